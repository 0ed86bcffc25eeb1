"""Kinds of constraints on a frame, or on a point or axis of it, in metres and radians.

A frame is held against the ground, or against the frame `other`, in whose axes targets are then
read.
"""

from __future__ import annotations

from dataclasses import field
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from kempe import spatial
from kempe.constraints.base import (
    EYE,
    HERE,
    UNITS,
    Bounded,
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
    make_axis_pose,
    make_point_pose,
    make_rotations_along,
    read_bounds,
    read_corners,
    read_directions,
    read_nonnegative_numbers,
    read_numbers,
    read_points,
    read_poses,
)
from kempe.constraints.tape import POSE, Tape
from kempe.constraints.text import LEAST, parse_tape
from kempe.errors import InputError
from kempe.poses import read_pose_array
from kempe.spatial import Array

# ---- bases of kinds

# What kinds that hold a frame share: their rows, where they are held, and bounds on how far they
# are from there.

ORIGIN = (0.0, 0.0, 0.0)
Z = (0.0, 0.0, 1.0)


@lru_cache
def list_point_rows(dim: int, axes: str = "xyz", **held: str) -> tuple[Row, ...]:
    """Return rows that hold the origin of B along axes of A; `dim` is 2 in the plane, else 3."""
    return tuple(
        Row(Op.POINT, ("xyz".index(a),), a, "m", part=k if held else None, **held)
        for k, a in enumerate(axes[:dim])
    )


@lru_cache
def list_pose_rows(dim: int) -> tuple[Row, ...]:
    """Return rows that hold position and orientation of B in A; `dim` is 2 in the plane, else 3."""
    return (*list_point_rows(dim), ROTATION)


ROTATION, TILT, LOOK = (
    Row(op, (), name, "rad") for op, name in ((Op.ROTATION, "r"), (Op.TILT, "r"), (Op.LOOK, "r"))
)


class Placed(Constraint):
    """Base of constraints with a `target` or an `origin` on frame A, and a `point` of frame B."""

    def make_tool_pose(self, dim: int) -> tuple[float, ...]:
        """Return the pose of the `point` of frame B, without a rotation, as 16 numbers."""
        point = getattr(self, "point", ORIGIN)
        return HERE if point is ORIGIN else make_point_pose(point, dim, f"point of {self.label}")

    def _make_poses_at(self, dim: int, name: str) -> Array:
        """Return poses (..., 4, 4), without a rotation, at the point in the field `name`.

        `dim` is 2 in the plane, else 3.
        """
        return spatial.pose(p=read_points(getattr(self, name), dim, f"{name} of {self.label}"))

    def _make_poses_along(self, dim: int, name: str) -> Array:
        """Return poses (..., 4, 4) at `origin` whose z is along the direction in the field `name`.

        In the plane (`dim` 2) their x is the normal of the plane; in space x is any direction
        across z.
        """
        z = read_directions(getattr(self, name), dim, f"{name} of {self.label}")
        origin: Any = self.origin  # type: ignore[attr-defined]
        points = read_points(origin, dim, f"origin of {self.label}")
        return spatial.pose(make_rotations_along(z, dim), points)


class Measured(Placed, Bounded):
    """Base of constraints on a distance, a height or an angle, at a value or between bounds."""

    measured: ClassVar[str] = "distance"
    instead: ClassVar[str] = ""
    """The field in whose place the bounds are; '' where the number is zero without bounds."""

    def check_fields(self, dim: int) -> None:
        """Refuse bounds that leave no value, and negative distances and angles."""
        value = getattr(self, self.instead) if self.instead else None
        if value is not None:
            read_nonnegative_numbers(value, f"{self.instead} of {self.label}")
        super().check_fields(dim)

    def list_bounded_rows(self, op: Op, *args: Any) -> tuple[Row, ...]:
        """Return the row that holds the measured number between `at_least` and `at_most`.

        `op` is the operation that measures it.
        """
        return (Row(op, args, self.measured, UNITS[self.measured], low="at_least", high="at_most"),)

    def list_distance_rows(self) -> tuple[Row, ...]:
        """Return the row of a distance that equals the field `instead`, or lies between bounds.

        Errors: `InputError`.
        """
        value = getattr(self, self.instead)
        if (value is None) != self.bounded:
            raise InputError(f"{self.label} needs a {self.instead}, or at_least or at_most")
        return (
            Row(Op.DISTANCE, (), "distance", equal=self.instead, low="at_least", high="at_most"),
        )

    def describe_field(self, name: str) -> str:
        """Return the value of a field in words; bounds replace the field where they are given."""
        return (
            self.bounds_text
            if name == self.instead and self.bounded
            else super().describe_field(name)
        )

    @property
    def sentence(self) -> str:
        """The constraint as one plain sentence, with its bounds."""
        said = super().sentence
        if not self.bounded or self.instead:
            return said
        unit = UNITS[self.measured].replace("1", "")
        return f"{said}, off by {self.bounds_text} {unit}".rstrip()


OFF_LINE, TILTED, AWAY, TURNED = (
    parse_tape(text, POSE)
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


# ---- the kinds

# Targets may have leading axes where `System.ik` takes them: they make a batch. `point` is a point
# of the frame, in its axes.


@kind("pose", says="{frame} is at {target}")
class Pose(Placed):
    """A frame at a pose: `target` (..., 4, 4), in planar systems also (..., 3, 3)."""

    frame: Frame
    target: Matrix
    other: Frame | None = field(default=None, kw_only=True)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the position and the orientation of the frame."""
        return list_pose_rows(dim)

    def make_goal_poses(self, dim: int) -> Array:
        """Return the target as poses (..., 4, 4)."""
        return read_poses(self.target, dim, f"target of {self.label}")


@kind("position", says="{frame} is at {target}")
class Position(Measured):
    """Point of a frame at or near a position `target` (..., 3), in planar systems also (..., 2).

    `at_least`, `at_most`: its distance from the target.
    """

    frame: Frame
    target: Point
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the position of the point, or one of its distance from the target."""
        return self.list_bounded_rows(Op.DISTANCE) if self.bounded else list_point_rows(dim)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4), without a rotation, at the target."""
        return self._make_poses_at(dim, "target")


@kind("orientation", says="{frame} is turned as {target}")
class Orientation(Measured):
    """Frame with the orientation `target`, a rotation (..., 3, 3) or a pose (..., 4, 4).

    The position of the frame is free.

    `at_least`, `at_most`: the angle of the rotation between them.
    """

    frame: Frame
    target: Rotation
    other: Frame | None = field(default=None, kw_only=True)

    measured: ClassVar[str] = "angle"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the rotation, or its angle."""
        return self.list_bounded_rows(Op.TAPE, TURNED, 0) if self.bounded else (ROTATION,)

    def make_goal_poses(self, dim: int) -> Array:
        """Return the target as poses (..., 4, 4) at the origin."""
        X = read_numbers(read_pose_array(self.target, what := f"target of {self.label}"), what)
        return read_poses(
            spatial.pose(X) if X.ndim >= 2 and X.shape[-2:] == (3, 3) else X, dim, what
        )


class _Axis(Measured):
    """Base of constraints on an `axis` of a frame."""

    measured: ClassVar[str] = "angle"

    def make_tool_pose(self, dim: int) -> tuple[float, ...]:
        """Return a rotation that turns z of the frame to the axis, as a pose of 16 numbers."""
        return make_axis_pose(self.axis, dim, f"axis of {self.label}")  # type: ignore[attr-defined]


@kind("pointing", says="an axis of {frame} is along {direction}")
class Pointing(_Axis):
    """An `axis` of a frame along a `direction` (..., 3) of the ground, or of `other`.

    The axis is z by default, in the plane x.

    `at_least`, `at_most`: the angle between them, as of a glass that must not spill.
    """

    frame: Frame
    direction: Direction
    axis: Direction = None
    other: Frame | None = field(default=None, kw_only=True)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the direction of the axis, or its angle to the target."""
        return self.list_bounded_rows(Op.TAPE, TILTED, 0) if self.bounded else (TILT,)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at the origin whose z is the direction."""
        return spatial.pose(
            make_rotations_along(
                read_directions(self.direction, dim, f"direction of {self.label}"), dim
            )
        )


@kind("look_at", says="an axis of {frame} points at {target}")
class LookAt(_Axis):
    """Frame whose `axis` points at a position `target` (..., 3), as a camera does.

    The axis is z by default, in the plane x.

    `at_least`, `at_most`: the angle between the axis and the line of sight, as of what must stay in
    view.
    """

    frame: Frame
    target: Point
    axis: Direction = None
    other: Frame | None = field(default=None, kw_only=True)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the direction of the axis, or its angle to the line of sight."""
        return self.list_bounded_rows(Op.TAPE, AWAY, 0) if self.bounded else (LOOK,)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at the target point."""
        return self._make_poses_at(dim, "target")


@kind("on_line", says="{frame} is on a line of {other}")
class OnLine(Measured):
    """A point of a frame on the line through `origin` (..., 3) along `direction` (..., 3).

    `at_least`, `at_most`: its distance from the line, outside or inside a tube.
    """

    frame: Frame
    origin: Point = ORIGIN
    direction: Direction = Z
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the coordinates across the line, or of the distance from the line.

        Across the line there are two coordinates, in the plane one.
        """
        return (
            self.list_bounded_rows(Op.TAPE, OFF_LINE, 0)
            if self.bounded
            else list_point_rows(3, "y" if dim == 2 else "xy")
        )

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at `origin` whose z is along the line."""
        return self._make_poses_along(dim, "direction")


@kind("on_plane", says="{frame} is on a plane of {other}")
class OnPlane(Measured):
    """A point of a frame on the plane through `origin` (..., 3) with the normal `normal` (..., 3).

    `at_least`, `at_most`: its height over the plane, along the normal.
    """

    frame: Frame
    origin: Point = ORIGIN
    normal: Direction = Z
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    measured: ClassVar[str] = "height"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the height of the point over the plane."""
        return self.list_bounded_rows(Op.POINT, 2) if self.bounded else list_point_rows(3, "z")

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at `origin` whose z is the normal of the plane."""
        return self._make_poses_along(dim, "normal")


@kind("half_space", "contact", "{frame} is on one side of a plane of {other}")
class HalfSpace(Placed):
    """A point of a frame at least `margin` (...) metres from a plane, on the side of its `normal`."""

    frame: Frame
    origin: Point = ORIGIN
    normal: Direction = Z
    point: Point = ORIGIN
    margin: Number = 0.0
    other: Frame | None = field(default=None, kw_only=True)

    unbounded: ClassVar[str] = "it is at least 'margin' away; OnPlane has both bounds of its height"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the height of the point over the plane, which is not negative."""
        return (Row(Op.POINT, (2,), "z", low="zero"),)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at a point `margin` over the plane, z along the normal."""
        X = self._make_poses_along(dim, "normal")
        margin = read_numbers(self.margin, f"margin of {self.label}")
        return X @ spatial.pose(p=margin[..., None] * np.array(Z)) if np.any(margin) else X


@kind("on_sphere", says="{frame} is {radius} m away from a point of {other}")
class OnSphere(Measured):
    """Point of a frame on a sphere (in planar systems a circle) of `radius` (...) about `center`.

    `at_least`, `at_most`, in place of the radius: outside or inside a sphere.
    """

    frame: Frame
    center: Point
    radius: Number = None
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    instead: ClassVar[str] = "radius"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the distance from the center."""
        return self.list_distance_rows()

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at the center of the sphere."""
        return self._make_poses_at(dim, "center")


@kind("in_box", "contact", "{frame} is in a box of {other}")
class InBox(Placed):
    """A point of a frame in a box at `pose` (..., 4, 4), between the corners `low` and `high`."""

    frame: Frame
    low: Point
    high: Point
    pose: Matrix = field(default_factory=lambda: np.eye(4))
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    unbounded: ClassVar[str] = "its bounds are the corners 'low' and 'high'"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for each direction of the box."""
        return list_point_rows(dim, low="low_corner", high="high_corner")

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) of the box."""
        return read_poses(self.pose, dim, f"pose of {self.label}")

    def check_fields(self, dim: int) -> None:
        """Refuse corners without space between them, and boxes off the plane or flat in space."""
        if dim == self._given_dim:
            self._corners  # noqa: B018
        else:
            self._read_corners(dim)

    @property
    def _given_dim(self) -> int:
        """Number of coordinates of the given corners: 2 or 3."""
        return 2 if (2,) in (np.shape(self.low)[-1:], np.shape(self.high)[-1:]) else 3

    @cached_property
    def _corners(self) -> tuple[Array, Array]:
        """The lower and the upper corner (..., 2) or (..., 3)."""
        return self._read_corners(self._given_dim)

    def _read_corners(self, dim: int) -> tuple[Array, Array]:
        """Read both corners, as arrays of one shape. Errors: `InputError`."""
        what = f"corners of {self.label}"
        return read_bounds(*read_corners(self.low, self.high, dim, what), what)

    @property
    def low_corner(self) -> Array:
        """Lower corner (..., 3) of the box in metres."""
        return self._corners[0]

    @property
    def high_corner(self) -> Array:
        """Upper corner (..., 3) of the box in metres."""
        return self._corners[1]


@kind("relative_pose", says="{frame} is at {target}, seen from {other}")
class RelativePose(Placed):
    """A frame at a pose `target` (..., 4, 4) seen from the frame `other`."""

    frame: Frame
    other: Frame
    target: Matrix

    list_rows = Pose.list_rows
    make_goal_poses = Pose.make_goal_poses


@kind("relative_position", says="{frame} is at {target}, seen from {other}")
class RelativePosition(Measured):
    """Point of a frame at or near a position `target` (..., 3) in the axes of the frame `other`."""

    frame: Frame
    other: Frame
    target: Point
    point: Point = ORIGIN

    list_rows = Position.list_rows
    make_goal_poses = Position.make_goal_poses


@kind("distance", says="{frame} and {other} are {value} m apart")
class Distance(Measured):
    """Distance between two points of two frames: `value` (...) [m], or within bounds.

    The points are `point` and `other_point`.

    A rod with a ball at each end has a `value`, a rope only `at_most`.
    """

    frame: Frame
    other: Frame
    value: Number = None
    point: Point = ORIGIN
    other_point: Point = ORIGIN

    instead: ClassVar[str] = "value"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the distance."""
        return self.list_distance_rows()

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) of the point of the other frame on that frame."""
        return EYE if self.other_point is ORIGIN else self._make_poses_at(dim, "other_point")


@kind("on_surface", says="{frame} is on {surface} of {other}")
class OnSurface(Measured):
    """Point of a frame on a surface f(x, y, z) = 0, in planar systems on a curve f(x, y) = 0.

    `at_least`, `at_most`: the value of f, as of what is outside or inside.

    `surface` is text such as ``"x^2/4 + y^2 = 1"``, in metres along the axes of the ground or of
    `other`.
    """

    frame: Frame
    surface: str
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    measured: ClassVar[str] = "value"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return the equation of the surface."""
        tape = self._make_tape(dim)
        return (
            self.list_bounded_rows(Op.TAPE, tape, 0)
            if self.bounded
            else (Row(Op.TAPE, (tape, 0), "surface", "1"),)
        )

    def _make_tape(self, dim: int) -> Tape:
        """Return the tape of the equation of the surface."""
        return parse_tape([self.surface], tuple("xyz"[:dim]), {})
