"""Pictures of systems and of motions with matplotlib, without any global state: PNG, SVG or PDF by `savefig`.

A planar system is drawn as a textbook's kinematic diagram, a system in space as solids. Importing this module needs
the extra [view]. Errors: `MissingExtraError` without matplotlib.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.calls import explained
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.configuration import as_q, distance, home_of
from kempe.kinematics.forward import fk
from kempe.kinematics.measure import judge
from kempe.reals import reals
from kempe.spatial import Array
from kempe.views.drawing import page, planar, style
from kempe.views.drawing.scene import Scene, look
from kempe.views.facts import units

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.system import System


@explained
def plot(
    system: System, q: Any = None, *, path: Any = None, frames: Iterable[Any] | None = (), labels: bool = True,
    ax: Axes | None = None, ghosts: int = 0,
) -> Axes:  # fmt: skip
    """Axes with a drawing of the system at a configuration; ``.figure.savefig("name.png")`` or ``.svg`` writes it.

    `q` (nq,) or dict: the configuration; without it, the posture 'closed' if there is one, else `mid`, brought to where
    loops are closed and constraints hold if that can be; with a `path` its configuration nearest to home. `frames`:
    names of frames or bodies whose axes are drawn, None for all of them: x red, y green, z blue. `path`: configurations
    (n, nq), or an answer that has them as `.q`; in place of the axes, the curves of the named `frames` are drawn over
    it (without names: those of the path's `.frames`, else all named frames of moving bodies), and `ghosts` earlier
    positions, evenly spread. Driven joints (`actuated`, or the path's `.driver`) are marked, and loops that are not
    closed are shown in red.
    Errors: `InputError` for shapes, `UnknownNameError` for frames.
    """
    configurations, drivers = _path(system, path)
    q = _configuration(system, q, configurations)
    names = names_of(system, frames)
    scene = look(system, q, drivers)
    if configurations is not None and not names:
        names = list(getattr(path, "frames", ()) or (f for link in scene.links[1:] for f in link.frames))
    curves = {n: fk(system, configurations, n)[:, :3, 3] for n in names} if configurations is not None else {}
    here = {n: fk(system, q, n) for n in names}
    before = [] if configurations is None else [look(system, c) for c in _spread(configurations, ghosts)]
    if system.dim == 3:
        from kempe.views.drawing import space

        return space.picture(scene, configurations, curves, here, before, labels, ax)
    return _picture(scene, configurations, curves, here, before, labels, ax)


def names_of(system: System, frames: Any) -> list[str]:
    """Names of the frames that are given: a list, one, or None for all bodies and frames."""
    if frames is None:
        return list(system.frame_names)
    return [system.structure.frame_name(f) for f in (frames if isinstance(frames, (list, tuple)) else [frames])]


def plot_path(
    path: Any, *, names: Iterable[str] = (), system: System | None = None, ax: Axes | None = None
) -> Axes:  # fmt: skip
    """Axes with coordinates over the arc length of a path: angles in radians, slides in metres (dashed).

    `path` is an answer with configurations `.q` (n, nq) and arc lengths `.s` (n,); its singular points are ringed, its
    turning points dotted. `names`: the coordinates to draw, all by default. `system` is that of the path, where the
    path has no `.system`. Errors: `InputError` for shapes, `UnknownNameError` for names.
    """
    system = getattr(path, "system", None) if system is None else system
    if system is None:
        raise InputError("the path does not say which system it belongs to; give it as `system`")
    q, s = as_q(system, path.q), reals(path.s, "the arc length of the path")
    if q.ndim != 2 or s.shape != q.shape[:1]:
        need = f"they must be (n, {system.nq}) and (n,)"
        raise InputError(f"path has q of shape {q.shape} and s of shape {s.shape}; {need}")
    known = system.coordinate_names
    chosen = list(names) or list(known)
    for name in chosen:
        if name not in known:
            raise UnknownNameError("coordinate", name, known, system.name)
    ax = page.new_figure(7.0, 4.2).add_axes((0.085, 0.12, 0.72, 0.84)) if ax is None else ax
    unit = units(system)
    for k, name in enumerate(chosen):
        i = known.index(name)
        how = {"color": style.link_colour(k + 1), "lw": 1.7, "ls": "--" if unit[name] == "m" else "-"}
        ax.plot(s, q[:, i], gid=f"coordinate:{name}", label=name, **how)
    index = [known.index(n) for n in chosen]
    for kind, colour, line in (("turning", style.GROUND, ":"), ("singular", style.OPEN, "-")):
        for k, event in enumerate(getattr(path, f"{kind}_points", ())):
            ax.axvline(event.s, color=colour, lw=0.8, ls=line, alpha=0.6, zorder=0.5, gid=f"{kind}:{k}")
            if kind == "singular":
                ax.plot(np.full(len(index), event.s), np.asarray(event.q)[index], "o", mfc="none", mec=colour, ms=6,
                        gid=f"{kind}:{k}:values")  # fmt: skip
    page.light_axes(ax)
    kinds = [text for u, text in (("rad", "angles [rad]"), ("m", "slides [m]")) if u in {unit[n] for n in chosen}]
    ax.set_ylabel(", ".join(kinds) or "coordinates", size=style.FONT, color=style.INK)
    ax.set_xlabel("arc length", size=style.FONT, color=style.INK)
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=style.FONT - 1, frameon=False)
    return ax


def _picture(
    scene: Scene, configurations: Array | None, curves: dict[str, Array], here: dict[str, Array],
    before: list[Scene], labels: bool, ax: Any,
) -> Axes:  # fmt: skip
    if ax is not None and hasattr(ax, "get_zlim"):
        raise InputError("ax is in space; a planar system needs plain axes")
    trial = page.new_figure().add_subplot() if ax is None else ax
    sheet = planar.Sheet(trial, scene, planar.pin_radius(scene), configurations)
    marks = {} if curves else here
    if ax is None:  # the extent of the drawing decides the shape of the figure
        planar.draw(sheet, labels=False)
        for name, X in marks.items():
            planar.mark(sheet, name, X, labels=False)
        sheet.extent += [c[np.isfinite(c).all(axis=1), :2] for c in curves.values()]
        sheet.extent += [planar.flat(old.points(link)) for old in before for link in old.links]
        lower, upper = page.limits(sheet)
        ax = page.figure_for(upper - lower, bool(curves))
        sheet = planar.Sheet(ax, scene, sheet.r, configurations)
    for k, old in enumerate(before):
        planar.ghost(sheet, old, k)
    for k, (name, points) in enumerate(curves.items()):
        page.curve(sheet, name, points[:, :2], planar.flat(here[name]), k)
    planar.draw(sheet, labels)
    for name, X in marks.items():
        planar.mark(sheet, name, X, labels)
    lower, upper = page.limits(sheet)
    page.finish(sheet, lower, upper, bool(curves))
    return ax


def _configuration(system: System, q: Any, configurations: Array | None) -> Array:
    if q is not None:
        q = as_q(system, q)
        if q.ndim != 1:
            raise InputError(f"q has shape {q.shape}; one configuration ({system.nq},) is drawn; others go in `path`")
        if not np.isfinite(q).all():
            raise InputError("q holds numbers that are not finite: there is nothing to draw")
        return q
    q = home_of(system)
    if configurations is None:
        closed = None if judge(system, q) else system.assemble(start=q)
        return closed.q if closed else q
    finite = configurations[np.isfinite(configurations).all(axis=1)]
    return finite[int(np.argmin(distance(system, finite, q)))]


def _path(system: System, path: Any) -> tuple[Array | None, tuple[str, ...]]:
    """Configurations (n, nq) of a path, and names of the joints that drive it.

    `path` is an array, or an answer with a field `q`, and perhaps `driver`, a name or names; None gives (None, ()).
    Errors: `InputError` for other shapes.
    """
    if path is None:
        return None, ()
    configurations = as_q(system, path if isinstance(path, np.ndarray) else getattr(path, "q", path))
    if configurations.ndim != 2 or not np.isfinite(configurations).all(axis=1).any():
        raise InputError(f"path has shape {configurations.shape}; it must be (n, {system.nq}), not all of it NaN")
    driver = getattr(path, "driver", None)
    names = [driver] if isinstance(driver, str) else list(driver or ()) if isinstance(driver, (list, tuple)) else []
    joints = {c: j for j in system.joint_names for c in system.structure.coordinates_of_joint(j)}
    return configurations, tuple(joints.get(n, n) for n in names if isinstance(n, str))


def _spread(configurations: Array, count: int) -> Array:
    finite = configurations[np.isfinite(configurations).all(axis=1)]
    if not isinstance(count, (int, np.integer)) or isinstance(count, bool) or count < 0:
        raise InputError(f"ghosts is {count!r}; it must be a whole number, not negative")
    index = np.unique(np.linspace(0, len(finite) - 1, count + 1).round().astype(int)[:count])
    return finite[index]
