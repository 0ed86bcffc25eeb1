"""Mechanisms of the literature and of proofs, with their counts, ranks and true degrees of freedom."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import numpy as np
from scipy.spatial.transform import Rotation
from world_mechanisms import World, X, Y, Z, framework, loop, on_rods, unit

from kempe.mobility.answer import Mobility
from kempe.mobility.mobility import mobility
from kempe.spatial import exp_se3

FAR = exp_se3(np.array([3.0, -1.0, 2.0, 0.4, -0.7, 0.5]))
FAR_FLAT = exp_se3(np.array([3.0, -1.0, 0.0, 0.0, 0.0, 0.6]))


def look(world: World, scale: float = 1.0, moved: bool = False, **options) -> Mobility:
    system = world.build(scale, (FAR if world.dim == 3 else FAR_FLAT) if moved else None)
    return mobility(system, system.neutral, **options)


def around(*angles: float, radius: float = 1.0, z: float = 0.0) -> list[tuple[float, float, float]]:
    return [(radius * cos(a), radius * sin(a), z) for a in angles]


# ---- known degrees of freedom

OCTAHEDRON = [
    (i, k) for i in range(6) for k in range(i + 1, 6) if (i, k) not in ((0, 1), (2, 3), (4, 5))
]
A, B, C = np.random.default_rng(5).normal(size=(3, 3))
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
MIRROR = np.diag([1.0, 1.0, -1.0])
SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.4, 0.8, 0.0), (0.4, 0.8, 0.0)]
ON_AXES = [(1, 0), (-1.7, 0), (0.6, 0), (0, 1.2), (0, -0.8), (0, 2.1)]
HEXAGON = np.array(around(0.1, 0.9, 2.2, 3.0, 4.3, 5.1))
TILTED = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
BENT = np.array(
    [(1, 0.1, 0), (0.7, 0.9, 0), (-0.5, 1.1, 0), (-1.2, 0.2, 0), (-0.3, -1, 0), (0.6, -0.7, 0)]
)


def bipartite(m: int, n: int) -> list[tuple[int, int]]:
    return [(i, m + k) for i in range(m) for k in range(n)]


def helical(pitches: list[float]) -> World:
    return loop(
        "four screws",
        [("helical", p, Z, {"pitch": h}) for p, h in zip(SQUARE, pitches, strict=True)],
    )


def trammel(n: int) -> World:
    """A point of a circle that rolls in one twice as large moves along a diameter (Cardano): any
    number of slots.
    """
    w = World("trammel", 2)
    w.joint("free", "ground", "rod")
    for k in range(n):
        e = np.array([cos(0.3 + pi * k / n), sin(0.3 + pi * k / n)])
        w.line("ground", "rod", (np.array([cos(0.7), sin(0.7)]) @ e) * e, e)
    return w


def hoberman(n: int, inner: float = 1.4, outer: float = 2.3) -> World:
    """A ring of n pairs of angulated bars (Hoberman, 1990); the first bar is the ground."""
    w = World("ring", 2)
    half = pi / n
    middle = (inner + outer) / 2 / cos(half)

    def ray(k: int, r: float) -> tuple[float, float]:
        return r * cos(k * half), r * sin(k * half)

    for i in range(n):
        j = (i + 1) % n
        a = "ground" if i == 0 else f"a{i}"
        b = "ground" if j == 0 else f"a{j}"
        w.turn(a, f"b{i}", ray(2 * i, middle))
        w.turn(a, f"b{j}", ray(2 * i + 1, outer))
        w.turn(f"b{i}", b, ray(2 * i + 1, inner))
    return w


def four_upu() -> World:
    """Legs between crosses whose outer axes are parallel: all motions but two turns (Zhao and
    Huang, 2000).
    """
    w = World("4-UPU")
    base = [(2, 0, 0), (0, 2, 0), (-2, 0.3, 0), (0.1, -2, 0)]
    top = [(0.6, 0.1), (0.2, 0.7), (-0.5, 0.1), (0.1, -0.6)]
    for i, (a, b) in enumerate(zip(base, top, strict=True)):
        a = np.array(a, dtype=float)
        b = np.array([*b, 1.4])
        across = unit(np.cross(Z, b - a))
        w.cross("ground", f"a{i}", a, Z, across)
        w.slide(f"a{i}", f"b{i}", b - a, a, name=f"leg{i}")
        w.cross(f"b{i}", "top", b, across, Z)
    return w


def cardan_shafts(first: float, second: float) -> World:
    w = World("two Cardan joints")
    d = np.array([sin(first), 0, cos(first)])
    e = np.array([sin(first + second), 0, cos(first + second)])
    w.turn("ground", "in", -Z, Z)
    w.cross("in", "mid", np.zeros(3), Y, np.cross(Y, d))
    w.cross("mid", "out", d, np.cross(Y, d), Y)
    w.turn("out", "ground", d + e, e)
    return w


def miura(nx: int, ny: int, fold: float) -> World:
    """Panels of Miura's fold, all alike; flat at 0. The first panel is the ground."""
    w = World("Miura")
    corner = 1.0
    deep = sqrt(1 + cos(fold) ** 2 * np.tan(corner) ** 2)
    step = cos(fold) * np.tan(corner) / deep
    shift = 1 / deep
    high = sin(fold) * sin(corner)
    long = sqrt(1 - (sin(fold) * sin(corner)) ** 2)

    def at(i: int, j: int) -> np.ndarray:
        return np.array([i * step, j * long + (i % 2) * shift, (j % 2) * high])

    def panel(i: int, j: int) -> str:
        return f"p{i}{j}" if (i, j) != (0, 0) else "ground"

    for i in range(nx):
        for j in range(ny):
            if i + 1 < nx:
                w.turn(panel(i, j), panel(i + 1, j), at(i + 1, j), at(i + 1, j + 1) - at(i + 1, j))
            if j + 1 < ny:
                w.turn(panel(i, j), panel(i, j + 1), at(i, j + 1), at(i + 1, j + 1) - at(i, j + 1))
    return w


def griffis_duffy() -> World:
    """Corners of each triangle under middles of the other's sides (Griffis, Duffy, 1993; Husty,
    Karger, 2000).
    """
    corners = np.array([(0, 0, 0), (1, 0, 0), (0.5, sqrt(3) / 2, 0)])
    middles = (corners.sum(axis=0) - corners) / 2
    top = np.concatenate([middles, corners]) - corners.mean(axis=0)
    return on_rods(
        "Griffis-Duffy", np.concatenate([corners, middles]), top @ TILTED.T + [0.5, 0.3, 1.0]
    )


def prism(turn: float) -> World:
    bottom = around(0, 2 * pi / 3, 4 * pi / 3)
    top = around(turn, turn + 2 * pi / 3, turn + 4 * pi / 3, z=1.0)
    edges = [
        (3, 4),
        (4, 5),
        (3, 5),
        *((i, 3 + i) for i in range(3)),
        *(((i + 1) % 3, 3 + i) for i in range(3)),
    ]
    return framework("twisted prism", bottom + top, edges, pinned=(0, 1, 2))


TWO_TRIANGLES = [(i, k) for i in (0, 1) for k in range(2, 8)] + [
    (2, 3),
    (3, 4),
    (2, 4),
    (5, 6),
    (6, 7),
    (5, 7),
]
ELLIPSE = [(2 * cos(t), sin(t)) for t in (0.2, 1.5, 3.9, 0.9, 2.6, 5.1)]
SPREAD = np.random.default_rng(8).normal(size=(10, 3))
ELLIPSOID = SPREAD / np.linalg.norm(SPREAD, axis=1, keepdims=True) * [1.0, 1.5, 0.7]
RECTANGLES = [(s * a, t * b) for a, b in ((1.0, 0.4), (0.5, 1.3)) for s in (1, -1) for t in (1, -1)]

KNOWN = {  # the count, the rank, the truth
    "Dixon, 1899, first": (framework("K33", ON_AXES, bipartite(3, 3), (0, 3), 2), 0, 1, 1),
    "Dixon, 1899, second": (framework("K44", RECTANGLES, bipartite(4, 4), (0, 4), 2), -3, 1, 1),
    "K33 on a conic: shaky": (framework("K33", ELLIPSE, bipartite(3, 3), (0, 3), 2), 0, 1, 0),
    "Bricard, 1897, line": (
        framework(
            "octahedron",
            [A, HALF_TURN @ A, B, HALF_TURN @ B, C, HALF_TURN @ C],
            OCTAHEDRON,
            (0, 2, 4),
        ),
        0,
        1,
        1,
    ),
    "Bricard, 1897, plane": (
        framework(
            "octahedron",
            [A, MIRROR @ A, B, MIRROR @ B, (0.3, 1.2, 0), (-1, -0.4, 0)],
            OCTAHEDRON,
            (0, 2, 4),
        ),
        0,
        1,
        1,
    ),
    "Cauchy: regular octahedron": (
        framework("octahedron", [X, -X, Y, -Y, Z, -Z], OCTAHEDRON, (0, 2, 4)),
        0,
        0,
        0,
    ),
    "octahedron turned by 30 degrees: shaky": (prism(5 * pi / 6), 0, 1, 0),
    "double banana": (framework("bananas", SPREAD[:8], TWO_TRIANGLES, (2, 3, 4)), 0, 1, 1),
    "K46 on a quadric: Bolker and Roth, 1980": (
        framework("K46", ELLIPSOID, bipartite(4, 6)),
        6,
        7,
        6,
    ),
    "Griffis-Duffy": (griffis_duffy(), 0, 1, 1),
    "similar hexagons on circles: Ma and Angeles, 1991": (
        on_rods("similar", HEXAGON, 0.6 * HEXAGON @ TILTED.T + [0.3, 0.2, 1.4]),
        0,
        1,
        1,
    ),
    "three parallel rods of one length": (
        on_rods("parallel", [(0, 0), (2, 0), (0.7, 1.1)], [(0.4, 1.5), (2.4, 1.5), (1.1, 2.6)], 2),
        0,
        1,
        1,
    ),
    "Delassus, 1922: parallelogram of screws": (helical([0.1, 0.3, 0.5, 0.3]), -2, 1, 1),
    "four screws that do not fit": (helical([0.1, 0.3, 0.5, 0.2]), -2, 0, 0),
    "trammel with five slots": (trammel(5), -2, 1, 1),
    "Hoberman's ring of six": (hoberman(6), -3, 1, 1),
    "4-UPU": (four_upu(), 2, 4, 4),
    "double Cardan": (cardan_shafts(0.5, -0.5), 0, 1, 1),
    "folded Miura": (miura(3, 3, 0.6), -12, 1, 1),
}
