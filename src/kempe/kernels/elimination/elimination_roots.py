"""The roots of the hidden joint one by one: which of them share a value, and whether each has a
posture of its own.

Roots and postures are matched one to one by the hidden joint's value. So where roots are close, or
the same, their number counts, and it does not matter from which of them Newton's steps came to a
posture.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device
from kempe.kernels.base.scratch import beyond
from kempe.kernels.elimination.elimination_polish import wrapped

ROOT = 3
ANGLE = 0
IMAGINARY = 1
STANDS_FOR = 2
"""Numbers of a root: value of the hidden joint, imaginary part (an angle each), what it stands
for."""

NONE = 0.0
OPTIONAL = 1.0
EXPECTED = 2.0
"""What a root stands for: no posture, at most one, one."""

REAL = 1e-7
DOUBT = 1e-3
NEARLY = 1e-2
"""Imaginary parts of angles: up to the first a root is real; up to the second a pair of postures
that are about to merge may hide behind it; up to the third it is tried, and a root belongs to a
posture whose value is so near."""

TOGETHER = 1e-6
"""Difference of roots, in radians, up to which three or more share a null space; and imaginary part
up to which a root must have a posture: the larger ones of ill-conditioned roots leave it open."""


FAR = 1e-5
"""Angle from pi at which a slide, whose angle is 2 atan d, is at infinity, where roots belong to no
posture."""


@device
def at_infinity(slides, angle):
    """Whether a joint's value is that of a slide at infinity."""
    return slides and abs(wrapped(angle - math.pi)) < FAR


@device
def write_roots(re, im, n, half, narrower, slides, roots):
    """Write n roots, with what they stand for by their imaginary parts, over `narrower`.

    re, im: the roots as the tangent of half their angle, zero at twice the angle `half`; NaN for
    one that is not known.
    """
    for i in range(n):
        t = re[i]
        root = beyond(roots, ROOT * i)
        root[IMAGINARY] = 2.0 * im[i] / (1.0 + t * t) / narrower
        size = abs(root[IMAGINARY])
        root[STANDS_FOR] = EXPECTED if size < TOGETHER else OPTIONAL if size < NEARLY else NONE
        root[ANGLE] = 2.0 * (half + math.atan2(t, 1.0)) if size < NEARLY else 0.0
        if at_infinity(slides, root[ANGLE]):
            root[STANDS_FOR] = NONE


@device
def is_with(roots, j, i):
    """Whether root j shares the value of root i, which is real."""
    d = roots[ROOT * j + ANGLE] - roots[ROOT * i + ANGLE]
    return abs(roots[ROOT * j + IMAGINARY]) < TOGETHER and abs(wrapped(d)) < TOGETHER


@device
def together(roots, n, i):
    """(number of roots that share the value of root i; whether one comes before it; mean difference
    from its value).
    """
    count = 0
    mean = 0.0
    met = False
    for j in range(n):
        if is_with(roots, j, i):
            count = count + 1
            mean = mean + wrapped(roots[ROOT * j + ANGLE] - roots[ROOT * i + ANGLE])
            met = met or j < i
    return count, met, mean / max(count, 1)


@device
def stand_for(roots, n, i, postures):
    """Mark the first `postures` of the roots that share the value of root i as EXPECTED, the others
    of them as NONE.
    """
    left = postures
    for j in range(n):
        if is_with(roots, j, i):
            roots[ROOT * j + STANDS_FOR] = EXPECTED if left > 0 else NONE
            left -= 1


@device
def expected(roots, n):
    """How many roots are expected to have a posture."""
    count = 0
    for i in range(n):
        count += int(roots[ROOT * i + STANDS_FOR] == EXPECTED)
    return count


@device
def matched(roots, n, angle):
    """Whether a root is left for a posture with this value of the hidden joint; the nearest is
    marked as used.
    """
    best = 0.0
    at = -1
    for i in range(n):
        what = roots[ROOT * i + STANDS_FOR]
        d = abs(wrapped(roots[ROOT * i + ANGLE] - angle))
        if what != NONE and d < NEARLY and what - d > best:
            best = what - d
            at = i
    if at < 0:
        return False
    roots[ROOT * at + STANDS_FOR] = NONE
    return True
