"""Configuration space and task space of a system with two coordinates, beside one another, with matplotlib.

Left is the configuration space, right what a frame's origin sees of it. Both are coloured by how many configurations
within the limits reach the place: none, one, two. Importing this module needs the extra [view].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained, flag, numbers
from kempe.errors import InputError, UnsupportedError, shown
from kempe.kinematics.configuration import circles, has_loops, sampling_box
from kempe.model.tree.coordinates import units
from kempe.reals import is_whole
from kempe.spatial import Array
from kempe.views.drawing import page, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.system import FrameLike, System

SHADES = ("#ffffff", "#d3e3f2", "#8db8dc", "#4c7fb0")
"""Colours of places with no, one, two, and more configurations: from light to dark, so that they read in grey."""
FINEST, COARSEST = 1000, 8
FINE, STEP = 145, 12
"""Points of a line of the grid, and how many lie between two lines: those are 1/12 of a side apart."""
FEW = 0.005
"""Part of a space from which the legend names its shade."""
ROOM = 0.06
"""Room around the task space, as a part of its width."""


@explained
def plot_spaces(
    system: System, frame: FrameLike, *, points: ArrayLike = (), grid: bool = False, ax: Any = None,
    resolution: int = 240
) -> tuple[Axes, Axes]:  # fmt: skip
    """Axes with the configuration space and with the task space of a frame, of a system with two coordinates.

    Limits are a rectangle on the left, and their image on the right (solid; the edges of a full turn, which are one
    line, are dotted). Red lines are singular: there the frame's velocity has lost a direction. Shades say how many
    configurations within the limits reach the place. `points` (k, 2) are places that the frame shall reach [m]: their
    solutions are marked on both sides, or, where there is none, the nearest place that is reached, with the distance.
    `grid` draws lines on which one coordinate is constant, and their images. `ax` is a pair of axes to draw on;
    `resolution` the number of places along each axis (8 to 1000). Errors: `UnsupportedError` for systems with loops or
    another number of coordinates; `InputError`; `UnknownNameError`.

    ``system.plot_spaces("e", points=[(0.6, 0.3)])[0].figure.savefig("spaces.png")`` writes the picture.
    """
    name = _checked(system, frame)
    targets = numbers(points, "points")
    targets = targets.reshape(0, 2) if not targets.size else targets
    if targets.ndim != 2 or targets.shape[1] != 2 or not np.isfinite(targets).all():
        raise InputError(f"points has shape {targets.shape}; it must be (k, 2), places x, y in metres")
    if not is_whole(resolution) or not COARSEST <= resolution <= FINEST:
        raise InputError(f"resolution is {shown(resolution)}; it must be a whole number, {COARSEST} to {FINEST}")
    if ax is None:
        figure = page.new_figure(11.8, 5.0)
        ax = figure.add_axes((0.06, 0.12, 0.36, 0.8)), figure.add_axes((0.49, 0.12, 0.36, 0.8))
    left, right = page.axes_given(ax, 2)
    lines = flag(grid, "grid")
    every = _grid(system, int(resolution))
    p = system.fk(every, name)[..., :2, 3]
    _shade_task_space(system, name, right, p, targets, int(resolution))
    _shade_configurations(system, name, left, every, p)
    _draw_limits(system, name, left, right)
    if lines:
        _draw_grid(system, name, left, right)
    _draw_singular(system, name, left, right, every)
    for k, target in enumerate(targets):
        _draw_point(system, name, left, right, target, k, every, p)
    _finish(system, name, left, right)
    return left, right


def preimages(system: System, frame: FrameLike, p: Array) -> np.ndarray:
    """How many configurations (...) within the limits bring the origin of a frame to places p (..., 2)."""
    flat = np.reshape(p, (-1, 2))
    found = system.ik_all(flat, frame, task="position", limits=True)
    return np.asarray(found.mask.sum(axis=-1)).reshape(np.shape(p)[:-1])  # type: ignore[union-attr]


def nearest(system: System, frame: FrameLike, target: Array, grid: Array, p: Array) -> tuple[Array, Array, float]:
    """The configuration (2,) that brings a frame nearest to a place (2,), where the frame is then, and how far away."""
    start = grid.reshape(-1, 2)[int(np.argmin(np.sum((p.reshape(-1, 2) - target) ** 2, axis=1)))]
    found = system.ik(target, frame, start, task="position").q
    tries = [(q, system.fk(q, frame)[:2, 3]) for q in (start, found) if np.isfinite(q).all()]
    q, at = min(tries, key=lambda x: float(np.linalg.norm(x[1] - target)))
    return q, at, float(np.linalg.norm(at - target))


# ---- what is drawn of


def _checked(system: System, frame: FrameLike) -> str:
    """The frame's name. Errors: `UnsupportedError`, `UnknownNameError`, `InputError`."""
    name = system.structure.frame_name(frame)
    if has_loops(system) or system.nv != 2 or len(system.structure.layout.vector_q) != 2:
        loops = " and loops" if has_loops(system) else ""
        needed = "both spaces are drawn of systems with two coordinates and without loops"
        raise UnsupportedError(f"{needed}; {system.name} has {system.nv} coordinates{loops}")
    open_ = ~(np.isfinite(system.lower) & np.isfinite(system.upper)) & ~circles(system)
    if open_.any():
        slide = system.structure.velocity_names[int(np.flatnonzero(open_)[0])]
        raise InputError(f"{slide!r} has no limits on both sides, and a picture has an end: "
                         f"with_limits({{{slide!r}: (low, high)}}) gives it one")  # fmt: skip
    z = system.fk(_grid(system, COARSEST), name)[..., 2, 3]
    if np.ptp(z) > 1e-9 * (1.0 + np.abs(z).max()):
        raise UnsupportedError(f"{name!r} leaves its plane: the task space is drawn in x and y")
    return name


def _grid(system: System, n: int) -> Array:
    """Configurations (n, n, 2) over the limits, or full turns."""
    low, high = sampling_box(system)
    sides = [np.linspace(float(low[i]), float(high[i]), n) for i in range(2)]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)


def _shade_task_space(system: System, name: str, ax: Any, p: Array, targets: Array, n: int) -> None:
    """Draw the places of the task space in the shade of the number of their configurations."""
    every = np.concatenate([p.reshape(-1, 2), targets])
    low, high = every.min(axis=0), every.max(axis=0)
    room = ROOM * max(float((high - low).max()), 1e-9)
    x, y = (np.linspace(float(low[i]) - room, float(high[i]) + room, n) for i in range(2))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    count = preimages(system, name, places)
    _shaded(ax, x, y, count)
    ax.set_xlim(x[0], x[-1])
    ax.set_ylim(y[0], y[-1])


def _shade_configurations(system: System, name: str, ax: Any, grid: Array, p: Array) -> None:
    """Draw configurations in the shade of the number of those that reach the same place."""
    _shaded(ax, grid[:, 0, 0], grid[0, :, 1], np.maximum(preimages(system, name, p), 1))


def _shaded(ax: Any, x: Array, y: Array, count: np.ndarray) -> None:
    from matplotlib.colors import ListedColormap

    ax.pcolormesh(x, y, np.minimum(count, 3).T, cmap=ListedColormap(SHADES), vmin=-0.5, vmax=3.5, shading="nearest",
                  gid="preimages", zorder=style.GHOSTS, rasterized=True)  # fmt: skip


def _draw_limits(system: System, name: str, left: Any, right: Any) -> None:
    """Draw the rectangle of the limits, or of full turns, and the image of the limits."""
    (a, b), (c, d) = np.array(sampling_box(system)).T
    t = np.linspace(0.0, 1.0, 200)
    edges = {0: [(np.full(200, x), c + (d - c) * t) for x in (a, b)],
             1: [(a + (b - a) * t, np.full(200, y)) for y in (c, d)]}  # fmt: skip
    for i, turns in enumerate(circles(system)):
        for k, (x, y) in enumerate(edges[i]):
            gid = f"limit:{system.coordinate_names[i]}:{k}"
            left.plot(x, y, color=style.INK, lw=1.4, ls=":" if turns else "-", gid=gid, zorder=style.CURVE)
            if not turns:
                image = system.fk(np.stack([x, y], axis=-1), name)[:, :2, 3]
                right.plot(*image.T, color=style.INK, lw=1.4, gid=gid, zorder=style.CURVE)


def _draw_grid(system: System, name: str, left: Any, right: Any) -> None:
    """Draw lines on which one coordinate is constant, a colour for each coordinate, and their images."""
    fine = _grid(system, FINE)
    for i in range(2):
        for k, at in enumerate(range(STEP, FINE - 1, STEP)):
            q = np.take(fine, at, axis=i)
            for ax, line in ((left, q), (right, system.fk(q, name)[:, :2, 3])):
                ax.plot(*line.T, color=style.link_colour(i + 1), lw=0.8, gid=f"grid:{system.coordinate_names[i]}:{k}",
                        zorder=style.CURVE)  # fmt: skip


def _draw_singular(system: System, name: str, left: Any, right: Any, grid: Array) -> None:
    """Draw where the frame's velocity loses a direction, and the image of that."""
    size = np.linalg.det(system.jacobian(grid, name)[..., :2, :])
    scale = float(np.abs(size).max())
    if scale < 1e-12:
        return
    size = np.where(np.abs(size) < 1e-9 * scale, 1e-9 * scale, size)  # a line through nodes of the grid is one, too
    lines = left.contour(grid[:, 0, 0], grid[0, :, 1], size.T, levels=[0.0], colors=[style.OPEN], linewidths=1.6,
                         zorder=style.PINS)  # fmt: skip
    for k, line in enumerate(x for x in lines.allsegs[0] if len(x) > 1):
        right.plot(*system.fk(np.asarray(line, dtype=float), name)[:, :2, 3].T, color=style.OPEN, lw=1.6,
                   gid=f"singular:{k}", zorder=style.PINS)  # fmt: skip


def _draw_point(
    system: System, name: str, left: Any, right: Any, target: Array, k: int, grid: Array, p: Array
) -> None:  # fmt: skip
    """Draw a place that shall be reached: its solutions, or the nearest place that is reached."""
    colour, number = style.curve_colour(k + 1), str(k + 1)
    found = system.ik_all(target, name, task="position", limits=True)
    right.plot(*target, "*" if len(found) else "X", ms=11, color=colour, mec="white", mew=0.7, gid=f"point:{k}",
               zorder=style.TEXT)  # fmt: skip
    right.annotate(number, target, xytext=(7, 5), textcoords="offset points", size=style.FONT, color=colour)
    for j, q in enumerate(found.q):
        left.plot(*q, "o", ms=7, color=colour, mec="white", mew=0.8, gid=f"solution:{k}:{j}", zorder=style.TEXT)
        letter = f"{number}{'abcdefgh'[j]}" if len(found) > 1 and j < 8 else number
        left.annotate(letter, q, xytext=(6, 5), textcoords="offset points", size=style.FONT, color=colour)
        _draw_arm(system, name, right, q, colour, f"arm:{k}:{j}", "-" if j == 0 else "--")
    if not len(found):
        q, at, far = nearest(system, name, target, grid, p)
        left.plot(*q, "X", ms=8, color=colour, mec="white", mew=0.7, gid=f"nearest:{k}", zorder=style.TEXT)
        _draw_arm(system, name, right, q, colour, f"arm:{k}:0", "-")
        right.plot(*np.stack([at, target]).T, color=colour, lw=1.2, ls=":", gid=f"distance:{k}", zorder=style.TEXT)
        right.annotate(f"{page.length_text(float(f'{far:.3g}'))} away", 0.5 * (at + target), xytext=(6, -10),
                       textcoords="offset points", size=style.FONT, color=colour, gid=f"distance:{k}:text")  # fmt: skip


def _draw_arm(system: System, name: str, ax: Any, q: Array, colour: str, gid: str, line: str) -> None:
    """Draw the bodies from the ground to the frame as a line through their joints."""
    m, tree = system.mechanism, system.structure.topology
    frame = m.frames.get(name)
    body = name if frame is None else frame.body
    ends = [system.fk(q, name)[:2, 3]]
    while body != system.body_names[0]:
        at = system.body_names.index(body) - 1
        joint = m.joints[tree.parent_joints[at]]
        own = joint.X_CM if joint.child == body else joint.X_PF
        ends.append((system.fk(q, body) @ own.evaluate(m.parameters))[:2, 3])
        body = system.body_names[system.parent[at]]
    ax.plot(*np.array(ends).T, color=colour, lw=1.5, ls=line, marker="o", ms=3.5, alpha=0.8, gid=gid,
            zorder=style.POINTS)  # fmt: skip


def _finish(system: System, name: str, left: Any, right: Any) -> None:
    """Say what the axes, the shades and the lines are."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    low, high = sampling_box(system)
    unit = units(system)
    for ax in (left, right):
        page.light_axes(ax)
    for i, (limits, label) in enumerate(((left.set_xlim, left.set_xlabel), (left.set_ylim, left.set_ylabel))):
        room = 0.04 * (high[i] - low[i])
        limits(low[i] - room, high[i] + room)
        coordinate = system.coordinate_names[i]
        label(f"{coordinate} [{unit[coordinate]}]", size=style.FONT, color=style.INK)
    right.set_xlabel("x [m]", size=style.FONT, color=style.INK)
    right.set_ylabel("y [m]", size=style.FONT, color=style.INK)
    right.set_aspect("equal", adjustable="box")
    left.set_title("configuration space", size=style.FONT + 1, color=style.INK)
    right.set_title(f"task space: position of {name!r}", size=style.FONT + 1, color=style.INK)
    seen: list[np.ndarray] = [np.asarray(mesh.get_array()) for ax in (left, right) for mesh in ax.collections
            if mesh.get_gid() == "preimages"]  # fmt: skip
    count = {k for k in range(4) if any(float((x == k).mean()) > FEW for x in seen)}
    words = ("not reached", "reached in 1 way", "reached in 2 ways", "in more ways")
    entries: list[Any] = [Patch(fc=SHADES[k], ec=style.FAINT, label=words[k]) for k in sorted(count)]
    entries.append(Line2D([], [], color=style.OPEN, lw=1.6, label="singular"))
    if not circles(system).all():
        entries.append(Line2D([], [], color=style.INK, lw=1.4, label="limits"))
    right.legend(handles=entries, loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=style.FONT - 1, frameon=False)
