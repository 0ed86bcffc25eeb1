"""The search for configurations that reach single targets: rounds of starts, then what is nearest."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.budget import look
from kempe.kernels.base.search_layout import (
    ANSWER,
    DESCENTS,
    LINEAR,
    NOT_FOUND,
    SOLVED,
    STARTS,
    STATUS,
    STEPS,
)
from kempe.kernels.compiled import schedule
from kempe.kernels.forward.table_layout import HAS_QUATERNION
from kempe.kinematics.common.parallel import over_chunks
from kempe.model.tree.characteristic_length import characteristic_length
from kempe.solvers.common.proofs import by_lengths
from kempe.solvers.common.serial_chain import Chain
from kempe.solvers.common.targets import TASKS, Z_AXIS, frame_of, points_along
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.system import System

MOST = 1000
"""Starts before a target is given up. Most succeed with the first; one in a hundred thousand needs
more than 100."""
GLANCE = 16
"""Starts after which a batch goes on, where what is nearest to such targets can wait."""
FEW = 64
"""Starts after which it is checked whether lengths put a target out of reach: then it is given
up."""
ITERATIONS = 40
"""Steps of one start; those that converge need 5 to 9, few as many as 40, and hopeless ones are
given up before."""
TOLERANCE = (1e-6, 1e-6)
"""Largest position error [m] and rotation angle [rad] of a success."""
ROUND = 32
"""Starts of a round where there is a time limit: all targets get these before one gets more."""
CHUNK = 256
SERIAL_BELOW = 1024
LANES = 8
WORK = 4096
NEAREST = 64
"""Targets of a chunk, and from how many on there are threads; the targets that are searched side by
side; starts of all targets together, and targets whose nearest configuration is searched for,
between two looks at the clock."""
LONG = 16
"""Coordinates of a chain, twice which make it long: rounds are shorter by the square of its length
in these."""
UNBEGUN = -1.0
"""In place of the status of an answer: the time was up before."""
LOOSE = 1e-4
"""Tolerance from which the nearest configuration may be the wrong one: another, farther off, may be
within it."""
SHARES = (1.0, 0.2, 5.0)
"""How the two tolerances are weighed against each other where they are loose."""


@dataclass(frozen=True, eq=False)
class FrameProblem:
    """What was required of the solver: kept with the answer, so that it can say why it failed."""

    system: System
    frame: str
    targets: Array = field(repr=False)
    name: str
    """One of `TASKS`."""
    axis: tuple[float, float, float]
    """The direction of the tool that is pointed, for tasks that point one."""
    tolerance: tuple[float, float]
    starts: int
    rng: int
    chain: Chain = field(repr=False)
    """The chain of the frame, its z axis turned to `axis`."""
    iterations: int = ITERATIONS
    time_limit: float | None = None
    end: float = math.inf
    """When the time is up, by `time.monotonic`."""
    usual: bool = False
    """Whether nobody named the time limit."""

    @property
    def share(self) -> int:
        """How many times as long a start takes as of a chain that is not long."""
        return max(1, len(self.chain.q_index) // LONG) ** 2

    @property
    def round(self) -> int | None:
        """Starts between two looks at the clock; None: as many as come next."""
        no = self.time_limit is None or (self.usual and self.share == 1)
        return None if no else max(1, ROUND // self.share)

    @property
    def mask(self) -> tuple[int, ...]:
        """Which errors [linear; angular] in the frame of the tip count, its z axis being `axis`."""
        return TASKS[self.name]


def rows_of(task: FrameProblem) -> np.ndarray:
    """What the kernel reads of a task: six rows, whether an axis is pointed, circular coordinates."""
    pointed = points_along(task.name)
    rows = (*task.mask[:5], 1, 1) if pointed else (*task.mask, 0)
    return np.concatenate([np.array(rows, dtype=np.int64), task.chain.circular])


def answered(
    task: FrameProblem,
    targets: Array,
    seeds: Array,
    limits: Array,
    out: Array,
    postpone: bool = False,
    threads: int | None = 1,
) -> int:
    """Number of targets (N, 4, 4) not reached; writes the answers (N, n + ANSWER) as `search.reach`
    does.

    seeds: (1 or N, K, n); limits: (2, nv). With `postpone`, what is nearest to targets that lengths
    prove to be out of reach is not searched for: their status is OUT_OF_REACH.

    All targets get their first starts before one gets its last. Between two pieces of the work,
    which take about 0.1 s, Python sees an interrupt, and the clock is looked at.
    """
    chain = task.chain
    n = out.shape[1] - ANSWER
    head = (
        chain.ints,
        chain.floats,
        limits,
        rows_of(task),
        goals_of(task, targets),
        seeds,
        task.rng,
    )
    few = task.round or FEW
    count = min(task.starts, few, GLANCE if postpone else few)
    out[:, n + STATUS] = UNBEGUN
    _some(task, head, slice(None), 0, count, 0.0, out, threads, CHUNK)
    left = np.flatnonzero(out[:, n + STATUS] != SOLVED)
    if not left.size:
        return 0
    unbegun = left[out[left, n + STATUS] == UNBEGUN]
    if unbegun.size:
        first = seeds[:, 0] if seeds.shape[1] else chain.base[:, chain.q_index]
        out[unbegun, :n] = first[unbegun] if len(first) > 1 else first
        out[unbegun, n:] = 0.0
        _end(task, targets, unbegun, out, alike=len(first) == 1)
    far = 0
    if postpone:
        left = left[out[left, n + STATUS] == NOT_FOUND]
        beyond = left[outside(task, targets[left]) > 0.0]
        out[beyond, n + STATUS] = Status.OUT_OF_REACH
        far = len(beyond)
    return go_on(task, targets, head, count, out, threads) + far + len(unbegun)


def goals_of(task: FrameProblem, targets: Array) -> Array:
    """Targets (N, 4, 4) with the z axis that kernels point."""
    goals = targets
    if task.axis != Z_AXIS:
        goals = goals.copy()
        goals[:, :3, :3] = goals[:, :3, :3] @ frame_of(np.array(task.axis))
    return goals


def starts_from(task: FrameProblem, head: tuple[Any, ...], start: int, steps: int) -> Array:
    """The answer (1, n + ANSWER) of one start after so many steps; `head` as in `go_on`."""
    found = np.empty((1, len(task.chain.q_index) + ANSWER))
    _search(task.chain)(*head, start, 1, steps, *task.tolerance, 0.0, found)
    return found


def go_on(
    task: FrameProblem,
    targets: Array,
    head: tuple[Any, ...],
    done: int,
    out: Array,
    threads: int | None = 1,
) -> int:
    """Number of targets NOT_FOUND in `out` that are not reached in the end, after the first `done`
    starts.

    head: the first arguments of the kernels. Where tolerances are loose, starts that weigh position
    and orientation by them; more starts, unless lengths prove that they cannot help or the time is
    up; at last, the nearest configurations.
    """
    n = out.shape[1] - ANSWER
    every = left = np.flatnonzero(out[:, n + STATUS] == NOT_FOUND)
    if not left.size:
        return 0
    left, done = _up_to(
        task, head, left, done, min(task.starts, FEW), out, threads
    )  # before lengths are asked
    left = left[outside(task, targets[left]) == 0.0]
    linear, angular = task.tolerance
    if max(linear, angular) > LOOSE and any(task.mask[:3]) and any(task.mask[3:]):
        for share in SHARES:
            left = left[out[left, n + STATUS] == NOT_FOUND]
            found = np.empty((len(left), out.shape[1]))
            found[:, n + STATUS] = UNBEGUN
            starts = min(task.starts, 4 * FEW)
            _some(task, head, left, 0, starts, share * linear / angular, found, threads)
            found[:, n + STEPS :] += out[left, n + STEPS :]
            good = found[:, n + STATUS] == SOLVED
            out[left[good]] = found[good]
    left = left[out[left, n + STATUS] == NOT_FOUND]
    left, done = _up_to(task, head, left, done, task.starts, out, threads)
    if done < task.starts and len(left):
        _end(task, targets, left, out)
    return _nearest(
        task, targets, head, every[out[every, n + STATUS] == NOT_FOUND], out, threads
    ) + int((out[every, n + STATUS] == Status.OUT_OF_TIME).sum())


def _nearest(
    task: FrameProblem,
    targets: Array,
    head: tuple[Any, ...],
    rows: np.ndarray,
    out: Array,
    threads: int | None,
) -> int:
    """Number of these rows that are not reached by the configurations nearest to their targets
    either.
    """
    from kempe.kernels.compiled import fallback

    n = out.shape[1] - ANSWER
    length = characteristic_length(task.system)
    nearest: Callable[..., int] = fallback.approach
    out[rows, n + LINEAR] = np.inf  # energies in another unit: descents begin there

    each = [0] if task.share == 1 else range(1, min(task.starts, DESCENTS) + 1)

    def work(i: int, j: int) -> int:
        some = rows[i:j]
        missed = 0
        own = _part(head, some)
        found = out[some]
        if time.monotonic() >= task.end:
            _end(task, targets, some, out)
            return len(some)
        for only in each:
            look()
            if only > 1 and time.monotonic() >= task.end:
                _end(task, targets, some, out)
                return len(some)
            missed = nearest(
                *own, only, task.starts, task.iterations, *task.tolerance, length, found
            )
            out[some] = found
        if missed and task.chain.span.wide and not task.chain.ints[HAS_QUATERNION]:
            from kempe.solvers.one_frame.sharpen import search_again

            missed = search_again(task, targets[some], own, found)
        out[some] = found
        return missed

    piece = max(1, NEAREST // task.share)
    return over_chunks(work, len(rows), piece, threads, 2 * piece) if len(rows) else 0


def _part(head: tuple[Any, ...], rows: Any) -> tuple[Any, ...]:
    """The first arguments of the kernels for some rows."""
    *chain, goals, seeds, rng = head
    return (*chain, goals[rows], seeds[rows] if len(seeds) > 1 else seeds, rng)


def _some(
    task: FrameProblem,
    head: tuple[Any, ...],
    rows: Any,
    first: int,
    count: int,
    length: float,
    out: Array,
    threads: int | None,
    chunk: int | None = None,
) -> None:
    """Write the answers (k, n + ANSWER) of some starts for these rows, until the time is up; `head`
    as in `go_on`.
    """
    search = _search(task.chain)
    given = _part(head, rows) if isinstance(rows, np.ndarray) else head
    piece = max(LANES, min(chunk or CHUNK, WORK // (count * task.share)))

    def work(i: int, j: int) -> int:
        for k in range(i, j, piece):
            look()
            if time.monotonic() >= task.end:
                break
            last = min(k + piece, j)
            search(
                *_part(given, slice(k, last)),
                first,
                count,
                task.iterations,
                *task.tolerance,
                length,
                out[k:last],
            )
        return 0

    over_chunks(work, len(out), chunk or piece, threads, SERIAL_BELOW if chunk else 2 * piece)


def _up_to(
    task: FrameProblem,
    head: tuple[Any, ...],
    left: np.ndarray,
    done: int,
    starts: int,
    out: Array,
    threads: int | None,
) -> tuple[np.ndarray, int]:
    """The rows that are still not reached after so many starts, or when the time is up, and how
    many these are.
    """
    while done < starts and len(left):
        count = min(task.round or starts, starts - done)
        some = _more(task, head, left, done, count, out, threads)
        if some is None:
            break
        left = some
        done = done + count
    return left, done


def _more(
    task: FrameProblem,
    head: tuple[Any, ...],
    rows: np.ndarray,
    first: int,
    count: int,
    out: Array,
    threads: int | None,
) -> np.ndarray | None:
    """The rows that are still not reached after further starts; None where there was no time for
    any.

    Answers that are better than the first are written.
    """
    n = out.shape[1] - ANSWER
    found = np.empty((len(rows), out.shape[1]))
    found[:, n + STATUS] = UNBEGUN
    _some(task, head, rows, first, count, 0.0, found, threads)
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


def _end(
    task: FrameProblem, targets: Array, left: np.ndarray, out: Array, alike: bool = False
) -> None:
    """Measure these rows as they are: the time is up. Whether their configurations are all `alike`."""
    n = out.shape[1] - ANSWER
    out[left, n + STATUS] = Status.OUT_OF_TIME
    out[left, n : n + STATUS] = misses(task, targets[left], out[left[:1] if alike else left, :n])


def misses(task: FrameProblem, targets: Array, q: Array) -> Array:
    """Linear and angular errors (N, 2), by the forward model, of a chain's configurations (N or 1,
    n).
    """
    from kempe.kinematics.forward import fk

    full = np.repeat(task.chain.base, len(q), axis=0)
    full[:, task.chain.q_index] = q
    X = fk(task.system, full, task.frame, threads=1)
    out = np.zeros((len(targets), 2))
    if any(task.mask[:3]):
        out[:, 0] = np.linalg.norm(X[:, :3, 3] - targets[:, :3, 3], axis=-1)
    if points_along(task.name):
        a, b = (Y[:, :3, :3] @ np.array(task.axis) for Y in (X, targets))
        out[:, 1] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))
    elif any(task.mask[3:]):
        out[:, 1] = np.linalg.norm(
            spatial.log_so3(np.swapaxes(X[:, :3, :3], 1, 2) @ targets[:, :3, :3]), axis=-1
        )
    return out


def _search(chain: Chain) -> Callable[..., int]:
    """The kernel that searches for a chain."""
    if chain.ints[HAS_QUATERNION]:
        from kempe.kernels.compiled import scalar_search

        return scalar_search.reach_one_by_one
    return schedule.reach


def outside(task: FrameProblem, targets: Array) -> Array:
    """How far (N,) targets are outside the reach bounds, in metres, for a point of the frame that
    each one fixes.

    Zero within what the tolerances allow. With the target's orientation, it is a lower bound of the
    position error.
    """
    if not task.mask[0]:
        return np.zeros(len(targets))
    out = np.abs(targets[:, 2, 3]) if task.system.dim == 2 else np.zeros(len(targets))
    out[out <= task.tolerance[0]] = 0.0
    return np.maximum(out, past_lengths(task, targets).max(axis=-1))


def look_closer(task: FrameProblem, code: np.ndarray) -> None:
    """Tell, in place, targets that lengths alone put out of reach from those that were not found."""
    failed = np.flatnonzero((code == Status.NOT_FOUND) | (code == Status.OUT_OF_TIME))
    code[failed[outside(task, task.targets[failed]) > 0.0]] = Status.OUT_OF_REACH


def past_lengths(task: FrameProblem, targets: Array) -> Array:
    """How far (N, 2) in metres targets are past what the lengths of the links reach; see
    `proofs.by_lengths`.
    """
    free = len(task.chain.v_index) >= (
        3 if task.system.dim == 2 else sum(task.mask)
    )  # else that is the reason
    along = np.array(task.axis) if free and points_along(task.name) else None
    return by_lengths(
        task.chain.bounds, targets, task.tolerance, free and all(task.mask), along=along
    )
