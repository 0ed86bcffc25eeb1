"""Charts: independent coordinates, the others from them, and when that fails."""

from __future__ import annotations

import math

import numpy as np
import pytest

import kempe
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics import loops
from kempe.solvers.charts import WORST, Chart, tangent_space

SYSTEMS = {"four_bar": 1, "five_bar": 2, "bennett": 1, "jansen": 1, "stewart": 6, "three_rrr": 3, "sarrus": 1}


@pytest.mark.parametrize(("name", "p"), SYSTEMS.items())
def test_as_many_as_there_are_freedoms(name, p):
    s = kempe.load(name)
    chart = s.independent(s.posture("closed"))
    assert chart.dim == p and set(chart.independent) | set(chart.dependent) == set(s.velocity_names)
    assert chart.valid(chart.origin) and chart.quality == pytest.approx(chart.condition(chart.origin))


@pytest.mark.parametrize("name", SYSTEMS)
def test_there_and_back(name):
    """q -> u -> q at other configurations of the chart, and tangents against central differences."""
    s = kempe.load(name)
    chart = s.independent(s.posture("closed"))
    rng = np.random.default_rng(3)
    u = chart.u(chart.origin) + 0.02 * rng.normal(size=chart.dim)
    q = chart.q(u)
    assert q.success and np.abs(s.closure_error(q.q)).max() < 1e-9
    np.testing.assert_allclose(chart.u(q.q), u, atol=1e-14)
    h = 1e-6
    numeric = np.stack([s.difference(chart.q(u - h * e, q.q).q, chart.q(u + h * e, q.q).q) / (2 * h)
                        for e in np.eye(chart.dim)], -1)  # fmt: skip
    np.testing.assert_allclose(chart.tangent(q.q), numeric, atol=1e-7 * (1 + np.abs(numeric).max()))


def test_a_batch_of_parameters():
    s = kempe.load("five_bar")
    chart = s.independent(s.posture("closed"))
    u = chart.u(chart.origin) + np.linspace(-0.05, 0.05, 11)[:, None]
    answer = chart.q(u)
    assert answer.q.shape == (11, s.nq) and answer.success.all()
    np.testing.assert_allclose(chart.u(answer.q), u, atol=1e-14)


def test_the_tangent_space_is_the_kernel():
    s = kempe.load("stewart")
    q = s.posture("closed")
    N, scale = tangent_space(s, q)
    np.testing.assert_allclose(N.T @ N, np.eye(6), atol=1e-12)
    assert np.abs(loops.jacobian(s, q) @ (scale[:, None] * N)).max() < 1e-12


def test_preferred_coordinates_come_first_or_are_refused():
    s = kempe.load("five_bar")
    q = s.posture("closed")
    for pair in (("A", "D"), ("A", "B"), ("B", "C")):
        if set(pair) <= set(s.velocity_names):
            assert set(s.independent(q, prefer=pair).independent) == set(pair)
    assert "A" in s.independent(q, prefer=["A"]).independent
    with pytest.raises(InputError, match="3 coordinates are preferred; here 2"):
        s.independent(q, prefer=s.velocity_names[:3])
    with pytest.raises(UnknownNameError):
        s.independent(q, prefer=["nobody"])
    with pytest.raises(InputError, match="not closed"):
        s.independent(q + 0.1)


def test_a_chart_fails_at_a_dead_point_and_another_takes_over():
    """A double rocker's crank cannot be set where coupler and rocker are in line: cosine law."""
    a, b, c, d = 0.4, 0.15, 0.3, 0.5
    m = kempe.Mechanism("rocker", dim=2)
    for body in ("crank", "coupler", "rocker"):
        m.body(body)
    m.revolute("A", m.ground, "crank")
    m.revolute("B", "crank", "coupler", at=(a, 0))
    m.revolute("C", "coupler", "rocker", at=(b, 0), child_at=(c, 0))
    m.revolute("D", m.ground, "rocker", at=(d, 0))
    s = m.build()
    extreme = math.acos((a * a + d * d - (b + c) ** 2) / (2 * a * d))
    chart = None
    for gap in (0.3, 1e-5):
        answer = s.assemble({"A": extreme - gap}, near=s.q({"A": extreme - gap, "B": -1.5, "D": 2.0}), starts=50)
        assert answer
        chart = s.independent(answer.q, prefer=["A"]) if gap == 0.3 else chart
        assert isinstance(chart, Chart)
        if gap == 0.3:
            assert chart.condition(answer.q) > 5 * WORST
            continue
        assert chart.condition(answer.q) < WORST and not chart.valid(answer.q)
        better = chart.next(answer.q)
        assert better.independent != ("A",) and better.quality > 0.5
        with pytest.raises(InputError, match="cannot be set independently"):
            s.independent(answer.q, prefer=["A"])
    assert not s.assemble({"A": extreme + 1e-3}, starts=30)


def test_open_chains_have_their_own_coordinates():
    s = kempe.load("puma560")
    chart = s.independent(s.mid)
    assert chart.independent == s.velocity_names and chart.quality == pytest.approx(1.0)
    assert str(chart).startswith("6 independent coordinates")
