"""What lengths and limits leave of a box: places outside of it are proven not to be reached.

A chain cannot be longer than its links and slides together, nor fold back further than its longest link leaves; and an
interval is led through its joints, each anywhere within its limits. Loops and constraints only take away.
Source of the intervals: Moore, Kearfott, Cloud, *Introduction to Interval Analysis*, 2009.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.kinds.legs import legs_of
from kempe.analysis.spaces.workspace.cell_map import Grid
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
from kempe.model.tree.primitive_table import local_chain
from kempe.solvers.common.serial_chain import ReachBound, reach_bounds
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

FINE = 2**18
"""Cells into which a box is cut at least, as far as halving brings them there."""
ROUNDING = 1e-9


def outer_measure(system: System, frame: str, grid: Grid) -> float:
    """Measure of the cells of a box, made finer, of which no bound proves that the frame's origin is never there."""
    finer = max(1, int((FINE / grid.count) ** (1.0 / len(grid.axes))))
    left = np.count_nonzero(possible_cells(system, frame, grid, finer))
    return float(left) * float(np.prod(grid.size)) / finer ** len(grid.axes)


def possible_cells(system: System, frame: str, grid: Grid, finer: int = 1) -> np.ndarray:
    """Cells of a box, made finer along each axis, of which no bound proves that the frame's origin is never there."""
    near: list[tuple[Array, Array]] = []
    for k, (low, high, cells) in enumerate(zip(grid.low, grid.high, grid.cells, strict=True)):
        ends = np.linspace(low, high, cells * finer + 1) if k in grid.kept else np.full(2, 0.5 * (low + high))
        near.append((ends[:-1], ends[1:]))
    left = np.ones([len(a) for a, _ in near], dtype=bool)
    for part in legs_of(system, frame) or (system,):
        box, shells = _bounds(part, frame)
        slack = ROUNDING * (1.0 + float(np.abs(box[np.isfinite(box)]).max(initial=0.0)))
        x, y, z = ((b >= box[0, k] - slack) & (a <= box[1, k] + slack) for k, (a, b) in enumerate(near))
        left &= x[:, None, None] & y[:, None] & z
        for shell in shells:
            least, most = (_squares(near, shell.centre, far) for far in (False, True))
            left &= (least <= (shell.largest + slack) ** 2) & (most >= max(shell.smallest - slack, 0.0) ** 2)
    return left.reshape([n * finer for n in grid.shape])


def _squares(near: list[tuple[Array, Array]], centre: Array, far: bool) -> Array:
    """Squares (nx, ny, nz) of the distances of a point from the nearest, or the farthest, points of cells."""
    parts: list[Array] = []
    for (a, b), x in zip(near, centre, strict=True):
        ends = np.maximum(np.abs(a - x), np.abs(b - x))
        parts.append((ends if far else np.maximum(np.maximum(a - x, x - b), 0.0)) ** 2)
    return parts[0][:, None, None] + parts[1][:, None] + parts[2]


def _bounds(system: System, frame: str) -> tuple[Array, list[ReachBound]]:
    """A box (2, 3), perhaps infinite, and shells in which the frame's origin is."""
    table, _, v_index = local_chain(system.structure.table, frame)
    ints, floats = table.pack([frame])
    limits = system.structure.limits[v_index].T
    shells = [b for b in reach_bounds(ints, floats, limits) if not b.point.any()]
    rows, numbers, placements = rows_of(ints), numbers_of(ints, floats), placements_of(ints, floats)
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
    return box, shells


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
    x, y = (np.repeat(box[:, 0], 2), np.tile(box[:, 1], 2))
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    if not high - low < 2.0 * math.pi:
        low, high = 0.0, 2.0 * math.pi
    for axis, quarter in ((0, 0.0), (1, 0.5 * math.pi)):  # the largest value is at `quarter`, the least opposite
        at = np.stack([r * np.cos(angle + low - quarter), r * np.cos(angle + high - quarter)])
        for k, side in ((1, 0.0), (0, math.pi)):
            passes = np.floor((angle + high - quarter - side) / (2.0 * math.pi)) >= np.ceil(
                (angle + low - quarter - side) / (2.0 * math.pi))  # fmt: skip
            ends = np.where(passes, r if k else -r, at.max(axis=0) if k else at.min(axis=0))
            out[k, axis] = ends.max() if k else ends.min()
    return out
