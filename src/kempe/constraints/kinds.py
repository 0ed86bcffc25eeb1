"""Kinds of constraints on a frame, or on a point or axis of it, in metres and radians.

A frame is held against the ground, or against the frame `other`, in whose axes targets are then
read.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import field, replace
from fractions import Fraction
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
from kempe.constraints.builder import scale_inputs
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
    """Demand that a frame is at a pose.

    Parameters
    ----------
    frame
        Name of the frame or body.
    target
        Pose (..., 4, 4), in the plane also (..., 3, 3), or a pose in another form that `ik` reads.
    other
        Frame in whose axes the target is read (default: the ground).

    See Also
    --------
    Position, Orientation : one part of a pose.

    Examples
    --------
    >>> import numpy as np
    >>> import kempe
    >>> from kempe.tasks import Pose
    >>> robot = kempe.load("puma560")
    >>> X = robot.fk(robot.mid, "tool")
    >>> answer = robot.ik(Pose("tool", X))
    >>> np.allclose(robot.fk(answer.q, "tool"), X, atol=1e-5)
    True
    """

    frame: Frame
    target: Matrix
    other: Frame | None = field(default=None, kw_only=True)

    goals: ClassVar[tuple[str, ...]] = ("target",)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the position and the orientation of the frame."""
        return list_pose_rows(dim)

    def make_goal_poses(self, dim: int) -> Array:
        """Return the target as poses (..., 4, 4)."""
        return read_poses(self.target, dim, f"target of {self.label}")


@kind("position", says="{frame} is at {target}")
class Position(Measured):
    """Demand that a point of a frame is at a position, or near it.

    Parameters
    ----------
    frame
        Name of the frame or body.
    target
        Position (..., 3) in metres, in the plane also (..., 2).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the target is read (default: the ground).
    at_least, at_most
        Bounds of the distance from the target in metres, in place of 0 (default: none).

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import Position
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(Position("tool", (0.4, 0.2, 0.3)))
    >>> robot.fk(answer.q, "tool")[:3, 3].round(5)
    array([0.4, 0.2, 0.3])
    """

    frame: Frame
    target: Point
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    goals: ClassVar[tuple[str, ...]] = ("target",)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the position of the point, or one of its distance from the target."""
        return self.list_bounded_rows(Op.DISTANCE) if self.bounded else list_point_rows(dim)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4), without a rotation, at the target."""
        return self._make_poses_at(dim, "target")


@kind("orientation", says="{frame} is turned as {target}")
class Orientation(Measured):
    """Demand that a frame has an orientation; its position is free.

    Parameters
    ----------
    frame
        Name of the frame or body.
    target
        Rotation (..., 3, 3), or a pose (..., 4, 4) of which the rotation counts.
    other
        Frame in whose axes the target is read (default: the ground).
    at_least, at_most
        Bounds of the angle between frame and target in radians, in place of 0 (default: none).

    Examples
    --------
    >>> import numpy as np
    >>> import kempe
    >>> from kempe.tasks import Orientation
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(Orientation("tool", np.eye(3)))
    >>> np.allclose(robot.fk(answer.q, "tool")[:3, :3], np.eye(3), atol=1e-5)
    True
    """

    frame: Frame
    target: Rotation
    other: Frame | None = field(default=None, kw_only=True)

    measured: ClassVar[str] = "angle"
    goals: ClassVar[tuple[str, ...]] = ("target",)

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
    """Demand that an axis of a frame has a direction.

    Parameters
    ----------
    frame
        Name of the frame or body.
    direction
        Direction (..., 3) of any length, in the plane also (..., 2), or a name: "x", "-z".
    axis
        Axis of the frame, in its axes (default: z, in the plane x).
    other
        Frame in whose axes the direction is read (default: the ground).
    at_least, at_most
        Bounds of the angle between axis and direction in radians, in place of 0 (default: none).

    Notes
    -----
    A glass that must not spill has `at_most`.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import Pointing
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(Pointing("tool", "-z"))
    >>> (robot.fk(answer.q, "tool")[:3, 2].round(5) + 0.0)
    array([ 0.,  0., -1.])
    """

    frame: Frame
    direction: Direction
    axis: Direction = None
    other: Frame | None = field(default=None, kw_only=True)

    goals: ClassVar[tuple[str, ...]] = ("direction",)

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
    """Demand that an axis of a frame points at a position, as a camera does.

    Parameters
    ----------
    frame
        Name of the frame or body.
    target
        Position (..., 3) in metres, in the plane also (..., 2).
    axis
        Axis of the frame, in its axes (default: z, in the plane x).
    other
        Frame in whose axes the target is read (default: the ground).
    at_least, at_most
        Bounds of the angle between axis and line of sight in radians, in place of 0 (default: none).

    Notes
    -----
    The line of sight goes from the origin of the frame to the target.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import LookAt
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(LookAt("tool", (1, 0, 0), at_most=0.1))
    >>> bool(answer.success)
    True
    """

    frame: Frame
    target: Point
    axis: Direction = None
    other: Frame | None = field(default=None, kw_only=True)

    goals: ClassVar[tuple[str, ...]] = ("target",)

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the direction of the axis, or its angle to the line of sight."""
        return self.list_bounded_rows(Op.TAPE, AWAY, 0) if self.bounded else (LOOK,)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at the target point."""
        return self._make_poses_at(dim, "target")


@kind("on_line", says="{frame} is on a line of {other}")
class OnLine(Measured):
    """Demand that a point of a frame is on a line, or near it.

    Parameters
    ----------
    frame
        Name of the frame or body.
    origin
        Point of the line (..., 3) in metres, in the plane also (..., 2) (default: the origin).
    direction
        Direction of the line (..., 3), or its name (default: z).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the line is read (default: the ground).
    at_least, at_most
        Bounds of the distance from the line in metres, in place of 0 (default: none).

    Notes
    -----
    Along the line and about it the frame is free.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import OnLine
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(OnLine("tool", (0.4, 0, 0), "z"))
    >>> robot.fk(answer.q, "tool")[:2, 3].round(5) + 0.0
    array([0.4, 0. ])
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
    """Demand that a point of a frame is on a plane, or at a height over it.

    Parameters
    ----------
    frame
        Name of the frame or body.
    origin
        Point of the plane (..., 3) in metres, in the plane also (..., 2) (default: the origin).
    normal
        Normal of the plane (..., 3), or its name (default: z).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the plane is read (default: the ground).
    at_least, at_most
        Bounds of the height along the normal in metres, which may be negative, in place of 0 (default: none).

    See Also
    --------
    HalfSpace : one side of a plane.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import OnPlane
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(OnPlane("tool", (0, 0, 0.3)))
    >>> round(float(robot.fk(answer.q, "tool")[2, 3]), 5)
    0.3
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
    """Demand that a point of a frame stays on one side of a plane.

    Parameters
    ----------
    frame
        Name of the frame or body.
    origin
        Point of the plane (..., 3) in metres, in the plane also (..., 2) (default: the origin).
    normal
        Normal (..., 3) on the allowed side, or its name (default: z).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    margin
        Least height (...) over the plane in metres (default: 0).
    other
        Frame in whose axes the plane is read (default: the ground).

    See Also
    --------
    OnPlane : both bounds of the height.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import HalfSpace
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(HalfSpace("tool", margin=0.1))
    >>> bool(robot.fk(answer.q, "tool")[2, 3] >= 0.1)
    True
    """

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
    """Demand that a point of a frame has a distance from a centre; in the plane, is on a circle.

    Parameters
    ----------
    frame
        Name of the frame or body.
    center
        Centre (..., 3) in metres, in the plane also (..., 2).
    radius
        Radius (...) in metres (default: none, for bounds).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the centre is read (default: the ground).
    at_least, at_most
        Bounds of the distance in metres, in place of the radius: outside or inside a sphere (default: none).

    Raises
    ------
    InputError
        If there is neither a radius nor a bound, or both.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import OnSphere
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(OnSphere("tool", (0, 0, 0.5), radius=0.5))
    >>> bool(answer.success)
    True
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
    """Demand that a point of a frame is in a box.

    Parameters
    ----------
    frame
        Name of the frame or body.
    low, high
        Opposite corners (..., 3) in metres, in the plane also (..., 2), in the axes of the box.
    pose
        Pose (..., 4, 4) of the box (default: the identity).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the pose of the box is read (default: the ground).

    Raises
    ------
    InputError
        If a corner `low` is above `high`.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import InBox
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(InBox("tool", (0.2, 0.2, 0.2), (0.4, 0.4, 0.4)))
    >>> bool(answer.success)
    True
    """

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
        corners: tuple[Any, Any] = (self.low, self.high)
        return 2 if any(np.shape(x)[-1:] == (2,) for x in corners) else 3

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
    """Demand that a frame is at a pose seen from another frame.

    Parameters
    ----------
    frame
        Name of the frame or body.
    other
        Frame in whose axes the target is read.
    target
        Pose (..., 4, 4), in the plane also (..., 3, 3).

    See Also
    --------
    Pose : the same with an optional `other`.
    """

    frame: Frame
    other: Frame
    target: Matrix

    goals = Pose.goals
    list_rows = Pose.list_rows
    make_goal_poses = Pose.make_goal_poses


@kind("relative_position", says="{frame} is at {target}, seen from {other}")
class RelativePosition(Measured):
    """Demand that a point of a frame is at a position seen from another frame, or near it.

    Parameters
    ----------
    frame
        Name of the frame or body.
    other
        Frame in whose axes the target is read.
    target
        Position (..., 3) in metres, in the plane also (..., 2).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    at_least, at_most
        Bounds of the distance from the target in metres, in place of 0 (default: none).

    See Also
    --------
    Position : the same with an optional `other`.
    """

    frame: Frame
    other: Frame
    target: Point
    point: Point = ORIGIN

    goals = Position.goals
    list_rows = Position.list_rows
    make_goal_poses = Position.make_goal_poses


@kind("distance", says="{frame} and {other} are {value} m apart")
class Distance(Measured):
    """Demand a distance between points of two frames, or bounds of it.

    Parameters
    ----------
    frame
        Name of the frame or body.
    other
        Name of the other frame or body.
    value
        Distance (...) in metres, above 0 in a mechanism (default: none, for bounds).
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other_point
        Point of the other frame, in its axes in metres (default: its origin).
    at_least, at_most
        Bounds of the distance in metres, in place of `value` (default: none).

    Raises
    ------
    InputError
        If there is neither a value nor a bound, or both.

    Notes
    -----
    A rod with a ball joint at each end has a `value`, a rope only `at_most`.

    Examples
    --------
    >>> from kempe import Mechanism
    >>> from kempe.constraints import Distance
    >>> m = Mechanism("pendulum")
    >>> _ = m.free("x", m.ground, m.particle("bob"))
    >>> print(m.constrain(Distance("bob", "ground", 0.3), name="rod").sentence)
    rod: bob and ground are 0.3 m apart
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
    """Demand that a point of a frame is on a surface, in the plane on a curve.

    Parameters
    ----------
    frame
        Name of the frame or body.
    surface
        Equation in x, y and z (in the plane x and y) in metres as text: ``"x^2/4 + y^2 = 1"``.
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the surface is read (default: the ground).
    at_least, at_most
        Bounds of the value of the left side less the right side, in place of 0 (default: none).

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import OnSurface
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(OnSurface("tool", "x^2 + y^2 = 0.16"))
    >>> x, y = robot.fk(answer.q, "tool")[:2, 3]
    >>> round(float(x**2 + y**2), 5)
    0.16
    """

    frame: Frame
    surface: str
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    measured: ClassVar[str] = "value"

    def scale_lengths(self, factor: Fraction, slides: Collection[str]) -> Constraint:
        """Return the constraint with its lengths in another unit; values of the equation stay."""
        tape = scale_inputs(self._make_tape(3), "xyz", factor)
        scaled = super().scale_lengths(factor, slides)
        return replace(scaled, surface=tape.format_outputs()[0])  # type: ignore[call-arg]

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
