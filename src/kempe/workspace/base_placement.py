"""Base placement: where to put the base so that a frame reaches all poses of a list."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arguments import (
    check_name,
    explain_errors,
    explain_method_errors,
    numbers,
    raise_interrupted,
)
from kempe.arrays import is_mapping, is_whole
from kempe.budget import Budget, Usual
from kempe.errors import InputError
from kempe.late import import_late_member
from kempe.numerics.clock import LONG
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import Quantity, format_count
from kempe.workspace.reach import MOST, Study, check_targets, refuse_many_poses, study_places

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike, Model

USUAL = Usual("reach.place", starts=64, rng=0, threads=None, progress=None, time_limit=LONG)
AXES = ("x", "y", "z", "yaw")


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class BasePlacement(Study):
    """Map of base placements with the reached poses of a list.

    Attributes
    ----------
    axes
        Values of the base coordinates along each axis of the map, by name.
    fixed
        Base coordinates that are the same everywhere.
    fraction
        Share of the poses that are reached, over the axes.
    margin, manipulability
        Least values of the poses, over the axes; NaN where a pose is not reached.
    broken
        Reason if the time limit or an interrupt ended the work; the remaining places are NaN.
    """

    _pictured = True
    _has_angles = True
    _entries = ("system", "frame", "poses", "axes", "fixed", "fraction", "margin", "manipulability")

    system: Model
    frame: str
    poses: int
    axes: dict[str, Array]
    fixed: dict[str, float]
    fraction: Array
    margin: Array
    manipulability: Array
    broken: Status | None = None

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `SOLVED` if all poses are reached from some place, `PARTLY` if some are."""
        most = float(np.nan_to_num(self.fraction).max())
        if self.broken is not None and most < 1.0:
            return self.broken
        return Status.SOLVED if most == 1.0 else Status.PARTLY if most > 0.0 else Status.NOT_FOUND

    @cached_property
    def order(self) -> np.ndarray:
        """Indices of the places in the flat map, the best first.

        Best is more poses, then a larger margin, then larger manipulability.
        """
        rest = [
            np.nan_to_num(x.ravel(), nan=-1.0, posinf=1e9)
            for x in (self.manipulability, self.margin)
        ]
        return np.lexsort((*rest, np.nan_to_num(self.fraction.ravel(), nan=-1.0)))[::-1]

    def place(self, rank: int = 0) -> dict[str, float]:
        """Return x, y, z [m] and yaw [rad] of the base at the place of a `rank`; 0 is the best.

        Errors: `InputError`.
        """
        if not 0 <= rank < self.fraction.size:
            raise InputError(
                f"rank is {rank}; there are {format_count(self.fraction.size, 'place')}, from 0"
            )
        index = np.unravel_index(int(self.order[rank]), self.fraction.shape)
        here = {n: float(v[i]) for (n, v), i in zip(self.axes.items(), index, strict=True)}
        return {n: here.get(n, self.fixed.get(n, 0.0)) for n in AXES}

    @property
    def best(self) -> Array:
        """Pose (4, 4) of the system's ground frame at the best place."""
        return compute_base_poses(np.array([list(self.place().values())]))[0]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the reached fraction over the first two axes in Matplotlib axes.

        The other axes are at the best place.

        Over a single axis it is a curve.
        """
        return import_late_member("plots of workspaces").plot_placement(self, ax)

    @property
    def status(self) -> str:
        """The number of poses reached from the best place, and that place, as a sentence."""
        n = round(float(np.nan_to_num(self.fraction).max()) * self.poses)
        where = ", ".join(f"{k} = {v:.4g}" for k, v in self.place().items() if k in self.axes)
        full = int((self.fraction == 1.0).sum())
        tried = format_count(int(np.isfinite(self.fraction).sum()), "place")
        if not n:
            none = f"none of {format_count(self.poses, 'pose')} reached from any of {tried}"
            return f"{self._subject}: {none}{self._tail}"
        some = f"{n} of {format_count(self.poses, 'pose')} reached from the best place ({where})"
        return f"{self._subject}: {some}; all from {full} of {tried}{self._tail}"

    def _collect_data(self) -> dict[str, Any]:
        placed = {"axes": self.axes, "fixed": self.fixed, "best": self.place()}
        return super()._collect_data() | {
            name: _attach_units(values) for name, values in placed.items()
        }


def _attach_units(values: Mapping[str, Any]) -> dict[str, Quantity]:
    """Attach units to numbers x, y, z [m] and yaw [rad]."""
    return {n: Quantity(x, "rad" if n == "yaw" else "m") for n, x in values.items()}


def compute_base_poses(places: Array) -> Array:
    """Compute poses (k, 4, 4) of places (k, 4): x, y, z in metres and yaw in radians."""
    full = np.zeros((len(places), 6))
    full[:, [0, 1, 2, 5]] = places
    return spatial.pose_from_xyz_rpy(full)


@explain_errors
@raise_interrupted
def place_base(
    system: Model,
    targets: ArrayLike,
    frame: FrameLike,
    box: Mapping[str, Any],
    cells: int | Mapping[str, int] = 11,
    *,
    task: str | tuple[str, ArrayLike] | None = None,
    budget: Budget | None = None,
) -> BasePlacement:
    """Map the places of the base from which a frame reaches the fixed `targets` (n, 4, 4).

    The `box` names coordinates of the base, "x", "y", "z" in metres and "yaw" in radians, with a
    pair (low, high) that is tried at so many `cells` values (one number, or a dict by name), or
    with one number; those not named are 0. Of the `budget` are read: starts (64), rng (0), threads,
    time_limit (600 s), and progress(poses tried, all). After the time limit the map has what was
    done, after Ctrl-C the `answer` of the
    `Interrupted`. Errors: `InputError`, `UnknownNameError`.
    """
    spend = USUAL.complete_budget(budget)
    name = system.structure.frame_name(frame)
    X = numbers(targets, "targets")
    if X.ndim != 3 or X.shape[1:] != (4, 4) or not len(X):
        raise InputError(
            f"targets have shape {X.shape}; they must be poses (n, 4, 4), at least one"
        )
    X = check_targets(X)
    axes, fixed = _read_axes(system, box, cells)
    shape = tuple(len(v) for v in axes.values())
    refuse_many_poses(int(np.prod(shape)) * len(X), "cells")
    grid = np.meshgrid(*axes.values(), indexing="ij")
    places = np.zeros((int(np.prod(shape)), 4))
    for i, n in enumerate(AXES):
        places[:, i] = grid[list(axes).index(n)].ravel() if n in axes else fixed.get(n, 0.0)

    def compute_targets(first: int, last: int) -> Array:
        """Compute the targets as seen from places `first` to `last` of the base."""
        return spatial.inverse(compute_base_poses(places[first:last]))[:, None] @ X

    (hit, far, w), broken = study_places(
        system,
        name,
        task,
        compute_targets,
        (len(places), len(X)),
        ("reached", "margin", "manipulability"),
        spend,
    )
    over = (hit.mean(axis=1), far.min(axis=1), w.min(axis=1))
    fraction, least_margin, least_w = (x.reshape(shape) for x in over)
    return BasePlacement(system, name, len(X), axes, fixed, fraction, least_margin, least_w, broken)


def _read_axes(
    system: Model, box: Mapping[str, Any], cells: Any
) -> tuple[dict[str, Array], dict[str, float]]:
    """Read the variable coordinates of the base with their values, and the fixed ones. Errors:
    `InputError`.
    """
    allowed = AXES if system.dim == 3 else tuple(n for n in AXES if n != "z")
    axes: dict[str, Array] = {}
    fixed: dict[str, float] = {}
    for name, value in box.items():
        check_name("coordinate of the base", name, allowed, system.name)
        v = numbers(value, f"box: {name}")
        if not np.isfinite(v).all() or v.shape not in ((), (2,)) or (v.shape and not v[0] < v[1]):
            raise InputError(
                f"box has {name} = {value!r}; it must be a number, or a pair (low, high) of finite "
                "numbers"
            )
        if v.shape == ():
            fixed[name] = float(v)
            continue
        n: Any = cells.get(name, 11) if is_mapping(cells) else cells
        if not is_whole(n) or not 1 <= int(n) <= MOST:
            raise InputError(
                f"cells has {name} = {n!r}; it must be a whole number, from 1 to {MOST}"
            )
        axes[name] = np.linspace(v[0], v[1], int(n)) if n > 1 else v.mean(keepdims=True)
    if not axes:
        raise InputError("box names no range to try, such as {'x': (-1, 1), 'y': (-1, 1)}")
    return {n: axes[n] for n in AXES if n in axes}, fixed
