"""All configurations in which a frame that moves with loops reaches a place."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import kempe
from kempe.errors import InputError, NoSolutionError, UnknownNameError, UnsupportedError


@pytest.mark.parametrize("name, count", [("delta_ss", 8), ("stewart_sps", 1)])
def test_each_leg_stands_in_its_own_ways(name, count):
    """An arm of the delta robot has two angles for a place of the platform (circle and sphere): 2^3 in all."""
    system = kempe.load(name)
    X = system.fk(system.q("closed"), "platform")
    found = system.ik_all(X, "platform")
    assert len(found) == count and found.inside.all() and not found.complete and "idle spins left out" in found.status
    np.testing.assert_allclose(system.fk(found.q, "platform"), np.broadcast_to(X, (count, 4, 4)), atol=1e-9)
    assert np.abs(system.loops.closure_error(found.q)).max() < 1e-9


def test_working_modes_of_planar_robots():
    """Two angles of each leg by the cosine law: 2^2 for the five-bar's tip, 2^3 for 3-RRR."""
    five = kempe.load("five_bar")
    tip = five.fk(five.q("closed"), "tip")[:2, 3]
    assert len(five.ik_all(tip, "tip")) == 4
    robot = kempe.load("three_rrr")
    q = robot.q("closed")
    found = robot.ik_all(robot.fk(q, "tool"), "tool", start=q)
    assert len(found) == 8
    np.testing.assert_allclose(robot.fk(found.q, "tool"), np.broadcast_to(robot.fk(q, "tool"), (8, 4, 4)), atol=1e-9)
    np.testing.assert_allclose(robot.configuration_space.difference(found.q[0], q), 0.0, atol=1e-7)


@pytest.mark.slow
def test_inside_the_limits_first():
    system = kempe.load("stewart")
    X = system.fk(system.q("closed"), "platform")
    legs = [i for i, n in enumerate(system.coordinate_names) if n.startswith("leg")]
    everything = system.ik_all(X, "platform")
    few = system.ik_all(X, "platform", limits=True)
    assert np.all(np.diff(everything.inside.astype(int)) <= 0) and few.inside.all()
    assert (everything.q[everything.inside][:, legs] > 0).all() and (few.q[:, legs] > 0).all()


@pytest.mark.slow
def test_what_cannot_be_reached_is_empty():
    system = kempe.load("five_bar")
    with pytest.raises(NoSolutionError, match="none found, which proves nothing") as error:
        system.ik_all([9.0, 9.0], "tip").expect()
    assert not error.value.solution


@pytest.mark.parametrize(
    ("change", "options", "error", "says"),
    [
        (1.0, {"task": "orientation"}, UnsupportedError, "takes one pose or position there, not task 'orientation'"),
        (np.ones((2, 1, 1)), {}, UnsupportedError, "not more than one target"),
        (np.nan, {}, InputError, "not finite"),
        (1.0, {"limits": "turns"}, InputError, "for chains"),
        (1.0, {"fixed": {"nobody": 0.1}}, UnknownNameError, "nobody"),
    ],
)
def test_what_is_refused(change, options, error, says):
    system = kempe.load("three_rrr")
    X = system.fk(system.q("closed"), "tool")
    with pytest.raises(error, match=says):
        system.ik_all(X * change, "tool", **options)


def test_held_joints_choose():
    """One leg held at each of its two angles leaves the others' 2^2."""
    robot = kempe.load("three_rrr")
    q = robot.q("closed")
    X, first = robot.fk(q, "tool"), robot.coordinate_names[0]
    found = robot.ik_all(X, "tool")
    _, at = np.unique(np.round(found.q[:, 0], 6), return_index=True)
    values = found.q[at, 0]
    assert len(values) == 2
    parts = [robot.ik_all(X, "tool", fixed={first: v}) for v in values]
    assert [len(p) for p in parts] == [4, 4]
    pairs = itertools.product(found.q, np.concatenate([p.q for p in parts]))
    assert sum(np.abs(robot.configuration_space.difference(a, b)).max() < 1e-6 for a, b in pairs) == 8
