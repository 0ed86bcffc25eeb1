"""Parts of the analysis of mobility, each where its answer is known by hand: series of joints,
forms, steps, ranks.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.assemble.generic_configurations import sample_nearby_ranks
from kempe.equations.velocity import record_tangent_rows
from kempe.first_order.constraint_graph import build_constraint_graph
from kempe.first_order.idle_freedoms import find_common_point, find_spin_groups
from kempe.first_order.rank import compute_rank
from kempe.first_order.redundant_constraints import REACTIONS, _choose_releases, _JointReaction
from kempe.mobility import dof_proofs
from kempe.mobility.classify import EvaluationPoint, sample_nearby_point
from kempe.mobility.dof_proofs import split_rows
from kempe.mobility.growth_vectors import _compute_null_space
from kempe.mobility.local_dimension import RADII, Spot, _drop_repeated_halves, find_local_dimension
from kempe.mobility.local_equations import Equations
from kempe.mobility.mobility import mobility
from kempe.numerics.rank import Level

EYE = np.eye(3)


def turns(*lines) -> np.ndarray:
    """Twists (6, k) of turns about lines, each a point and a direction."""
    return np.array([(*np.cross(p, w), *w) for p, w in lines]).T


def test_hinges_are_a_ball_if_their_axes_meet_in_one_point():
    rng = np.random.default_rng(0)
    for _ in range(20):
        point = rng.normal(size=3)
        axes = rng.normal(size=(3, 3))
        lines = [(point + d * w, w) for d, w in zip(rng.normal(size=3), axes, strict=True)]
        for count in (2, 3):
            np.testing.assert_allclose(find_common_point(turns(*lines[:count])), point, atol=1e-9)
        aside = lines[2][0] + 1e-3 * np.cross(axes[0], axes[1])
        assert find_common_point(turns(*lines[:2], (aside, axes[2]))) is None
    assert find_common_point(turns(lines[0])) is None
    assert find_common_point(turns(lines[0], (lines[0][0] + 1.0, lines[0][1]))) is None


def test_what_has_no_direction_is_released_before_turns():
    rows = [
        _JointReaction("J", label, False, None, np.ones(1))
        for label in (REACTIONS["x"], REACTIONS["rx"], "law")
    ]
    assert _choose_releases(rows, 1) == [[rows[2]]] and _choose_releases(rows[:2], 1) == [[rows[1]]]


@pytest.mark.slow
def test_a_joint_that_can_make_every_motion_holds_nothing():
    m = Mechanism("table")
    plate = m.body("plate")
    for k, x in enumerate((0.0, 0.4, 1.0)):
        rod = m.body(f"rod {k}")
        m.spherical(f"A{k}", m.ground, rod, at=(x, 0.2, 0.0))
        m.spherical(f"B{k}", rod, plate, at=(0.1, 0.2, 1.0), child_at=(x, 0.0, 0.0))
    m.free("F", m.ground, plate)
    system = m.build()
    edges = [e.name for e in build_constraint_graph(system).edges]
    at = compute_rank(system, mobility(system).q).screws
    plates = [g for g in find_spin_groups(system, at, frozenset(), False) if len(g.ends) == 4]
    assert [edges[e.steps[0].edge] for e in plates[0].ends if e.free] == ["F"]
    motor = frozenset([system.structure.velocity_names.index("F.x")])
    assert all(len(g.ends) == 2 for g in find_spin_groups(system, at, motor, False))


def test_a_regular_configuration_has_one_neighbour():
    s = kempe.load("four_bar")
    regular = compute_rank(s, s.assemble({"A": 1.0}).q)
    assert (
        regular.n_dependent == 0
        and len(sample_nearby_ranks(s, regular, np.random.default_rng(0))) == 1
    )


# ---- local dimensions


def test_half_branches_that_are_shaky_and_next_to_each_other_are_one():
    def left(delta: int, offset: float) -> int:
        split: Any = SimpleNamespace(delta=delta)
        ends = [np.array(RADII)[:, None] * np.array([1.0, x]) for x in (0.0, offset)]
        return len(_drop_repeated_halves([Spot(x, split) for x in ends]))

    assert (left(2, 0.0), left(2, 0.9), left(1, 0.0)) == (1, 2, 2)


def test_rates_that_are_none_of_a_bennett_linkage(monkeypatch):
    """Its own are recognised; where opposite joints turn the other way against each other nothing
    stays closed.
    """
    calls = []
    whole = dof_proofs.is_half_angle_motion
    monkeypatch.setattr(
        dof_proofs, "is_half_angle_motion", lambda *given: calls.append(given) or whole(*given)
    )
    system = kempe.load("bennett")
    find_local_dimension(system, system.q("closed"))
    ((equations, q, axes, places, rates),) = calls
    assert whole(equations, q, axes, places, rates)
    for turned in (places[2:], places[3:]):
        other = rates.copy()
        other[list(turned)] *= -1.0
        assert not whole(equations, q, axes, places, other)


def test_singular_values_count_by_their_part_of_the_largest():
    J = np.array([[1e3, 0.0, 0.0], [0.0, 1e-4, 0.0]])
    here = split_rows(np.zeros(3), J, np.eye(2), np.arange(3))
    assert (here.split.delta, here.split.corank) == (2, 1)
    np.testing.assert_allclose(J @ here.split.null_space, 0.0, atol=1.1e-4)


def slides(law: str) -> kempe.System:
    m = Mechanism("slides", dim=2)
    m.prismatic("x", m.ground, m.body("a"), axis=(1.0, 0.0))
    m.prismatic("y", "a", m.body("b"), axis=(0.0, 1.0))
    m.equation("law", law, of=("x", "y"))
    return m.build()


@pytest.mark.parametrize(
    ("law", "ends"),
    [
        ("y^2 - x^3", [(2, True)]),
        ("y^2 - x^2*(1 + x)", [(2, False)] * 2),
        ("x^3 - 3*x*y^2", [(2, False)] * 3),
        ("x^3 - 3*x*y^2 + 1e-20*(x^2 + y^2)", [(2, False)] * 3),
        ("x^2 + y^2", []),
    ],
)
def test_branches_of_one_equation(law, ends):
    """A cusp, a node, three lines, and these up to far below rounding; a point."""
    found = find_local_dimension(slides(law), [0.0, 0.0])
    assert (
        [(b.ends, b.cusp) for b in found.branches] == ends
        and found.dim == bool(ends)
        and not found.more
    )


def test_a_quadratic_form_counts_branches_only_where_no_direction_is_lost(monkeypatch):
    """Nor do forms that are far below rounding count any."""
    found = []
    whole = dof_proofs.decide_dimension
    monkeypatch.setattr(
        dof_proofs, "decide_dimension", lambda *given: found.append(whole(*given)) or found[-1]
    )
    for law in ("y^2 - x^3", "y^2 - x^2*(1 + x)", "x^3 - 3*x*y^2 + 1e-20*(x^2 + y^2)", "x^2 + y^2"):
        find_local_dimension(slides(law), [0.0, 0.0])
    assert [x[:2] for x in found] == [(1, None), (1, 2), (1, None), (0, 0)]


@pytest.mark.parametrize("far", [1.1, 0.93])
def test_a_step_leads_towards_a_sphere_from_outside_and_from_inside(far):
    equations = Equations(slides("y"))
    center = np.array([[0.3, 0.0]]) * equations.length
    radii = np.ones(1)
    q = center + equations.length * far * np.array([[1.0, 0.0]])
    q = equations._take_step(
        equations._project_points(q, center, radii, 0), center, radii, Level.ROUNDING
    )
    assert np.linalg.norm(q - center) / equations.length == pytest.approx(1.0, abs=0.006)


# ---- mobility


def test_the_gap_is_between_the_last_singular_value_that_counts_and_the_next():
    A = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 1e-2, 0.0, 0.0], [1.0, 2e-2, 1e-12, 0.0]])
    values = np.linalg.svd(A / np.linalg.norm(A, axis=1, keepdims=True), compute_uv=False)
    rows: Any = SimpleNamespace(units=np.ones(4), names=[SimpleNamespace(written=True)] * 3)
    found = _compute_null_space(rows, np.zeros(4), 0.0, np.arange(3), A, 1e-15)
    assert found.dimension == 2 and found.gap == pytest.approx(values[1] / values[2], rel=1e-2)


@pytest.mark.parametrize("length", [100.0, 0.01])
def test_random_places_are_as_far_away_as_links_are_long(length):
    m = Mechanism("cross", dim=2)
    m.prismatic("x", m.ground, m.body("a"), axis=(1.0, 0.0), at=(length, 0.0))
    m.prismatic("y", "a", m.body("b"), axis=(0.0, 1.0), at=(0.0, length))
    m.velocity_equation("w", [[0.0, 0.0]], of=("x", "y"))
    rows = record_tangent_rows(m.build())
    assert rows.units[:2] == pytest.approx([length, length], rel=0.5)
    place = EvaluationPoint(rows, np.zeros(2), 0.0, (), lambda q: q)
    rng = np.random.default_rng(0)
    found = np.array([sample_nearby_point(place, rng).q for _ in range(200)]) / rows.units[:2]
    assert np.sqrt((found**2).mean(axis=0)) == pytest.approx([0.7, 0.7], rel=0.2)


def test_a_report_names_the_joints_of_each_group_of_loops():
    m = mobility(kempe.load("four_bar"))
    (group,) = m.clusters
    assert (sorted(group.joints), group.loops) == (["A", "B", "C", "D"], ("C",))
    assert str(m).startswith("four_bar")


@pytest.mark.parametrize(
    ("name", "kind"),
    [("four_bar", ""), ("shaky_3r", "shaky: it can move to first order, but is rigid")],
)
def test_kinds_of_configurations(name, kind):
    assert mobility(kempe.load(name)).kind == kind
