"""The lecture's statements one by one, numbered in their order: each is tried by the calls that a
student would type.

A test's name has the number, its first line quotes the lecture. Those that `test_lecture` tests are
in `ELSEWHERE`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import test_lecture as lecture
from drawn import artists as all_artists

import kempe
from kempe import Mechanism, tasks
from kempe.errors import InputError, KempeError
from kempe.joints import TYPES

ELSEWHERE: dict[int, Callable[..., object]] = {
    8: lecture.test_j6_closes_the_loop,
    11: lecture.test_a_prismatic_joint_leaves_one_dof_and_imposes_five_constraints,
    15: lecture.test_a_prismatic_joint_leaves_one_dof_and_imposes_five_constraints,
    18: lecture.test_an_unconstrained_rigid_body_has_six_dof,
    19: lecture.test_counting_dof_of_the_planar_system,
    28: lecture.test_joints_are_combinations_of_revolute_and_prismatic_ones,
    42: lecture.test_only_p_joint_angles_of_a_closed_loop_can_be_set_independently,
    44: lecture.test_the_additional_considerations_are_arguments,
    56: lecture.test_fgm_position_and_orientation_separately,
    65: lecture.test_fgm_in_symbols,
    67: lecture.test_fgm_by_multiplying_n_homogeneous_matrices,
    70: lecture.test_any_convention_for_the_frames_gives_the_same_end_effector,
    72: lecture.test_connectivity,
    82: lecture.test_igm_without_a_solution,
    98: lecture.test_outside_the_workspace_if_and_only_if_c2_is_no_cosine,
}


def artists(ax) -> dict[str, Any]:
    """The first artist of each name in a picture."""
    return {name: found[0] for name, found in all_artists(ax).items()}


P = (0.6, 0.3)
"""The lecture's point, in reach of both elbows."""


@pytest.fixture
def arm() -> kempe.System:
    return kempe.load("two_link")


@pytest.fixture
def four_bar() -> kempe.System:
    return kempe.load("four_bar")


@pytest.fixture
def three_links() -> kempe.System:
    m = Mechanism("3R", dim=2)
    here = m.ground
    for i in (1, 2, 3):
        here = m.revolute(f"q{i}", here, m.body(f"B{i}"), at=(0.3 if i > 1 else 0, 0)).child
    m.frame("e", here, at=(0.3, 0))
    return m.build()


def test_all_statements_are_tried():
    own = {int(m[1]) for name in globals() if (m := re.match(r"test_(\d+)_", name))}
    assert own.isdisjoint(ELSEWHERE), "one place holds a statement"
    assert own | set(ELSEWHERE) == set(range(1, 108))


# ------------------------------------------------------------------ opening


def test_1_main_points(arm):
    """'multibody systems, constraints and DoF, forward, inverse geometric model'"""
    assert (
        arm.mobility().dof == 2
        and arm.fk([0, 0], "e")[0, 3] == pytest.approx(0.9)
        and arm.ik(P, "e")
    )


def test_2_a_particle():
    """'we started by analyzing the motion of a particle (mass point)'"""
    m = Mechanism("point")
    m.free("J", m.ground, m.particle("P"))
    assert str(m.build().configuration_space) == "R^3, dimension 3"


def test_3_a_rigid_body_is_a_collection_of_particles():
    """'we considered a rigid body as a collection of particles'"""
    m = Mechanism("four particles")
    for n in "abcd":
        m.free(n.upper(), m.ground, m.particle(n))
    for a, b in ("ab", "ac", "ad", "bc", "bd", "cd"):
        m.distance(a + b, a, b, length=1.0)
    found = m.build().mobility()
    assert (
        found.dof == 6
        and "4 x 3 = 12 DoF" in found.counting.steps[0]
        and "12 - 6 = 6" in found.counting.steps[1]
    )


def test_4_how_to_specify_the_position():
    """'How do we specify the position of a multibody system?'"""
    tree = kempe.load("seven_bodies")
    q = tree.q({"J3": 0.1})
    assert tree.q_dict(q)["J3"] == 0.1 and tree.fk(q).shape == (8, 4, 4)


# ------------------------------------------------------------------ a multibody system


def test_5_bodies_and_joints_have_their_names():
    """'Figure: system (B_i and J_i stand for rigid body i and joint i)'"""
    tree = kempe.load("seven_bodies")
    drawn = artists(tree.plot(labels=("bodies", "joints")))
    assert {f"label:body:B{i}" for i in range(8)} | {f"label:J{i}" for i in range(1, 8)} <= set(
        drawn
    )
    assert drawn["label:body:B5"].get_text() == "B5"
    with pytest.raises(InputError, match="labels has 'bodie'"):
        tree.plot(labels="bodie")


def test_6_seven_bodies_prismatic_and_revolute():
    """'seven rigid bodies, interconnected through a set of prismatic and revolute joints'"""
    system = kempe.load("seven_bodies_loop")
    kinds = {j.type.type_name for j in system.structure.joints.values()}
    assert len(system.parent) == 7 and kinds == {"prismatic", "revolute"}


def test_7_what_specifies_the_posture_of_each_component():
    """'has to uniquely specify the posture of each component'"""
    system = kempe.load("four_links")
    assert system.independent(prefer=["J1", "J5"]).independent == ("J1", "J5")
    with pytest.raises(
        InputError, match="J1, J2 cannot be set independently here.*the best choice is J1, J5"
    ):
        system.independent(prefer=["J1", "J2"])


# ------------------------------------------------------------------ constraints


def test_9_figure_of_b5_on_j6():
    """'Figure: B_5 on J_6 relative to B_0': both bodies named, the motion shown by positions beside
    it.
    """
    drawn = artists(kempe.load("slider").plot(labels=("bodies", "joints"), motion=True))
    assert {"label:J6", "label:body:B0", "ghost0:B5", "ghost1:B5"} <= set(drawn)
    assert any("B5" in name for name in drawn if name.startswith("label:body"))


def test_10_a_joint_as_a_constraint():
    """'J_6 as a constraint that limits the motion of B_5 relative to B_0 to be only along one fixed
    axis'
    """
    J6 = kempe.load("slider").structure.joints["J6"]
    assert len(J6.type.forbids()) == 5
    assert J6.forbids() == (
        "B5 cannot slide along y or z, nor turn about x, y or z of B0: "
        "5 of 6 freedoms are taken away"
    )


def test_12_constraints_are_limitations():
    """'We will think of constraints as limitations (restrictions) to the motion'"""
    system = kempe.load("seven_bodies_loop")
    (closing,) = system.loops.constraints()
    assert (
        closing.name == "J6"
        and np.abs(system.loops.closure_error(system.assemble().q)).max() < 1e-12
    )


def test_13_independent_variables():
    """'the number of independent variables required to determine the system configuration'"""
    system = kempe.load("four_links")
    chart = system.independent()
    assert chart.dim == len(chart.independent) == system.mobility().dof == 2


def test_14_dof_of_one_body_relative_to_another():
    """'B_5 has only one DoF relative to B_0'"""
    system = kempe.load("seven_bodies_loop")
    found = system.loops.relative_motion(system.assemble().q, "B5", "B0")
    assert str(found) == "1 DoF of B5 relative to B0: a slide along x"
    assert str(system.mobility(local=False).relative("B5", "B0")) == str(found)


def test_16_a_free_body():
    """'an unconstrained rigid body has 6 DoF'"""
    free = kempe.load("joint_free")
    assert str(free.configuration_space) == "R^3 x SO(3), dimension 6"
    assert free.mobility().counting.steps[2] == "Each body is held by one joint: 1 x (6 - 0) = 6."


# ------------------------------------------------------------------ counting DoF


def test_17_figure_of_four_links():
    """'The figure depicts a planar system with four links, four revolute joints, one prismatic
    joint'
    """
    drawn = artists(kempe.load("four_links").plot(labels=("bodies", "joints")))
    assert {f"label:body:B{i}" for i in (1, 2, 3, 4)} | {
        "link:B1",
        "link:B2",
        "link:B3",
        "block:J5",
    } <= set(drawn)


@pytest.mark.parametrize(
    ("step", "text"),
    [
        (0, "4 bodies could move freely in the plane: 4 x 3 = 12 DoF"),
        (2, "Each body is held by one joint (the last by two): 4 x (3 - 2) - 2 = 2."),
    ],
    ids=["if no joints", "one each"],
)
def test_20_and_21_steps_of_counting(step, text):
    """'If there were no joints ... 12 DoF'; 'each link is constrained by one joint (the last, by
    two)'
    """
    assert text in kempe.load("four_links").mobility().counting.steps[step]


test_21_the_last_by_two = test_20_and_21_steps_of_counting


def test_22_the_same_in_space_and_where_it_fails():
    """'The above reasoning could be applied to 3D systems as well'"""
    assert "7 x (6 - 5) = 7" in kempe.load("seven_bodies").mobility().counting.steps[2]
    said = kempe.load("bennett").mobility().sentence
    assert said == "1 degree of freedom (Grübler count: -2; 3 redundant constraints)"


# ------------------------------------------------------------------ types of joints

LECTURES = {
    "revolute": 1,
    "prismatic": 1,
    "cylindrical": 2,
    "universal": 2,
    "planar": 3,
    "spherical": 3,
}


def check_figure_of_a_joint(*kinds: str) -> None:
    """The DoF are the lecture's; a picture shows two neighbouring positions for each of them."""
    for kind in kinds:
        system = kempe.load(f"joint_{kind}")
        assert system.structure.joints["joint"].type.dof() == LECTURES[kind]
        ghosts = [name for name in artists(system.plot(motion=True)) if name.startswith("ghost")]
        assert len(ghosts) == 2 * LECTURES[kind]


def test_23_figures_of_revolute_and_prismatic():
    """'Revolute 1 DoF, Prismatic 1 DoF'"""
    check_figure_of_a_joint("revolute", "prismatic")


def test_24_figures_of_cylindrical_and_universal():
    """'Cylindrical 2 DoF, Universal 2 DoF'"""
    check_figure_of_a_joint("cylindrical", "universal")


def test_25_figure_of_planar():
    """'Planar 3 DoF'"""
    check_figure_of_a_joint("planar")


def test_26_figure_of_spherical():
    """'Spherical 3 DoF'"""
    check_figure_of_a_joint("spherical")


@pytest.mark.parametrize("kind", [k for k in TYPES if k not in ("fixed", "helical")])
def test_27_combinations_of_revolute_and_prismatic(kind):
    """'most complex joint can be modelled as a combination of revolute and prismatic joints'"""
    system = kempe.load(f"joint_{kind}")
    parts = kempe.convert.expand_joints(system)
    assert {j.type.type_name for j in parts.structure.joints.values()} <= {"revolute", "prismatic"}
    assert parts.mobility().dof == len(parts.joint_names) == system.mobility().dof


def test_29_a_spherical_joint_is_three_revolute_ones():
    """'a spherical joint is a combination of three revolute joints'"""
    m = Mechanism("ball")
    m.spherical("S", m.ground, m.body("B"), angles=True)
    system = m.build()
    assert system.structure.joints["S"].type.decomposition == "R(z) R(y) R(x)"
    assert system.coordinate_names == ("S.rz", "S.ry", "S.rx")


# ------------------------------------------------------------------ configurations


def test_30_configuration_space():
    """'The space of all configurations that a physical system may attain is called configuration
    space'
    """
    assert str(kempe.load("two_link").configuration_space) == "T^2, dimension 2"
    assert str(kempe.load("four_links").configuration_space).startswith(
        "dimension 2: the subset of T^4 x R"
    )


def test_31_a_configuration_is_a_point(arm):
    """'a single configuration as a point in the configuration space'"""
    left, _ = arm.plot_spaces("e", points=[P])
    drawn = artists(left)
    points = [drawn[f"solution:0:{k}"].get_xydata()[0] for k in range(2)]
    np.testing.assert_allclose(points, arm.ik_all(P, "e").q, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["two_link", "seven_bodies", "four_links", "four_bar", "joint_spherical", "bennett"]
)
def test_32_dof_is_the_dimension(name):
    """'The DoF of a system is equal to the dimension of its configuration space'"""
    system = kempe.load(name)
    assert system.configuration_space.dimension == system.mobility().dof


def test_33_pairs_and_constraints():
    """'For a system of n_b rigid bodies we can use n_b pairs (r, R) and m_c constraints'"""
    ways = str(kempe.load("seven_bodies").configuration_space.parametrizations())
    assert "n_b = 7 pairs (r, R) with m_c = 35 constraints, or n = 7 generalized positions" in ways
    tree = kempe.load("seven_bodies")
    pairs = kempe.convert.to_maximal(tree, tree.neutral)
    assert pairs[:, :3, 3].shape == (7, 3) and pairs[:, :3, :3].shape == (7, 3, 3)


@pytest.mark.parametrize(
    ("name", "n", "n_b"),
    [("four_links", 2, 4), ("seven_bodies", 7, 7), ("joint_free", 6, 1), ("joint_spherical", 3, 1)],
)
def test_34_generalized_positions(name, n, n_b):
    """'n independent generalized positions (where n <= n_b ...)': so for joints with one DoF, not
    for others.
    """
    system = kempe.load(name)
    assert (system.mobility().dof, len(system.parent)) == (n, n_b)
    if all(j.type.dof() == 1 for j in system.structure.joints.values()):
        assert n <= n_b


@pytest.mark.parametrize(("name", "dim"), [("four_links", 2), ("joint_free", 6), ("rssr", 2)])
def test_35_minimal_number_of_variables(name, dim):
    """'a parametrization with minimal number of variables and do not need to explicitly deal with
    constraints'
    """
    system = kempe.load(name)
    chart = system.independent()
    u = chart.u(system.assemble().q) + 0.02
    found = chart.q(u)
    assert chart.dim == dim and found and "left open" not in found.status
    assert np.abs(system.loops.closure_error(found.q)).max(initial=0.0) < 1e-9
    np.testing.assert_allclose(chart.u(found.q), u, rtol=0, atol=1e-9)


EXERCISE = [
    ("bennett", "3 x (6 - 5) - 5 = -2"),
    ("jansen", "7 x (3 - 2) - 3 x 2 = 1"),
    ("rssr", "= 2."),
]


@pytest.mark.parametrize(("name", "step"), EXERCISE, ids=[name for name, _ in EXERCISE])
def test_36_systems_in_space_and_in_the_plane(name, step):
    """'The system on the left is in 3D, while the system on the right is in 2D'"""
    assert step in kempe.load(name).mobility().counting.steps[-1]


@pytest.mark.parametrize(("name", "dof"), [("bennett", 1), ("jansen", 1), ("rssr", 2)])
def test_37_find_the_dof(name, dof):
    """'find the number of DoF for each system'"""
    assert kempe.load(name).mobility().dof == dof


def test_38_find_a_parametrization():
    """'find a parametrization for each system', by name and as formulas"""
    pytest.importorskip("sympy")
    assert kempe.load("bennett").independent().independent == ("q1",)
    leg = kempe.load("jansen")
    formulas = leg.loops.closed_form(["O"]).formulas()
    assert "the law of cosines" in str(formulas)
    q = formulas([1.0], "+++")
    assert np.abs(leg.loops.closure_error(q)).max() < 1e-12


# ------------------------------------------------------------------ open and closed loops


def test_39_a_loop_is_opened(four_bar):
    """'Figure: open-loop and closed-loop systems'"""
    tree = four_bar.open_loops("C")
    assert (four_bar.kind, tree.kind) == ("1 loop", "tree") and set(four_bar.joint_names) - set(
        tree.joint_names
    ) == {"C"}
    assert "link:coupler" in artists(tree.plot())


def test_40_kinds_of_systems():
    """'serial manipulators (also called tree systems, or open-loop chains)'"""
    kinds = [kempe.load(x).kind for x in ("two_link", "seven_bodies", "four_bar")]
    assert kinds == ["serial chain", "tree", "1 loop"]


def test_41_all_angles_can_be_set():
    """'All joint angles could be set independently to generate a unique point in the configuration
    space'
    """
    tree = kempe.load("seven_bodies")
    assert (
        tree.independent().independent == tree.coordinate_names
        and tree.independent().dependent == ()
    )


def test_43_loop_closure_constraints(four_bar):
    """'The remaining joint angles are determined by the loop closure constraints'"""
    pytest.importorskip("sympy")
    said = str(four_bar.symbolic.closure())
    assert (
        "a*cos(A) + b*cos(A + B) - c*cos(D) - d = 0" in said
        and "a*sin(A) + b*sin(A + B) - c*sin(D) = 0" in said
    )
    q = four_bar.q_dict(four_bar.assemble({"A": 1.0}).q)
    a, b, c, d = (four_bar.structure.parameters[k] for k in "abcd")
    residual = (
        a * np.exp(1j * q["A"]) + b * np.exp(1j * (q["A"] + q["B"])) - c * np.exp(1j * q["D"]) - d
    )
    assert abs(residual) < 1e-12


def test_45_figure_of_both_assemblies(four_bar):
    """'Figure: ... additional considerations'"""
    modes = four_bar.assembly_modes({"A": 1.0})
    assert [ax.get_title() for ax in four_bar.plot(modes, side_by_side=True)] == ["+", "-"]
    over = artists(four_bar.plot(modes))
    assert [over[f"label:configuration{k}"].get_text() for k in range(2)] == ["+", "-"]


# ------------------------------------------------------------------ configuration space and task
# space


def test_46_one_part_of_a_manipulator(arm):
    """'the motion of one particular part of a manipulator'"""
    assert "e" in arm.frame_names and arm.fk([0.3, -0.5], "e").shape == (4, 4)


def test_47_position_velocity_force(arm):
    """'we want to control its position, velocity, force, etc.': forces by virtual work, from a
    difference quotient.
    """
    q = np.array([0.3, -0.5])
    h = 1e-6
    force = np.array([0.0, -10.0])
    J = arm.jacobian(q, "e")[:2]
    moved = [(arm.fk(q + h * e, "e") - arm.fk(q - h * e, "e"))[:2, 3] / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(J.T, moved, rtol=0, atol=1e-9)
    np.testing.assert_allclose(J.T @ force, [force @ v for v in moved], rtol=0, atol=1e-8)


@pytest.mark.parametrize("task", ["position", "orientation", "pose"])
def test_48_position_or_orientation_of_the_tool(task):
    """'specifying the position and/or orientation of the tool is of great importance'"""
    system = kempe.load("two_link_pose")
    X = system.fk(system.neutral, "p_down")
    reached = system.fk(system.ik(X, "e", task=task).q, "e")
    for name, part in (("position", np.s_[:3, 3]), ("orientation", np.s_[:3, :3])):
        if task in (name, "pose"):
            np.testing.assert_allclose(reached[part], X[part], rtol=0, atol=1e-6)


def test_49_m_constraints_on_n_joints(arm):
    """'imposing m additional (task related) constraints to our n joint manipulator'"""
    s = arm.ik(P, "e")
    assert (s.m, s.n, s.rank, s.redundancy) == (2, 2, 2, 0)


def test_50_m_at_most_n(arm):
    """'In general, m <= n will be assumed'; 'in this example both are 2D (m = n)'"""
    panda = kempe.load("panda")
    s = panda.ik(panda.fk(panda.mid, "tool"), "tool")
    assert (s.m, s.n) == (6, 7)
    assert "m = n = 2" in str(arm.task_space("e", task="position"))


def test_51_figure_of_both_spaces(arm):
    """'Figure: (q1, q2) beside {x0, y0}'"""
    left, right = arm.plot_spaces("e", points=[P, (0.9, 0.5)])
    assert (left.get_title(), right.get_title()) == (
        "configuration space",
        "task space: position of 'e'",
    )
    far = np.hypot(0.9, 0.5) - 0.9
    assert artists(right)["distance:1:text"].get_text() == f"{far:.3g} m away"


def test_52_the_configuration_space_is_a_torus(arm):
    """'the span of vectors [q1, 0], [0, q2]': truly a torus, on which distances go the short way."""
    assert str(arm.configuration_space) == "T^2, dimension 2"
    assert arm.configuration_space.distance([3.1, 0], [-3.1, 0]) == pytest.approx(2 * np.pi - 6.2)


def test_53_x0_and_y0(arm):
    """'the span of vectors x_0, y_0'"""
    assert np.linalg.matrix_rank(arm.jacobian([0.3, -0.5], "e")[:2]) == 2
    drawn = artists(arm.plot(axes=("ground", "e")))
    assert drawn["label:ground:x"].get_text() == "$x_{0}$" and {"mark:ground:y", "mark:e:x"} <= set(
        drawn
    )


def test_54_the_map_between_the_spaces(arm):
    """'the map between (q_1, q_2) and the position of the end-effector': lines of a grid and their
    images.
    """
    left, right = arm.plot_spaces("e", grid=True, resolution=40)
    lines = artists(left)
    images = artists(right)
    gids = [name for name in lines if name.startswith("grid:")]
    assert {g.split(":")[1] for g in gids} == {"q1", "q2"}
    for gid in gids:
        q = lines[gid].get_xydata()
        assert np.ptp(q, axis=0).min() == 0.0, "one coordinate is constant"
        np.testing.assert_allclose(
            images[gid].get_xydata(), arm.fk(q, "e")[:, :2, 3], rtol=0, atol=1e-12
        )


# ------------------------------------------------------------------ forward and inverse geometric
# models


def test_55_figure_of_both_models(arm):
    """'Figure: forward and inverse geometric models': a number on the left stands at the same
    number on the right.
    """
    left, right = (artists(ax) for ax in arm.plot_spaces("e", points=[P]))
    for k in range(2):
        q = left[f"solution:0:{k}"].get_xydata()[0]
        tip = arm.fk(q, "e")[:2, 3]
        link = right[f"arm:0:{k}:{arm.body_names[-1]}"].get_xydata()
        assert np.linalg.norm(link - tip, axis=1).min() < 1e-12
        np.testing.assert_allclose(tip, right["point:0"].get_xydata()[0], rtol=0, atol=1e-9)


def test_57_given_a_pose_find_q(arm):
    """'Given the position and orientation of the end-effector, find a corresponding q'"""
    np.testing.assert_allclose(
        arm.ik(arm.fk([0.3, -0.5], "e"), "e").q, [0.3, -0.5], rtol=0, atol=1e-6
    )


# ------------------------------------------------------------------ the forward geometric model


def test_58_position_and_orientation(arm):
    """'Find 0p_e and 0_eR = 0_2R'"""
    sympy = pytest.importorskip("sympy")
    q1, q2 = sympy.symbols("q1 q2")
    T = arm.symbolic.fk("e")
    assert T[:2, :2] == sympy.Matrix(
        [[sympy.cos(q1 + q2), -sympy.sin(q1 + q2)], [sympy.sin(q1 + q2), sympy.cos(q1 + q2)]]
    )
    assert T[:3, :3] == arm.symbolic.fk("B2")[:3, :3]


def test_59_parts_of_the_position(arm):
    """'0p_1 = (0, 0, 0), 1p_2 = (l1, 0, 0), 2p_e = (l2, 0, 0)'"""
    sympy = pytest.importorskip("sympy")
    l1, l2 = sympy.symbols("l1 l2")
    pairs = (("ground", "B1", 0), ("B1", "B2", l1), ("B2", "e", l2))
    for of, frame, length in pairs:
        assert arm.symbolic.fk(frame, relative_to=of)[:3, 3] == sympy.Matrix([length, 0, 0])
    assert str(arm.structure.joints["q2"].X_PF) == "x = l1"
    np.testing.assert_allclose(
        arm.fk([0.3, 0.4], "B2", relative_to="B1")[:3, 3], [0.5, 0, 0], rtol=0, atol=1e-15
    )


def test_60_parts_of_the_orientation(arm):
    """'0_1R = R_z(q1), 1_2R = R_z(q2), 2_eR = R_z(0)'"""
    sympy = pytest.importorskip("sympy")
    angles = (*sympy.symbols("q1 q2"), 0)
    for of, frame, q in zip(("ground", "B1", "B2"), ("B1", "B2", "e"), angles, strict=True):
        c = sympy.cos(q)
        s = sympy.sin(q)
        assert arm.symbolic.fk(frame, relative_to=of)[:2, :2] == sympy.Matrix([[c, -s], [s, c]])


def test_61_steps_of_the_product(arm):
    """'0p_e = 0_1R (1p_2 + 1_2R 2p_e); 0_2R = 0_1R 1_2R'"""
    pytest.importorskip("sympy")
    steps = arm.symbolic.steps("e")
    by_hand = steps.R[0] * (steps.p[1] + steps.R[1] * steps.p[2])
    assert (by_hand - steps.products[-1][:3, 3]).expand().is_zero_matrix
    assert (steps.R[0] * steps.R[1] - steps.products[1][:3, :3]).expand().is_zero_matrix
    assert (
        r"{}^{\mathrm{ground}}_{\mathrm{e}}T &= {}^{\mathrm{ground}}_{\mathrm{B1}}T"
        in steps.latex()
    )


def test_62_figure_with_frames_angles_and_lengths(arm):
    """'Figure: two-link arm with frames, q1, q2, l1, l2'"""
    drawn = artists(arm.plot([0.4, 0.8], axes="all", angles=True, dimensions=True))
    texts = [
        drawn[f"label:{name}"].get_text()
        for name in ("angle:q1", "angle:q2", "dimension:B1:0", "dimension:B2:0")
    ]
    assert texts == ["q1", "q2", "l1", "l2"]
    assert {f"mark:{name}:{axis}" for name in ("ground", "B1", "B2", "e") for axis in "xy"} <= set(
        drawn
    )


def test_63_frames_by_name(arm):
    """'Figure: ... frames', by their names"""
    drawn = artists(arm.plot([0.4, 0.8], frames=["B1", "e"]))
    marks = {name.split(":")[1] for name in drawn if name.startswith("mark:")}
    assert marks == {"B1", "e"} and "mark:e" not in artists(arm.plot([0.4, 0.8]))


def test_64_a_unique_solution(arm):
    """'The FGM has a unique solution and, in general, it is easy to compute'"""
    Q = arm.random(0, 1000)
    assert arm.fk(Q, "e").shape == (1000, 4, 4)
    np.testing.assert_allclose(arm.fk(Q + 2 * np.pi, "e"), arm.fk(Q, "e"), rtol=0, atol=1e-13)


def test_66_n_matrices():
    """'forming and multiplying n 4x4 homogeneous matrices'"""
    panda = kempe.load("panda")
    q = panda.random(0)
    T = panda.symbolic.steps("panda_link7").numbers(q)
    assert len(T) == 7
    np.testing.assert_allclose(
        np.linalg.multi_dot(list(T)), panda.fk(q, "panda_link7"), rtol=0, atol=1e-13
    )


# ------------------------------------------------------------------ body-fixed frames, connectivity


def table(arm: kempe.System) -> kempe.System:
    return kempe.from_dh([{"a": "l1"}, {"a": "l2"}], parameters=arm.structure.parameters).build()


def test_68_matrices_depend_on_frames(arm):
    """'The form of each homogeneous matrix depends on where the body-fixed frames are placed'"""
    pytest.importorskip("sympy")
    own = arm.symbolic.steps("e")
    standard = table(arm).symbolic.steps("tool")
    assert own.T[0] != standard.T[0] and own.merged == standard.merged


def test_69_denavit_and_hartenberg(arm):
    """'A commonly used one is the Denavit-Hartenberg convention': tables are written, too."""
    pytest.importorskip("sympy")
    rows = arm.symbolic.to_dh("e")
    assert "joint = q1, a = l1, alpha = 0, d = 0, theta = q1" in str(rows)
    q = arm.random(0, 20)
    tool = rows.mechanism().build()
    np.testing.assert_allclose(tool.fk(q, tool.frame_names[-1]), arm.fk(q, "e"), rtol=0, atol=1e-13)


def test_71_a_frame_for_each_body_and_joint(arm):
    """'associate a coordinate frame with each rigid body and/or joint'"""
    assert {"ground", "B1", "B2", "e"} <= set(arm.frame_names)
    place = arm.structure.joints["q2"].X_PF.evaluate_pose(arm.structure.parameters)
    np.testing.assert_array_equal(place[:3, 3], [0.5, 0, 0])


def test_73_from_the_vector_to_the_system():
    """'P(B_i) = C_i': a loop over C builds the system, and `parent` is C again."""
    C = (0, 1, 2, 1, 4, 4, 2)
    m = Mechanism("from C", ground="B0")
    for i, parent in enumerate(C, 1):
        m.revolute(f"J{i}", f"B{parent}", m.body(f"B{i}"))
    system = m.build()
    assert system.parent == kempe.load("seven_bodies").parent == C
    assert system.structure.parent_joints == tuple(f"J{i}" for i in range(1, 8))


def test_74_figure_of_the_tree():
    """'The connectivity of the system in the figure is encoded in C'"""
    drawn = artists(kempe.load("seven_bodies_loop").plot_tree())
    assert drawn["connectivity"].get_text() == "C = {0, 1, 2, 1, 4, 4, 2}"
    assert {f"body:B{i}" for i in range(8)} | {"cut:J6", "edge:J1"} <= set(
        drawn
    ) and "edge:J6" not in drawn


# ------------------------------------------------------------------ the inverse geometric model


def test_75_how_many_solutions(arm):
    """'could have no solutions, one solution or multiple solutions (even when m = n)': or
    infinitely many.
    """
    assert [len(arm.ik_all([r, 0], "e")) for r in (0.05, 0.1, 0.5, 0.9, 1.0)] == [0, 1, 2, 1, 0]
    folded = arm.with_parameters(l2=0.5).ik_all([0.0, 0.0], "e")
    assert "a family with one freedom: q1 is free while q2 = 3.14159" in folded.status


def test_76_one_solution_at_the_edge(arm):
    """'one solution (even when m = n)': on the edge it is a double root, and does not move."""
    assert arm.ik_all([0.9, 0.0], "e").status.startswith("1 solution, the only one (a double root)")
    edge = tasks.Position("e", [0.9, 0.0])
    assert "1 freedom to first order only (the Jacobian loses rank here)" in arm.ik(edge).status
    motion = arm.inverse.self_motion([0, 0], edge)
    assert (motion.freedoms, len(motion.q)) == (0, 1)
    assert len({arm.ik([0.9, 0.0], "e", start=s).redundancy for s in ([0, 0], [0.5, 0.5])}) == 1


def test_77_more_constraints_than_dof():
    """'when m > n, there is no solution (if the m constraints are independent)': x, y, angle as
    three numbers.
    """
    system = kempe.load("two_link_pose")
    status = system.ik([0.6, 0.3, 0.5], "e", task="pose").status
    assert "the task has 3 equations, but the chain moves this frame in 2 freedoms only" in status
    status = system.ik([0.6, 0.3, 0.5], "e").status
    assert "outside the plane of the system by 0.5 m" in status and "task='pose'" in status


def test_78_two_values_of_q(arm):
    """'can reach the point p with two different values of q_1 and q_2'"""
    both = arm.ik_all(P, "e")
    assert len(both) == 2 and both.complete and "note = -" not in str(both)
    np.testing.assert_allclose(arm.fk(both.q, "e")[:, :2, 3], [P, P], rtol=0, atol=1e-12)


def test_79_figure_of_two_solutions(arm):
    """'In the figure, the end-effector can reach the point p with two different values'"""
    both = arm.ik_all(P, "e")
    beside = arm.plot(both, side_by_side=True)
    assert [ax.get_title() for ax in beside] == ["elbow-down", "elbow-up"]
    assert {"link:B1", "configuration1:B1", "frame:p"} <= set(artists(both.plot()))


def test_80_a_specific_orientation():
    """'If we want to reach p with a specific orientation ... in most cases there will be no
    solution'
    """
    system = kempe.load("two_link_pose")
    X, Y = system.fk(system.neutral, ["p", "p_down"])
    assert not system.ik_all(X, "e") and system.ik_all(Y, "e").status.startswith(
        "1 solution, the only one"
    )


def test_81_figure_without_a_solution():
    """'Example (IGM with no solution m = n)'"""
    system = kempe.load("unreachable")
    drawn = artists(system.plot(system.ik([0.8, 0.6], "e"), workspace="e"))
    radii = sorted(
        np.hypot(*drawn[f"workspace:boundary{k}"].get_xydata().T).max() for k in range(2)
    )
    np.testing.assert_allclose(radii, [0.1, 0.9], rtol=0, atol=1e-9)
    centre = system.fk(system.neutral, "p")[:2, 3]
    np.testing.assert_allclose(
        drawn["frame:p"].get_path().vertices.mean(axis=0), centre, rtol=0, atol=0.05
    )
    assert np.hypot(*centre) > radii[1]


def test_83_the_workspace(arm):
    """'p_e is outside the robot workspace': a ring between |l1 - l2| and l1 + l2."""
    ring = arm.reach.planar("e")
    assert ring.area == pytest.approx(np.pi * (0.9**2 - 0.1**2)) and len(ring.voids) == 1
    assert ring.contains([[0.6, 0.3], [0.9, 0.3], [0.05, 0.0]]).tolist() == [True, False, False]
    assert sorted(piece.radius for piece in ring.boundary) == pytest.approx([0.1, 0.9])


# ------------------------------------------------------------------ solution methods


def test_84_the_geometric_structure(arm):
    """'analyze the geometric structure of a given manipulator'"""
    said = str(arm.inverse.plan("e"))
    assert (
        "the position is planned" in said
        and "closed form" in said
        and "2 isolated configurations at most" in said
    )


def test_85_special_structures():
    """'3 consecutive rotational joint axes intersect; 3 consecutive rotational joint axes are
    parallel'
    """
    puma, ur5 = (" ".join(kempe.load(x).inverse.plan("tool").relations) for x in ("puma560", "ur5"))
    assert "the axes of q4, q5 and q6 meet in one point" in puma
    assert "the axes of shoulder_lift, elbow and wrist_1 are parallel" in ur5


def test_86_both_methods_agree():
    """'fast computation'; 'slower compared to an analytical solution, however, sufficiently fast'"""
    puma = kempe.load("puma560")
    X = puma.fk(puma.random(0, 50), "tool")
    every = puma.ik_all(X, "tool")
    one = puma.ik(X, "tool")
    assert every.complete.all() and one.success.all()
    for found in (every.q[every.mask][:50], one.q):
        assert len(found) == 50
    np.testing.assert_allclose(puma.fk(one.q, "tool"), X, rtol=0, atol=1e-5)


def test_87_any_type_of_system():
    """'applicable to any type of system'"""
    system = kempe.load("stewart")
    T = system.fk(system.assemble().q, "platform")
    T[2, 3] += 0.02
    s = system.ik(tasks.Pose("platform", T))
    assert s and np.abs(system.loops.closure_error(s.q)).max() < 1e-6
    np.testing.assert_allclose(system.fk(s.q, "platform"), T, rtol=0, atol=1e-5)


def test_88_redundancy(three_links):
    """'very useful in the presence of redundancy with respect to the task'"""
    q = three_links.ik([0.5, 0.3], "e").q
    for motion in (
        three_links.inverse.self_motion(q, tasks.Position("e", [0.5, 0.3])),
        three_links.inverse.self_motion(q, "e", task="position"),
    ):
        assert motion.closed and motion.freedoms == 1
        tips = three_links.fk(motion.q, "e")[:, :2, 3]
        np.testing.assert_allclose(
            tips, np.broadcast_to(three_links.fk(q, "e")[:2, 3], tips.shape), rtol=0, atol=1e-9
        )
    panda = kempe.load("panda")
    assert panda.ik([0.4, 0.2, 0.3], "tool").self_motion.shape == (7, 4)


def test_89_additional_constraints():
    """'can account for additional constraints'"""
    panda = kempe.load("panda")
    above = tasks.HalfSpace("panda_link4", (0, 0, 0.3), (0, 0, 1))
    s = panda.ik([tasks.Position("panda_hand_tcp", (0.4, 0.2, 0.3)), above])
    assert s and panda.fk(s.q, "panda_link4")[2, 3] >= 0.3 - 1e-6


def test_90_problems_of_convergence(arm):
    """'can have convergence problems, and produce unexpected results': from the stretched arm."""
    for p in ([0.6, 0.0], [-0.6, 0.0]):
        once = arm.ik(p, "e", start=[0, 0], budget=kempe.Budget(starts=1))
        assert (
            not once
            and "the search is stuck at a singular configuration; more starts find an answer"
            in once.status
        )
        assert arm.ik(p, "e", start=[0, 0])


def test_91_the_iterates(arm):
    """'Numerical solution (more details later on ...)'"""
    s = arm.ik(P, "e", history=True)
    errors = np.linalg.norm(arm.fk(s.history.q, "e")[:, :2, 3] - P, axis=1)
    np.testing.assert_allclose(s.history.position_error, errors, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(s.history.q[-1], s.q)
    assert "position:0" in artists(s.plot_history())


def test_92_the_initial_guess(arm):
    """'depend on an initial guess for q': in numbers, many at once, or by the name of a posture."""
    for sign in (-1, 1):
        assert np.sign(arm.ik(P, "e", start={"q2": sign}).q[1]) == sign
    many = arm.ik(P, "e", start=arm.random(0, 9))
    assert many.q.shape == (9, 2) and set(np.sign(many.q[:, 1])) == {-1, 1}
    assert {
        x: np.sign(arm.ik("p", "e", start=x, task="position").q[1])
        for x in ("elbow_up", "elbow_down")
    } == {"elbow_up": -1, "elbow_down": 1}


# ------------------------------------------------------------------ the two-link arm


def test_93_short_symbols(arm):
    """'c_1 = cos q_1, ..., p_ex = l1 c_1 + l2 c_12'"""
    sympy = pytest.importorskip("sympy")
    formula, legend = arm.symbolic.short(arm.symbolic.fk("e")[:2, 3])
    c1, s1, c12, s12, l1, l2, q1, q2 = sympy.symbols("c1 s1 c12 s12 l1 l2 q1 q2")
    assert formula == sympy.Matrix([l1 * c1 + l2 * c12, l1 * s1 + l2 * s12])
    assert legend[c12] == sympy.cos(q1 + q2) and legend[s1] == sympy.sin(q1)


def test_94_squared_and_summed(arm):
    """'when forming c_2 we squared and summed the x and y parts of the forward geometric model'"""
    sympy = pytest.importorskip("sympy")
    step = {str(s.symbol): s for s in arm.symbolic.ik("e").steps}
    assert step["r2"].says == "both parts of the position squared and summed"
    x, y = arm.symbolic.fk("e")[:2, 3]
    c2 = step["c2"].formula.subs(step["r2"].symbol, x**2 + y**2)
    assert sympy.simplify(c2 - sympy.cos(sympy.Symbol("q2"))) == 0


def test_95_the_formulas(arm):
    """'s_2 = +-sqrt(1 - c_2^2), alpha = atan2, beta = atan2, q_1 = alpha - beta, q_2 = atan2(s_2,
    c_2)'
    """
    pytest.importorskip("sympy")
    formulas = arm.symbolic.ik("e")
    names: dict[str, Callable[..., tuple[float, float]]] = {}
    exec(formulas.code(), names)
    for sign, expected in zip((-1, 1), lecture.closed_form(*P, 0.5, 0.4), strict=True):
        np.testing.assert_allclose(formulas(P, sign), expected, rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            names["inverse"](*P, sign, 0.5, 0.4), expected, rtol=0, atol=1e-14
        )
    assert r"s_{2} &= \pm \sqrt{1 - c_{2}^{2}}" in formulas.latex()


def test_96_figure_of_alpha_and_beta(arm):
    """'Figure: alpha, beta, q1, q2, p_e at the two-link arm'"""
    drawn = artists(arm.plot(arm.ik_all(P, "e").q[0], angles="e"))
    assert {f"label:angle:{name}" for name in ("alpha", "beta", "q1", "q2")} | {"way:e"} <= set(
        drawn
    )


def test_97_elbow_up_and_down(arm):
    """'s_2 = -sqrt(1 - c_2^2) corresponds to the elbow-up configuration'"""
    both = arm.ik_all(P, "e")
    assert {name: np.sign(q[1]) for name, q in zip(both.names, both.q, strict=True)} == {
        "elbow-up": -1,
        "elbow-down": 1,
    }
    assert "note = elbow-up" in str(both)


@pytest.mark.parametrize(
    ("zero", "p", "free"),
    [("l2", [0.3, 0.4], "q2 is free"), ("l1", [0.0, 0.4], "q1 + q2 = 1.5708")],
)
def test_99_zero_lengths(arm, zero, p, free):
    """'l_1 != 0 and l_2 != 0 is assumed': else there is a family."""
    found = arm.with_parameters(**{zero: 0.0}).ik_all(p, "e")
    assert found.status == f"no isolated solution, and a family with one freedom: {free}"


# ------------------------------------------------------------------ constraints, again


def test_100_functions_of_the_coordinates(arm):
    """'They can be expressed as functions of the system's position coordinates f(q) = 0'"""
    s = arm.ik(tasks.Function(lambda q: q[0] - 2 * q[1] - 0.3))
    assert s and (s.m, s.n) == (1, 2) and s.q[0] - 2 * s.q[1] == pytest.approx(0.3, abs=1e-6)


def test_101_a_constraint_of_ones_own_removes_one_dof():
    """'Each holonomic constraint decreases the dimension of the configuration space, hence removes
    one DoF'
    """
    m = kempe.read("two_link")
    m.equation("law", lambda x: x["q1"] - 2 * x["q2"], of=("q1", "q2"))
    system = m.build()
    assert system.mobility().dof == 1
    assert (
        "2 revolute joints x 2 + 1 equation x 1 = 5, which leaves 6 - 5 = 1"
        in system.mobility().counting.steps[1]
    )
    way = system.trace("q1").q
    np.testing.assert_allclose(way[:, 0], 2 * way[:, 1], rtol=0, atol=1e-9)


def test_102_joints_are_holonomic():
    """'Constraints imposed by prismatic and revolute joints are holonomic'"""
    pairs = kempe.convert.maximal(kempe.load("four_links"))
    kinds = {c.kind for c in pairs.classify().constraints.values()}
    assert kinds == {"holonomic"}


def test_103_nonholonomic():
    """'Constraints that can not be expressed as f(q) = 0 are called nonholonomic'"""
    found = kempe.load("car").classify()
    assert found.constraints["rear axle"].kind == "nonholonomic"
    assert (found.position_dof, found.velocity_dof, found.growth) == (3, 2, (2, 3))


def test_104_not_sideways():
    """'It can not move instantaneously sideways'"""
    car = kempe.load("car")
    wanted = np.array([[0, 1.0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0]])
    had = [car.ik_step(car.neutral, v, "car", 0.1).velocity[:2] for v in wanted]
    np.testing.assert_allclose(had, [[0, 0], [1, 0]], rtol=0, atol=1e-9)


def test_105_it_reaches_any_configuration():
    """'however, it has 3 DoF as it can reach any configuration in the plane'"""
    car = kempe.load("car")
    way = car.manoeuvre([0, 0, 0], [0, 1, 0])
    np.testing.assert_allclose(way.q[[0, -1]], [[0, 0, 0], [0, 1, 0]], rtol=0, atol=1e-9)
    step = np.diff(way.q, axis=0)
    middle = way.q[:-1, 2] + 0.5 * step[:, 2]
    sideways = -np.sin(middle) * step[:, 0] + np.cos(middle) * step[:, 1]
    assert np.abs(sideways).max() < 1e-9, "no step is sideways"
    assert {"mark:rear axle:wheel0", "mark:rear axle:wheel1"} <= set(artists(car.plot()))


def test_106_unilateral(arm):
    """'Constraints of the form f(q) > 0, are called unilateral'"""
    assert kempe.load("ball").classify().constraints["ground plane"].kind == "unilateral"
    s = arm.ik([tasks.HalfSpace("B2", (0, 0.2), (0, 1)), tasks.Position("e", P)])
    assert s and arm.fk(s.q, "B2")[1, 3] >= 0.2 - 1e-6


def test_107_a_ball_on_the_ground():
    """'a ball can not penetrate the ground, but it can bounce up'"""
    ball = kempe.load("ball")
    q = ball.q({"flight.z": 0.1})
    up = [
        ball.ik_step(q, np.array([0, 0, v, 0, 0, 0]), "ball", 0.1).velocity[2] for v in (-1.0, 1.0)
    ]
    np.testing.assert_allclose(up, [0, 1], rtol=0, atol=1e-9)
    said = str(ball.classify(q))
    assert "5 both ways and 1 one way only" in said and "closed; its value can only grow" in said
    fall = ball.simulate(1.0, start={"flight.z": 1.1}, restitution=0.8)
    assert fall.q[:, 2].min() >= 0.1 - 1e-9 and fall.events[0].time == pytest.approx(
        np.sqrt(2 / 9.81), abs=1e-3
    )
    assert not ball.ik([0.0, 0.0, -1.0], "ball")
    with pytest.raises(KempeError):
        ball.simulate(1.0, start={"flight.z": -1.0})
