"""The picture of a planar system: the diagram, curves, marks, other configurations, what is
measured, labels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError
from kempe.spatial import Array
from kempe.views.drawing import callouts, page, planar, shapes, style
from kempe.views.drawing import planar as touches
from kempe.views.drawing.planar import Sheet, project_to_plane
from kempe.views.drawing.plot_request import Subject, choose_subscript
from kempe.views.drawing.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_picture(
    subject: Subject,
    ax: Any,
    bounds: tuple[Array, Array] | None = None,
    make: Callable[..., Any] = page.make_figure,
) -> Axes:
    """Draw a planar subject on axes and return these; `bounds` are the corners (2,) of the picture.

    Without `ax`, `make` makes the figure.

    Without `ax` the figure is made by `make`.
    """
    if ax is not None and hasattr(page.check_axes(ax)[0], "get_zlim"):
        raise InputError("ax is in space; a planar system needs plain axes")
    radius = subject.radius or planar.choose_pin_radius(subject.scene)
    own = ax is None
    if own:  # the extent of the drawing decides the shape of the figure
        lower, upper = compute_extent(subject)
        lines = subject.format_parameters().count("\n") + 1 if subject.format_parameters() else 0
        ax = page.make_axes(upper - lower, bool(subject.curves), 0.16 * lines, make)
    sheet = Sheet(ax, subject.scene, radius, subject.way, steady=subject.radius is not None)
    draw_subject(sheet, subject)
    lower, upper = page.compute_limits(sheet) if bounds is None else bounds
    page.finish_page(sheet, lower, upper, bool(subject.curves))
    if subject.format_parameters():
        ax.set_title(
            subject.format_parameters(), loc="left", size=style.FONT - 1, color=style.INK, pad=3.0
        )
    if subject.keyed:
        page.draw_key(ax, subject.titles, own)
    return ax


def find_bounds(subjects: list[Subject]) -> tuple[Array, Array]:
    """Compute the lower left and upper right corner (2,) of several drawings together."""
    trial = page.make_bare_figure().add_subplot()
    corners = [compute_extent(s, trial) for s in subjects]
    return np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)


usual_radius = planar.choose_pin_radius


def make_empty_axes(
    subject: Subject, bounds: tuple[Array, Array], make: Callable[..., Any]
) -> Axes:
    """Make empty axes in a figure with the proportions of these bounds."""
    return page.make_axes(bounds[1] - bounds[0], bool(subject.curves), make=make)


def compute_extent(subject: Subject, trial: Axes | None = None) -> tuple[Array, Array]:
    """Compute the lower left and upper right corner (2,) of a drawing, which is tried on axes."""
    ax = page.make_bare_figure().add_subplot() if trial is None else trial
    steady = subject.radius is not None
    radius = subject.radius or planar.choose_pin_radius(subject.scene)
    sheet = Sheet(ax, subject.scene, radius, subject.way, steady=steady)
    draw_subject(sheet, subject)
    return page.compute_limits(sheet)


def draw_subject(sheet: Sheet, subject: Subject) -> None:
    """Draw a subject from back to front, and collect its labels."""
    options = subject.options
    if subject.workspace is not None:
        _draw_workspace(sheet, subject.workspace)
    for k, old in enumerate(subject.ghosts):
        planar.draw_ghost(sheet, old, k)
        sheet.extent += [project_to_plane(old.list_points(link)) for link in old.links]
    for k, other in enumerate(subject.others):
        _draw_other_configuration(sheet, other, k + 1)
    for k, (name, points) in enumerate(subject.curves.items()):
        page.draw_curve(sheet, name, points[:, :2], project_to_plane(subject.here[name]), k)
    texts = {j.name: subject.format_joint(j) for j in subject.scene.joints}
    planar.draw_scene(sheet, texts, "frames" in options.words)
    for name, X in subject.marks.items():
        below = choose_subscript(subject.system, name) if name in subject.axes else ""
        planar.draw_frame(sheet, name, X, "frames" in options.words and not below)
        if name in subject.axes:
            _label_axes(sheet, name, X, below)
    callouts.draw_callouts(sheet, subject)
    if subject.missed is not None:
        ends = project_to_plane(subject.missed)
        sheet.add_line(ends, "missed", style.ARROWS, color=style.OPEN, lw=1.5, ls=(0, (3, 2)))
        sheet.add_outline(
            shapes.make_circle(ends[1], 0.6 * sheet.r),
            "missed:target",
            style.ARROWS,
            fc="none",
            ec=style.OPEN,
            lw=1.5,
        )
        look = {"gid": "label:missed", "color": style.OPEN, "weight": "bold"}
        sheet.labels.append((subject.missed_text, ends.mean(axis=0), 0.9 * sheet.r, look))
    scenes = (subject.scene, *subject.others)
    points = [
        np.concatenate([project_to_plane(s.list_points(link)) for link in s.links[1:]])
        for s in scenes
        if subject.others
    ]
    for p, text, look in subject.place_names(points):
        sheet.labels.append((text, p, 1.6 * sheet.r, look))


def _label_axes(sheet: Sheet, name: str, X: Array, below: str) -> None:
    """Collect the labels of the axes of a frame."""
    for k, axis in enumerate("xy"):
        tip = project_to_plane(X) + (style.MARK + 1.6) * sheet.r * X[:2, k]
        look = {
            "gid": f"label:{name}:{axis}",
            "color": style.mix_colours(style.AXES[k], style.INK, 0.3),
        }
        sheet.labels.append((f"${axis}{below}$", tip, 0.3 * sheet.r, look))


def _draw_other_configuration(sheet: Sheet, scene: Scene, number: int) -> None:
    """Draw the links of another configuration in its own colour and line style."""
    colour = style.choose_configuration_colour(number)
    gid = f"configuration{number}"
    line = style.DASHES[number % len(style.DASHES)]
    for link in scene.links[1:]:
        p = project_to_plane(scene.list_points(link))
        if len(p) > 1:
            sheet.add_outline(
                shapes.make_rounded_outline(p, style.BAR * sheet.r),
                f"{gid}:{link.name}",
                style.POLYGONS,
                fc=(colour, 0.10),
                ec=colour,
                lw=1.3,
                ls=line,
            )
            for a, b in zip(p[:-1], p[1:], strict=True):
                sheet.obstacles.add_segment(a, b, sheet.r, 0.5)
    for mark in scene.marks:
        touches.draw_wheels(sheet, mark, f"{gid}:{mark.name}", colour)
    for joint in scene.joints:
        if joint.kind == "revolute":
            sheet.add_outline(
                shapes.make_circle(project_to_plane(joint.M), 0.7 * sheet.r),
                f"{gid}:{joint.name}",
                style.POLYGONS,
                fc=style.PAPER,
                ec=colour,
                lw=1.2,
            )


def _draw_workspace(sheet: Sheet, workspace: Any) -> None:
    """Draw the workspace of a frame, darker where there are more solutions, with its boundary."""
    for k, region in enumerate(workspace.regions):
        shade = style.mix_colours(
            style.FAINT, style.PAPER, 0.55 if region.solutions in (None, 1) else 0.25
        )
        sheet.add_outline(
            shapes.make_region_outline(region),
            f"workspace:{k}",
            style.GHOSTS - 0.5,
            fc=shade,
            ec="none",
        )
    for k, piece in enumerate(workspace.boundary):
        z = shapes.sample_piece(piece)
        p = np.column_stack([np.real(z), np.imag(z)])
        sheet.add_line(p, f"workspace:boundary{k}", style.GHOSTS, color=style.GROUND, lw=1.1)
