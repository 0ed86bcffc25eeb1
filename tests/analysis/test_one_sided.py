"""One-sided constraints at a configuration: which are closed, and what they allow, against linear programs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import kempe
from kempe.analysis.one_sided import one_sided
from kempe.kinematics.loops import evaluate


def least(c, E, G):
    """The least of c @ v within a unit box, where E v = 0 and G v >= 0."""
    b = None if not len(G) else np.zeros(len(G))
    e = None if not len(E) else np.zeros(len(E))
    out = linprog(c, -G if len(G) else None, b, E if len(E) else None, e, bounds=[(-1, 1)] * len(c), method="highs")
    return out.fun


def spanned(E, G, n, rng):
    """Dimension of the cone, from where linear functions are least in it."""
    b = None if not len(G) else np.zeros(len(G))
    found = [linprog(rng.normal(size=n), -G if len(G) else None, b, E if len(E) else None, None if not len(E) else
                     np.zeros(len(E)), bounds=[(-1, 1)] * n, method="highs").x for _ in range(4 * n)]  # fmt: skip
    return int(np.sum(np.linalg.svd(np.array(found), compute_uv=False) > 1e-6))


SYSTEMS = ("four_bar", "puma560", "five_bar", "two_link", pytest.param("stewart", marks=pytest.mark.slow))


@pytest.mark.parametrize("name", SYSTEMS)
def test_limits_that_are_reached(name, hunt):
    """Limits are put where coordinates are, below, above, or both; oracle: linear programs over the whole cone."""
    system, rng = kempe.load(name), hunt.rng()
    q = system.mobility(local=False).q
    at, v = system.layout.vector_q, system.layout.vector_v
    for _ in range(hunt.cases(5)):
        limits = np.column_stack([np.full(system.nv, -np.inf), np.full(system.nv, np.inf)])
        G = []
        for i, k in zip(at, v, strict=True):
            kind = rng.integers(0, 4)
            if kind % 2:
                limits[k, 0] = q[i]
                G.append(np.eye(system.nv)[k])
            if kind > 1:
                limits[k, 1] = q[i]
                G.append(-np.eye(system.nv)[k])
        E, G = evaluate(system, q, True, True)[1], np.array(G).reshape(-1, system.nv)
        found = one_sided(system.with_limits(limits), q)
        assert len(found.active) == len(G)
        assert not found.violated
        assert found.dimension == spanned(E, G, system.nv, rng)
        for k in range(system.nv):
            row = np.eye(system.nv)[k]
            ways = found.coordinates[system.velocity_names[k]]
            assert ways == (least(row, E, G) < -1e-6, least(-row, E, G) < -1e-6)


def test_states_and_slacks():
    system = kempe.load("puma560")
    low, high = system.limits.T
    q = system.mid.copy()
    q[0], q[1], q[2] = high[0], low[1] - 0.25, low[2] + 0.5
    found = one_sided(system, q)
    assert found.active == ("upper limit of q1",)
    assert found.violated == ("lower limit of q2",)
    side = {s.name: s for s in found.sides}
    assert side["lower limit of q2"].slack == pytest.approx(-0.25)
    assert side["lower limit of q3"].slack == pytest.approx(0.5)
    assert "violated: lower limit of q2 by 0.25 rad" in str(found)
    assert "closed, down but not up" in str(side["upper limit of q1"])


def test_mobility_tells_which_limits_are_reached():
    system = kempe.load("two_link").with_limits({"q1": (0.5, 1.0)})
    assert system.mobility([0.7, 0.2]).one_sided is None
    m = system.mobility([0.5, 0.2])
    assert (m.dof, m.rank_dof) == (2, 2)
    assert m.one_sided is not None
    assert m.one_sided.active == ("lower limit of q1",)
    assert (m.one_sided.dimension, m.one_sided.lineality) == (2, 1)
    assert "up but not down" in str(m)
    assert m.data()["one_sided"]["active"] == ["lower limit of q1"]
