"""The null space and the column space of a matrix, for callers that say what counts as zero."""

from __future__ import annotations

import numpy as np

from kempe.singular_values import svd
from kempe.spatial import Array


def null_space(A: Array, least: float) -> Array:
    """Orthonormal basis (n, k) of what A (m, n) maps to zero; singular values to `least` of the largest count as 0."""
    _, s, Vt = svd(A)
    return Vt[int(np.sum(s > least * max(float(s.max(initial=0.0)), 1e-300))) :].T


def column_space(A: Array, least: float, size: float) -> Array:
    """Orthonormal basis (m, r) of what the columns of A (m, n) span.

    Singular values to `least` of the largest one count as 0, or of `size`, if that is more.
    """
    U, s, _ = svd(A, full_matrices=False)
    return U[:, s > least * max(float(s.max(initial=0.0)), size)]
