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
