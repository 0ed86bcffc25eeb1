"""Coordinates that tasks have nothing to do with: no search needs to move them."""

from __future__ import annotations

import numpy as np

from kempe.kinematics.configuration import random
from kempe.kinematics.tasks.packed import Packed
from kempe.spatial import Array

NONE = np.zeros(0, dtype=np.int64)
SAMPLES = 3
NOTHING = 1e-12
"""Configurations at which it is looked what moves what, and derivatives there that are none, but
rounding."""


def apart(packed: Packed, pins: Array) -> np.ndarray:
    """Places in q that no task depends on, not even by loops or relations that it moves; `pins` (N,
    k) are goals.

    Looked for once, by derivatives at random configurations.
    """
    found = packed.stages.get(apart)
    if found is None:
        if not len(pins):
            return NONE
        q = random(packed.system, 0, SAMPLES)
        (_, tasks), (_, loops) = (packed.evaluate(q, pins[:1], c) for c in (False, True))
        if not (np.isfinite(tasks).all() and np.isfinite(loops).all()):
            return NONE
        sided = packed.one_sided.rates(q, declared=True)[1]
        tasks = np.concatenate([tasks, sided], axis=1)  # as if they were requested
        opaque = any(tie.function is not None for tie in packed.loops.ties)  # and may be flat there
        found = packed.stages[apart] = NONE if opaque else _left_alone(packed, tasks, loops)
    return found


def _left_alone(packed: Packed, tasks: Array, loops: Array) -> np.ndarray:
    """Places in q that Jacobians (N, m, nv) of tasks and loops leave alone."""
    layout = packed.system.structure.layout
    requested: np.ndarray = np.any(np.abs(tasks) > NOTHING, axis=(0, 1))
    bound: np.ndarray = np.any(np.abs(loops) > NOTHING, axis=0)
    for _ in range(len(bound)):  # what moves a loop moves all of it
        requested = requested | bound[(bound & requested).any(axis=1)].any(axis=0)
    balls = ~(requested[layout.quaternion_v[:, None] + np.arange(3)].any(axis=1))
    angles = layout.vector_q[~requested[layout.vector_v]]
    return np.concatenate(
        [angles, (layout.quaternion_q[balls][:, None] + np.arange(4)).ravel()]
    ).astype(np.int64)
