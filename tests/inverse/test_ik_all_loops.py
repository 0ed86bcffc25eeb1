"""All configurations in which a frame that moves with loops reaches a place."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import kempe
from kempe.errors import InputError, NoSolutionError, UnknownNameError, UnsupportedError


@pytest.mark.parametrize("name, count", [("delta_ss", 8), ("stewart_sps", 1)])
def test_each_leg_stands_in_its_own_ways(name, count):
    """An arm of the delta robot has two angles for a place of the platform (circle and sphere): 2^3
    in all.
    """
    system = kempe.load(name)
    X = system.fk(system.q("closed"), "platform")
    found = system.ik_all(X, "platform")
    assert (
        len(found) == count
        and found.inside.all()
        and not found.complete
        and "idle spins left out" in found.status
    )
    np.testing.assert_allclose(
        system.fk(found.q, "platform"), np.broadcast_to(X, (count, 4, 4)), atol=1e-9
    )
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
    np.testing.assert_allclose(
        robot.fk(found.q, "tool"), np.broadcast_to(robot.fk(q, "tool"), (8, 4, 4)), atol=1e-9
    )
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
    with pytest.raises(NoSolutionError, match="none found from .* without proof") as error:
        system.ik_all([9.0, 9.0], "tip").expect()
    assert not error.value.solution


@pytest.mark.parametrize(
    ("change", "options", "error", "says"),
    [
        (
            1.0,
            {"task": "orientation"},
            UnsupportedError,
            "takes one pose or position there, not task 'orientation'",
        ),
        (np.ones((2, 1, 1)), {}, UnsupportedError, "not more than one target"),
        (np.nan, {}, InputError, "must be finite"),
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
    X = robot.fk(q, "tool")
    first = robot.coordinate_names[0]
    found = robot.ik_all(X, "tool")
    _, at = np.unique(np.round(found.q[:, 0], 6), return_index=True)
    values = found.q[at, 0]
    assert len(values) == 2
    parts = [robot.ik_all(X, "tool", fixed={first: v}) for v in values]
    assert [len(p) for p in parts] == [4, 4]
    pairs = itertools.product(found.q, np.concatenate([p.q for p in parts]))
    assert (
        sum(np.abs(robot.configuration_space.difference(a, b)).max() < 1e-6 for a, b in pairs) == 8
    )


# ---- joints that follow others


def palletizer(base: float = 0.14, upper: float = 0.135, lower: float = 0.147) -> kempe.System:
    """An arm of which parallel linkages, written as couplings, keep the hand level: the motors turn
    both links.
    """
    m = kempe.Mechanism("palletizer")
    turn, first, fake, second, hand = (
        m.body(name) for name in ("turn", "first", "fake", "second", "hand")
    )
    m.revolute("j1", m.ground, turn, at=(0, 0, base))
    m.revolute("j2", turn, first, axis=(0, 1, 0))
    m.revolute("m2", first, fake, axis=(0, 1, 0), at=(0, 0, upper))
    m.revolute("j3", fake, second, axis=(0, 1, 0))
    m.revolute("m3", second, hand, axis=(0, 1, 0), at=(lower, 0, 0))
    m.couple("m2", {"j2": -1.0})
    m.couple("m3", {"j3": -1.0})
    return m.build()


def by_triangles(p, base=0.14, upper=0.135, lower=0.147) -> np.ndarray:
    """Angles (k, 3) of the palletizer at a place p (3,): two triangles, each in front of the base
    and behind it.
    """
    out = []
    for side in (1.0, -1.0):
        r = side * np.hypot(p[0], p[1])
        z = p[2] - base
        far = np.hypot(r, z)
        to = np.arctan2(r, z)
        cosine = (upper**2 + far**2 - lower**2) / (2.0 * upper * far)
        for sign in (1.0, -1.0) if abs(cosine) < 1.0 else ():
            second = to + sign * np.arccos(cosine)
            third = np.arctan2(-(z - upper * np.cos(second)), r - upper * np.sin(second))
            out.append([np.arctan2(side * p[1], side * p[0]), second, third])
    return np.array(out).reshape(-1, 3)


def test_solutions_of_an_arm_whose_joints_follow_others(hunt):
    """As many as its triangles, the same ones, and an answer that does not say they are all."""
    robot = palletizer()
    rng = hunt.rng()
    for _ in range(hunt.cases(16)):
        p = robot.fk(robot.random(rng), "hand")[:3, 3]
        found = robot.ik_all(p, "hand")
        known = by_triangles(p)
        assert found and len(found) == len(known) and not found.complete
        off = np.abs(np.angle(np.exp(1j * (found.q[:, None] - known)))).max(axis=-1)
        assert (off.min(axis=0) < 1e-6).all() and (off.min(axis=1) < 1e-6).all()
    q = np.array([0.3, 0.4, 0.2])
    X = robot.fk(q, "hand")
    posed = robot.ik_all(X, "hand", limits=True)
    assert len(posed) and np.abs(robot.fk(posed.q, "hand") - X).max() < 1e-9
    with pytest.raises(UnsupportedError, match="joints that follow others.*, not more than one"):
        robot.ik_all(np.stack([X, X]), "hand")
    with pytest.raises(UnsupportedError, match="not task 'direction'"):
        robot.ik_all(X, "hand", task="direction")
    with pytest.raises(InputError, match="joints that follow others: limits='turns'"):
        robot.ik_all(X, "hand", limits="turns")
    with pytest.raises(UnsupportedError, match="`ik_all` by `assembly_modes`"):
        robot.inverse.plan("hand")


def test_solutions_of_a_screw_and_of_a_joint_that_takes_another_along():
    """A nut that climbs as it turns; an elbow that a motor at the shoulder turns against the
    ground.
    """
    m = kempe.Mechanism("screw and elbow")
    nut, upper, lower, hand = (m.body(name) for name in ("nut", "upper", "lower", "hand"))
    m.helical("screw", m.ground, nut, pitch=0.5, limits=(-3.0, 3.0))
    m.revolute("shoulder", nut, upper, at=(0.1, 0, 0))
    m.revolute("motor", upper, lower, at=(0.4, 0, 0))
    m.revolute("elbow", lower, hand)
    m.couple("elbow", {"shoulder": -1.0})
    m.frame("tip", hand, at=(0.3, 0, 0))
    robot = m.build()
    rng = np.random.default_rng(3)
    for q in rng.uniform(-1.5, 1.5, (4, 3)):
        X = robot.fk(q, "tip")
        found = robot.ik_all(X[:3, 3], "tip", limits=True)
        assert np.abs(robot.fk(found.q, "tip")[:, :3, 3] - X[:3, 3]).max() < 1e-9
        off = np.abs(np.angle(np.exp(1j * (found.q - q)))).max(axis=-1)
        assert off.min() < 1e-6
