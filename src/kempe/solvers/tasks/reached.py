"""The answer for several tasks: the configuration, what each task misses, and what freedoms are
left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from kempe.calls import brief, explained_methods
from kempe.solvers.common.freedoms import Local
from kempe.solvers.one_frame.solution import Solution
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.tasks.demands import Demands


@explained_methods
@dataclass(frozen=True, eq=False)
class Reached(Solution):
    """Answer of `System.ik` for tasks.

    As `Solution`; `position_error` and `orientation_error` are the largest among the hard tasks.
    `errors` gives for each task, by its label, how far it is missed (..., 2) in metres and radians.
    `late` (...) says where the time limit ended the search, or the lowering of soft tasks and
    preferences.
    """

    __repr__ = brief

    row = "answers of ik, tasks"
    what = "problems solved"

    errors: dict[str, Array]
    late: Any

    @property
    def _closing(self) -> Any:
        return self.problem.packed.closing

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return self.problem.hard_tasks

    @cached_property
    def derivative(self) -> dict[str, Array]:
        """For each task, by its label, dq (..., nv, k) for motions of its goal.

        See `kempe.solvers.velocity.derivative_tasks`.
        """
        return self._row.derive(self)


def analyse(problem: Demands, q: Array) -> tuple[int, int, int, Array]:
    """Equations m, freedoms n, rank, and orthonormal basis (nv, k) of self-motions at q (nq,),
    scaled.
    """
    local = Local(problem, q)
    return local.m, local.n, local.n - local.left.shape[1], local.left
