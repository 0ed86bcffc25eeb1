"""What proves that there is no answer, as data: `bool` says whether it does, `text` says it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe import words
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.common.serial_chain import ReachBound

ROUNDING = 1e-14
"""What rounding makes of lengths, in parts of them."""


class Lengths(NamedTuple):
    """A target is outside of what the lengths of the links reach, by at least so many metres; 0 where it is not.

    `place` is whatever its orientation, `turned` together with its orientation, `plane` out of the plane of the system.
    """

    place: float = 0.0
    turned: float = 0.0
    plane: float = 0.0

    def __bool__(self) -> bool:
        return max(self) > 0.0

    @property
    def text(self) -> str:
        """The proof as a sentence; '' where nothing is proven."""
        if self.plane > 0.0:
            return words.off_plane(self.plane)
        return words.out_of_reach(self.place, self.turned) if self else ""


class Limits(NamedTuple):
    """All `count` configurations that reach a target are outside limits, or slides end `short` metres before it."""

    count: int = 0
    short: float = 0.0

    def __bool__(self) -> bool:
        return self.count > 0 or self.short > 0.0

    @property
    def text(self) -> str:
        """The proof as a sentence; '' where nothing is proven."""
        if self.short > 0.0:
            return f"slides end {self.short:.6g} m before it"
        if not self.count:
            return ""
        one = "the only configuration that reaches it is outside"
        return one if self.count == 1 else f"all {self.count} configurations that reach it are outside"


class LowRank(NamedTuple):
    """What is requested has more `equations` than what moves has `freedoms`: it holds by chance only."""

    equations: int
    freedoms: int

    def __bool__(self) -> bool:
        return self.freedoms < self.equations

    @property
    def text(self) -> str:
        """The proof as a sentence; '' where there are enough freedoms."""
        return f"{self.equations} equations, but {words.counted(self.freedoms, 'freedom')}" if self else ""


def by_lengths(
    bounds: Sequence[ReachBound], X: Array, tolerance: tuple[float, float], turned: bool = True,
    axes: Sequence[int] = (0, 1, 2), dim: int = 3, along: Array | None = None,
) -> Array:  # fmt: skip
    """How far (..., 2) in metres poses X (..., 4, 4) of a frame are past the bounds of its chain.

    First as to the place, then together with the orientation, where that is `turned`, or points `along` an axis (3,) of
    the frame. `axes` of the pose are those along which its place counts: with fewer than `dim`, no place is too near.
    These are lower bounds of the error in its place; zero within the tolerances and what rounding makes of them.
    """
    linear, angular = tolerance
    out = np.zeros((*X.shape[:-2], 2))
    p, R = X[..., :3, 3], X[..., :3, :3]
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
