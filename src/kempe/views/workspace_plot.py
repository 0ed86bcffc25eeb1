"""Pictures of what is reached, with matplotlib: counts of cells, exact regions in the plane,
fractions reached.

Importing it needs the extra [view]. Errors: `MissingExtraError` without matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import numbers
from kempe.errors import InputError, UnsupportedError
from kempe.spatial import Array
from kempe.units import METRE
from kempe.views.drawing import page, shapes, space, style
from kempe.views.plots import plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.workspace.answer import Workspace
    from kempe.workspace.base_placement import BasePlacement
    from kempe.workspace.capability import CapabilityMap
    from kempe.workspace.planar.planar_workspace import PlanarWorkspace
    from kempe.workspace.reach import ReachStudy

COLOURS = "cividis_r"
"""Darker is more often: it reads in grey, and for those who see fewer colours."""
OUTLINE = 400
"""Points of a grid along each side of a slice, between which the boundary of a solid is drawn."""
FEW = 10
"""Samples in a cell from which on the colours are logarithmic."""
PAIRS = ((0, 1, 2), (0, 2, 1), (1, 2, 0))
"""For each slice the axis to the right, the one upwards, and the one that is cut."""


def plot_workspace(workspace: Workspace, at: Any = None, ax: Any = None) -> Any:
    """Draw the sample counts of a workspace by cell, white where no sample fell.

    Samples that are places or orientations count where they are reached. In the plane one axes, in
    space an array of three, slices through the point `at` (3,) [m], by default the middle of what
    is reached (of orientations azimuth, height, roll); with the exact boundary in red where it is
    known, else with a line around the cells with samples. `ax` are the axes to draw on, as many.
    Errors: `InputError`.
    """
    grid = workspace.map.grid
    counts = workspace.map.counts
    d = len(grid.axes)
    if not workspace.map.occupied.any():
        raise InputError("no sample fell into the box: there is nothing to draw")
    if d == 1:
        raise InputError(
            "the workspace is a piece of a line: there is nothing to draw; see `.boundary`"
        )
    if d == 2:
        if at is not None:
            raise InputError("at= chooses a slice of a workspace in space; this one is planar")
        axes = page.make_figure(5.6, 4.6).add_subplot() if ax is None else page.check_axes(ax)[0]
        _draw_slice(workspace, axes, counts, 0, 1, counts.max(initial=1))
        _add_colour_bar(workspace, axes, [axes])
        for piece in workspace.outline:
            p = shapes.sample_piece(piece)
            axes.plot(np.real(p), np.imag(p), color=style.OPEN, linewidth=1.2, gid="boundary")
        return axes
    point = numbers(at, "at", 3) if at is not None else workspace.map.points.mean(axis=0)
    place, inside = grid.locate_cells(np.asarray(point))
    if point.shape != (3,) or not inside:
        raise InputError(f"at is {at!r}; it must be one point (3,) inside the box")
    if ax is None:
        figure = page.make_figure(11.0, 3.4)
        figure.set_layout_engine("constrained")
        axes = figure.subplots(1, 3)
    else:
        axes = page.check_axes(ax, 3)
    layers = [np.take(counts, place[cut], axis=cut) for *_, cut in PAIRS]
    most = max(int(layer.max(initial=1)) for layer in layers)
    for one, layer, (right, up, cut) in zip(axes, layers, PAIRS, strict=True):
        _draw_slice(workspace, one, layer, right, up, most)
        if workspace.exact is not None:
            _draw_outline(
                workspace.exact,
                one,
                (right, up),
                float(grid.list_centres(grid.axes[cut])[place[cut]]),
            )
        name = grid.axes[cut]
        here = grid.list_centres(grid.axes[cut])[place[cut]]
        # what rounding leaves of a middle at zero
        here = here if abs(here) > 1e-6 * grid.size[cut] else 0.0
        one.set_title(
            f"{name} = {here:.3g}{_format_unit(workspace, name)}",
            size=style.FONT,
            color=style.INK,
            pad=11,
        )
    _add_colour_bar(workspace, axes[0], list(axes))
    return axes


def _draw_slice(
    workspace: Workspace, ax: Axes, counts: np.ndarray, right: int, up: int, most: int
) -> None:
    """Draw the counts of one slice, and the outline of its cells with samples."""
    from matplotlib.colors import LogNorm, Normalize

    grid = workspace.map.grid
    names = workspace.map.grid.axes
    shown = np.ma.masked_equal(counts, 0).T
    low, high = (np.array(x)[grid.measured_axes] for x in (grid.low, grid.high))
    extent = (low[right], high[right], low[up], high[up])
    norm = LogNorm(1, most) if most > FEW else Normalize(int(most > 1), max(most, 2))
    ax.imshow(
        shown,
        origin="lower",
        extent=extent,
        cmap=COLOURS,
        norm=norm,
        interpolation="nearest",
        gid="counts",
    )
    filled = np.pad(counts > 0, 1).astype(float).T
    x, y = (_add_outer_cells(grid.list_centres(names[k]), float(grid.size[k])) for k in (right, up))
    if filled.any() and workspace.exact is None:
        ax.contour(x, y, filled, levels=[0.5], colors=style.INK, linewidths=0.8)
    units = {
        name: f" [{unit}]" if (unit := _format_unit(workspace, name).strip()) else ""
        for name in names
    }
    ax.set_xlabel(f"{names[right]}{units[names[right]]}", size=style.FONT, color=style.INK)
    ax.set_ylabel(f"{names[up]}{units[names[up]]}", size=style.FONT, color=style.INK)
    ax.tick_params(labelsize=style.FONT - 1, colors=style.GROUND)
    ax.ticklabel_format(style="sci", scilimits=(-3, 4))
    ax.set_aspect("equal" if workspace.map.unit == "m" else "auto")


def _draw_outline(exact: Any, ax: Axes, axes: tuple[int, int], here: float) -> None:
    """Draw the boundary of an exact solid in the plane of a slice."""
    right, up = axes
    x, y = (np.linspace(*limits, OUTLINE) for limits in (ax.get_xlim(), ax.get_ylim()))
    points = np.full((OUTLINE, OUTLINE, 3), here)
    points[..., right], points[..., up] = np.meshgrid(x, y)
    inside = exact.contains(points.reshape(-1, 3)).reshape(OUTLINE, OUTLINE)
    if inside.any():
        lines = ax.contour(
            x, y, inside.astype(float), levels=[0.5], colors=style.OPEN, linewidths=1.2
        )
        lines.set_gid("boundary")


def _format_unit(workspace: Workspace, axis: str) -> str:
    """Return the unit of an axis with a blank before it; '' for heights."""
    unit = workspace.map.unit
    return "" if axis == "height" else f" {workspace.system.unit if unit == METRE else unit}"


def _add_outer_cells(middles: Array, size: float) -> Array:
    """Add one more cell on each side to the middles (n,) of cells."""
    return np.concatenate([[middles[0] - size], middles, [middles[-1] + size]])


def _add_colour_bar(workspace: Workspace, first: Axes, axes: list[Any]) -> None:
    """Add a colour bar, unless cells are only reached or not."""
    from matplotlib.ticker import MaxNLocator

    workspace_kind = workspace.workspace_kind
    shown = first.images[0]
    low, high = shown.get_clim()
    if workspace_kind.tried and low == 0.0:
        return
    bar = first.figure.colorbar(shown, ax=axes, shrink=0.85)
    what = (
        f"{workspace_kind.noun}s reached in a cell" if workspace_kind.tried else "samples in a cell"
    )
    bar.set_label(what, size=style.FONT, color=style.INK)
    bar.ax.tick_params(labelsize=style.FONT - 1)
    if high <= FEW:
        bar.locator = MaxNLocator(integer=True)
        bar.update_ticks()


def plot_planar(workspace: PlanarWorkspace, ax: Axes | None = None) -> Axes:
    """Draw the regions of a planar workspace, darker with more solutions, and its boundary."""
    from matplotlib.patches import PathPatch

    own = ax is None
    ax = (
        page.make_figure(4.6, 4.6).add_axes((0.16, 0.12, 0.8, 0.78))
        if ax is None
        else page.check_axes(ax)[0]
    )
    for region in workspace.regions:
        shade = max(0.8 * 0.8 ** ((region.solutions or 1) - 1), 0.15)
        label = (
            "reached"
            if region.solutions is None
            else f"{region.solutions} solution{'s' * (region.solutions > 1)}"
        )
        ax.add_patch(
            PathPatch(
                shapes.make_region_outline(region),
                facecolor=(0.9 * shade, shade, 1.0),
                edgecolor="none",
                label=label,
            )
        )
    for piece in workspace.boundary:
        p = shapes.sample_piece(piece)
        ax.plot(np.real(p), np.imag(p), color="0.15", linewidth=1.2)
    ax.set_aspect("equal")
    page.draw_light_axes(ax)
    ax.set_xlabel(f"x [{workspace.system.unit}]", size=style.FONT, color=style.INK)
    ax.set_ylabel(f"y [{workspace.system.unit}]", size=style.FONT, color=style.INK)
    ax.set_title(
        f"{workspace.frame}: {workspace.area:.4g} {workspace.system.unit}²",
        size=style.FONT + 1,
        color=style.INK,
    )
    if workspace.regions:
        page.draw_legend(ax, own)
    return ax


def _draw_picture(
    ax: Axes | None, x: Array, y: Array, values: Array, labels: tuple[str, str]
) -> Axes:
    """Draw values on a grid as colours from 0 to 1, with labelled axes and a colour bar."""
    ax = page.make_figure().add_subplot() if ax is None else page.check_axes(ax)[0]
    drawn = ax.pcolormesh(x, y, values.T, vmin=0.0, vmax=1.0, cmap="viridis", shading="nearest")
    ax.figure.colorbar(drawn, ax=ax, label="fraction reached")
    ax.set_xlabel(labels[0])
    ax.set_ylabel(labels[1])
    return ax


def plot_reach(study: ReachStudy, ax: Axes | None = None) -> Axes:
    """Draw the system at its best reached pose, and all poses as dots, crosses and rings."""
    system = study.system
    best = np.where(study.reached, study.margin, -np.inf)
    dim = system.dim
    shape = study.targets.shape[1:]
    points = study.targets[:, :3, 3] if shape == (4, 4) else study.targets
    if points.ndim != 2 or points.shape[1] < dim:
        raise UnsupportedError("orientations have no places to draw")
    # frames of their own are drawn anyway
    marked = [study.frame] if study.frame in system.body_names else []
    shown = study.q[int(np.argmax(best))] if study.reached.any() else None
    drawn: Any = plot(system, shown, ax=ax, frames=marked)
    marks = (
        ("reached", "o", study.reached & study.tried),
        ("not reached", "x", ~study.reached & study.tried),
        ("not tried", "$\\circ$", ~study.tried),
    )
    for name, mark, which in marks:
        if which.any():
            line = drawn.plot(
                *points[which, :dim].T,
                mark,
                color=style.MOTION if mark == "o" else style.OPEN,
                label=name,
            )
            line[0].set_gid(f"poses:{name}")
    _set_axis_limits(drawn, points[np.isfinite(points).all(axis=1), :dim], ax is None)
    if len(points):
        page.draw_legend(drawn, ax is None)
    return drawn


def _set_axis_limits(ax: Any, points: Array, own: bool) -> None:
    """Set limits of axes, with one scale, so that points (n, 2 or 3) are inside."""
    names = "xyz"[: points.shape[1]]
    limits = np.array([getattr(ax, f"get_{name}lim")() for name in names])
    margin = 0.05 * np.ptp(limits, axis=1).max()
    limits[:, 0] = np.minimum(limits[:, 0], points.min(axis=0, initial=np.inf) - margin)
    limits[:, 1] = np.maximum(limits[:, 1], points.max(axis=0, initial=-np.inf) + margin)
    ax.set(**{f"{name}lim": pair for name, pair in zip(names, limits, strict=True)})
    if len(names) == 3:
        (space.fit_figure if own else space.set_aspect)(ax)


def plot_placement(found: BasePlacement, ax: Axes | None = None) -> Axes:
    """Draw the reached fraction over the first two axes, the others at the best place.

    Of a map over one axis it is a curve.
    """
    names = list(found.axes)
    index = np.unravel_index(int(found.order[0]), found.fraction.shape)
    units = [f"{n} [{'rad' if n == 'yaw' else found.system.unit}]" for n in names]
    x = found.axes[names[0]]
    if len(names) == 1:
        ax = page.make_figure().add_subplot() if ax is None else page.check_axes(ax)[0]
        ax.plot(x, found.fraction, ".-", color=style.MOTION)
        ax.set(xlabel=units[0], ylabel="fraction reached", ylim=(-0.05, 1.05))
        best = (x[index[0]], found.fraction[index])
    else:
        y = found.axes[names[1]]
        ax = _draw_picture(
            ax, x, y, found.fraction[(slice(None), slice(None), *index[2:])], (units[0], units[1])
        )
        best = (x[index[0]], y[index[1]])
    if found.fraction[index] > 0.0:
        ax.plot(*best, "o", color="white", markeredgecolor="black", label="best place")
        ax.legend(loc="upper right")
    if names[:2] == ["x", "y"]:
        ax.set_aspect("equal")
    return ax


def plot_capability(
    found: CapabilityMap, ax: Axes | None = None, height: float | None = None
) -> Axes:
    """Draw the fraction of directions over x and y, in the layer nearest to a height [m].

    By default the layer is the middle one.
    """
    values = found.fraction
    unit = found.system.unit
    title = found.frame
    if len(found.axes) == 3:
        z = found.axes[2]
        k = len(z) // 2 if height is None else int(np.argmin(np.abs(z - height)))
        values = values[..., k]
        title = f"{title}, z = {z[k]:.3g} {found.system.unit}"
    ax = _draw_picture(ax, found.axes[0], found.axes[1], values, (f"x [{unit}]", f"y [{unit}]"))
    ax.set_aspect("equal")
    ax.set_title(title)
    return ax
