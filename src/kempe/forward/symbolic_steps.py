"""Symbolic forward kinematics step by step: the pose of each body in the preceding body."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.arguments import check_name, explain_errors, read_flag
from kempe.errors import InputError, UnsupportedError, format_value
from kempe.forward.symbolic import (
    SymbolLeaves,
    align_formulas,
    derive_fk,
    format_latex,
    format_upright_name,
    list_oriented_steps,
    multiply_steps,
    sympy,
    unwrap_alignments,
)
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model

LONG = 3000
"""Operations from which on a Jacobian is not multiplied out: each general joint makes it five times
as long."""
FORMS = ("matrices", "separate", "products")
"""How `SymbolicSteps.latex` writes the model."""


@dataclass(frozen=True, eq=False)
class SymbolicSteps:
    """Chain from the ground to a frame: the symbolic pose of each frame in the preceding frame.

    `T[i]` is the pose of `names[i + 1]` in `names[i]`, a sympy Matrix (4, 4).
    """

    system: Model
    names: tuple[str, ...]
    T: tuple[Any, ...]
    merged: Any
    """Their product as `symbolic.fk` gives it: the angles of parallel joints are summed."""

    @property
    def R(self) -> tuple[Any, ...]:
        """Orientation (3, 3) of each step."""
        return tuple(T[:3, :3] for T in self.T)

    @property
    def p(self) -> tuple[Any, ...]:
        """Position (3, 1) of each step."""
        return tuple(T[:3, 3] for T in self.T)

    @property
    def products(self) -> tuple[Any, ...]:
        """Pose in the ground frame after each step, multiplied out and not simplified."""
        out = [sympy.eye(4)]
        for T in self.T:
            out.append(out[-1] * T)
        return tuple(out[1:])

    def numbers(self, q: Any) -> Array:
        """Evaluate the matrices at configurations (..., nq) as numbers (..., n, 4, 4)."""
        from kempe.forward.fk import fk  # only here: formulas need no kernels

        X = fk(self.system, q, list(self.names))
        return spatial.inverse(X[..., :-1, :, :]) @ X[..., 1:, :, :]

    def latex(self, form: str = "matrices", *, numbered: bool = False) -> str:
        r"""Return the forward kinematics in LaTeX, with the merged result.

        The two frames of each pose stand at the left of its symbol.

        Parameters
        ----------
        form
            "matrices": the homogeneous matrices and their product; "separate": R and p of each step
            and how they combine; "products": the pose in the ground frame after each step.
        numbered
            Whether frames are written as numbers 0, 1, 2, ... from the ground to the tip, in place
            of their names.

        Returns
        -------
        str
            An `aligned` environment, without dollar signs.

        Raises
        ------
        UnknownNameError
            For other forms.

        Examples
        --------
        >>> import kempe
        >>> steps = kempe.load("two_link").symbolic.steps("e")
        >>> print(steps.latex(numbered=True).splitlines()[-2].split("=")[1].strip())
        {}^{0}_{1}T \, {}^{1}_{2}T \, {}^{2}_{3}T
        """
        names = tuple(map(str, range(len(self.names)))) if numbered else self.names
        ground = names[0]
        tip = names[-1]
        ways = list(zip(names[:-1], names[1:], strict=True))
        form = check_name("form", form, FORMS)
        if form == "separate":
            lines: list[str] = []
            for (a, b), T in zip(ways, self.T, strict=True):
                p = format_latex(T[:3, 3])
                R = format_latex(T[:3, :3])
                lines.append(
                    f"{_format_symbol(a, b, 'p')} &= {p}, \\quad {_format_symbol(a, b, 'R')} = {R}"
                )
            place = _format_symbol(*ways[-1], "p")
            for a, b in reversed(ways[:-1]):
                place = rf"\left({place}\right)" if "+" in place else place
                place = f"{_format_symbol(a, b, 'p')} + {_format_symbol(a, b, 'R')} {place}"
            lines.append(
                f"{_format_symbol(ground, tip, 'p')} &= {place} = {format_latex(self.merged[:3, 3])}"
            )
            lines.append(
                f"{_format_symbol(ground, tip, 'R')} &= {_format_product(ways, 'R')} = "
                f"{format_latex(self.merged[:3, :3])}"
            )
            return align_formulas(lines)
        shown = zip([(ground, b) for _, b in ways], self.products, strict=True)
        if form == "matrices":
            shown = zip(ways, self.T, strict=True)
        lines = [f"{_format_symbol(a, b)} &= {format_latex(T)}" for (a, b), T in shown]
        return align_formulas(
            [
                *lines,
                f"{_format_symbol(ground, tip)} &= {_format_product(ways)} = {format_latex(self.merged)}",
            ]
        )

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.latex()}$"

    def __str__(self) -> str:
        lines: list[str] = []
        for a, b, T in zip(self.names[:-1], self.names[1:], self.T, strict=True):
            lines.append(f"{b} in {a}: p = {tuple(T[:3, 3])}, R = {T[:3, :3].tolist()}")
        return "\n".join(lines)


@explain_errors
def derive_steps(
    system: Model,
    frame: FrameLike,
    *,
    symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> SymbolicSteps:
    """Derive the matrices whose product is the pose of a body or frame, one for each joint.

    A frame that is not a body adds a last matrix, of its place on the body. `symbols`, `snap` and
    errors are those of `kempe.forward.symbolic.derive_fk`; besides,
    `UnsupportedError` for a frame of a particle, which has no orientation.

    >>> from kempe import Mechanism
    >>> arm = Mechanism("arm", dim=2)
    >>> l1 = arm.parameter("l1", 0.5)
    >>> _ = arm.revolute("q1", arm.ground, arm.body("upper"))
    >>> _ = arm.revolute("q2", "upper", arm.body("lower"), at=(l1, 0))
    >>> derive_steps(arm.build(), "lower").p[1].T
    Matrix([[l1, 0, 0]])
    """
    merged = derive_fk(system, frame, symbols=symbols, snap=snap)
    leaves = SymbolLeaves(system, symbols or {}, snap)
    parts = list_oriented_steps(system, frame, leaves)
    names = (system.structure.topology.bodies[0], *(name for name, _ in parts))
    return SymbolicSteps(
        system, names, tuple(multiply_steps(steps, leaves) for _, steps in parts), merged
    )


def _format_symbol(upper: str, lower: str, what: str = "T") -> str:
    """Format T, R or p in LaTeX with the names of its two frames."""
    a, b = (format_upright_name(name) for name in (upper, lower))
    return f"{{}}^{{{a}}}p_{{{b}}}" if what == "p" else f"{{}}^{{{a}}}_{{{b}}}{what}"


def _format_product(ways: list[tuple[str, str]], what: str = "T") -> str:
    """Format the product of the matrices of the steps in LaTeX."""
    return r" \, ".join(_format_symbol(a, b, what) for a, b in ways)


@explain_errors
def derive_jacobian(
    system: Model,
    frame: FrameLike,
    *,
    symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> Any:
    """Derive the Jacobian (6, nv) of a body or frame as a sympy Matrix, rows [linear; angular].

    Axes are those of the ground.

    A joint that turns about a has the column [a x (p - c); a], with a point c of its axis; one that
    slides along a has [a; 0] (Siciliano, Sciavicco, Villani, Oriolo 2009, section 3.1). Multiplied
    with velocities it gives what `system.jacobian` gives in numbers. It is multiplied out where
    that is short. `symbols`, `snap` and errors are those of `derive_steps`; besides,
    `UnsupportedError` where a ball with a quaternion moves the frame.
    """
    leaves = SymbolLeaves(system, {}, snap)
    given = SymbolLeaves(system, symbols or {}, snap).given
    parts = list_oriented_steps(system, frame, leaves)
    steps = unwrap_alignments(step for _, motions in parts for step in motions)
    names = system.structure.velocity_names
    end: Any = multiply_steps(steps, leaves)[:3, 3]
    J = sympy.zeros(6, len(names))
    for k, step in enumerate(steps):
        if step.kind == "rotation" and step.amount.has(*map(sympy.Symbol, system.coordinate_names)):
            raise UnsupportedError(
                f"{step.subject} turns by a quaternion; see joint type 'spherical' with angles=True"
            )
        moves = step.kind in ("turn", "slide")
        rates = [sympy.diff(step.amount, sympy.Symbol(name)) for name in names] if moves else []
        if any(rates):
            here: Any = multiply_steps(steps[:k], leaves)
            a = here[:3, :3] * step.axis
            column = [*a.cross(end - here[:3, 3]), *a] if step.kind == "turn" else [*a, 0, 0, 0]
            J += sympy.Matrix(column) * sympy.Matrix([rates])
    if int(sympy.count_ops(J)) < LONG:
        J = J.applyfunc(sympy.expand)
    return J.xreplace({sympy.Symbol(n): x for n, x in given.items()})


class ShortForm(NamedTuple):
    """A formula with short names, such as c1 for cos(q1) and s12 for sin(q1 + q2), and a legend."""

    formula: Any
    legend: dict[Any, Any]

    def __str__(self) -> str:
        matrix = isinstance(self.formula, sympy.MatrixBase)
        lines = [sympy.pretty(self.formula, use_unicode=False) if matrix else str(self.formula)]
        return "\n".join(lines + [f"{short} = {long}" for short, long in self.legend.items()])

    def _repr_latex_(self) -> str:
        lines = [f"& {format_latex(self.formula)}"]
        lines += [
            f"{format_latex(short)} &= {format_latex(long)}" for short, long in self.legend.items()
        ]
        return f"$\\displaystyle {align_formulas(lines)}$"


@explain_errors
def shorten_formula(system: Model, formula: Any) -> ShortForm:
    """Shorten a formula: replace sines and cosines by short names, as in l1 c1 + l2 c12.

    A coordinate is named by the digit at the end of its name, where that tells it from the others,
    else after an underscore by its name. Functions of anything else, and those whose short name the
    formula has already or another angle has taken, stay as they are. Errors: `InputError` for what
    is no formula.

    >>> import kempe
    >>> arm = kempe.load("two_link")
    >>> shorten_formula(arm, arm.symbolic.fk("e")[0, 3]).formula
    c1*l1 + c12*l2
    """
    # one of numpy, which older versions of sympy do not read
    number: Any = getattr(formula, "item", None)
    given: Any = number() if callable(number) and np.ndim(formula) == 0 else formula
    try:
        read = sympy.sympify(given, strict=True)  # text would be evaluated
    except (sympy.SympifyError, TypeError):  # the latter from containers of what has no hash
        read = None
    if not isinstance(read, (sympy.Expr, sympy.Rel, sympy.MatrixBase)):
        raise InputError(
            f"formula is {format_value(formula)}; it must be an expression or a matrix of sympy"
        )
    formula = read
    legend: dict[Any, Any] = {}
    words = _choose_short_names(system)
    angles = dict[str, Any]()
    for found in sorted(formula.atoms(sympy.sin, sympy.cos), key=str):
        angle = found.args[0]
        label = _format_label(words, angle)
        if "-" in label:  # c1-2 would be a difference
            label = f"_{{{label.replace('-_', '-').lstrip('_').replace('_', ',')}}}"
        symbol = sympy.Symbol(f"{'c' if found.func == sympy.cos else 's'}{label}")
        if (
            label
            and angles.setdefault(label, angle) == angle
            and symbol not in formula.free_symbols
        ):
            legend[symbol] = found
    return ShortForm(formula.xreplace({found: symbol for symbol, found in legend.items()}), legend)


@explain_errors
def derive_short_fk(system: Model, frame: FrameLike, short: bool, **options: Any) -> Any:
    """Derive the formula of `derive_fk`, and shorten it if `short`."""
    formula = derive_fk(system, frame, **options)
    return shorten_formula(system, formula) if read_flag(short, "short") else formula


def _choose_short_names(system: Model) -> dict[Any, str]:
    """Choose short names of the coordinates: their last digits where these differ."""
    names = system.coordinate_names
    ends = [re.search(r"\d+$", name) for name in names]
    digits = [end[0] for end in ends if end]
    short = len(set(digits)) == len(digits) and all(len(d) == 1 for d in digits)
    return {
        sympy.Symbol(n): end[0] if end and short else f"_{n}"
        for n, end in zip(names, ends, strict=True)
    }


def _format_label(words: Mapping[Any, str], angle: Any) -> str:
    """Format the short name of a sum of coordinates with signs; '' for other expressions."""
    terms = {
        symbol: sign
        for sign, symbol in (x.as_coeff_Mul() for x in sympy.Add.make_args(sympy.expand(angle)))
    }
    if not all(sign in (1, -1) and symbol in words for symbol, sign in terms.items()):
        return ""
    return "".join(
        [word for symbol, word in words.items() if terms.get(symbol) == 1]
        + [f"-{word}" for symbol, word in words.items() if terms.get(symbol) == -1]
    )
