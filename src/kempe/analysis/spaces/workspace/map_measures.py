"""What a map and the inverse model say together: the measure of what is reached, single points, the
boundary.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.analysis.spaces.kinds.questions import WorkspaceKind
from kempe.analysis.spaces.workspace.cell_map import CellMap
from kempe.errors import MissingExtraError
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

POINTS = {"inner": 500, "near": 2000, "far": 500}
"""Random points of each kind of cells whose places the inverse model is to reach, for the
measure."""
SIGMAS = 2.0
"""Standard errors that the error of a measure is."""
UNDECIDED, REACHED, UNREACHED = range(3)
"""What is known of a cell without samples."""
FIRST = 4
AT_ONCE = 256
"""Empty cells of which the nearest that is not reached is looked for first; points that are looked
at together."""


def measured(
    system: System,
    frame: str,
    cells: CellMap,
    seed: int,
    question: WorkspaceKind,
    possible: np.ndarray,
) -> tuple[float, float]:
    """The measure of what is reached inside the box, and `SIGMAS` standard errors of it.

    Random points in three layers of the map are decided by the inverse model; the layers make the
    error small, they prove nothing (stratified sampling: Cochran 1977, chapter 5; variances after
    Agresti and Coull 1998). Cells that are not `possible` are proven not to be reached, and left
    out.
    """
    rng = np.random.default_rng([seed, 1])
    cell = math.prod(cells.cell)
    value = 0.0
    variance = 0.0
    for name, mask in cells.layers.items():
        chosen = np.flatnonzero(mask & possible)
        if len(chosen):
            points = _within(cells, rng.choice(chosen, POINTS[name]), rng)
            hits = int(question.reached(system, frame, points, seed).sum())
            n = POINTS[name]
            whole = len(chosen) * cell
            part = (hits + 2.0) / (n + 4.0)
            value += whole * hits / n
            variance += whole**2 * part * (1.0 - part) / (n + 4.0)
    return value, SIGMAS * math.sqrt(variance)


def counted(cells: CellMap, samples: int, hits: int) -> tuple[float, float]:
    """The same of places of which so many were tried, as many in each cell, and so many reached.

    Cells of which each has its share make the error smaller than this one, which is that of places
    anywhere.
    """
    whole = math.prod(cells.cell) * cells.counts.size
    part = (hits + 2.0) / (samples + 4.0)
    error = SIGMAS * math.sqrt(part * (1.0 - part) / (samples + 4.0))
    return whole * hits / max(samples, 1), whole * error


def together(found: list[tuple[float, float]]) -> tuple[float, float]:
    """One value and its error of several that do not depend on each other, weighed by their errors."""
    proven = [x for x in found if x[1] == 0.0]
    if proven:
        return proven[0]
    values = np.array([v for v, _ in found])
    weights = np.array([e**-2.0 for _, e in found])
    return float(values @ weights / weights.sum()), float(weights.sum() ** -0.5)


def _within(cells: CellMap, numbers: np.ndarray, rng: np.random.Generator) -> Array:
    """Random points (n, 3), one in each of the cells."""
    grid = cells.grid
    at = np.stack(np.unravel_index(numbers, grid.shape), axis=-1)
    return grid.whole(np.array(grid.low)[grid.kept] + (at + rng.random(at.shape)) * grid.size)


def decided(
    system: System, frame: str, cells: CellMap, points: Array, seed: int, question: WorkspaceKind
) -> np.ndarray:
    """Whether each of points (n, 3) is reached: by the map in inner cells, else by the inverse
    model.
    """
    grid = cells.grid
    at, inside = grid.places(points[:, grid.kept])
    off = [k for k in range(3) if k not in grid.kept]
    middle = 0.5 * (np.array(grid.low) + grid.high)
    inside = inside & (np.abs(points - middle)[:, off] <= 1e-9 * (1.0 + np.abs(middle[off]))).all(
        axis=1
    )
    out = inside & cells.layers["inner"][tuple(at.T)]
    out[~out] = question.reached(system, frame, points[~out], seed)
    return out


def to_boundary(
    system: System,
    frame: str,
    cells: CellMap,
    points: Array,
    inside: np.ndarray,
    seed: int,
    question: WorkspaceKind,
) -> Array:
    """Distance [m] of points (n, 3) from the boundary, negative where they are not `inside`; of NaN
    it is NaN.

    Outside it is that from the nearest cell with samples. Inside it is that from the nearest cell
    whose middle is not reached: a cell may be empty for lack of samples only, so the inverse model
    decides.
    """
    at = points[:, cells.grid.kept]
    finite = np.isfinite(at).all(axis=1)
    out = np.where(np.isnan(at).any(axis=1), np.nan, -np.inf)
    edge = cast(Any, cells.edge)
    far = finite & ~inside
    out[far] = -edge.query(at[far])[0]
    near = np.flatnonzero(finite & inside)
    if question.tried:  # a place of each cell was decided
        out[near] = edge.query(at[near])[0]
        return out
    known = np.where(cells.empty[1], UNREACHED, UNDECIDED)
    for k in range(0, len(near), AT_ONCE):
        which = near[k : k + AT_ONCE]
        out[which] = _to_unreached(
            cells,
            at[which],
            known,
            lambda p: question.reached(system, frame, cells.grid.whole(p), seed),
        )
    return out


def _to_unreached(
    cells: CellMap, points: Array, known: np.ndarray, reached: Callable[[Array], np.ndarray]
) -> Array:
    """Distance (n,) of points (n, d) from the nearest empty cell that is not reached, less half its
    diagonal.

    `known` says of each empty cell what is known of it, and is filled in. That of the nearest
    middle is at most a diagonal too large, where the boundary is flat, and never too small.
    """
    tree = cast(Any, cells.empty[0])
    half = 0.5 * math.hypot(*cells.cell)
    out = np.zeros(len(points))
    left = np.arange(len(points))
    many = FIRST
    while len(left):
        far, cell = (
            x.reshape(len(left), -1) for x in tree.query(points[left], k=min(many, tree.n))
        )
        before = np.cumsum(known[cell] == UNREACHED, axis=1) == 0
        open_cells = np.unique(cell[before & (known[cell] == UNDECIDED)])
        known[open_cells] = np.where(reached(tree.data[open_cells]), REACHED, UNREACHED)
        gone = known[cell] == UNREACHED
        done = gone.any(axis=1)
        out[left[done]] = far[done, gone[done].argmax(axis=1)]
        left = left[~done]
        many = many * FIRST
    return np.maximum(out - half, 0.0)


def boundary_of(cells: CellMap) -> Any:
    """The boundary between cells with and without samples, through the middles between them; see
    `Workspace.boundary`.

    Errors: `MissingExtraError` without scikit-image.
    """
    grid = cells.grid
    filled = np.pad(cells.occupied, 1).astype(float)
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
