"""Points of curves made of cubic pieces: the nearest to a place, and entries of tables
(`tape_layout`).
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.constraints.tape_layout import PIECE

SAMPLES = 4
"""Parts of a piece in which the nearest point is looked for."""
REFINEMENTS = 60
"""Most steps of the refinement."""


@device
def piece_of(n, s):
    """The piece of a parameter; the first or last beyond them."""
    return 0 if not s > 0.0 else n - 1 if s >= n else int(s)


@routine
def entry_of(floats, at, n, s):
    """The entry of a table of n numbers for a parameter."""
    return floats[at + piece_of(n, s)]


@device
def cubic(floats, at, u):
    """A polynomial, and its first two derivatives."""
    a = floats[at]
    b = floats[at + 1]
    c = floats[at + 2]
    d = floats[at + 3]
    return a + u * (b + u * (c + u * d)), b + u * (2.0 * c + u * (3.0 * d)), 2.0 * c + 6.0 * d * u


@routine
def square_to(floats, at, u, x, y, z):
    """Square of the distance from the point of a piece, and half its first two derivatives."""
    cx, dx, ddx = cubic(floats, at, u)
    cy, dy, ddy = cubic(floats, at + 4, u)
    cz, dz, ddz = cubic(floats, at + 8, u)
    ex = x - cx
    ey = y - cy
    ez = z - cz
    slope = -(ex * dx + ey * dy + ez * dz)
    return (
        ex * ex + ey * ey + ez * ez,
        slope,
        dx * dx + dy * dy + dz * dz - (ex * ddx + ey * ddy + ez * ddz),
    )


@routine
def refined(floats, p, low, high, x, y, z):
    """Where the distance from a piece is least between two parameters, at which it falls and grows."""
    u = 0.5 * (low + high)
    for _ in range(REFINEMENTS):  # Newton's method within a shrinking interval
        _, slope, bend = square_to(floats, p, u, x, y, z)
        if slope < 0.0:
            low = u
        else:
            high = u
        new = u - slope / bend if bend > 0.0 else math.inf
        if not (low <= new <= high):
            new = 0.5 * (low + high)
        step = abs(new - u)
        u = new
        if step <= 1e-16:
            break
    return u


@routine
def nearest_on_curve(floats, first, count, x, y, z):
    """The parameter of the point of a curve nearest to (x, y, z), its table being floats[first :
    first + count].
    """
    n = (count - 1) // PIECE
    endless = floats[first] != 0.0
    best = math.inf
    s = 0.0
    for i in range(n):
        p = first + 1 + PIECE * i
        far, before, bend = square_to(floats, p, 0.0, x, y, z)
        if endless and (i == 0 or i == n - 1):
            u = min(-before / bend, 1.0) if i == 0 else max(-before / bend, 0.0)
            far, _, _ = square_to(floats, p, u, x, y, z)
            if far < best:
                best = far
                s = i + u
            continue
        away = (
            math.sqrt(far) - floats[p + 12]
        )  # no point is nearer than the ball that contains the piece
        if away > 0.0 and away * away >= best:
            continue
        for k in range(SAMPLES):
            if far < best:
                best = far
                s = i + k / SAMPLES
            far, after, _ = square_to(floats, p, (k + 1) / SAMPLES, x, y, z)
            if before < 0.0 and after > 0.0:
                u = refined(floats, p, k / SAMPLES, (k + 1) / SAMPLES, x, y, z)
                least, _, _ = square_to(floats, p, u, x, y, z)
                if least < best:
                    best = least
                    s = i + u
            before = after
    return s
