"""The answer of `assemble`: a configuration, its residual, and a sentence about the outcome."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.answer import Answer
from kempe.arguments import explain_method_errors
from kempe.forward.fk import fk
from kempe.spatial import Array
from kempe.words import format_fixed

if TYPE_CHECKING:
    from kempe.model.model import Model


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Assembly(Answer):
    """Answer of `assemble`: one configuration for each set of known values.

    All fields have the leading shape of the known values; for a single set they are plain Python
    numbers.

    Attributes
    ----------
    q
        Configurations (..., nq): all loops are closed where `success`, else the configurations
        nearest to closing.
    residual
        Norm of the closure equations in radians and characteristic lengths.
    iterations, starts
        Numbers of steps and of starts.
    late
        Whether the time limit ended the work.
    """

    row = "answers of assemble"
    what = "configurations closed"
    _entries = ("iterations", "starts")

    q: Array
    success: Any
    code: Any
    residual: Any = field()
    iterations: Any
    starts: Any
    assembler: Any
    """The `Assembler` that answered: the bound form for the names that are known."""
    late: bool = False
    """Whether the time limit ended the search for the nearest mechanism that closes exactly.

    Nothing is then known to be closed, and nothing is a success. Sets of known values for which it
    ended the search for a closed configuration have the `code` `OUT_OF_TIME`, too.
    """
    limit: float | None = None
    """The time limit, in seconds, where it may have ended the work."""

    @property
    def system(self) -> Model:
        """The system whose loops are closed."""
        return self.assembler.system

    def _mark_coordinates(self) -> list[str]:
        """Return a mark for each coordinate: "known", "cut" (of a cut joint) or ""."""
        sources = set(self.assembler.sources)
        closures = self.system.structure.closures
        return [
            "known"
            if name in sources
            else "cut" * (name.split(".")[0] in closures or name in closures)
            for name in self.system.coordinate_names
        ]

    def _list_notes(self, degrees: bool = False) -> list[str]:
        places = [] if self._batch_shape else list(self.assembler.frames)
        lines: list[str] = []
        for name in places:
            p = fk(self.system, self.q, name)[: self.system.dim, 3]
            lines.append(f"{name} is at {', '.join(format_fixed(x) for x in p.tolist())}")
        return [*lines, *super()._list_notes()]

    def _get_solver_residual(self) -> Any:
        return np.where(self.success, self.residual, 0.0)

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and values (n, nq) of the coordinates for a file.

        Rows of configurations that are not closed are NaN.
        """
        names, q = super()._list_columns()
        return names, np.where(np.reshape(self.success, (-1, 1)), q, np.nan)

    def _list_outcomes(self) -> dict[str, np.ndarray]:
        return {"success": np.ravel(self.success), "residual": np.ravel(self.residual)}
