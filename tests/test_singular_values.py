"""The decomposition that does not fail agrees with numpy's, and is there where numpy's does not
converge.
"""

from __future__ import annotations

import numpy as np
import pytest

from kempe.errors import InputError
from kempe.singular_values import svd


@pytest.mark.parametrize("shape", [(3, 5), (5, 3), (4, 4), (2, 3, 4, 6), (1, 1), (7, 1)])
@pytest.mark.parametrize("full", [True, False])
def test_where_numpy_does_not_converge_the_same_comes_out(shape, full, monkeypatch):
    A = np.random.default_rng(0).normal(size=shape)
    U, s, Vt = svd(A, full_matrices=full)
    values = svd(A, compute_uv=False)

    def never(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", never)
    for mine, other in zip(svd(A, full_matrices=full), (U, s, Vt), strict=True):
        assert mine.shape == other.shape
    again, sizes, rows = svd(A, full_matrices=full)
    k = sizes.shape[-1]
    np.testing.assert_allclose(
        (again[..., :k] * sizes[..., None, :]) @ rows[..., :k, :], A, atol=1e-14
    )
    np.testing.assert_allclose(sizes, s, atol=1e-14)
    np.testing.assert_allclose(svd(A, compute_uv=False), values, atol=1e-14)


def test_what_is_not_finite_is_refused(monkeypatch):
    def never(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", never)
    with pytest.raises(InputError, match="not finite"):
        svd([[1.0, np.nan], [0.0, 1.0]])
