"""The inner half of a closed-form inverse model: three joints with a known common motion, whose
axes meet in a point or that move in one plane.

Both have two solutions. A rotation as three turns about given axes: the generalised Euler angles
(Davenport, 1973; Piovan and Bullo, 2012). A planar motion as three turns across the plane: the
triangle of a two-link arm; slides take the place of turns.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import (
    add_scaled,
    cross,
    dot,
    rotate_about_axis,
    rotate_vector,
    subtract_vectors,
    transform_point,
    transform_point_back,
)
from kempe.kernels.closed_form.arm_part import (
    NOTHING,
    VALUE_STRIDE,
    VOID,
    solve_cone,
    solve_one_unknown,
    write_angle,
    write_joint_value,
)
from kempe.kernels.closed_form.subproblems import (
    compute_orbit,
    compute_triangle_discriminant,
    find_aligning_turn,
    find_precise_trig_roots,
)
from kempe.kernels.forward.table_layout import SLIDE

LOST = -1
"""In place of a number of solutions: parallel slides leave none or infinitely many, which is not
decided here."""

ANY = 1e3
"""How far beyond its edge the equation of the inner joints is tried where an outer joint is a
sample: others may do."""


@device
def find_perpendicular(h):
    """Return a unit vector perpendicular to the unit vector h."""
    other = (0.0, 0.0, 1.0) if abs(h[2]) < 0.8 else (1.0, 0.0, 0.0)
    n = cross(h, other)
    return add_scaled((0.0, 0.0, 0.0), 1.0 / math.sqrt(dot(n, n)), n)


@device
def write_turn(h, u, v, out, k):
    """Write the angle about h that turns u towards v, or 0 where it is not determined; return
    whether it is determined.
    """
    c, s, size = find_aligning_turn(h, u, v)
    if math.sqrt(size) <= NOTHING:
        write_angle(out, k, 1.0, 0.0, 1.0)
        return False
    write_angle(out, k, c, s, 0.0)
    return True


@device
def read_value(out, k):
    """Read value k: cosine and sine of a turn, or a slide and its square."""
    return out[VALUE_STRIDE * k], out[VALUE_STRIDE * k + 1]


@routine
def find_ball_turns(ha, hb, hc, d, wide, work, out):
    """Write the rotation of d as turns about ha, hb, hc, three values for each way in `out`; return
    the number of ways.
    """
    w = rotate_vector(d, hc)
    count = solve_cone(ha, hb, hc, w, 1.0, wide, work)
    for k in range(count):
        c, s = read_value(work, k)
        at = 3 * k
        write_angle(out, at + 1, c, s, work[VALUE_STRIDE * k + 3])
        u = rotate_about_axis(hb, hc, c, s)
        write_turn(ha, u, w, out, at)
        ca, sa = read_value(out, at)
        r = find_perpendicular(hc)
        back = rotate_about_axis(hb, rotate_about_axis(ha, rotate_vector(d, r), ca, -sa), c, -s)
        write_turn(hc, r, back, out, at + 2)
    return count


@device
def project_across(h, v):
    """Return the component of v perpendicular to h."""
    return subtract_vectors(v, add_scaled((0.0, 0.0, 0.0), dot(h, v), h))


@routine
def solve_planar_point(h, ka, ha, oa, kb, hb, ob, p, goal, wide, work, out):
    """Find the ways to bring p to goal, both perpendicular to h, by joint a after joint b; return
    their number. Values a, b of each are at 3k, 3k + 1.
    """
    if ka == SLIDE and kb == SLIDE:
        d = project_across(h, subtract_vectors(goal, p))
        n = cross(ha, hb)
        det = dot(h, n)
        if abs(det) <= VOID:
            return LOST
        x = dot(h, cross(d, hb)) / det
        y = dot(h, cross(ha, d)) / det
        write_joint_value(out, 0, x, x * x, x, 0.0)
        write_joint_value(out, 1, y, y * y, y, 0.0)
        return 1
    if ka == SLIDE:
        r = project_across(h, subtract_vectors(p, ob))
        g = project_across(h, subtract_vectors(goal, ob))
        count = solve_one_unknown(
            True, -2.0 * dot(g, ha), 1.0, dot(r, r) - dot(g, g), wide, 0.0, work
        )
    elif kb == SLIDE:
        r = project_across(h, subtract_vectors(p, oa))
        g = project_across(h, subtract_vectors(goal, oa))
        count = solve_one_unknown(
            True, 2.0 * dot(r, hb), 1.0, dot(g, g) - dot(r, r), wide, 0.0, work
        )
    else:
        m, u, w = compute_orbit(hb, subtract_vectors(p, ob))
        r = project_across(h, add_scaled(subtract_vectors(m, oa), 1.0, ob))
        g = project_across(h, subtract_vectors(goal, oa))
        r1 = math.sqrt(dot(r, r))
        r2 = math.sqrt(dot(u, u))
        rho2 = dot(g, g)
        a = 2.0 * dot(r, u)
        b = 2.0 * dot(r, w)
        k = rho2 - r1 * r1 - r2 * r2
        count = solve_one_unknown(False, a, b, k, wide, 0.0, work)
        if count == 2:
            c0, s0, c1, s1, _ = find_precise_trig_roots(
                a, b, k, compute_triangle_discriminant(r1, r2, rho2)
            )
            write_angle(work, 0, c0, s0, 0.0)
            write_angle(work, 1, c1, s1, 0.0)
    for k in range(count):
        a, b = read_value(work, k)
        at = VALUE_STRIDE * k
        if ka == SLIDE:
            write_joint_value(out, 3 * k, a, a * a, a, work[at + 3])
            write_turn(
                hb,
                project_across(h, subtract_vectors(p, ob)),
                project_across(
                    h,
                    subtract_vectors(
                        subtract_vectors(goal, ob), add_scaled((0.0, 0.0, 0.0), a, ha)
                    ),
                ),
                out,
                3 * k + 1,
            )
            continue
        for i in range(VALUE_STRIDE):
            out[VALUE_STRIDE * (3 * k + 1) + i] = work[at + i]
        there = (
            add_scaled(p, a, hb)
            if kb == SLIDE
            else add_scaled(ob, 1.0, rotate_about_axis(hb, subtract_vectors(p, ob), a, b))
        )
        write_turn(
            ha,
            project_across(h, subtract_vectors(there, oa)),
            project_across(h, subtract_vectors(goal, oa)),
            out,
            3 * k,
        )
    return count


@routine
def solve_planar_forward(h, ka, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out):
    """Find the ways to write the planar motion d by joints a, b and a turn c; return their number."""
    count = solve_planar_point(
        h, ka, ha, oa, kb, hb, ob, oc, transform_point(d, oc), wide, work, out
    )
    r = find_perpendicular(hc)
    for k in range(count):
        x = rotate_vector(d, r)
        if ka != SLIDE:
            c, s = read_value(out, 3 * k)
            x = rotate_about_axis(ha, x, c, -s)
        if kb != SLIDE:
            c, s = read_value(out, 3 * k + 1)
            x = rotate_about_axis(hb, x, c, -s)
        write_turn(hc, r, x, out, 3 * k + 2)
    return count


@routine
def solve_planar_backward(h, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out):
    """Find the ways to write the planar motion d where c slides and a turns, by the inverse motion
    with joints in reverse order; return their number.
    """
    count = solve_planar_point(
        h,
        SLIDE,
        subtract_vectors((0.0, 0.0, 0.0), hc),
        oc,
        kb,
        subtract_vectors((0.0, 0.0, 0.0), hb),
        ob,
        oa,
        transform_point_back(d, oa),
        wide,
        work,
        out,
    )
    r = find_perpendicular(ha)
    for k in range(count):
        for i in range(VALUE_STRIDE):
            out[VALUE_STRIDE * (3 * k + 2) + i] = out[VALUE_STRIDE * 3 * k + i]
        x = r
        if kb != SLIDE:
            c, s = read_value(out, 3 * k + 1)
            x = rotate_about_axis(hb, r, c, -s)
        write_turn(ha, r, rotate_vector(d, x), out, 3 * k)
    return count


@routine
def solve_planar_swing(h, ha, hb, ob, hc, d, out):
    """Find the one way to write the planar motion d by a slide, a turn and a slide; LOST where the
    slides are parallel.
    """
    r = find_perpendicular(hb)
    write_turn(hb, r, rotate_vector(d, r), out, 1)
    c, s = read_value(out, 1)
    v = rotate_about_axis(hb, hc, c, s)
    shift = project_across(h, subtract_vectors(transform_point(d, ob), ob))
    det = dot(h, cross(ha, v))
    if abs(det) <= VOID:
        return LOST
    x = dot(h, cross(shift, v)) / det
    y = dot(h, cross(ha, shift)) / det
    write_joint_value(out, 0, x, x * x, x, 0.0)
    write_joint_value(out, 2, y, y * y, y, 0.0)
    return 1


@routine
def solve_planar_triple(ka, ha, oa, kb, hb, ob, kc, hc, oc, d, wide, work, out):
    """Find the ways to write the planar motion d by three joints of the plane, three values each in
    `out`; return their number.
    """
    h = hc if kc != SLIDE else ha if ka != SLIDE else hb
    # the part of d that leaves the plane belongs to a target out of reach: the residual says so
    if kc != SLIDE:
        return solve_planar_forward(h, ka, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out)
    if ka != SLIDE:
        return solve_planar_backward(h, ha, oa, kb, hb, ob, hc, oc, d, wide, work, out)
    return solve_planar_swing(h, ha, hb, ob, hc, d, out)
