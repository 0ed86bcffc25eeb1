"""Formulas one after another, as a derivation on paper: evaluated, in LaTeX, and as a function for
numpy.
"""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.errors import InputError
from kempe.kinematics.formulas.symbolic import aligned, in_latex
from kempe.kinematics.formulas.symbolic_turns import sympy
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled


class FormulaStep(NamedTuple):
    """One line of a derivation: `symbol` = `formula`, what was done, and the condition under which
    it holds.
    """

    symbol: Any
    formula: Any
    says: str
    condition: str = ""


@dataclass(frozen=True, eq=False)
class Derivation:
    """Steps that lead from given symbols to coordinates; lengths are parameters of the system."""

    system: Compiled
    steps: tuple[FormulaStep, ...]
    given: tuple[Any, ...]
    """Symbols of what is given."""
    signs: tuple[Any, ...]
    """Symbols of the signs, -1 or +1, that choose among the solutions."""
    coordinates: tuple[str, ...]
    """Names of the coordinates that are found."""

    def evaluate(self, given: Array, signs: Array) -> Array:
        """The coordinates (..., k) for what is given (..., n) and signs (..., m); nan where a
        condition fails.

        Errors: `InputError` for lengths without a number.
        """
        known: dict[Any, Any] = {
            sympy.Symbol(n): v for n, v in self.system.structure.parameters.items()
        }
        unknown = sorted(map(str, self._lengths() - set(known)))
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
        """Of each step the symbols that its formula has, and the formula as a function of their
        numbers.
        """
        each = [(sorted(step.formula.free_symbols, key=str), step.formula) for step in self.steps]
        return [(symbols, sympy.lambdify(symbols, formula, "numpy")) for symbols, formula in each]

    def __getstate__(self) -> dict[str, Any]:
        """Without `_functions`: sympy makes these in the process, and they belong to no module."""
        return {name: value for name, value in vars(self).items() if name != "_functions"}

    def latex(self) -> str:
        """The formulas in LaTeX, one line each, with plus and minus in the place of signs; numbers
        have six digits.
        """
        names = {
            s: r"\pm" + (f"_{{{k}}}" if len(self.signs) > 1 else "")
            for k, s in enumerate(self.signs, 1)
        }
        lines = (
            f"{in_latex(step.symbol)} &= {in_latex(_readable(step.formula), names)}"
            for step in self.steps
        )
        return aligned(line.replace(r"- \pm", r"\mp") for line in lines)

    def code(self) -> str:
        """A Python function of the formulas, which needs numpy alone; names that Python does not
        allow are changed.
        """
        from sympy.printing.numpy import NumPyPrinter

        given = [*self.given, *self.signs, *sorted(self._lengths(), key=str)]
        words: dict[Any, Any] = {}
        for symbol in [*given, *(step.symbol for step in self.steps)]:
            words[symbol] = sympy.Symbol(
                _variable(str(symbol), {str(word) for word in words.values()})
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

    def _lengths(self) -> set[Any]:
        own = {step.symbol for step in self.steps} | {*self.given, *self.signs}
        return {s for step in self.steps for s in step.formula.free_symbols} - own

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __str__(self) -> str:
        return "\n".join(
            f"{step.symbol} = {_readable(step.formula)}"
            + f": {step.says}" * bool(step.says)
            + (f", if {step.condition}" if step.condition else "")
            for step in self.steps
        )


def _readable(formula: Any) -> Any:
    """A formula with six digits of each number, as it is printed."""
    return formula.xreplace({x: sympy.Float(f"{float(x):.6g}") for x in formula.atoms(sympy.Float)})


def _variable(name: str, taken: set[str]) -> str:
    """The name as Python takes it, with underscores in front of keywords, digits, and names that
    are taken.
    """
    word = re.sub(r"\W", "_", name)
    while not word.isidentifier() or keyword.iskeyword(word) or word in {*taken, "numpy"}:
        word = f"_{word}"
    return word
