"""Lengths of many sizes in one chain: no joint is dropped, no foreign exception, and what is not
found is said so.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some

import kempe
from kempe.errors import KempeError

H = math.pi / 2

TABLES = {
    "ur5": [(0, H, 0.089159, 0), (-0.425, 0, 0, 0), (-0.39225, 0, 0, 0), (0, H, 0.10915, 0), (0, -H, 0.09465, 0),
            (0, 0, 0.0823, 0)],
    "puma560": [(0, -H, 0, 0), (0.4318, 0, 0.15, 0), (0.0203, -H, 0, 0), (0, H, 0.4318, 0), (0, -H, 0, 0),
                (0, 0, 0.056, 0)],
    "hc10": [(0, -H, 0.275, 0), (0.7, math.pi, 0, -H), (0, -H, 0, 0), (0, H, -0.5, 0), (0, -H, -0.162, 0),
             (0, math.pi, -0.17, 0)],
    "iiwa14": [(0, -H, 0.36, 0), (0, H, 0, 0), (0, H, 0.42, 0), (0, -H, 0, 0), (0, -H, 0.4, 0), (0, H, 0, 0),
               (0, 0, 0.126, 0)],
}  # fmt: skip
"""Standard Denavit-Hartenberg tables (a, alpha, d, theta) of arms with and without closed form, one
redundant."""

LENGTHS = [
    (name, row, column)
    for name, rows in TABLES.items()
    for row, values in enumerate(rows)
    for column in (0, 2)
    if values[column] != 0.0
]
"""Every length of the tables that is not zero."""


def scaled(name: str, row: int, column: int, factor: float) -> list[tuple[float, ...]]:
    """The table with one length times a factor."""
    rows = [list(r) for r in TABLES[name]]
    rows[row][column] *= factor
    return [tuple(r) for r in rows]


def arm(rows) -> kempe.System:
    return kempe.from_dh(
        [dict(zip(("a", "alpha", "d", "theta"), r, strict=True)) for r in rows]
    ).build()


def product(rows, q: np.ndarray) -> np.ndarray:
    """Poses (..., 4, 4) of the tip by the matrices of Denavit and Hartenberg."""
    T = np.eye(4)
    for i, (a, alpha, d, theta) in enumerate(rows):
        c = np.cos(q[..., i] + theta)
        s = np.sin(q[..., i] + theta)
        ca = math.cos(alpha)
        sa = math.sin(alpha)
        z = np.zeros_like(c)
        one = np.ones_like(c)
        link = [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [z, z + sa, z + ca, z + d],
            [z, z, z, one],
        ]
        T = T @ np.moveaxis(np.array(link), (0, 1), (-2, -1))
    return T


def off(rows, q: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """What poses miss (...): positions in tolerances of `ik`, or in 1e-7 of the longest length,
    angles in 2e-6.
    """
    error = np.abs(product(rows, q) - targets)
    error[..., :3, 3] /= 1e-7 * max(max(abs(r[0]), abs(r[2]), 10.0) for r in rows)
    error[..., :3, :3] /= 2e-6
    return error.max(axis=(-1, -2))


def assert_solved_or_said(name, row, column, power, number, rng):
    rows = scaled(name, row, column, 10.0**power)
    system = arm(rows)
    q = rng.uniform(-3.0, 3.0, (number, len(rows)))
    targets = product(rows, q)
    some = system.ik(targets, "tool")
    every = system.ik_all(targets, "tool")
    assert len(every.spare) == len(rows) - 6
    assert (off(rows, some.q, targets)[some.success] < 1.1).all()
    reached = off(rows, np.where(every.mask[..., None], every.q, 0.0), targets[:, None])
    assert (reached[every.mask] < 1.1).all()
    assert power < 9 or column == 2 and row == 0 or not every.complete.any()
    if -6 <= power <= 6:
        assert some.success.all() and every.mask.any(axis=1).all()
    for text in (*some.status[~some.success], *every.status[~every.mask.any(axis=1)]):
        assert "orders of magnitude" in text or "finer than rounding" in text, text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "row", "column", "power"),
    some(
        [
            ("hc10", 4, 2, 6),
            ("ur5", 5, 2, 12),
            ("ur5", 3, 2, 6),
            ("iiwa14", 6, 2, 6),
        ],
        3,
    ),
)
def test_one_length_far_from_the_others(name, row, column, power, hunt):
    """A joint was dropped, `ik` reached none of these poses, and one raised LinAlgError."""
    assert_solved_or_said(name, row, column, power, 2, hunt.rng())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "row", "column"), LENGTHS)
@pytest.mark.parametrize("power", [-12, -6, 6, 12])
def test_hunt_one_length_far_from_the_others(power, name, row, column, hunt):
    rng = hunt.rng()
    assert_solved_or_said(name, row, column, power, hunt.cases(2), rng)


@pytest.mark.slow
@pytest.mark.parametrize("power", some([30, 100, 200, 300, -300], 3))
@pytest.mark.parametrize(("row", "column"), [(0, 2), (1, 0), (5, 2)])
def test_no_foreign_exception(row, column, power):
    """Numbers whose squares do not exist are refused in words."""
    system = arm(scaled("hc10", row, column, 10.0**power))
    target = system.fk(np.full(6, 0.3), "tool")
    for verb in (system.ik, system.ik_all):
        try:
            answer = verb(target, "tool")
        except KempeError as error:
            assert power >= 30 and ("1e+100" in str(error) or "orders of magnitude" in str(error))
        else:
            assert isinstance(answer.status, str)


def test_bounds_and_misses_agree():
    """A pose within the sum of the lengths is not called outside for what rounding makes of it."""
    rows = scaled("ur5", 1, 0, 1e90)
    system = arm(rows)
    q = np.random.default_rng(2).uniform(-3.0, 3.0, (40, 6))
    assert not any(
        "outside the workspace" in s
        for s in np.atleast_1d(system.ik(product(rows, q), "tool").status)
    )


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e3, 1e6])
def test_units(unit):
    """The same arm in other units: as many solutions, with the same angles."""
    rows = [(a * unit, alpha, d * unit, theta) for a, alpha, d, theta in TABLES["puma560"]]
    q = np.random.default_rng(5).uniform(-3.0, 3.0, (20, 6))
    own = arm(rows)
    usual = arm(TABLES["puma560"])
    a = own.ik_all(product(rows, q), "tool", tolerance=1e-9 * max(unit, 1e-2))
    b = usual.ik_all(product(TABLES["puma560"], q), "tool")
    np.testing.assert_array_equal(a.mask, b.mask)
    np.testing.assert_allclose(a.q[a.mask], b.q[b.mask], atol=1e-6)


@pytest.mark.parametrize("length", [1e3, 2e4, 3e4, 5e4])
def test_all_solutions_of_an_arm_with_one_long_link(length):
    """The structure that solves the arm is found, though rounding of the long link blurs its
    angles.
    """
    s = kempe.load("ur5").with_parameters(d4=length)
    q = s.random(1, 60)
    answer = s.ik_all(s.fk(q, "tool"), "tool")
    off = np.abs((answer.q - q[:, None] + math.pi) % (2.0 * math.pi) - math.pi).max(axis=-1)
    off = np.where(answer.mask, off, math.inf).min(axis=1)
    assert np.sum(off > 1e-2) <= 1
    assert not np.any((off > 1e-3) & answer.complete)
    assert answer.complete.all() == (length < 1e4)
