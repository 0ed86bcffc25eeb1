"""Eight starts side by side against starts one at a time, written apart; the rule by which the
answer is chosen.
"""

from __future__ import annotations

import numpy as np
import pytest
from chain_problems import (
    DIRECTION,
    ORIENTATION,
    PLANAR,
    POINT,
    POSE,
    POSITION,
    POSITION_AXIS,
    distance,
    free,
    judge,
    limited,
    planar_arm,
    points,
    solve,
)
from primitive_tables import Row, Table, pose, random_table
from scipy.spatial.transform import Rotation

from kempe.kernels.base.search_layout import ANSWER, NOT_FOUND, SOLVED
from kempe.kernels.compiled import schedule
from kempe.kernels.forward.table_layout import SLIDE, TURN

TASKS = {
    "pose": POSE,
    "position": POSITION,
    "orientation": ORIENTATION,
    "direction": DIRECTION,
    "position_axis": POSITION_AXIS,
    "some rows": (1, 0, 1, 0, 1, 1),
}
every_task = pytest.mark.parametrize("mask", TASKS.values(), ids=TASKS)


def chain_without_balls(seed, n=8, limit=2.0, **options):
    """Shared coordinates, slides, reversed and scaled rows, gauges."""
    rng = np.random.default_rng(seed)
    kinds = options.pop("kinds", (TURN, TURN, SLIDE))
    return limited(random_table(rng, n, chain=True, kinds=kinds, **options), -limit, limit), rng


def raw_answers(chain, targets, starts, seeds=None):
    """q and status as `reach_goals` leaves them, without the nearest of what was not reached."""
    n = len(targets)
    nq = chain.table.nq
    seeds = np.empty((1, 0, nq)) if seeds is None else seeds
    out = np.full((n, nq + ANSWER), 7.0)
    limits = np.array([chain.lower, chain.upper])
    task = np.r_[np.array((*POSE, 0)), chain.circular]
    schedule.reach_goals(
        *chain.table.pack(), limits, task, targets, seeds, 1, 0, starts, 20, 1e-6, 1e-6, 0.0, out
    )
    return out


@every_task
@pytest.mark.parametrize("seed", range(5))
def test_lanes_find_what_single_starts_find(seed, mask):
    """The same start reaches the goal, in as many steps, and at the same place."""
    chain, rng = chain_without_balls(seed)
    targets, _ = chain.reachable(rng, 60)
    fast = solve(chain, targets, mask)
    slow = solve(chain, targets, mask, slow=True)
    assert judge(chain, fast, targets, mask).all() and judge(chain, slow, targets, mask).all()
    same = (fast.starts == slow.starts) & (np.abs(fast.steps - slow.steps) <= 2 * fast.starts)
    assert same.mean() >= 0.9  # a step that rounding turns another way may lead elsewhere
    assert np.median(np.abs(fast.q - slow.q)[same].max(axis=1, initial=0.0)) < 1e-9


def test_what_the_task_does_not_read_stops_no_lane():
    arm = planar_arm(0.5, 0.3)
    targets = points([[0.4, 0.3, np.nan]] * 20)
    targets[:, :3, :3] = np.nan
    answers = solve(arm, targets, POINT)
    assert (answers.status == SOLVED).all() and (answers.steps < 20).all()


@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-9, np.pi - 1e-3, 3.0, 1e-9])
def test_half_turns_in_lanes(angle):
    """Three turning joints whose axes meet, from where the first and the last coincide nowhere
    near.
    """
    to_x = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_matrix()
    rows = [
        Row(TURN, -1, 0, 0, pose()),
        Row(TURN, 0, 1, 1, pose(to_x)),
        Row(TURN, 1, 2, 2, pose(to_x.T)),
    ]
    chain = free(limited(Table(rows, [(2, False, pose())], 3, 3, True), -np.inf, np.inf))
    start = np.array([[[0.3, 0.9, -0.2]]])
    axes = np.random.default_rng(0).normal(size=(40, 3))
    axes[:6] = np.r_[np.eye(3), -np.eye(3)]
    turns = Rotation.from_rotvec(angle * axes / np.linalg.norm(axes, axis=1)[:, None]).as_matrix()
    here = chain.forward(start[0, 0])[:3, :3]
    targets = np.array([pose(R @ here) for R in turns])
    answers = solve(chain, targets, ORIENTATION, seeds=start)
    assert judge(chain, answers, targets, ORIENTATION).all() and (answers.starts <= 3).all()


@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-9, 3.0, 1e-9, 0.0])
def test_opposite_directions(angle):
    chain, rng = chain_without_balls(3, kinds=(TURN,), plain=True)
    q = chain.random_q(rng, 20)
    targets = np.array([chain.forward(x) for x in q])
    for X in targets:
        across = np.cross(X[:3, 2], rng.normal(size=3))
        X[:3, :3] = (
            Rotation.from_rotvec(angle * across / np.linalg.norm(across)).as_matrix() @ X[:3, :3]
        )
    answers = solve(free(chain), targets, DIRECTION, seeds=q[:, None])
    assert judge(free(chain), answers, targets, DIRECTION).all() and (answers.starts == 1).all()


def test_the_answer_is_that_of_the_first_start_that_reaches_the_goal():
    """With fewer starts nothing is reached, with more it is the same answer."""
    chain, rng = chain_without_balls(7, 9, 1.5)
    targets, _ = chain.reachable(rng, 300)
    nq = chain.table.nq
    whole = raw_answers(chain, targets, 100)
    starts = whole[:, -1].astype(int)
    assert (whole[:, nq + 2] == SOLVED).all() and starts.max() > 3
    for i in np.flatnonzero(starts > 1)[:40]:
        n = int(starts[i])
        out = np.full((1, nq + ANSWER), 7.0)
        limits = np.array([chain.lower, chain.upper])
        task = np.r_[np.array((*POSE, 0)), chain.circular]
        for tries, expected in ((n - 1, NOT_FOUND), (n, SOLVED), (n + 1, SOLVED), (10 * n, SOLVED)):
            schedule.reach_goals(
                *chain.table.pack(),
                limits,
                task,
                targets[i : i + 1],
                np.empty((1, 0, nq)),
                1,
                0,
                tries,
                20,
                1e-6,
                1e-6,
                0.0,
                out,
            )
            assert out[0, nq + 2] == expected
            if expected == SOLVED:
                assert np.array_equal(out[0], whole[i])
        for first in range(n):  # starts that have been tried are left out
            schedule.reach_goals(
                *chain.table.pack(),
                limits,
                task,
                targets[i : i + 1],
                np.empty((1, 0, nq)),
                1,
                first,
                100,
                20,
                1e-6,
                1e-6,
                0.0,
                out,
            )
            assert np.array_equal(out[0, :nq], whole[i, :nq]) and out[0, -1] == n - first


def test_a_seed_that_leads_to_the_goal_is_preferred():
    chain, rng = chain_without_balls(2, 9)
    targets, q = chain.reachable(rng, 200)
    seeds = np.clip(q + rng.uniform(-0.2, 0.2, q.shape), -2.0, 2.0)[:, None]
    alone = solve(chain, targets, seeds=seeds, starts=1)
    among = solve(chain, targets, seeds=seeds)
    led = (alone.status == SOLVED) & (alone.steps <= 20)
    assert (
        led.sum() > 150
        and (among.starts[led] == 1).all()
        and np.array_equal(among.q[led], alone.q[led])
    )


def test_an_answer_depends_on_no_other_goal():
    """Goals in other company, bad ones and ones out of reach among them, and with other lanes free."""
    chain, rng = chain_without_balls(4, 9, 1.5)
    targets, _ = chain.reachable(rng, 60)
    whole = solve(chain, targets)
    for size in (1, 2, 7, 9, 33):
        part = solve(chain, targets[:size])
        assert np.array_equal(part.q, whole.q[:size]) and np.array_equal(
            part.steps, whole.steps[:size]
        )
    company = targets.copy()
    company[1::3, 0, 3] = np.nan
    company[2::3, :3, 3] += 100.0
    mixed = solve(chain, company, starts=100)
    assert np.array_equal(mixed.q[::3], whole.q[::3]) and np.array_equal(
        mixed.steps[::3], whole.steps[::3]
    )
    assert np.array_equal(mixed.starts[::3], whole.starts[::3])


@pytest.mark.parametrize("mask", [DIRECTION, POSITION_AXIS, ORIENTATION])
@pytest.mark.parametrize("seed", range(3))
def test_nearest_is_stationary(seed, mask):
    """Out of reach, no small motion inside the limits brings the tip nearer."""
    chain, rng = chain_without_balls(seed, 4, 0.6)
    targets = np.array(
        [
            pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3) * 3)
            for _ in range(6)
        ]
    )
    answers = solve(chain, targets, mask, length=1.0)
    judge(chain, answers, targets, mask)
    assert (answers.status == NOT_FOUND).any()
    for target, q in zip(
        targets[answers.status == NOT_FOUND], answers.q[answers.status == NOT_FOUND], strict=True
    ):
        here = np.hypot(*distance(chain, q, target, mask))
        for _ in range(60):
            moved = np.clip(q + rng.normal(size=q.size) * 1e-3, -0.6, 0.6)
            assert np.hypot(*distance(chain, moved, target, mask)) > here - 1e-9


def test_far_seeds():
    """Of circular joints they are turned back; of others the lanes' sine is lost far away, but
    never the truth.
    """
    arm = planar_arm(0.5, 0.3, 0.2)
    targets, _ = arm.reachable(np.random.default_rng(1), 20)
    answers = solve(arm, targets, PLANAR, seeds=np.full((1, 1, 3), 1e7))
    assert (
        judge(arm, answers, targets, PLANAR).all() and np.abs(answers.q - 1e7).max() <= np.pi + 1e-6
    )
    open_ended = limited(arm.table, -np.inf, np.inf)
    judge(
        open_ended,
        solve(open_ended, targets, PLANAR, seeds=np.full((1, 1, 3), 1e9), starts=3),
        targets,
        PLANAR,
    )
