"""What each element of a URDF file means, against formulas written out here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bad_file_cases import LIMIT, LINKS, joint, mimic, robot
from scipy.spatial.transform import Rotation

import kempe
from kempe.description.shapes import Mesh
from kempe.description.urdf_reader import read_urdf
from kempe.errors import DescriptionError, InputError, UnknownNameError


def pose(xyz=(0, 0, 0), rpy=(0, 0, 0)) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    X[:3, 3] = xyz
    return X


def about(axis, angle) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    return X


def along(axis, length) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = length * np.array(axis) / np.linalg.norm(axis)
    return X


ORIGIN = '<origin xyz="1 -2 .5" rpy="0.3 -1e-1 +2"/>'
X0 = pose((1, -2, 0.5), (0.3, -0.1, 2))
REST = joint("rest", "", "fixed", "arm", "hand")


@pytest.mark.parametrize(
    "axis", [(0, 0, 1), (1, 0, 0), (0, -1, 0), (0, 0, -1), (0.6, 0, 0.8), (1, 2, -3)]
)
@pytest.mark.parametrize(
    ("kind", "motion"), [("revolute", about), ("continuous", about), ("prismatic", along)]
)
@pytest.mark.parametrize("q", [0.0, 0.7])
def test_joints_with_an_axis(q, kind: str, motion, axis):
    text = robot(
        joint("j", f'{ORIGIN}<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>{LIMIT}', kind), REST
    )
    s = read_urdf(text).build()
    np.testing.assert_allclose(s.fk([q], "arm"), X0 @ motion(axis, q), rtol=0, atol=1e-14)


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (0, 0, -1), (1, 2, -3)])
def test_planar_joints_move_in_the_plane_across_their_axis(axis):
    text = robot(joint("j", f'{ORIGIN}<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>', "planar"), REST)
    s = read_urdf(text).build()
    np.testing.assert_allclose(s.fk(s.neutral, "arm"), X0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        s.fk({"j.rz": 0.4}, "arm"), X0 @ about(axis, 0.4), rtol=0, atol=1e-14
    )
    moved = np.linalg.inv(X0) @ s.fk({"j.x": 0.3, "j.y": -0.4}, "arm")
    np.testing.assert_allclose(moved[:3, :3], np.eye(3), rtol=0, atol=1e-14)
    assert (
        abs(np.dot(moved[:3, 3], axis)) < 1e-14 and abs(np.linalg.norm(moved[:3, 3]) - 0.5) < 1e-14
    )


def test_floating_joints():
    s = read_urdf(robot(joint("j", ORIGIN, "floating"), REST)).build()
    q = {"j.x": 1.0, "j.y": 2.0, "j.z": 3.0, "j.qw": math.cos(0.2), "j.qx": math.sin(0.2)}
    np.testing.assert_allclose(
        s.fk(q, "arm"), X0 @ pose((1, 2, 3)) @ about((1, 0, 0), 0.4), rtol=0, atol=1e-14
    )


def test_defaults():
    s = read_urdf(robot(joint("j", LIMIT), REST)).build()
    np.testing.assert_allclose(s.fk([0.5], "hand"), about((1, 0, 0), 0.5), rtol=0, atol=1e-15)
    m = read_urdf(robot(joint("j", '<origin/><axis xyz="0 0 1"/>' + LIMIT), REST))
    assert m.joints["j"].X_PF.steps == () and m.name == "r" and m.ground.name == "base"


def test_quaternions_of_newer_files():
    text = robot(
        joint("j", f'<origin xyz="1 2 3" quat_xyzw="0 0 {math.sin(0.3)} {math.cos(0.3)}"/>{LIMIT}'),
        REST,
    )
    with pytest.raises(
        DescriptionError, match="quat_xyzw is of URDF 1.1, and this file is of version 1.0"
    ):
        read_urdf(text)
    text = text.replace("<robot", '<robot version="1.1"')
    s = read_urdf(text).build()
    np.testing.assert_allclose(s.fk([0.0], "arm"), pose((1, 2, 3), (0, 0, 0.6)), rtol=0, atol=1e-15)
    with pytest.raises(DescriptionError, match="both rpy and quat_xyzw; give one"):
        read_urdf(text.replace("quat_xyzw", 'rpy="0 0 0" quat_xyzw'))


@pytest.mark.parametrize(
    ("limit", "limits", "bounds"),
    [
        ('<limit lower="-1" upper="2" effort="3" velocity="4"/>', (-1.0, 2.0), (4.0, 3.0)),
        ('<limit upper="2"/>', (0.0, 2.0), (None, None)),
        ('<limit lower="-2"/>', (-2.0, 0.0), (None, None)),
        ('<limit lower="-inf" upper="2"/>', (-math.inf, 2.0), (None, None)),
        (
            '<limit lower="-1e308" upper="+Infinity" effort="1e308" velocity="inf"/>',
            None,
            (None, None),
        ),
        ("", None, (None, None)),
    ],
)
def test_limits(limit: str, limits, bounds):
    j = read_urdf(robot(joint("j", limit), REST)).joints["j"]
    assert j.limits == ({"": limits} if limits else {})
    assert (j.velocity_limits.get(""), j.effort_limits.get("")) == bounds


SWAPPED = '<limit lower="1" upper="-1" effort="2" velocity="3"/>'


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_limits_without_bounds_are_zero_and_say_so(kind: str):
    text = robot(joint("j", '<limit effort="1" velocity="2"/>', kind), REST)
    m = read_urdf(text)
    assert m.joints["j"].limits == {"": (0.0, 0.0)} and m.joints["j"].unstated
    assert m.notes == [
        "<text>:5: joint 'j': its <limit> has no lower and upper; by the rules of URDF both are 0 "
        "and the joint cannot move (lenient_limits=True reads it as unlimited)"
    ]
    free = read_urdf(text, lenient_limits=True)
    assert free.joints["j"].limits == {} and not free.joints["j"].unstated
    assert (free.joints["j"].velocity_limits, free.joints["j"].effort_limits) == (
        {"": 2.0},
        {"": 1.0},
    )
    assert "it is read as unlimited, as requested" in free.notes[0]


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_swapped_limits_are_refused_or_none(kind: str):
    text = robot(joint("j", SWAPPED, kind), REST)
    with pytest.raises(
        DescriptionError, match="limits are swapped.*unlimited: lenient_limits=True reads it so"
    ):
        read_urdf(text)
    m = read_urdf(text, lenient_limits=True)
    assert m.joints["j"].limits == {} and m.joints["j"].velocity_limits == {"": 3.0}
    assert m.notes == [
        "<text>:5: joint 'j': its limits are swapped (lower='1' upper='-1'); "
        "it is read as unlimited, as requested"
    ]


def by_the_rules(given: dict[str, float], lenient: bool) -> tuple[float, float] | None:
    """Limits by the rules of URDF, or of Bullet where `lenient`; None where the file is to be
    refused.
    """
    lower = given.get("lower", 0.0)
    upper = given.get("upper", 0.0)
    if lenient and (not given or lower > upper):
        return -math.inf, math.inf
    if lower > upper or lower == math.inf or upper == -math.inf:
        return None
    return (
        (lower, upper) if abs(lower) < math.inf or abs(upper) < math.inf else (-math.inf, math.inf)
    )


def test_limits_of_all_kinds_are_read_by_the_rules(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(1000)):
        values = [float(x) for x in rng.choice([0.0, -1.0, 1.0, 0.5, -2.5, math.inf, -math.inf], 2)]
        given = {
            k: x for k, x in zip(("lower", "upper"), values, strict=True) if rng.random() < 0.7
        }
        said = "".join(f' {k}="{x}"' for k, x in given.items())
        lenient = bool(rng.random() < 0.5)
        text = robot(
            joint(
                "j",
                f'<limit effort="1" velocity="1"{said}/>',
                str(rng.choice(["revolute", "prismatic"])),
            ),
            REST,
        )
        wanted = by_the_rules(given, lenient)
        try:
            found = read_urdf(text, lenient_limits=lenient).joints["j"]
        except DescriptionError as error:
            assert wanted is None, (given, lenient, str(error))
        else:
            assert found.limits.get("", (-math.inf, math.inf)) == wanted, (given, lenient)
            assert found.unstated == (not given and not lenient)


def test_limits_that_hold_a_range_are_the_same_either_way():
    text = robot(
        joint("j", '<limit upper="2"/>'),
        joint("k", '<limit lower="0" upper="0"/>', "revolute", "arm", "hand"),
    )
    strict = read_urdf(text)
    lenient = read_urdf(text, lenient_limits=True)
    assert strict == lenient and not any(j.unstated for j in strict.joints.values())


def test_the_link_world_need_not_be_in_the_file():
    text = robot(joint("weld", "", "fixed", "world", "base"), joint("j"), REST)
    m = read_urdf(text)
    assert m.ground.name == "world" and list(m.bodies) == ["world", "base", "arm", "hand"]
    said = (
        "its parent link 'world' is not in the file; it is taken for the ground, as Drake takes it"
    )
    assert m.notes == [f"<text>:5: joint 'weld': {said}"]
    written = read_urdf(text.replace("</robot>", '<link name="world"/></robot>'))
    assert (
        written.notes == []
        and written.build().fk([0.3], "hand").tolist() == m.build().fk([0.3], "hand").tolist()
    )
    assert read_urdf(text, base="free").ground.name == "world_2"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            robot(joint("w", parent="arm", child="world"), joint(), REST),
            "child link 'world' does not exist",
        ),
        (robot(joint("w", parent="wrld"), REST), "parent link 'wrld' does not exist"),
        (
            robot(joint("w", parent="world"), REST, links=LINKS + '<link name="World"/>'),
            "'world' does not exist; did you",
        ),
        (
            robot(joint("w", "", "fixed", "world", "arm"), REST),
            "2 links are nobody's child: 'base' .*, 'world'",
        ),
    ],
)
def test_the_implicit_world_hides_no_slip(text: str, words: str):
    with pytest.raises(DescriptionError, match=words):
        read_urdf(text)


def test_spherical_joints_of_other_programs():
    limit = '<limit effort="1000.0" lower="0.2" upper=".8" twist=".3"/>'
    m = read_urdf(robot(joint("neck", f'{ORIGIN}<axis xyz="0 1 0"/>{limit}', "spherical"), REST))
    assert m.joints["neck"].type.type_name == "spherical" and m.joints["neck"].limits == {}
    s = m.build()
    q = {"neck.qw": math.cos(0.2), "neck.qy": math.sin(0.2)}
    np.testing.assert_allclose(s.fk(q, "arm"), X0 @ about((0, 1, 0), 0.4), rtol=0, atol=1e-14)
    notes = "\n".join(m.notes)
    for piece in (
        "'spherical' is a type of MuJoCo and Bullet; ROS refuses it",
        "the limit attribute 'twist' is not read",
        "the <limit> of a spherical joint has no defined meaning",
    ):
        assert piece in notes


def test_limits_of_continuous_joints_are_not_used():
    m = read_urdf(robot(joint("j", LIMIT, "continuous"), REST))
    assert m.joints["j"].limits == {} and m.joints["j"].velocity_limits == {"": 2.0}
    assert m.notes == [
        "<text>:5: joint 'j': a continuous joint turns without end: its lower and upper limit are "
        "not used"
    ]


def test_mimic_chains_multiply():
    text = robot(
        joint("a"),
        joint(
            "b",
            f'{LIMIT}<mimic joint="a" multiplier="-2" offset="0.5"/>',
            child="hand",
            parent="arm",
        ),
        joint("c", f'{LIMIT}<mimic joint="b" multiplier="3"/>', child="tip", parent="hand"),
        '<link name="tip"/>',
    )
    m = read_urdf(text)
    assert {k: (v.sources, v.offset) for k, v in m.couplings.items()} == {
        "b": ({"a": -2.0}, 0.5),
        "c": ({"b": 3.0}, 0.0),
    }
    s = m.build()
    q = 0.1
    total = q + (-2 * q + 0.5) + 3 * (-2 * q + 0.5)
    np.testing.assert_allclose(s.fk([q], "tip"), about((1, 0, 0), total), rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", ["fixed", "planar", "floating", "spherical"])
def test_mimic_needs_one_coordinate(kind: str):
    text = robot(joint("a", "", kind), joint("b", mimic("a"), parent="arm", child="hand"))
    with pytest.raises(DescriptionError, match=f"'a' is {kind} and has"):
        read_urdf(text)


@pytest.mark.parametrize(
    ("multiplier", "upper", "noted"), [(-1, 0.5, True), (1, 0.5, False), (-1, 0.0, False)]
)
def test_limits_of_followers_that_block_their_leader_are_noted(multiplier, upper, noted):
    limit = '<limit lower="0" upper="{}" effort="1" velocity="1"/>'
    text = robot(
        joint("a", limit.format(0.5), "revolute"),
        joint(
            "b",
            f'{limit.format(upper)}<mimic joint="a" multiplier="{multiplier}"/>',
            "revolute",
            "arm",
            "hand",
        ),
    )
    m = read_urdf(text)
    said = "joint 'b': its limits leave nothing but 0 to 'a', which it follows by -1"
    assert any(said in note for note in m.notes) == noted
    system = m.build()
    assert (system.upper[0] == 0.0) == (multiplier < 0)
    assert not np.signbit(system.upper[0])


def test_mimic_of_a_fixed_joint_is_noted():
    m = read_urdf(robot(joint("a"), joint("b", '<mimic joint="a"/>', "fixed", "arm", "hand")))
    assert not m.couplings and "its <mimic> is not used" in m.notes[0]


def test_masses_and_visuals():
    visual = (
        '<visual name="v">\n  <geometry><mesh filename="package://p/m.stl"/></geometry></visual>'
    )
    inertial = (
        '<inertial><origin xyz="1 2 3" rpy="1 1 1"/><mass value="4.5"/><inertia '
        'ixx="1"/></inertial>'
    )
    links = (
        f'<link name="base">{inertial}{visual}</link><link '
        'name="arm"><inertial/></link><link name="hand"/>\n'
    )
    m = read_urdf(robot(joint("j"), REST, links=links), package_dirs=["/models"])
    (shape,) = m.ground.shapes
    assert (m.ground.mass, m.ground.center) == (4.5, (1.0, 2.0, 3.0))
    assert (shape.geometry, shape.name) == (Mesh("package://p/m.stl"), "v")
    assert (m.bodies["arm"].mass, m.bodies["arm"].center) == (None, (0.0, 0.0, 0.0))
    assert m.bodies["hand"].center is None and m.roots == ("/models",)
    with pytest.raises(DescriptionError, match="link 'base': mass is -1; it must not be negative"):
        read_urdf(robot(joint("j"), REST, links=links.replace("4.5", "-1")))


def test_floating_base():
    m = read_urdf(robot(joint("base"), REST), base="free")
    assert m.ground.name == "world" and list(m.joints) == ["base_2", "base", "rest"]
    assert m.build().nv == 7 and list(m.bodies) == ["world", "base", "arm", "hand"]
    links = '<link name="world"/><link name="arm"/><link name="hand"/>\n'
    m = read_urdf(robot(joint("j", parent="world"), REST, links=links), base="free")
    assert m.ground.name == "world_2" and m.joints["base"].child == "world"
    with pytest.raises(InputError, match="base is 'fixed'; it must be None"):
        read_urdf(robot(joint("j"), REST), base="fixed")


def test_root_is_chosen_where_the_file_leaves_it_open():
    circle = robot(
        joint("a"), joint("b", parent="arm", child="hand"), joint("c", parent="hand", child="base")
    )
    m = read_urdf(circle, root="arm")
    assert m.ground.name == "arm" and m.build().structure.closures
    two = robot(joint("a", child="hand"), joint("b", parent="arm", child="hand"))
    assert read_urdf(two, root="arm").build().body_names[0] == "arm"
    with pytest.raises(UnknownNameError, match="no link 'amr'; did you mean 'arm'"):
        read_urdf(two, root="amr")
    with pytest.raises(DescriptionError, match="no joints lead from the root 'arm'"):
        read_urdf(robot(joint("a", child="hand")), root="arm")


def test_order_of_the_file_is_kept():
    links = '<link name="hand"/><link name="arm"/><link name="base"/>\n'
    m = read_urdf(robot(joint("wrist", parent="arm", child="hand"), joint("elbow"), links=links))
    assert list(m.bodies) == ["base", "hand", "arm"] and list(m.joints) == ["wrist", "elbow"]


def test_all_problems_are_reported_in_the_order_of_the_file():
    text = robot(
        joint("a", '<axis xyz="0 0 0"/><origin xyz="1 2"/>' + LIMIT),
        joint("b", "", "ball", "arm", "hand"),
        joint("c", mimic("x")),
        links=LINKS.replace('base"/>', 'base"><inertial><mass value="x"/></inertial></link>'),
    )
    with pytest.raises(DescriptionError) as caught:
        read_urdf(text, "r.urdf")
    assert [str(p).split(":")[1] for p in caught.value.problems] == ["2", "5", "5", "6", "7"]


def test_what_is_not_read_is_noted():
    text = robot(
        joint("a", LIMIT + "<spring/>"),
        REST,
        '<gazebo><joint name="loop" '
        'type="revolute"><parent>base</parent><child>hand</child></joint></gazebo>',
        "<loop/>",
        '<ros2_control><joint name="nobody"/></ros2_control>',
        '<material name="m"/>',
    )
    notes = "\n".join(read_urdf(text).notes)
    for piece in (
        "<text>:5: joint 'a': the element 'spring' is not read",
        "<text>:7: joint 'loop': a joint inside a <gazebo> block is not read",
        "<text>:8: the element 'loop' is not read",
        "<text>:9: a <ros2_control> speaks of joint 'nobody', which does not exist",
    ):
        assert piece in notes
    assert notes.count("\n") == 3


@pytest.mark.parametrize(
    ("tag", "words"),
    [
        ("sdf", "SDF"),
        ("mujoco", "MJCF"),
        ("launch", "launch file"),
        ("svg", "SVG picture"),
        ("kml", "starts with <robot"),
    ],
)
def test_other_files_are_named(tag, words):
    with pytest.raises(DescriptionError, match=words):
        read_urdf(f"<{tag}/>")


@pytest.mark.slow
def test_long_names_and_values_do_not_flood_the_message():
    text = robot(joint("a", f'<origin xyz="{"9" * 5000}x"/>' + LIMIT), joint("b", child="h" * 5000))
    with pytest.raises(DescriptionError) as caught:
        read_urdf(text)
    assert len(str(caught.value)) < 2000


# ---- MuJoCo, which reads URDF by rules of its own


# it wants some
INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)


def for_mujoco(*lines: str) -> str:
    """A URDF text of three links with masses."""
    return robot(*lines, links=LINKS.replace("/>", f">{INERTIAL}</link>"))


def test_lenient_limits_are_those_of_mujoco(hunt):
    mujoco = pytest.importorskip("mujoco")
    rng = hunt.rng()
    for _ in range(hunt.cases(200)):
        lower, upper = rng.choice([0.0, -1.0, 1.0, 0.5, -2.5], 2, replace=False).tolist()
        # of one bound it makes no limit
        given = {"lower": lower, "upper": upper} if rng.random() < 0.7 else {}
        said = "".join(f' {k}="{x}"' for k, x in given.items())
        text = for_mujoco(
            joint("j", f'<limit effort="1" velocity="1"{said}/>'),
            joint("rest", "", "continuous", "arm", "hand"),
        )
        model = mujoco.MjModel.from_xml_string(text)
        wanted = tuple(model.jnt_range[0].tolist()) if model.jnt_limited[0] else None
        assert read_urdf(text, lenient_limits=True).joints["j"].limits.get("") == wanted, given


def test_balls_of_mujoco(hunt):
    mujoco = pytest.importorskip("mujoco")
    rng = hunt.rng()
    text = for_mujoco(
        joint("b", ORIGIN + '<axis xyz="0 1 0"/>', "spherical"),
        joint("h", '<origin xyz="0.3 0 1"/>', "continuous", "arm", "hand"),
    )
    model = mujoco.MjModel.from_xml_string(text)
    s = read_urdf(text).build()
    data = mujoco.MjData(model)
    for _ in range(hunt.cases(50)):
        q = s.random(rng)
        named = s.q_dict(q)
        data.qpos[:] = [*(named[f"b.{k}"] for k in ("qw", "qx", "qy", "qz")), named["h"]]
        mujoco.mj_kinematics(model, data)
        X = np.eye(4)
        hand = model.body("hand").id
        X[:3, :3] = data.xmat[hand].reshape(3, 3)
        X[:3, 3] = data.xpos[hand]
        np.testing.assert_allclose(s.fk(q, "hand"), X, rtol=0, atol=1e-14)


def test_swapped_letters_of_a_short_attribute_are_a_slip():
    text = (
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent "
        "link='a'/><child link='b'/><origin xzy='1 0 0'/></joint></robot>"
    )
    with pytest.raises(DescriptionError, match="did you mean 'xyz'"):
        kempe.load(text)
