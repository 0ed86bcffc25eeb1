"""Lengths of a chain: their range of magnitudes, and what of it double precision can carry."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.arrays import compute_median
from kempe.kernels.forward.table_layout import copy_placements
from kempe.spatial import Array

NOISE = 1e-14
"""Parts of an offset that are rounding: cos(pi / 2) of a length, say."""

NOTHING = 1e-12
"""Parts of a middling length of the chain that are no length."""

EVEN = 1e3
SQUEEZED = 3.0
"""Ratio of lengths to their median from which a chain is uneven, and to which they are brought
then."""

WIDE = 1e5
"""Ratio of lengths from which solutions are searched for and polished with care."""

AWAY = 1e8
"""Largest lengths of the chain that its base may be from the origin, likewise."""

BLUR = 100.0
"""Roundings of an angle, in units of the square of the ratio of lengths: seen are up to 10."""

EPSILON = float(np.finfo(float).eps)


class Span(NamedTuple):
    """Smallest and largest length between the joints of a chain and to its tip, in metres.

    Both are 0 where there is no length.

    `middle` is the median of the steps from joint to joint, `away` how far from the ground's origin
    the first stands.
    """

    smallest: float
    largest: float
    middle: float
    away: float

    @property
    def wide(self) -> bool:
        """Whether lengths differ so much that rounding errors may spoil answers.

        Small ones do no harm: calibrated arms have some that are nearly zero.
        """
        return self.largest >= WIDE * self.middle > 0.0 or self.away > AWAY * self.largest > 0.0

    @property
    def rounding(self) -> float:
        """Rounding error of positions, in metres."""
        return 16.0 * EPSILON * max(self.largest, self.away)

    @property
    def blur(self) -> float:
        """Rounding error of angles, which grows where one long link makes short links imprecise."""
        return BLUR * EPSILON * (self.largest / self.middle) ** 2 if self.middle > 0.0 else 0.0

    def format_ratio(self) -> str:
        """Format the ratio of the lengths, and the rounding error of positions."""
        largest = max(self.largest, self.away)
        orders = math.log10(largest) - math.log10(self.smallest)
        what = "the distance of the base" if self.away > self.largest else "the longest"
        return (
            f"lengths from {self.smallest:.3g} m to {largest:.3g} m, {what}, span {orders:.0f} "
            "orders of magnitude, of which double precision keeps 16: positions are known to "
            f"{self.rounding:.1g} m"
        )


def measure_span(ints: np.ndarray, floats: np.ndarray) -> Span:
    """Measure the smallest and largest length of a packed chain."""
    p = np.abs(compute_offsets(ints, floats))
    away = float(p[0].max())
    p = p[1:]
    p = p[p.max(axis=1) > NOISE * p.max(initial=0.0)]
    if not p.any():
        return Span(0.0, 0.0, 0.0, away)
    return Span(float(p[p > 0.0].min()), float(p.max()), compute_median(p.max(axis=1)), away)


def compute_offsets(ints: np.ndarray, floats: np.ndarray) -> Array:
    """Compute the offsets (n + 1, 3) of the joints and the tip, each from the joint before.

    Rounding errors are set to zero.
    """
    p = copy_placements(ints, floats)[..., 3]
    return np.where(np.abs(p) > NOISE * np.abs(p).max(axis=1, keepdims=True), p, 0.0)


def even_out_offsets(ints: np.ndarray, floats: np.ndarray) -> Array | None:
    """Compute offsets (n + 1, 3) of a chain with the same axes and lengths of similar size.

    None where no length is far from the others.

    What freedoms a chain has does not depend on how large its lengths are, only on which are zero:
    so they are counted with lengths of one size. The first joint stands at the origin.
    """
    p = compute_offsets(ints, floats)
    p[0] = 0.0
    steps = np.abs(p).max(axis=1)
    if not steps.any():
        return None
    middle = compute_median(steps[steps > NOISE * steps.max()])
    p = np.where(np.abs(p) > NOTHING * middle, p, 0.0)
    sizes = np.abs(p[np.nonzero(p)])
    if middle / EVEN <= sizes.min() and sizes.max() <= middle * EVEN:
        return None
    return np.sign(p) * np.where(
        p == 0.0, 0.0, np.clip(np.abs(p), middle / SQUEEZED, middle * SQUEEZED)
    )
