"""Real roots of polynomials up to degree four, double ones included, and two equations in two joint
variables.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import beyond
from kempe.kernels.closed_form.arm_part import (
    FAINT,
    MOST,
    REPEATED,
    VALUE_STRIDE,
    VOID,
    WIDE,
    one_unknown,
    put,
    put_angle,
)
from kempe.kernels.closed_form.subproblems import TINY

TURNS = 60
ENOUGH = 1e-15
"""Iterations at most, and the relative change at which they end."""

NEARLY_REAL = 1e-4
"""Imaginary part, relative to the size of the root, that rounding can give a double root."""

SMALL = 1e-3
"""Size of a row of factors from which it counts in full; lengths are in units of the chain's."""


@device
def value_and_slope(p, x):
    """p(x) and p'(x) of a polynomial of degree four, p[k] the factor of x^k."""
    v = p[4] + 0.0 * x
    d = 0.0 * x
    for k in range(3, -1, -1):
        d = d * x + v
        v = v * x + p[k]
    return v, d


@routine
def quartic_roots(p, roots):
    """Number of real roots of p[0] + ... + p[4] x^4, written to roots (4): double ones twice, p[4]
    not zero.

    All four roots together by the method of Ehrlich (1967) and Aberth (1973), from points on a
    circle.
    """
    size = 0.0
    for k in range(4):
        if p[k] != 0.0:
            size = max(size, abs(p[k] / p[4]) ** (1.0 / (4 - k)))
    if size == 0.0:
        for k in range(4):
            roots[k] = 0.0
        return 4
    a = complex(0.9 * size, 0.25 * size)
    b = complex(-0.3 * size, 0.95 * size)
    c = complex(-0.85 * size, -0.4 * size)
    d = complex(0.35 * size, -1.0 * size)
    for _ in range(TURNS):
        change = 0.0
        for _root in range(4):
            v, slope = value_and_slope(p, a)
            others = 0.0j
            for z in (b, c, d):
                gap = a - z
                if gap != 0.0:
                    others += 1.0 / gap
            bottom = slope - v * others
            step = v / bottom if bottom != 0.0 else 0.0j
            change = max(change, abs(step))
            a, b, c, d = b, c, d, a - step
        if change <= ENOUGH * size:
            break
    count = 0
    for z in (a, b, c, d):
        if abs(z.imag) <= NEARLY_REAL * (abs(z) + 1e-3 * size):
            roots[count] = z.real
            count += 1
    return count


@device
def eliminated(t, other):
    """(P0, P1, P2), two numbers each: both factors of one joint as P0 + P1 f + P2 g of the other's."""
    det = t[1] * t[5] - t[2] * t[4]
    a = t[5] / det
    b = -t[2] / det
    c = -t[4] / det
    d = t[1] / det
    x = other[0] - t[0]
    y = other[3] - t[3]
    return (
        (a * x + b * y, c * x + d * y),
        (a * other[1] + b * other[4], c * other[1] + d * other[4]),
        (a * other[2] + b * other[5], c * other[2] + d * other[5]),
    )


@device
def steadiness(t):
    """Sine of the angle between the two rows of factors of one joint, 0 to 1; less where a row is
    below SMALL.
    """
    size = max(math.hypot(t[1], t[2]), SMALL) * max(math.hypot(t[4], t[5]), SMALL)
    return abs(t[1] * t[5] - t[2] * t[4]) / size


@device
def faint(t):
    """Whether a joint hardly moves what is measured: rounding of the square roots then leaves its
    value open.
    """
    return math.hypot(t[1], t[2]) + math.hypot(t[4], t[5]) < FAINT


@routine
def pairs_of(gone_slides, kept_slides, gone, kept, work, out_gone, out_kept):
    """Number of pairs of values that satisfy both equations, the joint `gone` eliminated; up to
    four.

    gone, kept: terms of the two joints. Both factors f, g of `gone` are linear in those of `kept`;
    f^2 + g^2 = 1 for a turn, g = f^2 for a slide, is then a polynomial of degree four in the slide
    or in the tangent of the half angle.
    """
    p0, p1, p2 = eliminated(gone, kept)
    if gone_slides:  # f^2 - g
        q00 = p0[0] * p0[0] - p0[1]
        q10 = 2.0 * p0[0] * p1[0] - p1[1]
        q01 = 2.0 * p0[0] * p2[0] - p2[1]
        q20 = p1[0] * p1[0]
        q11 = 2.0 * p1[0] * p2[0]
        q02 = p2[0] * p2[0]
    else:
        q00 = p0[0] * p0[0] + p0[1] * p0[1] - 1.0
        q10 = 2.0 * (p0[0] * p1[0] + p0[1] * p1[1])
        q01 = 2.0 * (p0[0] * p2[0] + p0[1] * p2[1])
        q20 = p1[0] * p1[0] + p1[1] * p1[1]
        q02 = p2[0] * p2[0] + p2[1] * p2[1]
        q11 = 2.0 * (p1[0] * p2[0] + p1[1] * p2[1])
    p = work
    roots = work
    quarter = 0
    if kept_slides:
        p[0] = q00
        p[1] = q10
        p[2] = q01 + q20
        p[3] = q11
        p[4] = q02
    # the angle is counted from a quarter turn for which half a turn, the infinite tangent, is far
    # from a root
    else:
        sizes = (
            abs(q00 - q10 + q20),
            abs(q00 - q01 + q02),
            abs(q00 + q10 + q20),
            abs(q00 + q01 + q02),
        )
        for k in range(1, 4):
            if sizes[k] > sizes[quarter]:
                quarter = k
        for _ in range(quarter):  # f, g -> -g, f
            q10, q01, q20, q11, q02 = q01, -q10, q02, -q11, q20
        p[0] = q00 + q10 + q20
        p[1] = 2.0 * (q01 + q11)
        p[2] = 2.0 * q00 - 2.0 * q20 + 4.0 * q02
        p[3] = 2.0 * (q01 - q11)
        p[4] = q00 - q10 + q20
    if abs(p[4]) <= VOID * (abs(p[0]) + abs(p[1]) + abs(p[2]) + abs(p[3])):
        p[4] = VOID * (abs(p[0]) + abs(p[1]) + abs(p[2]) + abs(p[3])) + 1e-300
    count = quartic_roots(p, roots)
    found = 0
    for k in range(count):
        x = roots[k]
        if kept_slides:
            f = x
            g = x * x
        else:
            n = 1.0 / (1.0 + x * x)
            f = (1.0 - x * x) * n
            g = 2.0 * x * n
            for _ in range(quarter):
                f, g = -g, f
        u = p0[0] + p1[0] * f + p2[0] * g
        v = p0[1] + p1[1] * f + p2[1] * g
        size = math.hypot(u, v)
        if not gone_slides and size < 0.5 and not faint(gone):
            continue
        at = out_kept
        if kept_slides:
            put(at, found, f, g, f, 0.0)
        else:
            put_angle(at, found, f, g, 0.0)
        if gone_slides:
            put(out_gone, found, u, u * u, u, 0.0)
        else:
            put_angle(out_gone, found, u / max(size, TINY), v / max(size, TINY), 0.0)
        found += 1
    return found


@device
def coupled_pairs(x_slides, z_slides, tx, tz, work, out_x, out_z):
    """Number of pairs of values of x and z that satisfy both outer equations; writes them to out_x
    and out_z.
    """
    if steadiness(tx) >= steadiness(tz):
        return pairs_of(x_slides, z_slides, tx, tz, work, out_x, out_z)
    return pairs_of(z_slides, x_slides, tz, tx, work, out_z, out_x)


UNCOUPLED = 1e-2
"""What a joint may add to the equation of the other, relative to its part in its own, for these to
be solved apart."""


@device
def least_row(t):
    """The combination (2) of the two rows of factors of one joint that has the least of this joint."""
    p = t[1] * t[1] + t[2] * t[2]
    q = t[1] * t[4] + t[2] * t[5]
    r = t[4] * t[4] + t[5] * t[5]
    angle = 0.5 * math.atan2(2.0 * q, p - r)
    return -math.sin(angle), math.cos(angle)


@device
def combined(w, t):
    """Constant, first and second factor of one joint in a combination of both equations."""
    return w[0] * t[0] + w[1] * t[3], w[0] * t[1] + w[1] * t[4], w[0] * t[2] + w[1] * t[5]


@device
def amplitude(row):
    """The size of the factors of a joint in one equation."""
    return math.hypot(row[1], row[2])


@device
def uncoupled(tx, tz):
    """Whether a combination of the equations has hardly anything of z, and another one hardly
    anything of x.

    The polynomial of degree four then nearly is a square: its roots lie in pairs, which rounding
    moves by its root, and with each root the other joint has two values, between which the pair
    decides.
    """
    without_x = least_row(tx)
    without_z = least_row(tz)
    x_alone = amplitude(combined(without_z, tx))
    z_alone = amplitude(combined(without_x, tz))
    z_left = amplitude(combined(without_z, tz))
    x_left = amplitude(combined(without_x, tx))
    return (
        x_left < UNCOUPLED * x_alone
        and z_left < UNCOUPLED * z_alone
        and min(x_alone, z_alone) > FAINT
    )


@routine
def uncoupled_pairs(x_slides, z_slides, tx, tz, x_centre, z_centre, work, out_x, out_z):
    """Number of pairs of values of x and z, up to four, that satisfy both equations where these are
    `uncoupled`.

    Either has one unknown if the little that the other joint adds is left out of that for x: pairs
    to be polished.
    """
    without_x = least_row(tx)
    without_z = least_row(tz)
    x = combined(without_z, tx)
    z = combined(without_z, tz)
    own_x = combined(without_x, tx)
    own_z = combined(without_x, tz)
    firsts = work
    seconds = beyond(work, VALUE_STRIDE * MOST)
    found = 0
    for i in range(one_unknown(x_slides, x[1], x[2], z[0] - x[0], WIDE, x_centre, firsts)):
        first = beyond(firsts, VALUE_STRIDE * i)
        known = own_x[0] + own_x[1] * first[0] + own_x[2] * first[1]
        for j in range(
            one_unknown(z_slides, own_z[1], own_z[2], known - own_z[0], WIDE, z_centre, seconds)
        ):
            second = beyond(seconds, VALUE_STRIDE * j)
            put(out_x, found, first[0], first[1], first[2], REPEATED)
            put(out_z, found, second[0], second[1], second[2], 0.0)
            found += 1
    return found


WORK = 5
"""Numbers of `work` that the roots of one polynomial take."""
