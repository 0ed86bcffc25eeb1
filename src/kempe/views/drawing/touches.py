"""What touches, rolls or does not slip in the plane: wheels on an axle, a wheel or ball on a line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.spatial import Array
from kempe.views.drawing import shapes, style
from kempe.views.drawing.style import GROUND, INK, PAPER

if TYPE_CHECKING:
    from kempe.views.drawing.planar import Sheet
    from kempe.views.drawing.scene import SeenMark

AXLE = 0.22
"""Half of an axle without a length of its own, as part of the whole drawing."""


def draw(sheet: Sheet, mark: SeenMark) -> None:
    """Draw where a constraint holds: an axle with wheels, a wheel or ball on the line that it
    touches, or a point.
    """
    r = sheet.r
    c = mark.point[:2]
    gid = f"mark:{mark.name}"
    label = c
    colour = style.link_colour(mark.link)
    if mark.plane is not None:
        foot = mark.plane[0][:2]
        down = -mark.plane[1][:2]
        half = max(mark.radius, 4.0 * r) * 1.6 * np.array([-down[1], down[0]])
        sheet.patch(
            shapes.hatched(foot - half, foot + half, down, r),
            f"{gid}:plane",
            style.RAILS,
            fc="none",
            ec=GROUND,
            lw=1.1,
        )
        sheet.obstacles.segment(foot - half, foot + half, r)
    if mark.radius > 0.0:
        sheet.patch(
            shapes.circle(c, mark.radius),
            f"{gid}:round",
            style.POLYGONS,
            fc=(colour, 0.2),
            ec=INK,
            lw=1.2,
        )
        sheet.obstacles.segment(c, c, mark.radius)
    elif mark.symbol == "wheel":
        label = wheels(sheet, mark, gid)
    sheet.patch(shapes.circle(c, 0.6 * r), gid, style.PINS, fc=PAPER, ec=INK, lw=1.2)
    sheet.labels.append((mark.name, label, 1.2 * r, {"gid": f"label:{mark.name}", "color": INK}))


def wheels(sheet: Sheet, mark: SeenMark, gid: str, colour: str = INK) -> Array:
    """Draw an axle with its wheels, if the constraint is one; where there is room for its name
    (2,).
    """
    r = sheet.r
    c = mark.point[:2]
    if mark.symbol != "wheel" or mark.radius > 0.0:
        return c
    along = mark.B[:2, 0]
    across = mark.B[:2, 1]
    half = max(4.0 * r, AXLE * sheet.scene.size) * across
    sheet.line(np.array([c - half, c + half]), f"{gid}:axle", style.BARS, color=colour, lw=1.8)
    for k, end in enumerate((c - half, c + half)):
        sheet.patch(
            shapes.box(end, along, 2.4 * r, 0.8 * r),
            f"{gid}:wheel{k}",
            style.BLOCKS,
            fc=colour,
            ec=colour,
        )
        sheet.obstacles.segment(end - 2.4 * r * along, end + 2.4 * r * along, r)
    return c + half + 1.2 * r * across
