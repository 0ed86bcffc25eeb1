"""Small linkages that several files of tests use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kempe import Mechanism, System


def four_bar(
    a: float = 0.1,
    b: float = 0.5,
    c: float = 0.4,
    d: float = 0.4,
    cut: str | None = "C",
    at: tuple[float, float] = (0.0, 0.0),
    **joints: dict[str, Any],
) -> System:
    """Crank a, coupler b, rocker c, ground d, standing at `at`; joints A, B, C, D with further
    keywords by name.
    """
    m = Mechanism("four-bar", dim=2)
    crank, coupler, rocker = (m.body(name) for name in ("crank", "coupler", "rocker"))
    places = {
        "A": (m.ground, crank, at, (0, 0)),
        "B": (crank, coupler, (a, 0), (0, 0)),
        "C": (coupler, rocker, (b, 0), (c, 0)),
        "D": (m.ground, rocker, (at[0] + d, at[1]), (0, 0)),
    }
    for name, (parent, child, here, there) in places.items():
        m.revolute(
            name, parent, child, at=here, child_at=there, cut=name == cut, **joints.get(name, {})
        )
    return m.build()


def planar_arm(*lengths: float, limits: Sequence[Any] | None = None) -> System:
    """Links of these lengths, b1, b2, ..., turning in the plane by q1, q2, ...; frame `tip`; limits
    of each joint.
    """
    m = Mechanism("planar arm", dim=2)
    before = m.ground
    at = 0.0
    for k, (length, pair) in enumerate(
        zip(lengths, limits or [None] * len(lengths), strict=True), 1
    ):
        m.revolute(f"q{k}", before, m.body(f"b{k}"), at=(at, 0.0), limits=pair)
        before = m.bodies[f"b{k}"]
        at = length
    m.frame("tip", before, at=(at, 0.0))
    return m.build()


def two_bars() -> Mechanism:
    """Bars `upper` and `lower` of 1 m, which turn in the plane by A and B; frame `tip`."""
    m = Mechanism("arm", dim=2)
    upper = m.body("upper")
    lower = m.body("lower")
    m.revolute("A", m.ground, upper)
    m.revolute("B", upper, lower, at=(1.0, 0.0))
    m.frame("tip", lower, at=(1.0, 0.0))
    return m


def place(x: float, y: float, scale: float, mirrored: bool) -> tuple[float, float]:
    """A place in the plane, drawn at a scale and mirrored or not."""
    return scale * x, -scale * y if mirrored else scale * y


def double_watt(
    second: float, turned: bool, scale: float = 1.0, mirrored: bool = False, cut: str = "m2"
) -> tuple[System, np.ndarray]:
    """Two of Watt's linkages with a bar between their middles; the second is `second` times as
    large.
    """
    m = Mechanism("double Watt", dim=2)

    def watt(k: int, x: float, way: float, size: float):
        left, right, middle = (m.body(f"{n}{k}") for n in ("left", "right", "middle"))
        half = place(0, 0.5 * size, scale, mirrored)
        low = place(0, -0.5 * size, scale, mirrored)
        m.revolute(f"o{k}", m.ground, left, at=place(x - way * size, 0.5 * size, scale, mirrored))
        m.revolute(f"p{k}", m.ground, right, at=place(x + way * size, -0.5 * size, scale, mirrored))
        m.revolute(
            f"l{k}", left, middle, at=(scale * way * size, 0), child_at=half, cut=cut == f"l{k}"
        )
        m.revolute(f"r{k}", right, middle, at=(-scale * way * size, 0), child_at=low)
        return middle

    one = watt(1, 0.0, 1.0, 1.0)
    two = watt(2, 1.0, -1.0 if turned else 1.0, second)
    bar = m.body("bar")
    m.revolute("m1", one, bar, cut=cut == "m1")
    m.revolute("m2", bar, two, at=(scale, 0), cut=cut == "m2")
    system = m.build()
    return system, system.neutral
