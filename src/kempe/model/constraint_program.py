"""Declared constraints as ties: rows of position between two frames, in the form kernels need."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from kempe.constraints.base import Constraint, Op, Row, held, numbers_in, one_sided
from kempe.constraints.builder import Builder, substituted
from kempe.constraints.tape import POSE, TIME, Tape
from kempe.constraints.text import LEAST, from_text
from kempe.description.mechanism import resolved
from kempe.description.parts import Declared, Joint
from kempe.errors import InputError
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints import tape_layout as TL
from kempe.model.coordinates import Relation
from kempe.model.kernel_functions import Callback
from kempe.model.primitive_table import Table

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- ties

# What holds one frame in another, or coordinates; `kempe.model.packed_loops` packs ties for the
# kernels.

TURN_NAMES = {
    L.NO_TURN: (),
    L.ANGLE: ("rz",),
    L.ALIGN: ("rx", "ry"),
    L.CROSS: ("x.y",),
    L.FULL: ("rx", "ry", "rz"),
    L.LOOK: ("rx", "ry"),
}
ONE_ROW = {L.DISTANCE: "distance", L.LINEAR: "relation"}


class CompiledFunction(Protocol):
    """A function of q in compiled form: `address` of void(double* q, double* value, double*
    columns, int64 flag).

    It writes its `rows` values at q, and with the flag the columns (n, rows) of its Jacobian in
    scaled velocities.
    """

    rows: int
    address: int
    scale: np.ndarray
    """Units (nv,) of the velocities: radians, or the length that equations are measured in."""
    support: tuple[int, ...]
    """The velocities that it depends on: its columns."""
    error: BaseException | None
    """What it raised."""


@dataclass(frozen=True, eq=False)
class Centre:
    """A centre of masses whose sum is 1: for each row of the table (n, 4) mass and first moment in
    its axes.

    `rest` (3,) is the first moment of what stands on the ground.
    """

    rows: np.ndarray
    rest: np.ndarray


@dataclass(frozen=True, eq=False)
class RecordedRows:
    """Rows that are outputs of a recorded expression: of the pose of B in A (where `posed`), else
    of coordinates.

    Inputs that start with no other meaning are coordinates by name.
    """

    tape: Tape
    names: tuple[str, ...]
    unit: str
    posed: bool
    given: tuple[str, ...] = ()
    """Inputs that are numbers of the call."""

    def input(self, name: str) -> int:
        """Number of the input `name`, as `loop_layout` encodes it."""
        if name in self.given:
            return L.GIVEN
        return L.PLACE + POSE.index(name) if self.posed and name in POSE else L.COORDINATE

    @property
    def moved(self) -> bool:
        """Whether the expression depends on the pose of B in A."""
        return any(self.input(n) < L.COORDINATE for n in self.tape.inputs)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that the expression depends on."""
        return tuple(n for n in self.tape.inputs if self.input(n) == L.COORDINATE)

    def over(self, sources: Mapping[str, tuple[str | None, float, float]]) -> RecordedRows:
        """The expression with coupled coordinates replaced by their sources: (source, multiplier,
        offset) by name.
        """
        return replace(
            self,
            tape=substituted(self.tape, {n: sources[n] for n in self.coordinates if n in sources}),
        )


@dataclass(frozen=True, eq=False)
class Tie:
    """Equations that hold a frame B in a frame A: name, both ends (row, placement, particle), and
    what they hold.
    """

    name: str
    a: tuple[int, np.ndarray, bool]
    b: tuple[int, np.ndarray, bool]
    mask: int = 0
    turns: int = L.NO_TURN
    number: float = 0.0
    relation: Relation | None = None
    pin: bool = False
    joint: Joint | None = None
    """The joint whose coordinates are read off where B is in A."""
    given: bool = False
    """Whether its number, or its four of a quaternion, come with the call."""
    bounds: tuple[tuple[float, float], ...] = ()
    """For each row, in metres or radians, between what it is held; without them at zero."""
    centre: Centre | None = None
    """In place of frame B."""
    own: int = -1
    """The velocity coordinate that an OWN tie holds, the first of a `ball`."""
    ball: bool = False
    function: CompiledFunction | None = None
    tape: RecordedRows | None = None

    @property
    def written(self) -> bool:
        """Whether its equations are an expression or a function."""
        return self.tape is not None or self.function is not None

    @property
    def plain(self) -> bool:
        """Whether its equations are plain numbers, neither metres nor radians of a pose."""
        return (
            self.relation is not None
            or self.function is not None
            or (self.tape is not None and self.tape.unit not in ("m", "rad"))
        )

    @property
    def rows(self) -> list[str]:
        """Names of its equations."""
        if self.turns in ONE_ROW:
            return [ONE_ROW[self.turns]]
        if self.tape is not None:
            return list(self.tape.names)
        if self.function is not None:
            return [str(i) for i in range(self.function.rows)]
        if self.turns == L.OWN:
            return ["rx", "ry", "rz"] if self.ball else ["value"]
        return [x for i, x in enumerate("xyz") if self.mask >> i & 1] + list(TURN_NAMES[self.turns])


# ---- ties of declared constraints

TURNS = {
    Op.ROTATION: {2: L.ANGLE, 3: L.FULL},
    Op.TILT: {2: L.ALIGN, 3: L.ALIGN},
    Op.LOOK: {2: L.LOOK, 3: L.LOOK},
}
"""What of the rotation a row holds, by the dimension."""

End = tuple[int, np.ndarray, bool]
"""A row of the table, the pose on it, whether it is a particle."""


def declared_ties(system: Model, table: Table, one_sided: bool = False) -> list[Tie]:
    """The ties of all declared constraints whose rows hold at a value, or with `one_sided` between
    two, too.
    """
    every = (t for c in system._mechanism.constraints.values() for t in ties_of(system, table, c))
    return [t for t in every if one_sided or not t.bounds]


def ties_of(system: Model, table: Table, declared: Declared) -> list[Tie]:
    """The ties of a declared constraint, one-sided ones with their bounds."""
    made = resolved(declared, system._mechanism.parameters, system.dim)
    return every_tie(system, declared.name, made, *ends_of(system, table, declared))


def ends_of(system: Model, table: Table, declared: Declared) -> tuple[End, End]:
    """Frames A and B of a declared constraint; the ground twice for one of coordinates."""
    if not declared.parent:
        return (-1, np.eye(4), False), (-1, np.eye(4), False)
    ends = (
        (declared.parent, declared.child),
        declared.frames(system._mechanism.parameters, system.dim),
    )
    a, b = (
        (row, X @ E, particle)
        for (row, X, particle), E in ((table.at[n], E) for n, E in zip(*ends, strict=True))
    )
    return a, b


def ties(
    name: str, made: Constraint, dim: int, a: End, b: End, given: bool = False
) -> Iterator[Tie]:
    """The ties of the rows of position between two ends, as few as can hold them; `given` as in
    `plain_rows`.
    """
    rows = plain_rows(made, dim, given)
    for sided in (False, True):
        own = [r for r in rows if one_sided(made, r) == sided]
        axes = [r for r in own if r.op is Op.POINT]
        turns = next((TURNS[r.op][dim] for r in own if r.op in TURNS), L.NO_TURN)
        bounds = tuple(between(made, r) for r in axes) if sided else ()
        look = turns == L.LOOK and bool(axes)  # which is towards the origin of A
        if axes or turns != L.NO_TURN:
            mask = sum(1 << r.args[0] for r in axes)
            there = np.eye(4)
            there[[r.args[0] for r in axes], 3] = [value_of(made, r) for r in axes]
            A = (a[0], a[1] @ there, a[2]) if there[:3, 3].any() else a
            yield Tie(name, A, b, mask, L.NO_TURN if look else turns, bounds=bounds)
        if look:
            yield Tie(name, a, b, turns=turns)
        for row in (r for r in own if r.op is Op.DISTANCE):
            number = 0.0 if sided else value_of(made, row)
            yield Tie(
                name,
                a,
                b,
                turns=L.DISTANCE,
                number=number,
                bounds=(between(made, row),) if sided else (),
            )
        for tape, unit in dict.fromkeys((r.args[0], r.unit) for r in own if r.op is Op.TAPE):
            alike = [r for r in own if r.op is Op.TAPE and (r.args[0], r.unit) == (tape, unit)]
            bounds = tuple(between(made, r) for r in alike) if sided else ()
            recording = recorded(made, alike, dim, given)
            yield Tie(
                name, a, b, turns=L.TAPE, bounds=bounds, tape=recording, given=bool(recording.given)
            )


def plain_rows(made: Constraint, dim: int, given: bool = False) -> list[Row]:
    """The rows of position, of which some become expressions that are to be zero, or not negative.

    These are values of expressions, and, where numbers are `given` with each call, all values, and
    ends that differ from target to target. Errors: `InputError` for rows that have no number.
    """
    out: list[Row] = []
    for row in made.rows(dim):
        if row.velocity:
            continue
        value = held(made, row)
        sided = one_sided(made, row)
        if row.op is Op.COORDINATE or (
            (value or sided) and (row.op in TURNS or (value and row.op is Op.CALL))
        ):
            raise InputError(
                f"the row {row.name!r} of {made.label} is no number that has a value or ends"
            )
        ends = (
            {value: "equal"}
            if value
            else {n: side for n, side in ((row.low, "low"), (row.high, "high")) if n}
        )
        ends = {n: side for n, side in ends.items() if getattr(made, n) is not None}
        varied = given and any(np.ndim(getattr(made, n)) > (row.part is not None) for n in ends)
        if not (varied or (value and (given or row.op is Op.TAPE))):
            out.append(row)
            continue
        if row.op not in AS_TEXT and row.op is not Op.TAPE:
            raise InputError(
                f"{made.label} is the same for all targets: its ends cannot differ from target to "
                "target"
            )
        tape, k = (
            row.args
            if row.op is Op.TAPE
            else (from_text(AS_TEXT[row.op], POSE), row.args[0] if row.args else 0)
        )
        for name, side in ends.items():
            end = name if row.part is None else f"{name}[{row.part}]"
            off = _off(tape, k, end, side == "high", (*POSE, *made.reads))
            out.append(Row(Op.TAPE, (off, 0), row.name, row.unit, low="zero" if sided else ""))
    return out


AS_TEXT = {Op.POINT: ("x", "y", "z"), Op.DISTANCE: (f"sqrt(x^2 + y^2 + z^2 + {LEAST})",)}
"""Rows of a pose as expressions."""


@lru_cache(maxsize=256)
def _off(tape: Tape, output: int, end: str, turned: bool, varying: tuple[str, ...]) -> Tape:
    """How far an output is above an end, which is an input; `turned`: below. All but `varying` is
    constant.
    """
    inputs = list(dict.fromkeys([*tape.inputs, end]))
    build = Builder(inputs, [n for n in inputs if n not in varying])
    value = build.replayed(tape.part([output]), [build.inputs.index(n) for n in tape.inputs])[0]
    place = build.inputs.index(end)
    return build.finish([build.binary(TL.SUB, *((place, value) if turned else (value, place)))])


def every_tie(
    system: Model, name: str, made: Constraint, a: End, b: End, given: bool = False
) -> list[Tie]:
    """As `ties`, with functions, too, over coordinates that are in q."""
    found = list(ties(name, made, system.dim, a, b, given))
    for sided in (False, True):
        own = [r for r in made.rows(system.dim) if r.op is Op.CALL and one_sided(made, r) == sided]
        for what in dict.fromkeys(r.args[0] for r in own):
            alike = [r for r in own if r.args[0] == what]
            bounds = tuple(between(made, r) for r in alike) if sided else ()
            numbers = numbers_of(made)
            which = [r.args[1] for r in alike]
            bound = getattr(what, "callback", None)  # a function of the whole configuration
            call = bound(which) if bound else Callback.of_call(system, what, which, numbers)
            found.append(Tie(name, a, b, turns=L.FUNCTION, bounds=bounds, function=call))
    sources = {n: (f.source, f.multiplier, f.offset) for n, f in system.structure.couplings.items()}
    return [t if t.tape is None else replace(t, tape=t.tape.over(sources)) for t in found]


def recorded(made: Constraint, rows: list[Row], dim: int, given: bool = False) -> RecordedRows:
    """Rows of one expression, with the constraint's numbers put in; `given`: those of its fields
    come with the call.
    """
    tape = rows[0].args[0].part([r.args[1] for r in rows])
    own = {n: input_of(made, n) for n in tape.inputs if n.partition("[")[0] in _own(made, dim)}
    numbers = numbers_of(made) | ({TIME: 0.0} if getattr(made, "time", False) else {}) | own
    fixed = {k: x for k, x in numbers.items() if k in tape.inputs and not (given and k in own)}
    names = tuple(r.name for r in rows)
    unit = rows[0].unit
    posed = made.ends[1] is not None
    return RecordedRows(
        tape.fixed(fixed) if fixed else tape, names, unit, posed, tuple(own) if given else ()
    )


def _own(made: Constraint, dim: int) -> set[str]:
    """The fields whose numbers expressions read."""
    ends = {n for r in made.rows(dim) for n in (r.equal, r.low, r.high)}
    return {*numbers_in(made), *ends} - {"", *made.reads}


def value_of(made: Constraint, row: Row) -> float:
    """What a row is held at."""
    return float(number_of(made, name, row.part)) if (name := held(made, row)) else 0.0


def number_of(made: Constraint, field: str, part: int | None = None) -> Any:
    """What a field gives, or one of several numbers that it holds."""
    x = getattr(made, field)
    return x if part is None or np.ndim(x) == 0 else np.asarray(x)[..., part]


def input_of(made: Constraint, name: str) -> Any:
    """What a field gives for an input of an expression: "low", or "low[1]" for one of several
    numbers.
    """
    field, _, part = name.partition("[")
    return number_of(made, field, int(part[:-1]) if part else None)


def numbers_of(made: Constraint) -> dict[str, float]:
    """The numbers of a constraint, parameters among them, by the names that expressions have for
    them.
    """
    own = {
        k: x
        for k, x in numbers_in(made).items()
        if x is not None and np.ndim(x) == 0 and not isinstance(x, str)
    }
    given: dict[str, Any] = {**(getattr(made, "parameters", None) or {}), **own}
    return {k: float(x) for k, x in given.items() if k not in made.reads}


def between(made: Constraint, row: Row) -> tuple[float, float]:
    """Between what a one-sided row holds."""
    ends = (number_of(made, field, row.part) if field else None for field in (row.low, row.high))
    low, high = (
        infinity if x is None else float(x)
        for x, infinity in zip(ends, (-np.inf, np.inf), strict=True)
    )
    if np.isnan(low) or np.isnan(high):
        raise InputError(f"{made.label} holds between {low} and {high}; these must be numbers")
    return low, high
