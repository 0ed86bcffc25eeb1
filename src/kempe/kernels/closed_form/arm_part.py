"""The outer half of a closed-form inverse model: the values of three joints that bring a point or a
plane back to its place.

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
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    add_scaled,
    cross,
    dot,
    find_foot_point,
    read_vector,
    rotate_about_axis,
    subtract_vectors,
)
from kempe.kernels.closed_form.analytic_layout import PLANE
from kempe.kernels.closed_form.subproblems import (
    compute_orbit,
    find_aligning_turn,
    find_cone_turns,
    find_parabola_roots,
    find_trig_roots,
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
def carry_element(kind, h, o, e, c, s, theta):
    """Return the point or plane `e` after the motion of a joint."""
    if kind == SLIDE:
        return PointOrPlane(add_scaled(e.p, theta, h), e.n)
    return PointOrPlane(
        add_scaled(o, 1.0, rotate_about_axis(h, subtract_vectors(e.p, o), c, s)),
        rotate_about_axis(h, e.n, c, s),
    )


@device
def compute_measure_vectors(kind, what, h, o, option, hx, kx, hz, kz):
    """Return the two vectors by which the joint y measures a point or plane: for a turning y its
    axis h and a point, for a sliding y two directions across it.
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
        first = subtract_vectors(other, add_scaled((0.0, 0.0, 0.0), dot(other, h), h))
    first = add_scaled((0.0, 0.0, 0.0), 1.0 / math.sqrt(dot(first, first)), first)
    second = cross(h, first)
    if what == PLANE and dot(second, second) < 1e-18:
        second = (
            cross(first, (0.0, 0.0, 1.0)) if abs(first[2]) < 0.8 else cross(first, (1.0, 0.0, 0.0))
        )
    return first, second


@routine
def write_measure_terms(kind, h, o, e, sign, what, y_slides, first, second, out):
    """Write the constant, first and second factor of both measures, as functions of one joint's
    variable, to out[0:3] and out[3:6].

    The factors belong to cos and sin of a turn, to d and d^2 of a slide; `sign` -1 for the inverse
    motion.
    """
    if kind == SLIDE:
        v = add_scaled((0.0, 0.0, 0.0), sign, h)
        x = e.n if what == PLANE else e.p
        out[0] = dot(first, x)
        out[1] = 0.0 if what == PLANE else dot(first, v)
        out[2] = 0.0
        out[5] = 0.0
        if y_slides:
            out[3] = dot(second, x)
            out[4] = 0.0 if what == PLANE else dot(second, v)
        elif what == PLANE:
            out[3] = dot(e.n, subtract_vectors(second, e.p))
            out[4] = -dot(e.n, v)
        else:
            r = subtract_vectors(e.p, second)
            out[3] = dot(r, r)
            out[4] = 2.0 * dot(r, v)
            out[5] = 1.0
        return
    if what == PLANE:
        m, u, w = compute_orbit(h, e.n)
    else:
        m, u, w = compute_orbit(h, subtract_vectors(e.p, o))
        m = add_scaled(m, 1.0, o)
    out[0] = dot(first, m)
    out[1] = dot(first, u)
    out[2] = sign * dot(first, w)
    if y_slides:
        out[3] = dot(second, m)
        out[4] = dot(second, u)
        out[5] = sign * dot(second, w)
    elif what == PLANE:
        d = subtract_vectors(second, o)
        out[3] = dot(m, d) + dot(e.n, subtract_vectors(o, e.p))
        out[4] = dot(u, d)
        out[5] = sign * dot(w, d)
    else:
        d = subtract_vectors(m, second)
        out[3] = dot(d, d) + dot(u, u)
        out[4] = 2.0 * dot(d, u)
        out[5] = 2.0 * sign * dot(d, w)


@device
def write_joint_value(out, k, a, b, theta, sampled):
    """Write one value of a joint to place k of `out`."""
    at = VALUE_STRIDE * k
    out[at] = a
    out[at + 1] = b
    out[at + 2] = theta
    out[at + SAMPLED] = sampled


@device
def write_angle(out, k, c, s, sampled):
    """Write one angle of a joint, by its cosine and sine."""
    write_joint_value(out, k, c, s, math.atan2(s, c), sampled)


@routine
def write_samples(slides, count, out, mark, centre):
    """Write a few samples of a joint that is free, no two of which differ by half a turn; return
    the new number of values.

    centre: near which a slide has to be for the other joints to reach.
    """
    for k in range(SAMPLES):
        x = 0.35 - 1.3 * k + 0.37 * (k // 2)
        if slides:
            x += centre + 1.3
            write_joint_value(out, count + k, x, x * x, x, mark)
        else:
            write_angle(out, count + k, math.cos(x), math.sin(x), mark)
    return count + SAMPLES


@routine
def solve_one_unknown(slides, a, b, k, wide, centre, out):
    """Solve a f + b g = k, where f, g are cos, sin of a turn or d, d^2 of a slide; return the
    number of solutions written to `out`.

    wide: how far beyond its edge the equation may be. centre: where a free slide is tried.
    """
    size = math.hypot(a, b)
    count = 0
    if size <= VOID and abs(k) > wide:
        return 0
    if size > NOTHING:
        if slides:
            x0, x1, d2 = find_parabola_roots(b, a, -k)
            if d2 < -wide * (size * size + abs(b * k)):
                return 0
            write_joint_value(out, 0, x0, x0 * x0, x0, 0.0)
            write_joint_value(out, 1, x1, x1 * x1, x1, 0.0)
            count = 1 if abs(b) <= 1e-14 * (size + abs(k)) else 2
        else:
            if abs(k) > size + wide:
                return 0
            c0, s0, c1, s1, _ = find_trig_roots(a, b, k)
            write_angle(out, 0, c0, s0, 0.0)
            write_angle(out, 1, c1, s1, 0.0)
            count = 2
    return write_samples(slides, count, out, 1.0, centre) if size <= VOID else count


@routine
def solve_cone(k, h, n, w, sign, wide, out):
    """Find the turns about h after which n makes the same angle with k as w does (inverse turns for
    `sign` -1); return their number.
    """
    c0, s0, c1, s1, d2 = find_cone_turns(k, h, n, w)
    a = cross(k, h)
    b = cross(h, n)
    size = math.sqrt(dot(a, a) * dot(b, b))
    count = 0
    if size <= VOID and abs(dot(k, w) - dot(k, n)) > wide:
        return 0
    if size > NOTHING:
        if d2 < -wide * size:
            return 0
        write_angle(out, 0, c0, sign * s0, 0.0)
        write_angle(out, 1, c1, sign * s1, 0.0)
        count = 2
    return write_samples(False, count, out, 1.0, 0.0) if size <= VOID else count


class Outer(NamedTuple):
    """The outer problem: the joints x, y, z as (kind, h, o), the moved points or planes, and the
    measures that y keeps.
    """

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
def make_outer_problem(what, kinds, lines, x, y, z, option, p0, n0, p1, n1):
    """Make the outer problem of the joints at places x, y, z of `lines`."""
    kx = kinds[x]
    ky = kinds[y]
    kz = kinds[z]
    hx = read_vector(lines, LINE_STRIDE * x)
    ox = read_vector(lines, LINE_STRIDE * x + 4)
    hy = read_vector(lines, LINE_STRIDE * y)
    oy = read_vector(lines, LINE_STRIDE * y + 4)
    hz = read_vector(lines, LINE_STRIDE * z)
    oz = read_vector(lines, LINE_STRIDE * z + 4)
    if option == 0:
        oy = find_foot_point(oy, hy, oz, hz)
    else:
        oy = find_foot_point(oy, hy, ox, hx)
    first, second = compute_measure_vectors(ky, what, hy, oy, option, hx, kx, hz, kz)
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
def write_x_terms(o, out):
    """Write the six terms of the joint x: constant, first and second factor of both measures."""
    write_measure_terms(o.kx, o.hx, o.ox, o.e0, -1.0, o.what, o.ky == SLIDE, o.first, o.second, out)


@device
def write_z_terms(o, out):
    """Write the six terms of the joint z: constant, first and second factor of both measures."""
    write_measure_terms(o.kz, o.hz, o.oz, o.e1, 1.0, o.what, o.ky == SLIDE, o.first, o.second, out)


@device
def find_x_centre(o):
    """Return the slide of a sliding x at which its point is nearest to the axis of y."""
    return dot(o.hx, subtract_vectors(o.e0.p, o.oy))


@device
def find_z_centre(o):
    """Return the slide of a sliding z at which its point is nearest to the axis of y."""
    return dot(o.hz, subtract_vectors(o.oy, o.e1.p))


@device
def is_cone_measure(o, j, kind):
    """Return whether measure j is the angle between a plane's normal and the axis of a turning y,
    under a turning joint.
    """
    return o.what == PLANE and j == 0 and o.ky != SLIDE and kind != SLIDE


@routine
def find_first_values(o, mode, j, tx, tz, out):
    """Find the values of the joint that measure j determines alone; return their number."""
    k = 3 * j
    if mode == 0:
        if is_cone_measure(o, j, o.kx):
            return solve_cone(o.hy, o.hx, o.e0.n, o.e1.n, -1.0, WIDE, out)
        return solve_one_unknown(
            o.kx == SLIDE, tx[k + 1], tx[k + 2], tz[k] - tx[k], WIDE, find_x_centre(o), out
        )
    if is_cone_measure(o, j, o.kz):
        return solve_cone(o.hy, o.hz, o.e1.n, o.e0.n, 1.0, WIDE, out)
    return solve_one_unknown(
        o.kz == SLIDE, tz[k + 1], tz[k + 2], tx[k] - tz[k], WIDE, find_z_centre(o), out
    )


@routine
def find_second_values(o, mode, j, tx, tz, first, out):
    """Find the values of the other joint by measure 1 - j, given those of the first joint; return
    their number.
    """
    k = 3 - 3 * j
    if mode == 0:
        e = carry_element(o.kx, o.hx, o.ox, o.e0, first[0], -first[1], -first[2])
        if is_cone_measure(o, 1 - j, o.kz):
            return solve_cone(o.hy, o.hz, o.e1.n, e.n, 1.0, WIDE, out)
        known = tx[k] + tx[k + 1] * first[0] + tx[k + 2] * first[1]
        return solve_one_unknown(
            o.kz == SLIDE, tz[k + 1], tz[k + 2], known - tz[k], WIDE, find_z_centre(o), out
        )
    e = carry_element(o.kz, o.hz, o.oz, o.e1, first[0], first[1], first[2])
    if is_cone_measure(o, 1 - j, o.kx):
        return solve_cone(o.hy, o.hx, o.e0.n, e.n, -1.0, WIDE, out)
    known = tz[k] + tz[k + 1] * first[0] + tz[k + 2] * first[1]
    return solve_one_unknown(
        o.kx == SLIDE, tx[k + 1], tx[k + 2], known - tx[k], WIDE, find_x_centre(o), out
    )


@routine
def find_middle_values(o, x, z, out):
    """Find the values of y for known x and z: one, or samples where y is free; return their number."""
    left = carry_element(o.kx, o.hx, o.ox, o.e0, x[0], -x[1], -x[2])
    right = carry_element(o.kz, o.hz, o.oz, o.e1, z[0], z[1], z[2])
    if o.ky == SLIDE:
        d = subtract_vectors(left.p, right.p)
        nearest = dot(o.hy, d)
        t = nearest
        slope = 1.0
        if o.what == PLANE:
            slope = abs(dot(left.n, o.hy))
            t = dot(left.n, d) / dot(left.n, o.hy) if slope > NOTHING else nearest
        write_joint_value(out, 0, t, t * t, t, 0.0)
        count = 1 if slope > NOTHING else 0
        return (
            count
            if slope > FAINT
            else write_samples(True, count, out, OPEN if slope > VOID else 1.0, nearest)
        )
    u, v = (
        (right.n, left.n)
        if o.what == PLANE
        else (subtract_vectors(right.p, o.oy), subtract_vectors(left.p, o.oy))
    )
    c, s, size = find_aligning_turn(o.hy, u, v)
    size = math.sqrt(size)
    count = 0
    if size > NOTHING:
        write_angle(out, 0, c, s, 0.0)
        count = 1
    if size > FAINT:
        return count
    return write_samples(False, count, out, OPEN if size > VOID else 1.0, 0.0)
