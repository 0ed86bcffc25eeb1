"""Answers of the analytical inverse model: all configurations that reach a target."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.kernels import analytic_layout as A
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.analytic.families import Family
    from kempe.solvers.analytic.plan import Plan
    from kempe.solvers.analytic.question import Question


class Solutions:
    """All configurations that reach a target, or each of a batch of targets.

    For one target: `q` (k, nq), those inside the limits first, each group sorted by nearness to `near`. For a batch:
    `q` (..., K, nq), NaN where `mask` (..., K) is False; along a trajectory a branch keeps its row. Of each solution:
    `residual` the norm of position error [m] and orientation error [rad] by the forward model, `inside` whether it
    respects the limits, `multiplicity` how many roots of the equations have merged in it (0: it is one of infinitely
    many, see `families`), `branch` the number of its branch (-1 where branches have no names), `condition` the
    condition number of the Jacobian of the task. `complete` says that there are no other isolated solutions.
    """

    def __init__(
        self, question: Question, plan: Plan, base: Array, q: Array, info: Array, count: np.ndarray,
        lead: tuple[int, ...] | None,
    ):  # fmt: skip
        self.question, self.plan = question, plan
        self._base, self._q, self._info, self._count, self._lead = base, q, info, count, lead

    @property
    def system(self) -> System:
        """The system that was asked."""
        return self.question.system

    @property
    def single(self) -> bool:
        """Whether one target was given, not a batch."""
        return self._lead is None

    @cached_property
    def mask(self) -> np.ndarray:
        """Which rows (..., K) of a batch are in use; of a single target all (k,)."""
        return self._pick(self._info[..., A.MULTIPLICITY] >= 0.0)

    def _pick(self, rows: Array) -> Any:
        """Rows (N, K, ...) in the shape of the answer."""
        if self._lead is None:
            return rows[0, : max(int(self._count[0]), 0)]
        return rows.reshape(*self._lead, *rows.shape[1:])

    @cached_property
    def q(self) -> Array:
        """Configurations (k, nq), or (..., K, nq) of a batch."""
        n, index = self.system.nq, self.plan.lines.q_index
        if len(index) == n and self.plan.plain:
            full = self._q
        else:
            full = np.empty((*self._q.shape[:2], n))
            full[:] = self._base[:, None]
            full[..., index] = self._q
        if self._lead is not None:
            full = np.where((self._info[..., A.MULTIPLICITY] >= 0.0)[..., None], full, np.nan)
        return self._pick(full)

    @cached_property
    def residual(self) -> Array:
        """Norm (k,) or (..., K) of position error [m] and orientation error [rad]."""
        return self._of(np.hypot(self._info[..., A.LINEAR], self._info[..., A.ANGULAR]))

    @cached_property
    def inside(self) -> np.ndarray:
        """Whether each is inside the limits, (k,) or (..., K)."""
        return self._pick((self._info[..., A.INSIDE] == 1.0) & (self._info[..., A.MULTIPLICITY] >= 0.0))

    @cached_property
    def multiplicity(self) -> np.ndarray:
        """How many roots each is, (k,) or (..., K); 0 for one of a family, and in rows not in use."""
        return self._pick(np.maximum(self._info[..., A.MULTIPLICITY], 0.0).astype(np.int64))

    @cached_property
    def branch(self) -> np.ndarray:
        """Number of the branch of each, (k,) or (..., K), -1 where there is none."""
        known = self._info[..., A.MULTIPLICITY] > 0.0
        return self._pick(np.where(known, self._info[..., A.SLOT], -1.0).astype(np.int64))

    def _of(self, values: Array) -> Array:
        if self._lead is not None:
            values = np.where(self._info[..., A.MULTIPLICITY] >= 0.0, values, np.nan)
        return self._pick(values)

    def __len__(self) -> int:
        return len(self.q)

    def __bool__(self) -> bool:
        return bool(self.inside.any())

    def __iter__(self) -> Iterator[Array]:
        return iter(self.q)

    def __getitem__(self, k: Any) -> Array:
        return self.q[k]
