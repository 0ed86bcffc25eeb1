"""What is written and measured in drawings of the plane: bodies, angles, dimensions, arrows of
motion.
"""

from __future__ import annotations

import numpy as np

from kempe.joints import P
from kempe.kinematics.closure_errors import coordinate_value
from kempe.kinematics.forward import fk
from kempe.spatial import Array
from kempe.views.drawing import shapes, style
from kempe.views.drawing.planar import Sheet, flat
from kempe.views.drawing.scene import SeenJoint, SeenLink
from kempe.views.drawing.style import GROUND, INK, MOTION
from kempe.views.drawing.subject import Subject, length_name, lengths_by_name

ARC = 4.8
"""Radius of the arc of an angle."""
THIN = {"lw": 0.8, "color": INK}
NOTHING = 0.02
"""Angles up to this have no arc [rad]."""


def draw(sheet: Sheet, subject: Subject) -> None:
    """Draw all that the options want beside the system itself; labels are only collected."""
    options = subject.options
    if options.motion:
        for joint in sheet.scene.joints:
            freedoms(sheet, joint)
    if options.dimensions:
        for link in sheet.scene.links:
            _dimensions(sheet, subject, link)
    if options.angles:
        for joint in sheet.scene.joints:
            _angle(sheet, subject, joint)
        if not isinstance(options.angles, bool):
            _way_to(sheet, subject, subject.system.structure.frame_name(options.angles))
    if "bodies" in options.words:
        for link in sheet.scene.links:
            _body(sheet, subject, link)


# ---- names of bodies


def _body(sheet: Sheet, subject: Subject, link: SeenLink) -> None:
    """Collect the name of a link, in its colour, at its middle."""
    p = flat(sheet.scene.points(link))
    text = subject.body_text(link)
    colour = style.mix(style.link_colour(link.number), INK, 0.35)
    look = {"gid": f"label:body:{text}", "color": colour, "weight": "bold"}
    if link.ground:
        grounded = [flat(j.on(0)) for j in sheet.scene.joints if 0 in (j.parent, j.child)]
        p = np.array(grounded[:1]) if grounded else p
        down = np.array([0.0, -1.0]) * (style.GROUND_HEIGHT + 1.0) * sheet.r
        p = p + down
    if not len(p):
        p = flat(next(iter(link.bodies.values())))[None]
    sheet.labels.append((text, p.mean(axis=0), 0.9 * sheet.r, look))


# ---- angles and lengths of coordinates


def _angle(sheet: Sheet, subject: Subject, joint: SeenJoint) -> None:
    """Draw the arc of an angle from x of F to x of M, or the length that a joint slides by."""
    names = subject.coordinates(joint)
    if len(names) != 1 or len(joint.motions) != 1:
        return
    value = float(coordinate_value(subject.system, sheet.scene.q, names[0]))
    text = subject.measured_text(names[0])
    gid = f"angle:{joint.name}"
    if joint.motions[0].kind == P:
        _dimension(sheet, flat(joint.F), flat(joint.M), text, gid, style.DRIVER)
        return
    turned = np.sign(joint.F[2, 2]) * value
    start = float(np.arctan2(joint.F[1, 0], joint.F[0, 0]))
    used = sum(bool(np.linalg.norm(c - flat(joint.M)) < 0.3 * sheet.r) for c in sheet.arcs)
    arc(
        sheet,
        flat(joint.M),
        start,
        start + float(np.fmod(turned, 2 * np.pi)),
        text,
        gid,
        ARC + 1.8 * used,
    )


def arc(
    sheet: Sheet,
    c: Array,
    start: float,
    stop: float,
    text: str,
    gid: str,
    radius: float = ARC,
    colour: str = INK,
) -> None:
    """Draw an angle at c (2,) between two directions [rad], with a line along each, and collect its
    name.
    """
    r = sheet.r
    size = radius * sheet.r
    for k, angle in enumerate((start, stop)):
        line = np.array(
            [c, c + (1.7 if k == 0 else 1.25) * size * np.array([np.cos(angle), np.sin(angle)])]
        )
        sheet.line(
            line, f"{gid}:side{k}", style.RAILS, **{**THIN, "ls": (0, (4, 3)), "color": GROUND}
        )
    middle = 0.5 * (start + stop)
    if abs(stop - start) > NOTHING:
        points, head = shapes.arc(
            c, size, start, stop, min(1.3 * r, 0.6 * size * abs(stop - start))
        )
        sheet.line(points, gid, style.ARROWS, lw=1.1, color=colour)
        sheet.arcs.append(c)
        sheet.patch(head, f"{gid}:head", style.ARROWS, fc=colour, ec="none")
        sheet.obstacles.line(points, 0.5 * r, 0.8)
    at = c + 1.05 * size * np.array([np.cos(middle), np.sin(middle)])
    sheet.labels.append(
        (text, at, 0.9 * r, {"gid": f"label:{gid}", "color": colour, "style": "italic"})
    )


def _way_to(sheet: Sheet, subject: Subject, frame: str) -> None:
    """Draw the line from the first joint to a frame, its angle alpha from the ground, beta from the
    first link.
    """
    first = next((j for j in sheet.scene.joints if j.parent == 0 and j.kind == "revolute"), None)
    if first is None:
        return
    c = flat(first.M)
    tip = flat(fk(subject.system, sheet.scene.q, frame))
    sheet.line(
        np.array([c, tip]),
        f"way:{frame}",
        style.BLOCKS,
        **{**THIN, "ls": (0, (6, 2)), "color": style.DRIVER},
    )
    zero = float(np.arctan2(first.F[1, 0], first.F[0, 0]))
    link = float(np.arctan2(first.M[1, 0], first.M[0, 0]))
    line = float(np.arctan2(*(tip - c)[::-1]))
    alpha, beta = (float((x + np.pi) % (2 * np.pi) - np.pi) for x in (line - zero, line - link))
    arc(sheet, c, zero, zero + alpha, r"$\alpha$", "angle:alpha", ARC + 2.6, style.DRIVER)
    arc(sheet, c, link, link + beta, r"$\beta$", "angle:beta", ARC + 5.4, MOTION)


# ---- dimensions


def _dimensions(sheet: Sheet, subject: Subject, link: SeenLink) -> None:
    """Draw the lengths between the joints and frames of a link, along its sides."""
    p = flat(sheet.scene.points(link))
    if link.ground:
        p = np.array(
            [
                flat(j.on(0))
                for j in sheet.scene.joints
                if 0 in (j.parent, j.child) and j.kind == "revolute"
            ]
        )
    corners = shapes.hull(p) if len(p) else p
    pairs = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))[
        : 1 if len(corners) == 2 else None
    ]
    known = lengths_by_name(subject.system, link.bodies)
    for k, (a, b) in enumerate(pairs):
        length = float(np.linalg.norm(b - a))
        if length > 4.0 * sheet.r:
            _dimension(
                sheet, a, b, length_name(known, length), f"dimension:{link.name}:{k}", GROUND
            )


def _dimension(sheet: Sheet, a: Array, b: Array, text: str, gid: str, colour: str) -> None:
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

    def cost(sign: float) -> float:
        line = a + t * (b - a) + 3.6 * sign * r * side
        return float(sheet.obstacles.covered(line).mean()) - 0.02 * sign * (side[1] - 0.3 * side[0])

    sign = min((-1.0, 1.0), key=cost)
    p, q = (x + 3.6 * sign * r * side for x in (a, b))
    for x in (a, b):
        sheet.line(
            np.array([x + 1.4 * sign * r * side, x + 4.4 * sign * r * side]),
            f"{gid}:end",
            style.RAILS,
            **{**THIN, "color": colour, "lw": 0.6},
        )
    sheet.line(np.array([p, q]), gid, style.RAILS, **{**THIN, "color": colour})
    for tip, way in ((p, -along), (q, along)):
        head = shapes.arrow_head(tip, way, min(1.2 * r, 0.4 * length))
        sheet.patch(head, f"{gid}:head", style.RAILS, fc=colour, ec="none")
    sheet.obstacles.segment(p, q, 0.6 * r)
    look = {"gid": f"label:{gid}", "color": colour, "style": "italic"}
    sheet.labels.append((text, 0.5 * (p + q), 0.5 * r, look))


# ---- motion


def freedoms(sheet: Sheet, joint: SeenJoint) -> None:
    """Draw an arrow with two heads for each freedom of a joint: round it, or along what it slides
    on.
    """
    r = sheet.r
    c = flat(sheet.scene.seat(joint, sheet.r))
    gid = f"motion:{joint.name}"
    for k, p in enumerate(joint.motions):
        if p.kind == P:
            along = joint.F[:2, "xyz".index(p.axis)]
            side = np.array([-along[1], along[0]]) * (1.0 if along[0] >= 0 else -1.0)
            middle = c + (2.6 if joint.kind == "prismatic" else 0.0) * r * side
            _both_ways(
                sheet, np.array([middle - 4.0 * r * along, middle + 4.0 * r * along]), f"{gid}:{k}"
            )
            continue
        start = _free_direction(sheet, c, 3.2 * r)
        angles = np.linspace(start, start + float(np.deg2rad(120.0)), 30)
        _both_ways(
            sheet, c + 3.2 * r * np.stack([np.cos(angles), np.sin(angles)], axis=1), f"{gid}:{k}"
        )


def _free_direction(sheet: Sheet, c: Array, radius: float) -> float:
    """Where an arc of 120 degrees round c begins that covers least."""
    costs: list[tuple[float, float]] = []
    start: float
    for start in np.deg2rad(np.arange(0.0, 360.0, 15.0)):
        angles = np.linspace(start, start + float(np.deg2rad(120.0)), 12)
        line = c + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        costs.append(
            (float(sheet.obstacles.covered(line).mean()) - 0.15 * np.sin(angles[6]), float(start))
        )
    return min(costs)[1]


def _both_ways(sheet: Sheet, line: Array, gid: str) -> None:
    """Draw a line (n, 2) with an arrow head at both ends."""
    sheet.line(line, gid, style.ARROWS, color=MOTION, lw=1.7, solid_capstyle="butt")
    for tip, before in ((line[0], line[1]), (line[-1], line[-2])):
        way = (tip - before) / max(float(np.linalg.norm(tip - before)), 1e-300)
        sheet.patch(
            shapes.arrow_head(tip + 0.9 * sheet.r * way, way, 1.5 * sheet.r),
            f"{gid}:head",
            style.ARROWS,
            fc=MOTION,
            ec="none",
        )
    sheet.obstacles.line(line, 0.8 * sheet.r)
