"""Tasks with two numbers, of which a picture can be drawn: two coordinates of a frame's place, or
its direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kempe.arguments import check_name
from kempe.constraints.base import Constraint
from kempe.constraints.kinds import OnLine, Pointing, Position
from kempe.errors import UnsupportedError
from kempe.spatial import Array

PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}
"""Axes of the ground that are drawn, and the one along which is looked."""
DIRECTION = "direction"


@dataclass(frozen=True)
class FlatTask:
    """Two numbers that say where a frame is: two coordinates of its place [m], or the direction of
    its z axis.

    `name` is "xy", "xz", "yz" or "direction"; a direction is seen as its azimuth about z and its
    elevation above the xy-plane [rad].
    """

    name: str
    dim: int

    @property
    def directional(self) -> bool:
        """Whether it is a direction."""
        return self.name == DIRECTION

    @property
    def axes(self) -> list[int]:
        """The two axes of the ground along which places are seen; none of a direction."""
        return [] if self.directional else list(PLANES[self.name][:2])

    @property
    def labels(self) -> tuple[str, str]:
        """What the two numbers are, with units."""
        if self.directional:
            return "azimuth [rad]", "elevation [rad]"
        return f"{self.name[0]} [m]", f"{self.name[1]} [m]"

    def describe_task(self, frame: str) -> str:
        """What is seen of a frame."""
        if self.directional:
            return f"direction of z of {frame!r}"
        along = "" if self.dim == 2 else f" along {' and '.join(self.name)}"
        return f"position of {frame!r}{along}"

    def project_poses(self, X: Array) -> Array:
        """The two numbers (..., 2) at poses (..., 4, 4)."""
        if not self.directional:
            return X[..., self.axes, 3]
        z = X[..., :3, 2]
        return np.stack(
            [np.arctan2(z[..., 1], z[..., 0]), np.arcsin(np.clip(z[..., 2], -1.0, 1.0))], axis=-1
        )

    def make_constraint(self, frame: str, p: Array) -> Constraint:
        """What is requested where the numbers shall be p (..., 2)."""
        if self.directional:
            return Pointing(frame, _compute_directions(p))
        if self.dim == 2:
            return Position(frame, p)
        i, j, along = PLANES[self.name]
        at = np.zeros((*p.shape[:-1], 3))
        at[..., i] = p[..., 0]
        at[..., j] = p[..., 1]
        return OnLine(frame, at, np.eye(3)[along])

    def compute_area(self, X: Array, J: Array) -> Array:
        """Area (...) that the rates of two coordinates span in the task, with its sign, of
        Jacobians (..., 6, 2).
        """
        if not self.directional:
            return np.asarray(np.linalg.det(J[..., self.axes, :]))
        return np.einsum("...i,...i", X[..., :3, 2], np.cross(J[..., 3:, 0], J[..., 3:, 1]))

    def compute_distance(self, p: Array, other: Array) -> Array:
        """How far (...) two of them (..., 2) are apart, in metres, or as an angle."""
        if not self.directional:
            return np.asarray(np.linalg.norm(other - p, axis=-1))
        a = _compute_directions(p)
        b = _compute_directions(other)
        return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def find_flat_task(name: object, dim: int) -> FlatTask:
    """The task by its name, None: "xy". Errors: `InputError`, `UnsupportedError`."""
    task = "xy" if name is None else check_name("task", name, (*PLANES, DIRECTION))
    if dim == 2 and task != "xy":
        raise UnsupportedError(f"task is {task!r}; of a planar system 'xy' is drawn")
    return FlatTask(task, dim)


def _compute_directions(p: Array) -> Array:
    """Unit vectors (..., 3) of azimuths and elevations (..., 2)."""
    level = np.cos(p[..., 1])
    return np.stack(
        [level * np.cos(p[..., 0]), level * np.sin(p[..., 0]), np.sin(p[..., 1])], axis=-1
    )
