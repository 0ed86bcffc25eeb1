"""Inverse kinematics of a chain's tip, compiled: damped least squares inside the limits, restarted until it succeeds.

One start reaches the goal in about nine of ten cases, whatever the optimiser: restarts decide, so a step must be
cheap and a start must be given up early. Each step takes the damping 0.05 E + 1e-10 (Chan and Lawrence 1988; Sugihara
2011) and is always accepted. A start ends at the goal, after `iteration_limit` steps, or after four steps without
decrease. Where all starts fail, the best of them is led to a true local minimum of the distance (`nearest`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels._jit import F1, F2, F3, I1, OUT2, OUTI2, device, kernel, routine
from kempe.kernels.nearest import ENOUGH, descend
from kempe.kernels.random import mix
from kempe.kernels.residual import (
    AXES_STRIDE,
    BALL,
    BOX_STRIDE,
    COLUMN_INTS,
    FACTOR,
    HEADER,
    HIGH,
    JACOBIAN_STRIDE,
    LOW,
    OWNER,
    PLACE,
    PLACE_INTS,
    ROUND,
    ROW_FLOATS,
    ROW_INTS,
    SCALE,
    SLIDE,
    TURNS,
    WEIGHTS,
    Chain,
    distances,
    energy,
    error,
    fill_jacobian,
    trace,
)
from kempe.kernels.starts import NUDGE, draw, middle, take, wrap
from kempe.kernels.step import advance, damped_step, place_of
from kempe.kernels.vectors import keep, raw

SOLVED, NOT_FOUND, BAD_INPUT = 0, 1, 2
"""Status codes: within both tolerances and all limits; not found, q is the nearest found; not finite or no rotation."""

DAMPING, DAMPING_FLOOR, DAMPING_CAP = 0.05, 1e-10, 0.1
PATIENCE = 4
DESCENT_LIMIT = 200
ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - I that a goal's rotation may have."""


@device
def characteristic_length(ints, floats):
    """A third of the chain's length from its first motion to its tip; of its placements' sizes; 1 where that is zero.

    About a third makes a turn of the middle joint by 1 rad and the tip's motion alike in the error.
    """
    length = 0.0
    for row in range(1, ints[0] + 1):
        k = ROW_FLOATS * row
        length += math.sqrt(floats[k + 3] ** 2 + floats[k + 7] ** 2 + floats[k + 11] ** 2)
    return length / 3.0 if length > 0.0 else 1.0


@routine
def prepare(chain, limits, circular, mask):
    """Fill the chain's notes, factors, box and weights, which no goal changes."""
    ints, box, notes = chain.ints, chain.box, chain.notes
    for v in range(chain.nv):
        k = BOX_STRIDE * v
        free = circular[v] != 0
        box[k + LOW] = -np.inf if free else limits[v]
        box[k + HIGH] = np.inf if free else limits[chain.nv + v]
        box[k + SCALE] = chain.length
    for row in range(ints[0]):
        k = HEADER + ROW_INTS * row
        if ints[k] != SLIDE:
            for i in range(3 if ints[k] == BALL else 1):
                box[BOX_STRIDE * (ints[k + 3] + i) + SCALE] = 1.0
    column = 0
    for row in range(ints[0]):
        k = HEADER + ROW_INTS * row
        is_ball = ints[k] == BALL
        for i in range(3 if is_ball else 1):
            v = ints[k + 3] + i
            scale = box[BOX_STRIDE * v + SCALE]
            chain.axes[AXES_STRIDE * column + FACTOR] = 1.0 if is_ball else chain.floats[ROW_FLOATS * row + 14] * scale
            notes[COLUMN_INTS * column + OWNER] = v
            notes[COLUMN_INTS * column + TURNS] = int(ints[k] != SLIDE)
            place = COLUMN_INTS * chain.columns + PLACE_INTS * v
            notes[place + PLACE], notes[place + ROUND] = ints[k + 2] + i, int(is_ball)
            if is_ball:
                box[BOX_STRIDE * v + LOW], box[BOX_STRIDE * v + HIGH] = -np.inf, np.inf
            column += 1
    for i in range(3):
        chain.goal[WEIGHTS + i] = mask[i] / chain.length
        chain.goal[WEIGHTS + 3 + i] = mask[3 + i] * 1.0


@routine
def aim(chain, target, k):
    """Whether the 4x4 pose target[k:] is sound where the task reads it; makes it the goal."""
    g, sound, turns = chain.goal, True, False
    for i in range(3):
        g[4 * i + 3] = target[k + 4 * i + 3] if g[WEIGHTS + i] != 0.0 else 0.0
        sound = sound and math.isfinite(g[4 * i + 3])
        turns = turns or g[WEIGHTS + 3 + i] != 0.0
        for j in range(3):
            g[4 * i + j] = (1.0 if i == j else 0.0)
    if not turns:
        return sound
    for i in range(3):
        for j in range(3):
            g[4 * i + j] = target[k + 4 * i + j]
    for i in range(3):
        for j in range(3):
            product = g[i] * g[j] + g[4 + i] * g[4 + j] + g[8 + i] * g[8 + j]
            sound = sound and abs(product - (1.0 if i == j else 0.0)) <= ROTATION_TOLERANCE
    determinant = (
        g[0] * (g[5] * g[10] - g[6] * g[9]) - g[1] * (g[4] * g[10] - g[6] * g[8]) + g[2] * (g[4] * g[9] - g[5] * g[8])
    )
    return sound and determinant > 0.0


@device
def copy(target, source, count):
    """Copy numbers."""
    for k in range(count):
        target[k] = source[k]


@routine
def attempt(chain, limit, tol_linear, tol_angular, kept):
    """Least energy that one start led to, the steps taken, whether within tolerance; `kept` is where.

    Within tolerance, it goes on as long as that pays: usually a step or two to rounding error.
    """
    best, stall, steps, found = np.inf, 0, 0, False
    while True:
        r, p = trace(chain)
        e = error(chain.goal, r, p)
        new = energy(e)
        if new < best:
            best, stall = new, 0
            copy(kept, chain.q, chain.nq)
            linear, angular = distances(chain, e)
            found = found or (linear <= tol_linear and angular <= tol_angular)
        else:
            stall += 1
        if best < ENOUGH or steps >= limit or stall >= (1 if found else PATIENCE):
            return best, steps, found
        fill_jacobian(chain, p)
        damped_step(chain, e, min(DAMPING * new, DAMPING_CAP) + DAMPING_FLOOR)
        advance(chain)
        steps += 1


@routine
def search(chain, seeds, first_seed, seed_count, key, home, settings, kept, best):
    """Steps and starts used; `best` becomes the best configuration found, led to a local minimum if no solution.

    Start k is seed k; after the seeds come about the middle of the limits, then random configurations.
    """
    start_limit, iteration_limit, tol_linear, tol_angular = settings
    least, steps = np.inf, 0
    for start in range(start_limit):
        if start < seed_count:
            take(chain, seeds, first_seed + start * chain.nq)
        else:
            draw(chain, home, mix(key, start), NUDGE if start == seed_count else 1.0)
        energy_found, count, found = attempt(chain, iteration_limit, tol_linear, tol_angular, kept)
        steps += count
        if found or energy_found < least:
            least = energy_found
            copy(best, kept, chain.nq)
        if found:
            return steps, start + 1
    copy(chain.q, best, chain.nq)
    steps += descend(chain, DESCENT_LIMIT)
    copy(best, chain.q, chain.nq)
    return steps, start_limit


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
    """Number of goals not reached; one goal after the other, each a pure function of its number and the arguments.

    ints, floats: table of a chain with one output. limits: (2, nv), lower and upper, infinite where there is none;
    ignored for balls. circular: (nv,) 1 for a coordinate of one turning row with multiplier +-1 whose range is at least
    a turn. mask: (6,) 1 for each row [linear; angular] (ground axes) of the task. targets: (N, 4, 4).
    seeds: (1 or N, K, nq), the first K starts. seed, offset: goal i draws its random numbers from (seed, offset + i).
    start_limit: starts at most, seeds included; iteration_limit: steps of a start. tol_linear, tol_angular: largest
    norm of the error's linear and angular part. length: unit of lengths in the error, 0 for one taken from the chain.
    out_q: (N, nq). out_residual: (N, 2) linear, angular. out_info: (N, 3) status, steps, starts.
    A goal or seed that is not finite, or no pose, gives NaN and BAD_INPUT. Without success out_q is the nearest found.
    """
    table, numbers = raw(ints), raw(floats)
    nq, nv, columns = ints[2], ints[3], 0
    for row in range(ints[0]):
        columns += 3 if ints[HEADER + ROW_INTS * row] == BALL else 1
    notes = np.zeros(COLUMN_INTS * columns + PLACE_INTS * nv, np.int64)
    axes, box, jacobian = np.empty(AXES_STRIDE * columns), np.empty(BOX_STRIDE * nv), np.empty(JACOBIAN_STRIDE * nv)
    goal, q, home, kept, best = np.empty(WEIGHTS + 6), np.zeros(nq), np.zeros(nq), np.zeros(nq), np.zeros(nq)
    unit_length = length if length > 0.0 else characteristic_length(table, numbers)
    chain = Chain(
        table, numbers, raw(notes), raw(axes), raw(box), raw(jacobian), raw(q), raw(goal), columns, nq, nv, unit_length
    )
    bounds, at = raw(limits), raw(circular)
    prepare(chain, bounds, at, raw(mask))
    seed_count = seeds.shape[1]
    settings = (start_limit, iteration_limit, tol_linear, tol_angular)
    if seed_count == 0:
        middle(chain, bounds, raw(home))
    missed = 0
    for i in range(targets.shape[0]):
        first_seed = seed_count * nq * i if seeds.shape[0] > 1 else 0
        sound = aim(chain, raw(targets), 16 * i)
        for k in range(seed_count):
            sound = sound and take(chain, raw(seeds), first_seed + (seed_count - 1 - k) * nq)
        if not sound:
            out_q[i, :] = np.nan
            out_residual[i, :] = np.nan
            out_info[i, 0], out_info[i, 1], out_info[i, 2] = BAD_INPUT, 0, 0
            missed += 1
            continue
        if seed_count > 0:
            copy(raw(home), raw(q), nq)
        key = mix(mix(seed, 0), offset + i)
        steps, starts = search(
            chain, raw(seeds), first_seed, seed_count, key, raw(home), settings, raw(kept), raw(best)
        )
        copy(raw(q), raw(best), nq)
        wrap(chain, bounds, at, raw(home))
        r, p = trace(chain)
        linear, angular = distances(chain, error(chain.goal, r, p))
        status = SOLVED if linear <= tol_linear and angular <= tol_angular else NOT_FOUND
        for k in range(nq):
            out_q[i, k] = q[k]
        out_residual[i, 0], out_residual[i, 1] = linear, angular
        out_info[i, 0], out_info[i, 1], out_info[i, 2] = status, steps, starts
        missed += int(status != SOLVED)
    for block in (axes, box, jacobian, goal, q, home, kept, best):
        keep(block)
    keep(notes)
    return missed
