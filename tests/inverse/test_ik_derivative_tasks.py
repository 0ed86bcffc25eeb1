"""Derivatives of answers to tasks with respect to their goals, against finite differences of
solving again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from test_ik_step_closed import leg

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.errors import InputError, UnsupportedError

HAND = "panda_link7"
TIGHT = {"tolerance": 1e-10}
Make = Callable[[np.ndarray], list]


def moved(X: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """The pose after a small motion, ground axes, at its origin."""
    return spatial.pose(spatial.exp_so3(twist[3:]) @ X[:3, :3], X[:3, 3] + twist[:3])


def again(
    s: System, make: Make, q: np.ndarray, step: float, direction: np.ndarray, **options
) -> np.ndarray:
    """dq along a direction, by solving again from q on both sides, at two distances (Richardson,
    1911).
    """

    def difference(h: float) -> np.ndarray:
        ends = [s.ik(make(x * h * direction), start=q, **TIGHT, **options) for x in (1.0, -1.0)]
        assert all(ends), ends[0].status
        return s.configuration_space.difference(ends[1].q, ends[0].q) / (2.0 * h)

    return (4.0 * difference(step / 2.0) - difference(step)) / 3.0


def check(
    s: System, make: Make, q: np.ndarray, n: int, step=1e-3, atol=1e-6, label=None, **options
) -> np.ndarray:
    """The derivative of a task's answer for the n directions that `make` takes."""
    answer = s.ik(make(np.zeros(n)), start=q, **TIGHT, **options)
    assert answer.success, answer.status
    D = answer.derivative[label or next(iter(answer.derivative))]
    for k, e in enumerate(np.eye(n)):
        found = again(s, make, answer.q, step, e, **options)
        np.testing.assert_allclose(D[:, k], found, atol=atol * max(1.0, np.abs(found).max() ** 2))
    return D


# ---- hard tasks: trees, loops, couplings


def test_a_redundant_tree_moves_least():
    """In radians and characteristic lengths, as 'nearest' does."""
    s = kempe.load("panda")
    q = s.mid + 0.2
    X = s.fk(q, HAND)
    D = check(s, lambda t: [tasks.Pose(HAND, moved(X, t))], q, 6, prefer="nearest", atol=1e-5)
    np.testing.assert_allclose(D, np.linalg.pinv(s.jacobian(q, HAND)), atol=1e-5)
    plain = s.ik(tasks.Pose(HAND, X), start=q, **TIGHT).derivative
    np.testing.assert_allclose(plain[f"Pose of '{HAND}'"], D, atol=1e-6)


def test_closed_loops():
    s = kempe.load("five_bar")
    q = s.assemble().q
    p = s.fk(q, "tip")[:3, 3]
    D = check(s, lambda t: [tasks.Position("tip", p + [*t, 0.0])], q, 2)
    np.testing.assert_allclose(s.jacobian(q, "tip")[:2] @ D[:, :2], np.eye(2), atol=1e-7)
    platform = kempe.load("stewart")
    q = platform.assemble().q
    X = platform.fk(q, "platform")
    X[:3, 3] += [0.01, 0.02, 0.0]
    check(platform, lambda t: [tasks.Pose("platform", moved(X, t))], q, 6)


def test_loops_with_relations_and_a_freedom_left():
    s = leg()
    q = s.assemble({"motor": 0.8, "rail": 0.1}).q
    x = s.fk(q, "toe")[1, 3]
    plane = lambda t: [tasks.OnPlane("toe", [0.0, x + t[1]], [0.0, 1.0])]  # noqa: E731
    D = check(s, plane, q, 2, prefer="nearest", atol=1e-5)
    np.testing.assert_allclose(s.jacobian(q, "toe")[1] @ D[:, 1], 1.0, atol=1e-7)


def test_gears():
    m = Mechanism("geared", dim=2)
    m.revolute("a", "ground", m.body("u"))
    m.revolute("b", "u", m.body("v"), at=(1, 0))
    m.revolute("c", "v", m.body("w"), at=(0.7, 0))
    m.gear("c", "a", -2.0, 0.3)
    m.frame("tip", "w", at=(0.5, 0))
    s = m.build()
    q = np.array([0.3, 0.9])
    p = s.fk(q, "tip")[:2, 3]
    check(s, lambda t: [tasks.Position("tip", p + t)], q, 2)


# ---- kinds of goals


def test_numbers_and_other_frames():
    s = kempe.load("panda")
    q = s.mid + 0.2
    far = float(np.linalg.norm(s.fk(q, HAND)[:3, 3]))
    D = check(
        s, lambda t: [tasks.OnSphere(HAND, t[:3], far + t[6])], q, 7, prefer="nearest", atol=1e-5
    )
    assert D.shape == (7, 7) and not D[:, 3:6].any()
    X = spatial.inverse(s.fk(q, "panda_link1")) @ s.fk(q, HAND)
    relative = lambda t: [tasks.RelativePose(HAND, "panda_link1", moved(X, t))]  # noqa: E731
    check(s, relative, q, 6, prefer="nearest", atol=1e-4)

    def bend(t):
        return [
            tasks.Posture({"panda_joint2": 0.3 + t[0], "panda_joint4": t[1] - 1.5}, weight=None)
        ]

    D = check(s, bend, q, 2)
    np.testing.assert_allclose(D[[1, 3]], np.eye(2), atol=1e-9)


def test_quaternions():
    s = kempe.load("stewart")
    q = s.assemble().q
    i = s.coordinate_names.index("S1.qw")
    names = s.coordinate_names[i : i + 4]
    held = s.ik(
        tasks.Posture(dict(zip(names, q[i : i + 4], strict=True)), weight=None), start=q, **TIGHT
    )
    D = held.derivative[next(iter(held.derivative))]
    v = (
        s.structure.velocity_names.index("S1.wx")
        if "S1.wx" in s.structure.velocity_names
        else int(s.structure.layout.quaternion_v[0])
    )
    assert D.shape == (s.nv, 3)
    np.testing.assert_allclose(D[v : v + 3], np.eye(3), atol=1e-8)


# ---- soft tasks, what is preferred, what is active


def test_soft_tasks_stay_least():
    """Not by their first derivatives only: the posture stays off, and the null space turns."""
    s = kempe.load("panda")
    q = s.mid + 0.1
    X = s.fk(q, HAND)
    both = lambda t: [tasks.Pose(HAND, moved(X, t)), tasks.Posture(s.mid, priority=1)]  # noqa: E731
    check(s, both, q, 6, step=1e-2, atol=1e-5)
    bent = lambda t: [tasks.Pose(HAND, X), tasks.Posture(s.mid + t, priority=1)]  # noqa: E731
    check(s, bent, q, 7, step=1e-2, atol=1e-5, label="Posture of all coordinates")
    check(s, lambda t: [tasks.Pose(HAND, moved(X, t))], q, 6, step=1e-2, atol=1e-5, prefer="mid")


def test_a_soft_task_out_of_reach():
    """The answer is the nearest point of a circle: closed form."""
    m = Mechanism("pendulum", dim=2)
    m.revolute("a", "ground", m.body("u"))
    m.frame("tip", "u", at=(1, 0))
    s = m.build()
    answer = s.ik(tasks.Position("tip", [3.0, 0.0], weight=1.0), start=[0.1])
    D = answer.derivative["Position of 'tip'"]
    np.testing.assert_allclose(D[0, :3], [0.0, 1.0 / 3.0, 0.0], atol=1e-6)


def test_limits_that_are_active_stay():
    s = kempe.load("panda")
    q = s.mid + 0.2
    q[2] = s.upper[2]
    X = s.fk(q, HAND)
    wish = q + 0.1 * np.eye(7)[2]
    make = lambda t: [tasks.Pose(HAND, moved(X, t)), tasks.Posture(wish, priority=1)]  # noqa: E731
    D = check(s, make, q, 6, step=1e-3, atol=1e-3)
    assert not D[2].any()
    np.testing.assert_allclose(s.jacobian(q, HAND) @ D, np.eye(6), atol=1e-6)


def test_inequalities_at_their_bound_hold():
    m = Mechanism("slides", dim=2)
    m.prismatic("x", "ground", m.body("u"), axis=(1, 0))
    m.prismatic("y", "u", m.body("v"), axis=(0, 1))
    s = m.build()
    wish = tasks.Position("v", [2.0, 0.5], weight=1.0, priority=1)
    wall = tasks.HalfSpace("v", [1.0, 0.0], [-1.0, 0.0])
    answer = s.ik([wall, wish], start=[0.0, 0.0])
    np.testing.assert_allclose(answer.q, [1.0, 0.5], atol=1e-6)
    D = answer.derivative
    np.testing.assert_allclose(D["HalfSpace of 'v'"][:, :2], [[1.0, 0.0], [0.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(D["Position of 'v'"][:, :2], [[0.0, 0.0], [0.0, 1.0]], atol=1e-6)
    inside = s.ik(
        [tasks.HalfSpace("v", [3.0, 0.0], [-1.0, 0.0]), wish], start=[0.0, 0.0]
    ).derivative
    assert not inside["HalfSpace of 'v'"].any()
    np.testing.assert_allclose(inside["Position of 'v'"][:, :2], np.eye(2), atol=1e-6)


# ---- batches and refusals


def test_batches_and_what_is_refused():
    s = kempe.load("panda")
    q = s.mid + 0.2
    p = np.tile(s.fk(q, HAND)[:3, 3], (3, 1))
    p[1] += 9.0
    p[2, 2] -= 0.05
    many = s.ik(tasks.Position(HAND, p), start=q, **TIGHT)
    D = many.derivative[f"Position of '{HAND}'"]
    assert D.shape == (3, 7, 6) and np.isnan(D[1]).all()
    alone = s.ik(tasks.Position(HAND, p[2]), start=q, **TIGHT)
    np.testing.assert_allclose(D[2], alone.derivative[f"Position of '{HAND}'"], atol=1e-8)
    with pytest.raises(InputError, match="do not hold"):
        _ = s.ik(tasks.Position(HAND, p[1]), budget=kempe.Budget(starts=2)).derivative
    with pytest.raises(UnsupportedError, match="one priority"):
        _ = s.ik([tasks.Posture(q), tasks.Posture(q, priority=1)]).derivative
    with pytest.raises(UnsupportedError, match="one priority"):
        _ = s.ik(tasks.Position(HAND, p[0]), prefer="manipulability").derivative
