"""Paths that follow targets, against Pinocchio and against arms whose limits, jumps and ends are
known by hand.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from linkages import planar_arm
from robots import urdf_files

import kempe
from kempe import Mechanism, spatial, tasks
from kempe.errors import InputError
from kempe.inverse.path import PathSteps


def circle(radius: float, angles: np.ndarray) -> np.ndarray:
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def elbow(radius: float) -> float:
    """Angle 'q2' at which the tip is at this distance from the base (law of cosines)."""
    return math.acos(radius**2 / 2.0 - 1.0)


def test_a_straight_line_with_a_turn_is_followed_on_target():
    pin = pytest.importorskip("pinocchio")
    path = next((p for n, p in urdf_files().items() if n.endswith("ur5_robot.urdf")), None)
    if path is None:
        pytest.skip("example-robot-data is not installed")
    robot = kempe.load(path)
    model = pin.buildModelFromUrdf(str(path))
    start = np.array([0.3, -1.2, 1.5, -0.9, -1.4, 0.2])
    X = robot.fk(start, "tool0")
    s = np.linspace(0.0, 1.0, 41)[:, None]
    targets = spatial.pose(
        X[:3, :3] @ spatial.exp_so3(s * [0.5, -0.8, 0.4]), X[:3, 3] + s * [-0.2, 0.35, 0.1]
    )
    p = robot.ik_path(targets, "tool0", start)
    assert p and p.success.all() and p.jumps == () and len(p) == 41
    np.testing.assert_allclose(p.q[0], start, atol=1e-9)
    data = model.createData()
    number = model.getFrameId("tool0")
    for q, target in zip(p.q, targets, strict=True):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(data.oMf[number].homogeneous, target, atol=1e-9)
    J = robot.jacobian(p.q[:-1], "tool0")
    twist = np.concatenate(
        [
            np.diff(targets[:, :3, 3], axis=0),
            spatial.log_so3(targets[1:, :3, :3] @ np.swapaxes(targets[:-1, :3, :3], 1, 2)),
        ],
        axis=1,
    )
    ahead = np.linalg.solve(J, twist[..., None])[..., 0]
    # each step is its first order
    assert np.abs(np.diff(p.q, axis=0) - ahead).max() < 0.1 * np.abs(ahead).max()


def test_free_joints_turn_on_and_on():
    angles = np.linspace(0.0, 4.0 * math.pi, 60)
    beta = elbow(1.2)
    p = planar_arm(1.0, 1.0).ik_path(circle(1.2, angles), "tip", [-beta / 2, beta])
    assert p
    np.testing.assert_allclose(
        p.q, np.stack([angles - beta / 2, np.full(60, beta)], axis=1), atol=1e-9
    )


@pytest.mark.parametrize("limit", [2.5, 2.0 * math.pi])
def test_a_circle_that_leaves_the_range_of_a_joint_jumps_where_it_does(limit):
    """a = angle - elbow / 2 meets its limit at a known target; the other elbow goes on from there."""
    beta = elbow(1.2)
    angles = np.linspace(0.0, 3.0 * math.pi, 200)
    last = int(np.flatnonzero(angles - beta / 2 <= limit)[-1])
    s = planar_arm(1.0, 1.0, limits=[(-limit, limit), (-3.0, 3.0)])
    p = s.ik_path(circle(1.2, angles), "tip", [-beta / 2, beta])
    assert not p and p.jumps == (last + 1,)
    assert p.success[: last + 1].all() and not p.success[last + 1 :].any()
    assert np.isnan(p.q[last + 1 :]).all()
    np.testing.assert_allclose(p.q[: last + 1, 0], angles[: last + 1] - beta / 2, atol=1e-9)
    part = (limit + beta / 2 - angles[last]) / (angles[1] - angles[0])
    said = float(p.status.split("stops ")[1].split("%")[0]) / 100
    assert (
        abs(said - part) < 0.01
        and "at the limit of 'q1'" in p.status
        and "by a jump of" in p.status
    )
    again = s.ik_path(circle(1.2, angles), "tip", [-beta / 2, beta], restart=True)
    assert again.success[last + 1] and again.jumps[0] == last + 1 and not again
    good = again.success
    np.testing.assert_allclose(
        s.fk(again.q[good], "tip")[:, :2, 3], circle(1.2, angles)[good], atol=1e-9
    )
    jumped = np.abs(np.diff(again.q, axis=0)).max(axis=1) > 0.3
    assert jumped[last] and np.all(
        good[1:][jumped] & np.isin(np.arange(1, 200)[jumped], again.jumps)
    )


@pytest.mark.parametrize("restart", [False, True])
def test_the_edge_of_the_workspace_is_a_singularity(restart):
    line = np.linspace([1.2, 0.3], [2.3, 0.3], 50)
    last = int(np.flatnonzero(np.linalg.norm(line, axis=1) <= 2.0)[-1])
    p = planar_arm(1.0, 1.0).ik_path(line, "tip", [-0.9, 1.85], restart=restart)
    assert p.success.sum() == last + 1 and p.jumps == ()
    assert "at a singularity" in p.status and "not reached from" in p.status


def test_a_path_begins_at_a_singularity():
    """From the stretched arm inwards joint steps go with the square root of the way: fast, but no
    jump.
    """
    line = np.linspace([2.0, 0.0], [1.0, 0.0], 30)
    p = planar_arm(1.0, 1.0).ik_path(line, "tip", [0.0, 0.0])
    assert p, p.status
    np.testing.assert_allclose(
        np.abs(p.q[:, 1]), [elbow(r) if r < 2.0 else 0.0 for r in line[:, 0]], atol=1e-5
    )


def test_a_wrist_goes_straight_through_its_singularity():
    """Targets of a motion in which the middle axis of a spherical wrist passes zero, which samples
    step over.
    """
    m = Mechanism("wrist")
    for before, body, axis in (
        ("ground", "1", (0, 0, 1)),
        ("1", "2", (0, 1, 0)),
        ("2", "3", (0, 0, 1)),
    ):
        m.revolute(f"j{body}", before, m.body(body), axis=axis)
    s = m.build()
    t = np.linspace(-1.0, 1.0, 30)
    q = np.stack([0.2 * t, 0.7 * t, 0.1 + 0.3 * t], axis=1)
    p = s.ik_path(tasks.Orientation("3", s.fk(q, "3")[:, :3, :3]), start=q[0])
    assert p, p.status
    np.testing.assert_allclose(p.q, q, atol=1e-7)


def test_a_limited_elbow_cannot_pass_to_the_other_side():
    """Touching the edge of the workspace and coming back changes the elbow only where limits let
    it.
    """
    beta = elbow(1.6)
    p = planar_arm(1.0, 1.0, limits=[None, (0.3, 3.0)]).ik_path(
        np.linspace([1.6, 0.0], [1.99, 0.0], 40), "tip", [-beta / 2, beta]
    )
    farthest = 2.0 * math.cos(0.15)  # the reach with the elbow at its limit
    assert (
        p.success.sum() == np.sum(np.linspace(1.6, 1.99, 40) <= farthest)
        and "the limit of 'q2'" in p.status
    )


def test_branches_choose_the_start_that_gets_farthest():
    """With the elbow at the other side, a = angle + elbow / 2 meets its limit earlier."""
    beta = elbow(1.2)
    angles = np.linspace(0.0, 2.5, 60)
    s = planar_arm(1.0, 1.0, limits=[(-2.0, 2.0), (-3.0, 3.0)])
    seed = [beta / 2, -beta]
    alone = s.ik_path(circle(1.2, angles), "tip", seed)
    assert alone.success.sum() == np.sum(angles + beta / 2 <= 2.0)
    best = s.ik_path(circle(1.2, angles), "tip", seed, branches=True)
    assert best and np.all(best.q[:, 1] > 0.0)


def test_redundant_arm_in_a_loop_of_positions():
    robot = kempe.load("panda")
    start = robot.mid
    x = robot.fk(start, "panda_link7")[:3, 3]
    angles = np.linspace(0.0, 2.0 * math.pi, 40)
    targets = x + 0.1 * np.stack([np.cos(angles) - 1.0, np.sin(angles), 0.0 * angles], axis=-1)
    p = robot.ik_path(targets, "panda_link7", start)
    assert p
    np.testing.assert_allclose(robot.fk(p.q, "panda_link7")[:, :3, 3], targets, atol=1e-9)
    assert np.abs(np.diff(p.q, axis=0)).max() < 0.1


def test_closed_loops_stay_closed():
    platform = kempe.load("stewart")
    start = platform.assemble().q
    targets = np.tile(platform.fk(start, "platform"), (8, 1, 1))
    targets[:, :3, 3] += np.linspace(0.0, 1.0, 8)[:, None] * [0.03, 0.02, 0.05]
    p = platform.ik_path(tasks.Pose("platform", targets), start=start)
    assert p, p.status
    np.testing.assert_allclose(platform.fk(p.q, "platform"), targets, atol=1e-9)
    assert np.abs(platform.loops.closure_error(p.q)).max() < 1e-9


def test_bad_input_is_refused_and_no_start_is_said():
    s = planar_arm(1.0, 1.0)
    p = s.ik_path([[3.0, 0.0], [1.0, 0.0]], "tip")
    assert not p.success.any() and "target 0" in p.status
    refused = [
        ([1.0, 0.0], {}),
        ([[1.0, 0.0], [np.nan, 0.0]], {}),
        ([[1.0, 0.0]], {"max_step": 0.0}),
        ([[1.0, 0.0]], {"start": [[0.0, 1.0]] * 2}),
    ]
    for targets, options in refused:
        with pytest.raises(InputError):
            s.ik_path(targets, "tip", **options)


@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "frame"), [("iiwa14", "tool"), ("panda", "panda_hand_tcp"), ("gen3", "tool")]
)
def test_lines_of_joints_of_redundant_arms_are_followed(name, frame, every):
    """Targets of a straight line of joints inside the limits: a continuous answer exists, and no
    status denies it.
    """
    system = kempe.load(name)
    followed = 0
    for k in range(0, 30, every):
        rng = np.random.default_rng(k)
        a = np.array(system.random(rng))
        e = np.array(system.random(rng))
        X = system.fk(a + (e - a) * np.linspace(0, 1, 81)[:, None], frame)
        p = system.ik_path(X, frame, a)
        followed += bool(p)
        if p:
            assert (p.q >= system.lower - 1e-9).all() and (p.q <= system.upper + 1e-9).all()
            assert np.abs(system.fk(p.q, frame) - X).max() < 1e-8
            big = int(np.argmax(np.abs(np.diff(p.q, axis=0)).max(axis=1)))
            A = X[big]
            B = X[big + 1]
            s = np.linspace(0, 1, 129)[:, None]
            turn = spatial.exp_so3(s * spatial.log_so3(A[:3, :3].T @ B[:3, :3]))
            fine = system.ik_path(
                spatial.pose(A[:3, :3] @ turn, A[:3, 3] + s * (B - A)[:3, 3]), frame, p.q[big]
            )
            assert fine and np.abs(np.diff(fine.q, axis=0)).max() < 0.2, (
                "its largest step is followed in small ones"
            )
        else:
            assert "whether a way without a jump exists is not known" in p.status
    assert followed >= (28 if every == 1 else 4)


def test_an_ik_path_names_the_constraint_that_the_targets_leave(hunt):
    """The tip of an arm is on a rail; targets beside it are refused by the rail's name, not by a
    singularity.
    """
    rng = hunt.rng()
    m = planar_arm(0.4, 0.4, 0.4, 0.3).mechanism
    m.constrain(kempe.constraints.OnLine("tip", [0, 0.5], [1, 0]), "rail")
    system = m.build()
    tried = 0
    for _ in range(hunt.cases(12)):
        q = system.assemble({}, start=rng.uniform(-1, 1, 4)).q
        if np.linalg.svd(system.jacobian(q, "tip")[:2])[1][-1] < 0.2:
            continue
        X = system.fk(q, "tip")[:3, 3]
        p = system.ik_path(X + [[0, 0, 0], [0, 0.02, 0], [0, 0.04, 0]], "tip", start=q)
        assert not p and "'rail' does not let it follow" in p.status and "singular" not in p.status
        along = system.ik_path(X + [[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]], "tip", start=q)
        assert along or "'rail' does not let" not in along.status
        tried += 1
    assert tried


def test_steps_that_nothing_speaks_against_are_those_of_the_careful_way(monkeypatch):
    """Kernels take them, with the same answers; of a circle of an arm with seven joints all."""
    robot = kempe.load("panda")
    frame = "panda_hand_tcp"
    start = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8])
    turned = circle(0.1, np.linspace(0.0, 2.0 * math.pi, 60)) - [0.1, 0.0]
    round_ = np.tile(robot.fk(start, frame), (60, 1, 1))
    round_[:, :2, 3] += turned
    line = robot.fk(
        start + np.linspace(0.0, 1.0, 40)[:, None] * [0.4, 1.0, 0.5, 0.3, 0.8, -1.7, 0.2], frame
    )
    careful: list[int] = []
    segment = PathSteps.follow_segment

    def count_segments(self, i, *rest):
        careful.append(i)
        return segment(self, i, *rest)

    monkeypatch.setattr(PathSteps, "follow_segment", count_segments)
    for targets, start_of in ((round_, start), (line, start), (round_[:, :3, 3], start)):
        careful.clear()
        fast = robot.ik_path(targets, frame, start_of)
        few = len(careful)
        with monkeypatch.context() as slow:
            slow.setattr(PathSteps, "follow_plain_targets", lambda self, out, i, before: i)
            other = robot.ik_path(targets, frame, start_of)
        assert fast.status == other.status and few < len(careful) - few
        assert few == 0 or targets is line
        np.testing.assert_allclose(fast.q, other.q, atol=1e-9)
