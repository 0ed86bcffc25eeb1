"""Errors of constraints at configurations, from poses in plain numpy, without the kernels.

Tasks of `ik` are judged at poses of the forward model. `judge_configurations` measures all that a system declares,
at poses that are multiplied out joint by joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from kempe import spatial
from kempe.arguments import explain_errors
from kempe.arrays import read_reals, unwrap_scalar
from kempe.constraints.base import Constraint, Op, Row, compute_tilt, find_value_field, is_one_sided
from kempe.constraints.tape import POSE, TIME
from kempe.description.mechanism import Mechanism, evaluate_constraint
from kempe.description.parts import Declared, Joint
from kempe.forward.fk import fk
from kempe.joints import JointType, P, Primitive, R
from kempe.kernels.constraints import loop_layout as L
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import find_free_angles, read_q
from kempe.model.constraint_program import (
    TURNS,
    collect_numbers,
    format_input_name,
    get_field_number,
)
from kempe.model.coordinates import Follower, list_coordinate_names
from kempe.model.kernel_functions import ConfigurationRows
from kempe.model.model import Model, keep_answers
from kempe.spatial import Array
from kempe.units import METRE
from kempe.words import InWords

# ---- loops: how far joints that the spanning tree left out are open


def compute_coordinate_value(system: Model, q: spatial.Array, name: str) -> spatial.Array:
    """Compute the value (...) of a joint coordinate at q (..., nq), also if coupled or locked."""
    follower: Follower | None = system.structure.couplings.get(name)
    if follower is None:
        return q[..., system.coordinate_names.index(name)]
    source = (
        0.0 if follower.source is None else q[..., system.coordinate_names.index(follower.source)]
    )
    return np.broadcast_to(follower.multiplier * source + follower.offset, q.shape[:-1])


@explain_errors
def closure_error(system: Model, q: Any) -> spatial.Array:
    """Compute the gap of each loop (..., number of closures, 6) at q (..., nq).

    For each joint that the tree left out: the twist [v; w] in metres and radians, in axes of its
    frame M, that leads from where its own coordinates put M to where the tree puts it. Zero where
    the loop is closed. The angular part of a particle is zero.
    """
    q = read_q(system, q)
    bodies = fk(system, q)
    out = np.zeros((*q.shape[:-1], len(system.structure.closures), 6))
    number = {b: i for i, b in enumerate(system.body_names)}
    mechanism = system._mechanism
    for k, name in enumerate(system.structure.closures):
        joint = mechanism.joints[name]
        names = list_coordinate_names(mechanism, joint)
        local = (
            np.stack([compute_coordinate_value(system, q, c) for c in names], axis=-1)
            if names
            else q[..., :0]
        )
        X_PF, X_CM = compute_joint_placements(system, name)
        X_FM = compute_joint_pose(
            joint.type, local, system.dim, mechanism.bodies[joint.child].particle
        )
        X_WM = bodies[..., number[joint.parent], :, :] @ X_PF @ X_FM
        X_MM = spatial.inverse(X_WM) @ bodies[..., number[joint.child], :, :] @ X_CM
        if mechanism.bodies[joint.child].particle:  # it has a position only
            out[..., k, :3] = X_MM[..., :3, 3]
        else:
            out[..., k, :] = spatial.log_se3(X_MM)
    return out


@keep_answers
def compute_joint_placements(system: Model, joint: str) -> tuple[Array, Array]:
    """Compute the poses (4, 4) of a joint's frames: F on its parent body and M on its child."""
    m = system._mechanism
    return m.joints[joint].X_PF.evaluate_pose(m.parameters), m.joints[joint].X_CM.evaluate_pose(
        m.parameters
    )


@keep_answers
def compute_frame_placement(system: Model, frame: str) -> Array:
    """Compute the pose (4, 4) of a declared frame on its body."""
    m = system._mechanism
    return m.frames[frame].X_BF.evaluate_pose(m.parameters)


def compute_joint_pose(
    kind: JointType, q: spatial.Array, dim: int = 3, particle: bool = False
) -> spatial.Array:
    """Compute the pose X_FM (..., 4, 4) of a joint type at its own coordinates (..., k)."""
    mechanism = Mechanism("joint", dim)
    child = mechanism.particle("M") if particle else mechanism.body("M")
    # not by `Mechanism.joint`: a slider of the plane slides along z of its frame F, which is not
    # the plane's z
    mechanism.joints["joint"] = Joint("joint", kind, mechanism.ground.name, child.name)
    return fk(Model(mechanism), q, "M")


# ---- rows of a pose

# Each operation of a row has one measure.

WITHIN = 1e-6
"""Error in radians, or as a part of the characteristic length, up to which what is declared counts
as held."""
ROUNDING = 1e-12
"""Error as a part of the largest coordinate of a point, that rounding alone may make."""
TURN = 2.0 * np.pi
"""A whole turn, in radians."""
SHOWN = 4
"""Names that a sentence lists."""

Numbers = dict[str, Array]
"""Numbers (..., k) of a constraint by name: those that come with one call."""
FRAME_ROWS = (*TURNS, Op.POINT, Op.DISTANCE)
"""Operations that read where one frame is in another."""


class RowShape(NamedTuple):
    """The parts of a relative pose that rows of a constraint hold."""

    mask: int
    turns: int
    lengths: bool
    angles: bool
    axes: tuple[int, ...]
    point: bool
    """Whether they hold a point of the frame, or the whole frame."""
    turned: bool
    """Whether they hold the orientation."""


@lru_cache(maxsize=512)
def make_row_shape(rows: tuple[Row, ...], dim: int) -> RowShape:
    """Determine which parts of the pose of frame B in frame A the rows hold.

    `dim` is 2 in the plane and 3 in space.
    """
    sorts = {
        Op.ROTATION: L.ANGLE if dim == 2 else L.FULL,
        Op.TILT: L.ALIGN,
        Op.LOOK: L.LOOK,
        Op.DISTANCE: L.DISTANCE,
    }
    axes = tuple(r.args[0] for r in rows if r.op is Op.POINT)
    turns = next((sorts[r.op] for r in rows if r.op in sorts), L.NO_TURN)
    units = {r.unit for r in rows}
    mask = sum(1 << a for a in axes)
    whole = mask == (3 if dim == 2 else 7)
    turned = turns in (L.FULL, L.ANGLE)
    return RowShape(mask, turns, "m" in units, "rad" in units, axes, whole, turned)


def compute_lengths(p: Array) -> Array:
    """Compute the lengths (...) of vectors (..., k)."""
    if p.ndim == 1:
        return math.sqrt(p.dot(p))  # type: ignore[return-value]
    return np.sqrt(np.vecdot(p, p))


def compute_angle_between(R: Array, S: Array) -> Array:
    """Compute the angle (...) between two rotations (..., 3, 3).

    It follows from the Frobenius norm of their difference, sqrt(8) sin(angle / 2).
    """
    d = R - S
    if d.ndim == 2:
        return 2.0 * math.asin(min(compute_lengths(d.ravel()) / math.sqrt(8.0), 1.0))  # type: ignore[return-value]
    d = d.reshape(*d.shape[:-2], 9)
    return 2.0 * np.arcsin(np.minimum(np.sqrt(np.vecdot(d, d) / 8.0), 1.0))


def compute_frame_errors(A: Array, B: Array, shape: RowShape) -> tuple[Array, Array]:
    """Compute how far (...) frame B (..., 4, 4) is from frame A, in metres and in radians.

    Only the parts of the pose that the `shape` holds count.
    """
    size: Any = 0.0
    angle: Any = 0.0
    if shape.mask:
        p = B[..., :3, 3] - A[..., :3, 3]
        size = compute_lengths(
            p if shape.point else (p[..., None, :] @ A[..., :3, list(shape.axes)])[..., 0, :]
        )
    if shape.turned:
        angle = compute_angle_between(B[..., :3, :3], A[..., :3, :3])
    elif shape.turns in (L.ALIGN, L.LOOK):
        seen = spatial.inverse(A) @ B
        look = shape.turns == L.LOOK
        angle = compute_tilt(
            np.einsum("...ji,...j->...i", seen[..., :3, :3], -seen[..., :3, 3])
            if look
            else seen[..., :3, 2]
        )
    return size, angle


# ---- rows that are expressions or functions


def list_pose_inputs(X: Array) -> dict[str, Array]:
    """List the inputs of expressions that a pose (..., 4, 4) gives, by name.

    These are its position, and its rotation row by row.
    """
    values = [X[..., i, 3] for i in range(3)] + [X[..., i, j] for i in range(3) for j in range(3)]
    return dict(zip(POSE, values, strict=True))


def measure_rows(
    system: Model,
    made: Constraint,
    rows: Iterable[Row],
    q: Array,
    A: Array | None = None,
    B: Array | None = None,
    given: Numbers | None = None,
    t: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Measure the errors (...) of position rows at q (..., nq): metres, and radians or numbers.

    `made` has its numbers, but for those `given` (..., k) by name; A and B (..., 4, 4) are its
    frames, where it has any; t (...) are the times of equations in time. Of values of coordinates
    the largest difference counts, else the root of the sum of squares.
    """
    numbers = given or {}
    frame_rows: list[Row] = []
    coordinates: list[Row] = []
    others: list[Row] = []
    for row in rows:
        whole = row.op in FRAME_ROWS and not is_compared(made, row)
        (frame_rows if whole else coordinates if row.op is Op.COORDINATE else others).append(row)
    misses: list[tuple[Any, Any]] = []
    if frame_rows:
        assert A is not None and B is not None
        misses.append(compute_frame_errors(A, B, make_row_shape(tuple(frame_rows), system.dim)))
    if coordinates:
        misses.append(compute_coordinate_errors(system, coordinates, q, numbers))
    known: dict[str, Any] = {}
    if any(r.op in (Op.TAPE, Op.CALL) for r in others):
        known = {TIME: t} | collect_numbers(made)
        known |= {name: x[..., 0] for name, x in numbers.items()}
        known |= {} if A is None or B is None else list_pose_inputs(spatial.inverse(A) @ B)
    for row in others:
        if row.op in FRAME_ROWS:
            assert A is not None and B is not None
            value = _measure_frame_row(row, A, B)
        else:
            value = _evaluate_function_row(system, made, row, q, known)
        low, high = _find_row_bounds(made, row, numbers)
        off = (
            abs(value - low)
            if low is high
            else abs(value - np.minimum(np.maximum(value, low), high))
        )
        misses.append((off, 0.0) if row.unit == "m" else (0.0, off))
    if len(misses) == 1:
        size, angle = misses[0]
    else:
        size, angle = (np.sqrt(sum(m[k] * m[k] for m in misses)) for k in (0, 1))
    if q.ndim == 1:
        return size, angle
    none = np.zeros(q.shape[:-1])
    return size + none, angle + none


def is_compared(made: Constraint, row: Row) -> bool:
    """Whether a row is compared with a number or a distance, and not with zero."""
    return row.op is Op.DISTANCE or bool(find_value_field(made, row)) or is_one_sided(made, row)


def _find_row_bounds(made: Constraint, row: Row, given: Numbers) -> tuple[Any, Any]:
    """Find the bounds (...) of a row; both are the same for a row with one value."""
    if not is_one_sided(made, row):
        value = _read_field_number(made, find_value_field(made, row), row.part, given, 0.0)
        return value, value
    low = _read_field_number(made, row.low, row.part, given, -np.inf)
    return low, _read_field_number(made, row.high, row.part, given, np.inf)


def _read_field_number(
    made: Constraint, field: str, part: int | None, given: Numbers, default: float
) -> Any:
    """Read the number (...) of a field: that of the call if `given`, else the field's own.

    Without either it is `default`.
    """
    x = given.get(format_input_name(field, part))
    if x is not None:
        return x[..., 0]
    x = get_field_number(made, field, part) if field else None
    return default if x is None else np.asarray(x, dtype=float)


def compute_coordinate_errors(
    system: Model, rows: Iterable[Row], q: Array, numbers: Numbers
) -> tuple[Array, Array]:
    """Compute the largest errors (...) of the coordinates that rows hold: slides, and turns."""
    values = np.broadcast_to(system.neutral, q.shape).copy()
    items = [r.args for r in rows]
    for _, i, name, ball in items:
        values[..., i : i + (4 if ball else 1)] = numbers[name]
    d = np.abs(system.structure.layout.compute_difference(values, q))
    whole = find_free_angles(system)
    d[..., whole] = np.abs(d[..., whole] - TURN * np.round(d[..., whole] / TURN))
    turning = system.structure.coordinates.turning
    slides = [v for v, _, _, ball in items if not ball and not turning[v]]
    turns = [v for v, _, _, ball in items if not ball and turning[v]]
    balls = [np.linalg.norm(d[..., v : v + 3], axis=-1) for v, _, _, ball in items if ball]
    angle = np.max(np.stack([d[..., turns].max(axis=-1, initial=0.0), *balls]), axis=0)
    return d[..., slides].max(axis=-1, initial=0.0), angle


def _measure_frame_row(row: Row, A: Array, B: Array) -> Array:
    """Measure the position (...) of frame B's origin along an axis of frame A, or its distance."""
    p = B[..., :3, 3] - A[..., :3, 3]
    return compute_lengths(p) if row.op is Op.DISTANCE else np.vecdot(p, A[..., :3, row.args[0]])


def _evaluate_function_row(
    system: Model, made: Constraint, row: Row, q: Array, known: Mapping[str, Any]
) -> Array:
    """Evaluate a row that is an expression or a function at q (..., nq): its values (...)."""
    what, k = row.args
    if row.op is Op.TAPE:
        own = {
            n: compute_coordinate_value(system, q, n)
            for n in what.inputs
            if n not in known or n in made.coordinate_names
        }
        return what.evaluate_outputs({**known, **own})[..., k]
    own = {n: compute_coordinate_value(system, q, n) for n in made.coordinate_names}
    out = np.empty(q.shape[:-1])
    if TIME in known:
        own = {TIME: np.broadcast_to(known[TIME], out.shape)} | own
    for index in np.ndindex(out.shape):
        out[index] = (
            what.compute_row_values(q[index])
            if isinstance(what, ConfigurationRows)
            else what({**known, **{n: x[index] for n, x in own.items()}})
        )[k]
    return out


# ---- poses multiplied out joint by joint


def multiply_primitives(primitives: Sequence[Primitive], values: Array) -> Array:
    """Multiply the primitives of a joint to its pose X_FM (..., 4, 4), at `values` (..., k)."""
    X = np.broadcast_to(np.eye(4), (*values.shape[:-1], 4, 4))
    for p in primitives:
        if p.kind == P:
            shift = np.zeros((*values.shape[:-1], 3))
            shift[..., "xyz".index(p.axis)] = p.multiplier * values[..., p.coordinate]
            step = spatial.pose(p=shift)
        elif p.kind == R:
            angle = p.multiplier * values[..., p.coordinate]
            step = spatial.pose(spatial.make_rotation(angle, p.axis))
        else:
            step = spatial.pose(
                spatial.quat_wxyz_to_matrix(values[..., p.coordinate : p.coordinate + 4])
            )
        X = X @ step
    return X


class Poses:
    """Poses of bodies and frames of a system at q (..., nq), in numpy.

    They are products of joint transforms along the tree.

    Equations in time are read at the times t (...).
    """

    def __init__(self, system: Model, q: Array, t: Array | float = 0.0):
        self.system = system
        self.q = q
        self.mechanism = system._mechanism
        tree = system.structure.topology
        self.t = t
        self.bodies = {tree.bodies[0]: np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))}
        for body, parent, name, back in zip(
            tree.bodies[1:], tree.parent, tree.parent_joints, tree.reversed_, strict=True
        ):
            F, M = self.compute_joint_frames(self.mechanism.joints[name])
            X = F @ spatial.inverse(M)
            self.bodies[body] = self.bodies[tree.bodies[parent]] @ (
                spatial.inverse(X) if back else X
            )

    def compute_joint_frames(self, joint: Joint) -> tuple[Array, Array]:
        """Compute the frames M of a joint: seen from its parent (..., 4, 4) and child (4, 4).

        Its coordinates place the first, its placement on the child the second.
        """
        system = self.system
        m = self.mechanism
        names, primitives = joint.type.layout(m.dim, m.bodies[joint.child].particle)
        whole = [f"{joint.name}.{n}" if n else joint.name for n in names]
        own = [compute_coordinate_value(system, self.q, n) for n in whole]
        values = np.stack(own, axis=-1) if own else self.q[..., :0]
        X_PF, X_CM = compute_joint_placements(system, joint.name)
        return X_PF @ multiply_primitives(primitives, values), X_CM

    def __call__(self, name: str | Sequence[str] | None) -> Array:
        """Return the pose (..., 4, 4) of a body or frame, or those of several (..., n, 4, 4).

        None stands for all bodies.
        """
        if not isinstance(name, str):
            return np.stack([self(n) for n in (self.bodies if name is None else name)], axis=-3)
        frame = self.mechanism.frames.get(name)
        if frame is None:
            return self.bodies[name]
        return self.bodies[frame.body] @ compute_frame_placement(self.system, name)

    def measure_joint_gap(self, joint: Joint) -> tuple[Array, Array]:
        """Measure the gap (...) of a cut joint: distance in metres and angle in radians.

        The angle is 0 for a particle.
        """
        F, M = self.compute_joint_frames(joint)
        A = self.bodies[joint.parent] @ F
        B = self.bodies[joint.child] @ M
        size = compute_lengths(B[..., :3, 3] - A[..., :3, 3])
        if self.mechanism.bodies[joint.child].particle:
            return size, np.zeros_like(size)
        return size, compute_angle_between(A[..., :3, :3], B[..., :3, :3])

    def measure_constraint(self, declared: Declared) -> tuple[Array, Array]:
        """Measure the errors (...) of a declared constraint's position rows: metres and radians."""
        m = self.mechanism
        dim = self.system.dim
        made = evaluate_constraint(declared, m.parameters, dim)
        A = None
        B = None
        if declared.parent:
            F, M = declared.frames(m.parameters, dim)
            A = self.bodies[declared.parent] @ F
            B = self.bodies[declared.child] @ M
        return measure_rows(
            self.system,
            made,
            [r for r in made.list_rows(dim) if not r.velocity],
            self.q,
            A,
            B,
            t=self.t,
        )

    def measure_relation(
        self, of: str, sources: dict[str, float], offset: float
    ) -> tuple[Array, Array]:
        """Measure the error (...) of a relation of coordinates, relative to its largest factor."""
        off = compute_coordinate_value(self.system, self.q, of) - offset
        for name, factor in sources.items():
            off = off - factor * compute_coordinate_value(self.system, self.q, name)
        off = np.abs(off) / max(1.0, *map(abs, sources.values()))
        turning = self.system.structure.coordinates.turning[
            self.system.structure.coordinates.first[of][1]
        ]
        return (np.zeros_like(off), off) if turning else (off, np.zeros_like(off))


# ---- the judgement of a whole system


class MeasuredTask(Protocol):
    """Protocol of a task whose error can be measured, as `kempe.equations.tasks.Task`."""

    label: str

    def measure_error(
        self, q: Array, goal: Any = None, poses: Callable[[Any], Array] | None = None
    ) -> tuple[Array, Array]:
        """Measure the errors (...) of the task at q (..., nq), in metres and radians.

        `poses` gives the poses of frames.
        """
        ...


@dataclass(frozen=True, eq=False)
class Judgement(InWords):
    """Errors of all constraints and tasks at configurations, and whether they are satisfied.

    The errors are measured on poses that numpy computes, independently of the solvers.

    `errors` (n, ..., 2) are by `names`, in metres and in radians (or plain numbers, of an
    equation); those above `allowed` are violations.
    """

    names: tuple[str, ...]
    errors: Array
    allowed: Array = field(repr=False)
    unit: str = field(default=METRE, repr=False)
    """Unit of the lengths."""

    @property
    def missed(self) -> np.ndarray:
        """Mask (n, ...) of the constraints whose error exceeds the allowed error or is NaN."""
        return np.asarray(~(self.errors <= self.allowed).all(axis=-1))

    @property
    def holds(self) -> Any:
        """Mask (...) of the configurations at which all constraints and tasks hold."""
        return unwrap_scalar(~self.missed.any(axis=0))

    def of(self, which: np.ndarray) -> Judgement:
        """Return the judgement of the configurations where `which` (...) is true."""
        return replace(self, errors=self.errors[:, which], allowed=self.allowed[:, which])

    def __bool__(self) -> bool:
        return bool(np.all(self.holds))

    def __str__(self) -> str:
        """Return the sentence that names the largest violation, or says that there is none."""
        n = len(self.names)
        if not n:
            return "nothing is declared or requested that poses could miss"
        each = self.errors.reshape(n, -1, 2)
        if self:
            names = ", ".join(map(repr, self.names[:SHOWN])) + (
                f", ... ({n} in all)" if n > SHOWN else ""
            )
            place, turn = each.max(axis=(0, 1), initial=0.0)
            most = f"{place:.1g} {self.unit} and {turn:.1g} rad"
            return f"independent check: {names} {'holds' if n == 1 else 'hold'} to {most}"
        share = (each / self.allowed.reshape(n, -1, 2)).max(axis=-1)
        k, row = np.unravel_index(
            int(np.argmax(np.where(np.isnan(share), np.inf, share))), share.shape
        )
        place, turn = each[k, row]
        far = f"{place:.3g} {self.unit} and {turn:.3g} rad"
        return f"independent check: {self.names[k]!r} is missed by {far}"

    def data(self) -> dict[str, Any]:
        """Return the largest error by name [m, rad], whether all constraints hold, and a sentence."""
        worst = (
            self.errors.reshape(len(self.names), -1, 2).max(axis=1, initial=0.0)
            if self.names
            else np.zeros((0, 2))
        )
        return {
            "holds": np.asarray(self.holds).tolist(),
            "errors": dict(zip(self.names, worst.tolist(), strict=True)),
            "text": str(self),
        }


def judge_configurations(
    system: Model,
    q: Any,
    requested: Sequence[tuple[MeasuredTask, Any, Any]] = (),
    more: Array | float = 0.0,
    t: Array | float = 0.0,
    closing: Model | None = None,
) -> Judgement:
    """Measure the errors of all constraints, and of the `requested` tasks, at q (..., nq).

    `t` (...) are the times of equations in time.

    That is: joints that the tree left out, rows of position of constraints, couplings with several
    sources. `requested` has tasks with their goals (or None) and what (2,) each may be missed by;
    `more` (...) is what solvers left of others, in radians and characteristic lengths. Rows of
    velocity are about motions, not about a configuration. Where another system is `closing`, what
    is declared is judged in its dimensions, and what is required in those of `system`.
    """
    q = read_q(system, q)
    t = read_reals(t, "t")
    at = drawn = Poses(system, q, t)
    if closing is not None and closing is not system:
        system = closing
        at = Poses(closing, q, t)
    m = at.mechanism
    found = [(name, at.measure_joint_gap(m.joints[name])) for name in system.structure.closures]
    found += [
        (c.name, at.measure_constraint(c))
        for c in m.constraints.values()
        if c.count_positions(system.dim)
    ]
    found += [
        (r.of, at.measure_relation(r.of, r.sources, r.offset)) for r in system.structure.relations
    ]
    far = max(
        (float(np.abs(X[..., :3, 3]).max(initial=0.0)) for X in at.bodies.values()), default=0.0
    )
    within = (WITHIN + 10.0 * np.asarray(more, dtype=float))[..., None] * [
        compute_characteristic_length(system),
        1.0,
    ]
    within = within + ROUNDING * np.array([far, 1.0])
    lead = (*q.shape[:-1], 2)
    allowed = [np.broadcast_to(within, lead) for _ in found]
    for task, goal, most in requested:
        found.append((task.label, task.measure_error(q, goal, drawn)))
        allowed.append(
            np.broadcast_to(np.asarray(most) * (1.0 + 1e-3) + ROUNDING * np.array([far, 1.0]), lead)
        )
    errors = np.array([np.stack(np.broadcast_arrays(*e), axis=-1) for _, e in found]).reshape(
        len(found), *lead
    )
    return Judgement(
        tuple(n for n, _ in found),
        errors,
        np.array(allowed).reshape(len(found), *lead),
        system.unit,
    )
