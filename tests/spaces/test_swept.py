"""Curves swept over one coordinate, against grids, theorems, and curves that are traced."""

from __future__ import annotations

import numpy as np
import pytest
from branch_grid import counted_on_a_grid, crank_and_dyads, limited
from hunts import some
from polygons import polygon

import kempe
from kempe import Budget, Mechanism, Status
from kempe.numerics.clock import TimeLimit
from kempe.spaces.branch_functions import dyad_branches, skew_branches
from kempe.spaces.branch_sweep import CurveSweep, sweep_of, swept
from kempe.spaces.polygons import polygon_of


def every(system: kempe.System) -> list[CurveSweep]:
    """Sweeps over each coordinate that can be used."""
    found = dyad_branches(system) if system.dim == 2 else skew_branches(system)
    return [] if isinstance(found, str) else [swept(b, TimeLimit(None)) for b in found]


def best(system: kempe.System) -> CurveSweep:
    found = sweep_of(system, TimeLimit(None))
    assert isinstance(found, CurveSweep)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("narrow", [False, True])
def test_dyads_are_counted_as_a_grid_counts_them(hunt, narrow):
    rng = hunt.rng()
    complete = 0
    seen = set()
    for _ in range(hunt.cases(8, least=8)):
        system = crank_and_dyads(rng)
        system = limited(system, rng) if narrow else system
        found = every(system)[:2]
        proven = {s.count for s in found if s.complete}
        assert len(proven) < 2, (system, proven)
        if proven:
            (count,) = proven
            assert all(s.count <= count for s in found)
            assert count in (counted_on_a_grid(system, 3000), counted_on_a_grid(system, 40_000)), (
                system
            )
            complete = complete + 1
            seen = seen | proven
    assert complete > 3 and len(seen) > 1


@pytest.mark.slow
def test_curves_that_are_traced_keep_their_component(hunt):
    """The tracer knows nothing of branches: all along a curve it is in one component, and in each
    there is a curve.
    """
    rng = hunt.rng()
    several = 0
    for _ in range(hunt.cases(4, least=4)):
        system = crank_and_dyads(rng)
        sweep = best(system) if not isinstance(dyad_branches(system), str) else None
        if sweep is None or not sweep.complete:
            continue
        for c, q in enumerate(sweep.starts):
            path = system.trace(start=q, budget=Budget(points=300))
            labels = {*sweep.labels(path.q).tolist()} - {-1}
            assert labels == {c}
            assert path.closed == (sweep.ends[c] == 0) or not path.success
        several += sweep.count > 1
    assert several


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


@pytest.mark.slow
def test_small_gaps_are_gaps(hunt):
    """Loops of four bars near their change points, against Grashof's rule: proven, or an honest
    lower bound.
    """
    rng = hunt.rng()
    proven = 0
    for _ in range(hunt.cases(10, least=10)):
        a, b, c = rng.uniform(0.2, 1.0, 3)
        off = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-10.0, -2.0)
        lengths = [max(a, b, c) + min(a, b, c) - sum(sorted([a, b, c])[1:2]) + off, a, b, c]
        if lengths[0] < 0.05:
            continue
        system = polygon(lengths)
        loop = polygon_of(system)
        found = best(system)
        assert not isinstance(loop, str)
        assert found.count == loop.count if found.complete else found.count <= loop.count, lengths
        proven += found.complete
    assert proven > 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", some(["parallelogram", "antiparallelogram", "kite", "slider_crank_equal"], 3)
)
def test_branches_that_touch_are_one_component(name):
    """Change points, to rounding: one component, whose crossings are flat."""
    system = kempe.load(name)
    found = best(system)
    assert (found.count, found.complete, len(found.crossings)) == (1, True, 2)
    assert np.abs(system.loops.closure_error(found.crossings)).max() < 1e-9
    assert all(system.mobility(q).singular for q in found.crossings)
    answer = system.configuration_space.components()
    assert (answer.count, answer.complete, len(answer.singular)) == (1, True, 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"),
    some(
        [
            ("andrews_squeezer", 4),
            ("klann", 3),
            ("stephenson_six_bar", 4),
            ("watt_six_bar", 2),
            ("slider_crank", 2),
            ("four_bar_spatial", 2),
        ],
        4,
    ),
)
def test_all_coordinates_say_the_same(name, count):
    """Counts over different coordinates share no function; those curves that are traced are as
    many.
    """
    system = kempe.load(name)
    found = every(system)
    assert len(found) > 1 and {s.count for s in found if s.complete} == {count}
    answer = system.configuration_space.components()
    assert (answer.count, answer.complete, len(answer.parts)) == (count, True, count)
    assert all(p.paths[0].closed and p.dimension == 1 for p in answer.parts)


def test_a_crank_out_of_its_limits_is_cut():
    free = kempe.load("stephenson_six_bar")
    assert {len(free.assembly_modes({"A": x})) for x in np.linspace(-1.0, 1.0, 9)} == {4}
    system = free.with_limits({"A": (-1.0, 1.0)})
    found = system.configuration_space.components()
    assert (found.count, found.complete) == (4, True)
    assert not any(p.paths[0].closed for p in found.parts) and {*best(system).ends} == {2}
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
        found = best(spherical(arcs))
        if (
            min(
                np.abs(
                    [
                        np.cos(sum(x * y for x, y in zip(arcs, s, strict=True))) - 1.0
                        for s in (
                            (1, 1, 1, -1),
                            (1, 1, -1, 1),
                            (1, -1, 1, 1),
                            (-1, 1, 1, 1),
                            (1, 1, -1, -1),
                            (1, -1, 1, -1),
                            (1, -1, -1, 1),
                            (1, 1, 1, 1),
                        )
                    ]
                )
            )
            < 1e-3
        ):
            continue  # nearly flat: too near for the grid
        assert found.complete and found.count == on_the_sphere(arcs), arcs
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
        found = best(m.build())
        assert (found.count, found.complete) == (count, True)
        seen.add(count)
    assert len(seen) > 1


def test_what_cannot_be_swept_says_why():
    for name, why in (
        ("five_bar", "one freedom"),
        ("double_parallelogram", "counting"),
        ("sarrus", "four"),
        ("bennett", "rod"),
    ):
        found = sweep_of(kempe.load(name), TimeLimit(None))
        assert isinstance(found, str) and why in found
