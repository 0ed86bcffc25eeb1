"""The null space and the column space of a matrix, with a bound for what counts as zero."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from kempe.singular_values import svd
from kempe.spatial import Array

RANK_TOLERANCE = 1e-8
"""Singular values below this fraction of the largest count as zero."""
TINY = 1e-300
"""Largest singular value below which a matrix is zero."""
SPARSE = 100
"""Columns from which on a matrix of loop equations is decomposed as a sparse one: few entries of a
row are not zero."""
SURE = 1e2
"""How far above what counts as zero the estimate of the smallest singular value must be for sparse
factors to do."""
ESTIMATES = 8
"""Inverse iterations that estimate the smallest singular value."""


def null_space(A: Array, least: float = RANK_TOLERANCE, size: float = 1.0) -> Array:
    """Orthonormal basis (n, k) of what A (m, n) maps to zero.

    Singular values to `least` of the largest one count as 0, or of `size`, if that is more.
    """
    if not A.size:
        return np.eye(A.shape[1])
    _, s, Vt = svd(A)
    return Vt[int(np.sum(s > least * max(float(s.max(initial=0.0)), size, TINY))) :].T


def null_space_from(A: Array, columns: Sequence[int], least: float) -> Array | None:
    """As `null_space` of A (m, n), from the entries of a vector in these `columns`, which determine
    the others.

    None where the other columns are not as many as the rows, or are not clearly independent: where
    their smallest singular value, estimated by inverse iteration with sparse factors, is not `SURE`
    times above `least` of a bound of the largest one, the root of the largest sum of a row times
    that of a column.
    """
    m = len(A)
    n = A.shape[1]
    others = np.setdiff1d(np.arange(n, dtype=np.int64), np.array(columns, dtype=np.int64))
    if len(others) != m or len(columns) != n - m:
        return None
    import scipy.sparse  # only here: they take long
    import scipy.sparse.linalg

    library = cast(Any, scipy.sparse)
    row: np.ndarray
    column: np.ndarray
    row, column = np.nonzero(A)
    number = np.full(n, -1)
    number[others] = np.arange(m)
    entries = A[row, column]
    place = number[column]
    inner = place >= 0
    try:
        factors = library.linalg.splu(
            library.csc_matrix((entries[inner], (row[inner], place[inner])), shape=(m, m))
        )
    except RuntimeError:  # it is singular
        return None
    x: Any = np.random.default_rng(0).normal(size=m)
    inverse = 0.0
    for _ in range(ESTIMATES):
        x = factors.solve(factors.solve(x / np.linalg.norm(x)), "T")
        inverse = float(np.sqrt(np.linalg.norm(x)))
    size = np.sqrt(
        np.bincount(row, np.abs(entries)).max() * np.bincount(column, np.abs(entries)).max()
    )
    if not SURE * least * inverse * float(size) < 1.0:
        return None
    basis = np.zeros((n, len(columns)))
    basis[list(columns), np.arange(len(columns))] = 1.0
    basis[others] = -factors.solve(np.ascontiguousarray(A[:, list(columns)]))
    return np.linalg.qr(basis)[0]


def column_space(A: Array, least: float, size: float) -> Array:
    """Orthonormal basis (m, r) of what the columns of A (m, n) span.

    Singular values to `least` of the largest one count as 0, or of `size`, if that is more.
    """
    U, s, _ = svd(A, full_matrices=False)
    return U[:, s > least * max(float(s.max(initial=0.0)), size)]
