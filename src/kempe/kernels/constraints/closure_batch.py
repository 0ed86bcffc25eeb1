"""The constraint equations of loops and their dense Jacobian, for a batch of configurations."""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import FLAG, OUT, F, I
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import add_product
from kempe.kernels.constraints.goals import fill
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import poses_at, row_poses, scratch_size


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("1|N", "_"),
    F("N", "nq"),
    FLAG,
    OUT("N", "m"),
    OUT("_", "m", "_"),
    returns=False,
)
def equations(ints, floats, plan, weights, pins, q, with_jacobian, residual, jacobian):
    """Write the residual (N, m) at q (N, nq) and, if requested, the Jacobian (N, m, nv), both
    scaled as `weights` say.

    ints, floats: the table; plan, weights: the loops, and pins (N or 1, k): as in
    `loop_layout`.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    m = plan[L.N_ROWS]
    sweep = scratch_size(n_rows)
    block = np.empty(sweep + m + plan[L.BLOCKS])
    scratch = raw(block)
    error = beyond(scratch, sweep)
    blocks = beyond(error, m)
    for i in range(q.shape[0]):
        start = beyond(raw(q), i * nq)
        pin = beyond(raw(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        loops = LoopScratch(
            raw(ints),
            raw(floats),
            raw(plan),
            raw(weights),
            pin,
            start,
            scratch,
            beyond(scratch, poses_at(n_rows)),
            error,
            blocks,
            n_rows,
            nq,
            nv,
        )
        row_poses(loops.ints, loops.floats, start, 0, scratch)
        fill(loops, with_jacobian)
        for r in range(m):
            residual[i, r] = error[r]
        if not with_jacobian:
            continue
        columns = beyond(raw(jacobian), i * m * nv)
        for k in range(m * nv):
            columns[k] = 0.0
        for v in range(nv):
            add_product(loops, v, 1.0, beyond(columns, v), nv)
    keep(block)
