"""Samples of configurations against the densities that the measures have in closed form, by
chi-square.
"""

from __future__ import annotations

import numpy as np
import pytest
from linkages import four_bar
from scipy.stats import chi2

import kempe
from kempe import Budget, Mechanism, Status
from kempe.errors import InputError


def fits(values: np.ndarray, edges: np.ndarray, expected: np.ndarray) -> bool:
    """Whether counts in bins agree with the shares expected of them, at one in ten thousand."""
    count = np.histogram(values, edges)[0]
    expected = expected / expected.sum() * len(values)
    assert count.sum() == len(values) and expected.min() > 5.0
    return bool(np.sum((count - expected) ** 2 / expected) < chi2.isf(1e-4, len(count) - 1))


def surface(text: str) -> kempe.System:
    m = Mechanism("surface")
    m.translation("T", m.ground, m.body("b"))
    m.equation("surface", text)
    return m.build()


def test_the_torus_of_two_turns_is_filled_evenly():
    q = kempe.load("two_link").configuration_space.sample(4000, 1).q
    cells = np.floor((q / (2.0 * np.pi) + 0.5) * 8).astype(int) % 8
    assert fits(cells @ [8, 1], np.arange(65) - 0.5, np.ones(64))


def test_limits_bound_the_product():
    arm = kempe.load("puma560")
    q = arm.configuration_space.sample(3000, 2).q
    for k, (low, high) in enumerate(arm.structure.limits):
        assert fits(q[:, k], np.linspace(low, high, 13), np.ones(12))


def test_rotations_have_haars_measure():
    """The angle of a uniform rotation has the density (1 - cos) / pi, its axis is uniform on the
    sphere.
    """
    q = kempe.load("joint_spherical").configuration_space.sample(5000, 3).q
    q = q[:, :4] * np.sign(q[:, :1])
    angle = 2.0 * np.arccos(np.clip(q[:, 0], -1.0, 1.0))
    edges = np.linspace(0.0, np.pi, 11)
    assert fits(angle, edges, np.diff(edges - np.sin(edges)))
    height = q[:, 3] / np.linalg.norm(q[:, 1:], axis=1)
    assert fits(height, np.linspace(-1.0, 1.0, 11), np.ones(10))


def test_one_sided_constraints_reject():
    m = Mechanism("box")
    m.translation("T", m.ground, m.body("b"), limits={n: (-1.0, 1.0) for n in "xyz"})
    m.inequality("above", "T.z - T.x")
    sample = m.build().configuration_space.sample(2000, 4)
    x = sample.q[:, 0]
    z = sample.q[:, 2]
    assert (z >= x).all() and sample.exact and sample.taken == pytest.approx(0.5, abs=0.05)
    edges = np.linspace(-1.0, 1.0, 9)  # the density of x is (1 - x) / 2
    assert fits(x, edges, -np.diff((1.0 - edges) ** 2))


def test_a_four_bars_curve_is_filled_by_arc_length():
    """Expected shares from a fine polygon through closed forms: two circles for the rocker's pin."""
    a = 0.1
    b = 0.5
    c = 0.4
    d = 0.4
    system = four_bar(a, b, c, d)
    sample = system.configuration_space.sample(6000, 5)
    assert sample.exact and sample.judged.holds.all()
    t = np.linspace(-np.pi, np.pi, 200_001)
    B = a * np.stack([np.cos(t), np.sin(t)], axis=1)
    way = np.array([d, 0.0]) - B
    far = np.linalg.norm(way, axis=1)
    along = np.arctan2(way[:, 1], way[:, 0])
    inner = np.arccos((b * b + far**2 - c * c) / (2.0 * b * far))
    edges = np.linspace(-np.pi, np.pi, 13)
    for sign in (1.0, -1.0):
        rod = along + sign * inner
        C = B + b * np.stack([np.cos(rod), np.sin(rod)], axis=1)
        rocker = np.arctan2(C[:, 1], C[:, 0] - d)
        turns = np.unwrap(np.stack([t, rod - t, rocker - rod, rocker], axis=1), axis=0)
        steps = np.linalg.norm(np.diff(turns, axis=0), axis=1)
        shares = np.add.reduceat(steps, np.searchsorted(t, edges)[:-1].clip(0, len(steps) - 1))
        own = sample.q[np.sign(np.sin(sample.q[:, 2])) == (np.sign(np.sin(turns[0, 2])))]
        assert 2800 < len(own) < 3200  # the two curves are mirror images
        assert fits(own[:, system.coordinate_names.index("A")], edges, shares)


@pytest.mark.slow
def test_a_walk_on_a_sphere_is_uniform():
    """Equal heights have equal areas (Archimedes)."""
    sample = surface("T.x*T.x + T.y*T.y + T.z*T.z = 1").configuration_space.sample(1000, 6)
    assert not sample.exact and abs(np.linalg.norm(sample.q, axis=1) - 1.0).max() < 1e-9
    for k in range(3):
        assert fits(sample.q[:, k], np.linspace(-1.0, 1.0, 11), np.ones(10))


@pytest.mark.slow
def test_a_walk_on_a_torus_has_more_outside_than_inside():
    """Its area by the angle v around the tube goes as R + r cos v (Diaconis, Holmes, Shahshahani,
    2013).
    """
    R = 1.0
    r = 0.6
    text = f"(sqrt(T.x*T.x + T.y*T.y) - {R})**2 + T.z*T.z = {r * r}"
    q = surface(text).configuration_space.sample(1000, 7).q
    around = np.arctan2(q[:, 2], np.hypot(q[:, 0], q[:, 1]) - R)
    edges = np.linspace(-np.pi, np.pi, 9)
    assert fits(around, edges, np.diff(R * edges + r * np.sin(edges)))


@pytest.mark.slow
def test_a_walk_among_rotations_keeps_haars_measure():
    """A ball, and a slide that is tied to none of it but through its own equation: a circle of
    radius 1 times SO(3).
    """
    m = Mechanism("ball and circle")
    m.spherical("Q", m.ground, m.body("ball"))
    m.translation("T", m.ground, m.body("b"))
    m.equation("flat", "T.z = 0")
    m.equation("circle", "T.x*T.x + T.y*T.y = 1")
    sample = m.build().configuration_space.sample(1000, 8)
    angle = 2.0 * np.arccos(np.clip(abs(sample.q[:, 0]), 0.0, 1.0))
    edges = np.linspace(0.0, np.pi, 7)
    assert fits(angle, edges, np.diff(edges - np.sin(edges)))
    k = sample.system.coordinate_names.index("T.x")
    assert fits(
        np.arctan2(sample.q[:, k + 1], sample.q[:, k]), np.linspace(-np.pi, np.pi, 9), np.ones(8)
    )


@pytest.mark.slow
def test_a_five_bars_surface_is_filled_by_area():
    """Shares of the first crank's angle from the areas of a fine net of triangles through closed
    forms.
    """
    a = 0.2
    b = 0.3
    d = 0.2
    system = kempe.load("five_bar")
    sample = system.configuration_space.sample(1000, 9)
    n = 600
    x = np.linspace(-np.pi, np.pi, n + 1)
    t, u = np.meshgrid(x, x, indexing="ij")  # the two cranks
    edges = np.linspace(-np.pi, np.pi, 7)
    shares = np.zeros(6)
    P = np.stack([a * np.cos(t), a * np.sin(t)]), np.stack([d + a * np.cos(u), a * np.sin(u)])
    way = P[1] - P[0]
    far = np.hypot(*way)
    inner = np.arccos(np.clip(far / (2.0 * b), 0.0, 1.0))
    left = np.arctan2(way[1], way[0]) + inner
    right = np.arctan2(-way[1], -way[0]) - inner
    q = np.stack([t, left - t, right - left, right - u, u], axis=-1)

    def step(k: int) -> np.ndarray:
        s = np.diff(q, axis=k)
        return s - 2.0 * np.pi * np.round(s / (2.0 * np.pi))

    e = step(0)[:, :-1]
    f = step(1)[:-1]
    area = np.sqrt(np.maximum(np.sum(e * e, -1) * np.sum(f * f, -1) - np.sum(e * f, -1) ** 2, 0.0))
    fine = far <= 2.0 * b
    area *= fine[:-1, :-1] & fine[1:, :-1] & fine[:-1, 1:] & fine[1:, 1:]
    for k in range(n):
        shares[k * 6 // n] += area[k].sum()
    assert fits(sample.q[:, 0], edges, shares)


@pytest.mark.parametrize("n", [0, -1, 1.5, 10**30, "3", True])
def test_a_wrong_number_is_refused(n):
    with pytest.raises(InputError, match="n is"):
        kempe.load("two_link").configuration_space.sample(n)


def test_slides_that_nothing_bounds_are_named():
    with pytest.raises(InputError, match=r"'J6'.*with_limits"):
        kempe.load("slider").configuration_space.sample(3)
    with pytest.raises(InputError, match="'S1'.*not bounded"):
        kempe.load("three_rpr").configuration_space.sample(3)


def test_structures_and_short_times():
    assert len(kempe.load("shaky_3r").configuration_space.sample(4, 0)) == 4
    late = kempe.load("five_bar").configuration_space.sample(4, 0, budget=Budget(time_limit=1e-9))
    assert late.code == Status.OUT_OF_TIME and "0 configurations of 4" in late.status
    calls = []
    kempe.load("two_link").configuration_space.sample(
        9, 0, budget=Budget(progress=lambda *x: calls.append(x))
    )
    assert calls == [(0, 9)]


@pytest.mark.slow
def test_the_same_number_draws_the_same_sample():
    for name in ("puma560", "four_bar", "five_bar"):
        space = kempe.load(name).configuration_space
        assert np.array_equal(space.sample(5, 3).q, space.sample(5, 3).q)
