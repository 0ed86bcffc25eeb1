"""Formulas of mechanisms made of dyads: the numbers of the closed form by circles and lines, on
each branch.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hunts import some

import kempe
from kempe.equations.judge import judge_configurations
from kempe.errors import UnsupportedError

sympy = pytest.importorskip("sympy")

CASES = [
    ("four_bar", ["A"]),
    ("four_bar", ["B"]),
    ("slider_crank", ["A"]),
    ("slider_crank", ["S"]),
    ("five_bar", ["A", "D"]),
    ("four_links", ["J1", "J2"]),
    ("ladder", ["X"]),
    ("three_rpr", ["A1", "S1", "A2"]),
    ("three_rpr", ["S1", "S2", "A1"]),
    ("watt_six_bar", ["A"]),
    ("klann", ["P15"]),
    ("stephenson_six_bar", ["C"]),
]


def same(system, q, r):
    """How far configurations are from one another, full turns left out."""
    turning = system.structure.coordinates.turning
    return np.abs(np.where(turning, (q - r + np.pi) % (2 * np.pi) - np.pi, q - r)).max(axis=-1)


@pytest.mark.parametrize(
    ("name", "known"), some(CASES, 4), ids=lambda x: x if isinstance(x, str) else "-".join(x)
)
def test_formulas_are_the_closed_form(name, known, hunt):
    system = kempe.load(name)
    plan = system.loops.closed_form(known)
    formulas = plan.formulas()
    home = system.assemble().q[[system.coordinate_names.index(k) for k in known]]
    values = home + hunt.rng().uniform(-0.5, 0.5, (20, len(known)))
    for branch in plan.branches():
        closed = plan.close(values, branch)
        regular = (
            closed.ok
            & (closed.undetermined == 0)
            & (np.abs(plan.heights(closed.q)) > 1e-3).all(axis=-1)
        )
        found = formulas(values, branch)
        assert same(system, found[regular], closed.q[regular]).max(initial=0.0) < 1e-8
        assert np.isnan(found[~closed.ok]).any(axis=-1).all()


def sixbar(names):
    m = kempe.Mechanism("six-bar", dim=2)
    for body in ("a", "b", "c", "d", "e"):
        m.body(body)
    ends = (
        ("ground", "a", 0.0, 0.0),
        ("a", "b", 0.1, 0.0),
        ("b", "c", 0.4, 0.3),
        ("ground", "c", 0.4, 0.0),
        ("c", "d", 0.2, 0.0),
        ("d", "e", 0.5, 0.15),
        ("ground", "e", 0.8, 0.0),
    )
    for name, (parent, child, at, child_at) in zip(names, ends, strict=True):
        m.revolute(name, parent, child, at=(at, 0), child_at=(child_at, 0))
    return m.build()


@pytest.mark.parametrize(
    "names",
    [
        ("beta_1", "theta_b", "r2_2", "d_x_1", "u_1", "sign_2", "x_c"),
        ("theta_c", "y_b", "c2_1", "alpha_2", "s2_1", "d_y_2", "theta_e"),
    ],
)
def test_names_that_derivations_use_are_left_to_the_system(names):
    """A driver may be called as a step of a dyad: on each branch the loops close, by the printed
    function, too.
    """
    system = sixbar(names)
    values = np.linspace(0.5, 1.5, 5)
    space = {}
    formulas = system.loops.closed_form([names[0]]).formulas()
    symbols = [
        str(s)
        for s in (*formulas.given, *formulas.signs, *(step.symbol for step in formulas.steps))
    ]
    assert len(set(symbols)) == len(symbols)
    exec(formulas.code(), space)
    for branch in itertools.product((-1, 1), repeat=2):
        q = formulas(values[:, None], branch)
        assert np.all(judge_configurations(system, q).holds) and np.allclose(q[:, 0], values)
        found = dict(zip(formulas.coordinates, space["inverse"](values[2], *branch), strict=True))
        assert same(system, system.q(found | {names[0]: values[2]}), q[2]) < 1e-9


def slides(kinds):
    """Two links between a turned ground and a crank, joined by joints of these kinds in a circle."""
    m = kempe.Mechanism(kinds, dim=2)
    m.revolute("O", m.ground, m.body("crank"), at=(0.1, 0.2))
    m.body("one"), m.body("two")
    ends = (("crank", "one"), ("one", "two"), ("two", "ground"))
    sizes = zip(
        "XYZ",
        kinds,
        ends,
        ((1, 0.3), (1, 0.2), (-0.4, 1)),
        (0.7, 1.1, 0.2 if kinds == "RPR" else 0.9),
        strict=True,
    )
    for name, kind, (a, b), axis, at in sizes:
        if kind == "R":
            m.revolute(name, a, b, at=(at, 0.1), child_at=(-0.1, 0.2))
        else:
            m.prismatic(name, a, b, at=(at, 0.1), axis=axis, child_at=(-0.1, 0.2), child_angle=0.4)
    return m.build()


@pytest.mark.parametrize("kinds", ["RRR", "RRP", "RPR", "PRR", "RPP", "PRP", "PPR"])
def test_dyads_of_all_kinds(kinds):
    system = slides(kinds)
    plan = system.loops.closed_form(["O"])
    assert sorted(plan.dyads[0].kind) == sorted(kinds)
    formulas = plan.formulas()
    values = np.linspace(-3, 3, 25)[:, None]
    closed = 0
    for branch in plan.branches():
        q, ok, _ = plan.solve(values, branch)
        assert same(system, formulas(values, branch)[ok], q[ok]).max(initial=0.0) < 1e-8
        closed += ok.sum()
    assert closed > 0


def test_the_four_bar_on_paper():
    """Freudenstein, 1955: with the rocker at D, a cos A + b cos(A + B) = d + c cos D, and the same
    with sines.
    """
    bar = kempe.load("four_bar")
    a, b, c, d = (bar.structure.parameters[k] for k in "abcd")
    formulas = bar.loops.closed_form(["A"]).formulas()
    for sign in "+-":
        A, B, _, D = formulas([1.0], sign)
        assert a * math.cos(A) + b * math.cos(A + B) == pytest.approx(
            d + c * math.cos(D), abs=1e-12
        )
        assert a * math.sin(A) + b * math.sin(A + B) == pytest.approx(c * math.sin(D), abs=1e-12)
    assert (
        "r_{1}^{2} &= d_{x 1}^{2} + d_{y 1}^{2}" in formulas.latex()
        and "def inverse(A, sign_1, a" in formulas.code()
    )
    assert "the law of cosines, if b != 0 and c != 0" in str(formulas)


def test_couplings_are_regarded():
    """The crank follows a motor by a gear of 3 : 1, with an offset; a second output follows the
    rocker.
    """
    m = kempe.read("four_bar")
    m.revolute("motor", m.ground, m.body("rotor"))
    m.couple("A", {"motor": 1 / 3}, offset=0.2)
    system = m.build()
    plan = system.loops.closed_form(["motor"])
    q, ok, _ = plan.solve([[1.5], [2.0]], "+")
    assert ok.all() and same(system, plan.formulas()([[1.5], [2.0]], "+"), q).max() < 1e-9


def test_what_has_no_formulas_is_refused():
    with pytest.raises(UnsupportedError, match="no formulas for"):
        kempe.load("shaky_3r").loops.closed_form(["A"]).formulas()
    with pytest.raises(UnsupportedError, match="dyad at"):
        kempe.load("jansen").loops.closed_form(["W"]).formulas()
    rods = kempe.Mechanism("rod", dim=2)
    rods.revolute("A", rods.ground, rods.body("crank"))
    rods.revolute("D", rods.ground, rods.body("rocker"), at=(2, 0))
    rods.distance("rod", "crank", "rocker", length=1.8, at=(0.5, 0), child_at=(1.0, 0))
    with pytest.raises(UnsupportedError, match="dyad"):
        rods.build().loops.closed_form(["A"]).formulas()
