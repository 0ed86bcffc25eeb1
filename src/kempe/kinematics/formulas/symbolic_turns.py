"""Products of turns and slides in symbols, with parallel turns merged into one by the sum of their
angles.

Quarter turns only rename axes, so they are kept apart as a signed permutation at the right end;
what is left is a list of turns about axes that stand still in the frame before, and neighbours
about the same axis are merged.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kempe import spatial
from kempe.errors import MissingExtraError, UnsupportedError

if TYPE_CHECKING:
    from kempe.kinematics.formulas.symbolic import SymbolLeaves

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
    """A turn by the angle or a slide by the length `amount` about or along an axis, or a rotation
    matrix.
    """

    kind: str
    axis: Any = None
    amount: Any = None
    subject: str = ""


def unwrapped(steps: Iterable[SymbolicStep]) -> list[SymbolicStep]:
    """The steps with 'align, motion about or along z, unalign' rewritten as that motion about or
    along the axis.
    """
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
    """A rotation (about `axis` by `angle`, or `matrix`) and the way from it to the next one, in
    turned axes.
    """

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

    def rotation(self) -> Any:
        """Its matrix (3, 3)."""
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
    """Orientation = turns[0] turns[1] ... corner, where `corner` is a signed permutation."""

    def __init__(self) -> None:
        self.turns = [_Turn(sympy.zeros(3, 1))]
        self.corner = sympy.eye(3)

    def add(self, step: SymbolicStep, leaves: SymbolLeaves) -> None:
        """Go on by a step."""
        if step.kind == "slide":
            self.turns[-1].way += _product(self.corner, step.axis) * step.amount
        elif step.kind == "turn":
            self.turn(step.axis, step.amount)
        elif step.kind == "rotation":
            self.rotate(step.amount)
        else:
            R_align = spatial.align_z([float(x) for x in step.axis])
            self.rotate(
                leaves.constant(R_align if step.kind == "align" else R_align.T, step.subject)
            )

    def turn(self, axis: Any, angle: Any) -> None:
        """Turn by an angle about an axis of the frame reached so far."""
        axis = self.corner * axis
        quarters = 2 * angle / sympy.pi
        if quarters.is_Integer and _is_corner(axis):
            self.corner = _Turn(sympy.zeros(3, 1), axis, angle).rotation() * self.corner
            return
        if _is_corner(axis) and min(axis) < 0:
            axis = -axis
            angle = -angle
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
            self.turns[-1] = _Turn(
                sympy.zeros(3, 1), matrix=_product(last.rotation(), turn.rotation())
            )
            return
        self.turns.append(turn)
        if len(self.turns) > TURN_LIMIT + 1:
            raise UnsupportedError(
                f"the formula has more than {TURN_LIMIT} turns of different axes; take a subchain"
            )

    def pose(self) -> tuple[Any, Any]:
        """Rotation (3, 3) and position (3, 1)."""
        rotation = self.corner
        position = sympy.zeros(3, 1)
        for turn in reversed(self.turns):
            R_turn = turn.rotation()
            rotation = _product(R_turn, rotation)
            position = _product(R_turn, turn.way + position)
        return rotation, position


def _product(a: Any, b: Any) -> Any:
    """Matrix product. Most entries are zero, and sympy asks of each factor of a zero whether it is
    finite.
    """

    def entry(i: int, j: int) -> Any:
        pairs = zip(a.row(i), b.col(j), strict=True)
        return sympy.Add(*(_times(x, y) for x, y in pairs if x != 0 and y != 0))

    return sympy.Matrix(a.rows, b.cols, entry)


def _times(x: Any, y: Any) -> Any:
    """Product in which a sum of negative terms gives its sign to the other factor."""
    return (
        -x * -y if y.is_Add and all(term.could_extract_minus_sign() for term in y.args) else x * y
    )


def _is_corner(axis: Any) -> bool:
    return all(x in (-1, 0, 1) for x in axis)


def pose_of(steps: Iterable[SymbolicStep], leaves: SymbolLeaves) -> Any:
    """The product of steps as a pose (4, 4)."""
    chain = TurnProduct()
    for step in unwrapped(steps):
        chain.add(step, leaves)
    rotation, position = chain.pose()
    return sympy.Matrix(
        sympy.BlockMatrix([[rotation, position], [sympy.zeros(1, 3), sympy.eye(1)]])
    )
