"""Directions over the sphere: how near they are to each other and to any other direction."""

from __future__ import annotations

import numpy as np
import pytest

from kempe.numerics.directions import spread_directions


@pytest.mark.parametrize("n", [1, 10, 400, 3000])
def test_directions_are_near_everywhere_and_nowhere_crowded(n):
    """A cap of the sphere with radius r holds n r^2 / 4 directions, if they are spread evenly."""
    directions = spread_directions(n)
    assert directions.shape == (n, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=0, atol=1e-15)
    probes = np.random.default_rng(0).normal(size=(500, 3))
    probes /= np.linalg.norm(probes, axis=1, keepdims=True)
    distance = np.linalg.norm(probes[:, None] - directions, axis=-1)
    assert distance.min(axis=1).max() < 3.0 / np.sqrt(n)
    own = np.linalg.norm(directions[:, None] - directions, axis=-1) + 9.0 * np.eye(n)
    assert own.min() > 2.5 / np.sqrt(n)
