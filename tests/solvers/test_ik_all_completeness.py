"""`complete` of `ik_all` on special poses of special arms, judged by solutions that another method knows.

Solutions of targets a little aside are followed to the special target by Newton's method in numpy (`continuation`), and
thousands of starts find those of a sample.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import continuation
import numpy as np
import pytest

PI, H = np.pi, np.pi / 2

HC20 = [(0, -H, 0.38, 0), (0.82, PI, 0, -H), (0, -H, 0, 0), (0, H, -0.88, 0), (0, -H, -0.2, 0), (0, PI, -0.15, 0)]

NAMED = [
    "jaco2", "gen3_lite", "xarm6", "crx10ia", "hc10", "piper", "m1013", "rail_xarm5", "ur5", "puma_lateral_tool",
    "puma_1e-5", "puma_1e-3", "ur10e_1e-5", "jaco2_1e-5", "randomRPRRPR_1", "stanford",
]  # fmt: skip


def arm_of(name: str) -> arms.Arm:
    """A robot of the table of arms, or the Denavit-Hartenberg table of an HC20."""
    return arms.table("hc20", HC20, "offset 6R", 16) if name == "hc20" else arms.arms()[name]


def on_a_line(name: str, q, seed: int, count: int):
    """(arm, configurations (count, 6)): the first and the last joint anywhere, the others as in q."""
    rng = np.random.default_rng(seed)
    Q = np.tile(np.array(q, dtype=float), (count, 1))
    Q[:, 0], Q[:, 5] = rng.uniform(-3, 3, (2, count))
    return arm_of(name), Q


def gaps(arm: arms.Arm, answer, q) -> np.ndarray:
    """How far (N,) the nearest row is from the configurations q (N, nq)."""
    theta = arm.model.theta(np.where(answer.mask[..., None], answer.q, 0.0))
    return np.where(answer.mask, arm.model.apart(theta, arm.model.theta(q)[:, None]), np.inf).min(axis=1)


@pytest.mark.parametrize(
    ("name", "q", "count"),
    [
        ("hc20", [0, PI, -1.7902066, -H, H, 0], 8),
        ("xarm6", [0, PI, -2.71643, 0, -H, 0], 10),
        ("hc10", [0, H, 0.30774, H, -H, 0], 8),
    ],
)
def test_four_solutions_at_one_value_of_the_hidden_joint_are_told_apart(name, q, count):
    """Up to four share it, two of them 0.03 to 0.1 rad apart; then 18 % of the poses had two fewer, said complete."""
    arm, Q = on_a_line(name, q, 0, 1000)
    answer = arm.system.ik_all(arm.model.fk(Q), arm.frame)
    assert gaps(arm, answer, Q).max() < 1e-6
    assert (answer.mask.sum(axis=1) == count).all() and answer.complete.all()


@pytest.mark.parametrize("name", ["crx10ia", "hc10"])
def test_points_of_a_curve_leave_room_for_the_isolated_solutions(name):
    """A self-motion gives any number of rows; the isolated solutions come first, or the answer is not complete."""
    at = {"crx10ia": [0.89, 0.0, H, 1.77, H, -0.3], "hc10": [2.7, 0.0, PI, 0.85, H, 1.8]}[name]
    arm, Q = on_a_line(name, at, 1, 40)
    Q[:, 3] = np.random.default_rng(2).uniform(-3, 3, len(Q))
    X = arm.model.fk(Q)
    answer = arm.system.ik_all(X, arm.frame)
    where, theta, weak = continuation.solutions(arm, X, Q, np.random.default_rng(3))
    assert len(where) > 40
    missed = continuation.missed(arm, answer, where, theta, weak)
    assert not (missed & answer.complete[where]).any()


def judged(arm: arms.Arm, rng: np.random.Generator, count: int) -> tuple[int, int]:
    """(poses judged, poses whose answer is not complete): structured poses whose answers miss nothing if complete."""
    q = continuation.structured_poses(arm, rng, count)
    X = arm.model.fk(q)
    answer = arm.system.ik_all(X, arm.frame)
    if answer.plan.method == "search" or answer.plan.locked:
        return 0, 0
    where, theta, weak = continuation.solutions(arm, X, q, rng)
    missed = continuation.missed(arm, answer, where, theta, weak)
    false = np.flatnonzero(missed & answer.complete[where])
    assert not len(false), (
        f"{arm.name}: complete without {theta[false[0]].tolist()}, for q = {q[where[false[0]]].tolist()}; "
        f"{len(np.unique(where[false]))} such poses of {count}, steps {arm.steps}"
    )
    return count, int((~answer.complete).sum())


@pytest.mark.parametrize("name", ["hc20", *NAMED])
def test_no_solution_is_missed_where_the_answer_is_complete(name, hunt):
    """Structured poses of robots, so too of calibrated ones."""
    count = hunt.cases(60)
    poses, open_ = judged(arm_of(name), hunt.rng(), count)
    assert poses == count and open_ < 0.5 * count


def test_no_solution_is_missed_with_structured_arms(hunt):
    """Arms with right angles, equal lengths, zeros and slides, or nearly so."""
    rng, poses = hunt.rng(), 0
    for i in range(hunt.cases(10)):
        poses += judged(continuation.structured_arm(rng, i), rng, 20)[0]
    assert poses > 0


@pytest.mark.parametrize("name", ["jaco2", "gen3_lite", "xarm6", "crx10ia", "hc10", "piper", "puma_1e-3", "ur10e_1e-5"])
def test_answers_for_ordinary_poses_are_complete(name):
    """For all but one in a thousand random poses."""
    arm = arm_of(name)
    q = arm.random(17, 1000)
    answer = arm.system.ik_all(arm.model.fk(q), arm.frame)
    assert gaps(arm, answer, q).max() < 1e-6
    assert answer.complete.mean() >= 0.999


@pytest.mark.parametrize("name", ["hc20", "xarm6", "hc10", "crx10ia", "piper"])
def test_complete_answers_are_what_thousands_of_starts_find(name, hunt):
    """All solutions of a few structured poses, by Newton's method from anywhere."""
    arm, rng = arm_of(name), hunt.rng()
    X = arm.model.fk(continuation.structured_poses(arm, rng, hunt.cases(2)))
    answer = arm.system.ik_all(X, arm.frame)
    for i in np.flatnonzero(answer.complete):
        theta = arm.model.theta(answer.q[i][answer.mask[i]])
        for solution in oracle.isolated(arm.model, X[i], batch=300, rounds=3, singular=1e-4):
            assert arm.model.apart(theta, solution).min() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hc20", *NAMED])
def test_long_hunt_for_missed_solutions(name, hunt):
    """Thousands of structured poses of each robot; `--hunt-times 3` makes 10^5 of all."""
    arm, rng = arm_of(name), hunt.rng()
    for _ in range(hunt.cases(2)):
        judged(arm, rng, 1000)


@pytest.mark.slow
def test_long_hunt_with_structured_arms(hunt):
    """Many arms, few poses of each."""
    rng = hunt.rng()
    for i in range(hunt.cases(60)):
        judged(continuation.structured_arm(rng, i), rng, 50)
