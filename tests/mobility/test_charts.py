"""Charts: independent coordinates, the others from them, and when that fails."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some

import kempe
from kempe import library
from kempe.equations import closure_rows
from kempe.errors import InputError, UnknownNameError
from kempe.joints import TYPES
from kempe.mobility.independent import WORST, Chart, compute_tangent_space

SYSTEMS = {
    "four_bar": 1,
    "five_bar": 2,
    "bennett": 1,
    "jansen": 1,
    "stewart": 6,
    "three_rrr": 3,
    "sarrus": 1,
}


@pytest.mark.parametrize(("name", "p"), SYSTEMS.items())
def test_as_many_as_there_are_freedoms(name, p):
    s = kempe.load(name)
    chart = s.independent(s.q("closed"))
    assert chart.dim == p and set(chart.independent) | set(chart.dependent) == set(
        s.structure.velocity_names
    )
    assert chart.valid(chart.origin) and chart.quality == pytest.approx(
        chart.condition(chart.origin)
    )


def there_and_back(s: kempe.System, chart: Chart) -> None:
    """q -> u -> q at another configuration than the origin, and tangents against central
    differences.
    """
    rng = np.random.default_rng(3)
    u = chart.u(chart.origin) + 0.02 * rng.normal(size=chart.dim)
    q = chart.q(u)
    assert q.success and np.abs(s.loops.closure_error(q.q)).max(initial=0.0) < 1e-9
    np.testing.assert_allclose(chart.u(q.q), u, atol=1e-12)
    h = 1e-6
    difference = s.configuration_space.difference
    numeric = np.stack(
        [
            difference(chart.q(u - h * e, q.q).q, chart.q(u + h * e, q.q).q) / (2 * h)
            for e in np.eye(chart.dim)
        ],
        -1,
    )
    np.testing.assert_allclose(chart.tangent(q.q), numeric, atol=1e-7 * (1 + np.abs(numeric).max()))
    many = chart.q(u + 0.003 * rng.normal(size=(4, chart.dim)), q.q)
    assert many.q.shape == (4, s.nq) and many.success.all()


@pytest.mark.parametrize("name", SYSTEMS)
def test_there_and_back(name):
    s = kempe.load(name)
    there_and_back(s, s.independent(s.q("closed")))


TABLE = [
    (name, dim)
    for name, t in TYPES.items()
    for dim in ((2, 3) if t.planar else (3,))
    if t().dof(dim)
]


@pytest.mark.parametrize("looped", [False, True])
@pytest.mark.parametrize(("name", "dim"), TABLE)
def test_each_joint_of_the_table_has_charts(name, dim, looped):
    """A body on a joint, and the same one that a free joint holds, too: that leaves what the first
    joint leaves.
    """
    m = kempe.Mechanism("one joint", dim=dim)
    at = (0.3, -0.2, 0.1)[:dim]
    turned = (
        {"rpy": (0.2, 0.4, -0.3)}
        if dim == 3
        else {"axis": (1.0, 0.5)}
        if name == "prismatic"
        else {"angle": 0.3}
    )
    m.joint("J", name, m.ground, m.body("body"), at=at, **turned)
    if looped:
        m.joint("F", "free", m.ground, "body", child_at=at)
    s = m.build()
    chart = s.independent()
    assert chart.dim == TYPES[name]().dof(dim) and chart.quality > WORST
    there_and_back(s, chart)


def test_a_batch_of_parameters():
    s = kempe.load("five_bar")
    chart = s.independent(s.q("closed"))
    u = chart.u(chart.origin) + np.linspace(-0.05, 0.05, 11)[:, None]
    answer = chart.q(u)
    assert answer.q.shape == (11, s.nq) and answer.success.all()
    np.testing.assert_allclose(chart.u(answer.q), u, atol=1e-14)


def test_the_tangent_space_is_the_kernel():
    s = kempe.load("stewart")
    q = s.q("closed")
    N, scale = compute_tangent_space(s, q)
    np.testing.assert_allclose(N.T @ N, np.eye(6), atol=1e-12)
    assert np.abs(closure_rows.compute_jacobian(s, q) @ (scale[:, None] * N)).max() < 1e-12


def test_preferred_coordinates_come_first_or_are_refused():
    s = kempe.load("five_bar")
    q = s.q("closed")
    for pair in (("A", "D"), ("A", "B"), ("B", "C")):
        if set(pair) <= set(s.structure.velocity_names):
            assert set(s.independent(q, prefer=pair).independent) == set(pair)
    assert "A" in s.independent(q, prefer=["A"]).independent
    with pytest.raises(
        InputError,
        match="3 coordinates are preferred; q has 2 degrees of freedom here, so prefer at most 2",
    ):
        s.independent(q, prefer=s.structure.velocity_names[:3])
    with pytest.raises(UnknownNameError):
        s.independent(q, prefer=["nobody"])
    with pytest.raises(InputError, match="does not close the loops"):
        s.independent(q + 0.1)


def test_a_chart_fails_at_a_dead_point_and_another_takes_over():
    """A double rocker's crank cannot be set where coupler and rocker are in line: cosine law."""
    a = 0.4
    b = 0.15
    c = 0.3
    d = 0.5
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
        answer = s.assemble(
            {"A": extreme - gap},
            start=s.q({"A": extreme - gap, "B": -1.5, "D": 2.0}),
            budget=kempe.Budget(starts=50),
        )
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
    assert not s.assemble({"A": extreme + 1e-3}, budget=kempe.Budget(starts=30))


def test_open_chains_have_their_own_coordinates():
    s = kempe.load("puma560")
    chart = s.independent(s.mid)
    assert chart.independent == s.structure.velocity_names and chart.quality == pytest.approx(1.0)
    assert str(chart).startswith("6 independent coordinates")


# ---- balls and idle spins

BALLS = {
    "ball": 6,
    "joint_free": 6,
    "joint_spherical": 3,
    "rssr": 2,
    "delta_ss": 9,
    "stewart_sps": 12,
}


@pytest.mark.parametrize("name", some(library.list_models(), 3))
def test_each_shipped_system_has_minimal_coordinates(name):
    """As many as the true freedoms, but where first order has more (singular postures)."""
    s = kempe.load(name)
    start = s.assemble()
    assert start, start.status
    chart = s.independent(start.q)
    assert chart.quality > 0.0 and len(set(chart.independent)) == chart.dim
    report = s.mobility(start.q, local=False)
    if not report.redundant_here:
        assert chart.dim == report.dof and len(chart.idle) in (0, report.idle)


@pytest.mark.parametrize(("name", "p"), BALLS.items())
def test_balls_have_rotation_vectors(name, p):
    s = kempe.load(name)
    chart = s.independent()
    assert chart.dim == p and any(n[-3:] in (".ex", ".ey", ".ez") for n in chart.independent)
    there_and_back(s, chart)


def test_a_rotation_vector_is_that_of_the_closed_form():
    """Rodrigues: the ball turned from the origin about an axis of the child by the vector's length."""
    s = kempe.load("joint_spherical")
    chart = s.independent()
    w = np.array([0.4, -0.9, 0.7])
    angle = np.linalg.norm(w)
    k = w / np.linalg.norm(w)
    K = np.cross(np.eye(3), k)
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    body = s.body_names[-1]
    before = s.fk(chart.origin, body)[:3, :3]
    np.testing.assert_allclose(before.T @ s.fk(chart.q(w).q, body)[:3, :3], R, atol=1e-12)
    assert chart.valid(chart.q(w).q) and not chart.valid(chart.q(3.1 * k).q)
    assert chart.next(chart.q(3.1 * k).q).valid(chart.q(3.1 * k).q)
    assert not chart.q(3.5 * k).success, "a vector longer than half a turn is none of this chart"


@pytest.mark.parametrize(
    ("name", "useful"),
    [
        ("rssr", ("A",)),
        ("delta_ss", ("A1", "A2", "A3")),
        ("stewart_sps", tuple(f"leg{i}" for i in range(1, 7))),
    ],
)
def test_useful_coordinates_come_first(name, useful):
    """What is useful can be given alone; what is idle moves no body that does not spin."""
    s = kempe.load(name)
    chart = s.independent()
    report = s.mobility()
    assert (
        chart.useful == useful
        and chart.independent == (*useful, *chart.idle)
        and len(chart.idle) == report.idle
    )
    u = chart.u(chart.origin)
    u[: len(useful)] += 0.02
    few = chart.q(u[: len(useful)])
    all_ = chart.q(u)
    spinning = {b for f in report.idle_freedoms for b in f.bodies}
    rest = [b for b in s.body_names[1:] if b not in spinning]
    assert few.success and all_.success
    np.testing.assert_allclose(s.fk(few.q, rest), s.fk(all_.q, rest), atol=1e-9)
    J = np.concatenate([s.jacobian(chart.origin, b) for b in rest])
    assert np.abs(J @ chart.tangent(chart.origin)[:, len(useful) :]).max() < 1e-9
    with pytest.raises(InputError, match="and, idle"):
        chart.q(np.zeros(chart.dim + 1))


def test_what_spins_can_be_preferred():
    s = kempe.load("rssr")
    assert s.independent(prefer=["D"]).useful == ("D",)
    chart = s.independent(prefer=["C.ez"])
    assert chart.useful == ("A",) and chart.idle == ("C.ez",)
    with pytest.raises(InputError, match="cannot be set independently"):
        s.independent(prefer=["A", "D"])
    with pytest.raises(UnknownNameError):
        s.independent(prefer=["C.wz"])


def test_velocities_that_lead_nowhere_are_no_coordinates():
    """A pendulum on bars in line: the pendulum alone; its truth is 1, its rank says 2."""
    chart = kempe.load("pendulum_dead_centre").independent()
    assert chart.independent == ("P",) and chart.quality == 1.0
    assert chart.q(2.0).success and chart.tangent(chart.origin).shape == (4, 1)
