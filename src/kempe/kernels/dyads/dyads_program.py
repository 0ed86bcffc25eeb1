"""Planar mechanisms made of dyads, `LANES` configurations side by side: a program of closed forms
is walked.

Known coordinates place bodies, dyads are closed (`kempe.kernels.dyads.dyads_program`), and all other
coordinates are read off the poses; how far joints are open is summed up on the way.
`kempe.assemble.dyad_decomposition` writes the programs.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.trig import REACH, ROUND, atan2, sincos
from kempe.kernels.base.vectors import (
    LANES,
    all_between,
    keep,
    load_lanes,
    rarely,
    raw,
    spread_lanes,
    square_root,
    store,
    where,
)
from kempe.kernels.dyads import dyads_layout as K
from kempe.kernels.dyads.dyads_layout import FLAG, GAP, MARGIN

# ---- dyads poses

# Poses in the plane in registers of `LANES` configurations: what programs of dyads are made of.
#
# A pose is (c, s, x, y): cosine and sine of the orientation, origin. A *pin* is the end of a revolute
# joint (a point of a body), a *rail* that of a prismatic one (a point and a direction).


TINY = 1e-14
"""Lengths below this share of the others count as zero: the direction along them would be
rounding."""


@device
def vector(v, place):
    """The vector at a place."""
    return load_lanes(v, LANES * place)


@device
def put(v, place, value):
    """Set the vector at a place to `value`."""
    store(v, LANES * place, value)


@device
def pose(v, place):
    """The pose in a register."""
    return vector(v, place), vector(v, place + 1), vector(v, place + 2), vector(v, place + 3)


@device
def put_pose(v, place, value):
    """Set the pose of a register."""
    put(v, place, value[0])
    put(v, place + 1, value[1])
    put(v, place + 2, value[2])
    put(v, place + 3, value[3])


@device
def times(a, b):
    """The pose a b."""
    c, s, x, y = a
    return (
        c * b[0] - s * b[1],
        s * b[0] + c * b[1],
        x + (c * b[2] - s * b[3]),
        y + (s * b[2] + c * b[3]),
    )


@device
def inverted(a):
    """The inverse of a pose."""
    c, s, x, y = a
    return c, -s, -(c * x + s * y), s * x - c * y


@device
def constant(floats, k):
    """The constant pose at floats[k:]."""
    return floats[k], floats[k + 1], floats[k + 2], floats[k + 3]


@device
def pin(v, place, floats, k):
    """The point of the body at `place`, in the axes of its cluster."""
    c, s, x, y = pose(v, place)
    px = floats[k]
    py = floats[k + 1]
    return x + (c * px - s * py), y + (s * px + c * py)


@device
def rail(v, place, floats, k):
    """The point and the direction of the body at `place`, in the axes of its cluster."""
    c, s, x, y = pose(v, place)
    px = floats[k]
    py = floats[k + 1]
    dx = floats[k + 2]
    dy = floats[k + 3]
    return x + (c * px - s * py), y + (s * px + c * py), c * dx - s * dy, s * dx + c * dy


@device
def unit(x, y):
    """(length, direction) of (x, y); the direction of a zero is (1, 0)."""
    n = square_root(x * x + y * y)
    zero = n == 0.0
    inverse = 1.0 / where(zero, 1.0, n)
    return n, where(zero, 1.0, x * inverse), y * inverse


@device
def positive(x):
    """x where it is positive, else 0, but NaN stays."""
    return where(0.0 > x, 0.0, x)


@device
def brought(ax, ay, c, s, bx, by):
    """The pose with orientation (c, s) that brings the body's point b to a."""
    return c, s, ax - (c * bx - s * by), ay - (s * bx + c * by)


@device
def flag(v, size, least):
    """Count the lanes in which `size` is not above `least`: they are undetermined."""
    put(v, FLAG, vector(v, FLAG) + where(size > least, 0.0, 1.0))


@device
def part_by(v, margin):
    """Count a dyad whose branches are as far apart as `margin`, the sine of the angle between its
    links, says.
    """
    least = vector(v, MARGIN)
    put(v, MARGIN, where(least > margin, margin, least))


@device
def open_by(v, square):
    """Add a squared opening."""
    put(v, GAP, vector(v, GAP) + square)


# ---- dyads groups

# Rings of three rigid clusters, and clusters that are joined twice, closed by circles and lines.
#
# Three bodies, joined in a circle by pins and rails, form the dyads of Assur (1914): `circles` (RRR),
# `line_circle` (one rail) and `lines` (two rails). What cannot close is put where it nearly touches.
# The functions return nothing; numbers in their docstrings are places in the integers of the
# operation, from 1.


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


@routine
def sincos_each(v, theta):
    """Write sine and cosine, by the C library, to the spare vectors."""
    put(v, K.SPARE, theta)
    for lane in range(LANES):
        x = v[LANES * K.SPARE + lane]
        store(v, LANES * K.SPARE + lane, math.sin(x))
        store(v, LANES * (K.SPARE + 1) + lane, math.cos(x))


@routine
def turn(v, ints, i, floats, f):
    """Set register 1 = register 2 . constant 1 . turn by (multiplier . vector 3) . constant 5."""
    theta = floats[f] * vector(v, ints[i + 3])
    s, c = sincos(theta)
    if rarely(not all_between(-REACH, theta, REACH)):
        sincos_each(v, theta)  # lanes within reach keep theirs: none depends on the others
        far = abs(theta)
        s = where(far > REACH, vector(v, K.SPARE), s)
        c = where(far > REACH, vector(v, K.SPARE + 1), c)
    a = times(pose(v, ints[i + 2]), constant(floats, f + 1))
    a = a[0] * c - a[1] * s, a[1] * c + a[0] * s, a[2], a[3]
    put_pose(v, ints[i + 1], times(a, constant(floats, f + 5)))


@routine
def slide(v, ints, i, floats, f):
    """Set register 1 = register 2 . constant 1 . slide along x by (multiplier . vector 3) .
    constant 5.
    """
    d = floats[f] * vector(v, ints[i + 3])
    a = times(pose(v, ints[i + 2]), constant(floats, f + 1))
    a = a[0], a[1], a[2] + a[0] * d, a[3] + a[1] * d
    put_pose(v, ints[i + 1], times(a, constant(floats, f + 5)))


@routine
def rebase(v, ints, i):
    """Set registers 3 and 4 to the identity and register 2, seen from the pose in register 1."""
    back = inverted(pose(v, ints[i + 1]))
    other = times(back, pose(v, ints[i + 2]))
    put_pose(v, ints[i + 3], back)
    put_pose(v, ints[i + 4], other)


@device
def rounded(x):
    """x rounded to the nearest integer."""
    return (x + ROUND) - ROUND


@device
def upward(x):
    """The least integer that is not below x."""
    r = rounded(x)
    return where(x > r, r + 1.0, r)


@device
def representative(a, target, period, low, high):
    """Of a + whole multiples of `period` the one nearest to the target, within the limits where one
    is.
    """
    nearest = a + period * rounded((target - a) / period)
    down = where(nearest > high, nearest - period * upward((nearest - high) / period), nearest)
    up = where(low > down, down + period * upward((low - down) / period), down)
    return where(up > high, nearest, up)


@routine
def read_turn(v, ints, i, floats, f):
    """Read coordinate 3 of a pin between bodies 1 and 2, target 4; what was known (5 is not 0) is
    checked.

    floats: cosine and sine of the constant turn between the frames; 1/multiplier,
    -offset/multiplier, period, limits; the pin on both bodies; metres for a unit of misfit.
    """
    a = pose(v, ints[i + 1])
    b = pose(v, ints[i + 2])
    c = a[0] * b[0] + a[1] * b[1]
    s = a[0] * b[1] - a[1] * b[0]
    kc = floats[f]
    ks = floats[f + 1]
    angle = atan2(s * kc + c * ks, c * kc - s * ks) * floats[f + 2] + floats[f + 3]
    period = floats[f + 4]
    place = ints[i + 3]
    if ints[i + 5]:
        misfit = angle - vector(v, place)
        misfit = (misfit - period * rounded(misfit / period)) * floats[f + 11]
        open_by(v, misfit * misfit)
    else:
        put(
            v,
            place,
            representative(angle, vector(v, ints[i + 4]), period, floats[f + 5], floats[f + 6]),
        )
    ax, ay = pin(v, ints[i + 1], floats, f + 7)
    bx, by = pin(v, ints[i + 2], floats, f + 9)
    open_by(v, (bx - ax) * (bx - ax) + (by - ay) * (by - ay))


@routine
def read_slide(v, ints, i, floats, f):
    """Read coordinate 3 of a rail between bodies 1 and 2; what was known (5 is not 0) is checked.

    floats: the rail on both bodies; 1/multiplier, -offset/multiplier; metres for a unit of misfit;
    metres for a radian.
    """
    px, py, dx, dy = rail(v, ints[i + 1], floats, f)
    qx, qy, ex, ey = rail(v, ints[i + 2], floats, f + 4)
    gx = qx - px
    gy = qy - py
    value = (gx * dx + gy * dy) * floats[f + 8] + floats[f + 9]
    off = dx * gy - dy * gx
    place = ints[i + 3]
    if ints[i + 5]:
        misfit = (value - vector(v, place)) * floats[f + 10]
        open_by(v, misfit * misfit)
    else:
        put(v, place, value)
    tx = (ex - dx) * floats[f + 11]
    ty = (ey - dy) * floats[f + 11]
    open_by(v, off * off + (tx * tx + ty * ty))


@device
def move(code, v, ints, i, floats, f):
    """Run one operation on coordinates or registers alone."""
    if code == K.SET:
        put(v, ints[i + 1], spread_lanes(floats[f]))
    elif code == K.ADD:
        put(v, ints[i + 1], vector(v, ints[i + 1]) + floats[f] * vector(v, ints[i + 2]))
    elif code == K.EXPECT_ZERO:
        misfit = floats[f] * vector(v, ints[i + 1])
        open_by(v, misfit * misfit)
    elif code == K.TURN:
        turn(v, ints, i, floats, f)
    elif code == K.SLIDE:
        slide(v, ints, i, floats, f)
    elif code == K.DIVIDE:
        put_pose(v, ints[i + 1], times(pose(v, ints[i + 1]), inverted(pose(v, ints[i + 2]))))
    elif code == K.CARRY:
        put_pose(v, ints[i + 1], times(pose(v, ints[i + 2]), pose(v, ints[i + 1])))
    elif code == K.REBASE:
        rebase(v, ints, i)


@device
def close(code, v, ints, i, floats, f):
    """Run one operation that closes a group or reads a joint."""
    if code == K.READ_TURN:
        read_turn(v, ints, i, floats, f)
    elif code == K.READ_SLIDE:
        read_slide(v, ints, i, floats, f)
    elif code == K.CIRCLES:
        circles(v, ints, i, floats, f)
    elif code == K.LINE_CIRCLE:
        line_circle(v, ints, i, floats, f)
    elif code == K.LINES:
        lines(v, ints, i, floats, f)
    elif code == K.PIN_PIN:
        pin_pin(v, ints, i, floats, f)
    elif code == K.PIN_RAIL:
        pin_rail(v, ints, i, floats, f)
    elif code == K.RAIL_RAIL:
        rail_rail(v, ints, i, floats, f)


@device
def begin(v, ints):
    """Set all registers to the identity, what is open to zero, and the least margin of the dyads to
    one.
    """
    zero = spread_lanes(0.0)
    one = spread_lanes(1.0)
    put(v, K.GAP, zero)
    put(v, K.FLAG, zero)
    put(v, K.MARGIN, one)
    for k in range(ints[K.N_REGISTERS]):
        put_pose(v, K.REGISTERS + 4 * k, (one, zero, zero, zero))


@kernel(I("_"), F("_"), F("N", "_"), F("1|N", "_"), F("1|N", "nq"), OUT("N", "nq"), OUT("N", 3))
def solve(ints, floats, values, signs, near, q, status):
    """Number of rows; walks the program for known values (N, n_known) and branch signs (N or 1,
    n_signs).

    Writes configurations q (N, nq), angles nearest to `near` (N or 1, nq), and of each row in
    `status` (N, 3): the norm of all openings in metres, how many dyads were undetermined, and the
    least margin of a dyad, which is 0 where two of its branches meet and at most 1. A block that is
    not full repeats its last.
    """
    n = q.shape[0]
    nq = ints[K.NQ]
    known = ints[K.N_KNOWN]
    scratch = np.empty(LANES * ints[K.N_VECTORS])
    i_ = raw(ints)
    f_ = raw(floats)
    v = raw(scratch)
    each_sign = min(signs.shape[0] - 1, 1)
    each_near = min(near.shape[0] - 1, 1)
    coordinates = ints[K.COORDINATES]
    targets = ints[K.TARGETS]
    first_sign = ints[K.SIGNS]
    for start in range(0, n, LANES):
        for lane in range(LANES):
            row = min(start + lane, n - 1)
            for k in range(nq):
                scratch[LANES * (coordinates + k) + lane] = math.nan
                scratch[LANES * (targets + k) + lane] = near[row * each_near, k]
            for k in range(known):
                scratch[LANES * (coordinates + ints[K.HEADER + k]) + lane] = values[row, k]
            for k in range(ints[K.N_SIGNS]):
                scratch[LANES * (first_sign + k) + lane] = signs[row * each_sign, k]
        begin(v, i_)
        for op in range(ints[K.N_OPS]):
            i = K.HEADER + known + K.OP_INTS * op
            f = K.OP_FLOATS * op
            code = i_[i]
            if code < K.CIRCLES:
                move(code, v, i_, i, f_, f)
            else:
                close(code, v, i_, i, f_, f)
        for lane in range(min(LANES, n - start)):
            for k in range(nq):
                q[start + lane, k] = scratch[LANES * (coordinates + k) + lane]
            status[start + lane, 0] = math.sqrt(scratch[LANES * K.GAP + lane])
            status[start + lane, 1] = scratch[LANES * K.FLAG + lane]
            status[start + lane, 2] = scratch[LANES * K.MARGIN + lane]
    keep(scratch)
    return n
