"""Functions of configurations and poses as constraints: derivatives, what they reach, what is
refused.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from test_loops import closure_of, loop, tree

import kempe
from kempe import System
from kempe import constraints as c
from kempe.equations.task_functions import Whole
from kempe.errors import InputError, UnknownNameError

STEP = 1e-6
NONE: Any = "7"


def check(of: c.Function, s: System, q: np.ndarray, atol: float = 1e-6) -> Whole:
    """Its Jacobian by central differences on the manifold."""
    whole = Whole(s, of)
    for x in q:
        J = whole.compute_jacobian(x)
        assert whole.compute_values(x).shape == (whole.count,) and J.shape == (whole.count, s.nv)
        ends = [
            [whole.compute_values(s.configuration_space.integrate(x, h * e)) for h in (STEP, -STEP)]
            for e in np.eye(s.nv)
        ]
        np.testing.assert_allclose(
            J, np.stack([(a - b) / (2 * STEP) for a, b in ends], axis=-1), atol=atol
        )
    return whole


def analytic(q):
    return [np.sin(q[0]) * q[2] + q[1] ** 2, q[0] * q[1] * q[3]]


def test_functions_of_q():
    s = tree().build()
    q = s.random(10, 4)
    found = check(c.Function(analytic), s, q)
    assert found.how == "complex step"
    assert check(c.Function(analytic, found.compute_jacobian), s, q).how == "supplied"
    for function in (
        lambda x: s.fk(x, "a")[:3, 3],  # refuses complex numbers
        lambda x: abs(x[0]) + np.conj(x[1]),  # takes them, but is not analytic
        lambda x: math.sin(x[0]),
        lambda x: np.array([float(np.real(x[1]))]) ** 2,
    ):
        assert check(c.Function(function), s, q).how == "central differences"
    assert Whole(s, c.Function(lambda x: x[0])).count == 1


def test_differences_agree_with_exact_rows():
    s = loop("revolute", {})
    closure = closure_of(s, "J")
    q = s.random(11)
    rough = Whole(s, c.Function(lambda x: closure.residual(s, x)))
    np.testing.assert_allclose(rough.compute_jacobian(q), closure.jacobian(s, q), atol=1e-8)


@pytest.mark.parametrize("dim", [2, 3])
def test_functions_of_poses_have_the_derivatives_of_what_they_compute(dim):
    """One that branches, against kinds that ask the same: the distance, and a position seen from
    another frame.
    """
    s = tree(dim).build()

    def apart(A, B):
        d = B[:3, 3] - A[:3, 3]
        return [max(float(np.linalg.norm(d)), 0.0) - 0.7, *(A[:3, :3].T @ d)[:dim]]

    mine = Whole(s, c.Function(apart, frames=("a", "b")))
    q = s.random(3, 5)
    judge = [c.Distance("b", "a", 0.7), c.RelativePosition("b", "a", [0.0] * dim)]
    for x in q:
        values = mine.compute_values(x)
        J = mine.compute_jacobian(x)
        error = np.concatenate([np.atleast_1d(kempe.tasks.error(s, k, x)) for k in judge])
        rows = np.concatenate([kempe.tasks.jacobian(s, k, x) for k in judge])
        np.testing.assert_allclose(np.abs(values[0]), np.abs(error[0]), atol=1e-12)
        signs = np.sign(values * error)
        np.testing.assert_allclose(values, signs * error, atol=1e-12)
        np.testing.assert_allclose(J, signs[:, None] * rows, atol=1e-9)


def counted(function):
    """The function, and the list that grows by each call of it."""
    calls: list[int] = []

    def call(*args):
        calls.append(1)
        return function(*args)

    return call, calls


def test_functions_of_poses_are_called_no_more_often_than_those_of_q():
    """One frame has six twists, which are fewer than seven coordinates; of seven frames all
    coordinates count but those of the fingers.
    """
    s = kempe.load("panda")
    q = s.random(6)
    links = [f"panda_link{k}" for k in range(1, 8)]
    far = np.array([0.45, 0.2, 0.3])
    for frames, most in ((links[-1:], 12), (links, 14)):
        of_poses, by_poses = counted(lambda *P: [np.linalg.norm(X[:3, 3] - far) for X in P])
        of_q, by_q = counted(
            lambda x, frames=frames: np.linalg.norm(s.fk(x, frames)[:, :3, 3] - far, axis=-1)
        )
        mine = check(c.Function(of_poses, frames=frames), s, q[None])
        same = Whole(s, c.Function(of_q))
        by_poses.clear()
        by_q.clear()
        np.testing.assert_allclose(
            mine.compute_jacobian(q), same.compute_jacobian(q), rtol=0, atol=1e-9
        )
        assert len(by_poses) == most <= len(by_q)
    X = np.eye(4)
    X[:3, :3] = np.diag([1, -1, -1])
    X[:3, 3] = 0.5, 0.1, 0.35
    bounds = {"low": np.full(7, 0.15), "high": np.full(7, np.inf)}
    by_poses.clear()
    by_q.clear()
    for apart in (c.Function(of_poses, frames=links, **bounds), c.Function(of_q, **bounds)):
        assert s.ik([kempe.tasks.Pose("panda_hand_tcp", X), apart])
    assert 0 < len(by_poses) <= len(by_q)


def test_poses_in_assembly_and_in_ik():
    """A height that branches, in a loop; and a whole pose of a robot."""
    s = kempe.load("four_bar")
    height = c.Function(
        lambda X: X[1, 3] - 0.3 if X[0, 3] > -9.0 else 1.0, frames="coupler_point", name="height"
    )
    answer = s.assemble(also=height)
    assert answer and s.fk(answer.q, "coupler_point")[1, 3] == pytest.approx(0.3, abs=1e-9)
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-9
    band = c.Function(lambda X: X[1, 3], low=0.25, high=0.28, frames="coupler_point")
    answer = s.assemble(also=[band])
    assert answer and 0.25 - 1e-9 < s.fk(answer.q, "coupler_point")[1, 3] < 0.28 + 1e-9
    at = s.assemble(also=c.Function(lambda X: X[1, 3], low=0.3, high=0.3, frames="coupler_point"))
    assert at and s.fk(at.q, "coupler_point")[1, 3] == pytest.approx(0.3, abs=1e-9)
    batch = s.assemble({"A": np.linspace(0.1, 0.4, 3)}, also=lambda q: 0.0 * q[0])
    assert batch.success.all()
    robot = kempe.load("puma560")
    hand = robot.frame_names[-1]
    X = robot.fk(robot.random(3), hand)
    found = robot.ik(c.Function(lambda Y: (Y - X)[:3].ravel(), frames=hand))
    assert found.success and np.abs(robot.fk(found.q, hand) - X).max() < 1e-6


def test_places_of_frames_and_functions_together():
    s = kempe.load("five_bar")
    place = s.fk(s.q("closed"), s.frame_names[-1])[:2, 3]
    answer = s.assemble({s.frame_names[-1]: place}, also=lambda q: q[0] - q[0])
    assert answer and np.abs(s.fk(answer.q, s.frame_names[-1])[:2, 3] - place).max() < 1e-9


def test_wrong_jacobians_are_refused():
    s = tree().build()
    right = Whole(s, c.Function(analytic))
    wrong = np.zeros((2, s.nv))
    wrong[1, 2] = 0.5
    name = s.structure.velocity_names[2]
    said = f"'Function of mine': its Jacobian is wrong: the derivative of row 1 by '{name}'"
    mine = lambda q: analytic(q)  # noqa: E731
    mine.__name__ = "mine"
    for broken, text in (
        (lambda x: right.compute_jacobian(x) + wrong, said),
        (lambda x: np.eye(2), r"shape \(2, 2\)"),
    ):
        with pytest.raises(InputError, match=text):
            Whole(s, c.Function(mine, broken))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (c.Function(lambda q: math.nan), "finite"),
        (c.Function(lambda q: "x"), "must give a number"),
        (c.Function(lambda q: []), "returns no numbers"),
        (c.Function(NONE), "it must be a function of q"),
        (c.Function(NONE, frames="coupler"), r"it must be a function of 1 pose \(4, 4\)"),
        (
            c.Function(lambda X, Y: 0.0, frames="coupler"),
            "is called with 1 pose, of coupler, which it does not take",
        ),
        (c.Function(lambda q: q[0], low=1.0, high=0.0), "leave nothing"),
        (c.Function(lambda q: q[0], weight=1.0), "has a weight, which ik reads of a wish"),
    ],
)
def test_what_is_refused(made, said):
    with pytest.raises(InputError, match=said):
        kempe.load("four_bar").assemble(also=made)


def test_frames_that_do_not_exist():
    with pytest.raises(UnknownNameError, match="no frame 'couplr'; did you mean 'coupler'"):
        kempe.load("four_bar").assemble(also=c.Function(lambda X: X[0, 3], frames=["couplr"]))
    with pytest.raises(UnknownNameError, match="no frame 'nowhere'"):
        kempe.load("puma560").ik(c.Function(lambda X: X[0, 3], frames=["nowhere"]))
