"""The shipped models are what they say: published poses, other libraries' models, closed loops,
counted freedoms.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from mechanisms import PLANAR
from mechanisms_spatial import SPATIAL

import kempe
from kempe import library
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.errors import UnknownNameError
from kempe.joints import TYPES

MODELS = library.list_models()
LECTURE = {
    "two_link",
    "two_link_pose",
    "unreachable",
    "seven_bodies",
    "seven_bodies_loop",
    "four_links",
    "slider",
    "car",
    "ball",
}
ROBOTS = {
    "puma560",
    "ur5",
    "cobra600",
    "stanford",
    "panda",
    "ur10e",
    "irb6640",
    "jaco2",
    "crx10ia",
    "hc10",
    "xarm6",
    "gen3",
    "gen3_lite",
    "iiwa14",
    "so101",
    "youbot",
}
JOINTS = {
    "joint_fixed",
    "joint_revolute",
    "joint_prismatic",
    "joint_helical",
    "joint_cylindrical",
    "joint_universal",
    "joint_planar",
    "joint_translation",
    "joint_spherical",
    "joint_free",
}
LINKAGES = {mechanism.name for mechanism in (*PLANAR, *SPATIAL)}


def test_what_is_shipped():
    assert set(MODELS) == LECTURE | ROBOTS | JOINTS | LINKAGES
    assert list(MODELS) == sorted(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_each_model_loads_and_describes_itself(name):
    text = library.find_model_file(name).read_text(encoding="utf-8")
    assert (
        text.startswith(f"# {library.describe_model(name)}\n")
        and 10 < len(library.describe_model(name)) <= 118
    )
    mechanism = read_toml(text, name)
    assert mechanism.name == name and not mechanism.notes
    assert read_toml(write_toml(mechanism)) == mechanism
    system = kempe.load(name)
    assert system == mechanism.build()
    assert np.isfinite(system.fk(system.random(0, 3))).all()


@pytest.mark.parametrize("name", MODELS)
def test_postures_are_allowed_and_loops_closed(name):
    system = kempe.load(name)
    assert not system.structure.closures or "closed" in system.structure.posture_names
    for posture in system.structure.posture_names:
        q = system.q(posture)
        v = q[system.structure.layout.vector_q]
        inside = system.structure.limits[system.structure.layout.vector_v]
        assert (inside[:, 0] <= v).all() and (v <= inside[:, 1]).all()
        if posture == "closed":
            np.testing.assert_allclose(system.loops.closure_error(q), 0.0, rtol=0, atol=1e-14)


def test_names_that_are_not_there():
    for call in (library.find_model_file, library.describe_model):
        with pytest.raises(UnknownNameError, match="did you mean 'puma560'"):
            call("puma5600")


# ------------------------------------------------------------------ the zoo


@pytest.mark.parametrize("model", sorted(JOINTS))
def test_a_model_of_each_joint(model):
    system = kempe.load(model)
    joint = system.structure.joints["joint"]
    assert f"joint_{joint.type.type_name}" == model and joint.type.type_name in TYPES
    said = re.search(r"(\d) DoF", library.describe_model(model))
    assert said is not None and int(said[1]) == joint.type.dof() == system.nv


def test_the_screw_climbs_10_mm_a_turn():
    X = kempe.load("joint_helical").fk([2 * np.pi], "body")
    np.testing.assert_allclose(X[:3, 3], [0, 0, 0.01], rtol=0, atol=1e-14)


# ------------------------------------------------------------------ linkages


def test_the_four_bar_has_the_lengths_that_it_says():
    system = kempe.load("four_bar")
    poses = dict(zip(system.body_names, system.fk(system.q("closed")), strict=True))
    B = poses["crank"] @ [0.1, 0, 0, 1]
    C = poses["coupler"] @ [0.5, 0, 0, 1]
    np.testing.assert_allclose(B[:2], [0, 0.1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(C[:2], [0.4, 0.4], rtol=0, atol=1e-14)
    np.testing.assert_allclose(C, poses["rocker"] @ [0.4, 0, 0, 1], rtol=0, atol=1e-14)
    assert np.linalg.norm(C - B) == pytest.approx(0.5, abs=1e-15)


# ------------------------------------------------------------------ robots


@pytest.mark.parametrize(
    "posture, rotation, position",
    [
        ("qz", np.eye(3), (0.4521, -0.1500, 0.4318)),
        ("qr", np.eye(3), (0.0203, -0.1500, 0.8636)),
        ("qn", [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], (0.5963, -0.1501, -0.0144)),
    ],
)
def test_puma_poses_of_the_textbook(posture, rotation, position):
    """Corke, Robotics, Vision and Control, 2011, section 7.2: four digits."""
    robot = kempe.load("puma560")
    X = robot.fk(robot.q(posture), "tool")
    np.testing.assert_allclose(X[:3, :3], rotation, rtol=0, atol=1e-14)
    np.testing.assert_allclose(X[:3, 3], position, rtol=0, atol=6e-5)


def test_ur5_upright():
    """All lengths along the way up: 1001.059 mm high, 191.45 mm aside."""
    robot = kempe.load("ur5")
    X = robot.fk(robot.q("up"), "tool")
    np.testing.assert_allclose(X[:3, 3], [0, -0.19145, 1.001059], rtol=0, atol=1e-14)


def test_stanford_arm_stretched():
    """At zero angles the slide points up and the hand with it, beside the shoulder by d2."""
    X = kempe.load("stanford").fk({"d3": 0.5}, "tool")
    np.testing.assert_allclose(X[:3, 3], [0, 0.154, 0.412 + 0.5 + 0.263], rtol=0, atol=1e-14)
    np.testing.assert_allclose(X[:3, :3], np.eye(3), rtol=0, atol=1e-14)


def test_toolbox_agrees():
    """Models of the Robotics Toolbox; it has the Puma on a pedestal and another hand on the Panda."""
    rtb = pytest.importorskip("roboticstoolbox")
    rng = np.random.default_rng(0)
    pedestal = np.eye(4)
    hand = np.eye(4)
    pedestal[2, 3] = 26.45 * 0.0254
    hand[2, 3] = 0.103 - 0.1034
    cases = [
        ("puma560", rtb.models.DH.Puma560(), "tool", pedestal, np.eye(4)),
        ("cobra600", rtb.models.DH.Cobra600(), "tool", np.eye(4), np.eye(4)),
        ("panda", rtb.models.DH.Panda(), "panda_hand_tcp", np.eye(4), hand),
    ]
    for name, other, frame, before, after in cases:
        robot = kempe.load(name)
        for q in robot.random(rng, 5):
            expected = other.fkine(q).A
            np.testing.assert_allclose(
                before @ robot.fk(q, frame) @ after, expected, rtol=0, atol=1e-14
            )
        limited = np.isfinite(robot.lower)
        np.testing.assert_allclose(
            robot.structure.limits[limited], np.asarray(other.qlim).T[limited], rtol=1e-15
        )


def test_toolbox_agrees_on_the_jaco():
    """Its table has the lengths of an older edition, and Kinova's angles."""
    rtb = pytest.importorskip("roboticstoolbox")
    other = rtb.models.DH.Jaco()
    robot = kempe.load("jaco2").with_parameters(D4=0.0743, D5=0.0743, D6=0.1687)
    for q in robot.random(0, 5):
        np.testing.assert_allclose(robot.fk(q, "tool"), other.fkine(q).A, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "name, frame, q, rotation, position",
    [
        ("ur10e", "tool", "up", None, (0, -0.17415 - 0.11655, 0.1807 + 0.6127 + 0.57155 + 0.11985)),
        ("iiwa14", "tool", None, np.eye(3), (0, 0, 0.36 + 0.42 + 0.4 + 0.126)),
        (
            "irb6640",
            "tool0",
            None,
            [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
            (0.32 + 1.392 + 0.2, 0, 0.78 + 1.075 + 0.2),
        ),
        (
            "crx10ia",
            "tool0",
            None,
            [[0, 0, 1], [0, -1, 0], [1, 0, 0]],
            (0.54 + 0.16, -0.15, 0.245 + 0.54),
        ),
        ("hc10", "tool0", None, np.diag([1, -1, -1]), (0, 0.162, 0.275 + 0.7 - 0.5 - 0.13)),
        (
            "xarm6",
            "tool",
            None,
            np.diag([1, -1, -1]),
            (0.0535 + 0.0775 + 0.076, 0, 0.267 + 0.2845 - 0.3425 - 0.097),
        ),
        (
            "gen3",
            "tool",
            None,
            np.eye(3),
            (
                0,
                -0.005375 - 3 * 0.006375 - 2 * 0.00017505,
                0.15643 + 0.12838 + 2 * 0.21038 + 0.20843 + 2 * 0.10593 + 0.061525,
            ),
        ),
        (
            "gen3_lite",
            "tool",
            None,
            np.eye(3),
            (0.057, -0.01, 0.12825 + 0.115 + 0.28 + 0.14 + 0.105 + 0.105),
        ),
        (
            "youbot",
            "tool",
            "candle",
            np.eye(3),
            (0.024 + 0.033 - 0.002, 0, 0.096 + 0.019 + 0.155 + 0.135 + 0.13),
        ),
    ],
)
def test_robots_stretched(name, frame, q, rotation, position):
    """Postures in which the lengths of the data sheet add up."""
    robot = kempe.load(name)
    X = robot.fk(robot.q(q) if q else robot.neutral, frame)
    if rotation is not None:
        np.testing.assert_allclose(X[:3, :3], rotation, rtol=0, atol=1e-14)
    np.testing.assert_allclose(X[:3, 3], position, rtol=0, atol=1e-14)


def robot_file(name: str) -> str:
    folder = (
        Path(sys.prefix)
        / "lib"
        / f"python{sys.version_info[0]}.{sys.version_info[1]}"
        / "site-packages"
    )
    found = sorted(folder.glob(f"cmeel.prefix/share/example-robot-data/robots/**/{name}"))
    if not found:
        pytest.skip("example-robot-data is not installed")
    return str(found[0])


@pytest.mark.parametrize(
    "name, file, base, ours, theirs, tolerance",
    [
        ("panda", "panda.urdf", "panda_link0", "tool", "panda_link8", 1e-12),
        ("panda", "panda.urdf", "panda_link0", "panda_hand_tcp", "panda_hand_tcp", 1e-12),
        # its maker's file writes pi/2 with twelve digits
        ("ur5", "ur5_robot.urdf", "base", "tool", "tool0", 1e-10),
        # its maker's file writes right angles with six digits
        ("so101", "so101.urdf", "base_link", "tool", "gripper_frame_link", 2e-5),
    ],
)
def test_pinocchio_agrees(name, file, base, ours, theirs, tolerance):
    """The published table and the maker's URDF are the same robot."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(robot_file(file))
    data = model.createData()
    robot = kempe.load(name)

    def placed(frame: str) -> np.ndarray:
        return data.oMf[model.getFrameId(frame)].homogeneous

    for q in robot.random(1, 5):
        pin.framesForwardKinematics(model, data, np.concatenate([q, np.zeros(model.nq - robot.nq)]))
        expected = np.linalg.inv(placed(base)) @ placed(theirs)
        np.testing.assert_allclose(robot.fk(q, ours), expected, rtol=0, atol=tolerance)
    if name == "panda":
        limits = np.stack([model.lowerPositionLimit, model.upperPositionLimit], axis=-1)[: robot.nq]
        np.testing.assert_array_equal(robot.structure.limits, limits)
