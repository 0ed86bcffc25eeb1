"""A unit of length is a label: numbers go in and come out in it, and only borders convert."""

import math

import numpy as np
import pytest

import kempe
from kempe import library, units
from kempe.description.length_units import convert_unit
from kempe.errors import DescriptionError, InputError
from kempe.model.configurations import list_units


def make_slider_crank(unit="m", size=1.0):
    """Return a slider-crank whose crank has this length."""
    m = kempe.Mechanism("slider-crank", dim=2, unit=unit)
    m.revolute("crank", m.ground, m.body("crank"))
    m.revolute("pin", "crank", m.body("rod"), at=(size, 0))
    m.revolute("wrist", "rod", m.body("piston"), at=(3 * size, 0))
    m.prismatic("stroke", m.ground, "piston", axis="x", limits=(2 * size, 4 * size), velocity=size)
    m.frame("tip", "piston", at=(size / 4, 0))
    return m


def make_all_kinds(unit="m", k=1.0):
    """Return a mechanism with lengths in every kind of part, k of its units a metre."""
    m = kempe.Mechanism("all", unit=unit)
    m.parameter("l", 0.5)
    m.body("a", mass=2.0, center=(0.1 * k, 0, 0.2 * k))
    m.prismatic("s", m.ground, "a", axis="x", at=(0, 0.1 * k, 0), limits=(-k, 2 * k), velocity=k)
    m.helical("h", "a", m.body("b"), pitch=0.02 * k, at=(0.3 * k, 0, 0))
    m.joint("p", "P(x) H(y, 0.25)" if k == 1.0 else f"P(x) H(y, {0.25 * k})", "b", m.body("c"))
    m.free("f", m.ground, m.body("d"), at=(0.2 * k, 0, 0))
    m.revolute("r", "c", m.body("e"), at=(f"l*{k}", 0, 0))
    m.particle("dot")
    m.translation("t", m.ground, "dot")
    m.couple("r", {"s": 2.0 / k}, offset=0.1)
    m.couple("t.y", {"s": 0.5, "h": 0.3 * k}, offset=0.2 * k)
    m.frame("tip", "e", at=(0, 0.4 * k, 0), rpy=(0.1, 0.2, 0.3))
    m.shape("a", "box", size=(0.1 * k, 0.2 * k, 0.3 * k), at=(0.05 * k, 0, 0))
    m.shape("a", "mesh", path="a.stl", scale=0.001 * k)
    m.constrain(kempe.constraints.Distance("d", "a", 0.7 * k), name="rod")
    m.constrain(
        kempe.constraints.OnSurface("d", "x^2 + z = 0.5" if k == 1 else f"(x/{k})^2 + z/{k} = 0.5"),
        name="surface",
    )
    m.equation(
        "law",
        "sin(s)*h - t.x^2" if k == 1 else f"sin(s/{k})*h - (t.x/{k})^2",
        of=("s", "h", "t.x"),
    )
    m.posture("home", {"s": 0.3 * k, "h": 0.2})
    m.lock({"t.z": 0.1 * k})
    return m


def scale_by_unit(system, q):
    """Return configurations in metres as those of a system in another unit."""
    unit = list_units(system)
    k = float(1 / units.METRES[system.unit])
    return q * np.array([k if unit[n] == system.unit else 1.0 for n in system.coordinate_names])


def test_a_unit_that_is_none_is_refused_by_name():
    with pytest.raises(InputError, match=r"'furlong'.*'m' \(metres\).*'in' \(inches\)"):
        kempe.Mechanism("a", unit="furlong")
    for wrong in (None, 1, ["mm"], "MM"):
        with pytest.raises(InputError, match="unit is"):
            kempe.Mechanism("a", unit=wrong)
    with pytest.raises(DescriptionError, match=r":2: unit is 'feet'; it must be a unit"):
        kempe.read('format = 2\nunit = "feet"\n')


def test_numbers_go_in_and_come_out_in_the_unit():
    m = make_slider_crank("mm", 40.0)
    system = m.build()
    assert m.unit == system.unit == system.mechanism.unit == "mm"
    q = system.assemble({"crank": 0.0}, start={"stroke": 150.0}).q
    assert system.q_dict(q)["stroke"] == pytest.approx(160.0)
    assert system.fk(q, "tip")[0, 3] == pytest.approx(170.0)
    assert list_units(system)["stroke"] == "mm"


def test_everything_made_of_a_mechanism_keeps_its_unit():
    m = make_slider_crank("mm", 40.0)
    m.group("half", ["crank", "pin"])
    system = m.build()
    assert m.copy().unit == m.subchain("crank", "tip").unit == "mm"
    for made in (
        system.with_limits({"stroke": (90.0, 150.0)}),
        system.group("half"),
        kempe.convert.maximal(system),
    ):
        assert made.unit == "mm"
    assert m != make_slider_crank("m", 40.0)
    assert (
        system.structure.content_hash != make_slider_crank("m", 40.0).build().structure.content_hash
    )


@pytest.mark.parametrize("unit", ["mm", "cm", "in"])
def test_toml_holds_the_unit(unit, tmp_path):
    m = make_all_kinds(unit, 100.0)
    again = kempe.read(m.save(tmp_path / "all.toml"))
    assert again == m
    assert again.unit == unit
    assert "unit" not in make_slider_crank().save(tmp_path / "m.toml").read_text()


def test_a_converted_mechanism_is_the_same_in_other_numbers():
    metres = make_all_kinds()
    converted = convert_unit(metres, "mm")
    same = make_all_kinds("mm", 1000.0)
    assert converted.bodies == same.bodies
    assert converted.postures == same.postures
    assert converted.locks == same.locks
    for name, joint in same.joints.items():
        assert converted.joints[name].type == joint.type
        assert converted.joints[name].limits == joint.limits
        assert converted.joints[name].velocity_limits == joint.velocity_limits
    for name, coupling in same.couplings.items():
        assert converted.couplings[name].sources == pytest.approx(coupling.sources)
        assert converted.couplings[name].offset == pytest.approx(coupling.offset)
    a, b = metres.build(), converted.build()
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.5, 0.5, (20, a.nq))
    for frame in a.frame_names:
        X, Y = a.fk(q, frame), b.fk(scale_by_unit(b, q), frame)
        np.testing.assert_allclose(1000.0 * X[:, :3, 3], Y[:, :3, 3], atol=1e-9)
        np.testing.assert_allclose(X[:, :3, :3], Y[:, :3, :3], atol=1e-12)
    for name, values in (
        ("law", {"s": 0.3, "h": 0.2, "t.x": 0.1}),
        ("surface", {"x": 0.2, "y": 1.0, "z": 0.3}),
    ):
        k = {n: 1.0 if n == "h" else 1e3 for n in values}
        one, two = (m.constraints[name].of.list_rows(3)[0].args[0] for m in (metres, converted))
        scaled = {n: k[n] * x for n, x in values.items()}
        assert two.evaluate_outputs(scaled) == pytest.approx(one.evaluate_outputs(values))


def test_rows_of_velocities_are_converted():
    m = kempe.Mechanism("skate", dim=2)
    m.planar("p", m.ground, m.body("skate"))
    m.velocity_equation("v", [["-p.y^2", "1", "p.x"]], of=("p.x", "p.y", "p.rz"))
    converted = convert_unit(m, "mm")
    a, b = (x.constraints["v"].of.list_rows(2)[0].args[0] for x in (m, converted))
    q = {"p.x": 0.3, "p.y": 0.2, "p.rz": 0.1, "p.x'": 0.7, "p.y'": 0.5, "p.rz'": 0.4}
    scaled = {n: x if "rz" in n else 1e3 * x for n, x in q.items()}
    assert b.evaluate_outputs(scaled) == pytest.approx(a.evaluate_outputs(q))


def test_what_cannot_be_converted_is_refused_by_name():
    def law(x):
        return x["stroke"] if x["stroke"] > 0 else round(float(x["stroke"]))

    m = make_slider_crank("m", 0.04)
    m.equation("law", law, of=("stroke", "crank"))
    with pytest.raises(
        InputError, match=r"law.*Python function of stroke.*write it as an expression"
    ):
        kempe.Mechanism("host", dim=2, unit="mm").attach(m)
    host = kempe.Mechanism("host", dim=2)
    assert host.attach(m, prefix="a_").constraints["a_law"]


@pytest.mark.parametrize("name", library.list_models())
def test_models_are_the_same_in_millimetres(name):
    m = kempe.read(name)
    a, b = m.build(), convert_unit(m, "mm").build()
    q = np.random.default_rng(1).uniform(-1, 1, (5, a.nq))
    p = a.fk(q)[..., :3, 3]
    np.testing.assert_allclose(b.fk(scale_by_unit(b, q))[..., :3, 3], 1e3 * p, atol=1e-8)
    assert a.mobility().dof == b.mobility().dof


def test_a_guest_is_converted_to_the_unit_of_the_host():
    metres, inches = make_slider_crank("m", 0.04), make_slider_crank("in", 2.0)
    host = kempe.Mechanism("both", dim=2, unit="mm")
    host.attach(metres, prefix="a_").attach(inches, prefix="b_", at=(0, 500))
    assert (metres.unit, inches.unit) == ("m", "in")
    system = host.build()
    X = system.fk(system.q({"a_crank": 0.0, "b_crank": math.pi / 2}), "b_rod")
    assert X[1, 3] == pytest.approx(500 + 50.8)
    assert dict(host.joints["a_stroke"].limits)[""] == (80.0, 160.0)
    assert host.joints["b_stroke"].velocity_limits[""] == pytest.approx(50.8)
    assert host.joints["b_crank"].limits == inches.joints["crank"].limits


@pytest.mark.parametrize("ending", ["urdf", "sdf"])
def test_files_of_others_are_written_in_metres(ending, tmp_path):
    def make(unit, k):
        m = kempe.Mechanism("arm", unit=unit)
        m.revolute("q1", m.ground, m.body("a", mass=1.0, center=(0, 0, 50 / k)), at=(0, 0, 333 / k))
        m.prismatic("s", "a", m.body("b"), axis="x", at=(12.5 / k, 0, 0), limits=(-20 / k, 60 / k))
        m.frame("tip", "b", at=(0, 88 / k, 0))
        m.shape("b", "capsule", radius=40 / k, length=200 / k)
        m.lock({"q1": 0.25})
        return m

    texts = [
        make(unit, k).save(tmp_path / f"{unit}.{ending}").read_text()
        for unit, k in (("m", 1000.0), ("mm", 1.0))
    ]
    assert texts[0] == texts[1]
    assert kempe.read(tmp_path / f"mm.{ending}").unit == "m"


def test_pinocchio_reads_the_file_of_an_arm_in_millimetres(tmp_path):
    pin = pytest.importorskip("pinocchio")
    arm = kempe.from_dh(
        [{"d": 400, "alpha": math.pi / 2}, {"a": 350}, {"type": "prismatic", "limits": (0, 300)}],
        unit="mm",
    )
    path = arm.save(tmp_path / "arm.urdf")
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    system = arm.build()
    rng = np.random.default_rng(2)
    for q in rng.uniform(0, 1, (10, 3)) * (3.0, 3.0, 300.0):
        there = kempe.convert.to_pinocchio(system, q, model)
        pin.framesForwardKinematics(model, data, there)
        X = data.oMf[model.getFrameId("tool")].homogeneous
        np.testing.assert_allclose(1e3 * X[:3, 3], system.fk(q, "tool")[:3, 3], atol=1e-8)
        np.testing.assert_allclose(kempe.convert.from_pinocchio(system, there, model), q)


def test_conversions_for_libraries_are_in_metres():
    pin = pytest.importorskip("pinocchio")
    m = make_slider_crank("mm", 40.0)
    m.joints.pop("wrist")
    m.couple("pin", {"stroke": 0.01})
    system, metres = m.build(), convert_unit(m, "m").build()
    model = pin.Model()
    for name, kind in (
        ("crank", pin.JointModelRZ()),
        ("pin", pin.JointModelRZ()),
        ("stroke", pin.JointModelPX()),
    ):
        model.addJoint(0, kind, pin.SE3.Identity(), name)
    both, plain = (kempe.convert.Correspondence(s, model) for s in (system, metres))
    q = np.array([0.3, 120.0])
    v = np.array([0.1, -7.0])
    there = both.to_q(q)
    np.testing.assert_allclose(there, plain.to_q([0.3, 0.12]))
    np.testing.assert_allclose(both.from_q(there), q)
    np.testing.assert_allclose(both.to_v(q, v), plain.to_v([0.3, 0.12], [0.1, -0.007]))
    np.testing.assert_allclose(both.from_v(there, both.to_v(q, v)), v)
    J = np.array([[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(both.to_jacobian(q, J) @ both.to_v(q, v), J @ v)
    K = np.arange(6.0).reshape(2, 3)
    np.testing.assert_allclose(both.from_jacobian(there, K) @ v, K @ both.to_v(q, v))


def test_messages_of_ros_are_in_metres():
    from types import SimpleNamespace

    system = make_slider_crank("mm", 40.0).build()
    message = SimpleNamespace(name=["stroke", "crank"], position=[], velocity=[])
    q = system.q({"stroke": 120.0, "crank": 0.5})
    v = np.arange(1.0, 5.0)
    kempe.convert.to_joint_state(system, q, message, v)
    assert message.position == pytest.approx([0.12, 0.5])
    assert message.velocity == pytest.approx([0.004, 1.0])
    back, rates = kempe.convert.from_joint_state(system, message, velocity=True)
    np.testing.assert_allclose(back, q)
    np.testing.assert_allclose(rates, [1.0, 0.0, 0.0, 4.0])


# ---- scale: a mechanism of 300 mm behaves as one of 0.3 m


def make_pair(name):
    """Return a model in metres, and in millimetres."""
    m = kempe.read(name)
    return m.build(), convert_unit(m, "mm").build()


def in_millimetres(X):
    """Return poses with their places in millimetres."""
    out = np.array(X)
    out[..., :3, 3] *= 1e3
    return out


@pytest.mark.parametrize(
    ("name", "frame"), [("panda", "panda_hand_tcp"), ("ur5", "tool0"), ("stanford", "tool")]
)
def test_ik_finds_the_same_in_millimetres(name, frame):
    a, b = make_pair(name)
    frame = frame if frame in a.frame_names else a.frame_names[-1]
    q = np.random.default_rng(3).uniform(-1, 1, (50, a.nq)) * 0.5 + a.mid
    X = a.fk(q, frame)
    one, two = a.ik(X, frame), b.ik(in_millimetres(X), frame)
    np.testing.assert_array_equal(one.success, two.success)
    np.testing.assert_array_equal(one.starts, two.starts)
    good = one.success
    np.testing.assert_allclose(scale_by_unit(b, one.q)[good], two.q[good], atol=1e-5)
    off = X.copy()
    off[:, 0, 3] += 2e-6  # beyond the usual tolerance of one, but not of two of them
    near = a.ik(off[0], frame, start=one.q[0])
    far = b.ik(in_millimetres(off[0]), frame, start=two.q[0])
    assert near.success == far.success
    assert near.iterations == far.iterations


@pytest.mark.parametrize("name", ["puma560", "ur5", "stanford"])
def test_ik_all_finds_the_same_in_millimetres(name):
    a, b = make_pair(name)
    frame = a.frame_names[-1]
    for q in np.random.default_rng(4).uniform(-1, 1, (5, a.nq)) * 0.5 + a.mid:
        X = a.fk(q, frame)
        one, two = a.ik_all(X, frame), b.ik_all(in_millimetres(X), frame)
        assert len(one.q) == len(two.q)
        np.testing.assert_allclose(scale_by_unit(b, one.q), two.q, atol=1e-6)


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "delta_ss", "jansen", "stewart_sps"])
def test_loops_close_the_same_in_millimetres(name):
    a, b = make_pair(name)
    one, two = a.assemble(), b.assemble()
    assert bool(one.success) == bool(two.success)
    np.testing.assert_allclose(scale_by_unit(b, one.q), two.q, atol=1e-7)
    assert (
        one.status == two.status
        or one.status.split("residual")[0] == two.status.split("residual")[0]
    )


def test_steps_have_the_same_default_speed_in_millimetres():
    a, b = make_slider_crank("m", 0.04).build(), make_slider_crank("mm", 40.0).build()
    from kempe.inverse.ik_step import list_speed_limits

    np.testing.assert_allclose(list_speed_limits(b)[:3], list_speed_limits(a)[:3])
    assert list_speed_limits(b)[3] == 40.0
    m = kempe.Mechanism("slide", unit="mm")
    m.prismatic("x", m.ground, m.body("a"), axis="x")
    step = m.build().ik_step([0.0], [5000.0, 0, 0, 0, 0, 0], "a", dt=0.1)
    assert step.velocity[0] == pytest.approx(1000.0)
    assert "1e+03 mm/s" in str(step) or "1000 mm/s" in str(step)
