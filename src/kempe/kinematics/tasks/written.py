"""Constraints whose rows are expressions or functions, or of several kinds, as tasks."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.constraints.base import Constraint, Op, Row, with_numbers
from kempe.constraints.reading import numbers_of
from kempe.description.constrain import reads_axes
from kempe.errors import InputError
from kempe.kinematics.forward import fk
from kempe.kinematics.measure import missed
from kempe.kinematics.tasks.functions import bound
from kempe.kinematics.tasks.task import FAR, GROUND, At, Goals, Task
from kempe.model.closures.constraint_program import every_tie, input_of, plain_rows
from kempe.model.closures.packed_loops import Tie
from kempe.model.tree.coordinates import check_read
from kempe.model.tree.primitive_table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled


class Made(NamedTuple):
    """A constraint in a system: with its parameters and functions; its rows of position, and its
    ties on no frames.
    """

    system: Compiled
    of: Constraint
    rows: list[Row]
    ties: list[Tie]


class Written(Task):
    """A constraint on values of expressions and functions: of poses, coordinates, parameters, and
    its own numbers.

    The goal and the numbers come with each call; parameters, and what functions are, do not.
    """

    _made: Made | None = None

    def __init__(self, of: Constraint, dim: int, rows: tuple[Row, ...]):
        super().__init__(of, dim, rows)
        units = {r.unit for r in self.rows}
        self.lengths = "m" in units
        self.angles = units != {"m"}
        self.lasting = all(r.op is not Op.CALL for r in self.rows)
        self.tool = np.reshape(of.tool(dim), (4, 4))
        self.posed = of.ends[1] is not None

    def made(self, system: Compiled) -> Made:
        """It in a system. Errors: `UnknownNameError` for coordinates that do not exist."""
        if self._made is None or self._made.system is not system:
            of = bound(
                system,
                with_numbers(
                    self.of.knowing(system.structure.parameters), system.structure.parameters
                ),
            )
            check_read(system, of.reads, self.label)
            ties = every_tie(system, self.label, of, GROUND, GROUND, True)
            check_read(system, [n for t in ties if t.tape for n in t.tape.coordinates], self.label)
            self._made = Made(system, of, plain_rows(of, self.dim, True), ties)
        return self._made

    def names(self, system: Compiled) -> tuple[str | None, str | None]:
        """The frames A and B. Errors: `UnknownNameError`."""
        a, b = (None if e is None else system.structure.frame_name(e) for e in self.of.ends)
        return a, b

    def structure(self, system: Compiled) -> Hashable:
        """Its frames, and its expressions without the numbers of the call."""
        each = (
            (t.mask, t.turns, t.bounds, t.tape and (t.tape.tape, t.tape.unit, t.tape.given))
            for t in self.made(system).ties
        )
        return self.names(system), self.tool.tobytes(), *each

    def ties(self, system: Compiled, table: Table) -> list[Tie]:
        """The packed constraints of the expressions: one for all equations and one for each group
        of inequalities.

        `table` holds the frames in which the poses are. Constraints that read poses have a goal,
        which comes with each call. Errors: `InputError` where axes of a particle are read.
        """
        if not self.posed:
            return every_tie(system, self.label, self.made(system).of, GROUND, GROUND, True)
        a, b = self.names(system)
        A = GROUND if a is None else table.at[a]
        (row, X, particle) = table.at[b]
        rows = self.made(system).rows
        turned = particle and (any(map(reads_axes, rows)) or np.any(self.tool[:3, 3]))
        if turned or (A[2] and any(r.op is not Op.DISTANCE for r in rows)):
            name = b if turned else a
            raise InputError(
                f"{name!r} is a particle, which has no axes: {self.label} cannot be required of it"
            )
        found = every_tie(
            system, self.label, self.made(system).of, A, (row, X @ self.tool, particle), True
        )
        return [t if t.function else replace(t, pin=True) for t in found]

    def coordinates(self, system: Compiled) -> set[str]:
        """Those that it reads, or those that they follow."""
        first = system.structure.coordinates.first
        found: set[int] = set()
        for t in self.made(system).ties:
            found |= {first[n][1] for n in t.tape.coordinates} if t.tape else found
            found |= set(t.function.support) if t.function else found
        return {system.structure.velocity_names[v] for v in found}

    def goals(self, system: Compiled) -> Goals:
        """For each tie the goal, and its numbers; ends that only some targets have are far away."""
        _, of, _, ties = self.made(system)
        goal = of.goal(self.dim) if self.posed else None
        out: list[tuple[Array | None, Array | None]] = []
        for tie in ties:
            given = [
                numbers_of(input_of(of, n), f"{n} of {self.label}")
                for n in (tie.tape.given if tie.tape else ())
            ]
            numbers = np.stack(np.broadcast_arrays(*given), axis=-1) if given else None
            if numbers is not None and tie.bounds:
                numbers = np.where(np.isinf(numbers), np.clip(numbers, -FAR, FAR), numbers)
            out.append((None if tie.function else goal, numbers))
        return out

    def measure(
        self, system: Compiled, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:
        """How far its values are from where they must be, by the forward model and plain numpy."""
        _, of, rows, ties = self.made(system)
        goals = self.goals(system) if goals is None else goals
        at = at or partial(fk, system, q)
        given: dict[str, Array] = {}
        A = None
        B = None
        for tie, (goal, numbers) in zip(ties, goals, strict=True):
            if numbers is not None and tie.tape:
                given |= {n: numbers[..., k] for k, n in enumerate(tie.tape.given)}
            A = goal if A is None else A
        if A is not None:
            a, b = self.names(system)
            A = A if a is None else at(a) @ A
            B = at(b) @ self.tool
        return missed(system, of, rows, q, A, B, given)
