"""Velocities that lead to no motion where the equations touch along all of a motion, and those that do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.closure_rows import evaluate
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

DIFFERENCE = 1e-5
"""Step of the central differences of the Jacobian, in radians and characteristic lengths."""
VANISHES = 1e-6
"""Second derivatives below this count as zero."""


def moving(system: System, q: Array, left: Array, kernel: Array, scale: Array) -> Array:
    """The part (nv, d) of a kernel (nv, p) of the scaled Jacobian at q (nq,) that motions have as velocities.

    `left` (rows, k) are the left null vectors. Along a motion at which the rank stays, the second derivatives of the
    equations vanish for `left`, a velocity and any of the kernel; where these leave less than the kernel, and as much
    as there are freedoms, the rest is shaky. Elsewhere the kernel is returned as it is.
    """
    if not np.abs(_change(system, q, left, kernel, scale, np.cos(np.arange(kernel.shape[1]))[None])).max() > VANISHES:
        return kernel
    blocks = _change(system, q, left, kernel, scale, np.eye(kernel.shape[1]))
    _, sizes, V = np.linalg.svd(blocks.reshape(-1, kernel.shape[1]))
    shaky = int(np.sum(sizes > VANISHES))
    if not 0 < shaky < kernel.shape[1] or system.mobility(q).dof != kernel.shape[1] - shaky:
        return kernel
    return kernel @ V[shaky:].T


def _change(system: System, q: Array, left: Array, kernel: Array, scale: Array, along: Array) -> Array:
    """Second derivatives (n, k, p) for left null vectors, combinations (n, p) of the kernel, and the kernel."""
    steps = DIFFERENCE * scale * (along @ kernel.T)
    J = evaluate(system, system.structure.layout.integrate(q, np.concatenate([steps, -steps])), True, True)[1]
    return left.T @ ((J[: len(steps)] - J[len(steps) :]) / (2.0 * DIFFERENCE)) @ kernel
