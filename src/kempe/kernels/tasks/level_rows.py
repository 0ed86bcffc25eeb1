"""What is required of ties, and how far it is missed: the rows of the solver of tasks
(`task_search`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.search_layout import LARGEST
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.goals import fill
from kempe.kernels.forward.table_rows import row_poses
from kempe.kernels.tasks.active_set import OFF

RIGID = 1e-6
"""How far a rotation may be from one."""


class Ask(NamedTuple):
    """What is required of the ties: pointers to their stage (-1: nothing), 1 if hard, weight, two
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
def assess(loops, work):
    """Write the equations, how far they are out of their bounds, and the Jacobian's blocks."""
    row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    fill(loops, True)
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
def square_of_tie(loops, ask, k):
    """Weighted squared residual of a tie."""
    tie = loops.plan[L.AT_TIES] + L.TIE_INTS * k
    total = 0.0
    at = loops.plan[tie + L.FIRST_ROW]
    for i in range(at, at + loops.plan[tie + L.ROWS]):
        total += loops.error[i] * loops.error[i]
    return total * ask.weight[k]


@routine
def square_of(loops, ask, first, last, hard_only):
    """Weighted squared residual of stages first to last."""
    total = 0.0
    for k in range(loops.plan[L.N_TIES]):
        if first <= ask.stage[k] <= last and not (hard_only and ask.hard[k] == 0):
            total += square_of_tie(loops, ask, k)
    return total


@routine
def missed(loops, ask, first, last):
    """The largest squared residual of a hard tie of these stages, as a part of its squared
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
def count_in(loops, work, ask, stage, held, damping, hard_only):
    """Mark the rows that count: of stages before `stage` with D = held, of it with `damping` by
    weight, no others.
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
def unbind(loops, work):
    """Write the bounds of all rows as they are given."""
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
def freeze(loops, work, ask, stage):
    """Hold from now on what a stage has reached: its residual becomes zero."""
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
    """Whether a stage is hard: it must be met, and is not only minimised."""
    for k in range(loops.plan[L.N_TIES]):
        if ask.stage[k] == stage:
            return ask.hard[k] != 0
    return False


@routine
def rigid(pin, k):
    """Whether the 3x4 pose at pin[k:] has a rotation: rows of length one, the third the product of
    the others.
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
def restore(loops, ask):
    """Restore the stages, and whether they are hard, as given."""
    ties = loops.plan[L.N_TIES]
    for k in range(ties):
        ask.stage[k], ask.hard[k] = ask.given[k], ask.given[ties + k]


@routine
def harden(loops, ask, last):
    """Whether soft stages stand before the last hard one up to `last`; makes them hard."""
    while last > 0 and not is_hard(loops, ask, last):
        last -= 1
    changed = False
    for k in range(loops.plan[L.N_TIES]):
        if 0 < ask.stage[k] < last and ask.hard[k] == 0:
            ask.hard[k] = 1
            changed = True
    return changed


@routine
def hold_ahead(loops, ask, stage):
    """Whether hard stages after this one are met at q; holds them with the loops."""
    changed = False
    for s in range(stage + 1, ask.stages + 1):
        if is_hard(loops, ask, s) and missed(loops, ask, s, s) <= 1.0:
            changed = True
            for k in range(loops.plan[L.N_TIES]):
                if ask.stage[k] == s:
                    ask.stage[k] = 0
    return changed
