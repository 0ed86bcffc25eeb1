"""Planar loops of bars, as tests of spaces need them."""

from __future__ import annotations

import kempe
from kempe import Mechanism


def polygon(lengths: list[float]) -> kempe.System:
    """A planar loop of bars, the first of which is the ground."""
    m = Mechanism("polygon", dim=2)
    bodies = [m.ground, *(m.body(f"b{k}") for k in range(1, len(lengths)))]
    m.revolute("j1", m.ground, bodies[1])
    for k in range(1, len(lengths) - 1):
        m.revolute(f"j{k + 1}", bodies[k], bodies[k + 1], at=(lengths[k], 0.0))
    m.revolute("j0", bodies[-1], m.ground, at=(lengths[-1], 0.0), child_at=(lengths[0], 0.0))
    return m.build()
