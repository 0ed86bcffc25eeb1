"""What is held at given values, coordinates and frames, as judges measure it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.constraints.frame_targets import of_target
from kempe.kinematics.tasks.task_classes import task_of
from kempe.solvers.common.arguments import place_of
from kempe.solvers.common.targets import Z_AXIS
from kempe.solvers.dyads.dyads import source_values
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

WITHIN = (1e-6, 1e-6)
"""Metres and radians that what is held may be off by."""


class HeldCoordinate(NamedTuple):
    """The coordinate `label` of q is `value` (...)."""

    label: str
    place: int
    turns: bool
    value: Any

    def measure(self, system: System, q: Array, goals: Any, at: Any) -> tuple[Array, Array]:
        """How far (...) configurations q (..., nq) miss it, in metres and in radians."""
        off = np.abs(q[..., self.place] - self.value)
        return (np.zeros_like(off), off) if self.turns else (off, np.zeros_like(off))


def held_at(system: System, known: Mapping[str, Any]) -> list[tuple[Any, Any, Any]]:
    """Tasks, goals and tolerances of known values by the names of coordinates, or places by the
    names of frames.
    """
    own = {*system.coordinate_names, *system.structure.couplings}
    turns = system.structure.coordinates.turning[system.structure.layout.vector_v].tolist()
    turning = dict(zip(system.structure.layout.vector_q.tolist(), turns, strict=True))
    out: list[tuple[Any, Any, Any]] = []
    for name, value in source_values(system, {k: x for k, x in known.items() if k in own}).items():
        i = system.coordinate_names.index(name)
        out.append((HeldCoordinate(name, i, turning.get(i, True), value), None, WITHIN))
    for name in known.keys() - own:
        whole = np.ndim(known[name]) == 2
        X = np.eye(4)
        place = place_of(system, name, known[name], whole)
        X[: len(place), 3 if not whole else slice(None)] = place
        made = of_target(name, "pose" if whole else "position", Z_AXIS, X)
        out += [(task_of(c, system.dim), None, WITHIN) for c in made]
    return out
