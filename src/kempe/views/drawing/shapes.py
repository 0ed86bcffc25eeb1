"""Outlines of the planar symbols as matplotlib paths, in metres: links, ground, rails, blocks,
arrows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.path import Path

from kempe.spatial import Array
from kempe.views.drawing.solids import find_hull
from kempe.views.drawing.style import GROUND_HALF, GROUND_HEIGHT, HATCH

if TYPE_CHECKING:
    from kempe.workspace.planar.planar_workspace import PlaneCurve, SolutionRegion

FINE = 0.02
"""Angle between the points by which an arc is drawn."""


def make_rounded_outline(points: Array, radius: float) -> Path:
    """Make the outline at a distance `radius` around the convex hull of points (n, 2)."""
    corners = find_hull(points)
    if len(corners) == 1:
        return make_circle(corners[0], radius)
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.rad2deg(np.arctan2(sides[:, 1], sides[:, 0])) - 90.0
    vertices: list[Array] = []
    codes: list[Any] = []
    for k, corner in enumerate(corners):
        start = normals[k - 1]
        stop = normals[k]
        angle = max((stop - start) % 360.0, 1e-6)
        parts = 2 ** math.ceil(angle / 90.0 - 1e-6)  # where rounding does not decide
        arc = Path.arc(start, start + angle, parts)
        unit = np.asarray(arc.vertices)
        vertices.append(corner + radius * unit)
        codes += [Path.LINETO if vertices[1:] else Path.MOVETO, *[Path.CURVE4] * (len(unit) - 1)]
    vertices.append(vertices[0][:1])
    return Path(np.concatenate(vertices), [*codes, Path.CLOSEPOLY])


def make_circle(centre: Array, radius: float) -> Path:
    """Make the outline of a circle."""
    unit = Path.unit_circle()
    return Path(np.asarray(centre) + radius * np.asarray(unit.vertices), unit.codes)


MOST_STROKES = 1000
"""Strokes of one line of the ground at most."""


def make_polygon(points: Array) -> Path:
    """Make the outline of a polygon with the corners (n, 2)."""
    return Path(
        np.concatenate([points, points[:1]]),
        [Path.MOVETO, *[Path.LINETO] * (len(points) - 1), Path.CLOSEPOLY],
    )


def make_strokes(lines: list[tuple[Array, Array]]) -> Path:
    """Make separate straight lines as one path."""
    codes = [Path.MOVETO, Path.LINETO] * len(lines)
    return Path(np.array([p for line in lines for p in line]).reshape(-1, 2), codes)


def make_hatched_line(a: Array, b: Array, down: Array, r: float) -> Path:
    """Make a ground line from a to b (2,), hatched on its side `down` (2,), a unit vector."""
    length = float(np.linalg.norm(b - a))
    along = (b - a) / max(length, 1e-300)
    count = max(2, min(round(length / (HATCH * r)), MOST_STROKES))
    foot = a + along * (np.arange(count) + 0.75)[:, None] * (length / count)
    slant = (down - along) * (HATCH * 0.85 * r)
    return make_strokes([(a, b), *[(p, p + slant) for p in foot]])


def make_ground_symbol(p: Array, down: Array, r: float) -> tuple[Path, Path]:
    """Make the triangle under a pivot at p (2,), and its hatched base line.

    `down` (2,) is a unit vector.
    """
    along = np.array([-down[1], down[0]])
    base = p + GROUND_HEIGHT * r * down
    corners = np.array([p, base - 1.55 * r * along, base + 1.55 * r * along])
    side = along if along[0] >= 0.0 else -along
    return make_polygon(corners), make_hatched_line(
        base - GROUND_HALF * r * side, base + GROUND_HALF * r * side, down, r
    )


def make_box(centre: Array, along: Array, half_length: float, half_height: float) -> Path:
    """Make the outline of a rectangle around a centre, its length along the unit vector `along`."""
    up = np.array([-along[1], along[0]])
    x = half_length * along
    y = half_height * up
    return make_polygon(np.array([centre - x - y, centre + x - y, centre + x + y, centre - x + y]))


def make_arc(
    centre: Array, radius: float, start: float, stop: float, head: float
) -> tuple[Array, Path]:
    """Make the points (n, 2) of a circular arc between two angles [rad], and its arrow head."""
    back = float(np.sign(stop - start)) * 0.8 * head / radius
    angles = np.linspace(start, stop - back, 40)
    line = centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    tip = centre + radius * np.array([np.cos(stop), np.sin(stop)])
    return line, make_arrow_head(tip, tip - line[-1], head)


def make_arrow_head(tip: Array, direction: Array, head: float) -> Path:
    """Make a slim triangle of length `head` with its tip in a direction (2,)."""
    along = direction / max(float(np.linalg.norm(direction)), 1e-300)
    side = np.array([-along[1], along[0]])
    base = tip - head * along
    return make_polygon(np.array([tip, base + 0.42 * head * side, base - 0.42 * head * side]))


def make_region_outline(region: SolutionRegion) -> Path:
    """Make the path of the closed curves around a region of a planar workspace."""
    codes: list[Any] = []
    corners: list[Array] = []
    for loop in region.loops:
        p = np.concatenate([sample_piece(piece) for piece in loop])
        corners.append(np.column_stack([np.real(p), np.imag(p)]))
        codes += [Path.MOVETO, *[Path.LINETO] * (len(p) - 2), Path.CLOSEPOLY]
    return Path(np.concatenate(corners), codes)


def sample_piece(piece: PlaneCurve) -> Array:
    """Sample points (k,) along a piece of a boundary, as complex numbers, densely enough to draw."""
    return piece.sample_points(FINE)
