"""Random samples of a workspace, counted in cells.

The counts of any range of samples follow from the recipe alone, wherever they are made.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.assemble.assemble import assemble
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError
from kempe.forward.fk import fk, pack_chain
from kempe.kernels.compiled import VARIANT, lane_positions
from kempe.kernels.forward.table_layout import Q_INDEX, get_row_integers
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import (
    compute_mid_configuration,
    compute_sampling_box,
    find_free_angles,
    has_loops,
    sample_configurations,
)
from kempe.spatial import Array
from kempe.version import __version__
from kempe.words import join_words
from kempe.workspace.cell_map import FEW_CELLS, USUAL_CELLS, Grid, count_cells, make_grid
from kempe.workspace.kinds import ORIENTATION, RANGES, TURNED, WorkspaceKind
from kempe.workspace.stored_map import AFTER
from kempe.workspace.workers import refuse_kernels, work_in_threads

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- the recipe

PIECE = 2**20
SLOW_PIECE = 1024
TRIED_PIECE = 64
"""Samples that one thread counts before it looks up: by the kernel, with what closes loops or obeys
constraints, and of places that the inverse model decides."""
PART = 10**8
SLOW_PART = 10**5
TRIED_PART = 10**4
"""Samples of a part at least, a few seconds; of systems with loops or constraints; and of places."""
GOLDEN = 0.6180339887498949
PILOT = 2**17
SLOW_PILOT = 2**11
"""Samples whose positions say where the box is."""
NARROW_PILOT = (2**18, 2**14)
ENOUGH = 64
"""Samples at most, of trees and with loops, that are drawn for that until there are enough within
constraints."""
FEW_SAMPLES = 10**5, 10**7
"""Samples where none are requested: with loops or constraints, and without."""
FAR = 1e7
"""Coordinates from which on a limit is none: sines lose their digits there."""
PLAIN = WorkspaceKind()
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Recipe:
    """Recipe of a map: system, frame, seed, grid and kind of workspace. They determine the counts
    of samples number `first` to `last`.

    `variant` are the kernels that make them: others round otherwise, and are refused.
    """

    system: Model
    frame: str
    seed: int
    grid: Grid
    variant: str = VARIANT
    version: str = __version__
    workspace_kind: WorkspaceKind = PLAIN

    def __reduce__(self) -> tuple[Any, ...]:
        return Recipe, (
            self.system,
            self.frame,
            self.seed,
            self.grid,
            self.variant,
            self.version,
            self.workspace_kind,
        )

    @cached_property
    def unconstrained(self) -> bool:
        """Whether samples are independent coordinates, without loops or declared constraints."""
        return is_plain_chain(self.system) and not self.workspace_kind.tried

    @property
    def piece_size(self) -> int:
        """Number of samples that one thread counts at once."""
        return (
            PIECE
            if self.unconstrained
            else TRIED_PIECE
            if self.workspace_kind.tried
            else SLOW_PIECE
        )

    @property
    def part_size(self) -> int:
        """Least number of samples in a part, which a worker of a cluster counts at once."""
        return (
            PART if self.unconstrained else TRIED_PART if self.workspace_kind.tried else SLOW_PART
        )

    @property
    def default_sample_count(self) -> int:
        """Default number of samples; one in each cell where places are tried."""
        return self.grid.count if self.workspace_kind.tried else FEW_SAMPLES[self.unconstrained]

    @property
    def n_entries(self) -> int:
        """Length of the counts: cells, samples outside, samples left out, filled up to an even
        number.
        """
        return (self.grid.count + AFTER + 1) // 2 * 2

    def describe_recipe(self) -> dict[str, Any]:
        """Describe the recipe as data that are stored with a map and must agree to add counts."""
        grid = {k: list(x) for k, x in asdict(self.grid).items()}
        grid |= json.loads(json.dumps(asdict(self.workspace_kind)))  # as it is read again
        return {
            "system": self.system.structure.content_hash,
            "frame": self.frame,
            "seed": self.seed,
            **grid,
            "variant": self.variant,
            "version": self.version,
        }

    def count_samples(self, first: int, last: int, counts: np.ndarray) -> None:
        """Count the samples `first` to `last` into counts (entries,) of uint32. Threads may share
        them.
        """
        if self.unconstrained:
            keys, bounds = self._sequence_bounds
            table = pack_chain(self.system, self.frame)
            lane_positions.count_cells(
                *table,
                keys,
                bounds,
                first,
                last - first,
                self.grid.kernel_bounds,
                counts.view(np.int64),
            )
            return
        size = self.piece_size
        for piece in range(first // size, -(-last // size)):
            points = (
                self._try_places(piece)
                if self.workspace_kind.tried
                else sample_positions(self.system, self.frame, self.seed, piece)
            )
            points = points[max(0, first - piece * size) : last - piece * size]
            kept = points[~np.isnan(points[:, 0])]
            with _one_at_a_time:
                np.add.at(counts, self.grid.number_cells(kept), np.uint32(1))
                counts[self.grid.count + 1] += np.uint32(len(points) - len(kept))

    def _try_places(self, piece: int) -> Array:
        """Draw points (TRIED_PIECE, 3) of one piece, in cells in scattered order, NaN if not
        reached.
        """
        grid = self.grid
        rng = np.random.Generator(np.random.Philox(key=[self.seed, piece]))
        number = (
            np.arange(piece * TRIED_PIECE, (piece + 1) * TRIED_PIECE) * self._stride
        ) % grid.count
        at = np.stack(np.unravel_index(number, grid.shape), axis=-1)
        points = grid.complete_points(
            np.array(grid.low)[grid.measured_axes] + (at + rng.random(at.shape)) * grid.size
        )
        points[
            ~self.workspace_kind.find_reached_points(self.system, self.frame, points, self.seed)
        ] = np.nan
        return points

    @cached_property
    def _stride(self) -> int:
        """A step between cells that visits each of them once, in golden-ratio order."""
        stride = max(1, int(GOLDEN * self.grid.count))
        while math.gcd(stride, self.grid.count) > 1:
            stride += 1
        return stride

    @cached_property
    def _sequence_bounds(self) -> tuple[np.ndarray, Array]:
        """Keys of the random sequences, and bounds of the coordinates."""
        return make_keys(self.seed, self.system.nq), list_sampling_bounds(self.system)


def count_part(recipe: Recipe, first: int, last: int) -> np.ndarray:
    """Count the samples `first` to `last` in one thread, and return counts (entries,). Errors:
    `KernelsError`.
    """
    refuse_kernels(recipe.variant, recipe.version)
    counts = np.zeros(recipe.n_entries, dtype=np.uint32)
    for start in range(first, last, recipe.piece_size):
        recipe.count_samples(start, min(start + recipe.piece_size, last), counts)
    return counts


# ---- samples of the recipe


def is_plain_chain(system: Model) -> bool:
    """Whether all configurations within the limits are allowed."""
    return not has_loops(system) and not system._mechanism.constraints


def make_keys(seed: int, count: int) -> np.ndarray:
    """Make keys (count,) of the coordinates' random sequences from a seed, by SplitMix64 twice."""
    return np.array([_mix_bits(_mix_bits(seed, 0), k) for k in range(count)], dtype=np.uint64).view(
        np.int64
    )


def _mix_bits(state: int, counter: int) -> int:
    """Compute number `counter` of SplitMix64 from `state` (Steele, Lea and Flood 2014)."""
    mask = 2**64 - 1
    z = (state + 0x9E3779B97F4A7C15 * (counter + 1)) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def list_sampling_bounds(system: Model) -> Array:
    """List lower end and range (nq, 2) of each drawn coordinate; quaternions have none."""
    low, high = compute_sampling_box(system)
    layout = system.structure.layout
    out = np.zeros((system.nq, 2))
    out[layout.vector_q, 0] = low[layout.vector_v]
    out[layout.vector_q, 1] = (high - low)[layout.vector_v]
    return out


def sample_positions(system: Model, frame: str, seed: int, piece: int) -> Array:
    """Sample positions (SLOW_PIECE, 3) of one piece, for a system with loops or constraints.

    NaN where a configuration is not closed, or violates a constraint.
    """
    q, good = sample_closed_configurations(system, seed, piece)
    points = np.full((len(q), 3), np.nan)
    points[good] = fk(system, q[good], frame, form="position")
    return points


def sample_closed_configurations(
    system: Model, seed: int, piece: int, count: int = SLOW_PIECE
) -> tuple[Array, np.ndarray]:
    """Sample random configurations (count, nq), closed if possible. A mask (count,) tells where all
    constraints hold.
    """
    q = sample_configurations(
        system, np.random.Generator(np.random.Philox(key=[seed, piece])), count
    )
    good = np.ones(len(q), dtype=bool)
    if has_loops(system):
        answer = assemble(system, None, q)
        q = answer.q
        good = np.asarray(answer.success, dtype=bool)
    rows = pack_one_sided_rows(system)
    good &= (
        rows.compute_excess(np.where(good[:, None], q, compute_mid_configuration(system))) == 0.0
    ).all(axis=1)
    return q, good


def make_recipe(
    system: Model,
    frame: str,
    seed: int,
    cells: Any,
    box: Any,
    workspace_kind: WorkspaceKind = PLAIN,
) -> Recipe:
    """Make the recipe of a map. Errors: `InputError` for an immobile frame, unlimited slides, wrong
    boxes.
    """
    if workspace_kind.kind == ORIENTATION:
        return Recipe(
            system,
            frame,
            seed,
            _make_orientation_grid(cells, box, system.dim),
            workspace_kind=workspace_kind,
        )
    if (names := list_unlimited_coordinates(system, frame)) and box is None:
        turns = {
            n
            for n, t in zip(
                system.structure.velocity_names, system.structure.coordinates.turning, strict=True
            )
            if t
        }
        so = f"so the frame {frame!r} no end of places"
        if turns.issuperset(names):
            so = f"a constraint tells {'its' if len(names) == 1 else 'their'} whole turns apart"
        raise InputError(
            f"{join_words(list(map(repr, names)))} {'has' if len(names) == 1 else 'have'} no "
            f"limits, and {so}: give a box, or limits, such as system.with_limits({{{names[0]!r}: "
            "(-1.0, 1.0)})"
        )
    workspace_kind = replace(workspace_kind, tried=True) if names else workspace_kind
    points = sample_pilot_positions(system, frame, seed)
    if not np.isfinite(points).all():
        raise InputError(f"positions of {frame!r} are not finite: a limit is too large")
    extent = np.stack([points.min(axis=0), points.max(axis=0)])
    length = compute_characteristic_length(system) or 1.0
    if not (extent[1] - extent[0] > 1e-9 * length).any():
        where = ", ".join(f"{x:.6g}" for x in extent[0][: system.dim])
        raise InputError(f"frame {frame!r} does not move: it is always at ({where})")
    usual = FEW_CELLS if workspace_kind.tried else USUAL_CELLS
    grid = make_grid(extent, cells, box, length, system.dim, usual)
    return Recipe(system, frame, seed, grid, workspace_kind=workspace_kind)


def sample_pilot_positions(system: Model, frame: str, seed: int) -> Array:
    """Sample positions (k, 3) that show the extent of a frame's places. Errors: `InputError` if no
    configuration closes.
    """
    if is_plain_chain(system):
        points = np.empty((PILOT, 3))
        table = pack_chain(system, frame)
        lane_positions.sample_positions(
            *table, make_keys(seed, system.nq), list_sampling_bounds(system), 0, points
        )
        return points
    found = list[Array]()
    most = NARROW_PILOT[has_loops(system)]
    for k in range(most // SLOW_PIECE):
        if k >= SLOW_PILOT // SLOW_PIECE and sum(map(len, found)) >= ENOUGH:
            break
        points = sample_positions(system, frame, seed, k)
        found.append(points[~np.isnan(points[:, 0])])
    points = np.concatenate(found)
    if not len(points):
        raise InputError(
            f"of {most} random configurations of {system.name!r} none could be closed within the "
            "limits and constraints, and a map counts random ones: narrower limits make more of "
            "them hold"
        )
    return points


def _make_orientation_grid(cells: Any, box: Any, dim: int) -> Grid:
    """Make the grid of all orientations. Errors: `InputError`."""
    if box is not None:
        raise InputError("box is for places: of orientations all are tried")
    names = TURNED[dim]
    ranges = RANGES[dim]
    low, high = (tuple(x) for x in zip(*ranges, strict=True))
    counts = count_cells(cells, np.array(high) - low, names, FEW_CELLS)
    rest = 3 - len(names)
    return Grid(
        low + (-0.5,) * rest,
        high + (0.5,) * rest,
        (*counts, *(1,) * rest),
        names,
        names + ("",) * rest,
    )


def list_unlimited_coordinates(system: Model, frame: str) -> list[str]:
    """List the names of coordinates that move a frame without limit."""
    layout = system.structure.layout
    circle = find_free_angles(system)
    if not has_loops(system):
        used = set(get_row_integers(pack_chain(system, frame)[0])[:, Q_INDEX].tolist())
    else:  # what is not driven may be held by loops
        driven = {
            c
            for j in system.structure.joints.values()
            if j.actuated
            for c in system.structure.coordinates_of_joint(j.name)
        }
        used = {k for k, name in enumerate(system.coordinate_names) if name in driven}
    return [
        system.structure.velocity_names[int(v)]
        for at, v in zip(layout.vector_q.tolist(), layout.vector_v.tolist(), strict=True)
        if at in used
        and not circle[v]
        and not all(abs(x[v]) < FAR for x in (system.lower, system.upper))
    ]


# ---- counting in threads

SHARED_BYTES = 256 * 2**20
"""Memory for the counts of all threads together; where each cannot have its own, they share."""


def count_in_threads(
    recipe: Recipe, first: int, last: int, threads: int, check: Callable[[int], None]
) -> tuple[np.ndarray, int, BaseException | None]:
    """Count samples from `first` on in threads, and return the counts (entries,) and where they
    stop. Also return what broke the work off, or None.

    `stop` is `last`, or the end of a piece where the time was up or an interrupt came. `check` is
    called with the number of samples that are counted, and raises what ends the work.
    """
    most = max(1, min(threads, SHARED_BYTES // (4 * recipe.n_entries)))
    counts = [np.zeros(recipe.n_entries, dtype=np.uint32) for _ in range(most)]
    piece = recipe.piece_size

    def count_piece(thread: int, start: int) -> None:
        """Count one piece of samples in a thread."""
        recipe.count_samples(start, min(start + piece, last), counts[thread % most])

    done, broken = work_in_threads(
        range(first, last, piece),
        count_piece,
        threads,
        lambda k: check(min(k * piece, last - first)),
    )
    for other in counts[1:]:
        counts[0] += other
    return counts[0], min(first + done * piece, last), broken
