"""One step under held rows, rows to be lowered and bounds: a small quadratic programme by an active
set.

The step d minimises |d - t|^2 / 2 + sum (J_i d + e_i)^2 / (2 D_i), t being a wished step: rows with
a D next to nothing hold, those with a larger one are damped least squares. With the set of
coordinates that stop at their limits, d = t - J^T y for the others and (J J^T + D) y = e + J d of
those that stop and of t. Rows between bounds count where they are violated or the step would
violate them (Nocedal and Wright, 2006, section 16.5).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.rotations import turn_ball
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.envelope import add_product, factor, normal, product, solve
from kempe.kernels.constraints.loop_coordinates import number, place_of, sort_of

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
def room(loops, v, end):
    """The scaled step of coordinate v to its lower (1) or upper (2) limit."""
    return (number(loops, end, v) - loops.q[place_of(loops, v)]) / number(loops, 0, v)


@routine
def mark_pushed(loops, work):
    """Stop, for a step of least squares, the coordinates at a limit that the gradient pushes
    outwards.
    """
    for i in range(loops.plan[L.N_ROWS]):
        work.y[i] = loops.error[i] if work.damp[i] < OFF else 0.0
    for v in range(loops.nv):
        work.stop[v] = np.nan
        if sort_of(loops, v) < L.BALL_FIRST:
            x = loops.q[place_of(loops, v)]
            if x <= number(loops, 1, v) or x >= number(loops, 2, v):
                push = -product(loops, v, work.y)
                if (x <= number(loops, 1, v) and push <= 0.0) or (
                    x >= number(loops, 2, v) and push >= 0.0
                ):
                    work.stop[v] = 0.0


@routine
def free_all(loops, work):
    """Stop no coordinate."""
    for v in range(loops.nv):
        work.stop[v] = np.nan


@routine
def solve_once(loops, work):
    """Write y and the step for the coordinates that stop and the rows that count now."""
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
    normal(loops, work.mark, 0.0, work.a, work.column)
    for i in range(m):
        if work.damp[i] >= OFF:
            work.y[i] = 0.0
        k = plan[L.AT_ROWS] + L.ENVELOPE_INTS * i
        work.a[plan[k + 1] + i - plan[k]] += work.damp[i]
    factor(loops, work.a, LEAST)
    solve(loops, work.a, work.y)
    for v in range(loops.nv):
        x = work.stop[v]
        work.step[v] = x if x == x else work.wish[v] - product(loops, v, work.y)


@routine
def stop_at_limits(loops, work):
    """Whether the step leads out of limits; stops the coordinates that it leads out."""
    changed = False
    for v in range(loops.nv):
        if work.stop[v] == work.stop[v] or sort_of(loops, v) >= L.BALL_FIRST:
            continue
        low = room(loops, v, 1)
        high = room(loops, v, 2)
        if work.step[v] < low:
            work.stop[v] = low
            changed = True
        elif work.step[v] > high:
            work.stop[v] = high
            changed = True
    return changed


@routine
def count_rows(loops, work, release):
    """Whether rows between bounds that did not count must, or with `release` the other way round;
    changes that.
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
def let_go(loops, work):
    """Whether a coordinate stops though it would rather go back inside; lets the one go that wants
    to most.
    """
    worst = SLIP
    which = -1
    for v in range(loops.nv):
        x = work.stop[v]
        if x == x:
            slope = x - work.wish[v] + product(loops, v, work.y)
            low = room(loops, v, 1)
            high = room(loops, v, 2)
            pull = -slope if x <= low else slope
            if low < high and pull > worst:
                worst = pull
                which = v
    if which >= 0:
        work.stop[which] = np.nan
    return which >= 0


@routine
def step_to(loops, work, passes, between, exact):
    """Write the step; `between`: there are rows between bounds; `exact`: also let go of what stops
    without need.
    """
    for _ in range(passes):
        solve_once(loops, work)
        changed = stop_at_limits(loops, work)
        if between and not changed:
            changed = count_rows(loops, work, exact)
        if exact and not changed:
            changed = let_go(loops, work)
        if not changed:
            break


@routine
def take(loops, work, longest):
    """Size of the step, in radians and characteristic lengths, and which part of it is taken: turns
    up to `longest`.
    """
    size = 0.0
    turn = 0.0
    for v in range(loops.nv):
        size = max(size, abs(work.step[v]))
        if sort_of(loops, v) != L.SLIDE:
            turn = max(turn, abs(work.step[v]))
    part = min(1.0, longest / max(turn, 1e-300))
    q = loops.q
    for v in range(loops.nv):
        work.step[v] *= part
    for v in range(loops.nv):
        sort = sort_of(loops, v)
        i = place_of(loops, v)
        if sort == L.BALL_FIRST:
            turn_ball(q, i, work.step[v], work.step[v + 1], work.step[v + 2])
        elif sort != L.BALL_MORE:
            x = q[i] + work.step[v] * number(loops, 0, v)
            q[i] = min(max(x, number(loops, 1, v)), number(loops, 2, v))
    return size, part
