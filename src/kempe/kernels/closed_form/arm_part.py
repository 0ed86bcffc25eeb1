"""Three joints that must bring a point or a plane back: the outer half of a closed-form inverse
model.

Where three consecutive axes meet in a point, or all lie across one plane, that point or plane does
not feel these joints. Along the loop that the target closes, the other three joints x, y, z then
have to satisfy

    E_y E_z e1 = E_x^-1 e0,     e0 the point or plane, e1 = G^-1 e0.

Two numbers of an element do not change under E_y: of a point, its height along the axis of y and
its squared distance from it; of a plane, the cosine of its normal with the axis and its distance
from a point of the axis; where y slides, two components across. So two equations are left, each a
sum of a term in x and a term in z (subproblem 6 of Elias and Wen, 2022; for points Pieper, 1968).
Where neighbouring axes meet or are parallel, one of them has one unknown only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import LINE_STRIDE, cross, dot, foot, minus, plus, three, turned
from kempe.kernels.closed_form.analytic_layout import PLANE
from kempe.kernels.closed_form.subproblems import (
    align,
    cone_roots,
    orbit,
    parabola_roots,
    trig_roots,
)
from kempe.kernels.forward.table_layout import SLIDE

VOID = 1e-10
NOTHING = 1e-13
WIDE = 1e-5
"""Amplitude below which an equation says so little that samples are taken as well, and below which
they are all there is; how far beyond its edge an equation is still tried (the residual decides)."""

VALUE_STRIDE = 4
SAMPLED = 3
"""A value of a joint: cosine and sine, or slide and its square; the variable; 1 if it was free and
is a sample, or OPEN if there is a root that it may lead to."""

FAINT = 1e-5
"""Size below which the square root of rounding leaves open what a joint does between others: values
are tried."""

SAMPLES = 4
MOST = 6
OPEN = 0.25
REPEATED = 1e-3
"""Samples of a joint that is free; values of one joint at most: samples after roots; marks in the
place of SAMPLED: of a sample that may lead to a root, and of a value that may lead to a root that
is a candidate already."""


class PointOrPlane(NamedTuple):
    """A point, or a plane with its unit normal `n` through `p`."""

    p: object
    n: object


@device
def carried(kind, h, o, e, c, s, theta):
    """The element moved by a joint."""
    if kind == SLIDE:
        return PointOrPlane(plus(e.p, theta, h), e.n)
    return PointOrPlane(plus(o, 1.0, turned(h, minus(e.p, o), c, s)), turned(h, e.n, c, s))


@device
def measures(kind, what, h, o, option, hx, kx, hz, kz):
    """Two vectors: what y measures. A turning y: its axis h and point; a sliding y: two directions
    across it.
    """
    if kind != SLIDE:
        return h, o
    other, slides = (hz, kz == SLIDE) if option == 0 else (hx, kx == SLIDE)
    across = cross(h, other)
    size = dot(across, across)
    if (
        what == PLANE
    ):  # the normal is constant: measured along the axis of a neighbour, which it turns about
        first = other
    elif size < 1e-18:
        first = cross(h, (0.0, 0.0, 1.0)) if abs(h[2]) < 0.8 else cross(h, (1.0, 0.0, 0.0))
    elif slides:
        first = across
    else:
        first = minus(other, plus((0.0, 0.0, 0.0), dot(other, h), h))
    first = plus((0.0, 0.0, 0.0), 1.0 / math.sqrt(dot(first, first)), first)
    second = cross(h, first)
    if what == PLANE and dot(second, second) < 1e-18:
        second = (
            cross(first, (0.0, 0.0, 1.0)) if abs(first[2]) < 0.8 else cross(first, (1.0, 0.0, 0.0))
        )
    return first, second


@routine
def terms(kind, h, o, e, sign, what, y_slides, first, second, out):
    """Write to out[0:3], out[3:6] the constant, first and second factor of both measures of the
    element under a joint.

    The factors belong to cos and sin of a turn, to d and d^2 of a slide; `sign` -1 for the inverse
    motion.
    """
    if kind == SLIDE:
        v = plus((0.0, 0.0, 0.0), sign, h)
        x = e.n if what == PLANE else e.p
        out[0] = dot(first, x)
        out[1] = 0.0 if what == PLANE else dot(first, v)
        out[2] = 0.0
        out[5] = 0.0
        if y_slides:
            out[3] = dot(second, x)
            out[4] = 0.0 if what == PLANE else dot(second, v)
        elif what == PLANE:
            out[3] = dot(e.n, minus(second, e.p))
            out[4] = -dot(e.n, v)
        else:
            r = minus(e.p, second)
            out[3] = dot(r, r)
            out[4] = 2.0 * dot(r, v)
            out[5] = 1.0
        return
    if what == PLANE:
        m, u, w = orbit(h, e.n)
    else:
        m, u, w = orbit(h, minus(e.p, o))
        m = plus(m, 1.0, o)
    out[0] = dot(first, m)
    out[1] = dot(first, u)
    out[2] = sign * dot(first, w)
    if y_slides:
        out[3] = dot(second, m)
        out[4] = dot(second, u)
        out[5] = sign * dot(second, w)
    elif what == PLANE:
        d = minus(second, o)
        out[3] = dot(m, d) + dot(e.n, minus(o, e.p))
        out[4] = dot(u, d)
        out[5] = sign * dot(w, d)
    else:
        d = minus(m, second)
        out[3] = dot(d, d) + dot(u, u)
        out[4] = 2.0 * dot(d, u)
        out[5] = 2.0 * sign * dot(d, w)


@device
def put(out, k, a, b, theta, sampled):
    """Write one value of a joint."""
    at = VALUE_STRIDE * k
    out[at] = a
    out[at + 1] = b
    out[at + 2] = theta
    out[at + SAMPLED] = sampled


@device
def put_angle(out, k, c, s, sampled):
    """Write one angle."""
    put(out, k, c, s, math.atan2(s, c), sampled)


@routine
def put_samples(slides, count, out, mark, centre):
    """New number of values of a joint that is free: a few more, of which no two differ by half a
    turn.

    centre: near which a slide has to be for the other joints to reach.
    """
    for k in range(SAMPLES):
        x = 0.35 - 1.3 * k + 0.37 * (k // 2)
        if slides:
            x += centre + 1.3
            put(out, count + k, x, x * x, x, mark)
        else:
            put_angle(out, count + k, math.cos(x), math.sin(x), mark)
    return count + SAMPLES


@routine
def one_unknown(slides, a, b, k, wide, centre, out):
    """Number of solutions of a f + b g = k, written to out; f, g = cos, sin of a turn, or d, d^2 of
    a slide.

    wide: how far beyond its edge the equation may be. centre: where a free slide is tried.
    """
    size = math.hypot(a, b)
    count = 0
    if size <= VOID and abs(k) > wide:
        return 0
    if size > NOTHING:
        if slides:
            x0, x1, d2 = parabola_roots(b, a, -k)
            if d2 < -wide * (size * size + abs(b * k)):
                return 0
            put(out, 0, x0, x0 * x0, x0, 0.0)
            put(out, 1, x1, x1 * x1, x1, 0.0)
            count = 1 if abs(b) <= 1e-14 * (size + abs(k)) else 2
        else:
            if abs(k) > size + wide:
                return 0
            c0, s0, c1, s1, _ = trig_roots(a, b, k)
            put_angle(out, 0, c0, s0, 0.0)
            put_angle(out, 1, c1, s1, 0.0)
            count = 2
    return put_samples(slides, count, out, 1.0, centre) if size <= VOID else count


@routine
def cone(k, h, n, w, sign, wide, out):
    """Number of turns about h (inverse turns for `sign` -1) that make the angle of n with k that of
    w with k.
    """
    c0, s0, c1, s1, d2 = cone_roots(k, h, n, w)
    a = cross(k, h)
    b = cross(h, n)
    size = math.sqrt(dot(a, a) * dot(b, b))
    count = 0
    if size <= VOID and abs(dot(k, w) - dot(k, n)) > wide:
        return 0
    if size > NOTHING:
        if d2 < -wide * size:
            return 0
        put_angle(out, 0, c0, sign * s0, 0.0)
        put_angle(out, 1, c1, sign * s1, 0.0)
        count = 2
    return put_samples(False, count, out, 1.0, 0.0) if size <= VOID else count


class Outer(NamedTuple):
    """The outer problem: joints x, y, z as (kind, h, o), elements, what is kept, the measures of y."""

    what: int
    kx: int
    hx: object
    ox: object
    ky: int
    hy: object
    oy: object
    kz: int
    hz: object
    oz: object
    e0: PointOrPlane
    e1: PointOrPlane
    first: object
    second: object


@device
def outer_of(what, kinds, lines, x, y, z, option, p0, n0, p1, n1):
    """The outer problem of the joints at places x, y, z of `lines`."""
    kx = kinds[x]
    ky = kinds[y]
    kz = kinds[z]
    hx = three(lines, LINE_STRIDE * x)
    ox = three(lines, LINE_STRIDE * x + 4)
    hy = three(lines, LINE_STRIDE * y)
    oy = three(lines, LINE_STRIDE * y + 4)
    hz = three(lines, LINE_STRIDE * z)
    oz = three(lines, LINE_STRIDE * z + 4)
    if option == 0:
        oy = foot(oy, hy, oz, hz)
    else:
        oy = foot(oy, hy, ox, hx)
    first, second = measures(ky, what, hy, oy, option, hx, kx, hz, kz)
    return Outer(
        what,
        kx,
        hx,
        ox,
        ky,
        hy,
        oy,
        kz,
        hz,
        oz,
        PointOrPlane(p0, n0),
        PointOrPlane(p1, n1),
        first,
        second,
    )


@device
def x_terms(o, out):
    """Write the terms of x, six numbers."""
    terms(o.kx, o.hx, o.ox, o.e0, -1.0, o.what, o.ky == SLIDE, o.first, o.second, out)


@device
def z_terms(o, out):
    """Write the terms of z, six numbers."""
    terms(o.kz, o.hz, o.oz, o.e1, 1.0, o.what, o.ky == SLIDE, o.first, o.second, out)


@device
def x_centre(o):
    """Where a sliding x brings its element nearest to y."""
    return dot(o.hx, minus(o.e0.p, o.oy))


@device
def z_centre(o):
    """Where a sliding z brings its element nearest to y."""
    return dot(o.hz, minus(o.oy, o.e1.p))


@device
def cones(o, j, kind):
    """Whether measure j is the angle of a plane's normal with a turning y, under a turning joint."""
    return o.what == PLANE and j == 0 and o.ky != SLIDE and kind != SLIDE


@routine
def first_values(o, mode, j, tx, tz, out):
    """Number of values of the joint that measure j determines alone."""
    k = 3 * j
    if mode == 0:
        if cones(o, j, o.kx):
            return cone(o.hy, o.hx, o.e0.n, o.e1.n, -1.0, WIDE, out)
        return one_unknown(
            o.kx == SLIDE, tx[k + 1], tx[k + 2], tz[k] - tx[k], WIDE, x_centre(o), out
        )
    if cones(o, j, o.kz):
        return cone(o.hy, o.hz, o.e1.n, o.e0.n, 1.0, WIDE, out)
    return one_unknown(o.kz == SLIDE, tz[k + 1], tz[k + 2], tx[k] - tz[k], WIDE, z_centre(o), out)


@routine
def second_values(o, mode, j, tx, tz, first, out):
    """Number of values of the other joint, given those of the first: measure 1 - j."""
    k = 3 - 3 * j
    if mode == 0:
        e = carried(o.kx, o.hx, o.ox, o.e0, first[0], -first[1], -first[2])
        if cones(o, 1 - j, o.kz):
            return cone(o.hy, o.hz, o.e1.n, e.n, 1.0, WIDE, out)
        known = tx[k] + tx[k + 1] * first[0] + tx[k + 2] * first[1]
        return one_unknown(
            o.kz == SLIDE, tz[k + 1], tz[k + 2], known - tz[k], WIDE, z_centre(o), out
        )
    e = carried(o.kz, o.hz, o.oz, o.e1, first[0], first[1], first[2])
    if cones(o, 1 - j, o.kx):
        return cone(o.hy, o.hx, o.e0.n, e.n, -1.0, WIDE, out)
    known = tz[k] + tz[k + 1] * first[0] + tz[k + 2] * first[1]
    return one_unknown(o.kx == SLIDE, tx[k + 1], tx[k + 2], known - tx[k], WIDE, x_centre(o), out)


@routine
def middle_values(o, x, z, out):
    """Number of values of y once x and z are known: one, or samples where it is free."""
    left = carried(o.kx, o.hx, o.ox, o.e0, x[0], -x[1], -x[2])
    right = carried(o.kz, o.hz, o.oz, o.e1, z[0], z[1], z[2])
    if o.ky == SLIDE:
        d = minus(left.p, right.p)
        nearest = dot(o.hy, d)
        t = nearest
        slope = 1.0
        if o.what == PLANE:
            slope = abs(dot(left.n, o.hy))
            t = dot(left.n, d) / dot(left.n, o.hy) if slope > NOTHING else nearest
        put(out, 0, t, t * t, t, 0.0)
        count = 1 if slope > NOTHING else 0
        return (
            count
            if slope > FAINT
            else put_samples(True, count, out, OPEN if slope > VOID else 1.0, nearest)
        )
    u, v = (right.n, left.n) if o.what == PLANE else (minus(right.p, o.oy), minus(left.p, o.oy))
    c, s, size = align(o.hy, u, v)
    size = math.sqrt(size)
    count = 0
    if size > NOTHING:
        put_angle(out, 0, c, s, 0.0)
        count = 1
    if size > FAINT:
        return count
    return put_samples(False, count, out, OPEN if size > VOID else 1.0, 0.0)
