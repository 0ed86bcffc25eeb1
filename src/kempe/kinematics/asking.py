"""Constraints as tasks: those of recorded expressions, and which class asks for which."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.constraints.base import Constraint, Op, numbers_in
from kempe.constraints.reading import numbers_of
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.forward import fk
from kempe.kinematics.measure import pose_inputs
from kempe.kinematics.task import GROUND, At, Centred, Goals, Placed, Task
from kempe.kinematics.tasks_whole import Called, Coordinates
from kempe.kinematics.written import Written
from kempe.model.loops import Tie
from kempe.model.program import ties
from kempe.model.table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


class Expressed(Task):
    """A constraint whose rows are recorded expressions of a pose or of coordinates."""

    def __init__(self, of: Constraint, dim: int):
        super().__init__(of, dim)
        self.lengths = any(r.unit == "m" for r in self.rows)
        self.angles = any(r.unit != "m" for r in self.rows)
        self.posed = of.ends[1] is not None
        self.made = list(ties(self.label, of, dim, GROUND, GROUND, True))

    def names(self, system: System) -> tuple[str | None, str | None]:
        """The frames A and B. Errors: `UnknownNameError`."""
        a, b = self.of.ends
        return None if a is None else system.frame_name(a), None if b is None else system.frame_name(b)

    def structure(self, system: System) -> Hashable:
        """Its expressions and frames; numbers are goals."""
        for name in self._coordinates():
            if name not in system.coordinates.first:
                raise UnknownNameError("coordinate", name, system.coordinate_names, system.name)
        return self.names(system), self.of.tool(self.dim), tuple((t.tape.tape, t.bounds) for t in self.made if t.tape)

    def _coordinates(self) -> list[str]:
        return [n for t in self.made if t.tape for n in t.tape.coordinates]

    def ties(self, system: System, table: Table) -> list[Tie]:
        """Its ties, pinned at the goal where they are of a pose."""
        out = []
        for tie in self.made:
            assert tie.tape is not None
            more: dict[str, Any] = {"given": bool(tie.tape.given)}
            if self.posed:
                a, b = self.names(system)
                row, X, particle = table.at[b]
                if particle:
                    raise InputError(f"{b!r} is a particle, which has no axes: {self.label} cannot be asked of it")
                B = (row, X @ np.reshape(self.of.tool(self.dim), (4, 4)), particle)
                more |= {"pin": True, "a": GROUND if a is None else table.at[a], "b": B}
            out.append(replace(tie, **more))
        return out

    def coordinates(self, system: System) -> set[str]:
        """Those that its expressions read."""
        first = system.coordinates.first
        return {system.velocity_names[first[n][1]] for n in self._coordinates()}

    def goals(self, system: System) -> Goals:
        """The pose of the goal, and the numbers of the expressions."""
        goal, numbers = self.of.goal(self.dim) if self.posed else None, numbers_in(self.of)
        out: Goals = []
        for tie in self.made:
            assert tie.tape is not None
            given = [numbers_of(numbers[n], f"{n} of {self.label}") for n in tie.tape.given]
            out.append((goal, np.stack(np.broadcast_arrays(*given), axis=-1) if given else None))
        return out

    def measure(
        self, system: System, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:  # fmt: skip
        """The sizes of its values, those that are lengths and the others."""
        at = at or partial(fk, system, q)
        squares = {"m": np.zeros(q.shape[:-1]), "rad": np.zeros(q.shape[:-1])}
        for tie, (goal, numbers) in zip(self.made, self.goals(system) if goals is None else goals, strict=True):
            assert tie.tape is not None
            inputs = {n: q[..., system.coordinates.first[n][0]] for n in tie.tape.coordinates}
            inputs |= {} if numbers is None else {n: numbers[..., k] for k, n in enumerate(tie.tape.given)}
            if goal is not None:
                a, b = self.names(system)
                A = goal if a is None else at(a) @ goal
                X = spatial.inverse(A) @ at(b) @ np.reshape(self.of.tool(self.dim), (4, 4))
                inputs |= pose_inputs(X)
            with np.errstate(all="ignore"):
                value = tie.tape.tape.evaluate(inputs)
            low, high = np.array(tie.bounds).T if tie.bounds else (0.0, 0.0)
            off = value - np.clip(value, low, high)
            unit = "m" if tie.tape.unit == "m" else "rad"
            squares[unit] = squares[unit] + np.vecdot(off, off)
        return np.sqrt(squares["m"]), np.sqrt(squares["rad"])


FAMILIES: dict[Op, type[Task]] = {Op.COORDINATE: Coordinates, Op.CALL: Called, Op.TAPE: Expressed}
"""Which class asks for rows of an operation; `Placed` for all others."""


def task_of(constraint: Constraint, dim: int) -> Task:
    """The constraint as a task. Errors: `InputError` where it cannot be asked of a configuration."""
    rows = constraint.rows(dim)
    constraint.check(dim)
    if Op.VELOCITY in [r.op for r in rows]:
        raise InputError(f"{constraint.label} is about velocities, which no configuration has: declare it by "
                         "Mechanism.constrain")  # fmt: skip
    if hasattr(constraint, "of"):  # it reads coordinates, which may follow others
        return Written(constraint, dim)
    family = FAMILIES.get(rows[0].op) or (Centred if hasattr(constraint, "masses") else Placed)
    return family(constraint, dim)
