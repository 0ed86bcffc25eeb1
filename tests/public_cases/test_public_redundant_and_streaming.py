"""Public reports about arms with more joints than the task needs, postures, directions, and steps
in a control loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from public_oracles import (
    PI,
    inside,
    pose_error,
    pose_errors,
    rpy,
    six_errors,
    turn,
    without_limits,
)
from robots import urdf_files
from scipy.optimize import minimize

import kempe
from kempe import Mechanism, System, tasks

# ---- streaming


def test_streaming_comes_back_from_outside_the_limits():
    """pink, issue 206: an angle starts beyond its limit; does the step fail, jump, or lead back
    inside?
    """
    s = kempe.load("panda")
    q = s.mid.copy()
    q[3] = s.upper[3] + 0.2
    X = s.fk(s.mid, "tool")
    for _ in range(200):
        before = q
        q = s.ik_step(q, X, "tool", 0.02, velocity_limits=1.0).q
        assert np.abs(q - before).max() <= 0.02 + 1e-9
    assert (q <= s.upper + 1e-9).all()
    assert pose_error(s.fk(q, "tool"), X) < 1e-4


def test_a_gripper_a_tenth_of_a_millimetre_below_zero_opens():
    """pink, issue 163: the measured opening is 1.3e-4 below the limit."""
    m = Mechanism("gripper")
    m.revolute("a", m.ground, m.body("x"), limits=(-2, 2))
    m.prismatic("p", "x", m.body("y"), axis="x", limits=(0, 0.05))
    s = m.build()
    q = np.array([0.1, -1.28515e-4])
    X = s.fk([0.3, 0.02], "y")
    step = s.ik_step(q, X, "y", 0.01, velocity_limits=1.0)
    assert np.isfinite(step.q).all() and step.q[1] > q[1]
    assert s.ik(X, "y", start=q)


def test_angles_without_limits_do_not_wind_up():
    """mink, issues 103 and 104: are angles above 10000 degrees returned when joints have no limits?"""
    s = kempe.load("ur5")
    free = without_limits(s)
    for seed in range(300):
        answer = free.ik(s.fk(s.random(seed), "tool"), "tool", start=np.zeros(6))
        assert answer and np.abs(answer.q).max() < 4 * PI, seed


@pytest.mark.parametrize("cycles", [300, pytest.param(2000, marks=pytest.mark.slow)])
def test_streaming_to_a_pose_out_of_reach_does_not_wind_up(cycles):
    """mink, issues 103 and 104: the same while a pose three metres away is streamed for 2000
    cycles.
    """
    s = without_limits(kempe.load("ur5"))
    q = np.array([0, -1, 1, 0, 0.5, 0.0])
    X = s.fk(q, "tool").copy()
    X[0, 3] += 3
    for _ in range(cycles):
        q = s.ik_step(q, X, "tool", 0.01).q
    assert np.abs(q).max() < 4 * PI


def test_a_slider_dragged_past_the_end_of_its_slot_does_not_turn_the_lid():
    """FreeCAD, issue 29820: a latch on a hinged lid is dragged out of its slot; does the lid jump
    to 180 degrees?
    """
    m = Mechanism("lid")
    lid = m.body("lid")
    latch = m.body("latch")
    m.revolute("hinge", m.ground, lid, axis=(0, 1, 0), limits=(0, PI))
    m.prismatic("slot", lid, latch, at=(0.2, 0, 0), axis=(0, 0, 1), limits=(-0.05, 0.02))
    s = m.build()
    q = np.array([0.2, 0.0])
    X = s.fk(q, "latch")
    for k in range(100):
        target = X[:3, 3] - 0.002 * k * X[:3, 2]
        before = q
        q = s.ik_step(q, [tasks.Position("latch", target)], dt=0.02).q
        assert np.abs(q - before).max() < 0.15 and inside(s, q), k


def scara() -> System:
    m = Mechanism("scara", dim=2)
    m.revolute("j0", m.ground, m.body("upper"))
    m.revolute("j1", "upper", m.body("lower"), at=(0.5, 0))
    m.frame("t", "lower", at=(0.4, 0))
    return m.build()


@pytest.mark.parametrize("form", ["task", "pose"])
def test_a_straight_arm_streams_inwards(form):
    """LinuxCNC, issue 620: a SCARA robot at full stretch is asked towards a point further in; does
    it leave?
    """
    s = scara()
    q = np.array([0.2, 0.0])
    X = s.fk(q, "t").copy()
    X[:2, 3] *= 0.8
    for _ in range(500):
        if form == "task":
            step = s.ik_step(q, [tasks.Position("t", X[:3, 3])], dt=0.01, velocity_limits=2.0)
        else:
            step = s.ik_step(q, X, "t", 0.01, velocity_limits=2.0, weights=[1, 1, 0, 0, 0, 0])
        assert np.abs(step.q - q).max() <= 0.02 + 1e-9
        q = step.q
    assert np.linalg.norm(s.fk(q, "t")[:2, 3] - X[:2, 3]) < 1e-6


@pytest.mark.parametrize(
    "strict, bound", [(True, 0.01), (False, 0.05)], ids=["posture second", "posture soft"]
)
def test_a_preferred_posture_bends_a_straight_arm(strict, bound):
    """newton, issue 3264, with LinuxCNC, issue 620: a bent posture is preferred while the point
    lies further in.
    """
    s = scara()
    place = s.fk([0.2, 0.0], "t")[:3, 3] * [0.8, 0.8, 1]
    bent = np.array([0, 1.0])
    if strict:
        wanted = [tasks.Position("t", place), tasks.Posture(bent, priority=1)]
    else:
        wanted = [tasks.Position("t", place, weight=1.0), tasks.Posture(bent, weight=0.05)]
    q = np.array([0.2, 0.0])
    for _ in range(300):
        q = s.ik_step(q, wanted, dt=0.01).q
    assert np.linalg.norm(s.fk(q, "t")[:2, 3] - place[:2]) < bound


def test_an_arm_with_a_straight_wrist_turns_out_of_it():
    """moveit, issue 1616: an arm that is nearly singular is asked to turn; does it turn, within its
    speeds?
    """
    s = kempe.load("ur5")
    q = np.array([0, -1.2, 1.0, 0.3, 1e-4, 0.0])
    R = s.fk(q, "tool")[:3, :3]
    for _ in range(200):
        step = s.ik_step(q, np.array([0, 0, 0, 0.3, 0, 0.0]), "tool", 0.01, velocity_limits=2.0)
        assert np.abs(step.q - q).max() <= 0.02 + 1e-9
        q = step.q
    angle = math.acos(np.clip((np.trace(s.fk(q, "tool")[:3, :3] @ R.T) - 1) / 2, -1, 1))
    assert angle > 0.3  # of 0.6 rad that were asked for


def moving_pose(X0: np.ndarray, k: int) -> np.ndarray:
    """Pose of a figure of eight that turns as it goes, in cycle k of 300."""
    a = 2 * PI * k / 300
    X = X0 @ rpy(0.3 * math.sin(a), 0.2, 0.4 * math.sin(a))
    X[:3, 3] = X0[:3, 3] + [0.04 * math.sin(a), 0.05 * math.sin(2 * a), 0.03 * (1 - math.cos(a))]
    return X


def test_five_joints_follow_poses_that_they_cannot_hold_without_jumps():
    """lerobot, issue 1966: full poses are streamed to an SO-101 arm whose motors lag; does the arm
    jump?
    """
    s = kempe.load("so101")
    motor = s.mid.copy()
    X0 = s.fk(motor, "tool")
    for k in range(600):
        step = s.ik_step(motor, moving_pose(X0, k), "tool", 0.02, velocity_limits=2.0)
        assert np.abs(step.q - motor).max() <= 0.04 + 1e-9
        motor = motor + 0.7 * (step.q - motor)
    assert inside(s, motor)


@pytest.mark.parametrize("cycles", [120, pytest.param(600, marks=pytest.mark.slow)])
def test_five_joints_keep_the_place_and_turn_as_well_as_they_can(cycles):
    """lerobot, issue 3613: the position comes first and the orientation second; how far off is the
    position?
    """
    s = kempe.load("so101")
    q = s.mid.copy()
    X0 = s.fk(q, "tool")
    for k in range(cycles):
        X = moving_pose(X0, k)
        wanted = [
            tasks.Position("tool", X[:3, 3]),
            tasks.Orientation("tool", X[:3, :3], priority=1),
        ]
        step = s.ik_step(q, wanted, dt=0.02, velocity_limits=2.0)
        assert np.abs(step.q - q).max() <= 0.04 + 1e-9
        q = step.q
        assert k < 100 or np.linalg.norm(s.fk(q, "tool")[:3, 3] - X[:3, 3]) < 5e-3


# ---- several ends at once


def quadruped() -> System:
    m = Mechanism("quadruped")
    trunk = m.body("trunk")
    m.free("base", m.ground, trunk)
    for leg, x, y in (("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("RL", -0.2, 0.1), ("RR", -0.2, -0.1)):
        hip, thigh, shank = (m.body(f"{leg} {part}") for part in ("hip", "thigh", "shank"))
        m.revolute(f"{leg}_x", trunk, hip, at=(x, y, 0), axis="x", limits=(-0.8, 0.8))
        m.revolute(f"{leg}_h", hip, thigh, axis="y", limits=(-1.5, 2.5))
        m.revolute(f"{leg}_k", thigh, shank, at=(0, 0, -0.2), axis="y", limits=(-2.6, -0.2))
        m.frame(f"{leg}_foot", shank, at=(0, 0, -0.2))
    return m.build()


def test_a_quadruped_moves_its_trunk_while_the_feet_stay():
    """robot_keyframe_kit, issue 3; quadruped_9g, issue 1: the trunk moves and turns; which angles
    keep the feet?
    """
    s = quadruped()
    legs = ("FL", "FR", "RL", "RR")
    start = s.q(
        {
            "base.z": 0.3,
            "base.qw": 1.0,
            **{f"{n}_h": 0.8 for n in legs},
            **{f"{n}_k": -1.6 for n in legs},
        }
    )
    feet = [f"{n}_foot" for n in legs]
    places = s.fk(start, feet)[:, :3, 3]
    X = s.fk(start, "trunk")
    rng = np.random.default_rng(0)
    reached = 0
    for _ in range(100):
        wanted = X @ rpy(*rng.uniform(-0.2, 0.2, 3))
        wanted[:3, 3] += rng.uniform(-0.04, 0.04, 3)
        stand = [tasks.Position(f, p) for f, p in zip(feet, places, strict=True)]
        answer = s.ik([tasks.Pose("trunk", wanted), *stand], start=start)
        if answer:
            assert np.abs(s.fk(answer.q, feet)[:, :3, 3] - places).max() < 1e-6
            assert pose_error(s.fk(answer.q, "trunk"), wanted) < 1e-6
            angles = answer.q[7:]  # behind the base, whose coordinates are a place and a quaternion
            assert (angles >= s.lower[6:] - 1e-9).all() and (angles <= s.upper[6:] + 1e-9).all()
        reached += bool(answer)
    assert reached >= 95


def two_arms() -> System:
    """Two arms with seven joints each on a torso that turns."""
    m = Mechanism("two arms")
    torso = m.body("torso")
    m.revolute("waist", m.ground, torso, axis="z", limits=(-1.5, 1.5))
    for side, y in (("L", 0.2), ("R", -0.2)):
        before = torso
        origins = [
            (0, y, 0.5),
            (0, 0, 0),
            (0, 0, 0),
            (0.3, 0, 0),
            (0, 0, 0),
            (0.25, 0, 0),
            (0, 0, 0),
        ]
        for k, (axis, origin) in enumerate(zip("zyxyxyx", origins, strict=True)):
            body = m.body(f"{side}{k}")
            m.revolute(f"{side}q{k}", before, body, at=origin, axis=axis, limits=(-2.6, 2.6))
            before = body
        m.frame(f"{side}tool", before, at=(0.1, 0, 0))
    return m.build()


@pytest.mark.parametrize("only_relative", [False, True], ids=["both hands", "relative pose"])
def test_two_arms_on_a_torso_reach_together(only_relative):
    """bullet3, issue 2492; industrial_moveit, issue 56; moveit2, issue 3344: both hands, or one
    hand in the other.
    """
    s = two_arms()
    hands = ["Ltool", "Rtool"]
    for seed in range(60):
        A, B = s.fk(s.random(seed) * 0.7, hands)
        relative = np.linalg.inv(A) @ B
        both = [tasks.Pose("Ltool", A), tasks.Pose("Rtool", B)]
        answer = s.ik([tasks.Pose("Rtool", relative, other="Ltool")] if only_relative else both)
        L, R = s.fk(answer.q, hands)
        error = (
            pose_error(np.linalg.inv(L) @ R, relative)
            if only_relative
            else max(pose_error(L, A), pose_error(R, B))
        )
        assert answer and error < 1e-5, seed


# ---- redundancy and postures


def least_near(
    s: System, q: np.ndarray, X: np.ndarray, cost: Callable[[np.ndarray], float]
) -> float:
    """Least cost near `q` with the tool at X, by a general minimiser."""
    constraint = {"type": "eq", "fun": lambda v: six_errors(s.fk(v, "tool"), X)}
    options = {"maxiter": 400, "ftol": 1e-12}
    bounds = list(zip(s.lower, s.upper, strict=True))
    return minimize(cost, q, constraints=constraint, bounds=bounds, options=options).fun


def test_a_posture_of_second_priority_is_the_nearest_one():
    """newton, issue 3264; iiwa_ros, issue 32: is the posture as near as the tool allows, by another
    minimiser?
    """
    s = kempe.load("iiwa14")
    q = np.array([0.3, 0.7, -0.4, -1.3, 0.2, 0.9, 0.1])
    rest = np.array([0, 0.4, 0, -1.6, 0, 1.0, 0])
    X = s.fk(q, "tool")
    answer = s.ik([tasks.Pose("tool", X), tasks.Posture(rest, priority=1)], start=q)
    assert answer and pose_error(s.fk(answer.q, "tool"), X) < 1e-6
    least = least_near(s, answer.q, X, lambda v: float(((v - rest) ** 2).sum()))
    assert ((answer.q - rest) ** 2).sum() < least + 1e-4


def test_an_elbow_goes_up_while_the_tool_stays():
    """xArm-Python-SDK, issue 45: the elbow is asked upwards, and the tool may not move."""
    s = kempe.load("iiwa14")
    q = np.array([0.3, 0.7, -0.4, -1.3, 0.2, 0.9, 0.1])
    X = s.fk(q, "tool")
    elbow = s.body_names[4]
    above = s.fk(q, elbow)[:3, 3] + [0, 0, 1]
    answer = s.ik([tasks.Pose("tool", X), tasks.Position(elbow, above, priority=1)], start=q)
    assert pose_error(s.fk(answer.q, "tool"), X) < 1e-6 and inside(s, answer.q)
    assert s.fk(answer.q, elbow)[2, 3] > s.fk(q, elbow)[2, 3] + 0.005

    def away(v: np.ndarray) -> float:
        return float(((s.fk(v, elbow)[:3, 3] - above) ** 2).sum())

    assert away(answer.q) < least_near(s, answer.q, X, away) + 1e-4


@pytest.fixture(scope="module")
def humanoid() -> System:
    path = urdf_files().get("talos_data/robots/talos_reduced.urdf")
    if path is None:
        pytest.skip("example-robot-data is not installed")
    return kempe.load(path)


def test_only_one_arm_of_a_humanoid_moves(humanoid):
    """bullet3, issue 4642: all joints but those of the right arm are held; is the hand still
    brought to its pose?
    """
    s = humanoid
    hand = "arm_right_7_link"
    start = s.mid.copy()
    arm = np.array([name.startswith("arm_right") for name in s.coordinate_names])
    held = {
        n: (v - 1e-12, v + 1e-12)
        for n, v, a in zip(s.coordinate_names, start, arm, strict=True)
        if not a
    }
    right = s.with_limits(held)
    for seed in range(60):
        X = s.fk(np.where(arm, s.random(seed), start), hand)
        answer = right.ik(X, hand, start=start)
        assert answer and pose_error(s.fk(answer.q, hand), X) < 1e-6, seed
        assert np.abs(answer.q - start)[~arm].max() < 1e-9


def test_joints_that_do_not_lead_to_the_hand_stay(humanoid):
    """lerobot, issue 3613: nothing is held; do legs or the other arm move although the hand does
    not need them?
    """
    s = humanoid
    hand = "arm_right_7_link"
    start = s.mid.copy()
    arm = np.array([name.startswith("arm_right") for name in s.coordinate_names])
    answer = s.ik(s.fk(np.where(arm, s.random(59), start), hand), hand, start=start)
    moved = np.array(s.coordinate_names)[np.abs(answer.q - start) > 1e-9]
    assert not [name for name in moved if name.startswith("leg") or "left" in name]


def snake() -> System:
    """Forty joints about y and z in turn, 5 cm apart, which turn by 0.6 rad at most."""
    m = Mechanism("snake")
    before = m.ground
    for i in range(40):
        body = m.body(f"b{i}")
        origin = (0.05 if i else 0, 0, 0)
        m.revolute(f"q{i}", before, body, at=origin, axis="z" if i % 2 else "y", limits=(-0.6, 0.6))
        before = body
    m.frame("t", before, at=(0.05, 0, 0))
    return m.build()


def test_a_snake_with_forty_joints_reaches_its_poses():
    """ikpy, issue 102: does the solver of a long chain converge from the straight configuration?"""
    s = snake()
    for seed in range(20):
        X = s.fk(s.random(seed), "t")
        answer = s.ik(X, "t", start=np.zeros(40))
        assert answer and pose_error(s.fk(answer.q, "t"), X) < 1e-6, seed


def test_a_pose_beyond_the_length_of_a_snake_is_proven_unreachable():
    """pinocchio, issue 1959: two metres of links, and a pose 2.3 metres away."""
    answer = snake().ik(np.array([[1, 0, 0, 2.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), "t")
    assert not answer and answer.code.proof


# ---- directions


def test_a_camera_beside_its_axes_looks_at_points():
    """NUbots, issue 1021; ros_controllers, issue 112: the camera is offset from both axes of its
    head.
    """
    m = Mechanism("head")
    m.revolute("pan", m.ground, m.body("neck"), at=(0, 0, 0.3), axis="z", limits=(-2.5, 2.5))
    m.revolute("tilt", "neck", m.body("skull"), at=(0.02, 0, 0.05), axis="y", limits=(-0.8, 1.2))
    m.frame("camera", "skull", at=(0.06, 0.03, 0.08))
    s = m.build()
    rng = np.random.default_rng(0)
    for _ in range(200):
        a = rng.uniform(-1.5, 1.5)
        place = np.array([math.cos(a), math.sin(a), 0]) * rng.uniform(0.5, 3) + [
            0,
            0,
            rng.uniform(-0.2, 0.9),
        ]
        answer = s.ik([tasks.LookAt("camera", place, axis="x")])
        X = s.fk(answer.q, "camera")
        view = place - X[:3, 3]
        angle = np.linalg.norm(np.cross(X[:3, 0], view)) / np.linalg.norm(view)
        assert answer and angle < 1e-6 and X[:3, 0] @ view > 0


def test_a_tool_turns_freely_within_a_quarter_turn():
    """jsk_apc, issue 1386; pytracik, issue 11: the tool may turn about its x axis, but only by 0 to
    90 degrees.
    """
    s = kempe.load("panda")
    for seed in range(40):
        X = s.fk(s.random(seed), "tool")
        middle = X @ turn("x", PI / 4)
        wanted = [
            tasks.Position("tool", X[:3, 3]),
            tasks.Pointing("tool", X[:3, 0], axis="x"),
            tasks.Pointing("tool", middle[:3, 1], axis="y", at_most=PI / 4),
        ]
        answer = s.ik(wanted)
        Y = s.fk(answer.q, "tool")
        R = X[:3, :3].T @ Y[:3, :3]
        assert answer and pose_errors(Y, X)[0] < 1e-6, seed
        assert abs(R[0, 0] - 1) < 1e-9 and -1e-6 <= math.atan2(R[2, 1], R[1, 1]) <= PI / 2 + 1e-6
