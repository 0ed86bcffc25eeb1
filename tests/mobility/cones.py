"""Cones in exact rational numbers, by trying all sets of active rows: what the tests of tangent
cones are against.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

Row = tuple[Fraction, ...]


def dot(a: Row, b: Row) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def reduced(rows: list[Row]) -> tuple[list[Row], list[int]]:
    """Reduced echelon form and its pivots."""
    m = [list(r) for r in rows]
    pivots = list[int]()
    at = 0
    for c in range(len(m[0]) if m else 0):
        p = next((i for i in range(at, len(m)) if m[i][c]), None)
        if p is None:
            continue
        m[at], m[p] = m[p], m[at]
        m[at] = [x / m[at][c] for x in m[at]]
        for i in range(len(m)):
            if i != at and m[i][c]:
                m[i] = [x - m[i][c] * y for x, y in zip(m[i], m[at], strict=True)]
        pivots.append(c)
        at += 1
    return [tuple(r) for r in m[:at]], pivots


def rank(rows: list[Row]) -> int:
    return len(reduced(rows)[1])


def null_space(rows: list[Row], n: int) -> list[Row]:
    """A basis of what rows leave at zero."""
    form, pivots = reduced(rows)
    out = []
    for c in (c for c in range(n) if c not in pivots):
        v = [Fraction(0)] * n
        v[c] = Fraction(1)
        for row, p in zip(form, pivots, strict=True):
            v[p] = -row[c]
        out.append(tuple(v))
    return out


@dataclass
class Exact:
    """The cone {E v = 0, G v >= 0}: lines, and edges across them."""

    E: list[Row]
    G: list[Row]
    n: int

    def __post_init__(self):
        self.lines = null_space([*self.E, *self.G], self.n)
        fixed = [*self.E, *self.lines]  # edges are looked for across the lines
        r = self.n - rank(fixed)
        found = set()
        for size in range(len(self.G) + 1):
            for chosen in combinations(self.G, size):
                line = null_space([*fixed, *chosen], self.n)
                if len(line) != 1 or r == 0:
                    continue
                for ray in (line[0], tuple(-x for x in line[0])):
                    if all(dot(g, ray) >= 0 for g in self.G):
                        largest = max(abs(x) for x in ray)
                        found.add(tuple(x / largest for x in ray))
        self.rays = sorted(found)

    @property
    def lineality(self) -> int:
        return len(self.lines)

    @property
    def dimension(self) -> int:
        return rank([*self.lines, *self.rays]) if self.lines or self.rays else 0

    def ways(self, row: Row) -> tuple[bool, bool]:
        if any(dot(row, v) for v in self.lines):
            return True, True
        rates = [dot(row, v) for v in self.rays]
        return any(x < 0 for x in rates), any(x > 0 for x in rates)

    def always(self, row: Row) -> bool:
        """Whether a row is never negative on the cone."""
        return not self.ways(row)[0]
