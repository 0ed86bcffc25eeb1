"""Eigenvalues against LAPACK (numpy) and against matrices whose eigenvalues are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from kempe.kernels.compiled import elimination_batch


def eigenvalues(matrices) -> np.ndarray:
    """Eigenvalues (N, n), complex, of matrices (N, n, n); none may be missed."""
    A = np.ascontiguousarray(matrices, dtype=float)
    re = np.empty(A.shape[:2])
    im = np.empty(A.shape[:2])
    missed = np.empty(len(A), np.int64)
    assert elimination_batch.compute_all_eigenvalues(A, re, im, missed) == 0 and not missed.any()
    return re + 1j * im


def apart(a, b) -> float:
    """Largest distance between two multisets of numbers, paired in the best way."""
    distance = abs(np.asarray(a)[:, None] - np.asarray(b)[None, :])
    return distance[linear_sum_assignment(distance)].max()


def assert_as_numpy(A, tolerance):
    for matrix, found in zip(A, eigenvalues(A), strict=True):
        assert apart(found, np.linalg.eigvals(matrix)) < tolerance * np.linalg.norm(matrix)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 8, 9, 12, 15, 16, 17, 23, 24, 25, 32])
def test_random(n):
    assert_as_numpy(np.random.default_rng(n).standard_normal((20, n, n)), 1e-12)


@pytest.mark.parametrize("n", [6, 16, 24])
def test_pairs_of_conjugates_stand_together(n):
    for found in eigenvalues(np.random.default_rng(n).standard_normal((20, n, n))):
        i = 0
        while i < n:
            if found[i].imag != 0.0:
                assert found[i].imag > 0.0 and found[i + 1] == found[i].conjugate()
                i += 1
            i += 1


@pytest.mark.parametrize("n", [16, 24])
def test_sparse_and_triangular(n):
    rng = np.random.default_rng(n)
    sparse = rng.standard_normal((20, n, n)) * (rng.random((20, n, n)) < 0.2)
    assert_as_numpy(sparse, 1e-4)  # nilpotent parts: defective zeros, as uncertain for numpy
    upper = np.triu(rng.standard_normal((n, n)))
    assert apart(eigenvalues([upper])[0], np.diag(upper)) < 1e-14 * n
    condition = np.linalg.cond(np.linalg.eig(upper)[1])  # of its eigenvectors
    assert apart(eigenvalues([upper.T])[0], np.diag(upper)) < 1e-15 * condition


def test_simple_ones_exactly():
    cycle = np.roll(np.eye(16), 1, axis=0)
    assert apart(eigenvalues([cycle])[0], np.exp(2j * np.pi * np.arange(16) / 16)) < 1e-14
    assert (eigenvalues([np.zeros((16, 16)), np.eye(16)]) == [[0.0], [1.0]]).all()
    assert eigenvalues([[[0.0, 1.0], [-1.0, 0.0]]])[0].tolist() == [1j, -1j]


@pytest.mark.parametrize("n", [8, 16, 24])
def test_graded(n):
    """Rows and columns of very different size: exact after balancing, hopeless without."""
    rng = np.random.default_rng(n)
    base = rng.standard_normal((10, n, n))
    scale = 10.0 ** rng.uniform(-12, 12, n)
    graded = base * scale[:, None] / scale
    for found, matrix in zip(eigenvalues(graded), base, strict=True):
        assert apart(found, np.linalg.eigvals(matrix)) < 1e-12 * np.linalg.norm(matrix)
    for size in (1e-120, 1e120):
        for found, matrix in zip(eigenvalues(size * base), base, strict=True):
            assert apart(found / size, np.linalg.eigvals(matrix)) < 1e-12 * np.linalg.norm(matrix)


def test_companion_of_known_roots():
    roots = np.concatenate(
        [np.linspace(-2.0, 2.0, 8), *[[z, z.conjugate()] for z in np.exp([0.5j, 1j, 1.5j, 2j])]]
    )
    coefficients = np.poly(roots).real
    companion = np.diag(np.ones(15), -1)
    companion[0] = -coefficients[1:]
    assert apart(eigenvalues([companion])[0], roots) < 1e-9
    assert apart(eigenvalues([companion.T])[0], roots) < 1e-9


@pytest.mark.parametrize("size, tolerance", [(2, 1e-6), (3, 1e-4), (4, 1e-3)])
def test_defective(size, tolerance):
    """A Jordan block of order k lets eigenvalues move by the k-th root of a rounding error, and no
    further.
    """
    rng = np.random.default_rng(size)
    J = np.diag(np.repeat(np.arange(1.0, 16 // size + 1), size)) + np.diag(
        np.ones(16 // size * size - 1), 1
    )
    J[np.arange(size, len(J), size) - 1, np.arange(size, len(J), size)] = 0.0
    Q = np.linalg.qr(rng.standard_normal(J.shape))[0]
    assert apart(eigenvalues([Q @ J @ Q.T])[0], np.diag(J)) < tolerance


def test_equal_eigenvalues_that_are_not_defective():
    """Each eigenvalue twice, real ones and pairs: the Hessenberg form falls apart only by rounding
    errors.
    """
    rng = np.random.default_rng(0)
    for _ in range(50):
        A = rng.standard_normal((8, 8))
        X = rng.standard_normal((16, 16))
        twice = X @ np.kron(np.eye(2), A) @ np.linalg.inv(X)
        values = np.linalg.eigvals(A)
        allowed = (
            1e-13 * np.linalg.cond(X) * np.linalg.norm(A) * np.linalg.cond(np.linalg.eig(A)[1])
        )
        assert apart(eigenvalues([twice])[0], [*values, *values]) < allowed


def test_not_finite_and_huge():
    A = np.random.default_rng(0).standard_normal((4, 16, 16))
    A[0, 3, 4], A[1, 0, 0] = np.nan, np.inf
    re = np.empty((4, 16))
    im = np.empty((4, 16))
    missed = np.empty(4, np.int64)
    assert elimination_batch.compute_all_eigenvalues(A, re, im, missed) == 2
    assert missed.tolist() == [16, 16, 0, 0]
    assert np.isnan(re[:2]).all() and np.isfinite(re[2:]).all() and np.isfinite(im[2:]).all()
