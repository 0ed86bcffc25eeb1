"""Idle spins held still: a mechanism in which bodies spin between balls moves as if they could not.

An idle spin moves nothing but the bodies that spin, so any rule that fixes it leaves the motion of
all others as it is. The rule here is that of a universal joint in place of a ball: a direction
fixed in the bodies stays perpendicular to a direction fixed in the ground. As long as the line
about which they spin is not parallel to the latter, the spin is a function of the line: a motion
that leads the line back leads the bodies back.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from kempe.forward.fk import query
from kempe.mobility.idle_spins import spins_of
from kempe.spatial import Array, unit

if TYPE_CHECKING:
    from kempe.equations.closure import Closure
    from kempe.model.model import Model

STEEP = 0.2
"""Sine of the angle between line and direction in the ground below which a direction farther away
is looked for."""
BETTER = 1.5
"""How many times farther away it must be."""
DIRECTIONS = 400
"""Directions in the ground that are tried."""


class Spins:
    """Equations that hold idle spins, one for each: ``ground . (R along) = 0``, with R the rotation
    of a body.

    `lines` (k, 3) are directions of the lines about which bodies spin, in the axes of the bodies.
    """

    def __init__(self, system: Model, bodies: Iterable[str], lines: Array, q: Array):
        self.bodies = list(bodies)
        self.lines = lines
        self.q = q
        self._queries = [query(system, b) for b in self.bodies]
        self.seen = self.at(q[None])
        self._choose([_across(d) for d in self.seen[0]])

    @property
    def count(self) -> int:
        """How many spins are held."""
        return len(self.bodies)

    def at(self, q: Array) -> Array:
        """Directions (n, k, 3) of the lines in the ground at configurations (n, nq)."""
        turned = [
            pose(q)[:, :3, :3] @ line for pose, line in zip(self._queries, self.lines, strict=True)
        ]
        return np.stack(turned, axis=1)

    def _choose(self, ground: Iterable[Array]) -> None:
        """Hold the spins by these directions in the ground, as they are at the first configuration."""
        self.ground = np.array(list(ground))
        across = unit(np.cross(self.ground, self.at(self.q[None])[0]))
        self.along = np.array(
            [pose(self.q)[:3, :3].T @ v for pose, v in zip(self._queries, across, strict=True)]
        )

    def write(
        self, equations: Closure, x: Array, F: Array, J: Array, at: int, with_matrix: bool
    ) -> None:
        """Write the residuals of these equations and their derivatives into F and J (., n) from row
        `at` on.
        """
        for i, pose in enumerate(self._queries):
            along = pose(x)[:3, :3] @ self.along[i]
            F[at + i] = self.ground[i] @ along
            if with_matrix:
                J[at + i] = np.cross(along, self.ground[i]) @ pose.jacobian(x)[3:] * equations.unit

    def begin(self, q: Array) -> None:
        """Go on from a configuration (nq,): by directions in the ground that are far from the lines
        there.
        """
        here = self.at(q[None])[0]
        if np.any(_sine(self.ground, here) < 2.0 * STEEP):
            self.q = q
            self._choose([_across(d) for d in here])

    def turned(self, q: Array) -> bool:
        """Whether lines came too near to the directions in the ground at some of (n, nq); others
        are chosen then.
        """
        self.seen = np.concatenate([self.seen, self.at(q)])
        out = np.array(self.ground)
        for i in range(self.count):
            least = _sine(self.ground[i], self.seen[:, i]).min()
            if least < STEEP:
                away = np.linalg.norm(
                    np.cross(_sphere()[:, None], self.seen[None, :, i]), axis=-1
                ).min(axis=1)
                best = int(np.argmax(away))
                out[i] = _sphere()[best] if away[best] > BETTER * least else out[i]
        changed = not np.array_equal(out, self.ground)
        if changed:
            self._choose(out)
        return changed


def spins_held(equations: Closure) -> Spins | None:
    """The spins that equations hold, None where there are none."""
    return next((m for m in equations.more if isinstance(m, Spins)), None)


def hold_spins(equations: Closure, q: Array, requested: Iterable[int]) -> bool:
    """Hold the idle spins from a closed configuration on, but those that move held or `requested`
    velocities; whether there are others.
    """
    keep = [*equations.held, *requested]
    tree = equations.tree
    found = [s for s in spins_of(tree, q) if not s.moves[keep].any()]
    if found and spins_held(equations) is None:
        equations.add(Spins(tree, [s.body for s in found], np.array([s.line for s in found]), q))
    return bool(found)


def _across(d: Array) -> Array:
    """A unit vector perpendicular to another."""
    e = np.eye(3)[int(np.argmin(np.abs(d)))]
    return unit(np.cross(d, e))


def _sine(a: Array, b: Array) -> Array:
    """Sines (...) of the angles between unit vectors (..., 3)."""
    return np.asarray(np.linalg.norm(np.cross(a, b), axis=-1), dtype=float)


def _sphere() -> Array:
    """Directions (n, 3) all over the half of a sphere: points of a Fibonacci spiral (Swinbank,
    Purser, 2006).
    """
    k = np.arange(DIRECTIONS) + 0.5
    z = k / DIRECTIONS
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
