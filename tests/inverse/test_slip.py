"""Velocity constraints in steps, velocities and paths: what rolls does not slip, and where it would
is reported.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import wheels

import kempe
from kempe import Mechanism, tasks
from kempe.errors import UnsupportedError


def slips(system, frame: str, q, v) -> float:
    """Velocity of a frame's origin along its y axis, by its Jacobian."""
    return float(np.asarray(system.jacobian(q, frame, "body"))[1] @ v)


def with_arm():
    """A cart on an axle with an arm of two joints."""
    m = Mechanism("mobile arm", dim=2)
    body = m.body("body")
    upper = m.body("upper")
    lower = m.body("lower")
    m.planar("pose", m.ground, body)
    m.revolute("shoulder", body, upper, at=(0.3, 0.1))
    m.revolute("elbow", upper, lower, at=(0.5, 0))
    m.frame("tip", lower, at=(0.4, 0))
    m.no_sideslip("axle", "body")
    return m.build()


# ---- one step


def test_steps_do_not_slip(hunt):
    rng = hunt.rng()
    system = with_arm()
    for _ in range(hunt.cases(60)):
        q = rng.uniform(-2, 2, system.nq)
        dt = 10.0 ** rng.uniform(-4, -1)
        wanted = rng.normal(size=6) * [1, 1, 0, 0, 0, 1]
        for step in (
            system.ik_step(q, wanted, "tip", dt, damping=0.0),
            system.ik_step(q, system.fk(rng.uniform(-2, 2, system.nq), "tip"), "tip", dt),
            system.ik_step(
                q,
                [tasks.Position("tip", [*rng.uniform(-2, 2, 2), 0]), tasks.Posture(q, weight=0.1)],
                None,
                dt,
            ),
        ):
            assert abs(slips(system, "body", q, step.velocity)) < 1e-9
            way = system.configuration_space.difference(q, step.q)
            middle = system.configuration_space.integrate(q, 0.5 * way)
            assert (
                abs(slips(system, "body", middle, way))
                < 1e-3 * dt**3 + 0.5 * np.linalg.norm(way) ** 3
            )


def test_a_step_gives_the_twist_that_rolling_leaves():
    """The arm makes up for what the axle does not allow; without it only the allowed part is had."""
    system = with_arm()
    q = np.array([0.0, 0.0, 0.0, 0.5, 0.7])
    step = system.ik_step(
        q, [0.1, 0.2, 0, 0, 0, 0.3], "tip", 0.01, damping=0.0, velocity_limits=math.inf
    )
    assert step.fraction == pytest.approx(1.0) and step.twist == pytest.approx(
        [0.1, 0.2, 0, 0, 0, 0.3]
    )
    bare = wheels.knife().ik_step(np.zeros(3), [0, 1.0, 0, 0, 0, 0], "body", 0.01)
    assert bare.fraction == 0.0 and not bare.velocity.any()
    half = wheels.knife().ik_step(np.zeros(3), [0.5, 0.5, 0, 0, 0, 0], "body", 0.01)
    assert half.velocity == pytest.approx([0.5, 0, 0]) and half.fraction == pytest.approx(0.5)


def test_a_step_names_why_the_rest_is_missing():
    """Wheels, limits of the call, and default speeds, which are no limits of the car."""
    car = kempe.load("car")
    aside = car.ik_step(car.neutral, [0, 1.0, 0, 0, 0, 0], "car", 0.1)
    assert str(aside.status) == "No motion: the wheels of 'rear axle' do not slip sideways"
    assert aside.blocked_by == ("rear axle",) and aside.saturated == aside.default_speed == ()
    fast = car.ik_step(car.neutral, [2.0, 0, 0, 0, 0, 0], "car", 0.1)
    assert (
        str(fast.status)
        == "0.5 of the wanted motion: at the default speed (pi rad/s, 1 m/s): 'drive.x'"
    )
    assert fast.default_speed == ("drive.x",) and fast.blocked_by == ()
    limited = car.ik_step(car.neutral, [2.0, 0, 0, 0, 0, 0], "car", 0.1, velocity_limits=0.5)
    assert (
        str(limited.status) == "0.25 of the wanted motion: at a limit: 'drive.x'"
        and limited.default_speed == ()
    )
    full = car.ik_step(car.neutral, [1.0, 0, 0, 0, 0, 0], "car", 0.1)
    assert str(full.status) == "The wanted motion in full"
    tasked = car.ik_step(car.neutral, tasks.Position("car", [0.0, 1.0]), dt=0.1)
    assert tasked.blocked_by == ("rear axle",)


@pytest.mark.slow
def test_cycles_lead_a_mobile_arm_to_its_target():
    """Without slip: the place of the axle is that of the unicycle with the speeds that it had."""
    system = with_arm()
    q = np.array([0.0, 0.0, 0.0, 0.5, 0.7])
    goal = tasks.Position("tip", [1.0, 1.5, 0.0])
    for _ in range(400):
        q = system.ik_step(q, [goal], None, 0.02).q
    assert system.fk(q, "tip")[:2, 3] == pytest.approx([1.0, 1.5], abs=1e-9)


# ---- velocities


def test_velocities_of_a_car():
    system = wheels.car(length=1.2)
    J = system.loops.jacobian(
        [1.0, 2.0, 0.7, 0.3], ["pose.x", "steer"], ["pose.y", "pose.rz", "fork"]
    )
    assert J.success and J.nullity == 2
    forward = 1.0 / math.cos(0.7)
    assert J.matrix[0] == pytest.approx([math.tan(0.7), 0.0])
    assert J.matrix[1] == pytest.approx([forward * math.tan(0.3) / 1.2, 0.0])
    loose = system.loops.jacobian([0, 0, 0, 0.3], ["steer"], ["pose.x"])
    assert not loose and "not determined" in loose.status
    assert system.loops.mechanical_advantage([0, 0, 0, 0.3], "pose.x", "pose.rz") == pytest.approx(
        1.2 / math.tan(0.3)
    )


def test_a_belt_under_the_wheel_is_no_proportion():
    m = Mechanism("belt", dim=2)
    m.planar("pose", m.ground, m.body("body"))
    m.no_sideslip("edge", "body", speed=0.5)
    system = m.build()
    with pytest.raises(UnsupportedError, match="speed of its own"):
        system.loops.jacobian(np.zeros(3), ["pose.x"], ["pose.y"])
    step = system.ik_step(np.zeros(3), [0.2, 0.0, 0, 0, 0, 0], "body", 0.01, damping=0.0)
    assert step.velocity == pytest.approx([0.2, 0.5, 0.0])


# ---- configurations


def test_ik_says_that_going_there_is_a_manoeuvre():
    system = wheels.knife()
    answer = system.ik(system.fk([1.0, 2.0, 0.3], "body"), "body")
    assert answer and "going there is a manoeuvre ('edge' holds on the way)" in answer.status
    assert "manoeuvre" in system.ik([tasks.Position("body", [1, 0, 0])]).status
    batch = system.ik(system.fk(np.ones((2, 3)), "body"), "body")
    assert all("manoeuvre" in s for s in batch.status)
    m = Mechanism("free", dim=2)
    m.planar("pose", m.ground, m.body("body"))
    assert "manoeuvre" not in m.build().ik(np.eye(4), "body").status


# ---- paths


@pytest.mark.slow
def test_paths_that_roll_are_followed(hunt):
    """Manoeuvres at random, sampled finely and coarsely, arcs, straight lines, cusps and turns on
    the spot.
    """
    rng = hunt.rng()
    system = wheels.knife((0.3, 0.1), 0.5)
    for _ in range(hunt.cases(15)):
        n = int(rng.integers(30, 200))
        found = system.manoeuvre(
            *rng.uniform(-2, 2, (2, 3)),
            radius=rng.choice([0.0, 0.5, 2.0]),
            budget=kempe.Budget(points=n),
        )
        path = system.ik_path(system.fk(found.q, "body"), "body", found.q[0])
        assert path, path.status
        assert np.abs(path.q - found.q).max() < 1e-8
        motion = system.drive(
            {name: found.values(name) for name in system.coordinate_names}, found.t
        )
        assert motion, motion.status


@pytest.mark.slow
def test_paths_that_slip_are_refused_with_the_place(hunt):
    """They roll up to a sample, and slip from there on."""
    rng = hunt.rng()
    system = wheels.knife()
    for _ in range(hunt.cases(15)):
        k = int(rng.integers(10, 40))
        speed = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-3, 0)
        bend = rng.normal()
        t = np.linspace(0, 1, 60)
        h = bend * t
        q = np.column_stack([np.sin(h) / bend, (1 - np.cos(h)) / bend, h])
        aside = np.where(t > t[k], speed * (t - t[k]), 0.0)
        q[:, :2] += aside[:, None] * np.column_stack([-np.sin(h), np.cos(h)])
        path = system.ik_path(system.fk(q, "body"), "body", q[0])
        where = re.search(
            r"stops before target (\d+).*slips by ([\d.e-]+) m across 'edge'", path.status
        )
        assert not path and where, path.status
        assert int(where[1]) in (k, k + 1, k + 2) and path.success.sum() == int(where[1])
        motion = system.drive(dict(zip(system.coordinate_names, q.T, strict=True)), t)
        where = re.search(r"before time ([\d.]+) by ([\d.e-]+) m/s across 'edge'", motion.status)
        assert not motion and where, motion.status
        assert t[k] - 0.02 <= float(where[1]) <= t[k + 2] + 1e-4 and len(motion.q) in (
            k,
            k + 1,
            k + 2,
        )
        assert float(where[2]) < 1.5 * abs(speed)


def test_slow_slip_all_along_is_reported_with_its_speed():
    system = wheels.knife()
    t = np.linspace(0, 2, 50)
    motion = system.drive({"pose.x": t, "pose.y": 0.01 * t, "pose.rz": 0 * t}, t)
    assert "by 0.01 m/s across 'edge'" in motion.status and not motion.success


def test_a_towed_axle_follows_a_tractrix():
    """A point ahead of the axle goes along a line: tan(angle / 2) to the line falls with exp(-way /
    length).
    """
    m = Mechanism("towed", dim=2)
    body = m.body("body")
    m.planar("pose", m.ground, body)
    m.frame("nose", body, at=(2.0, 0))
    m.no_sideslip("axle", "body")
    system = m.build()
    s = np.linspace(0, 4, 80)
    path = system.ik_path(np.column_stack([2 + 0 * s, s, 0 * s]), "nose", np.zeros(3))
    assert path and "without slip" in path.status
    assert np.abs(np.tan((0.5 * math.pi - path.q[:, 2]) / 2) - np.exp(-s / 2)).max() < 1e-4
    assert (
        np.abs(system.fk(path.q, "nose")[:, :2, 3] - np.column_stack([2 + 0 * s, s])).max() < 1e-9
    )


@pytest.mark.slow
def test_a_motion_that_rolls_along():
    system = wheels.coin(0.5)
    t = np.linspace(0, math.pi, 80)
    motion = system.drive({"roll": 2 * t, "pose.rz": 2 * t}, t, np.zeros(4))
    assert motion and motion.q[-1] == pytest.approx([0, 0, 2 * math.pi, 2 * math.pi], abs=1e-9)
    assert np.ptp(np.hypot(motion.q[:, 0], motion.q[:, 1] - 0.5)) < 1e-9
    curve = {"pose.x": 0.5 * np.sin(2 * t), "pose.y": 0.5 - 0.5 * np.cos(2 * t), "pose.rz": 2 * t}
    rolled = system.drive(curve, t, np.zeros(4))
    # of the chords of 80 samples
    assert rolled and rolled.q[-1, 3] == pytest.approx(2 * math.pi, rel=1e-3)
    functions = {"roll": lambda t: 2 * t, "pose.rz": lambda t: 2 * t + math.sin(t)}
    driven = system.drive(functions, t, np.zeros(4))
    same = system.simulate(
        math.pi, np.zeros(4), inputs={"roll": 2.0, "pose.rz": lambda t: 2 + math.cos(t)}
    )
    assert driven and np.abs(driven.q[-1] - same.q[-1]).max() < 1e-9


def test_traces_and_self_motions_tell_where_they_slip():
    system = wheels.knife()
    path = system.trace(
        "pose.y", [0, 0, 0], hold={"pose.x": 0.0, "pose.rz": 0.0}, budget=kempe.Budget(points=20)
    )
    assert not path and "slips by" in path.status and "'edge'" in path.status
    along = system.trace(
        "pose.x", [0, 0, 0], hold={"pose.y": 0.0, "pose.rz": 0.0}, budget=kempe.Budget(points=20)
    )
    assert "slips" not in along.status
    with pytest.raises(UnsupportedError, match="self-motion of mobile arm slips"):
        with_arm().inverse.self_motion(
            [0, 0, 0, 0.5, 0.7], "tip", direction="pose.y", budget=kempe.Budget(points=5)
        )


def test_inputs_that_leave_freedoms_and_limits():
    with pytest.raises(UnsupportedError, match="leave 1 freedom of motion, among 'pose.rz'"):
        wheels.coin().drive({"roll": [0.0, 1.0]}, start=np.zeros(4))
    t = np.linspace(0, 1, 40)
    stopped = wheels.knife(limits={"x": (-1, 0.5)}).drive(
        {"pose.x": t, "pose.y": 0 * t, "pose.rz": 0 * t}, t
    )
    assert (
        not stopped
        and "'pose.x' would be beyond its limit" in stopped.status
        and stopped.q[-1, 0] <= 0.5
    )
    held = wheels.coin().drive({"roll": t}, t, np.zeros(4), hold={"pose.rz": 0.0})
    assert held and held.q[-1] == pytest.approx([0.5, 0, 0, 1])


def cart(*axles: tuple[float, float, float]) -> kempe.System:
    """A body in the plane on axles, each at a place (x, y) and turned by an angle."""
    m = Mechanism("cart", dim=2)
    m.planar("pose", m.ground, m.body("body"))
    for k, (x, y, turn) in enumerate(axles):
        m.frame(f"wheel{k}", "body", at=(x, y), angle=turn)
        m.no_sideslip(f"axle{k}", f"wheel{k}")
    return m.build()


def test_ik_speaks_of_a_manoeuvre_only_where_brackets_show_one(hunt):
    """One axle is a car; two in parallel, or not, leave one freedom: a line or a circle, and no
    manoeuvre.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        first, second = rng.uniform(-1, 1, (2, 3))
        if rng.random() < 0.5:
            second[2] = first[2]
        target = kempe.spatial.pose(
            kempe.spatial.rot_z(rng.uniform(-2, 2)), [*rng.uniform(-2, 2, 2), 0.0]
        )
        one = cart(first).ik(target, "body")
        two = cart(first, second).ik(target, "body")
        assert one and "going there is a manoeuvre ('axle0' holds on the way)" in one.status
        assert two and "is a manoeuvre" not in two.status
        assert (
            "'axle0', 'axle1' hold on the way, where 2 functions of position keep their values"
            in two.status
        )


def test_a_coin_on_a_rail_has_no_manoeuvre():
    m = Mechanism("coin on a rail")
    m.prismatic("x", m.ground, m.body("yoke"), at=(0, 0, 0.3), axis="x")
    m.revolute("roll", "yoke", m.body("disc"), axis="y")
    m.rolls("floor", "disc", radius=0.3, shape="disc")
    system = m.build()
    answer = system.ik(system.fk(system.q({"x": 1.0, "roll": 0.2}), "disc"), "disc")
    assert (
        "1 function of position keeps its value" in answer.status
        and "is a manoeuvre" not in answer.status
    )


def test_ik_does_not_point_to_manoeuvres_that_are_not_known():
    """A ball on a table gets everywhere by rolling, and `manoeuvre` refuses it."""
    m = Mechanism("ball")
    m.free("at", m.ground, m.body("ball"))
    m.rolls("floor", "ball", radius=0.1)
    system = m.build()
    q = system.q({"at.x": 0.4, "at.z": 0.1})
    answer = system.ik(system.fk(q, "ball"), "ball", system.q({"at.z": 0.1}))
    assert (
        answer
        and "there are such motions" in answer.status
        and "system.manoeuvre" not in answer.status
    )
    with pytest.raises(UnsupportedError):
        system.manoeuvre(system.q({"at.z": 0.1}), q)
