"""Several tasks at once: search for a configuration that fulfils them, lower levels in the freedom
that higher levels leave.

Tasks are ties in stages. Stage 0 always holds (loops, relations); each further one is either hard,
to be met, or soft, a sum of weighted squares to be lowered. First damped least squares on all hard
rows, with restarts (Levenberg, 1944; Sugihara, 2011), then stage by stage steps that keep all
earlier ones (Siciliano and Slotine, 1991; Escande, Mansard and Wieber, 2014), each closed again: so
the earlier stages hold, to the tolerance and not only to first order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLAG, INT, OUT, OUTI, F, I
from kempe.kernels.base.random import mix_bits, to_unit_interval
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.search_layout import (
    AHEAD,
    BAD_INPUT,
    LARGEST,
    LATE,
    NOT_FOUND,
    NOTHING,
    SOLVED,
)
from kempe.kernels.base.vectors import extract_entry, get_pointer, keep_alive
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import (
    LoopScratch,
    pack_rotation,
    read_tie_ends,
    rotate_vector_back,
)
from kempe.kernels.constraints.envelope import (
    add_product,
    factor_envelope,
    multiply_column,
    write_normal_matrix,
)
from kempe.kernels.constraints.envelope import solve_envelope as solve_envelope
from kempe.kernels.constraints.goals import call_address, fill_equations, is_late, read_given_number
from kempe.kernels.constraints.loop_coordinates import (
    choose_nearest_angle,
    compute_home_distance,
    draw_configuration,
    find_place,
    is_held,
    prepare_start,
    read_sort,
    read_velocity_number,
    write_cut_coordinates,
)
from kempe.kernels.forward.table_layout import (
    HEADER,
    MULTIPLIER,
    NQ,
    NV,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    PARENT,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    V_INDEX,
)
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_rows import (
    count_sweep_scratch,
    locate_poses,
    read_placement,
    write_row_poses,
)

# ---- active set

# One step under held rows, rows to be lowered and bounds: a small quadratic programme by an active
# set.
#
# The step d minimises |d - t|^2 / 2 + sum (J_i d + e_i)^2 / (2 D_i), t being a wished step: rows
# with
# a D next to nothing hold, those with a larger one are damped least squares. With the set of
# coordinates that stop at their limits, d = t - J^T y for the others and (J J^T + D) y = e + J d of
# those that stop and of t. Rows between bounds count where they are violated or the step would
# violate them (Nocedal and Wright, 2006, section 16.5).


OFF = 1e30
"""The D of a row that does not count."""
LEAST = 1e-14
"""The D of a row that holds, and the least pivot: it stands in where rows depend on each other."""
LONGEST = 0.7
"""Longest turn of a coordinate in a step, in radians, where nothing says that the way is
straight."""
SLIP = 1e-9
"""Multipliers and violations below this are rounding."""


class ActiveSetScratch(NamedTuple):
    """Pointers to the scratch of a solver of tasks. Of velocities, scaled: the step, where it
    stops, the wish.
    """

    step: object
    stop: object
    """Where a coordinate stops at a limit its step, NaN for free ones."""
    wish: object
    mark: object
    way: object
    """A step that is kept."""
    value: object
    """Of rows, from here on: the equations before their bounds."""
    low: object
    high: object
    weak: object
    """The D of each row where it counts."""
    damp: object
    """The D of each row now."""
    y: object
    ahead: object
    """What the step makes of each row."""
    column: object
    a: object
    home: object
    """Configurations: where the search starts, six to keep, and where the last stage leads."""
    kept: object
    best: object
    trial: object
    rest: object
    aside: object
    goal: object
    held: object


@device
def compute_step_to_limit(loops, v, end):
    """Return the scaled step of coordinate v to its lower (1) or upper (2) limit."""
    return (
        read_velocity_number(loops, end, v) - loops.q[find_place(loops, v)]
    ) / read_velocity_number(loops, 0, v)


@routine
def mark_pushed_coordinates(loops, work):
    """Stop the coordinates at a limit that the gradient pushes outwards, for a step of least
    squares.
    """
    for i in range(loops.plan[L.N_ROWS]):
        work.y[i] = loops.error[i] if work.damp[i] < OFF else 0.0
    for v in range(loops.nv):
        work.stop[v] = np.nan
        if read_sort(loops, v) < L.BALL_FIRST:
            x = loops.q[find_place(loops, v)]
            if x <= read_velocity_number(loops, 1, v) or x >= read_velocity_number(loops, 2, v):
                push = -multiply_column(loops, v, work.y)
                if (x <= read_velocity_number(loops, 1, v) and push <= 0.0) or (
                    x >= read_velocity_number(loops, 2, v) and push >= 0.0
                ):
                    work.stop[v] = 0.0


@routine
def free_coordinates(loops, work):
    """Let all coordinates move."""
    for v in range(loops.nv):
        work.stop[v] = np.nan


@routine
def solve_step(loops, work):
    """Write y and the step for the stopped coordinates and the rows that count now."""
    plan = loops.plan
    m = plan[L.N_ROWS]
    for i in range(m):
        work.y[i] = loops.error[i] if work.damp[i] < OFF else 0.0
    for v in range(loops.nv):
        x = work.stop[v]
        work.mark[v] = np.nan if x == x else 0.0
        if x != x:
            x = work.wish[v]
        if x != 0.0:
            add_product(loops, v, x, work.y, 1)
    write_normal_matrix(loops, work.mark, 0.0, work.a, work.column)
    for i in range(m):
        if work.damp[i] >= OFF:
            work.y[i] = 0.0
        k = plan[L.AT_ROWS] + L.ENVELOPE_INTS * i
        work.a[plan[k + 1] + i - plan[k]] += work.damp[i]
    factor_envelope(loops, work.a, LEAST)
    solve_envelope(loops, work.a, work.y)
    for v in range(loops.nv):
        x = work.stop[v]
        work.step[v] = x if x == x else work.wish[v] - multiply_column(loops, v, work.y)


@routine
def stop_at_limits(loops, work):
    """Stop the coordinates that the step leads out of their limits; return whether there are any."""
    changed = False
    for v in range(loops.nv):
        if work.stop[v] == work.stop[v] or read_sort(loops, v) >= L.BALL_FIRST:
            continue
        low = compute_step_to_limit(loops, v, 1)
        high = compute_step_to_limit(loops, v, 2)
        if work.step[v] < low:
            work.stop[v] = low
            changed = True
        elif work.step[v] > high:
            work.stop[v] = high
            changed = True
    return changed


@routine
def update_counted_rows(loops, work, release):
    """Let rows between bounds that the step violates count (with `release`: drop rows that need not
    count); return whether any changed.
    """
    m = loops.plan[L.N_ROWS]
    changed = False
    for i in range(m):
        work.ahead[i] = 0.0
    for v in range(loops.nv):
        if work.step[v] != 0.0:
            add_product(loops, v, work.step[v], work.ahead, 1)
    for i in range(m):
        low = work.low[i]
        high = work.high[i]
        if low == high or work.weak[i] >= OFF:
            continue
        x = work.value[i] + work.ahead[i]
        if work.damp[i] >= OFF:
            if x < low - SLIP or x > high + SLIP:
                work.damp[i] = work.weak[i]
                loops.error[i] = work.value[i] - (low if x < low else high)
                changed = True
        elif release:
            to = work.value[i] - loops.error[i]  # the bound that it is led to
            if work.y[i] > SLIP if abs(to - low) < abs(to - high) else work.y[i] < -SLIP:
                work.damp[i] = OFF
                changed = True
    return changed


@routine
def release_coordinate(loops, work):
    """Release the stopped coordinate that the gradient pulls back inside most; return whether there
    is one.
    """
    worst = SLIP
    which = -1
    for v in range(loops.nv):
        x = work.stop[v]
        if x == x:
            slope = x - work.wish[v] + multiply_column(loops, v, work.y)
            low = compute_step_to_limit(loops, v, 1)
            high = compute_step_to_limit(loops, v, 2)
            pull = -slope if x <= low else slope
            if low < high and pull > worst:
                worst = pull
                which = v
    if which >= 0:
        work.stop[which] = np.nan
    return which >= 0


@routine
def write_step(loops, work, passes, between, exact):
    """Write the step; `between`: there are rows between bounds; `exact`: release coordinates that
    stop without need.
    """
    for _ in range(passes):
        solve_step(loops, work)
        changed = stop_at_limits(loops, work)
        if between and not changed:
            changed = update_counted_rows(loops, work, exact)
        if exact and not changed:
            changed = release_coordinate(loops, work)
        if not changed:
            break


@routine
def take_step(loops, work, longest):
    """Take the step, cut so that no angle turns by more than `longest`; return its size, in radians
    and characteristic lengths, and the part taken.
    """
    size = 0.0
    turn = 0.0
    for v in range(loops.nv):
        size = max(size, abs(work.step[v]))
        if read_sort(loops, v) != L.SLIDE:
            turn = max(turn, abs(work.step[v]))
    part = min(1.0, longest / max(turn, 1e-300))
    q = loops.q
    for v in range(loops.nv):
        work.step[v] *= part
    for v in range(loops.nv):
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        if sort == L.BALL_FIRST:
            turn_quaternion(q, i, work.step[v], work.step[v + 1], work.step[v + 2])
        elif sort != L.BALL_MORE:
            x = q[i] + work.step[v] * read_velocity_number(loops, 0, v)
            q[i] = min(max(x, read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v))
    return size, part


# ---- level rows

# What is required of ties, and how far it is missed: the rows of the solver of tasks
# (`task_search`).


RIGID = 1e-6
"""How far a rotation may be from one."""


class Ask(NamedTuple):
    """The requirements of the ties: pointers to their stage (-1: none), 1 if hard, weight, two
    tolerances.
    """

    given: object
    """Stages as they are given, then whether hard."""
    stage: object
    """The same now: a stage may be held before its turn, a soft one tried as a hard one."""
    hard: object
    weight: object
    tolerance: object
    stages: int
    between: bool
    """Whether rows between bounds are requested."""
    loose: bool
    """Whether the first start, too, may be moved as a whole: nobody requested it."""


@routine
def assess_equations(loops, work):
    """Write the equations, how far they are out of their bounds, and the Jacobian's blocks."""
    write_row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    fill_equations(loops, True)
    for i in range(loops.plan[L.N_ROWS]):
        g = loops.error[i]
        work.value[i] = g
        if not abs(g) < LARGEST:
            loops.error[i] = np.inf
        elif g < work.low[i]:
            loops.error[i] = g - work.low[i]
        elif g > work.high[i]:
            loops.error[i] = g - work.high[i]
        else:
            loops.error[i] = 0.0


@device
def square_tie_residual(loops, ask, k):
    """Return the weighted squared residual of a tie."""
    tie = loops.plan[L.AT_TIES] + L.TIE_INTS * k
    total = 0.0
    at = loops.plan[tie + L.FIRST_ROW]
    for i in range(at, at + loops.plan[tie + L.ROWS]):
        total += loops.error[i] * loops.error[i]
    return total * ask.weight[k]


@routine
def compute_squared_residual(loops, ask, first, last, hard_only):
    """Return the weighted squared residual of stages first to last."""
    total = 0.0
    for k in range(loops.plan[L.N_TIES]):
        if first <= ask.stage[k] <= last and not (hard_only and ask.hard[k] == 0):
            total += square_tie_residual(loops, ask, k)
    return total


@routine
def find_largest_miss(loops, ask, first, last):
    """Return the largest squared residual of a hard tie of these stages, as a part of its squared
    tolerance.
    """
    plan = loops.plan
    worst = 0.0
    for k in range(plan[L.N_TIES]):
        if ask.stage[k] < first or ask.stage[k] > last or ask.hard[k] == 0:
            continue
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        at = plan[tie + L.FIRST_ROW]
        lengths = plan[tie + L.LENGTHS]
        linear = angular = 0.0
        for i in range(plan[tie + L.ROWS]):
            x = loops.error[at + i]
            if i < lengths:
                linear += x * x
            else:
                angular += x * x
        a = ask.tolerance[2 * k]
        b = ask.tolerance[2 * k + 1]
        worst = max(worst, max(linear / (a * a), angular / (b * b)))
    return worst


@routine
def mark_counted_rows(loops, work, ask, stage, held, damping, hard_only):
    """Mark the rows that count: those of stages before `stage` with damping `held`, those of
    `stage` with `damping` by weight.
    """
    plan = loops.plan
    for k in range(plan[L.N_TIES]):
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        s = ask.stage[k]
        d = OFF
        if 0 <= s < stage and not (hard_only and ask.hard[k] == 0):
            d = held
        elif s == stage and damping < OFF:
            d = damping / ask.weight[k]
        at = plan[tie + L.FIRST_ROW]
        for i in range(at, at + plan[tie + L.ROWS]):
            work.weak[i] = d
            work.damp[i] = d if work.low[i] == work.high[i] or loops.error[i] != 0.0 else OFF


@routine
def restore_bounds(loops, work):
    """Write the given bounds of all rows."""
    plan = loops.plan
    for k in range(plan[L.N_TIES]):
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        at = plan[tie + L.FIRST_ROW]
        bound = plan[L.AT_BOUNDS] + plan[tie + L.BOUND]
        for i in range(plan[tie + L.ROWS]):
            work.low[at + i] = work.high[at + i] = 0.0
            if plan[tie + L.BOUND] >= 0:
                work.low[at + i] = loops.weights[bound + 2 * i]
                work.high[at + i] = loops.weights[bound + 2 * i + 1]


@routine
def freeze_stage(loops, work, ask, stage):
    """Hold the present values of a stage from now on: its residual becomes zero."""
    plan = loops.plan
    for k in range(plan[L.N_TIES]):
        if ask.stage[k] == stage:
            tie = plan[L.AT_TIES] + L.TIE_INTS * k
            at = plan[tie + L.FIRST_ROW]
            for i in range(at, at + plan[tie + L.ROWS]):
                if work.low[i] == work.high[i] or loops.error[i] != 0.0:
                    work.low[i] = work.high[i] = work.value[i]
                    loops.error[i] = 0.0


@routine
def is_hard(loops, ask, stage):
    """Return whether a stage is hard: it must be met, not only minimised."""
    for k in range(loops.plan[L.N_TIES]):
        if ask.stage[k] == stage:
            return ask.hard[k] != 0
    return False


@routine
def is_rigid(pin, k):
    """Return whether the 3x4 pose at pin[k:] has a rotation: rows of length one, the third the
    product of the others.
    """
    a = pin[k]
    b = pin[k + 1]
    c = pin[k + 2]
    d = pin[k + 4]
    e = pin[k + 5]
    f = pin[k + 6]
    x = b * f - c * e - pin[k + 8]
    y = c * d - a * f - pin[k + 9]
    z = a * e - b * d - pin[k + 10]
    off = max(abs(a * a + b * b + c * c - 1.0), abs(d * d + e * e + f * f - 1.0))
    return max(off, max(abs(a * d + b * e + c * f), max(abs(x), max(abs(y), abs(z))))) <= RIGID


@routine
def restore_stages(loops, ask):
    """Restore the given stages, and which of them are hard."""
    ties = loops.plan[L.N_TIES]
    for k in range(ties):
        ask.stage[k], ask.hard[k] = ask.given[k], ask.given[ties + k]


@routine
def harden_stages(loops, ask, last):
    """Make the soft stages before the last hard one up to `last` hard; return whether there are
    any.
    """
    while last > 0 and not is_hard(loops, ask, last):
        last -= 1
    changed = False
    for k in range(loops.plan[L.N_TIES]):
        if 0 < ask.stage[k] < last and ask.hard[k] == 0:
            ask.hard[k] = 1
            changed = True
    return changed


@routine
def hold_later_stages(loops, ask, stage):
    """Hold the hard stages after this one together with the loops; return whether they are met at
    q.
    """
    changed = False
    for s in range(stage + 1, ask.stages + 1):
        if is_hard(loops, ask, s) and find_largest_miss(loops, ask, s, s) <= 1.0:
            changed = True
            for k in range(loops.plan[L.N_TIES]):
                if ask.stage[k] == s:
                    ask.stage[k] = 0
    return changed


# ---- lexicographic

# Tasks lowered one level at a time: closing what holds, the value of a level, and steps that lower
# it.
#
# Gauss-Newton in the null space of what holds, with a damping that is measured: the curvature along
# the last step that the squares leave out (Marquardt, 1963; Dennis, Gay and Welsch, 1981), for an
# aim
# the projected gradient (Luenberger, 1972).


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
def predict_residual(loops, work, part):
    """Predict by linear equations the squared residual of the rows that count after the fraction
    `part` of a step.

    After the whole step a residual is D y.
    """
    square = 0.0
    for i in range(loops.plan[L.N_ROWS]):
        if work.damp[i] < OFF:
            x = (1.0 - part) * loops.error[i] + part * work.damp[i] * work.y[i]
            square += x * x
    return square


@device
def is_straight_step(square, before, after):
    """Return whether a short step changed the squared residual from `before` to `square` nearly as
    predicted, to `after`.
    """
    first = math.sqrt(before)
    promised = math.sqrt(after)
    small = 0.5 * first < promised < (1.0 - LITTLE) * first
    return small and abs(math.sqrt(square) - promised) <= STRAIGHT * (first - promised)


@routine
def descend_stages(loops, work, ask, last, enough, limit):
    """Lower the residual of stages 0 to last from q; return the least squared residual, whether it
    is small enough, and the number of steps.

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
        assess_equations(loops, work)
        square = compute_squared_residual(loops, ask, 0, last, hard_only)
        if not square < LARGEST:
            break
        met = find_largest_miss(loops, ask, 0, last) <= 1.0 if hard_only else square <= enough
        if met and not good:
            good = True
            best = np.inf
            limit = min(limit, steps + MORE) if hard_only else steps
        if square < best and met == good:
            best = square
            copy_numbers(work.kept, loops.q, 0, loops.nq)
        elif good:
            break
        straight = is_straight_step(square, from_, to)
        longest, trust = (longest * LONGER, trust * TRUST) if straight else (LONGEST, 1.0)
        if square > WORTH * before and not straight:
            idle += 1
        else:
            idle = 0
            before = square
        if (good and square <= ROUNDING) or steps >= limit or idle >= STALL:
            break
        damping = trust * min(DAMPING * square, MOST_DAMPING) + 10.0 * LEAST
        mark_counted_rows(loops, work, ask, last + 1, damping, OFF, hard_only)
        mark_pushed_coordinates(loops, work)
        write_step(loops, work, PASSES, ask.between, False)
        _, part = take_step(loops, work, longest)
        from_ = square
        to = predict_residual(loops, work, part)
        steps += 1
    return best, good, steps


@routine
def solve_stages(loops, work, ask, last, enough, limit):
    """Lower the residual of stages 0 to last near q, and move q to the least found; return its
    squared residual.
    """
    square, _, _ = descend_stages(loops, work, ask, last, enough, limit)
    copy_numbers(loops.q, work.kept, 0, loops.nq)
    assess_equations(loops, work)
    return square


@routine
def write_aim_step(loops, work, mode, part):
    """Write a step (nv,) that lowers the aim of the last stage, scaled by `part`, to `wish`; return
    the aim's value at q.
    """
    if mode == AHEAD:
        far = compute_home_distance(loops, work.goal, work.wish)
        for v in range(loops.nv):
            work.wish[v] *= part
        return 0.5 * far
    call_address(mode, loops.q, work.ahead, work.wish, 1)
    for v in range(loops.nv):
        work.wish[v] *= -part
    return work.ahead[0]


@routine
def compute_slope(loops, work, ask, stage, mode, part):
    """Return the slope of a stage's squared residual, or of the aim, along the step, and its
    Gauss-Newton curvature.

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
def evaluate_stage(loops, work, ask, stage, mode, part):
    """Return the weighted squared residual of a stage, or the value of the aim."""
    return (
        compute_squared_residual(loops, ask, stage, stage, False)
        if mode == NOTHING
        else write_aim_step(loops, work, mode, part)
    )


@routine
def search_along_step(loops, work, ask, stage, bound, mode, part, best, slope, longest):
    """Search the least value along the step; return it, its curvature, and the factor of the step's
    length that a parabola suggests.

    Every trial is closed; one that is much too long or too short is made once more with the length
    of the parabola. `trial` is where the least is, `way` the first step. A trial counts where
    earlier stages are within the bound.
    """
    share = 1.0
    least = best
    curve = 0.0
    copy_numbers(work.way, work.step, 0, loops.nv)
    for trial in range(2):
        if trial == 1:
            copy_numbers(loops.q, work.best, 0, loops.nq)
            for v in range(loops.nv):
                work.step[v] = share * work.way[v]
            take_step(loops, work, FURTHEST * longest)
        _, held, _ = descend_stages(loops, work, ask, stage - 1, bound[0], CLOSING)
        held = held and find_largest_miss(loops, ask, 0, stage - 1) <= bound[1]
        found = evaluate_stage(loops, work, ask, stage, mode, part)
        if held and found < least:
            least = found
            copy_numbers(work.trial, loops.q, 0, loops.nq)
        if trial == 0 and held:
            curve = found - best - slope
            share = min(-0.5 * slope / curve, FURTHEST) if curve > 0.0 and slope < 0.0 else 1.0
        if 0.7 < share < 1.4:
            break
    return least, curve, share


@device
def choose_damping(loops, work, damping, extra, better):
    """Return the next damping: the curvature `extra` along `way`, bounded; larger after a failure."""
    size = 1e-300
    for v in range(loops.nv):
        size += work.way[v] * work.way[v]
    measured = extra / size
    if better:
        return max(min(max(measured, 0.1 * damping), 10.0 * damping), 1e-9)
    return max(8.0 * damping, min(measured, 100.0 * damping))


@routine
def compute_bounds(loops, work, ask, stage):
    """Return the squared residual and the largest part of a tolerance that the stages before this
    one may have, with q closed.
    """
    square = solve_stages(loops, work, ask, stage - 1, ROUNDING, CLOSING)
    return max(ROUNDING, 4.0 * square), max(1.0, find_largest_miss(loops, ask, 0, stage - 1))


@routine
def ease_stage(loops, work, ask, stage, bound, limit, mode, stop):
    """Number of steps that lower the residual of a stage (mode 0) or the aim, whether the time was
    up, and the value reached; moves q there and assesses it. Earlier stages stay within the bound.
    """
    copy_numbers(work.best, loops.q, 0, loops.nq)
    damping = 1e-3
    part = 1.0
    steps = 0
    idle = 0
    streak = 0
    late = False
    longest = LONGEST
    best = evaluate_stage(loops, work, ask, stage, mode, part)
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
        mark_counted_rows(
            loops, work, ask, stage, LEAST, damping if mode == NOTHING else OFF, False
        )
        if mode != NOTHING:
            write_aim_step(loops, work, mode, part)
        free_coordinates(loops, work)
        write_step(loops, work, 4 + loops.nv, ask.between, True)
        size, _ = take_step(loops, work, longest)
        slope, bend = compute_slope(loops, work, ask, stage, mode, part)
        least, curve, share = search_along_step(
            loops, work, ask, stage, bound, mode, part, best, slope, longest
        )
        better = least < best
        fall = best - least
        longest = longest * LONGER if better and share >= FURTHEST else LONGEST
        if not better or fall > CLEAR * abs(best):
            damping = choose_damping(loops, work, damping, curve - bend, better)
        if better:
            idle = idle + 1 if fall <= flat * abs(best) else 0
            best = least
            copy_numbers(work.best, work.trial, 0, loops.nq)
            if streak >= 0:  # a length that has just been found too large is kept for a while
                part = min(2.0 * part, 1.0 if mode == AHEAD else 1e3)
            streak += 1
        else:
            part = 0.3 * part
            streak = -STREAK
        lost = not better and mode == NOTHING and -slope <= flat * abs(best)
        if idle >= 2 or lost or size < 1e-10 or damping > 1e4 or part < 1e-9:
            break
        copy_numbers(loops.q, work.best, 0, loops.nq)
        assess_equations(loops, work)
    copy_numbers(loops.q, work.best, 0, loops.nq)
    solve_stages(loops, work, ask, stage - 1, ROUNDING, MORE)
    return steps, late, evaluate_stage(loops, work, ask, stage, mode, part)


@routine
def nudge_unknowns(loops, key):
    """Move all unknowns of q by a small random step."""
    for v in range(loops.nv):
        if is_held(loops, v):
            continue
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        x = NUDGE * (2.0 * to_unit_interval(mix_bits(key, np.uint64(v))) - 1.0)
        if sort == L.BALL_FIRST:
            turn_quaternion(loops.q, i, x, 0.7 * x, -0.4 * x)
        elif sort != L.BALL_MORE:
            x = loops.q[i] + x * read_velocity_number(loops, 0, v)
            loops.q[i] = min(
                max(x, read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v)
            )


@routine
def lower_stage(loops, work, ask, stage, limit, mode, stop):
    """Lower the residual of a stage as `ease_stage` does, and leave saddles and maxima; return the
    number of steps, and whether the time was up.

    Where the gradient vanishes and the error does not, a small push and a few steps show whether q
    is one. The bound is that before the push: where the earlier stages cannot be closed as they
    were, there is no way down.
    """
    bound = compute_bounds(loops, work, ask, stage)
    steps, late, best = ease_stage(loops, work, ask, stage, bound, limit, mode, stop)
    if mode == NOTHING and not late and best > TIGHT and steps < limit:
        copy_numbers(work.rest, loops.q, 0, loops.nq)
        nudge_unknowns(loops, mix_bits(np.uint64(0), np.uint64(stage)))
        used = 0
        least = np.inf
        if solve_stages(loops, work, ask, stage - 1, bound[0], LONG) <= bound[0]:
            used, late, least = ease_stage(
                loops, work, ask, stage, bound, min(PROBE, limit - steps), mode, stop
            )
        steps += used
        if least < (1.0 - SADDLE) * best:
            used, late, best = ease_stage(loops, work, ask, stage, bound, limit - steps, mode, stop)
            steps += used
        else:
            copy_numbers(loops.q, work.rest, 0, loops.nq)
            assess_equations(loops, work)
    return steps, late


# ---- base fit

# A free base moved as a whole so that the frames which tasks hold come as near to their goals as
# they can together.


SQUARINGS = 26
"""Squarings that leave of a matrix the projection on the eigenvectors of its largest eigenvalue."""
FAINT = 1e-6
"""Square of a projection of length one at most from which on it counts."""


@device
def is_base_tie(loops, ask, k, ball):
    """Return whether tie k holds the position of a frame that the base moves against the ground, in
    a stage of its own.
    """
    plan = loops.plan
    ints = loops.ints
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    outputs = HEADER + ROW_INTS * loops.n_rows + OUTPUT_INTS * 2 * k
    turns = plan[tie + L.TURNS]
    if ask.stage[k] < 1 or plan[tie + L.PIN] < 0 or plan[tie + L.MASK] != 7 or ints[outputs] >= 0:
        return False
    if (
        (turns != L.FULL and turns != L.NO_TURN)
        or plan[tie + L.BOUND] >= 0
        or plan[tie + L.CENTRE] >= 0
    ):
        return False
    row = ints[outputs + OUTPUT_INTS]
    while row > ball:
        row = ints[HEADER + ROW_INTS * row + PARENT]
    return row == ball


@device
def square_matrix(m):
    """Return the square of a symmetric 4x4 matrix (ten numbers, row by row from the diagonal on),
    divided by its trace.
    """
    a, b, c, d, e, f, g, h, i, j = m
    p = a * a + b * b + c * c + d * d
    q = b * b + e * e + f * f + g * g
    r = c * c + f * f + h * h + i * i
    s = d * d + g * g + i * i + j * j
    n = 1.0 / max(p + q + r + s, 1e-300)
    return (
        p * n,
        (a * b + b * e + c * f + d * g) * n,
        (a * c + b * f + c * h + d * i) * n,
        (a * d + b * g + c * i + d * j) * n,
        q * n,
        (b * c + e * f + f * h + g * i) * n,
        (b * d + e * g + f * i + g * j) * n,
        r * n,
        (c * d + f * g + h * i + i * j) * n,
        s * n,
    )


@routine
def find_best_rotation(h):
    """Return the unit quaternion of the rotation D for which tr(D H) is largest, H row by row
    (Horn, 1987).

    Where many are as good, the one nearest to no rotation.
    """
    a, b, c, d, e, f, g, i, j = h  # of D x ~ y, H is the sum of all x y^T
    size = 1e-30
    for x in h:
        size += 2.0 * abs(x)
    m = (
        size + a + e + j,
        f - i,
        g - c,
        b - d,
        size + a - e - j,
        b + d,
        c + g,
        size + e - a - j,
        f + i,
        size + j - a - e,
    )
    for _ in range(SQUARINGS):
        m = square_matrix(m)
    if m[0] > FAINT:
        w = m[0]
        x = m[1]
        y = m[2]
        z = m[3]
    elif m[4] >= m[7] and m[4] >= m[9]:
        w = m[1]
        x = m[4]
        y = m[5]
        z = m[6]
    elif m[7] >= m[9]:
        w = m[2]
        x = m[5]
        y = m[7]
        z = m[8]
    else:
        w = m[3]
        x = m[6]
        y = m[8]
        z = m[9]
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * n, x * n, y * n, z * n


@routine
def sum_frame_positions(loops, ask, ball, hard):
    """Sum over the frames that count: their number, their positions, their targets, and the matrix
    of `find_best_rotation`.

    Places are measured from the first frame and its goal, which are returned, too.
    """
    count = 0
    first = (0.0, 0.0, 0.0)
    aim = (0.0, 0.0, 0.0)
    p = (0.0, 0.0, 0.0)
    g = (0.0, 0.0, 0.0)
    h = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    square = loops.weights[L.LENGTH] * loops.weights[L.LENGTH]
    for k in range(loops.plan[L.N_TIES]):
        if (ask.hard[k] != 0) != hard or not is_base_tie(loops, ask, k, ball):
            continue
        r_a, p_a, r_b, p_b = read_tie_ends(loops, k)
        if count == 0:
            first = p_b
            aim = p_a
        x = (p_b[0] - first[0], p_b[1] - first[1], p_b[2] - first[2])
        y = (p_a[0] - aim[0], p_a[1] - aim[1], p_a[2] - aim[2])
        count += 1
        p = (p[0] + x[0], p[1] + x[1], p[2] + x[2])
        g = (g[0] + y[0], g[1] + y[1], g[2] + y[2])
        t = (
            square
            if loops.plan[loops.plan[L.AT_TIES] + L.TIE_INTS * k + L.TURNS] == L.FULL
            else 0.0
        )
        h = (
            h[0] + x[0] * y[0] + t * (r_b[0] * r_a[0] + r_b[1] * r_a[1] + r_b[2] * r_a[2]),
            h[1] + x[0] * y[1] + t * (r_b[0] * r_a[3] + r_b[1] * r_a[4] + r_b[2] * r_a[5]),
            h[2] + x[0] * y[2] + t * (r_b[0] * r_a[6] + r_b[1] * r_a[7] + r_b[2] * r_a[8]),
            h[3] + x[1] * y[0] + t * (r_b[3] * r_a[0] + r_b[4] * r_a[1] + r_b[5] * r_a[2]),
            h[4] + x[1] * y[1] + t * (r_b[3] * r_a[3] + r_b[4] * r_a[4] + r_b[5] * r_a[5]),
            h[5] + x[1] * y[2] + t * (r_b[3] * r_a[6] + r_b[4] * r_a[7] + r_b[5] * r_a[8]),
            h[6] + x[2] * y[0] + t * (r_b[6] * r_a[0] + r_b[7] * r_a[1] + r_b[8] * r_a[2]),
            h[7] + x[2] * y[1] + t * (r_b[6] * r_a[3] + r_b[7] * r_a[4] + r_b[8] * r_a[5]),
            h[8] + x[2] * y[2] + t * (r_b[6] * r_a[6] + r_b[7] * r_a[7] + r_b[8] * r_a[8]),
        )
    n = 1.0 / max(count, 1)
    p = (p[0] * n, p[1] * n, p[2] * n)
    g = (g[0] * n, g[1] * n, g[2] * n)
    c = float(count)
    h = (h[0] - c * p[0] * g[0], h[1] - c * p[0] * g[1], h[2] - c * p[0] * g[2], h[3] - c * p[1] * g[0],
         h[4] - c * p[1] * g[1], h[5] - c * p[1] * g[2], h[6] - c * p[2] * g[0], h[7] - c * p[2] * g[1],
         h[8] - c * p[2] * g[2])  # fmt: skip
    p = (p[0] + first[0], p[1] + first[1], p[2] + first[2])
    return count, p, (g[0] + aim[0], g[1] + aim[1], g[2] + aim[2]), h


@routine
def fit_base(loops, ask):
    """Move a free base so that the frames of tasks are nearest to their targets, with the other
    joints as they are.

    Least is the sum of squares of distances and, by the characteristic length, of rotation matrices
    (Kabsch, 1976). Soft tasks count where no hard one holds a frame.
    """
    plan = loops.plan
    q = loops.q
    row = loops.plan[L.BASE_ROW]
    if plan[L.BASE_TIE] < 0:
        return
    write_row_poses(loops.ints, loops.floats, q, 0, loops.scratch)
    count, p, g, h = sum_frame_positions(loops, ask, row + 3, True)
    if count == 0:
        count, p, g, h = sum_frame_positions(loops, ask, row + 3, False)
    if count == 0:
        return
    w, x, y, z = find_best_rotation(h)
    a, b, c = read_placement(loops.poses, OUTPUT_FLOATS * (row + 3))
    sine = math.sqrt(x * x + y * y + z * z)
    f = 2.0 * math.atan2(sine, w) / max(sine, 1e-300)
    turn = rotate_vector_back(pack_rotation(a, b, c), f * x, f * y, f * z)  # in axes of the base
    turn_quaternion(
        q, loops.ints[HEADER + ROW_INTS * (row + 3) + Q_INDEX], turn[0], turn[1], turn[2]
    )
    o = (extract_entry(a, 3) - p[0], extract_entry(b, 3) - p[1], extract_entry(c, 3) - p[2])
    u = (2.0 * (y * o[2] - z * o[1]), 2.0 * (z * o[0] - x * o[2]), 2.0 * (x * o[1] - y * o[0]))
    d = (
        g[0] - p[0] + w * u[0] + y * u[2] - z * u[1],
        g[1] - p[1] + w * u[1] + z * u[0] - x * u[2],
        g[2] - p[2] + w * u[2] + x * u[1] - y * u[0],
    )
    for i in range(row, row + 3):
        a, b, c = read_placement(loops.poses, OUTPUT_FLOATS * i)
        at = loops.ints[HEADER + ROW_INTS * i + Q_INDEX]
        v = loops.ints[HEADER + ROW_INTS * i + V_INDEX]
        x = (
            q[at]
            + (extract_entry(a, 2) * d[0] + extract_entry(b, 2) * d[1] + extract_entry(c, 2) * d[2])
            / loops.floats[ROW_FLOATS * i + MULTIPLIER]
        )
        q[at] = min(max(x, read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v))


# ---- restarts

# Where the search for several tasks starts again: anywhere, or at what was found with a part of it
# drawn anew.
#
# A bundle is met once all its tasks are, each with a chance of its own at every start. Drawing all
# anew multiplies these chances. Keeping what meets some tasks, and drawing only what moves the
# others, adds up their waiting times instead.


NEAR = 0.6
"""Part of the ranges, about the first start and about their middles in turn, from which the first
starts are drawn: what is far from all limits leads to more answers."""
PLAIN = 8
WIDE = 1.35
WIDER = 2.0
"""Starts that are drawn so. Of those after them, of four one is drawn from all of the ranges, one
WIDE and two WIDER times as far about the middle and cut off at the limits, which puts a quarter and
a half of the coordinates there: what is left by then are mostly answers at limits."""
RESTARTS_AGAIN = 6
RESTARTS_LOWER = 0.99
"""Starts that begin at what another has reached, after the last that came to less than this part of
its square."""
NEARLY = 1e-3
"""Part of the largest square that a tie misses, up to which another one is as good as met."""
PART = 0.5
"""The largest part of the unknowns, on average, that is drawn anew where no task tells which."""
SALT = np.uint64(0x5EED)
"""What the numbers that choose a part are drawn with, beside those of the start."""


@routine
def write_middle(loops, home, to):
    """Write the configuration in the middle of all ranges to `to`; balls and held coordinates as at
    `home`.
    """
    copy_numbers(to, home, 0, loops.nq)
    for v in range(loops.nv):
        if read_sort(loops, v) < L.BALL_FIRST and not is_held(loops, v):
            to[find_place(loops, v)] = 0.5 * (
                read_velocity_number(loops, 3, v) + read_velocity_number(loops, 4, v)
            )


@routine
def set_start(loops, work, ask, key, count):
    """Set q to start `count`; `trial` is the middle."""
    copy_numbers(loops.q, work.home, 0, loops.nq)
    fresh = mix_bits(key, np.uint64(count))
    if 0 < count < PLAIN:
        draw_configuration(loops, work.trial if count % 2 else work.home, NEAR, fresh)
    elif count > 0:
        draw_configuration(loops, work.trial, 1.0, fresh)
        if count % 4 > 0:
            push_coordinates_away(loops, work.trial, WIDE if count % 4 == 1 else WIDER)
    if count > 0 or ask.loose:
        fit_base(loops, ask)


@routine
def push_coordinates_away(loops, about, far):
    """Move the coordinates of q away from `about`, to `far` times the distance; they stop at their
    limits.
    """
    for v in range(loops.nv):
        if not is_held(loops, v) and read_sort(loops, v) < L.BALL_FIRST:
            i = find_place(loops, v)
            x = about[i] + far * (loops.q[i] - about[i])
            loops.q[i] = min(
                max(x, read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v)
            )


@routine
def set_partial_start(loops, work, ask, last, key, count):
    """Set q to start `count`; where only some tasks are missed, only the coordinates that move
    these change from `rest`.

    In turns: all is kept that moves a tie which is met; all that moves another than the worst; any
    part.
    """
    set_start(loops, work, ask, key, count)
    copy_numbers(work.aside, loops.q, 0, loops.nq)
    copy_numbers(loops.q, work.rest, 0, loops.nq)
    assess_equations(loops, work)
    if count % 3 == 2 or not mark_separate_unknowns(loops, work, ask, last, count % 3 == 0):
        fresh = mix_bits(mix_bits(key, np.uint64(count)), SALT)
        share = PART * to_unit_interval(mix_bits(fresh, np.uint64(loops.nv)))
        for v in range(loops.nv):
            work.way[v] = 1.0 if to_unit_interval(mix_bits(fresh, np.uint64(v))) < share else 0.0
    for v in range(loops.nv):
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        if work.way[v] != 0.0 and not is_held(loops, v):
            if sort == L.BALL_FIRST:
                copy_numbers(advance_pointer(loops.q, i), work.aside, i, 4)
            elif sort != L.BALL_MORE:
                loops.q[i] = work.aside[i]


@routine
def mark_separate_unknowns(loops, work, ask, last, all_missed):
    """Mark in `way` the unknowns that move only missed ties, all or the worst; return whether there
    are such unknowns, and others.

    The equations must be those of q. Rows between bounds keep nothing.
    """
    plan = loops.plan
    worst = 0.0
    which = -1
    for k in range(plan[L.N_TIES]):
        if 0 <= ask.stage[k] <= last and ask.hard[k] != 0:
            square = square_tie_residual(loops, ask, k)
            if square > worst:
                worst = square
                which = k
    own = False
    kept = False
    for v in range(loops.nv):
        work.way[v] = 0.0
        if is_held(loops, v):
            continue
        at = plan[L.AT_VARS] + v
        moves = False
        keeps = False
        for use in range(plan[at], plan[at + 1]):
            k = plan[plan[L.AT_USES] + L.USE_INTS * use]
            if not 0 <= ask.stage[k] <= last or ask.hard[k] == 0:
                continue
            if k == which or (all_missed and square_tie_residual(loops, ask, k) > NEARLY * worst):
                moves = True
            elif plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND] < 0:
                keeps = True
        if moves and not keeps:
            work.way[v] = 1.0
            own = True
        kept = kept or keeps
    return own and kept


AGAIN = 5
LOWER = 0.99
"""Starts of a first stage that is soft, and the part of its square below which another than the
first one counts."""
GAIN = 1e-6
"""Part of what a soft stage misses that a hard one behind it must cost before it is let go."""


@routine
def search_stages(loops, work, ask, last, key, tries, limit, stop):
    """Search a configuration that meets the hard stages up to `last`; return whether it is met,
    whether the time was up, steps and starts.
    """
    best = np.inf
    count = 0
    steps = 0
    good = False
    late = False
    left = 0
    least = np.inf
    write_middle(loops, work.home, work.trial)
    while count < tries and not good:
        late = is_late(loops, stop, work.ahead, work.wish)
        if late:
            break
        if left > 0:
            set_partial_start(loops, work, ask, last, key, count)
        else:
            set_start(loops, work, ask, key, count)
        square, good, used = descend_stages(loops, work, ask, last, 0.0, limit)
        steps = steps + used
        count = count + 1
        if square < best or good:
            best = square
            copy_numbers(work.best, work.kept, 0, loops.nq)
        if left == 0 or square < RESTARTS_LOWER * least:
            left = RESTARTS_AGAIN if count >= PLAIN and square < LARGEST else 0
            least = square
            copy_numbers(work.rest, work.kept, 0, loops.nq)
        else:
            left -= 1
    copy_numbers(loops.q, work.best if best < np.inf else work.home, 0, loops.nq)
    return good, late, steps, count


@routine
def search_last_stage(loops, work, ask, key, tries, limit, stop):
    """Search how many stages can be met together; return the last of them, whether the time was up,
    steps and starts. q meets them.

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
            if not (good or late) and (softly == 1 or harden_stages(loops, ask, last)):
                good, late, used, count = search_stages(
                    loops, work, ask, last, key, tries, limit, stop
                )
                steps = steps + used
                most = max(most, count)
            restore_stages(loops, ask)
        if not good:
            last -= 1
            while last > 0 and not is_hard(loops, ask, last):
                last -= 1
    assess_equations(loops, work)
    return last, late, steps, most


@routine
def lower_holding_stages(loops, work, ask, stage, limit, mode, stop):
    """Lower a stage as `lower_stage` does; for half of the steps, later hard stages are held where
    that costs nothing.
    """
    if mode != NOTHING or is_hard(loops, ask, stage) or not hold_later_stages(loops, ask, stage):
        return lower_stage(loops, work, ask, stage, limit, mode, stop)
    steps, late = lower_stage(loops, work, ask, stage, limit // 2, mode, stop)
    restore_stages(loops, ask)
    least = compute_squared_residual(loops, ask, stage, stage, False)
    if least > TIGHT and not late:
        copy_numbers(work.aside, loops.q, 0, loops.nq)
        used, late = lower_stage(loops, work, ask, stage, limit - steps, mode, stop)
        steps += used
        if not compute_squared_residual(loops, ask, stage, stage, False) < (1.0 - GAIN) * least:
            copy_numbers(loops.q, work.aside, 0, loops.nq)
            assess_equations(loops, work)
    return steps, late


@routine
def lower_from_starts(loops, work, ask, key, tries, limit, stop):
    """Lower the first stage from several starts and keep the least; return steps, whether the time
    was up, and starts.
    """
    least = compute_squared_residual(loops, ask, 1, 1, False)
    steps = 0
    late = False
    count = 1
    part = 1.0 - GAIN if ask.loose else LOWER
    copy_numbers(work.aside, loops.q, 0, loops.nq)
    while count < min(tries, AGAIN) and not late and is_soft_stage_missed(loops, ask):
        write_middle(loops, work.home, work.trial)
        set_start(loops, work, ask, key, count)
        used, late = lower_stage(loops, work, ask, 1, limit, NOTHING, stop)
        steps = steps + used
        count = count + 1
        square = compute_squared_residual(loops, ask, 1, 1, False)
        if square < part * least and find_largest_miss(loops, ask, 0, 0) <= 1.0:
            least = square
            copy_numbers(work.aside, loops.q, 0, loops.nq)
        copy_numbers(loops.q, work.aside, 0, loops.nq)
        assess_equations(loops, work)
    return steps, late, count


@routine
def unwind_angles(loops, work, ask, stage):
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
            or read_sort(loops, v) != L.BOUND_TURN
        ):
            continue
        i = find_place(loops, v)
        x = q[i]
        y = choose_nearest_angle(q[i], read_given_number(loops, k))
        if (
            abs(x - y) < 1.0
            or y < read_velocity_number(loops, 1, v)
            or y > read_velocity_number(loops, 2, v)
        ):
            continue
        own = compute_squared_residual(loops, ask, stage, stage, False)
        before = compute_squared_residual(loops, ask, 0, stage - 1, False)
        q[i] = y
        assess_equations(loops, work)
        now = compute_squared_residual(loops, ask, stage, stage, False)
        if now > own or compute_squared_residual(loops, ask, 0, stage - 1, False) > before + TIGHT:
            q[i] = x
            assess_equations(loops, work)


@routine
def lead_angles_home(loops, work, ask):
    """Bring angles that a task holds near to the wanted value, by whole turns."""
    plan = loops.plan
    for k in range(plan[L.N_TIES]):
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        v = plan[tie + L.DATA]
        if ask.stage[k] > 0 and plan[tie + L.TURNS] == L.OWN and read_sort(loops, v) == L.CIRCLE:
            work.home[find_place(loops, v)] = read_given_number(loops, k)


@routine
def is_soft_stage_missed(loops, ask):
    """Return whether the first stage, which is soft, is missed by more than its tolerance."""
    for k in range(loops.plan[L.N_TIES]):
        ask.hard[k] = 1
    worst = find_largest_miss(loops, ask, 1, 1)
    restore_stages(loops, ask)
    return worst > 1.0


@routine
def search_tasks(loops, work, ask, key, tries, limit, mode, stop):
    """Search a configuration that fulfils the tasks; return (status, steps, starts). `loops.q` is
    start and answer.

    If none is found, `loops.q` is the nearest one. `ask` holds the tasks in stages: stage 0 are the
    loops, later ones yield to earlier ones. `tries` is the number of random starts, drawn by `key`;
    below 0, only the last stage is improved and the others keep the residuals of the start. `limit`
    is the number of steps of a start, `mode` what is minimised in the freedoms left (or NOTHING),
    `stop` the clock. `work` is scratch memory.
    """
    first = ask.stages if tries < 0 else 1
    restore_bounds(loops, work)
    restore_stages(loops, ask)
    last, late, steps, most = search_last_stage(loops, work, ask, key, tries, limit, stop)
    pinned = False
    for s in range(1, ask.stages + 1):
        pinned = pinned or is_hard(loops, ask, s)
    for s in range(1, ask.stages + (1 if mode == NOTHING else 2)):
        if late or not (
            s > last or not is_hard(loops, ask, s) or find_largest_miss(loops, ask, s, s) > 1.0
        ):
            continue
        if s >= first:
            copy_numbers(work.held, loops.q, 0, loops.nq)
            enough = 4.0 * compute_squared_residual(loops, ask, 0, s - 1, False)
            worst = find_largest_miss(loops, ask, 0, s - 1)
            if s <= ask.stages:
                unwind_angles(loops, work, ask, s)
            used, late = lower_holding_stages(
                loops, work, ask, s, 4 * limit, mode if s > ask.stages else NOTHING, stop
            )
            steps += used
            if s == 1 and s <= ask.stages and not (pinned or late):
                used, late, count = lower_from_starts(loops, work, ask, key, tries, 4 * limit, stop)
                steps = steps + used
                most = max(most, count)
            lost = not compute_squared_residual(loops, ask, 0, s - 1, False) <= max(
                enough, ROUNDING
            )
            if lost or find_largest_miss(loops, ask, 0, s - 1) > max(worst, 1.0):
                copy_numbers(loops.q, work.held, 0, loops.nq)
                assess_equations(loops, work)
        freeze_stage(loops, work, ask, s)
    restore_bounds(loops, work)
    assess_equations(loops, work)
    if mode == NOTHING:
        lead_angles_home(loops, work, ask)
    write_cut_coordinates(loops, work.home)
    if loops.plan[L.N_READINGS] > 0:
        assess_equations(loops, work)
    good = find_largest_miss(loops, ask, 0, ask.stages) <= 1.0
    return (SOLVED if good else NOT_FOUND) + (LATE if late else 0), steps, most


@device
def count_search_floats(plan, n_rows, nq, nv):
    """Return the number of floats of scratch of the search."""
    m = plan[L.N_ROWS]
    return (
        count_sweep_scratch(n_rows)
        + 9 * nq
        + 5 * nv
        + 9 * m
        + 3 * plan[L.N_TIES]
        + plan[L.BLOCKS]
        + plan[L.ENVELOPE]
        + 8
    )


@device
def divide_search_scratch(plan, scratch, n_rows, nq, nv):
    """Divide scratch among the parts of the search: pointers to q, the equations, the weights of
    ties and the Jacobian's blocks, and the scratch of the active set.
    """
    m = plan[L.N_ROWS]
    q = advance_pointer(scratch, count_sweep_scratch(n_rows))
    v = advance_pointer(q, 9 * nq)
    rows = advance_pointer(v, 5 * nv)
    weight = advance_pointer(rows, 9 * m)
    blocks = advance_pointer(weight, 3 * plan[L.N_TIES])
    work = ActiveSetScratch(
        v,
        advance_pointer(v, nv),
        advance_pointer(v, 2 * nv),
        advance_pointer(v, 3 * nv),
        advance_pointer(v, 4 * nv),
        advance_pointer(rows, m),
        advance_pointer(rows, 2 * m),
        advance_pointer(rows, 3 * m),
        advance_pointer(rows, 4 * m),
        advance_pointer(rows, 5 * m),
        advance_pointer(rows, 6 * m),
        advance_pointer(rows, 7 * m),
        advance_pointer(rows, 8 * m),
        advance_pointer(blocks, plan[L.BLOCKS]),
        advance_pointer(q, nq),
        advance_pointer(q, 2 * nq),
        advance_pointer(q, 3 * nq),
        advance_pointer(q, 4 * nq),
        advance_pointer(q, 5 * nq),
        advance_pointer(q, 6 * nq),
        advance_pointer(q, 7 * nq),
        advance_pointer(q, 8 * nq),
    )
    return q, rows, weight, blocks, work


@device
def make_ask(plan, stages, strengths, weight, now, loose):
    """Make the requirements of the ties from pointers to their `stages` and `strengths`.

    weight: scratch of 3 numbers a tie; now: of 2 whole numbers a tie.
    """
    ties = plan[L.N_TIES]
    last = 0
    between = False
    for k in range(ties):
        weight[k] = strengths[3 * k]
        weight[ties + 2 * k] = strengths[3 * k + 1]
        weight[ties + 2 * k + 1] = strengths[3 * k + 2]
        last = max(last, stages[k])
        between = between or (
            stages[k] >= 0 and plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND] >= 0
        )
    return Ask(
        stages,
        now,
        advance_pointer(now, ties),
        weight,
        advance_pointer(weight, ties),
        last,
        between,
        loose,
    )


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
def solve_tasks(
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
    """Solve all problems; return the number of problems whose hard tasks are not met.

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
    block = np.empty(count_search_floats(plan, n_rows, nq, nv))
    scratch = get_pointer(block)
    q, rows, weight, blocks, work = divide_search_scratch(
        get_pointer(plan), scratch, n_rows, nq, nv
    )
    now = np.empty(2 * plan[L.N_TIES], dtype=np.int64)
    ask = make_ask(
        get_pointer(plan),
        get_pointer(stages),
        get_pointer(strengths),
        weight,
        get_pointer(now),
        loose,
    )
    missing = 0
    for i in range(out_q.shape[0]):
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
            rows,
            blocks,
            n_rows,
            nq,
            nv,
        )
        copy_numbers(
            q, advance_pointer(get_pointer(starts), i * nq if starts.shape[0] > 1 else 0), 0, nq
        )
        copy_numbers(
            work.goal,
            advance_pointer(get_pointer(goals), i * nq if goals.shape[0] > 1 else 0),
            0,
            nq,
        )
        status = BAD_INPUT
        steps = 0
        count = 0
        fine = prepare_start(loops, work.home)
        for j in range(pins.shape[1]):
            fine = fine and abs(pin[j]) < LARGEST
        for j in range(plan[L.N_PINS]):
            fine = fine and is_rigid(pin, 12 * j)
        if fine:
            key = mix_bits(np.uint64(0), np.uint64(seed))
            status, steps, count = search_tasks(loops, work, ask, key, tries, limit, mode, stop)
        for k in range(nq):
            out_q[i, k] = q[k] if fine else math.nan
        info[i, 0] = status
        info[i, 1] = steps
        info[i, 2] = count
        missing += int(status % LATE != SOLVED)
    keep_alive(block)
    keep_alive(now)
    return missing
