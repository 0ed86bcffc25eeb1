"""Overviews: the tree of a system as text, picture and notebook page; and all joint types."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import library
from kempe.arguments import explain_errors
from kempe.description.read import read_mechanism
from kempe.equations.velocity import record_velocity_rows
from kempe.errors import InputError, KempeError
from kempe.joints import TYPES
from kempe.model.configurations import has_loops
from kempe.words import cut_lines, format_count, format_html_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.mobility.answer import Mobility
    from kempe.model.model import Model

MOST_LINES = 40
MOST_DRAWN = 60
"""Lines of a tree that a notebook shows, and bodies up to which it shows a picture."""
INCHES = 0.8
BELOW = 0.58
"""Inches of one unit of a drawn tree, and the part of a line at which its joint is named: there
siblings are apart."""


# ---- the tree


def list_children(system: Model) -> list[list[int]]:
    """List the children of each body, from the ground on."""
    out: list[list[int]] = [[] for _ in system.body_names]
    for body, parent in enumerate(system.parent, 1):
        out[parent].append(body)
    return out


def list_tree_lines(system: Model) -> list[str]:
    """List the lines of the spanning tree as text: each body with its joint, then the cut joints."""
    below = list_children(system)
    names = system.body_names
    joints = system.structure.joints
    out = [f"0 {names[0]}"]
    waiting = [(b, "", b == below[0][-1]) for b in reversed(below[0])]
    while waiting:
        body, indent, last = waiting.pop()
        joint = joints[system.structure.parent_joints[body - 1]]
        out.append(
            f"{indent}{'└─' if last else '├─'} {joint.name} ({joint.type.type_name}) ─ {body} "
            f"{names[body]}"
        )
        indent += "   " if last else "│  "
        waiting += [(b, indent, b == below[body][-1]) for b in reversed(below[body])]
    for name in system.structure.closures:
        joint = joints[name]
        out.append(
            f"╌╌ {name} ({joint.type.type_name}) closes a loop: {joint.parent} ╌ {joint.child}"
        )
    return [*out, format_connectivity(system)]


def format_connectivity(system: Model) -> str:
    """Format the connectivity vector: the parent of each body."""
    return f"C = {{{', '.join(map(str, system.parent))}}}"


def _place_bodies(system: Model) -> np.ndarray:
    """Compute the positions (n + 1, 2) of bodies in the tree: each parent above its children."""
    below = list_children(system)
    at = np.zeros((len(below), 2))
    for body, parent in enumerate(system.parent, 1):  # parents come first
        at[body, 1] = at[parent, 1] - 1.0
    waiting = [0]
    order: list[int] = []
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(below[order[-1]])
    for k, leaf in enumerate(b for b in order if not below[b]):
        at[leaf, 0] = k
    for body in reversed(order):
        if below[body]:
            at[body, 0] = 0.5 * (at[below[body][0], 0] + at[below[body][-1], 0])
    return at


@explain_errors
def plot_tree(system: Model, ax: Axes | None = None) -> Axes:
    """Draw the spanning tree of a system; see `System.plot_tree`."""
    from kempe.views.drawing import page, style
    from kempe.views.drawing.labels import shorten_label

    names = system.body_names
    joints = system.structure.joints
    at = _place_bodies(system) * (_choose_leaf_distance(system), 1.4)
    span = np.ptp(at, axis=0)
    if ax is None:
        wide = INCHES * (
            max(1.0, _measure_label_room(system))
            + max(1.0, 0.5 * _measure_widest_joint(system) + 0.1)
        )
        ax = page.make_figure(
            *np.clip(INCHES * span + (wide, 1.4), (3.2, 2.4), (16.0, 14.0))
        ).add_axes((0, 0, 1, 1))
    ax = page.check_axes(ax)[0]
    for body, parent in enumerate(system.parent, 1):
        joint = joints[system.structure.parent_joints[body - 1]]
        ax.plot(
            *at[[parent, body]].T,
            color=style.INK,
            lw=1.3,
            zorder=style.BARS,
            gid=f"edge:{joint.name}",
        )
        _draw_edge_label(ax, joint, at[parent], at[body], style.INK, BELOW)
    number = {name: k for k, name in enumerate(names)}
    lowest = float(at[:, 1].min())
    for name in system.structure.closures:
        joint = joints[name]
        a = at[number[joint.parent]]
        b = at[number[joint.child]]
        side = 0.22 * np.array([b[1] - a[1], a[0] - b[0]]) + (0.0, -0.15)
        t = np.linspace(0.0, 1.0, 40)[:, None]
        line = (1 - t) ** 2 * a + 2 * t * (1 - t) * (0.5 * (a + b) + 2.0 * side) + t**2 * b
        lowest = min(lowest, float(line[:, 1].min()))
        ax.plot(
            *line.T, color=style.OPEN, lw=1.3, ls=(0, (4, 3)), zorder=style.RAILS, gid=f"cut:{name}"
        )
        _draw_edge_label(ax, joint, line[20], line[20], style.OPEN)
    for k, (p, name) in enumerate(zip(at, names, strict=True)):
        short = name if len(name) <= 3 and name.endswith(str(k)) else str(k)
        colour = style.mix_colours(style.choose_link_colour(k), style.PAPER, 0.55)
        ax.plot(
            *p,
            "o",
            ms=25,
            mfc=colour,
            mec=style.INK,
            mew=1.2,
            zorder=style.PINS,
            gid=f"body:{name}",
        )
        ax.text(
            p[0],
            p[1],
            short,
            ha="center",
            va="center",
            size=style.FONT,
            zorder=style.TEXT,
            gid=f"label:{name}",
        )
        if short != name:
            ax.text(
                p[0] + 0.34,
                p[1],
                shorten_label(name),
                va="center",
                size=style.FONT - 1.5,
                zorder=style.TEXT,
                color=style.GROUND,
                bbox={"fc": style.PAPER, "ec": "none", "pad": 0.5},
            )
    ax.set_xlim(
        at[:, 0].min() - max(1.0, 0.5 * _measure_widest_joint(system) + 0.1),
        at[:, 0].max() + max(1.0, _measure_label_room(system)),
    )
    ax.set_ylim(lowest - 1.2, at[:, 1].max() + 0.6)
    ax.text(
        at[:, 0].min() - 0.7,
        lowest - 0.9,
        format_connectivity(system),
        size=style.FONT,
        gid="connectivity",
    )
    ax.set_axis_off()
    return ax


def _label_edge(joint: Any) -> str:
    """Format the name and the letter of a joint."""
    from kempe.views.drawing.labels import shorten_label

    return f"{shorten_label(joint.name)}  {joint.type.letter}".rstrip()


def _measure_label_room(system: Model) -> float:
    """Measure the room that the widest body name needs beside its circle, in units of the tree."""
    from kempe.views.drawing import style
    from kempe.views.drawing.labels import measure_text, shorten_label

    widest = max(
        measure_text(shorten_label(name), style.FONT - 1.5)[0] for name in system.body_names
    )
    return 0.34 + widest / 72.0 / INCHES + 0.1


def _choose_leaf_distance(system: Model) -> float:
    """Choose the distance of leaves, so that names do not overlap where there is room."""
    if len(system.parent) < 2 or max(map(len, list_children(system))) < 2:
        return 1.4
    return float(
        np.clip(
            max(_measure_label_room(system) + 0.36, (_measure_widest_joint(system) + 0.15) / BELOW),
            1.4,
            4.0,
        )
    )


def _measure_widest_joint(system: Model) -> float:
    """Measure the width of the widest joint name, in units of the tree."""
    from kempe.views.drawing import style
    from kempe.views.drawing.labels import measure_text

    said = [_label_edge(system.structure.joints[name]) for name in system.structure.parent_joints]
    return (
        max((measure_text(text, style.FONT - 1)[0] for text in said), default=0.0) / 72.0 / INCHES
    )


def _draw_edge_label(
    ax: Axes, joint: Any, a: np.ndarray, b: np.ndarray, colour: str, part: float = 0.5
) -> None:
    """Draw the name and the letter of a joint on its line, at some part of the way."""
    from kempe.views.drawing import style

    x, y = a + part * (b - a)
    ax.text(
        x,
        y,
        _label_edge(joint),
        ha="center",
        va="center",
        size=style.FONT - 1,
        color=colour,
        zorder=style.TEXT,
        bbox={"fc": style.PAPER, "ec": "none", "pad": 1.0},
        gid=f"label:{joint.name}",
    )


# ---- joint types


def list_joint_types() -> list[dict[str, Any]]:
    """List all joint types with name, letter, freedoms, constraints and decomposition."""
    out: list[dict[str, str | int | None]] = []
    for name, kind in TYPES.items():
        joint = kind()
        plane = (joint.dof(2), joint.constraints(2)) if joint.planar else (None, None)
        # a screw without a pitch of its own
        made = joint.decomposition.replace(", 0 q", ", pitch q")
        out.append(
            {
                "type": name,
                "letter": joint.letter,
                "dof": joint.dof(),
                "constraints": joint.constraints(),
                "dof_in_the_plane": plane[0],
                "constraints_in_the_plane": plane[1],
                "made_of": made,
                "says": joint.summary,
            }
        )
    return out


@explain_errors
def plot_joints(names: Sequence[str] = ()) -> tuple[Axes, ...]:
    """Draw joint types: both bodies, an arrow for each freedom, and neighbouring positions."""
    from kempe.views.drawing import page, style
    from kempe.views.plots import plot

    shown = [n for n in TYPES if TYPES[n]().dof()] if not len(names) else list(names)
    if unknown := [n for n in shown if f"joint_{n}" not in library.list_models()]:
        raise InputError(f"names has {unknown[0]!r}; there are: {', '.join(TYPES)}")
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = page.make_figure(3.4 * columns, 3.2 * rows)
    axes: list[Axes] = []
    for k, name in enumerate(shown):
        ax: Any = figure.add_subplot(rows, columns, k + 1, projection="3d")
        system = read_mechanism(f"joint_{name}").build()
        plot(system, motion=True, labels=False, ax=ax)
        ax.set_box_aspect(
            [np.ptp(x) for x in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())], zoom=1.25
        )
        ax.set_axis_off()
        ax.set_title(
            f"{name}, {format_count(TYPES[name]().dof(), 'freedom')}",
            size=style.FONT + 1,
            color=style.INK,
            y=0.97,
        )
        axes.append(ax)
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.95, wspace=0.0, hspace=0.06)
    return tuple(axes)


# ---- notebooks


def make_notebook_page(system: Model) -> str:
    """Return a system as HTML for notebooks: a picture, its freedoms, and its spanning tree."""
    count = format_count(len(system.parent), "body")
    kind = "in the plane" if system.dim == 2 else "in space"
    head = f"{system.name}: {count}, {format_count(len(system.joint_names), 'joint')}, {kind}"
    parts = [f"<p>{html.escape(head)}</p>", _render_picture(system)]
    parts.append(f"<p>{html.escape(_describe_freedoms(system))}</p>")
    lines = cut_lines(list_tree_lines(system), MOST_LINES)
    return "".join([*parts, f"<pre>{html.escape(chr(10).join(lines))}</pre>"])


def _describe_freedoms(system: Model) -> str:
    """Describe the degrees of freedom: of a tree by its joints, with loops by count and rank."""
    if not has_loops(system):
        from kempe.spaces.configuration_space import make_configuration_space

        within = make_configuration_space(system).within
        said = f"{format_count(system.nv, 'degree')} of freedom, configuration space {within}"
        return said + _describe_velocity_freedoms(system)
    try:
        return _compute_mobility(system).sentence
    except KempeError as error:
        return str(error)


def _compute_mobility(system: Model) -> Mobility:
    """Compute the mobility of a system by count and rank."""
    # Here, as it loads the kernels, which drawing a tree does not need.
    from kempe.mobility.mobility import mobility

    return mobility(system, local=False)


def _describe_velocity_freedoms(system: Model) -> str:
    """Describe how many freedoms velocity constraints leave, such as wheels; '' without any."""
    if not record_velocity_rows(system).names:
        return ""
    try:
        return f"; {_compute_mobility(system).velocity_dof} of velocity"
    except KempeError:
        return ""


def _render_picture(system: Model) -> str:
    """Render the picture of a system as an `img` of HTML; '' if nothing can be drawn."""
    if len(system.parent) > MOST_DRAWN:
        return ""
    try:
        from kempe.views.plots import draw_bare_system

        figure: Any = draw_bare_system(system).figure
    except (KempeError, ValueError, ArithmeticError):
        return ""
    return format_html_image(figure, f"picture of {system.name}")
