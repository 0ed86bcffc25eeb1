"""Lengths of a chain: their range of magnitudes, and how far the chain can reach."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kempe.arrays import compute_median
from kempe.kernels.forward.table_layout import (
    KIND,
    MULTIPLIER,
    SLIDE,
    TURN,
    V_INDEX,
    copy_placements,
    get_row_integers,
    get_row_numbers,
)
from kempe.spatial import Array

# ---- the span of lengths, and what of it double precision can carry

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

    def explain_rounding(self) -> str:
        """Write the warning about rounding for an answer that was not found."""
        return f"{self.format_ratio()}, and solutions may be missed"


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


# ---- bounds of the reach of a chain


class ReachBound(NamedTuple):
    """Bounds, from lengths alone, of the distance between a point of the frame and the ground."""

    centre: Array
    """The point of the ground (3,)."""
    largest: float
    smallest: float
    point: Array
    """The point of the frame (3,), in its axes: its origin, or one of the last axis."""


def compute_reach_bounds(ints: np.ndarray, floats: np.ndarray, limits: Array) -> list[ReachBound]:
    """Compute bounds of the reach of the tip, and of the last axis if its joint turns.

    A pose of the tip determines where the last axis is, and fewer lengths lead there.

    Of an axis that turns the best point counts: of the first the one nearest to the second joint,
    of the last the one nearest to the joint before.
    """
    table = get_row_integers(ints)
    rows = copy_placements(ints, floats)
    R = rows[..., :3]
    p = rows[..., 3].copy()
    n = len(table)
    kinds = table[:, KIND]
    start = p[0]
    slides = 0.0
    for row in np.flatnonzero(kinds == SLIDE):
        slides += float(
            np.max(
                np.abs(
                    get_row_numbers(ints, floats)[row, MULTIPLIER] * limits[:, table[row, V_INDEX]]
                )
            )
        )
    if n and kinds[0] == TURN:
        start = start + p[1, 2] * R[0, :, 2]
        p[1, 2] = 0.0
    out = [_compute_bound(start, p[1:], slides, bool(np.any(kinds == SLIDE)), np.zeros(3))]
    if n and kinds[-1] == TURN:
        along = 0.0
        if n > 2:
            axis = R[n - 1, :, 2]
            along = -float(p[n - 1] @ axis)
            p[n - 1] = p[n - 1] + along * axis
        point = R[n].T @ (np.array([0.0, 0.0, along]) - rows[n, :, 3])
        out.append(_compute_bound(start, p[1:n], slides, bool(np.any(kinds[:-1] == SLIDE)), point))
    return [b for b in out if math.isfinite(b.largest)]


def _compute_bound(
    start: Array, p: Array, slides: float, any_slide: bool, point: Array
) -> ReachBound:
    """Compute the bound from the lengths of steps p (n, 3) between joints."""
    lengths = np.sqrt((p * p).sum(axis=-1))
    total = float(lengths.sum()) + slides
    longest = 0.0 if any_slide else float(lengths.max(initial=0.0))
    return ReachBound(start, total, max(0.0, 2.0 * longest - total), point)


# ---- poses out of reach

ROUNDING = 1e-14
"""What rounding makes of lengths, in parts of them."""


def measure_bound_excess(
    bounds: Sequence[ReachBound],
    X: Array,
    tolerance: tuple[float, float],
    turned: bool = True,
    axes: Sequence[int] = (0, 1, 2),
    dim: int = 3,
    along: Array | None = None,
) -> Array:
    """Measure how far (..., 2) in metres poses X (..., 4, 4) of a frame exceed reach bounds.

    First as to the place, then together with the orientation, where that is `turned`, or points
    `along` an axis (3,) of the frame. `axes` of the pose are those along which its place counts:
    with fewer than `dim`, no place is too near. These are lower bounds of the error in its place;
    zero within the tolerances and what rounding makes of them.
    """
    linear, angular = tolerance
    out = np.zeros((*X.shape[:-2], 2))
    p = X[..., :3, 3]
    R = X[..., :3, :3]
    size = np.abs(p).max(axis=-1)
    for centre, largest, smallest, point in bounds:
        arm = float(np.linalg.norm(point))
        on_axis = along is not None and float(np.linalg.norm(np.cross(point, along))) < 1e-12 * arm
        if arm > 0.0 and not (turned or on_axis):
            continue
        away = p + R @ point - centre
        if len(axes) < 3:
            away = np.einsum("...ji,...j->...i", R, away)[..., list(axes)]
        far = np.linalg.norm(away, axis=-1)
        off = far - largest if len(axes) < dim else np.maximum(far - largest, smallest - far)
        k = int(arm > 0.0)
        slack = linear + arm * angular + ROUNDING * (largest + arm + size)
        out[..., k] = np.where(off > slack, np.maximum(out[..., k], off), out[..., k])
    return out
