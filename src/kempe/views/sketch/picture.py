"""What is drawn of a sketch: flat faces by the body that carries them, and labels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from kempe.spatial import Array
from kempe.views.drawing import style
from kempe.views.drawing.solids import find_hull, make_circle
from kempe.views.sketch.mechanism import list_bodies_of
from kempe.views.sketch.sketch import GROUND, Sketch, Slider

SIDES = 32
"""Corners of a round pin."""
RIM = 0.22
"""Width of the dark rim of bars and pins, in radii of a pin."""
HALO = 0.7
"""Width of the mark around what is chosen."""
RAIL = 16.0
"""Half-length of the line of a slider."""
SLOT = 9.0
"""Half-length of a slot in a bar."""
ARROW = 3.4
"""Radius of the arrow about the pin of the crank."""
AWAY = 3.3
"""Distance of a name from its pin."""
FARTHER = 4.4
"""The same for a pin in a block, beyond the arrow of a driven one."""
WAYS = 16
"""Directions from a pin in which its name may stand."""
CHOSEN = "#f2b134"
"""Colour of the mark around what is chosen."""

HALOS, SYMBOLS, RIMS, BARS, BLOCK_RIMS, BLOCKS, PIN_RIMS, PINS, ARROWS = range(1, 10)
"""Layers from back to front."""


class Face(NamedTuple):
    """A flat convex polygon: corners (n, 2), its layer, and its colour."""

    corners: Array
    layer: int
    colour: str


class Label(NamedTuple):
    """A text at a place (2,), carried by a body."""

    body: str
    at: Array
    text: str


def draw_faces(sketch: Sketch, r: float, chosen: Iterable[str] = ()) -> dict[str, list[Face]]:
    """Draw a sketch with pins of radius `r` [m]: the faces that each body carries, as drawn.

    `chosen` are the names of pins and bars that are marked.
    """
    marked = {*chosen}
    out = dict[str, list[Face]]()
    place = {pin: np.array(at) for pin, at in sketch.pins.items()}
    crank = sketch.crank
    for k, (bar, pins) in enumerate(sketch.bars.items(), 1):
        points = np.array([place[pin] for pin in pins])
        driven = crank is not None and crank.bar == bar
        rim = (
            style.DRIVER
            if driven
            else style.mix_colours(style.choose_link_colour(k), style.INK, 0.6)
        )
        wide = style.BAR * r
        faces = out.setdefault(bar, [])
        faces.append(Face(grow(points, wide + RIM * r), RIMS, rim))
        faces.append(Face(grow(points, wide), BARS, style.choose_link_colour(k)))
        if bar in marked:
            faces.append(Face(grow(points, wide + HALO * r), HALOS, CHOSEN))
    for pin, slider in sketch.sliders.items():
        body = list_bodies_of(sketch, pin)[0]
        out.setdefault(slider.carrier, []).extend(_draw_rail(place[pin], slider, r))
        along, up = _list_axes(slider.angle)
        half = np.array(style.BLOCK) * r
        for grown, layer, colour in ((RIM * r, BLOCK_RIMS, style.INK), (0.0, BLOCKS, style.FAINT)):
            x, y = (half + grown)[:, None] * np.array([along, up])
            corners = place[pin] + np.array([-x - y, x - y, x + y, y - x])
            out.setdefault(body, []).append(Face(corners, layer, colour))
    for pin, at in place.items():
        bodies = list_bodies_of(sketch, pin)
        body = bodies[0] if bodies else GROUND
        faces = out.setdefault(body, [])
        if pin in sketch.grounded:
            faces += _draw_ground(at, r)
        faces.append(Face(grow(at[None], r), PIN_RIMS, style.INK))
        faces.append(Face(grow(at[None], (1.0 - 2.0 * RIM) * r), PINS, style.PAPER))
        if pin in marked:
            faces.append(Face(grow(at[None], r + HALO * r), RIMS, CHOSEN))
    if crank is not None:
        out.setdefault(GROUND, []).extend(_draw_drive(sketch, r))
    return out


def grow(points: Array, radius: float) -> Array:
    """Return the corners of the region within a radius of the hull of points (n, 2)."""
    circle, _ = make_circle(SIDES)
    return find_hull((points[:, None] + radius * circle).reshape(-1, 2))


def _list_axes(angle: float) -> tuple[Array, Array]:
    """Return the unit vectors (2,) along a line and across it."""
    along = np.array([math.cos(angle), math.sin(angle)])
    return along, np.array([-along[1], along[0]])


def _draw_stroke(a: Array, b: Array, wide: float, layer: int, colour: str) -> Face:
    """Draw a straight line from a to b (2,)."""
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-300)
    side = 0.5 * wide * np.array([-along[1], along[0]])
    return Face(np.array([a - side, b - side, b + side, a + side]), layer, colour)


def _draw_hatched_line(a: Array, b: Array, down: Array, r: float) -> list[Face]:
    """Draw a ground line from a to b (2,), hatched on its side `down` (2,)."""
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    count = max(2, round(length / (style.HATCH * r)))
    feet = a + along * (np.arange(count) + 0.75)[:, None] * (length / count)
    slant = 0.85 * style.HATCH * r * (down - along)
    strokes = [(a, b), *((foot, foot + slant) for foot in feet)]
    return [_draw_stroke(p, q, 0.22 * r, SYMBOLS, style.GROUND) for p, q in strokes]


def _draw_ground(at: Array, r: float) -> list[Face]:
    """Draw the triangle under a grounded pin, on a hatched line."""
    base = at - [0.0, style.GROUND_HEIGHT * r]
    half = np.array([1.55 * r, 0.0])
    wide = np.array([style.GROUND_HALF * r, 0.0])
    corners = np.array([base - half, base + half, at])
    down = np.array([0.0, -1.0])
    triangle = Face(corners, SYMBOLS, style.FAINT)
    sides = [
        _draw_stroke(a, b, 0.22 * r, SYMBOLS, style.GROUND)
        for a, b in itertools.pairwise((corners[0], at, corners[1]))
    ]
    return [triangle, *sides, *_draw_hatched_line(base - wide, base + wide, down, r)]


def _draw_rail(at: Array, slider: Slider, r: float) -> list[Face]:
    """Draw the line on which a pin slides: hatched on the ground, a slot on a bar."""
    along, up = _list_axes(slider.angle)
    if slider.carrier != GROUND:
        a, b = at - SLOT * r * along, at + SLOT * r * along
        return [_draw_stroke(a, b, 0.5 * r, BLOCK_RIMS, style.INK)]
    down = -up if up[1] >= 0.0 else up
    low = at + (style.BLOCK[1] + RIM) * r * down
    return _draw_hatched_line(low - RAIL * r * along, low + RAIL * r * along, down, r)


def _draw_drive(sketch: Sketch, r: float) -> list[Face]:
    """Draw the arrow of the crank: about its pin, or along the line of its slider."""
    assert sketch.crank is not None
    at = np.array(sketch.pins[sketch.crank.pin])
    if sketch.crank.bar:
        angles = np.linspace(0.35 * np.pi, 1.2 * np.pi, 30)
        line = at + ARROW * r * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    else:
        along, up = _list_axes(sketch.sliders[sketch.crank.pin].angle)
        line = at + r * (2.2 * up + np.array([-3.0, 2.2])[:, None] * along)
    strokes = [
        _draw_stroke(a, b, 0.32 * r, ARROWS, style.DRIVER) for a, b in itertools.pairwise(line)
    ]
    way = (line[-1] - line[-2]) / float(np.linalg.norm(line[-1] - line[-2]))
    side = np.array([-way[1], way[0]])
    tip = line[-1] + 1.5 * r * way
    head = np.array([tip, line[-1] + 0.75 * r * side, line[-1] - 0.75 * r * side])
    return [*strokes, Face(head, ARROWS, style.DRIVER)]


def triangulate(faces: list[Face], r: float) -> tuple[Array, np.ndarray]:
    """Cut faces into triangles: corners (3 m, 3) and their colours, bytes (3 m, 4)."""
    corners = list[Array]()
    colours = list[np.ndarray]()
    for face in faces:
        fan = np.array([[0, k, k + 1] for k in range(1, len(face.corners) - 1)]).ravel()
        flat = face.corners[fan]
        a, b, c = face.corners[:3]
        turned = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0] < 0.0
        flat = flat.reshape(-1, 3, 2)[:, ::-1].reshape(-1, 2) if turned else flat
        height = np.full((len(flat), 1), face.layer * style.THICK * r)
        corners.append(np.hstack([flat, height]))
        red, green, blue = (int(face.colour[k : k + 2], 16) for k in (1, 3, 5))
        colours.append(np.tile(np.array([red, green, blue, 255], dtype=np.uint8), (len(flat), 1)))
    return np.concatenate(corners), np.concatenate(colours)


# ---- labels


def place_labels(sketch: Sketch, r: float, lengths: bool = False) -> list[Label]:
    """Place the names of pins where no bar and no symbol is; with `lengths` also those of bars."""
    out = list[Label]()
    for pin, at in sketch.pins.items():
        bodies = list_bodies_of(sketch, pin)
        way = _find_free_direction(sketch, pin)
        far = (FARTHER if pin in sketch.sliders else AWAY) * r
        place = np.array(at) + far * np.array([math.cos(way), math.sin(way)])
        out.append(Label(bodies[0] if bodies else GROUND, place, pin))
    for bar, pins in sketch.bars.items() if lengths else ():
        sides = list(itertools.combinations(pins, 2)) if len(pins) <= 3 else [pins[:2]]
        for a, b in sides:
            middle = 0.5 * (np.array(sketch.pins[a]) + np.array(sketch.pins[b]))
            out.append(Label(bar, middle, f"{sketch.measure_distance(a, b):.4g}"))
    return out


def _find_free_direction(sketch: Sketch, pin: str) -> float:
    """Find the direction from a pin that is farthest from bars, ground and slider lines [rad]."""
    x, y = sketch.pins[pin]
    taken = [
        math.atan2(v - y, u - x)
        for bar in sketch.list_bars_of(pin)
        for u, v in (sketch.pins[p] for p in sketch.bars[bar] if p != pin)
    ]
    if pin in sketch.grounded:
        taken += [-0.5 * math.pi, -0.75 * math.pi, -0.25 * math.pi]
    if (slider := sketch.sliders.get(pin)) is not None:
        down = slider.angle + (-0.5 if math.cos(slider.angle) >= 0.0 else 0.5) * math.pi
        taken += [slider.angle, slider.angle + math.pi, down]
    crank = sketch.crank
    if crank is not None and crank.pin == pin:
        taken += [0.5 * math.pi, math.pi] if crank.bar else []
    ways = [2.0 * math.pi * (k + 2) / WAYS for k in range(WAYS)]
    if not taken:
        return ways[0]
    return max(ways, key=lambda way: round(min(1.0 - math.cos(way - t) for t in taken), 6))
