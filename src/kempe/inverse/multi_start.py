"""Numerical search for configurations that reach targets: rounds of starts, then the nearest."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.targets import turn_targets_to_axis
from kempe.budget import check_for_stop
from kempe.inverse.chain.problem import (
    FEW,
    FrameProblem,
    compute_errors,
    measure_reach_excess,
    pack_row_flags,
)
from kempe.inverse.chain.serial_chain import Chain, move_inside_limits
from kempe.kernels import compiled
from kempe.kernels.base.search_layout import (
    ANSWER,
    DESCENTS,
    LARGEST,
    LINEAR,
    NOT_FOUND,
    SOLVED,
    STARTS,
    STATUS,
    STEPS,
)
from kempe.kernels.compiled import schedule
from kempe.kernels.forward.table_layout import HAS_QUATERNION
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import read_start, refuse_large_numbers
from kempe.numerics.pool import sum_over_chunks
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.model import Model

GLANCE = 16
"""Starts after which a batch goes on, where what is nearest to such targets can wait."""
CHUNK = 256
SERIAL_BELOW = 1024
LANES = 8
WORK = 4096
NEAREST = 64
"""Targets of a chunk, and from how many on there are threads; the targets that are searched side by
side; starts of all targets together, and targets whose nearest configuration is searched for,
between two looks at the clock."""
UNBEGUN = -1.0
"""In place of the status of an answer: the time was up before."""
LOOSE = 1e-4
"""Tolerance from which the nearest configuration may be the wrong one: another, farther off, may be
within it."""
SHARES = (1.0, 0.2, 5.0)
"""How the two tolerances are weighed against each other where they are loose."""


def search_targets(
    problem: FrameProblem,
    targets: Array,
    seeds: Array,
    limits: Array,
    out: Array,
    postpone: bool = False,
    threads: int | None = 1,
) -> int:
    """Search all targets (N, 4, 4), write answers (N, n + ANSWER), and count the unreached.

    seeds: (1 or N, K, n); limits: (2, nv). With `postpone`, what is nearest to targets that lengths
    prove to be out of reach is not searched for: their status is OUT_OF_REACH.

    All targets get their first starts before one gets its last. Between two pieces of the work,
    which take about 0.1 s, Python sees an interrupt, and the clock is looked at.
    """
    chain = problem.chain
    n = out.shape[1] - ANSWER
    head = (
        chain.ints,
        chain.floats,
        limits,
        pack_row_flags(problem),
        turn_targets_to_axis(targets, problem.axis),
        seeds,
        problem.rng,
    )
    few = problem.round or FEW
    count = min(problem.starts, few, GLANCE if postpone else few)
    out[:, n + STATUS] = UNBEGUN
    _run_starts(problem, head, slice(None), 0, count, 0.0, out, threads, CHUNK)
    left = np.flatnonzero(out[:, n + STATUS] != SOLVED)
    if not left.size:
        return 0
    unbegun = left[out[left, n + STATUS] == UNBEGUN]
    if unbegun.size:
        first = seeds[:, 0] if seeds.shape[1] else chain.base[:, chain.q_index]
        out[unbegun, :n] = first[unbegun] if len(first) > 1 else first
        out[unbegun, n:] = 0.0
        _measure_late_rows(problem, targets, unbegun, out, alike=len(first) == 1)
    far = 0
    if postpone:
        left = left[out[left, n + STATUS] == NOT_FOUND]
        beyond = left[measure_reach_excess(problem, targets[left]) > 0.0]
        out[beyond, n + STATUS] = Status.OUT_OF_REACH
        far = len(beyond)
    return continue_search(problem, targets, head, count, out, threads) + far + len(unbegun)


def run_one_start(problem: FrameProblem, head: tuple[Any, ...], start: int, steps: int) -> Array:
    """Run one start for some steps and return its answer (1, n + ANSWER).

    `head` is as in `continue_search`.
    """
    found = np.empty((1, len(problem.chain.q_index) + ANSWER))
    _choose_kernel(problem.chain)(*head, start, 1, steps, *problem.tolerance, 0.0, found)
    return found


def continue_search(
    problem: FrameProblem,
    targets: Array,
    head: tuple[Any, ...],
    done: int,
    out: Array,
    threads: int | None = 1,
) -> int:
    """Continue the search after the first `done` starts, and count the unreached targets.

    Targets that are NOT_FOUND in `out` are searched.

    head: the first arguments of the kernels. Where tolerances are loose, starts that weigh position
    and orientation by them; more starts, unless lengths prove that they cannot help or the time is
    up; at last, the nearest configurations.
    """
    n = out.shape[1] - ANSWER
    every = left = np.flatnonzero(out[:, n + STATUS] == NOT_FOUND)
    if not left.size:
        return 0
    # before lengths are asked
    left, done = _search_unreached_rows(
        problem, head, left, done, min(problem.starts, FEW), out, threads
    )
    left = left[measure_reach_excess(problem, targets[left]) == 0.0]
    linear, angular = problem.tolerance
    if max(linear, angular) > LOOSE and any(problem.mask[:3]) and any(problem.mask[3:]):
        for share in SHARES:
            left = left[out[left, n + STATUS] == NOT_FOUND]
            found = np.empty((len(left), out.shape[1]))
            found[:, n + STATUS] = UNBEGUN
            starts = min(problem.starts, 4 * FEW)
            _run_starts(problem, head, left, 0, starts, share * linear / angular, found, threads)
            found[:, n + STEPS :] += out[left, n + STEPS :]
            good = found[:, n + STATUS] == SOLVED
            out[left[good]] = found[good]
    left = left[out[left, n + STATUS] == NOT_FOUND]
    left, done = _search_unreached_rows(problem, head, left, done, problem.starts, out, threads)
    if done < problem.starts and len(left):
        _measure_late_rows(problem, targets, left, out)
    return _search_from_nearest(
        problem, targets, head, every[out[every, n + STATUS] == NOT_FOUND], out, threads
    ) + int((out[every, n + STATUS] == Status.OUT_OF_TIME).sum())


def _search_from_nearest(
    problem: FrameProblem,
    targets: Array,
    head: tuple[Any, ...],
    rows: np.ndarray,
    out: Array,
    threads: int | None,
) -> int:
    """Search from the configurations nearest to the targets, and count unreached rows."""
    n = out.shape[1] - ANSWER
    length = compute_characteristic_length(problem.system)
    nearest: Callable[..., int] = compiled.fallback.approach_goals
    out[rows, n + LINEAR] = np.inf  # energies in another unit: descents begin there

    each = [0] if problem.share == 1 else range(1, min(problem.starts, DESCENTS) + 1)

    def search_rows(i: int, j: int) -> int:
        some = rows[i:j]
        missed = 0
        own = _select_rows(head, some)
        found = out[some]
        if time.monotonic() >= problem.end:
            _measure_late_rows(problem, targets, some, out)
            return len(some)
        for only in each:
            check_for_stop()
            if only > 1 and time.monotonic() >= problem.end:
                _measure_late_rows(problem, targets, some, out)
                return len(some)
            missed = nearest(
                *own, only, problem.starts, problem.iterations, *problem.tolerance, length, found
            )
            out[some] = found
        if missed and problem.chain.span.wide and not problem.chain.ints[HAS_QUATERNION]:
            from kempe.inverse.refine import repeat_search

            missed = repeat_search(problem, targets[some], own, found)
        out[some] = found
        return missed

    piece = max(1, NEAREST // problem.share)
    return sum_over_chunks(search_rows, len(rows), piece, threads, 2 * piece) if len(rows) else 0


def _select_rows(head: tuple[Any, ...], rows: Any) -> tuple[Any, ...]:
    """Select the first arguments of kernels for some rows."""
    *chain, goals, seeds, rng = head
    return (*chain, goals[rows], seeds[rows] if len(seeds) > 1 else seeds, rng)


def _run_starts(
    problem: FrameProblem,
    head: tuple[Any, ...],
    rows: Any,
    first: int,
    count: int,
    length: float,
    out: Array,
    threads: int | None,
    chunk: int | None = None,
) -> None:
    """Run some starts for these rows and write their answers, until the time is up."""
    search = _choose_kernel(problem.chain)
    given = _select_rows(head, rows) if isinstance(rows, np.ndarray) else head
    piece = max(LANES, min(chunk or CHUNK, WORK // (count * problem.share)))

    def run_pieces(i: int, j: int) -> int:
        for k in range(i, j, piece):
            check_for_stop()
            if time.monotonic() >= problem.end:
                break
            last = min(k + piece, j)
            search(
                *_select_rows(given, slice(k, last)),
                first,
                count,
                problem.iterations,
                *problem.tolerance,
                length,
                out[k:last],
            )
        return 0

    sum_over_chunks(
        run_pieces, len(out), chunk or piece, threads, SERIAL_BELOW if chunk else 2 * piece
    )


def _search_unreached_rows(
    problem: FrameProblem,
    head: tuple[Any, ...],
    left: np.ndarray,
    done: int,
    starts: int,
    out: Array,
    threads: int | None,
) -> tuple[np.ndarray, int]:
    """Run starts up to a number; return the rows still unreached, and the starts made."""
    while done < starts and len(left):
        count = min(problem.round or starts, starts - done)
        some = _run_further_starts(problem, head, left, done, count, out, threads)
        if some is None:
            break
        left = some
        done = done + count
    return left, done


def _run_further_starts(
    problem: FrameProblem,
    head: tuple[Any, ...],
    rows: np.ndarray,
    first: int,
    count: int,
    out: Array,
    threads: int | None,
) -> np.ndarray | None:
    """Run further starts; return the rows still unreached, None if there was no time.

    Answers that are better than the first are written.
    """
    n = out.shape[1] - ANSWER
    found = np.empty((len(rows), out.shape[1]))
    found[:, n + STATUS] = UNBEGUN
    _run_starts(problem, head, rows, first, count, 0.0, found, threads)
    begun = found[:, n + STATUS] != UNBEGUN
    if not begun.any():
        return None
    some, found = (rows, found) if begun.all() else (rows[begun], found[begun])
    found[:, n + STARTS] += first
    found[:, n + STEPS] += out[some, n + STEPS]
    better = (found[:, n + STATUS] == SOLVED) | (found[:, n + LINEAR] < out[some, n + LINEAR])
    out[some[better]] = found[better]
    out[some, n + STEPS :] = found[:, n + STEPS :]
    return rows[out[rows, n + STATUS] == NOT_FOUND]


def _measure_late_rows(
    problem: FrameProblem, targets: Array, left: np.ndarray, out: Array, alike: bool = False
) -> None:
    """Measure these rows as they are when the time is up."""
    n = out.shape[1] - ANSWER
    out[left, n + STATUS] = Status.OUT_OF_TIME
    out[left, n : n + STATUS] = compute_errors(
        problem, targets[left], out[left[:1] if alike else left, :n]
    )


def _choose_kernel(chain: Chain) -> Callable[..., int]:
    """Choose the kernel that searches for a chain."""
    if chain.ints[HAS_QUATERNION]:
        return compiled.scalar_search.reach_goals_singly
    return schedule.reach_goals


# ---- all targets of a problem, and their starts


def solve_targets(
    problem: FrameProblem,
    seeds: Array,
    threads: int | None = 1,
    limits: Array | None = None,
    targets: Array | None = None,
    postpone: bool = False,
) -> tuple[Array, Array, np.ndarray]:
    """Solve all targets in fixed chunks: configurations of the chain, residuals (N, 2), info.

    The info is (status, steps, starts) (N, 3).

    `postpone` is as in `multi_start.search_targets`.
    """
    chain = problem.chain
    goals = problem.targets if targets is None else targets
    n = len(goals)
    nq = len(chain.q_index)
    out = np.empty((n, nq + ANSWER))
    bounds = chain.limits if limits is None else limits

    search_targets(problem, goals, seeds, bounds, out, postpone, threads)
    return out[:, :nq], out[:, nq + LINEAR : nq + STATUS], out[:, nq + STATUS :].astype(np.int64)


def make_seeds(
    system: Model, chain: Chain, start: Any, lead: tuple[int, ...]
) -> tuple[Array, Array]:
    """Make start configurations (1 or N, nq), and their part of the chain (1 or N, K, nq)."""
    if start is None:
        return chain.base, chain.no_seed
    base = read_start(system, start)
    base = np.array(base.reshape(math.prod(base.shape[:-1]), system.nq))
    if not lead and not np.all(np.abs(base) < LARGEST):
        refuse_large_numbers(system, base, "start")
    # the kernel brings them inside, circles by turns
    seeds = np.ascontiguousarray(base[:, None, chain.q_index])
    return move_inside_limits(system, base), seeds
