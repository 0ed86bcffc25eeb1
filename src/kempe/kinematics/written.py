"""Constraints whose rows are written, as expressions or functions: as tasks."""

from __future__ import annotations

from collections.abc import Hashable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.constraints.base import Constraint, Op, numbers_in, one_sided, with_numbers
from kempe.errors import InputError
from kempe.kinematics.forward import fk
from kempe.kinematics.measure import written_apart
from kempe.kinematics.task import GROUND, At, Goals, Task
from kempe.model.coordinates import check_read
from kempe.model.loops import Tie
from kempe.model.program import coordinates_of, every_tie
from kempe.model.table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


class Written(Task):
    """A constraint whose rows are expressions, of poses or of coordinates, or functions of named coordinates."""

    def __init__(self, of: Constraint, dim: int):
        super().__init__(of, dim)
        units = {r.unit for r in self.rows}
        self.lengths, self.angles = "m" in units, units != {"m"}
        self.lasting = all(r.op is Op.TAPE for r in self.rows)

    def _made(self, system: System) -> Constraint:
        """It with the parameters of the system. Errors: `UnknownNameError` for coordinates that do not exist."""
        made = with_numbers(self.of.knowing(system.parameters), system.parameters)
        check_read(system, coordinates_of(made), self.label)
        return made

    def _ends(self, system: System, made: Constraint) -> tuple[str | None, str | None]:
        a, b = (None if e is None else system.frame_name(e) for e in made.ends)
        return a, b

    def structure(self, system: System) -> Hashable:
        """Its frames and its expressions with their numbers."""
        made = self._made(system)
        rows = made.rows(self.dim)
        numbers = tuple((k, repr(x)) for k, x in numbers_in(made).items())
        return self._ends(system, made), rows, numbers, made.goal(self.dim).tobytes(), made.tool(self.dim)

    def ties(self, system: System, table: Table) -> list[Tie]:
        """One for all its equations and one for what is one-sided."""
        made = self._made(system)
        a, b = self._ends(system, made)
        if b is None:
            return every_tie(system, self.label, made, GROUND, GROUND)
        a, b = table.at[a or system.body_names[0]], table.at[b]
        goal, tool = made.goal(self.dim), np.reshape(made.tool(self.dim), (4, 4))
        if goal.ndim != 2:
            raise InputError(f"{self.label} is one for all targets: where it holds cannot differ from target to target")
        a, b = (a[0], a[1] @ goal, a[2]), (b[0], b[1] @ tool, b[2])
        return every_tie(system, self.label, made, a, b)

    def coordinates(self, system: System) -> set[str]:
        """Those that it reads, or those that they follow."""
        found = set()
        for name in coordinates_of(self._made(system)):
            f = system.couplings.get(name)
            found.add(name if f is None else f.source or name)
        return found

    def goals(self, system: System) -> Goals:
        """None."""
        kinds = dict.fromkeys((one_sided(self.of, r), r.op, r.args[0], r.unit) for r in self.rows)
        return [(None, None)] * len(kinds)

    def measure(
        self, system: System, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:  # fmt: skip
        """How far its values are from where they must be, by the forward model and plain numpy."""
        made, at = self._made(system), at or partial(fk, system, q)
        a, b = self._ends(system, made)
        X_AB = None
        if b is not None:
            A, B = at(a or system.body_names[0]), at(b)
            X_AB = spatial.inverse(A @ made.goal(self.dim)) @ B @ np.reshape(made.tool(self.dim), (4, 4))
        return written_apart(system, made, q, X_AB)
