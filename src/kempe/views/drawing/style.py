"""Colours, sizes and layers of the drawings, in one place. Lengths are in pin radii unless they say
otherwise.
"""

from __future__ import annotations

from typing import Any

INK = "#22303c"
GROUND = "#59646e"
PAPER = "#ffffff"
FAINT = "#b8c0c7"
DRIVER = "#c2410c"
MOTION = "#1d4e89"
"""Arrows of the freedoms of joints."""
OPEN = "#d11149"
"""Loops that are not closed."""
WRONG = 1e-6
"""Part of the size of the drawing beyond which joints and rods count as not closed."""

LINKS = (
    "#4c78a8",
    "#dd8452",
    "#5aa469",
    "#b5648f",
    "#8172b3",
    "#c4a13a",
    "#4aa3b0",
    "#a3715c",
    "#7d8ca3",
    "#cc6677",
    "#6b9a2f",
    "#9a7fd1",
)
AXES = ("#c0392b", "#2e8b57", "#2b5fb3")
"""Colours of the axes x, y, z of frames."""
CURVES = ("#c1272d", "#1b6fb5", "#2c8c45", "#8e44ad", "#d9820a", "#0f8b8d", "#8b5e3c", "#5b6770")

DASHES: tuple[Any, ...] = (
    "-", (0, (5, 2)), (0, (2, 2)), (0, (6, 2, 1, 2)), (0, (11, 3)), (0, (1, 1.6)), (0, (6, 2, 1, 2, 1, 2)),
    (0, (9, 2, 3, 2)),
)  # fmt: skip
"""Lines of configurations that lie over one another: they differ in grey, too."""

FONT = 9.0
"""Size of labels in points."""

GHOSTS, POLYGONS, RAILS, BARS, BLOCKS, CURVE, PINS, POINTS, ARROWS, TEXT = range(1, 11)
"""Layers from back to front."""

BAR = 0.68
"""Half-width of a bar."""
BLOCK = (2.5, 1.45)
"""Half-length and half-height of a sliding block."""
GROUND_HEIGHT = 2.7
GROUND_HALF = 2.3
"""Height of the triangle under a ground pivot, half-length of its hatched base line."""
MARK = 5.0
"""Length of the axes of a frame that is marked."""
HATCH = 0.95
"""Distance of the strokes of a hatching, and their depth."""
THICK = 0.15
"""Height between two layers of a planar drawing, in radii of a pin."""
POINT = 0.085
"""Width of a line of one point, in radii of a pin."""


def choose_link_colour(number: int) -> str:
    """Return the colour of the link with this number; 0 is the ground."""
    return GROUND if number == 0 else LINKS[(number - 1) % len(LINKS)]


def choose_curve_colour(number: int) -> str:
    """Return the colour of the curve with this number, counted from 0."""
    return CURVES[number % len(CURVES)]


def choose_configuration_colour(number: int) -> str:
    """Return the colour of one of several configurations in a picture; 0 is the first."""
    return INK if number == 0 else choose_curve_colour(number)


def mix_colours(colour: str, other: str, part: float) -> str:
    """Mix a `part` (0 to 1) of another colour into a colour; returns '#rrggbb'."""
    a, b = (tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in (colour, other))
    return "#" + "".join(f"{round(x + (y - x) * part):02x}" for x, y in zip(a, b, strict=True))
