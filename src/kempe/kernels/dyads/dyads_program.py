"""Planar mechanisms made of dyads, `LANES` configurations side by side: a program of closed forms
is walked.

Known coordinates place bodies, dyads are closed (`kempe.kernels.dyads.dyads_program`), and all
other coordinates are read off the poses; how far joints are open is summed up on the way.
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
    are_all_between,
    compute_square_root,
    expect_false,
    get_pointer,
    keep_alive,
    load_lanes,
    select_where,
    spread_lanes,
    store_value,
)
from kempe.kernels.dyads import dyads_layout as K
from kempe.kernels.dyads.dyads_layout import FLAG, GAP, MARGIN

# ---- dyads poses

# Poses in the plane in registers of `LANES` configurations: what programs of dyads are made of.
#
# A pose is (c, s, x, y): cosine and sine of the orientation, origin. A *pin* is the end of a
# revolute
# joint (a point of a body), a *rail* that of a prismatic one (a point and a direction).


TINY = 1e-14
"""Lengths below this share of the others count as zero: the direction along them would be
rounding."""


@device
def load_vector(v, place):
    """Read the vector at a place."""
    return load_lanes(v, LANES * place)


@device
def store_vector(v, place, value):
    """Write a vector to a place."""
    store_value(v, LANES * place, value)


@device
def load_pose(v, place):
    """Read the planar pose in a register."""
    return (
        load_vector(v, place),
        load_vector(v, place + 1),
        load_vector(v, place + 2),
        load_vector(v, place + 3),
    )


@device
def store_pose(v, place, value):
    """Write a planar pose to a register."""
    store_vector(v, place, value[0])
    store_vector(v, place + 1, value[1])
    store_vector(v, place + 2, value[2])
    store_vector(v, place + 3, value[3])


@device
def multiply_poses(a, b):
    """Return the product a b of two planar poses."""
    c, s, x, y = a
    return (
        c * b[0] - s * b[1],
        s * b[0] + c * b[1],
        x + (c * b[2] - s * b[3]),
        y + (s * b[2] + c * b[3]),
    )


@device
def invert_pose(a):
    """Return the inverse of a planar pose."""
    c, s, x, y = a
    return c, -s, -(c * x + s * y), s * x - c * y


@device
def read_constant_pose(floats, k):
    """Read the constant planar pose at floats[k:]."""
    return floats[k], floats[k + 1], floats[k + 2], floats[k + 3]


@device
def locate_pin(v, place, floats, k):
    """Return the point of the body at `place`, in the axes of its cluster."""
    c, s, x, y = load_pose(v, place)
    px = floats[k]
    py = floats[k + 1]
    return x + (c * px - s * py), y + (s * px + c * py)


@device
def locate_rail(v, place, floats, k):
    """Return the point and the direction of the rail of the body at `place`, in the axes of its
    cluster.
    """
    c, s, x, y = load_pose(v, place)
    px = floats[k]
    py = floats[k + 1]
    dx = floats[k + 2]
    dy = floats[k + 3]
    return x + (c * px - s * py), y + (s * px + c * py), c * dx - s * dy, s * dx + c * dy


@device
def normalize_vector(x, y):
    """Return length and direction of (x, y); the direction of a zero vector is (1, 0)."""
    n = compute_square_root(x * x + y * y)
    zero = n == 0.0
    inverse = 1.0 / select_where(zero, 1.0, n)
    return n, select_where(zero, 1.0, x * inverse), y * inverse


@device
def clip_negative_numbers(x):
    """Return x where it is positive, else 0; NaN stays NaN."""
    return select_where(0.0 > x, 0.0, x)


@device
def make_placing_pose(ax, ay, c, s, bx, by):
    """Return the planar pose with orientation (c, s) that brings the body's point b to a."""
    return c, s, ax - (c * bx - s * by), ay - (s * bx + c * by)


@device
def count_undetermined(v, size, least):
    """Count the lanes whose position is undetermined, since `size` is not above `least`."""
    store_vector(v, FLAG, load_vector(v, FLAG) + select_where(size > least, 0.0, 1.0))


@device
def record_margin(v, margin):
    """Keep the least margin of all dyads; `margin` is the sine of the angle between the links of
    one dyad.
    """
    least = load_vector(v, MARGIN)
    store_vector(v, MARGIN, select_where(least > margin, margin, least))


@device
def add_opening(v, square):
    """Add a squared distance to the opening, the distance by which joints do not meet."""
    store_vector(v, GAP, load_vector(v, GAP) + square)


# ---- dyads groups

# Rings of three rigid clusters, and clusters that are joined twice, closed by circles and lines.
#
# Three bodies, joined in a circle by pins and rails, form the dyads of Assur (1914):
# `intersect_circles` (RRR), `intersect_line_circle` (one rail) and `intersect_lines` (two rails).
# What cannot close is put where it nearly touches. The functions return nothing; numbers in their
# docstrings are places in the integers of the operation, from 1.


@routine
def intersect_circles(v, ints, i, floats, f):
    """Join two links by a pin: circle meets circle. Pins 1 and 2: A and C of the base; 3 and 4: A
    and B of a link; 5 and 6: B and C of the other. The sign 7 is the orientation of A, C, B. Out:
    registers 8 and 9 of the links.

    The height of B above AC comes from the product of four sums of the sides, which loses nothing
    where the triangle is a needle (Kahan, "Miscalculating area and angles of a needle-like
    triangle", 2014).
    """
    ax, ay = locate_pin(v, ints[i + 1], floats, f)
    cx, cy = locate_pin(v, ints[i + 2], floats, f + 2)
    a1x, a1y = locate_pin(v, ints[i + 3], floats, f + 4)
    b1x, b1y = locate_pin(v, ints[i + 4], floats, f + 6)
    b2x, b2y = locate_pin(v, ints[i + 5], floats, f + 8)
    c2x, c2y = locate_pin(v, ints[i + 6], floats, f + 10)
    d, ux, uy = normalize_vector(cx - ax, cy - ay)
    r1, w1x, w1y = normalize_vector(b1x - a1x, b1y - a1y)
    r2, w2x, w2y = normalize_vector(b2x - c2x, b2y - c2y)
    total = r1 + r2
    less = r1 - r2
    d = select_where(d > TINY * total, d, 0.0)
    together = d == 0.0
    inverse = 1.0 / select_where(together, 1.0, d)
    x = 0.5 * (d + less * (total * inverse))
    square = (total + d) * ((total - d) * ((d - less) * (d + less)))
    y = 0.5 * inverse * compute_square_root(clip_negative_numbers(square))
    area = r1 * r2
    record_margin(v, select_where(area > 0.0, y * d / select_where(area > 0.0, area, 1.0), 0.0))
    y = load_vector(v, ints[i + 7]) * select_where(together, r1, y)
    _, e1x, e1y = normalize_vector(x, y)
    _, e2x, e2y = normalize_vector(x - d, y)
    g1x = ux * e1x - uy * e1y
    g1y = uy * e1x + ux * e1y
    g2x = ux * e2x - uy * e2y
    g2y = uy * e2x + ux * e2y
    c1 = g1x * w1x + g1y * w1y
    s1 = g1y * w1x - g1x * w1y
    c2 = g2x * w2x + g2y * w2y
    s2 = g2y * w2x - g2x * w2y
    store_pose(v, ints[i + 8], make_placing_pose(ax, ay, c1, s1, a1x, a1y))
    store_pose(v, ints[i + 9], make_placing_pose(cx, cy, c2, s2, c2x, c2y))
    count_undetermined(
        v, select_where(r1 > r2, r2, r1) + select_where(together, -total, 0.0), TINY * (total + d)
    )


@routine
def intersect_line_circle(v, ints, i, floats, f):
    """Join a slider and a link: line meets circle. Rails 1 (base) and 2 (slider); pins 3 and 4: B
    of the slider and of the link; 5 and 6: A of the link and of the base. The sign 7 is that of B -
    A along the rail: + slides farther. Out: registers 8 of the slider and 9 of the link.
    """
    px, py, dx, dy = locate_rail(v, ints[i + 1], floats, f)
    qx, qy, ex, ey = locate_rail(v, ints[i + 2], floats, f + 4)
    b1x, b1y = locate_pin(v, ints[i + 3], floats, f + 8)
    b2x, b2y = locate_pin(v, ints[i + 4], floats, f + 10)
    a2x, a2y = locate_pin(v, ints[i + 5], floats, f + 12)
    ax, ay = locate_pin(v, ints[i + 6], floats, f + 14)
    c1 = dx * ex + dy * ey
    s1 = dy * ex - dx * ey
    wx = b1x - qx
    wy = b1y - qy
    gx = px + (c1 * wx - s1 * wy) - ax
    gy = py + (s1 * wx + c1 * wy) - ay
    along = gx * dx + gy * dy
    h = dx * gy - dy * gx
    r, w2x, w2y = normalize_vector(b2x - a2x, b2y - a2y)
    t = compute_square_root(clip_negative_numbers((r - h) * (r + h)))
    record_margin(v, select_where(r > 0.0, t / select_where(r > 0.0, r, 1.0), 0.0))
    t = load_vector(v, ints[i + 7]) * t
    slid = t - along
    _, g2x, g2y = normalize_vector(t * dx - h * dy, t * dy + h * dx)
    c2 = g2x * w2x + g2y * w2y
    s2 = g2y * w2x - g2x * w2y
    store_pose(v, ints[i + 8], make_placing_pose(px + slid * dx, py + slid * dy, c1, s1, qx, qy))
    store_pose(v, ints[i + 9], make_placing_pose(ax, ay, c2, s2, a2x, a2y))
    count_undetermined(v, r, TINY * abs(h))


@routine
def intersect_lines(v, ints, i, floats, f):
    """Pin two sliders on one base together: line meets line. Rails 1 (base) and 2 (first slider), 3
    (base) and 4 (second); pins 5 and 6 of the first and of the second. Out: registers 7 and 8.
    """
    p1x, p1y, d1x, d1y = locate_rail(v, ints[i + 1], floats, f)
    q1x, q1y, e1x, e1y = locate_rail(v, ints[i + 2], floats, f + 4)
    p2x, p2y, d2x, d2y = locate_rail(v, ints[i + 3], floats, f + 8)
    q2x, q2y, e2x, e2y = locate_rail(v, ints[i + 4], floats, f + 12)
    b1x, b1y = locate_pin(v, ints[i + 5], floats, f + 16)
    b2x, b2y = locate_pin(v, ints[i + 6], floats, f + 18)
    c1 = d1x * e1x + d1y * e1y
    s1 = d1y * e1x - d1x * e1y
    c2 = d2x * e2x + d2y * e2y
    s2 = d2y * e2x - d2x * e2y
    gx = p2x + (c2 * (b2x - q2x) - s2 * (b2y - q2y)) - p1x - (c1 * (b1x - q1x) - s1 * (b1y - q1y))
    gy = p2y + (s2 * (b2x - q2x) + c2 * (b2y - q2y)) - p1y - (s1 * (b1x - q1x) + c1 * (b1y - q1y))
    det = d1x * d2y - d1y * d2x
    parallel = select_where(abs(det) > TINY, 0.0, 1.0) == 1.0
    inverse = 1.0 / select_where(parallel, 1.0, det)
    t1 = select_where(parallel, gx * d1x + gy * d1y, (gx * d2y - gy * d2x) * inverse)
    t2 = select_where(parallel, 0.0, (gx * d1y - gy * d1x) * inverse)
    store_pose(v, ints[i + 7], make_placing_pose(p1x + t1 * d1x, p1y + t1 * d1y, c1, s1, q1x, q1y))
    store_pose(v, ints[i + 8], make_placing_pose(p2x + t2 * d2x, p2y + t2 * d2y, c2, s2, q2x, q2y))
    record_margin(v, abs(det))
    count_undetermined(v, abs(det), TINY)


@routine
def place_on_pins(v, ints, i, floats, f):
    """Place a body on two pins. Pins 1 and 2 of the base, 3 and 4 of the body; exact at the first.
    Out: register 5.
    """
    ax, ay = locate_pin(v, ints[i + 1], floats, f)
    bx, by = locate_pin(v, ints[i + 2], floats, f + 2)
    a1x, a1y = locate_pin(v, ints[i + 3], floats, f + 4)
    b1x, b1y = locate_pin(v, ints[i + 4], floats, f + 6)
    d, ux, uy = normalize_vector(bx - ax, by - ay)
    r, wx, wy = normalize_vector(b1x - a1x, b1y - a1y)
    store_pose(
        v, ints[i + 5], make_placing_pose(ax, ay, ux * wx + uy * wy, uy * wx - ux * wy, a1x, a1y)
    )
    count_undetermined(v, select_where(d > r, r, d), TINY * (d + r))


@routine
def place_by_pin_rail(v, ints, i, floats, f):
    """Place a body by a pin and a rail: its pin 4 on pin 3 of the base, its rail 2 along rail 1.
    Out: register 5.
    """
    _, _, dx, dy = locate_rail(v, ints[i + 1], floats, f)
    _, _, ex, ey = locate_rail(v, ints[i + 2], floats, f + 4)
    ax, ay = locate_pin(v, ints[i + 3], floats, f + 8)
    bx, by = locate_pin(v, ints[i + 4], floats, f + 10)
    store_pose(
        v, ints[i + 5], make_placing_pose(ax, ay, dx * ex + dy * ey, dy * ex - dx * ey, bx, by)
    )


@routine
def place_on_rails(v, ints, i, floats, f):
    """Place a body on two rails: its rails 2 and 4 lie on rails 1 and 3 of the base. Out: register
    5.
    """
    p1x, p1y, d1x, d1y = locate_rail(v, ints[i + 1], floats, f)
    q1x, q1y, ex, ey = locate_rail(v, ints[i + 2], floats, f + 4)
    p2x, p2y, d2x, d2y = locate_rail(v, ints[i + 3], floats, f + 8)
    q2x, q2y, _, _ = locate_rail(v, ints[i + 4], floats, f + 12)
    c = d1x * ex + d1y * ey
    s = d1y * ex - d1x * ey
    wx = q2x - q1x
    wy = q2y - q1y
    gx = p1x + (c * wx - s * wy) - p2x
    gy = p1y + (s * wx + c * wy) - p2y
    det = d1x * d2y - d1y * d2x
    parallel = select_where(abs(det) > TINY, 0.0, 1.0) == 1.0
    t = select_where(parallel, 0.0, -(gx * d2y - gy * d2x) / select_where(parallel, 1.0, det))
    store_pose(v, ints[i + 5], make_placing_pose(p1x + t * d1x, p1y + t * d1y, c, s, q1x, q1y))
    count_undetermined(v, abs(det), TINY)


@routine
def write_sincos(v, theta):
    """Write sine and cosine, by the C library, to the spare vectors."""
    store_vector(v, K.SPARE, theta)
    for lane in range(LANES):
        x = v[LANES * K.SPARE + lane]
        store_value(v, LANES * K.SPARE + lane, math.sin(x))
        store_value(v, LANES * (K.SPARE + 1) + lane, math.cos(x))


@routine
def append_turn(v, ints, i, floats, f):
    """Set register 1 = register 2 . constant 1 . turn by (multiplier . vector 3) . constant 5."""
    theta = floats[f] * load_vector(v, ints[i + 3])
    s, c = sincos(theta)
    if expect_false(not are_all_between(-REACH, theta, REACH)):
        write_sincos(v, theta)  # lanes within reach keep theirs: none depends on the others
        far = abs(theta)
        s = select_where(far > REACH, load_vector(v, K.SPARE), s)
        c = select_where(far > REACH, load_vector(v, K.SPARE + 1), c)
    a = multiply_poses(load_pose(v, ints[i + 2]), read_constant_pose(floats, f + 1))
    a = a[0] * c - a[1] * s, a[1] * c + a[0] * s, a[2], a[3]
    store_pose(v, ints[i + 1], multiply_poses(a, read_constant_pose(floats, f + 5)))


@routine
def append_slide(v, ints, i, floats, f):
    """Set register 1 = register 2 . constant 1 . slide along x by (multiplier . vector 3) .
    constant 5.
    """
    d = floats[f] * load_vector(v, ints[i + 3])
    a = multiply_poses(load_pose(v, ints[i + 2]), read_constant_pose(floats, f + 1))
    a = a[0], a[1], a[2] + a[0] * d, a[3] + a[1] * d
    store_pose(v, ints[i + 1], multiply_poses(a, read_constant_pose(floats, f + 5)))


@routine
def rebase_registers(v, ints, i):
    """Set registers 3 and 4 to the identity and register 2, seen from the pose in register 1."""
    back = invert_pose(load_pose(v, ints[i + 1]))
    other = multiply_poses(back, load_pose(v, ints[i + 2]))
    store_pose(v, ints[i + 3], back)
    store_pose(v, ints[i + 4], other)


@device
def round_to_integer(x):
    """Round x to the nearest integer."""
    return (x + ROUND) - ROUND


@device
def round_number_up(x):
    """Return the least integer that is not below x."""
    r = round_to_integer(x)
    return select_where(x > r, r + 1.0, r)


@device
def choose_representative(a, target, period, low, high):
    """Return a plus the whole multiple of `period` that is nearest to the target, inside the limits
    where one is.
    """
    nearest = a + period * round_to_integer((target - a) / period)
    down = select_where(
        nearest > high, nearest - period * round_number_up((nearest - high) / period), nearest
    )
    up = select_where(low > down, down + period * round_number_up((low - down) / period), down)
    return select_where(up > high, nearest, up)


@routine
def read_turn(v, ints, i, floats, f):
    """Read coordinate 3, the angle of a pin between bodies 1 and 2, near target 4; a known
    coordinate (5 is not 0) is checked.

    floats: cosine and sine of the constant turn between the frames; 1/multiplier,
    -offset/multiplier, period, limits; the pin on both bodies; metres for a unit of misfit.
    """
    a = load_pose(v, ints[i + 1])
    b = load_pose(v, ints[i + 2])
    c = a[0] * b[0] + a[1] * b[1]
    s = a[0] * b[1] - a[1] * b[0]
    kc = floats[f]
    ks = floats[f + 1]
    angle = atan2(s * kc + c * ks, c * kc - s * ks) * floats[f + 2] + floats[f + 3]
    period = floats[f + 4]
    place = ints[i + 3]
    if ints[i + 5]:
        misfit = angle - load_vector(v, place)
        misfit = (misfit - period * round_to_integer(misfit / period)) * floats[f + 11]
        add_opening(v, misfit * misfit)
    else:
        store_vector(
            v,
            place,
            choose_representative(
                angle, load_vector(v, ints[i + 4]), period, floats[f + 5], floats[f + 6]
            ),
        )
    ax, ay = locate_pin(v, ints[i + 1], floats, f + 7)
    bx, by = locate_pin(v, ints[i + 2], floats, f + 9)
    add_opening(v, (bx - ax) * (bx - ax) + (by - ay) * (by - ay))


@routine
def read_slide(v, ints, i, floats, f):
    """Read coordinate 3, the slide along a rail between bodies 1 and 2; a known coordinate (5 is
    not 0) is checked.

    floats: the rail on both bodies; 1/multiplier, -offset/multiplier; metres for a unit of misfit;
    metres for a radian.
    """
    px, py, dx, dy = locate_rail(v, ints[i + 1], floats, f)
    qx, qy, ex, ey = locate_rail(v, ints[i + 2], floats, f + 4)
    gx = qx - px
    gy = qy - py
    value = (gx * dx + gy * dy) * floats[f + 8] + floats[f + 9]
    off = dx * gy - dy * gx
    place = ints[i + 3]
    if ints[i + 5]:
        misfit = (value - load_vector(v, place)) * floats[f + 10]
        add_opening(v, misfit * misfit)
    else:
        store_vector(v, place, value)
    tx = (ex - dx) * floats[f + 11]
    ty = (ey - dy) * floats[f + 11]
    add_opening(v, off * off + (tx * tx + ty * ty))


@device
def run_motion_operation(code, v, ints, i, floats, f):
    """Run one operation that computes with coordinates or registers only."""
    if code == K.SET:
        store_vector(v, ints[i + 1], spread_lanes(floats[f]))
    elif code == K.ADD:
        store_vector(
            v, ints[i + 1], load_vector(v, ints[i + 1]) + floats[f] * load_vector(v, ints[i + 2])
        )
    elif code == K.EXPECT_ZERO:
        misfit = floats[f] * load_vector(v, ints[i + 1])
        add_opening(v, misfit * misfit)
    elif code == K.TURN:
        append_turn(v, ints, i, floats, f)
    elif code == K.SLIDE:
        append_slide(v, ints, i, floats, f)
    elif code == K.DIVIDE:
        store_pose(
            v,
            ints[i + 1],
            multiply_poses(load_pose(v, ints[i + 1]), invert_pose(load_pose(v, ints[i + 2]))),
        )
    elif code == K.CARRY:
        store_pose(
            v, ints[i + 1], multiply_poses(load_pose(v, ints[i + 2]), load_pose(v, ints[i + 1]))
        )
    elif code == K.REBASE:
        rebase_registers(v, ints, i)


@device
def run_closing_operation(code, v, ints, i, floats, f):
    """Run one operation that closes a group or reads a joint."""
    if code == K.READ_TURN:
        read_turn(v, ints, i, floats, f)
    elif code == K.READ_SLIDE:
        read_slide(v, ints, i, floats, f)
    elif code == K.CIRCLES:
        intersect_circles(v, ints, i, floats, f)
    elif code == K.LINE_CIRCLE:
        intersect_line_circle(v, ints, i, floats, f)
    elif code == K.LINES:
        intersect_lines(v, ints, i, floats, f)
    elif code == K.PIN_PIN:
        place_on_pins(v, ints, i, floats, f)
    elif code == K.PIN_RAIL:
        place_by_pin_rail(v, ints, i, floats, f)
    elif code == K.RAIL_RAIL:
        place_on_rails(v, ints, i, floats, f)


@device
def reset_registers(v, ints):
    """Set all registers to the identity, the openings to zero, and the least margin of the dyads to
    one.
    """
    zero = spread_lanes(0.0)
    one = spread_lanes(1.0)
    store_vector(v, K.GAP, zero)
    store_vector(v, K.FLAG, zero)
    store_vector(v, K.MARGIN, one)
    for k in range(ints[K.N_REGISTERS]):
        store_pose(v, K.REGISTERS + 4 * k, (one, zero, zero, zero))


@kernel(
    I("_"), F("_", "_"), F("N", "_"), F("1|N", "_"), F("1|N", "nq"), OUT("N", "nq"), OUT("N", 3)
)
def run_program(ints, floats, values, signs, near, q, status):
    """Run the program of dyads for known values (N, n_known) and branch signs (N or 1, n_signs);
    return the number of rows.

    `floats` (n, k) has a row for each design; the same number N / n of rows belongs to each, one
    after the other. Writes configurations q (N, nq), angles nearest to `near` (N or 1, nq), and of each row in
    `status` (N, 3): the norm of all openings in metres, how many dyads were undetermined, and the
    least margin of a dyad, which is 0 where two of its branches meet and at most 1. A block that is
    not full repeats its last.
    """
    n = q.shape[0]
    nq = ints[K.NQ]
    known = ints[K.N_KNOWN]
    scratch = np.empty(LANES * ints[K.N_VECTORS])
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    v = get_pointer(scratch)
    each_sign = min(signs.shape[0] - 1, 1)
    each_near = min(near.shape[0] - 1, 1)
    coordinates = ints[K.COORDINATES]
    targets = ints[K.TARGETS]
    first_sign = ints[K.SIGNS]
    designs = floats.shape[0]
    rows = n // designs if designs else 0
    blocks = (rows + LANES - 1) // LANES
    for block in range(blocks * designs):
        design = block // blocks
        end = rows * (design + 1)
        start = rows * design + LANES * (block - blocks * design)
        for lane in range(LANES):
            row = min(start + lane, end - 1)
            for k in range(nq):
                scratch[LANES * (coordinates + k) + lane] = math.nan
                scratch[LANES * (targets + k) + lane] = near[row * each_near, k]
            for k in range(known):
                scratch[LANES * (coordinates + ints[K.HEADER + k]) + lane] = values[row, k]
            for k in range(ints[K.N_SIGNS]):
                scratch[LANES * (first_sign + k) + lane] = signs[row * each_sign, k]
        reset_registers(v, i_)
        for op in range(ints[K.N_OPS]):
            i = K.HEADER + known + K.OP_INTS * op
            f = K.OP_FLOATS * op + floats.shape[1] * design
            code = i_[i]
            if code < K.CIRCLES:
                run_motion_operation(code, v, i_, i, f_, f)
            else:
                run_closing_operation(code, v, i_, i, f_, f)
        for lane in range(min(LANES, end - start)):
            for k in range(nq):
                q[start + lane, k] = scratch[LANES * (coordinates + k) + lane]
            status[start + lane, 0] = math.sqrt(scratch[LANES * K.GAP + lane])
            status[start + lane, 1] = scratch[LANES * K.FLAG + lane]
            status[start + lane, 2] = scratch[LANES * K.MARGIN + lane]
    keep_alive(scratch)
    return n
