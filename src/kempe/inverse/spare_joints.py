"""Search for values of the spare joints of a redundant chain that make a target reachable.

A target has solutions at some values of a spare joint only, near the boundary of the workspace and
in the corners of the limits at hardly more than one. So a grid of values misses some. A numerical
search finds a configuration wherever there is one; with the spare joints held where that has them,
all the other solutions follow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kempe.answers.targets import turn_targets_to_axis
from kempe.budget import check_for_stop
from kempe.inverse.chain.problem import FEW, ITERATIONS, MOST, measure_reach_excess, pack_row_flags
from kempe.inverse.closed_forms.descent import Aim, compute_limits, run_descent
from kempe.inverse.closed_forms.plan import SEARCH, ChainPlan, scale_to_domains
from kempe.inverse.closed_forms.problem import ChainProblem
from kempe.inverse.closed_forms.start_search import find_chain_columns, make_frame_problem
from kempe.inverse.multi_start import search_targets
from kempe.kernels.base.search_layout import ANGULAR, ANSWER, LINEAR, SOLVED, STATUS
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.compiled import schedule
from kempe.numerics.pool import sum_over_chunks
from kempe.spatial import Array

VALUES = 64
"""Values of the spare joints that are tried before it is said that there is no solution, the first
among them."""

LOOSE = 1e-6
"""Tolerance of the last search, which is polished after."""

POLISHES = 4
BRISK = 1e-8
"""Descents in a row that polish, at most, and the damping with which each begins."""

SAME = 1e-4
"""A solution nearer than this to the configuration of the search is that configuration."""

ROOM = 512
"""Targets times values that are solved at a time, unless there are more targets."""

CHUNK = 256
SERIAL_BELOW = 1024
PIECE = 16
"""Targets of a chunk, from how many on there are threads, and targets between two looks at the
clock."""

SIGN = -(2**63)
"""The bit that codes of rows in use do not have."""

Solve = Callable[[ChainProblem, Array, Array], tuple[Array, np.ndarray]]


@dataclass(frozen=True, eq=False)
class SpareJoints:
    """Where the spare joints are: `locked` (1 or N, n) coordinates of which those count that are
    held, and of each target how many values were `tried` (N,).
    """

    locked: Array
    tried: np.ndarray


def search_spare_joints(
    problem: ChainProblem,
    plan: ChainPlan,
    near: Array,
    locked: Array,
    rows: Array,
    counts: np.ndarray,
    solve: Solve,
    threads: int | None,
) -> SpareJoints:
    """Search values of the spare joints at which the targets have solutions.

    `rows` (N, K, n + 2) and `counts` (N, 2) are made better in place.

    near, locked: (1 or N, n). solve: rows and counts of a problem, near and locked.
    """
    tried = np.ones(len(rows), dtype=np.int64)
    left = np.flatnonzero((counts[:, 0] >= 0) & ~_find_reached_targets(rows))
    if not len(left):
        return SpareJoints(locked, tried)
    many = _Targets(
        problem,
        plan,
        near,
        np.array(np.broadcast_to(locked, (len(rows), len(plan.lines)))),
        rows,
        counts,
        tried,
        solve,
        threads,
    )
    left = many.search_configurations(left, FEW, problem.tolerance, True)
    if len(left):
        left = left[measure_reach_excess(make_frame_problem(problem), problem.targets[left]) == 0.0]
    if not len(left):
        return SpareJoints(many.locked, tried)
    if plan.method != SEARCH and plan.spare_joints:
        left = many.step_spare_values(left)
    left = many.search_configurations(left, MOST, problem.tolerance, True)
    left = many.search_configurations(left, MOST, max(problem.tolerance, LOOSE), True)
    many.search_configurations(
        left[~_find_solved_targets(rows[left])], MOST, max(problem.tolerance, LOOSE), False
    )
    return SpareJoints(many.locked, tried)


def _find_solved_targets(rows: Array) -> np.ndarray:
    """Find the targets (N,) that have a solution."""
    return np.any(rows[..., -A.INFO + A.CODE] >= 0.0, axis=1)


def _find_reached_targets(rows: Array) -> np.ndarray:
    """Find the targets (N,) that have a solution inside the limits."""
    # by solutions: many times as fast
    code = np.ascontiguousarray(rows[..., -A.INFO + A.CODE].T).astype(np.int64)
    return np.any((code & (SIGN | int(A.INSIDE_BIT))) == int(A.INSIDE_BIT), axis=0)


@dataclass(frozen=True, eq=False)
class _Targets:
    """Targets of a closed-form problem with the best solutions so far."""

    problem: ChainProblem
    plan: ChainPlan
    near: Array
    locked: Array
    rows: Array
    counts: np.ndarray
    tried: np.ndarray
    solve: Solve
    threads: int | None

    def solve_at_values(self, which: np.ndarray, locked: Array) -> tuple[Array, np.ndarray]:
        """Solve the targets `which` with the spare joints held at `locked` (1 or m, n).

        Returns rows (m, K, n + 2), each a configuration with its error and flag, and their counts
        (m, 2).
        """
        lead = None if self.problem.lead is None and len(which) == 1 else (len(which),)
        some = self.problem.of(which, lead)
        near = self.near if len(self.near) == 1 else self.near[which]
        return self.solve(some, near, locked)

    def keep_better_answers(
        self, which: np.ndarray, locked: Array, rows: Array, counts: np.ndarray
    ) -> None:
        """Keep answers that are better: a solution inside the limits, or any at all."""
        old = self.rows[which]
        better = (_find_reached_targets(rows) & ~_find_reached_targets(old)) | (
            _find_solved_targets(rows) & ~_find_solved_targets(old)
        )
        at = which[better]
        self.rows[at] = rows[better]
        self.counts[at] = counts[better]
        self.locked[at] = locked[better]

    def step_spare_values(self, left: np.ndarray) -> np.ndarray:
        """Try VALUES values of the spare joints; return the targets of `left` still unreached."""
        values = sample_spare_values(self.plan, self.plan.spare_joints)
        k = 0
        while k < len(values) and len(left) and not self.problem.check_time(left):
            some = values[k : k + max(1, ROOM // len(left))]
            which = np.repeat(left, len(some))
            locked = self.locked[which]
            locked[:, self.plan.spare_joints] = np.tile(some, (len(left), 1))
            same = len(some) == 1 and not np.ptp(locked, axis=0).any()
            rows, counts = self.solve_at_values(which, locked[:1] if same else locked)
            grade = (2 * _find_reached_targets(rows) + _find_solved_targets(rows)).reshape(
                len(left), len(some)
            )
            first = np.arange(len(left)) * len(some) + np.argmax(grade, axis=1)
            self.keep_better_answers(left, locked[first], rows[first], counts[first])
            self.tried[left] += np.where(
                grade.max(axis=1) == 3, 1 + np.argmax(grade, axis=1), len(some)
            )
            left = left[~_find_reached_targets(self.rows[left])]
            k = k + len(some)
        return left

    def search_configurations(
        self, left: np.ndarray, starts: int, tolerance: float, limited: bool
    ) -> np.ndarray:
        """Search the targets of `left` from many starts; return those still unreached.

        With `limited`, only configurations inside the limits count.

        The others have all solutions with the spare joints where their configuration has them,
        itself among them.
        """
        if not len(left) or self.problem.check_time(left):
            return left
        q, error, found = self._find_configurations(left, starts, tolerance, limited)
        which = left[found]
        q = q[found]
        error = error[found]
        if len(which):
            locked = self.locked[which]
            locked[:, self.plan.spare_joints] = q[:, self.plan.spare_joints]
            rows, counts = self.solve_at_values(which, locked)
            for i in np.flatnonzero(
                ~(_find_reached_targets(rows) if limited else _find_solved_targets(rows))
            ):
                _insert_configuration(
                    rows[i], counts[i], q[i], error[i], limited, self.problem.lead is None
                )
            self.tried[which] += 1
            self.keep_better_answers(which, locked, rows, counts)
        return left[~found]

    def _find_configurations(
        self, which: np.ndarray, starts: int, tolerance: float, limited: bool
    ) -> tuple[Array, Array, np.ndarray]:
        """Find coordinates (m, n) of the chain, errors (m,), and which were found (m,)."""
        lines = self.plan.lines
        task = make_frame_problem(self.problem)
        m = len(which)
        chain = task.chain
        at = find_chain_columns(chain, lines)
        goals = turn_targets_to_axis(self.problem.targets[which], self.problem.axis)
        pins = list(self.plan.fixed)
        pinned = self.locked[which][:, pins]
        out = np.empty((m, len(lines) + ANSWER))
        circular = chain.circular.copy()
        circular[at[pins]] = 0
        task = replace(
            task,
            chain=replace(chain, circular=circular),
            starts=starts,
            tolerance=(tolerance, min(tolerance, max(self.problem.angular, LOOSE))),
        )
        wanted = pack_row_flags(task)
        limits = chain.limits.copy() if limited else np.tile([[-np.inf], [np.inf]], len(lines))
        near = self.near if len(self.near) == 1 else self.near[which]
        seeds = np.empty((len(near), 1, len(lines)))
        seeds[:, 0, at] = near
        if starts > FEW and limited:  # the few began at `near`: other starts, then
            seeds = chain.no_seed

        def run_pieces(i: int, j: int) -> int:
            for k in range(i, j, PIECE):
                check_for_stop()
                last = min(k + PIECE, j)
                if self.problem.check_time(which[k:last]):
                    out[k:last] = np.nan
                else:
                    search_rows(k, last)
            return 0

        def search_rows(i: int, j: int) -> int:
            if len(pins):
                limits[:, at[pins]] = pinned[i]
            first = seeds[i:j] if len(seeds) > 1 else seeds
            if chain.span.wide:
                return search_targets(
                    task, self.problem.targets[which[i:j]], first, limits, out[i:j]
                )
            return schedule.reach_goals(
                chain.ints,
                chain.floats,
                limits,
                wanted,
                goals[i:j],
                first,
                0,
                0,
                starts,
                ITERATIONS,
                *task.tolerance,
                0.0,
                out[i:j],
            )

        if len(pins) and np.ptp(pinned, axis=0).any():
            for i in range(m):
                run_pieces(i, i + 1)
        else:
            sum_over_chunks(run_pieces, m, CHUNK, self.threads, SERIAL_BELOW)
        n = len(lines)
        q = out[:, at]
        error = np.hypot(out[:, n + LINEAR], out[:, n + ANGULAR])
        found = out[:, n + STATUS] == SOLVED
        for i in np.flatnonzero(found & (error > self.problem.tolerance)):
            q[i], error[i] = self._polish_configuration(which[i], q[i], limited)
        within = (error <= self.problem.tolerance) & (
            out[:, n + ANGULAR] <= max(self.problem.angular, LOOSE)
        )
        return q, error, found & within

    def _polish_configuration(self, index: int, q: Array, limited: bool) -> tuple[Array, float]:
        """Move a configuration (n,) onto the target as well as possible; also return its error."""
        lines = self.plan.lines
        target = self.problem.targets[index]
        aim = Aim.from_target(self.problem, self.plan, target, self.plan.fixed)
        low, high = compute_limits(lines) if limited else np.tile([[-np.inf], [np.inf]], len(lines))
        theta = lines.compute_theta(q)[None]
        error = np.inf
        for _ in range(POLISHES):  # where the chain is singular a step halves the way
            theta = run_descent(aim, theta, low[aim.moves], high[aim.moves], BRISK)
            R, p, _, _ = aim.compute_line_placements(theta)
            e = aim.compute_errors(R, p)[0]
            error = float(np.hypot(np.linalg.norm(e[:3]) * lines.length, np.linalg.norm(e[3:])))
            if error <= 0.1 * self.problem.tolerance:
                break
        q = (theta[0] - lines.offset) / lines.multiplier
        return np.clip(q, *lines.limits) if limited else q, error


def sample_spare_values(plan: ChainPlan, spare: list[int]) -> Array:
    """Sample values (VALUES - 1, k) of the spare joints between their limits.

    The ends come first, then values that fill the space between.

    The points of one joint are those of van der Corput (1935), of several those of a Kronecker
    sequence.
    """
    lines = plan.lines
    k = len(spare)
    count = VALUES - 1
    if k == 1:
        number = np.arange(1, count - 1)
        shares = sum(((number >> bit) & 1) / 2.0 ** (bit + 1) for bit in range(6))
        shares = np.concatenate([np.reshape(shares, (-1, 1)), [[0.0], [1.0]]])
    else:
        root = 2.0
        for _ in range(50):  # x^(k + 1) = x + 1
            root = (1.0 + root) ** (1.0 / (k + 1))
        shares = (0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, k + 1)) % 1.0
    full = np.full((count, len(lines)), 0.5)
    full[:, spare] = shares
    return scale_to_domains(lines, full)[:, spare]


def _insert_configuration(
    row: Array, count: np.ndarray, q: Array, error: float, inside: bool, first: bool
) -> None:
    """Insert a configuration in the rows (K, n + 2) of its target, once, if there is room."""
    n = len(q)
    used = row[:, n + A.CODE] >= 0.0
    off = np.where(used, np.abs(row[:, :n] - q).max(axis=1), np.inf)
    at = (
        int(np.argmin(off))
        if off.min() < SAME
        else int(np.argmin(used))
        if not used.all()
        else len(row) - 1
    )
    count[0] += int(not used[at])
    count[1] = 1
    own = np.concatenate([q, [error, A.MULTIPLICITY_UNIT + float(inside)]])
    if first:
        row[1 : at + 1] = row[:at].copy()
        at = 0
    row[at] = own
