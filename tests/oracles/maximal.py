"""The equations of a system in maximal coordinates, in numpy: residual, Jacobian by the twists of
the bodies.

Poses are (..., n_b, 4, 4), of all bodies but the ground. They move by twists [v; w] with the axes
of the ground, v the velocity of the origin of the body's frame: r + v and exp(w) R; columns are in
the order of `maximal_velocity_names`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import System, spatial
from kempe.arrays import read_reals
from kempe.errors import InputError
from kempe.forward.maximal import read_poses
from kempe.model.configurations import read_start
from kempe.spatial import Array
from oracles import pairs
from oracles.maximal_form import (
    coordinates_of,
    form_of,
    maximal_velocity_names,
    motion_in,
    off_by,
    pose_in,
)


def maximal_row_names(system: System) -> list[tuple[str, str]]:
    """For each equation the name of its joint, constraint or coordinate, and which of its rows it
    is.
    """
    form = form_of(system)
    out = [(p.name, row) for p in form.pairs for row in p.names] + [
        (r.name, "relation") for r in form.relations
    ]
    return out + [(joint.name, f"own r{axis}") for joint, _ in form.balls for axis in "xyz"]


def maximal_residual(system: System, poses: ArrayLike, near: Any = None) -> Array:
    """How far the poses violate each equation (..., m_c), in metres and radians.

    Poses do not tell full turns. Where a coupling depends on them, they are those nearest to the
    configuration `near`; without it, those that fit best.
    """
    form = form_of(system)
    poses = read_poses(system, poses)
    near = None if near is None else read_start(system, near)
    values = [pair.rows(pose_in(system, pair, poses))[0] for pair in form.pairs]
    if form.relations:
        read = coordinates_of(system, poses, near)[0]
        values.append(np.stack([off_by(r, read, near is None) for r in form.relations], axis=-1))
    values += [
        pairs.quaternion_rows(pose_in(system, joint, poses), quat)[0] for joint, quat in form.balls
    ]
    return np.concatenate([np.zeros((*poses.shape[:-3], 0)), *values], axis=-1)


def maximal_jacobian(system: System, poses: ArrayLike, near: Any = None) -> Array:
    """Derivatives (..., m_c, n) of the residual by the twists of the bodies, axes of the ground; n
    = 6 n_b in space.
    """
    form = form_of(system)
    poses = read_poses(system, poses)
    near = None if near is None else read_start(system, near)
    rows = [
        pair.rows(pose_in(system, pair, poses))[1] @ motion_in(system, pair, poses)
        for pair in form.pairs
    ]
    if form.relations:
        rates = coordinates_of(system, poses, near)[1]
        rows.append(
            np.stack([sum(m * rates[c] for c, m in r.terms) for r in form.relations], axis=-2)
        )
    for joint, quat in form.balls:
        rows.append(
            pairs.quaternion_rows(pose_in(system, joint, poses), quat)[1]
            @ motion_in(system, joint, poses)
        )
    return np.concatenate(
        [np.zeros((*poses.shape[:-3], 0, len(maximal_velocity_names(system)))), *rows], axis=-2
    )


def maximal_integrate(system: System, poses: ArrayLike, v: ArrayLike) -> Array:
    """Poses reached from `poses` by the twists `v` (..., n) in one unit of time: r + v and exp(w)
    R.
    """
    poses = read_poses(system, poses)
    v = read_reals(v, "v")
    n = len(maximal_velocity_names(system))
    if v.shape[-1:] != (n,):
        raise InputError(
            f"v has shape {v.shape}; {system.name} has {n} velocities of bodies: (..., {n})"
        )
    out = np.array(
        np.broadcast_to(
            poses, (*np.broadcast_shapes(poses.shape[:-3], v.shape[:-1]), *poses.shape[-3:])
        )
    )
    for i, selector in enumerate(form_of(system).selectors[1:]):
        twist = v @ selector.T
        out[..., i, :3, 3] += twist[..., :3]
        out[..., i, :3, :3] = spatial.exp_so3(twist[..., 3:]) @ out[..., i, :3, :3]
    return out
