"""Joint coordinates from poses of bodies: the inverse of maximal coordinates.

Each joint is read alone; full turns are then chosen so that dependent coordinates agree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arguments import broadcast_shapes, explain_errors
from kempe.assemble.assemble import bind_assembler
from kempe.assemble.bound import LOOSEST, TOLERANCE
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.equations.closure_rows import evaluate_constraints, list_row_names, pack_full_loops
from kempe.equations.judge import compute_coordinate_value
from kempe.errors import InputError
from kempe.forward.maximal import list_pose_coordinates, maximal, maximal_q, read_poses
from kempe.joints import JointType, P, Q
from kempe.model.configurations import compute_mid_configuration, read_start, refuse_large_numbers
from kempe.model.implicit_form import (
    find_implicit_form,
    find_screw_pitch,
    has_slide_along_z,
    turn_flat_frame,
)
from kempe.model.model import Model
from kempe.poses import Placement, check_poses, place
from kempe.spatial import Array
from kempe.units import make_tolerance

if TYPE_CHECKING:
    from kempe.model.model import Model

READ = 1e-6
"""Metres and radians by which poses may violate a joint and still be read; see `make_tolerance`."""
STARTS = 64
"""Starts from which the coordinates of a joint are searched for that are not read off in closed
form."""
LESS = 0.9
"""Part of the residual of the first of these starts, up to which what another one finds is
better."""
ANGLES_SINGULAR = 1e-9
"""Cosine of ry below which the turns about z and x of three angles are not distinguished."""
TURNS = (0, 32, 6, 2, 1)
"""Full turns to each side that are tried of 0, 1, 2, ... coordinates where what depends on them
tells their turns."""
FULL_TURN = 2.0 * math.pi


@explain_errors
def from_maximal(
    system: Model,
    poses: ArrayLike,
    start: ArrayLike | Mapping[str, ArrayLike] | str | None = None,
    tolerance: float | None = None,
) -> Array:
    """Compute configurations from the poses of all bodies but the ground.

    Parameters
    ----------
    system
        System of the configurations.
    poses
        Poses (..., n_b, 4, 4) in the ground frame.
    start
        Configuration (..., nq) to which angles and signs of quaternions are nearest (default:
        `System.mid`).
    tolerance
        Largest violation of a joint, constraint or coupling in the unit of the system
        or radians (default: 1e-6 m and 1e-6 rad).

    Returns
    -------
    Array
        Configurations (..., nq). Limits and inequalities are not checked.

    Raises
    ------
    InputError
        If poses violate a joint, a constraint or a coupling, with its name and by how much, or a
        matrix is no pose.

    See Also
    --------
    to_maximal : the way back.

    Notes
    -----
    A coordinate that others follow has made the full turns that the followers tell.

    Examples
    --------
    >>> import kempe
    >>> robot = kempe.load("two_link")
    >>> poses = kempe.convert.to_maximal(robot, [0.1, 0.2])
    >>> kempe.convert.from_maximal(robot, poses).round(6)
    array([0.1, 0.2])
    """
    poses = read_poses(system, poses)
    linear, tolerance = (
        make_tolerance(READ, system.unit) if tolerance is None else (tolerance, tolerance)
    )
    start = None if start is None else read_start(system, start)
    if start is not None:
        refuse_large_numbers(system, start, "start")
    _refuse_no_poses(system, poses, linear, tolerance)
    lead = broadcast_shapes(
        {"poses": poses.shape[:-3], "start": () if start is None else start.shape[:-1]}
    )
    joints = system.mechanism.joints
    read = read_joints(
        system, poses, compute_mid_configuration(system) if start is None else start, tolerance
    )
    for name, (_, length, angle) in read.items():
        _refuse_violations(
            f"joint {name!r} ({joints[name].type.type_name})",
            {"m": length, "rad": angle},
            linear,
            tolerance,
        )
    values = {
        n: x
        for name, (own, *_) in read.items()
        for n, x in _name_coordinates(system, name, own).items()
    }
    _refuse_held_rotations(system, values, tolerance)
    relations = _list_relations(system)
    add_full_turns(relations, values, tolerance)
    for r in relations:
        off = {"rad" if r.turns else "m": measure_violation(r, values)}
        _refuse_violations(
            f"coordinate {r.name!r}, which is tied to others or held,", off, linear, tolerance
        )
    q = np.empty((*lead, system.nq))
    for i, name in enumerate(system.coordinate_names):
        q[..., i] = values[name]
    _refuse_constraints(system, poses, q, linear, tolerance)
    return q


# ---- coordinates of each joint


def read_joints(
    system: Model, poses: Array, near: Array, tolerance: float = TOLERANCE
) -> dict[str, tuple[Array, Array, Array]]:
    """Read the coordinates (..., n) of each joint from poses of bodies, near a configuration.

    The values that follow, a length and an angle (...), are the errors of the joint.

    The second is a length, the third an angle (...): from where they put frame M to where it is.
    """
    m = system.mechanism
    number = system.body_names.index
    lead = np.broadcast_shapes(poses.shape[:-3], near.shape[:-1])
    alike: dict[tuple[JointType, bool], list[Joint]] = {}
    for joint in m.joints.values():
        alike.setdefault((joint.type, m.bodies[joint.child].particle), []).append(joint)
    out: dict[str, tuple[Array, Array, Array]] = {}
    for (
        kind,
        particle,
    ), joints in alike.items():  # what joints of one kind have in common is done once
        X = np.empty((len(joints), *lead, 4, 4))
        at: list[Array] = []
        for k, joint in enumerate(joints):
            ends: list[Array] = []
            for body, X_BE in ((joint.parent, joint.X_PF), (joint.child, joint.X_CM)):
                X_BE = X_BE.evaluate_pose(m.parameters)
                i = number(body)
                X_BE = (
                    turn_flat_frame(X_BE) if has_slide_along_z(kind, system.dim, particle) else X_BE
                )
                ends.append(poses[..., i - 1, :, :] @ X_BE if i else X_BE)
            X[k] = spatial.inverse(ends[0]) @ ends[1]
            values = [
                compute_coordinate_value(system, near, n)
                for n in system.structure.coordinates_of_joint(joint.name)
            ]
            at.append(
                np.broadcast_to(
                    np.stack(values, axis=-1) if values else near[..., :0], (*lead, len(values))
                )
            )
        found = fit_joint(kind, system.dim, particle, X, np.stack(at), tolerance)
        out |= {
            joint.name: (own, length, angle)
            for joint, own, length, angle in zip(joints, *found, strict=True)
        }
    return {name: out[name] for name in m.joints}


def read_configurations(system: Model, poses: Array, near: Array) -> Array:
    """Read configurations (..., nq) from poses of bodies, near others (..., nq).

    The poses may violate joints.
    """
    values: dict[str, Array] = {}
    for name, (own, *_) in read_joints(system, poses, near).items():
        values |= _name_coordinates(system, name, own)
    out = np.empty((*np.broadcast_shapes(poses.shape[:-3], near.shape[:-1]), system.nq))
    for k, name in enumerate(system.coordinate_names):
        out[..., k] = values[name]
    return out


def _name_coordinates(system: Model, joint: str, own: Array) -> dict[str, Array]:
    """Return the coordinates of a joint by name."""
    return {n: own[..., i] for i, n in enumerate(system.structure.coordinates_of_joint(joint))}


def fit_joint(
    kind: JointType, dim: int, particle: bool, X: Array, near: Array, tolerance: float = TOLERANCE
) -> tuple[Array, Array, Array]:
    """Fit the coordinates (..., n) of a joint to the poses X (..., 4, 4) of frame M in F.

    Also returns the remaining error, a length and an angle.

    Of several the ones found from `near` (..., n). In the plane a joint that slides along z does so
    along x of X.
    """
    system, free, lengths = _isolate_joint(kind, dim, particle)
    lead = X.shape[:-2]
    n = len(free)
    own = near.shape[-1]
    pitch = find_screw_pitch(kind) if dim == 3 and not particle else None
    if pitch:
        near = X[..., 2, 3, None] / pitch  # the slide tells the turns
    start = np.concatenate([*list_pose_coordinates(X, dim, particle), near], axis=-1).reshape(
        math.prod(lead), system.nq
    )
    form = find_implicit_form(kind, dim, particle)
    bound = bind_assembler(system, free)
    tolerance = min(max(tolerance, TOLERANCE), LOOSEST)
    found, size, _ = bound.run(start, bound.no_pins, 1, tolerance=tolerance)
    far = size > tolerance
    if form is None and far.any():
        others, less, _ = bound.run(start[far], bound.no_pins, STARTS, tolerance=tolerance)
        found[far] = np.where((less < LESS * size[far])[:, None], others, found[far])
    angles = [
        n + k
        for a in ("yaw", "pitch", "roll")
        for k, how in (form.readings if form else ())
        if how == f"turn {a}"
    ]
    if angles:
        found[:, angles] = _choose_three_angles(
            X[..., :3, :3].reshape(-1, 3, 3), found[:, angles], start[:, angles]
        )
    off = evaluate_constraints(system, found, False)[0].reshape(*lead, len(lengths))
    sizes = [np.linalg.norm(off[..., rows], axis=-1) for rows in (lengths, ~lengths)]
    return found[:, n:].reshape(*lead, own), sizes[0], sizes[1]


@lru_cache(maxsize=256)
def _isolate_joint(
    kind: JointType, dim: int, particle: bool
) -> tuple[Any, tuple[str, ...], np.ndarray]:
    """Build a system of one body that a joint of this kind connects to the ground.

    Also returns the coordinates of the body's pose, and a mask of the rows that are lengths.
    """
    m = Mechanism("joint", dim)
    child = m.particle("M") if particle else m.body("M")
    m.free("M", m.ground, child)
    X = place(axis=(1.0, 0.0)) if has_slide_along_z(kind, dim, particle) else Placement()
    m.joints["joint"] = Joint("joint", kind, m.ground.name, child.name, X, X, cut=True)
    system = Model(m)
    names = tuple(n for n in system.coordinate_names if n.startswith("M."))
    return system, names, np.array([row in "xyz" for _, row in list_row_names(system)])


def _choose_three_angles(R: Array, angles: Array, near: Array) -> Array:
    """Choose the nearer of the two triples (N, 3) of angles about z, y', x'' of a rotation."""
    a, b, c = np.moveaxis(angles, -1, 0)
    locked = np.cos(b) < ANGLES_SINGULAR
    a = np.where(locked, near[:, 0], a)  # only a combination of a and c is determined
    rest = np.swapaxes(spatial.make_rotation(a, "z") @ spatial.make_rotation(b, "y"), -1, -2) @ R
    c = np.where(locked, np.arctan2(rest[:, 2, 1], rest[:, 1, 1]), c)
    # (2, N, 3)
    ways: Array = np.stack([[a, b, c], [a + np.pi, np.pi - b, c + np.pi]]).swapaxes(1, 2)
    ways += FULL_TURN * np.round((near - ways) / FULL_TURN)
    one: Array = ways[0]
    other: Array = ways[1]
    second: np.ndarray = np.linalg.norm(ways[1] - near, axis=-1) < np.linalg.norm(
        ways[0] - near, axis=-1
    )
    return np.where(second[:, None], other, one)


# ---- coordinates that depend on others, and full turns


class LinearRow(NamedTuple):
    """A linear relation: the sum of factor times coordinate is the offset.

    The dependent coordinate comes first, with factor 1.

    `turns` says that the dependent one is an angle, `free` that it is part of q. `periods` are
    those of the other terms that can turn fully, so that poses do not tell how far they have
    turned.
    """

    name: str
    terms: tuple[tuple[str, float], ...]
    offset: float
    turns: bool
    free: bool
    periods: tuple[tuple[str, float], ...]


def _list_relations(system: Model) -> list[LinearRow]:
    """List couplings, locks and relations as linear rows, without locked quaternions."""
    followers = system.structure.couplings
    turning: set[str] = set()
    balls: set[str] = set()
    for joint in system.mechanism.joints.values():
        names = system.structure.coordinates_of_joint(joint.name)
        steps = joint.type.layout(system.dim, system._mechanism.bodies[joint.child].particle)[1]
        slow = {
            p.coordinate
            for p in steps
            if p.kind == P and p.multiplier or not float(p.multiplier).is_integer()
        }
        turning |= {names[p.coordinate] for p in steps if p.coordinate not in slow and p.kind != Q}
        balls |= {n for p in steps if p.kind == Q for n in names[p.coordinate : p.coordinate + 4]}
    wide = {
        n: not high - low < FULL_TURN
        for n, (low, high) in zip(
            system.structure.velocity_names, system.structure.limits, strict=True
        )
    }
    rows = [
        (n, {f.source: f.multiplier} if f.source else {}, f.offset)
        for n, f in followers.items()
        if n not in balls
    ]
    rows += [(r.of, r.sources, r.offset) for r in system.structure.relations]
    return [
        LinearRow(
            n,
            ((n, 1.0), *((s, -m) for s, m in sources.items())),
            offset,
            n in turning,
            n not in followers,
            tuple(
                (s, -m) for s, m in sources.items() if s in turning and (wide[s] or n in followers)
            ),
        )
        for n, sources, offset in rows
    ]


def measure_violation(relation: LinearRow, values: dict[str, Array]) -> Array:
    """Compute the violation (...) of a linear relation."""
    return np.asarray(sum(m * values[n] for n, m in relation.terms) - relation.offset)


def _list_turn_counts(n: int) -> Array:
    """List the numbers of full turns (k, n) to try for n coordinates, small ones first."""
    most = TURNS[n] if n < len(TURNS) else 0
    found = sorted(product(range(-most, most + 1), repeat=n), key=lambda ks: sum(map(abs, ks)))
    return np.array(found, dtype=float).reshape(len(found), n)


def add_full_turns(relations: list[LinearRow], values: dict[str, Array], tolerance: float) -> None:
    """Add full turns to coordinates, so that the coordinates that depend on them agree.

    Turns of a driver are those that fit all that follows it; then relations choose for coordinates
    that drive nothing.
    """
    followers: dict[str, list[LinearRow]] = {}
    for r in relations:
        if not r.free and r.periods:
            followers.setdefault(r.terms[1][0], []).append(r)
    for driver, mine in followers.items():
        given = values[driver][..., None] + FULL_TURN * _list_turn_counts(1)[:, 0]
        off = [values[r.name][..., None] + r.terms[1][1] * given - r.offset for r in mine]
        good = [
            np.abs(_remove_full_turns(x, r.turns)) <= tolerance
            for x, r in zip(off, mine, strict=True)
        ]
        first = np.argmax(np.all(good, axis=0), axis=-1)[..., None]
        values[driver] = np.take_along_axis(given, first, axis=-1)[..., 0]
    for r in relations:
        moving = [(n, m) for n, m in r.periods if n not in followers]
        counts = _list_turn_counts(len(moving))
        off = measure_violation(r, values)[..., None] + FULL_TURN * (
            counts @ np.array([m for _, m in moving])
        )
        first = np.argmax(np.abs(_remove_full_turns(off, r.turns)) <= tolerance, axis=-1)
        for i, (n, _) in enumerate(moving):
            values[n] = values[n] + FULL_TURN * counts[first, i]
        off = measure_violation(r, values)
        values[r.name] = values[r.name] - off + _remove_full_turns(off, r.turns)


def _remove_full_turns(off: Array, turns: bool) -> Array:
    """Remove full turns from the violation of a relation of angles."""
    return off - FULL_TURN * np.round(off / FULL_TURN) if turns else off


# ---- poses that are refused


def _refuse_no_poses(system: Model, poses: Array, linear: float, tolerance: float) -> None:
    """Refuse matrices that are no poses, turned particles, and poses outside the plane."""
    R = poses[..., :3, :3]
    p = poses[..., :3, 3]
    tilt = np.hypot(R[..., 2, 0], R[..., 2, 1]) + (R[..., 2, 2] < 0.0)
    bodies = system.mechanism.bodies
    for i, body in enumerate(system.body_names[1:]):
        subject = f"pose of body {body!r}"
        check_poses(poses[..., i, :, :], subject, tolerance)
        if bodies[body].particle and np.any(np.abs(R[..., i, :, :] - np.eye(3)) > tolerance):
            raise InputError(
                f"{subject}: a particle has no orientation; its rotation must be the identity"
            )
        away, tilted = np.abs(p[..., i, 2]) > linear, tilt[..., i] > tolerance
        if system.dim == 2 and np.any(away | tilted):
            raise InputError(f"{subject} leaves the plane")


def _refuse_constraints(
    system: Model, poses: Array, q: Array, linear: float, tolerance: float
) -> None:
    """Refuse poses, with the configurations read off them, that violate a declared constraint."""
    if not system._mechanism.constraints:
        return
    other = maximal(system)
    loops = pack_full_loops(other, False)
    off = evaluate_constraints(other, maximal_q(system, q, poses), False)[0]
    units = loops.units
    for name, made in system._mechanism.constraints.items():
        rows: dict[str, list[int]] = {}
        for i, (n, what) in enumerate(loops.names):
            if n == name and what != "relation":
                rows.setdefault(units[i], []).append(i)
        sizes = {unit: np.linalg.norm(off[..., at], axis=-1) for unit, at in rows.items()}
        _refuse_violations(f"constraint {name!r} ({made.kind})", sizes, linear, tolerance)


def _refuse_held_rotations(system: Model, values: dict[str, Array], tolerance: float) -> None:
    """Refuse rotations that differ from those of locked quaternions."""
    for joint in system.mechanism.joints.values():
        names = [
            n
            for n in system.structure.coordinates_of_joint(joint.name)
            if n in system.structure.couplings
        ]
        for p in joint.type.layout(system.dim, system._mechanism.bodies[joint.child].particle)[1]:
            four = system.structure.coordinates_of_joint(joint.name)[
                p.coordinate : p.coordinate + 4
            ]
            if p.kind == Q and four[0] in names:
                quat = np.array([system.structure.couplings[n].offset for n in four])
                found = spatial.quat_wxyz_to_matrix(np.stack([values[n] for n in four], axis=-1))
                turn = spatial.log_so3(spatial.quat_wxyz_to_matrix(spatial.unit(quat)).T @ found)
                subject = f"joint {joint.name!r} ({joint.type.type_name}) is locked"
                _refuse_violations(
                    subject, {"rad": np.linalg.norm(turn, axis=-1)}, tolerance, tolerance
                )


def _refuse_violations(
    subject: str, sizes: Mapping[str, Array], linear: float, tolerance: float
) -> None:
    """Refuse violations `sizes` (...), by unit, that exceed the tolerance of lengths or of others."""
    parts = [
        (float(np.abs(x).max(initial=0.0)), unit, linear if unit == "m" else tolerance)
        for unit, x in sizes.items()
    ]
    beyond = [part for part in parts if part[0] > part[2]]
    if beyond:
        said = " and ".join(f"{size:.3g} {unit}".removesuffix(" 1") for size, unit, _ in beyond)
        most = " and ".join(
            dict.fromkeys(f"{most:g} {unit}".removesuffix(" 1") for _, unit, most in beyond)
        )
        raise InputError(
            f"the poses violate {subject} by {said}; at most {most} is read; project them first"
        )
