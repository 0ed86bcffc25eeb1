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
    add_scaled,
    append_motion,
    cross,
    dot,
    read_vector,
    subtract_vectors,
    transform_point_back,
    unrotate_vector,
    write_identity,
    write_vector,
)
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
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
    find_first_values,
    find_middle_values,
    find_second_values,
    find_x_centre,
    find_z_centre,
    make_outer_problem,
    solve_one_unknown,
    write_angle,
    write_joint_value,
    write_samples,
    write_x_terms,
    write_z_terms,
)
from kempe.kernels.closed_form.subproblems import TINY
from kempe.kernels.closed_form.wrist_part import ANY, find_ball_turns, solve_planar_triple
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
def evaluate_quartic(p, x):
    """Return p(x) and p'(x) of a polynomial of degree four, p[k] the coefficient of x^k."""
    v = p[4] + 0.0 * x
    d = 0.0 * x
    for k in range(3, -1, -1):
        d = d * x + v
        v = v * x + p[k]
    return v, d


@routine
def find_quartic_roots(p, roots):
    """Find the real roots of p[0] + ... + p[4] x^4, p[4] not zero; return their number. Double
    roots are written twice to `roots` (4).

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
            v, slope = evaluate_quartic(p, a)
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
def eliminate_joint(t, other):
    """Return both factors of one joint as P0 + P1 f + P2 g in the factors f, g of the other joint:
    (P0, P1, P2), two numbers each.
    """
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
def compute_steadiness(t):
    """Return the sine, 0 to 1, of the angle between the two rows of factors of one joint; less
    where a row is below SMALL.
    """
    size = max(math.hypot(t[1], t[2]), SMALL) * max(math.hypot(t[4], t[5]), SMALL)
    return abs(t[1] * t[5] - t[2] * t[4]) / size


@device
def is_faint(t):
    """Return whether a joint hardly changes the measures, so that rounding leaves its value open."""
    return math.hypot(t[1], t[2]) + math.hypot(t[4], t[5]) < FAINT


@routine
def find_pairs(gone_slides, kept_slides, gone, kept, work, out_gone, out_kept):
    """Find up to four pairs of values that satisfy both equations, with the joint `gone`
    eliminated; return their number.

    gone, kept: terms of the two joints. Both factors f, g of `gone` are linear in those of `kept`;
    f^2 + g^2 = 1 for a turn, g = f^2 for a slide, is then a polynomial of degree four in the slide
    or in the tangent of the half angle.
    """
    p0, p1, p2 = eliminate_joint(gone, kept)
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
    count = find_quartic_roots(p, roots)
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
        if not gone_slides and size < 0.5 and not is_faint(gone):
            continue
        at = out_kept
        if kept_slides:
            write_joint_value(at, found, f, g, f, 0.0)
        else:
            write_angle(at, found, f, g, 0.0)
        if gone_slides:
            write_joint_value(out_gone, found, u, u * u, u, 0.0)
        else:
            write_angle(out_gone, found, u / max(size, TINY), v / max(size, TINY), 0.0)
        found += 1
    return found


@device
def find_coupled_pairs(x_slides, z_slides, tx, tz, work, out_x, out_z):
    """Find the pairs of values of x and z that satisfy both outer equations, written to out_x and
    out_z; return their number.
    """
    if compute_steadiness(tx) >= compute_steadiness(tz):
        return find_pairs(x_slides, z_slides, tx, tz, work, out_x, out_z)
    return find_pairs(z_slides, x_slides, tz, tx, work, out_z, out_x)


UNCOUPLED = 1e-2
"""What a joint may add to the equation of the other, relative to its part in its own, for these to
be solved apart."""


@device
def find_least_combination(t):
    """Return the combination (2 numbers) of the two rows of one joint in which this joint has the
    smallest factors.
    """
    p = t[1] * t[1] + t[2] * t[2]
    q = t[1] * t[4] + t[2] * t[5]
    r = t[4] * t[4] + t[5] * t[5]
    angle = 0.5 * math.atan2(2.0 * q, p - r)
    return -math.sin(angle), math.cos(angle)


@device
def combine_rows(w, t):
    """Return constant, first and second factor of one joint in a combination of both equations."""
    return w[0] * t[0] + w[1] * t[3], w[0] * t[1] + w[1] * t[4], w[0] * t[2] + w[1] * t[5]


@device
def compute_amplitude(row):
    """Return the norm of the factors of a joint in one equation."""
    return math.hypot(row[1], row[2])


@device
def is_uncoupled(tx, tz):
    """Return whether one combination of the equations is nearly free of z, and another one nearly
    free of x.

    The polynomial of degree four then nearly is a square: its roots lie in pairs, which rounding
    moves by its root, and with each root the other joint has two values, between which the pair
    decides.
    """
    without_x = find_least_combination(tx)
    without_z = find_least_combination(tz)
    x_alone = compute_amplitude(combine_rows(without_z, tx))
    z_alone = compute_amplitude(combine_rows(without_x, tz))
    z_left = compute_amplitude(combine_rows(without_z, tz))
    x_left = compute_amplitude(combine_rows(without_x, tx))
    return (
        x_left < UNCOUPLED * x_alone
        and z_left < UNCOUPLED * z_alone
        and min(x_alone, z_alone) > FAINT
    )


@routine
def find_uncoupled_pairs(x_slides, z_slides, tx, tz, x_centre, z_centre, work, out_x, out_z):
    """Find up to four pairs of values of x and z that satisfy both equations where `is_uncoupled`
    holds; return their number.

    Either has one unknown if the little that the other joint adds is left out of that for x: pairs
    to be polished.
    """
    without_x = find_least_combination(tx)
    without_z = find_least_combination(tz)
    x = combine_rows(without_z, tx)
    z = combine_rows(without_z, tz)
    own_x = combine_rows(without_x, tx)
    own_z = combine_rows(without_x, tz)
    firsts = work
    seconds = advance_pointer(work, VALUE_STRIDE * MOST)
    found = 0
    for i in range(solve_one_unknown(x_slides, x[1], x[2], z[0] - x[0], WIDE, x_centre, firsts)):
        first = advance_pointer(firsts, VALUE_STRIDE * i)
        known = own_x[0] + own_x[1] * first[0] + own_x[2] * first[1]
        for j in range(
            solve_one_unknown(
                z_slides, own_z[1], own_z[2], known - own_z[0], WIDE, z_centre, seconds
            )
        ):
            second = advance_pointer(seconds, VALUE_STRIDE * j)
            write_joint_value(out_x, found, first[0], first[1], first[2], REPEATED)
            write_joint_value(out_z, found, second[0], second[1], second[2], 0.0)
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
def find_meeting_point(lines, a, b):
    """Return the midpoint between the nearest points of two lines that are not parallel."""
    h = read_vector(lines, LINE_STRIDE * a)
    o = read_vector(lines, LINE_STRIDE * a + 4)
    g = read_vector(lines, LINE_STRIDE * b)
    p = read_vector(lines, LINE_STRIDE * b + 4)
    n = cross(h, g)
    d = subtract_vectors(p, o)
    square = dot(n, n)
    x = dot(cross(d, g), n) / square
    y = dot(cross(d, h), n) / square
    return add_scaled(
        add_scaled((0.0, 0.0, 0.0), 0.5, add_scaled(o, x, h)), 0.5, add_scaled(p, y, g)
    )


@device
def find_ball_centre(lines, k):
    """Return the point where the axes k, k + 1, k + 2 meet; two neighbouring axes may coincide."""
    h = read_vector(lines, LINE_STRIDE * k)
    g = read_vector(lines, LINE_STRIDE * (k + 1))
    n = cross(h, g)
    if dot(n, n) > 1e-6:
        return find_meeting_point(lines, k, k + 1)
    return find_meeting_point(lines, k + 1, k + 2)


@routine
def write_loop_lines(lines, goal, first, out):
    """Write the lines of the loop to `out`; those of joints before `first` are mapped by the
    inverse of the goal.
    """
    for i in range(6):
        at = LINE_STRIDE * i
        h = read_vector(lines, at)
        o = read_vector(lines, at + 4)
        if i < first:
            h = unrotate_vector(goal, h)
            o = transform_point_back(goal, o)
        write_vector(out, at, h)
        write_vector(out, at + 4, o)


@device
def compute_plane_normal(kinds, lines, k):
    """Return the normal of the plane in which joints k, k + 1, k + 2 move, and a point of the
    plane.
    """
    for i in range(k, k + 3):
        if kinds[i] != SLIDE:
            return read_vector(lines, LINE_STRIDE * i), read_vector(lines, LINE_STRIDE * i + 4)
    return read_vector(lines, LINE_STRIDE * k), read_vector(lines, LINE_STRIDE * k + 4)


@routine
def find_inner_values(kinds, lines, goal, k, what, x, y, z, scratch):
    """Find the values of the three inner joints for given values of the outer ones; return the
    number of solutions.
    """
    d = advance_pointer(scratch, AT_MOTION)
    around = advance_pointer(scratch, AT_LINES)
    write_identity(d)
    # I3 = G (Ex Ey Ez)^-1, built from the right: d = G Ez^-1 Ey^-1 Ex^-1
    for i in range(12):
        d[i] = goal[i]
    for i in range(3):
        j = (k + 5 - i) % 6
        v = z if i == 0 else y if i == 1 else x
        at = LINE_STRIDE * j
        append_motion(
            d,
            read_vector(around, at),
            read_vector(around, at + 4),
            kinds[j] == SLIDE,
            -v[2],
            v[0],
            -v[1],
        )
    a = LINE_STRIDE * k
    b = LINE_STRIDE * (k + 1)
    c = LINE_STRIDE * (k + 2)
    work = advance_pointer(scratch, AT_WORK)
    out = advance_pointer(scratch, AT_INNER)
    wide = ANY if x[SAMPLED] + y[SAMPLED] + z[SAMPLED] > REPEATED else WIDE
    if what == POINT:
        return find_ball_turns(
            read_vector(lines, a), read_vector(lines, b), read_vector(lines, c), d, wide, work, out
        )
    return solve_planar_triple(
        kinds[k],
        read_vector(lines, a),
        read_vector(lines, a + 4),
        kinds[k + 1],
        read_vector(lines, b),
        read_vector(lines, b + 4),
        kinds[k + 2],
        read_vector(lines, c),
        read_vector(lines, c + 4),
        d,
        wide,
        work,
        out,
    )


@routine
def write_candidates(kinds, lines, goal, k, what, x, y, z, slot, scratch, out, count):
    """Write the candidates that belong to one set of outer values; return the new number of
    candidates.
    """
    n = find_inner_values(kinds, lines, goal, k, what, x, y, z, scratch)
    if n < 0:
        scratch[AT_DOUBT] = 1.0
    inner = advance_pointer(scratch, AT_INNER)
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
def write_middle_candidates(kinds, lines, goal, k, outer, x, z, slot, scratch, out, count):
    """Write the candidates for one pair of values of x and z; return the new number of candidates."""
    y = advance_pointer(scratch, AT_Y)
    for i in range(find_middle_values(outer, x, z, y)):
        count = write_candidates(
            kinds,
            lines,
            goal,
            k,
            outer.what,
            x,
            advance_pointer(y, VALUE_STRIDE * i),
            z,
            slot,
            scratch,
            out,
            count,
        )
    return count


@device
def is_nearly_silent(t):
    """Return whether an equation hardly depends on a joint, so that a missing solution proves
    nothing.
    """
    a = math.hypot(t[1], t[2])
    b = math.hypot(t[4], t[5])
    return NOTHING < a < FAINT or NOTHING < b < FAINT


@routine
def find_candidates(kinds, lines, goal, k, what, mode, measure, option, scratch, out):
    """Find the candidates for E_1 ... E_6 = G, CANDIDATE numbers each in `out`; return their number
    and whether one may be missing.

    In doubt are goals for which the equations degenerate in a way that is not taken apart here.

    k: place of the first inner joint; what: POINT or PLANE; mode, measure, option: how the outer
    equations are solved, see `arm_part`. scratch: SCRATCH numbers.
    """
    around = advance_pointer(scratch, AT_LINES)
    write_loop_lines(lines, goal, k, around)
    xs = advance_pointer(scratch, AT_X)
    zs = advance_pointer(scratch, AT_Z)
    scratch[AT_DOUBT] = 0.0
    if mode == AT_REST:
        for i in range(VALUE_STRIDE):
            xs[i] = 1.0 if i == 0 else 0.0
        count = write_candidates(kinds, lines, goal, k, what, xs, xs, xs, 0, scratch, out, 0)
        return count, scratch[AT_DOUBT] != 0.0
    n, p = (
        compute_plane_normal(kinds, lines, k)
        if what == PLANE
        else (read_vector(lines, 0), find_ball_centre(lines, k))
    )
    outer = make_outer_problem(
        what,
        kinds,
        around,
        (k + 3) % 6,
        (k + 4) % 6,
        (k + 5) % 6,
        option,
        p,
        n,
        transform_point_back(goal, p),
        unrotate_vector(goal, n),
    )
    tx = advance_pointer(scratch, AT_TERMS)
    tz = advance_pointer(scratch, AT_TERMS + 6)
    write_x_terms(outer, tx)
    write_z_terms(outer, tz)
    count = 0
    if mode == COUPLED:
        pairs = find_coupled_pairs(
            outer.kx == SLIDE, outer.kz == SLIDE, tx, tz, advance_pointer(scratch, AT_WORK), xs, zs
        )
        for i in range(pairs):
            x = advance_pointer(xs, VALUE_STRIDE * i)
            z = advance_pointer(zs, VALUE_STRIDE * i)
            # the roots of a quartic have no names: a slot below zero
            count = write_middle_candidates(
                kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
            )
            some = advance_pointer(scratch, AT_SOME)
            if is_faint(tx):
                for j in range(write_samples(outer.kx == SLIDE, 0, some, OPEN, x[2])):
                    x = advance_pointer(some, VALUE_STRIDE * j)
                    count = write_middle_candidates(
                        kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
                    )
            elif is_faint(tz):
                for j in range(write_samples(outer.kz == SLIDE, 0, some, OPEN, z[2])):
                    z = advance_pointer(some, VALUE_STRIDE * j)
                    count = write_middle_candidates(
                        kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
                    )
        apart = is_uncoupled(tx, tz)
        if apart:
            work = advance_pointer(scratch, AT_APART)
            pairs = find_uncoupled_pairs(
                outer.kx == SLIDE,
                outer.kz == SLIDE,
                tx,
                tz,
                find_x_centre(outer),
                find_z_centre(outer),
                work,
                xs,
                zs,
            )
            for i in range(pairs):
                x = advance_pointer(xs, VALUE_STRIDE * i)
                z = advance_pointer(zs, VALUE_STRIDE * i)
                count = write_middle_candidates(
                    kinds, lines, goal, k, outer, x, z, -1 - i, scratch, out, count
                )
        dependent = not apart and max(compute_steadiness(tx), compute_steadiness(tz)) < DEPENDENT
        return count, dependent or scratch[AT_DOUBT] != 0.0
    firsts = zs if mode == Z_FIRST else xs
    seconds = xs if mode == Z_FIRST else zs
    for i in range(find_first_values(outer, mode, measure, tx, tz, firsts)):
        first = advance_pointer(firsts, VALUE_STRIDE * i)
        for j in range(find_second_values(outer, mode, measure, tx, tz, first, seconds)):
            second = advance_pointer(seconds, VALUE_STRIDE * j)
            x, z = (second, first) if mode == Z_FIRST else (first, second)
            slot = (0 if first[SAMPLED] != 0.0 else 2 * (i % 2)) + (
                0 if second[SAMPLED] != 0.0 else j % 2
            )
            count = write_middle_candidates(
                kinds, lines, goal, k, outer, x, z, slot, scratch, out, count
            )
    unsure = count == 0 and (is_nearly_silent(tx) or is_nearly_silent(tz))
    return count, unsure or scratch[AT_DOUBT] != 0.0


@kernel(I(6), F(6 * LINE_STRIDE), F(12), INT, INT, INT, OUT(12), returns=False)
def write_outer_terms(kinds, lines, goal, k, what, option, out):
    """Write the terms of x and of z (6, 6) for one goal, by which a plan sees which unknowns are
    missing.
    """
    scratch = np.empty(SCRATCH)
    around = get_pointer(scratch)
    l_ = get_pointer(lines)
    g_ = get_pointer(goal)
    write_loop_lines(l_, g_, k, around)
    n, p = (
        compute_plane_normal(get_pointer(kinds), l_, k)
        if what == PLANE
        else (read_vector(l_, 0), find_ball_centre(l_, k))
    )
    outer = make_outer_problem(
        what,
        get_pointer(kinds),
        around,
        (k + 3) % 6,
        (k + 4) % 6,
        (k + 5) % 6,
        option,
        p,
        n,
        transform_point_back(g_, p),
        unrotate_vector(g_, n),
    )
    write_x_terms(outer, get_pointer(out))
    write_z_terms(outer, advance_pointer(get_pointer(out), 6))
    keep_alive(scratch)
