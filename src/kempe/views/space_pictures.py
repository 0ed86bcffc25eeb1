"""Pictures of the configuration space and the task space of a system with two freedoms.

Left is the configuration space, right what a frame's origin sees of it; colours are numbers of
configurations within the limits. Needs the extra [view].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import call_until_interrupt, explain_errors, numbers, read_flag
from kempe.arrays import is_real, is_whole
from kempe.budget import Budget, Usual
from kempe.constraints.flat_tasks import FlatTask, find_flat_task
from kempe.equations.judge import closure_error
from kempe.errors import InputError, Interrupted, TimeLimitError, UnsupportedError, format_value
from kempe.forward.fk import fk
from kempe.model.configurations import has_loops, list_units, read_q, refuse_large_numbers
from kempe.motion.trace import trace
from kempe.numerics.clock import TIME_LIMIT, TimeLimit, describe_early_end
from kempe.spaces.two_freedoms import NEEDED, TwoFreedoms, make_two_freedoms
from kempe.spatial import Array
from kempe.status import Status
from kempe.units import name_lengths
from kempe.views.drawing import page, style
from kempe.views.drawing.scene import build_scene
from kempe.views.singular_plot import LINES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike, Model

SHADES = ("#ffffff", "#d3e3f2", "#8db8dc", "#4c7fb0", "#2f5d8a", "#1b3d63")
"""Colours of places with no, one, two, three, four and more configurations: from light to dark, to
read in grey."""
FINEST = 1000
COARSEST = 8
FINE = 145
STEP = 12
"""Points of a line of the grid, and how many lie between two lines: those are 1/12 of a side
apart."""
FEW = 0.005
"""Part of a space from which the legend names its shade."""
ROOM = 0.06
"""Room around the task space, as a part of its width."""
APART = 0.5
CLOSED = 1e-6
"""How far apart configurations of one line are at most, in radians and characteristic lengths; how
far loops may be open."""
DIRECTIONS = np.array([np.pi, 0.5 * np.pi])
"""The largest azimuth and elevation."""
ROUNDING = 1e-9
"""Angle in radians below which a configuration is at the end of a full turn."""
LINES_OF_LIMIT = 12
"""Lines on which one coordinate is at one of its limits, at most."""
USUAL = Usual("plot_spaces", time_limit=TIME_LIMIT, progress=None)


@explain_errors
def plot_spaces(
    system: Model,
    frame: FrameLike,
    *,
    points: ArrayLike = (),
    q: Any = None,
    task: str | None = None,
    grid: bool = False,
    ax: Any = None,
    resolution: int = 240,
    budget: Budget | None = None,
) -> tuple[Axes, Axes]:
    """Draw the configuration space and a frame's task space; see `System.plot_spaces`."""
    name = system.structure.frame_name(frame)
    seen = find_flat_task(task, system.dim)
    spend = USUAL.complete_budget(budget)
    targets = _read_targets(points, seen)
    if not is_whole(resolution) or not COARSEST <= resolution <= FINEST:
        raise InputError(
            f"resolution is {format_value(resolution)}; it must be a whole number, {COARSEST} to "
            f"{FINEST}"
        )
    lines = read_flag(grid, "grid")
    given = [_read_configurations(system, x) for x in _split_configurations(q)]
    dots = [x for x in given if x.ndim == 1]
    motions = [x for x in given if x.ndim == 2]
    own = None if ax is None else page.check_axes(ax, 2)
    space = make_two_freedoms(system, name, seen, TimeLimit(spend.time_limit))
    space.progress = spend.progress
    curves = _find_singular_curves(space)
    if own is None:
        figure = page.make_figure(11.8, 5.0)
        own = figure.add_axes((0.06, 0.12, 0.36, 0.8)), figure.add_axes((0.49, 0.12, 0.36, 0.8))
    left, right = own
    every = space.make_grid(int(resolution))
    over, mask = space.solve_grid(int(resolution))
    p = space.compute_places(over, mask)
    if not mask.any():
        raise UnsupportedError(
            f"{system.name}: no configuration was found inside the limits{_describe_missing_part(space.broken)}"
        )
    _shade_task_space(space, right, p, targets, int(resolution))
    _shade_counts(left, every[:, 0, 0], every[0, :, 1], space.count_modes(over, mask))
    _draw_limits(space, left, right)
    if has_loops(system):
        _draw_other_limits(space, left, right, over[mask])
    if lines:
        _draw_grid(space, left, right)
    _draw_curves(space, left, right, curves)
    for k, target in enumerate(targets):
        _draw_point(space, left, right, target, k, over[mask], p[mask])
    for k, motion in enumerate(motions):
        _draw_motion(space, left, right, motion, k, style.choose_curve_colour(len(targets) + k + 1))
    for k, x in enumerate(dots):
        _draw_configuration(space, left, right, x, k)
    _finish_axes(space, left, right, curves, len(targets), motions)
    if Status.INTERRUPTED in (space.broken, getattr(curves, "broken", None)):
        raise Interrupted((left, right))
    return left, right


def _read_targets(points: ArrayLike, seen: FlatTask) -> Array:
    """Read points as an array (k, 2). Errors: `InputError`."""
    targets = numbers(points, "points")
    targets = targets.reshape(0, 2) if not targets.size else targets
    if targets.ndim != 2 or targets.shape[1] != 2 or not np.isfinite(targets).all():
        unit = (
            "azimuths and elevations in radians"
            if seen.directional
            else f"places {', '.join(seen.name)} in metres"
        )
        raise InputError(f"points has shape {targets.shape}; it must be (k, 2), {unit}")
    return targets


def _split_configurations(q: Any) -> list[Any]:
    """Split the argument `q` into single configurations, lines of configurations and answers."""
    if q is None:
        return []
    if not isinstance(q, (list, tuple)):
        return [q]
    several: list[Any] = [*q]
    return [several] if all(is_real(x) for x in several) else several


def _read_configurations(system: Model, q: Any) -> Array:
    """Read a configuration (nq,) or a line (n, nq), without rows of NaN. Errors: `InputError`."""
    array = read_q(system, getattr(q, "q", q))
    if array.ndim > 2:
        raise InputError(
            f"q has shape {array.shape}; it must be ({system.nq},) or (n, {system.nq})"
        )
    if array.ndim == 1:
        return refuse_large_numbers(system, array, "q")
    return array[np.isfinite(array).all(axis=1)]


def find_nearest(
    system: Model, frame: str, task: FlatTask, target: Array, q: Array, p: Array
) -> tuple[Array, Array, float]:
    """Find the configuration whose frame is nearest to a target (2,).

    Candidates are q (..., nq) at places p (..., 2), and what `ik` finds from the nearest of these.
    Returned are the configuration, its place, and the distance.
    """
    from kempe.inverse.ik import ik

    start = q.reshape(-1, system.nq)[
        int(np.argmin(task.compute_distance(p.reshape(-1, 2), target)))
    ]
    found = ik(system, task.make_constraint(frame, target), start=start).q
    finite = (x for x in (start, found) if np.isfinite(x).all())
    tries = [(x, task.project_poses(fk(system, x, frame))) for x in finite if _is_closed(system, x)]
    x, at = min(tries, key=lambda row: float(task.compute_distance(row[1], target)))
    return x, at, float(task.compute_distance(at, target))


def _is_closed(system: Model, q: Array) -> bool:
    """Whether all loops are closed at a configuration."""
    return float(np.abs(closure_error(system, q)).max(initial=0.0)) < CLOSED


# ---- parts of the picture


def _find_singular_curves(space: TwoFreedoms) -> Any:
    """Find the singular curves of a system. Errors: `UnsupportedError`."""
    system = space.system
    name = space.frame
    task = space.task
    on_curve = (
        f"{NEEDED} and of a frame that moves in both: {task.describe_task(name)} of {system.name} moves on "
        "a curve"
    )
    hint = "" if system.dim == 2 else '; task may be "xy", "xz", "yz" or "direction"'
    from kempe.spaces.singularities import singularities

    kind = task.name if system.dim == 3 else "position"
    try:
        budget = Budget(time_limit=space.clock.remaining_seconds)
        found = singularities(
            system, name, kind, inputs=space.names if space.modes else None, budget=budget
        )
    except TimeLimitError:
        raise TimeLimitError(USUAL.verb, space.clock.limit) from None
    if found.analysis.frame_rank < 2:
        raise UnsupportedError(on_curve + hint)
    # where all is singular there are no lines
    if min((s.dimension for s in found.sets), default=0) > 1:
        return ()
    curves = call_until_interrupt(
        found.curves, budget=Budget(time_limit=space.clock.remaining_seconds)
    )
    if curves.broken is Status.INTERRUPTED:
        space.clock.end = (
            space.clock.soon
        ) = -np.inf  # what follows ends at once, with what there is
        space.clock.limit = space.clock.limit or 0.0
    return curves


def _shade_task_space(space: TwoFreedoms, ax: Any, p: Array, targets: Array, n: int) -> None:
    """Shade the task space by the number of configurations at each place."""
    every = np.concatenate([p.reshape(-1, 2), targets])
    low = np.nanmin(every, axis=0)
    high = np.nanmax(every, axis=0)
    room = ROOM * max(float((high - low).max()), 1e-9)
    ends = DIRECTIONS if space.task.directional else np.full(2, np.inf)
    low = np.maximum(low - room, -ends)
    high = np.minimum(high + room, ends)
    x, y = (np.linspace(float(low[i]), float(high[i]), n) for i in range(2))
    _shade_counts(ax, x, y, space.count_reaching_grid(x, y))
    ax.set_xlim(x[0], x[-1])
    ax.set_ylim(y[0], y[-1])


def _shade_counts(ax: Any, x: Array, y: Array, count: np.ndarray) -> None:
    """Shade the cells of a grid by their counts."""
    from matplotlib.colors import ListedColormap

    most = len(SHADES) - 1
    ax.pcolormesh(
        x,
        y,
        np.minimum(count, most).T,
        cmap=ListedColormap(SHADES),
        vmin=-0.5,
        vmax=most + 0.5,
        shading="nearest",
        gid="preimages",
        zorder=style.GHOSTS,
        rasterized=True,
    )


def _draw_limits(space: TwoFreedoms, left: Any, right: Any) -> None:
    """Draw the rectangle of the limits, or of full turns, and its image in the task space."""
    t = np.linspace(0.0, 1.0, 200)
    for i, turns in enumerate(space.turns):
        for k, end in enumerate((space.low[i], space.high[i])):
            values = space.low + (space.high - space.low) * t[:, None]
            values[:, i] = end
            gid = f"limit:{space.names[i]}:{k}"
            left.plot(
                *values.T,
                color=style.INK,
                lw=1.4,
                ls=":" if turns else "-",
                gid=gid,
                zorder=style.CURVE,
            )
            for image in () if turns else _map_values(space, values):
                right.plot(*image.T, color=style.INK, lw=1.4, gid=gid, zorder=style.CURVE)


def _map_values(space: TwoFreedoms, values: Array) -> list[Array]:
    """Map a line of values (n, 2) to the task space (n, 2) in each mode; NaN where impossible."""
    p = space.compute_places(*space.solve_line(values))
    return [
        _split_at_jumps(space, image) for image in np.moveaxis(p, 1, 0) if np.isfinite(image).any()
    ]


def _split_at_jumps(space: TwoFreedoms, line: Array) -> Array:
    """Split a line (n, 2) in the task space where an azimuth jumps by a turn, with NaN."""
    jump = np.flatnonzero(np.abs(np.diff(line[:, 0])) > np.pi) + 1 if space.task.directional else ()
    return np.insert(line, jump, np.nan, axis=0)


def _draw_other_limits(space: TwoFreedoms, left: Any, right: Any, q: Array) -> None:
    """Draw where other coordinates are at a limit, and the image of these lines."""
    system = space.system
    layout = space.system.structure.layout
    solver = space.solver
    for v, at in zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True):
        k = 0
        name = system.coordinate_names[int(at)]
        for end in (system.lower[v], system.upper[v]):
            if at in space.columns or not np.isfinite(end):
                continue
            off = np.abs(q[:, at] - end) / space.manifold.scale[v]
            near = q[np.argsort(off)[: int((off < APART).sum())]]
            for _ in range(LINES_OF_LIMIT):
                if not len(near):
                    break
                path = trace(
                    system,
                    start=near[0],
                    hold={name: float(end)},
                    budget=Budget(time_limit=space.clock.remaining_seconds),
                )
                line = np.concatenate([near[:1], path.q])
                near = near[[solver.compute_distances(x[None], line).min() > APART for x in near]]
                if len(path.q) > 1:
                    _draw_line(
                        space,
                        left,
                        right,
                        path.q,
                        f"limit:{name}:{k}",
                        color=style.INK,
                        lw=1.4,
                        zorder=style.CURVE,
                    )
                    k += 1


def _draw_line(
    space: TwoFreedoms, left: Any, right: Any, q: Array, gid: str, marker: str = "", **look: Any
) -> None:
    """Draw a line of configurations (n, nq) in both spaces; a `marker` in the left one only."""
    turned = _list_values(space, q)
    jump = np.flatnonzero((np.abs(np.diff(turned, axis=0))[:, space.turns] > np.pi).any(axis=1)) + 1
    left.plot(*np.insert(turned, jump, np.nan, axis=0).T, gid=gid, marker=marker, ms=4, **look)
    right.plot(
        *_split_at_jumps(space, space.task.project_poses(fk(space.system, q, space.frame))).T,
        gid=gid,
        **look,
    )


def _draw_grid(space: TwoFreedoms, left: Any, right: Any) -> None:
    """Draw lines with one constant coordinate, and their images in the task space."""
    fine = space.make_grid(FINE)
    for i in range(2):
        for k, at in enumerate(range(STEP, FINE - 1, STEP)):
            values = np.take(fine, at, axis=i)
            images = _map_values(space, values)
            for ax, line in ((left, values), *((right, p) for p in images)):
                ax.plot(
                    *line.T,
                    color=style.choose_link_colour(i + 1),
                    lw=0.8,
                    gid=f"grid:{space.names[i]}:{k}",
                    zorder=style.CURVE,
                )


def _draw_curves(space: TwoFreedoms, left: Any, right: Any, curves: Any) -> None:
    """Draw singular curves and their images, in the line style of their kind."""
    for k, curve in enumerate(curves):
        # a part turns while both are held
        still = np.ptp(curve.q[:, space.columns], axis=0).max() < CLOSED
        _draw_line(
            space,
            left,
            right,
            curve.q,
            f"singular:{k}",
            "o" if still else "",
            color=style.OPEN,
            lw=1.6,
            ls=LINES.get(curve.kinds, ":"),
            zorder=style.PINS,
        )


def _draw_point(
    space: TwoFreedoms, left: Any, right: Any, target: Array, k: int, every: Array, p: Array
) -> None:
    """Draw a target with its solutions, or with the nearest place that is reached."""
    colour = style.choose_curve_colour(k + 1)
    number = str(k + 1)
    found = space.find_solutions(target)
    right.plot(
        *target,
        "*" if len(found) else "X",
        ms=11,
        color=colour,
        mec="white",
        mew=0.7,
        gid=f"point:{k}",
        zorder=style.TEXT,
    )
    right.annotate(
        number, target, xytext=(7, 5), textcoords="offset points", size=style.FONT, color=colour
    )
    for j, q in enumerate(found):
        at = _list_values(space, q)
        left.plot(
            *at,
            "o",
            ms=7,
            color=colour,
            mec="white",
            mew=0.8,
            gid=f"solution:{k}:{j}",
            zorder=style.TEXT,
        )
        letter = f"{number}{'abcdefgh'[j]}" if len(found) > 1 and j < 8 else number
        left.annotate(
            letter, at, xytext=(6, 5), textcoords="offset points", size=style.FONT, color=colour
        )
        _draw_arm(space, right, q, colour, f"arm:{k}:{j}", "-" if j == 0 else "--")
    if not len(found):
        q, at, far = find_nearest(space.system, space.frame, space.task, target, every, p)
        said = (
            f"{np.degrees(far):.3g}°"
            if space.task.directional
            else page.format_length(float(f"{far:.3g}"), space.system.unit)
        )
        left.plot(
            *_list_values(space, q),
            "X",
            ms=8,
            color=colour,
            mec="white",
            mew=0.7,
            gid=f"nearest:{k}",
            zorder=style.TEXT,
        )
        _draw_arm(space, right, q, colour, f"arm:{k}:0", "-")
        right.plot(
            *np.stack([at, target]).T,
            color=colour,
            lw=1.2,
            ls=":",
            gid=f"distance:{k}",
            zorder=style.TEXT,
        )
        # towards the middle, below the number
        side = -1 if target[0] > np.mean(right.get_xlim()) else 1
        right.annotate(
            f"{said} away",
            target,
            xytext=(11 * side, -13),
            textcoords="offset points",
            size=style.FONT,
            color=colour,
            ha={1: "left", -1: "right"}[side],
            gid=f"distance:{k}:text",
        )


def _draw_motion(space: TwoFreedoms, left: Any, right: Any, q: Array, k: int, colour: str) -> None:
    """Draw a path (n, nq) as a line in both spaces, with a ring at its start."""
    if not len(q):
        return
    _draw_line(space, left, right, q, f"path:{k}", color=colour, lw=2.0, zorder=style.TEXT)
    begins = (
        _list_values(space, q[0]),
        space.task.project_poses(fk(space.system, q[0], space.frame)),
    )
    for ax, place in zip((left, right), begins, strict=True):
        ax.plot(
            *place,
            "o",
            ms=7,
            mfc="white",
            mec=colour,
            mew=1.6,
            gid=f"begin:{k}",
            zorder=style.TEXT,
        )


def _draw_configuration(space: TwoFreedoms, left: Any, right: Any, q: Array, k: int) -> None:
    """Draw a configuration (nq,) as a dot in both spaces, with the bodies in the task space."""
    place = space.task.project_poses(fk(space.system, q, space.frame))
    for ax, at in ((left, _list_values(space, q)), (right, place)):
        ax.plot(
            *at,
            "o",
            ms=7,
            color=style.INK,
            mec="white",
            mew=0.8,
            gid=f"configuration:{k}",
            zorder=style.TEXT,
        )
    _draw_arm(space, right, q, style.INK, f"configuration:{k}:arm", "-")


def _list_values(space: TwoFreedoms, q: Array) -> Array:
    """Return the two coordinates (..., 2) of configurations (..., nq) that span the left picture."""
    at = q[..., space.columns]
    # what is at the lower end of a full turn but for rounding is not moved to the upper one
    turned = np.mod(at - space.low + ROUNDING, 2.0 * np.pi) - ROUNDING
    return np.where(space.turns, space.low + turned, at)


def _draw_arm(space: TwoFreedoms, ax: Any, q: Array, colour: str, gid: str, line: str) -> None:
    """Draw the bodies as lines through their joints and frames, and make room for them."""
    system = space.system
    axes = space.task.axes
    if not axes:
        return
    scene = build_scene(system, q)
    bars = {link.name: scene.list_points(link) for link in scene.links[1:]}
    bars |= {
        j.name: np.array([j.F[:3, 3], j.M[:3, 3]]) for j in scene.joints if j.kind == "prismatic"
    }
    for bar, points in bars.items():
        ax.plot(
            *points[:, axes].T,
            color=colour,
            lw=1.5,
            ls=line,
            marker="o",
            ms=3.5,
            alpha=0.8,
            gid=f"{gid}:{bar}",
            zorder=style.POINTS,
        )
    corners = np.concatenate([*bars.values()])[:, axes]
    low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
    room = 0.02 * (high - low)
    low = np.minimum(low, corners.min(axis=0) - room)
    high = np.maximum(high, corners.max(axis=0) + room)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])


def _finish_axes(
    space: TwoFreedoms, left: Any, right: Any, curves: Any, first: int, motions: list[Array]
) -> None:
    """Add labels of the axes, titles and the legend."""
    unit = list_units(space.system)
    for ax in (left, right):
        page.draw_light_axes(ax)
        ax.ticklabel_format(style="sci", scilimits=(-3, 4))
    for i, (limits, label) in enumerate(
        ((left.set_xlim, left.set_xlabel), (left.set_ylim, left.set_ylabel))
    ):
        room = 0.04 * (space.high[i] - space.low[i])
        limits(space.low[i] - room, space.high[i] + room)
        label(f"{space.names[i]} [{unit[space.names[i]]}]", size=style.FONT, color=style.INK)
    right.set_xlabel(
        name_lengths(space.task.labels[0], space.system.unit), size=style.FONT, color=style.INK
    )
    right.set_ylabel(
        name_lengths(space.task.labels[1], space.system.unit), size=style.FONT, color=style.INK
    )
    right.set_aspect("equal", adjustable="box")
    left.set_title("configuration space", size=style.FONT + 1, color=style.INK)
    said = f"task space: {space.task.describe_task(space.frame)}{'' if space.complete else ', as found'}"
    right.set_title(said, size=style.FONT + 1, color=style.INK)
    if said := _describe_missing_part(space.broken, getattr(curves, "broken", None)):
        left.text(
            0.0,
            -0.14,
            said.strip(),
            transform=left.transAxes,
            size=style.FONT - 1,
            color=style.OPEN,
            gid="partial",
        )
    right.legend(
        handles=[
            *_list_shade_entries(space, left, right),
            *_list_line_entries(space, curves),
            *_list_path_entries(first, len(motions)),
        ],
        loc="upper left",
        bbox_to_anchor=(1.03, 1.0),
        fontsize=style.FONT - 1,
        frameon=False,
    )


def _describe_missing_part(*broken: Status | None) -> str:
    """Describe that a part of the picture is missing; '' if the work was not interrupted."""
    return describe_early_end(Status.INTERRUPTED in broken, Status.OUT_OF_TIME in broken)


def _list_shade_entries(space: TwoFreedoms, left: Any, right: Any) -> list[Any]:
    """List the legend entries of the shades in the picture."""
    from matplotlib.patches import Patch

    seen: list[np.ndarray] = [
        np.asarray(mesh.get_array())
        for ax in (left, right)
        for mesh in ax.collections
        if mesh.get_gid() == "preimages"
    ]
    count = [k for k in range(len(SHADES)) if any(float((x == k).mean()) > FEW for x in seen)]
    more = range(2, len(SHADES) - 1)
    words = [
        "not reached",
        "reached in 1 way",
        *(f"reached in {k} ways" for k in more),
        "in more ways",
    ]
    if space.modes:
        words = ["none", "1 mode, or 1 way", *(f"{k} modes, or {k} ways" for k in more), "more"]
    return [Patch(fc=SHADES[k], ec=style.FAINT, label=words[k]) for k in count]


def _list_line_entries(space: TwoFreedoms, curves: Any) -> list[Any]:
    """List the legend entries of lines."""
    from matplotlib.lines import Line2D

    loops = bool(space.system.structure.closures)  # of a chain all are serial
    entries = [
        Line2D(
            [],
            [],
            color=style.OPEN,
            lw=1.6,
            ls=LINES.get(kinds, ":"),
            label=f"singular, {' and '.join(kinds)}" if loops else "singular",
        )
        for kinds in sorted({c.kinds for c in curves})
    ]
    limited = np.isfinite(space.system.lower) | np.isfinite(space.system.upper)
    if not space.turns.all() or (space.modes and limited.any()):
        entries.append(Line2D([], [], color=style.INK, lw=1.4, label="limits"))
    return entries


def _list_path_entries(first: int, count: int) -> list[Any]:
    """List the legend entries of paths, whose colours follow those of the points."""
    from matplotlib.lines import Line2D

    names = ["path"] if count == 1 else [f"path {k + 1}" for k in range(count)]
    return [
        Line2D([], [], color=style.choose_curve_colour(first + k + 1), lw=2.0, label=name)
        for k, name in enumerate(names)
    ]
