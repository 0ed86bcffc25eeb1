"""Joint types: each is one small class that *declares* its primitives, with which kernels compute.

A joint connects frame F on its parent body to frame M on its child body. Its pose X_FM(q) is a
product of primitives: turns and slides about and along the axes x, y, z of the frame reached so
far, and unit quaternions. Most complex joints are combinations of revolute and prismatic ones; the
classes say which. A product without a class of its own is said in words:
`make_joint_type("P(x) R(z) R(y)")`.
"""

from __future__ import annotations

import math
import re
from dataclasses import MISSING, dataclass, fields, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kempe import spatial
from kempe.arrays import is_real
from kempe.errors import InputError, UnknownNameError
from kempe.kernels.forward.table_layout import BALL, SLIDE, TURN
from kempe.units import scale_lengths
from kempe.words import format_html_paragraphs

R = TURN
P = SLIDE
Q = BALL
"""Kinds of primitives in the table of the kernels: turn, slide, unit quaternion."""


MOTIONS = ("x", "y", "z", "rx", "ry", "rz")
"""Motions along and about axes."""


class Primitive(NamedTuple):
    """One elementary motion of a joint. It has a kind, an axis of the frame reached so far, a
    coordinate within the joint, and a multiplier.
    """

    kind: int
    axis: str
    coordinate: int
    multiplier: float = 1.0


@dataclass(frozen=True)
class JointType:
    """Base of all joint types. A subclass declares its name, coordinates and primitives."""

    type_name: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    planar: ClassVar[bool] = False
    """Whether the joint can be used in planar systems (dim = 2)."""
    short: ClassVar[str] = ""
    """The letter of the type, where it is none of R, P and S."""

    def layout(
        self, dim: int = 3, particle: bool = False
    ) -> tuple[tuple[str, ...], tuple[Primitive, ...]]:
        """Return the names of the joint's coordinates and its primitives, as (names, primitives).

        `dim` is 2 for a planar system, 3 for one in space; `particle` says that the child is a
        particle, which cannot turn.
        """
        raise NotImplementedError

    def dof(self, dim: int = 3, particle: bool = False) -> int:
        """Count the degrees of freedom of the joint, which equal its velocity coordinates."""
        return sum(3 if p.kind == Q else 1 for p in _select_unique(self.layout(dim, particle)[1]))

    def constraints(self, dim: int = 3, particle: bool = False) -> int:
        """Count the freedoms that the joint removes. A body has 6 (in the plane 3), a particle 3
        (2).
        """
        free = dim if particle else (6 if dim == 3 else 3)
        return free - self.dof(dim, particle)

    def forbids(self, dim: int = 3) -> tuple[str, ...]:
        """List the motions of M that the joint never allows. 'x', 'y', 'z' are along, 'rx', 'ry',
        'rz' about axes of F.

        In space a joint may take away more freedoms than these: along or about axes that move
        (universal), or by a relation between those that it allows (helical). In the plane the axis
        of a slide counts as x.
        """
        primitives = self.layout(dim)[1]
        if dim == 2:
            primitives = tuple(
                p._replace(axis="x") if p.kind == P and p.axis == "z" else p for p in primitives
            )
        slides = np.zeros((0, 3))
        turns = np.zeros((0, 3))
        turned = np.eye(3)
        for k, p in enumerate(primitives, 1):  # at some configuration that is not special
            own = np.eye(3) if p.kind == Q else p.multiplier * turned[:, "xyz".index(p.axis)][None]
            if p.kind == P:
                slides = np.vstack([slides, own, np.cross(turns, own)])
            else:
                turns = np.vstack([turns, own])
                turned = spatial.exp_so3(0.3 * k * own.sum(axis=0)) @ turned
        most = [x for of in (slides, turns) for x in np.abs(of).max(axis=0, initial=0.0).tolist()]
        still = {name for name, x in zip(MOTIONS, most, strict=True) if x < 1e-9}
        return tuple(name for name in (MOTIONS if dim == 3 else ("x", "y", "rz")) if name in still)

    def list_coordinate_names(self, dim: int = 3, particle: bool = False) -> tuple[str, ...]:
        """List the names of the coordinates within the joint; a single coordinate has the name ''."""
        return self.layout(dim, particle)[0]

    def list_velocity_names(self, dim: int = 3, particle: bool = False) -> tuple[str, ...]:
        """List the names of the velocity coordinates; a quaternion has wx, wy, wz (axes of M)."""
        names, primitives = self.layout(dim, particle)
        quaternions = {p.coordinate for p in primitives if p.kind == Q}
        if not quaternions:
            return tuple(names)
        out: list[str] = []
        for i, name in enumerate(names):
            if i in quaternions:
                out += ["wx", "wy", "wz"]
            elif not any(first < i < first + 4 for first in quaternions):
                out.append(name)
        return tuple(out)

    def list_turning_names(self, dim: int = 3, particle: bool = False) -> set[str]:
        """List the names of the coordinates that are angles, of a screw, too."""
        names, primitives = self.layout(dim, particle)
        return {names[p.coordinate] for p in primitives if p.kind == R}

    @property
    def decomposition(self) -> str:
        """The joint as a product of revolute (R) and prismatic (P) joints, as text."""
        parts: list[str] = []
        for kind, axis, _, multiplier in self.layout()[1]:
            if kind == Q:
                parts.append("R R R (as one unit quaternion)")
            else:
                coupled = f", {multiplier:g} q" if multiplier != 1.0 else ""
                parts.append(f"{'RP'[kind]}({axis}{coupled})")
        return " ".join(parts) or "rigid"

    @property
    def letter(self) -> str:
        """The letter of the type in pictures, or the letters of its primitives; '' for a fixed
        joint.
        """
        return self.short or "".join("RPS"[p.kind] for p in _select_unique(self.layout()[1]))

    def _repr_html_(self) -> str:
        n = self.dof()
        m = self.constraints()
        return format_html_paragraphs(
            [f"{self.type_name}: {self.summary}; {n} DoF, {m} constraint{'s' * (m != 1)}"]
        )

    @property
    def options(self) -> dict[str, object]:
        """The options that differ from their defaults, by name."""
        return {
            n: getattr(self, n)
            for n, default in self.list_defaults().items()
            if getattr(self, n) != default
        }

    @classmethod
    def list_defaults(cls) -> dict[str, object]:
        """Return the options of the joint type with their defaults, by name."""
        return {f.name: f.default for f in fields(cls) if f.default is not MISSING}


class Fixed(JointType):
    """Fixed joint: no motion."""

    type_name = "fixed"
    summary = "no motion"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Return no names and no primitives."""
        return (), ()


class Revolute(JointType):
    """Revolute joint, a hinge: rotation about z of F."""

    type_name = "revolute"
    summary = "turn about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Return one name '' and one primitive: a rotation about z of F."""
        return ("",), (Primitive(R, "z", 0),)


class Prismatic(JointType):
    """Prismatic joint, a slider: translation along z of F."""

    type_name = "prismatic"
    summary = "slide along z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Return one name '' and one primitive: a translation along z of F."""
        return ("",), (Primitive(P, "z", 0),)


@dataclass(frozen=True)
class Helical(JointType):
    """Helical joint, a screw: rotation about z, translation of `pitch` metres a radian along z. See
    Lynch, Park, 2017, section 2.2.
    """

    type_name = "helical"
    short = "H"
    summary = "turn about z and slide along it by pitch times the angle"
    pitch: float = 0.0

    def layout(self, dim: int = 3, particle: bool = False):
        """Return the name '' and two primitives of one angle: rotation about z, translation along
        z.
        """
        return ("",), (Primitive(R, "z", 0), Primitive(P, "z", 0, self.pitch))


class Cylindrical(JointType):
    """Cylindrical joint, a sleeve on a shaft: independent rotation about z and translation along z."""

    type_name = "cylindrical"
    short = "C"
    summary = "turn about z, slide along z"

    def layout(self, dim: int = 3, particle: bool = False):
        """Return names 'rz' and 'z' and their primitives: rotation about z, translation along z of
        F.
        """
        return ("rz", "z"), (Primitive(R, "z", 0), Primitive(P, "z", 1))


class Universal(JointType):
    """Universal (Cardan) joint: rotation about x of F, then about y of the cross."""

    type_name = "universal"
    short = "U"
    summary = "turn about x of F, then about y of M"

    def layout(self, dim: int = 3, particle: bool = False):
        """Return names 'rx' and 'ry' and their primitives: rotation about x of F, then y of the
        cross.
        """
        return ("rx", "ry"), (Primitive(R, "x", 0), Primitive(R, "y", 1))


class Planar(JointType):
    """Planar joint, a block on a table: translation along x and y of F, then rotation about z."""

    type_name = "planar"
    short = "E"
    summary = "slide along x and y, turn about z"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Return names 'x', 'y', 'rz' and primitives: two translations, then a rotation about z. A
        particle has no 'rz'.
        """
        if particle:
            return ("x", "y"), (Primitive(P, "x", 0), Primitive(P, "y", 1))
        return ("x", "y", "rz"), (Primitive(P, "x", 0), Primitive(P, "y", 1), Primitive(R, "z", 2))


class Translation(JointType):
    """Translation joint: three translations (in the plane two), constant orientation."""

    type_name = "translation"
    short = "T"
    summary = "slide along x, y and z (in the plane x and y)"
    planar = True

    def layout(self, dim: int = 3, particle: bool = False):
        """Return names 'x', 'y' (and in space 'z') with a translation along each of these axes."""
        return tuple("xyz"[:dim]), tuple(Primitive(P, a, i) for i, a in enumerate("xyz"[:dim]))


@dataclass(frozen=True)
class Spherical(JointType):
    """Spherical joint, a ball: any rotation, as a unit quaternion. With `angles` it has three
    rotations about z, y', x''.

    With angles there are as many coordinates as degrees of freedom, at the price of a singularity
    at ry = +-90 degrees.
    """

    type_name = "spherical"
    summary = "any rotation"
    angles: bool = False

    def layout(self, dim: int = 3, particle: bool = False):
        """Return the names and primitives of a rotation.

        They are 'qw', 'qx', 'qy', 'qz' with one quaternion, with `angles` 'rz', 'ry', 'rx' with
        three rotations.
        """
        if self.angles:
            return ("rz", "ry", "rx"), tuple(Primitive(R, a, i) for i, a in enumerate("zyx"))
        return ("qw", "qx", "qy", "qz"), (Primitive(Q, "z", 0),)


@dataclass(frozen=True)
class Free(JointType):
    """Free joint: no constraint. It has 6 degrees of freedom in space and 3 in the plane, for a
    particle 3 and 2.
    """

    type_name = "free"
    short = "F"
    summary = "any motion"
    planar = True
    angles: bool = False

    def layout(self, dim: int = 3, particle: bool = False):
        """Return names and primitives of `Translation` and `Spherical`, in the plane of `Planar`."""
        if particle:
            return Translation().layout(dim)
        if dim == 2:
            return Planar().layout(dim)
        names, slides = Translation().layout()
        ball_names, turns = Spherical(self.angles).layout()
        return names + ball_names, slides + tuple(
            t._replace(coordinate=t.coordinate + 3) for t in turns
        )


@dataclass(frozen=True)
class Product(JointType):
    """A product of primitives as text, such as "P(x) R(z) R(y)". The axes of each are moved by
    those before it.

    R(x) turns about an axis, P(x) slides along it, H(x, 0.1) is a screw of that pitch in metres a
    radian, S (or Q) is any rotation, as a unit quaternion. Coordinates are `rx` for turns and
    screws and `x` for slides, numbered where an axis occurs more than once (`rz1`, `rz2`).
    """

    summary = "product of primitives"
    planar = True
    words: str

    def __post_init__(self) -> None:
        said = [
            letter + f"({', '.join(letters)})" * bool(letters)
            for letter, *letters in _parse_factors(self.words)
        ]
        object.__setattr__(self, "words", " ".join(said))

    @property
    def type_name(self) -> str:  # type: ignore[override]
        """The product as text that `make_joint_type` reads."""
        return self.words

    def layout(self, dim: int = 3, particle: bool = False):
        """Return the names and primitives of the product, factor by factor."""
        return _parse_product(self.words)


_FACTOR = re.compile(
    r"([RP])\(([xyz])\)|(H)\(([xyz]),([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\)|[SQ]", re.ASCII
)
_LETTERS = frozenset("RPHSQ")


def _parse_factors(words: str) -> list[tuple[str, ...]]:
    """Parse a product into letter, axis and pitch of each factor, as text. Errors: `InputError`."""
    out: list[tuple[str, ...]] = []
    for word in re.findall(r"\w+(?:\s*\([^()]*\))?|\S", words):
        found = _FACTOR.fullmatch("".join(word.split()))
        pitch = float(found[5]) if found and found[3] else 0.0
        if found is None or not math.isfinite(pitch):
            allowed = (
                "R(x) turns, P(x) slides, H(x, 0.1) is a screw with its pitch, each with x, y or "
                "z; S is a ball"
            )
            raise InputError(f"joint type {words!r}: {word!r} is no primitive; {allowed}")
        out.append(
            (found[1], found[2])
            if found[1]
            else ("H", found[4], repr(pitch))
            if found[3]
            else ("S",)
        )
    if not out or out.count(("S",)) > 1:
        raise InputError(
            f"joint type {words!r}: it has " + ("more than one S" if out else "no primitive")
        )
    return out


@lru_cache(maxsize=256)
def _parse_product(words: str) -> tuple[tuple[str, ...], tuple[Primitive, ...]]:
    """Parse a product into the names of its coordinates and its primitives."""
    names: list[str] = []
    steps: list[Primitive] = []
    for letter, *letters in _parse_factors(words):
        i = len(names)
        if letter == "S":
            names += ["qw", "qx", "qy", "qz"]
            steps.append(Primitive(Q, "z", i))
            continue
        names.append(letters[0] if letter == "P" else "r" + letters[0])
        if letter != "P":
            steps.append(Primitive(R, letters[0], i))
        if letter != "R":
            steps.append(Primitive(P, letters[0], i, float(letters[1]) if letter == "H" else 1.0))
    numbered = tuple(
        f"{n}{names[:i].count(n) + 1}" if names.count(n) > 1 else n for i, n in enumerate(names)
    )
    return ("",) if len(names) == 1 else numbered, tuple(steps)


def scale_pitch(joint: JointType, factor: Fraction) -> JointType:
    """Return the joint type with the pitch of its screws in another unit of length.

    Errors: `InputError` for screws of other types, whose pitch nobody knows how to set.
    """
    if isinstance(joint, Helical):
        return replace(joint, pitch=scale_lengths(joint.pitch, factor))
    if isinstance(joint, Product):
        factors = [
            ("H", found[1], repr(scale_lengths(float(found[2]), factor)))
            if found[0] == "H"
            else found
            for found in _parse_factors(joint.words)
        ]
        words = [letter + f"({', '.join(of)})" * bool(of) for letter, *of in factors]
        return Product(" ".join(words))
    primitives = joint.layout()[1]
    turning = {p.coordinate for p in primitives if p.kind == R}
    if any(p.kind == P and p.coordinate in turning for p in primitives):
        raise InputError(
            f"its type {joint.type_name!r} turns and slides by one coordinate: its pitch cannot be "
            "converted to another unit of length"
        )
    return joint


TYPES: dict[str, type[JointType]] = {
    t.type_name: t
    for t in (
        Fixed,
        Revolute,
        Prismatic,
        Helical,
        Cylindrical,
        Universal,
        Planar,
        Translation,
        Spherical,
        Free,
    )
}
"""The table of the zoo: one row a joint type."""


def make_joint_type(name: object, **options: object) -> JointType:
    """Make a joint type from its name, a product as text (see `Product`), or another joint type.
    Options are set in it.

    Errors: `UnknownNameError` for the name, `InputError` for products that cannot be read and for
    options that the type does not take.
    """
    if isinstance(name, JointType):
        made = name
    elif isinstance(name, str) and name in TYPES:
        made = TYPES[name]()
    elif isinstance(name, str) and ("(" in name or name and _LETTERS.issuperset(name.split())):
        made = Product(name)
    else:
        raise UnknownNameError("joint type", name, (*TYPES, "P(x) R(z)"))
    known = made.list_defaults()
    options = {**made.options, **options}
    for key, given in options.items():
        if key not in known:
            allowed = f"it takes {', '.join(known)}" if known else "it takes no options"
            raise InputError(f"joint type {made.type_name!r} has no option {key!r}; {allowed}")
        if isinstance(known[key], bool):
            if not isinstance(given, (bool, np.bool_)):
                raise InputError(f"option {key!r} is {given!r}; it must be true or false")
        elif not is_real(given) or not np.isfinite(float(given)):
            raise InputError(f"option {key!r} is {given!r}; it must be a finite number")
    kept: dict[str, Any] = {k: type(known[k])(v) for k, v in options.items()}  # type: ignore[call-arg]
    return replace(made, **kept) if kept else made


def is_table_type(kind: JointType) -> bool:
    """Whether `make_joint_type` can make this joint type from its name and options, as files
    require.
    """
    return TYPES.get(kind.type_name, Product) is type(kind)


AXIS_ROTATIONS = {
    "x": spatial.align_z([1.0, 0, 0]),
    "y": spatial.align_z([0.0, 1, 0]),
    "z": np.eye(3),
}
"""The rotation that takes z to each axis: primitives of the table always turn about z or slide
along it."""


def _select_unique(primitives: tuple[Primitive, ...]) -> list[Primitive]:
    """Select one primitive of each coordinate."""
    return list({p.coordinate: p for p in primitives}.values())
