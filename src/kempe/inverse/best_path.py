"""`ik_path(branches="best")` and `closed=True`: the best of several paths, and paths that return to
their first configuration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kempe.answers.problem import Problem
from kempe.arrays import read_reals
from kempe.equations.slip import has_velocity_constraints
from kempe.errors import InputError, UnsupportedError
from kempe.inverse.chain.serial_chain import has_shared_coordinates, is_moved_by_loop
from kempe.inverse.tasks.demands import Demands, find_untouched_places
from kempe.inverse.tasks.search import make_checked_answer
from kempe.kernels.base.search_layout import SOLVED
from kempe.model.configurations import (
    compute_mid_configuration,
    find_free_angles,
    shorten_turns,
)
from kempe.model.coordinates import find_returning_angles
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.inverse.path import FollowedPath, IkPath
    from kempe.model.model import Model
    from kempe.spatial import Array

SAME = 1e-6
"""Largest difference of coordinates by which two starts, or the ends of a path, are one."""


class Home(NamedTuple):
    """A configuration (nq,) that self-motions lead towards, and weights (nv,) of its coordinates."""

    q: Array
    weights: Array


# ---- the cost of a path


def compute_motion(way: FollowedPath, path: IkPath) -> float:
    """Compute the length of the path of the configurations that reach their targets."""
    q = path.q[path.success]
    moved = way.system.structure.layout.compute_difference(q[:-1], q[1:])
    return float(np.linalg.norm(moved, axis=-1).sum())


def compute_limit_nearness(way: FollowedPath, path: IkPath) -> float:
    """Compute how near the path comes to limits: 0 in the middle, 1 at a limit."""
    system = way.system
    q = path.q[path.success]
    layout = system.structure.layout
    half = 0.5 * (system.upper - system.lower)
    bounded = np.isfinite(half) & (half > 0.0)
    away = layout.compute_difference(np.broadcast_to(compute_mid_configuration(system), q.shape), q)
    return float(np.abs(away[:, bounded] / half[bounded]).max(initial=0.0))


def compute_singular_nearness(way: FollowedPath, path: IkPath) -> float:
    """Compute the largest ratio of singular values, largest by smallest, of the targets' Jacobian."""
    ratios = (
        way.compute_first_order_step(way.rows[i], path.q[i]).ratio
        for i in np.flatnonzero(path.success).tolist()
    )
    return max((1.0 / max(r, 1e-300) for r in ratios), default=math.inf)


Cost = Callable[["FollowedPath", "IkPath"], float]

COSTS: dict[str, Cost] = {
    "motion": compute_motion,
    "limits": compute_limit_nearness,
    "singularities": compute_singular_nearness,
}
"""What a path costs, by name: the smallest is the best."""


def read_cost(cost: Any) -> Cost:
    """Return the function of a cost that is given by name or as a function of q (n, nq)."""
    if isinstance(cost, str) and cost in COSTS:
        return COSTS[cost]
    if callable(cost):
        function = cast("Callable[[Array], float]", cost)
        return lambda way, path: float(function(path.q[path.success]))
    raise InputError(
        f"cost is {cost!r}; it must be one of {', '.join(map(repr, COSTS))} or a function of the "
        "configurations (n, nq) that returns a number"
    )


# ---- starts


def list_starts(problem: Problem, way: FollowedPath, begin: int, q: Array) -> list[Array]:
    """List configurations that reach target `begin`: q, those that are found from other starts, and
    those of `ik_all`.
    """
    found = [
        q,
        *way.find_other_configurations(begin, q),
        *_list_all_solutions(problem, way.rows[begin], begin, q),
    ]
    out: list[Array] = []
    for x in found:
        if all(np.abs(x - other).max(initial=0.0) > SAME for other in out):
            out.append(x)
    return out


def _list_all_solutions(problem: Problem, row: Demands, begin: int, q: Array) -> list[Array]:
    """List the solutions of `ik_all` for target `begin` inside the limits."""
    if (
        problem.frame is None
        or is_moved_by_loop(problem.system, problem.frame)
        or has_shared_coordinates(problem.system, problem.frame)
    ):
        return []
    from kempe.inverse.ik_all import ik_all

    try:
        found = ik_all(problem.system, read_reals(problem.targets, "targets")[begin], problem.frame)
    except UnsupportedError:
        return []
    starts = found.q[found.inside]
    untouched = find_untouched_places(row.packed, row.pins)
    starts[:, untouched] = q[untouched]
    answers = [row.run_search(x[None]) for x in starts]
    return [x[0] for x, info in answers if info[0, 0] == SOLVED]


# ---- the best path


def find_best_branch(
    way: FollowedPath,
    starts: list[Array],
    begin: int,
    restart: bool,
    measure: Cost,
) -> IkPath:
    """Find the path that gets farthest, then that with the most targets, then the fewest jumps, then
    the cheapest.

    Where a path from one start meets limits, it is followed without them and moved inside by whole
    turns.
    """
    circle = _find_turning_coordinates(way.system)
    free = way.copy_without_limits() if circle.any() and way.problem.limits else None
    paths: list[IkPath] = []
    for x in starts:
        path = way.find_best_path(x, restart, begin)
        broken = path.late or path.interrupted
        turned: list[IkPath] = []
        if free is not None and not broken:
            whole = path or free.follow_path(x, False, begin)
            turned = _add_turns(way, whole, circle, starts[0])
        paths += [way.keep_rolling_part(p, begin) for p in turned or [path]]
        if broken:
            break
    orders = [_rank_path(path) for path in paths]
    best = [p for p, order in zip(paths, orders, strict=True) if order == min(orders)]
    if len(best) == 1 or not best[0].success.any():
        return best[0]
    return min(best, key=lambda p: measure(way, p))


def _rank_path(path: IkPath) -> tuple[int, int, int]:
    """Return numbers that are smaller for a better path, whatever it costs."""
    return -count_followed_targets(path), -int(path.success.sum()), len(path.jumps)


def count_followed_targets(path: IkPath) -> int:
    """Count the targets before the first one that is not reached continuously."""
    return int(min([*np.flatnonzero(~path.success), *path.jumps, len(path)]))


def _find_turning_coordinates(system: Model) -> np.ndarray:
    """Return a mask (nv,) of angles with limits more than a turn apart, for which a full turn
    changes nothing.
    """
    width = system.upper - system.lower
    return (
        find_returning_angles(system._mechanism, system.structure.coordinates)
        & np.isfinite(width)
        & (width > 2.0 * math.pi)
    )


def _add_turns(way: FollowedPath, path: IkPath, circle: np.ndarray, start: Array) -> list[IkPath]:
    """Add whole turns to the angles of a whole path, so that it is inside the limits.

    One answer begins near `start` (nq,), the other lies in the middle of the limits.
    """
    if not path:
        return []
    system = way.system
    layout = system.structure.layout
    away = layout.compute_difference(
        np.broadcast_to(compute_mid_configuration(system), path.q.shape), path.q
    )
    half = np.where(circle, 0.5 * (system.upper - system.lower), 0.0)
    turn = 2.0 * math.pi
    low, high = away.min(axis=0), away.max(axis=0)
    least = np.ceil((-half - low) / turn - SAME)
    most = np.floor((half - high) / turn + SAME)
    out: list[IkPath] = []
    for wish in (layout.compute_difference(path.q[0], start), -0.5 * (low + high)):
        turns = np.minimum(np.maximum(np.round(wish / turn), least), most)
        moved = np.broadcast_to(np.where(circle, turn * turns, 0.0), away.shape)
        q = layout.integrate_velocity(path.q, moved)
        success = way.check_configurations(q)
        if success.all():
            out.append(replace(path, q=q, success=success, problem=way.problem))
    return out


# ---- paths that return


def close_path(way: FollowedPath, path: IkPath) -> IkPath:
    """Change a whole path so that its last configuration is its first, if it can be.

    A path that is always as near as it can be to its first configuration returns. Angles without
    limits may make whole turns; how near these are does not count.
    """
    system = path.system
    if has_velocity_constraints(system):
        raise InputError("closed=True is not for systems that roll")
    if not path:
        return path
    first = path.q[0]
    if not make_checked_answer(way.rows[-1], first[None], np.full((1, 3), SOLVED)):
        raise InputError("closed=True needs a last target that is the first one again")
    if _find_gap(way, path.q) is None:
        return path
    whole = system.structure.layout.compute_difference(first, path.q[-1])
    wound = find_free_angles(system) & (np.abs(whole) > math.pi)
    way.home = Home(first, np.where(wound, 0.0, 1.0))
    near = way.follow_path(first, False)
    way.home = None
    if near.late or near.interrupted:
        return near
    gap = _find_gap(way, near.q if near else path.q)
    if near and gap is None:
        return near
    path = near if near else path
    q = path.q.copy()
    q[-1] = np.nan
    success = path.success.copy()
    success[-1] = False
    said = (
        f"{success.sum()} of {format_count(len(q), 'target')} followed; the path ends elsewhere "
        f"than it begins: {gap}"
    )
    return replace(path, q=q, success=success, reason=said)


def _find_gap(way: FollowedPath, q: Array) -> str | None:
    """Describe by how much a path (n, nq) ends elsewhere than it begins; None if it does not."""
    system = way.system
    apart = system.structure.layout.compute_difference(q[0], q[-1])
    apart = shorten_turns(apart, find_free_angles(system))
    far = np.abs(apart / way.scale)
    if far.max(initial=0.0) <= SAME:
        return None
    most = int(np.argmax(far))
    return f"{system.structure.velocity_names[most]!r} differs by {apart[most]:.3g}"
