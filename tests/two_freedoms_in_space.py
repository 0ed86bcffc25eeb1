"""Mechanisms in space with two freedoms, and numbers of their configurations in closed form."""

from __future__ import annotations

import numpy as np

import kempe


def spherical_five_bar(a1, b1, b2, a2, d) -> kempe.System:
    """Five turns whose axes meet in a point; links are arcs of these angles, and A and D are
    driven.
    """
    m = kempe.Mechanism("spherical five-bar")
    m.revolute("A", m.ground, m.body("crank1"), axis="z", actuated=True)
    m.revolute("B", "crank1", m.body("rod1"), rpy=(a1, 0, 0), axis="z")
    m.revolute("D", m.ground, m.body("crank2"), rpy=(d, 0, 0), axis="z", actuated=True)
    m.revolute("C", "crank2", m.body("rod2"), rpy=(a2, 0, 0), axis="z")
    m.revolute("P", "rod1", "rod2", rpy=(b1, 0, 0), child_rpy=(b2, 0, 0), axis="z")
    m.frame("tip", "rod1", rpy=(b1, 0, 0))
    return m.build()


def turned(axis: str, angle) -> np.ndarray:
    """Rotations (..., 3, 3) about x or z."""
    c = np.cos(angle)
    s = np.sin(angle)
    o = np.zeros(np.shape(angle))
    i = np.ones(np.shape(angle))
    rows = {"z": [c, -s, o, s, c, o, o, o, i], "x": [i, o, o, o, c, -s, o, s, c]}[axis]
    return np.stack(rows, axis=-1).reshape(*np.shape(angle), 3, 3)


def directions(az, el) -> np.ndarray:
    """Unit vectors (..., 3)."""
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)


def between(u, v) -> np.ndarray:
    """Angles (...) between unit vectors."""
    return np.arccos(np.clip(np.sum(u * v, axis=-1), -1.0, 1.0))


def triangle(far, a, b) -> np.ndarray:
    """Whether a spherical triangle with the sides a, b (0 to pi) and `far` closes."""
    return (far > abs(a - b)) & (far < np.minimum(a + b, 2.0 * np.pi - a - b))


def modes_of_spherical(values, a1, b1, b2, a2, d) -> np.ndarray:
    """Two where the axes of B and C are so far apart that the rods close a triangle, else none."""
    z = np.array([0.0, 0.0, 1.0])
    B = turned("z", values[..., 0]) @ turned("x", a1) @ z
    C = turned("x", d) @ turned("z", values[..., 1]) @ turned("x", a2) @ z
    return 2 * triangle(between(B, C), b1, b2)


def ways_of_spherical(z, a1, b1, b2, a2, d) -> np.ndarray:
    """Each leg closes a triangle from its pivot to the direction z (..., 3) in two ways or in none."""
    legs = [between(z, turned("x", x) @ np.array([0.0, 0.0, 1.0])) for x in (0.0, d)]
    return 4 * (triangle(legs[0], a1, b1) & triangle(legs[1], a2, b2))


def five_bar(plane: str | None) -> kempe.System:
    """A five-bar in the plane (None), or one in space that moves in the xy- or the xz-plane."""
    m = kempe.Mechanism("five-bar", dim=2 if plane is None else 3)
    on = {} if plane is None else {"axis": "z"}
    base = {"rpy": (np.pi / 2, 0, 0)} if plane == "xz" else {}

    def at(x, y=0.0):
        return (x, y) if plane is None else (x, y, 0.0)

    m.revolute("A", m.ground, m.body("crank1"), actuated=True, **on, **base)
    m.revolute("D", m.ground, m.body("crank2"), at=at(0.3), actuated=True, **on, **base)
    m.revolute("B", "crank1", m.body("rod1"), at=at(0.2), **on)
    m.revolute("C", "crank2", m.body("rod2"), at=at(0.25), **on)
    m.revolute("P", "rod1", "rod2", at=at(0.3), child_at=at(0.35), limits=(-2.5, 2.8), **on)
    m.frame("tip", "rod1", at=at(0.3, 0.05))
    return m.build()


def slider_pair(dim: int) -> kempe.System:
    """Two bars that meet at the tip, on driven slides along x, in millimetres."""
    m = kempe.Mechanism("PRRRP", dim=dim)
    on = {} if dim == 2 else {"axis": "z"}
    for k, limits in ((1, (-300.0, 100.0)), (2, (100.0, 500.0))):
        m.prismatic(
            f"s{k}",
            m.ground,
            m.body(f"cart{k}"),
            axis=(1, 0, 0)[:dim],
            limits=limits,
            actuated=True,
        )
        m.revolute(f"A{k}", f"cart{k}", m.body(f"bar{k}"), **on)
    m.revolute("P", "bar1", "bar2", at=(250, 0, 0)[:dim], child_at=(300, 0, 0)[:dim], **on)
    m.frame("tip", "bar1", at=(250, 0, 0)[:dim])
    return m.build()


def pointer(lower: str, upper: str, limits=(0.35, 1.0)) -> kempe.System:
    """A plate on a universal joint, tilted by two legs whose lengths are driven: between joints of
    these types.
    """
    m = kempe.Mechanism("pointer")
    m.universal("U", m.ground, m.body("plate"), at=(0, 0, 0.5))
    for k, (x, y) in enumerate(FEET):
        getattr(m, lower)(f"F{k}", m.ground, m.body(f"cylinder{k}"), at=(x, y, 0))
        m.prismatic(
            f"s{k}", f"cylinder{k}", m.body(f"piston{k}"), axis="z", limits=limits, actuated=True
        )
        getattr(m, upper)(f"T{k}", f"piston{k}", "plate", child_at=TOPS[k])
    m.frame("camera", "plate", at=(0, 0, 0.1))
    return m.build()


FEET = ((0.3, 0.0), (0.0, 0.25))
TOPS = ((0.2, 0.0, 0.05), (0.0, 0.2, 0.0))


def lengths_of_pointer(U) -> np.ndarray:
    """Lengths (..., 2) of the legs at the two angles (..., 2) of the universal joint, x before y."""
    a = U[..., 0]
    b = U[..., 1]
    y_turn = np.zeros((*b.shape, 3, 3))
    y_turn[..., 0, 0], y_turn[..., 0, 2], y_turn[..., 1, 1] = np.cos(b), np.sin(b), 1.0
    y_turn[..., 2, 0], y_turn[..., 2, 2] = -np.sin(b), np.cos(b)
    R = turned("x", a) @ y_turn
    ends = [
        R @ np.array(t) + [0, 0, 0.5] - [x, y, 0.0] for t, (x, y) in zip(TOPS, FEET, strict=True)
    ]
    return np.stack([np.linalg.norm(e, axis=-1) for e in ends], axis=-1)
