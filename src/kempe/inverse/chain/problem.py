"""The numerical inverse problem of one frame: its data, errors and reach."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.answers.targets import TASKS, is_axis_task
from kempe.inverse.chain.serial_chain import Chain
from kempe.numerics.length_bounds import measure_bound_excess
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.model import Model

MOST = 1000
"""Starts before a target is given up. Most succeed with the first; one in a hundred thousand needs
more than 100."""
FEW = 64
"""Starts after which it is checked whether lengths put a target out of reach: then it is given
up."""
ITERATIONS = 40
"""Steps of one start; those that converge need 5 to 9, few as many as 40, and hopeless ones are
given up before."""
TOLERANCE = 1e-6
"""Largest position error [m] and rotation angle [rad] of a success; see `make_tolerance`."""
ROUND = 32
"""Starts of a round where there is a time limit: all targets get these before one gets more."""
LONG = 16
"""Coordinates of a chain, twice which make it long: rounds are shorter by the square of its length
in these."""


@dataclass(frozen=True, eq=False)
class FrameProblem:
    """An inverse problem of one frame: targets, tolerances, starts and time limit.

    The answer keeps it, to explain failures.
    """

    system: Model
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
        """Time of one start, relative to a start of a short chain."""
        return max(1, len(self.chain.q_index) // LONG) ** 2

    @property
    def round(self) -> int | None:
        """Number of starts between two checks of the clock; None for no limit."""
        no = self.time_limit is None or (self.usual and self.share == 1)
        return None if no else max(1, ROUND // self.share)

    @property
    def mask(self) -> tuple[int, ...]:
        """Mask (6,) of the error rows [linear; angular], in the tip's frame, that the task uses."""
        return TASKS[self.name]


def pack_row_flags(problem: FrameProblem) -> np.ndarray:
    """Pack the rows that count, whether an axis is pointed, and circular coordinates, for kernels."""
    pointed = is_axis_task(problem.name)
    rows = (*problem.mask[:5], 1, 1) if pointed else (*problem.mask, 0)
    return np.concatenate([np.array(rows, dtype=np.int64), problem.chain.circular])


def compute_errors(problem: FrameProblem, targets: Array, q: Array) -> Array:
    """Compute linear and angular errors (N, 2) of configurations (N or 1, n) of a chain."""
    from kempe.forward.fk import fk

    full = np.repeat(problem.chain.base, len(q), axis=0)
    full[:, problem.chain.q_index] = q
    X = fk(problem.system, full, problem.frame, threads=1)
    out = np.zeros((len(targets), 2))
    if any(problem.mask[:3]):
        out[:, 0] = np.linalg.norm(X[:, :3, 3] - targets[:, :3, 3], axis=-1)
    if is_axis_task(problem.name):
        a, b = (Y[:, :3, :3] @ np.array(problem.axis) for Y in (X, targets))
        out[:, 1] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))
    elif any(problem.mask[3:]):
        out[:, 1] = np.linalg.norm(
            spatial.log_so3(np.swapaxes(X[:, :3, :3], 1, 2) @ targets[:, :3, :3]), axis=-1
        )
    return out


def measure_reach_excess(problem: FrameProblem, targets: Array) -> Array:
    """Measure how far (N,) in metres targets are outside the reach bounds of the chain.

    Measured at a point of the frame that each target fixes.

    Zero within what the tolerances allow. With the target's orientation, it is a lower bound of the
    position error.
    """
    if not problem.mask[0]:
        return np.zeros(len(targets))
    out = np.abs(targets[:, 2, 3]) if problem.system.dim == 2 else np.zeros(len(targets))
    out[out <= problem.tolerance[0]] = 0.0
    return np.maximum(out, measure_length_excess(problem, targets).max(axis=-1))


def mark_unreachable_targets(problem: FrameProblem, code: np.ndarray) -> None:
    """Mark, in place, failed targets that the lengths of the links put out of reach."""
    failed = np.flatnonzero((code == Status.NOT_FOUND) | (code == Status.OUT_OF_TIME))
    code[failed[measure_reach_excess(problem, problem.targets[failed]) > 0.0]] = Status.OUT_OF_REACH


def measure_length_excess(problem: FrameProblem, targets: Array) -> Array:
    """Measure how far (N, 2) in metres targets exceed the reach of the links.

    See `kempe.numerics.length_bounds.measure_bound_excess`.
    """
    # else that is the reason
    free = len(problem.chain.v_index) >= (3 if problem.system.dim == 2 else sum(problem.mask))
    along = np.array(problem.axis) if free and is_axis_task(problem.name) else None
    return measure_bound_excess(
        problem.chain.bounds, targets, problem.tolerance, free and all(problem.mask), along=along
    )
