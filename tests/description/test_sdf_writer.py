"""SDF that is written: it reads back as the same mechanism, and what cannot be said is listed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots import good_urdf_files
from sdf_files import FILES
from sdf_files import write as write_files

import kempe
from kempe.description.mechanism import Mechanism
from kempe.description.read import read_mechanism
from kempe.description.sdf_reader import read_sdf
from kempe.description.sdf_writer import write_sdf
from kempe.errors import DescriptionError

EXACT: dict[str, Any] = {"rtol": 0, "atol": 1e-12}


def comes_back(m: Mechanism, base: str | None = None) -> Mechanism:
    """The mechanism that the written text gives, whose poses are compared at random coordinates."""
    system = m.build()
    again = read_sdf(write_sdf(m), base=base)
    other = again.build()
    for q in system.random(0, 4):
        by_name = other.q(system.q_dict(q))
        for frame in system.frame_names:
            np.testing.assert_allclose(
                other.fk(by_name, frame), system.fk(q, frame), **EXACT, err_msg=frame
            )
    return again


def oblique() -> Mechanism:
    """A tree with all types of joints, also from child to parent, frames turned on both bodies."""
    m = Mechanism("oblique & <odd>", ground="base")
    turned: dict[str, Any] = {
        "at": (0.1, 0.2, 0.3),
        "rpy": (0.4, -0.5, 0.6),
        "child_at": (-0.2, 0.1, 0.05),
        "child_rpy": (0.3, 0.2, -0.7),
    }
    for name in "abcdefg":
        m.body(name, mass=1.5, center=(0.1, 0.2, 0.3))
    m.revolute("turn", "base", "a", limits=(-1, None), velocity=3, effort=7, **turned)
    m.prismatic("slide", "b", "a", limits=(0.1, 0.5), axis=(1, 2, 3), **turned)
    m.universal("cardan", "a", "c", limits={"rx": (-1, 1)}, **turned)
    m.helical("screw", "c", "d", pitch=0.02, **turned)
    m.spherical("ball", "d", "e", **turned)
    m.planar("table", "e", "f", **turned)
    m.fixed("weld", "g", "f", **turned)
    m.frame("tip", "g", at=(0, 0, 0.1), rpy=(0.1, 0.2, 0.3))
    m.frame("mark", "base", at=(1, 0, 0))
    return m


def test_all_that_can_be_said_comes_back():
    again = comes_back(oblique())
    assert again.name == "oblique & <odd>"
    joint = again.joints["turn"]
    assert (joint.limits, joint.velocity_limits, joint.effort_limits) == (
        {"": (-1.0, np.inf)},
        {"": 3.0},
        {"": 7.0},
    )
    assert again.joints["cardan"].limits == {"rx": (-1.0, 1.0)}
    assert again.joints["screw"].type.options["pitch"] == pytest.approx(0.02, abs=1e-17)
    assert (again.bodies["c"].mass, again.bodies["c"].center) == (1.5, (0.1, 0.2, 0.3))
    assert again.joints["base_fixed"].type.type_name == "fixed" and not again.notes


def test_shapes_come_back():
    m = Mechanism("m")
    m.revolute("j", m.ground, m.body("a"))
    m.shape("a", "box", size=(1, 2, 3), at=(1, 0, 0), rpy=(0, 0, 1), color=(1, 0, 0, 0.5), name="b")
    m.shape("a", "ellipsoid", radii=(1, 2, 3), visual=False)
    m.shape("a", "capsule", radius=0.1, length=0.4, collision=False)
    m.shape("a", "mesh", path="package://x/a&b.stl", scale=(2, 2, 2), collision=False)
    again = read_sdf(write_sdf(m))
    found = [(s.geometry, s.visual, s.collision) for s in again.bodies["a"].shapes]
    given = m.bodies["a"].shapes
    assert found[:2] == [(given[0].geometry, True, False), (given[0].geometry, False, True)]
    assert found[2:] == [(s.geometry, s.visual, s.collision) for s in given[1:]]
    assert again.bodies["a"].shapes[0].color == (1, 0, 0, 0.5)
    np.testing.assert_allclose(
        again.bodies["a"].shapes[0].X_BS.evaluate_pose({}), given[0].X_BS.evaluate_pose({}), **EXACT
    )


def test_locks_followers_and_parameters():
    m = oblique()
    length = m.parameter("length", 0.7)
    m.revolute("last", "g", m.body("h"), at=(length, 0, 0))
    m.couple("last", {"turn": -2.0}, 0.5)
    m.lock({"slide": 0.3, "table.x": 0.1, "table.y": 0.2, "table.rz": 0.4})
    again = comes_back(m)
    assert again.joints["slide"].type.type_name == again.joints["table"].type.type_name == "fixed"
    assert str(again.couplings["last"].sentence) == "last = -2 turn + 0.5"


def test_loops_that_zero_closes():
    m = Mechanism("parallelogram")
    for name in ("left", "right", "top"):
        m.body(name)
    y: dict[str, Any] = {"axis": "y"}
    m.revolute("a", m.ground, "left", **y)
    m.revolute("b", m.ground, "right", at=(1, 0, 0), **y)
    m.revolute("c", "left", "top", at=(0, 0, 1), **y)
    m.revolute("d", "right", "top", at=(0, 0, 1), child_at=(1, 0, 0), cut=True, **y)
    again = comes_back(m)
    assert again.joints["d"].cut and len(again.build().structure.closures) == 1
    m.joints["d"] = m.copy().joints.pop("d")
    m.fixed("e", "right", m.body("x"), at=(5, 0, 0))
    assert comes_back(m).bodies["x"]


@pytest.mark.parametrize("ground", ["world", "floor"])
def test_what_moves_freely_on_the_ground_comes_back(ground: str):
    m = Mechanism("robot", ground=ground)
    at = {"at": (0.1, 0.2, 0.3), "rpy": (0.4, -0.5, 0.6)}
    m.free("base", ground, m.body("base"), **at)
    m.revolute("arm", "base", m.body("hand"), **at, child_at=(0, 0.1, 0))
    m.frame("tip", "hand", at=(0, 0, 0.1))
    again = comes_back(m, base="free")
    assert again.joints["base"].child == "base" and not again.notes
    assert again.build().nq == m.build().nq
    assert "nothing ties 'base' to the world" in read_sdf(write_sdf(m)).notes[0]


def test_free_joints_of_what_other_joints_hold_are_left_out():
    m = Mechanism("m", ground="world")
    m.free("loose", "world", m.body("a"), at=(5, 5, 5))
    m.revolute("r", "world", m.body("b"), at=(1, 0, 0))
    m.revolute("s", "b", "a", at=(1, 0, 0), axis=(0, 1, 0))
    again = read_sdf(write_sdf(m), base="free")
    assert list(again.joints) == ["r", "s"]
    assert again.build().fk([0.0, 0.0], "a")[:3, 3] == pytest.approx([2, 0, 0])
    assert m.build().mobility().dof == again.build().mobility().dof == 2


def test_names_of_nested_models_come_back():
    m = Mechanism("two arms")
    turned: dict[str, Any] = {
        "at": (0.1, 0.2, 0.3),
        "rpy": (0.4, -0.5, 0.6),
        "child_at": (0.1, 0, 0),
    }
    names = ("base", "left::arm", "left::hand", "left::grip::jaw", "left::table", "right::arm")
    for name in names:
        m.body(name)
    m.fixed("stand", m.ground, "base", at=(0, 0, 1))
    m.revolute("left_mount", "base", "left::arm", **turned)
    m.revolute("left::wrist", "left::arm", "left::hand", **turned)
    m.prismatic("left::grip_mount", "left::hand", "left::grip::jaw", limits=(0, 0.1), **turned)
    m.planar("left::slide", "left::hand", "left::table", **turned)
    m.revolute("right_mount", "right::arm", "base", **turned)
    m.couple("left::grip_mount", {"left::wrist": 0.1})
    m.frame("left::grip::tip", "left::grip::jaw", at=(0, 0, 0.1))
    m.frame("mark", "left::hand", at=(0, 0, 0.2))
    text = write_sdf(m)
    assert text.count("<model name=") == 4 and '<model name="grip">' in text
    again = comes_back(m)
    assert again.bodies.keys() == {*m.bodies, "world"}
    assert again.couplings.keys() == m.couplings.keys()
    for name, joint in m.joints.items():
        assert again.joints[name].type.type_name == joint.type.type_name


def test_parts_of_nested_models_that_are_tied_to_parts_outside_are_named():
    m = Mechanism("m", ground="world")
    m.body("arm::link")
    m.body("hand")
    m.revolute("arm::j", m.ground, "arm::link")
    m.revolute("k", m.ground, "hand")
    m.revolute("arm::l", "arm::link", "hand")
    m.frame("arm::tip", "hand")
    m.body("arm")
    m.fixed("x::", "hand", "arm")
    with pytest.raises(DescriptionError) as caught:
        write_sdf(m)
    said = {p.subject: p.message for p in caught.value.problems}
    assert said.keys() == {"joint 'arm::l'", "frame 'arm::tip'", "body 'arm'", "joint 'x::'"}
    assert "nested model 'arm', which does not see 'hand'" in said["joint 'arm::l'"]
    assert "a nested model has its name" in said["body 'arm'"]


def test_files_of_gazebo_come_back(tmp_path: Path):
    for case in ("frames", "version_1_4", "types", "loop"):
        comes_back(read_mechanism(write_files(FILES[case], tmp_path)))


def test_all_that_cannot_be_said_is_listed(tmp_path: Path):
    m = oblique()
    m.free("fly", "a", m.body("bird"))
    m.free("loose", "base", m.body("kite"), angles=True)
    m.cylindrical("sleeve", "base", m.body("__x__"))
    m.distance("rod", "a", "b", 1.0)
    with pytest.raises(DescriptionError) as caught:
        m.save(tmp_path / "m.sdf")
    subjects = [p.subject for p in caught.value.problems]
    assert sorted(subjects) == [
        "body '__x__'",
        "constraint 'rod'",
        "joint 'fly'",
        "joint 'loose'",
        "joint 'sleeve'",
    ]
    assert not (tmp_path / "m.sdf").exists()


@pytest.mark.parametrize("path", list(good_urdf_files().values())[:12])
def test_robots_come_back(path: Path):
    m = read_mechanism(path)
    try:
        text = write_sdf(m)
    except DescriptionError as error:
        assert all("its name, too" in p.message for p in error.problems)
    else:
        assert text and comes_back(m).bodies


def test_converted_by_command(tmp_path: Path):
    path = kempe.read("ur5").save(tmp_path / "ur5.sdf")
    assert kempe.load(path).coordinate_names == kempe.load("ur5").coordinate_names
