"""Systems whose workspaces have closed forms."""

from __future__ import annotations

import math

from kempe import Mechanism


def two_bars(a, b, limits=None):
    """A planar arm of two bars; its tip covers an annulus, or with limits of the second joint a
    part of it.
    """
    m = Mechanism("two bars", dim=2)
    first = m.body("first")
    second = m.body("second")
    m.revolute("A", m.ground, first)
    m.revolute("B", first, second, at=(a, 0), limits=limits)
    m.frame("tip", second, (b, 0))
    return m.build()


def scara(a, b, height):
    """Two bars that turn about z, and a slide along it: the tip covers an annulus times the stroke."""
    m = Mechanism("scara")
    first = m.body("first")
    second = m.body("second")
    rod = m.body("rod")
    hand = m.body("hand")
    m.revolute("A", m.ground, first, axis="z")
    m.revolute("B", first, second, at=(a, 0, 0), axis="z")
    m.prismatic("C", second, rod, at=(b, 0, 0), axis="z", limits=(0.0, height))
    m.revolute("D", rod, hand, axis="z")
    m.frame("tip", hand)
    return m.build()


def shell(a, b, rolled=False):
    """An arm of two bars in space on a shoulder that turns twice, or thrice: its tip covers a
    spherical shell.
    """
    m = Mechanism("shell")
    hip = m.body("hip")
    upper = m.body("upper")
    lower = m.body("lower")
    m.revolute("A", m.ground, hip, axis="z")
    m.revolute("B", hip, upper, axis="y")
    if rolled:
        m.revolute("R", upper, m.body("sleeve"), axis="x")
    m.revolute("C", "sleeve" if rolled else upper, lower, at=(a, 0, 0), axis="y")
    m.frame("tip", lower, (b, 0, 0))
    return m.build()


def torus(large, small, solid):
    """A spatial arm of two turns, whose tip covers a torus; with a slide from its centre line on,
    all inside it.
    """
    m = Mechanism("torus")
    hip = m.body("hip")
    arm = m.body("arm")
    rod = m.body("rod")
    m.revolute("A", m.ground, hip, axis="z")
    m.revolute("B", hip, arm, at=(large, 0, 0), axis="y")
    if solid:
        m.prismatic("C", arm, rod, axis="x", limits=(0.0, small))
    else:
        m.fixed("C", arm, rod, at=(small, 0, 0))
    m.frame("tip", rod)
    return m.build()


ANNULUS = math.pi * ((0.5 + 0.3) ** 2 - (0.5 - 0.3) ** 2)
SHELL = 4.0 / 3.0 * math.pi * ((0.5 + 0.3) ** 3 - (0.5 - 0.3) ** 3)
TORUS = 2.0 * math.pi**2 * 0.5 * 0.2**2
"""Area and volumes of what `two_bars(0.5, 0.3)`, `shell(0.5, 0.3)` and `torus(0.5, 0.2, True)`
reach."""
