"""Maximal coordinates: every body on its own, as n_b poses (r, R), held together by constraint equations.

The other way to say where a system is, next to q. Poses are (..., n_b, 4, 4): those of all bodies but the ground, in
the order of `system.body_names[1:]`. They move by twists [v; w] with the axes of the ground: v is the velocity of the
origin of the body's frame, so r + v and exp(w) R. A body has 6 of these numbers, 3 in the plane (vx, vy, wz); a
particle has 3, in the plane 2, and its rotation is the identity. Columns of the Jacobian are in this order, body by
body (`maximal_velocity_names`).

Equations: for every joint, in the tree or not, the rows that its type takes away, in axes of its frame F; then
declared constraints; then one for each coordinate that follows others or is held, and for each relation. A joint that
holds nothing along fixed axes (a turn about x, a slide along z, a turn about y) has six rows, three in the plane: the
least by which any of its coordinates miss the pose. As many of them as it has freedoms follow from the others.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.calls import explained, numbers, together
from kempe.errors import InputError
from kempe.kinematics import pairs
from kempe.kinematics.configuration import as_start
from kempe.kinematics.forward import fk
from kempe.kinematics.maximal_form import (
    coordinates_of,
    find_turns,
    form_of,
    maximal_velocity_names,
    motion_in,
    off_by,
    pose_in,
)
from kempe.reals import reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

TOLERANCE = 1e-6
"""Metres and radians by which poses may violate a joint and still be read."""
CLOSED = 1e-10
"""Largest residual, in metres and radians, of a projection that counts as reached."""
STEPS = 100
"""Most steps of a projection."""
STEP_LIMIT = 0.5
"""Largest part of a step: radians, or typical links."""


@explained
def to_maximal(system: System, q: Any) -> Array:
    """Poses (..., n_b, 4, 4) of all bodies but the ground; those of the tree, where loops are open."""
    return np.ascontiguousarray(fk(system, q)[..., 1:, :, :])


def maximal_row_names(system: System) -> list[tuple[str, str]]:
    """For each equation the name of its joint, constraint or coordinate, and which of its rows it is."""
    form = form_of(system)
    out = [(p.name, row) for p in form.pairs for row in p.names] + [(r.name, "relation") for r in form.relations]
    return out + [(joint.name, f"own r{axis}") for joint, _ in form.balls for axis in "xyz"]


def maximal_residual(system: System, poses: ArrayLike, near: Any = None) -> Array:
    """How far the poses violate each equation (..., m_c), in metres and radians.

    Poses do not tell full turns. Where a coupling depends on them, they are those nearest to the configuration
    `near`; without it, those that fit best.
    """
    form, poses = form_of(system), _checked(system, poses)
    values = [pair.rows(pose_in(system, pair, poses))[0] for pair in form.pairs]
    if form.relations:
        read = coordinates_of(system, poses, near)[0]
        values.append(np.stack([off_by(r, read, near is None) for r in form.relations], axis=-1))
    values += [pairs.quaternion_rows(pose_in(system, joint, poses), quat)[0] for joint, quat in form.balls]
    return np.concatenate([np.zeros((*poses.shape[:-3], 0)), *values], axis=-1)


def maximal_jacobian(system: System, poses: ArrayLike, near: Any = None) -> Array:
    """Derivatives (..., m_c, n) of the residual by the twists of the bodies, axes of the ground; n = 6 n_b in space."""
    form, poses = form_of(system), _checked(system, poses)
    rows = [pair.rows(pose_in(system, pair, poses))[1] @ motion_in(system, pair, poses) for pair in form.pairs]
    if form.relations:
        rates = coordinates_of(system, poses, near)[1]
        rows.append(np.stack([sum(m * rates[c] for c, m in r.terms) for r in form.relations], axis=-2))
    for joint, quat in form.balls:
        rows.append(pairs.quaternion_rows(pose_in(system, joint, poses), quat)[1] @ motion_in(system, joint, poses))
    return np.concatenate([np.zeros((*poses.shape[:-3], 0, len(maximal_velocity_names(system)))), *rows], axis=-2)


def maximal_integrate(system: System, poses: ArrayLike, v: ArrayLike) -> Array:
    """Poses reached from `poses` by the twists `v` (..., n) in one unit of time: r + v and exp(w) R."""
    poses, v = _checked(system, poses), reals(v, "v")
    out = np.array(np.broadcast_to(poses, (*np.broadcast_shapes(poses.shape[:-3], v.shape[:-1]), *poses.shape[-3:])))
    for i, selector in enumerate(form_of(system).selectors[1:]):
        twist = v @ selector.T
        out[..., i, :3, 3] += twist[..., :3]
        out[..., i, :3, :3] = spatial.exp_so3(twist[..., 3:]) @ out[..., i, :3, :3]
    return out


@explained
def from_maximal(system: System, poses: ArrayLike, near: Any = None, tolerance: float = TOLERANCE) -> Array:
    """Configuration (..., nq) of the poses (..., n_b, 4, 4), each coordinate read off where its joint's bodies are.

    Angles are those nearest to the configuration `near` (default: `system.mid`), and so are the signs of quaternions;
    a driver has made the full turns that those which follow it tell. Limits are not looked at.
    Errors: `InputError` for poses that violate a joint, a constraint or a coupling by more than `tolerance` (metres
    or radians), naming it and by how much, and for matrices that are no poses.
    """
    form, poses = form_of(system), _checked(system, poses)
    near = None if near is None else as_start(system, near)
    _refuse_no_poses(system, poses, tolerance)
    for pair in form.pairs:
        _refuse_far(form.said[pair.name], pair.rows(pose_in(system, pair, poses))[0], pair.names, tolerance)
    for joint, quat in form.balls:
        turned = pairs.quaternion_rows(pose_in(system, joint, poses), quat)[0]
        _refuse_far(f"{form.said[joint.name]} is locked", turned, ("rx", "ry", "rz"), tolerance)
    values = coordinates_of(system, poses, near)[0]
    find_turns(form, values, tolerance)
    for r in form.relations:
        unit = ("rx",) if r.turns else ("x",)
        off = off_by(r, values, False)[..., None]
        _refuse_far(f"coordinate {r.name!r}, which is tied to others or held,", off, unit, tolerance)
    lead = together({"poses": poses.shape[:-3], "near": () if near is None else near.shape[:-1]})
    q = np.empty((*lead, system.nq))
    for i, name in enumerate(system.coordinate_names):
        q[..., i] = values[name]
    return q


# ---- onto the constraints


def project_maximal(
    system: System, poses: ArrayLike, near: Any = None, tolerance: float = CLOSED
) -> tuple[Array, Array]:  # fmt: skip
    """Poses that satisfy all equations, near the given ones, and whether that was reached (...) within `tolerance`.

    Gauss-Newton steps of least norm on SE(3)^n, damped in proportion to the residual (Levenberg, 1944; Fan, Yuan,
    2005), so redundant equations are no obstacle; lengths are measured in typical links. What was not reached is the
    nearest that was found. Rotations are made orthonormal first, and planar poses flat. Not finite in, not reached.
    """
    from kempe.kinematics.loops import characteristic_length

    given = _checked(system, poses)
    count = math.prod(given.shape[:-3])  # numpy's -1 cannot where some axis is empty
    flat = _rigid(system, given).reshape(count, *given.shape[-3:])
    length = characteristic_length(system)
    scale = np.array([length if n.rpartition(".")[2][0] == "v" else 1.0 for n in maximal_velocity_names(system)])
    start = None if near is None else np.broadcast_to(as_start(system, near), (*given.shape[:-3], system.nq))
    converged = np.zeros(count, dtype=bool)
    for k in np.flatnonzero(np.isfinite(flat).all(axis=(1, 2, 3))):
        at = None if start is None else start.reshape(count, system.nq)[k]
        flat[k], converged[k] = _projected(system, flat[k], at, scale, tolerance)
    return flat.reshape(given.shape), converged.reshape(given.shape[:-3])


def _projected(system: System, X: Array, near: Array | None, scale: Array, tolerance: float) -> tuple[Array, bool]:
    r = maximal_residual(system, X, near)
    damping = 1.0
    for _ in range(STEPS):
        size = float(np.linalg.norm(r))
        if size <= 1e-3 * tolerance or not np.isfinite(size):
            break
        U, s, V = np.linalg.svd(maximal_jacobian(system, X, near) * scale, full_matrices=False)
        step = -V.T @ (s / (s * s + damping * size) * (U.T @ r))
        step *= min(1.0, STEP_LIMIT / max(float(np.abs(step).max(initial=0.0)), STEP_LIMIT))
        new = maximal_integrate(system, X, scale * step)
        r_new = maximal_residual(system, new, near)
        if np.linalg.norm(r_new) < size:
            X, r, damping = new, r_new, max(0.1 * damping, 1e-6)
        elif (damping := 10.0 * damping) > 1e6:
            break
    return X, bool(np.abs(r).max(initial=0.0) <= tolerance)


def _rigid(system: System, poses: Array) -> Array:
    """The nearest poses that bodies of the system can have: rotations, flat ones in the plane, none of particles."""
    out = np.array(poses)
    fine = np.isfinite(out).all(axis=(-1, -2))
    if system.dim == 2:
        out[..., 2, 3] = 0.0
        out[..., :3, :3] = spatial.rot_z(np.arctan2(out[..., 1, 0], out[..., 0, 0]))
    else:
        U, _, V = np.linalg.svd(out[fine][..., :3, :3])
        U[..., :, 2] *= np.linalg.det(U @ V)[..., None]
        R = out[..., :3, :3]
        R[fine] = U @ V
    bodies = system.mechanism.bodies
    for i, body in enumerate(system.body_names[1:]):
        if bodies[body].particle:
            out[..., i, :3, :3] = np.eye(3)
    return out


# ---- what is refused


def _checked(system: System, poses: ArrayLike) -> Array:
    array = numbers(poses, "poses")
    n = len(system.body_names) - 1
    if array.ndim < 3 or array.shape[-3:] != (n, 4, 4):
        raise InputError(
            f"poses have shape {array.shape}; {system.name} needs (..., {n}, 4, 4): all bodies but the ground"
        )
    return array


def _refuse_no_poses(system: System, poses: Array, tolerance: float) -> None:
    R, p = poses[..., :3, :3], poses[..., :3, 3]
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    tilt = np.hypot(R[..., 2, 0], R[..., 2, 1]) + (R[..., 2, 2] < 0.0)
    bodies = system.mechanism.bodies
    for i, body in enumerate(system.body_names[1:]):
        subject = f"pose of body {body!r}"
        if not np.isfinite(poses[..., i, :, :]).all():
            raise InputError(f"{subject} is not finite")
        if np.any(off[..., i] > tolerance) or np.any(np.linalg.det(R[..., i, :, :]) < 0.0):
            raise InputError(f"{subject}: its rotation is none (orthonormal, determinant +1)")
        if bodies[body].particle and np.any(np.abs(R[..., i, :, :] - np.eye(3)) > tolerance):
            raise InputError(f"{subject}: a particle has no orientation; its rotation must be the identity")
        if system.dim == 2 and np.any(np.maximum(np.abs(p[..., i, 2]), tilt[..., i]) > tolerance):
            raise InputError(f"{subject} leaves the plane")


def _refuse_far(subject: str, value: Array, names: tuple[str, ...], tolerance: float) -> None:
    """Refuse residuals (..., m) above the tolerance, by their lengths in metres and radians."""
    angular = np.array([n.startswith("r") or n == "x.y" for n in names], dtype=bool)
    parts = [(np.linalg.norm(value[..., mask], axis=-1).max(initial=0.0), unit)
             for mask, unit in ((~angular, "m"), (angular, "rad"))]  # fmt: skip
    if any(size > tolerance for size, _ in parts):
        said = " and ".join(f"{size:.3g} {unit}" for size, unit in parts if size > tolerance)
        raise InputError(f"the poses violate {subject} by {said}; at most {tolerance:g} is read; project them first")
