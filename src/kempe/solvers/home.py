"""Where assemblies start: at home, or anywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.configuration import sampling_box
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


def home_of(system: System) -> Array:
    """Where an assembly starts that is told nothing: the posture 'closed' if there is one, else within the limits."""
    if "closed" in system.posture_names:
        return system.posture("closed")
    return system.mid


def scatter(system: System, n: int, rng: np.random.Generator) -> Array:
    """Starts (n, nq) all over the coordinates' ranges, for those who look for all closed configurations."""
    low, high = sampling_box(system)
    q = np.broadcast_to(system.neutral, (n, system.nq)).copy()
    at_q, at_v = system.layout.vector_q, system.layout.vector_v
    q[:, at_q] = low[at_v] + (high - low)[at_v] * rng.random((n, len(at_v)))
    system.layout.random_quaternions(q, rng)
    return q
