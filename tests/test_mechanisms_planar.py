"""The planar mechanisms of the library are what their headers and the table say: counts, ranks,
motions, paths.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import atan2, pi

import numpy as np
import pytest
from hunts import some
from mechanisms import PLANAR, SINGULAR, Case, Motion, antiparallelogram_rocker, branches
from scipy.optimize import least_squares

import kempe
from kempe import System, library
from kempe.equations import closure_rows

CASES = [*PLANAR, *SINGULAR]
MOVING = [case for case in CASES if case.branches and branches(case.name)]
STILL = [case for case in CASES if case.true == 0]
LECTURE = {"seven_bodies_loop", "four_links"}


def solved(system: System, known: dict[str, float], near: np.ndarray) -> np.ndarray:
    """The configuration with these coordinates that closes the loops, next to another one."""
    names = list(system.coordinate_names)
    free = [i for i, name in enumerate(names) if name not in known]
    q = near.copy()
    q[[names.index(name) for name in known]] = list(known.values())

    def error(x: np.ndarray) -> np.ndarray:
        p = np.broadcast_to(q, (*x.shape[:-1], q.size)).copy()
        p[..., free] = x
        return system.loops.closure_error(p).reshape(*x.shape[:-1], -1)

    def slope(x: np.ndarray) -> np.ndarray:
        h = 1e-6 * np.eye(len(free))
        return (error(x + h) - error(x - h)).T / 2e-6

    answer = least_squares(error, q[free], slope, xtol=3e-16, ftol=3e-16, gtol=3e-16)  # pyright: ignore
    q[free] = answer.x
    np.testing.assert_allclose(system.loops.closure_error(q), 0.0, rtol=0, atol=1e-12)
    return q


def path(name: str, driver: str, angles: list[float], frame: str) -> list[complex]:
    """Places of a frame while a driver goes from `closed` through these values, as complex numbers."""
    system = kempe.load(name)
    q = system.q("closed")
    out = []
    for angle in angles:
        for part in np.linspace(system.q_dict(q)[driver], angle, 9)[1:]:
            q = solved(system, {driver: float(part)}, q)
        x, y = system.fk(q, frame)[:2, 3]
        out.append(complex(x, y))
    return out


def meet(p: complex, r: float, c: complex, s: float, side: int) -> complex:
    """Where two circles meet, to the left (+1) or to the right (-1) of the way from p to c."""
    d = abs(c - p)
    a = (r * r - s * s + d * d) / (2 * d)
    return p + (c - p) / d * complex(a, side * np.sqrt(r * r - a * a))


def turn(angle: float) -> complex:
    return complex(np.cos(angle), np.sin(angle))


def steps(degrees: list[float]) -> list[float]:
    return np.radians(degrees).tolist()


def assert_same_places(
    found: list[complex], expected: list[complex], tolerance: float = 1e-11
) -> None:
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


# ------------------------------------------------------------------ the table


def test_the_table_has_every_planar_mechanism_with_loops():
    names = [case.name for case in PLANAR]
    systems = {name: kempe.load(name) for name in library.list_models()}
    closed = {
        name for name, system in systems.items() if system.dim == 2 and system.structure.closures
    }
    assert len(set(names)) == len(names) and set(names) == closed - LECTURE


@pytest.mark.parametrize("name", [case.name for case in PLANAR])
def test_each_posture_is_in_the_table(name):
    postures = [case.posture for case in CASES if case.name == name]
    assert sorted(postures) == sorted(kempe.load(name).structure.posture_names)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_postures_are_closed(case: Case):
    system = kempe.load(case.name)
    q = system.q(case.posture)
    np.testing.assert_allclose(system.loops.closure_error(q), 0.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(closure_rows.compute_residual(system, q), 0.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_counts_and_what_the_files_say(case: Case):
    mechanism = kempe.load(case.name).mechanism
    freedoms = {"revolute": 1, "prismatic": 1}
    taken = sum(3 - freedoms[joint.type.type_name] for joint in mechanism.joints.values())
    bodies = [name for name in mechanism.bodies if name != "ground"]
    assert 3 * len(bodies) - taken == case.count
    text = library.find_model_file(case.name).read_text(encoding="utf-8")
    numbers = re.search(
        r"# Count in the plane: 3 \* (\d+) bodies - 2 \* (\d+) joints = (-?\d+).*DoF: (\d)", text
    )
    if case.name != "four_bar":  # it writes the count in another form
        assert numbers is not None
        assert tuple(map(int, numbers.groups())) == (
            len(bodies),
            len(mechanism.joints),
            case.count,
            case.true,
        )


def nullity(J: np.ndarray, tolerance: float) -> int:
    values = np.linalg.svd(J, compute_uv=False)
    return J.shape[1] - int((values > tolerance * values[0]).sum())


@pytest.mark.parametrize("case", CASES, ids=str)
def test_rank(case: Case):
    """By the Jacobian of the loops, and by central differences of their error."""
    system = kempe.load(case.name)
    q = system.q(case.posture)
    assert nullity(closure_rows.compute_jacobian(system, q), 1e-9) == case.rank
    h = 1e-5 * np.eye(system.nv)
    ahead = system.loops.closure_error(system.configuration_space.integrate(q, h))
    behind = system.loops.closure_error(system.configuration_space.integrate(q, -h))
    assert nullity(((ahead - behind) / 2e-5).reshape(system.nv, -1).T, 1e-6) == case.rank


@pytest.mark.parametrize(
    "case", [case for case in CASES if not case.branches and case.rank == case.count], ids=str
)
def test_full_rank_is_the_truth(case: Case):
    """Where the constraints of the count are independent, the implicit function theorem gives the
    dimension.
    """
    assert case.true == case.rank


@pytest.mark.parametrize("case", MOVING, ids=str)
def test_motions_through_singular_postures(case: Case):
    """They close far from the posture, start at it, have their dimension, and differ from each
    other.
    """
    system = kempe.load(case.name)
    q0 = system.q(case.posture)
    motions = branches(case.name)
    assert tuple(sorted((dim for dim, _ in motions), reverse=True)) == case.branches
    assert max(case.branches) == case.true
    rng = np.random.default_rng(1)
    J = closure_rows.compute_jacobian(system, q0)
    spans = []
    for dim, motion in motions:
        assert motion(*[0.0] * dim) == pytest.approx(system.q_dict(q0), abs=1e-15)
        for values in rng.uniform(-0.28, 0.28, (5, dim)):
            np.testing.assert_allclose(
                system.loops.closure_error(system.q(motion(*values))), 0.0, rtol=0, atol=1e-14
            )
        h = 1e-6 * np.eye(dim)
        tangents = np.array([system.q(motion(*e)) - system.q(motion(*-e)) for e in h]) / 2e-6
        np.testing.assert_allclose(J @ tangents.T, 0.0, rtol=0, atol=2e-9)
        assert np.linalg.matrix_rank(tangents, tol=1e-3) == dim
        spans.append(tangents)
    for i, one in enumerate(spans):
        for other in spans[:i]:
            assert np.linalg.matrix_rank(np.vstack([one, other]), tol=1e-3) > max(
                len(one), len(other)
            )


def projected(system: System, q: np.ndarray) -> np.ndarray:
    """A closed configuration next to an open one, by shortest Newton steps; many, since at shaky
    postures each step only halves the way, and does less at a cusp.
    """
    for _ in range(100):
        error = closure_rows.compute_residual(system, q)
        if np.abs(error).max() < 1e-16:
            break
        step = -np.linalg.lstsq(closure_rows.compute_jacobian(system, q), error, rcond=1e-12)[0]
        q = system.configuration_space.integrate(q, step)
    assert np.abs(closure_rows.compute_residual(system, q)).max() < 1e-7
    return q


def kicked(case: Case, size: float, n: int) -> Iterator[np.ndarray]:
    """Closed configurations next to a posture, from random steps along the null space of the
    Jacobian.
    """
    system = kempe.load(case.name)
    q = system.q(case.posture)
    kernel = np.linalg.svd(closure_rows.compute_jacobian(system, q))[2][system.nv - case.rank :]
    steps = np.random.default_rng(3).normal(size=(n, case.rank)) * size
    return (
        projected(system, system.configuration_space.integrate(q, step @ kernel)) for step in steps
    )


def from_motion(system: System, q: np.ndarray, dim: int, motion: Motion) -> float:
    """How far a configuration is from a motion of the table."""
    answer = least_squares(
        lambda x: system.configuration_space.difference(q, system.q(motion(*x))),
        np.zeros(dim),
        xtol=1e-15,
    )
    return float(np.abs(answer.fun).max())


@pytest.mark.parametrize("case", some([*MOVING, *STILL], 3), ids=str)
def test_nothing_else_moves_through_singular_postures(case: Case):
    """What random steps find is on one of the motions, and each motion is found; a structure does
    not move.
    """
    motions = branches(case.name) or [(1, lambda x: {})]
    system = kempe.load(case.name)
    least = 100 if len(motions) > 4 else 12
    hits: set[int] = set()
    # which are hit first depends on the basis of the null space
    for i, q in enumerate(kicked(case, 0.1, 4 * least)):
        if i >= least and len(hits) == len(motions):
            break
        distances = [from_motion(system, q, *motion) for motion in motions]
        assert min(distances) < 1e-4
        hits.add(int(np.argmin(distances)))
    assert len(hits) == len(motions)


def test_the_cusp_of_the_double_watt_linkage():
    """u^2 = (k L / 2) w^3 near the tip, u and w the difference and the sum of the heights of the
    two middles.
    """
    case = next(case for case in PLANAR if case.name == "double_watt")
    system = kempe.load(case.name)
    heights = np.array([system.fk(q, ["p1", "p2"])[:, 1, 3] for q in kicked(case, 0.1, 20)])
    u = heights[:, 1] - heights[:, 0]
    w = heights.sum(axis=1)
    away = w < -2e-3
    assert w.max() < 2e-3 and 5 < away.sum() < 20 and len(set(np.sign(u[away]))) == 2
    k = -0.06 / 0.08 / (2 * 0.2**2)
    np.testing.assert_allclose(u[away] ** 2 / w[away] ** 3, k * 0.4 / 2, rtol=0.25)


def test_points_of_the_two_kinds_of_motions_of_the_twelve_bar_linkage():
    system = kempe.load("wunderlich")
    motions = [motion for _, motion in branches("wunderlich")]
    assert motions[0](0.7, -0.4) == pytest.approx(system.q_dict(system.q("parallel")), abs=1e-15)
    assert motions[-1](0.15) == pytest.approx(system.q_dict(system.q("antiparallel")), abs=1e-15)


@pytest.mark.parametrize("name", ["shaky_3r", "pendulum_dead_centre"])
def test_the_shaky_structures_have_no_play(name):
    """The fixed points are as far apart as the two bars are long: the pin has one place."""
    joints = kempe.load(name).structure.joints
    numbers = kempe.load(name).structure.parameters
    ground = [joints[n].X_PF.evaluate_pose(numbers)[:3, 3] for n in "AC"]
    bars = [
        joints["B"].X_PF.evaluate_pose(numbers)[:3, 3],
        joints["C"].X_CM.evaluate_pose(numbers)[:3, 3],
    ]
    lengths = np.linalg.norm(bars, axis=1)
    assert np.linalg.norm(ground[1] - ground[0]) == pytest.approx(lengths.sum(), abs=1e-16)


# ------------------------------------------------------------------ one loop: closed forms


@pytest.mark.slow
def test_slider_crank():
    angles = steps([80, 130, 180, 250])
    found = path("slider_crank", "A", angles, "slider")
    assert_same_places(
        found, [0.1 * np.cos(t) + np.sqrt(0.09 - (0.1 * np.sin(t)) ** 2) for t in angles]
    )
    angles = steps([20, -30])
    assert_same_places(
        path("slider_crank_equal", "A", angles, "slider"), [0.4 * np.cos(t) for t in angles]
    )


@pytest.mark.slow
def test_trammel():
    feet = [0.4, 0.45, 0.2]
    tops = [np.sqrt(0.25 - x * x) for x in feet]
    middles = [complex(x, y) / 2 for x, y in zip(feet, tops, strict=True)]
    assert_same_places(path("ladder", "X", feet, "middle"), middles)
    pen = np.array(path("ladder", "X", feet, "pen"))
    np.testing.assert_allclose(
        (np.real(pen) / 0.75) ** 2 + (np.imag(pen) / 0.25) ** 2, 1.0, rtol=0, atol=1e-11
    )


@pytest.mark.slow
def test_parallelogram_and_antiparallelogram():
    angles = steps([70, 120, 160])
    circle = [0.1 * turn(t) + 0.15 + 0.05j for t in angles]
    assert_same_places(path("parallelogram", "A", angles, "coupler_point"), circle)
    crossed = [
        0.5 * (0.1 * turn(t) + 0.3 + 0.1 * turn(antiparallelogram_rocker(t))) for t in angles
    ]
    found = path("antiparallelogram", "A", angles, "coupler_point")
    assert_same_places(found, crossed)
    eight = np.array(found) - 0.15
    np.testing.assert_allclose(
        np.abs(eight) ** 2, 0.01 - 0.09 * np.sin(np.angle(eight)) ** 2, rtol=0, atol=1e-12
    )


def test_kite():
    """The free pin stays on the bisector of the crank's angle."""
    angles = steps([90, 120, 170])
    system = kempe.load("kite")
    for t in angles:
        q = solved(system, {"A": t}, system.q("closed"))
        X = system.fk(q, "rocker") @ [0.3, 0, 0, 1]
        assert atan2(X[1], X[0]) == pytest.approx(t / 2, abs=1e-11)


@pytest.mark.slow
def test_straight_line_four_bars_touch_their_line():
    """Chebyshev: heights 4 at x = 2, 0 and 4; Hoecken: at 90, 180 and 270 degrees; both at most
    0.01 off in between.
    """
    left = kempe.load("chebyshev").q("closed")[0] + np.linspace(0, pi / 2 - np.arcsin(0.8), 9)
    found = np.array(path("chebyshev", "A", left.tolist(), "P")) * 10
    np.testing.assert_allclose(found[[0, -1]], [2 + 4j, 4j], rtol=0, atol=1e-10)
    assert 0.005 < np.abs(np.imag(found) - 4).max() < 0.01
    found = np.array(path("hoeken", "A", np.linspace(pi / 2, 1.5 * pi, 9).tolist(), "P")) * 10
    np.testing.assert_allclose(found[[0, 4, 8]], [4 + 4j, 2 + 4j, 4j], rtol=0, atol=1e-10)
    assert 0.005 < np.abs(np.imag(found) - 4).max() < 0.01


@pytest.mark.slow
def test_evans():
    """Scott Russell's end point to 0.3 mm over a stroke of half a metre."""
    angles = steps([30, 15, 0, -15, -30])
    found = np.array(path("evans", "A", angles, "P"))
    assert np.abs(np.real(found)).max() < 3e-4
    np.testing.assert_allclose(np.imag(found), 0.5 * np.sin(angles), rtol=0, atol=3e-3)
    expected = []
    for t in angles:
        B = 0.25 * turn(t)
        expected.append(2 * B - meet(B, 0.25, 0.442 + 1j, 1.0, -1))
    assert_same_places(found.tolist(), expected)


@pytest.mark.slow
def test_watt_curve():
    """The polar equation of Watt's curve, squared so that both signs fit."""
    a = 0.13
    b = 0.12
    c = 0.05
    points = np.array(path("watt_straight", "A", steps([20, 10, -10, -40]), "P")) - a
    r = np.abs(points)
    t = np.angle(points)
    s = c * c - (a * np.cos(t)) ** 2
    wanted = (a * np.sin(t)) ** 2 + s
    np.testing.assert_allclose(
        (b * b - r * r - wanted) ** 2, 4 * (a * np.sin(t)) ** 2 * s, rtol=0, atol=1e-14
    )


# ------------------------------------------------------------------ more loops


def test_five_bar():
    system = kempe.load("five_bar")
    for t1, t2 in (steps([120, 40]), steps([150, 80]), steps([95, 30])):
        q = solved(system, {"A": t1, "D": t2}, system.q("closed"))
        x, y = system.fk(q, "tip")[:2, 3]
        assert_same_places(
            [complex(x, y)], [meet(0.2 * turn(t1), 0.3, 0.2 + 0.2 * turn(t2), 0.3, 1)]
        )


@pytest.mark.slow
def test_double_parallelogram_and_row_move():
    angles = steps([80, 130, -40])
    circle = [0.2 * turn(t) + 0.3 + 0.1j for t in angles]
    assert_same_places(path("double_parallelogram", "A1", angles, "coupler_point"), circle)
    angles = steps([80, 110])
    assert_same_places(path("row_of_four_bars", "A0", angles, "end"), [3 + turn(t) for t in angles])


@pytest.mark.slow
def test_scissor():
    slides = [0.3, 0.2, 0.45]
    assert_same_places(
        path("scissor", "S", slides, "load"), [0.25 + 2j * np.sqrt(0.25 - s * s) for s in slides]
    )


@pytest.mark.slow
def test_peaucellier_is_straight():
    """x = (OA^2 - AC^2) / (2 OQ) = 3.22; O, C and D are on a line, whose angle is half of the
    crank's.
    """
    angles = steps([60, 80, 55, 30, 0, -30, -60, -80])
    found = path("peaucellier", "Q", angles, "D_point")
    assert_same_places(found, [complex(3.22, 3.22 * np.tan(t / 2)) for t in angles])


def watt_six_bar(t: float) -> complex:
    B = 0.1 * turn(t)
    C = meet(B, 0.35, 0.35, 0.25, 1)
    E = 0.35 + 0.2 * (C - 0.35) / abs(C - 0.35) * turn(-1.2)
    return meet(E, 0.3, 0.7, 0.2, 1)


def stephenson_six_bar(t: float) -> complex:
    B = 0.1 * turn(t)
    C = meet(B, 0.3, 0.35, 0.3, 1)
    return B + (C - B) / abs(C - B) * (0.2 + 0.15j)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, frame, chain",
    [
        ("watt_six_bar", "output", watt_six_bar),
        ("stephenson_six_bar", "coupler_point", stephenson_six_bar),
    ],
)
def test_six_bars_turn_fully(name, frame, chain):
    start = kempe.load(name).q("closed")[0]
    angles = (start + np.linspace(0, 2 * pi, 13)).tolist()
    assert_same_places(path(name, "A", angles, frame), [chain(t) for t in angles])


def jansen(t: float) -> complex:
    b = 41.5
    c = 39.3
    d = 40.1
    e = 55.8
    f = 39.4
    g = 36.7
    h = 65.7
    i = 49.0
    j = 50.0
    k = 61.9
    pin = 15 * turn(t)
    fixed = -38 - 7.8j
    upper = meet(fixed, b, pin, j, 1)
    lower = meet(fixed, c, pin, k, -1)
    outer = meet(fixed, d, upper, e, 1)
    knee = meet(outer, f, lower, g, -1)
    return meet(knee, h, lower, i, -1) / 100


@pytest.mark.slow
def test_jansen_walks():
    """Circles that meet; the foot stays within 1 mm (of 92 cm) over 90 degrees of the crank, then
    it is lifted.
    """
    angles = np.radians(np.arange(0, 361, 20))
    foot = path("jansen", "O", angles.tolist(), "foot")
    assert_same_places(foot, [jansen(t) for t in angles])
    path_ = np.array([jansen(t) for t in np.radians(np.arange(0, 360))])
    flat = path_[np.arange(-45, 46)]
    assert np.ptp(np.imag(flat)) < 1e-3 and np.ptp(np.real(flat)) > 0.35
    assert np.imag(flat).min() == np.imag(path_).min() and np.ptp(np.imag(path_)) > 0.2


def klann(t: float) -> complex:
    p9 = 1.366 + 1.366j
    p11 = 1.009 + 0.574j
    p15 = 1.599 + 0.75j
    p27 = 0.741 + 0.75j
    p29 = 1.331 + 0.75j
    p35 = 0.232 + 0.866j
    p37 = 0.866 + 1.5j
    pin = p15 + (p29 - p15) * turn(t)
    elbow = meet(p11, abs(p27 - p11), pin, abs(p29 - p27), 1)
    knee = pin + (elbow - pin) * (p35 - p29) / (p27 - p29)
    hip = meet(p9, abs(p37 - p9), knee, abs(p37 - p35), -1)
    return knee + (hip - knee) * (0 - p35) / (p37 - p35)


@pytest.mark.slow
def test_klann_walks():
    """At a turn of 0 the foot is at the origin of the patent's table; half a turn later it has gone
    one unit.
    """
    angles = np.radians(np.arange(0, 361, 20))
    foot = path("klann", "P15", angles.tolist(), "foot")
    assert_same_places(foot, [klann(t) for t in angles])
    assert abs(foot[0]) < 1e-15 and abs(foot[9] - 1) < 2e-3


def test_andrews_squeezer():
    """The six position equations of Hairer and Wanner, at their initial values and after turning
    the crank.
    """
    system = kempe.load("andrews_squeezer")
    c = system.structure.parameters
    q = system.q("closed")
    for beta in (q[0], 0.1, 0.4):
        q = solved(system, {"beta": beta}, q)
        v = system.q_dict(q)
        pin = c["rr"] * turn(v["beta"]) - c["d"] * turn(v["beta"] + v["theta"])
        gamma = turn(v["gamma"])
        delta = turn(v["delta"])
        epsilon = turn(v["epsilon"])
        B = complex(c["xb"], c["yb"])
        A = complex(c["xa"], c["ya"])
        assert_same_places(
            [
                pin + 1j * c["ss"] * gamma,
                pin + 1j * c["e"] * turn(v["phi"]) * delta - c["zt"] * delta,
                pin - c["zf"] * turn(v["omega"]) * epsilon + 1j * c["u"] * epsilon,
            ],
            [B, A, A],
            1e-12,
        )


# ------------------------------------------------------------------ parallel robots


@pytest.mark.parametrize("x, y, w", [(0.03, 0.02, 0.2), (-0.04, 0.03, 0.35), (0.0, -0.05, 0.5)])
def test_parallel_robots_reach_poses_by_closed_forms(x, y, w):
    corners = [turn(2 * pi * k / 3) for k in range(3)]
    ends = [complex(x, y) + 0.15 * turn(w) * corner for corner in corners]
    rrr = {}
    rpr = {}
    for k, (corner, end) in enumerate(zip(corners, ends, strict=True), 1):
        elbow = meet(0.5 * corner, 0.25, end, 0.3, 1)
        rrr[f"A{k}"] = float(np.angle(elbow - 0.5 * corner))
        rpr[f"S{k}"] = abs(end - 0.5 * corner)
    for name, known in (("three_rrr", rrr), ("three_rpr", rpr)):
        system = kempe.load(name)
        q = system.q("closed")
        start = system.q_dict(q)
        for part in (0.25, 0.5, 0.75, 1.0):
            q = solved(
                system, {n: start[n] + part * (value - start[n]) for n, value in known.items()}, q
            )
        X = system.fk(q, "tool")
        np.testing.assert_allclose(
            [*X[:2, 3], atan2(X[1, 0], X[0, 0])], [x, y, w], rtol=0, atol=1e-10
        )


@pytest.mark.parametrize(
    "name, posture, free",
    [
        ("three_rrr", "closed", 0),
        ("three_rpr", "closed", 0),
        ("three_rpr", "concurrent", 1),
        ("five_bar", "closed", 0),
    ],
)
def test_actuators_hold_the_platform(name, posture, free):
    """Motions left when the actuated joints stand still: the legs' lines of the untwisted 3-RPR
    meet in a point.
    """
    system = kempe.load(name)
    J = closure_rows.compute_jacobian(system, system.q(posture))
    passive = [
        i
        for i, n in enumerate(system.structure.velocity_names)
        if not system.structure.joints[n].actuated
    ]
    assert nullity(J[:, passive], 1e-9) == free
