"""Entry points for batches of goals and of matrices: what the solver does, seen alone."""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.eigen import EIGEN_SCRATCH, LARGEST_SIZE, eigenvalues
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.elimination.elimination import CANDIDATES, ELIMINATION_SCRATCH, eliminate
from kempe.kernels.elimination.elimination_loop import LINE_STRIDE


@kernel(I(6), F(6, LINE_STRIDE), F("N", 12), INT, OUT("N", "_", 6), OUTI("N"), OUTI("N"))
def eliminate_each(kinds, lines, goals, formulation, thetas, counts, suspects):
    """Number of suspect goals; all candidates of each by one formulation, see
    `elimination.eliminate`.

    kinds: (6,). lines: (6, LINE_STRIDE). goals: (N, 12), rows of G. thetas: (N, K, 6), K at least
    16; of what is left over nothing is written. counts, suspects: (N,).
    """
    block = np.empty(ELIMINATION_SCRATCH + 6 * CANDIDATES)
    w = raw(block)
    out = beyond(w, ELIMINATION_SCRATCH)
    doubted = 0
    room = thetas.shape[1]
    for g in range(goals.shape[0]):
        count, _, suspect = eliminate(
            raw(kinds), raw(lines), beyond(raw(goals), 12 * g), formulation, w, out
        )
        doubted += int(suspect != 0)
        counts[g] = min(count, room)
        suspects[g] = suspect
        for k in range(min(count, room)):
            for j in range(6):
                thetas[g, k, j] = out[6 * k + j]
    keep(block)
    return doubted


@kernel(F("N", "n", "n"), OUT("N", "n"), OUT("N", "n"), OUTI("N"))
def eigenvalues_each(matrices, re, im, missed):
    """Number of matrices with eigenvalues that were not found, of N matrices (N, n, n), n <=
    LARGEST_SIZE.

    re, im: (N, n), NaN where not found. missed: (N,), how many.
    """
    n = matrices.shape[1]
    failures = 0
    block = np.zeros(LARGEST_SIZE * (LARGEST_SIZE + 1) + EIGEN_SCRATCH)
    a = raw(block)
    scratch = beyond(a, LARGEST_SIZE * (LARGEST_SIZE + 1))
    for m in range(matrices.shape[0]):
        for i in range(n):
            for j in range(n):
                a[i * LARGEST_SIZE + j] = matrices[m, i, j]
        lost = eigenvalues(
            a, n, LARGEST_SIZE, beyond(raw(re), m * n), beyond(raw(im), m * n), scratch
        )
        missed[m] = lost
        failures += int(lost > 0)
    keep(block)
    return failures
