"""Arms in space as formulas that end in two turns after three joints in one plane, such as those of
Universal Robots.

Axis 5 lies in the plane of the joints before it, and meets axis 6 at right angles in a point, which
turns of neither move: it gives the first coordinate. How axis 6 stands to the plane gives the
fifth, how the tip sees the normal of the plane the sixth, and axis 6 in the plane the turn of the
fourth body, with which three joints in a plane are left (Hawkins 2013, "Analytic inverse kinematics
for the Universal Robots UR-5/UR-10 arms", does so in DH parameters).
"""

from __future__ import annotations

from typing import Any

from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.plane_steps import Names
from kempe.kinematics.formulas.symbolic_dh import JointLine
from kempe.solvers.analytic.describe.arm_plane import (
    ArmPlane,
    Z,
    meeting,
    normal_of,
    parallel,
    upright,
)


class ParallelArm(ArmPlane):
    """Three joints in the plane that the first turns, and two turns whose axes meet in the end."""

    @classmethod
    def of(cls, joints: list[JointLine], tip: Any) -> ParallelArm | None:
        """The arm of six joints; None if it is not of this kind."""
        if len(joints) != 6 or not joints[0].turns or not parallel(joints[0].along, Z):
            return None
        normal = normal_of(joints[1:4])
        end = meeting(*joints[4:])
        if normal is None or end is None or not upright(joints[4].along, normal):
            return None
        return cls(tuple(joints), normal, end, tip)

    def steps(self, to: list[Any], R: Any, names: dict[str, Any], n: Names) -> list[FormulaStep]:
        """The first coordinate, the last two, and those between."""
        lift = names["phi"]
        hand = self.wrist(
            self.first_turn(),
            self.normal,
            "the normal of the plane",
            (lift, "turn of the fourth body in the plane"),
            R,
            names,
        )
        return [*self.turned_to(to, names), *hand, *self.placed(3, to[2], lift, names, n)]
