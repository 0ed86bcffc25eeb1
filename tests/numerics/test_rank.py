"""Ranks and what follows from them, against matrices whose singular values are chosen, and against
exact arithmetic.
"""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from kempe.errors import InputError
from kempe.numerics import rank as module
from kempe.numerics.rank import Level, Spectrum, compute_svd

LEVELS = (Level.ROUNDING, Level.CLOSED, Level.GENERIC, Level.ROUGH)


def orthogonal(rng, n):
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


def matrix(rng, m, n, values):
    """A matrix (m, n) with these singular values."""
    k = len(values)
    return orthogonal(rng, m)[:, :k] @ np.diag(values) @ orthogonal(rng, n)[:k]


def test_levels_are_ordered_and_each_counts_what_is_above_it():
    assert list(LEVELS) == sorted(LEVELS)
    rng = np.random.default_rng(0)
    values = [3.0, *(3.0 * level * factor for level in LEVELS for factor in (0.3, 3.0))]
    spectrum = Spectrum(matrix(rng, 12, 10, values))
    assert [spectrum.compute_rank(level) for level in LEVELS] == [8, 6, 4, 2]
    np.testing.assert_allclose(spectrum.compute_rank_gap(Level.ROUGH), 10.0, rtol=1e-9)


@pytest.mark.parametrize("shape", [(4, 7), (7, 4), (5, 5), (1, 3), (3, 1)])
def test_spaces_and_solutions_follow_from_a_rank(shape, hunt):
    """Bases are orthonormal, A maps them to zero or spans them; solutions are numpy's."""
    m, n = shape
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        r = int(rng.integers(0, min(m, n) + 1))
        A = matrix(rng, m, n, rng.uniform(0.1, 3.0, size=r)) if r else np.zeros(shape)
        A = A + 1e-15 * rng.normal(size=shape)
        spectrum = Spectrum(A, 1.0)
        assert spectrum.compute_rank(Level.ROUNDING) == r
        null, left, columns, rows = (
            part(Level.ROUNDING)
            for part in (
                spectrum.compute_null_space,
                spectrum.compute_left_null_space,
                spectrum.compute_column_space,
                spectrum.compute_row_space,
            )
        )
        for basis, size in (
            (null, (n, n - r)),
            (left, (m, m - r)),
            (columns, (m, r)),
            (rows, (n, r)),
        ):
            assert basis.shape == size
            np.testing.assert_allclose(basis.T @ basis, np.eye(size[1]), atol=1e-13)
        np.testing.assert_allclose(A @ null, 0.0, atol=1e-13)
        np.testing.assert_allclose(left.T @ A, 0.0, atol=1e-13)
        np.testing.assert_allclose(columns @ (columns.T @ A), A, atol=1e-13)
        np.testing.assert_allclose((A @ rows) @ rows.T, A, atol=1e-13)
        clean = A if r else np.zeros(shape)
        b = rng.normal(size=(m, 2))
        expected = np.linalg.lstsq(clean, b, rcond=1e-12)[0]
        np.testing.assert_allclose(
            spectrum.solve_least_squares(b, Level.ROUNDING), expected, atol=1e-11
        )
        np.testing.assert_allclose(
            spectrum.solve_least_squares(b[:, 0], Level.ROUNDING), expected[:, 0], atol=1e-11
        )
        np.testing.assert_allclose(
            spectrum.compute_pseudo_inverse(Level.ROUNDING),
            np.linalg.pinv(clean, rcond=1e-12),
            atol=1e-11,
        )


def test_ranks_of_batches_are_those_of_each(hunt):
    rng = hunt.rng()
    A = np.array([matrix(rng, 4, 5, np.ones(k + 1)) for k in rng.integers(0, 4, size=12)])
    A = A.reshape(3, 4, 4, 5)
    spectrum = Spectrum(A)
    for index in np.ndindex(3, 4):
        one = Spectrum(A[index])
        assert spectrum.compute_ranks(Level.CLOSED)[index] == one.compute_rank(Level.CLOSED)
        np.testing.assert_allclose(
            spectrum.compute_pseudo_inverse(Level.CLOSED)[index],
            one.compute_pseudo_inverse(Level.CLOSED),
            atol=1e-13,
        )
    assert Spectrum(np.zeros((0, 3, 3))).compute_ranks(Level.CLOSED).shape == (0,)


def test_matrices_without_rows_columns_or_entries():
    assert Spectrum(np.zeros((0, 3))).compute_null_space(Level.CLOSED).shape == (3, 3)
    assert Spectrum(np.zeros((3, 0))).compute_column_space(Level.CLOSED).shape == (3, 0)
    assert Spectrum(np.zeros((2, 3))).compute_rank(Level.CLOSED) == 0
    assert Spectrum(np.zeros((2, 3))).compute_null_space(Level.CLOSED).shape == (3, 3)
    assert Spectrum(np.full((2, 3), 1e-16), 1.0).compute_rank(Level.CLOSED) == 0
    assert Spectrum(np.full((2, 3), 1e-16)).compute_rank(Level.CLOSED) == 1


def test_the_rank_of_integer_matrices_is_that_of_exact_arithmetic(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        m, n, r = rng.integers(1, 7, size=3)
        A = rng.integers(-3, 4, size=(m, r)) @ rng.integers(-3, 4, size=(r, n))
        exact = sympy.Matrix(A.tolist())
        spectrum = Spectrum(A.astype(float), 1.0)
        assert (
            spectrum.compute_rank(Level.ROUNDING) == spectrum.find_clear_rank()[0] == exact.rank()
        )
        null = spectrum.compute_null_space(Level.ROUNDING)
        for v in exact.nullspace():
            x = np.array(v, dtype=float).ravel()
            np.testing.assert_allclose(null @ (null.T @ x), x, atol=1e-10 * np.linalg.norm(x))


def test_the_nearest_orthogonal_matrices_and_rotations(hunt):
    """No orthogonal matrix drawn at random, and for rotations none of determinant 1, is nearer."""
    rng = hunt.rng()
    A = rng.normal(size=(hunt.cases(10), 3, 3))
    spectrum = Spectrum(A)
    for M, near, turned in zip(A, spectrum.orthogonal, spectrum.rotation, strict=True):
        assert np.linalg.det(turned) == pytest.approx(1.0)
        for _ in range(30):
            other = orthogonal(rng, 3)
            assert np.linalg.norm(M - near) <= np.linalg.norm(M - other) + 1e-12
            if np.linalg.det(other) > 0.0:
                assert np.linalg.norm(M - turned) <= np.linalg.norm(M - other) + 1e-12


def clear_rank(*values, size=0.0):
    return Spectrum(np.diag(values), size).find_clear_rank()


def test_the_rank_is_decided_at_the_gap():
    assert clear_rank(1.0, 0.5, 1e-15)[0] == 2
    assert clear_rank(1.0, 0.5, 3e-8)[0] == 2  # a singular point known to 1e-15 only
    rank, gap = clear_rank(1.0, 3e-6, 1e-7)
    assert rank == 1 and gap == pytest.approx(1 / 3e-6)
    rank, gap = clear_rank(1.0, 1e-5, 1e-7)
    assert rank == 1 and gap > 1e3
    assert clear_rank(2.0, 1.0) == (2, pytest.approx(0.5 / 1e-15))
    assert (
        clear_rank(0.0, 0.0, 0.0)[0] == 0 and Spectrum(np.zeros((0, 0))).find_clear_rank()[0] == 0
    )
    rank, gap = clear_rank(1.0, 1e-2, 3e-5, 2e-5, 5e-7)
    assert gap < 1e3  # said to be doubtful
    assert clear_rank(1e-16, size=1.0)[0] == 0 and clear_rank(1e-16)[0] == 1
    assert clear_rank(1e-2, size=1.0)[0] == 1


# ---- the decomposition


def test_a_matrix_is_decomposed_once(monkeypatch):
    """A batch in one call; and none of its matrices is decomposed again, nor for its values."""
    calls = []

    def count_svd(*given, **how):
        calls.append(how)
        return compute_svd(*given, **how)

    monkeypatch.setattr(module, "compute_svd", count_svd)
    A = np.random.default_rng(0).normal(size=(5, 3, 4))
    for one in Spectrum(A):
        assert one.compute_rank(Level.CLOSED) == 3 and one.compute_null_space(0.1).shape == (4, 1)
        assert one.thin_decomposition[0].shape == (3, 3) and one.left.shape == (3, 3)
    assert calls == [{}]
    one = Spectrum(A[0])
    assert one.compute_pseudo_inverse(Level.CLOSED).shape == (4, 3) and one.largest > 0.0
    assert calls == [{}, {"full_matrices": False}]


@pytest.mark.parametrize("shape", [(3, 5), (5, 3), (4, 4), (2, 3, 4, 6), (1, 1), (7, 1)])
@pytest.mark.parametrize("full", [True, False])
def test_where_numpy_does_not_converge_the_same_comes_out(shape, full, monkeypatch):
    A = np.random.default_rng(0).normal(size=shape)
    U, s, Vt = compute_svd(A, full_matrices=full)
    values = compute_svd(A, compute_uv=False)

    def never(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", never)
    for mine, other in zip(compute_svd(A, full_matrices=full), (U, s, Vt), strict=True):
        assert mine.shape == other.shape
    again, sizes, rows = compute_svd(A, full_matrices=full)
    k = sizes.shape[-1]
    np.testing.assert_allclose(
        (again[..., :k] * sizes[..., None, :]) @ rows[..., :k, :], A, atol=1e-14
    )
    np.testing.assert_allclose(sizes, s, atol=1e-14)
    np.testing.assert_allclose(compute_svd(A, compute_uv=False), values, atol=1e-14)


def test_what_is_not_finite_is_refused(monkeypatch):
    def never(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", never)
    with pytest.raises(InputError, match="not finite"):
        compute_svd([[1.0, np.nan], [0.0, 1.0]])
