"""The builder: what it accepts, what it refuses and in which words, and how mechanisms are put
together.
"""

from __future__ import annotations

import copy
import inspect
import json
import pickle

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kempe import Mechanism, System, joints
from kempe.description.keywords import JointKeywords
from kempe.description.toml_reader import read_toml
from kempe.errors import DescriptionError, Fault, InputError, KempeError, UnknownNameError, Where
from kempe.poses import Placement, place


def arm(name: str = "arm", links: int = 2, length: float = 1.0) -> Mechanism:
    """A planar-looking arm in space: hinges about z, one link length apart, frame 'tip' at the end."""
    m = Mechanism(name, ground="base")
    here = m.ground
    for i in range(links):
        link = m.body(f"link{i + 1}")
        m.revolute(f"q{i + 1}", here, link, at=(length if i else 0, 0, 0), limits=(-2.0, 2.5))
        here = link
    m.frame("tip", here, at=(length, 0, 0))
    return m


def gripper() -> Mechanism:
    """Two fingers, the second follows the first."""
    m = Mechanism("gripper", ground="palm")
    for name, side in (("left", 1), ("right", -1)):
        m.prismatic(f"{name}_finger", m.ground, m.body(name), axis=(0, side, 0), limits=(0, 0.04))
    m.gear("right_finger", "left_finger", 1.0)
    m.frame("grasp", "palm", at=(0, 0, 0.1))
    m.posture("open", {"left_finger": 0.04})
    return m


# ------------------------------------------------------------------ the readme's use


def test_the_lectures_arm_in_a_few_lines():
    m = Mechanism("two-link", dim=2)
    l1 = m.parameter("l1", 1.0)
    _ = m.parameter("l2", 0.7)
    upper = m.body("upper")
    lower = m.body("lower")
    m.revolute("q1", m.ground, upper)
    m.revolute("q2", upper, lower, at=(l1, 0))
    m.frame("tip", lower, at=("l2", 0))
    T = m.build().fk({"q1": 0.3, "q2": 0.4}, "tip")
    np.testing.assert_allclose(
        T[:2, 3], [np.cos(0.3) + 0.7 * np.cos(0.7), np.sin(0.3) + 0.7 * np.sin(0.7)], atol=1e-15
    )


def test_calls_return_their_records():
    m = Mechanism()
    b = m.body("b", mass=2, center=(0, 1))
    p = m.particle("p", mass=1)
    assert (b.mass, b.center, b.particle, p.particle, str(b)) == (
        2.0,
        (0.0, 1.0, 0.0),
        False,
        True,
        "b",
    )
    j = m.revolute("j", m.ground, b, velocity=2, effort=np.float32(3), limits=np.array([-1, 1]))
    assert (j.limits, j.velocity_limits, j.effort_limits) == (
        {"": (-1.0, 1.0)},
        {"": 2.0},
        {"": 3.0},
    )
    f = m.frame("f", b, at=(1, 0, 0))
    assert (f.body, str(f), str(j)) == ("b", "f", "j")
    assert m.lock({j: 0.5}) is m and m.locks == {"j": 0.5}


def test_records_and_names_are_interchangeable():
    m = Mechanism()
    b = m.body("b")
    c = m.body("c")
    m.revolute("j", m.ground, "b")
    k = m.revolute("k", b, "c", at=(1, 0, 0))
    m.couple(k, {"j": 2.0})
    f = m.frame("f", "c", at=(0.5, 0, 0))
    s = m.build()
    np.testing.assert_array_equal(s.fk([0.3], f), s.fk([0.3], "f"))
    np.testing.assert_array_equal(s.fk([0.3], [b, c, f]), s.fk([0.3], ["b", "c", "f"]))


def test_a_joint_can_sit_on_named_frames():
    m = arm()
    tool = m.body("tool")
    m.frame("grip", tool, at=(0, 0, 0.2), rpy=(0.1, 0.2, 0.3))
    m.revolute("wrist", "link2", tool, at="tip", child_at=m.frames["grip"], rpy=(0.5, 0, 0))
    s = m.build()
    q = np.array([0.1, 0.2, 0.7])
    X = s.fk(q, "tip") @ reference.turn("x", 0.5) @ reference.turn("z", 0.7)
    np.testing.assert_allclose(s.fk(q, "grip"), X.astype(float), rtol=0, atol=1e-15)
    with pytest.raises(
        DescriptionError, match="joint 'again': body 'link1' has no frame 'tip'; there are none"
    ):
        m.revolute("again", "link1", tool, at="tip")
    with pytest.raises(DescriptionError, match="frame 'other': body 'link1' has no frame 'tip'"):
        m.frame("other", "link1", at="tip")
    on_tip = m.frame("on tip", "link2", at="tip", rpy=(0, 0, 0.5))
    np.testing.assert_allclose(
        m.build().fk(q, on_tip), s.fk(q, "tip") @ place(angle=0.5).evaluate_pose({}), atol=1e-15
    )


def test_placements_and_axes_on_both_sides():
    m = Mechanism()
    b = m.body("b")
    m.revolute(
        "j",
        m.ground,
        b,
        at=Placement((("z", (1.0,)),)),
        axis=(0, 1, 0),
        child_at=(0.5, 0, 0),
        child_axis=(1, 0, 0),
    )
    X = m.build().fk([0.3], "b")
    align = {"y": reference.turn("x", -np.pi / 2), "x": reference.turn("y", np.pi / 2)}
    expected = (
        reference.slide("z", 1)
        @ align["y"]
        @ reference.turn("z", 0.3)
        @ reference.inverse(reference.slide("x", 0.5) @ align["x"])
    )
    np.testing.assert_allclose(X, expected.astype(float), rtol=0, atol=1e-15)


# ------------------------------------------------------------------ wrong calls: what, why, what is
# allowed


def planar() -> Mechanism:
    m = Mechanism("flat", dim=2)
    m.body("b"), m.particle("p")
    return m


def space() -> Mechanism:
    m = arm()
    m.body("free body"), m.particle("p")
    m.parameter("l1", 1.0)
    return m


WRONG = [
    (lambda m: Mechanism(dim=4), InputError, "dim is 4; a system lives in the plane"),
    (lambda m: Mechanism(ground=""), InputError, "body name is ''; it must be text, not empty"),
    (
        lambda m: m.body("link1"),
        DescriptionError,
        "body 'link1': there is another body of this name",
    ),
    (lambda m: m.body("tip"), DescriptionError, "body 'tip': there is another frame of this name"),
    (lambda m: m.body("base"), DescriptionError, "body 'base': there is another body of this name"),
    (lambda m: m.body(3), InputError, "body name is 3"),
    (
        lambda m: m.body("x", mass=-1),
        DescriptionError,
        "body 'x': mass is -1; it must not be negative",
    ),
    (
        lambda m: m.body("x", mass="heavy"),
        InputError,
        "body 'x': mass is 'heavy'; it must be a number",
    ),
    (lambda m: m.body("x", mass=np.nan), InputError, "body 'x': mass is nan"),
    (
        lambda m: m.body("x", center=(1,)),
        DescriptionError,
        "body 'x': center has 1 number; it must have 2 or 3",
    ),
    (
        lambda m: m.body("x", center=5),
        DescriptionError,
        "body 'x': center is 5; it must have 2 or 3 numbers",
    ),
    (lambda m: m.body("x", center=(1, 2, np.inf)), InputError, "body 'x': center is inf"),
    (
        lambda m: m.frame("tip", "link1"),
        DescriptionError,
        "frame 'tip': there is another frame of this name",
    ),
    (
        lambda m: m.frame("f", "link9"),
        DescriptionError,
        "frame 'f': arm has no body 'link9'; did you mean 'link",
    ),
    (lambda m: m.frame("f", 7), DescriptionError, "frame 'f': arm has no body 7"),
    (lambda m: m.frame("f", ["link1"]), DescriptionError, "frame 'f': arm has no body"),
    (
        lambda m: m.frame("f", "link1", at=(1, 2, 3, 4)),
        DescriptionError,
        "frame 'f': at has 4 numbers; it must have 2 or 3",
    ),
    (
        lambda m: m.frame("f", "link1", at=("l9", 0, 0)),
        DescriptionError,
        "frame 'f': arm has no parameter 'l9'",
    ),
    (lambda m: m.frame("f", "link1", matrix="x"), DescriptionError, "frame 'f': matrix is 'x'"),
    (
        lambda m: m.frame("f", "p", at=(1, 0, 0)),
        DescriptionError,
        "frame 'f': a particle .'p'. has no extent",
    ),
    (
        lambda m: m.frame("f", "p", rpy=(1, 0, 0)),
        DescriptionError,
        "frame 'f': a particle .'p'. has no orientation",
    ),
    (lambda m: m.parameter("l1", 2.0), InputError, "parameter 'l1' exists already"),
    (lambda m: m.parameter("2l", 2.0), InputError, "parameter name '2l' must be an identifier"),
    (lambda m: m.parameter("sin", 2.0), InputError, "'sin'"),
    (lambda m: m.parameter("pi", 2.0), InputError, "parameter name 'pi' must be"),
    (lambda m: m.parameter("lambda", 2.0), InputError, "'lambda'"),
    (lambda m: m.parameter("k", "l1"), InputError, "parameter 'k' is 'l1'; it must be a number"),
    (lambda m: m.parameter("k", np.inf), InputError, "parameter 'k' is inf"),
    (
        lambda m: m.revolute("q1", "base", "p"),
        DescriptionError,
        "joint 'q1': there is another joint of this name",
    ),
    (lambda m: m.revolute("", "base", "p"), InputError, "joint name is ''"),
    (
        lambda m: m.joint("j", "hinge", "base", "free body"),
        DescriptionError,
        "joint 'j': no joint type 'hinge'; there are",
    ),
    (
        lambda m: m.revolute("j", "bass", "link1"),
        DescriptionError,
        "joint 'j': arm has no body 'bass'; did you mean 'base'",
    ),
    (
        lambda m: m.revolute("j", "link1", "link1"),
        DescriptionError,
        "joint 'j': it connects body 'link1' to itself",
    ),
    (
        lambda m: m.revolute("j", "p", "link1"),
        DescriptionError,
        "joint 'j': its parent 'p' is a particle.*make the particle the",
    ),
    (
        lambda m: m.revolute("j", "base", "p"),
        DescriptionError,
        "joint 'j': a revolute joint turns, but 'p' is a particle",
    ),
    (
        lambda m: m.free("j", "base", "p", child_at=(1, 0, 0)),
        DescriptionError,
        "joint 'j': a particle .'p'. has no extent",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", axis=(0, 0, 0)),
        DescriptionError,
        "joint 'j': axis is 0.0 0.0 0.0",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", rpy=(1, 2)),
        DescriptionError,
        "joint 'j': rpy has 2 numbers",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", color="red"),
        DescriptionError,
        "joint 'j':.*no keyword 'color'; they take at, child_at",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", limits=3),
        DescriptionError,
        "joint 'j': limits are 3; they must be a pair",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", limits="12"),
        DescriptionError,
        "joint 'j': limits are '12'; they must be a pa",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", limits=("0", "1")),
        DescriptionError,
        "joint 'j': limits are",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", limits=(1, 0)),
        DescriptionError,
        "joint 'j': lower limit 1 is above upper limit",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", limits=(0, np.nan)),
        DescriptionError,
        "joint 'j': limits are .0.0, nan.; they",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", limits=(np.inf, np.inf)),
        DescriptionError,
        "joint 'j': limits are",
    ),
    (
        lambda m: m.fixed("j", "base", "link2", limits=(0, 1)),
        DescriptionError,
        "joint 'j'.*by coordinate: it has none",
    ),
    (
        lambda m: m.universal("j", "base", "link2", limits=(0, 1)),
        DescriptionError,
        "joint 'j'.*by coordinate: rx, ry",
    ),
    (
        lambda m: m.universal("j", "base", "link2", limits={"rz": (0, 1)}),
        DescriptionError,
        "joint 'j'.*no coordinate 'rz'",
    ),
    (
        lambda m: m.spherical("j", "base", "link2", limits={"wx": (0, 1)}),
        DescriptionError,
        "joint 'j'.*no coordinate 'wx'",
    ),
    (
        lambda m: m.spherical("j", "base", "link2", limits={"qw": (0, 1)}),
        DescriptionError,
        "joint 'j'.*no coordinate 'qw'",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", velocity=-1),
        DescriptionError,
        "joint 'j': velocity limit is -1; it must be",
    ),
    (
        lambda m: m.revolute("j", "base", "link2", effort="9"),
        DescriptionError,
        "joint 'j': effort limit is '9'",
    ),
    (lambda m: m.couple("q2", {}), DescriptionError, "coupling of 'q2': it has no source"),
    (
        lambda m: m.couple("q2", "q1"),
        DescriptionError,
        "coupling of 'q2': its sources are 'q1'; they must be a dict",
    ),
    (
        lambda m: m.couple("q2", {"q1": np.nan}),
        DescriptionError,
        "coupling of 'q2': multiplier is nan; it must be finite",
    ),
    (
        lambda m: m.gear("q2", "q1", "2,5"),
        DescriptionError,
        "coupling of 'q2': '2,5' is not an expression",
    ),
    (
        lambda m: m.posture("home", [0, 0]),
        InputError,
        "posture 'home' is .0, 0.; it must be a dict",
    ),
    (
        lambda m: m.posture("home", {"q1": "up"}),
        InputError,
        "posture 'home': 'q1' is 'up'; it must be a number",
    ),
    (lambda m: m.lock([1]), InputError, "lock is .1.; it must be a dict"),
    (lambda m: m.lock({"q1": np.nan}), InputError, "lock: 'q1' is nan"),
    (lambda m: m.attach("panda.urdf"), InputError, "'panda.urdf' is no Mechanism or System"),
    (
        lambda m: m.attach(Mechanism(dim=2)),
        InputError,
        "has dim 2, 'arm' has dim 3; they must be equal",
    ),
    (
        lambda m: m.attach(gripper(), to="tipp"),
        UnknownNameError,
        "arm has no body or frame 'tipp'; did you mean 'tip'",
    ),
    (
        lambda m: m.attach(gripper(), to="tip", at=(1, 0, 0)),
        InputError,
        "`at` cannot be given when mounting on a frame",
    ),
    (
        lambda m: m.attach(gripper(), to="p"),
        DescriptionError,
        "joint 'palm_mount': its parent 'p' is a particle",
    ),
    (lambda m: m.attach(arm()), DescriptionError, "both have bodies and frames 'base', 'link1'"),
    (
        lambda m: m.subchain("bass", "tip"),
        UnknownNameError,
        "arm has no body 'bass'; did you mean 'base'",
    ),
    (
        lambda m: m.subchain("base", "top"),
        UnknownNameError,
        "arm has no body or frame 'top'; did you mean 'tip'",
    ),
    (
        lambda m: m.subchain("base", "free body"),
        DescriptionError,
        "no joints lead from 'base' to 'free body'",
    ),
]


@pytest.mark.parametrize(("call", "kind", "words"), WRONG, ids=[w for _, _, w in WRONG])
def test_wrong_calls_say_what_is_wrong_and_change_nothing(call, kind, words):
    m = space()
    before = m.copy()
    with pytest.raises(kind, match=words):
        call(m)
    assert m == before and m.content() == before.content()


FLAT = [
    (
        lambda m: m.frame("f", "b", at=(1, 2, 3)),
        "frame 'f': z leaves the plane; planar systems take x, y and turns about z",
    ),
    (lambda m: m.frame("f", "b", rpy=(0.1, 0, 0)), "frame 'f': a turn about x leaves the plane"),
    (lambda m: m.frame("f", "b", axis=(1, 0)), "frame 'f': the axis leaves the plane"),
    (
        lambda m: m.frame("f", "b", quat_wxyz=(1, 0, 0, 0)),
        "frame 'f': the quaternion leaves the plane",
    ),
    (lambda m: m.revolute("j", "ground", "b", axis=(1, 0)), "joint 'j': the axis leaves the plane"),
    (lambda m: m.revolute("j", "ground", "b", at=(0, 0, 1)), "joint 'j': z leaves the plane"),
    (
        lambda m: m.revolute("j", "ground", "b", child_rpy=(0, 1, 0)),
        "joint 'j': a turn about y leaves the plane",
    ),
    (
        lambda m: m.prismatic("j", "ground", "b"),
        "joint 'j': a prismatic joint slides along z, out of the plane; give its axis",
    ),
    (
        lambda m: m.prismatic("j", "ground", "p"),
        "joint 'j': a prismatic joint slides along z, out of the plane",
    ),
    (
        lambda m: m.prismatic("j", "ground", "b", axis=(0, 0, 1)),
        "joint 'j': a prismatic joint slides along z",
    ),
    (lambda m: m.prismatic("j", "ground", "b", axis=(1, 0, 1)), "joint 'j': its axis has z = 0.7"),
    (
        lambda m: m.prismatic("j", "ground", "b", axis=(1, 0), child_axis=(0, 1)),
        "joint 'j': its axis differs on the two bodies",
    ),
    (lambda m: m.planar("j", "ground", "b", axis=(0, 1)), "joint 'j': the axis leaves the plane"),
    (lambda m: m.fixed("j", "ground", "b", axis=(0, 1)), "joint 'j': the axis leaves the plane"),
    (
        lambda m: m.cylindrical("j", "ground", "b"),
        "joint 'j': a cylindrical joint does not exist in the plane; planar systems",
    ),
]


@pytest.mark.parametrize(("call", "words"), FLAT, ids=[w for _, w in FLAT])
def test_planar_systems_refuse_what_leaves_the_plane(call, words):
    m = planar()
    before = m.copy()
    with pytest.raises(DescriptionError, match=words):
        call(m)
    assert m == before


def test_sliders_of_the_plane_slide_where_they_point():
    m = planar()
    m.prismatic(
        "j",
        m.ground,
        "b",
        at=(1, 0),
        angle=0.5,
        axis=(0, 2),
        child_at=(0, 1),
        child_angle=0.2,
        child_axis=(0, 3),
    )
    m.prismatic("k", "b", "p", axis=(1, 0))
    s = m.build()
    q = np.array([0.4, 0.3])
    expected = (
        reference.placement((1, 0), (0, 0, 0.5))
        @ reference.slide("y", 0.4)
        @ reference.inverse(reference.placement((0, 1), (0, 0, 0.2)))
    )
    np.testing.assert_allclose(s.fk(q, "b"), expected.astype(float), rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        s.fk(q, "p")[:3, 3], (expected @ [0.3, 0, 0, 1])[:3].astype(float), rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(s.fk(q, "p")[:3, :3], np.eye(3))


def test_problems_know_where_they_are():
    m = Mechanism()
    m.body("b", where=Where("robot.urdf", 3))
    with pytest.raises(DescriptionError) as error:
        m.body("b", where=Where("robot.urdf", 7, 5, "  <link name='b'/>"))
    (problem,) = error.value.problems
    assert (
        str(problem)
        == "robot.urdf:7: body 'b': there is another body of this name (robot.urdf:3); names must be unique"
    )
    assert problem.caret() == "      <link name='b'/>\n        ^"
    again = pickle.loads(pickle.dumps(error.value))
    assert (
        isinstance(again, DescriptionError)
        and str(again) == str(error.value)
        and again.problems == (problem,)
    )


def test_errors_are_also_the_builtin_ones():
    many = DescriptionError([Fault(f"problem {i}") for i in range(25)])
    assert isinstance(many, ValueError) and isinstance(many, KempeError)
    assert str(many).count("\n") == 20 and str(many).endswith("... and 5 more")
    unknown = UnknownNameError("joint", "elbo", ["elbow", "wrist"], "arm")
    assert (
        isinstance(unknown, KeyError)
        and str(unknown) == "arm has no joint 'elbo'; did you mean 'elbow'?"
    )
    assert pickle.loads(pickle.dumps(unknown)).allowed == ("elbow", "wrist")


# ------------------------------------------------------------------ couplings


def three(*, limits=(None, None, None)) -> Mechanism:
    m = Mechanism("three")
    here = m.ground
    for name, bound in zip("abc", limits, strict=True):
        body = m.body(f"body_{name}")
        m.revolute(name, here, body, at=(1, 0, 0), limits=bound)
        here = body
    return m


def angle_of(X) -> float:
    return float(np.arctan2(X[1, 0], X[0, 0]))


def test_gears_and_offsets():
    m = three()
    m.gear("b", "a", -2.0, offset=0.3)
    s = m.build()
    assert s.coordinate_names == ("a", "c") and s.nq == 2
    assert angle_of(s.fk([0.2, 0.0], "body_b")) == pytest.approx(0.2 - 0.4 + 0.3, abs=1e-15)
    np.testing.assert_allclose(s.jacobian([0.2, 0.0], "body_b")[5], [1 - 2.0, 0.0], atol=1e-15)
    assert (
        s.structure.couplings["b"].source == "a" and s.structure.couplings["b"].multiplier == -2.0
    )
    assert s.q({"b": 0.3 - 2.0 * 0.2}).tolist() == pytest.approx([0.2, 0.0])
    assert s.q({"b": 0.3 - 2.0 * 0.2, "a": 0.2}).tolist() == [0.2, 0.0]
    rows = s.q({"b": 0.3 - 2.0 * np.arange(3.0), "a": np.arange(3.0)})
    np.testing.assert_array_equal(rows[:, 0], np.arange(3.0))
    said = "coordinate 'b' is 1; it follows 'a' and must be -0.1"
    with pytest.raises(InputError, match=said):
        s.q({"b": 1.0, "a": 0.2})
    with pytest.raises(InputError, match=r"coordinate 'b' is 1 \(row 1\); it follows 'a'"):
        s.fk({"b": [0.3, 1.0], "a": [0.0, 0.0]}, "body_b")
    with pytest.raises(InputError, match="leading shapes do not fit together: .*'b', .*'a'"):
        s.q({"b": [0.3, 0.3], "a": [0.0, 0.0, 0.0]})
    with pytest.raises(UnknownNameError, match="'d'"):
        s.q({"b": 1.0, "d": 0.2})


@pytest.mark.parametrize("order", [("b", "c"), ("c", "b")])
def test_mimics_of_mimics(order):
    m = three()
    for name in order:
        m.gear(
            name,
            {"b": "a", "c": "b"}[name],
            {"b": 2.0, "c": -3.0}[name],
            offset={"b": 0.1, "c": 0.2}[name],
        )
    s = m.build()
    b = 2 * 0.4 + 0.1
    assert s.coordinate_names == ("a",)
    assert angle_of(s.fk([0.4], "body_c")) == pytest.approx(0.4 + b + (-3 * b + 0.2), abs=1e-15)


@given(seed=st.integers(0, 10**6))
def test_chains_of_couplings_in_any_order(seed):
    """Values of all coordinates agree with plain substitution, whatever the order of the calls."""
    rng = np.random.default_rng(seed)
    n = 8
    m = Mechanism("chain")
    here = m.ground
    for i in range(n):
        body = m.body(f"b{i}")
        m.prismatic(f"j{i}", here, body)
        here = body
    parents = {i: int(rng.integers(0, i)) for i in range(1, n) if rng.random() < 0.6}
    couplings = {
        f"j{i}": ({f"j{p}": float(rng.normal())}, float(rng.normal())) for i, p in parents.items()
    }
    for name in rng.permutation(list(couplings)):
        m.couple(str(name), *couplings[name])
    locks = {
        f"j{i}": float(rng.normal()) for i in range(n) if i not in parents and rng.random() < 0.3
    }
    m.lock(locks)
    s = m.build()
    free = {
        f"j{i}": float(rng.normal()) for i in range(n) if i not in parents and f"j{i}" not in locks
    }
    assert set(s.coordinate_names) == set(free)
    values = reference.coordinate_values(free, couplings, locks)
    heights = np.cumsum([values[f"j{i}"] for i in range(n)])
    np.testing.assert_allclose(s.fk(s.q(free))[1:, 2, 3], heights, rtol=1e-12, atol=1e-12)


def test_several_sources_are_a_relation():
    m = three()
    m.couple("c", {"a": 0.5, "b": "0.25 + 0.25"}, offset=0.1)
    s = m.build()
    (relation,) = s.structure.relations
    assert s.nq == 3 and (relation.of, relation.sources, relation.offset) == (
        "c",
        {"a": 0.5, "b": 0.5},
        0.1,
    )


def test_relations_are_reduced_by_locks_and_mimics():
    m = three()
    m.couple("c", {"a": 0.5, "b": 2.0}, offset=0.1)
    m.lock({"b": 0.4})
    s = m.build()
    assert s.structure.relations == () and s.coordinate_names == ("a",)
    assert angle_of(s.fk([0.2], "body_c")) == pytest.approx(
        0.2 + 0.4 + (0.1 + 0.8 + 0.1), abs=1e-15
    )
    m = three()
    m.gear("b", "a", 2.0)
    m.couple("c", {"a": 1.0, "b": 3.0})
    assert m.build().structure.couplings["c"].multiplier == 7.0
    m = three()
    m.gear("b", "a", 2.0)
    m.couple("c", {"a": 1.0, "b": -0.5}, offset=0.25)  # they cancel
    assert (
        m.build().structure.couplings["c"].source is None
        and m.build().structure.couplings["c"].offset == 0.25
    )


def test_parameters_drive_couplings():
    m = three()
    ratio = m.parameter("ratio", 2.0)
    m.gear("b", "a", ratio, offset="ratio/10")
    s = m.build()
    assert angle_of(s.fk([0.1, 0], "body_b")) == pytest.approx(0.1 + 0.2 + 0.2, abs=1e-15)
    assert angle_of(s.with_parameters(ratio=3).fk([0.1, 0], "body_b")) == pytest.approx(
        0.1 + 0.3 + 0.3, abs=1e-15
    )
    with pytest.raises(KempeError, match="coupling of 'b' depends on ratio"):
        s.with_parameters(ratio=[1.0, 2.0])


@pytest.mark.parametrize(
    ("edges", "cycle"),
    [
        ([("a", "a")], "a -> a"),
        ([("a", "b"), ("b", "a")], "a -> b -> a"),
        ([("b", "c"), ("c", "a"), ("a", "b")], "b -> c -> a -> b"),
    ],
)
def test_cycles_are_printed(edges, cycle):
    m = three()
    for of, source in edges:
        m.gear(of, source, 1.0)
    with pytest.raises(DescriptionError, match=f"it follows itself: {cycle}"):
        m.build()


def test_couplings_that_do_not_fit():
    def refused(words, *calls):
        m = three()
        ball = m.body("ball")
        m.spherical("s", "body_c", ball)
        for call in calls:
            call(m)
        with pytest.raises(DescriptionError, match=words):
            m.build()

    refused("coupling of 'b': three has no coordinate 'd'", lambda m: m.gear("b", "d", 1))
    refused("coupling of 'bb': three has no coordinate 'bb'", lambda m: m.gear("bb", "a", 1))
    refused(
        "coupling of 'b': 's.qx' is part of a quaternion; only angles",
        lambda m: m.gear("b", "s.qx", 1),
    )
    refused("coupling of 's.qw': 's.qw' is part of a quaternion", lambda m: m.gear("s.qw", "a", 1))
    refused("coupling of 'b': no parameter 'k'", lambda m: m.gear("b", "a", "k"))
    refused(
        "coupling of 'b': its multiplier or offset is not a number",
        lambda m: m.gear("b", "a", "1/0"),
    )
    refused(
        "coordinate 'b': it is locked, but follows a; lock what it follows",
        lambda m: m.gear("b", "a", 1),
        lambda m: m.lock({"b": 0}),
    )
    refused("lock of 'x': three has no coordinate 'x'", lambda m: m.lock({"x": 0}))
    refused(
        "lock of 's.qw': a quaternion is locked as a whole; missing are s.qx, s.qy, s.qz",
        lambda m: m.lock({"s.qw": 1}),
    )
    refused(
        "lock of 's.qw': the quaternion is zero", lambda m: m.lock({f"s.q{c}": 0 for c in "wxyz"})
    )
    with pytest.raises(
        DescriptionError, match="coupling of 'b': the coordinate follows others already"
    ):
        m = three()
        m.gear("b", "a", 1)
        m.gear("b", "c", 1)


def test_limits_pass_through_mimics():
    m = three(limits=((-3, 3), (-1, 4), None))
    m.gear("b", "a", -2.0, offset=1.0)  # -1 <= -2 a + 1 <= 4  means  -1.5 <= a <= 1
    s = m.build()
    np.testing.assert_allclose(s.structure.limits[0], [-1.5, 1.0])
    q = s.random(0, 500)
    assert q[:, 0].min() >= -1.5 and q[:, 0].max() <= 1.0
    m = three(limits=((-3, 3), None, (-1, np.inf)))
    m.gear("b", "a", 0.5)
    m.gear("c", "b", 4.0)
    np.testing.assert_allclose(m.build().structure.limits[0], [-0.5, 3.0])


def test_speeds_pass_through_mimics():
    m = Mechanism()
    a = m.body("A")
    b = m.body("B")
    m.revolute("a", m.ground, a, velocity=10)
    m.revolute("b", a, b, velocity=3)
    m.gear("b", "a", -2.0)
    np.testing.assert_allclose(m.build().structure.velocity_limits, [1.5])


def test_limits_that_leave_nothing():
    m = three(limits=((-1, 1), (5, 6), None))
    m.gear("b", "a", 1.0)
    with pytest.raises(
        DescriptionError, match="joint 'b': its limits leave nothing to 'a', which drives it"
    ):
        m.build()
    m = three(limits=((-1, 1), None, None)).lock({"a": 2})
    with pytest.raises(DescriptionError, match=r"lock of 'a': 2 is outside the limits \[-1, 1\]"):
        m.build()
    m = three(limits=((-1, 1), (-1, 1), None)).lock({"a": 0.5})
    m.gear("b", "a", 3.0)
    with pytest.raises(
        DescriptionError, match=r"coordinate 'b': it is held at 1.5, outside its limits \[-1, 1\]"
    ):
        m.build()
    m = three(limits=((0, 0.1), (0, 0.3), None)).lock({"a": 0.1})
    m.gear("b", "a", 3.0)  # 0.1 * 3 > 0.3 by rounding
    assert m.build().structure.couplings["b"].offset == pytest.approx(0.3)


def test_coordinate_names_must_be_unique():
    m = Mechanism()
    m.cylindrical("a", m.ground, m.body("A"))
    m.revolute("a.rz", "A", m.body("B"))
    with pytest.raises(
        DescriptionError,
        match="joint 'a.rz': its coordinate 'a.rz' has the same name as one of joint 'a'",
    ):
        m.build()
    m = Mechanism()
    m.spherical("a", m.ground, m.body("A"))
    m.revolute("a.wx", "A", m.body("B"))
    with pytest.raises(
        DescriptionError,
        match="joint 'a.wx': its coordinate 'a.wx' has the same name as one of joint 'a'",
    ):
        m.build()


# ------------------------------------------------------------------ locks


def test_locked_coordinates_leave_q():
    s = arm().build()
    held = s.mechanism.lock({"q1": 0.4}).build()
    assert held.coordinate_names == ("q2",) and held.nq == 1 and held.joint_names == s.joint_names
    np.testing.assert_allclose(held.fk([0.3], "tip"), s.fk([0.4, 0.3], "tip"), rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        held.jacobian([0.3], "tip"), s.jacobian([0.4, 0.3], "tip")[:, 1:], rtol=0, atol=1e-15
    )
    assert held.q({"q1": 0.4, "q2": 0.3}).tolist() == [0.3]
    with pytest.raises(InputError, match="coordinate 'q1' is 0; it is held at 0.4"):
        held.q({"q1": 0.0})
    assert s.nq == 2, "locking makes a new system"


def test_a_locked_gripper():
    s = gripper().build()
    held = s.mechanism.lock({"left_finger": 0.04}).build()
    assert held.nq == 0
    np.testing.assert_allclose(held.fk([], "right")[:3, 3], [0, -0.04, 0], atol=1e-16)


def test_a_locked_ball():
    m = Mechanism()
    m.free("f", m.ground, m.body("b"))
    m.lock({"f.qw": 2, "f.qx": 0, "f.qy": 0, "f.qz": 2, "f.y": 0.5})
    s = m.build()
    assert s.coordinate_names == s.structure.velocity_names == ("f.x", "f.z")
    expected = (reference.placement((0.1, 0.5, 0.2)) @ reference.turn("z", np.pi / 2)).astype(float)
    np.testing.assert_allclose(s.fk([0.1, 0.2], "b"), expected, rtol=0, atol=1e-15)


# ------------------------------------------------------------------ parameters and designs


def designed() -> Mechanism:
    m = Mechanism("designed")
    l1 = m.parameter("l1", 1.0)
    _ = m.parameter("twist", 0.3)
    a = m.body("a")
    b = m.body("b")
    m.revolute("q1", m.ground, a)
    m.revolute("q2", a, b, at=(l1, 0, "l1/10"), rpy=("twist", 0, 0))
    m.spherical("q3", b, m.body("c"), at=(0, 2 * l1, 0))
    m.frame("tip", "c", at=("l1*cos(twist)", 0, 0))
    return m


@given(seed=st.integers(0, 10**6), lead=st.sampled_from([(), (2,), (0,), (2, 2)]))
def test_numbers_without_a_batch_are_one_design(seed, lead):
    rng = np.random.default_rng(seed)
    s = designed().build()
    (length, twist) = rng.uniform(0.5, 2, 2)
    one = s.with_parameters(l1=np.array(length), twist=np.array(twist))
    assert isinstance(one, System) and one == s.with_parameters(
        l1=float(length), twist=float(twist)
    )
    assert one.fk(one.random(rng, lead), "tip").shape == (*lead, 4, 4)


@given(
    seed=st.integers(0, 10**6),
    shape=st.sampled_from([(1,), (3,), (2, 3), (0,), (2, 0)]),
    lead=st.sampled_from([None, (), (2,), (0,), (2, 2)]),
)
def test_batches_of_designs_are_the_designs_one_by_one(seed, shape, lead):
    rng = np.random.default_rng(seed)
    s = designed().build()
    numbers = {"l1": rng.uniform(0.5, 2, shape), "twist": rng.normal(size=shape)}
    batch = s.with_parameters(**numbers)
    q = s.random(rng) if lead is None else s.random(rng, (*shape, *lead))
    T = batch.fk(q, "tip")
    assert batch.shape == shape and T.shape == (*shape, *(lead or ()), 4, 4)
    for i in np.ndindex(*shape):
        one = s.with_parameters(**{k: float(v[i]) for k, v in numbers.items()})
        np.testing.assert_allclose(
            T[i], one.fk(q if lead is None else q[i], "tip"), rtol=0, atol=1e-14
        )
        assert batch[i] == one


def test_one_varied_parameter_keeps_the_others():
    s = designed().build()
    batch = s.with_parameters(l1=[1.0, 2.0])
    assert batch.parameters["twist"] == 0.3 and "2" in repr(batch)
    np.testing.assert_allclose(batch.fk(s.neutral, "tip")[0], s.fk(s.neutral, "tip"), atol=1e-15)
    assert batch[1].structure.parameters == {"l1": 2.0, "twist": 0.3}
    mixed = s.with_parameters(l1=2.0, twist=[0.1, 0.2])
    assert mixed.shape == (2,) and mixed[0].structure.parameters == {"l1": 2.0, "twist": 0.1}


def test_designs_share_their_structure():
    s = designed().build()
    other = s.with_parameters(l1=2)
    assert (
        other != s
        and other.structure.hash == s.structure.hash
        and other.structure.content_hash != s.structure.content_hash
    )
    assert (
        other.structure.topology is s.structure.topology
        and s.with_parameters(l1=1.0) == s
        and s.with_parameters() == s
    )
    assert s.structure.parameters["l1"] == 1.0


def test_bad_parameters():
    s = designed().build()
    with pytest.raises(
        UnknownNameError, match="designed has no parameter 'twit'; did you mean 'twist'"
    ):
        s.with_parameters(twit=1)
    for bad in ("long", [1, "a"], [[1, 2], [3]], {}):
        words = "parameter .l1. (is|holds) .*; it must be a number or an array of numbers"
        with pytest.raises(InputError, match=words):
            s.with_parameters(l1=bad)
    with pytest.raises(InputError, match="parameter 'l1' is (nan|inf); it must be finite"):
        s.with_parameters(l1=np.nan)
    with pytest.raises(
        InputError, match=r"shapes of the parameters do not fit together: l1 \(2,\), twist \(3,\)"
    ):
        s.with_parameters(l1=[1, 2], twist=[1, 2, 3])
    with pytest.raises(InputError, match="q has shape"):
        s.with_parameters(l1=[1, 2]).fk(s.random(0, 3), "tip")
    m = Mechanism()
    m.parameter("d", 1.0)
    m.frame("f", m.ground, at=("sqrt(d)", 0, 0))
    with pytest.raises(
        DescriptionError, match="frame 'f': its placement is not a number with these parameters"
    ):
        m.build().with_parameters(d=-1)
    m = Mechanism()
    m.parameter("d", 0.0)
    m.revolute("j", m.ground, m.body("b"), at=("1/d", 0, 0))
    with pytest.raises(DescriptionError, match="not a number with these parameters"):
        m.build()


# ------------------------------------------------------------------ composition


def test_a_tool_on_a_frame():
    m = arm().attach(gripper(), to="tip", prefix="hand/")
    s = m.build()
    assert s.body_names == ("base", "link1", "link2", "hand/palm", "hand/left", "hand/right")
    assert s.joint_names[2] == "hand/palm_mount" and s.coordinate_names == (
        "q1",
        "q2",
        "hand/left_finger",
    )
    assert "hand/grasp" in s.frame_names and s.structure.posture_names == ("hand/open",)
    q = np.array([0.3, -0.4, 0.02])
    alone = arm().build()
    tool = gripper().build()
    for frame in ("grasp", "left", "right"):
        expected = alone.fk(q[:2], "tip") @ tool.fk(q[2:], frame)
        np.testing.assert_allclose(s.fk(q, f"hand/{frame}"), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(s.q("hand/open"), [0, 0, 0.04])


def test_the_same_thing_twice_side_by_side():
    m = Mechanism("two arms", ground="table")
    m.attach(arm(), prefix="l_", at=(0, 0.5, 0)).attach(
        arm().build(), prefix="r_", at=(0, -0.5, 0), rpy=(0, 0, np.pi)
    )
    s = m.build()
    assert s.nq == 4 and s.parent == (0, 1, 2, 0, 4, 5)
    alone = arm().build().fk([0.1, 0.2], "tip")
    q = [0.1, 0.2, 0.1, 0.2]
    np.testing.assert_allclose(
        s.fk(q, "l_tip"), reference.placement((0, 0.5, 0)).astype(float) @ alone, atol=1e-15
    )
    np.testing.assert_allclose(
        s.fk(q, "r_tip"),
        reference.placement((0, -0.5, 0), (0, 0, np.pi)).astype(float) @ alone,
        rtol=0,
        atol=1e-15,
    )
    with pytest.raises(
        DescriptionError, match="both have bodies and frames 'l_base'.*prefix='l_2_'"
    ):
        m.attach(arm(), prefix="l_")
    assert m.build() == s, "a refused call leaves the mechanism as it was"


def test_an_arm_on_itself():
    m = arm()
    m.attach(m, to="tip", prefix="second_")
    s = m.build()
    assert s.nq == 4
    np.testing.assert_allclose(
        s.fk([0.1, 0.2, 0, 0], "second_base"), s.fk([0.1, 0.2, 0, 0], "tip"), atol=1e-15
    )


def test_attached_things_keep_couplings_locks_parameters_limits_notes():
    guest = designed()
    guest.gear("q2", "q1", 2.0)
    guest.lock({"q3.qw": 1, "q3.qx": 0, "q3.qy": 0, "q3.qz": 0})
    guest.notes.append("a note")
    m = arm().attach(guest, to="link2", prefix="g.", at=(0.1, 0, 0))
    s = m.build()
    assert (
        s.coordinate_names == ("q1", "q2", "g.q1")
        and s.structure.couplings["g.q2"].source == "g.q1"
    )
    assert s.structure.parameters == {"l1": 1.0, "twist": 0.3} and "a note" in s.structure.notes
    m.attach(designed(), prefix="same.")
    other = designed()
    other.parameters["l1"] = 5.0
    with pytest.raises(InputError, match="parameter 'l1' is 1 here and 5 in 'designed'"):
        m.attach(other, prefix="h.")


def test_names_that_clash_ask_for_a_prefix():
    m = Mechanism("host", ground="table")
    m.attach(gripper())
    other = Mechanism("other", ground="plate")
    other.prismatic("left_finger", other.ground, other.body("thing"))
    said = (
        "attach 'other' to 'host': both have joints and constraints 'left_finger'; "
        ".*prefix='other_'"
    )
    with pytest.raises(DescriptionError, match=said):
        m.attach(other)
    third = Mechanism("third", ground="block")
    third.posture("open", {})
    with pytest.raises(
        DescriptionError, match="both have postures 'open'; give its names a prefix"
    ):
        m.attach(third)


def test_the_chain_between_two_bodies():
    m = arm(links=4).attach(gripper(), to="tip")
    chain = m.subchain("link1", "link3").build()
    assert chain.body_names == ("link1", "link2", "link3") and chain.coordinate_names == (
        "q2",
        "q3",
    )
    s = m.build()
    q = s.random(0)
    whole = np.linalg.inv(s.fk(q, "link1")) @ s.fk(q, "link3")
    np.testing.assert_allclose(chain.fk(q[1:3], "link3"), whole, rtol=0, atol=1e-15)
    np.testing.assert_allclose(chain.structure.limits, s.structure.limits[1:3])
    back = s.mechanism.subchain(
        "link3", "link1"
    ).build()  # upside down: joints are walked backwards, their direction stays
    np.testing.assert_allclose(
        back.fk(back.q({"q2": q[1], "q3": q[2]}), "link1"), np.linalg.inv(whole), atol=1e-15
    )
    tip = s.mechanism.subchain("base", "grasp").build()
    assert tip.frame_names[-2:] == ("tip", "grasp") and tip.nq == 4
    np.testing.assert_allclose(tip.fk(q[:4], "grasp"), s.fk(q, "grasp"), rtol=0, atol=1e-15)
    assert m.subchain("link2", "link2").build().nq == 0


def test_a_chain_keeps_what_it_follows_or_says_what_it_cannot():
    m = gripper()
    with pytest.raises(
        DescriptionError,
        match="coordinate 'right_finger': it follows left_finger, outside the chain; lock",
    ):
        m.subchain("palm", "right")
    held = m.lock({"left_finger": 0.03}).subchain("palm", "right").build()
    np.testing.assert_allclose(held.fk([], "right")[:3, 3], [0, -0.03, 0], atol=1e-16)
    m = three()
    m.gear("c", "b", 2.0, offset=0.1)
    m.gear("b", "a", 3.0, offset=0.2)
    m.revolute("d", "body_a", m.body("body_d"))
    m.couple("d", {"b": 1.0, "a": 0.5})
    chain = m.subchain("ground", "body_d").build()  # d follows b, which follows a
    assert chain.coordinate_names == ("a",)
    assert angle_of(chain.fk([0.1], "body_d")) == pytest.approx(0.1 + 3.5 * 0.1 + 0.2, abs=1e-15)


def test_chains_do_not_pass_through_particles():
    m = Mechanism()
    a = m.body("a")
    b = m.body("b")
    p = m.particle("p")
    m.revolute("A", m.ground, a), m.revolute("B", m.ground, b)
    m.prismatic("PA", a, p), m.prismatic("PB", b, p)
    assert [j for j in m.subchain("a", "b").joints] == ["A", "B"]
    assert list(m.subchain("a", "p").joints) == ["PA"]


# ------------------------------------------------------------------ identity


def test_equality_is_of_content():
    assert arm() == arm() and arm() != arm("other") and arm() != arm(length=2.0) and arm() != 3
    m = arm()
    m.notes.append("a note")
    assert m == arm(), "notes do not matter"
    for change in (
        lambda m: m.body("x"),
        lambda m: m.frame("f", "link1"),
        lambda m: m.parameter("k", 1.0),
        lambda m: m.gear("q2", "q1", 1.0),
        lambda m: m.posture("p", {}),
        lambda m: m.lock({"q1": 0.0}),
    ):
        m = arm()
        change(m)
        assert m != arm()
    with pytest.raises(TypeError):
        hash(arm())


def test_systems_are_values():
    s = arm().build()
    t = arm().build()
    assert s == t and hash(s) == hash(t) and len({s, t, arm(length=2.0).build()}) == 2
    for again in (pickle.loads(pickle.dumps(s)), copy.deepcopy(s), copy.copy(s)):
        assert again == s and again.structure.content_hash == s.structure.content_hash
        np.testing.assert_array_equal(again.fk([0.1, 0.2]), s.fk([0.1, 0.2]))
    assert s != "arm"


@pytest.mark.slow
def test_content_hash_is_the_same_in_every_process():
    import subprocess
    import sys

    code = (
        "from kempe import Mechanism; m = Mechanism('h'); m.parameter('k', 0.1); m.universal('u', "
        "m.ground, m.body('b'), at=('k', 0, 0), limits={'rx': (0, 1), 'ry': (-1, 1)}); s = "
        "m.build().structure; print(s.content_hash, s.hash)"
    )
    outs = {
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path)},
        ).stdout
        for seed in "12"
    }
    assert len(outs) == 1 and len(outs.pop().split()) == 2


def test_a_built_system_does_not_see_later_changes():
    m = arm()
    s = m.build()
    m.body("late"), m.revolute("late", "link2", "late")
    m.lock({"q1": 0})
    again = s.mechanism
    again.lock({"q2": 0})
    assert s.nq == 2 and "late" not in s.body_names and m.copy() == m and m.copy() is not m
    for name in ("nq", "name", "parent", "lower", "neutral"):
        with pytest.raises(AttributeError):
            setattr(s, name, 0)
    for array in (
        s.lower,
        s.upper,
        s.structure.limits,
        s.structure.velocity_limits,
        s.neutral,
        s.mid,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 99.0
    assert s.lower[0] == -2.0 and s.neutral[0] == 0.0
    for array in (
        s.structure.coordinates.lower,
        s.structure.layout.vector_q,
        s.structure.table.placement,
        s.structure.coordinates.turning,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_postures():
    m = arm()
    m.posture("home", {"q1": 0.5})
    m.posture("zero", {})
    s = m.build()
    assert s.structure.posture_names == ("home", "zero")
    np.testing.assert_array_equal(s.q("home"), [0.5, 0.0])
    np.testing.assert_array_equal(s.q("zero"), s.neutral)
    with pytest.raises(InputError, match="posture 'home' exists already"):
        m.posture("home", {})
    with pytest.raises(UnknownNameError, match="arm has no posture 'hone'; did you mean 'home'"):
        s.q("hone")
    m.posture("wrong", {"q9": 1.0})
    with pytest.raises(
        DescriptionError, match="posture 'wrong': arm has no coordinate 'q9'; there are: 'q1', 'q2'"
    ):
        m.build()
    held = s.mechanism.lock({"q1": 0.2}).build()
    np.testing.assert_array_equal(held.q("home"), [0.0])


def test_printing():
    assert repr(arm()) == "Mechanism('arm', dim=3, bodies=2, joints=2)"
    assert repr(arm().build()) == "System('arm', bodies=2, joints=2, nq=2)"


def test_particles():
    m = Mechanism("beads")
    a = m.body("a")
    p = m.particle("p")
    m.revolute("j", m.ground, a)
    m.prismatic("s", a, p, at=(1, 0, 0), axis=(0, 1, 0))
    m.frame("on p", p)
    s = m.build()
    X = s.fk([0.3, 0.5], "p")
    c = np.cos(0.3)
    si = np.sin(0.3)
    np.testing.assert_allclose(X[:3, 3], [c - 0.5 * si, si + 0.5 * c, 0], atol=1e-15)
    np.testing.assert_array_equal(X[:3, :3], np.eye(3))
    np.testing.assert_array_equal(s.fk([0.3, 0.5], "on p"), X)
    J = s.jacobian([0.3, 0.5], "p")
    assert np.all(J[3:] == 0)
    np.testing.assert_allclose(J[:2, 0], [-X[1, 3], X[0, 3]], atol=1e-15)
    np.testing.assert_array_equal(s.jacobian([0.3, 0.5], "p", "body"), J)


def test_particles_hold_nothing():
    m = Mechanism("chain through a bead")
    b = m.body("b")
    p = m.particle("p")
    m.free("f", m.ground, p)
    m.prismatic("s", b, p)
    with pytest.raises(
        DescriptionError,
        match="no joints lead from 'ground' to 'b'; a free body needs.*particle can hold no",
    ):
        m.build()


def test_a_loop_through_a_particle_is_cut_at_the_particle():
    m = Mechanism("bead on two rods")
    a = m.body("a")
    b = m.body("b")
    p = m.particle("p")
    m.spherical("A", m.ground, a), m.spherical("B", m.ground, b, at=(1, 0, 0))
    m.prismatic("PA", a, p, axis=(1, 0, 0)), m.prismatic("PB", b, p, axis=(-1, 0, 0))
    s = m.build()
    assert len(s.structure.closures) == 1 and s.structure.closures[0] in ("PA", "PB")
    q = s.q({"PA": 0.25, "PB": 0.75})
    np.testing.assert_allclose(s.loops.closure_error(q), np.zeros((1, 6)), atol=1e-15)
    error = s.loops.closure_error(
        s.q({"PA": 0.25, "PB": 0.75, "B.qw": np.cos(0.1), "B.qz": np.sin(0.1)})
    )[0]
    assert np.all(error[3:] == 0)
    np.testing.assert_allclose(np.linalg.norm(error[:3]), 2 * 0.75 * np.sin(0.1), atol=1e-15)


# ---- placements in all the ways in which they are given


def turned(rng: np.random.Generator) -> tuple[Rotation, dict[str, object]]:
    """A rotation, and keywords that say it."""
    R = Rotation.random(random_state=int(rng.integers(2**31)))
    how = int(rng.integers(5))
    if how == 0:
        return R, {"matrix": R.as_matrix() if rng.random() < 0.5 else R.as_matrix().tolist()}
    if how == 1:
        return R, {"quat_wxyz": (R.as_quat()[[3, 0, 1, 2]] * rng.uniform(0.5, 2.0)).tolist()}
    if how == 2:
        return R, {"rpy": R.as_euler("xyz").tolist()}
    if how == 3:
        angle = float(rng.uniform(-3, 3))
        return Rotation.from_rotvec([0, 0, angle]), {"angle": angle}
    return Rotation.identity(), {}


AXES = {
    "x": (1, 0, 0),
    "+y": (0, 1, 0),
    "z": (0, 0, 1),
    "-x": (-1, 0, 0),
    "-y": (0, -1, 0),
    "-z": (0, 0, -1),
}


def placed(rng: np.random.Generator) -> tuple[np.ndarray, dict[str, object]]:
    """A pose (4, 4), and keywords that say it, the axis left out."""
    R, keywords = turned(rng)
    X = np.eye(4)
    X[:3, :3] = R.as_matrix()
    X[:3, 3] = rng.uniform(-1, 1, 3)
    if rng.random() < 0.3:
        return X, {"at": X if rng.random() < 0.5 else X.tolist()}
    return X, {"at": X[:3, 3].tolist(), **keywords}


def hunted(rng: np.random.Generator, count: int) -> None:
    """Joints placed in all ways, by the builder and by TOML: both frames where the keywords say, by
    scipy.
    """
    for _ in range(count):
        (A, on_parent) = placed(rng)
        (B, on_child) = placed(rng)
        axis = str(rng.choice(list(AXES)))
        kind, q = (
            ("revolute", float(rng.uniform(-3, 3)))
            if rng.random() < 0.5
            else ("prismatic", float(rng.uniform(-1, 1)))
        )
        limits = ((None, 4.0), (-4.0, None), (None, None), (-4, 4))[rng.integers(4)]
        m = Mechanism("m")
        child = {f"child_{k}": v for k, v in on_child.items()}
        j = m.joint(
            "j", kind, m.ground, m.body("b"), axis=axis, limits=limits, **on_parent, **child
        )
        motion = np.eye(4)
        if kind == "revolute":
            motion[:3, :3] = Rotation.from_rotvec(q * np.array(AXES[axis])).as_matrix()
        else:
            motion[:3, 3] = q * np.array(AXES[axis])
        np.testing.assert_allclose(
            m.build().fk([q], "b"), A @ motion @ np.linalg.inv(B), rtol=0, atol=1e-12
        )
        ends = tuple(
            float(s * np.inf) if x is None else float(x)
            for x, s in zip(limits, (-1, 1), strict=True)
        )
        assert j.limits == {"": ends}
        text = (
            'format = 1\nname = "m"\n[[body]]\nname = "b"\n[[joint]]\nname = "j"\nparent = '
            '"ground"\nchild = "b"\n'
        )
        keys = {"type": kind, "axis": axis, "limits": list(ends), **on_parent, **child}
        text += "".join(
            f"{k} = {json.dumps(np.asarray(v).tolist())}\n" for k, v in keys.items()
        ).replace("Infinity", "inf")
        assert read_toml(text) == m


def test_joints_are_where_their_keywords_say(hunt):
    hunted(hunt.rng(), hunt.cases(100))


@pytest.mark.slow
def test_many_joints_are_where_their_keywords_say(hunt):
    hunted(hunt.rng(), hunt.cases(1000))


def test_constraints_and_frames_take_all_placements():
    m = Mechanism("m")
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("x", 0.3).as_matrix()
    X[:3, 3] = (1, 2, 3)
    m.free("f", m.ground, m.body("b"))
    a = m.point_on_line(
        "a", m.ground, "b", at=(1, 2, 3), quat_wxyz=(np.cos(0.15), np.sin(0.15), 0, 0)
    )
    b = m.point_on_plane("b", m.ground, "b", at=X, axis="-y")
    c = m.point_on_line("c", m.ground, "b", at=(1, 2, 3), matrix=X[:3, :3])
    f = m.frame("tip", "b", at=X)
    for placement in (a.X_PF, c.X_PF, f.X_BF):
        np.testing.assert_allclose(placement.evaluate_pose({}), X, rtol=0, atol=1e-15)
    np.testing.assert_allclose(b.X_PF.evaluate_pose({})[:3, 2], -X[:3, 1], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        (
            {"quat_xyzw": (0, 0, 0, 1)},
            "joints have no keyword 'quat_xyzw'; did you mean 'quat_wxyz'",
        ),
        ({"matrx": np.eye(3)}, "joints have no keyword 'matrx'; did you mean 'matrix'"),
        ({"axis": "w"}, "axis is 'w'; it must be numbers, or one of x, y, z, -x, -y, -z"),
        (
            {"matrix": np.eye(4)},
            r"matrix is a pose \(4, 4\); it must be a rotation \(3, 3\), and a pose is given as at",
        ),
        (
            {"at": np.ones((4, 4))},
            "the matrix is not a pose: its last row is .*; it must be 0 0 0 1",
        ),
        ({"at": np.diag([2.0, 1, 1, 1])}, "matrix is not a rotation"),
        ({"matrix": np.eye(3), "rpy": (0, 0, 0)}, "orientation given twice, by rpy and matrix"),
        (
            {"limits": (None, 1, 2)},
            r"they must be a pair \(lower, upper\), None where there is none",
        ),
        ({"limits": ("", 1)}, "they must be a pair"),
        ({"colour": 1}, "joints have no keyword 'colour'; they take at, child_at, rpy, .*limits"),
        ({"origin": (0, 0, 0)}, r"no keyword 'origin': give the joint's place as at=\(x, y, z\)"),
        ({"xyz": (0, 0, 0)}, r"no keyword 'xyz': give the joint's place as at=\(x, y, z\)"),
        ({"length": 1.0}, "no keyword 'length': a link's length is where its next joint sits"),
        ({"lower": 0.0}, r"no keyword 'lower': give limits=\(lower, upper\)"),
        ({"rpy": 0.6}, "rpy is 0.6; it must have 3 numbers; one turn about z is angle=0.6"),
    ],
)
def test_keywords_that_are_none(keywords, words):
    m = Mechanism("m")
    with pytest.raises((DescriptionError, InputError), match=words):
        m.revolute("j", m.ground, m.body("b"), **keywords)


def test_methods_of_joints_show_all_keywords():
    """Signatures and docstrings of `revolute` and its siblings have all keywords of `joint`, with
    their types and defaults, and so has the type `JointKeywords` that editors read.
    """
    own = inspect.signature(Mechanism.joint).parameters
    shown = {name: own[name].annotation for name in JointKeywords.__annotations__}
    assert [p for p in own if p in shown] == list(own)[5:-1]
    types = {n: t.__forward_arg__ for n, t in JointKeywords.__annotations__.items()}
    assert types == shown
    for kind in joints.TYPES:
        method = getattr(Mechanism, kind)
        keywords = inspect.signature(method).parameters
        assert all(keywords[p].default == own[p].default for p in shown)
        assert {p.kind for p in keywords.values()} <= {
            inspect.Parameter.POSITIONAL_OR_KEYWORD,
            inspect.Parameter.KEYWORD_ONLY,
        }
        described = method.__doc__.partition("Parameters\n---")[2].partition("\n\nReturns")[0]
        lines = {name for line in described.splitlines() for name in line.split(", ")}
        assert set(keywords) - {"self"} <= lines, kind


def test_no_public_method_takes_any():
    public = [f for n, f in vars(Mechanism).items() if inspect.isfunction(f) and n[0] != "_"]
    assert len(public) > 30
    for function in public:
        assert "Any" not in str(inspect.signature(function)), function
