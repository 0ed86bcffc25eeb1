"""The problem of one call of the inverse kinematics: its goals one by one, and how answers are
judged and written.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, F, I
from kempe.kernels.base.random import mix
from kempe.kernels.base.scratch import beyond, copy
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
from kempe.kernels.base.vectors import raw
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
    distances,
    error,
    trace,
)
from kempe.kernels.one_frame.starts import draw, middle, spread_of, take, wrap

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
"""What the kernels of the inverse kinematics take, see `schedule.reach`."""


class IkProblem(NamedTuple):
    """The arguments of a call; all but numbers are pointers."""

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
def aim(chain, target, k):
    """Whether the 4x4 pose target[k:] is sound where the task reads it; makes it the goal."""
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
def begin(problem, i, home):
    """Whether goal i and its seeds are sound; makes it the chain's goal and writes the default
    start to `home`.

    Where they are not sound, the answer is BAD_INPUT.
    """
    chain = problem.chain
    nq = problem.chain.nq
    sound = aim(chain, problem.targets, 16 * i)
    for k in range(4):
        sound = sound and problem.targets[16 * i + 12 + k] == (1.0 if k == 3 else 0.0)
    for k in range(problem.seed_count):
        sound = sound and take(
            chain, problem.seeds, problem.seed_step * i + (problem.seed_count - 1 - k) * nq
        )
    copy(home, chain.q if problem.seed_count > 0 else problem.middle, 0, nq)
    if not sound:
        for k in range(nq):
            answer_of(problem, i)[k] = np.nan
        write(problem, i, BAD_INPUT, np.nan, np.nan, 0, 0)
    return sound


@device
def answer_of(problem, i):
    """Where answer i lies: the configuration, then ANSWER numbers."""
    return beyond(problem.out, (problem.chain.nq + ANSWER) * i)


@device
def write(problem, i, status, linear, angular, steps, starts):
    """Write all but the configuration of answer i."""
    out = beyond(answer_of(problem, i), problem.chain.nq)
    out[LINEAR] = linear
    out[ANGULAR] = angular
    out[STATUS] = status
    out[STEPS] = steps
    out[STARTS] = starts


@device
def key_of(problem):
    """What random numbers are drawn from, for all goals alike: an answer does not depend on the
    place in a batch.
    """
    return mix(np.uint64(0), np.uint64(problem.seed))


@routine
def go_to(problem, i, start, home):
    """Set q of the chain to start `start` of this call for goal i: a seed, or drawn."""
    number = problem.first + start
    if number < problem.seed_count:
        take(problem.chain, problem.seeds, problem.seed_step * i + number * problem.chain.nq)
    else:
        spread = spread_of(number - problem.seed_count) if start < problem.tries else 1.0
        draw(problem.chain, home, mix(key_of(problem), np.uint64(number)), spread)


@routine
def judged(problem, home):
    """(whether solved, linear and angular distance) of the chain's q, which is brought inside the
    limits.
    """
    chain = problem.chain
    wrap(chain, problem.limits, problem.circular, home)
    linear, angular = distances(chain, error(chain.goal, trace(chain)))
    return linear <= problem.tol_linear and angular <= problem.tol_angular, linear, angular


@device
def count_columns(ints):
    """Columns of the Jacobian before shared coordinates are added up: three of a ball, one of other
    rows.
    """
    columns = 0
    for row in range(ints[N_ROWS]):
        columns += 3 if ints[HEADER + ROW_INTS * row + KIND] == BALL else 1
    return columns


@device
def problem_floats(columns, nq, nv):
    """Numbers of scratch of a problem."""
    return AXES_STRIDE * columns + (BOX_STRIDE + JACOBIAN_STRIDE) * nv + GOAL_SIZE + 4 * nq


@device
def problem_ints(columns, nv):
    """Whole numbers of scratch of a problem."""
    return COLUMN_INTS * columns + PLACE_INTS * nv


@device
def characteristic_length(ints, floats):
    """A third of the chain's length, from its first row over all rows to its tip; 1 where that is
    zero.

    So weighed, turning half of a chain by some angle changes the linear and the angular error
    alike.
    """
    length = 0.0
    for row in range(1, ints[N_ROWS] + 1):
        k = ROW_FLOATS * row
        length += math.sqrt(floats[k + 3] ** 2 + floats[k + 7] ** 2 + floats[k + 11] ** 2)
    return length / 3.0 if length > 0.0 else 1.0


@routine
def prepare(chain, limits, circular, task):
    """Fill the chain's notes, factors, box and weights, which no goal changes."""
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
def problem_of(
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
    """The problem for the arguments of a kernel, in scratch of these two sizes, and `home` for one
    goal.
    """
    table = raw(ints)
    numbers = raw(floats)
    bounds = raw(limits)
    circular = beyond(raw(task), 7)
    nq = ints[NQ]
    nv = ints[NV]
    axes = block
    box = beyond(axes, AXES_STRIDE * columns)
    jacobian = beyond(box, BOX_STRIDE * nv)
    goal = beyond(jacobian, JACOBIAN_STRIDE * nv)
    q = beyond(goal, GOAL_SIZE)
    unit_length = length if length > 0.0 else characteristic_length(table, numbers)
    chain = ChainScratch(
        table, numbers, notes, axes, box, jacobian, q, goal, columns, nq, nv, unit_length
    )
    prepare(chain, bounds, circular, raw(task))
    rest = beyond(q, nq)
    kept = beyond(q, 2 * nq)
    home = beyond(q, 3 * nq)
    if seeds.shape[1] == 0:
        middle(chain, bounds, rest)
    seed_step = seeds.shape[1] * nq if seeds.shape[0] > 1 else 0
    return IkProblem(
        chain,
        bounds,
        circular,
        raw(targets),
        raw(seeds),
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
        raw(out),
    )
