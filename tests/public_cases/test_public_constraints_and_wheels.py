"""Public reports about equations, contacts, wheels, bounces and gears."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from public_oracles import PI
from scipy.integrate import solve_ivp

import kempe
from kempe import Mechanism, System, constraints

# ---- equations and gears


def planetary(ring_held: bool) -> System:
    """Sun 18, planet 12 and ring 42 teeth, by the formula of Willis in the frame of the carrier."""
    m = Mechanism("planetary", dim=2)
    bodies = {name: m.body(name) for name in ("sun", "carrier", "planet", "ring")}
    for joint, body in (("S", "sun"), ("C", "carrier"), ("R", "ring")):
        m.revolute(joint, m.ground, bodies[body])
    m.revolute("P", bodies["carrier"], bodies["planet"], at=(0.1125, 0))
    m.equation("sun and planet", "18*(S-C)+12*P")
    m.equation("ring and planet", "42*(R-C)-12*P")
    if ring_held:
        m.equation("ring", "R")
    return m.build()


def test_ratios_of_a_planetary_gear():
    """brepjs, issue 846: the carrier turns 0.3, the planet -0.75 of the sun; a wrong formula gave
    -1.2.
    """
    s = planetary(ring_held=True)
    assert s.mobility().dof == 1
    answer = s.assemble({"S": 1.0})
    values = s.q_dict(answer.q)
    assert values["C"] == pytest.approx(0.3, abs=1e-12)
    assert values["C"] + values["P"] == pytest.approx(-0.75, abs=1e-12)
    ratios = s.loops.jacobian(answer.q, inputs=["S"], outputs=["C", "P"]).matrix[:, 0]
    np.testing.assert_allclose(ratios, [0.3, -1.05])
    assert planetary(ring_held=False).mobility().dof == 2


def test_redundant_constraints_of_a_lever_are_counted_and_named():
    """solvespace, issues 671 and 1717; asm3, issue 753: a lever has two coincident planes; which
    one is redundant?
    """
    m = Mechanism("lever")
    lever = m.body("lever")
    m.free("F", m.ground, lever)
    m.frame("e1", lever, at=(0, 0, 0))
    m.frame("e2", lever, at=(1, 0, 0))
    m.constrain(constraints.Position("e1", (0, 0, 0)), "pin")
    m.constrain(constraints.Pointing("e1", (0, 0, 1)), "first normal")
    m.constrain(constraints.Pointing("e2", (0, 0, 1)), "second normal")
    m.constrain(constraints.OnPlane("e2", normal=(0, 0, 1)), "second plane")
    s = m.build()
    mobility = s.mobility()
    assert mobility.dof == 1
    assert "normal" in str(mobility) or "second plane" in str(mobility)
    assert s.assemble(
        start=s.configuration_space.integrate(s.neutral, [0.3, 0.1, -0.2, 0.4, 0.5, 0.6])
    )


def test_three_angles_of_a_triangle_are_two_conditions():
    """solvespace, issue 671: all three angles of a sketch are dimensioned; how many freedoms are
    left of nine?
    """
    m = Mechanism("triangle", dim=2)
    for i in range(3):
        m.planar(f"p{i}", m.ground, m.body(f"side{i}"))
    for i, angle in enumerate((2 * PI / 3, 2 * PI / 3, -4 * PI / 3)):
        m.equation(f"angle {i}", f"p{i}.rz - p{(i + 1) % 3}.rz - ({angle!r})")
    assert m.build().mobility().dof == 7


# ---- bounces


def test_bounce_times_of_a_ball_are_those_of_a_geometric_series():
    """Wolfram Demonstrations, "Bounce Time": from 1.5 m with restitution 0.7, 13 bounces by 3.10 s,
    rest at 3.135 s.
    """
    m = Mechanism("ball")
    m.free("f", m.ground, m.body("ball"))
    m.contact("floor", "ball", radius=0.0)
    s = m.build()
    events = s.simulate(
        4.0, s.q({"f.z": 1.5, "f.qw": 1.0}), velocity={"f.x": 1.0}, restitution=0.7
    ).events
    first = math.sqrt(2 * 1.5 / 9.81)
    times = first * (1 + 2 * np.cumsum(0.7 ** np.arange(13)) - 2)
    np.testing.assert_allclose([e.time for e in events][:13], times, atol=1e-9)
    assert times[12] == pytest.approx(3.10, abs=0.01)
    end = first * (1 + 2 * 0.7 / 0.3)
    assert end == pytest.approx(3.135, abs=0.002) and events[-1].time == pytest.approx(
        end, abs=1e-6
    )


# ---- wheels


def test_a_tractor_with_a_trailer_moves_as_its_differential_equation():
    """MRPT, issue 408; rsmotion, issue 4: the hitch is behind the rear axle; what is controllable,
    where does it go?
    """
    wheelbase = 2.5
    hitch = 0.6
    trailer = 3.0
    m = Mechanism("tractor and trailer", dim=2)
    front = m.body("tractor")
    rear = m.body("trailer")
    m.planar("p", m.ground, front)
    m.no_sideslip("rear axle", front)
    m.revolute("hitch", front, rear, at=(-hitch, 0))
    m.frame("axle", rear, at=(-trailer, 0))
    m.no_sideslip("trailer wheels", "axle")
    s = m.build()
    kind = s.classify({"hitch": 0.3})
    assert (kind.position_dof, kind.velocity_dof, kind.growth[-1]) == (4, 2, 4)
    v = 1.0
    w = 0.25
    assert math.atan(wheelbase * w / v) < 0.6  # a steering angle that a tractor has

    def rates(_, x):
        heading = x[2]
        angle = x[3]
        # of the hitch, in the frame of the trailer
        sideways = -math.sin(angle) * v + math.cos(angle) * -hitch * w
        return [v * math.cos(heading), v * math.sin(heading), w, sideways / trailer - w]

    expected = solve_ivp(rates, (0, 6), [0, 0, 0, 0.2], rtol=1e-11, atol=1e-12).y[:, -1]
    motion = s.simulate(6.0, start={"hitch": 0.2}, inputs={"tractor.vx": v, "tractor.wz": w})
    np.testing.assert_allclose(motion.q[-1], expected, rtol=0, atol=1e-6)


def test_a_rolling_disc_reaches_every_place_heading_and_angle():
    """Pages about nonholonomic systems: a disc rolls on a plane; which coordinates can it reach?"""
    m = Mechanism("disc")
    yoke = m.body("yoke")
    disc = m.body("disc")
    m.planar("p", m.ground, yoke, at=(0, 0, 0.2))
    m.revolute("roll", yoke, disc, axis="y")
    m.rolls("floor", disc, radius=0.2, shape="disc")
    kind = m.build().classify()
    assert (kind.position_dof, kind.velocity_dof, tuple(kind.growth)) == (4, 2, (2, 3, 4))


def test_a_wheel_on_a_track_is_integrable():
    """Pages about nonholonomic systems: x - R phi is constant on a straight track; is that
    recognised?
    """
    m = Mechanism("track", dim=2)
    wheel = m.body("wheel")
    m.prismatic("x", m.ground, m.body("hub"), axis=(1, 0))
    m.revolute("phi", "hub", wheel)
    m.velocity_equation("roll", lambda v: [[1, 0.2]], of=("x", "phi"))
    kind = m.build().classify()
    assert kind.reachable_dimension == 1 and "integrable" in str(kind)


def test_a_ball_that_may_not_spin_has_growth_two_three_five():
    """Pages about nonholonomic systems: the ball on a plate without spin, the classical
    distribution (2, 3, 5).
    """
    m = Mechanism("ball")
    m.free("J", m.ground, m.body("ball"))
    m.rolls("plate", "ball", radius=0.1, spin=False)
    assert tuple(m.build().classify().growth) == (2, 3, 5)


def test_wheel_angles_of_a_differential_drive_reach_four_dimensions():
    """burro, issue 36, and pages about rolling: R (right - left) = 2 b heading is a hidden position
    constraint.
    """
    R = 0.1
    b = 0.25
    m = Mechanism("differential drive", dim=2)
    chassis = m.body("chassis")
    m.planar("p", m.ground, chassis)
    m.revolute("left", chassis, m.body("left wheel"))
    m.revolute("right", chassis, m.body("right wheel"))

    def rolling(x):
        c = np.cos(x["p.rz"])
        s = np.sin(x["p.rz"])
        return [[s, -c, 0, 0, 0], [c, s, b, 0, -R], [c, s, -b, -R, 0]]

    m.velocity_equation("rolling", rolling, of=("p.x", "p.y", "p.rz", "left", "right"))
    kind = m.build().classify()
    assert (kind.velocity_dof, kind.reachable_dimension) == (2, 4)
    assert tuple(kind.growth)[:3] == (2, 3, 4)


LENGTHS = json.loads((Path(__file__).parent / "reeds_shepp.json").read_text())["goals"]
"""Goals (x, y, heading) and the lengths of the shortest ways that the package rsplan found."""


@pytest.mark.slow
@pytest.mark.parametrize("part", range(3))
def test_ways_of_a_car_are_no_longer_than_those_of_rsplan(part):
    """rsmotion and OMPL users: the shortest way of a car with turning radius 1.3 m, against the
    package rsplan.
    """
    s = kempe.load("car")
    for *goal, length in LENGTHS[part::3]:
        way = s.manoeuvre([0, 0, 0], goal, radius=1.3)
        assert np.abs(way.q[-1][:2] - goal[:2]).max() < 1e-9
        assert abs(math.remainder(way.q[-1][2] - goal[2], 2 * PI)) < 1e-9
        assert all(abs(p.turning) <= abs(p.forward) / 1.3 + 1e-9 for p in way.pieces)
        own = sum(abs(p.forward) * p.duration for p in way.pieces)
        assert own <= length + 1e-6, goal
