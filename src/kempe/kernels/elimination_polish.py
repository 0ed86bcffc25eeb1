"""Forward motion of a chain of six lines, and Newton's method on E_1 ... E_6 = G."""

from __future__ import annotations

import math

from kempe.kernels._jit import device, routine
from kempe.kernels.elimination_loop import LINE_STRIDE
from kempe.kernels.layout import SLIDE
from kempe.kernels.trig import sincos_any
from kempe.kernels.vectors import LANES, load_lanes, store

JACOBIAN = 8
"""Stride of the Jacobian's rows: six columns, the right-hand side, 0."""

POSE = 6 * JACOBIAN
"""Place of the reached pose (12 numbers) after the Jacobian."""

POLISH_SIZE = POSE + 12

ENOUGH = 1e-13
"""Error at which no further step is taken."""

LONGEST_STEP = 0.5
"""Largest change of a coordinate in one Newton step."""


@routine
def trace(kinds, lines, theta, work):
    """Write the product E_1(theta_1) ... E_6(theta_6) and the Jacobian: column i is the twist [direction; moment] of i.

    Both in ground axes, seen at the ground's origin. work: POLISH_SIZE numbers.
    """
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    tx = ty = tz = 0.0
    for i in range(6):
        k = LINE_STRIDE * i
        a, b, c = lines[k], lines[k + 1], lines[k + 2]
        hx, hy, hz = r0 * a + r1 * b + r2 * c, r3 * a + r4 * b + r5 * c, r6 * a + r7 * b + r8 * c
        if kinds[i] == SLIDE:
            work[i], work[JACOBIAN + i], work[2 * JACOBIAN + i] = 0.0, 0.0, 0.0
            work[3 * JACOBIAN + i], work[4 * JACOBIAN + i], work[5 * JACOBIAN + i] = hx, hy, hz
            d = theta[i]
            tx, ty, tz = tx + d * hx, ty + d * hy, tz + d * hz
            continue
        a, b, c = lines[k + 4], lines[k + 5], lines[k + 6]
        ox, oy, oz = r0 * a + r1 * b + r2 * c + tx, r3 * a + r4 * b + r5 * c + ty, r6 * a + r7 * b + r8 * c + tz
        work[i], work[JACOBIAN + i], work[2 * JACOBIAN + i] = hx, hy, hz
        work[3 * JACOBIAN + i] = oy * hz - oz * hy
        work[4 * JACOBIAN + i] = oz * hx - ox * hz
        work[5 * JACOBIAN + i] = ox * hy - oy * hx
        s, c = sincos_any(theta[i])
        v = 1.0 - c
        m0, m1, m2 = c + v * hx * hx, v * hx * hy - s * hz, v * hx * hz + s * hy
        m3, m4, m5 = v * hx * hy + s * hz, c + v * hy * hy, v * hy * hz - s * hx
        m6, m7, m8 = v * hx * hz - s * hy, v * hy * hz + s * hx, c + v * hz * hz
        r0, r3, r6 = m0 * r0 + m1 * r3 + m2 * r6, m3 * r0 + m4 * r3 + m5 * r6, m6 * r0 + m7 * r3 + m8 * r6
        r1, r4, r7 = m0 * r1 + m1 * r4 + m2 * r7, m3 * r1 + m4 * r4 + m5 * r7, m6 * r1 + m7 * r4 + m8 * r7
        r2, r5, r8 = m0 * r2 + m1 * r5 + m2 * r8, m3 * r2 + m4 * r5 + m5 * r8, m6 * r2 + m7 * r5 + m8 * r8
        tx, ty, tz = tx - ox, ty - oy, tz - oz
        tx, ty, tz = ox + m0 * tx + m1 * ty + m2 * tz, oy + m3 * tx + m4 * ty + m5 * tz, oz + m6 * tx + m7 * ty + m8 * tz
    k = POSE
    work[k], work[k + 1], work[k + 2], work[k + 3] = r0, r1, r2, tx
    work[k + 4], work[k + 5], work[k + 6], work[k + 7] = r3, r4, r5, ty
    work[k + 8], work[k + 9], work[k + 10], work[k + 11] = r6, r7, r8, tz


@device
def error(goal, work):
    """(twist of six numbers, trace) of D = goal . reached^-1: the vector of D's skew part, and D's translation."""
    t = POSE
    d = (
        goal[0] * work[t] + goal[1] * work[t + 1] + goal[2] * work[t + 2],
        goal[0] * work[t + 4] + goal[1] * work[t + 5] + goal[2] * work[t + 6],
        goal[0] * work[t + 8] + goal[1] * work[t + 9] + goal[2] * work[t + 10],
        goal[4] * work[t] + goal[5] * work[t + 1] + goal[6] * work[t + 2],
        goal[4] * work[t + 4] + goal[5] * work[t + 5] + goal[6] * work[t + 6],
        goal[4] * work[t + 8] + goal[5] * work[t + 9] + goal[6] * work[t + 10],
        goal[8] * work[t] + goal[9] * work[t + 1] + goal[10] * work[t + 2],
        goal[8] * work[t + 4] + goal[9] * work[t + 5] + goal[10] * work[t + 6],
        goal[8] * work[t + 8] + goal[9] * work[t + 9] + goal[10] * work[t + 10],
    )
    x, y, z = work[t + 3], work[t + 7], work[t + 11]
    return (
        0.5 * (d[7] - d[5]),
        0.5 * (d[2] - d[6]),
        0.5 * (d[3] - d[1]),
        goal[3] - (d[0] * x + d[1] * y + d[2] * z),
        goal[7] - (d[3] * x + d[4] * y + d[5] * z),
        goal[11] - (d[6] * x + d[7] * y + d[8] * z),
        d[0] + d[4] + d[8],
    )


@routine
def solve_six(m):
    """Least over largest pivot; solves the six equations in place, column 6 becomes the solution.

    Gauss-Jordan elimination with partial pivoting, on six rows of stride JACOBIAN.
    """
    least, largest = math.inf, 0.0
    for k in range(6):
        best, place = -1.0, k
        for i in range(k, 6):
            size = abs(m[i * JACOBIAN + k])
            if size > best:
                best, place = size, i
        if not best > 0.0:
            return 0.0
        least, largest = min(least, best), max(largest, best)
        for c in range(0, JACOBIAN, LANES):
            row = load_lanes(m, place * JACOBIAN + c)
            store(m, place * JACOBIAN + c, load_lanes(m, k * JACOBIAN + c))
            store(m, k * JACOBIAN + c, row)
        over = 1.0 / m[k * JACOBIAN + k]
        for c in range(0, JACOBIAN, LANES):
            store(m, k * JACOBIAN + c, over * load_lanes(m, k * JACOBIAN + c))
        for i in range(6):
            if i != k:
                f = m[i * JACOBIAN + k]
                for c in range(0, JACOBIAN, LANES):
                    row = load_lanes(m, i * JACOBIAN + c) - f * load_lanes(m, k * JACOBIAN + c)
                    store(m, i * JACOBIAN + c, row)
    return least / largest


@device
def wrapped(x):
    """The angle x in (-pi, pi]."""
    if -math.pi < x <= math.pi:
        return x
    y = x - 2.0 * math.pi * math.floor((x + math.pi) / (2.0 * math.pi))
    return y if y > -math.pi else math.pi


@device
def size_of(e):
    """Norm of an error, at least 1 where the rotation is far from 0."""
    size = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + e[3] * e[3] + e[4] * e[4] + e[5] * e[5])
    return size if e[6] > 1.0 else 1.0 + size


@routine
def polish(kinds, lines, goal, theta, work, steps):
    """(error at first, error at last) of `steps` Newton steps at most; theta: six numbers, improved in place."""
    begin = now = math.inf
    for step in range(steps + 1):
        trace(kinds, lines, theta, work)
        e = error(goal, work)
        now = size_of(e)
        if step == 0:
            begin = now
        if not now > ENOUGH or step == steps:
            break
        for i in range(6):
            work[8 * i + 6] = e[i]
        if not solve_six(work) > 0.0:
            break
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(work[8 * i + 6]))
        if not largest < math.inf:
            break
        factor = min(1.0, LONGEST_STEP / largest) if largest > 0.0 else 0.0
        for i in range(6):
            theta[i] += factor * work[8 * i + 6]
    return begin, now
