"""Steps of tasks in one kernel call, against the same steps taken level by level in numpy."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

import kempe
from kempe import System, tasks
from kempe.inverse.constrained_step import ConstrainedSteps
from kempe.inverse.ik_step import IkStep, _make_constrained_step, list_speed_limits
from kempe.inverse.tasks import search

ROBOTS = (
    "panda",
    "ur5",
    "iiwa14",
    "puma560",
    "stanford",
    "xarm6",
    "gen3",
    "irb6640",
    "jaco2",
    "so101",
    "youbot",
    "two_link",
)
ALIKE = 1e-5
"""By how much of the largest velocity both steps may differ."""


def step_in_numpy(system: System, q, wanted, dt, speed, damping) -> IkStep:
    """The step of the general solver, which loops and declared constraints need."""
    limits = list_speed_limits(system) if speed is None else np.full(system.nv, speed)
    return _make_constrained_step(
        system, q, wanted, None, dt, limits, speed is None, damping, False, None
    )


def draw_configuration(system: System, rng: np.random.Generator) -> np.ndarray:
    """A random configuration, some coordinates at a limit, some beyond."""
    q = system.random(rng)
    at = system.structure.layout.vector_q
    v = system.structure.layout.vector_v
    end = np.where(rng.random(len(at)) < 0.5, system.lower[v], system.upper[v])
    q[at] = np.where((rng.random(len(at)) < 0.15) & np.isfinite(end), end, q[at])
    if rng.random() < 0.1:
        q[at[0]] += 5.0
    return q


def draw_tasks(system: System, q, rng: np.random.Generator) -> list:
    """One to three tasks, near or far from q: all hard, weighted, or with priorities."""
    tip = system.frame_names[-1]
    middle = system.frame_names[len(system.frame_names) // 2]
    there = system.structure.layout.integrate_velocity(
        q, 10.0 ** rng.uniform(-4.0, 0.3) * rng.normal(size=system.nv)
    )
    X, Y = system.fk(there, tip), system.fk(there, middle)
    d = system.dim
    if rng.random() < 0.2:
        X[:d, 3] += rng.normal(size=d)
    kinds = [
        lambda **o: tasks.Position(tip, X[:d, 3], **o),
        lambda **o: tasks.Pose(tip, X, **o),
        lambda **o: tasks.Posture(there, **o),
        lambda **o: tasks.Position(middle, Y[:d, 3], **o),
        lambda **o: tasks.HalfSpace(tip, X[:d, 3], rng.normal(size=d), **o),
    ]
    if d == 3:
        kinds += [
            lambda **o: tasks.Pointing(tip, rng.normal(size=3), **o),
            lambda **o: tasks.OnPlane(middle, Y[:3, 3], rng.normal(size=3), **o),
            lambda **o: tasks.Orientation(tip, X, **o),
        ]
    how = rng.integers(3)
    out = []
    for k in range(rng.integers(1, 4)):
        options = {"priority": k} if how == 2 else {}
        if how and rng.random() < 0.6:
            options["weight"] = float(10.0 ** rng.uniform(-2.0, 1.0))
        out.append(kinds[rng.integers(len(kinds))](**options))
    return out


def find_difference(a: IkStep, b: IkStep) -> float:
    return float(np.abs(a.velocity - b.velocity).max() / max(1e-3, np.abs(a.velocity).max()))


@pytest.mark.parametrize("name", ROBOTS)
def test_one_kernel_call_gives_the_step_of_levels_in_numpy(name, hunt):
    """Where the general step itself jumps with q (it halves a step or not), none is compared."""
    s = kempe.load(name)
    rng = hunt.rng()
    cases = hunt.cases(10)
    jumps = 0
    for _ in range(cases):
        q = draw_configuration(s, rng)
        wanted = draw_tasks(s, q, rng)
        dt = float(10.0 ** rng.uniform(-3.3, -0.7))
        damping = float(rng.choice([0.0, 0.05, 0.3]))
        speed = [None, 0.5, 2.0, math.inf][rng.integers(4)]
        oracle = step_in_numpy(s, q, wanted, dt, speed, damping)
        got = s.ik_step(q, wanted, dt=dt, velocity_limits=speed, damping=damping)
        if find_difference(oracle, got) <= ALIKE:
            assert abs(got.fraction - oracle.fraction) <= ALIKE
            assert got.twist.shape == oracle.twist.shape
            np.testing.assert_allclose(
                got.twist,
                oracle.twist,
                atol=10.0 * ALIKE * max(1.0, np.abs(oracle.twist).max(initial=0.0)),
            )
            np.testing.assert_allclose(got.q, oracle.q, atol=10.0 * ALIKE)
            continue
        beside = [
            step_in_numpy(
                s,
                s.structure.layout.integrate_velocity(q, 1e-12 * rng.normal(size=s.nv)),
                wanted,
                dt,
                speed,
                damping,
            )
            for _ in range(8)
        ]
        assert max(find_difference(oracle, x) for x in beside) > 0.1 * find_difference(oracle, got)
        jumps += 1
    assert jumps <= 0.2 * cases + 2


def test_tasks_without_loops_never_reach_the_general_solver(panda, monkeypatch):
    """Counted, not timed: position and posture, at rest too, take the kernel alone."""

    def refuse(*_):
        raise AssertionError("the general solver was asked")

    monkeypatch.setattr(ConstrainedSteps, "make_goal_step", refuse)
    q = panda.mid
    goal = panda.fk(q + 0.2, "panda_link7")[:3, 3]
    for _ in range(50):
        wanted = [
            tasks.Position("panda_link7", goal),
            tasks.Posture(panda.mid, weight=1.0, priority=1),
        ]
        q = panda.ik_step(q, wanted, dt=0.05).q
    assert np.abs(panda.fk(q, "panda_link7")[:3, 3] - goal).max() < 1e-9


class Matrix:
    """A pose of another library, which changes in place."""

    def __init__(self, X):
        self.homogeneous = X


def test_tasks_that_exist_already_are_not_made_again(panda, monkeypatch):
    """Counted, not timed: only a task of which more than the goal has changed is read again."""
    read = []
    original = search._make_task
    monkeypatch.setattr(search, "_make_task", lambda *a: read.append(a[2]) or original(*a))
    target = np.array([0.4, 0.1, 0.5])
    near = tasks.Position("panda_link7", target, point=(0.1, 0.0, 0.0))
    far = tasks.Position("panda_link7", target + 0.1).soft(0.1, priority=1)
    wanted = [near, far, tasks.Posture({"panda_joint3": 0.2}, priority=2)]
    first = panda.ik_step(panda.mid, wanted, dt=0.01)
    assert len(read) == 3
    again = panda.ik_step(panda.mid, wanted, dt=0.01)
    assert len(read) == 3 and (again.q == first.q).all()
    target[0] += 0.01
    moved = panda.ik_step(panda.mid, wanted, dt=0.01)
    assert len(read) == 3 and (moved.q != first.q).any()
    wanted[0] = tasks.Position("panda_link7", target.copy(), point=(0.1, 0.0, 0.0))
    wanted[2] = tasks.Posture({"panda_joint3": 0.2}, priority=2)
    assert (panda.ik_step(panda.mid, wanted, dt=0.01).q == moved.q).all() and len(read) == 3
    wanted[0] = tasks.Position("panda_link7", target, point=(0.2, 0.0, 0.0))
    panda.ik_step(panda.mid, wanted, dt=0.01)
    assert read[3:] == [near.label]
    panda.ik_step(panda.mid, wanted[::-1], dt=0.01)
    assert len(read) == 6  # the two positions change names


@pytest.mark.parametrize("other", [False, True])
@pytest.mark.parametrize("word", ["array", "view", "list", "dict", "matrix", "point", "axis"])
def test_tasks_whose_numbers_change_in_place_are_read_again(panda, word, other):
    """A step never depends on the numbers that a task had before, also not where an `other` task
    has these still.
    """
    tip = "panda_link7"
    X = panda.fk(panda.mid + 0.1, tip)
    numbers = X[:3, 3].tolist()
    values = {"panda_joint1": 0.3, "panda_joint3": 0.1}
    near = np.array([0.1, 0.2, 0.3])
    made = {
        "array": lambda: tasks.Pose(tip, X),
        "view": lambda: tasks.Position(tip, X[:3, 3]),
        "list": lambda: tasks.Position(tip, numbers),
        "dict": lambda: tasks.Posture(values),
        "matrix": lambda: tasks.Pose(tip, Matrix(X)),
        "point": lambda: tasks.Position(tip, (0.4, 0.1, 0.5), point=near),
        "axis": lambda: tasks.Pointing(tip, (0.0, 0.0, 1.0), axis=near),
    }[word]
    kept = made()
    before = None
    for k in range(4):
        if other:
            copied = copy.deepcopy(kept)
            panda.ik_step(panda.mid, [copied], dt=0.01)
        got = panda.ik_step(panda.mid, [kept], dt=0.01)
        new = kempe.load("panda").ik_step(panda.mid, [made()], dt=0.01)
        assert (got.q == new.q).all()
        assert before is None or (got.q == before).all() == (k == 2)
        before = got.q
        if k != 1:
            X[0, 3] += 0.01
            numbers[1] += 0.01
            values["panda_joint1"] += 0.01
            near[2] += 0.05


@pytest.mark.parametrize("name", ["joint_helical", "joint_planar"])
def test_tasks_that_nothing_moves_move_nothing(name):
    """The only axis of these joints is the one that points: no motion changes what is missed."""
    s = kempe.load(name)
    rng = np.random.default_rng(0)
    for q in s.random(rng, 20):
        wanted = tasks.Pointing("body", rng.normal(size=3))
        assert not s.ik_step(q, wanted, dt=0.01).velocity.any()
