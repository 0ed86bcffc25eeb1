"""The constraints of a system by rows: derivatives by finite differences on the manifold, counts,
what they mean.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from graphs import KINDS, PLANAR_KINDS, SLIDES, graphs
from hunts import examples, some
from hypothesis import given, settings
from hypothesis import strategies as st
from linkages import four_bar
from oracles import closures
from oracles.declared import declared

from kempe import Mechanism, System, load, spatial
from kempe import constraints as c
from kempe.equations import closure_rows
from kempe.errors import InputError
from kempe.joints import make_joint_type
from kempe.model.implicit_form import find_implicit_form

STEP = 1e-6


def by_differences(
    constraint: closure_rows.SystemConstraint, s: System, q: np.ndarray
) -> np.ndarray:
    """Jacobian by central differences along the manifold."""
    steps = STEP * np.eye(s.nv)
    ends = [
        [constraint.residual(s, s.configuration_space.integrate(q, x * e)) for x in (1, -1)]
        for e in steps
    ]
    return np.stack([(a - b) / (2 * STEP) for a, b in ends], axis=-1)


def check(
    constraint: closure_rows.SystemConstraint, s: System, q: np.ndarray, atol: float = 2e-7
) -> None:
    """The battery for one constraint at configurations (n, nq): shapes, one and many, derivatives."""
    r = constraint.residual(s, q)
    J = constraint.jacobian(s, q)
    assert r.shape == (*q.shape[:-1], constraint.size) and J.shape == (*r.shape, s.nv)
    assert (
        len(constraint.names) == constraint.size and len(set(constraint.names)) == constraint.size
    )
    np.testing.assert_allclose(constraint.residual(s, q[0]), r[0], atol=1e-13)
    np.testing.assert_allclose(constraint.jacobian(s, q[0]), J[0], atol=1e-12)
    np.testing.assert_allclose(
        J, by_differences(constraint, s, q), atol=atol * (1 + np.abs(J).max(initial=0))
    )


def tree(dim: int = 3) -> Mechanism:
    """Two branches of moving bodies with frames in odd places, a ball joint and a particle in them."""
    m = Mechanism("tree", dim)
    rng = np.random.default_rng(3)

    def at() -> dict:
        p = rng.uniform(-1, 1, 3)
        return {
            "at": p[:dim],
            **({"rpy": rng.uniform(-1, 1, 3)} if dim == 3 else {"angle": rng.uniform(-1, 1)}),
        }

    for side in "ab":
        m.revolute(f"{side}1", m.ground, m.body(f"{side}1"), **at())
        m.joint(
            f"{side}2", "spherical" if dim == 3 else "free", f"{side}1", m.body(f"{side}2"), **at()
        )
        m.frame(f"{side}", f"{side}2", **at())
    m.translation("p", "a1", m.particle("point"), **at())
    return m


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("other", ["b", "b2", "ground"])
def test_pairs_of_frames(dim, other):
    """Against plain vector algebra of the poses, and by differences."""
    m = tree(dim)
    origin = [0.3, -0.2, 0.1][:dim]
    direction = [0.6, -0.8, 0.4][:dim]
    m.constrain(c.Distance("a", other, 0.7, other_point=origin), "rod")
    m.constrain(c.OnLine("a", origin, direction, other=other), "line")
    m.constrain(c.OnPlane("a", origin, direction, other=other), "plane")
    s = m.build()
    q = s.random(1, 5)
    found = {x.name: x for x in s.loops.constraints()}
    for x in found.values():
        check(x, s, q)
    A = s.fk(q, "a")
    B = s.fk(q, other)
    p = np.r_[origin, [0.0] * (3 - dim)]
    d = np.einsum("nji,nj->ni", B[:, :3, :3], A[:, :3, 3] - B[:, :3, 3]) - p
    t = spatial.unit(np.r_[direction, [0.0] * (3 - dim)])
    sizes = {name: np.linalg.norm(found[name].residual(s, q), axis=-1) for name in found}
    np.testing.assert_allclose(sizes["rod"], np.abs(np.linalg.norm(d, axis=1) - 0.7), atol=1e-13)
    np.testing.assert_allclose(sizes["line"], np.linalg.norm(np.cross(d, t), axis=1), atol=1e-13)
    np.testing.assert_allclose(sizes["plane"], np.abs(d @ t), atol=1e-13)
    for name, x in found.items():
        judge = declared(s, s.mechanism.constraints[name])
        J = x.jacobian(s, q)[0]
        K = judge.jacobian(s, q)[0]
        if name != "rod":  # the judge's is signed the other way round
            np.testing.assert_allclose(
                sizes[name], np.linalg.norm(judge.residual(s, q), axis=-1), atol=1e-13
            )
        assert [np.linalg.matrix_rank(M, tol=1e-9) for M in (J, K)] == 2 * [x.size], name


# ------------------------------------------------------------------ closures, by joint type


def loop(
    kind: str, options: dict, dim: int = 3, particle: bool = False, backwards: bool = False
) -> System:
    """A loop of a long enough chain, cut at a joint of some type in odd frames."""
    m = Mechanism("loop", dim)
    rng = np.random.default_rng(len(kind) + dim)

    def place(prefix: str = "") -> dict:
        if dim == 2:
            return {prefix + "at": rng.uniform(-1, 1, 2), prefix + "angle": rng.uniform(-1, 1)}
        return {prefix + "at": rng.uniform(-1, 1, 3), prefix + "rpy": rng.uniform(-1, 1, 3)}

    a = m.body("a")
    b = m.particle("b") if particle else m.body("b")
    m.joint("Ja", "spherical" if dim == 3 else "revolute", m.ground, a, **place())
    m.joint("Jb", "translation" if particle else "free", m.ground, b, **place())
    ends = (b, a) if backwards else (a, b)
    axis = {"axis": (0.6, -0.8)} if dim == 2 and kind == "prismatic" else {}
    child = {} if ends[1].particle else place("child_")
    m.joint("J", kind, *ends, cut=True, **place(), **child, **axis, **options)
    s = m.build()
    assert s.structure.closures == ("J",)
    return s


def closure_of(s: System, joint: str, own: bool = False) -> closure_rows.SystemConstraint:
    """The constraint of a joint that closes a loop; one with no rows where it has none."""
    return next(
        (
            c
            for c in closure_rows.list_constraints(s, own)
            if c.name == joint and c.names != ("relation",)
        ),
        closure_rows.SystemConstraint(joint, closure_rows.pack_full_loops(s, False), ()),
    )


CASES = [(k, o, 3, False) for k, o in KINDS] + [(k, o, 2, False) for k, o in PLANAR_KINDS]
CASES += [(k, o, dim, True) for k, o in SLIDES for dim in (2, 3)]
every_loop = pytest.mark.parametrize(
    ("kind", "options", "dim", "particle", "backwards"),
    [
        (*case, backwards)
        for case in CASES
        for backwards in (False, True)
        if not (case[3] and backwards)
    ],
)
"""Each joint from the first chain to the second, and the other way round, but that nothing hangs on
a particle."""


@pytest.mark.parametrize("own", some([False, True], 3))
@every_loop
def test_closures(kind, options, dim, particle, backwards, own):
    s = loop(kind, options, dim, particle, backwards)
    closure = closure_of(s, "J", own)
    type_ = make_joint_type(
        kind, **options
    )  # its constraints: see TABLE in tests/test_joint_zoo.py
    explicit = own or find_implicit_form(type_, dim, particle) is None
    assert closure.size == type_.constraints(dim, particle) + (
        type_.dof(dim, particle) if explicit else 0
    )
    check(closure, s, s.random(4, 6))


@every_loop
def test_closed_loops_have_no_residual(kind, options, dim, particle, backwards):
    """Body b is put, by its free joint, where the cut joint wants it."""
    s = loop(kind, options, dim, particle, backwards)
    q = s.random(5)
    joint = s.structure.joints["J"]
    m = Mechanism("open", dim)
    for body in "ab":
        m.bodies[body] = s.mechanism.bodies[body]
    m.joints = {n: s.structure.joints[n] for n in ("Ja", "J")}
    X_b = m.build().fk(
        {n: v for n, v in s.q_dict(q).items() if n.split(".")[0] in ("Ja", "J")}, "b"
    )
    X = spatial.inverse(s.structure.joints["Jb"].X_PF.evaluate_pose({})) @ X_b
    if particle or dim == 2:
        values = {f"Jb.{c}": X[i, 3] for i, c in enumerate("xyz"[:dim])}
        if not particle:
            values["Jb.rz"] = math.atan2(X[1, 0], X[0, 0])
    else:
        values = {f"Jb.{c}": X[i, 3] for i, c in enumerate("xyz")}
        values |= dict(
            zip(
                ["Jb.qw", "Jb.qx", "Jb.qy", "Jb.qz"],
                spatial.matrix_to_quat_wxyz(X[:3, :3]),
                strict=True,
            )
        )
    q = s.q(values, q)
    assert np.abs(s.loops.closure_error(q)).max() < 1e-12, joint
    for own in (False, True):
        closure = closure_of(s, "J", own)
        np.testing.assert_allclose(closure.residual(s, q), 0, atol=1e-12)
        check(closure, s, q[None])
    judge = closures.closure_of(s, "J", own=find_implicit_form(joint.type, dim, particle) is None)
    J = closure_of(s, "J").jacobian(s, q)
    K = judge.jacobian(s, q)
    # none too many
    assert [np.linalg.matrix_rank(M, tol=1e-9) for M in (J, K, np.vstack([J, K]))] == 3 * [len(J)]


def test_own_coordinates_of_two_branches():
    """Three angles say a rotation twice, and a turn may be a full one more: the pose is what
    counts.
    """
    s = loop("spherical", {"angles": True})
    q = s.random(6)
    closure = closure_of(s, "J", own=True)
    other = s.q(
        {
            "J.rz": s.q_dict(q)["J.rz"] + math.pi,
            "J.ry": math.pi - s.q_dict(q)["J.ry"],
            "J.rx": s.q_dict(q)["J.rx"] - math.pi,
        },
        q,
    )
    np.testing.assert_allclose(closure.residual(s, q), closure.residual(s, other), atol=1e-13)
    s = loop("revolute", {})
    q = s.random(6)
    closure = closure_of(s, "J", own=True)
    np.testing.assert_allclose(
        closure.residual(s, q),
        closure.residual(s, s.q({"J": s.q_dict(q)["J"] + 4 * math.pi}, q)),
        atol=1e-13,
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
    ball = ball.lock(
        dict(zip(["J.qw", "J.qx", "J.qy", "J.qz"], quat.tolist(), strict=True))
    ).build()
    assert closure_of(ball, "J").size == 6
    check(closure_of(ball, "J"), ball, ball.random(7, 4))
    m = loop("universal", {}).mechanism
    m.couple("J.rx", {"Jb.x": 1.0, "J.ry": 2.0})
    related = m.build()
    assert [c.size for c in closure_rows.list_constraints(related, own=False)] == [6, 1]


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
    found = closure_rows.list_constraints(s)
    assert [(c.name, c.names) for c in found] == [
        ("R", ("x", "y", "z", "rx", "ry", "rz")),
        ("rod", ("distance",)),
        ("line", ("x", "y")),
        ("plane", ("z",)),
        ("R", ("relation",)),
    ]
    for constraint in found:
        check(constraint, s, s.random(12, 4))
    assert found[1].residual(s, s.neutral) == pytest.approx([0.0])  # |(0, 1, 0)| = 2 l
    assert load("two_link") and closure_rows.list_constraints(load("two_link")) == []


@given(graphs(most=5, loops=3), st.integers(0, 2**32))
@settings(max_examples=examples(25))
def test_random_graphs(graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed, 2)
    for own in (False, True):
        for constraint in closure_rows.list_constraints(s, own):
            check(constraint, s, q, atol=1e-5)  # gears and screws make some entries large


@given(graphs(most=4, loops=2), st.integers(0, 2**32))
@settings(max_examples=examples(25))
def test_same_zeros_as_closure_error(graph, seed):
    """With rows for own coordinates the residual vanishes with the closure error, and grows with
    it.
    """
    s = graph.mechanism().build()
    q = s.random(seed)
    for k, name in enumerate(s.structure.closures):
        particle = s.mechanism.bodies[s.structure.joints[name].child].particle
        small = closure_of(s, name, own=True).residual(s, q)
        other = closures.closure_of(s, name, own=True).residual(s, q)
        full = s.loops.closure_error(q)[k]
        if np.linalg.norm(full) > 1e-6:
            assert np.linalg.norm(small) > 1e-9 and np.linalg.norm(other) > 1e-9
        assert small.size == (s.dim if particle else 6 if s.dim == 3 else 3)


@pytest.mark.parametrize("cut", "ABCD")
@pytest.mark.parametrize("at", [(0.0, 0.0), (1000.0, -2000.0)])
def test_the_characteristic_length_is_of_the_links(cut, at):
    """Neither the cut nor where the ground has its origin matters."""
    assert closure_rows.compute_characteristic_length(four_bar(cut=cut, at=at)) == pytest.approx(
        0.4, rel=1e-9
    )


@pytest.mark.parametrize("own", [NotImplemented, 1, "no", None])
def test_whether_own_coordinates_count_is_true_or_false(own):
    with pytest.raises(InputError, match="own is .*; it must be True or False"):
        closure_rows.list_constraints(load("four_bar"), own)
