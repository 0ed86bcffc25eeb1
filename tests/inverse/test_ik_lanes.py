"""The inverse model of one frame: tasks, the rule by which a start is chosen, plain calls;
batteries.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings

import numpy as np
import pytest
from robots import DATA

import kempe
from kempe.errors import CallError, InputError
from kempe.status import Status

AXES = [(0.0, 0.0, 1.0), (1.0, 2.0, -0.5)]


def snake(n):
    """A planar arm of n joints within +-2.5, one metre long."""
    m = kempe.Mechanism(f"snake{n}", dim=2)
    last = m.ground
    for i in range(n):
        body = m.body(f"b{i}")
        m.revolute(f"j{i}", last, body, at=(0.0 if i == 0 else 1.0 / n, 0), limits=(-2.5, 2.5))
        last = body
    m.frame("tip", last, at=(1.0 / n, 0))
    return m.build()


def gantry():
    """Slides, turns, and a finger whose joints share a coordinate."""
    m = kempe.Mechanism("gantry")
    last = m.ground
    for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
        body = m.body(name)
        m.prismatic(f"along {name}", last, body, axis=axis, limits=(-0.5, 0.8))
        last = body
    for i, axis in enumerate([(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 0)]):
        body = m.body(f"link{i}")
        m.revolute(f"turn{i}", last, body, at=(0.2, 0, 0.1), axis=axis, limits=(-1.8, 2.2))
        last = body
    m.gear("turn3", "turn1", -0.5, 0.2)
    m.frame("tip", last, at=(0.15, 0.02, 0))
    return m.build()


def angles(A, B, axis=None):
    """Angles (N,) between rotations, or between the directions of an axis of theirs."""
    if axis is not None:
        a, b = (X[:, :3, :3] @ np.asarray(axis) / np.linalg.norm(axis) for X in (A, B))
        return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
    R = np.swapaxes(A[:, :3, :3], 1, 2) @ B[:, :3, :3]
    skew = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], -1)
    return np.arctan2(np.linalg.norm(skew, axis=-1), np.trace(R, axis1=1, axis2=2) - 1.0)


ROBOTS = {
    "so101": lambda: (kempe.load("so101"), None),
    "panda": lambda: (kempe.load("panda"), None),
    "gantry": lambda: (gantry(), "tip"),
}


def robot_of(name):
    robot, frame = ROBOTS[name]()
    return robot, frame or robot.frame_names[-1]


def inside(robot, q):
    at_q = robot.structure.layout.vector_q
    at_v = robot.structure.layout.vector_v
    return bool(
        (q[..., at_q] >= robot.lower[at_v]).all() and (q[..., at_q] <= robot.upper[at_v]).all()
    )


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("task", ["pose", "position", "orientation", "direction", "position_axis"])
@pytest.mark.parametrize("name", ROBOTS)
def test_tasks(name, task, axis):
    robot, frame = robot_of(name)
    X = robot.fk(robot.random(0, 300), frame)
    s = robot.ik(X, frame, task=(task, axis))
    Y = robot.fk(s.q, frame)
    assert s.success.all() and inside(robot, s.q)
    if task in ("pose", "position", "position_axis"):
        far = np.linalg.norm(X[:, :3, 3] - Y[:, :3, 3], axis=-1)
        assert far.max() <= 1e-6
        np.testing.assert_allclose(s.position_error, far, atol=1e-12)
    else:
        assert (s.position_error == 0.0).all()
    if task == "position":
        assert (s.orientation_error == 0.0).all()
    else:
        off = angles(X, Y, axis if task in ("direction", "position_axis") else None)
        assert off.max() <= 1e-6
        np.testing.assert_allclose(s.orientation_error, off, atol=1e-12)
    if task == "position_axis":
        assert angles(X, Y).max() > 0.1  # turns about the axis are free, and are used


def test_tasks_by_other_targets():
    robot, frame = robot_of("panda")
    X = robot.fk(robot.random(3), frame)
    axis = np.array([0.6, 0.0, 0.8])
    d = X[:3, :3] @ axis
    for target, task in ((d, "direction"), (np.r_[X[:3, 3], d], "position_axis")):
        s = robot.ik(target, frame, task=(task, axis))
        Y = robot.fk(s.q, frame)
        assert s.success and np.abs(Y[:3, :3] @ axis - d).max() < 2e-6
    s = robot.ik(X[:3, :3], frame, task="orientation")
    assert s.success and np.abs(robot.fk(s.q, frame)[:3, :3] - X[:3, :3]).max() < 2e-6
    planar = snake(5)
    s = planar.ik([0.3, 0.2, 0.0, 1.0], "tip", task=("position_axis", (1, 0, 0)))
    assert s.success and np.allclose(
        planar.fk(s.q, "tip")[:2, [0, 3]], [[0.0, 0.3], [1.0, 0.2]], atol=2e-6
    )


def test_five_joints_point_where_they_cannot_pose():
    robot, frame = robot_of("so101")
    X = robot.fk(robot.random(5, 40), frame) @ kempe.spatial.pose(kempe.spatial.rot_z(1.0))
    assert not robot.ik(X, frame, budget=kempe.Budget(starts=20)).success.any()
    assert robot.ik(X, frame, task="position_axis").success.all()
    X[:, :3, :3] = X[:, :3, :3] @ kempe.spatial.rot_x(1.3)
    s = robot.ik(X, frame, task="position_axis", budget=kempe.Budget(starts=20))
    lost = np.flatnonzero(~s.success)
    assert len(lost) and np.all(s.status[lost] != "") and "rad" in s.status[lost[0]]


def test_arguments_are_checked():
    robot, frame = robot_of("panda")
    X = robot.fk(robot.mid, frame)
    with pytest.raises(InputError, match="'sideways'; it must be one of 'pose'"):
        robot.ik(X, frame, task="sideways")
    with pytest.raises(CallError, match="position_only"):
        robot.ik(X, frame, task="orientation", position_only=True)
    with pytest.raises(InputError, match="asks for an orientation"):
        robot.ik(X[:3, 3], frame, task="pose")
    with pytest.raises(InputError, match="not all zero"):
        robot.ik(X, frame, task=("direction", (0, 0, 0)))
    assert (
        robot.ik(X, frame, task="position").q.tolist()
        == robot.ik(X, frame, task="position").q.tolist()
    )


@pytest.mark.parametrize("task", ["direction", "position_axis", "orientation"])
def test_exact_solutions_answer_tasks_too(task):
    robot = kempe.load("puma560")
    X = robot.fk(robot.random(1, 30), "tool")
    s = robot.ik(X, "tool", task=(task, (1, 0, 1)), method="auto")
    Y = robot.fk(s.q, "tool")
    assert (
        s.success.all() and angles(X, Y, None if task == "orientation" else (1, 0, 1)).max() < 1e-6
    )


# ---- which start is chosen


def test_a_seed_that_leads_to_the_target_is_the_answer():
    robot, frame = robot_of("panda")
    q = robot.random(1, 200)
    near = np.clip(
        q + np.random.default_rng(0).uniform(-0.05, 0.05, q.shape), robot.lower, robot.upper
    )
    X = robot.fk(q, frame)
    s = robot.ik(X, frame, start=near)
    alone = robot.ik(X, frame, start=near, budget=kempe.Budget(starts=1))
    assert s.success.all() and (s.starts == 1).all() and np.array_equal(s.q, alone.q)
    assert np.median(np.abs(s.q - near).max(axis=1)) < 0.15
    other = robot.ik(X, frame, start=near, budget=kempe.Budget(rng=5))
    assert np.array_equal(s.q, other.q)  # no random number took part


def test_plain_calls_are_answered_as_careful_ones():
    robot, frame = robot_of("panda")
    X = robot.fk(robot.random(0, 30), frame)
    many = robot.ik(X[:1], frame)
    first = robot.ik(X[0], frame)
    again = robot.ik(X[0], frame)
    assert (frame, None, 2) in robot._kept["ik"]
    assert (
        np.array_equal(first.q, many.q[0])
        and np.array_equal(again.q, first.q)
        and again.success is True
    )
    for X_, q in zip(X, robot.random(1, 30), strict=True):
        short = robot.ik(X_, frame, start=q)
        careful = robot.ik(X_.tolist(), frame, start=list(q))
        assert np.array_equal(short.q, careful.q) and short.starts == careful.starts
        assert (short.iterations, short.residual) == (careful.iterations, careful.residual)
        assert short.status == careful.status and str(short) == str(careful)
    back = pickle.loads(pickle.dumps(again))
    assert back.status == again.status and back.problem.frame == frame
    outside = np.full(robot.nq, 50.0)
    a = robot.ik(X[0], frame, start=outside)
    b = robot.ik(X[0].tolist(), frame, start=outside.tolist())
    assert np.array_equal(a.q, b.q) and inside(robot, a.q)


@pytest.mark.parametrize("options", [{}, {"task": "position"}], ids=["by the shape", "by name"])
def test_plain_calls_for_points_are_answered_as_careful_ones(options):
    for robot in map(kempe.load, ("panda", "ur5", "youbot")):
        frame = robot.frame_names[-1]
        p = np.ascontiguousarray(robot.fk(robot.random(0, 30), frame)[:, :3, 3])
        for p_, q in zip(p, robot.random(1, 30), strict=True):
            for seed in (None, q, q + 40.0):
                short = robot.ik(p_, frame, seed, **options)
                careful = robot.ik(
                    p_.tolist(), frame, None if seed is None else seed.tolist(), **options
                )
                assert np.array_equal(short.q, careful.q) and short.status == careful.status
                assert (short.iterations, short.residual) == (careful.iterations, careful.residual)
                assert short and inside(robot, short.q)
                assert np.linalg.norm(robot.fk(short.q, frame)[:3, 3] - p_) < 1e-6
        assert (frame, options.get("task"), 1) in robot._kept["ik"]


def test_plain_calls_after_unusual_ones_are_usual():
    robot, frame = robot_of("panda")
    X = robot.fk(robot.random(0, 20), frame)
    usual = [robot.ik(x, frame).q for x in X]
    for options in (
        {"budget": kempe.Budget(starts=1)},
        {"tolerance": 0.1},
        {"budget": kempe.Budget(rng=3)},
        {"task": "position"},
        {"task": "direction"},
    ):
        other, _ = robot_of("panda")
        other.ik(X[0], frame, **options)
        for x, q in zip(X, usual, strict=True):
            assert np.array_equal(other.ik(x, frame).q, q)


def test_plain_calls_say_what_is_wrong():
    robot, frame = robot_of("panda")
    X = robot.fk(robot.mid, frame)
    for _ in range(2):
        assert robot.ik(X, frame)
        far = X.copy()
        far[:3, 3] += 9.0
        s = robot.ik(far, frame)
        assert s.code == Status.OUT_OF_REACH and not s and "outside the workspace" in s.status
        with pytest.raises(InputError, match="must be finite"):
            robot.ik(np.where(X == 1.0, np.nan, X), frame)
        with pytest.raises(InputError, match="last row"):
            robot.ik(np.ascontiguousarray(far.T), frame)
        with pytest.raises(InputError, match="start.*is nan; it must be finite"):
            robot.ik(X, frame, start=np.full(robot.nq, np.nan))
        with pytest.raises(InputError, match="start has 8 coordinates; panda needs 7"):
            robot.ik(X, frame, start=np.zeros((2, robot.nq + 1)))
    turned = X.copy()
    turned[:3, 3] = [0.0, 0.0, 0.05]
    s = robot.ik(turned, frame)
    assert s.code in (Status.SOLVED, Status.NOT_FOUND) and inside(robot, s.q)


def test_joints_that_the_chain_does_not_move_keep_their_seed():
    robot = kempe.load("panda")
    m = robot.mechanism
    m.revolute("aside", m.ground, m.body("other"), limits=(-1.0, 1.0))
    robot, frame = m.build(), robot.frame_names[-1]
    seed = robot.mid.copy()
    X = robot.fk(seed, frame)
    at = robot.coordinate_names.index("aside")
    for value, kept in ((0.7, 0.7), (5.0, 1.0)):
        seed[at] = value
        for _ in range(2):
            assert robot.ik(X, frame, start=seed).q[at] == kept
    seed[at] = np.nan
    with pytest.raises(InputError, match="must be finite"):
        robot.ik(X, frame, start=seed)


SCRIPT = """
import numpy as np, kempe, sys
from kempe.kernels.base.vectors import LANES
robot = kempe.load("panda")
frame = robot.frame_names[-1]
s = robot.ik(robot.fk(robot.random(1, 300), frame), frame)
np.savez(sys.argv[1], lanes=LANES, q=s.q, starts=s.starts, success=s.success)
"""


@pytest.mark.slow
def test_the_width_of_the_vectors_does_not_decide(tmp_path):
    """The same starts reach the goals with four lanes as with eight."""
    path = tmp_path / "four.npz"
    pytest.importorskip("numba")
    narrow = {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": "+avx2,+fma",
        "KEMPE_KERNELS": "jit",
    }
    subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path)], check=True, env={**os.environ, **narrow}
    )
    four = np.load(path)
    (robot, frame) = robot_of("panda")
    own = robot.ik(robot.fk(robot.random(1, 300), frame), frame)
    assert four["lanes"] == 4 and four["success"].all() and own.success.all()
    same = own.starts == four["starts"]
    assert same.mean() > 0.97 and np.median(np.abs(own.q - four["q"])[same].max(axis=1)) < 1e-9


# ---- batteries

ARMS = {
    "panda": ("panda.urdf", "panda_hand_tcp"),
    "ur5": ("ur5_robot.urdf", "tool0"),
    "ur10": ("ur10_robot.urdf", "tool0"),
    "ur5 limited": ("ur5_joint_limited_robot.urdf", "tool0"),
    "talos": ("talos_reduced.urdf", "gripper_left_base_link"),
    "icub": ("icub.urdf", "r_hand"),
    "tiago": ("tiago.urdf", "arm_tool_link"),
    "romeo": ("romeo.urdf", "r_wrist"),
    "g1": ("g1_29dof_rev_1_0.urdf", "right_rubber_hand"),
    "so101": ("so101.urdf", "gripper_frame_link"),
}
OURS = {
    "iiwa": lambda: kempe.load("iiwa14"),
    "snake10": lambda: snake(10),
    "snake20": lambda: snake(20),
    "snake40": lambda: snake(40),
    "gantry": gantry,
}
BATTERY = 10_000


def at_limits(robot, frame, q, rng):
    """Half of the chain's joints exactly at a limit, of those that have limits."""
    rows = robot.structure.table.find_path(frame)
    v = np.array(sorted({int(robot.structure.table.iv[k]) for k in rows}))
    at = np.array(
        [
            int(robot.structure.table.iq[next(k for k in rows if robot.structure.table.iv[k] == i)])
            for i in v
        ]
    )
    low = robot.lower[v]
    high = robot.upper[v]
    low = np.where(np.isfinite(low), low, -np.pi)
    high = np.where(np.isfinite(high), high, np.pi)
    chosen = np.argsort(rng.random((len(q), len(v))), axis=1) < len(v) // 2
    q = q.copy()
    q[:, at] = np.where(chosen, np.where(rng.random(chosen.shape) < 0.5, low, high), q[:, at])
    return q


def pinocchio(path, frame):
    """A function from configurations of ours to poses (N, 4, 4), by Pinocchio alone."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    number = model.getFrameId(frame)

    def poses(robot, q):
        index = {n: i for i, n in enumerate(robot.coordinate_names)}
        joints = [
            (index[model.names[j]], model.joints[j].idx_q, model.joints[j].nq)
            for j in range(1, model.njoints)
            if model.names[j] in index
        ]
        out = np.empty((len(q), 4, 4))
        x = pin.neutral(model)
        for row, configuration in enumerate(q):
            for i, at, size in joints:
                value = configuration[i]
                x[at : at + size] = (np.cos(value), np.sin(value)) if size == 2 else value
            pin.framesForwardKinematics(model, data, x)
            out[row] = data.oMf[number].homogeneous
        return out

    return poses


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ARMS, *OURS])
def test_battery(name):
    """All reachable targets are found, at the limits all but one in a thousand; none is falsely
    said to be reached.
    """
    if name in ARMS:
        if not DATA:
            pytest.skip("example-robot-data is not installed")
        file, frame = ARMS[name]
        path = next(DATA[0].rglob(file))
        robot = kempe.load(str(path))
        poses = pinocchio(path, frame)
    else:
        robot = OURS[name]()
        frame = robot.frame_names[-1]

        def poses(robot, q):
            return robot.fk(q, robot.frame_names[-1])

    axis = (1.0, 2.0, -0.5) if name == "so101" else None
    options = {"task": ("position_axis", axis)} if axis else {}
    q = robot.random(1, BATTERY)
    for configurations, share in (
        (q, 1.0),
        (at_limits(robot, frame, q, np.random.default_rng(0)), 0.999),
    ):
        X = poses(robot, configurations)
        s = robot.ik(X, frame, **options)
        Y = poses(robot, s.q)
        near = np.linalg.norm(X[:, :3, 3] - Y[:, :3, 3], axis=-1) <= 1.001e-6
        right = near & (angles(X, Y, axis) <= 1.001e-6)
        assert np.array_equal(right, s.success) and right.mean() >= share and inside(robot, s.q)
        assert s.starts.mean() < 6


@pytest.mark.parametrize("kind", [complex, np.float32, np.int64, object, ">f8", bool])
@pytest.mark.parametrize("task", [None, "position"])
def test_plain_calls_take_what_the_first_call_takes(kind, task):
    """The same answer or the same error, whether or not a bound form was made."""
    robot, frame = robot_of("panda")
    target = (
        robot.fk(robot.random(4), frame)
        if task is None
        else robot.fk(robot.random(4), frame)[:3, 3]
    )
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        odd = (target * (1 + 1j) if kind is complex else target).astype(kind)

    def outcome() -> object:
        try:
            return robot.ik(odd, frame, **({} if task is None else {"task": task})).q.tolist()
        except (InputError, TypeError, ValueError) as error:
            return str(error)

    for kept in robot._kept.values():
        kept.clear()
    first = outcome()
    robot.ik(target, frame, **({} if task is None else {"task": task}))
    assert outcome() == first
