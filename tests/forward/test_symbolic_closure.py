"""Equations of closed loops in symbols: zero where loops are closed, and of the rank that
`mobility` finds.
"""

from __future__ import annotations

import numpy as np
import pytest
from hunts import some
from shipped import shipped

import kempe
from kempe.errors import InputError, UnsupportedError
from kempe.model.configurations import has_loops
from kempe.model.packed_loops import find_explicit_joints

sympy = pytest.importorskip("sympy")

LONG = {"delta_ss", "stewart", "stewart_dietmaier", "stewart_sps", "delta_uu"}
MODELS = [n for n in shipped() if n not in LONG and has_loops(shipped()[n])]


def function(system, closure):
    symbols = [sympy.Symbol(n) for n in (*system.structure.parameters, *system.coordinate_names)]
    f = sympy.lambdify(symbols, closure.matrix, "numpy", cse=True)
    return lambda q: np.array(f(*system.structure.parameters.values(), *q), dtype=float).ravel()


@pytest.mark.parametrize(
    "name", some([*MODELS, *(pytest.param(n, marks=pytest.mark.slow) for n in sorted(LONG))], 4)
)
def test_equations_are_zero_where_closed_and_have_the_rank_of_the_loops(name):
    system = kempe.load(name)
    f = function(system, system.symbolic.closure())
    q = system.assemble().q
    h = 1e-6
    np.testing.assert_allclose(f(q), 0.0, atol=1e-9)
    move = system.configuration_space.integrate
    J = np.stack(
        [(f(move(q, h * e)) - f(move(q, -h * e))) / (2 * h) for e in np.eye(system.nv)], axis=1
    )
    cut = [
        system.structure.joints[j]
        for j in system.structure.closures
        if j not in find_explicit_joints(system)
    ]
    absent = sum(j.type.dof(system.dim) for j in cut)  # coordinates of cut joints do not occur
    rank = np.linalg.matrix_rank(J, tol=1e-6)
    assert system.nv - absent - rank == system.mobility(q, local=False).rank_dof


def test_the_four_bar_to_the_letter():
    closure = kempe.load("four_bar").symbolic.closure()
    assert [str(f) for f in closure["C"]] == [
        "a*cos(A) + b*cos(A + B) - c*cos(D) - d",
        "a*sin(A) + b*sin(A + B) - c*sin(D)",
    ]
    assert str(closure).startswith("C: a*cos(A)") and str(closure).endswith(" = 0")
    assert closure.latex().count("&= 0") == 2 and closure._repr_latex_().startswith("$")


def test_rods_slots_and_relations():
    m = kempe.Mechanism("m", dim=2)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("D", m.ground, m.body("rocker"), at=(2, 0))
    m.distance(
        "rod", "crank", "rocker", length=m.parameter("l", 1.8), at=(0.5, 0), child_at=(1.0, 0)
    )
    m.revolute("E", "rocker", m.body("wheel"), at=(1, 0))
    m.couple("E", {"A": 2.0, "D": 1.0}, offset=0.1)
    system = m.build()
    closure = system.symbolic.closure()
    q = system.assemble().q
    np.testing.assert_allclose(function(system, closure)(q), 0.0, atol=1e-9)
    assert (
        list(closure.equations) == ["rod", "E"] and sympy.Symbol("l") in closure["rod"].free_symbols
    )
    slot = kempe.read("two_link")
    slot.point_on_line("rail", slot.ground, "e", axis=(1, 0), at=(0, 0.2))
    assert (
        sympy.simplify(
            slot.build().symbolic.closure()["rail"][0] ** 2
            - (sympy.sympify("l1*sin(q1) + l2*sin(q1 + q2) - 0.2")) ** 2
        )
        == 0
    )


def test_joints_that_are_cut_with_limits_are_led_on():
    m = kempe.read("four_bar")
    from dataclasses import replace

    m.joints["C"] = replace(m.joints["C"], limits={"": (0.0, 1.0)}, cut=True)
    system = m.build()
    closure = system.symbolic.closure()
    assert closure["C"].shape == (3, 1) and sympy.Symbol("C") in closure["C"].free_symbols
    np.testing.assert_allclose(function(system, closure)(system.assemble().q), 0.0, atol=1e-9)


def test_refusals():
    m = kempe.read("two_link")
    m.equation("law", lambda x: x["q1"] - 2 * x["q2"], of=("q1", "q2"))
    with pytest.raises(UnsupportedError, match="'law' is of kind equation"):
        m.build().symbolic.closure()
    with pytest.raises(InputError, match="snap"):
        kempe.load("four_bar").symbolic.closure(snap=9)
    assert kempe.load("two_link").symbolic.closure().equations == {}
