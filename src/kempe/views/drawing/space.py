"""Systems in space, on matplotlib's axes in three dimensions: links as tubes and plates, joints as
oriented symbols.

All solids are one collection of faces, so that matplotlib sorts them by depth together.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError
from kempe.spatial import Array
from kempe.views.drawing import callouts, page, style, symbols
from kempe.views.drawing.labels import Obstacles, measure_text, shorten_label
from kempe.views.drawing.plot_request import Subject, choose_subscript
from kempe.views.drawing.scene import Scene
from kempe.views.drawing.solids import Solids
from kempe.views.drawing.style import FAINT, FONT, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VIEWS = [(float(elev), float(azim)) for elev in (22, 32) for azim in range(-75, -14, 12)]
"""Elevations and azimuths [degrees] among which the one is taken that keeps the points furthest
apart."""


def find_bounds(subjects: list[Subject]) -> tuple[Array, tuple[float, float]]:
    """Compute the points (n, 3) that bound several drawings together, and the view of the first."""
    points = [
        p for s in subjects for scene in (s.scene, *s.others) for p in _list_solid_points(scene)
    ]
    points += [c[np.isfinite(c).all(axis=1)] for s in subjects[:1] for c in s.curves.values()]
    points += [s.missed for s in subjects if s.missed is not None]
    return np.concatenate([p for p in points if len(p)]), _choose_view(subjects[0].scene)


def _list_solid_points(scene: Scene) -> list[Array]:
    """List the corners of all solids of a scene."""
    solids = Solids()
    symbols.add_scene(solids, scene, symbols.choose_radius(scene), None)
    return solids.faces


usual_radius = symbols.choose_radius


def make_empty_axes(
    subject: Subject, bounds: tuple[Array, tuple[float, float]], make: Callable[..., Any]
) -> Axes:
    """Make empty axes in space, in a figure with the proportions of these bounds."""
    ax = make().add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    _set_limits(ax, subject.system.unit, bounds[0], *bounds[1])
    fit_figure(ax)
    return ax


def draw_picture(
    subject: Subject,
    ax: Any,
    bounds: tuple[Array, tuple[float, float]] | None = None,
    make: Callable[..., Any] = page.make_figure,
) -> Axes:
    """Draw a subject in space on axes and return these: solids, curves, other positions.

    `bounds` are the points (n, 3) and the view of several pictures with one scale.

    Frames are marked: by a dot on their curve, or by their axes. Without `ax` the figure is made by
    `make`. `bounds` are points (n, 3) and the view for which the axes are made already, by `make_empty_axes`.
    """
    own = ax is None
    if own:
        ax = make().add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    elif not hasattr(page.check_axes(ax)[0], "get_zlim"):
        raise InputError("ax is flat; a system in space needs axes with projection='3d'")
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    ax.computed_zorder = False
    scene = subject.scene
    solids = Solids()
    radius = subject.radius or symbols.choose_radius(scene)
    skeleton = symbols.add_scene(solids, scene, radius, subject.way)
    if subject.options.motion:
        for joint in scene.joints:
            skeleton += callouts.draw_freedoms_in_space(solids, joint, radius)
    faces = Poly3DCollection(
        solids.faces,
        facecolors=solids.colours,
        edgecolors=solids.edges,
        linewidths=0.35,
        zorder=style.BARS,
        gid="solids",
    )
    ax.add_collection3d(faces, autolim=False)
    all_points = [*solids.faces, *_draw_other_positions(ax, subject)]
    for k, (name, points) in enumerate(subject.curves.items()):
        colour = style.choose_curve_colour(k)
        ax.plot(
            *points.T, color=colour, lw=1.9, zorder=style.ARROWS, gid=f"curve:{name}", label=name
        )
        p = subject.here[name][:3, 3]
        ax.plot(
            [p[0]],
            [p[1]],
            [p[2]],
            "o",
            color=colour,
            ms=6,
            mec="white",
            mew=1.0,
            zorder=style.ARROWS,
            gid=f"here:{name}",
        )
    ends = [_draw_frame(ax, name, X, style.MARK * radius) for name, X in subject.marks.items()]
    all_points += [*ends, *(c[np.isfinite(c).all(axis=1)] for c in subject.curves.values())]
    all_points += [scene.list_points(link) for link in scene.links]
    angles = callouts.draw_angles_in_space(ax, subject, radius) if subject.options.angles else []
    all_points += [p[None] for p, _, _ in angles]
    if subject.missed is not None:
        ax.plot(
            *subject.missed.T,
            "o--",
            color=style.OPEN,
            lw=1.8,
            ms=5,
            mfc="none",
            zorder=style.ARROWS,
            gid="missed",
        )
        look = {"color": style.OPEN, "weight": "bold", "gid": "label:missed"}
        angles.append((subject.missed.mean(axis=0), subject.missed_text, look))
        all_points.append(subject.missed)
    if not any(len(p) for p in all_points):  # nothing moves and nothing is named
        all_points.append(np.zeros((1, 3)))
    elev, azim = _choose_view(scene) if bounds is None else bounds[1]
    if bounds is None:
        _set_limits(ax, scene.system.unit, np.concatenate(all_points), elev, azim)
    if own:
        fit_figure(ax)
    skeleton += [np.stack([e[0], tip]) for e in ends for tip in e[1:]]
    texts = [*angles, *callouts.list_texts(subject, style.MARK * radius)]
    _draw_labels(ax, subject, texts, skeleton, radius, compute_camera(elev, azim), own)
    if subject.format_parameters():
        ax.set_title(subject.format_parameters(), loc="left", size=FONT - 1, color=INK, pad=3.0)
    if subject.keyed:
        page.draw_key(ax, subject.titles, own)
    return ax


def _draw_other_positions(ax: Any, subject: Subject) -> list[Array]:
    """Draw earlier positions faintly, and other configurations in colours; return their points."""
    drawn: list[Array] = []
    thick = 3.0 if subject.options.motion else 1.6
    for k, old in enumerate(subject.ghosts):
        for link, line in symbols.iterate_link_lines(old):
            drawn.append(line)
            ax.plot(
                *line.T,
                color=style.choose_link_colour(link.number),
                alpha=0.3,
                lw=thick,
                zorder=style.GHOSTS,
                gid=f"ghost{k}:{link.name}",
            )
    for k, other in enumerate(subject.others, 1):
        for link, line in symbols.iterate_link_lines(other):
            drawn.append(line)
            ax.plot(
                *line.T,
                color=style.choose_configuration_colour(k),
                lw=2.2,
                ls=style.DASHES[k % len(style.DASHES)],
                zorder=style.BLOCKS,
                gid=f"configuration{k}:{link.name}",
            )
    return drawn


def _draw_frame(ax: Any, name: str, X: Array, length: float) -> Array:
    """Draw the axes of a frame (4, 4) over everything else; return origin and ends (4, 3)."""
    ends = np.concatenate([X[:3, 3][None], X[:3, 3] + length * X[:3, :3].T])
    for k, axis in enumerate("xyz"):
        ax.plot(
            *ends[[0, k + 1]].T,
            color=style.AXES[k],
            lw=2.4,
            zorder=style.ARROWS,
            solid_capstyle="round",
            gid=f"mark:{name}:{axis}",
        )
    ax.plot(
        *ends[:1].T,
        "o",
        color=style.PAPER,
        ms=4.5,
        mec=INK,
        mew=1.2,
        zorder=style.ARROWS,
        gid=f"mark:{name}",
    )
    return ends


def compute_camera(elev: float, azim: float) -> Array:
    """Compute the rows right, up and towards the eye (3, 3) of a view; angles in degrees."""
    e = np.deg2rad(elev)
    a = np.deg2rad(azim)
    return np.array(
        [
            [-np.sin(a), np.cos(a), 0.0],
            [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)],
            [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)],
        ]
    )


def _choose_view(scene: Scene) -> tuple[float, float]:
    """Choose the view [deg] in which joint centres and frames lie farthest apart."""
    p = np.concatenate([scene.list_points(link) for link in scene.links])
    i, j = np.triu_indices(len(p), 1)
    apart = np.linalg.norm(p[i] - p[j], axis=1) > 1e-6 * scene.size
    d = (p[i] - p[j])[apart]
    if not len(d):
        return VIEWS[2]
    costs: list[float] = []
    for elev, azim in VIEWS:
        seen = np.linalg.norm(d @ compute_camera(elev, azim)[:2].T, axis=1)
        costs.append(float(np.sum(1.0 / (seen + 0.02 * scene.size))))
    best = min(costs)
    return next(v for v, c in zip(VIEWS, costs, strict=True) if c <= 1.0000001 * best)


def _set_limits(ax: Any, unit: str, points: Array, elev: float, azim: float) -> None:
    """Set limits with equal scales, light axes with their unit, and the view of axes in space."""
    lower = points.min(axis=0)
    upper = points.max(axis=0)
    room = 0.03 * float((upper - lower).max()) or 0.5  # a lone point has no extent
    lower = lower - room
    upper = upper + room
    thin = 0.3 * float((upper - lower).max())
    grow = np.maximum(thin - (upper - lower), 0.0) / 2
    lower = lower - grow
    upper = upper + grow
    for axis, name, a, b in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", lower, upper, strict=True):
        getattr(ax, f"set_{name}lim")(a, b)
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.line.set_color(FAINT)
        axis._axinfo["grid"].update(color="#e3e7ea", linewidth=0.6)
        axis._axinfo["tick"].update(inward_factor=0.0, outward_factor=0.15)
        axis.set_tick_params(labelsize=FONT - 2, labelcolor=style.GROUND, color=FAINT, pad=-2)
        small = (b - a) < 0.45 * float((upper - lower).max())
        axis.set_major_locator(_make_locator(2 if small else 5))
        axis.set_label_text(f"{name} [{unit}]", size=FONT - 1, color=style.GROUND)
        axis.labelpad = -4 if small else 0
    ax.set_proj_type("ortho")
    ax.set_box_aspect(upper - lower, zoom=1.0)
    ax.view_init(elev=elev, azim=azim)


def fit_figure(ax: Any) -> None:
    """Fit the box of the axes to its figure, and shrink the figure to its content."""
    figure = ax.figure
    side = 7.0
    room = (0.75, 0.55)
    figure.set_size_inches(side, side)
    seen = _project_to_axes(ax, _list_corners(ax))
    span = np.ptp(seen, axis=0)
    zoom = float(min((side - 2 * r) / side / x for r, x in zip(room, span, strict=True)))
    set_aspect(ax, zoom)
    seen = _project_to_axes(ax, _list_corners(ax))
    lower = seen.min(axis=0) * side - room
    upper = seen.max(axis=0) * side + room
    size = np.maximum(upper - lower, (3.2, 2.4))
    corner = 0.5 * (size - lower - upper)
    figure.set_size_inches(*size)
    ax.set_position((corner[0] / size[0], corner[1] / size[1], side / size[0], side / size[1]))


def set_aspect(ax: Any, zoom: float = 1.0) -> None:
    """Set one scale for all axes in space."""
    ax.set_box_aspect(
        [np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim()), np.ptp(ax.get_zlim())], zoom=zoom
    )


def _list_corners(ax: Any) -> Array:
    """List the eight corners (8, 3) of the limits of axes in space."""
    limits: list[Array] = [np.asarray(x) for x in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())]
    return np.stack(np.meshgrid(*limits), axis=-1).reshape(-1, 3)


def _project_to_axes(ax: Any, points: Array) -> Array:
    """Project points (n, 3) to coordinates (n, 2) of the axes' rectangle."""
    from mpl_toolkits.mplot3d import proj3d

    ax.apply_aspect()
    x, y, _ = proj3d.proj_transform(points[:, 0], points[:, 1], points[:, 2], ax.get_proj())
    return ax.transAxes.inverted().transform(ax.transData.transform(np.stack([x, y], axis=-1)))


def _make_locator(count: int) -> Any:
    """Make a locator of at most `count` ticks at round numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count, steps=[1, 2, 5, 10])


def _draw_labels(
    ax: Any,
    subject: Subject,
    texts: list[tuple[Array, str, dict[str, Any]]],
    skeleton: list[Array],
    radius: float,
    eye: Array,
    own: bool,
) -> None:
    """Draw names of joints and frames and other texts, placed so that they cover little."""
    from matplotlib.patheffects import withStroke

    scene = subject.scene
    words = subject.options.words
    obstacles = Obstacles()
    for line in skeleton:
        obstacles.add_line(line @ eye[:2].T, 1.2 * radius, 0.8)
    for joint in scene.joints:
        c = eye[:2] @ joint.centre
        obstacles.add_segment(c, c, 2.0 * radius, 1.0)
        if scene.is_telescopic(joint, radius):
            low, high = (joint.F[:3, 3] + t * (joint.centre - joint.F[:3, 3]) for t in (0.16, 0.56))
            obstacles.add_segment(eye[:2] @ low, eye[:2] @ high, 2.0 * radius, 1.0)
        if 0 in (joint.parent, joint.child):
            obstacles.add_segment(c, c - eye[:2, 2] * 3.0 * radius, 2.2 * radius, 0.9)
    metres_a_point = _compute_point_size(ax, eye)
    half = 0.5 * metres_a_point * 72.0 * (ax.figure.get_size_inches() - 0.1)
    centre = eye[:2] @ _list_corners(ax).mean(axis=0)
    obstacles.bounds = (centre - half, centre + half) if own else None
    groups: list[tuple[Array, list[str], dict[str, Any]]] = []
    for joint in scene.joints:
        seat = scene.find_seat(joint, radius)
        text = subject.format_joint(joint)
        if not text:
            continue
        near = next(
            (g for g in groups if np.linalg.norm(eye[:2] @ (g[0] - seat)) < 1.2 * radius), None
        )
        if near is None:
            groups.append((seat, [text], {"color": INK, "size": FONT}))
        else:
            near[1].append(text)
    if "frames" in words:
        grey = {
            "color": style.mix_colours(INK, style.PAPER, 0.3),
            "style": "italic",
            "size": FONT - 1,
        }
        named = {name: X for link in scene.links for name, X in link.frames.items()} | subject.marks
        named = {
            n: X
            for n, X in named.items()
            if n not in subject.axes or not choose_subscript(subject.system, n)
        }
        groups += [(X[:3, 3], [name], grey) for name, X in named.items()]
    groups += [(p, [text], {"size": FONT, **look}) for p, text, look in texts]
    middle = np.mean([g[0] for g in groups], axis=0) if groups else np.zeros(3)
    halo = [withStroke(linewidth=2.2, foreground=style.PAPER)]
    for p, names, look in groups:
        text = ", ".join(names)
        said = shorten_label(text)
        width, height = (
            metres_a_point * x for x in measure_text(said, look["size"], "weight" in look)
        )
        c = eye[:2] @ p
        outward = eye[:2] @ (p - middle) / scene.size
        place = obstacles.find_free_place(c, (width, height), 2.1 * radius, outward)
        where = p + eye[:2].T @ (place - c)
        ax.text(
            *where,
            said,
            ha="center",
            va="center",
            zorder=style.TEXT,
            path_effects=halo,
            **{"gid": f"label:{text}", **look},
        )


def _compute_point_size(ax: Any, eye: Array) -> float:
    """Metres in one point (1/72 inch) of the paper, in the plane of the picture."""
    centre = np.array(
        [
            float(np.asarray(x, dtype=float).mean())
            for x in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())
        ]
    )
    step = float(np.ptp(ax.get_xlim()))
    a, b = ax.transAxes.transform(_project_to_axes(ax, np.array([centre, centre + step * eye[0]])))
    return step / max(float(np.linalg.norm(b - a)) * 72.0 / ax.figure.dpi, 1e-300)
