"""Public reports about closed chains: how many freedoms, which branch, how far, and where the end
of the range is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from public_oracles import PI, apart, at, point, pose_error, rpy, turn
from scipy.optimize import brentq, fsolve
from scipy.spatial.transform import Rotation

import kempe
from kempe import Mechanism, System
from kempe.mobility.local_dimension import find_local_dimension


def four_bar(
    crank: float,
    coupler: float,
    rocker: float,
    ground: float,
    limits: dict[str, tuple[float, float]] | None = None,
) -> System:
    """Planar four-bar linkage with hinges A and D on the ground, B and C on the coupler."""
    m = Mechanism("four-bar", dim=2)
    a, b, c = (m.body(name) for name in "abc")
    ends = limits or {}
    m.revolute("A", m.ground, a, limits=ends.get("A"))
    m.revolute("B", a, b, at=(crank, 0), limits=ends.get("B"))
    m.revolute("D", m.ground, c, at=(ground, 0), limits=ends.get("D"))
    m.revolute("C", b, c, at=(coupler, 0), child_at=(rocker, 0), limits=ends.get("C"))
    return m.build()


def third_corner(A: np.ndarray, B: np.ndarray, a: float, b: float, side: int) -> np.ndarray | None:
    """Where two links of lengths a and b from A and B meet, on the left of AB for side 1; None if
    they do not.
    """
    across = B - A
    L = float(np.linalg.norm(across))
    x = (a * a - b * b + L * L) / (2 * L)
    if a * a < x * x:
        return None
    e = across / L
    return A + x * e + side * math.sqrt(a * a - x * x) * np.array([-e[1], e[0]])


def on_circle(radius: float, angle: float) -> np.ndarray:
    return radius * np.array([math.cos(angle), math.sin(angle)])


# ---- four-bar linkages


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
def test_a_crank_rocker_keeps_its_branch_over_a_turn(side):
    """Articraft, issue 127: ground 1, crank 0.5, coupler 1.2, rocker 0.8; sweeping the crank
    changed the branch.
    """
    s = four_bar(0.5, 1.2, 0.8, 1.0)

    def expected(angle):
        return third_corner(on_circle(0.5, angle), np.array([1.0, 0]), 1.2, 0.8, side)

    def hinge(q):
        return point(s, q, "c", 0.8)[:2]

    C = expected(0.2)
    q = s.assemble({"A": 0.2}, start={"A": 0.2, "D": math.atan2(C[1], C[0] - 1)}).q
    np.testing.assert_allclose(hinge(q), C, atol=1e-9)
    angles = np.linspace(0.2, 0.2 + 2 * PI, 361)
    driven = s.drive({"A": angles}, start=q)
    followed = s.assemble({"A": angles}, start=q, prefer="continuous")
    assert driven
    for answer in (driven, followed):
        assert (
            max(
                np.linalg.norm(hinge(v) - expected(t))
                for v, t in zip(answer.q, angles, strict=True)
            )
            < 1e-8
        )
    for samples in (5, 9, 13):
        coarse = s.drive({"A": np.linspace(0.2, 0.2 + 2 * PI, samples)}, start=q)
        assert np.linalg.norm(hinge(coarse.q[-1]) - C) < 1e-8, samples


def test_a_parallelogram_carries_its_coupler_point_on_a_circle():
    """pylinkage, issue 2: crank 1, coupler 3, rocker 1, ground 3, with a rigid triangle on the
    coupler.
    """
    m = Mechanism("triangle", dim=2)
    a, b, c = (m.body(name) for name in "abc")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("D", m.ground, c, at=(3, 0))
    m.revolute("C", b, c, at=(3, 0), child_at=(1, 0))
    m.frame("head", b, at=(1.5, 1.0))
    s = m.build()
    assert s.mobility().dof == 1
    q = s.assemble({"A": 0.31}).q
    assert np.linalg.norm(point(s, q, "a", 1) - point(s, q, "c", 1)) == pytest.approx(3, abs=1e-9)
    heads = s.fk(s.trace("A", start=q).q, "head")[:, :2, 3]
    if abs(s.fk(q, "b")[1, 0]) < 1e-6:  # the coupler stays parallel
        np.testing.assert_allclose(np.linalg.norm(heads - [1.5, 1.0], axis=1), 1, atol=1e-6)


def test_a_four_bar_stops_at_its_toggle_and_does_not_jump():
    """solidworks_urdf_exporter2, issue 96: a hood is driven past its toggle, and back; one jump of
    36 degrees.
    """
    s = four_bar(0.35, 0.30, 0.25, 0.5)
    toggle = math.acos(0.2)

    def expected(angle, side):
        return third_corner(on_circle(0.35, angle), np.array([0.5, 0]), 0.30, 0.25, side)

    def hinge(q):
        return point(s, q, "c", 0.25)[:2]

    q = s.assemble({"A": 0.4}, branch="+").q
    side = 1 if np.allclose(hinge(q), expected(0.4, 1), atol=1e-6) else -1
    driven = s.drive({"A": np.linspace(0.4, toggle + 0.3, 50)}, start=q)
    assert not driven
    reached = driven.q[np.isfinite(driven.q).all(axis=1)]
    assert reached[-1][0] <= toggle + 1e-6
    before = [v for v in reached if v[0] < toggle - 1e-4]
    assert before and max(np.linalg.norm(hinge(v) - expected(v[0], side)) for v in before) < 1e-7
    assert not s.assemble({"A": toggle + 0.2}, start=reached[-1])
    far = s.drive({"A": [0.4, 1.03]}, start=q)
    assert far and np.linalg.norm(hinge(far.q[-1]) - expected(1.03, side)) < 1e-8


def test_limits_of_a_follower_are_named_where_they_exclude_the_linkage():
    """articraft, issue 146: the limits of a follower exclude what the linkage needs; which limit is
    it?
    """
    s = four_bar(0.1, 0.5, 0.4, 0.4, {"D": (1.2, 1.5)})
    answers = [s.assemble({"A": angle}) for angle in np.linspace(0, 2 * PI, 40)]
    refused = [answer.status for answer in answers if not answer]
    assert refused and all("D" in status for status in refused)


def test_angles_of_a_linkage_are_inside_limits_from_zero_to_a_turn():
    """universal_robot, issues 127 and 316, for linkages: all hinges go from 0 to 2 pi; are both
    modes offered?
    """
    s = four_bar(2, 7, 9, 6, dict.fromkeys("ABCD", (0, 2 * PI)))
    assert len(s.assembly_modes({"A": 0.5})) == 2
    for angle in np.linspace(0, 2 * PI, 60):
        assert s.assemble({"A": angle}), angle


@pytest.mark.parametrize("seed", range(10))
def test_a_spatial_four_bar_need_not_be_aligned_with_the_world(seed):
    """gz-physics, issue 719: a closed chain works only if its axes are aligned with those of the
    world.
    """
    s = turned_four_bar(seed, None)
    assert s.mobility().dof == 1 and s.assemble({"A": 0.5})


@pytest.mark.parametrize("seed", range(5))
def test_a_four_bar_with_rounded_axes_moves_within_a_tolerance(seed):
    """gz-physics, issue 719: the same with axes and places rounded to five digits, as files have
    them.
    """
    s = turned_four_bar(seed, 5)
    assert s.mobility(tolerance=1e-4).dof == 1
    assert s.assemble({"A": 0.5}, tolerance=1e-4)


def turned_four_bar(seed: int, digits: int | None) -> System:
    R = Rotation.random(random_state=seed).as_matrix()

    def turned(*xyz: float) -> tuple[float, ...]:
        v = R @ xyz
        return tuple(v if digits is None else np.round(v, digits))

    m = Mechanism("turned")
    a, b, c = (m.body(name) for name in "abc")
    axis = turned(0, 0, 1)
    m.revolute("A", m.ground, a, axis=axis)
    m.revolute("B", a, b, at=turned(0.4, 0, 0), axis=axis)
    m.revolute("D", m.ground, c, at=turned(1, 0, 0), axis=axis)
    m.revolute("C", b, c, at=turned(1, 0, 0), child_at=turned(0.8, 0, 0), axis=axis)
    return m.build()


# ---- linkages given by the places of their hinges


def local(origin: np.ndarray, along: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Coordinates of a place in the frame of a link that lies from `origin` towards `along`."""
    u = (along - origin) / np.linalg.norm(along - origin)
    d = place - origin
    return float(d @ u), float(u[0] * d[1] - u[1] * d[0])


def direction(origin: np.ndarray, along: np.ndarray) -> float:
    return math.atan2(*(along - origin)[::-1])


def length(A: np.ndarray, B: np.ndarray) -> float:
    return float(np.linalg.norm(B - A))


def test_a_four_bar_given_by_places_has_the_range_of_the_triangle_inequality():
    """PMKSWeb, issue 91: hinges and coupler point are given by coordinates; the program drew a
    wrong path.
    """
    A, B, C, D, E = map(
        np.array, [(4.1, 3.75), (1.244, 0.196), (-2.32, -2.293), (0.165, 1.322), (-2.591, 1.657)]
    )
    AB = length(A, B)
    BC = length(B, C)
    DC = length(D, C)
    AD = length(A, D)
    m = Mechanism("places", dim=2)
    crank, coupler, rocker = (m.body(name) for name in ("crank", "coupler", "rocker"))
    m.revolute("A", m.ground, crank, at=A)
    m.revolute("B", crank, coupler, at=(AB, 0))
    m.revolute("D", m.ground, rocker, at=D)
    m.revolute("C", coupler, rocker, at=(BC, 0), child_at=(DC, 0))
    m.frame("E", coupler, at=local(B, C, E))
    s = m.build()
    start = {"A": direction(A, B), "D": direction(D, C)}
    answer = s.assemble({"A": start["A"]}, start=start)
    assert answer
    np.testing.assert_allclose(s.fk(answer.q, "E")[:2, 3], E, atol=1e-9)
    trace = s.trace("A", start=answer.q)
    cranks = s.fk(trace.q, "crank")
    rockers = s.fk(trace.q, "rocker")
    couplers = (cranks @ [AB, 0, 0, 1] - rockers @ [DC, 0, 0, 1])[:, :2]
    np.testing.assert_allclose(np.linalg.norm(couplers, axis=1), BC, atol=1e-9)
    ends = sorted(event.q[0] for event in trace.turning_points)
    cosines = [(AB**2 + AD**2 - r * r) / (2 * AB * AD) for r in (BC + DC, abs(BC - DC))]
    farthest, nearest = (math.acos(max(-1.0, min(1.0, c))) for c in cosines)
    if farthest < PI and nearest > 0:  # two ranges, one on each side of AD
        assert ends[-1] - ends[0] == pytest.approx(farthest - nearest, abs=1e-3)
    elif ends:
        assert ends[-1] - ends[0] == pytest.approx(2 * (farthest - nearest), abs=1e-3)
    else:
        assert np.ptp(trace.q[:, 0]) == pytest.approx(2 * PI, abs=1e-3)


def test_links_of_a_six_bar_keep_their_lengths():
    """PMKSWeb, issue 92: a six-bar linkage given by coordinates; there links became longer and
    shorter.
    """
    places = [
        (-3.74, -2.41),
        (-2.72, 0.91),
        (1.58, 0.43),
        (-0.24, 4.01),
        (5.08, 5.31),
        (8.14, 3.35),
        (7.32, -3.51),
    ]
    A, B, C, D, E, F, G = map(np.array, places)
    m = Mechanism("six-bar", dim=2)
    ab, cbd, cfg, de, fe = (m.body(name) for name in ("AB", "CBD", "CFG", "DE", "FE"))
    m.revolute("A", m.ground, ab, at=A)
    m.revolute("B", ab, cbd, at=(length(A, B), 0))
    m.revolute("G", m.ground, cfg, at=G)
    m.revolute("C", cbd, cfg, at=local(B, C, C), child_at=local(G, F, C))
    m.revolute("D", cbd, de, at=local(B, C, D))
    m.revolute("F", cfg, fe, at=local(G, F, F))
    m.revolute("E", de, fe, at=(length(D, E), 0), child_at=(length(F, E), 0))
    s = m.build()
    ternary = direction(B, C)
    start = {"A": direction(A, B), "G": direction(G, F), "B": ternary - direction(A, B)}
    start |= {"D": direction(D, E) - ternary, "F": direction(F, E) - direction(G, F)}
    answer = s.assemble({"A": start["A"]}, start=start)
    assert answer and s.mobility(answer.q).dof == 1
    held = {
        "A": A,
        "B": ("AB", (length(A, B), 0)),
        "C": ("CBD", local(B, C, C)),
        "D": ("CBD", local(B, C, D)),
    }
    held |= {"E": ("DE", (length(D, E), 0)), "F": ("CFG", local(G, F, F)), "G": G}

    def now(q):
        return {
            k: v if isinstance(v, np.ndarray) else point(s, q, v[0], *v[1])[:2]
            for k, v in held.items()
        }

    drawn = dict(zip("ABCDEFG", (A, B, C, D, E, F, G), strict=True))
    assert all(length(now(answer.q)[k], drawn[k]) < 1e-6 for k in drawn)
    for q in s.trace("A", start=answer.q).q[::5]:
        moved = now(q)
        for a, b in ("AB", "BC", "DE", "EF", "CG", "FG", "CF", "BD", "CD"):
            assert length(moved[a], moved[b]) == pytest.approx(
                length(drawn[a], drawn[b]), abs=1e-9
            ), a + b
    assert len(s.assembly_modes({"A": start["A"]})) >= 1


# ---- sliders


def test_a_slider_crank_moves_as_its_formula_and_turns_at_its_dead_centres():
    """pylinkage, issues 56 and 60; Pyslvs, issue 49: crank 1, rod 2.2; driven by the slider from a
    dead centre.
    """
    m = Mechanism("slider-crank", dim=2)
    a, b, c = (m.body(name) for name in "abc")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.prismatic("S", m.ground, c, axis=(1, 0))
    m.revolute("C", b, c, at=(2.2, 0))
    s = m.build()
    assert s.mobility().dof == 1
    angles = np.linspace(0.0, 2 * PI, 25)
    q = s.assemble({"A": 0.0}, start={"S": 3.2}).q
    driven = s.drive({"A": angles}, start=q)
    assert driven
    expected = np.cos(angles) + np.sqrt(2.2**2 - np.sin(angles) ** 2)
    np.testing.assert_allclose([s.q_dict(v)["S"] for v in driven.q], expected, atol=1e-9)
    assert len(s.trace("S", start=q).turning_points) >= 2


def test_an_engine_with_a_cylindrical_pin_closes_from_far_away():
    """FreeCAD, issue 30536: crankshaft, rod and piston in space; the solver fails unless parts are
    dragged first.
    """
    m = Mechanism("engine")
    crank, rod, piston = (m.body(name) for name in ("crank", "rod", "piston"))
    m.revolute("main", m.ground, crank, axis=(0, 1, 0))
    m.revolute("big end", crank, rod, at=(40, 0, 0), axis=(0, 1, 0))
    m.cylindrical("bore", m.ground, piston, axis=(0, 0, 1))
    m.cylindrical("pin", rod, piston, at=(0, 0, 140), axis=(0, 1, 0))
    s = m.build()
    assert s.mobility().dof == 1
    rng = np.random.default_rng(0)
    for case in range(200):
        start = rng.uniform(-200, 200, s.nq)
        angle = rng.uniform(-3, 3)
        answer = s.assemble({"main": angle}, start=start)
        assert answer, case
        above = s.fk(answer.q, "piston")[2, 3] + 40 * math.sin(angle)
        assert abs(above) == pytest.approx(
            math.sqrt(140**2 - (40 * math.cos(angle)) ** 2), abs=1e-6
        ), case


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scott_russell_linkage_draws_a_straight_line(dim):
    """EXUDYN, issue 39: redundant hinges of a Scott Russell linkage in space make the Jacobian
    singular.
    """
    m = Mechanism("Scott Russell", dim=dim)
    big, small, slider, platform = (m.body(name) for name in ("big", "small", "slider", "platform"))

    def place(x, y):
        return (x, y, 0)[:dim]

    hinge = {} if dim == 2 else {"axis": (0, 0, 1)}
    m.prismatic("S", m.ground, slider, axis=place(1, 0))
    m.revolute("R", slider, big, **hinge)
    m.revolute("O", m.ground, small, **hinge)
    m.revolute("M", small, big, at=place(1, 0), child_at=place(1, 0), **hinge)
    m.prismatic("T", m.ground, platform, axis=place(0, 1))
    m.revolute("P", platform, big, child_at=place(2, 0), **hinge)
    m.frame("tip", big, at=place(2, 0))
    s = m.build()
    assert s.mobility().dof == 1
    answer = s.assemble({"S": 1.2})
    assert answer
    x, y = s.fk(answer.q, "tip")[:2, 3]
    assert x == pytest.approx(0, abs=1e-9) and abs(y) == pytest.approx(
        math.sqrt(4 - 1.44), abs=1e-9
    )


def test_a_quick_return_has_the_time_ratio_of_its_formula():
    """PMKSWeb, issue 231: crank 100 mm, centres 240 mm apart; the return takes 2 acos(100/240) of a
    turn.
    """
    m = Mechanism("quick return", dim=2)
    crank, block, lever = (m.body(name) for name in ("crank", "block", "lever"))
    m.revolute("A", m.ground, crank, at=(0, 240))
    m.revolute("B", crank, block, at=(100, 0))
    m.revolute("O", m.ground, lever, at=(0, 0))
    m.prismatic("S", lever, block, axis=(1, 0))
    s = m.build()
    q = s.assemble({"A": 0.3}, start={"O": 1.5, "S": 300.0}).q
    assert s.mobility(q).dof == 1
    first, second, *_ = (event.q[0] for event in s.trace("O", start=q).turning_points)
    part = abs(first - second) % (2 * PI)
    part = min(part, 2 * PI - part)
    assert math.degrees(part) == pytest.approx(2 * math.degrees(math.acos(100 / 240)), abs=1e-4)
    assert (2 * PI - part) / part == pytest.approx(1.753, abs=1e-3)


def test_a_scotch_yoke_moves_as_a_cosine():
    """PMKSWeb, issue 231: the template of a Scotch yoke; is its stroke a pure cosine?"""
    m = Mechanism("yoke", dim=2)
    crank, pin, yoke = (m.body(name) for name in ("crank", "pin", "yoke"))
    m.revolute("A", m.ground, crank)
    m.revolute("P", crank, pin, at=(0.3, 0))
    m.prismatic("slot", yoke, pin, axis=(0, 1))
    m.prismatic("Y", m.ground, yoke, axis=(1, 0))
    s = m.build()
    angles = np.linspace(0, 6, 61)
    driven = s.drive({"A": angles}, start=s.assemble({"A": 0.0}).q)
    np.testing.assert_allclose(
        [s.q_dict(q)["Y"] for q in driven.q], 0.3 * np.cos(angles), atol=1e-9
    )


def test_a_roller_adds_a_freedom_that_is_of_no_use():
    """METU course on mechanisms, Kutzbach with a roller: an eccentric cam; the count says 2, one is
    the roller's.
    """
    m = Mechanism("cam", dim=2)
    cam, follower, roller = (m.body(name) for name in ("cam", "follower", "roller"))
    m.revolute("A", m.ground, cam)
    m.frame("centre", cam, at=(0.02, 0))
    m.prismatic("S", m.ground, follower, axis=(0, 1))
    m.revolute("R", follower, roller)
    m.distance("touch", "centre", roller, 0.08)
    s = m.build()
    q = s.assemble({"A": 0.4}, start={"S": 0.08}).q
    mobility = s.mobility(q)
    assert (mobility.dof, mobility.useful) == (2, 1)
    angles = np.linspace(0.4, 0.4 + 2 * PI, 37)
    driven = s.drive({"A": angles}, start=q)
    expected = 0.02 * np.sin(angles) + np.sqrt(0.0064 - (0.02 * np.cos(angles)) ** 2)
    np.testing.assert_allclose([s.q_dict(v)["S"] for v in driven.q], expected, atol=1e-9)


def test_a_steering_trapezoid_moves_as_its_triangles():
    """onshape-to-robot, issue 94; solidworks_urdf_exporter2, issue 92: a rack steers two wheels,
    not in proportion.
    """
    track = 0.30
    arm = 0.06
    tie = 0.11
    behind = -0.05
    slant = 0.25
    arms = {side: -arm * np.array([math.cos(slant), side * math.sin(slant)]) for side in (1, -1)}
    m = Mechanism("steering", dim=2)
    wheels = {1: m.body("left"), -1: m.body("right")}
    rack = m.body("rack")
    ties = {1: m.body("left tie"), -1: m.body("right tie")}
    names = {1: "L", -1: "R"}
    for side, wheel in wheels.items():
        m.revolute(names[side], m.ground, wheel, at=(0, side * track / 2))
    m.prismatic("rack", m.ground, rack, at=(behind, 0), axis=(0, 1))
    for side, wheel in wheels.items():
        m.revolute(f"{names[side]} inner", rack, ties[side], at=(0, side * 0.03))
        m.revolute(f"{names[side]} outer", ties[side], wheel, at=(tie, 0), child_at=arms[side])
    s = m.build()
    start = s.assemble({"rack": 0.0}, start={"L inner": PI / 2, "R inner": -PI / 2})
    assert start and s.mobility(start.q).dof == 1
    middle = s.q_dict(start.q)
    assert middle["L"] + middle["R"] == pytest.approx(0, abs=1e-9)

    def angles(y, side):
        def missing(t):
            c = math.cos(t)
            n = math.sin(t)
            end = np.array([[c, -n], [n, c]]) @ arms[side] + [0, side * track / 2]
            return float(np.linalg.norm(end - [behind, y + side * 0.03])) - tie

        tried = np.linspace(-1.2, 1.2, 1001)
        values = [missing(t) for t in tried]
        pairs = zip(itertools.pairwise(tried), itertools.pairwise(values), strict=True)
        return [brentq(missing, a, b, xtol=1e-14) for (a, b), (u, w) in pairs if u * w < 0]

    places = np.linspace(0, 0.03, 31)
    driven = s.drive({"rack": places}, start=start.q)
    assert driven
    for q, y in zip(driven.q[::3], places[::3], strict=True):
        for side, name in names.items():
            assert min(abs(t - s.q_dict(q)[name]) for t in angles(y, side)) < 1e-9
    factor = s.loops.jacobian(driven.q[0], inputs=["L"], outputs=["R"]).matrix[0, 0]
    assert factor == pytest.approx(1, abs=1e-9)


def scissor(
    cells: int, dim: int, limits: tuple[float, float] | None
) -> tuple[System, dict[str, float]]:
    """Scissor lift with bars of length 1 whose foot slides, and its symmetric configuration."""
    m = Mechanism("scissor", dim=dim)

    def place(x, y=0.0):
        return (x, y, 0)[:dim]

    hinge = {} if dim == 2 else {"axis": (0, 0, 1)}
    left = m.ground
    right = m.body("slider")
    m.prismatic("S", m.ground, right, axis=place(1), limits=limits)
    slope = 0.6
    start = {"S": math.cos(slope)}
    for i in range(cells):
        a = m.body(f"a{i}")
        b = m.body(f"b{i}")
        end = place(1.0 if i else 0.0)
        m.revolute(f"p{i}", left, a, at=end, **hinge)
        m.revolute(f"r{i}", right, b, at=end, **hinge)
        m.revolute(f"c{i}", a, b, at=place(0.5), child_at=place(0.5), **hinge)
        start |= {
            f"p{i}": 2 * slope - PI if i else slope,
            f"r{i}": PI - 2 * slope if i else PI - slope,
        }
        start[f"c{i}"] = PI - 2 * slope
        left = b
        right = a
    return m.build(), start


ENDS = (0.2, 0.95)
LIFTS = [(3, 2, ENDS), (3, 2, None), (4, 3, ENDS)]
LONG_LIFTS = [(4, 3, None), (10, 2, ENDS), (10, 2, None)]


@pytest.mark.parametrize(
    "cells, dim, limits",
    [*LIFTS, *(pytest.param(*case, marks=pytest.mark.slow) for case in LONG_LIFTS)],
)
def test_scissor_lifts_with_many_cells_move(cells, dim, limits):
    """gz-physics, issue 25; articraft, issue 120: count, assemble, drive and trace a lift with many
    cells.
    """
    s, start = scissor(cells, dim, limits)
    answer = s.assemble({"S": math.cos(0.6)}, start=start)
    assert answer
    np.testing.assert_allclose(answer.q, s.q(start), atol=1e-9)
    assert s.mobility(answer.q).dof == 1
    assert s.drive({"S": np.linspace(math.cos(0.6), 0.3, 50)}, start=answer.q)
    traced = s.trace("S", start=answer.q, budget=kempe.Budget(points=40))
    assert np.abs([s.loops.closure_error(q) for q in traced.q[::10]]).max() < 1e-8


# ---- legs and platforms in space


def test_a_leg_of_parallel_hinges_in_space_is_counted_and_moved():
    """pinocchio, issue 2729: a leg like Digit's; "6D" closures leave no freedom, "3D" closures are
    unstable.
    """
    m = Mechanism("leg")
    thigh, shank, rod, crank = (m.body(name) for name in ("thigh", "shank", "rod", "crank"))
    y = (0, 1, 0)
    m.revolute("hip", m.ground, thigh, axis=y)
    m.revolute("knee", thigh, shank, at=(0, 0, -0.4), axis=y, limits=(-2.4, 0))
    m.revolute("motor", thigh, crank, at=(0.05, 0, -0.05), axis=y, actuated=True)
    m.revolute("A", crank, rod, at=(0.06, 0, 0), axis=y)
    m.revolute("B", rod, shank, at=(0, 0, -0.35), child_at=(0.06, 0, 0), axis=y)
    s = m.build()
    assert s.mobility().dof == 2
    for knee in np.linspace(-1.2, -0.2, 7):
        answer = s.assemble({"hip": 0.3, "knee": knee})
        assert answer, knee
        rod_now = point(s, answer.q, "crank", 0.06) - point(s, answer.q, "shank", 0.06)
        assert np.linalg.norm(rod_now) == pytest.approx(0.35, abs=1e-9)
    J = s.loops.jacobian(answer.q, inputs=["hip", "motor"], outputs=["knee"]).matrix
    motor = s.q_dict(answer.q)["motor"]
    h = 1e-6
    after, before = (
        s.assemble({"hip": 0.3, "motor": motor + d}, start=answer.q).q for d in (h, -h)
    )
    rate = (s.q_dict(after)["knee"] - s.q_dict(before)["knee"]) / (2 * h)
    assert J[0, 1] == pytest.approx(rate, abs=1e-5)


def test_the_count_does_not_change_when_the_parts_move():
    """FreeCAD, issue 27557: the reported degrees of freedom change after the part was moved."""
    s = kempe.load("four_bar_spatial")
    first = s.coordinate_names[0]
    assert {s.mobility(s.assemble({first: t}).q).dof for t in np.linspace(0, 6, 25)} == {1}


RODS = {"L": (0.05, 0.25), "R": (-0.05, 0.20)}
"""Of the ankle below: side, length of the rod."""


def ankle(limits: dict[str, tuple[float, float]] | None) -> System:
    """Foot on a universal joint, turned by two cranks over rods."""
    m = Mechanism("ankle")
    foot = m.body("foot")
    m.universal("U", m.ground, foot, limits=limits)
    for side, (y, rod) in RODS.items():
        crank = m.body(f"crank {side}")
        m.revolute(f"m{side}", m.ground, crank, at=(-0.02, y, rod), axis="y", actuated=True)
        m.distance(f"rod {side}", crank, foot, rod, at=(-0.05, 0, 0), child_at=(-0.07, y, 0.0))
    return m.build()


def rod_errors(foot: np.ndarray, motors: Sequence[float]) -> list[float]:
    """How much too long the square of each rod is, by plain geometry."""
    errors = []
    for angle, (y, rod) in zip(motors, RODS.values(), strict=True):
        A = (at(-0.02, y, rod) @ turn("y", angle) @ [-0.05, 0, 0, 1])[:3]
        B = (foot @ [-0.07, y, 0, 1])[:3]
        errors.append(float((A - B) @ (A - B)) - rod**2)
    return errors


ANKLE_LIMITS = {"rx": (-0.5, 0.5), "ry": (-0.8, 0.8)}


def test_a_parallel_ankle_is_solved_both_ways():
    """Robotics_Notebooks, issue 907; RBDyn, issue 127: motors for a foot, and the foot for these
    motors.
    """
    s = ankle(ANKLE_LIMITS)
    assert s.mobility().dof == 2
    rng = np.random.default_rng(0)
    for case in range(100):
        pitch = rng.uniform(-0.5, 0.5)
        roll = rng.uniform(-0.3, 0.3)
        answer = s.assemble({"U.rx": roll, "U.ry": pitch})
        assert answer, case
        values = s.q_dict(answer.q)
        motors = {"mL": values["mL"], "mR": values["mR"]}
        assert np.abs(rod_errors(s.fk(answer.q, "foot"), list(motors.values()))).max() < 1e-10
        back = s.q_dict(s.assemble(motors, start=answer.q).q)
        assert abs(back["U.rx"] - roll) + abs(back["U.ry"] - pitch) < 1e-8, case
    assert len(s.assembly_modes({"U.rx": 0.1, "U.ry": 0.2})) == 4


@pytest.mark.slow
def test_limits_of_a_model_do_not_hide_modes_that_are_asked_for_without_them():
    """RBDyn, issue 127; Linkage, issue 12: all modes of an ankle with and without limits, counted
    from many starts.
    """
    free = ankle(None)
    limited = ankle(ANKLE_LIMITS)
    values = free.q_dict(free.assemble({"U.rx": 0.0539, "U.ry": 0.4783}).q)
    motors = {"mL": values["mL"], "mR": values["mR"]}

    def equations(v):
        return rod_errors(turn("x", v[0]) @ turn("y", v[1]), list(motors.values()))

    rng = np.random.default_rng(1)
    roots = []
    for _ in range(300):
        v = fsolve(equations, rng.uniform(-PI, PI, 2), xtol=1e-13, full_output=True)[0]
        if np.abs(equations(v)).max() < 1e-12 and all(apart(v, w) > 1e-3 for w in roots):
            roots.append(v)
    assert len(free.assembly_modes(motors)) == len(roots)
    without = limited.assembly_modes(motors, limits=False)
    assert len(without) == len(roots), without.status
    assert "missing" not in limited.assembly_modes(motors).status


@pytest.mark.slow
@pytest.mark.parametrize("rods, dof, useful", [(6, 8, 2), (3, 6, 3)])
def test_a_plate_on_equal_parallel_rods(rods, dof, useful):
    """r/robotics, question 1jivt2u: a plate on six rods with balls at both ends; answers were 0, 2,
    3, 6, 8 and 9.
    """
    s = plate(rods)
    q = s.assemble(start={"F.z": 1.0, "F.qw": 1.0}).q
    np.testing.assert_allclose(s.fk(q, "plate"), at(0, 0, 1), atol=1e-9)
    mobility = s.mobility(q)
    assert (mobility.dof, mobility.useful) == (dof, useful), mobility.sentence


@pytest.mark.slow
def test_a_plate_on_rods_for_any_random_numbers(hunt):
    """Both branches are shaky all along: what is near a branch must not count as a direction of it."""
    s = plate(6)
    q = s.assemble(start={"F.z": 1.0, "F.qw": 1.0}).q
    for seed in range(hunt.cases(40)):
        assert find_local_dimension(s, q, rng=seed).dim == 8, seed


@pytest.mark.slow
def test_a_plate_on_six_rods_keeps_two_freedoms_away_from_home():
    """r/robotics, question 1jivt2u: the same after the plate was moved sideways by 0.3, still
    parallel.
    """
    s = plate(6)
    start = {"F.x": 0.3, "F.z": math.sqrt(1 - 0.3**2), "F.qw": 1.0}
    q = s.assemble({"F.x": 0.3}, start=start).q
    if np.allclose(s.fk(q, "plate")[:3, :3], np.eye(3), atol=1e-6):
        assert s.mobility(q).dof == 8
    assert s.fk(q, "plate")[0, 3] == pytest.approx(0.3, abs=1e-9)


def plate(rods: int) -> System:
    m = Mechanism("plate")
    top = m.body("plate")
    m.free("F", m.ground, top)
    for i in range(rods):
        corner = (*on_circle(1.0, 2 * PI * i / rods), 0)
        rod = m.body(f"rod{i}")
        m.spherical(f"B{i}", m.ground, rod, at=corner)
        m.spherical(f"T{i}", rod, top, at=(0, 0, 1), child_at=corner)
    return m.build()


BASE = [(150, 20, 0), (-58, 141, 0), (-92, 120, 0), (-92, -120, 0), (-58, -141, 0), (150, -20, 0)]
TOP = [(60, 80, 0), (40, 92, 0), (-100, 12, 0), (-100, -12, 0), (40, -92, 0), (60, -80, 0)]


def stewart() -> tuple[System, np.ndarray, list[float]]:
    """Platform in millimetres, a pose, and its leg lengths."""
    X = at(8, -5, 180) @ rpy(0.08, -0.05, 0.12)
    lengths = [length((X @ [*p, 1])[:3], np.array(b)) for p, b in zip(TOP, BASE, strict=True)]
    m = Mechanism("stewart")
    platform = m.body("platform")
    m.free("F", m.ground, platform)
    for i, (b, p, long) in enumerate(zip(BASE, TOP, lengths, strict=True)):
        m.distance(f"leg{i}", m.ground, platform, m.parameter(f"L{i}", long), at=b, child_at=p)
    return m.build(), X, lengths


def test_a_platform_in_millimetres_is_assembled_from_its_leg_lengths():
    """Stewart platforms of jotux and NicHub: leg lengths of a pose are given; is that pose found
    from above?
    """
    s, X, _ = stewart()
    answer = s.assemble(start={"F.z": 170.0, "F.qw": 1.0})
    assert answer and pose_error(s.fk(answer.q, "platform"), X) < 1e-6
    assert s.mobility(answer.q).dof == 0


@pytest.mark.slow
def test_all_assemblies_of_a_platform_in_millimetres():
    """Stewart platforms of jotux and NicHub: are the assemblies a mirrored set, the given pose
    among them?
    """
    s, X, lengths = stewart()
    poses = s.fk(s.assembly_modes().q, "platform")
    assert min(pose_error(Y, X) for Y in poses) < 1e-6 and len(poses) % 2 == 0
    for Y in poses:
        legs = [length((Y @ [*p, 1])[:3], np.array(b)) for p, b in zip(TOP, BASE, strict=True)]
        np.testing.assert_allclose(legs, lengths, atol=1e-6)
