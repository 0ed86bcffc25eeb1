"""Public reports about serial arms: tables of their rows, poses with published solutions, singular
configurations.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from public_oracles import (
    PI,
    at,
    dh,
    inside,
    modified_dh,
    nearest,
    pose_error,
    product,
    rpy,
    turn,
    without_limits,
)
from scipy.optimize import least_squares

import kempe
from kempe import Mechanism, System, tasks

# ---- tables of Denavit and Hartenberg

XB25 = {
    "alpha": [0, -PI / 2, 0, -PI / 2, PI / 2, -PI / 2],
    "a": [0, 0.16, 0.78, 0.15, 0, 0],
    "offset": [0, -PI / 2, 0, 0, 0, PI],
    "d": [0.49, 0, 0, 0.66, 0, 0.11],
}


def test_a_tool_down_pose_of_a_rokae_arm_has_its_published_solution():
    """robotics-toolbox-python, issue 440: modified DH rows of an XB25; one solver failed where
    another one did not.
    """
    rows = [{name: column[i] for name, column in XB25.items()} for i in range(6)]
    s = kempe.from_dh(rows, convention="modified", name="xb25").build()

    def pose(q):
        return product(
            modified_dh(r["alpha"], r["a"], v + r["offset"], r["d"])
            for r, v in zip(rows, q, strict=True)
        )

    q = np.random.default_rng(0).uniform(-2, 2, 6)
    np.testing.assert_allclose(s.fk(q, "tool"), pose(q), atol=1e-12)
    down = at(0.2834, 0.2788, 0.3) @ turn("y", PI)
    answer = s.ik(down, "tool")
    answers = s.ik_all(down, "tool")
    assert answer and pose_error(pose(answer.q), down) < 1e-6
    assert len(answers) > 0 and max(pose_error(pose(v), down) for v in answers.q) < 1e-8
    assert nearest(answers.q, [0.7772, 0.9013, 1.479, 0, -0.8091, 0.7772]) < 2e-3


def test_columns_of_a_table_are_not_mixed_up():
    """pybotics, issue 765: UR10 rows are (alpha, a, theta, d) in millimetres; who expects another
    order must say so.
    """
    rows = [
        [0, 0, 0, 118],
        [PI / 2, 0, PI, 0],
        [0, 612.7, 0, 0],
        [0, 571.6, 0, 163.9],
        [-PI / 2, 0, 0, 115.7],
        [PI / 2, 0, PI, 92.2],
    ]
    s = kempe.from_dh(
        rows, convention="modified", columns=("alpha", "a", "theta", "d"), name="ur10"
    ).build()
    q = np.array([0.1, -0.5, 0.7, 0.3, 0.9, -0.2])
    X = product(
        modified_dh(alpha, a, v + theta, d) for (alpha, a, theta, d), v in zip(rows, q, strict=True)
    )
    np.testing.assert_allclose(s.fk(q, "tool"), X, atol=1e-9)
    answers = s.ik_all(X, "tool")
    assert len(answers) == 8 and max(pose_error(s.fk(v, "tool"), X) for v in answers.q) < 1e-6
    with pytest.raises(kempe.KempeError):
        kempe.from_dh(rows, convention="modified")  # 612.7 would be an angle


def test_an_elbow_beside_its_link_becomes_an_offset_of_the_angle():
    """Robotics Stack Exchange, question 19160: the 24 mm of an OpenManipulator-X; expected is
    (0.024, 0, 0.455).
    """
    m = Mechanism("open manipulator")
    before = m.ground
    places = [
        ((0, 0, 0), "z"),
        ((0, 0, 0.077), "y"),
        ((0.024, 0, 0.128), "y"),
        ((0.124, 0, 0), "y"),
    ]
    for i, (place, axis) in enumerate(places, 1):
        body = m.body(f"l{i}")
        m.revolute(f"j{i}", before, body, at=place, axis=axis)
        before = body
    m.frame("tip", before, at=(0.126, 0, 0))
    s = m.build()
    np.testing.assert_allclose(s.fk({"j3": -PI / 2}, "tip")[:3, 3], [0.024, 0, 0.455], atol=1e-12)
    length = math.hypot(0.024, 0.128)
    angle = math.atan2(0.128, 0.024)
    links = [{"a": length, "offset": -angle}, {"a": 0.124, "offset": angle}, {"a": 0.126}]
    table = kempe.from_dh([{"d": 0.077, "alpha": -PI / 2}, *links]).build()
    for seed in range(20):
        q = np.random.default_rng(seed).uniform(-1, 1, 4)
        np.testing.assert_allclose(s.fk(q, "tip")[:3, 3], table.fk(q, "tool")[:3, 3], atol=1e-12)
    q = np.array([0.3, 0.4, -0.6, 0.5])
    answers = s.ik_all(s.fk(q, "tip"), "tip")
    assert min(np.abs(v - q).max() for v in answers.q) < 1e-6, answers.status


KASSOW = [
    (0.3571, 0.062, -PI / 2, (-2 * PI, 2 * PI)),
    (0.1052, -0.062, PI / 2, (-1.22173, PI)),
    (0.9225, 0.05, -PI / 2, (-2 * PI, 2 * PI)),
    (-0.0857, -0.05, PI / 2, (-1.22173, PI)),
    (0.8775, 0, -PI / 2, (-2 * PI, 2 * PI)),
    (0.111, 0, PI / 2, (-2 * PI, 2 * PI)),
    (0.108, 0, 0, (-2 * PI, 2 * PI)),
]


def test_seven_joints_with_offsets_and_limits_reach_their_poses():
    """robotics-toolbox-python, issue 479: rows of a Kassow KR810; a solver found nothing for poses
    within reach.
    """
    s = kempe.from_dh(
        [{"d": d, "a": a, "alpha": alpha, "limits": ends} for d, a, alpha, ends in KASSOW]
    ).build()

    def pose(q):
        return product(dh(v, *row[:3]) for row, v in zip(KASSOW, q, strict=True))

    for seed in range(200):
        X = pose(s.random(seed))
        answer = s.ik(X, "tool")
        assert answer and pose_error(pose(answer.q), X) < 1e-6 and inside(s, answer.q), seed
    published = np.deg2rad([-170.9, 6, -150])
    for X in (
        rpy(*published),
        turn("x", published[0]) @ turn("y", published[1]) @ turn("z", published[2]),
    ):
        X[:3, 3] = 1.61637, 0.114284, -0.245724
        answer = s.ik(X, "tool")
        assert bool(answer) == (pose_error(pose(answer.q), X) < 1e-6)


def test_five_joints_hold_a_direction_where_they_hold_no_pose():
    """Robotics Stack Exchange: five joints (d 63.5, 90, 100 mm, a 400, 200 mm), tool down at (550,
    90, 0).
    """
    alpha = np.deg2rad([-90, 0, 0, 90, 0])
    a = [0, 400, 200, 0, 0]
    d = [63.5, 0, 0, 90, 100]
    s = kempe.from_dh(
        [{"d": d[i], "a": a[i], "alpha": alpha[i]} for i in range(5)], name="five"
    ).build()

    def pose(q):
        return product(dh(q[i], d[i], a[i], alpha[i]) for i in range(5))

    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(s.fk(q, "tool"), pose(q), atol=1e-9)
    down = at(550, 90, 0) @ turn("x", PI)
    pointing = [tasks.Position("tool", (550, 90, 0)), tasks.Pointing("tool", (0, 0, -1))]
    full = s.ik(down, "tool")
    place = s.ik(down, "tool", task="position")
    direction = s.ik(pointing)
    assert full and pose_error(pose(full.q), down) < 1e-6
    for answer in (place, direction):
        assert answer and np.linalg.norm(pose(answer.q)[:3, 3] - down[:3, 3]) < 1e-6
    np.testing.assert_allclose(pose(direction.q)[:3, 2], [0, 0, -1], atol=1e-9)
    # the last axis lies in a vertical plane 90 mm from the first axis; tilted about x, it would
    # need one at 550 mm
    assert not s.ik(down @ turn("x", 0.3), "tool")


# ---- one arm and its factory calibration

UR3 = {"d": [0.1519, 0, 0, 0.11235, 0.08535, 0.0819], "a": [0, -0.24365, -0.21325, 0, 0, 0],
       "alpha": [PI / 2, 0, 0, PI / 2, -PI / 2, 0]}  # fmt: skip
CALIBRATION = {
    "offset": [
        9.14361764983717684e-08,
        0.178461025123001604,
        6.68283349819805572,
        -0.578116982609792496,
        6.11299818305960363e-06,
        -5.03926212855332345e-07,
    ],
    "a": [
        -0.000243788991999517813,
        0.00381165418642351317,
        0.034503078453104935,
        0.000107694612896758047,
        -0.000198736633205663144,
        0,
    ],
    "d": [
        9.225352853908797e-05,
        12.0620003757611567,
        17.6719025641737275,
        -29.7339960369544869,
        -2.8164617795367608e-05,
        0.000217420471082099831,
    ],
    "alpha": [
        0.00115615746589403656,
        0.0035851898103369975,
        0.00392132336586574568,
        0.000406668888106365145,
        -0.00201170396009153762,
        0,
    ],
}
"""A published calibration of a UR3: axes 2, 3 and 4 are not parallel any more, and are metres apart
along them."""


def ur3(calibrated: bool) -> tuple[System, Callable[[np.ndarray], np.ndarray]]:
    """The robot, and its poses by the product of its rows."""
    none = [0.0] * 6
    added = CALIBRATION if calibrated else dict.fromkeys(CALIBRATION, none)
    columns = {name: np.add(UR3.get(name, none), added[name]) for name in added}
    rows = [{name: float(column[i]) for name, column in columns.items()} for i in range(6)]
    built = kempe.from_dh(rows, name="ur3").build()

    def pose(q: np.ndarray) -> np.ndarray:
        return product(
            dh(v + r["offset"], r["d"], r["a"], r["alpha"]) for r, v in zip(rows, q, strict=True)
        )

    return built, pose


def test_an_offset_of_more_than_a_turn_is_read():
    """pyrobotlab, issue 145; ur5_isaac_simulation, issue 4: delta_theta of the third joint is
    6.6828 rad.
    """
    s, pose = ur3(calibrated=True)
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    np.testing.assert_allclose(s.fk(q, "tool"), pose(q), atol=1e-12)


@pytest.mark.slow
def test_a_calibrated_arm_keeps_its_solutions():
    """ik-geo, issue 32; Universal Robots driver, issue 317: does the inverse of a calibrated UR3
    lose solutions?
    """
    s, pose = ur3(calibrated=True)
    nominal, _ = ur3(calibrated=False)
    rng = np.random.default_rng(0)
    for case in range(60):
        q = rng.uniform(-2.8, 2.8, 6)
        X = pose(q)
        answer = s.ik(X, "tool")
        answers = s.ik_all(X, "tool")
        assert answer and pose_error(pose(answer.q), X) < 1e-6, case
        assert (
            max(pose_error(pose(v), X) for v in answers.q) < 1e-6 and nearest(answers.q, q) < 1e-5
        ), case
        for v in nominal.ik_all(X, "tool").q if case < 20 else ():
            polished = least_squares(
                lambda z, X=X: (pose(z) - X)[:3].ravel(), v, xtol=1e-15, ftol=1e-15, gtol=1e-15
            )
            assert polished.cost > 1e-18 or nearest(answers.q, polished.x) < 1e-4, case


# ---- single poses of well-known robots


def test_a_pose_of_a_gen3_is_reached_within_a_turn():
    """robotics-toolbox-python, issue 431: identity orientation at (0.4, 0, 0.6); solvers reported
    no success.
    """
    s = kempe.load("gen3")
    X = at(0.4, 0, 0.6)
    answer = s.ik(X, "tool")
    assert answer and pose_error(s.fk(answer.q, "tool"), X) < 1e-6
    assert np.abs(answer.q).max() < 2 * PI + 1e-9


def test_a_tool_ten_centimetres_longer_is_undone_on_the_right_side():
    """robotics-toolbox-python, issues 640 and 491: a Puma 560 with a tool; is its length undone
    along the tool?
    """
    plain = kempe.load("puma560")
    m = kempe.read("puma560")
    last = plain.body_names[-1]
    flange = plain.fk(plain.neutral, last)
    tool = plain.fk(plain.neutral, "tool")
    m.frame("tip", last, at=np.linalg.inv(flange) @ tool @ at(0, 0, 0.1))
    s = m.build()
    for seed in range(200):
        X = plain.fk(s.random(seed), "tool") @ at(0, 0, 0.1)
        answers = s.ik_all(X, "tip")
        assert answers.inside.any(), seed
        assert max(pose_error(plain.fk(v, "tool") @ at(0, 0, 0.1), X) for v in answers.q) < 1e-7, (
            seed
        )


def test_a_panda_reaches_a_shifted_pose_inside_its_limits():
    """pinocchio, issue 1626: a pose moved by -0.4 m; the example's solver left the limits. Is it
    within them?
    """
    s = kempe.load("panda")
    q = [
        -8.60531747e-01,
        1.48915422,
        1.47712374,
        -6.70803905e-01,
        3.77983612e-04,
        3.00506473,
        7.79607475e-01,
    ]
    X = s.fk(q, "tool").copy()
    X[0, 3] -= 0.4
    answer = s.ik(X, "tool")
    assert answer and inside(s, answer.q) and pose_error(s.fk(answer.q, "tool"), X) < 1e-6


def test_a_pose_out_of_reach_of_a_ur5_is_proven():
    """pinocchio, issue 1618: identity orientation at (1, 0, 1); the iteration never converged. Is
    that reachable?
    """
    longest = 0.425 + 0.39225 + math.hypot(0.10915, 0.09465) + 0.0823
    assert np.linalg.norm([1, 0, 1 - 0.089159]) > longest  # the distance from the shoulder
    answer = kempe.load("ur5").ik(at(1, 0, 1), "tool")
    assert not answer and answer.code.proof, answer.status


def test_all_solutions_of_a_pose_with_the_tool_nearly_down():
    """openrave, issue 1334: a given pose of a UR5; generated formulas said that the fifth angle is
    always zero.
    """
    s = without_limits(kempe.load("ur5"))
    X = np.eye(4)
    X[:3] = [
        [0.04071115, -0.99870914, 0.03037599, 0.4720009],
        [-0.99874455, -0.04156303, -0.02796067, 0.12648243],
        [0.0291871, -0.02919955, -0.99914742, 0.43451169],
    ]
    answers = s.ik_all(X, "tool")
    assert len(answers) >= 4, answers.status
    assert max(pose_error(s.fk(q, "tool"), X) for q in answers.q) < 1e-6
    assert (np.abs(np.sin(answers.q[:, 4])) > 0.5).all()


def test_rays_in_front_of_a_kit_arm_are_answered_alike():
    """hebi-matlab-examples, issues 65 and 69: poses above (0.2, 0.2), from zero; do ik and ik_all
    agree?
    """
    m = Mechanism("kit")
    before = m.ground
    places = [(0, 0, 0.08), (0, 0, 0.05), (0.33, 0, 0), (0.33, 0, 0), (0.1, 0, 0), (0.06, 0, 0)]
    for i, (place, axis) in enumerate(zip(places, "zyyyzx", strict=True)):
        body = m.body(f"b{i}")
        m.revolute(f"q{i}", before, body, at=place, axis=axis, limits=(-3, 3))
        before = body
    m.frame("t", before, at=(0.1, 0, 0))
    s = m.build()
    reached = 0
    for z in np.linspace(0.02, 0.6, 30):
        X = at(0.2, 0.2, z) @ turn("y", PI / 2)
        answer = s.ik(X, "t", start=np.zeros(6))
        assert bool(answer) == (len(s.ik_all(X, "t", limits=True)) > 0), z
        assert not answer or pose_error(s.fk(answer.q, "t"), X) < 1e-6
        reached += bool(answer)
    assert reached > 0


def test_a_planar_arm_reaches_the_place_it_came_from():
    """drake, issue 13578: q = (1.34, 1.51, -1.43) and its place; a solver says infeasible from a
    start at zero.
    """
    m = Mechanism("arm", dim=2)
    before = m.ground
    for i, length in enumerate((0, 1.0, 0.8)):
        body = m.body(f"l{i}")
        m.revolute(f"q{i}", before, body, at=(length, 0), limits=(-3.1, 3.1))
        before = body
    s = m.build()
    place = s.fk([1.34093164, 1.51048232, -1.43221495], "l2")[:2, 3]
    answer = s.ik(place, "l2", start=[0, 0, 0], task="position")
    assert answer
    np.testing.assert_allclose(s.fk(answer.q, "l2")[:2, 3], place, atol=1e-8)
    answers = s.ik_all(place, "l2", task="position")
    assert len(answers) == 2 or "famil" in answers.status or "free" in answers.status, (
        answers.status
    )


def test_a_gantry_with_a_wrist_has_two_solutions():
    """rl, issue 63: three slides carry a wrist with three axes; which configurations have a pose?"""
    m = Mechanism("gantry")
    before = m.ground
    for i, axis in enumerate("xyz"):
        body = m.body(f"b{i}")
        m.prismatic(axis, before, body, axis=axis, limits=(-2, 2))
        before = body
    for i, axis in enumerate("zyz", 3):
        body = m.body(f"b{i}")
        m.revolute(f"w{i}", before, body, axis=axis, limits=(-3, 3))
        before = body
    m.frame("t", before, at=(0.1, 0, -0.2))
    s = m.build()
    for seed in range(100):
        q = s.random(seed)
        X = s.fk(q, "t")
        answers = s.ik_all(X, "t")
        assert len(answers) == 2 and max(pose_error(s.fk(v, "t"), X) for v in answers.q) < 1e-9, (
            seed
        )
        assert min(np.abs(v - q).max() for v in answers.q) < 1e-6, seed


# ---- windings and limits


def test_windings_of_the_start_are_kept():
    """ur-analytic-ik, issue 19; moveit, issue 571; ssik, issue 562: limits of two turns; 350
    degrees are not -10.
    """
    u = kempe.load("ur5")
    s = u.with_limits(dict.fromkeys(u.coordinate_names, (-2 * PI, 2 * PI)))
    q = np.array([6.1, -1.2, 1.0, -5.8, 0.9, 5.9])
    X = s.fk(q, "tool")
    answer = s.ik(X, "tool", start=q + 0.01)
    assert answer and np.abs(answer.q - q).max() < 0.1
    assert np.abs(s.ik_all(X, "tool", start=q).q - q).max(axis=1).min() < 1e-6


def test_limits_from_zero_to_a_turn_contain_all_angles():
    """universal_robot, issues 127 and 316: solutions come between -pi and pi; are they inside
    limits from 0 to 2 pi?
    """
    u = kempe.load("ur5")
    s = u.with_limits(dict.fromkeys(u.coordinate_names, (0, 2 * PI)))
    for seed in range(100):
        X = s.fk(s.random(seed), "tool")
        answer = s.ik(X, "tool")
        answers = s.ik_all(X, "tool")
        assert answer and inside(s, answer.q), seed
        assert answers.inside.all() and all(inside(s, v) for v in answers.q), seed
        assert len(s.ik_all(X, "tool", limits=True)) == len(answers), seed


# ---- singular configurations


@pytest.mark.parametrize("fifth", [0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, PI])
def test_a_straight_wrist_gives_neither_nan_nor_nothing(fifth):
    """universal-robots-kinematics, issue 17: the fifth angle of a UR5 is zero, nearly zero, or half
    a turn.
    """
    s = without_limits(kempe.load("ur5"))
    q = np.array([0.3, -1.1, 1.2, 0.4, fifth, 0.2])
    X = s.fk(q, "tool")
    answers = s.ik_all(X, "tool")
    assert np.isfinite(answers.q).all()
    assert max((pose_error(s.fk(v, "tool"), X) for v in answers.q), default=0) < 1e-6
    assert len(answers) + len(answers.families) > 0, answers.status
    if fifth in (0.0, PI):
        assert len(answers.families) > 0 or "famil" in answers.status
    elif fifth >= 1e-5:
        assert nearest(answers.q, q) < 1e-3, answers.status


def test_six_joints_with_four_parallel_axes_have_families():
    """EAIK, issues 15 to 17: an arm that is singular everywhere; are its solutions called finite
    and complete?
    """
    rows = [
        {"d": 0.3, "alpha": PI / 2},
        {"a": 0.4},
        {"a": 0.35},
        {"a": 0.3},
        {"a": 0.1, "alpha": PI / 2},
        {"d": 0.1},
    ]
    s = kempe.from_dh(rows, name="redundant").build()
    X = s.fk(np.array([0.3, 0.5, -0.7, 0.4, 0.6, 0.2]), "tool")
    answer = s.ik(X, "tool")
    answers = s.ik_all(X, "tool")
    assert answer and pose_error(s.fk(answer.q, "tool"), X) < 1e-6
    said = answers.status.lower()
    assert not answers.complete or len(answers) >= 50 or "famil" in said or "infinit" in said, said
    assert max((pose_error(s.fk(v, "tool"), X) for v in answers.q), default=0) < 1e-7
    tilted = X @ turn("x", 0.4) @ turn("y", 0.3)
    tilted[:3, 3] += 0.02, -0.03, 0.01
    other = s.ik(tilted, "tool")
    assert not other or pose_error(s.fk(other.q, "tool"), tilted) < 1e-6


def test_singularities_of_a_ur5_name_wrist_and_elbow():
    """xarm_ros, issue 169; moveit, issue 3350; UR-kinematics, issue 76: what are the singularities
    of my robot?
    """
    s = kempe.load("ur5")
    text = str(s.singularities("tool"))
    elbow = s.coordinate_names[2]
    wrist = s.coordinate_names[4]
    assert elbow in text and wrist in text
    for straight in (2, 4):
        q = np.array([0.3, -1.1, 1.2, 0.4, 0.9, 0.2])
        q[straight] = 0.0
        singular_values = np.linalg.svd(s.jacobian(q, "tool"), compute_uv=False)
        assert singular_values[-1] < 1e-4 * singular_values[0]


# ---- what can be reached


def test_a_large_robot_is_not_shown_as_a_box_of_a_metre():
    """reuleaux, issue 56; moveit, issue 3459: how far does an IRB 6640 reach, by random
    configurations?
    """
    s = kempe.load("irb6640")
    mapped = np.asarray(s.workspace("tool0", n=4e5).map.points)
    drawn = s.fk(s.random(0, 400_000), "tool0")[:, :3, 3]
    reach, expected = (np.linalg.norm(points[:, :2], axis=1).max() for points in (mapped, drawn))
    assert reach > 2.5 and abs(reach - expected) < 0.15


def test_area_of_an_arm_with_two_links_is_its_integral():
    """moveit, issue 3459: an elbow that bends one way, on a shoulder that makes half a turn: pi l1
    l2 times 2.
    """
    m = Mechanism("arm", dim=2)
    m.revolute("a", m.ground, m.body("upper"), limits=(-PI / 2, PI / 2))
    m.revolute("b", "upper", m.body("lower"), at=(1, 0), limits=(0, PI))
    m.frame("t", "lower", at=(0.7, 0))
    area, _ = m.build().workspace("t").area
    assert area == pytest.approx(PI * 0.7 * 2, abs=1e-6)
