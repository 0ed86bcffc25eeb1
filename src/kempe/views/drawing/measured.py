"""What is written and measured in drawings of systems in space: bodies, angles, lengths, names of
axes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kempe.joints import P, Primitive, Q, R
from kempe.kinematics.closure_errors import coordinate_value
from kempe.spatial import Array
from kempe.views.drawing import style, symbols
from kempe.views.drawing.scene import SeenJoint
from kempe.views.drawing.solids import Solids
from kempe.views.drawing.style import GROUND, INK, MOTION
from kempe.views.drawing.subject import Subject, length_name, lengths_by_name, subscript

Text = tuple[Array, str, dict[str, Any]]
"""A point (3,), what is written beside it, and its look."""
ARC = 4.5
"""Radius of the arc of an angle."""


def texts(subject: Subject, mark: float) -> list[Text]:
    """What is written beside names of joints and frames; `mark` is the length of drawn axes [m]."""
    options = subject.options
    scene = subject.scene
    out: list[Text] = []
    for name, X in subject.axes.items():
        below = subscript(subject.system, name)
        for k, axis in enumerate("xyz"):
            look = {"color": style.mix(style.AXES[k], INK, 0.3), "gid": f"label:{name}:{axis}"}
            out.append((X[:3, 3] + 1.1 * mark * X[:3, k], f"${axis}{below}$", look))
    for link in scene.links if "bodies" in options.words or options.dimensions else ():
        lines = list(symbols.lines_of(scene, link)) if not link.ground else []
        colour = style.mix(style.link_colour(link.number), INK, 0.35)
        longest = max(lines, key=_length, default=scene.points(link)[:1])
        at = _middle(longest) if len(longest) else next(iter(link.bodies.values()))[:3, 3]
        if "bodies" in options.words:
            text = subject.body_text(link)
            out.append((at, text, {"color": colour, "weight": "bold", "gid": f"label:body:{text}"}))
        if (
            options.dimensions and not link.ground and len(scene.points(link)) > 1
        ):  # a handle has no length
            known = lengths_by_name(subject.system, link.bodies)
            for k, line in enumerate(side for one in lines for side in _sides(one)):
                text = length_name(known, float(np.linalg.norm(line[-1] - line[0])))
                look = {
                    "color": GROUND,
                    "style": "italic",
                    "gid": f"label:dimension:{link.name}:{k}",
                }
                out.append((_middle(line), text, look))
    scenes = (scene, *subject.others) if subject.others else ()
    out += subject.names_at(
        [np.concatenate([s.points(link) for link in s.links[1:]]) for s in scenes]
    )
    return out


def _sides(line: Array) -> list[Array]:
    """The sides (2, 3) of a closed polyline (n, 3), or an open one as it is."""
    return (
        [line[k : k + 2] for k in range(len(line) - 1)]
        if np.array_equal(line[0], line[-1])
        else [line]
    )


def _length(line: Array) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _middle(line: Array) -> Array:
    """The middle (3,) of the longest piece of a polyline (n, 3)."""
    if len(line) < 2:
        return line[0]
    k = int(np.argmax(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    return 0.5 * (line[k] + line[k + 1])


def angles(ax: Any, subject: Subject, r: float) -> list[Text]:
    """Draw the arc of each angle from x of F to x of M, and the way of each slide; their names with
    their points.
    """
    out: list[Text] = []
    for joint in subject.scene.joints:
        names = subject.coordinates(joint)
        if len(names) != 1 or len(joint.motions) != 1:
            continue
        value = float(coordinate_value(subject.system, subject.scene.q, names[0]))
        gid = f"angle:{joint.name}"
        c = joint.centre
        F = joint.F[:3, :3]
        look = {"color": INK, "style": "italic", "gid": f"label:{gid}"}
        if joint.motions[0].kind == P:
            a = joint.F[:3, 3] + 2.5 * r * F[:, 0]
            line = np.stack([a, a + value * F[:, 2]])
        elif joint.motions[0].kind == R:
            t = np.linspace(0.0, float(np.fmod(value, 2 * np.pi)), 40)[:, None]
            line = c + ARC * r * (np.cos(t) * F[:, 0] + np.sin(t) * F[:, 1])
            for end in (line[0], line[-1]):
                ax.plot(
                    *np.stack([c, c + 1.3 * (end - c)]).T,
                    color=GROUND,
                    lw=0.8,
                    ls=(0, (4, 3)),
                    zorder=style.ARROWS,
                    gid=f"{gid}:side",
                )
        else:
            continue
        ax.plot(*line.T, color=INK, lw=1.2, zorder=style.ARROWS, gid=gid)
        ax.plot(*line[-1:].T, "o", color=INK, ms=2.5, zorder=style.ARROWS, gid=f"{gid}:end")
        out.append((line[len(line) // 2], subject.measured_text(names[0]), look))
    return out


def freedoms(solids: Solids, j: SeenJoint, r: float) -> list[Array]:
    """Arrows with two heads, added for each freedom of a joint: round the axis that it turns about,
    or along it.
    """
    lines: list[Any] = []
    for kind, name in ((k, a) for p in j.motions for k, a in _single(p)):
        axis = j.F[:3, "xyz".index(name)]
        x, y = (j.F[:3, ("xyz".index(name) + n) % 3] for n in (1, 2))
        if kind == P:
            middle = j.centre + 2.6 * r * (x + y) / np.sqrt(2.0)
            line = middle + np.linspace(-3.4, 3.4, 24)[:, None] * r * axis
        else:
            t = np.deg2rad(np.linspace(20.0, 160.0, 40))[:, None]
            line = j.centre + 3.6 * r * (np.cos(t) * x + np.sin(t) * y)
        solids.arrow(f"motion:{j.name}", line[2:-2], 0.13 * r, MOTION)
        solids.arrow(f"motion:{j.name}", line[2:5][::-1], 0.13 * r, MOTION)
        lines.append(line)
    return lines


def _single(p: Primitive) -> list[tuple[int, str]]:
    """The single freedoms of a motion, as kind and axis: a ball turns about all axes."""
    return [(R, axis) for axis in "xyz"] if p.kind == Q else [(p.kind, p.axis)]
