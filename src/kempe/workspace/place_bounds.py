"""Bounds of the places of a frame. Points outside are proven to be unreachable.

They follow from the lengths and limits of a chain, or of each leg of a parallel mechanism.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.inverse.chain.length_bounds import ReachBound, compute_reach_bounds
from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    KIND,
    MULTIPLIER,
    SIN_OFFSET,
    SLIDE,
    TURN,
    V_INDEX,
    copy_placements,
    get_row_integers,
    get_row_numbers,
)
from kempe.model.model import keep_answers
from kempe.model.primitive_table import extract_chain
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import Model


# ---- legs of parallel mechanisms

# Legs are chains from the ground to a frame that share only the bodies at their ends. Where the
# frame's pose is given, the legs do not know of each other: it is reached if and only if each leg
# reaches it.


@keep_answers
def find_legs(system: Model, frame: str) -> tuple[Model, ...]:
    """Find the legs to a frame, each as a system with that frame; none without at least two legs.

    Bodies that hang on others only are left out. Constraints and couplings may tie legs: with these
    there are none.
    """
    m = system._mechanism
    ground = system.body_names[0]
    body = m.frames[frame].body if frame in m.frames else frame
    if m.constraints or m.couplings or system.structure.relations or body == ground:
        return ()
    out: list[Model] = []
    for names in _find_joints_between(m, ground, body):
        part = m.copy()
        part.joints = {n: m.joints[n] for n in names}
        part.postures = {}
        leg = type(system)(part.subchain(ground, frame))
        if leg.structure.closures or len(leg.joint_names) != len(names):
            return ()
        out.append(leg)
    return tuple(out) if len(out) > 1 else ()


def _find_joints_between(m: Mechanism, ground: str, body: str) -> list[list[str]]:
    """Find the names of joints between two bodies, for each part, without dead ends."""
    ends = {ground, body}
    free = dict(m.joints)
    parts: list[list[str]] = []
    while free:
        first = next(iter(free.values()))
        inside = {first.parent, first.child} - ends
        names = [first.name]
        del free[first.name]
        while more := [j for j in free.values() if {j.parent, j.child} & inside]:
            for j in more:
                inside |= {j.parent, j.child} - ends
                names.append(j.name)
                del free[j.name]
        parts.append(_drop_dead_ends(m, names, ends))
    return [
        names
        for names in parts
        if ends <= {b for n in names for b in (m.joints[n].parent, m.joints[n].child)}
    ]


def _drop_dead_ends(m: Mechanism, names: list[str], ends: set[str]) -> list[str]:
    """Drop joints that lead to a body without any other joint."""
    while True:
        bodies = [b for n in names for b in (m.joints[n].parent, m.joints[n].child)]
        loose = {b for b in bodies if bodies.count(b) == 1} - ends
        if not loose:
            return names
        names = [n for n in names if not {m.joints[n].parent, m.joints[n].child} & loose]


# ---- bounds

# A chain cannot be longer than its links and slides together, nor fold back further than its
# longest link leaves; and an interval is led through its joints, each anywhere within its limits.
# Loops and constraints only take away. Source of the intervals: Moore, Kearfott, Cloud,
# *Introduction to Interval Analysis*, 2009.

ROUNDING = 1e-9
MISSED = 1e-6
"""Slack for rounding, as a part of the box; and by how much [m] the inverse model may miss a place
that it reaches."""


class PlaceBounds(NamedTuple):
    """Bounds of a frame's origin: a box (2, 3), perhaps infinite, and shells. All are widened by a
    `slack` for rounding.
    """

    box: Array
    shells: tuple[ReachBound, ...]
    slack: float


@keep_answers
def compute_place_bounds(system: Model, frame: str) -> tuple[PlaceBounds, ...]:
    """Compute the bounds of the places of a frame, from each of its legs or from its chain."""
    return tuple(
        _compute_chain_bounds(part, frame) for part in find_legs(system, frame) or (system,)
    )


def find_possible_places(system: Model, frame: str, points: Array) -> np.ndarray:
    """Find which points (n, 3) may be reached: they are not beyond a bound by more than `MISSED`.
    NaN is unreachable.
    """
    out = np.asarray(np.isfinite(points).all(axis=1))
    for (low, high), shells, slack in compute_place_bounds(system, frame):
        slack += MISSED
        out &= ((points >= low - slack) & (points <= high + slack)).all(axis=1)
        for shell in shells:
            far = np.linalg.norm(points - shell.centre, axis=1)
            out &= (far <= shell.largest + slack) & (far >= shell.smallest - slack)
    return out


def _compute_chain_bounds(system: Model, frame: str) -> PlaceBounds:
    """Compute the bounds of the places of a frame from its chain."""
    table, _, v_index = extract_chain(system.structure.table, frame)
    ints, floats = table.pack_arrays([frame])
    limits = system.structure.limits[v_index].T
    shells = tuple(b for b in compute_reach_bounds(ints, floats, limits) if not b.point.any())
    rows = get_row_integers(ints)
    numbers = get_row_numbers(ints, floats)
    placements = copy_placements(ints, floats)
    box = np.tile(placements[-1][:, 3], (2, 1))
    for row, own, X in zip(rows[::-1], numbers[::-1], placements[-2::-1], strict=True):
        if row[KIND] == TURN:
            ends = np.sort(own[MULTIPLIER] * limits[:, row[V_INDEX]])
            box = _bound_turned_box(box, *(ends + math.atan2(own[SIN_OFFSET], own[COS_OFFSET])))
        elif row[KIND] == SLIDE:
            box[:, 2] += np.sort(own[MULTIPLIER] * limits[:, row[V_INDEX]])
        else:
            far = float(np.linalg.norm(np.abs(box).max(axis=0)))
            box = np.array([[-far] * 3, [far] * 3])
        box = _bound_placed_box(box, X)
    return PlaceBounds(
        box, shells, ROUNDING * (1.0 + float(np.abs(box[np.isfinite(box)]).max(initial=0.0)))
    )


def _bound_placed_box(box: Array, X: Array) -> Array:
    """Compute the smallest box that contains a box moved by the pose X."""
    with np.errstate(invalid="ignore"):
        ends = np.where(X[:, :3] == 0.0, 0.0, X[:, :3] * box[:, None, :])
    return X[:, 3] + np.stack([ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)])


def _bound_turned_box(box: Array, low: float, high: float) -> Array:
    """Compute the smallest box that contains a box turned about z by angles from `low` to `high`."""
    out = box.copy()
    if not np.isfinite(box[:, :2]).all():
        out[:, :2] = [[-np.inf], [np.inf]]
        return out
    x = np.repeat(box[:, 0], 2)
    y = np.tile(box[:, 1], 2)
    r = np.hypot(x, y)
    angle = np.arctan2(y, x)
    if not high - low < 2.0 * math.pi:
        low = 0.0
        high = 2.0 * math.pi
    # the largest value is at `quarter`, the least opposite
    for axis, quarter in (
        (0, 0.0),
        (1, 0.5 * math.pi),
    ):
        at = np.stack([r * np.cos(angle + low - quarter), r * np.cos(angle + high - quarter)])
        for k, side in ((1, 0.0), (0, math.pi)):
            passes = np.floor((angle + high - quarter - side) / (2.0 * math.pi)) >= np.ceil(
                (angle + low - quarter - side) / (2.0 * math.pi)
            )
            ends = np.where(passes, r if k else -r, at.max(axis=0) if k else at.min(axis=0))
            out[k, axis] = ends.max() if k else ends.min()
    return out
