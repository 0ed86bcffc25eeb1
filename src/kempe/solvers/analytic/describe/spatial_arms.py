"""Arms in space as formulas: a first turn about z, two joints in the plane that it turns, perhaps a
wrist.

The wrist has three axes that meet in a point, which the first three joints place; the orientation
is left to the last three (Pieper, 1968; Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12).
"""

from __future__ import annotations

from typing import Any

from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.plane_steps import Names
from kempe.kinematics.formulas.symbolic_dh import JointLine
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.solvers.analytic.describe.arm_plane import (
    ArmPlane,
    Z,
    is_on,
    meeting,
    normal_of,
    parallel,
    turn_about,
    upright,
)


class SpatialArm(ArmPlane):
    """Three joints, which place the tip or the point in which the axes of the last three meet."""

    @classmethod
    def of(cls, joints: list[JointLine], tip: Any) -> SpatialArm | None:
        """The arm of three joints, or of six that end in a wrist; None if it is not of this kind."""
        if len(joints) not in (3, 6) or not joints[0].turns or not parallel(joints[0].along, Z):
            return None
        normal = normal_of(joints[1:3])
        end = tip[:3, 3] if len(joints) == 3 else _centre(*joints[3:])
        return None if normal is None or end is None else cls(tuple(joints), normal, end, tip)

    def steps(self, to: list[Any], R: Any, names: dict[str, Any], n: Names) -> list[FormulaStep]:
        """The first three coordinates, and those of the wrist."""
        three = [*self.turned_to(to, names), *self.placed(2, to[2], None, names, n)]
        if not R:
            return three
        four = self.joints[3]
        turn = (sympy.Symbol(four.coordinate), "the fourth coordinate")
        return three + self.wrist(self._third(), four.along, "axis 4", turn, R, names)

    def _third(self) -> Any:
        """How the third body is turned (3, 3) against q = 0."""
        lift = sum(
            (
                int(round(float(j.along.dot(self.normal)))) * sympy.Symbol(j.coordinate)
                for j in self.joints[1:3]
                if j.turns
            ),
            sympy.Integer(0),
        )
        return self.first_turn() * turn_about(self.normal, lift)


def _centre(a: JointLine, b: JointLine, c: JointLine) -> Any:
    """The point (3,) in which the axes of a wrist meet, the middle one at right angles to both;
    None for others.
    """
    end = meeting(a, b)
    return (
        end if end is not None and c.turns and upright(b.along, c.along) and is_on(end, c) else None
    )
