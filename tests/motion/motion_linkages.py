"""Small mechanisms for tests of motion, and their positions by circles, independent of the library."""

from __future__ import annotations

import math

import numpy as np

from kempe import Mechanism, System

TURN = 2.0 * math.pi


def four_bar(
    a: float, b: float, c: float, d: float, tracer: tuple[float, float] = (0.0, 0.0), **limits
) -> System:
    """Crank a, coupler b, rocker c, ground d, joints A, B, C, D; crank and rocker angles are those
    of the links.
    """
    m = Mechanism("four-bar", dim=2)
    crank = m.body("crank")
    coupler = m.body("coupler")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank, limits=limits.get("A"))
    m.revolute("B", crank, coupler, at=(a, 0), limits=limits.get("B"))
    m.revolute("D", m.ground, rocker, at=(d, 0), limits=limits.get("D"))
    m.revolute("C", coupler, rocker, at=(b, 0), child_at=(c, 0), cut=True, limits=limits.get("C"))
    m.frame("P", coupler, at=tracer)
    return m.build()


def slider_crank(r: float, rod: float, offset: float = 0.0, limits=None) -> System:
    """Crank r, rod, slider along x at height `offset`; joints A, B, C (pin on the slider), S
    (slide).
    """
    m = Mechanism("slider-crank", dim=2)
    crank = m.body("crank")
    link = m.body("rod")
    slider = m.body("slider")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, link, at=(r, 0))
    m.revolute("C", link, slider, at=(rod, 0), cut=True)
    m.prismatic("S", m.ground, slider, at=(0, offset), axis=(1, 0), limits=limits)
    return m.build()


def ladder(cranks: int, a: float = 1.0, spacing: float = 1.5) -> System:
    """Parallel cranks of one length on the ground and one coupler: joints A1, A2, ... below, B1,
    B2, ... above.
    """
    m = Mechanism("ladder", dim=2)
    coupler = m.body("coupler")
    for k in range(1, cranks + 1):
        crank = m.body(f"crank{k}")
        m.revolute(f"A{k}", m.ground, crank, at=(spacing * (k - 1) ** 1.2, 0))
        m.revolute(
            f"B{k}", crank, coupler, at=(a, 0), child_at=(spacing * (k - 1) ** 1.2, 0), cut=k > 1
        )
    return m.build()


def bennett(a: float, b: float, alpha: float, beta: float) -> System:
    """Bennett's linkage: links a, b, a, b with twists alpha, beta; closes where a / sin alpha = b /
    sin beta.
    """
    m = Mechanism("bennett")
    last = m.ground
    places = [(a, alpha), (b, beta), (a, alpha), (b, beta)]
    for k in range(1, 4):
        body = m.body(f"link{k}")
        length, twist = places[k - 2] if k > 1 else (0.0, 0.0)
        m.revolute(f"T{k}", last, body, at=(length, 0, 0), rpy=(twist, 0, 0))
        last = body
    end = m.body("end")
    m.fixed("tip", last, end, at=(a, 0, 0), rpy=(alpha, 0, 0))
    m.revolute("T4", end, m.ground, child_at=(-b, 0, 0), child_rpy=(-beta, 0, 0), cut=True)
    return m.build()


def circles(p, r: float, q, s: float, side: float):
    """Points (..., 2) at distance r from p and s from q (..., 2), on the left of p -> q for side =
    1.
    """
    p = np.asarray(p, dtype=float)
    q = np.asarray(q, dtype=float)
    v = q - p
    d = np.linalg.norm(v, axis=-1, keepdims=True)
    x = (d**2 + r**2 - s**2) / (2.0 * d)
    y = np.sqrt(r**2 - x**2)
    u = v / d
    return p + x * u + side * y * np.stack([-u[..., 1], u[..., 0]], axis=-1)


def angle(v):
    """Angle (...) of vectors (..., 2)."""
    return np.arctan2(v[..., 1], v[..., 0])


def same_angle(a, b) -> float:
    """Largest difference of two arrays of angles, whole turns apart."""
    d = np.asarray(a) - np.asarray(b)
    return float(np.abs(d - TURN * np.round(d / TURN)).max())


def linkage(
    name: str, points: dict[str, tuple[float, float]], links: dict[str, str | tuple[str, ...]]
) -> System:
    """A planar linkage of pinned links, drawn in one pose: links are lists of points, the first is
    the ground.

    In that pose all coordinates are zero and all bodies coincide with the ground. The joint at a
    point is named after it, further ones there after it and a number; the points are frames, named
    with a star.
    """
    m = Mechanism(name, dim=2)
    bodies = [m.ground, *(m.body(b) for b in list(links)[1:])]
    at = {
        p: [b for b, ends in zip(bodies, links.values(), strict=True) if p in ends] for p in points
    }
    for p, xy in points.items():
        for k, other in enumerate(at[p][1:]):
            m.revolute(p if k == 0 else f"{p}{k + 1}", at[p][0], other, at=xy, child_at=xy)
        m.frame(f"{p}*", at[p][0] if at[p][0] is not m.ground else at[p][-1], at=xy)
    return m.build()


JANSEN = dict(
    zip(
        "abcdefghijklm",
        (38, 41.5, 39.3, 40.1, 55.8, 39.4, 36.7, 65.7, 49, 50, 61.9, 7.8, 15),
        strict=True,
    )
)


def jansen_points(theta) -> dict[str, np.ndarray]:
    """Points (..., 2) of Theo Jansen's leg at crank angle theta (...), by circles one after the
    other.
    """
    n = JANSEN
    theta = np.asarray(theta, dtype=float)
    Q = np.broadcast_to([-n["a"], -n["l"]], (*theta.shape, 2))
    X = n["m"] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    Y = circles(Q, n["b"], X, n["j"], 1.0)
    W = circles(Q, n["c"], X, n["k"], -1.0)
    Z = circles(Q, n["d"], Y, n["e"], 1.0)
    V = circles(Z, n["f"], W, n["g"], -1.0)
    F = circles(V, n["h"], W, n["i"], -1.0)
    return {"O": np.zeros_like(X), "Q": Q, "X": X, "Y": Y, "W": W, "Z": Z, "V": V, "F": F}


def jansen() -> System:
    """Theo Jansen's leg with the crank at 0."""
    points = {k: tuple(map(float, v)) for k, v in jansen_points(0.0).items()}
    return linkage(
        "jansen",
        points,
        {
            "ground": ("O", "Q"),
            "crank": ("O", "X"),
            "j": ("X", "Y"),
            "k": ("X", "W"),
            "upper": ("Q", "Y", "Z"),
            "c": ("Q", "W"),
            "f": ("Z", "V"),
            "foot": ("V", "W", "F"),
        },
    )


def peaucellier() -> System:
    """Peaucellier's cell with OA = OC = 3, rhombus 1.6, OQ = QB = 1, in a pose off its axis."""
    t = 0.4
    B = np.array([1.0 + np.cos(t), np.sin(t)])
    A = circles([0, 0], 3.0, B, 1.6, 1.0)
    C = circles([0, 0], 3.0, B, 1.6, -1.0)
    points = {"Q": (1.0, 0.0), "O": (0.0, 0.0), "A": A, "C": C, "B": B, "D": A + C - B}
    return linkage(
        "peaucellier",
        {k: tuple(map(float, v)) for k, v in points.items()},
        {
            "ground": ("Q", "O"),
            "crank": ("Q", "B"),
            "OA": ("O", "A"),
            "OC": ("O", "C"),
            "AB": ("A", "B"),
            "BC": ("B", "C"),
            "CD": ("C", "D"),
            "DA": ("D", "A"),
        },
    )


def two_parallelograms() -> System:
    """Two parallelograms on one crank, of different lengths: both are flat at once."""
    a = 0.7
    up = np.array([np.cos(a), np.sin(a)])
    points = {
        "A": np.zeros(2),
        "D": np.array([2.0, 0]),
        "E": np.array([-3.0, 0]),
        "B": up,
        "C": up + [2.0, 0],
        "F": up + [-3.0, 0],
    }
    return linkage(
        "two parallelograms",
        {k: tuple(map(float, v)) for k, v in points.items()},
        {
            "ground": ("A", "D", "E"),
            "crank": ("A", "B"),
            "right": ("B", "C"),
            "rocker": ("C", "D"),
            "left": ("B", "F"),
            "other": ("F", "E"),
        },
    )


def row_of_four_bars(n: int, wider: float = 0.0) -> System:
    """A row of n four-bars: n + 1 cranks on the ground, neighbours joined by couplers. Each second
    coupler is `wider` than a parallelogram's.
    """
    m = Mechanism(f"row of {n} four-bars", dim=2)
    for i in range(n + 1):
        m.revolute(f"A{i}", m.ground, m.body(f"crank{i}"), at=(i, 0))
    for i in range(n):
        coupler = m.body(f"coupler{i}")
        m.revolute(f"B{i}", f"crank{i}", coupler, at=(0, 0.5))
        m.revolute(
            f"C{i}", coupler, f"crank{i + 1}", at=(1.0 + wider * (i % 2), 0), child_at=(0, 0.5)
        )
    return m.build()
