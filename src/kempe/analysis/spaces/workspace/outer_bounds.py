"""What bounds of places leave of the cells of a box."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.kinds.place_bounds import place_bounds
from kempe.analysis.spaces.workspace.cell_map import Grid
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

FINE = 2**18
"""Cells into which a box is cut at least, as far as halving brings them there."""


def outer_measure(system: System, frame: str, grid: Grid) -> float:
    """Measure of the cells of a box, made finer, of which no bound proves that the frame's origin
    is never there.
    """
    finer = max(1, int((FINE / grid.count) ** (1.0 / len(grid.axes))))
    left = np.count_nonzero(possible_cells(system, frame, grid, finer))
    return float(left) * float(np.prod(grid.size)) / finer ** len(grid.axes)


def possible_cells(system: System, frame: str, grid: Grid, finer: int = 1) -> np.ndarray:
    """Cells of a box, made finer along each axis, of which no bound proves that the frame's origin
    is never there.
    """
    near: list[tuple[Array, Array]] = []
    for k, (low, high, cells) in enumerate(zip(grid.low, grid.high, grid.cells, strict=True)):
        ends = (
            np.linspace(low, high, cells * finer + 1)
            if k in grid.kept
            else np.full(2, 0.5 * (low + high))
        )
        near.append((ends[:-1], ends[1:]))
    left = np.ones([len(a) for a, _ in near], dtype=bool)
    for box, shells, slack in place_bounds(system, frame):
        x, y, z = (
            (b >= box[0, k] - slack) & (a <= box[1, k] + slack) for k, (a, b) in enumerate(near)
        )
        left &= x[:, None, None] & y[:, None] & z
        for shell in shells:
            least, most = (_squares(near, shell.centre, far) for far in (False, True))
            left &= (least <= (shell.largest + slack) ** 2) & (
                most >= max(shell.smallest - slack, 0.0) ** 2
            )
    return left.reshape([n * finer for n in grid.shape])


def _squares(near: list[tuple[Array, Array]], centre: Array, far: bool) -> Array:
    """Squares (nx, ny, nz) of the distances of a point from the nearest, or the farthest, points of
    cells.
    """
    parts: list[Array] = []
    for (a, b), x in zip(near, centre, strict=True):
        ends = np.maximum(np.abs(a - x), np.abs(b - x))
        parts.append((ends if far else np.maximum(np.maximum(a - x, x - b), 0.0)) ** 2)
    return parts[0][:, None, None] + parts[1][:, None] + parts[2]
