"""Manoeuvres: integrated again from their speeds alone, against the velocity rows, and what is
refused.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import wheels
from linkages import planar_arm
from scipy.integrate import solve_ivp

import kempe
from kempe import Mechanism
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.motion.reeds_shepp import compute_length, list_ways


def check(system, path, start, goal, frame: str) -> None:
    """What every manoeuvre is held against, with the axle at the origin of `frame`, its wheels
    along x.

    Start, goal and limits; the velocity of the axle by the frame's Jacobian; the derivative of `at`
    by differences; and the unicycle x' = v cos h, y' = v sin h, h' = w, integrated by scipy from
    the speeds of the pieces.
    """
    assert path.success, path.status
    scale = 1.0 + np.abs(path.q).max() + path.length
    off = system.configuration_space.difference(path.q[-1], goal)
    assert np.array_equal(path.q[0], start)
    assert np.abs(off - 2 * math.pi * np.round(off / (2 * math.pi))).max() < 1e-12 * scale
    assert np.all(np.diff(path.t) > 0.0)
    v = path.velocity(path.t)
    J = np.asarray(system.jacobian(path.q, frame, "body"))
    twist = np.einsum("nij,nj->ni", J, v)
    assert np.abs(twist[:, 1]).max() < 1e-9 * scale
    if len(path) < 2:
        return
    mid = 0.5 * (path.t[1:] + path.t[:-1])
    h = np.minimum(1e-5, 0.25 * np.diff(path.t))
    slope = (
        system.configuration_space.difference(path.at(mid - h), path.at(mid + h)) / (2 * h)[:, None]
    )
    v = path.velocity(mid)
    rounding = 1e-15 * scale / h[:, None]
    assert (np.abs(slope - v) < 1e-7 * np.maximum(1.0, np.abs(v).max()) ** 3 + 10 * rounding).all()
    X0 = system.fk(path.q[0], frame)
    x = np.zeros(3)  # in the axes of the frame at the start
    for p in path.pieces:
        inputs = p.forward, p.turning

        def rate(t, x, inputs=inputs):
            return [inputs[0] * math.cos(x[2]), inputs[0] * math.sin(x[2]), inputs[1]]

        x = solve_ivp(rate, (0.0, p.duration), x, rtol=1e-12, atol=1e-12, method="DOP853").y[:, -1]
        X = np.linalg.inv(X0) @ system.fk(path.at(min(p.start + p.duration, path.duration)), frame)
        assert np.abs(X[:2, 3] - x[:2]).max() < 1e-9 * scale
        assert np.abs(X[:2, 0] - [math.cos(x[2]), math.sin(x[2])]).max() < 1e-9 * scale


def axles(system, q, frame="axle") -> np.ndarray:
    X = system.fk(q, frame)
    return X[:2, 3]


@pytest.mark.slow
def test_any_configuration_is_reached(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        system = wheels.knife(rng.normal(size=2), rng.uniform(-3, 3))
        start, goal = rng.uniform(-4, 4, (2, 3)) * rng.choice([1e-3, 1.0, 100.0])
        for radius in (None, rng.choice([0.05, 1.0, 7.0])):
            path = system.manoeuvre(start, goal, radius=radius, budget=kempe.Budget(points=60))
            check(system, path, start, goal, "axle")
            far = np.linalg.norm(axles(system, goal) - axles(system, start))
            if radius is None:
                assert path.length == pytest.approx(far, rel=1e-12)
                assert np.array_equal(path.q[-1], goal)
            else:
                assert path.length >= far * (1 - 1e-12)


@pytest.mark.slow
def test_any_configuration_is_reached_slow(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(500)):
        system = wheels.knife(rng.normal(size=2), rng.uniform(-3, 3))
        start, goal = rng.uniform(-4, 4, (2, 3)) * rng.choice([1e-3, 1.0, 100.0])
        radius = rng.choice([0.0, 0.05, 1.0, 7.0])
        check(
            system,
            system.manoeuvre(start, goal, radius=radius, budget=kempe.Budget(points=40)),
            start,
            goal,
            "axle",
        )


@pytest.mark.parametrize("radius", [0.5, 1.0, 3.0])
def test_lengths_are_those_of_reeds_and_shepp(hunt, radius):
    rng = hunt.rng()
    system = wheels.knife()
    for _ in range(hunt.cases(20)):
        goal = rng.uniform(-3, 3, 3)
        best = list_ways(goal[0] / radius, goal[1] / radius, goal[2])[0]
        assert system.manoeuvre(np.zeros(3), goal, radius=radius).length == pytest.approx(
            radius * compute_length(best)
        )


@pytest.mark.slow
def test_planes_and_joints_of_any_kind(hunt):
    """The structure counts: slides and a turn in any order, plane, place of the axle."""
    rng = hunt.rng()
    done = 0
    for _ in range(hunt.cases(30)):
        system = wheels.tilted(rng)
        start, goal = rng.uniform(-3, 3, (2, 3))
        for radius in (None, 0.7):
            path = system.manoeuvre(start, goal, radius=radius, budget=kempe.Budget(points=50))
            if not path:  # a turn between the slides turns one of them to the other
                assert "would be parallel" in path.status
                continue
            check(system, path, start, goal, "axle")
            done += 1
    assert done > hunt.cases(30)


def test_sideways_by_alternation():
    """Parking: 1 m to the side, at a turning radius of 4 m, forwards and in reverse by turns."""
    system = wheels.knife()
    path = system.manoeuvre([0, 0, 0], [0, 1, 0], radius=4.0)
    check(system, path, np.zeros(3), np.array([0.0, 1.0, 0.0]), "axle")
    assert path.cusps == 2 and {p.kind for p in path.pieces} == {"forwards", "in reverse"}
    assert "2 cusps" in str(path)
    assert path.length == pytest.approx(4 * compute_length(list_ways(0, 0.25, 0)[0]))


@pytest.mark.parametrize("radius", [None, 0.5])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.8, -0.4), (1e-9, 0.0)])
def test_a_coin_rolls_along(place, radius):
    """The point on the floor rests, and the coin rolls by the signed length of its way."""
    system = wheels.coin()
    start = np.array([0.1, 0.2, 0.3, 0.4])
    goal = np.array([0.1 + place[0], 0.2 + place[1], 2.0, 0.0])
    path = system.manoeuvre(start, goal, radius=radius)
    goal[3] = start[3] + sum(p.length for p in path.pieces) / 0.5
    check(system, path, start, goal, "yoke")
    v = path.velocity(path.t)
    J = np.asarray(system.jacobian(path.q, "coin"))
    at_floor = np.einsum(
        "nij,nj->ni", J[:, :3] + np.cross(J[:, 3:], np.array([0, 0, -0.5])[:, None], axis=-2), v
    )
    assert np.abs(at_floor).max() < 1e-9


def test_wheels_end_where_they_roll_to_and_the_status_says_so():
    coin = wheels.coin()
    named = coin.manoeuvre(np.zeros(4), [1.0, 0, 0, 9.0])
    np.testing.assert_allclose(named.q[-1], [1.0, 0.0, 0.0, 2.0], rtol=0, atol=1e-14)
    assert "'roll' rolls along, and ends at 2" in named.status
    assert "roll" not in coin.manoeuvre({}, {"pose.x": 1.0}).status
    cart = wheels.differential()
    goal = np.array([1.0, 1.0, 2.0, 15.0, 15.0])
    path = cart.manoeuvre(np.zeros(5), goal)
    along = np.sqrt(2.0) / 0.1
    turned = 0.3 * 2.0 / 0.1  # of each wheel, in opposite ways, where the cart turns by 2 rad
    goal[3:] = along - turned, along + turned
    check(cart, path, np.zeros(5), goal, "body")
    assert cart.manoeuvre(np.zeros(5), {"pose.x": 1.0, "pose.y": 2.0}, radius=1.0)


def front_slip(system, path) -> float:
    v = path.velocity(path.t)
    return float(
        np.abs(
            np.einsum("ni,ni->n", np.asarray(system.jacobian(path.q, "fork", "body"))[:, 1], v)
        ).max()
    )


def test_a_car_steers(hunt):
    rng = hunt.rng()
    system = wheels.car()
    for _ in range(hunt.cases(5)):
        start, goal = rng.uniform(-1.4, 1.4, (2, 4))
        for radius in (None, 2.0):
            path = system.manoeuvre(start, goal, radius=radius)
            check(system, path, start, goal, "body")
            assert front_slip(system, path) < 1e-9


def test_a_car_with_limits_takes_its_smallest_circle():
    system = wheels.car(limits=(-0.6, 0.5))
    start = np.zeros(4)
    goal = np.array([0.0, 1.0, 0.0, 0.2])
    path = system.manoeuvre(start, goal)
    check(system, path, start, goal, "body")
    least = 1.2 / math.tan(0.5)
    assert path.length == pytest.approx(least * compute_length(list_ways(0.0, 1.0 / least, 0.0)[0]))
    assert path.q[:, 3].max() <= 0.5 + 1e-12 and front_slip(system, path) < 1e-9
    tight = system.manoeuvre(start, goal, radius=1.0)
    assert not tight and f"smallest radius is {least:.6g} m" in tight.status
    assert "does not turn on the spot" in system.manoeuvre(start, goal, radius=0.0).status
    with pytest.raises(InputError, match="between -0.6 and 0.5"):
        system.manoeuvre(start, [0, 1, 0, 0.55])


def test_limits_of_the_place_choose_the_way():
    """The tip of the triangle, or the shortest way, is on the side where there is room."""
    free = wheels.knife()
    narrow = wheels.knife(limits={"x": (-0.1, 5.0)})
    goal = np.array([0.0, 1.0, 0.0])
    assert free.manoeuvre(np.zeros(3), goal, radius=2.0).q[:, 0].min() < -0.1
    path = narrow.manoeuvre(np.zeros(3), goal, radius=2.0)
    assert path and path.q[:, 0].min() > -0.1 - 1e-9
    shut = wheels.knife(limits={"x": (-0.1, 0.1)}).manoeuvre(np.zeros(3), goal, radius=2.0)
    assert not shut and "'pose.x' would get to" in shut.status
    turn = wheels.knife(limits={"rz": (-0.5, 0.5)})
    assert not turn.manoeuvre(np.zeros(3), goal) and turn.manoeuvre(
        np.zeros(3), 0.1 * goal, radius=1.0
    )


@pytest.mark.parametrize("radius", [None, 1.0])
def test_velocity_limits_are_kept(radius):
    slow = wheels.knife().with_limits(velocity={"pose.x": 0.2, "pose.rz": 0.1})
    path = slow.manoeuvre(np.zeros(3), [1.0, 1.0, 2.0], radius=radius)
    v = np.abs(path.velocity(np.linspace(0, path.duration, 5000))).max(axis=0)
    assert v[0] <= 0.2 * (1 + 1e-9) and v[2] <= 0.1 * (1 + 1e-9) and v.max() > 0.0999


def test_an_arm_on_the_cart_moves_along():
    m = Mechanism("cart with arm", dim=2)
    body = m.body("body")
    arm = m.body("arm")
    m.planar("pose", m.ground, body)
    m.revolute("elbow", body, arm, at=(0.2, 0), limits=(-3, 3), velocity=0.5)
    m.no_sideslip("edge", "body")
    system = m.build()
    start = np.zeros(4)
    goal = np.array([1.0, 1.0, 0.0, 2.5])
    path = system.manoeuvre(start, goal)
    check(system, path, start, goal, "body")
    assert np.abs(path.velocity(path.t)[:, 3]).max() <= 0.5 + 1e-12
    still = system.manoeuvre(start, [0.0, 0.0, 0.0, 1.0])
    assert (
        still.length == 0.0
        and still.q[-1].tolist() == [0.0, 0.0, 0.0, 1.0]
        and still.duration == pytest.approx(2)
    )


def test_nothing_to_do():
    path = wheels.knife().manoeuvre(np.ones(3), np.ones(3))
    assert path and len(path.q) == 1 and path.length == 0.0 and "the same" in path.status
    assert path.at(0.0).tolist() == [1, 1, 1] and not path.velocity(0.0).any()


@pytest.mark.parametrize("radius", [None, 1.0])
def test_far_from_the_origin(radius):
    system = wheels.knife((0.5, 0.1), 0.2)
    start = np.array([1e6, -2e6, 40.0])
    goal = start + [0.3, 0.4, -2.0]
    check(system, system.manoeuvre(start, goal, radius=radius), start, goal, "axle")


def test_radii_and_distances_of_all_sizes(hunt):
    """From micrometres to a hundred kilometres, goals that are near in angle or place among them."""
    rng = hunt.rng()
    system = wheels.knife()
    for _ in range(hunt.cases(100)):
        turn = rng.choice([0.0, 1e-9, 1e-5, 0.1, 3.0, math.pi, -math.pi / 2])
        goal = np.append(
            rng.uniform(-1, 1, 2) * 10.0 ** rng.uniform(-5, 4) * (rng.random() < 0.8), turn
        )
        path = system.manoeuvre(
            np.zeros(3), goal, radius=10.0 ** rng.uniform(-5, 5), budget=kempe.Budget(points=30)
        )
        off = system.configuration_space.difference(path.q[-1], goal)
        off[2] = math.remainder(off[2], 2 * math.pi)
        assert (
            path
            and np.abs(off).max() < 1e-12 * (1 + np.abs(path.q).max() + path.length)
            and path.slip < 1e-12
        )


def bare() -> Mechanism:
    m = Mechanism("bare", dim=2)
    m.planar("pose", m.ground, m.body("body"))
    return m


def holonomic():
    m = bare()
    m.no_sideslip("edge", "body")
    m.frame("across", "body", angle=1.0)
    m.no_sideslip("other", "across")
    return m.build()


def serial():
    m = Mechanism("arm", dim=2)
    a = m.body("a")
    b = m.body("b")
    c = m.body("c")
    m.revolute("1", m.ground, a)
    m.revolute("2", a, b, at=(1, 0))
    m.revolute("3", b, c, at=(1, 0))
    m.no_sideslip("edge", "c")
    return m.build()


def looped():
    m = bare()
    m.frame("edge", "body")
    m.no_sideslip("no slip", "edge")
    m.distance("rod", m.ground, "body", 1.0)
    return m.build()


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        (lambda: bare().build(), "no velocity constraints"),
        (wheels.trailer, "'hitch' depends on 'hitch' itself"),
        (serial, "two slides and a turn"),
        (looped, "'rod' ties coordinates"),
        (holonomic, "1 freedom"),
    ],
)
def test_what_is_not_known_is_refused_with_the_reason(system, reason):
    s = system()
    with pytest.raises(UnsupportedError, match=reason):
        s.manoeuvre(np.zeros(s.nq), np.ones(s.nq))


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"radius": -1.0}, "radius is -1.0"),
        ({"radius": math.nan}, "radius is nan"),
        ({"radius": "2"}, "radius is '2'"),
        ({"budget": kempe.Budget(points=1)}, "points is 1"),
        ({"budget": kempe.Budget(points=2.5)}, "points is 2.5"),
        ({"goal": [1, 2]}, "2 coordinates"),
        ({"goal": [1, 2, math.nan]}, "be finite"),
        ({"start": [[0, 0, 0]]}, "shape"),
        ({"goal": {"pose.q": 1}}, "pose.q"),
    ],
)
def test_bad_input_is_named(options, error):
    given = {"start": np.zeros(3), "goal": np.ones(3), **options}
    with pytest.raises((InputError, UnknownNameError), match=error):
        wheels.knife().manoeuvre(given.pop("start"), given.pop("goal"), **given)


def test_it_is_saved_and_drawn_like_other_paths(tmp_path):
    path = wheels.knife().manoeuvre(np.zeros(3), [0, 1, 0], radius=1.0)
    data = np.loadtxt(path.save(tmp_path / "p.csv"), delimiter=",", skiprows=1)
    assert np.array_equal(data[:, 0], path.t) and np.array_equal(data[:, 1:], path.q)
    assert path.curve("body")[-1] == pytest.approx([0, 1, 0]) and path.values("pose.y")[-1] == 1.0
    assert "Reeds" not in str(path) and path._repr_html_().startswith("<p>")
    with pytest.raises(InputError, match="outside the manoeuvre"):
        path.at(path.duration + 1.0)
    ax = path.system.plot(path=path, ghosts=3)
    assert ax.figure is not None


def test_what_does_not_roll_is_told_what_holds_on_the_way():
    free = planar_arm(0.4, 0.4, 0.4, 0.3)
    with pytest.raises(UnsupportedError, match="nothing keeps it from going straight there"):
        free.manoeuvre(free.neutral, free.neutral)
    with pytest.raises(
        UnsupportedError, match="limits or one-sided constraints hold on the way.*path"
    ):
        free.with_limits({"q2": (-1.0, 1.0)}).manoeuvre(free.neutral, free.neutral)
    m = free.mechanism
    m.constrain(kempe.constraints.OnLine("tip", [0, 0.5], [1, 0]), "rail")
    railed = m.build()
    q = railed.assemble({}, start=np.ones(4)).q
    with pytest.raises(
        UnsupportedError, match="'rail' holds positions on the way.*configuration_space.path"
    ):
        railed.manoeuvre(q, q)


@pytest.mark.parametrize("angle", [1e6, 1e15, -1e16])
def test_very_many_turns_are_one_turn_of_that_angle(angle):
    """Of the half turns between both ends only those near them are tried: all others cost the same."""
    car = kempe.load("car")
    for start, goal in (([0.0, 0.0, angle], [0.0, 1.0, 0.0]), ([0.0, 0.0, 0.0], [0.0, 1.0, angle])):
        way = car.manoeuvre(start, goal)
        assert way and len(way.pieces) <= 3 and np.array_equal(way.q[-1], goal)
        assert sum(abs(p.angle) for p in way.pieces) <= abs(angle) * (1.0 + 1e-12) + 2.0 * np.pi


def test_what_stays_where_it_is_says_where_wheels_and_heading_end():
    coin = wheels.coin().manoeuvre(np.zeros(4), [0, 0, 0, 3.0])
    assert coin and coin.status == "the axle stays where it is; 'roll' rolls along, and ends at 0"
    turned = wheels.knife().manoeuvre(np.zeros(3), [0, 0, 2 * np.pi], radius=1.0)
    assert "1 whole turn" in turned.status
    assert wheels.knife().manoeuvre(np.zeros(3), [0, 0, 0]).status == "start and goal are the same"


def test_a_radius_without_a_way_is_no_success():
    none = wheels.knife().manoeuvre([0, 0, 0], [1, 1, 1], radius=5e-324)
    assert not none and none.status == "no way was found to rounding"
