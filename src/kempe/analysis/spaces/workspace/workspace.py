"""What a frame reaches: a map of counts by random configurations, and what follows from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.maps.part_log import refuse_other
from kempe.analysis.maps.zarr_folders import description_of
from kempe.analysis.spaces.workspace import map_measures
from kempe.analysis.spaces.workspace.cell_map import CellMap
from kempe.analysis.spaces.workspace.map_files import Stored, read_map, write_map
from kempe.calls import explained, explained_methods
from kempe.errors import InputError
from kempe.kinematics.common.result import Cells, Report
from kempe.reals import reals
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import System

MEASURES = {1: ("length", "m"), 2: ("area", "m^2"), 3: ("volume", "m^3")}
"""What is measured in one, two and three dimensions, and its unit."""


@explained_methods
@dataclass(frozen=True, eq=False)
class Workspace(Report):
    """The places that a frame reaches, as counts of random configurations in the cells of a box.

    A cell with a count above zero holds a point that is reached: no more is proven by the `map`. An empty cell may hold
    points that are reached, too. `samples` were drawn, of the `requested` ones; `outside` of them fell outside the box,
    `left_out` could not be closed or violated a constraint. Where the work was `interrupted`, or the time limit came
    (`late`), the map holds what was done.
    """

    system: System
    frame: str
    map: CellMap
    samples: int
    requested: int
    outside: int
    left_out: int
    said: dict[str, Any] = field(repr=False)
    interrupted: bool = False
    late: bool = False
    redone: int = 0
    """Damaged parts that were found on disk, and whose samples were drawn again."""

    @property
    def seed(self) -> int:
        """What the samples were drawn from."""
        return int(self.said["seed"])

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `INTERRUPTED` and `OUT_OF_TIME` where fewer samples were drawn than were requested."""
        return Status.INTERRUPTED if self.interrupted else Status.OUT_OF_TIME if self.late else Status.SOLVED

    # ---- how much

    @cached_property
    def _measure(self) -> tuple[float, float]:
        return map_measures.measured(self.system, self.frame, self.map, self.seed)

    def _measured(self, dimension: int) -> tuple[float, float]:
        axes = self.map.grid.axes
        if len(axes) != dimension:
            has = MEASURES[len(axes)][0]
            raise InputError(f"{self.frame!r} moves along {', '.join(axes)}: the measure is its {has}")
        return self._measure

    @property
    def volume(self) -> tuple[float, float]:
        """Volume of what is reached in the box, and its error [m^3]; see `area`."""
        return self._measured(3)

    @property
    def area(self) -> tuple[float, float]:
        """Area of what is reached in the box, and its error [m^2].

        The value is estimated: the inverse model decides random points, more of them where the map changes. The error
        is two standard errors of that. What the inverse model does not find counts as not reached.
        """
        return self._measured(2)

    @property
    def length(self) -> tuple[float, float]:
        """Length of what is reached of a line, and its error [m]; see `area`."""
        return self._measured(1)

    # ---- single points

    def contains(self, points: ArrayLike, check: bool = False) -> np.ndarray:
        """Whether points (..., d) in the ground frame [m] are reached (...); d is 2 or 3, as of the system.

        In a cell that has samples, as all cells around it have, the map decides, unless `check` is True: that is no
        proof for each point of it. All others are decided by the inverse model, which finds a configuration or not.
        """
        flat, lead = self._points(points)
        if check:
            return map_measures.reached(self.system, self.frame, flat, self.seed).reshape(lead)
        return map_measures.decided(self.system, self.frame, self.map, flat, self.seed).reshape(lead)

    def distance(self, points: ArrayLike) -> Array:
        """Distance (...) [m] of points (..., d) from the boundary of the map, negative outside.

        It is measured to the middle of the nearest boundary cell, so it may be off by half the diagonal of a cell
        (`resolution`), and by what the samples missed.
        """
        flat, lead = self._points(points)
        return map_measures.to_boundary(self.map, flat[:, self.map.grid.kept]).reshape(lead)

    @property
    def resolution(self) -> float:
        """Half the diagonal of a cell [m]."""
        return 0.5 * math.sqrt(sum(x * x for x in self.map.cell))

    def _points(self, points: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        x, dim = reals(points, "points"), self.system.dim
        if x.ndim == 0 or x.shape[-1] != dim:
            raise InputError(f"points have shape {x.shape}; they must be (..., {dim})")
        flat = np.zeros((math.prod(x.shape[:-1]), 3))
        flat[:, :dim] = x.reshape(-1, dim)
        return flat, x.shape[:-1]

    @cached_property
    def boundary(self) -> Any:
        """The boundary of the cells with samples, in metres.

        In the plane a list of closed lines (k, 2), in space a surface as corners (k, 3) and triangles (m, 3) by number
        (marching cubes), on a line the ends. Errors: `MissingExtraError` without the extra [scale].
        """
        return map_measures.boundary_of(self.map)

    # ---- files and pictures

    def save(self, path: str | Path) -> Path:
        """The path, to which the map is written as Zarr: `kempe.open_workspace` and xarray read it."""
        path = Path(path)
        toml = description_of(self.system)
        write_map(path, Stored(self.map, self.samples, self.outside, self.left_out, self.said, toml))
        return path

    def plot(self, at: Any = None, ax: Any = None) -> Any:
        """Matplotlib axes with the map; see `kempe.views.workspace_plot.plot_workspace`."""
        from kempe.views.workspace_plot import plot_workspace

        return plot_workspace(self, at, ax)

    # ---- in words

    @property
    def status(self) -> str:
        """How much was drawn, and how many cells it fell into."""
        found, of = int(self.map.occupied.sum()), self.map.counts.size
        left = f" ({self.requested:.6g} were requested)" if self.samples < self.requested else ""
        edges = " x ".join(f"{1e3 * x:.4g}" for x in self.map.cell)
        return (
            f"{self.samples:.6g} samples{left} of frame {self.frame!r} fell into {found} of {counted(of, 'cell')} of "
            f"{edges} mm: each of these holds a point that is reached"
        )

    def _cells(self) -> Cells:
        grid = self.map.grid
        name, unit = MEASURES[len(grid.axes)]
        value, error = self._measure
        box = ", ".join(f"{a} {grid.low[k]:.6g} to {grid.high[k]:.6g} m" for a, k in zip(grid.axes, grid.kept,
                                                                                        strict=True))  # fmt: skip
        rows = [("box", box), (name, f"{value:.6g} +- {error:.2g} {unit}, estimated with the inverse model")]
        rows += [("outside the box", counted(self.outside, "sample"))] * bool(self.outside)
        rows += [("left out", f"{counted(self.left_out, 'sample')} that could not be closed within all limits and "
                  "constraints")] * bool(self.left_out)  # fmt: skip
        rows += [("redone", f"{counted(self.redone, 'part')} that was damaged on disk")] * bool(self.redone)
        return (), rows

    def _data(self) -> dict[str, Any]:
        grid, (name, _) = self.map.grid, MEASURES[len(self.map.grid.axes)]
        value, error = self._measure
        box = {a: [grid.low[k], grid.high[k]] for a, k in zip(grid.axes, grid.kept, strict=True)}
        numbers = {k: getattr(self, k) for k in ("samples", "requested", "outside", "left_out", "seed", "redone")}
        return {"system": self.system.name, "frame": self.frame, "box": box, "cells": list(grid.shape),
                "occupied": int(self.map.occupied.sum()), name: value, f"{name}_error": error, **numbers,
                "kernels": self.said["variant"], "version": self.said["version"]}  # fmt: skip


@explained
def open_workspace(path: str | Path, system: System | None = None) -> Workspace:
    """The `Workspace` that was written to a path.

    The system is read from the map itself, or given. Errors: `InputError` where there is no map, where it is of another
    system, or where it has none in it and none is given; `DamagedError` where the file is not what was written.
    """
    stored = read_map(Path(path))
    if system is None:
        if stored.toml is None:
            raise InputError(f"{path} does not hold its system, which no file can describe: give it, too")
        from kempe.description.source import collecting_later
        from kempe.description.toml.toml import read_toml

        with collecting_later():
            system = read_toml(stored.toml).build()
    refuse_other(stored.said, {"system": system.structure.content_hash}, str(path))
    return of_stored(system, stored, stored.samples)


def of_stored(system: System, stored: Stored, requested: int, **ended: Any) -> Workspace:
    """The answer that a stored map is."""
    numbers = stored.samples, requested, stored.outside, stored.left_out
    return Workspace(system, stored.said["frame"], stored.map, *numbers, stored.said, **ended)
