"""Exact workspaces of planar chains, against closed forms and samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import Hunt

import kempe
from kempe.errors import InputError, UnsupportedError
from kempe.workspace.kinds import read_workspace_kind
from kempe.workspace.planar.planar_workspace import (
    compute_planar_workspace,
    describe_ring,
    planar_workspace,
)
from kempe.workspace.planar.plane_curves import PlanePiece


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
    assert [p.radius for p in sorted(w.boundary, key=lambda p: p.radius)] == pytest.approx(
        [0.2, 1.0]
    )
    assert [(r.solutions, len(r.loops)) for r in w.regions] == [(2, 2)] and len(w.voids) == 1
    assert w.contains([[0.5, 0.5], [0.1, 0.0], [1.1, 0.0], [np.nan, 0.0]]).tolist() == [
        True,
        False,
        False,
        False,
    ]


@pytest.mark.parametrize(("low", "high"), [(0.0, np.pi), (0.3, 2.0), (-2.5, -0.4)])
def test_a_sector_of_an_annulus(low, high):
    """Two links, the second turned to one side only: area by integrating a b |sin q2| over the
    limits.
    """
    a = 0.6
    b = 0.4
    first = (-1.0, 0.5)
    w = planar_workspace(arm(("R", 0.0, first), ("R", a, (low, high))), "tool")
    expected = (first[1] - first[0]) * a * b * abs(np.cos(low) - np.cos(high))
    assert w.area == pytest.approx(expected, abs=1e-10)
    assert [r.solutions for r in w.regions] == [1]


def test_how_many_solutions_there_are_where():
    """Areas, counted with their solutions, are the integral of |det J| = a b |sin q2| over all
    configurations.
    """
    a = 0.6
    b = 0.4
    first = (-1.0, 1.3)
    second = (-2.0, 1.4)
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
    disk = planar_workspace(
        arm(("R", 0.0, None), ("R", 0.5, None), ("R", 0.4, None), tool=0.3), "tool"
    )
    assert disk.area == pytest.approx(np.pi * 1.2**2, abs=1e-10) and not disk.voids
    ring = planar_workspace(
        arm(("R", 0.0, None), ("R", 1.0, None), ("R", 0.3, None), tool=0.2), "tool"
    )
    assert ring.area == pytest.approx(np.pi * (1.5**2 - 0.5**2), abs=1e-10) and len(ring.voids) == 1
    assert ring.regions[0].solutions is None


def test_slides():
    """A turn and a slide: a ring sector; a slide and a turn: a stadium; two slides: a
    parallelogram.
    """
    polar = planar_workspace(arm(("R", 0.0, (0.0, 1.2)), ("P", 0.0, (0.3, 0.9)), tool=0.0), "tool")
    assert polar.area == pytest.approx(0.5 * 1.2 * (0.9**2 - 0.3**2), abs=1e-12)
    stadium = planar_workspace(arm(("P", 0.0, (0.0, 2.0)), ("R", 0.0, None), tool=0.4), "tool")
    reached = 2.0 * 0.8 + np.pi * 0.4**2
    assert stadium.area == pytest.approx(reached, abs=1e-10)  # both ways of bending cover all of it
    m = kempe.Mechanism("gantry", dim=2)
    first = m.body("first")
    second = m.body("second")
    m.prismatic("x", m.ground, first, axis=(1.0, 0.0), limits=(0.0, 2.0))
    m.prismatic("y", first, second, axis=(0.6, 0.8), limits=(0.0, 0.5))
    m.frame("tool", second)
    gantry = planar_workspace(m.build(), "tool")
    assert gantry.area == pytest.approx(2.0 * 0.5 * 0.8, abs=1e-12) and len(gantry.boundary) == 4


def grid(system, workspace, n=90):
    """The area by a grid of points, each decided by `ik` with limits, and the largest it can be
    wrong by.
    """
    size = workspace.region.size
    x = np.linspace(-size, size, n)
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    return points.reshape(-1, 2), (x[1] - x[0]) ** 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "joints",
    [
        (("R", 0.0, (-2.0, 2.0)), ("R", 0.5, (-1.5, 2.2)), ("R", 0.4, (-0.5, 2.5))),
        (("R", 0.0, (-0.6, 0.6)), ("R", 0.7, (0.5, 2.4)), ("R", 0.5, (-2.0, -1.0))),
        (("R", 0.0, (-1.0, 1.0)), ("P", 0.4, (0.1, 0.5)), ("R", 0.2, (-2.0, 2.0))),
        (("P", 0.0, (-0.3, 0.5)), ("R", 0.2, (-1.0, 2.0)), ("R", 0.4, (-2.0, 0.7))),
    ],
)
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
    closed = sum(p.evaluate_points(1.0) - p.evaluate_points(0.0) for p in w.boundary)
    assert abs(closed) < 1e-9  # the boundary is closed curves


def test_hunt_for_two_joints_that_are_counted_wrongly(hunt: Hunt):
    """The integral of |det J| over random limits, by 400 x 400 midpoints, is the area counted with
    solutions.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(6)):
        limits = np.sort(rng.uniform(-3.0, 3.0, (2, 2)), axis=1) + [[0.0, 0.3], [0.0, 0.3]]
        a, b = rng.uniform(0.2, 1.0, 2)
        w = planar_workspace(
            arm(("R", 0.0, tuple(limits[0])), ("R", a, tuple(limits[1])), tool=b), "tool"
        )
        n = 40000
        q = limits[1, 0] + (np.arange(n) + 0.5) / n * np.diff(limits[1])[0]
        total = np.diff(limits[0])[0] * np.diff(limits[1])[0] * np.mean(a * b * np.abs(np.sin(q)))
        assert sum(r.solutions * r.area for r in w.regions) == pytest.approx(total, rel=1e-6), (
            limits
        )


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
    with pytest.raises(
        UnsupportedError, match="constraint 'stop' of two_link may bound the workspace"
    ):
        planar_workspace(m.build(), "e")
    with pytest.raises(InputError, match="does not move"):
        planar_workspace(kempe.load("two_link"), kempe.load("two_link").body_names[0])
    w = planar_workspace(arm(("R", 0.0, None), ("R", 0.6, None)), "tool")
    with pytest.raises(InputError, match="points has shape"):
        w.contains([1.0, 2.0, 3.0, 4.0])


# ---- kinds, and what bounds them, beside the inverse model


def random_arm(rng, wrist):
    """Two to four joints, of which some have one axis, are held by limits, or do not move the tool."""
    count = int(rng.integers(2, 5))
    joints = []
    for k in range(count):
        turns = wrist and k == count - 1 or rng.random() < 0.7
        limits = tuple(
            np.sort(rng.uniform(-3.0, 3.0, 2) if turns else rng.uniform(-1.0, 1.0, 2)).tolist()
        )
        limits = None if turns and (wrist and k == count - 1 or rng.random() < 0.4) else limits
        limits = (0.3, 0.3) if rng.random() < 0.1 and not wrist else limits
        joints.append(
            ("R" if turns else "P", float(rng.choice([0.0, 0.3, rng.uniform(0.1, 1.0)])), limits)
        )
    return arm(*joints, tool=float(rng.choice([0.0, 0.3, rng.uniform(0.05, 0.8)])))


def exact_or_none(system, given):
    """The exact workspace, or None where it has none."""
    try:
        return planar_workspace(system, "tool", **given)
    except (UnsupportedError, InputError):
        return None


@pytest.mark.parametrize(
    "kind",
    [
        "reachable",
        "constant-orientation",
        "dexterous",
        pytest.param("some angles", marks=pytest.mark.slow),
    ],
)
def test_hunt_for_points_that_are_decided_wrongly(hunt: Hunt, kind):
    """What the boundary goes round is what the inverse model reaches, and configurations within
    limits are inside.
    """
    rng = hunt.rng()
    wrist = kind != "reachable"
    areas = 0
    turns = {"constant-orientation": 1, "some angles": 3}
    for _ in range(hunt.cases(24, least=12)):
        system = random_arm(rng, wrist)
        angles = rng.uniform(-3.0, 3.0, turns[kind]) if kind in turns else None
        if kind == "constant-orientation":
            angles = float(angles[0])
        given = {"kind": "dexterous" if kind == "some angles" else kind, "orientation": angles}
        w = exact_or_none(system, given)
        if w is None or w.region.is_curve:
            continue
        points = np.concatenate(
            [system.fk(system.random(rng, 8), "tool")[:, :2, 3], rng.uniform(-2.0, 2.0, (12, 2))]
        )
        clear = w.distance(points) > (0.02 if kind == "dexterous" else 1e-4)
        workspace_kind = read_workspace_kind(system, "tool", given["kind"], angles, None)
        reached = workspace_kind.find_reached_points(
            system, "tool", np.pad(points, ((0, 0), (0, 1))), 0
        )
        assert np.array_equal(w.contains(points)[clear], reached[clear]), (system.mechanism, given)
        numbers = w.region.count_solutions(points[clear] @ [1.0, 1j])
        assert np.array_equal(numbers > 0, reached[clear])
        areas += 1
    assert areas


def test_a_joint_about_the_tool_does_not_move_it():
    w = planar_workspace(
        arm(("R", 0.0, None), ("R", 0.6, None), ("R", 0.4, (-1.0, 1.0)), tool=0.0), "tool"
    )
    assert (
        w.area == pytest.approx(np.pi * (1.0 - 0.04), abs=1e-12) and w.regions[0].solutions is None
    )
    with pytest.raises(InputError, match="does not move"):
        planar_workspace(arm(("R", 0.0, None), tool=0.0), "tool")
    with pytest.raises(InputError, match="held by their limits"):
        planar_workspace(arm(("R", 0.0, (0.3, 0.3)), ("R", 0.5, (1.0, 1.0))), "tool")


def test_turns_about_one_axis_are_one_turn():
    one = planar_workspace(arm(("R", 0.0, (-0.5, 1.0)), ("R", 0.5, (0.2, 2.0))), "tool")
    two = planar_workspace(
        arm(("R", 0.0, (-0.2, 0.5)), ("R", 0.0, (-0.3, 0.5)), ("R", 0.5, (0.2, 2.0))), "tool"
    )
    assert (
        two.area == pytest.approx(one.area, abs=1e-12)
        and one.region.counted
        and not two.region.counted
    )


def test_a_five_bar_reaches_what_both_legs_reach():
    """Two annuli about the ground joints; see Cervantes-Sanchez, Rendon-Sanchez, "A simplified
    approach for obtaining the workspace of a class of 2-dof planar parallel manipulators", Mech.
    Mach. Theory 34 (1999).
    """
    system = kempe.load("five_bar")
    w = planar_workspace(system, "tip")
    circles = {
        (round(p.centre.real, 9), round(p.centre.imag, 9), round(p.radius, 9)) for p in w.boundary
    }
    points = np.random.default_rng(0).uniform(*w.extent, (2000, 2))
    far = np.abs(
        points[:, None] @ [1.0, 1j] - np.array([complex(x, y) for x, y, _ in sorted(circles)])
    )
    radii = np.array([r for _, _, r in sorted(circles)])
    clear = (np.abs(far - radii) > 1e-6).all(axis=1) & (np.arange(2000) < 200)
    assert np.array_equal(system.ik(points[clear], "tip").success, w.contains(points[clear]))
    assert np.prod(w.extent[1] - w.extent[0]) * w.contains(points).mean() == pytest.approx(
        w.area, rel=0.1
    )


def test_a_planar_parallel_robot_in_one_orientation():
    """Of each leg an annulus, moved by where the leg holds the platform (Gosselin, Angeles 1988)."""
    w = kempe.load("three_rrr").reach.planar("tool", orientation=0.2)
    thirds = np.exp(2.0j * np.pi / 3.0 * np.arange(3))
    points = np.random.default_rng(0).uniform(*w.extent, (400_000, 2))
    far = np.abs((points @ [1.0, 1j])[:, None] + (0.15 * np.exp(0.2j) - 0.5) * thirds)
    inside = ((far > 0.05) & (far < 0.55)).all(axis=1)
    assert np.array_equal(w.contains(points), inside)
    assert w.area == pytest.approx(np.prod(w.extent[1] - w.extent[0]) * inside.mean(), rel=5e-3)
    assert {r.solutions for r in w.regions} == {8} and w.kind == "constant-orientation"
    assert "three_rrr, tool (constant-orientation): area" in w.status


@pytest.mark.slow
def test_a_platform_on_three_legs_with_limits_in_given_orientations(monkeypatch):
    """Annuli of the leg lengths about the pivots moved by where the leg holds the platform; area by
    quadrature.

    Merlet, Gosselin, Mouly, "Workspaces of planar parallel manipulators", Mechanism and Machine
    Theory 33 (1998). In twelve orientations they are 36 annuli, of which not each curve is cut by
    each.
    """
    low = 0.35
    high = 0.95
    angle = 0.4
    base = np.array([0.0, 1.0 + 0.1j, 0.3 + 0.9j])
    platform = np.array([0.0, 0.35 - 0.05j, 0.1 + 0.3j])
    m = kempe.Mechanism("3-RPR", dim=2)
    plate = m.body("platform")
    for k, (a, b) in enumerate(zip(base, platform, strict=True)):
        m.revolute(f"A{k}", m.ground, m.body(f"leg{k}"), at=(a.real, a.imag))
        m.prismatic(
            f"s{k}", f"leg{k}", m.body(f"rod{k}"), axis=(1, 0), limits=(low, high), actuated=True
        )
        m.revolute(f"B{k}", f"rod{k}", plate, child_at=(b.real, b.imag))
    m.frame("tool", plate)
    w = m.build().reach.planar("tool", orientation=angle)
    centres = base - platform * np.exp(1j * angle)
    points = np.random.default_rng(0).uniform(-1.0, 1.5, (50_000, 2))
    far = np.abs((points @ [1.0, 1j])[:, None] - centres)
    assert np.array_equal(w.contains(points), ((far > low) & (far < high)).all(axis=1))
    assert w.area == pytest.approx(_area_of_annuli(centres, low, high), rel=1e-5)
    assert m.build().workspace("tool", orientation=angle).area[0] == pytest.approx(
        w.area, abs=1e-12
    )
    cuts = []
    meets = PlanePiece.find_meetings
    monkeypatch.setattr(PlanePiece, "find_meetings", lambda *given: cuts.append(0) or meets(*given))
    turns = np.linspace(0.2, 0.6, 12)
    several = m.build().reach.planar("tool", kind="dexterous", orientation=turns)
    centres = (base - platform * np.exp(1j * turns[:, None])).ravel()
    assert (
        several.area == pytest.approx(_area_of_annuli(centres, low, high, 2000), rel=1e-4)
        and len(cuts) < 60_000
    )


def _area_of_annuli(centres: np.ndarray, low: float, high: float, lines: int = 20_000) -> float:
    """Of what lies in all annuli: lengths of the pieces of lines y = constant, by the midpoint
    rule.
    """
    edges = np.linspace(-1.0, 2.0, lines + 1)
    y = 0.5 * (edges[1:] + edges[:-1])[:, None] - centres.imag
    halves = [np.sqrt(np.maximum(r * r - y * y, 0.0)) for r in (low, high)]
    x = np.sort(
        np.concatenate([s * h + centres.real for h in halves for s in (-1.0, 1.0)], axis=1), axis=1
    )
    middle = 0.5 * (x[:, 1:] + x[:, :-1])
    far = np.hypot(middle[..., None] - centres.real, y[:, None])
    return float(
        (np.diff(x, axis=1) * ((far > low) & (far < high)).all(axis=2)).sum()
        * (edges[1] - edges[0])
    )


def test_dexterous_places_of_three_links():
    """The ring within which a circle of the last link's length lies in the annulus of the first
    two.
    """
    w = planar_workspace(
        arm(("R", 0.0, None), ("R", 0.6, None), ("R", 0.4, None), tool=0.1),
        "tool",
        kind="dexterous",
    )
    assert w.area == pytest.approx(np.pi * (0.9**2 - 0.3**2), abs=1e-10) and len(w.voids) == 1
    empty = planar_workspace(
        arm(("R", 0.0, None), ("R", 0.6, None), ("R", 0.4, None), tool=2.0), "tool", "dexterous"
    )
    assert (
        empty.area == 0.0
        and "no place is reached" in empty.status
        and not empty.contains([0.0, 0.0])
    )
    with pytest.raises(UnsupportedError, match="without limits"):
        planar_workspace(
            arm(("R", 0.0, None), ("R", 0.6, None), ("R", 0.4, (0.0, 1.0))),
            "tool",
            kind="dexterous",
        )
    with pytest.raises(UnsupportedError, match="one of places"):
        compute_planar_workspace(
            w.system, "tool", read_workspace_kind(w.system, "tool", None, None, (0.1, 0.2))
        )


def test_distances_from_the_boundary():
    """Of the annulus of radii 0.1 and 1.1, above its plane, too; infinite points are infinitely
    far.
    """
    w = planar_workspace(arm(("R", 0.0, None), ("R", 0.6, None), tool=0.5), "tool")
    assert w.distance([[0.0, 0.0], [0.3, 0.4], [0.0, -2.0]]) == pytest.approx(
        [0.1, 0.4, 0.9], abs=1e-14
    )
    assert w.distance([0.3, 0.4, 0.3]) == pytest.approx(0.5) and not w.contains([0.3, 0.4, 0.3])
    with np.errstate(all="raise"):
        assert np.isinf(w.distance([[np.inf, 0.0], [0.0, -np.inf]])).all() and np.isnan(
            w.distance([np.nan, 0.0])
        )
        assert not w.contains([[np.inf, 0.0], [0.0, -np.inf], [np.nan, 0.0]]).any()


@pytest.mark.parametrize("over", [1e-2, 1e-3, 3e-4, 1e-4])
def test_curves_that_nearly_coincide(over):
    """A slide that goes just over the place where it is nearest to the axis: the hole stays one,
    however thin the ring of two solutions is.
    """
    w = planar_workspace(arm(("R", 0.0, None), ("P", 0.5, (-0.8, over)), tool=0.0), "tool")
    assert w.area == pytest.approx(np.pi * 0.64, abs=1e-8) and not w.contains([0.1, 0.2])
    assert w.contains([[0.6, 0.0], [0.0, -0.6]]).all() and [r.solutions for r in w.regions] == [
        1,
        2,
    ]
    assert w.regions[1].area == pytest.approx(np.pi * over**2, rel=1e-6)


@pytest.mark.parametrize(
    ("bars", "base", "said"),
    [
        ((0.5, 0.4), (0.0, 0.0), "annulus about (0, 0), 0.1 to 0.9 m"),
        ((1.0, 0.5), (0.3, -0.4), "annulus about (0.3, -0.4), 0.5 to 1.5 m"),
        ((1.0, 1.0), (0.0, 0.0), "disc about (0, 0), radius 2 m"),
    ],
)
def test_a_disc_or_an_annulus_is_named_before_the_samples(bars, base, said):
    m = kempe.Mechanism("arm", dim=2)
    m.revolute("a", m.ground, m.body("one"), at=base)
    m.revolute("b", "one", m.body("two"), at=(bars[0], 0))
    m.frame("tip", "two", at=(bars[1], 0))
    system = m.build()
    assert system.reach.planar("tip").status.startswith(f"arm, tip: {said}, area ")
    assert system.workspace("tip", n=1e4).status.startswith(f"{said}, exactly; 10000 samples of ")
    limited = system.with_limits({"a": (-1, 1)}).reach.planar("tip")
    assert limited.ring == "" and "bounded by" in limited.status


def test_circles_about_two_points_are_no_ring():
    arc = PlanePiece(0j, 1.0, 0.0, math.tau)
    half = PlanePiece(0j, 1.0, 0.0, math.pi)
    hole = PlanePiece(0.01 + 0j, 0.5, math.tau, -math.tau)
    assert describe_ring([arc, hole], 1e-9) == describe_ring([half], 1e-9) == ""
    assert describe_ring([half, PlanePiece(0j, 1.0, math.pi, math.pi)], 1e-9).startswith("disc")
