"""Targets of one frame hold what is declared on its way: rods, slots, surfaces and equations of
coordinates.
"""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe.equations.judge import judge_configurations


def rod() -> kempe.Mechanism:
    m = kempe.Mechanism("arm on a rod", dim=2)
    m.revolute("shoulder", m.ground, m.body("upper"))
    m.revolute("elbow", "upper", m.body("fore"), at=(0.5, 0))
    m.revolute("wrist", "fore", m.body("hand"), at=(0.4, 0))
    m.frame("tip", "hand", at=(0.2, 0))
    m.distance("rod", m.ground, "fore", length=0.6, at=(0.3, 0))
    return m


def law() -> kempe.Mechanism:
    m = kempe.Mechanism("arm with a law", dim=2)
    m.revolute("shoulder", m.ground, m.body("upper"))
    m.revolute("elbow", "upper", m.body("fore"), at=(0.5, 0))
    m.revolute("wrist", "fore", m.body("hand"), at=(0.4, 0))
    m.frame("tip", "hand", at=(0.2, 0))
    m.equation("law", lambda x: x["elbow"] - 2 * x["shoulder"], of=("elbow", "shoulder"))
    return m


def particles() -> kempe.Mechanism:
    m = kempe.Mechanism("chain of rods", dim=2)
    for name in "pqr":
        m.translation(f"J{name}", m.ground, m.particle(name))
    for a, b in ("pq", "qr"):
        m.distance(a + b, a, b, length=0.5)
    m.distance("hook", m.ground, "p", length=0.3)
    m.frame("tip", "r")
    return m


@pytest.mark.parametrize("make", [rod, law, particles])
def test_a_target_is_reached_with_what_is_declared(make):
    """From a configuration that holds it, to the place of the tip at another one that does."""
    s = make().build()
    start, there = (s.assemble(start=s.random(k)).q for k in (0, 1))
    p = s.fk(there, "tip")[:2, 3]
    for answer in (s.ik(p, "tip", start), s.ik(p, "tip", start, method="auto")):
        assert answer.success and judge_configurations(s, answer.q).holds
        assert np.allclose(s.fk(answer.q, "tip")[:2, 3], p, atol=1e-6)
    batch = s.ik(np.stack([p, s.fk(start, "tip")[:2, 3]]), "tip", start)
    assert batch.success.all() and judge_configurations(s, batch.q).holds.all()
    assert judge_configurations(s, s.ik_step(start, s.fk(there, "tip"), "tip", dt=0.01).q).holds


@pytest.mark.parametrize("make", [rod, law])
def test_all_configurations_hold_what_is_declared(make):
    """The tip of each has two freedoms, which its place takes: those found are isolated, and the
    known one is there.
    """
    s = make().build()
    q = s.assemble(start=s.random(1)).q
    found = s.ik_all(s.fk(q, "tip")[:2, 3], "tip")
    assert judge_configurations(s, found.q).holds.all()
    assert np.abs(np.sin(0.5 * (found.q - q))).max(axis=1).min() < 1e-6


def test_what_is_declared_can_put_a_place_out_of_reach():
    """A point of a plane on which the tip is held is reached, one beside it is missed by its
    distance.
    """
    m = kempe.Mechanism("pencil on a table")
    m.revolute("a", m.ground, m.body("A"), axis="z")
    m.revolute("b", "A", m.body("B"), axis="y", at=(0, 0, 0.3))
    m.revolute("c", "B", m.body("C"), axis="y", at=(0.4, 0, 0))
    m.frame("tip", "C", at=(0.4, 0, 0))
    m.point_on_plane("table", m.ground, "C", child_at=(0.4, 0, 0))
    s = m.build()
    assert s.ik([0.3, 0.4, 0.0], "tip").success
    beside = s.ik([0.3, 0.4, 0.1], "tip")
    assert not beside.success and judge_configurations(s, beside.q).holds
    assert abs(np.linalg.norm(s.fk(beside.q, "tip")[:3, 3] - [0.3, 0.4, 0.1]) - 0.1) < 1e-6


def test_a_frame_beside_what_is_declared_keeps_its_own_chain():
    """A rod on one of two arms leaves the other its closed form: two solutions, all of them."""
    m = rod()
    m.revolute("other q1", m.ground, m.body("other upper"), at=(2, 0))
    m.revolute("other q2", "other upper", m.body("other lower"), at=(0.5, 0))
    m.frame("other tip", "other lower", at=(0.4, 0))
    found = m.build().ik_all([2.4, 0.3], "other tip")
    assert len(found) == 2 and found.complete
