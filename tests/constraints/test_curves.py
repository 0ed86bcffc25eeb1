"""Points on curves: against scipy's spline and brute force, by differences, and in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hunts import some
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

import kempe
from kempe import constraints as c
from kempe.constraints.curves import fit_spline, flatten_pieces
from kempe.constraints.tape import Tape
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.errors import DescriptionError, InputError
from kempe.kernels.compiled import tape_evaluation as kernel
from kempe.model.constraint_program import record_rows

ROUND = np.linspace(0.0, 2.0 * np.pi, 25)
RING = np.stack([1.5 * np.cos(ROUND), 0.8 * np.sin(ROUND), 0.3 * np.sin(2.0 * ROUND)], axis=1)
EIGHT = np.stack([np.sin(ROUND), np.sin(2.0 * ROUND), 0.0 * ROUND], axis=1)
CURVES = {
    "ring": (RING, True),
    "arc": (RING[:12], False),
    "eight": (EIGHT, True),
    "open eight": (EIGHT[:20], False),
}


def tape_of(points, closed: bool, dim: int) -> Tape:
    made = c.OnCurve("tip", np.asarray(points)[:, :dim], closed)
    return record_rows(made, list(made.list_rows(dim)), dim).tape


def judged(t: Tape, p: np.ndarray) -> np.ndarray:
    """Values in plain numpy."""
    return t.evaluate_outputs({name: p[:, i] for i, name in enumerate("xyz"[: p.shape[1]])})


def run(t: Tape, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and gradients by the kernel."""
    ints, floats = t.make_arrays()
    values = np.empty((len(p), len(t.outputs)))
    gradients = np.empty((len(p), len(t.outputs), p.shape[1]))
    kernel.evaluate_tape_gradients(ints, floats, np.ascontiguousarray(p), values, gradients)
    return values, gradients


def scipy_spline(points, closed: bool) -> CubicSpline:
    s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    points = np.array(points)
    if closed:
        points[-1] = points[0]
    return CubicSpline(s, points, bc_type="periodic" if closed else "not-a-knot")


def distance(points, closed: bool, p: np.ndarray) -> float:
    """The distance of a place from scipy's spline, by the finest of samples; from its tangents
    beyond the ends.
    """
    spline = scipy_spline(points, closed)
    fine = np.linspace(0.0, spline.x[-1], 4001)
    squares = np.sum((spline(fine) - p) ** 2, axis=1)
    i = int(np.argmin(squares))
    best = squares.min()
    ends = fine[max(i - 1, 0)], fine[min(i + 1, 4000)]
    found: Any = minimize_scalar(
        lambda s: float(np.sum((spline(s) - p) ** 2)),
        method="bounded",
        options={"xatol": 1e-12},
        bounds=ends,
    )
    best = min(best, found.fun)
    if not closed:
        for s, way in ((0.0, -1.0), (spline.x[-1], 1.0)):
            t = way * spline(s, 1) / np.linalg.norm(spline(s, 1))
            far = max(float((p - spline(s)) @ t), 0.0)
            best = min(best, float(np.sum((p - spline(s) - far * t) ** 2)))
    return float(np.sqrt(best))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", CURVES)
def test_distances_are_those_from_the_spline_of_scipy(name, dim, hunt):
    """The kernel's nearest point is the nearest one, and so is that of the numpy judge."""
    points, closed = CURVES[name]
    points = points[:, :dim]
    t = tape_of(points, closed, dim)
    p = hunt.rng().uniform(-2.5, 2.5, size=(hunt.cases(1000) // 20, dim))
    expected = [distance(points, closed, x) for x in p]
    np.testing.assert_allclose(np.linalg.norm(run(t, p)[0], axis=1), expected, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(judged(t, p), axis=1), expected, atol=1e-7)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", CURVES)
def test_zero_on_the_curve_and_nowhere_steep(name, dim):
    """Also where it crosses itself."""
    points, closed = CURVES[name]
    spline = scipy_spline(points[:, :dim], closed)
    on = spline(np.linspace(0.01, spline.x[-1] - 0.01, 200))
    values, gradients = run(tape_of(points, closed, dim), on)
    np.testing.assert_allclose(values, 0.0, atol=1e-12)
    products = gradients @ np.swapaxes(gradients, 1, 2)
    np.testing.assert_allclose(
        products, np.broadcast_to(np.eye(dim - 1), products.shape), atol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("dim", some([2, 3], 2))
@pytest.mark.parametrize("name", some(CURVES, 2))
def test_gradients_by_differences_of_the_judge(name, dim, hunt):
    t = tape_of(*CURVES[name], dim)
    p = hunt.rng().uniform(-2.0, 2.0, size=(200, dim))
    h = 1e-6
    ends = [[judged(t, p + x * e) for x in (h, -h)] for e in np.eye(dim)]
    slopes = np.stack([(a - b) / (2.0 * h) for a, b in ends], axis=-1)
    off = np.abs(run(t, p)[1] - slopes).max(axis=(1, 2))
    assert np.mean(off < 1e-7) > 0.97  # at the others the nearest point jumps within the step
    assert np.median(off) < 1e-9


@pytest.mark.parametrize("name", ["arc", "open eight"])
def test_directions_across_a_curve_do_not_jump_where_pieces_join(name):
    """Values beside the curve, just before and just after each of its points."""
    points, closed = CURVES[name]
    s = scipy_spline(points, closed)
    for side in np.random.default_rng(4).normal(size=(3, 3)):
        before, after = (s(s.x[1:-1] + h) + 0.02 * side for h in (-1e-8, 1e-8))
        t = tape_of(points, closed, 3)
        np.testing.assert_allclose(judged(t, before), judged(t, after), atol=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
def test_series_by_values_along_a_line(dim):
    """Orders of the kernel's series, summed, against the numpy judge a little further on the line."""
    t = tape_of(*CURVES["arc"], dim)
    rng = np.random.default_rng(1)
    order = 6
    h = 0.02
    p = rng.uniform(-2.0, 2.0, size=(60, dim))
    way = rng.normal(size=(60, dim))
    given = np.zeros((60, dim, order + 1))
    found = np.empty((60, len(t.outputs), order + 1))
    given[:, :, 0], given[:, :, 1] = p, way
    ints, floats = t.make_arrays()
    kernel.evaluate_tape_series(ints, floats, order, given, found)
    later = judged(t, p + h * way)
    off = np.abs(found @ h ** np.arange(order + 1) - later).max(axis=1)
    # some lines cross into another piece
    assert np.median(off) < 1e-12 and np.mean(off < 1e-8) > 0.8


@pytest.mark.parametrize(
    "points",
    [
        np.stack([np.cos(5.0 * (x := np.linspace(0.0, 1.0, 1000))), np.sin(3.0 * x), x], axis=1)
        * 1e3,
        np.stack([x, 0.0 * x, 0.0 * x], axis=1),
    ],
)
def test_a_thousand_points(points):
    t = tape_of(points, False, 3)
    s = scipy_spline(points, False)
    on = s(np.linspace(0.0, s.x[-1], 77))
    np.testing.assert_allclose(run(t, on)[0], 0.0, atol=1e-9 * np.abs(points).max())


def test_points_of_a_closed_curve_may_end_where_they_start():
    """Points from a drawing, in millimetres, the last one the first but for rounding."""
    mm = np.round(1e3 * RING, 6)
    last = mm[-1] + [1e-7, 0.0, -1e-7]
    once, twice = (tape_of(1e-3 * np.vstack([mm[:-1], *more]), True, 3) for more in ([], [last]))
    p = np.random.default_rng(2).uniform(-2.0, 2.0, (50, 3))
    np.testing.assert_allclose(run(once, p)[0], run(twice, p)[0], atol=1e-15)


def crank_and_arm(constraint: c.Constraint | None = None) -> kempe.Mechanism:
    m = kempe.Mechanism("arm", dim=2)
    upper = m.body("upper")
    lower = m.body("lower")
    m.revolute("A", m.ground, upper)
    m.revolute("B", upper, lower, at=(1.0, 0.0))
    m.frame("tip", lower, at=(1.0, 0.0))
    m.frame("base", m.ground, at=(0.3, 0.1), angle=0.4)
    if constraint is not None:
        m.constrain(constraint, "cam")
    return m


def circle(n: int) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, n)
    return np.stack([1.2 + 0.4 * np.cos(t), 0.4 * np.sin(t)], axis=1)


def test_a_circle_of_many_points_is_a_crank():
    """The same counts, configurations and path as under the distance from its centre."""
    curve = crank_and_arm(c.OnCurve("tip", circle(721), closed=True, other="base")).build()
    rod = crank_and_arm(c.OnSphere("tip", [1.2, 0.0], 0.4, other="base")).build()
    assert (curve.mobility().dof, curve.mobility().rank_dof) == (1, 1)
    a, b = (s.assembly_modes({"A": 0.9}).q for s in (curve, rod))
    assert len(a) == len(b) == 2
    np.testing.assert_allclose(a[np.argsort(a[:, 1])], b[np.argsort(b[:, 1])], atol=1e-8)
    paths = [s.trace("A", start=s.assemble({"A": 0.9}).q) for s in (curve, rod)]
    assert [p.closed for p in paths] == [True, True]
    assert paths[0].length == pytest.approx(paths[1].length, rel=1e-6)
    J = [s.loops.jacobian(b[0], ["A"], ["B"]).matrix for s in (curve, rod)]
    assert J[0] == pytest.approx(J[1], rel=1e-6)
    assert curve.classify().constraints["cam"].kind == "holonomic"


def test_in_assembly_for_one_call_and_in_ik():
    s = crank_and_arm().build()
    held = c.OnCurve("tip", circle(60), closed=True, other="base")
    closed = s.assemble({"A": 0.9}, also=held)
    requested = s.ik([held, c.Posture(q={"A": 0.9}, weight=None)], start=closed.q)
    for q in (closed.q, requested.q):
        p = np.linalg.inv(s.fk(q, "base")) @ s.fk(q, "tip")
        assert distance(circle(60), True, p[:2, 3]) < 1e-6
    assert closed and requested.success
    far = s.assemble({"A": 2.5}, also=held)
    assert not far and "OnCurve of 'tip' and 'base'" in far.status and "stays open by" in far.status


def test_written_and_read():
    m = crank_and_arm(c.OnCurve("tip", circle(9)[:7], other="base"))
    again = read_toml(write_toml(m))
    assert again == m
    q = m.build().random(1)
    np.testing.assert_array_equal(
        again.build().loops.constraints()[0].residual(again.build(), q),
        m.build().loops.constraints()[0].residual(m.build(), q),
    )


@pytest.mark.parametrize(
    ("points", "closed", "said"),
    [
        (
            [[0, 0], [1, 1], [2, 0]],
            False,
            "points of OnCurve of 'tip' are 3; an open curve needs 4",
        ),
        ([[0, 0], [1, 1]], True, "are 2; a closed curve needs 3"),
        ([[0, 0], [1, 1], [0, 0]], True, "are 2; a closed curve needs 3"),
        ([[0, 0], [0, 0], [1, 1], [2, 2]], False, "points 0 and 1 are equal"),
        ([[0, 0], [1, 0], [1, 1], [1, 1]], True, "points 2 and 3 are equal"),
        ([[0, 0], [0, 0], [0, 0], [0, 0]], False, "are equal"),
        ([0, 1, 2, 3], False, r"have the shape \(4,\); they must be"),
        (np.zeros((4, 4)), False, r"have the shape \(4, 4\)"),
        ([], False, "have the shape"),
        ([[0, 0], [np.nan, 0], [1, 1], [2, 2]], False, "finite"),
        ([[0, 0], [np.inf, 0], [1, 1], [2, 2]], True, "finite"),
        ([["a", 0], [1, 0], [1, 1], [2, 2]], False, "points of OnCurve of 'tip'"),
        ([[0, 0], [1, 1], [2], [3, 3]], False, "points of OnCurve of 'tip'"),
    ],
)
def test_points_of_no_curve(points, closed, said):
    with pytest.raises(InputError, match=said):
        c.OnCurve("tip", points, closed)


def test_points_of_another_dimension():
    with pytest.raises(InputError, match="points of OnCurve of 'tip' has shape"):
        kempe.load("panda").ik(
            c.OnCurve(kempe.load("panda").frame_names[-1], circle(9), name="OnCurve of 'tip'")
        )
    with pytest.raises(DescriptionError, match="leaves the plane"):
        crank_and_arm(c.OnCurve("tip", RING, closed=True))
    with pytest.raises(InputError, match="closed of OnCurve of 'tip' is 'yes'"):
        c.OnCurve("tip", RING, "yes")  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [1e-10, 1.0, 1e6])
def test_a_sharp_curve_is_split_into_gentle_pieces_that_join(size):
    """Through the corners of a zigzag round a square: of any size, through all points, without gaps
    or kinks.
    """
    points = size * np.array(
        [[0, 0, 0], [1, 0, 0], [0.9, 1, 0], [0.1, 0.1, 0], [0, 1, 0]], dtype=float
    )
    pieces = fit_spline(tuple(map(tuple, points)), True, "the curve")
    assert len(pieces) > len(points)
    starts = pieces[..., 0]
    ends = pieces.sum(axis=-1)
    speeds = pieces[..., 1], (pieces * np.arange(4)).sum(axis=-1)
    assert np.allclose(ends, np.roll(starts, -1, axis=0), atol=1e-12 * size)
    there = np.linalg.norm(points[:, None] - starts, axis=-1).min(axis=1)
    assert there.max() < 1e-12 * size
    along = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in speeds]
    assert np.allclose(along[1], np.roll(along[0], -1, axis=0), atol=1e-9)


def test_the_radius_of_a_piece_is_that_of_its_control_points():
    """Bernstein's form of a cubic, by the conversion of monomials that textbooks print (Farin 2002,
    chapter 5).
    """
    pieces = np.random.default_rng(3).normal(size=(5, 3, 4))
    rows = np.array(flatten_pieces(pieces, True)[1:]).reshape(5, 13)
    to_bernstein = np.array([[1, 0, 0, 0], [1, 1 / 3, 0, 0], [1, 2 / 3, 1 / 3, 0], [1, 1, 1, 1]])
    control = pieces @ to_bernstein.T
    radius = np.linalg.norm(control[..., 1:] - control[..., :1], axis=1).max(axis=-1)
    assert np.allclose(rows[:, 12], radius) and np.array_equal(rows[:, :12], pieces.reshape(5, 12))
