"""Small solids of flat faces, shaded by their normals, for drawings in space: tubes, balls, boxes,
plates, cones.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from kempe import spatial
from kempe.numerics.rank import Spectrum
from kempe.spatial import Array

LIGHT = np.array([0.35, -0.55, 0.76])
"""Direction of the light; faces turned away from it keep `SHADE` of their colour."""
SHADE = 0.66
SIDES = 12
"""Faces around a tube."""


@dataclass
class Solids:
    """Solids as faces (k, 3) with colours; `named` has the numbers of the faces of each name."""

    faces: list[Array] = field(default_factory=list[Array])
    colours: list[tuple[float, float, float, float]] = field(
        default_factory=list[tuple[float, float, float, float]]
    )
    edges: list[tuple[float, float, float, float]] = field(
        default_factory=list[tuple[float, float, float, float]]
    )
    named: dict[str, list[int]] = field(default_factory=dict[str, list[int]])
    by_depth: bool = True
    """Whether what is drawn sorts faces by depth, where parts inside others would be seen."""
    sides: int = SIDES
    """Faces around a tube or ball."""

    def add_face(
        self,
        name: str,
        corners: Array,
        normal: Array,
        colour: str,
        alpha: float = 1.0,
        edge: str = "",
    ) -> None:
        """Add a flat convex face with its outward normal (3,); `edge` is the colour of its outline.

        Faces are kept as quadrangles: matplotlib pads others with memory that it never wrote.
        """
        light = abs(float(normal @ LIGHT)) if alpha < 1.0 else max(float(normal @ LIGHT), 0.0)
        red, green, blue = (x * (SHADE + (1.0 - SHADE) * light) for x in parse_colour(colour))
        if len(corners) == 3:
            corners = corners[[0, 1, 2, 2]]
        for k in range(1, len(corners) - 2, 2):
            self.named.setdefault(name, []).append(len(self.faces))
            self.faces.append(corners[[0, k, k + 1, k + 2]])
            self.colours.append((red, green, blue, alpha))
            line = parse_colour(edge) if edge and len(corners) == 4 else (red, green, blue)
            self.edges.append((*line, 1.0 if alpha == 1.0 else 0.8 if edge else 0.0))
        if len(corners) > 4 and len(corners) % 2:  # the last triangle of the fan
            self.add_face(name, corners[[0, -2, -1]], normal, colour, alpha)

    def add_faces(self, name: str, corners: Array, normals: Array, colour: str) -> None:
        """Add the faces of a solid: corners (k, n, 3) with outward normals (k, 3)."""
        for face, normal in zip(corners, normals, strict=True):
            self.add_face(name, face, normal, colour)

    def add_tube(
        self,
        name: str,
        a: Array,
        b: Array,
        radius: float,
        colour: str,
        pieces: int = 0,
        caps: bool = True,
        edge: str = "",
        sides: int = 0,
        end_radius: float | None = None,
    ) -> None:
        """Add a tube from a to b (3,), cut into `pieces` along its length; with `end_radius` a
        cone.
        """
        length = float(np.linalg.norm(b - a))
        if length < 1e-12:
            return
        X = spatial.align_z((b - a) / length)
        round_, middle = make_circle(sides or self.sides) @ X[:, :2].T
        pieces = pieces or (int(np.clip(length / (6 * radius), 1, 16)) if self.by_depth else 1)
        thinner = 0.0 if end_radius is None else radius - end_radius
        rings = [
            a + (b - a) * t + (radius - thinner * t) * round_
            for t in (k / pieces for k in range(pieces + 1))
        ]
        for low, high in itertools.pairwise(rings):
            self._add_sides(name, low, high, middle, colour)
        if caps:
            for ring, sign in ((rings[0], -1.0), (rings[-1], 1.0)):
                self.add_face(name, ring, sign * X[:, 2], colour)
            if edge:
                along = 0.14 * radius * X[:, 2]
                wider = 1.02 * radius * round_
                for low in (a + wider, b - along + wider):
                    self._add_sides(name, low, low + along, middle, edge)

    def _add_sides(self, name: str, low: Array, high: Array, normals: Array, colour: str) -> None:
        """Add the faces between two rings (n, 3), with outward normals (n, 3)."""
        n = len(low)
        after = [*range(1, n), 0]
        corners = np.concatenate([low, low[after], high[after], high], axis=1)
        self.add_faces(name, corners.reshape(n, 4, 3), normals, colour)

    def add_ball(self, name: str, centre: Array, radius: float, colour: str) -> None:
        """Add a sphere."""
        lat = np.linspace(-np.pi / 2, np.pi / 2, self.sides * 2 // 3 + 1)
        self._add_bands(name, centre, radius, _make_sphere(lat, self.sides), colour)

    def add_bowl(self, name: str, centre: Array, radius: float, way: Array, colour: str) -> None:
        """Add a hollow hemisphere on the side of the direction `way` (3,)."""
        lat = np.deg2rad(np.linspace(90.0, 5.0, self.sides // 3 + 1))
        p = _make_sphere(lat, self.sides) @ spatial.align_z(way).T
        self._add_bands(name, centre, radius, p, colour)

    def _add_bands(self, name: str, centre: Array, radius: float, p: Array, colour: str) -> None:
        """Add a part of a sphere from points (m, n, 3) of the unit sphere, by latitude and
        longitude.
        """
        low, high = p[:-1], p[1:]
        corners = np.stack([low[:, :-1], low[:, 1:], high[:, 1:], high[:, :-1]], axis=2)
        corners = corners.reshape(-1, 4, 3)
        normals = corners.mean(axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        self.add_faces(name, centre + radius * corners, normals, colour)

    def add_box(self, name: str, X: Array, half: Array, colour: str, edge: str = "") -> None:
        """Add a box around the origin of the pose X (4, 4), with half-lengths (3,) along its axes."""
        for axis in range(3):
            for sign in (-1.0, 1.0):
                u = (axis + 1) % 3
                v = (axis + 2) % 3
                corners = np.zeros((4, 3))
                corners[:, axis] = sign
                corners[:, u] = (-1, 1, 1, -1)
                corners[:, v] = (-1, -1, 1, 1)
                self.add_face(
                    name,
                    X[:3, 3] + (corners * half) @ X[:3, :3].T,
                    sign * X[:3, axis],
                    colour,
                    edge=edge,
                )

    def add_plate(
        self, name: str, corners: Array, colour: str, alpha: float, edge: str = ""
    ) -> None:
        """Add a flat polygon without thickness, corners (n, 3) in order."""
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        self.add_face(
            name, corners, normal / max(float(np.linalg.norm(normal)), 1e-300), colour, alpha, edge
        )

    def add_arrow(self, name: str, line: Array, radius: float, colour: str) -> None:
        """Add a bent arrow along points (n, 3) with its head at the last point."""
        for a, b in zip(line[:-2], line[1:-1], strict=True):
            self.add_tube(name, a, b, radius, colour, pieces=1, caps=False, sides=6)
        tip = line[-1] - line[-2]
        tip = tip / max(float(np.linalg.norm(tip)), 1e-300)
        self.add_tube(
            name,
            line[-2],
            line[-2] + 6.0 * radius * tip,
            2.6 * radius,
            colour,
            pieces=1,
            sides=8,
            end_radius=0.0,
        )


# ---- pieces, for pages


class DrawnPiece(NamedTuple):
    """Triangles (m, 3) over corners (n, 3) with a name, of one colour (4,): red, green, blue, alpha
    from 0 to 1.
    """

    name: str
    corners: Array
    triangles: np.ndarray
    colour: tuple[float, float, float, float]


@dataclass
class SolidRecord(Solids):
    """Solids as pieces, without light: the page has its own."""

    pieces: list[DrawnPiece] = field(default_factory=list[DrawnPiece])
    by_depth: bool = False
    sides: int = 24

    def add_face(
        self,
        name: str,
        corners: Array,
        normal: Array,
        colour: str,
        alpha: float = 1.0,
        edge: str = "",
    ) -> None:
        """Add a flat convex face with its outward normal, seen from both sides where it can be
        looked through.
        """
        self._add_piece(name, corners[None], normal[None], colour, alpha)

    def add_faces(self, name: str, corners: Array, normals: Array, colour: str) -> None:
        """Add solid faces, corners (k, n, 3) with outward normals (k, 3), as one piece."""
        self._add_piece(name, corners, normals, colour, 1.0)

    def _add_piece(
        self, name: str, corners: Array, normals: Array, colour: str, alpha: float
    ) -> None:
        k, n, _ = corners.shape
        (a, b, c) = (corners[:, 1] - corners[:, 0]).T
        (d, e, f) = (corners[:, -1] - corners[:, 0]).T
        x, y, z = normals.T
        # the cross product by hand, for np.cross is slow
        turned = (b * f - c * e) * x + (c * d - a * f) * y + (a * e - b * d) * z < 0.0
        fans = make_fans(k, n)
        triangles = np.where(turned[:, None, None], fans[..., ::-1], fans)
        if alpha < 1.0:  # seen from both sides
            triangles = np.concatenate([triangles, triangles[..., ::-1]], axis=1)
        self.pieces.append(
            DrawnPiece(
                name,
                corners.reshape(-1, 3),
                triangles.reshape(-1, 3),
                (*parse_colour(colour), alpha),
            )
        )


def _make_sphere(latitudes: Array, sides: int) -> Array:
    """Make points (m, sides + 1, 3) of the unit sphere at latitudes (m,) [rad]."""
    longitudes = np.arange(sides + 1) * (2 * np.pi / sides)
    return np.stack(
        [
            np.outer(np.cos(latitudes), np.cos(longitudes)),
            np.outer(np.cos(latitudes), np.sin(longitudes)),
            np.outer(np.sin(latitudes), np.ones(sides + 1)),
        ],
        axis=-1,
    )


@cache
def make_circle(sides: int) -> Array:
    """Make corners and outward normals of a regular polygon about the unit circle (2, sides, 2)."""
    angles = np.arange(sides) * (2 * np.pi / sides)
    angles = np.stack([angles, angles + np.pi / sides])
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


@cache
def make_fan(n: int) -> np.ndarray:
    """Triangles (n - 2, 3) of a convex polygon with n corners."""
    return make_fans(1, n)[0]


@cache
def make_fans(count: int, n: int) -> np.ndarray:
    """Triangles (count, n - 2, 3) of convex polygons with n corners each, one after the other."""
    k = np.arange(1, n - 1)
    fan = np.stack([np.zeros_like(k), k, k + 1], axis=1)
    return fan + n * np.arange(count)[:, None, None]


@cache
def parse_colour(colour: str) -> tuple[float, float, float]:
    """Convert a colour '#rrggbb' to red, green and blue from 0 to 1."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


def find_hull(points: Array) -> Array:
    """Find the corners (k, 2) of the convex hull of points (n, 2), counterclockwise (Andrew's monotone
    chain, 1979).
    """
    if len(points) < 3:
        return points
    flat = 1e-12 * max(float(np.ptp(points, axis=0).max()), 1e-300) ** 2
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]

    def find_half_hull(sequence: Array) -> list[Array]:
        out: list[Array] = []
        for p in sequence:
            while len(out) > 1:
                (a, b), (c, d) = out[-1] - out[-2], p - out[-2]
                if a * d - b * c > flat:
                    break
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(find_half_hull(ordered) + find_half_hull(ordered[::-1]))


def find_flat_hull(points: Array, tolerance: float) -> list[int] | None:
    """Find the convex hull of points (n, 3) in a common plane: their numbers (k,) in order, else
    None.
    """
    middle = points.mean(axis=0)
    _, size, axes = Spectrum(points - middle).thin_decomposition
    if len(points) < 3 or size[1] < tolerance or (len(size) > 2 and size[2] > tolerance):
        return None
    p = (points - middle) @ axes[:2].T
    corners = find_hull(p)
    return [int(np.argmin(np.linalg.norm(p - c, axis=1))) for c in corners]
