"""Formulas of the inverse model: those of the lecture's slide, and the numbers of `fk`."""

from __future__ import annotations

import ast

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.errors import InputError, UnsupportedError

sympy = pytest.importorskip("sympy")

ARM = kempe.load("two_link")


def arm(l1, l2, at=(0.0, 0.0), axis=1):
    m = Mechanism("arm")
    m.revolute("a", m.ground, m.body("A"), axis=(0, 0, axis), at=(*at, 0.3))
    m.revolute("b", "A", m.body("B"), axis=(0, 0, axis), at=(m.parameter("first", l1), 0, 0))
    m.frame("tip", "B", (m.parameter("second", l2), 0, 0))
    return m.build()


def test_the_lectures_formulas_to_the_letter():
    """The slide: c2 from squares, s2 = +-sqrt(1 - c2^2), q1 = alpha - beta, q2 = atan2(s2, c2)."""
    found = {str(step.symbol): step.formula for step in ARM.symbolic.ik("e").steps}
    x, y, l1, l2, r2, c2, s2, alpha, beta, sign = sympy.symbols("p_x p_y l1 l2 r2 c2 s2 alpha beta sign")
    assert sympy.simplify(found["c2"].subs(r2, found["r2"]) - (x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2)) == 0
    assert found["s2"] == sign * sympy.sqrt(1 - c2**2)
    assert found["alpha"] == sympy.atan2(y, x) and found["beta"] == sympy.atan2(l2 * s2, l1 + l2 * c2)
    assert found["q1"] == alpha - beta and found["q2"] == sympy.atan2(s2, c2)


@pytest.mark.parametrize("system", [ARM, arm(0.7, 0.4, (0.2, -0.1)), arm(0.7, -0.4)], ids=["lecture", "moved", "back"])
def test_both_solutions_reach_the_target(system):
    frame = system.frame_names[-1] if system is not ARM else "e"
    p = system.fk(np.random.default_rng(1).uniform(-3, 3, (20, 2)), frame)[..., :2, 3]
    formulas = system.symbolic.ik(frame)
    for sign in (-1, 1):
        q = formulas(p, sign)
        assert q.shape == (20, 2) and np.allclose(system.fk(q, frame)[..., :2, 3], p, atol=1e-9)
        assert (np.sign(np.sin(q[:, 1])) == sign).all()


def test_the_signs_are_the_elbows_of_all_solutions():
    p = np.array([0.6, 0.3])
    both, formulas = ARM.ik_all(p, "e"), ARM.symbolic.ik("e")
    for sign, name in ((-1, "elbow-up"), (1, "elbow-down")):
        assert np.allclose(both.q[both.named(name)], [formulas(p, sign)], atol=1e-9)
    assert np.isnan(formulas([2.0, 0.0], 1)).all()


def test_what_is_printed():
    formulas = ARM.symbolic.ik("e")
    assert "s_{2} &= sign \\sqrt{1 - c_{2}^{2}}" in formulas.latex() and formulas.latex() in formulas._repr_latex_()
    code = formulas.code()
    assert "def inverse(p_x, p_y, sign, l1, l2):" in code and "    s2 = sign*numpy.sqrt(1 - c2**2)" in code
    assert code.endswith("    return q1, q2\n")
    assert "if -1 <= c2 <= 1" in str(formulas)


def test_other_chains_are_refused():
    for name, frame in (("puma560", "tool"), ("slider", "B5"), ("four_bar", kempe.load("four_bar").body_names[2])):
        with pytest.raises(UnsupportedError, match="ik_all"):
            kempe.load(name).symbolic.ik(frame)
    with pytest.raises(UnsupportedError, match="about z"):
        arm(0.7, 0.4, axis=-1).symbolic.ik("tip")
    with pytest.raises(InputError, match="sign"):
        ARM.symbolic.ik("e")([0.6, 0.3], 0)
    with pytest.raises(InputError, match="shape"):
        ARM.symbolic.ik("e")([0.6, 0.3, 0.0], 1)
    with pytest.raises(InputError, match="k"):
        ARM.symbolic.ik("e", symbols={"l1": sympy.Symbol("k")})([0.6, 0.3], 1)


@pytest.mark.parametrize("names", [("a.b", "a_b"), ("q 1", "2nd"), ("lambda", "numpy"), ("first", "second")])
def test_code_has_names_of_its_own_for_all_that_it_computes(names):
    m = Mechanism("arm", dim=2)
    m.revolute(names[0], m.ground, m.body("A"))
    m.revolute(names[1], "A", m.body("B"), at=(m.parameter("l1", 0.5), 0))
    m.frame("tip", "B", at=(0.4, 0))
    function = ast.parse(m.build().symbolic.ik("tip").code()).body[-1]
    assert isinstance(function, ast.FunctionDef)
    *lines, last = function.body
    made = [line.targets[0].id for line in lines]
    known = [argument.arg for argument in function.args.args] + made
    assert len(set(known)) == len(known) == 4 + 7 and "numpy" not in known
    assert [x.id for x in last.value.elts] == made[-2:]
    for i, line in enumerate(lines):  # what is computed before, and the arguments
        used = {x.id for x in ast.walk(line.value) if isinstance(x, ast.Name)} - {"numpy"}
        assert used <= {*known[: 4 + i]}
