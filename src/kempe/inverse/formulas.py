"""Inverse kinematics as formulas, in the steps of a derivation on paper.

It knows planar arms, SCARAs, and arms in space with a wrist or with parallel axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.derivation import (
    Derivation,
    FormulaStep,
    Names,
    Vector,
    add_vectors,
    iterate_endings,
    rotate_vector,
    solve_slide_and_bar,
    solve_turning_slide,
    solve_two_bars,
    solve_two_slides,
    subtract_vectors,
    to_polar_coordinates,
)
from kempe.arguments import explain_errors, numbers
from kempe.arrays import is_whole
from kempe.equations.closure_rows import list_constraints
from kempe.errors import InputError, UnsupportedError, format_value
from kempe.forward.joint_lines import JointLine
from kempe.forward.symbolic import SymbolLeaves, sympy
from kempe.forward.symbolic_dh import derive_angle, derive_joint_lines, tidy_matrix
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- planar arms of two or three joints

# The triangle that joints and target make is solved step by step.

ELBOW = "-1 is elbow up, +1 elbow down"


def make_planar_line(joint: JointLine) -> JointLine:
    """Make the line of a joint of the plane z = 0, with pairs of x and y.

    `rate` is the sense of a turn.
    """
    return joint._replace(
        point=(joint.point[0], joint.point[1]),
        direction=(joint.direction[0], joint.direction[1]),
        rate=int(joint.direction[2]) if joint.turns else 1,
    )


def solve_planar_pose(
    n: Names,
    arm: list[JointLine],
    to: Vector,
    end: Vector,
    angle: Any,
    names: list[Any],
    elbow: str = ELBOW,
) -> tuple[list[FormulaStep], list[Any]]:
    """Solve a planar arm for a pose, from the place of its last joint, which turns.

    Steps and coordinates are as in `solve_planar_arm`; `names` are names of that place.
    """
    steps = list[FormulaStep]()
    if angle is not None and arm[-1].turns:
        place = subtract_vectors(to, rotate_vector(subtract_vectors(end, arm[-1].point), angle))
        if place != to:
            steps = [
                FormulaStep(s, x, "the target, less the last link")
                for s, x in zip(names, place, strict=True)
            ]
            to = (steps[0].symbol, steps[1].symbol)
        end = arm[-1].point
    more, found = solve_planar_arm(n, arm, to, end, angle, elbow)
    return steps + more, found


def solve_planar_arm(
    n: Names, arm: list[JointLine], to: Vector, end: Vector, angle: Any, elbow: str
) -> tuple[list[FormulaStep], list[Any]]:
    """Solve two or three joints that bring the point `end` to `to`: steps and coordinates.

    The last body is turned by `angle`.

    `elbow` says what the sign of two turns is.
    """
    kinds = "".join("RP"[not j.turns] for j in arm)
    one = arm[0]
    two = arm[1]
    if any(
        one.turns and two.turns and set(subtract_vectors(two.point, one.point)) == {0}
        for one, two in pairwise(arm)
    ):
        raise UnsupportedError(
            "two turns are about one axis, which leaves a joint to spare; ik_all gives families"
        )
    if kinds in ("RR", "RRR"):
        (l1, at1) = to_polar_coordinates(subtract_vectors(two.point, one.point))
        (l2, at2) = to_polar_coordinates(subtract_vectors(end, two.point))
        steps, first, bend = solve_two_bars(
            n, subtract_vectors(to, one.point), l1, l2, elbow, int(one.rate)
        )
        turns = [first - at1, bend - (at2 - at1)]
        return steps, _list_turn_coordinates(arm, turns, angle)
    if kinds in ("RP", "RPR"):
        gap = subtract_vectors(end, one.point)
        (_, at) = to_polar_coordinates(two.direction)
        ahead, aside = _split_vector(gap, two.direction)
        steps, u, rail = solve_turning_slide(n, subtract_vectors(to, one.point), aside)
        turn = rail - at
        return steps, [
            one.rate * turn,
            u - ahead,
            *([arm[2].rate * (angle - turn)] if kinds == "RPR" else []),
        ]
    if kinds in ("PR", "PRR"):
        length, at = to_polar_coordinates(subtract_vectors(end, two.point))
        steps, u, bar = solve_slide_and_bar(
            n, subtract_vectors(to, two.point), one.direction, length
        )
        turn = bar - at
        return steps, [
            u,
            two.rate * turn,
            *([arm[2].rate * (angle - turn)] if kinds == "PRR" else []),
        ]
    if kinds == "RRP":  # the orientation is that of the second body
        length, at = to_polar_coordinates(subtract_vectors(two.point, one.point))
        rest = subtract_vectors(
            subtract_vectors(to, one.point), rotate_vector(subtract_vectors(end, two.point), angle)
        )
        steps, u, bar = solve_slide_and_bar(n, rest, rotate_vector(arm[2].direction, angle), length)
        turn = bar - at
        return steps, [one.rate * turn, two.rate * (angle - turn), u]
    if kinds in ("PP", "PPR"):
        steps, u1, u2 = solve_two_slides(n, subtract_vectors(to, end), one.direction, two.direction)
        return steps, [u1, u2, *([arm[2].rate * angle] if kinds == "PPR" else [])]
    if kinds == "RPP":
        rest = subtract_vectors(
            rotate_vector(subtract_vectors(to, one.point), -angle), subtract_vectors(end, one.point)
        )
        steps, u2, u3 = solve_two_slides(n, rest, two.direction, arm[2].direction)
        return steps, [one.rate * angle, u2, u3]
    if kinds == "PRP":
        rest = subtract_vectors(
            to, add_vectors(two.point, rotate_vector(subtract_vectors(end, two.point), angle))
        )
        steps, u1, u3 = solve_two_slides(
            n, rest, one.direction, rotate_vector(arm[2].direction, angle)
        )
        return steps, [u1, two.rate * angle, u3]
    raise UnsupportedError(
        "formulas need a joint that turns where an angle is wanted; ik_all gives numbers"
    )


def _list_turn_coordinates(arm: list[JointLine], turns: list[Any], angle: Any) -> list[Any]:
    """List the coordinates of turning joints, the last one from the remaining angle."""
    last = [] if angle is None else [angle - sum(turns)]
    return [j.rate * x for j, x in zip(arm, [*turns, *last], strict=True)]


def _split_vector(v: Vector, along: Vector) -> tuple[Any, Any]:
    """Split a vector into its parts along a direction and to the left of it."""
    return v[0] * along[0] + v[1] * along[1], along[0] * v[1] - along[1] * v[0]


# ---- arms in space: the plane that the first joint turns to the target

# The first turn is about z; joints after it move in the plane.

SMALL = 1e-9
"""Sine of an angle, and a cosine, below which directions are parallel or at right angles."""
PLANE_SYMBOLS = (
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
    """The lines of an arm at q = 0: joints after the first move in one plane.

    The plane has the `normal`.

    `end` is the point that they place.
    """

    joints: tuple[JointLine, ...]
    normal: Any
    end: Any
    tip: Any

    @property
    def outward_direction(self) -> Any:
        """Horizontal direction in the plane; turns about the normal lead upwards from it."""
        return Z.cross(self.normal)

    def list_solution_steps(
        self, to: list[Any], R: Any, names: dict[str, Any], n: Names
    ) -> list[FormulaStep]:
        """List the steps to a place `to` (3,) of the end and an orientation R (3, 3) of the tip.

        Only arms with a wrist have the orientation.
        """
        raise NotImplementedError

    def derive_first_turn(self, to: list[Any], names: dict[str, Any]) -> list[FormulaStep]:
        """Derive the distance in the arm's plane, and the first coordinate, which turns the plane."""
        first = self.joints[0]
        rho = names["rho"]
        shoulder = names["shoulder"]
        x = to[0] - first.point[0]
        y = to[1] - first.point[1]
        aside = tidy_matrix(sympy.Matrix([self.normal.dot(self.end - first.point)]))[0]
        _, zero = to_polar_coordinates((self.outward_direction[0], self.outward_direction[1]))
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
        turn = first.direction[2] * (angle - zero)
        steps.append(
            FormulaStep(sympy.Symbol(first.coordinate), turn, "turns the plane to the target", some)
        )
        return steps

    def derive_planar_joints(
        self, count: int, height: Any, angle: Any, names: dict[str, Any], n: Names
    ) -> list[FormulaStep]:
        """Derive the `count` coordinates after the first.

        The end is at the distance `rho` from axis 1, and at a height.

        Three of them turn their last body by an angle, too.
        """
        joints = self.joints[1 : 1 + count]
        arm = [
            j._replace(
                point=self.project_to_plane(j.point - self.joints[0].point, j.point),
                direction=self.project_to_plane(j.direction, j.direction),
                rate=-1 if j.turns and float(j.direction.dot(self.normal)) < 0.0 else 1,
            )
            for j in joints
        ]
        end = self.project_to_plane(self.end - self.joints[0].point, self.end)
        steps, found = solve_planar_pose(
            n, arm, (names["rho"], height), end, angle, [names["h_x"], names["h_z"]], BEND
        )
        return steps + [
            FormulaStep(sympy.Symbol(j.coordinate), x, f"the {place} coordinate")
            for j, x, place in zip(joints, found, PLACES[1:], strict=False)
        ]

    def derive_wrist(
        self, S: Any, a: Any, called: str, turn: tuple[Any, str], R: Any, names: dict[str, Any]
    ) -> list[FormulaStep]:
        """Derive the last two coordinates, and the turn about `a` before them, from orientation R.

        S (3, 3) is how that is turned which `a`, `called` so, turns in; `turn` is the symbol of the
        turn, and in words.
        """
        five, six = self.joints[-2:]
        b = five.direction
        c = six.direction
        tip = self.tip[:3, :3]
        m = [names[f"m_{i}"] for i in (1, 2, 3)]
        k = [names[f"n_{i}"] for i in (2, 3)]
        wrist = names["wrist"]
        own = (
            (a, f"part of axis 6 along {called}"),
            (b, "along axis 5 at zero"),
            (tidy_matrix(a.cross(b)), "across both"),
        )
        far = (
            (b, f"part of {called} along axis 5 at zero, seen by the tip"),
            (tidy_matrix(c.cross(b)), "across both"),
        )
        seen = R * tidy_matrix(tip.T * c)
        steps = [
            FormulaStep(s, simplify_expression((S * e).dot(seen)), says)
            for s, (e, says) in zip(m, own, strict=True)
        ]
        steps += [
            FormulaStep(s, simplify_expression((S * a).dot(R * tidy_matrix(tip.T * e))), says)
            for s, (e, says) in zip(k, far, strict=True)
        ]
        some = f"{m[1]} != 0 or {m[2]} != 0"
        bend = sympy.atan2(wrist * sympy.sqrt(m[1] ** 2 + m[2] ** 2), m[0]) - derive_angle(a, c, b)
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

    def project_to_plane(self, across: Any, up: Any) -> Vector:
        """Project vectors to the plane: `across` to the outward direction, `up` to z."""
        return tidy_matrix(sympy.Matrix([self.outward_direction.dot(across)]))[0], up[2]

    def build_first_rotation(self) -> Any:
        """Build the rotation (3, 3) of the first body against q = 0."""
        return build_rotation(
            Z, self.joints[0].direction[2] * sympy.Symbol(self.joints[0].coordinate)
        )


def find_normal(joints: list[JointLine]) -> Any:
    """Find the horizontal normal (3,) of the plane in which joints move; None if there is none."""
    turns = [j.direction for j in joints if j.turns]
    across = turns or [Z.cross(j.direction) for j in joints if not are_parallel(j.direction, Z)]
    if not across:
        return None
    normal = tidy_matrix(across[0] / sympy.sqrt(across[0].dot(across[0])))
    flat = all(
        are_parallel(j.direction, normal) if j.turns else are_perpendicular(j.direction, normal)
        for j in joints
    )
    return normal if flat and are_perpendicular(normal, Z) else None


def build_rotation(axis: Any, angle: Any) -> Any:
    """Build the matrix (3, 3) of a turn about a unit vector (Rodrigues, 1840)."""
    x, y, z = axis
    along = axis * axis.T
    across = sympy.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return along + sympy.cos(angle) * (sympy.eye(3) - along) + sympy.sin(angle) * across


def simplify_expression(x: Any) -> Any:
    """Simplify an expression: no products by zero, no rounding, terms of an entry together."""
    x = tidy_matrix(sympy.Matrix([x]))[0]
    return sympy.collect(x, sorted((s for s in x.free_symbols if str(s).startswith("r_")), key=str))


def find_meeting_point(a: JointLine, b: JointLine) -> Any:
    """Find the point (3,) in which two perpendicular axes meet; None for others."""
    if not (a.turns and b.turns and are_perpendicular(a.direction, b.direction)):
        return None
    # where they would be nearest to each other
    end = tidy_matrix(a.point + a.direction * (b.point - a.point).dot(a.direction))
    return end if is_on_axis(end, b) else None


def is_on_axis(point: Any, line: JointLine) -> bool:
    """Return whether a point is on the axis of a joint."""
    return tidy_matrix((point - line.point).cross(line.direction)).is_zero_matrix


def are_parallel(a: Any, b: Any) -> bool:
    """Return whether two unit vectors are parallel, in either sense."""
    return max(abs(float(x)) for x in a.cross(b)) < SMALL


def are_perpendicular(a: Any, b: Any) -> bool:
    """Return whether two unit vectors are perpendicular."""
    return abs(float(a.dot(b))) < SMALL


# ---- arms in space with parallel axes, such as those of Universal Robots

# Two turns follow three joints in one plane. Axis 5 lies in the plane of the joints before it, and
# meets axis 6 at right angles in a point, which turns of neither move: it gives the first
# coordinate. How axis 6 stands to the plane gives the fifth, how the tip sees the normal of the
# plane the sixth, and axis 6 in the plane the turn of the fourth body, with which three joints in a
# plane are left (Hawkins 2013, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10
# arms", does so in DH parameters).


class ParallelArm(ArmPlane):
    """An arm of six joints: three parallel axes, and two wrist axes that meet in the end."""

    @classmethod
    def from_joints(cls, joints: list[JointLine], tip: Any) -> ParallelArm | None:
        """Make the arm from its six joints; None if it is not of this kind."""
        if len(joints) != 6 or not joints[0].turns or not are_parallel(joints[0].direction, Z):
            return None
        normal = find_normal(joints[1:4])
        end = find_meeting_point(*joints[4:])
        if normal is None or end is None or not are_perpendicular(joints[4].direction, normal):
            return None
        return cls(tuple(joints), normal, end, tip)

    def list_solution_steps(
        self, to: list[Any], R: Any, names: dict[str, Any], n: Names
    ) -> list[FormulaStep]:
        """List the steps: the first coordinate, the last two, and those between."""
        lift = names["phi"]
        hand = self.derive_wrist(
            self.build_first_rotation(),
            self.normal,
            "the normal of the plane",
            (lift, "turn of the fourth body in the plane"),
            R,
            names,
        )
        return [
            *self.derive_first_turn(to, names),
            *hand,
            *self.derive_planar_joints(3, to[2], lift, names, n),
        ]


# ---- arms in space of three joints, or six with a wrist

# A first turn about z is followed by two joints in the plane that it turns, perhaps by a wrist. The
# wrist has three axes that meet in a point, which the first three joints place; the orientation is
# left to the last three (Pieper, 1968; Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12).


class SpatialArm(ArmPlane):
    """An arm of three joints that place the tip, or the centre of a spherical wrist."""

    @classmethod
    def from_joints(cls, joints: list[JointLine], tip: Any) -> SpatialArm | None:
        """Make the arm from three joints, or six with a wrist; None if it is not of this kind."""
        if (
            len(joints) not in (3, 6)
            or not joints[0].turns
            or not are_parallel(joints[0].direction, Z)
        ):
            return None
        normal = find_normal(joints[1:3])
        end = tip[:3, 3] if len(joints) == 3 else _find_wrist_centre(*joints[3:])
        return None if normal is None or end is None else cls(tuple(joints), normal, end, tip)

    def list_solution_steps(
        self, to: list[Any], R: Any, names: dict[str, Any], n: Names
    ) -> list[FormulaStep]:
        """List the steps: the first three coordinates, and those of the wrist."""
        three = [
            *self.derive_first_turn(to, names),
            *self.derive_planar_joints(2, to[2], None, names, n),
        ]
        if not R:
            return three
        four = self.joints[3]
        turn = (sympy.Symbol(four.coordinate), "the fourth coordinate")
        return three + self.derive_wrist(
            self._build_third_rotation(), four.direction, "axis 4", turn, R, names
        )

    def _build_third_rotation(self) -> Any:
        """Build the rotation (3, 3) of the third body against q = 0."""
        lift = sum(
            (
                int(round(float(j.direction.dot(self.normal)))) * sympy.Symbol(j.coordinate)
                for j in self.joints[1:3]
                if j.turns
            ),
            sympy.Integer(0),
        )
        return self.build_first_rotation() * build_rotation(self.normal, lift)


def _find_wrist_centre(a: JointLine, b: JointLine, c: JointLine) -> Any:
    """Find the point (3,) in which the axes of a wrist meet; None for others.

    The middle axis is perpendicular to both others.
    """
    end = find_meeting_point(a, b)
    return (
        end
        if end is not None
        and c.turns
        and are_perpendicular(b.direction, c.direction)
        and is_on_axis(end, c)
        else None
    )


# ---- formulas of a system

TASKS = {2: "position", 3: "pose"}
"""What a chain of so many joints that move in the plane can reach."""
SPATIAL = {3: "position", 6: "pose"}
"""What an arm in space of so many joints can reach."""
OWN = ("p_x", "p_y", "p_z", "phi", "w_x", "w_y", "w_z")
"""Names of the target, and of the place of the last joint, or of the wrist."""
TURNED = tuple(f"r_{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
"""Names of the entries of a target's rotation matrix."""


@dataclass(frozen=True, eq=False)
class InverseFormulas(Derivation):
    """Formulas of inverse kinematics, with symbols for the target and for signs of branches.

    The symbol `sign` is -1 for elbow up and +1 for elbow down, as `ik_all` names them.

    Of an arm with a slide it is +1 where that is farther than where both solutions meet; two slides
    have one solution. An arm in space has up to three: `shoulder`, `elbow` (or its slide) and
    `wrist`, +1 without a flip.
    """

    @property
    def target(self) -> tuple[Any, ...]:
        """Symbols of the target: p_x, p_y, in space p_z, and for a pose phi, or r_11 to r_33."""
        return self.given

    def __call__(self, p: ArrayLike, sign: Any = 1) -> Array:
        """Evaluate the coordinates (..., n), radians and metres, for positions or planar poses.

        Positions are (..., 2), planar poses x, y and angle (..., 3).

        Where a joint slides along z the height comes after x and y: (..., 3) or x, y, z and angle
        (..., 4). The angle is that of the frame's x axis. Of an arm in space targets are positions
        (..., 3), and `sign` has one -1 or 1 for each of its signs, or is one for all. Poses (...,
        4, 4) say all of it. They are nan where the target is out of reach.
        """
        if len(self.given) > len(TURNED):
            X = numbers(p, "p", 4, 4)
            at = np.concatenate([X[..., :3, 3], X[..., :3, :3].reshape(*X.shape[:-2], 9)], axis=-1)
        else:
            at = numbers(self._read_poses(p), "p", len(self.given))
        many: Any = sign
        several = isinstance(sign, (tuple, list, np.ndarray))
        most = max(len(self.signs), 1)
        signs: list[Any] = list(many) if several else [many] * most
        if not all(is_whole(s) and s in (-1, 1) for s in signs):
            elbows = (" (elbow up)", " (elbow down)") if len(self.signs) < 2 else ("", "")
            raise InputError(
                f"sign is {format_value(sign)}; it must be -1{elbows[0]} or 1{elbows[1]}"
            )
        if len(signs) != most:
            raise InputError(
                f"sign is {format_value(sign)}; it must be one number, or {len(self.signs)}: "
                f"{', '.join(map(str, self.signs))}"
            )
        signs = signs[: len(self.signs)]
        return self.evaluate(
            at, np.broadcast_to(np.array(signs, dtype=float), at.shape[:-1] + (len(signs),))
        )

    def _read_poses(self, p: ArrayLike) -> ArrayLike:
        """Read the numbers of the formulas from poses (..., 4, 4); return other input unchanged."""
        X = np.asarray(p)
        if (
            X.shape[-2:] != (4, 4)
            or X.dtype.kind not in "fi"
            or not np.all(X[..., 3, :] == (0.0, 0.0, 0.0, 1.0))
        ):
            return p
        angle = np.arctan2(X[..., 1, 0], X[..., 0, 0])
        place = X[..., : len(self.given) - ("phi" in str(self.given[-1])), 3]
        return np.concatenate([place, angle[..., None]], axis=-1)[..., : len(self.given)]


@explain_errors
def derive_ik(
    system: Model,
    frame: FrameLike,
    task: str | None = None,
    *,
    symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> InverseFormulas:
    """Derive formulas of inverse kinematics for planar arms, SCARAs and simple arms in space.

    Arms in space need a wrist or three parallel axes.

    In the plane two joints reach a "position", three a "pose" x, y, angle: they turn about z or -z
    of the ground, or slide across it. One more may slide along it, at any place, as of a SCARA,
    which then reaches a height, too. Of two turns, the position is squared and summed, which leaves
    the second angle; its sine has two signs, the two elbows; the first is the difference of two
    angles (Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12.1); slides make lines of
    circles. A pose fixes where the last joint is, from which on it is the same.

    In space three joints reach a "position": the first turns about z or -z, the others turn about
    or slide across one horizontal direction, as of the Puma, of a Stanford arm, or of a cylindrical
    one. Six reach a "pose" if the axes of the last three, turns about directions at right angles,
    meet in a point; or if three joints turn about or slide across that direction, and the axes of
    the last two, turns, meet at right angles, the first of them at right angles to that direction,
    as of the arms of Universal Robots.

    Limits are not regarded. `ik_all` gives the solutions of other chains in numbers. `symbols` and
    `snap` are those of `derive_fk`.

    Errors: those of `kempe.forward.symbolic.derive_fk`; `UnsupportedError` for other
    chains and for systems with constraints.

    >>> import kempe
    >>> print(derive_ik(kempe.load("two_link"), "e").steps[1].formula)
    (-l1**2 - l2**2 + r2)/(2*l1*l2)
    """
    name = system.structure.frame_name(frame)
    if list_constraints(system):
        raise UnsupportedError(f"formulas for {name!r} need an open chain; ik_all gives numbers")
    leaves = SymbolLeaves(system, symbols or {}, snap)
    joints, tip = derive_joint_lines(
        system, name, leaves, f"formulas for {name!r} need two or three joints that move it"
    )
    taken: set[Any] = {sympy.Symbol(j.name) for j in joints} | set(tip.free_symbols)
    taken = taken.union(*(j.point.free_symbols for j in joints))
    words = (*Names._fields, *OWN, *TURNED, *PLANE_SYMBOLS)
    free = {
        word: next(s for e in iterate_endings() if (s := sympy.Symbol(f"{word}{e}")) not in taken)
        for word in words
    }
    if _is_planar_arm(joints, tip, task):
        return _derive_planar_formulas(system, joints, tip, task, free)
    arm = SpatialArm.from_joints(joints, tip) or ParallelArm.from_joints(joints, tip)
    if arm is None or task not in (None, SPATIAL[len(joints)]):
        raise UnsupportedError(
            f"formulas for {name!r} need two joints to a position, or three to a pose, that turn "
            "about z of the ground or slide across it, and at most one that slides along it; or "
            "in space a first turn about z, and two joints that turn about or slide across one "
            "horizontal direction, to a position, or to a pose with a wrist of three axes at "
            "right angles that meet, or three such joints and two turns about axes at right "
            "angles that meet, the first at right angles to that direction; ik_all gives numbers"
        )
    return _derive_spatial_formulas(system, arm, free)


def _is_planar_arm(joints: list[JointLine], tip: Any, task: str | None) -> bool:
    """Return whether two or three joints move the frame in a plane, and at most one along z."""
    arm = [j for j in joints if not _is_vertical_slide(j)]
    what = task or TASKS.get(len(arm), "position")
    planar = all(
        bool(j.direction[0] == 0 == j.direction[1]) if j.turns else bool(j.direction[2] == 0)
        for j in arm
    )
    upright = what != "pose" or tip[2, 0] == 0 == tip[2, 1]
    return TASKS.get(len(arm)) == what and planar and len(joints) <= len(arm) + 1 and bool(upright)


def _derive_planar_formulas(
    system: Model, joints: list[JointLine], tip: Any, task: str | None, names: dict[str, Any]
) -> InverseFormulas:
    """Derive formulas of a planar arm with at most one slide along z.

    `names` are the symbols by their words.
    """
    arm = [j for j in joints if not _is_vertical_slide(j)]
    lifts = [j for j in joints if _is_vertical_slide(j)]
    what = task or TASKS[len(arm)]
    x, y, z, phi, *last = (names[word] for word in OWN[:-1])
    inputs: list[Any] = [x, y, *([z] if lifts else []), *([phi] if what == "pose" else [])]
    n = Names.from_words(names)
    angle = phi - sympy.atan2(tip[1, 0], tip[0, 0]) if what == "pose" else None
    flat = [make_planar_line(j) for j in arm]
    steps, coordinates = solve_planar_pose(n, flat, (x, y), (tip[0, 3], tip[1, 3]), angle, last)
    found: dict[str, Any] = {j.coordinate: x for j, x in zip(flat, coordinates, strict=True)}
    # no other joint changes the height
    found |= {j.coordinate: j.direction[2] * (z - tip[2, 3]) for j in lifts}
    for j, place in zip(joints, PLACES, strict=False):
        says = f"the {place} coordinate" + ", from the height" * _is_vertical_slide(j)
        steps.append(FormulaStep(sympy.Symbol(j.coordinate), found[j.coordinate], says))
    return _make_formulas(system, steps, inputs, [n.sign], joints)


def _derive_spatial_formulas(
    system: Model, arm: ArmPlane, names: dict[str, Any]
) -> InverseFormulas:
    """Derive formulas of an arm in space; `names` are the symbols by their words."""
    x, y, z, _, *place = (names[word] for word in OWN)
    inputs = [x, y, z]
    to = [x, y, z]
    steps = list[FormulaStep]()
    R = None
    if len(arm.joints) > 3:
        R = sympy.Matrix(3, 3, [names[word] for word in TURNED])
        inputs += list(R)
        hand = tidy_matrix(arm.tip[:3, :3].T * (arm.end - arm.tip[:3, 3]))
        if not hand.is_zero_matrix:
            steps = [
                FormulaStep(s, w, "the wrist: the target, less the hand")
                for s, w in zip(place, sympy.Matrix(to) + R * hand, strict=True)
            ]
            to = place
    steps += arm.list_solution_steps(
        to, R, names, Names.from_words(names)._replace(sign=names["elbow"])
    )
    return _make_formulas(
        system,
        steps,
        inputs,
        [names[word] for word in ("shoulder", "elbow", "wrist")],
        list(arm.joints),
    )


def _make_formulas(
    system: Model,
    steps: list[FormulaStep],
    inputs: list[Any],
    signs: list[Any],
    joints: list[JointLine],
) -> InverseFormulas:
    """Make the formulas, with only those signs that occur."""
    signs = [sign for sign in signs if any(s.formula.has(sign) for s in steps)]
    return InverseFormulas(
        system, tuple(steps), tuple(inputs), tuple(signs), tuple(j.coordinate for j in joints)
    )


def _is_vertical_slide(joint: JointLine) -> bool:
    """Return whether a joint slides along z of the ground."""
    return not joint.turns and bool(joint.direction[0] == 0 == joint.direction[1])
