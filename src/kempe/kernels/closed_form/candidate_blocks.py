"""Closed forms of arms with six turning joints, `LANES` targets side by side: eight slots a target,
no branches.

It is `closed` for the plans that most robots have, in straight lines: one joint of the outer three
comes from one equation, both roots of each of three quadratics are carried along, and no function
of the C library is called. Slots: 4 first + 2 second + inner. A target for which anything is not
plain (a root that is nearly double, an axis through the point that it should move, an error above
rounding) is marked, and left to the careful path.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    dot,
    follow,
    foot,
    identity,
    mapped,
    rotated,
    three,
    translation,
    write3,
)
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import LANES, entry, gather, keep, raw, spread_lanes, store, where
from kempe.kernels.closed_form.analytic_layout import (
    FACTOR,
    INFO,
    INNER,
    JOINT_FLOATS,
    LENGTH,
    LINES,
    MEASURE,
    MODE,
    N_JOINTS,
    N_LINES,
    OFFSET,
    OPTION,
    ORDER,
    ORIGIN,
    PLAN_HEADER,
    POINT,
    TIP,
    WHAT,
)
from kempe.kernels.closed_form.candidate_branches import ROW, ROWS, SLOTS, SharedTargets, block
from kempe.kernels.closed_form.candidate_lanes import GOAL, joint_line
from kempe.kernels.closed_form.candidates import ball_centre
from kempe.kernels.closed_form.merging import arrange
from kempe.kernels.forward.table_layout import SLIDE

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - 1 that a target's rotation may have."""

AT_LINES = 12
AT_JOINTS = AT_LINES + 6 * LINE_STRIDE
AT_SHIFT = AT_JOINTS + 6 * JOINT_FLOATS
SIX = AT_SHIFT + 13
"""Places in the numbers of the six unknowns: the tip's pose, lines, joints, a motion and an angle;
how many."""


@routine
def take_targets(targets, at, floats, tip, lanes):
    """1 in lanes whose target is sound, else 0; writes the goals G = T M^-1."""
    r = (
        gather(targets, at, 16),
        gather(targets, at + 1, 16),
        gather(targets, at + 2, 16),
        gather(targets, at + 4, 16),
        gather(targets, at + 5, 16),
        gather(targets, at + 6, 16),
        gather(targets, at + 8, 16),
        gather(targets, at + 9, 16),
        gather(targets, at + 10, 16),
    )
    p = (gather(targets, at + 3, 16), gather(targets, at + 7, 16), gather(targets, at + 11, 16))
    scale = 1.0 / floats[LENGTH]
    p = (
        (p[0] - floats[ORIGIN]) * scale,
        (p[1] - floats[ORIGIN + 1]) * scale,
        (p[2] - floats[ORIGIN + 2]) * scale,
    )
    x = (r[0], r[3], r[6])
    y = (r[1], r[4], r[7])
    z = (r[2], r[5], r[8])
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


@routine
def reduced(ints, floats, moves, locked, six):
    """Write to six (SIX numbers) the tip's pose, lines and joints of the unknowns, moved by the
    locked joints.
    """
    n = ints[N_JOINTS]
    order = beyond(ints, ORDER)
    shift = beyond(six, AT_SHIFT)
    theta = beyond(six, AT_SHIFT + 12)
    joints = beyond(floats, LINES + LINE_STRIDE * ints[N_LINES])
    identity(shift)
    for i in range(n):
        at = JOINT_FLOATS * i
        k = 0
        theta[0] = joints[at + FACTOR] * locked[i] + joints[at + OFFSET]
        h = three(floats, LINES + LINE_STRIDE * i)
        o = three(floats, LINES + LINE_STRIDE * i + 4)
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
        six[j] = column[0]
        six[4 + j] = column[1]
        six[8 + j] = column[2]
    p = mapped(shift, translation(tip))
    six[3] = p[0]
    six[7] = p[1]
    six[11] = p[2]


@device
def problem_of(ints, floats, six, lanes, out, near, near_step):
    """What the targets of a call share."""
    lines = beyond(six, AT_LINES)
    k = ints[INNER]
    what = ints[WHAT]
    x = (k + 3) % 6
    y = (k + 4) % 6
    z = (k + 5) % 6
    hy, oy = joint_line(lines, y)
    other = z if ints[OPTION] == 0 else x
    oy = foot(oy, hy, three(lines, LINE_STRIDE * other + 4), three(lines, LINE_STRIDE * other))
    normal = three(lines, LINE_STRIDE * k)
    p = ball_centre(lines, k) if what == POINT else three(lines, LINE_STRIDE * k + 4)
    return SharedTargets(
        lines,
        beyond(six, AT_JOINTS),
        lanes,
        out,
        near,
        near_step,
        beyond(ints, ORDER),
        k,
        what,
        ints[MODE],
        ints[MEASURE],
        oy,
        p,
        normal,
        translation(six),
        floats[LENGTH],
    )


@routine
def spread_rows(answers, n, order, moves, locked, count, out):
    """Write answers of six unknowns as those of n joints, with the values of the locked ones."""
    width = n + INFO
    for i in range(count * SLOTS):
        row = beyond(out, width * i)
        from_ = beyond(answers, ROW * i)
        for j in range(n):
            if moves[j] == 0:
                row[j] = locked[j]
        for j in range(6):
            row[order[j]] = from_[j]
        row[n], row[n + 1] = from_[6], from_[7]


@kernel(
    I("_"),
    F("_"),
    F("N", 4, 4),
    F("_", "n"),
    F("_", "n"),
    INT,
    OUT("N", "_", f"n+{INFO}"),
    OUTI("N"),
)
def closed_side_by_side(ints, floats, targets, near, locked, sort, out, left):
    """Number of targets left to the careful path, whose numbers are written to `left` (N,); the
    others are done.

    ints, floats: plan, see `analytic_layout`, of six unknown turning joints with an equation in one
    unknown. targets: (N, 4, 4). near: (1 or N, n), at least LANES rows if not one and locked is
    one. locked: (1 or N, n), of which the locked joints count. sort: 1 for rows in order; if none
    are left, -1 less the rows in use of the last target is returned. out: (N, SLOTS, n + INFO).
    """
    scratch = np.empty(ROWS * LANES + (16 + SLOTS * ROW) * LANES + SIX)
    n_targets = targets.shape[0]
    n = ints[N_JOINTS]
    lanes = raw(scratch)
    goals = beyond(lanes, ROWS * LANES)
    answers = beyond(lanes, (ROWS + 16) * LANES)
    six = beyond(answers, SLOTS * ROW * LANES)
    moves = beyond(raw(ints), PLAN_HEADER + ints[N_LINES])
    apart = locked.shape[0] > 1
    step = n if near.shape[0] > 1 else 0
    group = 1 if apart else n_targets  # targets of which the lines are the same
    few = group < LANES
    width = SLOTS * (n + INFO)
    direct = n == 6 and not few
    next_ = 0 if apart else step
    count = 0
    done = 0
    for first in range(0, n_targets, max(1, group)):
        wanted = beyond(raw(targets), 16 * first)
        rows = beyond(raw(out), width * first)
        held = beyond(raw(locked), n * first if apart else 0)
        reduced(raw(ints), raw(floats), moves, held, six)
        if few:  # the lanes are filled up with the last target
            for i in range(LANES):
                for j in range(16):
                    goals[16 * i + j] = wanted[16 * min(i, group - 1) + j]
        for i in range(0, group, LANES):
            at = 0 if few else min(i, group - LANES)
            pr = problem_of(
                raw(ints),
                raw(floats),
                six,
                lanes,
                beyond(rows, width * at) if direct else answers,
                beyond(raw(near), step * (first + at)),
                next_,
            )
            sound = take_targets(
                goals if few else beyond(wanted, 16 * at), 0, raw(floats), six, lanes
            )
            clear = sound * block(pr, 0)
            if not direct:
                spread_rows(
                    answers, n, pr.order, moves, held, min(LANES, group), beyond(rows, width * at)
                )
            for lane in range(i - at, min(LANES, group - at)):
                if not entry(clear, lane) > 0.5:
                    left[count] = first + at + lane
                    count += 1
    if sort != 0:
        joints = beyond(raw(floats), LINES + LINE_STRIDE * ints[N_LINES])
        for i in range(n_targets):
            used = arrange(
                n,
                joints,
                beyond(raw(near), step * i),
                beyond(raw(out), SLOTS * (n + INFO) * i),
                SLOTS,
            )
            if count == 0:
                done = -1 - used
    keep(scratch)
    return count if count > 0 else done
