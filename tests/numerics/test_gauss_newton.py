"""The Gauss-Newton loop against closed forms, scipy's least squares and exact rational
pseudo-inverses.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import least_squares as scipy_least_squares

from kempe.numerics import newton as g
from kempe.numerics.newton import (
    run_gauss_newton,
    run_many_gauss_newton,
    solve_damped_least_squares,
    solve_least_squares,
    solve_many_least_squares,
)


def arm(x):
    """The tip of a planar arm with links of length 1 (..., 2), and the Jacobian (..., 2, n)."""
    s = np.cumsum(x, axis=-1)
    tip = np.stack([np.cos(s).sum(axis=-1), np.sin(s).sum(axis=-1)], axis=-1)
    ends = np.stack([-np.sin(s), np.cos(s)], axis=-2)
    return tip, np.cumsum(ends[..., ::-1], axis=-1)[..., ::-1]


def test_the_least_solution_of_dependent_equations(hunt):
    """By the definition: what is left is normal to the columns, the solution to the null space."""
    rng = hunt.rng()
    for _ in range(hunt.cases(300)):
        m, n, r = rng.integers(1, 9, 3)
        A = rng.normal(size=(m, min(r, m, n))) @ rng.normal(size=(min(r, m, n), n))
        b = rng.normal(size=m)
        one = solve_least_squares(A, b)
        many = solve_many_least_squares(A[None], b[None])[0]
        for y in (one, many):
            size = np.linalg.norm(A, 2) * max(1.0, np.linalg.norm(b)) * max(1.0, np.linalg.norm(y))
            assert np.abs(A.T @ (A @ y - b)).max() < 1e-8 * size * max(1.0, np.linalg.norm(A, 2))
            assert np.abs(null_space(A, 1e-9).T @ y).max(initial=0.0) < 1e-7 * max(
                1.0, np.linalg.norm(y)
            )


@pytest.mark.parametrize("rows", [g.LARGE - 1, g.LARGE + 1])
def test_large_and_small_problems_have_the_same_solution(rows):
    """Normal equations where these are far from singular; where they are not, singular values."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(rows, 5))
    b = rng.normal(size=rows)
    np.testing.assert_allclose(
        solve_least_squares(A, b), np.linalg.solve(A.T @ A, A.T @ b), rtol=1e-10
    )
    A[:, 4] = A[:, 0]
    y = solve_least_squares(A, b)
    assert y[4] == pytest.approx(y[0], abs=1e-10)
    np.testing.assert_allclose(
        np.append(y[1:4], 2 * y[0]), np.linalg.lstsq(A[:, [1, 2, 3, 0]], b)[0], atol=1e-10
    )


def test_damping_is_that_of_the_normal_equations():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 6))
    b = rng.normal(size=4)
    expected = np.linalg.solve(A.T @ A + 0.3 * np.eye(6), A.T @ b)
    np.testing.assert_allclose(solve_damped_least_squares(A, b, 0.3), expected, atol=1e-12)


def test_the_root_of_a_quadratic_in_the_closed_form():
    """x^2 = a by Newton's method, and the number of its evaluations: what is left halves its digits
    each time.
    """
    calls = []

    def both(x):
        calls.append(float(x[0]))
        return x * x - 2.0, np.diag(2.0 * x)

    found = run_gauss_newton(both, np.array([1.0]), 50)
    assert found.x[0] == pytest.approx(math.sqrt(2.0), abs=3e-16) and len(calls) <= 7
    assert found.size == abs(found.x[0] ** 2 - 2.0)


def test_scipy_finds_the_same_minimum_where_no_solution_exists(hunt):
    """Circles and points that contradict each other: small residuals, where Gauss-Newton steps
    converge.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        centres = rng.normal(size=(5, 2))
        p = rng.normal(size=2)
        radii = np.linalg.norm(centres - p, axis=1) + 1e-3 * rng.normal(size=5)

        def both(x, centres=centres, radii=radii):
            d = x - centres
            far = np.linalg.norm(d, axis=1)
            return far - radii, d / far[:, None]

        found = run_gauss_newton(both, p, 60, last=1e-13)
        oracle = scipy_least_squares(
            lambda x, f=both: f(x)[0],
            p,
            lambda x, f=both: f(x)[1],
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        np.testing.assert_allclose(found.x, oracle.x, atol=1e-7)


def test_steps_from_many_starts_are_those_from_each(hunt):
    """Redundant arms: each lane as by itself, and on its target by the forward formula."""
    rng = hunt.rng()
    target = rng.uniform(-1.4, 1.4, (hunt.cases(200), 2))
    x = rng.uniform(-2.0, 2.0, (len(target), 4))

    def many(x, at):
        tip, J = arm(x)
        return tip - target[at], J

    found = run_many_gauss_newton(many, x, 60, longest=0.3)
    assert np.abs(arm(found)[0] - target).max() < 1e-12
    one = [
        run_many_gauss_newton(
            lambda y, _, k=k: many(y, np.array([k])), x[k : k + 1], 60, longest=0.3
        )[0]
        for k in range(len(x))
    ]
    np.testing.assert_allclose(found, one, atol=1e-9)


def test_what_is_not_finite_ends_alone():
    def both(x, at):
        return np.where(at[:, None] == 1, np.nan, x - 3.0), np.ones((len(x), 1, 1))

    np.testing.assert_array_equal(
        run_many_gauss_newton(both, np.zeros((3, 1)), 5), [[3.0], [np.nan], [3.0]]
    )
    found = run_gauss_newton(lambda x: (np.full(1, np.inf), np.eye(1)), np.ones(1), 5)
    assert found.x[0] == 1.0 and not found.size < np.inf


@pytest.mark.parametrize(
    ("options", "end"),
    [
        ({"longest": 0.5}, 1.5),
        ({"met": 3.0}, 0.0),
        ({"step": lambda x, r, J: np.ones(1)}, 3.0),
        ({}, 10.0),
        ({"last": 100.0}, 10.0),
        ({"step": lambda x, r, J: np.ones(1), "halving": True}, 1.0),
        ({"move": lambda x, y: x - y}, -70.0),
    ],
)
def test_what_the_options_do(options, end):
    """Three steps towards where 0.3 (x - 10) is zero; each end by hand."""
    found = run_gauss_newton(
        lambda x: (0.3 * (x - 10.0), np.full((1, 1), 0.3)), np.zeros(1), 3, **options
    )
    assert found.x[0] == pytest.approx(end)


def test_dependent_equations_do_no_harm(hunt):
    """The nearest point of a line in space, said by twice as many equations as it needs, by the
    exact projection.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(200)):
        A = rng.normal(size=(2, 3))
        M = np.concatenate([A, rng.normal(size=(2, 2)) @ A])
        b = rng.normal(size=3)
        x = rng.normal(size=3)
        found = run_gauss_newton(lambda x, M=M, b=b: (M @ (x - b), M), x, 5).x
        along = np.cross(A[0], A[1])
        np.testing.assert_allclose(
            found, b + along * (along @ (x - b)) / (along @ along), atol=1e-6
        )
