"""Closed-form inverse kinematics as symbolic formulas, for three joints in the plane.

The triangle of three joints is closed by two circles, a line and a circle, or two lines. An arm that reaches a
point or a pose, and a dyad between two links, make the same triangle (Assur, 1914).
"""

from __future__ import annotations

import itertools
import keyword
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.errors import InputError
from kempe.forward.symbolic import align_formulas, format_latex, sympy
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- derivations: evaluated, in LaTeX, and as functions for numpy


class FormulaStep(NamedTuple):
    """One line of a derivation: `symbol` = `formula`, its explanation, and when it holds."""

    symbol: Any
    formula: Any
    says: str
    condition: str = ""


@dataclass(frozen=True, eq=False)
class Derivation:
    """Formulas that lead from given symbols to coordinates; lengths are parameters of the system."""

    system: Model
    steps: tuple[FormulaStep, ...]
    given: tuple[Any, ...]
    """Symbols of what is given."""
    signs: tuple[Any, ...]
    """Symbols of the signs, -1 or +1, that choose among the solutions."""
    coordinates: tuple[str, ...]
    """Names of the coordinates that are found."""

    def evaluate(self, given: Array, signs: Array) -> Array:
        """Evaluate the coordinates (..., k) for given numbers (..., n) and signs (..., m).

        Rows where a condition fails are NaN.

        Errors: `InputError` for lengths without a number.
        """
        known: dict[Any, Any] = {
            sympy.Symbol(n): v for n, v in self.system.structure.parameters.items()
        }
        unknown = sorted(map(str, self._find_lengths() - set(known)))
        if unknown:
            raise InputError(
                f"no numbers are known for {', '.join(unknown)}; they are no parameters of the "
                "system"
            )
        known |= {s: given[..., i] for i, s in enumerate(self.given)}
        known |= {s: signs[..., i] for i, s in enumerate(self.signs)}
        lead = np.broadcast_shapes(given.shape[:-1], signs.shape[:-1])
        with np.errstate(invalid="ignore", divide="ignore"):
            for step, (symbols, function) in zip(self.steps, self._functions, strict=True):
                known[step.symbol] = function(*(known[s] for s in symbols))
        columns = [np.broadcast_to(known[sympy.Symbol(name)], lead) for name in self.coordinates]
        out = np.stack(columns, axis=-1).astype(float)
        out[np.isnan(out).any(axis=-1)] = np.nan
        return out

    @cached_property
    def _functions(self) -> list[tuple[list[Any], Any]]:
        """For each step the symbols in its formula, and the formula as a numpy function of these."""
        each = [(sorted(step.formula.free_symbols, key=str), step.formula) for step in self.steps]
        return [(symbols, sympy.lambdify(symbols, formula, "numpy")) for symbols, formula in each]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the numpy functions of `_functions`, which cannot be pickled."""
        return {name: value for name, value in vars(self).items() if name != "_functions"}

    def latex(self) -> str:
        """Return the formulas in LaTeX, one line each, with plus-minus for signs and six digits."""
        names = {
            s: r"\pm" + (f"_{{{k}}}" if len(self.signs) > 1 else "")
            for k, s in enumerate(self.signs, 1)
        }
        for step in self.steps:
            square = SQUARE.fullmatch(str(step.symbol))
            if square and str(step.symbol) not in self.coordinates:
                names[step.symbol] = "r" + f"_{{{square[1]}}}" * bool(square[1]) + "^{2}"
        lines = (
            f"{format_latex(step.symbol, names)} &= "
            f"{format_latex(_round_numbers(step.formula), names)}"
            for step in self.steps
        )
        return align_formulas(line.replace(r"- \pm", r"\mp") for line in lines)

    def code(self) -> str:
        """Return the source code of a Python function that evaluates the formulas with NumPy alone.

        Names that Python does not allow are changed.
        """
        from sympy.printing.numpy import NumPyPrinter

        given = [*self.given, *self.signs, *sorted(self._find_lengths(), key=str)]
        words: dict[Any, Any] = {}
        for symbol in [*given, *(step.symbol for step in self.steps)]:
            words[symbol] = sympy.Symbol(
                _make_variable_name(str(symbol), {str(word) for word in words.values()})
            )
        arguments = ", ".join(str(words[symbol]) for symbol in given)
        printer: Any = NumPyPrinter()
        printed = printer.doprint
        lines = [
            f"    {words[step.symbol]} = {printed(step.formula.xreplace(words))}"
            for step in self.steps
        ]
        last = (
            f"    return {', '.join(str(words[sympy.Symbol(name)]) for name in self.coordinates)}"
        )
        return (
            "\n".join(["import numpy", "", "", f"def inverse({arguments}):", *lines, last]) + "\n"
        )

    def _find_lengths(self) -> set[Any]:
        """Find the symbols that are neither given nor computed: the lengths of the system."""
        own = {step.symbol for step in self.steps} | {*self.given, *self.signs}
        return {s for step in self.steps for s in step.formula.free_symbols} - own

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __str__(self) -> str:
        return "\n".join(
            f"{step.symbol} = {_round_numbers(step.formula)}"
            + f": {step.says}" * bool(step.says)
            + (f", if {step.condition}" if step.condition else "")
            for step in self.steps
        )


def _round_numbers(formula: Any) -> Any:
    """Round the numbers of a formula to six digits, for printing."""
    return formula.xreplace({x: sympy.Float(f"{float(x):.6g}") for x in formula.atoms(sympy.Float)})


def _make_variable_name(name: str, taken: set[str]) -> str:
    """Make a valid Python name of a symbol's name, different from keywords and from `taken` names.

    Underscores stand in front where the name is not allowed.
    """
    word = re.sub(r"\W", "_", name)
    while not word.isidentifier() or keyword.iskeyword(word) or word in {*taken, "numpy"}:
        word = f"_{word}"
    return word


# ---- vectors of expressions

Vector = tuple[Any, Any]
"""Two expressions, along x and y."""


def rotate_vector(v: Vector, angle: Any) -> Vector:
    """Rotate a plane vector by an angle [rad], counterclockwise."""
    c = sympy.cos(angle)
    s = sympy.sin(angle)
    return c * v[0] - s * v[1], s * v[0] + c * v[1]


def add_vectors(a: Vector, b: Vector) -> Vector:
    """Add two plane vectors."""
    return a[0] + b[0], a[1] + b[1]


def subtract_vectors(a: Vector, b: Vector) -> Vector:
    """Subtract the second plane vector from the first."""
    return a[0] - b[0], a[1] - b[1]


def compute_cross_product(a: Vector, b: Vector) -> Any:
    """Compute the cross product of two plane vectors: a_x b_y - a_y b_x."""
    return a[0] * b[1] - a[1] * b[0]


def to_polar_coordinates(v: Vector) -> tuple[Any, Any]:
    """Return length and angle [rad] of a plane vector.

    For a vector along an axis the length is written without a root.
    """
    x, y = map(sympy.expand, v)
    if y == 0:
        sense = x.could_extract_minus_sign()
        return (-x if sense else x), sympy.pi if sense else sympy.Integer(0)
    if x == 0:
        sense = y.could_extract_minus_sign()
        return (-y if sense else y), (-1 if sense else 1) * sympy.pi / 2
    return sympy.sqrt(x**2 + y**2), sympy.atan2(y, x)


def describe_nonzero_condition(*lengths: Any, named: Any = None) -> str:
    """Write the condition that none of some expressions is zero: 'l1 != 0 and l2 != 0'.

    Numbers other than zero are left out; with `named` this name stands in place of each expression.
    """
    left = [x if named is None else named for x in lengths if not x.is_number or x.is_zero]
    return " and ".join(f"{x} != 0" for x in left)


# ---- the triangle of three joints


def iterate_endings() -> Iterator[str]:
    """Iterate over endings of symbol names: '', '_0', '_1', ...

    The first ending that no symbol of a system has makes new names unique.
    """
    return itertools.chain([""], (f"_{k}" for k in itertools.count()))


SQUARE = re.compile("r2(?:_(.+))?")
"""Names of the symbols `Names.r2`, which are squares of a distance r."""


class Names(NamedTuple):
    """Symbols in the formulas of one triangle of joints."""

    r2: Any
    c2: Any
    s2: Any
    alpha: Any
    beta: Any
    sign: Any
    u: Any

    @classmethod
    def from_ending(cls, end: str) -> Names:
        """Make the symbols with an ending such as '_1'."""
        return cls(*(sympy.Symbol(f"{name}{end}") for name in cls._fields))

    @classmethod
    def from_words(cls, names: dict[str, Any]) -> Names:
        """Select the symbols of a triangle from a dictionary of symbols by name."""
        return cls(*(names[name] for name in cls._fields))


def solve_two_bars(
    n: Names, to: Vector, l1: Any, l2: Any, says: str, sense: int = 1
) -> tuple[list[FormulaStep], Any, Any]:
    """Solve for two bars of lengths l1, l2 in a row whose end is at the point `to`.

    Returned are the steps, the angle of the first bar, and the angle from the first bar to the
    second.

    Where `sign` times `sense` is +1 the second is turned to the left against the first.
    """
    x, y = to
    steps = [
        FormulaStep(n.r2, x**2 + y**2, "both parts of the position squared and summed"),
        FormulaStep(
            n.c2,
            (n.r2 - l1**2 - l2**2) / (2 * l1 * l2),
            "the law of cosines",
            describe_nonzero_condition(l1, l2),
        ),
        FormulaStep(n.s2, sense * n.sign * sympy.sqrt(1 - n.c2**2), says, f"-1 <= {n.c2} <= 1"),
        FormulaStep(n.alpha, sympy.atan2(y, x), "angle to the target", f"{n.r2} != 0"),
        FormulaStep(
            n.beta,
            sympy.atan2(l2 * n.s2, l1 + l2 * n.c2),
            "angle from the first link to the target",
        ),
    ]
    return steps, n.alpha - n.beta, sympy.atan2(n.s2, n.c2)


def solve_slide_and_bar(
    n: Names, to: Vector, along: Vector, length: Any
) -> tuple[list[FormulaStep], Any, Any]:
    """Solve for a slide u along a direction, then a bar, whose end is at the point `to`.

    Returned are the steps, u, and the angle of the bar.

    Where `sign` is +1 it slides farther than where both roots meet.
    """
    ahead = to[0] * along[0] + to[1] * along[1]
    aside = compute_cross_product(along, to)
    steps = [
        FormulaStep(
            n.s2,
            aside / length,
            "part of the way across the slide",
            describe_nonzero_condition(length),
        ),
        FormulaStep(
            n.c2, -n.sign * sympy.sqrt(1 - n.s2**2), "+1 slides farther", f"-1 <= {n.s2} <= 1"
        ),
        FormulaStep(
            n.u, ahead - length * n.c2, "the slide: part of the way along it, less that of the bar"
        ),
        FormulaStep(n.beta, sympy.atan2(n.s2, n.c2), "angle from the slide to the bar"),
    ]
    return steps, n.u, n.beta + to_polar_coordinates(along)[1]


def solve_turning_slide(n: Names, to: Vector, across: Any) -> tuple[list[FormulaStep], Any, Any]:
    """Solve for a turning rail with a point that slides at a distance `across`, at the point `to`.

    Returned are the steps, the slide, and the angle of the rail.

    Where `sign` is +1 it slides farther than where both roots meet, the foot of the rail's normal.
    """
    (x, y) = to
    least = across**2
    far = f"{n.r2} >= {float(least):.6g}" if least.is_number else f"{n.r2} >= {least}"
    steps = [
        FormulaStep(n.r2, x**2 + y**2, "both parts of the position squared and summed"),
        FormulaStep(
            n.u,
            n.sign * sympy.sqrt(n.r2 - least),
            "the slide, by Pythagoras",
            far * (not least.is_zero),
        ),
        FormulaStep(n.alpha, sympy.atan2(y, x), "angle to the target", f"{n.r2} != 0"),
        FormulaStep(n.beta, sympy.atan2(across, n.u), "angle from the rail to the target"),
    ]
    return steps, n.u, n.alpha - n.beta


def solve_two_slides(
    n: Names, to: Vector, one: Vector, two: Vector
) -> tuple[list[FormulaStep], Any, Any]:
    """Solve for two slides along given directions whose sum is the vector `to`.

    Returned are the steps (none for slides at right angles) and both slides.
    """
    area = sympy.simplify(compute_cross_product(one, two))
    if area in (1, -1):
        return [], area * compute_cross_product(to, two), area * compute_cross_product(one, to)
    steps = [
        FormulaStep(
            n.c2,
            area,
            "sine of the angle between the slides",
            describe_nonzero_condition(area, named=n.c2),
        )
    ]
    return steps, compute_cross_product(to, two) / n.c2, compute_cross_product(one, to) / n.c2
