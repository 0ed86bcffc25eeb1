"""Velocity constraints A(q) v = b(q, t) of a system, and the tangents of what holds positions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained
from kempe.constraints.base import Constraint, Op, with_numbers
from kempe.errors import UnsupportedError
from kempe.joints import P
from kempe.kernels import loop_layout as L
from kempe.kinematics.configuration import as_q
from kempe.kinematics.record import Form, Num, Recorder
from kempe.kinematics.recorded import TIME, RowName, Rows
from kempe.model.lengths import characteristic_length
from kempe.model.loop_plan import Tie
from kempe.model.loops import all_ties
from kempe.model.program import ends_of, ties_of
from kempe.model.table import Table, lower
from kempe.reals import reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


@explained
def rates(system: System, q: Any, t: ArrayLike = 0.0) -> tuple[Array, Array]:
    """The rows A (..., m, nv) and b (..., m) of the velocity constraints A(q) v = b at q (..., nq) and times t (...).

    Rows are in the order of `row_names`, those that slip in m/s, those that turn in rad/s. A system without such
    constraints has none. Errors: `InputError`.
    """
    return velocity_rows(system).values(as_q(system, q), reals(t, "t"))


def row_names(system: System) -> tuple[tuple[str, str], ...]:
    """For each row of `rates` the name of its constraint, and of the row."""
    return tuple((r.of, r.name) for r in velocity_rows(system).names)


def velocity_rows(system: System) -> Rows:
    """The rows of the declared velocity constraints, recorded once."""
    found = system._queries.get("velocity rows")
    if found is None:
        found = system._queries["velocity rows"] = _recorded(system, system.table, False)
    return found


def tangent_rows(system: System) -> Rows:
    """The rows of all constraints, recorded once: tangents of what holds positions, and velocity constraints.

    Joints that the tree left out are led on through their own motion, so that all coordinates count. One-sided rows are
    there, as if they were active.
    """
    found = system._queries.get("tangent rows")
    if found is None:
        m = system.mechanism
        table = lower(m, system.topology, system.coordinates, m.parameters, dict.fromkeys(system.closures, True))
        found = system._queries["tangent rows"] = _recorded(system, table, True)
    return found


def _recorded(system: System, table: Table, positions: bool) -> Rows:
    recorder = Recorder(table, system.coordinate_names, TIME)
    names: list[RowName] = []
    if positions:
        declared = system.mechanism.constraints
        ties = [t for t in all_ties(system, table, frozenset(system.closures)) if t.name not in declared]
        ties += [t for c in declared.values() for t in ties_of(system, table, c)]
        for tie in ties:
            names += _tangents(system, recorder, tie)
    for declared in system.mechanism.constraints.values():
        made = with_numbers(declared.of, system.mechanism.parameters)
        a, b = ends_of(system, table, declared, made)
        for row in made.rows(system.dim):
            if row.velocity:
                tape, which = row.args
                value, form = recorder.linear(tape, a, b, *_inputs(system, recorder, made), which)
                recorder.add_row(a, b, form, value)
                names.append(RowName(declared.name, row.name, row.unit))
    tape, entries = recorder.finish()
    units = np.append(np.where(_slides(table), characteristic_length(system), 1.0), 1.0)
    return Rows(system.layout, system.coordinate_names, tape, entries, tuple(names), units)
