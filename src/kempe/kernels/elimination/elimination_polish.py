"""Forward motion of a chain of six lines, and Newton's method on E_1 ... E_6 = G."""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import LANES, load_lanes, store_value
from kempe.kernels.elimination.elimination_loop import LINE_STRIDE
from kempe.kernels.forward.table_layout import SLIDE

JACOBIAN = 8
"""Stride of the Jacobian's rows: six columns, the right-hand side, 0."""

POSE = 6 * JACOBIAN
"""Place of the reached pose (12 numbers) after the Jacobian."""

TWIST = 6
"""Column of the right-hand side."""

TURN = POSE + 12
"""Place of the rotation that is missing (9 numbers)."""

POLISH_SIZE = TURN + 9
"""Numbers of scratch that Newton's method needs."""

ENOUGH = 1e-13
NEARLY_ENOUGH = 1e-10
"""Error at which no further step is taken; error at which a step must halve it, else it is the
last."""

DISTURBANCE = 1e-4
"""How far, in radians and units of the chain's length, a disturbed goal is from the goal."""

LONGEST_STEP = 0.5
"""Largest change of a coordinate in one Newton step."""


@routine
def trace_lines(kinds, lines, theta, work):
    """Write the product E_1(theta_1) ... E_6(theta_6) and the Jacobian: column i is the twist
    [direction; moment] of i.

    Both in ground axes, seen at the ground's origin. work: POLISH_SIZE numbers.
    """
    r0 = 1.0
    r1 = 0.0
    r2 = 0.0
    r3 = 0.0
    r4 = 1.0
    r5 = 0.0
    r6 = 0.0
    r7 = 0.0
    r8 = 1.0
    tx = ty = tz = 0.0
    for i in range(6):
        k = LINE_STRIDE * i
        a = lines[k]
        b = lines[k + 1]
        c = lines[k + 2]
        hx = r0 * a + r1 * b + r2 * c
        hy = r3 * a + r4 * b + r5 * c
        hz = r6 * a + r7 * b + r8 * c
        if kinds[i] == SLIDE:
            work[i] = 0.0
            work[JACOBIAN + i] = 0.0
            work[2 * JACOBIAN + i] = 0.0
            work[3 * JACOBIAN + i] = hx
            work[4 * JACOBIAN + i] = hy
            work[5 * JACOBIAN + i] = hz
            d = theta[i]
            tx = tx + d * hx
            ty = ty + d * hy
            tz = tz + d * hz
            continue
        a = lines[k + 4]
        b = lines[k + 5]
        c = lines[k + 6]
        ox = r0 * a + r1 * b + r2 * c + tx
        oy = r3 * a + r4 * b + r5 * c + ty
        oz = r6 * a + r7 * b + r8 * c + tz
        work[i] = hx
        work[JACOBIAN + i] = hy
        work[2 * JACOBIAN + i] = hz
        work[3 * JACOBIAN + i] = oy * hz - oz * hy
        work[4 * JACOBIAN + i] = oz * hx - ox * hz
        work[5 * JACOBIAN + i] = ox * hy - oy * hx
        s, c = sincos(theta[i])
        v = 1.0 - c
        m0 = c + v * hx * hx
        m1 = v * hx * hy - s * hz
        m2 = v * hx * hz + s * hy
        m3 = v * hx * hy + s * hz
        m4 = c + v * hy * hy
        m5 = v * hy * hz - s * hx
        m6 = v * hx * hz - s * hy
        m7 = v * hy * hz + s * hx
        m8 = c + v * hz * hz
        r0, r3, r6 = (
            m0 * r0 + m1 * r3 + m2 * r6,
            m3 * r0 + m4 * r3 + m5 * r6,
            m6 * r0 + m7 * r3 + m8 * r6,
        )
        r1, r4, r7 = (
            m0 * r1 + m1 * r4 + m2 * r7,
            m3 * r1 + m4 * r4 + m5 * r7,
            m6 * r1 + m7 * r4 + m8 * r7,
        )
        r2, r5, r8 = (
            m0 * r2 + m1 * r5 + m2 * r8,
            m3 * r2 + m4 * r5 + m5 * r8,
            m6 * r2 + m7 * r5 + m8 * r8,
        )
        tx = tx - ox
        ty = ty - oy
        tz = tz - oz
        tx, ty, tz = (
            m0 * tx + m1 * ty + m2 * tz,
            m3 * tx + m4 * ty + m5 * tz,
            m6 * tx + m7 * ty + m8 * tz,
        )
        tx = tx + ox
        ty = ty + oy
        tz = tz + oz
    k = POSE
    work[k] = r0
    work[k + 1] = r1
    work[k + 2] = r2
    work[k + 3] = tx
    work[k + 4] = r3
    work[k + 5] = r4
    work[k + 6] = r5
    work[k + 7] = ty
    work[k + 8] = r6
    work[k + 9] = r7
    work[k + 10] = r8
    work[k + 11] = tz


@routine
def compare_goal(goal, work):
    """(size, trace of the rotation) of D = goal . reached^-1; writes its twist beside the Jacobian,
    in column 6.

    The twist is the vector of D's skew part, then D's translation; its size is at least 1 where D
    turns by 90 degrees or more.
    """
    t = POSE
    for i in range(3):
        a = goal[4 * i]
        b = goal[4 * i + 1]
        c = goal[4 * i + 2]
        x = a * work[t] + b * work[t + 1] + c * work[t + 2]
        y = a * work[t + 4] + b * work[t + 5] + c * work[t + 6]
        z = a * work[t + 8] + b * work[t + 9] + c * work[t + 10]
        work[TURN + 3 * i] = x
        work[TURN + 3 * i + 1] = y
        work[TURN + 3 * i + 2] = z
        shift = goal[4 * i + 3] - (x * work[t + 3] + y * work[t + 7] + z * work[t + 11])
        work[(3 + i) * JACOBIAN + TWIST] = shift
    k = TURN
    work[TWIST] = 0.5 * (work[k + 7] - work[k + 5])
    work[JACOBIAN + TWIST] = 0.5 * (work[k + 2] - work[k + 6])
    work[2 * JACOBIAN + TWIST] = 0.5 * (work[k + 3] - work[k + 1])
    square = 0.0
    for i in range(6):
        square += work[i * JACOBIAN + TWIST] * work[i * JACOBIAN + TWIST]
    trace_ = work[k] + work[k + 4] + work[k + 8]
    size = math.sqrt(square)
    return size if trace_ > 1.0 else 1.0 + size, trace_


@routine
def solve_six_equations(m):
    """Solve six linear equations in place, column 6 becomes the solution; return the ratio of least
    to largest pivot.

    Gauss-Jordan elimination with partial pivoting, on six rows of stride JACOBIAN.
    """
    least = math.inf
    largest = 0.0
    for k in range(6):
        best = -1.0
        place = k
        for i in range(k, 6):
            size = abs(m[i * JACOBIAN + k])
            if size > best:
                best = size
                place = i
        if not best > 0.0:
            return 0.0
        least = min(least, best)
        largest = max(largest, best)
        for c in range(0, JACOBIAN, LANES):
            row = load_lanes(m, place * JACOBIAN + c)
            store_value(m, place * JACOBIAN + c, load_lanes(m, k * JACOBIAN + c))
            store_value(m, k * JACOBIAN + c, row)
        over = 1.0 / m[k * JACOBIAN + k]
        for c in range(0, JACOBIAN, LANES):
            store_value(m, k * JACOBIAN + c, over * load_lanes(m, k * JACOBIAN + c))
        for i in range(6):
            if i != k:
                f = m[i * JACOBIAN + k]
                for c in range(0, JACOBIAN, LANES):
                    row = load_lanes(m, i * JACOBIAN + c) - f * load_lanes(m, k * JACOBIAN + c)
                    store_value(m, i * JACOBIAN + c, row)
    return least / largest


@device
def wrap_angle(x):
    """Return the angle x in (-pi, pi]."""
    if -math.pi < x <= math.pi:
        return x
    y = x - 2.0 * math.pi * math.floor((x + math.pi) / (2.0 * math.pi))
    return y if y > -math.pi else math.pi


@routine
def polish_posture(kinds, lines, goal, theta, work, steps):
    """Improve the six numbers theta by at most `steps` Newton steps; return (error at first, error
    at last, pivot ratio).

    Ends once the error is ENOUGH, or close to that and no longer halved by a step. The pivot ratio
    is the Jacobian's where it was last solved with: near 0 the posture is singular.
    """
    begin = before = now = math.inf
    ratio = 0.0
    for step in range(steps + 1):
        trace_lines(kinds, lines, theta, work)
        now, _ = compare_goal(goal, work)
        if step == 0:
            begin = now
        done = not now > ENOUGH or (now < NEARLY_ENOUGH and now > 0.5 * before) or step == steps
        if done and step > 0:
            break
        before = now
        ratio = solve_six_equations(work)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(work[JACOBIAN * i + TWIST]))
        if done or not ratio > 0.0 or not largest < math.inf:
            break
        factor = LONGEST_STEP / max(largest, LONGEST_STEP)
        for i in range(6):
            theta[i] += factor * work[JACOBIAN * i + TWIST]
    return begin, now, ratio


@routine
def disturb_goal(goal, out):
    """Write the goal, moved a little in a fixed, arbitrary direction."""
    x = 0.55 * DISTURBANCE
    y = -0.71 * DISTURBANCE
    z = 0.44 * DISTURBANCE
    size = 1.0 / math.sqrt(1.0 + x * x + y * y + z * z)
    for j in range(4):
        a = goal[j]
        b = goal[4 + j]
        c = goal[8 + j]
        # Cayley's rotation of the vector (x, y, z): v + 2 (r x v + r x (r x v)) / (1 + r.r)
        p = y * c - z * b
        q = z * a - x * c
        r = x * b - y * a
        f = 2.0 * size * size
        out[j] = a + f * (p + y * r - z * q)
        out[4 + j] = b + f * (q + z * p - x * r)
        out[8 + j] = c + f * (r + x * q - y * p)
    out[3] = out[3] - z
    out[7] = out[7] + x
    out[11] = out[11] + y


# ---- elimination accept

# Candidates of the elimination: Newton's method makes each a new posture, one that is known, or
# none.


FOUND = 16
RAW_ERROR = 6
PIVOTS = 7
START = 8
KNOWN = 14
CLAIMED = 15
"""Numbers of a candidate in scratch: coordinates, error before Newton's steps, pivot ratio of the
Jacobian after them, coordinates before them, which candidate it came to be, whether a root at its
value of the hidden joint led to it."""

STEPS = 12
"""Newton steps of a candidate at most; two or three are usual, where postures merge each halves the
distance."""

ACCEPT = 1e-9
"""Error up to which a candidate is kept."""

SINGULAR_RATIO = 1e-5
"""Pivot ratio of the Jacobian below which a posture counts as singular."""

APART = 1e-6
"""Coordinates that differ by less are the same posture."""


@routine
def accept_candidate(kinds, lines, goal, found, count, work):
    """Add candidate `count` to the postures: 1 for a new one, 0 for one that is known, -1 for none."""
    theta = advance_pointer(found, FOUND * count)
    for j in range(6):
        theta[START + j] = theta[j]
    begin, end, ratio = polish_posture(kinds, lines, goal, theta, work, STEPS)
    theta[RAW_ERROR] = begin
    theta[PIVOTS] = ratio
    theta[KNOWN] = float(count)
    theta[CLAIMED] = 0.0
    if not end < ACCEPT:
        return -1
    for j in range(6):
        if kinds[j] != SLIDE:
            theta[j] = wrap_angle(theta[j])
    for k in range(count):
        far = 0.0
        for j in range(6):
            d = theta[j] - found[FOUND * k + j]
            far = max(far, abs(d if kinds[j] == SLIDE else wrap_angle(d)))
        if far < APART:
            theta[KNOWN] = float(k)
            return 0
    return 1


@routine
def accept_twin(kinds, lines, goal, found, source, count, work):
    """Add the posture reached from the mirror image of candidate `source` about its own start; the
    result is that of `accept_candidate`.

    Two postures that are about to merge lie on both sides of where their common root, or two close
    ones, point.
    """
    one = advance_pointer(found, FOUND * source)
    other = advance_pointer(found, FOUND * count)
    for j in range(6):
        d = one[j] - one[START + j]
        other[j] = one[START + j] - (d if kinds[j] == SLIDE else wrap_angle(d))
    return accept_candidate(kinds, lines, goal, found, count, work)


@device
def is_singular(found, k):
    """Return whether candidate k is a singular posture."""
    return not found[FOUND * k + PIVOTS] > SINGULAR_RATIO
