"""Tasks lowered one level at a time: closing what holds, the value of a level, and steps that lower
it.

Gauss-Newton in the null space of what holds, with a damping that is measured: the curvature along
the last step that the squares leave out (Marquardt, 1963; Dennis, Gay and Welsch, 1981), for an aim
the projected gradient (Luenberger, 1972).
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.random import mix, unit
from kempe.kernels.base.rotations import turn_ball
from kempe.kernels.base.scratch import copy
from kempe.kernels.base.search_layout import AHEAD, LARGEST, NOTHING
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.envelope import add_product
from kempe.kernels.constraints.goals import call, is_late
from kempe.kernels.constraints.loop_coordinates import distance, is_held, number, place_of, sort_of
from kempe.kernels.tasks.active_set import LEAST, LONGEST, OFF, free_all, mark_pushed, step_to, take
from kempe.kernels.tasks.level_rows import assess, count_in, is_hard, missed, square_of

DAMPING = 0.1
MOST_DAMPING = 0.1
"""Damping by the square of the residual, and its largest."""
STALL = 4
WORTH = 0.95
"""Steps without a decrease of the squared residual to this part of it, after which a start is given
up."""
PASSES = 2
"""Solves of one step: the second with what the first led out of its bounds."""
TIGHT = 1e-22
ROUNDING = 1e-25
"""Square of what a soft stage misses from which on it is met, and of what earlier ones may miss
after each step."""
CLOSING = 6
MORE = 3
LONG = 12
"""Steps that they may take for that: after a step, at the end, and after a push."""
"""What the last stage lowers: nothing; the distance to `goal`. Anything else is the address of a
function."""
STREAK = 3
"""Steps that must succeed after one that did not, before the steps of an aim grow again."""
FURTHEST = 3.0
"""How many times longer than the step a trial along it may be."""
FLAT = 1e-15
FLAT_AIM = 1e-13
FLAT_HARD = 1e-8
"""Decreases to this part of a value, twice in a row, end its lowering: of a soft stage, an aim, and
a hard stage, which is missed anyway."""
CLEAR = 1e-9
"""Decreases from this part of a value on say what curvature is; smaller ones are too near to
rounding."""
NUDGE = 0.05
PROBE = 4
SADDLE = 1e-7
"""A push, in radians and characteristic lengths, the steps after it, and the part of the value that
they must save."""
STRAIGHT = 0.01
LITTLE = 1e-6
"""How well a small step must keep what straight equations promise, as a part of it, and the least
promise."""
LONGER = 4.0
TRUST = 0.1
"""Where it does, the next may be so much longer and is damped by so much less."""


@routine
def foreseen(loops, work, part):
    """Squared residual of the rows that count after the fraction `part` of a step, as linear
    equations predict it.

    After the whole step a residual is D y.
    """
    square = 0.0
    for i in range(loops.plan[L.N_ROWS]):
        if work.damp[i] < OFF:
            x = (1.0 - part) * loops.error[i] + part * work.damp[i] * work.y[i]
            square += x * x
    return square


@device
def is_straight(square, before, after):
    """Whether a short step led from the squared residual `before` to `square`, near the predicted
    `after`.
    """
    first = math.sqrt(before)
    promised = math.sqrt(after)
    small = 0.5 * first < promised < (1.0 - LITTLE) * first
    return small and abs(math.sqrt(square) - promised) <= STRAIGHT * (first - promised)


@routine
def descend(loops, work, ask, last, enough, limit):
    """Least squared residual of stages 0 to last on the way from q, whether it is enough, and
    number of steps.

    Writes its configuration to `kept`. `enough` is a square, or 0 for the tolerances of the hard
    ties, which alone count then; once these are met, some more steps make the error as small as
    possible.
    """
    best = np.inf
    before = np.inf
    steps = 0
    idle = 0
    good = False
    hard_only = enough == 0.0
    longest = LONGEST
    trust = 1.0
    from_ = 0.0
    to = 0.0
    for v in range(loops.nv):
        work.wish[v] = 0.0
    while True:
        assess(loops, work)
        square = square_of(loops, ask, 0, last, hard_only)
        if not square < LARGEST:
            break
        met = missed(loops, ask, 0, last) <= 1.0 if hard_only else square <= enough
        if met and not good:
            good = True
            best = np.inf
            limit = min(limit, steps + MORE) if hard_only else steps
        if square < best and met == good:
            best = square
            copy(work.kept, loops.q, 0, loops.nq)
        elif good:
            break
        straight = is_straight(square, from_, to)
        longest, trust = (longest * LONGER, trust * TRUST) if straight else (LONGEST, 1.0)
        if square > WORTH * before and not straight:
            idle += 1
        else:
            idle = 0
            before = square
        if (good and square <= ROUNDING) or steps >= limit or idle >= STALL:
            break
        damping = trust * min(DAMPING * square, MOST_DAMPING) + 10.0 * LEAST
        count_in(loops, work, ask, last + 1, damping, OFF, hard_only)
        mark_pushed(loops, work)
        step_to(loops, work, PASSES, ask.between, False)
        _, part = take(loops, work, longest)
        from_ = square
        to = foreseen(loops, work, part)
        steps += 1
    return best, good, steps


@routine
def close(loops, work, ask, last, enough, limit):
    """Least squared residual of stages 0 to last found near q; moves q there and assesses it."""
    square, _, _ = descend(loops, work, ask, last, enough, limit)
    copy(loops.q, work.kept, 0, loops.nq)
    assess(loops, work)
    return square


@routine
def aim(loops, work, mode, part):
    """Value of what the last stage lowers, at q; writes a step (nv,) that lowers it, scaled by
    `part`, to `wish`.
    """
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
    """Slope of the squared residual of a stage, or of the aim, along the step, and its Gauss-Newton
    curvature.

    Both at the q that was assessed last.
    """
    slope = 0.0
    bend = 0.0
    plan = loops.plan
    m = loops.plan[L.N_ROWS]
    if mode != NOTHING:
        for v in range(loops.nv):
            slope -= work.wish[v] * work.step[v] / part
        return slope, bend
    for i in range(m):
        work.ahead[i] = 0.0
    for v in range(loops.nv):
        add_product(loops, v, work.step[v], work.ahead, 1)
    for k in range(plan[L.N_TIES]):
        if ask.stage[k] == stage:
            tie = plan[L.AT_TIES] + L.TIE_INTS * k
            for i in range(plan[tie + L.FIRST_ROW], plan[tie + L.FIRST_ROW] + plan[tie + L.ROWS]):
                if (
                    work.low[i] == work.high[i]
                    or work.value[i] < work.low[i]
                    or work.value[i] > work.high[i]
                ):
                    miss = work.value[i] - min(max(work.value[i], work.low[i]), work.high[i])
                    slope += 2.0 * ask.weight[k] * miss * work.ahead[i]
                    bend += ask.weight[k] * work.ahead[i] * work.ahead[i]
    return slope, bend


@routine
def value_of(loops, work, ask, stage, mode, part):
    """Weighted squared residual of a stage, or the value of the aim."""
    return (
        square_of(loops, ask, stage, stage, False)
        if mode == NOTHING
        else aim(loops, work, mode, part)
    )


@routine
def look_along(loops, work, ask, stage, bound, mode, part, best, slope, longest):
    """Least value found along the step taken, its curvature, and the factor of its length that a
    parabola suggests.

    Every trial is closed; one that is much too long or too short is made once more with the length
    of the parabola. `trial` is where the least is, `way` the first step. A trial counts where
    earlier stages are within the bound.
    """
    share = 1.0
    least = best
    curve = 0.0
    copy(work.way, work.step, 0, loops.nv)
    for trial in range(2):
        if trial == 1:
            copy(loops.q, work.best, 0, loops.nq)
            for v in range(loops.nv):
                work.step[v] = share * work.way[v]
            take(loops, work, FURTHEST * longest)
        _, held, _ = descend(loops, work, ask, stage - 1, bound[0], CLOSING)
        held = held and missed(loops, ask, 0, stage - 1) <= bound[1]
        found = value_of(loops, work, ask, stage, mode, part)
        if held and found < least:
            least = found
            copy(work.trial, loops.q, 0, loops.nq)
        if trial == 0 and held:
            curve = found - best - slope
            share = min(-0.5 * slope / curve, FURTHEST) if curve > 0.0 and slope < 0.0 else 1.0
        if 0.7 < share < 1.4:
            break
    return least, curve, share


@device
def damping_for(loops, work, damping, extra, better):
    """The next damping: `extra` curvature along `way`, which the squares leave out, bounded; larger
    after a failure.
    """
    size = 1e-300
    for v in range(loops.nv):
        size += work.way[v] * work.way[v]
    measured = extra / size
    if better:
        return max(min(max(measured, 0.1 * damping), 10.0 * damping), 1e-9)
    return max(8.0 * damping, min(measured, 100.0 * damping))


@routine
def bound_of(loops, work, ask, stage):
    """Bounds for the stages before this one, with q closed: their squared residual and largest part
    of a tolerance.
    """
    square = close(loops, work, ask, stage - 1, ROUNDING, CLOSING)
    return max(ROUNDING, 4.0 * square), max(1.0, missed(loops, ask, 0, stage - 1))


@routine
def ease(loops, work, ask, stage, bound, limit, mode, stop):
    """Number of steps that lower the residual of a stage (mode 0) or the aim, whether the time was
    up, and the value reached; moves q there and assesses it. Earlier stages stay within the bound.
    """
    copy(work.best, loops.q, 0, loops.nq)
    damping = 1e-3
    part = 1.0
    steps = 0
    idle = 0
    streak = 0
    late = False
    longest = LONGEST
    best = value_of(loops, work, ask, stage, mode, part)
    flat = FLAT_AIM
    if mode == NOTHING:
        flat = FLAT_HARD if is_hard(loops, ask, stage) else FLAT
    while steps < limit and best == best and not (mode == NOTHING and best <= TIGHT):
        late = is_late(loops, stop, work.ahead, work.wish)
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
        size, _ = take(loops, work, longest)
        slope, bend = slope_of(loops, work, ask, stage, mode, part)
        least, curve, share = look_along(
            loops, work, ask, stage, bound, mode, part, best, slope, longest
        )
        better = least < best
        fall = best - least
        longest = longest * LONGER if better and share >= FURTHEST else LONGEST
        if not better or fall > CLEAR * abs(best):
            damping = damping_for(loops, work, damping, curve - bend, better)
        if better:
            idle = idle + 1 if fall <= flat * abs(best) else 0
            best = least
            copy(work.best, work.trial, 0, loops.nq)
            if streak >= 0:  # a length that has just been found too large is kept for a while
                part = min(2.0 * part, 1.0 if mode == AHEAD else 1e3)
            streak += 1
        else:
            part = 0.3 * part
            streak = -STREAK
        lost = not better and mode == NOTHING and -slope <= flat * abs(best)
        if idle >= 2 or lost or size < 1e-10 or damping > 1e4 or part < 1e-9:
            break
        copy(loops.q, work.best, 0, loops.nq)
        assess(loops, work)
    copy(loops.q, work.best, 0, loops.nq)
    close(loops, work, ask, stage - 1, ROUNDING, MORE)
    return steps, late, value_of(loops, work, ask, stage, mode, part)


@routine
def nudge(loops, key):
    """Move all unknowns of q by a little, at random."""
    for v in range(loops.nv):
        if is_held(loops, v):
            continue
        sort = sort_of(loops, v)
        i = place_of(loops, v)
        x = NUDGE * (2.0 * unit(mix(key, np.uint64(v))) - 1.0)
        if sort == L.BALL_FIRST:
            turn_ball(loops.q, i, x, 0.7 * x, -0.4 * x)
        elif sort != L.BALL_MORE:
            x = loops.q[i] + x * number(loops, 0, v)
            loops.q[i] = min(max(x, number(loops, 1, v)), number(loops, 2, v))


@routine
def lower(loops, work, ask, stage, limit, mode, stop):
    """Number of steps, and whether the time was up; as `ease`, but leaves saddles and maxima.

    Where the gradient vanishes and the error does not, a small push and a few steps show whether q
    is one. The bound is that before the push: where the earlier stages cannot be closed as they
    were, there is no way down.
    """
    bound = bound_of(loops, work, ask, stage)
    steps, late, best = ease(loops, work, ask, stage, bound, limit, mode, stop)
    if mode == NOTHING and not late and best > TIGHT and steps < limit:
        copy(work.rest, loops.q, 0, loops.nq)
        nudge(loops, mix(np.uint64(0), np.uint64(stage)))
        used = 0
        least = np.inf
        if close(loops, work, ask, stage - 1, bound[0], LONG) <= bound[0]:
            used, late, least = ease(
                loops, work, ask, stage, bound, min(PROBE, limit - steps), mode, stop
            )
        steps += used
        if least < (1.0 - SADDLE) * best:
            used, late, best = ease(loops, work, ask, stage, bound, limit - steps, mode, stop)
            steps += used
        else:
            copy(loops.q, work.rest, 0, loops.nq)
            assess(loops, work)
    return steps, late
