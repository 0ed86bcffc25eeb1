"""Loops as data: what ties which frames together over which coordinates, packed for the kernels.

A *tie* is one constraint between two frames A and B: a joint that the tree left out, a declared constraint, a frame
held in place (a pin), or a linear relation of coordinates. A joint that the tree left out is tied in one of two forms.
*Reduced*, A is its frame F and B its frame M, held as the joint holds them; its own coordinates are read off
afterwards. *Carried*, A is led on through the joint's own motion, and coincides with B; its coordinates are unknowns
like all others. So a coordinate that is known, limited or coupled needs nothing special.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.description.checks import constraint_length
from kempe.description.parts import Joint
from kempe.joints import P, Q, R
from kempe.kernels import loop_layout as L
from kempe.kernels.layout import HEADER, OUTPUT_INTS, ROW_INTS
from kempe.model.coordinates import Relation, coordinate_names, returning
from kempe.model.lengths import characteristic_length, moved, origin_of
from kempe.model.table import Table, lower

if TYPE_CHECKING:
    from kempe.model.system import System

MASKS = {"": 0, "z": 4, "xy": 3, "y": 2, "xyz": 7}
TURNS = {"": L.NO_TURN, "z": L.ANGLE, "xy": L.ALIGN, "x.y": L.CROSS, "xyz": L.FULL}
TURN_NAMES = {L.NO_TURN: (), L.ANGLE: ("rz",), L.ALIGN: ("rx", "ry"), L.CROSS: ("x.y",), L.FULL: ("rx", "ry", "rz")}


@dataclass(frozen=True, eq=False)
class Tie:
    """One constraint: what it is called, its frames (row, placement, particle), what it holds of B in A, a number."""

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

    @property
    def rows(self) -> list[str]:
        """Names of its equations."""
        if self.turns in (L.DISTANCE, L.LINEAR):
            return ["distance" if self.turns == L.DISTANCE else "relation"]
        return [x for i, x in enumerate("xyz") if self.mask >> i & 1] + list(TURN_NAMES[self.turns])


@dataclass(frozen=True, eq=False)
class Loops:
    """The ties of a system, packed. `ints` and `floats` are its table; the other arrays are as in `loop_layout`."""

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


def must_carry(system: System, known: Iterable[str] = ()) -> frozenset[str]:
    """The joints left out of the tree whose coordinates must be unknowns: screws, known, limited or coupled ones."""
    related = {n for r in system.relations for n in (r.of, *r.sources)} | set(known)
    related |= {f.source for f in system.couplings.values() if f.source is not None}  # others move with them
    v_index = {n: i for i, n in enumerate(system.velocity_names)}
    limited = np.isfinite(system.lower) | np.isfinite(system.upper)
    out = set()
    for name in system.closures:
        names = system.coordinates_of_joint(name)
        screw = system.joints[name].type.type_name == "helical"
        if screw or any(c in system.couplings or c in related or (c in v_index and limited[v_index[c]]) for c in names):
            out.add(name)
    return frozenset(out)


def loops_of(
    system: System, carried: frozenset[str], held: frozenset[str] = frozenset(),
    pins: tuple[tuple[str, bool], ...] = (), length: float | None = None,
) -> Loops:  # fmt: skip
    """The packed loops of a system.

    `carried` names the left-out joints to carry, `held` the velocity coordinates that are no unknowns, `pins` the
    frames that are held in place (with their orientation where the flag says so). Equations and unknowns are scaled by
    `length` (default: the characteristic length); with length 1 they are in metres.
    """
    key = ("loops", carried, held, pins, length)
    found = system._queries.get(key)
    if found is None:
        found = system._queries[key] = _pack(system, carried, held, pins, length)
    return found


def _pack(
    system: System, carried: frozenset[str], held: frozenset[str], pins: tuple[tuple[str, bool], ...],
    length: float | None,
) -> Loops:  # fmt: skip
    mechanism = system.mechanism
    table = lower(
        mechanism, system.topology, system.coordinates, mechanism.parameters, {n: n in carried for n in system.closures}
    )
    size, origin = characteristic_length(system) if length is None else length, origin_of(system)
    if origin.any():
        table = moved(table, -origin)
    ties = _in_order([t for t in _ties(system, table, carried, pins) if t.rows or t.joint], table)
    at = dict(table.at)
    for k, tie in enumerate(ties):
        at["tie", k, 0], at["tie", k, 1] = tie.a, tie.b
    table = replace(table, at=at)
    ints, floats = table.pack([("tie", k, end) for k in range(len(ties)) for end in (0, 1)])
    plan, weights = _Plan(system, ties, ints, held, size, length is None).arrays()
    names = tuple((t.name, row) for t in ties for row in t.rows)
    unknown = np.array([i for i, n in enumerate(system.velocity_names) if n not in held], dtype=np.int64)
    return Loops(tuple(ties), names, ints, floats, plan, weights, unknown, size, origin)


# ---- what is tied


def _ties(
    system: System, table: Table, carried: frozenset[str], pins: tuple[tuple[str, bool], ...]
) -> list[Tie]:  # fmt: skip
    mechanism = system.mechanism
    ties = [_of_joint(system, table, mechanism.joints[n], n in carried) for n in system.closures]
    for c in mechanism.constraints.values():
        ends = []
        for body, X in ((c.parent, c.X_PF), (c.child, c.X_CM)):
            row, X_row, particle = table.at[body]
            ends.append((row, X_row @ X.evaluate(mechanism.parameters), particle))
        if c.kind == "distance":
            ties.append(Tie(c.name, *ends, turns=L.DISTANCE, number=constraint_length(c, mechanism.parameters)))
        elif c.kind == "point_on_plane":
            ties.append(Tie(c.name, *ends, mask=MASKS["z"]))
        elif system.dim == 2:
            ends = [_flat(end, ends[0], table) for end in ends]
            ties.append(Tie(c.name, *ends, mask=MASKS["y"]))
        else:
            ties.append(Tie(c.name, *ends, mask=MASKS["xy"]))
    ground = (-1, np.eye(4), False)
    for relation in system.relations:
        ties.append(Tie(relation.of, ground, ground, turns=L.LINEAR, number=relation.offset, relation=relation))
    for frame, turned in pins:
        mask = MASKS["xy" if system.dim == 2 else "xyz"]
        turns = L.NO_TURN if not turned else L.ANGLE if system.dim == 2 else L.FULL
        ties.append(Tie(frame, ground, table.at[frame], mask, turns, pin=True))
    return ties


def _flat(end: tuple, of: tuple, table: Table) -> tuple:
    """The end turned so that x is what was z of `of`, and z the plane's normal: a slide of the plane is along z."""
    z = _normal(of, table)
    x = np.array([0.0, 0.0, 1.0])
    C = np.eye(4)
    C[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return end[0], end[1] @ C, end[2]


def _normal(end: tuple, table: Table) -> np.ndarray:
    """The normal of the plane of a planar system, in axes of a frame: the same in all configurations."""
    z, way, row = np.array([0.0, 0.0, 1.0]), [end[1]], end[0]
    while row >= 0:
        way.append(table.placement[row])
        row = int(table.parent[row])
    for X in reversed(way):
        z = X[:3, :3].T @ z
    return z


def _of_joint(system: System, table: Table, joint: Joint, carried: bool) -> Tie:
    """The tie of a joint that the tree left out."""
    a, b = table.at[joint.name, "F"], table.at[joint.name, "M"]
    position, turns = ("xyz", "xyz") if carried else joint.type.ties
    if system.dim == 2:
        turns = "z" if turns == "xyz" else ""
        if abs(_normal(b, table)[2]) < 0.5:  # a slider
            a, b = _flat(a, b, table), _flat(b, b, table)
            position = "xy" if carried else "y"
        else:
            position = "xy" if position == "xyz" else ""
    if b[2]:
        turns = ""
    return Tie(joint.name, a, b, MASKS[position], TURNS[turns], joint=None if carried else joint)


def readings(system: System, joint: Joint) -> list[tuple[int, int]]:
    """For each coordinate of a joint how it is read off the pose of M in F, and its place in q."""
    particle = system.mechanism.bodies[joint.child].particle
    names = coordinate_names(system.mechanism, joint)
    _, primitives = joint.type.layout(system.dim, particle)
    turns = [p for p in primitives if p.kind == R]
    codes = {1: (L.READ_ANGLE,), 2: (L.READ_RX, L.READ_RY), 3: (L.READ_YAW, L.READ_PITCH, L.READ_ROLL)}.get(len(turns))
    flat_slider = system.dim == 2 and joint.type.type_name == "prismatic"
    out = []
    for p in primitives:
        if p.kind == P:
            code = L.READ_X if flat_slider else "xyz".index(p.axis)
        elif p.kind == Q:
            code = L.READ_QUATERNION
        else:
            assert codes is not None
            code = codes[turns.index(p)]
        out.append((code, system.coordinates.first[names[p.coordinate]][0]))
    return out


def _in_order(ties: list[Tie], table: Table) -> list[Tie]:
    """The ties so that those that share coordinates are near each other: it keeps the envelope of J J^T small."""
    if len(ties) < 8:
        return ties
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    users: dict[int, list[int]] = {}
    for k, tie in enumerate(ties):
        rows = _moving(tie.a[0], tie.b[0], table.parent)  # a relation has none
        for v in {int(table.iv[row]) for _, row in rows}:
            users.setdefault(v, []).append(k)
    pairs = [(i, j) for use in users.values() for i in use for j in use]
    if not pairs:
        return ties
    i, j = np.array(pairs).T
    graph = csr_matrix((np.ones(len(pairs)), (i, j)), shape=(len(ties), len(ties)))
    return [ties[k] for k in reverse_cuthill_mckee(graph, symmetric_mode=True)]


def _moving(a: int, b: int, parent: np.ndarray) -> list[tuple[float, int]]:
    """Rows that move row b against row a, with the sign of their motion; -1 is the ground."""
    ways = []
    for row in (a, b):
        way = []
        while row >= 0:
            way.append(row)
            row = int(parent[row])
        ways.append(way)
    common = set(ways[0]) & set(ways[1])
    return [(sign, r) for sign, way in zip((-1.0, 1.0), ways, strict=True) for r in way if r not in common]


# ---- packing


class _Plan:
    """The integers and numbers of `loop_layout`, being collected."""

    def __init__(self, system: System, ties: list[Tie], ints: np.ndarray, held: frozenset[str], length: float,
                 scaled: bool):  # fmt: skip
        self.system, self.ties, self.length, self.scaled = system, ties, length, scaled
        self.number = [t.number for t in ties]
        n = int(ints[0])
        self.rows = ints[HEADER : HEADER + ROW_INTS * n].reshape(n, ROW_INTS)
        self.outputs = ints[HEADER + ROW_INTS * n :].reshape(-1, OUTPUT_INTS)
        self.held = np.array([name in held for name in system.velocity_names], dtype=bool)
        c = system.coordinates
        self.turns = c.turning.copy()
        for iv in system.layout.quaternion_v:
            self.turns[iv : iv + 3] = True
        self.turns[self.rows[self.rows[:, 0] == R, 3]] = True  # what slides and turns together counts as a turn
        self.scale = np.where(self.turns, 1.0, length)
        self.place, self.sort = np.full(system.nv, -1, dtype=np.int64), np.full(system.nv, L.SLIDE, dtype=np.int64)
        self.place[system.layout.vector_v] = system.layout.vector_q
        self.place[system.layout.quaternion_v] = system.layout.quaternion_q
        self.sort[self.turns] = L.BOUND_TURN
        self.sort[returning(system.mechanism, c)] = L.CIRCLE
        for iv in system.layout.quaternion_v:
            self.sort[iv : iv + 3] = L.BALL_FIRST, L.BALL_MORE, L.BALL_MORE
        self.entries: list[tuple[int, int]] = []
        self.factors: list[float] = []
        self.locals: list[int] = []
        self.uses: list[list[tuple[int, int]]] = [[] for _ in range(system.nv)]

    def tie(self, k: int, tie: Tie) -> list[int]:
        """The integers of tie k; appends its entries and locals."""
        entry, local = len(self.entries), len(self.locals)
        columns: dict[int, int] = {}
        if tie.relation is not None:
            self._linear(k, tie.relation, columns)
        else:
            for sign, row in self._moving(k):
                kind, iv = int(self.rows[row, 0]), int(self.rows[row, 3])
                if self.held[iv]:
                    continue
                first = columns.setdefault(iv, len(columns))
                for more in range(1, 3 if kind == Q else 1):
                    columns.setdefault(iv + more, len(columns))
                self.entries.append((row, first))
                self.factors.append(sign)
        self.locals += list(columns)
        for v, column in columns.items():
            if not self.held[v]:
                self.uses[v].append((k, column))
        return [len(self.entries) - entry, entry, len(columns), local]

    def _linear(self, k: int, relation: Relation, columns: dict[int, int]) -> None:
        first = self.system.coordinates.first
        terms = {relation.of: 1.0}
        for name, m in relation.sources.items():
            terms[name] = terms.get(name, 0.0) - m
        self.number[k] /= (norm := max(abs(m) * self.scale[first[n][1]] for n, m in terms.items()) ** self.scaled)
        for name, factor in terms.items():
            columns[first[name][1]] = len(columns)  # held ones, too: their values count
            self.entries.append((first[name][0], 0))
            self.factors.append(factor / norm)

    def _moving(self, k: int) -> list[tuple[float, int]]:
        return _moving(int(self.outputs[2 * k, 0]), int(self.outputs[2 * k + 1, 0]), self.rows[:, 1])

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """The two arrays."""
        ties, first_row, block, pin = [], 0, 0, 0
        for k, tie in enumerate(self.ties):
            n_entries, entry, n_locals, local = self.tie(k, tie)
            rows = len(tie.rows)
            ties.append([tie.mask, tie.turns, rows, first_row, n_entries, entry, n_locals, local, block,
                         pin if tie.pin else -1])  # fmt: skip
            pin += tie.pin
            first_row += rows
            block += rows * n_locals
        reading = [(code, iq, k) for k, t in enumerate(self.ties) if t.joint is not None
                   for code, iq in readings(self.system, t.joint)]  # fmt: skip
        envelope, size = self._envelope(ties, first_row)
        starts = np.concatenate([[0], np.cumsum([len(u) for u in self.uses])])
        lists = [
            ties, self.entries, self.locals, starts, [x for u in self.uses for x in u], envelope, reading,
            np.stack([self.place, self.sort, self.held], axis=1),
        ]  # fmt: skip
        flat = [np.asarray(x, dtype=np.int64).ravel() for x in lists]
        places = L.HEAD + np.concatenate([[0], np.cumsum([len(x) for x in flat])])
        head = [len(ties), first_row, len(reading), pin, block, size, *places[:8].tolist()]
        weights = [1.0 / self.length, self.length, *self.scale, *self._ranges(), *self.number, *self.factors]
        at_numbers = L.SCALES + 5 * self.system.nv
        head += [at_numbers, at_numbers + len(ties)]
        return np.concatenate([np.array(head, dtype=np.int64), *flat]), np.array(weights, dtype=float)

    def _ranges(self) -> list[float]:
        """Limits, and where to draw random coordinates from."""
        low, high = self.system.coordinates.lower, self.system.coordinates.upper
        reach = np.where(self.turns, np.pi, self.length)
        far, near = np.where(np.isfinite(low), low, -np.inf), np.where(np.isfinite(high), high, np.inf)
        draw_low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), near - 2.0 * reach, -reach))
        draw_high = np.where(np.isfinite(high), high, np.where(np.isfinite(low), far + 2.0 * reach, reach))
        return [*low, *high, *draw_low, *draw_high]

    def _envelope(self, ties: list[list[int]], m: int) -> tuple[list[tuple[int, int]], int]:
        """For each row of J J^T its first column that is not zero, and where the row begins."""
        own = [t[L.FIRST_ROW] for t in ties]
        first = own.copy()
        for use in self.uses:
            if use:
                least = min(own[k] for k, _ in use)
                for k, _ in use:
                    first[k] = min(first[k], least)
        out, at = [], 0
        for k, t in enumerate(ties):
            for r in range(t[L.ROWS]):
                out.append((first[k], at))
                at += t[L.FIRST_ROW] + r - first[k] + 1
        return out, at
