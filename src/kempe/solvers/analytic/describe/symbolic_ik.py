"""The inverse model of a planar two-link arm as formulas, in the steps in which it is derived on paper."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained, numbers
from kempe.errors import InputError, UnsupportedError, shown
from kempe.kinematics.symbolic import aligned, symbolic_fk
from kempe.kinematics.symbolic_turns import sympy
from kempe.reals import is_whole
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System


class FormulaStep(NamedTuple):
    """One line of a derivation: `symbol` = `formula`, what was done, and the condition under which it holds."""

    symbol: Any
    formula: Any
    says: str
    condition: str = ""


@dataclass(frozen=True, eq=False)
class InverseFormulas:
    """Formulas of both solutions; the symbol `sign` is -1 for elbow up (sin q2 < 0) and +1 for elbow down."""

    system: System
    steps: tuple[FormulaStep, ...]
    target: tuple[Any, Any]
    """Symbols of the wanted position, p_x and p_y."""
    coordinates: tuple[str, str]

    def __call__(self, p: ArrayLike, sign: int) -> Array:
        """The two coordinates (..., 2) in radians for positions p (..., 2) in metres; nan where p is out of reach."""
        at = numbers(p, "p", 2)
        if not is_whole(sign) or sign not in (-1, 1):
            raise InputError(f"sign is {shown(sign)}; it must be -1 (elbow up) or 1 (elbow down)")
        known: dict[Any, Any] = {sympy.Symbol(n): v for n, v in self.system.structure.parameters.items()}
        unknown = sorted(map(str, self._lengths() - set(known)))
        if unknown:
            raise InputError(f"no numbers are known for {', '.join(unknown)}; they are no parameters of the system")
        known |= {self.target[0]: at[..., 0], self.target[1]: at[..., 1], sympy.Symbol("sign"): sign}
        with np.errstate(invalid="ignore"):
            for step in self.steps:
                known[step.symbol] = sympy.lambdify(list(known), step.formula, "numpy")(*known.values())
        return np.stack([known[sympy.Symbol(name)] for name in self.coordinates], axis=-1)

    def latex(self) -> str:
        """The formulas in LaTeX, one line each."""
        lines = [f"{sympy.latex(step.symbol)} &= {sympy.latex(step.formula)}" for step in self.steps]
        return aligned(lines)

    def code(self) -> str:
        """A Python function of the formulas, which needs numpy alone; names that Python does not allow are changed."""
        from sympy.printing.numpy import NumPyPrinter

        given = [*self.target, sympy.Symbol("sign"), *sorted(self._lengths(), key=str)]
        words: dict[Any, Any] = {}
        for symbol in [*given, *(step.symbol for step in self.steps)]:
            words[symbol] = sympy.Symbol(_variable(str(symbol), {str(word) for word in words.values()}))
        arguments = ", ".join(str(words[symbol]) for symbol in given)
        printer: Any = NumPyPrinter()
        printed = printer.doprint
        lines = [f"    {words[step.symbol]} = {printed(step.formula.xreplace(words))}" for step in self.steps]
        last = f"    return {', '.join(str(words[sympy.Symbol(name)]) for name in self.coordinates)}"
        return "\n".join(["import numpy", "", "", f"def inverse({arguments}):", *lines, last]) + "\n"

    def _lengths(self) -> set[Any]:
        own = {step.symbol for step in self.steps} | {*self.target, sympy.Symbol("sign")}
        return {s for step in self.steps for s in step.formula.free_symbols} - own

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __str__(self) -> str:
        return "\n".join(
            f"{step.symbol} = {step.formula}: {step.says}" + (f", if {step.condition}" if step.condition else "")
            for step in self.steps
        )


@explained
def symbolic_ik(system: System, frame: FrameLike, *, symbols: Mapping[str, Any] | None = None) -> InverseFormulas:
    """Formulas for the position of a frame that two turns about z move, with links along x where both are zero.

    The position is squared and summed, which leaves q2; its sine has two signs, the two elbows; q1 is the difference
    of two angles (Siciliano, Sciavicco, Villani, Oriolo 2009, section 2.12.1). Limits are not regarded. `ik_all` gives
    the solutions of other chains in numbers. `symbols` replaces parameters as in `symbolic_fk`.

    Errors: those of `kempe.kinematics.symbolic.symbolic_fk`; `UnsupportedError` for other chains and for systems
    with constraints.

    >>> import kempe
    >>> print(symbolic_ik(kempe.load("two_link"), "e").steps[1].formula)
    (-l1**2 - l2**2 + r2)/(2*l1*l2)
    """
    name = system.structure.frame_name(frame)
    position: Any = symbolic_fk(system, frame, symbols=symbols)[:3, 3]
    moving = [n for n in system.coordinate_names if position.has(sympy.Symbol(n))]
    if len(moving) != 2 or system.loops.constraints():
        raise UnsupportedError(f"formulas for {name!r} need two joints in an open chain; ik_all gives numbers")
    one, two = map(sympy.Symbol, moving)
    base, l1, l2 = _links(position, one, two)
    own = sympy.symbols("p_x p_y sign r2 c2 s2 alpha beta")
    if base is None or position.free_symbols & set(own):
        raise UnsupportedError(
            f"formulas for {name!r} need two turns about z, with links along x where both are zero, and no parameter"
            f" called {', '.join(map(str, own))}; ik_all gives numbers"
        )
    return InverseFormulas(system, _steps(own, base, (l1, l2), (one, two)), (own[0], own[1]), (moving[0], moving[1]))


def _variable(name: str, taken: set[str]) -> str:
    """The name as Python takes it, with underscores in front of keywords, digits, and names that are taken."""
    word = re.sub(r"\W", "_", name)
    while not word.isidentifier() or keyword.iskeyword(word) or word in {*taken, "numpy"}:
        word = f"_{word}"
    return word


def _links(position: Any, one: Any, two: Any) -> tuple[Any, Any, Any]:
    """Place of the first axis and the two lengths, by half turns of the joints; None for other chains."""
    base = (position + position.subs(one, one + sympy.pi)) / 2
    outer = (position - position.subs(two, two + sympy.pi)) / 2
    zero = {one: 0, two: 0}
    base, l2 = base.subs(zero), outer[0].subs(zero)
    l1 = (position[0].subs(zero) - base[0] - l2).expand()
    way = (l1 * sympy.cos(one) + l2 * sympy.cos(one + two), l1 * sympy.sin(one) + l2 * sympy.sin(one + two))
    off = sympy.Matrix([position[0] - base[0] - way[0], position[1] - base[1] - way[1], position[2] - base[2]])
    if 0 in (l1, l2) or not off.expand(trig=True).is_zero_matrix:
        return None, l1, l2
    return base, l1, l2


def _steps(own: Any, base: Any, lengths: tuple[Any, Any], angles: tuple[Any, Any]) -> tuple[FormulaStep, ...]:
    p_x, p_y, sign, r2, c2, s2, alpha, beta = own
    l1, l2 = lengths
    x, y = p_x - base[0], p_y - base[1]
    return (
        FormulaStep(r2, x**2 + y**2, "both parts of the position squared and summed"),
        FormulaStep(c2, (r2 - l1**2 - l2**2) / (2 * l1 * l2), "the law of cosines", f"{l1} != 0 and {l2} != 0"),
        FormulaStep(s2, sign * sympy.sqrt(1 - c2**2), "-1 is elbow up, +1 elbow down", "-1 <= c2 <= 1"),
        FormulaStep(alpha, sympy.atan2(y, x), "angle to the target", f"{r2} != 0"),
        FormulaStep(beta, sympy.atan2(l2 * s2, l1 + l2 * c2), "angle from the first link to the target"),
        FormulaStep(angles[0], alpha - beta, "the first coordinate"),
        FormulaStep(angles[1], sympy.atan2(s2, c2), "the second coordinate"),
    )
