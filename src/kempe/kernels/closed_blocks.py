"""Closed forms of arms with six turning joints, `LANES` targets side by side: eight slots a target, no branches.

It is `closed` for the plans that most robots have, in straight lines: one joint of the outer three comes from one
equation, both roots of each of three quadratics are carried along, and no function of the C library is called. Slots:
4 first + 2 second + inner. A target for which anything is not plain (a root that is nearly double, an axis through the
point that it should move, an error above rounding) is marked, and left to the careful path.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from kempe.kernels._jit import F1, F2, F3, I1, OUT3, OUTI1, device, kernel, routine
from kempe.kernels.analytic_layout import (
    FACTOR,
    GAUGE,
    HIGH,
    INFO,
    INNER,
    INSIDE_BIT,
    JOINT_FLOATS,
    LENGTH,
    LINES,
    LOW,
    MEASURE,
    MODE,
    MULTIPLICITY_UNIT,
    N_JOINTS,
    N_LINES,
    OPTION,
    ORDER,
    ORIGIN,
    PLAN_HEADER,
    SLOT_UNIT,
    TIP,
    UNUSED,
    WHAT,
)
from kempe.kernels.closed import ball_centre
from kempe.kernels.closed_lanes import (
    FAR,
    GOAL,
    LANE_ROWS,
    X_SIDE,
    Z_SIDE,
    M,
    U,
    clear_of,
    inner_direction,
    inner_point,
    joint_line,
    load3,
    on_orbit,
    put_cs,
    roots_of,
    sides,
    term,
)
from kempe.kernels.distinct import arrange
from kempe.kernels.inner import across
from kempe.kernels.layout import SLIDE
from kempe.kernels.lines import (
    LINE_STRIDE,
    dot,
    follow,
    foot,
    identity,
    mapped,
    minus,
    plus,
    rotated,
    three,
    translation,
    turned,
    write3,
)
from kempe.kernels.outer import PLANE, POINT, X_FIRST
from kempe.kernels.scratch import beyond
from kempe.kernels.subproblems import align, cone_roots, orbit, trig_roots
from kempe.kernels.trig import ROUND, atan2
from kempe.kernels.vectors import (
    LANES,
    entry,
    gather,
    keep,
    load_lanes,
    raw,
    spread_lanes,
    square_root,
    store,
    store_columns,
    where,
)

ROUNDING, EDGE = 1e-12, 1e-10
"""The largest error that is left as it is; how far beyond a limit rounding may push a coordinate."""

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - 1 that a target's rotation may have."""

SLOTS, ROW = 8, 8
"""Slots of a target, and numbers of each: six coordinates, error, code."""

AT_ANGLES = LANE_ROWS
ROWS = LANE_ROWS + 6
"""Rows of scratch: those of `closed_lanes`, and the angles of the joints."""

AT_LINES = 12
AT_JOINTS = AT_LINES + 6 * LINE_STRIDE
AT_SHIFT = AT_JOINTS + 6 * JOINT_FLOATS
SIX = AT_SHIFT + 13
"""Places in the numbers of the six unknowns: the tip's pose, lines, joints, a motion and an angle; how many."""


@routine
def take_targets(targets, at, floats, tip, lanes):
    """1 in lanes whose target is sound, else 0; writes the goals G = T M^-1."""
    r = (
        gather(targets, at, 16), gather(targets, at + 1, 16), gather(targets, at + 2, 16),
        gather(targets, at + 4, 16), gather(targets, at + 5, 16), gather(targets, at + 6, 16),
        gather(targets, at + 8, 16), gather(targets, at + 9, 16), gather(targets, at + 10, 16),
    )  # fmt: skip
    p = (gather(targets, at + 3, 16), gather(targets, at + 7, 16), gather(targets, at + 11, 16))
    scale = 1.0 / floats[LENGTH]
    p = ((p[0] - floats[ORIGIN]) * scale, (p[1] - floats[ORIGIN + 1]) * scale, (p[2] - floats[ORIGIN + 2]) * scale)
    x, y, z = (r[0], r[3], r[6]), (r[1], r[4], r[7]), (r[2], r[5], r[8])
    normal = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    off = abs(dot(x, x) - 1.0) + abs(dot(y, y) - 1.0) + abs(dot(x, y))
    off = off + abs(normal[0] - z[0]) + abs(normal[1] - z[1]) + abs(normal[2] - z[2])
    off = off + 0.0 * (p[0] + p[1] + p[2])
    off = off + abs(gather(targets, at + 12, 16)) + abs(gather(targets, at + 13, 16))
    off = off + abs(gather(targets, at + 14, 16)) + abs(gather(targets, at + 15, 16) - 1.0)
    for i in range(3):
        row = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
        a = dot(row, three(tip, 0))
        b = dot(row, three(tip, 4))
        c = dot(row, three(tip, 8))
        store(lanes, (GOAL + 4 * i) * LANES, a)
        store(lanes, (GOAL + 4 * i + 1) * LANES, b)
        store(lanes, (GOAL + 4 * i + 2) * LANES, c)
        t = translation(tip)
        store(lanes, (GOAL + 4 * i + 3) * LANES, p[i] - (a * t[0] + b * t[1] + c * t[2]))
    return where(ROTATION_TOLERANCE > off, 1.0, spread_lanes(0.0))


class Problem(NamedTuple):
    """What all targets of a call share; pointers and numbers."""

    lines: object
    joints: object
    lanes: object
    out: object
    near: object
    near_step: int
    order: object
    k: int
    what: int
    mode: int
    measure: int
    oy: object
    p: object
    n: object
    probe: object
    length: float


@device
def coordinate(pr, joint, theta, near):
    """(q, inside) of a joint: of all turns the one inside the limits and nearest to `near`; inside is 1 or 0."""
    at = JOINT_FLOATS * joint
    low, high = pr.joints[at + LOW], pr.joints[at + HIGH]
    period = 2.0 * math.pi / abs(pr.joints[at + FACTOR])
    per = 1.0 / period
    q = (theta - pr.joints[at + GAUGE]) * (1.0 / pr.joints[at + FACTOR])
    q = q + period * (((near - q) * per + ROUND) - ROUND)
    # one period back inside is tried from either side; where none fits, q stays as it is and is outside
    over, under = (q - (high + EDGE)) * per, ((low - EDGE) - q) * per
    down = q - period * (((over + 0.5) + ROUND) - ROUND)
    up = q + period * (((under + 0.5) + ROUND) - ROUND)
    moved = where(over > 0.0, down, where(under > 0.0, up, q))
    fits = where(moved > high + EDGE, 0.0, where(low - EDGE > moved, 0.0, spread_lanes(1.0)))
    q = where(fits > 0.5, moved, q)
    q = where(fits > 0.5, where(q > high, high, where(low > q, low, q)), q)
    return q, fits


@routine
def write_row(pr, at, slot, valid, error):
    """Nothing; one slot of all lanes, from the angles in the scratch."""
    place = at * SLOTS * ROW + slot * ROW
    inside = spread_lanes(1.0)
    q0, f0 = coordinate(pr, 0, load_lanes(pr.lanes, AT_ANGLES * LANES), near_of(pr, at, 0))
    q1, f1 = coordinate(pr, 1, load_lanes(pr.lanes, (AT_ANGLES + 1) * LANES), near_of(pr, at, 1))
    q2, f2 = coordinate(pr, 2, load_lanes(pr.lanes, (AT_ANGLES + 2) * LANES), near_of(pr, at, 2))
    q3, f3 = coordinate(pr, 3, load_lanes(pr.lanes, (AT_ANGLES + 3) * LANES), near_of(pr, at, 3))
    q4, f4 = coordinate(pr, 4, load_lanes(pr.lanes, (AT_ANGLES + 4) * LANES), near_of(pr, at, 4))
    q5, f5 = coordinate(pr, 5, load_lanes(pr.lanes, (AT_ANGLES + 5) * LANES), near_of(pr, at, 5))
    inside = inside * f0 * f1 * f2 * f3 * f4 * f5
    code = where(valid > 0.5, MULTIPLICITY_UNIT + SLOT_UNIT * (slot + 1) + INSIDE_BIT * inside, UNUSED)
    store_columns(pr.out, place, SLOTS * ROW, q0, q1, q2, q3)
    store_columns(pr.out, place + 4, SLOTS * ROW, q4, q5, error, code)


@device
def near_of(pr, at, joint):
    """What the coordinate of a joint shall be near, in all lanes."""
    return gather(pr.near, pr.near_step * at + pr.order[joint], pr.near_step)


@device
def put_angle(lanes, joint, c, s):
    """Write cosine, sine and angle of a joint."""
    put_cs(lanes, joint, c, s)
    store(lanes, (AT_ANGLES + joint) * LANES, atan2(s, c))


@routine
def error_of(pr, a, b, c, w, dr, dp, r):
    """The error of one solution: a probe point and two directions moved by the inner joints, against where they go."""
    ha, oa = joint_line(pr.lines, pr.k)
    hb, ob = joint_line(pr.lines, pr.k + 1)
    hc, oc = joint_line(pr.lines, pr.k + 2)
    p = plus(oc, 1.0, turned(hc, minus(pr.probe, oc), c[0], c[1]))
    p = plus(ob, 1.0, turned(hb, minus(p, ob), b[0], b[1]))
    p = plus(oa, 1.0, turned(ha, minus(p, oa), a[0], a[1]))
    x = turned(ha, turned(hb, turned(hc, r, c[0], c[1]), b[0], b[1]), a[0], a[1])
    y = turned(ha, turned(hb, hc, b[0], b[1]), a[0], a[1])
    p, x, y = minus(p, dp), minus(x, dr), minus(y, w)
    return square_root(pr.length * pr.length * dot(p, p) + dot(x, x) + dot(y, y))


@routine
def inner_pair(pr, at, slot, valid, clear):
    """`clear` after both solutions of the inner joints were written; the outer angles are in the scratch."""
    ha, oa = joint_line(pr.lines, pr.k)
    hb, ob = joint_line(pr.lines, pr.k + 1)
    hc, oc = joint_line(pr.lines, pr.k + 2)
    r = across(hc)
    w, dr = inner_direction(pr.lines, pr.k, pr.lanes, hc), inner_direction(pr.lines, pr.k, pr.lanes, r)
    dp = inner_point(pr.lines, pr.k, pr.lanes, pr.probe)
    one = spread_lanes(1.0)
    goal = w
    middle, u0, w0 = orbit(hb, minus(oc, ob))
    if pr.what == POINT:
        c0, s0, c1, s1, d2 = cone_roots(ha, hb, hc, w)
        sa, sb = minus(ha, plus((0.0, 0.0, 0.0), dot(ha, hb), hb)), minus(hc, plus((0.0, 0.0, 0.0), dot(hc, hb), hb))
        size = one * (dot(sa, sa) * dot(sb, sb))
    else:
        q = minus(inner_point(pr.lines, pr.k, pr.lanes, oc), oa)
        goal = minus(q, plus((0.0, 0.0, 0.0), dot(hc, q), hc))
        fixed = minus(plus(middle, 1.0, ob), oa)
        fixed = minus(fixed, plus((0.0, 0.0, 0.0), dot(hc, fixed), hc))
        x, y = 2.0 * dot(fixed, u0), 2.0 * dot(fixed, w0)
        c0, s0, c1, s1, d2 = trig_roots(one * x, one * y, dot(goal, goal) - dot(fixed, fixed) - dot(u0, u0))
        size = one * (x * x + y * y)
        middle = fixed
    there = where(d2 > 0.0, one, 0.0)
    clear = clear * where(valid > 0.5, clear_of(d2, size), 1.0)
    valid = valid * there
    for i in range(2):
        c, s = c0, s0
        if i == 1:
            c, s = c1, s1
        u = turned(hb, (one * hc[0], one * hc[1], one * hc[2]), c, s)
        if pr.what == PLANE:
            u = plus(plus((one * middle[0], one * middle[1], one * middle[2]), c, u0), s, w0)
        ca, sa_, size_a = align(ha, u, goal)
        back = turned(hb, turned(ha, dr, ca, -sa_), c, -s)
        cc, sc, _ = align(hc, r, back)
        put_angle(pr.lanes, pr.k, ca, sa_)
        put_angle(pr.lanes, pr.k + 1, c, s)
        put_angle(pr.lanes, pr.k + 2, cc, sc)
        error = error_of(pr, (ca, sa_), (c, s), (cc, sc), w, dr, dp, r)
        fine = where(ROUNDING > error, where(size_a > FAR * FAR, one, 0.0), 0.0)
        clear = clear * where(valid > 0.5, fine, 1.0)
        write_row(pr, at, slot + i, valid, error)
    return clear


@routine
def second_pair(pr, at, slot, c, s, valid, clear):
    """`clear` after the four solutions were written that belong to one angle of the first joint."""
    first, second = (X_SIDE, Z_SIDE) if pr.mode == X_FIRST else (Z_SIDE, X_SIDE)
    x, y, z = (pr.k + 3) % 6, (pr.k + 4) % 6, (pr.k + 5) % 6
    hy = three(pr.lines, LINE_STRIDE * y)
    lanes = pr.lanes
    v = on_orbit(lanes, first, c, s)
    j = 1 - pr.measure
    known = dot(hy, v)
    if j == 1:
        t = term(lanes, first, hy, 1)
        known = t[0] + t[1] * c + t[2] * s
    sign = 1.0 if pr.mode == X_FIRST else -1.0
    c0, s0, c1, s1, there, plain = roots_of(lanes, second, sign, hy, pr.what, j, known, v)
    clear = clear * where(valid > 0.5, plain, 1.0)
    valid = valid * there
    for i in range(2):
        c2, s2 = c0, s0
        if i == 1:
            c2, s2 = c1, s1
        other = on_orbit(lanes, second, c2, s2)
        if pr.mode == X_FIRST:
            cy, sy, size = align(hy, other, v)
            put_angle(lanes, x, c, s)
            put_angle(lanes, z, c2, s2)
        else:
            cy, sy, size = align(hy, v, other)
            put_angle(lanes, z, c, s)
            put_angle(lanes, x, c2, s2)
        put_angle(lanes, y, cy, sy)
        clear = clear * where(valid > 0.5, where(size > FAR * FAR, 1.0, spread_lanes(0.0)), 1.0)
        clear = inner_pair(pr, at, slot + 2 * i, valid, clear)
    return clear


@routine
def block(pr, at):
    """1 in lanes whose target was plain, else 0; writes all slots of the targets from `at` on."""
    first, second = (X_SIDE, Z_SIDE) if pr.mode == X_FIRST else (Z_SIDE, X_SIDE)
    hy = three(pr.lines, LINE_STRIDE * ((pr.k + 4) % 6))
    lanes = pr.lanes
    sides(pr.lines, pr.k, pr.what, pr.n, pr.p, pr.oy, lanes)
    known = term(lanes, second, hy, pr.measure)[0]
    w = plus(load3(lanes, second + M), 1.0, load3(lanes, second + U))
    sign = -1.0 if pr.mode == X_FIRST else 1.0
    c0, s0, c1, s1, valid, clear = roots_of(lanes, first, sign, hy, pr.what, pr.measure, known, w)
    clear = second_pair(pr, at, 0, c0, s0, valid, clear)
    return second_pair(pr, at, 4, c1, s1, valid, clear)


@routine
def reduced(ints, floats, moves, locked, six):
    """Nothing; six (SIX numbers) gets the tip's pose, lines and joints of the unknowns, carried by the locked ones."""
    n, order = ints[N_JOINTS], beyond(ints, ORDER)
    shift, theta = beyond(six, AT_SHIFT), beyond(six, AT_SHIFT + 12)
    joints = beyond(floats, LINES + LINE_STRIDE * ints[N_LINES])
    identity(shift)
    for i in range(n):
        at, k = JOINT_FLOATS * i, 0
        theta[0] = joints[at + FACTOR] * locked[i] + joints[at + GAUGE]
        h, o = three(floats, LINES + LINE_STRIDE * i), three(floats, LINES + LINE_STRIDE * i + 4)
        if moves[i] == 0:
            slides = ints[PLAN_HEADER + i] == SLIDE
            follow(shift, h, o, slides, theta[0], math.cos(theta[0]), math.sin(theta[0]))
            continue
        while order[k] != i:
            k += 1
        write3(six, AT_LINES + LINE_STRIDE * k, rotated(shift, h))
        write3(six, AT_LINES + LINE_STRIDE * k + 4, mapped(shift, o))
        for j in range(JOINT_FLOATS):
            six[AT_JOINTS + JOINT_FLOATS * k + j] = joints[at + j]
    tip = beyond(floats, TIP)
    for j in range(3):
        column = rotated(shift, (tip[j], tip[4 + j], tip[8 + j]))
        six[j], six[4 + j], six[8 + j] = column[0], column[1], column[2]
    p = mapped(shift, translation(tip))
    six[3], six[7], six[11] = p[0], p[1], p[2]


@device
def problem_of(ints, floats, six, lanes, out, near, near_step):
    """What the targets of a call share."""
    lines, k, what = beyond(six, AT_LINES), ints[INNER], ints[WHAT]
    x, y, z = (k + 3) % 6, (k + 4) % 6, (k + 5) % 6
    hy, oy = joint_line(lines, y)
    other = z if ints[OPTION] == 0 else x
    oy = foot(oy, hy, three(lines, LINE_STRIDE * other + 4), three(lines, LINE_STRIDE * other))
    normal = three(lines, LINE_STRIDE * k)
    p = ball_centre(lines, k) if what == POINT else three(lines, LINE_STRIDE * k + 4)
    return Problem(lines, beyond(six, AT_JOINTS), lanes, out, near, near_step, beyond(ints, ORDER), k, what,
                   ints[MODE], ints[MEASURE], oy, p, normal, translation(six), floats[LENGTH])  # fmt: skip


@routine
def spread_rows(answers, n, order, moves, locked, count, out):
    """Nothing; answers of six unknowns written as those of n joints, with the values of the locked ones."""
    width = n + INFO
    for i in range(count * SLOTS):
        row, from_ = beyond(out, width * i), beyond(answers, ROW * i)
        for j in range(n):
            if moves[j] == 0:
                row[j] = locked[j]
        for j in range(6):
            row[order[j]] = from_[j]
        row[n], row[n + 1] = from_[6], from_[7]


@kernel(types.int64(I1, F1, F3, F2, F2, types.int64, OUT3, OUTI1))
def closed_side_by_side(ints, floats, targets, near, locked, sort, out, left):
    """Number of targets left to the careful path, whose numbers are written to `left` (N,); the others are done.

    ints, floats: plan, see `analytic_layout`, of six unknown turning joints with an equation in one unknown. targets:
    (N, 4, 4). near: (1 or N, n), at least LANES rows if not one. locked: (1, n), of which the locked joints count. sort: 1 for rows in order; if none
    are left, `left` then has the number of rows in use. out: (N, SLOTS, n + INFO).
    """
    scratch = np.empty(ROWS * LANES + (16 + SLOTS * ROW) * LANES + SIX)
    n_targets, n = targets.shape[0], ints[N_JOINTS]
    lanes = raw(scratch)
    goals, answers = beyond(lanes, ROWS * LANES), beyond(lanes, (ROWS + 16) * LANES)
    six = beyond(answers, SLOTS * ROW * LANES)
    moves = beyond(raw(ints), PLAN_HEADER + ints[N_LINES])
    reduced(raw(ints), raw(floats), moves, raw(locked), six)
    few, step = n_targets < LANES, n if near.shape[0] > 1 else 0
    direct = n == 6 and not few
    if few:  # the lanes are filled up with the last target
        for i in range(LANES if n_targets > 0 else 0):
            for j in range(16):
                goals[16 * i + j] = raw(targets)[16 * min(i, n_targets - 1) + j]
    count = 0
    for i in range(0, n_targets, LANES):
        at = 0 if few else min(i, n_targets - LANES)
        pr = problem_of(raw(ints), raw(floats), six, lanes, beyond(raw(out), SLOTS * ROW * at) if direct else answers,
                        beyond(raw(near), step * at), step)  # fmt: skip
        some = goals if few else beyond(raw(targets), 16 * at)
        sound = take_targets(some, 0, raw(floats), six, lanes)
        clear = sound * block(pr, 0)
        if not direct:
            width = SLOTS * (n + INFO)
            spread_rows(answers, n, pr.order, moves, raw(locked), min(LANES, n_targets), beyond(raw(out), width * at))
        for lane in range(i - at, min(LANES, n_targets - at)):
            if not entry(clear, lane) > 0.5:
                left[count] = at + lane
                count += 1
    if sort != 0:
        joints = beyond(raw(floats), LINES + LINE_STRIDE * ints[N_LINES])
        for i in range(n_targets):
            used = arrange(n, joints, beyond(raw(near), step * i), beyond(raw(out), SLOTS * (n + INFO) * i), SLOTS)
            if count == 0:
                left[i] = used
    keep(scratch)
    return count
