"""Entry points of the elimination for batches of goals and of matrices."""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.eigen import EIGEN_SCRATCH, LARGEST_SIZE, compute_eigenvalues
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.elimination.elimination import (
    CANDIDATES,
    ELIMINATION_SCRATCH,
    eliminate_unknowns,
)
from kempe.kernels.elimination.elimination_loop import LINE_STRIDE


@kernel(I(6), F(6, LINE_STRIDE), F("N", 12), INT, OUT("N", "_", 6), OUTI("N"), OUTI("N"))
def eliminate_goals(kinds, lines, goals, formulation, thetas, counts, suspects):
    """Write all candidates of each goal by one formulation (`elimination.eliminate_unknowns`);
    return the number of suspect goals.

    kinds: (6,). lines: (6, LINE_STRIDE). goals: (N, 12), rows of G. thetas: (N, K, 6), K at least
    16; of what is left over nothing is written. counts, suspects: (N,).
    """
    block = np.empty(ELIMINATION_SCRATCH + 6 * CANDIDATES)
    w = get_pointer(block)
    out = advance_pointer(w, ELIMINATION_SCRATCH)
    doubted = 0
    room = thetas.shape[1]
    for g in range(goals.shape[0]):
        count, _, suspect = eliminate_unknowns(
            get_pointer(kinds),
            get_pointer(lines),
            advance_pointer(get_pointer(goals), 12 * g),
            formulation,
            w,
            out,
        )
        doubted += int(suspect != 0)
        counts[g] = min(count, room)
        suspects[g] = suspect
        for k in range(min(count, room)):
            for j in range(6):
                thetas[g, k, j] = out[6 * k + j]
    keep_alive(block)
    return doubted


@kernel(F("N", "n", "n"), OUT("N", "n"), OUT("N", "n"), OUTI("N"))
def compute_all_eigenvalues(matrices, re, im, missed):
    """Write the eigenvalues of N matrices (N, n, n), n <= LARGEST_SIZE; return the number of
    matrices with eigenvalues that were not found.

    re, im: (N, n), NaN where not found. missed: (N,), how many.
    """
    n = matrices.shape[1]
    failures = 0
    block = np.zeros(LARGEST_SIZE * (LARGEST_SIZE + 1) + EIGEN_SCRATCH)
    a = get_pointer(block)
    scratch = advance_pointer(a, LARGEST_SIZE * (LARGEST_SIZE + 1))
    for m in range(matrices.shape[0]):
        for i in range(n):
            for j in range(n):
                a[i * LARGEST_SIZE + j] = matrices[m, i, j]
        lost = compute_eigenvalues(
            a,
            n,
            LARGEST_SIZE,
            advance_pointer(get_pointer(re), m * n),
            advance_pointer(get_pointer(im), m * n),
            scratch,
        )
        missed[m] = lost
        failures += int(lost > 0)
    keep_alive(block)
    return failures
