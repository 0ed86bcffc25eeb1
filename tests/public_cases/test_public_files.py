"""Public reports about robot descriptions: what a URDF file says, and which answers follow from it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from public_oracles import (
    PI,
    apart,
    at,
    inside,
    jacobian_by_differences,
    nearest,
    point,
    pose_error,
    product,
    turn,
)

import kempe
from kempe import System, tasks

Limits = tuple[float, float] | None


def written(values: tuple[float, ...]) -> str:
    return " ".join(f"{v:.17g}" for v in values)


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: tuple[float, ...] = (0, 0, 0),
    axis: tuple[float, ...] = (0, 0, 1),
    limits: Limits = (-3, 3),
    more: str = "",
) -> str:
    """Element of one joint; `more` is written into it."""
    ends = (
        ""
        if limits is None
        else f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>'
    )
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{written(xyz)}"/><axis xyz="{written(axis)}"/>{ends}{more}</joint>'
    )


def follows(other: str, multiplier: float = 1, offset: float = 0) -> str:
    return f'<mimic joint="{other}" multiplier="{multiplier}" offset="{offset}"/>'


def robot(links: str, *joints: str) -> str:
    """Text of a URDF file."""
    return f'<robot name="case">{"".join(f"""<link name="{n}"/>""" for n in links.split())}{"".join(joints)}</robot>'


# ---- limits

WITHOUT_ONE_LIMIT = robot(
    "base plat arm fore grip",
    joint("rot", "revolute", "base", "plat", (0, 0, 0.09), limits=None),
    joint("sh", "revolute", "plat", "arm", (0, 0, 0.05), (0, 1, 0), (-0.02, 0.02)),
    joint("el", "revolute", "arm", "fore", (-0.037, 0, 0.172), (0, 1, 0), (-0.2, 0.2)),
    joint("w", "revolute", "fore", "grip", (0.24, 0, 0), (0, 1, 0), (-0.3, 0.3)),
)


def test_a_revolute_joint_without_limits_is_named():
    """ikpy, issue 39: one joint has no <limit>; is that said, or does the arm reach in silence what
    it cannot?
    """
    try:
        s = kempe.load(WITHOUT_ONE_LIMIT)
    except kempe.KempeError as error:
        assert "rot" in str(error)
    else:
        answer = s.ik([0.2, 0.2, 0.25], "grip", task="position")
        assert not answer
        assert "rot" in str(answer.status) + str(kempe.read(WITHOUT_ONE_LIMIT).notes)


def test_narrow_limits_hold_within_reach_and_out_of_it():
    """ikpy, issue 39: are the limits of the other joints respected?"""
    s = kempe.load(WITHOUT_ONE_LIMIT, lenient_limits=True)
    for seed in range(50):
        target = s.fk(s.random(seed), "grip")[:3, 3]
        answer = s.ik(target, "grip", task="position")
        assert answer and inside(s, answer.q), seed
    assert inside(s, s.ik([0.2, 0.2, 0.25], "grip", task="position").q)


CONTINUOUS = robot(
    "b a t",
    joint("j", "continuous", "b", "a", limits=None),
    joint("k", "continuous", "a", "t", (1, 0, 0), limits=(0, 0)),
)


def test_continuous_joints_have_no_limits_and_finite_samples():
    """cram, issue 188; prpl-mono, issue 490: are limits of a continuous joint ignored, and samples
    finite?
    """
    s = kempe.load(CONTINUOUS)
    assert np.isinf(s.lower).all() and np.isinf(s.upper).all()
    drawn = s.random(0, 1000)
    assert (
        np.isfinite(drawn).all() and np.abs(drawn).max() <= 2 * PI + 1e-9 and drawn[:, 0].std() > 1
    )


def test_continuous_joints_go_the_short_way_round():
    """aikido, issue 430: what is between 3.1 and -3.1 rad of a continuous joint?"""
    space = kempe.load(CONTINUOUS).configuration_space
    here = np.array([3.1, 0.0])
    there = np.array([-3.1, 0.0])
    short = 2 * PI - 6.2
    assert space.distance(here, there) == pytest.approx(short, abs=1e-9)
    assert space.difference(here, there)[0] == pytest.approx(short, abs=1e-9)
    assert apart(space.interpolate(here, there, 0.5)[:1], [PI]) < 1e-9


@pytest.mark.parametrize(
    "start, target, away",
    [(3.1, (-1.0, 0.001), 0.1), (3.12, (-math.cos(0.02), -math.sin(0.02)), 0.3)],
)
def test_inverse_kinematics_crosses_half_a_turn_of_a_continuous_joint(start, target, away):
    """aikido, issue 430: does the solution near 3.12 rad stay there, or come back at -3.12?"""
    answer = kempe.load(CONTINUOUS).ik(
        [*target, 0], "t", start=np.array([start, 0]), task="position"
    )
    assert answer and abs(answer.q[0] - start) < away


# ---- joints that follow others


@pytest.mark.parametrize("order", ["abc", "cba", "bca"])
def test_offsets_of_mimics_and_mimics_of_mimics_count(order):
    """gz_ros2_control, issue 952; cram, issue 114; ros/robot_model, issue 177: c follows b, which
    follows a.
    """
    joints = {
        "a": joint("a", "revolute", "l0", "l1"),
        "b": joint("b", "revolute", "l1", "l2", (1, 0, 0), more=follows("a", -2, 0.3)),
        "c": joint("c", "revolute", "l2", "l3", (1, 0, 0), more=follows("b", 0.5, -0.1)),
    }
    s = kempe.load(robot("l0 l1 l2 l3", *(joints[name] for name in order)))
    assert s.nq == 1
    for a in (-0.7, 0, 0.4, 1.1):
        b = 0.3 - 2 * a
        expected = turn("z", a) @ at(1, 0, 0) @ turn("z", b) @ at(1, 0, 0) @ turn("z", b / 2 - 0.1)
        np.testing.assert_allclose(s.fk({"a": a}, "l3"), expected, atol=1e-12)
    # b = 0.3 - 2a is between -3 and 3
    np.testing.assert_allclose([s.lower[0], s.upper[0]], [-1.35, 1.65])
    answer = s.ik(s.fk([0.8], "l3"), "l3")
    assert answer and abs(answer.q[0] - 0.8) < 1e-6


def test_fingers_mimic_each_other_and_answer_for_a_width():
    """yourdfpy, issue 1; pinocchio, issue 2676: where are both fingers, and which joint value gives
    a width?
    """
    ends = (0, 0.04)
    s = kempe.load(
        robot(
            "hand lf rf",
            joint("f1", "prismatic", "hand", "lf", (0, 0, 0.0584), (0, 1, 0), ends),
            joint("f2", "prismatic", "hand", "rf", (0, 0, 0.0584), (0, -1, 0), ends, follows("f1")),
        )
    )
    places = s.fk({"f1": 0.03}, ["lf", "rf"])[:, :3, 3]
    np.testing.assert_allclose(places, [[0, 0.03, 0.0584], [0, -0.03, 0.0584]])
    answer = s.ik([tasks.Distance("lf", "rf", 0.05)])
    assert answer and answer.q[0] == pytest.approx(0.025, abs=1e-9)
    assert not s.ik([tasks.Distance("lf", "rf", 0.2)])


def parallel_arm() -> System:
    """Shape of a Dobot Magician: each mimic joint undoes a rotation, as a parallelogram would."""
    ends = (-1.9, 1.9)
    return kempe.load(
        robot(
            "b l1 l2 fake l3 l4",
            joint("j1", "revolute", "b", "l1", (0, 0, 0.138), limits=ends),
            joint("j2", "revolute", "l1", "l2", (0, 0, 0), (0, 1, 0), ends),
            joint(
                "m2", "revolute", "l2", "fake", (0, 0, 0.135), (0, 1, 0), ends, follows("j2", -1)
            ),
            joint("j3", "revolute", "fake", "l3", (0, 0, 0), (0, 1, 0), ends),
            joint("m3", "revolute", "l3", "l4", (0.147, 0, 0), (0, 1, 0), ends, follows("j3", -1)),
        )
    )


def test_inverse_kinematics_of_an_arm_whose_parallelograms_are_mimics():
    """openrave, issue 924: is every pose of a Dobot Magician, written with mimic joints, found
    again?
    """
    s = parallel_arm()
    assert s.nq == 3
    for seed in range(100):
        X = s.fk(s.random(seed), "l4")
        answer = s.ik(X[:3, 3], "l4", task="position")
        assert answer and np.linalg.norm(s.fk(answer.q, "l4")[:3, 3] - X[:3, 3]) < 1e-6, seed
        assert s.ik(X, "l4"), seed


def test_all_solutions_of_an_arm_whose_parallelograms_are_mimics():
    """openrave, issue 924: are all solutions offered, the one that the target came from among them?"""
    s = parallel_arm()
    for seed in (0, 1, 50, 99):
        q = s.random(seed)
        place = s.fk(q, "l4")[:3, 3]
        answers = s.ik_all(place, "l4", task="position")
        assert len(answers) > 0, answers.status
        assert max(np.linalg.norm(s.fk(v, "l4")[:3, 3] - place) for v in answers.q) < 1e-9
        assert nearest(answers.q, q) < 1e-6, answers.status


def arm_with_gripper() -> System:
    ends = (-2.9, 2.9)
    places = [(0, 0, 0.3), (0.05, 0, 0), (0, 0, 0.4), (0.3, 0, 0.02), (0, 0, 0), (0.08, 0, 0)]
    axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
    rows = enumerate(zip(places, axes, strict=True))
    arm = [joint(f"q{i + 1}", "revolute", f"l{i}", f"l{i + 1}", p, a, ends) for i, (p, a) in rows]
    opening = (0, 0.04)
    fingers = [
        joint("g", "prismatic", "l6", "fl", (0.1, 0, 0), (0, 1, 0), opening),
        joint("gm", "prismatic", "l6", "fr", (0.1, 0, 0), (0, -1, 0), opening, follows("g")),
    ]
    return kempe.load(robot("l0 l1 l2 l3 l4 l5 l6 fl fr", *arm, *fingers))


ARM_AND_GRIPPER = np.array([0.3, 0.5, -0.9, 0.4, 0.7, -0.2, 0.02])


def test_a_gripper_behind_the_wrist_does_not_hinder_the_arm():
    """nao_robot, issue 39; ManiSkill, issue 1165: is the arm solved as before, and does the gripper
    stay?
    """
    s = arm_with_gripper()
    assert s.nq == 7
    X = s.fk(ARM_AND_GRIPPER, "l6")
    answers = s.ik_all(X, "l6")
    assert min(np.abs(v - ARM_AND_GRIPPER)[:6].max() for v in answers.q) < 1e-6
    assert max(pose_error(s.fk(v, "l6"), X) for v in answers.q) < 1e-9
    answer = s.ik(X, "l6", start=[0, 0, 0, 0, 0, 0, 0.013])
    assert answer and answer.q[6] == 0.013


@pytest.mark.parametrize("finger", ["fl", "fr"])
def test_fingertips_are_solved_while_the_gripper_is_held(finger):
    """nao_robot, issue 39; ManiSkill, issue 1165: which arm configurations bring a finger, also a
    mimic, to a pose?
    """
    s = arm_with_gripper()
    X = s.fk(ARM_AND_GRIPPER, finger)
    answer = s.ik(X, finger)
    assert answer and pose_error(s.fk(answer.q, finger), X) < 1e-6
    answers = s.ik_all(X, finger, fixed={"g": 0.02})
    assert min(np.abs(v - ARM_AND_GRIPPER).max() for v in answers.q) < 1e-6, answers.status


# ---- order, names and elements of files


@pytest.mark.parametrize("order", ["".join(p) for p in itertools.permutations("abc")])
def test_order_of_joints_in_a_file_does_not_matter(order):
    """adam, issue 17; differentiable-robot-model, issue 37: joints are written in any order; what
    are the poses?
    """
    joints = {
        "a": joint("a", "revolute", "l0", "l1", (0, 0, 1), (0, 0, 1)),
        "b": joint("b", "revolute", "l1", "l2", (0, 0.5, 0), (1, 0, 0)),
        "c": joint("c", "revolute", "l2", "l3", (1, 0, 0), (0, 1, 0)),
    }
    s = kempe.load(robot("l3 l1 l0 l2", *(joints[name] for name in order)))
    values = {"a": 0.3, "b": -0.4, "c": 0.9}
    expected = product(
        [at(0, 0, 1), turn("z", 0.3), at(0, 0.5, 0), turn("x", -0.4), at(1, 0, 0), turn("y", 0.9)]
    )
    np.testing.assert_allclose(s.fk(values, "l3"), expected, atol=1e-12)
    q = s.q(values)
    expected = jacobian_by_differences(lambda v: s.fk(v, "l3"), q)
    np.testing.assert_allclose(s.jacobian(q, "l3"), expected, atol=1e-7)


def test_floating_and_planar_joints_of_a_file_are_read():
    """scikit-robot, issue 868: a floating joint has the name of a link, and a planar one follows
    it.
    """
    text = (
        '<robot name="r"><link name="base"/><link name="m"/><link name="p"/><joint name="base" '
        'type="floating"><parent link="base"/><child link="m"/><origin xyz="0 0 1"/></joint><joint '
        'name="pl" type="planar"><parent link="m"/><child link="p"/><axis xyz="0 1 '
        '0"/></joint></robot>'
    )
    s = kempe.load(text)
    assert s.nv == 9
    np.testing.assert_allclose(s.fk(s.neutral, "p")[:3, 3], [0, 0, 1], atol=1e-12)


WHEEL = (
    '<robot name="smb"><link name="c"/><link name="w"/><joint name="h" type="continuous"><parent '
    'link="c"/><child link="w"/><origin rpy="0 0 0" xyz="0.2159 0.265 0.14"/><axis rpy="0 0 0" '
    'xyz="0 1 0"/><dynamics damping="1.0" friction="0.0"/><limit effort="1" '
    'velocity="1"/><joint_properties damping="0.2" friction="0.2"/></joint></robot>'
)


def test_additional_attributes_of_a_wheel_do_not_change_it():
    """compas, issue 171: an axis with rpy, a limit without ends and an unknown element are in the
    file.
    """
    s = kempe.load(WHEEL)
    assert np.isinf(s.lower).all()
    np.testing.assert_allclose(
        s.fk([0.3], "w"), at(0.2159, 0.265, 0.14) @ turn("y", 0.3), atol=1e-12
    )


def test_a_decimal_comma_is_refused():
    """urdfdom, issue 98: a locale wrote 0,2159; is that read as another number?"""
    with pytest.raises(kempe.KempeError, match="0,2159"):
        kempe.load(WHEEL.replace("0.2159", "0,2159"))


# ---- links with two parents, and other formats


def test_a_heavy_robot_with_a_parallelogram_and_a_cylinder_moves_as_its_triangle_says():
    """onshape-to-robot, issue 94: one link has two parents; is the URDF file read, counted and
    moved?
    """
    ends = (-3, 3)
    y = (0, 1, 0)
    s = kempe.load(
        robot(
            "base col lower upper crank rod cyl piston tip lug",
            joint("j1", "revolute", "base", "col", (0, 0, 0.5), (0, 0, 1), ends),
            joint("j2", "revolute", "col", "lower", (0.4, 0, 0.3), y),
            joint("j3", "revolute", "lower", "upper", (0, 0, 1.1), y),
            joint("crank", "revolute", "col", "crank", (0.4, 0, 0.3), y),
            joint("rodA", "revolute", "crank", "rod", (-0.5, 0, 0), y),
            joint("rodB", "revolute", "rod", "tip", (0, 0, 1.1), y),
            joint("weld", "fixed", "upper", "tip", (-0.5, 0, 0), limits=None),
            joint("c1", "revolute", "col", "cyl", (-0.2, 0, 0.2), y),
            joint("c2", "prismatic", "cyl", "piston", (0, 0, 0.4), (0, 0, 1)),
            joint("c3", "revolute", "piston", "lug", (0, 0, 0), y),
            joint("lug weld", "fixed", "lower", "lug", (0, 0, 0.4), limits=None),
        )
    )
    assert s.mobility(s.assemble({"j2": 0.1, "j3": 0.2}).q).dof == 3
    answer = s.assemble({"j1": 0.2, "j2": 0.3, "j3": -0.2})
    assert answer, answer.status
    values = s.q_dict(answer.q)
    ends_of_rod = point(s, answer.q, "crank", -0.5) - point(s, answer.q, "upper", -0.5)
    assert np.linalg.norm(ends_of_rod) == pytest.approx(1.1, abs=1e-9)
    if abs(values["crank"]) < 1.5:  # else the parallelogram is crossed
        assert values["crank"] == pytest.approx(0.3 - 0.2, abs=1e-9)
    lug = np.array([0.4, 0, 0.3]) + (turn("y", 0.3) @ [0, 0, 0.4, 1])[:3]
    length = np.linalg.norm(lug - [-0.2, 0, 0.2])
    assert values["c2"] == pytest.approx(length - 0.4, abs=1e-9)


MJCF_FOUR_BAR = """<mujoco><worldbody>
<body name="crank"><joint name="A" axis="0 0 1"/><geom size="0.01"/>
<body name="coupler" pos="0 1 0"><joint name="B" axis="0 0 1"/><geom size="0.01"/></body></body>
<body name="rocker" pos="3.5 0 0"><joint name="D" axis="0 0 1"/><geom size="0.01"/></body>
</worldbody><equality><connect name="C" body1="coupler" body2="rocker" anchor="3 1 0"/></equality></mujoco>"""
SDF_FOUR_BAR = """<sdf version="1.9"><model name="m"><link name="crank"/>
<link name="coupler"><pose>0 1 0 0 0 0</pose></link><link name="rocker"><pose>3.5 0 0 0 0 0</pose></link>
<joint name="A" type="revolute"><parent>world</parent><child>crank</child><axis><xyz>0 0 1</xyz></axis></joint>
<joint name="B" type="revolute"><parent>crank</parent><child>coupler</child><axis><xyz>0 0 1</xyz></axis></joint>
<joint name="D" type="revolute"><parent>world</parent><child>rocker</child><axis><xyz>0 0 1</xyz></axis></joint>
<joint name="C" type="revolute"><pose>-0.5 2 0 0 0 0</pose><parent>coupler</parent><child>rocker</child>
<axis><xyz>0 0 1</xyz></axis></joint></model></sdf>"""


@pytest.mark.parametrize(
    ("ending", "text"), [("xml", MJCF_FOUR_BAR), ("sdf", SDF_FOUR_BAR)], ids=["mujoco", "sdf"]
)
def test_closed_chains_of_other_formats_are_read(tmp_path, ending, text):
    """drake, issues 18803 and 18829; mujoco, issue 172; mujoco-py, issue 613: linkages come as SDF
    or MJCF files.
    """
    path = tmp_path / f"m.{ending}"
    path.write_text(text)
    four_bar = kempe.load(path)
    closed = four_bar.assemble({"A": 0.1})
    assert closed and four_bar.mobility(closed.q).dof == 1
    X = four_bar.fk(closed.q, ["crank", "coupler", "rocker"])
    np.testing.assert_allclose(X[1][:2, 3], [-np.sin(0.1), np.cos(0.1)], rtol=0, atol=1e-12)
    pins = (X[1] @ [3, 1, 0, 1], X[2] @ [-0.5, 2, 0, 1])
    np.testing.assert_allclose(*pins, rtol=0, atol=1e-9)
