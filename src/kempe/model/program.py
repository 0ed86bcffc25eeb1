"""Declared constraints as ties for the kernels: their rows of position, with ends on rows of the table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.constraints.base import Constraint, Op, Row, held, numbers_in, one_sided
from kempe.constraints.tape import TIME
from kempe.description.constrain import resolved
from kempe.description.parts import Declared
from kempe.kernels import loop_layout as L
from kempe.model.callback import Callback
from kempe.model.table import Table
from kempe.model.ties import Recorded, Tie

if TYPE_CHECKING:
    from kempe.model.system import System

TURNS = {Op.ROTATION: {2: L.ANGLE, 3: L.FULL}, Op.TILT: {2: L.ALIGN, 3: L.ALIGN}, Op.LOOK: {2: L.LOOK, 3: L.LOOK}}
"""What of the rotation a row holds, by the dimension."""

End = tuple[int, np.ndarray, bool]
"""A row of the table, the pose on it, whether it is a particle."""


def declared_ties(system: System, table: Table, one_sided: bool = False) -> list[Tie]:
    """The ties of all declared constraints whose rows hold at a value, or with `one_sided` between two, too."""
    every = (t for c in system.mechanism.constraints.values() for t in ties_of(system, table, c))
    return [t for t in every if one_sided or not t.bounds]


def ties_of(system: System, table: Table, declared: Declared) -> list[Tie]:
    """The ties of a declared constraint, one-sided ones with their bounds."""
    made = resolved(declared, system.mechanism.parameters, system.dim)
    return every_tie(system, declared.name, made, *ends_of(system, table, declared))


def ends_of(system: System, table: Table, declared: Declared) -> tuple[End, End]:
    """Frames A and B of a declared constraint; the ground twice for one of coordinates."""
    if not declared.parent:
        return (-1, np.eye(4), False), (-1, np.eye(4), False)
    ends = ((declared.parent, declared.child), declared.frames(system.mechanism.parameters, system.dim))
    a, b = ((row, X @ E, particle) for (row, X, particle), E in ((table.at[n], E) for n, E in zip(*ends, strict=True)))
    return a, b


def ties(name: str, made: Constraint, dim: int, a: End, b: End, given: bool = False) -> Iterator[Tie]:
    """The ties of the rows of position between two ends, as few as can hold them; `given` as in `recorded`."""
    rows = [r for r in made.rows(dim) if not r.velocity]
    for sided in (False, True):
        own = [r for r in rows if one_sided(made, r) == sided]
        axes = [r for r in own if r.op is Op.POINT]
        turns = next((TURNS[r.op][dim] for r in own if r.op in TURNS), L.NO_TURN)
        bounds = tuple(between(made, r) for r in axes) if sided else ()
        if axes or turns != L.NO_TURN:
            yield Tie(name, a, b, sum(1 << r.args[0] for r in axes), turns, bounds=bounds)
        for row in (r for r in own if r.op is Op.DISTANCE):
            field = held(made, row)
            number = 0.0 if sided else float(getattr(made, field))
            yield Tie(name, a, b, turns=L.DISTANCE, number=number, bounds=(between(made, row),) if sided else ())
        for tape, unit in dict.fromkeys((r.args[0], r.unit) for r in own if r.op is Op.TAPE):
            alike = [r for r in own if r.op is Op.TAPE and (r.args[0], r.unit) == (tape, unit)]
            bounds = tuple(between(made, r) for r in alike) if sided else ()
            yield Tie(name, a, b, turns=L.TAPE, bounds=bounds, tape=recorded(made, alike, given))


def every_tie(system: System, name: str, made: Constraint, a: End, b: End) -> list[Tie]:
    """The ties of the rows of position, functions among them, over coordinates that are in q."""
    found = list(ties(name, made, system.dim, a, b))
    for sided in (False, True):
        own = [r for r in made.rows(system.dim) if r.op is Op.CALL and one_sided(made, r) == sided]
        for what in dict.fromkeys(r.args[0] for r in own):
            alike = [r for r in own if r.args[0] == what]
            bounds = tuple(between(made, r) for r in alike) if sided else ()
            numbers, which = numbers_of(made), [r.args[1] for r in alike]
            bound = getattr(what, "callback", None)  # a function of the whole configuration
            call = bound(which) if bound else Callback.of_call(system, what, which, numbers)
            found.append(Tie(name, a, b, turns=L.FUNCTION, bounds=bounds, function=call))
    sources = {n: (f.source, f.multiplier, f.offset) for n, f in system.couplings.items()}
    return [t if t.tape is None else replace(t, tape=t.tape.over(sources)) for t in found]


def recorded(made: Constraint, rows: list[Row], given: bool = False) -> Recorded:
    """Rows of one expression, with the numbers of the constraint put in; `given`: they come with the call."""
    tape = rows[0].args[0].part([r.args[1] for r in rows])
    names, unit, posed = tuple(r.name for r in rows), rows[0].unit, made.ends[1] is not None
    if given:
        return Recorded(tape, names, unit, posed, tuple(k for k in numbers_in(made) if k in tape.inputs))
    numbers = numbers_of(made) | ({TIME: 0.0} if getattr(made, "time", False) else {})
    return Recorded(tape.fixed({k: x for k, x in numbers.items() if k in tape.inputs}), names, unit, posed)


def numbers_of(made: Constraint) -> dict[str, float]:
    """The numbers of a constraint, parameters among them, by the names that expressions have for them."""
    own = {k: x for k, x in numbers_in(made).items() if x is not None and np.ndim(x) == 0 and not isinstance(x, str)}
    given = {**(getattr(made, "parameters", None) or {}), **own}
    return {k: float(x) for k, x in given.items() if k not in coordinates_of(made)}


def coordinates_of(made: Constraint) -> tuple[str, ...]:
    """Names of the coordinates that a constraint reads, besides poses."""
    return tuple(getattr(made, "of", ()))


def between(made: Constraint, row: Row) -> tuple[float, float]:
    """Between what a one-sided row holds."""
    ends = []
    for field, infinity in ((row.low, -np.inf), (row.high, np.inf)):
        x = getattr(made, field) if field else None
        ends.append(infinity if x is None else float(x if row.part is None else np.asarray(x)[row.part]))
    return ends[0], ends[1]
