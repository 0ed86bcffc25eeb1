"""Numbers of Pinocchio and MuJoCo, judged by these libraries; messages of ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hunts import some
from robots import good_urdf_files, mujoco_text

import kempe
from kempe import Mechanism, System, convert
from kempe.convert import Correspondence
from kempe.errors import InputError, UnknownNameError

ROBOTS = good_urdf_files()
GRIPPER = """<robot name="gripper"><link name="palm"/><link name="left"/><link name="right"/>
<joint name="a" type="{kind}"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>{limit}</joint>
<joint name="b" type="{kind}"><parent link="palm"/><child link="right"/><mimic joint="a" multiplier="-2" offset="0.3"/>
{limit}</joint></robot>"""
LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'


def gripper(kind: str = "continuous") -> str:
    """A URDF whose second joint follows the first."""
    return GRIPPER.format(kind=kind, limit=LIMIT if kind == "revolute" else "")


def pinocchio_agrees(pin: Any, robot: System, model: Any, seed: int = 0) -> int:
    """Poses, twists, Jacobians of all bodies, and the way back; the number of bodies that were
    compared.
    """
    data = model.createData()
    rng = np.random.default_rng(seed)
    q = robot.random(seed, 2)
    v = rng.normal(size=(2, robot.nv))
    both = Correspondence(robot, model)
    at = both.to_q(q)
    rate = both.to_v(q, v)
    assert at.shape == (2, model.nq) and rate.shape == (2, model.nv)
    there = robot.configuration_space.difference(q, both.from_q(at))
    np.testing.assert_allclose(there, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(both.from_v(at, rate), v, rtol=0, atol=1e-12)
    pin.computeJointJacobians(model, data, at[1])
    pin.forwardKinematics(model, data, at[1], rate[1])
    pin.updateFramePlacements(model, data)
    seen = 0
    for i, frame in enumerate(model.frames):
        if frame.type == pin.FrameType.BODY and frame.name in robot.frame_names:
            seen += 1
            J = pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)
            twist = pin.getFrameVelocity(model, data, i, pin.LOCAL_WORLD_ALIGNED).vector
            body_agrees(both, frame.name, q[1], v[1], data.oMf[i].homogeneous, J)
            assert np.abs(twist - J @ rate[1]).max() < 1e-12
    return seen


def body_agrees(both: Correspondence, name: str, q: Any, v: Any, X: Any, J: Any) -> None:
    """The pose and the Jacobian of a body there, at what q and v are there."""
    mine = both.system.jacobian(q, name)
    off = [
        X - both.system.fk(q, name),
        J @ both.to_v(q, v) - mine @ v,
        both.from_jacobian(both.to_q(q), J) - mine,
        both.to_jacobian(q, mine) @ both.to_v(q, v) - mine @ v,
    ]
    assert max(np.abs(x).max(initial=0.0) for x in off) < 1e-12, name


def mujoco_agrees(mujoco: Any, robot: System, model: Any, seed: int = 0) -> int:
    """The same with MuJoCo."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    q = robot.random(seed, 2)
    v = rng.normal(size=(2, robot.nv))
    both = Correspondence(robot, model)
    at = both.to_q(q)
    rate = both.to_v(q, v)
    there = robot.configuration_space.difference(q, both.from_q(at))
    np.testing.assert_allclose(there, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(both.from_v(at, rate), v, rtol=0, atol=1e-12)
    data.qpos[:] = at[1]
    mujoco.mj_forward(model, data)
    seen = 0
    X = np.eye(4)
    for i in range(1, model.nbody):
        name = model.body(i).name or f"body{i}"
        if name in robot.frame_names:
            seen += 1
            J = np.zeros((6, model.nv))
            mujoco.mj_jacBody(model, data, J[:3], J[3:], i)
            X[:3, 3] = data.xpos[i]
            X[:3, :3] = data.xmat[i].reshape(3, 3)
            body_agrees(both, name, q[1], v[1], X, J)
    return seen


# ---- all robots of a package of files


@pytest.mark.slow
@pytest.mark.parametrize("base", some([None, "free"], 2))
def test_robots_in_pinocchio(base):
    pin = pytest.importorskip("pinocchio")
    done = 0
    for path in ROBOTS.values():
        root = [] if base is None else [pin.JointModelFreeFlyer()]
        model = pin.buildModelFromUrdf(str(path), *root)
        robot = kempe.load(str(path), base=base)
        if not robot.nq:
            continue  # Pinocchio's Jacobians of no joints end the process
        assert pinocchio_agrees(pin, robot, model) >= len(robot.body_names) - 1, path
        done += 1
    assert done > 60


@pytest.mark.slow
@pytest.mark.parametrize("base", some([None, "free"], 2))
def test_robots_in_mujoco(base):
    mujoco = pytest.importorskip("mujoco")
    done = 0
    for path in ROBOTS.values():
        robot = kempe.load(str(path), base=base)
        spec = mujoco.MjSpec.from_string(mujoco_text(path))
        first = spec.worldbody.first_body()
        if first is None or (base and first.name != robot.body_names[1]):
            continue  # what is called world is the ground there
        if base:
            first.add_freejoint()
        done += 1
        assert mujoco_agrees(mujoco, robot, spec.compile()) >= len(robot.body_names) - 2, path
    assert done > 50 or not ROBOTS


# ---- all kinds of joints


def zoo() -> System:
    """A tree of all joints that Pinocchio has, on a base that slides in a plane."""
    m = Mechanism("zoo")
    last: Any = m.ground
    for name, add in {
        "base": m.planar,
        "ball": m.spherical,
        "wheel": m.revolute,
        "screw": lambda n, *a, **k: m.joint(n, "helical", *a, pitch=0.2, **k),
        "cross": m.universal,
        "table": lambda n, *a, **k: m.joint(n, "translation", *a, **k),
        "angles": lambda *a, **k: m.spherical(*a, angles=True, **k),
        "arm": lambda n, *a, **k: m.joint(n, "P(x) R(z) S", *a, **k),
        "free": m.free,
        "slide": m.prismatic,
    }.items():
        body = m.body(f"on {name}")
        add(name, last, body, at=(0.1, 0.2, 0.3), rpy=(0.3, -0.2, 0.5))
        last = body
    return m.build()


def pinocchio_zoo(pin: Any) -> Any:
    """The same, by hand, in another order of names."""
    model = pin.Model()
    robot = zoo()
    X = np.asarray(robot.structure.joints["ball"].X_PF.evaluate_pose({}))
    composite = pin.JointModelComposite(pin.JointModelPX())
    composite.addJoint(pin.JointModelRZ())
    composite.addJoint(pin.JointModelSpherical())
    kinds = {
        "root_joint": pin.JointModelPlanar(),
        "ball": pin.JointModelSpherical(),
        "wheel": pin.JointModelRUBZ(),
        "screw": pin.JointModelHZ(0.2),
        "cross": pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
        "table": pin.JointModelTranslation(),
        "angles": pin.JointModelSphericalZYX(),
        "arm": composite,
        "free": pin.JointModelFreeFlyer(),
        "slide": pin.JointModelPZ(),
    }
    parent = 0
    for (name, kind), body in zip(kinds.items(), robot.body_names[1:], strict=True):
        parent = model.addJoint(parent, kind, pin.SE3(X), name)
        model.addFrame(pin.Frame(body, parent, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return model


def test_all_kinds_of_joints_in_pinocchio():
    pin = pytest.importorskip("pinocchio")
    for seed in range(3):
        assert pinocchio_agrees(pin, zoo(), pinocchio_zoo(pin), seed) == 10


MJCF = """<mujoco><compiler angle="radian"/><worldbody>
<body name="cart" pos="0.1 0.2 0.3" euler="0.3 -0.2 0.5"><joint name="cart_x" type="slide" axis="1 0 0"/>
 <joint name="cart_y" type="slide" axis="0 1 0"/><joint name="cart_turn" axis="0 0 1"/><geom size="0.1"/>
 <body name="head" pos="0.1 0.2 0.3" euler="0.3 -0.2 0.5"><joint name="neck" type="ball"/><geom size="0.1"/>
  <body name="eye" pos="0.1 0.2 0.3"><joint name="lid" axis="0 0 1"/><geom size="0.1"/></body></body></body>
<body name="drone" pos="1 2 3" euler="0.1 0.2 0.3"><freejoint/><geom size="0.1"/></body>
</worldbody></mujoco>"""


def cart() -> System:
    """The same in another order, with one joint for three, and the place of the drone in a joint."""
    m = Mechanism("cart")
    at: Any = {"at": (0.1, 0.2, 0.3), "matrix": turned("xyz", (0.3, -0.2, 0.5))}
    drone, body, head, eye = (m.body(n) for n in ("drone", "cart", "head", "eye"))
    m.free("base", m.ground, drone, at=(1, 2, 3), matrix=turned("xyz", (0.1, 0.2, 0.3)))
    m.planar("floor", m.ground, body, **at)
    m.spherical("neck", body, head, **at)
    m.revolute("lid", head, eye, at=(0.1, 0.2, 0.3))
    return m.build()


def turned(axes: str, angles: tuple[float, ...]) -> np.ndarray:
    """Turns about moving axes, one after the other."""
    R = np.eye(3)
    for axis, angle in zip(axes, angles, strict=True):
        R = R @ getattr(kempe.spatial, f"rot_{axis}")(angle)
    return R


def test_all_kinds_of_joints_in_mujoco():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(MJCF)
    assert mujoco_agrees(mujoco, cart(), model) == 4
    drone = model.jnt_qposadr[model.njnt - 1]
    at = convert.to_mujoco(cart(), cart().neutral, model)
    np.testing.assert_allclose(at[drone:], model.qpos0[drone:], rtol=0, atol=1e-12)


UNNAMED = """<mujoco><worldbody><body pos="0 0 1"><joint type="slide" axis="1 0 0"/>
<joint axis="1 1 0" ref="10"/><geom size="1"/><body><joint type="ball"/><geom size="1"/></body>
<body><joint axis="0 1 0" ref="30"/><geom size="1"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("text", [MJCF, UNNAMED], ids=["named", "unnamed"])
def test_what_kempe_reads_from_mjcf_has_the_same_numbers(text):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    robot = kempe.load(text)
    assert mujoco_agrees(mujoco, robot, model)
    q = robot.random(5)
    v = np.arange(float(robot.nv))
    for x, same in zip(convert.to_mujoco(robot, q, model, v), (q, v), strict=True):
        np.testing.assert_allclose(x, same, rtol=0, atol=1e-15)


def test_quaternions_are_sent_with_length_one():
    pin = pytest.importorskip("pinocchio")
    q = zoo().random(1)
    long = q.copy()
    ball = zoo().coordinate_names.index("ball.qw")
    long[ball : ball + 4] *= 3.0
    model = pinocchio_zoo(pin)
    np.testing.assert_allclose(
        convert.to_pinocchio(zoo(), long, model), convert.to_pinocchio(zoo(), q, model), atol=1e-15
    )


# ---- followers, locked and fixed joints


@pytest.mark.parametrize("kind", ["continuous", "revolute"])
@pytest.mark.parametrize("mimic", [False, True])
def test_followers_in_pinocchio(kind, mimic):
    """They are joints of their own there, or none."""
    pin = pytest.importorskip("pinocchio")
    robot = kempe.load(gripper(kind))
    model = pin.buildModelFromXML(gripper(kind), mimic=mimic)
    q = np.array([0.4])
    at, rate = convert.to_pinocchio(robot, q, model, [0.7])
    assert len(at) == model.nq and len(rate) == model.nv
    back = convert.from_pinocchio(robot, at, model, rate)
    np.testing.assert_allclose(np.concatenate(back), [0.4, 0.7], rtol=0, atol=1e-15)
    if mimic:
        J = pin.computeJointJacobian(model, model.createData(), at, 1)
        J = Correspondence(robot, model).from_jacobian(at, J)
        np.testing.assert_allclose(J, robot.jacobian(q, "left", "body"), rtol=0, atol=1e-15)
    else:
        np.testing.assert_allclose(rate, [0.7, -1.4], rtol=0, atol=1e-15)
        assert pinocchio_agrees(pin, robot, model) == 3
        wrong = at.copy()
        wrong[-2:] = (0.6, 0.8) if kind == "continuous" else (0.4, 0.5)
        said = r"coordinate 'b' is 0\.\d+; it follows 'a' and must be -0.5"
        with pytest.raises(InputError, match=said):
            convert.from_pinocchio(robot, wrong, model)
        assert convert.from_pinocchio(robot, wrong, model, tolerance=2.0) == pytest.approx(0.4)
        said = "the velocity of 'b' is -1; it follows 'a' and must be -1.4"
        with pytest.raises(InputError, match=said):
            convert.from_pinocchio(robot, at, model, [0.7, -1.0])
        with pytest.raises(InputError, match=r"coordinate 'b' is 0\.\d+ \(row 1\)"):
            convert.from_pinocchio(robot, np.stack([at, wrong]), model)


def test_locked_and_fixed_joints():
    pin = pytest.importorskip("pinocchio")
    text = gripper("revolute")
    model = pin.buildModelFromXML(text)
    robot = kempe.load(text)
    locked = robot.mechanism.lock({"a": 0.25}).build()
    np.testing.assert_allclose(convert.to_pinocchio(locked, [], model), [0.25, -0.2], atol=1e-15)
    assert convert.from_pinocchio(locked, [0.25, -0.2], model).shape == (0,)
    with pytest.raises(InputError, match="coordinate 'a' is 0.3; it is held at 0.25"):
        convert.from_pinocchio(locked, [0.3, -0.2], model)
    with pytest.raises(InputError, match="the velocity of 'a' is 0.1; it is held at 0"):
        convert.from_pinocchio(locked, [0.25, -0.2], model, [0.1, 0.0])
    kind = lambda name: gripper(name).replace('<mimic joint="a" multiplier="-2" offset="0.3"/>', "")  # noqa: E731
    fixed = kempe.load(kind("fixed"))
    for name, at in (("revolute", [0.0, 0.0]), ("continuous", [1.0, 0.0, 1.0, 0.0])):
        model = pin.buildModelFromXML(kind(name))
        assert convert.to_pinocchio(fixed, [], model).tolist() == at
        assert convert.from_pinocchio(fixed, at, model).shape == (0,)
    with pytest.raises(InputError, match=r"coordinate 'b' is 0\.6435\d+; it is held at 0"):
        convert.from_pinocchio(fixed, [1.0, 0.0, 0.8, 0.6], model)


def test_joints_without_a_counterpart_are_named():
    pin = pytest.importorskip("pinocchio")
    text = gripper("revolute")
    model = pin.buildModelFromXML(text)
    reduced = pin.buildReducedModel(model, [1], pin.neutral(model))
    robot = kempe.load(text)
    with pytest.raises(InputError, match="joint 'a' is not in the Pinocchio model .*lock it"):
        convert.to_pinocchio(robot, [0.1], reduced)
    other = kempe.load(text.replace('"a"', '"c"'))
    said = "joint 'c' is not in the Pinocchio model .*joint 'a' of the Pinocchio model is not in"
    with pytest.raises(InputError, match=said):
        convert.to_pinocchio(other, [0.1], model)
    free = kempe.load(text, base="free")
    with pytest.raises(InputError, match="joint 'base' is not in the Pinocchio model"):
        convert.from_pinocchio(free, [0.0, 0.3], model)
    base = free.random(4)
    at = convert.from_pinocchio(free, [0.0, 0.3], model, base=base)
    np.testing.assert_array_equal(at, [*base[:7], 0.0])
    m = Mechanism("balls")
    for name in "ab":
        m.spherical(name, m.ground, m.body(f"body {name}"))
    with pytest.raises(InputError, match="joint 'a' has 4 coordinates, and 1 number in the Pino"):
        convert.to_pinocchio(m.build(), m.build().neutral, model)


def test_a_robot_among_other_bodies():
    """The others stay as they are in `base`, and at rest."""
    mujoco = pytest.importorskip("mujoco")
    ball = '<worldbody><body name="ball"><freejoint/><geom size="1"/></body>'
    model = mujoco.MjModel.from_xml_string(MJCF.replace("<worldbody>", ball))
    robot = cart()
    q = robot.random(3, 2)
    v = np.ones((2, robot.nv))
    with pytest.raises(
        InputError, match="without a name, of body 'ball', of the MuJoCo model is no"
    ):
        convert.to_mujoco(robot, q, model)
    base = np.arange(float(model.nq))
    at, rate = convert.to_mujoco(robot, q, model, v, base=base)
    plain, rates = convert.to_mujoco(robot, q, mujoco.MjModel.from_xml_string(MJCF), v)
    np.testing.assert_array_equal(at, np.concatenate([[base[:7]] * 2, plain], axis=-1))
    np.testing.assert_array_equal(rate, np.concatenate([np.zeros((2, 6)), rates], axis=-1))
    back, again = convert.from_mujoco(robot, at, model, rate, base=robot.neutral)
    there = robot.configuration_space.difference(q, back)
    np.testing.assert_allclose(there, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again, v, rtol=0, atol=1e-12)
    both = Correspondence(robot, model, partial=True)
    J = np.ones((6, robot.nv))
    assert not both.to_jacobian(q[0], J)[:, :6].any()
    with pytest.raises(
        InputError, match="base is None; it must be a configuration of the MuJoCo m"
    ):
        both.to_q(q)
    less = Mechanism("only the lid")
    less.revolute("lid", less.ground, less.body("eye"))
    q = convert.to_mujoco(less.build(), [0.5], model, base=base)
    assert (q != base).sum() == 1 and 0.5 in q
    assert convert.from_mujoco(less.build(), q, model, base=[0.0]) == 0.5
    wrong = Mechanism("wrong")
    wrong.spherical("lid", wrong.ground, wrong.body("eye"))
    with pytest.raises(InputError, match="joint 'lid' has 4 coordinates, and 1 number in the MuJo"):
        convert.to_mujoco(wrong.build(), [1.0, 0, 0, 0], model, base=base)


def test_what_is_no_model_and_no_configuration_is_refused():
    pin = pytest.importorskip("pinocchio")
    mujoco = pytest.importorskip("mujoco")
    model = pin.buildModelFromXML(gripper())
    robot = kempe.load(gripper())
    with pytest.raises(InputError, match="model is Data; it must be a Model of Pinocchio or a MjM"):
        Correspondence(robot, model.createData())
    with pytest.raises(InputError, match="it must be a MjModel of MuJoCo"):
        convert.to_mujoco(robot, [0.1], model)
    with pytest.raises(InputError, match="it must be a Model of Pinocchio"):
        convert.to_pinocchio(robot, [0.1], mujoco.MjModel.from_xml_string("<mujoco/>"))
    with pytest.raises(InputError, match=r"q of the Pinocchio model has shape \(1,\); .* 4\)"):
        convert.from_pinocchio(robot, [0.1], model)
    with pytest.raises(InputError, match="coordinate 'a' has the cosine 0 and the sine 0"):
        convert.from_pinocchio(robot, np.zeros(4), model)
    both = Correspondence(robot, model)
    for J in (np.zeros(1), np.zeros((6, 2))):
        with pytest.raises(InputError, match=r"jacobian has shape .*it must be \(..., m, 1\)"):
            both.to_jacobian([0.1], J)
    assert both.to_v(np.zeros((3, 1)), [0.1]).shape == (3, 2)
    assert both.to_jacobian(np.zeros((3, 1)), np.ones((6, 1))).shape == (3, 6, 2)


def test_free_joints_that_begin_elsewhere_than_in_mujoco():
    mujoco = pytest.importorskip("mujoco")
    text = (
        '<mujoco><worldbody><body name="b"><freejoint/><geom size="1"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    m = Mechanism("two")
    body = m.body("b")
    m.free("base", m.ground, body, child_at=(0.1, 0, 0))
    with pytest.raises(InputError, match="'base' is free and does not end in the frame of 'b'"):
        convert.to_mujoco(m.build(), m.build().neutral, model)
    m = Mechanism("two")
    cart = m.body("cart")
    m.prismatic("rail", m.ground, cart)
    m.free("base", cart, m.body("b"))
    text = text.replace(
        "</worldbody>",
        '<body><joint name="rail" type="slide"/><geom size="1"/></body></worldbody>',
    )
    model = mujoco.MjModel.from_xml_string(text)
    with pytest.raises(InputError, match="'base' is free and begins on 'cart', which moves"):
        convert.to_mujoco(m.build(), m.build().neutral, model)


# ---- messages


def state(**parts: Any) -> Any:
    """As a message JointState: empty unless said."""
    return SimpleNamespace(**({"name": [], "position": [], "velocity": [], "effort": []} | parts))


def test_joint_states():
    robot = kempe.load(gripper("revolute"), base="free")
    q = robot.random(0)
    v = np.arange(1.0, 8.0)
    sent = convert.to_joint_state(robot, q, state(), v)
    assert sent.name == ["a", "b"] and sent.velocity == [7.0, -14.0]
    assert sent.position == pytest.approx([q[7], 0.3 - 2.0 * q[7]])
    assert all(type(x) is float for x in sent.position)
    back, rate = convert.from_joint_state(robot, sent, base=q, velocity=True)
    np.testing.assert_allclose(back, q, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rate, [0.0] * 6 + [7.0])
    np.testing.assert_array_equal(robot.q(sent, base=q), back)
    np.testing.assert_array_equal(convert.from_joint_state(robot, sent)[:7], robot.neutral[:7])
    assert convert.to_joint_state(robot, q, state(name=["b"])).name == ["b"]
    sent.velocity = [7.0, 0.0]
    with pytest.raises(
        InputError, match="the velocity of 'b' is 0; it follows 'a' and must be -14"
    ):
        convert.from_joint_state(robot, sent, velocity=True)
    with pytest.raises(InputError, match="the message has 1 name and 0 velocities"):
        convert.from_joint_state(robot, state(name=["a"], position=[0.0]), velocity=True)
    with pytest.raises(InputError, match="coordinate 'b' is 0.5; it follows 'a'"):
        convert.from_joint_state(robot, state(name=["a", "b"], position=[0.3, 0.5]))
    with pytest.raises(UnknownNameError, match="'c'"):
        convert.to_joint_state(robot, q, state(name=["c"]))
    with pytest.raises(UnknownNameError, match="'c'"):
        convert.from_joint_state(robot, state(name=["c"], position=[0.0]))
