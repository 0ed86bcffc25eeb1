"""Configuration space and task space of a system with two freedoms, beside one another, with matplotlib.

Left is the configuration space, right what a frame's origin sees of it. Both are coloured by numbers of configurations
within the limits: none, one, two, and so on. Importing this module needs the extra [view].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.spaces.configuration.two_freedoms import NEEDED, TwoFreedoms, two_freedoms
from kempe.calls import explained, flag, numbers
from kempe.errors import InputError, UnsupportedError, shown
from kempe.kinematics import closure_rows
from kempe.model.tree.coordinates import units
from kempe.reals import is_whole
from kempe.spatial import Array
from kempe.views.drawing import page, style
from kempe.views.drawing.scene import look
from kempe.views.singular_plot import LINES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.system import FrameLike, System

SHADES = ("#ffffff", "#d3e3f2", "#8db8dc", "#4c7fb0", "#2f5d8a", "#1b3d63")
"""Colours of places with no, one, two, three, four and more configurations: from light to dark, to read in grey."""
FINEST, COARSEST = 1000, 8
FINE, STEP = 145, 12
"""Points of a line of the grid, and how many lie between two lines: those are 1/12 of a side apart."""
FEW = 0.005
"""Part of a space from which the legend names its shade."""
ROOM = 0.06
"""Room around the task space, as a part of its width."""
ON, CLOSED = 3.0, 1e-6
"""How far inside its limit a coordinate is drawn as on it, in squares of a grid's step; how far open loops may be."""


@explained
def plot_spaces(
    system: System, frame: FrameLike, *, points: ArrayLike = (), grid: bool = False, ax: Any = None,
    resolution: int = 240
) -> tuple[Axes, Axes]:  # fmt: skip
    """Axes with the configuration space and with the task space of a frame, of a system with two freedoms.

    Limits are a rectangle on the left, and their image on the right (solid; the edges of a full turn, which are one
    line, are dotted). Red lines are singular: there the frame's velocity has lost a direction. Shades say how many
    configurations within the limits reach the place. `points` (k, 2) are places that the frame shall reach [m]: their
    solutions are marked on both sides, or, where there is none, the nearest place found, with the distance.
    `grid` draws lines on which one coordinate is constant, and their images. `ax` is a pair of axes to draw on;
    `resolution` the number of places along each axis (8 to 1000).

    With closed loops the system is planar, its frame moves in two directions, and dyads close it: left are the two
    actuated coordinates, or others where these are not two, and shades there count the assembly modes at these values.
    Right are all modes. Singular lines are those that `singularities` finds: of type 1, where the frame has lost a
    direction, and, dashed, of type 2, where it moves though both coordinates are held and where modes meet. Limits of
    other coordinates are lines, too. Where the configurations that reach a place have no closed form they are not
    counted: one shade shows the image of a grid. Errors: `UnsupportedError` for other systems and numbers of
    freedoms; `InputError`; `UnknownNameError`.

    ``system.plot_spaces("e", points=[(0.6, 0.3)])[0].figure.savefig("spaces.png")`` writes the picture.
    """
    name = system.structure.frame_name(frame)
    targets = numbers(points, "points")
    targets = targets.reshape(0, 2) if not targets.size else targets
    if targets.ndim != 2 or targets.shape[1] != 2 or not np.isfinite(targets).all():
        raise InputError(f"points has shape {targets.shape}; it must be (k, 2), places x, y in metres")
    if not is_whole(resolution) or not COARSEST <= resolution <= FINEST:
        raise InputError(f"resolution is {shown(resolution)}; it must be a whole number, {COARSEST} to {FINEST}")
    lines, own = flag(grid, "grid"), None if ax is None else page.axes_given(ax, 2)
    space = two_freedoms(system, name)
    curves = _singular_curves(space)
    if own is None:
        figure = page.new_figure(11.8, 5.0)
        own = figure.add_axes((0.06, 0.12, 0.36, 0.8)), figure.add_axes((0.49, 0.12, 0.36, 0.8))
    left, right = own
    every = space.grid(int(resolution))
    q, mask = space.over(every)
    p = space.places(q, mask)
    if not mask.any():
        raise UnsupportedError(f"{system.name}: its loops close nowhere inside the limits: there is nothing to draw")
    _shade_task_space(space, right, p, targets, int(resolution))
    _shade_configurations(space, left, every, mask, p)
    _draw_limits(space, left, right)
    if space.modes:
        _draw_other_limits(space, left, right, every, q)
    if lines:
        _draw_grid(space, left, right)
    if curves is None:
        _draw_singular(space, left, right, every)
    else:
        _draw_curves(space, left, right, curves)
    for k, target in enumerate(targets):
        _draw_point(space, left, right, target, k, q[mask], p[mask])
    _finish(space, left, right, curves)
    return left, right


def nearest(system: System, frame: FrameLike, target: Array, grid: Array, p: Array) -> tuple[Array, Array, float]:
    """The configuration (nq,) that brings a frame nearest to a place (2,), where it is then, and how far away."""
    start = grid.reshape(-1, system.nq)[int(np.argmin(np.sum((p.reshape(-1, 2) - target) ** 2, axis=1)))]
    found = system.ik(target, frame, start, task="position").q
    tries = [(q, system.fk(q, frame)[:2, 3]) for q in (start, found) if np.isfinite(q).all() and _closed(system, q)]
    q, at = min(tries, key=lambda x: float(np.linalg.norm(x[1] - target)))
    return q, at, float(np.linalg.norm(at - target))


def _closed(system: System, q: Array) -> bool:
    return float(np.abs(system.loops.closure_error(q)).max(initial=0.0)) < CLOSED


# ---- what is drawn


def _singular_curves(space: TwoFreedoms) -> Any:
    """The singular curves of a system with loops; None of a chain. Errors: `UnsupportedError`."""
    system, name = space.system, space.frame
    if not space.modes:
        z = system.fk(space.grid(COARSEST), name)[..., 2, 3]
        if np.ptp(z) > 1e-9 * (1.0 + np.abs(z).max()):
            raise UnsupportedError(f"{name!r} leaves its plane: the task space is drawn in x and y")
        return None
    found = system.singularities(name, "position", inputs=space.names)
    if found.questions.frame_rank < 2:
        raise UnsupportedError(
            f"{NEEDED} and of a frame that moves in both: {name!r} of {system.name} moves on a curve"
        )
    surfaces = min((s.dimension for s in found.sets), default=0) > 1
    return () if surfaces else found.curves()  # where all is singular there are no lines


def _shade_task_space(space: TwoFreedoms, ax: Any, p: Array, targets: Array, n: int) -> None:
    """Draw the places of the task space in the shade of the number of their configurations."""
    every = np.concatenate([p.reshape(-1, 2), targets])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = ROOM * max(float((high - low).max()), 1e-9)
    x, y = (np.linspace(float(low[i]) - room, float(high[i]) + room, n) for i in range(2))
    _shaded(ax, x, y, space.preimages(x, y, p))
    ax.set_xlim(x[0], x[-1])
    ax.set_ylim(y[0], y[-1])


def _shade_configurations(space: TwoFreedoms, ax: Any, grid: Array, mask: np.ndarray, p: Array) -> None:
    """Draw values in the shade of the number of modes there, or of configurations that reach the same place."""
    count = mask.sum(axis=-1) if space.modes else np.maximum(space.reaching(p[..., 0, :])[1].sum(axis=-1), 1)
    _shaded(ax, grid[:, 0, 0], grid[0, :, 1], count)


def _shaded(ax: Any, x: Array, y: Array, count: np.ndarray) -> None:
    from matplotlib.colors import ListedColormap

    most = len(SHADES) - 1
    ax.pcolormesh(x, y, np.minimum(count, most).T, cmap=ListedColormap(SHADES), vmin=-0.5, vmax=most + 0.5,
                  shading="nearest", gid="preimages", zorder=style.GHOSTS, rasterized=True)  # fmt: skip


def _draw_limits(space: TwoFreedoms, left: Any, right: Any) -> None:
    """Draw the rectangle of the limits, or of full turns, and the image of the limits."""
    t = np.linspace(0.0, 1.0, 200)
    for i, turns in enumerate(space.turns):
        for k, end in enumerate((space.low[i], space.high[i])):
            values = space.low + (space.high - space.low) * t[:, None]
            values[:, i] = end
            gid = f"limit:{space.names[i]}:{k}"
            left.plot(*values.T, color=style.INK, lw=1.4, ls=":" if turns else "-", gid=gid, zorder=style.CURVE)
            for image in () if turns else _images(space, values):
                right.plot(*image.T, color=style.INK, lw=1.4, gid=gid, zorder=style.CURVE)


def _images(space: TwoFreedoms, values: Array) -> list[Array]:
    """The image (n, 2) of a line of values (n, 2) in each mode, NaN where there is none."""
    p = space.places(*space.over(values))
    return [image for image in np.moveaxis(p, 1, 0) if np.isfinite(image).any()]


def _draw_other_limits(space: TwoFreedoms, left: Any, right: Any, grid: Array, q: Array) -> None:
    """Draw where coordinates that are not on the axes are at a limit, and the image of that, mode by mode."""
    system, layout = space.system, space.system.structure.layout
    turning, scale = system.structure.coordinates.turning, closure_rows.scales(system)
    for v, at in zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True):
        near = ON * (2.0 * np.pi / len(grid)) ** 2 * scale[v]
        for end in (system.lower[v] + near, system.upper[v] - near):
            if at in space.columns or not np.isfinite(end):
                continue
            for k in range(q.shape[2]):
                off = np.sin(q[..., k, at] - end) if turning[v] else q[..., k, at] - end
                for line in _zeros(left, grid, off):
                    x, ok = space.over(line)
                    ok &= np.abs(x[..., at] - end) < near
                    p = space.places(x, ok)[:, k]
                    if not ok[:, k].any():
                        continue
                    for ax, way in ((left, np.where(ok[:, k, None], line, np.nan)), (right, p)):
                        ax.plot(*way.T, color=style.INK, lw=1.4, gid=f"limit:{system.coordinate_names[at]}:{k}",
                                zorder=style.CURVE)  # fmt: skip


def _zeros(ax: Any, grid: Array, values: Array) -> list[Array]:
    """Lines (n, 2) on which values over a grid are zero."""
    if not (np.nanmin(values, initial=np.inf) < 0.0 < np.nanmax(values, initial=-np.inf)):
        return []
    lines = ax.contour(grid[:, 0, 0], grid[0, :, 1], values.T, levels=[0.0], linewidths=0.0)
    found = [np.asarray(x, dtype=float) for x in lines.allsegs[0] if len(x) > 1]
    lines.remove()
    return found


def _draw_grid(space: TwoFreedoms, left: Any, right: Any) -> None:
    """Draw lines on which one coordinate is constant, a colour for each coordinate, and their images."""
    fine = space.grid(FINE)
    for i in range(2):
        for k, at in enumerate(range(STEP, FINE - 1, STEP)):
            values = np.take(fine, at, axis=i)
            images = _images(space, values)
            for ax, line in ((left, values), *((right, p) for p in images)):
                ax.plot(*line.T, color=style.link_colour(i + 1), lw=0.8, gid=f"grid:{space.names[i]}:{k}",
                        zorder=style.CURVE)  # fmt: skip


def _draw_curves(space: TwoFreedoms, left: Any, right: Any, curves: Any) -> None:
    """Draw singular curves, and their images, in the line style of their kind."""
    for k, curve in enumerate(curves):
        at: Array = curve.q[:, space.columns]
        turned: Array = np.where(space.turns, space.low + np.mod(at - space.low, 2.0 * np.pi), at)
        jump = np.flatnonzero((np.abs(np.diff(turned, axis=0)) > np.pi).any(axis=1)) + 1
        dot = "o" if np.ptp(at, axis=0).max() < CLOSED else ""  # a part that turns by itself while both are held
        for ax, line, marker in ((left, np.insert(turned, jump, np.nan, axis=0), dot), (right, curve.p[:, :2], "")):
            ax.plot(*line.T, color=style.OPEN, lw=1.6, ls=LINES.get(curve.kinds, ":"), gid=f"singular:{k}", ms=4,
                    marker=marker, zorder=style.PINS)  # fmt: skip


def _draw_singular(space: TwoFreedoms, left: Any, right: Any, grid: Array) -> None:
    """Draw where the velocity of a chain's frame loses a direction, and the image of that."""
    system, name = space.system, space.frame
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
    space: TwoFreedoms, left: Any, right: Any, target: Array, k: int, every: Array, p: Array
) -> None:  # fmt: skip
    """Draw a place that shall be reached: its solutions, or the nearest place that is reached."""
    colour, number = style.curve_colour(k + 1), str(k + 1)
    found = space.solutions(target)
    right.plot(*target, "*" if len(found) else "X", ms=11, color=colour, mec="white", mew=0.7, gid=f"point:{k}",
               zorder=style.TEXT)  # fmt: skip
    right.annotate(number, target, xytext=(7, 5), textcoords="offset points", size=style.FONT, color=colour)
    for j, q in enumerate(found):
        at = _values(space, q)
        left.plot(*at, "o", ms=7, color=colour, mec="white", mew=0.8, gid=f"solution:{k}:{j}", zorder=style.TEXT)
        letter = f"{number}{'abcdefgh'[j]}" if len(found) > 1 and j < 8 else number
        left.annotate(letter, at, xytext=(6, 5), textcoords="offset points", size=style.FONT, color=colour)
        _draw_arm(space, right, q, colour, f"arm:{k}:{j}", "-" if j == 0 else "--")
    if not len(found):
        q, at, far = nearest(space.system, space.frame, target, every, p)
        left.plot(
            *_values(space, q), "X", ms=8, color=colour, mec="white", mew=0.7, gid=f"nearest:{k}", zorder=style.TEXT
        )
        _draw_arm(space, right, q, colour, f"arm:{k}:0", "-")
        right.plot(*np.stack([at, target]).T, color=colour, lw=1.2, ls=":", gid=f"distance:{k}", zorder=style.TEXT)
        right.annotate(f"{page.length_text(float(f'{far:.3g}'))} away", 0.5 * (at + target), xytext=(6, -10),
                       textcoords="offset points", size=style.FONT, color=colour, gid=f"distance:{k}:text")  # fmt: skip


def _values(space: TwoFreedoms, q: Array) -> Array:
    """Where a configuration (nq,) is on the left (2,)."""
    at = q[space.columns]
    return np.where(space.turns, space.low + np.mod(at - space.low, 2.0 * np.pi), at)


def _draw_arm(space: TwoFreedoms, ax: Any, q: Array, colour: str, gid: str, line: str) -> None:
    """Draw the bodies from the ground to the frame as a line through their joints; of loops each body as a line."""
    system, name = space.system, space.frame
    if space.modes:
        scene = look(system, q)
        bars = {link.name: scene.points(link) for link in scene.links[1:]}
        bars |= {j.name: np.array([j.F[:3, 3], j.M[:3, 3]]) for j in scene.joints if j.kind == "prismatic"}
        for bar, points in bars.items():
            ax.plot(*points[:, :2].T, color=colour, lw=1.5, ls=line, marker="o", ms=3.5, alpha=0.8, gid=f"{gid}:{bar}",
                    zorder=style.POINTS)  # fmt: skip
        corners = np.concatenate([*bars.values()])[:, :2]
        low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
        room = 0.02 * (high - low)
        low, high = np.minimum(low, corners.min(axis=0) - room), np.maximum(high, corners.max(axis=0) + room)
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        return
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


def _finish(space: TwoFreedoms, left: Any, right: Any, curves: Any) -> None:
    """Say what the axes, the shades and the lines are."""
    unit = units(space.system)
    for ax in (left, right):
        page.light_axes(ax)
    for i, (limits, label) in enumerate(((left.set_xlim, left.set_xlabel), (left.set_ylim, left.set_ylabel))):
        room = 0.04 * (space.high[i] - space.low[i])
        limits(space.low[i] - room, space.high[i] + room)
        label(f"{space.names[i]} [{unit[space.names[i]]}]", size=style.FONT, color=style.INK)
    right.set_xlabel("x [m]", size=style.FONT, color=style.INK)
    right.set_ylabel("y [m]", size=style.FONT, color=style.INK)
    right.set_aspect("equal", adjustable="box")
    left.set_title("configuration space", size=style.FONT + 1, color=style.INK)
    right.set_title(f"task space: position of {space.frame!r}", size=style.FONT + 1, color=style.INK)
    right.legend(handles=[*_shade_entries(space, left, right), *_line_entries(space, curves)], loc="upper left",
                 bbox_to_anchor=(1.03, 1.0), fontsize=style.FONT - 1, frameon=False)  # fmt: skip


def _shade_entries(space: TwoFreedoms, left: Any, right: Any) -> list[Any]:
    """Entries of the legend about the shades that are seen."""
    from matplotlib.patches import Patch

    seen: list[np.ndarray] = [np.asarray(mesh.get_array()) for ax in (left, right) for mesh in ax.collections
            if mesh.get_gid() == "preimages"]  # fmt: skip
    count = [k for k in range(len(SHADES)) if any(float((x == k).mean()) > FEW for x in seen)]
    more = range(2, len(SHADES) - 1)
    words = ["not reached", "reached in 1 way", *(f"reached in {k} ways" for k in more), "in more ways"]
    if space.modes and space.counted:
        words = ["none", "1 mode, or 1 way", *(f"{k} modes, or {k} ways" for k in more), "more"]
    elif space.modes:
        words = ["none", "1 mode, or reached", *(f"{k} modes" for k in more), "more modes"]
    return [Patch(fc=SHADES[k], ec=style.FAINT, label=words[k]) for k in count]


def _line_entries(space: TwoFreedoms, curves: Any) -> list[Any]:
    """Entries of the legend about lines."""
    from matplotlib.lines import Line2D

    kinds = sorted({c.kinds for c in curves or ()})
    styles = [(f"singular, {' and '.join(k)}", LINES.get(k, ":")) for k in kinds]
    styles = [("singular", "-")] if curves is None else styles
    entries = [Line2D([], [], color=style.OPEN, lw=1.6, ls=line, label=label) for label, line in styles]
    limited = np.isfinite(space.system.lower) | np.isfinite(space.system.upper)
    if not space.turns.all() or (space.modes and limited.any()):
        entries.append(Line2D([], [], color=style.INK, lw=1.4, label="limits"))
    return entries
