"""Directions spread evenly over the sphere."""

from __future__ import annotations

import numpy as np

from kempe.spatial import Array


def spread_directions(n: int) -> Array:
    """Spread unit vectors (n, 3) evenly over the sphere, in a Fibonacci lattice.

    Source: Swinbank and Purser, Q. J. R. Meteorol. Soc. 132 (2006); Gonzalez, Mathematical
    Geosciences 42 (2010).
    """
    i = np.arange(n) + 0.5
    z = 1.0 - 2.0 * i / n
    turn = np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
