"""The forward geometric model in symbols: formulas such as l1 cos q1 + l2 cos(q1 + q2), from the same description.

The chain is walked as a product of turns and slides. Quarter turns only rename axes, so they are kept apart as a signed
permutation at the right end; what is left is a list of turns about axes that stand still in the frame before, and
neighbours about the same axis, which are parallel joints, are merged into one turn by the sum of their angles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.calls import explained
from kempe.description.parts import Joint
from kempe.errors import InputError, MissingExtraError, UnknownNameError, UnsupportedError
from kempe.joints import Q, R
from kempe.model.tree.coordinates import coordinate_names
from kempe.placement import Placement
from kempe.values import FUNCTIONS, Expression, Value

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

try:
    import sympy
except ImportError:
    raise MissingExtraError("sympy", "symbolic") from None

TURN_LIMIT = 100
"""Turns about different axes in one formula; it doubles in length with each, and nobody reads that."""

_AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
_FUNCTIONS: dict[str, Callable] = {name: getattr(sympy, name) for name in FUNCTIONS if hasattr(sympy, name)} | {
    "hypot": lambda x, y: sympy.sqrt(x**2 + y**2), "radians": lambda x: x * sympy.pi / 180,
    "degrees": lambda x: x * 180 / sympy.pi,
}  # fmt: skip


@explained
def symbolic_fk(
    system: System, frame: FrameLike, *, symbols: Mapping[str, Any] | None = None, snap: float = 0.0
) -> sympy.Matrix:
    """Pose of a body or frame in the ground frame as a sympy Matrix (4, 4), in coordinates and named parameters.

    Symbols are called like the coordinates and the parameters; `symbols` replaces some of them, by name, by other
    symbols, expressions or numbers. Parallel joints come out merged: cos(q1 + q2). Coordinates that follow one other
    or are locked are replaced by what they follow. Quaternions are taken to have norm one (`fk` normalises them).
    Angles that are the nearest double to a multiple of pi/12 become exact; other numbers stay decimals. With `snap`,
    angles within that many radians of a multiple of pi/2 become that multiple (robot files write 1.5708), and axes
    that near to x, y or z become these; the attribute `snapped` of the result says which, one sentence each.
    Jupyter shows the result as a formula; `sympy.latex` prints it.

    Errors: `UnknownNameError` for names; `InputError` for a `snap` that is not in [0, pi/4), and where a parameter and
    a coordinate share a name; `UnsupportedError` beyond `TURN_LIMIT` turns; `MissingExtraError`
    without sympy.

    >>> from kempe import Mechanism
    >>> arm = Mechanism("arm", dim=2)
    >>> l1 = arm.parameter("l1", 0.5)
    >>> _ = arm.revolute("q1", arm.ground, arm.body("upper"))
    >>> _ = arm.revolute("q2", "upper", arm.body("lower"), at=(l1, 0))
    >>> symbolic_fk(arm.build(), "lower")[:2, 3]
    Matrix([
    [l1*cos(q1)],
    [l1*sin(q1)]])
    """
    name = system.structure.frame_name(frame)
    if isinstance(snap, bool) or not isinstance(snap, (int, float)) or not 0.0 <= snap < math.pi / 4:
        raise InputError(f"snap is {snap!r}; it must be an angle in radians, from 0 to less than pi/4")
    leaves = _Leaves(system, symbols or {}, float(snap))
    chain = _TurnProduct()
    for step in _unwrapped(_steps(system, name, leaves)):
        chain.add(step, leaves)
    rotation, position = chain.pose()
    on = system.structure.frames[name].body if name in system.structure.frames else name
    if system.mechanism.bodies[on].particle:
        rotation = sympy.eye(3)  # a particle has no orientation
    out: Any = sympy.Matrix(sympy.BlockMatrix([[rotation, position], [sympy.zeros(1, 3), sympy.eye(1)]]))
    out.snapped = tuple(dict.fromkeys(leaves.snapped))
    return out


# ---- the way from the ground to the frame, as turns, slides and constant rotations


@dataclass(frozen=True)
class _Step:
    """A turn by the angle or a slide by the length `amount` about or along an axis, or a rotation matrix."""

    kind: str
    axis: Any = None
    amount: Any = None
    subject: str = ""


def _steps(system: System, name: str, leaves: _Leaves) -> Iterator[_Step]:
    """Elementary motions from the ground to a body or frame."""
    mechanism, tree = system.mechanism, system.structure.topology
    frame = mechanism.frames.get(name)
    number = tree.bodies.index(frame.body if frame else name)
    path = []
    while number:
        path.append(number - 1)
        number = tree.parent[number - 1]
    for i in reversed(path):
        yield from _joint_steps(system, mechanism.joints[tree.parent_joints[i]], tree.reversed_[i], leaves)
    if frame:
        yield from _placement_steps(frame.X_BF, f"frame {name!r}", leaves)


def _joint_steps(system: System, joint: Joint, backwards: bool, leaves: _Leaves) -> Iterator[_Step]:
    mechanism, subject = system.mechanism, f"joint {joint.name!r}"
    names = coordinate_names(mechanism, joint)
    primitives = joint.type.layout(mechanism.dim, mechanism.bodies[joint.child].particle)[1]
    first, last = (joint.X_CM, joint.X_PF) if backwards else (joint.X_PF, joint.X_CM)
    yield from _placement_steps(first, subject, leaves)
    sign = -1 if backwards else 1
    for p in reversed(primitives) if backwards else primitives:
        if p.kind == Q:
            turned = leaves.ball(names[p.coordinate : p.coordinate + 4], subject)
            yield _Step("rotation", amount=turned.T if backwards else turned, subject=subject)
        else:
            amount = sign * _number(p.multiplier) * leaves.coordinate(names[p.coordinate])
            yield _Step("turn" if p.kind == R else "slide", sympy.Matrix(_AXES[p.axis]), amount, subject)
    yield from _placement_steps(last.inverse(), subject, leaves)


def _placement_steps(X: Placement, subject: str, leaves: _Leaves) -> Iterator[_Step]:
    for motion, numbers in X.steps:
        if motion in _AXES:
            yield _Step("slide", sympy.Matrix(_AXES[motion]), leaves.value(numbers[0]), subject)
        elif motion in ("rx", "ry", "rz"):
            yield _Step("turn", sympy.Matrix(_AXES[motion[1]]), leaves.angle(numbers[0], subject), subject)
        elif motion in ("align", "unalign"):
            yield _Step(motion, leaves.direction(numbers, subject), None, subject)
        elif motion == "quat_wxyz" and any(isinstance(x, Expression) for x in numbers):
            any_length = [leaves.value(x) for x in numbers]
            length = sympy.sqrt(sum(x**2 for x in any_length))
            yield _Step("rotation", amount=_ball([x / length for x in any_length]), subject=subject)
        else:
            constant = Placement(((motion, numbers),)).evaluate({})[:3, :3]
            yield _Step("rotation", amount=leaves.constant(constant, subject), subject=subject)


def _unwrapped(steps: Iterator[_Step]) -> list[_Step]:
    """The steps with 'align, motion about or along z, unalign' rewritten as that motion about or along the axis."""
    out: list[_Step] = []
    for step in steps:
        if step.kind == "unalign":
            k = len(out)
            while k and out[k - 1].kind in ("turn", "slide") and tuple(out[k - 1].axis or ()) == _AXES["z"]:
                k -= 1
            if k and out[k - 1].kind == "align" and out[k - 1].axis == step.axis:
                out[k - 1 :] = [_Step(s.kind, step.axis, s.amount, s.subject) for s in out[k:]]
                continue
        out.append(step)
    return out


def _ball(quat_wxyz: list[Any]) -> sympy.Matrix:
    """Rotation of a quaternion of norm one (Euler and Rodrigues)."""
    w, x, y, z = quat_wxyz
    return sympy.Matrix([
        [1 - 2 * (y**2 + z**2), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x**2 + z**2), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)],
    ])  # fmt: skip


# ---- numbers, parameters and coordinates as sympy expressions


class _Leaves:
    """What the names and numbers of a description are in the formula, and the angles that were snapped."""

    def __init__(self, system: System, symbols: Mapping[str, Any], snap: float):
        mechanism = system.mechanism
        self.snap, self.snapped, self.locks = snap, [], mechanism.locks
        allowed = (*system.coordinate_names, *mechanism.parameters)
        for name in symbols:
            if name not in allowed:
                raise UnknownNameError("coordinate or parameter", name, allowed, system.name)
        given = {k: sympy.sympify(v) for k, v in symbols.items()}
        if None in given.values():
            raise InputError(f"symbols is {symbols}; its values must be symbols, expressions or numbers")
        self.parameters = {n: given.get(n, sympy.Symbol(n)) for n in mechanism.parameters}
        self.coordinates = {n: given.get(n, sympy.Symbol(n)) for n in system.coordinate_names}
        for name in self.parameters.keys() & self.coordinates.keys():
            raise InputError(f"{name!r} is the name of a parameter and of a coordinate; rename one of them")
        turning = _turning(system)
        for name in system.structure.couplings:  # each comes after those that it depends on
            self.coordinates[name] = self._follower(system, name, name in turning)

    def _follower(self, system: System, name: str, turning: bool) -> Any:
        """The coordinate `name` in terms of what it follows."""
        mechanism = system.mechanism
        read = self.angle if turning else self.value
        if name in mechanism.locks:
            return read(mechanism.locks[name], f"lock of {name!r}")
        coupling = mechanism.couplings[name]
        out = read(coupling.offset, f"coupling of {name!r}")
        for source, multiplier in coupling.sources.items():
            out += self.value(multiplier) * self.coordinates[source]
        return out

    def coordinate(self, name: str) -> Any:
        """A coordinate, or what it follows."""
        return self.coordinates[name]

    def ball(self, names: list[str], subject: str) -> sympy.Matrix:
        """Rotation of a quaternion coordinate, constant where that is locked."""
        if names[0] in self.locks:
            return self.constant(spatial.quat_wxyz_to_matrix([self.locks[n] for n in names]), subject)
        return _ball([self.coordinates[n] for n in names])

    def value(self, x: Value, subject: str = "") -> Any:
        """A length or factor."""
        if not isinstance(x, Expression):
            return _number(x)
        return x.fold({**self.parameters, "pi": sympy.pi}, _FUNCTIONS, _number)

    def angle(self, x: Value, subject: str) -> Any:
        """An angle: exact where it is a multiple of pi/12, or of pi/2 after snapping."""
        if isinstance(x, Expression):
            formula = self.value(x)
            return self._exact(float(formula), subject) if formula.is_Float or formula.is_Integer else formula
        return self._exact(x, subject)

    def _exact(self, angle: float, subject: str) -> Any:
        k = round(angle * 12.0 / math.pi)
        exact = sympy.pi * sympy.Rational(k, 12)
        if angle in (float(exact), k * math.pi / 12.0, k * (math.pi / 12.0)):
            return exact
        quarters = sympy.pi * sympy.Rational(round(angle * 2.0 / math.pi), 2)
        if abs(angle - float(quarters)) <= self.snap:
            self.snapped.append(f"{subject}: angle {angle!r} taken as {quarters}")
            return quarters
        return sympy.Float(angle)

    def direction(self, axis: tuple[Any, ...], subject: str) -> sympy.Matrix:
        """Unit vector of an axis, exact where its entries are whole numbers or, after snapping, all but one zero."""
        unit = spatial.unit(axis)
        nearest = np.rint(unit)
        off = float(np.linalg.norm(unit - nearest))
        if np.abs(nearest).sum() == 1.0 and off <= self.snap:
            if off:
                self.snapped.append(f"{subject}: axis {axis} taken as {tuple(nearest.tolist())}")
            return sympy.Matrix([int(x) for x in nearest])
        if all(x.is_integer() for x in axis):
            whole = sympy.Matrix([int(x) for x in axis])
            return whole / sympy.sqrt(whole.dot(whole))
        return sympy.Matrix([_number(x) for x in unit.tolist()])

    def constant(self, matrix: np.ndarray, subject: str) -> sympy.Matrix:
        """A constant rotation matrix: a signed permutation after snapping, if it is near enough to one."""
        nearest = np.rint(matrix)
        if self.snap and abs(np.linalg.det(nearest)) == 1.0 and not np.array_equal(nearest, matrix):
            angle = float(np.linalg.norm(spatial.log_so3(nearest.T @ matrix)))
            if angle <= self.snap:
                self.snapped.append(f"{subject}: rotation matrix moved by {angle:.3g} rad to quarter turns")
                matrix = nearest
        return sympy.Matrix(3, 3, [_number(float(x)) for x in matrix.ravel()])


def _turning(system: System) -> set[str]:
    """Names of the coordinates that are angles."""
    mechanism, out = system.mechanism, set()
    for joint in mechanism.joints.values():
        names = coordinate_names(mechanism, joint)
        primitives = joint.type.layout(mechanism.dim, mechanism.bodies[joint.child].particle)[1]
        out |= {names[p.coordinate] for p in primitives if p.kind == R}
    return out


def _number(x: Any) -> Any:
    """A number as sympy prints it best: whole numbers exactly, others as decimals of the same double."""
    if isinstance(x, str):
        return sympy.nan
    return sympy.Integer(int(x)) if float(x).is_integer() else sympy.Float(float(x))


# ---- the product of the steps


@dataclass
class _Turn:
    """A rotation (about `axis` by `angle`, or `matrix`) and the way from it to the next one, in turned axes."""

    way: Any
    axis: Any = None
    angle: Any = 0
    matrix: Any = None

    @property
    def constant(self) -> bool:
        """Whether it is a rotation by numbers, other than the ground's."""
        if self.matrix is None:
            return self.axis is not None and bool(self.angle.is_number)
        return not self.matrix.free_symbols

    def rotation(self) -> sympy.Matrix:
        """Its matrix (3, 3)."""
        if self.matrix is not None or self.axis is None:
            return sympy.eye(3) if self.matrix is None else self.matrix
        along = self.axis * self.axis.T
        x, y, z = self.axis
        across = sympy.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # Rodrigues, 1840
        return along + sympy.cos(self.angle) * (sympy.eye(3) - along) + sympy.sin(self.angle) * across


class _TurnProduct:
    """Orientation = turns[0] turns[1] ... corner, where `corner` is a signed permutation."""

    def __init__(self) -> None:
        self.turns = [_Turn(sympy.zeros(3, 1))]
        self.corner = sympy.eye(3)

    def add(self, step: _Step, leaves: _Leaves) -> None:
        """Go on by a step."""
        if step.kind == "slide":
            self.turns[-1].way += _product(self.corner, step.axis) * step.amount
        elif step.kind == "turn":
            self.turn(step.axis, step.amount)
        elif step.kind == "rotation":
            self.rotate(step.amount)
        else:
            R_align = spatial.align_z([float(x) for x in step.axis])
            self.rotate(leaves.constant(R_align if step.kind == "align" else R_align.T, step.subject))

    def turn(self, axis: Any, angle: Any) -> None:
        """Turn by an angle about an axis of the frame reached so far."""
        axis = self.corner * axis
        quarters = 2 * angle / sympy.pi
        if quarters.is_Integer and _is_corner(axis):
            self.corner = _Turn(sympy.zeros(3, 1), axis, angle).rotation() * self.corner
            return
        if _is_corner(axis) and min(axis) < 0:
            axis, angle = -axis, -angle
        last = self.turns[-1]
        if last.axis is not None and last.axis in (axis, -axis):
            # turn(a) way turn(b) = [turn(a) way], then turn(a + b)
            self.turns[-2].way += _product(last.rotation(), last.way)
            last.way = sympy.zeros(3, 1)
            last.angle = sympy.expand(last.angle + (angle if last.axis == axis else -angle))
            if (2 * last.angle / sympy.pi).is_Integer and _is_corner(axis):
                self.turns.pop()
                self.turn(self.corner.T * last.axis, last.angle)
        elif angle != 0:
            self._append(_Turn(sympy.zeros(3, 1), axis, angle))

    def rotate(self, matrix: Any) -> None:
        """Turn by a rotation matrix."""
        if all(x in (-1, 0, 1) for x in matrix):
            self.corner = self.corner * matrix
        else:
            turned = self.corner * matrix * self.corner.T
            self._append(_Turn(sympy.zeros(3, 1), matrix=turned))

    def _append(self, turn: _Turn) -> None:
        last = self.turns[-1]
        if last.constant and turn.constant:  # one matrix of numbers instead of a product
            self.turns[-2].way += _product(last.rotation(), last.way)
            self.turns[-1] = _Turn(sympy.zeros(3, 1), matrix=_product(last.rotation(), turn.rotation()))
            return
        self.turns.append(turn)
        if len(self.turns) > TURN_LIMIT + 1:
            raise UnsupportedError(f"the formula has more than {TURN_LIMIT} turns of different axes; take a subchain")

    def pose(self) -> tuple[sympy.Matrix, sympy.Matrix]:
        """Rotation (3, 3) and position (3, 1)."""
        rotation, position = self.corner, sympy.zeros(3, 1)
        for turn in reversed(self.turns):
            R_turn = turn.rotation()
            rotation, position = _product(R_turn, rotation), _product(R_turn, turn.way + position)
        return rotation, position


def _product(a: Any, b: Any) -> Any:
    """Matrix product. Most entries are zero, and sympy asks of each factor of a zero whether it is finite."""

    def entry(i: int, j: int) -> Any:
        pairs = zip(a.row(i), b.col(j), strict=True)
        return sympy.Add(*(_times(x, y) for x, y in pairs if x != 0 and y != 0))

    return sympy.Matrix(a.rows, b.cols, entry)


def _times(x: Any, y: Any) -> Any:
    """Product in which a sum of negative terms gives its sign to the other factor."""
    return -x * -y if y.is_Add and all(term.could_extract_minus_sign() for term in y.args) else x * y


def _is_corner(axis: Any) -> bool:
    return all(x in (-1, 0, 1) for x in axis)
