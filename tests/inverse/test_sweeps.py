"""Sweeps over a joint for each task: the solutions at a value are those of `ik_all`, ends lie where
a limit is met.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import numpy as np
import pytest
from hunts import some
from test_ik_all_redundant import robot

import kempe
from kempe.inverse.sweep import ik_sweep
from kempe.kernels.compiled import chain_curves

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


def compute_gaps(rows: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Largest differences (k,) of configurations (k, n) of turning joints from q (n,)."""
    d = rows - q
    return np.abs(d - 2.0 * np.pi * np.round(d / (2.0 * np.pi))).max(axis=1, initial=0.0)


def assert_branches_are_solutions(name: str, rng: np.random.Generator, number: int) -> None:
    """Branches have the solutions of `ik_all` at any value, and end at folds and limits."""
    system, frame = robot(name)
    for q in system.random(rng, number):
        target = system.fk(q, frame)
        sweep = ik_sweep(system, target, frame, SEVEN[name], start=q)
        at = sweep.curves.lines.q_index
        own = system.coordinate_names.index(sweep.parameter)
        values = np.append(rng.uniform(*sweep.domain, 7), q[own])
        rows, mask = sweep.curves.compute_rows(values, None)
        fixed = {**sweep.held, sweep.parameter: values}
        held = system.ik_all(
            np.broadcast_to(target, (8, 4, 4)), frame, np.tile(q, (8, 1)), fixed=fixed
        )
        poses = np.tile(q, (*mask.shape, 1))
        poses[..., at] = rows
        assert np.abs(system.fk(poses[mask], frame) - target).max(initial=0.0) < 1e-9
        assert any(low - 1e-9 <= q[own] <= high + 1e-9 for low, high in sweep.feasible)
        sure = held.mask & (held.multiplicity == 1) & (held.condition < 1e4)
        for k, j in zip(*np.nonzero(sure), strict=True):
            assert compute_gaps(rows[k][mask[k]], held.q[k, j, at]).min(initial=np.inf) < 1e-6
        for branch, parts in enumerate(sweep.intervals):
            for end in np.ravel(parts):
                assert_end_is_special(sweep, system, frame, branch, float(end))


def assert_end_is_special(sweep, system, frame, branch, end) -> None:
    """At the end of an interval the parameter or a joint is at a limit, or it turns back."""
    if np.abs(end - np.array(sweep.domain)).min() < 1e-9:
        return
    x, there = sweep.curves.compute_rows(np.array([end]), np.array([branch]))
    assert there.all()
    at = sweep.curves.lines.q_index
    away = np.abs(sweep.curves.lines.limits - x[0, 0])
    with np.errstate(invalid="ignore"):  # no limit
        away -= 2.0 * np.pi * np.round(away / (2.0 * np.pi))
    q = sweep.near.copy()
    q[at] = x[0, 0]
    J = system.jacobian(q, frame)[:, sweep.curves.lines.v_index]
    joints = [n for n in sweep.curves.lines.names if n not in (sweep.parameter, *sweep.held)]
    J = J[:, [sweep.curves.lines.names.index(n) for n in joints]]
    fold = np.linalg.svd(J, compute_uv=False)[-1] < 1e-4
    assert fold or np.nanmin(np.abs(away)) < 1e-8


SEVEN = {
    "panda": None,
    "iiwa14": "q1",
    "gen3": "joint_3",
    "xarm7": None,
    "baxter": None,
    "pr2": None,
    "tiago_pro": None,
}
"""Arms of seven joints, and the parameter where it is not the usual one."""


@pytest.mark.parametrize("name", some(SEVEN, 3))
def test_branches_have_the_solutions_of_ik_all(name, hunt):
    assert_branches_are_solutions(name, hunt.rng(), hunt.cases(8))


@pytest.mark.slow
@pytest.mark.parametrize("name", SEVEN)
def test_hunt_branches_have_the_solutions_of_ik_all(name, hunt):
    assert_branches_are_solutions(name, hunt.rng(), hunt.cases(150))


@pytest.mark.slow
def test_curves_are_followed_side_by_side(monkeypatch):
    """How often kernels are called does not grow with the number of values, curves and intervals."""
    calls: list[str] = []

    class Counted:
        """The kernels, with a list of those that are called."""

        def __getattr__(self, name):
            calls.append(name)
            return getattr(chain_curves, name)

    monkeypatch.setattr("kempe.inverse.sweep_curves.chain_curves", Counted())
    robot = kempe.load("panda")
    frame = "panda_hand_tcp"
    for q in robot.random(2, 4):
        calls.clear()
        robot.inverse.sweep(robot.fk(q, frame), frame, budget=kempe.Budget(points=64))
        few = len(calls)
        calls.clear()
        sweep = robot.inverse.sweep(robot.fk(q, frame), frame)
        assert len(calls) <= few + 2 <= 14 and sweep.intervals
        calls.clear()
        best = sweep.best()
        assert best is not None and len(calls) <= 14
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
