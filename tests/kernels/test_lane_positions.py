"""Random configurations and their cells, beside numpy's."""

import numpy as np
import pytest
from primitive_tables import all_forms, random_table
from scipy import stats

from kempe.kernels.compiled import lane_positions
from kempe.kernels.forward.table_layout import BALL, GENERAL, SLIDE

MASK = 2**64 - 1
KEYS = np.arange(1, 40, dtype=np.int64) * 1234567890123456789


def unit(key, counter):
    """SplitMix64 (Steele, Lea and Flood 2014) in whole numbers of Python, the upper 52 bits."""
    z = (int(key) + 0x9E3779B97F4A7C15 * (counter + 1)) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return ((z ^ (z >> 31)) >> 12) * 2.0**-52


def drawn(table, bounds, first, n):
    """The configurations (n, nq) of the samples from `first` on."""
    u = np.array(
        [[unit(key, k) for key in KEYS[: table.nq]] for k in range(first, first + n)]
    ).reshape(n, table.nq)
    q = bounds[: table.nq, 0] + bounds[: table.nq, 1] * u
    for row in (r for r in table.rows if r.kind == BALL):
        a = u[:, row.iq]
        b = 2.0 * np.pi * u[:, row.iq + 1]
        c = 2.0 * np.pi * u[:, row.iq + 2]
        small = np.sqrt(1.0 - a)
        large = np.sqrt(a)
        parts = small * np.sin(b), small * np.cos(b), large * np.sin(c), large * np.cos(c)
        q[:, row.iq : row.iq + 4] = np.stack(parts, axis=-1)
    return q


def limits(rng, nq):
    low = rng.uniform(-2, 2, nq)
    return np.ascontiguousarray(np.c_[low, rng.uniform(0, 3, nq)])


def positions_of(table, q):
    return np.array([table.poses(x)[0][:3, 3] for x in q]).reshape(-1, 3)


@pytest.mark.parametrize("first", [0, 5, 10**12])
@pytest.mark.parametrize("n", [1, 8, 37])
@pytest.mark.parametrize("seed", range(6))
def test_samples_are_a_function_of_key_and_number(seed, n, first):
    rng = np.random.default_rng(seed)
    table = random_table(rng, 6, chain=True, forms=all_forms())
    bounds = limits(rng, table.nq)
    out = np.full((n, 3), 7.0)
    lane_positions.sample_positions(*table.pack(), KEYS[: table.nq], bounds, first, out)
    assert np.abs(out - positions_of(table, drawn(table, bounds, first, n))).max() < 1e-12


@pytest.mark.parametrize("n", [0, 1, 255, 256, 700])
def test_cells_are_those_of_numpy(n):
    rng = np.random.default_rng(3)
    table = random_table(rng, 4, chain=True, forms=all_forms())
    bounds = limits(rng, table.nq)
    points = np.empty((n, 3))
    lane_positions.sample_positions(*table.pack(), KEYS[: table.nq], bounds, 9, points)
    grid = np.array([[-1.0, 3.0, 6], [-0.5, 4.0, 5], [-2.0, 2.0, 7]])
    counts = np.zeros(6 * 5 * 7 // 2 + 1, dtype=np.int64)
    lane_positions.count_cells(*table.pack(), KEYS[: table.nq], bounds, 9, n, grid, counts)
    edges = [low + np.arange(int(k) + 1) / by for low, by, k in grid]
    wanted = np.histogramdd(points, bins=edges)[0].ravel()
    found = counts.view(np.uint32)[: 6 * 5 * 7 + 1]
    assert found[:-1].tolist() == wanted.tolist() and found.sum() == n


def test_counts_of_pieces_add_up():
    rng = np.random.default_rng(4)
    table = random_table(rng, 6, chain=True, forms=all_forms())
    bounds = limits(rng, table.nq)
    grid = np.array([[-2.0, 2.0, 8]] * 3)
    whole, parts = np.zeros((2, 8**3 // 2 + 1), dtype=np.int64)
    arguments = (*table.pack(), KEYS[: table.nq], bounds)
    lane_positions.count_cells(*arguments, 0, 5000, grid, whole)
    for first, n in ((0, 1), (1, 1337), (1338, 3662)):
        lane_positions.count_cells(*arguments, first, n, grid, parts)
    assert np.array_equal(whole, parts) and whole.view(np.uint32).sum() == 5000


def test_a_slide_is_uniform():
    """By Kolmogorov and Smirnov, at 1 %."""
    rng = np.random.default_rng(5)
    table = random_table(rng, 1, chain=True, kinds=(SLIDE,), forms=(GENERAL,))
    row = table.rows[0]
    out = np.empty((20000, 3))
    bounds = np.tile([0.0, 1.0 / abs(row.multiplier)], (table.nq, 1))
    lane_positions.sample_positions(*table.pack(), KEYS[: table.nq], bounds, 0, out)
    away = np.linalg.norm(out - positions_of(table, [np.zeros(table.nq)]), axis=1)
    assert stats.kstest(away, "uniform").pvalue > 0.01


def test_a_ball_turns_uniformly():
    """A point at rest in the ball is uniform on a sphere: so are its three coordinates
    (Archimedes).
    """
    rng = np.random.default_rng(6)
    table = random_table(rng, 1, chain=True, kinds=(BALL,), forms=(GENERAL,))
    out = np.empty((20000, 3))
    lane_positions.sample_positions(
        *table.pack(), KEYS[: table.nq], np.zeros((table.nq, 2)), 0, out
    )
    away = out - table.rows[0].X[:3, 3]
    radius = np.linalg.norm(away, axis=1).mean()
    assert all(stats.kstest(0.5 + 0.5 * x / radius, "uniform").pvalue > 0.01 for x in away.T)
