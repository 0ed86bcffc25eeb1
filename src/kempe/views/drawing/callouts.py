"""Callouts of drawings: names of bodies, angles, lengths and arrows of motion.

The plane comes first, then space.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kempe.equations.judge import compute_coordinate_value
from kempe.forward.fk import fk
from kempe.joints import P, Primitive, Q, R
from kempe.spatial import Array
from kempe.views.drawing import shapes, style, symbols
from kempe.views.drawing.planar import Sheet, project_to_plane
from kempe.views.drawing.plot_request import (
    Subject,
    choose_subscript,
    list_named_lengths,
    name_length,
)
from kempe.views.drawing.scene import SeenJoint, SeenLink
from kempe.views.drawing.solids import Solids, find_hull
from kempe.views.drawing.style import GROUND, INK, MOTION

ARC = 4.8
"""Radius of the arc of an angle."""
THIN = {"lw": 0.8, "color": INK}
NOTHING = 0.02
"""Angles up to this have no arc [rad]."""


def draw_callouts(sheet: Sheet, subject: Subject) -> None:
    """Draw what the options request beside the system itself: axes, angles, dimensions, freedoms."""
    options = subject.options
    if options.motion:
        for joint in sheet.scene.joints:
            draw_freedoms(sheet, joint)
    if options.dimensions:
        for link in sheet.scene.links:
            _draw_dimensions(sheet, subject, link)
    if options.angles:
        for joint in sheet.scene.joints:
            _draw_coordinate(sheet, subject, joint)
        if not isinstance(options.angles, bool):
            _draw_line_to_frame(sheet, subject, subject.system.structure.frame_name(options.angles))
    if "bodies" in options.words:
        for link in sheet.scene.links:
            _label_body(sheet, subject, link)


# ---- names of bodies


def _label_body(sheet: Sheet, subject: Subject, link: SeenLink) -> None:
    """Collect the label with the name of a link, in its colour, at its middle."""
    p = project_to_plane(sheet.scene.list_points(link))
    text = subject.format_bodies(link)
    colour = style.mix_colours(style.choose_link_colour(link.number), INK, 0.35)
    look = {"gid": f"label:body:{text}", "color": colour, "weight": "bold"}
    if link.is_ground:
        grounded = [
            project_to_plane(j.find_pose_on(0))
            for j in sheet.scene.joints
            if 0 in (j.parent, j.child)
        ]
        p = np.array(grounded[:1]) if grounded else p
        down = np.array([0.0, -1.0]) * (style.GROUND_HEIGHT + 1.0) * sheet.r
        p = p + down
    if not len(p):
        p = project_to_plane(next(iter(link.bodies.values())))[None]
    sheet.labels.append((text, p.mean(axis=0), 0.9 * sheet.r, look))


# ---- angles and lengths of coordinates


def _draw_coordinate(sheet: Sheet, subject: Subject, joint: SeenJoint) -> None:
    """Draw the arc of a joint's angle from x of F to x of M, or the length of its slide."""
    names = subject.list_coordinates(joint)
    if len(names) != 1 or len(joint.motions) != 1:
        return
    value = float(compute_coordinate_value(subject.system, sheet.scene.q, names[0]))
    text = subject.format_coordinate(names[0])
    gid = f"angle:{joint.name}"
    if joint.motions[0].kind == P:
        _draw_dimension(
            sheet, project_to_plane(joint.F), project_to_plane(joint.M), text, gid, style.DRIVER
        )
        return
    turned = np.sign(joint.F[2, 2]) * value
    start = float(np.arctan2(joint.F[1, 0], joint.F[0, 0]))
    used = sum(
        bool(np.linalg.norm(c - project_to_plane(joint.M)) < 0.3 * sheet.r) for c in sheet.arcs
    )
    draw_angle(
        sheet,
        project_to_plane(joint.M),
        start,
        start + float(np.fmod(turned, 2 * np.pi)),
        text,
        gid,
        ARC + 1.8 * used,
    )


def draw_angle(
    sheet: Sheet,
    c: Array,
    start: float,
    stop: float,
    text: str,
    gid: str,
    radius: float = ARC,
    colour: str = INK,
) -> None:
    """Draw an angle at c (2,) between two directions [rad], with a line along each and its name."""
    r = sheet.r
    size = radius * sheet.r
    for k, angle in enumerate((start, stop)):
        line = np.array(
            [c, c + (1.7 if k == 0 else 1.25) * size * np.array([np.cos(angle), np.sin(angle)])]
        )
        sheet.add_line(
            line, f"{gid}:side{k}", style.RAILS, **{**THIN, "ls": (0, (4, 3)), "color": GROUND}
        )
    middle = 0.5 * (start + stop)
    if abs(stop - start) > NOTHING:
        points, head = shapes.make_arc(
            c, size, start, stop, min(1.3 * r, 0.6 * size * abs(stop - start))
        )
        sheet.add_line(points, gid, style.ARROWS, lw=1.1, color=colour)
        sheet.arcs.append(c)
        sheet.add_outline(head, f"{gid}:head", style.ARROWS, fc=colour, ec="none")
        sheet.obstacles.add_line(points, 0.5 * r, 0.8)
    at = c + 1.05 * size * np.array([np.cos(middle), np.sin(middle)])
    sheet.labels.append(
        (text, at, 0.9 * r, {"gid": f"label:{gid}", "color": colour, "style": "italic"})
    )


def _draw_line_to_frame(sheet: Sheet, subject: Subject, frame: str) -> None:
    """Draw the line from the first joint to a frame, its angle alpha from the ground, beta from the
    first link.
    """
    first = next((j for j in sheet.scene.joints if j.parent == 0 and j.kind == "revolute"), None)
    if first is None:
        return
    c = project_to_plane(first.M)
    tip = project_to_plane(fk(subject.system, sheet.scene.q, frame))
    sheet.add_line(
        np.array([c, tip]),
        f"way:{frame}",
        style.BLOCKS,
        **{**THIN, "ls": (0, (6, 2)), "color": style.DRIVER},
    )
    zero = float(np.arctan2(first.F[1, 0], first.F[0, 0]))
    link = float(np.arctan2(first.M[1, 0], first.M[0, 0]))
    line = float(np.arctan2(*(tip - c)[::-1]))
    alpha, beta = (float((x + np.pi) % (2 * np.pi) - np.pi) for x in (line - zero, line - link))
    draw_angle(sheet, c, zero, zero + alpha, r"$\alpha$", "angle:alpha", ARC + 2.6, style.DRIVER)
    draw_angle(sheet, c, link, link + beta, r"$\beta$", "angle:beta", ARC + 5.4, MOTION)


# ---- lengths of links


def _draw_dimensions(sheet: Sheet, subject: Subject, link: SeenLink) -> None:
    """Draw the lengths between the joints and frames of a link, along its sides."""
    p = project_to_plane(sheet.scene.list_points(link))
    if link.is_ground:
        p = np.array(
            [
                project_to_plane(j.find_pose_on(0))
                for j in sheet.scene.joints
                if 0 in (j.parent, j.child) and j.kind == "revolute"
            ]
        )
    corners = find_hull(p) if len(p) else p
    pairs = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))[
        : 1 if len(corners) == 2 else None
    ]
    known = list_named_lengths(subject.system, link.bodies)
    for k, (a, b) in enumerate(pairs):
        length = float(np.linalg.norm(b - a))
        if length > 4.0 * sheet.r:
            _draw_dimension(
                sheet,
                a,
                b,
                name_length(known, length, subject.system.unit),
                f"dimension:{link.name}:{k}",
                GROUND,
            )


def _draw_dimension(sheet: Sheet, a: Array, b: Array, text: str, gid: str, colour: str) -> None:
    """Draw a length beside a line, with an arrow head at both ends, on the side where there is more
    room.
    """
    length = float(np.linalg.norm(b - a))
    if length < 1e-9 * sheet.scene.size:
        return
    along = (b - a) / length
    r = sheet.r
    side = np.array([-along[1], along[0]])
    t = np.linspace(0.05, 0.95, 24)[:, None]

    def compute_cost(sign: float) -> float:
        """Compute how much a dimension line on one side of the link covers; `sign` chooses the
        side.
        """
        line = a + t * (b - a) + 3.6 * sign * r * side
        return float(sheet.obstacles.find_covering_weights(line).mean()) - 0.02 * sign * (
            side[1] - 0.3 * side[0]
        )

    sign = min((-1.0, 1.0), key=compute_cost)
    p, q = (x + 3.6 * sign * r * side for x in (a, b))
    for x in (a, b):
        sheet.add_line(
            np.array([x + 1.4 * sign * r * side, x + 4.4 * sign * r * side]),
            f"{gid}:end",
            style.RAILS,
            **{**THIN, "color": colour, "lw": 0.6},
        )
    sheet.add_line(np.array([p, q]), gid, style.RAILS, **{**THIN, "color": colour})
    for tip, way in ((p, -along), (q, along)):
        head = shapes.make_arrow_head(tip, way, min(1.2 * r, 0.4 * length))
        sheet.add_outline(head, f"{gid}:head", style.RAILS, fc=colour, ec="none")
    sheet.obstacles.add_segment(p, q, 0.6 * r)
    look = {"gid": f"label:{gid}", "color": colour, "style": "italic"}
    sheet.labels.append((text, 0.5 * (p + q), 0.5 * r, look))


# ---- arrows of motion


def draw_freedoms(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw an arrow with two heads for each freedom of a joint: around it, or along its slide."""
    r = sheet.r
    c = project_to_plane(sheet.scene.find_seat(joint, sheet.r))
    gid = f"motion:{joint.name}"
    for k, p in enumerate(joint.motions):
        if p.kind == P:
            along = joint.F[:2, "xyz".index(p.axis)]
            side = np.array([-along[1], along[0]]) * (1.0 if along[0] >= 0 else -1.0)
            middle = c + (2.6 if joint.kind == "prismatic" else 0.0) * r * side
            _draw_double_arrow(
                sheet, np.array([middle - 4.0 * r * along, middle + 4.0 * r * along]), f"{gid}:{k}"
            )
            continue
        start = _find_free_direction(sheet, c, 3.2 * r)
        angles = np.linspace(start, start + float(np.deg2rad(120.0)), 30)
        _draw_double_arrow(
            sheet, c + 3.2 * r * np.stack([np.cos(angles), np.sin(angles)], axis=1), f"{gid}:{k}"
        )


def _find_free_direction(sheet: Sheet, c: Array, radius: float) -> float:
    """Find the direction [rad] where an arc of 120 degrees around c (2,) covers least."""
    costs: list[tuple[float, float]] = []
    start: float
    for start in np.deg2rad(np.arange(0.0, 360.0, 15.0)):
        angles = np.linspace(start, start + float(np.deg2rad(120.0)), 12)
        line = c + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        costs.append(
            (
                float(sheet.obstacles.find_covering_weights(line).mean())
                - 0.15 * np.sin(angles[6]),
                float(start),
            )
        )
    return min(costs)[1]


def _draw_double_arrow(sheet: Sheet, line: Array, gid: str) -> None:
    """Draw a line (n, 2) with an arrow head at both ends."""
    sheet.add_line(line, gid, style.ARROWS, color=MOTION, lw=1.7, solid_capstyle="butt")
    for tip, before in ((line[0], line[1]), (line[-1], line[-2])):
        way = (tip - before) / max(float(np.linalg.norm(tip - before)), 1e-300)
        sheet.add_outline(
            shapes.make_arrow_head(tip + 0.9 * sheet.r * way, way, 1.5 * sheet.r),
            f"{gid}:head",
            style.ARROWS,
            fc=MOTION,
            ec="none",
        )
    sheet.obstacles.add_line(line, 0.8 * sheet.r)


# ---- drawings in space

Text = tuple[Array, str, dict[str, Any]]
"""A point (3,), what is written beside it, and its look."""
ARC_IN_SPACE = 4.5
"""Radius of the arc of an angle."""


def list_texts(subject: Subject, mark: float) -> list[Text]:
    """List the texts of a picture in space besides the names of joints and frames.

    `mark` is the length of drawn axes [m].
    """
    options = subject.options
    scene = subject.scene
    out: list[Text] = []
    for name, X in subject.axes.items():
        below = choose_subscript(subject.system, name)
        for k, axis in enumerate("xyz"):
            look = {
                "color": style.mix_colours(style.AXES[k], INK, 0.3),
                "gid": f"label:{name}:{axis}",
            }
            out.append((X[:3, 3] + 1.1 * mark * X[:3, k], f"${axis}{below}$", look))
    for link in scene.links if "bodies" in options.words or options.dimensions else ():
        lines = list(symbols.list_link_lines(scene, link)) if not link.is_ground else []
        colour = style.mix_colours(style.choose_link_colour(link.number), INK, 0.35)
        longest = max(lines, key=_compute_length, default=scene.list_points(link)[:1])
        at = _find_middle(longest) if len(longest) else next(iter(link.bodies.values()))[:3, 3]
        if "bodies" in options.words:
            text = subject.format_bodies(link)
            out.append((at, text, {"color": colour, "weight": "bold", "gid": f"label:body:{text}"}))
        # a handle has no length
        if options.dimensions and not link.is_ground and len(scene.list_points(link)) > 1:
            known = list_named_lengths(subject.system, link.bodies)
            for k, line in enumerate(side for one in lines for side in _split_polyline(one)):
                text = name_length(
                    known, float(np.linalg.norm(line[-1] - line[0])), scene.system.unit
                )
                look = {
                    "color": GROUND,
                    "style": "italic",
                    "gid": f"label:dimension:{link.name}:{k}",
                }
                out.append((_find_middle(line), text, look))
    scenes = (scene, *subject.others) if subject.others else ()
    out += subject.place_names(
        [np.concatenate([s.list_points(link) for link in s.links[1:]]) for s in scenes]
    )
    return out


def _split_polyline(line: Array) -> list[Array]:
    """Split a closed polyline (n, 3) into its sides (2, 3); an open one stays whole."""
    return (
        [line[k : k + 2] for k in range(len(line) - 1)]
        if np.array_equal(line[0], line[-1])
        else [line]
    )


def _compute_length(line: Array) -> float:
    """Compute the length of a polyline (n, d) [m]."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _find_middle(line: Array) -> Array:
    """Find the middle (3,) of the longest segment of a polyline (n, 3)."""
    if len(line) < 2:
        return line[0]
    k = int(np.argmax(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    return 0.5 * (line[k] + line[k + 1])


def draw_angles_in_space(ax: Any, subject: Subject, r: float) -> list[Text]:
    """Draw the arc of each angle and the length of each slide in space.

    Returned are their names with the points at which they stand.
    """
    out: list[Text] = []
    for joint in subject.scene.joints:
        names = subject.list_coordinates(joint)
        if len(names) != 1 or len(joint.motions) != 1:
            continue
        value = float(compute_coordinate_value(subject.system, subject.scene.q, names[0]))
        gid = f"angle:{joint.name}"
        c = joint.centre
        F = joint.F[:3, :3]
        look = {"color": INK, "style": "italic", "gid": f"label:{gid}"}
        if joint.motions[0].kind == P:
            a = joint.F[:3, 3] + 2.5 * r * F[:, 0]
            line = np.stack([a, a + value * F[:, 2]])
        elif joint.motions[0].kind == R:
            t = np.linspace(0.0, float(np.fmod(value, 2 * np.pi)), 40)[:, None]
            line = c + ARC_IN_SPACE * r * (np.cos(t) * F[:, 0] + np.sin(t) * F[:, 1])
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
        out.append((line[len(line) // 2], subject.format_coordinate(names[0]), look))
    return out


def draw_freedoms_in_space(solids: Solids, j: SeenJoint, r: float) -> list[Array]:
    """Draw an arrow with two heads for each freedom of a joint in space; return the arrows' points."""
    lines: list[Any] = []
    for kind, name in ((k, a) for p in j.motions for k, a in _split_freedoms(p)):
        axis = j.F[:3, "xyz".index(name)]
        x, y = (j.F[:3, ("xyz".index(name) + n) % 3] for n in (1, 2))
        if kind == P:
            middle = j.centre + 2.6 * r * (x + y) / np.sqrt(2.0)
            line = middle + np.linspace(-3.4, 3.4, 24)[:, None] * r * axis
        else:
            t = np.deg2rad(np.linspace(20.0, 160.0, 40))[:, None]
            line = j.centre + 3.6 * r * (np.cos(t) * x + np.sin(t) * y)
        solids.add_arrow(f"motion:{j.name}", line[2:-2], 0.13 * r, MOTION)
        solids.add_arrow(f"motion:{j.name}", line[2:5][::-1], 0.13 * r, MOTION)
        lines.append(line)
    return lines


def _split_freedoms(p: Primitive) -> list[tuple[int, str]]:
    """Split a motion into single freedoms (kind and axis); a ball turns about all three axes."""
    return [(R, axis) for axis in "xyz"] if p.kind == Q else [(p.kind, p.axis)]
