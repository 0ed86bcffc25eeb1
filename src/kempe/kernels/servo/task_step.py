"""One step of tasks in order, of a system without loops.

What each level of tasks reaches, the next ones keep: they act in the null space of its equations,
its inequalities become bounds (Siciliano and Slotine, 1991; Escande, Mansard and Wieber, 2014). The
first level that a step of first order does not lower as promised takes one of second order, with
the Hessian of the Lagrangian (earlier levels stay as they are), which must do so, else a shorter
one; levels after it do not count.

Velocities are scaled: radians and characteristic lengths in a second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLOAT, OUT, F, I
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.search_layout import LARGEST as LARGEST_NUMBER
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import add_product
from kempe.kernels.constraints.goals import fill_equations
from kempe.kernels.forward.bound import advance_integer_pointer
from kempe.kernels.forward.configuration_steps import compute_turn
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import (
    count_sweep_scratch,
    locate_poses,
    read_unit_quaternion,
    write_row_poses,
)
from kempe.kernels.servo.joint_step import (
    advance_configuration,
    compute_slow_fraction,
    compute_velocity_bounds,
    is_any_fast,
    is_turning_back,
    mark_limited,
    take_step,
)
from kempe.kernels.servo.servo_layout import (
    BAD_CONFIGURATION,
    BAD_MOTION,
    TASK_HEAD,
    WRONG_SHAPE,
)
from kempe.kernels.servo.step_algebra import (
    compute_dot,
    compute_eigenvectors,
    compute_feasible_fraction,
    compute_largest_size,
    compute_singular_values,
    is_inside,
    multiply_columns,
    multiply_rows,
    symmetrize_matrix,
)
from kempe.kernels.servo.step_constants import (
    ASIDE,
    BEYOND,
    BLIND,
    BUSY,
    DIFFERENCE,
    ENOUGH,
    FLAT,
    HALF,
    INWARD,
    LARGEST,
    LEAST,
    NEAR,
    NOTHING,
    REACHED,
    ROUNDING,
    SADDLE,
    SHIFT,
    SHORTER,
    SLACK,
    SLOW,
    STILL,
    TAKEN,
    TRIALS,
)
from kempe.kernels.tasks.task_search import is_rigid

CLOSED = 1e-8
"""Singular values, as parts of the largest, that count as zero."""
TINY = 1e-300


class Levels(NamedTuple):
    """What does not depend on the configuration; all fields but the numbers are pointers."""

    level: object
    """Level of each row, from 1 on; 0 for rows that do not count."""
    equal: object
    """Whether each row is an equation."""
    hard: object
    """Whether each level is hard."""
    q_of: object
    """Coordinate of each velocity in q; -1 for those of quaternions."""
    ball_q: object
    ball_v: object
    scale: object
    lower: object
    upper: object
    """Limits of each velocity's coordinate."""
    weight: object
    row_low: object
    row_high: object
    """Weight and bounds of each row."""
    fastest: object
    """Largest scaled speeds (n,)."""
    nq: int
    n: int
    ties: int
    """Rows of the tasks; those of near bodies follow."""
    m: int
    """All rows."""
    near: object
    """For each row of near bodies, derivatives (n,) of their distance by scaled velocities, and the
    least speed of the distance for this step."""
    start: object
    """Configuration of these derivatives."""
    levels: int
    balls: int
    dt: float
    damping: float
    slow: float
    """Speed below which no joint counts as turning back."""


class Rows(NamedTuple):
    """Rows of the tasks at a configuration, weighted, and of near bodies: the Jacobian (m, n), and
    between what its product with the velocities shall be.
    """

    jacobian: object
    low: object
    high: object


class Descent(NamedTuple):
    """Velocities that satisfy levels one after the other, and scratch; all fields are pointers."""

    z: object
    free: object
    """Orthonormal rows (p, n): what earlier levels leave."""
    bound_rows: object
    bound_low: object
    bound_high: object
    """Bounds that hold: low <= G z <= high."""
    rows: object
    right: object
    which: object
    """Rows of a level that are lowered: equations, then inequalities that do not hold."""
    equations: object
    wish: object
    """The same for what is free: E y = wish."""
    reduced: object
    low: object
    high: object
    """The bounds for what is free."""
    y: object
    left: object
    values: object
    vectors: object
    """Singular values of E: U^T, s, V^T."""
    held: object
    value: object
    way: object
    push: object
    held_rows: object
    held_left: object
    held_values: object
    held_vectors: object
    """Rows of bounds that hold a solution, and their singular values."""
    inner: object
    inner_left: object
    inner_values: object
    inner_vectors: object
    metric: object
    goal: object
    step: object
    pull: object
    slope: object
    work: object


class Trial(NamedTuple):
    """Scratch of a step: pointers to vectors (n,), matrices (n, n), one number for each level, and
    a configuration.
    """

    wide_low: object
    wide_high: object
    least: object
    most: object
    pull: object
    force: object
    model: object
    convex: object
    requested: object
    remaining: object
    after: object


# ---- configurations and rows


@routine
def add_near_rows(own, q, rows):
    """Write the rows of near bodies: distances change as their derivatives at the start say."""
    n = own.n
    for i in range(own.m - own.ties):
        given = advance_pointer(own.near, i * (n + 1))
        row = advance_pointer(rows.jacobian, (own.ties + i) * n)
        copy_numbers(row, given, 0, n)
        changed = 0.0
        for k in range(n):
            if own.q_of[k] >= 0:
                changed += given[k] * (q[own.q_of[k]] - own.start[own.q_of[k]]) / own.scale[k]
        for b in range(own.balls):
            k = own.ball_v[b]
            at = own.ball_q[b]
            x, y, z = compute_turn(
                read_unit_quaternion(own.start, at, 1.0), read_unit_quaternion(q, at, 1.0)
            )
            changed += given[k] * x / own.scale[k]
            changed += given[k + 1] * y / own.scale[k + 1] + given[k + 2] * z / own.scale[k + 2]
        rows.low[own.ties + i] = given[n] - changed / own.dt
        rows.high[own.ties + i] = math.inf


@routine
def evaluate_rows(own, loops, q, rows):
    """Write all rows at a configuration; return whether they are finite."""
    n = own.n
    copy_numbers(loops.q, q, 0, own.nq)
    write_row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    fill_equations(loops, True)
    for i in range(own.ties * n):
        rows.jacobian[i] = 0.0
    for v in range(n):
        add_product(loops, v, 1.0, advance_pointer(rows.jacobian, v), n)
    fine = True
    for i in range(own.ties):
        if own.level[i] == 0:
            continue
        w = own.weight[i]
        rate = w / own.dt
        error = rate * loops.error[i]
        fine = fine and abs(error) < LARGEST_NUMBER
        rows.low[i] = rate * own.row_low[i] - error
        rows.high[i] = rate * own.row_high[i] - error
        for j in range(n):
            rows.jacobian[i * n + j] *= w
    add_near_rows(own, q, rows)
    return fine


@routine
def compute_level_square(own, rows, level, u, moving):
    """Return the square of what velocities leave of a level; of all of it where not `moving`."""
    total = 0.0
    for i in range(own.m):
        if own.level[i] != level:
            continue
        value = compute_dot(advance_pointer(rows.jacobian, i * own.n), u, own.n) if moving else 0.0
        off = rows.low[i] - value
        if own.equal[i] == 0:
            off = max(off, 0.0) + max(value - rows.high[i], 0.0)
        total += off * off
    return total


# ---- least squares under bounds


@device
def count_rank(values, count, level, size):
    """Return how many of the descending singular values are above a part of the largest, which
    counts as `size` at least.
    """
    largest = max(values[0], size) if count else size
    rank = 0
    while rank < count and values[rank] > level * largest:
        rank += 1
    return rank


@routine
def solve_held_step(d, p, rank):
    """Write the step to the nearest point that moves along no held row."""
    k = p - rank
    for i in range(p):
        row = advance_pointer(d.vectors, i * p)
        d.slope[i] = d.metric[i] * (compute_dot(row, d.goal, p) - compute_dot(row, d.y, p))
        for j in range(k):
            d.inner[i * k + j] = d.metric[i] * compute_dot(
                row, advance_pointer(d.held_vectors, (rank + j) * p), p
            )
    compute_singular_values(d.inner, p, k, d.inner_left, d.inner_values, d.inner_vectors, d.work)
    for j in range(p):
        d.step[j] = 0.0
    for i in range(k):
        if d.inner_values[i] > ROUNDING * d.inner_values[0]:
            along = compute_dot(advance_pointer(d.inner_left, i * p), d.slope, p)
            along /= d.inner_values[i]
            for a in range(k):
                part = along * d.inner_vectors[i * k + a]
                for j in range(p):
                    d.step[j] += part * d.held_vectors[(rank + a) * p + j]


@routine
def find_released_row(d, held, p):
    """Return the held row that the gradient pulls inside most, -1 where there is none."""
    size = 1.0
    for i in range(p):
        row = advance_pointer(d.vectors, i * p)
        goal = compute_dot(row, d.goal, p)
        size = max(size, abs(d.metric[i] * goal))
        d.slope[i] = d.metric[i] * d.metric[i] * (compute_dot(row, d.y, p) - goal)
    multiply_columns(d.vectors, d.slope, p, p, d.step)
    for a in range(held):
        d.push[a] = 0.0
    for i in range(min(held, p)):
        if d.held_values[i] > ROUNDING * d.held_values[0]:
            along = compute_dot(advance_pointer(d.held_vectors, i * p), d.step, p)
            for a in range(held):
                d.push[a] += along / d.held_values[i] * d.held_left[i * held + a]
    worst = -1
    most = INWARD * size
    for a in range(held):
        i = int(d.way[a])
        value = compute_dot(advance_pointer(d.reduced, i * p), d.y, p)
        if not d.low[i] < d.high[i]:
            continue
        pull = -d.push[a] if value - d.low[i] <= d.high[i] - value else d.push[a]
        if pull > most:
            most = pull
            worst = i
    return worst


@routine
def find_nearest_bounded(d, p, count):
    """Move y (p,) to the point nearest to it that keeps `count` bounds, by an active set (Stark and
    Parker, 1995).

    Distances are measured by `metric` (p,) along the right singular vectors. Zero must be within
    the bounds; rows may depend on each other.
    """
    for j in range(p):
        d.goal[j] = d.y[j]
        d.y[j] = 0.0
    for i in range(count):
        d.held[i] = 0.0
    for _ in range(10 * count + 10):
        held = 0
        for i in range(count):
            if d.held[i] != 0.0:
                copy_numbers(
                    advance_pointer(d.held_rows, held * p), advance_pointer(d.reduced, i * p), 0, p
                )
                held += 1
        rank = 0
        if held:
            compute_singular_values(
                d.held_rows, held, p, d.held_left, d.held_values, d.held_vectors, d.work
            )
            rank = count_rank(d.held_values, min(held, p), CLOSED, 1.0)
        if rank < p:
            if held:
                solve_held_step(d, p, rank)
            else:
                for j in range(p):
                    d.step[j] = d.goal[j] - d.y[j]
            multiply_rows(d.reduced, d.step, count, p, d.way)
            multiply_rows(d.reduced, d.y, count, p, d.value)
            slack = SLACK * max(1.0, compute_largest_size(d.way, count))
            part = math.inf
            which = -1
            for i in range(count):
                if d.held[i] != 0.0:
                    continue
                ahead = d.value[i] + d.way[i]
                room = math.inf
                if d.way[i] < 0.0 and ahead < d.low[i] - slack:
                    room = (d.low[i] - d.value[i]) / d.way[i]
                elif d.way[i] > 0.0 and ahead > d.high[i] + slack:
                    room = (d.high[i] - d.value[i]) / d.way[i]
                if room < part:
                    part = room
                    which = i
            if which >= 0:
                part = min(max(part, 0.0), 1.0)
            else:
                part = 1.0
            for j in range(p):
                d.y[j] += part * d.step[j]
            if which >= 0:
                d.held[which] = 1.0
                continue
        if held == 0:
            return
        a = 0
        for i in range(count):
            if d.held[i] != 0.0:
                d.way[a] = float(i)
                a += 1
        worst = find_released_row(d, held, p)
        if worst < 0:
            return
        d.held[worst] = 0.0


@routine
def minimize_damped_residual(d, p, m, count, damping):
    """Write the damped y (p,) that minimises |E y - wish| within `count` bounds, and the singular
    values of E (m, p).

    Directions whose singular values are below `NEAR` times the largest are damped, by at most
    `damping` times that (Maciejewski and Klein, 1988). Where this y is outside the bounds, the
    nearest one within them is taken, in the metric of the damped equations.
    """
    compute_singular_values(d.equations, m, p, d.left, d.values, d.vectors, d.work)
    k = min(m, p)
    most = d.values[0] if d.values[0] != 0.0 else 1.0
    weak = LEAST * NEAR * most
    for j in range(p):
        d.y[j] = 0.0
        d.metric[j] = weak
    for i in range(k):
        s = d.values[i]
        if s > ROUNDING * d.values[0]:
            hard = 0.0
            if s < NEAR * most:
                hard = damping * most * math.sqrt(max(1.0 - (s / (NEAR * most)) ** 2, 0.0))
            along = compute_dot(advance_pointer(d.left, i * m), d.wish, m)
            along *= s / (s * s + hard * hard)
            for j in range(p):
                d.y[j] += along * d.vectors[i * p + j]
            d.metric[i] = math.sqrt(s * s + hard * hard + weak * weak)
        else:
            d.metric[i] = math.sqrt(s * s + weak * weak)
    multiply_rows(d.reduced, d.y, count, p, d.value)
    if not is_inside(d.value, d.low, d.high, count):
        find_nearest_bounded(d, p, count)


@routine
def slow_velocities(own, d, p, m, count, low, high):
    """Shorten y (p,) to limits of speed (n,), then find the nearest allowed velocities.

    The singular values are those of E (m, p), which `minimize_damped_residual` left.
    """
    n = own.n
    multiply_columns(d.free, d.y, p, n, d.step)
    part = compute_feasible_fraction(d.step, low, high, n)
    inside = True
    for j in range(n):
        x = part * d.step[j]
        inside = inside and x >= min(low[j] - d.z[j], 0.0) and x <= max(high[j] - d.z[j], 0.0)
    for j in range(p):
        d.y[j] *= part
    if inside:
        return
    for i in range(n):
        for j in range(p):
            d.reduced[(count + i) * p + j] = d.free[j * n + i]
        d.low[count + i] = min(low[i] - d.z[i], 0.0)
        d.high[count + i] = max(high[i] - d.z[i], 0.0)
    weak = SHIFT * NEAR * (d.values[0] if d.values[0] != 0.0 else 1.0)
    for j in range(p):
        s = d.values[j] if j < m else 0.0
        d.metric[j] = math.sqrt(s * s + weak * weak)
    find_nearest_bounded(d, p, count + n)


# ---- levels


@routine
def add_bound(d, n, count, row, low, high):
    """Add the bound low <= row z <= high after `count` others."""
    copy_numbers(advance_pointer(d.bound_rows, count * n), row, 0, n)
    d.bound_low[count] = low
    d.bound_high[count] = high


@routine
def make_convex_problem(own, d, p, m, model, damping):
    """Replace E (m, p) and its right side by those of a Hessian (n, n) and the pull (p,).

    Curvatures are made positive; the damping that E would have is added.
    """
    n = own.n
    compute_singular_values(d.equations, m, p, d.left, d.values, d.vectors, d.work)
    largest = max(d.values[0], TINY)
    for i in range(p):
        multiply_rows(model, advance_pointer(d.free, i * n), n, n, d.step)
        for j in range(p):
            d.inner[i * p + j] = compute_dot(d.step, advance_pointer(d.free, j * n), n)
    for k in range(p):
        s = d.values[k] / largest if k < m else 0.0
        weak = damping * math.sqrt(max(1.0 - (s / NEAR) ** 2, 0.0)) * d.values[0]
        if weak > 0.0:
            for i in range(p):
                for j in range(p):
                    d.inner[i * p + j] += weak * weak * d.vectors[k * p + i] * d.vectors[k * p + j]
    symmetrize_matrix(d.inner, p)
    compute_eigenvectors(d.inner, p, d.inner_values, d.inner_vectors, d.work)
    most = compute_largest_size(d.inner_values, p)
    for i in range(p):
        size = abs(d.inner_values[i])
        if size <= FLAT * most:
            size = max(most, TINY)
        root = math.sqrt(size)
        row = advance_pointer(d.inner_vectors, i * p)
        d.wish[i] = compute_dot(row, d.pull, p) / root
        for j in range(p):
            d.equations[i * p + j] = root * row[j]


@routine
def write_pull(own, d, p, equations, lowered, model):
    """Write the pull (p,) of the rows to be lowered, less what the velocities have of a Hessian.

    `d.right` holds what the rows shall be.
    """
    n = own.n
    multiply_rows(model, d.z, n, n, d.slope)
    for j in range(n):
        d.slope[j] = -d.slope[j]
    for i in range(lowered):
        for j in range(n):
            d.slope[j] += d.right[i] * d.rows[i * n + j]
    multiply_rows(d.free, d.slope, p, n, d.pull)


@routine
def lower_rows(own, d, p, lowered, count, damping, modelled, model, slowed, low, high):
    """Move z so that the first `lowered` of `rows` come as near as can be to `right`, in the freedom
    of `free` and within the bounds.

    `modelled`: the Hessian `model` (n, n) counts. `slowed`: limits of speed shorten it.
    """
    n = own.n
    for i in range(lowered):
        row = advance_pointer(d.rows, i * n)
        d.wish[i] = d.right[i] - compute_dot(row, d.z, n)
        for j in range(p):
            d.equations[i * p + j] = compute_dot(row, advance_pointer(d.free, j * n), n)
    for i in range(count):
        row = advance_pointer(d.bound_rows, i * n)
        value = compute_dot(row, d.z, n)
        d.low[i] = min(d.bound_low[i] - value, 0.0)
        d.high[i] = max(d.bound_high[i] - value, 0.0)
        for j in range(p):
            d.reduced[i * p + j] = compute_dot(row, advance_pointer(d.free, j * n), n)
    m = lowered
    if modelled:
        write_pull(own, d, p, lowered, lowered, model)
        make_convex_problem(own, d, p, m, model, damping)
        m = p
        damping = 0.0
    minimize_damped_residual(d, p, m, count, damping)
    if slowed:
        slow_velocities(own, d, p, m, count, low, high)
    for i in range(p):
        for j in range(n):
            d.z[j] += d.y[i] * d.free[i * n + j]


@routine
def take_box(own, d, low, high):
    """Begin at rest within a box; return the number of bounds."""
    n = own.n
    count = 0
    for j in range(n):
        d.z[j] = 0.0
        for k in range(n):
            d.free[j * n + k] = 1.0 if j == k else 0.0
    for j in range(n):
        if not (abs(low[j]) < math.inf or abs(high[j]) < math.inf):
            continue
        row = advance_pointer(d.free, j * n)
        add_bound(d, n, count, row, low[j], high[j])
        count += 1
    return count


@routine
def take_level(own, d, rows, level, p, count, damping, modelled, model, slowed, low, high):
    """Lower what velocities miss of a level while earlier levels keep theirs; return the number of
    bounds.
    """
    n = own.n
    hard = own.hard[level] != 0
    lowered = 0
    for i in range(own.m):
        if own.level[i] == level and own.equal[i] != 0:
            copy_numbers(
                advance_pointer(d.rows, lowered * n), advance_pointer(rows.jacobian, i * n), 0, n
            )
            d.right[lowered] = rows.low[i]
            lowered += 1
    equations = lowered
    for i in range(own.m):
        if own.level[i] != level or own.equal[i] != 0:
            continue
        row = advance_pointer(rows.jacobian, i * n)
        value = compute_dot(row, d.z, n)
        slack = BEYOND * max(1.0, abs(value))
        if value < rows.low[i] - slack or value > rows.high[i] + slack:
            copy_numbers(advance_pointer(d.rows, lowered * n), row, 0, n)
            d.right[lowered] = min(max(value, rows.low[i]), rows.high[i])
            d.which[lowered] = float(i)
            lowered += 1
        elif hard:
            add_bound(d, n, count, row, rows.low[i], rows.high[i])
            count += 1
    if lowered and p:
        lower_rows(own, d, p, lowered, count, damping, modelled, model, slowed, low, high)
    if hard:
        for k in range(equations, lowered):
            i = int(d.which[k])
            row = advance_pointer(d.rows, k * n)
            value = compute_dot(row, d.z, n)
            add_bound(d, n, count, row, min(rows.low[i], value), max(rows.high[i], value))
            count += 1
    return count


@routine
def keep_equations(own, d, rows, level, p):
    """Leave to later levels what moves none of the equations of a level; return how much it is."""
    n = own.n
    m = 0
    for i in range(own.m):
        if own.level[i] == level and own.equal[i] != 0:
            row = advance_pointer(rows.jacobian, i * n)
            for j in range(p):
                d.equations[m * p + j] = compute_dot(row, advance_pointer(d.free, j * n), n)
            m += 1
    if m == 0 or p == 0:
        return p
    compute_singular_values(d.equations, m, p, d.left, d.values, d.vectors, d.work)
    rank = count_rank(d.values, min(m, p), CLOSED, 1.0)
    for i in range(p - rank):
        row = advance_pointer(d.inner, i * n)
        multiply_columns(d.free, advance_pointer(d.vectors, (rank + i) * p), p, n, row)
    copy_numbers(d.free, d.inner, 0, (p - rank) * n)
    return p - rank


@routine
def compute_velocity(
    own, d, rows, levels, low, high, modelled, model, slowed, least, most, damping, u
):
    """Write velocities (n,) for the first levels, in order, within the box.

    `slowed`: least and largest velocities within the box shorten what a level asks for, before
    others take over. `modelled`: the Hessian `model` (n, n) counts for the last level.
    """
    count = take_box(own, d, low, high)
    p = own.n
    for level in range(1, levels + 1):
        last = level == levels
        count = take_level(
            own, d, rows, level, p, count, damping, modelled and last, model, slowed, least, most
        )
        if not last:
            p = keep_equations(own, d, rows, level, p)
    for j in range(own.n):
        below = least[j] if slowed else low[j]
        above = most[j] if slowed else high[j]
        u[j] = min(max(d.z[j], below), above)


# ---- second order


@routine
def add_level_pull(own, rows, level, out):
    """Write the pull (n,) of what a level misses."""
    n = own.n
    for j in range(n):
        out[j] = 0.0
    for i in range(own.m):
        if own.level[i] != level:
            continue
        off = rows.low[i]
        if own.equal[i] == 0:
            off = max(rows.low[i], 0.0) + min(rows.high[i], 0.0)
        if off != 0.0:
            for j in range(n):
                out[j] += own.dt * off * rows.jacobian[i * n + j]


@routine
def collect_held_rows(own, d, rows, level, u, low, high, first):
    """Collect the equations of levels before `level`, and unit rows of velocities at a bound, the
    latter `first` or last; return how many there are.
    """
    n = own.n
    count = 0
    for turn in range(2):
        if (turn == 0) == first:
            for k in range(n):
                if u[k] <= low[k] or u[k] >= high[k]:
                    for j in range(n):
                        d.held_rows[count * n + j] = 1.0 if j == k else 0.0
                    count += 1
        else:
            for i in range(own.m):
                if 0 < own.level[i] < level and own.equal[i] != 0:
                    copy_numbers(
                        advance_pointer(d.held_rows, count * n),
                        advance_pointer(rows.jacobian, i * n),
                        0,
                        n,
                    )
                    count += 1
    return count


@routine
def compute_hessian(own, loops, d, t, q, rows, aside, level, u, low, high):
    """Write the Hessian (n, n) of half the square of what a level misses, where earlier levels stay
    as they are: that of the Lagrangian, by differences. `aside` are rows elsewhere.
    """
    n = own.n
    add_level_pull(own, rows, level, t.pull)
    held = collect_held_rows(own, d, rows, level, u, low, high, False)
    for a in range(held):
        t.force[a] = 0.0
    if held:
        compute_singular_values(
            d.held_rows, held, n, d.held_left, d.held_values, d.held_vectors, d.work
        )
        rank = count_rank(d.held_values, min(held, n), CLOSED, TINY)
        for i in range(rank):
            along = compute_dot(advance_pointer(d.held_vectors, i * n), t.pull, n)
            along /= d.held_values[i]
            for a in range(held):
                t.force[a] += along * d.held_left[i * held + a]
    for k in range(n):
        row = advance_pointer(t.model, k * n)
        for j in range(n):
            row[j] = 0.0
            d.step[j] = 0.0
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            d.step[k] = sign * DIFFERENCE
            advance_configuration(own, q, d.step, 1.0, t.after)
            evaluate_rows(own, loops, t.after, aside)
            add_level_pull(own, aside, level, t.pull)
            a = 0
            for i in range(own.m):
                if 0 < own.level[i] < level and own.equal[i] != 0:
                    for j in range(n):
                        t.pull[j] -= t.force[a] * aside.jacobian[i * n + j]
                    a += 1
            for j in range(n):
                row[j] -= sign / (2.0 * DIFFERENCE) * t.pull[j]
    symmetrize_matrix(t.model, n)


@routine
def leave_saddle_point(own, d, t, rows, level, low, high, u):
    """Write velocities (n,) that leave a saddle point of a level's error, and return the decrease
    that they promise; -1 where there are none.

    Their direction is that of the least curvature, where it is negative, among those that earlier
    levels and bounds leave.
    """
    n = own.n
    held = collect_held_rows(own, d, rows, level, u, low, high, True)
    compute_singular_values(
        d.held_rows, held, n, d.held_left, d.held_values, d.held_vectors, d.work
    )
    rank = count_rank(d.held_values, min(held, n), CLOSED, 1.0)
    p = n - rank
    if p == 0:
        return -1.0
    most = compute_largest_size(t.model, n * n)
    for i in range(p):
        multiply_rows(t.model, advance_pointer(d.held_vectors, (rank + i) * n), n, n, d.step)
        for j in range(p):
            d.inner[i * p + j] = compute_dot(
                d.step, advance_pointer(d.held_vectors, (rank + j) * n), n
            )
    compute_eigenvectors(d.inner, p, d.inner_values, d.inner_vectors, d.work)
    if d.inner_values[0] >= -SADDLE * most:
        return -1.0
    multiply_columns(advance_pointer(d.held_vectors, rank * n), d.inner_vectors, p, n, d.step)
    along = 0.0
    for i in range(own.m):
        if own.level[i] == level and own.equal[i] != 0:
            row = advance_pointer(rows.jacobian, i * n)
            along += rows.low[i] * compute_dot(row, d.step, n)
    size = ASIDE / own.dt if along >= 0.0 else -ASIDE / own.dt
    for j in range(n):
        u[j] = size * d.step[j]
        d.value[j] = u[j]
        d.low[j] = low[j]
        d.high[j] = high[j]
    count = n
    for i in range(own.m):
        kept = 0 < own.level[i] <= level and own.equal[i] == 0
        if kept and rows.low[i] <= 0.0 and rows.high[i] >= 0.0:
            d.value[count] = compute_dot(advance_pointer(rows.jacobian, i * n), u, n)
            d.low[count] = rows.low[i]
            d.high[count] = rows.high[i]
            count += 1
    part = compute_feasible_fraction(d.value, d.low, d.high, count)
    for j in range(n):
        u[j] *= part
    return -d.inner_values[0] * compute_dot(u, u, n)


@routine
def descend_to_second_order(own, loops, d, t, q, rows, aside, level, least, most, low, high, u):
    """Write velocities (n,) of a step of second order for a level, those of the levels before where
    none lowers its error; u are those of first order.
    """
    n = own.n
    before = compute_level_square(own, rows, level, u, False)  # exactly as below: rounding cancels
    compute_hessian(own, loops, d, t, q, rows, aside, level, u, low, high)
    size = compute_largest_size(t.model, n * n)
    more = 0.0
    for _ in range(TRIALS):
        copy_numbers(t.convex, t.model, 0, n * n)
        for j in range(n):
            t.convex[j * n + j] += more
        compute_velocity(
            own, d, rows, level, low, high, True, t.convex, False, least, most, own.damping, u
        )
        promise = before - compute_level_square(own, rows, level, u, True)
        aslant = False
        if promise <= BLIND * before:
            copy_numbers(t.pull, u, 0, n)
            found = leave_saddle_point(own, d, t, rows, level, low, high, t.pull)
            if found >= 0.0:
                aslant = True
                promise = found
                copy_numbers(u, t.pull, 0, n)
        if promise >= 0.0 and promise <= STILL * before + (NOTHING / own.dt) ** 2:
            break
        good = promise > 0.0 and promise <= BLIND * before
        if promise > 0.0 and not good:
            take_step(own, q, u, t.after)
            evaluate_rows(own, loops, t.after, aside)
            left = compute_level_square(own, aside, level, u, False)
            good = left <= before - TAKEN * promise
        if good:
            if aslant:
                part = compute_feasible_fraction(u, least, most, n)
                for j in range(n):
                    u[j] *= part
            else:
                compute_velocity(
                    own, d, rows, level, low, high, True, t.convex, True, least, most,
                    own.damping, u,
                )  # fmt: skip
            return
        more = 4.0 * more if more > 0.0 else 1e-2 * size
    compute_velocity(
        own, d, rows, level - 1, low, high, False, t.model, True, least, most, own.damping, u
    )


# ---- a step


@routine
def find_missed_level(own, t, size):
    """Return the first level that needs a step of second order, 0 where none does."""
    for level in range(1, own.levels + 1):
        had = t.requested[level]
        left = t.remaining[level]
        if not left > max(HALF * had, ENOUGH / own.dt):
            continue
        earlier = 0.0
        for k in range(1, level):
            earlier = max(earlier, t.requested[k])
        # earlier ones move it, by more than it disturbs them; or curvature is little beside what is
        # gained
        busy = level > 1 and earlier > BUSY * size
        if busy or (level > 1 and had * had - left * left > 2.0 * BUSY * size * left):
            return 0
        return level
    return 0


@routine
def compute_goal_velocity(own, loops, d, t, q, rows, aside, low, high, u):
    """Write velocities (n,) of a step at q, where `rows` are known; return whether it is calm: it
    arrives, and the next one makes good only what second derivatives have left.
    """
    n = own.n
    compute_velocity_bounds(own, q, True, low, high)
    compute_velocity_bounds(own, q, False, t.wide_low, t.wide_high)
    for j in range(n):
        t.wide_low[j] = max(t.wide_low[j], -LARGEST / own.dt)
        t.wide_high[j] = min(t.wide_high[j], LARGEST / own.dt)
    compute_velocity(
        own, d, rows, own.levels, t.wide_low, t.wide_high, False, t.model, False, low, high,
        own.damping, u,
    )  # fmt: skip
    size = own.dt * compute_dot(u, u, n)
    still = size * own.dt <= ENOUGH * ENOUGH
    whole = compute_feasible_fraction(u, low, high, n) == 1.0
    far = not (whole or still)
    if far:
        take_step(own, q, u, t.after)
        evaluate_rows(own, loops, t.after, aside)
    most = 0.0
    for k in range(1, own.levels + 1):
        t.requested[k] = math.sqrt(compute_level_square(own, rows, k, u, False))
        if far:
            t.remaining[k] = math.sqrt(compute_level_square(own, aside, k, u, False))
        else:
            t.remaining[k] = math.sqrt(compute_level_square(own, rows, k, u, True))
        most = max(most, t.remaining[k])
    level = find_missed_level(own, t, size)
    if level:
        descend_to_second_order(
            own, loops, d, t, q, rows, aside, level, low, high, t.wide_low, t.wide_high, u
        )
        return False
    if still:
        for j in range(n):
            u[j] = 0.0
    elif not whole:
        compute_velocity(
            own, d, rows, own.levels, t.wide_low, t.wide_high, False, t.model, True, low, high,
            own.damping, u,
        )  # fmt: skip
    following = size * math.sqrt(float(n)) / max(NEAR, own.damping)
    return whole and most <= ENOUGH / own.dt and own.damping >= NEAR and following <= own.slow


@routine
def find_steady_fraction(own, loops, d, t, q, u, moved, rows, aside, low, high, then, there):
    """Find the fraction of the step after which no joint turns back at once.

    Speeds below `SLOW` of the largest (n,) do not count. Where a joint turns back, a shorter step
    leads nearer to where its speed passes zero, and one at `SLOW` of the speeds across.
    """
    n = own.n
    part = 1.0
    for _ in range(SHORTER):
        for j in range(n):
            moved[j] = part * u[j]
        if not is_any_fast(own, moved):
            return part
        take_step(own, q, moved, there)
        evaluate_rows(own, loops, there, rows)
        compute_goal_velocity(own, loops, d, t, there, rows, aside, low, high, then)
        if not is_turning_back(own, moved, then):
            return part
        part *= 0.5
    return compute_slow_fraction(own, u)


@routine
def write_answer(own, rows, q, u, low, high, out):
    """Write q after the step, velocities, fraction, which velocities are at a limit, and the rates
    of equations of hard levels; return how many are at a limit.
    """
    n = own.n
    take_step(own, q, u, out)
    velocity = advance_pointer(out, own.nq)
    limited = advance_pointer(velocity, n + 1)
    rates = advance_pointer(limited, n)
    count = mark_limited(own, u, low, high, limited)
    for j in range(n):
        velocity[j] = u[j] * own.scale[j]
    had = 0.0
    square = 0.0
    k = 0
    for level in range(1, own.levels + 1):
        if own.hard[level] == 0:
            continue
        for i in range(own.m):
            if own.level[i] == level and own.equal[i] != 0:
                x = compute_dot(advance_pointer(rows.jacobian, i * n), u, n)
                rates[k] = x
                had += rows.low[i] * x
                square += rows.low[i] * rows.low[i]
                k += 1
    reached = square * own.dt * own.dt <= REACHED * REACHED
    velocity[n] = 1.0 if reached else had / square
    return count


@device
def make_rows(block, m, n):
    """Make `Rows` in a block of m n + 2 m numbers."""
    low = advance_pointer(block, m * n)
    return Rows(block, low, advance_pointer(low, m))


@device
def count_descent_numbers(m, n):
    """Count the numbers of a `Descent`."""
    r = m + n
    c = r + n
    return 4 * r * n + 2 * c * n + 9 * r + r * r + 6 * c + c * c + 7 * n * n + c * n + 12 * n + 64


@device
def make_descent(block, m, n):
    """Make a `Descent` in a block of scratch."""
    r = m + n
    c = r + n
    z = block
    free = advance_pointer(z, n)
    bound_rows = advance_pointer(free, n * n)
    bound_low = advance_pointer(bound_rows, r * n)
    bound_high = advance_pointer(bound_low, r)
    rows = advance_pointer(bound_high, r)
    right = advance_pointer(rows, r * n)
    which = advance_pointer(right, r)
    equations = advance_pointer(which, r)
    wish = advance_pointer(equations, r * n)
    reduced = advance_pointer(wish, r)
    low = advance_pointer(reduced, c * n)
    high = advance_pointer(low, c)
    y = advance_pointer(high, c)
    left = advance_pointer(y, n)
    values = advance_pointer(left, r * r)
    vectors = advance_pointer(values, r)
    held = advance_pointer(vectors, n * n)
    value = advance_pointer(held, c)
    way = advance_pointer(value, c)
    push = advance_pointer(way, c)
    held_rows = advance_pointer(push, c)
    held_left = advance_pointer(held_rows, c * n)
    held_values = advance_pointer(held_left, c * c)
    held_vectors = advance_pointer(held_values, c)
    inner = advance_pointer(held_vectors, n * n)
    inner_left = advance_pointer(inner, n * n)
    inner_values = advance_pointer(inner_left, n * n)
    inner_vectors = advance_pointer(inner_values, n)
    metric = advance_pointer(inner_vectors, n * n)
    goal = advance_pointer(metric, n)
    step = advance_pointer(goal, n)
    pull = advance_pointer(step, n)
    slope = advance_pointer(pull, n)
    work = advance_pointer(slope, n)
    return Descent(
        z, free, bound_rows, bound_low, bound_high, rows, right, which, equations, wish, reduced,
        low, high, y, left, values, vectors, held, value, way, push, held_rows, held_left,
        held_values, held_vectors, inner, inner_left, inner_values, inner_vectors, metric, goal,
        step, pull, slope, work,
    )  # fmt: skip


@device
def make_trial(block, m, n, levels):
    """Make a `Trial` in a block of scratch."""
    wide_high = advance_pointer(block, n)
    least = advance_pointer(wide_high, n)
    most = advance_pointer(least, n)
    pull = advance_pointer(most, n)
    force = advance_pointer(pull, n)
    model = advance_pointer(force, m + n)
    convex = advance_pointer(model, n * n)
    requested = advance_pointer(convex, n * n)
    remaining = advance_pointer(requested, levels + 1)
    after = advance_pointer(remaining, levels + 1)
    return Trial(
        block, wide_high, least, most, pull, force, model, convex, requested, remaining, after
    )


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("_"),
    I("_"),
    F("_"),
    F("_"),
    F("_"),
    F("_"),
    FLOAT,
    FLOAT,
    OUT("_"),
)
def compute_task_step(
    ints, floats, plan, weights, pins, order, numbers, near, q, speed, dt, damping, out
):
    """Write the configuration (nq,) after one step of tasks, and an answer as `servo_layout` says;
    return the number of velocities at a limit, or a negative code.

    ints, floats: the table; plan, weights: the ties, and pins (k,), as `loop_layout` says. order,
    numbers: levels of rows, as `servo_layout` says. near: for each row of near bodies, which follow
    those of the ties, derivatives (nv,) of their distance and its least speed. speed: one entry, or
    nv.
    """
    nq = ints[NQ]
    n = ints[NV]
    n_rows = ints[TABLE_ROWS]
    ties = plan[L.N_ROWS]
    m = ties + near.shape[0] // (n + 1)
    o_ = get_pointer(order)
    levels = o_[0]
    balls = o_[1]
    rates = o_[2]
    one = speed.shape[0] == 1
    if (
        q.shape[0] != nq
        or (not one and speed.shape[0] != n)
        or out.shape[0] != nq + 2 * n + 1 + rates
    ):
        return WRONG_SHAPE
    for i in range(nq):
        if not abs(q[i]) < LARGEST_NUMBER:
            return BAD_CONFIGURATION
    pin = get_pointer(pins)
    for j in range(pins.shape[0]):
        if not abs(pin[j]) < LARGEST_NUMBER:
            return BAD_MOTION
    for j in range(plan[L.N_PINS]):
        if not is_rigid(pin, 12 * j):
            return BAD_MOTION
    level = advance_integer_pointer(o_, TASK_HEAD)
    equal = advance_integer_pointer(level, m)
    hard = advance_integer_pointer(equal, m)
    q_of = advance_integer_pointer(hard, levels + 1)
    ball_q = advance_integer_pointer(q_of, n)
    ball_v = advance_integer_pointer(ball_q, balls)
    scale = get_pointer(numbers)
    lower = advance_pointer(scale, n)
    upper = advance_pointer(lower, n)
    weight = advance_pointer(upper, n)
    row_low = advance_pointer(weight, ties)
    row_high = advance_pointer(row_low, ties)
    sweep = count_sweep_scratch(n_rows)
    size_rows = m * n + 2 * m
    size_trial = 6 * n + m + 2 * n * n + 2 * (levels + 1) + nq
    block = np.empty(
        sweep
        + m
        + plan[L.BLOCKS]
        + 2 * nq
        + 8 * n
        + 3 * size_rows
        + size_trial
        + count_descent_numbers(m, n)
        + 64
    )
    scratch = get_pointer(block)
    error = advance_pointer(scratch, sweep)
    blocks = advance_pointer(error, m)
    place = advance_pointer(blocks, plan[L.BLOCKS])
    there = advance_pointer(place, nq)
    fastest = advance_pointer(there, nq)
    low = advance_pointer(fastest, n)
    high = advance_pointer(low, n)
    u = advance_pointer(high, n)
    then = advance_pointer(u, n)
    moved = advance_pointer(then, n)
    then_low = advance_pointer(moved, n)
    then_high = advance_pointer(then_low, n)
    first = advance_pointer(then_high, n)
    second = advance_pointer(first, size_rows)
    third = advance_pointer(second, size_rows)
    tried = advance_pointer(third, size_rows)
    descent = advance_pointer(tried, size_trial)
    slow = math.inf
    for j in range(n):
        fastest[j] = (speed[0] if one else speed[j]) / scale[j]
        slow = min(slow, SLOW * fastest[j])
    loops = LoopScratch(
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(plan),
        get_pointer(weights),
        pin,
        place,
        scratch,
        advance_pointer(scratch, locate_poses(n_rows)),
        error,
        blocks,
        n_rows,
        nq,
        n,
    )
    start = get_pointer(q)
    own = Levels(
        level, equal, hard, q_of, ball_q, ball_v, scale, lower, upper, weight, row_low, row_high,
        fastest, nq, n, ties, m, get_pointer(near), start, levels, balls, dt, damping, slow,
    )  # fmt: skip
    d = make_descent(descent, m, n)
    t = make_trial(tried, m, n, levels)
    rows = make_rows(first, m, n)
    if not evaluate_rows(own, loops, start, rows):
        return BAD_MOTION
    calm = compute_goal_velocity(
        own, loops, d, t, start, rows, make_rows(third, m, n), low, high, u
    )
    if not calm:
        part = find_steady_fraction(
            own, loops, d, t, start, u, moved, make_rows(second, m, n), make_rows(third, m, n),
            then_low, then_high, then, there,
        )  # fmt: skip
        for j in range(n):
            u[j] *= part
    count = write_answer(own, rows, start, u, low, high, get_pointer(out))
    keep_alive(block)
    return count
