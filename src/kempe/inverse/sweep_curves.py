"""Self-motions of a chain with one freedom to spare: curves, cut into arcs over a joint.

Each curve is followed by predictor and corrector from solutions at many values of the parameter.
A curve that lives between two of the values is missed: hence "not exact", however small the errors
are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.targets import TASKS, is_axis_task, make_rotations_along
from kempe.budget import TimeUp, check_for_stop
from kempe.forward.fk import Query, query
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.kernels.forward.table_layout import SLIDE
from kempe.numerics.clock import TimeLimit
from kempe.numerics.curves import ACROSS, BEND, BLUNT, IDEAL_BEND, LEAST_STEP
from kempe.numerics.intervals import SAME_ANGLE, unite_intervals
from kempe.numerics.newton import run_many_gauss_newton
from kempe.numerics.rank import TINY, Spectrum
from kempe.numerics.roots import find_sign_change, find_sign_changes
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

LONGEST = 0.15
MOST_STEPS = 4000
"""The longest step along a curve [rad, lengths of the chain], and how many a curve may have."""

LANDINGS = 20
"""Bisections of a step that find where it passes a value of the parameter; a corrector follows."""

BISECTIONS = 45
"""The same, where it is found on a curve that is known."""

CONVERGED = 1e-13
HELD = 1e-11
"""Error of a configuration that is corrected no further, and of one that is taken for good."""

CHECKS = np.linspace(0.0, 1.0, 6)
"""Places in a step where folds and limits are looked for: a pair of them closer than that is
missed."""

TWO_PI = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class ChainMotion:
    """A chain that keeps its task at a target, with one freedom: joints `free` of the chain move,
    that at `p` of these is the parameter, the others stay as in `base` (nq,). x are the free
    coordinates, slides in lengths of the chain.
    """

    system: Model
    frame: str
    lines: Lines
    task: str
    axis: tuple[float, float, float]
    target: Array = field(repr=False)
    base: Array = field(repr=False)
    free: tuple[int, ...]
    p: int

    @property
    def n(self) -> int:
        """Number of joints that move."""
        return len(self.free)

    @cached_property
    def unit(self) -> Array:
        """Unit (nf,) of each free coordinate x in the system's units."""
        free = list(self.free)
        return np.where(self.lines.kinds[free] == SLIDE, self.lines.length, 1.0)

    @cached_property
    def period(self) -> Array:
        """Period (nf,) of each free coordinate: a turn; infinite for slides."""
        free = list(self.free)
        return np.where(
            self.lines.kinds[free] == SLIDE, np.inf, TWO_PI / np.abs(self.lines.multiplier[free])
        )

    @cached_property
    def limits(self) -> Array:
        """Limits (2, nf) of x."""
        return self.lines.limits[:, list(self.free)] / self.unit

    def make_configurations(self, x: Array) -> Array:
        """Make configurations (..., nq) of free coordinates x (..., nf)."""
        out = np.array(np.broadcast_to(self.base, (*x.shape[:-1], len(self.base))), order="C")
        out[..., self._places] = x * self.unit
        return out

    @cached_property
    def _places(self) -> np.ndarray:
        """Places (nf,) in q of the joints that move."""
        return self.lines.q_index[list(self.free)]

    def read_coordinates(self, q: Array) -> Array:
        """Read the free coordinates (..., nf) of configurations (..., nq)."""
        return q[..., self._places] / self.unit

    @cached_property
    def tool(self) -> Array:
        """Rotation (3, 3) from the frame to one whose z axis is the tool's axis."""
        return make_rotations_along(np.array(self.axis)) if is_axis_task(self.task) else np.eye(3)

    @cached_property
    def rows(self) -> Array:
        """Weights (6,), 0 or 1, of the six pose errors."""
        planar = self.system.dim == 2 and self.task == "pose"
        return np.array((1, 1, 0, 0, 0, 1) if planar else TASKS[self.task], dtype=float)

    @cached_property
    def _weights(self) -> Array:
        """Weights (6, nf) that derivatives of the tip's twist have where the tool needs no turn."""
        unit = self.rows * np.repeat([1.0 / self.lines.length, 1.0], 3)
        return unit[:, None] * self.unit

    @cached_property
    def _find_pose(self) -> Query:
        return query(self.system, self.frame)

    @cached_property
    def _columns(self) -> np.ndarray:
        """Velocity coordinates (nf,) of the joints that move."""
        return self.lines.v_index[list(self.free)]

    def compute_missing_twist(self, x: Array) -> Array:
        """Compute the twist (..., 6) from the tip to the target at x (..., nf), in the tip's frame.

        Lengths are in lengths of the chain.

        What the task does not ask for is zero.
        """
        return self._compare_poses(self._find_pose(self.make_configurations(x), threads=1))

    def _compare_poses(self, X: Array) -> Array:
        """Compute the missing twist (..., 6) at poses (..., 4, 4) of the tip."""
        turn = self.tool
        pointed = is_axis_task(self.task)
        back = np.swapaxes(X[..., :3, :3] @ turn if pointed else X[..., :3, :3], -1, -2)
        away = (
            np.einsum("...ij,...j->...i", back, self.target[:3, 3] - X[..., :3, 3])
            / self.lines.length
        )
        left = back @ (self.target[:3, :3] @ turn)
        if pointed:
            angular = np.stack(
                [-left[..., 1, 2], left[..., 0, 2], np.zeros(left.shape[:-2])], axis=-1
            )
        else:
            angular = compute_rotation_vector(left)
        return self.rows * np.concatenate([away, angular], axis=-1)

    def compute_twist_jacobian(self, x: Array) -> Array:
        """Compute derivatives (..., 6, nf) of the tip's twist by x."""
        return self.evaluate_twist(x)[1]

    def evaluate_twist(self, x: Array) -> tuple[Array, Array]:
        """Compute the missing twist (..., 6) at x (..., nf), and derivatives (..., 6, nf) of the tip's
        twist.
        """
        q = self.make_configurations(x)
        X, J = self._find_pose.pose_and_jacobian(q, "body", threads=1)
        J = J[..., self._columns]
        if is_axis_task(self.task):
            J = np.concatenate(
                [self.tool.T @ part for part in (J[..., :3, :], J[..., 3:, :])], axis=-2
            )
        return self._compare_poses(X), self._weights * J

    def correct_points(self, x: Array, across: Array, rounds: int = 8) -> tuple[Array, np.ndarray]:
        """Find points (m, nf) of the curve in planes through x (m, nf), and which exist (m,).

        The planes are normal to the directions `across` (m, nf).
        """
        at = np.sum(across * x, axis=-1)

        def evaluate_equations(x: Array, some: np.ndarray) -> tuple[Array, Array]:
            e, J = self.evaluate_twist(x)
            away = np.sum(across[some] * x, axis=-1) - at[some]
            return np.append(-e, away[:, None], axis=-1), np.append(J, across[some, None], axis=-2)

        x = run_many_gauss_newton(evaluate_equations, x, rounds, met=CONVERGED)
        return x, np.abs(self.compute_missing_twist(x)).max(axis=-1) < HELD

    def compute_short_difference(self, x: Array, y: Array) -> Array:
        """Compute y - x (..., nf), with angles the short way."""
        d = y - x
        period = self.period
        with np.errstate(invalid="ignore"):
            return np.where(np.isfinite(period), d - period * np.round(d / period), d)

    def is_inside_limits(self, x: Array) -> np.ndarray:
        """Whether (...) x (..., nf) is inside the limits in some turn, except the parameter."""
        (low, high) = self.limits
        period = self.period
        with np.errstate(invalid="ignore"):
            up = np.where(np.isfinite(period) & np.isfinite(low), low + np.mod(x - low, period), x)
            only = np.isfinite(period) & ~np.isfinite(low) & np.isfinite(high)
            up = np.where(only, high - np.mod(high - x, period), up)
        good = (up >= low) & (up <= high)
        good[..., self.p] = True
        return good.all(axis=-1)


@dataclass(frozen=True, eq=False)
class Arcs:
    """Arcs of curves over which the parameter rises: nodes x (k, nf) and unit tangents t (k, nf) of
    one arc after the other; arc i has the nodes first[i] to last[i].
    """

    motion: ChainMotion
    x: Array
    t: Array
    first: np.ndarray
    last: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    @cached_property
    def values(self) -> Array:
        """Parameter values (k,) of the nodes."""
        return np.ascontiguousarray(self.x[:, self.motion.p])

    def guess_points(self, k: np.ndarray, s: Array) -> Array:
        """Estimate points (m, nf) at fractions s (m,) of steps k (m,), by cubics."""
        return interpolate_hermite(self.x[k], self.t[k], self.x[k + 1], self.t[k + 1], s)

    def bisect_steps(
        self, k: np.ndarray, joint: Any, level: Array, low: Array, high: Array
    ) -> tuple[Array, Array]:
        """Find between which fractions (m,) of steps k the estimates of a joint pass levels (m,).

        `joint` is the number of the joint, or one for each step.
        """
        size = np.linalg.norm(self.x[k + 1] - self.x[k], axis=-1)
        x0, x1 = self.x[k, joint], self.x[k + 1, joint]
        d0, d1 = size * self.t[k, joint], size * self.t[k + 1, joint]

        def estimate_joint(s: Array) -> Array:
            return evaluate_cubics(x0, d0, x1, d1, s)

        rising = estimate_joint(high) > estimate_joint(low)
        for _ in range(BISECTIONS):
            s = 0.5 * (low + high)
            before = (estimate_joint(s) < level) == rising
            low = np.where(before, s, low)
            high = np.where(before, high, s)
        return low, high

    def compute_points(self, k: np.ndarray, s: Array) -> Array:
        """Compute points (m, nf) of the curve at fractions s (m,) of steps k (m,)."""
        across = self.x[k + 1] - self.x[k]
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        return self.motion.correct_points(self.guess_points(k, s), across)[0]

    def find_points(self, values: Array, arc: np.ndarray) -> tuple[Array, np.ndarray]:
        """Find points (m, nf) of arcs (m,) at parameter values (m,), and which exist (m,)."""
        p = self.motion.p
        known = self.values
        first = self.first[arc]
        last = self.last[arc]
        there = (values >= known[first]) & (values <= known[last])
        out = np.full((len(values), self.x.shape[1]), np.nan)
        if not there.any():
            return out, there
        v = values[there]
        k = np.empty(len(v), dtype=np.int64)
        for i in np.unique(arc[there]):
            own = arc[there] == i
            nodes = known[self.first[i] : self.last[i] + 1]
            k[own] = self.first[i] + np.searchsorted(nodes, v[own], side="right") - 1
        k = np.clip(k, first[there], last[there] - 1)
        low, high = self.bisect_steps(k, p, v, np.zeros(len(v)), np.ones(len(v)))
        x = self.guess_points(k, 0.5 * (low + high))
        x[:, p] = v
        across = np.zeros_like(x)
        across[:, p] = 1.0
        better, good = self.motion.correct_points(x, across)
        steps = np.linalg.norm(self.x[k + 1] - self.x[k], axis=-1)
        good &= np.linalg.norm(better - x, axis=-1) < 0.5 * steps + 1e-6
        for ends in (first, last):  # folds, where the corrector has nothing to hold on to
            end = ends[there]
            at_end = np.abs(v - known[end]) <= 1e-14 * (1.0 + np.abs(known[end]))
            better[at_end] = self.x[end[at_end]]
            good[at_end] = True
        out[there] = better
        there[there] = good
        return out, there

    def find_intervals(self, limited: bool = True) -> list[list[tuple[float, float]]]:
        """Find the intervals of the parameter in which each arc is inside the limits.

        Without `limited`, return all of it.
        """
        low = self.values[self.first].tolist()
        high = self.values[self.last].tolist()
        if not limited:
            return [[pair] for pair in zip(low, high, strict=True)]
        crossings: list[list[tuple[float, float]]] = [[] for _ in range(len(self))]
        for i, place, value in self._iterate_crossings():
            crossings[i].append((place, value))
        pairs: list[tuple[int, tuple[float, float], tuple[float, float]]] = []
        for i, found in enumerate(crossings):
            steps = float(self.last[i] - self.first[i])
            ends = [(0.0, low[i]), *sorted(found), (steps, high[i])]
            pairs += [
                (i, a, b) for a, b in zip(ends[:-1], ends[1:], strict=True) if b[0] - a[0] > 1e-11
            ]
        if not pairs:
            return [[] for _ in crossings]
        middles = np.array([0.5 * (a[0] + b[0]) for _, a, b in pairs])
        arc = np.array([i for i, _, _ in pairs])
        k = np.minimum(middles.astype(int), (self.last - self.first)[arc] - 1)
        points = self.compute_points(self.first[arc] + k, middles - k)
        parts: list[list[tuple[float, float]]] = [[] for _ in crossings]
        for (i, a, b), inside in zip(pairs, self.motion.is_inside_limits(points), strict=True):
            if inside:
                parts[i].append((a[1], b[1]))
        return [list(unite_intervals(part, slack=SAME_ANGLE)) for part in parts]

    def _iterate_crossings(self) -> Iterator[tuple[int, float, float]]:
        """Yield arc, place in its steps and parameter where another joint passes a limit."""
        m = self.motion
        steps = np.delete(np.arange(len(self.x)), self.last)
        k = np.repeat(steps, len(CHECKS))
        some = self.guess_points(k, np.tile(CHECKS, len(steps)))
        some = some.reshape(len(steps), len(CHECKS), -1)
        found: list[tuple[np.ndarray, ...]] = []
        limits: list[list[float]] = m.limits.T.tolist()
        for j, (low, high) in enumerate(limits):
            for limit in {low, high} if j != m.p else ():
                if not math.isfinite(limit):
                    continue
                period = m.period[j] if math.isfinite(m.period[j]) else 1e30
                lap = np.floor((some[..., j] - limit) / period)
                k, i = np.nonzero(lap[:, 1:] != lap[:, :-1])
                lifted = np.maximum(lap[k, i], lap[k, i + 1])
                level: Array = np.where(lifted != 0.0, limit + period * lifted, limit)
                found.append((steps[k], i, np.full(len(k), j), level))
        if not sum(len(k) for k, *_ in found):
            return
        at, i, joint, level = (np.concatenate(column) for column in zip(*found, strict=True))
        rows = np.arange(len(at))
        low, high = self.bisect_steps(at, joint, level, CHECKS[i], CHECKS[i + 1])
        first = self.guess_points(at, 0.5 * (low + high))
        first[rows, joint] = level
        x, good = m.correct_points(first, np.eye(some.shape[-1])[joint])
        size = np.linalg.norm(self.x[at + 1] - self.x[at], axis=-1)
        good &= np.linalg.norm(x - first, axis=-1) < 0.05 * size + 1e-9
        arc = np.searchsorted(self.last, at)
        for r in rows:
            if not good[r]:  # the joint only grazes its limit: found on the curve, step by step

                def compute_offset(s: float, r: Any = r) -> float:
                    return float(
                        self.compute_points(at[[r]], np.array([s]))[0, joint[r]] - level[r]
                    )

                s = find_sign_change(compute_offset, float(CHECKS[i[r]]), float(CHECKS[i[r] + 1]))
                if s is None:
                    continue
                low[r] = high[r] = s
                x[r] = self.compute_points(at[[r]], np.array([s]))[0]
            ends = self.values[[self.first[arc[r]], self.last[arc[r]]]]
            yield (
                int(arc[r]),
                float(at[r] - self.first[arc[r]] + 0.5 * (low[r] + high[r])),
                float(np.clip(x[r, m.p], *ends)),
            )


def compute_rotation_vector(R: Array) -> Array:
    """Compute 2 tan(angle / 2) times the axis (..., 3) of rotations.

    For small angles it is the rotation vector.
    """
    v = np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]],
        axis=-1,
    )
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return v * (2.0 / np.maximum(1.0 + trace, 1e-9))[..., None]


def interpolate_hermite(x0: Array, t0: Array, x1: Array, t1: Array, s: Array) -> Array:
    """Interpolate points (m, n) at fractions s (m,) between nodes with unit tangents (m, n)."""
    size = np.linalg.norm(x1 - x0, axis=-1, keepdims=True)
    return evaluate_cubics(x0, size * t0, x1, size * t1, s[:, None])


def evaluate_cubics(x0: Array, d0: Array, x1: Array, d1: Array, s: Array) -> Array:
    """Evaluate cubics at s between 0, where they are x0 with the derivative d0, and 1."""
    return (
        x0
        + s * s * (3.0 - 2.0 * s) * (x1 - x0)
        + (s * (1.0 - s) ** 2 * d0 - s * s * (1.0 - s) * d1)
    )


# ---- following a curve between two values

# *Folds*, where the parameter turns back and two solutions merge, and the places where joints reach
# limits, are found on the curve itself (Burdick, "On the inverse kinematics of redundant
# manipulators: characterization of the self-motion manifolds", ICRA 1989).


def compute_tangents(motion: ChainMotion, x: Array, toward: Array) -> Array:
    """Compute unit tangents (m, nf) of curves at points x (m, nf), the null vectors nearest to
    `toward` (m, nf).
    """
    spectrum = Spectrum(motion.compute_twist_jacobian(x))
    Vt = spectrum.right
    null = np.ones(Vt.shape[:2], dtype=bool)
    many = spectrum.values.shape[1]
    null[:, :many] = spectrum.values <= BLUNT * spectrum.largest[:, None]
    null[:, -1] = True
    along = np.einsum("mk,mkn->mn", null * np.einsum("mkn,mn->mk", Vt, toward), Vt)
    size = np.linalg.norm(along, axis=1, keepdims=True)
    return np.where(size > 0.0, along / np.maximum(size, TINY), Vt[:, -1])


def follow_curves(
    motion: ChainMotion, x: Array, t: Array, low: Array, high: Array
) -> list[tuple[Array, Array]]:
    """Follow curves from points x (m, nf) along tangents t until the parameter leaves intervals.

    Returns nodes and tangents of each. The last node is on the end `low` or `high` (m,) of the
    interval. Where the curve has no tangent, or is too long, the last node is inside. All curves
    are followed side by side, each with steps of its own.
    """
    nodes = [[point] for point in x]
    tangents = [[tangent] for tangent in t]
    x = x.copy()
    t = t.copy()
    h = np.full(len(x), LONGEST)
    left = np.arange(len(x))
    for _ in range(MOST_STEPS):
        if not len(left):
            break
        check_for_stop()
        a = x[left]
        u = t[left]
        step = h[left, None]
        guess = a + step * u
        b, good = motion.correct_points(guess, u)
        good &= np.linalg.norm(b - guess, axis=1) <= ACROSS * step[:, 0]
        b = np.where(good[:, None], b, a)
        v = compute_tangents(motion, b, np.where(good[:, None], b - a, u))
        bend = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(v - u, axis=1)))
        good &= bend <= BEND
        value = b[:, motion.p]
        out = good & ((value < low[left]) | (value > high[left]))
        if out.any():
            k = np.flatnonzero(out)
            ends = np.where(value[k] < low[left[k]], low[left[k]], high[left[k]])
            b[k], good[k] = _find_landings(motion, a[k], u[k], b[k], v[k], ends)
            done = k[good[k]]
            if len(done):
                v[done] = compute_tangents(motion, b[done], u[done])
        for i in np.flatnonzero(good):
            nodes[left[i]].append(b[i])
            tangents[left[i]].append(v[i])
        x[left[good]] = b[good]
        t[left[good]] = v[good]
        longer = np.clip(IDEAL_BEND / np.maximum(bend, 1e-9), 0.5, 1.5)
        h[left] = np.where(good, np.minimum(LONGEST, h[left] * longer), 0.5 * h[left])
        left = left[~(out & good) & (h[left] >= LEAST_STEP)]
    return [(np.array(n), np.array(u)) for n, u in zip(nodes, tangents, strict=True)]


def _find_landings(
    motion: ChainMotion, a: Array, t: Array, b: Array, u: Array, values: Array
) -> tuple[Array, np.ndarray]:
    """Find points (m, nf) in steps from a to b where the parameter has values (m,), and which are
    found (m,).
    """
    p = motion.p
    low = np.full(len(a), 1e-9)
    high = np.ones(len(a))
    first = interpolate_hermite(a, t, b, u, low)[:, p] < values
    there = first != (b[:, p] < values)
    for _ in range(LANDINGS):
        s = 0.5 * (low + high)
        before = (interpolate_hermite(a, t, b, u, s)[:, p] < values) == first
        low = np.where(before, s, low)
        high = np.where(before, high, s)
    guess = interpolate_hermite(a, t, b, u, 0.5 * (low + high))
    guess[:, p] = values
    across = np.zeros_like(guess)
    across[:, p] = 1.0
    x, good = motion.correct_points(guess, across)
    near = np.linalg.norm(x - guess, axis=1) <= ACROSS * np.linalg.norm(b - a, axis=1)
    return x, there & good & near


def split_at_folds(
    motion: ChainMotion, curves: list[tuple[Array, Array]]
) -> list[list[tuple[Array, Array]]]:
    """Split curves (nodes and tangents) at their folds: the parts of each, in order."""
    steps = [(c, k) for c, (x, _) in enumerate(curves) for k in range(len(x) - 1)]
    folds: list[list[tuple[int, Array, Array]]] = [[] for _ in curves]
    if steps:
        first, last = (
            np.concatenate([np.stack(curve)[:, part] for curve in curves], axis=1)
            for part in (slice(-1), slice(1, None))
        )
        for i, z, u in _find_folds(motion, *first, *last):
            c, k = steps[i]
            folds[c].append((k, z, u))
    out: list[list[tuple[Array, Array]]] = []
    for (x, t), here in zip(curves, folds, strict=True):
        cuts = [0, *(k + 1 + i for i, (k, _, _) in enumerate(here)), len(x) - 1 + len(here)]
        places = [k + 1 for k, _, _ in here]
        if here:
            x = np.insert(x, places, [z for _, z, _ in here], axis=0)
            t = np.insert(t, places, [u for _, _, u in here], axis=0)
        out.append([(x[i : j + 1], t[i : j + 1]) for i, j in zip(cuts[:-1], cuts[1:], strict=True)])
    return out


def _find_folds(
    motion: ChainMotion, x: Array, t: Array, y: Array, u: Array
) -> list[tuple[int, Array, Array]]:
    """Find points and tangents in steps from x to y (m, nf) where the parameter turns back.

    Returns them with the number of their step, in order.
    """
    p = motion.p
    s = CHECKS
    size = np.linalg.norm(y - x, axis=1)[:, None]
    rates = 6.0 * s * (1.0 - s) * (y - x)[:, [p]] + size * (
        (1.0 - s) * (1.0 - 3.0 * s) * t[:, [p]] - s * (2.0 - 3.0 * s) * u[:, [p]]
    )
    rates[:, 0] = t[:, p]
    rates[:, -1] = u[:, p]
    some = np.flatnonzero(((rates[:, 1:] > 0.0) != (rates[:, :-1] > 0.0)).any(axis=1))
    if not len(some):
        return []

    def compute_nodes(k: np.ndarray, s: Array) -> tuple[Array, Array]:
        """Compute points and tangents (m, nf) at fractions s (m,) of steps k (m,)."""
        across = (y - x)[k] / size[k]
        guess = interpolate_hermite(x[k], t[k], y[k], u[k], s)
        z = motion.correct_points(guess, across)[0]
        return z, compute_tangents(motion, z, t[k])

    # the cubic says that there is one; the curve itself says where
    inner = s[1:-1]
    k = np.repeat(some, len(inner))
    rates[some, 1:-1] = compute_nodes(k, np.tile(inner, len(some)))[1][:, p].reshape(len(some), -1)
    row, i = np.nonzero((rates[some, 1:] > 0.0) != (rates[some, :-1] > 0.0))
    k = some[row]
    at = find_sign_changes(
        lambda s, which: compute_nodes(k[which], s)[1][:, p],
        (s[i], rates[k, i]),
        (s[i + 1], rates[k, i + 1]),
    )
    inside = (at > 0.0) & (at < 1.0)
    k = k[inside]
    z, v = compute_nodes(k, at[inside])
    return list(zip(k.tolist(), z, v, strict=True))


# ---- arcs through solutions at many values of the parameter

SAME = 1e-4
"""Distance below which the end of a path is a solution that is known."""

STRAIGHT = 0.1
"""How far a step may be from the mean of the tangents at its ends, as a fraction of its length."""

Piece = tuple[Array, Array]


class Net:
    """Solutions at rising values of the parameter, and the pieces of curve between them.

    x, t (M, nf): solutions and unit tangents along which the parameter rises; level (M,): which
    value. `up[a]` is the next node above a with the piece from a to it, both inclusive; `head[a]`
    and `foot[a]` are pieces that end in a fold above a, or begin in one below; `loose` are arcs
    that no value meets.
    """

    def __init__(self, motion: ChainMotion, values: Array, x: Array, level: np.ndarray):
        self.motion = motion
        self.values = values
        self.x = x
        self.level = level
        t = Spectrum(motion.compute_twist_jacobian(x)).right[:, -1] if len(x) else np.zeros_like(x)
        self.t = np.where(t[:, motion.p, None] < 0.0, -t, t)
        self.up: dict[int, tuple[int, Piece]] = {}
        self.below: set[int] = set()
        self.head: dict[int, Piece] = {}
        self.foot: dict[int, Piece] = {}
        self.loose: list[Piece] = []
        self.at = [np.flatnonzero(level == i) for i in range(len(values))]

    def join_nodes(self) -> None:
        """Join neighbouring nodes, and follow the curves from all ends that are left."""
        self._join_levels()
        for sense, joined, ended, last in (
            (1.0, self.up, self.head, len(self.values) - 1),
            (-1.0, self.below, self.foot, 0),
        ):
            left = [
                a
                for a in range(len(self.x))
                if self.level[a] != last and a not in joined and a not in ended
            ]
            for a, curve in zip(left, self._follow_curves(left, sense), strict=True):
                if a not in joined and a not in ended:
                    self._keep_curve(a, sense, curve)

    def _join_levels(self) -> None:
        """Join nodes of neighbouring levels that only fit to each other."""
        pairs = [
            (np.repeat(low, len(high)), np.tile(high, len(low)))
            for low, high in zip(self.at[:-1], self.at[1:], strict=True)
            if low.size and high.size
        ]
        if not pairs:
            return
        a, b = (np.concatenate(column) for column in zip(*pairs, strict=True))
        d = self.motion.compute_short_difference(self.x[a], self.x[b])
        t = self.t[a]
        u = self.t[b]
        size = np.linalg.norm(d, axis=-1)
        straight = np.linalg.norm(d - 0.5 * size[:, None] * (t + u), axis=-1) <= STRAIGHT * size
        fits = straight & (np.sum(t * u, axis=-1) >= math.cos(BEND)) & (size < 2.0 * LONGEST)
        a = a[fits]
        b = b[fits]
        alone = (np.bincount(a)[a] == 1) & (np.bincount(b)[b] == 1)
        for i, j, way in zip(a[alone].tolist(), b[alone].tolist(), d[fits][alone], strict=True):
            self._link_nodes(i, j, (np.stack([self.x[i], self.x[i] + way]), self.t[[i, j]]))

    def _link_nodes(self, a: int, b: int, piece: Piece) -> None:
        self.up[a] = (b, piece)
        self.below.add(b)

    def _follow_curves(self, nodes: list[int], sense: float) -> list[list[Piece]]:
        """Follow the curves from nodes up (sense 1) or down (-1) to the next level, or back.

        Returns the parts of each between folds.
        """
        motion = self.motion
        i = self.level[nodes]
        here = self.values[i]
        there = self.values[i + int(sense)]
        curves = follow_curves(
            motion,
            self.x[nodes],
            sense * self.t[nodes],
            np.minimum(here, there),
            np.maximum(here, there),
        )
        return split_at_folds(motion, curves)

    def _keep_curve(self, a: int, sense: float, parts: list[Piece]) -> None:
        """Keep the parts of a curve from node a in `up`, `head`, `foot` and `loose`."""
        i = int(self.level[a])
        j = i + int(sense)
        end = parts[-1][0][-1]
        value = end[self.motion.p]
        arrived = i if abs(value - self.values[i]) < abs(value - self.values[j]) else j
        b = self._find_node(end, arrived)
        if len(parts) == 1:
            x, t = parts[0]
            if b is not None and b not in (self.below if sense > 0.0 else self.up):
                self._link_nodes(*((a, b, (x, t)) if sense > 0.0 else (b, a, (x[::-1], -t[::-1]))))
            else:
                (self.head if sense > 0.0 else self.foot)[a] = (
                    (x, t) if sense > 0.0 else (x[::-1], -t[::-1])
                )
            return
        self._keep_fold_piece(a, sense, parts[0])
        if b is not None:
            x, t = parts[-1]
            self._keep_fold_piece(b, sense if arrived == i else -sense, (x[::-1], -t[::-1]))
            parts.pop()
        self.loose += parts[1:]

    def _keep_fold_piece(self, a: int, sense: float, piece: Piece) -> None:
        """Keep a piece that leads from a node to a fold above or below it."""
        x, t = piece
        if sense > 0.0:
            self.head[a] = x, t
        else:
            self.foot[a] = x[::-1], -t[::-1]

    def _find_node(self, x: Array, level: int) -> int | None:
        """Find the node at a level that equals x (nf,), or None."""
        some = self.at[level]
        if not some.size:
            return None
        away = np.abs(self.motion.compute_short_difference(self.x[some], x)).max(axis=-1)
        k = int(np.argmin(away))
        return int(some[k]) if away[k] < SAME else None

    def list_arcs(self) -> Arcs:
        """List all arcs, in the order of their beginnings."""
        out = [self._make_arc([piece]) for piece in self.loose]
        for a in range(len(self.x)):
            if a in self.below:
                continue
            parts = [self.foot[a]] if a in self.foot else []
            k = a
            while k in self.up:
                k, piece = self.up[k]
                parts.append(piece)
            if k in self.head:
                parts.append(self.head[k])
            if parts:
                out.append(self._make_arc(parts))
        p = self.motion.p
        out.sort(key=lambda arc: (round(float(arc[0][0, p]), 6), *arc[0][0].round(6).tolist()))
        last = np.cumsum([len(x) for x, _ in out], dtype=np.int64) - 1
        first = np.concatenate([[0], last[:-1] + 1])[: len(out)].astype(np.int64)
        none = np.zeros((0, self.motion.n))
        x, t = (np.concatenate([none, *(arc[i] for arc in out)]) for i in (0, 1))
        return Arcs(self.motion, x, t, first, last)

    def _make_arc(self, parts: list[Piece]) -> Piece:
        """Make one arc of consecutive pieces; the parameter rises and angles have no jumps."""
        motion = self.motion
        p = motion.p
        begins = np.array([x[0] for x, _ in parts])
        ends = np.array([x[-1] for x, _ in parts])
        jumps = motion.compute_short_difference(ends[:-1], begins[1:]) - (begins[1:] - ends[:-1])
        turns = np.concatenate([np.zeros((1, motion.n)), np.cumsum(jumps, axis=0)])
        more = [0] + [1] * (len(parts) - 1)
        x = np.concatenate(
            [x[i:] + turn for (x, _), turn, i in zip(parts, turns, more, strict=True)]
        )
        t = np.concatenate([t[i:] for (_, t), i in zip(parts, more, strict=True)])
        if x[-1, p] < x[0, p]:
            x = x[::-1]
            t = -t[::-1]
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(x[:, p])) > 0.0])
        return x[keep], t[keep]


def trace_arcs(
    motion: ChainMotion, values: Array, x: Array, level: np.ndarray, time: TimeLimit
) -> Arcs:
    """Trace the arcs through solutions x (M, nf) at rising values (m,) of the parameter.

    `level` (M,) is the index of each solution's value.

    Solutions at the values are joined to curves; from those that find no partner curves are
    followed.
    """
    x = x.copy()
    x[:, motion.p] = values[level]
    better, good = motion.correct_points(
        x, np.repeat(np.eye(x.shape[1])[[motion.p]], len(x), axis=0)
    )
    good &= np.abs(better - x).max(axis=-1, initial=0.0) < SAME
    net = Net(motion, values, np.where(good[:, None], better, x), level)
    try:
        net.join_nodes()
    except TimeUp:  # the arcs that were joined by now
        if not time.spent:
            raise
    return net.list_arcs()
