"""Exact workspaces of planar platforms in any orientation, against closed forms and the inverse
model.
"""

from __future__ import annotations

import numpy as np
import pytest
from hunts import Hunt

import kempe
from kempe.errors import UnsupportedError
from kempe.forward.joint_lines import JointLine
from kempe.workspace.planar.planar_chain import PlanarChain
from kempe.workspace.planar.planar_platform import (
    PlatformLeg,
    PlatformRegion,
    find_coupler_curves,
    find_open_ends,
)
from kempe.workspace.planar.planar_workspace import compute_loop_area, planar_workspace
from kempe.workspace.planar.plane_curves import TURN, PlanePiece


def platform(legs, tool=(0.0, 0.0), turned=0.0):
    """A platform on legs of (types of joints, base, point of the platform, two numbers, limits of
    two joints).

    RRR has two lengths, RR one. The slide of RPR goes from one number to the other, that of PRR and
    PR by the second along x, with a rod of the first behind it. Angles of last joints are counted
    from `turned` times 1, 2 and 3.
    """
    m = kempe.Mechanism("platform", dim=2)
    body = m.body("body")
    for k, (kind, base, at, (first, second), limits) in enumerate(legs):
        parent = m.body(f"a{k}")
        if kind[0] == "P":
            m.prismatic(f"x{k}", m.ground, parent, at=base, axis=(1.0, 0.0), limits=(0.0, second))
        else:
            m.revolute(f"x{k}", m.ground, parent, at=base, limits=limits[0])
        end = (first, 0.0)
        if len(kind) == 3:
            child = m.body(f"b{k}")
            if kind == "RPR":
                m.prismatic(f"y{k}", parent, child, axis=(1.0, 0.0), limits=(first, second))
                end = (0.0, 0.0)
            else:
                m.revolute(f"y{k}", parent, child, at=(first, 0.0), limits=limits[1])
                end = (second if kind == "RRR" else 0.3, 0.0)
            parent = child
        m.revolute(f"z{k}", parent, body, at=end, child_at=at, child_angle=(k + 1) * turned)
    m.frame("tool", body, at=tool)
    return m.build()


FREE = (None, None)
WIDE = ("RRR", (0.0, 0.0), (0.0, 0.0), (5.0, 5.0), FREE)
"""A leg that holds the platform wherever the others do in the tests below."""


@pytest.mark.parametrize(
    ("legs", "tool", "area"),
    [
        # a crank of 0.5 with the tool 0.2 off its end: an annulus
        (
            [("RR", (0.1, 0.2), (0.0, 0.0), (0.5, 0.0), FREE), WIDE],
            (0.2, 0.0),
            np.pi * (0.7**2 - 0.3**2),
        ),
        # an annulus of radii 0.4 and 1.0, and the tool 0.1 off: wider by that on both sides
        (
            [("RPR", (0.3, 0.0), (0.1, 0.0), (0.4, 1.0), FREE), WIDE],
            (0.0, 0.0),
            np.pi * (1.1**2 - 0.3**2),
        ),
        # the same with the tool 0.5 off: a disk
        ([("RPR", (0.3, 0.0), (0.5, 0.0), (0.4, 1.0), FREE), WIDE], (0.0, 0.0), np.pi * 1.5**2),
        # a slide of 0.8 with the tool 0.3 off: a stadium
        (
            [("PR", (0.0, 0.0), (0.0, 0.3), (0.1, 0.8), FREE), WIDE],
            (0.0, 0.0),
            0.8 * 0.6 + np.pi * 0.3**2,
        ),
    ],
)
def test_legs_of_which_one_decides(legs, tool, area):
    """The other leg ends elsewhere on the platform, so that it is decided as one."""
    other = (*legs[1][:2], (0.4, 0.4), *legs[1][3:])
    w = planar_workspace(platform([legs[0], other], tool), "tool")
    assert isinstance(w.region, PlatformRegion)
    assert w.area == pytest.approx(area, abs=2.0 * w.error) and 0.0 < w.error < 0.002 * area
    assert sum(piece.moment for piece in w.boundary) == pytest.approx(area, abs=1e-9)


def test_two_disks_at_two_points_of_a_rod():
    """A rod of length d with its ends in disks of radius r whose centres are d apart: the middle
    has theirs between.

    Without turning the middle fills a disk of radius r, and it leaves that nowhere, being the mean
    of two points that do not leave theirs.
    """
    r = 0.3
    d = 1.0
    legs = [("RRR", (s * d / 2, 0.0), (s * d / 2, 0.0), (r / 2, r / 2), FREE) for s in (-1.0, 1.0)]
    w = planar_workspace(platform(legs), "tool")
    p = np.random.default_rng(0).uniform(-0.4, 0.4, (4000, 2))
    far = np.hypot(*p.T)
    inside = w.contains(p)
    assert np.array_equal(inside, far < r) and w.area == pytest.approx(
        np.pi * r**2, abs=2 * w.error
    )
    assert {(p.kind, round(float(np.abs(p.sample_points(0.1)).max()), 9)) for p in w.boundary} == {
        ("coupler curve", r)
    }


def annuli(legs, tool, points, turns=20_000):
    """Whether points are reached by RRR and RPR legs without limits, on a fine row of angles:
    shares nothing.
    """
    u = np.exp(1j * TURN * np.arange(turns) / turns)
    out = []
    for p in points:
        good = np.ones(turns, dtype=bool)
        for kind, base, at, (first, second), _ in legs:
            far = np.abs(complex(*p) + u * (complex(*at) - complex(*tool)) - complex(*base))
            least, most = (
                (first, second) if kind == "RPR" else (abs(first - second), first + second)
            )
            good &= (far >= least) & (far <= most)
        out.append(good.any())
    return np.array(out)


THREE = {
    "3-RRR": ([("RRR", 1.0 * np.array([np.cos(a), np.sin(a)]), 0.3 * np.array([np.cos(a), np.sin(a)]), (0.6, 0.45),
                FREE) for a in np.deg2rad([90.0, 210.0, 330.0])], (0.0, 0.0)),
    "3-RPR, as in Merlet, Gosselin, Mouly": ([
        ("RPR", (0.0, 0.0), (0.0, 0.0), (8.0, 12.0), FREE), ("RPR", (15.91, 0.0), (17.04, 0.0), (5.0, 11.0), FREE),
        ("RPR", (0.0, 10.0), (10.42, 17.3), (10.0, 17.0), FREE)], (0.0, 0.0)),
    "3-RPR, tool aside": ([
        ("RPR", (0.0, 0.0), (-0.2, 0.0), (0.3, 0.9), FREE), ("RPR", (1.0, 0.0), (0.2, 0.0), (0.3, 0.7), FREE),
        ("RRR", (0.4, 1.0), (0.0, 0.3), (0.5, 0.2), FREE)], (0.35, 0.1)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", THREE)
def test_three_legs_against_a_row_of_angles(name):
    legs, tool = THREE[name]
    w = planar_workspace(
        platform([(k, tuple(b), tuple(a), *rest) for k, b, a, *rest in legs], tool), "tool"
    )
    low, high = w.extent
    points = np.random.default_rng(1).uniform(low - 0.1, high + 0.1, (500, 2))
    clear = w.distance(points) > 1e-3 * w.region.size
    inside = w.contains(points)
    assert np.array_equal(inside[clear], annuli(legs, tool, points[clear]))
    assert any(p.kind == "coupler curve" for p in w.boundary)
    # closed curves
    assert (
        abs(sum(p.evaluate_points(1.0) - p.evaluate_points(0.0) for p in w.boundary))
        < 1e-6 * w.region.size
    )
    (region,) = w.regions
    assert sum(map(compute_loop_area, region.loops)) == pytest.approx(w.area, abs=2.0 * w.error)
    many = np.random.default_rng(2).uniform(low, high, (200_000, 2))
    box = np.prod(high - low)
    share = w.contains(many).mean()
    assert w.area == pytest.approx(
        box * share, abs=4.0 * box * np.sqrt(share * (1.0 - share) / len(many))
    )
    assert "(sampled)" in w.status and "open end" not in w.status


@pytest.mark.slow
def test_it_moves_with_its_base_and_scales():
    """Turned, moved and enlarged as a whole, and with legs in another order, it has the same area,
    times a square.
    """
    legs, tool = THREE["3-RPR, tool aside"]
    before = planar_workspace(platform(legs, tool), "tool")
    u = np.exp(0.7j)
    by = 3.0 - 2.0j
    scale = 1000.0
    moved = [
        (k, np.array([z.real, z.imag]), np.multiply(a, scale), np.multiply(n, scale), x)
        for k, b, a, n, x in legs[::-1]
        for z in [scale * (u * complex(*b) + by)]
    ]
    after = planar_workspace(platform(moved, np.multiply(tool, scale)), "tool")
    assert after.area == pytest.approx(
        scale**2 * before.area, abs=2.0 * (after.error + scale**2 * before.error)
    )
    lengths = [sum(piece.length for piece in w.boundary) for w in (before, after)]
    # those of coupler curves are sums of chords
    assert lengths[1] == pytest.approx(scale * lengths[0], rel=1e-4)
    assert len(after.voids) == len(before.voids)
    p = np.random.default_rng(3).uniform(*before.extent, (2000, 2))
    z = scale * (u * (p[:, 0] + 1j * p[:, 1]) + by)
    assert np.array_equal(before.contains(p), after.contains(np.column_stack([z.real, z.imag])))


@pytest.mark.slow
def test_a_point_aside_of_a_five_bar(hunt: Hunt):
    """A point of one distal link is reached where the inverse model finds a solution; how many, that
    says.
    """
    legs = [
        ("RR", (-0.3, 0.0), (0.0, 0.0), (0.5, 0.0), FREE),
        ("RRR", (0.3, 0.0), (0.6, 0.0), (0.5, 0.6), (None, (-1.5, 2.5))),
    ]
    system = platform(legs, (0.8, 0.2))
    w = planar_workspace(system, "tool")
    low, high = w.extent
    points = hunt.rng().uniform(low - 0.1, high + 0.1, (hunt.cases(60), 2))
    points = points[w.distance(points) > 1e-4]
    every = [len(system.ik_all(p, "tool", task="position", limits=True).q) for p in points]
    assert w.contains(points).tolist() == [n > 0 for n in every]
    with pytest.raises(UnsupportedError, match="solutions are not counted"):
        w.solutions(points)


def pantograph(unit=1.0):
    """A five-bar whose pen is beyond the joint that the two sides share, with limits at the ground."""
    m = kempe.Mechanism("five", dim=2)
    a, b, c, d = (m.body(x) for x in "abcd")
    m.revolute("A", m.ground, a, at=(-0.1 * unit, 0.0), limits=(0.5, 3.0))
    m.revolute("E", m.ground, d, at=(0.1 * unit, 0.0), limits=(-0.2, 2.6))
    m.revolute("B", a, b, at=(0.25 * unit, 0.0))
    m.revolute("D", d, c, at=(0.25 * unit, 0.0))
    m.revolute("C", b, c, at=(0.3 * unit, 0.0), child_at=(0.3 * unit, 0.0))
    m.frame("pen", b, at=(0.36 * unit, 0.02 * unit))
    return m.build()


@pytest.mark.slow
def test_curves_that_touch_are_cut_once():
    """Where a joint comes to its limit two coupler curves touch: no slivers are left of that, in
    any unit.
    """
    small = planar_workspace(pantograph(), "pen")
    large = planar_workspace(pantograph(1000.0), "pen")
    for w in (small, large):
        assert len(w.voids) == 2 and len(w.boundary) == 14
        assert min(piece.length for piece in w.boundary) > 1e-3 * w.region.size
        assert [len(r.loops) for r in w.regions] == [3]
    assert large.area == pytest.approx(1e6 * small.area, abs=2.0 * large.error)


@pytest.mark.slow
def test_joints_that_limits_hold_turn_the_legs():
    """Held at other angles than zero they are as if the next joint were limited to others."""

    def three(held):
        m = kempe.Mechanism("platform", dim=2)
        body = m.body("body")
        for k, (base, at, angle) in enumerate(
            [((0, 0), (-0.2, 0), 0.7), ((1, 0), (0.2, 0), -0.5), ((0.4, 0.9), (0, 0.2), -0.5)]
        ):
            a = m.body(f"a{k}")
            b = m.body(f"b{k}")
            c = m.body(f"c{k}")
            shift = 0.0 if held else angle
            m.revolute(f"w{k}", m.ground, a, at=base, limits=(angle - shift, angle - shift))
            m.revolute(f"x{k}", a, b, limits=(shift - 2.0, shift + 2.0))
            m.revolute(f"y{k}", b, c, at=(0.4, 0.0))
            m.revolute(f"z{k}", c, body, at=(0.3, 0.0), child_at=at)
        m.frame("tool", body, at=(0.05, 0.02))
        return planar_workspace(m.build(), "tool")

    one = three(True)
    two = three(False)
    assert one.area == pytest.approx(two.area, abs=one.error + two.error) and one.area > 0.05
    points = np.random.default_rng(5).uniform(*one.extent, (2000, 2))
    assert np.array_equal(one.contains(points), two.contains(points))


def test_a_leg_that_reaches_nothing():
    legs = [
        ("RPR", (0.0, 0.0), (0.1, 0.0), (0.4, 1.0), FREE),
        ("RPR", (9.0, 0.0), (-0.1, 0.0), (0.4, 1.0), FREE),
    ]
    w = planar_workspace(platform(legs), "tool")
    assert (
        w.area == 0.0 and not w.contains([[0.5, 0.0]]).any() and "no place is reached" in w.status
    )


def test_what_is_left_a_curve_is_refused():
    legs = [
        ("RR", (0.0, 0.0), (0.1, 0.0), (0.4, 0.0), FREE),
        ("RR", (0.5, 0.0), (-0.1, 0.0), (0.4, 0.0), FREE),
    ]
    with pytest.raises(UnsupportedError, match="leave frame 'tool' a curve"):
        planar_workspace(platform(legs, (0.3, 0.2)), "tool")


# ---- coupler curves


def test_a_trammel_draws_an_ellipse():
    """Of Archimedes: points on two lines at right angles, and one between them at 0.3 and 0.5 of
    them.
    """
    x = PlanePiece(-2.0 + 0j, 0.0, way=4.0 + 0j)
    y = PlanePiece(-2.0j, 0.0, way=4.0j)
    (curve,) = find_coupler_curves(x, y, 0.3 + 0j, -0.5 + 0j)
    p = curve.sample_points(0.0)
    assert np.abs((p.real / 0.5) ** 2 + (p.imag / 0.3) ** 2 - 1.0).max() < 1e-12
    assert compute_loop_area((curve,)) == pytest.approx(
        np.pi * 0.15, rel=1e-4
    ) or compute_loop_area((curve,)) == pytest.approx(-np.pi * 0.15, rel=1e-4)


def test_points_of_a_four_bar_are_on_both_curves():
    """The place, with the platform turned, leads its points along both circles; of random four-bars
    all places that a row of crank angles gives are on a curve.
    """
    rng = np.random.default_rng(0)
    for _ in range(12):
        radii = rng.uniform(0.3, 1.5, 2)
        (c, d, aside) = rng.uniform(-1.0, 1.0, (3, 2)) @ [1.0, 1j]
        one = PlanePiece(0j, radii[0], 0.0, TURN)
        two = PlanePiece(c, radii[1], 0.0, TURN)
        curves = list(find_coupler_curves(one, two, aside, aside + d))
        places = [np.zeros(0, dtype=complex)]
        for curve in curves:
            t = np.linspace(0.0, 1.0, 200)
            p, u = curve.evaluate_motions(t)
            for piece, b in ((one, aside), (two, aside + d)):
                assert np.abs(piece.compute_offsets(p + u * b)).max() < 1e-12
            places.append(curve.sample_points(0.0))
        for angle in rng.uniform(0.0, TURN, 40):
            z = radii[0] * np.exp(1j * angle)
            w = c - z
            along = (abs(w) ** 2 + abs(d) ** 2 - radii[1] ** 2) / (2.0 * abs(w) * abs(d))
            if abs(along) < 0.999:
                for bent in (np.arccos(along), -np.arccos(along)):
                    p = z - aside * np.exp(1j * (np.angle(w / d) + bent))
                    assert np.abs(np.concatenate(places) - p).min() < 0.05


CIRCLE = PlanePiece(0j, 1.0, 0.0, TURN)
CHAIN_POSITIONS = {
    "parallelogram": (CIRCLE, PlanePiece(0.7 + 0j, 1.0, 0.0, TURN), 0.7 + 0j),
    "kite, which turns about the second centre": (CIRCLE, PlanePiece(1.0 + 0j, 0.4, 0.0, TURN), 0.4 + 0j),
    "kite, which turns about the first centre": (PlanePiece(1.0 + 0j, 0.4, 0.0, TURN), CIRCLE, 0.4j),
    "rhombus": (CIRCLE, PlanePiece(1.0 + 0j, 1.0, 0.0, TURN), 1.0 + 0j),
    "crank and slide": (CIRCLE, PlanePiece(-4.0 + 0.3j, 0.0, way=8.0 + 0j), 1.5 + 0j),
    "slide and crank": (PlanePiece(-4.0 + 0.3j, 0.0, way=8.0 + 0j), CIRCLE, 0.6 + 0j),
    "parallel slides": (PlanePiece(-2.0 + 0j, 0.0, way=4.0 + 0j), PlanePiece(-2.0 + 0.3j, 0.0, way=4.0 + 0j), 0.5 + 0j),
}  # fmt: skip


@pytest.mark.parametrize("name", CHAIN_POSITIONS)
def test_places_of_special_four_bars_are_on_curves(name):
    """Those at which one point is put somewhere on its circle or line and the other where a circle
    about that meets the other circle or line: of both points as the first.
    """
    first, second, d = CHAIN_POSITIONS[name]
    a = 0.2 + 0.5j
    curves = list(find_coupler_curves(first, second, a, a + d))
    places = np.concatenate([c.evaluate_points(np.linspace(0.0, 1.0, 4000)) for c in curves])
    assert np.isfinite(places).all()
    for one, two, b, rod in ((first, second, a, d), (second, first, a + d, -d)):
        for z in one.evaluate_points((np.arange(50) + 0.37) / 50).tolist():
            circle = PlanePiece(z, abs(d), 0.0, TURN)
            for t in circle.find_meetings(two, 0.0).tolist():
                p = z - b * (complex(circle.evaluate_points(t)) - z) / rod
                assert np.abs(places - p).min() < 0.01
    for curve in curves:
        t = np.linspace(0.0, 1.0, 300)
        p, u = curve.evaluate_motions(t)
        for piece, b in ((first, a), (second, a + d)):
            assert np.abs(piece.compute_offsets(p + u * b)).max() < 1e-9
        middle = 0.5 * (t[1:] + t[:-1])
        along = np.real(np.diff(p) * curve.evaluate_tangents(middle).conj())
        moving = np.abs(np.diff(p)) > 1e-5
        assert (along[moving] > 0.0).mean() > 0.98  # but where branches touch


# ---- hunts


def random_platform(rng):
    """Two or three legs of all kinds, some with limits, some with one joint fewer; bases and points
    also on a grid.
    """
    legs = []
    for k in range(int(rng.integers(2, 4))):
        few = k == 0 and rng.random() < 0.4
        kind = str(rng.choice(["RR", "PR"] if few else ["RRR", "RPR", "PRR"]))
        base = rng.uniform(-1.0, 1.0, 2)
        at = rng.uniform(-0.5, 0.5, 2)
        if rng.random() < 0.2:
            base = np.round(base)
            at = np.round(at, 1)
        first = float(rng.choice([0.5, rng.uniform(0.2, 0.8)]))
        second = (
            first + float(rng.uniform(0.2, 1.0))
            if kind == "RPR"
            else float(rng.choice([0.5, rng.uniform(0.2, 1)]))
        )
        spans = [np.sort(rng.uniform(-3.0, 3.0, 2)) + [0.0, 0.3] for _ in range(2)]
        limits = [None if rng.random() < 0.5 else (float(low), float(high)) for low, high in spans]
        legs.append((kind, tuple(base), tuple(at), (first, second), tuple(limits)))
    tool = tuple(rng.uniform(-0.4, 0.4, 2)) if rng.random() < 0.8 else (0.0, 0.0)
    return platform(legs, tool, rng.choice([0.0, 0.7]))


def turned_about(boundary, points):
    """Whether curves go round points, by sums of angles of short chords."""
    total = np.zeros(len(points))
    for piece in boundary:
        p = piece.sample_points(0.005)
        for a, b in zip(p[:-1], p[1:], strict=True):
            total += np.angle((b - points) / (a - points))
    return np.round(total / TURN) != 0


@pytest.mark.slow
def test_hunt_for_platforms_that_are_decided_wrongly(hunt: Hunt):
    """Points by common angles of the legs, by the boundary, and by the inverse model; the area by
    counting.
    """
    rng = hunt.rng()
    reached = 0
    for _ in range(hunt.cases(20, least=3)):
        system = random_platform(rng)
        w = planar_workspace(system, "tool")
        if not w.boundary:
            assert not system.ik(
                rng.uniform(-1.0, 1.0, (5, 2)), "tool", task="position"
            ).success.any()
            continue
        reached += 1
        low, high = w.extent
        pad = 0.1 * (high - low)
        points = rng.uniform(low - pad, high + pad, (1000, 2))
        inside = w.contains(points)
        clear = w.distance(points) > 1e-4
        z = points[:, 0] + 1j * points[:, 1]
        assert not len(find_open_ends(w.boundary, 1e-5 * w.region.size))
        round_it = turned_about(w.boundary, z)
        assert np.array_equal(inside[clear], round_it[clear])
        some = np.flatnonzero(clear)[:25]
        found = system.ik(points[some], "tool", task="position").success
        assert np.array_equal(inside[some], found)
        box = float(np.prod(high - low + 2.0 * pad))
        share = inside.mean()
        assert w.area == pytest.approx(
            box * share, abs=5.0 * box * np.sqrt(share * (1.0 - share) / 1000) + 1e-6
        )
    assert reached > 0


def test_regions_are_plain_parts():
    """The parts can be put together without a system, too: a crank, and a disk about its end."""
    crank = PlanarChain.from_joints([JointLine(0j, 0j)], 0.5 + 0j).region
    disk = PlanarChain.from_joints(
        [JointLine(2.0 + 0j, 0j), JointLine(3.0 + 0j, 0j)], 4.0 + 0j
    ).region
    region = PlatformRegion((PlatformLeg(crank, 0.1 + 0j), PlatformLeg(disk, 1.0 + 0j)))
    assert region.contains_points(np.array([0.45 + 0.05j, 3.0 + 0j])).tolist() == [True, False]
