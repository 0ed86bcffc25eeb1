"""What answers of `ik_all` give on demand, and what stands in for closed forms: rows of
trajectories, starts, turns.
"""

from __future__ import annotations

import math
from dataclasses import replace

import arms
import numpy as np
import pytest
from ik_all_checks import ask, same_sets

import kempe
from kempe import spatial
from kempe.errors import InputError
from kempe.inverse.closed_forms.plan import SEARCH
from kempe.inverse.closed_forms.solve import solve_locked_chain
from kempe.kernels.forward.table_layout import TURN

ARMS = arms.arms()


# ---- along a trajectory


def shuffled(answer, rng):
    """The answer (B, T, K) with the rows of each target in random order, and angles in random
    turns.
    """
    rows = answer._rows.copy()
    lines = answer.plan.lines
    turns = np.where(lines.kinds == TURN, 2.0 * math.pi / np.abs(lines.multiplier), 0.0)
    rows[..., : len(lines)] += turns * rng.integers(-2, 3, (*rows.shape[:2], len(lines)))
    for x in rows:
        x[:] = x[rng.permutation(len(x))]
    return answer._replace_rows(rows, None)


def modulo_turns(answer):
    """Variables (B, T, K, 2 n) of an answer, angles as cosine and sine; 9 where a row is not in
    use.
    """
    lines = answer.plan.lines
    theta = lines.compute_theta(answer.q[..., lines.q_index])
    turning = lines.kinds == TURN
    both = np.concatenate(
        [np.where(turning, np.cos(theta), theta), np.where(turning, np.sin(theta), 0.0)], axis=-1
    )
    return np.nan_to_num(both, nan=9.0)


@pytest.mark.parametrize("name", ["ur5", "stanford"])
@pytest.mark.parametrize("hidden", [False, True])
def test_rows_continue_along_trajectories(name, hidden):
    """Branches stay apart; however rows are mixed, each comes back to its place, after a gap, too."""
    system = ARMS[name].system
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 12)[:, None]
    begin = ARMS[name].random(5, 2)
    way = 0.2 * rng.uniform(-1.0, 1.0, (2, 1, system.nq))
    begin[:, 4] = 0.8
    answer = system.ik_all(system.fk(begin[:, None] + t * way, "tool"), "tool")
    assert (answer.mask == answer.mask[:, :1]).all() and answer.mask[:, 0].sum() > 6
    first = answer.along()
    if hidden:
        first._rows[3:7, 1, -1] = first._rows[14:20, 0, -1] = -1.0
        first = answer._replace_rows(first._rows, None)
    found = shuffled(first, rng).along()
    a = modulo_turns(first)
    b = modulo_turns(found)
    for x, y in zip(a, b, strict=True):
        order = [int(np.abs(y[0] - row).max(axis=1).argmin()) for row in x[0]]
        np.testing.assert_allclose(y[:, order], x, atol=1e-9)
        there = (y[1:] < 9.0) & (y[:-1] < 9.0)
        assert np.abs(np.diff(y, axis=0))[there].max() < 0.3
    assert found.status[0, 0] == answer.status[0, 0]


@pytest.mark.parametrize("lead", [(0,), (2, 0)])
def test_no_targets_along_a_trajectory(lead):
    system = kempe.load("ur5")
    assert system.ik_all(np.zeros((*lead, 4, 4)), "tool").along().q.shape[:-2] == lead
    one = system.ik_all(system.fk(system.mid, "tool"), "tool")
    assert one.along() is one


def test_rows_of_one_trajectory_do_not_depend_on_another():
    """A batch (2, T) is two trajectories: the second begins anew."""
    system = kempe.load("ur5")
    t = np.linspace(0.0, 1.0, 6)[:, None]
    q = (
        np.array([[0.2, -1.0, 1.2, 0.3, 0.8, 0.1], [-0.9, -0.6, -1.0, 0.9, -1.1, 0.4]])[:, None]
        + 0.1 * t
    )
    both = shuffled(system.ik_all(system.fk(q, "tool"), "tool"), np.random.default_rng(0))
    for i in (0, 1):
        alone = system.ik_all(system.fk(q[i], "tool"), "tool")
        alone = alone._replace_rows(both._rows.reshape(2, 6, *both._rows.shape[1:])[i], None)
        np.testing.assert_array_equal(both.along().q[i], alone.along().q)


# ---- derivatives of the error of an axis


@pytest.mark.parametrize("task", ["direction", "position_axis"])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.0, 1.0)])
def test_derivatives_for_an_axis_of_the_tool(task, axis):
    """Against answers for targets moved and turned a little; a turn about the direction itself
    changes nothing.
    """
    arm = ARMS["wrist3" if task == "direction" else "random5_axis"]
    system = arm.system.mechanism.lock({"j3": 0.3}).build() if task == "direction" else arm.system
    q = 0.4 + 0.1 * np.arange(system.nq)
    step = 1e-6
    X = system.fk(q, "tool")

    def solved(Y):
        target = Y[:3, :3] @ np.array(axis) if task == "direction" else Y
        return system.ik_all(target, "tool", task=(task, axis), start=q)

    answer = solved(X)
    k = int(np.argmin(np.abs(answer.q - q).max(axis=1)))
    assert np.abs(answer.q[k] - q).max() < 1e-9
    for c in range(3, 6) if task == "direction" else range(6):
        near = []
        for side in (step, -step):
            twist = side * np.eye(6)[c]
            Y = spatial.pose(spatial.exp_so3(twist[3:]) @ X[:3, :3], X[:3, 3] + twist[:3])
            found = solved(Y).q
            near.append(found[np.abs(found - q).max(axis=1).argmin()])
        np.testing.assert_allclose(
            answer.derivative[k][:, c], (near[0] - near[1]) / (2 * step), rtol=1e-4, atol=1e-5
        )
    J = answer.jacobian[k]
    assert not J[5].any() and (task == "position_axis" or not J[:3].any())
    assert (np.abs(answer.derivative[k] @ np.append(np.zeros(3), X[:3, :3] @ axis)) < 1e-9).all()


# ---- what comes closest


def test_nearest_of_a_batch():
    """Two links of 0.5 and 0.4 m: what is missed is the distance beyond their sum, of each target
    its own.
    """
    arm = kempe.load("two_link")
    targets = np.array([[0.3, 0.3], [1.2, 0.0], [0.0, -1.5]])
    answer = arm.ik_all(targets, "e")
    for i, missed in enumerate([0.0, 0.3, 0.6]):
        q, position, angle = answer.nearest(i)
        assert position == pytest.approx(missed, abs=1e-8) and angle == 0.0
        p = arm.fk(q, "e")[:2, 3]
        assert np.linalg.norm(p - targets[i]) == pytest.approx(missed, abs=1e-8)
    for i in (-1, 3):
        with pytest.raises(InputError, match=f"index is {i}; there are 3 targets"):
            answer.nearest(i)


def test_nothing_is_nearest_to_no_pose():
    arm = kempe.load("puma560")
    targets = arm.fk(arm.random(1, 2), "tool")
    targets[1, 0, 3] = math.nan
    q, position, angle = arm.ik_all(targets, "tool").nearest(1)
    assert np.isnan(q).all() and q.shape == (6,) and math.isnan(position) and math.isnan(angle)


# ---- turns


def test_turns_that_multiply_beyond_bounds_are_refused():
    """Limits of 400 turns of two joints are more configurations than anybody reads."""
    m = kempe.Mechanism("winch", dim=2)
    m.revolute("A", m.ground, m.body("a"), limits=(-400 * math.pi, 400 * math.pi))
    m.revolute("B", "a", m.body("b"), at=(0.5, 0.0), limits=(-400 * math.pi, 400 * math.pi))
    m.frame("tip", "b", at=(0.4, 0.0))
    arm = m.build()
    with pytest.raises(
        InputError, match="more than 20000 solutions: joint 'B' alone has 40[01] turns"
    ):
        arm.ik_all([0.6, 0.3], "tip", limits="turns")
    assert len(arm.ik_all([0.6, 0.3], "tip", limits=True)) == 2


# ---- many starts in place of closed forms


@pytest.mark.parametrize(
    "name", ["puma560", "randomRPR_6", "youbot_axis", "wrist3", "geared_piper", "iiwa14"]
)
def test_many_starts_find_what_closed_forms_find(name):
    """The search that stands in where there is no plan: the same solutions, turns, flags; a bad
    target is a bad row.
    """
    arm = ARMS[name]
    q = arm.inside(4, 3)
    X = arm.model.fk(q)
    truth = ask(arm, X, q)
    start = q + 0.1  # no turn is as near as another
    near, locked = (np.ascontiguousarray(x[:, truth.plan.lines.q_index]) for x in (start, q))
    targets = truth.problem.targets.copy()
    targets[1, 0, 0] = math.nan
    problem = replace(truth.problem, targets=targets)
    plan = replace(truth.plan, method=SEARCH)
    rows, counts = solve_locked_chain(problem, plan, near, locked, None)
    n = len(plan.lines)
    assert counts[1, 0] == -1 and (rows[1, :, n + 1] < 0.0).all() and (counts[:, 1] == 1).all()
    expected = ask(arm, X, q, start=start)
    for i in (0, 2):
        used = rows[i, :, n + 1] >= 0.0
        found = np.tile(q[i], (used.sum(), 1))
        wanted = expected.q[i][expected.mask[i]]
        found[:, plan.lines.q_index] = rows[i, used, :n]
        theta = arm.model.theta(wanted)
        assert counts[i, 0] == len(found) == len(wanted) and same_sets(
            arm, theta, arm.model.theta(found)
        )
        order = [arm.model.apart(theta, x).argmin() for x in arm.model.theta(found)]
        inside = expected.inside[i][expected.mask[i]][order]
        np.testing.assert_array_equal(rows[i, used, n + 1] % 2 == 1, inside)
        np.testing.assert_allclose(found[inside], wanted[order][inside], atol=1e-6)
        assert (rows[i, used, n] <= problem.tolerance).all()


# ---- joints that do not move the frame


def two_arms(joints: int) -> kempe.System:
    """Arms beside each other: zero is inside the limits of the first, outside those of the other."""
    m = kempe.Mechanism("two arms")
    for side, limits in (("a", (-3.0, 3.0)), ("b", (0.5, 2.0))):
        body = m.ground
        for k in range(joints):
            child = m.body(f"{side}{k}")
            axis = np.eye(3)[(2, 1, 0)[k % 3] if joints == 7 else (2, 1, 1)[k]]
            at = (0.4 if k and joints == 3 or k % 2 else 0.0, 0.0, 0.1)
            m.revolute(f"{side} q{k}", body, child, at=at, axis=axis, limits=limits)
            body = child
        m.frame(f"{side} tip", body, at=(0.3, 0.0, 0.0))
    return m.build()


def assert_inside(system, q):
    """Configurations (..., nq) are inside the limits of every joint."""
    q = np.atleast_2d(q)
    assert len(q) and np.isfinite(q).all()
    assert ((q >= system.lower - 1e-12) & (q <= system.upper + 1e-12)).all(), q


@pytest.mark.parametrize("with_start", [False, True])
def test_solutions_inside_the_limits_are_so_for_joints_outside_the_chain(with_start):
    system = two_arms(3)
    q = np.concatenate([[0.3, 0.4, 0.5], np.ones(3)])
    X = system.fk(q, "a tip")[:3, 3]
    start = np.concatenate([q[:3], np.zeros(3)]) if with_start else None
    for options in ({}, {"limits": True}, {"limits": "turns"}):
        answer = system.ik_all(X, "a tip", start, **options)
        assert answer and answer.inside.any()
        assert_inside(system, answer.q[answer.inside])
        np.testing.assert_array_equal(answer.q[:, 3:], np.full((len(answer), 3), 0.5))  # as of `ik`
        np.testing.assert_array_equal(answer.q[0, 3:], system.ik(X, "a tip", start).q[3:])
    batch = system.ik_all(np.tile(X, (5, 1)), "a tip", start)
    assert_inside(system, batch.q[batch.mask & batch.inside])
    kept = system.ik_all(X, "a tip", np.concatenate([q[:3], np.full(3, 1.7)]))
    np.testing.assert_array_equal(kept.q[:, 3:], np.full((len(kept), 3), 1.7))


@pytest.mark.parametrize("with_start", [False, True])
def test_the_best_of_a_sweep_is_inside_the_limits_of_joints_outside_the_chain(with_start):
    system = two_arms(7)
    q = np.concatenate([[0.3, 0.5, -0.4, 0.8, 0.3, 0.4, 0.2], np.ones(7)])
    X = system.fk(q, "a tip")
    start = np.concatenate([q[:7], np.zeros(7)]) if with_start else None
    sweep = system.inverse.sweep(X, "a tip", "a q2", n=8, start=start)
    assert_inside(system, sweep.q[sweep.inside])
    best = sweep.best()
    assert_inside(system, best.q)
    at = sweep.at(best.value)
    assert_inside(system, at.q[at.inside])
