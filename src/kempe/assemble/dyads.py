"""Planar mechanisms made of dyads in closed form: all configurations for known coordinates, with
their branches.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Answer
from kempe.answers.targets import Z_AXIS, place_of
from kempe.arguments import brief, explained, explained_methods, listed
from kempe.arrays import reals
from kempe.assemble.dyad_decomposition import Decomposition, Dyad, PartLine, alone, parts_of
from kempe.constraints.kinds import of_target
from kempe.equations.tasks import task_of
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.forward.fk import fk
from kempe.forward.formula_steps import (
    Derivation,
    FormulaStep,
    Names,
    Vector,
    endings,
    line_and_circle,
    minus,
    plus,
    polar,
    turned,
    turning_slide,
    two_circles,
    two_lines,
)
from kempe.forward.symbolic import SymbolLeaves, placement_steps, pose_of, sympy
from kempe.joints import R
from kempe.model.configurations import as_q, as_start, refuse_far
from kempe.model.model import kept
from kempe.numerics.pool import over_chunks
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import Status, member
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.model import Model

# ---- dyad formulas

# The closed form of a planar mechanism of dyads as formulas: body after body, coordinate after
# coordinate.


Three = tuple[str, str, str]
Bodies = tuple[str, ...]
LEFT = "+1 has the middle joint to the left"


@dataclass(frozen=True, eq=False)
class DyadFormulas(Derivation):
    """Formulas of all coordinates of a mechanism from those that are known; `sign_1`, ... are the
    branch signs.

    Angles are found up to full turns. Symbols `x_b`, `y_b`, `theta_b` are the place and the angle
    of the body b.
    """

    plan: Plan

    def __call__(self, values: ArrayLike, branch: Any = None) -> Array:
        """Configurations (..., nq) for known coordinates (..., n), nan where a branch does not
        close; see `Plan.solve`.

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
    """Where a body is in the ground: its origin and its angle."""

    at: Vector
    angle: Any

    def of(self, point: Vector) -> Vector:
        """A point of the body, in the ground."""
        return plus(self.at, turned(point, self.angle))


class _Geometry(NamedTuple):
    """A joint of one freedom in the plane: a point on each of two bodies, and the angle of its
    frames there.
    """

    joint: Joint
    turns: bool
    points: tuple[Vector, Vector]
    angles: tuple[Any, Any]
    value: Any
    """Its coordinate as an expression in coordinates of q."""

    def side(self, body: str) -> int:
        """0 for the parent, 1 for the child."""
        return int(body == self.joint.child)


class _Writing:
    """The derivation while it is written: what is placed, what is known."""

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
            end for end in endings() if not any(f"{word}{end}" in taken for word in own)
        )
        self.found: list[str] = []
        self.unknown = {sympy.Symbol(n) for n in plan.system.coordinate_names} - {
            sympy.Symbol(n) for n in plan.known
        }
        self.places = {plan.system.body_names[0]: _Place((0, 0), 0)}
        self.joints = {name: self._geometry(j) for name, j in plan.system.structure.joints.items()}
        self.hinges = {name: names for names, _ in parts_of(plan.system).hinges for name in names}

    def _geometry(self, joint: Joint) -> _Geometry:
        """A joint as it lies on its bodies; without motion its value is zero."""
        motion = alone(joint)
        if motion is None and joint.type.layout(2)[1]:
            raise UnsupportedError(
                f"joint {joint.name!r} has no formulas here; loops.closed_form has numbers"
            )
        ends: list[Any] = [
            pose_of(placement_steps(X, joint.name, self.leaves), self.leaves)
            for X in (joint.X_PF, joint.X_CM)
        ]
        turns = motion is None or motion.kind == R
        axis = 0 if turns or motion is None else "xyz".index(motion.axis)
        angles = [polar((X[0, axis], X[1, axis]))[1] for X in ends]
        name = self.system.structure.coordinates_of_joint(joint.name)
        value = self.leaves.coordinate(name[0]) if name else sympy.Integer(0)
        (a, b) = ((X[0, 3], X[1, 3]) for X in ends)
        return _Geometry(joint, turns, (a, b), (angles[0], angles[1]), value)

    def write(self) -> DyadFormulas:
        """Place body after body, by known coordinates, then by the next dyad, until all coordinates
        are known.
        """
        dyads = list(self.plan.dyads)
        while True:
            while self._drive() or self._read():
                pass
            if not dyads:
                break
            self._close(dyads.pop(0), len(self.plan.dyads) - len(dyads))
        if self.unknown:
            names = ", ".join(sorted(map(str, self.unknown)))
            raise UnsupportedError(f"no formulas for {names}; loops.closed_form has numbers")
        given = tuple(sympy.Symbol(n) for n in self.plan.known)
        signs = tuple(sympy.Symbol(f"sign_{k + 1}{self.end}") for k in range(self.plan.signs))
        return DyadFormulas(
            self.system, tuple(self.steps), given, signs, tuple(self.found), self.plan
        )

    # ---- what is known

    def _say(self, name: str, formula: Any, says: str = "") -> Any:
        symbol = sympy.Symbol(name)
        self.steps.append(FormulaStep(symbol, formula, says))
        return symbol

    def _place(self, body: str, angle: Any, own: Vector, at: Vector) -> None:
        """Place a body: its angle, and the ground's point `at` at which its own point is."""
        end = f"{body}{self.end}"
        theta = self._say(f"theta_{end}", angle, f"angle of {body}")
        x, y = minus(at, turned(own, theta))
        self.places[body] = _Place(
            (self._say(f"x_{end}", x, f"place of {body}"), self._say(f"y_{end}", y)), theta
        )

    def _drive(self) -> bool:
        """Place a body by a joint whose coordinate is known."""
        for g in self.joints.values():
            ends = g.joint.parent, g.joint.child
            there = [b for b in ends if b in self.places]
            if len(there) == 1 and not g.value.free_symbols & self.unknown:
                self._beyond(g, there[0], g.value)
                return True
        return False

    def _across(
        self, g: _Geometry, body: str, here: _Place, value: Any
    ) -> tuple[str, Any, Vector, Vector]:
        """What is on the other side of a joint at a value: the body, its angle, its point, and
        where that is.
        """
        side = g.side(body)
        sense = -1 if side else 1
        angle = here.angle + g.angles[side] - g.angles[1 - side] + (sense * value if g.turns else 0)
        at = here.of(g.points[side])
        if not g.turns:
            at = plus(at, turned((sense * value, 0), here.angle + g.angles[side]))
        return (g.joint.parent if side else g.joint.child), angle, g.points[1 - side], at

    def _beyond(self, g: _Geometry, body: str, value: Any) -> None:
        other, angle, own, at = self._across(g, body, self.places[body], value)
        self._place(other, angle, own, at)

    def _read(self) -> bool:
        """Learn the coordinate of a joint that turns between bodies that are placed."""
        for g in self.joints.values():
            if (
                g.joint.parent in self.places
                and g.joint.child in self.places
                and g.value.free_symbols & self.unknown
            ):
                parent = self.places[g.joint.parent]
                child = self.places[g.joint.child]
                if g.turns:
                    self._learn(g, child.angle + g.angles[1] - parent.angle - g.angles[0])
                else:
                    gap = minus(child.of(g.points[1]), parent.of(g.points[0]))
                    self._learn(g, turned(gap, -(parent.angle + g.angles[0]))[0])
                return True
        return False

    def _learn(self, g: _Geometry, value: Any) -> None:
        """Note the coordinate of which the value of a joint is a multiple, plus an offset."""
        unknown = list(g.value.free_symbols & self.unknown)
        if len(unknown) == 1:
            rate = sympy.diff(g.value, unknown[0])
            self._say(
                str(unknown[0]),
                (value - g.value.subs(unknown[0], 0)) / rate,
                f"coordinate of {g.joint.name}",
            )
            self.unknown -= {unknown[0]}
            self.found.append(str(unknown[0]))

    # ---- dyads

    def _cluster(self, bodies: tuple[str, ...]) -> dict[str, _Place]:
        """Where bodies that known coordinates join are in the frame of the first one."""
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
                    other, angle, own, at = self._across(g, there[0], out[there[0]], g.value)
                    out[other] = _Place(minus(at, turned(own, angle)), angle)
                    grown = True
        return out

    def _pin(self, joint: str, places: dict[str, _Place]) -> Vector:
        """The point of a hinge on bodies whose places are given."""
        for name in self.hinges.get(joint, (joint,)):
            g = self.joints.get(name)
            for body, point in (
                zip((g.joint.parent, g.joint.child), g.points, strict=True) if g else ()
            ):
                if body in places:
                    return places[body].of(point)
        raise self._none(joint)

    def _rail(self, joint: str, places: dict[str, _Place]) -> tuple[_Geometry, str]:
        """A joint that slides, and the body of it whose place is given."""
        g = self.joints.get(joint)
        for body in (g.joint.parent, g.joint.child) if g else ():
            if g and body in places:
                return g, body
        raise self._none(joint)

    def _none(self, joint: str) -> UnsupportedError:
        return UnsupportedError(
            f"no formulas for the dyad at {joint!r}; loops.closed_form has numbers"
        )

    def _to(self, k: int, v: Vector) -> Vector:
        return self._say(f"d_x_{k}{self.end}", v[0], "between the joints"), self._say(
            f"d_y_{k}{self.end}", v[1]
        )

    def _polar(self, v: Vector) -> tuple[Any, Any]:
        """Length, not negative, and angle of a vector."""
        length, angle = polar(v)
        values = {sympy.Symbol(n): x for n, x in self.system.structure.parameters.items()}
        number = length.subs(values)
        if number.free_symbols:
            return sympy.sqrt(sympy.expand(v[0] ** 2 + v[1] ** 2)), sympy.atan2(v[1], v[0])
        return (length, angle) if float(number) >= 0.0 else (-length, angle + sympy.pi)

    def _close(self, dyad: Dyad, k: int) -> None:
        """Place the two links of a dyad."""
        n = Names.ending(f"_{k}{self.end}")
        if dyad.sign is not None:
            n = n._replace(sign=sympy.Symbol(f"sign_{dyad.sign + 1}{self.end}"))
        first, second = dyad.bodies
        x, y, z = dyad.joints
        if not {*first, *second} <= set(self.system.body_names):
            raise self._none(y)
        near = ((x, y, z), first, second)
        far = ((z, y, x), second, first)
        how = {"RRR": self._circles, "RPR": self._turning, "PRP": self._both_slide}.get(dyad.kind)
        if how is None:
            how = self._line_circle if dyad.kind.count("P") == 1 else self._slide_on_slide
        how(
            n,
            k,
            *(near if dyad.kind[0] == "P" or dyad.kind[-1] == "R" and dyad.kind != "RPP" else far),
        )

    def _circles(self, n: Names, k: int, joints: Three, first: Bodies, second: Bodies) -> None:
        (x, y, z) = joints
        one = self._cluster(first)
        two = self._cluster(second)
        A = self._pin(x, self.places)
        to = self._to(k, minus(self._pin(z, self.places), A))
        a1 = self._pin(x, one)
        b1 = self._pin(y, one)
        b2 = self._pin(y, two)
        c2 = self._pin(z, two)
        (l1, at1) = self._polar(minus(b1, a1))
        (l2, at2) = self._polar(minus(c2, b2))
        steps, angle, bend = two_circles(n._replace(sign=-n.sign), to, l1, l2, LEFT)
        self.steps += steps
        self._place(first[0], angle - at1, a1, A)
        here = self.places[first[0]]
        self._place(second[0], here.angle + at1 + bend - at2, b2, here.of(b1))

    def _slid(self, rail: str, slider: Bodies) -> tuple[_Geometry, str, _Place, Vector]:
        """A link that slides on what is placed: the joint, its placed body, where the link is at
        zero, and its way.
        """
        g, still = self._rail(rail, self.places)
        own = self._cluster(slider)
        body, angle, point, at = self._across(g, still, self.places[still], 0)
        if body not in own:
            raise self._none(rail)
        turn = angle - own[body].angle
        side = g.side(still)
        along = turned((-1 if side else 1, 0), self.places[still].angle + g.angles[side])
        return g, still, _Place(minus(at, turned(own[body].of(point), turn)), turn), along

    def _line_circle(self, n: Names, k: int, joints: Three, slider: Bodies, bar: Bodies) -> None:
        """Place a slider on what is placed, and a bar from it to a hinge on what is placed."""
        rail, middle, pin = joints
        g, still, start, along = self._slid(rail, slider)
        two = self._cluster(bar)
        b2 = self._pin(middle, two)
        c2 = self._pin(pin, two)
        fixed = self._pin(pin, self.places)
        length, at_bar = self._polar(minus(c2, b2))
        to = minus(fixed, start.of(self._pin(middle, self._cluster(slider))))
        steps, u, turn = line_and_circle(n, self._to(k, to), along, length)
        self.steps += steps
        self._slide(g, still, u)
        self._place(bar[0], turn - at_bar, c2, fixed)

    def _slide(self, g: _Geometry, body: str, u: Any) -> None:
        """Note how far a joint slides, and place what is beyond it."""
        self._learn(g, u)
        self._beyond(g, body, g.value)

    def _turning(self, n: Names, k: int, joints: Three, first: Bodies, second: Bodies) -> None:
        """Place two links on hinges with a slide between them."""
        x, y, z = joints
        g, body = self._rail(y, dict.fromkeys(first, self.places[self.system.body_names[0]]))
        if g.joint.parent != body:
            x, z, first, second = z, x, second, first
        one = self._cluster(first)
        two = self._cluster(second)
        parent = one.get(g.joint.parent)
        child = two.get(g.joint.child)
        if parent is None or child is None:
            raise self._none(y)
        A = self._pin(x, self.places)
        a = self._pin(x, one)
        rail = parent.angle + g.angles[0]
        other = child.angle + g.angles[1]
        reach = turned(minus(self._pin(z, two), child.of(g.points[1])), rail - other)
        gap = turned(plus(minus(parent.of(g.points[0]), a), reach), -rail)
        ahead, aside = (sympy.simplify(v) for v in gap)
        steps, u, angle = turning_slide(n, self._to(k, minus(self._pin(z, self.places), A)), aside)
        self.steps += steps
        self._learn(g, u - ahead)
        self._place(first[0], angle - rail, a, A)

    def _both_slide(self, n: Names, k: int, joints: Three, first: Bodies, second: Bodies) -> None:
        """Place two sliders on what is placed, joined by a hinge."""
        ways = [
            self._slid(rail, bodies) for rail, bodies in ((joints[0], first), (joints[2], second))
        ]
        pins = [
            way[2].of(self._pin(joints[1], self._cluster(bodies)))
            for way, bodies in zip(ways, (first, second), strict=True)
        ]
        (d1, d2) = (way[3] for way in ways)
        to = self._to(k, minus(pins[1], pins[0]))
        steps, *slides = two_lines(n, to, d1, (-d2[0], -d2[1]))
        self.steps += steps
        for (g, still, *_), u in zip(ways, slides, strict=True):
            self._slide(g, still, u)

    def _slide_on_slide(self, n: Names, k: int, joints: Three, near: Bodies, far: Bodies) -> None:
        """Place a slider on what is placed, and one on it that a hinge holds."""
        rail, middle, pin = joints
        g1, still, start, d1 = self._slid(rail, near)
        before = self.places
        own = self._cluster(near)
        self.places = {
            b: _Place(start.of(p.at), start.angle + p.angle) for b, p in own.items()
        }  # as at zero
        g2, _, tip, d2 = self._slid(middle, far)
        self.places = before
        to = minus(self._pin(pin, self.places), tip.of(self._pin(pin, self._cluster(far))))
        steps, u1, u2 = two_lines(n, self._to(k, to), d1, d2)
        self.steps += steps
        self._slide(g1, still, u1)
        self._learn(g2, u2)


def dyad_formulas(plan: Plan, symbols: Mapping[str, Any] | None = None) -> DyadFormulas:
    """The formulas of a closed form; see `Plan.formulas`."""
    return _Writing(plan, symbols).write()


CLOSED = 1e-12
"""Openings below this share of the mechanism's size are rounding."""
CHUNK = 8192
SERIAL_BELOW = 20_000
STEP = 0.1
"""Largest change of a coordinate between two rows, in radians and characteristic lengths, as a part
of the least margin of a dyad, for a sequence of rows to stay on its branch: the sine of the angle
between the links is that margin."""
MOST_SIGNS = 16
"""Branch signs up to which all combinations are tried: 65536 configurations."""


@dataclass(frozen=True)
class Incomplete(Report):
    """Why there is no closed form: `reason` as a sentence, and the `bodies` that no dyad places."""

    reason: str
    bodies: tuple[str, ...] = ()

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: that a closed form was not found is no proof that there is none."""
        return Status.NOT_FOUND

    @property
    def status(self) -> str:
        """Why there is no closed form."""
        return self.reason

    def describe(self) -> str:
        """Why there is no closed form, as `Plan.describe` says what there is."""
        return self.reason

    def formulas(self, *args: Any, **options: Any) -> NoReturn:
        """Refused, as all that needs a closed form. Errors: `UnsupportedError` with the reason."""
        raise UnsupportedError(
            f"{self.reason}; `assemble` and `assembly_modes` find its configurations by numbers"
        )

    solve = close = all = heights = branch_of = formulas

    def _data(self) -> dict[str, Any]:
        return {"bodies": self.bodies}


@explained_methods
@dataclass(frozen=True, eq=False)
class DyadAnswer(Answer):
    """Configurations `q` (..., nq) of a `plan`; which are closed (`success` or `ok`); their
    openings `gap` in metres.

    `undetermined` (...) counts the parts of each that these inputs leave free: links without
    length, circles with one centre, parallel lines. They got one of their infinitely many
    positions.
    """

    __repr__ = brief

    what = "configurations closed"
    also = ("gap", "undetermined")

    q: Array
    success: Any
    gap: Any
    undetermined: Any
    closing: tuple[Plan, Array] = field(repr=False)
    """The plan, and the values (n, known) that it was to close."""

    @property
    def system(self) -> Model:
        """The system of the problem."""
        return self.closing[0].system

    @property
    def ok(self) -> Any:
        """Which (...) are closed: another name of `success`."""
        return self.success

    @property
    def code(self) -> Any:
        """The outcome (...): where this branch does not close, others may."""
        sound = np.isfinite(self.closing[1]).all(axis=-1).reshape(np.shape(self.success))
        left = np.where(sound, Status.NOT_FOUND, Status.BAD_INPUT)
        return member(np.where(self.success, Status.SOLVED, left))

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:

        plan, values = self.closing
        columns = values.T.reshape(len(plan.known), *np.shape(self.success))
        return held_at(self.system, dict(zip(plan.known, columns, strict=True)))

    def _sentence(self, index: tuple[int, ...]) -> str:
        code, gap, free = (
            np.asarray(x)[index].item() for x in (self.code, self.gap, self.undetermined)
        )
        if code == Status.BAD_INPUT:
            return "known values are not finite or too large"
        if code != Status.SOLVED:
            text = f"open by {gap:.6g} m on this branch; q is where it nearly touches"
            return text + (
                f"; {counted(free, 'part')} left undetermined, which may close elsewhere"
                if free
                else ""
            )
        return f"closed: open by {gap:.1e} m" + (
            f"; {counted(free, 'part')} left undetermined" if free else ""
        )


@explained_methods
@dataclass(frozen=True, eq=False)
class Plan(Report):
    """A mechanism in closed form for `known` coordinates: dyad after dyad of three rigid clusters.

    `dyads` lists them; `signs` is how many of them have two roots, and so are chosen by a branch
    sign, +1 or -1. A sign stays along a motion until its `heights` is zero: there two branches
    meet. Most mechanisms turn back at such a place; at a change point, as of a parallelogram that
    is flat, a smooth motion goes on with the other sign. Openings up to `tolerance` metres count as
    closed. Method: chained circle and line intersections of the dyads (Assur, 1914), in vectors of
    configurations.
    """

    system: Model
    known: tuple[str, ...]
    dyads: tuple[Dyad, ...]
    tolerance: float
    program: tuple[np.ndarray, np.ndarray] = field(repr=False)

    @property
    def signs(self) -> int:
        """Number of branch signs."""
        return sum(d.sign is not None for d in self.dyads)

    @property
    def status(self) -> str:
        """From what it is closed, and by how many dyads."""
        return (
            f"{self.system.name} from {', '.join(self.known) or 'nothing'}: "
            f"{counted(len(self.dyads), 'dyad')}"
        )

    def describe(self) -> str:
        """What each dyad is, and what its branch sign means, as text; one line each."""
        return str(self)

    def _notes(self) -> list[str]:
        return [
            f"{'sign ' + str(d.sign + 1) if d.sign is not None else 'no sign'}: {d}"
            for d in self.dyads
        ]

    def _data(self) -> dict[str, Any]:
        return {
            "system": self.system.name,
            "known": self.known,
            "signs": self.signs,
            "dyads": self._notes(),
        }

    def formulas(self, *, symbols: Mapping[str, Any] | None = None) -> DyadFormulas:
        """The closed form as formulas, which can be called, printed and written as LaTeX and as
        code for numpy.

        `symbols` replaces coordinates and parameters as in `symbolic.fk`. Errors:
        `UnsupportedError` for rods and slots without bodies of their own, laws of several
        coordinates, and links that are several bodies; `MissingExtraError` without sympy.
        """

        return dyad_formulas(self, symbols)

    def solve(
        self, values: ArrayLike, branch: Any = None, start: Any = None, threads: int | None = None
    ) -> tuple[Array, Any, Any]:
        """Configurations q (..., nq), whether they are closed (...), and their openings (...) in
        metres.

        `values` (..., n_known) are the known coordinates in the order of `known`. `branch` are the
        signs, (signs,) or (..., signs), or text such as '+-'; where it is left out, the branch of
        `start` is taken, else + everywhere. Angles are those nearest to `start`, (nq,) or (...,
        nq), else to zero, and inside the limits where some representative is. What cannot close is
        put where it nearly touches; NaN among the values gives NaN.
        """
        closed = self.close(values, branch, start, threads)
        return closed.q, closed.ok, closed.gap

    def close(
        self, values: ArrayLike, branch: Any = None, start: Any = None, threads: int | None = None
    ) -> DyadAnswer:
        """As `solve`, with what these inputs leave undetermined."""
        given, lead = self.values(values)
        nq = self.system.nq
        if start is None:
            targets = np.zeros((1, nq))
        else:
            targets = _rows(as_start(self.system, start), lead, "near")
            refuse_far(self.system, targets, "start")
        signs = self.sign_rows(
            branch, targets if branch is None and start is not None else None, lead
        )
        q, status = self._run(given, signs, targets, threads)
        gap = status[:, 0]
        ok = (gap <= self.tolerance) & np.isfinite(given).all(axis=-1)
        if not lead:
            return DyadAnswer(q[0], bool(ok[0]), float(gap[0]), int(status[0, 1]), (self, given))
        ok, gap, free = (x.reshape(lead) for x in (ok, gap, status[:, 1].astype(int)))
        return DyadAnswer(q.reshape(*lead, nq), ok, gap, free, (self, given))

    def all(self, values: ArrayLike, start: Any = None) -> tuple[Array, np.ndarray]:
        """Configurations q (..., 2**signs, nq) on all branches, and a mask (..., 2**signs) of those
        that close.

        Branches are in the order of `branches()`. Angles are nearest to `start` (nq,), else to
        zero.
        """
        given, lead = self.values(values)
        signs = self.branches()
        k = len(signs)
        nq = self.system.nq
        targets = (
            np.zeros((1, nq)) if start is None else _rows(as_start(self.system, start), (), "near")
        )
        refuse_far(self.system, targets, "start")
        many = np.repeat(given, k, axis=0)
        q, status = self._run(many, np.tile(signs, (len(given), 1)), targets)
        mask = (status[:, 0] <= self.tolerance) & np.isfinite(many).all(axis=-1)
        return q.reshape(*lead, k, nq), mask.reshape(*lead, k)

    def branches(self) -> Array:
        """All combinations of signs (2**signs, signs), + before -. Errors: `InputError` where they
        are too many.
        """
        if self.signs > MOST_SIGNS:
            raise InputError(
                f"there are 2**{self.signs} branches; all of them are listed up to 2**{MOST_SIGNS}"
            )
        return np.array(list(product((1.0, -1.0), repeat=self.signs))).reshape(
            2**self.signs, self.signs
        )

    def heights(self, q: Any) -> Array:
        """What the branch signs are the signs of (..., signs), in metres; zero where two branches
        meet.

        For three revolute joints, the distance of the middle one from the line through the others;
        with a prismatic joint, the way that it has slid from where its two roots meet.
        """
        q = as_q(self.system, q)
        X = fk(self.system, q)
        out = np.empty((*q.shape[:-1], self.signs))
        for d in self.dyads:
            if d.sign is None:
                continue
            first, line, last = (self._place(X, e) for e in d.ends)
            to = last[0] - first[0]
            if d.along:
                out[..., d.sign] = np.sum(line[1] * to, axis=-1)
                continue
            way = line[0] - first[0]
            length = np.linalg.norm(way, axis=-1, keepdims=True)
            base = X[..., d.base, :2, 0]
            unit = np.where(length > 0.0, way / np.where(length > 0.0, length, 1.0), base)
            out[..., d.sign] = unit[..., 0] * to[..., 1] - unit[..., 1] * to[..., 0]
        return out

    def branch_of(self, q: Any) -> Array:
        """Branch signs (..., signs), +1 or -1, of closed configurations q (..., nq); + where two
        branches meet.
        """
        return np.where(self.heights(q) < 0.0, -1.0, 1.0)

    def _place(self, X: Array, end: PartLine) -> tuple[Array, Array]:
        pose = X[..., end.part, :, :]
        point = pose[..., :2, 3] + pose[..., :2, :2] @ np.array([end.x, end.y])
        return point, pose[..., :2, :2] @ np.array([end.dx, end.dy])

    def _continued(
        self, values: Array, before: Array, unit: Array, turns: np.ndarray
    ) -> Array | None:
        """Configurations (N, nq) for known `values` (N, n_known) that continue the closed one
        `before` (nq,).

        They lie on its branch, and each follows the row before it without a jump. None where a row
        does not close, is undetermined, or differs from the row before it by more than `STEP` of
        the least margin of its dyads: the branch alone does not say there how the sequence goes on.
        `unit` (nq,) are the coordinates of one radian or one characteristic length; `turns` are
        indices of those that a full turn brings back.
        """
        q, status = self._run(values, self.branch_of(before)[None], before[None], 1)
        if not (np.all(status[:, 0] <= self.tolerance) and np.all(status[:, 1] == 0.0)):
            return None
        turning = set(turns.tolist())
        given = {self.system.coordinate_names.index(name) for name in self.known}
        most = np.zeros(len(q))
        for i in range(self.system.nq):
            if i in given:
                continue
            change = np.diff(q[:, i], prepend=before[i])
            if i in turning:
                back = np.rint(change / (2.0 * math.pi))
                if back.any():
                    q[:, i] -= 2.0 * math.pi * np.cumsum(back)
                    change -= 2.0 * math.pi * back
            np.maximum(most, np.abs(change) / unit[i], out=most)
        return q if np.all(most <= STEP * status[:, 2]) else None

    def _run(
        self, values: Array, signs: Array, targets: Array, threads: int | None = None
    ) -> tuple[Array, Array]:
        """Configurations (N, nq), and of each the opening, the count of undetermined parts and the
        margin (N, 3).
        """
        from kempe.kernels.compiled import dyads_program as dyads

        ints, floats = self.program
        q = np.empty((len(values), self.system.nq))
        status = np.empty((len(values), 3))

        def work(i: int, j: int) -> int:
            s, t = (a if len(a) == 1 else a[i:j] for a in (signs, targets))
            return dyads.solve(ints, floats, values[i:j], s, t, q[i:j], status[i:j])

        over_chunks(work, len(values), CHUNK, threads, SERIAL_BELOW)
        return q, status

    def values(self, values: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Known coordinates as (N, n_known), and their leading shape. Errors: `InputError`."""
        array = reals(values, "values")
        if array.ndim == 0 or array.shape[-1] != len(self.known):
            got = "a single number" if array.ndim == 0 else f"shape {array.shape}"
            raise InputError(
                f"values have {got}; they must be (..., {len(self.known)}): {', '.join(self.known)}"
            )
        lead = array.shape[:-1]
        return np.ascontiguousarray(array.reshape(math.prod(lead), len(self.known))), lead

    def sign_rows(self, branch: Any, start: Array | None, lead: tuple[int, ...]) -> Array:
        """Signs (1 or N, signs) of a branch, else those of the configurations `start`, else +.
        Errors: `InputError`.
        """
        if branch is None:
            return (
                np.ones((1, self.signs))
                if start is None
                else np.ascontiguousarray(self.branch_of(start))
            )
        given = (
            [{"+": 1.0, "-": -1.0}.get(c, math.nan) for c in branch]
            if isinstance(branch, str)
            else branch
        )
        signs = reals(given, "branch", "signs, +1 or -1")
        if signs.ndim == 0 or signs.shape[-1] != self.signs or not np.all(np.abs(signs) == 1.0):
            each = f"{counted(self.signs, 'sign')}, + or - (1 or -1), one for each dyad"
            raise InputError(
                f"branch is {branch!r}; it must be {each}; "
                f"loops.closed_form({self.known}).describe() tells"
            )
        return _rows(signs, lead, "branch")


def _rows(x: Array, lead: tuple[int, ...], what: str) -> Array:
    """`x` as (1 or N, k), where it has no leading axes or those of the values."""
    if x.ndim > 1 and x.shape[:-1] != lead:
        raise InputError(
            f"{what} has shape {x.shape}; it must be ({x.shape[-1]},) or {(*lead, x.shape[-1])}"
        )
    return np.ascontiguousarray(x.reshape(math.prod(x.shape[:-1]), x.shape[-1]))


@explained
def closed_form(system: Model, known: Sequence[str] | str) -> Plan | Incomplete:
    """The closed form of a planar system for these known coordinates, or `Incomplete`, which says
    what is left over.

    It exists for bodies, joined by revolute, prismatic and fixed joints, that are placed by known
    coordinates, their followers, and dyads of three rigid clusters (Assur groups of the second
    class). Errors: `UnknownNameError` for the names, `InputError` for one that is not in q.
    """
    return _closed_form(system, listed(known, "known"))


def source_values(system: Model, known: Mapping[str, Any]) -> dict[str, Any]:
    """Known values by coordinates of q: a coordinate that follows another is led back to that.

    Errors: `UnknownNameError`, and `InputError` for a coordinate that is held, or two that move
    together.
    """
    out: dict[str, Any] = {}
    for name, given in known.items():
        follower = system.structure.couplings.get(name)
        if follower is None and name not in system.coordinate_names:
            raise UnknownNameError("coordinate", name, system.coordinate_names, system.name)
        if follower is not None and follower.source is None:
            raise InputError(
                f"coordinate {name!r} is held at {follower.offset:g}: it cannot be given"
            )
        number = reals(given, f"coordinate {name!r}", "a number")
        source = name if follower is None else str(follower.source)
        if source in out:
            raise InputError(
                f"known coordinates {name!r} and {source!r} move together: give one of them"
            )
        out[source] = (
            number if follower is None else (number - follower.offset) / follower.multiplier
        )
    return out


def on_branch(
    system: Model,
    known: Mapping[str, Any],
    branch: Any,
    near: Any = None,
    threads: int | None = None,
) -> Array:
    """Configurations (..., nq) on a branch, as `Plan.solve` gives them, for known values by
    coordinate name.

    What cannot close on this branch is put where it nearly touches. Errors: `InputError` where
    there is no closed form, and so no branch signs.
    """
    values = source_values(system, known)
    plan = closed_form(system, tuple(values))
    if isinstance(plan, Incomplete):
        raise InputError(f"branch {branch!r} cannot be looked up: {plan.reason}")
    columns = np.broadcast_arrays(*values.values(), np.zeros(()))[:-1]
    stacked = np.stack(columns, axis=-1) if columns else np.zeros(0)
    return plan.solve(stacked, branch, near, threads)[0]


@kept
def _closed_form(system: Model, names: tuple[str, ...]) -> Plan | Incomplete:
    slots = {c: i for i, c in enumerate(system.coordinate_names)}
    for name in names:
        if name in slots:
            continue
        follower = system.structure.couplings.get(name)
        if follower is None:
            raise UnknownNameError("coordinate", name, system.coordinate_names, system.name)
        follows = (
            f"it follows {follower.source!r}"
            if follower.source
            else f"it is held at {follower.offset:g}"
        )
        raise InputError(f"coordinate {name!r} is not part of q: {follows}")
    if len(set(names)) < len(names):
        raise InputError(f"known names a coordinate twice: {', '.join(names)}")
    parts = parts_of(system)
    if parts.trouble:
        return Incomplete(f"no closed form: {parts.trouble}")
    search = Decomposition(system, parts, [slots[n] for n in names])
    left = search.run()
    if left:
        return _incomplete(search, left)
    dyads = tuple(_in_bodies(d, parts.reps) for d in search.dyads)
    program = search.code.pack([slots[n] for n in names])
    return Plan(system, names, dyads, CLOSED * parts.size, program)


def _in_bodies(dyad: Dyad, reps: tuple[int, ...]) -> Dyad:
    """A dyad whose ends count bodies instead of parts."""
    ends = tuple(PartLine(reps[e.part], *e.rail) for e in dyad.ends)
    return Dyad(
        dyad.kind, dyad.base, dyad.bodies, dyad.joints, dyad.sign, dyad.meaning, ends, dyad.along
    )


def _incomplete(search: Decomposition, left: list[int]) -> Incomplete:
    """What is left over, and why: too little is known, or no dyad is among it."""
    bodies = tuple(b for c in left for p in search.members[c] for b in search.parts.names[p])
    shown = ", ".join(bodies[:8]) + (f", ... ({len(bodies)} in all)" if len(bodies) > 8 else "")
    missing = search.freedom()
    if missing > 0:
        them = "coordinate" if missing == 1 else "coordinates"
        why = f"by counting, {missing} more {them} must be known"
    else:
        why = "they form an Assur group of a higher class, which has no dyad"
    return Incomplete(
        f"no closed form: {shown} cannot be placed one dyad after another; {why}", bodies
    )


# ---- held

# What is held at given values, coordinates and frames, as judges measure it.


WITHIN = (1e-6, 1e-6)
"""Metres and radians that what is held may be off by."""


class HeldCoordinate(NamedTuple):
    """The coordinate `label` of q is `value` (...)."""

    label: str
    place: int
    turns: bool
    value: Any

    def measure(self, system: Model, q: Array, goals: Any, at: Any) -> tuple[Array, Array]:
        """How far (...) configurations q (..., nq) miss it, in metres and in radians."""
        off = np.abs(q[..., self.place] - self.value)
        return (np.zeros_like(off), off) if self.turns else (off, np.zeros_like(off))


def held_at(system: Model, known: Mapping[str, Any]) -> list[tuple[Any, Any, Any]]:
    """Tasks, goals and tolerances of known values by the names of coordinates, or places by the
    names of frames.
    """
    own = {*system.coordinate_names, *system.structure.couplings}
    turns = system.structure.coordinates.turning[system.structure.layout.vector_v].tolist()
    turning = dict(zip(system.structure.layout.vector_q.tolist(), turns, strict=True))
    out: list[tuple[Any, Any, Any]] = []
    for name, value in source_values(system, {k: x for k, x in known.items() if k in own}).items():
        i = system.coordinate_names.index(name)
        out.append((HeldCoordinate(name, i, turning.get(i, True), value), None, WITHIN))
    for name in known.keys() - own:
        whole = np.ndim(known[name]) == 2
        X = np.eye(4)
        place = place_of(system, name, known[name], whole)
        X[: len(place), 3 if not whole else slice(None)] = place
        made = of_target(name, "pose" if whole else "position", Z_AXIS, X)
        out += [(task_of(c, system.dim), None, WITHIN) for c in made]
    return out
