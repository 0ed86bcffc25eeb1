"""Numbers of configurations over two coordinates and at places, found from node to node, against
closed forms.
"""

from __future__ import annotations

import numpy as np
import pytest
from reached_sets import torus
from two_freedoms_in_space import (
    directions,
    five_bar,
    lengths_of_pointer,
    modes_of_spherical,
    pointer,
    slider_pair,
    spherical_five_bar,
    ways_of_spherical,
)

import kempe
from kempe import Budget
from kempe.constraints.flat_tasks import FlatTask, find_flat_task
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.spaces import two_freedoms as spaces

PLANE = FlatTask("xy", 2)
DIRECTION = FlatTask("direction", 3)


def test_modes_and_ways_of_spherical_five_bars_are_those_of_triangles(hunt):
    """At all nodes: each leg closes a spherical triangle in two ways or in none, and so do the
    rods.
    """
    rng = hunt.rng()
    met = set[int]()
    for _ in range(hunt.cases(8)):
        arcs = rng.uniform(0.3, 1.5, 5)
        space = spaces.make_two_freedoms(spherical_five_bar(*arcs), "tip", DIRECTION)
        modes = space.solve_grid(31)[1].sum(axis=-1)
        x = np.linspace(-3.1, 3.0, 31)
        y = np.linspace(-1.5, 1.55, 29)
        ways = space.count_reaching_grid(x, y)
        z = directions(*np.meshgrid(x, y, indexing="ij"))
        assert space.names == ("A", "D")
        assert np.array_equal(modes, modes_of_spherical(space.make_grid(31), *arcs))
        assert np.array_equal(ways, ways_of_spherical(z, *arcs))
        met |= set(modes.ravel().tolist()) | set(ways.ravel().tolist())
    assert met == {0, 2, 4}


@pytest.mark.parametrize(("plane", "task"), [("xy", "xy"), ("xz", "xz")])
def test_a_planar_five_bar_in_space_has_the_numbers_of_that_in_the_plane(plane, task):
    flat = spaces.make_two_freedoms(five_bar(None), "tip", PLANE)
    deep = spaces.make_two_freedoms(five_bar(plane), "tip", FlatTask(task, 3))
    modes = [s.solve_grid(37)[1].sum(axis=-1) for s in (flat, deep)]
    x = np.linspace(-0.7, 0.9, 37)
    y = np.linspace(-0.71, 0.7, 35)
    ways = [s.count_reaching_grid(x, y) for s in (flat, deep)]
    assert (
        flat.complete
        and not deep.complete
        and set(modes[0].ravel()) == {0, 1, 2}
        and len(np.unique(ways[0])) > 2
    )
    assert np.array_equal(*modes) and np.array_equal(*ways)


def test_lengths_in_millimetres_do_not_matter():
    """The tip is reached from each slide in two ways; slides are within their limits."""
    space = spaces.make_two_freedoms(slider_pair(3), "tip", FlatTask("xy", 3))
    modes = space.solve_grid(33)[1].sum(axis=-1)
    values = space.make_grid(33)
    far = values[..., 1] - values[..., 0]
    clear = (np.abs(far - 550.0) > 1e-6) & (np.abs(far - 50.0) > 1e-6)
    assert np.array_equal(modes[clear], (2 * ((far > 50.0) & (far < 550.0)))[clear])
    x = np.linspace(-400.0, 420.0, 33)
    y = np.linspace(-277.0, 270.0, 31)
    expected = np.zeros((33, 31), dtype=int)
    X, Y = np.meshgrid(x, y, indexing="ij")
    for s1, s2 in ((a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)):
        with np.errstate(invalid="ignore"):
            carts = X + s1 * np.sqrt(250.0**2 - Y**2), X + s2 * np.sqrt(300.0**2 - Y**2)
        expected += (
            (carts[0] > -300.0) & (carts[0] < 100.0) & (carts[1] > 100.0) & (carts[1] < 500.0)
        )
    assert (
        np.array_equal(space.count_reaching_grid(x, y), expected) and len(np.unique(expected)) > 1
    )
    assert len(space.find_solutions(np.array([50.0, 200.0]))) > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lower", "upper", "times"),
    [
        ("spherical", "spherical", 1),
        ("universal", "spherical", 4),
        ("spherical", "universal", 4),
    ],
)
def test_modes_of_a_pointer_on_two_legs_are_the_roots_of_their_lengths(lower, upper, times):
    """Legs that spin idly are counted once; each universal joint of a leg has two pairs of angles."""
    space = spaces.make_two_freedoms(pointer(lower, upper), "camera", DIRECTION)
    q, mask = space.solve_grid(16)
    assert space.names == ("s0", "s1")
    at = [space.system.coordinate_names.index(n) for n in ("U.rx", "U.ry", "s0", "s1")]
    U = q[mask][:, at[:2]]
    s = q[mask][:, at[2:]]
    assert lengths_of_pointer(U) == pytest.approx(s, abs=1e-9)
    values = space.make_grid(16).reshape(-1, 2)
    expected = [roots_of_pointer(x) for x in values[::23]]
    assert mask.sum(axis=-1).ravel()[::23].tolist() == [times * k for k in expected] and set(
        expected
    ) == {0, 2, 4}


def roots_of_pointer(s: np.ndarray) -> int:
    """How many pairs of angles give these lengths: Newton's method from a grid."""
    side = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    x = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    for _ in range(40):
        off = lengths_of_pointer(x) - s
        J = np.stack(
            [
                (lengths_of_pointer(x + e) - lengths_of_pointer(x - e)) / 2e-6
                for e in 1e-6 * np.eye(2)
            ],
            axis=-1,
        )
        step = np.einsum("kij,kj->ki", np.linalg.pinv(J), -off)
        x += step * np.minimum(1.0, 0.3 / np.maximum(np.linalg.norm(step, axis=1), 1e-9))[:, None]
    x = x[np.abs(lengths_of_pointer(x) - s).max(axis=1) < 1e-9]
    return len(np.unique(np.round(np.exp(1j * x), 4) + 0.0, axis=0))


def test_a_gimbal_reaches_each_direction_in_two_ways_but_for_its_axis():
    m = kempe.Mechanism("gimbal")
    m.universal("U", m.ground, m.body("camera"))
    space = spaces.make_two_freedoms(m.build(), "camera", DIRECTION)
    space.solve_grid(40)
    x = np.linspace(-3.0, 3.0, 30)
    y = np.linspace(-1.5, 1.5, 30)
    assert (space.count_reaching_grid(x, y) == 2).all()
    limited = spaces.make_two_freedoms(
        m.build().with_limits({"U.rx": (-1.0, 1.0), "U.ry": (-0.5, 0.5)}), "camera", DIRECTION
    )
    limited.solve_grid(40)
    z = directions(*np.meshgrid(x, y, indexing="ij"))
    b = np.arcsin(z[..., 0])
    a = np.arctan2(-z[..., 1], z[..., 2])
    assert np.array_equal(limited.count_reaching_grid(x, y), (np.abs(b) < 0.5) & (np.abs(a) < 1.0))


def test_solutions_of_a_point_are_all_ways_to_it():
    arcs = (1.0, 1.2, 1.1, 0.9, 1.3)
    space = spaces.make_two_freedoms(spherical_five_bar(*arcs), "tip", DIRECTION)
    space.solve_grid(31)
    space.count_reaching_grid(np.linspace(-3.1, 3.1, 41), np.linspace(-1.5, 1.5, 41))
    for p in ((0.3, 0.5), (-2.0, 0.1)):
        q = space.find_solutions(np.array(p))
        assert len(q) == ways_of_spherical(directions(*p), *arcs) == 4
        assert space.system.fk(q, "tip")[:, :3, 2] == pytest.approx(
            np.tile(directions(*p), (4, 1)), abs=1e-8
        )
        assert np.abs(space.system.loops.closure_error(q)).max() < 1e-8


def test_places_without_a_closed_form_are_counted_from_node_to_node(monkeypatch):
    exact = spaces.make_two_freedoms(five_bar(None), "tip", PLANE)
    monkeypatch.setattr(spaces, "_plan_for_place", lambda *_: None)
    found = spaces.make_two_freedoms(five_bar(None), "tip", PLANE)
    exact.solve_grid(30)
    found.solve_grid(30)
    x = np.linspace(-0.7, 0.9, 31)
    y = np.linspace(-0.71, 0.7, 29)
    assert np.array_equal(exact.count_reaching_grid(x, y), found.count_reaching_grid(x, y))


def test_the_time_limit_ends_a_search_with_what_is_found():
    from kempe.numerics.clock import TimeLimit

    space = spaces.make_two_freedoms(
        spherical_five_bar(1.0, 1.2, 1.1, 0.9, 1.3), "tip", DIRECTION, TimeLimit(1e-9)
    )
    assert not space.solve_grid(60)[1].any() and space.broken is kempe.Status.OUT_OF_TIME


@pytest.mark.parametrize(
    ("name", "frame", "task", "error", "words"),
    [
        (
            "rssr",
            "coupler",
            "xy",
            UnsupportedError,
            "rssr has 1 freedom and loops, 1 idle spin left out",
        ),
        ("five_bar", "tip", "direction", UnsupportedError, "of a planar system 'xy' is drawn"),
        ("five_bar", "tip", "yx", UnknownNameError, "'xy'.*'direction'"),
        ("bennett", "tool", "xy", UnsupportedError, "bennett has 1 freedom and loops"),
    ],
)
def test_what_is_not_drawn_is_said(name, frame, task, error, words):
    with pytest.raises(error, match=words):
        system = kempe.load(name)
        spaces.make_two_freedoms(system, frame, find_flat_task(task, system.dim))
    with pytest.raises(InputError, match="plot_spaces does not read"):
        kempe.load("two_link").plot_spaces("e", budget=Budget(starts=3))


def test_places_beside_singular_lines_are_reached_in_as_many_ways_as_they_are():
    """The tip of a torus, from above: within the annulus each place is reached over and under, but
    on its edge.
    """
    space = spaces.make_two_freedoms(torus(0.5, 0.2, False), "tip", FlatTask("xy", 3))
    values = space.make_grid(60)
    q, mask = space.solve_grid(60)
    x = np.linspace(-0.75, 0.75, 60)
    y = np.linspace(-0.74, 0.74, 59)
    space.count_reaching_grid(x, y)
    clear = np.abs(np.sin(values[..., 1])) > 1e-6
    assert mask.all() and clear.mean() > 0.9 and (space.count_modes(q, mask)[clear] == 2).all()
