"""Loops packed for the kernels: ties between frames over coordinates, as arrays.

A tie is one constraint between two frames: of a cut joint, a declared constraint, a frame held in
place, or a linear relation of coordinates.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.description.parts import Joint
from kempe.joints import P, Q
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.forward.table_layout import HEADER, NV, OUTPUT_INTS, ROW_INTS
from kempe.model.characteristic_length import (
    choose_origin,
    compute_characteristic_length,
    move_table,
)
from kempe.model.constraint_program import (
    Centre,
    CompiledFunction,
    RecordedRows,
    Tie,
    list_declared_ties,
)
from kempe.model.coordinates import Relation, find_periodic_angles, list_coordinate_names
from kempe.model.implicit_form import ImplicitForm, find_implicit_form, has_slide_along_z
from kempe.model.model import keep_answers
from kempe.model.primitive_table import End, Table, make_primitive_table

if TYPE_CHECKING:
    from kempe.model.model import Model


@dataclass(frozen=True, eq=False)
class PackedLoops:
    """The loop closures and constraints ("ties") of a system as arrays for the kernels.

    A tie is a set of equations that hold a frame B in a frame A. `ints` and `floats` are the table
    of primitives; the other arrays are as in `loop_layout`.
    """

    ties: tuple[Tie, ...]
    names: tuple[tuple[str, str], ...]
    """For each equation the name of its tie and what it is of it."""
    ints: np.ndarray
    floats: np.ndarray
    plan: np.ndarray
    weights: np.ndarray
    unknown: np.ndarray
    """Velocity coordinates (k,) that are solved for."""
    length: float
    origin: np.ndarray
    """Where (3,) the origin of the table is in the ground: pins are placed from there."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set the pickled state; functions have other addresses in this process."""
        vars(self).update(state)
        for k, tie in enumerate(self.ties):
            if tie.function is not None:
                place = int(self.plan[L.AT_TIES]) + L.TIE_INTS * k + L.DATA
                self.plan[place] = tie.function.address

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each equation: "m", "rad", or that of an expression."""
        return tuple(
            "m" if i < n else "rad" if t.tape is None else t.tape.unit
            for t, n in zip(self.ties, self.lengths, strict=True)
            for i in range(len(t.row_names))
        )

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper bounds (2, m) of the scaled equations; zero for those that hold exactly."""
        ends = np.zeros((len(self.names), 2))
        first = int(self.plan[L.AT_BOUNDS])
        at = 0
        for k, tie in enumerate(self.ties):
            n = len(tie.row_names)
            if tie.bounds:
                place = first + int(self.plan[self.plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND])
                ends[at : at + n] = self.weights[place : place + 2 * n].reshape(n, 2)
            at += n
        return ends.T

    @property
    def tie_coordinates(self) -> list[list[int]]:
        """For each tie, the unknown velocity coordinates that its equations depend on."""
        unknown = set(self.unknown.tolist())
        out = list[list[int]]()
        for tie in self.plan[self.plan[L.AT_TIES] :][: L.TIE_INTS * len(self.ties)].reshape(
            -1, L.TIE_INTS
        ):
            at = int(self.plan[L.AT_LOCALS] + tie[L.LOCAL])
            out.append([v for v in self.plan[at : at + tie[L.LOCALS]].tolist() if v in unknown])
        return out

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns (k,) of the entries of the Jacobian that are not zero by structure."""
        row: list[np.ndarray] = []
        column: list[np.ndarray] = []
        first = 0
        for tie, coordinates in zip(self.ties, self.tie_coordinates, strict=True):
            count = len(tie.row_names)
            row.append(np.repeat(np.arange(first, first + count), len(coordinates)))
            column.append(np.tile(np.array(coordinates, dtype=np.int64), count))
            first += count
        none = np.zeros(0, dtype=np.int64)
        return np.concatenate([none, *row]), np.concatenate([none, *column])

    @property
    def lengths(self) -> list[int]:
        """For each tie, how many of its first equations are lengths."""
        at = int(self.plan[L.AT_TIES]) + L.LENGTHS
        return self.plan[at : at + L.TIE_INTS * len(self.ties) : L.TIE_INTS].tolist()

    @property
    def scale(self) -> np.ndarray:
        """Unit (nv,) of each velocity coordinate in the kernels, in radians or metres; a view."""
        return L.view_velocity_lists(self.weights, int(self.ints[NV]))[0]

    @cached_property
    def functions(self) -> tuple[CompiledFunction, ...]:
        """Compiled functions of the user among the constraints."""
        return tuple(t.function for t in self.ties if t.function is not None)

    def raise_function_error(self) -> None:
        """Raise the error, if any, that a user's function raised while a kernel called it."""
        for f in self.functions:
            if f.error is not None:
                error = f.error
                f.error = None
                raise error

    def list_columns(self, k: int) -> list[int]:
        """List the velocity coordinates that the equations of tie k depend on."""
        tie = self.plan[self.plan[L.AT_TIES] + L.TIE_INTS * k :]
        at = int(self.plan[L.AT_LOCALS] + tie[L.LOCAL])
        return self.plan[at : at + int(tie[L.LOCALS])].tolist()


# ---- arrays for the kernels

# Their layout is that of `kempe.kernels.constraints.loop_layout`.

READINGS = {
    "x": L.READ_X,
    "y": L.READ_Y,
    "z": L.READ_Z,
    "turn z": L.READ_ANGLE,
    "turn rx": L.READ_RX,
    "turn ry": L.READ_RY,
    "turn yaw": L.READ_YAW,
    "turn pitch": L.READ_PITCH,
    "turn roll": L.READ_ROLL,
    "quaternion": L.READ_QUATERNION,
}


def _list_readings(system: Model, joint: Joint) -> list[tuple[int, int]]:
    """List how each coordinate of a joint is read off the pose of M in F, with its place in q."""
    names = list_coordinate_names(system._mechanism, joint)
    first = system.structure.coordinates.first
    form = find_implicit_form(
        joint.type, system.dim, system._mechanism.bodies[joint.child].particle
    )
    return [(READINGS[how], first[names[k]][0]) for k, how in (form.readings if form else ())]


def find_moving_rows(a: int, b: int, parent: np.ndarray) -> list[tuple[float, int]]:
    """Return the rows that move row b against row a, with the sign of their motion.

    Row -1 is the ground.
    """
    ways: list[list[int]] = []
    for row in (a, b):
        way: list[int] = []
        while row >= 0:
            way.append(row)
            row = int(parent[row])
        ways.append(way)
    common = set(ways[0]) & set(ways[1])
    return [
        (sign, r)
        for sign, way in zip((-1.0, 1.0), ways, strict=True)
        for r in way
        if r not in common
    ]


def pack_tapes(
    recorded: list[tuple[np.ndarray, np.ndarray, list[int]]], at: int, numbers_at: int
) -> tuple[np.ndarray, list[int]]:
    """Pack the integers of TAPE ties as `loop_layout` says, and where those of each tie begin.

    The numbers of their tapes stand at `numbers_at`, one after the other.
    """
    out: list[int] = []
    work = 0
    starts: list[int] = []
    for ints, floats, inputs in recorded:
        starts.append(at + len(out))
        out += [starts[-1] + L.TAPE_INPUTS + len(inputs), numbers_at, work, *inputs, *ints.tolist()]
        numbers_at = numbers_at + len(floats)
        work = work + 3 * int(ints[1])
    return np.array(out, dtype=np.int64), starts


class LoopPlan:
    """The integers and numbers of `loop_layout`, as they are collected."""

    def __init__(
        self,
        system: Model,
        ties: list[Tie],
        ints: np.ndarray,
        held: frozenset[str],
        length: float,
        scaled: bool,
        wide: np.ndarray | None = None,
    ):
        self.system = system
        self.ties = ties
        self.length = length
        self.scaled = scaled
        self.number = [t.number for t in ties]
        n = int(ints[0])
        self.rows = ints[HEADER : HEADER + ROW_INTS * n].reshape(n, ROW_INTS)
        self.outputs = ints[HEADER + ROW_INTS * n :].reshape(-1, OUTPUT_INTS)
        self.held = np.array([name in held for name in system.structure.velocity_names], dtype=bool)
        c = system.structure.coordinates
        self.turns = c.angular
        self.scale = np.where(self.turns, 1.0, length)
        self.place = np.full(system.nv, -1, dtype=np.int64)
        self.sort = np.full(system.nv, L.SLIDE, dtype=np.int64)
        self.place[system.structure.layout.vector_v] = system.structure.layout.vector_q
        self.place[system.structure.layout.quaternion_v] = system.structure.layout.quaternion_q
        self.sort[self.turns] = L.BOUND_TURN
        self.sort[find_periodic_angles(system._mechanism, c)] = L.CIRCLE
        self.wide = np.zeros(system.nv, dtype=bool) if wide is None else wide
        self.sort[self.wide] = L.CIRCLE
        for iv in system.structure.layout.quaternion_v:
            self.sort[iv : iv + 3] = L.BALL_FIRST, L.BALL_MORE, L.BALL_MORE
        self.entries: list[tuple[int, int]] = []
        self.factors: list[float] = []
        self.locals: list[int] = []
        self.uses: list[list[tuple[int, int]]] = [[] for _ in range(system.nv)]
        self.recorded: list[tuple[np.ndarray, np.ndarray, list[int]]] = []
        """Of each TAPE tie the integers and numbers of its tape, and what its inputs are."""

    def pack_tie(self, k: int, tie: Tie) -> list[int]:
        """Return the integers of tie k, and append its entries and locals."""
        entry = len(self.entries)
        local = len(self.locals)
        columns: dict[int, int] = {}
        if tie.relation is not None:
            self._pack_relation(k, tie.relation, columns)
        elif tie.turns == L.OWN:
            columns.update({tie.own + n: n for n in range(3 if tie.ball else 1)})
        elif tie.function is not None:
            columns.update({v: n for n, v in enumerate(tie.function.support)})
        else:
            for sign, row in (
                self._list_moving_rows(k, tie)
                if tie.tape is None or tie.tape.pose_dependent
                else ()
            ):
                kind = int(self.rows[row, 0])
                iv = int(self.rows[row, 3])
                if self.held[iv]:
                    continue
                first = columns.setdefault(iv, len(columns))
                for more in range(1, 3 if kind == Q else 1):
                    columns.setdefault(iv + more, len(columns))
                self.entries.append((row, first))
                self.factors.append(sign)
        if tie.tape is not None:
            self._record_tape(tie.tape, columns)
        self.locals += list(columns)
        for v, column in columns.items():
            if not self.held[v]:
                self.uses[v].append((k, column))
        return [len(self.entries) - entry, entry, len(columns), local]

    def _record_tape(self, recorded: RecordedRows, columns: dict[int, int]) -> None:
        """Collect the tape of a TAPE tie and the meaning of each of its inputs."""
        ints, floats = recorded.tape.make_arrays()
        first = self.system.structure.coordinates.first
        inputs: list[int] = []
        for name in recorded.tape.inputs:
            place = -1
            column = -1
            if (what := recorded.encode_input(name)) == L.COORDINATE:
                place, v = first[name]
                column = -1 if self.held[v] else columns.setdefault(v, len(columns))
            elif what == L.GIVEN:
                place = recorded.given.index(name)
            inputs += [what, place, column]
        self.recorded.append((ints, floats, inputs))

    def _pack_relation(self, k: int, relation: Relation, columns: dict[int, int]) -> None:
        """Append the terms of a linear relation of coordinates, scaled to unit size."""
        first = self.system.structure.coordinates.first
        terms = {relation.of: 1.0}
        for name, m in relation.sources.items():
            terms[name] = terms.get(name, 0.0) - m
        self.number[k] /= (
            norm := max(abs(m) * self.scale[first[n][1]] for n, m in terms.items()) ** self.scaled
        )
        for name, factor in terms.items():
            columns[first[name][1]] = len(columns)  # held ones, too: their values count
            self.entries.append((first[name][0], 0))
            self.factors.append(factor / norm)

    def _list_moving_rows(self, k: int, tie: Tie) -> list[tuple[float, int]]:
        """List the rows that move B against A, with signs.

        A centre of mass is moved by all rows that carry mass, and A moves apart.
        """
        if tie.centre is None:
            return self._find_rows_between(k)
        share = self._sum_moved_masses(tie.centre)
        return [
            (-s, r) for s, r in find_moving_rows(int(self.outputs[2 * k, 0]), -1, self.rows[:, 1])
        ] + [(1.0, r) for r in range(len(share)) if share[r] > 0.0]

    def _sum_moved_masses(self, centre: Centre) -> np.ndarray:
        """Return, for each row (n,), the mass of all that the row moves."""
        share = centre.rows[:, 0].copy()
        for r in range(len(share) - 1, -1, -1):
            if self.rows[r, 1] >= 0:
                share[self.rows[r, 1]] += share[r]
        return share

    def _find_rows_between(self, k: int) -> list[tuple[float, int]]:
        """Return the rows that move frame B of tie k against its frame A, with signs."""
        return find_moving_rows(
            int(self.outputs[2 * k, 0]), int(self.outputs[2 * k + 1, 0]), self.rows[:, 1]
        )

    def make_arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the integer array and the number array of `loop_layout`."""
        first_row = 0
        block = 0
        pin = 0
        given = 0
        ties: list[list[int]] = []
        bounds: list[float] = []
        centres: list[np.ndarray] = []
        for k, tie in enumerate(self.ties):
            n_entries, entry, n_locals, local = self.pack_tie(k, tie)
            rows = len(tie.row_names)
            data = tie.function.address if tie.function is not None else tie.own
            work = 0
            if tie.tape is not None:
                data = len(self.recorded) - 1
                work = 3 * tie.tape.tape.size
            ties.append(
                [
                    tie.mask,
                    tie.turns,
                    rows,
                    first_row,
                    n_entries,
                    entry,
                    n_locals,
                    local,
                    block,
                    pin if tie.pin else -1,
                    self._count_lengths(tie),
                    given if tie.numbers else -1,
                    len(bounds) if tie.bounds else -1,
                    len(centres) if tie.centre is not None else -1,
                    data,
                ]
            )
            pin = pin + tie.pin
            given = given + (4 if tie.ball else len(tie.numbers))
            first_row = first_row + rows
            block = block + rows * n_locals + work
            unit = self.length if self._count_lengths(tie) else 1.0
            bounds += [x / unit for low, high in tie.bounds for x in (low, high)]
            if tie.centre is not None:
                rows_ = np.column_stack([tie.centre.rows, self._sum_moved_masses(tie.centre)])
                centres += [np.concatenate([rows_.ravel(), tie.centre.rest])]
        reading = [
            (code, iq, k)
            for k, t in enumerate(self.ties)
            if t.joint is not None
            for code, iq in _list_readings(self.system, t.joint)
        ]
        envelope, size = self._compute_envelope(ties)
        starts = np.concatenate([[0], np.cumsum([len(u) for u in self.uses])])
        lists = [
            ties,
            self.entries,
            self.locals,
            starts,
            [x for u in self.uses for x in u],
            envelope,
            reading,
            np.stack([self.place, self.sort, self.held], axis=1),
        ]
        flat = [np.asarray(x, dtype=np.int64).ravel() for x in lists]
        places = L.HEAD + np.concatenate([[0], np.cumsum([len(x) for x in flat])])
        numbers_at = (
            sum(len(x) for x in (self.number, self.factors, bounds)) + 2 + 5 * self.system.nv
        )
        numbers_at += sum(len(c) for c in centres)
        read, starts_at = pack_tapes(self.recorded, int(places[-1]), numbers_at)
        for t, tie in zip(flat[0].reshape(-1, L.TIE_INTS), self.ties, strict=True):
            if tie.tape is not None:
                t[L.DATA] = starts_at[t[L.DATA]]
        flat.append(read)
        head = [len(ties), first_row, len(reading), pin, block, size, *places[:8].tolist()]
        lists = [
            [1.0 / self.length, self.length],
            [*self.scale, *self._list_ranges()],
            self.number,
            self.factors,
            bounds,
        ]
        at = np.cumsum([len(x) for x in lists])
        head += [*at[1:].tolist(), *self._find_base_tie()]
        lists += [*centres, *(x for _, x, _ in self.recorded)]
        weights = np.concatenate([np.array(x, dtype=float) for x in lists])
        return np.concatenate([np.array(head, dtype=np.int64), *flat]), weights

    def _count_lengths(self, tie: Tie) -> int:
        """Count the first equations of a tie that are lengths."""
        if tie.turns == L.OWN:
            return int(self.sort[tie.own] == L.SLIDE)
        if tie.tape is not None:
            return len(tie.row_names) * (tie.tape.unit == "m")
        return tie.mask.bit_count() + (tie.turns == L.DISTANCE)

    def _find_base_tie(self) -> tuple[int, int]:
        """Find a tie that holds a frame, carried by a free joint, in the ground.

        Returned are the tie and the first of that joint's rows, or -1, -1.
        """
        if (
            len(self.rows) < 4
            or self.rows[:4, 0].tolist() != [P, P, P, Q]
            or np.any(self.rows[:4, 1] != range(-1, 3))
        ):
            return -1, -1
        for turns in (L.FULL, L.NO_TURN):
            for k, tie in enumerate(self.ties):
                held = (
                    tie.mask == 7 and tie.turns == turns and not tie.bounds and tie.centre is None
                )
                way = [r for _, r in self._find_rows_between(k)] if tie.pin and held else []
                if self.outputs[2 * k, 0] < 0 and set(range(4)) <= set(way):
                    return k, 0
        return -1, -1

    def _list_ranges(self) -> list[float]:
        """List the limits of coordinates, then the ranges in which random ones are drawn."""
        low = self.system.structure.coordinates.lower
        high = self.system.structure.coordinates.upper
        reach = np.where(self.turns, np.pi, self.length)
        far = np.where(np.isfinite(low), low, -np.inf)
        near = np.where(np.isfinite(high), high, np.inf)
        draw_low = np.where(
            np.isfinite(low), low, np.where(np.isfinite(high), near - 2.0 * reach, -reach)
        )
        draw_high = np.where(
            np.isfinite(high), high, np.where(np.isfinite(low), far + 2.0 * reach, reach)
        )
        return [
            *np.where(self.wide, -np.inf, low),
            *np.where(self.wide, np.inf, high),
            *draw_low,
            *draw_high,
        ]

    def _compute_envelope(self, ties: list[list[int]]) -> tuple[list[tuple[int, int]], int]:
        """Compute the first nonzero column of each row of J J^T, and where the row begins."""
        own = [t[L.FIRST_ROW] for t in ties]
        first = own.copy()
        for use in self.uses:
            if use:
                least = min(own[k] for k, _ in use)
                for k, _ in use:
                    first[k] = min(first[k], least)
        at = 0
        out: list[tuple[int, int]] = []
        for k, t in enumerate(ties):
            for r in range(t[L.ROWS]):
                out.append((first[k], at))
                at += t[L.FIRST_ROW] + r - first[k] + 1
        return out, at


# ---- packing a system

Places = dict[str, tuple[int, int]]
"""For each coordinate by name its place in q, and in the velocities."""
TURNS = {"": L.NO_TURN, "z": L.ANGLE, "xy": L.ALIGN, "x.y": L.CROSS, "xyz": L.FULL}


def find_explicit_joints(system: Model, known: Iterable[str] = ()) -> frozenset[str]:
    """Find the cut joints that must be explicit loop joints.

    They have no implicit form, or known, limited or coupled coordinates.
    """
    related = {n for r in system.structure.relations for n in (r.of, *r.sources)} | set(known)
    related |= {n for c in system._mechanism.constraints.values() for n in c.of.coordinate_names}
    # others move with them
    related |= {f.source for f in system.structure.couplings.values() if f.source is not None}
    v_index = {n: i for i, n in enumerate(system.structure.velocity_names)}
    limited = np.isfinite(system.lower) | np.isfinite(system.upper)
    out: set[str] = set()
    for name in system.structure.closures:
        names = system.structure.coordinates_of_joint(name)
        none = _find_implicit_form(system, system.structure.joints[name]) is None
        if none or any(
            c in system.structure.couplings
            or c in related
            or (c in v_index and limited[v_index[c]])
            for c in names
        ):
            out.add(name)
    return frozenset(out)


def get_packed_loops(
    system: Model,
    explicit: frozenset[str],
    held: frozenset[str] = frozenset(),
    pins: tuple[tuple[str, bool], ...] = (),
    length: float | None = None,
    one_sided: bool = False,
) -> PackedLoops:
    """Return the packed loops of a system.

    With `one_sided`, declared constraints that hold between bounds are included.

    `explicit` names the left-out joints in explicit form, `held` the velocity coordinates that are
    no unknowns, `pins` the frames that are held in place (with their orientation where the flag
    says so). Equations and unknowns are scaled by `length` (default: the characteristic length);
    with length 1 they are in metres.
    """
    return _pack_once(system, explicit, held, pins, length, one_sided)


@keep_answers
def _pack_once(
    system: Model,
    explicit: frozenset[str],
    held: frozenset[str],
    pins: tuple[tuple[str, bool], ...],
    length: float | None,
    one_sided: bool,
) -> PackedLoops:
    """Return the packed loops of a system, packed in the first call with these arguments."""
    return pack_loops(system, explicit, held, pins, length, one_sided=one_sided)


def pack_loops(
    system: Model,
    explicit: frozenset[str],
    held: frozenset[str] = frozenset(),
    pins: tuple[tuple[str, bool], ...] = (),
    length: float | None = None,
    further: Callable[[Table], list[Tie]] | None = None,
    wide: np.ndarray | None = None,
    level: Callable[[Tie], int] | None = None,
    one_sided: bool = False,
    drawn: Model | None = None,
) -> PackedLoops:
    """Pack the loops of a system anew, with `further` ties over the rows of the table.

    `wide` (nv,) marks angles whose limits do not count, for whole turns lead back into them. Ties
    of a lower `level` stand before others, so that of rows that depend on each other the later ones
    yield. The frames of `further` ties are those of the `drawn` system, where given: it has the
    same coordinates, and other dimensions.
    """
    size = compute_characteristic_length(system) if length is None else length
    origin = choose_origin(system)
    table = _make_loop_table(system, {n: n in explicit for n in system.structure.closures}, origin)
    frames = table
    if drawn is not None:
        table, frames = _join_tables(_make_loop_table(drawn, {}, origin), table)
    ties = _list_ties(system, table, explicit, pins, one_sided) + (
        further(frames) if further else []
    )
    ties = [t for t in ties if t.row_names or t.joint]
    first = system.structure.coordinates.first
    ties = (
        _order_ties_by_level(ties, table, level, first)
        if level
        else _order_ties(ties, table, first)
    )
    at = dict(table.at)
    for k, tie in enumerate(ties):
        at["tie", k, 0] = tie.a
        at["tie", k, 1] = tie.b
    table = replace(table, at=at)
    # a centre is moved by all that has mass
    every = range(len(table.kind)) if any(t.centre for t in ties) else None
    ints, floats = table.pack_arrays(
        [("tie", k, end) for k in range(len(ties)) for end in (0, 1)], every
    )
    plan, weights = LoopPlan(system, ties, ints, held, size, length is None, wide).make_arrays()
    for tie in ties:
        if tie.function is not None:
            tie.function.scale = L.view_velocity_lists(weights, system.nv)[0]
    names = tuple((t.name, row) for t in ties for row in t.row_names)
    unknown = np.array(
        [i for i, n in enumerate(system.structure.velocity_names) if n not in held], dtype=np.int64
    )
    return PackedLoops(tuple(ties), names, ints, floats, plan, weights, unknown, size, origin)


def _make_loop_table(system: Model, ends: dict[str, bool], origin: np.ndarray) -> Table:
    """Make the primitive table with the ends of cut joints, measured from `origin` (3,)."""
    mechanism = system._mechanism
    given = system.structure
    table = make_primitive_table(
        mechanism, given.topology, given.coordinates, mechanism.parameters, ends
    )
    return move_table(table, -origin) if origin.any() else table


def _join_tables(first: Table, second: Table) -> tuple[Table, Table]:
    """Join two tables over the same coordinates to one, with the ends of each of them.

    The first one returned has the ends of the second, the other one those of the first.
    """
    n = len(first.kind)
    behind = np.where(second.parent < 0, -1, second.parent + n)
    ends = {
        name: (row if row < 0 else row + n, X, particle)
        for name, (row, X, particle) in second.at.items()
    }
    both = Table(
        np.concatenate([first.kind, second.kind]),
        np.concatenate([first.parent, behind]),
        np.concatenate([first.iq, second.iq]),
        np.concatenate([first.iv, second.iv]),
        np.concatenate([first.multiplier, second.multiplier]),
        np.concatenate([first.offset, second.offset]),
        np.concatenate([first.placement, second.placement]),
        ends,
        second.nq,
        second.nv,
    )
    return both, replace(both, at=first.at)


# ---- ties of a system

# A joint that the tree left out is tied in one of two forms. *Implicit*, A is its frame F and B its
# frame M, held as the joint holds them; its own coordinates are read off afterwards. *Explicit*, A
# is led on through the joint's own motion, and coincides with B; its coordinates are unknowns like
# all others. So a coordinate that is known, limited or coupled needs nothing special, and neither
# does a joint type that has no implicit form (`kempe.model.implicit_form`).


def make_explicit_table(system: Model) -> Table:
    """Make the primitive table with the ends of all cut joints, led on through their own motion."""
    closures = dict.fromkeys(system.structure.closures, True)
    return _make_loop_table(system, closures, np.zeros(3))


def list_position_ties(system: Model, table: Table) -> list[Tie]:
    """List all ties that hold positions: of cut joints, explicit, and of declared constraints.

    One-sided constraints are among them. `table` has the frames of these joints, led on through
    their motion.
    """
    return _list_ties(system, table, frozenset(system.structure.closures), (), True)


def _list_ties(
    system: Model,
    table: Table,
    explicit: frozenset[str],
    pins: tuple[tuple[str, bool], ...],
    one_sided: bool,
) -> list[Tie]:
    """List the ties of cut joints, declared constraints, relations and pinned frames."""
    mechanism = system._mechanism
    ties = [
        _make_joint_tie(system, table, mechanism.joints[n], n in explicit)
        for n in system.structure.closures
    ]
    ties += list_declared_ties(system, table, one_sided)
    ground = (-1, np.eye(4), False)
    for relation in system.structure.relations:
        ties.append(
            Tie(
                relation.of,
                ground,
                ground,
                turns=L.LINEAR,
                number=relation.offset,
                relation=relation,
            )
        )
    for frame, turned in pins:
        mask = _make_axis_mask("xyz"[: system.dim])
        turns = L.NO_TURN if not turned else L.ANGLE if system.dim == 2 else L.FULL
        ties.append(Tie(frame, ground, table.at[frame], mask, turns, pin=True))
    return ties


def _flatten_end(end: End, of: End, table: Table) -> End:
    """Turn an end so that x is what was z of `of`, and z the plane's normal."""
    z = compute_plane_normal(of, table)
    x = np.array([0.0, 0.0, 1.0])
    C = np.eye(4)
    C[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return end[0], end[1] @ C, end[2]


def compute_plane_normal(end: End, table: Table) -> np.ndarray:
    """Compute the normal (3,) of the plane of a planar system, in axes of a frame.

    It is the same in all configurations.
    """
    z = np.array([0.0, 0.0, 1.0])
    row = end[0]
    way: list[np.ndarray] = [end[1]]
    while row >= 0:
        way.append(table.placement[row])
        row = int(table.parent[row])
    for X in reversed(way):
        z = X[:3, :3].T @ z
    return z


def _make_joint_tie(system: Model, table: Table, joint: Joint, explicit: bool) -> Tie:
    """Make the tie of a cut joint."""
    a = table.at[joint.name, "F"]
    b = table.at[joint.name, "M"]
    if has_slide_along_z(joint.type, system.dim, b[2]):
        a = _flatten_end(a, b, table)
        b = _flatten_end(b, b, table)
    if explicit:
        turns = "" if b[2] else "z" if system.dim == 2 else "xyz"
        return Tie(joint.name, a, b, _make_axis_mask("xyz"[: system.dim]), TURNS[turns])
    form = _find_implicit_form(system, joint)
    assert form is not None, f"joint {joint.name!r} must be explicit"
    return Tie(joint.name, a, b, _make_axis_mask(form.position), TURNS[form.turns], joint=joint)


def _find_implicit_form(system: Model, joint: Joint) -> ImplicitForm | None:
    """Return the implicit form of a joint of the system, or None."""
    return find_implicit_form(
        joint.type, system.dim, system._mechanism.bodies[joint.child].particle
    )


def _make_axis_mask(axes: str) -> int:
    """Return the bits of some axes as one integer."""
    return sum(1 << "xyz".index(a) for a in axes)


def _order_ties(ties: list[Tie], table: Table, first: Places) -> list[Tie]:
    """Order ties so that those that share coordinates are near each other.

    The envelope of J J^T is then small.
    """
    if len(ties) < 8:
        return ties
    users: dict[int, list[int]] = {}
    for k, tie in enumerate(ties):
        for v in _find_tie_coordinates(tie, table, first):
            users.setdefault(v, []).append(k)
    if not users:
        return ties
    neighbours: list[set[int]] = [set() for _ in ties]
    for use in users.values():
        for k in use:
            neighbours[k].update(use)
    return [ties[k] for k in _order_nodes([sorted(x) for x in neighbours])]


def _order_nodes(neighbours: list[list[int]]) -> list[int]:
    """Order the nodes of a graph so that neighbours are near each other.

    The order is that of Cuthill and McKee (1969), reversed: breadth first from a node of lowest
    degree, neighbours by degree. SciPy has it, too, but its import takes longer than to assemble
    most mechanisms.
    """
    degree = [len(x) for x in neighbours]
    out: list[int] = []
    seen = [False] * len(degree)
    for seed in sorted(range(len(degree)), key=degree.__getitem__):
        if seen[seed]:
            continue
        seen[seed] = True
        queue: deque[int] = deque([seed])
        while queue:
            node = queue.popleft()
            out.append(node)
            new = sorted((k for k in neighbours[node] if not seen[k]), key=degree.__getitem__)
            for k in new:
                seen[k] = True
            queue.extend(new)
    return out[::-1]


def _order_ties_by_level(
    ties: list[Tie], table: Table, level: Callable[[Tie], int], first: Places
) -> list[Tie]:
    """Order ties by levels, and within each level so that the envelope of J J^T is small.

    The order of the others is the same without the last level.

    Those of the last level that hold one coordinate each stand before the first other one that it
    moves: this keeps the envelope small.
    """
    last = max(level(t) for t in ties)
    loose = [t for t in ties if t.own >= 0 and level(t) == last]
    groups = [
        [t for t in ties if level(t) == n and t not in loose]
        for n in sorted({level(t) for t in ties})
    ]
    out: list[Tie] = []
    for tie in (t for group in groups for t in _order_ties(group, table, first)):
        moved_by = _find_tie_coordinates(tie, table, first)
        out += [*(t for t in loose if t.own in moved_by), tie]
        loose = [t for t in loose if t.own not in moved_by]
    return out + loose


def _find_tie_coordinates(tie: Tie, table: Table, first: Places) -> set[int]:
    """Return the velocity coordinates that the equations of a tie depend on.

    `table` holds the rows of the tree, `first` the places of coordinates by name.
    """
    if tie.own >= 0:
        return {tie.own}
    if tie.function is not None:
        return set(tie.function.support)
    if tie.centre is not None:
        return set(table.iv.tolist())
    if tie.tape is not None:
        own = {first[name][1] for name in tie.tape.coordinates}
        return own | (_find_moving_coordinates(tie, table) if tie.tape.pose_dependent else set())
    return _find_moving_coordinates(tie, table)


def _find_moving_coordinates(tie: Tie, table: Table) -> set[int]:
    """Return the velocity coordinates that move frame B of a tie against its frame A."""
    return {int(table.iv[row]) for _, row in find_moving_rows(tie.a[0], tie.b[0], table.parent)}
