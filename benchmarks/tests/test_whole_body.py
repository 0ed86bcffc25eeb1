"""Feet and hands of humanoids held at once: how many reachable goals are found, judged by
Pinocchio.
"""

from __future__ import annotations

import numpy as np
import pytest
from kempe_bench import whole
from kempe_bench.whole_peers import COARSE, FINE
from kempe_bench.whole_robots import BASE, HUMANOIDS, Body

import kempe
from kempe import tasks
from kempe.inverse.answer import Reached

pytest.importorskip("pinocchio")

GOALS = 300
LEAST = {False: 0.99, True: 0.98}
"""Part of the goals that is found, without and with the centre of mass."""


@pytest.fixture(scope="module", params=HUMANOIDS, ids=lambda robot: robot.title)
def body(request, tmp_path_factory) -> Body:
    found = request.param.body(tmp_path_factory.mktemp("bodies"))
    if found is None:
        pytest.skip("example-robot-data is not installed")
    return found


def held(body: Body, goals: np.ndarray) -> list[tasks.Task]:
    """The tasks for goals (..., k, 4, 4)."""
    out: list[tasks.Task] = [
        tasks.Pose(name, goals[..., i, :, :]) for i, name in enumerate(body.frames)
    ]
    return out if goals.shape[-3] == len(out) else [*out, tasks.CentreOfMass(goals[..., -1, :3, 3])]


def judge(
    body: Body,
    q: np.ndarray,
    success: np.ndarray,
    goals: np.ndarray,
    tolerance: tuple[float, float],
) -> None:
    """None of the successes is false, all answers are inside the limits, enough are found."""
    mass = goals.shape[1] > len(body.frames)
    loose = (1.001 * tolerance[0] + 1e-12, 1.001 * tolerance[1] + 1e-12)
    reached = whole.Line("", body, mass, loose, False).reached(q, goals)
    lower, upper = body.limits.T
    assert np.all(reached[success])
    assert np.all((q[:, BASE:] >= lower - 1e-12) & (q[:, BASE:] <= upper + 1e-12))
    assert reached.mean() >= LEAST[mass] and success.mean() >= LEAST[mass]


@pytest.mark.slow
@pytest.mark.parametrize("draw", [Body.anywhere, Body.standing])
@pytest.mark.parametrize("tolerance", [COARSE, FINE])
@pytest.mark.parametrize("mass", [False, True])
def test_reachable_goals_are_found(body, mass, tolerance, draw):
    """In one batch: 300 goals made by random configurations inside the limits, without a seed."""
    goals = whole.goals_of(body, draw(body, GOALS, np.random.default_rng(8)), mass)
    answer = body.system.ik(held(body, goals), tolerance=tolerance)
    assert isinstance(answer, Reached)
    judge(body, answer.q, answer.success, goals, tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [False, True])
def test_single_calls_find_as_much(body, mass):
    goals = whole.goals_of(body, body.anywhere(GOALS, np.random.default_rng(9)), mass)
    single = [body.system.ik(held(body, wanted)) for wanted in goals]
    judge(body, np.array([a.q for a in single]), np.array([a.success for a in single]), goals, FINE)


def test_both_feet_and_a_hand_are_held_and_no_more_is_claimed(body):
    """The fast form: goals near standing are all found; hands wanted out of reach are never called
    reached.
    """
    q = body.standing(6, np.random.default_rng(10))
    goals = whole.goals_of(body, q, True)
    answer = body.system.ik(held(body, goals))
    judge(body, answer.q, answer.success, goals, FINE)
    goals[:, 2, 2, 3] += 5.0
    far = body.system.ik(held(body, goals), budget=kempe.Budget(starts=2))
    assert not far.success.any() and np.isfinite(far.q).all()
    lower, upper = body.limits.T
    assert np.all((far.q[:, BASE:] >= lower - 1e-12) & (far.q[:, BASE:] <= upper + 1e-12))
