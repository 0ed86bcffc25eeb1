"""Maximal coordinates: counts, derivatives, the way to joint coordinates and back, projection, what
is refused.
"""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import closed_graphs
import numpy as np
import pytest
from graphs import Graph, graphs
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.maximal import maximal_integrate, maximal_jacobian, maximal_residual
from oracles.maximal_form import maximal_velocity_names
from own_joints import OWN
from robots import good_urdf_files

from kempe import Mechanism, System, convert, load, spatial
from kempe.assemble.from_poses import from_maximal
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.equations import closure_rows
from kempe.equations.judge import compute_coordinate_value, compute_joint_pose
from kempe.errors import InputError
from kempe.first_order.counting import count_freedoms
from kempe.forward.maximal import maximal_q, to_maximal
from kempe.joints import Free, Revolute, Spherical
from kempe.poses import make_placement_from_pose


def closed(graph: Graph, seed: int) -> tuple[System, np.ndarray]:
    """The graph with the joints that close loops placed so that a random configuration is closed."""
    s = graph.mechanism().build()
    q = s.random(seed)
    m = s.mechanism
    for name in s.structure.closures:
        joint = m.joints[name]
        names = s.structure.coordinates_of_joint(name)
        own = np.array([compute_coordinate_value(s, q, n) for n in names])
        X_FM = compute_joint_pose(joint.type, own, s.dim, m.bodies[joint.child].particle)
        X_WM = s.fk(q, joint.child) @ joint.X_CM.evaluate_pose({})
        X_PF = spatial.inverse(s.fk(q, joint.parent)) @ X_WM @ spatial.inverse(X_FM)
        if m.bodies[joint.child].particle:  # its rotation is none: keep that of F
            F = joint.X_PF.evaluate_pose({})
            X_WF = s.fk(q, joint.parent) @ F
            shift = X_WM[:3, 3] - (X_WF @ X_FM)[:3, 3]
            X_PF = np.array(F)
            X_PF[:3, 3] += s.fk(q, joint.parent)[:3, :3].T @ shift
        m.joints[name] = replace(joint, X_PF=make_placement_from_pose(X_PF))
    out = m.build()
    assert (
        out.structure.closures == s.structure.closures
        and np.abs(out.loops.closure_error(q)).max(initial=0.0) < 1e-8
    )
    return out, q


def chain() -> System:
    """One joint of each type in a row, with a particle at the end and couplings of all sorts."""
    m = Mechanism("chain")
    here = m.ground
    rng = np.random.default_rng(0)
    kinds = [
        ("revolute", {}),
        ("prismatic", {}),
        ("helical", {"pitch": 0.2}),
        ("cylindrical", {}),
        ("universal", {}),
        ("planar", {}),
        ("translation", {}),
        ("spherical", {}),
        ("spherical", {"angles": True}),
        ("fixed", {}),
        ("free", {}),
        ("free", {"angles": True}),
    ]
    for i, (kind, options) in enumerate(kinds):
        body = m.body(f"b{i}")
        m.joint(
            f"J{i}",
            kind,
            here,
            body,
            at=rng.uniform(-1, 1, 3),
            rpy=rng.uniform(-1, 1, 3),
            child_at=rng.uniform(-1, 1, 3),
            child_rpy=rng.uniform(-1, 1, 3),
            **options,
        )
        here = body
    m.planar("Jp", here, m.particle("p"), at=(1, 2, 3))
    return m.build()


# ------------------------------------------------------------------ counts


def test_it_is_the_same_bodies_on_free_joints():
    s = chain()
    other = convert.maximal(s)
    assert (
        other is convert.maximal(s)
        and other.body_names == s.body_names
        and set(other.parent) == {0}
    )
    assert other.structure.closures == s.joint_names
    assert other.coordinate_names[-s.nq :] == s.coordinate_names
    assert other.nv == 6 * 12 + 3 + s.nv and other.coordinate_names[84:87] == ("p.x", "p.y", "p.z")
    found = other.mobility().counting
    assert (found.free, found.taken, found.gruebler) == (75, 75 - s.nv, s.nv)
    again = pickle.loads(pickle.dumps(other))
    assert again == other and read_toml(write_toml(other.mechanism)).build() == other


@pytest.mark.parametrize(
    ("name", "numbers", "constraints"), [("four_links", 12, 10), ("seven_bodies", 42, 35)]
)
def test_lecture_count(name, numbers, constraints):
    """Four bodies in the plane, four revolute joints and a slider: 12 - 10 = 2; seven in space: 42
    - 35 = 7.
    """
    found = convert.maximal(load(name)).mobility().counting
    assert (found.free, found.taken) == (numbers, constraints)


@given(graphs(most=6, loops=3))
def test_count_of_graphs(graph):
    """Bodies times 6 (3) less what joints and couplings take away, as of the system itself."""
    s = graph.mechanism().build()
    taken = [
        j.type.constraints(s.dim, s.mechanism.bodies[j.child].particle)
        for j in s.structure.joints.values()
    ]
    particles, full, few = len(graph.particles), *((6, 3) if s.dim == 3 else (3, 2))
    found = count_freedoms(convert.maximal(s))
    own = count_freedoms(s)
    assert (
        found.taken
        == own.taken
        == sum(taken) + len(s.structure.couplings) + len(s.structure.relations)
    )
    assert found.free == own.free == full * (len(s.parent) - particles) + few * particles


def test_names_are_taken():
    m = Mechanism("names", 2)
    for name in ("a", "b"):
        m.body(name)
    m.revolute("a", m.ground, "b")
    m.revolute("a_2", "b", "a", at=(1, 0))
    s = m.build()
    assert convert.maximal(s).joint_names == ("b", "a_3", "a", "a_2")
    q = maximal_q(s, [0.1, 0.2])
    np.testing.assert_allclose(convert.maximal(s).fk(q), s.fk([0.1, 0.2]), rtol=0, atol=1e-15)


def test_postures_put_the_bodies_in_place():
    s = load("jansen")
    other = convert.maximal(s)
    assert other.structure.posture_names == s.structure.posture_names
    np.testing.assert_allclose(other.q("closed"), maximal_q(s, s.q("closed")), rtol=0, atol=1e-14)
    assert convert.maximal(chain()).structure.posture_names == ("closed",)


# ------------------------------------------------------------------ the same zeros and the same
# motions


def judged(s: System, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual and Jacobian by the twists of the bodies where q puts them, in numpy."""
    X = convert.to_maximal(s, q)
    return maximal_residual(s, X, q), maximal_jacobian(s, X, q)


def null_space(J: np.ndarray, tol: float = 1e-7) -> np.ndarray:
    _, size, V = np.linalg.svd(J)
    return V[int((size > tol).sum()) :].T


def twists(s: System, q_max: np.ndarray) -> np.ndarray:
    """Matrix (numbers of the pairs, nv) from velocities of the maximal system to twists of its
    bodies.
    """
    kept = range(6) if s.dim == 3 else (0, 1, 5)
    rows = []
    for body in s.body_names[1:]:
        J = convert.maximal(s).jacobian(q_max, body)
        rows.append(J[: s.dim] if s.mechanism.bodies[body].particle else J[list(kept)])
    return np.concatenate(rows) if rows else np.zeros((0, convert.maximal(s).nv))


def compare(s: System, q: np.ndarray) -> None:
    """At a closed q the system in maximal coordinates and the judge have the same motions of the
    bodies.
    """
    q_max = maximal_q(s, q)
    assert np.abs(closure_rows.compute_residual(convert.maximal(s), q_max)).max(initial=0.0) < 1e-7
    r, K = judged(s, q)
    assert np.abs(r).max(initial=0.0) < 1e-7
    J = closure_rows.compute_jacobian(convert.maximal(s), q_max)
    moving = twists(s, q_max) @ null_space(J)
    assert np.abs(K @ moving).max(initial=0.0) < 1e-6
    singular = np.linalg.svd(K, compute_uv=False) if min(K.shape) else np.zeros(0)
    # else a random configuration is near a singular one
    if not np.any((singular > 1e-9) & (singular < 1e-4)):
        free = K.shape[1] - int((singular > 1e-6).sum())
        assert np.linalg.matrix_rank(moving, tol=1e-6) == free if moving.size else free == 0
    minimal = closure_rows.compute_jacobian(s, q)
    ranks = [np.linalg.matrix_rank(M, tol=1e-7) for M in (J, minimal)]
    assert convert.maximal(s).nv - ranks[0] == s.nv - ranks[1]


@pytest.mark.slow
@given(graphs(most=6, loops=3), st.integers(0, 2**32))
@settings(max_examples=examples(60))
def test_same_motions(graph, seed):
    compare(*closed(graph, seed))


@pytest.mark.parametrize(
    "name", ["four_bar", "four_links", "jansen", "bennett", "sarrus", "stewart", "puma560"]
)
def test_same_motions_of_models(name):
    s = load(name)
    compare(s, s.assemble().q)


def test_same_motions_with_couplings_of_all_sorts():
    m = chain().mechanism
    m.gear("J0", "J1", 2.0, 0.1)
    m.gear("J2", "J3.rz", -0.5)
    m.couple("J4.rx", {"J5.x": 1.0, "J4.ry": -0.7, "J8.ry": 0.3}, 0.2)
    m.gear("J8.rz", "J11.rx", 1.5)
    quat = spatial.unit([1.0, -2, 3, 4])
    m.lock(
        dict(zip(["J7.qw", "J7.qx", "J7.qy", "J7.qz"], quat.tolist(), strict=True)) | {"J6.x": 0.3}
    )
    m.distance("rod", "b3", "p", 0.7, at=(1, 0, 0))
    m.point_on_line("line", "b1", "p", axis=(1, 2, 3))
    m.point_on_plane("plane", "b8", "b2", child_at=(0, 1, 0))
    s = m.build()
    for seed in range(3):
        answer = s.assemble(start=s.random(seed))
        assert answer.success
        compare(s, answer.q)


@given(graphs(most=5, loops=3), st.integers(0, 2**32))
@settings(max_examples=examples(20))
def test_same_zeros(graph, seed):
    """Where bodies are put aside the residual is as large as the judge's, up to a factor."""
    s, q = closed(graph, seed)
    X = disturbed(s, convert.to_maximal(s, q), 0.1, seed)
    ours = np.linalg.norm(closure_rows.compute_residual(convert.maximal(s), maximal_q(s, q, X)))
    judge = np.linalg.norm(maximal_residual(s, X, q))
    assert (judge > 1e-6) <= (ours > 1e-7)


def disturbed(s: System, X: np.ndarray, size: float, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(*X.shape[:-3], len(maximal_velocity_names(s))))
    return maximal_integrate(s, X, size * v)


# ------------------------------------------------------------------ there and back


@given(graphs(most=6, loops=3), st.integers(0, 2**32))
@settings(max_examples=examples(60))
def test_there_and_back(graph, seed):
    s, q = closed(graph, seed)
    X = to_maximal(s, q)
    np.testing.assert_allclose(X, s.fk(q)[1:], atol=0)
    np.testing.assert_allclose(from_maximal(s, X, start=q), q, atol=1e-6)
    again = from_maximal(s, X)
    np.testing.assert_allclose(to_maximal(s, again), X, atol=1e-6)
    np.testing.assert_allclose(s.loops.closure_error(again), 0, atol=1e-6)


def test_a_batch():
    s = chain()
    q = s.random(3, (2, 3))
    back = from_maximal(s, to_maximal(s, q), start=q)
    np.testing.assert_allclose(back, q, atol=1e-10)
    np.testing.assert_allclose(
        from_maximal(s, to_maximal(s, q)[1, 2], start=q[1, 2]), q[1, 2], atol=1e-10
    )
    assert from_maximal(s, np.zeros((0, 13, 4, 4))).shape == (0, s.nq)


def test_turns_are_those_nearby():
    s = chain()
    q = s.random(4)
    q[0] += 14 * math.pi
    np.testing.assert_allclose(from_maximal(s, to_maximal(s, q), start=q), q, atol=1e-10)
    screw = s.coordinate_names.index("J2")
    q[0] -= 14 * math.pi
    q[screw] = 77.0  # its slide tells the turns
    np.testing.assert_allclose(from_maximal(s, to_maximal(s, q))[screw], 77.0, atol=1e-10)


def test_angles_at_their_singularity():
    s = chain()
    q = s.random(5)
    q = s.q({"J8.ry": math.pi / 2}, q)
    X = to_maximal(s, q)
    np.testing.assert_allclose(to_maximal(s, from_maximal(s, X)), X, atol=1e-8)
    np.testing.assert_allclose(from_maximal(s, X, start=q), q, atol=1e-8)


def test_followers_tell_the_turns_of_their_driver():
    m = Mechanism("gears")
    for name in "abc":
        m.revolute(name, m.ground, m.body(f"wheel {name}"))
    m.gear("b", "a", 0.5, 0.1)
    m.gear("c", "a", -1 / 3)
    s = m.build()
    # a third of c's turns, and half of b's: known up to six turns of a
    q = np.array([4.5 * 2 * math.pi])
    X = to_maximal(s, q)
    found = from_maximal(s, X)
    np.testing.assert_allclose(to_maximal(s, found), X, atol=1e-12)
    np.testing.assert_allclose(from_maximal(s, X, start=q), q, atol=1e-12)
    X[1] = X[1] @ spatial.pose(spatial.rot_z(0.01))
    with pytest.raises(
        InputError, match="violate coordinate 'b', which is tied to others or held, by 0.01 rad"
    ):
        from_maximal(s, X)


def test_relations_are_checked():
    m = Mechanism("differential")
    for name in "abc":
        m.revolute(name, m.ground, m.body(f"wheel {name}"))
    m.couple("c", {"a": 0.5, "b": 0.5})
    s = m.build()
    # c turned twice more: the poses cannot tell
    q = s.q({"a": 2.0, "b": 1.0, "c": 1.5 + 4 * math.pi})
    X = to_maximal(s, q)
    np.testing.assert_allclose(from_maximal(s, X), [2.0, 1.0, 1.5], atol=1e-12)
    with pytest.raises(InputError, match="'c'.*by 0.5 rad"):
        from_maximal(s, to_maximal(s, s.q({"a": 2.0, "b": 1.0, "c": 2.0})))


# ------------------------------------------------------------------ declared constraints


def mixed() -> System:
    """A loop, a rod, a point on a line, one in a plane, and a relation, over few enough freedoms to
    leave some.
    """
    m = Mechanism("mixed")
    for name in "abc":
        m.free(f"J{name}", m.ground, m.body(name))
    m.universal("U", "a", "b", at=(1, 0, 0), child_at=(0, 0.3, 0), cut=True)
    m.distance("rod", "b", "c", 1.5, at=(0, 0, 1), child_at=(0.2, 0, 0))
    m.point_on_line("line", m.ground, "a", axis=(1, 2, 0))
    m.point_on_plane("plane", "a", "c", child_at=(0, 1, 0), rpy=(0.3, 0, 0))
    m.couple("U.rx", {"Ja.z": 1.0, "U.ry": -0.5}, 0.1)
    return m.build()


def test_declared_constraints_in_three_forms():
    """18 freedoms less 4 of a universal joint, 1 + 2 + 1 of constraints, 1 of a relation."""
    s = mixed()
    for seed in range(5):
        X, reached = project(s, convert.to_maximal(s, s.random(seed)))
        assert reached
        q = convert.from_maximal(s, X)
        np.testing.assert_allclose(closure_rows.compute_residual(s, q), 0, atol=1e-9)
        for c in s.loops.constraints():
            np.testing.assert_allclose(c.residual(s, q), 0, atol=1e-9)
        stacked = np.concatenate([c.jacobian(s, q) for c in s.loops.constraints()])
        whole = closure_rows.compute_jacobian(convert.maximal(s), maximal_q(s, q))
        forms = whole, stacked, closure_rows.compute_jacobian(s, q), judged(s, q)[1]
        assert [J.shape[1] - np.linalg.matrix_rank(J, tol=1e-6) for J in forms] == [9, 9, 9, 9]


# ------------------------------------------------------------------ projection


def project(s: System, X: np.ndarray, near=None, **options) -> tuple[np.ndarray, np.ndarray]:
    """Poses that satisfy all constraints, near the given ones, and whether that was reached."""
    answer = convert.maximal(s).assemble(start=maximal_q(s, near, X), **options)
    return convert.maximal(s).fk(answer.q)[..., 1:, :, :], answer.success


@given(graphs(most=5, loops=2), st.integers(0, 2**32))
@settings(max_examples=examples(30))
def test_projection(graph, seed):
    s, q = closed(graph, seed)
    X = convert.to_maximal(s, q)
    start = disturbed(s, X, 0.02, seed)
    back, reached = project(s, start, q, limits=False)
    if reached:
        np.testing.assert_allclose(maximal_residual(s, back, q), 0, atol=1e-8)
        R = back[..., :3, :3]
        np.testing.assert_allclose(
            R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12
        )
    same, reached = project(s, X, q, limits=False)
    assert reached and np.abs(same - X).max(initial=0.0) < 1e-6


def bennett() -> System:
    """A loop of four revolute joints that the count says cannot move: redundant equations (Bennett,
    1903).
    """
    a = 1.0
    b = 1.5
    alpha = 0.6
    beta = math.asin(b * math.sin(alpha) / a)
    m = Mechanism("bennett")
    bodies = [m.ground, *(m.body(f"link{i}") for i in range(1, 4))]
    sides = [(a, alpha), (b, beta)] * 2
    for i in range(4):
        length, twist = sides[i - 1]
        m.revolute(f"J{i + 1}", bodies[i - 1], bodies[i], at=(length, 0, 0), rpy=(twist, 0, 0))
    return m.build()


@pytest.mark.slow
def test_redundant_equations_are_no_obstacle():
    s = bennett()
    rng = np.random.default_rng(1)
    reached = 0
    for _ in range(20):
        q = rng.uniform(-2, 2, s.nq)
        X, good = project(s, convert.to_maximal(s, q), q)
        if good:
            reached += 1
            q = convert.from_maximal(s, X)
            assert np.abs(s.loops.closure_error(q)).max() < 1e-9
            # 20 equations for 18 unknowns, and still it moves
            assert convert.maximal(s).mobility(maximal_q(s, q)).dof == 1
    assert reached >= 15
    found = convert.maximal(s).mobility(maximal_q(s, q)).counting
    assert (found.free, found.taken) == (18, 20)


def test_projection_to_the_nearest():
    """A pendulum's bob, pulled off: the nearest point of a circle has a closed form."""
    m = Mechanism("bob", 2)
    m.translation("J", m.ground, m.particle("bob"))
    m.distance("rod", m.ground, "bob", 2.0)
    s = m.build()
    X = np.eye(4)[None].copy()
    X[0, :2, 3] = [3.0, 4.0]
    found, reached = project(s, X, [3.0, 4.0], prefer="nearest")
    assert reached
    np.testing.assert_allclose(found[0, :2, 3], [1.2, 1.6], atol=1e-9)


def test_projection_of_a_batch_says_what_failed():
    m = Mechanism("too short", 2)
    m.free("J", m.ground, m.body("a"))
    m.distance("rod", m.ground, "a", 1.0)
    m.distance("stick", m.ground, "a", 1.0, at=(3, 0))  # the circles do not meet
    s = m.build()
    X, reached = project(s, convert.to_maximal(s, s.random(0, (2, 2))))
    assert X.shape == (2, 2, 1, 4, 4) and reached.shape == (2, 2) and not reached.any()
    m.constraints.pop("stick")
    s = m.build()
    assert project(s, convert.to_maximal(s, s.random(0, (2, 2))))[1].all()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_units_do_not_matter(unit):
    """The same linkage in millimetres, metres and far larger: assembled as well, and read back."""
    m = Mechanism("four bar", 3)
    bodies = [m.ground, *(m.body(n) for n in "abc")]
    for i, at in enumerate([0.0, 0.2, 0.7, 0.6]):
        ends = (bodies[i], bodies[i + 1]) if i < 3 else (m.ground, bodies[3])
        m.revolute(
            "ABCD"[i],
            *ends,
            at=((at if i < 3 else 0.8) * unit, 0, 0),
            child_at=(0.6 * unit, 0, 0) if i == 3 else (0, 0, 0),
        )
    s = m.build()
    q = s.assemble({"A": 0.7}).q
    X = convert.to_maximal(s, q)
    off = disturbed(s, X / np.array([[1.0] * 3 + [unit]] * 3 + [[1.0] * 4]), 0.05) * 1.0
    off[..., :3, 3] *= unit
    back, reached = project(s, off, q)
    assert reached and np.abs(maximal_residual(s, back)[...]).max() < 1e-9 * max(unit, 1e-3)
    np.testing.assert_allclose(convert.from_maximal(s, X, start=q), q, rtol=0, atol=1e-9)
    assert convert.maximal(s).mobility(maximal_q(s, q)).dof == s.mobility(q).dof == 1


def test_bodies_far_from_the_origin():
    m = Mechanism("far", 3)
    a = m.body("a")
    b = m.body("b")
    m.revolute("A", m.ground, a, at=(1e6, -1e6, 3e5))
    m.universal("B", a, b, at=(0.3, 0, 0))
    m.distance("rod", m.ground, b, 0.5, at=(1e6 + 0.4, -1e6, 3e5), child_at=(0.3, 0.0, 0.1))
    s = m.build()
    q = s.assemble().q
    np.testing.assert_allclose(
        convert.from_maximal(s, convert.to_maximal(s, q), start=q), q, rtol=0, atol=1e-8
    )
    answer = convert.maximal(s).assemble(
        start=convert.maximal(s).configuration_space.integrate(
            maximal_q(s, q), np.full(convert.maximal(s).nv, 0.01)
        )
    )
    assert answer.success and convert.maximal(s).mobility(maximal_q(s, q)).dof == 2


def test_nothing_moves():
    m = Mechanism("rigid", 2)
    m.fixed("J", m.ground, m.body("a"), at=(1, 2))
    s = m.build()
    X = convert.to_maximal(s, s.neutral)
    assert convert.from_maximal(s, X).shape == (0,) and project(s, X, s.neutral)[1]
    s = Mechanism("nothing").build()
    X = convert.to_maximal(s, s.neutral)
    assert X.shape == (0, 4, 4) and convert.from_maximal(s, X).shape == (0,)
    assert convert.maximal(s).nq == 0 and project(s, X)[1]


# ------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda X: X[:-1], r"needs \(..., 3, 4, 4\): all bodies but the ground"),
        (lambda X: X + [[np.nan]], "pose of body 'crank' is not a pose: .* must be finite"),
        (
            lambda X: 1.01 * X,
            "pose of body 'crank' is not a pose: its last row is .*1.01.; it must be 0 0 0 1",
        ),
        (lambda X: spatial.pose(spatial.rot_x(0.1)) @ X, "pose of body 'crank' leaves the plane"),
        (lambda X: spatial.pose(p=[0, 0, 0.1]) @ X, "pose of body 'crank' leaves the plane"),
        (
            lambda X: spatial.pose(p=[0.3, 0.4, 0]) @ X,
            r"violate joint 'A' \(revolute\) by 0.5 m; at most 1e-06",
        ),
    ],
)
def test_refused(change, said):
    s = load("four_bar")
    X = convert.to_maximal(s, s.assemble({"A": 0.4}).q)
    assert from_maximal(s, X).shape == (s.nq,)
    with pytest.raises(InputError, match=said):
        from_maximal(s, change(X))


def test_refused_by_name():
    s = chain()
    X = to_maximal(s, s.random(6))
    off = X.copy()
    off[9:-1] = off[9] @ spatial.exp_se3([0, 0, 0, 0.2, 0, 0]) @ spatial.inverse(off[9]) @ off[9:-1]
    with pytest.raises(InputError, match=r"joint 'J9' \(fixed\) by .* and 0.2 rad"):
        from_maximal(s, off)
    off = X.copy()
    off[-1] = off[-1] @ spatial.pose(spatial.rot_x(0.1))
    with pytest.raises(InputError, match="'p': a particle has no orientation"):
        from_maximal(s, off)
    m = s.mechanism
    m.distance("rod", "b3", "p", 1e3)
    with pytest.raises(InputError, match=r"constraint 'rod' \(distance\) by"):
        from_maximal(m.build(), X)
    quat = spatial.unit([1.0, -2, 3, 4])
    m = s.mechanism
    m.lock(dict(zip(["J7.qw", "J7.qx", "J7.qy", "J7.qz"], quat.tolist(), strict=True)))
    with pytest.raises(InputError, match=r"joint 'J7' \(spherical\) is locked by .* rad"):
        from_maximal(m.build(), X)
    locked = m.build()
    assert from_maximal(locked, to_maximal(locked, locked.random(1))).shape == (locked.nq,)


# ------------------------------------------------------------------ poses of another library


@pytest.mark.skipif(not good_urdf_files(), reason="the package example-robot-data is not installed")
def test_poses_of_pinocchio():
    pin = pytest.importorskip("pinocchio")
    path = next(p for n, p in good_urdf_files().items() if n.endswith("panda.urdf"))
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    s = load(path)
    q = s.random(7)
    v = s.q_dict(q)
    names = list(model.names)[1:]
    values = {n: v[n] if n in v else float(compute_coordinate_value(s, q, n)) for n in names}
    pin.framesForwardKinematics(model, data, np.array([values[n] for n in names]))
    X = np.stack([data.oMf[model.getFrameId(b)].homogeneous for b in s.body_names[1:]])
    np.testing.assert_allclose(to_maximal(s, q), X, atol=1e-12)
    np.testing.assert_allclose(from_maximal(s, X, start=q), q, atol=1e-10)


# ------------------------------------------------------------------ joints that hold nothing along
# fixed axes


@pytest.mark.parametrize(
    ("kind", "dim"), [(t(), d) for t in OWN for d in (2, 3) if d == 3 or t.planar], ids=str
)
def test_types_of_ones_own(kind, dim):
    """The rank, projection, and coordinates read off."""
    rng = np.random.default_rng(13)
    shape = closed_graphs.closed(
        rng, dim, 2, [kind, Spherical() if dim == 3 else Revolute(), Free()], ring=True
    )
    s = shape.system(frozenset({"j0"}))
    q = shape.values(s)
    compare(s, q)
    off = disturbed(s, convert.to_maximal(s, q), 0.02)
    near, found = project(s, off, q)
    assert found and np.abs(maximal_residual(s, near)).max() < 1e-8
    back = convert.from_maximal(s, near, start=q)
    np.testing.assert_allclose(convert.to_maximal(s, back), near, rtol=0, atol=1e-7)
    assert shape.open_by(s, back) < 1e-7
