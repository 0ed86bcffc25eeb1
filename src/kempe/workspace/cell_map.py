"""Boxes divided into cells, and counts of samples in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from kempe.arrays import is_whole, read_reals
from kempe.errors import InputError, format_value
from kempe.spatial import Array

AXES = ("x", "y", "z")
_images: Any = ndimage
MOST_CELLS = 2**31 - 8
"""Cells of a map: their numbers, and those after the last, must fit into what a count's place is
written in."""


@dataclass(frozen=True)
class Grid:
    """A box along the ground's axes, divided into equal `cells` along x, y, z from `low` to `high`
    [m].

    An axis along which nothing moves has one cell, and is left out of `axes` and of the measure. Of
    orientations the `names` of the three are others.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    cells: tuple[int, ...]
    axes: tuple[str, ...]
    names: tuple[str, ...] = AXES

    @cached_property
    def measured_axes(self) -> list[int]:
        """The numbers of the axes along which the box is measured."""
        return [self.names.index(a) for a in self.axes]

    @property
    def count(self) -> int:
        """Number of cells."""
        return math.prod(self.cells)

    @cached_property
    def size(self) -> Array:
        """Edge lengths (d,) of a cell [m]."""
        return ((np.array(self.high) - self.low) / self.cells)[self.measured_axes]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each of the `axes`."""
        return tuple(self.cells[k] for k in self.measured_axes)

    @cached_property
    def kernel_bounds(self) -> Array:
        """Lower end, cells a metre and number of cells (3, 3), for the kernel."""
        low, high, cells = (np.array(x, dtype=float) for x in (self.low, self.high, self.cells))
        return np.ascontiguousarray(np.stack([low, cells / (high - low), cells], axis=1))

    def list_centres(self, axis: str) -> Array:
        """List the centres of the cells along an axis [m]."""
        k = self.names.index(axis)
        return (
            self.low[k]
            + (np.arange(self.cells[k]) + 0.5) * (self.high[k] - self.low[k]) / self.cells[k]
        )

    def locate_cells(self, points: Array) -> tuple[np.ndarray, np.ndarray]:
        """Locate the cells (..., d) of points (..., d), clipped to the box. A mask (...) tells
        which points are inside.
        """
        at = np.floor((points - np.array(self.low)[self.measured_axes]) / self.size)
        inside = np.asarray(((at >= 0) & (at < self.shape)).all(axis=-1))
        return np.clip(np.nan_to_num(at), 0, np.array(self.shape) - 1).astype(np.int64), inside

    def number_cells(self, points: Array) -> np.ndarray:
        """Compute the numbers (n,) of the cells of points (n, 3), last axis fastest. Points outside
        have the number `count`.
        """
        low, by, cells = self.kernel_bounds.T
        at = np.floor((points - low) * by)
        inside = ((at >= 0) & (at < cells)).all(axis=1)
        at = np.where(inside[:, None], at, 0).astype(np.int64)
        return np.where(
            inside, (at[:, 0] * self.cells[1] + at[:, 1]) * self.cells[2] + at[:, 2], self.count
        )

    def complete_points(self, points: Array) -> Array:
        """Complete points (n, d) on the `axes` to points (n, 3)."""
        out = np.tile(0.5 * (np.array(self.low) + self.high), (len(points), 1))
        out[:, self.measured_axes] = points
        return out


@dataclass(frozen=True, eq=False)
class CellMap:
    """Number of samples in each cell of a box around a workspace.

    `Workspace.map` is one. An axis along which the frame does not move is left out.

    Attributes
    ----------
    grid : Grid
        The box along the axes of the ground, and the number of its cells.
    counts : ndarray of int
        Number of samples in each cell, shape (nx, ny, nz) with one entry for each of the `axes`.

    See Also
    --------
    kempe.System.workspace : Computes a workspace and its map.

    Notes
    -----
    Lengths are metres. The map of a workspace of the kind "orientation" has angles in radians as
    axes; `unit` says which.

    Examples
    --------
    >>> import kempe
    >>> cells = kempe.load("two_link").workspace("e", n=100_000, cells=20).map
    >>> cells.counts.shape, list(cells.axes), cells.unit
    ((20, 20), ['x', 'y'], 'm')
    >>> int(cells.counts.sum())
    100000
    """

    grid: Grid
    counts: np.ndarray

    @property
    def unit(self) -> str:
        """Unit of the axes: "m", or "rad" for a workspace of the kind "orientation".

        Returns
        -------
        str
            "m" or "rad".
        """
        return "m" if self.grid.names == AXES else "rad"

    @property
    def axes(self) -> dict[str, Array]:
        """Centres of the cells along each axis.

        Returns
        -------
        dict of str to ndarray
            Coordinates (n,) of the centres in the ground frame, by the name of the axis, in `unit`.
        """
        return {a: self.grid.list_centres(a) for a in self.grid.axes}

    @cached_property
    def occupied(self) -> np.ndarray:
        """Mask of the cells with at least one sample.

        Returns
        -------
        ndarray of bool
            Shape of `counts`.
        """
        return self.counts > 0

    @cached_property
    def layers(self) -> dict[str, np.ndarray]:
        """Masks of the cells far inside, near the boundary, and far outside.

        Returns
        -------
        dict of str to ndarray of bool
            Masks with the shape of `counts`. "inner": the cell and all its neighbours have samples;
            "far": neither the cell nor a neighbour has a sample; "near": all other cells.
            Neighbours share a face, an edge or a corner with the cell.
        """
        around = np.ones((3,) * self.counts.ndim, dtype=bool)
        inner = np.asarray(_images.binary_erosion(self.occupied, around), dtype=bool)
        far = ~np.asarray(_images.binary_dilation(self.occupied, around), dtype=bool)
        return {"inner": inner, "near": ~(inner | far), "far": far}

    @cached_property
    def edge(self) -> KDTree:
        """Cells with samples that share a face with a cell without samples.

        Returns
        -------
        scipy.spatial.KDTree
            Search tree of the centres (k, d) of these cells, in `unit`.
        """
        within = _images.binary_erosion(
            self.occupied, _images.generate_binary_structure(self.counts.ndim, 1)
        )
        at = np.argwhere(self.occupied & ~np.asarray(within, dtype=bool))
        return KDTree(
            np.array(self.grid.low)[self.grid.measured_axes] + (at + 0.5) * self.grid.size
        )

    @cached_property
    def empty(self) -> tuple[KDTree, np.ndarray]:
        """Cells without samples, with one layer of cells around the box.

        Returns
        -------
        tree : scipy.spatial.KDTree
            Search tree of the centres (k, d) of these cells, in `unit`.
        around : ndarray of bool
            Mask (k,) of the cells that lie outside the box.
        """
        occupied = np.pad(self.occupied, 1)
        at = np.argwhere(~occupied) - 1
        around = np.asarray(((at < 0) | (at >= self.grid.shape)).any(axis=1))
        return KDTree(
            np.array(self.grid.low)[self.grid.measured_axes] + (at + 0.5) * self.grid.size
        ), around

    @property
    def cell(self) -> tuple[float, ...]:
        """Edge lengths of a cell.

        Returns
        -------
        tuple of float
            One length for each of the `axes`, in `unit`.
        """
        return tuple(self.grid.size.tolist())

    @property
    def points(self) -> Array:
        """Centres of the cells with samples, as a point cloud.

        Returns
        -------
        ndarray
            Coordinates (k, d) in the ground frame, one column for each of the `axes`, in `unit`.
        """
        at = np.argwhere(self.occupied)
        return np.array(self.grid.low)[self.grid.measured_axes] + (at + 0.5) * self.grid.size


USUAL_CELLS = {1: 1024, 2: 256, 3: 64}
FEW_CELLS = {1: 512, 2: 64, 3: 20}
"""Cells along the longest edge: of samples that cost nothing, and of places that the inverse model
decides."""


def make_grid(
    extent: Array, cells: Any, box: Any, length: float, dim: int, usual: dict[int, int]
) -> Grid:
    """Make the grid for positions within `extent` (2, 3), of a system of this characteristic
    length.

    `cells` are how many along the longest edge of the box, or for each axis, as is `usual` by the
    number of axes; `box` (d, 2) replaces the extent, which else is made wider by a twentieth on
    each side. Errors: `InputError`.
    """
    names = AXES[:dim]
    moves = [k for k in range(dim) if extent[1, k] - extent[0, k] > 1e-9 * length]
    # where nothing moves: one cell about it
    low = extent[0] - 0.5 * length
    high = extent[1] + 0.5 * length
    margin = 0.05 * (extent[1] - extent[0])
    for k in moves:
        low[k] = extent[0, k] - margin[k]
        high[k] = extent[1, k] + margin[k]
    if box is not None:
        ends = read_reals(box, "box", "pairs (lower, upper) of metres, one an axis")
        if ends.shape != (dim, 2):
            raise InputError(
                f"box is {format_value(box)}; it must be {dim} pairs (lower, upper) of metres, of "
                f"{names}"
            )
        for name, (a, b) in zip(AXES, ends.tolist(), strict=False):
            if not -np.inf < a < b < np.inf:
                raise InputError(
                    f"box: {name} is from {a:g} to {b:g}; the first must be less, both in metres"
                )
        for k, (a, b) in enumerate(ends.tolist()):
            if k in moves or not a <= extent[0, k] <= b:  # else the one cell stays about the place
                low[k] = a
                high[k] = b
    axes = tuple(AXES[k] for k in moves)
    numbers = [1, 1, 1]
    for k, count in zip(moves, count_cells(cells, (high - low)[moves], axes, usual), strict=True):
        numbers[k] = count
    if math.prod(numbers) > MOST_CELLS:
        raise InputError(
            f"cells are {format_value(cells)}: {math.prod(numbers):.3g} cells; at most "
            f"{MOST_CELLS:.3g} are held"
        )
    return Grid(tuple(low.tolist()), tuple(high.tolist()), tuple(numbers), axes)


def count_cells(
    cells: Any, edges: Array, axes: tuple[str, ...], usual: dict[int, int]
) -> list[int]:
    """Compute the number of cells along each axis. One number stands for the longest edge, with
    nearly cubic cells.
    """
    if cells is None:
        cells = usual[len(axes)]
    if is_whole(cells) and 1 <= cells <= MOST_CELLS:
        return [max(1, int(np.ceil(cells * e / edges.max() - 1e-9))) for e in edges]
    several: Any = cells
    listed = isinstance(cells, (Sequence, np.ndarray)) and not isinstance(cells, str)
    given: list[Any] = list(several) if listed else []
    if len(given) == len(axes) and all(is_whole(c) and 1 <= c <= MOST_CELLS for c in given):
        return [int(c) for c in given]
    needed = f"a whole number, at least 1, or {len(axes)} of them, for {', '.join(axes)}"
    raise InputError(f"cells is {format_value(several)}; it must be {needed}")
