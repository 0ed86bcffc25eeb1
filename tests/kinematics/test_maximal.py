"""Maximal coordinates: counts, derivatives, the way to joint coordinates and back, projection, what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import closed_graphs
import numpy as np
import pytest
from graphs import Graph, graphs
from hypothesis import given, settings
from hypothesis import strategies as st
from own_joints import OWN
from robots import good_urdf_files

from kempe import Mechanism, System, load, spatial
from kempe.errors import InputError
from kempe.joints import Free, Revolute, Spherical
from kempe.kinematics import loops, zoo
from kempe.kinematics.constraints import coordinate_value, joint_pose
from kempe.kinematics.maximal import (
    from_maximal,
    maximal_integrate,
    maximal_jacobian,
    maximal_residual,
    maximal_row_names,
    maximal_velocity_names,
    project_maximal,
    to_maximal,
)
from kempe.kinematics.pairs import hold_of
from kempe.placement import placement_of_pose

STEP = 1e-6


def closed(graph: Graph, seed: int) -> tuple[System, np.ndarray]:
    """The graph with the joints that close loops placed so that a random configuration is closed."""
    s = graph.mechanism().build()
    q = s.random(seed)
    m = s.mechanism
    for name in s.closures:
        joint = m.joints[name]
        names = s.coordinates_of_joint(name)
        own = np.array([coordinate_value(s, q, n) for n in names])
        X_FM = joint_pose(joint.type, own, s.dim, m.bodies[joint.child].particle)
        X_WM = s.fk(q, joint.child) @ joint.X_CM.evaluate({})
        X_PF = spatial.inverse(s.fk(q, joint.parent)) @ X_WM @ spatial.inverse(X_FM)
        if m.bodies[joint.child].particle:  # its rotation is none: keep that of F
            F = joint.X_PF.evaluate({})
            X_WF = s.fk(q, joint.parent) @ F
            shift = X_WM[:3, 3] - (X_WF @ X_FM)[:3, 3]
            X_PF = np.array(F)
            X_PF[:3, 3] += s.fk(q, joint.parent)[:3, :3].T @ shift
        m.joints[name] = replace(joint, X_PF=placement_of_pose(X_PF))
    out = m.build()
    assert out.closures == s.closures and np.abs(out.closure_error(q)).max(initial=0.0) < 1e-8
    return out, q


def chain() -> System:
    """One joint of each type in a row, with a particle at the end and couplings of all sorts."""
    m = Mechanism("chain")
    here = m.ground
    rng = np.random.default_rng(0)
    kinds = [("revolute", {}), ("prismatic", {}), ("helical", {"pitch": 0.2}), ("cylindrical", {}), ("universal", {}),
             ("planar", {}), ("translation", {}), ("spherical", {}), ("spherical", {"angles": True}),
             ("fixed", {}), ("free", {}), ("free", {"angles": True})]  # fmt: skip
    for i, (kind, options) in enumerate(kinds):
        body = m.body(f"b{i}")
        m.joint(f"J{i}", kind, here, body, at=rng.uniform(-1, 1, 3), rpy=rng.uniform(-1, 1, 3),
                child_at=rng.uniform(-1, 1, 3), child_rpy=rng.uniform(-1, 1, 3), **options)  # fmt: skip
        here = body
    m.planar("Jp", here, m.particle("p"), at=(1, 2, 3))
    return m.build()


# ------------------------------------------------------------------ counts


def test_count_of_rows_and_columns():
    s = chain()
    names, columns = maximal_row_names(s), maximal_velocity_names(s)
    expected = [5, 5, 5, 4, 4, 3, 3, 3, 3, 6, 0, 0, 1]
    assert [sum(n == j for n, _ in names) for j in s.joint_names] == expected
    assert len(columns) == 6 * 12 + 3 and columns[-3:] == ("p.vx", "p.vy", "p.vz")
    X = to_maximal(s, s.random(0, 4))
    assert X.shape == (4, 13, 4, 4)
    J = maximal_jacobian(s, X)
    assert maximal_residual(s, X).shape == (4, len(names)) and J.shape == (4, len(names), len(columns))
    # a tree has no row too many: what is left are the freedoms of its joints
    assert np.linalg.matrix_rank(J[0]) == len(names) == len(columns) - s.nv


def test_lecture_count():
    """Four bodies in the plane, four revolute joints and a slider: 12 - 10 = 2."""
    s = load("four_links")
    assert len(maximal_velocity_names(s)) == 12 and len(maximal_row_names(s)) == 10


@given(graphs(most=6, loops=3))
def test_rows_are_what_joints_take_away(graph):
    s = graph.mechanism().build()
    expected = 0
    for joint in s.joints.values():
        particle = s.mechanism.bodies[joint.child].particle
        held = hold_of(joint.type, s.dim, particle) is not None
        expected += joint.type.constraints(s.dim, particle) + (0 if held else joint.type.dof(s.dim, particle))
    expected += len(s.couplings) + len(s.relations)
    particles = len(graph.particles)
    full, few = (6, 3) if s.dim == 3 else (3, 2)
    assert len(maximal_row_names(s)) == expected
    assert len(maximal_velocity_names(s)) == full * (len(s.parent) - particles) + few * particles


# ------------------------------------------------------------------ derivatives


def check_jacobian(s: System, X: np.ndarray, near=None, atol: float = 2e-7) -> None:
    J = maximal_jacobian(s, X, near)
    steps = STEP * np.eye(J.shape[-1])
    ends = [[maximal_residual(s, maximal_integrate(s, X, x * e), near) for x in (1, -1)] for e in steps]
    found = np.stack([(a - b) / (2 * STEP) for a, b in ends], axis=-1)
    np.testing.assert_allclose(J, found, atol=atol * (1 + np.abs(J).max(initial=0)))


def disturbed(s: System, X: np.ndarray, size: float, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(*X.shape[:-3], len(maximal_velocity_names(s))))
    return maximal_integrate(s, X, size * v)


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_derivatives_of_every_joint(size):
    s = chain()
    X = disturbed(s, to_maximal(s, s.random(1, 3)), size)
    check_jacobian(s, X)
    m = s.mechanism
    m.gear("J0", "J1", 2.0, 0.1)
    m.gear("J2", "J3.rz", -0.5)
    m.couple("J4.rx", {"J5.x": 1.0, "J4.ry": -0.7, "J8.ry": 0.3}, 0.2)
    m.gear("J8.rz", "J11.rx", 1.5)
    quat = spatial.unit([1.0, -2, 3, 4])
    m.lock(dict(zip(["J7.qw", "J7.qx", "J7.qy", "J7.qz"], quat.tolist(), strict=True)) | {"J6.x": 0.3})
    m.distance("rod", "b3", "p", 0.7, at=(1, 0, 0))
    m.point_on_line("line", "b1", "p", axis=(1, 2, 3))
    m.point_on_plane("plane", "b8", "b2", child_at=(0, 1, 0))
    s = m.build()
    q = s.random(2, 3)
    check_jacobian(s, disturbed(s, to_maximal(s, q), size), q)
    tied = [n for n in maximal_row_names(s) if n[0] not in s.joint_names]
    assert tied == [("rod", "distance"), ("line", "x"), ("line", "y"), ("plane", "z"), ("J6.x", "relation"),
                    ("J8.rz", "relation"), ("J4.rx", "relation")]  # fmt: skip


@given(graphs(most=5, loops=3), st.integers(0, 2**32))
@settings(max_examples=20)
def test_derivatives_of_graphs(graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed)
    check_jacobian(s, disturbed(s, to_maximal(s, q), 0.2, seed), q, atol=1e-5)


# ------------------------------------------------------------------ there and back


@given(graphs(most=6, loops=3), st.integers(0, 2**32))
@settings(max_examples=60)
def test_there_and_back(graph, seed):
    s, q = closed(graph, seed)
    X = to_maximal(s, q)
    np.testing.assert_allclose(X, s.fk(q)[1:], atol=0)
    np.testing.assert_allclose(maximal_residual(s, X, q), 0, atol=1e-7)
    np.testing.assert_allclose(maximal_residual(s, X), 0, atol=1e-7)
    np.testing.assert_allclose(from_maximal(s, X, near=q), q, atol=1e-6)
    again = from_maximal(s, X)
    np.testing.assert_allclose(to_maximal(s, again), X, atol=1e-6)
    np.testing.assert_allclose(s.closure_error(again), 0, atol=1e-6)


def test_a_batch():
    s = chain()
    q = s.random(3, (2, 3))
    back = from_maximal(s, to_maximal(s, q), near=q)
    np.testing.assert_allclose(back, q, atol=1e-10)
    np.testing.assert_allclose(from_maximal(s, to_maximal(s, q)[1, 2], near=q[1, 2]), q[1, 2], atol=1e-10)
    assert from_maximal(s, np.zeros((0, 13, 4, 4))).shape == (0, s.nq)
    assert maximal_jacobian(s, np.zeros((0, 13, 4, 4))).shape[0] == 0


def test_turns_are_those_nearby():
    s = chain()
    q = s.random(4)
    q[0] += 14 * math.pi
    np.testing.assert_allclose(from_maximal(s, to_maximal(s, q), near=q), q, atol=1e-10)
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
    np.testing.assert_allclose(from_maximal(s, X, near=q), q, atol=1e-8)


def test_followers_tell_the_turns_of_their_driver():
    m = Mechanism("gears")
    for name in "abc":
        m.revolute(name, m.ground, m.body(f"wheel {name}"))
    m.gear("b", "a", 0.5, 0.1)
    m.gear("c", "a", -1 / 3)
    s = m.build()
    q = np.array([4.5 * 2 * math.pi])  # a third of c's turns, and half of b's: known up to six turns of a
    X = to_maximal(s, q)
    found = from_maximal(s, X)
    np.testing.assert_allclose(to_maximal(s, found), X, atol=1e-12)
    np.testing.assert_allclose(from_maximal(s, X, near=q), q, atol=1e-12)
    np.testing.assert_allclose(maximal_residual(s, X), 0, atol=1e-12)
    X[1] = X[1] @ spatial.pose(spatial.rot_z(0.01))
    with pytest.raises(InputError, match="violate coordinate 'b', which is tied to others or held, by 0.01 rad"):
        from_maximal(s, X)


def test_relations_are_checked():
    m = Mechanism("differential")
    for name in "abc":
        m.revolute(name, m.ground, m.body(f"wheel {name}"))
    m.couple("c", {"a": 0.5, "b": 0.5})
    s = m.build()
    q = s.q({"a": 2.0, "b": 1.0, "c": 1.5 + 4 * math.pi})  # c turned twice more: the poses cannot tell
    X = to_maximal(s, q)
    np.testing.assert_allclose(from_maximal(s, X), [2.0, 1.0, 1.5], atol=1e-12)
    with pytest.raises(InputError, match="'c'.*by 0.5 rad"):
        from_maximal(s, to_maximal(s, s.q({"a": 2.0, "b": 1.0, "c": 2.0})))


# ------------------------------------------------------------------ the same freedoms


def nullity(J: np.ndarray) -> tuple[int, float]:
    """Columns less rank, and the gap between what counts and what does not."""
    s = np.linalg.svd(J, compute_uv=False) if min(J.shape) else np.zeros(0)
    rank = int((s > 1e-6).sum())
    return J.shape[1] - rank, float(np.min(s[s > 1e-6], initial=1.0))


@given(graphs(most=6, loops=3), st.integers(0, 2**32))
@settings(max_examples=60)
def test_both_parametrisations_have_the_same_freedoms(graph, seed):
    s, q = closed(graph, seed)
    free, gap = nullity(maximal_jacobian(s, to_maximal(s, q), q))
    minimal, gap_2 = nullity(loops.jacobian(s, q))
    if min(gap, gap_2) > 1e-4:  # else a random configuration is near a singular one
        assert free == minimal


def mixed() -> System:
    """A loop, a rod, a point on a line, one in a plane, and a relation, over few enough freedoms to leave some."""
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
        X, reached = project_maximal(s, to_maximal(s, s.random(seed)))
        assert reached
        q = from_maximal(s, X)
        np.testing.assert_allclose(loops.residual(s, q), 0, atol=1e-9)
        constraints = zoo.of_system(s)
        for c in constraints:
            np.testing.assert_allclose(c.residual(s, q), 0, atol=1e-9)
        stacked = np.concatenate([c.jacobian(s, q) for c in constraints])
        forms = maximal_jacobian(s, X, q), stacked, loops.jacobian(s, q)
        assert [nullity(J)[0] for J in forms] == [9, 9, 9]


@pytest.mark.parametrize(("name", "dof"), [("four_bar", 1), ("four_links", 2), ("two_link", 2), ("puma560", 6)])
def test_freedoms_of_models(name, dof):
    s = load(name)
    q = s.random(0)
    if s.closures:
        X, reached = project_maximal(s, to_maximal(s, q))
        assert reached
        q = from_maximal(s, X)
        assert np.abs(s.closure_error(q)).max() < 1e-9
    assert nullity(maximal_jacobian(s, to_maximal(s, q)))[0] == dof


# ------------------------------------------------------------------ projection


@given(graphs(most=5, loops=2), st.integers(0, 2**32))
@settings(max_examples=30)
def test_projection(graph, seed):
    s, q = closed(graph, seed)
    X = to_maximal(s, q)
    start = disturbed(s, X, 0.02, seed)
    back, reached = project_maximal(s, start, near=q)
    assert np.abs(back - X).max(initial=0.0) < 5.0
    if reached:
        np.testing.assert_allclose(maximal_residual(s, back, q), 0, atol=1e-9)
        R = back[..., :3, :3]
        np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    same, reached = project_maximal(s, X, near=q)
    assert reached and np.abs(same - X).max(initial=0.0) < 1e-6


def bennett() -> System:
    """A loop of four revolute joints that the count says cannot move: redundant equations (Bennett, 1903)."""
    a, b, alpha = 1.0, 1.5, 0.6
    beta = math.asin(b * math.sin(alpha) / a)
    m = Mechanism("bennett")
    bodies = [m.ground, *(m.body(f"link{i}") for i in range(1, 4))]
    sides = [(a, alpha), (b, beta)] * 2
    for i in range(4):
        length, twist = sides[i - 1]
        m.revolute(f"J{i + 1}", bodies[i - 1], bodies[i], at=(length, 0, 0), rpy=(twist, 0, 0))
    return m.build()


def test_redundant_equations_are_no_obstacle():
    s = bennett()
    rng = np.random.default_rng(1)
    reached = 0
    for _ in range(20):
        X, good = project_maximal(s, to_maximal(s, rng.uniform(-2, 2, s.nq)))
        if good:
            reached += 1
            q = from_maximal(s, X)
            assert np.abs(s.closure_error(q)).max() < 1e-9
            assert nullity(maximal_jacobian(s, X))[0] == 1  # 20 equations for 18 unknowns, and still it moves
    assert reached >= 15
    assert len(maximal_row_names(s)) == 20 and len(maximal_velocity_names(s)) == 18


def test_projection_converges_quadratically_to_the_nearest():
    """A pendulum's bob, pulled off: the step of least norm has a closed form for a point on a circle."""
    m = Mechanism("bob", 2)
    m.translation("J", m.ground, m.particle("bob"))
    m.distance("rod", m.ground, "bob", 2.0)
    s = m.build()
    X = np.eye(4)[None].copy()
    X[0, :2, 3] = [3.0, 4.0]
    found, reached = project_maximal(s, X)
    assert reached
    np.testing.assert_allclose(found[0, :2, 3], [1.2, 1.6], atol=1e-12)
    X[0, :2, 3] = np.nan
    assert not project_maximal(s, X)[1]


def test_projection_of_a_batch_says_what_failed():
    m = Mechanism("too short", 2)
    m.free("J", m.ground, m.body("a"))
    m.distance("rod", m.ground, "a", 1.0)
    m.distance("stick", m.ground, "a", 1.0, at=(3, 0))  # the circles do not meet
    s = m.build()
    X, reached = project_maximal(s, to_maximal(s, s.random(0, (2, 2))))
    assert X.shape == (2, 2, 1, 4, 4) and reached.shape == (2, 2) and not reached.any()
    m.constraints.pop("stick")
    s = m.build()
    assert project_maximal(s, to_maximal(s, s.random(0, (2, 2))))[1].all()


def test_projection_makes_rotations_first():
    """The nearest rotation to a matrix of singular values 3, 2, -1 turns the weakest axis back (Kabsch, 1976)."""
    m = Mechanism("loose")
    m.free("J", m.ground, m.body("a"))
    R, Q = (spatial.exp_so3(w) for w in ([0.3, -1.0, 0.5], [1.0, 0.2, -0.4]))
    X, reached = project_maximal(m.build(), spatial.pose(R @ np.diag([3.0, 2.0, -1.0]) @ Q)[None])
    assert reached
    np.testing.assert_allclose(X[0, :3, :3], R @ Q, atol=1e-14)


def test_nothing_moves():
    m = Mechanism("rigid", 2)
    m.fixed("J", m.ground, m.body("a"), at=(1, 2))
    s = m.build()
    X = to_maximal(s, s.neutral)
    assert from_maximal(s, X).shape == (0,) and project_maximal(s, X, near=s.neutral)[1]
    s = Mechanism("nothing").build()
    X = to_maximal(s, s.neutral)
    assert X.shape == (0, 4, 4) and from_maximal(s, X).shape == (0,)
    assert maximal_jacobian(s, X).shape == (0, 0) and project_maximal(s, X)[1]


# ------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda X: X[:-1], r"needs \(..., 3, 4, 4\): all bodies but the ground"),
        (lambda X: X + [[np.nan]], "pose of body 'crank' is not finite"),
        (lambda X: 1.01 * X, "pose of body 'crank': its rotation is none"),
        (lambda X: spatial.pose(spatial.rot_x(0.1)) @ X, "pose of body 'crank' leaves the plane"),
        (lambda X: spatial.pose(p=[0, 0, 0.1]) @ X, "pose of body 'crank' leaves the plane"),
        (lambda X: spatial.pose(p=[0.3, 0.4, 0]) @ X, r"violate joint 'A' \(revolute\) by 0.5 m; at most 1e-06"),
    ],
)
def test_refused(change, said):
    s = load("four_bar")
    X, reached = project_maximal(s, to_maximal(s, s.random(1)))
    assert reached and from_maximal(s, X).shape == (s.nq,)
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
    values = {n: v[n] if n in v else float(coordinate_value(s, q, n)) for n in names}
    pin.framesForwardKinematics(model, data, np.array([values[n] for n in names]))
    X = np.stack([data.oMf[model.getFrameId(b)].homogeneous for b in s.body_names[1:]])
    np.testing.assert_allclose(to_maximal(s, q), X, atol=1e-12)
    np.testing.assert_allclose(maximal_residual(s, X), 0, atol=1e-12)
    np.testing.assert_allclose(from_maximal(s, X, near=q), q, atol=1e-10)


# ------------------------------------------------------------------ joints that hold nothing along fixed axes


@pytest.mark.parametrize(("kind", "dim"), [(t(), d) for t in OWN for d in (2, 3) if d == 3 or t.planar], ids=str)
def test_types_of_ones_own(kind, dim):
    """Derivatives also where poses violate the joint, the rank, projection, and coordinates read off."""
    rng = np.random.default_rng(13)
    shape = closed_graphs.closed(rng, dim, 2, [kind, Spherical() if dim == 3 else Revolute(), Free()], ring=True)
    s = shape.system(frozenset({"j0"}))
    q = shape.values(s)
    X = s.to_maximal(q)
    np.testing.assert_allclose(maximal_residual(s, X), 0, atol=1e-9)
    J = maximal_jacobian(s, X)
    assert J.shape[1] - np.linalg.matrix_rank(J, tol=1e-6) == visible(s, q)
    off = maximal_integrate(s, X, rng.uniform(-0.05, 0.05, J.shape[1]))
    check_jacobian(s, off, atol=1e-5)
    near, found = project_maximal(s, off)
    assert found and np.abs(maximal_residual(s, near)).max() < 1e-9
    back = from_maximal(s, near, near=q)
    np.testing.assert_allclose(s.to_maximal(back), near, rtol=0, atol=1e-7)
    assert shape.open_by(s, back) < 1e-7


def visible(s: System, q: np.ndarray) -> int:
    """Freedoms of the bodies at a closed configuration: the rank of what they do as the loops allow."""
    K = loops.jacobian(s, q)
    _, size, V = np.linalg.svd(K)
    free = V[int((size > 1e-8).sum()) :].T
    twists = np.concatenate([s.jacobian(q, b) for b in s.body_names[1:]])
    return int(np.linalg.matrix_rank(twists @ free, tol=1e-7))
