"""Tapes: recorded expressions as small programs.

They have exact values, gradients, Taylor series, text and pickle.

A tape is made of text (`kempe.constraints.text`) or of a Python function
(`kempe.constraints.equations`). Kernels run it from its arrays
(`kempe.kernels.constraints.tape_layout`); `Tape.evaluate_outputs` is plain numpy and shares no formula with
them.
"""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kempe.arrays import is_sequence
from kempe.errors import InputError, UnknownNameError
from kempe.kernels.constraints import tape_layout as L
from kempe.values import CONSTANTS, FUNCTIONS

Node = tuple[int, int, int]
"""Operation, left, right, as `tape_layout` says."""

TIME = "t"
"""The name of the time among the inputs."""
POSE = ("x", "y", "z", "xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
"""Inputs between frames: the place of frame B in A, and of its rotation the component by row, the
axis by column."""
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
"""Inputs of rows of velocities: the velocity of the origin of B against A and its angular velocity,
in axes of A."""
RATE = "'"
"""What follows the name of a coordinate in the name of its velocity."""

TEXT_LIMIT = 20_000
"""Characters of the text of one output: shared parts are written out wherever they are used."""

WHOLE_POWERS = 64
"""Whole exponents up to this size become products, which are exact in every order of a series and
at zero."""


def look_up_entries(s: Any, table: NDArray[Any]) -> NDArray[Any]:
    """Return the entries of a table at parameters."""
    return table[np.clip(np.floor(s), 0, len(table) - 1).astype(np.int64)]


def find_nearest_parameters(way: Any, z: Any) -> NDArray[Any]:
    """Find the parameters of the points of a curve nearest to places.

    All critical points of all pieces that may have the nearest one are compared.

    `way` has the table of the curve, and x and y.
    """
    table, *xy = way
    endless = table[0] != 0.0
    rows = np.reshape(table[1:], (-1, L.PIECE))
    p = np.stack(np.broadcast_arrays(*xy, z), axis=-1)
    out = np.empty(p.shape[:-1])
    for index in np.ndindex(out.shape):
        out[index] = _find_nearest_parameter(rows, endless, p[index])
    return out


def _find_nearest_parameter(rows: NDArray[Any], endless: bool, p: NDArray[Any]) -> float:
    """Find the parameter of the point of a curve nearest to one place.

    Candidates are roots of the derivative of the squared distance, polynomials of degree 5.
    """
    if not np.isfinite(p).all():
        return 0.0
    c = rows[:, :12].reshape(-1, 3, 4).copy()
    n = len(rows)
    c[..., 0] -= p
    away = np.linalg.norm(c[..., 0], axis=-1)
    may = away - rows[:, 12] <= away.min()
    if endless:
        may[[0, -1]] = True
    best = np.inf
    found = 0.0
    for i in np.flatnonzero(may):
        slope = np.sum([np.convolve(x, x[1:] * [1.0, 2.0, 3.0]) for x in c[i]], axis=0)
        low = -np.inf if endless and i == 0 else 0.0
        high = np.inf if endless and i == n - 1 else 1.0
        us = np.polynomial.polynomial.polyroots(np.trim_zeros(slope, "b"))
        us = np.clip(us[np.abs(us.imag) < 1e-6].real, low, high).tolist()
        for u in [*us, *(x for x in (low, high) if np.isfinite(x))]:
            far = float(np.sum((c[i] @ [1.0, u, u * u, u**3]) ** 2))
            if far < best:
                best = far
                found = float(i + u)
    return found


def append_coordinate(way: Any, x: Any) -> tuple[Any, ...]:
    """Append a coordinate of a place to the table of a curve."""
    return (*way, x) if is_sequence(way) else (way, x)


BINARY: dict[int, Callable[..., Any]] = {
    L.ADD: np.add,
    L.SUB: np.subtract,
    L.MUL: np.multiply,
    L.DIV: np.divide,
    L.POW: np.power,
    L.ATAN2: np.arctan2,
    L.HYPOT: np.hypot,
    L.LOOKUP: look_up_entries,
    L.NEAREST: find_nearest_parameters,
    L.AT: append_coordinate,
}
UNARY: dict[int, Callable[..., Any]] = {
    L.NEG: np.negative,
    L.EXP: np.exp,
    L.LOG: np.log,
    L.SQRT: np.sqrt,
    L.SIN: np.sin,
    L.COS: np.cos,
    L.TAN: np.tan,
    L.ASIN: np.arcsin,
    L.ACOS: np.arccos,
    L.ATAN: np.arctan,
    L.SINH: np.sinh,
    L.COSH: np.cosh,
    L.TANH: np.tanh,
    L.ASINH: np.arcsinh,
    L.ACOSH: np.arccosh,
    L.ATANH: np.arctanh,
}
"""Operations as functions of numpy."""

NAMES = {op: name for name, f in FUNCTIONS.items() for op, g in (BINARY | UNARY).items() if f is g}
"""Names in text of operations that are functions."""

SYMBOLS = {L.ADD: (" + ", 1), L.SUB: (" - ", 1), L.MUL: ("*", 2), L.DIV: ("/", 2), L.POW: ("**", 4)}
"""Signs of operations, and how tightly they bind; a minus before a term binds with 3, a name or
call with 5."""
SIGN = 3
ATOM = 5


@dataclass(frozen=True)
class Tape:
    """A program of functions of named inputs: hashable, comparable by content, picklable.

    inputs: names, in the order of places 0 ... n_inputs - 1. nodes: what is computed, in order
    (`tape_layout`). numbers: constants that nodes refer to. outputs: places of the results.
    """

    inputs: tuple[str, ...]
    nodes: tuple[Node, ...]
    numbers: tuple[float, ...]
    outputs: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of places: inputs and nodes."""
        return len(self.inputs) + len(self.nodes)

    def evaluate_outputs(self, values: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Evaluate the outputs (..., n_outputs) at inputs given by name, which broadcast.

        They are NaN or infinite where they are not defined.
        """
        for name in self.inputs:
            if name not in values:
                raise UnknownNameError("input", name, values)
        found: list[Any] = [np.asarray(values[name], dtype=np.float64) for name in self.inputs]
        found += [None] * len(self.nodes)
        with np.errstate(all="ignore"):
            for i in self._list_needed_places():
                op, left, right = self.nodes[i - len(self.inputs)]
                if op == L.NUMBER:
                    found[i] = np.float64(self.numbers[left])
                elif op == L.TABLE:
                    found[i] = np.array(self.numbers[left : left + right])
                elif op in BINARY:
                    found[i] = BINARY[op](found[left], found[right])
                else:
                    found[i] = UNARY[op](found[left])
        shape = np.broadcast_shapes(*[found[i].shape for i in range(len(self.inputs))])
        out = np.empty((*shape, len(self.outputs)))
        for k, place in enumerate(self.outputs):
            out[..., k] = found[place]
        return out

    def _list_operands(self, place: int) -> tuple[int, ...]:
        """List the places that the value at a place is computed from."""
        if place < len(self.inputs):
            return ()
        op, left, right = self.nodes[place - len(self.inputs)]
        return (left, right) if op in BINARY else (left,) if op in UNARY else ()

    def _list_needed_places(self) -> list[int]:
        """List the places of nodes that the outputs need, in order; derivatives are left out."""
        needed = set(self.outputs)
        for place in range(self.size - 1, len(self.inputs) - 1, -1):
            if place in needed:
                needed.update(self._list_operands(place))
        return sorted(place for place in needed if place >= len(self.inputs))

    def fix_inputs(self, values: Mapping[str, float]) -> Tape:
        """Return the tape with given inputs replaced by constants, which come first in `numbers`.

        Its nodes are the same for all values. Names that are no inputs are left alone.
        """
        n = len(self.inputs)
        bound = [i for i, name in enumerate(self.inputs) if name in values]
        kept = [i for i in range(n) if i not in bound]
        place = {old: new for new, old in enumerate([*kept, *bound])}

        def move_node(node: Node) -> Node:
            """Return a node with its places counted as in the new tape."""
            op, left, right = node
            if op in (L.NUMBER, L.TABLE):
                return op, left + len(bound), right
            return op, place.get(left, left), place.get(right, right)

        numbers = tuple(float(values[self.inputs[i]]) for i in bound)
        return Tape(
            tuple(self.inputs[i] for i in kept),
            tuple((L.NUMBER, k, -1) for k in range(len(bound)))
            + tuple(move_node(node) for node in self.nodes),
            numbers + self.numbers,
            tuple(place.get(i, i) for i in self.outputs),
        )

    def select_outputs(self, outputs: Iterable[int]) -> Tape:
        """Return the tape of the outputs with given indices; the inputs stay."""
        return replace(self, outputs=tuple(self.outputs[i] for i in outputs))

    def make_arrays(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the integers and the numbers that kernels read."""
        head = (len(self.inputs), self.size, len(self.outputs), *self.outputs)
        ints = np.array([*head, *(x for node in self.nodes for x in node)], dtype=np.int64)
        return ints, np.array(self.numbers, dtype=np.float64)

    def compute_degrees(self, names: Iterable[str]) -> tuple[int, ...]:
        """Compute the degree of each output in the given inputs jointly: 0, 1, or 2 for all above.

        The program is read, so that a degree may be less than that.
        """
        requested = set(names)
        degree = [int(name in requested) for name in self.inputs] + [0] * len(self.nodes)
        for i in self._list_needed_places():
            op, left, right = self.nodes[i - len(self.inputs)]
            parts = [degree[k] for k in self._list_operands(i)]
            if op in (L.ADD, L.SUB, L.NEG):
                degree[i] = max(parts)
            elif op == L.MUL:
                degree[i] = min(sum(parts), 2)
            elif op == L.DIV and not degree[right]:
                degree[i] = degree[left]
            else:
                degree[i] = 2 if any(parts) else 0
        return tuple(degree[i] for i in self.outputs)

    def is_linear_in(self, names: Iterable[str]) -> bool:
        """Return whether the program computes all outputs with degree 0 or 1 in the given inputs.

        A constant part is allowed.
        """
        return max(self.compute_degrees(names), default=0) <= 1

    def format_outputs(self) -> tuple[str, ...]:
        """Return the outputs as text expressions, from which `parse_tape` makes an equal tape.

        Names that are no plain words stand in backquotes. Errors: `InputError` where one is beyond
        `TEXT_LIMIT`.
        """
        made: dict[int, tuple[str, int]] = {
            i: (quote_name(name), ATOM) for i, name in enumerate(self.inputs)
        }
        powers = {i: (i, 1) for i in range(len(self.inputs))}
        for i in self._list_needed_places():
            made[i] = self._format_node(i, made, powers)
            if len(made[i][0]) > TEXT_LIMIT:
                raise InputError(f"the expression has more than {TEXT_LIMIT} characters as text")
        return tuple(made[i][0] for i in self.outputs)

    def _format_node(
        self, i: int, made: dict[int, tuple[str, int]], powers: dict[int, tuple[int, int]]
    ) -> tuple[str, int]:
        """Return the text of a node, and how tightly it binds.

        `powers` keeps the base and the exponent of whole powers.
        """
        op, left, right = self.nodes[i - len(self.inputs)]
        powers[i] = (i, 1)
        if op == L.NUMBER:
            x = self.numbers[left]
            text = str(int(x)) if x.is_integer() and abs(x) < 1e15 else repr(x)
            return text, ATOM if text[0] != "-" else SIGN
        base = powers[left][0]
        n = powers[left][1] + powers.get(right, (-1, 0))[1]
        if op == L.MUL and powers[right][0] == base and n <= WHOLE_POWERS:
            powers[i] = (base, n)
            return f"{_bracket_part(made[base], ATOM)}**{n}", SYMBOLS[L.POW][1]
        if op == L.NEG:
            return f"-{_bracket_part(made[left], SIGN + 1)}", SIGN
        if op in SYMBOLS:
            sign, tight = SYMBOLS[op]
            first = _bracket_part(made[left], tight + (op == L.POW))
            return (
                f"{first}{sign}{_bracket_part(made[right], ATOM if made[right][1] == SIGN else tight + 1)}",
                tight,
            )
        arguments = ", ".join(made[k][0] for k in self._list_operands(i))
        return f"{NAMES[op]}({arguments})", ATOM


def _bracket_part(part: tuple[str, int], tight: int) -> str:
    """Return the text of a part, in brackets unless it binds at least as tightly as `tight`."""
    return part[0] if part[1] >= tight else f"({part[0]})"


def is_plain(name: str) -> bool:
    """Tell whether a name may stand in text as it is, without backquotes.

    It is of words, also with dots between them, and is not taken.
    """
    words = name.split(".")
    return (
        all(
            re.fullmatch(r"[^\W\d]\w*", word) and unicodedata.normalize("NFKC", word) == word
            for word in words
        )
        and not any(keyword.iskeyword(word) for word in words)
        and name not in FUNCTIONS
        and name not in CONSTANTS
    )


def quote_name(name: str) -> str:
    """Return a name as it is written in text. Errors: `InputError` for names with a backquote."""
    if "`" in name:
        raise InputError(f"the name {name!r} has a backquote, which text cannot hold")
    return name if is_plain(name) else f"`{name}`"
