"""Power series whose coefficients are enclosed, rounding included.

What is computed with them is proven. A coefficient is any number within a radius of a middle (ball
arithmetic: van der Hoeven, "Ball arithmetic", 2009), the k-th one f^(k)(x) / k! of a function f, at
every x of an interval at once. So the first coefficient bounds the values of f on that interval,
the second its slopes (Moore, *Interval Analysis*, 1966). What is not known has an infinite radius.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kempe.spatial import Array

UNIT = 4.0 * float(np.finfo(float).eps)
"""Bound of the relative error of a few operations, with a margin."""

LEAST = 1e-300
"""Added to each radius, for numbers so small that their relative error is larger."""


class Enclosure:
    """Series with middles and radii (order + 1, n) of their coefficients, for n intervals."""

    __slots__ = ("mid", "rad")
    __array_ufunc__ = None

    def __init__(self, mid: Array, rad: Array):
        """Widen the radii (order + 1, n) by the rounding of one operation that gave them and the
        middles.
        """
        rad = rad * (1.0 + UNIT) + UNIT * np.abs(mid) + LEAST
        bad = ~(np.isfinite(mid) & np.isfinite(rad))
        self.mid, self.rad = (
            (np.where(bad, 0.0, mid), np.where(bad, np.inf, rad)) if bad.any() else (mid, rad)
        )

    @property
    def low(self) -> Array:
        """Lower bounds (n,) of the values."""
        return self.mid[0] - self.rad[0]

    @property
    def high(self) -> Array:
        """Upper bounds (n,) of the values."""
        return self.mid[0] + self.rad[0]

    def __add__(self, other: Enclosure | float | Array) -> Enclosure:
        if isinstance(other, Enclosure):
            return Enclosure(self.mid + other.mid, self.rad + other.rad)
        mid = self.mid.copy()
        mid[0] += other
        return Enclosure(mid, self.rad)

    def __neg__(self) -> Enclosure:
        return Enclosure(-self.mid, self.rad)

    def __sub__(self, other: Enclosure | float | Array) -> Enclosure:
        return self + (-other)

    def __rsub__(self, other: float | Array) -> Enclosure:
        return (-self) + other

    def __mul__(self, other: Enclosure | float | Array) -> Enclosure:
        if not isinstance(other, Enclosure):
            with np.errstate(invalid="ignore"):
                return Enclosure(self.mid * other, self.rad * np.abs(other))
        return _joined(
            [_sum(self.terms, other.terms, range(k + 1), k) for k in range(len(self.mid))]
        )

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other: Enclosure) -> Enclosure:
        """The quotient, unknown where the divisor may be zero."""
        a = self.terms
        b = other.terms
        out = list[Enclosure]()
        one = _inverse(b[0])
        for k in range(len(a)):
            out.append(_times(a[k] - _sum(out, b, range(k), k) if k else a[0], one))
        return _joined(out)

    def root(self) -> Enclosure:
        """The square root of what is not negative; its slopes are unknown where that may be zero."""
        a = self.terms
        (low, high) = (np.sqrt(np.maximum(x, 0.0)) for x in (self.low, self.high))
        out = [Enclosure((0.5 * (low + high))[None], (0.5 * (high - low) + UNIT * high)[None])]
        half = _inverse(out[0] * 2.0)
        for k in range(1, len(a)):
            out.append(_times(a[k] - _sum(out, out, range(1, k), k) if k > 1 else a[1], half))
        return _joined(out)

    @property
    def terms(self) -> list[Enclosure]:
        """The coefficients, each by itself."""
        return [_raw(self.mid[k : k + 1], self.rad[k : k + 1]) for k in range(len(self.mid))]


def interval(low: Array, high: Array, order: int) -> Enclosure:
    """The variable itself on the intervals from `low` (n,) to `high` (n,)."""
    mid = np.zeros((order + 1, len(low)))
    rad = np.zeros((order + 1, len(low)))
    mid[0] = 0.5 * (low + high)
    rad[0] = 0.5 * (high - low)
    mid[1:2] = 1.0
    return Enclosure(mid, rad)


def constant(values: Array, order: int, error: Array | float = 0.0) -> Enclosure:
    """Constants (n,), each up to an `error`."""
    mid = np.zeros((order + 1, len(values)))
    rad = np.zeros_like(mid)
    mid[0] = values
    rad[0] = error
    return Enclosure(mid, rad)


def cos_sin(x: Enclosure) -> tuple[Enclosure, Enclosure]:
    """Cosine and sine of a series that is linear, as of an angle that turns evenly."""
    c = np.cos(x.mid[0])
    s = np.sin(x.mid[0])
    h = x.rad[0]
    m = x.mid[1:2].sum(axis=0)
    near: list[tuple[Array, Array]] = []
    for value, slope in ((c, s), (s, c)):
        near.append((value, np.minimum(np.abs(slope) * h + 0.5 * h * h, 2.0) + UNIT))
    (c, dc), (s, ds) = near
    out: tuple[list[Enclosure], list[Enclosure]] = ([], [])
    turns = ((c, dc, s, ds), (-s, ds, c, dc), (-c, dc, -s, ds), (s, ds, -c, dc))
    factor = np.ones_like(m)
    for k in range(len(x.mid)):
        factor = factor * m / max(k, 1) if k else factor
        cos, rc, sin, rs = turns[k % 4]
        more = 4.0 * k * UNIT  # rounding of the factor
        out[0].append(Enclosure((cos * factor)[None], ((rc + more) * np.abs(factor))[None]))
        out[1].append(Enclosure((sin * factor)[None], ((rs + more) * np.abs(factor))[None]))
    return _joined(out[0]), _joined(out[1])


def _raw(mid: Array, rad: Array) -> Enclosure:
    out = Enclosure.__new__(Enclosure)
    out.mid = mid
    out.rad = rad
    return out


def _joined(terms: Sequence[Enclosure]) -> Enclosure:
    return _raw(np.concatenate([t.mid for t in terms]), np.concatenate([t.rad for t in terms]))


def _times(a: Enclosure, b: Enclosure) -> Enclosure:
    """The product of two numbers."""
    with np.errstate(invalid="ignore"):
        return Enclosure(a.mid * b.mid, np.abs(a.mid) * b.rad + a.rad * (np.abs(b.mid) + b.rad))


def _sum(a: list[Enclosure], b: list[Enclosure], which: range, k: int) -> Enclosure:
    """The sum of a_i b_(k - i)."""
    out = _times(a[which[0]], b[k - which[0]])
    for i in which[1:]:
        out = out + _times(a[i], b[k - i])
    return out


def _inverse(a: Enclosure) -> Enclosure:
    """One through a number."""
    size = np.abs(a.mid)
    least = np.abs(a.mid) - a.rad * (1.0 + UNIT)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Enclosure(
            np.where(least > 0.0, 1.0 / a.mid, np.inf), a.rad / (size * least) * (1.0 + UNIT)
        )
