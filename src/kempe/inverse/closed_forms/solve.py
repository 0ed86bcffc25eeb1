"""All configurations in which a frame reaches its targets, by the plan of its chain."""

from __future__ import annotations

import math

import numpy as np

from kempe.answers.targets import turn_targets_to_axis
from kempe.budget import check_for_stop
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.inverse.closed_forms.plan import SEARCH, ChainPlan
from kempe.inverse.closed_forms.problem import ChainProblem
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.forward.table_layout import SLIDE
from kempe.numerics.pool import sum_over_chunks
from kempe.spatial import Array

TOLERANCE = 1e-9
"""Largest position error [m] and rotation angle [rad] of a solution."""

EPSILON = float(np.finfo(float).eps)
CHUNK = 256
SERIAL_BELOW = 4096
ELIMINATED = 64
"""Targets that another plan solves between two looks at the clock."""
FAR = 300.0
"""Lengths of a chain with slides beyond which these are so long that its equations may say nothing
of the rest."""

NONE = np.zeros(0, dtype=np.int64)
"""No targets."""


def estimate_attainable_error(targets: Array, lines: Lines) -> float:
    """Estimate the error [m] that rounding leaves, from the size of targets and chain.

    Far away it exceeds the tolerance.
    """
    if len(targets) == 1:  # in Python: for three numbers arrays cost more
        far = max([abs(x) for x in targets[0, :3, 3].tolist() if math.isfinite(x)], default=0.0)
    else:
        size = np.abs(targets[:, :3, 3])
        far = float(size[np.isfinite(size)].max(initial=0.0))
    return (
        16.0
        * EPSILON
        * (far + lines.length * (1.0 + max(abs(x) for x in lines.tip[:3, 3].tolist())))
    )


def solve_locked_chain(
    problem: ChainProblem,
    plan: ChainPlan,
    chain_near: Array,
    locked: Array,
    threads: int | None,
    starts: bool = True,
) -> tuple[Array, np.ndarray]:
    """Solve a chain with locked joints: rows (N, K, n + 2) and counts (N, 2) of the kernels.

    `locked` (1 or N, n) are the values of locked joints.

    chain_near: (1 or N, n) coordinates of the chain, near which angles are given. With `starts` a
    search looks for solutions where the equations say nothing.
    """
    targets = turn_targets_to_axis(problem.targets, problem.axis)
    lines = plan.lines
    n = len(targets)
    single = problem.lead is None
    out = np.empty((n, plan.method.slots, len(lines) + A.INFO))
    counts = np.zeros((n, 2), dtype=np.int64)
    if plan.method == SEARCH:
        from kempe.inverse.closed_forms.start_search import search_targets

        search_targets(problem, plan, chain_near, locked, out, counts, np.arange(n))
        return out, counts
    blocks = None if plan.method.blocks is None else plan.method.blocks()
    piece = plan.method.piece
    if not plan.locked:
        locked = locked[:1]

    def solve_pieces(i: int, j: int) -> int:
        for k in range(i, j, piece):
            check_for_stop()
            last = min(k + piece, j)
            if problem.check_time(slice(k, last)):
                out[k:last, :, -A.INFO + A.CODE] = A.UNUSED
                counts[k:last, 1] = 1
            else:
                solve_chunk(k, last)
        return 0

    def solve_chunk(i: int, j: int) -> int:
        some = chain_near[i:j] if len(chain_near) > 1 else chain_near
        held_at = locked[i:j] if len(locked) > 1 else locked
        which = np.arange(j - i)
        if blocks is not None:
            padded = (
                np.resize(some, (A.LANES, len(lines)))
                if 1 < len(some) < A.LANES and len(locked) == 1
                else some
            )
            left = blocks(
                plan.ints, plan.floats, targets[i:j], padded, held_at, int(single), out[i:j], which
            )
            if left <= 0:
                return 0
            which = which[:left].copy()
        plan.fill_solutions(
            targets[i:j],
            some,
            held_at,
            problem.tolerance,
            problem.angular,
            int(single),
            which,
            out[i:j],
            counts[i:j],
        )
        return 0

    sum_over_chunks(solve_pieces, n, CHUNK, threads, SERIAL_BELOW)
    maybe_none = n != 1 or counts.item(0) == 0
    if (lines.kinds == SLIDE).any():
        counts[np.linalg.norm(targets[:, :3, 3] - lines.origin, axis=1) > FAR * lines.length, 1] = 1
    none = np.flatnonzero(counts[:, 0] == 0) if maybe_none and plan.has_resting_lines else NONE
    if len(none) and (other := plan.alternative_plan) is not None:  # two completions have to agree
        for k in range(0, len(none), ELIMINATED):
            some = none[k : k + ELIMINATED]
            if problem.check_time(some):
                counts[some, 1] = 1
                continue
            other.fill_solutions(
                targets,
                chain_near,
                locked,
                problem.tolerance,
                problem.angular,
                int(single),
                some,
                out,
                counts,
            )
    lost = (
        np.flatnonzero((counts[:, 1] == 1) & (counts[:, 0] == 0)) if maybe_none and starts else NONE
    )
    if len(lost):  # the equations said nothing: starts may
        from kempe.inverse.closed_forms.start_search import search_targets

        search_targets(problem, plan, chain_near, locked, out, counts, lost)
    if lines.span.wide or plan.blurred:  # a structure may be there by rounding alone
        counts[:, 1] = 1
    return out, counts
