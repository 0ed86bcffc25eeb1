"""Declared constraints of a description, in numpy."""

from __future__ import annotations

from typing import Any

from kempe import System
from kempe.constraints.base import position_rows
from kempe.description.parts import Declared
from kempe.kinematics.zoo import Distance, Pair, PointOnLine, PointOnPlane


def declared(system: System, constraint: Declared) -> Pair:
    """The constraint of a record of the description."""
    X_A, X_B = constraint.frames(system.parameters, system.dim)
    ends: Any = {"X_A": X_A, "X_B": X_B}
    names = constraint.name, constraint.parent, constraint.child
    if constraint.rod:
        return Distance(*names, constraint.length(system.parameters), **ends)
    if len(position_rows(constraint.of, 3)) == 2:
        return PointOnLine(*names, system.dim == 2, **ends)
    return PointOnPlane(*names, **ends)
