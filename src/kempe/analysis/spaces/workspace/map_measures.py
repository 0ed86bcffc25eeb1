"""What a map and the inverse model say together: the measure of what is reached, single points, the boundary."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.analysis.spaces.kinds.questions import WorkspaceKind
from kempe.analysis.spaces.workspace.cell_map import CellMap
from kempe.errors import MissingExtraError
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

POINTS = {"inner": 500, "near": 2000, "far": 500}
"""Random points of each kind of cells whose places the inverse model is to reach, for the measure."""
SIGMAS = 2.0
"""Standard errors that the error of a measure is."""


def measured(system: System, frame: str, cells: CellMap, seed: int, question: WorkspaceKind) -> tuple[float, float]:
    """The measure of what is reached inside the box, and `SIGMAS` standard errors of it.

    Random points in three layers of the map are decided by the inverse model; the layers make the error small, they
    prove nothing (stratified sampling: Cochran 1977, chapter 5; variances after Agresti and Coull 1998).
    """
    rng, cell = np.random.default_rng([seed, 1]), math.prod(cells.cell)
    value, variance = 0.0, 0.0
    for name, mask in cells.layers.items():
        chosen = np.flatnonzero(mask)
        if len(chosen):
            points = _within(cells, rng.choice(chosen, POINTS[name]), rng)
            hits, n = int(question.reached(system, frame, points, seed).sum()), POINTS[name]
            whole, part = len(chosen) * cell, (hits + 2.0) / (n + 4.0)
            value += whole * hits / n
            variance += whole**2 * part * (1.0 - part) / (n + 4.0)
    return value, SIGMAS * math.sqrt(variance)


def counted(cells: CellMap, samples: int, hits: int) -> tuple[float, float]:
    """The same of places of which so many were tried, as many in each cell, and so many reached.

    Cells of which each has its share make the error smaller than this one, which is that of places anywhere.
    """
    whole, part = math.prod(cells.cell) * cells.counts.size, (hits + 2.0) / (samples + 4.0)
    error = SIGMAS * math.sqrt(part * (1.0 - part) / (samples + 4.0))
    return whole * hits / max(samples, 1), whole * error


def together(found: list[tuple[float, float]]) -> tuple[float, float]:
    """One value and its error of several that do not depend on each other, weighed by their errors."""
    values, weights = np.array([v for v, _ in found]), np.array([e**-2.0 for _, e in found])
    return float(values @ weights / weights.sum()), float(weights.sum() ** -0.5)


def _within(cells: CellMap, numbers: np.ndarray, rng: np.random.Generator) -> Array:
    """Random points (n, 3), one in each of the cells."""
    grid = cells.grid
    at = np.stack(np.unravel_index(numbers, grid.shape), axis=-1)
    return grid.whole(np.array(grid.low)[grid.kept] + (at + rng.random(at.shape)) * grid.size)


def decided(
    system: System, frame: str, cells: CellMap, points: Array, seed: int, question: WorkspaceKind
) -> np.ndarray:
    """Whether each of points (n, 3) is reached: by the map in inner cells, else by the inverse model."""
    grid = cells.grid
    at, inside = grid.places(points[:, grid.kept])
    off = [k for k in range(3) if k not in grid.kept]
    middle = 0.5 * (np.array(grid.low) + grid.high)
    inside = inside & (np.abs(points - middle)[:, off] <= 1e-9 * (1.0 + np.abs(middle[off]))).all(axis=1)
    out = inside & cells.layers["inner"][tuple(at.T)]
    out[~out] = question.reached(system, frame, points[~out], seed)
    return out


def to_boundary(cells: CellMap, points: Array) -> Array:
    """Distance [m] of points (n, d) from the middle of the nearest boundary cell, negative outside."""
    grid, occupied = cells.grid, cells.occupied
    far: Array = cast(Any, cells.edge).query(points)[0]
    at, inside = grid.places(points)
    return np.where(inside & occupied[tuple(at.T)], far, -far)


def boundary_of(cells: CellMap) -> Any:
    """The boundary between cells with and without samples, through the middles between them; see `Workspace.boundary`.

    Errors: `MissingExtraError` without scikit-image.
    """
    grid, filled = cells.grid, np.pad(cells.occupied, 1).astype(float)
    origin = np.array(grid.low)[grid.kept] - 0.5 * grid.size
    if filled.ndim == 1:
        ends = np.flatnonzero(np.diff(filled))
        return (origin + (ends[:, None] + 0.5) * grid.size).ravel()
    try:
        from skimage import measure
    except ImportError:
        raise MissingExtraError("scikit-image", "scale") from None
    if filled.ndim == 2:
        return [origin + line * grid.size for line in cast(Any, measure).find_contours(filled, 0.5)]
    if not cells.occupied.any():
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    corners, triangles, _, _ = cast(Any, measure).marching_cubes(filled, 0.5)
    return origin + corners * grid.size, triangles
