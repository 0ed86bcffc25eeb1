"""Arms in space as formulas that end in two turns after three joints in one plane, such as those of Universal Robots.

Axis 5 lies in the plane of the joints before it, and meets axis 6 at right angles in a point, which turns of neither
move: it gives the first coordinate. How axis 6 stands to the plane gives the fifth, how the tip sees the normal of the
plane the sixth, and axis 6 in the plane the turn of the fourth body, with which three joints in a plane are left
(Hawkins 2013, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", does so in DH parameters).
"""

from __future__ import annotations

from typing import Any

from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.plane_steps import Names
from kempe.kinematics.formulas.symbolic_dh import JointLine, tidy
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.solvers.analytic.describe.arm_plane import (
    ArmPlane,
    Z,
    less_zero,
    meeting,
    normal_of,
    parallel,
    short,
    upright,
)


class ParallelArm(ArmPlane):
    """Three joints in the plane that the first turns, and two turns whose axes meet in the end."""

    @classmethod
    def of(cls, joints: list[JointLine], tip: Any) -> ParallelArm | None:
        """The arm of six joints; None if it is not of this kind."""
        if len(joints) != 6 or not joints[0].turns or not parallel(joints[0].along, Z):
            return None
        normal, end = normal_of(joints[1:4]), meeting(*joints[4:])
        if normal is None or end is None or not upright(joints[4].along, normal):
            return None
        return cls(tuple(joints), normal, end, tip)

    def steps(self, to: list[Any], R: Any, names: dict[str, Any], n: Names) -> list[FormulaStep]:
        """The first coordinate, the last two, and those between."""
        lift, hand = self._hand(R, names)
        return [*self.turned_to(to, names), *hand, *self.placed(3, to[2], lift, names, n)]

    def _hand(self, R: Any, names: dict[str, Any]) -> tuple[Any, list[FormulaStep]]:
        """The turn of the fourth body in the plane, and the steps to it and to the last two coordinates."""
        five, six = self.joints[4:]
        b, c, tip = five.along, six.along, self.tip[:3, :3]
        m, k, wrist = [names[f"m_{i}"] for i in (1, 2, 3)], [names[f"n_{i}"] for i in (2, 3)], names["wrist"]
        S, seen = self.first_turn(), R * tidy(tip.T * c)
        own = ((self.normal, "part of axis 6 across the plane"), (self.out, "horizontal, in the plane"), (Z, "upright"))
        far = ((tidy(b.cross(c)), "part across the plane of a direction across axes 5 and 6"), (b, "of axis 5 at zero"))
        steps = [FormulaStep(s, short((S * e).dot(seen)), says) for s, (e, says) in zip(m, own, strict=True)]
        steps += [FormulaStep(s, short((S * self.normal).dot(R * tidy(tip.T * e))), says)
                  for s, (e, says) in zip(k, far, strict=True)]  # fmt: skip
        zero, flat = sympy.atan2(b.dot(self.normal.cross(c)), self.normal.dot(c)), tidy(b.cross(self.normal))
        bend, some = sympy.atan2(wrist * sympy.sqrt(m[1] ** 2 + m[2] ** 2), m[0]), f"{m[1]} != 0 or {m[2]} != 0"
        upwards = less_zero(sympy.atan2(wrist * m[2], wrist * m[1]), sympy.atan2(flat[2], self.out.dot(flat)))
        steps += [
            FormulaStep(sympy.Symbol(five.coordinate), less_zero(bend, zero), "+1 is no flip, -1 flip"),
            FormulaStep(sympy.Symbol(six.coordinate), sympy.atan2(wrist * k[1], -wrist * k[0]), "the sixth coordinate",
                        some),
            FormulaStep(names["phi"], upwards, "turn of the fourth body in the plane", some),
        ]  # fmt: skip
        return names["phi"], steps
