"""Every real robot that Pinocchio or MuJoCo can read: where all bodies are, and how frames move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots import good_urdf_files, mimics, mujoco_text

import kempe
from kempe import System
from kempe.equations.judge import compute_coordinate_value
from kempe.poses import place

pin = pytest.importorskip("pinocchio")
mujoco = pytest.importorskip("mujoco")

FILES = good_urdf_files()
pytestmark = pytest.mark.skipif(not FILES, reason="the package example-robot-data is not installed")
every_robot = pytest.mark.parametrize("path", FILES.values(), ids=list(FILES))

FRAMES = {"world_aligned": pin.LOCAL_WORLD_ALIGNED, "world": pin.WORLD, "body": pin.LOCAL}


def joint_values(s: System, path: Path, q: np.ndarray) -> dict[str, float]:
    """Values of all joints with one coordinate, mimic joints resolved from the text of the file."""
    values = s.q_dict(q)
    waiting = mimics(path)
    while waiting:
        ready = [name for name, (source, _, _) in waiting.items() if source in values]
        assert ready
        for name in ready:
            source, factor, offset = waiting.pop(name)
            values[name] = factor * values[source] + offset
    return values


class Pinocchio:
    """A robot as Pinocchio sees it; mimic joints are its own where it can, else set from the file."""

    def __init__(self, path: Path):
        try:
            self.model = pin.buildModelFromUrdf(str(path), mimic=True)
        except ValueError:  # it wants the source of a mimic joint before the joint
            self.model = pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()
        self.bodies = [
            f.name
            for f in self.model.frames
            if f.type == pin.FrameType.BODY and f.name != "universe"
        ]

    def q(self, values: dict[str, float]) -> np.ndarray:
        """Its configuration: circles are (cos, sin), mimic joints have no coordinate."""
        q = pin.neutral(self.model)
        for name, joint in zip(
            list(self.model.names)[1:], list(self.model.joints)[1:], strict=True
        ):
            if joint.shortname() == "JointModelMimic":
                continue
            x = values[name]
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
            )
        return q

    def poses(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        pin.framesForwardKinematics(self.model, self.data, self.q(values))
        return {
            name: self.data.oMf[self.model.getFrameId(name, pin.FrameType.BODY)].homogeneous
            for name in self.bodies
        }

    def jacobian(self, values: dict[str, float], frame: str, kind) -> dict[str, np.ndarray]:
        """Columns by joint name; of the source for its mimic joints."""
        number = self.model.getFrameId(frame, pin.FrameType.BODY)
        J = pin.computeFrameJacobian(self.model, self.data, self.q(values), number, kind)
        joints = zip(list(self.model.names)[1:], list(self.model.joints)[1:], strict=True)
        return {name: J[:, j.idx_v] for name, j in joints if j.shortname() != "JointModelMimic"}


def configurations(s: System, rng: np.random.Generator) -> list[np.ndarray]:
    """Two inside the limits, and one in which the unlimited joints have turned many times."""
    far = s.random(rng)
    wide = np.isinf(s.upper) & s.structure.coordinates.turning
    far[s.structure.layout.vector_q[wide[s.structure.layout.vector_v]]] *= 1e4
    return [s.random(rng), s.random(rng), far]


@every_robot
def test_poses_are_pinocchios(path):
    s = kempe.load(path)
    other = Pinocchio(path)
    for q in configurations(s, np.random.default_rng(0)):
        poses = other.poses(joint_values(s, path, q))
        mine = dict(zip(s.body_names, s.fk(q), strict=True))
        assert set(mine) == set(poses)
        for name, X in poses.items():
            np.testing.assert_allclose(mine[name], X, rtol=0, atol=1e-12, err_msg=name)
    for name in list(poses)[:: max(1, len(poses) // 5)]:
        np.testing.assert_allclose(s.fk(q, name), poses[name], rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            s.fk(np.array([q] * 9), name)[4], poses[name], rtol=0, atol=1e-12
        )


@every_robot
def test_jacobians_are_pinocchios(path):
    s = kempe.load(path)
    other = Pinocchio(path)
    follows = {n: (source, factor) for n, (source, factor, _) in mimics(path).items()}
    q = s.random(np.random.default_rng(1))
    values = joint_values(s, path, q)
    for name in other.bodies[:: max(1, len(other.bodies) // 4)] + other.bodies[-1:]:
        for frame, kind in FRAMES.items():
            expected = dict.fromkeys(s.structure.velocity_names, 0.0)
            for joint, column in other.jacobian(values, name, kind).items():
                factor = 1.0
                while joint in follows:
                    joint, more = follows[joint]
                    factor *= more
                expected[joint] = expected[joint] + factor * column
            columns = np.zeros((6, s.nv))
            for k, v in enumerate(s.structure.velocity_names):
                columns[:, k] = expected[v]
            np.testing.assert_allclose(
                s.jacobian(q, name, frame), columns, rtol=0, atol=1e-10, err_msg=f"{name} {frame}"
            )


@every_robot
def test_poses_are_mujocos(path):
    s = kempe.load(path)
    model = mujoco.MjModel.from_xml_string(mujoco_text(path))
    data = mujoco.MjData(model)
    names = [model.body(i).name for i in range(1, model.nbody)]
    # MuJoCo may melt the root link into its world
    assert {*names, s.body_names[0]} == set(s.body_names)
    for q in configurations(s, np.random.default_rng(2)):
        values = joint_values(s, path, q)
        for j in range(model.njnt):
            data.qpos[model.jnt_qposadr[j]] = values[model.joint(j).name]
        mujoco.mj_kinematics(model, data)
        poses = dict(zip(s.body_names, s.fk(q), strict=True))
        for i, name in enumerate(names, start=1):
            np.testing.assert_allclose(
                poses[name][:3, 3], data.xpos[i], rtol=0, atol=1e-12, err_msg=name
            )
            np.testing.assert_allclose(
                poses[name][:3, :3], data.xmat[i].reshape(3, 3), rtol=0, atol=1e-12, err_msg=name
            )


@every_robot
def test_limits_and_mimics_are_pinocchios(path):
    s = kempe.load(path)
    model = Pinocchio(path).model
    plain = {
        n: j
        for n, j in zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
        if j.nq == 1
    }
    followed = {source for source, _, _ in mimics(path).values()}
    for name, joint in plain.items():
        if name in s.structure.velocity_names and name not in followed:
            i = s.structure.velocity_names.index(name)
            assert s.lower[i] == model.lowerPositionLimit[joint.idx_q]
            assert s.upper[i] == model.upperPositionLimit[joint.idx_q]
    q = s.random(0)
    for name, x in joint_values(s, path, q).items():
        assert compute_coordinate_value(s, q, name) == pytest.approx(x, abs=1e-12)


# ------------------------------------------------------------------ joints that no file has: free,
# spherical, planar


@pytest.mark.parametrize(
    ("kind", "model"),
    [
        ("free", pin.JointModelFreeFlyer()),
        ("spherical", pin.JointModelSpherical()),
        ("translation", pin.JointModelTranslation()),
        ("planar", pin.JointModelPlanar()),
        ("spherical angles", pin.JointModelSphericalZYX()),
    ],
)
def test_joints_with_many_freedoms_are_pinocchios(kind, model):
    """Velocities of a free joint: Pinocchio has both parts in body axes, here the linear one is in
    those of F.
    """
    m = kempe.Mechanism()
    placement = pin.XYZQUATToSE3(np.array([0.3, -0.2, 0.5, *np.array([0.1, 0.7, -0.5, 0.5]) / 1.0]))
    m.joint(
        "j",
        kind.split()[0],
        m.ground,
        m.body("b"),
        at=place(placement.translation, matrix=placement.rotation),
        **({"angles": True} if "angles" in kind else {}),
    )
    s = m.build()
    other = pin.Model()
    other.addJoint(0, model, placement, "j")
    data = other.createData()
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = s.random(rng)
        turn = np.array([[1.0]])
        if kind in ("free", "spherical"):
            theirs = np.concatenate([q[:-4], q[-3:], q[-4:-3]])  # x, y, z, w
        elif kind == "planar":
            theirs = np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2])])
            turn = pin.rpy.rpyToMatrix(0, 0, q[2])[:2, :2]
        else:
            theirs = q
        if kind == "free":
            turn = pin.Quaternion(theirs[3:]).matrix()
        J = pin.computeJointJacobians(other, data, theirs).copy()
        k = turn.shape[0] if kind in ("free", "planar") else 0
        J[:, :k] = J[:, :k] @ turn[:k, :k].T
        np.testing.assert_allclose(s.fk(q, "b"), data.oMi[1].homogeneous, rtol=0, atol=1e-14)
        np.testing.assert_allclose(s.jacobian(q, "b", "world"), J, rtol=0, atol=1e-13)
