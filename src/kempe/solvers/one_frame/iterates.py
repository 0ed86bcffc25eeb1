"""The iterates of the numerical inverse model: step by step what its starts found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError
from kempe.kernels.base.search_layout import STEPS
from kempe.kinematics.common.result import Report
from kempe.late import late
from kempe.solvers.one_frame import multi_start
from kempe.solvers.one_frame.solution import Solution
from kempe.spatial import Array
from kempe.words import counted, cut

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.system import System
    from kempe.solvers.common.problem import Problem
    from kempe.solvers.one_frame.multi_start import FrameProblem

MOST_STARTS = 64
"""Starts whose iterates are kept: those of more fill no picture."""
MOST_LINES = 32
"""Lines of the text."""


@dataclass(frozen=True, eq=False)
class IkHistory(Report):
    """What a search found after each of its steps, one row each.

    `q` (k, nq) is the nearest configuration that its start had found by then (steps that lead away
    are taken, too, and repeat the row before), `position_error` (k,) in metres, `orientation_error`
    (k,) in radians, `start` (k,) the number of the start, `step` (k,) that of the step in it: 0 is
    where it began.
    """

    system: System
    q: Array
    position_error: Array
    orientation_error: Array
    start: np.ndarray
    step: np.ndarray
    starts: int
    """How many starts there were; of the first 64 there are rows."""

    @property
    def errors(self) -> Array:
        """Position and orientation error (k, 2)."""
        return np.stack([self.position_error, self.orientation_error], axis=-1)

    @property
    def status(self) -> str:
        """How many steps and starts there are, and how the errors fell."""
        last = (
            f"{self.position_error[-1]:.2g} m"
            + f" and {self.orientation_error[-1]:.2g} rad" * self._turns
        )
        kept = "" if self.starts <= MOST_STARTS else f", the first {MOST_STARTS} of {self.starts}"
        count = int(self.start[-1]) + 1
        return (
            f"{counted(len(self.q) - count, 'step')} of {counted(count, 'start')}{kept}: at last "
            f"{last}"
        )

    @property
    def _turns(self) -> bool:
        return bool(np.any(self.orientation_error > 0.0))

    def _lines(self) -> list[str]:
        rows = list(
            zip(self.start, self.step, self.position_error, self.orientation_error, strict=True)
        )
        if self.start[-1] > 0:  # of each of several starts the last step
            rows = [rows[k] for k in (*(np.flatnonzero(np.diff(self.start))), -1)]
        lines = [
            f"start {s}, step {k}: {p:.3g} m" + f", {a:.3g} rad" * self._turns
            for s, k, p, a in rows
        ]
        return cut(lines, MOST_LINES)

    def _data(self) -> dict[str, Any]:
        names = ("q", "position_error", "orientation_error", "start", "step", "starts")
        return {name: getattr(self, name) for name in names}

    def plot(self, ax: Axes | None = None) -> Axes:
        """Matplotlib axes with the errors over the steps, a line for each start; see
        `kempe.views.plots.plot_history`.

        The iterates themselves are drawn by ``system.plot(history.q)``.
        """
        return late("plots").plot_history(self, ax)


def with_history(answer: Solution, problem: Problem) -> Solution:
    """The answer with its iterates. Errors: `InputError` for batches and other methods."""
    if np.ndim(answer.success) or problem.method != "numeric" or type(answer) is not Solution:
        raise InputError(
            "history=True is for one target of one frame that is searched for with method 'numeric'"
        )
    from kempe.solvers.one_frame.inverse import seeds_of

    task = answer.task
    base, seeds = seeds_of(problem.system, task.chain, problem.start, ())
    object.__setattr__(answer, "history", _of_starts(task, base, seeds, int(answer.starts)))
    return answer


def _of_starts(task: FrameProblem, base: Array, seeds: Array, starts: int) -> IkHistory:
    head = (
        task.chain.ints,
        task.chain.floats,
        task.chain.limits,
        multi_start.rows_of(task),
        multi_start.goals_of(task, task.targets),
        seeds,
        task.rng,
    )
    n = len(task.chain.q_index)
    rows: list[Array] = []
    at: list[tuple[int, int]] = []
    for start in range(min(max(starts, 1), MOST_STARTS)):
        for steps in range(task.iterations + 1):
            found = multi_start.starts_from(task, head, start, steps)[0]
            if steps and found[n + STEPS] < steps:
                break
            rows.append(found[:n])
            at.append((start, steps))
    chain = np.array(rows)
    missed = multi_start.misses(task, np.repeat(task.targets, len(chain), axis=0), chain)
    q = np.repeat(base, len(chain), axis=0)
    q[:, task.chain.q_index] = chain
    number, step = np.array(at).T
    return IkHistory(task.system, q, missed[:, 0], missed[:, 1], number, step, starts)
