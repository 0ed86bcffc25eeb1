"""Derivatives of answers of the numerical inverse model with respect to their targets."""

from __future__ import annotations

import numpy as np

from kempe.errors import InputError
from kempe.kinematics.forward import fk, jacobian
from kempe.singular_values import svd
from kempe.solvers.common.targets import Z_AXIS, frame_of
from kempe.solvers.one_frame.solution import Solution
from kempe.spatial import Array

AT_LIMIT = 1e-9
"""How near to a limit a coordinate is at it."""
RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest count as zero when it is checked whether
limits take a freedom."""


def derivative(solution: Solution) -> Array:
    """dq (..., nv, 6) for a twist [linear; angular] of the target, ground axes, at its origin; NaN
    where not reached.

    By the implicit function theorem, the pseudoinverse of the rows of the Jacobian that the task
    reads: least squares of the velocities where the chain has more freedoms than those. Coordinates
    at a limit stay, and have rows of zeros, where the others span the same motions. Errors:
    `InputError` where a single target was not reached.
    """
    task = solution.task
    good = np.asarray(solution.success)
    if not good.ndim and not good:
        raise InputError(f"the target was not reached, so q does not follow it: {solution.status}")
    system = task.system
    chain = task.chain
    q = np.where(good[..., None], solution.q, system.neutral)
    J = jacobian(system, q, task.frame)[..., chain.v_index]
    R = fk(system, q, task.frame)[..., :3, :3]
    if task.axis != Z_AXIS:
        R = R @ frame_of(np.array(task.axis))
    S = np.zeros(
        (*R.shape[:-2], 6, 6)
    )  # from ground axes to those rows in the axes of the tip that count
    S[..., :3, :3] = S[..., 3:, 3:] = np.swapaxes(R, -1, -2)
    S *= np.array(task.mask, dtype=float)[:, None]
    J = np.where(system.upper > system.lower, 1.0, 0.0)[chain.v_index] * (
        S @ J
    )  # what has no room moves nothing
    x = np.full((*q.shape[:-1], system.nv), np.nan)
    v = system.structure.layout.vector_v
    x[..., v] = q[..., system.structure.layout.vector_q]
    held = ((x <= system.lower + AT_LIMIT) | (x >= system.upper - AT_LIMIT))[..., chain.v_index]
    free = np.where(held[..., None, :], 0.0, J)
    stay = held & (_rank(free, J) == _rank(J, J))[..., None]
    inverse = np.where(
        stay[..., None], 0.0, np.linalg.pinv(np.where(stay[..., None, :], 0.0, J), rcond=1e-12)
    )
    out = np.zeros((*q.shape[:-1], system.nv, 6))
    out[..., chain.v_index, :] = inverse @ S
    return np.where(good[..., None, None], out, np.nan)


def _rank(J: Array, whole: Array) -> np.ndarray:
    """Ranks (...) of Jacobians, counted against the largest singular value of the whole ones."""
    most = svd(whole, compute_uv=False).max(axis=-1, initial=0.0)
    return (svd(J, compute_uv=False) > RANK_TOLERANCE * most[..., None]).sum(axis=-1)
