"""Primitive tables: joints as rows of primitives about z, bodies and frames as places on rows.

The packed form, one int64 and one float64 array, is described in
`kempe.kernels.forward.table_layout`. Constants (offsets of mimic joints, locked coordinates, fixed
joints) end up in placements and offsets, so a table has rows for motion only. Placements may carry
leading axes: a batch of designs is lowered in one pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kempe import spatial
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.joints import AXIS_ROTATIONS, P, Primitive, Q
from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    HEADER,
    MULTIPLIER,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    ROW_FLOATS,
    ROW_INTS,
    SIN_OFFSET,
)
from kempe.model.coordinates import Coordinates, list_coordinate_names
from kempe.model.topology import Topology

_AXES = {axis: spatial.pose(rotation) for axis, rotation in AXIS_ROTATIONS.items()}
_AXES_BACK = {axis: spatial.inverse(X) for axis, X in _AXES.items()}
_EYE = np.eye(4)

End = tuple[int, np.ndarray, bool]
"""Where a frame sits: its row, its pose (..., 4, 4) on that row, and whether it is a particle."""


@dataclass(frozen=True, eq=False)
class Table:
    """The primitive table of a system: its rows, and where bodies and frames sit on them.

    Rows: `kind`, `parent` row (-1 ground), `iq`, `iv`, `multiplier`, `offset` angle (..., n),
    `placement` (..., n, 4, 4).
    `at` gives for each body or frame name its row, its pose (..., 4, 4) on that row, and whether it
    is a particle.
    """

    kind: np.ndarray
    parent: np.ndarray
    iq: np.ndarray
    iv: np.ndarray
    multiplier: np.ndarray
    offset: np.ndarray
    placement: np.ndarray
    at: Mapping[Any, End]
    nq: int
    nv: int

    def find_path(self, name: Any) -> list[int]:
        """Return the rows from the ground to a body or frame."""
        row = self.at[name][0]
        rows: list[int] = []
        while row >= 0:
            rows.append(row)
            row = int(self.parent[row])
        return rows[::-1]

    def pack_arrays(
        self, names: Sequence[Any], rows: Sequence[int] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pack the rows that move the named outputs, and the outputs, as arrays (ints, floats).

        Leading axes of a batch of designs stay on `floats`.
        """
        if rows is None:
            # the last entry stands for the ground
            needed = np.zeros(len(self.kind) + 1, dtype=bool)
            for name in names:
                row = self.at[name][0]
                while row >= 0 and not needed[row]:
                    needed[row] = True
                    row = int(self.parent[row])
            rows = np.flatnonzero(needed[:-1]).tolist()
        index = np.full(len(self.kind) + 1, -1, dtype=np.int64)
        index[rows] = np.arange(len(rows))
        n = len(rows)
        k = len(names)
        parent = index[self.parent[rows]] if n else np.zeros(0, dtype=np.int64)
        out_rows = index[[self.at[m][0] for m in names]] if k else np.zeros(0, dtype=np.int64)
        chain = (
            k == 1 and np.array_equal(parent, np.arange(n) - 1) and (n == 0 or out_rows[0] == n - 1)
        )
        ints = np.zeros(HEADER + ROW_INTS * n + OUTPUT_INTS * k, dtype=np.int64)
        ints[:6] = n, k, self.nq, self.nv, chain, n > 0 and bool(np.any(self.kind[rows] == Q))
        body = ints[HEADER : HEADER + ROW_INTS * n].reshape(n, ROW_INTS)
        body[:, 0], body[:, 1], body[:, 2], body[:, 3] = (
            self.kind[rows],
            parent,
            self.iq[rows],
            self.iv[rows],
        )
        tail = ints[HEADER + ROW_INTS * n :].reshape(k, OUTPUT_INTS)
        tail[:, 0] = out_rows
        tail[:, 1] = [self.at[m][2] for m in names]
        return ints, self._pack_floats(rows, names)

    def _pack_floats(self, rows: Sequence[int], names: Sequence[Any]) -> np.ndarray:
        """Pack the numbers of rows and of named outputs (..., n) as kernels read them."""
        n = len(rows)
        k = len(names)
        lead = self.placement.shape[:-3]
        floats = np.zeros((*lead, ROW_FLOATS * n + OUTPUT_FLOATS * k))
        body = floats[..., : ROW_FLOATS * n].reshape(*lead, n, ROW_FLOATS)
        body[..., :12] = self.placement[..., rows, :3, :].reshape(*lead, n, 12)
        body[..., COS_OFFSET], body[..., SIN_OFFSET] = (
            np.cos(self.offset[..., rows]),
            np.sin(self.offset[..., rows]),
        )
        body[..., MULTIPLIER] = self.multiplier[..., rows]
        tail = floats[..., ROW_FLOATS * n :].reshape(*lead, k, OUTPUT_FLOATS)
        for i, name in enumerate(names):
            tail[..., i, :] = self.at[name][1][..., :3, :].reshape(*self.at[name][1].shape[:-2], 12)
        return floats


class _TableRows:
    """Rows of a table as they are collected along one joint after the other."""

    def __init__(self, coordinates: Coordinates):
        self.coordinates = coordinates
        self.rows: list[tuple[int, int, int, int, object, object, np.ndarray]] = []

    def add_primitive(
        self, at: tuple[int, np.ndarray], primitive: Primitive, name: str, sign: float
    ) -> tuple[int, np.ndarray]:
        """Add the row of a primitive, and return the row and placement reached from `at`.

        `name` is the coordinate that moves it.
        """
        row, X = at
        X = X @ _AXES[primitive.axis]
        follower = self.coordinates.followers.get(name)
        factor = sign * primitive.multiplier
        offset = 0.0
        if follower is not None:
            name, factor, offset = (
                follower.source or "",
                factor * follower.multiplier,
                factor * follower.offset,
            )
        turn = 0.0
        if primitive.kind == P:
            X = X @ spatial.pose(p=np.array([0.0, 0.0, offset])) if offset else X
        elif factor == 0.0:
            X = X @ spatial.pose(spatial.make_rotation(offset, "z")) if offset else X
        else:
            turn = offset
        if factor != 0.0:
            iq, iv = self.coordinates.first[name]
            self.rows.append((primitive.kind, row, iq, iv, factor, turn, X))
            row = len(self.rows) - 1
            X = _EYE
        return row, X @ _AXES_BACK[primitive.axis]

    def add_joint(
        self, mechanism: Mechanism, joint: Joint, at: tuple[int, np.ndarray], backwards: bool
    ) -> tuple[int, np.ndarray]:
        """Add the rows of a joint, and return the row and placement reached from `at`.

        With `backwards` the way is from M to F.
        """
        names = list_coordinate_names(mechanism, joint)
        primitives = joint.type.layout(mechanism.dim, mechanism.bodies[joint.child].particle)[1]
        sign = -1.0 if backwards else 1.0
        for p in reversed(primitives) if backwards else primitives:
            if p.kind == Q:
                at = self.add_ball(at, names[p.coordinate : p.coordinate + 4], sign)
            else:
                at = self.add_primitive(at, p, names[p.coordinate], sign)
        return at

    def add_ball(
        self, at: tuple[int, np.ndarray], names: Sequence[str], sign: float
    ) -> tuple[int, np.ndarray]:
        """Add the row of a quaternion, and return the row and placement reached from `at`.

        Where the joint is locked the rotation is constant.
        """
        row, X = at
        locked = [self.coordinates.followers.get(n) for n in names]
        if all(f is not None for f in locked):
            turn = spatial.quat_wxyz_to_matrix([f.offset for f in locked if f is not None])
            return row, X @ spatial.pose(turn if sign > 0 else turn.T)
        iq, iv = self.coordinates.first[names[0]]
        self.rows.append((Q, row, iq, iv, sign, 0.0, X))
        return len(self.rows) - 1, _EYE


def make_primitive_table(
    mechanism: Mechanism,
    topology: Topology,
    coordinates: Coordinates,
    parameters: Mapping[str, Any],
    explicit: Mapping[str, bool] | None = None,
) -> Table:
    """Make the primitive table of a mechanism.

    Parameters may be arrays of one shape: a batch of designs.

    For each joint in `explicit` that the tree left out, `at` has its frames too: (name, "M") on the
    child, and (name, "F") on the parent, led on through the joint's own motion where
    `explicit[name]`.
    """
    rows = _TableRows(coordinates)
    where: dict[str, tuple[int, np.ndarray]] = {topology.bodies[0]: (-1, _EYE)}
    inverses: dict[Any, np.ndarray] = {}
    tree = zip(
        topology.bodies[1:],
        topology.parent,
        topology.parent_joints,
        topology.reversed_,
        strict=True,
    )
    for body, parent, joint_name, backwards in tree:
        joint = mechanism.joints[joint_name]
        X_PF = joint.X_PF.evaluate_pose(parameters)
        X_CM = joint.X_CM.evaluate_pose(parameters)
        first, last = (X_CM, X_PF) if backwards else (X_PF, X_CM)
        row, X = where[topology.bodies[parent]]
        row, X = rows.add_joint(mechanism, joint, (row, X @ first), backwards)
        steps = (joint.X_PF if backwards else joint.X_CM).steps
        if steps not in inverses:  # many joints have the same one
            inverses[steps] = spatial.inverse(last)
        where[body] = (row, X @ inverses[steps])
    ends = _place_joint_ends(mechanism, rows, where, parameters, explicit or {})
    return _finish_table(mechanism, rows, where, parameters, coordinates, ends)


def _place_joint_ends(
    mechanism: Mechanism,
    rows: _TableRows,
    where: dict[str, tuple[int, np.ndarray]],
    parameters: Mapping[str, Any],
    explicit: Mapping[str, bool],
) -> dict[Any, End]:
    """Return the frames F and M of each joint in `explicit`.

    F is moved through the joint where it is explicit.
    """
    at: dict[Any, End] = {}
    for name, through in explicit.items():
        joint = mechanism.joints[name]
        row, X = where[joint.parent]
        here = row, X @ joint.X_PF.evaluate_pose(parameters)
        row, X = rows.add_joint(mechanism, joint, here, False) if through else here
        at[name, "F"] = row, X, False
        row, X = where[joint.child]
        at[name, "M"] = (
            row,
            X @ joint.X_CM.evaluate_pose(parameters),
            mechanism.bodies[joint.child].particle,
        )
    return at


def _finish_table(
    mechanism: Mechanism,
    rows: _TableRows,
    where: dict[str, tuple[int, np.ndarray]],
    parameters: Mapping[str, Any],
    c: Coordinates,
    ends: dict[Any, End],
) -> Table:
    """Make the table of the rows, with bodies and frames where the walk reached them."""
    at: dict[Any, End] = {
        b: (row, X, mechanism.bodies[b].particle) for b, (row, X) in where.items()
    }
    for frame in mechanism.frames.values():
        row, X = where[frame.body]
        at[frame.name] = (
            row,
            X @ frame.X_BF.evaluate_pose(parameters),
            mechanism.bodies[frame.body].particle,
        )
    at |= ends
    n = len(rows.rows)
    columns: list[Any] = list(zip(*rows.rows, strict=True)) if n else [[]] * 7
    lead = np.broadcast_shapes(*(np.shape(p) for p in parameters.values())) if parameters else ()
    placement = np.zeros((*lead, n, 4, 4))
    for i, X in enumerate(columns[6]):
        placement[..., i, :, :] = X
    placement.setflags(write=False)
    spread = (*lead, n)
    return Table(
        np.array(columns[0], dtype=np.int64),
        np.array(columns[1], dtype=np.int64),
        np.array(columns[2], dtype=np.int64),
        np.array(columns[3], dtype=np.int64),
        np.broadcast_to(np.array(columns[4], dtype=float), spread),
        np.broadcast_to(np.array(columns[5], dtype=float), spread),
        placement,
        at,
        c.layout.nq,
        c.layout.nv,
    )


def extract_chain(
    table: Table, name: str, base: str | None = None
) -> tuple[Table, np.ndarray, np.ndarray]:
    """Return the table of one chain, and the indices of its coordinates in q and in v.

    The chain leads from the ground, or from the frame `base`, down to a joint that both frames hang
    on and up again. Its coordinates count from 0.
    """
    up = [] if base is None else table.find_path(base)[::-1]
    down = table.find_path(name)
    while up and down and up[-1] == down[0]:
        up.pop()
        down.pop(0)
    path = up + down
    tip = table.at[name][1]
    placement = table.placement[..., path, :, :]
    if base is not None:
        X = spatial.inverse(table.at[base][1])
        for k, row in enumerate(up):
            placement[..., k, :, :] = X
            X = spatial.inverse(table.placement[..., row, :, :])
        if down:
            placement[..., len(up), :, :] = X @ placement[..., len(up), :, :]
        else:
            tip = X @ tip
    sign = np.repeat([-1.0, 1.0], [len(up), len(down)])
    kind = table.kind[path]
    iq = table.iq[path]
    iv = table.iv[path]
    first = {
        int(a): (int(b), 4 if k == Q else 1)
        for k, a, b in reversed(list(zip(kind, iq, iv, strict=True)))
    }
    order = list(dict.fromkeys(int(a) for a in iq))
    q_index: list[int] = []
    v_index: list[int] = []
    to_q: dict[int, int] = {}
    to_v: dict[int, int] = {}
    for a in order:
        b, size = first[a]
        to_q[a] = len(q_index)
        to_v[a] = len(v_index)
        q_index += range(a, a + size)
        v_index += range(b, b + (3 if size == 4 else 1))
    local = Table(
        kind,
        np.arange(len(path)) - 1,
        np.array([to_q[int(a)] for a in iq], dtype=np.int64),
        np.array([to_v[int(a)] for a in iq], dtype=np.int64),
        sign * table.multiplier[..., path],
        sign * table.offset[..., path],
        placement,
        {name: (len(path) - 1, tip, table.at[name][2])},
        len(q_index),
        len(v_index),
    )
    return local, np.array(q_index, dtype=np.int64), np.array(v_index, dtype=np.int64)
