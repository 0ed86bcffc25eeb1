"""Assembly under further constraints that the kernels do not know: curves, functions of the user.

The same damped steps of minimum norm as `kempe.kernels.assembly`, in numpy, over the equations of the loops in full
form and the rows of the constraints of `kempe.kinematics.zoo`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.kernels.loop_layout import DAMPING, LONGEST, MOST_DAMPING, SCALES, WIDER
from kempe.kinematics.loops import evaluate, full
from kempe.model.own_tree import own_tree
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.kinematics.zoo import SystemConstraint
    from kempe.model.system import System

SMALL = 1e-13
"""Singular values below this part of the largest are rounding of dependent rows."""


def rows_of(system: System, constraints: Sequence[SystemConstraint], q: Array) -> tuple[Array, Array]:
    """Residual (m,) and Jacobian (m, nv) of the loops and of further constraints, in characteristic lengths."""
    error, J = evaluate(system, q, True, True)
    scale = scales(system)
    residuals, columns = [error], [J]
    for constraint in constraints:
        residuals.append(np.asarray(constraint.residual(system, q)))
        columns.append(np.asarray(constraint.jacobian(system, q)) * scale)
    return np.concatenate(residuals), np.concatenate(columns)


def scales(system: System) -> Array:
    """The unit (nv,) of each velocity coordinate: a radian, or the characteristic length for a slide."""
    return full(system, True).weights[SCALES : SCALES + system.nv]


def close(
    system: System, constraints: Sequence[SystemConstraint], start: Array, held: np.ndarray, steps: int,
    tolerance: float,
) -> tuple[Array, float, int]:  # fmt: skip
    """The configuration (nq,) reached from `start`, its residual and the steps; `held` (nv,) marks what stays."""
    low, high, at_q, at_v = system.lower, system.upper, system.layout.vector_q, system.layout.vector_v
    q, best, least, before = start.copy(), start.copy(), np.inf, np.inf
    scale = scales(system)
    free = ~held
    for step in range(steps + 1):
        error, J = rows_of(system, constraints, q)
        size = float(np.linalg.norm(error))
        if not np.isfinite(size):
            break
        if size < least:
            best, least = q.copy(), size
        if size <= 1e-15 or (size <= tolerance and size > 0.3 * before) or step == steps:
            break
        before = size
        moves = free.copy()
        gradient = J.T @ error
        at = q[at_q]
        out = ((at <= low[at_v]) & (gradient[at_v] >= 0.0)) | ((at >= high[at_v]) & (gradient[at_v] <= 0.0))
        moves[at_v[out]] = False
        U, values, Vt = np.linalg.svd(J[:, moves], full_matrices=False)
        damping = min(DAMPING * size * size / max(len(error), 1), MOST_DAMPING)
        large = values > SMALL * values.max(initial=1.0)
        part = np.where(large, values / np.where(large, values * values + damping, 1.0), 0.0)
        v = np.zeros(system.nv)
        v[moves] = -(Vt.T * part) @ (U.T @ error)
        v *= min(1.0, LONGEST / max(np.abs(v).max(initial=0.0), 1e-300))
        q = system.integrate(q, v * scale)
        q[at_q] = np.where(free[at_v], np.clip(q[at_q], low[at_v], high[at_v]), q[at_q])
    return best, least, step


def assemble_each(
    system: System, constraints: Sequence[SystemConstraint], starts: Array, held: np.ndarray, tries: int, steps: int,
    tolerance: float, rng: int,
) -> tuple[Array, Array, np.ndarray]:  # fmt: skip
    """As the kernel: configurations (N, nq), residuals (N,) and (status, steps, starts) (N, 3)."""
    system = own_tree(system)
    q, residual = np.empty_like(starts), np.full(len(starts), np.nan)
    info: Any = np.zeros((len(starts), 3), dtype=np.int64)
    for i, home in enumerate(starts):
        generator = np.random.default_rng((rng, i))
        least, count, used = np.inf, 0, 0
        while count < tries and not least <= tolerance:
            start = home
            if count:
                spread = generator.uniform(-1.0, 1.0, system.nv) * min(1.0, WIDER * count) * np.pi
                start = system.integrate(home, np.where(held, 0.0, spread) * scales(system))
            found, size, n = close(system, constraints, start, held, steps, tolerance)
            count, used = count + 1, used + n
            if size < least or count == 1:
                q[i], least = found, size
        residual[i] = least
        info[i] = (0 if least <= tolerance else 1 if np.isfinite(least) else 2), used, count
    return q, residual, info
