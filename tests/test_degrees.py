"""Angles that look like degrees give a warning that names the place; others give none."""

from __future__ import annotations

import math
import re
import warnings

import numpy as np
import pytest
from command import Result
from hypothesis import given
from hypothesis import strategies as st

import kempe
from kempe import spatial
from kempe.errors import DegreesWarning
from kempe.words import convert_sentence_angles

ARM = kempe.load("puma560")
LOOP = kempe.load("four_bar")
REST = [0.1, -0.4, 0.3, 0.2, 0.5, -0.6]


def add_joint(**keywords):
    m = kempe.Mechanism("m")
    return m.revolute("hinge", m.ground, m.body("b"), **keywords)


def read_urdf(text: str):
    return kempe.read(
        f'<robot name="r"><link name="a"/><link name="b"/>'
        f'<joint name="j" type="revolute"><parent link="a"/><child link="b"/>{text}</joint></robot>',
        format="urdf",
    )


PLACES = {
    "q['q2'] is 45 rad, 7.2 turns": lambda: ARM.fk([0, 45, -90, 0, 30, 0], "tool"),
    "'q2' is -90 rad": lambda: ARM.fk({"q2": -90.0}, "tool"),
    "start['q1'] is 30 rad": lambda: ARM.ik(ARM.fk(REST, "tool"), "tool", start=[30, *REST[1:]]),
    "'A' is 30 rad": lambda: LOOP.assemble({"A": 30}),
    "'A' is 15 rad": lambda: LOOP.assemble({"A": np.arange(0, 20, 5)}),
    "'A' is 25 rad": lambda: LOOP.assemble({"A": [10, 20.5, 25]}),
    "'A' is 360 rad": lambda: LOOP.drive({"A": 360}),
    "'A' is 20 rad": lambda: LOOP.drive({"A": np.linspace(0, 40, 5)}),
    "start['A'] is 90 rad": lambda: LOOP.trace("A", start=[90, 0, 0, 0]),
    "rpy is 90 rad": lambda: ARM.ik({"at": (0.5, 0.2, 0.1), "rpy": (0, 90, 0)}, "tool"),
    "angle is 90 rad": lambda: spatial.rot_z(90),
    "rpy is 180 rad": lambda: spatial.pose_from_xyz_rpy([0, 0, 0, 0, 180, 0]),
    "joint 'hinge': a limit is -180 rad, -28.6 turns": lambda: add_joint(limits=(-180, 180)),
    "joint 'hinge': rpy is 90 rad": lambda: add_joint(rpy=(0, 90, 0)),
    "joint 'hinge': angle is 45 rad": lambda: add_joint(angle=45),
    "limits of 'q1': a limit is 170 rad": lambda: ARM.with_limits({"q1": (-1.0, 170)}),
    ":1: joint 'j': a limit is -90 rad": lambda: read_urdf(
        '<limit lower="-90" upper="90" effort="1" velocity="1"/>'
    ),
    ":1: joint 'j': rpy is 90 rad": lambda: read_urdf(
        '<origin rpy="0 0 90"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    ),
}


@pytest.mark.parametrize("said", PLACES)
def test_the_place_is_named(said):
    with pytest.warns(DegreesWarning) as seen:
        PLACES[said]()
    (one,) = seen
    assert said in str(one.message)
    written = "angles in files are radians: for" if said[0] == ":" else "* kempe.deg"
    assert written in str(one.message)
    assert one.filename == __file__


def count_warnings(call) -> int:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        call()
    return len(seen)


@given(st.floats(-4 * math.pi, 4 * math.pi), st.integers(-150, 150))
def test_angles_below_two_turns_and_numbers_in_between_are_radians(angle, halves):
    between = 0.5 * halves + (0.25 if halves % 10 == 0 else 0.0)

    def use():
        for x in (angle, between):
            ARM.fk([x, *REST[1:]], "tool")
            spatial.rot_x(x)
            add_joint(limits=(x - 1e-9, x), angle=x)

    assert not count_warnings(use)


@pytest.mark.parametrize("upper", [20 * 2 * math.pi, 1000, 1e9, math.inf, 6.68])
def test_a_winch_and_limits_that_are_none_are_what_they_say(upper):
    assert not count_warnings(lambda: add_joint(limits=(-upper, upper)))


def test_lengths_are_no_angles():
    m = kempe.Mechanism("m", dim=2)
    assert not count_warnings(
        lambda: m.prismatic("s", m.ground, m.body("b"), axis="x", limits=(0, 500))
    )
    assert not count_warnings(lambda: m.build().fk([400.0], "b"))


def test_arrays_of_programs_are_not_looked_at():
    assert not count_warnings(lambda: ARM.fk(np.array([30.0, *REST[1:]]), "tool"))


def test_one_degree_and_one_millimetre():
    assert np.allclose(spatial.rot_z(90 * kempe.deg), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert 360 * kempe.deg == pytest.approx(math.tau)
    assert 25.4 * kempe.mm == pytest.approx(0.0254)


@pytest.mark.parametrize(
    "words",
    [
        ("fk", "puma560", "--frame", "tool", "--q", "30,45,-90,0,30,0"),
        ("ik", "puma560", "--frame", "tool", "--target", "0.5,0.2,0.1,0,90,0"),
        ("assemble", "four_bar", "A=30"),
    ],
)
def test_commands_advise_to_give_deg(words):
    found = Result(*words)
    assert "rad" in found.err and "for degrees give --deg" in found.err
    assert "DegreesWarning" not in found.err
    assert "--deg" not in Result(*words, "--deg").err


@pytest.mark.parametrize(
    ("sentence", "shown"),
    [
        ("missed by 0.2 m, 0.36 rad", "missed by 0.2 m, 20.6 deg"),
        ("'A' = 0.872665 rad is not on it", "'A' = 50 deg is not on it"),
        ("1e-16 rad, at most 3.1 rad/s", "6e-15 deg, at most 3.1 rad/s"),
        ("radii of 2 m", "radii of 2 m"),
    ],
)
def test_sentences_have_degrees_where_these_are_requested(sentence, shown):
    assert convert_sentence_angles(sentence, False) == sentence
    assert convert_sentence_angles(sentence, True) == shown


def test_the_text_of_an_answer_has_its_error_in_degrees():
    answer = ARM.ik(spatial.pose(spatial.rot_z(1.0), [9.0, 0.0, 0.0]), "tool")
    (radians,) = re.findall(r"misses it by \S+ m, (\S+) rad", answer.text())
    (degrees,) = re.findall(r"misses it by \S+ m, (\S+) deg", answer.text(degrees=True))
    assert float(degrees) == pytest.approx(np.degrees(float(radians)), rel=1e-2)
