"""Pictures of singular configurations and curves, with the lost and gained directions.

Importing this module needs the extra [view].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError
from kempe.forward.fk import fk
from kempe.numerics.clock import describe_early_end
from kempe.spaces.singular_types import TYPE_1, TYPE_2, LostAndGained, SingularSet, describe_changes
from kempe.spatial import Array
from kempe.status import Status
from kempe.views.drawing import page, style
from kempe.views.plots import plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.budget import Budget
    from kempe.spaces.singular_curves import SingularCurves
    from kempe.spaces.singularities import Singularities

LINES: dict[tuple[str, ...], Any] = {
    (TYPE_1,): "-",
    (TYPE_2,): (0, (4, 1.6)),
    (TYPE_1, TYPE_2): "-.",
    ("serial",): "-",
}
"""How curves of the kinds of singular configurations are drawn; others are dotted."""
MOST = 4
EACH = 2
"""Configurations that a picture shows at most, in all and of each set."""
ARROW = 0.2
NEAR = 0.6
"""Length of an arrow, and how far from the frame a centre of rotation is still drawn, as parts of
the drawing."""
COLOURS = {"lost": style.OPEN, "gained": style.MOTION}
STILL = 1e-7
"""Part of a twist that counts as none."""


def find_shown_curves(found: Singularities, budget: Budget | None = None) -> SingularCurves | None:
    """Find the singular curves to be drawn of a frame in the plane; None if there are none."""
    flat = found.system.dim == 2 and found.frame is not None and found.sets
    return (
        found.curves(budget=budget) if flat and max(s.dimension for s in found.sets) <= 1 else None
    )


def plot_singularities(
    found: Singularities, curves: SingularCurves | None, *, ax: Any = None, **options: Any
) -> tuple[Axes, ...]:
    """Draw singular configurations side by side, and the singular curves.

    See `Singularities.plot`.
    """
    rows = [_pick_configurations(s) for s in found.sets]
    # of each set first one
    shown = sorted((k, i) for i, own in enumerate(rows) for k in range(len(own)))[:MOST]
    picks = [rows[i][k] for i, k in sorted((i, k) for k, i in shown)]
    if not picks:
        raise InputError(f"{found.status}: there is nothing to draw")
    system = found.system
    q = np.array([row[1] for row in picks])
    flat = system.dim == 2
    more = curves is not None and bool(curves or curves.broken)
    count = len(q) + more
    own: Any = None if ax is None else page.check_axes(ax, count)
    if own is None and flat:
        own = np.ravel(
            np.array(page.make_figure(4.2 * count, 4.4).subplots(1, count), dtype=object)
        )
    titles = [title for title, _, _ in picks]
    # frames of their own are drawn anyway
    marked = [found.frame] if found.frame in system.body_names else []
    show: dict[str, Any] = {
        "labels": False,
        "side_by_side": True,
        "titles": titles,
        "frames": marked,
    } | options
    axes = plot(system, q, ax=None if own is None else own[: len(q)], **show)
    if found.frame is not None:
        for one, (_, x, local) in zip(axes, picks, strict=True):
            _draw_directions(one, fk(system, x, found.frame)[:3, 3], local, flat)
        _draw_legend(axes[-1], picks)
    if more and curves is not None and own is not None:
        axes = (*axes, plot_curves(curves, own[-1]))
    return tuple(axes)


def plot_curves(curves: SingularCurves, ax: Axes | None = None) -> Axes:
    """Draw the positions of the frame along singular curves, one line style for each kind."""
    if not any(len(c.p) for c in curves) and not (curves.frame and curves.broken):
        raise InputError(
            f"{curves.status}: there is nothing to draw"
            + ("" if curves.frame else ", without a frame")
        )
    if curves.system.dim != 2 and ax is None:
        ax = page.make_figure(5.0, 5.0).add_subplot(projection="3d")
    given: Any = page.make_figure(5.0, 4.4).add_subplot() if ax is None else page.check_axes(ax)[0]
    d = 3 if hasattr(given, "get_zlim") else 2
    named = set[str]()
    for k, c in enumerate(curves):
        word = c.name or " and ".join(c.kinds)
        given.plot(
            *c.p[:, :d].T,
            color=style.OPEN,
            lw=1.5,
            ls=LINES.get(c.kinds, ":"),
            gid=f"singular:{k}",
            label=word if word not in named else None,
        )
        named.add(word)
    given.set_aspect("equal", adjustable="box" if d == 2 else None)
    if d == 2:
        page.draw_light_axes(given)
    for name in "xyz"[:d]:
        getattr(given, f"set_{name}label")(
            f"{name} [{curves.system.unit}]", size=style.FONT, color=style.INK
        )
    said = describe_early_end(
        curves.broken is Status.INTERRUPTED, curves.broken is Status.OUT_OF_TIME
    )
    said = said.replace(" (", "\n(").replace(": ", ":\n")
    given.set_title(
        f"singular places of {curves.frame!r}{said}", size=style.FONT + 1, color=style.INK
    )
    if named:
        given.legend(
            fontsize=style.FONT - 1,
            frameon=False,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.14),
            ncols=2,
        )
    return given


def _pick_configurations(s: SingularSet) -> list[tuple[str, Array, LostAndGained]]:
    """Pick configurations of a set, with titles and the lost and gained directions."""
    head = s.name or " and ".join(s.kinds)
    if not len(s.values):
        return [
            (f"{head}\n{describe_changes(s.local[0].lost, s.local[0].gained)}", s.q[0], s.local[0])
        ]
    names = list(s.coordinates)
    rows = list[tuple[str, Array, LostAndGained]]()
    for value in s.values[:EACH]:
        off = [np.abs(np.sin(0.5 * (q[list(s.places)] - value))).max() for q in s.q]
        k = int(np.argmin(off))
        said = ", ".join(f"{n} = {x + 0.0:.3g}" for n, x in zip(names, value, strict=True))
        rows.append(
            (
                f"{head}, {said}\n{describe_changes(s.local[k].lost, s.local[k].gained)}",
                s.q[k],
                s.local[k],
            )
        )
    return rows


def _draw_directions(ax: Any, p: Array, local: LostAndGained, flat: bool) -> None:
    """Draw twists at a frame's position (3,): arrows of slides; centres or axes of rotations."""
    length = ARROW * float(np.ptp(ax.get_xlim()))
    for word, colour in COLOURS.items():
        for k, twist in enumerate(getattr(local, word)):
            gid = f"{word}:{k}"
            (v, w) = (twist[:3], twist[3:])
            if not flat:
                for x, line in ((v, "-"), (w, ":")):
                    if np.linalg.norm(x) > STILL * max(np.linalg.norm(twist), STILL):
                        ax.quiver(
                            *p,
                            *(length * x / np.linalg.norm(x)),
                            color=colour,
                            lw=1.8,
                            ls=line,
                            gid=gid,
                        )
                continue
            centre = (
                p[:2] + np.array([-v[1], v[0]]) / w[2] if abs(w[2]) > STILL else np.full(2, np.inf)
            )
            how: dict[str, Any] = {
                "arrowstyle": "<|-|>",
                "color": colour,
                "lw": 1.6,
                "shrinkA": 0,
                "shrinkB": 0,
            }
            ends = p[:2] + length * np.outer(
                [-1.0, 1.0], v[:2] / max(float(np.linalg.norm(v[:2])), 1e-300)
            )
            if np.linalg.norm(centre - p[:2]) < NEAR * length / ARROW:
                ax.plot(
                    *np.stack([centre, p[:2]]).T, ls=":", lw=1.0, color=colour, zorder=style.ARROWS
                )
                ax.plot(*centre, "o", ms=5, color=colour, gid=f"{gid}:centre", zorder=style.TEXT)
                ends = centre + 0.5 * length * np.array([[0.8, -0.6], [0.8, 0.6]])
                how["connectionstyle"] = "arc3,rad=0.45"
            ax.annotate(
                "",
                ends[1],
                xytext=ends[0],
                arrowprops=how,
                gid=gid,
                zorder=style.TEXT,
                annotation_clip=False,
            )


def _draw_legend(ax: Any, picks: list[tuple[str, Array, LostAndGained]]) -> None:
    """Draw the legend of lost and gained directions."""
    from matplotlib.lines import Line2D

    words = [w for w in COLOURS if any(len(getattr(local, w)) for _, _, local in picks)]
    entries = [Line2D([], [], color=COLOURS[w], lw=1.8, label=f"direction {w}") for w in words]
    if entries:
        ax.legend(
            handles=entries,
            fontsize=style.FONT - 1,
            frameon=False,
            loc="upper center",
            ncols=2,
            bbox_to_anchor=(0.5, -0.1),
        )
