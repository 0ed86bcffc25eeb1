"""The ball that falls and bounces: times against closed forms, corners and grooves by what no
motion may do.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from kempe.motion.bounces import Flight, Plane, find_first_zero, project_onto_cone

G = 9.81


def floor(height: float = 0.0) -> Plane:
    return Plane("floor", np.array([1.0]), -height)


def flown(planes, gravity, e, y, v, duration) -> Flight:
    flight = Flight(planes, np.asarray(gravity, dtype=float), e)
    flight.compute_flight(np.asarray(y, dtype=float), np.asarray(v, dtype=float), duration)
    return flight


@pytest.mark.slow
def test_times_and_speeds_of_bounces_are_a_geometric_series(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(100)):
        e = rng.uniform(0.05, 0.97)
        h = rng.uniform(0.01, 5)
        v = rng.uniform(-3, 3)
        g = rng.uniform(0.5, 20)
        impact = math.sqrt(v * v + 2 * g * h)
        first = (v + impact) / g
        end = first + 2 * e * impact / (g * (1 - e))
        flight = flown([floor()], [-g], e, [h], [v], 1.1 * end)
        *bounces, last = flight.impacts
        k = np.arange(len(bounces))
        times = first + 2 * impact * e * (1 - e**k) / (g * (1 - e))
        assert np.abs([b.time for b in bounces] - times).max() < 1e-10
        assert np.allclose([-b.before for b in bounces], impact * e**k, rtol=1e-9)
        assert np.allclose([b.after for b in bounces], impact * e ** (k + 1), rtol=1e-9)
        assert last.kind == "settles" and abs(last.time - end) < 1e-10
        assert flight.evaluate_flight(np.array([end, 1.05 * end]))[0] == pytest.approx(
            0.0, abs=1e-15
        )


@pytest.mark.parametrize("e", [0.0, 1.0])
def test_without_rebound_and_without_loss(e):
    flight = flown([floor()], [-G], e, [1.0], [0.0], 10.0)
    first = math.sqrt(2 / G)
    assert flight.impacts[0].time == pytest.approx(first, abs=1e-14)
    if e:
        assert [i.time for i in flight.impacts] == pytest.approx(
            first * np.arange(1, 2 * 11, 2), abs=1e-12
        )
    else:
        assert [i.kind for i in flight.impacts] == ["lands"] and not flight.evaluate_flight(
            np.array([5.0])
        )[1].any()


def test_at_rest_in_contact_nothing_happens():
    flight = flown([floor(0.25)], [-G], 0.5, [0.25], [0.0], 3.0)
    assert not flight.impacts and flight.evaluate_flight(np.array([0.0, 3.0]))[0].tolist() == [
        [0.25],
        [0.25],
    ]


def test_what_is_pulled_off_leaves():
    flight = flown([floor()], [2.0], 0.5, [0.0], [0.0], 3.0)
    assert not flight.impacts and flight.evaluate_flight(np.array([3.0]))[0] == pytest.approx(9.0)


def test_sliding_down_an_incline_is_uniformly_accelerated():
    slope = math.radians(30)
    n = np.array([-math.sin(slope), math.cos(slope)])
    flight = flown([Plane("slope", n, 0.0)], [0, -G], 0.4, [0, 0], [0, 0], 2.0)
    y, v = flight.evaluate_flight(np.array([2.0]))
    down = -np.array([math.cos(slope), math.sin(slope)])
    assert not flight.impacts
    assert y[0] == pytest.approx(0.5 * G * math.sin(slope) * 4.0 * down, abs=1e-12)
    assert v[0] == pytest.approx(G * math.sin(slope) * 2.0 * down, abs=1e-12)


def groove(rng) -> list[Plane]:
    """Two to four planes through points near the origin that hold up what falls, in two or three
    dimensions.
    """
    k = int(rng.integers(2, 4))
    planes = []
    for i in range(int(rng.integers(k, 5))):
        n = np.append(rng.normal(size=k - 1), rng.uniform(0.2, 1.5))
        planes.append(
            Plane(f"p{i}", n / np.linalg.norm(n) * rng.uniform(0.5, 2), rng.uniform(0.0, 0.2))
        )
    return planes


def test_between_planes_nothing_penetrates_or_gains_energy(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        planes = groove(rng)
        k = len(planes[0].normal)
        e = rng.choice([0.0, 0.4, 0.8, 1.0, rng.random()])
        up = np.zeros(k)
        up[-1] = 1.0
        flight = flown(planes, -G * up, e, 2.0 * up, rng.normal(size=k), 2.0)
        t = np.union1d(np.linspace(0, 2.0, 100), [i.time for i in flight.impacts[:2000]])
        if flight.broken:
            t = t[t <= flight.impacts[-1].time]
        y, v = flight.evaluate_flight(t)
        assert min(flight.compute_gaps(x).min() for x in y) > -1e-9
        energy = 0.5 * (v**2).sum(axis=1) + G * y[:, -1]
        assert np.diff(energy).max() < 1e-9
        if e == 1.0:
            assert np.ptp(energy) < 1e-9
        starts = np.array([a.time for a in flight.arcs])
        before = np.array(
            [
                a.y + (b - a.time) * (a.v + 0.5 * (b - a.time) * a.a)
                for a, b in zip(flight.arcs, starts[1:], strict=False)
            ]
        )
        assert np.abs(before - np.array([a.y for a in flight.arcs[1:]])).max(initial=0.0) < 1e-8


def test_a_groove_brings_to_rest():
    """Bounces between two walls end, though their times are no geometric series."""
    a = math.radians(60)
    walls = [
        Plane(n, np.array([s * math.sin(a), math.cos(a)]), 0.0)
        for n, s in (("left", 1), ("right", -1))
    ]
    flight = flown(walls, [0, -G], 0.8, [0.1, 1.0], [0, 0], 10.0)
    y, v = flight.evaluate_flight(np.array([10.0]))
    assert not flight.broken and flight.impacts[-1].time < 4.0
    assert np.abs(y).max() < 1e-12 and not v.any()


@pytest.mark.parametrize("share", [0.5, 1 - 1e-7, 1 - 1e-12, 1 + 1e-12, 1.5])
def test_wall_hit_while_bounces_on_the_floor_fade(share):
    """The wall is reached shortly before the bounces on the floor end: the order in time is kept."""
    e = 0.5
    g = 10.0
    end = 3 * math.sqrt(2 / g)  # t1 (1 + 2 e / (1 - e)) for a fall from 1 m
    planes = [
        Plane("floor", np.array([0.0, 1.0]), 0.0),
        Plane("wall", np.array([-1.0, 0.0]), end * share),
    ]
    flight = flown(planes, [0, -g], e, [0, 1.0], [1.0, 0], 3 * end)
    walls = [i for i in flight.impacts if 1 in i.planes]
    assert len(walls) == 1 and walls[0].time == pytest.approx(end * share, abs=1e-10)
    assert [i.time for i in flight.impacts] == sorted(i.time for i in flight.impacts)
    settled = [i for i in flight.impacts if i.kind != "bounce"]
    assert len(settled) == 1 and settled[0].time == pytest.approx(end, abs=1e-10)
    y, v = flight.evaluate_flight(np.array([3 * end]))
    assert v[0] == pytest.approx([-0.5, 0.0]) and y[0, 1] == 0.0


def test_roots_of_gaps(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(1000)):
        g = 10.0 ** rng.uniform(-12, 3)
        r = rng.normal() * 10.0 ** rng.uniform(-6, 3)
        a = rng.normal()
        t = find_first_zero(g, r, a)
        roots = np.roots([0.5 * a, r, g])
        real = sorted(x.real for x in roots if abs(x.imag) < 1e-12 * abs(x) and x.real > 0)
        if math.isinf(t):
            assert not real or abs(r * r - 2 * a * g) < 1e-9 * r * r
        else:
            assert abs(g + t * (r + 0.5 * a * t)) < 1e-12 * (g + abs(r * t) + abs(a) * t * t)
            assert t <= real[0] * (1 + 1e-6)


def test_nearest_in_cone_against_least_squares(hunt):
    from scipy.optimize import nnls

    rng = hunt.rng()
    for _ in range(hunt.cases(300)):
        k = int(rng.integers(1, 4))
        N = rng.normal(size=(int(rng.integers(1, 6)), k))
        v = rng.normal(size=k)
        x = v + N.T @ nnls(N.T, -v)[0]
        assert project_onto_cone(v, N) == pytest.approx(x, abs=1e-9)
