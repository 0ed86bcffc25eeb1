"""Velocity constraints A(q) v = b(q, t) of a system, and tangents of its position constraints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors
from kempe.arrays import read_reals
from kempe.constraints.builder import Builder
from kempe.constraints.tape import BINARY, POSE, RATE, TIME, TWIST, UNARY, Tape
from kempe.description.mechanism import evaluate_constraint
from kempe.description.parts import Declared
from kempe.errors import UnsupportedError
from kempe.joints import P, Q
from kempe.kernels.compiled import tape_evaluation as tape
from kempe.kernels.constraints import loop_layout
from kempe.kernels.constraints import tape_layout as L
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import read_q
from kempe.model.constraint_program import Tie, collect_numbers, find_ends
from kempe.model.coordinates import Layout
from kempe.model.model import keep_answers
from kempe.model.packed_loops import find_moving_rows, list_position_ties, make_explicit_table
from kempe.model.primitive_table import End, Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- recorded rows: names and values

# One tape gives values at any number of configurations, and what brackets need.

CLOCK = ""
"""The name of the time among the inputs of the tape, which is no coordinate's."""


@dataclass(frozen=True)
class RowName:
    """Origin of a velocity row: its constraint or joint, its name there, and its unit.

    `velocity`: a row A(q) v = b, not the tangent of a position; `sided`: of a position that is held
    between two ends; `written`: by the user, in units of his own.
    """

    of: str
    name: str
    unit: str = "m/s"
    velocity: bool = True
    sided: bool = False
    written: bool = False


@dataclass(frozen=True, eq=False)
class VelocityRows:
    """Recorded rows A(q) v = b(q, t) of velocity constraints.

    `tape` has inputs that are entries of q, by `coordinates`, or the time; its outputs are the
    entries of A and b that are not zero. `entries` (k, 2) say row and column of each, the column nv
    being that of -b.
    """

    layout: Layout
    coordinates: tuple[str, ...]
    tape: Tape
    entries: np.ndarray
    names: tuple[RowName, ...]
    units: Array = field(repr=False)
    """What (nv + 1,) velocities, and the time, are measured in: 1, or a length."""

    @cached_property
    def packed_tape(self) -> tuple[np.ndarray, Array]:
        """Arrays of the tape, as kernels read them."""
        return self.tape.make_arrays()

    @cached_property
    def inputs(self) -> np.ndarray:
        """Place in (q, t) of each input of the tape."""
        place = {name: i for i, name in enumerate((*self.coordinates, CLOCK))}
        return np.array([place[name] for name in self.tape.inputs], dtype=np.int64)

    @cached_property
    def steady(self) -> bool:
        """Whether A and b do not depend on the time and b is zero: no column nv is needed."""
        return CLOCK not in self.tape.inputs and not bool(
            np.any(self.entries[:, 1] == self.layout.nv)
        )

    def evaluate_rows(self, q: Array, t: Array | float = 0.0) -> tuple[Array, Array]:
        """Compute A (..., m, nv) and b (..., m) at configurations (..., nq) and times (...)."""
        shape = np.broadcast_shapes(q.shape[:-1], np.shape(t))
        n = int(np.prod(shape, dtype=np.int64))
        points = np.empty((n, self.layout.nq + 1))
        points[:, :-1] = np.broadcast_to(q, (*shape, self.layout.nq)).reshape(n, self.layout.nq)
        points[:, -1] = np.broadcast_to(t, shape).reshape(n)
        found = np.empty((n, len(self.entries)))
        tape.evaluate_tape_outputs(
            *self.packed_tape, np.ascontiguousarray(points[:, self.inputs]), found
        )
        whole = np.zeros((n, len(self.names), self.layout.nv + 1))
        whole[:, self.entries[:, 0], self.entries[:, 1]] = found
        whole = whole.reshape(*shape, len(self.names), self.layout.nv + 1)
        return whole[..., :-1], -whole[..., -1]

    def find_needed_nodes(self, outputs: Sequence[int]) -> np.ndarray:
        """Find the nodes of the tape that some outputs are computed from, in order.

        Those of derivatives of functions are included.
        """
        n = len(self.tape.inputs)
        nodes = self.tape.nodes
        todo = [self.tape.outputs[i] for i in outputs]
        seen = set[int]()
        while todo:
            place = todo.pop()
            if place < n or place in seen:
                continue
            seen.add(place)
            op, left, right = nodes[place - n]
            if op in UNARY:
                todo += [left] if op == L.NEG else [left, right]
            elif op in BINARY:
                todo += [left, right]
            if L.ATAN2 <= op <= L.NEAREST:
                todo += nodes[place + 1 - n][1:]
        return np.array(sorted(seen), dtype=np.int64)

    @cached_property
    def slots(self) -> np.ndarray:
        """Velocity and tape input (nq + 1, 2) of each entry of (q, t), -1 for none.

        Entries of quaternions have no single velocity.
        """
        layout = self.layout
        out = np.full((layout.nq + 1, 2), -1, dtype=np.int64)
        out[layout.vector_q, 0] = layout.vector_v
        out[-1, 0] = layout.nv
        out[self.inputs, 1] = np.arange(len(self.inputs))
        return out

    @cached_property
    def balls(self) -> np.ndarray:
        """First entry in q and first velocity (k, 2) of each quaternion."""
        pairs = np.stack([self.layout.quaternion_q, self.layout.quaternion_v], axis=-1)
        return np.ascontiguousarray(pairs.reshape(-1, 2), dtype=np.int64)


# ---- recording of rows

# A row is linear in the twist of frame B against frame A: coefficients c of the pose X_AB, dotted
# with the twists that the joints between A and B give, as in
# `kempe.kernels.constraints.constraint_rows`. Numbers that are known are folded, so that a tape
# holds what moves only.

Num = float | int
"""A number that is known (float) or a place of the tape that is recorded (int)."""
Form = dict[Any, Num]
"""What is linear in velocities: coefficients by twist component (0 ... 5) or by ("v", velocity
coordinate)."""

PLACE = {"x": 0, "y": 1, "z": 2}


class Numbers:
    """Arithmetic with recorded numbers, in which known zeros and ones are folded."""

    def __init__(self, builder: Builder):
        self.builder = builder

    def place_number(self, a: Num) -> int:
        """Return the place of a number on the tape."""
        return self.builder.add_number(a) if isinstance(a, float) else a

    def record_operation(self, op: int, a: Num, b: Num | None = None) -> Num:
        """Record an operation on the tape and return its number."""
        x = self.place_number(a)
        build = self.builder
        made = (
            build.add_unary(op, x) if b is None else build.add_binary(op, x, self.place_number(b))
        )
        if made >= len(self.builder.inputs):
            known = self.builder._get_constant(made)
            return made if known is None else known
        return made

    def add_numbers(self, a: Num, b: Num) -> Num:
        """Return the sum a + b."""
        if isinstance(a, float) and isinstance(b, float):
            return a + b
        if isinstance(a, float) and a == 0.0:
            return b
        return a if isinstance(b, float) and b == 0.0 else self.record_operation(L.ADD, a, b)

    def negate_number(self, a: Num) -> Num:
        """Return the negative -a."""
        return -a if isinstance(a, float) else self.record_operation(L.NEG, a)

    def subtract_numbers(self, a: Num, b: Num) -> Num:
        """Return the difference a - b."""
        if isinstance(a, float) and isinstance(b, float):
            return a - b
        if isinstance(b, float) and b == 0.0:
            return a
        return (
            self.negate_number(b)
            if isinstance(a, float) and a == 0.0
            else self.record_operation(L.SUB, a, b)
        )

    def multiply_numbers(self, a: Num, b: Num) -> Num:
        """Return the product a b."""
        if isinstance(a, float) and isinstance(b, float):
            return a * b
        for x, y in ((a, b), (b, a)):
            if isinstance(x, float) and x in (0.0, 1.0, -1.0):
                return 0.0 if x == 0.0 else y if x == 1.0 else self.negate_number(y)
        return self.record_operation(L.MUL, a, b)

    def compute_dot_product(self, a: Any, b: Any) -> Num:
        """Return the dot product of two vectors."""
        total: Num = 0.0
        for x, y in zip(a, b, strict=True):
            total = self.add_numbers(total, self.multiply_numbers(x, y))
        return total

    def compute_cross_product(self, a: Any, b: Any) -> list[Num]:
        """Return the cross product of two vectors."""
        m = self.multiply_numbers
        s = self.subtract_numbers
        return [
            s(m(a[1], b[2]), m(a[2], b[1])),
            s(m(a[2], b[0]), m(a[0], b[2])),
            s(m(a[0], b[1]), m(a[1], b[0])),
        ]


@dataclass
class RecordedPose:
    """A recorded pose: rotation matrix by rows, and position."""

    R: list[list[Num]]
    p: list[Num]

    def get_axis(self, j: int) -> list[Num]:
        """Return axis `j` of the frame: a column of the rotation matrix."""
        return [self.R[i][j] for i in range(3)]


IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


class Recorder:
    """The velocity constraints of one system while they are recorded as a tape.

    `entries` are (row, velocity, number); the velocity nv stands for -b.
    """

    def __init__(self, table: Table, coordinates: tuple[str, ...], time: str):
        self.table = table
        self.builder = Builder([*coordinates, time])
        self.numbers = Numbers(self.builder)
        self.time = len(coordinates)
        self.entries: list[tuple[int, int, Num]] = []
        self.count = 0
        self._before: dict[int, RecordedPose] = {}
        self._after: dict[int, RecordedPose] = {-1: RecordedPose(IDENTITY, [0.0, 0.0, 0.0])}

    # ---- poses

    def move_pose(self, pose: RecordedPose, X: np.ndarray) -> RecordedPose:
        """Return the product pose @ X for a known X (4, 4)."""
        n = self.numbers
        X = np.asarray(X, dtype=float)
        R = [[n.compute_dot_product(row, X[:3, j].tolist()) for j in range(3)] for row in pose.R]
        p = [
            n.add_numbers(pose.p[i], n.compute_dot_product(pose.R[i], X[:3, 3].tolist()))
            for i in range(3)
        ]
        return RecordedPose(R, p)

    def find_pose_before(self, row: int) -> RecordedPose:
        """Find the pose before the motion of a row of the table."""
        self.find_pose_after(row)
        return self._before[row]

    def find_pose_after(self, row: int) -> RecordedPose:
        """Find the pose after the motion of a row of the table."""
        way: list[int] = []
        while row not in self._after:
            way.append(row)
            row = int(self.table.parent[row])
        for r in reversed(way):
            self._before[r] = self.move_pose(
                self._after[int(self.table.parent[r])], self.table.placement[r]
            )
            self._after[r] = self._apply_motion(r, self._before[r])
            row = r
        return self._after[way[0] if way else row]

    def _apply_motion(self, r: int, at: RecordedPose) -> RecordedPose:
        """Apply the motion of row `r` of the table to a pose."""
        n = self.numbers
        table = self.table
        q = int(table.iq[r])
        factor = float(table.multiplier[r])
        if table.kind[r] == Q:
            turn = self._record_quaternion_matrix(q, factor < 0.0)
            return RecordedPose(
                [
                    [n.compute_dot_product(row, [turn[k][j] for k in range(3)]) for j in range(3)]
                    for row in at.R
                ],
                at.p,
            )
        theta = n.multiply_numbers(factor, q)
        if table.kind[r] == P:
            return RecordedPose(
                at.R,
                [n.add_numbers(at.p[i], n.multiply_numbers(theta, at.R[i][2])) for i in range(3)],
            )
        offset = float(table.offset[r])
        theta = n.add_numbers(theta, offset)
        s = n.record_operation(L.SIN, theta)
        c = n.record_operation(L.COS, theta)
        R = [
            [
                n.add_numbers(n.multiply_numbers(c, x), n.multiply_numbers(s, y)),
                n.subtract_numbers(n.multiply_numbers(c, y), n.multiply_numbers(s, x)),
                z,
            ]
            for x, y, z in at.R
        ]
        return RecordedPose(R, at.p)

    def _record_quaternion_matrix(self, q: int, inverse: bool) -> list[list[Num]]:
        """Record the rotation matrix (3 rows of 3) of the quaternion wxyz at q[`q`] as polynomials.

        With `inverse` it is the transpose. The quaternion is taken to have norm 1; at norm n the
        matrix is n^2 times as large.
        """
        n = self.numbers
        (w, x, y, z) = range(q, q + 4)
        if inverse:
            x = n.negate_number(x)
            y = n.negate_number(y)
            z = n.negate_number(z)
        m = n.multiply_numbers
        a = n.add_numbers
        s = n.subtract_numbers
        two: Callable[[Num], Num] = lambda u: m(2.0, u)  # noqa: E731
        squares = [m(u, u) for u in (w, x, y, z)]
        diagonal = [
            a(squares[0], s(s(squares[1 + i], squares[1 + (i + 1) % 3]), squares[1 + (i + 2) % 3]))
            for i in range(3)
        ]
        return [
            [diagonal[0], two(s(m(x, y), m(w, z))), two(a(m(x, z), m(w, y)))],
            [two(a(m(x, y), m(w, z))), diagonal[1], two(s(m(y, z), m(w, x)))],
            [two(s(m(x, z), m(w, y))), two(a(m(y, z), m(w, x))), diagonal[2]],
        ]

    # ---- frames against frames

    def find_end_pose(self, end: End) -> RecordedPose:
        """Find the pose of an end (row, placement, particle) of a constraint."""
        pose = self.move_pose(self.find_pose_after(end[0]), end[1])
        return RecordedPose(IDENTITY, pose.p) if end[2] else pose

    def add_row(self, a: End, b: End, form: Form, value: Num = 0.0) -> None:
        """Record a row A v = b from its linear form and its value.

        `form` is linear in the twist of b against a and in velocities, `value` is -b(q, t).
        """
        out: dict[int, Num] = {}
        n = self.numbers
        for key, x in form.items():
            pair: Any = key
            if isinstance(key, tuple):
                out[pair[1]] = n.add_numbers(out.get(pair[1], 0.0), x)
        c = [form.get(k, 0.0) for k in range(6)]
        if any(not isinstance(x, float) or x != 0.0 for x in c):
            self._add_twist_terms(a, b, c, out)
        out[self.table.nv] = n.add_numbers(out.get(self.table.nv, 0.0), value)
        for column, x in out.items():
            if not isinstance(x, float) or x != 0.0:
                self.entries.append((self.count, column, x))
        self.count += 1

    def _add_twist_terms(self, a: End, b: End, c: list[Num], out: dict[int, Num]) -> None:
        """Add the entries of A that coefficients `c` (6,) of the twist of b against a give."""
        n = self.numbers
        table = self.table
        R = self.find_end_pose(a).R
        p = self.find_end_pose(b).p
        force = [n.compute_dot_product(R[i], c[:3]) for i in range(3)]
        moment = [n.compute_dot_product(R[i], c[3:]) for i in range(3)]
        for sign, row in find_moving_rows(a[0], b[0], table.parent):
            factor = sign * float(table.multiplier[row])
            kind = table.kind[row]
            column = int(table.iv[row])
            reverse = kind == Q and factor * sign < 0.0
            axes = self.find_pose_before(row) if reverse else self.find_pose_after(row)
            arm = [n.subtract_numbers(p[i], axes.p[i]) for i in range(3)]
            turn = n.compute_cross_product(arm, force)
            if not (b[2] and sign > 0.0):  # a particle does not turn
                turn = [n.add_numbers(turn[i], moment[i]) for i in range(3)]
            for k in range(0 if kind == Q else 2, 3):
                rate = n.multiply_numbers(
                    factor, n.compute_dot_product(axes.get_axis(k), force if kind == P else turn)
                )
                at = column + (k if kind == Q else 0)
                out[at] = n.add_numbers(out.get(at, 0.0), rate)

    # ---- expressions

    def make_relative_pose(self, a: End, b: End) -> Seen:
        """Make the pose of frame b relative to frame a, with its numbers by name."""
        return Seen(self, a, b)

    def linearize_output(
        self,
        tape: Tape,
        seen: Seen | None,
        known: Mapping[str, Num],
        rates: Mapping[str, Form],
        which: int,
    ) -> tuple[Num, Form]:
        """Linearize an output of a tape: its value, and its rate as a form in velocities.

        Inputs are, where there is a pose `seen`, its numbers, and the components of the twist,
        whose value is zero and whose rate is the component itself; `known` gives others by name,
        `rates` the rates of some of them.
        """
        n = self.numbers
        values: list[Num] = []
        forms: list[Form] = []
        for name in tape.inputs:
            if seen is not None and name in TWIST:
                value = 0.0
                form = {TWIST.index(name): 1.0}
            elif seen is not None and name in POSE:
                value, form = seen(name)
            else:
                value = known[name]
                form = rates.get(name, {})
            values.append(value)
            forms.append(form)
        zero: Num = 0.0
        needed = set(tape._list_needed_places())
        for i, (op, left, right) in enumerate(tape.nodes, len(tape.inputs)):
            if i not in needed:
                value = zero
                form = {}
            elif op == L.NUMBER:
                value = tape.numbers[left]
                form = {}
            elif op == L.TABLE:
                value = self.builder.add_table(tape.numbers[left : left + right])
                form = {}
            elif op in BINARY:
                value, form = self._linearize_operation(
                    op, values[left], values[right], forms[left], forms[right]
                )
            else:
                value = (
                    n.negate_number(values[left])
                    if op == L.NEG
                    else n.record_operation(op, values[left])
                )
                form = {}
                if forms[left]:
                    slope = -1.0 if op == L.NEG else self._record_slope(op, values[left], value)
                    form = {k: n.multiply_numbers(slope, x) for k, x in forms[left].items()}
            values.append(value)
            forms.append(form)
        at = tape.outputs[which]
        return values[at], forms[at]

    def combine_forms(self, f: Form, by: Num, g: Form, other: Num) -> Form:
        """Return the linear combination `by` f + `other` g of two forms."""
        n = self.numbers
        out = {k: n.multiply_numbers(by, x) for k, x in f.items()}
        for k, x in g.items():
            out[k] = n.add_numbers(out.get(k, 0.0), n.multiply_numbers(other, x))
        return out

    def _linearize_operation(self, op: int, a: Num, b: Num, f: Form, g: Form) -> tuple[Num, Form]:
        """Linearize an operation of two numbers with rates f and g: its value and its rate."""
        n = self.numbers
        if op in (L.ADD, L.SUB):
            sign = 1.0 if op == L.ADD else -1.0
            return (n.add_numbers if op == L.ADD else n.subtract_numbers)(a, b), self.combine_forms(
                f, 1.0, g, sign
            )
        if op == L.MUL:
            return n.multiply_numbers(a, b), self.combine_forms(f, b, g, a)
        value = (
            0.0
            if op == L.DIV and isinstance(a, float) and a == 0.0
            else n.record_operation(op, a, b)
        )
        if op in (L.AT, L.NEAREST, L.LOOKUP):
            return value, self._compute_nearest_rate(op, value, f, g)
        if not f and not g:
            return value, {}
        if op == L.DIV:
            by = n.record_operation(L.DIV, 1.0, b)
            return value, self.combine_forms(
                f, by, g, n.negate_number(n.multiply_numbers(value, by))
            )
        if op == L.POW:
            slope = n.multiply_numbers(b, n.record_operation(L.POW, a, n.subtract_numbers(b, 1.0)))
            return value, self.combine_forms(
                f, slope, g, n.multiply_numbers(value, n.record_operation(L.LOG, a)) if g else 0.0
            )
        if op == L.HYPOT:
            return value, self.combine_forms(
                f, n.record_operation(L.DIV, a, value), g, n.record_operation(L.DIV, b, value)
            )
        square = n.add_numbers(n.multiply_numbers(a, a), n.multiply_numbers(b, b))
        return value, self.combine_forms(
            f,
            n.record_operation(L.DIV, b, square),
            g,
            n.negate_number(n.record_operation(L.DIV, a, square)),
        )

    def _compute_nearest_rate(self, op: int, place: Any, f: Form, g: Form) -> Form:
        """Compute the rate of the parameter of a nearest point of a curve.

        The operation before it, AT, collects the rates of x and y.
        """
        n = self.numbers
        build = self.builder
        if op == L.LOOKUP:
            return {}
        if op == L.AT:
            return f | {(len({i for i, _ in f}), k): x for k, x in g.items()}
        rates = build.find_nearest_rates(place)
        out: Form = {}
        for i, key, x in [*((*k, x) for k, x in f.items()), *((2, k, x) for k, x in g.items())]:
            known = build._get_constant(rates[i])
            out[key] = n.add_numbers(
                out.get(key, 0.0), n.multiply_numbers(rates[i] if known is None else known, x)
            )
        return out

    def _record_slope(self, op: int, x: Num, y: Num) -> Num:
        """Record the derivative of y = f(x)."""
        place = self.builder.add_unary(op, self.numbers.place_number(x))
        nodes = self.builder._nodes
        slope = nodes[place - len(self.builder.inputs)][2]
        known = self.builder._get_constant(slope)
        return slope if known is None else known

    def finish_tape(self) -> tuple[Tape, np.ndarray]:
        """Return the finished tape, and row and velocity (k, 2) of each of its outputs."""
        tape = self.builder.finish_tape([self.numbers.place_number(x) for _, _, x in self.entries])
        places = np.array([(row, column) for row, column, _ in self.entries], dtype=np.int64)
        return tape, places.reshape(-1, 2)


class Seen:
    """Numbers of the pose of frame b relative to frame a, and their rates, by name."""

    def __init__(self, recorder: Recorder, a: End, b: End):
        self.recorder = recorder
        self.a = a
        self.b = b
        self._ends: tuple[RecordedPose, RecordedPose] | None = None

    def __call__(self, name: str) -> tuple[Num, Form]:
        """Return a number of the pose by name, and its rate."""
        n = self.recorder.numbers
        if self._ends is None:
            self._ends = self.recorder.find_end_pose(self.a), self.recorder.find_end_pose(self.b)
        A, B = self._ends
        if len(name) == 1:
            away = [n.subtract_numbers(B.p[i], A.p[i]) for i in range(3)]
            return n.compute_dot_product(A.get_axis(PLACE[name]), away), {PLACE[name]: 1.0}
        i = PLACE[name[0]]
        j = PLACE[name[1]]
        entry: Callable[[int], Num] = lambda k: n.compute_dot_product(A.get_axis(k), B.get_axis(j))  # noqa: E731
        # the rate of an axis is w x axis
        y = (i + 1) % 3
        z = (i + 2) % 3
        return entry(i), {3 + y: entry(z), 3 + z: n.negate_number(entry(y))}


# ---- rows of a system


@explain_errors
def evaluate_velocity_rows(system: Model, q: Any, t: ArrayLike = 0.0) -> tuple[Array, Array]:
    """Compute A (..., m, nv) and b (..., m) of the velocity constraints A(q) v = b(q, t).

    q is (..., nq), t (...) are times.

    Rows are in the order of `list_velocity_row_names`, those that slip in m/s, those that turn in rad/s. A system
    without such constraints has none. Errors: `InputError`.
    """
    return record_velocity_rows(system).evaluate_rows(read_q(system, q), read_reals(t, "t"))


def list_velocity_row_names(system: Model) -> tuple[tuple[str, str], ...]:
    """List the names of each velocity row: that of its constraint and its own."""
    return tuple((r.of, r.name) for r in record_velocity_rows(system).names)


@keep_answers
def record_velocity_rows(system: Model) -> VelocityRows:
    """Record the rows of the declared velocity constraints."""
    return _record_rows(system, system.structure.table, False)


@keep_answers
def record_tangent_rows(system: Model) -> VelocityRows:
    """Record the velocity rows of all constraints, those of positions differentiated.

    Joints that the tree left out are led on through their own motion, so that all coordinates
    count. One-sided rows are there, as if they were active.
    """
    return _record_rows(system, make_explicit_table(system), True)


def _record_rows(system: Model, table: Table, positions: bool) -> VelocityRows:
    """Record the declared velocity rows, and with `positions` the tangents of position rows."""
    mechanism = system._mechanism
    made = _Recording(system, table, mechanism.parameters)
    for tie in list_position_ties(system, table) if positions else ():
        made.add_tangents(tie)
    for declared in mechanism.constraints.values():
        made.add_velocity_rows(declared)
    return made.finish_rows()


class _Recording:
    """Recording of the velocity rows of a system, with their names."""

    def __init__(self, system: Model, table: Table, parameters: Mapping[str, float]):
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
            self._add_quaternion_rates(int(iq), int(iv))
        numbers = self.recorder.numbers
        for name, f in system.structure.couplings.items():
            self.known[name] = float(f.offset)
            self.rates[name] = {}
            if f.source is not None:
                self.known[name] = numbers.add_numbers(
                    numbers.multiply_numbers(f.multiplier, self.known[f.source]), float(f.offset)
                )
                self.rates[name] = {("v", first[f.source][1]): f.multiplier}
        self.known.setdefault(TIME, self.recorder.time)  # unless a coordinate is called so

    def _add_quaternion_rates(self, iq: int, iv: int) -> None:
        """Add the rates of the entries of a quaternion: q' = q (0, w) / 2."""
        half = [self.recorder.numbers.multiply_numbers(0.5, iq + k) for k in range(4)]
        w, x, y, z = half
        minus = self.recorder.numbers.negate_number
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

    def add_tangents(self, tie: Tie) -> None:
        """Add the velocity rows that are the time derivatives of a tie's equations."""
        for name, form in zip(tie.row_names, self._iterate_forms(tie), strict=True):
            self.recorder.add_row(tie.a, tie.b, form)
            self.names.append(RowName(tie.name, name, "m", False, bool(tie.bounds)))

    def _iterate_forms(self, tie: Tie) -> Iterator[Form]:
        """Yield the rate of each equation of a tie as a form in twist and velocities."""
        r = self.recorder
        turns = tie.turns
        seen = r.make_relative_pose(tie.a, tie.b)
        if tie.tape is not None:
            known = {**self.known}
            rates = {TIME: {("v", r.table.nv): 1.0}, **self.rates}
            for k in range(len(tie.tape.names)):
                yield r.linearize_output(
                    tie.tape.tape, seen if tie.tape.posed else None, known, rates, k
                )[1]
            return
        if turns == loop_layout.LINEAR and tie.relation is not None:
            form: Form = {}
            for name, factor in (
                (tie.relation.of, 1.0),
                *((n, -m) for n, m in tie.relation.sources.items()),
            ):
                form = r.combine_forms(form, 1.0, self.rates[name], factor)
            yield form
            return
        if turns == loop_layout.DISTANCE:
            yield {i: seen("xyz"[i])[0] for i in range(3)}
            return
        yield from ({i: 1.0} for i in range(3) if tie.mask >> i & 1)
        if turns in (loop_layout.FULL, loop_layout.ANGLE):
            yield from ({3 + i: 1.0} for i in range(0 if turns == loop_layout.FULL else 2, 3))
        elif turns == loop_layout.ALIGN:
            yield from (seen(entry)[1] for entry in ("yz", "xz"))
        elif turns == loop_layout.CROSS:
            yield seen("xy")[1]
        elif turns == loop_layout.LOOK:
            for axis in "xy":  # the axis across the line of sight
                form = {}
                for i in "xyz":
                    (u, du) = seen(i + axis)
                    (p, dp) = seen(i)
                    form = r.combine_forms(form, 1.0, r.combine_forms(du, p, dp, u), 1.0)
                yield form
        elif turns != loop_layout.NO_TURN:
            raise UnsupportedError(
                f"constraint {tie.name!r} is no recorded expression: its series are needed here"
            )

    def add_velocity_rows(self, declared: Declared) -> None:
        """Add the velocity rows of a declared constraint."""
        system = self.system
        made = evaluate_constraint(declared, self.parameters, system.dim)
        rows = [row for row in made.list_rows(system.dim) if row.velocity]
        if not rows:
            return
        a, b = find_ends(system, self.recorder.table, declared)
        seen = self.recorder.make_relative_pose(a, b) if made.ends[1] is not None else None
        numbers = collect_numbers(made)
        known: dict[str, Num] = {**self.known, **numbers}
        speeds = {n + RATE: form for n, form in self.rates.items()}
        known |= dict.fromkeys(speeds, 0.0)
        for row in rows:
            tape, which = row.args
            value, form = self.recorder.linearize_output(tape, seen, known, speeds, which)
            self.recorder.add_row(a, b, form, value)
            self.names.append(
                RowName(declared.name, row.name, row.unit, written=not declared.of.scaled)
            )

    def finish_rows(self) -> VelocityRows:
        """Return the recorded rows."""
        system = self.system
        table = self.recorder.table
        tape, entries = self.recorder.finish_tape()
        turning = set(table.iv[table.kind != P].tolist())
        turning |= {v + i for v in table.iv[table.kind == Q].tolist() for i in range(3)}
        length = compute_characteristic_length(system)
        units = np.array([1.0 if v in turning else length for v in range(system.nv)] + [1.0])
        return VelocityRows(
            system.structure.layout,
            system.coordinate_names,
            tape,
            entries,
            tuple(self.names),
            units,
        )
