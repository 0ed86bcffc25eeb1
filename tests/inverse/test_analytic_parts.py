"""Parts of `ik_all`, each against a formula of its own: rotation vectors, descents, planes,
samples, joints held.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

import kempe
from kempe.inverse import families, spare_joints
from kempe.inverse.all_answer import Solutions
from kempe.inverse.arm_angle import compute_reference_direction
from kempe.inverse.closed_forms import descent
from kempe.inverse.closed_forms import plan as choice
from kempe.inverse.closed_forms.plan import sample_variables
from kempe.inverse.explain_all import ROW
from kempe.inverse.families import SolutionSet
from kempe.kernels.forward.table_layout import SLIDE

AXES = ([0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [1.0, -2.0, 0.5], [-0.3, 0.2, 0.9])


ANGLES = (0.0, 1e-12, 1e-4, 0.05, 0.2, 1.0, math.pi / 2 - 1e-8, 1.7, 2.9, 3.1)


def test_rotation_vectors():
    """Each alone: a batch has one formula for all."""
    v = np.array(
        [angle * np.array(axis) / np.linalg.norm(axis) for angle in ANGLES for axis in AXES]
    )
    found = np.concatenate(
        [descent._compute_rotation_vectors(R[None]) for R in Rotation.from_rotvec(v).as_matrix()]
    )
    np.testing.assert_allclose(found, v, rtol=1e-11, atol=1e-15)


def linear(A: np.ndarray, b: np.ndarray) -> Any:
    """An aim whose errors are b - A x."""
    n = A.shape[1]
    return SimpleNamespace(
        moves=np.arange(n),
        linearise_errors=lambda x: (b - x @ A.T, np.broadcast_to(A, (len(x), *A.shape))),
    )


@pytest.mark.parametrize("weak", [1.0, 1e-3, 1e-4])
def test_a_descent_ends_in_the_least_squares_solution_however_badly_it_is_conditioned(weak):
    A = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 + weak, 0.0], [0.0, 0.0, 1.0], [0.5, 0.5, 0.5]])
    x = np.array([0.3, -0.2, 0.4])
    across = np.linalg.svd(A)[0][:, 3]
    free = np.full(3, math.inf)
    found = descent.run_descent(linear(A, A @ x + 0.01 * across), np.zeros((2, 3)), -free, free)
    np.testing.assert_allclose(found, [x, x], atol=1e-7)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_descent_leaves_joints_at_the_limits_on_which_they_press(sign):
    """Against bounded least squares; the gradients are small, the joints far from independent."""
    A = np.array([[1.0, 0.9], [0.9, 1.0]])
    b = sign * np.array([0.05, -0.04])
    low, high = (-1.0, 0.0) if sign > 0.0 else (0.0, 1.0)
    low = np.array([low, -1.0])
    high = np.array([high, 1.0])
    expected = lsq_linear(A, b, (low, high), tol=1e-14).x
    assert expected[0] == pytest.approx(0.0, abs=1e-9)
    found = descent.run_descent(linear(A, b), np.zeros((1, 2)), low, high)
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


def test_a_configuration_is_polished_onto_its_target():
    """The arm's lines are seen from a point that is far from the ground's origin."""
    arm = kempe.load("puma560")
    q = np.array([0.3, -0.7, 0.4, 0.5, 0.9, -0.2])
    answer = arm.ik_all(arm.fk(q, "tool"), "tool")
    assert np.abs(answer.plan.lines.origin).max() > 0.1
    none: Any = None
    target = spare_joints._Targets(
        answer.problem, answer.plan, none, none, none, none, none, none, None
    )
    found, error = target._polish_configuration(0, q + 1e-3, True)
    assert error < 1e-9 and np.abs(found - q).max() < 1e-8


def test_random_samples_of_a_chain_turn_to_any_angle_and_slide_as_far_as_it_is_long():
    arm = kempe.load("stanford")
    lines = arm.ik_all(arm.fk(arm.mid, "tool"), "tool").plan.lines
    most = np.abs(sample_variables(lines, np.random.default_rng(0), 1000)).max(axis=0)
    slides = lines.kinds == SLIDE
    assert slides.any() and (0.9 < most[slides]).all() and (most[slides] <= 1.0).all()
    assert (3.0 < most[~slides]).all() and (most[~slides] <= math.pi).all()


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ((-1.0, 1.0), 0.4),
        ((0.0, 1.0), 0.4),
        ((-1.0, 0.0), -0.4),
        ((0.1, 0.2), 0.2),
        ((-0.3, -0.2), -0.3),
    ],
)
def test_where_axes_line_up_joints_are_held_aside_of_zero_inside_the_limits(
    limits, expected, monkeypatch
):
    arm = kempe.load("puma560")
    lines = arm.ik_all(arm.fk(arm.mid, "tool"), "tool").plan.lines
    lines = replace(
        lines, limits=np.tile(np.array(limits)[:, None], 6), multiplier=np.full(6, -1.0)
    )
    counts = iter([3, 0])  # at zero, elsewhere
    monkeypatch.setattr(choice, "_count_aligned_joints", lambda plan, theta: next(counts))
    plan: Any = SimpleNamespace(lines=lines, method=choice.ELIMINATION, locked=(2,))
    assert choice._choose_held_values(plan, ()) == (expected,) * 6


X, Y, Z = np.eye(3)
OBLIQUE = np.array([0.95, math.sqrt(1.0 - 0.95**2), 0.0])


@pytest.mark.parametrize(
    ("z", "v", "expected"),
    [
        (Z, X, Z),
        (Z, OBLIQUE, Z),
        (Z, Z, X),
        (Z, -Z, X),
        (X, X, Y),
        (Y, Y, X),
        (OBLIQUE, OBLIQUE, np.array([-OBLIQUE[1], OBLIQUE[0], 0.0])),
        (X, 0.6 * X + 0.8 * Z, 0.8 * X - 0.6 * Z),
    ],
)
def test_the_plane_from_which_arm_angles_count(z, v, expected):
    np.testing.assert_allclose(
        compute_reference_direction(z, np.stack([v, v])), [expected, expected], atol=1e-15
    )


def test_rounded_rotations_of_a_batch_are_mended():
    arm = kempe.load("puma560")
    targets = arm.fk(arm.random(3, 4), "tool")
    given = targets.copy()
    given[1:, :3, :3] = targets[1:, :3, :3].round(5)
    U, _, Vt = np.linalg.svd(given[1:, :3, :3])
    targets[1:, :3, :3] = U @ Vt
    with pytest.warns(UserWarning, match="in 3 of 4 cases; the nearest rotation was taken"):
        found = arm.ik_all(given, "tool")
    expected = arm.ik_all(targets, "tool")
    assert found.mask.any(axis=1).all()
    np.testing.assert_allclose(found.q, expected.q, atol=1e-12)


def test_families_are_not_looked_for_where_nothing_is_singular(monkeypatch):
    arm = kempe.load("puma560")
    q = np.array([0.3, -0.7, 0.4, 0.5, 0.9, -0.2])
    calls = []
    row = replace(ROW, families=lambda *given: calls.append(given) or ROW.families(*given))
    monkeypatch.setattr(Solutions, "_row", row)
    assert arm.ik_all(arm.fk(q, "tool"), "tool").families == [] and not calls
    q[4] = 0.0  # the axes of the wrist line up
    assert arm.ik_all(arm.fk(q, "tool"), "tool").families and calls


def test_nothing_is_left_out_where_there_was_room():
    arm = kempe.load("puma560")
    answer = arm.ik_all(arm.fk([0.3, -0.7, 0.4, 0.5, 0.0, -0.2], "tool"), "tool")
    assert families._read_left_out_samples(answer, 0).shape == (0, 6)


def test_curves_cross_where_the_second_singular_value_vanishes():
    """It is the distance from 0.47 along a straight curve, and nowhere near zero at its other ends."""
    x = np.linspace(0.0, 1.0, 9)
    theta = np.stack([x, 0.0 * x], axis=1)
    way = np.tile([1.0, 0.0], (9, 1))
    chain: Any = SimpleNamespace(
        aim=SimpleNamespace(moves=np.arange(2)),
        minimise_error=lambda p, t: SimpleNamespace(x=p, J=p),
        evaluate_batch=lambda p: (None, p),
        decompose_jacobians=lambda p: (
            np.abs(np.stack([0.0 * p[..., 0], p[..., 0] - 0.47], axis=-1)),
            None,
        ),
    )
    (crossing,) = SolutionSet.find_crossings(chain, theta, way[:, None])
    np.testing.assert_allclose(crossing, [0.47, 0.0], atol=1e-6)
