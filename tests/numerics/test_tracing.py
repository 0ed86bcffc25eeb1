"""The tracer against curves in closed form: circles, ellipses, helices, crossings, ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some
from scipy.special import ellipe

from kempe.numerics import curves
from kempe.numerics.curves import (
    BEND,
    Curve,
    Node,
    compute_bend_angle,
    correct_point,
    estimate_arc_length,
    find_next_node,
    find_node_between,
    is_determinant_flipped,
    make_node,
    walk_curve,
)


class Implicit(Curve):
    """Where functions of n numbers vanish; `f` gives them and their derivatives."""

    def __init__(self, n, f):
        self.n = n
        self.f = f

    def evaluate_equations(self, x):
        F, J = self.f(x)
        more = max(self.n - len(F), 0)
        return np.append(F, np.zeros(more)), np.append(J, np.zeros((more, self.n)), axis=0)


def ellipse(a, b):
    return Implicit(
        2,
        lambda x: (
            np.array([(x[0] / a) ** 2 + (x[1] / b) ** 2 - 1.0]),
            np.array([[2.0 * x[0] / a**2, 2.0 * x[1] / b**2]]),
        ),
    )


def traced(curve, x, toward, longest, most=100_000, **more):
    nodes = [make_node(curve, np.asarray(x, dtype=float), np.asarray(toward, dtype=float))]

    def taken(a, h):
        b = find_next_node(curve, a, h)
        return None if b is None else [b]

    for b in walk_curve(nodes[0], taken, longest, 0.25 * longest, **more):
        nodes.append(b)
        if len(nodes) == most:
            break
    return nodes


@pytest.mark.slow
@pytest.mark.parametrize("a", some([1.0, 2.0, 5.0], 3))
def test_the_circumference_of_an_ellipse(a):
    """Complete elliptic integral of the second kind; nodes on the curve, tangents by the
    derivative, bends bounded.
    """
    curve = ellipse(a, 1.0)
    nodes = []
    for b in traced(curve, [a, 0.0], [0.0, 1.0], 0.05, 2000):
        if len(nodes) > 5 and b.x[1] > 0.0 > nodes[-1].x[1]:
            break
        nodes.append(b)
    x = np.array([n.x for n in nodes])
    assert np.abs((x[:, 0] / a) ** 2 + x[:, 1] ** 2 - 1.0).max() < 1e-13
    t = np.stack([-a * x[:, 1], x[:, 0] / a], axis=1)
    np.testing.assert_allclose(
        [n.t for n in nodes], t / np.linalg.norm(t, axis=1)[:, None], atol=1e-12
    )
    bends = [compute_bend_angle(n, m) for n, m in zip(nodes, nodes[1:], strict=False)]
    assert max(bends) <= BEND
    last = make_node(curve, nodes[0].x, nodes[0].t)
    length = sum(
        estimate_arc_length(curve, n, m) for n, m in zip(nodes, [*nodes[1:], last], strict=True)
    )
    assert length == pytest.approx(4.0 * a * ellipe(1.0 - 1.0 / a**2), rel=1e-6)


def test_a_helix_among_dependent_equations(hunt):
    """x = cos z, y = sin z, said twice: every node on it, and steps as long as requested where it
    bends evenly.
    """

    def f(x):
        F = np.array([x[0] - math.cos(x[2]), x[1] - math.sin(x[2])])
        J = np.array([[1.0, 0.0, math.sin(x[2])], [0.0, 1.0, -math.cos(x[2])]])
        return np.append(F, F.sum()), np.vstack([J, J.sum(axis=0)])

    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        z = rng.uniform(-3.0, 3.0)
        nodes = traced(Implicit(3, f), [math.cos(z), math.sin(z), z], [0.0, 0.0, 1.0], 0.1, 60)
        x = np.array([n.x for n in nodes])
        np.testing.assert_allclose(
            x[:, :2], np.stack([np.cos(x[:, 2]), np.sin(x[:, 2])], axis=1), atol=1e-12
        )
        # pitch 1, radius 1
        np.testing.assert_allclose([n.t[2] for n in nodes], math.sqrt(0.5), atol=1e-12)
        assert np.diff(x[:, 2])[5:] == pytest.approx(0.1 * math.sqrt(0.5), rel=5e-3)


def test_a_crossing_is_passed_straight_on_and_noticed():
    """x y = 0 from left to right: the determinant changes its sign at the origin, and nowhere else."""
    curve = Implicit(2, lambda x: (np.array([x[0] * x[1]]), np.array([[x[1], x[0]]])))
    nodes = traced(curve, [-1.0, 0.0], [1.0, 0.0], 0.07, 40)
    x = np.array([n.x for n in nodes])
    assert x[-1, 0] > 1.0 and np.abs(x[:, 1]).max() < 1e-12
    found = [k for k in range(len(nodes) - 1) if is_determinant_flipped(nodes[k], nodes[k + 1])]
    assert [x[k, 0] < 0.0 < x[k + 1, 0] for k in found] == [True]


def test_the_walk_ends_where_a_curve_is_not_smooth():
    """y^2 = x^3 has a cusp at the origin: the walk ends where rounding says so, and does not turn
    round.
    """
    # points at which less is missing count as points of the curve
    near = curves.CLOSED ** (1.0 / 3.0)
    curve = Implicit(
        2, lambda x: (np.array([x[1] ** 2 - x[0] ** 3]), np.array([[-3.0 * x[0] ** 2, 2.0 * x[1]]]))
    )
    nodes = traced(curve, [0.5, 0.5**1.5], [-1.0, -1.0], 0.1, 1000)
    x = np.array([n.x[0] for n in nodes])
    assert len(x) < 1000 and -near <= x[-1] < 1e-3 and (np.diff(x) < 0.0).all()


def test_steps_that_are_too_long_are_none():
    """On a circle of radius 1 a step bends by its own length: BEND is the longest that is taken."""
    a = make_node(ellipse(1.0, 1.0), np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    for h in np.linspace(0.05, 1.5, 30):
        # the corrector lands in the plane across the tangent, at the height h: the bend is asin(h)
        b = find_next_node(ellipse(1.0, 1.0), a, float(h))
        allowed = (
            h <= 1.0 and math.asin(h) <= BEND and 1.0 - math.sqrt(1.0 - h * h) <= curves.ACROSS * h
        )
        assert (b is not None) == allowed
        assert b is None or compute_bend_angle(a, b) == pytest.approx(math.asin(h), abs=1e-10)


def test_points_between_and_points_that_are_not_there():
    curve = ellipse(1.0, 1.0)
    a = make_node(curve, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    b = find_next_node(curve, a, 0.2)
    c = find_node_between(curve, a, b, 0.1)
    np.testing.assert_allclose(c.x, [math.sqrt(0.99), 0.1], atol=1e-13)
    # no point of the circle is at y = 1.5
    assert correct_point(curve, np.array([1.0, 1.5]), np.array([0.0, 1.0])) is None


@pytest.mark.parametrize("limit", [0.123, 0.5, 0.99])
def test_the_walk_comes_as_near_to_a_limit_as_its_least_step(limit):
    """Steps beyond a limit are refused: halved until none is left, so that the last was refused
    below twice that.
    """
    a = Node(np.zeros(1), np.ones(1), 1.0, 1, curves.NONE, curves.NONE)

    def taken(a, h):
        x = a.x + h
        return [Node(x, a.t, 1.0, 1, curves.NONE, curves.NONE)] if x[0] <= limit else None

    nodes = list(walk_curve(a, taken, 0.05, 0.05, least=1e-4, ideal=math.inf))
    assert limit - 2e-4 <= nodes[-1].x[0] <= limit
    steps = np.diff([0.0, *(float(n.x[0]) for n in nodes)])
    assert steps[: int(limit / 0.05)] == pytest.approx(0.05)
