import numpy as np
import pytest

from kempe.kernels.base.linear import factor_matrix, solve_definite_six, substitute_back


@pytest.mark.parametrize("condition", [1.0, 1e4, 1e9])
def test_six_unknowns(condition):
    rng = np.random.default_rng(int(condition))
    for _ in range(20):
        U = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        A = U @ np.diag(np.geomspace(1.0, 1.0 / condition, 6)) @ U.T
        b = rng.normal(size=6)
        x = np.array(solve_definite_six.py_func(tuple(A[np.tril_indices(6)]), tuple(b)))
        assert np.abs(A @ x - b).max() < 1e-13 * np.abs(x).max()


@pytest.mark.parametrize("n", [0, 1, 2, 7, 30])
def test_any_number_of_unknowns(n):
    rng = np.random.default_rng(n)
    B = rng.normal(size=(n, n))
    A = B @ B.T + np.eye(n)
    x = rng.normal(size=n)
    a = A.ravel().copy()
    b = A @ x
    assert factor_matrix.py_func(a, n)
    substitute_back.py_func(a, n, b)
    assert np.allclose(b, x, rtol=0, atol=1e-10)


@pytest.mark.parametrize("n", [1, 2, 7])
def test_not_positive_definite(n):
    A = np.eye(n)
    A[-1, -1] = -1e-3
    assert not factor_matrix.py_func(A.ravel().copy(), n)
    A[-1, -1] = np.nan
    assert not factor_matrix.py_func(A.ravel().copy(), n)
