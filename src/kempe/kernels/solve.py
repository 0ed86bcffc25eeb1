"""Inverse kinematics of a chain's tip: damped least squares inside the limits, restarted until it succeeds.

One start in two to one in one reaches the goal, whatever the optimiser: restarts decide, so a step must be
cheap and a start must be given up early. Each step takes the damping 0.05 E + 1e-10 (Chan and Lawrence 1988;
Sugihara 2011) and is always accepted. A start ends at the goal, after `iteration_limit` steps, or after four
steps without decrease. Where all starts fail, the answer is the nearest configuration: the best of several
descents to a local minimum of the distance (`nearest`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels._jit import F1, F2, F3, I1, OUT2, OUTI2, device, kernel, routine
from kempe.kernels.layout import (
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
from kempe.kernels.nearest import ENOUGH, descend
from kempe.kernels.random import mix
from kempe.kernels.residual import (
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
    ROUND,
    SCALE,
    TURNS,
    WEIGHTS,
    Chain,
    distances,
    energy,
    error,
    fill_jacobian,
    trace,
)
from kempe.kernels.scratch import beyond
from kempe.kernels.starts import LARGEST, copy, draw, middle, spread_of, take, wrap
from kempe.kernels.step import advance, damped_step
from kempe.kernels.vectors import keep, raw

SOLVED, NOT_FOUND, BAD_INPUT = 0, 1, 2
"""Status codes: within tolerances and limits; not found, q is the nearest; not finite or no rotation."""

DAMPING, DAMPING_FLOOR, DAMPING_CAP = 0.05, 1e-10, 0.1
"""Damping: DAMPING * E, at most DAMPING_CAP, plus DAMPING_FLOOR. Factors of 0.02 to 0.3 do equally well."""

PATIENCE = 4
"""Steps without decrease after which a start is given up."""

DESCENTS, DESCENT_LIMIT = 16, 200
"""Descents to the nearest configuration, at most as many as starts, and steps of each.

The best of 16 is the best of 1000 for at least 95 of 100 goals out of reach of five real arms."""

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - I that a goal's rotation may have."""


@device
def characteristic_length(ints, floats):
    """A third of the chain's length, from its first row over all rows to its tip; 1 where that is zero.

    So weighed, turning half of a chain by some angle changes the linear and the angular error alike.
    """
    length = 0.0
    for row in range(1, ints[N_ROWS] + 1):
        k = ROW_FLOATS * row
        length += math.sqrt(floats[k + 3] ** 2 + floats[k + 7] ** 2 + floats[k + 11] ** 2)
    return length / 3.0 if length > 0.0 else 1.0


@routine
def prepare(chain, limits, circular, mask):
    """Fill the chain's notes, factors, box and weights, which no goal changes."""
    ints, box, notes, places = chain.ints, chain.box, chain.notes, COLUMN_INTS * chain.columns
    for v in range(chain.nv):
        k = BOX_STRIDE * v
        free = circular[v] != 0
        box[k + LOW] = -np.inf if free else limits[v]
        box[k + HIGH] = np.inf if free else limits[chain.nv + v]
        box[k + SCALE] = chain.length
        notes[places + PLACE_INTS * v + PLACE], notes[places + PLACE_INTS * v + ROUND] = -1, 0
    column = 0
    for row in range(ints[N_ROWS]):
        k = HEADER + ROW_INTS * row
        for i in range(3 if ints[k + KIND] == BALL else 1):
            v = ints[k + V_INDEX] + i
            place = places + PLACE_INTS * v
            notes[COLUMN_INTS * column + OWNER] = v
            notes[COLUMN_INTS * column + TURNS] = int(ints[k + KIND] != SLIDE)
            notes[place + PLACE], notes[place + ROUND] = ints[k + Q_INDEX] + i, int(ints[k + KIND] == BALL)
            if ints[k + KIND] != SLIDE:
                box[BOX_STRIDE * v + SCALE] = 1.0
            if ints[k + KIND] == BALL:
                box[BOX_STRIDE * v + LOW], box[BOX_STRIDE * v + HIGH] = -np.inf, np.inf
            chain.axes[AXES_STRIDE * column + FACTOR] = chain.floats[ROW_FLOATS * row + MULTIPLIER]
            column += 1
    for column in range(chain.columns):
        v = notes[COLUMN_INTS * column + OWNER]
        chain.axes[AXES_STRIDE * column + FACTOR] *= box[BOX_STRIDE * v + SCALE]
    for i in range(3):
        chain.goal[WEIGHTS + i] = mask[i] / chain.length
        chain.goal[WEIGHTS + 3 + i] = mask[3 + i] * 1.0


@routine
def aim(chain, target, k):
    """Whether the 4x4 pose target[k:] is sound where the task reads it; makes it the goal."""
    g, sound, turns = chain.goal, True, False
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
        sound and (g[10] * z + g[6] * (g[1] * g[8] - g[0] * g[9]) + g[2] * (g[4] * g[9] - g[5] * g[8])) > 0.0
    )


@routine
def attempt(chain, limit, tol_linear, tol_angular, kept):
    """Least energy that one start led to, the steps taken, whether within tolerance; `kept` is where.

    Within tolerance, it goes on as long as that pays: usually a step or two to rounding error.
    """
    best, stall, steps, found = np.inf, 0, 0, False
    while True:
        tip = trace(chain)
        e = error(chain.goal, tip)
        new = energy(e)
        if new < best:
            best, stall = new, 0
            copy(kept, chain.q, 0, chain.nq)
            linear, angular = distances(chain, e)
            found = found or (linear <= tol_linear and angular <= tol_angular)
        else:
            stall += 1
        if best < ENOUGH or steps >= limit or stall >= (1 if found else PATIENCE):
            return best, steps, found
        fill_jacobian(chain, tip[3])
        damped_step(chain, e, min(DAMPING * new, DAMPING_CAP) + DAMPING_FLOOR)
        advance(chain)
        steps += 1


@kernel(
    types.int64(
        I1, F1, F2, I1, I1, F3, F3, types.int64, types.int64, types.int64, types.int64,
        types.float64, types.float64, types.float64, OUT2, OUT2, OUTI2,
    )
)  # fmt: skip
def ik(
    ints, floats, limits, circular, mask, targets, seeds, seed, offset, start_limit, iteration_limit,
    tol_linear, tol_angular, length, out_q, out_residual, out_info,
):  # fmt: skip
    """Number of goals not reached; each answer is a pure function of the goal's number and the arguments.

    ints, floats: table of a chain with one output. limits: (2, nv), lower and upper, infinite where there is
    none; ignored for balls. circular: (nv,), 1 for a coordinate of a single turning row with multiplier +-1
    whose range is at least a turn. mask: (6,), 1 for each row [linear; angular] (ground axes) of the task.
    targets: (N, 4, 4). seeds: (1 or N, K, nq), the first K starts. seed, offset: goal i draws its random
    numbers from (seed, offset + i). start_limit: starts at most, seeds included. iteration_limit: steps of a
    start. tol_linear, tol_angular: largest norm of the error's linear and angular part. length: what weighs
    as much as a radian, 0 for a part of the chain's. out_q: (N, nq). out_residual: (N, 2) linear, angular.
    out_info: (N, 3) status, steps, starts. SOLVED is judged at the q written, which is always inside the
    limits; with NOT_FOUND it is the nearest found. BAD_INPUT, q and residuals NaN: a goal or seed that is not
    finite or above 1e100, a goal that is no pose.
    """
    table, numbers = raw(ints), raw(floats)
    nq, nv, columns = ints[NQ], ints[NV], 0
    for row in range(ints[N_ROWS]):
        columns += 3 if ints[HEADER + ROW_INTS * row + KIND] == BALL else 1
    notes = np.empty(COLUMN_INTS * columns + PLACE_INTS * nv, np.int64)
    block = np.empty(AXES_STRIDE * columns + (BOX_STRIDE + JACOBIAN_STRIDE) * nv + GOAL_SIZE + 4 * nq)
    axes = raw(block)
    box = beyond(axes, AXES_STRIDE * columns)
    jacobian = beyond(box, BOX_STRIDE * nv)
    goal = beyond(jacobian, JACOBIAN_STRIDE * nv)
    q = beyond(goal, GOAL_SIZE)
    home, kept, best = beyond(q, nq), beyond(q, 2 * nq), beyond(q, 3 * nq)
    unit_length = length if length > 0.0 else characteristic_length(table, numbers)
    chain = Chain(table, numbers, raw(notes), axes, box, jacobian, q, goal, columns, nq, nv, unit_length)
    bounds, at = raw(limits), raw(circular)
    prepare(chain, bounds, at, raw(mask))
    seed_count, tries = seeds.shape[1], max(start_limit, 1)
    if seed_count == 0:
        middle(chain, bounds, home)
    missed = 0
    for i in range(targets.shape[0]):
        first_seed = seed_count * nq * i if seeds.shape[0] > 1 else 0
        sound = aim(chain, raw(targets), 16 * i)
        for k in range(seed_count):
            sound = sound and take(chain, raw(seeds), first_seed + (seed_count - 1 - k) * nq)
        if not sound:
            for k in range(nq):
                out_q[i, k] = np.nan
            out_residual[i, 0], out_residual[i, 1] = np.nan, np.nan
            out_info[i, 0], out_info[i, 1], out_info[i, 2] = BAD_INPUT, 0, 0
            missed += 1
            continue
        if seed_count > 0:
            copy(home, q, 0, nq)
        key = mix(mix(np.uint64(0), np.uint64(seed)), np.uint64(offset + i))
        least, steps, starts, found = np.inf, 0, 0, False
        for start in range(tries + min(tries, DESCENTS)):
            if start == tries:
                copy(q, best, 0, nq)
            elif start < seed_count:
                take(chain, raw(seeds), first_seed + start * nq)
            else:
                spread = spread_of(start - seed_count) if start < tries else 1.0
                draw(chain, home, mix(key, np.uint64(start)), spread)
            if start < tries:
                reached, count, found = attempt(chain, iteration_limit, tol_linear, tol_angular, kept)
                starts += 1
            else:
                reached, count = descend(chain, DESCENT_LIMIT, kept)
            steps += count
            if found or reached < least:
                least = reached
                copy(best, kept, 0, nq)
            if found:
                break
        copy(q, best, 0, nq)
        wrap(chain, bounds, at, home)
        linear, angular = distances(chain, error(chain.goal, trace(chain)))
        status = SOLVED if linear <= tol_linear and angular <= tol_angular else NOT_FOUND
        for k in range(nq):
            out_q[i, k] = q[k]
        out_residual[i, 0], out_residual[i, 1] = linear, angular
        out_info[i, 0], out_info[i, 1], out_info[i, 2] = status, steps, starts
        missed += int(status != SOLVED)
    keep(block)
    keep(notes)
    return missed
