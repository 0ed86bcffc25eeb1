"""Levels of tasks: strict priorities, least values against scipy and closed forms, saddles, long
ways, free bases.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from linkages import planar_arm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.inverse.answer import Reached

HAND = "panda_hand_tcp"


def screw_table(pitch: float, limits: tuple[float, float] | None = None) -> System:
    m = Mechanism("screw table")
    m.helical(
        "screw", m.ground, m.body("nut"), pitch=pitch, **({"limits": limits} if limits else {})
    )
    return m.build()


def solve(
    s: System, *wanted: tasks.Task, start=None, tolerance=None, prefer=None, **budget
) -> Reached:
    answer = s.ik(
        list(wanted), start=start, tolerance=tolerance, prefer=prefer, budget=kempe.Budget(**budget)
    )
    assert isinstance(answer, Reached)
    return answer


# ---- strict priorities


def test_a_soft_task_before_a_hard_one_is_met_with_it_where_both_can_be():
    """Goals are read off one configuration, so both can be met."""
    s = kempe.load("panda")
    for q in s.random(0, 10):
        X = s.fk(q, HAND)
        soft = tasks.Position(HAND, X[:3, 3], weight=1.0, name="soft")
        hard = tasks.Pointing(HAND, X[:3, 2], priority=1, name="hard")
        answer = solve(s, soft, hard, start=s.mid)
        assert answer.success
        np.testing.assert_allclose(s.fk(answer.q, HAND)[:3, 3], X[:3, 3], atol=1e-8)
        np.testing.assert_allclose(s.fk(answer.q, HAND)[:3, 2], X[:3, 2], atol=1e-5)


def test_a_soft_task_between_two_hard_ones_is_met_with_them():
    s = planar_arm(*[1.0] * 4)
    first = tasks.OnPlane("tip", [1.5, 0.0], [1.0, 0.0], name="first")
    between = tasks.OnPlane("tip", [0.0, 1.0], [0.0, 1.0], weight=1.0, name="between")
    last = tasks.Posture({"q1": 0.1}, weight=None, priority=1, name="last")
    answer = solve(s, first, between, last, start=[0.3, 0.4, 0.5, 0.2])
    assert answer.success
    np.testing.assert_allclose(s.fk(answer.q, "tip")[:2, 3], [1.5, 1.0], atol=1e-9)
    np.testing.assert_allclose(answer.q[0], 0.1, atol=1e-9)


def test_a_soft_task_does_not_suffer_for_a_hard_one_behind_it():
    """A target 2 m beyond a stretched arm wants it stretched; the first link shall turn away,
    behind that.
    """
    s = planar_arm(*[1.0] * 3)
    soft = tasks.Position("tip", [5.0, 0.0], weight=1.0, name="soft")
    hard = tasks.Posture({"q1": 0.5}, weight=None, priority=1, name="hard")
    answer = solve(s, soft, hard, start=[0.4, 0.2, -0.3])
    assert not answer.success
    assert answer.errors["soft"][0] == pytest.approx(2.0, abs=1e-6)
    assert answer.errors["hard"][1] == pytest.approx(0.5, abs=1e-3)


def test_a_hard_task_behind_a_soft_one_that_stays_off_holds_in_what_that_leaves():
    """Four links come within 6 m of the line x = 10 where they are stretched along x: the first
    angle is then 0.
    """
    s = planar_arm(*[1.0] * 4)
    soft = tasks.OnPlane("tip", [10.0, 0.0], [1.0, 0.0], weight=1.0, name="soft")
    answer = solve(
        s, soft, tasks.Posture({"q1": 0.0}, weight=None, priority=1), start=[0.3, 0.4, 0.5, 0.2]
    )
    assert answer.success and answer.errors["soft"][0] == pytest.approx(6.0, abs=1e-9)


# ---- least values


def test_soft_mixes_are_as_low_as_scipy_brings_them():
    """From the answer a solver of bounded least squares finds next to nothing lower."""
    s = kempe.load("panda")
    rng = np.random.default_rng(5)
    for _ in range(12):
        near = s.random(rng)
        weight = rng.uniform(0.1, 3.0)
        goal = s.fk(s.random(rng), HAND)[:3, 3] * rng.uniform(1.0, 1.6)
        other = s.fk(s.random(rng), "panda_link4")[:3, 3] * rng.uniform(1.0, 1.6)
        one = tasks.Position(HAND, goal, weight=1.0)
        two = tasks.Position("panda_link4", other, weight=weight)
        answer = solve(s, one, two, start=near, starts=1)

        def miss(q, goal=goal, other=other, weight=weight):
            X = s.fk(q, [HAND, "panda_link4"])
            return np.concatenate([X[0, :3, 3] - goal, math.sqrt(weight) * (X[1, :3, 3] - other)])

        cost = 0.5 * np.sum(miss(answer.q) ** 2)
        bounds = (s.lower, s.upper)
        start = np.clip(answer.q, s.lower + 1e-9, s.upper - 1e-9)
        found = least_squares(miss, start, bounds=bounds, xtol=1e-14, ftol=1e-14, gtol=1e-12)
        assert cost <= found.cost * (1.0 + 1e-3) + 1e-12


@pytest.mark.parametrize("count, away", [(2, 3.0), (3, 4.0)])
def test_an_arm_stretches_towards_what_is_out_of_reach(count, away):
    """The least distance is what the target is farther away than the arm is long."""
    s = planar_arm(*[1.0] * count)
    answer = solve(
        s, tasks.Position("tip", [away, 0.0], weight=1.0), start=np.ones(count), starts=1
    )
    assert answer.position_error == 0.0 and answer.iterations <= 120
    assert next(iter(answer.errors.values()))[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_a_soft_position_is_as_near_as_scipy_comes():
    s = kempe.load("xarm6")
    rng = np.random.default_rng(1)
    frame = s.frame_names[-1]
    for _ in range(6):
        d = rng.normal(size=3)
        x = d / np.linalg.norm(d) * rng.uniform(1.5, 4.0)
        answer = solve(s, tasks.Position(frame, x, weight=1.0))
        low = np.maximum(s.lower, -7.0)
        high = np.minimum(s.upper, 7.0)

        def miss(q, x=x):
            return s.fk(q, frame)[:3, 3] - x

        starts = [np.clip(s.random(rng), low + 1e-6, high - 1e-6) for _ in range(4)]
        best = min(
            least_squares(miss, q, bounds=(low, high), xtol=1e-13, ftol=1e-13).cost for q in starts
        )
        assert np.linalg.norm(miss(answer.q)) <= math.sqrt(2.0 * best) + 1e-3


# ---- saddles


@pytest.mark.parametrize("count, at", [(2, 1.0), (3, 0.3)])
def test_a_stretched_arm_folds_for_a_soft_target_inside(count, at):
    """The gradient vanishes there; the least distance is zero, for the target is within reach."""
    s = planar_arm(*[1.0] * count)
    for more in ({}, {"start": np.zeros(count)}, {"starts": 1}):
        answer = solve(s, tasks.Position("tip", [at, 0.0], weight=1.0), **more)
        np.testing.assert_allclose(s.fk(answer.q, "tip")[:2, 3], [at, 0.0], atol=1e-6)


def test_a_stretched_arm_folds_within_a_hard_task():
    s = planar_arm(*[1.0] * 3)
    line = tasks.OnPlane("tip", [0.0, 0.0], [0.0, 1.0])
    answer = solve(s, line, tasks.Position("tip", [0.3, 0.0], weight=1.0), start=np.zeros(3))
    assert answer.success
    np.testing.assert_allclose(s.fk(answer.q, "tip")[:2, 3], [0.3, 0.0], atol=1e-6)


def test_a_posture_does_not_stay_a_whole_turn_off():
    """The hand is held by a configuration; each of its joints may be a turn away, which changes
    nothing else.
    """
    s = kempe.load("ur5")
    frame = s.frame_names[-1]
    q = 0.3 * s.random(0)
    turned = q - 2.0 * math.pi * np.sign(q)
    answer = solve(s, tasks.Pose(frame, s.fk(q, frame)), tasks.Posture(q), start=turned)
    assert answer.success
    np.testing.assert_allclose(answer.q, q, atol=1e-6)


# ---- long ways


@pytest.mark.parametrize("limits", [None, (-1500.0, 1500.0)])
@pytest.mark.parametrize("z", [0.01, 0.05, 0.2, 1.0, -0.5])
def test_a_ball_screw_turns_as_often_as_it_must(limits, z):
    """The nut rises by the pitch times the angle: 200 turns a metre."""
    pitch = 0.005 / (2.0 * math.pi)
    s = screw_table(pitch, limits)
    answer = solve(s, tasks.Position("nut", (0.0, 0.0, z)))
    assert answer.success and answer.starts == 1 and answer.iterations <= 40
    assert answer.q[0] == pytest.approx(z / pitch, abs=1e-6 / pitch)


# ---- free bases


def flying(frames: int) -> System:
    """A rigid body that flies and the frames 0, 1, ... on it, in general places."""
    m = Mechanism("flying")
    rng = np.random.default_rng(3)
    m.free("base", m.ground, m.body("body"))
    for k in range(frames):
        m.frame(str(k), "body", at=rng.normal(size=3), rpy=rng.normal(size=3))
    return m.build()


@pytest.mark.parametrize(
    "frames, posed", [(1, True), (1, False), (2, False), (3, False), (2, True)]
)
def test_a_rigid_body_that_flies_is_where_it_should_be_at_once(frames, posed):
    """The best fit of goals that a rigid body can meet is exact, also where points leave a turn
    open.
    """
    s = flying(frames)
    rng = np.random.default_rng(4)
    for k in range(10):
        turn = Rotation.random(rng=rng).as_matrix() if k else np.diag([1.0, -1.0, -1.0])
        X = spatial.pose(turn, 100.0 * rng.normal(size=3))
        quaternion = np.roll(Rotation.from_matrix(turn).as_quat(), 1)
        q = s.q(dict(zip(s.coordinate_names, [*X[:3, 3], *quaternion], strict=True)))
        at = [s.fk(q, str(i)) for i in range(frames)]
        kind = [
            tasks.Pose(str(i), Y) if posed else tasks.Position(str(i), Y[:3, 3])
            for i, Y in enumerate(at)
        ]
        answer = solve(s, *kind)
        assert answer.success and answer.starts == 1 and answer.iterations <= 2
        for i, Y in enumerate(at):
            np.testing.assert_allclose(s.fk(answer.q, str(i))[:3, 3], Y[:3, 3], atol=1e-6)


def test_rows_that_need_more_starts_are_the_calls_alone():
    """Random starts are the same for every row, so an answer does not depend on its place in a
    batch.
    """
    s = kempe.load("panda")
    q = s.random(7, 60)
    X = s.fk(q, HAND)
    together = solve(s, tasks.Pose(HAND, X), start=s.mid)
    again = np.flatnonzero(together.starts > 1)
    assert len(again) >= 3
    for i in again[:6]:
        np.testing.assert_array_equal(
            solve(s, tasks.Pose(HAND, X[i]), start=s.mid).q, together.q[i]
        )


def test_what_cannot_be_reached_is_missed_by_as_little_as_must_be_after_few_steps():
    """A target beyond the arm: the closed form of the miss, from one start."""
    s = planar_arm(*[1.0] * 3)
    answer = solve(s, tasks.Position("tip", [0.0, 4.0]), start=[0.3, 0.4, 0.5], starts=1)
    assert not answer.success and answer.iterations <= 60
    assert answer.position_error == pytest.approx(1.0, abs=1e-4)
