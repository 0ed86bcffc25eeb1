"""Ties, packed for the kernels as `kempe.kernels.constraints.loop_layout` says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.description.parts import Joint
from kempe.joints import P, Q, R
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.forward.table_layout import HEADER, OUTPUT_INTS, ROW_INTS
from kempe.model.closures.frame_constraints import Centre, RecordedRows, Tie
from kempe.model.closures.implicit_form import implicit_form
from kempe.model.tree.coordinates import Relation, coordinate_names, returning

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled

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


def _readings(system: Compiled, joint: Joint) -> list[tuple[int, int]]:
    """For each coordinate of a joint how it is read off the pose of M in F, and its place in q."""
    names = coordinate_names(system._mechanism, joint)
    first = system.structure.coordinates.first
    form = implicit_form(joint.type, system.dim, system._mechanism.bodies[joint.child].particle)
    return [(READINGS[how], first[names[k]][0]) for k, how in (form.readings if form else ())]


def moving(a: int, b: int, parent: np.ndarray) -> list[tuple[float, int]]:
    """Rows that move row b against row a, with the sign of their motion; -1 is the ground."""
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


def laid_out(
    recorded: list[tuple[np.ndarray, np.ndarray, list[int]]], at: int, numbers_at: int
) -> tuple[np.ndarray, list[int]]:
    """The integers of TAPE ties, as `loop_layout` says, to stand at `at`, and where those of each
    begin.

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
    """The integers and numbers of `loop_layout`, being collected."""

    def __init__(
        self,
        system: Compiled,
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
        self.turns = c.turning.copy()
        for iv in system.structure.layout.quaternion_v:
            self.turns[iv : iv + 3] = True
        self.turns[self.rows[self.rows[:, 0] == R, 3]] = (
            True  # what slides and turns together counts as a turn
        )
        self.scale = np.where(self.turns, 1.0, length)
        self.place = np.full(system.nv, -1, dtype=np.int64)
        self.sort = np.full(system.nv, L.SLIDE, dtype=np.int64)
        self.place[system.structure.layout.vector_v] = system.structure.layout.vector_q
        self.place[system.structure.layout.quaternion_v] = system.structure.layout.quaternion_q
        self.sort[self.turns] = L.BOUND_TURN
        self.sort[returning(system._mechanism, c)] = L.CIRCLE
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

    def tie(self, k: int, tie: Tie) -> list[int]:
        """The integers of tie k; appends its entries and locals."""
        entry = len(self.entries)
        local = len(self.locals)
        columns: dict[int, int] = {}
        if tie.relation is not None:
            self._linear(k, tie.relation, columns)
        elif tie.turns == L.OWN:
            columns.update({tie.own + n: n for n in range(3 if tie.ball else 1)})
        elif tie.function is not None:
            columns.update({v: n for n, v in enumerate(tie.function.support)})
        else:
            for sign, row in self._rows(k, tie) if tie.tape is None or tie.tape.moved else ():
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
            self._record(tie.tape, columns)
        self.locals += list(columns)
        for v, column in columns.items():
            if not self.held[v]:
                self.uses[v].append((k, column))
        return [len(self.entries) - entry, entry, len(columns), local]

    def _record(self, recorded: RecordedRows, columns: dict[int, int]) -> None:
        """Collect what a TAPE tie reads: its tape, and for each input what it is."""
        ints, floats = recorded.tape.arrays()
        first = self.system.structure.coordinates.first
        inputs: list[int] = []
        for name in recorded.tape.inputs:
            place = -1
            column = -1
            if (what := recorded.input(name)) == L.COORDINATE:
                place, v = first[name]
                column = -1 if self.held[v] else columns.setdefault(v, len(columns))
            elif what == L.GIVEN:
                place = recorded.given.index(name)
            inputs += [what, place, column]
        self.recorded.append((ints, floats, inputs))

    def _linear(self, k: int, relation: Relation, columns: dict[int, int]) -> None:
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

    def _rows(self, k: int, tie: Tie) -> list[tuple[float, int]]:
        """The rows that move B against A, with signs; a centre is moved by all that carry mass, and
        A moves apart.
        """
        if tie.centre is None:
            return self._moving(k)
        share = self._shares(tie.centre)
        return [(-s, r) for s, r in moving(int(self.outputs[2 * k, 0]), -1, self.rows[:, 1])] + [
            (1.0, r) for r in range(len(share)) if share[r] > 0.0
        ]

    def _shares(self, centre: Centre) -> np.ndarray:
        """For each row (n,) the mass of all that it moves."""
        share = centre.rows[:, 0].copy()
        for r in range(len(share) - 1, -1, -1):
            if self.rows[r, 1] >= 0:
                share[self.rows[r, 1]] += share[r]
        return share

    def _moving(self, k: int) -> list[tuple[float, int]]:
        return moving(int(self.outputs[2 * k, 0]), int(self.outputs[2 * k + 1, 0]), self.rows[:, 1])

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """The two arrays."""
        first_row = 0
        block = 0
        pin = 0
        given = 0
        ties: list[list[int]] = []
        bounds: list[float] = []
        centres: list[np.ndarray] = []
        for k, tie in enumerate(self.ties):
            n_entries, entry, n_locals, local = self.tie(k, tie)
            rows = len(tie.rows)
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
                    self._lengths(tie),
                    given if tie.given else -1,
                    len(bounds) if tie.bounds else -1,
                    len(centres) if tie.centre is not None else -1,
                    data,
                ]
            )
            pin = pin + tie.pin
            given = given + (len(tie.tape.given) if tie.tape else 4 if tie.ball else 1) * tie.given
            first_row = first_row + rows
            block = block + rows * n_locals + work
            unit = self.length if self._lengths(tie) else 1.0
            bounds += [x / unit for low, high in tie.bounds for x in (low, high)]
            if tie.centre is not None:
                rows_ = np.column_stack([tie.centre.rows, self._shares(tie.centre)])
                centres += [np.concatenate([rows_.ravel(), tie.centre.rest])]
        reading = [
            (code, iq, k)
            for k, t in enumerate(self.ties)
            if t.joint is not None
            for code, iq in _readings(self.system, t.joint)
        ]
        envelope, size = self._envelope(ties, first_row)
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
        read, starts_at = laid_out(self.recorded, int(places[-1]), numbers_at)
        for t, tie in zip(flat[0].reshape(-1, L.TIE_INTS), self.ties, strict=True):
            if tie.tape is not None:
                t[L.DATA] = starts_at[t[L.DATA]]
        flat.append(read)
        head = [len(ties), first_row, len(reading), pin, block, size, *places[:8].tolist()]
        lists = [
            [1.0 / self.length, self.length],
            [*self.scale, *self._ranges()],
            self.number,
            self.factors,
            bounds,
        ]
        at = np.cumsum([len(x) for x in lists])
        head += [*at[1:].tolist(), *self._base()]
        lists += [*centres, *(x for _, x, _ in self.recorded)]
        weights = np.concatenate([np.array(x, dtype=float) for x in lists])
        return np.concatenate([np.array(head, dtype=np.int64), *flat]), weights

    def _lengths(self, tie: Tie) -> int:
        """How many of its rows, the first ones, are lengths."""
        if tie.turns == L.OWN:
            return int(self.sort[tie.own] == L.SLIDE)
        if tie.tape is not None:
            return len(tie.rows) * (tie.tape.unit == "m")
        return tie.mask.bit_count() + (tie.turns == L.DISTANCE)

    def _base(self) -> tuple[int, int]:
        """A tie that holds, in the ground, a frame of what a free joint moves, and the first of
        that joint's rows.
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
                way = [r for _, r in self._moving(k)] if tie.pin and held else []
                if self.outputs[2 * k, 0] < 0 and set(range(4)) <= set(way):
                    return k, 0
        return -1, -1

    def _ranges(self) -> list[float]:
        """Limits, and where to draw random coordinates from."""
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

    def _envelope(self, ties: list[list[int]], m: int) -> tuple[list[tuple[int, int]], int]:
        """For each row of J J^T its first column that is not zero, and where the row begins."""
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
