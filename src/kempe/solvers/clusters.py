"""Which configurations are one and the same: angles modulo full turns, lengths in characteristic lengths."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from kempe.joints import R
from kempe.kinematics.forward import fk
from kempe.model.coordinates import coordinate_names
from kempe.model.loops import characteristic_length
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

MOST_TURNS = 100
"""Most turns of a source after which those that are geared to it must be back, to count as periodic."""
SAME = 1e-6
"""Configurations nearer than this, in radians and characteristic lengths, are one: double roots merge at 1e-8."""
MOST_AT_ONCE = 1 << 20
"""Numbers in one comparison of configurations with clusters."""
INSIDE = 1e-9
"""How far a coordinate may be outside its limits: rounding."""


class Metric:
    """Distances between configurations of a system.

    `scale` (nv,) are the metres, or radians, that count as one. `period` (nv,) are the angles after which every body is
    where it was, 0 for coordinates that have none; limits do not matter.
    """

    def __init__(self, system: System):
        self.system, self.length = system, characteristic_length(system)
        self.scale = np.where(system.coordinates.turning, 1.0, self.length)
        self.scale[(system.layout.quaternion_v[:, None] + np.arange(3)).ravel()] = 1.0
        self.period = _periods(system)

    def distances(self, q: Array, to: Array) -> Array:
        """Largest difference (...) in any coordinate, in radians and characteristic lengths."""
        v = self.system.layout.difference(to, q)
        back = self.period > 0.0
        v[..., back] -= self.period[back] * np.round(v[..., back] / self.period[back])
        return np.abs(v / self.scale).max(axis=-1, initial=0.0)

    def representatives(self, q: Array, near: Array | None) -> Array:
        """The configurations (n, nq), each angle turned to be nearest to `near`, or to zero, and inside its limits."""
        system = self.system
        low, high = np.maximum(system.lower, -1e300), np.minimum(system.upper, 1e300)
        q = np.array(q)
        for iq, iv in zip(system.layout.vector_q.tolist(), system.layout.vector_v.tolist(), strict=True):
            turn = float(self.period[iv])
            if not turn:
                continue
            target = 0.0 if near is None else near[iq]
            x = q[:, iq] + turn * np.round((target - q[:, iq]) / turn)
            down = np.where(x > high[iv], x - turn * np.ceil((x - high[iv]) / turn), x)
            up = np.where(down < low[iv], down + turn * np.ceil((low[iv] - down) / turn), down)
            q[:, iq] = np.where(up > high[iv] + INSIDE, x, up)
        return q


def _periods(system: System) -> Array:
    """For each velocity coordinate (nv,) the turn after which everything is as before; 0 where there is none.

    A gear p / q brings its follower back only after q turns of its source.
    """
    turns = np.where(system.coordinates.turning, 1, 0)
    number = {name: i for i, name in enumerate(system.velocity_names)}
    mechanism, followers = system.mechanism, system.couplings
    for joint in mechanism.joints.values():
        names = coordinate_names(mechanism, joint)
        for p in joint.type.layout(system.dim, mechanism.bodies[joint.child].particle)[1]:
            follower = followers.get(names[p.coordinate])
            if follower is not None and follower.source is not None:
                factor, i = p.multiplier * follower.multiplier, number[follower.source]
                ratio = Fraction(factor).limit_denominator(MOST_TURNS)
                again = p.kind == R and abs(float(ratio) - factor) < 1e-12
                turns[i] = math.lcm(int(turns[i]), ratio.denominator) if again else 0
    for relation in system.relations:
        for name in (relation.of, *relation.sources):
            turns[number[name]] = 0
    return 2.0 * math.pi * np.where(turns <= MOST_TURNS, turns, 0)


class Clusters:
    """Configurations, those that are one together: `q` (k, nq) the first of each, `hits` (k,) how many there were.

    `members` are their numbers in the order in which they came. With `frames`, configurations that put these frames at
    the same poses are one.
    """

    def __init__(self, system: System, frames: tuple[str, ...] = ()):
        self.system, self.frames, self.metric = system, frames, Metric(system)
        self.q = np.empty((0, system.nq))
        self.poses = np.empty((0, len(frames), 3, 4))
        self.tolerance = np.empty(0)
        self.members: list[list[int]] = []
        self.count = 0

    @property
    def hits(self) -> np.ndarray:
        """Number (k,) of configurations in each cluster."""
        return np.array([len(m) for m in self.members], dtype=np.int64)

    def add(self, q: Array, tolerance: Array, counted: bool = True) -> np.ndarray:
        """Numbers (n,) of the clusters into which configurations (n, nq) are sorted, new ones where needed.

        `tolerance` (n,) is the distance below which each is the same as another. Those that are not `counted` do not
        become members.
        """
        X = self._placed(q)
        out = self._nearest(q, X, tolerance, 0)
        while (out < 0).any():
            k = int(np.argmax(out < 0))
            self.members.append([])
            self.q = np.concatenate([self.q, q[k : k + 1]])
            self.poses = np.concatenate([self.poses, X[k : k + 1]])
            self.tolerance = np.append(self.tolerance, tolerance[k])
            rest = np.flatnonzero(out < 0)
            out[rest] = self._nearest(q[rest], X[rest], tolerance[rest], len(self.members) - 1)
            out[k] = len(self.members) - 1
        if counted:
            for k in out.tolist():
                self.members[k].append(self.count)
                self.count += 1
        return out

    def _nearest(self, q: Array, X: Array, tolerance: Array, first: int) -> np.ndarray:
        """Numbers (n,) of the nearest clusters, from the first on, that configurations are the same as; -1: none."""
        out = np.full(len(q), -1)
        if first == len(self.members):
            return out
        step = max(1, MOST_AT_ONCE // max(1, (len(self.members) - first) * max(q.shape[1], 12 * len(self.frames))))
        for i in range(0, len(q), step):
            part = slice(i, i + step)
            apart = self._apart(q[part, None], X[part, None], self.q[None, first:], self.poses[None, first:])
            apart = np.where(apart <= np.maximum(self.tolerance[first:], tolerance[part, None]), apart, np.inf)
            out[part] = np.where(np.isfinite(apart).any(axis=1), first + np.argmin(apart, axis=1), -1)
        return out

    def distances(self, q: Array, to: Array) -> Array:
        """How far configurations (n, nq) are from others, in radians and characteristic lengths."""
        return self._apart(q, self._placed(q), to, self._placed(to))

    def _placed(self, q: Array) -> Array:
        """Places (n, frames, 3, 4) of the frames."""
        if not self.frames:
            return np.empty((len(q), 0, 3, 4))
        return np.stack([fk(self.system, q, f)[:, :3] for f in self.frames], axis=1)

    def _apart(self, q: Array, X: Array, to: Array, Y: Array) -> Array:
        if not self.frames:
            return self.metric.distances(q, to)
        error = Y - X
        error[..., 3] /= self.metric.length
        return np.linalg.norm(error, axis=(-2, -1)).max(axis=-1)
