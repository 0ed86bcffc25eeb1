"""Which start runs in which lane: the inverse kinematics of chains of turns and slides.

Damped least squares inside the limits, restarted until it succeeds. One start in two to one in one reaches the goal,
whatever the optimiser: restarts decide, so a step must be cheap and a start must be given up early. Each step takes the
damping 0.05 E + 1e-10 (Chan and Lawrence 1988; Sugihara 2011) and is always accepted. A start ends at the goal, after
`iteration_limit` steps, or after three steps that hardly lower the error.

The starts of a goal are tried in order, its seed first, and the answer is that of the first one that reaches the goal.
So it depends on nothing but the goal: not on the lanes, nor on the goals beside it. A lane works for one goal and
runs its starts one after the other; when no goal is left, it runs starts ahead for others, which count only if all
before them fail. So many goals keep all lanes busy, and a single one has as many starts at a time as there are lanes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.scratch import aligned, beyond, copy
from kempe.kernels.base.search_layout import ANGULAR, LINEAR, NOT_FOUND, SOLVED, STARTS, STATUS, STEPS
from kempe.kernels.base.vectors import LANES, keep, raw
from kempe.kernels.forward.table_layout import (
    COS_GAUGE,
    HEADER,
    KIND,
    MULTIPLIER,
    NQ,
    NV,
    ROW_FLOATS,
    ROW_INTS,
    SIN_GAUGE,
    SLIDE,
    V_INDEX,
)
from kempe.kernels.one_frame.descent import ENOUGH
from kempe.kernels.one_frame.ik_problem import (
    ARGUMENTS,
    Job,
    aim,
    answer_of,
    begin,
    count_columns,
    go_to,
    job_floats,
    job_ints,
    job_of,
    judged,
    write,
)
from kempe.kernels.one_frame.lanes import (
    BEST,
    COORDINATE_LANES,
    COUNT,
    FACTOR,
    FOUND,
    GAUGE,
    GOAL,
    KEPT,
    PLACE,
    POINTING,
    ROW_LANES,
    ROWS,
    SOME,
    STALL,
    WHOLE,
    Lanes,
    U,
    lane_coordinate,
)
from kempe.kernels.one_frame.lanes_step import step_lanes
from kempe.kernels.one_frame.residual import BOX_STRIDE, HIGH, LOW, POINTS, SCALE, WEIGHTS
from kempe.kernels.one_frame.step import place_of

AHEAD = 16
"""Starts at most that are begun and not settled, for a goal."""

HOLD = 5
"""Steps that a seed has to itself: from a good one, more are not needed, and to begin starts takes time."""

ROUNDED = 1e-24
"""Energy that more steps would hardly lower."""

TARGET, FIRST, NEXT, ANSWER, SPENT, BEST_START, DONE, DESK = 0, 1, 2, 3, 4, 5, 6, 6 + AHEAD
"""A desk: its goal (-1: none), first start not settled, next to begin, the one that reached the goal (`tries`: none),
steps of those settled, the start that came nearest; steps of start k at DONE + k % AHEAD, -1 while it runs."""

AT_DESK, START, LANE = 0, 1, 2
"""A lane: the desk it works for (-1: none) and its start."""

NONE = -1


class Hall(NamedTuple):
    """One desk for each lane. All but numbers are pointers."""

    job: Job
    lanes: Lanes
    desks: object
    places: object
    """The lanes."""
    homes: object
    least: object
    """Least energy of the starts that failed, for each desk."""
    count: int
    """How many goals there are."""


@device
def hall_floats(rows, nq, nv):
    """Numbers of scratch of a hall."""
    lanes = ROWS + ROW_LANES * rows + COORDINATE_LANES * nv
    return LANES * lanes + 8 + ROW_FLOATS * (rows + 1) + 2 * nv + 6 + LANES * nq + LANES


@device
def hall_ints(rows):
    """Whole numbers of scratch of a hall."""
    return LANES * (DESK + LANE) + rows


@routine
def hall(job, notes, block, count):
    """The hall for a job, its chain in the units of the lanes; all desks are free."""
    chain = job.chain
    rows, nq, nv, ints = chain.columns, chain.nq, chain.nv, chain.ints
    lanes = aligned(block)
    floats = beyond(lanes, LANES * (ROWS + ROW_LANES * rows + COORDINATE_LANES * nv))
    limits = beyond(floats, ROW_FLOATS * (rows + 1))
    weights = beyond(limits, 2 * nv)
    homes = beyond(weights, 6)
    places = beyond(notes, LANES * DESK)
    last = beyond(places, LANES * LANE)
    for row in range(rows + 1):
        at = ROW_FLOATS * row
        for k in range(12):
            floats[at + k] = chain.floats[at + k] / (chain.length if k % 4 == 3 else 1.0)
        if row == rows:
            break
        v, slides = ints[HEADER + ROW_INTS * row + V_INDEX], ints[HEADER + ROW_INTS * row + KIND] == SLIDE
        unit = chain.box[BOX_STRIDE * v + SCALE] / (chain.length if slides else 1.0)
        floats[at + FACTOR] = chain.floats[at + MULTIPLIER] * unit
        floats[at + GAUGE] = math.atan2(chain.floats[at + SIN_GAUGE], chain.floats[at + COS_GAUGE])
        last[row] = 1
        for other in range(row):
            if ints[HEADER + ROW_INTS * other + V_INDEX] == v:
                last[other], last[row] = last[other] & 2, 3
    for v in range(nv):
        k = BOX_STRIDE * v
        limits[2 * v] = chain.box[k + LOW] / chain.box[k + SCALE]
        limits[2 * v + 1] = chain.box[k + HIGH] / chain.box[k + SCALE]
    turns = 0
    for i in range(6):
        weights[i] = 1.0 if chain.goal[WEIGHTS + i] != 0.0 else 0.0
        turns += int(weights[i]) if i > 2 else 0
    whole = weights[0] + weights[1] + weights[2] + turns == 6.0
    task = PLACE if turns == 0 else POINTING if chain.goal[POINTS] != 0.0 else WHOLE if whole else SOME
    for d in range(LANES):
        notes[DESK * d + TARGET], places[LANE * d + AT_DESK] = NONE, NONE
    for k in range(LANES * (ROWS + ROW_LANES * rows + COORDINATE_LANES * nv)):
        lanes[k] = 0.0
    s = Lanes(ints, floats, limits, last, weights, lanes, rows, nv, task)
    return Hall(job, s, notes, places, homes, beyond(homes, LANES * nq), count)


@device
def home_of(h, d):
    """Where the search of a desk is at home."""
    return beyond(h.homes, h.job.chain.nq * d)


@routine
def put(h, lane, d):
    """Nothing; the lane begins the next start of the desk."""
    job, s = h.job, h.lanes
    desk, chain, p = beyond(h.desks, DESK * d), job.chain, beyond(s.lanes, lane)
    i, start = desk[TARGET], desk[NEXT]
    desk[NEXT] = start + 1
    desk[DONE + start % AHEAD] = NONE
    h.places[LANE * lane + AT_DESK], h.places[LANE * lane + START] = d, start
    go_to(job, i, start, home_of(h, d))
    for v in range(s.nv):
        k, u = place_of(chain, v), 0.0
        if k >= 0:
            u = chain.q[k] / chain.box[BOX_STRIDE * v + SCALE]
            if job.circular[v] != 0:
                u -= 2.0 * math.pi * math.floor(u / (2.0 * math.pi) + 0.5)
        p[(lane_coordinate(s, v) + U) * LANES] = u
    target = beyond(job.targets, 16 * i)
    for k in range(3):  # what the task does not read need not be a number
        p[(GOAL + 4 * k + 3) * LANES] = target[4 * k + 3] / chain.length if s.weights[k] != 0.0 else 0.0
        for j in range(3):
            p[(GOAL + 4 * k + j) * LANES] = target[4 * k + j] if s.task != PLACE else 0.0
    p[BEST * LANES], p[STALL * LANES], p[COUNT * LANES], p[FOUND * LANES] = np.inf, 0.0, 0.0, 0.0


@device
def begun_of(h, d):
    """How many starts of a desk are begun and not settled; AHEAD where no other may begin."""
    desk = beyond(h.desks, DESK * d)
    if desk[TARGET] < 0 or desk[NEXT] >= desk[ANSWER]:
        return AHEAD
    return desk[NEXT] - desk[FIRST]


@device
def least_begun(h):
    """(starts begun and not settled, desk) where they are fewest; AHEAD if none may begin another."""
    least, at = AHEAD, 0
    for d in range(LANES):
        begun = begun_of(h, d)
        if begun < least:
            least, at = begun, d
    return least, at


@routine
def employ(h, lane, queue, may_help):
    """New number of goals taken; the lane gets a start of a goal without a lane, else a new goal, else it helps."""
    begun, d = least_begun(h)
    if begun > 0 and queue < h.count:
        free = 0
        while h.desks[DESK * free + TARGET] >= 0:  # there is one: each desk that is taken has a lane at work
            free += 1
        desk = beyond(h.desks, DESK * free)
        while desk[TARGET] < 0 and queue < h.count:
            if begin(h.job, queue, home_of(h, free)):
                desk[TARGET], desk[FIRST], desk[NEXT], desk[ANSWER] = queue, 0, 0, h.job.tries
                desk[SPENT], desk[BEST_START] = 0, NONE
                h.least[free] = np.inf
                copy(answer_of(h.job, queue), home_of(h, free), 0, h.job.chain.nq)
                begun, d = 0, free
            queue += 1
    if begun == 0 or (begun < AHEAD and may_help):
        put(h, lane, d)
    return queue


@device
def settle(h, d):
    """Nothing; counts the starts of a desk that are done, in order; closes it if one is the answer or all failed."""
    desk, job = beyond(h.desks, DESK * d), h.job
    i, end = desk[TARGET], desk[ANSWER]
    while desk[FIRST] < min(end + 1, job.tries) and desk[FIRST] < desk[NEXT]:
        steps = desk[DONE + desk[FIRST] % AHEAD]
        if steps < 0:
            return
        desk[SPENT] += steps
        desk[FIRST] += 1
    if end < job.tries:
        if desk[FIRST] > end:
            out = beyond(answer_of(job, i), job.chain.nq)
            out[STATUS], out[STEPS], out[STARTS] = SOLVED, desk[SPENT], end + 1
            desk[TARGET] = NONE
    elif desk[FIRST] == job.tries:
        write(job, i, NOT_FOUND, h.least[d], 0.0, desk[SPENT], job.tries)
        desk[TARGET] = NONE


@device
def fetch(h, lane, d, what):
    """Nothing; q of the chain is `what` a lane holds: U, or KEPT."""
    chain, s = h.job.chain, h.lanes
    copy(chain.q, home_of(h, d), 0, chain.nq)
    for v in range(s.nv):
        k = place_of(chain, v)
        if k >= 0:
            box = beyond(chain.box, BOX_STRIDE * v)
            x = s.lanes[(lane_coordinate(s, v) + what) * LANES + lane] * box[SCALE]
            chain.q[k] = min(max(x, box[LOW]), box[HIGH])  # units round


@routine
def accepted(h, lane, d, what, enough):
    """Whether what a lane holds is an answer, of energy below `enough`; writes it and lets all later starts go."""
    job, chain, desk = h.job, h.job.chain, beyond(h.desks, DESK * d)
    start = h.places[LANE * lane + START]
    fetch(h, lane, d, what)
    aim(chain, job.targets, 16 * desk[TARGET])
    solved, linear, angular = judged(job, home_of(h, d))
    if not solved or 0.5 * ((linear / chain.length) ** 2 + angular**2) > enough:
        return False
    out = answer_of(job, desk[TARGET])
    copy(out, chain.q, 0, chain.nq)
    out[chain.nq + LINEAR], out[chain.nq + ANGULAR] = linear, angular
    desk[ANSWER] = start
    for other in range(LANES):
        if h.places[LANE * other + AT_DESK] == d and h.places[LANE * other + START] > start:
            h.places[LANE * other + AT_DESK] = NONE
    return True


@routine
def finish(h, lane):
    """Nothing; a start is done: it is the answer, the nearest so far, or nothing. Or it goes on, if that pays."""
    d, start = h.places[LANE * lane + AT_DESK], h.places[LANE * lane + START]
    desk, p, out = beyond(h.desks, DESK * d), beyond(h.lanes.lanes, lane), answer_of(h.job, h.desks[DESK * d + TARGET])
    energy, found = p[BEST * LANES], p[FOUND * LANES]
    spent = p[COUNT * LANES] >= h.job.iteration_limit
    if found == 1.0 and p[STALL * LANES] == 0.0 and energy >= ENOUGH and not spent:  # one step from rounding error
        p[COUNT * LANES] += 1.0
        p[FOUND * LANES] = 2.0
        if not accepted(h, lane, d, np.int64(U), ROUNDED):
            return
    elif found == 0.0 or not accepted(h, lane, d, np.int64(KEPT), np.inf):
        nearer = energy < h.least[d] or (energy == h.least[d] and start < desk[BEST_START])
        if nearer and desk[ANSWER] == h.job.tries:
            fetch(h, lane, d, np.int64(KEPT))
            h.least[d], desk[BEST_START] = energy, start
            copy(out, h.job.chain.q, 0, h.job.chain.nq)
    h.places[LANE * lane + AT_DESK] = NONE
    desk[DONE + start % AHEAD] = int(p[COUNT * LANES])
    settle(h, d)


@device
def at_work(h):
    """Lanes that run a start, as bits."""
    lanes = 0
    for lane in range(LANES):
        lanes |= int(h.places[LANE * lane + AT_DESK] >= 0) << lane
    return lanes


@device
def search(h):
    """Nothing; all goals are answered, as far as starts do it."""
    job, queue, busy, alone, changed = h.job, np.int64(0), 0, 0, True
    linear, angular = (job.tol_linear / job.chain.length) ** 2, job.tol_angular**2
    hold = HOLD if job.seed_count > job.first else 0
    while True:
        if changed or alone == hold:
            for lane in range(LANES):
                if not busy >> lane & 1:
                    before = queue
                    queue = employ(h, lane, queue, alone >= hold)
                    alone = alone if queue == before else 0
            busy, changed = at_work(h), False
            if busy == 0:
                return
        done = step_lanes(h.lanes, job.iteration_limit, linear, angular) & busy
        alone += 1
        if done != 0:
            for lane in range(LANES):
                if done >> lane & 1 and h.places[LANE * lane + AT_DESK] >= 0:  # those before may have let it go
                    finish(h, lane)
            busy, changed = at_work(h), True


@kernel(*ARGUMENTS)
def reach(
    ints, floats, limits, task, targets, seeds, seed, first, start_limit, iteration_limit, tol_linear, tol_angular,
    length, out,
):  # fmt: skip
    """Number of goals not reached; each answer is a pure function of its goal, its seeds and the other arguments.

    ints, floats: table of a chain with one output, without balls. limits: (2, nv), lower and upper, infinite where
    there is none; ignored for balls. task: (7 + nv,), 1 for each row [linear; angular] (ground axes) that counts; 1 if
    of the orientation only the direction of the tip's z axis counts; 1 for each coordinate of a single turning row with
    multiplier +-1 whose range is at least a turn. targets: (N, 4, 4). seeds: (1 or N, K, nq), the first K starts.
    seed: what random numbers are drawn from. first: number of the first start, those before have been tried.
    start_limit: starts at most, seeds included. iteration_limit: steps of a start. tol_linear, tol_angular: largest
    norm of the error's linear and angular part. length: what weighs as much as a radian, 0 for a part of the chain's.
    out: (N, nq + 5): q, linear and angular error, status, steps, starts.

    Starts are tried in order, the answer is that of the first that reaches the goal. SOLVED is judged at the q
    written, which is always inside the limits. With NOT_FOUND it is where a start came nearest, and the linear error is
    its energy: `fallback.approach` goes on from there. BAD_INPUT, q and errors NaN: a goal or seed that is not finite
    or above 1e100, a goal that is no pose.
    """
    columns, nq, nv = count_columns(raw(ints)), ints[NQ], ints[NV]
    whole, size = job_ints(columns, nv), job_floats(columns, nq, nv)
    notes, block = np.empty(whole + hall_ints(columns), np.int64), np.empty(size + hall_floats(columns, nq, nv))
    job = job_of(
        ints, floats, limits, task, targets, seeds, seed, first, start_limit, iteration_limit, tol_linear, tol_angular,
        length, out, columns, raw(notes), raw(block),
    )  # fmt: skip
    search(hall(job, beyond(raw(notes), whole), beyond(raw(block), size), targets.shape[0]))
    missed = 0
    for i in range(targets.shape[0]):
        missed += int(out[i, nq + STATUS] != SOLVED)
    keep(block)
    keep(notes)
    return missed
