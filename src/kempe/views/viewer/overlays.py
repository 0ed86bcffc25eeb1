"""Overlays of a page: curves, workspaces, capability maps and singular configurations.

Each is a generator of ever finer `Overlay`s, which runs beside the page and may be left any time.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.budget import Budget
from kempe.errors import InputError, UnsupportedError
from kempe.forward.fk import fk
from kempe.model.configurations import has_loops
from kempe.spatial import Array
from kempe.units import name_lengths
from kempe.views.drawing import shapes, style
from kempe.views.drawing.solids import parse_colour
from kempe.views.viewer.session import MOTION_PATIENCE
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.views.viewer.session import Session
    from kempe.workspace.answer import Workspace
    from kempe.workspace.planar.planar_workspace import PlanarWorkspace

LONG = 10.0
"""Seconds after which no further round begins."""
CELLS = {2: (32, 64, 128), 3: (12, 24, 40)}
"""Cells of a workspace along its longest edge, round by round, in the plane and in space."""
MAP = (5, 9, 13)
"""Cells of a capability map along each axis, round by round."""
EACH = 60
"""Samples for each cell of a workspace; with loops a tenth of that."""
CUT = "; cut open at y = {:.3g} m"
"""What is said of what is shown from there on only, so that one sees into it."""
SINGULAR = 0.026
"""Diameter of the mark of a singular configuration in sizes of the drawing."""
ROUNDS = 8
"""Rounds in which singular configurations are searched for."""
REACHED = "#6f9fd0"
OFTEN = "#2f5f95"
EDGE = "#123a63"
"""Colours of what is reached, in one way and in several, and of its boundary."""
KINDS = ("#7a4fbf", "#d9820a", "#2b7a3b", "#8a5a00", "#0f8b8d")
"""Colours of sets of singular configurations, none that a curve or a workspace has."""
FEW = "#fee838"
MANY = "#00224e"
"""Colours of a capability map where few directions are reached, and where all are."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """Overlay of a page: points (n, 3) with colours and sizes [m], lines (m, 2, 3), surfaces, a
    sentence.

    `surfaces` are corners (k, 3) and triangles (j, 3) with a colour. `legend` says what each colour
    means.
    """

    said: str
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    colours: Array = field(default_factory=lambda: np.zeros((0, 3)))
    sizes: Array = field(default_factory=lambda: np.zeros(0))
    lines: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))
    line_colour: str = style.choose_curve_colour(0)
    surfaces: tuple[tuple[Array, np.ndarray, str], ...] = ()
    legend: tuple[tuple[str, str], ...] = ()

    @property
    def extent(self) -> Array:
        """Lower and upper corner (2, 3) of the overlay's bounding box [m]; no rows if it is empty."""
        every = np.concatenate(
            [self.points, self.lines.reshape(-1, 3), *(corners for corners, *_ in self.surfaces)]
        )
        return np.stack([every.min(axis=0), every.max(axis=0)]) if len(every) else every


def _split_polyline(points: Array) -> Array:
    """Split a polyline (n, 3) into segments (n - 1, 2, 3), without those with NaN."""
    lines = np.stack([points[:-1], points[1:]], axis=1)
    return lines[np.isfinite(lines).all(axis=(1, 2))]


# ---- curves


def _iterate_curve(session: Session) -> Iterator[Overlay]:
    """Give the curve of the frame's origin in the motion that is played, or in the whole motion."""
    from kempe.motion.trace import trace

    system = session.system
    frame = session.frame
    if session.motion is not None:
        places = fk(system, session.motion.q, frame)[:, :3, 3]
        yield _make_curve(session, f"what {frame} passes", places)
        return
    motion = trace(
        system, session.sliders[0].name, session.q, budget=session.make_budget(MOTION_PATIENCE)
    )
    places = fk(system, motion.q, frame)[:, :3, 3]
    yield _make_curve(session, f"{frame}: {motion.status}", places)


def _make_curve(session: Session, said: str, places: Array) -> Overlay:
    """Make the overlay of the curve through places (n, 3) of the frame."""
    legend = ((style.choose_curve_colour(0), f"curve of {session.frame}"),)
    return Overlay(said, lines=_split_polyline(places), legend=legend)


# ---- workspaces and capability maps


def _iterate_workspace(session: Session) -> Iterator[Overlay]:
    """Give the workspace of the frame: exact for planar chains, else cells of ever finer maps."""
    from kempe.workspace.planar.planar_workspace import planar_workspace
    from kempe.workspace.workspace import workspace

    system = session.system
    frame = session.frame
    if system.dim == 2:
        try:
            exact = planar_workspace(system, frame)
        except UnsupportedError:
            pass
        else:
            yield _make_regions(exact)
            return
    for k, cells in enumerate(CELLS[system.dim]):
        budget = session.make_budget(MOTION_PATIENCE, rng=k)
        n = EACH * cells**system.dim // (10 if has_loops(system) else 1)
        found = workspace(system, frame, n=n, cells=cells, budget=budget)
        yield _make_cells(found, float(session.pose[1, 3]))


def _make_regions(found: PlanarWorkspace) -> Overlay:
    """Make the overlay of a planar workspace: its regions with their boundary."""
    surfaces: list[tuple[Array, np.ndarray, str]] = []
    for region in found.regions:
        corners, triangles = _triangulate_loops(shapes.make_region_outline(region).to_polygons())
        surfaces.append((corners, triangles, REACHED if region.solutions in (None, 1) else OFTEN))
    lines = [np.zeros((0, 2, 3))]
    for piece in found.boundary:
        p = shapes.sample_piece(piece)
        lines.append(_split_polyline(np.column_stack([np.real(p), np.imag(p), np.zeros(len(p))])))
    words = {REACHED: "workspace", OFTEN: "reached in several ways", EDGE: "boundary"}
    used = {colour for *_, colour in surfaces} | {EDGE}
    return Overlay(
        found.status,
        lines=np.concatenate(lines),
        line_colour=EDGE,
        surfaces=tuple(surfaces),
        legend=tuple((colour, word) for colour, word in words.items() if colour in used),
    )


def _triangulate_loops(loops: Any) -> tuple[Array, np.ndarray]:
    """Triangulate the area inside closed curves: corners (k, 3) and triangles (j, 3).

    Where an even number of curves encloses a point, there is a hole.

    Between two neighbouring heights of corners the sides are straight: what is inside are trapezia.
    """
    sides = np.concatenate(
        [np.stack([loop[:-1], loop[1:]], axis=1) for loop in map(np.asarray, loops)]
    )
    levels = np.unique(sides[..., 1])
    levels = levels[np.concatenate([[True], np.diff(levels) > 1e-9 * np.ptp(levels)])]
    out: list[Array] = []
    for low, high in zip(levels[:-1], levels[1:], strict=True):
        middle = 0.5 * (low + high)
        a, b = sides[
            (sides[..., 1].min(axis=1) < middle) & (sides[..., 1].max(axis=1) > middle)
        ].transpose(1, 0, 2)
        slope = (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
        order = np.argsort(a[:, 0] + (middle - a[:, 1]) * slope)
        at = [(a[:, 0] + (y - a[:, 1]) * slope)[order] for y in (low, high)]
        for k in range(0, len(order) - 1, 2):
            out.append(
                np.array(
                    [
                        [at[0][k], low, 0],
                        [at[0][k + 1], low, 0],
                        [at[1][k + 1], high, 0],
                        [at[1][k], high, 0],
                    ]
                )
            )
    corners = np.array(out).reshape(-1, 3)
    return corners, _triangulate_quadrangles(len(out))


def _triangulate_quadrangles(n: int) -> np.ndarray:
    """List the triangles (2 n, 3) of n quadrangles, whose corners are numbered one after the other."""
    return (4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)


def _make_cells(found: Workspace, cut: float) -> Overlay:
    """Make the overlay of a workspace's cells with samples.

    In the plane all cells are drawn, in space the surface of those from y = `cut` on.
    """
    grid = found.map.grid
    some = found.map.occupied.copy()
    said = found.status
    d = some.ndim
    if d == 3:
        some[:, grid.list_centres("y") < cut] = False
        said += name_lengths(CUT.format(cut), found.system.unit)
    full = np.pad(some, 1)
    if d == 1:
        lines = _split_polyline(grid.complete_points(found.map.points))
        legend = ((EDGE, "workspace"),)
        return Overlay(found.status, lines=lines, line_colour=EDGE, legend=legend)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    quads = [np.argwhere(full)[:, None] + square] if d == 2 else []
    for axis, side in np.ndindex(3, 2) if d == 3 else ():
        free = full & ~np.roll(full, 1 - 2 * side, axis)
        quad = np.repeat(np.argwhere(free)[:, None].astype(float), 4, axis=1)
        quad[..., axis] += side
        quad[..., [k for k in range(3) if k != axis]] += square
        quads.append(quad)
    places = (np.concatenate(quads).reshape(-1, d) - 1.0) * grid.size + np.array(grid.low)[
        grid.measured_axes
    ]
    return Overlay(
        said,
        surfaces=(
            (grid.complete_points(places), _triangulate_quadrangles(len(places) // 4), REACHED),
        ),
        legend=((REACHED, "workspace"),),
    )


def _iterate_capability(session: Session) -> Iterator[Overlay]:
    """Give the directions in which the frame reaches cells: larger and darker points for more."""
    from matplotlib import colormaps

    from kempe.workspace.capability import capability_map
    from kempe.workspace.workspace import workspace

    system = session.system
    frame = session.frame
    rough = workspace(system, frame, n=20_000, cells=8).map.grid
    box = np.stack([rough.low, rough.high])[:, : system.dim]
    for cells in MAP:
        budget = session.make_budget(MOTION_PATIENCE, starts=4)
        found = capability_map(system, frame, box, cells, 16, budget=budget)
        middles = np.stack(np.meshgrid(*found.axes, indexing="ij"), axis=-1).reshape(-1, system.dim)
        part = np.nan_to_num(found.fraction.ravel())
        some = (part > 0.0) & ((system.dim == 2) | (middles[:, 1] >= session.pose[1, 3]))
        points = np.zeros((int(some.sum()), 3))
        points[:, : system.dim] = middles[some]
        edge = float(np.min((box[1] - box[0]) / cells))
        colours = np.asarray(colormaps["cividis_r"](part[some]))[:, :3]
        cut = name_lengths(CUT.format(session.pose[1, 3]), system.unit)
        said = found.status + cut * (system.dim == 3)
        legend = ((FEW, "few directions reached"), (MANY, "all directions reached"))
        yield Overlay(said, points, colours, edge * (0.15 + 0.45 * part[some]), legend=legend)


# ---- singular configurations


def _iterate_singular_places(session: Session) -> Iterator[Overlay]:
    """Give the frame's positions at singular configurations, one colour for each set."""
    from kempe.spaces.singularities import singularities

    system = session.system
    frame = session.frame
    task = None if has_loops(system) else session.task
    held: dict[str, list[Array]] = {}
    starts = 4 if has_loops(system) else 32
    total = 0
    for k in range(ROUNDS):
        budget = Budget(starts=starts, rng=k)
        total = total + starts
        starts = min(2 * starts, 64)
        try:
            found = singularities(system, frame, task, budget=budget)
        except InputError:
            if k < ROUNDS - 1 and has_loops(system):  # no start closed the loops
                continue
            raise
        for one in found.sets:
            places = fk(system, one.q, frame)[:, :3, 3]
            held.setdefault(one.name or " and ".join(one.kinds), []).append(places)
        points = [np.zeros((0, 3))]
        colours = [np.zeros((0, 3))]
        legend = list[tuple[str, str]]()
        for (name, several), colour in zip(held.items(), itertools.cycle(KINDS)):
            points.append(np.concatenate(several))
            colours.append(np.tile(parse_colour(colour), (len(points[-1]), 1)))
            legend.append((colour, f"singular: {name}"))
        every = np.concatenate(points)
        what = f"{', '.join(held) or 'none'} found from {format_count(total, 'start')}"
        yield Overlay(
            f"{frame} at singular configurations: {what}",
            every,
            np.concatenate(colours),
            np.full(len(every), SINGULAR * session.size),
            legend=tuple(legend),
        )


OVERLAYS: dict[str, Callable[[Session], Iterator[Overlay]]] = {
    "curve": _iterate_curve,
    "workspace": _iterate_workspace,
    "capability map": _iterate_capability,
    "singular configurations": _iterate_singular_places,
}
"""What can be laid over a system, by name."""


def list_offered_overlays(session: Session) -> tuple[str, ...]:
    """List the names of `OVERLAYS` that a session can show."""
    has = {
        "curve": session.motion is not None or len(session.sliders) == 1,
        "capability map": not has_loops(session.system),
    }
    return tuple(n for n in OVERLAYS if has.get(n, True))


def iterate_rounds(session: Session, name: str) -> Iterator[Overlay]:
    """Iterate over ever finer overlays of a name, until the time for them is up."""
    end = time.monotonic() + LONG
    for overlay in OVERLAYS[name](session):
        yield overlay
        if time.monotonic() > end:
            return
