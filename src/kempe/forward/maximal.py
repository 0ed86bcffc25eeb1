"""Maximal coordinates: each body has its own pose, and all joints are constraints.

They are a system like any other: its tree is a free joint for each body, its loops are all the
joints. So forward kinematics, closure errors, mobility and assembly of this system are the general
ones: its count is
6 n_b - m_c, and to assemble it is to project bodies onto the constraints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arguments import explain_errors, numbers
from kempe.errors import InputError
from kempe.forward.fk import fk
from kempe.model.characteristic_length import choose_origin
from kempe.model.configurations import find_home, make_q, read_q
from kempe.model.model import keep_answers
from kempe.poses import correct_rotations, read_pose_array
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model, SystemType


@explain_errors
@keep_answers
def maximal(system: SystemType) -> SystemType:
    """Return the system in maximal coordinates: a free joint for each body, all joints cut.

    Parameters
    ----------
    system
        System in joint coordinates.

    Returns
    -------
    System
        System whose configuration is the poses of the bodies, followed by the configuration of
        `system`. Couplings, locks, limits, declared constraints and parameters are those of
        `system`.

    See Also
    --------
    maximal_q : its configurations.

    Notes
    -----
    Free joints have the names of their bodies, with a number where a joint has that name. Particles
    have positions only. Where the system is far from the origin of the ground, positions are
    measured from a point in its midst. Postures are those of the system; without any, 'closed' is
    its home configuration.

    Examples
    --------
    >>> import kempe
    >>> kempe.convert.maximal(kempe.load("two_link")).name
    'two_link, maximal'
    """
    m = system.mechanism
    joints = m.joints
    m.joints = {}
    m.name = f"{m.name}, maximal"
    m.bodies = {body: m.bodies[body] for body in system.body_names}
    taken = {*joints, *m.constraints}
    origin = choose_origin(system)[: system.dim]
    for body in system.body_names[1:]:
        name = body
        number = 2
        while name in taken:
            name = f"{body}_{number}"
            number = number + 1
        m.free(name, m.ground, body, at=origin)
        taken.add(name)
    m.joints |= {name: replace(joint, cut=True) for name, joint in joints.items()}
    at = {"closed": find_home(system)} | {
        name: make_q(system, name) for name in system.structure.posture_names
    }
    m.postures = {}
    names = type(system)(m).coordinate_names
    for name, q in at.items():
        m.posture(
            name,
            dict(
                zip(
                    names, _join_coordinates(system, q, to_maximal(system, q)).tolist(), strict=True
                )
            ),
        )
    return type(system)(m)


@explain_errors
def to_maximal(system: Model, q: ArrayLike | Mapping[str, ArrayLike]) -> Array:
    """Compute the poses of all bodies but the ground.

    Parameters
    ----------
    system
        System of the configurations.
    q
        Configurations (..., nq) in radians and metres, or values by coordinate name.

    Returns
    -------
    Array
        Poses (..., n_b, 4, 4) in the ground frame. Where loops are open, they are those along the
        spanning tree.

    See Also
    --------
    from_maximal : the way back.
    """
    return np.ascontiguousarray(fk(system, q)[..., 1:, :, :])


@explain_errors
def maximal_q(
    system: Model,
    q: ArrayLike | Mapping[str, ArrayLike] | None = None,
    poses: ArrayLike | None = None,
) -> Array:
    """Return configurations of `maximal(system)`.

    Parameters
    ----------
    system
        System in joint coordinates.
    q
        Configurations (..., nq) of its joints (default: home).
    poses
        Poses (..., n_b, 4, 4) of all bodies but the ground (default: those at `q`).

    Returns
    -------
    Array
        Configurations of the maximal system. Loops and joints need not be closed.
    """
    q = find_home(system) if q is None else read_q(system, q)
    return _join_coordinates(
        system, q, to_maximal(system, q) if poses is None else read_poses(system, poses)
    )


def _join_coordinates(system: Model, q: Array, poses: Array) -> Array:
    """Join the coordinates of the bodies' free joints at `poses` with the coordinates `q`."""
    points = [system.mechanism.bodies[b].particle for b in system.body_names[1:]]
    poses = poses - np.pad(choose_origin(system)[:, None], ((0, 1), (3, 0)))
    parts = [
        x
        for i, p in enumerate(points)
        for x in list_pose_coordinates(poses[..., i, :, :], system.dim, p)
    ]
    lead = np.broadcast_shapes(poses.shape[:-3], q.shape[:-1])
    return np.concatenate([np.broadcast_to(x, (*lead, x.shape[-1])) for x in (*parts, q)], axis=-1)


def list_pose_coordinates(X: Array, dim: int, particle: bool) -> list[Array]:
    """List the coordinates of a free joint at the pose X (..., 4, 4), as arrays."""
    p = X[..., :dim, 3]
    R = X[..., :3, :3]
    if particle:
        return [p]
    return [
        p,
        spatial.matrix_to_quat_wxyz(R)
        if dim == 3
        else np.arctan2(R[..., 1, 0], R[..., 0, 0])[..., None],
    ]


def read_poses(system: Model, poses: ArrayLike) -> Array:
    """Read poses of all bodies but the ground as an array.

    Errors: `InputError` for other shapes.
    """
    array = numbers(read_pose_array(poses, "poses"), "poses")
    n = len(system.body_names) - 1
    if array.ndim < 3 or array.shape[-3:] != (n, 4, 4):
        raise InputError(
            f"poses have shape {array.shape}; {system.name} needs (..., {n}, 4, 4): all bodies but "
            "the ground"
        )
    return correct_rotations(array, "poses")
