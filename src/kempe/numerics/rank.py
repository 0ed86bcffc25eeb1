"""Singular values of matrices, and ranks and null spaces that follow from them.

The rank of a computed matrix is the number of its singular values that are clearly not zero. What is
clear depends on how large an error the matrix has: the four values of `Level`.

Source: Golub, Van Loan, *Matrix Computations*, 4th edition, 2013, section 5.4.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Literal, cast, overload

import numpy as np
from numpy.typing import NDArray

from kempe.budget import check_for_stop
from kempe.errors import InputError

Array = NDArray[np.float64]

LARGE = 2000
"""Entries from which on a decomposition takes far longer than a look at the clock."""
TINY = 1e-300
"""Largest singular value below which a matrix is zero."""
FLOOR = 1e-15
"""Singular values below this part of the largest are rounding."""
SPARSE = 100
"""Columns from which on a matrix of loop equations is decomposed as a sparse one: few entries of a
row are not zero."""
SURE = 1e2
"""How far above what counts as zero the estimate of the smallest singular value must be for sparse
factors to do."""
ESTIMATES = 8
"""Inverse iterations that estimate the smallest singular value."""


class Level:
    """Level of error of a matrix, as a part of the largest singular value.

    Singular values below it count as zero.
    """

    ROUNDING = 1e-12
    """Level of matrices whose entries are computed in closed form: products of a few dozen poses are
    off by 1e-15 to 1e-14, and a hundred times that is left as a margin."""
    CLOSED = 1e-8
    """Level of matrices at configurations that solve equations, loops or tasks, to 1e-13 or better.

    Where the solution is regular the entries are off as little. Next to a fold a residual of rounding,
    1e-16, moves the configuration by its square root, and singular values with it."""
    GENERIC = 1e-6
    """Level of matrices at configurations that are drawn at random, and of ranks that must be the same
    around a configuration as at it.

    Zeros of the structure are zero to rounding there, and others rarely below 1e-3; at a configuration
    that is found to 1e-14 next to a singular one, where equations are quadratic, they are 1e-7."""
    ROUGH = 1e-4
    """Level of matrices at first guesses, and of those that second differences of functions give: both
    are off by 1e-6 to 1e-5."""


class Spectrum:
    """Singular values of a matrix A (m, n), or of matrices (..., m, n), and their ranks.

    Parameters
    ----------
    A
        The matrix, with rows and columns scaled so that their sizes can be compared.
    size
        What the largest singular value (...) counts as at least: what it would be if the matrix were
        not singular. A matrix that is rounding only then has the rank 0; without it, the largest one
        counts always.

    Decompositions are made when they are needed, and once. `level` is the part of the largest
    singular value above which others count: one of `Level`, or a number that has a reason.
    """

    def __init__(self, A: Array, size: float | Array = 0.0):
        self.A = A
        self.size = size
        self._full: tuple[Array, Array, Array] | None = None
        self._thin: tuple[Array, Array, Array] | None = None

    def __iter__(self) -> Iterator[Spectrum]:
        """Yield the spectra of the matrices of a batch (k, m, n), decomposed together."""
        for A, U, s, Vt in zip(self.A, *self.full_decomposition, strict=True):
            one = Spectrum(A, self.size)
            one._full = U, s, Vt
            yield one

    @property
    def full_decomposition(self) -> tuple[Array, Array, Array]:
        """Left vectors (..., m, m), values (..., min(m, n)) and right vectors (..., n, n)."""
        if self._full is None:
            self._full = compute_svd(self.A)
        return self._full

    @property
    def thin_decomposition(self) -> tuple[Array, Array, Array]:
        """Left vectors (..., m, k), values (..., k) and right vectors (..., k, n), k = min(m, n)."""
        if self._thin is None and self._full is not None:
            U, s, Vt = self._full
            k = s.shape[-1]
            self._thin = U[..., :k], s, Vt[..., :k, :]
        elif self._thin is None:
            self._thin = compute_svd(self.A, full_matrices=False)
        return self._thin

    @cached_property
    def values(self) -> Array:
        """The singular values (..., min(m, n)), descending."""
        known = self._full or self._thin
        return compute_svd(self.A, compute_uv=False) if known is None else known[1]

    @property
    def left(self) -> Array:
        """The left singular vectors (..., m, m), as columns."""
        return self.full_decomposition[0]

    @property
    def right(self) -> Array:
        """The right singular vectors (..., n, n), as rows."""
        return self.full_decomposition[2]

    @property
    def largest(self) -> Array:
        """Reference value (...) of levels: the largest singular value, or `size` if larger."""
        return np.maximum(np.maximum(self.values.max(axis=-1, initial=0.0), self.size), TINY)

    @property
    def smallest(self) -> Array:
        """Last singular value (...); 0 if the matrix has none."""
        s = self.values
        return s[..., -1] if s.shape[-1] else np.zeros(s.shape[:-1])

    def compute_ranks(self, level: float) -> NDArray[np.int64]:
        """Compute the number (...) of singular values above `level`."""
        return (self.values > level * self.largest[..., None]).sum(axis=-1)

    def compute_rank(self, level: float) -> int:
        """Compute the rank of one matrix."""
        return int(self.compute_ranks(level))

    def compute_null_space(self, level: float) -> Array:
        """Compute an orthonormal basis (n, n - rank) of the null space of one matrix."""
        Vt = self.right
        return Vt[self.compute_rank(level) :].T

    def compute_left_null_space(self, level: float) -> Array:
        """Compute an orthonormal basis (m, m - rank) of the left null space of one matrix."""
        U = self.left
        return U[:, self.compute_rank(level) :]

    def compute_column_space(self, level: float) -> Array:
        """Compute an orthonormal basis (m, rank) of the column space of one matrix."""
        U = self.thin_decomposition[0]
        return U[:, : self.compute_rank(level)]

    def compute_row_space(self, level: float) -> Array:
        """Compute an orthonormal basis (n, rank) of the row space of one matrix."""
        Vt = self.thin_decomposition[2]
        return Vt[: self.compute_rank(level)].T

    def compute_rank_gap(self, level: float) -> float:
        """Compute the ratio of the last singular value above `level` to the first one below.

        It is infinite at full rank.
        """
        r = self.compute_rank(level)
        s = self.values
        if r == len(s):
            return np.inf
        return float((s[r - 1] if r else self.largest) / max(s[r], TINY))

    def compute_pseudo_inverse(self, level: float) -> Array:
        """Compute the pseudo-inverses (..., n, m)."""
        U, s, Vt = self.thin_decomposition
        big = s > level * self.largest[..., None]
        part = np.where(big, 1.0 / np.where(big, s, 1.0), 0.0)
        return np.swapaxes(Vt, -1, -2) @ (part[..., None] * np.swapaxes(U, -1, -2))

    def solve_least_squares(self, b: Array, level: float) -> Array:
        """Find the shortest x (n,), or (n, k), that minimises |A x - b| for one matrix."""
        U, s, Vt = self.thin_decomposition
        r = self.compute_rank(level)
        part = U[:, :r].T @ b
        return Vt[:r].T @ (part / (s[:r] if b.ndim == 1 else s[:r, None]))

    def find_clear_rank(self) -> tuple[int, float]:
        """Find the rank at the widest gap between neighbouring singular values, and their ratio.

        What is above `Level.ROUGH` counts, what is below `Level.GENERIC` does not; between the two
        the widest gap decides. Singular values below `FLOOR` are equal.
        """
        values = self.values
        if not len(values) or values[0] <= 0.0:
            return 0, np.inf
        s = values / self.largest
        above = np.append(1.0, s)  # above[r]: the last that counts if the rank is r
        first = 0 if np.any(self.size) else 1
        allowed = [
            r
            for r in range(first, len(above))
            if above[r] > Level.GENERIC and (r == len(s) or s[r] < Level.ROUGH)
        ]
        gaps = [above[r] / max(s[r], FLOOR) if r < len(s) else above[r] / FLOOR for r in allowed]
        best = int(np.argmax(gaps))
        return allowed[best], float(gaps[best])

    @property
    def orthogonal(self) -> Array:
        """Orthogonal matrices (..., n, n) nearest to square matrices (Procrustes)."""
        U, _, Vt = self.full_decomposition
        return U @ Vt

    @property
    def rotation(self) -> Array:
        """The rotations (..., n, n) nearest to square matrices (Kabsch, 1976)."""
        U, _, Vt = self.full_decomposition
        sense = np.ones(U.shape[:-1])
        sense[..., -1] = np.sign(np.linalg.det(U @ Vt))
        return (U * sense[..., None, :]) @ Vt

    def compute_sparse_null_space(
        self, columns: Sequence[int], level: float, places: tuple[Any, Any] | None = None
    ) -> Array | None:
        """Compute the null space of a large sparse matrix from the entries in these `columns`.

        These entries of a null vector determine the others. `places` are rows and columns (k,) of
        all entries that may not be zero, where they are known.

        None where the other columns are not as many as the rows, or are not clearly independent:
        where their smallest singular value, estimated by inverse iteration with sparse factors, is
        not `SURE` times above `level` of a bound of the largest one, the root of the largest sum of
        a row times that of a column.
        """
        A = self.A
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
        row, column = np.nonzero(A) if places is None else places
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
        if not SURE * level * inverse * float(size) < 1.0:
            return None
        basis = np.zeros((n, len(columns)))
        basis[list(columns), np.arange(len(columns))] = 1.0
        basis[others] = -factors.solve(np.ascontiguousarray(A[:, list(columns)]))
        return np.linalg.qr(basis)[0]


# ---- the decomposition


@overload
def compute_svd(
    A: Any, full_matrices: bool = True, compute_uv: Literal[True] = True
) -> tuple[Array, Array, Array]: ...
@overload
def compute_svd(A: Any, full_matrices: bool = True, *, compute_uv: Literal[False]) -> Array: ...
def compute_svd(A: Any, full_matrices: bool = True, compute_uv: bool = True) -> Any:
    """Singular value decomposition of matrices (..., m, n), as numpy's `svd` gives it.

    LAPACK's divide and conquer (gesdd), which numpy calls, does not converge for some finite
    matrices with several singular values near rounding. These are decomposed by QR iteration
    (gesvd), which is slower and does.

    Raises
    ------
    InputError
        For matrices with entries that are not finite.
    """
    if getattr(A, "size", 0) > LARGE:
        check_for_stop()
    numpys: Any = np.linalg
    try:
        return numpys.svd(A, full_matrices=full_matrices, compute_uv=compute_uv)
    except np.linalg.LinAlgError:
        matrices = np.asarray(A, dtype=np.float64)
        if not np.isfinite(matrices).all():
            raise InputError(
                "a matrix has entries that are not finite: a number of the system or of the call "
                "is too large"
            ) from None
    import scipy.linalg  # only here: it takes long

    library: Any = scipy.linalg
    lead = matrices.shape[:-2]
    found: list[Any] = [
        library.svd(M, full_matrices=full_matrices, compute_uv=compute_uv, lapack_driver="gesvd")
        for M in matrices.reshape(-1, *matrices.shape[-2:])
    ]
    if not compute_uv:
        return np.reshape(found, (*lead, -1))
    return tuple(
        np.reshape([part[k] for part in found], (*lead, *np.shape(found[0][k]))) for k in range(3)
    )
