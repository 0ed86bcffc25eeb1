"""Rings of three rigid clusters, and clusters that are joined twice, closed by circles and lines.

Three bodies, joined in a circle by pins and rails, form the dyads of Assur (1914): `circles` (RRR),
`line_circle` (one rail) and `lines` (two rails). What cannot close is put where it nearly touches.
The functions return nothing; numbers in their docstrings are places in the integers of the
operation, from 1.
"""

from __future__ import annotations

from kempe.kernels.base._jit import routine
from kempe.kernels.base.vectors import square_root, where
from kempe.kernels.dyads.dyads_poses import (
    TINY,
    brought,
    flag,
    part_by,
    pin,
    positive,
    put_pose,
    rail,
    unit,
    vector,
)


@routine
def circles(v, ints, i, floats, f):
    """Join two links by a pin: circle meets circle. Pins 1 and 2: A and C of the base; 3 and 4: A
    and B of a link; 5 and 6: B and C of the other. The sign 7 is the orientation of A, C, B. Out:
    registers 8 and 9 of the links.

    The height of B above AC comes from the product of four sums of the sides, which loses nothing
    where the triangle is a needle (Kahan, "Miscalculating area and angles of a needle-like
    triangle", 2014).
    """
    ax, ay = pin(v, ints[i + 1], floats, f)
    cx, cy = pin(v, ints[i + 2], floats, f + 2)
    a1x, a1y = pin(v, ints[i + 3], floats, f + 4)
    b1x, b1y = pin(v, ints[i + 4], floats, f + 6)
    b2x, b2y = pin(v, ints[i + 5], floats, f + 8)
    c2x, c2y = pin(v, ints[i + 6], floats, f + 10)
    d, ux, uy = unit(cx - ax, cy - ay)
    r1, w1x, w1y = unit(b1x - a1x, b1y - a1y)
    r2, w2x, w2y = unit(b2x - c2x, b2y - c2y)
    total = r1 + r2
    less = r1 - r2
    d = where(d > TINY * total, d, 0.0)
    together = d == 0.0
    inverse = 1.0 / where(together, 1.0, d)
    x = 0.5 * (d + less * (total * inverse))
    square = (total + d) * ((total - d) * ((d - less) * (d + less)))
    y = 0.5 * inverse * square_root(positive(square))
    area = r1 * r2
    part_by(v, where(area > 0.0, y * d / where(area > 0.0, area, 1.0), 0.0))
    y = vector(v, ints[i + 7]) * where(together, r1, y)
    _, e1x, e1y = unit(x, y)
    _, e2x, e2y = unit(x - d, y)
    g1x = ux * e1x - uy * e1y
    g1y = uy * e1x + ux * e1y
    g2x = ux * e2x - uy * e2y
    g2y = uy * e2x + ux * e2y
    c1 = g1x * w1x + g1y * w1y
    s1 = g1y * w1x - g1x * w1y
    c2 = g2x * w2x + g2y * w2y
    s2 = g2y * w2x - g2x * w2y
    put_pose(v, ints[i + 8], brought(ax, ay, c1, s1, a1x, a1y))
    put_pose(v, ints[i + 9], brought(cx, cy, c2, s2, c2x, c2y))
    flag(v, where(r1 > r2, r2, r1) + where(together, -total, 0.0), TINY * (total + d))


@routine
def line_circle(v, ints, i, floats, f):
    """Join a slider and a link: line meets circle. Rails 1 (base) and 2 (slider); pins 3 and 4: B
    of the slider and of the link; 5 and 6: A of the link and of the base. The sign 7 is that of B -
    A along the rail: + slides farther. Out: registers 8 of the slider and 9 of the link.
    """
    px, py, dx, dy = rail(v, ints[i + 1], floats, f)
    qx, qy, ex, ey = rail(v, ints[i + 2], floats, f + 4)
    b1x, b1y = pin(v, ints[i + 3], floats, f + 8)
    b2x, b2y = pin(v, ints[i + 4], floats, f + 10)
    a2x, a2y = pin(v, ints[i + 5], floats, f + 12)
    ax, ay = pin(v, ints[i + 6], floats, f + 14)
    c1 = dx * ex + dy * ey
    s1 = dy * ex - dx * ey
    wx = b1x - qx
    wy = b1y - qy
    gx = px + (c1 * wx - s1 * wy) - ax
    gy = py + (s1 * wx + c1 * wy) - ay
    along = gx * dx + gy * dy
    h = dx * gy - dy * gx
    r, w2x, w2y = unit(b2x - a2x, b2y - a2y)
    t = square_root(positive((r - h) * (r + h)))
    part_by(v, where(r > 0.0, t / where(r > 0.0, r, 1.0), 0.0))
    t = vector(v, ints[i + 7]) * t
    slid = t - along
    _, g2x, g2y = unit(t * dx - h * dy, t * dy + h * dx)
    c2 = g2x * w2x + g2y * w2y
    s2 = g2y * w2x - g2x * w2y
    put_pose(v, ints[i + 8], brought(px + slid * dx, py + slid * dy, c1, s1, qx, qy))
    put_pose(v, ints[i + 9], brought(ax, ay, c2, s2, a2x, a2y))
    flag(v, r, TINY * abs(h))


@routine
def lines(v, ints, i, floats, f):
    """Pin two sliders on one base together: line meets line. Rails 1 (base) and 2 (first slider), 3
    (base) and 4 (second); pins 5 and 6 of the first and of the second. Out: registers 7 and 8.
    """
    p1x, p1y, d1x, d1y = rail(v, ints[i + 1], floats, f)
    q1x, q1y, e1x, e1y = rail(v, ints[i + 2], floats, f + 4)
    p2x, p2y, d2x, d2y = rail(v, ints[i + 3], floats, f + 8)
    q2x, q2y, e2x, e2y = rail(v, ints[i + 4], floats, f + 12)
    b1x, b1y = pin(v, ints[i + 5], floats, f + 16)
    b2x, b2y = pin(v, ints[i + 6], floats, f + 18)
    c1 = d1x * e1x + d1y * e1y
    s1 = d1y * e1x - d1x * e1y
    c2 = d2x * e2x + d2y * e2y
    s2 = d2y * e2x - d2x * e2y
    gx = p2x + (c2 * (b2x - q2x) - s2 * (b2y - q2y)) - p1x - (c1 * (b1x - q1x) - s1 * (b1y - q1y))
    gy = p2y + (s2 * (b2x - q2x) + c2 * (b2y - q2y)) - p1y - (s1 * (b1x - q1x) + c1 * (b1y - q1y))
    det = d1x * d2y - d1y * d2x
    parallel = where(abs(det) > TINY, 0.0, 1.0) == 1.0
    inverse = 1.0 / where(parallel, 1.0, det)
    t1 = where(parallel, gx * d1x + gy * d1y, (gx * d2y - gy * d2x) * inverse)
    t2 = where(parallel, 0.0, (gx * d1y - gy * d1x) * inverse)
    put_pose(v, ints[i + 7], brought(p1x + t1 * d1x, p1y + t1 * d1y, c1, s1, q1x, q1y))
    put_pose(v, ints[i + 8], brought(p2x + t2 * d2x, p2y + t2 * d2y, c2, s2, q2x, q2y))
    part_by(v, abs(det))
    flag(v, abs(det), TINY)


@routine
def pin_pin(v, ints, i, floats, f):
    """Place a body on two pins. Pins 1 and 2 of the base, 3 and 4 of the body; exact at the first.
    Out: register 5.
    """
    ax, ay = pin(v, ints[i + 1], floats, f)
    bx, by = pin(v, ints[i + 2], floats, f + 2)
    a1x, a1y = pin(v, ints[i + 3], floats, f + 4)
    b1x, b1y = pin(v, ints[i + 4], floats, f + 6)
    d, ux, uy = unit(bx - ax, by - ay)
    r, wx, wy = unit(b1x - a1x, b1y - a1y)
    put_pose(v, ints[i + 5], brought(ax, ay, ux * wx + uy * wy, uy * wx - ux * wy, a1x, a1y))
    flag(v, where(d > r, r, d), TINY * (d + r))


@routine
def pin_rail(v, ints, i, floats, f):
    """Place a body by a pin and a rail: its pin 4 on pin 3 of the base, its rail 2 along rail 1.
    Out: register 5.
    """
    _, _, dx, dy = rail(v, ints[i + 1], floats, f)
    _, _, ex, ey = rail(v, ints[i + 2], floats, f + 4)
    ax, ay = pin(v, ints[i + 3], floats, f + 8)
    bx, by = pin(v, ints[i + 4], floats, f + 10)
    put_pose(v, ints[i + 5], brought(ax, ay, dx * ex + dy * ey, dy * ex - dx * ey, bx, by))


@routine
def rail_rail(v, ints, i, floats, f):
    """Place a body on two rails: its rails 2 and 4 lie on rails 1 and 3 of the base. Out: register
    5.
    """
    p1x, p1y, d1x, d1y = rail(v, ints[i + 1], floats, f)
    q1x, q1y, ex, ey = rail(v, ints[i + 2], floats, f + 4)
    p2x, p2y, d2x, d2y = rail(v, ints[i + 3], floats, f + 8)
    q2x, q2y, _, _ = rail(v, ints[i + 4], floats, f + 12)
    c = d1x * ex + d1y * ey
    s = d1y * ex - d1x * ey
    wx = q2x - q1x
    wy = q2y - q1y
    gx = p1x + (c * wx - s * wy) - p2x
    gy = p1y + (s * wx + c * wy) - p2y
    det = d1x * d2y - d1y * d2x
    parallel = where(abs(det) > TINY, 0.0, 1.0) == 1.0
    t = where(parallel, 0.0, -(gx * d2y - gy * d2x) / where(parallel, 1.0, det))
    put_pose(v, ints[i + 5], brought(p1x + t * d1x, p1y + t * d1y, c, s, q1x, q1y))
    flag(v, abs(det), TINY)
