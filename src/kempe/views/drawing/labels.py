"""Where to write labels so that they cover nothing: candidate places around a point, the least
covered one wins.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from matplotlib.textpath import TextPath

from kempe.spatial import Array

ANGLES = np.deg2rad(
    [45, 135, -45, -135, 90, 0, 180, -90, 22.5, 67.5, 112.5, 157.5, -22.5, -67.5, -112.5, -157.5]
)
RINGS = (1.0, 1.6, 2.4, 3.5)
"""Distances from the point that are tried, in clearances."""


MOST = 32
WIDEST = 44
"""Letters of one name in a picture, and of one line of several."""


def shorten_label(text: str) -> str:
    """Shorten a label: too long names keep both ends, several names stand on several lines."""
    if "$" in text or len(text) <= MOST:
        return text
    lines: list[str] = []
    for given in text.split("\n"):
        names = [
            x if len(x) <= MOST else f"{x[: MOST // 2 - 1]}…{x[-MOST // 2 :]}"
            for x in given.split(", ")
        ]
        lines.append(names[0])
        for name in names[1:]:
            if len(lines[-1]) + len(name) + 2 <= WIDEST or not name:
                lines[-1] += f", {name}"
            else:
                lines[-1] += ","
                lines.append(name)
    return "\n".join(lines)


def fit_sentence(sentence: str) -> str:
    """Shorten the words of a sentence to fit a narrow panel; too long words keep both ends."""
    return " ".join(shorten_label(word) for word in sentence.split(" "))


@lru_cache(maxsize=4096)
def measure_text(text: str, points: float, bold: bool = False) -> tuple[float, float]:
    """Measure the width and height of a text in points (1/72 inch) at a font size."""
    lines = text.split("\n")
    wide = max(float(TextPath((0.0, 0.0), line, size=points).get_extents().width) for line in lines)
    high = (0.95 + 1.2 * (len(lines) - 1)) * points
    return max(wide * (1.15 if bold else 1.0), 0.4 * points) + 0.15 * points, high


@dataclass
class Obstacles:
    """What is on the sheet already: segments with a radius and a weight, and boxes of labels."""

    segments: list[tuple[float, float, float, float, float, float]] = field(
        default_factory=list[tuple[float, float, float, float, float, float]]
    )
    boxes: list[tuple[float, float, float, float]] = field(
        default_factory=list[tuple[float, float, float, float]]
    )
    bounds: tuple[Array, Array] | None = None
    """Lower left and upper right corner (2,) of the sheet, which labels should not leave."""
    _packed: Array = field(default_factory=lambda: np.zeros((0, 6)), repr=False)
    """The segments as an array, as many as there were when it was made."""

    def add_segment(self, a: Array, b: Array, radius: float, weight: float = 1.0) -> None:
        """Add a capsule from a (2,) to b (2,) as an obstacle of labels."""
        self.segments.append((float(a[0]), float(a[1]), float(b[0]), float(b[1]), radius, weight))

    def add_line(
        self, points: Array, radius: float, weight: float = 1.0, pieces: int = 120
    ) -> None:
        """Add a polyline (n, 2), thinned to some `pieces`, as an obstacle of labels."""
        points = points[np.isfinite(points).all(axis=1)]
        points = points[:: max(1, len(points) // pieces)]
        for a, b in zip(points[:-1], points[1:], strict=True):
            self.add_segment(a, b, radius, weight)

    def find_covering_weights(self, points: Array) -> Array:
        """Compute for points (..., 2) the weight (...) of the heaviest obstacle that covers each."""
        if points.ndim > 2:  # one group after the other: each has few segments near it
            return np.array([self.find_covering_weights(group) for group in points]).reshape(
                points.shape[:-1]
            )
        s = self.select_near_segments(points.reshape(-1, 2))
        if not len(s):
            return np.zeros(points.shape[:-1])
        a = s[:, 0:2]
        d = s[:, 2:4] - s[:, 0:2]
        length2 = np.maximum((d * d).sum(axis=1), 1e-300)
        rel = points[..., None, :] - a
        t = np.clip((rel * d).sum(axis=-1) / length2, 0.0, 1.0)
        gap = np.linalg.norm(rel - t[..., None] * d, axis=-1)
        return (np.where(gap < s[:, 4], s[:, 5], 0.0)).max(axis=-1)

    def select_near_segments(self, points: Array) -> Array:
        """Select the obstacles (k, 6) that can cover any of the points (n, 2), by bounding boxes."""
        if len(self._packed) != len(self.segments):
            self._packed = np.array(self.segments)
        s = self._packed
        if not len(s) or not len(points):
            return s[:0]
        low = np.minimum(s[:, 0:2], s[:, 2:4]) - s[:, 4:5]
        high = np.maximum(s[:, 0:2], s[:, 2:4]) + s[:, 4:5]
        return s[((low <= points.max(axis=0)) & (high >= points.min(axis=0))).all(axis=1)]

    def find_free_place(
        self, p: Array, size: tuple[float, float], clearance: float, outward: Array
    ) -> Array:
        """Find the centre (2,) of a free box near p (2,) for a label, and add it as an obstacle.

        `outward` (2,) is the direction that is taken where all are equally free.
        """
        rings = np.repeat(RINGS, len(ANGLES))
        direction = np.tile(np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), (len(RINGS), 1))
        half = 0.5 * np.array(size)
        reach = clearance * rings + np.minimum(
            half[0] / np.maximum(np.abs(direction[:, 0]), 1e-9),
            half[1] / np.maximum(np.abs(direction[:, 1]), 1e-9),
        )
        centres = p + direction * reach[:, None]
        grid = (
            np.stack(np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 4)), axis=-1).reshape(
                -1, 2
            )
            * half
        )
        cost = self.find_covering_weights(centres[:, None, :] + grid).sum(axis=1)
        for x0, y0, x1, y1 in self.boxes:
            across = np.minimum(centres[:, 0] + half[0], x1) - np.maximum(
                centres[:, 0] - half[0], x0
            )
            along = np.minimum(centres[:, 1] + half[1], y1) - np.maximum(
                centres[:, 1] - half[1], y0
            )
            part = np.clip(across, 0, None) * np.clip(along, 0, None) / (4 * half[0] * half[1])
            cost = cost + 60.0 * part + 15.0 * (part > 0.0)
        if self.bounds is not None:
            out = np.maximum(self.bounds[0] - (centres - half), 0.0) + np.maximum(
                centres + half - self.bounds[1], 0.0
            )
            cost = cost + 60.0 * (out / (2 * half)).sum(axis=1)
        cost = cost + 1.2 * (rings - 1.0) - 0.35 * direction @ outward - 0.05 * direction[:, 1]
        best = centres[int(np.argmin(cost))]
        self.boxes.append(
            (best[0] - half[0], best[1] - half[1], best[0] + half[0], best[1] + half[1])
        )
        return best
