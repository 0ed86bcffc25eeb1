"""Symbolic formulas for planar mechanisms made of dyads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

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
from kempe.assemble.dyad_decomposition import Dyad, build_parts, find_single_motion
from kempe.errors import UnsupportedError
from kempe.forward.symbolic import SymbolLeaves, iterate_placement_steps, multiply_steps, sympy
from kempe.joints import R
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.assemble.dyads import Plan
    from kempe.description.parts import Joint

Three = tuple[str, str, str]
Bodies = tuple[str, ...]
LEFT = "+1 has the middle joint to the left"


@dataclass(frozen=True, eq=False)
class DyadFormulas(Derivation):
    """Formulas for all coordinates of a mechanism of dyads; `sign_1`, ... are the branch signs.

    Angles are found up to full turns. Symbols `x_b`, `y_b`, `theta_b` are the place and the angle
    of the body b.
    """

    plan: Plan

    def __call__(self, values: ArrayLike, branch: Any = None) -> Array:
        """Evaluate configurations (..., nq) for known coordinates (..., n).

        They are nan where a branch does not close; see `Plan.solve`.

        Angles that are found are in (-pi, pi].
        """
        given, lead = self.plan.values(values)
        found = self.evaluate(
            given,
            np.broadcast_to(self.plan.sign_rows(branch, None, lead), (len(given), self.plan.signs)),
        )
        names = self.system.coordinate_names
        turning = self.system.structure.coordinates.turning
        q = np.empty((len(given), self.system.nq))
        for name, column in zip(self.plan.known, given.T, strict=True):
            q[:, names.index(name)] = column
        for name, column in zip(self.coordinates, found.T, strict=True):
            i = names.index(name)
            q[:, i] = -((np.pi - column) % (2.0 * np.pi) - np.pi) if turning[i] else column
        return q.reshape(*lead, self.system.nq)


class _Place(NamedTuple):
    """Position of a body's origin in the ground frame, and the body's angle."""

    at: Vector
    angle: Any

    def transform_point(self, point: Vector) -> Vector:
        """Transform a point of the body to the ground frame."""
        return add_vectors(self.at, rotate_vector(point, self.angle))


class _Geometry(NamedTuple):
    """A planar joint of one freedom: a point and an angle of its frame on each body."""

    joint: Joint
    turns: bool
    points: tuple[Vector, Vector]
    angles: tuple[Any, Any]
    value: Any
    """Its coordinate as an expression in coordinates of q."""

    def find_side(self, body: str) -> int:
        """Return the side of a body: 0 for the parent, 1 for the child."""
        return int(body == self.joint.child)


class _Writing:
    """A derivation in progress: the placed bodies, the steps, and the unknown coordinates."""

    def __init__(self, plan: Plan, symbols: Mapping[str, Any] | None):
        self.plan = plan
        self.system = plan.system
        self.leaves = SymbolLeaves(plan.system, symbols or {}, 0.0)
        self.steps: list[FormulaStep] = []
        taken = {*plan.system.coordinate_names, *plan.system.structure.parameters}
        own = {f"{word}_{b}" for word in ("theta", "x", "y") for b in plan.system.body_names}
        own |= {
            f"{word}_{k}"
            for word in (*Names._fields, "d_x", "d_y")
            for k in range(1, len(plan.dyads) + 1)
        }
        self.end = next(
            end for end in iterate_endings() if not any(f"{word}{end}" in taken for word in own)
        )
        self.found: list[str] = []
        self.unknown = {sympy.Symbol(n) for n in plan.system.coordinate_names} - {
            sympy.Symbol(n) for n in plan.known
        }
        self.places = {plan.system.body_names[0]: _Place((0, 0), 0)}
        self.joints = {
            name: self._make_geometry(j) for name, j in plan.system.structure.joints.items()
        }
        self.hinges = {
            name: names
            for names, _ in build_parts(plan.system, plan.system.structure.parameters).hinges
            for name in names
        }

    def _make_geometry(self, joint: Joint) -> _Geometry:
        """Return the geometry of a joint on its two bodies; a fixed joint has the value zero."""
        motion = find_single_motion(joint)
        if motion is None and joint.type.layout(2)[1]:
            raise UnsupportedError(
                f"joint {joint.name!r} has no formulas here; loops.closed_form has numbers"
            )
        ends: list[Any] = [
            multiply_steps(iterate_placement_steps(X, joint.name, self.leaves), self.leaves)
            for X in (joint.X_PF, joint.X_CM)
        ]
        turns = motion is None or motion.kind == R
        axis = 0 if turns or motion is None else "xyz".index(motion.axis)
        angles = [to_polar_coordinates((X[0, axis], X[1, axis]))[1] for X in ends]
        name = self.system.structure.coordinates_of_joint(joint.name)
        value = self.leaves.express_coordinate(name[0]) if name else sympy.Integer(0)
        (a, b) = ((X[0, 3], X[1, 3]) for X in ends)
        return _Geometry(joint, turns, (a, b), (angles[0], angles[1]), value)

    def write_formulas(self) -> DyadFormulas:
        """Place body after body until all coordinates are known, and return the formulas.

        Bodies are placed by known coordinates, then by the next dyad.
        """
        dyads = list(self.plan.dyads)
        while True:
            while self._place_driven_body() or self._read_joint():
                pass
            if not dyads:
                break
            self._place_dyad(dyads.pop(0), len(self.plan.dyads) - len(dyads))
        if self.unknown:
            names = ", ".join(sorted(map(str, self.unknown)))
            raise UnsupportedError(f"no formulas for {names}; loops.closed_form has numbers")
        given = tuple(sympy.Symbol(n) for n in self.plan.known)
        signs = tuple(sympy.Symbol(f"sign_{k + 1}{self.end}") for k in range(self.plan.signs))
        return DyadFormulas(
            self.system, tuple(self.steps), given, signs, tuple(self.found), self.plan
        )

    # ---- what is known

    def _add_step(self, name: str, formula: Any, says: str = "") -> Any:
        """Add a step: a symbol, its formula and what it means. Return the symbol."""
        symbol = sympy.Symbol(name)
        self.steps.append(FormulaStep(symbol, formula, says))
        return symbol

    def _place_body(self, body: str, angle: Any, own: Vector, at: Vector) -> None:
        """Place a body by its angle and the ground position `at` of its point `own`."""
        end = f"{body}{self.end}"
        theta = self._add_step(f"theta_{end}", angle, f"angle of {body}")
        x, y = subtract_vectors(at, rotate_vector(own, theta))
        self.places[body] = _Place(
            (self._add_step(f"x_{end}", x, f"place of {body}"), self._add_step(f"y_{end}", y)),
            theta,
        )

    def _place_driven_body(self) -> bool:
        """Place a body by a joint whose coordinate is known; return whether there was one."""
        for g in self.joints.values():
            ends = g.joint.parent, g.joint.child
            there = [b for b in ends if b in self.places]
            if len(there) == 1 and not g.value.free_symbols & self.unknown:
                self._place_next_body(g, there[0], g.value)
                return True
        return False

    def _cross_joint(
        self, g: _Geometry, body: str, here: _Place, value: Any
    ) -> tuple[str, Any, Vector, Vector]:
        """Cross a joint at a value of its coordinate.

        Returns the other body, its angle, its point and the position of that point.
        """
        side = g.find_side(body)
        sense = -1 if side else 1
        angle = here.angle + g.angles[side] - g.angles[1 - side] + (sense * value if g.turns else 0)
        at = here.transform_point(g.points[side])
        if not g.turns:
            at = add_vectors(at, rotate_vector((sense * value, 0), here.angle + g.angles[side]))
        return (g.joint.parent if side else g.joint.child), angle, g.points[1 - side], at

    def _place_next_body(self, g: _Geometry, body: str, value: Any) -> None:
        """Place the body on the other side of a joint at a value of its coordinate."""
        other, angle, own, at = self._cross_joint(g, body, self.places[body], value)
        self._place_body(other, angle, own, at)

    def _read_joint(self) -> bool:
        """Compute the coordinate of a joint between placed bodies; return whether there was one."""
        for g in self.joints.values():
            if (
                g.joint.parent in self.places
                and g.joint.child in self.places
                and g.value.free_symbols & self.unknown
            ):
                parent = self.places[g.joint.parent]
                child = self.places[g.joint.child]
                if g.turns:
                    self._learn_coordinate(
                        g, child.angle + g.angles[1] - parent.angle - g.angles[0]
                    )
                else:
                    gap = subtract_vectors(
                        child.transform_point(g.points[1]), parent.transform_point(g.points[0])
                    )
                    self._learn_coordinate(g, rotate_vector(gap, -(parent.angle + g.angles[0]))[0])
                return True
        return False

    def _learn_coordinate(self, g: _Geometry, value: Any) -> None:
        """Compute the coordinate on which the value of a joint depends linearly."""
        unknown = list(g.value.free_symbols & self.unknown)
        if len(unknown) == 1:
            rate = sympy.diff(g.value, unknown[0])
            self._add_step(
                str(unknown[0]),
                (value - g.value.subs(unknown[0], 0)) / rate,
                f"coordinate of {g.joint.name}",
            )
            self.unknown -= {unknown[0]}
            self.found.append(str(unknown[0]))

    # ---- dyads

    def _place_cluster(self, bodies: tuple[str, ...]) -> dict[str, _Place]:
        """Place bodies that known coordinates connect in the frame of the first one."""
        out = {bodies[0]: _Place((0, 0), sympy.Integer(0))}
        grown = True
        while grown:
            grown = False
            for g in self.joints.values():
                ends = g.joint.parent, g.joint.child
                there = [b for b in ends if b in out]
                if (
                    len(there) == 1
                    and {*ends} <= {*bodies}
                    and not g.value.free_symbols & self.unknown
                ):
                    other, angle, own, at = self._cross_joint(g, there[0], out[there[0]], g.value)
                    out[other] = _Place(subtract_vectors(at, rotate_vector(own, angle)), angle)
                    grown = True
        return out

    def _find_pin(self, joint: str, places: dict[str, _Place]) -> Vector:
        """Return the point of a hinge on one of the placed bodies."""
        for name in self.hinges.get(joint, (joint,)):
            g = self.joints.get(name)
            for body, point in (
                zip((g.joint.parent, g.joint.child), g.points, strict=True) if g else ()
            ):
                if body in places:
                    return places[body].transform_point(point)
        raise self._make_error(joint)

    def _find_rail(self, joint: str, places: dict[str, _Place]) -> tuple[_Geometry, str]:
        """Return the geometry of a prismatic joint, and its placed body."""
        g = self.joints.get(joint)
        for body in (g.joint.parent, g.joint.child) if g else ():
            if g and body in places:
                return g, body
        raise self._make_error(joint)

    def _make_error(self, joint: str) -> UnsupportedError:
        """Make the error for a dyad without formulas."""
        return UnsupportedError(
            f"no formulas for the dyad at {joint!r}; loops.closed_form has numbers"
        )

    def _name_vector(self, k: int, v: Vector) -> Vector:
        """Name the components of the vector between two joints of dyad k."""
        return self._add_step(f"d_x_{k}{self.end}", v[0], "between the joints"), self._add_step(
            f"d_y_{k}{self.end}", v[1]
        )

    def _convert_to_polar(self, v: Vector) -> tuple[Any, Any]:
        """Return length, not negative, and angle of a vector."""
        length, angle = to_polar_coordinates(v)
        values = {sympy.Symbol(n): x for n, x in self.system.structure.parameters.items()}
        number = length.subs(values)
        if number.free_symbols:
            return sympy.sqrt(sympy.expand(v[0] ** 2 + v[1] ** 2)), sympy.atan2(v[1], v[0])
        return (length, angle) if float(number) >= 0.0 else (-length, angle + sympy.pi)

    def _place_dyad(self, dyad: Dyad, k: int) -> None:
        """Place the two links of dyad k."""
        n = Names.from_ending(f"_{k}{self.end}")
        if dyad.sign is not None:
            n = n._replace(sign=sympy.Symbol(f"sign_{dyad.sign + 1}{self.end}"))
        first, second = dyad.bodies
        x, y, z = dyad.joints
        if not {*first, *second} <= set(self.system.body_names):
            raise self._make_error(y)
        near = ((x, y, z), first, second)
        far = ((z, y, x), second, first)
        how = {
            "RRR": self._place_three_hinges,
            "RPR": self._place_turning_slide,
            "PRP": self._place_two_sliders,
        }.get(dyad.kind)
        if how is None:
            how = (
                self._place_slider_bar if dyad.kind.count("P") == 1 else self._place_stacked_sliders
            )
        how(
            n,
            k,
            *(near if dyad.kind[0] == "P" or dyad.kind[-1] == "R" and dyad.kind != "RPP" else far),
        )

    def _place_three_hinges(
        self, n: Names, k: int, joints: Three, first: Bodies, second: Bodies
    ) -> None:
        """Place two links that three hinges connect, by the intersection of two circles."""
        (x, y, z) = joints
        one = self._place_cluster(first)
        two = self._place_cluster(second)
        A = self._find_pin(x, self.places)
        to = self._name_vector(k, subtract_vectors(self._find_pin(z, self.places), A))
        a1 = self._find_pin(x, one)
        b1 = self._find_pin(y, one)
        b2 = self._find_pin(y, two)
        c2 = self._find_pin(z, two)
        (l1, at1) = self._convert_to_polar(subtract_vectors(b1, a1))
        (l2, at2) = self._convert_to_polar(subtract_vectors(c2, b2))
        steps, angle, bend = solve_two_bars(n._replace(sign=-n.sign), to, l1, l2, LEFT)
        self.steps += steps
        self._place_body(first[0], angle - at1, a1, A)
        here = self.places[first[0]]
        self._place_body(second[0], here.angle + at1 + bend - at2, b2, here.transform_point(b1))

    def _find_slider(self, rail: str, slider: Bodies) -> tuple[_Geometry, str, _Place, Vector]:
        """Return the prismatic joint of a slider on a placed body.

        Also the placed body, the slider's place at coordinate zero, and the direction of sliding.
        """
        g, still = self._find_rail(rail, self.places)
        own = self._place_cluster(slider)
        body, angle, point, at = self._cross_joint(g, still, self.places[still], 0)
        if body not in own:
            raise self._make_error(rail)
        turn = angle - own[body].angle
        side = g.find_side(still)
        along = rotate_vector((-1 if side else 1, 0), self.places[still].angle + g.angles[side])
        return (
            g,
            still,
            _Place(
                subtract_vectors(at, rotate_vector(own[body].transform_point(point), turn)), turn
            ),
            along,
        )

    def _place_slider_bar(
        self, n: Names, k: int, joints: Three, slider: Bodies, bar: Bodies
    ) -> None:
        """Place a slider on a placed body, and a bar from the slider to a placed hinge."""
        rail, middle, pin = joints
        g, still, start, along = self._find_slider(rail, slider)
        two = self._place_cluster(bar)
        b2 = self._find_pin(middle, two)
        c2 = self._find_pin(pin, two)
        fixed = self._find_pin(pin, self.places)
        length, at_bar = self._convert_to_polar(subtract_vectors(c2, b2))
        to = subtract_vectors(
            fixed, start.transform_point(self._find_pin(middle, self._place_cluster(slider)))
        )
        steps, u, turn = solve_slide_and_bar(n, self._name_vector(k, to), along, length)
        self.steps += steps
        self._slide_joint(g, still, u)
        self._place_body(bar[0], turn - at_bar, c2, fixed)

    def _slide_joint(self, g: _Geometry, body: str, u: Any) -> None:
        """Note the coordinate of a prismatic joint, and place the body beyond it."""
        self._learn_coordinate(g, u)
        self._place_next_body(g, body, g.value)

    def _place_turning_slide(
        self, n: Names, k: int, joints: Three, first: Bodies, second: Bodies
    ) -> None:
        """Place two links on placed hinges, with a slide between the links."""
        x, y, z = joints
        g, body = self._find_rail(y, dict.fromkeys(first, self.places[self.system.body_names[0]]))
        if g.joint.parent != body:
            x, z, first, second = z, x, second, first
        one = self._place_cluster(first)
        two = self._place_cluster(second)
        parent = one.get(g.joint.parent)
        child = two.get(g.joint.child)
        if parent is None or child is None:
            raise self._make_error(y)
        A = self._find_pin(x, self.places)
        a = self._find_pin(x, one)
        rail = parent.angle + g.angles[0]
        other = child.angle + g.angles[1]
        reach = rotate_vector(
            subtract_vectors(self._find_pin(z, two), child.transform_point(g.points[1])),
            rail - other,
        )
        gap = rotate_vector(
            add_vectors(subtract_vectors(parent.transform_point(g.points[0]), a), reach), -rail
        )
        ahead, aside = (sympy.simplify(v) for v in gap)
        steps, u, angle = solve_turning_slide(
            n, self._name_vector(k, subtract_vectors(self._find_pin(z, self.places), A)), aside
        )
        self.steps += steps
        self._learn_coordinate(g, u - ahead)
        self._place_body(first[0], angle - rail, a, A)

    def _place_two_sliders(
        self, n: Names, k: int, joints: Three, first: Bodies, second: Bodies
    ) -> None:
        """Place two sliders on placed bodies, with a hinge between the sliders."""
        ways = [
            self._find_slider(rail, bodies)
            for rail, bodies in ((joints[0], first), (joints[2], second))
        ]
        pins = [
            way[2].transform_point(self._find_pin(joints[1], self._place_cluster(bodies)))
            for way, bodies in zip(ways, (first, second), strict=True)
        ]
        (d1, d2) = (way[3] for way in ways)
        to = self._name_vector(k, subtract_vectors(pins[1], pins[0]))
        steps, *slides = solve_two_slides(n, to, d1, (-d2[0], -d2[1]))
        self.steps += steps
        for (g, still, *_), u in zip(ways, slides, strict=True):
            self._slide_joint(g, still, u)

    def _place_stacked_sliders(
        self, n: Names, k: int, joints: Three, near: Bodies, far: Bodies
    ) -> None:
        """Place a slider on a placed body, and on it a second one that a placed hinge holds."""
        rail, middle, pin = joints
        g1, still, start, d1 = self._find_slider(rail, near)
        before = self.places
        own = self._place_cluster(near)
        # as at zero
        self.places = {
            b: _Place(start.transform_point(p.at), start.angle + p.angle) for b, p in own.items()
        }
        g2, _, tip, d2 = self._find_slider(middle, far)
        self.places = before
        to = subtract_vectors(
            self._find_pin(pin, self.places),
            tip.transform_point(self._find_pin(pin, self._place_cluster(far))),
        )
        steps, u1, u2 = solve_two_slides(n, self._name_vector(k, to), d1, d2)
        self.steps += steps
        self._slide_joint(g1, still, u1)
        self._learn_coordinate(g2, u2)


def derive_formulas(plan: Plan, symbols: Mapping[str, Any] | None = None) -> DyadFormulas:
    """Derive the formulas of a closed form; see `Plan.formulas`."""
    return _Writing(plan, symbols).write_formulas()
