"""Constraint equations written as text, such as ``"A - 2*B"`` or ``"sin(A) = `rear axle` / 2"``.

The language is that of `kempe.values.Expression` (a parser of its own rules, nothing is run), and
besides:

- ``left = right`` stands for ``left - (right)``;
- ``^`` is a power, like ``**``;
- names may have dots between words (``joint.x``); all other names that are no plain words, and
  those that are also the names of functions, stand in backquotes: `` `rear axle` ``, `` `sin` ``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeGuard

from kempe.constraints.builder import Builder
from kempe.constraints.tape import TEXT_LIMIT, Tape, is_plain, quote_name
from kempe.errors import InputError, UnknownNameError
from kempe.kernels.constraints import tape_layout as L
from kempe.values import CONSTANTS, FUNCTIONS, OF_TWO, Expression

LEAST = "1e-24"
"""Added to squares under a root, so that the root has derivatives at zero, too."""

_TOKENS = re.compile(
    r"(?P<space>\s+)|`(?P<quoted>[^`]*)`|(?P<number>(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][+-]?\d+)?)(?!\w)"
    r"|(?P<name>[^\W\d]\w*(?:\.[^\W\d]\w*)*)|(?P<sign>\*\*|[-+*/^(),=])"
)
_OPERATIONS = {
    "sin": L.SIN,
    "cos": L.COS,
    "tan": L.TAN,
    "asin": L.ASIN,
    "acos": L.ACOS,
    "atan": L.ATAN,
    "sqrt": L.SQRT,
    "exp": L.EXP,
    "log": L.LOG,
    "sinh": L.SINH,
    "cosh": L.COSH,
    "tanh": L.TANH,
    "asinh": L.ASINH,
    "acosh": L.ACOSH,
    "atanh": L.ATANH,
    "atan2": L.ATAN2,
    "hypot": L.HYPOT,
}


@dataclass(frozen=True)
class TapePlace:
    """A number under construction: a place of a tape that is being built."""

    builder: Builder
    place: int

    def apply_operation(self, op: int, other: TapePlace | None = None) -> TapePlace:
        """Apply an operation to this number, and to another one where it takes two."""
        if other is None:
            return TapePlace(self.builder, self.builder.add_unary(op, self.place))
        return TapePlace(self.builder, self.builder.add_binary(op, self.place, other.place))

    def __add__(self, other: TapePlace) -> TapePlace:
        return self.apply_operation(L.ADD, other)

    def __sub__(self, other: TapePlace) -> TapePlace:
        return self.apply_operation(L.SUB, other)

    def __mul__(self, other: TapePlace) -> TapePlace:
        return self.apply_operation(L.MUL, other)

    def __truediv__(self, other: TapePlace) -> TapePlace:
        return self.apply_operation(L.DIV, other)

    def __pow__(self, other: TapePlace) -> TapePlace:
        return self.apply_operation(L.POW, other)

    def __neg__(self) -> TapePlace:
        return self.apply_operation(L.NEG)


def parse_tape(
    texts: str | list[str] | tuple[str, ...],
    names: Collection[str],
    parameters: Collection[str] = (),
) -> Tape:
    """Parse expressions in the named inputs and parameters to a tape, an output for each text.

    Its inputs are the names that occur, in the order of `names` and then of `parameters`. Exponents
    may depend on parameters freely; along curves and in gradients they count as constant.

    Errors: `InputError` for what is no expression, constants that are not finite, and a name that
    is both; `UnknownNameError` for names that are neither, with near ones.
    """
    listed = tuple(texts) if isinstance(texts, (list, tuple)) else (texts,)
    for text in listed:
        if not isinstance(text, str):  # what is no text cannot be looked up either
            parse_expression(text)
    return _parse_tape_once(listed, tuple(names), tuple(parameters))


@lru_cache(maxsize=1024)
def _parse_tape_once(
    texts: tuple[str, ...], names: tuple[str, ...], parameters: tuple[str, ...]
) -> Tape:
    """Parse the tape in the first call, and return it again for equal arguments."""
    for name in names:
        if name in parameters:
            raise InputError(
                f"{name!r} is the name of a coordinate and of a parameter; rename one of them"
            )
    builder = Builder([*names, *parameters], parameters)
    place = {name: TapePlace(builder, i) for i, name in enumerate([*names, *parameters])}
    outputs: list[int] = []
    for text in texts:
        expression, meant = parse_expression(text)
        for word in expression.names:
            if meant.get(word, word) not in place:
                raise UnknownNameError(
                    "name", meant.get(word, word), place, f"expression {text!r}:"
                )
        leaves = {word: place[meant.get(word, word)] for word in expression.names}

        def add_number(x: float) -> TapePlace:
            """Add a constant to the tape."""
            return TapePlace(builder, builder.add_number(float(x)))

        leaves |= {word: add_number(x) for word, x in CONSTANTS.items()}
        try:
            outputs.append(expression.fold(leaves, _make_functions(add_number), add_number).place)
        except (InputError, OverflowError) as error:
            reason = error if isinstance(error, InputError) else "a number in it is too large"
            raise InputError(f"{text!r} cannot be used: {reason}") from None
    return builder.finish_tape(outputs)


def _make_functions(number: Callable[[float], TapePlace]) -> dict[str, Callable[..., Any]]:
    """Return the functions that expressions may use, by name."""
    made: dict[str, Callable[..., Any]] = {
        name: _make_function(op, name in OF_TWO) for name, op in _OPERATIONS.items()
    }
    factors = {name: float(FUNCTIONS[name](1.0)) for name in ("radians", "degrees")}
    return made | {name: _make_scaling(number, f) for name, f in factors.items()}


def _make_scaling(
    number: Callable[[float], TapePlace], factor: float
) -> Callable[[TapePlace], TapePlace]:
    """Make a function that multiplies by a factor."""
    return lambda x: x * number(factor)


def _make_function(op: int, of_two: bool) -> Callable[..., TapePlace]:
    """Make the function of an operation with one or two operands."""
    one: Callable[[TapePlace], TapePlace] = lambda x: x.apply_operation(op)  # noqa: E731
    two: Callable[[TapePlace, TapePlace], TapePlace] = lambda x, y: x.apply_operation(op, y)  # noqa: E731
    return two if of_two else one


def is_text_tuple(x: object) -> TypeGuard[tuple[str, ...]]:
    """Tell whether an object is a tuple, as of the texts of several expressions."""
    return isinstance(x, tuple)


def parse_expression(text: str) -> tuple[Expression, dict[str, str]]:
    """Parse an expression; ``left = right`` becomes a difference.

    Returned are the expression, and the names by the words that stand for them in it.

    Errors: `InputError`.
    """
    if not isinstance(text, str):
        raise InputError(f"{text!r} is no expression; it must be text")
    if len(text) > TEXT_LIMIT:
        raise InputError(f"expression of {len(text)} characters; at most {TEXT_LIMIT} are allowed")
    sides = [""]
    at = 0
    meant: dict[str, str] = {}
    while at < len(text):
        match = _TOKENS.match(text, at)
        if match is None:
            raise InputError(
                f"{_shorten_text(text)} has {text[at]!r} at place {at + 1}, which no expression holds"
            )
        at = match.end()
        kind = match.lastgroup
        token = match[match.lastgroup or 0]
        if token == "=":
            sides.append("")
            continue
        if kind == "quoted" or (
            kind == "name" and token not in FUNCTIONS and token not in CONSTANTS
        ):
            name = token
            if not name.strip():
                raise InputError(f"{_shorten_text(text)} has an empty name in backquotes")
            if kind == "quoted" or not is_plain(name) or not token.isascii() or "." in token:
                token = next(
                    (word for word, known in meant.items() if known == name), f"name_{len(meant)}_"
                )
                while token in text:
                    token += "_"
                meant[token] = name
        sides[-1] += "**" if token == "^" else " " if kind == "space" else token
    if len(sides) > 2:
        raise InputError(
            f"{_shorten_text(text)} has {len(sides) - 1} signs of equality; one is allowed"
        )
    try:
        parts = [Expression(side, len(text) + len(side) + 1) for side in sides]
        if len(parts) == 1 or parts[1].text in ("0", "0.0"):
            return parts[0], meant
        return Expression(f"({sides[0]}) - ({sides[1]})", sum(map(len, sides)) + 9), meant
    except InputError as error:
        reason = str(error)
        for side in sides:
            reason = reason.replace(repr(side.strip()), _shorten_text(text))
        for word, name in meant.items():
            reason = reason.replace(word, quote_name(name))
        raise InputError(reason) from None


def _shorten_text(text: str) -> str:
    """Return a text in quotes, its first 57 characters where it is long."""
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
