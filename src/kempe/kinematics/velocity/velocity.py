"""Velocity constraints A(q) v = b(q, t) of a system, and the tangents of what holds positions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained
from kempe.constraints.tape import RATE, TIME
from kempe.description.constrain import resolved
from kempe.description.parts import Declared
from kempe.errors import UnsupportedError
from kempe.joints import P, Q
from kempe.kernels.constraints import loop_layout as L
from kempe.kinematics.configuration import as_q
from kempe.kinematics.velocity.velocity_recording import Form, Num, Recorder
from kempe.kinematics.velocity.velocity_rows import CLOCK, RowName, VelocityRows
from kempe.model.closures.constraint_program import ends_of, numbers_of
from kempe.model.closures.frame_constraints import Tie
from kempe.model.closures.packed_loops import held_ties
from kempe.model.kept import kept
from kempe.model.tree.characteristic_length import characteristic_length
from kempe.model.tree.primitive_table import Table, lower
from kempe.reals import reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled


@explained
def rates(system: Compiled, q: Any, t: ArrayLike = 0.0) -> tuple[Array, Array]:
    """The rows A (..., m, nv) and b (..., m) of the velocity constraints A(q) v = b at q (..., nq)
    and times t (...).

    Rows are in the order of `row_names`, those that slip in m/s, those that turn in rad/s. A system
    without such constraints has none. Errors: `InputError`.
    """
    return velocity_rows(system).values(as_q(system, q), reals(t, "t"))


def row_names(system: Compiled) -> tuple[tuple[str, str], ...]:
    """For each row of `rates` the name of its constraint, and of the row."""
    return tuple((r.of, r.name) for r in velocity_rows(system).names)


@kept
def velocity_rows(system: Compiled) -> VelocityRows:
    """The rows of the declared velocity constraints, recorded."""
    return _recorded(system, system.structure.table, False)


@kept
def tangent_rows(system: Compiled) -> VelocityRows:
    """The rows of all constraints, recorded: tangents of what holds positions, and velocity
    constraints.

    Joints that the tree left out are led on through their own motion, so that all coordinates
    count. One-sided rows are there, as if they were active.
    """
    m = system._mechanism
    table = lower(
        m,
        system.structure.topology,
        system.structure.coordinates,
        m.parameters,
        dict.fromkeys(system.structure.closures, True),
    )
    return _recorded(system, table, True)


def _recorded(system: Compiled, table: Table, positions: bool) -> VelocityRows:
    mechanism = system._mechanism
    made = _Recording(system, table, mechanism.parameters)
    for tie in held_ties(system, table) if positions else ():
        made.tangents(tie)
    for declared in mechanism.constraints.values():
        made.velocities(declared)
    return made.rows()


class _Recording:
    """The rows of a system being recorded, with their names."""

    def __init__(self, system: Compiled, table: Table, parameters: Mapping[str, float]):
        self.system = system
        self.parameters = parameters
        self.names = list[RowName]()
        self.recorder = Recorder(table, system.coordinate_names, CLOCK)
        first = system.structure.coordinates.first
        self.known: dict[str, Num] = {n: i for i, n in enumerate(system.coordinate_names)}
        self.rates: dict[str, Form] = {n: {("v", iv): 1.0} for n, (_, iv) in first.items()}
        for iq, iv in zip(
            system.structure.layout.quaternion_q, system.structure.layout.quaternion_v, strict=True
        ):
            self._quaternion(int(iq), int(iv))
        numbers = self.recorder.numbers
        for name, f in system.structure.couplings.items():
            self.known[name] = float(f.offset)
            self.rates[name] = {}
            if f.source is not None:
                self.known[name] = numbers.add(
                    numbers.mul(f.multiplier, self.known[f.source]), float(f.offset)
                )
                self.rates[name] = {("v", first[f.source][1]): f.multiplier}
        self.known.setdefault(TIME, self.recorder.time)  # unless a coordinate is called so

    def _quaternion(self, iq: int, iv: int) -> None:
        """Add the rates of the entries of a quaternion: q' = q (0, w) / 2."""
        half = [self.recorder.numbers.mul(0.5, iq + k) for k in range(4)]
        w, x, y, z = half
        minus = self.recorder.numbers.neg
        rates = (
            (minus(x), minus(y), minus(z)),
            (w, minus(z), y),
            (z, w, minus(x)),
            (minus(y), x, w),
        )
        for k, rate in enumerate(rates):
            self.rates[self.system.coordinate_names[iq + k]] = {
                ("v", iv + i): c for i, c in enumerate(rate)
            }

    def tangents(self, tie: Tie) -> None:
        """Add the rates of the equations of a tie."""
        for name, form in zip(tie.rows, self._forms(tie), strict=True):
            self.recorder.add_row(tie.a, tie.b, form)
            self.names.append(RowName(tie.name, name, "m", False, bool(tie.bounds)))

    def _forms(self, tie: Tie) -> Iterator[Form]:
        r = self.recorder
        turns = tie.turns
        seen = r.seen(tie.a, tie.b)
        if tie.tape is not None:
            known = {**self.known}
            rates = {TIME: {("v", r.table.nv): 1.0}, **self.rates}
            for k in range(len(tie.tape.names)):
                yield r.linear(tie.tape.tape, seen if tie.tape.posed else None, known, rates, k)[1]
            return
        if turns == L.LINEAR and tie.relation is not None:
            form: Form = {}
            for name, factor in (
                (tie.relation.of, 1.0),
                *((n, -m) for n, m in tie.relation.sources.items()),
            ):
                form = r.sum_of(form, 1.0, self.rates[name], factor)
            yield form
            return
        if turns == L.DISTANCE:
            yield {i: seen("xyz"[i])[0] for i in range(3)}
            return
        yield from ({i: 1.0} for i in range(3) if tie.mask >> i & 1)
        if turns in (L.FULL, L.ANGLE):
            yield from ({3 + i: 1.0} for i in range(0 if turns == L.FULL else 2, 3))
        elif turns == L.ALIGN:
            yield from (seen(entry)[1] for entry in ("yz", "xz"))
        elif turns == L.CROSS:
            yield seen("xy")[1]
        elif turns == L.LOOK:
            for axis in "xy":  # the axis across the line of sight
                form = {}
                for i in "xyz":
                    (u, du) = seen(i + axis)
                    (p, dp) = seen(i)
                    form = r.sum_of(form, 1.0, r.sum_of(du, p, dp, u), 1.0)
                yield form
        elif turns != L.NO_TURN:
            raise UnsupportedError(
                f"constraint {tie.name!r} is no recorded expression: its series are needed here"
            )

    def velocities(self, declared: Declared) -> None:
        """Add the rows of velocity of a declared constraint."""
        system = self.system
        made = resolved(declared, self.parameters, system.dim)
        rows = [row for row in made.rows(system.dim) if row.velocity]
        if not rows:
            return
        a, b = ends_of(system, self.recorder.table, declared)
        seen = self.recorder.seen(a, b) if made.ends[1] is not None else None
        numbers = numbers_of(made)
        known: dict[str, Num] = {**self.known, **numbers}
        speeds = {n + RATE: form for n, form in self.rates.items()}
        known |= dict.fromkeys(speeds, 0.0)
        for row in rows:
            tape, which = row.args
            value, form = self.recorder.linear(tape, seen, known, speeds, which)
            self.recorder.add_row(a, b, form, value)
            self.names.append(
                RowName(declared.name, row.name, row.unit, written=not declared.of.scaled)
            )

    def rows(self) -> VelocityRows:
        """What was recorded."""
        system = self.system
        table = self.recorder.table
        tape, entries = self.recorder.finish()
        turning = set(table.iv[table.kind != P].tolist())
        turning |= {v + i for v in table.iv[table.kind == Q].tolist() for i in range(3)}
        length = characteristic_length(system)
        units = np.array([1.0 if v in turning else length for v in range(system.nv)] + [1.0])
        return VelocityRows(
            system.structure.layout,
            system.coordinate_names,
            tape,
            entries,
            tuple(self.names),
            units,
        )
