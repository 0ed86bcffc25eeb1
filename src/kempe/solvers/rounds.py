"""The search for single targets within a time limit: rounds of starts, with a look at the clock before each."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.kernels.job import ANSWER, LINEAR, STATUS, STEPS
from kempe.kinematics.forward import fk
from kempe.solvers.solution import NOT_FOUND, OUT_OF_TIME
from kempe.solvers.targets import Z_AXIS, frame_of, points_along
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.inverse import Task

ROUND = 32
"""Starts of a round."""
FEW = 64
"""Targets of a round."""


def in_time(
    task: Task, search: Callable[..., int], approach: Callable[..., int], arguments: tuple[Any, ...]
) -> int:  # fmt: skip
    """Number of targets not reached; answers as `search` and then `approach` write them, unless the time is up before.

    `arguments` are those of the kernels. Where the time runs out, the answer is the nearest found, or the first start.
    """
    *head, goals, seeds, rng, offset, tries, steps, linear, angular, length, out = arguments
    missed = 0
    for i in range(0, len(goals), FEW):
        some = slice(i, i + FEW)
        first = seeds[some] if len(seeds) > 1 else seeds
        missed += _rounds(task, search, approach, (
            *head, goals[some], first, rng, offset + i, tries, steps, linear, angular, length, out[some],
        ))  # fmt: skip
    return missed


def _rounds(task: Task, search: Callable[..., int], approach: Callable[..., int], arguments: tuple[Any, ...]) -> int:
    *head, goals, seeds, rng, offset, tries, steps, linear, angular, length, out = arguments
    nq = out.shape[1] - ANSWER
    out[:, :nq] = seeds[:, 0] if seeds.shape[1] else task.chain.base[:, task.chain.q_index]
    out[:, nq:], out[:, nq + LINEAR], out[:, nq + STATUS] = 0.0, np.inf, NOT_FOUND
    left, done = np.arange(len(goals)), 0

    def asked(row: Array, number: int, count: int) -> tuple[Any, ...]:
        first = seeds[left] if len(seeds) > 1 else seeds
        return (*head, goals[left], first, number, offset, count, steps, linear, angular, length, row)

    while len(left) and done < tries and time.monotonic() < task.end:
        found, count = np.empty((len(left), out.shape[1])), min(ROUND, tries - done)
        search(*asked(found, rng + done, count))
        better = (found[:, nq + STATUS] != NOT_FOUND) | ~(found[:, nq + LINEAR] >= out[left, nq + LINEAR])
        work = out[left, nq + STEPS :] + found[:, nq + STEPS :]
        out[left[better]] = found[better]
        out[left, nq + STEPS :] = work
        left, done = left[found[:, nq + STATUS] == NOT_FOUND], done + count
    if len(left) and done == tries:
        rest = out[left]
        approach(*asked(rest, rng, tries))
        out[left] = rest
    elif len(left):
        out[left, nq + STATUS] = OUT_OF_TIME
        out[left, nq : nq + STATUS] = misses(task, goals[left], out[left, :nq])
    return len(left)


def misses(task: Task, goals: Array, q: Array) -> Array:
    """Linear and angular errors (N, 2) of a chain's configurations (N, n); goals (N, 4, 4) have `task.axis` as z."""
    full = np.repeat(task.chain.base, len(q), axis=0)
    full[:, task.chain.q_index] = q
    X, out = fk(task.system, full, task.frame, threads=1), np.zeros((len(q), 2))
    if any(task.mask[:3]):
        out[:, 0] = np.linalg.norm(X[:, :3, 3] - goals[:, :3, 3], axis=-1)
    if any(task.mask[3:]):
        turn = np.eye(3) if task.axis == Z_AXIS else frame_of(np.array(task.axis))
        D = X[:, :3, :3] @ turn - goals[:, :3, :3]
        if points_along(task.name):
            out[:, 1] = 2.0 * np.arcsin(np.minimum(np.linalg.norm(D[:, :, 2], axis=-1) / 2.0, 1.0))
        else:
            out[:, 1] = 2.0 * np.arcsin(np.minimum(np.sqrt((D * D).sum(axis=(-1, -2)) / 8.0), 1.0))
    return out
