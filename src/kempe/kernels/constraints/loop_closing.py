"""Assembly: a configuration that closes all loops, by damped least squares over the unknown
coordinates.

Step: -J^T (J J^T + mu I)^-1 phi, of minimum norm, so that redundant equations are no obstacle; mu
falls with the square of the residual, so that convergence is quadratic (Nakamura and Hanafusa,
1986; Sugihara, 2011). J J^T is kept within its envelope (Jennings, 1966): rows that share no
coordinates cost nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.declare import FLAG, FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.random import mix
from kempe.kernels.base.rotations import turn_ball
from kempe.kernels.base.scratch import beyond, copy
from kempe.kernels.base.search_layout import BAD_INPUT, LARGEST, LATE, NOT_FOUND, SOLVED, UNFINISHED
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import add_product, factor, normal, product, solve
from kempe.kernels.constraints.goals import fill, is_late
from kempe.kernels.constraints.loop_coordinates import (
    distance,
    draw,
    is_held,
    lead_on,
    number,
    place_of,
    read_off,
    sort_of,
    sound,
)
from kempe.kernels.constraints.loop_layout import DAMPING, LONGEST, MOST_DAMPING, WIDER
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import poses_at, row_poses, scratch_size

FLOOR = 1e-30
"""Square of the scaled residual below which rounding is all there is."""
LEAST = 1e-14
"""Floor of the damping, which holds up J J^T where the equations are redundant."""
MANY = 60
"""Equations from which on the clock is looked at before each step: then a step takes far longer
than that."""
LONGEST_SLIDE = 2.0
"""Longest step of a slide, in characteristic lengths."""


class ClosingScratch(NamedTuple):
    """Pointers to the scratch of a solver: steps, the way home, two columns of J J^T's size, the
    matrix, two q's.
    """

    step: object
    target: object
    y: object
    column: object
    a: object
    home: object
    kept: object


@routine
def evaluate(loops, with_blocks):
    """Square of the scaled residual at q."""
    row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    return fill(loops, with_blocks)


@routine
def mark(loops, step):
    """Mark NaN the steps of coordinates that stay: held ones, and those at a limit that the
    gradient pushes out.
    """
    for v in range(loops.nv):
        step[v] = 0.0
        if is_held(loops, v):
            step[v] = np.nan
            continue
        if sort_of(loops, v) >= L.BALL_FIRST:
            continue
        x = loops.q[place_of(loops, v)]
        low = number(loops, 1, v)
        high = number(loops, 2, v)
        if x <= low or x >= high:
            push = -product(loops, v, loops.error)
            if (x <= low and push <= 0.0) or (x >= high and push >= 0.0):
                step[v] = np.nan


@routine
def move(loops, step, y, target, with_target):
    """Size of the step -J^T y (+ target), as a part of the longest; takes it, cut to that and at
    the limits.
    """
    size = 0.0
    for v in range(loops.nv):
        if step[v] == step[v]:
            step[v] = -product(loops, v, y)
            if with_target:
                step[v] += target[v]
            size = max(
                size, abs(step[v]) / (LONGEST_SLIDE if sort_of(loops, v) == L.SLIDE else LONGEST)
            )
    part = 1.0 / max(size, 1.0)
    q = loops.q
    for v in range(loops.nv):
        if step[v] != step[v]:
            continue
        sort = sort_of(loops, v)
        i = place_of(loops, v)
        if sort == L.BALL_FIRST:
            turn_ball(q, i, part * step[v], part * step[v + 1], part * step[v + 2])
        elif sort != L.BALL_MORE:
            x = q[i] + part * step[v] * number(loops, 0, v)
            q[i] = min(max(x, number(loops, 1, v)), number(loops, 2, v))
    return size


@routine
def damped_step(loops, work, damping):
    """Size of the step -J^T (J J^T + damping I)^-1 phi, which is taken; for the equations written
    last.
    """
    mark(loops, work.step)
    normal(loops, work.step, damping, work.a, work.column)
    factor(loops, work.a, LEAST)
    copy(work.y, loops.error, 0, loops.plan[L.N_ROWS])
    solve(loops, work.a, work.y)
    return move(loops, work.step, work.y, work.step, False)


@routine
def close(loops, work, limit, accepted, kept, stop):
    """Least square of the residual reached from q, steps taken, and whether it was the last one
    evaluated.

    `kept` is where it was reached; where it was the last one, poses and equations are those of that
    configuration.
    """
    best = np.inf
    before = np.inf
    last = np.inf
    steps = 0
    m = loops.plan[L.N_ROWS]
    often = stop if m >= MANY else 0
    while True:
        square = evaluate(loops, True)
        if not square < LARGEST:
            break
        last = square
        if square < best:
            best = square
            copy(kept, loops.q, 0, loops.nq)
        if square <= FLOOR or (square <= accepted and square > 0.1 * before) or steps >= limit:
            break
        if often != 0 and is_late(loops, often, work.column, work.y):
            break
        before = square
        damping = min(DAMPING * square / m, MOST_DAMPING) + LEAST
        size = damped_step(loops, work, damping)
        steps += 1
        last = np.inf
        if size < 1e-15:
            break
    return best, steps, last == best


@routine
def descend(loops, work, limit, kept, stop):
    """Least square of the residual near q and steps taken, where it does not vanish; `kept` is
    where.

    Damped steps that are taken back where they lead up (Levenberg, 1944; Marquardt, 1963).
    """
    copy(kept, loops.q, 0, loops.nq)
    best = evaluate(loops, True)
    damping = 1.0
    steps = 0
    often = stop if loops.plan[L.N_ROWS] >= MANY else 0
    while steps < limit and damping < 1e12:
        if often != 0 and is_late(loops, often, work.column, work.y):
            break
        size = damped_step(loops, work, damping)
        steps += 1
        square = evaluate(loops, True)
        if square < best:
            best = square
            damping = max(0.3 * damping, LEAST)
            copy(kept, loops.q, 0, loops.nq)
        else:
            damping *= 4.0
            copy(loops.q, kept, 0, loops.nq)
            evaluate(loops, True)
        if size < 1e-12:
            break
    return best, steps


@routine
def approach(loops, work, limit, accepted, kept, stop):
    """Steps taken along the closed configurations towards the one nearest to `home`, from the
    closed one in `kept`.

    Each goes the way to `home` as far as the tangent space allows, shortened where that leads away,
    and is closed again (a projected gradient: Luenberger, 1972). `kept` is where it ends.
    """
    m = loops.plan[L.N_ROWS]
    steps = 0
    rounds = 0
    copy(loops.q, kept, 0, loops.nq)
    least = distance(loops, work.home, work.target)
    part = 1.0
    size = 1.0
    while rounds < limit and part > 0.05 and size > 1e-9:
        if is_late(loops, stop, work.column, work.y):
            break
        rounds += 1
        evaluate(loops, True)
        distance(loops, work.home, work.target)
        mark(loops, work.step)
        for i in range(m):
            work.y[i] = 0.0
        for v in range(loops.nv):
            work.target[v] *= part
            if work.step[v] == work.step[v]:
                add_product(loops, v, work.target[v], work.y, 1)
        normal(loops, work.step, LEAST, work.a, work.column)
        factor(loops, work.a, LEAST)
        solve(loops, work.a, work.y)
        size = move(loops, work.step, work.y, work.target, True)
        square, used, _ = close(loops, work, limit, accepted, loops.q, stop)
        steps += 1 + used
        far = distance(loops, work.home, work.target)
        if square <= accepted and far < least:
            least = far
            part = min(1.0, 2.0 * part)
            copy(kept, loops.q, 0, loops.nq)
        else:
            part *= 0.5
            copy(loops.q, kept, 0, loops.nq)
    return steps


@routine
def search(loops, work, key, first, tries, limit, accepted, nearest, best_q, stop):
    """Square of the residual, steps, starts of the assembly that begins at q, and whether the time
    was up.

    `best_q` is where it ends, and, of an assembly that goes on after `first` starts, where these
    have led.
    """
    best = np.inf
    steps = 0
    count = first
    current = False
    late = False
    if not sound(loops, work.home):
        return best, steps, count, late
    if first > 0 or tries == 0:
        copy(loops.q, best_q, 0, loops.nq)
        square = evaluate(loops, False)
        best = square if square < LARGEST else np.inf
    while count < tries and not best <= accepted:
        if count > 0:
            late = is_late(loops, stop, work.column, work.y)
            if late:
                break
            draw(loops, work.home, min(1.0, WIDER * count), mix(key, np.uint64(count)))
        square, used, last = close(loops, work, limit, accepted, work.kept, stop)
        steps += used
        count += 1
        current = last and square < best
        if square < best:
            best = square
            copy(best_q, work.kept, 0, loops.nq)
    if not best < np.inf:
        return best, steps, count, late
    copy(loops.q, best_q, 0, loops.nq)
    if best > accepted:
        current = False
        if nearest != UNFINISHED and not late:
            late = is_late(loops, stop, work.column, work.y)
            if not late:
                best, used = descend(loops, work, 10 * limit, best_q, stop)
                steps += used
    elif nearest > 0:
        steps += approach(loops, work, nearest, accepted, best_q, stop)
        current = False
    if not current:
        copy(loops.q, best_q, 0, loops.nq)
        best = evaluate(loops, False)
    read_off(loops, work.home)
    copy(best_q, loops.q, 0, loops.nq)
    return best, steps, count, late


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("N", "nq"),
    F("1|N", "_"),
    INT,
    INT,
    INT,
    FLOAT,
    INT,
    INT,
    INT,
    FLAG,
    INT,
    OUT("N", "nq"),
    OUT("N"),
    OUTI("N", 3),
)
def assemble(
    ints,
    floats,
    plan,
    weights,
    starts,
    pins,
    first,
    tries,
    limit,
    tolerance,
    nearest,
    seed,
    offset,
    follow,
    stop,
    out_q,
    out_residual,
    info,
):
    """Number of starts that were not closed.

    ints, floats: the table; plan, weights: the loops (`loop_layout`). starts: (N, nq), with the
    held coordinates. pins: (N or 1, 12 pins) the poses (3x4) of pinned frames. tries: starts at
    most, the first at `starts`, the others drawn from (seed, offset + row), wider and wider about
    it. first: how many of them were made before: `out_q` is then where these led. limit: steps of a
    start. tolerance: largest norm of the residual, in radians and characteristic lengths. nearest:
    steps at most towards the closed configuration nearest to the start; UNFINISHED: none, and what
    is open is not led nearer to closing, for further starts follow. follow: each row after the
    first starts where the two before it lead, with its own held coordinates. stop: address of a
    function that writes whether the work must end, or 0: it is read before each start but the
    first, and, of many equations, before each step; rows after that are not begun. out_q: (N, nq),
    the closed configuration, else the nearest to closing. out_residual: (N,). info: (N, 3) status
    (+ LATE where the work ended before all starts), steps, starts.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    m = plan[L.N_ROWS]
    sweep = scratch_size(n_rows)
    block = np.empty(sweep + 4 * nq + 2 * nv + 3 * m + plan[L.BLOCKS] + plan[L.ENVELOPE] + 8)
    scratch = raw(block)
    q = beyond(scratch, sweep)
    step = beyond(q, 4 * nq)
    error = beyond(step, 2 * nv)
    blocks = beyond(error, 3 * m)
    work = ClosingScratch(
        step,
        beyond(step, nv),
        beyond(error, m),
        beyond(error, 2 * m),
        beyond(blocks, plan[L.BLOCKS]),
        beyond(q, nq),
        beyond(q, 2 * nq),
    )
    best_q = beyond(q, 3 * nq)
    accepted = tolerance * tolerance
    missed = 0
    ended = False
    for i in range(starts.shape[0]):
        pin = beyond(raw(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        loops = LoopScratch(
            raw(ints),
            raw(floats),
            raw(plan),
            raw(weights),
            pin,
            q,
            scratch,
            beyond(scratch, poses_at(n_rows)),
            error,
            blocks,
            n_rows,
            nq,
            nv,
        )
        copy(q, beyond(raw(starts), i * nq), 0, nq)
        if follow and i > 0:
            lead_on(loops, raw(out_q), i)
        key = mix(mix(np.uint64(0), np.uint64(seed)), np.uint64(offset + i))
        copy(best_q, beyond(raw(out_q), i * nq) if first > 0 else q, 0, nq)
        best, steps, count, late = search(
            loops,
            work,
            key,
            first,
            first if ended else tries,
            limit,
            accepted,
            UNFINISHED if ended else nearest,
            best_q,
            stop,
        )
        ended = ended or late
        status = BAD_INPUT if not best < np.inf else (SOLVED if best <= accepted else NOT_FOUND)
        if ended and status == NOT_FOUND:
            status = NOT_FOUND + LATE
        for k in range(nq):
            out_q[i, k] = best_q[k] if status != BAD_INPUT else np.nan
        out_residual[i] = math.sqrt(best) if status != BAD_INPUT else np.nan
        info[i, 0] = status
        info[i, 1] = steps
        info[i, 2] = count
        missed += int(status != SOLVED)
    keep(block)
    return missed
