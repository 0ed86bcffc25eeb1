"""Tangent cones against exact rational arithmetic over all sets of active rows, and cases known by
hand.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from cones import Exact, null_space

from kempe.mobility.one_sided import ConeDirections, compute_tangent_cone


def rows_of(rng, k, n, size):
    return [tuple(Fraction(int(x)) for x in rng.integers(-size, size + 1, n)) for _ in range(k)]


def case(rng):
    """Rows of small integers, some of them opposite, sums of others, equal, or zero."""
    n = int(rng.integers(1, 5))
    E = rows_of(rng, int(rng.integers(0, n)), n, 1)
    G = rows_of(rng, int(rng.integers(0, 7)), n, int(rng.integers(1, 3)))
    for i in range(1, len(G)):
        what = rng.random()
        j, k = rng.integers(0, i, 2)
        if what < 0.15:
            G[i] = tuple(-x for x in G[j])
        elif what < 0.3:
            G[i] = tuple(x + y for x, y in zip(G[j], G[k], strict=True))
        elif what < 0.4:
            G[i] = tuple(-x - y for x, y in zip(G[j], G[k], strict=True))
        elif what < 0.45 and E:
            G[i] = tuple(x + y for x, y in zip(G[j], E[0], strict=True))
    return n, E, G


def floats(rows, n):
    return np.array([[float(x) for x in r] for r in rows]).reshape(len(rows), n)


def agrees(n, E, G, C, probes, turn):
    exact = Exact(E, G, n)
    assert (C.size, C.dimension, C.lineality) == (n, exact.dimension, exact.lineality)
    vanishing = [i for i, g in enumerate(G) if not any(g)]
    held = [
        all(sum(a * b for a, b in zip(g, v, strict=True)) == 0 for v in null_space(E, n)) for g in G
    ]
    still = [exact.ways(g) == (False, False) for g in G]
    assert list(C.vanishing) == vanishing
    assert list(C.implied) == [i for i in range(len(G)) if held[i] and i not in vanishing]
    assert list(C.implicit) == [i for i in range(len(G)) if still[i] and not held[i]]
    for i in C.redundant:
        rest = [g for j, g in enumerate(G) if j not in C.redundant]
        assert Exact(E, rest, n).always(G[i])
    for i in set(range(len(G))) - {*C.redundant, *C.implied, *C.vanishing}:
        rest = [g for j, g in enumerate(G) if j not in C.redundant and j != i]
        assert not Exact(E, rest, n).always(G[i])
    assert C.rays is not None
    assert len(C.rays) == len(exact.rays)
    for row in [*probes, *G]:
        assert C.find_directions(turn @ np.array([float(x) for x in row])) == exact.ways(row)


@pytest.mark.parametrize("number", [250, pytest.param(1000, marks=pytest.mark.slow)])
def test_cones_of_random_rows(hunt, number):
    """Rows are turned into other axes and scaled, which changes nothing."""
    rng = hunt.rng()
    for _ in range(hunt.cases(number)):
        n, E, G = case(rng)
        probes = rows_of(rng, 3, n, 2)
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        scale = 10.0 ** rng.uniform(-1, 1, (len(G), 1))
        C = compute_tangent_cone(floats(E, n) @ turn.T, scale * (floats(G, n) @ turn.T))
        agrees(n, E, G, C, probes, turn)


def test_rays_are_edges(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(200)):
        n, E, G = case(rng)
        C = compute_tangent_cone(floats(E, n), floats(G, n))
        assert C.rays is not None
        assert np.all(C.rays @ floats(G, n).T > -1e-12)
        assert np.allclose(C.rays @ floats(E, n).T, 0.0)
        assert np.allclose(C.rays @ C.free.T, 0.0)


@pytest.mark.parametrize(
    ("G", "dimension", "lineality", "implicit", "redundant"),
    [
        ([[0, 0, 1]], 3, 2, (), ()),  # a ball on the floor
        ([[0, 0, 1], [0, 0, -1]], 2, 2, (0, 1), ()),  # between two plates
        ([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]], 3, 0, (), ()),  # in a pyramid
        ([[1, 0, 0], [0, 1, 0], [-1, -1, 0]], 1, 1, (0, 1, 2), ()),  # three walls of a shaft
        ([[0, 0, 1], [0, 0, 2], [1, 0, 0], [1, 0, 1]], 3, 1, (), (1, 3)),
        ([[1, 0, 0], [-1, 0, 0], [0, 1, 0]], 2, 1, (0, 1), ()),
    ],
)
def test_contacts_of_a_point(G, dimension, lineality, implicit, redundant):
    C = compute_tangent_cone(np.zeros((0, 3)), np.array(G, dtype=float))
    assert (C.dimension, C.lineality, C.implicit, C.redundant) == (
        dimension,
        lineality,
        implicit,
        redundant,
    )


def test_up_but_not_down():
    C = compute_tangent_cone(np.zeros((0, 3)), np.array([[0.0, 0, 1]]))
    assert C.find_directions([0, 0, 1]) == ConeDirections(down=False, up=True)
    assert C.find_directions([1, 0, 0]) == ConeDirections(down=True, up=True)
    assert C.exact


def test_a_row_that_vanishes_says_nothing_to_first_order():
    C = compute_tangent_cone(np.zeros((0, 2)), np.array([[0.0, 3e-8]]))
    assert (C.dimension, C.lineality, C.vanishing, C.exact) == (2, 2, (0,), False)


@pytest.mark.parametrize("opening", [1e-2, 1e-4, 1e-5])
def test_a_narrow_wedge_is_open(opening):
    C = compute_tangent_cone(np.zeros((0, 2)), np.array([[opening, 1.0], [opening, -1.0]]))
    assert (C.dimension, C.lineality, C.implicit) == (2, 0, ())
    C = compute_tangent_cone(
        np.zeros((0, 2)), np.array([[opening, 1.0], [opening, -1.0], [1.0, 0.0]])
    )
    assert (C.dimension, C.lineality, C.implicit, C.redundant) == (2, 0, (), (2,))


@pytest.mark.parametrize("opening", [0.0, 1e-9, -1e-9])
def test_a_wedge_closed_to_rounding_is_closed(opening):
    G = np.array([[opening, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    C = compute_tangent_cone(np.zeros((0, 3)), G)
    assert (C.dimension, C.lineality, C.implicit) == (2, 1, (0, 1))


def test_many_rows_list_no_rays_but_answer(hunt):
    """A regular cone around the last axis: rays are not listed, and what is allowed is the same."""
    rng = hunt.rng()
    normals = rng.normal(size=(60, 4))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    G = np.column_stack([normals, np.ones(60)])
    C = compute_tangent_cone(np.zeros((0, 5)), G)
    assert C.rays is None
    assert (C.dimension, C.lineality) == (5, 0)
    assert C.find_directions([0, 0, 0, 0, 1]) == ConeDirections(down=False, up=True)
    assert C.find_directions([1, 0, 0, 0, 0]) == ConeDirections(down=True, up=True)
