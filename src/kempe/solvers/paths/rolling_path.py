"""Paths of what rolls: checked for slip, and where the targets leave freedoms, led without slip
from the start on.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.common.gauss_newton import gauss_newton, least_squares
from kempe.solvers.common.slip import Slip, hard_rows, slip_of
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.solvers.paths.following import IkPath
    from kempe.solvers.paths.path_steps import PathSteps

LONGEST = 0.02
"""Longest step that is led without slip at once, in radians and characteristic lengths."""
ITERATIONS = 12
HELD = 1e-12
"""By how much targets may be missed, and rows violated, after a step."""
MOST = 4096
"""Steps at most between two targets."""


def without_slip(way: PathSteps, path: IkPath, begin: int) -> IkPath:
    """The path where it does not slip; else one that rolls and holds the targets, if they leave
    that; else what is before the first slip, with the place.
    """
    good = np.flatnonzero(path.success)
    whole = len(good) and good[-1] - good[0] + 1 == len(good)
    slip = slip_of(way.system, path.q[good]) if whole else None
    if slip is None:
        return path
    q = path.q.copy()
    reached = _led(way, q, begin)
    if reached == len(q) - 1:
        status = f"{len(q) - begin} of {counted(len(q), 'target')} followed, without slip"
        return replace(path, q=q, success=np.arange(len(q)) >= begin, jumps=(), reason=status)
    return _broken(path, slip, int(good[0]))


def _broken(path: IkPath, slip: Slip, first: int) -> IkPath:
    """The part of the path before it slips."""
    k = first + slip.index
    q = path.q.copy()
    success = path.success.copy()
    q[k:] = np.nan
    success[k:] = False
    many = int(success.sum())
    followed = f"{many} of {counted(len(q), 'target')} followed"
    status = (
        f"{followed}; stops before target {k}: on the way there it {slip.text}; getting there is a "
        "manoeuvre"
    )
    return replace(path, q=q, success=success, jumps=(), reason=status)


def _led(way: PathSteps, out: Array, begin: int) -> int:
    """Write configurations (n, nq) that roll from target to target; returns the last one that was
    reached.
    """
    q = out[begin]
    for i in range(begin + 1, len(out)):
        way.budget.check()
        ahead = way.first_order(way.rows[i], q).way
        parts = min(max(2, math.ceil(ahead / LONGEST)), MOST)
        for part in range(1, parts + 1):
            found = _step(way, i, part / parts, q)
            if found is None:
                return i - 1
            q = found
        out[i] = q
    return len(out) - 1


def _step(way: PathSteps, i: int, part: float, q: Array) -> Array | None:
    """The configuration (nq,) that holds the target between, without slip in the middle of the way
    to it; or None.

    The smallest such step, by Newton's method.
    """
    system = way.system
    problem = way.at(i, part)

    def both(d: Array) -> tuple[Array, Array]:
        e, J = way.missing(problem, system.structure.layout.integrate(q, d * way.scale))
        A, b = hard_rows(
            system, system.structure.layout.integrate(q, 0.5 * d * way.scale), way.scale
        )
        return np.concatenate([e, np.full(len(A), np.inf) if b.any() else A @ d]), np.concatenate(
            [J, A]
        )

    def newton(d: Array, r: Array, M: Array) -> Array:
        new = least_squares(M, M @ d - r, 1e-8)
        return (
            new - d
            if np.linalg.norm(new) < 10.0 * LONGEST + 2.0 * np.linalg.norm(d)
            else np.full(len(d), np.inf)
        )

    found = gauss_newton(both, np.zeros(system.nv), ITERATIONS - 1, step=newton, met=HELD, last=0.0)
    layout = system.structure.layout
    x = layout.integrate(q, found.x * way.scale)
    v = layout.vector_v
    at = layout.vector_q
    inside = (x[at] >= system.lower[v] - HELD) & (x[at] <= system.upper[v] + HELD)
    return x if found.size <= HELD and inside.all() else None
