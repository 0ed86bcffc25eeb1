"""Pictures of systems and motions with matplotlib, without global state; `savefig` writes them.

A planar system is drawn as a textbook's kinematic diagram, a system in space as solids. Importing
this module needs the extra [view]. Errors: `MissingExtraError` without matplotlib.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import add_signature_options, explain_errors, read_names
from kempe.arrays import is_sequence, read_reals
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.forward.fk import fk
from kempe.model.configurations import (
    has_loops,
    integrate_velocity,
    list_units,
    read_q,
)
from kempe.spatial import Array
from kempe.views.drawing import page, style
from kempe.views.drawing.plot_request import (
    FARTHEST,
    Subject,
    choose_configuration,
    read_configurations,
    read_motion,
)
from kempe.views.drawing.scene import build_scene
from kempe.views.plot_options import PlotOptions
from kempe.words import format_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import Model

ACROSS = 4
"""Pictures beside one another."""
ALONG = {"arc length": "s", "time [s]": "t"}
"""What coordinates are drawn over, and the attribute of a path that has it."""
MARKERS = "os^Dv<>ph*"
"""Marks by which curves differ without colours."""
MOST_NAMED = 16
"""Starts that the key of a history names."""
FEW = 3
TURN = 0.35
SLIDE = 0.08
"""Coordinates up to which neighbours are drawn; how far away: in radians, and in parts of the size
of the drawing."""


@explain_errors
@add_signature_options(PlotOptions)
def plot(system: Model, q: Any = None, *, path: Any = None, **options: Any) -> Any:
    """Draw a system on Matplotlib axes; see `System.plot`."""
    chosen = PlotOptions(**options)
    if not isinstance(chosen.angles, bool):
        name = system.structure.frame_name(chosen.angles)
        if system.dim == 3:
            raise UnsupportedError(
                f"angles to frame {name!r} are drawn of planar systems; in space there is "
                "angles=True"
            )
    if path is None and getattr(q, "is_motion", False):
        q, path = None, q
    way, drivers = read_motion(system, path)
    several, titles = read_configurations(system, q, way)
    given = tuple(read_names(chosen.titles, "titles"))
    if given and len(given) != len(several):
        raise InputError(
            f"titles has {format_count(len(given), 'name')}, and "
            f"{format_count(len(several), 'configuration')} {'is' if len(several) == 1 else 'are'} "
            "drawn"
        )
    if chosen.ghosts and way is None:
        raise InputError(f"ghosts is {chosen.ghosts}, and there is no motion: path gives one")
    titles = given or titles
    subjects = [
        replace(
            make_subject(system, several[:1], way, path, drivers, chosen, titles),
            missed=_find_missed_target(system, q),
        )
    ]
    if len(several) > 1 and chosen.side_by_side:
        subjects = [
            make_subject(system, x[None], way, path, drivers, chosen, titles[k : k + 1])
            for k, x in enumerate(several)
        ]
    elif len(several) > 1:
        subjects = [make_subject(system, several, way, path, drivers, chosen, titles)]
    drawing = choose_drawing(system)
    if not chosen.side_by_side:
        ax = drawing.draw_picture(subjects[0], chosen.ax)
        if len(given) == 1:
            # an own figure has no room above
            inside = {"y": 1.0, "pad": -12.0} if chosen.ax is None else {}
            ax.set_title(given[0], size=style.FONT + 1, color=style.INK, **inside)
        return ax
    return _draw_subjects(drawing, subjects)


def _find_missed_target(system: Model, answer: Any) -> Array | None:
    """Find the frame's position and the target (2, 3) that an answer does not reach, else None."""
    problem: Any = getattr(answer, "problem", None)
    targets: Any = getattr(problem, "targets", None)
    name: Any = getattr(problem, "frame", None)
    if name is None or np.shape(targets) != (1, 4, 4) or answer or not all(problem.mask[:3]):
        return None
    ends = np.stack([fk(system, answer.q, name)[:3, 3], targets[0, :3, 3]])
    return ends if np.isfinite(ends).all() else None


def draw_bare_system(system: Model) -> Axes:
    """Draw a system with default options in a figure that is independent of pyplot."""
    subject = make_subject(
        system, choose_configuration(system, None)[None], None, None, (), PlotOptions(), ()
    )
    return choose_drawing(system).draw_picture(subject, None, make=page.make_bare_figure)


def choose_drawing(system: Model) -> Any:
    """Choose the module that draws systems of this dimension."""
    from kempe.views.drawing import plane, space

    return space if system.dim == 3 else plane


def make_subject(
    system: Model,
    several: Array,
    way: Array | None,
    path: Any,
    drivers: tuple[str, ...],
    options: PlotOptions,
    titles: tuple[str, ...],
) -> Subject:
    """Make the subject of one picture; the first of several configurations is drawn in full."""
    q = several[0]
    names = list_frame_names(system, options.frames)
    scene = build_scene(system, q, drivers)
    if not all(np.all(np.abs(scene.list_points(link)) < FARTHEST) for link in scene.links):
        raise InputError(
            f"{system.name} has points that are not finite or beyond {FARTHEST:g} {system.unit}: "
            "nothing is drawn"
        )
    if way is not None and not names:
        names = list(
            getattr(path, "frames", ()) or (f for link in scene.links[1:] for f in link.frames)
        )
    curves = {n: fk(system, way, n)[:, :3, 3] for n in names} if way is not None else {}
    moving = [f for link in scene.links[1:] for f in (*link.bodies, *link.frames)]
    every = isinstance(options.axes, str) and options.axes == "all"
    axes = [system.body_names[0], *moving] if every else list_frame_names(system, options.axes)
    earlier = [] if way is None else list(_select_configurations(way, options.ghosts))
    earlier += list(_list_neighbours(system, q)) if options.motion else []
    return Subject(
        system,
        scene,
        options,
        tuple(build_scene(system, x, drivers) for x in several[1:]),
        titles,
        tuple(build_scene(system, x) for x in earlier),
        way,
        curves,
        {n: fk(system, q, n) for n in names},
        {n: fk(system, q, n) for n in axes},
        _compute_workspace(system, options),
        units=list_units(system),
    )


def _compute_workspace(system: Model, options: PlotOptions) -> Any:
    """Compute the workspace to be shaded. Errors: `UnsupportedError`."""
    if options.workspace is None:
        return None
    if system.dim == 3:
        raise UnsupportedError(
            "a workspace is shaded in pictures of planar systems; in space see workspace(frame)"
        )
    from kempe.workspace.planar.planar_workspace import planar_workspace

    return planar_workspace(system, options.workspace)


def _draw_subjects(drawing: Any, subjects: list[Subject]) -> tuple[Axes, ...]:
    """Draw each subject on axes of its own, in rows of up to `ACROSS`, all with the same scale."""
    rows = -(-len(subjects) // ACROSS)
    across = -(-len(subjects) // rows)
    own: Any = subjects[0].options.ax
    if own is not None:
        own = page.check_axes(own, len(subjects))
    if drawing.__name__.endswith("space"):
        figure = None if own is not None else page.make_figure(4.2 * across, 4.2 * rows)
        axes = (
            own
            if figure is None
            else [
                figure.add_subplot(rows, across, k + 1, projection="3d")
                for k in range(len(subjects))
            ]
        )
        bounds: Any = [()] * len(subjects)
    else:
        bounds = [(drawing.find_bounds(subjects),)] * len(subjects)
        span = bounds[0][0][1] - bounds[0][0][0]
        height = float(np.clip(4.2 * span[1] / span[0], 1.8, 5.0))
        figure = None if own is not None else page.make_figure(4.2 * across, (height + 0.5) * rows)
        axes = (
            own
            if figure is None
            else [figure.add_subplot(rows, across, k + 1) for k in range(len(subjects))]
        )
    axes = tuple(np.ravel(np.array(axes, dtype=object)))
    for subject, ax, known in zip(subjects, axes, bounds, strict=True):
        drawing.draw_picture(subject, ax, *known)
        if subject.titles:
            ax.set_title(subject.titles[0], size=style.FONT + 1, color=style.INK)
    return axes


def list_frame_names(system: Model, frames: Any) -> list[str]:
    """List the names of frames given as a list, as one name, or as None for all."""
    if frames is None:
        return list(system.frame_names)
    several: list[Any] = list(frames) if is_sequence(frames) else [frames]
    return [system.structure.frame_name(f) for f in several]


def plot_path(
    path: Any, *, names: Iterable[str] = (), system: Model | None = None, ax: Axes | None = None
) -> Axes:
    """Plot coordinates over the arc length of a path: angles in radians, slides in metres (dashed).

    `path` is an answer with configurations `.q` (n, nq) and arc lengths `.s` (n,), else times `.t`
    [s], else they are numbered; its singular points are ringed, its turning points dotted. `names`:
    the coordinates to draw, all by default. `system` is that of the path, where the path has no
    `.system`. Errors: `InputError` for shapes, `UnknownNameError` for names.
    """
    system = getattr(path, "system", None) if system is None else system
    if system is None:
        raise InputError("the path does not say which system it belongs to; give it as `system`")
    over, along = next(((n, a) for n, a in ALONG.items() if hasattr(path, a)), ("row", ""))
    q = read_q(system, path.q)
    s = (
        read_reals(getattr(path, along), "the arc length of the path")
        if along
        else np.arange(float(len(q)))
    )
    if q.ndim != 2 or s.shape != q.shape[:1]:
        need = f"they must be (n, {system.nq}) and (n,)"
        raise InputError(f"path has q of shape {q.shape} and s of shape {s.shape}; {need}")
    known = system.coordinate_names
    chosen = list(names) or list(known)
    for name in chosen:
        if name not in known:
            raise UnknownNameError("coordinate", name, known, system.name)
    ax = (
        page.make_figure(7.0, 4.2).add_axes((0.085, 0.12, 0.72, 0.84))
        if ax is None
        else page.check_axes(ax)[0]
    )
    unit = list_units(system)
    for k, name in enumerate(chosen):
        i = known.index(name)
        how: dict[str, Any] = {
            "color": style.choose_link_colour(k + 1),
            "lw": 1.7,
            "ls": "--" if unit[name] == system.unit else "-",
        }
        how |= {
            "marker": MARKERS[k % len(MARKERS)],
            "ms": 5,
            "mfc": "white",
            "markevery": _choose_marker_spacing(len(s), k),
        }
        ax.plot(s, q[:, i], gid=f"coordinate:{name}", label=name, **how)
    index = [known.index(n) for n in chosen]
    for kind, colour, line in (("turning", style.GROUND, ":"), ("singular", style.OPEN, "-")):
        for k, event in enumerate(getattr(path, f"{kind}_points", ())):
            ax.axvline(
                event.s, color=colour, lw=0.8, ls=line, alpha=0.6, zorder=0.5, gid=f"{kind}:{k}"
            )
            if kind == "singular":
                values = np.asarray(event.q, dtype=float)[index]
                ax.plot(
                    np.full((len(index),), float(event.s)),
                    values,
                    "o",
                    mfc="none",
                    mec=colour,
                    ms=6,
                    gid=f"{kind}:{k}:values",
                )
    page.draw_light_axes(ax)
    kinds = [
        text
        for u, text in (("rad", "angles [rad]"), (system.unit, f"slides [{system.unit}]"))
        if u in {unit[n] for n in chosen}
    ]
    ax.set_ylabel(", ".join(kinds) or "coordinates", size=style.FONT, color=style.INK)
    ax.set_xlabel(over, size=style.FONT, color=style.INK)
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=style.FONT - 1, frameon=False)
    return ax


def _choose_marker_spacing(count: int, k: int) -> tuple[int, int]:
    """Choose the first of `count` points that is marked on curve k, and how many lie between two marks."""
    every = max(1, count // 8)
    return (k * every // len(MARKERS)) % max(count, 1), every


def _list_neighbours(system: Model, q: Array) -> Array:
    """List configurations (k, nq) slightly to both sides in each coordinate.

    There are none with loops or many coordinates.
    """
    if has_loops(system) or not 0 < system.nv <= FEW:
        return np.zeros((0, system.nq))
    slides = [
        unit == system.unit
        for unit in (list_units(system).get(n, "") for n in system.structure.velocity_names)
    ]
    steps = np.diag([SLIDE * build_scene(system, q).size if slide else TURN for slide in slides])
    return np.concatenate([integrate_velocity(system, q, sign * steps) for sign in (-1.0, 1.0)])


def plot_history(history: Any, ax: Axes | None = None) -> Axes:
    """Plot the errors of an `IkHistory` over its steps, logarithmically, one line for each start.

    Starts differ in their marks, open ones from the `len(MARKERS)`-th on, and the one that came
    nearest is drawn thick; position errors [m] are solid lines, orientation errors [rad] dashed.
    """
    from matplotlib.ticker import MaxNLocator

    ax = (
        page.make_figure(7.0, 4.2).add_axes((0.11, 0.12, 0.68, 0.84))
        if ax is None
        else page.check_axes(ax)[0]
    )
    least = 1e-17
    units = {"position": history.system.unit, "orientation": "rad"}
    kinds = {"position": "-", "orientation": (0, (5, 2))}
    errors = {name: np.asarray(getattr(history, f"{name}_error")) for name in units}
    errors = {name: values for name, values in errors.items() if values.any()}
    starts = np.unique(history.start)
    best = (
        history.start[int(np.argmin(sum(errors.values(), np.zeros(len(history.start)))))]
        if len(starts)
        else -1
    )
    for k, start in enumerate(starts):
        rows = history.start == start
        colour = style.INK if start == best else style.choose_link_colour(k + 1)
        how: dict[str, Any] = {
            "color": colour,
            "lw": 2.6 if start == best else 1.2,
            "zorder": 2.0 + (start == best),
        }
        how |= {
            "marker": MARKERS[k % len(MARKERS)],
            "ms": 5,
            "mfc": "white" if k // len(MARKERS) % 2 else colour,
        }
        for name, values in errors.items():
            named = (k < MOST_NAMED or start == best) and name == next(iter(errors))
            label = f"start {start}" if named else "_"
            ax.plot(
                history.step[rows],
                np.maximum(values[rows], least),
                ls=kinds[name],
                gid=f"{name}:{start}",
                label=label,
                **how,
            )
    ax.set_yscale("log")
    page.draw_light_axes(ax)
    ax.tick_params(
        which="minor", labelsize=style.FONT - 2, labelcolor=style.GROUND, color=style.FAINT
    )
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("step", size=style.FONT, color=style.INK)
    dashed = " (dashed)" * (len(errors) > 1)
    said = [f"{name} [{units[name]}]" + dashed * (name == "orientation") for name in errors]
    ax.set_ylabel(
        f"error: {', '.join(said)}" if said else "error", size=style.FONT, color=style.INK
    )
    ax.legend(
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        fontsize=style.FONT - 1,
        frameon=False,
        title=f"of {format_count(len(starts), 'start')}" if len(starts) > MOST_NAMED else None,
    )
    return ax


def _select_configurations(configurations: Array, count: int) -> Array:
    """Select `count` configurations evenly spread over a motion, without its last one."""
    finite = configurations[np.isfinite(configurations).all(axis=1)]
    index = np.unique(np.linspace(0, len(finite) - 1, count + 1).round().astype(int)[:count])
    return finite[index]
