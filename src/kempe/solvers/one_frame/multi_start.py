"""The search for configurations that reach single targets: rounds of starts, then what is nearest."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.kernels.base.search_layout import ANSWER, LINEAR, NOT_FOUND, SOLVED, STARTS, STATUS, STEPS
from kempe.kernels.compiled import schedule
from kempe.kernels.forward.table_layout import HAS_QUATERNION
from kempe.model.tree.characteristic_length import characteristic_length
from kempe.solvers.common.proofs import by_lengths
from kempe.solvers.common.serial_chain import Chain
from kempe.solvers.common.targets import TASKS, Z_AXIS, frame_of, points_along
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.system import System

MOST = 1000
"""Starts before a target is given up. Most succeed with the first; one in a hundred thousand needs more than 100."""
GLANCE = 16
"""Starts after which a batch goes on, where what is nearest to such targets can wait."""
HARD = 8
"""So few targets of a chunk that are not reached by then are more likely hard than out of reach: first they go on."""
FEW = 64
"""Starts after which it is checked whether lengths put a target out of reach: then it is given up."""
ITERATIONS = 40
"""Steps of one start; those that converge need 5 to 9, few as many as 40, and hopeless ones are given up before."""
TOLERANCE = (1e-6, 1e-6)
"""Largest position error [m] and rotation angle [rad] of a success."""
ROUND = 32
"""Starts of a round, after which one looks at the clock, where there is a time limit."""
LOOSE = 1e-4
"""Tolerance from which the nearest configuration may be the wrong one: another, farther off, may be within it."""
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
    task: FrameProblem, targets: Array, seeds: Array, limits: Array, out: Array, postpone: bool = False
) -> int:  # fmt: skip
    """Number of targets (N, 4, 4) not reached; writes the answers (N, n + ANSWER) as `search.reach` does.

    seeds: (1 or N, K, n); limits: (2, nv). With `postpone`, what is nearest to targets that lengths prove to be out of
    reach is not searched for: their status is OUT_OF_REACH.
    """
    chain = task.chain
    head = (chain.ints, chain.floats, limits, rows_of(task), goals_of(task, targets), seeds, task.rng)
    count = min(task.starts, FEW if task.time_limit is None else ROUND)
    n = out.shape[1] - ANSWER
    if postpone and count > GLANCE:
        if not _search(chain)(*head, 0, GLANCE, task.iterations, *task.tolerance, 0.0, out):
            return 0
        left = np.flatnonzero(out[:, n + STATUS] == NOT_FOUND)
        hard = len(left) <= HARD
        left = _more(task, head, left, GLANCE, count - GLANCE, out) if hard else left
        far = outside(task, targets[left]) > 0.0 if len(left) else np.zeros(0, dtype=bool)
        out[left[far], n + STATUS] = Status.OUT_OF_REACH
        left = left[~far]
        left = left if hard else _more(task, head, left, GLANCE, count - GLANCE, out)
        return go_on(task, targets, head, count, out) if len(left) else int(far.sum())
    if time.monotonic() < task.end:
        if not _search(chain)(*head, 0, count, task.iterations, *task.tolerance, 0.0, out):
            return 0
        return go_on(task, targets, head, count, out)
    out[:, :n], out[:, n:] = seeds[:, 0] if seeds.shape[1] else chain.base[:, chain.q_index], 0.0
    _end(task, targets, np.arange(len(out)), out)
    return len(out)


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


def go_on(task: FrameProblem, targets: Array, head: tuple[Any, ...], done: int, out: Array) -> int:
    """Number of targets not reached in the end, of those that the first `done` starts left.

    head: the first arguments of the kernels. Where tolerances are loose, starts that weigh position and orientation
    by them; more starts, unless lengths prove that they cannot help or the time is up; at last, the nearest
    configurations.
    """
    from kempe.kernels.compiled import fallback

    n = out.shape[1] - ANSWER
    left = np.flatnonzero(out[:, n + STATUS] == NOT_FOUND)
    left = left[outside(task, targets[left]) == 0.0]
    linear, angular = task.tolerance
    if max(linear, angular) > LOOSE and any(task.mask[:3]) and any(task.mask[3:]):
        for share in SHARES:
            left = left[out[left, n + STATUS] == NOT_FOUND]
            found = _some(task, head, left, 0, min(task.starts, 4 * FEW), share * linear / angular)
            found[:, n + STEPS :] += out[left, n + STEPS :]
            good = found[:, n + STATUS] == SOLVED
            out[left[good]] = found[good]
    left = left[out[left, n + STATUS] == NOT_FOUND]
    while done < task.starts and len(left) and time.monotonic() < task.end:
        count = task.starts - done if task.time_limit is None else min(ROUND, task.starts - done)
        left, done = _more(task, head, left, done, count, out), done + count
    if done < task.starts and len(left):
        _end(task, targets, left, out)
    nearest: Callable[..., int] = fallback.approach
    out[out[:, n + STATUS] == NOT_FOUND, n + LINEAR] = np.inf  # energies in another unit: descents begin there
    missed = nearest(*head, 0, task.starts, task.iterations, *task.tolerance, characteristic_length(task.system), out)
    if missed and task.chain.span.wide and not task.chain.ints[HAS_QUATERNION]:
        from kempe.solvers.one_frame.sharpen import search_again

        return search_again(task, targets, head, out)
    return missed


def _some(task: FrameProblem, head: tuple[Any, ...], rows: np.ndarray, first: int, count: int, length: float) -> Array:
    """Answers (k, n + ANSWER) of some starts for these rows; `head` as in `go_on`."""
    *chain, goals, seeds, rng = head
    own = seeds[rows] if len(seeds) > 1 else seeds
    found = np.empty((len(rows), len(task.chain.q_index) + ANSWER))
    search_ = _search(task.chain)
    search_(*chain, goals[rows], own, rng, first, count, task.iterations, *task.tolerance, length, found)
    return found


def _more(
    task: FrameProblem, head: tuple[Any, ...], rows: np.ndarray, first: int, count: int, out: Array
) -> np.ndarray:
    """The rows that are still not reached after further starts; answers that are better than the first are written."""
    if not len(rows):
        return rows
    n = out.shape[1] - ANSWER
    found = _some(task, head, rows, first, count, 0.0)
    found[:, n + STARTS] += first
    found[:, n + STEPS] += out[rows, n + STEPS]
    better = (found[:, n + STATUS] == SOLVED) | (found[:, n + LINEAR] < out[rows, n + LINEAR])
    out[rows[better]] = found[better]
    out[rows, n + STEPS :] = found[:, n + STEPS :]
    return rows[out[rows, n + STATUS] == NOT_FOUND]


def _end(task: FrameProblem, targets: Array, left: np.ndarray, out: Array) -> None:
    """Measure these rows as they are: the time is up."""
    n = out.shape[1] - ANSWER
    out[left, n + STATUS] = Status.OUT_OF_TIME
    out[left, n : n + STATUS] = misses(task, targets[left], out[left, :n])


def misses(task: FrameProblem, targets: Array, q: Array) -> Array:
    """Linear and angular errors (N, 2), by the forward model, of a chain's configurations (N, n)."""
    from kempe.kinematics.forward import fk

    full = np.repeat(task.chain.base, len(q), axis=0)
    full[:, task.chain.q_index] = q
    X, out = fk(task.system, full, task.frame, threads=1), np.zeros((len(q), 2))
    if any(task.mask[:3]):
        out[:, 0] = np.linalg.norm(X[:, :3, 3] - targets[:, :3, 3], axis=-1)
    if points_along(task.name):
        a, b = (Y[:, :3, :3] @ np.array(task.axis) for Y in (X, targets))
        out[:, 1] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))
    elif any(task.mask[3:]):
        out[:, 1] = np.linalg.norm(spatial.log_so3(np.swapaxes(X[:, :3, :3], 1, 2) @ targets[:, :3, :3]), axis=-1)
    return out


def _search(chain: Chain) -> Callable[..., int]:
    """The kernel that searches for a chain."""
    if chain.ints[HAS_QUATERNION]:
        from kempe.kernels.compiled import scalar_search

        return scalar_search.reach_one_by_one
    return schedule.reach


def outside(task: FrameProblem, targets: Array) -> Array:
    """How far (N,) targets are outside the reach bounds, in metres, for a point of the frame that each one fixes.

    Zero within what the tolerances allow. With the target's orientation, it is a lower bound of the position error.
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
    """How far (N, 2) in metres targets are past what the lengths of the links reach; see `proofs.by_lengths`."""
    free = len(task.chain.v_index) >= (3 if task.system.dim == 2 else sum(task.mask))  # else that is the reason
    along = np.array(task.axis) if free and points_along(task.name) else None
    return by_lengths(task.chain.bounds, targets, task.tolerance, free and all(task.mask), along=along)
