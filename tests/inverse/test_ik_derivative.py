"""Derivatives of answers with respect to their targets, against finite differences of solving
again.
"""

from __future__ import annotations

import numpy as np
import pytest

from kempe import System, spatial
from kempe.errors import InputError

HAND = "panda_link7"
H = 1e-5


def moved(X: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """The pose after a small motion, ground axes, at its origin."""
    return spatial.pose(spatial.exp_so3(twist[3:]) @ X[:3, :3], X[:3, 3] + twist[:3])


def difference(
    s: System, X: np.ndarray, q: np.ndarray, twist: np.ndarray, both: bool = True, **options
) -> np.ndarray:
    """dq for a twist by solving again from q, on both sides or on one."""
    ends = [
        s.ik(moved(X, h * twist), HAND, q, tolerance=1e-13, **options)
        for h in ((H, -H) if both else (H, 0.0))
    ]
    assert all(ends)
    return (ends[0].q - ends[1].q) / (2 * H if both else H)


def regular(s: System, q: np.ndarray) -> bool:
    return np.linalg.svd(s.jacobian(q, HAND), compute_uv=False)[-1] > 0.05


def test_six_joints(six):
    for q in six.random(0, 20):
        if regular(six, q):
            X = six.fk(q, HAND)
            answer = six.ik(X, HAND, q)
            D = answer.derivative
            assert D.shape == (6, 6)
            for k, e in enumerate(np.eye(6)):
                np.testing.assert_allclose(
                    D[:, k], difference(six, X, q, e), atol=2e-5 * max(1.0, np.abs(D).max() ** 3)
                )


def test_redundant_arm_moves_least(panda):
    for q in panda.mid + 0.5 * (panda.random(1, 10) - panda.mid):
        if regular(panda, q):
            X = panda.fk(q, HAND)
            D = panda.ik(X, HAND, q).derivative
            for k, e in enumerate(np.eye(6)):
                np.testing.assert_allclose(D[:, k], difference(panda, X, q, e), atol=1e-3)


def test_a_joint_at_its_limit_stays(panda):
    """On the side to which the limit is active, solving again leaves it there, too."""
    checked = 0
    for joint in (0, 2, 4):
        q = 0.5 * panda.mid + 0.3
        q[1] = 0.4
        q[3] = -1.6
        q[5] = 1.9
        q[joint] = panda.upper[joint]
        X = panda.fk(q, HAND)
        J = panda.jacobian(q, HAND)
        answer = panda.ik(X, HAND, q)
        assert answer.q[joint] == panda.upper[joint]
        D = answer.derivative
        assert not D[joint].any()
        np.testing.assert_allclose(J @ D, np.eye(6), atol=1e-9)
        outwards = np.linalg.pinv(J)[joint]
        for e in np.eye(6):
            if abs(outwards @ e) > 1e-3:
                twist = e * np.sign(outwards @ e)
                dq = difference(panda, X, q, twist, both=False)
                np.testing.assert_allclose(
                    dq, D @ twist, atol=1e-3 * max(1.0, np.abs(D).max() ** 2)
                )
                checked += 1
    assert checked > 6


def test_a_joint_that_is_needed_leaves_its_limit(six):
    q = np.array([0.3, 0.4, -1.6, 0.5, 1.9, six.upper[5]])
    D = six.ik(six.fk(q, HAND), HAND, q).derivative
    assert D[5].any()
    np.testing.assert_allclose(six.jacobian(q, HAND) @ D, np.eye(6), atol=1e-9)


@pytest.mark.parametrize("task", ["position", "orientation", "position_axis", "direction"])
def test_tasks_that_ask_for_less(panda, task):
    q = 0.9 * panda.mid + 0.1
    axis = [0.3, -0.5, 0.8]
    X = panda.fk(q, HAND)
    options = {"task": (task, axis)}
    D = panda.ik(X, HAND, q, **options).derivative
    for k, e in enumerate(np.eye(6)):
        np.testing.assert_allclose(D[:, k], difference(panda, X, q, e, **options), atol=1e-3)
    a = X[:3, :3] @ np.array(axis) / np.linalg.norm(axis)
    if task == "direction":
        # a turn about the axis asks for nothing
        np.testing.assert_allclose(D @ [0, 0, 0, *a], 0.0, atol=1e-12)


def test_it_is_that_of_all_solutions(six):
    q = six.mid + 0.2
    X = six.fk(q, HAND)
    every = six.ik_all(X, HAND)
    k = int(np.argmin(np.abs(every.q - q).max(axis=1)))
    np.testing.assert_allclose(six.ik(X, HAND, q).derivative, every.derivative[k], atol=1e-7)


def test_batches_and_failures(panda):
    q = panda.mid + 0.3 * (panda.random(2, 5) - panda.mid)
    X = panda.fk(q, HAND)
    X[2, :3, 3] = 9.0
    many = panda.ik(X, HAND, q)
    D = many.derivative
    assert D.shape == (5, 7, 6) and np.isnan(D[2]).all()
    for i in (0, 1, 3, 4):
        np.testing.assert_allclose(D[i], panda.ik(X[i], HAND, q[i]).derivative, atol=1e-9)
    with pytest.raises(InputError, match="not reached"):
        _ = panda.ik(X[2], HAND).derivative


@pytest.mark.parametrize("task", ["pose", "position", "orientation", "position_axis"])
def test_batches_are_pseudo_inverses_at_limits_and_singularities_too(panda, task):
    """Rows of the Jacobian that the task reads, without coordinates at limits where the others do."""
    q = panda.random(3, 60)
    q[10:30, 4] = panda.upper[4]
    q[20:40, 5] = panda.lower[5]
    q[40:50, 1] = 0.0
    q[40:50, 3] = panda.upper[3]
    q[45:50, 2] = 0.0
    D = panda.ik(panda.fk(q, HAND), HAND, q, task=task).derivative
    rows = {"pose": 6, "position": 3, "orientation": 6, "position_axis": 5}[task]
    first = 3 if task == "orientation" else 0
    for at, given in zip(q, D, strict=True):
        turned = np.kron(np.eye(2), panda.fk(at, HAND)[:3, :3].T)[first:rows]
        J = turned @ panda.jacobian(at, HAND)
        free = (at > panda.lower + 1e-9) & (at < panda.upper - 1e-9)
        same = np.linalg.matrix_rank(J[:, free], 1e-8) == np.linalg.matrix_rank(J, 1e-8)
        wanted = np.linalg.pinv(J * free if same else J, 1e-12) @ turned
        np.testing.assert_allclose(given, wanted, atol=1e-9 * max(1.0, np.abs(wanted).max() ** 2))
