"""Formulas step by step, relative, as a Jacobian, in short: those of the lecture, and the numbers
of `fk`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hunts import some

import kempe
from kempe import Mechanism, spatial
from kempe.errors import InputError, UnknownNameError, UnsupportedError

sympy = pytest.importorskip("sympy")
from kempe.forward.symbolic_steps import shorten_formula  # noqa: E402

ARM = kempe.load("two_link")
SYSTEMS = [
    "two_link",
    "seven_bodies",
    "puma560",
    "ur5",
    "panda",
    "four_bar",
    "four_links",
    "joint_helical",
    "joint_universal",
    "joint_cylindrical",
    "seven_bodies_loop",
]


def numbers(system, formula, q):
    """The formula as numbers at q."""
    values = {**system.structure.parameters, **dict(zip(system.coordinate_names, q, strict=True))}
    return np.array(formula.subs(values).evalf(), dtype=float)


def ends(system):
    """The last frame and a body half way to it."""
    return system.frame_names[-1], system.body_names[(len(system.body_names) + 1) // 2]


@pytest.mark.parametrize("name", some(SYSTEMS, 3))
def test_steps_multiply_to_the_forward_model(name):
    system = kempe.load(name)
    q = system.random(3)
    frame = ends(system)[0]
    steps = system.symbolic.steps(frame)
    pairs = list(zip(steps.names[:-1], steps.names[1:], strict=True))
    assert len(steps.T) == len(pairs) == len(steps.R) == len(steps.p)
    for (a, b), T, R, p, X in zip(pairs, steps.T, steps.R, steps.p, steps.numbers(q), strict=True):
        A = system.fk(q, a) if a != steps.names[0] else np.eye(4)
        B = system.fk(q, b)
        assert np.allclose(
            numbers(system, T, q), spatial.inverse(A) @ B, atol=1e-12
        ) and np.allclose(X, spatial.inverse(A) @ B, atol=1e-12)
        assert T[:3, :3] == R and T[:3, 3] == p
    for b, product in zip(steps.names[1:], steps.products, strict=True):
        assert np.allclose(numbers(system, product, q), system.fk(q, b), atol=1e-12)
    assert steps.merged == system.symbolic.fk(frame)


@pytest.mark.parametrize("name", some(SYSTEMS, 3))
def test_one_frame_in_another_and_the_jacobian(name):
    system = kempe.load(name)
    q = system.random(4)
    (frame, body) = ends(system)
    for a, b in ((frame, body), (body, frame), (frame, frame)):
        relative = numbers(system, system.symbolic.fk(a, relative_to=b), q)
        assert np.allclose(relative, spatial.inverse(system.fk(q, b)) @ system.fk(q, a), atol=1e-12)
    J = system.symbolic.jacobian(frame)
    assert J.shape == (6, system.nv)
    assert np.allclose(numbers(system, J, q), system.jacobian(q, frame), atol=1e-12)


def test_the_lectures_arm_to_the_letter():
    """The slide: 0p_e = 0R1 (1p_2 + 1R2 2p_e), with frames in the joints."""
    steps = ARM.symbolic.steps("e")
    q1, q2, l1, l2 = sympy.symbols("q1 q2 l1 l2")
    assert steps.names == ("ground", "B1", "B2", "e")
    assert [list(p) for p in steps.p] == [[0, 0, 0], [l1, 0, 0], [l2, 0, 0]]
    assert steps.R[0] == sympy.Matrix(
        [[sympy.cos(q1), -sympy.sin(q1), 0], [sympy.sin(q1), sympy.cos(q1), 0], [0, 0, 1]]
    )
    by_hand = steps.R[0] * (steps.p[1] + steps.R[1] * steps.p[2])
    assert sympy.simplify(by_hand - steps.merged[:3, 3]) == sympy.zeros(3, 1)
    c1, s1, c12, s12 = sympy.symbols("c1 s1 c12 s12")
    formula, legend = ARM.symbolic.short(steps.merged[:2, 3])
    assert formula == sympy.Matrix([l1 * c1 + l2 * c12, l1 * s1 + l2 * s12])
    assert legend[c12] == sympy.cos(q1 + q2) and legend[s1] == sympy.sin(q1) and len(legend) == 4
    J, _ = ARM.symbolic.short(ARM.symbolic.jacobian("e"))
    assert J[:2, :] == sympy.Matrix(
        [[-l1 * s1 - l2 * s12, -l2 * s12], [l1 * c1 + l2 * c12, l2 * c12]]
    )
    assert list(J[5, :]) == [1, 1]
    det = sympy.trigsimp(ARM.symbolic.jacobian("e")[:2, :].det())
    # singular where the arm is straight or folded
    assert sympy.simplify(det - l1 * l2 * sympy.sin(q2)) == 0


def test_latex_says_both_frames_at_the_left():
    steps = ARM.symbolic.steps("e")
    assert (
        r"{}^{\mathrm{ground}}_{\mathrm{B1}}T" in steps.latex()
        and "{}^{0}_{1}T &=" in steps.latex(numbered=True)
        and steps._repr_latex_().startswith("$")
    )
    assert "B2 in B1: p = (l1, 0, 0)" in str(steps)


@pytest.mark.parametrize(
    "formula, said",
    [
        ("cos(q2 - q1)", "c_{1-2}"),
        ("sin(q1) + sin(q2)", "s1 + s2"),
        ("cos(2*q1)", "cos(2*q1)"),
        ("cos(l1)", "cos(l1)"),
        ("cos(q1 + 1)", "cos(q1 + 1)"),
        ("c1 + cos(q1)", "c1 + cos(q1)"),
    ],
)
def test_short_names(formula, said):
    short, legend = shorten_formula(ARM, sympy.sympify(formula))
    assert str(short) == said
    assert sympy.simplify(short.xreplace(legend) - sympy.sympify(formula)) == 0


def test_names_without_digits_stay_readable():
    m = Mechanism("arm", dim=2)
    m.revolute("shoulder", m.ground, m.body("upper"))
    m.revolute("elbow", "upper", m.body("lower"), at=(0.5, 0))
    m.frame("tip", "lower", at=(0.25, 0))
    system = m.build()
    assert (
        str(system.symbolic.short(system.symbolic.fk("tip")[0, 3]).formula)
        == "0.5*c_shoulder + 0.25*c_shoulder_elbow"
    )


def test_values_in_place_of_symbols():
    J = ARM.symbolic.jacobian("e", symbols={"l1": 2, "l2": 1, "q1": 0})
    q2 = sympy.Symbol("q2")
    assert J[:2, :] == sympy.Matrix(
        [[-sympy.sin(q2), -sympy.sin(q2)], [2 + sympy.cos(q2), sympy.cos(q2)]]
    )
    assert ARM.symbolic.steps("e", symbols={"l1": 2}).p[1][0] == 2


def test_what_has_no_formula_is_said():
    ball = kempe.load("joint_spherical")
    with pytest.raises(UnsupportedError, match="quaternion"):
        ball.symbolic.jacobian(ball.body_names[-1])
    m = Mechanism("particle")
    m.free("J", m.ground, m.particle("P"))
    for ask in (m.build().symbolic.steps, m.build().symbolic.jacobian):
        with pytest.raises(UnsupportedError, match="particle"):
            ask("P")
    with pytest.raises(UnsupportedError, match="particle"):
        m.build().symbolic.fk("P", relative_to="ground")
    for ask in (ARM.symbolic.steps, ARM.symbolic.jacobian):
        with pytest.raises(UnknownNameError, match="nowhere"):
            ask("nowhere")
        with pytest.raises(UnknownNameError, match="l9"):
            ask("e", symbols={"l9": 1})
        with pytest.raises(InputError, match="snap"):
            ask("e", snap=3.0)


@pytest.mark.parametrize("wrong", ["cos(q1)", None, object, [1, "q1"], {"q1": [1, 2]}, {"q1": {}}])
def test_what_is_no_formula_is_refused(wrong):
    with pytest.raises(InputError, match="must be an expression or a matrix of sympy"):
        ARM.symbolic.short(wrong)


@pytest.mark.parametrize(
    "names, said",
    [
        (("q12", "q1", "q2"), "c_q12 + c_q12_q1 + c_q12_q1_q2"),
        (("left1", "right1"), "c_left1 + c_left1_right1"),
        (("q1", "q2"), "c1 + c12"),
        (("q1", "swing"), "c1 + c1_swing"),
        (("a", "b", "a_b"), "c_a + c_a_b + c_a_b_a_b"),
    ],
)
def test_short_names_tell_angles_apart(names, said):
    """Two angles have no short name in common: numbers put into the legend give the formula back."""
    m = Mechanism("arm", dim=2)
    body = m.ground
    for i, name in enumerate(names):
        m.revolute(name, body, m.body(f"B{i}"), at=(0.0 if i == 0 else 1.0, 0))
        body = f"B{i}"
    m.frame("e", body, at=(1.0, 0))
    system = m.build()
    formula = system.symbolic.fk("e")[0, 3]
    short, legend = system.symbolic.short(formula)
    assert str(short) == said and short.xreplace(legend) == formula
    angles = sum(system.symbolic.fk(f"B{i}")[0, 0] for i in range(len(names)))
    more = angles + sum(sympy.sin(sympy.Symbol(name)) for name in names)
    short, legend = system.symbolic.short(more)
    assert short.xreplace(legend) == more and len({a.args[0] for a in legend.values()}) == len(
        {str(c)[1:] for c in legend}
    )


def test_words_are_upright_and_letters_are_not():
    """A name of several letters is one symbol, not their product; Greek ones stay Greek."""
    m = kempe.Mechanism("arm", dim=2)
    m.revolute("shoulder", m.ground, m.body("upper"))
    m.revolute("theta", "upper", m.body("lower"), at=(m.parameter("l1", 0.5), 0))
    m.frame("tip", "lower", at=(m.parameter("reach", 0.4), 0))
    arm = m.build()
    for text in (arm.symbolic.steps("tip").latex(), arm.symbolic.ik("tip").latex()):
        assert (
            r"\mathrm{shoulder}" in text
            and r"\mathrm{reach}" in text
            and r"\theta" in text
            and "l_{1}" in text
        )
        assert (
            r"\mathrm{cos}" not in text
            and r"\mathrm{theta}" not in text
            and r"\mathrm{l}" not in text
        )
    short = arm.symbolic.fk("tip", short=True)._repr_latex_()
    assert r"c_{\mathrm{shoulder} \theta}" in short


@pytest.mark.parametrize("name", ["a%b", "q#", "d$", "R&D"])
def test_latex_of_names_with_signs_that_latex_reads(name):
    m = Mechanism("named", dim=2)
    m.revolute(name, m.ground, m.body("x^2 & " + name))
    m.frame("e", "x^2 & " + name, at=(1, 0))
    system = m.build()
    escaped = name[0] + "\\" + name[1:]
    for text in (
        system.symbolic.steps("e").latex(),
        system.symbolic.fk("e", short=True)._repr_latex_(),
    ):
        assert escaped in text and name not in text and "x^2" not in text
    assert r"\mathrm{x\wedge 2 \& " in system.symbolic.steps("e").latex()


@pytest.mark.slow
def test_the_jacobian_of_four_general_joints_is_not_multiplied_out():
    """That takes five times as long with each joint, a minute for five of them."""
    m = Mechanism("cad")
    rng = np.random.default_rng(0)
    body = m.ground
    for i in range(4):
        child = m.body(f"b{i}")
        m.revolute(
            f"j{i}", body, child, at=rng.normal(size=3).round(3), rpy=rng.normal(size=3).round(4)
        )
        body = child
    m.frame("tool", body, at=(0.1, 0, 0.2))
    system = m.build()
    q = rng.normal(size=4)
    J = system.symbolic.jacobian("tool")
    assert any(
        isinstance(factor, sympy.Add)
        for term in sympy.Add.make_args(J[0, 0])
        for factor in term.args
    )
    values = {sympy.Symbol(n): x for n, x in zip(system.coordinate_names, q, strict=True)}
    np.testing.assert_allclose(
        np.array(J.subs(values), dtype=float), system.jacobian(q, "tool"), atol=1e-12
    )
