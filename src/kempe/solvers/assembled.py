"""The answer of an assembly: the configuration, whether and how well it closes, and the sentence that says so."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.assembly import Assembler

CLOSED, NOT_CLOSED, BAD_INPUT, OUTSIDE, OTHER_BRANCH = 0, 1, 2, 3, 4
"""Codes of `Assembly.code`. OUTSIDE: a known coordinate is outside its limits. OTHER_BRANCH: the branch asked for
cannot be closed, `q` is on another one."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """Answer of `assemble`: one configuration for each set of known values.

    `q` (..., nq) closes all loops where `success`; elsewhere it is the configuration found that is nearest to closing.
    `residual` is the norm of the closure equations, in radians and characteristic lengths; `iterations` and `starts`
    count the work. All have the leading shape of the known values; for a single set they are plain Python numbers.
    """

    q: Array
    success: Any
    code: Any
    residual: Any
    iterations: Any
    starts: Any
    assembler: Assembler = field(repr=False)

    @cached_property
    def status(self) -> Any:
        """The sentence for a single answer; an array of sentences for a batch. Made when asked for."""
        from kempe.solvers.explain_assembly import sentence

        if np.ndim(self.success) == 0:
            return sentence(self, ())
        out = np.empty(np.shape(self.success), dtype=object)
        for index in np.ndindex(out.shape):
            out[index] = sentence(self, index)
        return out

    @property
    def system(self) -> System:
        """The system that was assembled."""
        return self.assembler.system

    def __bool__(self) -> bool:
        return bool(np.all(self.success))

    def __len__(self) -> int:
        return len(self.success)

    def __str__(self) -> str:
        if np.ndim(self.success):
            return f"{int(np.sum(self.success))} of {np.size(self.success)} configurations closed"
        lines = [self.status]
        lines += [f"  {name} = {x:.9g}" for name, x in zip(self.system.coordinate_names, self.q, strict=True)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from html import escape

        if np.ndim(self.success):
            return f"<p>{escape(str(self))}</p>"
        rows = "".join(
            f"<tr><td>{escape(n)}</td><td>{x:.9g}</td></tr>"
            for n, x in zip(self.system.coordinate_names, self.q, strict=True)
        )
        return f"<p>{escape(self.status)}</p><table>{rows}</table>"
