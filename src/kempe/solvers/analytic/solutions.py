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
        self, question: Question, plan: Plan, base: Array, rows: Array, counts: np.ndarray, lead: tuple[int, ...] | None
    ):
        self.question, self.plan = question, plan
        self._base, self._rows, self._counts, self._lead = base, rows, counts, lead

    @property
    def system(self) -> System:
        """The system that was asked."""
        return self.question.system

    @property
    def single(self) -> bool:
        """Whether one target was given, not a batch."""
        return self._lead is None

    @cached_property
    def _code(self) -> np.ndarray:
        """Codes of all rows (N, K), see `kernels.analytic_layout`; 0 for rows not in use."""
        code = self._rows[..., len(self.plan.lines) + A.CODE]
        return np.where(code >= 0.0, code, 0.0).astype(np.int64)

    @cached_property
    def _used(self) -> np.ndarray:
        """Which rows (N, K) are in use."""
        return self._rows[..., len(self.plan.lines) + A.CODE] >= 0.0

    @cached_property
    def mask(self) -> np.ndarray:
        """Which rows (..., K) of a batch are in use; of a single target all (k,)."""
        return self._pick(self._used)

    def _pick(self, rows: Array) -> Any:
        """Rows (N, K, ...) in the shape of the answer."""
        if self._lead is None:
            return rows[0, : int(self._used[0].sum())]
        return rows.reshape(*self._lead, *rows.shape[1:])

    def _of(self, values: Array) -> Array:
        """Numbers (N, K, ...) in the shape of the answer, NaN in rows not in use."""
        if self._lead is not None and not self._used.all():
            shape = (*self._used.shape, *[1] * (values.ndim - 2))
            values = np.where(self._used.reshape(shape), values, np.nan)
        return self._pick(values)

    @cached_property
    def q(self) -> Array:
        """Configurations (k, nq), or (..., K, nq) of a batch."""
        n, index = self.system.nq, self.plan.lines.q_index
        own = self._rows[..., : len(index)]
        if not self.plan.plain or len(index) < n:
            full = np.empty((*own.shape[:2], n))
            full[:] = self._base[:, None]
            full[..., index] = own
            own = full
        return self._of(own)

    @cached_property
    def residual(self) -> Array:
        """Norm (k,) or (..., K) of position error [m] and orientation error [rad]."""
        return self._of(self._rows[..., len(self.plan.lines) + A.ERROR])

    @cached_property
    def inside(self) -> np.ndarray:
        """Whether each is inside the limits, (k,) or (..., K)."""
        return self._pick(self._code % 2 == 1)

    @cached_property
    def multiplicity(self) -> np.ndarray:
        """How many roots each is, (k,) or (..., K); 0 for one of a family, and in rows not in use."""
        return self._pick(self._code // int(A.MULTIPLICITY_UNIT))

    @cached_property
    def branch(self) -> np.ndarray:
        """Number of the branch of each, (k,) or (..., K), -1 where there is none."""
        unit = int(A.SLOT_UNIT)
        return self._pick(self._code % int(A.MULTIPLICITY_UNIT) // unit - 1)

    def __len__(self) -> int:
        return len(self.q)

    def __bool__(self) -> bool:
        return bool(self.inside.any())

    def __iter__(self) -> Iterator[Array]:
        return iter(self.q)

    def __getitem__(self, k: Any) -> Array:
        return self.q[k]
