"""Joint types of one's own: declared in tests only, and in the table of joints while a `with` block
lasts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields

import numpy as np

from kempe.joints import TYPES, JointType, P, Primitive, Q, R


@dataclass(frozen=True)
class PinSlot(JointType):
    """A pin in a slot: slide along x of F, then turn about z."""

    type_name = "pin_slot"
    summary = "slide along x, turn about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """A slide and a turn."""
        return ("x", "rz"), (Primitive(P, "x", 0), Primitive(R, "z", 1))


@dataclass(frozen=True)
class SlotFirst(JointType):
    """The same pair the other way round: turn about z, then slide along x."""

    type_name = "slot_pin"
    summary = "turn about z, slide along x"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """A turn and a slide."""
        return ("rz", "x"), (Primitive(R, "z", 0), Primitive(P, "x", 1))


@dataclass(frozen=True)
class Crooked(JointType):
    """Turn about x, slide along z, turn about y: nothing is held along fixed axes."""

    type_name = "crooked"
    summary = "turn about x, slide along z, turn about y"

    def layout(self, dim: int = 3, particle: bool = False):
        """Two turns and a slide between them."""
        return ("a", "s", "b"), (Primitive(R, "x", 0), Primitive(P, "z", 1), Primitive(R, "y", 2))


@dataclass(frozen=True)
class TurnedTable(JointType):
    """A planar joint that turns first: its slides are along the axes of the turned frame."""

    type_name = "turned_table"
    summary = "turn about z, slide along x and y"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """A turn and two slides."""
        return ("rz", "x", "y"), (Primitive(R, "z", 0), Primitive(P, "x", 1), Primitive(P, "y", 2))


@dataclass(frozen=True)
class CrossSlide(JointType):
    """Two slides in the order y, x, and a turn about z, with coordinates in another order."""

    type_name = "cross_slide"
    summary = "slide along y and x, turn about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Two slides and a turn."""
        return ("rz", "x", "y"), (Primitive(P, "y", 2), Primitive(P, "x", 1), Primitive(R, "z", 0))


@dataclass(frozen=True)
class OtherCardan(JointType):
    """A universal joint with the axes z and x."""

    type_name = "other_cardan"
    summary = "turn about z, then about x"

    def layout(self, dim: int = 3, particle: bool = False):
        """Two turns."""
        return ("rz", "rx"), (Primitive(R, "z", 0), Primitive(R, "x", 1))


@dataclass(frozen=True)
class Drill(JointType):
    """A screw along x that also turns about its own z, geared to a slide: one coordinate, three
    motions.
    """

    type_name = "drill"
    summary = "turn about x, slide along it and turn about z by one coordinate"
    lead: float = 0.2

    def layout(self, dim: int = 3, particle: bool = False):
        """Three primitives of one coordinate."""
        return ("",), (
            Primitive(P, "x", 0, self.lead),
            Primitive(R, "x", 0),
            Primitive(R, "z", 0, 0.5),
        )


@dataclass(frozen=True)
class Coaxial(JointType):
    """Three turns about one axis: only their sum can be seen."""

    type_name = "coaxial"
    summary = "three turns about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Three turns."""
        return ("a", "b", "c"), tuple(Primitive(R, "z", i) for i in range(3))


@dataclass(frozen=True)
class BallInTube(JointType):
    """A ball whose centre slides along z."""

    type_name = "ball_in_tube"
    summary = "slide along z, any rotation"

    def layout(self, dim: int = 3, particle: bool = False):
        """A slide and a quaternion."""
        return ("z", "qw", "qx", "qy", "qz"), (Primitive(P, "z", 0), Primitive(Q, "z", 1))


@dataclass(frozen=True)
class BallOnStick(JointType):
    """A rotation, and then a slide along the turned z."""

    type_name = "ball_on_stick"
    summary = "any rotation, slide along z of M"

    def layout(self, dim: int = 3, particle: bool = False):
        """A quaternion and a slide."""
        return ("qw", "qx", "qy", "qz", "z"), (Primitive(Q, "z", 0), Primitive(P, "z", 4))


@dataclass(frozen=True)
class Geared(JointType):
    """A hinge whose coordinate is that of the motor before a gear: it turns 2.5 times as slowly."""

    type_name = "geared"
    summary = "turn about z by 0.4 of the coordinate"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """One turn."""
        return ("motor",), (Primitive(R, "z", 0, 0.4),)


@dataclass(frozen=True)
class Rail(JointType):
    """A slide along x of F, in the plane as well."""

    type_name = "rail"
    summary = "slide along x"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """One slide."""
        return ("",), (Primitive(P, "x", 0),)


@dataclass(frozen=True)
class Telescope(JointType):
    """Two slides along z: only their sum can be seen."""

    type_name = "telescope"
    summary = "two slides along z"

    def layout(self, dim: int = 3, particle: bool = False):
        """Two slides."""
        return ("outer", "inner"), (Primitive(P, "z", 0), Primitive(P, "z", 1))


@dataclass(frozen=True)
class Diagonal(JointType):
    """A slide along x and y by one coordinate."""

    type_name = "diagonal"
    summary = "slide along x and y alike"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Two slides of one coordinate."""
        return ("",), (Primitive(P, "x", 0), Primitive(P, "y", 0))


OWN: tuple[type[JointType], ...] = (
    PinSlot,
    SlotFirst,
    Crooked,
    TurnedTable,
    CrossSlide,
    OtherCardan,
    Drill,
    Coaxial,
    BallInTube,
    BallOnStick,
    Geared,
    Rail,
    Telescope,
    Diagonal,
)
"""Types that are not in the table of joints."""


PRODUCTS = (
    "P(x) R(z) R(y)",
    "P(x) R(z)",
    "R(z) P(x) R(z)",
    "P(y) P(x)",
    "P(z) R(x) P(y) R(z)",
    "R(z) R(x) R(z)",
    "H(x, 0.25)",
    "H(z, -0.1) P(y) S",
    "S P(z)",
    "R(y)",
    "P(x)",
    "S",
    "P(x) P(y) P(z) R(x) R(y) R(z)",
    "R(x) R(y) P(y)",
)
"""Joint types as products in words."""


def random_product(rng: np.random.Generator, dim: int = 3) -> str:
    """A product in words, of one to four factors."""
    words = []
    for _ in range(int(rng.integers(1, 5 if dim == 3 else 4))):
        letter = str(rng.choice(list("RRRPPPHS" if dim == 3 else "RP")))
        axis = str(rng.choice(list("xyz") if dim == 3 else ["z"] if letter == "R" else ["x", "y"]))
        if letter == "S" and "S" in words:
            continue
        words.append(
            {"S": "S", "H": f"H({axis}, {rng.uniform(-1, 1):.2f})"}.get(letter, f"{letter}({axis})")
        )
    return " ".join(words)


def declared(name: str, steps: Sequence[Primitive]) -> JointType:
    """A joint of a type of its own, with the coordinates c0, c1, ... and these primitives wherever
    it is used.
    """
    count = max((p.coordinate + (4 if p.kind == Q else 1) for p in steps), default=0)
    found = tuple(f"c{i}" for i in range(count)), tuple(steps)
    body = {
        "type_name": name,
        "summary": "random primitives",
        "planar": True,
        "layout": lambda *_, **__: found,
    }
    return type(name, (JointType,), body)()


def random_type(rng: np.random.Generator, name: str, dim: int = 3) -> JointType:
    """A joint type of one to four random primitives; some share a coordinate, some have a
    multiplier.
    """
    if dim == 2 and rng.random() < 0.15:
        return declared(name, [Primitive(P, "z", 0, float(rng.choice([1.0, 1.0, -0.7])))])
    steps = []
    count = 0
    ball = False
    for _ in range(int(rng.integers(1, 5 if dim == 3 else 4))):
        if dim == 3 and not ball and rng.random() < 0.12:
            steps.append(Primitive(Q, "z", count))
            count = count + 4
            ball = True
            continue
        kind = int(rng.choice([R, P]))
        axis = str(rng.choice(list("xyz") if dim == 3 else ["z"] if kind == R else ["x", "y"]))
        before = [p.coordinate for p in steps if p.kind != Q]
        if before and rng.random() < 0.15:
            steps.append(
                Primitive(
                    kind, axis, before[-1], float(rng.choice([1.0, round(rng.uniform(-2, 2), 2)]))
                )
            )
        else:
            steps.append(
                Primitive(kind, axis, count, float(rng.choice([1.0, 1.0, 1.0, -1.0, 0.4, 2.0])))
            )
            count += 1
    return declared(name, steps)


def variants(kind: type[JointType], number: float) -> list[dict]:
    """Option sets of a type: each number at the given value, and each switch off, then on."""
    numbers = {f.name: number for f in fields(kind) if isinstance(f.default, float)}
    return [numbers, *({**numbers, f.name: True} for f in fields(kind) if f.default is False)]


@contextmanager
def registered(kinds: Sequence[type[JointType]] = OWN) -> Iterator[None]:
    """The table of joints has these types, too, while the block lasts."""
    before = dict(TYPES)
    TYPES.update({kind.type_name: kind for kind in kinds})
    try:
        yield
    finally:
        TYPES.clear()
        TYPES.update(before)
