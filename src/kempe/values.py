"""Numbers of a description: floats, or expressions in parameters such as ``"l1 + 2*cos(alpha)"``."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kempe.arguments import is_list
from kempe.arrays import is_real
from kempe.errors import InputError, UnknownNameError, format_value
from kempe.words import format_count

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "sqrt": np.sqrt,
    "hypot": np.hypot,
    "exp": np.exp,
    "log": np.log,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "radians": np.deg2rad,
    "degrees": np.rad2deg,
}
"""Functions of an expression; `log` is the natural logarithm."""
OF_TWO = frozenset({"atan2", "hypot"})
"""Functions of two numbers; all others are of one."""
CONSTANTS = {"pi": math.pi}
LENGTH_LIMIT = 1000
"""Characters of an expression."""
DEPTH_LIMIT = 300
"""Operations inside each other in an expression; a sum of n terms counts n."""

_BINARY: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}
_UNARY: dict[type, Callable[[Any], Any]] = {ast.USub: lambda a: -a, ast.UAdd: lambda a: a}


class Expression:
    """Arithmetic expression in named parameters.

    It has ``+ - * / **``, parentheses, `pi` and the `FUNCTIONS`.

    >>> (Expression("l1") / 2 + 1).evaluate({"l1": 3.0})
    2.5
    """

    __slots__ = ("_tree", "names", "text")

    def __init__(self, text: str, length: int = LENGTH_LIMIT):
        self.text = text.strip()
        self._tree = _parse_expression(self.text, length)
        self.names = tuple(
            sorted(
                {n.id for n in ast.walk(self._tree) if isinstance(n, ast.Name)}
                - {*FUNCTIONS, *CONSTANTS}
            )
        )

    def evaluate(self, parameters: Mapping[str, Any]) -> Any:
        """Evaluate the expression for parameter values, which are numbers or arrays that broadcast.

        Errors: `UnknownNameError`.
        """
        for name in self.names:
            if name not in parameters:
                raise UnknownNameError("parameter", name, parameters)
        with np.errstate(all="ignore"):
            return self.fold({**parameters, **CONSTANTS}, FUNCTIONS, float)

    def fold(
        self,
        names: Mapping[str, Any],
        functions: Mapping[str, Callable[..., Any]],
        number: Callable[..., Any],
    ) -> Any:
        """Evaluate the expression in any algebra.

        `names` and `functions` give the operands, `number` converts constants.
        """
        return _fold_node(self._tree.body, names, functions, number)

    def __repr__(self) -> str:
        return f"Expression({self.text!r})"

    def __str__(self) -> str:
        return self.text

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Expression) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __reduce__(self):
        return (Expression, (self.text, max(LENGTH_LIMIT, len(self.text))))

    def _combine_operands(self, form: str, other: Value) -> Expression:
        return Expression(form.format(a=_add_brackets(self), b=_add_brackets(other)))

    def __add__(self, other: Value) -> Expression:
        return self._combine_operands("{a} + {b}", other)

    def __radd__(self, other: Value) -> Expression:
        return self._combine_operands("{b} + {a}", other)

    def __sub__(self, other: Value) -> Expression:
        return self._combine_operands("{a} - {b}", other)

    def __rsub__(self, other: Value) -> Expression:
        return self._combine_operands("{b} - {a}", other)

    def __mul__(self, other: Value) -> Expression:
        return self._combine_operands("{a} * {b}", other)

    def __rmul__(self, other: Value) -> Expression:
        return self._combine_operands("{b} * {a}", other)

    def __truediv__(self, other: Value) -> Expression:
        return self._combine_operands("{a} / {b}", other)

    def __rtruediv__(self, other: Value) -> Expression:
        return self._combine_operands("{b} / {a}", other)

    def __pow__(self, other: Value) -> Expression:
        return self._combine_operands("{a} ** {b}", other)

    def __rpow__(self, other: Value) -> Expression:
        return self._combine_operands("{b} ** {a}", other)

    def __neg__(self) -> Expression:
        return Expression(f"-{_add_brackets(self)}")


Value = float | Expression
"""What a length, an angle or a factor of a description is."""


def read_value(x: object, what: str = "value") -> Value:
    """Convert `x` to a `Value`: a finite number to a float, text to an expression. Errors:
    `InputError`.
    """
    if isinstance(x, Expression):
        return x
    if isinstance(x, str):
        return Expression(x)
    if not is_real(x):
        raise InputError(
            f"{what} is {format_value(x)}; it must be a number or an expression in parameters"
        )
    number = float(x)
    if not math.isfinite(number):
        raise InputError(f"{what} is {format_value(x)}; it must be finite")
    return number


def read_values(xs: Any, count: int | tuple[int, ...], what: str) -> tuple[Value, ...]:
    """Convert numbers and texts to a tuple of `Value` of an allowed length. Errors: `InputError`."""
    counts = (count,) if isinstance(count, int) else count
    given = xs
    if type(xs) is tuple or type(xs) is list:
        kinds: set[type] = set(map(type, given))
        if (
            len(kinds) == 1
            and float in kinds
            and len(given) in counts
            and math.isfinite(sum(given))
        ):
            return tuple(given)
    if not is_list(given):
        raise InputError(
            f"{what} is {format_value(given)}; it must have {' or '.join(map(str, counts))} numbers"
        )
    items: tuple[Any, ...] = tuple(given)
    if len(items) not in counts:
        s = "s" if len(items) != 1 else ""
        raise InputError(
            f"{what} has {len(items)} number{s}; it must have {' or '.join(map(str, counts))}"
        )
    return tuple(read_value(x, what) for x in items)


def evaluate_value(x: Value, parameters: Mapping[str, Any]) -> Any:
    """Evaluate a `Value` to a number, or to an array if a parameter is one."""
    return x.evaluate(parameters) if isinstance(x, Expression) else x


def find_angle_names(x: Value, turns: bool) -> frozenset[str]:
    """Find the parameters that are angles in a value, which is an angle itself if it `turns`.

    These are the arguments of sine, cosine and tangent, and, in an angle, what is outside of
    functions.
    """

    def find_names(node: ast.AST, turns: bool) -> frozenset[str]:
        """Find the names of angles below a node of the syntax tree."""
        if isinstance(node, ast.Name):
            return frozenset([node.id] if turns else [])
        inner = node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node)
        if isinstance(node, ast.Call):
            turns = isinstance(node.func, ast.Name) and node.func.id in ("sin", "cos", "tan")
        return frozenset[str]().union(*(find_names(child, turns) for child in inner))

    if not isinstance(x, Expression):
        return frozenset()
    return find_names(x._tree.body, turns).intersection(x.names)


def negate_value(x: Value) -> Value:
    """Return the value with the opposite sign; a double minus is removed."""
    return -x


def _add_brackets(x: Value) -> str:
    """Format a value as an operand, in brackets if it needs them."""
    if isinstance(x, Expression):
        simple = isinstance(x._tree.body, (ast.Name, ast.Call, ast.Constant))
        return x.text if simple else f"({x.text})"
    return repr(float(x)) if x >= 0 else f"({float(x)!r})"


def _parse_expression(text: str, length: int) -> ast.Expression:
    """Parse the text of an expression. Errors: `InputError`."""
    if len(text) > length:
        raise InputError(f"expression of {len(text)} characters; at most {length} are allowed")
    try:
        tree = ast.parse(text, mode="eval")
        _check_node(tree.body, text, 0)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{text!r} is not an expression; write numbers as 1.5, and 2*l1 for products"
        ) from None
    return tree


def _check_node(node: ast.AST, text: str, depth: int) -> None:
    """Refuse a node of a syntax tree that is not allowed in expressions. Errors: `InputError`."""
    if depth > DEPTH_LIMIT:
        raise InputError(
            f"{text[:40]!r}... has more than {DEPTH_LIMIT} operations inside each other"
        )
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        _check_node(node.left, text, depth + 1)
        _check_node(node.right, text, depth + 1)
    elif isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        _check_node(node.operand, text, depth + 1)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if name not in FUNCTIONS:
            raise InputError(f"{text!r} calls {name!r}; allowed are {', '.join(FUNCTIONS)}")
        count = 2 if name in OF_TWO else 1
        if len(node.args) != count:
            raise InputError(
                f"{text!r} calls {name} with {format_count(len(node.args), 'number')}; it takes "
                f"{count}"
            )
        for argument in node.args:
            _check_node(argument, text, depth + 1)
    elif isinstance(node, ast.Name) and node.id in FUNCTIONS:
        raise InputError(
            f"{text!r} uses the function {node.id!r} without its brackets, such as {node.id}(x)"
        )
    elif not (
        isinstance(node, ast.Name)
        or (
            isinstance(node, ast.Constant)
            and type(node.value) in (int, float)
            and math.isfinite(node.value)  # type: ignore[arg-type]
        )
    ):
        raise InputError(
            f"{text!r} is not an expression of numbers, parameters, + - * / ** and functions"
        )


def _fold_node(
    node: Any,
    names: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    number: Callable[..., Any],
) -> Any:
    """Evaluate a node of a syntax tree in the algebra of `Expression.fold`."""
    if isinstance(node, ast.BinOp):
        left = _fold_node(node.left, names, functions, number)
        right = _fold_node(node.right, names, functions, number)
        try:
            result = _BINARY[type(node.op)](left, right)
        except (ZeroDivisionError, OverflowError):
            return number("nan")
        return number("nan") if isinstance(result, complex) else result
    if isinstance(node, ast.UnaryOp):
        return _UNARY[type(node.op)](_fold_node(node.operand, names, functions, number))
    if isinstance(node, ast.Call):
        arguments = [_fold_node(a, names, functions, number) for a in node.args]
        return functions[node.func.id](*arguments)  # type: ignore[attr-defined]
    if isinstance(node, ast.Name):
        return names[node.id]
    return number(node.value)
