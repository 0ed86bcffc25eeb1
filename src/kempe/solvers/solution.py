"""Answers of solvers: the configuration, whether and how well it solves the task, and the sentence that says so."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.inverse import Task

SOLVED, NOT_FOUND, BAD_INPUT, OUT_OF_REACH = 0, 1, 2, 3
"""Codes of `Solution.code`; `status` has the sentences."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Answer of the inverse model: one configuration for each target.

    `q` (..., nq) solves the task where `success`; elsewhere it is the nearest configuration found inside the limits
    (NaN for targets that are not numbers). `position_error` in metres and `orientation_error` in radians (0 for
    position targets) are measured by a forward pass; `residual` is the norm of both. `iterations` and `starts` count
    the work. All have the leading shape of the targets; for a single target they are plain Python numbers.
    """

    q: Array
    success: Any
    code: Any
    position_error: Any
    orientation_error: Any
    iterations: Any
    starts: Any
    task: Task = field(repr=False)

    @property
    def residual(self) -> Any:
        """Norm (...) of position error [m] and orientation error [rad]."""
        r = np.hypot(self.position_error, self.orientation_error)
        return float(r) if np.ndim(r) == 0 else r

    @cached_property
    def status(self) -> Any:
        """The sentence for a single target; an array of sentences for a batch. Made when asked for."""
        from kempe.solvers.explain import sentence

        if np.ndim(self.success) == 0:
            return sentence(self, ())
        out = np.empty(np.shape(self.success), dtype=object)
        for index in np.ndindex(out.shape):
            out[index] = sentence(self, index)
        return out

    def __bool__(self) -> bool:
        return bool(np.all(self.success))

    def __len__(self) -> int:
        return len(self.success)

    def __str__(self) -> str:
        if np.ndim(self.success):
            return f"{int(np.sum(self.success))} of {np.size(self.success)} targets reached"
        lines = [self.status]
        lines += [f"  {name} = {x:.9g}" for name, x in zip(self.task.system.coordinate_names, self.q, strict=True)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from html import escape

        if np.ndim(self.success):
            return f"<p>{escape(str(self))}</p>"
        rows = "".join(
            f"<tr><td>{escape(n)}</td><td>{x:.9g}</td></tr>"
            for n, x in zip(self.task.system.coordinate_names, self.q, strict=True)
        )
        return f"<p>{escape(self.status)}</p><table>{rows}</table>"
