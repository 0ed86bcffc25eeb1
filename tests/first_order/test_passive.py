"""Idle freedoms: every form of a ball, what is driven, carried, held by one part; judged by moving
and null space.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hunts import some
from literature import look
from oracles.maximal import maximal_jacobian
from rods import FORMS, UNITS, Rods, mechanism
from world_mechanisms import World

import kempe
from kempe import Mechanism, System
from kempe.equations.closure_rows import compute_residual
from kempe.first_order.idle_freedoms import IdleFreedom
from kempe.mobility.mobility import mobility
from kempe.spatial import exp_so3

ANGLE = 0.02
"""Angle of a finite spin, where hinges turn as fast; three hinges that turn faster are soon in one
plane."""


def groups(freedoms) -> list[frozenset[str]]:
    return sorted((frozenset(f.bodies) for f in freedoms), key=sorted)


def assert_spins(system: System, q: np.ndarray, f: IdleFreedom) -> None:
    """Moved by a finite amount and closed again, the group has turned about the axis, and nothing
    but its links too.
    """
    group = {*f.bodies, *f.links}
    moved = {j.name for j in system.mechanism.joints.values() if {j.parent, j.child} & group}
    others = {n: x for n, x in system.q_dict(q).items() if n.partition(".")[0] not in moved}
    point = np.array(f.point)
    direction = np.array(f.direction)
    before = system.fk(q)
    turn = np.eye(4)
    speed = f.velocity / rate_of(system, q, f)
    angle = ANGLE / np.max(speed**2)
    turn[:3, :3] = exp_so3(angle * direction)
    turn[:3, 3] = point - turn[:3, :3] @ point
    start = system.configuration_space.integrate(q, angle * speed)
    first = turn @ before[system.body_names.index(f.bodies[0])]
    answer = system.assemble(others | {f.bodies[0]: first}, start, budget=kempe.Budget(starts=1))
    assert answer.success and np.abs(compute_residual(system, answer.q)).max() < 1e-9
    after = system.fk(answer.q)
    inside = [system.body_names.index(b) for b in (*f.bodies, *f.links)]
    still = [b for b in range(len(before)) if b not in inside]
    assert np.abs(after[still] - before[still]).max() < 1e-9
    turned = after[inside[: len(f.bodies)]] @ np.linalg.inv(before[inside[: len(f.bodies)]])
    assert np.abs(turned - turn).max() < 1e-8 < angle, "the group turns as one about the axis"


def rate_of(system: System, q: np.ndarray, f: IdleFreedom) -> float:
    """How fast the first body turns about the axis."""
    return float(system.jacobian(q, f.bodies[0])[3:] @ f.velocity @ f.direction)


def alone(system: System, q: np.ndarray, bodies) -> int:
    """In how many ways these bodies can move while all others rest: a null space in maximal
    coordinates.
    """
    J = maximal_jacobian(system, kempe.convert.to_maximal(system, q))
    columns = [6 * (system.body_names.index(b) - 1) + k for b in bodies for k in range(6)]
    values = np.linalg.svd(J[:, columns], compute_uv=False)
    return len(columns) - int((values > 1e-9 * values.max()).sum())


def check(r: Rods) -> None:
    """What is said to spin is what was built to spin."""
    system = r.world.build()
    q = system.neutral
    m = mobility(system, q, local=False)
    found = groups(m.idle_freedoms)
    assert found == sorted(r.idle, key=sorted), f"{found} and not {r.idle}"
    for f in m.idle_freedoms:
        assert_spins(system, q, f)
        assert alone(system, q, (*f.bodies, *f.links)) >= 1
        assert f.joined == through_joints(r.world, f), str(f)


def through_joints(w: World, f: IdleFreedom) -> bool:
    """Whether the origins of both joints, or the ends of rods, are two points of the axis."""
    places = {name: p for name, _, _, _, p, _, _ in w.joints}
    places |= {name: at if a in f.bodies else end for name, _, a, _, at, end, _ in w.constraints}
    first, second = (places[n] - f.point for n in f.joints)
    off = [np.linalg.norm(np.cross(d, f.direction)) for d in (first, second)]
    return bool(max(off) < 1e-7 and abs((second - first) @ f.direction) > 1e-7)


# ---- one by one


@pytest.mark.parametrize("first, second", [*product(FORMS, FORMS)])
def test_a_rod_spins_whatever_its_balls_are_made_of(first, second):
    r = Rods(np.random.default_rng(5))
    a = r.arm("ground")
    b = r.arm("ground")
    r.ball(a, "rod", r.point(), first)
    r.ball("rod", b, r.point(), second)
    system = r.world.build()
    m = mobility(system, system.neutral)
    assert (m.dof, m.idle, m.useful) == (2, 1, 1)
    assert m.idle_freedoms[0].bodies == ("rod",)
    assert_spins(system, m.q, m.idle_freedoms[0])


@pytest.mark.parametrize("unit", some(UNITS, 3), ids=lambda u: u.__name__)
def test_what_spins_and_what_does_not(unit):
    for seed in range(6):
        r = Rods(np.random.default_rng(seed))
        unit(r, "ground")
        check(r)


def leg() -> System:
    m = Mechanism("leg")
    m.revolute("hip", m.ground, m.body("thigh"), axis=(0, 1, 0))
    m.revolute("knee", "thigh", m.body("shin"), at=(0, 0, -1), axis=(0, 1, 0))
    m.spherical("b1", m.ground, m.body("rod"), at=(0, 0.2, 0))
    m.spherical("b2", "shin", "rod", at=(0, 0.2, -0.3), child_at=(0.1, 0, -1.2))
    return m.build()


@pytest.mark.parametrize("actuated", [None, [], ["hip"], ["knee"], ["hip", "knee"]])
def test_a_leg_whose_hip_goes_through_a_ball_is_not_idle(actuated):
    system = leg()
    m = mobility(system, system.assemble().q, actuated)
    assert (m.dof, m.idle, m.useful) == (2, 1, 1) and m.idle_freedoms[0].bodies == ("rod",)


def test_a_motor_that_is_named_keeps_a_rod_from_being_idle():
    r = Rods(np.random.default_rng(1))
    a = r.arm("ground")
    b = r.arm("ground")
    w = r.world
    for k, (i, j) in enumerate(zip((a, "x", "y"), ("x", "y", "rod"), strict=True)):
        w.turn(i, j, (0, 0, 1), np.eye(3)[k], name=f"m{k}")
    r.ball("rod", b, r.point(), "S")
    system = w.build()
    assert mobility(system, system.neutral).idle == 1
    for motor in ("m0", "m1", "m2"):
        m = mobility(system, system.neutral, [motor])
        assert m.idle == 0 and m.useful == m.control.useful == 2


@pytest.mark.parametrize("at, idle", [((0, 0.5, 0), 1), ((0.2, 0.5, 0), 0)])
def test_a_frame_off_the_axis_of_a_rod_makes_it_useful(at, idle):
    w = World("tool")
    w.turn("ground", "a", (1, 0, 0))
    w.ball("a", "rod", (0, 0, 0), name="b1")
    w.ball("rod", "b", (0, 1, 0), name="b2")
    w.turn("b", "ground", (0, 1, 1), (1, 0, 0))
    m = w.build().mechanism
    m.frame("tool", "rod", at=at)
    system = m.build()
    assert mobility(system, system.neutral).idle == idle


@pytest.mark.parametrize(
    "form, actuated, idle", [("S", None, 1), ("RRR", None, 0), ("RRR", ["base"], 1), ("RRR", [], 1)]
)
def test_an_elbow_swings_idly_if_its_joints_are_known_to_be_passive(form, actuated, idle):
    """Two links with an elbow between two balls: an arm of seven hinges is such a thing, and these
    may be motors.
    """
    r = Rods(np.random.default_rng(3))
    w = r.world
    w.turn("ground", "a", r.point(), r.axis(), name="base")
    r.ball("a", "upper", r.point(), form)
    w.turn("upper", "lower", r.point(), r.axis(), name="elbow")
    r.ball("lower", "b", r.point(), form)
    w.turn("b", "ground", r.point(), r.axis())
    system = w.build()
    m = mobility(system, system.neutral, actuated, local=False)
    assert m.idle == idle
    assert mobility(system, system.neutral, ["elbow"], local=False).idle == 1, (
        "it does not turn in this motion"
    )


def test_what_turns_about_an_axis_that_happens_to_pass_a_ball_is_not_idle():
    """A lead screw between two balls turns as a whole; its inner turn is no spin."""
    w = World("lead screw")
    w.turn("ground", "a", (1, 0, 0), name="A")
    w.ball("a", "nut", (0, 0, 0))
    w.joint("helical", "nut", "screw", (0, 0, 0), (0, 1, 0), pitch=0.01)
    w.ball("screw", "b", (0, 1, 0))
    w.turn("b", "ground", (0, 1, 1), (1, 0, 0))
    system = w.build()
    m = mobility(system, system.neutral, local=False)
    assert [f.bodies for f in m.idle_freedoms] == [("nut", "screw")]


@pytest.mark.parametrize(
    "name, idle",
    [("rssr", 1), ("delta_ss", 6), ("delta_uu", 0), ("stewart_sps", 6), ("stewart", 0)],
)
def test_the_shipped_ones(name, idle):
    system = kempe.load(name)
    m = mobility(system)
    assert m.idle == idle
    for f in m.idle_freedoms:
        assert_spins(system, m.q, f)


# ---- hunts


@pytest.mark.slow
def test_hunt_rods(hunt):
    """Random mechanisms of rods, legs, pistons and linkages: what spins idly is what was built to."""
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        check(mechanism(rng))


@pytest.mark.slow
def test_hunt_many_rods(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(400)):
        check(mechanism(rng))


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_a_roller_on_its_pin_is_idle_and_links_that_happen_to_be_in_line_are_not(scale):
    """Textbooks' idle freedom: a roller between an arm and a block. A rhombus folded for good is no
    such thing.
    """
    w = World("roller", 2)
    w.turn("ground", "arm", (0, 0))
    w.turn("arm", "roller", (1, 0.5))
    w.turn("roller", "block", (1, 0.5))
    w.slide("block", "ground", (0.3, 1), (1, 0.5))
    m = look(w, scale, moved=True)
    assert (m.gruebler, m.dof, m.idle, m.useful) == (1, 1, 1, 0)
    w.joints[-1] = ("bar", "revolute", "block", "bar", np.array([2.0, 1.0, 0.0]), np.eye(3), {})
    w.turn("bar", "ground", (2, 0))
    m = look(w, scale, moved=True)
    assert (m.dof, [f.bodies for f in m.idle_freedoms], m.useful) == (2, [("roller",)], 1)
    folded = World("rhombus", 2)
    for a, b, p in (
        ("ground", "a", (0, 0)),
        ("a", "b", (1, 0)),
        ("b", "c", (1.6, 0.8)),
        ("c", "ground", (1, 0)),
    ):
        folded.turn(a, b, p)
    assert look(folded).idle == 0
