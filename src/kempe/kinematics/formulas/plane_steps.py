"""The closing of three joints in the plane in steps: two circles, a line and a circle, two lines.

An arm that reaches a point or a pose, and a dyad between two links, are the same triangle (Assur,
1914).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.symbolic_turns import sympy

Vector = tuple[Any, Any]
"""Two expressions, along x and y."""


def turned(v: Vector, angle: Any) -> Vector:
    """A vector, turned by an angle."""
    c = sympy.cos(angle)
    s = sympy.sin(angle)
    return c * v[0] - s * v[1], s * v[0] + c * v[1]


def plus(a: Vector, b: Vector) -> Vector:
    """The sum of two vectors."""
    return a[0] + b[0], a[1] + b[1]


def minus(a: Vector, b: Vector) -> Vector:
    """The difference of two vectors."""
    return a[0] - b[0], a[1] - b[1]


def cross(a: Vector, b: Vector) -> Any:
    """What spans a parallelogram: a_x b_y - a_y b_x."""
    return a[0] * b[1] - a[1] * b[0]


def polar(v: Vector) -> tuple[Any, Any]:
    """Length and angle of a vector; of one along x, or with parameters along an axis, without a
    root.
    """
    x, y = map(sympy.expand, v)
    if y == 0:
        sense = x.could_extract_minus_sign()
        return (-x if sense else x), sympy.pi if sense else sympy.Integer(0)
    if x == 0:
        sense = y.could_extract_minus_sign()
        return (-y if sense else y), (-1 if sense else 1) * sympy.pi / 2
    return sympy.sqrt(x**2 + y**2), sympy.atan2(y, x)


def unless_zero(*lengths: Any, named: Any = None) -> str:
    """The condition that none of some expressions is zero, without those that are other numbers; of
    one its name.
    """
    left = [x if named is None else named for x in lengths if not x.is_number or x.is_zero]
    return " and ".join(f"{x} != 0" for x in left)


def endings() -> Iterator[str]:
    """What is put after the names of symbols, until a system has none of them: nothing, '_0', '_1',
    ...
    """
    return itertools.chain([""], (f"_{k}" for k in itertools.count()))


class Names(NamedTuple):
    """The symbols of one triangle."""

    r2: Any
    c2: Any
    s2: Any
    alpha: Any
    beta: Any
    sign: Any
    u: Any

    @classmethod
    def ending(cls, end: str) -> Names:
        """The symbols with an ending such as '_1'."""
        return cls(*(sympy.Symbol(f"{name}{end}") for name in cls._fields))

    @classmethod
    def among(cls, names: dict[str, Any]) -> Names:
        """Those of several symbols, by their words, that are of a triangle."""
        return cls(*(names[name] for name in cls._fields))


def two_circles(
    n: Names, to: Vector, l1: Any, l2: Any, says: str, sense: int = 1
) -> tuple[list[FormulaStep], Any, Any]:
    """Two bars of lengths l1, l2 that end at `to`: steps, the angle of the first, and that from it
    to the second.

    Where `sign` times `sense` is +1 the second is turned to the left against the first.
    """
    x, y = to
    steps = [
        FormulaStep(n.r2, x**2 + y**2, "both parts of the position squared and summed"),
        FormulaStep(
            n.c2, (n.r2 - l1**2 - l2**2) / (2 * l1 * l2), "the law of cosines", unless_zero(l1, l2)
        ),
        FormulaStep(n.s2, sense * n.sign * sympy.sqrt(1 - n.c2**2), says, f"-1 <= {n.c2} <= 1"),
        FormulaStep(n.alpha, sympy.atan2(y, x), "angle to the target", f"{n.r2} != 0"),
        FormulaStep(
            n.beta,
            sympy.atan2(l2 * n.s2, l1 + l2 * n.c2),
            "angle from the first link to the target",
        ),
    ]
    return steps, n.alpha - n.beta, sympy.atan2(n.s2, n.c2)


def line_and_circle(
    n: Names, to: Vector, along: Vector, length: Any
) -> tuple[list[FormulaStep], Any, Any]:
    """A slide u along a direction, then a bar that ends at `to`: steps, u, and the angle of the
    bar.

    Where `sign` is +1 it slides farther than where both roots meet.
    """
    ahead = to[0] * along[0] + to[1] * along[1]
    aside = cross(along, to)
    steps = [
        FormulaStep(n.s2, aside / length, "part of the way across the slide", unless_zero(length)),
        FormulaStep(
            n.c2, -n.sign * sympy.sqrt(1 - n.s2**2), "+1 slides farther", f"-1 <= {n.s2} <= 1"
        ),
        FormulaStep(
            n.u, ahead - length * n.c2, "the slide: part of the way along it, less that of the bar"
        ),
        FormulaStep(n.beta, sympy.atan2(n.s2, n.c2), "angle from the slide to the bar"),
    ]
    return steps, n.u, n.beta + polar(along)[1]


def turning_slide(n: Names, to: Vector, across: Any) -> tuple[list[FormulaStep], Any, Any]:
    """A rail that turns, on which a point slides at a distance `across`, to `to`: steps, the slide,
    the rail's angle.

    Where `sign` is +1 it slides farther than where both roots meet, the foot of the rail's normal.
    """
    (x, y) = to
    least = across**2
    far = f"{n.r2} >= {float(least):.6g}" if least.is_number else f"{n.r2} >= {least}"
    steps = [
        FormulaStep(n.r2, x**2 + y**2, "both parts of the position squared and summed"),
        FormulaStep(
            n.u,
            n.sign * sympy.sqrt(n.r2 - least),
            "the slide, by Pythagoras",
            far * (not least.is_zero),
        ),
        FormulaStep(n.alpha, sympy.atan2(y, x), "angle to the target", f"{n.r2} != 0"),
        FormulaStep(n.beta, sympy.atan2(across, n.u), "angle from the rail to the target"),
    ]
    return steps, n.u, n.alpha - n.beta


def two_lines(n: Names, to: Vector, one: Vector, two: Vector) -> tuple[list[FormulaStep], Any, Any]:
    """Two slides along directions that add up to `to`: steps, none for slides at right angles, and
    both slides.
    """
    area = sympy.simplify(cross(one, two))
    if area in (1, -1):
        return [], area * cross(to, two), area * cross(one, to)
    steps = [
        FormulaStep(
            n.c2, area, "sine of the angle between the slides", unless_zero(area, named=n.c2)
        )
    ]
    return steps, cross(to, two) / n.c2, cross(one, to) / n.c2
