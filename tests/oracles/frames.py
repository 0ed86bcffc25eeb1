"""A constraint between two frames: rows of equations of the pose of one in the other, with their
rates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.forward.fk import fk
from kempe.forward.fk import jacobian as frame_jacobian
from kempe.model.configurations import read_q
from kempe.spatial import Array
from oracles import pairs

if TYPE_CHECKING:
    from kempe.system import System

_EYE = np.eye(4)


@dataclass(frozen=True, eq=False)
class Pair(ABC):
    """A constraint on where frame B is in frame A: `X_A` on the body or frame `a`, `X_B` on `b`."""

    name: str
    a: str
    b: str
    X_A: Array = field(default_factory=lambda: _EYE, kw_only=True)
    X_B: Array = field(default_factory=lambda: _EYE, kw_only=True)

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """A name for each row."""

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.names)

    @abstractmethod
    def rows(self, X: Array) -> pairs.Rows:
        """Residual (..., size) and rates (..., size, 6) of the pose X of B in A; see
        `kempe.kinematics.pairs`.
        """

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""
        return self.rows(self.pose(system, read_q(system, q)))[0]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""
        return self.rows(self.pose(system, q := read_q(system, q)))[1] @ self.motion(system, q)

    def pose(self, system: System, q: Array) -> Array:
        """Pose (..., 4, 4) of B in A."""
        return spatial.inverse(fk(system, q, self.a) @ self.X_A) @ fk(system, q, self.b) @ self.X_B

    def motion(self, system: System, q: Array) -> Array:
        """Matrix (..., 6, nv): velocity coordinates to the twist of B against A, at the origin of
        B, in axes of A.
        """
        ends = ((self.a, self.X_A), (self.b, self.X_B))
        return pairs.motion(*((fk(system, q, f), X, frame_jacobian(system, q, f)) for f, X in ends))
