"""Motions between configurations, each judged by itself: closed, within limits, in short steps,
without a jump.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from linkages import four_bar
from polygons import polygon

import kempe
from kempe import Budget, Mechanism, Status
from kempe.equations.judge import judge_configurations
from kempe.errors import InputError
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.spaces.polygons import find_polygon


def connects(
    system: kempe.System, found: Any, q0: np.ndarray, q1: np.ndarray, step: float = 0.1
) -> bool:
    """Whether a motion leads from q0 to q1 on all constraints and within all limits, without a
    jump.

    Between any two points the nearest closed configuration to the middle lies between them, and so
    it does between these, three times over.
    """
    space = system.configuration_space
    assert bool(found) and found.code is Status.SOLVED and not found.step > step
    assert space.distance(found.q[0], q0) < 1e-7 and space.distance(found.q[-1], q1) < 1e-7
    q = found.q
    length = compute_characteristic_length(system)
    low, high = system.structure.limits[system.structure.layout.vector_v].T
    for _ in range(3):
        assert np.all(judge_configurations(system, q).holds)
        x = q[:, system.structure.layout.vector_q]
        assert (x >= low - 1e-9).all() and (x <= high + 1e-9).all()
        far = space.distance(q[:-1], q[1:])
        assert far.max() <= step * max(1.0, length) + 1e-9
        half = space.interpolate(q[:-1], q[1:], 0.5)
        closed = (
            system.assemble(start=half, prefer="nearest").q if system.structure.closures else half
        )
        assert (
            space.distance(closed, q[:-1]) + space.distance(closed, q[1:]) <= 1.2 * far + 1e-9
        ).all()
        between = np.empty((2 * len(q) - 1, q.shape[1]))
        between[::2] = q
        between[1::2] = closed
        q = between
        step = 0.75 * step
    return True


def test_a_tree_moves_straight_within_its_limits():
    arm = kempe.load("puma560")
    q0, q1 = arm.random(1, 2)
    found = arm.configuration_space.path(q0, q1)
    assert connects(arm, found, q0, q1) and found.length == pytest.approx(np.linalg.norm(q1 - q0))


def test_four_bars_with_a_crank_stay_on_their_side(hunt):
    """Both assemblies for one angle of the crank: excluded by Grashof's rule; any two of one side
    are joined.
    """
    rng = hunt.rng()
    system = four_bar()
    for _ in range(hunt.cases(4)):
        x, y = rng.uniform(-np.pi, np.pi, 2)
        (a, b) = system.assembly_modes({"A": x}).q
        c = system.assembly_modes({"A": y})
        none = system.configuration_space.path(a, b)
        assert none.code is Status.NONE_EXISTS and "proven" in none.status and not len(none)
        same = [q for q in c.q if np.sign(np.sin(q[2])) == np.sign(np.sin(a[2]))]
        assert len(same) == 1 and connects(
            system, system.configuration_space.path(a, same[0]), a, same[0]
        )


def test_a_rocker_passes_its_dead_points_to_the_other_assembly():
    system = four_bar(0.3, 0.3, 0.4, 0.5)  # 0.3 + 0.5 > 0.3 + 0.4: no link turns fully
    a, b = system.assembly_modes({"A": 0.6}).q
    assert connects(system, system.configuration_space.path(a, b), a, b)


@pytest.mark.slow
def test_bifurcations_are_crossed():
    system = kempe.load("parallelogram")
    a, b = system.assembly_modes({system.coordinate_names[0]: 0.7}).q
    found = system.configuration_space.path(a, b)
    assert "over 1 bifurcation" in found.status and connects(system, found, a, b)


def test_trees_join_the_assemblies_of_a_five_bar():
    system = kempe.load("five_bar")
    for k, q in enumerate(system.assembly_modes({"A": 2.0, "D": 1.0}).q[1:]):
        a = system.assembly_modes({"A": 2.0, "D": 1.0}).q[0]
        found = system.configuration_space.path(a, q, budget=Budget(rng=k, step=0.2))
        assert "random trees" in found.status and connects(system, found, a, q, 0.2)


def test_limits_turn_trees_aside_or_exclude():
    free = kempe.load("five_bar")
    a, b = free.assembly_modes({"A": 2.0, "D": 1.0}).q
    tight = free.with_limits({"A": (1.9, 2.1), "D": (0.9, 1.1)})
    none = tight.configuration_space.path(a, b, budget=Budget(iterations=40))
    assert none.code is Status.NOT_FOUND and "no proof" in none.status
    beyond = free.with_limits({"A": (0.0, 1.0)}).configuration_space.path(a, b)
    assert (
        beyond.code is Status.OUTSIDE_LIMITS
        and "the start q0 is outside the limits of 'A'" in beyond.status
    )


@pytest.mark.slow
def test_cranks_and_rods_with_the_spin_left_out():
    system = kempe.load("rssr")
    found = system.configuration_space.components()
    a, b = (part.paths[0].q[0] for part in found.parts)
    c = found.parts[0].paths[0].q[40]
    none = system.configuration_space.path(a, b)
    assert none.code is Status.NONE_EXISTS and "proven" in none.status
    assert connects(
        system, system.configuration_space.path(a, c, budget=Budget(step=0.3)), a, c, 0.3
    )


def test_two_curves_are_proven_to_be_apart():
    system = kempe.load("slider_crank")
    one, two = (part.paths[0].q for part in system.configuration_space.components().parts)
    a = one[0]
    b = two[0]
    c = one[40]
    none = system.configuration_space.path(a, b)
    assert none.code is Status.NONE_EXISTS and "proven" in none.status
    assert connects(system, system.configuration_space.path(a, c), a, c)


@pytest.mark.slow
def test_curves_without_a_proof_are_not_called_apart():
    system = kempe.load("schatz")
    a, b = (part.paths[0].q[0] for part in system.configuration_space.components().parts)
    none = system.configuration_space.path(a, b)
    assert none.code is Status.NOT_FOUND and "no proof" in none.status


def test_one_sided_constraints_are_gone_around():
    """A point in the plane, with a disc that it must not enter: the straight way would cross it."""
    m = Mechanism("disc", dim=2)
    m.translation("T", m.ground, m.particle("b"), limits={"x": (-2.0, 2.0), "y": (-2.0, 2.0)})
    m.inequality("outside", "T.x*T.x + T.y*T.y - 1")
    system = m.build()
    found = system.configuration_space.path([-1.5, 0.0], [1.5, 0.0])
    assert bool(found) and np.hypot(*found.q.T).min() >= 1.0 - 1e-9
    assert np.linalg.norm(np.diff(found.q, axis=0), axis=1).max() < 0.1 * found.system.nv
    assert found.length >= 2.0 * (np.sqrt(1.5**2 - 1.0) + np.arcsin(1 / 1.5)) / 2.0


@pytest.mark.parametrize(
    ("q0", "said"),
    [([0.0], "needs 4: A, B, C, D"), ([np.nan] * 4, "finite"), ([0.1] * 4, "not closed")],
)
def test_ends_that_are_no_configurations_are_refused(q0, said):
    system = kempe.load("four_bar")
    with pytest.raises(InputError, match=said):
        system.configuration_space.path(q0, system.q("closed"))


def test_late_and_wrong_budgets():
    system = kempe.load("five_bar")
    a, b = system.assembly_modes({"A": 2.0, "D": 1.0}).q
    assert (
        system.configuration_space.path(a, b, budget=Budget(time_limit=1e-9)).code
        is Status.OUT_OF_TIME
    )
    with pytest.raises(InputError, match="step is"):
        system.configuration_space.path(a, b, budget=Budget(step=7.0))


@pytest.mark.slow
def test_random_loops_of_bars_are_joined_where_the_theorem_allows(hunt):
    """Two random configurations are on one side, and a way is found, or on two, and it is proven
    that there is none.
    """
    rng = hunt.rng()
    seen = set()
    for _ in range(hunt.cases(12)):
        system = polygon(rng.uniform(0.1, 1.0, 5).tolist())
        loop = find_polygon(system)
        assert not isinstance(loop, str)
        if loop.count:
            a, b = system.configuration_space.sample(2, rng).q
            found = system.configuration_space.path(a, b)
            seen.add(found.code)
            apart = loop.label_components(a[None])[0] != loop.label_components(b[None])[0]
            assert found.code is Status.NONE_EXISTS if apart else connects(system, found, a, b)
    assert Status.SOLVED in seen
