"""Capability maps: in how many directions a frame reaches each cell of a box, and how well.

Source: Zacharias, Borst, Hirzinger, "Capturing robot workspace structure: representing robot
capabilities", IROS 2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.targets import Z_AXIS, make_rotations_along, make_target_constraints
from kempe.arguments import explain_errors, explain_method_errors, numbers, raise_interrupted
from kempe.arrays import is_sequence, is_whole
from kempe.budget import Budget, Usual
from kempe.errors import InputError, TimeLimitError
from kempe.geometry.path_clearance import read_clearances
from kempe.late import import_late_member
from kempe.numerics.clock import LONG
from kempe.numerics.directions import spread_directions
from kempe.spaces.task_space import task_space
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import format_count
from kempe.workspace.reach import MOST, UNKNOWN, Study, refuse_many_poses, study_places

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.constraints.base import Constraint
    from kempe.model.model import FrameLike, Model

USUAL = Usual("reach.capability", starts=32, rng=0, threads=None, progress=None, time_limit=LONG)


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class CapabilityMap(Study):
    """Map of how well a frame reaches the cells of a box, by inverse kinematics at their centres.

    Attributes
    ----------
    axes
        Coordinates of the centres in metres, along each axis.
    fraction
        Share of the poses that are reached, for each cell.
    solutions
        Mean number of solutions inside the limits; NaN if infinite or not certain.
    manipulability, margin
        Best values found; NaN where no pose is reached.
    directions
        Directions (d, 3) of the frame's z axis, in the plane of its x axis.
    rolls
        Angles about each direction; empty if the angle is free.
    reached
        Mask (cells, d, rolls) of the reached poses.
    broken
        Reason if the time limit or an interrupt ended the work; the remaining cells are NaN.
    """

    _pictured = True
    _entries = (
        "system",
        "frame",
        "axes",
        "directions",
        "rolls",
        "fraction",
        "solutions",
        "manipulability",
        "margin",
    )

    system: Model
    frame: str
    axes: tuple[Array, ...]
    directions: Array
    rolls: Array | None
    reached: np.ndarray
    fraction: Array
    solutions: Array
    manipulability: Array
    margin: Array
    broken: Status | None = None

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `NOT_FOUND` if no cell is reached, or the reason why the map ended early."""
        return self.broken or (Status.SOLVED if self.fraction.any() else Status.NOT_FOUND)

    @property
    def status(self) -> str:
        """The number of cells that are reached at all and in all directions, as a sentence."""
        some = int((self.fraction > 0.0).sum())
        whole = int((self.fraction == 1.0).sum())
        cells = format_count(int(np.isfinite(self.fraction).sum()), "cell")
        directions = format_count(len(self.directions), "direction")
        said = (
            f"{self._subject}: {some} of {cells} reached, {whole} in all {directions}{self._tail}"
        )
        return said if some or not self._no_reach_reason else f"{said}; {self._no_reach_reason}"

    @cached_property
    def _no_reach_reason(self) -> str:
        """The reason why no direction is reached anywhere, if the frame has too few freedoms, else
        ''.
        """
        system = self.system
        name = self.frame
        free = self.rolls is None and self.system.dim == 3
        task = "position_axis" if free else "pose"
        try:
            found = task_space(system, make_target_constraints(name, task, Z_AXIS, np.eye(4)))
        except TimeLimitError:
            return ""
        if found.generic_rank >= found.m:
            return ""
        what = "a position and a direction have" if free else "a pose has"
        return (
            f"{what} {found.m} equations, but this frame has only "
            f"{format_count(found.generic_rank, 'freedom')}: give the directions that it can take"
        )

    def plot(self, ax: Axes | None = None, height: float | None = None) -> Axes:
        """Draw the reached fraction over x and y in Matplotlib axes.

        It is that of the layer of cells nearest to a height, by default the middle.
        """
        return import_late_member("plots of workspaces").plot_capability(self, ax, height)


@explain_errors
@raise_interrupted
def capability_map(
    system: Model,
    frame: FrameLike,
    box: ArrayLike,
    cells: int | tuple[int, ...] = 10,
    directions: int | ArrayLike = 32,
    rolls: int | None = None,
    *,
    clearance: Constraint | Sequence[Constraint] | None = None,
    budget: Budget | None = None,
) -> CapabilityMap:
    """Map in how many directions a frame reaches each cell of a box, and how well.

    `box` is the pair of its corners (2, 3), in the plane (2, 2), in metres, cut into so many
    `cells` along each axis. `directions` are that many, spread evenly, or vectors (d, 3), in the
    plane (d, 2). With `rolls` each is tried at that many angles about it, as a pose, and solutions
    are counted where the chain has finitely many. With a `clearance` only those count that keep it.
    Of the `budget` are read: starts (32), rng (0),
    threads, progress, time_limit (600 s); after that the map has what was done, after Ctrl-C the
    `answer` of the `Interrupted`. Errors: `InputError`, `UnknownNameError`.
    """
    spend = USUAL.complete_budget(budget)
    name = system.structure.frame_name(frame)
    dim = system.dim
    axes = _read_cells(box, cells, dim)
    d = _read_directions(directions, dim)
    if rolls is not None and (dim == 2 or not is_whole(rolls) or not 1 <= int(rolls) <= 360):
        raise InputError(
            f"rolls is {rolls!r}; it must be a whole number from 1 to 360, in space, or None"
        )
    shape = tuple(len(a) for a in axes)
    angles = None if rolls is None else 2.0 * np.pi * np.arange(int(rolls)) / int(rolls)
    R = _make_rotations(d, angles, dim)
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    refuse_many_poses(len(centres) * len(R), "cells or directions")
    task = None if dim == 2 or rolls is not None else "position_axis"

    def make_targets(first: int, last: int) -> Array:
        """Make the poses of all directions at the cells `first` to `last`."""
        X = np.tile(np.eye(4), (last - first, len(R), 1, 1))
        X[..., :3, :3] = R
        X[..., :dim, 3] = centres[first:last, None]
        return X

    clearances = () if clearance is None else tuple(read_clearances(clearance))
    names = ("reached", "solutions", "manipulability", "margin")
    (share, solutions, w, far), broken = study_places(
        system, name, task, make_targets, (len(centres), len(R)), names, spend, clearances
    )
    hit = share == 1.0
    mean = np.where((solutions == UNKNOWN).any(axis=1), np.nan, solutions.mean(axis=1))
    best = [
        np.where(hit.any(axis=1), np.max(np.where(hit, x, -np.inf), axis=1), np.nan)
        for x in (w, far)
    ]
    return CapabilityMap(
        system,
        name,
        axes,
        d,
        angles,
        hit.reshape(*shape, len(d), -1),
        share.mean(axis=1).reshape(shape),
        mean.reshape(shape),
        best[0].reshape(shape),
        best[1].reshape(shape),
        broken,
    )


def _read_cells(box: ArrayLike, cells: Any, dim: int) -> tuple[Array, ...]:
    """Read the box and return the centres of its cells along each axis. Errors: `InputError`."""
    corners = numbers(box, "box")
    if (
        corners.shape != (2, dim)
        or not np.isfinite(corners).all()
        or not (corners[0] < corners[1]).all()
    ):
        raise InputError(
            f"box has shape {corners.shape}; it must be two corners (2, {dim}), the lower one first"
        )
    counts: tuple[Any, ...] = tuple(cells) if is_sequence(cells) else (cells,) * dim
    if len(counts) != dim or not all(is_whole(n) and 1 <= int(n) <= MOST for n in counts):
        raise InputError(f"cells is {cells!r}; it must be a whole number from 1, or {dim} of them")
    return tuple(
        low + (np.arange(int(n)) + 0.5) * (high - low) / int(n)
        for low, high, n in zip(*corners, counts, strict=True)
    )


def _read_directions(directions: Any, dim: int) -> Array:
    """Read directions as unit vectors (d, 3). Errors: `InputError`."""
    if is_whole(directions):
        if not 1 <= int(directions) <= MOST:
            raise InputError(f"directions is {directions}; it must be at least 1")
        if dim == 3:
            return spread_directions(int(directions))
        turn = 2.0 * np.pi * np.arange(int(directions)) / int(directions)
        return np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])
    d = numbers(directions, "directions")
    if d.ndim != 2 or d.shape[1] != dim or not len(d):
        raise InputError(f"directions has shape {d.shape}; it must be (d, {dim}), or their number")
    size = np.linalg.norm(d, axis=1, keepdims=True)
    if not (np.isfinite(d).all() and (size > 0.0).all()):
        raise InputError("directions must be finite, and not zero")
    out = np.zeros((len(d), 3))
    out[:, :dim] = d / size
    return out


def _make_rotations(d: Array, angles: Array | None, dim: int) -> Array:
    """Make rotations (k, 3, 3) of the tool, with all angles about each direction in turn."""
    if dim == 2:
        zero = np.zeros(len(d))
        one = np.ones(len(d))
        return np.stack(
            [d, np.column_stack([-d[:, 1], d[:, 0], zero]), np.column_stack([zero, zero, one])],
            axis=-1,
        )
    R = make_rotations_along(d)
    if angles is None:
        return R
    c = np.cos(angles)
    s = np.sin(angles)
    about = np.zeros((len(angles), 3, 3))
    about[:, 0, 0], about[:, 0, 1], about[:, 1, 0], about[:, 1, 1], about[:, 2, 2] = (
        c,
        -s,
        s,
        c,
        1.0,
    )
    return (R[:, None] @ about).reshape(-1, 3, 3)
