"""Formulas of the inverse model: those of the lecture's slide, and the numbers of `fk`."""

from __future__ import annotations

import ast
import itertools
from itertools import pairwise

import numpy as np
import pytest
from hunts import some

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
    x, y, l1, l2, r2, c2, s2, alpha, beta, sign = sympy.symbols(
        "p_x p_y l1 l2 r2 c2 s2 alpha beta sign"
    )
    assert (
        sympy.simplify(
            found["c2"].subs(r2, found["r2"]) - (x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2)
        )
        == 0
    )
    assert found["s2"] == sign * sympy.sqrt(1 - c2**2)
    assert found["alpha"] == sympy.atan2(y, x) and found["beta"] == sympy.atan2(
        l2 * s2, l1 + l2 * c2
    )
    assert found["q1"] == alpha - beta and found["q2"] == sympy.atan2(s2, c2)


@pytest.mark.parametrize(
    "system", [ARM, arm(0.7, 0.4, (0.2, -0.1)), arm(0.7, -0.4)], ids=["lecture", "moved", "back"]
)
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
    both = ARM.ik_all(p, "e")
    formulas = ARM.symbolic.ik("e")
    for sign, name in ((-1, "elbow-up"), (1, "elbow-down")):
        assert np.allclose(both.q[both.find_branch(name)], [formulas(p, sign)], atol=1e-9)
    assert np.isnan(formulas([2.0, 0.0], 1)).all()


def test_what_is_printed():
    formulas = ARM.symbolic.ik("e")
    assert (
        "s_{2} &= \\pm \\sqrt{1 - c_{2}^{2}}" in formulas.latex()
        and formulas.latex() in formulas._repr_latex_()
        and "r^{2} &= p_{x}^{2} + p_{y}^{2}" in formulas.latex()
        and r"\operatorname{atan2}{\left(s_{2},c_{2}" in formulas.latex()
    )
    code = formulas.code()
    assert (
        "def inverse(p_x, p_y, sign, l1, l2):" in code
        and "    s2 = sign*numpy.sqrt(1 - c2**2)" in code
    )
    assert code.endswith("    return q1, q2\n")
    assert "if -1 <= c2 <= 1" in str(formulas)


def test_other_chains_are_refused():
    for name, frame in (
        ("xarm6", "tool"),
        ("slider", "B5"),
        ("four_bar", kempe.load("four_bar").body_names[2]),
    ):
        with pytest.raises(UnsupportedError, match="ik_all"):
            kempe.load(name).symbolic.ik(frame)
    with pytest.raises(UnsupportedError, match="two joints to a position"):
        ARM.symbolic.ik("e", "pose")
    with pytest.raises(UnsupportedError, match="held"):
        kempe.load("panda").inverse.plan("panda_hand_tcp").formulas()
    with pytest.raises(UnsupportedError, match="one axis"):
        arm(0.0, 0.4).symbolic.ik("tip", symbols={"first": 0})
    with pytest.raises(InputError, match="sign"):
        ARM.symbolic.ik("e")([0.6, 0.3], 0)
    with pytest.raises(InputError, match="shape"):
        ARM.symbolic.ik("e")([0.6, 0.3, 0.0], 1)
    with pytest.raises(InputError, match="k"):
        ARM.symbolic.ik("e", symbols={"l1": sympy.Symbol("k")})([0.6, 0.3], 1)


@pytest.mark.parametrize(
    "names", [("a.b", "a_b"), ("q 1", "2nd"), ("lambda", "numpy"), ("first", "second")]
)
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


@pytest.mark.parametrize(
    "names",
    [("r2", "s2", "c2"), ("alpha", "sign", "phi"), ("p_x", "w_x_0", "u"), ("beta", "x", "beta_0")],
)
def test_names_that_derivations_use_are_left_to_the_system(names):
    """The symbols of the steps get an ending; the formulas reach the pose by `fk`, also as the
    printed function.
    """
    m = Mechanism("arm", dim=2)
    bodies = ["ground", "A", "B", "C"]
    for k, name in enumerate(names):
        m.revolute(name, bodies[k], m.body(bodies[k + 1]), at=(0.0 if k == 0 else 0.5, 0))
    m.frame("tip", "C", at=(0.2, 0))
    system = m.build()
    space = {}
    formulas = system.symbolic.ik("tip")
    exec(formulas.code(), space)
    for sign in (-1, 1):
        q = formulas([0.5, 0.4, 0.3], sign)
        X = system.fk(q, "tip")
        assert np.allclose([*X[:2, 3], np.arctan2(X[1, 0], X[0, 0])], [0.5, 0.4, 0.3])
        assert np.allclose(space["inverse"](0.5, 0.4, 0.3, sign), q)


def test_conditions_are_those_that_may_fail():
    """Lengths that are numbers other than zero are none; parameters are."""
    m = Mechanism("arm", dim=2)
    m.revolute("q1", m.ground, m.body("A"))
    m.revolute("q2", "A", m.body("B"), at=(0.5, 0))
    m.frame("tip", "B", at=(m.parameter("b", 0.4), 0))
    said = {str(step.symbol): step.condition for step in m.build().symbolic.ik("tip").steps}
    assert said["c2"] == "b != 0" and said["s2"] == "-1 <= c2 <= 1" and said["alpha"] == "r2 != 0"
    found = {str(step.symbol): step.condition for step in ARM.symbolic.ik("e").steps}
    assert found["c2"] == "l1 != 0 and l2 != 0"


# ---- all planar chains of two and three joints


def chain(kinds, rng, dim):
    """Joints at offset places, turned bases, axes along z and -z, slides in any direction."""
    m = Mechanism("chain", dim=dim)
    here = m.ground
    for i, kind in enumerate(kinds):
        length = m.parameter(f"l{i}", float(rng.uniform(0.2, 1.0)))
        at = (length, float(rng.uniform(-0.5, 0.5)), *([0.3] if dim == 3 else []))
        body = m.body(f"b{i}")
        across = [0.0] if dim == 3 else []
        if kind == "P":
            m.prismatic(f"q{i}", here, body, at=at, axis=(*rng.uniform(-1, 1, 2), *across))
        elif dim == 3:
            m.revolute(f"q{i}", here, body, at=at, axis=(0, 0, -1) if i == 0 else "z")
        else:
            m.revolute(f"q{i}", here, body, at=at, angle=0.3)
        here = f"b{i}"
    m.frame("tip", here, at=("l0", 0.1, *across), **({"angle": 0.2} if dim == 2 else {}))
    return m.build()


KINDS = [k for n in (2, 3) for k in map("".join, itertools.product("RP", repeat=n)) if k != "PPP"]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kinds", some(KINDS, 4))
def test_formulas_of_any_planar_chain_reach_the_target_and_miss_no_solution(kinds, dim, hunt):
    rng = hunt.rng()
    system = chain(kinds, rng, dim)
    n = len(kinds)
    turns = np.array(list(kinds)) == "R"
    q = rng.uniform(-2, 2, (20, n))
    X = system.fk(q, "tip")
    target = (
        X[:, :2, 3]
        if n == 2
        else np.column_stack([X[:, :2, 3], np.arctan2(X[:, 1, 0], X[:, 0, 0])])
    )
    formulas = system.inverse.plan("tip", "position" if n == 2 else "pose").formulas()
    assert len(formulas.signs) == (kinds.count("R") > n - 2 or kinds == "RP")
    off = []
    for sign in (-1, 1):
        found = formulas(target, sign)
        Y = system.fk(found, "tip")
        np.testing.assert_allclose(*((Y, X) if n == 3 else (Y[:, :2, 3], X[:, :2, 3])), atol=1e-9)
        off.append(np.where(turns, (found - q + np.pi) % (2 * np.pi) - np.pi, found - q))
    assert np.abs(off).max(axis=-1).min(axis=0).max() < 1e-6


@pytest.mark.parametrize("kinds", ["RR", "PRR", "RPR"])
def test_code_computes_what_the_formulas_say(kinds):
    system = chain(kinds, np.random.default_rng(4), 2)
    formulas = system.symbolic.ik("tip")
    names: dict = {}
    exec(formulas.code(), names)
    X = system.fk([0.3, 0.4, 0.5][: len(kinds)], "tip")
    p = [*X[:2, 3], np.arctan2(X[1, 0], X[0, 0])][: len(kinds)]
    lengths = [
        system.structure.parameters[str(s)] for s in sorted(formulas._find_lengths(), key=str)
    ]
    np.testing.assert_allclose(names["inverse"](*p, 1, *lengths), formulas(p, 1), atol=1e-12)
    assert np.isfinite(formulas(p, 1)).all()


# ---- the same with a slide along z: SCARAs, cylindrical and cartesian arms


def lifted(kinds, rng):
    """A chain of `chain` in which an L is a slide along z or -z; its tip looks up or down."""
    m = Mechanism("lifted")
    here = "ground"
    for i, kind in enumerate(kinds):
        length = m.parameter(f"l{i}", float(rng.uniform(0.2, 1.0)))
        options = {"at": (length, *rng.uniform(-0.5, 0.5, 2)), "axis": str(rng.choice(["z", "-z"]))}
        if kind == "P":
            options["axis"] = (*rng.uniform(-1, 1, 2), 0.0)
        (m.revolute if kind == "R" else m.prismatic)(f"q{i}", here, m.body(f"b{i}"), **options)
        here = f"b{i}"
    m.frame("tip", here, at=("l0", 0.1, 0.2), rpy=(rng.choice([0.0, np.pi]), 0, 0.4))
    return m.build()


LIFTED = ["RRRL", "RRLR", "RLRR", "LRRR", "RRL", "LRP", "RLP", "PLR", "LPP", "RPLR", "PRRL", "LPPR"]


@pytest.mark.parametrize("kinds", some(LIFTED, 5))
def test_formulas_with_a_slide_along_z_are_all_solutions(kinds, hunt):
    """Each reaches the target, and those of `ik_all` are the same: of SCARAs, with the same names."""
    rng = hunt.rng()
    system = lifted(kinds, rng)
    n = len(kinds)
    task = "position" if len(kinds) == 3 else "pose"
    X = system.fk(rng.uniform(-2, 2, (20, n)), "tip")
    angle = np.arctan2(X[:, 1, 0], X[:, 0, 0])
    target = X[:, :3, 3] if n == 3 else np.column_stack([X[:, :3, 3], angle])
    formulas = system.inverse.plan("tip", task).formulas()
    assert formulas.coordinates == system.joint_names and "from the height" in str(formulas)
    both = [formulas(target, sign) for sign in (-1, 1)]
    turns = np.array(list(kinds)) == "R"
    for q in both:
        Y = system.fk(q, "tip")
        np.testing.assert_allclose(*((Y, X) if n == 4 else (Y[:, :3, 3], X[:, :3, 3])), atol=1e-9)
    found = system.ik_all(X, "tip", task=task)
    assert found.success.all() and (found.mask.sum(axis=1) == len(formulas.signs) + 1).all()
    for i, mask in enumerate(found.mask):
        for q, name in zip(found.q[i, mask], found.names[i, mask], strict=True):
            off = [
                np.where(turns, (x[i] - q + np.pi) % (2 * np.pi) - np.pi, x[i] - q) for x in both
            ]
            off = np.abs(off).max(axis=1)
            assert off.min() < 1e-6
            assert not name or name == ("elbow-up" if off[0] < off[1] else "elbow-down")


@pytest.mark.parametrize("axis", [1, -1])
def test_elbow_up_is_what_all_solutions_call_so(axis):
    """Seen from where the axes point to, which is from below if that is down."""
    system = arm(0.7, 0.4, axis=axis)
    p = system.fk([0.4, 0.8], "tip")[:3, 3]
    found = system.ik_all(p, "tip")
    formulas = system.symbolic.ik("tip")
    for sign, name in ((-1, "elbow-up"), (1, "elbow-down")):
        np.testing.assert_allclose(
            found.q[found.find_branch(name)], [formulas(p[:2], sign)], atol=1e-9
        )


def test_the_formulas_of_a_shipped_scara():
    """Craig's steps, and the printed function."""
    scara = kempe.load("cobra600")
    formulas = scara.inverse.plan("tool").formulas()
    names = {}
    said = {str(step.symbol): str(step.formula) for step in formulas.steps}
    assert said["r2"] == "p_x**2 + p_y**2" and said["q3"] == "d1 - p_z" and "w_x" not in said
    assert "q_{3} &= d_{1} - p_{z}" in formulas.latex()
    exec(formulas.code(), names)
    q = scara.ik_all(
        scara.fk([0.5, 0.9, 0.1, -0.3], "tool"), "tool", start=[0.5, 0.9, 0.1, -0.3]
    ).q[0]
    X = scara.fk(q, "tool")
    sizes = scara.structure.parameters
    p = [*X[:3, 3], np.arctan2(X[1, 0], X[0, 0])]
    np.testing.assert_allclose(
        names["inverse"](*p, 1, *(sizes[x] for x in ("a1", "a2", "d1"))), q, atol=1e-9
    )
    np.testing.assert_allclose(formulas(p, 1), q, atol=1e-9)
    with pytest.raises(InputError, match="shape"):
        formulas([0.1, 0.2, 0.3], 1)


def test_what_is_printed_of_numbers_can_be_read():
    """Six digits of each, while the formulas and the function keep all; slides at right angles
    divide by nothing.
    """
    m = Mechanism("arm", dim=2)
    m.revolute("q1", m.ground, m.body("A"))
    m.revolute("q2", "A", m.body("B"), at=(0.3, 0))
    m.frame("tip", "B", at=(0.25, 0))
    system = m.build()
    formulas = system.symbolic.ik("tip")
    both = system.ik_all([0.4, 0.2], "tip")
    assert (
        "c2 = 6.66667*r2 - 1.01667" in str(formulas)
        and "6.66667 r^{2} - 1.01667" in formulas.latex()
    )
    assert "6.6666666666666" in formulas.code()
    np.testing.assert_allclose(
        [formulas([0.4, 0.2], 1)], both.q[both.find_branch("elbow-down")], atol=1e-12
    )
    t = Mechanism("table", dim=2)
    t.prismatic("x", t.ground, t.body("A"), axis=(1, 0))
    t.prismatic("y", "A", t.body("B"), axis=(0, -1))
    t.frame("tip", "B", at=(0.5, 0))
    assert [str(step.formula) for step in t.build().symbolic.ik("tip").steps] == [
        "p_x - 0.5",
        "-p_y",
    ]


def test_formulas_take_poses():
    """Of a planar arm with three joints, and of a SCARA, whose pose has as many rows as its targets
    have numbers.
    """
    arm = kempe.Mechanism("arm", dim=2)
    for k, (parent, body) in enumerate(pairwise((arm.ground, "a", "b", "c"))):
        arm.revolute(f"q{k}", parent, arm.body(body), at=(0.5 * (k > 0), 0))
    arm.frame("tip", "c", at=(0.2, 0))
    rows = [
        {"a": 0.3, "d": 0.4},
        {"a": 0.25, "alpha": np.pi},
        {"type": "prismatic"},
        {"type": "revolute"},
    ]
    for system, frame, q in (
        (arm.build(), "tip", [0.3, 0.8, -0.4]),
        (kempe.from_dh(rows).build(), "tool", [0.4, 0.8, 0.1, 0.3]),
    ):
        formulas = system.symbolic.ik(frame)
        X = system.fk(q, frame)
        assert np.allclose(formulas(X, +1), q)
        assert np.allclose(formulas(np.stack([X, X]), +1), [q, q])
