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
    MOST,
    NOTHING,
    OPEN,
    REPEATED,
    SAMPLED,
    VALUE_STRIDE,
    VOID,
    WIDE,
    first_values,
    middle_values,
    one_unknown,
    outer_of,
    put,
    put_angle,
    put_samples,
    second_values,
    x_centre,
    x_terms,
    z_centre,
    z_terms,
)
from kempe.kernels.closed_form.subproblems import TINY
from kempe.kernels.closed_form.wrist_part import ANY, ball_triple, planar_triple
from kempe.kernels.forward.table_layout import SLIDE

# ---- quartic

# Real roots of polynomials up to degree four, double ones included, and two equations in two joint
# variables.


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
