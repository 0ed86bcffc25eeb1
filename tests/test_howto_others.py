"""The page about numbers of other libraries, judged by these libraries."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kempe import spatial

PAGE = Path(__file__).parents[1] / "docs" / "howto_others.md"
MJCF = """<mujoco><worldbody><body name="trunk"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<body name="leg" pos="0.1 0 0.2" quat="{}"><joint name="hip" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def page() -> dict:
    """The names of the page after its first two cells: robot, q, v, and what they are for
    Pinocchio.
    """
    cells = re.findall(
        r"^```\{code-cell\} python\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE
    )
    names: dict = {}
    for cell in cells[:2]:
        exec(compile(cell, "howto_others.md", "exec"), names)
    return names


def test_pinocchio(page):
    pin = pytest.importorskip("pinocchio")
    robot, q, v = (page[k] for k in ("robot", "q", "v"))
    model = pin.buildModelFromXML(page["urdf"], pin.JointModelFreeFlyer())
    data = model.createData()
    leg = model.getFrameId("leg")
    at = page["q_pinocchio"]
    rate = page["v_pinocchio"]
    pin.framesForwardKinematics(model, data, at)
    np.testing.assert_allclose(data.oMf[leg].homogeneous, robot.fk(q, "leg"), rtol=0, atol=1e-14)
    J, own = (
        pin.computeFrameJacobian(model, data, at, leg, f)
        for f in (pin.LOCAL_WORLD_ALIGNED, pin.LOCAL)
    )
    np.testing.assert_allclose(J @ rate, robot.jacobian(q, "leg") @ v, rtol=0, atol=1e-14)
    np.testing.assert_allclose(own @ rate, robot.jacobian(q, "leg", "body") @ v, rtol=0, atol=1e-14)
    walk = robot.configuration_space.integrate
    # a screw, and a straight line: the same to first order
    for h, same in (
        (1e-4, True),
        (0.3, False),
    ):
        there = pin.integrate(model, at, h * rate)
        assert (np.abs(there[:3] - walk(q, h * v)[:3]).max() < 10 * h**2) and (
            np.allclose(there[:3], walk(q, h * v)[:3], rtol=0, atol=1e-6) is same
        )


def test_mujoco(page):
    mujoco = pytest.importorskip("mujoco")
    robot, q, v = (page[k] for k in ("robot", "q", "v"))
    turned = spatial.matrix_to_quat_wxyz(spatial.rpy_to_matrix([0.3, 0.2, 0.1]))
    model = mujoco.MjModel.from_xml_string(MJCF.format(" ".join(repr(float(x)) for x in turned)))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("leg").xpos, robot.fk(q, "leg")[:3, 3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        data.body("leg").xmat.reshape(3, 3), robot.fk(q, "leg")[:3, :3], rtol=0, atol=1e-14
    )
    linear = np.zeros((3, 7))
    angular = np.zeros((3, 7))
    mujoco.mj_jacBody(model, data, linear, angular, model.body("leg").id)
    np.testing.assert_allclose(
        np.vstack([linear, angular]), robot.jacobian(q, "leg"), rtol=0, atol=1e-14
    )
    there = data.qpos.copy()
    mujoco.mj_integratePos(model, there, v, 0.3)
    np.testing.assert_allclose(
        there, robot.configuration_space.integrate(q, 0.3 * v), rtol=0, atol=1e-14
    )
