"""Connected components, against counts by brute force: grids whose neighbours are joined, and
Grashof's rule.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hunts import some
from linkages import four_bar
from polygons import polygon
from scipy.ndimage import label

import kempe
from kempe import Budget, Status
from kempe.equations.closure_rows import compute_jacobian
from kempe.spaces.four_joints import FourJoints, find_four_joints
from kempe.spaces.polygons import find_polygon


def grashof(lengths: list[float]) -> int:
    s, p, q, longest = sorted(lengths)
    return 0 if longest > s + p + q else 2 if s + longest < p + q else 1


def glued(regions: np.ndarray) -> np.ndarray:
    """Numbers of regions of a grid that is a torus: its first row lies beside the last, as the
    first column does.
    """
    while True:
        before = regions.copy()
        for here, there in ((regions[0], regions[-1]), (regions[:, 0], regions[:, -1])):
            for k in np.flatnonzero((here > 0) & (there > 0) & (here != there)):
                regions[regions == max(here[k], there[k])] = min(here[k], there[k])
        if np.array_equal(before, regions):
            return regions


def by_grid(five: list[float], n: int = 240) -> int:
    """Components of a loop of five bars, from a grid of two angles.

    At each point the last two bars close the loop in two mirrored ways, which meet where these bars
    are in line: the space is two copies of the region that can be reached, glued along its edge.
    Where the region has an edge, its two copies are joined.
    """
    ground, a, b, c, d = five
    x = 2.0 * np.pi * (np.arange(n) + 0.5) / n
    t, u = np.meshgrid(x, x, indexing="ij")
    far = np.hypot(a * np.cos(t) + b * np.cos(u) - ground, a * np.sin(t) + b * np.sin(u))
    inside = (far <= c + d) & (far >= abs(c - d))
    regions = glued(np.asarray(label(inside)[0]))
    edge = inside & ~(
        np.roll(inside, 1, 0)
        & np.roll(inside, -1, 0)
        & np.roll(inside, 1, 1)
        & np.roll(inside, -1, 1)
    )
    return sum(1 if (edge & (regions == k)).any() else 2 for k in np.unique(regions[inside]))


def test_four_bars_are_counted_by_grashofs_rule(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        lengths = rng.uniform(0.1, 1.0, 4).tolist()
        loop = find_polygon(polygon(lengths))
        assert not isinstance(loop, str) and loop.count == grashof(lengths)


@pytest.mark.slow
@pytest.mark.parametrize("more", [0.0, 1e-13, 1e-9])
def test_lengths_that_are_taken_to_be_equal_are_named(more):
    """By Grashof's rule two components as soon as one bar is longer; what decides below 1e-12 is
    said.
    """
    bars = polygon([0.4, 0.2, 0.4, 0.2 + more])
    answer = bars.configuration_space.components()
    assert (answer.count == 2) == (more == 1e-9)
    assert ("sums that differ by 5e-14 m are taken to be equal" in answer.status) == (more == 1e-13)


def test_five_bars_are_counted_as_a_grid_counts_them(hunt):
    rng = hunt.rng()
    seen = set()
    for _ in range(hunt.cases(40)):
        lengths = (rng.uniform(0.1, 1.0, 5) ** 2).tolist()
        x = np.sort(lengths)[::-1]
        if abs(x[1] + x[2] - 0.5 * x.sum()) < 0.05 or abs(x[0] - 0.5 * x.sum()) < 0.05:
            continue  # too near to where the number changes for the grid
        answer = polygon(lengths).configuration_space.components()
        assert answer.complete and answer.count == by_grid(lengths), lengths
        seen.add(answer.count)
    assert seen == {0, 1, 2} or hunt.cases(40) < 40


@pytest.mark.parametrize(
    "lengths", some([[0.4, 0.1, 0.5, 0.4], [0.5, 0.3, 0.3, 0.4], [0.3, 0.1, 0.3, 0.1]], 3)
)
def test_curves_that_are_traced_are_as_many_as_the_theorem_says(lengths):
    answer = polygon(lengths).configuration_space.components()
    assert answer.complete and answer.code == Status.SOLVED
    assert len(answer.parts) == answer.count == grashof(lengths)
    assert len(answer.singular) == (2 if lengths[0] == lengths[2] else 0)


@pytest.mark.slow
def test_the_sides_of_two_components_never_meet(hunt):
    """Of five bars of which three are long, every random closed configuration and all along a walk
    keep their side.
    """
    system = polygon([1.0, 0.1, 0.9, 1.0, 0.1])
    loop = find_polygon(system)
    assert not isinstance(loop, str) and loop.count == 2
    sample = system.configuration_space.sample(40, hunt.rng())
    side = loop.label_components(sample.q)
    assert set(side) == {0, 1}
    for q, own in zip(sample.q, side, strict=True):
        path = system.trace(start=q, hold={"j1": q[0]}, budget=Budget(points=60))
        assert (loop.label_components(path.q) == own).all()


def test_aligned_polygons_are_closed_and_on_one_line():
    loop = find_polygon(polygon([0.4, 0.1, 0.2, 0.2, 0.1]))
    assert not isinstance(loop, str)
    q = loop.singular_points
    assert len(q) == 2  # 4 + 1 = 2 + 2 + 1 with the first or the last of the ones on the left
    for x in q:
        ends = (
            loop.system.fk(x, "b4")[:2, :3] @ np.array([0.1, 0.0, 0.0])
            + loop.system.fk(x, "b4")[:2, 3]
        )
        assert np.allclose(ends, [0.4, 0.0], atol=1e-12)
        assert np.allclose(loop.system.fk(x)[:, 1, 3], 0.0, atol=1e-12)


def rssr(crank: float, coupler: float, rocker: float, x: float, y: float, z: float) -> kempe.System:
    return kempe.load("rssr").with_parameters(
        crank=crank, coupler=coupler, rocker=rocker, x=x, y=y, z=z
    )


def rods_by_grid(system: kempe.System, rod: float, n: int = 720) -> int:
    """Components of crank angle by rocker angle where the balls are a rod apart: cells through
    which the curve goes.
    """
    m = system.mechanism
    A, D, B, C = (m.joints[k] for k in "ADBC")
    at = 2.0 * np.pi * np.arange(n + 1) / n
    turn = np.zeros((n + 1, 4, 4))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(at)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(at), -np.sin(at)
    turn[:, 2, 2] = turn[:, 3, 3] = 1.0

    def circle(joint, ball, body):
        where = (ball.X_PF if ball.parent == body else ball.X_CM).evaluate_pose(m.parameters)[:, 3]
        X = (
            joint.X_PF.evaluate_pose(m.parameters)
            @ turn
            @ np.linalg.inv(joint.X_CM.evaluate_pose(m.parameters))
        )
        return (X @ where)[:, :3]

    p = circle(A, B, "crank")
    r = circle(D, C, "rocker")
    f = np.linalg.norm(p[:, None] - r[None], axis=-1) - rod
    corner = np.stack([f[:-1, :-1], f[1:, :-1], f[:-1, 1:], f[1:, 1:]])
    cells = (corner.min(axis=0) < 0.0) & (corner.max(axis=0) > 0.0)
    return len(set(np.unique(glued(np.asarray(label(cells, np.ones((3, 3)))[0])))) - {0})


@pytest.mark.slow
def test_two_cranks_and_a_rod_are_counted_as_a_grid_counts_them(hunt):
    rng = hunt.rng()
    seen = []
    for _ in range(hunt.cases(60, least=20)):
        crank, rocker, x, y, z = rng.uniform(0.05, 0.4, 5)
        rod = rng.uniform(0.2, 0.8)
        system = rssr(crank, rod, rocker, x, y, z)
        found = find_four_joints(system)
        assert isinstance(found, FourJoints)
        seen.append(found.count)
        # else dead points are too near to one another for the grid
        if np.diff(found.cuts).min() > 0.02:
            assert found.count == rods_by_grid(system, rod), (crank, rod, rocker, x, y, z)
    assert set(seen) >= {0, 1, 2}


@pytest.mark.slow
def test_curves_of_cranks_and_a_rod_are_traced_with_the_spin_left_out():
    answer = kempe.load("rssr").configuration_space.components()
    assert (answer.count, answer.complete, answer.idle, len(answer.parts)) == (2, True, 1, 2)


@pytest.mark.slow
def test_without_a_proof_the_number_is_a_lower_bound():
    """Three parallel cranks: three curves were traced, which meet where all is flat, or are not
    known to be apart.
    """
    answer = kempe.load("double_parallelogram").configuration_space.components()
    assert answer.code == Status.PARTLY and not answer and "lower bound" in answer.status
    assert answer.count == 1 and len(answer.parts) > 1 and "may meet" in answer.status
    assert all(p.dimension == 1 and len(p.singular_points) for p in answer.parts)


@pytest.mark.slow
def test_pieces_of_other_dimensions_are_distinguished():
    """Bricard's loop of six turns has positions in which it is rigid: six equations, six unknowns,
    regular.
    """
    system = kempe.load("bricard_line_symmetric")
    parts = system.configuration_space.components().parts
    assert {p.dimension for p in parts} == {0, 1}
    for part in parts:
        assert (
            np.linalg.matrix_rank(compute_jacobian(system, part.paths[0].q[0]), 1e-8)
            == 6 - part.dimension
        )
    # Sarrus' linkage lies flat with all its parallel axes in line: then both halves turn by
    # themselves
    assert "2 freedoms" in kempe.load("sarrus").configuration_space.components().status


def test_limits_cut_curves():
    system = four_bar().with_limits({"A": (-1.0, 1.0)})
    answer = system.configuration_space.components()
    assert (
        answer.complete and answer.count == 2 and not any(p.paths[0].closed for p in answer.parts)
    )


def test_structures_trees_and_loops_that_cannot_close():
    assert kempe.load("two_link").configuration_space.components().count == 1
    apart = polygon([9.0, 1.0, 1.0, 1.0]).configuration_space.components()
    assert apart.code == Status.NONE_EXISTS and apart.complete and "longer than all" in apart.status
    triangle = polygon([1.0, 1.0, 1.0]).configuration_space.components()
    assert triangle.count == 2 and triangle.complete


def test_looking_for_five_bars_warns_of_nothing():
    """Steps that run away while the loop is searched for are longer than squares of numbers can be."""
    m = kempe.Mechanism("five-bar", dim=2)
    m.revolute("A", m.ground, m.body("crank1"), actuated=True)
    m.revolute("B", "crank1", m.body("rod1"), at=(1.37, 0.0))
    m.revolute("D", m.ground, m.body("crank2"), at=(0.88, 0.0), actuated=True)
    m.revolute("C", "crank2", m.body("rod2"), at=(0.33, 0.0))
    m.revolute("P", "rod1", "rod2", at=(0.81, 0.0), child_at=(1.01, 0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert m.build().configuration_space.components().count == 1


@pytest.mark.parametrize(
    ("law", "turns"),
    [
        ("a - b", {"a": 1, "b": 1}),
        ("a - 2*b", {"a": 2, "b": 1}),
        ("2*a + 3*b - 1", {"a": 3, "b": -2}),
    ],
)
def test_a_law_of_angles_leaves_one_endless_line(law, turns):
    """Of which turns of both angles by the law's ratio lead to the same poses: starts are not taken
    out of the law.
    """
    m = kempe.Mechanism("law", dim=2)
    m.revolute("a", m.ground, m.body("A"))
    m.revolute("b", "A", m.body("B"), at=(0.5, 0))
    m.equation("law", law)
    system = m.build()
    found = system.configuration_space.components()
    assert found.count == len(found.parts) == 1 and not found.complete
    (path,) = found.parts[0].paths
    assert path.turns in (turns, {n: -k for n, k in turns.items()}) and "endless curve" in str(
        found.parts[0]
    )
    q = system.configuration_space.sample(300, 0).q
    assert np.abs([eval(law, {"a": a, "b": b}) for a, b in q]).max() < 1e-9
    modes = system.assembly_modes({"b": 2.5})
    assert (
        len(modes) == 1
        and abs(eval(law, {"a": modes.q[0][0], "b": 2.5})) < 1e-9
        and "even" not in modes.status
    )


def test_a_law_of_cosines_leaves_a_closed_curve():
    m = kempe.Mechanism("law", dim=2)
    m.revolute("a", m.ground, m.body("A"))
    m.revolute("b", "A", m.body("B"), at=(0.5, 0))
    m.equation("law", "0.5*cos(a) + 0.4*cos(a + b) - 0.3")
    found = m.build().configuration_space.components()
    assert found.count == 1 and "closed curve" in str(found.parts[0])


def test_a_law_of_angles_within_limits_leaves_one_line():
    m = kempe.Mechanism("law", dim=2)
    m.revolute("a", m.ground, m.body("A"), limits=(-3, 3))
    m.revolute("b", m.ground, m.body("B"), at=(1, 0), limits=(-3, 3))
    m.equation("law", "a - 2*b")
    found = m.build().configuration_space.components()
    assert found.count == 1 and found.parts[0].length == pytest.approx(np.hypot(6.0, 3.0))


@pytest.mark.slow
@pytest.mark.parametrize(("least", "count"), [(2.0, 0), (0.85, 1)])
def test_of_a_space_in_which_nothing_was_found_none_is_counted(least, count):
    """The tip comes at most 0.9 m from the ground: beyond that a space is empty, which is not
    proven here.
    """
    m = kempe.Mechanism("arm", dim=2)
    m.revolute("a", m.ground, m.body("A"), limits=(-1, 1))
    m.revolute("b", "A", m.body("B"), at=(0.5, 0), limits=(-1, 1))
    m.frame("tip", "B", at=(0.4, 0))
    m.constrain(kempe.constraints.Distance("tip", "ground", at_least=least), "far")
    found = m.build().configuration_space.components()
    assert (
        found.count == count
        and not found.complete
        and ("no configuration within" in found.status) == (count == 0)
    )
    assert found.code is (Status.PARTLY if count else Status.NOT_FOUND)


@pytest.mark.parametrize(("limit", "count"), [(0.3, 0), (2.5, 1)])
def test_limits_can_leave_nothing_of_a_loop_with_two_freedoms(limit, count):
    """Three bars of 1 m end at x >= cos(0.3) + cos(0.6) + cos(0.9) = 2.4, and the fourth, of 0.5 m,
    begins at 1.
    """
    m = kempe.Mechanism("five", dim=2)
    m.revolute("A", m.ground, m.body("a"), limits=(-limit, limit))
    m.revolute("B", "a", m.body("b"), at=(1, 0), limits=(-limit, limit))
    m.revolute("C", "b", m.body("c"), at=(1, 0), limits=(-limit, limit))
    m.revolute("E", m.ground, m.body("d"), at=(1, 0))
    m.revolute("D", "c", "d", at=(1, 0), child_at=(0.5, 0))
    found = m.build().configuration_space.components()
    assert found.count == count and not found.complete


def test_the_image_of_a_task_is_of_configurations_within_one_sided_constraints():
    def image(least):
        m = kempe.Mechanism("arm", dim=2)
        m.revolute("a", m.ground, m.body("A"), limits=(-1, 1))
        m.revolute("b", "A", m.body("B"), at=(0.5, 0), limits=(-1, 1))
        m.frame("tip", "B", at=(0.4, 0))
        m.constrain(kempe.constraints.Distance("tip", "ground", at_least=least), "far")
        return m.build().task_space("tip").image

    assert image(2.0) == {} and image(0.85)["x"][0] >= 0.85 * np.cos(1.5)
