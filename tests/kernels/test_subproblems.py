"""Subproblems: what they return satisfies their statement, at regular and at degenerate places."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from kempe import spatial
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer
from kempe.kernels.closed_form import arm_part, candidates, subproblems, wrist_part
from kempe.kernels.forward.table_layout import SLIDE, TURN

ANGLE = st.floats(-math.pi, math.pi)
SMALL = st.sampled_from([1e-3, 1e-6, 1e-8, 1e-10, 1e-12])


@numba.njit
def trig_roots(a, b, k):
    return subproblems.find_trig_roots(a, b, k)


@numba.njit
def align(h, u, v):
    return subproblems.find_aligning_turn(h, u, v)


@numba.njit
def cone_roots(k, h, n, w):
    return subproblems.find_cone_turns(k, h, n, w)


@numba.njit
def parabola_roots(a, b, k):
    return subproblems.find_parabola_roots(a, b, k)


@numba.njit
def quartic_roots(p, out):
    return candidates.find_quartic_roots(get_pointer(p), get_pointer(out))


@numba.njit
def one_unknown(slides, a, b, k, wide, out):
    return arm_part.solve_one_unknown(slides, a, b, k, wide, 0.0, get_pointer(out))


@numba.njit
def coupled(x_slides, z_slides, terms, work, x, z):
    return candidates.find_coupled_pairs(
        x_slides,
        z_slides,
        get_pointer(terms),
        advance_pointer(get_pointer(terms), 6),
        get_pointer(work),
        get_pointer(x),
        get_pointer(z),
    )


@numba.njit
def ball_triple(a, b, c, d, work, out):
    return wrist_part.find_ball_turns(
        a, b, c, get_pointer(d), 1e-5, get_pointer(work), get_pointer(out)
    )


@numba.njit
def planar_triple(kinds, a, oa, b, ob, c, oc, d, work, out):
    axes = (kinds[0], a, oa, kinds[1], b, ob, kinds[2], c, oc)
    return wrist_part.solve_planar_triple(
        *axes, get_pointer(d), 1e-5, get_pointer(work), get_pointer(out)
    )


def unit(v) -> tuple[float, float, float]:
    return tuple((np.asarray(v) / np.linalg.norm(v)).tolist())


def turn(h, angle: float) -> np.ndarray:
    return spatial.exp_so3(angle * np.asarray(h))


def gap(a: float, b: float) -> float:
    return abs((a - b + math.pi) % (2.0 * math.pi) - math.pi)


# ---- subproblem 4


@given(ANGLE, ANGLE, st.floats(1e-3, 1e3))
def test_a_circle_meets_a_line_twice(theta, direction, size):
    a = size * math.cos(direction)
    b = size * math.sin(direction)
    k = a * math.cos(theta) + b * math.sin(theta)
    c0, s0, c1, s1, _ = trig_roots(a, b, k)
    for c, s in ((c0, s0), (c1, s1)):
        assert a * c + b * s == pytest.approx(k, abs=4e-15 * size)
        assert c * c + s * s == pytest.approx(1.0, abs=1e-15)
    # a double root: half the digits
    assert min(gap(math.atan2(s0, c0), theta), gap(math.atan2(s1, c1), theta)) < 1e-7


def test_a_line_that_misses_the_circle_gives_the_nearest_point():
    c0, s0, c1, s1, d2 = trig_roots(3.0, 4.0, 5.0 * (1.0 + 1e-9))
    assert d2 < 0.0
    assert (c0, s0) == pytest.approx((0.6, 0.8), abs=1e-12) == (c1, s1)


# ---- subproblem 1


@given(ANGLE, ANGLE, SMALL)
def test_align_keeps_its_digits_near_the_axis(angle, about, off):
    """u and v a distance `off` from the axis: the angle between them is still right to 1e-16 / off."""
    h = unit([1.0, 2.0, -0.5])
    side = turn(h, about) @ np.cross(h, [0.0, 0.0, 1.0])
    u = np.asarray(h) + off * side
    v = turn(h, angle) @ u
    c, s, size = align(h, tuple(u), tuple(v))
    assert size == pytest.approx(off**2 * (side @ side), rel=1e-2)
    assert gap(math.atan2(s, c), angle) < 2e-15 / off


def test_align_on_the_axis_has_no_size():
    assert align((0.0, 0.0, 1.0), (0.0, 0.0, 2.0), (1.0, 0.0, 0.0))[2] == 0.0


# ---- the generalised Euler angles


@given(st.integers(0, 10**6), ANGLE)
def test_cone_finds_both_turns(seed, theta):
    rng = np.random.default_rng(seed)
    k, h, n = (unit(v) for v in rng.standard_normal((3, 3)))
    w = turn(h, theta) @ n
    w = turn(k, rng.uniform(-3.0, 3.0)) @ w  # any direction at the same angle with k
    c0, s0, c1, s1, d2 = cone_roots(k, h, n, unit(w))
    found = [math.atan2(s0, c0), math.atan2(s1, c1)]
    assert min(gap(x, theta) for x in found) < 1e-6
    if d2 > 1e-6:
        for x in found:
            assert np.dot(k, turn(h, x) @ n) == pytest.approx(np.dot(k, w), abs=1e-9)


@given(SMALL, ANGLE)
def test_cone_keeps_its_digits_where_wrists_are_singular(eps, about):
    """Axes at right angles, n turned by eps from k: cos(eps) would have lost half the digits."""
    k = (0.0, 0.0, 1.0)
    h = (0.0, 1.0, 0.0)
    n = (0.0, 0.0, 1.0)
    w = turn(k, about) @ turn(h, eps) @ n
    c0, s0, c1, s1, _ = cone_roots(k, h, n, tuple(w))
    assert sorted([math.atan2(s0, c0), math.atan2(s1, c1)]) == pytest.approx(
        [-eps, eps], rel=1e-9, abs=3e-16
    )


@pytest.mark.slow
@settings(max_examples=examples(60))
@given(st.integers(0, 10**6))
def test_a_rotation_is_three_turns_about_given_axes(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (unit(v) for v in rng.standard_normal((3, 3)))
    angles = rng.uniform(-np.pi, np.pi, 3)
    R = turn(a, angles[0]) @ turn(b, angles[1]) @ turn(c, angles[2])
    d = np.hstack([R, np.zeros((3, 1))]).ravel()
    out = np.empty(4 * 3 * arm_part.MOST)
    count = ball_triple(a, b, c, d, np.empty(4 * arm_part.MOST), out)
    assert count == 2
    values = out.reshape(-1, 3, 4)[:count, :, 2]
    for x in values:
        assert np.abs(turn(a, x[0]) @ turn(b, x[1]) @ turn(c, x[2]) - R).max() < 1e-7
    assert min(max(gap(p, q) for p, q in zip(x, angles, strict=True)) for x in values) < 1e-6


# ---- planar motions


@pytest.mark.slow
@settings(max_examples=examples(80))
@given(st.integers(0, 10**6), st.sampled_from(["RRR", "RRP", "RPR", "PRR", "RPP", "PRP", "PPR"]))
def test_a_planar_motion_is_three_joints_of_the_plane(seed, letters):
    rng = np.random.default_rng(seed)
    base = spatial.exp_so3(rng.standard_normal(3))
    kinds = np.array([TURN if x == "R" else SLIDE for x in letters])
    signs = rng.choice([-1.0, 1.0], 3)
    h = [
        signs[i] * base[:, 2] if kinds[i] == TURN else base[:, :2] @ unit(rng.standard_normal(2))
        for i in range(3)
    ]
    o = [base @ rng.standard_normal(3) for _ in range(3)]
    x = rng.uniform(-1.5, 1.5, 3)

    def motion(theta):
        T = np.eye(4)
        for kind, axis, point, t in zip(kinds, h, o, theta, strict=True):
            E = np.eye(4)
            if kind == SLIDE:
                E[:3, 3] = t * axis
            else:
                E[:3, :3] = turn(axis, t)
                E[:3, 3] = point - E[:3, :3] @ point
            T = T @ E
        return T

    d = motion(x)
    out = np.empty(4 * 3 * arm_part.MOST)
    lines = [tuple(v) for pair in zip(h, o, strict=True) for v in pair]
    count = planar_triple(kinds, *lines, d[:3].ravel().copy(), np.empty(4 * arm_part.MOST), out)
    found = out.reshape(-1, 3, 4)[:count, :, 2]
    assert 1 <= count <= 2
    for theta in found:
        assert np.abs(motion(theta) - d).max() < 1e-6
    off = [
        max(gap(t, y) if k == TURN else abs(t - y) for t, y, k in zip(theta, x, kinds, strict=True))
        for theta in found
    ]
    assert min(off) < 1e-6


# ---- polynomials, and two equations in two unknowns


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3).filter(lambda x: abs(x) > 1e-3))
def test_parabola(x, y, a):
    x0, x1, _ = parabola_roots(a, -a * (x + y), a * x * y)
    assert sorted([x0, x1]) == pytest.approx(sorted([x, y]), abs=1e-6)


def test_a_parabola_without_its_square_is_a_line():
    assert parabola_roots(0.0, 2.0, -3.0)[:2] == (1.5, 1.5)


@pytest.mark.slow
@given(st.lists(st.floats(-4, 4), min_size=4, max_size=4, unique=True))
def test_quartic(roots):
    p = np.polynomial.polynomial.polyfromroots(roots)
    out = np.empty(5)
    count = quartic_roots(p, out)
    spread = np.min(np.diff(np.sort(roots)))
    if spread > 1e-2:
        assert count == 4
        assert np.sort(out[:4]) == pytest.approx(np.sort(roots), abs=1e-7)


@pytest.mark.slow
def test_double_roots_of_a_quartic_are_two():
    out = np.empty(5)
    assert quartic_roots(np.polynomial.polynomial.polyfromroots([1.0, 1.0, -2.0, 3.0]), out) == 4
    assert np.sort(out[:4]) == pytest.approx([-2.0, 1.0, 1.0, 3.0], abs=1e-6)
    assert quartic_roots(np.array([1.0, 0.0, 0.0, 0.0, 1.0]), out) == 0


@pytest.mark.slow
@settings(max_examples=examples(80))
@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_coupled_equations_have_the_pair_that_they_were_made_of(seed, x_slides, z_slides):
    rng = np.random.default_rng(seed)
    terms = rng.standard_normal(12)
    x = rng.uniform(-1.5, 1.5)
    z = rng.uniform(-1.5, 1.5)

    def factors(slides, t):
        return np.array([1.0, t, t * t] if slides else [1.0, math.cos(t), math.sin(t)])

    left = terms[:6].reshape(2, 3)
    right = terms[6:].reshape(2, 3)
    right[:, 0] += left @ factors(x_slides, x) - right @ factors(z_slides, z)
    xs = np.empty(4 * arm_part.MOST)
    zs = np.empty(4 * arm_part.MOST)
    count = coupled(x_slides, z_slides, terms, np.empty(candidates.WORK), xs, zs)
    pairs = [(xs[4 * i + 2], zs[4 * i + 2]) for i in range(count)]
    assert count <= 4
    assert min(max(abs(p - x), abs(q - z)) for p, q in pairs) < 1e-5


# ---- an equation that says nothing


def test_an_equation_of_no_size_gives_samples_or_nothing():
    out = np.empty(4 * arm_part.MOST)
    assert one_unknown(False, 0.0, 0.0, 0.0, 1e-5, out) == arm_part.SAMPLES
    assert np.all(out.reshape(-1, 4)[: arm_part.SAMPLES, arm_part.SAMPLED] == 1.0)
    assert one_unknown(False, 0.0, 0.0, 1e-3, 1e-5, out) == 0
    # near to nothing: both roots, and samples
    assert one_unknown(False, 1e-11, 0.0, 0.0, 1e-5, out) == 2 + arm_part.SAMPLES
