"""The answer of `workspace`: the places that a frame reaches, their measure and their boundary.

It holds counts of random configurations in cells, and bounds of what can be reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import read_reals
from kempe.description.source import expand_path
from kempe.errors import InputError, MissingExtraError, UnsupportedError
from kempe.forward.fk import jacobian
from kempe.late import call_late_function, import_late_member
from kempe.report import Report, Table
from kempe.spaces.task_space import compute_image_ranks
from kempe.spatial import Array
from kempe.status import Status
from kempe.units import METRE
from kempe.words import format_count, make_plural
from kempe.workspace.cell_map import CellMap, Grid
from kempe.workspace.kinds import (
    DEXTEROUS,
    ORIENTATION,
    REACHABLE,
    WorkspaceKind,
    compute_rotation_coordinates,
    read_rotations,
)
from kempe.workspace.legs import list_place_bounds
from kempe.workspace.planar.planar_workspace import (
    PlanarWorkspace,
    PlaneCurve,
    compute_planar_workspace,
)
from kempe.workspace.planar.swept_solids import SweptSolid, find_swept_solid
from kempe.workspace.sampling_job import sample_closed_configurations
from kempe.workspace.store import refuse_other_map
from kempe.workspace.stored_map import SampleCounts, read_map, write_map

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- measure and boundary of what is reached

# The map and the inverse model are used together.

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


def estimate_measure(
    system: Model,
    frame: str,
    cells: CellMap,
    seed: int,
    workspace_kind: WorkspaceKind,
    possible: np.ndarray,
) -> tuple[float, float]:
    """Estimate the measure of the reached part of the box, with `SIGMAS` standard errors.

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
            points = _sample_in_cells(cells, rng.choice(chosen, POINTS[name]), rng)
            hits = int(workspace_kind.find_reached_points(system, frame, points, seed).sum())
            n = POINTS[name]
            whole = len(chosen) * cell
            part = (hits + 2.0) / (n + 4.0)
            value += whole * hits / n
            variance += whole**2 * part * (1.0 - part) / (n + 4.0)
    return value, SIGMAS * math.sqrt(variance)


def estimate_from_counts(cells: CellMap, samples: int, hits: int) -> tuple[float, float]:
    """Estimate the measure and its error from numbers of samples and hits. All cells have equally
    many samples.

    Cells of which each has its share make the error smaller than this one, which is that of places
    anywhere.
    """
    whole = math.prod(cells.cell) * cells.counts.size
    part = (hits + 2.0) / (samples + 4.0)
    error = SIGMAS * math.sqrt(part * (1.0 - part) / (samples + 4.0))
    return whole * hits / max(samples, 1), whole * error


def combine_estimates(found: list[tuple[float, float]]) -> tuple[float, float]:
    """Combine independent estimates (value, error) to one, weighted by their errors."""
    proven = [x for x in found if x[1] == 0.0]
    if proven:
        return proven[0]
    values = np.array([v for v, _ in found])
    weights = np.array([e**-2.0 for _, e in found])
    return float(values @ weights / weights.sum()), float(weights.sum() ** -0.5)


def _sample_in_cells(cells: CellMap, numbers: np.ndarray, rng: np.random.Generator) -> Array:
    """Sample random points (n, 3), one in each of the cells."""
    grid = cells.grid
    at = np.stack(np.unravel_index(numbers, grid.shape), axis=-1)
    return grid.complete_points(
        np.array(grid.low)[grid.measured_axes] + (at + rng.random(at.shape)) * grid.size
    )


def decide_reached_points(
    system: Model,
    frame: str,
    cells: CellMap,
    points: Array,
    seed: int,
    workspace_kind: WorkspaceKind,
) -> np.ndarray:
    """Decide whether points (n, 3) are reached, by the map in inner cells, else by inverse
    kinematics.
    """
    grid = cells.grid
    at, inside = grid.locate_cells(points[:, grid.measured_axes])
    off = [k for k in range(3) if k not in grid.measured_axes]
    middle = 0.5 * (np.array(grid.low) + grid.high)
    inside = inside & (np.abs(points - middle)[:, off] <= 1e-9 * (1.0 + np.abs(middle[off]))).all(
        axis=1
    )
    out = inside & cells.layers["inner"][tuple(at.T)]
    out[~out] = workspace_kind.find_reached_points(system, frame, points[~out], seed)
    return out


def compute_boundary_distance(
    system: Model,
    frame: str,
    cells: CellMap,
    points: Array,
    inside: np.ndarray,
    seed: int,
    workspace_kind: WorkspaceKind,
) -> Array:
    """Compute the distances [m] of points (n, 3) from the boundary, negative if not `inside`. NaN
    gives NaN.

    Outside it is that from the nearest cell with samples. Inside it is that from the nearest cell
    whose middle is not reached: a cell may be empty for lack of samples only, so the inverse model
    decides.
    """
    at = points[:, cells.grid.measured_axes]
    finite = np.isfinite(at).all(axis=1)
    out = np.where(np.isnan(at).any(axis=1), np.nan, -np.inf)
    edge = cast(Any, cells.edge)
    far = finite & ~inside
    out[far] = -edge.query(at[far])[0]
    near = np.flatnonzero(finite & inside)
    if workspace_kind.tried:  # a place of each cell was decided
        out[near] = edge.query(at[near])[0]
        return out
    known = np.where(cells.empty[1], UNREACHED, UNDECIDED)
    for k in range(0, len(near), AT_ONCE):
        which = near[k : k + AT_ONCE]
        out[which] = _compute_unreached_distance(
            cells,
            at[which],
            known,
            lambda p: workspace_kind.find_reached_points(
                system, frame, cells.grid.complete_points(p), seed
            ),
        )
    return out


def _compute_unreached_distance(
    cells: CellMap, points: Array, known: np.ndarray, reached: Callable[[Array], np.ndarray]
) -> Array:
    """Compute the distances (n,) of points (n, d) from the nearest unreached cell. Half the
    diagonal of the cell is subtracted.

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


def find_cell_boundary(cells: CellMap) -> Any:
    """Find the boundary between cells with and without samples, halfway between their centres. See
    `Workspace.boundary`.

    Errors: `MissingExtraError` without scikit-image.
    """
    grid = cells.grid
    filled = np.pad(cells.occupied, 1).astype(float)
    origin = np.array(grid.low)[grid.measured_axes] - 0.5 * grid.size
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


# ---- outer bounds

# What bounds of places leave of the cells of a box.

FINE = 2**18
"""Cells into which a box is cut at least, as far as halving brings them there."""


def compute_outer_measure(system: Model, frame: str, grid: Grid) -> float:
    """Compute an upper bound of the measure: the cells of a refined box that the frame may reach."""
    finer = max(1, int((FINE / grid.count) ** (1.0 / len(grid.axes))))
    left = np.count_nonzero(find_possible_cells(system, frame, grid, finer))
    return float(left) * float(np.prod(grid.size)) / finer ** len(grid.axes)


def find_possible_cells(system: Model, frame: str, grid: Grid, finer: int = 1) -> np.ndarray:
    """Find the cells of a refined box that the frame's origin may reach, as no bound excludes them."""
    near: list[tuple[Array, Array]] = []
    for k, (low, high, cells) in enumerate(zip(grid.low, grid.high, grid.cells, strict=True)):
        ends = (
            np.linspace(low, high, cells * finer + 1)
            if k in grid.measured_axes
            else np.full(2, 0.5 * (low + high))
        )
        near.append((ends[:-1], ends[1:]))
    left = np.ones([len(a) for a, _ in near], dtype=bool)
    for box, shells, slack in list_place_bounds(system, frame):
        x, y, z = (
            (b >= box[0, k] - slack) & (a <= box[1, k] + slack) for k, (a, b) in enumerate(near)
        )
        left &= x[:, None, None] & y[:, None] & z
        for shell in shells:
            least, most = (
                _compute_squared_distances(near, shell.centre, far) for far in (False, True)
            )
            left &= (least <= (shell.largest + slack) ** 2) & (
                most >= max(shell.smallest - slack, 0.0) ** 2
            )
    return left.reshape([n * finer for n in grid.shape])


def _compute_squared_distances(near: list[tuple[Array, Array]], centre: Array, far: bool) -> Array:
    """Compute squared distances (nx, ny, nz) of a centre from the nearest or farthest points of
    cells.
    """
    parts: list[Array] = []
    for (a, b), x in zip(near, centre, strict=True):
        ends = np.maximum(np.abs(a - x), np.abs(b - x))
        parts.append((ends if far else np.maximum(np.maximum(a - x, x - b), 0.0)) ** 2)
    return parts[0][:, None, None] + parts[1][:, None] + parts[2]


# ---- the answer

MEASURES = {1: ("length", "m"), 2: ("area", "m^2"), 3: ("volume", "m^3")}
"""What is measured in one, two and three dimensions, and its unit."""
LARGE = 1.0
"""Edge [m] of a cell from which on it is written in metres, below in millimetres."""
THIN = {0: "stays at points", 1: "moves on a curve", 2: "moves on a surface"}
LOOKED = 64
"""Configurations at which the dimension is found."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Workspace(Report):
    """Places that a frame reaches, as counts of random samples in the cells of a box.

    A cell with a sample contains a reached point, so the `map` is a lower bound. An empty cell may
    contain reached points, too. For the kind "orientation", points are orientations, and the
    measure is their angle, in space the volume of rotations (8 pi^2 in all).

    Attributes
    ----------
    requested, samples
        Numbers of requested and of drawn samples.
    outside
        Number of samples outside the box.
    left_out
        Number of samples that could not be closed, violated a constraint, or are not reached.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work; the map has the finished samples.
    """

    _pictured = True

    system: Model
    sample_counts: SampleCounts
    requested: int
    interrupted: bool = False
    late: bool = False
    redone: int = 0
    """1 where the map that was found on disk was damaged, and its samples were drawn again."""

    @property
    def metadata(self) -> dict[str, Any]:
        """The data that define the map, such as system, frame and grid."""
        return self.sample_counts.metadata

    @property
    def frame(self) -> str:
        """The name of the frame."""
        return str(self.metadata["frame"])

    @property
    def map(self) -> CellMap:
        """The number of samples in each cell."""
        return self.sample_counts.map

    @property
    def samples(self) -> int:
        """Number of samples drawn."""
        return self.sample_counts.samples

    @property
    def outside(self) -> int:
        """Number of samples outside the box."""
        return self.sample_counts.outside

    @property
    def left_out(self) -> int:
        """Number of samples that were not closed, violated a constraint, or were not reached."""
        return self.sample_counts.left_out

    @property
    def seed(self) -> int:
        """The seed of the random samples."""
        return int(self.metadata["seed"])

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `INTERRUPTED` or `OUT_OF_TIME` if fewer samples were drawn than requested."""
        return (
            Status.INTERRUPTED
            if self.interrupted
            else Status.OUT_OF_TIME
            if self.late
            else Status.SOLVED
        )

    # ---- how much

    @cached_property
    def workspace_kind(self) -> WorkspaceKind:
        """The kind of workspace: what counts as reached."""
        return WorkspaceKind.from_data(self.metadata)

    @property
    def kind(self) -> str:
        """Name of the kind: "reachable", "constant-orientation", "dexterous" or "orientation"."""
        return self.workspace_kind.kind

    @cached_property
    def exact(self) -> PlanarWorkspace | SweptSolid | None:
        """Workspace with its exact boundary, or None if the boundary is unknown.

        For planar systems it is the workspace of `System.reach.planar`. In space it is known for
        chains that move the frame in a plane, if a slide moves this plane across itself, or if a
        first joint without limits turns it about an axis in the plane. It is not used where it
        exceeds the box.
        """
        found = self._compute_exact()
        grid = self.map.grid
        dim = self.system.dim
        if found is None or len(grid.axes) != dim:
            return None
        low, high = found.extent
        return found if (low >= grid.low[:dim]).all() and (high <= grid.high[:dim]).all() else None

    @property
    def outline(self) -> tuple[PlaneCurve, ...]:
        """Curves that bound an exactly known planar workspace; () for other workspaces."""
        return self.exact.boundary if isinstance(self.exact, PlanarWorkspace) else ()

    def _compute_exact(self) -> PlanarWorkspace | SweptSolid | None:
        """Compute the exact workspace, or None if that is impossible."""
        if self.system.dim == 3:
            return find_swept_solid(self.system, self.frame) if self.kind == REACHABLE else None
        try:
            return compute_planar_workspace(self.system, self.frame, self.workspace_kind)
        except (UnsupportedError, InputError):
            return None

    @cached_property
    def dimension(self) -> int:
        """Dimension of the reached set: 1 for a curve, 2 for a surface, else that of the box.

        It is the rank of the frame's velocities at up to `LOOKED` random configurations. It is that
        of the box if no configuration was closed, and for kinds other than "reachable".
        """
        most = len(self.map.grid.axes)
        q, good = sample_closed_configurations(self.system, self.seed, 0, LOOKED)
        if self.kind != REACHABLE or not good.any():
            return most
        rates = jacobian(self.system, q[good], self.frame)[..., :3, :]
        return min(
            most,
            int(compute_image_ranks(self.system, q[good], rates, np.ones(3, dtype=bool))[0].max()),
        )

    @property
    def thin(self) -> bool:
        """Whether the reached set is a curve or surface (measure 0) in a box of more dimensions."""
        return self.dimension < len(self.map.grid.axes)

    @cached_property
    def measure(self) -> tuple[float, float]:
        """Length, area or volume [m, m^2, m^3] of the reached part of the box, with its error.

        It is the `estimate`. For an exactly known workspace it is the area or volume, with an error
        from rounding. For a planar platform, whose points are decided exactly, the area is sampled
        and the error is two standard errors.
        """
        return self.estimate if self.exact is None else self.exact.measure

    @cached_property
    def estimate(self) -> tuple[float, float]:
        """Measure of the workspace estimated from samples, with two standard errors.

        Inverse kinematics decides random points, more of them where the map changes. Points without
        a solution found count as not reached, so apart from chance the value is too small rather
        than too large. Cells that lengths and limits prove unreachable are left out. The error is 0
        if these are all cells, and for a workspace that is `thin`.
        """
        if self.thin:
            return 0.0, 0.0
        wanted = self.workspace_kind
        found: list[tuple[float, float]] = []
        if wanted.tried:
            found.append(estimate_from_counts(self.map, self.samples, int(self.map.counts.sum())))
        if wanted.kind != DEXTEROUS:  # there one point costs as much as hundreds of others
            possible = np.ones(self.map.counts.shape, dtype=bool)
            if wanted.kind != ORIENTATION:
                possible = find_possible_cells(self.system, self.frame, self.map.grid)
            found.append(
                estimate_measure(self.system, self.frame, self.map, self.seed, wanted, possible)
            )
        value, error = combine_estimates(found)
        return min(value, self._outer), error

    @cached_property
    def _outer(self) -> float:
        """An upper bound of the measure in the box, from lengths and limits."""
        if self.kind == ORIENTATION:
            return math.prod(self.map.cell) * self.map.counts.size
        return compute_outer_measure(self.system, self.frame, self.map.grid)

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound of the measure in the box.

        The lower bound is the value less its error: every counted point is reached, so only the
        random choice of points can make it too large (in one of 40 cases). The upper bound is
        proven by lengths and limits. For an exact workspace the bounds are the value and its error.
        """
        value, error = self.measure
        if self.exact is not None or self.thin:
            return value - error, value + error
        return max(value - error, 0.0), self._outer

    def _check_dimension(self, dimension: int) -> tuple[float, float]:
        """Return the measure if the box has this dimension. Errors: `InputError`."""
        axes = self.map.grid.axes
        if len(axes) != dimension:
            has = MEASURES[len(axes)][0]
            what = "turns by" if self.kind == ORIENTATION else "moves along"
            raise InputError(f"{self.frame!r} {what} {', '.join(axes)}: the measure is its {has}")
        return self.measure

    @property
    def volume(self) -> tuple[float, float]:
        """Volume of the reached part of the box, and its error [m^3]; see `estimate`."""
        return self._check_dimension(3)

    @property
    def area(self) -> tuple[float, float]:
        """Area of the reached part of the box, and its error [m^2]; see `estimate`."""
        return self._check_dimension(2)

    @property
    def length(self) -> tuple[float, float]:
        """Length of the reached part of a line, and its error [m]; see `estimate`."""
        return self._check_dimension(1)

    # ---- single points

    def contains(self, points: ArrayLike, check: bool = False) -> np.ndarray:
        """Determine which points are reached.

        Parameters
        ----------
        points
            Points (..., d) in the ground frame in metres, d = 2 or 3. For the kind "orientation",
            rotations (..., 3, 3), in the plane also angles (...).
        check
            Decide all points by inverse kinematics.

        Returns
        -------
        Array
            Mask (...) of the reached points.

        Notes
        -----
        The `exact` workspace decides where it is known. Otherwise the map decides in a cell with
        samples that is surrounded by such cells, which proves nothing for a single point. Inverse
        kinematics decides all other points.
        """
        flat, lead = self._read_points(points)
        if self.exact is not None and not check:
            found = self.exact.contains(flat)
        elif check:
            found = self.workspace_kind.find_reached_points(
                self.system, self.frame, flat, self.seed
            )
        else:
            found = decide_reached_points(
                self.system, self.frame, self.map, flat, self.seed, self.workspace_kind
            )
        return found.reshape(lead)

    def distance(self, points: ArrayLike) -> Array:
        """Compute the distances of points from the boundary of the workspace.

        Parameters
        ----------
        points
            Points (..., d) in the ground frame in metres.

        Returns
        -------
        Array
            Distances (...) in metres, negative outside.

        Raises
        ------
        UnsupportedError
            For workspaces of orientations.

        Notes
        -----
        The boundary is the `exact` one, or that of the map. With a map, the distance inside is that
        to the nearest cell that is not reached, and outside that to the nearest reached cell. It
        may differ by half the diagonal of a cell (`resolution`), and outside also by what the
        samples missed. Inside, inverse kinematics decides cells without samples.
        """
        if self.kind == ORIENTATION:
            raise UnsupportedError("distances are those of places, not of orientations")
        flat, lead = self._read_points(points)
        if self.exact is not None:
            return (
                self.exact.distance(flat) * np.where(self.exact.contains(flat), 1.0, -1.0)
            ).reshape(lead)
        workspace_kind = self.workspace_kind
        inside = np.asarray(self.contains(points)).reshape(-1)
        far = compute_boundary_distance(
            self.system, self.frame, self.map, flat, inside, self.seed, workspace_kind
        )
        return far.reshape(lead)

    @property
    def resolution(self) -> float:
        """Half the diagonal of a cell [m]."""
        return 0.5 * math.sqrt(sum(x * x for x in self.map.cell))

    def _read_points(self, points: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Read points (..., d), or orientations as points. Errors: `InputError`."""
        if self.kind == ORIENTATION:
            R = read_rotations(points, self.system.dim, "points")
            return compute_rotation_coordinates(R, self.system.dim).reshape(-1, 3), R.shape[:-2]
        x = read_reals(points, "points")
        dim = self.system.dim
        if x.ndim == 0 or x.shape[-1] != dim:
            raise InputError(f"points have shape {x.shape}; they must be (..., {dim})")
        flat = np.zeros((math.prod(x.shape[:-1]), 3))
        flat[:, :dim] = x.reshape(-1, dim)
        return flat, x.shape[:-1]

    @cached_property
    def boundary(self) -> Any:
        """Boundary of the cells with samples, in metres.

        In the plane it is a list of closed lines (k, 2); in space a surface as corners (k, 3) and
        triangles (m, 3) of their numbers (marching cubes); on a line the ends. `MissingExtraError`
        without the extra [scale].
        """
        return find_cell_boundary(self.map)

    # ---- files and pictures

    def save(self, path: str | Path) -> Path:
        """Write the map to a path as Zarr, and return the path.

        `kempe.open_workspace` and xarray read it.
        """
        path = expand_path(path)
        write_map(path, self.system, self.sample_counts)
        return path

    def plot(self, at: Any = None, ax: Any = None) -> Any:
        """Draw the map in Matplotlib axes; see `kempe.views.workspace_plot.plot_workspace`."""
        return import_late_member("plots of workspaces").plot_workspace(self, at, ax)

    # ---- in words

    @property
    def status(self) -> str:
        """What is known exactly, then the numbers of samples and of cells with samples."""
        ring = self.exact.ring if isinstance(self.exact, PlanarWorkspace) else ""
        return f"{ring}, exactly; {self._describe_samples()}" if ring else self._describe_samples()

    def _describe_samples(self) -> str:
        """Describe the number of samples, and of cells with samples."""
        found = int(self.map.occupied.sum())
        of = self.map.counts.size
        wanted = self.workspace_kind
        left = f" ({self.requested:.6g} were requested)" if self.samples < self.requested else ""
        unit = self.system.unit
        small = unit == METRE and max(self.map.cell) < LARGE
        part, unit = (1e3, "mm") if small else (1.0, unit)
        edges = " x ".join(f"{part * x:.4g}" for x in self.map.cell)
        size = "" if self.kind == ORIENTATION else f" of {edges} {unit}"
        cells = (
            f"{found} of {format_count(of, 'cell')}{size}: each of these holds a point that is "
            "reached"
        )
        if not wanted.tried:
            return (
                f"{self.samples:.6g} {make_plural(self.samples, 'sample')}{left} of frame "
                f"{self.frame!r} fell into {cells}"
            )
        many = f" in all {len(wanted.turns)} orientations" if len(wanted.turns) > 1 else ""
        hits = int(self.map.counts.sum())
        return (
            f"{self.kind}: {hits} of {format_count(self.samples, wanted.noun)}{left} that were "
            f"tried are reached by frame {self.frame!r}{many}, in {cells}"
        )

    def _make_tables(self) -> Sequence[Table]:
        grid = self.map.grid
        (name, unit) = MEASURES[len(grid.axes)]
        (value, error) = self.measure
        (low, high) = self.bounds
        unit = unit.replace("m", self.map.unit)
        box = ", ".join(
            f"{a} {grid.low[k]:.6g} to "
            f"{grid.high[k]:.6g}{'' if a == 'height' else f' {self.map.unit}'}"
            for a, k in zip(grid.axes, grid.measured_axes, strict=True)
        )
        if self.exact is not None:
            said = [(name, f"{value:.9g} {unit}, exact but for rounding")]
            if isinstance(self.exact, PlanarWorkspace) and self.exact.error:
                sampled = f"{value:.5g} +- {error:.2g} {unit}, by samples that are decided exactly"
                said = [(name, sampled)]
        elif self.thin:
            said = [(name, f"0 {unit}: the frame {THIN[self.dimension]}, as its velocities say")]
        elif not high:
            said = [(name, f"0 {unit}, proven by lengths and limits")]
        else:
            least = f"at least {low:.6g} {unit} (confidence 97.5 %)"
            most = f"at most {high:.6g} {unit} by lengths and limits"
            said = [
                (name, f"{value:.6g} +- {error:.2g} {unit}, estimated with the inverse model"),
                ("bounds", f"{least}, {most}"),
            ]
        rows = [("box", box), *said]
        rows += [("outside the box", format_count(self.outside, "sample"))] * bool(self.outside)
        rows += [
            (
                "left out",
                f"{format_count(self.left_out, 'sample')} that could not be closed within all "
                "limits and constraints",
            )
        ] * bool(self.left_out and not self.workspace_kind.tried)
        rows += [("redone", "the map on disk was damaged")] * bool(self.redone)
        return [Table((), rows, record=True)]

    def _collect_data(self) -> dict[str, Any]:
        grid = self.map.grid
        (name, _) = MEASURES[len(self.map.grid.axes)]
        value, error = self.measure
        box = {
            a: [grid.low[k], grid.high[k]]
            for a, k in zip(grid.axes, grid.measured_axes, strict=True)
        }
        numbers = {
            k: getattr(self, k)
            for k in ("samples", "requested", "outside", "left_out", "seed", "redone")
        }
        return {
            "system": self.system.name,
            "frame": self.frame,
            "kind": self.kind,
            "box": box,
            "cells": list(grid.shape),
            "occupied": int(self.map.occupied.sum()),
            "exact": self.exact is not None,
            name: value,
            f"{name}_error": error,
            f"{name}_bounds": list(self.bounds),
            **numbers,
            "kernels": self.metadata["variant"],
            "version": self.metadata["version"],
        }


@explain_errors
def open_workspace(path: str | Path, system: Model | None = None) -> Workspace:
    """Open the `Workspace` that was written to a path.

    The system is read from the map itself, or given. Errors: `InputError` where there is no map,
    where it is of another system, or where it has none in it and none is given; `DamagedError`
    where the file is not what was written.
    """
    samples, toml = read_map(expand_path(path))
    if system is None:
        if toml is None:
            raise InputError(
                f"{path} does not hold its system, which no file can describe: give it, too"
            )
        from kempe.description.source import pause_garbage_collection
        from kempe.description.toml_reader import read_toml

        with pause_garbage_collection():
            own: Model = call_late_function("System", read_toml(toml))
            system = own
    refuse_other_map(samples.metadata, {"system": system.structure.content_hash}, str(path))
    return Workspace(system, samples, samples.samples)
