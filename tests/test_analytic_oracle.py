"""The oracle of inverse solutions against Pinocchio, derivatives, closed forms and published
counts.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

ARMS = arms.arms()
MANSEUR_R = np.array(
    [[-0.760117, -0.641689, 0.102262], [0.133333, 0.0, 0.991071], [-0.635959, 0.766965, 0.085558]]
)


def manseur_target() -> np.ndarray:
    """The pose of the paper, with its rotation of six digits made orthonormal."""
    U, _, V = np.linalg.svd(MANSEUR_R)
    X = np.eye(4)
    X[:3, :3] = U @ V
    X[:3, 3] = (-1.140175, 0.0, 0.0)
    return X


def test_there_are_arms_of_every_class():
    assert len(ARMS) >= 30 and set(arms.COUNTS) == set(ARMS)
    assert {len(a.model.kinds) for a in ARMS.values()} == {2, 3, 4, 5, 6, 7}


@pytest.mark.parametrize("name", ARMS)
def test_systems_and_models_are_the_same_chain(name):
    """The package's forward model against that of the oracle, two programs from one table."""
    arm = ARMS[name]
    q = arm.random(1, 8)
    np.testing.assert_allclose(arm.system.fk(q, arm.frame), arm.model.fk(q), rtol=0, atol=2e-14)


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
def test_pinocchio_agrees_with_the_model(arm):
    pin = pytest.importorskip("pinocchio")
    m = arm.model
    frames, tip = arms.frames_of(m)
    robot = pin.Model()
    at = 0
    for i, (X, kind) in enumerate(zip(frames, m.kinds, strict=True)):
        joint = pin.JointModelRZ() if kind == oracle.TURN else pin.JointModelPZ()
        at = robot.addJoint(at, joint, pin.SE3(X[:3, :3], X[:3, 3]), f"j{i}")
    data = robot.createData()
    for q in arm.random(2, 3):
        theta = m.theta(q)
        pin.forwardKinematics(robot, data, theta)
        np.testing.assert_allclose(
            data.oMi[at].homogeneous @ tip, m.fk(q), rtol=0, atol=2e-14, err_msg=arm.name
        )


@pytest.mark.parametrize("name", ["puma560", "randomRRPRRR_2", "so101", "gen3", "sleeve"])
def test_jacobians_are_derivatives(name):
    m = ARMS[name].model
    theta = m.theta(ARMS[name].random(3, 1)[0])
    step = 1e-6
    J = m.jacobian(theta)
    for i in range(m.n):
        ahead = m.pose(theta + step * np.eye(m.n)[i])
        behind = m.pose(theta - step * np.eye(m.n)[i])
        w = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec() / (2 * step)
        v = (ahead[:3, 3] - behind[:3, 3]) / (2 * step)
        np.testing.assert_allclose(J[:, i], [*v, *w], rtol=0, atol=1e-8)


def test_sixteen_real_solutions_of_manseur_and_doty():
    m = ARMS["manseur_doty"].model
    found = oracle.isolated(m, manseur_target())
    assert len(found) == 16
    position, angle = oracle.error(m.pose(found), manseur_target())
    assert position.max() < 1e-10 and angle.max() < 1e-10


@pytest.mark.parametrize("name", ["planar2", "flat2"])
def test_two_links_have_the_solutions_of_the_closed_form(name):
    m = ARMS[name].model
    for q in ARMS[name].random(4, 5):
        X = m.fk(q)
        found = oracle.isolated(m, X, "position")
        expected = np.array(oracle.two_link(X[0, 3], X[1, 3], 0.5, 0.4))
        assert len(found) == len(expected) == 2
        assert max(m.apart(found, e).min() for e in expected) < 1e-9


@pytest.mark.slow
def test_three_links_have_the_solutions_of_the_closed_form():
    m = ARMS["planar3"].model
    for q in ARMS["planar3"].random(5, 5):
        X = m.fk(q)
        phi = np.arctan2(X[1, 0], X[0, 0]) - 0.3  # the tip is turned on the last link
        expected = np.array(oracle.three_link(X[0, 3], X[1, 3], phi, 0.5, 0.4, 0.2))
        found = oracle.isolated(m, X)
        assert len(found) == len(expected) == 2
        assert max(m.apart(found, e).min() for e in expected) < 1e-9


def test_held_joints_are_constants():
    arm = ARMS["gen3"]
    q = arm.random(6, 1)[0]
    held = arm.model.held({"joint_2": q[1], "joint_7": q[6]})
    assert held.n == 5
    np.testing.assert_allclose(held.fk(q), arm.model.fk(q), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "name", ["puma560", "ur10e", "jaco2", "randomRRRPRR_3", "orthogonal3_cuspidal"]
)
def test_singular_configurations_are_singular(name):
    arm = ARMS[name]
    for seed in range(3):
        theta, direction = oracle.singular_configuration(
            arm.model, np.random.default_rng(seed), arm.task
        )
        assert arm.model.condition(theta, arm.task) < 1e-12
        assert arm.model.condition(theta + 0.01 * direction, arm.task) > 1e-6


@pytest.mark.parametrize("name", ["puma560", "jaco2_1e-5", "randomRRRRPR_4", "mobile_base"])
def test_regauged_arms_are_the_same(name):
    arm = ARMS[name]
    new, base, tool, signs = arms.regauged(arm, 1)
    q = arm.random(7, 3)
    q_new = np.empty_like(q)
    q_new[:, new.model.index] = signs * arm.model.theta(q)
    np.testing.assert_allclose(
        new.system.fk(q_new, "tool"), base @ arm.model.fk(q) @ tool, rtol=0, atol=1e-13
    )
