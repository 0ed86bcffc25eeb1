"""What the target of one frame stands for: the constraints that `System.ik` holds by the name of a
task.
"""

from __future__ import annotations

import numpy as np

from kempe.constraints.base import Constraint
from kempe.spatial import Array

AXIS_TASKS = ("direction", "position_axis")
"""Tasks on an axis of the tool."""


def of_target(
    frame: str, task: str, axis: tuple[float, float, float], X: Array
) -> list[Constraint]:
    """The constraints of a target (..., 4, 4) for "pose", "position", "orientation" or one of
    `AXIS_TASKS`.
    """
    from kempe.constraints.kinds import Orientation, Pointing, Pose, Position

    out: list[Constraint] = []
    if task == "pose":
        out.append(Pose(frame, X))
    if task in AXIS_TASKS:
        out.append(Pointing(frame, X[..., :3, :3] @ np.array(axis), axis=axis))
    if task == "orientation":
        out.append(Orientation(frame, X[..., :3, :3]))
    if task in ("position", "position_axis"):
        out.append(Position(frame, X[..., :3, 3]))
    return out
