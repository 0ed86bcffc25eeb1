"""The answer for several tasks: the configuration, what each task misses, and what freedoms are left."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.solvers.solution import Solution
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.tasks import Problem

RANK_TOLERANCE = 1e-8
"""Singular values below this fraction of the largest count as zero."""


@dataclass(frozen=True, eq=False)
class Reached(Solution):
    """Answer of `System.ik` for tasks.

    As `Solution`; `position_error` and `orientation_error` are the largest among the hard tasks. `errors` gives for
    each task, by its label, how far it is missed (..., 2) in metres and radians. `late` (...) says where the time limit
    ended the search, or the lowering of soft tasks and preferences.
    """

    what = "problems solved"

    errors: dict[str, Array]
    late: Any

    def _analysed(self) -> tuple[int, int, int, Array]:
        return analyse(self.asked, self.q)

    @cached_property
    def derivative(self) -> dict[str, Array]:
        """For each task, by its label, dq (..., nv, k) for motions of its goal; see `solvers.derivative_tasks`."""
        from kempe.solvers.derivative_tasks import derivative

        return derivative(self)

    def sentence(self, index: tuple[int, ...]) -> str:
        """The sentence for one problem."""
        from kempe.solvers.explain_tasks import sentence

        return sentence(self, index)


def analyse(problem: Problem, q: Array) -> tuple[int, int, int, Array]:
    """Equations m, freedoms n, rank, and orthonormal basis (nv, k) of self-motions at q (nq,), scaled."""
    packed = problem.packed
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None and problem.use[i]]
    ties = packed.loops.ties
    equal = np.repeat([not t.bounds for t in ties], [len(t.rows) for t in ties])[packed.rows >= 0]
    own = packed.rows[packed.rows >= 0]
    J = packed.evaluate(q, problem.pins)[1][np.isin(own, hard) & equal]
    N = null(packed.evaluate(q, problem.pins, closures=True)[1])
    rest = N @ null(J @ N)
    m = packed.count(hard)
    return m, N.shape[1], N.shape[1] - rest.shape[1], rest


def null(J: Array) -> Array:
    """Orthonormal basis (n, k) of the null space of J (m, n)."""
    if not J.size:
        return np.eye(J.shape[1])
    _, s, Vt = np.linalg.svd(J, full_matrices=True)
    return Vt[int((s > RANK_TOLERANCE * max(1.0, s.max(initial=0.0))).sum()) :].T
