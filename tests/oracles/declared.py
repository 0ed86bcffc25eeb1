"""Declared constraints of a description, in numpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kempe import System
from kempe.constraints.base import list_position_rows
from kempe.description.parts import Declared
from kempe.model.implicit_form import turn_flat_frame
from kempe.spatial import Array
from oracles.frames import Pair

Rows = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Distance(Pair):
    """The origins of two frames are `length` metres apart: a rod with a ball joint at each end."""

    length: float

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("distance",)

    def rows(self, X: Array) -> Rows:
        """Distance less length."""
        p = X[..., :3, 3]
        d = np.linalg.norm(p, axis=-1, keepdims=True)
        along = p / np.where(d > 0.0, d, 1.0)
        return d - self.length, np.concatenate([along, np.zeros_like(along)], axis=-1)[..., None, :]


@dataclass(frozen=True, eq=False)
class PointOnLine(Pair):
    """The origin of B is on the z axis of A; in planar systems z lies in the plane."""

    planar: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Two rows, in the plane one."""
        return ("y",) if self.planar else ("x", "y")

    def rows(self, X: Array) -> Rows:
        """Distances along x and y of A; in the plane along the normal of the line."""
        value, rates = _slides(X, "xy")
        if not self.planar:
            return value, rates
        across = turn_flat_frame(self.X_A)[:3, 1] @ self.X_A[:3, :3]  # in axes of A
        return X[..., :3, 3] @ across[:, None], np.broadcast_to(
            np.r_[across, 0.0, 0.0, 0.0], (*X.shape[:-2], 1, 6)
        )


@dataclass(frozen=True, eq=False)
class PointOnPlane(Pair):
    """The origin of B is in the xy-plane of A."""

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("z",)

    def rows(self, X: Array) -> Rows:
        """Height over the plane."""
        return _slides(X, "z")


def _slides(X: Array, axes: str) -> Rows:
    """Positions of M along some axes of F."""
    index = ["xyz".index(a) for a in axes]
    rates = np.zeros((*X.shape[:-2], len(index), 6))
    rates[..., np.arange(len(index)), index] = 1.0
    return X[..., index, 3], rates


def declared(system: System, constraint: Declared) -> Pair:
    """The constraint of a record of the description."""
    X_A, X_B = constraint.frames(system.structure.parameters, system.dim)
    ends: Any = {"X_A": X_A, "X_B": X_B}
    names = constraint.name, constraint.parent, constraint.child
    if constraint.rod:
        return Distance(*names, constraint.length(system.structure.parameters), **ends)
    if len(list_position_rows(constraint.of, 3)) == 2:
        return PointOnLine(*names, system.dim == 2, **ends)
    return PointOnPlane(*names, **ends)
