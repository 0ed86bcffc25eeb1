"""All candidates of a six-joint chain with three consecutive joints that leave a point or a plane
in place.

Joints are counted around the loop that the goal closes: the three before the inner ones, taken
round the goal, are the outer ones. Nothing is decided here: candidates are polished and judged by
whoever calls.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import INT, OUT, F, I
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    cross,
    dot,
    follow,
    identity,
    minus,
    plus,
    three,
    unmapped,
    unrotated,
    write3,
)
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.closed_form.analytic_layout import AT_REST, COUPLED, PLANE, POINT, Z_FIRST
from kempe.kernels.closed_form.arm_part import (
    FAINT,
    NOTHING,
    OPEN,
    REPEATED,
    SAMPLED,
    VALUE_STRIDE,
    WIDE,
    first_values,
    middle_values,
    outer_of,
    put_samples,
    second_values,
    x_centre,
    x_terms,
    z_centre,
    z_terms,
)
from kempe.kernels.closed_form.quartic import (
    coupled_pairs,
    faint,
    steadiness,
    uncoupled,
    uncoupled_pairs,
)
from kempe.kernels.closed_form.wrist_part import ANY, ball_triple, planar_triple
from kempe.kernels.forward.table_layout import SLIDE

CANDIDATE = 8
SLOT = 6
SAMPLE = 7
"""Numbers of a candidate: six variables; its slot by signs; 1 if it has a sample of a free joint,
less if that may lead to a root, REPEATED if it may be one of those before."""

DEPENDENT = 1e-7
"""Steadiness of both outer joints below which their two equations are nearly one."""

MOST_CANDIDATES = 192
"""Candidates at most."""

AT_LINES = 0
AT_TERMS = 48
AT_X = 60
AT_Z = 84
AT_Y = 108
AT_INNER = 132
AT_WORK = 204
AT_MOTION = 228
AT_DOUBT = 240
AT_SOME = 241
AT_APART = 265
SCRATCH = 313
"""Places in the scratch: lines round the loop, terms, values of x, z, y and the inner joints, work,
a motion, doubt, samples, values of two equations that are solved apart."""


@device
def meeting_point(lines, a, b):
    """The point halfway between the nearest points of two lines that are not parallel."""
    h = three(lines, LINE_STRIDE * a)
    o = three(lines, LINE_STRIDE * a + 4)
    g = three(lines, LINE_STRIDE * b)
    p = three(lines, LINE_STRIDE * b + 4)
    n = cross(h, g)
    d = minus(p, o)
    square = dot(n, n)
    x = dot(cross(d, g), n) / square
    y = dot(cross(d, h), n) / square
    return plus(plus((0.0, 0.0, 0.0), 0.5, plus(o, x, h)), 0.5, plus(p, y, g))


@device
def ball_centre(lines, k):
    """Where the axes k, k + 1, k + 2 meet; neighbours may coincide with none of the others only."""
    h = three(lines, LINE_STRIDE * k)
    g = three(lines, LINE_STRIDE * (k + 1))
    n = cross(h, g)
    if dot(n, n) > 1e-6:
        return meeting_point(lines, k, k + 1)
    return meeting_point(lines, k + 1, k + 2)


@routine
def loop_lines(lines, goal, first, out):
    """Write the lines to out, those of joints before `first` taken round the goal: mapped by its
    inverse.
    """
    for i in range(6):
        at = LINE_STRIDE * i
        h = three(lines, at)
        o = three(lines, at + 4)
        if i < first:
            h = unrotated(goal, h)
            o = unmapped(goal, o)
        write3(out, at, h)
        write3(out, at + 4, o)


@device
def plane_normal(kinds, lines, k):
    """The normal of the plane in which joints k, k + 1, k + 2 move, and a point of it."""
    for i in range(k, k + 3):
        if kinds[i] != SLIDE:
            return three(lines, LINE_STRIDE * i), three(lines, LINE_STRIDE * i + 4)
    return three(lines, LINE_STRIDE * k), three(lines, LINE_STRIDE * k + 4)


@routine
def inner_values(kinds, lines, goal, k, what, x, y, z, scratch):
    """Number of solutions of the inner joints, given values of the outer ones; three values each."""
    d = beyond(scratch, AT_MOTION)
    around = beyond(scratch, AT_LINES)
    identity(d)
    # I3 = G (Ex Ey Ez)^-1, built from the right: d = G Ez^-1 Ey^-1 Ex^-1
    for i in range(12):
        d[i] = goal[i]
    for i in range(3):
        j = (k + 5 - i) % 6
        v = z if i == 0 else y if i == 1 else x
        at = LINE_STRIDE * j
        follow(d, three(around, at), three(around, at + 4), kinds[j] == SLIDE, -v[2], v[0], -v[1])
    a = LINE_STRIDE * k
    b = LINE_STRIDE * (k + 1)
    c = LINE_STRIDE * (k + 2)
    work = beyond(scratch, AT_WORK)
    out = beyond(scratch, AT_INNER)
    wide = ANY if x[SAMPLED] + y[SAMPLED] + z[SAMPLED] > REPEATED else WIDE
    if what == POINT:
        return ball_triple(three(lines, a), three(lines, b), three(lines, c), d, wide, work, out)
    return planar_triple(
        kinds[k],
        three(lines, a),
        three(lines, a + 4),
        kinds[k + 1],
        three(lines, b),
        three(lines, b + 4),
        kinds[k + 2],
        three(lines, c),
        three(lines, c + 4),
        d,
        wide,
        work,
        out,
    )


@routine
def emit(kinds, lines, goal, k, what, x, y, z, slot, scratch, out, count):
    """New number of candidates, after those that belong to one set of outer values."""
    n = inner_values(kinds, lines, goal, k, what, x, y, z, scratch)
    if n < 0:
        scratch[AT_DOUBT] = 1.0
    inner = beyond(scratch, AT_INNER)
    for i in range(n):
        if count >= MOST_CANDIDATES:
            break
        at = CANDIDATE * count
        sampled = x[SAMPLED] + y[SAMPLED] + z[SAMPLED]
        for j in range(3):
            out[at + k + j] = inner[VALUE_STRIDE * (3 * i + j) + 2]
            sampled += inner[VALUE_STRIDE * (3 * i + j) + SAMPLED]
        out[at + (k + 3) % 6] = x[2]
        out[at + (k + 4) % 6] = y[2]
        out[at + (k + 5) % 6] = z[2]
        out[at + SLOT] = 2 * slot + i % 2
        out[at + SAMPLE] = min(sampled, 1.0)
        count += 1
    return count


@routine
def with_middles(kinds, lines, goal, k, outer, x, z, slot, scratch, out, count):
    """New number of candidates, after those for one pair of values of x and z."""
    y = beyond(scratch, AT_Y)
    for i in range(middle_values(outer, x, z, y)):
        count = emit(
            kinds,
            lines,
            goal,
            k,
            outer.what,
            x,
            beyond(y, VALUE_STRIDE * i),
            z,
            slot,
            scratch,
            out,
            count,
        )
    return count


@device
def nearly_silent(t):
    """Whether an equation says hardly anything of a joint: that there is no solution is then not to
    be trusted.
    """
    a = math.hypot(t[1], t[2])
    b = math.hypot(t[4], t[5])
    return NOTHING < a < FAINT or NOTHING < b < FAINT


@routine
def closed_candidates(kinds, lines, goal, k, what, mode, measure, option, scratch, out):
    """(number of candidates, doubt) for E_1 ... E_6 = G, CANDIDATE numbers each in out.

    In doubt are goals for which the equations degenerate in a way that is not taken apart here.

    k: place of the first inner joint; what: POINT or PLANE; mode, measure, option: how the outer
    equations are solved, see `arm_part`. scratch: SCRATCH numbers.
    """
    around = beyond(scratch, AT_LINES)
    loop_lines(lines, goal, k, around)
    xs = beyond(scratch, AT_X)
    zs = beyond(scratch, AT_Z)
    scratch[AT_DOUBT] = 0.0
    if mode == AT_REST:
        for i in range(VALUE_STRIDE):
            xs[i] = 1.0 if i == 0 else 0.0
        count = emit(kinds, lines, goal, k, what, xs, xs, xs, 0, scratch, out, 0)
        return count, scratch[AT_DOUBT] != 0.0
    n, p = (
        plane_normal(kinds, lines, k) if what == PLANE else (three(lines, 0), ball_centre(lines, k))
    )
    outer = outer_of(
        what,
        kinds,
        around,
        (k + 3) % 6,
        (k + 4) % 6,
        (k + 5) % 6,
        option,
        p,
        n,
        unmapped(goal, p),
        unrotated(goal, n),
    )
    tx = beyond(scratch, AT_TERMS)
    tz = beyond(scratch, AT_TERMS + 6)
    x_terms(outer, tx)
    z_terms(outer, tz)
    count = 0
    if mode == COUPLED:
        pairs = coupled_pairs(
            outer.kx == SLIDE, outer.kz == SLIDE, tx, tz, beyond(scratch, AT_WORK), xs, zs
        )
        for i in range(pairs):
            x = beyond(xs, VALUE_STRIDE * i)
            z = beyond(zs, VALUE_STRIDE * i)
            # the roots of a quartic have no names: a slot below zero
            count = with_middles(kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count)
            some = beyond(scratch, AT_SOME)
            if faint(tx):
                for j in range(put_samples(outer.kx == SLIDE, 0, some, OPEN, x[2])):
                    x = beyond(some, VALUE_STRIDE * j)
                    count = with_middles(
                        kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
                    )
            elif faint(tz):
                for j in range(put_samples(outer.kz == SLIDE, 0, some, OPEN, z[2])):
                    z = beyond(some, VALUE_STRIDE * j)
                    count = with_middles(
                        kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
                    )
        apart = uncoupled(tx, tz)
        if apart:
            work = beyond(scratch, AT_APART)
            pairs = uncoupled_pairs(
                outer.kx == SLIDE,
                outer.kz == SLIDE,
                tx,
                tz,
                x_centre(outer),
                z_centre(outer),
                work,
                xs,
                zs,
            )
            for i in range(pairs):
                x = beyond(xs, VALUE_STRIDE * i)
                z = beyond(zs, VALUE_STRIDE * i)
                count = with_middles(
                    kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
                )
        dependent = not apart and max(steadiness(tx), steadiness(tz)) < DEPENDENT
        return count, dependent or scratch[AT_DOUBT] != 0.0
    firsts = zs if mode == Z_FIRST else xs
    seconds = xs if mode == Z_FIRST else zs
    for i in range(first_values(outer, mode, measure, tx, tz, firsts)):
        first = beyond(firsts, VALUE_STRIDE * i)
        for j in range(second_values(outer, mode, measure, tx, tz, first, seconds)):
            second = beyond(seconds, VALUE_STRIDE * j)
            x, z = (second, first) if mode == Z_FIRST else (first, second)
            slot = (0 if first[SAMPLED] != 0.0 else 2 * (i % 2)) + (
                0 if second[SAMPLED] != 0.0 else j % 2
            )
            count = with_middles(kinds, lines, goal, k, outer, x, z, slot, scratch, out, count)
    unsure = count == 0 and (nearly_silent(tx) or nearly_silent(tz))
    return count, unsure or scratch[AT_DOUBT] != 0.0


@kernel(I(6), F(6 * LINE_STRIDE), F(12), INT, INT, INT, OUT(12), returns=False)
def outer_terms(kinds, lines, goal, k, what, option, out):
    """Write the terms of x and of z (6, 6) for one goal: a plan sees by them which unknowns are
    missing.
    """
    scratch = np.empty(SCRATCH)
    around = raw(scratch)
    l_ = raw(lines)
    g_ = raw(goal)
    loop_lines(l_, g_, k, around)
    n, p = plane_normal(raw(kinds), l_, k) if what == PLANE else (three(l_, 0), ball_centre(l_, k))
    outer = outer_of(
        what,
        raw(kinds),
        around,
        (k + 3) % 6,
        (k + 4) % 6,
        (k + 5) % 6,
        option,
        p,
        n,
        unmapped(g_, p),
        unrotated(g_, n),
    )
    x_terms(outer, raw(out))
    z_terms(outer, beyond(raw(out), 6))
    keep(scratch)
