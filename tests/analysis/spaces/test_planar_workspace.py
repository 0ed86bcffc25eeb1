"""Exact workspaces of planar chains, against closed forms and samples."""

from __future__ import annotations

import numpy as np
import pytest
from hunts import Hunt

import kempe
from kempe.analysis.spaces.planar.planar_workspace import planar_workspace
from kempe.errors import InputError, UnsupportedError


def arm(*joints, tool=0.4):
    """A planar chain of ("R" or "P", length of the link before it, limits)."""
    m = kempe.Mechanism("arm", dim=2)
    parent = m.ground
    for k, (kind, length, limits) in enumerate(joints):
        body = m.body(f"b{k}")
        if kind == "R":
            m.revolute(f"q{k}", parent, body, at=(length, 0.0), limits=limits)
        else:
            m.prismatic(f"q{k}", parent, body, at=(length, 0.0), axis=(0.0, 1.0), limits=limits)
        parent = body
    m.frame("tool", parent, at=(tool, 0.0))
    return m.build()


def sampled(system, workspace, count=4000, rng=0):
    """No configuration lies outside, but for those on the boundary to rounding."""
    p = system.fk(system.random(rng, count), "tool")[..., :2, 3]
    inside = workspace.contains(p)
    return bool((inside | (workspace.distance(p) < 1e-9)).all())


def test_an_annulus_of_two_links_without_limits():
    w = planar_workspace(arm(("R", 0.0, None), ("R", 0.6, None)), "tool")
    assert w.area == pytest.approx(np.pi * (1.0**2 - 0.2**2), abs=1e-12)
    assert [p.radius for p in sorted(w.boundary, key=lambda p: p.radius)] == pytest.approx([0.2, 1.0])
    assert [(r.solutions, len(r.loops)) for r in w.regions] == [(2, 2)] and len(w.voids) == 1
    assert w.contains([[0.5, 0.5], [0.1, 0.0], [1.1, 0.0], [np.nan, 0.0]]).tolist() == [True, False, False, False]


@pytest.mark.parametrize(("low", "high"), [(0.0, np.pi), (0.3, 2.0), (-2.5, -0.4)])
def test_a_sector_of_an_annulus(low, high):
    """Two links, the second turned to one side only: area by integrating a b |sin q2| over the limits."""
    a, b, first = 0.6, 0.4, (-1.0, 0.5)
    w = planar_workspace(arm(("R", 0.0, first), ("R", a, (low, high))), "tool")
    expected = (first[1] - first[0]) * a * b * abs(np.cos(low) - np.cos(high))
    assert w.area == pytest.approx(expected, abs=1e-10)
    assert [r.solutions for r in w.regions] == [1]


def test_how_many_solutions_there_are_where():
    """Areas, counted with their solutions, are the integral of |det J| = a b |sin q2| over all configurations."""
    a, b, first, second = 0.6, 0.4, (-1.0, 1.3), (-2.0, 1.4)
    system = arm(("R", 0.0, first), ("R", a, second))
    w = planar_workspace(system, "tool")
    folded = sum(1.0 - np.cos(x) for x in second)
    total = sum(r.solutions * r.area for r in w.regions)
    assert total == pytest.approx((first[1] - first[0]) * a * b * folded, abs=1e-10)
    assert [r.solutions for r in w.regions] == [1, 2] and sampled(system, w)
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (300, 2))
    answer = system.ik_all(points, "tool", limits=True)
    assert np.array_equal(w.solutions(points), answer.mask.sum(axis=-1))


def test_three_links_without_limits_reach_a_disk_or_an_annulus():
    """Radii by the lengths of the links: the longest less the others."""
    disk = planar_workspace(arm(("R", 0.0, None), ("R", 0.5, None), ("R", 0.4, None), tool=0.3), "tool")
    assert disk.area == pytest.approx(np.pi * 1.2**2, abs=1e-10) and not disk.voids
    ring = planar_workspace(arm(("R", 0.0, None), ("R", 1.0, None), ("R", 0.3, None), tool=0.2), "tool")
    assert ring.area == pytest.approx(np.pi * (1.5**2 - 0.5**2), abs=1e-10) and len(ring.voids) == 1
    assert ring.regions[0].solutions is None


def test_slides():
    """A turn and a slide: a ring sector; a slide and a turn: a stadium; two slides: a parallelogram."""
    polar = planar_workspace(arm(("R", 0.0, (0.0, 1.2)), ("P", 0.0, (0.3, 0.9)), tool=0.0), "tool")
    assert polar.area == pytest.approx(0.5 * 1.2 * (0.9**2 - 0.3**2), abs=1e-12)
    stadium = planar_workspace(arm(("P", 0.0, (0.0, 2.0)), ("R", 0.0, None), tool=0.4), "tool")
    reached = 2.0 * 0.8 + np.pi * 0.4**2
    assert stadium.area == pytest.approx(reached, abs=1e-10)  # both ways of bending cover all of it
    m = kempe.Mechanism("gantry", dim=2)
    first, second = m.body("first"), m.body("second")
    m.prismatic("x", m.ground, first, axis=(1.0, 0.0), limits=(0.0, 2.0))
    m.prismatic("y", first, second, axis=(0.6, 0.8), limits=(0.0, 0.5))
    m.frame("tool", second)
    gantry = planar_workspace(m.build(), "tool")
    assert gantry.area == pytest.approx(2.0 * 0.5 * 0.8, abs=1e-12) and len(gantry.boundary) == 4


def grid(system, workspace, n=90):
    """The area by a grid of points, each decided by `ik` with limits, and the largest it can be wrong by."""
    size = workspace.region.size
    x = np.linspace(-size, size, n)
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    return points.reshape(-1, 2), (x[1] - x[0]) ** 2


@pytest.mark.parametrize("joints", [
    (("R", 0.0, (-2.0, 2.0)), ("R", 0.5, (-1.5, 2.2)), ("R", 0.4, (-0.5, 2.5))),
    (("R", 0.0, (-0.6, 0.6)), ("R", 0.7, (0.5, 2.4)), ("R", 0.5, (-2.0, -1.0))),
    (("R", 0.0, (-1.0, 1.0)), ("P", 0.4, (0.1, 0.5)), ("R", 0.2, (-2.0, 2.0))),
    (("P", 0.0, (-0.3, 0.5)), ("R", 0.2, (-1.0, 2.0)), ("R", 0.4, (-2.0, 0.7))),
])  # fmt: skip
def test_three_joints_with_limits(joints):
    """Nothing that is sampled lies outside, and what `ik` reaches of a grid is what is inside."""
    system = arm(*joints, tool=0.3)
    w = planar_workspace(system, "tool")
    assert sampled(system, w, 1500)
    points, cell = grid(system, w, 40)
    clear = w.distance(points) > 0.02
    reached = system.ik(points[clear], "tool").success
    assert np.array_equal(w.contains(points[clear]), reached)
    assert w.area == pytest.approx(cell * w.contains(points).sum(), rel=0.08)
    closed = sum(p.at(1.0) - p.at(0.0) for p in w.boundary)
    assert abs(closed) < 1e-9  # the boundary is closed curves


def test_hunt_for_two_joints_that_are_counted_wrongly(hunt: Hunt):
    """The integral of |det J| over random limits, by 400 x 400 midpoints, is the area counted with solutions."""
    rng = hunt.rng()
    for _ in range(hunt.cases(6)):
        limits = np.sort(rng.uniform(-3.0, 3.0, (2, 2)), axis=1) + [[0.0, 0.3], [0.0, 0.3]]
        a, b = rng.uniform(0.2, 1.0, 2)
        w = planar_workspace(arm(("R", 0.0, tuple(limits[0])), ("R", a, tuple(limits[1])), tool=b), "tool")
        n = 40000
        q = limits[1, 0] + (np.arange(n) + 0.5) / n * np.diff(limits[1])[0]
        total = np.diff(limits[0])[0] * np.diff(limits[1])[0] * np.mean(a * b * np.abs(np.sin(q)))
        assert sum(r.solutions * r.area for r in w.regions) == pytest.approx(total, rel=1e-6), limits


def test_one_joint_has_a_curve_without_area():
    w = planar_workspace(arm(("R", 0.0, (0.0, 1.0))), "tool")
    assert w.area == 0.0 and len(w.boundary) == 1 and w.boundary[0].length == pytest.approx(0.4)
    assert "a curve" in w.status


def test_what_cannot_be_done_is_said():
    with pytest.raises(UnsupportedError, match="in space"):
        planar_workspace(kempe.load("puma560"), "tool")
    with pytest.raises(InputError, match="slide 'q0' has no limits"):
        planar_workspace(arm(("P", 0.0, None), ("R", 0.0, None)), "tool")
    with pytest.raises(UnsupportedError, match="loop"):
        planar_workspace(kempe.load("four_bar"), "coupler")
    m = kempe.load("two_link").mechanism
    m.inequality("stop", "1 - q2", of=("q2",))
    with pytest.raises(UnsupportedError, match="constraint 'stop' of two_link may bound the workspace"):
        planar_workspace(m.build(), "e")
    with pytest.raises(InputError, match="does not move"):
        planar_workspace(kempe.load("two_link"), kempe.load("two_link").body_names[0])
    w = planar_workspace(arm(("R", 0.0, None), ("R", 0.6, None)), "tool")
    with pytest.raises(InputError, match="points has shape"):
        w.contains([1.0, 2.0, 3.0, 4.0])
