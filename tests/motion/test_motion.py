"""Paths of mechanisms with one freedom, against circles, laws of cosines and published curves."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hunts import examples, some
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from linkages import double_watt
from motion_linkages import (
    JANSEN,
    TURN,
    angle,
    bennett,
    circles,
    four_bar,
    jansen,
    jansen_points,
    ladder,
    linkage,
    peaucellier,
    row_of_four_bars,
    same_angle,
    slider_crank,
    two_parallelograms,
)

import kempe
from kempe import Mechanism
from kempe.arguments import call_until_interrupt
from kempe.equations.closure import Closure
from kempe.equations.closure_rows import compute_residual
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.motion import crossings, events
from kempe.motion.crossings import SingularNode, find_germ
from kempe.motion.trace import trace, trace_branches
from kempe.numerics import newton
from kempe.numerics.clock import TimeLimit


def pins(a, d, A, D, c):
    """Moving pins B on the crank and C on the rocker of a four-bar, (n, 2) each."""
    B = a * np.stack([np.cos(A), np.sin(A)], axis=-1)
    return B, np.array([d, 0.0]) + c * np.stack([np.cos(D), np.sin(D)], axis=-1)


# ---- whole branches against closed forms


def test_crank_rocker_by_circles():
    a = 1.0
    b = 2.5
    c = 2.0
    d = 3.0
    path = trace(four_bar(a, b, c, d), "A", {"A": 0.5})
    assert path.closed and path.success and path.turns["A"] == 1 and not path.turning_points
    A = path.values("A")
    B = a * np.stack([np.cos(A), np.sin(A)], axis=-1)
    errors = []
    for side in (1.0, -1.0):
        C = circles(B, b, [d, 0.0], c, side)
        errors.append(same_angle(path.values("D"), angle(C - [d, 0.0])))
        assert (errors[-1] < 1e-13) == (same_angle(path.values("B"), angle(C - B) - A) < 1e-13)
    assert min(errors) < 1e-13 < max(errors)
    assert np.abs(compute_residual(path.system, path.q)).max() < 1e-14


def test_crank_rocker_driven_from_the_rocker_has_its_dead_points_where_crank_and_coupler_align():
    a = 1.0
    b = 2.5
    c = 2.0
    d = 3.0
    path = trace(four_bar(a, b, c, d), "D", {"A": 0.5})
    assert path.closed and [e.kind for e in path.turning_points] == 2 * ["fold of the driver"]
    inner = [math.pi - math.acos((c * c + d * d - r * r) / (2 * c * d)) for r in (b - a, b + a)]
    found = sorted(abs(e.value) for e in path.turning_points)
    np.testing.assert_allclose(found, sorted(inner), atol=1e-12)
    for e in path.turning_points:
        B = path.system.q_dict(e.q)["B"]
        assert abs(math.sin(B)) < 1e-9  # in line


def test_double_rocker_turns_back_at_the_law_of_cosines():
    a = 2.0
    b = 1.5
    c = 2.2
    d = 3.0
    path = trace(four_bar(a, b, c, d), "A", {"A": 0.8})
    assert path.closed and "A" not in path.turns
    extreme = math.acos((a * a + d * d - (b + c) ** 2) / (2 * a * d))
    np.testing.assert_allclose(
        sorted(e.value for e in path.turning_points), [-extreme, extreme], atol=1e-12
    )
    for e in path.turning_points:
        assert abs(path.at(e.s) - e.q).max() < 1e-6  # also its arc length is right


def test_slider_crank_dead_centres():
    r = 1.0
    rod = 2.3
    offset = 0.4
    path = trace(slider_crank(r, rod, offset), "S", [0.6, -1.0, 0.0, 3.0])
    assert path.closed and abs(path.turns["A"]) == 1
    A = path.values("A")
    S = path.values("S")
    exact = r * np.cos(A) + np.sqrt(rod**2 - (r * np.sin(A) - offset) ** 2)
    np.testing.assert_allclose(S, exact, atol=1e-13)
    ends = [math.sqrt((rod - r) ** 2 - offset**2), math.sqrt((rod + r) ** 2 - offset**2)]
    np.testing.assert_allclose(sorted(e.value for e in path.turning_points), ends, atol=1e-13)


@pytest.mark.slow
def test_peaucellier_draws_a_straight_line():
    system = peaucellier()
    path = trace(system, "Q", np.zeros(system.nq))
    assert path.closed
    D = path.curve("D*")
    # closed to 1e-12, where the cell is stretched
    assert np.abs(D[:, 0] - (3.0**2 - 1.6**2) / 2.0).max() < 1e-11
    # as far as the cell reaches
    assert np.ptp(D[:, 1]) == pytest.approx(2.0 * math.sqrt(4.6**2 - 3.22**2), abs=1e-9)


def test_jansen_foot_by_chained_circles():
    system = jansen()
    path = trace(system, "O", np.zeros(system.nq))
    assert path.closed and path.turns["O"] == 1 and not path.singular_points
    exact = jansen_points(path.values("O"))
    for name in "XYZWVF":
        # lengths are about 50
        assert np.abs(path.curve(f"{name}*")[:, :2] - exact[name]).max() < 1e-11, name
    foot = path.resample(400).curve("F*")
    low = foot[foot[:, 1] < foot[:, 1].min() + 1.5]
    # it walks: most of the step is near the ground
    assert np.ptp(low[:, 0]) > 0.6 * np.ptp(foot[:, 0]) > 40.0
    assert JANSEN["m"] == 15


def polar_watt(a, b, c, point):
    """|left - right| of the equation of Watt's curve: ground 2 a, cranks b, coupler 2 c, polar about the middle."""
    r2 = point @ point
    t = math.atan2(point[1], point[0])
    root = math.sqrt(max(c * c - (a * math.cos(t)) ** 2, 0.0))
    return min(abs(r2 - b * b + (a * math.sin(t) + s * root) ** 2) for s in (1, -1))


def test_watt_curve_has_its_published_equation():
    a = 1.5
    b = 1.1
    c = 0.7
    system = four_bar(b, 2 * c, b, 2 * a, tracer=(c, 0.0))
    path = trace(system, "A", [0.5, -1.4, math.pi - 0.5, 0.0])
    assert path.closed
    points = path.curve("P")[:, :2] - [a, 0.0]
    assert max(polar_watt(a, b, c, p) for p in points) < 1e-12


def test_chebyshev_linkage_is_on_its_line_three_times():
    """Cranks 5, ground 4, coupler 2: the middle of the coupler has y = 4 at x = 0, 2 and 4 (3-4-5
    triangles).
    """
    path = trace(
        four_bar(5, 2, 5, 4, tracer=(1.0, 0.0)),
        "A",
        {"A": math.atan2(4, 3), "D": math.atan2(4, -3)},
    )
    assert path.closed
    P = path.curve("P")
    between = P[(P[:, 0] > 0.0) & (P[:, 0] < 4.0) & (np.abs(P[:, 1] - 4.0) < 0.2)]
    # nearly straight, but not quite
    assert len(between) > 20 and 0.005 < np.abs(between[:, 1] - 4.0).max() < 0.02
    system = path.system
    for A, D, point in [
        (math.pi / 2, math.atan2(3, -4), (0, 4)),
        (math.atan2(4, 3), math.atan2(4, -3), (2, 4)),
        (math.atan2(3, 4), math.pi / 2, (4, 4)),
    ]:
        B, C = pins(5.0, 4.0, A, D, 5.0)
        np.testing.assert_allclose((B + C) / 2, point, atol=1e-12)
        k = int(np.argmin(np.hypot(*(P[:, :2] - point).T)))
        q = path.at(nearest_s(path, path.s[k], "A", A))
        np.testing.assert_allclose(system.fk(q, "P")[:2, 3], point, atol=1e-11)


def nearest_s(path, s, coordinate, value):
    """Arc length near `s` at which a coordinate has a value, by the secant method."""
    i = path.system.coordinate_names.index(coordinate)
    f = lambda x: math.remainder(path.at(x)[i] - value, TURN)  # noqa: E731
    a = s - 0.01
    b = s + 0.01
    for _ in range(30):
        fa = f(a)
        fb = f(b)
        if fa == fb:
            break
        a, b = b, b - fb * (b - a) / (fb - fa)
    return b


def test_hoeken_linkage_is_on_its_line_at_quarter_turns():
    """Crank 1, ground 2, coupler and rocker 2.5, tracer at twice the coupler: (4, 4), (2, 4), (0,
    4).
    """
    path = trace(four_bar(1, 2.5, 2.5, 2, tracer=(5.0, 0.0)), "A", [math.pi / 2, -0.6, 1.6, 0.0])
    assert path.closed and path.turns["A"] == 1
    A = path.values("A")
    P = path.curve("P")[:, :2]
    B, C = pins(1.0, 2.0, A, path.values("D"), 2.5)
    np.testing.assert_allclose(P, 2 * C - B, atol=1e-13)
    up = P[:, 1].mean() > 0  # the other assembly mode is the mirror image
    for quarter, x in [(1, 4.0), (2, 2.0), (3, 0.0)]:
        k = int(np.argmin(np.abs(np.mod(A, TURN) - quarter * math.pi / 2)))
        s = nearest_s(path, path.s[k], "A", quarter * math.pi / 2)
        X = path.system.fk(path.at(s), "P")[:2, 3]
        np.testing.assert_allclose(np.abs(X), [4.0 - x if not up else x, 4.0], atol=1e-11)


def test_bennett_relation_along_the_branch():
    alpha = math.radians(40)
    beta = math.radians(70)
    system = bennett(1.0, math.sin(beta) / math.sin(alpha), alpha, beta)
    K = math.sin((beta + alpha) / 2) / math.sin((beta - alpha) / 2)
    second = 2 * math.atan(K / math.tan(0.5))
    path = trace(system, "T1", [1.0, second, -1.0, -second])
    assert path.closed and path.turns == {"T1": 1, "T2": -1, "T3": -1, "T4": 1}
    t = path.q
    # tan(T1/2) tan(T2/2) = K, without the poles
    left = np.sin(t[:, 0] / 2) * np.sin(t[:, 1] / 2) - K * np.cos(t[:, 0] / 2) * np.cos(t[:, 1] / 2)
    assert np.abs(left).max() < 1e-13
    assert same_angle(t[:, 0], -t[:, 2]) < 1e-13 and same_angle(t[:, 1], -t[:, 3]) < 1e-13


def universal_rssr(angles: bool):
    """Crank and rocker in space joined by a rod with a universal and a spherical joint."""
    m = Mechanism("RUSR")
    crank = m.body("crank")
    rod = m.body("rod")
    rocker = m.body("rocker")
    m.revolute("A", m.ground, crank)
    m.revolute("D", m.ground, rocker, at=(2, 0, 0.5), rpy=(0.5, 1.2, 0))
    m.universal("B", crank, rod, at=(0.5, 0, 0))
    m.spherical("C", rod, rocker, at=(2, 0, 0), child_at=(1, 0, 0), cut=True, angles=angles)
    m.frame("pin", crank, at=(0.5, 0, 0))
    m.frame("ball", rocker, at=(1, 0, 0))
    return m.build()


@pytest.mark.slow
def test_spatial_path_with_a_quaternion_closes_and_keeps_the_rod():
    system = universal_rssr(angles=False)
    path = trace(system, "D", {"A": 0.3})
    assert path.closed
    rod = np.linalg.norm(path.curve("pin") - path.curve("ball"), axis=1)
    assert np.abs(rod - 2.0).max() < 1e-13
    first = system.fk(path.q[0])
    last = system.fk(path.q[-1])
    assert np.abs(first - last).max() < 1e-12
    # the rocker turns back where the sphere about its ball only touches the circle of the pin
    assert len(path.turning_points) == 2
    for e in path.turning_points:
        C = system.fk(e.q, "ball")[:3, 3]
        assert abs(0.25 + C @ C - 4.0) == pytest.approx(math.hypot(C[0], C[1]), abs=1e-12)
    other = trace(universal_rssr(angles=True), "D", {"A": 0.3})
    found = [sorted(math.remainder(e.value, TURN) for e in p.turning_points) for p in (path, other)]
    assert found[0] == pytest.approx(found[1], abs=1e-10)


# ---- singular points and branches


def test_parallelogram_change_points_and_branches():
    path = trace(four_bar(1, 2, 1, 2), "A", {"A": 0.8, "B": -0.8, "D": 0.8})
    assert path.closed and path.length == pytest.approx(2 * TURN, abs=1e-9)  # all four rates are 1
    assert same_angle(path.values("A"), path.values("D")) < 1e-12
    first, second = path.singular_points
    assert (first.kind, first.nullity, len(first.directions)) == ("bifurcation", 2, 2)
    np.testing.assert_allclose(np.mod(first.q[0], TURN), math.pi, atol=1e-9)
    np.testing.assert_allclose(np.mod(second.q[0] + 1.0, TURN), 1.0, atol=1e-9)
    assert first.s == pytest.approx(2 * (math.pi - 0.8), abs=1e-9)
    # rates (A, B, D, C): parallel (1, -1, 1, -1); the other by the heights and, in second order, by
    # the line
    np.testing.assert_allclose(np.abs(first.directions[0]), 0.5, atol=1e-8)
    crossed = first.directions[1] / first.directions[1][0]
    coupler = 1.0 + crossed[1]
    rocker = crossed[2]
    assert -1 + 2 * coupler == pytest.approx(-rocker, abs=1e-7)
    assert coupler**2 * 2 - 1 + rocker**2 == pytest.approx(0.0, abs=1e-7)
    assert abs(coupler) > 0.1


def test_branches_of_the_parallelogram():
    parallel, crossed = trace_branches(four_bar(1, 2, 1, 2), "A", {"A": 0.8, "B": -0.8, "D": 0.8})
    assert same_angle(parallel.values("A"), parallel.values("D")) < 1e-12
    A = crossed.values("A")
    D = crossed.values("D")
    product = np.sin(A / 2) * np.cos(D / 2), np.cos(A / 2) * np.sin(D / 2)
    # tan(D/2) / tan(A/2) is constant
    ratio = np.linalg.lstsq(product[0][:, None], product[1], rcond=None)[0][0]
    assert np.abs(product[1] - ratio * product[0]).max() < 1e-9 and abs(ratio - 1) > 0.5
    assert crossed.closed and len(crossed.singular_points) == 2


def test_a_start_at_a_change_point_chooses_by_the_wish():
    system = four_bar(1, 2, 1, 2)
    parallel = trace(system, "A", np.zeros(4), toward={"A": 1, "D": 1})
    crossed = trace(system, "A", np.zeros(4), toward={"A": 1, "D": -1})
    assert same_angle(parallel.values("A"), parallel.values("D")) < 1e-12
    assert same_angle(crossed.values("A"), crossed.values("D")) > 1.0
    assert parallel.closed and crossed.closed and parallel.singular_points[0].s == 0.0


@pytest.mark.parametrize("cranks", [3, 4])
def test_a_ladder_has_singular_points_without_branches(cranks):
    path = trace(ladder(cranks), "A1", {"A1": 0.7})
    assert path.closed and [e.kind for e in path.singular_points] == ["singular", "singular"]
    for e in path.singular_points:
        assert abs(math.sin(e.q[0])) < 1e-9
    assert same_angle(path.values("A1"), path.values("A3")) < 1e-12


@pytest.mark.slow
def test_two_parallelograms_flat_at_once_have_four_branches():
    system = two_parallelograms()
    paths = trace_branches(system, "A", np.zeros(system.nq))
    assert len(paths) == 4 and all(p.closed for p in paths)
    for p in paths:
        assert [(e.kind, e.nullity, len(e.directions)) for e in p.singular_points] == 2 * [
            ("bifurcation", 3, 4)
        ]
    kinds = set()
    for p in paths:
        names = system.coordinate_names
        kinds.add(
            tuple(same_angle(p.q[:, names.index("A")], p.q[:, names.index(n)]) < 1e-9 for n in "DE")
        )
    assert kinds == {(True, True), (True, False), (False, True), (False, False)}


def test_one_to_one_slider_crank_has_the_resting_slider_as_its_other_branch():
    paths = trace_branches(slider_crank(1.0, 1.0), "A", {"A": 0.7, "B": -1.4})
    moving, resting = paths
    np.testing.assert_allclose(moving.values("S"), 2 * np.cos(moving.values("A")), atol=1e-12)
    assert np.abs(resting.values("S")).max() < 1e-12 and resting.turns["A"] in (1, -1)
    assert [math.cos(e.q[0]) for e in moving.singular_points] == pytest.approx([0, 0], abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("gap", some([1e-4, 1e-6, 1e-8, 1e-10], 4))
def test_nearly_a_parallelogram_turns_the_corner(gap):
    """Branches that nearly meet do not cross: the coupler goes over from parallel to crossed and
    back.
    """
    path = trace(four_bar(1.0, 2.0 - gap, 1.0, 2.0), "A", [0.8, -0.8, 0.8, -0.8])
    assert path.closed and not path.singular_points
    A = path.values("A")
    D = path.values("D")
    assert same_angle(A, D) > 1.0
    parallel, crossed = trace_branches(four_bar(1, 2, 1, 2), "A", {"A": 0.8, "B": -0.8, "D": 0.8})
    # the corners cut off a length of order sqrt(gap); staying on one branch would miss 12
    assert path.length == pytest.approx(
        parallel.length + crossed.length, abs=20 * math.sqrt(gap) + 1e-5
    )
    B, C = pins(1.0, 2.0, A, D, 1.0)
    assert np.abs(np.linalg.norm(B - C, axis=1) - (2.0 - gap)).max() < 1e-12


def test_lengths_that_differ_by_rounding_cross():
    path = trace(four_bar(1.0, 2.0 - 1e-12, 1.0, 2.0), "A", [0.8, -0.8, 0.8, -0.8])
    assert [e.kind for e in path.singular_points] == ["bifurcation", "bifurcation"]


# ---- limits, other freedoms, ends


def test_ends_at_limits_are_exact_and_named():
    path = trace(slider_crank(1, 2, 0.3, limits=(1.5, 2.9)), "A", [0.7, -0.8, 0.0, 2.7])
    assert not path.closed and path.success
    assert path.ends == ("the upper limit 2.9 of 'S'", "the lower limit 1.5 of 'S'")
    S = path.values("S")
    assert (
        abs(S[0] - 2.9) < 1e-12
        and abs(S[-1] - 1.5) < 1e-12
        and S.min() > 1.5 - 1e-12
        and S.max() < 2.9 + 1e-12
    )
    free = trace(path.system, "A", path.q[0], limits=False)
    assert free.closed


def test_a_limit_that_is_only_touched_between_two_steps_is_found():
    top = math.sqrt(3.0**2 - 0.3**2)
    path = trace(slider_crank(1, 2, 0.3, limits=(0.0, top - 1e-7)), "A", [1.4, -1.5, 0.0, 2.0])
    assert not path.closed and all("2.98" in e for e in path.ends)
    touching = trace(slider_crank(1, 2, 0.3, limits=(0.0, top + 1e-7)), "A", [1.4, -1.5, 0.0, 2.0])
    assert touching.closed


def test_start_outside_limits_and_open_loops_are_answers():
    path = trace(slider_crank(1, 2, 0.3, limits=(0.0, 2.5)), "A", [0.1, -0.2, 0.0, 2.9])
    assert not path and "'S' is outside its limits" in path.status and len(path) == 1
    path = trace(four_bar(1, 1, 1, 9), "A")
    assert not path.success and "do not close" in str(path)


def five_bar():
    points = {"A": (0.0, 0.0), "B": (-0.5, 1.0), "C": (0.9, 1.8), "D": (2.2, 1.1), "E": (2.0, 0.0)}
    return linkage(
        "five-bar",
        points,
        {
            "ground": ("A", "E"),
            "a": ("A", "B"),
            "b": ("B", "C"),
            "c": ("C", "D"),
            "d": ("D", "E"),
        },
    )


def test_more_freedoms_are_refused_by_name_or_held():
    system = five_bar()
    with pytest.raises(UnsupportedError, match=r"2 freedoms.*'A' held still.*'E'"):
        trace(system, "A", np.zeros(5))
    path = trace(system, "A", np.zeros(5), hold={"E": 0.1})
    assert path.closed and np.abs(path.values("E") - 0.1).max() < 1e-14 and path.held == ("E",)
    B = path.curve("B*")
    D = path.curve("D*")
    C = path.curve("C*")
    assert (
        np.ptp(np.linalg.norm(C - B, axis=1)) < 1e-13
        and np.ptp(np.linalg.norm(C - D, axis=1)) < 1e-13
    )


def test_a_rigid_frame_cannot_move():
    rigid = linkage(
        "triangle",
        {"A": (0.0, 0.0), "B": (1.0, 0.0), "C": (0.4, 0.9)},
        {"ground": ("A", "B"), "a": ("A", "C"), "b": ("B", "C")},
    )
    path = trace(rigid, start=np.zeros(3))
    assert len(path) == 1 and path.success and "cannot move" in path.ends[0]


def test_a_shaky_structure_is_not_walked_but_what_swings_beside_it_is():
    flat = {"A": (0.0, 0.0), "B": (1.0, 0.0), "C": (2.5, 0.0)}
    links = {"ground": ("A", "C"), "a": ("A", "B"), "b": ("B", "C")}
    path = trace(linkage("flat triangle", flat, links), start=np.zeros(3))
    assert len(path) == 1 and "shaky" in path.status
    m = linkage("flat triangle", flat, links).mechanism
    m.revolute("P", m.ground, m.body("pendulum"), at=(0, 3))
    swings = trace(m.build(), "P", np.zeros(4))
    assert swings.closed and np.abs(swings.q[:, :3]).max() < 1e-12
    assert np.ptp(swings.q[:, 3]) == pytest.approx(2 * np.pi)


def test_paths_are_picklable_and_frozen():
    path = trace(four_bar(1, 2.5, 2, 3), "A", {"A": 0.5})
    again = pickle.loads(pickle.dumps(path))
    np.testing.assert_array_equal(again.q, path.q)
    np.testing.assert_array_equal(again.at(1.0), path.at(1.0))
    with pytest.raises(AttributeError):
        path.closed = False  # type: ignore[misc]


def test_an_interrupt_returns_what_was_done():
    def stop(points, length):
        if points > 40:
            raise KeyboardInterrupt

    path = call_until_interrupt(
        trace, four_bar(1, 2.5, 2, 3), "A", {"A": 0.5}, budget=kempe.Budget(progress=stop)
    )
    assert path.interrupted and not path and 30 < len(path) < 80 and "interrupted" in path.status
    assert np.abs(compute_residual(path.system, path.q)).max() < 1e-13


def test_a_gear_brings_the_path_back_after_whole_periods():
    """A second crank turns by 1.5 of the first: all is as before after two turns of it."""
    m = four_bar(1, 2.5, 2, 3).mechanism
    m.revolute("G", m.ground, m.body("wheel"), at=(-2, 0))
    m.gear("G", "A", 1.5)
    path = trace(m.build(), "A", {"A": 0.5})
    assert path.closed and path.turns["A"] == 2


def test_names_are_checked():
    system = four_bar(1, 2.5, 2, 3)
    with pytest.raises(UnknownNameError, match="crankk"):
        trace(system, "crankk")
    with pytest.raises(UnknownNameError):
        trace(system, "A", hold={"nothing": 1.0})
    nan = float("nan")
    for bad in (
        {"budget": kempe.Budget(step=0.0)},
        {"budget": kempe.Budget(step=nan)},
        {"budget": kempe.Budget(points=1)},
        {"start": [0.0, 1.0]},
        {"start": [nan] * 4},
    ):
        with pytest.raises(InputError):
            trace(system, "A", **bad)
    path = trace(system, "A", {"A": 0.5}, budget=kempe.Budget(points=20))
    assert not path.closed and "20 points" in path.status


# ---- what a path knows


def test_arc_length_points_in_between_and_tables():
    path = replace(trace(four_bar(1, 2.5, 2, 3, tracer=(1.0, 0.5)), "A", {"A": 0.5}), frames=("P",))
    even = path.resample(501)
    assert len(even) == 501 and np.abs(compute_residual(path.system, even.q)).max() < 1e-13
    chords = np.linalg.norm(np.diff(even.q, axis=0), axis=1)  # all coordinates are angles
    np.testing.assert_allclose(chords, path.length / 500, rtol=2e-4)
    # the length itself, by chords of two finenesses (Richardson)
    coarse, fine = (
        np.linalg.norm(np.diff(path.resample(n).q, axis=0), axis=1).sum() for n in (1001, 2001)
    )
    assert path.length == pytest.approx(fine + (fine - coarse) / 3, abs=2e-5)
    q = path.at([0.0, path.length, -1.0, path.length - 1.0])
    np.testing.assert_allclose(q[1] - q[0], path.q[-1] - path.q[0], atol=1e-15)
    np.testing.assert_allclose(q[3] - q[2], path.q[-1] - path.q[0], atol=1e-9)
    names, table = path.table()
    assert names == ["s", "A", "B", "D", "C", "P.x", "P.y"] and table.shape == (len(path), 7)
    np.testing.assert_array_equal(table[:, 5:], path.curve("P")[:, :2])
    assert path.curve("P", poses=True).shape == (len(path), 4, 4)
    assert "<table>" in path._repr_html_() and "closed curve" in str(path)
    with pytest.raises(InputError):
        path.resample(1)
    with pytest.raises(InputError):
        path.at(float("nan"))


def test_points_near_a_change_point_are_on_the_branch():
    path = trace(four_bar(1, 2, 1, 2), "A", {"A": 0.8, "B": -0.8, "D": 0.8})
    s = path.singular_points[0].s
    q = path.at(s + np.array([-1e-3, -1e-5, -1e-7, -1e-9, 0.0, 1e-9, 1e-7, 1e-5, 1e-3]))
    assert np.abs(q[:, 0] - q[:, 2]).max() < 1e-11 and np.abs(q[:, 0] + q[:, 1]).max() < 1e-11


@pytest.mark.slow
@settings(max_examples=examples(12))
@given(
    st.lists(st.floats(0.6, 3.0), min_size=4, max_size=4),
    st.floats(0.0, 6.0),
    st.floats(0.02, 0.12),
    st.floats(-3, 3),
)
def test_paths_depend_neither_on_start_step_nor_unit(lengths, place, step, scale):
    a, b, c, d = lengths
    grashof = [a + b - c - d, a + c - b - d, a + d - b - c]
    # near a change point the branch is long and bent: tested elsewhere
    assume(min(map(abs, grashof)) >= 0.02)
    assume(2 * max(lengths) < sum(lengths))  # it can be closed
    path = trace(four_bar(a, b, c, d), "A")
    assert path and path.closed
    other = trace(four_bar(a, b, c, d), "A", path.at(place), budget=kempe.Budget(step=step))
    assert other.closed and other.length == pytest.approx(path.length, rel=1e-4)
    k = 10.0**scale
    large = trace(four_bar(k * a, k * b, k * c, k * d), "A", path.q[0])
    assert large.length == pytest.approx(path.length, rel=1e-6)
    assert [e.value for e in large.turning_points] == pytest.approx(
        [e.value for e in path.turning_points], abs=1e-9
    )


def test_a_branch_closes_where_limits_are_not_looked_at():
    m = four_bar(0.1, 0.5, 0.4, 0.4).mechanism
    m.joints.pop("A")
    m.revolute("A", m.ground, "crank", limits=(-1, 1))
    path = m.build().trace("A", {"A": 0.0}, limits=False)
    assert path.closed and path.turns["A"] == 1 and len(path) < 200


def test_points_allowed_are_all_points():
    path = kempe.load("four_bar").trace("A", budget=kempe.Budget(points=7))
    assert len(path) == 7 and path.ends == ("the start", "the 7 points allowed")


@pytest.mark.parametrize("wrong", [{"step": "x"}, {"points": "x"}, {"points": 2.5}])
def test_bad_budgets_of_a_trace_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        kempe.load("four_bar").trace("A", budget=kempe.Budget(**wrong))


@pytest.mark.parametrize("rate", [np.nan, "x"])
def test_bad_rates_of_a_trace_are_refused(rate):
    with pytest.raises(InputError, match="toward"):
        kempe.load("four_bar").trace("A", toward={"A": rate})


def test_what_has_no_coordinates_does_not_move():
    m = Mechanism("nothing", dim=2)
    assert len(m.build().trace()) == 1
    m.fixed("F", m.ground, m.body("block"))
    assert "cannot move" in m.build().trace().status


def test_a_trace_without_a_start_begins_where_one_sided_constraints_hold():
    m = kempe.Mechanism("slot", dim=2)
    crank = m.body("crank")
    link = m.body("link")
    m.revolute("A", m.ground, crank)
    m.revolute("B", m.ground, link, at=(0.5, 0))
    m.frame("pin", crank, at=(0.3, 0))
    m.point_on_line("slot", link, "pin", axis=(1, 0))
    m.constrain(kempe.constraints.InBox("pin", [0.1, -1], [0.75, 1], other=link), "ends")
    system = m.build()
    path = system.trace()
    pins = np.linalg.inv(system.fk(path.q, "link")) @ system.fk(path.q, "pin")
    assert (
        path
        and path.length > 5.0
        and pins[:, 0, 3].min() > 0.1 - 1e-9
        and pins[:, 0, 3].max() < 0.75 + 1e-9
    )
    assert all("'ends x, upper end'" in end for end in path.ends)
    assert not system.trace(start=system.neutral), "a start that is given is taken as it is"


def test_bounds_that_are_not_approached_cost_no_search(monkeypatch):
    """A bound is looked for between two points only where the quantity can have its largest value
    in between.
    """
    counted = []
    whole = events.find_root
    monkeypatch.setattr(events, "find_root", lambda *given: counted.append(1) or whole(*given))
    m = kempe.Mechanism("slot", dim=2)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("B", m.ground, m.body("link"), at=(0.5, 0))
    m.frame("pin", "crank", at=(0.3, 0))
    m.point_on_line("slot", "link", "pin", axis=(1, 0))
    m.constrain(kempe.constraints.InBox("pin", [0.1, -1], [0.75, 1], other="link"), "ends")
    path = m.build().trace()
    assert len(path) > 50 and len(counted) < 10


# ---- cusps, and branches that touch


def slides(law: str, size: float = math.inf) -> kempe.System:
    m = Mechanism("slides", dim=2)
    m.prismatic("x", m.ground, m.body("a"), axis=(1.0, 0.0), limits=(-size, size))
    m.prismatic("y", "a", m.body("b"), axis=(0.0, 1.0), limits=(-size, size))
    m.equation("law", law, of=("x", "y"))
    return m.build()


CLOSED = {  # an implicit equation, points on it, its length, and its cusps
    "deltoid": ("(x^2+y^2)^2 + 18*(x^2+y^2) - 27 - 8*(x^3-3*x*y^2)", [(-1.0, 0.0), (3.0, 0.0)], 16.0,
                [(3.0, 0.0), (-1.5, 1.5 * 3**0.5), (-1.5, -1.5 * 3**0.5)]),
    "astroid": ("(x^2+y^2-1)^3 + 27*x^2*y^2", [(8**-0.5, 8**-0.5), (0.0, 1.0)], 6.0,
                [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]),
    "cardioid": ("(x^2+y^2-x)^2 - x^2 - y^2", [(2.0, 0.0), (0.0, 0.0)], 8.0, [(0.0, 0.0)]),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("at", [0, 1], ids=["beside", "at a cusp"])
@pytest.mark.parametrize("name", CLOSED)
def test_curves_with_cusps_close_with_their_published_length(name, at):
    law, points, length, cusps = CLOSED[name]
    path = slides(law).trace(start=list(points[at]))
    assert path.closed and path.length == pytest.approx(length / path.unit_length, rel=2e-5)
    assert [e.kind for e in path.singular_points] == ["cusp"] * len(cusps)
    for cusp in cusps:
        assert min(np.linalg.norm(e.q - cusp) for e in path.singular_points) < 1e-5
    middle = path.at(np.linspace(0.0, path.length, 500))
    assert np.abs(compute_residual(path.system, middle)).max() < 1e-11
    assert np.linalg.norm(np.diff(middle, axis=0), axis=1).max() < 1.05 * length / 499


GERMS = {  # branches (x, y) of a parameter in [-1, 1], and the equation u, v that they fulfil
    "cusp": ("v^2-u^3", [(2, 3, 1)]), "sharp cusp": ("v^2-u^5", [(2, 5, 1)]), "cubic": ("v^3-u^4", [(3, 4, 1)]),
    "tacnode": ("(v-u^2)*(v+u^2)", [(1, 2, 1), (1, 2, -1)]), "inflection": ("v*(v-u^3)", [(1, 1, 0), (1, 3, 1)]),
    "close": ("v*(v-u^4)", [(1, 1, 0), (1, 4, 1)]), "cusp and line": ("v*(v^2-u^3)", [(2, 3, 1), (1, 1, 0)]),
    "two cusps": ("(v^2-u^3)*(v^2-4*u^3)", [(2, 3, 1), (2, 3, 2)]),
    "three": ("(v-u^2)*(v-2*u^2)*(v+u^2)", [(1, 2, 1), (1, 2, 2), (1, 2, -1)]),
    "node": ("(v-u)*(v+u)", [(1, 1, 1), (1, 1, -1)]), "node of cubes": ("u*(u^2-3*v^2)", [
        (1, 1, 3**-0.5), (1, 1, -(3**-0.5)), (0, 1, 1)]),
}  # fmt: skip


ELSEWHERE = ("cusp", "cubic", "tacnode", "close", "node")
"""Germs through which a walk from elsewhere stays on its branch; at others it may change to another
one, or end."""


def germ_case(name: str, rng: np.random.Generator) -> tuple[kempe.System, list[np.ndarray]]:
    """Slides on a germ in axes that are turned, scaled and bent, and its branches (n, 2) sampled
    finely.
    """
    law, powers = GERMS[name]
    turn = rng.uniform(-math.pi, math.pi)
    scale = 10.0 ** rng.uniform(-0.2, 0.2)
    bent = rng.uniform(-0.3, 0.3)
    c = scale * math.cos(turn)
    s = scale * math.sin(turn)
    u = f"({c!r}*x+{s!r}*y)"
    v = f"({-s!r}*x+{c!r}*y+{bent!r}*{u}^2)"
    system = slides(law.replace("u", "@").replace("v", v).replace("@", u), 0.4 / scale)
    t = np.linspace(-1.0, 1.0, 4001)
    branches = []
    for m, n, k in powers:
        p = t**m if m else 0.0 * t
        q = k * t**n - bent * p * p
        branches.append(np.stack([c * p - s * q, s * p + c * q], axis=1) / scale**2)
    return system, branches


def assert_germ(name: str, rng: np.random.Generator) -> None:
    """All branches are found, each once, from the point where they meet and from elsewhere, and
    none is left.
    """
    system, branches = germ_case(name, rng)
    paths = [system.trace(start=[0.0, 0.0], ways="branches")]
    paths = [replace(paths[0], others=()), *paths[0].others]
    assert len(paths) == len(branches), (name, len(paths))
    own = []
    for path in paths:
        off = [np.min(np.linalg.norm(b - path.q[:, None], axis=2), axis=1).max() for b in branches]
        assert np.sort(off)[0] < 2e-3 and "limit" in path.ends[0] and "limit" in path.ends[1], (
            name,
            off,
            path.ends,
        )
        own.append(int(np.argmin(off)))
        q = path.q[3]
        if name in ELSEWHERE and np.linalg.norm(q) > 0.2:
            again = system.trace(start=q)
            assert again.length == pytest.approx(path.length, rel=1e-4), (name, again.status)
    assert sorted(own) == list(range(len(branches))), (name, own)


@pytest.mark.parametrize("name", ["cusp", "tacnode"])
def test_a_node_at_a_singular_point_stays_on_its_germ_when_reversed(name):
    system, _ = germ_case(name, np.random.default_rng(3))
    germ = find_germ(Closure(system), np.zeros(2))
    for half, partner in enumerate(germ.partner):
        node = germ.make_node(half)
        back = node.reverse_direction()
        assert isinstance(back, SingularNode) and back.half == partner and back.germ is germ
        np.testing.assert_array_equal(back.t, -node.t)


@pytest.mark.parametrize("name", GERMS)
def test_branches_of_a_germ_are_followed_through_it(name, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(4)):
        assert_germ(name, rng)


@pytest.mark.slow
@pytest.mark.parametrize("name", GERMS)
def test_branches_of_a_germ_are_followed_through_it_often(name, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(90)):
        assert_germ(name, rng)


@pytest.mark.slow
@pytest.mark.parametrize(("second", "turned"), [(1.0, True), (0.6, False), (1.7, False)])
def test_two_linkages_of_watt_are_traced_through_their_cusp(second, turned):
    """From the cusp and from elsewhere it is the same closed curve; the bar's turn says on which
    side.
    """
    system, q = double_watt(second, turned)
    path = system.trace(start=q)
    (event,) = path.singular_points
    assert path.closed and event.kind == "cusp" and not np.any(event.q)
    again = system.trace(start=path.at(0.4 * path.length))
    (other,) = again.singular_points
    assert (
        again.closed
        and again.length == pytest.approx(path.length, abs=1e-4)
        and other.kind == "cusp"
    )
    assert np.abs(other.q - 2 * np.pi * np.round(other.q / (2 * np.pi))).max() < 1e-4
    beside = path.at(np.array([0.3, path.length - 0.3]))
    turn = beside[:, [system.coordinate_names.index(n) for n in ("o1", "l1", "m1")]].sum(axis=1)
    assert turn[0] * turn[1] < 0.0, (
        "the bar turns to one side before the cusp and to the other one after it"
    )


@pytest.mark.slow
def test_branches_that_touch_to_the_fourth_order_are_followed_apart():
    """Two equal linkages of Watt: the bar translates on one branch, and turns by a fourth power on
    the other one.
    """
    system, q = double_watt(1.0, False)
    path = system.trace(start=q, ways="branches")
    assert path.closed and len(path.others) == 1 and path.others[0].closed
    places = [system.coordinate_names.index(n) for n in ("o1", "l1", "m1")]
    turned = sorted(float(np.ptp(p.q[:, places].sum(axis=1))) for p in (path, *path.others))
    assert turned[0] < 1e-9 < 0.1 < turned[1]
    elsewhere = system.trace(start=path.at(0.3 * path.length))
    assert elsewhere.closed and elsewhere.length == pytest.approx(path.length, abs=1e-3)


# ---- points at which very many branches meet


def scissor_lift(stages):
    """Crossed bars of length 1, joined at their middles and ends; the foot slides on the ground."""
    m = Mechanism("scissor lift", dim=2)
    for k in range(stages):
        m.body(f"a{k}")
        m.body(f"b{k}")
    m.body("foot")
    m.revolute("base", "ground", "a0")
    m.prismatic("rail", "ground", "foot", axis=(1, 0))
    m.revolute("hinge", "foot", "b0")
    for k in range(stages):
        m.revolute(f"middle{k}", f"a{k}", f"b{k}", at=(0.5, 0), child_at=(0.5, 0))
        if k + 1 < stages:
            m.revolute(f"right{k}", f"a{k}", f"b{k + 1}", at=(1, 0))
            m.revolute(f"left{k}", f"b{k}", f"a{k + 1}", at=(1, 0))
    return m.build()


def test_a_scissor_lift_passes_straight_through_its_flat_states():
    """All bars of one side stay parallel, where half of 2^stages branches meet and where the lift is
    a line, in which each stage can turn.
    """
    stages = 7
    system = scissor_lift(stages)
    start = {"base": 0.6} | {f"middle{k}": np.pi - 1.2 for k in range(stages)}
    q = system.assemble({"rail": 0.8}, start=start).q
    path = system.trace(start=q)
    assert path.closed
    sides = [system.fk(path.q, f"{side}{k}")[:, :2, 0] for side in "ab" for k in range(stages)]
    for k in range(stages):
        np.testing.assert_allclose(sides[k], sides[0], atol=1e-9)
        np.testing.assert_allclose(sides[stages + k], sides[0] * (-1.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(path.q[:, 1], sides[0][:, 0], atol=1e-9)
    flat = [e for e in path.singular_points if abs(abs(e.q[1]) - 1.0) < 1e-6]
    assert [len(e.directions) for e in flat] == [2 ** (stages - 1)] * 2
    assert all(e.complete and e.nullity == stages for e in flat)


def test_of_very_many_branches_some_are_found_and_that_is_said():
    """A flat row of n parallelograms has 2^n branches."""
    system = row_of_four_bars(8)
    path = system.trace(start=system.assemble({"A0": 0.2}).q)
    assert path.closed
    event = path.singular_points[0]
    assert len(event.directions) == crossings.MOST_LINES and not event.complete
    assert f"{crossings.MOST_LINES} branches or more" in str(path)
    along = event.directions[0]
    cranks = [along[i] for i, n in enumerate(system.structure.velocity_names) if n[0] == "A"]
    assert np.ptp(cranks) < 1e-9 < abs(cranks[0])  # straight on: all cranks stay parallel


# ---- directions of branches from second order


def vanish_along(rng, d, count, forms):
    """Quadratic forms (forms, d, d), random but zero along `count` lines, and the lines (count, d)."""
    lines = rng.normal(size=(count, d))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    i, j = np.triu_indices(d)
    rows = lines[:, i] * lines[:, j]
    null = np.linalg.svd(rows)[2][count:]
    F = np.zeros((forms, d, d))
    F[:, i, j] = rng.normal(size=(forms, len(null))) @ null
    return 0.5 * (F + F.transpose(0, 2, 1)), lines


@pytest.mark.parametrize("d", [3, 4, 5])
def test_all_lines_along_which_forms_vanish_are_found(d, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(5)):
        F, lines = vanish_along(rng, d, d, d + 2)
        found, complete = crossings._solve_many_forms(F / np.abs(F).max(), TimeLimit(None))
        assert found.shape == (d, d) and complete
        np.testing.assert_allclose(np.abs(found @ lines.T).max(axis=0), 1.0, atol=1e-9)


def test_directions_of_branches_take_few_calls(monkeypatch):
    """Counted are solutions of linear equations: many starts make a step together."""
    calls = []
    solve = newton.solve_many_least_squares

    def count(A, b, level):
        calls.append(len(A))
        return solve(A, b, level)

    monkeypatch.setattr(newton, "solve_many_least_squares", count)
    F, _ = vanish_along(np.random.default_rng(0), 5, 5, 7)
    crossings._solve_many_forms(F / np.abs(F).max(), TimeLimit(None))
    assert sum(calls) > 40 * 2**5 and len(calls) <= 3 * 40
