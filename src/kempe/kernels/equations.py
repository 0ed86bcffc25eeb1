"""The constraint equations of loops and their dense Jacobian, for a batch of configurations."""

from __future__ import annotations

import numpy as np
from numba import types

from kempe.kernels import loop_layout as L
from kempe.kernels._jit import F1, F2, I1, OUT2, OUT3, kernel
from kempe.kernels.layout import N_ROWS as TABLE_ROWS
from kempe.kernels.layout import NQ, NV
from kempe.kernels.rows import poses_at, row_poses, scratch_size
from kempe.kernels.scratch import beyond
from kempe.kernels.ties import Loops, fill
from kempe.kernels.vectors import keep, raw


@kernel(types.void(I1, F1, I1, F1, F2, types.boolean, OUT2, OUT3))
def equations(ints, floats, plan, weights, q, with_jacobian, residual, jacobian):
    """Write the residual (N, m) at q (N, nq) and, if asked, the Jacobian (N, m, nv), both scaled as `weights` say.

    ints, floats: the table; plan, weights: the loops (`loop_layout`), without pins.
    """
    nq, nv, n_rows, m = ints[NQ], ints[NV], ints[TABLE_ROWS], plan[L.N_ROWS]
    sweep = scratch_size(n_rows)
    block = np.empty(sweep + m + plan[L.BLOCKS] + nq + 8)
    scratch = raw(block)
    error = beyond(scratch, sweep)
    blocks = beyond(error, m)
    loops = Loops(raw(ints), raw(floats), raw(plan), raw(weights), raw(weights), blocks, scratch,
                  beyond(scratch, poses_at(n_rows)), error, blocks, n_rows, nq, nv)  # fmt: skip
    for i in range(q.shape[0]):
        start = beyond(raw(q), i * nq)
        loops = Loops(loops.ints, loops.floats, loops.plan, loops.weights, loops.pins, start, scratch, loops.poses,
                      error, blocks, n_rows, nq, nv)  # fmt: skip
        row_poses(loops.ints, loops.floats, start, 0, scratch)
        fill(loops, with_jacobian)
        for r in range(m):
            residual[i, r] = error[r]
        if not with_jacobian:
            continue
        for r in range(m):
            for v in range(nv):
                jacobian[i, r, v] = 0.0
        for v in range(nv):
            at = plan[L.AT_VARS] + v
            for use in range(plan[at], plan[at + 1]):
                k = plan[L.AT_USES] + L.USE_INTS * use
                tie = plan[L.AT_TIES] + L.TIE_INTS * plan[k]
                rows, first = plan[tie + L.ROWS], plan[tie + L.FIRST_ROW]
                there = plan[tie + L.BLOCK] + rows * plan[k + 1]
                for r in range(rows):
                    jacobian[i, first + r, v] = blocks[there + r]
    keep(block)
