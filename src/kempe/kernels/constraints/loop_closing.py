"""Assembly: a configuration that closes all loops, by damped least squares over the unknown
coordinates.

Step: -J^T (J J^T + mu I)^-1 phi, of minimum norm, so that redundant equations are no obstacle; mu
falls with the square of the residual, so that convergence is quadratic (Nakamura and Hanafusa,
1986; Sugihara, 2011). J J^T is kept within its envelope (Jennings, 1966): rows that share no
coordinates cost nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLAG, FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.random import mix_bits
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.search_layout import BAD_INPUT, LARGEST, LATE, NOT_FOUND, SOLVED, UNFINISHED
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import (
    add_product,
    factor_envelope,
    multiply_column,
    solve_envelope,
    write_normal_matrix,
)
from kempe.kernels.constraints.goals import fill_equations, is_late
from kempe.kernels.constraints.loop_coordinates import (
    compute_home_distance,
    draw_configuration,
    extrapolate_unknowns,
    find_place,
    is_held,
    prepare_start,
    read_sort,
    read_velocity_number,
    write_cut_coordinates,
)
from kempe.kernels.constraints.loop_layout import DAMPING, LONGEST, MOST_DAMPING, WIDER
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import count_sweep_scratch, locate_poses, write_row_poses

FLOOR = 1e-30
"""Square of the scaled residual below which rounding is all there is."""
LEAST = 1e-14
"""Floor of the damping, which holds up J J^T where the equations are redundant."""
MANY = 60
"""Equations from which on the clock is looked at before each step: then a step takes far longer
than that."""
NEARLY_CLOSED = 1e-10
"""Damping of a step between limits, which is unique with it."""
SLIGHT = 1e-12
"""Step out of a limit, in radians and characteristic lengths, that is rounding."""
LONGEST_SLIDE = 2.0
"""Longest step of a slide, in characteristic lengths."""


class ClosingScratch(NamedTuple):
    """Pointers to the scratch of a solver: steps, the way home, two columns, the matrix J J^T, two
    configurations.
    """

    step: object
    target: object
    y: object
    column: object
    a: object
    home: object
    kept: object


@routine
def evaluate_residual(loops, with_blocks):
    """Return the square of the scaled residual at q; write the residual."""
    write_row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    return fill_equations(loops, with_blocks)


@routine
def mark_held_steps(loops, step):
    """Mark with NaN the steps of coordinates that do not move: held ones, and those that the
    gradient pushes out of a limit.
    """
    for v in range(loops.nv):
        step[v] = 0.0
        if is_held(loops, v):
            step[v] = np.nan
            continue
        if read_sort(loops, v) >= L.BALL_FIRST:
            continue
        x = loops.q[find_place(loops, v)]
        low = read_velocity_number(loops, 1, v)
        high = read_velocity_number(loops, 2, v)
        if x <= low or x >= high:
            push = -multiply_column(loops, v, loops.error)
            if (x <= low and push <= 0.0) or (x >= high and push >= 0.0):
                step[v] = np.nan


@routine
def take_step(loops, step, y, target, with_target):
    """Take the step -J^T y (+ target), cut to the longest step and at the limits; return its size
    as a part of the longest.
    """
    size = 0.0
    for v in range(loops.nv):
        if step[v] == step[v]:
            step[v] = -multiply_column(loops, v, y)
            if with_target:
                step[v] += target[v]
            size = max(
                size, abs(step[v]) / (LONGEST_SLIDE if read_sort(loops, v) == L.SLIDE else LONGEST)
            )
    part = 1.0 / max(size, 1.0)
    q = loops.q
    for v in range(loops.nv):
        if step[v] != step[v]:
            continue
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        if sort == L.BALL_FIRST:
            turn_quaternion(q, i, part * step[v], part * step[v + 1], part * step[v + 2])
        elif sort != L.BALL_MORE:
            x = q[i] + part * step[v] * read_velocity_number(loops, 0, v)
            q[i] = min(max(x, read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v))
    return size


@routine
def take_damped_step(loops, work, damping):
    """Take the step -J^T (J J^T + damping I)^-1 phi for the equations written last; return its
    size.
    """
    mark_held_steps(loops, work.step)
    write_normal_matrix(loops, work.step, damping, work.a, work.column)
    factor_envelope(loops, work.a, LEAST)
    copy_numbers(work.y, loops.error, 0, loops.plan[L.N_ROWS])
    solve_envelope(loops, work.a, work.y)
    return take_step(loops, work.step, work.y, work.step, False)


@routine
def close_loops(loops, work, limit, accepted, kept, stop):
    """Close the loops from q; return the least square of the residual, the number of steps, and
    whether the last evaluation was the least.

    `kept` is where it was reached; where it was the last one, poses and equations are those of that
    configuration.
    """
    best = np.inf
    before = np.inf
    last = np.inf
    steps = 0
    m = loops.plan[L.N_ROWS]
    often = stop if m >= MANY else 0
    while True:
        square = evaluate_residual(loops, True)
        if not square < LARGEST:
            break
        last = square
        if square < best:
            best = square
            copy_numbers(kept, loops.q, 0, loops.nq)
        if square <= FLOOR or (square <= accepted and square > 0.1 * before) or steps >= limit:
            break
        if often != 0 and is_late(loops, often, work.column, work.y):
            break
        before = square
        damping = min(DAMPING * square / m, MOST_DAMPING) + LEAST
        size = take_damped_step(loops, work, damping)
        steps += 1
        last = np.inf
        if size < 1e-15:
            break
    return best, steps, last == best


@routine
def minimize_residual(loops, work, limit, kept, stop):
    """Minimise the residual near q where it does not vanish; return its least square and the number
    of steps. `kept` is the minimum.

    Damped steps that are taken back where they lead up (Levenberg, 1944; Marquardt, 1963).
    """
    copy_numbers(kept, loops.q, 0, loops.nq)
    best = evaluate_residual(loops, True)
    damping = 1.0
    steps = 0
    often = stop if loops.plan[L.N_ROWS] >= MANY else 0
    while steps < limit and damping < 1e12:
        if often != 0 and is_late(loops, often, work.column, work.y):
            break
        size = take_damped_step(loops, work, damping)
        steps += 1
        square = evaluate_residual(loops, True)
        if square < best:
            best = square
            damping = max(0.3 * damping, LEAST)
            copy_numbers(kept, loops.q, 0, loops.nq)
        else:
            damping *= 4.0
            copy_numbers(loops.q, kept, 0, loops.nq)
            evaluate_residual(loops, True)
        if size < 1e-12:
            break
    return best, steps


@device
def limit_step(loops, v, x):
    """Return the step x of velocity coordinate v cut at its limits."""
    if read_sort(loops, v) >= L.BALL_FIRST:
        return x
    at = loops.q[find_place(loops, v)]
    scale = read_velocity_number(loops, 0, v)
    low = (read_velocity_number(loops, 1, v) - at) / scale
    return min(max(x, low), (read_velocity_number(loops, 2, v) - at) / scale)


@routine
def switch_limit(loops, work, v):
    """Mark or release velocity coordinate v where the limits that its step reaches for the `y`
    found last are not those it is marked with; return whether they are not.
    """
    if is_held(loops, v):
        return False
    x = work.target[v] - multiply_column(loops, v, work.y)
    inside = limit_step(loops, v, x)
    marked = work.step[v] != work.step[v]
    if marked:
        wrong = inside == x or inside != work.kept[v]
    else:
        wrong = abs(inside - x) > SLIGHT
    if wrong:
        work.step[v] = 0.0 if marked else np.nan
        work.kept[v] = inside
    return wrong


@routine
def project_on_closed_directions(loops, work):
    """Replace `target` by the nearest step that keeps loops closed to first order and stays inside
    all limits.

    A step is `target` - J^T y, or as far as the limit for the coordinates that are marked NaN in
    `step`; `kept` has how far. They are marked and released one by one, the first that is wrong
    each time, which ends for the damped equations (least-index pivoting: Murty, 1974).
    """
    for v in range(loops.nv):
        work.step[v] = np.nan if is_held(loops, v) else 0.0
        work.kept[v] = 0.0
    damping = LEAST
    for _ in range(4 * loops.nv):
        for i in range(loops.plan[L.N_ROWS]):
            work.y[i] = 0.0
        for v in range(loops.nv):
            marked = work.step[v] != work.step[v]
            add_product(loops, v, work.kept[v] if marked else work.target[v], work.y, 1)
        write_normal_matrix(loops, work.step, damping, work.a, work.column)
        factor_envelope(loops, work.a, LEAST)
        solve_envelope(loops, work.a, work.y)
        wrong = 0
        while wrong < loops.nv and not switch_limit(loops, work, wrong):
            wrong += 1
        if wrong == loops.nv:
            break
        damping = NEARLY_CLOSED
    for v in range(loops.nv):
        if is_held(loops, v):
            work.target[v] = 0.0
        else:
            x = work.target[v] - multiply_column(loops, v, work.y)
            work.target[v] = limit_step(loops, v, x)
            work.step[v] = 0.0
    for i in range(loops.plan[L.N_ROWS]):
        work.y[i] = 0.0


@routine
def approach_home(loops, work, limit, accepted, kept, stop):
    """Move along the closed configurations from the one in `kept` towards the one nearest to
    `home`; return the number of steps.

    Each goes the way to `home` as far as closed loops and limits allow to first order, shortened
    where that leads away, and is closed again (a projected gradient: Luenberger, 1972). `kept` is
    where it ends.
    """
    steps = 0
    rounds = 0
    copy_numbers(loops.q, kept, 0, loops.nq)
    least = compute_home_distance(loops, work.home, work.target)
    part = 1.0
    size = 1.0
    while rounds < limit and part > 0.05 and size > 1e-9:
        if is_late(loops, stop, work.column, work.y):
            break
        rounds += 1
        evaluate_residual(loops, True)
        compute_home_distance(loops, work.home, work.target)
        for v in range(loops.nv):
            work.target[v] *= part
        project_on_closed_directions(loops, work)
        size = take_step(loops, work.step, work.y, work.target, True)
        square, used, _ = close_loops(loops, work, limit, accepted, loops.q, stop)
        steps += 1 + used
        far = compute_home_distance(loops, work.home, work.target)
        if square <= accepted and far < least:
            least = far
            part = min(1.0, 2.0 * part)
            copy_numbers(kept, loops.q, 0, loops.nq)
        else:
            part *= 0.5
            copy_numbers(loops.q, kept, 0, loops.nq)
    return steps


@routine
def search_closure(loops, work, key, first, tries, limit, accepted, nearest, best_q, stop):
    """Search for a closed configuration from q and other starts; return the residual's square,
    steps, starts, and whether the time was up.

    `best_q` is where it ends, and, of an assembly that goes on after `first` starts, where these
    have led.
    """
    best = np.inf
    steps = 0
    count = first
    current = False
    late = False
    if not prepare_start(loops, work.home):
        return best, steps, count, late
    if first > 0 or tries == 0:
        copy_numbers(loops.q, best_q, 0, loops.nq)
        square = evaluate_residual(loops, False)
        best = square if square < LARGEST else np.inf
    while count < tries and not best <= accepted:
        if count > 0:
            late = is_late(loops, stop, work.column, work.y)
            if late:
                break
            draw_configuration(
                loops, work.home, min(1.0, WIDER * count), mix_bits(key, np.uint64(count))
            )
        square, used, last = close_loops(loops, work, limit, accepted, work.kept, stop)
        steps += used
        count += 1
        current = last and square < best
        if square < best:
            best = square
            copy_numbers(best_q, work.kept, 0, loops.nq)
    if not best < np.inf:
        return best, steps, count, late
    copy_numbers(loops.q, best_q, 0, loops.nq)
    if best > accepted:
        current = False
        if nearest != UNFINISHED and not late:
            late = is_late(loops, stop, work.column, work.y)
            if not late:
                best, used = minimize_residual(loops, work, 10 * limit, best_q, stop)
                steps += used
    elif nearest > 0:
        steps += approach_home(loops, work, nearest, accepted, best_q, stop)
        current = False
    if not current:
        copy_numbers(loops.q, best_q, 0, loops.nq)
        best = evaluate_residual(loops, False)
    write_cut_coordinates(loops, work.home)
    copy_numbers(best_q, loops.q, 0, loops.nq)
    return best, steps, count, late


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("N", "nq"),
    F("1|N", "_"),
    INT,
    INT,
    INT,
    FLOAT,
    INT,
    INT,
    INT,
    FLAG,
    INT,
    OUT("N", "nq"),
    OUT("N"),
    OUTI("N", 3),
)
def assemble_loops(
    ints,
    floats,
    plan,
    weights,
    starts,
    pins,
    first,
    tries,
    limit,
    tolerance,
    nearest,
    seed,
    offset,
    follow,
    stop,
    out_q,
    out_residual,
    info,
):
    """Assemble all configurations; return the number of starts that were not closed.

    ints, floats: the table; plan, weights: the loops (`loop_layout`). starts: (N, nq), with the
    held coordinates. pins: (N or 1, 12 pins) the poses (3x4) of pinned frames. tries: starts at
    most, the first at `starts`, the others drawn from (seed, offset + row), wider and wider about
    it. first: how many of them were made before: `out_q` is then where these led. limit: steps of a
    start. tolerance: largest norm of the residual, in radians and characteristic lengths. nearest:
    steps at most towards the closed configuration nearest to the start; UNFINISHED: none, and what
    is open is not led nearer to closing, for further starts follow. follow: each row after the
    first starts where the two before it lead, with its own held coordinates. stop: address of a
    function that writes whether the work must end, or 0: it is read before each start but the
    first, and, of many equations, before each step; rows after that are not begun. out_q: (N, nq),
    the closed configuration, else the nearest to closing. out_residual: (N,). info: (N, 3) status
    (+ LATE where the work ended before all starts), steps, starts.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    m = plan[L.N_ROWS]
    sweep = count_sweep_scratch(n_rows)
    block = np.empty(sweep + 4 * nq + 2 * nv + 3 * m + plan[L.BLOCKS] + plan[L.ENVELOPE] + 8)
    scratch = get_pointer(block)
    q = advance_pointer(scratch, sweep)
    step = advance_pointer(q, 4 * nq)
    error = advance_pointer(step, 2 * nv)
    blocks = advance_pointer(error, 3 * m)
    work = ClosingScratch(
        step,
        advance_pointer(step, nv),
        advance_pointer(error, m),
        advance_pointer(error, 2 * m),
        advance_pointer(blocks, plan[L.BLOCKS]),
        advance_pointer(q, nq),
        advance_pointer(q, 2 * nq),
    )
    best_q = advance_pointer(q, 3 * nq)
    accepted = tolerance * tolerance
    missed = 0
    ended = False
    for i in range(starts.shape[0]):
        pin = advance_pointer(get_pointer(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        loops = LoopScratch(
            get_pointer(ints),
            get_pointer(floats),
            get_pointer(plan),
            get_pointer(weights),
            pin,
            q,
            scratch,
            advance_pointer(scratch, locate_poses(n_rows)),
            error,
            blocks,
            n_rows,
            nq,
            nv,
        )
        copy_numbers(q, advance_pointer(get_pointer(starts), i * nq), 0, nq)
        if follow and i > 0:
            extrapolate_unknowns(loops, get_pointer(out_q), i)
        key = mix_bits(mix_bits(np.uint64(0), np.uint64(seed)), np.uint64(offset + i))
        copy_numbers(best_q, advance_pointer(get_pointer(out_q), i * nq) if first > 0 else q, 0, nq)
        best, steps, count, late = search_closure(
            loops,
            work,
            key,
            first,
            first if ended else tries,
            limit,
            accepted,
            UNFINISHED if ended else nearest,
            best_q,
            stop,
        )
        ended = ended or late
        status = BAD_INPUT if not best < np.inf else (SOLVED if best <= accepted else NOT_FOUND)
        if ended and status == NOT_FOUND:
            status = NOT_FOUND + LATE
        for k in range(nq):
            out_q[i, k] = best_q[k] if status != BAD_INPUT else np.nan
        out_residual[i] = math.sqrt(best) if status != BAD_INPUT else np.nan
        info[i, 0] = status
        info[i, 1] = steps
        info[i, 2] = count
        missed += int(status != SOLVED)
    keep_alive(block)
    return missed
