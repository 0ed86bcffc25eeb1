"""What the numerical inverse model claims: tolerances, reasons, answers that depend on nothing but
the question.
"""

from __future__ import annotations

import numpy as np
import pytest
from linkages import planar_arm

import kempe
from kempe import Mechanism, spatial
from kempe.errors import InputError
from kempe.status import Status

# ---- tolerance


@pytest.mark.parametrize("name, limit", [("so101", 0.05), ("youbot", 0.05)])
def test_a_loose_tolerance_is_used_where_the_target_itself_cannot_be_reached(name, limit):
    """Five joints, poses turned off what they reach: the configuration they were made from is
    within the tolerance.
    """
    robot = kempe.load(name)
    frame = robot.frame_names[-1]
    q = robot.random(0, 60)
    X = robot.fk(q, frame)
    Y = X.copy()
    Y[:, :3, :3] = X[:, :3, :3] @ spatial.rot_x(limit)
    s = robot.ik(Y, frame, start=q, tolerance=(1e-4, 1.2 * limit))
    assert s.success.all()
    Z = robot.fk(s.q, frame)
    assert np.linalg.norm(Z[:, :3, 3] - Y[:, :3, 3], axis=1).max() <= 1e-4
    turn = spatial.log_so3(np.swapaxes(Z[:, :3, :3], 1, 2) @ Y[:, :3, :3])
    assert np.linalg.norm(turn, axis=1).max() <= 1.2 * limit
    assert not robot.ik(Y, frame, start=q).success.any()  # to a millionth nothing is


def test_a_tolerance_finer_than_rounding_is_said_to_be():
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(3), "tool")
    s = robot.ik(X, "tool", tolerance=1e-18)
    assert not s and "finer than rounding" in s.status and "blocked" not in s.status


# ---- answers depend on the question only


@pytest.mark.parametrize("seeded", [False, True])
def test_a_target_has_one_answer_wherever_it_stands_in_a_batch(seeded):
    robot = kempe.load("panda")
    frame = robot.frame_names[-1]
    X = robot.fk(robot.random(0, 300), frame)
    seed = robot.random(7) if seeded else None
    whole = robot.ik(X, frame, seed)
    back = robot.ik(X[::-1], frame, seed)
    assert np.array_equal(whole.q, back.q[::-1]) and np.array_equal(whole.starts, back.starts[::-1])
    for i in range(0, 300, 11):
        assert np.array_equal(robot.ik(X[i], frame, seed).q, whole.q[i])
        assert np.array_equal(robot.ik(X[i : i + 7], frame, seed).q, whole.q[i : i + 7])


@pytest.mark.parametrize("many", [False, True])
def test_an_answer_keeps_its_target(many):
    """A buffer that is used again does not change what was said of it."""
    robot = kempe.load("puma560")
    near = robot.fk(robot.random(1), "tool")
    X = np.tile(near, (2, 1, 1)) if many else near.copy()
    X[..., 0, 3] += 9.0
    far = X.copy()
    robot.ik(X, "tool")
    s = robot.ik(X, "tool")
    X[...] = near
    said = s.status[0] if many else s.status
    assert said == (robot.ik(far, "tool").status[0] if many else robot.ik(far, "tool").status)
    assert "by at least 0 m" not in said and np.array_equal(np.squeeze(s.problem.targets), far)


def test_rounds_of_starts_are_one_sequence():
    """What is found after the first round is what one search of as many starts would have found."""
    robot = kempe.load("so101")
    frame = robot.frame_names[-1]
    X = robot.fk(robot.random(0, 3000), frame)
    s = robot.ik(X, frame, task="position_axis")
    hard = np.flatnonzero(s.starts > 30)
    assert s.success.all() and len(hard) > 5
    for i in hard:
        n = int(s.starts[i])
        again = robot.ik(X[i], frame, task="position_axis", budget=kempe.Budget(starts=n))
        assert np.array_equal(again.q, s.q[i]) and again.starts == n


# ---- reasons


def test_too_few_starts_are_no_blocking_limits():
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(0, 300), "tool")
    s = robot.ik(X, "tool", budget=kempe.Budget(starts=1))
    failed = np.flatnonzero(~s.success)
    assert len(failed) > 20 and robot.ik(X[failed], "tool").success.all()
    assert all("more starts find an answer" in x for x in s.status[failed])


def test_a_joint_with_whole_turns_is_never_blamed():
    m = Mechanism("turntable", dim=2)
    m.revolute("table", m.ground, m.body("plate"), limits=(-4.0, 4.0))
    m.prismatic("slide", "plate", m.body("cart"), axis=(1, 0), limits=(0.2, 0.5))
    m.frame("tip", "cart")
    s = m.build().ik([0.0, 0.7], "tip")
    assert s.code in (Status.NOT_FOUND, Status.OUT_OF_REACH) and "'table'" not in s.status
    inner = m.build().ik([0.0, 0.1], "tip")
    assert (
        inner.code == Status.NOT_FOUND
        and "blocked by the limit of 'slide' (all 2" in inner.status
        and inner.proven
    )


def test_a_pose_off_the_plane_is_said_to_be():
    robot = planar_arm(1.0, 0.7, 0.2, limits=[(-3.0, 3.0)] * 3)
    X = robot.fk([0.3, 0.4, -0.2], "tip")
    X[:3, :3] = X[:3, :3] @ spatial.rot_x(0.1)
    s = robot.ik(X, "tip")
    assert not s and s.status.startswith("tilted out of the plane of the system by 0.1 rad")


@pytest.mark.parametrize("height, out", [(0.4, 0.1), (0.0, 1e-3), (2.0, 0.5)])
def test_columns_do_not_weaken_the_proof(height, out):
    """An arm on a column: the shoulder is as far as the axis leaves the point alone, and all that
    counts.
    """
    m = Mechanism("on a column")
    m.revolute("pan", m.ground, m.body("column"), axis=(0, 0, 1))
    m.revolute("lift", "column", m.body("upper"), at=(0, 0, height), axis=(0, 1, 0))
    m.revolute("bend", "upper", m.body("lower"), at=(0.5, 0, 0), axis=(0, 1, 0))
    m.frame("tip", "lower", at=(0.4, 0, 0))
    s = m.build()
    direction = np.array([0.6, 0.0, -0.8])
    found = s.ik(np.array([0.0, 0.0, height]) + (0.9 + out) * direction, "tip")
    assert found.code == Status.OUT_OF_REACH and f"by at least {out:g} m" in found.status
    assert s.ik(np.array([0.0, 0.0, height]) + 0.8999 * direction, "tip")


# ---- wrong input


def test_wrong_input_blames_what_is_wrong():
    flat = planar_arm(1.0, 0.7, limits=[(-3.0, 3.0)] * 2)
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(0), "tool")
    with pytest.raises(InputError, match="direction of the target must be finite and not zero"):
        flat.ik([0.0, 0.0], "tip", task=("direction", (1, 0, 0)))
    with pytest.raises(InputError, match="direction of the target must be finite and not zero"):
        flat.ik([1.0, 1.0, 0.0, 0.0], "tip", task=("position_axis", (1, 0, 0)))
    with pytest.raises(InputError, match="task is .'pose'."):
        robot.ik(X, "tool", task=["pose"])
    for task, words in (("direction", ["a", "b", "c"]), ("orientation", [["a"] * 3] * 3)):
        with pytest.raises(InputError, match="array of real numbers"):
            robot.ik(words, "tool", task=task)
    Y = X.copy()
    Y[0, 3] = 1e155
    with pytest.raises(InputError, match=r"its x is 1e\+155; its size must be below 1e\+100"):
        robot.ik(Y, "tool")
    for _ in range(2):
        with pytest.raises(InputError, match=r"start\['q1'\] is (nan|inf); it must be finite"):
            robot.ik(X, "tool", np.full(6, np.inf))
    m = Mechanism("free")
    m.free("float", m.ground, m.body("hull"))
    with pytest.raises(InputError, match=r"the quaternion at start\[.float.qw.\] is zero"):
        m.build().ik(np.eye(4), "hull", start=np.zeros(7))


# ---- paths, steps, derivatives


def test_a_path_names_the_target_that_is_no_pose_and_a_seed_that_is_none():
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(0), "tool")
    P = np.tile(X, (3, 1, 1))
    with pytest.raises(InputError, match=r"start\['q1'\] is (nan|inf); it must be finite"):
        robot.ik_path(P, "tool", np.full(6, np.nan))
    P[1] = X.T
    with pytest.raises(InputError, match=r"targets\[1\] is not a pose"):
        robot.ik_path(P, "tool")


def test_a_path_with_restarts_begins_where_it_can():
    robot = planar_arm(1.0, 0.7, limits=[(-3.0, 3.0)] * 2)
    p = np.stack([np.linspace(2.2, 1.2, 11), np.full(11, 0.1)], axis=1)
    path = robot.ik_path(p, "tip", restart=True)
    reachable = np.linalg.norm(p, axis=1) < 1.7
    assert (
        np.array_equal(path.success, reachable)
        and "no answer was found for targets 0 to" in path.status
    )
    assert not robot.ik_path(p, "tip").success.any()


@pytest.mark.parametrize("size", [1.0, 0.1, 0.03, 1e-3])
def test_a_step_of_a_small_robot_is_that_of_a_large_one(size):
    robot = planar_arm(size, size, limits=[(-3.0, 3.0)] * 2)
    wanted = np.array([0.5 * size, 0.2 * size, 0.0, 0.0, 0.0, 0.0])
    step = robot.ik_step([0.3, 1.4], wanted, "tip", 0.01, weights=[1, 1, 0, 0, 0, 0])
    np.testing.assert_allclose(step.twist[:2], wanted[:2], rtol=1e-9)


def test_joints_without_room_have_no_derivative():
    robot = planar_arm(1.0, 0.7, limits=[(0.3, 0.3)] * 2)
    s = robot.ik(robot.fk([0.3, 0.3], "tip")[:2, 3], "tip")
    assert s.success and not s.derivative.any()


@pytest.mark.parametrize(
    "task, m", [("pose", 6), ("position", 3), ("position_axis", 5), ("orientation", 3)]
)
def test_freedoms_that_a_target_leaves_are_counted(task, m):
    """The lecture's m and n: rank and null space are those of the Jacobian's rows that count."""
    robot = kempe.load("panda")
    frame = robot.frame_names[-1]
    s = robot.ik(robot.fk(robot.random(2), frame), frame, task=task)
    assert (s.m, s.n, s.rank, s.redundancy) == (m, 7, m, 7 - m)
    rows = {"pose": 6, "position": 3, "position_axis": 5, "orientation": 6}[task]
    J = robot.jacobian(s.q, frame, "body")[3 if task == "orientation" else 0 : rows]
    assert s.self_motion.shape == (7, 7 - m) and np.abs(J @ s.self_motion).max() < 1e-9
    with pytest.raises(InputError, match="one answer"):
        _ = robot.ik(robot.fk(robot.random(2, 3), frame), frame).redundancy
    flat = planar_arm(1.0, 0.7, 0.2, 0.3, limits=[(-3.0, 3.0)] * 4)
    t = flat.ik(flat.fk([0.3, 0.4, -0.2, 0.1], "tip"), "tip")
    assert (t.m, t.n, t.redundancy) == (3, 4, 1)


# ---- near misses


@pytest.mark.parametrize("size", [1.0, 1e-3])
@pytest.mark.parametrize("gap", [3e-8, 3e-7, 3e-5])
def test_a_near_miss_is_said_to_be_one(size, gap):
    """Beyond the reach of an arm whose links do not lie on one line, so that their lengths prove
    nothing.
    """
    m = Mechanism("arm")
    m.revolute("yaw", m.ground, m.body("base"), axis=(0, 0, 1))
    m.revolute("shoulder", "base", m.body("upper"), axis=(0, 1, 0))
    m.revolute("elbow", "upper", m.body("lower"), at=(0.5 * size, 0, 0), axis=(0, 1, 0))
    m.frame("tip", "lower", at=(0.4 * size, 0.3 * size, 0))
    s = m.build()
    x = s.fk(np.array([0.3, 0.4, 0.0]), "tip")[:3, 3]
    answer = s.ik(x * (1.0 + gap / np.linalg.norm(x)), "tip", tolerance=1e-9)
    assert not answer.success and answer.position_error == pytest.approx(gap, rel=1e-6)
    status = str(answer.status)
    if gap > 1e-6:
        assert "no configuration was found" in status and "ended early" not in status
    else:
        reason = (
            "at so small a scale" if size < 1.0 else "or the target is just outside the workspace"
        )
        assert (
            f"the search came within {gap:.0e} m" in status and "it may have ended early" in status
        )
        assert reason in status and "no configuration was found" not in status
