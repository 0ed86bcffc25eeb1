"""Every constraint of the zoo: derivatives by finite differences on the manifold, counts, and what they mean."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from graphs import KINDS, PLANAR_KINDS, SLIDES, graphs
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import closures

from kempe import Mechanism, System, load, spatial
from kempe.errors import InputError, UnknownNameError
from kempe.joints import joint_type
from kempe.kinematics import loops, zoo
from kempe.kinematics.curves import curve_of, curve_through
from kempe.model.reduced import reduced

STEP = 1e-6


def by_differences(constraint: zoo.SystemConstraint, s: System, q: np.ndarray) -> np.ndarray:
    """Jacobian by central differences along the manifold."""
    steps = STEP * np.eye(s.nv)
    ends = [[constraint.residual(s, s.integrate(q, x * e)) for x in (1, -1)] for e in steps]
    return np.stack([(a - b) / (2 * STEP) for a, b in ends], axis=-1)


def check(constraint: zoo.SystemConstraint, s: System, q: np.ndarray, atol: float = 2e-7) -> None:
    """The battery for one constraint at configurations (n, nq): shapes, one and many, derivatives."""
    r, J = constraint.residual(s, q), constraint.jacobian(s, q)
    assert r.shape == (*q.shape[:-1], constraint.size) and J.shape == (*r.shape, s.nv)
    assert len(constraint.names) == constraint.size and len(set(constraint.names)) == constraint.size
    np.testing.assert_allclose(constraint.residual(s, q[0]), r[0], atol=1e-13)
    np.testing.assert_allclose(constraint.jacobian(s, q[0]), J[0], atol=1e-12)
    np.testing.assert_allclose(J, by_differences(constraint, s, q), atol=atol * (1 + np.abs(J).max(initial=0)))


def tree(dim: int = 3) -> System:
    """Two branches of moving bodies with frames in odd places, a ball joint and a particle in them."""
    m = Mechanism("tree", dim)
    rng = np.random.default_rng(3)

    def at() -> dict:
        p = rng.uniform(-1, 1, 3)
        return {"at": p[:dim], **({"rpy": rng.uniform(-1, 1, 3)} if dim == 3 else {"angle": rng.uniform(-1, 1)})}

    for side in "ab":
        m.revolute(f"{side}1", m.ground, m.body(f"{side}1"), **at())
        m.joint(f"{side}2", "spherical" if dim == 3 else "free", f"{side}1", m.body(f"{side}2"), **at())
        m.frame(f"{side}", f"{side}2", **at())
    m.translation("p", "a1", m.particle("point"), **at())
    return m.build()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("b", ["b", "b2", "point", "ground"])
def test_pairs_of_frames(dim, b):
    s = tree(dim)
    q = s.random(1, 5)
    X = spatial.pose_from_xyz_rpy([0.3, -0.2, 0.1 * (dim - 2), *([0.4, 0.5] if dim == 3 else [0, 0]), 0.6])
    axis = X @ spatial.pose(spatial.align_z([0.6, -0.8, 0.0 if dim == 2 else 0.4]))
    check(zoo.Distance("rod", "a", b, 0.7, X_A=X), s, q)
    check(zoo.PointOnLine("line", "a", b, dim == 2, X_A=axis), s, q)
    if dim == 3:
        check(zoo.PointOnPlane("plane", "a", b, X_A=axis), s, q)
    check(zoo.Distance("rod", "point", b if b != "point" else "a", 0.7), s, q)


def test_what_pairs_measure():
    """Against plain vector algebra."""
    s = tree()
    q = s.random(2)
    A, B = s.fk(q, "a"), s.fk(q, "b")
    d = B[:3, 3] - A[:3, 3]
    assert zoo.Distance("", "a", "b", 0.5).residual(s, q)[0] == pytest.approx(np.linalg.norm(d) - 0.5, abs=1e-14)
    line = zoo.PointOnLine("", "a", "b").residual(s, q)
    assert np.linalg.norm(line) == pytest.approx(np.linalg.norm(np.cross(A[:3, 2], d)), abs=1e-14)
    assert zoo.PointOnPlane("", "a", "b").residual(s, q)[0] == pytest.approx(A[:3, 2] @ d, abs=1e-14)
    s = tree(2)
    q = s.random(2)
    A, B = s.fk(q, "a"), s.fk(q, "b")
    along = A @ spatial.pose(spatial.align_z([0.6, 0.8, 0]))
    row = zoo.PointOnLine("", "a", "b", True, X_A=spatial.pose(spatial.align_z([0.6, 0.8, 0]))).residual(s, q)
    assert row.shape == (1,)
    normal = np.cross([0, 0, 1], along[:3, 2])
    assert abs(row[0]) == pytest.approx(abs(normal @ (B - A)[:3, 3]), abs=1e-14)


# ------------------------------------------------------------------ closures, by joint type


def loop(kind: str, options: dict, dim: int = 3, particle: bool = False, backwards: bool = False) -> System:
    """A loop of a long enough chain, cut at a joint of some type in odd frames."""
    m = Mechanism("loop", dim)
    rng = np.random.default_rng(len(kind) + dim)

    def place(prefix: str = "") -> dict:
        if dim == 2:
            return {prefix + "at": rng.uniform(-1, 1, 2), prefix + "angle": rng.uniform(-1, 1)}
        return {prefix + "at": rng.uniform(-1, 1, 3), prefix + "rpy": rng.uniform(-1, 1, 3)}

    a, b = m.body("a"), m.particle("b") if particle else m.body("b")
    m.joint("Ja", "spherical" if dim == 3 else "revolute", m.ground, a, **place())
    m.joint("Jb", "translation" if particle else "free", m.ground, b, **place())
    ends = (b, a) if backwards else (a, b)
    axis = {"axis": (0.6, -0.8)} if dim == 2 and kind == "prismatic" else {}
    child = {} if ends[1].particle else place("child_")
    m.joint("J", kind, *ends, cut=True, **place(), **child, **axis, **options)
    s = m.build()
    assert s.closures == ("J",)
    return s


def closure_of(s: System, joint: str, own: bool = False) -> zoo.SystemConstraint:
    """The constraint of a joint that closes a loop; one with no rows where it has none."""
    return next((c for c in zoo.of_system(s, own) if c.name == joint and c.names != ("relation",)),
                zoo.Tied(joint, loops.full(s, False), ()))  # fmt: skip


CASES = [(k, o, 3, False) for k, o in KINDS] + [(k, o, 2, False) for k, o in PLANAR_KINDS]
CASES += [(k, o, dim, True) for k, o in SLIDES for dim in (2, 3)]


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(("kind", "options", "dim", "particle"), CASES)
def test_closures(kind, options, dim, particle, backwards, own):
    if backwards and particle:
        return  # nothing can hang on a particle
    s = loop(kind, options, dim, particle, backwards)
    closure = closure_of(s, "J", own)
    type_ = joint_type(kind, **options)  # its constraints: see TABLE in tests/test_joint_zoo.py
    carried = own or reduced(type_, dim, particle) is None
    assert closure.size == type_.constraints(dim, particle) + (type_.dof(dim, particle) if carried else 0)
    check(closure, s, s.random(4, 6))


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(("kind", "options", "dim", "particle"), CASES)
def test_closed_loops_have_no_residual(kind, options, dim, particle, backwards):
    """Body b is put, by its free joint, where the cut joint wants it."""
    if backwards and particle:
        return
    s = loop(kind, options, dim, particle, backwards)
    q = s.random(5)
    joint = s.joints["J"]
    m = Mechanism("open", dim)
    for body in "ab":
        m.bodies[body] = s.mechanism.bodies[body]
    m.joints = {n: s.joints[n] for n in ("Ja", "J")}
    X_b = m.build().fk({n: v for n, v in s.q_dict(q).items() if n.split(".")[0] in ("Ja", "J")}, "b")
    X = spatial.inverse(s.joints["Jb"].X_PF.evaluate({})) @ X_b
    if particle or dim == 2:
        values = {f"Jb.{c}": X[i, 3] for i, c in enumerate("xyz"[:dim])}
        if not particle:
            values["Jb.rz"] = math.atan2(X[1, 0], X[0, 0])
    else:
        values = {f"Jb.{c}": X[i, 3] for i, c in enumerate("xyz")}
        values |= dict(zip(["Jb.qw", "Jb.qx", "Jb.qy", "Jb.qz"], spatial.matrix_to_quat_wxyz(X[:3, :3]), strict=True))
    q = s.q(values, q)
    assert np.abs(s.closure_error(q)).max() < 1e-12, joint
    for own in (False, True):
        closure = closure_of(s, "J", own)
        np.testing.assert_allclose(closure.residual(s, q), 0, atol=1e-12)
        check(closure, s, q[None])
    judge = closures.closure_of(s, "J", own=reduced(joint.type, dim, particle) is None)
    J, K = closure_of(s, "J").jacobian(s, q), judge.jacobian(s, q)
    assert [np.linalg.matrix_rank(M, tol=1e-9) for M in (J, K, np.vstack([J, K]))] == 3 * [len(J)]  # none too many


def test_own_coordinates_of_two_branches():
    """Three angles say a rotation twice, and a turn may be a full one more: the pose is what counts."""
    s = loop("spherical", {"angles": True})
    q = s.random(6)
    closure = closure_of(s, "J", own=True)
    other = s.q({"J.rz": s.q_dict(q)["J.rz"] + math.pi, "J.ry": math.pi - s.q_dict(q)["J.ry"],
                 "J.rx": s.q_dict(q)["J.rx"] - math.pi}, q)  # fmt: skip
    np.testing.assert_allclose(closure.residual(s, q), closure.residual(s, other), atol=1e-13)
    s = loop("revolute", {})
    q = s.random(6)
    closure = closure_of(s, "J", own=True)
    np.testing.assert_allclose(
        closure.residual(s, q), closure.residual(s, s.q({"J": s.q_dict(q)["J"] + 4 * math.pi}, q)), atol=1e-13
    )


def test_coordinates_that_are_not_free_are_tied():
    m = loop("cylindrical", {}).mechanism
    assert closure_of(m.build(), "J").size == 4
    locked = m.copy().lock({"J.z": 0.2}).build()
    assert closure_of(locked, "J").size == 6
    m.gear("J.rz", "Jb.x", 1.5, 0.1)
    geared = m.lock({"J.z": 0.2}).build()
    assert closure_of(geared, "J").names == ("x", "y", "z", "rx", "ry", "rz")
    for s in (locked, geared):
        check(closure_of(s, "J"), s, s.random(7, 4))
    ball = loop("spherical", {}).mechanism
    quat = spatial.unit([1, 2, 3, 4.0])
    ball = ball.lock(dict(zip(["J.qw", "J.qx", "J.qy", "J.qz"], quat.tolist(), strict=True))).build()
    assert closure_of(ball, "J").size == 6
    check(closure_of(ball, "J"), ball, ball.random(7, 4))
    m = loop("universal", {}).mechanism
    m.couple("J.rx", {"Jb.x": 1.0, "J.ry": 2.0})
    related = m.build()
    assert [c.size for c in zoo.of_system(related, own=False)] == [6, 1]


# ------------------------------------------------------------------ couplings


def test_couplings():
    m = loop("cylindrical", {}).mechanism
    m.gear("J.rz", "Jb.x", 1.5, 0.1)
    m.lock({"Jb.y": 0.3})
    s = m.build()
    q = s.random(8, 5)
    coupling = zoo.Coupling("c", "J.rz", {"J.z": -0.5, "Jb.y": 2.0, "Jb.x": 1.0}, 0.7)
    check(coupling, s, q)
    v = s.q_dict(q[0])
    expected = 1.5 * v["Jb.x"] + 0.1 - (-0.5 * v["J.z"] + 2.0 * 0.3 + v["Jb.x"] + 0.7)
    assert coupling.residual(s, q[0]) == pytest.approx([expected], abs=1e-14)
    check(zoo.gear("J.z", "Jb.z", 2.0), s, q)
    np.testing.assert_allclose(zoo.gear("J.rz", "Jb.x", 1.5, 0.1).residual(s, q), 0, atol=1e-15)
    with pytest.raises(UnknownNameError, match="no coordinate 'J.q'"):
        zoo.gear("J.q", "Jb.x", 1.0).residual(s, q)
    with pytest.raises(InputError, match="'Jb.qw' is part of a quaternion"):
        zoo.gear("J.z", "Jb.qw", 1.0).jacobian(s, q)


# ------------------------------------------------------------------ curves


def helix(t):
    return [2 * cmath.cos(t) if isinstance(t, complex) else 2 * math.cos(t), np.sin(2 * t), 0.7 * t]


ROUND = np.linspace(0, 2 * math.pi, 25)
RING = np.stack([1.5 * np.cos(ROUND), 0.8 * np.sin(ROUND), 0.3 * np.sin(2 * ROUND)], axis=1)
CURVES = {
    "closed spline": (curve_through(RING, closed=True), "spline"),
    "open spline": (curve_through(RING[:12]), "spline"),
    "complex": (curve_of(helix, (-3, 3)), "complex step"),
    "real only": (curve_of(lambda t: [2 * math.cos(t), math.sin(2 * t), 0.7 * t], (-3, 3)), "central differences"),
    "supplied": (curve_of(lambda t: [math.cos(t), math.sin(t), 0.0], (0, 2 * math.pi), True,
                          lambda t: [-math.sin(t), math.cos(t), 0.0]), "supplied"),
}  # fmt: skip


@pytest.mark.parametrize("name", CURVES)
def test_points_on_curves(name):
    curve, how = CURVES[name]
    s = tree()
    rough = how == "central differences"
    constraint = zoo.PointOnCurve("c", "a", "b", curve)
    assert constraint.how == how and constraint.size == 2
    check(constraint, s, s.random(9, 8), atol=1e-3 if rough else 1e-6)
    flat = zoo.PointOnCurve("c", "a", "b", curve_through(RING[:, :2], closed=True), planar=True)
    check(flat, tree(2), tree(2).random(9, 8), atol=1e-6)


def test_distance_from_curves():
    """A circle and a straight line have closed forms."""
    rng = np.random.default_rng(0)
    p = rng.normal(size=(300, 3))
    circle = CURVES["supplied"][0]
    value, _ = circle.distances(p)
    expected = np.hypot(np.hypot(p[:, 0], p[:, 1]) - 1, p[:, 2])
    np.testing.assert_allclose(np.linalg.norm(value, axis=1), expected, atol=1e-12)
    line = curve_through([[0, 0, 0], [1, 1, 1], [2, 2, 2], [4, 4, 4.0]])
    value, _ = line.distances(p)  # past its ends, too
    expected = np.linalg.norm(np.cross(p, spatial.unit([1, 1, 1.0])), axis=1)
    np.testing.assert_allclose(np.linalg.norm(value, axis=1), expected, atol=1e-12)
    on = CURVES["closed spline"][0]
    value, rates = on.distances(on.point(np.linspace(*on.span, 50)))
    np.testing.assert_allclose(value, 0, atol=1e-13)
    np.testing.assert_allclose(rates @ np.swapaxes(rates, 1, 2), np.broadcast_to(np.eye(2), (50, 2, 2)), atol=1e-12)


def test_the_nearest_point_is_the_nearest():
    rng = np.random.default_rng(1)
    p = rng.uniform(-2, 2, (200, 3))
    for curve, _ in CURVES.values():
        s = curve.nearest(p)
        found = np.linalg.norm(p - curve.point(s), axis=1)
        fine = curve.point(np.linspace(*curve.span, 20001))
        best = np.sqrt(((p[:, None] - fine) ** 2).sum(-1).min(1))
        assert np.all(found <= best + 1e-9)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: curve_through([[0, 0], [1, 1], [2, 0]]), "3 points; a open|an open|needs 4"),
        (lambda: curve_through([[0, 0], [0, 0], [1, 1], [2, 2]]), "points 0 and 1 are equal"),
        (lambda: curve_through([0, 1, 2]), "must be"),
        (lambda: curve_through([[0, 0], [math.nan, 0], [1, 1], [2, 2]]), "finite"),
        (lambda: curve_of(helix, (1, 0)), "span is"),
        (lambda: curve_of(lambda t: t, (0, 1)), "must be"),
    ],
)
def test_curves_that_are_none(call, said):
    with pytest.raises(InputError, match=said):
        call()


# ------------------------------------------------------------------ users' functions


def analytic(q):
    return [np.sin(q[0]) * q[2] + q[1] ** 2, q[0] * q[1] * q[3]]


def test_users_functions():
    s = tree()
    q = s.random(10, 4)
    found = zoo.user_constraint(s, "mine", analytic)
    assert found.how == "complex step"
    check(found, s, q)
    by_hand = zoo.user_constraint(s, "mine", analytic, lambda x: found.jacobian(s, x))
    assert by_hand.how == "supplied"
    check(by_hand, s, q)
    for function in (
        lambda x: s.fk(x, "a")[:3, 3],  # refuses complex numbers
        lambda x: abs(x[0]) + np.conj(x[1]),  # takes them, but is not analytic
        lambda x: math.sin(x[0]),
        lambda x: np.array([float(np.real(x[1]))]) ** 2,
    ):
        rough = zoo.user_constraint(s, "mine", function)
        assert rough.how == "central differences"
        check(rough, s, q, atol=1e-6)
    assert zoo.user_constraint(s, "one", lambda x: x[0]).size == 1


def test_differences_agree_with_exact_rows():
    s = loop("revolute", {})
    closure = closure_of(s, "J")
    q = s.random(11, 3)
    rough = zoo.user_constraint(s, "closure", lambda x: closure.residual(s, x))
    np.testing.assert_allclose(rough.jacobian(s, q), closure.jacobian(s, q), atol=1e-8)


def test_wrong_jacobians_are_refused():
    s = tree()
    right = zoo.user_constraint(s, "mine", analytic)
    wrong = np.zeros((2, s.nv))
    wrong[1, 2] = 0.5
    name = s.velocity_names[2]
    with pytest.raises(InputError, match=f"'mine': its Jacobian is wrong: the derivative of row 1 by '{name}'"):
        zoo.user_constraint(s, "mine", analytic, lambda x: right.jacobian(s, x) + wrong)
    with pytest.raises(InputError, match=r"shape \(2, 2\); it must have"):
        zoo.user_constraint(s, "mine", analytic, lambda x: np.eye(2))
    with pytest.raises(InputError, match="finite"):
        zoo.user_constraint(s, "mine", lambda x: math.nan)


# ------------------------------------------------------------------ of a system


def test_what_a_system_has():
    m = Mechanism("mixed")
    m.parameter("l", 0.5)
    for name in "ab":
        m.free(f"J{name}", m.ground, m.body(name))
    m.revolute("R", "a", "b", at=(1, 0, 0), cut=True)
    m.distance("rod", m.ground, "a", "2*l", child_at=(0, 1, 0))
    m.point_on_line("line", "a", "b", axis=(1, 1, 0))
    m.point_on_plane("plane", "b", "a", rpy=(0.1, 0.2, 0.3))
    m.couple("R", {"Ja.x": 1.0, "Jb.y": -2.0}, 0.3)
    s = m.build()
    found = zoo.of_system(s)
    assert [(c.name, c.names) for c in found] == [
        ("R", ("x", "y", "z", "rx", "ry", "rz")), ("rod", ("distance",)), ("line", ("x", "y")), ("plane", ("z",)),
        ("R", ("relation",)),
    ]  # fmt: skip
    for constraint in found:
        check(constraint, s, s.random(12, 4))
    assert found[1].residual(s, s.neutral) == pytest.approx([0.0])  # |(0, 1, 0)| = 2 l
    assert load("two_link") and zoo.of_system(load("two_link")) == []


@given(graphs(most=5, loops=3), st.integers(0, 2**32))
@settings(max_examples=25)
def test_random_graphs(graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed, 2)
    for own in (False, True):
        for constraint in zoo.of_system(s, own):
            check(constraint, s, q, atol=1e-5)  # gears and screws make some entries large


@given(graphs(most=4, loops=2), st.integers(0, 2**32))
@settings(max_examples=25)
def test_same_zeros_as_closure_error(graph, seed):
    """With rows for own coordinates the residual vanishes with the closure error, and grows with it."""
    s = graph.mechanism().build()
    q = s.random(seed)
    for k, name in enumerate(s.closures):
        particle = s.mechanism.bodies[s.joints[name].child].particle
        small = closure_of(s, name, own=True).residual(s, q)
        other = closures.closure_of(s, name, own=True).residual(s, q)
        full = s.closure_error(q)[k]
        if np.linalg.norm(full) > 1e-6:
            assert np.linalg.norm(small) > 1e-9 and np.linalg.norm(other) > 1e-9
        assert small.size == (s.dim if particle else 6 if s.dim == 3 else 3)
