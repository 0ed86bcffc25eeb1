"""Arms in space as formulas: a first turn about z, two joints in the plane that it turns, perhaps a wrist.

The wrist has three axes that meet in a point, which the first three joints place; the orientation is left to the last
three (Pieper, 1968; Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.plane_steps import Names, polar
from kempe.kinematics.formulas.symbolic_dh import JointLine, tidy
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.solvers.analytic.describe.plane_arms import PlaneJoint, solved

SMALL = 1e-9
"""Sine of an angle, and a cosine, below which directions are parallel or at right angles."""
OWN = ("rho", "theta", *(f"m_{k}" for k in (1, 2, 3)), *(f"n_{k}" for k in (2, 3)), "shoulder", "elbow", "wrist")
"""Names of what is computed, and of the signs."""
Z: Any = sympy.Matrix([0, 0, 1])
BEND = "the bend, +1 in the sense of the first turn in the plane"


@dataclass(frozen=True)
class SpatialArm:
    """The lines of an arm at q = 0: the plane of its second and third joint has the `normal`, and `out` is in it.

    `end` is the point that the first three joints place: that where the axes of the wrist meet, or the tip.
    """

    joints: tuple[JointLine, ...]
    normal: Any
    end: Any
    tip: Any

    @property
    def out(self) -> Any:
        """The horizontal direction in the plane: turns about the normal lead from it upwards."""
        return Z.cross(self.normal)

    @classmethod
    def of(cls, joints: list[JointLine], tip: Any) -> SpatialArm | None:
        """The arm of three joints, or of six that end in a wrist; None if it is not of this kind."""
        if len(joints) not in (3, 6) or not joints[0].turns or not _parallel(joints[0].along, Z):
            return None
        one, two = joints[1:3]
        turns = [j.along for j in (one, two) if j.turns]
        across = turns or [Z.cross(j.along) for j in (one, two) if not _parallel(j.along, Z)]
        if not across:
            return None
        normal = tidy(across[0] / sympy.sqrt(across[0].dot(across[0])))
        flat = all(_parallel(j.along, normal) if j.turns else _upright(j.along, normal) for j in (one, two))
        end = tip[:3, 3] if len(joints) == 3 else _meeting(joints[3:])
        if not _upright(normal, Z) or not flat or end is None:
            return None
        return cls(tuple(joints), normal, end, tip)

    def steps(self, to: list[Any], R: Any, names: dict[str, Any], n: Names) -> list[FormulaStep]:
        """The steps to a place `to` (3,) of the end, and to the orientation R (3, 3) of the tip if there is a wrist."""
        return [*self._turned(to, names), *self._in_plane(to, names, n), *(self._wrist(R, names) if R else [])]

    # ---- the first three joints

    def _turned(self, to: list[Any], names: dict[str, Any]) -> list[FormulaStep]:
        """The distance in the plane of the arm, and the first coordinate, which turns that plane to the target."""
        first, rho, shoulder = self.joints[0], names["rho"], names["shoulder"]
        x, y = to[0] - first.point[0], to[1] - first.point[1]
        aside = tidy(sympy.Matrix([self.normal.dot(self.end - first.point)]))[0]
        _, zero = polar((self.out[0], self.out[1]))
        squares = sympy.expand(aside**2)
        far = "" if squares.is_zero else f"{x**2 + y**2} >= {squares}"
        says = "distance from axis 1 in the plane of the arm, -1 over the shoulder"
        steps = [FormulaStep(rho, shoulder * sympy.sqrt(x**2 + y**2 - squares), says, far)]
        if squares.is_zero:
            angle, some = sympy.atan2(shoulder * y, shoulder * x), f"{rho} != 0"
        else:
            angle, some = sympy.atan2(y, x) + sympy.atan2(aside, rho), ""
        turn = first.along[2] * (angle - zero)
        steps.append(FormulaStep(sympy.Symbol(first.coordinate), turn, "turns the plane to the target", some))
        return steps

    def _in_plane(self, to: list[Any], names: dict[str, Any], n: Names) -> list[FormulaStep]:
        """The second and third coordinate, in the plane of the arm: the distance from axis 1 and the height."""
        pair = self.joints[1:3]
        flat = [PlaneJoint(j.coordinate, self._flat(j.point - self.joints[0].point, j.point), j.turns,
                           -1 if j.turns and float(j.along.dot(self.normal)) < 0.0 else 1, self._flat(j.along, j.along))
                for j in pair]  # fmt: skip
        end = self._flat(self.end - self.joints[0].point, self.end)
        steps, found = solved(n, flat, (names["rho"], to[2]), end, None, BEND)
        return steps + [FormulaStep(sympy.Symbol(j.coordinate), x, f"the {place} coordinate")
                        for j, x, place in zip(pair, found, ("second", "third"), strict=True)]  # fmt: skip

    def _flat(self, across: Any, up: Any) -> tuple[Any, Any]:
        """Parts of a vector along `out`, and of another along z."""
        return tidy(sympy.Matrix([self.out.dot(across)]))[0], up[2]

    # ---- the wrist

    def _wrist(self, R: Any, names: dict[str, Any]) -> list[FormulaStep]:
        """The last three coordinates: the parts of axis 6 along axes 4, 5 and across, as the third body sees them."""
        four, five, six = self.joints[3:]
        a, b, c, tip = four.along, five.along, six.along, self.tip[:3, :3]
        m, k, wrist = [names[f"m_{i}"] for i in (1, 2, 3)], [names[f"n_{i}"] for i in (2, 3)], names["wrist"]
        S, seen = self._third(), R * tidy(tip.T * c)
        own = ((a, "part of axis 6 along axis 4"), (b, "along axis 5 at zero"), (tidy(a.cross(b)), "across both"))
        far = ((b, "part of axis 4 along axis 5 at zero, seen by the tip"), (tidy(c.cross(b)), "across both"))
        steps = [FormulaStep(s, _short((S * e).dot(seen)), says) for s, (e, says) in zip(m, own, strict=True)]
        steps += [FormulaStep(s, _short((S * a).dot(R * tidy(tip.T * e))), says)
                  for s, (e, says) in zip(k, far, strict=True)]  # fmt: skip
        zero = sympy.atan2(b.dot(a.cross(c)), a.dot(c))
        bend = sympy.atan2(wrist * sympy.sqrt(m[1] ** 2 + m[2] ** 2), m[0])
        turns = (bend - (0 if abs(float(zero)) < SMALL else zero), sympy.atan2(wrist * m[1], -wrist * m[2]),
                 sympy.atan2(wrist * k[0], wrist * k[1]))  # fmt: skip
        says = ("+1 is no flip, -1 flip", "the fourth coordinate", "the sixth coordinate")
        some = f"{m[1]} != 0 or {m[2]} != 0"
        return steps + [FormulaStep(sympy.Symbol(j.coordinate), x, w, "" if j is five else some)
                        for j, x, w in zip((five, four, six), turns, says, strict=True)]  # fmt: skip

    def _third(self) -> Any:
        """How the third body is turned (3, 3) against q = 0."""
        first = self.joints[0]
        lift = sum((int(round(float(j.along.dot(self.normal)))) * sympy.Symbol(j.coordinate)
                    for j in self.joints[1:3] if j.turns), sympy.Integer(0))  # fmt: skip
        return _turn(Z, first.along[2] * sympy.Symbol(first.coordinate)) * _turn(self.normal, lift)


def _turn(axis: Any, angle: Any) -> Any:
    """The matrix (3, 3) of a turn about a unit vector (Rodrigues, 1840)."""
    x, y, z = axis
    along, across = axis * axis.T, sympy.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return along + sympy.cos(angle) * (sympy.eye(3) - along) + sympy.sin(angle) * across


def _short(x: Any) -> Any:
    """The expression without products by zero and rounding, terms of a target's entry together."""
    x = tidy(sympy.Matrix([x]))[0]
    return sympy.collect(x, sorted((s for s in x.free_symbols if str(s).startswith("r_")), key=str))


def _meeting(lines: list[JointLine]) -> Any:
    """The point (3,) in which the axes of a wrist meet, the middle one at right angles to both; None for others."""
    a, b, c = lines
    if not (a.turns and b.turns and c.turns and _upright(a.along, b.along) and _upright(b.along, c.along)):
        return None
    gap = b.point - a.point
    end = tidy(a.point + a.along * gap.dot(a.along))  # axes at right angles meet where that is nearest to the other
    aside = [tidy((end - line.point).cross(line.along)) for line in (b, c)]
    return end if all(v.is_zero_matrix for v in aside) else None


def _parallel(a: Any, b: Any) -> bool:
    return max(abs(float(x)) for x in a.cross(b)) < SMALL


def _upright(a: Any, b: Any) -> bool:
    return abs(float(a.dot(b))) < SMALL
