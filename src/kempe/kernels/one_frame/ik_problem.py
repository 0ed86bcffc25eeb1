"""The problem of one call of the inverse kinematics: its goals one by one, and how answers are
judged and written.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, F, I
from kempe.kernels.base.random import mix_bits, to_unit_interval
from kempe.kernels.base.rotations import draw_quaternion
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.search_layout import (
    ANGULAR,
    ANSWER,
    BAD_INPUT,
    LARGEST,
    LINEAR,
    ROTATION_TOLERANCE,
    STARTS,
    STATUS,
    STEPS,
)
from kempe.kernels.base.vectors import get_pointer
from kempe.kernels.forward.table_layout import (
    BALL,
    HEADER,
    KIND,
    MULTIPLIER,
    N_ROWS,
    NQ,
    NV,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    SLIDE,
    V_INDEX,
)
from kempe.kernels.one_frame.residual import (
    AXES_STRIDE,
    BOX_STRIDE,
    COLUMN_INTS,
    FACTOR,
    GOAL_SIZE,
    HIGH,
    JACOBIAN_STRIDE,
    LOW,
    OWNER,
    PLACE,
    PLACE_INTS,
    POINTS,
    ROUND,
    SCALE,
    TURNS,
    WEIGHTS,
    ChainScratch,
    compute_distances,
    compute_error,
    trace_chain,
)
from kempe.kernels.one_frame.step import find_place, is_ball_coordinate

# ---- starts

# Where the inverse kinematics starts, and how its answer is brought back into the limits.


NUDGE = 0.02
"""Size of the region about the middle of the limits, as a part of their range, in which the first
start lies.

The exact middle is often singular (a stretched arm), where no step leads out."""


LATE = 64
WIDER = 2.0
"""Every other start from this one on is drawn from so much of the range that half of the
coordinates are at a limit."""


@device
def compute_spread(count):
    """Return the part of the limits' range from which start `count` after the seeds is drawn; late
    starts crowd at the limits.
    """
    if count >= LATE and count % 2 == 1:
        return WIDER
    return NUDGE if count == 0 else min(0.75 + 0.05 * count, 1.35)


@routine
def draw_configuration(chain, home, key, spread):
    """Write a random configuration to q: uniform in `spread` times the limits' range, cut off at
    them.

    Where a limit is missing, the range is a turn, or twice the chain's length, about `home`.
    """
    q = chain.q
    box = chain.box
    copy_numbers(q, home, 0, chain.nq)
    v = 0
    while v < chain.nv:
        i = find_place(chain, v)
        low = box[BOX_STRIDE * v + LOW]
        high = box[BOX_STRIDE * v + HIGH]
        fresh = mix_bits(key, np.uint64(v))
        if is_ball_coordinate(chain, v):
            if spread > NUDGE:
                draw_quaternion(q, i, fresh)
            v += 3
            continue
        if i >= 0:
            part = spread
            if low < -LARGEST or high > LARGEST:
                half = math.pi if box[BOX_STRIDE * v + SCALE] == 1.0 else chain.length
                low = max(low, home[i] - half)
                high = min(high, low + 2.0 * half)
                low = max(box[BOX_STRIDE * v + LOW], high - 2.0 * half)
                part = min(spread, 1.0)
            x = 0.5 * (low + high) + part * (to_unit_interval(fresh) - 0.5) * (high - low)
            q[i] = min(max(x, low), high)
        v += 1


@routine
def read_seed(chain, seeds, k):
    """Write the configuration seeds[k:] to q, inside the solver's limits; return whether it is
    valid.
    """
    q = chain.q
    box = chain.box
    sound = True
    copy_numbers(q, seeds, k, chain.nq)
    v = 0
    while v < chain.nv:
        i = find_place(chain, v)
        if is_ball_coordinate(chain, v):
            w = q[i]
            x = q[i + 1]
            y = q[i + 2]
            z = q[i + 3]
            size = math.sqrt(w * w + x * x + y * y + z * z)
            sound = sound and 0.0 < size < LARGEST
            q[i], q[i + 1], q[i + 2], q[i + 3] = w / size, x / size, y / size, z / size
            v += 3
            continue
        if i >= 0:
            sound = sound and abs(q[i]) < LARGEST
            q[i] = min(max(q[i], box[BOX_STRIDE * v + LOW]), box[BOX_STRIDE * v + HIGH])
        v += 1
    return sound


@routine
def write_middle_configuration(chain, limits, home):
    """Write to `home` (nq,) the middle of the limits of each coordinate; the identity for
    quaternions.

    Where a limit is missing it is the allowed value nearest to 0.
    """
    for k in range(chain.nq):
        home[k] = 0.0
    v = 0
    while v < chain.nv:
        i = find_place(chain, v)
        low = limits[v]
        high = limits[chain.nv + v]
        if is_ball_coordinate(chain, v):
            home[i] = 1.0
            v += 3
            continue
        if i >= 0:
            home[i] = (
                0.5 * (low + high)
                if low > -LARGEST and high < LARGEST
                else min(max(0.0, low), high)
            )
        v += 1


@routine
def wrap_coordinates(chain, limits, circular, home):
    """Turn circular coordinates of q by whole turns: into the limits, there as near to `home` as
    can be.
    """
    for v in range(chain.nv):
        i = find_place(chain, v)
        low = limits[v]
        high = limits[chain.nv + v]
        if circular[v] != 0 and i >= 0:
            x = chain.q[i]
            near = min(max(home[i], low), high)
            x -= 2.0 * math.pi * math.ceil((x - near) / (2.0 * math.pi) - 0.5)
            if x > high:
                x -= 2.0 * math.pi
            elif x < low:
                x += 2.0 * math.pi
            chain.q[i] = min(max(x, low), high)


ARGUMENTS = (
    I("_"),
    F("_"),
    F(2, "nv"),
    I("nv+7"),
    F("N", 4, 4),
    F("1|N", "_", "nq"),
    INT,
    INT,
    INT,
    INT,
    FLOAT,
    FLOAT,
    FLOAT,
    OUT("N", f"nq+{ANSWER}"),
)
"""What the kernels of the inverse kinematics take, see `schedule.reach_goals`."""


class IkProblem(NamedTuple):
    """The arguments of a call; all fields but the numbers are pointers."""

    chain: ChainScratch
    limits: object
    circular: object
    targets: object
    seeds: object
    middle: object
    """The middle of the limits: `home` where there is no seed."""
    kept: object
    home: object
    """Scratch: a configuration, and where the search of one goal is at home."""
    seed_count: int
    seed_step: int
    """How far the seeds of one goal are from those of the next, 0 where all share them."""
    seed: int
    first: int
    """Number of the first start: those before have been tried."""
    tries: int
    iteration_limit: int
    tol_linear: float
    tol_angular: float
    out: object


@routine
def set_goal(chain, target, k):
    """Make the 4x4 pose target[k:] the goal; return whether the part of it that the task reads is
    valid.
    """
    g = chain.goal
    sound = True
    turns = False
    for i in range(3):
        g[4 * i + 3] = target[k + 4 * i + 3] if g[WEIGHTS + i] != 0.0 else 0.0
        sound = sound and abs(g[4 * i + 3]) < LARGEST
        turns = turns or g[WEIGHTS + 3 + i] != 0.0
        for j in range(3):
            g[4 * i + j] = 1.0 if i == j else 0.0
    if not turns:
        return sound
    for i in range(3):
        for j in range(3):
            g[4 * i + j] = target[k + 4 * i + j]
    for i in range(3):
        for j in range(3):
            product = g[i] * g[j] + g[4 + i] * g[4 + j] + g[8 + i] * g[8 + j]
            sound = sound and abs(product - (1.0 if i == j else 0.0)) <= ROTATION_TOLERANCE
    # of an orthogonal matrix the last column is plus or minus the product of the others
    z = g[0] * g[5] - g[1] * g[4]
    return (
        sound
        and (g[10] * z + g[6] * (g[1] * g[8] - g[0] * g[9]) + g[2] * (g[4] * g[9] - g[5] * g[8]))
        > 0.0
    )


@routine
def begin_goal(problem, i, home):
    """Make goal i the chain's goal, and write the default start to `home`; return whether the goal
    and its seeds are valid.

    Where they are not sound, the answer is BAD_INPUT.
    """
    chain = problem.chain
    nq = problem.chain.nq
    sound = set_goal(chain, problem.targets, 16 * i)
    for k in range(4):
        sound = sound and problem.targets[16 * i + 12 + k] == (1.0 if k == 3 else 0.0)
    for k in range(problem.seed_count):
        sound = sound and read_seed(
            chain, problem.seeds, problem.seed_step * i + (problem.seed_count - 1 - k) * nq
        )
    copy_numbers(home, chain.q if problem.seed_count > 0 else problem.middle, 0, nq)
    if not sound:
        for k in range(nq):
            locate_answer(problem, i)[k] = np.nan
        write_answer(problem, i, BAD_INPUT, np.nan, np.nan, 0, 0)
    return sound


@device
def locate_answer(problem, i):
    """Return the pointer to answer i: the configuration, then ANSWER numbers."""
    return advance_pointer(problem.out, (problem.chain.nq + ANSWER) * i)


@device
def write_answer(problem, i, status, linear, angular, steps, starts):
    """Write the status, errors, steps and starts of answer i."""
    out = advance_pointer(locate_answer(problem, i), problem.chain.nq)
    out[LINEAR] = linear
    out[ANGULAR] = angular
    out[STATUS] = status
    out[STEPS] = steps
    out[STARTS] = starts


@device
def make_random_key(problem):
    """Return the key of the random numbers, the same for all goals: an answer does not depend on
    its place in a batch.
    """
    return mix_bits(np.uint64(0), np.uint64(problem.seed))


@routine
def go_to_start(problem, i, start, home):
    """Set q of the chain to start `start` of this call for goal i: a seed, or a random
    configuration.
    """
    number = problem.first + start
    if number < problem.seed_count:
        read_seed(problem.chain, problem.seeds, problem.seed_step * i + number * problem.chain.nq)
    else:
        spread = compute_spread(number - problem.seed_count) if start < problem.tries else 1.0
        draw_configuration(
            problem.chain, home, mix_bits(make_random_key(problem), np.uint64(number)), spread
        )


@routine
def judge_configuration(problem, home):
    """Bring the chain's q inside the limits; return whether it solves the goal, and its linear and
    angular distance.
    """
    chain = problem.chain
    wrap_coordinates(chain, problem.limits, problem.circular, home)
    linear, angular = compute_distances(chain, compute_error(chain.goal, trace_chain(chain)))
    return linear <= problem.tol_linear and angular <= problem.tol_angular, linear, angular


@device
def count_columns(ints):
    """Count the columns of the Jacobian before shared coordinates are added up: three of a ball,
    one of other rows.
    """
    columns = 0
    for row in range(ints[N_ROWS]):
        columns += 3 if ints[HEADER + ROW_INTS * row + KIND] == BALL else 1
    return columns


@device
def count_problem_floats(columns, nq, nv):
    """Return the number of floats of scratch of a problem."""
    return AXES_STRIDE * columns + (BOX_STRIDE + JACOBIAN_STRIDE) * nv + GOAL_SIZE + 4 * nq


@device
def count_problem_ints(columns, nv):
    """Return the number of integers of scratch of a problem."""
    return COLUMN_INTS * columns + PLACE_INTS * nv


@device
def compute_characteristic_length(ints, floats):
    """Return a third of the chain's length, from its first row over all rows to its tip; 1 where
    the length is zero.

    So weighed, turning half of a chain by some angle changes the linear and the angular error
    alike.
    """
    length = 0.0
    for row in range(1, ints[N_ROWS] + 1):
        k = ROW_FLOATS * row
        length += math.sqrt(floats[k + 3] ** 2 + floats[k + 7] ** 2 + floats[k + 11] ** 2)
    return length / 3.0 if length > 0.0 else 1.0


@routine
def prepare_chain(chain, limits, circular, task):
    """Fill the chain's notes, factors, box and weights, which are the same for all goals."""
    ints = chain.ints
    box = chain.box
    notes = chain.notes
    places = COLUMN_INTS * chain.columns
    for v in range(chain.nv):
        k = BOX_STRIDE * v
        free = circular[v] != 0
        box[k + LOW] = -np.inf if free else limits[v]
        box[k + HIGH] = np.inf if free else limits[chain.nv + v]
        box[k + SCALE] = chain.length
        notes[places + PLACE_INTS * v + PLACE] = -1
        notes[places + PLACE_INTS * v + ROUND] = 0
    column = 0
    for row in range(ints[N_ROWS]):
        k = HEADER + ROW_INTS * row
        for i in range(3 if ints[k + KIND] == BALL else 1):
            v = ints[k + V_INDEX] + i
            place = places + PLACE_INTS * v
            notes[COLUMN_INTS * column + OWNER] = v
            notes[COLUMN_INTS * column + TURNS] = int(ints[k + KIND] != SLIDE)
            notes[place + PLACE], notes[place + ROUND] = (
                ints[k + Q_INDEX] + i,
                int(ints[k + KIND] == BALL),
            )
            if ints[k + KIND] != SLIDE:
                box[BOX_STRIDE * v + SCALE] = 1.0
            if ints[k + KIND] == BALL:
                box[BOX_STRIDE * v + LOW] = -np.inf
                box[BOX_STRIDE * v + HIGH] = np.inf
            chain.axes[AXES_STRIDE * column + FACTOR] = chain.floats[ROW_FLOATS * row + MULTIPLIER]
            column += 1
    for column in range(chain.columns):
        v = notes[COLUMN_INTS * column + OWNER]
        chain.axes[AXES_STRIDE * column + FACTOR] *= box[BOX_STRIDE * v + SCALE]
    for i in range(3):
        chain.goal[WEIGHTS + i] = task[i] / chain.length
        chain.goal[WEIGHTS + 3 + i] = task[3 + i] * 1.0
    chain.goal[POINTS] = task[6] * 1.0


@device
def make_ik_problem(
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
    notes,
    block,
):
    """Collect the arguments of a kernel as a problem, with scratch of these two sizes, and `home`
    for one goal.
    """
    table = get_pointer(ints)
    numbers = get_pointer(floats)
    bounds = get_pointer(limits)
    circular = advance_pointer(get_pointer(task), 7)
    nq = ints[NQ]
    nv = ints[NV]
    axes = block
    box = advance_pointer(axes, AXES_STRIDE * columns)
    jacobian = advance_pointer(box, BOX_STRIDE * nv)
    goal = advance_pointer(jacobian, JACOBIAN_STRIDE * nv)
    q = advance_pointer(goal, GOAL_SIZE)
    unit_length = length if length > 0.0 else compute_characteristic_length(table, numbers)
    chain = ChainScratch(
        table, numbers, notes, axes, box, jacobian, q, goal, columns, nq, nv, unit_length
    )
    prepare_chain(chain, bounds, circular, get_pointer(task))
    rest = advance_pointer(q, nq)
    kept = advance_pointer(q, 2 * nq)
    home = advance_pointer(q, 3 * nq)
    if seeds.shape[1] == 0:
        write_middle_configuration(chain, bounds, rest)
    seed_step = seeds.shape[1] * nq if seeds.shape[0] > 1 else 0
    return IkProblem(
        chain,
        bounds,
        circular,
        get_pointer(targets),
        get_pointer(seeds),
        rest,
        kept,
        home,
        seeds.shape[1],
        seed_step,
        seed,
        first,
        max(start_limit, 1),
        iteration_limit,
        tol_linear,
        tol_angular,
        get_pointer(out),
    )
