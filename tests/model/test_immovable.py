"""Coordinates that limits hold still, and why it is said where an answer fails."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe.answers.wording import describe_immovable_coordinates
from kempe.description.urdf_reader import read_urdf

EFFORT = '<limit effort="1" velocity="1"/>'


def chain(*limits: str, more: str = "") -> str:
    """A planar chain of unit links about z; the limits of its joints j0, j1, ...; its last link is
    'tip'.
    """
    parts = ['<link name="l0"/>']
    for i, limit in enumerate(limits):
        x = 0 if i == 0 else 1
        parts.append(
            f'<link name="l{i + 1}"/><joint name="j{i}" type="revolute"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>{limit}</joint>'
        )
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="l{len(limits)}"/><child '
        'link="tip"/><origin xyz="1 0 0"/></joint>'
    )
    return f'<robot name="r">{"".join(parts)}{more}</robot>'


WIDE = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
STILL = '<limit lower="0.5" upper="0.5" effort="1" velocity="1"/>'


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ((WIDE, WIDE), ""),
        (
            (EFFORT, WIDE),
            "'j0' cannot move (0..0 because the file gives no bounds; lenient_limits=True reads it "
            "as unlimited)",
        ),
        (
            (EFFORT, EFFORT),
            "'j0', 'j1' cannot move (0..0 because the file gives no bounds; lenient_limits=True "
            "reads them as unlimited)",
        ),
        (
            (STILL, EFFORT),
            "'j1' cannot move (0..0 because the file gives no bounds; lenient_limits=True reads it "
            "as unlimited); 'j0' cannot move (lower and upper limit of it are the same)",
        ),
    ],
)
def test_what_holds_joints_still(limits, said):
    assert describe_immovable_coordinates(read_urdf(chain(*limits)).build()) == said


def test_many_names_are_cut_short_and_given_limits_can_be_left_out():
    s = read_urdf(chain(*[EFFORT] * 8, STILL)).build()
    assert describe_immovable_coordinates(s).startswith(
        "'j0', 'j1', 'j2', 'j3', 'j4', 'j5', ... (8 in all) cannot move"
    )
    assert "'j8'" not in describe_immovable_coordinates(
        s, unstated=True
    ) and describe_immovable_coordinates(s, [8]).startswith("'j8' cannot move (lower")
    assert describe_immovable_coordinates(s, [0]).startswith("'j0' cannot move (0..0")


def test_a_follower_without_bounds_holds_its_leader():
    mimic = '<limit effort="1" velocity="1"/><mimic joint="j0"/>'
    assert (
        "'j0' cannot move (0..0 because the file gives no bounds"
        in describe_immovable_coordinates(read_urdf(chain(WIDE, mimic)).build())
    )


def test_what_comes_along_with_copies():
    text = chain(EFFORT, WIDE)
    m = kempe.Mechanism("host")
    m.attach(kempe.read(text), prefix="a_")
    assert describe_immovable_coordinates(m.build()).startswith("'a_j0' cannot move (0..0 because")
    assert describe_immovable_coordinates(
        kempe.load(text).mechanism.subchain("l0", "l1").build()
    ).startswith("'j0' cannot move (0..0 because")
    assert kempe.read(text) == kempe.read(
        text.replace(EFFORT, '<limit lower="0" upper="0" effort="1" velocity="1"/>')
    )


TARGET = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, 1.0], [0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize("ask", ["pose", "position", "tasks", "ik_all", "assemble", "trace"])
def test_failures_name_joints_that_the_file_holds_still(ask: str):
    loop = (
        '<joint name="loop" type="continuous"><parent link="l0"/><child link="tip"/><origin '
        'xyz="0.5 1 0"/></joint>'
    )
    s = kempe.load(chain(EFFORT, EFFORT, EFFORT, more=loop if ask in ("assemble", "trace") else ""))
    answer = {
        "pose": lambda: s.ik(TARGET, "tip"),
        "position": lambda: s.ik(TARGET[:3, 3], "tip"),
        "tasks": lambda: s.ik([kempe.tasks.Position("tip", TARGET[:3, 3])]),
        "ik_all": lambda: s.ik_all(TARGET, "tip"),
        "assemble": lambda: s.assemble(),
        "trace": lambda: s.trace(),
    }[ask]()
    assert not answer
    assert (
        "'j0', 'j1', 'j2' cannot move (0..0 because the file gives no bounds; lenient_limits=True"
        in answer.status
    )


@pytest.mark.parametrize("ask", ["ik", "assemble"])
def test_lenient_limits_let_them_move(ask: str):
    loop = (
        '<joint name="loop" type="continuous"><parent link="l0"/><child link="tip"/><origin '
        'xyz="0.5 1 0"/></joint>'
    )
    text = chain(
        EFFORT, EFFORT, EFFORT, more=loop.replace("/></joint>", '/><axis xyz="0 0 1"/></joint>')
    )
    s = kempe.load(
        text if ask == "assemble" else chain(EFFORT, EFFORT, EFFORT), lenient_limits=True
    )
    assert s.assemble() if ask == "assemble" else s.ik(TARGET, "tip")


def test_a_success_says_nothing_of_limits():
    s = kempe.load(chain(EFFORT, WIDE, WIDE))
    assert "cannot move" not in s.ik(s.fk([0, 0.3, 0.4], "tip"), "tip").status
