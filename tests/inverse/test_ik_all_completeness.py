"""`complete` of `ik_all` on special poses of special arms, judged by solutions that another method
knows.

Solutions of targets a little aside are followed to the special target by Newton's method in numpy
(`continuation`), and thousands of starts find those of a sample.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import continuation
import numpy as np
import pytest
from hunts import some

PI = np.pi
H = np.pi / 2

HC20 = [
    (0, -H, 0.38, 0),
    (0.82, PI, 0, -H),
    (0, -H, 0, 0),
    (0, H, -0.88, 0),
    (0, -H, -0.2, 0),
    (0, PI, -0.15, 0),
]

NAMED = [
    "jaco2",
    "gen3_lite",
    "xarm6",
    "crx10ia",
    "hc10",
    "piper",
    "m1013",
    "rail_xarm5",
    "ur5",
    "puma_lateral_tool",
    "puma_1e-5",
    "puma_1e-3",
    "ur10e_1e-5",
    "jaco2_1e-5",
    "randomRPRRPR_1",
    "stanford",
]


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
    return np.where(answer.mask, arm.model.apart(theta, arm.model.theta(q)[:, None]), np.inf).min(
        axis=1
    )


@pytest.mark.parametrize(
    ("name", "q", "count"),
    [
        ("hc20", [0, PI, -1.7902066, -H, H, 0], 8),
        ("xarm6", [0, PI, -2.71643, 0, -H, 0], 10),
        ("hc10", [0, H, 0.30774, H, -H, 0], 8),
    ],
)
def test_four_solutions_at_one_value_of_the_hidden_joint_are_distinguished(name, q, count):
    """Up to four share it, two of them 0.03 to 0.1 rad apart; then 18 % of the poses had two fewer,
    said complete.
    """
    arm, Q = on_a_line(name, q, 0, 1000)
    answer = arm.system.ik_all(arm.model.fk(Q), arm.frame)
    assert gaps(arm, answer, Q).max() < 1e-6
    assert (answer.mask.sum(axis=1) == count).all() and answer.complete.all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crx10ia", "hc10"])
def test_points_of_a_curve_leave_room_for_the_isolated_solutions(name):
    """A self-motion gives any number of rows; the isolated solutions come first, or the answer is
    not complete.
    """
    at = {"crx10ia": [0.89, 0.0, H, 1.77, H, -0.3], "hc10": [2.7, 0.0, PI, 0.85, H, 1.8]}[name]
    arm, Q = on_a_line(name, at, 1, 40)
    Q[:, 3] = np.random.default_rng(2).uniform(-3, 3, len(Q))
    X = arm.model.fk(Q)
    answer = arm.system.ik_all(X, arm.frame)
    where, theta, weak = continuation.solutions(arm, X, Q, np.random.default_rng(3))
    assert len(where) > 40
    missed = continuation.missed(arm, answer, where, theta, weak)
    assert not (missed & answer.complete[where]).any()


SHARING = {  # rows (a, alpha [degrees], d, type) and a configuration
    "closed form": ([(0.3, 60, 0.3, "prismatic"), (0, -90, 0.5), (0, 90, 0), (0.3, 60, 0.3), (0.3, -90, 0.3),
                (0.3, 90, 0.3)],
               [-0.726509, -H, -1.349116, H, -H, 3.484955]),
    "elimination": ([(-0.2, -90, 0.5, "prismatic"), (0.3, 90, 0.5), (0.3, 180, -0.2), (0, 60, 0.5), (0.3, 90, 0.3),
                     (0.3, -90, 0)], [0.063988483, 1.581321318, 0, H, -H, -0.101023264]),
}  # fmt: skip


@pytest.mark.parametrize("method", SHARING)
def test_two_solutions_that_differ_in_a_slide_and_its_neighbours_only(method):
    """Three joints have the same values in both: what the first are computed from does not say all
    of the others.
    """
    rows, q = SHARING[method]
    arm = arms.table(
        method, [(a, np.radians(t), d, 0.0, *kind) for a, t, d, *kind in rows], "structured", 16
    )
    answer = arm.system.ik_all(arm.model.fk(np.array([q])), arm.frame)
    assert answer.plan.method.word == method
    assert answer.mask.sum() == 8 and answer.complete.all()


def moved(arm: arms.Arm, rng: np.random.Generator, q: np.ndarray) -> tuple[int, int]:
    """(poses judged, poses whose answer is not complete): answers have the configuration that gave
    the target.

    And where the first and the last joint are moved, the same solutions moved with them.
    """
    model = arm.model
    d = np.zeros(q.shape)
    d[:, [0, -1]] = rng.uniform(-2, 2, (len(q), 2))
    answers = [arm.system.ik_all(model.fk(x), arm.frame) for x in (q, q + d)]
    if answers[0].plan.method.word == "search" or answers[0].plan.locked:
        return 0, 0
    scale = np.where(model.kinds == oracle.SLIDE, model.size, 1.0)
    shift = model.theta(q + d) - model.theta(q)
    angles = []
    for i, answer in enumerate(answers):
        angles.append(
            model.theta(np.where(answer.mask[..., None], answer.q, 0.0)) - i * shift[:, None]
        )
        lost = (gaps(arm, answer, q + i * d) > 1e-6) & (
            regularity(model, model.theta(q + i * d), scale) > 1e-4
        )
        assert not (lost & answer.complete).any(), (
            f"{arm.name}: complete without the given one, steps {arm.steps}"
        )
    for here, there in ((0, 1), (1, 0)):
        off = np.abs(model.wrapped(angles[here][:, :, None] - angles[there][:, None]) / scale).max(
            axis=-1
        )
        off = np.where(answers[there].mask[:, None], off, np.inf).min(axis=-1)
        at = np.nonzero(answers[here].mask & (off > 1e-5) & answers[there].complete[:, None])
        false = regularity(model, model.theta(answers[here].q[at]), scale) > 1e-4
        assert not false.any(), (
            f"{arm.name}: {answers[here].q[at][false][0].tolist()} is missed when joints 1 and 6 "
            f"are moved, for q = {q[at[0][false][0]].tolist()}, steps {arm.steps}"
        )
    return 2 * len(q), sum(int((~answer.complete).sum()) for answer in answers)


def regularity(model: oracle.Model, theta: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Smallest singular value of the Jacobian over the largest, (m,) of configurations (m, n)."""
    if not len(theta):
        return np.zeros(0)
    J = model.jacobian(theta)
    J[:, :3] /= model.size
    values = np.linalg.svd(J * scale, compute_uv=False)
    return values[:, -1] / values[:, 0]


def poses(arm: arms.Arm, rng: np.random.Generator, count: int) -> np.ndarray:
    """Structured configurations (count, nq); half of them on lines, right angles but for one joint
    and the ends.
    """
    q = continuation.structured_poses(arm, rng, count)
    half = count // 2
    n = q.shape[1]
    line = PI * rng.choice([0, 0.25, 0.5, 0.5, -0.5, -0.5, 1.0, -0.25], (half, n))
    line[np.arange(half), rng.integers(1, n - 1, half)] = rng.uniform(-PI, PI, half)
    line[:, [0, -1]] = rng.uniform(-3, 3, (half, 2))
    slides = np.zeros(n, dtype=bool)
    slides[arm.model.index[arm.model.kinds == oracle.SLIDE]] = True
    q[:half] = np.where(slides, 0.1 * line, line)
    return q


def judged(arm: arms.Arm, rng: np.random.Generator, count: int) -> tuple[int, int]:
    """(poses judged, poses whose answer is not complete): structured poses whose answers miss
    nothing if complete.
    """
    q = continuation.structured_poses(arm, rng, count)
    X = arm.model.fk(q)
    answer = arm.system.ik_all(X, arm.frame)
    if answer.plan.method.word == "search" or answer.plan.locked:
        return 0, 0
    where, theta, weak = continuation.solutions(arm, X, q, rng)
    missed = continuation.missed(arm, answer, where, theta, weak)
    false = np.flatnonzero(missed & answer.complete[where])
    assert not len(false), (
        f"{arm.name}: complete without {theta[false[0]].tolist()}, for q = "
        f"{q[where[false[0]]].tolist()}; {len(np.unique(where[false]))} such poses of {count}, "
        f"steps {arm.steps}"
    )
    return count, int((~answer.complete).sum())


@pytest.mark.parametrize("name", some(["hc20", *NAMED], 3))
def test_no_solution_is_missed_where_the_answer_is_complete(name, hunt):
    """Structured poses of robots, so too of calibrated ones."""
    count = hunt.cases(60)
    poses, open_ = judged(arm_of(name), hunt.rng(), count)
    assert poses == count and open_ < 0.5 * count


def test_no_solution_is_missed_with_structured_arms(hunt):
    """Arms with right angles, equal lengths, zeros and slides, or nearly so."""
    rng = hunt.rng()
    poses = 0
    for i in range(hunt.cases(10)):
        poses += judged(continuation.structured_arm(rng, i), rng, 20)[0]
    assert poses > 0


@pytest.mark.parametrize(
    "name", ["jaco2", "gen3_lite", "xarm6", "crx10ia", "hc10", "piper", "puma_1e-3", "ur10e_1e-5"]
)
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
    arm = arm_of(name)
    rng = hunt.rng()
    X = arm.model.fk(continuation.structured_poses(arm, rng, hunt.cases(2)))
    answer = arm.system.ik_all(X, arm.frame)
    for i in np.flatnonzero(answer.complete):
        theta = arm.model.theta(answer.q[i][answer.mask[i]])
        for solution in oracle.isolated(arm.model, X[i], batch=300, rounds=3, singular=1e-4):
            assert arm.model.apart(theta, solution).min() < 1e-6


def test_moved_targets_have_the_same_solutions(hunt):
    """Robots and structured arms, a few of the poses of the long hunt."""
    rng = hunt.rng()
    count = 0
    for name in ("hc20", *NAMED):
        arm = arm_of(name)
        count += moved(arm, rng, poses(arm, rng, hunt.cases(40)))[0]
    for i in range(hunt.cases(10)):
        arm = continuation.structured_arm(rng, i)
        count += moved(arm, rng, poses(arm, rng, 20))[0]
    assert count > 0


@pytest.mark.slow
@pytest.mark.parametrize("part", range(5))
def test_long_hunt_for_missed_solutions(part, hunt):
    """10^5 structured poses in all: of the robots by turns, and of as many structured arms."""
    rng = hunt.rng()
    names = ["hc20", *NAMED]
    i = part
    total = np.zeros(2, dtype=int)
    try:
        while total[0] < hunt.cases(20_000):
            arm = arm_of(names[i % len(names)])
            total += moved(arm, rng, poses(arm, rng, 1000))
            for _ in range(4):
                i += 1
                arm = continuation.structured_arm(rng, i)
                total += moved(arm, rng, poses(arm, rng, 100))
    finally:
        print(f"part {part}: {total[0]} poses, {total[1]} answers not complete", flush=True)


@pytest.mark.slow
def test_followed_solutions_are_not_missed(hunt):
    """10^4 structured poses, judged by solutions that are followed from targets aside."""
    rng = hunt.rng()
    for name in ("hc20", *NAMED):
        judged(arm_of(name), rng, hunt.cases(400))
    for i in range(hunt.cases(100)):
        judged(continuation.structured_arm(rng, i), rng, 30)
