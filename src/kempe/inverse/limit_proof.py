"""Whether it is proven that limits keep the answers of the inverse model away: all of them are
known, or slides end.

Both hold for chains without loops and relations. That a search finds nothing inside the limits
proves nothing.
"""

from __future__ import annotations

import numpy as np

from kempe.answers.evidence import Evidence, evidence
from kempe.answers.problem import Problem
from kempe.arguments import quiet
from kempe.errors import UnsupportedError
from kempe.inverse.chain.problem import FrameProblem
from kempe.inverse.chain.serial_chain import Chain, moved_by, of_loops, shared_by
from kempe.kernels.forward.table_layout import (
    KIND,
    MULTIPLIER,
    SLIDE,
    V_INDEX,
    numbers_of,
    placements_of,
    rows_of,
)
from kempe.numerics.clock import TimeLimit
from kempe.poses import sound
from kempe.spatial import Array

CLEAR = 1e-3
"""How far beyond a limit, in radians or parts of the target's distance, each answer must be: what
is nearer may be reached within the tolerance, or be rounding where two answers are near each
other."""


@quiet
def shut_out(task: FrameProblem, target: Array) -> Evidence | None:
    """What proves that a target (1, 4, 4) has no answer inside the limits; None where that is not
    proven.
    """
    return _slides_end(task, target) or _all_outside(task, target)


def _all_outside(task: FrameProblem, target: Array) -> Evidence | None:
    """Whether all the answers there are without limits are outside them."""
    system = task.system
    chain = task.chain
    plain = np.all(np.abs(numbers_of(task.chain.ints, task.chain.floats)[:, MULTIPLIER]) == 1.0)
    if max(task.tolerance) > CLEAR * CLEAR or len(chain.q_index) != len(chain.v_index) or not plain:
        return None
    if of_loops(system, task.frame) or shared_by(system, task.frame):
        return None
    from kempe.inverse.solve_all import SINGLE, by_chain

    if task.name == "position":
        goal = np.eye(4)
        goal[: system.dim, 3] = target[0, : system.dim, 3]
    else:
        goal = sound(target[0], "target")
    problem = Problem(
        system,
        "all",
        limits=False,
        options={"time": TimeLimit(SINGLE)},
        frame=task.frame,
        task=(task.name, task.axis),
        targets=goal[None],
    )
    try:
        found = by_chain(problem)
    except UnsupportedError:
        return None
    if not found.complete or not len(found.q) or found.families:
        return None
    size = 1.0 + float(np.linalg.norm(target[0, :3, 3]))
    beyond = min(_beyond(chain, q[chain.q_index]) for q in found.q)
    if not beyond > CLEAR * size:
        return None
    return evidence("outside", count=len(found.q))


def _beyond(chain: Chain, q: Array) -> float:
    """How far the coordinate that is farthest outside its limits is outside, whatever whole turns
    are added.
    """
    turning, sliding = moved_by(chain)
    (low, high) = chain.limits
    turns = 2.0 * np.pi * (turning & ~sliding)
    above = np.maximum(q - high, 0.0)
    below = np.maximum(low - q, 0.0)
    off = above + below
    # the nearest turns on both sides of the range
    for v in np.flatnonzero((turns > 0.0) & (off > 0.0)):
        x = off[v] % turns[v]
        room = high[v] - low[v]
        off[v] = max(min(x, turns[v] - x - room), 0.0)
    return float(off.max(initial=0.0))


def _slides_end(task: FrameProblem, target: Array) -> Evidence | None:
    """Whether slides which nothing turns end too far from the target, along some direction,
    whatever the rest does.
    """
    chain = task.chain
    table = rows_of(task.chain.ints)
    rows = placements_of(chain.ints, chain.floats)
    factors = numbers_of(chain.ints, chain.floats)[:, MULTIPLIER]
    R = np.eye(3)
    place = np.zeros(3)
    reach = 0.0
    axes: list[Array] = []
    moved: list[tuple[float, float]] = []
    for k, X in enumerate(rows):
        place = place + R @ X[:, 3]
        R = R @ X[:, :3]
        if k == len(table) or table[k, KIND] != SLIDE:
            reach = sum(float(np.linalg.norm(Y[:, 3])) for Y in rows[k + 1 :])
            if np.any(table[k:, KIND] == SLIDE):
                return None
            break
        ends = factors[k] * chain.limits[:, table[k, V_INDEX]]
        axes.append(R[:, 2])
        moved.append((float(ends.min()), float(ends.max())))
    if not axes or not task.mask[0] or len(set(table[: len(axes), V_INDEX])) < len(axes):
        return None
    A = np.array(axes).T
    (low, high) = np.array(moved).T
    p = target[0, :3, 3]
    for d in np.concatenate([A.T, np.linalg.pinv(A, rcond=1e-9)]):
        d = d / max(float(np.linalg.norm(d)), 1e-300)
        part = d @ A
        used = np.abs(part) > 1e-12
        ends = np.stack([part[used] * low[used], part[used] * high[used]])
        least = float(ends.min(axis=0).sum())
        most = float(ends.max(axis=0).sum())
        off = float(d @ (p - place))
        out = max(off - most, least - off) - reach
        if out > task.tolerance[0] + 1e-9 * (1.0 + abs(off) + reach):
            return evidence("outside", short=out)
    return None
