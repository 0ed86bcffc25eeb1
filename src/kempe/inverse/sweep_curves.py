"""Self-motions of a chain with one freedom to spare: curves, cut into arcs over a joint.

Each curve is followed by predictor and corrector from solutions at many values of the parameter.
A curve that lives between two of the values is missed: hence "not exact", however small the errors
are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.targets import TASKS, is_axis_task, make_rotations_along
from kempe.budget import TimeUp, check_for_stop
from kempe.forward.fk import fk, jacobian
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.kernels.forward.table_layout import SLIDE
from kempe.numerics.clock import TimeLimit
from kempe.numerics.curves import ACROSS, BEND, Curve, Node, find_next_node, make_node, walk_curve
from kempe.numerics.intervals import SAME_ANGLE, unite_intervals
from kempe.numerics.newton import GaussNewtonEnd, run_many_gauss_newton
from kempe.numerics.rank import Spectrum
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

LONGEST = 0.15
MOST_STEPS = 4000
"""The longest step along a curve [rad, lengths of the chain], and how many a curve may have."""

CONVERGED = 1e-13
HELD = 1e-11
"""Error of a configuration that is corrected no further, and of one that is taken for good."""

CHECKS = np.linspace(0.0, 1.0, 6)
"""Places in a step where folds and limits are looked for: a pair of them closer than that is
missed."""

TWO_PI = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class ChainMotion(Curve):
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

    @property
    def unit(self) -> Array:
        """Unit (nf,) of each free coordinate x in the system's units."""
        free = list(self.free)
        return np.where(self.lines.kinds[free] == SLIDE, self.lines.length, 1.0)

    @property
    def period(self) -> Array:
        """Period (nf,) of each free coordinate: a turn; infinite for slides."""
        free = list(self.free)
        return np.where(
            self.lines.kinds[free] == SLIDE, np.inf, TWO_PI / np.abs(self.lines.multiplier[free])
        )

    @property
    def limits(self) -> Array:
        """Limits (2, nf) of x."""
        return self.lines.limits[:, list(self.free)] / self.unit

    def make_configurations(self, x: Array) -> Array:
        """Make configurations (..., nq) of free coordinates x (..., nf)."""
        out = np.array(np.broadcast_to(self.base, (*x.shape[:-1], len(self.base))), order="C")
        out[..., self.lines.q_index[list(self.free)]] = x * self.unit
        return out

    def read_coordinates(self, q: Array) -> Array:
        """Read the free coordinates (..., nf) of configurations (..., nq)."""
        return q[..., self.lines.q_index[list(self.free)]] / self.unit

    @property
    def tool(self) -> Array:
        """Rotation (3, 3) from the frame to one whose z axis is the tool's axis."""
        return make_rotations_along(np.array(self.axis)) if is_axis_task(self.task) else np.eye(3)

    @property
    def rows(self) -> Array:
        """Weights (6,), 0 or 1, of the six pose errors."""
        planar = self.system.dim == 2 and self.task == "pose"
        return np.array((1, 1, 0, 0, 0, 1) if planar else TASKS[self.task], dtype=float)

    def compute_missing_twist(self, q: Array) -> Array:
        """Compute the twist (..., 6) from the tip to the target, in the tip's frame.

        Lengths are in lengths of the chain.

        What the task does not ask for is zero.
        """
        X = fk(self.system, q, self.frame)
        turn = self.tool
        back = np.swapaxes(X[..., :3, :3] @ turn, -1, -2)
        away = (
            np.einsum("...ij,...j->...i", back, self.target[:3, 3] - X[..., :3, 3])
            / self.lines.length
        )
        left = back @ (self.target[:3, :3] @ turn)
        if is_axis_task(self.task):
            angular = np.stack(
                [-left[..., 1, 2], left[..., 0, 2], np.zeros(left.shape[:-2])], axis=-1
            )
        else:
            angular = compute_rotation_vector(left)
        return self.rows * np.concatenate([away, angular], axis=-1)

    def compute_twist_jacobian(self, x: Array) -> Array:
        """Compute derivatives (..., 6, nf) of the tip's twist by x."""
        J = jacobian(self.system, self.make_configurations(x), self.frame, "body")
        J = J[..., self.lines.v_index[list(self.free)]] * self.unit
        J = np.concatenate(
            [self.tool.T @ J[..., :3, :] / self.lines.length, self.tool.T @ J[..., 3:, :]], axis=-2
        )
        return self.rows[:, None] * J

    def evaluate_equations(self, x: Array) -> tuple[Array, Array]:
        """Compute minus the missing twist at x (nf,), and its derivatives, with zero rows below."""
        return np.append(
            -self.compute_missing_twist(self.make_configurations(x)), np.zeros(max(self.n - 6, 0))
        ), self.compute_jacobian(x)

    def compute_jacobian(self, x: Array) -> Array:
        """Compute the derivatives of `evaluate_equations` alone."""
        return np.append(
            self.compute_twist_jacobian(x), np.zeros((max(self.n - 6, 0), self.n)), axis=0
        )

    def compute_tolerance(self, x: Array) -> float:
        """Compute the largest error of a point of the curve."""
        return HELD

    def correct_points(self, x: Array, across: Array, rounds: int = 8) -> tuple[Array, np.ndarray]:
        """Find points (m, nf) of the curve in planes through x (m, nf), and which exist (m,).

        The planes are normal to the directions `across` (m, nf).
        """
        at = np.sum(across * x, axis=-1)

        def evaluate_equations(x: Array, some: np.ndarray) -> tuple[Array, Array]:
            e = self.compute_missing_twist(self.make_configurations(x))
            J = self.compute_twist_jacobian(x)
            away = np.sum(across[some] * x, axis=-1) - at[some]
            return np.append(-e, away[:, None], axis=-1), np.append(J, across[some, None], axis=-2)

        x = run_many_gauss_newton(evaluate_equations, x, rounds, met=CONVERGED)
        return x, np.abs(self.compute_missing_twist(self.make_configurations(x))).max(
            axis=-1
        ) < HELD

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
class CurvePiece:
    """A piece of a curve over which the parameter rises: nodes x (k, nf) and unit tangents t (k,
    nf).
    """

    motion: ChainMotion
    x: Array
    t: Array

    @property
    def values(self) -> Array:
        """Parameter values (k,) of the nodes."""
        return self.x[:, self.motion.p]

    def guess_points(self, k: np.ndarray, s: Array) -> Array:
        """Estimate points (m, nf) at fractions s (m,) of steps k (m,), by cubics."""
        return interpolate_hermite(self.x[k], self.t[k], self.x[k + 1], self.t[k + 1], s)

    def compute_points(self, k: np.ndarray, s: Array) -> Array:
        """Compute points (m, nf) of the curve at fractions s (m,) of steps k (m,)."""
        across = self.x[k + 1] - self.x[k]
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        return self.motion.correct_points(self.guess_points(k, s), across)[0]

    def find_points(self, values: Array) -> tuple[Array, np.ndarray]:
        """Find points (m, nf) at parameter values (m,), and whether the arc exists there (m,)."""
        p = self.motion.p
        known = self.values
        there = (values >= known[0]) & (values <= known[-1])
        out = np.full((len(values), self.x.shape[1]), np.nan)
        if not there.any():
            return out, there
        v = values[there]
        k = np.clip(np.searchsorted(known, v, side="right") - 1, 0, len(known) - 2)
        low = np.zeros(len(v))
        high = np.ones(len(v))
        for _ in range(45):
            s = 0.5 * (low + high)
            less = self.guess_points(k, s)[:, p] < v
            low = np.where(less, s, low)
            high = np.where(less, high, s)
        x = self.guess_points(k, 0.5 * (low + high))
        x[:, p] = v
        across = np.zeros_like(x)
        across[:, p] = 1.0
        better, good = self.motion.correct_points(x, across)
        steps = np.linalg.norm(self.x[k + 1] - self.x[k], axis=-1)
        good &= np.linalg.norm(better - x, axis=-1) < 0.5 * steps + 1e-6
        for end in (0, -1):  # the ends are folds, where the corrector has nothing to hold on to
            at_end = np.abs(v - known[end]) <= 1e-14 * (1.0 + abs(known[end]))
            better[at_end] = self.x[end]
            good[at_end] = True
        out[there] = better
        there[there] = good
        return out, there

    def find_intervals(self, limited: bool = True) -> list[tuple[float, float]]:
        """Find the intervals of the parameter in which the arc is inside the limits.

        Without `limited`, return all of it.
        """
        if not limited:
            return [(float(self.values[0]), float(self.values[-1]))]
        last = len(self.x) - 1
        ends = [
            (0.0, self.values[0]),
            *sorted(self._iterate_crossings()),
            (float(last), self.values[-1]),
        ]
        pairs = [(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True) if b[0] - a[0] > 1e-11]
        middles = np.array([0.5 * (a[0] + b[0]) for a, b in pairs])
        k = np.minimum(middles.astype(int), last - 1)
        good = self.motion.is_inside_limits(self.compute_points(k, middles - k))
        kept = [pair for pair, inside in zip(pairs, good, strict=True) if inside]
        parts = [(float(low), float(high)) for (_, low), (_, high) in kept]
        return list(unite_intervals(parts, slack=SAME_ANGLE))

    def _iterate_crossings(self) -> Iterator[tuple[float, float]]:
        """Yield step, fraction and parameter where another joint passes a limit."""
        m = self.motion
        steps = len(self.x) - 1
        k = np.repeat(np.arange(steps), len(CHECKS))
        some = self.guess_points(k, np.tile(CHECKS, steps)).reshape(steps, len(CHECKS), -1)
        found: list[tuple[int, int, int, float]] = []
        for j, (low, high) in enumerate(m.limits.T):
            for limit in {low, high} if j != m.p else ():
                if not math.isfinite(limit):
                    continue
                period = m.period[j] if math.isfinite(m.period[j]) else 1e30
                lap = np.floor((some[..., j] - limit) / period)
                for k, i in zip(*np.nonzero(lap[:, 1:] != lap[:, :-1]), strict=True):
                    lifted = max(lap[k, i], lap[k, i + 1])
                    found.append(
                        (int(k), int(i), j, float(limit + period * lifted if lifted else limit))
                    )
        if not found:
            return
        at, i, joint, level = (np.array(column) for column in zip(*found, strict=True))
        low = CHECKS[i]
        high = CHECKS[i + 1]
        rows = np.arange(len(at))
        rising = self.guess_points(at, high)[rows, joint] > self.guess_points(at, low)[rows, joint]
        for _ in range(30):
            s = 0.5 * (low + high)
            before = (self.guess_points(at, s)[rows, joint] < level) == rising
            low = np.where(before, s, low)
            high = np.where(before, high, s)
        first = self.guess_points(at, 0.5 * (low + high))
        first[rows, joint] = level
        x, good = m.correct_points(first, np.eye(some.shape[-1])[joint])
        size = np.linalg.norm(self.x[at + 1] - self.x[at], axis=-1)
        good &= np.linalg.norm(x - first, axis=-1) < 0.05 * size + 1e-9
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
            yield (
                float(at[r] + 0.5 * (low[r] + high[r])),
                float(np.clip(x[r, m.p], self.values[0], self.values[-1])),
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
    s = s[:, None]
    d = x1 - x0
    return (
        x0 + s * s * (3.0 - 2.0 * s) * d + size * (s * (1.0 - s) ** 2 * t0 - s * s * (1.0 - s) * t1)
    )


# ---- following a curve between two values

# *Folds*, where the parameter turns back and two solutions merge, and the places where joints reach
# limits, are found on the curve itself (Burdick, "On the inverse kinematics of redundant
# manipulators: characterization of the self-motion manifolds", ICRA 1989).


def follow_curve(
    motion: ChainMotion, start: Array, tangent: Array, between: tuple[float, float]
) -> tuple[list[Array], list[Array]]:
    """Follow the curve until the parameter leaves an interval: nodes and tangents.

    The last node is on the end of the interval.

    Where the curve has no tangent, or is too long, the last node is inside.
    """
    nodes = [make_node(motion, start, tangent)]
    ends = list[Node]()

    def take_step(a: Node, h: float) -> list[Node] | None:
        b = find_next_node(motion, a, h)
        if b is None or between[0] <= b.x[motion.p] <= between[1]:
            return None if b is None else [b]
        end = _find_landing(motion, a, b, between[0] if b.x[motion.p] < between[0] else between[1])
        ends[:] = [] if end is None else [make_node(motion, end.x, a.t, end.J)]
        return ends or None

    for b in walk_curve(nodes[0], take_step, LONGEST, LONGEST):
        nodes.append(b)
        if ends or len(nodes) == MOST_STEPS:
            break
    return [a.x for a in nodes], [a.t for a in nodes]


def _find_landing(motion: ChainMotion, a: Node, b: Node, value: float) -> GaussNewtonEnd | None:
    """Find the point in a step where the parameter has a value; None if there is none."""
    p = motion.p
    ends = a.x[None], a.t[None], b.x[None], b.t[None]
    s = find_sign_change(
        lambda s: float(interpolate_hermite(*ends, np.array([s]))[0, p] - value), 1e-9, 1.0
    )
    if s is None:
        return None
    guess = interpolate_hermite(*ends, np.array([s]))[0]
    guess[p] = value
    end = motion.correct_point(guess, np.eye(motion.n)[p])
    near = end is not None and np.linalg.norm(end.x - guess) <= ACROSS * np.linalg.norm(b.x - a.x)
    return end if near else None


def split_at_folds(
    motion: ChainMotion, xs: list[Array], ts: list[Array]
) -> list[tuple[Array, Array]]:
    """Split a path at its folds: nodes and tangents of the parts, in order."""
    nodes = [xs[0]]
    tangents = [ts[0]]
    ends = [0]
    for k in range(len(xs) - 1):
        for x, t in _iterate_folds(motion, xs[k], ts[k], xs[k + 1], ts[k + 1]):
            ends.append(len(nodes))
            nodes.append(x)
            tangents.append(t)
        nodes.append(xs[k + 1])
        tangents.append(ts[k + 1])
    ends.append(len(nodes) - 1)
    spans = zip(ends[:-1], ends[1:], strict=True)
    return [(np.array(nodes[a : b + 1]), np.array(tangents[a : b + 1])) for a, b in spans]


def _iterate_folds(
    motion: ChainMotion, x: Array, t: Array, y: Array, u: Array
) -> Iterator[tuple[Array, Array]]:
    """Yield points and tangents in a step where the parameter turns back."""
    p = motion.p
    piece = CurvePiece(motion, np.array([x, y]), np.array([t, u]))
    at_0 = np.array([0])

    def compute_slope(s: float) -> float:
        return float(make_node(motion, piece.compute_points(at_0, np.array([s]))[0], t).t[p])

    size = float(np.linalg.norm(y - x))
    s = CHECKS
    d = (y - x)[p]
    rates = 6.0 * s * (1.0 - s) * d + size * (
        (1.0 - s) * (1.0 - 3.0 * s) * t[p] - s * (2.0 - 3.0 * s) * u[p]
    )
    rates[0] = t[p]
    rates[-1] = u[p]
    if not np.any((rates[1:] > 0.0) != (rates[:-1] > 0.0)):
        return
    # the cubic says that there is one; the curve itself says where
    tangents = [
        make_node(motion, z, t).t for z in piece.compute_points(np.zeros(len(s), dtype=int), s)
    ]
    rates = np.array([t[p], *(v[p] for v in tangents[1:-1]), u[p]])
    for i in np.flatnonzero((rates[1:] > 0.0) != (rates[:-1] > 0.0)):
        at = find_sign_change(compute_slope, float(s[i]), float(s[i + 1]))
        if at is not None and 0.0 < at < 1.0:
            z = piece.compute_points(at_0, np.array([at]))[0]
            yield z, make_node(motion, z, t).t


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
        for i in range(len(self.values) - 1):
            self._join_levels(self.at[i], self.at[i + 1])
        for a in range(len(self.x)):
            if self.level[a] < len(self.values) - 1 and a not in self.up and a not in self.head:
                self._follow_curve_from_node(a, 1.0)
        for a in range(len(self.x)):
            if self.level[a] > 0 and a not in self.below and a not in self.foot:
                self._follow_curve_from_node(a, -1.0)

    def _join_levels(self, low: np.ndarray, high: np.ndarray) -> None:
        if not low.size or not high.size:
            return
        d = self.motion.compute_short_difference(self.x[low][:, None], self.x[high][None])
        t = self.t[low][:, None]
        u = self.t[high][None]
        size = np.linalg.norm(d, axis=-1)
        straight = np.linalg.norm(d - 0.5 * size[..., None] * (t + u), axis=-1) <= STRAIGHT * size
        fits = straight & (np.sum(t * u, axis=-1) >= math.cos(BEND)) & (size < 2.0 * LONGEST)
        for j, k in zip(
            *np.nonzero(fits & (fits.sum(axis=0) == 1) & (fits.sum(axis=1) == 1)[:, None]),
            strict=True,
        ):
            a = int(low[j])
            b = int(high[k])
            x = np.array([self.x[a], self.x[a] + d[j, k]])
            self._link_nodes(a, b, (x, self.t[[a, b]]))

    def _link_nodes(self, a: int, b: int, piece: Piece) -> None:
        self.up[a] = (b, piece)
        self.below.add(b)

    def _follow_curve_from_node(self, a: int, sense: float) -> None:
        """Follow the curve from node a up (sense 1) or down (-1) to the next level, or back.

        Its pieces are kept in `up`, `head`, `foot` and `loose`.
        """
        check_for_stop()
        motion = self.motion
        i = int(self.level[a])
        j = i + int(sense)
        between = (
            float(min(self.values[i], self.values[j])),
            float(max(self.values[i], self.values[j])),
        )
        xs, ts = follow_curve(motion, self.x[a], sense * self.t[a], between)
        parts = split_at_folds(motion, xs, ts)
        arrived = (
            i
            if abs(xs[-1][motion.p] - self.values[i]) < abs(xs[-1][motion.p] - self.values[j])
            else j
        )
        b = self._find_node(xs[-1], arrived)
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

    def list_arcs(self) -> list[CurvePiece]:
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
        return sorted(out, key=lambda a: (round(float(a.values[0]), 6), *a.x[0].round(6).tolist()))

    def _make_arc(self, parts: list[Piece]) -> CurvePiece:
        """Make one arc of consecutive pieces; the parameter rises and angles have no jumps."""
        (x, t) = parts[0]
        p = self.motion.p
        xs = list(x)
        ts = list(t)
        for more, tangents in parts[1:]:
            turn = xs[-1] + self.motion.compute_short_difference(xs[-1], more[0]) - more[0]
            xs += list(more[1:] + turn)
            ts += list(tangents[1:])
        x = np.array(xs)
        t = np.array(ts)
        if x[-1, p] < x[0, p]:
            x = x[::-1]
            t = -t[::-1]
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(x[:, p])) > 0.0])
        return CurvePiece(self.motion, x[keep], t[keep])


def trace_arcs(
    motion: ChainMotion, values: Array, x: Array, level: np.ndarray, time: TimeLimit
) -> list[CurvePiece]:
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
