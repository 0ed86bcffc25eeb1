"""The rank of what a system moves: of rates of tasks or frames over the velocities that loops
leave.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics import closure_rows
from kempe.kinematics.configuration import has_loops
from kempe.kinematics.forward import fk
from kempe.model.tree.characteristic_length import characteristic_length
from kempe.singular_values import svd
from kempe.solvers.assembly.charts import tangent_space
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

FULL = 1e-7
"""Singular value, as a part of the largest, up to which a direction counts as lost."""
ROUNDED = 1e-13
CLOSED = 1e-9
"""Rate, of rows in radians or characteristic lengths, up to which it is rounding: of trees, and
where loops are closed within a tolerance. Rounding of places grows with their distance from the
origin."""


def image_ranks(
    system: System, q: Array, rates: Array, metres: np.ndarray
) -> tuple[np.ndarray, int]:
    """Ranks (k,) of rates (k, m, nv) over the velocities that loops leave at q (k, nq), and the
    least freedoms.

    `metres` (m,) says which rows are lengths: these are measured in characteristic lengths, so that
    ranks do not depend on the unit of length. A singular value counts where it is above `FULL`
    times the largest, and above rounding.
    """
    out = list[int]()
    n = system.nv
    loops = has_loops(system)
    N = np.eye(system.nv)
    scale = closure_rows.scales(system)
    length = characteristic_length(system)
    row_unit = np.where(metres, length, 1.0)[:, None]
    far = np.abs(fk(system, q)[..., :3, 3]).max(axis=(-2, -1), initial=0.0) / length
    for x, J, away in zip(q, rates, far.tolist(), strict=True):
        N = tangent_space(system, x)[0] if loops else N
        n = min(n, N.shape[1])
        s = svd(J @ (scale[:, None] * N) / row_unit, compute_uv=False)
        rounding = (CLOSED if loops else ROUNDED) * (1.0 + away)
        out.append(int((s > max(FULL * float(s.max(initial=0.0)), rounding)).sum()))
    return np.array(out, dtype=int), n
