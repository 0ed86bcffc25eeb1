"""Several tasks at once: the search for a configuration that holds them, and lower tasks in what the higher leave free.

Tasks are ties in stages. Stage 0 always holds (loops, relations); each further one is either hard, to be met, or soft,
a sum of weighted squares to be lowered. First damped least squares on all hard rows, with restarts (Levenberg, 1944;
Sugihara, 2011), then stage by stage steps that keep all earlier ones (Siciliano and Slotine, 1991; Escande, Mansard and
Wieber, 2014), each closed again, so that the earlier ones hold and do not merely hardly suffer.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels import loop_layout as L
from kempe.kernels._jit import F1, F2, I1, OUT2, OUTI2, kernel, routine
from kempe.kernels.active import LEAST, OFF, Work, free_all, mark_pushed, step_to, take
from kempe.kernels.asked import (
    Ask,
    assess,
    count_in,
    freeze,
    is_hard,
    missed,
    rigid,
    square_of,
    unbind,
)
from kempe.kernels.envelope import add_product
from kempe.kernels.goals import call
from kempe.kernels.layout import (
    HEADER,
    MULTIPLIER,
    NQ,
    NV,
    OUTPUT_FLOATS,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    V_INDEX,
)
from kempe.kernels.layout import N_ROWS as TABLE_ROWS
from kempe.kernels.loop_coordinates import (
    LARGEST,
    distance,
    draw,
    is_held,
    number,
    place_of,
    read_off,
    sort_of,
    sound,
)
from kempe.kernels.random import mix
from kempe.kernels.residual import logarithm
from kempe.kernels.rows import placement, poses_at, row_poses, scratch_size
from kempe.kernels.scratch import beyond
from kempe.kernels.starts import copy
from kempe.kernels.step import turn_ball
from kempe.kernels.ties import Loops, back, ends_of, matrix, relative
from kempe.kernels.vectors import entry, keep, raw

SOLVED, NOT_FOUND, BAD_INPUT = 0, 1, 2
"""Status of one problem."""
LATE = 4
"""Added to the status where the time was up before all was done."""
DAMPING, MOST_DAMPING = 0.1, 0.1
"""Damping by the square of the residual, and its largest."""
STALL, WORTH = 4, 0.95
"""Steps without a decrease of the squared residual to this part of it, after which a start is given up."""
PASSES = 2
"""Solves of one step: the second with what the first led out of its bounds."""
NEAR, WHOLE = 0.6, 8
"""Part of the ranges, about the first start and about their middles in turn, from which starts are drawn; and every how
many starts one is drawn from all of them. What is far from all limits leads to more answers."""
STREAK = 3
"""Steps that must succeed after one that did not, before the damping falls again."""
TIGHT, ROUNDING = 1e-22, 1e-25
"""Square of the residual to which earlier stages are closed again at each step, and at the end what holds."""
CLOSING, MORE = 6, 3
"""Steps that they may take for that."""
NOTHING, AHEAD = 0, 1
"""What the last stage lowers: nothing; the distance to `goal`. Anything else is the address of a function."""


@routine
def descend(loops, work, ask, last, enough, limit):
    """Least square of what stages 0 to last miss, from q on, whether it is enough, and steps; `kept` is where.

    Enough is a square, or 0 for the tolerances of the hard ties, which then alone count; once these are met, some steps
    more make the error as small as it gets.
    """
    best, before, steps, idle, good = np.inf, np.inf, 0, 0, False
    hard_only = enough == 0.0
    for v in range(loops.nv):
        work.wish[v] = 0.0
    while True:
        assess(loops, work)
        square = square_of(loops, ask, 0, last, hard_only)
        if not square < LARGEST:
            break
        met = missed(loops, ask, 0, last) <= 1.0 if hard_only else square <= enough
        if met and not good:
            good, best, limit = True, np.inf, min(limit, steps + MORE) if hard_only else steps
        if square < best and met == good:
            best = square
            copy(work.kept, loops.q, 0, loops.nq)
        elif good:
            break
        if square > WORTH * before:
            idle += 1
        else:
            idle, before = 0, square
        if (good and square <= ROUNDING) or steps >= limit or idle >= STALL:
            break
        damping = min(DAMPING * square, MOST_DAMPING) + 10.0 * LEAST
        count_in(loops, work, ask, last + 1, damping, OFF, hard_only)
        mark_pushed(loops, work)
        step_to(loops, work, PASSES, ask.between, False)
        take(loops, work)
        steps += 1
    return best, good, steps


@routine
def close(loops, work, ask, last, enough, limit):
    """Least square of what stages 0 to last miss near q, where q ends, assessed."""
    square, _, _ = descend(loops, work, ask, last, enough, limit)
    copy(loops.q, work.kept, 0, loops.nq)
    assess(loops, work)
    return square


@routine
def is_late(loops, work, stop):
    """Whether the time is up, as the function at the address `stop` says; 0 is none."""
    work.ahead[0] = 0.0
    if stop != 0:
        call(stop, loops.q, work.ahead, work.wish, 0)
    return work.ahead[0] != 0.0


@routine
def aim(loops, work, mode, part):
    """What the last stage lowers, at q; writes the wished step down there, `part` of the way."""
    if mode == AHEAD:
        far = distance(loops, work.goal, work.wish)
        for v in range(loops.nv):
            work.wish[v] *= part
        return 0.5 * far
    call(mode, loops.q, work.ahead, work.wish, 1)
    for v in range(loops.nv):
        work.wish[v] *= -part
    return work.ahead[0]


@routine
def slope_of(loops, work, ask, stage, mode, part):
    """Rate of what a stage misses, or of the aim, along the step, at the q that was assessed last."""
    slope, plan, m = 0.0, loops.plan, loops.plan[L.N_ROWS]
    if mode != NOTHING:
        for v in range(loops.nv):
            slope -= work.wish[v] * work.step[v] / part
        return slope
    for i in range(m):
        work.ahead[i] = 0.0
    for v in range(loops.nv):
        add_product(loops, v, work.step[v], work.ahead)
    for k in range(plan[L.N_TIES]):
        if ask.stage[k] == stage:
            tie = plan[L.AT_TIES] + L.TIE_INTS * k
            for i in range(plan[tie + L.FIRST_ROW], plan[tie + L.FIRST_ROW] + plan[tie + L.ROWS]):
                if work.low[i] == work.high[i] or work.value[i] < work.low[i] or work.value[i] > work.high[i]:
                    miss = work.value[i] - min(max(work.value[i], work.low[i]), work.high[i])
                    slope += 2.0 * ask.weight[k] * miss * work.ahead[i]
    return slope


@routine
def lower(loops, work, ask, stage, limit, mode, stop):
    """Steps taken from q that lower what a stage misses (mode 0) or the aim, all earlier stages held, and whether the
    time was up; ends in q.

    Gauss-Newton in the null space with a damping that follows the success (Marquardt, 1963), for an aim the projected
    gradient (Luenberger, 1972). A step that is much too long or too short is tried once more with the length that a
    parabola through its ends suggests.
    """
    enough = max(TIGHT, 4.0 * close(loops, work, ask, stage - 1, TIGHT, CLOSING))
    copy(work.best, loops.q, 0, loops.nq)
    damping, part, steps, idle, streak, late = 1e-3, 1.0, 0, 0, 0, False
    best = square_of(loops, ask, stage, stage, False) if mode == NOTHING else aim(loops, work, mode, part)
    while steps < limit and best == best and not (mode == NOTHING and best <= TIGHT):
        late = is_late(loops, work, stop)
        if late:
            break
        steps += 1
        for v in range(loops.nv):
            work.wish[v] = 0.0
        count_in(loops, work, ask, stage, LEAST, damping if mode == NOTHING else OFF, False)
        if mode != NOTHING:
            aim(loops, work, mode, part)
        free_all(loops, work)
        step_to(loops, work, 4 + loops.nv, ask.between, True)
        size, share, least = take(loops, work), 1.0, best
        slope = slope_of(loops, work, ask, stage, mode, part)
        copy(work.way, work.step, 0, loops.nv)
        for trial in range(2):
            if trial == 1:
                copy(loops.q, work.best, 0, loops.nq)
                for v in range(loops.nv):
                    work.step[v] = share * work.way[v]
                take(loops, work)
            _, held, _ = descend(loops, work, ask, stage - 1, enough, CLOSING)
            found = square_of(loops, ask, stage, stage, False) if mode == NOTHING else aim(loops, work, mode, part)
            if held and found < least:
                least = found
                copy(work.trial, loops.q, 0, loops.nq)
            curve = found - best - slope
            share = min(-0.5 * slope / curve, 3.0) if held and curve > 0.0 and slope < 0.0 else 1.0
            if 0.7 < share < 1.4:
                break
        if least < best:
            idle = idle + 1 if best - least <= 1e-13 * abs(best) else 0
            best = least
            copy(work.best, work.trial, 0, loops.nq)
            if streak >= 0:  # a damping that has just been found too small is kept for a while
                damping, part = max(0.1 * damping, 1e-9), min(2.0 * part, 1.0 if mode == AHEAD else 1e3)
            streak += 1
        else:
            damping, part, streak = 8.0 * damping, 0.3 * part, -STREAK
        if idle >= 2 or size < 1e-10 or damping > 1e4 or part < 1e-9:
            break
        copy(loops.q, work.best, 0, loops.nq)
        assess(loops, work)
    copy(loops.q, work.best, 0, loops.nq)
    close(loops, work, ask, stage - 1, ROUNDING, MORE)
    return steps, late


@routine
def settle_base(loops, ask):
    """Move a free base so that the frame that a task holds is where the task wants it, as the other joints are."""
    plan, q = loops.plan, loops.q
    k, row = plan[L.BASE_TIE], plan[L.BASE_ROW]
    if k < 0 or ask.stage[k] < 1:
        return
    row_poses(loops.ints, loops.floats, q, 0, loops.scratch)
    r_a, p_a, r_b, p_b = ends_of(loops, k)
    a, b, c = placement(loops.poses, OUTPUT_FLOATS * (row + 3))
    p = (p_b[0] - entry(a, 3), p_b[1] - entry(b, 3), p_b[2] - entry(c, 3))
    if plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.TURNS] == L.FULL:
        r = matrix(a, b, c)
        # the base becomes R_A R_B^T R: in its own axes it turns by (R_A^T R)^T (R_B^T R)
        w = logarithm(relative(relative(r_a, r), relative(r_b, r)))
        turn_ball(q, loops.ints[HEADER + ROW_INTS * (row + 3) + Q_INDEX], w[0], w[1], w[2])
        x = back(r_b, p[0], p[1], p[2])
        p = (r_a[0] * x[0] + r_a[1] * x[1] + r_a[2] * x[2], r_a[3] * x[0] + r_a[4] * x[1] + r_a[5] * x[2],
             r_a[6] * x[0] + r_a[7] * x[1] + r_a[8] * x[2])  # fmt: skip
    d = (p_a[0] - p[0] - entry(a, 3), p_a[1] - p[1] - entry(b, 3), p_a[2] - p[2] - entry(c, 3))
    for i in range(row, row + 3):
        a, b, c = placement(loops.poses, OUTPUT_FLOATS * i)
        at, v = loops.ints[HEADER + ROW_INTS * i + Q_INDEX], loops.ints[HEADER + ROW_INTS * i + V_INDEX]
        x = q[at] + (entry(a, 2) * d[0] + entry(b, 2) * d[1] + entry(c, 2) * d[2]) / loops.floats[
            ROW_FLOATS * i + MULTIPLIER]  # fmt: skip
        q[at] = min(max(x, number(loops, 1, v)), number(loops, 2, v))


@routine
def to_middle(loops, home, to):
    """Write a configuration in the middle of all ranges to `to`; balls and what is no unknown as at `home`."""
    copy(to, home, 0, loops.nq)
    for v in range(loops.nv):
        if sort_of(loops, v) < L.BALL_FIRST and not is_held(loops, v):
            to[place_of(loops, v)] = 0.5 * (number(loops, 3, v) + number(loops, 4, v))


@routine
def reach(loops, work, ask, key, tries, limit, mode, stop):
    """Status, steps and starts; q is the answer, or the nearest found.

    First all hard tasks at once; where that fails, those of fewer and fewer stages.
    """
    unbind(loops, work)
    to_middle(loops, work.home, work.trial)
    last, good, late, steps, most = ask.stages, False, False, 0, 0
    while not (good or late) and last > 0:
        copy(loops.q, work.home, 0, loops.nq)
        best, count = np.inf, 0
        while count < tries and not good:
            late = is_late(loops, work, stop)
            if late:
                break
            if count > 0:
                about = work.trial if count % 2 else work.home
                draw(loops, about, NEAR if count % WHOLE else 1.0, mix(key, np.uint64(count)))
            if count > 0 or ask.loose:
                settle_base(loops, ask)
            square, good, used = descend(loops, work, ask, last, 0.0, limit)
            steps, count = steps + used, count + 1
            if square < best or good:
                best = square
                copy(work.best, work.kept, 0, loops.nq)
        most = max(most, count)
        copy(loops.q, work.best if best < np.inf else work.home, 0, loops.nq)
        if not good:
            last -= 1
            while last > 0 and not is_hard(loops, ask, last):
                last -= 1
    for s in range(1, ask.stages + (1 if mode == NOTHING else 2)):
        if not late and (s > last or not is_hard(loops, ask, s)):
            used, late = lower(loops, work, ask, s, 4 * limit, mode if s > ask.stages else NOTHING, stop)
            steps += used
            freeze(loops, work, ask, s)
    unbind(loops, work)
    assess(loops, work)
    read_off(loops, work.home)
    if loops.plan[L.N_READINGS] > 0:
        assess(loops, work)
    good = missed(loops, ask, 0, ask.stages) <= 1.0
    return (SOLVED if good else NOT_FOUND) + (LATE if late else 0), steps, most


@kernel(types.int64(I1, F1, I1, F1, I1, F2, F2, F2, F2, types.int64, types.int64, types.int64, types.int64,
                    types.boolean, types.int64, types.int64, OUT2, OUTI2))  # fmt: skip
def solve(
    ints, floats, plan, weights, stages, strengths, starts, goals, pins, tries, limit, mode, stop, loose,
    seed, offset, out_q, info
):  # fmt: skip
    """Number of problems whose hard tasks are not met.

    ints, floats: the table; plan, weights: the loops, and pins (N or 1, k), as `loop_layout` says. stages (2 ties):
    stage of each tie and 1 if it is hard. strengths (ties, 3): weight, tolerance of its lengths, in characteristic
    lengths, and of its other rows. starts (N or 1, nq); goals (N or 1, nq): where the last stage leads in mode 1.
    tries: starts at most, drawn from (seed, offset + row). limit: steps of a start. mode: NOTHING, AHEAD, or the
    address of a function to lower. stop: address of a function that writes whether the time is up, or 0: it is asked
    before each start and each step of a lower stage. loose: whether a free base may be moved before the first start.
    out_q: (N, nq). info: (N, 3) status, steps, starts.
    """
    nq, nv, n_rows, m, ties = ints[NQ], ints[NV], ints[TABLE_ROWS], plan[L.N_ROWS], plan[L.N_TIES]
    sweep = scratch_size(n_rows)
    block = np.empty(sweep + 6 * nq + 5 * nv + 9 * m + 3 * ties + plan[L.BLOCKS] + plan[L.ENVELOPE] + 8)
    scratch = raw(block)
    q = beyond(scratch, sweep)
    v = beyond(q, 6 * nq)
    rows = beyond(v, 5 * nv)
    weight = beyond(rows, 9 * m)
    blocks = beyond(weight, 3 * ties)
    a = beyond(blocks, plan[L.BLOCKS])
    work = Work(v, beyond(v, nv), beyond(v, 2 * nv), beyond(v, 3 * nv), beyond(v, 4 * nv), beyond(rows, m),
                beyond(rows, 2 * m), beyond(rows, 3 * m), beyond(rows, 4 * m), beyond(rows, 5 * m),
                beyond(rows, 6 * m), beyond(rows, 7 * m), beyond(rows, 8 * m), a, beyond(q, nq), beyond(q, 2 * nq),
                beyond(q, 3 * nq), beyond(q, 4 * nq), beyond(q, 5 * nq))  # fmt: skip
    last, between = 0, False
    for k in range(ties):
        weight[k], weight[ties + 2 * k], weight[ties + 2 * k + 1] = strengths[k, 0], strengths[k, 1], strengths[k, 2]
        last = max(last, stages[k])
        between = between or (stages[k] >= 0 and plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND] >= 0)
    ask = Ask(raw(stages), beyond(raw(stages), ties), weight, beyond(weight, ties), last, between, loose)
    missing = 0
    for i in range(out_q.shape[0]):
        pin = beyond(raw(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        loops = Loops(raw(ints), raw(floats), raw(plan), raw(weights), pin, q, scratch,
                      beyond(scratch, poses_at(n_rows)), rows, blocks, n_rows, nq, nv)  # fmt: skip
        copy(q, beyond(raw(starts), i * nq if starts.shape[0] > 1 else 0), 0, nq)
        copy(work.goal, beyond(raw(goals), i * nq if goals.shape[0] > 1 else 0), 0, nq)
        status, steps, count, fine = BAD_INPUT, 0, 0, sound(loops, work.home)
        for j in range(pins.shape[1]):
            fine = fine and abs(pin[j]) < LARGEST
        for j in range(plan[L.N_PINS]):
            fine = fine and rigid(pin, 12 * j)
        if fine:
            key = mix(mix(np.uint64(0), np.uint64(seed)), np.uint64(offset + i))
            status, steps, count = reach(loops, work, ask, key, tries, limit, mode, stop)
        for k in range(nq):
            out_q[i, k] = q[k] if fine else math.nan
        info[i, 0], info[i, 1], info[i, 2] = status, steps, count
        missing += int(status % LATE != SOLVED)
    keep(block)
    return missing
