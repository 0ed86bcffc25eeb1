"""Tests whether configurations are the same, modulo full turns and idle spins."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.equations import closure_rows
from kempe.forward.fk import fk
from kempe.joints import R
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.coordinates import find_wound_coordinates, list_coordinate_names
from kempe.model.model import keep_answers
from kempe.spatial import Array, unit

if TYPE_CHECKING:
    from kempe.model.model import Model

HELD = 1e-6
"""By how much more of the equations may be missing after whole turns, in radians and characteristic
lengths."""
MOST_TURNS = 100
"""Most turns of a source after which those that are geared to it must be back, to count as
periodic."""
SAME = 1e-6
"""Configurations nearer than this, in radians and characteristic lengths, are one: double roots
merge at 1e-8."""
MOST_AT_ONCE = 1 << 20
"""Numbers in one comparison of configurations with clusters."""
INSIDE = 1e-9
"""How far a coordinate may be outside its limits: rounding."""


class Metric:
    """Distances between configurations of a system, modulo the periods of angles.

    `scale` (nv,) are the metres, or radians, that count as one. `period` (nv,) are the angles after
    which every body is where it was, 0 for coordinates that have none; limits do not matter.
    """

    def __init__(self, system: Model):
        self.system = system
        self.length = compute_characteristic_length(system)
        self.scale = np.where(system.structure.coordinates.angular, 1.0, self.length)
        self.period = _compute_periods(system)
        self._weights = np.random.default_rng(0).uniform(0.5, 1.0, size=(system.nq + 4, 4))
        self.steepest = float(
            np.pi * system.nq + np.sum(2.0 * np.pi / self.period[self.period > 0.0]) + system.nq
        )
        """What keys of configurations that are 1 apart differ by at most."""

    def compute_keys(self, q: Array) -> Array:
        """Compute numbers (n,) that are nearly equal for nearly equal configurations (n, nq).

        Configurations with different numbers differ.
        """
        layout = self.system.structure.layout
        w = self._weights
        x = q[:, layout.vector_q]
        period = self.period[layout.vector_v]
        back = period > 0.0
        weight = w[: len(period), 0]
        turned = np.cos(2.0 * np.pi * x[:, back] / period[back] + w[: len(period), 1][back])
        out = (
            turned @ weight[back]
            + (x[:, ~back] / self.scale[layout.vector_v][~back]) @ weight[~back]
        )
        for k, i in enumerate(layout.quaternion_q):
            p = unit(q[:, i : i + 4])
            A = w[k : k + 4]
            out += np.sum((p @ (A + A.T)) * p, axis=1) / 8.0
        return out

    def compute_distances(self, q: Array, to: Array, counts: Any = slice(None)) -> Array:
        """Compute the largest coordinate difference (...), in radians and characteristic lengths.

        `counts` (nv,) selects coordinates.
        """
        v = self.system.structure.layout.compute_difference(to, q)
        back = self.period > 0.0
        v[..., back] -= self.period[back] * np.round(v[..., back] / self.period[back])
        return np.abs(v / self.scale)[..., counts].max(axis=-1, initial=0.0)

    def find_unique_configurations(
        self, q: Array, tolerance: float, counts: Any = slice(None)
    ) -> np.ndarray:
        """Find indices of the configurations (n, nq) that differ from all before them.

        `counts` (nv,) are the velocity coordinates that tell them apart: all, if not given.
        """
        keep: list[int] = []
        for k, x in enumerate(q):
            if not (keep and (self.compute_distances(q[keep], x, counts) < tolerance).any()):
                keep.append(k)
        return np.array(keep, dtype=int)

    def choose_representatives(self, q: Array, near: Array | None) -> Array:
        """Return configurations (n, nq) with angles nearest to `near` or zero, inside the limits.

        Angles of which a constraint tells whole turns apart stay as they are where it would else
        not hold.
        """
        system = self.system
        given = q
        low = np.maximum(system.lower, -1e300)
        high = np.minimum(system.upper, 1e300)
        q = np.array(q)
        for iq, iv in zip(
            system.structure.layout.vector_q.tolist(),
            system.structure.layout.vector_v.tolist(),
            strict=True,
        ):
            turn = float(self.period[iv])
            if not turn:
                continue
            target = 0.0 if near is None else near[iq]
            x = q[:, iq] + turn * np.round((target - q[:, iq]) / turn)
            down = np.where(x > high[iv], x - turn * np.ceil((x - high[iv]) / turn), x)
            up = np.where(down < low[iv], down + turn * np.ceil((low[iv] - down) / turn), down)
            q[:, iq] = np.where(up > high[iv] + INSIDE, x, up)
        read = find_wound_coordinates(system.mechanism, system.structure.coordinates)[
            system.structure.layout.vector_v
        ]
        if read.any() and len(q):
            off, before = (
                np.abs(closure_rows.evaluate_constraints(system, x, False, scaled=True)[0]).max(
                    axis=1, initial=0.0
                )
                for x in (q, given)
            )
            at = system.structure.layout.vector_q[read]
            q[:, at] = np.where((off > before + HELD)[:, None], np.asarray(given)[:, at], q[:, at])
        return q


@keep_answers
def get_metric(system: Model) -> Metric:
    """Return the metric of a system."""
    return Metric(system)


def _compute_periods(system: Model) -> Array:
    """Compute the period (nv,) of each velocity coordinate; 0 where there is none.

    A gear p / q brings its follower back only after q turns of its source.
    """
    from fractions import Fraction

    turns = np.where(system.structure.coordinates.turning, 1, 0)
    number = {name: i for i, name in enumerate(system.structure.velocity_names)}
    mechanism = system.mechanism
    followers = system.structure.couplings
    for joint in mechanism.joints.values():
        names = list_coordinate_names(mechanism, joint)
        for p in joint.type.layout(system.dim, mechanism.bodies[joint.child].particle)[1]:
            follower = followers.get(names[p.coordinate])
            if follower is not None and follower.source is not None:
                factor = p.multiplier * follower.multiplier
                i = number[follower.source]
                ratio = Fraction(factor).limit_denominator(MOST_TURNS)
                again = p.kind == R and abs(float(ratio) - factor) < 1e-12
                turns[i] = math.lcm(int(turns[i]), ratio.denominator) if again else 0
    for relation in system.structure.relations:
        for name in (relation.of, *relation.sources):
            turns[number[name]] = 0
    return 2.0 * math.pi * np.where(turns <= MOST_TURNS, turns, 0)


class Clusters:
    """Clusters of equal configurations: `q` (k, nq) the first of each, `hits` (k,) their sizes.

    `members` are their numbers in the order in which they came. With `frames`, configurations that
    put these frames at the same poses are one.
    """

    def __init__(self, system: Model, frames: tuple[str, ...] = ()):
        self.system = system
        self.frames = frames
        self.metric = get_metric(system)
        self.q = np.empty((0, system.nq))
        self.poses = np.empty((0, len(frames), 3, 4))
        self.keys = np.empty(0)
        self.tolerance = np.empty(0)
        self.members: list[list[int]] = []
        self.count = 0

    @property
    def hits(self) -> np.ndarray:
        """Number (k,) of configurations in each cluster."""
        return np.array([len(m) for m in self.members], dtype=np.int64)

    def add_configurations(self, q: Array, tolerance: Array, counted: bool = True) -> np.ndarray:
        """Sort configurations (n, nq) into clusters, new ones where needed.

        Returns the indices (n,) of their clusters.

        `tolerance` (n,) is the distance below which each is the same as another. Those that are not
        `counted` do not become members.
        """
        X = self._locate_frames(q)
        keys = self._compute_keys(q, X)
        out = self._find_nearest_clusters(q, X, keys, tolerance)
        rest = np.flatnonzero(out < 0)
        first, place = np.unique(
            self._find_first_equal_indices(q[rest], X[rest], keys[rest], tolerance[rest]),
            return_inverse=True,
        )
        out[rest] = len(self.members) + place
        new = rest[first]
        fresh: list[list[int]] = [[] for _ in new]
        self.members += fresh
        self.q = np.concatenate([self.q, q[new]])
        self.poses = np.concatenate([self.poses, X[new]])
        self.keys = np.append(self.keys, keys[new])
        self.tolerance = np.append(self.tolerance, tolerance[new])
        if counted:
            places: list[int] = out.tolist()
            for k in places:
                self.members[k].append(self.count)
                self.count += 1
        return out

    def _compute_keys(self, q: Array, X: Array) -> Array:
        """Compute keys (n,) that differ by at most `steepest` times the distance."""
        if not self.frames:
            return self.metric.compute_keys(q)
        X = X.copy()
        X[..., 3] /= self.metric.length
        return X.reshape(len(q), int(np.prod(X.shape[1:]))).mean(axis=1) * np.sqrt(12.0)

    def _find_nearest_clusters(
        self, q: Array, X: Array, keys: Array, tolerance: Array
    ) -> np.ndarray:
        """Find the indices (n,) of the nearest equal clusters; -1: none."""
        out = np.full(len(q), -1)
        if not len(self.members) or not len(q):
            return out
        order = np.argsort(self.keys, kind="stable")
        reach = self._bound_key_difference(max(float(tolerance.max()), float(self.tolerance.max())))
        low = np.searchsorted(self.keys[order], keys - reach, "left")
        high = np.searchsorted(self.keys[order], keys + reach, "right")
        count = high - low
        start = np.cumsum(count) - count
        who = np.repeat(np.arange(len(q)), count)
        with_ = order[np.arange(len(who)) - start[who] + low[who]]
        apart = np.empty(len(who))
        step = max(1, MOST_AT_ONCE // max(q.shape[1], 12 * len(self.frames), 1))
        for i in range(0, len(who), step):
            a = who[i : i + step]
            b = with_[i : i + step]
            apart[i : i + step] = self._measure_distances(q[a], X[a], self.q[b], self.poses[b])
        same = apart <= np.maximum(self.tolerance[with_], tolerance[who])
        who = who[same]
        with_ = with_[same]
        apart = apart[same]
        best = np.lexsort((with_, apart, who))[::-1]  # the nearest of each is written last
        out[who[best]] = with_[best]
        return out

    def _find_first_equal_indices(
        self, q: Array, X: Array, keys: Array, tolerance: Array
    ) -> np.ndarray:
        """Find for each configuration the index (n,) of the first equal one, or its own."""
        out = np.arange(len(q))
        if len(q) < 2:
            return out
        order = np.argsort(keys, kind="stable")
        ends = (
            np.flatnonzero(
                np.diff(keys[order]) > self._bound_key_difference(float(tolerance.max()))
            )
            + 1
        )
        for group in np.split(order, ends):
            left = np.sort(group)
            while len(left) > 1:
                k = left[0]
                left = left[1:]
                apart = self._measure_distances(q[left], X[left], q[k : k + 1], X[k : k + 1])
                same = apart <= np.maximum(tolerance[left], tolerance[k])
                out[left[same]] = k
                left = left[~same]
        return out

    def _bound_key_difference(self, tolerance: float) -> float:
        """Bound the difference of the keys of configurations within a tolerance."""
        return 1e-12 + 1.01 * tolerance * (np.sqrt(12.0) if self.frames else self.metric.steepest)

    def compute_distances(self, q: Array, to: Array) -> Array:
        """Compute distances of configurations (n, nq), in radians and characteristic lengths."""
        return self._measure_distances(q, self._locate_frames(q), to, self._locate_frames(to))

    def _locate_frames(self, q: Array) -> Array:
        """Compute the poses (n, frames, 3, 4) of the frames."""
        if not self.frames:
            return np.empty((len(q), 0, 3, 4))
        return np.stack([fk(self.system, q, f)[:, :3] for f in self.frames], axis=1)

    def _measure_distances(self, q: Array, X: Array, to: Array, Y: Array) -> Array:
        """Compute distances of configurations, or of the poses X and Y of their frames."""
        if not self.frames:
            return self.metric.compute_distances(q, to)
        error = Y - X
        error[..., 3] /= self.metric.length
        return np.linalg.norm(error, axis=(-2, -1)).max(axis=-1)
