"""Poses in the plane in registers of `LANES` configurations: what programs of dyads are made of.

A pose is (c, s, x, y): cosine and sine of the orientation, origin. A *pin* is the end of a revolute
joint (a point of a body), a *rail* that of a prismatic one (a point and a direction).
"""

from __future__ import annotations

from kempe.kernels.base._jit import device
from kempe.kernels.base.vectors import LANES, load_lanes, square_root, store, where
from kempe.kernels.dyads.dyads_layout import FLAG, GAP, MARGIN

TINY = 1e-14
"""Lengths below this share of the others count as zero: the direction along them would be
rounding."""


@device
def vector(v, place):
    """The vector at a place."""
    return load_lanes(v, LANES * place)


@device
def put(v, place, value):
    """Set the vector at a place to `value`."""
    store(v, LANES * place, value)


@device
def pose(v, place):
    """The pose in a register."""
    return vector(v, place), vector(v, place + 1), vector(v, place + 2), vector(v, place + 3)


@device
def put_pose(v, place, value):
    """Set the pose of a register."""
    put(v, place, value[0])
    put(v, place + 1, value[1])
    put(v, place + 2, value[2])
    put(v, place + 3, value[3])


@device
def times(a, b):
    """The pose a b."""
    c, s, x, y = a
    return (
        c * b[0] - s * b[1],
        s * b[0] + c * b[1],
        x + (c * b[2] - s * b[3]),
        y + (s * b[2] + c * b[3]),
    )


@device
def inverted(a):
    """The inverse of a pose."""
    c, s, x, y = a
    return c, -s, -(c * x + s * y), s * x - c * y


@device
def constant(floats, k):
    """The constant pose at floats[k:]."""
    return floats[k], floats[k + 1], floats[k + 2], floats[k + 3]


@device
def pin(v, place, floats, k):
    """The point of the body at `place`, in the axes of its cluster."""
    c, s, x, y = pose(v, place)
    px = floats[k]
    py = floats[k + 1]
    return x + (c * px - s * py), y + (s * px + c * py)


@device
def rail(v, place, floats, k):
    """The point and the direction of the body at `place`, in the axes of its cluster."""
    c, s, x, y = pose(v, place)
    px = floats[k]
    py = floats[k + 1]
    dx = floats[k + 2]
    dy = floats[k + 3]
    return x + (c * px - s * py), y + (s * px + c * py), c * dx - s * dy, s * dx + c * dy


@device
def unit(x, y):
    """(length, direction) of (x, y); the direction of a zero is (1, 0)."""
    n = square_root(x * x + y * y)
    zero = n == 0.0
    inverse = 1.0 / where(zero, 1.0, n)
    return n, where(zero, 1.0, x * inverse), y * inverse


@device
def positive(x):
    """x where it is positive, else 0, but NaN stays."""
    return where(0.0 > x, 0.0, x)


@device
def brought(ax, ay, c, s, bx, by):
    """The pose with orientation (c, s) that brings the body's point b to a."""
    return c, s, ax - (c * bx - s * by), ay - (s * bx + c * by)


@device
def flag(v, size, least):
    """Count the lanes in which `size` is not above `least`: they are undetermined."""
    put(v, FLAG, vector(v, FLAG) + where(size > least, 0.0, 1.0))


@device
def part_by(v, margin):
    """Count a dyad whose branches are as far apart as `margin`, the sine of the angle between its
    links, says.
    """
    least = vector(v, MARGIN)
    put(v, MARGIN, where(least > margin, margin, least))


@device
def open_by(v, square):
    """Add a squared opening."""
    put(v, GAP, vector(v, GAP) + square)
