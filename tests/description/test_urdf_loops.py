"""Joints and constraints of simulators in URDF: of Drake, and loop joints."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bad_file_cases import LIMIT, joint, robot

import kempe
from kempe.description.urdf_reader import read_urdf
from kempe.errors import DescriptionError

DRAKE = """<robot name="r" xmlns:drake="http://drake.mit.edu">
<link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<drake:joint name="u" type="universal"><parent link="base"/><child link="a"/>
<origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/></drake:joint>
<drake:joint name="s" type="screw"><parent link="a"/><child link="b"/>
<origin xyz="0 0 0.5" rpy="0 1 0"/><axis xyz="1 2 2"/>
<drake:screw_thread_pitch value="0.25"/></drake:joint>
<drake:joint name="p" type="planar"><parent link="b"/><child link="c"/>
<origin xyz="0 0.3 0"/><axis xyz="0 0 1"/></drake:joint>
<drake:joint name="k" type="ball"><parent link="c"/><child link="d"/>
<origin xyz="0.2 0 0" rpy="0.3 0 0"/></drake:joint>
</robot>"""
AT = {"u.rx": 0.7, "u.ry": -0.8, "s": 0.9, "p.x": 0.11, "p.y": -0.12, "p.rz": 0.5}
BALL = (0.1, 0.2, 0.3)
"""Roll, pitch and yaw of the ball joint."""
POSES = {
    "b": [
        [-0.1427289654153007, -0.5656476835267865, 0.8122014162461539, -0.0428352870024126],
        [0.841612279568836, -0.5012180168362191, -0.2011697553751934, -0.2834585907145853],
        [0.5208811892460941, 0.6548459343384123, 0.5475943653563526, 0.3016326330159765],
    ],
    "d": [
        [-0.599366167038151, 0.0358728578205778, 0.7996707671797061, -0.2396405355249515],
        [0.2046426386712628, -0.9589308467956952, 0.1964001565716132, -0.1814429744440166],
        [0.7738744008220314, 0.2813623449139488, 0.5674095898175021, 0.6310150546683725],
    ],
}
"""Poses of bodies by Drake 1.45 at these coordinates."""


def test_joints_of_drake():
    system = kempe.load(DRAKE)
    x, y, z = (
        np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.eye(3)[k])])
        for k, angle in enumerate(BALL)
    )
    q = system.q(AT)
    q[-4:] = times(z, times(y, x))
    for body, X in POSES.items():
        np.testing.assert_allclose(system.fk(q, body)[:3], X, rtol=0, atol=1e-14)
    assert any("'k': its coordinates are a unit quaternion" in n for n in system.mechanism.notes)


def times(a, b):
    """The product of two quaternions, wxyz."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([w, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (('type="ball"', 'type="bal"'), "unknown type 'bal'; did you mean 'ball'?"),
        (('type="ball"', 'type="revolute"'), "a <drake:joint> has ball, planar, screw, universal"),
        (('value="0.25"', 'value="0"'), "its thread pitch is 0; it must not be zero"),
        (('value="0.25"', 'value="x"'), "value is 'x'"),
        (('value="0.25"', ""), "has no <drake:screw_thread_pitch value=...>"),
    ],
)
def test_wrong_joints_of_drake(changed, words: str):
    with pytest.raises(DescriptionError) as caught:
        kempe.load(DRAKE.replace(*changed))
    assert words in str(caught.value)


# ---- loops

LINKS = "".join(f'<link name="{name}"/>' for name in ("base", "crank", "rod", "rocker"))
TURNS = (
    joint("A", '<axis xyz="0 0 1"/>', "continuous", "base", "crank"),
    joint("B", '<origin xyz="1 0 0"/><axis xyz="0 0 1"/>', "continuous", "crank", "rod"),
    joint("D", '<origin xyz="4 0 0"/><axis xyz="0 0 1"/>', "continuous", "base", "rocker"),
)
ENDS = (
    '<drake:ball_constraint><drake:ball_constraint_body_A name="rod"/>'
    '<drake:ball_constraint_p_AP value="3.5 0 0"/><drake:ball_constraint_body_B name="rocker"/>'
    '<drake:ball_constraint_p_BQ value="0 3 0"/></drake:ball_constraint>',
    '<loop_joint name="C" type="spherical"><link1 link="rod" rpy="0 0 0" xyz="3.5 0 0"/>'
    '<link2 link="rocker" rpy="0.1 0 0" xyz="0 3 0"/></loop_joint>',
    # as Isaac Sim documents it
    '<loop_joint name="C" type="spherical"><link1 link="rod" rpy="0 0 0" xyz="3.5 0 0"/>'
    '<link1 link="rocker" rpy="0 0 0" xyz="0 3 0"/></loop_joint>',
    '<loop_joint name="C" type="continuous"><link1 link="rod" xyz="3.5 0 0"/>'
    '<link2 link="rocker" xyz="0 3 0"/><axis xyz="0 0 1"/></loop_joint>',
    '<loop_joint name="C" type="revolute"><link1 link="rod" xyz="3.5 0 0" rpy="0 0.7 0"/>'
    '<link2 link="rocker" xyz="0 3 0" rpy="0 0.7 0"/><axis xyz="-0.644217687 0 0.764842187"/>'
    "</loop_joint>",
)
CRANK = 0.8


@pytest.mark.parametrize("closing", ENDS)
def test_a_four_bar_that_an_element_of_simulators_closes(closing: str):
    system = kempe.load(robot(*TURNS, closing, links=LINKS))
    assert system.mechanism.notes == [] and system.mobility().dof == 1
    found = system.assemble({"A": CRANK})
    assert found.success
    B = np.array([math.cos(CRANK), math.sin(CRANK)])
    q = system.q_dict(found.q)
    C = np.array([4 - 3 * math.sin(q["D"]), 3 * math.cos(q["D"])])
    assert np.hypot(*(C - B)) == pytest.approx(3.5, abs=1e-8)
    X = system.fk(found.q, "rod")
    np.testing.assert_allclose((X @ [3.5, 0, 0, 1])[:2], C, rtol=0, atol=1e-8)


def test_names_of_what_closes_loops():
    m = read_urdf(robot(*TURNS, ENDS[0], ENDS[0], ENDS[1], links=LINKS))
    assert list(m.constraints) == ["ball_constraint", "ball_constraint_2"]
    assert m.joints["C"].cut and m.joints["C"].where.line == 7 and m.notes == []


@pytest.mark.parametrize(
    ("closing", "words"),
    [
        (ENDS[3].replace('name="C"', 'name="A"'), "<text>:5: joint 'A': there is another joint"),
        (ENDS[3].replace('name="C"', ""), "<loop_joint>: it has no name"),
        (ENDS[3].replace("rocker", "roker"), "'roker' does not exist; did you mean 'rocker'?"),
        (ENDS[3].replace("xyz", "xzy", 1), "unknown link1 attribute 'xzy'; did you mean 'xyz'?"),
        (ENDS[3].replace("0 3 0", "0 3"), "link2 xyz is '0 3': 2 numbers"),
        (ENDS[3].replace(' xyz="0 0 1"', ""), "its <axis> has no xyz"),
        (ENDS[3].replace("0 0 1", "0 0 0"), "axis"),
        (ENDS[3].replace('type="continuous"', ""), "it has no type; a <loop_joint> has spherical"),
        (
            '<loop_joint name="C" type="revolute"><parent link="rod"/><child link="rocker"/>'
            "</loop_joint>",
            "it has 0 ends; a loop joint has two: <link1 link=... xyz=... rpy=.../> and <link2 .../>",
        ),
        (ENDS[0].replace('value="0 3 0"', ""), "its <drake:ball_constraint_p_BQ> has no value"),
        (
            ENDS[0].replace("body_B", "body_A"),
            "it has 2 <drake:ball_constraint_body_A>; it needs one",
        ),
        (ENDS[0].replace('name="rod"', ""), "its <drake:ball_constraint_body_A> names no link"),
    ],
)
def test_wrong_elements_that_close_loops(closing: str, words: str):
    with pytest.raises(DescriptionError) as caught:
        read_urdf(robot(*TURNS, closing, links=LINKS))
    assert words in str(caught.value)


# ---- what is read with a note


def test_negative_limits_of_effort_and_velocity():
    text = robot(
        joint("a", '<limit lower="-1" upper="1" effort="-1" velocity="-2"/>'),
        joint("b", LIMIT, "revolute", "arm", "hand"),
    )
    with pytest.raises(DescriptionError, match="effort limit is -1; .*lenient_limits=True reads"):
        read_urdf(text)
    m = read_urdf(text, lenient_limits=True)
    assert m.joints["a"].effort_limits == {} and m.joints["a"].velocity_limits == {}
    assert m.joints["a"].limits == {"": (-1.0, 1.0)}
    assert "its effort limit is -1; it is read as unlimited, as requested" in "\n".join(m.notes)


def test_a_declaration_is_refused_where_it_stands_inside():
    text = robot(joint(), '<?xml version="1.0"?>')
    with pytest.raises(DescriptionError, match="is not at the very start"):
        read_urdf(text)
