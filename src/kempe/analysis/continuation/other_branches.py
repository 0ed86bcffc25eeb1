"""Assembly modes that a traced path does not pass: a mechanism that is built again may move on
another branch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.configuration import q_dict
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.analysis.continuation.path import Path


MOST_SIGNS = 6
"""Dyads of mechanisms whose assembly modes are looked at: 64 modes, in some hundredths of a
second."""


def elsewhere(path: Path) -> tuple[str, Array]:
    """The input, and other configurations (k, nq) with its value at the path's start that the path
    does not pass.

    They are looked for where they are in closed form, inside the limits. The input is the driver; a
    path that has none, or a driver that is not a coordinate, takes the first coordinate with which
    there are some. `held` coordinates stay. Of mechanisms of many dyads there are none.
    """
    from kempe.solvers.dyads.dyads import Incomplete, closed_form
    from kempe.solvers.modes.modes import assembly_modes

    system = path.system
    nothing = ("", np.zeros((0, path.system.nq)))
    if not system.structure.closures or not path.success or len(path.track.s) < 2:
        return nothing
    start = q_dict(system, path.q[0])
    held = {name: start[name] for name in path.held}
    for name in [path.driver] if path.driver in start else start:
        plan = None if name in held else closed_form(system, (name, *held))
        if plan is not None and not isinstance(plan, Incomplete) and plan.signs <= MOST_SIGNS:
            modes = assembly_modes(system, {name: start[name], **held})
            others = [q for q in modes.q if not any(_passes(p, q) for p in (path, *path.others))]
            if others:
                return name, np.array(others)
    return nothing


def _passes(path: Path, q: Array) -> bool:
    """Whether a path may pass q: on the way from one node to the next it is no farther from one
    than these are.
    """
    track = path.track
    e = path.track.equations
    y = np.array([e.between(node, q) for node in track.q]) * e.unit
    turning = path.system.structure.coordinates.turning
    y = np.where(turning, y - 2.0 * np.pi * np.round(y / (2.0 * np.pi)), y) / e.unit
    return bool(np.linalg.norm(y, axis=1).min() <= np.diff(track.s).max())
