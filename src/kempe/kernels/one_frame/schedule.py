"""The schedule of the inverse kinematics of chains of turns and slides: which start runs in which
lane.

Damped least squares inside the limits, restarted until it succeeds. From 50 to 100 % of the starts
reach the goal, whatever the optimiser: restarts decide, so a step must be cheap and a start must be
given up early. Each step takes the damping 0.05 E + 1e-10 (Chan and Lawrence 1988; Sugihara 2011)
and is always accepted. A start ends at the goal, after `iteration_limit` steps, or after three
steps that hardly lower the error.

The starts of a goal are tried in order, its seed first, and the answer is that of the first one
that reaches the goal. So it depends on nothing but the goal: not on the lanes, nor on the goals
beside it. A lane works for one goal and runs its starts one after the other; when no goal is left,
it runs starts ahead for others, which count only if all before them fail. So many goals keep all
lanes busy, and a single one has as many starts at a time as there are lanes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.scratch import advance_pointer, align_pointer, copy_numbers
from kempe.kernels.base.search_layout import (
    ANGULAR,
    LINEAR,
    NOT_FOUND,
    SOLVED,
    STARTS,
    STATUS,
    STEPS,
)
from kempe.kernels.base.vectors import LANES, get_pointer, keep_alive
from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    HEADER,
    KIND,
    MULTIPLIER,
    NQ,
    NV,
    ROW_FLOATS,
    ROW_INTS,
    SIN_OFFSET,
    SLIDE,
    V_INDEX,
)
from kempe.kernels.one_frame.descent import ENOUGH
from kempe.kernels.one_frame.ik_problem import (
    ARGUMENTS,
    IkProblem,
    begin_goal,
    count_columns,
    count_problem_floats,
    count_problem_ints,
    go_to_start,
    judge_configuration,
    locate_answer,
    make_ik_problem,
    set_goal,
    write_answer,
)
from kempe.kernels.one_frame.lanes import (
    BEST,
    COORDINATE_LANES,
    COUNT,
    FACTOR,
    FOUND,
    GOAL,
    KEPT,
    OFFSET,
    PLACE,
    POINTING,
    ROW_LANES,
    ROWS,
    SOME,
    STALL,
    WHOLE,
    Lanes,
    U,
    locate_lane_coordinate,
)
from kempe.kernels.one_frame.lanes_step import step_lanes
from kempe.kernels.one_frame.residual import BOX_STRIDE, HIGH, LOW, POINTS, SCALE, WEIGHTS
from kempe.kernels.one_frame.step import find_place

AHEAD = 16
"""Starts at most that are begun and not committed, for a goal."""

HOLD = 5
"""Steps that a seed has to itself: from a good one, more are not needed, and to begin starts takes
time."""

ROUNDED = 1e-24
"""Energy that more steps would hardly lower."""

TARGET = 0
FIRST = 1
NEXT = 2
ANSWER = 3
SPENT = 4
BEST_START = 5
DONE = 6
SLOT = 6 + AHEAD
"""Places in the record of a slot: its goal (-1 where the slot is free), the first start that is not
committed, the next start to begin, the start that reached the goal (`tries` where none did), the
sum of the steps of committed starts, the start that came nearest. The steps of start k stand at
DONE + k % AHEAD, -1 while it runs."""

OF_SLOT = 0
START = 1
LANE = 2
"""Places in the record of a lane: the slot whose start it runs (-1 where it is idle), and that
start."""

NONE = -1


class Scheduler(NamedTuple):
    """Goals in work: a slot holds one goal, and there are as many slots as lanes. All fields but
    the numbers are pointers.
    """

    problem: IkProblem
    lanes: Lanes
    slots: object
    places: object
    """The records of the lanes."""
    defaults: object
    """The configuration that the search of each slot starts from by default."""
    least: object
    """Least energy of the starts that failed, for each slot."""
    count: int
    """How many goals there are."""


@device
def count_scheduler_floats(rows, nq, nv):
    """Return the number of floats of scratch of the scheduler."""
    lanes = ROWS + ROW_LANES * rows + COORDINATE_LANES * nv
    return LANES * lanes + 8 + ROW_FLOATS * (rows + 1) + 2 * nv + 6 + LANES * nq + LANES


@device
def count_scheduler_ints(rows):
    """Return the number of integers of scratch of the scheduler."""
    return LANES * (SLOT + LANE) + rows


@routine
def make_scheduler(problem, notes, block, count):
    """Make the scheduler of a problem, its chain in the units of the lanes, with all slots free."""
    chain = problem.chain
    rows = chain.columns
    nq = chain.nq
    nv = chain.nv
    ints = chain.ints
    lanes = align_pointer(block)
    floats = advance_pointer(lanes, LANES * (ROWS + ROW_LANES * rows + COORDINATE_LANES * nv))
    limits = advance_pointer(floats, ROW_FLOATS * (rows + 1))
    weights = advance_pointer(limits, 2 * nv)
    defaults = advance_pointer(weights, 6)
    places = advance_pointer(notes, LANES * SLOT)
    last = advance_pointer(places, LANES * LANE)
    for row in range(rows + 1):
        at = ROW_FLOATS * row
        for k in range(12):
            floats[at + k] = chain.floats[at + k] / (chain.length if k % 4 == 3 else 1.0)
        if row == rows:
            break
        v = ints[HEADER + ROW_INTS * row + V_INDEX]
        slides = ints[HEADER + ROW_INTS * row + KIND] == SLIDE
        unit = chain.box[BOX_STRIDE * v + SCALE] / (chain.length if slides else 1.0)
        floats[at + FACTOR] = chain.floats[at + MULTIPLIER] * unit
        floats[at + OFFSET] = math.atan2(
            chain.floats[at + SIN_OFFSET], chain.floats[at + COS_OFFSET]
        )
        last[row] = 1
        for other in range(row):
            if ints[HEADER + ROW_INTS * other + V_INDEX] == v:
                last[other] = last[other] & 2
                last[row] = 3
    for v in range(nv):
        k = BOX_STRIDE * v
        limits[2 * v] = chain.box[k + LOW] / chain.box[k + SCALE]
        limits[2 * v + 1] = chain.box[k + HIGH] / chain.box[k + SCALE]
    turns = 0
    for i in range(6):
        weights[i] = 1.0 if chain.goal[WEIGHTS + i] != 0.0 else 0.0
        turns += int(weights[i]) if i > 2 else 0
    whole = weights[0] + weights[1] + weights[2] + turns == 6.0
    task = (
        PLACE if turns == 0 else POINTING if chain.goal[POINTS] != 0.0 else WHOLE if whole else SOME
    )
    for d in range(LANES):
        notes[SLOT * d + TARGET] = NONE
        places[LANE * d + OF_SLOT] = NONE
    for k in range(LANES * (ROWS + ROW_LANES * rows + COORDINATE_LANES * nv)):
        lanes[k] = 0.0
    s = Lanes(ints, floats, limits, last, weights, lanes, rows, nv, task)
    return Scheduler(
        problem, s, notes, places, defaults, advance_pointer(defaults, LANES * nq), count
    )


@device
def locate_default_start(h, d):
    """Return the pointer to the configuration that the search of a slot starts from by default."""
    return advance_pointer(h.defaults, h.problem.chain.nq * d)


@routine
def begin_next_start(h, lane, d):
    """Begin the next start of the slot in the lane."""
    problem = h.problem
    s = h.lanes
    slot = advance_pointer(h.slots, SLOT * d)
    chain = problem.chain
    p = advance_pointer(s.lanes, lane)
    i = slot[TARGET]
    start = slot[NEXT]
    slot[NEXT] = start + 1
    slot[DONE + start % AHEAD] = NONE
    h.places[LANE * lane + OF_SLOT] = d
    h.places[LANE * lane + START] = start
    go_to_start(problem, i, start, locate_default_start(h, d))
    for v in range(s.nv):
        k = find_place(chain, v)
        u = 0.0
        if k >= 0:
            u = chain.q[k] / chain.box[BOX_STRIDE * v + SCALE]
            if problem.circular[v] != 0:
                u -= 2.0 * math.pi * math.floor(u / (2.0 * math.pi) + 0.5)
        p[(locate_lane_coordinate(s, v) + U) * LANES] = u
    target = advance_pointer(problem.targets, 16 * i)
    for k in range(3):  # what the task does not read need not be a number
        p[(GOAL + 4 * k + 3) * LANES] = (
            target[4 * k + 3] / chain.length if s.weights[k] != 0.0 else 0.0
        )
        for j in range(3):
            p[(GOAL + 4 * k + j) * LANES] = target[4 * k + j] if s.task != PLACE else 0.0
    p[BEST * LANES] = np.inf
    p[STALL * LANES] = 0.0
    p[COUNT * LANES] = 0.0
    p[FOUND * LANES] = 0.0


@device
def count_begun_starts(h, d):
    """Count the starts of a slot that are begun and not committed; AHEAD where no other start may
    begin.
    """
    slot = advance_pointer(h.slots, SLOT * d)
    if slot[TARGET] < 0 or slot[NEXT] >= slot[ANSWER]:
        return AHEAD
    return slot[NEXT] - slot[FIRST]


@device
def find_least_begun_slot(h):
    """Find the slot with the fewest starts begun and not committed; return their number, or AHEAD,
    and the slot.
    """
    least = AHEAD
    at = 0
    for d in range(LANES):
        begun = count_begun_starts(h, d)
        if begun < least:
            least = begun
            at = d
    return least, at


@routine
def assign_start(h, lane, queue, may_help):
    """Give an idle lane a start, and return how many goals are taken from the queue by now.

    A slot without a running start comes first, then a new goal; with `may_help` a start ahead for a
    slot that has one.
    """
    begun, d = find_least_begun_slot(h)
    if begun > 0 and queue < h.count:
        free = 0
        while (
            h.slots[SLOT * free + TARGET] >= 0
        ):  # there is one: each slot that is taken has a lane at work
            free += 1
        slot = advance_pointer(h.slots, SLOT * free)
        while slot[TARGET] < 0 and queue < h.count:
            if begin_goal(h.problem, queue, locate_default_start(h, free)):
                slot[TARGET] = queue
                slot[FIRST] = 0
                slot[NEXT] = 0
                slot[ANSWER] = h.problem.tries
                slot[SPENT] = 0
                slot[BEST_START] = NONE
                h.least[free] = np.inf
                copy_numbers(
                    locate_answer(h.problem, queue),
                    locate_default_start(h, free),
                    0,
                    h.problem.chain.nq,
                )
                begun = 0
                d = free
            queue += 1
    if begun == 0 or (begun < AHEAD and may_help):
        begin_next_start(h, lane, d)
    return queue


@device
def commit_starts(h, d):
    """Count the starts of a slot that are done, in order; write the answer where one reached the
    goal or all failed.
    """
    slot = advance_pointer(h.slots, SLOT * d)
    problem = h.problem
    i = slot[TARGET]
    end = slot[ANSWER]
    while slot[FIRST] < min(end + 1, problem.tries) and slot[FIRST] < slot[NEXT]:
        steps = slot[DONE + slot[FIRST] % AHEAD]
        if steps < 0:
            return
        slot[SPENT] += steps
        slot[FIRST] += 1
    if end < problem.tries:
        if slot[FIRST] > end:
            out = advance_pointer(locate_answer(problem, i), problem.chain.nq)
            out[STATUS], out[STEPS], out[STARTS] = SOLVED, slot[SPENT], end + 1
            slot[TARGET] = NONE
    elif slot[FIRST] == problem.tries:
        write_answer(problem, i, NOT_FOUND, h.least[d], 0.0, slot[SPENT], problem.tries)
        slot[TARGET] = NONE


@device
def load_configuration(h, lane, d, what):
    """Set q of the chain to a configuration that a lane holds: `what` is U or KEPT."""
    chain = h.problem.chain
    s = h.lanes
    copy_numbers(chain.q, locate_default_start(h, d), 0, chain.nq)
    for v in range(s.nv):
        k = find_place(chain, v)
        if k >= 0:
            box = advance_pointer(chain.box, BOX_STRIDE * v)
            x = s.lanes[(locate_lane_coordinate(s, v) + what) * LANES + lane] * box[SCALE]
            chain.q[k] = min(max(x, box[LOW]), box[HIGH])  # units round


@routine
def accept_answer(h, lane, d, what, enough):
    """Accept a configuration of a lane as the answer if its energy is below `enough`, and drop all
    later starts; return whether it is one.
    """
    problem = h.problem
    chain = h.problem.chain
    slot = advance_pointer(h.slots, SLOT * d)
    start = h.places[LANE * lane + START]
    load_configuration(h, lane, d, what)
    set_goal(chain, problem.targets, 16 * slot[TARGET])
    solved, linear, angular = judge_configuration(problem, locate_default_start(h, d))
    if not solved or 0.5 * ((linear / chain.length) ** 2 + angular**2) > enough:
        return False
    out = locate_answer(problem, slot[TARGET])
    copy_numbers(out, chain.q, 0, chain.nq)
    out[chain.nq + LINEAR] = linear
    out[chain.nq + ANGULAR] = angular
    slot[ANSWER] = start
    for other in range(LANES):
        if h.places[LANE * other + OF_SLOT] == d and h.places[LANE * other + START] > start:
            h.places[LANE * other + OF_SLOT] = NONE
    return True


@routine
def retire_start(h, lane):
    """End the start of a lane, keep its result if it is the best so far, and continue it if one
    step more pays.
    """
    d = h.places[LANE * lane + OF_SLOT]
    start = h.places[LANE * lane + START]
    slot = advance_pointer(h.slots, SLOT * d)
    p = advance_pointer(h.lanes.lanes, lane)
    out = locate_answer(h.problem, slot[TARGET])
    energy = p[BEST * LANES]
    found = p[FOUND * LANES]
    spent = p[COUNT * LANES] >= h.problem.iteration_limit
    if (
        found == 1.0 and p[STALL * LANES] == 0.0 and energy >= ENOUGH and not spent
    ):  # one step from rounding error
        p[COUNT * LANES] += 1.0
        p[FOUND * LANES] = 2.0
        if not accept_answer(h, lane, d, np.int64(U), ROUNDED):
            return
    elif found == 0.0 or not accept_answer(h, lane, d, np.int64(KEPT), np.inf):
        nearer = energy < h.least[d] or (energy == h.least[d] and start < slot[BEST_START])
        if nearer and slot[ANSWER] == h.problem.tries:
            load_configuration(h, lane, d, np.int64(KEPT))
            h.least[d], slot[BEST_START] = energy, start
            copy_numbers(out, h.problem.chain.q, 0, h.problem.chain.nq)
    h.places[LANE * lane + OF_SLOT] = NONE
    slot[DONE + start % AHEAD] = int(p[COUNT * LANES])
    commit_starts(h, d)


@device
def find_busy_lanes(h):
    """Return the lanes that run a start, as bits."""
    lanes = 0
    for lane in range(LANES):
        lanes |= int(h.places[LANE * lane + OF_SLOT] >= 0) << lane
    return lanes


@device
def run_lanes(h):
    """Run the lanes until each goal is reached or has failed from all its starts."""
    problem = h.problem
    queue = np.int64(0)
    busy = 0
    alone = 0
    changed = True
    linear = (problem.tol_linear / problem.chain.length) ** 2
    angular = problem.tol_angular**2
    hold = HOLD if problem.seed_count > problem.first else 0
    while True:
        if changed or alone == hold:
            for lane in range(LANES):
                if not busy >> lane & 1:
                    before = queue
                    queue = assign_start(h, lane, queue, alone >= hold)
                    alone = alone if queue == before else 0
            busy = find_busy_lanes(h)
            changed = False
            if busy == 0:
                return
        done = step_lanes(h.lanes, problem.iteration_limit, linear, angular) & busy
        alone += 1
        if done != 0:
            for lane in range(LANES):
                if (
                    done >> lane & 1 and h.places[LANE * lane + OF_SLOT] >= 0
                ):  # those before may have let it go
                    retire_start(h, lane)
            busy = find_busy_lanes(h)
            changed = True


@kernel(*ARGUMENTS)
def reach_goals(
    ints,
    floats,
    limits,
    task,
    targets,
    seeds,
    seed,
    first,
    start_limit,
    iteration_limit,
    tol_linear,
    tol_angular,
    length,
    out,
):
    """Search a configuration for each goal; return the number of goals not reached. An answer
    depends only on its goal, its seeds and the other arguments.

    ints, floats: table of a chain with one output, without balls. limits: (2, nv), lower and upper,
    infinite where there is none; ignored for balls. task: (7 + nv,), 1 for each row [linear;
    angular] (ground axes) that counts; 1 if of the orientation only the direction of the tip's z
    axis counts; 1 for each coordinate of a single turning row with multiplier +-1 whose range is at
    least a turn. targets: (N, 4, 4). seeds: (1 or N, K, nq), the first K starts. seed: what random
    numbers are drawn from. first: number of the first start, those before have been tried.
    start_limit: starts at most, seeds included. iteration_limit: steps of a start. tol_linear,
    tol_angular: largest norm of the error's linear and angular part. length: what weighs as much as
    a radian, 0 for a part of the chain's. out: (N, nq + 5): q, linear and angular error, status,
    steps, starts.

    Starts are tried in order, the answer is that of the first that reaches the goal. SOLVED is
    judged at the q written, which is always inside the limits. With NOT_FOUND it is where a start
    came nearest, and the linear error is its energy: `fallback.approach_goals` goes on from there.
    BAD_INPUT, q and errors NaN: a goal or seed that is not finite or above 1e100, a goal that is no
    pose.
    """
    columns = count_columns(get_pointer(ints))
    nq = ints[NQ]
    nv = ints[NV]
    whole = count_problem_ints(columns, nv)
    size = count_problem_floats(columns, nq, nv)
    notes = np.empty(whole + count_scheduler_ints(columns), np.int64)
    block = np.empty(size + count_scheduler_floats(columns, nq, nv))
    problem = make_ik_problem(
        ints,
        floats,
        limits,
        task,
        targets,
        seeds,
        seed,
        first,
        start_limit,
        iteration_limit,
        tol_linear,
        tol_angular,
        length,
        out,
        columns,
        get_pointer(notes),
        get_pointer(block),
    )
    run_lanes(
        make_scheduler(
            problem,
            advance_pointer(get_pointer(notes), whole),
            advance_pointer(get_pointer(block), size),
            targets.shape[0],
        )
    )
    missed = 0
    for i in range(targets.shape[0]):
        missed += int(out[i, nq + STATUS] != SOLVED)
    keep_alive(block)
    keep_alive(notes)
    return missed
