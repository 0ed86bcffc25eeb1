"""Ranks of many loops: banded equations give what a dense decomposition gives."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe.first_order import rank as ranks
from kempe.first_order.rank import compute_rank
from kempe.numerics import rank as numerics


def row_of_loops(n: int, every: int = 0, slide: bool = False) -> kempe.System:
    """A row of n four-bars between cranks; of each `every`-th the coupler has a joint more, and the
    first crank may be pushed by a slide.
    """
    m = kempe.Mechanism(f"row of {n} loops", dim=2)
    for i in range(n + 1):
        m.revolute(f"A{i}", m.ground, m.body(f"crank{i}"), at=(i, 0))
    for i in range(n):
        link = m.body(f"coupler{i}")
        reach = 1.0 + 0.02 * (i % 3)
        m.revolute(f"B{i}", f"crank{i}", link, at=(0, 0.5))
        if every and i % every == 0:
            more = m.body(f"more{i}")
            m.revolute(f"D{i}", link, more, at=(0.6 * reach, 0))
            link = more
            reach *= 0.4
        m.revolute(f"C{i}", link, f"crank{i + 1}", at=(reach, 0), child_at=(0, 0.5))
    if slide:
        m.prismatic("S", m.ground, m.body("slider"), at=(-2, 0), axis=(1, 0))
        m.revolute("P", "crank0", m.body("rod"), at=(0, 0.3))
        m.revolute("Q", "rod", "slider", at=(1.5, 0.0))
    return m.build()


@pytest.mark.parametrize("options", [{}, {"every": 9}, {"every": 4, "slide": True}])
def test_banded_equations_give_the_dense_rank_and_null_space(options, monkeypatch):
    system = row_of_loops(60, **options)
    q = system.assemble(start=system.neutral + 0.01).q
    monkeypatch.setattr(ranks, "BANDED", 10**9)
    dense = compute_rank(system, q)
    monkeypatch.setattr(ranks, "BANDED", 1)
    banded = compute_rank(system, q)
    assert len(dense.clusters) == len(banded.clusters) == 1
    one, other = dense.clusters[0], banded.clusters[0]
    assert (one.rank, one.nullity, one.n_dependent) == (other.rank, other.nullity, 0)
    assert one.stresses.shape == other.stresses.shape
    np.testing.assert_allclose(other.values, one.values, atol=1e-10)
    np.testing.assert_allclose(other.size, one.size, rtol=1e-12)
    np.testing.assert_allclose(other.gap, one.gap, rtol=1e-6)
    N = other.null_space
    np.testing.assert_allclose(N.T @ N, np.eye(other.nullity), atol=1e-13)
    assert np.abs(other.jacobian @ N).max() < 1e-14
    assert np.linalg.norm(N - one.null_space @ (one.null_space.T @ N)) < 1e-11


def test_a_rank_that_is_not_clearly_full_is_left_to_the_dense_decomposition(monkeypatch):
    """A row of parallelograms that lie flat: the rank falls there."""
    m = kempe.Mechanism("flat row", dim=2)
    for i in range(31):
        m.revolute(f"A{i}", m.ground, m.body(f"crank{i}"), at=(i, 0))
    for i in range(30):
        m.revolute(f"B{i}", f"crank{i}", m.body(f"coupler{i}"), at=(0.5, 0))
        m.revolute(f"C{i}", f"coupler{i}", f"crank{i + 1}", at=(1, 0), child_at=(0.5, 0))
    system = m.build()
    monkeypatch.setattr(ranks, "BANDED", 10**9)
    dense = compute_rank(system, system.neutral)
    monkeypatch.setattr(ranks, "BANDED", 1)
    banded = compute_rank(system, system.neutral)
    assert dense.n_dependent > 0
    assert (banded.rank, banded.nullity) == (dense.rank, dense.nullity)


@pytest.mark.slow
def test_mobility_of_a_long_row_takes_no_large_decomposition(monkeypatch):
    """Counted are the entries of the largest matrix whose singular values are computed."""
    largest = [0]
    decompose = numerics.compute_svd

    def count(A, *args, **options):
        largest[0] = max(largest[0], np.size(A))
        return decompose(A, *args, **options)

    monkeypatch.setattr(numerics, "compute_svd", count)
    system = row_of_loops(150)
    found = system.mobility(system.assemble({"A0": 0.2}).q)
    assert found.dof == 1 and found.certain
    assert largest[0] < 10_000
