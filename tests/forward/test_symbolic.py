"""Formulas: those of the lecture and of textbooks to the letter, and the right numbers for systems
of every kind.
"""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import reference
from graphs import KINDS, Graph, graphs
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

import kempe
from kempe import Mechanism, System
from kempe.errors import InputError, UnknownNameError, UnsupportedError

sympy = pytest.importorskip("sympy")
from kempe.forward.symbolic import TURN_LIMIT, derive_fk  # noqa: E402


def numbers(formula, system: System, q, **parameters) -> np.ndarray:
    """The formula as numbers, by sympy, at a configuration."""
    values = {
        **system.structure.parameters,
        **parameters,
        **dict(zip(system.coordinate_names, q, strict=True)),
    }
    function = sympy.lambdify([sympy.Symbol(n) for n in values], formula, modules="numpy", cse=True)
    return np.array(function(*values.values()), dtype=float)


def two_link() -> Mechanism:
    m = Mechanism("two-link", dim=2)
    l1 = m.parameter("l1", 0.5)
    l2 = m.parameter("l2", 0.4)
    m.revolute("q1", m.ground, m.body("B1"))
    m.revolute("q2", "B1", m.body("B2"), at=(l1, 0))
    m.frame("e", "B2", at=(l2, 0))
    return m


# ------------------------------------------------------------------ formulas to the letter


def test_the_lectures_formula():
    T = two_link().build().symbolic.fk("e")
    assert isinstance(T, sympy.Matrix) and T.shape == (4, 4)
    assert [str(x) for x in T[:2, 3]] == [
        "l1*cos(q1) + l2*cos(q1 + q2)",
        "l1*sin(q1) + l2*sin(q1 + q2)",
    ]
    assert [str(x) for x in T[:2, 0]] == ["cos(q1 + q2)", "sin(q1 + q2)"]
    assert [str(x) for x in T[:2, 1]] == ["-sin(q1 + q2)", "cos(q1 + q2)"]
    assert list(T[2, :]) == [0, 0, 1, 0] and list(T[3, :]) == [0, 0, 0, 1]
    assert T.snapped == ()


def test_it_prints_as_latex():
    T = two_link().build().symbolic.fk("e")
    assert (
        sympy.latex(T[0, 3])
        == r"l_{1} \cos{\left(q_{1} \right)} + l_{2} \cos{\left(q_{1} + q_{2} \right)}"
    )
    shown = T._repr_latex_()
    assert shown.startswith("$") and r"l_{2} \sin{\left(q_{1} + q_{2} \right)}" in shown
    assert pickle.loads(pickle.dumps(T)) == T


@pytest.mark.parametrize("tilt", [(0, 0, 0), (0.5, 0, 0), (0, -0.5, 1), (1, 0, 0.5)])
def test_three_parallel_joints_whatever_axes_they_are_written_in(tilt):
    """The second joint's frames are tilted by quarter turns; its axis stays the same."""
    m = Mechanism("3R")
    for i in (1, 2, 3):
        m.parameter(f"l{i}", 1.0)
    lengths = ["0", "l1", "l2"]
    here = m.ground
    tilt = [x * math.pi for x in tilt]
    R = reference.placement((0, 0, 0), tilt)[:3, :3].astype(float)
    for i, length in enumerate(lengths, 1):
        link = m.body(f"B{i}")
        turn = {"rpy": tilt, "child_rpy": tilt} if i == 2 else {}
        axis = np.rint(R.T[:, 2]) if i == 2 else (0, 0, 1)
        m.revolute(f"q{i}", here, link, at=(length, 0, 0), axis=axis, **turn)
        here = link
    m.frame("e", here, at=("l3", 0, 0))
    T = m.build().symbolic.fk("e")
    assert str(T[0, 3]) == "l1*cos(q1) + l2*cos(q1 + q2) + l3*cos(q1 + q2 + q3)"
    assert str(T[1, 3]) == "l1*sin(q1) + l2*sin(q1 + q2) + l3*sin(q1 + q2 + q3)"
    assert str(T[0, 0]) == "cos(q1 + q2 + q3)" and T[2, 3] == 0


def test_a_scara():
    T = kempe.load("cobra600").symbolic.fk("tool")
    assert str(T[0, 3]) == "a1*cos(q1) + a2*cos(q1 + q2)"
    assert str(T[1, 3]) == "a1*sin(q1) + a2*sin(q1 + q2)"
    assert str(T[2, 3]) == "d1 - q3"
    assert str(T[0, 0]) == "cos(q1 + q2 - q4)" and T[2, 2] == -1


def test_a_joint_turned_over_counts_backwards():
    m = Mechanism("backwards")
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"), at=(1, 0, 0), axis=(0, 0, -1))
    # the tree walks it from its child to its parent
    m.revolute("C", m.body("c"), "b", child_at=(2, 0, 0))
    T = m.build().symbolic.fk("c")
    assert str(T[0, 3]) == "cos(A) + 2*cos(A - B)" and str(T[0, 0]) == "cos(-A + B + C)"


def test_the_puma_of_the_textbooks():
    """Position of the wrist (Paul and Zhang, 1986)."""
    T = kempe.load("puma560").symbolic.fk("tool")
    c1, s1, c2, s2, c23, s23 = sympy.symbols("c1 s1 c2 s2 c23 s23")
    q1, q2, q3 = sympy.symbols("q1 q2 q3")
    names = {
        sympy.cos(q1): c1,
        sympy.sin(q1): s1,
        sympy.cos(q2): c2,
        sympy.sin(q2): s2,
        sympy.cos(q2 + q3): c23,
        sympy.sin(q2 + q3): s23,
    }
    a2, a3, d3, d4 = sympy.symbols("a2 a3 d3 d4")
    reach = a2 * c2 + a3 * c23 - d4 * s23
    wanted = [c1 * reach + d3 * s1, s1 * reach - d3 * c1, a2 * s2 + a3 * s23 + d4 * c23]
    for got, x in zip(T[:3, 3], wanted, strict=True):
        assert sympy.expand(got.subs(names) - x) == 0


def test_the_stanford_arm_of_the_textbooks():
    """Pose of the hand (Spong, Hutchinson, Vidyasagar, 2006, chapter 3), where the shoulder is the
    origin.
    """
    arm = kempe.load("stanford")
    T = arm.symbolic.fk("tool", symbols={"d1": 0})
    d2, d3, d6 = sympy.symbols("d2 d3 d6")
    (c1, s1), (c2, s2), (c4, s4), (c5, s5), (c6, s6) = (
        (sympy.cos(x), sympy.sin(x)) for x in sympy.symbols("q1 q2 q4 q5 q6")
    )
    position = [
        c1 * s2 * d3 - s1 * d2 + d6 * (c1 * c2 * c4 * s5 + c1 * c5 * s2 - s1 * s4 * s5),
        s1 * s2 * d3 + c1 * d2 + d6 * (c1 * s4 * s5 + c2 * c4 * s1 * s5 + c5 * s1 * s2),
        c2 * d3 + d6 * (c2 * c5 - c4 * s2 * s5),
    ]
    first = c1 * (c2 * (c4 * c5 * c6 - s4 * s6) - s2 * s5 * c6) - s1 * (s4 * c5 * c6 + c4 * s6)
    for got, x in zip([*T[:3, 3], T[0, 0]], [*position, first], strict=True):
        assert sympy.expand(got - x) == 0


def test_a_quaternion_is_a_polynomial():
    m = Mechanism("ball")
    m.spherical("S", m.ground, m.body("b"))
    T = m.build().symbolic.fk("b")
    w, x, y, z = (sympy.Symbol(f"S.q{c}") for c in "wxyz")
    assert T[0, 0] == 1 - 2 * y**2 - 2 * z**2 and T[1, 0] == 2 * w * z + 2 * x * y


# ------------------------------------------------------------------ numbers


@pytest.mark.slow
@given(graph=graphs(most=5), seed=st.integers(0, 10**6))
@settings(max_examples=examples(60))
def test_random_systems(graph: Graph, seed):
    """All joint types, walked both ways, gears, locks and particles, against the reference."""
    s = graph.mechanism().build()
    q = s.random(seed)
    expected = graph.poses(s, q)
    rng = np.random.default_rng(seed)
    for name in rng.choice(s.body_names, min(2, len(s.body_names)), replace=False).tolist():
        np.testing.assert_allclose(
            numbers(s.symbolic.fk(name), s, q), expected[name], rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("kind, options", KINDS)
def test_each_joint(kind, options, backwards):
    m = Mechanism("one joint")
    body = m.body("b")
    m.joint("J", kind, *((body, m.ground) if backwards else (m.ground, body)), **options)
    s = m.build()
    q = s.random(3)
    X = reference.joint_pose(kind, q, **options)
    expected = (reference.inverse(X) if backwards else X).astype(float)
    np.testing.assert_allclose(numbers(s.symbolic.fk("b"), s, q), expected, rtol=0, atol=1e-14)


ANGLES = [
    math.pi / 2,
    -math.pi / 2,
    math.pi,
    math.pi / 3,
    -3 * math.pi / 4,
    0.0,
    0.7,
    "alpha",
    "pi/2 - alpha",
    "pi/6",
]
LENGTHS = [0.0, 0.3, -1.0, "l", "l/2 + 0.1", "l*cos(alpha)"]
DIRECTIONS = [
    (0, 0, 1),
    (0, 0, -1),
    (1, 0, 0),
    (0, -2.5, 0),
    (1, 1, 0),
    (0.3, -0.4, 0.5),
    (1, 2, 3),
]


@st.composite
def chains(draw) -> System:
    """Chains with parameters, axes in every direction, exact angles, couplings and locks."""
    m = Mechanism("chain")
    m.parameter("alpha", 0.4), m.parameter("l", 0.7)
    here = m.ground
    others = ["prismatic", "helical", "cylindrical", "universal", "spherical", "planar"]

    def place():
        rpy = [draw(st.sampled_from(ANGLES[:3])) for _ in range(3)]
        rpy[draw(st.integers(0, 2))] = draw(st.sampled_from(ANGLES))  # one, or formulas get long
        return {"at": [draw(st.sampled_from(LENGTHS)) for _ in range(3)], "rpy": rpy}

    for i in range(draw(st.integers(1, 4))):
        body = m.body(f"b{i}")
        kind = draw(st.just("revolute") | st.sampled_from(others))
        X = place()
        Y = place()
        options = {"pitch": draw(st.sampled_from([0.2, -1.0]))} if kind == "helical" else {}
        ends = (body, here) if draw(st.booleans()) else (here, body)
        axis = draw(st.sampled_from(DIRECTIONS))
        m.joint(
            f"j{i}", kind, *ends, **X, child_at=Y["at"], child_rpy=Y["rpy"], axis=axis, **options
        )
        here = body
    single = [
        n for n, j in m.joints.items() if j.type.type_name in ("revolute", "prismatic", "helical")
    ]
    if len(single) > 2 and draw(st.booleans()):
        m.couple(
            single[0],
            {single[1]: draw(st.sampled_from([-1.0, 0.5, "2*l"]))},
            draw(st.sampled_from(ANGLES)),
        )
    if len(single) > 1 and draw(st.booleans()):
        m.lock({single[-1]: draw(st.sampled_from([math.pi / 2, 0.3]))})
    m.frame("e", here, **place(), axis=draw(st.sampled_from(DIRECTIONS)))
    return m.build()


@pytest.mark.slow
@given(s=chains(), seed=st.integers(0, 10**6))
@settings(max_examples=examples(20))
def test_chains_with_parameters(s: System, seed):
    q = s.random(seed)
    T = s.symbolic.fk("e")
    for new in ({}, {"alpha": -1.1, "l": 0.25}):
        expected = s.with_parameters(**new).fk(q, "e")
        np.testing.assert_allclose(numbers(T, s, q, **new), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "name", ["puma560", "ur5", "stanford", "cobra600", "panda", "seven_bodies_loop"]
)
def test_shipped_models(name):
    s = kempe.load(name)
    q = s.random(1)
    for frame in (s.frame_names[-1], s.body_names[-1]):
        np.testing.assert_allclose(
            numbers(s.symbolic.fk(frame), s, q), s.fk(q, frame), rtol=0, atol=1e-12
        )


def test_panda_from_its_file():
    folder = (
        Path(sys.prefix)
        / "lib"
        / f"python{sys.version_info[0]}.{sys.version_info[1]}"
        / "site-packages"
    )
    found = sorted(
        folder.glob(
            "cmeel.prefix/share/example-robot-data/robots/panda_description/urdf/panda.urdf"
        )
    )
    if not found:
        pytest.skip("example-robot-data is not installed")
    s = kempe.load(found[0])
    q = s.random(5)
    T = s.symbolic.fk("panda_hand_tcp")
    np.testing.assert_allclose(numbers(T, s, q), s.fk(q, "panda_hand_tcp"), rtol=0, atol=1e-12)


def test_loose_ends():
    """The ground, a frame on it, a particle, a quaternion that is locked or set by parameters, a
    numeric matrix.
    """
    m = Mechanism("loose ends")
    m.parameter("w", 0.3)
    m.frame("f", m.ground, at=(1, 2, 3), quat_wxyz=("w", 1, 0, 0.5))
    m.spherical("S", m.ground, m.body("b"))
    m.revolute("R", "b", m.body("c"), at=(1, 0, 0))
    m.prismatic("P", "c", m.particle("dot"), axis=(1, 0, 0))
    m.frame("g", "c", matrix=reference.placement((0, 0, 0), (0.1, 0.2, 0.3))[:3, :3].astype(float))
    m.lock({"S.qw": 2.0, "S.qx": 0.0, "S.qy": 1.0, "S.qz": -1.0})
    s = m.build()
    q = s.random(0)
    for name in s.frame_names:
        np.testing.assert_allclose(
            numbers(s.symbolic.fk(name), s, q), s.fk(q, name), rtol=0, atol=1e-14
        )
    assert s.symbolic.fk("dot")[:3, :3] == sympy.eye(3) and s.symbolic.fk("ground") == sympy.eye(4)


# ------------------------------------------------------------------ constants


def turned(angle) -> System:
    m = Mechanism("turned")
    m.prismatic("x", m.ground, m.body("b"), rpy=(0, 0, angle), axis=(1, 0, 0))
    return m.build()


@pytest.mark.parametrize("k", range(-24, 25))
def test_exact_angles(k):
    for angle in (k * math.pi / 12, math.radians(15 * k), float(sympy.pi * k / 12)):
        x = turned(angle).symbolic.fk("b")[0, 3]
        assert x == sympy.cos(sympy.pi * k / 12) * sympy.Symbol("x") and not x.has(sympy.Float)


@pytest.mark.parametrize(
    "angle", [1.5708, 0.5, 1.0, math.pi / 7, math.nextafter(math.nextafter(math.pi, 4), 4)]
)
def test_other_angles_stay_what_they_are(angle):
    factor = turned(angle).symbolic.fk("b")[0, 3].coeff(sympy.Symbol("x"))
    assert isinstance(factor, sympy.Float) and float(factor) == pytest.approx(
        math.cos(angle), rel=1e-15
    )


def test_lengths_stay_decimals_and_print_well():
    m = Mechanism("lengths", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"), at=(0.333, 0))
    m.frame("e", "b", at=(2.0, 0))
    x = m.build().symbolic.fk("e")[0, 3]
    assert str(x) == "0.333*cos(A) + 2*cos(A + B)"
    assert float(x.coeff(sympy.cos(sympy.Symbol("A")))) == 0.333


def test_snap():
    s = turned(1.5708)
    assert s.symbolic.fk("b").snapped == s.symbolic.fk("b", snap=1e-6).snapped == ()
    T = s.symbolic.fk("b", snap=1e-5)
    assert T[0, 3] == 0 and T[1, 3] == sympy.Symbol("x")
    assert T.snapped == ("joint 'x': angle 1.5708 taken as pi/2",)


def test_snap_of_a_matrix():
    m = Mechanism("matrix")
    m.frame(
        "f",
        m.ground,
        matrix=reference.placement((0, 0, 0), (1e-6, 0, math.pi / 2))[:3, :3].astype(float),
    )
    s = m.build()
    T = s.symbolic.fk("f", snap=1e-5)
    assert T[:3, :3] == sympy.Matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert T.snapped == ("frame 'f': rotation matrix moved by 1e-06 rad to quarter turns",)
    assert s.symbolic.fk("f", snap=1e-7).snapped == ()


def test_snap_of_an_axis():
    m = Mechanism("axis")
    m.revolute("A", m.ground, m.body("b"), axis=(1e-7, 0, -2))
    s = m.build()
    assert s.symbolic.fk("b").has(sympy.Float)
    T = s.symbolic.fk("b", snap=1e-6)
    assert str(T[1, 0]) == "-sin(A)" and T[2, 2] == 1
    assert T.snapped == ("joint 'A': axis (1e-07, 0.0, -2.0) taken as (0.0, 0.0, -1.0)",)


def test_couplings_keep_their_names():
    m = Mechanism("gears", dim=2)
    ratio = m.parameter("ratio", 3.0)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"))
    m.revolute("C", "b", m.body("c"))
    m.gear("B", "A", ratio)
    m.couple("C", {"B": -1.0}, math.pi / 2)
    s = m.build()
    assert str(s.symbolic.fk("b")[0, 0]) == "cos(A*ratio + A)"
    assert str(s.symbolic.fk("c")[0, 0]) == "-sin(A)"


# ------------------------------------------------------------------ other symbols, wrong arguments


def test_symbols_of_ones_own():
    s = two_link().build()
    theta = sympy.Symbol("theta_1", real=True)
    T = s.symbolic.fk("e", symbols={"q1": theta, "l1": 1, "l2": "a/2"})
    assert str(T[0, 3]) == "a*cos(q2 + theta_1)/2 + cos(theta_1)"
    assert str(s.symbolic.fk("e", symbols={"q2": 0})[0, 3]) == "(l1 + l2)*cos(q1)"  # one body, then


def test_wrong_arguments():
    s = two_link().build()
    with pytest.raises(UnknownNameError, match="did you mean 'e'"):
        s.symbolic.fk("E")
    with pytest.raises(UnknownNameError, match="no coordinate or parameter 'q3'"):
        s.symbolic.fk("e", symbols={"q3": 1})
    for snap in (-1.0, math.nan, 1.0, "a", True):
        with pytest.raises(InputError, match="snap"):
            derive_fk(s, "e", snap=snap)
    m = Mechanism("twice", dim=2)
    m.parameter("q", 1.0)
    m.revolute("q", m.ground, m.body("b"), at=("q", 0))
    with pytest.raises(InputError, match="'q' is the name of a parameter and of a coordinate"):
        m.build().symbolic.fk("b")


def test_a_formula_of_too_many_turns_is_refused():
    m = Mechanism("long")
    here = m.ground
    for i in range(TURN_LIMIT + 1):
        m.revolute(f"q{i}", here, m.body(f"b{i}"), axis=((1, 0, 0), (0, 1, 0))[i % 2])
        here = f"b{i}"
    s = m.build()
    with pytest.raises(UnsupportedError, match=f"more than {TURN_LIMIT} turns"):
        s.symbolic.fk(here)
    assert s.symbolic.fk("b3").shape == (4, 4)


def test_without_sympy():
    code = (
        "import sys; sys.modules['sympy'] = None\n"
        "import kempe\n"
        "m = kempe.Mechanism('m', dim=2); m.revolute('q', m.ground, m.body('b'))\n"
        "try:\n    m.build().symbolic.fk('b')\n"
        "except kempe.errors.MissingExtraError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True
    )
    assert done.stdout.strip().endswith("pip install 'sympy>=1.12'")
