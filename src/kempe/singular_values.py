"""Singular value decomposition that does not fail: the one place where the library calls it."""

from __future__ import annotations

from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from kempe.budget import look
from kempe.errors import InputError

LARGE = 2000
"""Entries from which on a decomposition takes far longer than a look at the clock."""
Floats = NDArray[np.float64]


@overload
def svd(
    A: Any, full_matrices: bool = True, compute_uv: Literal[True] = True
) -> tuple[Floats, Floats, Floats]: ...
@overload
def svd(A: Any, full_matrices: bool = True, *, compute_uv: Literal[False]) -> Floats: ...
def svd(A: Any, full_matrices: bool = True, compute_uv: bool = True) -> Any:
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
        look()
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
