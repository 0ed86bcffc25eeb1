from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from chain_problems import (
    PLANAR,
    POINT,
    POSE,
    POSITION,
    distance,
    floating_arm,
    free,
    judge,
    limited,
    planar_arm,
    points,
    solve,
)
from primitive_tables import Row, Table, pose, random_pose, random_table
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from kempe.kernels.base.search_layout import BAD_INPUT, NOT_FOUND, SOLVED
from kempe.kernels.forward.table_layout import BALL, SLIDE, TURN


def same(a, b):
    return all(
        np.array_equal(x, y, equal_nan=True)
        for x, y in zip(vars(a).values(), vars(b).values(), strict=True)
    )


def rows_of(answers, chosen):
    return {k: v[chosen] for k, v in vars(answers).items() if k != "missed"}


def random_chain(seed, n_rows=8, **options):
    """Shared coordinates, slides, balls, reversed and scaled rows, gauges; limits of +-2."""
    rng = np.random.default_rng(seed)
    return limited(random_table(rng, n_rows, chain=True, **options), -2.0, 2.0), rng


@pytest.mark.parametrize("seed", range(12))
def test_reachable_targets_of_random_chains(seed):
    chain, rng = random_chain(seed)
    targets, _ = chain.reachable(rng, 50)
    answers = solve(chain, targets)
    assert judge(chain, answers, targets).all()
    assert answers.residual.max() < 1e-6 and np.median(answers.residual) < 1e-12


def test_floating_base():
    chain = floating_arm()
    rng = np.random.default_rng(5)
    targets, _ = chain.reachable(rng, 100)
    targets[50:, :3, 3] *= 1000.0  # far away, but the base goes anywhere
    answers = solve(chain, targets)
    assert judge(chain, answers, targets).all()
    assert np.allclose(np.linalg.norm(answers.q[:, 3:7], axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize(
    ("n", "mask"),
    [
        *((2, mask) for mask in (POSITION, POINT)),
        *((n, mask) for n in (3, 10, 40) for mask in (POSITION, POINT, PLANAR, POSE)),
    ],
)
def test_planar_arms(n, mask):
    chain = planar_arm(*[1.0 / n] * n)
    rng = np.random.default_rng(n)
    targets, _ = chain.reachable(rng, 100)
    answers = solve(chain, targets, mask)
    assert judge(chain, answers, targets, mask).all()
    assert np.abs(answers.q).max() <= np.pi


@pytest.mark.parametrize(
    "radius, distances",
    [(0.8, 0.0), (0.2, 0.0), (0.92, 0.12), (5.0, 4.2), (0.05, 0.15), (0.0, 0.2)],
)
def test_two_links_at_and_beyond_the_boundary(radius, distances):
    chain = planar_arm(0.5, 0.3)
    angles = np.linspace(0.0, 2 * np.pi, 65)
    targets = points(radius * np.c_[np.cos(angles), np.sin(angles), 0.0 * angles])
    answers = solve(chain, targets, POSITION)
    assert judge(chain, answers, targets, POSITION).all() == (distances == 0.0)
    assert np.abs(answers.residual[:, 0] - distances).max() < (1e-6 if distances == 0.0 else 1e-11)
    assert (answers.status == (SOLVED if distances == 0.0 else NOT_FOUND)).all()


def test_nearest_when_a_limit_blocks():
    chain = limited(planar_arm(1.0).table, 0.0, 0.5)
    angles = np.linspace(0.6, 1.5, 20)
    answers = solve(
        chain, points(np.c_[np.cos(angles), np.sin(angles), 0 * angles]), POSITION, starts=4
    )
    assert (answers.q == 0.5).all() and (answers.status == NOT_FOUND).all()
    assert np.allclose(answers.residual[:, 0], 2 * np.sin((angles - 0.5) / 2), rtol=0, atol=1e-14)


@pytest.mark.parametrize("mask", [POSITION, POSE])
def test_nearest_of_three_slides_is_the_nearest_corner_of_the_box(mask):
    gantry = floating_arm().table.rows[:3]
    chain = limited(
        Table(gantry, [(2, False, pose(gantry[2].X[:3, :3] @ gantry[0].X[:3, :3]))], 3, 3, True),
        -1.0,
        2.0,
    )
    wanted = np.random.default_rng(0).uniform(-5, 5, (50, 3))
    targets = points(wanted)
    targets[:, :3, :3] = chain.forward(np.zeros(3))[:3, :3]
    answers = solve(chain, targets, mask)
    # each slide moves along one axis of the ground
    axes = np.array([chain.forward(x)[:3, 3] for x in np.eye(3)])
    best = np.clip(wanted, *np.sort([-axes.sum(axis=0), 2 * axes.sum(axis=0)], axis=0))
    assert np.allclose(
        answers.residual[:, 0], np.linalg.norm(wanted - best, axis=1), rtol=0, atol=1e-12
    )
    judge(chain, answers, targets, mask)


def descend_elsewhere(chain, target, mask, length, q0):
    """Least weighted distance that SciPy's bounded quasi-Newton method finds from q0; no balls."""
    rows = np.array(mask, dtype=float)
    nv = chain.table.nv

    def cost(x):
        q = np.r_[x, q0[nv:]]
        T = chain.table.poses(q)[0]
        turn = Rotation.from_matrix(target[:3, :3] @ T[:3, :3].T).as_rotvec()
        e = rows * np.r_[(target - T)[:3, 3] / length, turn]
        J = chain.table.jacobian(q, 0)
        return 0.5 * e @ e, -(J[:3].T @ (rows[:3] * e[:3]) / length + J[3:].T @ (rows[3:] * e[3:]))

    bounds = list(zip(chain.lower, chain.upper, strict=True))
    options = {"ftol": 1e-15, "gtol": 1e-10, "maxiter": 2000, "maxfun": 4000}
    return np.sqrt(
        2 * minimize(cost, q0[:nv], jac=True, method="L-BFGS-B", bounds=bounds, options=options).fun
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 6))]
)
@pytest.mark.parametrize("mask", [POSITION, POSE])
def test_nearest_is_a_local_minimum_of_the_distance(seed, mask):
    """From the answer an independent optimiser finds no way down, from random starts nothing
    nearer.
    """
    rng = np.random.default_rng(seed)
    table = random_table(rng, 6, chain=True, kinds=(TURN, TURN, SLIDE))
    chain = limited(table, -1.5, 1.5)
    targets = np.array([pose(random_pose(rng)[:3, :3], rng.normal(size=3) * 8) for _ in range(4)])
    answers = solve(chain, targets, mask, length=0.7)
    judge(chain, answers, targets, mask)
    for target, q, (linear, angular) in zip(targets, answers.q, answers.residual, strict=True):
        reached = np.hypot(linear / 0.7, angular)
        assert descend_elsewhere(chain, target, mask, 0.7, q) > reached - 1e-9
        elsewhere = min(
            descend_elsewhere(chain, target, mask, 0.7, rng.uniform(-1.5, 1.5, table.nq))
            for _ in range(5)
        )
        assert elsewhere > reached - 1e-7


def test_nearest_with_balls_is_stationary():
    """Along no velocity of the chain does the distance decrease to first order, nor to second."""
    rng = np.random.default_rng(2)
    kinds = [
        (BALL, 0, 0, 1.0),
        (TURN, 4, 3, -0.7),
        (BALL, 5, 4, -1.0),
        (SLIDE, 9, 7, 1.0),
        (TURN, 4, 3, 1.0),
    ]
    rows = [
        Row(kind, i - 1, iq, iv, random_pose(rng), 0.0, m)
        for i, (kind, iq, iv, m) in enumerate(kinds)
    ]
    table = Table(rows, [(4, False, random_pose(rng))], 10, 8, True, [(0, 0), (5, 4)])
    chain = limited(table, -1.0, 1.0)
    targets = points(rng.normal(size=(10, 3)) * 20)
    answers = solve(chain, targets, length=1.0)
    for target, q in zip(targets, answers.q, strict=True):
        here = np.hypot(*distance(chain, q, target))
        for _ in range(40):
            v = rng.normal(size=table.nv) * 1e-3
            moved = table.moved(q, v)
            for r in table.rows:
                if r.kind != BALL:
                    moved[r.iq] = np.clip(moved[r.iq], -1.0, 1.0)
            assert np.hypot(*distance(chain, moved, target)) > here - 1e-9


@pytest.mark.parametrize("size", [1e-3, 1.0, 100.0])
def test_size_does_not_matter(size):
    rng = np.random.default_rng(4)
    table = random_table(rng, 7, chain=True, kinds=(TURN, TURN, TURN, SLIDE), plain=True)
    for r in table.rows:
        r.X[:3, 3] *= size
    table.outputs[0][2][:3, 3] *= size
    slides = np.array(
        [any(r.iv == v and r.kind == SLIDE for r in table.rows) for v in range(table.nv)]
    )
    limit = np.where(slides, 2.0 * size, 2.0)
    chain = limited(table, -limit, limit)
    targets = np.array(
        [chain.forward(x) for x in rng.uniform(-1, 1, (200, table.nq)) * np.r_[limit, 0.0]]
    )
    answers = solve(chain, targets, tol=1e-6 * min(size, 1.0))
    assert judge(chain, answers, targets, tol=1e-6 * min(size, 1.0)).all()
    assert answers.steps.mean() < 60


def test_circular_coordinates_come_back_into_their_limits_near_the_seed():
    chain = limited(planar_arm(0.5, 0.3, 0.2).table, -2 * np.pi, 2 * np.pi, 1)
    rng = np.random.default_rng(1)
    targets, _ = chain.reachable(rng, 200)
    seeds = rng.uniform(-2 * np.pi, 2 * np.pi, (200, 1, 3))
    answers = solve(chain, targets, PLANAR, seeds)
    assert judge(chain, answers, targets, PLANAR).all()
    away = answers.q - seeds[:, 0]
    nearer = answers.q - 2 * np.pi * np.sign(away)
    assert ((np.abs(away) <= np.pi + 1e-9) | (np.abs(nearer) > 2 * np.pi)).all()


def test_unlimited_coordinates_come_back_to_the_seed_or_to_half_a_turn():
    chain = planar_arm(0.5, 0.3, 0.2)
    targets, _ = chain.reachable(np.random.default_rng(1), 50)
    assert np.abs(solve(chain, targets, PLANAR).q).max() <= np.pi
    far = np.full((1, 1, 3), 1000.0)
    answers = solve(chain, targets, PLANAR, far)
    assert (
        judge(chain, answers, targets, PLANAR).all()
        and np.abs(answers.q - 1000.0).max() <= np.pi + 1e-9
    )


def test_a_seed_that_solves_is_the_answer():
    chain, rng = random_chain(3)
    targets, q = chain.reachable(rng, 20)
    answers = solve(chain, targets, seeds=q[:, None])
    read = sorted({r.iq for r in chain.table.rows if r.kind != BALL})
    assert (answers.starts == 1).all() and (answers.steps <= 2).all()
    assert np.abs(answers.q - q)[:, read].max() < 1e-9


def test_seeds_outside_the_limits_are_brought_inside():
    chain = limited(planar_arm(0.5, 0.3).table, -1.0, 1.0)
    answers = solve(chain, points([[0.1, 0.1, 0.0]]), POSITION, seeds=[[[7.0, -9.0]]], starts=1)
    assert judge(
        chain, answers, points([[0.1, 0.1, 0.0]]), POSITION
    ).sum() == 0 and chain.within_limits(answers.q[0])


def test_later_seeds_are_tried_when_the_first_fails():
    arm = planar_arm(0.5, 0.3)
    target = points(arm.forward(np.array([0.4, 0.9]))[:3, 3])
    # stretched towards the target: no step leads out
    singular = np.arctan2(target[0, 1, 3], target[0, 0, 3])
    answers = solve(arm, target, POSITION, seeds=[[[singular, 0.0], [0.4, 0.9]]])
    assert answers.starts[0] == 2 and np.allclose(answers.q, [[0.4, 0.9]])


def test_batch_equals_one_by_one_and_repeats_in_threads():
    chain, rng = random_chain(7)
    targets, _ = chain.reachable(rng, 40)
    targets[::5, :3, 3] += 50.0  # some of them out of reach
    whole = solve(chain, targets)
    assert (whole.status == NOT_FOUND).sum() >= 8
    singles = [solve(chain, targets[i : i + 1]) for i in range(40)]
    for i, single in enumerate(singles):
        expected = rows_of(whole, slice(i, i + 1))
        assert all(np.array_equal(v, expected[k]) for k, v in rows_of(single, slice(None)).items())
    with ThreadPoolExecutor(2) as pool:
        assert all(same(whole, a) for a in pool.map(lambda _: solve(chain, targets), range(6)))


def test_random_starts_depend_on_the_seed_and_on_nothing_else():
    chain = planar_arm(*[0.2] * 6)
    targets, _ = chain.reachable(np.random.default_rng(0), 1)
    one, other, again = (solve(chain, targets, PLANAR, seed=s).q for s in (1, 2, 1))
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    same_goal = solve(chain, np.repeat(targets, 20, axis=0), PLANAR).q
    assert np.array_equal(same_goal, np.repeat(one, 20, axis=0))


def spoil(pose_, how):
    if how == "scaled":
        pose_[:3, :3] *= 1.001
    elif how == "mirrored":
        pose_[:3, 0] *= -1
    else:
        pose_[how[0], how[1]] = how[2]


@pytest.mark.parametrize(
    "how", ["scaled", "mirrored", (0, 3, np.nan), (1, 3, np.inf), (2, 2, np.nan), (0, 3, 1e200)]
)
def test_a_bad_target_becomes_nan_and_leaves_the_others_alone(how):
    chain, rng = random_chain(1)
    targets, _ = chain.reachable(rng, 9)
    clean = solve(chain, targets)
    for i in (0, 4, 8):
        spoil(targets[i], how)
    answers = solve(chain, targets)
    rest = [1, 2, 3, 5, 6, 7]
    assert answers.missed == 3 and (answers.status[[0, 4, 8]] == BAD_INPUT).all()
    assert np.isnan(answers.q[[0, 4, 8]]).all() and np.isnan(answers.residual[[0, 4, 8]]).all()
    assert all(
        np.array_equal(v, rows_of(clean, rest)[k]) for k, v in rows_of(answers, rest).items()
    )


def test_what_the_task_does_not_read_may_be_nan():
    chain = planar_arm(0.5, 0.3)
    targets = points([[0.4, 0.3, np.nan]])
    targets[:, :3, :3] = np.nan
    assert solve(chain, targets, POINT).status[0] == SOLVED
    assert solve(chain, targets, POSITION).status[0] == BAD_INPUT


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_bad_seed_becomes_nan(value):
    chain, rng = random_chain(1)
    targets, q = chain.reachable(rng, 3)
    seeds = q[:, None].repeat(2, axis=1)
    seeds[1, 1, chain.table.rows[0].iq] = value
    answers = solve(chain, targets, seeds=seeds)
    assert answers.status.tolist() == [SOLVED, BAD_INPUT, SOLVED] and np.isnan(answers.q[1]).all()


def test_a_quaternion_without_norm_is_a_bad_seed():
    chain = floating_arm()
    targets, q = chain.reachable(np.random.default_rng(0), 1)
    q[:, 3:7] = 0.0
    assert solve(chain, targets, seeds=q[:, None]).status[0] == BAD_INPUT


@pytest.mark.parametrize("angle", [np.pi, np.pi - 1e-9, np.pi - 1e-3, 3.0, 1e-9])
def test_half_turns(angle):
    ball = Table([Row(BALL, -1, 0, 0, pose())], [(0, False, pose())], 4, 3, True, [(0, 0)])
    axes = np.random.default_rng(0).normal(size=(30, 3))
    axes[:6] = np.r_[np.eye(3), -np.eye(3)]
    turns = Rotation.from_rotvec(angle * axes / np.linalg.norm(axes, axis=1)[:, None]).as_matrix()
    targets = np.array([pose(R) for R in turns])
    chain = limited(ball, -np.inf, np.inf)
    answers = solve(chain, targets, seeds=[[[1.0, 0.0, 0.0, 0.0]]], starts=1)
    assert judge(chain, answers, targets).all() and (answers.steps <= 8).all()


def test_no_rows_and_no_targets():
    X = random_pose(np.random.default_rng(0))
    fixed = limited(Table([], [(-1, False, X)], 0, 0, True), 0.0, 0.0)
    answers = solve(fixed, np.array([X, pose()]))
    assert answers.status.tolist() == [SOLVED, NOT_FOUND]
    assert solve(planar_arm(1.0), np.empty((0, 4, 4))).missed == 0


def test_equal_and_huge_limits():
    chain = planar_arm(0.5, 0.3, 0.2)
    limits = limited(chain.table, [-1.7e308, 0.3, -1e308], [1.7e308, 0.3, np.inf])
    targets = np.array(
        [
            limits.forward(q)
            for q in np.random.default_rng(0).uniform(-2, 2, (20, 3)) * [1, 0, 1] + [0, 0.3, 0]
        ]
    )
    answers = solve(limits, targets, POINT)
    assert judge(limits, answers, targets, POINT).all() and (answers.q[:, 1] == 0.3).all()


def test_unlimited_random_chains_need_few_starts():
    for seed in range(5):
        chain, rng = random_chain(seed, 9, kinds=(TURN,), plain=True)
        chain = free(chain)
        targets, _ = chain.reachable(rng, 100)
        answers = solve(chain, targets)
        assert (
            judge(chain, answers, targets).all()
            and answers.starts.mean() < 1.5
            and answers.steps.mean() < 20
        )
