"""Ties of declared constraints: their position equations between two frames, for the kernels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from kempe.constraints.base import (
    Constraint,
    Op,
    Row,
    find_value_field,
    is_one_sided,
    list_number_fields,
)
from kempe.constraints.builder import Builder, substitute_sources
from kempe.constraints.tape import POSE, TIME, Tape
from kempe.description.mechanism import evaluate_constraint
from kempe.description.parts import Declared, Joint
from kempe.errors import InputError
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints import tape_layout as TL
from kempe.model.configurations import refuse_unreadable
from kempe.model.coordinates import Relation
from kempe.model.kernel_functions import Callback, ConfigurationRows
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
    """A function of q that compiled kernels call at its `address`.

    The signature is void(double* q, double* value, double* columns, int64 flag).

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
    """A centre of masses whose sum is 1.

    `rows` (n, 4) are mass and first moment of each row of the table, in its axes.

    `rest` (3,) is the first moment of what stands on the ground.
    """

    rows: np.ndarray
    rest: np.ndarray


@dataclass(frozen=True, eq=False)
class RecordedRows:
    """Rows that are outputs of a recorded expression.

    The expression reads the pose of B in A (where `posed`), else coordinates.

    Inputs that start with no other meaning are coordinates by name.
    """

    tape: Tape
    names: tuple[str, ...]
    unit: str
    posed: bool
    given: tuple[str, ...] = ()
    """Inputs that are numbers of the call."""

    def encode_input(self, name: str) -> int:
        """Return the integer by which `loop_layout` encodes the input `name`."""
        if name in self.given:
            return L.GIVEN
        return L.PLACE + POSE.index(name) if self.posed and name in POSE else L.COORDINATE

    @property
    def pose_dependent(self) -> bool:
        """Whether the expression depends on the pose of B in A."""
        return any(self.encode_input(n) < L.COORDINATE for n in self.tape.inputs)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that the expression depends on."""
        return tuple(n for n in self.tape.inputs if self.encode_input(n) == L.COORDINATE)

    def substitute_sources(
        self, sources: Mapping[str, tuple[str | None, float, float]]
    ) -> RecordedRows:
        """Return the expression with coupled coordinates replaced by their sources.

        `sources` are (source, multiplier, offset) by name.
        """
        return replace(
            self,
            tape=substitute_sources(
                self.tape, {n: sources[n] for n in self.coordinates if n in sources}
            ),
        )


@dataclass(frozen=True, eq=False)
class Tie:
    """Equations that hold a frame B in a frame A, or coordinates, as kernels read them.

    `a` and `b` are the ends: row of the table, placement (4, 4), whether it is a particle.
    """

    name: str
    a: tuple[int, np.ndarray, bool]
    b: tuple[int, np.ndarray, bool]
    mask: int = 0
    turns: int = L.NO_TURN
    number: float = 0.0
    relation: Relation | None = None
    pin: bool = False
    """Whether the pose of frame A comes with each call."""
    joint: Joint | None = None
    """The joint whose coordinates are read off where B is in A."""
    numbers: tuple[str, ...] = ()
    """Names of the numbers of its constraint that come with each call."""
    shift: tuple[str, ...] = ()
    """For each axis of `mask` the name of the number by which the goal moves along it; '' for none."""
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
    def user_written(self) -> bool:
        """Whether the equations of the tie are an expression or a function that the user wrote."""
        return self.tape is not None or self.function is not None

    @property
    def unscaled(self) -> bool:
        """Whether the equations of the tie are plain numbers, neither metres nor radians of a pose."""
        return (
            self.relation is not None
            or self.function is not None
            or (self.tape is not None and self.tape.unit not in ("m", "rad"))
        )

    @property
    def row_names(self) -> list[str]:
        """Names of the equations of the tie."""
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
GROUND: End = (-1, np.eye(4), False)
ABOVE = (0.0, np.inf)
BELOW = (-np.inf, 0.0)
"""Bounds of what is measured from a lower, or from an upper bound."""


def list_declared_ties(system: Model, table: Table, one_sided: bool = False) -> list[Tie]:
    """List the ties of all declared constraints that hold at a value.

    With `one_sided`, those that hold between two bounds are listed, too.
    """
    every = (
        t
        for c in system._mechanism.constraints.values()
        for t in make_declared_ties(system, table, c)
    )
    return [t for t in every if one_sided or not t.bounds]


def make_declared_ties(system: Model, table: Table, declared: Declared) -> list[Tie]:
    """Make the ties of a declared constraint; one-sided ones have their bounds."""
    made = evaluate_constraint(declared, system._mechanism.parameters, system.dim)
    return make_ties(system, declared.name, made, *find_ends(system, table, declared))


def find_ends(system: Model, table: Table, declared: Declared) -> tuple[End, End]:
    """Return the frames A and B of a declared constraint: the ground twice if it reads coordinates."""
    if not declared.parent:
        return GROUND, GROUND
    ends = (
        (declared.parent, declared.child),
        declared.frames(system._mechanism.parameters, system.dim),
    )
    a, b = (
        (row, X @ E, particle)
        for (row, X, particle), E in ((table.at[n], E) for n, E in zip(*ends, strict=True))
    )
    return a, b


def make_ties(
    system: Model,
    name: str,
    made: Constraint,
    a: End,
    b: End,
    requested: bool = False,
    centre: Centre | None = None,
) -> list[Tie]:
    """Make the ties of a constraint's position rows between two ends, as few as possible.

    The pose of frame A and the numbers of a constraint that is `requested` of one call come with
    the call, except bounds that are the same for all targets. A `centre` of masses takes the place
    of frame B. Errors: `InputError` for a value or bounds of a row that cannot have them.
    """
    out: list[Tie] = []
    for side in list_sides(made, system.dim, requested):
        out += _make_pose_ties(name, side, system.dim, a, b, centre)
        out += _make_distance_ties(name, side, a, b)
        out += _make_tape_ties(name, side, system, a, b)
        out += _make_function_ties(name, side, system, a, b)
        out += _make_coordinate_ties(name, side)
    return out


class Side(NamedTuple):
    """Rows of one constraint that are held at values, or between bounds.

    `end` is "low" or "high" where this bound comes with each call, else "".
    """

    made: Constraint
    rows: list[Row]
    sided: bool
    requested: bool
    end: str = ""

    def find_number_name(self, row: Row) -> str:
        """Return the name of the number that a row is measured from, "" where that is zero."""
        field = getattr(row, self.end) if self.end else find_value_field(self.made, row)
        return format_input_name(field, row.part)

    def list_bounds(self, rows: list[Row]) -> tuple[tuple[float, float], ...]:
        """List the bounds of some rows, measured from their numbers.

        It is empty for rows that hold at values.
        """
        if not self.sided:
            return ()
        if self.end:
            return (ABOVE if self.end == "low" else BELOW,) * len(rows)
        return tuple(get_row_bounds(self.made, r) for r in rows)


def list_sides(made: Constraint, dim: int, requested: bool) -> list[Side]:
    """Group the position rows of a constraint by how their values are given.

    Rows hold at values, between fixed bounds, or on one side of a bound that comes with the call.
    Errors: `InputError` for a value or bounds of a row that cannot have them.
    """
    rows = [r for r in made.list_rows(dim) if not r.velocity]
    for row in rows:
        _check_row_number(made, row, requested)
    varied_rows = [r for r in rows if requested and has_varied_bounds(made, r)]
    fixed_rows = [r for r in rows if is_one_sided(made, r) and r not in varied_rows]
    sides = [
        Side(made, [r for r in rows if not is_one_sided(made, r)], False, requested),
        Side(made, fixed_rows, True, requested),
    ]
    for end in ("low", "high"):
        rows_with_end = [r for r in varied_rows if end in list_varied_ends(made, r)]
        sides.append(Side(made, rows_with_end, True, requested, end))
    return [side for side in sides if side.rows]


def has_varied_bounds(made: Constraint, row: Row) -> bool:
    """Tell whether a row is held between bounds that differ from target to target."""
    if not is_one_sided(made, row):
        return False
    plain = 0 if row.part is None else 1
    return any([field and np.ndim(getattr(made, field)) > plain for field in (row.low, row.high)])


def list_varied_ends(made: Constraint, row: Row) -> tuple[str, ...]:
    """List which bounds of a row, "low" or "high", differ from target to target and are finite."""
    if not has_varied_bounds(made, row):
        return ()
    out: list[str] = []
    for end in ("low", "high"):
        field = getattr(row, end)
        x = get_field_number(made, field, row.part) if field else None
        if x is not None and not np.isinf(x).all():
            out.append(end)
    return tuple(out)


def _check_row_number(made: Constraint, row: Row, requested: bool) -> None:
    """Refuse a value or bounds for a row that cannot have them. Errors: `InputError`."""
    value = find_value_field(made, row)
    whole = row.op in TURNS and (value or is_one_sided(made, row))
    if whole or (value and row.op is Op.CALL) or (row.op is Op.COORDINATE and not requested):
        raise InputError(
            f"the row {row.name!r} of {made.label} is no number that has a value or ends"
        )
    if requested and row.op is Op.CALL and has_varied_bounds(made, row):
        raise InputError(
            f"{made.label} is the same for all targets: its ends cannot differ from target to "
            "target"
        )


def _make_pose_ties(
    name: str, side: Side, dim: int, a: End, b: End, centre: Centre | None
) -> list[Tie]:
    """Make the tie of position and rotation rows, or two ties where B looks at A."""
    axes = [r for r in side.rows if r.op is Op.POINT]
    turns = next((TURNS[r.op][dim] for r in side.rows if r.op in TURNS), L.NO_TURN)
    pin = side.requested
    look = turns == L.LOOK and bool(axes)  # which is towards the origin of A
    out: list[Tie] = []
    if axes or turns != L.NO_TURN:
        axes.sort(key=lambda r: r.args[0])
        mask = sum(1 << r.args[0] for r in axes)
        shift = tuple(side.find_number_name(r) for r in axes)
        A = a
        if not pin and any(shift):
            there = np.eye(4)
            there[[r.args[0] for r in axes], 3] = [get_row_value(side.made, r) for r in axes]
            A = (a[0], a[1] @ there, a[2])
        out.append(
            Tie(
                name,
                A,
                b,
                mask,
                L.NO_TURN if look else turns,
                pin=pin,
                bounds=side.list_bounds(axes),
                centre=centre,
                shift=shift if pin and any(shift) else (),
            )
        )
    if look:
        out.append(Tie(name, a, b, turns=turns, pin=pin))
    return out


def _make_distance_ties(name: str, side: Side, a: End, b: End) -> list[Tie]:
    """Make a tie for each row of a distance."""
    out: list[Tie] = []
    for row in (r for r in side.rows if r.op is Op.DISTANCE):
        number = side.find_number_name(row)
        call = side.requested and number
        out.append(
            Tie(
                name,
                a,
                b,
                turns=L.DISTANCE,
                number=0.0 if side.sided or call else get_row_value(side.made, row),
                pin=side.requested,
                bounds=side.list_bounds([row]),
                numbers=(number,) if call else (),
            )
        )
    return out


def _make_tape_ties(name: str, side: Side, system: Model, a: End, b: End) -> list[Tie]:
    """Make a tie for the rows of each recorded expression, over coordinates that are in q.

    Rows with values, and bounds that come with the call, are expressions that are to be zero, or
    not negative.
    """
    made = side.made
    rows: list[Row] = []
    for row in (r for r in side.rows if r.op is Op.TAPE):
        number = side.find_number_name(row)
        if number:
            off = _make_excess_tape(
                *row.args, number, side.end == "high", (*POSE, *made.coordinate_names)
            )
            row = Row(Op.TAPE, (off, 0), row.name, row.unit)
        rows.append(row)
    sources = {n: (f.source, f.multiplier, f.offset) for n, f in system.structure.couplings.items()}
    out: list[Tie] = []
    for tape, unit in dict.fromkeys((r.args[0], r.unit) for r in rows):
        alike = [r for r in rows if (r.args[0], r.unit) == (tape, unit)]
        recording = record_rows(made, alike, system.dim, side.requested)
        refuse_unreadable(system, recording.coordinates, made.label)
        bounds = (ABOVE,) * len(alike) if side.end else side.list_bounds(alike)
        out.append(
            Tie(
                name,
                a,
                b,
                turns=L.TAPE,
                pin=side.requested and recording.posed,
                bounds=bounds,
                tape=recording.substitute_sources(sources),
                numbers=recording.given,
            )
        )
    return out


def _make_function_ties(name: str, side: Side, system: Model, a: End, b: End) -> list[Tie]:
    """Make a tie for the rows of each Python function."""
    out: list[Tie] = []
    calls = [r for r in side.rows if r.op is Op.CALL]
    for what in dict.fromkeys(r.args[0] for r in calls):
        alike = [r for r in calls if r.args[0] == what]
        which = [r.args[1] for r in alike]
        call = (
            what.make_callback(which)
            if isinstance(what, ConfigurationRows)
            else Callback.from_call(system, what, which, collect_numbers(side.made))
        )
        out.append(Tie(name, a, b, turns=L.FUNCTION, bounds=side.list_bounds(alike), function=call))
    return out


def _make_coordinate_ties(name: str, side: Side) -> list[Tie]:
    """Make a tie for each coordinate or quaternion that is held at numbers of the call."""
    out: list[Tie] = []
    for v, _, number, ball in (r.args for r in side.rows if r.op is Op.COORDINATE):
        out.append(Tie(name, GROUND, GROUND, turns=L.OWN, own=v, ball=ball, numbers=(number,)))
    return out


@lru_cache(maxsize=256)
def _make_excess_tape(
    tape: Tape, output: int, end: str, turned: bool, varying: tuple[str, ...]
) -> Tape:
    """Make the tape of how far an output is above a bound, which is an input of the tape.

    With `turned` it is how far the output is below. All inputs but `varying` are constant.
    """
    inputs = list(dict.fromkeys([*tape.inputs, end]))
    build = Builder(inputs, [n for n in inputs if n not in varying])
    value = build.replay_tape(
        tape.select_outputs([output]), [build.inputs.index(n) for n in tape.inputs]
    )[0]
    place = build.inputs.index(end)
    return build.finish_tape(
        [build.add_binary(TL.SUB, *((place, value) if turned else (value, place)))]
    )


def record_rows(made: Constraint, rows: list[Row], dim: int, given: bool = False) -> RecordedRows:
    """Record rows of one expression, with the numbers of the constraint inserted.

    With `given`, the numbers of its fields stay inputs that come with each call.
    """
    tape = rows[0].args[0].select_outputs([r.args[1] for r in rows])
    own = {n: get_input_number(made, n) for n in list_recorded_numbers(made, dim, tape)}
    numbers = collect_numbers(made) | ({TIME: 0.0} if getattr(made, "time", False) else {}) | own
    fixed = {k: x for k, x in numbers.items() if k in tape.inputs and not (given and k in own)}
    names = tuple(r.name for r in rows)
    unit = rows[0].unit
    posed = made.ends[1] is not None
    return RecordedRows(
        tape.fix_inputs(fixed) if fixed else tape, names, unit, posed, tuple(own) if given else ()
    )


def list_recorded_numbers(made: Constraint, dim: int, tape: Tape) -> list[str]:
    """List the inputs of an expression that are numbers in fields of the constraint."""
    ends = {n for r in made.list_rows(dim) for n in (r.equal, r.low, r.high)}
    fields = {*list_number_fields(made), *ends} - {"", *made.coordinate_names}
    return [n for n in tape.inputs if n.partition("[")[0] in fields]


def get_row_value(made: Constraint, row: Row) -> float:
    """Return the value at which a row is held."""
    return (
        float(get_field_number(made, name, row.part))
        if (name := find_value_field(made, row))
        else 0.0
    )


def get_field_number(made: Constraint, field: str, part: int | None = None) -> Any:
    """Return the number in a field, or one of several numbers in it."""
    x = getattr(made, field)
    return x if part is None or np.ndim(x) == 0 else np.asarray(x)[..., part]


def format_input_name(field: str, part: int | None = None) -> str:
    """Return the name of a number of a field: "low", or "low[1]" for one of several.

    The name is "" where there is no field.
    """
    return field if not field or part is None else f"{field}[{part}]"


def get_input_number(made: Constraint, name: str) -> Any:
    """Return the number of a field by a name from `format_input_name`."""
    field, _, part = name.partition("[")
    return get_field_number(made, field, int(part[:-1]) if part else None)


def collect_numbers(made: Constraint) -> dict[str, float]:
    """Return the numbers and parameters of a constraint, by the names that expressions use."""
    own = {
        k: x
        for k, x in list_number_fields(made).items()
        if x is not None and np.ndim(x) == 0 and not isinstance(x, str)
    }
    given: dict[str, Any] = {**(getattr(made, "parameters", None) or {}), **own}
    return {k: float(x) for k, x in given.items() if k not in made.coordinate_names}


def get_row_bounds(made: Constraint, row: Row) -> tuple[float, float]:
    """Return the lower and the upper bound of a one-sided row. Errors: `InputError`."""
    ends = (
        get_field_number(made, field, row.part) if field else None for field in (row.low, row.high)
    )
    low, high = (
        infinity if x is None else float(x)
        for x, infinity in zip(ends, (-np.inf, np.inf), strict=True)
    )
    if np.isnan(low) or np.isnan(high):
        raise InputError(f"{made.label} holds between {low} and {high}; these must be numbers")
    if not (low <= high and low < np.inf and high > -np.inf):
        raise InputError(f"{made.label} holds between {low} and {high}, which is nothing")
    return low, high
