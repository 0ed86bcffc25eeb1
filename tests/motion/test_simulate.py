"""Motion in time: the ball against closed forms, rolling against integrations of its own, and what
is refused.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import wheels
from scipy.integrate import solve_ivp

import kempe
from kempe import Mechanism, constraints
from kempe.budget import TimeUp
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.motion import bounces

G = 9.81


def ball(kind: str = "free", dim: int = 3, limits=None, **place):
    m = Mechanism("ball", dim=dim)
    m.joint("at", kind, m.ground, m.body("ball"), limits=limits, **place)
    return m.build()


# ---- what falls


def test_a_ball_bounces_to_rest_and_rolls_on_evenly():
    system = ball(limits={"z": (0.1, None)})
    start = system.q({"at.z": 1.1})
    r = system.simulate(5.0, start, velocity={"at.x": 0.5, "at.wz": 3.0}, restitution=0.8)
    first = math.sqrt(2 / G)
    speed = math.sqrt(2 * G)
    end = first + 2 * 0.8 * speed / (G * 0.2)
    bounces = [e for e in r.events if e.kind == "bounce"]
    k = np.arange(len(bounces))
    assert (
        np.abs(
            [e.time for e in bounces] - (first + 2 * speed * 0.8 * (1 - 0.8**k) / (G * 0.2))
        ).max()
        < 1e-10
    )
    assert r and r.events[-1].kind == "settles" and abs(r.events[-1].time - end) < 1e-10
    assert r.q[-1, :3] == pytest.approx([2.5, 0.0, 0.1], abs=1e-12)
    assert r.q[-1, 3:] == pytest.approx([math.cos(7.5), 0, 0, math.sin(7.5)]) or r.q[-1, 3] < 0
    assert r.v[-1] == pytest.approx([0.5, 0, 0, 0, 0, 3.0])
    assert "settles on" in str(r) and "it stays on" in r.status
    assert r.q[:, 2].min() >= 0.1 - 1e-12 and np.all(np.diff(r.t) > 0)


def test_samples_are_parabolas_between_bounces():
    system = ball("translation", limits={"z": (0.0, None)})
    r = system.simulate(
        1.2,
        {"at.z": 1.0},
        velocity=[0.3, 0.0, 1.0],
        restitution=0.5,
        budget=kempe.Budget(points=500),
    )
    hit = (1.0 + math.sqrt(1 + 2 * G)) / G
    t = r.t[r.t < hit]
    assert r.q[: len(t), 2] == pytest.approx(1.0 + t - 0.5 * G * t**2, abs=1e-13)
    assert r.events[0].time == pytest.approx(hit, abs=1e-13)
    assert (r.events[0].before, r.events[0].after) == pytest.approx(
        (-(G * hit - 1), 0.5 * (G * hit - 1))
    )
    assert r.at(hit)[2] == pytest.approx(0.0, abs=1e-14) and r.velocity(hit)[2] == pytest.approx(
        0.5 * (G * hit - 1)
    )


@pytest.mark.parametrize("kind", ["translation", "free"])
def test_without_planes_it_falls(kind):
    r = ball(kind).simulate(2.0, velocity={"at.x": 1.0}, acceleration=(0.0, 1.0, -2.0))
    assert r and not r.events and r.q[-1, :3] == pytest.approx([2.0, 2.0, -4.0])


def test_a_bead_on_an_inclined_rod_takes_its_part_of_the_acceleration():
    m = Mechanism("bead", dim=2)
    m.prismatic("s", m.ground, m.particle("bead"), axis=(3.0, 4.0, 0.0), limits=(0.0, 2.0))
    r = m.build().simulate(1.0, {"s": 1.0}, restitution=0.6)
    hit = math.sqrt(2 * 1.0 / (0.8 * G))
    assert r.events[0].time == pytest.approx(hit, abs=1e-14) and r.events[0].contacts[0].startswith(
        "lower limit"
    )
    assert r.events[0].after == pytest.approx(0.6 * 0.8 * G * hit)


def test_slides_that_are_not_at_right_angles_have_the_metric_of_space(hunt):
    """The same ball on skew slides: the same motion of its place."""
    rng = hunt.rng()
    for _ in range(hunt.cases(10)):
        m = Mechanism("skew", dim=2)
        a = m.body("a")
        m.prismatic("u", m.ground, a, axis=(1.0, rng.uniform(-0.5, 0.5), 0.0))
        m.prismatic("w", a, m.particle("p"), axis=(rng.uniform(-0.5, 0.5), 1.0, 0.0))
        with pytest.raises(UnsupportedError, match="several moving bodies"):
            m.build().simulate(1.0)
    rpy = rng.uniform(-1, 1, 3)
    system = ball("translation", rpy=tuple(rpy))
    r = system.simulate(1.0, velocity=[0.1, 0.2, 0.3])
    X = system.fk(r.q, "ball")[:, :3, 3]
    v0 = np.asarray(system.jacobian(r.q[0], "ball"))[:3] @ [0.1, 0.2, 0.3]
    assert np.abs(X - (np.outer(r.t, v0) - np.outer(0.5 * r.t**2, [0, 0, G]))).max() < 1e-12


def test_a_corner_of_two_stops():
    system = ball("planar", dim=2, limits={"x": (None, 2.0), "y": (0.0, None)})
    r = system.simulate(10.0, {"at.y": 1.0}, velocity={"at.x": 1.5, "at.rz": 1.0}, restitution=0.7)
    wall = [e for e in r.events if "upper limit of at.x" in e.contacts]
    assert len(wall) == 1 and wall[0].time == pytest.approx(2 / 1.5, abs=1e-12)
    assert r.q[-1] == pytest.approx([2 - 1.05 * (10 - 2 / 1.5), 0.0, 10.0], abs=1e-9)


def test_a_start_inside_is_refused_with_the_distance():
    system = ball(limits={"z": (0.1, None)})
    with pytest.raises(InputError, match="0.05 m inside 'lower limit of at.z'"):
        system.simulate(1.0, system.q({"at.z": 0.05}))
    touching = system.simulate(1.0, system.q({"at.z": 0.1}), restitution=0.9)
    assert touching and not touching.events and np.all(touching.q[:, 2] == 0.1)


def declared(shape: str = "ball", at=(0.0, 0.0, 0.0), radius: float = 0.1):
    """A ball above a floor and beside a wall, by declared contacts."""
    m = Mechanism("ball")
    body = m.body("ball")
    m.free("at", m.ground, body)
    m.frame("touching", body, at=at)
    m.frame("wall plane", m.ground, at=(2.0, 0.0, 0.0), axis="-x")
    m.contact("floor", "touching", radius=radius, shape=shape)
    m.contact("wall", "touching", on="wall plane", radius=radius)
    return m.build()


def test_declared_contacts_are_bounced_on():
    system = declared()
    r = system.simulate(
        8.0, system.q({"at.z": 1.1}), velocity={"at.x": 1.0, "at.wy": 2.0}, restitution=0.7
    )
    first = math.sqrt(2 / G)
    speed = math.sqrt(2 * G)
    wall = [e for e in r.events if e.contacts == ("wall",)]
    assert (
        len(wall) == 1
        and wall[0].time == pytest.approx(1.9, abs=1e-12)
        and wall[0].after == pytest.approx(0.7)
    )
    floor = [e.time for e in r.events if e.contacts == ("floor",)]
    assert floor[0] == pytest.approx(first, abs=1e-12)
    assert floor[-1] == pytest.approx(first + 2 * 0.7 * speed / (G * 0.3), abs=1e-10)
    assert r.q[-1, :3] == pytest.approx([1.9 - 0.7 * 6.1, 0, 0.1], abs=1e-9)
    with pytest.raises(InputError, match="0.04 m inside 'floor'"):
        system.simulate(1.0, system.q({"at.z": 0.06}))


def test_a_floor_that_slopes(hunt):
    """A contact on a plane in any direction: the gap of the judge, and no tangential change at an
    impact.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(10)):
        m = Mechanism("slope")
        body = m.particle("p")
        m.free("at", m.ground, body)
        m.frame(
            "plane", m.ground, at=tuple(rng.normal(size=3)), rpy=tuple(rng.uniform(-0.6, 0.6, 3))
        )
        m.contact("slope", "p", on="plane")
        system = m.build()
        X = system.fk(system.neutral, "plane")
        start = X[:3, 3] + 0.5 * X[:3, 2] + rng.normal() * X[:3, 0]
        r = system.simulate(
            3.0, start, velocity=rng.normal(size=3), restitution=rng.uniform(0.2, 0.9)
        )
        gap = (r.q - X[:3, 3]) @ X[:3, 2]
        assert r and r.events and gap.min() > -1e-9
        for e in r.events[:20]:
            before = r.velocity(max(e.time - 1e-9, 0.0))
            after = r.velocity(e.time)
            assert abs((e.q - X[:3, 3]) @ X[:3, 2]) < 1e-9
            assert np.abs((after - before) @ X[:3, :2]).max() < 1e-7
            if e.after > 1e-6:
                assert e.after == pytest.approx(after @ X[:3, 2], abs=1e-9)


def test_a_car_that_rolls_stops_at_a_wall():
    m = Mechanism("car", dim=2)
    m.planar("pose", m.ground, m.body("body"))
    m.no_sideslip("edge", "body")
    m.contact("wall", "body")
    system = m.build()
    r = system.simulate(3.0, [0.0, 1.0, 0.0], inputs={"body.vx": 1.0, "pose.rz": -0.8})
    assert (
        not r
        and "'wall' meets its bound" in r.status
        and r.q[-1, 1] == pytest.approx(0.0, abs=1e-9)
    )
    # y = 1 - (1 - cos 0.8 t) / 0.8
    assert r.t[-1] == pytest.approx(math.acos(1 - 0.8) / 0.8, abs=1e-9)
    with pytest.raises(InputError, match="violates 'wall' by 0.5"):
        system.simulate(1.0, [0.0, -0.5, 0.0], inputs={"body.vx": 1.0, "pose.rz": 0.0})
    path = system.manoeuvre([0, 0, 0], [0, 1, 0], radius=1.0)
    assert path and path.q[:, 1].min() > -1e-9
    with pytest.raises(InputError, match="goal has 'wall' = -1"):
        system.manoeuvre([0, 1, 0], [0, -1, 0])


def pendulum():
    m = Mechanism("pendulum", dim=2)
    m.revolute("A", m.ground, m.body("bob", center=(1.0, 0.0, 0.0)))
    return m.build()


def two():
    m = Mechanism("two")
    m.free("A", m.ground, m.body("a"))
    m.free("B", m.ground, m.body("b"))
    return m.build()


def rope():
    m = Mechanism("rope")
    m.free("A", m.ground, m.particle("p"))
    m.constrain(constraints.Distance("p", m.ground.name, at_most=1.0), "rope")
    return m.build()


def rod():
    m = Mechanism("rod", dim=2)
    m.free("A", m.ground, m.body("a"))
    m.distance("rope", m.ground, "a", 1.0)
    return m.build()


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        (pendulum, "'A' swings the centre of 'bob'.*moments of inertia"),
        (two, "several moving bodies.*masses"),
        (rod, "'rope'.*masses"),
        (wheels.coin, "velocity constraints.*masses.*inputs"),
        (lambda: Mechanism("still").build(), "no body that moves"),
        (rope, "'rope' is no plane"),
        (
            lambda: declared(at=(0.1, 0, 0)),
            "'floor' is touched depends on how 'ball' is turned.*moments of inertia",
        ),
        (
            lambda: declared("disc"),
            "'floor' is touched depends on how 'ball' is turned.*moments of inertia",
        ),
    ],
)
def test_what_needs_masses_is_refused_with_the_reason(system, reason):
    s = system()
    with pytest.raises(UnsupportedError, match=reason):
        s.simulate(1.0, s.q({n: 5.0 for n in s.coordinate_names if n.endswith(".z")}))


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"duration": 0.0}, "duration is 0.0"),
        ({"duration": math.inf}, "duration is inf"),
        ({"restitution": 1.5}, "restitution is 1.5"),
        ({"acceleration": (1, 2)}, "acceleration has shape"),
        ({"velocity": [1.0]}, "velocity has shape"),
        ({"velocity": {"at.u": 1}}, "at.u"),
        ({"budget": kempe.Budget(points=0)}, "points is 0"),
        ({"velocity": {"at.x": "fast"}}, "'fast'"),
        ({"start": [0, 0]}, "2 coordinates"),
        ({"inputs": {"at.x": 1}, "velocity": {"at.y": 1}}, "velocity is for what falls"),
        ({"inputs": 3}, "inputs is 3"),
    ],
)
def test_bad_input_is_named(options, error):
    given = {"duration": 1.0, **options}
    with pytest.raises((InputError, UnknownNameError), match=error):
        ball().simulate(given.pop("duration"), given.pop("start", None), **given)


# ---- what rolls


def test_a_car_follows_its_inputs(hunt):
    """Against the equations of the bicycle: x' = v cos h, y' = v sin h, h' = v tan(steer) / length."""
    rng = hunt.rng()
    system = wheels.car(length=1.2)
    for _ in range(hunt.cases(4)):
        a = rng.uniform(0.1, 0.4)
        w = rng.uniform(0.5, 2)
        v = rng.uniform(-2, 2)
        inputs = {"body.vx": v, "steer": lambda t, a=a, w=w: a * math.cos(w * t)}
        r = system.simulate(6.0, np.zeros(4), inputs=inputs, budget=kempe.Budget(points=30))

        def rate(t, x, a=a, w=w, v=v):
            return [
                v * math.cos(x[2]),
                v * math.sin(x[2]),
                v * math.tan(x[3]) / 1.2,
                a * math.cos(w * t),
            ]

        x = solve_ivp(
            rate, (0, 6.0), np.zeros(4), rtol=1e-12, atol=1e-12, method="DOP853", t_eval=r.t
        ).y.T
        assert r and np.abs(r.q - x).max() < 1e-8 and r.slip < 1e-12
        J = np.asarray(system.jacobian(r.q, "fork", "body"))
        assert np.abs(np.einsum("ni,ni->n", J[:, 1], r.v)).max() < 1e-9


@pytest.mark.slow
def test_a_coin_in_a_circle_comes_back():
    """Radius 0.5, speed 1 m/s, turning at 2 rad/s: after pi s the place is the start's, and the
    coin has turned.
    """
    system = wheels.coin()
    r = system.simulate(math.pi, np.zeros(4), inputs={"roll": 2.0, "pose.rz": 2.0})
    assert r.q[-1] == pytest.approx([0, 0, 2 * math.pi, 2 * math.pi], abs=1e-9) and r.slip < 1e-12
    assert np.ptp(np.hypot(r.q[:, 0], r.q[:, 1] - 0.5)) < 1e-9


@pytest.mark.slow
def test_a_ball_rolls_on_a_plane():
    """On a circle, with some spin: x' = r wy, y' = -r wx."""
    m = Mechanism("ball on plane")
    a = m.body("carrier")
    b = m.body("ball")
    m.translation("at", m.ground, a, at=(0.0, 0.0, 0.2))
    m.spherical("turn", a, b)
    m.rolls("floor", "ball", radius=0.2, shape="ball")
    system = m.build()
    with pytest.raises(UnsupportedError, match="leave 3 freedoms"):
        system.simulate(1.0, inputs={"at.z": 0.0})
    place = {"at.x": lambda t: 0.1 * math.cos(t), "at.y": lambda t: -0.1 * math.sin(t), "at.z": 0.0}
    r = system.simulate(2.0, inputs={**place, "ball.wz": 0.3})
    assert r.q[-1, :3] == pytest.approx(
        [0.1 * math.sin(2.0), 0.1 * math.cos(2.0) - 0.1, 0.0], abs=1e-9
    )
    w = np.asarray(system.jacobian(r.q, "ball"))[:, 3:] @ r.v[:, :, None]
    assert (
        np.abs(r.v[:, 0] - 0.2 * w[:, 1, 0]).max() < 1e-9
        and np.abs(r.v[:, 1] + 0.2 * w[:, 0, 0]).max() < 1e-9
    )
    assert np.abs(np.linalg.norm(r.q[:, 3:], axis=1) - 1).max() < 1e-14


@pytest.mark.slow
def test_loops_stay_closed():
    m = Mechanism("four-bar", dim=2)
    crank = m.body("crank")
    coupler = m.body("coupler")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("B", crank, coupler, at=(1, 0))
    m.revolute("C", coupler, rocker, at=(3, 0), child_at=(2.5, 0))
    m.revolute("D", m.ground, rocker, at=(3, 0))
    system = m.build()
    start = system.assemble({"A": 0.5}).q
    r = system.simulate(20.0, start, inputs={"A": 1.0})
    assert r and np.abs(system.loops.closure_error(r.q)).max() < 1e-12
    i = system.coordinate_names.index("A")
    assert r.q[:, i] == pytest.approx(0.5 + r.t, abs=1e-9)
    driven = system.drive({"A": 0.5 + r.t}, r.t, start)
    assert np.abs(r.q - driven.q).max() < 1e-8
    with pytest.raises(InputError, match="off by"):
        system.simulate(1.0, start + 0.1, inputs={"A": 1.0})


def test_it_ends_where_a_limit_is_met():
    r = wheels.car(limits=(-0.6, 0.6)).simulate(
        10.0, np.zeros(4), inputs={"body.vx": 1.0, "steer": 0.1}
    )
    assert (
        not r and "'steer' meets its limit" in r.status and r.t[-1] == pytest.approx(6.0, abs=1e-9)
    )
    assert r.q[-1, 3] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("inputs", "reason"),
    [
        ({"body.vx": 1.0}, "leave 1 freedom of motion, among 'steer'"),
        (
            {"body.vx": 1.0, "steer": 0.0, "body.vy": 1.0},
            "do not allow the input 'body.vy' = 1.*they allow 0",
        ),
    ],
)
def test_inputs_that_are_too_few_or_too_many(inputs, reason):
    with pytest.raises(UnsupportedError, match=reason):
        wheels.car().simulate(1.0, np.zeros(4), inputs=inputs)


@pytest.mark.parametrize(
    ("inputs", "error"),
    [
        ({"body.v": 1.0}, "no velocity 'body.v'"),
        ({"body.vx": "1"}, "'body.vx' is '1'"),
        ({"body.vx": lambda t: "1"}, "at time 0 is '1'"),
        ({"body.vx": lambda t: math.nan}, "must be finite"),
    ],
)
def test_bad_inputs_are_named(inputs, error):
    with pytest.raises((InputError, UnknownNameError), match=error):
        wheels.car().simulate(1.0, np.zeros(4), inputs={"steer": 0.0, **inputs})


def test_time_is_up(looks):
    looks(30)
    r = wheels.car().simulate(
        1.0, np.zeros(4), inputs={"body.vx": 1.0, "steer": 0.0}, budget=kempe.Budget(time_limit=1.0)
    )
    assert r.late and not r and "time limit" in r.status and len(r.q) == len(r.t) == len(r.v)


# ---- planes that move


def above(law: str, dim: int = 2, **more: str) -> kempe.System:
    """A particle above a floor that is a law of time, and beside further walls."""
    m = Mechanism("moving floor", dim=dim)
    m.free("at", m.ground, m.particle("p"))
    m.inequality("floor", f"at.y - ({law})", time=True)
    for name, wall in more.items():
        m.inequality(name, wall, time=True)
    return m.build()


@pytest.mark.slow
def test_a_floor_that_rises_evenly_is_a_floor_at_rest_seen_from_itself(hunt):
    """Times, rates of gaps and the end of all bounces by Galilei's change of the frame of
    reference.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(8)):
        u = rng.uniform(-2, 2)
        h = rng.uniform(0.1, 1)
        v = rng.uniform(-1, 1)
        e = rng.uniform(0.1, 0.6)
        r = above(f"{u!r}*t").simulate(3.0, {"at.y": h}, velocity=[0.7, v], restitution=e)
        still = above("0").simulate(3.0, {"at.y": h}, velocity=[0.7, v - u], restitution=e)
        # on planes that move, lower hops count as the rest of the series
        large = 1e-4 * abs(still.events[0].before)
        count = sum(abs(b.before) > large for b in still.events)
        assert sum(abs(a.before) > large for a in r.events) == count
        for a, b in zip(r.events[:count], still.events, strict=False):
            assert (a.kind, a.contacts) == (b.kind, b.contacts)
            assert (a.time, a.before, a.after) == pytest.approx(
                (b.time, b.before, b.after), abs=1e-7
            )
        assert r.events[-1].kind == "settles" and r.events[-1].time == pytest.approx(
            still.events[-1].time, abs=1e-6
        )
        assert r.q[-1] == pytest.approx([2.1, 3 * u], abs=1e-9) and r.v[-1] == pytest.approx(
            [0.7, u], abs=1e-9
        )
        assert r and r.judged and (r.q[:, 1] - u * r.t).min() > -1e-9


def flown_over(law, rate, h, e, duration):
    """Impacts (time, rate of the gap) of a particle that falls from h onto a floor, by steps of 10
    microseconds.
    """
    y = h
    v = 0.0
    t = 0.0
    out = []
    while True:
        s = t + np.concatenate(
            [np.geomspace(1e-8, 1e-5, 200), np.arange(1e-5, duration - t + 1e-5, 1e-5)]
        )
        gap = y + v * (s - t) - 0.5 * G * (s - t) ** 2 - law(s)
        k = int(np.argmax(gap < 0.0))
        if not k:
            return out
        a = s[k - 1]
        b = s[k]
        for _ in range(60):
            c = 0.5 * (a + b)
            a, b = (a, c) if y + v * (c - t) - 0.5 * G * (c - t) ** 2 - law(c) < 0.0 else (c, b)
        y = law(a)
        v = v - G * (a - t)
        t = a
        if t > duration:
            return out
        out.append((t, v - rate(t)))
        v = rate(t) - e * (v - rate(t))


def test_a_ball_on_a_table_that_vibrates(hunt):
    """Against a search of impacts in small steps; the first ones, before chaos has made rounding
    large.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        A = rng.uniform(0.02, 0.2)
        w = rng.uniform(2, 12)
        p = rng.uniform(-3, 3)
        h = A + rng.uniform(0.05, 0.5)
        e = rng.uniform(0.5, 1.0)
        system = above(f"{A!r}*sin({w!r}*t + {p!r})")
        r = system.simulate(1.5, {"at.y": h}, restitution=e)

        def law(t, A=A, w=w, p=p):
            return A * np.sin(w * t + p)

        def rate(t, A=A, w=w, p=p):
            return A * w * np.cos(w * t + p)

        wanted = [x for x in flown_over(law, rate, h, e, 1.5) if abs(x[1]) > 1e-2][:8]
        found = [(x.time, x.before) for x in r.events if x.kind == "bounce"][: len(wanted)]
        assert np.abs(np.array(found) - wanted).max(initial=0.0) < 1e-7
        assert all(
            x.after == pytest.approx(-e * x.before, abs=1e-9)
            for x in r.events
            if x.kind == "bounce"
        )
        assert r.judged and (r.q[:, 1] - law(r.t)).min() > -1e-9


@pytest.mark.slow
def test_a_body_stays_on_a_table_until_that_falls_faster():
    """Without rebound: it leaves where the table's acceleration is -g, and lands after a parabola."""
    r = above("sin(10*t)/10").simulate(0.82, {"at.y": 0.0}, velocity=[0.0, 1.0], restitution=0.0)
    leaves = math.asin(G / 10) / 10
    place = math.sin(10 * leaves) / 10
    speed = math.cos(10 * leaves)
    assert [e.kind for e in r.events] == ["leaves", "lands", "leaves"]
    assert r.events[0].time == pytest.approx(leaves, abs=1e-8)
    s = r.events[1].time - leaves
    lands = place + speed * s - 0.5 * G * s**2
    assert lands == pytest.approx(math.sin(10 * r.events[1].time) / 10, abs=1e-9)
    assert r.events[2].time == pytest.approx(leaves + 2 * math.pi / 10, abs=1e-8)
    on = (r.t < leaves) | ((r.t > r.events[1].time) & (r.t < r.events[2].time))
    assert np.abs(r.q[on, 1] - np.sin(10 * r.t[on]) / 10).max() < 1e-10
    assert np.abs(r.v[on, 1] - np.cos(10 * r.t[on])).max() < 1e-8
    assert "it stays on" not in r.status and "leaves 'floor'" in str(r)


@pytest.mark.slow
def test_a_particle_on_a_plane_that_turns():
    """A smooth tray that turns about z: its motion along the tray, u'' = w^2 u - g sin(w t), in
    closed form.
    """
    m = Mechanism("tray", dim=2)
    m.free("at", m.ground, m.particle("p"))
    m.inequality("tray", "cos(t/2)*at.y - sin(t/2)*at.x", time=True)
    r = m.build().simulate(1.0, {"at.x": 0.2}, velocity=[0.0, 0.1], restitution=0.0)
    w = 0.5
    u = (
        (G / (2 * w * w)) * np.sin(w * r.t)
        + 0.2 * np.cosh(w * r.t)
        - (G / (2 * w * w)) * np.sinh(w * r.t)
    )
    along = np.cos(w * r.t) * r.q[:, 0] + np.sin(w * r.t) * r.q[:, 1]
    assert np.abs(along - u).max() < 1e-9 and r and r.judged


def test_walls_that_leave_no_room_end_the_motion():
    system = above("t", lid="1.5 - t - at.y")
    r = system.simulate(2.0, {"at.y": 0.4}, restitution=0.5)
    assert (
        not r
        and r.t[-1] == pytest.approx(0.75, abs=1e-3)
        and ("no room" in r.status or "at once" in r.status)
    )


def test_planes_that_move_are_refused_where_they_bend():
    m = Mechanism("bowl", dim=2)
    m.free("at", m.ground, m.particle("p"))
    m.inequality("bowl", "at.y - at.x^2*sin(t)", time=True)
    with pytest.raises(UnsupportedError, match="'bowl' is no plane"):
        m.build().simulate(1.0, {"at.y": 1.0})
    m = Mechanism("held", dim=2)
    m.free("at", m.ground, m.particle("p"))
    m.equation("rail", "t*at.y = 0", time=True)
    with pytest.raises(UnsupportedError, match="'rail'.*would push"):
        m.build().simulate(1.0)


def test_bounces_end_by_the_time_limit_with_those_that_were_computed(monkeypatch):
    """Between planes that do not move nobody asked the clock: 100 000 s of bounces without loss
    took minutes.
    """
    calls = itertools.count(1)

    def asked():
        if next(calls) == 51:
            raise TimeUp

    monkeypatch.setattr(bounces, "check_for_stop", asked)
    ball = kempe.load("ball")
    part = ball.simulate(
        1e5, start={"flight.z": 1.1}, restitution=1.0, budget=kempe.Budget(time_limit=1000.0)
    )
    # a fall of 1 m, and between two bounces twice its time
    first = np.sqrt(2.0 / 9.81)
    each = np.sqrt(8.0 / 9.81)
    assert not part and part.late and len(part.events) == 50
    assert part.t[-1] == pytest.approx(first + 49 * each) and abs(part.q[-1, 2] - 0.1) < 1e-6
