"""The outcome of `ik_all` for each target, and what its solutions must be judged by."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.frame_targets import of_target
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kinematics.tasks.task_classes import task_of
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.solvers.analytic.answers.solutions import Solutions


def codes(solutions: Solutions) -> np.ndarray:
    """The `Status` numbers (N,): that there is no solution is proven where the answer is complete.

    Solutions that were left out, of a whole answer, are outside of limits or of one-sided
    constraints. What is known of curves of solutions is no proof.
    """
    whole = solutions if solutions._whole is None else solutions._whole
    used = whole._used
    multiplicity = whole._code // int(A.MULTIPLICITY_UNIT)
    curves = (used & (multiplicity == 0)).any(axis=1)
    none = np.where(used.any(axis=1), Status.OUTSIDE_LIMITS, Status.NONE_EXISTS)
    complete = np.ravel(whole.complete) & np.ravel(
        solutions.complete
    )  # of the whole, and of what is left
    none = np.where(complete & ~curves, none, Status.NOT_FOUND)
    none = np.where(np.ravel(whole.late), Status.OUT_OF_TIME, none)
    none = np.where(whole._counts[:, 0] < 0, Status.BAD_INPUT, none)
    return np.where((solutions._code % 2 == 1).any(axis=1), Status.SOLVED, none)


def goals(solutions: Solutions) -> list[tuple[Any, Any, Any]]:
    """Tasks, goals and tolerances of the target, for each of its solutions."""
    question = solutions.question
    lead = solutions._lead
    X = question.targets[0] if lead is None else question.targets.reshape(*lead, 1, 4, 4)
    allowed = (question.tolerance, max(question.tolerance, question.angular))
    made = of_target(question.frame, question.task, question.axis, X)
    return [(task_of(c, solutions.system.dim), None, allowed) for c in made]
