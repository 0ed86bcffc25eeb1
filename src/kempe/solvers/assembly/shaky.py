"""Velocities that lead to no motion where the equations touch along all of a motion, and those that
do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.closure_rows import evaluate
from kempe.singular_values import svd
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

DIFFERENCE = 1e-5
"""Step of the central differences of the Jacobian, in radians and characteristic lengths."""
VANISHES = 1e-6
"""Second derivatives below this count as zero."""


def moving(system: System, q: Array, left: Array, null_space: Array, scale: Array) -> Array:
    """The part (nv, d) of a null space (nv, p) of the scaled Jacobian at q (nq,) that motions have
    as velocities.

    `left` (rows, k) are the left null vectors. Along a motion at which the rank stays, the second
    derivatives of the equations vanish for `left`, a velocity and any of the null space; where
    these leave less than the null space, and as much as there are freedoms, the rest is shaky.
    Elsewhere the null space is returned as it is.
    """
    some = np.cos(np.arange(null_space.shape[1], dtype=float))[None]
    if not np.abs(_change(system, q, left, null_space, scale, some)).max() > VANISHES:
        return null_space
    blocks = _change(system, q, left, null_space, scale, np.eye(null_space.shape[1]))
    _, sizes, V = svd(blocks.reshape(-1, null_space.shape[1]))
    shaky = int(np.sum(sizes > VANISHES))
    if not 0 < shaky < null_space.shape[1]:
        return null_space
    from kempe.analysis.mobility.mobility import mobility

    if mobility(system, q).dof != null_space.shape[1] - shaky:
        return null_space
    return null_space @ V[shaky:].T


def _change(
    system: System, q: Array, left: Array, null_space: Array, scale: Array, along: Array
) -> Array:
    """Second derivatives (n, k, p) for left null vectors, combinations (n, p) of the null space,
    and the null space.
    """
    steps = DIFFERENCE * scale * (along @ null_space.T)
    J = evaluate(
        system, system.structure.layout.integrate(q, np.concatenate([steps, -steps])), True, True
    )[1]
    return left.T @ ((J[: len(steps)] - J[len(steps) :]) / (2.0 * DIFFERENCE)) @ null_space
