"""Curves that a point can be held on: by splines through points, or by functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.errors import InputError
from kempe.kernels.layout import SLIDE
from kempe.kinematics.derivatives import COMPLEX, IMAGINARY_STEP, REAL_STEP, SUPPLIED, way_of
from kempe.model.layout import layout_of
from kempe.reals import reals
from kempe.spatial import Array

SAMPLES = 256
"""Points of a curve that are compared before the nearest one is refined."""
REFINEMENTS = 40
"""Most steps of the refinement."""
SECOND_STEP = 1e-5
"""Step, in parts of the span, of the central differences of an exact first derivative."""
SAME_POINT = 1e-12
"""Distance, in parts of the extent of a curve, of points that are one."""

CurveFunction = Callable[[Array], Array]
"""Takes parameters (n,), gives points or derivatives (n, 3)."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve c(s) for s in `span`, with first and second derivatives; `how` says where the first comes from."""

    point: CurveFunction
    first: CurveFunction
    second: CurveFunction
    span: tuple[float, float]
    closed: bool
    how: str

    def nearest(self, p: Array) -> Array:
        """Parameters (n,) of the nearest points to p (n, 3), wrapped into the span where it is closed."""
        low, high = self.span
        grid = np.linspace(low, high, SAMPLES + 1)
        squares = np.sum((p[:, None] - self.point(grid)) ** 2, axis=-1)
        s, step = grid[np.argmin(squares, axis=1)], (high - low) / SAMPLES
        a, b = s - step, s + step
        if not self.closed:
            a, b = np.maximum(a, low), np.minimum(b, high)
        for _ in range(REFINEMENTS):  # Newton's method within a shrinking interval
            e, c1 = p - self.point(self._wrapped(s)), self.first(self._wrapped(s))
            slope = -np.sum(e * c1, axis=-1)
            bend = np.sum(c1 * c1, axis=-1) - np.sum(e * self.second(self._wrapped(s)), axis=-1)
            a, b = np.where(slope < 0.0, s, a), np.where(slope > 0.0, s, b)
            with np.errstate(invalid="ignore", divide="ignore"):
                new = s - slope / bend
            good = (bend > 0.0) & (new >= a) & (new <= b)
            new = np.where(slope == 0.0, s, np.where(good, new, 0.5 * (a + b)))
            done = np.abs(new - s) <= 1e-16 * (high - low)
            s = new
            if np.all(done):
                break
        return self._wrapped(s)

    def _wrapped(self, s: Array) -> Array:
        low, high = self.span
        return low + (s - low) % (high - low) if self.closed else s

    def distances(self, p: Array, planar: bool = False) -> tuple[Array, Array]:
        """Distances (..., 2), in the plane (..., 1), of points p (..., 3) from the curve along its normals, and their
        derivatives (..., 2, 3) by p, exact off the curve, too.
        """  # fmt: skip
        flat = p.reshape(-1, 3)
        s = self.nearest(flat)
        e, c1, c2 = flat - self.point(s), self.first(s), self.second(s)
        speed = np.linalg.norm(c1, axis=-1, keepdims=True)
        t = c1 / speed
        dt = (c2 - np.sum(c2 * t, axis=-1, keepdims=True) * t) / speed  # by s
        normals, d_normals = _plane_normals(t, dt) if planar else _normals(t, dt)
        ds = c1 / (speed**2 - np.sum(e * c2, axis=-1, keepdims=True))  # by p, from (p - c) . c' = 0
        if not self.closed:
            end = (s <= self.span[0]) | (s >= self.span[1])
            ds = np.where(end[:, None], 0.0, ds)
        value = np.einsum("nij,nj->ni", normals, e)
        slope = np.einsum("nij,nj->ni", d_normals, e)  # n . c' = 0
        rates = normals + slope[:, :, None] * ds[:, None, :]
        m = normals.shape[1]
        return value.reshape(*p.shape[:-1], m), rates.reshape(*p.shape[:-1], m, 3)


def _plane_normals(t: Array, dt: Array) -> tuple[Array, Array]:
    """The normal (n, 1, 3) of a tangent in the plane, and its derivative."""
    left = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    return (t @ left.T)[:, None], (dt @ left.T)[:, None]


def _normals(t: Array, dt: Array) -> tuple[Array, Array]:
    """Two normals (n, 2, 3) of tangents: x and y turned by the smallest rotation from z, or -z, to t; derivatives."""
    sign = np.where(t[:, 2] < 0.0, -1.0, 1.0)[:, None]
    (x, y, z), (dx, dy, dz) = (sign * t).T, (sign * dt).T
    k, dk = 1.0 / (1.0 + z), -dz / (1.0 + z) ** 2
    normals = np.stack([
        np.stack([1.0 - k * x * x, -k * x * y, -x], axis=-1), np.stack([-k * x * y, 1.0 - k * y * y, -y], axis=-1),
    ], axis=1)  # fmt: skip
    xy = -dk * x * y - k * (dx * y + x * dy)
    d_normals = np.stack([
        np.stack([-dk * x * x - 2.0 * k * x * dx, xy, -dx], axis=-1),
        np.stack([xy, -dk * y * y - 2.0 * k * y * dy, -dy], axis=-1),
    ], axis=1)  # fmt: skip
    return normals, d_normals


def curve_through(points: ArrayLike, closed: bool = False) -> Curve:
    """The cubic spline through points (n, 2 or 3), by the length of its chords; a closed one ends where it starts.

    The first point of a closed curve need not be repeated. Errors: `InputError` for fewer than 4 points (3 of a
    closed curve), equal neighbours, or numbers that are not finite.
    """
    from scipy.interpolate import CubicSpline

    given = reals(points, "points")
    if given.ndim != 2 or given.shape[1] not in (2, 3) or not np.isfinite(given).all():
        raise InputError(f"points have shape {given.shape}; they must be (n, 2) or (n, 3), and finite")
    same = SAME_POINT * np.max(np.ptp(given, axis=0), initial=0.0) if len(given) else 0.0
    if closed and len(given) > 1 and np.linalg.norm(given[0] - given[-1]) <= same:
        given = given[:-1]
    least = 3 if closed else 4
    if len(given) < least:
        raise InputError(f"{len(given)} points; a {'closed' if closed else 'open'} curve needs {least} at least")
    given = np.pad(given, ((0, 0), (0, 3 - given.shape[1])))
    if closed:
        given = np.concatenate([given, given[:1]])
    chords = np.linalg.norm(np.diff(given, axis=0), axis=1)
    if chords.min() <= same:
        raise InputError(f"points {np.argmin(chords)} and {np.argmin(chords) + 1} are equal; neighbours must differ")
    s = np.concatenate([[0.0], np.cumsum(chords)])
    spline = CubicSpline(s, given, bc_type="periodic" if closed else "not-a-knot")
    return Curve(spline, spline.derivative(1), spline.derivative(2), (0.0, float(s[-1])), closed, "spline")


def curve_of(
    function: Callable[[Any], Any], span: tuple[float, float], closed: bool = False,
    derivative: Callable[[Any], Any] | None = None,
) -> Curve:  # fmt: skip
    """The curve of a function s -> (x, y, z) or (x, y), which is called with one number at a time.

    Its tangent is `derivative`, or found by complex steps where the function takes complex numbers, else by central
    differences; `Curve.how` says which. Errors: `InputError` for a span that is none, points that are none.
    """
    low, high = float(span[0]), float(span[1])
    if not (np.isfinite([low, high]).all() and low < high):
        raise InputError(f"span is ({low:g}, {high:g}); it must be two finite numbers, the lower first")
    middle = low + 0.377 * (high - low)
    size = np.shape(function(middle))
    if size not in ((2,), (3,)):
        raise InputError(f"the curve gives an array of shape {size}; it must be (x, y) or (x, y, z)")

    def padded(f: Callable[[Any], Any]) -> CurveFunction:
        return lambda s: np.array([(*f(x), 0.0)[:3] for x in np.atleast_1d(s).tolist()], dtype=float)

    point = padded(function)
    layout = layout_of([(SLIDE, 0, 0)], 1, 1)
    how = SUPPLIED if derivative else way_of(lambda q: function(q[0]), layout, np.array([middle]))
    h = REAL_STEP * (high - low)
    exact = derivative or (lambda s: np.imag(function(s + 1j * IMAGINARY_STEP)) / IMAGINARY_STEP)
    rough: CurveFunction = lambda s: (point(s + h) - point(s - h)) / (2.0 * h)  # noqa: E731
    first = padded(exact) if derivative or how == COMPLEX else rough
    # a first derivative by differences is too rough to be differenced by a small step
    wide = (SECOND_STEP if derivative or how == COMPLEX else 1e-3) * (high - low)

    def second(s: Array) -> Array:
        return (first(s + wide) - first(s - wide)) / (2.0 * wide)

    return Curve(point, first, second, (low, high), closed, how)
