"""The inverse model through the public face, judged by independent forward passes and closed forms."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

import kempe
from kempe import Mechanism
from kempe.errors import InputError, NoSolutionError, UnknownNameError, UnsupportedError
from kempe.inverse.chain.serial_chain import find_chain
from kempe.status import Status


def two_link(l1=1.0, l2=0.7, limits=None):
    arm = Mechanism("two-link", dim=2)
    upper = arm.body("upper")
    lower = arm.body("lower")
    arm.revolute("q1", arm.ground, upper)
    arm.revolute("q2", upper, lower, at=(l1, 0), limits=limits)
    arm.frame("tip", lower, at=(l2, 0))
    return arm.build()


def tip(q, l1=1.0, l2=0.7):
    return np.array(
        [l1 * np.cos(q[0]) + l2 * np.cos(q[0] + q[1]), l1 * np.sin(q[0]) + l2 * np.sin(q[0] + q[1])]
    )


def spatial_arm(n=6, seed=1, limits=None):
    """A chain of n joints in random directions; every third one slides."""
    rng = np.random.default_rng(seed)
    arm = Mechanism(f"random{n}")
    last = arm.ground
    for i in range(n):
        body = arm.body(f"b{i}")
        at = rng.uniform(-0.4, 0.4, 3)
        rpy = rng.uniform(-2, 2, 3)
        axis = rng.normal(size=3)
        if i % 3 == 2:
            arm.prismatic(f"j{i}", last, body, at=at, rpy=rpy, axis=axis, limits=(-0.3, 0.3))
        else:
            arm.revolute(f"j{i}", last, body, at=at, rpy=rpy, axis=axis, limits=limits)
        last = body
    arm.frame("tool", last, at=(0.1, 0.2, 0.3))
    return arm.build()


def angle_between(A, B):
    """Angle of R_A^T R_B from its skew and trace parts, accurate near zero."""
    R = np.swapaxes(A[..., :3, :3], -1, -2) @ B[..., :3, :3]
    skew = np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    return np.arctan2(np.linalg.norm(skew, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1.0)


@given(r=st.floats(0.31, 1.69), phi=st.floats(-3.1, 3.1))
@settings(max_examples=examples(200), deadline=None)
def test_two_link_agrees_with_the_closed_form(r, phi):
    p = np.array([r * math.cos(phi), r * math.sin(phi)])
    s = two_link().ik(p, "tip")
    assert s.success
    c2 = (r * r - 1.0 - 0.49) / 1.4
    np.testing.assert_allclose(abs(math.remainder(s.q[1], 2 * math.pi)), math.acos(c2), atol=1e-5)
    np.testing.assert_allclose(tip(s.q), p, atol=1e-6)


@pytest.mark.parametrize("limits, sign", [((-math.pi, 0.0), -1), ((0.0, math.pi), 1)])
def test_limits_choose_elbow_up_or_down(limits, sign):
    s = two_link(limits=limits).ik([0.9, 0.4], "tip")
    assert s.success and np.sign(math.sin(s.q[1])) == sign


@pytest.mark.parametrize(
    "p, distance", [((3.0, 0.0), 1.3), ((0.0, -2.5), 0.8), ((0.1, 0.0), 0.2), ((0.0, 0.0), 0.3)]
)
def test_unreachable_points_say_how_far_outside_they_are(p, distance):
    s = two_link().ik(p, "tip")
    assert s.success is False and s.code == Status.OUT_OF_REACH and not s
    assert f"outside the workspace by at least {distance:g} m" in s.status
    # the nearest configuration is the true one
    np.testing.assert_allclose(s.position_error, distance, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(tip(s.q) - p), distance, atol=1e-6)
    with pytest.raises(NoSolutionError, match="outside the workspace"):
        two_link().ik(p, "tip").expect()


@pytest.mark.parametrize("p", [(1.7, 0.0), (0.0, 1.7), (-0.3, 0.0)])
def test_boundary_of_the_workspace_is_reached(p):
    s = two_link().ik(p, "tip")
    assert s.success and s.position_error <= 1e-6


def test_a_limit_that_blocks_is_named():
    s = two_link(limits=(-2.0, -0.5)).ik([1.7, 0.0], "tip")
    assert s.code == Status.NOT_FOUND and "blocked by the limit of 'q2'" in s.status
    assert -2.0 <= s.q[1] <= -0.5
    s = two_link(limits=(-2.0, -0.5)).ik([9.0, 0.0], "tip")
    assert "outside the workspace" in s.status and s.q[1] == pytest.approx(-0.5)


def three_links(limits):
    m = Mechanism("three links", dim=2)
    last = m.ground
    for i, (length, bounds) in enumerate(zip((0.0, 1.0, 0.7), limits, strict=True)):
        link = m.body(f"link{i}")
        m.revolute(f"q{i}", last, link, at=(length, 0.0), limits=bounds)
        last = link
    m.frame("tip", last, at=(0.2, 0.0))
    return m.build()


def test_limits_that_block_together_are_named():
    """A pose has two solutions, elbow up and down; each limit that is lifted alone leaves both of
    them shut off.
    """
    up = np.array([0.3, 0.9, -0.4])
    free = three_links([(-3.0, 3.0)] * 3)
    X = free.fk(up, "tip")
    down = free.ik(X, "tip", start=[1.0, -0.9, 0.7]).q
    assert np.abs(down - up).min() > 0.1
    limits = [(-3.0, 3.0)] * 3
    limits[0] = tuple(0.5 * (up[0] + down[0]) + np.array([-0.05, 0.05]))  # shuts both off
    limits[1] = (down[1] + 0.05, 3.0)  # the second one
    limits[2] = (up[2] + 0.05, 3.0) if down[2] > up[2] else (-3.0, up[2] - 0.05)  # the first one
    s = three_links(limits).ik(X, "tip")
    assert s.code == Status.NOT_FOUND and not s
    assert "blocked by the limits of 'q0' and 'q2' together" in s.status


@pytest.mark.parametrize("name", ["iiwa14", "stanford", "ur10e"])
def test_nothing_is_proven_against_what_can_be_reached(name):
    robot = kempe.load(name)
    frame = robot.frame_names[-1]
    assert robot.ik(robot.fk(robot.random(0, 500), frame), frame).success.all()


@pytest.mark.parametrize("below", [0.01, 0.03, 0.1, 0.24])
def test_a_pose_may_be_proven_out_of_reach_by_its_last_axis(below):
    """Shoulder and wrist centre of the iiwa are never farther apart than 0.42 m + 0.4 m."""
    robot = kempe.load("iiwa14")
    radius = 0.82
    frame = robot.frame_names[-1]
    bound = min(b.largest for b in find_chain(robot, frame).bounds)
    assert bound == pytest.approx(radius, abs=1e-12)
    far = np.eye(4)
    far[:3, 3] = [0.0, 0.0, 0.36 + radius + 0.126 - below]  # the wrist is inside the sphere
    assert robot.ik(far, frame).success
    far[:3, :3] = np.diag([1.0, -1.0, -1.0])  # looking down, the wrist is 0.126 m above the flange
    s = robot.ik(far, frame)
    assert s.code == Status.OUT_OF_REACH
    assert (
        f"outside the workspace with this orientation by at least {2 * 0.126 - below:.3g} m"
        in s.status
    )
    position = robot.ik(far[:3, 3].copy(), frame)
    assert position.success


def test_more_equations_than_freedoms_is_said():
    robot = two_link()
    X = robot.fk([0.3, -0.8], "tip")
    assert robot.ik(X, "tip").success
    X[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]]
    s = robot.ik(X, "tip")
    assert not s.success
    assert (
        "3 equations" in s.status
        and "2 freedoms" in s.status
        and "position alone can be reached" in s.status
    )
    s = robot.ik(X, "tip", task="position")
    assert s.success and s.orientation_error == 0


def test_a_target_outside_the_plane_is_said():
    robot = two_link()
    X = robot.fk([0.3, -0.8], "tip")
    X[2, 3] = 0.25
    s = robot.ik(X, "tip")
    assert not s.success and "plane" in s.status
    np.testing.assert_allclose(s.position_error, 0.25, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_random_spatial_chains_reach_what_they_can_reach(seed):
    robot = spatial_arm(7, seed, limits=(-2.0, 2.5))
    q = robot.random(seed, 300)
    X = robot.fk(q, "tool")
    s = robot.ik(X, "tool")
    Y = robot.fk(s.q, "tool")
    assert s.success.all()
    assert np.linalg.norm(Y[:, :3, 3] - X[:, :3, 3], axis=-1).max() <= 1e-6
    assert angle_between(X, Y).max() <= 1e-6
    assert (s.q >= robot.lower).all() and (s.q <= robot.upper).all()


def test_answers_do_not_depend_on_threads_or_on_the_rest_of_the_batch():
    robot = spatial_arm(7, 2)
    X = robot.fk(robot.random(5, 700), "tool")
    one, two, five = (robot.ik(X, "tool", budget=kempe.Budget(threads=n)) for n in (1, 2, 5))
    assert np.array_equal(one.q, two.q) and np.array_equal(one.q, five.q)
    assert np.array_equal(one.q, robot.ik(X, "tool").q)
    assert np.array_equal(one.q[:1], robot.ik(X[:1], "tool").q)
    other = robot.ik(X, "tool", budget=kempe.Budget(rng=1))
    assert other.success.all() and not np.array_equal(one.q, other.q)


def test_shapes_follow_the_targets():
    robot = spatial_arm(6)
    X = robot.fk(robot.random(0, (2, 3)), "tool")
    s = robot.ik(X, "tool")
    assert s.q.shape == (
        2,
        3,
        robot.nq,
    ) and s.success.shape == s.starts.shape == s.residual.shape == (2, 3)
    assert s.status.shape == (2, 3) and s.status[0, 0].startswith("reached")
    assert robot.ik(X[:0], "tool").q.shape == (0, 3, robot.nq)
    single = robot.ik(X[0, 0], "tool")
    assert (
        single.q.shape == (robot.nq,)
        and single.success is True
        and isinstance(single.iterations, int)
    )
    assert str(single).startswith("reached") and "j0 = " in str(single)


def test_a_bad_row_leaves_the_others_alone():
    robot = spatial_arm(6)
    X = robot.fk(robot.random(0, 4), "tool")
    good = robot.ik(X, "tool")
    spoilt = X.copy()
    spoilt[1, 0, 3] = np.nan
    spoilt[2, :3, :3] = 2.0 * np.eye(3)
    s = robot.ik(spoilt, "tool")
    assert s.code.tolist() == [Status.SOLVED, Status.BAD_INPUT, Status.BAD_INPUT, Status.SOLVED]
    assert np.isnan(s.q[1:3]).all() and np.array_equal(s.q[[0, 3]], good.q[[0, 3]])


def test_bad_single_arguments_raise():
    robot = spatial_arm(6)
    X = robot.fk(robot.neutral, "tool")
    bad = X.copy()
    bad[0, 0] = np.nan
    with pytest.raises(InputError, match="must be finite"):
        robot.ik(bad, "tool")
    with pytest.raises(InputError, match="orthonormal"):
        robot.ik(np.diag([2.0, 1, 1, 1]), "tool")
    with pytest.raises(InputError, match=r"shape \(5,\); it must be a pose"):
        robot.ik(np.zeros(5), "tool")
    with pytest.raises(UnknownNameError, match="did you mean 'tool'"):
        robot.ik(X, "tol")
    with pytest.raises(InputError, match="6"):
        robot.ik(X, "tool", start=np.zeros(5))
    for keyword in (
        {"budget": kempe.Budget(starts=0)},
        {"tolerance": -1.0},
        {"tolerance": (1e-6, math.nan)},
    ):
        with pytest.raises(InputError):
            robot.ik(X, "tool", **keyword)


def test_the_seed_decides_the_branch_and_keeps_what_the_chain_does_not_move():
    m = two_link().mechanism
    m.revolute("aside", m.ground, m.body("other"), limits=(-1.0, 1.0))
    robot = m.build()
    for q2 in (-1.0, 1.0):
        s = robot.ik([0.9, 0.4], "tip", start={"q1": 0.0, "q2": q2, "aside": 0.7})
        assert s.success and s.starts == 1 and np.sign(s.q[1]) == np.sign(q2) and s.q[2] == 0.7
    assert robot.ik([0.9, 0.4], "tip", start={"aside": 5.0}).q[2] == 1.0
    assert robot.ik([0.9, 0.4], "tip").q[2] == 0.0


def test_a_warm_start_stays_near():
    robot = spatial_arm(7, 3)
    q = robot.random(1, 200)
    near = q + np.random.default_rng(0).normal(scale=0.01, size=q.shape)
    s = robot.ik(robot.fk(q, "tool"), "tool", start=near)
    assert s.success.all() and (s.starts == 1).mean() > 0.95
    assert np.median(np.linalg.norm(s.q - near, axis=-1)) < 0.1


def test_mimic_and_locked_joints_inside_the_chain():
    m = Mechanism("curl", dim=2)
    last = m.ground
    for i in range(4):
        body = m.body(f"b{i}")
        m.revolute(f"j{i}", last, body, at=(0.3 if i else 0.0, 0))
        last = body
    m.frame("tip", last, at=(0.3, 0))
    m.gear("j2", "j1", -0.5, 0.2)
    m.lock({"j3": 0.4})
    robot = m.build()
    assert robot.coordinate_names == ("j0", "j1")
    q = robot.random(0, 100)
    s = robot.ik(robot.fk(q, "tip")[..., :2, 3], "tip")
    assert s.success.all()
    angles = np.cumsum(
        np.stack([s.q[:, 0], s.q[:, 1], -0.5 * s.q[:, 1] + 0.2, np.full(100, 0.4)], -1), axis=-1
    )
    p = 0.3 * np.stack([np.cos(angles).sum(-1), np.sin(angles).sum(-1)], -1)
    np.testing.assert_allclose(p, robot.fk(q, "tip")[:, :2, 3], atol=1e-6)


def test_quaternion_chain():
    m = Mechanism("ball and arm")
    a = m.body("a")
    b = m.body("b")
    m.spherical("shoulder", m.ground, a)
    m.revolute("elbow", a, b, at=(0.4, 0, 0), axis=(0, 1, 0), limits=(0.0, 2.5))
    m.frame("hand", b, at=(0.3, 0, 0))
    robot = m.build()
    q = robot.random(0, 200)
    s = robot.ik(robot.fk(q, "hand")[:, :3, 3], "hand")
    assert s.success.all()
    np.testing.assert_allclose(np.linalg.norm(s.q[:, :4], axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(
        robot.fk(s.q, "hand")[:, :3, 3], robot.fk(q, "hand")[:, :3, 3], atol=1e-6
    )


def test_a_frame_that_nothing_moves():
    m = Mechanism("post")
    m.frame("top", m.ground, at=(0, 0, 1))
    m.revolute("j", m.ground, m.body("arm"))
    robot = m.build()
    assert robot.ik([0.0, 0, 1], "top").success
    s = robot.ik([0.0, 0, 3], "top")
    assert not s.success and s.position_error == pytest.approx(2.0)


def test_loops_and_relations_hold_where_the_frame_moves_with_them():
    m = Mechanism("four-bar and arm", dim=2)
    a, b, c, arm = (m.body(n) for n in ("a", "b", "c", "arm"))
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, c, at=(2, 0), child_at=(1, 0))
    m.revolute("D", m.ground, c, at=(2, 0))
    m.revolute("E", m.ground, arm, at=(0, 5))
    m.frame("tip", arm, at=(1, 0))
    robot = m.build()
    pose = robot.fk(robot.assemble({"A": 0.7}).q, "b")
    s = robot.ik(pose, "b")
    assert s.success and np.abs(robot.loops.closure_error(s.q)).max() < 1e-9
    assert robot.q_dict(s.q)["A"] == pytest.approx(0.7, abs=1e-6)
    assert not robot.ik([0.0, 1.5], "b")
    assert robot.ik([0.0, 6.0], "tip").success
    with pytest.raises(UnsupportedError, match="loop"):
        robot.ik(pose, "b", method="analytic")
    m.couple("E", {"A": 1.0, "B": 1.0})
    robot = m.build()
    s = robot.ik([math.cos(0.5), 5.0 + math.sin(0.5)], "tip")
    q = robot.q_dict(s.q)
    assert s.success and q["A"] + q["B"] == pytest.approx(0.5, abs=1e-6) == q["E"]
    assert not robot.ik([0.0, 6.0], "tip")  # the coupler of this bar turns by 60 degrees at most


@pytest.mark.parametrize("scale", [1e-3, 1.0, 100.0])
def test_scale_of_the_robot_does_not_matter(scale):
    robot = two_link(scale, 0.7 * scale)
    s = robot.ik([0.9 * scale, 0.4 * scale], "tip", tolerance=1e-9 * scale)
    assert s.success


def test_renaming_and_reordering_do_not_change_the_answer():
    def build(order, names):
        m = Mechanism("arm")
        for i in order:
            m.body(names[i])
        for i in order:
            parent = m.ground if i == 0 else names[i - 1]
            m.revolute(
                f"{names[i]}_joint",
                parent,
                names[i],
                at=(0.2, 0.1 * i, 0.3),
                axis=(i % 2, 1 - i % 2, 0.3 * i),
            )
        return m.build()

    plain, renamed, mixed = (
        build(o, n)
        for o, n in (
            (range(6), "abcdef"),
            (range(6), ["x", "y", "z", "u", "v", "w"]),
            ([3, 1, 5, 0, 4, 2], "abcdef"),
        )
    )
    X = plain.fk(plain.random(0), "f")
    s = plain.ik(X, "f")
    assert np.array_equal(s.q, renamed.ik(X, "w").q)
    assert plain.q_dict(s.q) == mixed.q_dict(mixed.ik(X, "f").q)


def test_an_answer_can_be_pickled_and_shown():
    s = two_link().ik([3.0, 0.0], "tip")
    again = pickle.loads(pickle.dumps(s))
    assert again.status == s.status and np.array_equal(again.q, s.q)
    assert "outside the workspace" in s._repr_html_()


def test_work_is_counted():
    robot = spatial_arm(7, 2)
    s = robot.ik(robot.fk(robot.random(0, 300), "tool"), "tool")
    assert np.median(s.iterations) <= 30 and np.median(s.starts) <= 2
    assert robot.ik([50.0, 0, 0], "tool", budget=kempe.Budget(starts=7)).starts == 7


def test_transposed_pose_is_refused_as_target():
    robot = kempe.load("puma560")
    X = robot.fk(robot.q("qn"), "tool")
    with pytest.raises(InputError, match="its last row is"):
        robot.ik(X.T, "tool")
    batch = robot.ik(np.stack([X, X.T]), "tool")
    assert batch.success.tolist() == [True, False] and np.isnan(batch.q[1]).all()
    with pytest.raises(InputError, match="real numbers"):
        robot.ik(X.astype(complex), "tool")


def test_orientation_of_a_particle_is_refused_as_target():
    system = kempe.Mechanism("particle")
    system.translation("t", system.ground, system.particle("p"))
    built = system.build()
    target = np.diag([-1.0, -1.0, 1.0, 1.0])
    with pytest.raises(InputError, match="particle"):
        built.ik(target, "p")
    assert (
        built.ik(target, "p", task="position")
        and built.ik(np.eye(4), "p")
        and built.ik([1.0, 2.0, 3.0], "p")
    )


@pytest.mark.parametrize("joint", ["q1", "q3"])
def test_limit_is_the_reason_even_where_the_task_has_more_equations_than_freedoms(joint):
    robot = kempe.load("cobra600")
    i = robot.coordinate_names.index(joint)
    q = robot.mid.copy()
    q[i] = robot.upper[i] + 0.05
    assert f"blocked by the limit of '{joint}'" in robot.ik(robot.fk(q, "tool"), "tool").status


def test_wrong_arguments_are_named():
    robot = kempe.load("puma560")
    target = robot.fk(robot.q("qn"), "tool")
    with pytest.raises(InputError, match="starts is"):
        robot.ik(target, "tool", budget=kempe.Budget(starts=10**30))
    with pytest.raises(
        InputError, match=r"leading shapes do not fit together: \(3,\) of target, \(2,\) of start"
    ):
        robot.ik(np.stack([target] * 3), "tool", start=np.zeros((2, 6)))
    with pytest.raises(kempe.KempeError, match="frame of expression"):
        robot.jacobian(robot.neutral, "tool", ["body"])
    assert robot.ik(target, "tool", tolerance=np.array([1e-6, 1e-6]))


@pytest.mark.parametrize(
    ("p", "distance"), [((0.5, 0.0, 0.0), 0.5), ((0.0, 0.0, -3.0), 2.0), ((2.0, 2.0, 1.0), 2.0)]
)
def test_a_ball_joint_leads_a_point_on_a_sphere(p, distance):
    """No axis of it stays where it is, so that the lengths about an axis that turns say nothing
    there.
    """
    m = Mechanism("ball")
    rod = m.body("rod")
    m.spherical("S", m.ground, rod)
    m.frame("tip", rod, (0.0, 0.0, 1.0))
    s = m.build().ik(p, "tip")
    assert (
        s.code == Status.OUT_OF_REACH
        and f"outside the workspace by at least {distance:g} m" in s.status
    )
    np.testing.assert_allclose(s.position_error, distance, atol=1e-6)


def test_starts_and_targets_broadcast():
    """Each answer of a batch is the answer to its pair alone; the elbow is on the side on which its
    start is.
    """
    arm = kempe.load("two_link")
    starts = np.stack([np.full(9, 0.5), np.linspace(-1.0, 1.1, 9)], axis=-1)
    p = np.array([[0.6, 0.3], [0.4, -0.5]])
    many = arm.ik(p[:, None], "e", start=starts)
    assert many.q.shape == (2, 9, 2) and many.success.all()
    for i, j in np.ndindex(2, 9):
        np.testing.assert_array_equal(many.q[i, j], arm.ik(p[i], "e", start=starts[j]).q)
    assert arm.ik(p[0], "e", start=np.zeros((0, 2))).q.shape == (0, 2)


def test_names_stand_for_starts_and_targets():
    arm = kempe.load("two_link")
    p = arm.fk(arm.neutral, "p")[:2, 3]
    np.testing.assert_array_equal(
        arm.ik(p, "e", start="elbow_up").q, arm.ik(p, "e", start=arm.q("elbow_up")).q
    )
    np.testing.assert_array_equal(arm.ik("p", "e", task="position").q, arm.ik(p, "e").q)
    assert len(arm.ik_all("p", "e", task="position")) == 2
    with pytest.raises(InputError, match="'e', which moves"):
        arm.ik("e", "e")
    with pytest.raises(kempe.KempeError, match="no frame 'x'"):
        arm.ik("x", "e")
    with pytest.raises(kempe.KempeError, match="no posture 'x'"):
        arm.ik(p, "e", start="x")


@pytest.mark.parametrize(
    ("name", "frame"), [("puma560", "tool"), ("panda", "panda_hand_tcp"), ("two_link", "e")]
)
def test_a_history_leads_from_the_start_to_the_answer(name, frame):
    robot = kempe.load(name)
    q0 = robot.random(1)
    X = robot.fk(robot.random(2), frame)
    target = X if robot.dim == 3 else X[:2, 3]
    s = robot.ik(target, frame, start=q0, history=True)
    history = s.history
    np.testing.assert_array_equal(s.q, robot.ik(target, frame, start=q0).q)
    np.testing.assert_array_equal(history.q[-1], s.q)
    np.testing.assert_allclose(history.q[0], q0, rtol=0, atol=1e-12)
    assert history.start[-1] == s.starts - 1 and (np.diff(history.start) >= 0).all()
    Y = robot.fk(history.q, frame)
    np.testing.assert_allclose(
        history.position_error, np.linalg.norm(Y[:, :3, 3] - X[:3, 3], axis=-1), atol=1e-12
    )
    energy = history.position_error**2 + history.orientation_error**2
    assert energy[-1] < 1e-12 < energy[0] and str(history).startswith(
        f"{len(history.q) - s.starts} steps of "
    )


def test_a_history_of_what_converges_not_at_first():
    """Stretched, the arm is singular: the first start is stuck; of a target out of reach no start
    arrives.
    """
    arm = kempe.load("two_link")
    s = arm.ik([-0.6, 0.0], "e", start=[0.0, 0.0], history=True)
    assert s and s.starts > 1 and (s.history.position_error[s.history.start == 0] > 1.4).all()
    far = kempe.load("unreachable").ik([0.8, 0.6], "e", history=True)
    assert not far and far.history.starts == 1000 and far.history.start.max() == 63
    assert "the first 64 of 1000" in far.history.status
    axes = s.plot_history()
    assert {line.get_gid() for line in axes.lines} == {f"position:{k}" for k in range(s.starts)}
    for call in (
        lambda: arm.ik([[0.6, 0.3]], "e", history=True),
        lambda: arm.ik([0.6, 0.3], "e").plot_history(),
        lambda: arm.ik([0.6, 0.3], "e", method="analytic", history=True),
        lambda: arm.ik([kempe.tasks.Position("e", [0.6, 0.3])], history=True),
    ):
        with pytest.raises(InputError, match="history"):
            call()
