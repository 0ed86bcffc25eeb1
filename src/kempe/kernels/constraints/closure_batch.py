"""The constraint equations of loops and their dense Jacobian, for a batch of configurations."""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import FLAG, OUT, F, I
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import add_product
from kempe.kernels.constraints.goals import fill_equations
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import count_sweep_scratch, locate_poses, write_row_poses


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
def evaluate_equations(ints, floats, plan, weights, pins, q, with_jacobian, residual, jacobian):
    """Write the residual (N, m) at q (N, nq) and, if requested, the Jacobian (N, m, nv), both
    scaled as `weights` say.

    ints, floats: the table; plan, weights: the loops, and pins (N or 1, k): as in
    `loop_layout`.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    m = plan[L.N_ROWS]
    sweep = count_sweep_scratch(n_rows)
    block = np.empty(sweep + m + plan[L.BLOCKS])
    scratch = get_pointer(block)
    error = advance_pointer(scratch, sweep)
    blocks = advance_pointer(error, m)
    for i in range(q.shape[0]):
        start = advance_pointer(get_pointer(q), i * nq)
        pin = advance_pointer(get_pointer(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        loops = LoopScratch(
            get_pointer(ints),
            get_pointer(floats),
            get_pointer(plan),
            get_pointer(weights),
            pin,
            start,
            scratch,
            advance_pointer(scratch, locate_poses(n_rows)),
            error,
            blocks,
            n_rows,
            nq,
            nv,
        )
        write_row_poses(loops.ints, loops.floats, start, 0, scratch)
        fill_equations(loops, with_jacobian)
        for r in range(m):
            residual[i, r] = error[r]
        if not with_jacobian:
            continue
        columns = advance_pointer(get_pointer(jacobian), i * m * nv)
        for k in range(m * nv):
            columns[k] = 0.0
        for v in range(nv):
            add_product(loops, v, 1.0, advance_pointer(columns, v), nv)
    keep_alive(block)
