"""Three joints whose joint motion is known: three axes through a point, or three joints of one
plane.

Both have two solutions. A rotation as three turns about given axes: the generalised Euler angles
(Davenport, 1973; Piovan and Bullo, 2012). A planar motion as three turns across the plane: the
triangle of a two-link arm; slides take the place of turns.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import cross, dot, mapped, minus, plus, rotated, turned, unmapped
from kempe.kernels.closed_form.arm_part import (
    NOTHING,
    VALUE_STRIDE,
    VOID,
    cone,
    one_unknown,
    put,
    put_angle,
)
from kempe.kernels.closed_form.subproblems import align, orbit, triangle, trig_roots_of
from kempe.kernels.forward.table_layout import SLIDE

LOST = -1
"""In place of a number of solutions: parallel slides leave none or infinitely many, which is not
decided here."""

ANY = 1e3
"""How far beyond its edge the equation of the inner joints is tried where an outer joint is a
sample: others may do."""


@device
def across(h):
    """A unit vector perpendicular to the unit vector h."""
    other = (0.0, 0.0, 1.0) if abs(h[2]) < 0.8 else (1.0, 0.0, 0.0)
    n = cross(h, other)
    return plus((0.0, 0.0, 0.0), 1.0 / math.sqrt(dot(n, n)), n)


@device
def put_turn(h, u, v, out, k):
    """Whether it is determined; writes the angle about h that brings u towards v, else 0."""
    c, s, size = align(h, u, v)
    if math.sqrt(size) <= NOTHING:
        put_angle(out, k, 1.0, 0.0, 1.0)
        return False
    put_angle(out, k, c, s, 0.0)
    return True


@device
def value(out, k):
    """Cosine and sine, or slide and its square, of value k."""
    return out[VALUE_STRIDE * k], out[VALUE_STRIDE * k + 1]


@routine
def ball_triple(ha, hb, hc, d, wide, work, out):
    """Number of ways to write the rotation of d as turns about ha, hb, hc; three values each in
    out.
    """
    w = rotated(d, hc)
    count = cone(ha, hb, hc, w, 1.0, wide, work)
    for k in range(count):
        c, s = value(work, k)
        at = 3 * k
        put_angle(out, at + 1, c, s, work[VALUE_STRIDE * k + 3])
        u = turned(hb, hc, c, s)
        put_turn(ha, u, w, out, at)
        ca, sa = value(out, at)
        r = across(hc)
        back = turned(hb, turned(ha, rotated(d, r), ca, -sa), c, -s)
        put_turn(hc, r, back, out, at + 2)
    return count


@device
def flat(h, v):
    """The part of v across h."""
    return minus(v, plus((0.0, 0.0, 0.0), dot(h, v), h))


@routine
def planar_point(h, ka, ha, oa, kb, hb, ob, p, goal, wide, work, out):
    """Number of ways to bring p to goal, both across h, by joint a after joint b; values a, b of
    each at 3k, 3k + 1.
    """
    if ka == SLIDE and kb == SLIDE:
        d = flat(h, minus(goal, p))
        n = cross(ha, hb)
        det = dot(h, n)
        if abs(det) <= VOID:
            return LOST
        x = dot(h, cross(d, hb)) / det
        y = dot(h, cross(ha, d)) / det
        put(out, 0, x, x * x, x, 0.0)
        put(out, 1, y, y * y, y, 0.0)
        return 1
    if ka == SLIDE:
        r = flat(h, minus(p, ob))
        g = flat(h, minus(goal, ob))
        count = one_unknown(True, -2.0 * dot(g, ha), 1.0, dot(r, r) - dot(g, g), wide, 0.0, work)
    elif kb == SLIDE:
        r = flat(h, minus(p, oa))
        g = flat(h, minus(goal, oa))
        count = one_unknown(True, 2.0 * dot(r, hb), 1.0, dot(g, g) - dot(r, r), wide, 0.0, work)
    else:
        m, u, w = orbit(hb, minus(p, ob))
        r = flat(h, plus(minus(m, oa), 1.0, ob))
        g = flat(h, minus(goal, oa))
        r1 = math.sqrt(dot(r, r))
        r2 = math.sqrt(dot(u, u))
        rho2 = dot(g, g)
        a = 2.0 * dot(r, u)
        b = 2.0 * dot(r, w)
        k = rho2 - r1 * r1 - r2 * r2
        count = one_unknown(False, a, b, k, wide, 0.0, work)
        if count == 2:
            c0, s0, c1, s1, _ = trig_roots_of(a, b, k, triangle(r1, r2, rho2))
            put_angle(work, 0, c0, s0, 0.0)
            put_angle(work, 1, c1, s1, 0.0)
    for k in range(count):
        a, b = value(work, k)
        at = VALUE_STRIDE * k
        if ka == SLIDE:
            put(out, 3 * k, a, a * a, a, work[at + 3])
            put_turn(
                hb,
                flat(h, minus(p, ob)),
                flat(h, minus(minus(goal, ob), plus((0.0, 0.0, 0.0), a, ha))),
                out,
                3 * k + 1,
            )
            continue
        for i in range(VALUE_STRIDE):
            out[VALUE_STRIDE * (3 * k + 1) + i] = work[at + i]
        there = plus(p, a, hb) if kb == SLIDE else plus(ob, 1.0, turned(hb, minus(p, ob), a, b))
        put_turn(ha, flat(h, minus(there, oa)), flat(h, minus(goal, oa)), out, 3 * k)
    return count


@routine
def planar_forward(h, ka, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out):
    """Number of ways to write the planar motion d by joints a, b and a turn c."""
    count = planar_point(h, ka, ha, oa, kb, hb, ob, oc, mapped(d, oc), wide, work, out)
    r = across(hc)
    for k in range(count):
        x = rotated(d, r)
        if ka != SLIDE:
            c, s = value(out, 3 * k)
            x = turned(ha, x, c, -s)
        if kb != SLIDE:
            c, s = value(out, 3 * k + 1)
            x = turned(hb, x, c, -s)
        put_turn(hc, r, x, out, 3 * k + 2)
    return count


@routine
def planar_backward(h, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out):
    """The same where c slides and a turns: the inverse motion, joints in reverse order."""
    count = planar_point(
        h,
        SLIDE,
        minus((0.0, 0.0, 0.0), hc),
        oc,
        kb,
        minus((0.0, 0.0, 0.0), hb),
        ob,
        oa,
        unmapped(d, oa),
        wide,
        work,
        out,
    )
    r = across(ha)
    for k in range(count):
        for i in range(VALUE_STRIDE):
            out[VALUE_STRIDE * (3 * k + 2) + i] = out[VALUE_STRIDE * 3 * k + i]
        x = r
        if kb != SLIDE:
            c, s = value(out, 3 * k + 1)
            x = turned(hb, r, c, -s)
        put_turn(ha, r, rotated(d, x), out, 3 * k)
    return count


@routine
def planar_swing(h, ha, hb, ob, hc, d, out):
    """The one way to write the planar motion d by a slide, a turn and a slide; LOST where the
    slides are parallel.
    """
    r = across(hb)
    put_turn(hb, r, rotated(d, r), out, 1)
    c, s = value(out, 1)
    v = turned(hb, hc, c, s)
    shift = flat(h, minus(mapped(d, ob), ob))
    det = dot(h, cross(ha, v))
    if abs(det) <= VOID:
        return LOST
    x = dot(h, cross(shift, v)) / det
    y = dot(h, cross(ha, shift)) / det
    put(out, 0, x, x * x, x, 0.0)
    put(out, 2, y, y * y, y, 0.0)
    return 1


@routine
def planar_triple(ka, ha, oa, kb, hb, ob, kc, hc, oc, d, wide, work, out):
    """Number of ways to write the planar motion d by three joints of the plane; three values each
    in out.
    """
    h = hc if kc != SLIDE else ha if ka != SLIDE else hb
    # the part of d that leaves the plane belongs to a target out of reach: the residual says so
    if kc != SLIDE:
        return planar_forward(h, ka, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out)
    if ka != SLIDE:
        return planar_backward(h, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out)
    return planar_swing(h, ha, hb, ob, hc, d, out)
