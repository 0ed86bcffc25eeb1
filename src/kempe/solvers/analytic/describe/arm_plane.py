"""What arms in space have in common whose first turn is about z: joints in the plane that it turns
to the target.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kempe.kinematics.formulas.derivation import FormulaStep
from kempe.kinematics.formulas.plane_steps import Names, Vector, polar
from kempe.kinematics.formulas.symbolic_dh import JointLine, angle_about, tidy
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.solvers.analytic.describe.plane_arms import PlaneJoint, in_plane

SMALL = 1e-9
"""Sine of an angle, and a cosine, below which directions are parallel or at right angles."""
OWN = (
    "rho",
    "theta",
    "phi",
    *(f"m_{k}" for k in (1, 2, 3)),
    *(f"n_{k}" for k in (2, 3)),
    "h_x",
    "h_z",
    "shoulder",
    "elbow",
    "wrist",
)
"""Names of what is computed, and of the signs."""
Z: Any = sympy.Matrix([0, 0, 1])
BEND = "the bend, +1 in the sense of the first turn in the plane"
PLACES = ("first", "second", "third", "fourth")
"""Numbers of the joints that place the end, in words."""


@dataclass(frozen=True)
class ArmPlane:
    """The lines of an arm at q = 0: the plane of the joints after the first has the `normal`, and
    `out` is in it.

    `end` is the point that they place.
    """

    joints: tuple[JointLine, ...]
    normal: Any
    end: Any
    tip: Any

    @property
    def out(self) -> Any:
        """The horizontal direction in the plane: turns about the normal lead from it upwards."""
        return Z.cross(self.normal)

    def steps(self, to: list[Any], R: Any, names: dict[str, Any], n: Names) -> list[FormulaStep]:
        """The steps to a place `to` (3,) of the end, and to the orientation R (3, 3) of the tip if
        it has a wrist.
        """
        raise NotImplementedError

    def turned_to(self, to: list[Any], names: dict[str, Any]) -> list[FormulaStep]:
        """The distance in the plane of the arm, and the first coordinate, which turns that plane to
        the target.
        """
        first = self.joints[0]
        rho = names["rho"]
        shoulder = names["shoulder"]
        x = to[0] - first.point[0]
        y = to[1] - first.point[1]
        aside = tidy(sympy.Matrix([self.normal.dot(self.end - first.point)]))[0]
        _, zero = polar((self.out[0], self.out[1]))
        squares = sympy.expand(aside**2)
        far = "" if squares.is_zero else f"{x**2 + y**2} >= {squares}"
        says = "distance from axis 1 in the plane of the arm, -1 over the shoulder"
        steps = [FormulaStep(rho, shoulder * sympy.sqrt(x**2 + y**2 - squares), says, far)]
        if squares.is_zero:
            angle = sympy.atan2(shoulder * y, shoulder * x)
            some = f"{rho} != 0"
        else:
            angle = sympy.atan2(y, x) + sympy.atan2(aside, rho)
            some = ""
        turn = first.along[2] * (angle - zero)
        steps.append(
            FormulaStep(sympy.Symbol(first.coordinate), turn, "turns the plane to the target", some)
        )
        return steps

    def placed(
        self, count: int, height: Any, angle: Any, names: dict[str, Any], n: Names
    ) -> list[FormulaStep]:
        """The coordinates of the `count` joints after the first: the end at a distance `rho` from
        axis 1, and a height.

        Three of them turn their last body by an angle, too.
        """
        joints = self.joints[1 : 1 + count]
        arm = [
            PlaneJoint(
                j.coordinate,
                self.flat(j.point - self.joints[0].point, j.point),
                j.turns,
                -1 if j.turns and float(j.along.dot(self.normal)) < 0.0 else 1,
                self.flat(j.along, j.along),
            )
            for j in joints
        ]
        end = self.flat(self.end - self.joints[0].point, self.end)
        steps, found = in_plane(
            n, arm, (names["rho"], height), end, angle, [names["h_x"], names["h_z"]], BEND
        )
        return steps + [
            FormulaStep(sympy.Symbol(j.coordinate), x, f"the {place} coordinate")
            for j, x, place in zip(joints, found, PLACES[1:], strict=False)
        ]

    def wrist(
        self, S: Any, a: Any, called: str, turn: tuple[Any, str], R: Any, names: dict[str, Any]
    ) -> list[FormulaStep]:
        """The last two coordinates, and the turn about the direction `a` before them, by the
        orientation R of the tip.

        S (3, 3) is how that is turned which `a`, `called` so, turns in; `turn` is the symbol of the
        turn, and in words.
        """
        five, six = self.joints[-2:]
        b = five.along
        c = six.along
        tip = self.tip[:3, :3]
        m = [names[f"m_{i}"] for i in (1, 2, 3)]
        k = [names[f"n_{i}"] for i in (2, 3)]
        wrist = names["wrist"]
        own = (
            (a, f"part of axis 6 along {called}"),
            (b, "along axis 5 at zero"),
            (tidy(a.cross(b)), "across both"),
        )
        far = (
            (b, f"part of {called} along axis 5 at zero, seen by the tip"),
            (tidy(c.cross(b)), "across both"),
        )
        seen = R * tidy(tip.T * c)
        steps = [
            FormulaStep(s, short((S * e).dot(seen)), says)
            for s, (e, says) in zip(m, own, strict=True)
        ]
        steps += [
            FormulaStep(s, short((S * a).dot(R * tidy(tip.T * e))), says)
            for s, (e, says) in zip(k, far, strict=True)
        ]
        some = f"{m[1]} != 0 or {m[2]} != 0"
        bend = sympy.atan2(wrist * sympy.sqrt(m[1] ** 2 + m[2] ** 2), m[0]) - angle_about(a, c, b)
        return steps + [
            FormulaStep(sympy.Symbol(five.coordinate), bend, "+1 is no flip, -1 flip"),
            FormulaStep(turn[0], sympy.atan2(wrist * m[1], -wrist * m[2]), turn[1], some),
            FormulaStep(
                sympy.Symbol(six.coordinate),
                sympy.atan2(wrist * k[0], wrist * k[1]),
                "the sixth coordinate",
                some,
            ),
        ]

    def flat(self, across: Any, up: Any) -> Vector:
        """Parts of a vector along `out`, and of another along z."""
        return tidy(sympy.Matrix([self.out.dot(across)]))[0], up[2]

    def first_turn(self) -> Any:
        """How the first body is turned (3, 3) against q = 0."""
        return turn_about(Z, self.joints[0].along[2] * sympy.Symbol(self.joints[0].coordinate))


def normal_of(joints: list[JointLine]) -> Any:
    """The horizontal normal (3,) of the plane in which joints turn and slide; None if there is no
    one plane.
    """
    turns = [j.along for j in joints if j.turns]
    across = turns or [Z.cross(j.along) for j in joints if not parallel(j.along, Z)]
    if not across:
        return None
    normal = tidy(across[0] / sympy.sqrt(across[0].dot(across[0])))
    flat = all(parallel(j.along, normal) if j.turns else upright(j.along, normal) for j in joints)
    return normal if flat and upright(normal, Z) else None


def turn_about(axis: Any, angle: Any) -> Any:
    """The matrix (3, 3) of a turn about a unit vector (Rodrigues, 1840)."""
    x, y, z = axis
    along = axis * axis.T
    across = sympy.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return along + sympy.cos(angle) * (sympy.eye(3) - along) + sympy.sin(angle) * across


def short(x: Any) -> Any:
    """The expression without products by zero and rounding, terms of a target's entry together."""
    x = tidy(sympy.Matrix([x]))[0]
    return sympy.collect(x, sorted((s for s in x.free_symbols if str(s).startswith("r_")), key=str))


def meeting(a: JointLine, b: JointLine) -> Any:
    """The point (3,) in which two axes at right angles meet; None for others."""
    if not (a.turns and b.turns and upright(a.along, b.along)):
        return None
    end = tidy(
        a.point + a.along * (b.point - a.point).dot(a.along)
    )  # where they would be nearest to each other
    return end if is_on(end, b) else None


def is_on(point: Any, line: JointLine) -> bool:
    """Whether a point is on the axis of a joint."""
    return tidy((point - line.point).cross(line.along)).is_zero_matrix


def parallel(a: Any, b: Any) -> bool:
    """Whether two unit vectors are parallel, in either sense."""
    return max(abs(float(x)) for x in a.cross(b)) < SMALL


def upright(a: Any, b: Any) -> bool:
    """Whether two unit vectors are at right angles."""
    return abs(float(a.dot(b))) < SMALL
