"""The page around a planar drawing: its limits, curves, labels, axes in metres or a scale bar."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from kempe.errors import InputError
from kempe.spatial import Array
from kempe.units import METRE
from kempe.views.drawing import labels, style
from kempe.views.drawing.planar import Sheet
from kempe.views.drawing.style import FAINT, FONT, INK, PAPER

WIDTH = (3.2, 7.0)
HEIGHT = (2.4, 6.6)
"""Least and largest size of a drawing in inches."""


def make_figure(width: float = 6.4, height: float = 4.8) -> Figure:
    """Make an empty figure, sizes in inches; a figure of pyplot where pyplot is in use.

    Then `show` shows it, and a notebook that a cell drew it; else no window and no global state
    knows of it.
    """
    if "matplotlib.pyplot" not in sys.modules and not _is_in_notebook():
        return make_bare_figure(width, height)
    from matplotlib import pyplot

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that many figures are open
        return pyplot.figure(figsize=(width, height), facecolor="white")


def _is_in_notebook() -> bool:
    """Whether the program runs in the kernel of a notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and hasattr(shell.get_ipython(), "kernel")


def check_axes(ax: Any, count: int = 1) -> tuple[Axes, ...]:
    """Check that `ax` has `count` matplotlib axes, and return them. Errors: `InputError`."""
    given = tuple(np.ravel(np.array(ax, dtype=object)))
    if len(given) != count or not all(isinstance(one, Axes) for one in given):
        need = "matplotlib axes" if count == 1 else f"{count} matplotlib axes"
        got = (
            f"{len(given)} of them"
            if all(isinstance(one, Axes) for one in given)
            else type(ax).__name__
        )
        raise InputError(f"ax must be {need}, not {got}")
    return given


def make_bare_figure(width: float = 6.4, height: float = 4.8) -> Figure:
    """Make an empty figure, independent of windows and of pyplot; sizes in inches."""
    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def draw_curve(sheet: Sheet, name: str, points: Array, here: Array | None, number: int) -> None:
    """Draw the coupler curve (n, 2) of a frame, with a marker at the current position."""
    colour = style.choose_curve_colour(number)
    sheet.add_line(
        points,
        f"curve:{name}",
        style.CURVE,
        color=colour,
        lw=1.9,
        solid_joinstyle="round",
        solid_capstyle="round",
        label=name,
    )
    sheet.obstacles.add_line(points, 0.5 * sheet.r, 0.8)
    if here is not None:
        sheet.ax.plot(
            [here[0]],
            [here[1]],
            gid=f"here:{name}",
            zorder=style.POINTS + 0.5,
            marker="o",
            ms=6.5,
            color=colour,
            mec=PAPER,
            mew=1.2,
        )


def compute_limits(sheet: Sheet) -> tuple[Array, Array]:
    """Compute the lower left and upper right corner (2,) of the drawing, with room for labels."""
    p = np.concatenate([x for x in sheet.extent if len(x)]) if sheet.extent else np.zeros((1, 2))
    room = 4.0 * sheet.r
    return p.min(axis=0) - room, p.max(axis=0) + room


def make_axes(
    span: Array, with_axes: bool, above: float = 0.0, make: Callable[..., Figure] = make_figure
) -> Axes:
    """Make axes in a new figure with the proportions of a drawing of size `span` (2,) [m].

    Some inches are left `above` it.
    """
    width = WIDTH[1] - 0.7 * with_axes
    height = width * span[1] / span[0]
    if height > HEIGHT[1]:
        width = width * HEIGHT[1] / height
        height = HEIGHT[1]
    width = max(width, WIDTH[0])
    height = max(height, HEIGHT[0])
    left, bottom = (0.62, 0.5) if with_axes else (0.05, 0.32)
    right = 0.12
    top = 0.12 + above
    w = width + left + right
    h = height + bottom + top
    rect: Any = (left / w, bottom / h, width / w, height / h)
    return make(w, h).add_axes(rect)


def finish_page(sheet: Sheet, lower: Array, upper: Array, with_axes: bool) -> None:
    """Set limits and equal aspect, place the labels, and add axes with units or a scale bar."""
    ax = sheet.ax
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(lower[0], upper[0])
    ax.set_ylim(lower[1], upper[1])
    ax.apply_aspect()
    metres_a_point = _compute_point_size(ax)
    middle = 0.5 * (lower + upper)
    sheet.obstacles.bounds = lower, upper
    for text, p, clearance, look in sheet.labels:
        size = look.get("size", FONT)
        text = labels.shorten_label(text)
        width, height = labels.measure_text(text, size, "weight" in look)
        outward = (p - middle) / max(float(np.linalg.norm(upper - lower)), 1e-300)
        box = (width * metres_a_point, height * metres_a_point)
        place = sheet.obstacles.find_free_place(p, box, clearance + 2.0 * metres_a_point, outward)
        how: dict[str, Any] = {"size": FONT, **look}
        ax.text(place[0], place[1], text, ha="center", va="center", zorder=style.TEXT, **how)
    unit = sheet.scene.system.unit
    along = f"x [{unit}]"
    if with_axes and ax.get_xlabel() != along:  # else they are drawn: a frame of a motion
        draw_light_axes(ax)
        ax.set_xlabel(along, size=FONT, color=INK)
        ax.set_ylabel(f"y [{unit}]", size=FONT, color=INK)
    elif not with_axes:
        ax.set_axis_off()
        _draw_scale_bar(sheet)


def _compute_point_size(ax: Axes) -> float:
    """Compute how many metres are one point (1/72 inch) of the paper."""
    (x0, _), (x1, _) = ax.transData.transform([(0.0, 0.0), (1.0, 0.0)])
    return ax.figure.dpi / 72.0 / max(x1 - x0, 1e-300)


def draw_light_axes(ax: Axes) -> None:
    """Draw the left and the bottom axis in grey, without a box."""
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)
    ax.tick_params(color=FAINT, labelcolor=style.GROUND, labelsize=FONT - 1, length=3)


def draw_key(ax: Axes, titles: tuple[str, ...], own: bool) -> None:
    """Draw a key of configurations: number, line style and title; beside the picture if `own`."""
    lines = [
        Line2D(
            [],
            [],
            color=style.choose_configuration_colour(k),
            lw=2.2 if k else 4.0,
            ls=style.DASHES[k % len(style.DASHES)],
            label=f"{k + 1}  {title}",
        )
        for k, title in enumerate(titles)
    ]
    draw_legend(ax, own, lines, handlelength=4.5)


def draw_legend(ax: Any, own: bool, handles: list[Any] | None = None, **how: Any) -> None:
    """Draw a legend of given handles, or of all labelled artists; beside the picture if `own`."""
    entries: list[Any] = ax.get_legend_handles_labels()[0] if handles is None else handles
    how |= {"handles": entries, "fontsize": FONT - 1, "frameon": False}
    if not own:
        ax.legend(**how, loc="best")
        return
    figure: Any = ax.figure
    (wide, high) = figure.get_size_inches()
    box = ax.get_position(original=True)
    more = max(labels.measure_text(str(x.get_label()), FONT - 1)[0] for x in entries) / 72.0 + 0.9
    figure.set_size_inches(wide + more, high)
    part = wide / (wide + more)
    ax.set_position((part * box.x0, box.y0, part * box.width, box.height))
    ax.legend(
        **how, loc="center right", bbox_to_anchor=(1.0, 0.5), bbox_transform=figure.transFigure
    )


def round_length(length: float) -> float:
    """Round a length down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(k * power for k in (5.0, 2.0, 1.0) if k * power <= length * (1 + 1e-12) or k == 1.0)


def format_length(length: float, unit: str = METRE) -> str:
    """Format a length with its unit; metres with the unit that makes them short, such as '2 mm'."""
    if unit != METRE:
        return f"{length:g} {unit}"
    if abs(length) >= 0.1 or length == 0.0:
        return f"{length:g} m"
    return f"{1e3 * length:g} mm" if abs(length) >= 1e-4 else f"{1e6 * length:g} µm"


def _draw_scale_bar(sheet: Sheet) -> None:
    """Draw a scale bar of a round length at the lower left of the drawing."""
    ax: Any = sheet.ax
    x0, x1 = ax.get_xlim()
    length = round_length(0.22 * (x1 - x0))
    start = x0 + 0.02 * (x1 - x0)
    transform = ax.get_xaxis_transform()
    tick = 0.05 / max(ax.get_position().height * ax.figure.get_figheight(), 1e-9)
    y = -1.6 * tick
    look = {"color": INK, "lw": 1.2, "transform": transform, "clip_on": False, "gid": "scale"}
    ax.plot(
        [start, start, start, start + length, start + length, start + length],
        [y - tick, y + tick, y, y, y + tick, y - tick],
        **look,
    )
    ax.text(
        start + length,
        y,
        f"  {format_length(length, sheet.scene.system.unit)}",
        transform=transform,
        ha="left",
        va="center",
        size=FONT - 1,
        color=INK,
        clip_on=False,
        gid="scale:text",
    )
