"""The page about numbers of other libraries, judged by these libraries."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kempe import spatial

PAGE = Path(__file__).parents[1] / "docs" / "howto_others.md"
INERTIA = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
MJCF = f"""<mujoco><worldbody><body name="trunk"><freejoint/>{INERTIA}
<body name="leg" pos="0.1 0 0.2" quat="{{}}"><joint name="hip" axis="0 1 0"/>{INERTIA}
<body name="foot" pos="0 0 -0.4"><joint name="ankle" axis="0 1 0"/>{INERTIA}
</body></body></body></worldbody></mujoco>"""


def page(heading: str, **names: Any) -> dict[str, Any]:
    """The names of the page after its first cell and the code of one section."""
    sections = PAGE.read_text("utf-8").split("\n## ")
    section = next(s for s in sections if s.startswith(heading))
    code = re.compile(r"^```py(?:thon)?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
    for cell in (*code.findall(sections[0]), *code.findall(section)):
        exec(compile(cell, "howto_others.md", "exec"), names)
    return names


def test_pinocchio():
    pin = pytest.importorskip("pinocchio")
    of = page("Pinocchio")
    robot, q, v, model, at, rate = (
        of[k] for k in ("robot", "q", "v", "model", "q_there", "v_there")
    )
    data = model.createData()
    foot = model.getFrameId("foot")
    pin.framesForwardKinematics(model, data, at)
    np.testing.assert_allclose(data.oMf[foot].homogeneous, robot.fk(q, "foot"), rtol=0, atol=1e-14)
    for frame, word in ((pin.LOCAL_WORLD_ALIGNED, "world_aligned"), (pin.LOCAL, "body")):
        J = pin.computeFrameJacobian(model, data, at, foot, frame)
        mine = robot.jacobian(q, "foot", word)
        np.testing.assert_allclose(J @ rate, mine @ v, rtol=0, atol=1e-14)
    np.testing.assert_allclose(of["J"], robot.jacobian(q, "foot"), rtol=0, atol=1e-14)
    np.testing.assert_allclose(of["v_again"], v, rtol=0, atol=1e-14)
    move = robot.configuration_space.integrate
    np.testing.assert_allclose(of["q_again"], q, rtol=0, atol=1e-14)
    assert abs(q[7]) > np.pi, "the whole turn is known from the follower"
    # a screw, and a straight line: the same to first order
    for h, same in ((1e-4, True), (0.3, False)):
        there = pin.integrate(model, at, h * rate)[:3]
        here = move(q, h * v)[:3]
        assert np.abs(there - here).max() < 10 * h**2
        assert np.allclose(there, here, rtol=0, atol=1e-6) is same


def test_mujoco():
    mujoco = pytest.importorskip("mujoco")
    turned = spatial.matrix_to_quat_wxyz(spatial.rpy_to_matrix([0.3, 0.2, 0.1]))
    model = mujoco.MjModel.from_xml_string(MJCF.format(" ".join(repr(float(x)) for x in turned)))
    of = page("MuJoCo", model=model)
    robot, q, v = (of[k] for k in ("robot", "q", "v"))
    data = mujoco.MjData(model)
    data.qpos[:] = of["qpos"]
    mujoco.mj_forward(model, data)
    X = robot.fk(q, "foot")
    np.testing.assert_allclose(data.body("foot").xpos, X[:3, 3], rtol=0, atol=1e-14)
    turn = data.body("foot").xmat.reshape(3, 3)
    np.testing.assert_allclose(turn, X[:3, :3], rtol=0, atol=1e-14)
    J = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, J[:3], J[3:], model.body("foot").id)
    twist = robot.jacobian(q, "foot") @ v
    np.testing.assert_allclose(J @ of["qvel"], twist, rtol=0, atol=1e-14)
    np.testing.assert_allclose(of["v_again"], v, rtol=0, atol=1e-14)
    there = data.qpos.copy()
    mujoco.mj_integratePos(model, there, of["qvel"], 0.3)
    here = robot.configuration_space.integrate(q, 0.3 * v)
    np.testing.assert_allclose(there[:8], here, rtol=0, atol=1e-14)


def test_ros():
    of = page("ROS")
    arm = of["arm"]
    assert arm.q_dict(of["q"])["elbow"] == 0.3 and of["v"].tolist() == [0, 0, 1, 0, 0, 0]
    assert tuple(of["sent"].name) == arm.coordinate_names
    np.testing.assert_array_equal(arm.fk(of["q"], "tool"), of["X"])
