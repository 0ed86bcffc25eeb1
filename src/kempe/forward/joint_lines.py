"""Joint lines of a chain at q = 0: axes of rotation and directions of slides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.errors import UnsupportedError
from kempe.forward.fk import fk, jacobian
from kempe.model.primitive_table import extract_chain
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

SCREW = 1e-9
"""Cosine of the angle between the velocity of a point and its turning, above which a joint also
slides along its axis."""


class JointLine(NamedTuple):
    """The line of a joint: the axis of its rotation, or the direction of its slide.

    `point` and the unit vector `direction` are numbers (3,) or symbols, or in the plane complex
    numbers or pairs; there turns go about z, and `rate` has their sense. The joint turns or slides
    `rate` times as much as its `coordinate` changes, which stays within `limits`.
    """

    point: Any
    direction: Any
    turns: bool = True
    coordinate: str = ""
    rate: float = 1.0
    limits: tuple[float, float] = (-np.inf, np.inf)

    @property
    def name(self) -> str:
        """Name of the coordinate with underscores in place of dots, as a joint's name."""
        return self.coordinate.replace(".", "_")


def make_zero_configuration(system: Model) -> Array:
    """Make the configuration (nq,) of zeros; coordinates fixed by equal limits keep those values."""
    q = system.neutral.copy()
    held = system.lower == system.upper
    q[held] = system.lower[held]
    return q


def compute_joint_lines(system: Model, frame: str) -> tuple[list[JointLine], Array]:
    """Compute the lines of the joints that move a frame, and its pose (4, 4), both at q = 0.

    The lines are numbers and begin at the ground.

    Joints that their limits hold are left out. Errors: `UnsupportedError` for other joints than
    turns and slides, each with one coordinate.
    """
    table, q_index, v_index = extract_chain(system.structure.table, frame)
    if len(table.iv) != len(v_index) or len(q_index) != len(v_index):
        raise UnsupportedError(
            f"the chain of {frame!r} has joints that follow each other, or have quaternions"
        )
    q = make_zero_configuration(system)
    pose = fk(system, q, frame)
    J = jacobian(system, q, frame)[:, v_index]
    lines: list[JointLine] = []
    for k, i in enumerate(v_index):
        v = J[:3, k]
        w = J[3:, k]
        limits = (float(system.lower[i]), float(system.upper[i]))
        turning = float(np.linalg.norm(w))
        if limits[0] == limits[1]:
            continue
        if turning > 0.0 and abs(float(v @ w)) > SCREW * turning**2:
            raise UnsupportedError(f"a joint of the chain of {frame!r} is a screw")
        rate = turning or float(np.linalg.norm(v))
        point = pose[:3, 3] + np.cross(w, v) / turning**2 if turning else pose[:3, 3]
        name = system.coordinate_names[int(q_index[k])]
        lines.append(
            JointLine(point, (w if turning else v) / rate, turning > 0.0, name, rate, limits)
        )
    return lines, pose
