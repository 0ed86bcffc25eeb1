"""Legs of a parallel mechanism, and the places of its frame that no leg excludes by its lengths.

Legs are chains from the ground to a frame that share only the bodies at their ends. Where the
frame's pose is given, the legs do not know of each other: it is reached if and only if each leg
reaches it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.model.model import keep_answers
from kempe.numerics.length_bounds import PlaceBounds, compute_place_bounds
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import Model


@keep_answers
def find_legs(system: Model, frame: str) -> tuple[Model, ...]:
    """Find the legs to a frame, each as a system with that frame; none without at least two legs.

    Bodies that hang on others only are left out. Constraints and couplings may tie legs: with these
    there are none.
    """
    m = system._mechanism
    ground = system.body_names[0]
    body = m.frames[frame].body if frame in m.frames else frame
    if m.constraints or m.couplings or system.structure.relations or body == ground:
        return ()
    out: list[Model] = []
    for names in _find_joints_between(m, ground, body):
        part = m.copy()
        part.joints = {n: m.joints[n] for n in names}
        part.postures = {}
        leg = type(system)(part.subchain(ground, frame))
        if leg.structure.closures or len(leg.joint_names) != len(names):
            return ()
        out.append(leg)
    return tuple(out) if len(out) > 1 else ()


def _find_joints_between(m: Mechanism, ground: str, body: str) -> list[list[str]]:
    """Find the names of joints between two bodies, for each part, without dead ends."""
    ends = {ground, body}
    free = dict(m.joints)
    parts: list[list[str]] = []
    while free:
        first = next(iter(free.values()))
        inside = {first.parent, first.child} - ends
        names = [first.name]
        del free[first.name]
        while more := [j for j in free.values() if {j.parent, j.child} & inside]:
            for j in more:
                inside |= {j.parent, j.child} - ends
                names.append(j.name)
                del free[j.name]
        parts.append(_drop_dead_ends(m, names, ends))
    return [
        names
        for names in parts
        if ends <= {b for n in names for b in (m.joints[n].parent, m.joints[n].child)}
    ]


def _drop_dead_ends(m: Mechanism, names: list[str], ends: set[str]) -> list[str]:
    """Drop joints that lead to a body without any other joint."""
    while True:
        bodies = [b for n in names for b in (m.joints[n].parent, m.joints[n].child)]
        loose = {b for b in bodies if bodies.count(b) == 1} - ends
        if not loose:
            return names
        names = [n for n in names if not {m.joints[n].parent, m.joints[n].child} & loose]


# ---- places

MISSED = 1e-6
"""By how much [m] the inverse model may miss a place that it reaches."""


@keep_answers
def list_place_bounds(system: Model, frame: str) -> tuple[PlaceBounds, ...]:
    """List the bounds of the places of a frame, of each of its legs or of its chain."""
    return tuple(
        compute_place_bounds(part, part.structure.table.at[frame])
        for part in find_legs(system, frame) or (system,)
    )


def find_possible_places(system: Model, frame: str, points: Array) -> np.ndarray:
    """Find which points (n, 3) may be reached: they are not beyond a bound by more than `MISSED`.
    NaN is unreachable.
    """
    out = np.asarray(np.isfinite(points).all(axis=1))
    for (low, high), shells, slack in list_place_bounds(system, frame):
        slack += MISSED
        out &= ((points >= low - slack) & (points <= high + slack)).all(axis=1)
        for shell in shells:
            far = np.linalg.norm(points - shell.centre, axis=1)
            out &= (far <= shell.largest + slack) & (far >= shell.smallest - slack)
    return out
