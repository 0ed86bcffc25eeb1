"""SRDF: groups, postures, end effectors, bases and pairs, on own files and on those of robots."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from bad_file_cases import joint, robot
from robots import urdf_files

import kempe
from kempe.description import srdf as srdf_module
from kempe.description.read import check_description, read_mechanism
from kempe.description.toml_writer import write_toml
from kempe.errors import DescriptionError, InputError, UnknownNameError

LINKS = "".join(
    f'<link name="{n}"/>' for n in ("base", "torso", "l1", "l2", "tool", "r1", "r2", "f1", "f2")
)
TURNS = '<origin xyz="0.1 0.2 0.3" rpy="0.3 0 0"/><axis xyz="0 0 1"/>'
URDF = robot(
    joint("waist", TURNS, "continuous", "base", "torso"),
    joint("la", TURNS, "continuous", "torso", "l1"),
    joint("lb", TURNS, "continuous", "l1", "l2"),
    joint("flange", '<origin xyz="0 0 0.1"/>', "fixed", "l2", "tool"),
    joint("ra", TURNS, "continuous", "torso", "r1"),
    joint("rb", TURNS, "continuous", "r1", "r2"),
    joint("fa", TURNS, "continuous", "tool", "f1"),
    joint("fb", f'{TURNS}<mimic joint="fa" multiplier="2"/>', "continuous", "tool", "f2"),
    links=LINKS,
).replace('name="r"', 'name="two arms"')
SRDF = """<robot name="two arms">
<group name="both"><group name="left"/><group name="right"/></group>
<group name="left"><chain base_link="torso" tip_link="tool"/></group>
<group name="right"><joint name="ra"/><link name="r2"/></group>
<group name="fingers"><joint name="fa"/><joint name="fb"/></group>
<group name="ends"><joint name="lb"/><joint name="rb"/></group>
<group name="far"><joint name="waist"/><joint name="fa"/></group>
<group_state name="home" group="both"><joint name="la" value="0.5"/><joint name="rb" value="-0.5"/>
</group_state>
<group_state name="open" group="fingers"><joint name="fa" value="0.2"/><joint name="fb" value="0.4"/>
</group_state>
<end_effector name="gripper" parent_link="tool" group="fingers" parent_group="left"/>
<passive_joint name="rb"/>
<disable_collisions link1="l1" link2="torso" reason="Adjacent"/>
<disable_collisions link1="r2" link2="l2"/>
</robot>"""


def test_groups_postures_frames_and_pairs():
    robot = kempe.load(URDF, srdf=SRDF)
    assert robot.groups == {
        "both": ("la", "lb", "flange", "ra", "rb"),
        "left": ("la", "lb", "flange"),
        "right": ("ra", "rb"),
        "fingers": ("fa", "fb"),
        "ends": ("lb", "rb"),
        "far": ("waist", "fa"),
    }
    assert robot.structure.posture_names == ("both/home", "fingers/open")
    assert robot.q_dict(robot.q("both/home")) == {
        **dict.fromkeys(("waist", "la", "lb", "ra", "rb", "fa"), 0.0),
        **{"la": 0.5, "rb": -0.5},
    }
    assert robot.q_dict(robot.q("fingers/open"))["fa"] == 0.2
    assert robot.mechanism.frames["gripper"].body == "tool"
    assert [j.name for j in robot.structure.joints.values() if j.actuated is False] == ["rb"]
    assert robot.mechanism.ignored_pairs == {("torso", "l1"): "Adjacent", ("l2", "r2"): ""}
    assert robot.mechanism.notes == []
    with pytest.raises(TypeError, match="read-only"):
        robot.groups["x"] = ()


@pytest.mark.parametrize(
    ("name", "ground", "coordinates", "bodies"),
    [
        ("left", "torso", ("la", "lb"), {"torso", "l1", "l2", "tool"}),
        ("right", "torso", ("ra", "rb"), {"torso", "r1", "r2"}),
        (
            "both",
            "torso",
            ("la", "lb", "ra", "rb"),
            {"torso", "l1", "l2", "tool", "r1", "r2"},
        ),
        ("fingers", "tool", ("fa",), {"tool", "f1", "f2"}),
        ("ends", "torso", ("lb", "rb"), {"torso", "l1", "l2", "tool", "r1", "r2"}),
        ("far", "base", ("waist", "fa"), {"base", "torso", "l1", "l2", "tool", "f1"}),
    ],
)
def test_a_group_moves_as_in_the_whole(name, ground, coordinates, bodies):
    whole = kempe.load(URDF, srdf=SRDF)
    part = whole.group(name)
    assert part.mechanism.ground.name == ground and part.coordinate_names == coordinates
    assert set(part.body_names) == bodies
    q = part.random(3)
    full = whole.q(part.q_dict(q))
    X = np.linalg.inv(whole.fk(full, ground))
    for body in bodies:
        np.testing.assert_allclose(part.fk(q, body), X @ whole.fk(full, body), rtol=0, atol=1e-14)


def test_what_belongs_to_a_group_comes_along():
    left = kempe.load(URDF, srdf=SRDF).group("left")
    assert set(left.groups) == {"left"} and "gripper" in left.frame_names
    assert left.mechanism.ignored_pairs == {("torso", "l1"): "Adjacent"}
    assert left.q_dict(left.q("both/home")) == {"la": 0.5, "lb": 0.0}
    X = left.fk(left.q({"la": 0.3, "lb": 0.4}), "gripper")
    assert left.ik(X, "gripper", start=left.q({"la": 0.2, "lb": 0.5})).success


def test_groups_without_a_system():
    robot = kempe.load(
        URDF, srdf=SRDF.replace('<joint name="fa"/><joint name="fb"/>', '<joint name="fb"/>')
    )
    with pytest.raises(UnknownNameError, match="has no group 'lft'; did you mean 'left'"):
        robot.group("lft")
    with pytest.raises(DescriptionError, match="it follows fa, outside the chain"):
        robot.group("fingers")
    m = read_mechanism(URDF)
    m.group("none", [])
    with pytest.raises(InputError, match="group 'none' has no joints"):
        m.build().group("none")


def test_groups_of_the_builder():
    m = read_mechanism(URDF)
    m.group("arm", ["la", "lb", "la"])
    assert m.groups == {"arm": ("la", "lb")}
    with pytest.raises(InputError, match="group 'arm' exists already"):
        m.group("arm", ["la"])
    with pytest.raises(UnknownNameError, match="no joint 'l'"):
        m.group("other", ["l"])
    with pytest.raises(DescriptionError, match="both bodies are 'l1'"):
        m.ignore_pair("l1", "l1")
    with pytest.raises(DescriptionError, match="no body 'l'"):
        m.ignore_pair("l1", "l")
    m.ignore_pair("l2", "l1", "Never")
    assert m != read_mechanism(URDF) and m.copy() == m
    m.copy().group("new", ["la"])
    assert "new" not in m.groups
    host = kempe.Mechanism("host")
    host.attach(m, prefix="a_")
    assert host.groups == {"a_arm": ("a_la", "a_lb")}
    assert host.ignored_pairs == {("a_l1", "a_l2"): "Never"}
    with pytest.raises(DescriptionError, match="groups 'arm'"):
        m.attach(m)


def test_groups_and_pairs_in_toml():
    m = read_mechanism(URDF, srdf=SRDF)
    text = write_toml(m)
    assert read_mechanism(text) == m
    for old, new, words in (
        (
            'left = ["la", "lb", "flange"]',
            'left = "la"',
            "group 'left': it is 'la'; it must be a list",
        ),
        ('"lb", "flange"]', '"lc", "flange"]', "no joint 'lc'"),
        ('["l2", "r2"]', '["l2", "r3"]', "no body 'r3'"),
        ('["l2", "r2"]', '["l2"]', "it must be two bodies and a reason"),
        ('["l2", "r2"]', "3", "it must be a list of names"),
    ):
        assert old in text
        with pytest.raises(DescriptionError, match=words):
            read_mechanism(text.replace(old, new))


def test_default_collisions():
    more = (
        '<disable_default_collisions link="tool"/><enable_collisions link1="tool" link2="r1"/>'
        '<disable_collisions link1="tool" link2="l1" reason="Never"/></robot>'
    )
    pairs = read_mechanism(URDF, srdf=SRDF.replace("</robot>", more)).ignored_pairs
    others = ("base", "torso", "l1", "l2", "r2", "f1", "f2")
    assert {frozenset(pair) for pair in pairs if "tool" in pair} == {
        frozenset((name, "tool")) for name in others
    }
    assert pairs["l1", "tool"] == "Never" and pairs["torso", "tool"] == "Default"


def test_hostile_groups(monkeypatch):
    monkeypatch.setattr(srdf_module, "MOST", 18)
    with pytest.raises(DescriptionError, match="the groups hold more than 18 joints") as caught:
        read_mechanism(URDF, srdf=SRDF.replace('<joint name="waist"/>', '<group name="both"/>'))
    assert len(caught.value.problems) < 20
    more = "".join(f'<disable_default_collisions link="{name}"/>' for name in ("l1", "l2", "r1"))
    with pytest.raises(DescriptionError, match="it disables more than 18 pairs"):
        read_mechanism(URDF, srdf=f'<robot name="two arms">{more}</robot>')


# ---- bases

VIRTUAL = '<virtual_joint name="v" type="{}" parent_frame="map" child_link="{}"/></robot>'


@pytest.mark.parametrize(
    ("kind", "made", "names"),
    [
        ("floating", "free", ("v.x", "v.y", "v.z", "v.qw", "v.qx", "v.qy", "v.qz")),
        ("planar", "planar", ("v.x", "v.y", "v.rz")),
        ("fixed", "fixed", ()),
    ],
)
def test_virtual_joints(kind, made, names):
    text = SRDF.replace("</robot>", VIRTUAL.format(kind, "base"))
    robot = kempe.load(URDF, srdf=text.replace('name="ra"', 'name="v"', 1))
    assert robot.body_names[0] == "map" and robot.structure.joints["v"].type.type_name == made
    assert robot.coordinate_names[: len(names)] == names
    assert robot.groups["right"] == ("v", "rb")
    if kind == "fixed":
        with pytest.raises(
            InputError, match="base is 'free', but the virtual joint 'v' of the SRDF"
        ):
            kempe.load(URDF, srdf=text, base="free")
    other = kempe.load(URDF, srdf=SRDF.replace("</robot>", VIRTUAL.format(kind, "torso")))
    assert other.body_names[0] == "base"
    assert "its child link 'torso' is not 'base', the root" in other.mechanism.notes[0]


def test_values_of_a_free_base():
    state = '<group_state name="up" group="both"><joint name="{}" value="1 2 3 0 0 0.6 0.8"/>'
    text = SRDF.replace("</robot>", state.format("v") + "</group_state>" + VIRTUAL).format(
        "floating", "base"
    )
    robot = kempe.load(URDF, srdf=text)
    q = robot.q("both/up")
    assert np.allclose(q[:7], [1, 2, 3, 0.8, 0, 0, 0.6])
    assert "1 joint not in the group: 'v'" in robot.mechanism.notes[0]
    # Pinocchio's name, without a virtual joint
    text = SRDF.replace("</robot>", state.format("root_joint") + "</group_state></robot>")
    robot = kempe.load(URDF, srdf=text, base="free")
    assert np.allclose(robot.q("both/up")[:7], [1, 2, 3, 0.8, 0, 0, 0.6])
    assert robot.structure.joints["root_joint"].type.type_name == "free"
    notes = kempe.load(URDF, srdf=text).mechanism.notes
    assert "the value of 'root_joint' is not used: base='free' lets" in notes[0]


# ---- notes and refusals


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        (
            'name="two arms"',
            'name="one"',
            "it is written for the robot 'one', and this is 'two arms'",
        ),
        (' group="both">', ">", "group_state 'home': it names no group"),
        ('<passive_joint name="rb"/>', '<gripper name="g"/>', "the element 'gripper' is not read"),
        ('name="fb" value="0.4"', 'name="fb" value="0.5"', "it follows fa, which makes it 0.4"),
        ('name="la" value="0.5"', 'name="flange" value="0"', "'flange' does not move"),
        ('name="gripper"', 'name="l1"', "it gets no frame of its own: a link has its name"),
        ('parent_group="left"', 'parent_group="lft"', "no group 'lft'; did you mean 'left'?"),
        (
            'link1="r2"',
            'link1="r3"',
            "<disable_collisions>: link 'r3' is left out: the robot does not have it; there are",
        ),
        (
            'tip_link="tool"',
            'tip_link="tol"',
            ":3: group 'left': link 'tol' is left out: the robot does not have it; did you mean 'tool'",
        ),
        (
            '<joint name="ra"/>',
            '<joint name="rx"/><joint name="ry"/>',
            ":4: group 'right': 2 joints that the robot does not have are left out: 'rx', 'ry'",
        ),
        (
            '<group name="right"/>',
            '<group name="rigt"/>',
            ":2: group 'both': group 'rigt' is left out: the robot does not have it; did you mean",
        ),
        ('group="both"', 'group="bth"', ":8: group_state 'home': group 'bth' is left out"),
        (
            'name="la" value="0.5"',
            'name="lx" value="0.5"',
            ":8: posture 'both/home': joint 'lx' is left out: the robot does not have it",
        ),
        (
            '<joint name="fa" value="0.2"/><joint name="fb" value="0.4"/>',
            '<joint name="x" value="0.2"/>',
            ":10: posture 'fingers/open': it is left out: the robot has none of its coordinates",
        ),
        (
            'parent_link="tool"',
            'parent_link="tol"',
            ":12: end_effector 'gripper': link 'tol' is left out",
        ),
        (
            '<passive_joint name="rb"/>',
            '<passive_joint name="rx"/>',
            ":13: passive_joint: joint 'rx'",
        ),
        ('<joint name="lb"/><joint name="rb"/>', "", "group 'ends': it holds no joint"),
    ],
)
def test_what_is_noted(old: str, new: str, note: str):
    assert old in SRDF
    notes = read_mechanism(URDF, srdf=SRDF.replace(old, new, 1)).notes
    assert note in "\n".join(notes) and notes[0].startswith("<srdf>:")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (' tip_link="tool"', "", ":3: group 'left': it has no tip_link; write tip_link="),
        ('<link name="r2"/>', '<group name="both"/>', "it holds itself: 'both' holds 'right' holds"),
        ('<group name="far">', '<group name="left">', ":7: group 'left': there is another group"),
        ('<group name="far">', "<group>", ":7: <group>: it has no name"),
        ('name="la" value="0.5"', 'name="la" value="0.5 1"', "joint value is '0.5 1': 2 numbers"),
        ('name="la" value="0.5"', 'name="la"', "joint 'la' has no value"),
        ('name="open" group="fingers"', 'name="home" group="both"', "another posture 'both/home'"),
        ('<passive_joint name="rb"/>', '<grup name="x"/>', "unknown element 'grup'; did you mean"),
        ('link1="r2" link2="l2"', 'link1="r2" link2="r2"', "both links are 'r2'"),
        (' link2="l2"', "", "<disable_collisions>: it has no link2"),
        ("</robot>", VIRTUAL.format("flying", "base"), "virtual_joint 'v': unknown type 'flying'"),
        ("</robot>", '<xacro:x xmlns:xacro="x"/></robot>', "this is xacro, a program that writes SRDF"),
        ("</robot>", '<link name="base"/></robot>', "this is no SRDF, but a URDF: it has links"),
        ("<robot", "<robots", ""),
        ("</robot>", "", ""),
    ],
)  # fmt: skip
def test_what_is_refused(old: str, new: str, words: str, tmp_path: Path):
    assert old in SRDF
    path = tmp_path / "a.srdf"
    path.write_text(SRDF.replace(old, new, 1))
    with pytest.raises(DescriptionError) as caught:
        kempe.load(URDF, srdf=path)
    assert words in str(caught.value) and str(caught.value).startswith(f"{path}:")
    assert check_description(URDF, srdf=path).problems == caught.value.problems


def test_all_problems_are_named_at_once():
    text = SRDF.replace(' tip_link="tool"', "").replace('name="la" value="0.5"', 'name="la"')
    with pytest.raises(DescriptionError) as caught:
        read_mechanism(URDF, srdf=text.replace('parent_link="tool"', ""))
    assert [p.where.line for p in caught.value.problems if p.where] == [3, 8, 12]


def test_a_robot_that_lacks_parts_gets_what_fits():
    """One SRDF for several variants: all that names parts of this one is kept, the rest is noted."""
    only = URDF.replace("ra", "other").replace('"r2"', '"other2"')
    m = read_mechanism(only, srdf=SRDF)
    whole = read_mechanism(URDF, srdf=SRDF)
    assert m.groups["left"] == whole.groups["left"] and "ra" not in m.groups["both"]
    assert m.postures == whole.postures and m.joints["rb"].actuated is False
    assert [*m.ignored_pairs] == [p for p in whole.ignored_pairs if "r2" not in p]
    said = "\n".join(m.notes)
    assert "group 'right': joint 'ra'" in said and "group 'right': link 'r2'" in said
    assert "<disable_collisions>: link 'r2'" in said and whole.notes == []


def test_an_srdf_of_which_nothing_fits_is_refused():
    other = robot(
        joint("x", TURNS, "continuous", "y", "z"), links='<link name="y"/><link name="z"/>'
    )
    with pytest.raises(DescriptionError) as caught:
        kempe.load(other, srdf=SRDF)
    (problem,) = caught.value.problems
    assert "nor any other joint or link that the SRDF names" in problem.message
    assert problem.allowed == "give the SRDF of the robot 'r'"


def test_an_srdf_alone_and_with_other_formats(tmp_path: Path):
    path = tmp_path / "arms.srdf"
    path.write_text(SRDF)
    with pytest.raises(
        DescriptionError, match=r"this is an SRDF: .* with this file as srdf=\(...\)"
    ):
        kempe.load(path)
    with pytest.raises(InputError, match="the option 'srdf' is for URDF, and this is TOML"):
        kempe.load("panda", srdf=path)
    with pytest.raises(DescriptionError, match="no.srdf: there is no such file"):
        kempe.load(URDF, srdf=tmp_path / "no.srdf")


def test_a_xacro_srdf(tmp_path: Path):
    pytest.importorskip("xacrodoc")
    text = SRDF.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"')
    (tmp_path / "a.srdf.xacro").write_text(text.replace("fingers", "${'fin'}gers"))
    (tmp_path / "a.urdf").write_text(URDF.replace('"two arms"', '"$(arg name)"'))
    with pytest.raises(DescriptionError, match="a xacro file, a program that writes SRDF"):
        kempe.load(URDF, srdf=tmp_path / "a.srdf.xacro")
    given = {"name": "two arms"}
    robot = kempe.load(tmp_path / "a.urdf", srdf=tmp_path / "a.srdf.xacro", xacro=given)
    assert "fingers" in robot.groups and robot.mechanism.notes == []


# ---- real robots

REAL = {
    "anymal_c_simple_description/urdf/anymal.urdf": "anymal_c_simple_description/srdf/anymal.srdf",
    "xarm_description/urdf/xarm7.urdf": "xarm_description/srdf/xarm7.srdf",
    "go1_description/urdf/go1.urdf": "go1_description/srdf/go1.srdf",
    "talos_data/robots/talos_reduced.urdf": "talos_data/srdf/talos.srdf",
    "icub_description/robots/icub.urdf": "icub_description/srdf/icub.srdf",
    "romeo_description/urdf/romeo.urdf": "romeo_description/srdf/romeo.srdf",
    "solo_description/robots/solo.urdf": "solo_description/srdf/solo.srdf",
}


@pytest.mark.parametrize("name", REAL)
def test_postures_are_those_of_pinocchio(name: str):
    pin = pytest.importorskip("pinocchio")
    found = [path for path in urdf_files().values() if str(path).endswith(name)]
    if not found:
        pytest.skip("example-robot-data is not installed")
    srdf = Path(str(found[0]).removesuffix(name)) / REAL[name]
    free = "root_joint" in srdf.read_text()
    model = pin.buildModelFromUrdf(str(found[0]), *([pin.JointModelFreeFlyer()] if free else []))
    pin.loadReferenceConfigurations(model, str(srdf), False)
    base = None if "<virtual_joint" in srdf.read_text() or not free else "free"
    robot = kempe.load(found[0], srdf=srdf, base=base)
    assert robot.structure.posture_names
    for posture in robot.structure.posture_names:
        q = robot.q(posture)
        wanted = model.referenceConfigurations[posture.partition("/")[2]]
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.normalize(model, wanted))
        for body in robot.body_names[1:]:
            X = data.oMf[model.getFrameId(body, pin.BODY)].homogeneous
            np.testing.assert_allclose(robot.fk(q, body), X, rtol=0, atol=1e-9)
    pairs = [
        {e.get("link1"), e.get("link2")}
        for e in ET.parse(srdf).iter("disable_collisions")
        if {e.get("link1"), e.get("link2")} <= set(robot.body_names)
    ]
    assert {frozenset(p) for p in robot.mechanism.ignored_pairs} == set(map(frozenset, pairs))
    for group in filter(robot.groups.get, robot.groups):
        part = robot.group(group)
        assert set(part.joint_names) >= set(robot.groups[group]) - {"root_joint"}
