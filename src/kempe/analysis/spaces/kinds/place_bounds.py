"""What lengths and limits leave of space: places outside of it are proven not to be reached.

A chain cannot be longer than its links and slides together, nor fold back further than its longest
link leaves; and an interval is led through its joints, each anywhere within its limits. Loops and
constraints only take away. Source of the intervals: Moore, Kearfott, Cloud, *Introduction to
Interval Analysis*, 2009.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.analysis.spaces.kinds.legs import legs_of
from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    KIND,
    MULTIPLIER,
    SIN_OFFSET,
    SLIDE,
    TURN,
    V_INDEX,
    numbers_of,
    placements_of,
    rows_of,
)
from kempe.model.kept import kept
from kempe.model.tree.primitive_table import local_chain
from kempe.solvers.common.serial_chain import ReachBound, reach_bounds
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

ROUNDING = 1e-9
MISSED = 1e-6
"""Slack for rounding, as a part of the box; and by how much [m] the inverse model may miss a place
that it reaches."""


class PlaceBounds(NamedTuple):
    """A box (2, 3), perhaps infinite, and shells in which a frame's origin is, each wider by a
    `slack` for rounding.
    """

    box: Array
    shells: tuple[ReachBound, ...]
    slack: float


@kept
def place_bounds(system: System, frame: str) -> tuple[PlaceBounds, ...]:
    """What bounds the places of a frame: of each leg to it, or of its chain."""
    return tuple(_bounds(part, frame) for part in legs_of(system, frame) or (system,))


def possible_places(system: System, frame: str, points: Array) -> np.ndarray:
    """Which points (n, 3) are not proven to be out of reach of the origin by more than `MISSED`; of
    NaN none.
    """
    out = np.asarray(np.isfinite(points).all(axis=1))
    for (low, high), shells, slack in place_bounds(system, frame):
        slack += MISSED
        out &= ((points >= low - slack) & (points <= high + slack)).all(axis=1)
        for shell in shells:
            far = np.linalg.norm(points - shell.centre, axis=1)
            out &= (far <= shell.largest + slack) & (far >= shell.smallest - slack)
    return out


def _bounds(system: System, frame: str) -> PlaceBounds:
    table, _, v_index = local_chain(system.structure.table, frame)
    ints, floats = table.pack([frame])
    limits = system.structure.limits[v_index].T
    shells = tuple(b for b in reach_bounds(ints, floats, limits) if not b.point.any())
    rows = rows_of(ints)
    numbers = numbers_of(ints, floats)
    placements = placements_of(ints, floats)
    box = np.tile(placements[-1][:, 3], (2, 1))
    for row, own, X in zip(rows[::-1], numbers[::-1], placements[-2::-1], strict=True):
        if row[KIND] == TURN:
            ends = np.sort(own[MULTIPLIER] * limits[:, row[V_INDEX]])
            box = _turned(box, *(ends + math.atan2(own[SIN_OFFSET], own[COS_OFFSET])))
        elif row[KIND] == SLIDE:
            box[:, 2] += np.sort(own[MULTIPLIER] * limits[:, row[V_INDEX]])
        else:
            far = float(np.linalg.norm(np.abs(box).max(axis=0)))
            box = np.array([[-far] * 3, [far] * 3])
        box = _placed(box, X)
    return PlaceBounds(
        box, shells, ROUNDING * (1.0 + float(np.abs(box[np.isfinite(box)]).max(initial=0.0)))
    )


def _placed(box: Array, X: Array) -> Array:
    """The smallest box that holds a placed one."""
    with np.errstate(invalid="ignore"):
        ends = np.where(X[:, :3] == 0.0, 0.0, X[:, :3] * box[:, None, :])
    return X[:, 3] + np.stack([ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)])


def _turned(box: Array, low: float, high: float) -> Array:
    """The smallest box that holds one turned about z by the angles from `low` to `high`."""
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
    for axis, quarter in (
        (0, 0.0),
        (1, 0.5 * math.pi),
    ):  # the largest value is at `quarter`, the least opposite
        at = np.stack([r * np.cos(angle + low - quarter), r * np.cos(angle + high - quarter)])
        for k, side in ((1, 0.0), (0, math.pi)):
            passes = np.floor((angle + high - quarter - side) / (2.0 * math.pi)) >= np.ceil(
                (angle + low - quarter - side) / (2.0 * math.pi)
            )
            ends = np.where(passes, r if k else -r, at.max(axis=0) if k else at.min(axis=0))
            out[k, axis] = ends.max() if k else ends.min()
    return out
