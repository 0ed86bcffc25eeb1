"""Kinds that hold a frame, or a point or an axis of it, in, on or near something; lengths in metres, angles in radians.

A frame is held against the ground, or against the frame `other`, in whose axes targets are then read. Targets may have
leading axes where `System.ik` is asked: they make a batch. `point` is a point of the frame, in its axes.
"""

from __future__ import annotations

import math
from dataclasses import field
from functools import lru_cache

import numpy as np

from kempe import spatial
from kempe.constraints.base import (
    EYE,
    HERE,
    Constraint,
    Direction,
    Frame,
    Matrix,
    Number,
    Op,
    Point,
    Rotation,
    Row,
    kind,
    plainly,
)
from kempe.constraints.reading import (
    along,
    at_point,
    corners_of,
    directions_of,
    numbers_of,
    pair,
    points_of,
    poses_of,
    positive,
    with_axis,
)
from kempe.constraints.tape import Tape
from kempe.constraints.text import from_text
from kempe.errors import InputError
from kempe.rigid import arrays
from kempe.spatial import Array

ORIGIN, Z = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@lru_cache
def points(dim: int, axes: str = "xyz", **held: str) -> tuple[Row, ...]:
    """Rows that hold the origin of B along axes of A."""
    return tuple(
        Row(Op.POINT, ("xyz".index(a),), a, "m", part=k if held else None, **held) for k, a in enumerate(axes[:dim])
    )


@lru_cache
def whole(dim: int) -> tuple[Row, ...]:
    """Rows that hold all of a frame."""
    return (*points(dim), ROTATION)


ROTATION, TILT, LOOK = (Row(op, (), name, "rad") for op, name in ((Op.ROTATION, "r"), (Op.TILT, "r"), (Op.LOOK, "r")))


class Placed(Constraint):
    """A kind with a `target`, or an `origin`, and a `point` of the frame."""

    def tool(self, dim: int) -> tuple[float, ...]:
        """The point."""
        point = getattr(self, "point", ORIGIN)
        return HERE if point is ORIGIN else at_point(point, dim, f"point of {self.label}")

    def _at(self, dim: int, name: str) -> Array:
        """A pose at the point that a field holds."""
        return spatial.pose(p=points_of(getattr(self, name), dim, f"{name} of {self.label}"))

    def _along(self, dim: int, name: str) -> Array:
        """A pose at `origin` whose z is along the direction that a field holds."""
        z = directions_of(getattr(self, name), dim, f"{name} of {self.label}")
        return spatial.pose(along(z, dim), points_of(self.origin, dim, f"origin of {self.label}"))  # type: ignore[attr-defined]


@kind("pose", says="{frame} is at {target}")
class Pose(Placed):
    """A frame at a pose: `target` (..., 4, 4), in planar systems also (..., 3, 3)."""

    frame: Frame
    target: Matrix
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """All of the frame."""
        return whole(dim)

    def goal(self, dim: int) -> Array:
        """The target."""
        return poses_of(self.target, dim, f"target of {self.label}")


@kind("position", says="{frame} is at {target}")
class Position(Placed):
    """A point of a frame at a position `target` (..., 3), in planar systems also (..., 2)."""

    frame: Frame
    target: Point
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The point."""
        return points(dim)

    def goal(self, dim: int) -> Array:
        """The target."""
        return self._at(dim, "target")


@kind("orientation", says="{frame} is turned as {target}")
class Orientation(Placed):
    """A frame turned as `target` (..., 3, 3), or as a pose (..., 4, 4), wherever it is."""

    frame: Frame
    target: Rotation
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The rotation."""
        return (ROTATION,)

    def goal(self, dim: int) -> Array:
        """The target."""
        X = numbers_of(arrays(self.target, what := f"target of {self.label}"), what)
        return poses_of(spatial.pose(X) if X.ndim >= 2 and X.shape[-2:] == (3, 3) else X, dim, what)


class _Axis(Placed):
    """A kind on an `axis` of a frame."""

    def tool(self, dim: int) -> tuple[float, ...]:
        """A turn that brings z to the axis."""
        return with_axis(self.axis, dim, f"axis of {self.label}")  # type: ignore[attr-defined]


@kind("pointing", says="an axis of {frame} is along {direction}")
class Pointing(_Axis):
    """An `axis` of a frame (default z, in the plane x) along a `direction` (..., 3) of the ground, or of `other`."""

    frame: Frame
    direction: Direction
    axis: Direction = None
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The axis."""
        return (TILT,)

    def goal(self, dim: int) -> Array:
        """A frame whose z is the direction."""
        return spatial.pose(along(directions_of(self.direction, dim, f"direction of {self.label}"), dim))


@kind("look_at", says="an axis of {frame} points at {target}")
class LookAt(_Axis):
    """An `axis` of a frame (default z, in the plane x) towards a point `target` (..., 3), as a camera looks at it."""

    frame: Frame
    target: Point
    axis: Direction = None
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The axis."""
        return (LOOK,)

    def goal(self, dim: int) -> Array:
        """The point."""
        return self._at(dim, "target")


@kind("on_line", says="{frame} is on a line of {other}")
class OnLine(Placed):
    """A point of a frame on the line through `origin` (..., 3) along `direction` (..., 3)."""

    frame: Frame
    origin: Point = ORIGIN
    direction: Direction = Z
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """What is across the line; in the plane only within it."""
        return points(3, "y" if dim == 2 else "xy")

    def goal(self, dim: int) -> Array:
        """A frame on the line, z along it."""
        return self._along(dim, "direction")


@kind("on_plane", says="{frame} is on a plane of {other}")
class OnPlane(Placed):
    """A point of a frame on the plane through `origin` (..., 3) with the normal `normal` (..., 3)."""

    frame: Frame
    origin: Point = ORIGIN
    normal: Direction = Z
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """What is along the normal."""
        return points(3, "z")

    def goal(self, dim: int) -> Array:
        """A frame on the plane, z along the normal."""
        return self._along(dim, "normal")


@kind("half_space", "contact", "{frame} is on one side of a plane of {other}")
class HalfSpace(OnPlane):
    """A point of a frame on that side of a plane to which its `normal` points, at least `margin` (...) m from it."""

    margin: Number = 0.0

    def rows(self, dim: int) -> tuple[Row, ...]:
        """Above the plane."""
        return (Row(Op.POINT, (2,), "z", low="zero"),)

    def goal(self, dim: int) -> Array:
        """A frame that far from the plane, z along the normal."""
        X, margin = super().goal(dim), numbers_of(self.margin, f"margin of {self.label}")
        return X @ spatial.pose(p=margin[..., None] * np.array(Z)) if np.any(margin) else X


@kind("on_sphere", says="{frame} is {radius} m away from a point of {other}")
class OnSphere(Placed):
    """A point of a frame at the distance `radius` (...) from `center` (..., 3): on a sphere, in the plane a circle."""

    frame: Frame
    center: Point
    radius: Number
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The distance."""
        return (Row(Op.DISTANCE, (), "distance", equal="radius"),)

    def check(self, dim: int) -> None:
        """A radius is not negative."""
        positive(self.radius, f"radius of {self.label}")

    def goal(self, dim: int) -> Array:
        """The center."""
        return self._at(dim, "center")


@kind("in_box", "contact", "{frame} is in a box of {other}")
class InBox(Placed):
    """A point of a frame between the corners `low` and `high` (..., 3) of a box that is at `pose` (..., 4, 4)."""

    frame: Frame
    low: Point
    high: Point
    pose: Matrix = field(default_factory=lambda: np.eye(4))
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """All directions."""
        return points(dim, low="low_corner", high="high_corner")

    def goal(self, dim: int) -> Array:
        """The box's frame."""
        return poses_of(self.pose, dim, f"pose of {self.label}")

    def check(self, dim: int) -> None:
        """The corners leave something between them."""
        self._corners(dim)

    def _corners(self, dim: int = 0) -> tuple[Array, Array]:
        what = f"corners of {self.label}"
        flat = np.shape(self.low)[-1:] == (2,) or np.shape(self.high)[-1:] == (2,)
        return pair(*corners_of(self.low, self.high, dim or (2 if flat else 3), what), what)

    @property
    def low_corner(self) -> Array:
        """The lower corner (..., 3), checked."""
        return self._corners()[0]

    @property
    def high_corner(self) -> Array:
        """The upper corner (..., 3), checked."""
        return self._corners()[1]


class _TwoFrames(Placed):
    """A kind on a frame and another one, which is named second."""


@kind("relative_pose", says="{frame} is at {target}, seen from {other}")
class RelativePose(_TwoFrames):
    """A frame at a pose `target` (..., 4, 4) seen from the frame `other`."""

    frame: Frame
    other: Frame
    target: Matrix

    rows, goal = Pose.rows, Pose.goal


@kind("relative_position", says="{frame} is at {target}, seen from {other}")
class RelativePosition(_TwoFrames):
    """A point of a frame at a position `target` (..., 3) seen from the frame `other`, in its axes."""

    frame: Frame
    other: Frame
    target: Point
    point: Point = ORIGIN

    rows, goal = Position.rows, Position.goal


@kind("distance", says="{frame} and {other} are {value} m apart")
class Distance(_TwoFrames):
    """The distance of a `point` of a frame from `other_point` of another: `value` (...), or between bounds (...).

    A rod with a ball at each end has a `value`, a rope only `at_most`.
    """

    frame: Frame
    other: Frame
    value: Number = None
    at_least: Number = None
    at_most: Number = None
    point: Point = ORIGIN
    other_point: Point = ORIGIN

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The distance."""
        if (self.value is None) == (self.at_least is None and self.at_most is None):
            raise InputError(f"{self.label} needs a value, or at_least or at_most")
        return (Row(Op.DISTANCE, (), "distance", equal="value", low="at_least", high="at_most"),)

    def in_words(self, name: str) -> str:
        """Bounds in place of the value, where they are given."""
        if name != "value" or self.value is not None:
            return super().in_words(name)
        given = (("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{word} {plainly(x)}" for word, x in given if x is not None)

    def check(self, dim: int) -> None:
        """Distances are not negative, and bounds leave something between them."""
        for name in ("value", "at_least", "at_most"):
            if (x := getattr(self, name)) is not None:
                positive(x, f"{name} of {self.label}" if name == "value" else f"a bound of {self.label}")
        if self.value is None:
            pair(0.0 if self.at_least is None else self.at_least, math.inf if self.at_most is None else self.at_most,
                 f"at_least and at_most of {self.label}")  # fmt: skip

    def goal(self, dim: int) -> Array:
        """The point of the other frame."""
        return EYE if self.other_point is ORIGIN else self._at(dim, "other_point")


@kind("on_surface", says="{frame} is on {surface} of {other}")
class OnSurface(Placed):
    """A point of a frame on the surface f(x, y, z) = 0, in the plane on the curve f(x, y) = 0.

    `surface` is text such as ``"x^2/4 + y^2 = 1"``, in metres along the axes of the ground or of `other`.
    """

    frame: Frame
    surface: str
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def rows(self, dim: int) -> tuple[Row, ...]:
        """The equation of the surface."""
        return (Row(Op.TAPE, (self._tape(dim), 0), "surface", "1"),)

    def _tape(self, dim: int) -> Tape:
        return from_text([self.surface], tuple("xyz"[:dim]), {})
