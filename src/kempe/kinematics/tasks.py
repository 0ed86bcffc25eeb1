"""The task zoo: what a configuration can be asked for. ``from kempe import tasks``, and `System.ik` takes any of them.

Each class holds one frame, two frames, a centre or coordinates; see `Task` for `weight`, `priority`, `tolerance` and
`name`, which all take. Goals may have leading axes: they make a batch. Lengths are in metres, angles in radians, goals
in the ground frame. `point` is a point of the frame, in its axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.calls import explained_making
from kempe.errors import InputError
from kempe.kernels import loop_layout as L
from kempe.kinematics.task import HERE, Hold, Placed, Task, along, numbers_of, poses_of
from kempe.kinematics.task_between import Between, pair
from kempe.kinematics.task_input import at_point, corners_of, directions_of, points_of, tilt_of, with_axis
from kempe.kinematics.tasks_whole import CentreOfMass, CentreOfPoints, Function, Posture
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

__all__ = [
    "CentreOfMass", "CentreOfPoints", "Distance", "Function", "HalfSpace", "InBox", "LookAt", "OnLine", "OnPlane",
    "OnSphere", "Orientation", "Pointing", "Pose", "Position", "Posture", "RelativePose", "RelativePosition", "Task",
]  # fmt: skip

_EYE = np.eye(4)
ORIGIN, Z = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def _mask(dim: int) -> int:
    """All directions."""
    return 3 if dim == 2 else 7


def _turns(dim: int) -> int:
    """The whole orientation."""
    return L.ANGLE if dim == 2 else L.FULL


def _size(p: Array) -> Array:
    return np.sqrt(np.vecdot(p, p))


def _between(R: Array, S: Array) -> Array:
    """Angle (...) between two rotations, by how far their entries are apart: sqrt(8) times the sine of its half."""
    d = R - S
    d = d.reshape(*d.shape[:-2], 9)
    return 2.0 * np.arcsin(np.minimum(np.sqrt(np.vecdot(d, d) / 8.0), 1.0))


def _none(X: Array) -> Array:
    return np.zeros(X.shape[:-2])


@dataclass(frozen=True, eq=False)
class _OneFrame(Placed):
    """A task on one frame."""

    frame: str

    @property
    def about(self) -> str:
        """The frame."""
        return repr(str(self.frame))

    def _hold(self, system: System, mask: int, turns: int = L.NO_TURN, point: Any = ORIGIN, **more: Any) -> Hold:
        X = HERE if point is ORIGIN else at_point(point, system.dim, f"point of {self.label}")
        return Hold(system.frame_name(self.frame), X, mask, turns, **more)

    def _hold_axis(self, system: System, turns: int, axis: Any) -> Hold:
        X = with_axis(axis, system.dim, f"axis of {self.label}")
        return Hold(system.frame_name(self.frame), X, 0, turns)


@dataclass(frozen=True, eq=False)
class Pose(_OneFrame):
    """A frame at a pose: `target` (..., 4, 4), in planar systems also (..., 3, 3)."""

    target: Any
    angles = True

    def hold(self, system: System) -> Hold:
        """All of the frame."""
        return self._hold(system, _mask(system.dim), _turns(system.dim))

    def goal(self, system: System) -> Array:
        """The target."""
        return poses_of(self.target, system.dim, f"target of {self.label}")

    def miss(self, X: Array) -> tuple[Array, Array]:
        """Distance and angle."""
        return self.apart(_EYE, X)

    def apart(self, goal: Array, X: Array) -> tuple[Array, Array]:
        """Distance and angle."""
        return _size(X[..., :3, 3] - goal[..., :3, 3]), _between(X[..., :3, :3], goal[..., :3, :3])


@dataclass(frozen=True, eq=False)
class Position(_OneFrame):
    """A point of a frame at a position `target` (..., 3), in planar systems also (..., 2)."""

    target: Any
    point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """The point."""
        return self._hold(system, _mask(system.dim), point=self.point)

    def goal(self, system: System) -> Array:
        """The target."""
        return spatial.pose(p=points_of(self.target, system.dim, f"target of {self.label}"))

    def miss(self, X: Array) -> tuple[Array, Array]:
        """Distance."""
        return _size(X[..., :3, 3]), _none(X)


@dataclass(frozen=True, eq=False)
class Orientation(_OneFrame):
    """A frame turned as `target` (..., 3, 3), or as a pose (..., 4, 4), wherever it is."""

    target: Any
    lengths, angles = False, True

    def hold(self, system: System) -> Hold:
        """The rotation."""
        return self._hold(system, 0, _turns(system.dim))

    def goal(self, system: System) -> Array:
        """The target."""
        X = numbers_of(self.target, what := f"target of {self.label}")
        return poses_of(spatial.pose(X) if X.ndim >= 2 and X.shape[-2:] == (3, 3) else X, system.dim, what)

    def miss(self, X: Array) -> tuple[Array, Array]:
        """Angle."""
        return _none(X), _between(X[..., :3, :3], _EYE[:3, :3])


@dataclass(frozen=True, eq=False)
class Pointing(_OneFrame):
    """An `axis` of a frame (default z, in the plane x) along a `direction` (..., 3) of the ground."""

    direction: Any
    axis: Any = None
    lengths, angles = False, True

    def hold(self, system: System) -> Hold:
        """The axis."""
        return self._hold_axis(system, L.ALIGN, self.axis)

    def goal(self, system: System) -> Array:
        """A frame whose z is the direction."""
        z = directions_of(self.direction, system.dim, f"direction of {self.label}")
        return spatial.pose(along(z, system.dim))

    def miss(self, X: Array) -> tuple[Array, Array]:
        """Angle between the two."""
        return _none(X), tilt_of(X[..., :3, 2])


@dataclass(frozen=True, eq=False)
class LookAt(_OneFrame):
    """An `axis` of a frame (default z, in the plane x) towards a point `target` (..., 3), as a camera looks at it."""

    target: Any
    axis: Any = None
    lengths, angles = False, True

    def hold(self, system: System) -> Hold:
        """The axis."""
        return self._hold_axis(system, L.LOOK, self.axis)

    def goal(self, system: System) -> Array:
        """The point."""
        return spatial.pose(p=points_of(self.target, system.dim, f"target of {self.label}"))

    def miss(self, X: Array) -> tuple[Array, Array]:
        """Angle between the axis and the direction to the point; pi where that is the frame's origin."""
        d = np.einsum("...ji,...j->...i", X[..., :3, :3], -X[..., :3, 3])
        return _none(X), tilt_of(d)


@dataclass(frozen=True, eq=False)
class OnLine(_OneFrame):
    """A point of a frame on the line through `origin` (..., 3) along `direction` (..., 3)."""

    origin: Any
    direction: Any
    point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """What is across the line; in the plane only within it."""
        return self._hold(system, 2 if system.dim == 2 else 3, point=self.point)

    def goal(self, system: System) -> Array:
        """A frame on the line, z along it."""
        z = directions_of(self.direction, system.dim, f"direction of {self.label}")
        return spatial.pose(along(z, system.dim), points_of(self.origin, system.dim, f"origin of {self.label}"))

    def miss(self, X: Array) -> tuple[Array, Array]:
        """Distance from the line."""
        return np.hypot(X[..., 0, 3], X[..., 1, 3]), _none(X)


@dataclass(frozen=True, eq=False)
class OnPlane(Between, _OneFrame):
    """A point of a frame on the plane through `origin` (..., 3) with the normal `normal` (..., 3)."""

    origin: Any
    normal: Any
    point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """What is along the normal."""
        return self._hold(system, 4, point=self.point)

    def goal(self, system: System) -> Array:
        """A frame on the plane, z along the normal."""
        z = directions_of(self.normal, system.dim, f"normal of {self.label}")
        return spatial.pose(along(z, system.dim), points_of(self.origin, system.dim, f"origin of {self.label}"))

    def values(self, X: Array) -> Array:
        """What is along the normal."""
        return X[..., 2:3, 3]


@dataclass(frozen=True, eq=False)
class HalfSpace(OnPlane):
    """A point of a frame on that side of a plane to which its `normal` points, at least `margin` (...) m from it."""

    margin: Any = 0.0

    def goal(self, system: System) -> Array:
        """A frame that far from the plane, z along the normal."""
        X, margin = super().goal(system), numbers_of(self.margin, f"margin of {self.label}")
        return X @ spatial.pose(p=margin[..., None] * np.array(Z)) if np.any(margin) else X

    def ends(self, system: System) -> tuple[Array, Array]:
        """Above the plane."""
        return np.zeros(1), np.full(1, math.inf)


@dataclass(frozen=True, eq=False)
class OnSphere(Between, _OneFrame):
    """A point of a frame at the distance `radius` (...) from `center` (..., 3): on a sphere, in the plane a circle."""

    center: Any
    radius: Any
    point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """The distance."""
        return self._hold(system, 0, L.DISTANCE, point=self.point, given=True)

    def goal(self, system: System) -> Array:
        """The center."""
        return spatial.pose(p=points_of(self.center, system.dim, f"center of {self.label}"))

    @property
    def number(self) -> Array:
        """The radius."""
        return _positive(self.radius, f"radius of {self.label}")

    def values(self, X: Array) -> Array:
        """The distance."""
        return _size(X[..., :3, 3])[..., None]


@dataclass(frozen=True, eq=False)
class InBox(Between, _OneFrame):
    """A point of a frame between the corners `low` and `high` (..., 3) of a box that is at `pose` (..., 4, 4)."""

    low: Any
    high: Any
    pose: Any = field(default_factory=lambda: np.eye(4))
    point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """All directions."""
        return self._hold(system, _mask(system.dim), point=self.point)

    def goal(self, system: System) -> Array:
        """The box's frame."""
        return poses_of(self.pose, system.dim, f"pose of {self.label}")

    def values(self, X: Array) -> Array:
        """Where the point is in the box's frame; in the plane, within it."""
        return X[..., : 2 if np.shape(self.low)[-1] == 2 else 3, 3]

    def ends(self, system: System) -> tuple[Array, Array]:
        """The corners."""
        what = f"corners of {self.label}"
        return pair(*corners_of(self.low, self.high, system.dim, what), what)

    def from_end(self, system: System, goal: Array, end: Array) -> tuple[Array, Array | None]:
        """The box's frame at a corner."""
        return goal @ spatial.pose(p=points_of(end, system.dim, f"corner of {self.label}")), None


def _positive(x: Any, what: str) -> Array:
    value = numbers_of(x, what)
    if np.any(value < 0.0):
        raise InputError(f"{what} is {x!r}; it must not be negative")
    return value


@dataclass(frozen=True, eq=False)
class _TwoFrames(_OneFrame):
    """A task on a frame and an `other` one."""

    other: str

    @property
    def about(self) -> str:
        """Both frames."""
        return f"{str(self.frame)!r} and {str(self.other)!r}"


@dataclass(frozen=True, eq=False)
class RelativePose(_TwoFrames):
    """A frame at a pose `target` (..., 4, 4) seen from the frame `other`."""

    target: Any
    angles = True

    def hold(self, system: System) -> Hold:
        """All of the frame."""
        return self._hold(system, _mask(system.dim), _turns(system.dim), a=system.frame_name(self.other))

    goal, miss, apart = Pose.goal, Pose.miss, Pose.apart


@dataclass(frozen=True, eq=False)
class RelativePosition(_TwoFrames):
    """A point of a frame at a position `target` (..., 3) seen from the frame `other`, in its axes."""

    target: Any
    point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """The point."""
        return self._hold(system, _mask(system.dim), point=self.point, a=system.frame_name(self.other))

    goal, miss = Position.goal, Position.miss


@dataclass(frozen=True, eq=False)
class Distance(Between, _TwoFrames):
    """The distance of a `point` of a frame from `other_point` of another: `value` (...), or between bounds (...)."""

    value: Any = None
    at_least: Any = None
    at_most: Any = None
    point: Any = ORIGIN
    other_point: Any = ORIGIN

    def hold(self, system: System) -> Hold:
        """The distance."""
        return self._hold(system, 0, L.DISTANCE, point=self.point, a=system.frame_name(self.other), given=True)

    def ends(self, system: System) -> tuple[Array, Array] | None:
        """The bounds, if any."""
        if (self.value is None) == (self.at_least is None and self.at_most is None):
            raise InputError(f"{self.label} needs a value, or at_least or at_most")
        if self.value is not None:
            return None
        low, high = (default if x is None else _positive(x, f"a bound of {self.label}")
                     for x, default in ((self.at_least, 0.0), (self.at_most, math.inf)))  # fmt: skip
        low, high = pair(low, high, f"at_least and at_most of {self.label}")
        return low[..., None], high[..., None]

    def from_end(self, system: System, goal: Array, end: Array) -> tuple[Array, Array]:
        """The point, and the bound."""
        return goal, end[..., 0]

    def goal(self, system: System) -> Array:
        """The point of the other frame."""
        return spatial.pose(p=points_of(self.other_point, system.dim, f"other_point of {self.label}"))

    @property
    def number(self) -> Array:
        """The distance, or what bounds are measured from."""
        return np.zeros(()) if self.value is None else _positive(self.value, f"value of {self.label}")

    def values(self, X: Array) -> Array:
        """The distance."""
        return _size(X[..., :3, 3])[..., None]


for _name in __all__:
    explained_making(globals()[_name])
