"""The lecture on multibody systems, statement by statement, in its order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from command import Result
from hypothesis import given
from hypothesis import strategies as st

import kempe
from kempe import Mechanism, System, spatial
from kempe.forward.maximal import maximal_q
from kempe.joints import TYPES, Spherical, make_joint_type
from kempe.library import lecture
from kempe.model.structural_order import make_sort_key


def dof_by_counting(system: System) -> int:
    """Freedoms of all bodies without joints, less the constraints that each joint imposes."""
    free = 6 if system.dim == 3 else 3
    return free * len(system.parent) - sum(
        j.type.constraints(system.dim) for j in system.structure.joints.values()
    )


def dimension_here(system: System, q: np.ndarray) -> int:
    """Dimension of the configuration space at a configuration: coordinates less independent closure
    constraints.
    """
    if not system.structure.closures:
        return system.nv
    h = 1e-6
    ahead, back = (
        system.loops.closure_error(
            system.configuration_space.integrate(q, step * np.eye(system.nv))
        )
        for step in (h, -h)
    )
    rows = ((ahead - back) / (2 * h)).reshape(system.nv, -1)
    return system.nv - int(np.linalg.matrix_rank(rows, tol=1e-6))


# ------------------------------------------------------------------ constraints and degrees of
# freedom


def test_a_prismatic_joint_leaves_one_dof_and_imposes_five_constraints():
    system = kempe.load("slider")
    joint = system.structure.joints["J6"]
    assert (joint.parent, joint.child) == ("B0", "B5")
    assert joint.type.dof() == 1 and joint.type.constraints() == 5
    assert system.nq == 1, "one parameter specifies the position of B5 relative to B0"
    moved = system.fk([[0.0], [0.1], [-0.7]], "B5")
    np.testing.assert_array_equal(moved[:, :3, :3], np.tile(np.eye(3), (3, 1, 1)))
    # along one fixed axis
    np.testing.assert_array_equal(moved[:, :3, 3], [[0, 0, 0], [0.1, 0, 0], [-0.7, 0, 0]])


def test_an_unconstrained_rigid_body_has_six_dof():
    system = kempe.load("joint_free")
    assert system.nv == 6 and system.structure.joints["joint"].type.constraints() == 0
    m = Mechanism("plane", dim=2)
    m.free("J", m.ground, m.body("b"))
    assert m.build().nv == 3, "two translations and one rotation"
    for dim in (2, 3):
        m = Mechanism("particle", dim)
        m.free("J", m.ground, m.particle("p"))
        assert m.build().nv == dim


def test_counting_dof_of_the_planar_system():
    system = kempe.load("four_links")
    kinds = [j.type.type_name for j in system.structure.joints.values()]
    assert (
        len(system.parent) == 4 and kinds.count("revolute") == 4 and kinds.count("prismatic") == 1
    )
    assert all(j.type.constraints(2) == 2 for j in system.structure.joints.values()), (
        "each joint imposes two constraints"
    )
    assert 4 * 3 == 12 and dof_by_counting(system) == 12 - 5 * 2 == 4 * (3 - 2) - 2 == 2
    tree = [j for j in system.joint_names if j not in system.structure.closures]
    assert len(tree) == 4 and len(system.structure.closures) == 1, (
        "one joint a link, and for the last one another"
    )


def test_the_same_reasoning_in_space():
    system = kempe.load("seven_bodies")
    assert dof_by_counting(system) == 7 * (6 - 5) == system.nv == 7


@pytest.mark.parametrize(
    "name", ["slider", "two_link", "seven_bodies", "four_links", "four_bar", "car"]
)
def test_dof_is_the_dimension_of_the_configuration_space(name):
    system = kempe.load(name)
    q = system.q("closed") if system.structure.closures else system.random(0)
    assert dimension_here(system, q) == dof_by_counting(system)
    if not system.structure.closures:
        assert system.configuration_space.dimension == system.nv


def test_the_loop_through_j6():
    """Its axes are parallel, so counting, which knows no lengths and axes, is three constraints too
    strict.
    """
    system = kempe.load("seven_bodies_loop")
    assert dof_by_counting(system) == 7 - 5 == 2
    assert dimension_here(system, system.q("closed")) == 8 - 3 == 5


# ------------------------------------------------------------------ types of joints


@pytest.mark.parametrize(
    "kind, dof",
    [
        ("revolute", 1),
        ("cylindrical", 2),
        ("planar", 3),
        ("prismatic", 1),
        ("universal", 2),
        ("spherical", 3),
    ],
)
def test_dof_of_the_types(kind, dof):
    assert TYPES[kind]().dof() == dof


COMBINATIONS = [
    (make_joint_type("universal"), [("revolute", "x"), ("revolute", "y")]),
    (make_joint_type("cylindrical"), [("revolute", "z"), ("prismatic", "z")]),
    (make_joint_type("planar"), [("prismatic", "x"), ("prismatic", "y"), ("revolute", "z")]),
    (Spherical(angles=True), [("revolute", "z"), ("revolute", "y"), ("revolute", "x")]),
]


@pytest.mark.parametrize("kind, parts", COMBINATIONS, ids=lambda x: getattr(x, "type_name", ""))
def test_joints_are_combinations_of_revolute_and_prismatic_ones(kind, parts):
    assert kind.decomposition == " ".join(f"{part[0].upper()}({axis})" for part, axis in parts)
    m = Mechanism("combination")
    whole = m.body("whole")
    here = m.ground
    m.joint("whole", kind, here, whole)
    for i, (part, axis) in enumerate(parts):
        link = m.body(f"link{i}")
        m.joint(f"part{i}", part, here, link, axis=np.eye(3)["xyz".index(axis)])
        here = link
    system = m.build()
    n = len(parts)
    q = system.random(0, 5)
    q[:, :n] = q[:, n:]
    np.testing.assert_allclose(system.fk(q, "whole"), system.fk(q, here), rtol=0, atol=1e-14)


# ------------------------------------------------------------------ configurations


def test_two_ways_to_give_a_configuration():
    """Pairs (r, R) of n_b bodies with m_c constraints, or as many generalized positions as there
    are DoF.
    """
    system = kempe.load("seven_bodies")
    q = system.random(0)
    assert q.shape == (7,)
    m = Mechanism("pairs", ground="B0")
    m.parameters = dict(system.structure.parameters)
    for body in system.body_names[1:]:
        m.free(f"pair {body}", "B0", m.body(body))
    for joint in system.structure.joints.values():
        m.joint(
            joint.name,
            joint.type,
            joint.parent,
            joint.child,
            at=joint.X_PF,
            child_at=joint.X_CM,
            cut=True,
        )
    pairs = m.build()
    assert pairs.structure.closures == system.joint_names
    # the joints' own coordinates are part of it, as of every configuration
    space = pairs.configuration_space
    assert space.ambient_dimension - 7 == 7 * 6 == space.constraints and space.dimension == 7
    values = system.q_dict(q)
    for body, X in zip(system.body_names[1:], system.fk(q)[1:], strict=True):
        numbers = [*X[:3, 3], *spatial.matrix_to_quat_wxyz(X[:3, :3])]
        values |= {
            f"pair {body}.{c}": x for c, x in zip("x y z qw qx qy qz".split(), numbers, strict=True)
        }
    np.testing.assert_allclose(pairs.loops.closure_error(pairs.q(values)), 0.0, rtol=0, atol=1e-14)
    values["pair B5.x"] += 0.01
    assert np.abs(pairs.loops.closure_error(pairs.q(values))).max() > 0.005, (
        "now joint J5 is torn apart"
    )


def test_open_chains_take_any_joint_angles_and_closed_ones_do_not():
    tree = kempe.load("seven_bodies")
    loop = kempe.load("four_bar")
    assert tree.structure.closures == () and tree.loops.closure_error(tree.random(0)).shape == (
        0,
        6,
    )
    assert np.abs(loop.loops.closure_error(loop.random(0))).max() > 0.01
    np.testing.assert_allclose(loop.loops.closure_error(loop.q("closed")), 0.0, rtol=0, atol=1e-14)
    assert dimension_here(loop, loop.q("closed")) == 1, "only one angle can be set independently"


def test_additional_considerations_decide_between_two_assemblies():
    """The same crank angle, the same loop closed: coupler and rocker mirrored in the line between
    their ends.
    """
    loop = kempe.load("four_bar")
    first = loop.q_dict(loop.q("closed"))
    a, b, c, d = (loop.structure.parameters[k] for k in "abcd")
    B = a * np.array([math.cos(first["A"]), math.sin(first["A"])])
    D = np.array([d, 0.0])
    C = B + b * np.array([math.cos(first["A"] + first["B"]), math.sin(first["A"] + first["B"])])
    along = (D - B) / np.linalg.norm(D - B)
    mirrored = B + 2 * along * (along @ (C - B)) - (C - B)
    coupler, rocker = (math.atan2(v[1], v[0]) for v in (mirrored - B, mirrored - D))
    second = loop.q(
        {"A": first["A"], "B": coupler - first["A"], "C": rocker - coupler, "D": rocker}
    )
    np.testing.assert_allclose(loop.loops.closure_error(second), 0.0, rtol=0, atol=1e-14)
    assert np.abs(loop.fk(second, "rocker") - loop.fk(first, "rocker")).max() > 0.5
    assert math.dist(mirrored, D) == pytest.approx(c)


CLOSED = [
    "four_links",
    "seven_bodies_loop",
    "four_bar",
    "five_bar",
    "bennett",
    "sarrus",
    "three_rpr",
]


@pytest.mark.parametrize("name", CLOSED)
def test_only_p_joint_angles_of_a_closed_loop_can_be_set_independently(name):
    """With p of them set, inside a neighbourhood, the loop closes; with one more, set elsewhere, it
    does not.
    """
    system = kempe.load(name)
    home = system.q("closed")
    chart = system.independent(home)
    assert chart.dim == system.mobility(home).dof == dimension_here(system, home)
    u = chart.u(home) + 0.02
    q = chart.q(u, home)
    assert q, q.status
    np.testing.assert_allclose(chart.u(q.q), u, rtol=0, atol=1e-14)
    np.testing.assert_allclose(system.loops.closure_error(q.q), 0.0, rtol=0, atol=1e-9)
    one_more = next(n for n in chart.dependent if n in system.coordinate_names)
    values = system.q_dict(q.q)
    known = {n: values[n] for n in chart.independent}
    assert not system.assemble({**known, one_more: values[one_more] + 0.01}, q.q)


def test_the_additional_considerations_are_arguments():
    """Both assemblies of the loop: by start, by name, and listed; limits that only one of them
    respects choose, too.
    """
    system = kempe.load("four_bar")
    q = system.q("closed")
    modes = system.assembly_modes({"A": q[0]}, start=q)
    assert len(modes) == 2 and modes.complete
    np.testing.assert_allclose(modes.q[0], q, rtol=0, atol=1e-12)
    for name, mode in zip(modes.branches, modes.q, strict=True):
        for found in (
            system.assemble({"A": q[0]}, mode),
            system.assemble({"A": q[0]}, branch=name),
        ):
            assert found and apart(found.q, tuple(mode)) < 1e-9
    m = system.mechanism
    m.joints["C"] = replace(m.joints["C"], limits={"": (-math.pi, 0.0)})
    m.postures.clear()
    limited = m.build()
    found = limited.assemble({"A": q[0]}, q)
    assert found and apart(found.q, tuple(modes.q[1])) < 1e-9


@pytest.mark.parametrize("u", [0.0, 0.4, 0.8])
def test_two_parametrizations_of_a_closed_loop_and_the_ways_between_them(u):
    """The lecture's pairs (r, R) with constraints; generalized positions, as many as DoF, without
    any.
    """
    system = kempe.load("jansen")
    chart = system.independent()
    n_b = len(system.parent)
    q = chart.q([u]).q
    pairs = kempe.convert.to_maximal(system, q)
    assert pairs.shape == (n_b, 4, 4) and chart.dim <= n_b, "n <= n_b"
    at = maximal_q(system, q)
    assert np.abs(kempe.convert.maximal(system).loops.closure_error(at)).max() < 1e-12
    m = kempe.convert.maximal(system).mobility(at)
    assert (m.counting.free, m.counting.taken) == (21, 20) and m.rank_dof == m.dof == chart.dim == 1
    assert chart.u(kempe.convert.from_maximal(system, pairs, start=q)) == pytest.approx(
        [u], abs=1e-12
    )


def test_configuration_space_and_task_space_of_the_two_link_arm():
    system = kempe.load("two_link")
    assert str(system.configuration_space).startswith("T^2, dimension 2")
    J = system.jacobian(system.random(0), "e")[:2]
    assert np.linalg.matrix_rank(J) == 2, "the task space is spanned by x0 and y0: m = n = 2"


# ------------------------------------------------------------------ the forward geometric model


def test_fgm_position_and_orientation_separately():
    system = kempe.load("two_link")
    l1 = system.structure.parameters["l1"]
    l2 = system.structure.parameters["l2"]
    q1 = 0.4
    q2 = -1.1
    R01 = spatial.rot_z(q1)
    R12 = spatial.rot_z(q2)
    p_e = R01 @ (np.array([l1, 0, 0]) + R12 @ [l2, 0, 0])
    X = system.fk([q1, q2], "e")
    np.testing.assert_allclose(X[:3, 3], p_e, rtol=0, atol=1e-14)
    np.testing.assert_allclose(X[:3, :3], R01 @ R12, rtol=0, atol=1e-14)
    formula = [
        l1 * math.cos(q1) + l2 * math.cos(q1 + q2),
        l1 * math.sin(q1) + l2 * math.sin(q1 + q2),
    ]
    np.testing.assert_allclose(p_e[:2], formula, rtol=0, atol=1e-14)


def test_fgm_in_symbols():
    pytest.importorskip("sympy")
    T = kempe.load("two_link").symbolic.fk("e")
    assert (
        str(T[0, 3]) == "l1*cos(q1) + l2*cos(q1 + q2)"
        and str(T[1, 3]) == "l1*sin(q1) + l2*sin(q1 + q2)"
    )


def test_fgm_by_multiplying_n_homogeneous_matrices():
    system = kempe.load("panda")
    q = system.random(0)
    poses = system.fk(q)
    product = np.eye(4)
    for i in range(1, 8):
        step = spatial.inverse(poses[i - 1]) @ poses[i]  # the matrix of body i seen from body i - 1
        alone = system.fk(system.q({f"panda_joint{i}": q[i - 1]}))
        np.testing.assert_allclose(
            step, spatial.inverse(alone[i - 1]) @ alone[i], rtol=0, atol=1e-14
        )
        product = product @ step
        np.testing.assert_array_equal(product[3], [0, 0, 0, 1])  # again a homogeneous matrix
        np.testing.assert_allclose(
            product[:3, :3] @ product[:3, :3].T, np.eye(3), rtol=0, atol=1e-14
        )
        assert np.linalg.det(product[:3, :3]) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(product, system.fk(q, "panda_link7"), rtol=0, atol=1e-14)


def test_any_convention_for_the_frames_gives_the_same_end_effector():
    """Frames of one's own, Denavit and Hartenberg's, and screw axes."""
    own = kempe.load("two_link").with_parameters(l1=0.5, l2=0.4)
    table = kempe.from_dh([{"a": 0.5}, {"a": 0.4}]).build()
    screws = kempe.from_screws(
        [{"axis": (0, 0, 1)}, {"axis": (0, 0, 1), "point": (0.5, 0, 0)}], {"at": (0.9, 0, 0)}
    )
    q = own.random(0, 10)
    for other in (table, screws.build()):
        np.testing.assert_allclose(other.fk(q, "tool"), own.fk(q, "e"), rtol=0, atol=1e-14)


# ------------------------------------------------------------------ connectivity


@pytest.mark.parametrize(
    "name, joints", [("seven_bodies", "1234567"), ("seven_bodies_loop", "1234578")]
)
def test_connectivity(name, joints):
    system = kempe.load(name)
    assert system.parent == (0, 1, 2, 1, 4, 4, 2)
    assert system.body_names == tuple(f"B{i}" for i in range(8))
    assert system.structure.parent_joints == tuple(f"J{i}" for i in joints)
    for i, C_i in enumerate(system.parent, 1):  # P(B_i) = C_i
        joint = system.structure.joints[system.structure.parent_joints[i - 1]]
        assert (joint.parent, joint.child) == (f"B{C_i}", f"B{i}")


def test_connectivity_prints():
    assert "C = {0, 1, 2, 1, 4, 4, 2}" in Result("info", "seven_bodies").out


def test_joint_i_is_the_parent_joint_of_body_i():
    system = kempe.load("seven_bodies")
    assert sorted(system.joint_names, key=make_sort_key) == list(system.structure.parent_joints)


def test_j6_closes_the_loop():
    system = kempe.load("seven_bodies_loop")
    joint = system.structure.joints["J6"]
    assert system.structure.closures == ("J6",) and joint.type.type_name == "prismatic"
    assert (joint.parent, joint.child) == ("B0", "B5")


# ------------------------------------------------------------------ the inverse geometric model


def closed_form(x: float, y: float, l1: float, l2: float) -> list[tuple[float, float]]:
    """All (q1, q2) of the two-link arm by the lecture's formulas, elbow-up (sin q2 < 0) first."""
    c2 = (x * x + y * y - l1 * l1 - l2 * l2) / (2 * l1 * l2)
    if not -1 <= c2 <= 1:
        return []
    out = []
    for s2 in (-math.sqrt(1 - c2 * c2), math.sqrt(1 - c2 * c2)):
        alpha = math.atan2(y, x)
        beta = math.atan2(l2 * s2, l1 + l2 * c2)
        out.append((alpha - beta, math.atan2(s2, c2)))
    return out


def apart(q: np.ndarray, other: tuple[float, float]) -> float:
    """Largest angle between two configurations."""
    return float(np.abs((q - other + math.pi) % (2 * math.pi) - math.pi).max())


def test_two_configurations_reach_p():
    system = kempe.load("two_link")
    p = system.fk(system.neutral, "p")[:2, 3]
    solutions = closed_form(*p, *system.structure.parameters.values())
    for posture, expected in zip(("elbow_up", "elbow_down"), solutions, strict=True):
        q = system.q(posture)
        assert (math.sin(q[1]) < 0) == (posture == "elbow_up")
        np.testing.assert_allclose(q, expected, rtol=0, atol=1e-14)
        np.testing.assert_allclose(system.fk(q, "e")[:2, 3], p, rtol=0, atol=1e-14)
    elbow = system.fk(solutions[0], "B2")[:2, 3]
    assert elbow[1] / elbow[0] > p[1] / p[0], "up: the elbow is above the line to p"


@given(
    radius=st.floats(0.11, 0.89),
    direction=st.floats(-math.pi, math.pi),
    elbow=st.sampled_from([0, 1]),
    off=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
)
def test_the_numerical_igm_finds_the_analytical_solutions(radius, direction, elbow, off):
    """It starts from a guess, and ends in the solution on that side."""
    system = kempe.load("two_link")
    p = [radius * math.cos(direction), radius * math.sin(direction)]
    solutions = closed_form(*p, 0.5, 0.4)
    assert min(apart(system.ik(p, "e").q, q) for q in solutions) < 1e-4
    guess = np.add(solutions[elbow], off)
    if math.sin(guess[1]) * math.sin(solutions[elbow][1]) > 0:
        s = system.ik(p, "e", start=guess)
        assert s.success and s.starts == 1
        assert apart(s.q, solutions[elbow]) < 1e-4


@given(radius=st.floats(0.0, 2.0), direction=st.floats(-math.pi, math.pi))
def test_outside_the_workspace_if_and_only_if_c2_is_no_cosine(radius, direction):
    system = kempe.load("two_link")
    p = [radius * math.cos(direction), radius * math.sin(direction)]
    c2 = (radius**2 - 0.41) / 0.4
    if abs(abs(c2) - 1) > 1e-4:
        found = system.ik(p, "e", budget=kempe.Budget(starts=20))
        assert bool(found) == (abs(c2) < 1) == bool(closed_form(*p, 0.5, 0.4))


def test_igm_without_a_solution():
    system = kempe.load("unreachable")
    p = system.fk(system.neutral, "p")[:2, 3]
    assert closed_form(*p, *system.structure.parameters.values()) == []
    s = system.ik(p, "e")
    assert not s.success and s.status.startswith("outside the workspace by at least 0.1 m")
    # stretched towards p
    np.testing.assert_allclose(system.fk(s.q, "e")[:2, 3], 0.9 * p, rtol=0, atol=1e-6)


def test_more_task_constraints_than_dof():
    """m = 3 > n = 2: position and orientation, in general, have no solution, though the position
    alone has.
    """
    system = kempe.load("two_link_pose")
    P = system.fk(system.neutral, ["p", "p_down"])
    s = system.ik(P[0], "e")
    assert not s.success and "3 equations" in s.status and "2 freedoms" in s.status
    assert system.ik(P[0], "e", task="position").success
    lucky = system.ik(P[1], "e")
    assert lucky.success and apart(lucky.q, tuple(system.q("elbow_down"))) < 1e-4


def test_redundancy_and_further_constraints():
    """The numerical method takes more joints than the task needs, and limits, in its stride."""
    m = Mechanism("three-link", dim=2)
    here = m.ground
    for i in (1, 2, 3):
        m.revolute(f"q{i}", here, m.body(f"B{i}"), at=(0.3 if i > 1 else 0, 0), limits=(-1.0, 1.5))
        here = f"B{i}"
    m.frame("e", here, at=(0.3, 0))
    system = m.build()
    answers = system.ik(system.fk(system.random(0, 50), "e"), "e", task="position")
    assert answers.success.all()
    assert (answers.q >= -1.0).all() and (answers.q <= 1.5).all()


def test_zero_lengths():
    """The formulas assume l1, l2 != 0; the model itself does not."""
    system = kempe.load("two_link").with_parameters(l2=0.0)
    assert isinstance(system, System)
    np.testing.assert_allclose(
        system.fk([0.3, 1.0], "e")[:3, 3], spatial.rot_z(0.3) @ [0.5, 0, 0], rtol=0, atol=1e-14
    )
    assert system.ik([0.3, 0.4], "e").success
    assert system.ik([0.3, 0.3], "e").status.startswith("outside the workspace")


# ------------------------------------------------------------------ constraints, again


def test_each_holonomic_constraint_removes_one_dof():
    """f(q) = q3 - q1 - q2 = 0 on a tree of three joints."""
    m = Mechanism("constrained", dim=2)
    here = m.ground
    for i in (1, 2, 3):
        m.revolute(f"q{i}", here, m.body(f"B{i}"))
        here = f"B{i}"
    free = m.build().configuration_space
    m.couple("q3", {"q1": 1.0, "q2": 1.0})
    space = m.build().configuration_space
    assert free.dimension == free.ambient_dimension == 3
    assert space.dimension == space.ambient_dimension - space.constraints == 2


def test_a_car_has_three_dof():
    """It cannot move sideways at an instant, but it reaches any configuration in the plane."""
    system = kempe.load("car")
    assert system.nv == 3
    target = spatial.pose(spatial.rot_z(2.0), [-3.0, 7.0, 0.0])
    s = system.ik(target, "car")
    assert s.success
    np.testing.assert_allclose(s.q, [-3.0, 7.0, 2.0], rtol=0, atol=1e-6)


def test_a_ball_stays_above_the_ground():
    """A unilateral constraint, f(q) = z - r >= 0, removes no DoF."""
    system = kempe.load("ball")
    assert system.nv == 6
    z = system.coordinate_names.index("flight.z")
    s = system.ik([1.0, 2.0, -0.5], "ball")
    assert not s.success and "violating 'ground plane' by 0.6 m" in s.status
    assert s.q[z] == pytest.approx(0.1, abs=1e-9)
    assert system.ik([1.0, 2.0, 0.5], "ball").success


# ------------------------------------------------------------------ the page about the lecture


def test_the_sections_of_the_page_run():
    """One by one, as the tour shows them; its pictures are drawn in test_tour."""
    pytest.importorskip("sympy")
    pytest.importorskip("matplotlib")
    text = "\n".join(
        text
        for x in lecture.read_sections()
        for kind, text in lecture.iterate_parts(x)
        if kind == "output"
    )
    assert "False" not in text and "left out" not in text
