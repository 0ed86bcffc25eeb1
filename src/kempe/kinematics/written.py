"""Constraints whose rows are written, as expressions or functions: as tasks, and their values in plain numpy."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.constraints.base import Constraint, Op, numbers_in, one_sided, with_numbers
from kempe.constraints.tape import POSE
from kempe.errors import InputError
from kempe.kinematics.constraints import coordinate_value
from kempe.kinematics.forward import fk
from kempe.kinematics.task import GROUND, Goals, Task
from kempe.model.coordinates import check_read
from kempe.model.loops import Tie
from kempe.model.program import between, coordinates_of, every_tie, numbers_of
from kempe.model.table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


def pose_inputs(X: Array) -> dict[str, Array]:
    """The inputs of expressions that a pose (..., 4, 4) gives: its place, and its rotation row by row."""
    values = [X[..., i, 3] for i in range(3)] + [X[..., i, j] for i in range(3) for j in range(3)]
    return dict(zip(POSE, values, strict=True))


def written_values(system: System, made: Constraint, q: Array, X_AB: Array | None = None) -> Array:
    """Values (..., rows) of the written rows of a constraint at q (..., nq), by plain numpy.

    `made` has its numbers; `X_AB` (..., 4, 4) is where its frame B is in A, where it has frames.
    """
    rows = [r for r in made.rows(system.dim) if r.op in (Op.TAPE, Op.CALL)]
    given: dict[str, Array] = {k: np.asarray(x) for k, x in numbers_of(made).items()}
    given |= {n: coordinate_value(system, q, n) for n in coordinates_of(made)}
    if X_AB is not None:
        given |= pose_inputs(X_AB)
    out = np.empty((*q.shape[:-1], len(rows)))
    for k, row in enumerate(rows):
        what, n = row.args
        if row.op is Op.TAPE:
            out[..., k] = what.evaluate(given)[..., n]
            continue
        for index in np.ndindex(q.shape[:-1]):
            out[(*index, k)] = what({m: np.broadcast_to(x, q.shape[:-1])[index] for m, x in given.items()})[n]
    return out


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

    def measure(self, system: System, q: Array, goals: Goals | None = None) -> tuple[Array, Array]:
        """How far its values are from where they must be, by the forward model and plain numpy."""
        made = self._made(system)
        a, b = self._ends(system, made)
        X_AB = None
        if b is not None:
            A, B = fk(system, q, a or system.body_names[0]), fk(system, q, b)
            X_AB = spatial.inverse(A @ made.goal(self.dim)) @ B @ np.reshape(made.tool(self.dim), (4, 4))
        values = written_values(system, made, q, X_AB)
        low, high = np.array([between(made, r) if one_sided(made, r) else (0.0, 0.0) for r in self.rows]).T
        off = values - np.clip(values, low, high)
        metres = np.array([r.unit == "m" for r in self.rows])
        return np.linalg.norm(off[..., metres], axis=-1), np.linalg.norm(off[..., ~metres], axis=-1)
