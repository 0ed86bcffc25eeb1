"""Rows A(q) v = 0 given as text, for brackets, and the same in symbols for the oracle."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from sympy.parsing.sympy_parser import parse_expr

from kempe.constraints.text import parse_tape
from kempe.equations.velocity import RowName, VelocityRows
from kempe.model.coordinates import Layout

EMPTY = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Pfaffian:
    """Rows of text over named coordinates, and what is known of their growth at a point of each
    sort.
    """

    coordinates: str
    text: tuple[tuple[str, ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The coordinates."""
        return tuple(self.coordinates.split())

    def rows(self) -> VelocityRows:
        """The rows, recorded; those of one matrix entry that is the text 0 have none."""
        n = len(self.names)
        entries = [(i, j) for i, row in enumerate(self.text) for j, x in enumerate(row) if x != "0"]
        tape = parse_tape([self.text[i][j] for i, j in entries], self.names, {})
        layout = Layout(n, n, np.arange(n), np.arange(n), EMPTY, EMPTY)
        names = tuple(RowName("law", str(i)) for i in range(len(self.text)))
        return VelocityRows(
            layout, self.names, tape, np.array(entries).reshape(-1, 2), names, np.ones(n + 1)
        )

    def symbolic(self) -> tuple[list[Any], Any]:
        """The coordinates and the matrix in symbols."""
        symbols = [sympy.Symbol(n) for n in self.names]
        known: Any = dict(zip(self.names, symbols, strict=True))
        return symbols, sympy.Matrix([[parse_expr(x, known) for x in row] for row in self.text])


def trailers(n: int) -> Pfaffian:
    """A car, x y t0, with n trailers t1 ... of length 1, each coupled to the axle before it: no
    axle slips.
    """
    angles = [f"t{i}" for i in range(n + 1)]
    rows = []
    for i, t in enumerate(angles):
        turned = [f"-cos({t} - {u})" if 0 < j <= i else "0" for j, u in enumerate(angles)]
        rows.append((f"-sin({t})", f"cos({t})", *turned))
    return Pfaffian("x y " + " ".join(angles), tuple(rows))


SYSTEMS = {
    "knife edge": Pfaffian("x y t", (("sin(t)", "-cos(t)", "0"),)),
    "upright disc": Pfaffian(
        "x y t p", (("1", "0", "0", "-cos(t)*0.3"), ("0", "1", "0", "-sin(t)*0.3"))
    ),
    "steered car": Pfaffian(
        "x y t p", (("sin(t)", "-cos(t)", "0", "0"), ("sin(t+p)", "-cos(t+p)", "-cos(p)", "0"))
    ),
    "Martinet": Pfaffian("x y z", (("-y**2", "0", "1"),)),
    "Heisenberg": Pfaffian("x y z", (("y/2", "-x/2", "1"),)),
    "Engel": Pfaffian("x y z w", (("-z", "1", "0", "0"), ("-w", "0", "1", "0"))),
    "Cartan": Pfaffian(
        "x y z u v",
        (("y", "-x", "1", "0", "0"), ("-z", "0", "0", "1", "0"), ("0", "-z", "0", "0", "1")),
    ),
    "exact": Pfaffian("x y z", (("cos(x)*y", "sin(x)", "exp(z)"),)),
    "exact, with a factor": Pfaffian("x y z", (("x*(2+sin(y))", "y*(2+sin(y))", "z*(2+sin(y))"),)),
    "two exact": Pfaffian("x y z w", (("y*z", "x*z", "x*y", "0"), ("1", "1", "1", "2*w"))),
    "exact only together": Pfaffian("x y z w", (("-y", "0", "1", "0"), ("0", "1", "0", "0"))),
    "one exact of two": Pfaffian("x y z w", (("-y", "0", "1", "0"), ("0", "0", "0", "1"))),
    "leaf z = 0": Pfaffian("x y z", (("0", "-x*z", "1"),)),
    "one trailer": trailers(1),
    "two trailers": trailers(2),
    "three trailers": trailers(3),
}
"""Systems of up to six coordinates: literature, and exact forms."""


def fields(A: Any, symbols: list[Any], free: list[int]) -> list[Any]:
    """The fields in the null space of A whose free entries are 1, one after the other, and 0."""
    dependent = [i for i in range(len(symbols)) if i not in free]
    solved: Any = -A[:, dependent].LUsolve(A[:, free]) if dependent else None
    out = []
    for k, i in enumerate(free):
        x = sympy.zeros(len(symbols), 1)
        x[i] = 1
        for d, j in enumerate(dependent):
            x[j] = solved[d, k]
        out.append(x)
    return out


def bracket(X: Any, Y: Any, symbols: list[Any]) -> Any:
    """[X, Y] = DY X - DX Y."""
    return Y.jacobian(symbols) * X - X.jacobian(symbols) * Y


def at_point(X: Any, symbols: list[Any], q: np.ndarray) -> np.ndarray:
    """The numbers of a field at q, from forty digits."""
    exact = {s: sympy.Rational(float(x)) for s, x in zip(symbols, q, strict=True)}
    return np.array([float(sympy.N(x.subs(exact), 40)) for x in X])


def growth_by_symbols(
    system: Pfaffian, q: np.ndarray, free: list[int], steps: int
) -> tuple[int, ...]:
    """The growth vector at q, up to brackets of so many letters, from all words of the fields."""
    symbols, A = system.symbolic()
    X = fields(A, symbols, free)
    words = list(X)
    span = []
    out = []
    for _ in range(steps):
        span += [at_point(w, symbols, q) for w in words]
        values = np.linalg.svd(
            np.array(span) / np.max(np.abs(span), axis=1, initial=1e-9, keepdims=True)
        )[1]
        out.append(int(np.sum(values > 1e-9)))
        words = [bracket(x, w, symbols) for x, w in itertools.product(X, words)]
    return tuple(out)
