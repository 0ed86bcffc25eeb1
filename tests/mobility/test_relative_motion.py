"""How one body moves relative to another: each joint's freedoms, axes known from drawings,
differences of poses.
"""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Mechanism, spatial
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.joints import TYPES


@pytest.mark.parametrize("name", sorted(TYPES))
def test_a_joint_leaves_its_freedoms(name):
    options = {"pitch": 0.02} if name == "helical" else {}
    m = Mechanism("pair")
    m.joint("J", name, m.ground, m.body("B"), at=(0.3, -0.2, 0.5), rpy=(0.4, 0.5, 0.6), **options)
    m.free("K", m.ground, m.body("other"))
    system = m.build()
    found = system.loops.relative_motion(system.random(1), "B", "ground")
    kind = TYPES[name](**options)
    assert found.dof == kind.dof() == found.twists.shape[1]
    back = system.loops.relative_motion(system.random(1), "ground", "B")
    assert (back.dof, back.slides) == (found.dof, found.slides)
    assert system.loops.relative_motion(system.random(1), "other", "B").dof == 6


def test_the_lectures_slider():
    loop = kempe.load("seven_bodies_loop")
    q = loop.assemble().q
    assert (
        loop.loops.relative_motion(q, "B5", "B0").sentence
        == "1 DoF of B5 relative to B0: a slide along x"
    )
    assert str(loop.loops.relative_motion(q, "B0", "B0")) == "0 DoF of B0 relative to B0"


def test_links_of_four_bars_turn_about_known_points():
    """A rocker about its pin; the coupler about its pole, where the lines of both cranks meet
    (Kennedy, Aronhold).
    """
    bar = kempe.load("four_bar")
    q = bar.assemble({"A": 1.1}).q
    pins = {c: bar.fk(q, b)[:2, 3] for c, b in (("A", "crank"), ("B", "coupler"), ("D", "rocker"))}
    rocker = bar.loops.relative_motion(q, "rocker", "ground")
    assert (
        rocker.dof == 1
        and rocker.slides == 0
        and "a turn about z through (0.4, 0, 0)" in rocker.sentence
    )
    motion = bar.loops.relative_motion(q, "coupler", "ground")
    v = motion.twists[:2, 0]
    w = motion.twists[5, 0]
    pole = pins["B"] + np.array([-v[1], v[0]]) / w
    along = pins["B"] - pins["A"]
    off = pole - pins["A"]
    assert abs(along[0] * off[1] - along[1] * off[0]) < 1e-9  # on the line of the crank


def test_the_coupler_of_a_parallelogram_slides():
    m = Mechanism("parallelogram", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("coupler"), at=(0.0, 0.3))
    m.revolute("D", m.ground, m.body("d"), at=(0.5, 0.0))
    m.revolute("C", "coupler", "d", at=(0.5, 0.0), child_at=(0.0, 0.3))
    system = m.build()
    q = system.assemble({"A": 0.4}, start=system.q({"A": 0.4, "B": -0.4, "D": 0.4})).q
    found = system.loops.relative_motion(q, "coupler", "ground")
    assert (found.dof, found.slides) == (1, 1) and "a slide along (" in found.sentence


def test_twists_are_rates_of_relative_poses():
    """In trees: twists span the differences of relative poses, and nothing else."""
    system = kempe.load("seven_bodies")
    q = system.random(5)
    h = 1e-6
    for body, to in (("B7", "B2"), ("B4", "B6"), ("B3", "B0")):
        found = system.loops.relative_motion(q, body, to)

        def pose(x, body=body, to=to):
            return spatial.inverse(system.fk(x, to)) @ system.fk(x, body)

        X = pose(q)
        columns = []
        for e in np.eye(system.nq):
            D = (pose(q + h * e) - pose(q - h * e)) / (2 * h)
            W = D[:3, :3] @ X[:3, :3].T
            columns.append([*D[:3, 3], W[2, 1], W[0, 2], W[1, 0]])
        rates = np.array(columns).T
        assert found.dof == np.linalg.matrix_rank(rates, 1e-6) and np.allclose(
            found.origin, X[:3, 3]
        )
        inside = found.twists @ np.linalg.lstsq(found.twists, rates, rcond=None)[0]
        assert np.allclose(inside, rates, atol=1e-8)


def test_bad_input():
    arm = kempe.load("two_link")
    with pytest.raises(InputError, match=r"one configuration \(2,\)"):
        arm.loops.relative_motion(np.zeros((3, 2)), "B1", "ground")
    with pytest.raises(UnknownNameError, match="nowhere"):
        arm.loops.relative_motion(arm.neutral, "nowhere", "ground")
    m = Mechanism("point")
    m.free("J", m.ground, m.particle("P"))
    with pytest.raises(UnsupportedError, match="particle"):
        m.build().loops.relative_motion([0, 0, 0], "P", "ground")


def test_a_singular_posture_says_what_there_is_around():
    """A stretched arm loses a direction; moved away from there it has what it has elsewhere."""
    for name, frame, here, around in (("ur5", "tool", 5, 6), ("two_link", "e", 2, 2)):
        arm = kempe.load(name)
        found = arm.mobility(arm.neutral).relative(frame, arm.body_names[0])
        J = arm.jacobian(arm.neutral, frame)
        assert found.dof == np.linalg.matrix_rank(J, 1e-9) == here and found.around == around
        assert ("to first order here, around here 6" in found.status) == (here < around)
        elsewhere = arm.loops.relative_motion(arm.random(1), frame, arm.body_names[0])
        assert elsewhere.dof == elsewhere.around == around and "here" not in elsewhere.status
    bar = kempe.load("four_bar")
    q = bar.assemble({"A": 0.5}).q
    assert bar.loops.relative_motion(q, "rocker", "ground").around == 1


def test_a_turn_about_the_origin_of_a_body_is_no_screw():
    """Of a sleeve that a crank moves over a ball and a cross, at the dead centre: it does not slide
    there.
    """
    m = Mechanism("crank, rod and sleeve")
    m.revolute("crank", m.ground, m.body("wheel"))
    m.spherical("ball", "wheel", m.body("rod"), at=(0.2, 0, 0))
    m.universal("cross", "rod", m.body("sleeve"), at=(1.0, 0, 0))
    m.cylindrical("rail", m.ground, "sleeve", at=(0, 0, 0.3), axis="x")
    system = m.build()
    at_end = system.assemble({"crank": 0.0})
    found = system.loops.relative_motion(at_end.q, "sleeve", "ground")
    assert found.status.startswith("1 DoF of sleeve relative to ground: a turn about x through (")
    beside = system.loops.relative_motion(
        system.assemble({"crank": 0.5}, start=at_end.q).q, "sleeve", "ground"
    )
    assert ": a screw of " in beside.status
