"""Systems that roll, for tests: built by declared constraints only."""

from __future__ import annotations

import numpy as np

from kempe import Mechanism
from kempe.system import System


def knife(at=(0.0, 0.0), angle: float = 0.0, limits: dict | None = None) -> System:
    """A body in the plane on one axle, placed anywhere on it."""
    m = Mechanism("knife edge", dim=2)
    body = m.body("body")
    m.planar("pose", m.ground, body, limits=limits)
    m.frame("axle", body, at=at, angle=angle)
    m.no_sideslip("edge", "axle")
    return m.build()


def tilted(rng: np.random.Generator) -> System:
    """A body on an axle in some plane in space, by two prismatic joints, not at right angles, and a
    revolute one.
    """
    m = Mechanism("tilted", dim=3)
    a = m.body("a")
    b = m.body("b")
    body = m.body("body")
    rpy = rng.uniform(-1, 1, 3)
    m.fixed("mount", m.ground, a, at=tuple(rng.normal(size=3)), rpy=tuple(rpy))
    c = m.body("c")
    d = m.body("d")
    skew = rng.uniform(-0.6, 0.6)
    order = list(rng.permutation(3))
    bodies = [a, c, d, body]
    kinds = ["x", "y", "turn"]
    for i, k in enumerate(order):
        at = tuple(rng.uniform(-0.3, 0.3, 3))
        if kinds[k] == "turn":
            m.revolute("h", bodies[i], bodies[i + 1], at=at)
        else:
            axis = (1.0, 0.0, 0.0) if kinds[k] == "x" else (np.sin(skew), np.cos(skew), 0.0)
            m.prismatic(kinds[k], bodies[i], bodies[i + 1], at=at, axis=axis)
    m.fixed("b is no part of it", m.ground, b)
    m.frame("axle", body, at=tuple(rng.uniform(-0.5, 0.5, 3)), angle=rng.uniform(-3, 3))
    m.no_sideslip("edge", "axle")
    return m.build()


def car(limits=None, length: float = 1.2) -> System:
    """A car with a steering angle: rear axle and front wheel do not slip."""
    m = Mechanism("car", dim=2)
    body = m.body("body")
    fork = m.body("fork")
    m.planar("pose", m.ground, body)
    m.revolute("steer", body, fork, at=(length, 0.0), limits=limits)
    m.no_sideslip("rear", "body")
    m.no_sideslip("front", "fork")
    return m.build()


def coin(radius: float = 0.5) -> System:
    """A coin that stands upright and rolls on a plane."""
    m = Mechanism("coin", dim=3)
    yoke = m.body("yoke")
    disc = m.body("coin")
    m.planar("pose", m.ground, yoke, at=(0.0, 0.0, radius))
    m.revolute("roll", yoke, disc, axis="y")
    m.rolls("floor", "coin", radius=radius, shape="disc")
    return m.build()


def differential(radius: float = 0.1, half: float = 0.3) -> System:
    """A cart with two driven wheels on one axle."""
    m = Mechanism("cart", dim=3)
    body = m.body("body")
    m.planar("pose", m.ground, body, at=(0.0, 0.0, radius))
    for name, y in (("left", half), ("right", -half)):
        wheel = m.body(name)
        m.revolute(name, body, wheel, at=(0.0, y, 0.0), axis="y")
        m.rolls(f"{name} rolls", name, radius=radius, shape="disc")
    return m.build()


def trailer() -> System:
    """A cart on an axle that pulls a trailer."""
    m = Mechanism("trailer", dim=2)
    body = m.body("body")
    behind = m.body("trailer")
    m.planar("pose", m.ground, body)
    m.revolute("hitch", body, behind)
    m.frame("wheels", behind, at=(-1.0, 0.0))
    m.no_sideslip("front", "body")
    m.no_sideslip("rear", "wheels")
    return m.build()
