"""What kinds that hold a frame share: their rows, where they are held, and bounds on how far they
are from there.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar

from kempe import spatial
from kempe.constraints.base import (
    HERE,
    UNITS,
    Bounded,
    Constraint,
    Op,
    Row,
)
from kempe.constraints.reading import (
    along,
    at_point,
    directions_of,
    points_of,
    positive,
)
from kempe.constraints.tape import POSE
from kempe.constraints.text import from_text
from kempe.errors import InputError
from kempe.spatial import Array

ORIGIN = (0.0, 0.0, 0.0)
Z = (0.0, 0.0, 1.0)


@lru_cache
def points(dim: int, axes: str = "xyz", **held: str) -> tuple[Row, ...]:
    """Rows that hold the origin of B along axes of A; `dim` is 2 in the plane, else 3."""
    return tuple(
        Row(Op.POINT, ("xyz".index(a),), a, "m", part=k if held else None, **held)
        for k, a in enumerate(axes[:dim])
    )


@lru_cache
def whole(dim: int) -> tuple[Row, ...]:
    """Rows that hold position and orientation of B in A; `dim` is 2 in the plane, else 3."""
    return (*points(dim), ROTATION)


ROTATION, TILT, LOOK = (
    Row(op, (), name, "rad") for op, name in ((Op.ROTATION, "r"), (Op.TILT, "r"), (Op.LOOK, "r"))
)


class Placed(Constraint):
    """Base of constraints with a `target` or an `origin` on frame A, and a `point` of frame B."""

    def tool(self, dim: int) -> tuple[float, ...]:
        """The pose, as 16 numbers, of the `point` of frame B, without a rotation."""
        point = getattr(self, "point", ORIGIN)
        return HERE if point is ORIGIN else at_point(point, dim, f"point of {self.label}")

    def _at(self, dim: int, name: str) -> Array:
        """Poses (..., 4, 4), without a rotation, at the point in the field `name`; `dim` is 2 in
        the plane, else 3.
        """
        return spatial.pose(p=points_of(getattr(self, name), dim, f"{name} of {self.label}"))

    def _along(self, dim: int, name: str) -> Array:
        """Poses (..., 4, 4) at `origin` whose z is along the direction in the field `name`.

        In the plane (`dim` 2) their x is the normal of the plane; in space x is any direction
        across z.
        """
        z = directions_of(getattr(self, name), dim, f"{name} of {self.label}")
        return spatial.pose(along(z, dim), points_of(self.origin, dim, f"origin of {self.label}"))  # type: ignore[attr-defined]


class Measured(Placed, Bounded):
    """Base of constraints on one number: a distance, a height or an angle, at a value or between
    bounds.
    """

    measured: ClassVar[str] = "distance"
    instead: ClassVar[str] = ""
    """The field in whose place the bounds are; '' where the number is zero without bounds."""

    def check(self, dim: int) -> None:
        """Refuse bounds that leave nothing between them, and negative distances and angles."""
        value = getattr(self, self.instead) if self.instead else None
        if value is not None:
            positive(value, f"{self.instead} of {self.label}")
        super().check(dim)

    def between(self, op: Op, *args: Any) -> tuple[Row, ...]:
        """The row that holds the number between `at_least` and `at_most`; `op` is the operation
        that measures it.
        """
        return (Row(op, args, self.measured, UNITS[self.measured], low="at_least", high="at_most"),)

    def apart(self) -> tuple[Row, ...]:
        """The row of a distance that is the number of the field `instead`, or within bounds.
        Errors: `InputError`.
        """
        value = getattr(self, self.instead)
        if (value is None) != self.bounded:
            raise InputError(f"{self.label} needs a {self.instead}, or at_least or at_most")
        return (
            Row(Op.DISTANCE, (), "distance", equal=self.instead, low="at_least", high="at_most"),
        )

    def in_words(self, name: str) -> str:
        """The bounds, in place of the field that they replace, as `sentence` writes them."""
        return (
            self.bounds_in_words
            if name == self.instead and self.bounded
            else super().in_words(name)
        )

    @property
    def sentence(self) -> str:
        """The constraint as one plain sentence, with its bounds."""
        said = super().sentence
        if not self.bounded or self.instead:
            return said
        unit = UNITS[self.measured].replace("1", "")
        return f"{said}, off by {self.bounds_in_words} {unit}".rstrip()


LEAST = "1e-24"
"""Added to squares under a root, so that the root has derivatives at zero, too."""
OFF_LINE, TILTED, AWAY, TURNED = (
    from_text(text, POSE)
    for text in (
        f"sqrt(x^2 + y^2 + {LEAST})",
        f"atan2(sqrt(xz^2 + yz^2 + {LEAST}), zz)",
        f"atan2(sqrt((yz*z - zz*y)^2 + (zz*x - xz*z)^2 + (xz*y - yz*x)^2 + {LEAST}), -(xz*x + yz*y "
        "+ zz*z))",
        f"atan2(sqrt((zy - yz)^2 + (xz - zx)^2 + (yx - xy)^2 + {LEAST}), xx + yy + zz - 1)",
    )
)
"""Distance from z of A; angles of z of B against z of A, of z of B against the direction from B to
the origin of A, and of B against A."""
