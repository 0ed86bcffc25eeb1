"""The rank of what a system moves: of rates of tasks or frames over the velocities that loops leave."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics import closure_rows
from kempe.kinematics.configuration import has_loops
from kempe.solvers.assembly.charts import tangent_space
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

FULL = 1e-7
"""Singular value, as a part of the largest, up to which a direction counts as lost."""


def image_ranks(system: System, q: Array, rates: Array) -> tuple[np.ndarray, int]:
    """Ranks (k,) of rates (k, m, nv) over the velocities that loops leave at q (k, nq), and the least freedoms."""
    out, n = list[int](), system.nv
    N, scale = np.eye(system.nv), closure_rows.scales(system)
    for x, J in zip(q, rates, strict=True):
        N = tangent_space(system, x)[0] if has_loops(system) else N
        n = min(n, N.shape[1])
        s = np.linalg.svd(J @ (scale[:, None] * N), compute_uv=False)
        out.append(int((s > FULL * max(float(s.max(initial=0.0)), 1e-300)).sum()))
    return np.array(out, dtype=int), n
