"""`complete` of `ik_all` next to self-motions, for chains with slides whose axes nearly meet, and for few joints."""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import continuation
import numpy as np
import pytest
from hunts import some
from ik_all_checks import allowed, ask, assert_found, assert_true, near_singular

PI, H = np.pi, np.pi / 2


def assert_all_found_near_singular(arm: arms.Arm, seed: int, number: int) -> None:
    """Configurations moved off random singular ones by 1e-12 to 1e-3 are found, or the answer is not complete."""
    theta, curve = near_singular(arm, seed, number, 10.0 ** -np.arange(3, 13))
    far = allowed(arm, theta, curve[:, None]).ravel()
    theta = theta.reshape(-1, arm.model.n)
    X = arm.model.pose(theta)
    answer = ask(arm, X)
    assert_true(arm, answer, X)
    q = np.zeros((len(X), arm.system.nq))
    q[:, arm.model.index] = (theta - arm.model.offset) / arm.model.multiplier
    assert_found(arm, answer, q, far, len(q))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "number"), some([("rail_xarm5", 3, 17), ("concurrent234", 3, 22), ("puma_1e-7", 12, 7)], 3)
)
def test_next_to_self_motions_what_is_missed_is_said(name, seed, number):
    """A slide that is nearly free, 17 lengths away; a fold whose roots are 3e-5 apart; an odd number, and no fold."""
    assert_all_found_near_singular(arms.arms()[name], seed, number)


@pytest.mark.slow
def test_near_singularities_of_structured_arms(hunt):
    """Arms with right angles, equal lengths, zeros and slides."""
    rng, count = hunt.rng(), hunt.cases(6)
    for i in range(count):
        arm = continuation.structured_arm(rng, i)
        plan = arm.system.ik_all(arm.model.fk(arm.random(0, 1)), arm.frame).plan
        if plan.method != "search" and not plan.locked:
            assert_all_found_near_singular(arm, int(rng.integers(1 << 30)), 2)


POLAR = {  # rows (a, alpha, d, kind) and a task
    "RRP": ([(0, H, 0.2, "R"), (0, H, 0, "R"), (0.3, 0, 0, "P")], "position"),
    "PRR": ([(0, H, 0, "P"), (0, H, 0.2, "R"), (0.3, 0, 0, "R")], "position"),
    "PPRRR": ([(0, H, 0, "P"), (0, H, 0.2, "P"), (0, H, 0, "R"), (0, -H, 0, "R"), (0.1, 0, 0.1, "R")], "pose"),
    "RRPRRR": ([(0, H, 0.2, "R"), (0, H, 0, "R"), (0, 0, 0, "P"), (0, H, 0, "R"), (0, -H, 0, "R"), (0.1, 0, 0.1, "R")],
               "pose"),
}  # fmt: skip


@pytest.mark.parametrize("name", POLAR)
@pytest.mark.parametrize("error", [1e-5, 1e-4, 1e-3])
def test_axes_that_meet_but_for_calibration_are_no_unit_for_slides(name, error):
    """Offsets of hundredths of a millimetre beside slides of a metre."""
    rows, task = POLAR[name]
    e = error * np.random.default_rng(1).standard_normal((len(rows), 4))
    kinds = {"P": "prismatic", "R": "revolute"}
    table = [(a + x[0], t + x[1], d + x[2], x[3], kinds[k]) for (a, t, d, k), x in zip(rows, e, strict=True)]
    arm = arms.table(name, table, "polar", 16)
    q = np.random.default_rng(0).uniform(-2, 2, (60, len(rows)))
    answer = arm.system.ik_all(arm.model.fk(q), arm.frame, task=task)
    theta = arm.model.theta(np.where(answer.mask[..., None], answer.q, 0.0))
    gap = np.where(answer.mask, arm.model.apart(theta, arm.model.theta(q)[:, None]), np.inf).min(axis=1)
    assert gap.max() < 1e-6
    assert answer.complete.mean() > 0.5


FEW = [
    ("RRRRR", "pose"), ("RRRRR", "position_axis"), ("RPRRR", "pose"), ("PRRRR", "position_axis"),
    ("RRPRR", "position_axis"), ("RRRR", "pose"), ("RRR", "position"), ("RRR", "orientation"), ("RPR", "position"),
    ("PRR", "position"), ("RRP", "position"),
]  # fmt: skip


@pytest.mark.parametrize(("kinds", "task"), some(FEW, 4))
def test_structured_arms_of_few_joints(kinds, task, hunt):
    """Judged by what gave the target, and by solutions of targets aside that Newton's method follows to it."""
    rng = hunt.rng()
    for _ in range(hunt.cases(1)):
        error = 10.0 ** rng.uniform(-6, -3) if rng.random() < 1 / 3 else 0.0
        rows = []
        for kind in kinds:
            e = error * rng.standard_normal(4)
            a, t, d = (rng.choice(x) for x in (continuation.LENGTHS, continuation.TWISTS, continuation.LENGTHS))
            rows.append((a + e[0], t + e[1], d + e[2], e[3], "prismatic" if kind == "P" else "revolute"))
        arm = arms.table(kinds, rows, "structured", 16)
        assert not false_of(arm, task, rng, 20), f"{rows}"


def false_of(arm: arms.Arm, task: str, rng: np.random.Generator, count: int) -> list[tuple]:
    """Regular solutions that answers said to be complete have not: (q that gave the target, solution)."""
    m = arm.model
    shape = (count, arm.system.nq)
    q = 0.25 * PI * rng.integers(-4, 5, shape) + np.where(rng.random(shape) < 0.4, rng.uniform(-1, 1, shape), 0.0)
    X = m.fk(q)
    answer = arm.system.ik_all(X, arm.frame, task=task)
    if answer.plan.locked or answer.plan.method == "search":
        return []
    scale = np.where(m.kinds == oracle.SLIDE, m.size, 1.0)
    near = arm.system.ik_all(m.fk(q + 1e-4 * rng.standard_normal(shape)), arm.frame, task=task)
    known = [(i, m.theta(x)) for i, x in enumerate(q)]
    known += [(i, m.theta(near.q[i, k])) for i, k in zip(*np.nonzero(near.mask), strict=True)]
    false = []
    for i, start in known:
        theta, done = oracle.newton(m, X[i], start[None], task)
        if not answer.complete[i] or not done[0] or m.condition(theta[0], task) < 1e-4:
            continue
        off = np.abs(m.wrapped(m.theta(answer.q[i][answer.mask[i]]) - theta[0]) / scale).max(axis=-1)
        if off.min(initial=np.inf) > 1e-5:
            false.append((q[i].tolist(), theta[0].tolist()))
    return false
