"""Forward kinematics as formulas, such as l1 cos q1 + l2 cos(q1 + q2).

The chain is a product of turns and slides. Neighbouring parallel turns become one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.arguments import explain_errors
from kempe.description.parts import Joint
from kempe.errors import InputError, MissingExtraError, UnknownNameError, UnsupportedError
from kempe.joints import Q, R
from kempe.model.coordinates import list_coordinate_names
from kempe.poses import Placement
from kempe.values import FUNCTIONS, Expression, Value

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- products of turns and slides

# Quarter turns only rename axes, so they are kept apart as a signed permutation at the right end;
# what is left is a list of turns about axes that stand still in the frame before, and neighbours
# about the same axis are merged.

try:
    import sympy as _sympy
except ImportError:
    raise MissingExtraError("sympy", "symbolic") from None

sympy: Any = _sympy
"""The package without types, of which it has only some."""

TURN_LIMIT = 100
"""Turns about different axes in one formula; it doubles in length with each, and nobody reads
that."""

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


@dataclass(frozen=True)
class SymbolicStep:
    """One motion of a chain: a turn or slide by `amount` about or along an axis, or a rotation.

    The amount is an angle, a length or a rotation matrix.
    """

    kind: str
    axis: Any = None
    amount: Any = None
    subject: str = ""


def unwrap_alignments(steps: Iterable[SymbolicStep]) -> list[SymbolicStep]:
    """Replace 'align, motion about or along z, unalign' by the motion about or along the axis."""
    out: list[SymbolicStep] = []
    for step in steps:
        if step.kind == "unalign":
            k = len(out)
            while (
                k
                and out[k - 1].kind in ("turn", "slide")
                and tuple(out[k - 1].axis or ()) == AXES["z"]
            ):
                k -= 1
            if k and out[k - 1].kind == "align" and out[k - 1].axis == step.axis:
                out[k - 1 :] = [
                    SymbolicStep(s.kind, step.axis, s.amount, s.subject) for s in out[k:]
                ]
                continue
        out.append(step)
    return out


@dataclass
class _Turn:
    """A rotation in a product, and the displacement `way` to the next one in rotated axes.

    The rotation is about `axis` by `angle`, or a `matrix`.
    """

    way: Any
    axis: Any = None
    angle: Any = 0
    matrix: Any = None

    @property
    def constant(self) -> bool:
        """Whether the rotation is constant, and not that of the ground."""
        if self.matrix is None:
            return self.axis is not None and bool(self.angle.is_number)
        return not self.matrix.free_symbols

    def build_rotation(self) -> Any:
        """Build the rotation matrix (3, 3)."""
        if self.matrix is not None or self.axis is None:
            return sympy.eye(3) if self.matrix is None else self.matrix
        along = self.axis * self.axis.T
        x, y, z = self.axis
        across = sympy.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # Rodrigues, 1840
        return (
            along + sympy.cos(self.angle) * (sympy.eye(3) - along) + sympy.sin(self.angle) * across
        )


class TurnProduct:
    """A product of turns and slides, with neighbouring parallel turns merged.

    The orientation is turns[0] turns[1] ... corner, where `corner` is a signed permutation.
    """

    def __init__(self) -> None:
        self.turns = [_Turn(sympy.zeros(3, 1))]
        self.corner = sympy.eye(3)

    def add_step(self, step: SymbolicStep, leaves: SymbolLeaves) -> None:
        """Multiply the product by a step."""
        if step.kind == "slide":
            self.turns[-1].way += _multiply_matrices(self.corner, step.axis) * step.amount
        elif step.kind == "turn":
            self.add_turn(step.axis, step.amount)
        elif step.kind == "rotation":
            self.add_rotation(step.amount)
        else:
            R_align = spatial.align_z([float(x) for x in step.axis])
            self.add_rotation(
                leaves.express_constant_rotation(
                    R_align if step.kind == "align" else R_align.T, step.subject
                )
            )

    def add_turn(self, axis: Any, angle: Any) -> None:
        """Multiply the product by a turn about an axis of the frame reached so far."""
        axis = self.corner * axis
        quarters = 2 * angle / sympy.pi
        if quarters.is_Integer and _is_coordinate_axis(axis):
            self.corner = _Turn(sympy.zeros(3, 1), axis, angle).build_rotation() * self.corner
            return
        if _is_coordinate_axis(axis) and min(axis) < 0:
            axis = -axis
            angle = -angle
        last = self.turns[-1]
        if last.axis is not None and last.axis in (axis, -axis):
            # turn(a) way turn(b) = [turn(a) way], then turn(a + b)
            self.turns[-2].way += _multiply_matrices(last.build_rotation(), last.way)
            last.way = sympy.zeros(3, 1)
            last.angle = sympy.expand(last.angle + (angle if last.axis == axis else -angle))
            if (2 * last.angle / sympy.pi).is_Integer and _is_coordinate_axis(axis):
                self.turns.pop()
                self.add_turn(self.corner.T * last.axis, last.angle)
        elif angle != 0:
            self._append_factor(_Turn(sympy.zeros(3, 1), axis, angle))

    def add_rotation(self, matrix: Any) -> None:
        """Multiply the product by a rotation matrix."""
        if all(x in (-1, 0, 1) for x in matrix):
            self.corner = self.corner * matrix
        else:
            turned = self.corner * matrix * self.corner.T
            self._append_factor(_Turn(sympy.zeros(3, 1), matrix=turned))

    def _append_factor(self, turn: _Turn) -> None:
        """Append a turn to the list, merged with the last one where both are constant."""
        last = self.turns[-1]
        if last.constant and turn.constant:  # one matrix of numbers instead of a product
            self.turns[-2].way += _multiply_matrices(last.build_rotation(), last.way)
            self.turns[-1] = _Turn(
                sympy.zeros(3, 1),
                matrix=_multiply_matrices(last.build_rotation(), turn.build_rotation()),
            )
            return
        self.turns.append(turn)
        if len(self.turns) > TURN_LIMIT + 1:
            raise UnsupportedError(
                f"the formula has more than {TURN_LIMIT} turns of different axes; take a subchain"
            )

    def multiply_turns(self) -> tuple[Any, Any]:
        """Multiply all turns out to a rotation (3, 3) and a position (3, 1)."""
        rotation = self.corner
        position = sympy.zeros(3, 1)
        for turn in reversed(self.turns):
            R_turn = turn.build_rotation()
            rotation = _multiply_matrices(R_turn, rotation)
            position = _multiply_matrices(R_turn, turn.way + position)
        return rotation, position


def _multiply_matrices(a: Any, b: Any) -> Any:
    """Multiply two matrices, skipping zeros, which sympy would ask about their factors."""

    def compute_entry(i: int, j: int) -> Any:
        pairs = zip(a.row(i), b.col(j), strict=True)
        return sympy.Add(*(_multiply_terms(x, y) for x, y in pairs if x != 0 and y != 0))

    return sympy.Matrix(a.rows, b.cols, compute_entry)


def _multiply_terms(x: Any, y: Any) -> Any:
    """Multiply two terms; a sum of negative terms gives its sign to the other factor."""
    return (
        -x * -y if y.is_Add and all(term.could_extract_minus_sign() for term in y.args) else x * y
    )


def _is_coordinate_axis(axis: Any) -> bool:
    """Return whether all entries of a vector are -1, 0 or 1."""
    return all(x in (-1, 0, 1) for x in axis)


def multiply_steps(steps: Iterable[SymbolicStep], leaves: SymbolLeaves) -> Any:
    """Multiply steps out to a pose (4, 4)."""
    chain = TurnProduct()
    for step in unwrap_alignments(steps):
        chain.add_step(step, leaves)
    rotation, position = chain.multiply_turns()
    return sympy.Matrix(
        sympy.BlockMatrix([[rotation, position], [sympy.zeros(1, 3), sympy.eye(1)]])
    )


# ---- formulas of poses, and their LaTeX

WORD = re.compile(r"(?<![\\A-Za-z])[A-Za-z][A-Za-z.]+")
"""What is a word in the LaTeX of a name, not a letter or a command."""
SPECIAL = re.compile(r"(?<!\\)[%#$&]")
"""What LaTeX would read as a command in a name of which sympy has set the indices."""
ESCAPED = str.maketrans(
    {c: "\\" + c for c in "%#$&_{}"} | {"^": r"\wedge ", "\\": r"\backslash ", "~": r"\sim "}
)
"""All that LaTeX would read as a command in a name."""


def _express_hypot(x: Any, y: Any) -> Any:
    return sympy.sqrt(x**2 + y**2)


def _convert_to_radians(x: Any) -> Any:
    return x * sympy.pi / 180


def _convert_to_degrees(x: Any) -> Any:
    return x * 180 / sympy.pi


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(sympy, name) for name in FUNCTIONS if hasattr(sympy, name)
}
_FUNCTIONS |= {
    "hypot": _express_hypot,
    "radians": _convert_to_radians,
    "degrees": _convert_to_degrees,
}


@explain_errors
def derive_fk(
    system: Model,
    frame: FrameLike,
    *,
    relative_to: FrameLike | None = None,
    symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> Any:
    """Derive the pose of a body or frame as a sympy Matrix (4, 4), in coordinates and parameters.

    It is the pose in the ground frame, or in the frame `relative_to`, by the joints between the
    two.

    Symbols are called like the coordinates and the parameters; `symbols` replaces some of them, by
    name, by other symbols, expressions or numbers. Parallel joints come out merged: cos(q1 + q2).
    Coordinates that follow one other or are locked are replaced by what they follow. Quaternions
    are taken to have norm one (`fk` normalises them). Angles that are the nearest double to a
    multiple of pi/12 become exact; other numbers stay decimals. With `snap`, angles within that
    many radians of a multiple of pi/2 become that multiple (robot files write 1.5708), and axes
    that near to x, y or z become these; the attribute `snapped` of the result says which, one
    sentence each. Jupyter shows the result as a formula; `sympy.latex` prints it.

    Errors: `UnknownNameError` for names; `InputError` for a `snap` that is not in [0, pi/4), and
    where a parameter and a coordinate share a name; `UnsupportedError` beyond `TURN_LIMIT` turns;
    `MissingExtraError`
    without sympy, `UnsupportedError` for particles where a frame is given that they are relative
    to.

    >>> from kempe import Mechanism
    >>> arm = Mechanism("arm", dim=2)
    >>> l1 = arm.parameter("l1", 0.5)
    >>> _ = arm.revolute("q1", arm.ground, arm.body("upper"))
    >>> _ = arm.revolute("q2", "upper", arm.body("lower"), at=(l1, 0))
    >>> derive_fk(arm.build(), "lower")[:2, 3]
    Matrix([
    [l1*cos(q1)],
    [l1*sin(q1)]])
    """
    name = system.structure.frame_name(frame)
    leaves = SymbolLeaves(system, symbols or {}, snap)
    out: Any = multiply_steps(_list_steps_between(system, name, relative_to, leaves), leaves)
    if system.structure.table.at[name][2]:
        out[:3, :3] = sympy.eye(3)  # a particle has no orientation
    out.snapped = tuple(dict.fromkeys(leaves.snapped))
    return out


def format_latex(formula: Any, names: Mapping[Any, str] | None = None) -> str:
    """Format a formula in LaTeX, with names of several letters upright.

    `names` gives other names.
    """
    own = {
        s: SPECIAL.sub(
            r"\\\g<0>",
            WORD.sub(r"\\mathrm{\g<0>}", sympy.latex(s)).replace(r" \mathrm", r"\,\mathrm"),
        )
        for s in formula.free_symbols
    }
    text = str(sympy.latex(formula, symbol_names={**own, **(names or {})}))
    return text.replace(r"\operatorname{atan}_{2}", r"\operatorname{atan2}")


def format_upright_name(name: str) -> str:
    """Format the name of a body or frame in LaTeX, in upright letters; numbers stay as they are."""
    if name.isdigit():
        return name
    return rf"\mathrm{{{name.translate(ESCAPED)}}}"


def align_formulas(lines: Iterable[str]) -> str:
    """Join formulas in LaTeX, one below the other, aligned at their `&`."""
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


# ---- the way to a frame, as turns, slides and constant rotations


def _list_steps_between(
    system: Model, name: str, base: FrameLike | None, leaves: SymbolLeaves
) -> list[SymbolicStep]:
    """List the motions from the ground, or from the frame `base`, to the frame `name`."""
    if base is None:
        return [step for _, steps in list_steps_by_body(system, name, leaves) for step in steps]
    there, since = (list_oriented_steps(system, x, leaves) for x in (name, base))
    shared = 0
    while shared < min(len(there), len(since)) and there[shared][0] == since[shared][0]:
        shared += 1
    back = invert_steps([step for _, steps in since[shared:] for step in steps])
    return back + [step for _, steps in there[shared:] for step in steps]


def list_oriented_steps(
    system: Model, frame: FrameLike, leaves: SymbolLeaves
) -> list[tuple[str, list[SymbolicStep]]]:
    """List the motions to a frame that has an orientation, by body.

    Errors: `UnsupportedError` for particles.
    """
    name = system.structure.frame_name(frame)
    if system.structure.table.at[name][2]:
        raise UnsupportedError(
            f"{name!r} is a particle and has no orientation; symbolic.fk gives its position"
        )
    return list_steps_by_body(system, name, leaves)


def invert_steps(steps: Iterable[SymbolicStep]) -> list[SymbolicStep]:
    """Invert a sequence of motions."""
    return [_invert_step(step) for step in reversed(list(steps))]


def _invert_step(step: SymbolicStep) -> SymbolicStep:
    """Invert one motion."""
    if step.kind in ("turn", "slide"):
        return SymbolicStep(step.kind, step.axis, -step.amount, step.subject)
    if step.kind == "rotation":
        return SymbolicStep(step.kind, amount=step.amount.T, subject=step.subject)
    return SymbolicStep(
        {"align": "unalign", "unalign": "align"}[step.kind], step.axis, None, step.subject
    )


def list_steps_by_body(
    system: Model, name: str, leaves: SymbolLeaves
) -> list[tuple[str, list[SymbolicStep]]]:
    """List the bodies from the ground to a body or frame, each with the motions that lead to it."""
    mechanism = system.mechanism
    tree = system.structure.topology
    frame = mechanism.frames.get(name)
    number = tree.bodies.index(frame.body if frame else name)
    out: list[tuple[str, list[SymbolicStep]]] = []
    while number:
        i = number - 1
        joint = mechanism.joints[tree.parent_joints[i]]
        out.append(
            (
                tree.bodies[number],
                list(_iterate_joint_steps(system, joint, tree.reversed_[i], leaves)),
            )
        )
        number = tree.parent[i]
    out.reverse()
    if frame:
        out.append((name, list(iterate_placement_steps(frame.X_BF, f"frame {name!r}", leaves))))
    return out


def _iterate_joint_steps(
    system: Model, joint: Joint, backwards: bool, leaves: SymbolLeaves
) -> Iterator[SymbolicStep]:
    """Iterate over the motions of a joint between two bodies, with its placements."""
    subject = f"joint {joint.name!r}"
    first, last = (joint.X_CM, joint.X_PF) if backwards else (joint.X_PF, joint.X_CM)
    yield from iterate_placement_steps(first, subject, leaves)
    yield from iterate_joint_motions(system, joint, backwards, leaves)
    yield from iterate_placement_steps(last.invert_steps(), subject, leaves)


def iterate_joint_motions(
    system: Model, joint: Joint, backwards: bool, leaves: SymbolLeaves
) -> Iterator[SymbolicStep]:
    """Iterate over the motions of a joint from its frame F to M, or back."""
    mechanism = system.mechanism
    subject = f"joint {joint.name!r}"
    names = list_coordinate_names(mechanism, joint)
    primitives = joint.type.layout(mechanism.dim, mechanism.bodies[joint.child].particle)[1]
    sign = -1 if backwards else 1
    for p in reversed(primitives) if backwards else primitives:
        if p.kind == Q:
            turned = leaves.express_ball_rotation(names[p.coordinate : p.coordinate + 4], subject)
            yield SymbolicStep(
                "rotation", amount=turned.T if backwards else turned, subject=subject
            )
        else:
            amount = (
                sign
                * _express_number(p.multiplier)
                * leaves.express_coordinate(names[p.coordinate])
            )
            yield SymbolicStep(
                "turn" if p.kind == R else "slide", sympy.Matrix(AXES[p.axis]), amount, subject
            )


def iterate_placement_steps(
    X: Placement, subject: str, leaves: SymbolLeaves
) -> Iterator[SymbolicStep]:
    """Iterate over the motions of a placement."""
    for motion, numbers in X.steps:
        if motion in AXES:
            yield SymbolicStep(
                "slide", sympy.Matrix(AXES[motion]), leaves.express_value(numbers[0]), subject
            )
        elif motion in ("rx", "ry", "rz"):
            yield SymbolicStep(
                "turn",
                sympy.Matrix(AXES[motion[1]]),
                leaves.express_angle(numbers[0], subject),
                subject,
            )
        elif motion in ("align", "unalign"):
            yield SymbolicStep(motion, leaves.express_direction(numbers, subject), None, subject)
        elif motion == "quat_wxyz" and any(isinstance(x, Expression) for x in numbers):
            any_length = [leaves.express_value(x) for x in numbers]
            length = sympy.sqrt(sum(x**2 for x in any_length))
            yield SymbolicStep(
                "rotation", amount=_make_rotation([x / length for x in any_length]), subject=subject
            )
        else:
            constant = Placement(((motion, numbers),)).evaluate_pose({})[:3, :3]
            yield SymbolicStep(
                "rotation",
                amount=leaves.express_constant_rotation(constant, subject),
                subject=subject,
            )


def _make_rotation(quat_wxyz: list[Any]) -> Any:
    """Make the rotation matrix (3, 3) of a unit quaternion (Euler and Rodrigues)."""
    w, x, y, z = quat_wxyz
    return sympy.Matrix([
        [1 - 2 * (y**2 + z**2), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x**2 + z**2), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)],
    ])  # fmt: skip


# ---- numbers, parameters and coordinates as sympy expressions


class SymbolLeaves:
    """Numbers, parameters and coordinates of a description as sympy expressions.

    `snapped` lists the angles that were rounded.
    """

    def __init__(self, system: Model, symbols: Mapping[str, Any], snap: float):
        if (
            isinstance(snap, bool)
            or not isinstance(snap, (int, float))
            or not 0.0 <= snap < math.pi / 4
        ):
            raise InputError(
                f"snap is {snap!r}; it must be an angle in radians, from 0 to less than pi/4"
            )
        mechanism = system.mechanism
        self.snap = float(snap)
        self.locks = mechanism.locks
        self.snapped: list[str] = []
        allowed = (*system.coordinate_names, *mechanism.parameters)
        for name in symbols:
            if name not in allowed:
                raise UnknownNameError("coordinate or parameter", name, allowed, system.name)
        given = {k: sympy.sympify(v) for k, v in symbols.items()}
        self.given = given
        if None in given.values():
            raise InputError(
                f"symbols is {symbols}; its values must be symbols, expressions or numbers"
            )
        self.parameters = {n: given.get(n, sympy.Symbol(n)) for n in mechanism.parameters}
        self.coordinates = {n: given.get(n, sympy.Symbol(n)) for n in system.coordinate_names}
        for name in self.parameters.keys() & self.coordinates.keys():
            raise InputError(
                f"{name!r} is the name of a parameter and of a coordinate; rename one of them"
            )
        turning = _list_angle_names(system)
        for name in system.structure.couplings:  # each comes after those that it depends on
            self.coordinates[name] = self._express_follower(system, name, name in turning)

    def _express_follower(self, system: Model, name: str, turning: bool) -> Any:
        """Express the coordinate `name` by the coordinates that it follows."""
        mechanism = system.mechanism
        read = self.express_angle if turning else self.express_value
        if name in mechanism.locks:
            return read(mechanism.locks[name], f"lock of {name!r}")
        coupling = mechanism.couplings[name]
        out = read(coupling.offset, f"coupling of {name!r}")
        for source, multiplier in coupling.sources.items():
            out += self.express_value(multiplier) * self.coordinates[source]
        return out

    def express_coordinate(self, name: str) -> Any:
        """Return the expression of a coordinate, or of the coordinates that it follows."""
        return self.coordinates[name]

    def express_ball_rotation(self, names: list[str], subject: str) -> Any:
        """Return the rotation matrix of a quaternion coordinate, constant where that is locked."""
        if names[0] in self.locks:
            return self.express_constant_rotation(
                spatial.quat_wxyz_to_matrix([self.locks[n] for n in names]), subject
            )
        return _make_rotation([self.coordinates[n] for n in names])

    def express_value(self, x: Value, subject: str = "") -> Any:
        """Return the expression of a length or factor."""
        if not isinstance(x, Expression):
            return _express_number(x)
        return x.fold({**self.parameters, "pi": sympy.pi}, _FUNCTIONS, _express_number)

    def express_angle(self, x: Value, subject: str) -> Any:
        """Return the expression of an angle, exact for multiples of pi/12, snapped ones of pi/2."""
        if isinstance(x, Expression):
            formula = self.express_value(x)
            return (
                self._make_exact_angle(float(formula), subject)
                if formula.is_Float or formula.is_Integer
                else formula
            )
        return self._make_exact_angle(x, subject)

    def _make_exact_angle(self, angle: float, subject: str) -> Any:
        """Return a number as an exact angle, where it is near enough to one."""
        k = round(angle * 12.0 / math.pi)
        exact = sympy.pi * sympy.Rational(k, 12)
        if angle in (float(exact), k * math.pi / 12.0, k * (math.pi / 12.0)):
            return exact
        quarters = sympy.pi * sympy.Rational(round(angle * 2.0 / math.pi), 2)
        if abs(angle - float(quarters)) <= self.snap:
            self.snapped.append(f"{subject}: angle {angle!r} taken as {quarters}")
            return quarters
        return sympy.Float(angle)

    def express_direction(self, axis: tuple[Any, ...], subject: str) -> Any:
        """Return the unit vector of an axis, exact for whole or snapped entries."""
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
        return sympy.Matrix([_express_number(x) for x in unit.tolist()])

    def express_constant_rotation(self, matrix: np.ndarray, subject: str) -> Any:
        """Return a constant rotation matrix, snapped to a signed permutation where near enough."""
        nearest = np.rint(matrix)
        if self.snap and abs(np.linalg.det(nearest)) == 1.0 and not np.array_equal(nearest, matrix):
            angle = float(np.linalg.norm(spatial.log_so3(nearest.T @ matrix)))
            if angle <= self.snap:
                self.snapped.append(
                    f"{subject}: rotation matrix moved by {angle:.3g} rad to quarter turns"
                )
                matrix = nearest
        return sympy.Matrix(3, 3, [_express_number(float(x)) for x in matrix.ravel()])


def _list_angle_names(system: Model) -> set[str]:
    """List the names of the coordinates that are angles."""
    mechanism = system.mechanism
    out: set[str] = set()
    for joint in mechanism.joints.values():
        names = list_coordinate_names(mechanism, joint)
        primitives = joint.type.layout(mechanism.dim, mechanism.bodies[joint.child].particle)[1]
        out |= {names[p.coordinate] for p in primitives if p.kind == R}
    return out


def _express_number(x: Any) -> Any:
    """Return a number for sympy: whole numbers exactly, others as decimals of the same double."""
    if isinstance(x, str):
        return sympy.nan
    return sympy.Integer(int(x)) if float(x).is_integer() else sympy.Float(float(x))
