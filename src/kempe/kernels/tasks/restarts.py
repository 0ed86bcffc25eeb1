"""Where the search for several tasks starts again: anywhere, or at what was found with a part of it
drawn anew.

A bundle is met once all its tasks are, each with a chance of its own at every start. Drawing all
anew multiplies these chances. Keeping what meets some tasks, and drawing only what moves the
others, adds up their waiting times instead.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import routine
from kempe.kernels.base.random import mix, unit
from kempe.kernels.base.scratch import beyond, copy
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.loop_coordinates import draw, is_held, number, place_of, sort_of
from kempe.kernels.tasks.base_fit import fit_base
from kempe.kernels.tasks.level_rows import assess, square_of_tie

NEAR = 0.6
"""Part of the ranges, about the first start and about their middles in turn, from which the first
starts are drawn: what is far from all limits leads to more answers."""
PLAIN = 8
WIDE = 1.35
WIDER = 2.0
"""Starts that are drawn so. Of those after them, of four one is drawn from all of the ranges, one
WIDE and two WIDER times as far about the middle and cut off at the limits, which puts a quarter and
a half of the coordinates there: what is left by then are mostly answers at limits."""
AGAIN = 6
LOWER = 0.99
"""Starts that begin at what another has reached, after the last that came to less than this part of
its square."""
NEARLY = 1e-3
"""Part of the largest square that a tie misses, up to which another one is as good as met."""
PART = 0.5
"""The largest part of the unknowns, on average, that is drawn anew where no task tells which."""
SALT = np.uint64(0x5EED)
"""What the numbers that choose a part are drawn with, beside those of the start."""


@routine
def to_middle(loops, home, to):
    """Write a configuration in the middle of all ranges to `to`; balls and what is no unknown as at
    `home`.
    """
    copy(to, home, 0, loops.nq)
    for v in range(loops.nv):
        if sort_of(loops, v) < L.BALL_FIRST and not is_held(loops, v):
            to[place_of(loops, v)] = 0.5 * (number(loops, 3, v) + number(loops, 4, v))


@routine
def begin(loops, work, ask, key, count):
    """Set q to start `count`, `trial` being the middle."""
    copy(loops.q, work.home, 0, loops.nq)
    fresh = mix(key, np.uint64(count))
    if 0 < count < PLAIN:
        draw(loops, work.trial if count % 2 else work.home, NEAR, fresh)
    elif count > 0:
        draw(loops, work.trial, 1.0, fresh)
        if count % 4 > 0:
            widen(loops, work.trial, WIDE if count % 4 == 1 else WIDER)
    if count > 0 or ask.loose:
        fit_base(loops, ask)


@routine
def widen(loops, about, far):
    """Move the coordinates of q away from `about`, `far` times as far; they stop at their limits."""
    for v in range(loops.nv):
        if not is_held(loops, v) and sort_of(loops, v) < L.BALL_FIRST:
            i = place_of(loops, v)
            x = about[i] + far * (loops.q[i] - about[i])
            loops.q[i] = min(max(x, number(loops, 1, v)), number(loops, 2, v))


@routine
def begin_at(loops, work, ask, last, key, count):
    """Set q to start `count`, but for what is kept of `rest`: where only some tasks are missed,
    what moves others.

    In turns: all is kept that moves a tie which is met; all that moves another than the worst; any
    part.
    """
    begin(loops, work, ask, key, count)
    copy(work.aside, loops.q, 0, loops.nq)
    copy(loops.q, work.rest, 0, loops.nq)
    assess(loops, work)
    if count % 3 == 2 or not mark_own(loops, work, ask, last, count % 3 == 0):
        fresh = mix(mix(key, np.uint64(count)), SALT)
        share = PART * unit(mix(fresh, np.uint64(loops.nv)))
        for v in range(loops.nv):
            work.way[v] = 1.0 if unit(mix(fresh, np.uint64(v))) < share else 0.0
    for v in range(loops.nv):
        sort = sort_of(loops, v)
        i = place_of(loops, v)
        if work.way[v] != 0.0 and not is_held(loops, v):
            if sort == L.BALL_FIRST:
                copy(beyond(loops.q, i), work.aside, i, 4)
            elif sort != L.BALL_MORE:
                loops.q[i] = work.aside[i]


@routine
def mark_own(loops, work, ask, last, all_missed):
    """Whether some unknowns move only ties that are missed, all or the worst, and others not; marks
    them in `way`.

    The equations must be those of q. Rows between bounds keep nothing.
    """
    plan = loops.plan
    worst = 0.0
    which = -1
    for k in range(plan[L.N_TIES]):
        if 0 <= ask.stage[k] <= last and ask.hard[k] != 0:
            square = square_of_tie(loops, ask, k)
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
            if k == which or (all_missed and square_of_tie(loops, ask, k) > NEARLY * worst):
                moves = True
            elif plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND] < 0:
                keeps = True
        if moves and not keeps:
            work.way[v] = 1.0
            own = True
        kept = kept or keeps
    return own and kept
