"""Construction of tapes: equal nodes are shared, constants folded, derivatives added.

Every tape is finished in one order, that of a walk from its outputs, so that equal expressions give
equal tapes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from kempe.constraints.tape import BINARY, UNARY, WHOLE_POWERS, Node, Tape
from kempe.errors import InputError
from kempe.kernels.constraints import tape_layout as L


class Builder:
    """Nodes of a tape under construction, each at a place: an integer, inputs first."""

    def __init__(self, inputs: Iterable[str], constant: Iterable[str] = ()):
        self.inputs = tuple(inputs)
        self._nodes: list[tuple[int, int, int]] = []
        self._numbers: list[float] = []
        self._known: dict[tuple[int, Any, int], int] = {}
        self._powers: dict[int, tuple[int, int]] = {}
        self._varies = [name not in set(constant) for name in self.inputs]

    def add_number(self, x: float) -> int:
        """Add a constant and return its place. Errors: `InputError` unless it is finite."""
        x = float(x)
        if not math.isfinite(x):
            raise InputError(f"a constant part of it is {x}; it must be finite")
        key = (L.NUMBER, repr(x), -1)
        if key not in self._known:
            self._numbers.append(x)
            self._known[key] = self._append_node(L.NUMBER, len(self._numbers) - 1, -1, False)
        return self._known[key]

    def add_table(self, numbers: tuple[float, ...]) -> int:
        """Add a list of numbers and return its place."""
        key = (L.TABLE, numbers, -1)
        if key not in self._known:
            self._numbers += numbers
            self._known[key] = self._append_node(
                L.TABLE, len(self._numbers) - len(numbers), len(numbers), False
            )
        return self._known[key]

    def _append_node(self, op: int, left: int, right: int, varies: bool) -> int:
        """Append a node and return its place; `varies` says that it is not constant."""
        self._nodes.append((op, left, right))
        self._varies.append(varies)
        return len(self._varies) - 1

    def _get_constant(self, place: int) -> float | None:
        """Return the number at a place, or None where the node is no number."""
        if place < len(self.inputs):
            return None
        op, left, _ = self._nodes[place - len(self.inputs)]
        return self._numbers[left] if op == L.NUMBER else None

    def _fold_constants(self, function: Callable[..., Any], *places: int) -> int | None:
        """Add the value of a function of numbers and return its place; None unless all are numbers."""
        found = [self._get_constant(place) for place in places]
        if any(x is None for x in found):
            return None
        with np.errstate(all="ignore"):
            return self.add_number(float(function(*map(np.float64, found))))

    def add_binary(self, op: int, left: int, right: int) -> int:
        """Add an operation with two operands and return its place.

        These are left + right, left - right, left * right, left / right, left ** right, atan2 and
        hypot.
        """
        folded = self._fold_constants(BINARY[op], left, right)
        if folded is not None:
            return folded
        a = self._get_constant(left)
        b = self._get_constant(right)
        if op in (L.ADD, L.SUB) and b == 0.0:
            return left
        if op in (L.ADD, L.SUB) and a == 0.0:
            return right if op == L.ADD else self.add_unary(L.NEG, right)
        if op in (L.MUL, L.DIV) and b == 1.0:
            return left
        if op == L.MUL and a == 1.0:
            return right
        if op == L.MUL:
            (base, m) = self._powers.get(left, (left, 1))
            (other, n) = self._powers.get(right, (right, 1))
            if base == other and m + n <= WHOLE_POWERS:
                return self._add_whole_power(base, m + n)
        if op == L.POW:
            return self._add_power(left, right, b)
        if op == L.AT:
            return self._reserve_partials(op, left, right)
        if op == L.NEAREST:
            return self._add_nearest_parameter(left, right)
        if op in (L.ATAN2, L.HYPOT):
            return self._add_two_operand_function(op, left, right)
        return self._share_node(op, left, right)

    def _share_node(self, op: int, left: int, right: int) -> int:
        """Return the place of an operation with two operands, added where there is none yet."""
        keys = [(op, left, right)] + [(op, right, left)] * (op in (L.ADD, L.MUL))
        for key in keys:
            if key in self._known:
                return self._known[key]
        place = self._append_node(op, left, right, self._varies[left] or self._varies[right])
        self._known[keys[0]] = place
        return place

    def _add_whole_power(self, base: int, n: int) -> int:
        """Add base ** n for a whole n > 0 as products of squares, and return its place."""
        if n == 1:
            return base
        half = self._add_whole_power(base, n // 2)
        place = self._share_node(L.MUL, half, half)
        self._powers[place] = (base, n - n % 2)
        if n % 2:
            place = self._share_node(L.MUL, place, base)
            self._powers[place] = (base, n)
        return place

    def _add_power(self, left: int, right: int, exponent: float | None) -> int:
        """Add left ** right and return its place; `exponent` is the number of right, if it is one."""
        if exponent is not None:
            if exponent == 0.0:
                return self.add_number(1.0)
            if exponent == 0.5:
                return self.add_unary(L.SQRT, left)
            base, m = self._powers.get(left, (left, 1))
            if exponent.is_integer() and abs(exponent) * m <= WHOLE_POWERS:
                place = self._add_whole_power(base, int(abs(exponent)) * m)
                return (
                    place if exponent > 0 else self.add_binary(L.DIV, self.add_number(1.0), place)
                )
        if self._varies[right]:
            return self.add_unary(L.EXP, self.add_binary(L.MUL, right, self.add_unary(L.LOG, left)))
        return self._share_node(L.POW, left, right)

    def _add_two_operand_function(self, op: int, left: int, right: int) -> int:
        """Add atan2 or hypot with its partial derivatives, and return its place."""
        if (op, left, right) in self._known:
            return self._known[op, left, right]
        place = self._known[op, left, right] = self._reserve_partials(op, left, right)
        if op == L.HYPOT:
            by = self.add_binary(L.DIV, left, place), self.add_binary(L.DIV, right, place)
        else:
            square = self.add_binary(L.ADD, self._add_square(right), self._add_square(left))
            by = (
                self.add_binary(L.DIV, right, square),
                self.add_unary(L.NEG, self.add_binary(L.DIV, left, square)),
            )
        return self._set_partials(place, *by)

    def _reserve_partials(self, op: int, left: int, right: int) -> int:
        """Add a function of two operands, and return its place; derivatives follow."""
        place = self._append_node(op, left, right, self._varies[left] or self._varies[right])
        self._append_node(L.PARTIALS, -1, -1, False)
        return place

    def _set_partials(self, place: int, by_left: int, by_right: int) -> int:
        """Set the places of the partial derivatives of a function of two operands."""
        self._nodes[place + 1 - len(self.inputs)] = (L.PARTIALS, by_left, by_right)
        return place

    def _add_nearest_parameter(self, way: int, z: int) -> int:
        """Add the parameter of the nearest point of a curve and return its place."""
        _, before, y = self._nodes[way - len(self.inputs)]
        _, table, x = self._nodes[before - len(self.inputs)]
        key = (L.NEAREST, (table, x, y), z)
        if key not in self._known:
            place = self._known[key] = self._reserve_partials(L.NEAREST, way, z)
            zero = self.add_number(0.0)
            one = self.add_number(1.0)
            by = add_nearest_rates(self, self._read_table(table), place, (x, y, z))
            for k, left, rate in zip((before, way, place), (zero, one, one), by, strict=True):
                self._set_partials(k, left, rate)
        return self._known[key]

    def add_entry(self, s: int, numbers: Sequence[float]) -> int:
        """Add the entry of a list that belongs to a curve parameter, and return its place."""
        if len(set(numbers)) == 1:
            return self.add_number(numbers[0])
        return self.add_binary(L.LOOKUP, s, self.add_table(tuple(numbers)))

    def add_nearest_parameter(self, table: tuple[float, ...], p: Sequence[int]) -> int:
        """Add the parameter of the point of a curve that is nearest to p, and return its place.

        `table` is the curve in the form of `tape_layout`.
        """
        way = self.add_table(table)
        for op, x in zip((L.AT, L.AT, L.NEAREST), p, strict=True):
            way = self.add_binary(op, way, x)
        return way

    def find_nearest_rates(self, place: int) -> list[int]:
        """Return the places of the derivatives of a nearest point's parameter by x, y, z."""
        found = list[int]()
        n = len(self.inputs)
        for _ in range(3):
            found.insert(0, self._nodes[place + 1 - n][2])
            place = self._nodes[place - n][1]
        return found

    def _read_table(self, table: int) -> tuple[float, ...]:
        """Return the list of numbers at a place."""
        _, first, count = self._nodes[table - len(self.inputs)]
        return tuple(self._numbers[first : first + count])

    def _add_square(self, place: int) -> int:
        """Add the square of a node and return its place."""
        return self.add_binary(L.MUL, place, place)

    def add_unary(self, op: int, x: int) -> int:
        """Add a function of one operand, or its negative, and return its place."""
        folded = self._fold_constants(UNARY[op], x)
        if folded is not None:
            return folded
        if op == L.NEG and x >= len(self.inputs) and self._nodes[x - len(self.inputs)][0] == L.NEG:
            return self._nodes[x - len(self.inputs)][1]
        if (op, x, -1) in self._known:
            return self._known[op, x, -1]
        place = self._append_node(op, x, -1, self._varies[x])
        self._known[op, x, -1] = place
        if op != L.NEG:
            self._nodes[place - len(self.inputs)] = (op, x, self._add_derivative(op, x, place))
        return place

    def _add_derivative(self, op: int, x: int, y: int) -> int:
        """Add the derivative of y = f(x) and return its place."""
        one = self.add_number(1.0)
        unary = self.add_unary
        binary = self.add_binary
        square = self._add_square
        apart = lambda: binary(L.MUL, binary(L.SUB, one, x), binary(L.ADD, one, x))  # noqa: E731
        root: Callable[[int], int] = lambda z: binary(L.DIV, one, unary(L.SQRT, z))  # noqa: E731
        made: dict[int, Callable[[], int]] = {
            L.EXP: lambda: y,
            L.LOG: lambda: binary(L.DIV, one, x),
            L.SQRT: lambda: binary(L.DIV, self.add_number(0.5), y),
            L.SIN: lambda: unary(L.COS, x),
            L.COS: lambda: unary(L.NEG, unary(L.SIN, x)),
            L.TAN: lambda: binary(L.ADD, one, square(y)),
            L.ASIN: lambda: root(apart()),
            L.ACOS: lambda: unary(L.NEG, root(apart())),
            L.ATAN: lambda: binary(L.DIV, one, binary(L.ADD, one, square(x))),
            L.SINH: lambda: unary(L.COSH, x),
            L.COSH: lambda: unary(L.SINH, x),
            L.TANH: lambda: binary(L.SUB, one, square(y)),
            L.ASINH: lambda: root(binary(L.ADD, one, square(x))),
            L.ACOSH: lambda: root(binary(L.MUL, binary(L.SUB, x, one), binary(L.ADD, one, x))),
            L.ATANH: lambda: binary(L.DIV, one, apart()),
        }
        return made[op]()

    def finish_tape(self, outputs: Iterable[int]) -> Tape:
        """Return the tape of these outputs, with only the nodes that they need.

        Nodes are in the order of a walk from the outputs.
        """
        outputs = list(outputs)
        n = len(self.inputs)
        used = [i for i in self._order_places(outputs) if i < n]
        kept = sorted(used)
        fresh = Builder(
            [self.inputs[i] for i in kept], [self.inputs[i] for i in kept if not self._varies[i]]
        )
        place = {old: new for new, old in enumerate(kept)}
        for i in self._order_places(outputs):
            if i >= n:
                place[i] = fresh.copy_node(self._nodes[i - n], self._numbers, place)
        return Tape(
            fresh.inputs,
            tuple(fresh._nodes),
            tuple(fresh._numbers),
            tuple(place[i] for i in outputs),
        )

    def copy_node(self, node: Node, numbers: Sequence[float], place: Mapping[int, int]) -> int:
        """Copy a node of another tape with these numbers, and return its place.

        `place` has the places of its operands here.
        """
        op, left, right = node
        if op == L.NUMBER:
            return self.add_number(numbers[left])
        if op == L.TABLE:
            return self.add_table(tuple(numbers[left : left + right]))
        return (
            self.add_binary(op, place[left], place[right])
            if op in BINARY
            else self.add_unary(op, place[left])
        )

    def _order_places(self, outputs: list[int]) -> list[int]:
        """Order the places that the values at `outputs` need, operands first."""
        order: dict[int, None] = {}
        stack = [(place, False) for place in reversed(outputs)]
        while stack:
            place, ready = stack.pop()
            if place in order:
                continue
            if ready or place < len(self.inputs):
                order[place] = None
                continue
            op, left, right = self._nodes[place - len(self.inputs)]
            stack.append((place, True))
            if op in BINARY:
                stack.append((right, False))
            if op in BINARY or op in UNARY:
                stack.append((left, False))
        return list(order)

    def replay_tape(self, tape: Tape, leaves: Iterable[int]) -> list[int]:
        """Add the nodes of a tape with inputs at `leaves`, and return the places of its outputs."""
        place = dict(enumerate(leaves))
        for i in tape._list_needed_places():
            place[i] = self.copy_node(tape.nodes[i - len(tape.inputs)], tape.numbers, place)
        return [place[i] for i in tape.outputs]


def rename_inputs(tape: Tape, names: Mapping[str, str]) -> Tape:
    """Return the tape with other names of its inputs."""
    return replace(tape, inputs=tuple(names.get(n, n) for n in tape.inputs))


def substitute_sources(tape: Tape, sources: Mapping[str, tuple[str | None, float, float]]) -> Tape:
    """Return the tape with inputs replaced by multiplier * source + offset.

    An input is the offset where its source is None.

    Exponents are constants. Errors: `InputError` for numbers that are not finite.
    """
    if not sources.keys() & set(tape.inputs):
        return tape
    follows = [sources.get(n, (n, 1.0, 0.0)) for n in tape.inputs]
    builder = Builder(dict.fromkeys(source for source, _, _ in follows if source is not None))
    leaves: list[int] = []
    for source, multiplier, offset in follows:
        place = builder.add_number(offset)
        if source is not None:
            factor = builder.add_binary(
                L.MUL, builder.add_number(multiplier), builder.inputs.index(source)
            )
            place = builder.add_binary(L.ADD, factor, place)
        leaves.append(place)
    return builder.finish_tape(builder.replay_tape(tape, leaves))


def add_curve_terms(
    build: Builder, pieces: np.ndarray, s: int, p: Sequence[int]
) -> tuple[list[int], list[int], int]:
    """Add terms of a curve c at its parameter s and a point p, and return their places.

    The terms are p - c(s), c'(s), and c'.c' - (p - c).c''.
    """
    b = build.add_binary
    entry: Callable[[np.ndarray], int] = lambda column: build.add_entry(s, column.tolist())  # noqa: E731
    u = b(L.SUB, s, entry(np.arange(len(pieces), dtype=float)))
    two = build.add_number(2.0)
    three = build.add_number(3.0)
    off: list[int] = []
    first: list[int] = []
    second: list[int] = []
    for i in range(3):
        k = [entry(pieces[:, i, j]) for j in range(4)]
        slope = b(L.ADD, k[2], b(L.MUL, u, k[3]))
        off.append(b(L.SUB, p[i], b(L.ADD, k[0], b(L.MUL, u, b(L.ADD, k[1], b(L.MUL, u, slope))))))
        cubed = b(L.MUL, three, b(L.MUL, u, k[3]))
        first.append(b(L.ADD, k[1], b(L.MUL, u, b(L.ADD, b(L.MUL, two, k[2]), cubed))))
        second.append(b(L.MUL, two, b(L.ADD, k[2], cubed)))
    return (
        off,
        first,
        b(L.SUB, add_dot_product(build, first, first), add_dot_product(build, off, second)),
    )


def add_dot_product(build: Builder, a: Sequence[int], b: Sequence[int]) -> int:
    """Add the dot product of two vectors of three places, and return its place."""
    x, y, z = (build.add_binary(L.MUL, i, k) for i, k in zip(a, b, strict=True))
    return build.add_binary(L.ADD, build.add_binary(L.ADD, x, y), z)


def add_nearest_rates(
    build: Builder, table: tuple[float, ...], s: int, p: Sequence[int]
) -> list[int]:
    """Add the derivatives by p of the parameter of the point of a curve nearest to p.

    They follow from (p - c) . c' = 0. Returned are their three places.
    """
    pieces = np.reshape(table[1:], (-1, L.PIECE))[:, :12].reshape(-1, 3, 4)
    _, first, bend = add_curve_terms(build, pieces, s, p)
    return [build.add_binary(L.DIV, x, bend) for x in first]


def scale_inputs(tape: Tape, names: Iterable[str], factor: Fraction) -> Tape:
    """Return the tape over inputs in another unit, of which `factor` are one of the old unit."""
    return substitute_sources(tape, {n: (n, float(1 / factor), 0.0) for n in names})
