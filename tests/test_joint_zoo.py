"""One battery for every joint of the zoo: in space, in the plane, for particles, both ways round."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field

import numpy as np
import own_joints
import pytest
import reference
from graphs import SLIDES
from hunts import some
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import kempe
from kempe import Mechanism
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.description.urdf_writer import write_urdf
from kempe.equations.judge import compute_joint_pose
from kempe.errors import DescriptionError, InputError, UnknownNameError
from kempe.joints import (
    TYPES,
    Helical,
    JointType,
    P,
    Primitive,
    Product,
    Q,
    R,
    Revolute,
    Spherical,
    is_table_type,
    make_joint_type,
)


@dataclass(frozen=True)
class Case:
    """A joint type with its options, and where it is used."""

    type: str
    dim: int = 3
    particle: bool = False
    options: dict = field(default_factory=dict, hash=False)

    @property
    def kind(self) -> JointType:
        return make_joint_type(self.type, **self.options)

    @property
    def slider(self) -> bool:
        """Whether it slides along z: in the plane it needs an axis."""
        return any(
            p.kind == P and p.axis == "z" for p in self.kind.layout(self.dim, self.particle)[1]
        )

    def __str__(self) -> str:
        words = [self.type, *(f"{k}={v}" for k, v in self.options.items())]
        return " ".join(words + ["in the plane"] * (self.dim == 2) + ["particle"] * self.particle)


def variants(name: str) -> list[dict]:
    """Option sets of a type: none, and others where it has options."""
    every = [{}, *own_joints.variants(TYPES[name], 0.25), *own_joints.variants(TYPES[name], -0.1)]
    return [o for i, o in enumerate(every) if o not in every[:i]]


CASES = [Case(name, options=o) for name in TYPES for o in variants(name)]
CASES += [Case(name, dim=2) for name, t in TYPES.items() if t.planar]
CASES += [Case(name, dim=dim, particle=True) for dim in (2, 3) for name, _ in SLIDES]
CASES += [Case(words) for words in own_joints.PRODUCTS]
CASES += [
    Case(words, dim=2)
    for words in ("P(x) R(z)", "R(z) P(x) R(z)", "P(y) P(x)", "R(z)", "P(y)", "P(z)")
]
CASES += [Case(words, dim, True) for words in ("P(y) P(x)", "P(x)") for dim in (2, 3)]
every_case = pytest.mark.parametrize("case", CASES, ids=str)

X_PF_AT = (0.3, -0.2, 0.5)
X_PF_RPY = (0.4, -0.7, 1.1)
X_CM_AT = (-0.1, 0.25, 0.15)
X_CM_RPY = (-1.2, 0.3, 0.8)


def one_joint(case: Case, backwards: bool = False, placed: bool = False, **keywords):
    """The system of one joint 'j' between the ground and the body 'M', given from 'M' to the ground
    if backwards.
    """
    m = Mechanism("one joint", case.dim)
    body = m.particle("M") if case.particle else m.body("M")
    if placed:
        if case.dim == 3:
            keywords |= {"at": X_PF_AT, "rpy": X_PF_RPY}
            if not case.particle:
                keywords |= {"child_at": X_CM_AT, "child_rpy": X_CM_RPY}
        else:
            keywords |= {"at": X_PF_AT[:2], "angle": X_PF_RPY[2]}
            if not case.particle:
                keywords |= {"child_at": X_CM_AT[:2], "child_angle": X_CM_RPY[2]}
    if case.dim == 2 and case.slider:
        keywords.setdefault("axis", (1.0, 0.0))
    ends = (body, m.ground) if backwards else (m.ground, body)
    m.joint("j", case.type, *ends, **case.options, **keywords)
    return m.build()


def expected_pose(case: Case, q, backwards: bool = False, placed: bool = False) -> np.ndarray:
    """Pose of 'M', by the reference."""
    X_FM = reference.joint_pose(case.type, q, dim=case.dim, particle=case.particle, **case.options)
    if case.dim == 2 and case.slider:
        X_FM = reference.slide("x", q[0])
    X_PF = X_CM = np.eye(4)
    if placed:
        if case.dim == 3:
            X_PF = reference.placement(X_PF_AT, X_PF_RPY)
            X_CM = reference.placement(X_CM_AT, X_CM_RPY)
        else:
            X_PF = reference.placement(X_PF_AT[:2], (0, 0, X_PF_RPY[2]))
            X_CM = reference.placement(X_CM_AT[:2], (0, 0, X_CM_RPY[2]))
    if case.particle:
        X_CM = np.eye(4)
    X = X_PF @ X_FM @ reference.inverse(X_CM)
    X = reference.inverse(X) if backwards else X
    if case.particle:
        X[:3, :3] = np.eye(3)
    return np.asarray(X, dtype=float)


def sample(system, rng, size: float = 3.0) -> np.ndarray:
    """A configuration with plain coordinates up to `size` and quaternions that are not normalised."""
    q = rng.uniform(-size, size, system.nq)
    for i in system.structure.layout.quaternion_q:
        q[i : i + 4] = rng.normal(size=4) * rng.uniform(0.5, 2.0)
    return q


both_ways = pytest.mark.parametrize(
    "case, backwards",
    [
        pytest.param(case, back, id=f"{case} backwards" if back else str(case))
        for case in CASES
        for back in (False, True)
        if not (case.particle and back)
    ],
)
"""Each case with the body as child and as parent; but a particle is nobody's parent."""
places = pytest.mark.parametrize("placed", [False, True], ids=["bare", "placed"])


# ------------------------------------------------------------------ counting


@every_case
def test_freedoms_and_constraints_add_up(case):
    all_freedoms = {(3, False): 6, (2, False): 3, (3, True): 3, (2, True): 2}[
        case.dim, case.particle
    ]
    kind = case.kind
    assert (
        kind.dof(case.dim, case.particle) + kind.constraints(case.dim, case.particle)
        == all_freedoms
    )


@every_case
def test_number_of_coordinates(case):
    system = one_joint(case)
    balls = sum(p.kind == Q for p in case.kind.layout(case.dim, case.particle)[1])
    assert system.nv == case.kind.dof(case.dim, case.particle)
    assert system.nq == system.nv + balls
    assert len(system.coordinate_names) == system.nq
    assert (
        len(system.structure.velocity_names)
        == system.nv
        == len(set(system.structure.velocity_names))
    )


@every_case
@places
def test_columns_of_the_jacobian_are_independent(case, placed):
    system = one_joint(case, placed=placed)
    J = system.jacobian(sample(system, np.random.default_rng(1), 1.0), "M")
    assert np.linalg.matrix_rank(J, tol=1e-9) == system.nv


# dof, constraints in space, constraints in the plane (the lecture: each joint of the plane imposes
# two), decomposition
TABLE = {
    "fixed": (0, 6, 3, "rigid"),
    "revolute": (1, 5, 2, "R(z)"),
    "prismatic": (1, 5, 2, "P(z)"),
    "helical": (1, 5, None, "R(z) P(z, 0.25 q)"),
    "cylindrical": (2, 4, None, "R(z) P(z)"),
    "universal": (2, 4, None, "R(x) R(y)"),
    "planar": (3, 3, 0, "P(x) P(y) R(z)"),
    "translation": (3, 3, 1, "P(x) P(y) P(z)"),
    "spherical": (3, 3, None, "R R R (as one unit quaternion)"),
    "free": (6, 0, 0, "P(x) P(y) P(z) R R R (as one unit quaternion)"),
}


@pytest.mark.parametrize("name", TYPES)
def test_table_of_the_lecture(name):
    dof, space, plane, text = TABLE[name]
    kind = make_joint_type(name, **({"pitch": 0.25} if name == "helical" else {}))
    assert (kind.dof(), kind.constraints(), kind.decomposition) == (
        dof,
        space,
        text,
    )
    assert kind.planar == (plane is not None)
    if plane is not None:
        assert kind.constraints(2) == plane


def test_angles_are_three_turns():
    assert make_joint_type("spherical", angles=True).decomposition == "R(z) R(y) R(x)"
    assert make_joint_type("free", angles=True).decomposition == "P(x) P(y) P(z) R(z) R(y) R(x)"


@every_case
def test_the_table_tells_types_apart(case):
    assert TYPES.get(case.type, Product).__doc__ and case.kind.summary
    assert make_joint_type(case.kind.type_name, **case.kind.options) == case.kind and is_table_type(
        case.kind
    )


# ------------------------------------------------------------------ poses


@both_ways
@places
@pytest.mark.parametrize("size", [1.0, 1e3])
def test_pose_is_the_reference(case, backwards, placed, size):
    system = one_joint(case, backwards, placed)
    rng = np.random.default_rng(7)
    for _ in range(5):
        q = sample(system, rng, size)
        expected = expected_pose(case, q, backwards, placed)
        np.testing.assert_allclose(
            system.fk(q, "M"), expected, rtol=0, atol=1e-13 * max(10.0, size)
        )


def slides(case: Case) -> bool:
    return any(p.kind == P for p in case.kind.layout(case.dim, case.particle)[1])


@both_ways
@pytest.mark.parametrize("size", some([1.0, 1e4, 1e8], 3))
def test_poses_are_rigid_motions_at_large_coordinates(case, backwards, size):
    system = one_joint(case, backwards)
    rng = np.random.default_rng(3)
    q = np.array([sample(system, rng, size) for _ in range(20)])
    for X in (system.fk(q, "M"), np.array([system.fk(x, "M") for x in q]), system.fk(q)[:, 1]):
        turn = X[:, :3, :3]
        assert np.abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max() < 1e-12
        assert np.abs(np.linalg.det(turn) - 1).max() < 1e-12
        assert np.array_equal(X[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (20, 1)))
        expected = np.array([expected_pose(case, x, backwards) for x in q])
        assert np.abs(X - expected)[:, :3, :3].max() < 1e-12
        assert np.abs(X - expected)[:, :3, 3].max() < 1e-12 * max(
            1.0, size if slides(case) else 1.0
        )


@both_ways
def test_neutral_is_no_motion(case, backwards):
    system = one_joint(case, backwards)
    np.testing.assert_array_equal(system.fk(system.neutral, "M"), np.eye(4))


@every_case
def test_pose_of_the_bare_joint(case):
    """X_FM of the joint alone slides along z of F in the plane, too."""
    system = one_joint(case)
    rng = np.random.default_rng(5)
    q = np.array([sample(system, rng) for _ in range(4)])
    expected = [
        reference.joint_pose(case.type, x, dim=case.dim, particle=case.particle, **case.options)
        for x in q
    ]
    found = compute_joint_pose(case.kind, q, case.dim, case.particle)
    np.testing.assert_allclose(found, np.array(expected, dtype=float), rtol=0, atol=1e-14 * 10)


@every_case
@pytest.mark.parametrize("lead", [(), (0,), (1,), (2, 0, 3), (2, 1, 3), (70,)], ids=str)
def test_batches(case, lead):
    system = one_joint(case, placed=True)
    rng = np.random.default_rng(2)
    q = np.array([sample(system, rng) for _ in range(int(np.prod(lead)))]).reshape(*lead, system.nq)
    X = system.fk(q, "M")
    J = system.jacobian(q, "M")
    bodies = system.fk(q)
    assert (
        X.shape == (*lead, 4, 4)
        and J.shape == (*lead, 6, system.nv)
        and bodies.shape == (*lead, 2, 4, 4)
    )
    assert system.fk(q, ["M", "ground", "M"]).shape == (*lead, 3, 4, 4)
    assert system.random(0, lead).shape == (*lead, system.nq)
    for i in np.ndindex(*lead):
        np.testing.assert_allclose(X[i], system.fk(q[i], "M"), rtol=0, atol=1e-15 * 10)
        np.testing.assert_allclose(bodies[i], [np.eye(4), X[i]], rtol=0, atol=1e-15 * 10)
        np.testing.assert_allclose(J[i], system.jacobian(q[i], "M"), rtol=0, atol=1e-15 * 10)


@every_case
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_numbers_stay_bad(case, bad):
    system = one_joint(case, placed=True)
    for k in range(system.nq):
        q = np.array([sample(system, np.random.default_rng(i)) for i in range(5)])
        good = system.fk(q, "M"), system.jacobian(q, "M"), system.fk(q)
        q[2, k] = bad
        for ask in (lambda x: system.fk(x, "M"), lambda x: system.jacobian(x, "M"), system.fk):
            with pytest.raises(InputError, match=system.coordinate_names[k]):
                ask(q[2])
        others = [0, 1, 3, 4]
        for now, before in zip(
            (system.fk(q, "M"), system.jacobian(q, "M"), system.fk(q)[:, 1]),
            (good[0], good[1], good[2][:, 1]),
            strict=True,
        ):
            np.testing.assert_array_equal(now[others], before[others])
            assert np.isnan(now[2, :3]).all()
        assert np.isfinite(system.fk(q)[2, 0]).all()  # the ground does not depend on q


@pytest.mark.parametrize(
    "case",
    [
        c
        for c in CASES
        if c.kind.layout(c.dim, c.particle)[1][-1:]
        and c.kind.layout(c.dim, c.particle)[1][-1].kind == Q
    ],
    ids=str,
)
def test_zero_quaternions_are_refused_and_others_normalised(case):
    system = one_joint(case)
    q = system.neutral.copy()
    k = int(system.structure.layout.quaternion_q[0])
    for scale in (1e-300, 1e-160, 1.0, 1e160, 1e300):
        q[k : k + 4] = np.array([0.5, 0.5, -0.5, 0.5]) * scale
        expected = reference.ball(0.5, 0.5, -0.5, 0.5)[:3, :3].astype(float)
        np.testing.assert_allclose(system.fk(q, "M")[:3, :3], expected, rtol=0, atol=1e-15)
        moved = system.configuration_space.integrate(q, np.zeros(system.nv))
        np.testing.assert_allclose(moved[k : k + 4], [0.5, 0.5, -0.5, 0.5], rtol=0, atol=1e-15)
    q[k : k + 4] = 0.0
    with pytest.raises(InputError, match="quaternion"):
        system.fk(q, "M")
    assert np.isnan(system.fk(q[None], "M")[0, :3]).all()
    assert np.isnan(system.configuration_space.integrate(q, np.zeros(system.nv))[k : k + 4]).all()


# ------------------------------------------------------------------ velocities


@pytest.mark.parametrize("case", [c for c in CASES if not c.particle], ids=str)
def test_what_a_joint_forbids_is_what_never_moves(case):
    """Rows of the Jacobian in axes of F that are zero in all of many configurations; in the plane
    those of it.
    """
    system = one_joint(case)
    J = [
        system.jacobian(sample(system, np.random.default_rng(k)), "M", "world_aligned")
        for k in range(20)
    ]
    most = dict(
        zip(("x", "y", "z", "rx", "ry", "rz"), np.abs(J).max(axis=(0, 2), initial=0.0), strict=True)
    )
    still = [
        name for name in most if most[name] < 1e-9 and (case.dim == 3 or name in ("x", "y", "rz"))
    ]
    assert case.kind.forbids(case.dim) == tuple(still)
    assert len(still) <= case.kind.constraints(case.dim)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("two_link", "serial chain"),
        ("seven_bodies", "tree"),
        ("four_bar", "1 loop"),
        ("jansen", "3 loops"),
    ],
)
def test_kinds_of_systems(name, kind):
    assert kempe.load(name).kind == kind


def test_a_loop_is_opened():
    """The lecture's two figures: the joint that closes the loop is taken out, and with it what was
    said of it.
    """
    loop = kempe.load("four_bar")
    tree = loop.open_loops("C")
    assert (tree.kind, tree.joint_names, tree.mobility().dof) == ("tree", ("A", "B", "D"), 3)
    q = dict(zip(loop.coordinate_names, loop.q("closed"), strict=True))
    same = [q[name] for name in tree.coordinate_names]
    assert tree.q("closed").tolist() == same
    for body in loop.body_names:
        np.testing.assert_allclose(tree.fk(same, body), loop.fk(loop.q("closed"), body), atol=1e-14)
    assert kempe.load("jansen").open_loops().kind == "tree"
    with pytest.raises(UnknownNameError, match="there are: 'A', 'B', 'C', 'D'"):
        loop.open_loops("E")
    with pytest.raises(InputError, match="no loop to open: it is a tree"):
        tree.open_loops()
    with pytest.raises(DescriptionError, match="no joints lead"):
        loop.open_loops(["A", "B"])


@both_ways
@places
def test_motion_subspace_is_the_derivative_of_the_pose(case, backwards, placed):
    """Central differences on the manifold, of second order: (X(q (+) h e) - X(q (-) h e)) / 2h."""
    system = one_joint(case, backwards, placed)
    rng = np.random.default_rng(11)
    h = 1e-5
    q = sample(system, rng, 1.2)
    X = system.fk(q, "M")
    body, aligned, world = (system.jacobian(q, "M", f) for f in ("body", "world_aligned", "world"))
    for i in range(system.nv):
        step = h * np.eye(system.nv)[i]
        ahead = system.fk(system.configuration_space.integrate(q, step), "M")
        back = system.fk(system.configuration_space.integrate(q, -step), "M")
        twist = reference.twist_between(back, ahead, 2 * h)
        velocity = np.concatenate([(ahead - back)[:3, 3] / (2 * h), X[:3, :3] @ twist[3:]])
        np.testing.assert_allclose(
            body[:, i], np.concatenate([X[:3, :3].T @ velocity[:3], twist[3:]]), atol=1e-8
        )
        np.testing.assert_allclose(aligned[:, i], velocity, atol=1e-8)
        spatial_twist = velocity + np.concatenate([np.cross(X[:3, 3], velocity[3:]), np.zeros(3)])
        np.testing.assert_allclose(world[:, i], spatial_twist, atol=1e-8)


@every_case
@given(seed=st.integers(0, 10**6))
def test_integrate_and_difference_are_inverse(case, seed):
    system = one_joint(case)
    rng = np.random.default_rng(seed)
    q0 = sample(system, rng)
    q1 = sample(system, rng)
    v = system.configuration_space.difference(q0, q1)
    end = system.configuration_space.integrate(q0, v)
    np.testing.assert_allclose(system.fk(end, "M"), system.fk(q1, "M"), rtol=0, atol=1e-13)
    # antisymmetric
    np.testing.assert_allclose(
        system.configuration_space.difference(q1, q0), -v, rtol=0, atol=1e-12
    )
    small = rng.uniform(-1.0, 1.0, system.nv)
    np.testing.assert_allclose(
        system.configuration_space.difference(q0, system.configuration_space.integrate(q0, small)),
        small,
        rtol=0,
        atol=1e-13,
    )
    np.testing.assert_array_equal(
        system.configuration_space.difference(q0, q0), np.zeros(system.nv)
    )
    for i in system.structure.layout.quaternion_q:
        assert abs(np.linalg.norm(end[i : i + 4]) - 1) < 1e-15


@every_case
def test_random_stays_within_limits(case):
    names = [
        c
        for c in case.kind.list_coordinate_names(case.dim, case.particle)
        if c in case.kind.list_velocity_names(case.dim, case.particle)
    ]
    bounds = {n: (0.3 * i - 1.0, 0.3 * i - 0.9) for i, n in enumerate(names)}
    system = one_joint(case, limits=bounds or None)
    q = system.random(np.random.default_rng(0), 200)
    plain = system.structure.layout.vector_q
    lower = system.lower[system.structure.layout.vector_v]
    upper = system.upper[system.structure.layout.vector_v]
    assert np.all(q[:, plain] >= lower) and np.all(q[:, plain] <= upper)
    if len(plain):
        assert np.all(np.ptp(q[:, plain], axis=0) > 0.09)
    for i in system.structure.layout.quaternion_q:
        np.testing.assert_allclose(np.linalg.norm(q[:, i : i + 4], axis=-1), 1.0, atol=1e-14)
    assert np.all(system.mid[plain] >= lower) and np.all(system.mid[plain] <= upper)


# ------------------------------------------------------------------ composites: most joints are
# turns and slides


def chain_of_primitives(case: Case):
    """The joint as a chain of revolute, prismatic and spherical joints through intermediate bodies."""
    m = Mechanism("chain")
    names, primitives = case.kind.layout()
    here = m.ground
    made = {}
    for i, p in enumerate(primitives):
        body = m.body("M" if i == len(primitives) - 1 else f"between {i}")
        axis = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[p.axis]
        m.joint(
            f"c{i}",
            ("revolute", "prismatic", "spherical")[p.kind],
            here,
            body,
            **({} if p.kind == Q else {"axis": axis}),
        )
        if p.coordinate in made:
            m.gear(f"c{i}", made[p.coordinate], p.multiplier)
        made[p.coordinate] = f"c{i}"
        here = body
    return m.build()


@pytest.mark.parametrize(
    "case", [c for c in CASES if c.dim == 3 and not c.particle and c.type != "fixed"], ids=str
)
def test_composite_joints_are_chains_of_primitives(case):
    joint = one_joint(case)
    chain = chain_of_primitives(case)
    rng = np.random.default_rng(4)
    assert (joint.nq, joint.nv) == (chain.nq, chain.nv)
    for _ in range(5):
        q = sample(joint, rng)
        np.testing.assert_allclose(joint.fk(q, "M"), chain.fk(q, "M"), rtol=0, atol=1e-14)
        for frame in ("body", "world", "world_aligned"):
            np.testing.assert_allclose(
                joint.jacobian(q, "M", frame), chain.jacobian(q, "M", frame), rtol=0, atol=1e-13
            )


def test_what_the_lecture_says_the_composites_are():
    def kinds(name, **options):
        return "".join("RPQ"[p.kind] for p in make_joint_type(name, **options).layout()[1])

    assert kinds("universal") == "RR"
    assert sorted(kinds("cylindrical")) == sorted("RP")
    assert sorted(kinds("planar")) == sorted("PPR")
    assert kinds("spherical", angles=True) == "RRR"


@pytest.mark.parametrize("name", ["spherical", "free"])
@given(angles=st.tuples(*[st.floats(-3, 3)] * 3))
def test_quaternion_and_angles_are_one_joint(name, angles):
    ball = one_joint(Case(name))
    turns = one_joint(Case(name, options={"angles": True}))
    slides = [0.1, -0.2, 0.3] if name == "free" else []
    x, y, z, w = Rotation.from_euler("ZYX", angles).as_quat()
    np.testing.assert_allclose(
        ball.fk([*slides, w, x, y, z], "M"), turns.fk([*slides, *angles], "M"), rtol=0, atol=1e-13
    )


def test_a_screw_is_between_a_hinge_and_a_slider():
    hinge = one_joint(Case("revolute"))
    screw = one_joint(Case("helical", options={"pitch": 0.0}))
    np.testing.assert_array_equal(hinge.fk([0.7], "M"), screw.fk([0.7], "M"))
    steep = one_joint(Case("helical", options={"pitch": 1.0}))
    np.testing.assert_allclose(steep.jacobian([0.7], "M")[:, 0], [0, 0, 1, 0, 0, 1], atol=1e-16)


@pytest.mark.parametrize("case", [c for c in CASES if c.dim == 2])
def test_planar_systems_stay_in_the_plane(case):
    system = one_joint(case, placed=True)
    X = system.fk(system.random(0, 50), "M")
    assert (
        np.all(X[..., 2, :3] == [0, 0, 1])
        and np.all(X[..., :3, 2] == [0, 0, 1])
        and np.all(X[..., 2, 3] == 0)
    )
    J = system.jacobian(system.random(0, 50), "M")
    assert np.all(J[..., 2:5, :] == 0.0), case


# ------------------------------------------------------------------ records


@every_case
def test_types_and_systems_pickle(case):
    kind = case.kind
    system = one_joint(case, placed=True)
    assert pickle.loads(pickle.dumps(kind)) == kind
    copy = pickle.loads(pickle.dumps(system))
    assert (
        copy == system
        and hash(copy) == hash(system)
        and copy.structure.hash == system.structure.hash
    )
    q = sample(system, np.random.default_rng(0))
    np.testing.assert_array_equal(copy.fk(q), system.fk(q))


@both_ways
def test_description_survives_a_round_trip(case, backwards):
    system = one_joint(case, backwards, placed=True)
    assert read_toml(write_toml(system.mechanism)).build() == system


@every_case
def test_locked_joint_is_a_constant(case):
    system = one_joint(case, placed=True)
    rng = np.random.default_rng(9)
    q = sample(system, rng)
    held = system.mechanism.lock(
        dict(zip(system.coordinate_names, q.tolist(), strict=True))
    ).build()
    assert held.nq == held.nv == 0
    np.testing.assert_allclose(held.fk([], "M"), system.fk(q, "M"), rtol=0, atol=1e-15 * 10)
    assert held.jacobian([], "M").shape == (6, 0)
    assert held.fk(np.zeros((3, 0)), "M").shape == (3, 4, 4)


def test_every_option_is_named_and_checked():
    assert make_joint_type("helical", pitch=np.float32(0.5)) == Helical(pitch=0.5)
    assert make_joint_type("helical", pitch=1) == Helical(pitch=1.0)
    assert make_joint_type(Spherical(), angles=True) == Spherical(angles=True)
    assert make_joint_type(Spherical(angles=True)).options == {"angles": True}
    with pytest.raises(UnknownNameError, match="did you mean 'revolute'"):
        make_joint_type("revolut")
    for wrong in (None, 3, ["revolute"], Revolute):
        with pytest.raises(UnknownNameError, match="joint type"):
            make_joint_type(wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="'revolute' has no option 'pitch'; it takes no options"):
        make_joint_type("revolute", pitch=0.1)
    with pytest.raises(InputError, match="'helical' has no option 'lead'; it takes pitch"):
        make_joint_type("helical", lead=0.1)
    for wrong in ("0.1", np.nan, np.inf, True, None):
        with pytest.raises(InputError, match="'pitch'.*must be a finite number"):
            make_joint_type("helical", pitch=wrong)
    with pytest.raises(InputError, match="'angles'.*must be true or false"):
        make_joint_type("spherical", angles="yes")
    m = Mechanism()
    for wrong in ("steep", np.nan):
        with pytest.raises(DescriptionError, match="joint 'h'.*pitch"):
            m.helical("h", m.ground, m.body(f"b {wrong}"), pitch=wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [n for n, t in TYPES.items() if not t.planar])
def test_joints_of_space_are_refused_in_the_plane(name):
    m = Mechanism(dim=2)
    with pytest.raises(
        DescriptionError, match=f"joint 'j': a {name} joint does not exist in the plane; planar"
    ):
        m.joint("j", name, m.ground, m.body("b"))


@pytest.mark.parametrize(
    ("name", "dim"),
    [(n, dim) for n in TYPES for dim in (2, 3) if Case(n, dim=dim, particle=True) not in CASES],
)
def test_particles_take_slides_only(name, dim):
    m = Mechanism(dim=dim)
    with pytest.raises(
        DescriptionError, match="joint 'j'.*(particles take|does not exist in the plane)"
    ):
        m.joint("j", name, m.ground, m.particle("p"))


def test_kinds_are_what_the_kernels_expect():
    assert (R, P, Q) == (0, 1, 2)


# ------------------------------------------------------------------ products in words


@pytest.mark.parametrize(
    ("words", "normal", "coordinates", "velocities"),
    [
        ("P(x) R(z) R(y)", "P(x) R(z) R(y)", "x rz ry", "x rz ry"),
        (" P( x )R(z)\tR(y) ", "P(x) R(z) R(y)", "x rz ry", "x rz ry"),
        ("R(z) P(x) R(z) P(x)", "R(z) P(x) R(z) P(x)", "rz1 x1 rz2 x2", "rz1 x1 rz2 x2"),
        ("R(z) H(z, 1e-1) P(z)", "R(z) H(z, 0.1) P(z)", "rz1 rz2 z", "rz1 rz2 z"),
        ("P(y) Q P(y)", "P(y) S P(y)", "y1 qw qx qy qz y2", "y1 wx wy wz y2"),
        ("S", "S", "qw qx qy qz", "wx wy wz"),
        ("H(x,-.5)", "H(x, -0.5)", "", ""),
        ("R(y)", "R(y)", "", ""),
    ],
)
def test_products_in_words(words, normal, coordinates, velocities):
    kind = make_joint_type(words)
    assert (kind.type_name, kind.options) == (normal, {}) and kind == make_joint_type(
        normal
    ) == make_joint_type(kind)
    assert kind.list_coordinate_names() == tuple(coordinates.split() or [""])
    assert kind.list_velocity_names() == tuple(velocities.split() or [""])
    m = Mechanism()
    m.joint("J", words, m.ground, m.body("b"))
    assert f'type = "{normal}"' in write_toml(m)


def test_products_are_the_types_that_they_spell():
    same = {
        "universal": "R(x) R(y)",
        "cylindrical": "R(z) P(z)",
        "planar": "P(x) P(y) R(z)",
        "spherical": "S",
        "translation": "P(x) P(y) P(z)",
        "free": "P(x) P(y) P(z) S",
        "revolute": "R(z)",
    }
    for name, words in same.items():
        assert make_joint_type(name).layout() == make_joint_type(words).layout(), name
    assert make_joint_type("helical", pitch=0.2).layout() == make_joint_type("H(z, 0.2)").layout()
    assert (
        make_joint_type("spherical", angles=True).layout()
        == make_joint_type("R(z) R(y) R(x)").layout()
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("P(w)", r"'P\(w\)' is no primitive; R\(x\) turns, P\(x\) slides"),
        ("R", "'R' is no"),
        ("P(x)*R(z)", r"'\*' is no"),
        ("r(z)", r"'r\(z\)' is no"),
        ("H(x)", r"'H\(x\)' is no"),
        ("()", r"'\(' is no"),
        ("H(x, nan)", "is no primitive"),
        ("H(z, 1e999)", "is no primitive"),
        ("R(z, 2)", "is no primitive"),
        ("S Q", "more than one S"),
        (" ", "no primitive"),
        ("P(x) R(z", r"'R' is no"),
        ("R(٣)", "is no primitive"),
        ("H(z, ٣)", "is no primitive"),
        ("SS()", "is no primitive"),
    ],
)
def test_words_that_are_no_product(words, said):
    with pytest.raises((InputError, UnknownNameError), match=said):
        make_joint_type(words)
    m = Mechanism()
    for options, fault in (({}, said), ({"limit": 3}, "no keyword 'limit'"), ({"pitch": 3}, said)):
        with pytest.raises(DescriptionError, match=rf"joint 'J': .*{fault}"):
            m.joint("J", words, m.ground, m.body(f"b{options}"), **options)
    text = (
        'format = 1\nname = "m"\n[[body]]\nname = "b"\n[[joint]]\nname = "J"\ntype = '
        f'"{words}"\nparent = "ground"\n'
    )
    with pytest.raises(DescriptionError, match=f":7: joint 'J': .*{said.removeprefix('no ')}"):
        read_toml(text + 'child = "b"\n')


def test_where_products_do_not_fit():
    with pytest.raises(
        InputError, match=r"joint type 'P\(x\) R\(z\)' has no option 'words'; it takes no options"
    ):
        make_joint_type("P(x) R(z)", words="S")
    with pytest.raises(UnknownNameError, match=r"'free', 'P\(x\) R\(z\)'"):
        make_joint_type("knee")
    flat = Mechanism(dim=2)
    m = Mechanism()
    for words in ("P(x) R(y)", "S", "H(z, 0.1)", "P(x) P(z)"):
        with pytest.raises(
            DescriptionError, match=r"joint 'J': a .* joint leaves the plane; in the plane"
        ):
            flat.joint("J", words, flat.ground, flat.body(words))
    with pytest.raises(
        DescriptionError, match=r"a P.* joint turns, but 'p' is a particle; .*products of slides"
    ):
        m.joint("J", "P(x) R(z)", m.ground, m.particle("p"))
    m = Mechanism()
    m.joint("J", "P(x) R(z)", m.ground, m.body("b"), limits={"x": (-1, 1)})
    with pytest.raises(
        DescriptionError, match=r"joint 'J': a P\(x\) R\(z\) joint does not exist in URDF"
    ):
        write_urdf(m)


def test_random_products(hunt):
    """Poses of random products are the reference's, and files hold them."""
    rng = hunt.rng()
    for _ in range(hunt.cases(100)):
        dim = int(rng.choice([2, 3]))
        case = Case(own_joints.random_product(rng, dim), dim)
        system = one_joint(case, placed=True)
        q = sample(system, rng)
        np.testing.assert_allclose(
            system.fk(q, "M"), expected_pose(case, q, placed=True), rtol=0, atol=1e-12
        )
        assert read_toml(write_toml(system.mechanism)).build() == system


def test_a_joint_is_one_of_space_where_nothing_is_said():
    """Also one whose motions stand in a table by the dimension."""

    class Slab(JointType):
        """Slides, and in space a ball."""

        def layout(self, dim: int = 3, particle: bool = False):
            """By the dimension."""
            flat = (Primitive(P, "x", 0), Primitive(P, "y", 1))
            return {
                2: (("x", "y"), flat),
                3: (("x", "y", "qw", "qx", "qy", "qz"), (*flat, Primitive(Q, "z", 2))),
            }[dim]

    kind = Slab()
    assert (kind.dof(), kind.constraints(), kind.forbids()) == (
        5,
        1,
        ("z",),
    )
    assert (kind.dof(2), kind.constraints(2), kind.forbids(2)) == (
        2,
        1,
        ("rz",),
    )
    assert (
        kind.list_velocity_names() == ("x", "y", "wx", "wy", "wz")
        and len(kind.list_coordinate_names()) == 6
    )
