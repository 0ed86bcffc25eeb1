"""Lie brackets and growth vectors against sympy, against the literature and against what leaves
them as they are.
"""

from __future__ import annotations

from typing import Any

import hunts
import numpy as np
import pytest
import sympy
from hunts import Hunt, some
from pfaffian import SYSTEMS, Pfaffian, at_point, bracket, fields, growth_by_symbols, trailers

from kempe.mobility.classify import EvaluationPoint, Reach, compute_reach, sample_nearby_point
from kempe.mobility.growth_vectors import Words, compute_distribution, compute_growth

CHEAP = [name for name in SYSTEMS if name != "three trailers"]


def reached(system: Pfaffian, q: object, seed: int = 0) -> Reach:
    """What motions reach from q."""
    rows = system.rows()
    rng = np.random.default_rng(seed)
    place = EvaluationPoint(rows, np.array(q, dtype=float), 0.0, (), lambda q: q)
    return compute_reach(place, sample_nearby_point(place, rng), range(len(rows.names)), rng)


def words_by_symbols(
    system: Pfaffian, q: np.ndarray, free: list[int], letters: np.ndarray
) -> list[np.ndarray]:
    """The brackets of the last 1, 2, ... letters at q."""
    symbols, A = system.symbolic()
    basis = fields(A, symbols, free)
    X: list[Any] = [
        sum((sympy.Rational(float(c)) * x for c, x in zip(row, basis, strict=True)), 0 * basis[0])
        for row in letters
    ]
    word = X[-1]
    out = []
    for x in [None, *X[-2::-1]]:
        word = word if x is None else bracket(x, word, symbols)
        out.append(at_point(word, symbols, q))
    return out


@pytest.mark.parametrize("name", some(CHEAP, 4))
def test_words_are_those_of_sympy(name: str, hunt: Hunt) -> None:
    """Brackets of up to four random letters, three with five coordinates, at a random point, to
    their rounding.
    """
    system = SYSTEMS[name]
    rng = hunt.rng()
    q = rng.uniform(0.2, 1.2, size=len(system.names))
    at = compute_distribution(system.rows(), q)
    length = 4 if len(q) < 5 else 3
    free = np.flatnonzero(at.pivots < 0)
    words = Words(at, rng)
    letters = rng.normal(size=(length, len(free)))
    found, noise = words.evaluate_brackets((letters @ np.eye(len(q))[free])[None])
    for k, exact in enumerate(words_by_symbols(system, q, free.tolist(), letters)):
        error = float(np.max(np.abs(found[0, length - 1 - k] - exact)))
        assert error <= 10.0 * noise[0, length - 1 - k] + 1e-17, (k, error)


@pytest.mark.slow
def test_words_of_three_trailers_are_those_of_sympy(hunt: Hunt) -> None:
    """Six coordinates, four letters."""
    test_words_are_those_of_sympy("three trailers", hunt)


LITERATURE = {
    "knife edge": ((0.1, 0.2, 0.3), (2, 3), (2, 3)),
    "upright disc": ((0.1, 0.2, 0.3, 0.4), (2, 3, 4), (2, 3, 4)),
    "steered car": ((0.1, 0.2, 0.3, 0.4), (2, 3, 4), (2, 3, 4)),
    "Martinet": ((0.1, 0.5, 0.3), (2, 3), (2, 3)),
    "Heisenberg": ((0.1, 0.2, 0.3), (2, 3), (2, 3)),
    "Engel": ((0.1, 0.2, 0.3, 0.4), (2, 3, 4), (2, 3, 4)),
    "Cartan": ((0.1, 0.2, 0.3, 0.4, 0.5), (2, 3, 5), (2, 3, 5)),
    "exact": ((0.1, 0.2, 0.3), (2, 2), (2, 2)),
    "exact, with a factor": ((0.1, 0.2, 0.3), (2, 2), (2, 2)),
    "two exact": ((0.1, 0.2, 0.3, 0.4), (2, 2), (2, 2)),
    "exact only together": ((0.1, 0.2, 0.3, 0.4), (2, 2), (2, 2)),
    "one exact of two": ((0.1, 0.2, 0.3, 0.4), (2, 3, 3), (2, 3, 3)),
    "leaf z = 0": ((0.1, 0.2, 0.3), (2, 3), (2, 3)),
    "one trailer": ((0.1, 0.2, 0.3, 0.6), (2, 3, 4), (2, 3, 4)),
    "two trailers": ((0.1, 0.2, 0.3, 0.6, 0.1), (2, 3, 4, 5), (2, 3, 4, 5)),
    "three trailers": ((0.1, 0.2, 0.3, 0.6, 0.1, 0.9), (2, 3, 4, 5, 6), (2, 3, 4, 5, 6)),
}
SINGULAR = {
    "Martinet": ((0.1, 0.0, 0.3), (2, 2, 3), (2, 3)),
    "leaf z = 0": ((0.1, 0.2, 0.0), (2, 2), (2, 3)),
    "two trailers": ((0.1, 0.2, 0.3, 0.3 + np.pi / 2, 0.1), (2, 3, 4, 4, 5), (2, 3, 4, 5)),
}
"""Growth at a point and around: Bellaiche (1996), Jean (1996), Montgomery (2002)."""


POINTS = {
    f"{name}, {at}": (name, *row)
    for at, rows in (("generic", LITERATURE), ("singular", SINGULAR))
    for name, row in rows.items()
}


@pytest.mark.parametrize("name, q, here, around", POINTS.values(), ids=POINTS)
def test_growth_of_the_literature(name: str, q: tuple, here: tuple, around: tuple) -> None:
    """Growth vectors at points of which they are known, and around these."""
    found = reached(SYSTEMS[name], q)
    assert (found.growth, found.around, found.doubtful) == (here, around, False)
    assert found.dimension == here[-1]
    assert found.dimension_around == around[-1]
    assert found.degree == here.index(here[-1]) + 1


LONG = (
    pytest.mark.slow,
    pytest.mark.skipif(hunts.TIMES < 1, reason="takes half a minute: --hunt-times 1"),
)


@pytest.mark.parametrize(
    "name", some([pytest.param(n, marks=LONG) if n == "two trailers" else n for n in CHEAP], 4)
)
def test_growth_is_that_of_all_brackets_of_sympy(name: str) -> None:
    """All words of the fields, symbolically, at the point of the literature and at the singular
    one.
    """
    system = SYSTEMS[name]
    for q, here, _ in [cases[name] for cases in (LITERATURE, SINGULAR) if name in cases]:
        point = np.array(q)
        free = np.flatnonzero(compute_distribution(system.rows(), point).pivots < 0).tolist()
        assert growth_by_symbols(system, point, free, len(here)) == here


PERPENDICULAR = {
    (2, (1,)): (2, 3, 4, 4, 5),
    (2, (2,)): (2, 3, 4, 5),
    (3, (1,)): (2, 3, 4, 4, 5, 5, 6),
    (3, (1, 2)): (2, 3, 4, 4, 5, 5, 5, 6),
    (3, (2,)): (2, 3, 4, 5, 5, 6),
    (3, (3,)): (2, 3, 4, 5, 6),
}
"""By the number of trailers and which of them stand across what pulls them. The last one may: Jean
(1996). The degrees of those that all do are Fibonacci numbers, 5 and 8: Luca, Risler (1994)."""


@pytest.mark.parametrize(("n", "across"), PERPENDICULAR)
def test_trailers_across(n: int, across: tuple[int, ...], hunt: Hunt) -> None:
    """Singular configurations of trailers, with random other angles."""
    rng = hunt.rng()
    for _ in range(hunt.cases(5)):
        q = np.zeros(3 + n)
        q[:3] = rng.uniform(-2, 2, size=3)
        for i in range(1, n + 1):
            q[2 + i] = q[1 + i] + (
                rng.choice([-1, 1]) * np.pi / 2 if i in across else rng.uniform(-1, 1)
            )
        found = reached(trailers(n), q)
        assert (found.growth, found.dimension) == (PERPENDICULAR[n, across], 3 + n)
        assert found.around == tuple(range(2, 4 + n))


@pytest.mark.slow
def test_degree_of_four_trailers_across() -> None:
    """F(7) = 13 letters (Luca, Risler, 1994)."""
    q = np.array([0.0, 0.0, *np.cumsum([0.3, np.pi / 2, np.pi / 2, np.pi / 2, 0.2])])
    found = reached(trailers(4), q)
    assert found.growth == (2, 3, 4, 4, 5, 5, 5, 6, 6, 6, 6, 6, 7)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 5])
def test_growth_of_trailers(n: int, hunt: Hunt) -> None:
    """(2, 3, ..., n + 3) at random configurations, none of which is near a singular one, and never
    doubtful.
    """
    rows = trailers(n).rows()
    rng = hunt.rng()
    for _ in range(hunt.cases(170)):
        q = rng.uniform(-2, 2, size=3 + n)
        q[3:] = q[2] + np.cumsum(rng.uniform(-1.1, 1.1, size=n))
        found = compute_growth(compute_distribution(rows, q), rng, n + 3, False)
        assert (found.dimensions, found.doubtful) == (tuple(range(2, 4 + n)), False)


@pytest.mark.parametrize("name", LITERATURE)
def test_growth_does_not_depend_on_how_rows_are_written(name: str, hunt: Hunt) -> None:
    """Sums of rows with factors that are functions, in other units, and coordinates in another
    order.
    """
    system = SYSTEMS[name]
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        q, here, _ = (SINGULAR if name in SINGULAR and rng.random() < 0.5 else LITERATURE)[name]
        names = system.names
        m = len(system.text)
        order = rng.permutation(len(q))
        mix = (np.eye(m) + rng.uniform(-0.3, 0.3, size=(m, m)) / m).tolist()
        factors = [
            [f"({mix[i][j]!r}*(2 + sin({rng.choice(names)})))" for j in range(m)] for i in range(m)
        ]
        sums = [
            [
                " + ".join(f"{f}*({row[j]})" for f, row in zip(own, system.text, strict=True))
                for j in order
            ]
            for own in factors
        ]
        other = Pfaffian(" ".join(names[j] for j in order), tuple(map(tuple, sums)))
        found = reached(other, np.array(q)[order], int(rng.integers(1000)))
        assert (found.growth, found.dimension) == (here, here[-1])
