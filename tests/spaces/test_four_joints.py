"""Loops of four joints, against grids, theorems, other coordinates, and curves that are traced."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hunts import some
from polygons import polygon

import kempe
from kempe import Budget, Mechanism, Status
from kempe.spaces.four_joints import FourJoints, find_four_joints
from kempe.spaces.polygons import find_polygon


def decided(system: kempe.System) -> FourJoints:
    found = find_four_joints(system)
    assert isinstance(found, FourJoints)
    return found


def limited(system: kempe.System, rng: np.random.Generator) -> kempe.System:
    """The same with limits of one or two coordinates of turns and slides around a configuration."""
    q = system.assemble({system.coordinate_names[0]: rng.uniform(-3.0, 3.0)}).q
    place = system.coordinate_names.index
    names = [str(x) for x in rng.choice(system.coordinate_names, rng.integers(1, 3), replace=False)]
    size = {n: 0.1 if n == "S" else 1.0 for n in names}
    return system.with_limits(
        {
            n: (
                q[place(n)] - size[n] * rng.uniform(0.1, 2.0),
                q[place(n)] + size[n] * rng.uniform(0.1, 1.0),
            )
            for n in names
        }
    )


def arcs_on_a_grid(system: kempe.System, n: int = 20_000) -> int:
    """Components, from both assemblies at n angles of a turning crank A: runs of angles at which one
    is within limits, joined where both assemblies end together at a dead point.
    """
    plan = system.with_limits(dict.fromkeys(system.coordinate_names)).loops.closed_form("A")
    low, high = system.lower, system.upper
    k = system.coordinate_names.index("A")
    x = FIRST + 2.0 * np.pi * np.arange(n) / n
    q, there = plan.all(x[:, None])
    turning = system.structure.coordinates.turning
    inside = np.zeros(q.shape, dtype=bool)
    for turns in (-1.0, 0.0, 1.0):
        value = q + 2.0 * np.pi * turns * turning
        inside |= (value >= low) & (value <= high)
    alive = there & inside.all(axis=-1)
    assert not np.isfinite([low[k], high[k]]).any()
    runs = []
    for j in (0, 1):
        begin = np.flatnonzero(alive[:, j] & ~np.roll(alive[:, j], 1))
        for i in begin if len(begin) else [0] * bool(alive[0, j]):
            stop = (np.flatnonzero(~np.roll(alive[:, j], -i))[:1].tolist() or [n])[0]
            runs.append((j, int(i), (int(i) + stop - 1) % n, stop == n))
    group = np.arange(len(runs))
    for a, (j, first, last, whole) in enumerate(runs):
        for b, (k2, other, end, _) in enumerate(runs[:a]):
            if j != k2 and not whole:
                dead = [
                    first == other and not there[first - 1].any(),
                    last == end and not there[(last + 1) % n].any(),
                ]
                if any(dead):
                    group[group == max(group[a], group[b])] = min(group[a], group[b])
    return len(np.unique(group))


FIRST = 0.0123


def test_loops_within_limits_are_counted_as_a_grid_counts_them(hunt):
    rng = hunt.rng()
    seen = []
    for _ in range(hunt.cases(16)):
        lengths = rng.uniform(0.2, 1.0, 4)
        m = Mechanism("loop", dim=2)
        m.revolute("A", m.ground, m.body("crank"))
        m.revolute("B", "crank", m.body("rod"), at=(lengths[0], 0))
        if rng.random() < 0.5:
            m.revolute("C", "rod", m.body("rocker"), at=(lengths[1], 0))
            m.revolute("D", m.ground, "rocker", at=(lengths[3], 0), child_at=(lengths[2], 0))
        else:
            m.revolute("C", "rod", m.body("slider"), at=(lengths[1], 0))
            m.prismatic("S", m.ground, "slider", at=(0, lengths[3] - 0.5), axis=(1, 0))
        system = m.build()
        if not system.assemble():
            continue
        system = limited(system, rng)
        bounded = np.isfinite(system.lower)[system.coordinate_names.index("A")]
        found = find_four_joints(system)
        if bounded or isinstance(found, str) or np.diff(found.cuts).min() < 0.01:
            continue
        assert found.count == arcs_on_a_grid(system), (lengths, system.structure.limits)
        assert found.label_components(found.starts).tolist() == list(range(found.count))
        seen.append(found.count)
    assert seen


@pytest.mark.parametrize("name", ["slider_crank", "four_bar"])
def test_traced_curves_keep_their_component(name):
    """The tracer knows nothing of dead points: all along a curve it is in one component."""
    system = kempe.load(name)
    found = decided(system)
    for c, q in enumerate(found.starts):
        path = system.trace(start=q, budget=Budget(points=300))
        assert {*found.label_components(path.q).tolist()} - {-1} == {c}


@pytest.mark.parametrize(
    ("first", "last", "count"), [((0.3, 0.4), (0.3, -0.2), 1), ((0.5, 0.0), (1.0, 0.0), 2)]
)
def test_a_rod_between_two_slides(first, last, count):
    """Its ends draw an ellipse; on parallel slides it is ahead or behind."""
    m = Mechanism("rod on slides", dim=2)
    m.prismatic("S", m.ground, m.body("a"), axis=first)
    m.prismatic("T", m.ground, m.body("b"), axis=last, at=(0, 0.1))
    m.revolute("A", "a", m.body("rod"))
    m.revolute("B", "rod", "b", at=(0.6, 0))
    assert decided(m.build()).count == count


def test_slider_cranks_are_counted_by_their_lengths(hunt):
    """Crank r, rod l, offset e: the sine of the crank's angle is at least (e - l) / r and at most
    (e + l) / r.
    """
    rng = hunt.rng()
    seen = set()
    for _ in range(hunt.cases(12)):
        r, rod, e = rng.uniform(0.1, 1.0, 3)
        m = Mechanism("slider-crank", dim=2)
        m.revolute("A", m.ground, m.body("crank"))
        m.revolute("B", "crank", m.body("rod"), at=(r, 0))
        m.revolute("C", "rod", m.body("slider"), at=(rod, 0))
        m.prismatic("S", m.ground, "slider", at=(0, e), axis=(1, 0))
        low = (e - rod) / r
        high = (e + rod) / r
        gaps = int(low > -1.0) + int(high < 1.0)
        count = 0 if low > 1.0 else 2 if gaps in (0, 2) else 1
        found = m.build().configuration_space.components(budget=Budget(time_limit=60))
        assert (found.count, found.complete) == (count, True), (r, rod, e)
        seen.add(count)
    assert len(seen) > 1


def test_small_gaps_are_gaps(hunt):
    """Loops of four bars near their change points, against Grashof's rule."""
    rng = hunt.rng()
    proven = 0
    for _ in range(hunt.cases(10, least=10)):
        a, b, c = rng.uniform(0.2, 1.0, 3)
        off = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-9.0, -2.0)
        lengths = [max(a, b, c) + min(a, b, c) - sum(sorted([a, b, c])[1:2]) + off, a, b, c]
        if lengths[0] < 0.05:
            continue
        system = polygon(lengths)
        loop = find_polygon(system)
        found = find_four_joints(system)
        assert not isinstance(loop, str)
        assert isinstance(found, str) or found.count == loop.count, lengths
        proven += not isinstance(found, str)
    assert proven > 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", some(["parallelogram", "antiparallelogram", "kite", "slider_crank_equal"], 3)
)
def test_branches_that_touch_are_one_component(name):
    """Change points, to rounding: one component, whose crossings are flat."""
    system = kempe.load(name)
    found = decided(system)
    assert found.count == 1 and len(found.touching)
    assert np.abs(system.loops.closure_error(found.singular_points)).max() < 1e-9
    assert all(system.mobility(q).singular for q in found.singular_points)
    answer = system.configuration_space.components()
    assert (answer.count, answer.complete, len(answer.singular)) == (1, True, 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count", "proven"),
    some(
        [
            ("klann", 3, False),
            ("stephenson_six_bar", 4, False),
            ("watt_six_bar", 2, False),
            ("slider_crank", 2, True),
            ("four_bar_spatial", 2, True),
        ],
        4,
    ),
)
def test_curves_that_are_traced_are_as_many_as_sweeps_with_bounds_proved(name, count, proven):
    answer = kempe.load(name).configuration_space.components()
    assert (answer.count, answer.complete, len(answer.parts)) == (count, proven, count)
    assert all(p.paths[0].closed and p.dimension == 1 for p in answer.parts)
    assert ("evidence and no proof" in answer.status) == (not proven)


def test_a_crank_out_of_its_limits_is_cut():
    system = kempe.load("four_bar").with_limits({"A": (-1.0, 1.0)})
    found = system.configuration_space.components()
    assert (found.count, found.complete) == (2, True)
    assert not any(p.paths[0].closed for p in found.parts)
    a, b = (p.paths[0].q[0] for p in found.parts[:2])
    none = system.configuration_space.path(a, b)
    assert none.code is Status.NONE_EXISTS and "proven" in none.status


def spherical(arcs: list[float]) -> kempe.System:
    """Four turns about axes through the origin, these arcs apart."""
    m = Mechanism("spherical four-bar")
    bodies = [m.ground, m.body("crank"), m.body("coupler"), m.body("rocker")]
    for k, name in enumerate("ABC"):
        m.revolute(name, bodies[k], bodies[k + 1], rpy=(arcs[k] if k else 0.0, 0.0, 0.0))
    m.revolute("D", bodies[3], m.ground, rpy=(arcs[3], 0.0, 0.0), child_rpy=(-arcs[0], 0.0, 0.0))
    return m.build()


def on_the_sphere(arcs: list[float], n: int = 400) -> int:
    """Components by brute force: cells of the two crank angles through which the curve goes."""
    from test_components import glued, label

    ground, crank, coupler, rocker = arcs
    t = 2.0 * np.pi * np.arange(n + 1) / n
    c = np.cos(t)
    s = np.sin(t)
    # directions of the coupler's axes; the second crank turns about an axis in the y-z plane
    u = np.stack([np.sin(crank) * s, -np.sin(crank) * c, np.cos(crank) * np.ones_like(t)])
    v = np.stack([np.sin(rocker) * s, -np.sin(rocker) * c, np.cos(rocker) * np.ones_like(t)])
    turn = np.array(
        [[1, 0, 0], [0, np.cos(ground), -np.sin(ground)], [0, np.sin(ground), np.cos(ground)]]
    )
    f = np.einsum("ia,ib->ab", u, turn @ v) - np.cos(coupler)
    corner = np.stack([f[:-1, :-1], f[1:, :-1], f[:-1, 1:], f[1:, 1:]])
    cells = (corner.min(axis=0) < 0.0) & (corner.max(axis=0) > 0.0)
    return len({*np.unique(glued(np.asarray(label(cells, np.ones((3, 3)))[0])))} - {0})


def test_spherical_loops_are_counted_as_a_grid_counts_them(hunt):
    rng = hunt.rng()
    seen = set()
    for _ in range(hunt.cases(15)):
        arcs = rng.uniform(0.2, 1.5, 4).tolist()
        found = decided(spherical(arcs))
        ways = [np.cos(arcs[0] + np.dot(arcs[1:], s)) for s in itertools.product((1, -1), repeat=3)]
        if min(1.0 - np.array(ways)) < 1e-3:
            continue  # nearly flat: too near for the grid
        assert found.count == on_the_sphere(arcs), arcs
        seen.add(found.count)
    assert seen >= {1, 2}


def test_a_rod_between_a_crank_and_a_slide(hunt):
    """By brute force: values of the slide at which the rod fits, over the crank's angle."""
    rng = hunt.rng()
    seen = set()
    for _ in range(hunt.cases(12)):
        r = rng.uniform(0.2, 0.6)
        rod = rng.uniform(0.2, 1.2)
        at = rng.uniform(-0.6, 0.6, 3)
        axis = rng.normal(size=3)
        m = Mechanism("RSSP")
        m.revolute("A", m.ground, m.body("crank"))
        m.spherical("B", "crank", m.body("rod"), at=(r, 0, 0))
        m.prismatic("S", m.ground, m.body("block"), at=at, axis=axis)
        m.spherical("C", "rod", "block", at=(rod, 0, 0))
        t = 2.0 * np.pi * np.arange(4000) / 4000
        way = np.stack([r * np.cos(t), r * np.sin(t), 0.0 * t], axis=1) - at
        u = axis / np.linalg.norm(axis)
        fits = rod**2 - np.sum(way**2, axis=1) + (way @ u) ** 2 > 0.0
        count = 2 if fits.all() else int((fits & ~np.roll(fits, 1)).sum())
        found = decided(m.build())
        assert found.count == count
        seen.add(count)
    assert len(seen) > 1


def test_what_cannot_be_decided_says_why():
    for name, why in (
        ("five_bar", "four joints"),
        ("double_parallelogram", "more than one loop"),
        ("bennett", "rod"),
    ):
        found = find_four_joints(kempe.load(name))
        assert isinstance(found, str) and why in found
