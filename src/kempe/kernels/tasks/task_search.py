"""Several tasks at once: the search for a configuration that holds them, and lower tasks in what
the higher leave free.

Tasks are ties in stages. Stage 0 always holds (loops, relations); each further one is either hard,
to be met, or soft, a sum of weighted squares to be lowered. First damped least squares on all hard
rows, with restarts (Levenberg, 1944; Sugihara, 2011), then stage by stage steps that keep all
earlier ones (Siciliano and Slotine, 1991; Escande, Mansard and Wieber, 2014), each closed again: so
the earlier stages hold, to the tolerance and not only to first order.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.declare import FLAG, INT, OUT, OUTI, F, I
from kempe.kernels.base.random import mix
from kempe.kernels.base.scratch import beyond, copy
from kempe.kernels.base.search_layout import BAD_INPUT, LARGEST, LATE, NOT_FOUND, NOTHING, SOLVED
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.goals import is_late, number_of
from kempe.kernels.constraints.loop_coordinates import (
    nearest_turn,
    number,
    place_of,
    read_off,
    sort_of,
    sound,
)
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import poses_at, scratch_size
from kempe.kernels.tasks import restarts
from kempe.kernels.tasks.active_set import ActiveSetScratch
from kempe.kernels.tasks.level_rows import (
    Ask,
    assess,
    freeze,
    harden,
    hold_ahead,
    is_hard,
    missed,
    restore,
    rigid,
    square_of,
    unbind,
)
from kempe.kernels.tasks.lexicographic import ROUNDING, TIGHT, descend, lower
from kempe.kernels.tasks.restarts import begin, begin_at, to_middle

AGAIN = 5
LOWER = 0.99
"""Starts of a first stage that is soft, and the part of its square below which another than the
first one counts."""
GAIN = 1e-6
"""Part of what a soft stage misses that a hard one behind it must cost before it is let go."""


@routine
def search(loops, work, ask, last, key, tries, limit, stop):
    """Whether the hard stages up to `last` are met, whether the time was up, steps and starts; q is
    the nearest.
    """
    best = np.inf
    count = 0
    steps = 0
    good = False
    late = False
    left = 0
    least = np.inf
    to_middle(loops, work.home, work.trial)
    while count < tries and not good:
        late = is_late(loops, stop, work.ahead, work.wish)
        if late:
            break
        if left > 0:
            begin_at(loops, work, ask, last, key, count)
        else:
            begin(loops, work, ask, key, count)
        square, good, used = descend(loops, work, ask, last, 0.0, limit)
        steps = steps + used
        count = count + 1
        if square < best or good:
            best = square
            copy(work.best, work.kept, 0, loops.nq)
        if left == 0 or square < restarts.LOWER * least:
            left = restarts.AGAIN if count >= restarts.PLAIN and square < LARGEST else 0
            least = square
            copy(work.rest, work.kept, 0, loops.nq)
        else:
            left -= 1
    copy(loops.q, work.best if best < np.inf else work.home, 0, loops.nq)
    return good, late, steps, count


@routine
def search_down(loops, work, ask, key, tries, limit, stop):
    """The last of the stages whose hard ones are met together, whether the time was up, steps and
    starts; q meets them.

    First all hard tasks at once; where that fails, those of fewer and fewer stages. Soft stages
    before a hard one are first tried as if they were hard: where all of them can be met, nothing is
    lower.
    """
    last = ask.stages
    good = False
    late = False
    steps = 0
    most = 0
    while last > 1 and not is_hard(loops, ask, last):
        last -= 1
    while not (good or late) and last > 0:
        for softly in range(2):
            if not (good or late) and (softly == 1 or harden(loops, ask, last)):
                good, late, used, count = search(loops, work, ask, last, key, tries, limit, stop)
                steps = steps + used
                most = max(most, count)
            restore(loops, ask)
        if not good:
            last -= 1
            while last > 0 and not is_hard(loops, ask, last):
                last -= 1
    assess(loops, work)
    return last, late, steps, most


@routine
def lower_first(loops, work, ask, stage, limit, mode, stop):
    """As `lower`; hard stages behind a soft one are held as long as that costs it nothing, for half
    of the steps.
    """
    if mode != NOTHING or is_hard(loops, ask, stage) or not hold_ahead(loops, ask, stage):
        return lower(loops, work, ask, stage, limit, mode, stop)
    steps, late = lower(loops, work, ask, stage, limit // 2, mode, stop)
    restore(loops, ask)
    least = square_of(loops, ask, stage, stage, False)
    if least > TIGHT and not late:
        copy(work.aside, loops.q, 0, loops.nq)
        used, late = lower(loops, work, ask, stage, limit - steps, mode, stop)
        steps += used
        if not square_of(loops, ask, stage, stage, False) < (1.0 - GAIN) * least:
            copy(loops.q, work.aside, 0, loops.nq)
            assess(loops, work)
    return steps, late


@routine
def lower_again(loops, work, ask, key, tries, limit, stop):
    """Steps, whether the time was up, starts; lowers the first stage from other starts, too, and
    keeps the least.
    """
    least = square_of(loops, ask, 1, 1, False)
    steps = 0
    late = False
    count = 1
    part = 1.0 - GAIN if ask.loose else LOWER
    copy(work.aside, loops.q, 0, loops.nq)
    while count < min(tries, AGAIN) and not late and missed_softly(loops, ask):
        to_middle(loops, work.home, work.trial)
        begin(loops, work, ask, key, count)
        used, late = lower(loops, work, ask, 1, limit, NOTHING, stop)
        steps = steps + used
        count = count + 1
        square = square_of(loops, ask, 1, 1, False)
        if square < part * least and missed(loops, ask, 0, 0) <= 1.0:
            least = square
            copy(work.aside, loops.q, 0, loops.nq)
        copy(loops.q, work.aside, 0, loops.nq)
        assess(loops, work)
    return steps, late, count


@routine
def unwind(loops, work, ask, stage):
    """Turn angles that a stage holds back by whole turns towards their goals, where that costs no
    earlier stage.
    """
    plan = loops.plan
    q = loops.q
    for k in range(plan[L.N_TIES]):
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        v = plan[tie + L.DATA]
        if (
            ask.stage[k] != stage
            or plan[tie + L.TURNS] != L.OWN
            or sort_of(loops, v) != L.BOUND_TURN
        ):
            continue
        i = place_of(loops, v)
        x = q[i]
        y = nearest_turn(q[i], number_of(loops, k))
        if abs(x - y) < 1.0 or y < number(loops, 1, v) or y > number(loops, 2, v):
            continue
        own = square_of(loops, ask, stage, stage, False)
        before = square_of(loops, ask, 0, stage - 1, False)
        q[i] = y
        assess(loops, work)
        now = square_of(loops, ask, stage, stage, False)
        if now > own or square_of(loops, ask, 0, stage - 1, False) > before + TIGHT:
            q[i] = x
            assess(loops, work)


@routine
def lead_home(loops, work, ask):
    """Let angles that a turn brings back, and that a task holds, be brought back near to what it
    wants.
    """
    plan = loops.plan
    for k in range(plan[L.N_TIES]):
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        v = plan[tie + L.DATA]
        if ask.stage[k] > 0 and plan[tie + L.TURNS] == L.OWN and sort_of(loops, v) == L.CIRCLE:
            work.home[place_of(loops, v)] = number_of(loops, k)


@routine
def missed_softly(loops, ask):
    """Whether the first stage, which is soft, is missed by more than its tolerance."""
    for k in range(loops.plan[L.N_TIES]):
        ask.hard[k] = 1
    worst = missed(loops, ask, 1, 1)
    restore(loops, ask)
    return worst > 1.0


@routine
def reach(loops, work, ask, key, tries, limit, mode, stop):
    """(status, steps, starts) of a search for a configuration that fulfils tasks; `loops.q` is
    start and answer.

    If none is found, `loops.q` is the nearest one. `ask` holds the tasks in stages: stage 0 are the
    loops, later ones yield to earlier ones. `tries` is the number of random starts, drawn by `key`;
    below 0, only the last stage is improved and the others keep the residuals of the start. `limit`
    is the number of steps of a start, `mode` what is minimised in the freedoms left (or NOTHING),
    `stop` the clock. `work` is scratch memory.
    """
    first = ask.stages if tries < 0 else 1
    unbind(loops, work)
    restore(loops, ask)
    last, late, steps, most = search_down(loops, work, ask, key, tries, limit, stop)
    pinned = False
    for s in range(1, ask.stages + 1):
        pinned = pinned or is_hard(loops, ask, s)
    for s in range(1, ask.stages + (1 if mode == NOTHING else 2)):
        if late or not (s > last or not is_hard(loops, ask, s) or missed(loops, ask, s, s) > 1.0):
            continue
        if s >= first:
            copy(work.held, loops.q, 0, loops.nq)
            enough = 4.0 * square_of(loops, ask, 0, s - 1, False)
            worst = missed(loops, ask, 0, s - 1)
            if s <= ask.stages:
                unwind(loops, work, ask, s)
            used, late = lower_first(
                loops, work, ask, s, 4 * limit, mode if s > ask.stages else NOTHING, stop
            )
            steps += used
            if s == 1 and s <= ask.stages and not (pinned or late):
                used, late, count = lower_again(loops, work, ask, key, tries, 4 * limit, stop)
                steps = steps + used
                most = max(most, count)
            lost = not square_of(loops, ask, 0, s - 1, False) <= max(enough, ROUNDING)
            if lost or missed(loops, ask, 0, s - 1) > max(worst, 1.0):
                copy(loops.q, work.held, 0, loops.nq)
                assess(loops, work)
        freeze(loops, work, ask, s)
    unbind(loops, work)
    assess(loops, work)
    if mode == NOTHING:
        lead_home(loops, work, ask)
    read_off(loops, work.home)
    if loops.plan[L.N_READINGS] > 0:
        assess(loops, work)
    good = missed(loops, ask, 0, ask.stages) <= 1.0
    return (SOLVED if good else NOT_FOUND) + (LATE if late else 0), steps, most


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    I("_"),
    F("_", 3),
    F("1|N", "nq"),
    F("1|N", "nq"),
    F("1|N", "_"),
    INT,
    INT,
    INT,
    INT,
    FLAG,
    INT,
    OUT("N", "nq"),
    OUTI("N", 3),
)
def solve(
    ints,
    floats,
    plan,
    weights,
    stages,
    strengths,
    starts,
    goals,
    pins,
    tries,
    limit,
    mode,
    stop,
    loose,
    seed,
    out_q,
    info,
):
    """Number of problems whose hard tasks are not met.

    ints, floats: the table; plan, weights: the loops, and pins (N or 1, k), as `loop_layout` says.
    stages (2 ties): stage of each tie and 1 if it is hard. strengths (ties, 3): weight, tolerance
    of its lengths, in characteristic lengths, and of its other rows. starts (N or 1, nq); goals (N
    or 1, nq): where the last stage leads in mode 1. tries: starts at most, drawn from `seed`, for
    all rows alike; with 0 each stage is lowered in turn from `starts`, with -1 only the last one.
    limit: steps of a start. mode: NOTHING, AHEAD, or the address of a function to lower. stop:
    address of a function that writes whether the time is up, or 0: it is read before each start and
    each step of a lower stage. loose: whether a free base may be moved before the first start.
    out_q: (N, nq). info: (N, 3) status, steps, starts.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    m = plan[L.N_ROWS]
    ties = plan[L.N_TIES]
    sweep = scratch_size(n_rows)
    block = np.empty(
        sweep + 9 * nq + 5 * nv + 9 * m + 3 * ties + plan[L.BLOCKS] + plan[L.ENVELOPE] + 8
    )
    scratch = raw(block)
    q = beyond(scratch, sweep)
    v = beyond(q, 9 * nq)
    rows = beyond(v, 5 * nv)
    weight = beyond(rows, 9 * m)
    blocks = beyond(weight, 3 * ties)
    a = beyond(blocks, plan[L.BLOCKS])
    work = ActiveSetScratch(
        v,
        beyond(v, nv),
        beyond(v, 2 * nv),
        beyond(v, 3 * nv),
        beyond(v, 4 * nv),
        beyond(rows, m),
        beyond(rows, 2 * m),
        beyond(rows, 3 * m),
        beyond(rows, 4 * m),
        beyond(rows, 5 * m),
        beyond(rows, 6 * m),
        beyond(rows, 7 * m),
        beyond(rows, 8 * m),
        a,
        beyond(q, nq),
        beyond(q, 2 * nq),
        beyond(q, 3 * nq),
        beyond(q, 4 * nq),
        beyond(q, 5 * nq),
        beyond(q, 6 * nq),
        beyond(q, 7 * nq),
        beyond(q, 8 * nq),
    )
    last = 0
    between = False
    for k in range(ties):
        weight[k] = strengths[k, 0]
        weight[ties + 2 * k] = strengths[k, 1]
        weight[ties + 2 * k + 1] = strengths[k, 2]
        last = max(last, stages[k])
        between = between or (
            stages[k] >= 0 and plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND] >= 0
        )
    now = np.empty(2 * ties, dtype=np.int64)
    ask = Ask(
        raw(stages),
        raw(now),
        beyond(raw(now), ties),
        weight,
        beyond(weight, ties),
        last,
        between,
        loose,
    )
    missing = 0
    for i in range(out_q.shape[0]):
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
            rows,
            blocks,
            n_rows,
            nq,
            nv,
        )
        copy(q, beyond(raw(starts), i * nq if starts.shape[0] > 1 else 0), 0, nq)
        copy(work.goal, beyond(raw(goals), i * nq if goals.shape[0] > 1 else 0), 0, nq)
        status = BAD_INPUT
        steps = 0
        count = 0
        fine = sound(loops, work.home)
        for j in range(pins.shape[1]):
            fine = fine and abs(pin[j]) < LARGEST
        for j in range(plan[L.N_PINS]):
            fine = fine and rigid(pin, 12 * j)
        if fine:
            key = mix(np.uint64(0), np.uint64(seed))
            status, steps, count = reach(loops, work, ask, key, tries, limit, mode, stop)
        for k in range(nq):
            out_q[i, k] = q[k] if fine else math.nan
        info[i, 0] = status
        info[i, 1] = steps
        info[i, 2] = count
        missing += int(status % LATE != SOLVED)
    keep(block)
    keep(now)
    return missing
