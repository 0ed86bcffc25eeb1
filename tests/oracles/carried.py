"""The closure of a joint that holds nothing along fixed axes: its frame M, led on by its own
coordinates, is welded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.equations.judge import compute_coordinate_value
from kempe.model.configurations import read_q
from kempe.spatial import Array
from oracles import pairs
from oracles.frames import Pair
from oracles.motion import FLAT, Motion

if TYPE_CHECKING:
    from kempe.system import System


def coordinate_row(system: System, name: str) -> np.ndarray:
    """Derivatives (nv,) of any coordinate that is an angle or a length, also of one that is not in
    q.
    """
    row = np.zeros(system.nv)
    factor = 1.0
    follower = system.structure.couplings.get(name)
    if follower is not None:
        if follower.source is None:
            return row
        name = follower.source
        factor = follower.multiplier
    row[system.structure.coordinates.first[name][1]] = factor
    return row


@dataclass(frozen=True, eq=False)
class Carried(Pair):
    """A joint that closes a loop, by how far its coordinates put M from where M is: six rows, three
    in the plane.
    """

    own: Motion

    @property
    def names(self) -> tuple[str, ...]:
        """Position, then rotation, in axes of the M that the coordinates predict."""
        return tuple(("x", "y", "z", "rx", "ry", "rz")[k] for k in self.own.keep)

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""
        q = read_q(system, q)
        keep = list(self.own.keep)
        return self.own.error(self.pose(system, q), self.values(system, q)).value[..., keep]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""
        q = read_q(system, q)
        keep = list(self.own.keep)
        e = self.own.error(self.pose(system, q), self.values(system, q))
        rates = e.by_pose @ self.motion(system, q) + e.by_own @ self._own_rows(system)
        return rates[..., keep, :]

    def values(self, system: System, q: Array) -> Array:
        """Values (..., n) of the joint's own coordinates, those that follow others or are held
        included.
        """
        values = [compute_coordinate_value(system, q, n) for n in self.own.names]
        return np.stack(values, axis=-1) if values else np.zeros((*q.shape[:-1], 0))

    def _own_rows(self, system: System) -> Array:
        """Matrix (velocities of the joint, nv)."""
        out = np.zeros((self.own.size, system.nv))
        for value, velocity in self.own.plain:
            out[velocity] = coordinate_row(system, self.own.names[value])
        for s in self.own.steps:
            if s.value == self.own.ball >= 0:
                first = system.structure.coordinates.first[self.own.names[s.value]][1]
                out[s.velocity : s.velocity + 3, first : first + 3] = np.eye(3)
        return out

    def rows(self, X: Array) -> pairs.Rows:
        """The least that any coordinates leave open at a pose X of M in F, with rates.

        Of the rows as many depend on the others as the joint has freedoms.
        """
        keep = list(self.own.keep)
        e = self.own.error(X, self.own.fit(X))
        return e.value[..., keep], (e.by_pose + e.by_own @ self._follows(e))[..., keep, :]

    def read(self, X: Array, near: Array) -> tuple[Array, Array]:
        """The coordinates (..., n) at a pose, of several the ones nearest to `near`, and rates
        (..., velocities, 6).
        """
        values = self.own.fit(X, near)
        return values, self._follows(self.own.error(X, values))

    def _follows(self, e: Any) -> Array:
        """How the coordinates of the best fit follow the twist of M (..., velocities, 6)."""
        by_own, by_pose = self.own.slope(e)
        return -np.linalg.pinv(by_own, rcond=FLAT) @ by_pose
