"""Assembly: a configuration that closes all loops, by damped least squares over the unknown coordinates.

Step: -J^T (J J^T + mu I)^-1 phi, of minimum norm, so that redundant equations are no obstacle; mu falls with the
square of the residual, so that convergence is quadratic (Nakamura and Hanafusa, 1986; Sugihara, 2011). J J^T is kept
within its envelope (Jennings, 1966): rows that share no coordinates cost nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels import loop_layout as L
from kempe.kernels._jit import F1, F2, I1, OUT1, OUT2, OUTI2, device, kernel, routine
from kempe.kernels.layout import N_ROWS as TABLE_ROWS
from kempe.kernels.layout import NQ, NV
from kempe.kernels.random import mix, unit
from kempe.kernels.scratch import beyond
from kempe.kernels.starts import copy, draw_ball
from kempe.kernels.step import turn_ball
from kempe.kernels.sweep import poses_at, row_poses, scratch_size
from kempe.kernels.ties import Loops, back, ends_of, fill, relative
from kempe.kernels.trig import atan2
from kempe.kernels.vectors import keep, raw

SOLVED, NOT_CLOSED, BAD_INPUT = 0, 1, 2
"""Status of one assembly."""
FLOOR = 1e-30
"""Square of the scaled residual below which rounding is all there is."""
LARGEST = 1e100
"""Size from which a number is no coordinate."""
DAMPING, LEAST = 1e-1, 1e-14
"""Damping by the square of the residual, and its floor, which holds up J J^T where equations are redundant."""
LONGEST = 1.0
"""Longest step of a coordinate, in radians or characteristic lengths."""


@device
def sort_of(loops, v):
    """Sort of velocity coordinate v."""
    return loops.plan[loops.plan[L.AT_PLACES] + L.PLACE_INTS * v + 1]


@device
def place_of(loops, v):
    """Place in q of velocity coordinate v, for a ball of its quaternion."""
    return loops.plan[loops.plan[L.AT_PLACES] + L.PLACE_INTS * v]


@device
def is_held(loops, v):
    """Whether v is no unknown."""
    return loops.plan[loops.plan[L.AT_PLACES] + L.PLACE_INTS * v + 2] != 0


@device
def number(loops, list_, v):
    """Entry v of a list of velocities in `weights`: 0 scales, 1 lower, 2 upper limits, 3 and 4 ends to draw from."""
    return loops.weights[L.SCALES + list_ * loops.nv + v]


@device
def evaluate(loops, with_blocks):
    """Square of the scaled residual at q."""
    row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    return fill(loops, with_blocks)


@device
def product(loops, v, y):
    """Column v of the scaled Jacobian times y."""
    plan = loops.plan
    total = 0.0
    at = plan[L.AT_VARS] + v
    for use in range(plan[at], plan[at + 1]):
        k = plan[L.AT_USES] + L.USE_INTS * use
        tie = plan[L.AT_TIES] + L.TIE_INTS * plan[k]
        rows, first = plan[tie + L.ROWS], plan[tie + L.FIRST_ROW]
        block = plan[tie + L.BLOCK] + rows * plan[k + 1]
        for i in range(rows):
            total += loops.blocks[block + i] * y[first + i]
    return total


@routine
def normal(loops, step, damping, a, column):
    """Write the lower triangle of J J^T + damping I, row by row within its envelope; without columns marked NaN.

    Each column is spread out first, so that the inner loop runs over neighbours.
    """
    plan, blocks = loops.plan, loops.blocks
    for i in range(plan[L.ENVELOPE]):
        a[i] = 0.0
    rows_at, ties_at, uses_at, m = plan[L.AT_ROWS], plan[L.AT_TIES], plan[L.AT_USES], plan[L.N_ROWS]
    for i in range(m):
        column[i] = 0.0
        k = rows_at + L.ENVELOPE_INTS * i
        a[plan[k + 1] + i - plan[k]] = damping
    for v in range(loops.nv):
        if step[v] != step[v]:
            continue
        at = plan[L.AT_VARS] + v
        low, high = m, 0
        for use in range(plan[at], plan[at + 1]):
            k = uses_at + L.USE_INTS * use
            tie = ties_at + L.TIE_INTS * plan[k]
            rows, first = plan[tie + L.ROWS], plan[tie + L.FIRST_ROW]
            block = plan[tie + L.BLOCK] + rows * plan[k + 1]
            for i in range(rows):
                column[first + i] = blocks[block + i]
            low, high = min(low, first), max(high, first + rows)
        for i in range(low, high):
            x = column[i]
            if x != 0.0:
                k = rows_at + L.ENVELOPE_INTS * i
                row = beyond(a, plan[k + 1] + low - plan[k])
                there = beyond(column, low)
                for j in range(i + 1 - low):
                    row[j] += x * there[j]
        for i in range(low, high):
            column[i] = 0.0


@device
def dot(a, b, n):
    """The scalar product of n numbers each, in two sums."""
    even, odd = 0.0, 0.0
    for k in range(n // 2):
        even += a[2 * k] * b[2 * k]
        odd += a[2 * k + 1] * b[2 * k + 1]
    if n % 2:
        even += a[n - 1] * b[n - 1]
    return even + odd


@routine
def factor(loops, a, least):
    """Overwrite the matrix by L and D, A = L D L^T; pivots below `least` are rounding and become it."""
    plan = loops.plan
    rows_at = plan[L.AT_ROWS]
    for i in range(plan[L.N_ROWS]):
        k = rows_at + L.ENVELOPE_INTS * i
        first, row = plan[k], plan[k + 1] - plan[k]
        for j in range(first + 1, i):
            k = rows_at + L.ENVELOPE_INTS * j
            start, other = max(first, plan[k]), plan[k + 1] - plan[k]
            if start < j:  # L_ij D_j until the row is done
                a[row + j] -= dot(beyond(a, row + start), beyond(a, other + start), j - start)
        d = a[row + i]
        for j in range(first, i):
            k = rows_at + L.ENVELOPE_INTS * j
            g = a[row + j]
            x = g / a[plan[k + 1] - plan[k] + j]
            a[row + j] = x
            d -= g * x
        a[row + i] = max(d, least)


@routine
def solve(loops, a, y):
    """Overwrite y by the solution of L D L^T x = y."""
    plan = loops.plan
    rows_at, m = plan[L.AT_ROWS], plan[L.N_ROWS]
    for i in range(m):
        k = rows_at + L.ENVELOPE_INTS * i
        first, row = plan[k], plan[k + 1] - plan[k]
        s = y[i]
        for j in range(first, i):
            s -= a[row + j] * y[j]
        y[i] = s
    for back_ in range(m):
        i = m - 1 - back_
        k = rows_at + L.ENVELOPE_INTS * i
        y[i] /= a[plan[k + 1] - plan[k] + i]
    for back_ in range(m):
        i = m - 1 - back_
        k = rows_at + L.ENVELOPE_INTS * i
        first, row = plan[k], plan[k + 1] - plan[k]
        s = y[i]
        for j in range(first, i):
            y[j] -= a[row + j] * s


@device
def mark(loops, step):
    """Mark NaN the steps of coordinates that stay: held ones, and those at a limit that the gradient pushes out."""
    for v in range(loops.nv):
        step[v] = 0.0
        if is_held(loops, v):
            step[v] = np.nan
            continue
        if sort_of(loops, v) >= L.BALL_FIRST:
            continue
        x, low, high = loops.q[place_of(loops, v)], number(loops, 1, v), number(loops, 2, v)
        if x <= low or x >= high:
            push = -product(loops, v, loops.error)
            if (x <= low and push <= 0.0) or (x >= high and push >= 0.0):
                step[v] = np.nan


@routine
def move(loops, step, y, target, with_target):
    """Size of the step -J^T y (+ target); takes it, cut to LONGEST and at the limits."""
    size = 0.0
    for v in range(loops.nv):
        if step[v] == step[v]:
            step[v] = -product(loops, v, y)
            if with_target:
                step[v] += target[v]
            size = max(size, abs(step[v]))
    part = min(1.0, LONGEST / size) if size > 0.0 else 1.0
    q = loops.q
    for v in range(loops.nv):
        if step[v] != step[v]:
            continue
        sort, i = sort_of(loops, v), place_of(loops, v)
        if sort == L.BALL_FIRST:
            turn_ball(q, i, part * step[v], part * step[v + 1], part * step[v + 2])
        elif sort != L.BALL_MORE:
            x = q[i] + part * step[v] * number(loops, 0, v)
            q[i] = min(max(x, number(loops, 1, v)), number(loops, 2, v))
    return size


@routine
def close(loops, limit, accepted, step, a, y, column, kept):
    """Least square of the residual reached from q, and steps taken; `kept` is where."""
    best, before, steps = np.inf, np.inf, 0
    m = loops.plan[L.N_ROWS]
    while True:
        square = evaluate(loops, True)
        if not square < LARGEST:
            break
        if square < best:
            best = square
            copy(kept, loops.q, 0, loops.nq)
        if square <= FLOOR or (square <= accepted and square > 0.1 * before) or steps >= limit:
            break
        before = square
        damping = DAMPING * min(square, 1.0) + LEAST
        mark(loops, step)
        normal(loops, step, damping, a, column)
        factor(loops, a, LEAST)
        copy(y, loops.error, 0, m)
        solve(loops, a, y)
        size = move(loops, step, y, step, False)
        steps += 1
        if size < 1e-15:
            break
    return best, steps


@device
def ball_difference(q, home, i, to, at):
    """Write the rotation vector from the quaternion at q[i:] to that at home[i:] to to[at:]."""
    w, x, y, z = q[i], -q[i + 1], -q[i + 2], -q[i + 3]
    a, b, c, d = home[i], home[i + 1], home[i + 2], home[i + 3]
    rw = w * a - x * b - y * c - z * d
    rx = w * b + x * a + y * d - z * c
    ry = w * c - x * d + y * a + z * b
    rz = w * d + x * c - y * b + z * a
    sine = math.sqrt(rx * rx + ry * ry + rz * rz)
    f = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, abs(rw)) / sine
    f = math.copysign(f, rw)
    to[at], to[at + 1], to[at + 2] = f * rx, f * ry, f * rz


@routine
def approach(loops, limit, home, step, a, y, column, target, kept):
    """Steps taken along the closed configurations towards the one nearest to `home`, from a closed q.

    Gauss-Newton steps of the nearest point: home - J^+ (phi + J (home - q)); they stop when they no longer come
    nearer. `kept` is where.
    """
    m, plan = loops.plan[L.N_ROWS], loops.plan
    least, steps = np.inf, 0
    while steps < limit:
        square = evaluate(loops, True)
        mark(loops, step)
        far = 0.0
        for v in range(loops.nv):
            if sort_of(loops, v) == L.BALL_FIRST:
                ball_difference(loops.q, home, place_of(loops, v), target, v)
            elif sort_of(loops, v) != L.BALL_MORE:
                i = place_of(loops, v)
                target[v] = (home[i] - loops.q[i]) / number(loops, 0, v)
        for v in range(loops.nv):
            far += target[v] * target[v]
        for i in range(m):
            y[i] = loops.error[i]
        for v in range(loops.nv):
            if step[v] == step[v]:
                at = plan[L.AT_VARS] + v
                for use in range(plan[at], plan[at + 1]):
                    k = plan[L.AT_USES] + L.USE_INTS * use
                    tie = plan[L.AT_TIES] + L.TIE_INTS * plan[k]
                    rows, first = plan[tie + L.ROWS], plan[tie + L.FIRST_ROW]
                    for i in range(rows):
                        y[first + i] += loops.blocks[plan[tie + L.BLOCK] + rows * plan[k + 1] + i] * target[v]
        if far + 1e3 * square >= least:
            break
        least = far + 1e3 * square
        copy(kept, loops.q, 0, loops.nq)
        normal(loops, step, LEAST, a, column)
        factor(loops, a, LEAST)
        solve(loops, a, y)
        steps += 1
        if move(loops, step, y, target, True) < 1e-12:
            break
    return steps


@device
def nearest_turn(x, to):
    """The angle x plus whole turns, as near as can be to the angle `to`."""
    return x - 2.0 * math.pi * math.ceil((x - to) / (2.0 * math.pi) - 0.5)


@device
def quaternion_of(r, q, i, home):
    """Write the unit quaternion of the rotation r to q[i:], of the sign that is nearer to home[i:]."""
    if r[0] + r[4] + r[8] > 0.0:
        w, x, y, z = 1.0 + r[0] + r[4] + r[8], r[7] - r[5], r[2] - r[6], r[3] - r[1]
    elif r[0] >= r[4] and r[0] >= r[8]:
        w, x, y, z = r[7] - r[5], 1.0 + r[0] - r[4] - r[8], r[1] + r[3], r[2] + r[6]
    elif r[4] >= r[8]:
        w, x, y, z = r[2] - r[6], r[1] + r[3], 1.0 - r[0] + r[4] - r[8], r[5] + r[7]
    else:
        w, x, y, z = r[3] - r[1], r[2] + r[6], r[5] + r[7], 1.0 - r[0] - r[4] + r[8]
    size = math.sqrt(w * w + x * x + y * y + z * z)
    if w * home[i] + x * home[i + 1] + y * home[i + 2] + z * home[i + 3] < 0.0:
        size = -size
    q[i], q[i + 1], q[i + 2], q[i + 3] = w / size, x / size, y / size, z / size


@routine
def read_off(loops, home):
    """Write the coordinates of cut joints to q, and bring angles that a turn brings back near to `home`.

    The poses must be those of q. Angles of crosses and of three turns are as in `joints`.
    """
    plan, q = loops.plan, loops.q
    for n in range(plan[L.N_READINGS]):
        k = plan[L.AT_READINGS] + L.READING_INTS * n
        code, i = plan[k], plan[k + 1]
        r_a, p_a, r_b, p_b = ends_of(loops, plan[k + 2])
        p = back(r_a, p_b[0] - p_a[0], p_b[1] - p_a[1], p_b[2] - p_a[2])
        r = relative(r_a, r_b)
        if code <= L.READ_Z:
            q[i] = p[code]
        elif code == L.READ_QUATERNION:
            quaternion_of(r, q, i, home)
        else:
            if code == L.READ_ANGLE:
                angle = atan2(r[3] - r[1], r[0] + r[4])
            elif code == L.READ_RX:
                angle = atan2(r[7], r[4])
            elif code == L.READ_RY:
                angle = atan2(r[2], r[0])
            elif code == L.READ_YAW:
                angle = atan2(r[3], r[0])
            elif code == L.READ_PITCH:
                angle = atan2(-r[6], math.sqrt(r[0] * r[0] + r[3] * r[3]))
            else:
                angle = atan2(r[7], r[8])
            q[i] = nearest_turn(angle, home[i])
    for v in range(loops.nv):
        if sort_of(loops, v) == L.CIRCLE and not is_held(loops, v):
            i = place_of(loops, v)
            q[i] = nearest_turn(q[i], home[i])


@routine
def draw(loops, home, spread, key):
    """Write a random configuration to q: unknowns within `spread` of their range about `home`, or anywhere for 1."""
    q = loops.q
    copy(q, home, 0, loops.nq)
    for v in range(loops.nv):
        if is_held(loops, v):
            continue
        sort, i, fresh = sort_of(loops, v), place_of(loops, v), mix(key, np.uint64(v))
        if sort == L.BALL_FIRST:
            if spread >= 1.0:
                draw_ball(q, i, fresh)
            else:
                t = 2.0 * math.pi * spread
                a, b, c = mix(fresh, np.uint64(0)), mix(fresh, np.uint64(1)), mix(fresh, np.uint64(2))
                turn_ball(q, i, t * (unit(a) - 0.5), t * (unit(b) - 0.5), t * (unit(c) - 0.5))
        elif sort != L.BALL_MORE:
            low, high = number(loops, 3, v), number(loops, 4, v)
            if spread >= 1.0:
                q[i] = low + (high - low) * unit(fresh)
            else:
                x = home[i] + spread * (high - low) * (unit(fresh) - 0.5)
                q[i] = min(max(x, number(loops, 1, v)), number(loops, 2, v))


@routine
def sound(loops, home):
    """Whether the start at q is finite; brings unknowns inside their limits, quaternions to norm 1, keeps `home`."""
    q, good = loops.q, True
    for v in range(loops.nv):
        sort, i = sort_of(loops, v), place_of(loops, v)
        if sort == L.BALL_FIRST:
            w, x, y, z = q[i], q[i + 1], q[i + 2], q[i + 3]
            size = math.sqrt(w * w + x * x + y * y + z * z)
            good = good and 0.0 < size < LARGEST
            q[i], q[i + 1], q[i + 2], q[i + 3] = w / size, x / size, y / size, z / size
        elif sort != L.BALL_MORE:
            good = good and abs(q[i]) < LARGEST
            if not is_held(loops, v):
                q[i] = min(max(q[i], number(loops, 1, v)), number(loops, 2, v))
    copy(home, q, 0, loops.nq)
    return good


@device
def lead_on(loops, done, i):
    """Write to the unknowns of q where rows i - 2 and i - 1 of `done` lead."""
    last, nq = (i - 1) * loops.nq, loops.nq
    for v in range(loops.nv):
        if is_held(loops, v):
            continue
        sort, k = sort_of(loops, v), place_of(loops, v)
        if sort == L.BALL_FIRST:
            copy(beyond(loops.q, k), done, last + k, 4)
        elif sort != L.BALL_MORE:
            before = done[last - nq + k] if i > 1 else done[last + k]
            loops.q[k] = 2.0 * done[last + k] - before


@kernel(types.int64(I1, F1, I1, F1, F2, F2, types.int64, types.int64, types.float64, types.int64, types.int64,
                    types.int64, types.boolean, OUT2, OUT1, OUTI2))  # fmt: skip
def assemble(
    ints, floats, plan, weights, starts, pins, tries, limit, tolerance, nearest, seed, offset, follow,
    out_q, out_residual, info
):  # fmt: skip
    """Number of starts that were not closed.

    ints, floats: the table; plan, weights: the loops (`loop_layout`). starts: (N, nq), with the held coordinates. pins:
    (N or 1, 12 pins) the poses (3x4) of pinned frames. tries: starts at most, the first at `starts`, the others drawn
    from (seed, offset + row), wider and wider about it. limit: steps of a start. tolerance: largest norm of the
    residual, in radians and characteristic lengths. nearest: steps at most towards the closed configuration nearest
    to the start. follow: each row after the first starts where the two before it lead, with its own held coordinates.
    out_q: (N, nq), the closed configuration, else the nearest to closing. out_residual: (N,). info: (N, 3)
    status, steps, starts.
    """
    nq, nv, n_rows, m = ints[NQ], ints[NV], ints[TABLE_ROWS], plan[L.N_ROWS]
    sweep = scratch_size(n_rows)
    block = np.empty(sweep + 4 * nq + 2 * nv + 3 * m + plan[L.BLOCKS] + plan[L.ENVELOPE] + 8)
    scratch = raw(block)
    q = beyond(scratch, sweep)
    home, kept, best_q = beyond(q, nq), beyond(q, 2 * nq), beyond(q, 3 * nq)
    step = beyond(q, 4 * nq)
    target = beyond(step, nv)
    error = beyond(target, nv)
    y = beyond(error, m)
    blocks = beyond(y, m)
    column = beyond(blocks, plan[L.BLOCKS])
    a = beyond(column, m)
    accepted, missed = tolerance * tolerance, 0
    for i in range(starts.shape[0]):
        pin = beyond(raw(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        loops = Loops(raw(ints), raw(floats), raw(plan), raw(weights), pin, q, scratch,
                      beyond(scratch, poses_at(n_rows)), error, blocks, n_rows, nq, nv)  # fmt: skip
        copy(q, beyond(raw(starts), i * nq), 0, nq)
        if follow and i > 0:
            lead_on(loops, raw(out_q), i)
        best, steps, count, status = np.inf, 0, 0, BAD_INPUT
        if sound(loops, home):
            status = NOT_CLOSED
            key = mix(mix(np.uint64(0), np.uint64(seed)), np.uint64(offset + i))
            while count < tries and not best <= accepted:
                if count > 0:
                    draw(loops, home, min(1.0, 0.15 * count), mix(key, np.uint64(count)))
                square, used = close(loops, limit, accepted, step, a, y, column, kept)
                steps += used
                count += 1
                if square < best:
                    best = square
                    copy(best_q, kept, 0, nq)
            copy(q, best_q, 0, nq)
            if best > accepted:
                best, used = close(loops, 10 * limit, accepted, step, a, y, column, best_q)
                steps += used
            elif nearest > 0:
                steps += approach(loops, nearest, home, step, a, y, column, target, best_q)
                copy(q, best_q, 0, nq)
                best, used = close(loops, limit, accepted, step, a, y, column, best_q)
            copy(q, best_q, 0, nq)
            if best < np.inf:
                evaluate(loops, False)
                read_off(loops, home)
                status = SOLVED if best <= accepted else NOT_CLOSED
            else:
                status = BAD_INPUT
        for k in range(nq):
            out_q[i, k] = q[k] if status != BAD_INPUT else np.nan
        out_residual[i] = math.sqrt(best) if status != BAD_INPUT else np.nan
        info[i, 0], info[i, 1], info[i, 2] = status, steps, count
        missed += int(status != SOLVED)
    keep(block)
    return missed
