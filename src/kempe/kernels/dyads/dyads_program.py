"""Planar mechanisms made of dyads, `LANES` configurations side by side: a program of closed forms
is walked.

Known coordinates place bodies, dyads are closed (`kempe.kernels.dyads.dyads_groups`), and all other
coordinates are read off the poses; how far joints are open is summed up on the way.
`kempe.solvers.dyads.assur_groups` writes the programs.
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
    rarely,
    raw,
    spread_lanes,
    store,
    where,
)
from kempe.kernels.dyads import dyads_layout as K
from kempe.kernels.dyads.dyads_groups import (
    circles,
    line_circle,
    lines,
    pin_pin,
    pin_rail,
    rail_rail,
)
from kempe.kernels.dyads.dyads_poses import (
    constant,
    inverted,
    open_by,
    pin,
    pose,
    put,
    put_pose,
    rail,
    times,
    vector,
)


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
