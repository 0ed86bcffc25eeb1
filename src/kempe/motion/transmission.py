"""Velocities and forces through closed loops: Jacobian, mechanical advantage, dead points, angles.

The null space of the closure Jacobian, and of the velocity constraints, holds all velocities that
they allow. Where the inputs determine them, other velocities are linear in those of the inputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import (
    explain_errors,
    explain_method_errors,
    read_distinct_names,
    read_names,
)
from kempe.arrays import read_reals
from kempe.assemble.nearest_exact import answer_within_tolerance, describe_nearest
from kempe.constraints.tape import TWIST
from kempe.equations.closure import Closure
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.first_order.rank import compute_allowed_velocities, refuse_open_loops
from kempe.forward.fk import fk, jacobian
from kempe.joints import P, R
from kempe.model.configurations import read_q
from kempe.motion.path import Event, Path
from kempe.motion.start import find_angle_or_slide, refuse_follower
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Nearest, Report, Table
from kempe.spatial import Array
from kempe.status import Status, to_status
from kempe.words import Quantity, format_count

if TYPE_CHECKING:
    from kempe.argument_types import ConfigurationLike
    from kempe.model.model import Model


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class LoopJacobian(Report):
    """Jacobian of output velocities with respect to input velocities, through closed loops.

    Attributes
    ----------
    matrix
        Jacobians (..., rows, inputs) in SI units, NaN where they do not exist.
    inputs, rows
        Names of the inputs and of the rows.
    nullity
        Numbers (...) of first-order motions of the mechanism.
    rank
        Numbers (...) of independent motions among the inputs.
    margin
        Smallest singular values (...) of the inputs on the null space: 0 at a dead point.
    code
        `Status.SOLVED`, `DEAD_POINT` or `UNDETERMINED`.
    """

    _entries = ("inputs", "rows", "matrix", "rank", "nullity", "margin")

    matrix: Array
    inputs: tuple[str, ...]
    rows: tuple[str, ...]
    rank: Any
    nullity: Any
    margin: Any
    code: Any = field()
    within: Nearest | None = None
    """The nearest mechanism that closes exactly, whose velocities these are; None: the given
    one's."""

    @property
    def status(self) -> Any:
        """Sentence for one configuration; an array of sentences for several configurations."""
        if np.ndim(self.code) == 0:
            return self._make_sentence(
                int(self.code), int(self.rank), int(self.nullity)
            ) + describe_nearest(self.within)
        out = np.empty(np.shape(self.code), dtype=object)
        for i in np.ndindex(out.shape):
            out[i] = self._make_sentence(int(self.code[i]), int(self.rank[i]), int(self.nullity[i]))
        return out

    def _make_sentence(self, code: Any, rank: int, nullity: int) -> str:
        names = " and ".join(map(repr, self.inputs))
        motions = format_count(nullity, "first-order motion")
        if code == Status.SOLVED:
            return f"{names} determine{'s' * (len(self.inputs) == 1)} the outputs ({motions})"
        if code == Status.DEAD_POINT:
            some = f"only {rank} of" if rank else "none of"
            return f"dead point: {some} the inputs ({names}) can move independently ({motions})"
        return (
            f"not determined: with {names} at rest the outputs still move ({motions}, rank {rank} "
            "of the inputs)"
        )

    def _make_headline(self) -> str:
        if np.ndim(self.code):
            many = format_count(np.size(self.code), "configuration")
            return f"{int(np.sum(self.success))} of {many}: the outputs are determined"
        return self.status

    def _make_tables(self) -> Sequence[Table]:
        if np.ndim(self.code):
            return []
        each = zip(self.rows, self.matrix, strict=True)
        rows = [(name, *(Quantity(float(x)) for x in row)) for name, row in each]
        return [Table(("", *self.inputs), rows, grid=True)]


@explain_errors
@answer_within_tolerance("q")
def compute_loop_jacobian(
    system: Model,
    q: ConfigurationLike,
    inputs: Sequence[str],
    outputs: Sequence[str],
    in_frame: str = "world_aligned",
    *,
    tolerance: float | str | None = None,
) -> LoopJacobian:
    """Compute the Jacobian of outputs by inputs at closed configurations `q` (..., nq).

    `inputs` are names of angles and slides, as many as the mechanism has freedoms (more may be free
    where they do not move the outputs: idle spins). `outputs` are names of coordinates, one row
    each, or of bodies and frames, six rows each, [linear; angular] expressed `in_frame` as in
    `System.jacobian`; where a coordinate and a frame share a name write "joint:name" or
    "frame:name". Errors: `InputError` for a configuration that is not closed or an unclear name,
    `UnknownNameError`.
    """
    inputs = _read_names(inputs)
    outputs = _read_names(outputs)
    q = read_q(system, q)
    closure = Closure(system)
    index = [find_angle_or_slide(system, n) for n in inputs]
    kinds = [_find_output(system, n) for n in outputs]
    rows = tuple(
        r
        for kind, name in kinds
        for r in ([name] if kind == "joint" else [f"{name}.{t}" for t in TWIST])
    )
    lead = q.shape[:-1]
    matrix = np.full((*lead, len(rows), len(index)), np.nan)
    rank, nullity, code = (np.zeros(lead, dtype=np.int64) for _ in range(3))
    margin = np.zeros(lead)
    for i in np.ndindex(lead):
        free = compute_allowed_velocities(closure, q[i], index)
        motion = free * closure.unit[:, None]
        out = np.vstack(
            [
                motion[[find_angle_or_slide(system, n)]]
                if kind == "joint"
                else jacobian(system, q[i], n, in_frame) @ motion
                for kind, n in kinds
            ]
        )
        nullity[i] = free.shape[1]
        driven = Spectrum(free[index], 1.0)
        rest = out @ driven.compute_null_space(Level.CLOSED)
        rank[i] = driven.compute_rank(Level.CLOSED)
        margin[i] = driven.smallest if free.shape[1] >= len(index) else 0.0
        scale = np.abs(out).max(initial=0.0)
        if rank[i] < len(index):
            code[i] = Status.DEAD_POINT
        elif np.abs(rest).max(initial=0.0) > 1e-7 * max(scale, 1e-300):
            code[i] = Status.UNDETERMINED
        else:
            matrix[i] = out @ driven.compute_pseudo_inverse(Level.CLOSED) / closure.unit[index]
    if not lead:
        return LoopJacobian(
            matrix, tuple(inputs), rows, int(rank), int(nullity), float(margin), to_status(code)
        )
    return LoopJacobian(matrix, tuple(inputs), rows, rank, nullity, margin, code)


def _read_names(names: Sequence[str]) -> list[str]:
    """Read the names of inputs or outputs, at least one, each once. Errors: `InputError`."""
    out = list(read_distinct_names(names, "inputs or outputs"))
    if not out:
        raise InputError("inputs and outputs must each name at least one coordinate or frame")
    return out


def _find_output(system: Model, name: str) -> tuple[str, str]:
    """Return ("joint" or "frame", name) of an output."""
    kind, colon, rest = str(name).partition(":")
    if colon and kind in ("joint", "frame"):
        return kind, rest if kind == "joint" else system.structure.frame_name(rest)
    coordinate = name in system.structure.velocity_names
    frame = name in system.frame_names
    if coordinate and frame:
        raise InputError(
            f"{name!r} is a coordinate and a frame; write 'joint:{name}' or 'frame:{name}'"
        )
    if not coordinate and not frame:
        refuse_follower(system, name)
        raise UnknownNameError(
            "coordinate or frame",
            name,
            (*system.structure.velocity_names, *system.frame_names),
            system.name,
        )
    return ("joint", name) if coordinate else ("frame", name)


@explain_errors
@answer_within_tolerance("q")
def compute_mechanical_advantage(
    system: Model,
    q: ConfigurationLike,
    input: str,
    output: str,
    direction: ArrayLike | None = None,
    still: Sequence[str] = (),
    *,
    tolerance: float | str | None = None,
) -> Any:
    """Compute force (or torque) at the output per force (or torque) at the input, without losses.

    By the principle of virtual power the velocity of the input divided by that of the output;
    infinite where the output rests (a toggle), 0 where the input does (a dead point), NaN where the
    ratio is not determined. `output` is a coordinate, or a frame with a `direction` (3,) in the
    ground frame in which it pushes. `still` names other inputs that do not move. `tolerance` and
    errors are as those of `compute_loop_jacobian`.
    """
    q = read_q(system, q)
    closure = Closure(system)
    i = find_angle_or_slide(system, input)
    others = [find_angle_or_slide(system, n) for n in read_names(still, "still")]
    kind, name = _find_output(system, output)
    if (kind == "frame") != (direction is not None):
        raise InputError(
            f"output {name!r} is a {kind}: "
            + ("give a direction" if kind == "frame" else "leave the direction out")
        )
    push = np.zeros(3) if direction is None else read_reals(direction, "direction")
    if kind == "frame" and (push.shape != (3,) or not np.linalg.norm(push) > 0.0):
        raise InputError(f"direction is {direction!r}; it must be three numbers, not all zero")
    out = np.full(q.shape[:-1], np.nan)
    for k in np.ndindex(out.shape):
        motion = compute_allowed_velocities(closure, q[k]) * closure.unit[:, None]
        if others:
            rates = motion[others] / closure.unit[others, None]
            motion = motion @ Spectrum(rates, 1.0).compute_null_space(Level.CLOSED)
        far = (
            motion[find_angle_or_slide(system, name)]
            if kind == "joint"
            else (push / np.linalg.norm(push) @ jacobian(system, q[k], name)[:3] @ motion)
        )
        along = Spectrum(np.vstack([motion[i] / closure.unit[i], far]), 1.0).compute_row_space(
            Level.CLOSED
        )
        if along.shape[1] != 1:
            continue
        near = motion[i] @ along[:, 0]
        far = far @ along[:, 0]
        out[k] = near / far if abs(far) > 1e-13 * abs(near) else math.inf
    return float(out) if out.ndim == 0 else out


def find_dead_points(path: Path, input: str) -> tuple[Event, ...]:
    """Find the dead points of a path, where `input` reverses and cannot drive the mechanism."""
    find_angle_or_slide(path.system, input)
    return tuple(e for e in path.extremes if e.coordinate == input)


# ---- pressure and transmission angles


def compute_pressure_angle(
    system: Model,
    q: ConfigurationLike,
    joint: str,
    coupler: str | None = None,
    output: str | None = None,
) -> Any:
    """Compute the pressure angle (...) at a joint, in [0, pi/2].

    It is between the force that the coupler transmits and the direction in which the output can
    move.

    `joint` connects the coupler, which pulls along the line to its other joint (a two-force
    member), and the output link, whose other joint is a revolute or prismatic one and says which
    way the point can go. `coupler` and `output` name these other joints; they need not be given
    where there is one each. `output` also says which of the two bodies is the output link (default:
    the one nearer to the ground). 0 is best, pi/2 is stuck. Source: Alt, *Werkstattstechnik* 1932.
    Errors: `UnsupportedError`, `InputError`, `UnknownNameError`.
    """
    far, near = _find_dyad(system, joint, coupler, output)
    q = read_q(system, q)
    flat = q.reshape(-1, system.nq)
    refuse_open_loops(Closure(system).evaluate_many_points(flat, False)[0])
    p = _compute_joint_pose(system, q, joint)[..., :3, 3]
    a = _compute_joint_pose(system, q, far)[..., :3, 3]
    base = _compute_joint_pose(system, q, near)
    axis = base[..., :3, 2]
    kind = _find_joint_kind(system, near)
    way = axis if kind == P else np.cross(axis, p - base[..., :3, 3])
    pull = p - a
    across = np.linalg.norm(np.cross(pull, way), axis=-1)
    angle = np.arctan2(across, np.abs(np.sum(pull * way, axis=-1)))
    return float(angle) if angle.ndim == 0 else angle


@explain_errors
def compute_transmission_angle(
    system: Model,
    q: ConfigurationLike,
    joint: str,
    coupler: str | None = None,
    output: str | None = None,
) -> Any:
    """Compute the transmission angle (...) at a joint, in [0, pi/2].

    It is between the coupler and the output link: pi/2 less the pressure angle.

    Where the output link slides, the angle between the coupler and the normal of the slide. pi/2 is
    best, below about 40 degrees a linkage runs badly, 0 is stuck. Arguments as in `compute_pressure_angle`.
    """
    return 0.5 * math.pi - compute_pressure_angle(system, q, joint, coupler, output)


def _find_joint_kind(system: Model, name: str) -> int | None:
    """Return R or P for a joint with one turn or one slide, else None."""
    joint = system.structure.joints[name]
    primitives = joint.type.layout(system.dim, system._mechanism.bodies[joint.child].particle)[1]
    return primitives[0].kind if len(primitives) == 1 and primitives[0].kind in (R, P) else None


def _find_dyad(
    system: Model, joint: str, coupler: str | None, output: str | None
) -> tuple[str, str]:
    """Return the other joints of the coupler and of the output link."""
    joints = system.structure.joints
    for name in (joint, coupler, output):
        if name is not None and name not in joints:
            raise UnknownNameError("joint", name, system.joint_names, system.name)
    ends = {joints[joint].parent, joints[joint].child}
    if system.body_names[0] in ends:
        raise InputError(
            f"joint {joint!r} is on the ground; it must connect the coupler and the output link"
        )
    at: dict[str, list[str]] = {b: [] for b in ends}
    for other in joints.values():
        for body in {other.parent, other.child} & ends:
            if other.name != joint:
                at[body].append(other.name)
    if output is None:
        ground = system.body_names[0]
        grounded = [
            (b, n)
            for b, names in at.items()
            for n in names
            if ground in (joints[n].parent, joints[n].child)
        ]
        if len(grounded) != 1:
            raise UnsupportedError(
                f"joint {joint!r} has {len(grounded)} bodies with a joint to the ground beside it; "
                "name the other joints: coupler=..., output=..."
            )
        output = grounded[0][1]
    link = next((b for b in ends if output in at[b]), None)
    if link is None or _find_joint_kind(system, output) is None:
        raise InputError(
            f"{output!r} must be a revolute or prismatic joint of a body that {joint!r} connects"
        )
    rest = [n for b in ends - {link} for n in at[b]]
    if coupler is None and len(rest) != 1:
        raise UnsupportedError(
            f"the coupler has {len(rest)} other joints: {', '.join(rest)}; name one: coupler=..."
        )
    if coupler is not None and coupler not in rest:
        raise InputError(
            f"{coupler!r} is not a joint of the coupler; its joints are: {', '.join(rest)}"
        )
    return coupler or rest[0], output


def _compute_joint_pose(system: Model, q: Array, name: str) -> Array:
    """Compute the pose (..., 4, 4) of frame F of a joint."""
    joint = system.structure.joints[name]
    return fk(system, q, joint.parent) @ joint.X_PF.evaluate_pose(system.structure.parameters)
