"""Formulas of arms in space: those of textbooks, and all solutions that `ik_all` has."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hunts import Hunt

import kempe
from kempe import Mechanism
from kempe.errors import InputError, UnsupportedError

sympy = pytest.importorskip("sympy")

PUMA = kempe.load("puma560")


def every(formulas, target):
    """The solutions (k, n) of a target, of all signs, that exist."""
    found = [
        formulas(target, signs) for signs in itertools.product((-1, 1), repeat=len(formulas.signs))
    ]
    return np.array([q for q in found if np.isfinite(q).all()])


def same(a, b, turns):
    """Whether two lists of configurations (k, n) are the same, in any order, but for whole turns."""
    off = a[:, None] - b
    off = np.where(turns, (off + np.pi) % (2.0 * np.pi) - np.pi, off)
    far = np.abs(off).max(axis=-1)
    return len(a) == len(b) and far.min(axis=0).max() < 1e-6 and far.min(axis=1).max() < 1e-6


def arm(rng, kinds, wrist):
    """A first turn about z or -z, joints in a plane beside it, and turns whose axes meet, each
    anywhere.

    After two joints in the plane three turns, after three of them two, the first of which is in the
    plane.
    """
    m = Mechanism("arm")
    n = rng.uniform(-np.pi, np.pi)
    normal = np.array([-np.sin(n), np.cos(n), 0.0])
    out = np.array([np.cos(n), np.sin(n), 0.0])
    m.revolute(
        "q1", m.ground, m.body("b1"), at=rng.uniform(-0.3, 0.3, 3), axis=(0, 0, rng.choice([-1, 1]))
    )
    for i, kind in enumerate(kinds, 2):
        at = [m.parameter(f"l{i}", float(rng.uniform(0.2, 0.5))), *rng.uniform(-0.3, 0.3, 2)]
        if kind == "R":
            m.revolute(
                f"q{i}", f"b{i - 1}", m.body(f"b{i}"), at=at, axis=rng.choice([-1, 1]) * normal
            )
        else:
            c = np.cos(x := rng.uniform(-np.pi, np.pi))
            s = np.sin(x)
            m.prismatic(
                f"q{i}",
                f"b{i - 1}",
                m.body(f"b{i}"),
                at=at,
                axis=c * out + s * np.array([0.0, 0.0, 1.0]),
            )
    hand = rng.uniform(-0.3, 0.3, 3)
    k = len(kinds) + 2
    if not wrist:
        m.frame("tip", "b3", at=hand)
        return m.build()
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if k == 5:
        a = rng.uniform(-np.pi, np.pi)
        Q = np.linalg.qr(np.column_stack([np.cos(a) * out + [0, 0, np.sin(a)], Q[:, :2]]))[0]
    bend = rng.uniform(-np.pi, np.pi) if rng.random() < 0.5 else 0.0
    axes = [Q[:, 0], Q[:, 1], np.cos(bend) * Q[:, 0] + np.sin(bend) * Q[:, 2]][: 7 - k]
    # joints stand anywhere on their axes
    shift = np.array([rng.uniform(-0.2, 0.2) * a for a in axes])
    before = np.zeros(3)
    for i, (a, s) in enumerate(zip(axes, shift, strict=True), k):
        m.revolute(
            f"q{i}", f"b{i - 1}", m.body(f"b{i}"), at=(hand if i == k else 0.0) + s - before, axis=a
        )
        before = s
    m.frame("tip", "b6", at=rng.uniform(-0.2, 0.2, 3), rpy=rng.uniform(-3, 3, 3))
    return m.build()


KINDS = ["RR", "RP", "PR", "PP"]
IN_PLANE = ["RRR", "RPR", "PRR", "RRP", "PPR", "RPP", "PRP"]


@pytest.mark.parametrize("wrist", [False, True], ids=["position", "pose"])
@pytest.mark.parametrize("kinds", KINDS)
def test_formulas_of_arms_in_space_are_all_solutions(kinds, wrist, hunt: Hunt):
    """Of arms drawn at random each sign leads to the target, and together they are what `ik_all`
    finds.
    """
    for _ in range(hunt.cases(2)):
        compared(arm(hunt.rng(), kinds, wrist), kinds, wrist, hunt.rng())


@pytest.mark.slow
@pytest.mark.parametrize("kinds", IN_PLANE)
def test_formulas_of_arms_with_three_joints_in_a_plane_are_all_solutions(kinds, hunt: Hunt):
    """Such as those of Universal Robots, whose axes 2, 3 and 4 are parallel: as above."""
    for _ in range(hunt.cases(2)):
        compared(arm(hunt.rng(), kinds, True), kinds, True, hunt.rng())


def compared(system, kinds, wrist, rng):
    task = "pose" if wrist else "position"
    turns = np.array([k != "P" for k in "R" + kinds])
    turns = np.append(turns, np.ones(system.nq - len(turns), dtype=bool))
    formulas = system.inverse.plan("tip", task).formulas()
    X = system.fk(rng.uniform(-2.0, 2.0, (6, len(turns))), "tip")
    target = X if wrist else X[:, :3, 3]
    found = system.ik_all(X, "tip", task=task)
    assert found.success.all() and formulas.coordinates == system.joint_names
    for i in range(6):
        got = every(formulas, target[i])
        Y = system.fk(got, "tip")
        np.testing.assert_allclose(
            *((Y, X[i] + 0 * Y) if wrist else (Y[:, :3, 3], X[i, :3, 3] + 0 * Y[:, :3, 3])),
            atol=1e-8,
        )
        assert same(got, found.q[i, found.mask[i]], turns)


def test_the_formulas_of_a_puma_are_those_of_the_textbook():
    """Craig (2005), section 4.7: the root of the first angle, and K, which gives the third."""
    formulas = PUMA.inverse.plan("tool").formulas()
    assert [str(s) for s in formulas.signs] == ["shoulder", "elbow", "wrist"]
    found = {str(step.symbol): step.formula for step in formulas.steps}
    x, y, z, a2, a3, d3, d4, rho, r2, c2 = sympy.symbols("p_x p_y p_z a2 a3 d3 d4 rho r2 c2")
    shoulder = sympy.Symbol("shoulder")
    assert sympy.expand(found["rho"] ** 2 - shoulder**2 * (x**2 + y**2 - d3**2)) == 0
    K = (x**2 + y**2 + z**2 - a2**2 - a3**2 - d3**2 - d4**2) / (2 * a2)
    ours = found["c2"].subs(r2, found["r2"]).subs(rho**2, x**2 + y**2 - d3**2) * sympy.sqrt(
        a3**2 + d4**2
    )
    assert sympy.simplify(ours - K) == 0
    assert "\\pm_{1}" in formulas.latex() and "\\pm_{3}" in formulas.latex()


@pytest.mark.parametrize("system", [PUMA, kempe.load("ur5")], ids=lambda system: system.name)
def test_signs_have_the_names_of_all_solutions(system):
    """The wrist's sign is that of `no flip` and `flip`; both shoulders and both elbows are
    distinguished by theirs.
    """
    rng = np.random.default_rng(5)
    formulas = system.symbolic.ik("tool")
    X = system.fk(rng.uniform(-3.0, 3.0, (10, 6)), "tool")
    for target in X:
        both = system.ik_all(target, "tool")
        answers = {signs: formulas(target, signs) for signs in itertools.product((-1, 1), repeat=3)}
        off = {
            signs: np.abs(np.sin(0.5 * (both.q - q))).max(axis=1)
            for signs, q in answers.items()
            if np.isfinite(q).all()
        }
        assert all(x.min() < 1e-7 for x in off.values())
        words = {signs: both.names[int(np.argmin(x))] for signs, x in off.items()}
        assert len(words) == len(both)
        assert all(("no flip" in name) == (signs[2] == 1) for signs, name in words.items())
        for place, word in ((0, "shoulder left"), (2, "no flip")):
            assert (
                len({(word in name) == (signs[place] == 1) for signs, name in words.items()}) == 1
            )


def test_the_printed_function_computes_the_same():
    formulas = kempe.load("stanford").symbolic.ik("tool")
    names = {}
    exec(formulas.code(), names)
    system = formulas.system
    X = system.fk([0.3, 0.7, 0.5, 0.2, 0.9, -0.4], "tool")
    sizes = [system.structure.parameters[str(s)] for s in sorted(formulas._find_lengths(), key=str)]
    for signs in itertools.product((-1, 1), repeat=3):
        q = names["inverse"](*X[:3, 3], *X[:3, :3].ravel(), *signs, *sizes)
        np.testing.assert_allclose(q, formulas(X, signs), atol=1e-12)
    far = PUMA.fk(PUMA.neutral, "tool") + np.pad([[9.0]], ((0, 3), (3, 0)))
    assert np.isnan(PUMA.symbolic.ik("tool")(far)).all()


def test_what_is_refused():
    for name, frame in (("gen3_lite", "tool"), ("xarm6", "tool"), ("hc10", "tool0")):
        with pytest.raises(
            UnsupportedError, match="a wrist of three axes at right angles that meet"
        ):
            kempe.load(name).symbolic.ik(frame)
    with pytest.raises(UnsupportedError, match="ik_all"):
        PUMA.symbolic.ik("tool", "position")
    formulas = PUMA.symbolic.ik("tool")
    X = PUMA.fk(PUMA.neutral, "tool")
    for sign in (0, 2, (1, 1), (1, 1, 0), "up", None, 1.5):
        with pytest.raises(InputError, match="sign is"):
            formulas(X, sign)
    with pytest.raises(InputError, match=r"p has shape \(3,\)"):
        formulas(X[:3, 3])


def test_rounded_angles_of_a_file_are_taken_as_right_angles_with_snap():
    m = Mechanism("rounded")
    m.revolute("q1", m.ground, m.body("b1"), axis="z")
    m.revolute("q2", "b1", m.body("b2"), at=(0, 0, 0.4), rpy=(1.5708, 0, 0), axis="z")
    m.revolute("q3", "b2", m.body("b3"), at=(0.5, 0, 0), axis="z")
    m.frame("tip", "b3", at=(0.4, 0, 0))
    system = m.build()
    with pytest.raises(UnsupportedError, match="formulas for 'tip' need"):
        system.symbolic.ik("tip")
    formulas = system.symbolic.ik("tip", snap=1e-4)
    p = system.fk([0.3, 0.5, 0.7], "tip")[:3, 3]
    assert np.abs(system.fk(every(formulas, p), "tip")[:, :3, 3] - p).max() < 1e-5
    assert "p_z - 0.4" in str(formulas)
