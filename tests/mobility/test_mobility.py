"""Degrees of freedom as published, by counting, by rank and truly; redundancy, idle freedoms and
control.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hunts import some
from literature import SPREAD, look, miura
from mechanisms import PLANAR, SINGULAR, Case
from mechanisms_spatial import SPATIAL, Spatial, joint_constraints
from world_mechanisms import World, Z, loop, unit

import kempe
from kempe import Mechanism, System
from kempe.assemble.generic_configurations import sample_nearby_ranks
from kempe.equations.closure_rows import compute_residual
from kempe.equations.judge import closure_error
from kempe.errors import InputError, UnknownNameError
from kempe.first_order.rank import compute_rank
from kempe.joints import Universal
from kempe.mobility.answer import Mobility
from kempe.mobility.local_dimension import find_local_dimension
from kempe.mobility.mobility import mobility
from kempe.poses import Placement

# ---- published values


@pytest.mark.parametrize("case", some(PLANAR + SINGULAR, 3), ids=str)
def test_planar_mechanisms(case: Case):
    system = kempe.load(case.name)
    m = mobility(system, system.q(case.posture))
    assert (m.gruebler, m.rank_dof, m.dof) == (case.count, case.rank, case.true)
    assert (
        m.redundant_here == case.rank - case.count
        and m.redundant == m.generic_rank_dof - case.count
    )
    assert m.singular == bool(case.branches or case.rank > case.true)
    if case.branches and m.local.certain:
        assert sorted(b.dim for b in m.local.branches) == sorted(case.branches)
    if m.singular is False:
        assert m.certain and m.kind == "" and m.generic_rank_dof == m.rank_dof


@pytest.mark.parametrize("case", SPATIAL, ids=lambda c: c.name)
def test_spatial_mechanisms(case: Spatial):
    system = kempe.load(case.name)
    m = mobility(system, system.q("closed") if "closed" in system.structure.posture_names else None)
    assert (m.gruebler, m.rank_dof, m.dof, m.idle) == (case.count, case.rank, case.dof, case.idle)
    assert m.redundant_here == case.redundant and m.gruebler_spatial == m.gruebler
    assert m.redundant == (case.redundant if not m.singular else m.generic_rank_dof - case.count)
    assert m.useful == case.dof - case.idle


@pytest.mark.parametrize(
    ("name", "spatial"),
    [
        ("four_bar", -2),
        ("slider_crank", -2),
        ("double_parallelogram", -6),
        ("peaucellier", -8),
        ("jansen", -8),
        ("three_rrr", -3),
        ("five_bar", -1),
    ],
)
def test_what_planar_mechanisms_count_to_in_space(name, spatial):
    assert mobility(kempe.load(name), local=False).gruebler_spatial == spatial


def test_the_same_four_bar_in_the_plane_and_in_space():
    flat = mobility(kempe.load("four_bar"))
    solid = mobility(kempe.load("four_bar_spatial"))
    assert (flat.gruebler, flat.dof, flat.redundant) == (1, 1, 0)
    assert (solid.gruebler, solid.dof, solid.redundant) == (flat.gruebler_spatial, 1, 3)
    assert "1 degree of freedom (Grübler count: -2; 3 redundant constraints)" in str(solid)


# ---- counting


def test_the_lectures_example():
    m = mobility(kempe.load("four_links"))
    assert m.gruebler == m.dof == 2
    assert "4 x 3 = 12" in m.counting.steps[0]
    assert (
        "4 x (3 - 2) - 2 = 2" in m.counting.steps[-1] and "the last by two" in m.counting.steps[-1]
    )


def test_each_loop_has_its_group_of_motions():
    solid = mobility(kempe.load("four_bar_spatial"), local=False)
    # three parallel freedoms
    assert [(x.freedoms, x.equations, x.count) for x in solid.loops] == [(4, 3, 1)]
    assert [(x.freedoms, x.equations, x.count) for x in mobility(kempe.load("bennett")).loops] == [
        (4, 6, -2)
    ]
    assert mobility(kempe.load("four_bar")).loops[0].joints == ("A", "B", "C", "D")


def test_a_spherical_four_bar_is_closed_by_three_equations():
    system = spherical_four_bar()
    m = mobility(system)
    assert (m.gruebler, m.dof, m.redundant) == (-2, 1, 3)
    loop = m.loops[0]
    assert (loop.equations, loop.count, loop.motion) == (3, 1, "turns about one point")


def spherical_four_bar() -> System:
    """All axes through the origin; closed at zero coordinates."""
    m = Mechanism("spherical")
    axes = [(0, 0, 1), (0.6, 0, 0.8), (0.5, 0.6, math.sqrt(0.39)), (-0.1, 0.7, math.sqrt(0.5))]
    bodies = [m.ground, m.body("a"), m.body("b"), m.body("c")]
    for k, axis in enumerate(axes):
        m.revolute(f"J{k}", bodies[k], bodies[(k + 1) % 4], axis=axis)
    return m.build()


def test_couplings_locks_and_declared_constraints_take_away_freedoms():
    base = kempe.load("five_bar").mechanism
    joints = [n for n in base.joints if base.joints[n].type.type_name == "revolute"]
    geared = base.copy()
    closed = base.postures["closed"]
    a = joints[0]
    b = joints[-1]
    geared.gear(b, a, -1.0, closed.get(b, 0.0) + closed.get(a, 0.0))
    m = mobility(geared.build())
    assert (m.gruebler, m.dof) == (1, 1) and "coupling" in m.counting.steps[1]
    locked = base.copy().lock({a: closed.get(a, 0.0)}).build()
    m = mobility(locked)
    assert (m.gruebler, m.dof) == (1, 1) and "lock" in m.counting.steps[1]


def test_rods_lines_and_planes():
    m = Mechanism("held")
    m.free("J", m.ground, m.body("b"))
    ends = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    for k, end in enumerate(ends):
        m.distance(f"rod{k}", m.ground, "b", 1.0, at=(end[0], end[1], 1.0), child_at=end)
    report = mobility(m.build())
    assert (report.gruebler, report.rank_dof, report.dof, report.idle) == (3, 3, 3, 0)
    m.point_on_line("slot", m.ground, "b", child_at=(0, 0, 0))
    m.point_on_plane("table", m.ground, "b", child_at=(1, 0, 0))
    report = mobility(m.build(), local=False)
    assert report.gruebler == 0 and report.rank_dof == m_rank(m.build())


def m_rank(system: System) -> int:
    """Nullity of the loop equations by differences."""
    q = system.neutral
    h = 1e-6
    space = system.configuration_space
    columns = [
        (
            compute_residual(system, space.integrate(q, h * e))
            - compute_residual(system, space.integrate(q, -h * e))
        )
        / (2 * h)
        for e in np.eye(system.nv)
    ]
    return system.nv - int(np.linalg.matrix_rank(np.array(columns).T, 1e-6))


def test_a_particle_counts_three():
    m = Mechanism("bead")
    arm = m.body("arm")
    bead = m.particle("bead")
    m.revolute("A", m.ground, arm)
    m.prismatic("wire", arm, bead, axis=(1, 0, 0))
    m.translation("hand", m.ground, bead)
    report = mobility(
        m.build(),
        {"A": 0.3, "wire": 0.5, "hand.x": 0.5 * math.cos(0.3), "hand.y": 0.5 * math.sin(0.3)},
    )
    # 6 + 3 - 5 - 2 - 0
    assert (report.gruebler, report.rank_dof, report.dof) == (2, 2, 2)


# ---- open mechanisms


def test_an_open_mechanism_is_counted_only():
    m = kempe.load("four_bar").mechanism
    for name, x in {"a": 0.1, "b": 0.1, "c": 0.1, "d": 0.5}.items():
        m.parameters[name] = x
    report = mobility(m.build())
    assert report.gruebler == 1 and not report.closed
    assert report.rank_dof is report.dof is report.redundant is report.singular is None
    assert report.residual > 0.01 and "cannot be closed" in str(report)


def test_a_sloppy_configuration_is_closed_first():
    system = kempe.load("bennett")
    q = system.q("closed").round(4)
    assert np.abs(closure_error(system, q)).max() > 1e-6
    report = mobility(system, q)
    assert (report.rank_dof, report.dof) == (1, 1) and report.given_residual > 1e-6
    assert "given with residual" in str(report)
    folded = Mechanism("triangle", dim=2)
    for name, before, at in (("A", "ground", 0), ("B", "a", 2), ("C", "b", 2)):
        folded.revolute(name, before, folded.body(name.lower()), at=(at, 0))
    folded.prismatic("D", folded.ground, "c", axis="x", at=(1, 1))
    assert "no q was given: this is the closed one found from all zeros" in str(
        mobility(folded.build())
    )
    assert (
        np.abs(closure_error(system, report.q)).max() < 1e-12 and np.abs(report.q - q).max() < 1e-3
    )


def test_wrong_arguments_are_refused():
    system = kempe.load("four_bar")
    with pytest.raises(UnknownNameError, match="'Z'"):
        mobility(system, actuated=["Z"])
    with pytest.raises(InputError, match="list of names"):
        mobility(system, actuated="A")
    with pytest.raises(InputError):
        mobility(system, [0.0, 1.0])
    with pytest.raises(InputError, match="one configuration"):
        mobility(system, np.zeros((2, 4)))
    with pytest.raises(InputError):
        mobility(system, np.full(4, np.nan))


# ---- idle freedoms


def test_rods_spin_about_the_line_through_their_ends():
    system = kempe.load("delta_ss")
    m = mobility(system)
    assert m.idle == 6 and m.useful == 3
    assert len({f.bodies for f in m.idle_freedoms}) == 6 and all(
        len(f.bodies) == 1 for f in m.idle_freedoms
    )
    for f in m.idle_freedoms:
        assert f.joined and str(f).endswith(
            f"spins about the line through {f.joints[0]} and {f.joints[1]}"
        )
        moved = system.fk(system.configuration_space.integrate(m.q, 1e-6 * f.velocity)) - system.fk(
            m.q
        )
        still = [b for b in range(len(moved)) if np.abs(moved[b]).max() < 1e-11]
        assert len(still) == len(moved) - 1  # only the rod moves, and keeps the loops closed
        assert (
            np.abs(
                closure_error(system, system.configuration_space.integrate(m.q, 0.7 * f.velocity))
            ).max()
            < 1e-12
        )


def test_a_door_on_two_hinges_is_not_idle():
    m = Mechanism("door")
    door = m.body("door")
    m.revolute("low", m.ground, door)
    m.revolute("high", m.ground, door, at=(0, 0, 2), child_at=(0, 0, 2))
    report = mobility(m.build())
    assert (report.gruebler, report.dof, report.idle, report.redundant) == (-4, 1, 0, 5)


def test_a_shaft_in_its_bearings_is_not_idle_but_a_piston_on_a_ball_is():
    m = Mechanism("shaft")
    m.revolute("fixed", m.ground, m.body("shaft"))
    m.cylindrical("floating", m.ground, "shaft", at=(0, 0, 1), child_at=(0, 0, 1))
    report = mobility(m.build())
    assert (report.dof, report.idle) == (1, 0)
    m = Mechanism("engine")
    m.revolute("A", m.ground, m.body("crank"))
    m.spherical("big end", "crank", m.body("rod"), at=(0, 1, 0))
    m.spherical("small end", "rod", m.body("piston"), at=(3, -1, 0))
    m.cylindrical("bore", m.ground, "piston", axis=(1, 0, 0), at=(3, 0, 0))
    report = mobility(m.build())
    # 3 x 6 - 5 - 3 - 3 - 4; the rod spins, the piston spins, the engine runs
    assert (report.gruebler, report.dof, report.idle, report.useful) == (3, 3, 2, 1)
    assert sorted(f.bodies for f in report.idle_freedoms) == [("piston",), ("rod",)]


def test_a_spin_in_one_position_only_is_not_idle():
    """The leg turns alone where its ball is on the axis of its hinge, but nowhere near."""
    m = Mechanism("polar leg")
    m.revolute("R", m.ground, m.body("arm"))
    m.prismatic("P", "arm", m.body("slide"), axis=(1, 0, 0))
    m.planar("table", m.ground, m.body("plate"))
    m.spherical("S", "slide", "plate")
    system = m.build()
    at = system.q({"P": 0.0})
    assert mobility(system, at).idle == 0
    report = mobility(system, system.assemble({"P": 0.4}, start=at).q)
    assert (report.gruebler, report.dof, report.idle, report.redundant) == (2, 3, 0, 1)


def test_a_rigid_structure_has_no_generic_neighbours():
    system = kempe.load("shaky_3r")
    assert (
        sample_nearby_ranks(
            system, compute_rank(system, mobility(system).q), np.random.default_rng(0)
        )
        == []
    )


def test_a_regular_configuration_is_generic_itself():
    """Where constraints depend on each other more points are looked at than where they do not:
    there one is enough.
    """
    for name, least, most in (("four_bar", 1, 1), ("bennett", 2, 99)):
        system = kempe.load(name)
        found = sample_nearby_ranks(
            system, compute_rank(system, mobility(system).q), np.random.default_rng(0)
        )
        assert least <= len(found) <= most and all(r.nullity == 1 for r in found)


def test_a_driven_rod_is_not_idle():
    m = kempe.load("rssr").mechanism
    ball = next(j for j in m.joints.values() if j.type.type_name == "spherical")
    driven = m.copy()
    driven.joints[ball.name] = replace(ball, actuated=True)
    assert mobility(m.build()).idle == 1 and mobility(driven.build()).idle == 0


# ---- redundancy


def slotted() -> System:
    """A four-bar linkage in space, one of whose joints is two turns with a slide between them: a
    plane of motions.
    """
    m = Mechanism("slotted")
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", m.ground, m.body("b"), at=(3, 0, 0.2))
    m.revolute("C", "a", m.body("c"), at=(0, 1, 0.1))
    m.joint("S", SLOT, "c", "b", at=(2, 0, 0.1), child_at=(0, 1.5, 0))
    m.postures["closed"] = m.build().q_dict(m.build().assemble(start={"A": 0.3, "S.x": 0.9}).q)
    return m.build()


RELEASED = [c.name for c in SPATIAL if c.redundant and c.name != "three_upu_snu"] + ["slotted"]


@pytest.mark.parametrize("name", some(RELEASED, 3))
def test_releases_remove_what_is_redundant_and_nothing_else(name):
    """By velocities of bodies, which know nothing of loops: rows are the directions that joints
    hold.
    """
    system = slotted() if name == "slotted" else kempe.load(name)
    m = mobility(system, local=False)
    released = {r.joint: r.reactions for r in m.redundancy.releases}
    full = held_rows(system, m.q, {})
    kept = held_rows(system, m.q, released)
    assert len(full) == len(kept) + m.redundant
    assert rank_of(full) == rank_of(kept) == len(kept)
    assert rank_of(full) == 6 * (len(system.body_names) - 1) - m.rank_dof
    assert name == "slotted" or rank_of(full) == rank_of(joint_constraints(system, m.q))
    stressed = dict(m.redundancy.stressed)
    # a direction carries self-stress if it can be left out without a new freedom
    for joint in system.structure.joints:
        for reaction in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
            less = held_rows(system, m.q, {joint: (reaction,)})
            if len(less) < len(full):
                assert (rank_of(less) == rank_of(full)) == (reaction in stressed.get(joint, ())), (
                    joint,
                    reaction,
                )


def rank_of(rows: np.ndarray) -> int:
    values = np.linalg.svd(rows, compute_uv=False)
    assert not np.any((values > 1e-9 * values[0]) & (values < 1e-5 * values[0]))
    return int((values > 1e-7 * values[0]).sum())


SLOT = "R(z) P(x) R(z)"
MOVES = {
    "revolute": {"Mz"},
    "prismatic": {"Fz"},
    "universal": {"Mx", "My"},
    "spherical": {"Mx", "My", "Mz"},
    SLOT: {"Fx", "Fy", "Mz"},
}


def held_rows(system: System, q: np.ndarray, released: dict[str, tuple[str, ...]]) -> np.ndarray:
    """Rows on the twists of all bodies: relative velocities that joints hold, in their own axes at
    the origin of M.
    """
    pose = dict(zip(system.body_names, system.fk(q), strict=True))
    column = {b: 6 * i for i, b in enumerate(system.body_names[1:])}
    rows = []
    for joint in system.structure.joints.values():
        F = pose[joint.parent] @ joint.X_PF.evaluate_pose(system.structure.parameters)
        M = pose[joint.child] @ joint.X_CM.evaluate_pose(system.structure.parameters)
        R = F[:3, :3]
        p = M[:3, 3]
        if joint.type.type_name == "universal":
            x = F[:3, 0]
            y = M[:3, 1]
            R = np.stack([x, y, np.cross(x, y)], axis=1)
        own = {f"F{a}": np.r_[R[:, k], np.cross(p, R[:, k])] for k, a in enumerate("xyz")}
        own |= {f"M{a}": np.r_[0, 0, 0, R[:, k]] for k, a in enumerate("xyz")}
        for label, wrench in own.items():
            if label in MOVES[joint.type.type_name] or label in released.get(joint.name, ()):
                continue
            row = np.zeros(6 * len(column))
            for body, sign in ((joint.parent, -1.0), (joint.child, 1.0)):
                if body in column:
                    row[column[body] : column[body] + 6] += sign * wrench
            rows.append(row)
    return np.array(rows)


def test_repairs_have_names():
    (release,) = mobility(kempe.load("four_bar_spatial")).redundancy.releases
    assert set(release.reactions) == {"Mx", "My", "Fz"}
    assert (
        f"{release.joint}: two moments and one force (Mx, My, Fz): use a point-on-axis pair"
        in str(release)
    )
    (release,) = mobility(kempe.load("sarrus")).redundancy.releases
    assert (
        len(release.reactions) == 1
        and release.reactions[0][0] == "M"
        and release.pair == "a universal joint"
    )


def test_a_sarrus_linkage_with_its_repair_has_no_redundancy():
    system = kempe.load("sarrus")
    (release,) = mobility(system).redundancy.releases
    m = system.mechanism
    j = m.joints[release.joint]  # turns about z; the repaired one about z and about x or y besides
    # the x axis of the universal joint is the old z, its y the released direction
    to_x = (("ry", (math.pi / 2,)),)
    turn = Placement(to_x if release.reactions == ("My",) else (("rz", (math.pi / 2,)), *to_x))
    q = system.q("closed")
    angle = float(q[system.coordinate_names.index(j.name)])
    X_CM = Placement((*j.X_CM.steps, ("rz", (-angle,))))  # at q its frames coincide
    m.joints[j.name] = replace(j, type=Universal(), X_PF=j.X_PF @ turn, X_CM=X_CM @ turn)
    m.postures.clear()
    repaired = m.build()
    known = {n: v for n, v in system.q_dict(q).items() if n in repaired.coordinate_names}
    report = mobility(repaired, known)
    assert (report.gruebler, report.dof, report.redundant) == (1, 1, 0)


def test_two_rods_where_one_would_do():
    m = Mechanism("swing", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", m.ground, m.body("b"), at=(3, 0))
    m.revolute("C", "a", m.body("c"), at=(0, 1))
    m.revolute("D", "c", "b", at=(3, 0), child_at=(0, 1))
    m.distance("rod", "a", "b", 3.0, at=(0, 0.5), child_at=(0, 0.5))
    report = mobility(m.build())
    assert (report.gruebler, report.dof, report.redundant) == (0, 1, 1)
    assert [str(r) for r in report.redundancy.releases] == ["leave out the constraint rod"]
    assert dict(report.redundancy.stressed)["rod"] == ("F",)


def test_a_gear_can_be_the_redundant_constraint():
    m = kempe.load("parallelogram").mechanism
    a = "A"
    b = next(j.name for j in m.joints.values() if j.parent == m.ground.name and j.name != "A")
    m.gear(b, a, 1.0)
    system = m.build()
    q = {
        n: v for n, v in kempe.load("parallelogram").mechanism.postures["closed"].items() if n != b
    }
    report = mobility(system, q)
    assert (report.gruebler, report.dof, report.redundant) == (0, 1, 1)
    assert f"coupling of {b}" in dict(report.redundancy.stressed)


# ---- control


def test_motors_that_control_are_too_few_or_too_many():
    four = kempe.load("four_bar")
    five = kempe.load("five_bar")
    assert mobility(four, actuated=["A"]).control.complete
    both = mobility(four, actuated=["A", "D"]).control
    assert both.complete and both.excess == 1 and "redundant actuation" in str(both)
    rail = kempe.Mechanism("wedge", dim=2)
    rail.prismatic("P1", rail.ground, rail.body("w"), axis="x")
    rail.prismatic("P2", "w", rail.body("f"), axis=(2.0, 1.0))
    rail.prismatic("P3", rail.ground, "f", axis="y")
    wedge = mobility(rail.build())
    assert wedge.dof == 1
    assert "P1: one moment (about the normal)" in str(wedge.redundancy)
    driven = next(iter(five.structure.joints))
    one = mobility(five, actuated=[driven]).control
    assert not one.complete and (one.controlled, one.useful, one.excess) == (1, 2, 0)
    (free,) = one.free
    assert driven not in free and max(map(abs, free.values())) == pytest.approx(1.0)
    v = np.array([free.get(n, 0.0) for n in five.structure.velocity_names])
    q = mobility(five).q
    assert (
        np.abs(closure_error(five, five.configuration_space.integrate(q, 1e-6 * v))).max() < 1e-10
    )
    assert mobility(system_without_motors()).control is None


def system_without_motors() -> System:
    m = kempe.load("four_bar").mechanism
    m.joints.update({n: replace(j, actuated=None) for n, j in m.joints.items()})
    return m.build()


def test_idle_spins_need_no_motor():
    delta = mobility(kempe.load("delta_ss"))
    assert delta.control.complete and delta.control.useful == 3 and not delta.control.free
    legs = mobility(kempe.load("stewart_sps"))
    assert legs.control.complete and legs.control.useful == 6


def test_a_slider_cannot_drive_its_crank_through_the_dead_point():
    system = kempe.load("slider_crank")
    r = system.structure.parameters["r"]
    rod = system.structure.parameters["l"]
    slide = next(
        j.name for j in system.structure.joints.values() if j.type.type_name == "prismatic"
    )
    dead = system.assemble({slide: r + rod - 1e-9}, start=system.assemble({"A": 0.01}).q).q
    stretched = system.assemble({"A": 0.0}, start=dead).q
    at_dead, beside = (
        mobility(system, q, actuated=[slide]).control for q in (stretched, system.q("closed"))
    )
    assert beside.complete and not beside.singular
    assert not at_dead.complete and at_dead.singular and at_dead.excess == 0
    assert mobility(system, stretched, actuated=["A"]).control.complete


# ---- the report


@pytest.mark.parametrize("name", ["bennett", "delta_uu", "wunderlich", "stewart_sps", "four_links"])
def test_the_report_is_text_html_and_data(name):
    m = mobility(kempe.load(name), local=name != "wunderlich")
    text = str(m)
    data = json.loads(json.dumps(m.data()))
    assert m.sentence in text and data["gruebler"] == m.gruebler and data["dof"] == m.dof
    assert "<table>" in m._repr_html_() and m.name in m._repr_html_()
    assert len(data["idle_freedoms"]) == m.idle


def test_what_is_not_known_is_not_said():
    m = mobility(kempe.load("bennett"), local=False)
    assert m.dof is None and m.useful is None and "not tested" in m.sentence
    assert isinstance(m, Mobility) and m.rank_dof == 1
    assert "below 1e-09" in str(mobility(kempe.load("schatz"))) and "proven: " in str(
        mobility(kempe.load("bennett"))
    )


def test_the_reason_for_the_freedoms_of_trees_is_true():
    """Gears and wheels are held by more than their joints."""
    m = Mechanism("gears", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", m.ground, m.body("b"), at=(1, 0))
    assert "no loops: all joints move independently" in str(mobility(m.build()))
    m.gear("B", "A", -2.0)
    geared = str(mobility(m.build()))
    assert "no loops; 'B' follows 'A'; all other joints move independently" in geared
    assert "move independently" not in str(mobility(kempe.load("car")))


def test_trees_and_nothing():
    arm = mobility(kempe.load("panda"))
    assert (
        arm.dof == arm.gruebler == arm.rank_dof == len(kempe.load("panda").structure.velocity_names)
    )
    assert arm.redundant == 0 and arm.loops == () and not arm.singular
    empty = mobility(Mechanism("empty").build())
    assert empty.dof == empty.gruebler == 0


def test_groups_of_loops_are_counted_by_themselves():
    m = Mechanism("two four-bars", dim=2)
    for k in range(2):
        m.attach(kempe.load("four_bar"), at=(2.0 * k, 0), prefix=f"m{k}_")
    q = {
        f"m{k}_{n}": v
        for k in range(2)
        for n, v in kempe.load("four_bar").mechanism.postures["closed"].items()
    }
    system = m.build()
    report = mobility(system, q)
    assert [(c.gruebler, c.rank_dof, c.redundant) for c in report.clusters] == [
        (1, 1, 0),
        (1, 1, 0),
    ]
    assert (report.gruebler, report.dof, report.outside) == (2, 2, 0)
    names = [*kempe.load("four_bar").joint_names]
    for k, (c, cut) in enumerate(zip(report.clusters, system.structure.closures, strict=True)):
        assert sorted(c.joints) == sorted(f"m{k}_{n}" for n in names) and c.loops == (cut,)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_axes_through_one_point_away_from_the_origin(scale):
    """The spread of the joints is rounding there, and no length."""
    spherical = loop("spherical", [("revolute", np.zeros(3), unit(z)) for z in SPREAD[:5]])
    m = look(spherical, scale, moved=True)
    assert (m.gruebler, m.rank_dof, m.dof, m.redundant) == (-1, 2, 2, 3)
    assert m.loops[0].motion == "turns about one point"
    jack = [
        ("revolute", np.zeros(3), Z),
        ("helical", np.zeros(3), Z, {"pitch": 0.1}),
        ("prismatic", np.zeros(3), Z),
    ]
    m = look(loop("screw jack", jack), scale, moved=True)
    assert (m.gruebler, m.rank_dof, m.dof) == (-3, 1, 1)


@pytest.mark.parametrize("seed", range(4))
def test_redundancy_does_not_depend_on_the_seed_where_branches_meet(seed):
    """Flat, Miura's panels fold along both straight lines at once (2), or in ways of one freedom."""
    m = look(miura(3, 3, 0.0), rng=seed)
    assert (m.gruebler, m.dof, m.local.branch_dims[0], m.local.branch_dims[-1]) == (-12, 2, 2, 1)
    assert (m.generic_rank_dof, m.redundant) == (1, 13)


@pytest.mark.slow
@pytest.mark.parametrize("off", some([1e-6, 1e-7, 1e-8], 3))
def test_what_is_nearly_a_mechanism_is_none_for_certain_or_probably_one(off):
    """A Bennett linkage whose axes are off by this much is no mechanism, but nearly one."""
    system = kempe.load("bennett")
    rng = np.random.default_rng(0)
    pose = dict(zip(system.body_names, system.fk(system.q("closed")), strict=True))
    world = World("nearly")
    for j in system.structure.joints.values():
        F = pose[j.parent] @ j.X_PF.evaluate_pose(system.structure.parameters)
        p = F[:3, 3] + off * rng.normal(size=3)
        z = F[:3, 2] + off * rng.normal(size=3)
        world.turn(
            *("ground" if b == system.body_names[0] else b for b in (j.parent, j.child)), p, z
        )
    report = look(world)
    assert report.dof == 0 if report.certain else "probably" in report.sentence


def test_drives_are_a_list_and_tolerances_are_small():
    system = kempe.load("four_bar")
    q = system.q("closed")
    with pytest.raises(InputError, match="list of names"):
        mobility(system, q, actuated=3)  # pyright: ignore[reportArgumentType]
    for tolerance in (0.0, -1.0, 1.0, 2.0, float("nan")):
        with pytest.raises(InputError, match="tolerance"):
            find_local_dimension(system, q, tolerance=tolerance)
