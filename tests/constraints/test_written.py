"""Constraints as tasks of one class: expressions, functions, rows of several kinds; numbers are
data of each call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from kempe import Mechanism, tasks
from kempe import constraints as c
from kempe.constraints import Constraint, Op, Row
from kempe.constraints.base import Frame, Number
from kempe.constraints.tape import POSE
from kempe.constraints.text import parse_tape
from kempe.equations.tasks import Task
from kempe.errors import InputError, UnknownNameError
from kempe.inverse.tasks.search import pack_tasks


@dataclass(frozen=True, eq=False)
class Sum(Constraint):
    """A sum of two coordinates, at a value or between ends."""

    of: tuple[str, ...]
    value: Number = None
    at_least: Number = None
    at_most: Number = None

    def list_rows(self, dim):
        x, y = self.of
        tape = parse_tape([f"{x} + 2*{y}"], self.of)
        return (
            Row(Op.TAPE, (tape, 0), "sum", "rad", equal="value", low="at_least", high="at_most"),
        )


@dataclass(frozen=True, eq=False)
class Weighed(Constraint):
    """A sum of two coordinates, one of them times a number of the call."""

    of: tuple[str, ...]
    factor: Number
    value: Number

    def list_rows(self, dim):
        x, y = self.of
        return (
            Row(
                Op.TAPE,
                (parse_tape([f"{x} + factor*{y} - value"], (*self.of, "factor", "value")), 0),
                "sum",
                "1",
            ),
        )


@dataclass(frozen=True, eq=False)
class Level(Constraint):
    """A frame level, at a height, as far from the z axis as it is high, or farther."""

    frame: Frame
    height: Number
    least: Number = None

    def list_rows(self, dim):
        tape = parse_tape(["hypot(x, y)"], POSE)
        rows = (Row(Op.TILT, (), "r", "rad"), Row(Op.POINT, (2,), "z", "m", equal="height"))
        return *rows, Row(Op.TAPE, (tape, 0), "off", "m", low="least")


@dataclass(frozen=True, eq=False)
class Between(Constraint):
    """Two coordinates, each between two numbers."""

    of: tuple[str, ...]
    low: Any
    high: Any

    def list_rows(self, dim):
        tape = parse_tape(list(self.of), self.of)
        return tuple(
            Row(Op.TAPE, (tape, k), str(k), "1", low="low", high="high", part=k) for k in range(2)
        )


@dataclass(frozen=True, eq=False)
class Apart(Constraint):
    """A frame at a distance from the origin, and at a height."""

    frame: Frame
    value: Number
    height: Number = 0.0

    def list_rows(self, dim):
        height = Row(Op.TAPE, (parse_tape(["z - height"], (*POSE, "height")), 0), "z", "m")
        return Row(Op.DISTANCE, (), "distance", equal="value"), height


@dataclass(frozen=True, eq=False)
class Drill(Constraint):
    """A frame at the origin, and its z along the ground's."""

    frame: Frame

    def list_rows(self, dim):
        return *(Row(Op.POINT, (k,), "xyz"[k]) for k in range(3)), Row(Op.TILT, (), "r", "rad")


def arm():
    """Three revolute joints, the last coupled to the first, and a slide at the end."""
    m = Mechanism("arm")
    a = m.body("a")
    b = m.body("b")
    hand = m.body("hand")
    tip = m.body("tip")
    m.revolute("A", m.ground, a, axis="z")
    m.revolute("B", a, b, at=(0.0, 0.0, 0.5), axis="y")
    m.revolute("C", b, hand, at=(0.6, 0.0, 0.0), axis="y")
    m.prismatic("D", hand, tip, at=(0.4, 0.0, 0.0), axis="x")
    return m


def free():
    """One free body."""
    m = Mechanism("free")
    m.free("J", m.ground, m.body("b"))
    return m.build()


def test_numbers_of_expressions_of_coordinates_are_data_of_the_call(hunt):
    """A batch of values, and of factors, has one structure, and each target is met."""
    s = arm().build()
    rng = hunt.rng()
    value = rng.uniform(-1.0, 1.0, 1000)
    factor = rng.uniform(0.5, 2.0, 1000)
    q = s.ik([Weighed(("A", "B"), factor, value)], start=s.random(1)).q
    np.testing.assert_allclose(q[:, 0] + factor * q[:, 1], value, atol=1e-6)
    q = s.ik([Sum(("A", "B"), value)], start=s.random(1)).q
    np.testing.assert_allclose(q[:, 0] + 2.0 * q[:, 1], value, atol=1e-6)
    one, other = (pack_tasks(s, (Task(s, Weighed(("A", "B"), 2.0, x)),), True) for x in (0.1, 0.2))
    assert one is other


def test_ends_of_expressions_differ_from_target_to_target(hunt):
    """By the closest point: each q moves along (1, 2) until the sum is within its ends; infinite
    ends are none.
    """
    s = arm().build()
    rng = hunt.rng()
    low = np.where(rng.random(500) < 0.2, -np.inf, rng.uniform(-1.0, 0.0, 500))
    high = np.where(rng.random(500) < 0.2, np.inf, rng.uniform(0.0, 1.0, 500))
    answer = s.ik(
        [Sum(("A", "B"), at_least=low, at_most=high)], start=rng.uniform(-1.0, 1.0, (500, s.nq))
    )
    total = answer.q[:, 0] + 2.0 * answer.q[:, 1]
    assert answer.success.all() and (total > low - 2e-6).all() and (total < high + 2e-6).all()
    assert np.ptp(total) > 0.5
    one = s.ik([Sum(("A", "B"), at_least=low[0], at_most=high[0])], start=answer.q[0])
    assert one.success and np.array_equal(one.q, answer.q[0])


def test_each_of_several_numbers_has_ends(hunt):
    s = arm().build()
    rng = hunt.rng()
    low = -rng.uniform(0.0, 0.5, (200, 2))
    high = rng.uniform(0.0, 0.5, (200, 2))
    answer = s.ik([Between(("A", "B"), low, high)], start=rng.uniform(-1.0, 1.0, (200, s.nq)))
    assert answer.success.all()
    assert (answer.q[:, :2] > low - 2e-6).all() and (answer.q[:, :2] < high + 2e-6).all()
    assert tasks.miss(s, Between(("A", "B"), [0.0, 0.1], [0.2, 0.3]), [0.5, 0.4, 0.0, 0.0])[
        1
    ] == pytest.approx(np.hypot(0.3, 0.1))


def test_a_point_and_an_axis_are_both_measured(hunt):
    """By the pose: the distance of the origin, and the angle between the axes."""
    s = free()
    q = s.random(hunt.rng(), 100)
    X = s.fk(q, "b")
    size, angle = tasks.miss(s, Drill("b"), q)
    np.testing.assert_allclose(size, np.linalg.norm(X[:, :3, 3], axis=1), atol=1e-12)
    np.testing.assert_allclose(angle, np.arccos(X[:, 2, 2]), atol=1e-7)


def test_rows_of_several_kinds_are_tasks_together(hunt):
    """Turned, at a height, off an axis: by poses."""
    s = free()
    rng = hunt.rng()
    height = rng.uniform(-1.0, 1.0, 100)
    for least in (0.4, rng.uniform(0.2, 0.6, 100)):
        answer = s.ik([Level("b", height, least)], start=s.random(3))
        X = s.fk(answer.q, "b")
        assert answer.success.all()
        np.testing.assert_allclose(X[:, 2, 3], height, atol=1e-6)
        np.testing.assert_allclose(X[:, 2, 2], 1.0, atol=1e-9)
        assert (np.hypot(X[:, 0, 3], X[:, 1, 3]) > least - 1e-6).all()
    X = s.fk(s.ik([Apart("b", 1.0 + height**2, height)], start=s.random(4)).q, "b")
    np.testing.assert_allclose(np.linalg.norm(X[:, :3, 3], axis=-1), 1.0 + height**2, atol=1e-6)
    np.testing.assert_allclose(X[:, 2, 3], height, atol=1e-6)


def test_distances_straight_above_have_derivatives():
    """Where x and y are zero, the distance in the plane of these has none."""
    s = free()
    q = s.q({"J.z": 0.5})
    made = Apart("b", 1.0, 0.6)
    np.testing.assert_allclose(tasks.jacobian(s, made, q)[:, :3], [[0.0, 0.0, 1.0]] * 2, atol=1e-12)
    assert s.ik([Apart("b", np.full(3, 0.6), np.full(3, 0.6))], start=q).success.all()


@pytest.mark.parametrize("other", [None, "base", "arm"])
def test_goals_of_expressions_are_seen_from_frames_far_away(other):
    """On an ellipse cylinder, and a frame above a plane, about the ground, a body that stands and
    one that moves.
    """
    m = Mechanism("far")
    base = m.body("base")
    a = m.body("arm")
    b = m.body("b")
    m.fixed("F", m.ground, base, at=(300.0, -200.0, 0.0), rpy=(0.1, 0.2, 0.3))
    m.revolute("A", base, a, axis="z")
    m.free("J", base, b)
    s = m.build()
    for made in (
        c.OnSurface("b", "(x/2)^2 + y^2 = 1", other=other),
        c.Contact("b", other, radius=0.3),
    ):
        q = s.ik([made], start=s.random(1)).q
        A = np.eye(4) if other is None else s.fk(q, other)
        p = (np.linalg.inv(A) @ s.fk(q, "b"))[:3, 3]
        f = (
            (p[0] / 2.0) ** 2 + p[1] ** 2 - 1.0
            if made.kind == "on_surface"
            else min(p[2] - 0.3, 0.0)
        )
        assert abs(f) < 1e-6


def test_a_value_of_any_row_holds_where_it_is_declared():
    m = Mechanism("free")
    m.free("J", m.ground, m.body("b"))
    m.constrain(Level("b", 0.3, 0.4), "it")
    s = m.build()
    X = s.fk(s.assemble(start=s.random(5)).q, "b")
    assert s.mobility(s.assemble(start=s.random(5)).q).dof == 3  # along the plane, and about z
    assert X[2, 3] == pytest.approx(0.3, abs=1e-9) and np.hypot(X[0, 3], X[1, 3]) > 0.4 - 1e-9


def test_coordinates_that_follow_others_are_read(hunt):
    m = arm()
    m.couple("C", {"A": 2.0}, 0.1)
    s = m.build()
    value = hunt.rng().uniform(-1.0, 1.0, 100)
    q = s.ik([Weighed(("C", "B"), 1.0, value)], start=s.random(1)).q
    np.testing.assert_allclose(2.0 * q[:, 0] + 0.1 + q[:, 1], value, atol=1e-6)
    assert max(tasks.miss(s, Weighed(("C", "B"), 1.0, value[7]), q[7])) < 1e-6


def test_what_has_no_number_is_refused():
    @dataclass(frozen=True, eq=False)
    class Turned(Constraint):
        frame: Frame
        value: Number = 0.3

        def list_rows(self, dim):
            return (Row(Op.ROTATION, (), "r", "rad", equal="value"),)

    with pytest.raises(InputError, match="no number that has a value"):
        free().ik([Turned("b")])
    with pytest.raises(UnknownNameError, match="coordinate"):
        arm().build().ik([Sum(("A", "Q"), 0.3)])


def test_a_value_and_its_derivatives_of_functions_and_expressions_agree(hunt):
    """The same equation as text, as a function of named coordinates that branches, and of q."""
    s = arm().build()
    rng = hunt.rng()
    branching = c.Equation(lambda q: q["A"] * q["B"] - 0.2 if q["A"] < 9.0 else 1.0, of=("A", "B"))
    made = [c.Equation("A*B - 0.2"), branching, c.Function(lambda q: q[0] * q[1] - 0.2)]
    for q in rng.uniform(-1.0, 1.0, (20, s.nq)):
        for x in made:
            np.testing.assert_allclose(tasks.error(s, x, q), [q[0] * q[1] - 0.2], atol=1e-12)
            np.testing.assert_allclose(tasks.jacobian(s, x, q), [[q[1], q[0], 0.0, 0.0]], atol=1e-8)
            assert tasks.miss(s, x, q)[1] == pytest.approx(abs(q[0] * q[1] - 0.2), abs=1e-12)
