"""Tasks with two numbers, which can be plotted: two coordinates of a frame, or its direction."""

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
    """A task of two numbers: two coordinates of a frame's origin in m, or its z axis as angles.

    `name` is "xy", "xz", "yz" or "direction"; a direction is seen as its azimuth about z and its
    elevation above the xy-plane [rad].
    """

    name: str
    dim: int

    @property
    def directional(self) -> bool:
        """Whether the task is a direction."""
        return self.name == DIRECTION

    @property
    def axes(self) -> list[int]:
        """Numbers of the two axes of the ground that are the coordinates; [] for a direction."""
        return [] if self.directional else list(PLANES[self.name][:2])

    @property
    def labels(self) -> tuple[str, str]:
        """Names of the two numbers, with units."""
        if self.directional:
            return "azimuth [rad]", "elevation [rad]"
        return f"{self.name[0]} [m]", f"{self.name[1]} [m]"

    def describe_task(self, frame: str) -> str:
        """Return words for the two numbers of a frame."""
        if self.directional:
            return f"direction of z of {frame!r}"
        along = "" if self.dim == 2 else f" along {' and '.join(self.name)}"
        return f"position of {frame!r}{along}"

    def project_poses(self, X: Array) -> Array:
        """Return the two numbers (..., 2) at poses (..., 4, 4)."""
        if not self.directional:
            return X[..., self.axes, 3]
        z = X[..., :3, 2]
        return np.stack(
            [np.arctan2(z[..., 1], z[..., 0]), np.arcsin(np.clip(z[..., 2], -1.0, 1.0))], axis=-1
        )

    def make_constraint(self, frame: str, p: Array) -> Constraint:
        """Return the constraint that holds the two numbers of a frame at p (..., 2)."""
        if self.directional:
            return Pointing(frame, _compute_directions(p))
        if self.dim == 2:
            return Position(frame, p)
        i, j, along = PLANES[self.name]
        at = np.zeros((*p.shape[:-1], 3))
        at[..., i] = p[..., 0]
        at[..., j] = p[..., 1]
        return OnLine(frame, at, np.eye(3)[along])

    def compute_distance(self, p: Array, other: Array) -> Array:
        """Compute the distance (...) of two values (..., 2) of the task, in metres or radians."""
        if not self.directional:
            return np.asarray(np.linalg.norm(other - p, axis=-1))
        a = _compute_directions(p)
        b = _compute_directions(other)
        return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def find_flat_task(name: object, dim: int) -> FlatTask:
    """Return the task by its name; None is "xy". Errors: `InputError`, `UnsupportedError`."""
    task = "xy" if name is None else check_name("task", name, (*PLANES, DIRECTION))
    if dim == 2 and task != "xy":
        raise UnsupportedError(f"task is {task!r}; of a planar system 'xy' is drawn")
    return FlatTask(task, dim)


def _compute_directions(p: Array) -> Array:
    """Return unit vectors (..., 3) of azimuths and elevations (..., 2)."""
    level = np.cos(p[..., 1])
    return np.stack(
        [level * np.cos(p[..., 0]), level * np.sin(p[..., 0]), np.sin(p[..., 1])], axis=-1
    )
