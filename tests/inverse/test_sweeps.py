"""Sweeps over a joint for each task: the solutions at a value are those of `ik_all`, ends lie where
a limit is met.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import numpy as np
import pytest
from hunts import some

import kempe
from kempe.inverse.sweep import ik_sweep
from kempe.inverse.sweep_curves import ChainMotion

AXIS = (0.6, 0.0, 0.8)
CASES = {
    "pose": ("RRRRRRR", (0.0, 0.0, 1.0)),
    "pose, slide": ("RRPRRRR", (0.0, 0.0, 1.0)),
    "position": ("RRRR", (0.0, 0.0, 1.0)),
    "position, slide": ("RPRR", (0.0, 0.0, 1.0)),
    "orientation": ("RRRR", (0.0, 0.0, 1.0)),
    "direction": ("RRR", AXIS),
    "position_axis": ("RRRRRR", AXIS),
}


def limited(arm: arms.Arm, q: np.ndarray, half: float) -> kempe.System:
    """The arm with limits around a configuration (nq,)."""
    m = arm.mechanism()
    for name, x in zip(arm.system.coordinate_names, q, strict=True):
        m.joints[name].limits[""] = (x - half, x + 0.8 * half)
    return m.build()


@pytest.mark.parametrize("case", some(CASES, 3))
@pytest.mark.parametrize("joint", [0, -1])
def test_solutions_at_a_value_are_those_with_the_joint_held(case, joint):
    kinds, axis = CASES[case]
    task = case.partition(",")[0]
    seed = 21
    arm = arms.random_arm(seed, kinds, task=task)
    q = arm.random(seed, 1)[0]
    system = limited(arm, q, 1.3)
    name = system.coordinate_names[joint]
    X = arm.model.fk(q)
    target = X[:3, 3] if task == "position" else X[:3, :3] @ axis if task == "direction" else X
    what = (task, axis) if axis == AXIS else task
    sweep = ik_sweep(system, target, "tool", name, task=what, n=21, budget=kempe.Budget(points=24))
    theta = arm.model.theta(sweep.q[sweep.mask])
    off = oracle.error(arm.model.pose(theta), X, task, axis)
    assert sweep.mask.any() and max(np.max(e) for e in off) < 1e-9
    assert any(low <= q[joint] <= high for low, high in sweep.feasible)
    for i, value in enumerate(sweep.values):
        held = system.ik_all(target, "tool", task=what, fixed={name: value})
        assert len(held) == sweep.mask[i].sum() and held.inside.sum() == sweep.inside[i].sum()
        rows = arm.model.theta(sweep.q[i][sweep.mask[i]])
        assert all(arm.model.apart(rows, x).min() < 1e-6 for x in arm.model.theta(held.q))


@pytest.mark.slow
def test_curves_are_followed_side_by_side(monkeypatch):
    """How often points are corrected does not grow with the number of curves and intervals."""
    calls: list[int] = []
    correct = ChainMotion.correct_points

    def count_calls(self, x, across, rounds=8):
        calls.append(len(x))
        return correct(self, x, across, rounds)

    monkeypatch.setattr(ChainMotion, "correct_points", count_calls)
    robot = kempe.load("panda")
    frame = "panda_hand_tcp"
    for q in robot.random(2, 4):
        calls.clear()
        sweep = robot.inverse.sweep(robot.fk(q, frame), frame)
        assert len(calls) < 150 and sweep.intervals
        calls.clear()
        best = sweep.best()
        assert best is not None and len(calls) <= 12
        at = sweep.at(best.value)
        away = np.abs(at.q - best.q).max(axis=1)
        assert away.min() < 1e-6 and at.inside[int(np.argmin(away))]
        # no value of a dense grid is better
        values = np.concatenate(
            [np.linspace(low, high, 200) for rows in sweep.intervals for low, high in rows]
        )
        held = robot.ik_all(
            np.broadcast_to(sweep.target, (len(values), 4, 4)),
            frame,
            fixed={sweep.parameter: values},
        )
        x = held.q[held.mask & held.inside][:, :7]
        low, high = robot.lower[:7], robot.upper[:7]
        margin = (2.0 * np.minimum(x - low, high - x) / (high - low)).min(axis=1)
        assert margin.max() <= best.score + 1e-9
