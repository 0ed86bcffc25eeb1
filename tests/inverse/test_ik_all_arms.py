"""All inverse solutions of all arms: found, verified, counted, the same in every gauge, batch and
number of threads.
"""

from __future__ import annotations

import itertools
import math

import analytic_oracle as oracle
import arms
import numpy as np
import pytest
import reference
from hunts import some
from ik_all_checks import (
    SAME,
    allowed,
    ask,
    assert_distinct,
    assert_found,
    assert_sound,
    assert_true,
    can_be_inside,
    is_inside,
    model,
    near_singular,
    nearest,
    on_a_curve,
    on_a_family,
    rows,
    same_sets,
    square,
    turns,
)
from test_analytic_oracle import manseur_target

import kempe
from kempe.errors import InputError, NoSolutionError, UnknownNameError, UnsupportedError

ARMS = arms.arms()
every_arm = pytest.mark.parametrize("name", ARMS)

TYPICAL = [
    "puma560",
    "ur10e",
    "jaco2",
    "crx10ia",
    "randomRRRRRR_3",
    "puma_1e-5",
    "stanford",
    "randomRRPRRR_2",
    "cobra600",
    "youbot",
    "so101_axis",
    "orthogonal3_cuspidal",
    "wrist3",
    "planar3",
    "universals",
    "geared_piper",
]
"""One or two arms of each class, for what need not be repeated on all."""
typical_arms = pytest.mark.parametrize("name", some(TYPICAL, 3))


def posed(name: str, seed: int, number: int):
    """An arm, configurations half of which are inside the limits, and their poses."""
    arm = ARMS[name]
    q = np.vstack([arm.inside(seed, number // 2), arm.random(seed, number - number // 2)])
    return arm, q, arm.model.fk(q)


# ---------------------------------------------------------------- found, verified, counted


@every_arm
def test_what_gave_the_target_is_found_and_all_answers_are_true(name):
    arm, q, X = posed(name, 1, 60)
    answer = ask(arm, X, q)
    assert_sound(arm, answer, X)
    assert_found(arm, answer, q)
    assert np.all(answer.complete)


@every_arm
def test_as_many_as_the_oracle_has(name):
    """Counts of thousands of Newton starts, frozen in `arms.COUNTS`."""
    arm = ARMS[name]
    at, counts = zip(*arms.COUNTS[name], strict=True)
    q = arm.random(arms.SEED, 40)[list(at)]
    answer = ask(arm, arm.model.fk(q), q)
    assert [len(found) for found in rows(answer)] == list(counts)
    assert (answer.multiplicity[answer.mask] == 1).all()


@typical_arms
def test_the_same_ones_as_the_oracle_has(name):
    arm, q, _ = posed(name, 2, 2)
    x = arm.random(arms.SEED, 40)[arms.COUNTS[name][1][0]]
    answer = ask(arm, arm.model.fk(x), x)
    found = oracle.isolated(model(arm, x), arm.model.fk(x), arm.task, arm.axis)
    assert same_sets(arm, arm.model.theta(answer.q), found)


def test_sixteen_real_solutions_of_manseur_and_doty():
    arm = ARMS["manseur_doty"]
    answer = ask(arm, manseur_target())
    assert_sound(arm, answer, manseur_target())
    assert len(answer) == 16 and answer.complete


@pytest.mark.parametrize(
    "p, expected",
    [
        ((0.6, 0.3), oracle.two_link(0.6, 0.3, 0.5, 0.4)),
        ((0.0, -0.7), oracle.two_link(0.0, -0.7, 0.5, 0.4)),
        ((0.9, 0.0), [(0.0, 0.0)]),
        ((0.0, -0.1), [(-math.pi / 2, math.pi)]),
        ((0.95, 0.0), []),
        ((0.05, 0.0), []),
    ],
)
def test_the_two_links_of_the_lecture(p, expected):
    """Two ways, one where it is stretched or folded, none beyond."""
    arm = ARMS["planar2"]
    answer = arm.system.ik_all(p, "tool")
    assert same_sets(arm, answer.q, np.array(expected).reshape(-1, 2))
    assert (answer.multiplicity == (2 if len(expected) == 1 else 1)).all() and bool(answer) == (
        len(expected) > 0
    )


def test_three_links_in_the_plane():
    arm = ARMS["planar3"]
    for q in arm.random(3, 20):
        X = arm.model.fk(q)
        phi = math.atan2(X[1, 0], X[0, 0])
        expected = np.array(oracle.three_link(X[0, 3], X[1, 3], phi - 0.3, 0.5, 0.4, 0.2))
        flat = np.array(
            [
                [math.cos(phi), -math.sin(phi), X[0, 3]],
                [math.sin(phi), math.cos(phi), X[1, 3]],
                [0, 0, 1],
            ]
        )
        for target in (X, flat):
            assert same_sets(arm, arm.system.ik_all(target, "tool").q, expected)


# ---------------------------------------------------------------- gauges


@pytest.mark.parametrize(
    "name",
    some([n for n, a in ARMS.items() if a.task == "pose" and not a.held and a.system.dim == 3], 4),
)
def test_no_gauge_changes_the_answer(name):
    """Base, tool, origins along and about axes, senses, names and their order."""
    arm = ARMS[name]
    at, counts = zip(*arms.COUNTS[name], strict=True)
    for seed, x, count in zip(range(2), arm.random(arms.SEED, 40)[list(at)], counts, strict=False):
        new, base, tool, signs = arms.regauged(arm, seed)
        target = base @ arm.model.fk(x) @ tool
        answer = new.system.ik_all(target, "tool")
        assert_sound(new, answer, target)
        assert len(answer) == count
        theta = arm.model.theta(ask(arm, arm.model.fk(x)).q)
        assert same_sets(new, new.model.theta(answer.q), signs * theta)


@pytest.mark.parametrize(
    "name", [n for n in TYPICAL if ARMS[n].task != "orientation" and ARMS[n].system.dim == 3]
)
def test_the_size_of_the_arm_does_not_matter(name):
    """Micrometres and kilometres: only the accuracy of positions follows the lengths."""
    arm = ARMS[name]
    assert not arm.held
    m = arm.model
    q = arm.random(5, 6)
    for size in (1e-3, 1e3):
        frames, tip = arms.frames_of(m)
        frames[:, :3, 3] *= size
        tip[:3, 3] *= size
        big = arms.placed("scaled", frames, m.kinds, tip, "", arm.bound)
        theta = m.theta(q) * np.where(m.kinds == oracle.SLIDE, size, 1.0)
        X = big.model.fk(theta)
        answer = big.system.ik_all(
            X, "tool", task=(arm.task, arm.axis), tolerance=1e-9 * max(1.0, size)
        )
        for found, wanted in zip(rows(answer), theta, strict=True):
            d = np.where(m.kinds == oracle.SLIDE, 1.0 / size, 1.0) * big.model.wrapped(
                found - wanted
            )
            assert np.abs(d).max(axis=-1).min(initial=np.inf) < SAME


# ---------------------------------------------------------------- batches and threads


@typical_arms
def test_a_batch_is_its_targets_one_by_one(name):
    arm, q, X = posed(name, 6, 10)
    together = ask(arm, X, q)
    for i in range(len(X)):
        alone = ask(arm, X[i], q[i])
        assert same_sets(arm, arm.model.theta(alone.q), arm.model.theta(rows(together)[i]), 1e-9)
        assert bool(alone.complete) == bool(together.complete[i])
        assert sorted(alone.multiplicity) == sorted(together.multiplicity[i][together.mask[i]])


@pytest.mark.parametrize("shape", [(1,), (2, 3), (2, 1, 2), (0,), (3, 0)])
@pytest.mark.parametrize("name", ["puma560", "jaco2", "cobra600", "planar2"])
def test_batches_of_any_shape(name, shape):
    arm = ARMS[name]
    number = math.prod(shape)
    q = arm.random(7, number)
    X = arm.model.fk(q).reshape(*shape, 4, 4)
    answer = ask(arm, X)
    K = answer.q.shape[-2]
    assert answer.q.shape == (*shape, K, arm.system.nq) and answer.complete.shape == shape
    for field in (
        answer.mask,
        answer.residual,
        answer.inside,
        answer.multiplicity,
        answer.condition,
        answer.branch,
    ):
        assert field.shape == (*shape, K)
    flat = ask(arm, X.reshape(-1, 4, 4)) if number else answer
    np.testing.assert_array_equal(
        answer.q.reshape(-1, K, arm.system.nq), flat.q.reshape(-1, K, arm.system.nq)
    )
    assert np.isnan(answer.q[~answer.mask]).all() and np.isnan(answer.residual[~answer.mask]).all()
    assert not answer.inside[~answer.mask].any() and not answer.multiplicity[~answer.mask].any()


@pytest.mark.parametrize("name", ["puma560", "ur10e", "jaco2", "randomRRPRRR_2", "cobra600"])
def test_a_bad_row_is_a_row_of_nan(name):
    arm, q, X = posed(name, 8, 6)
    good = ask(arm, X)
    bad = X.copy()
    bad[1, 0, 3], bad[3, 1, 1], bad[4, :3, :3] = np.nan, np.inf, 2.0 * bad[4, :3, :3]
    answer = ask(arm, bad)
    for i in range(6):
        if i in (1, 3, 4):
            assert not answer.mask[i].any() and np.isnan(answer.q[i]).all()
        else:
            np.testing.assert_array_equal(answer.q[i], good.q[i])
    for i in (1, 3, 4):
        with pytest.raises(InputError):
            ask(arm, bad[i])


@pytest.mark.parametrize("name", ["puma560", "jaco2", "youbot"])
def test_threads_change_nothing(name):
    arm = ARMS[name]
    number = 9000 if name == "puma560" else 600
    X = arm.model.fk(arm.random(9, number))
    one = ask(arm, X, budget=kempe.Budget(threads=1))
    for threads in (2, 3):
        more = ask(arm, X, budget=kempe.Budget(threads=threads))
        np.testing.assert_array_equal(more.q, one.q)
        np.testing.assert_array_equal(more.multiplicity, one.multiplicity)
    np.testing.assert_array_equal(ask(arm, X).q, one.q)


# ---------------------------------------------------------------- limits and turns

LIMITED = ["puma560", "ur5", "irb6640", "panda", "crx10ia", "cobra600", "so101", "puma_wide_limits"]


@pytest.mark.parametrize("name", LIMITED)
def test_limits_sort_and_do_not_hide(name):
    arm = ARMS[name]
    for x in arm.inside(10, 8):
        X = arm.model.fk(x)
        answer = ask(arm, X, x)
        assert [can_be_inside(arm, q) for q in answer.q] == answer.inside.tolist()
        assert (
            answer.inside.tolist() == sorted(answer.inside.tolist(), reverse=True)
            and answer.inside[0]
        )
        assert bool(answer)
        only = ask(arm, X, x, limits=True)
        assert only.inside.all()
        np.testing.assert_array_equal(only.q, answer.q[answer.inside])


@pytest.mark.parametrize("name", ["puma_wide_limits", "ur5", "crx10ia"])
def test_every_turn_inside_the_limits(name):
    """Against the product of what each joint's limits hold."""
    arm = ARMS[name]
    x = arm.inside(11, 1)[0]
    X = arm.model.fk(x)
    answer = ask(arm, X)
    every = ask(arm, X, limits="turns")
    expected = [
        p
        for q in answer.q
        for p in itertools.product(*(turns(arm, q, i) for i in range(arm.system.nq)))
    ]
    assert len(every) == len(expected) > answer.inside.sum()
    expected = np.array(expected)
    for q in every.q:
        assert np.abs(expected - q).max(axis=-1).min() < 1e-9
    for p in expected:
        assert np.abs(every.q - p).max(axis=-1).min() < 1e-9


@pytest.mark.parametrize("name", ["puma560", "ur10e", "jaco2", "panda", "stanford"])
def test_near_comes_first(name):
    arm = ARMS[name]
    for x in arm.inside(12, 5):
        answer = ask(arm, arm.model.fk(x), x, start=x)
        np.testing.assert_allclose(answer.q[0], x, rtol=0, atol=SAME)


def test_near_chooses_the_turn():
    arm = ARMS["ur10e"]  # its limits span two turns
    x = np.array([3.5, -4.0, 5.0, -5.5, 4.2, 6.0])
    answer = ask(arm, arm.model.fk(x), start=x)
    np.testing.assert_allclose(answer.q[0], x, rtol=0, atol=SAME)
    for q in answer.q:
        for i in range(6):
            assert abs(q[i] - x[i]) <= min(abs(t - x[i]) for t in turns(arm, q, i)) + 1e-9
    free = ARMS["jaco2"]  # joints 1, 4, 5, 6 turn freely
    x = np.array([100.0, 3.0, 2.0, -50.0, 1.0, 20.0])
    np.testing.assert_allclose(ask(free, free.model.fk(x), start=x).q[0], x, rtol=0, atol=SAME)


# ---------------------------------------------------------------- tasks


@pytest.mark.parametrize(
    "name", ["anthropomorphic3", "orthogonal3_cuspidal", "randomRRR_5", "planar2"]
)
def test_positions_as_points_and_as_poses(name):
    arm, _, X = posed(name, 13, 4)
    dim = arm.system.dim
    by_pose = ask(arm, X)
    by_point = arm.system.ik_all(X[:, :dim, 3], arm.frame)
    for a, b in zip(rows(by_pose), rows(by_point), strict=True):
        assert same_sets(arm, arm.model.theta(a), arm.model.theta(b), 1e-9)


def test_the_pose_matters_only_where_the_task_reads_it():
    arm = ARMS["wrist3"]
    X = arm.model.fk(arm.random(14, 1)[0])
    X[:3, 3] = 7.0, 8.0, 9.0
    assert len(ask(arm, X)) == 2
    so101 = ARMS["so101_axis"]
    x = so101.random(15, 1)[0]
    X = so101.model.fk(x)
    turned = X.copy()
    c = math.cos(0.7)
    s = math.sin(0.7)
    turned[:3, :3] = X[:3, :3] @ [[1, 0, 0], [0, c, -s], [0, s, c]]  # about the tool's x, its axis
    assert same_sets(so101, ask(so101, X).q, ask(so101, turned).q)


# ---------------------------------------------------------------- redundant chains


@pytest.mark.parametrize("name", arms.names("seven"))
def test_held_joints_stay(name):
    arm, q, X = posed(name, 16, 20)
    answer = ask(arm, X, q)
    for joint in arm.held:
        i = arm.system.coordinate_names.index(joint)
        held = np.repeat(q[:, i], answer.mask.sum(axis=-1))
        np.testing.assert_allclose(answer.q[..., i][answer.mask], held, rtol=0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("name", some(arms.names("seven"), 3))
def test_redundant_arms_have_families(name):
    """One freedom too many: curves of configurations, one of them through what gave the target."""
    arm, q, X = posed(name, 17, 2)  # the first is inside the limits
    answer = arm.system.ik_all(X[0], arm.frame, start=q[0])
    assert nearest(arm, answer.q, arm.model.theta(q[0])) < SAME and on_a_family(answer, 0, q[0])
    assert_families(arm, answer, X[0])


# ---------------------------------------------------------------- singular targets


def assert_families(arm, answer, X):
    """Samples of families reach the target, and follow each other closely."""
    assert len(answer.families) >= 1
    for family in answer.families:
        assert family.freedoms == 1 and len(family.q) >= 3
        position, angle = oracle.error(arm.model.fk(family.q), X, arm.task, arm.axis)
        assert max(position.max(), angle.max()) <= 1e-9
        assert (
            arm.model.apart(arm.model.theta(family.q[1:]), arm.model.theta(family.q[:-1])).max()
            < 0.5
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", some(["puma560", "irb6640", "ur10e", "hollow60", "stanford", "wrist3", "ball_wrist"], 3)
)
def test_a_straight_wrist_has_a_family(name):
    """Only the sum or difference of the angles about the two aligned axes matters."""
    arm = ARMS[name]
    hand = 1 if name == "wrist3" else 4
    for x in arm.random(20, 4):
        x[hand] = math.pi / 2 if name == "ball_wrist" else 0.0  # its three turns are about z, y, x
        X = arm.model.fk(x)
        answer = ask(arm, X)
        assert on_a_family(answer, 0, x)
        assert_families(arm, answer, X)
        if name != "ur10e":  # there the elbow moves, too
            # the turns about z and x of the ball are opposite once the one about y is a right angle
            straight = (
                arm.model.axes[hand - 1] @ arm.model.axes[hand + 1]
                if name != "ball_wrist"
                else -1.0
            )
            sense = -math.copysign(1.0, straight)
            for t in (-1.0, 0.3, 2.0):
                y = x.copy()
                y[hand - 1] += t
                y[hand + 1] += sense * t
                assert oracle.error(arm.model.fk(y), X)[1] < 1e-12 and on_a_family(answer, 0, y)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    some(["anthropomorphic3", "orthogonal3_cuspidal", "irb6640", "ur10e", "puma560", "jaco2"], 3),
)
def test_random_singular_targets(name):
    """Two solutions that meet are one with two roots; a curve of solutions is a family."""
    arm = ARMS[name]
    rng = np.random.default_rng(21)
    for _ in range(6):
        theta, _ = oracle.singular_configuration(arm.model, rng, arm.task)
        X = arm.model.pose(theta)
        answer = ask(arm, X)
        assert_true(arm, answer, X)
        if on_a_curve(arm, theta):
            assert on_a_family(answer, 0, theta)
            assert_families(arm, answer, X)
        else:
            at = arm.model.apart(arm.model.theta(answer.q), theta)
            merged = answer.multiplicity[at.argmin()] == 2
            # rounding of the target alone may hold the two roots a little more than SAME apart
            assert at.min() < SAME and (merged or np.sort(at)[1] < 2.0 * SAME)
            assert answer.condition[at.argmin()] > 1e5
        assert_distinct(arm, answer)


@pytest.mark.parametrize("name", ["puma560", "ur10e", "jaco2", "orthogonal3_cuspidal", "stanford"])
def test_near_singular_targets(name):
    """From 1e-3 to 1e-12 off a singular configuration: what gave the target, or a family through
    it, is found.
    """
    arm = ARMS[name]
    theta, curve = near_singular(arm, 22, 4, 10.0 ** -np.arange(3, 13))
    far = allowed(arm, theta, curve[:, None]).ravel()
    theta = theta.reshape(-1, arm.model.n)
    X = arm.model.pose(theta)
    answer = ask(arm, X)
    assert_true(arm, answer, X)
    assert_found(arm, answer, theta, far)
    assert_distinct(arm, answer)


# ---------------------------------------------------------------- derivatives


@pytest.mark.parametrize("name", [n for n in TYPICAL if square(ARMS[n]) or n == "panda"])
def test_derivatives_of_branches(name):
    """Against answers for targets moved a little along and about each axis."""
    arm = ARMS[name]
    x = arm.random(arms.SEED, 40)[arms.COUNTS[name][0][0]]
    X = arm.model.fk(x)
    step = 1e-6
    answer = ask(arm, X, x)
    assert answer.derivative.shape == (len(answer), arm.system.nv, 6)
    columns = {"pose": range(6), "position": range(3), "orientation": range(3, 6)}[arm.task]
    for c in columns:
        moved = []
        for side in (step, -step):
            Y = X.copy()
            if c < 3:
                Y[c, 3] += side
            else:
                Y[:3, :3] = reference.turn("xyz"[c - 3], side)[:3, :3].astype(float) @ X[:3, :3]
            found = ask(arm, Y, x).q
            moved.append(
                np.array(
                    [
                        found[arm.model.apart(arm.model.theta(found), t).argmin()]
                        for t in arm.model.theta(answer.q)
                    ]
                )
            )
        slope = arm.model.wrapped(arm.model.theta(moved[0]) - arm.model.theta(moved[1])) / (
            2 * step
        )
        expected = arm.model.multiplier * answer.derivative[:, arm.model.index, c]
        np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


# ---------------------------------------------------------------- beyond reach


BOUNDED = [
    n for n in TYPICAL if ARMS[n].task != "orientation" and "prismatic" not in ARMS[n].classes
]


@pytest.mark.parametrize("name", BOUNDED)
def test_what_is_out_of_reach_has_no_answer(name):
    arm, q, X = posed(name, 18, 3)
    X[:, 0, 3] += 100.0
    answer = ask(arm, X)
    assert not answer.mask.any() and np.all(answer.complete)
    alone = ask(arm, X[0])
    assert len(alone) == 0 and not alone and alone.complete
    assert "outside" in alone.status or "reach" in alone.status
    q, far, turned = alone.nearest()
    assert is_inside(arm, q)
    position, angle = oracle.error(arm.model.fk(q), X[0], arm.task, arm.axis)
    np.testing.assert_allclose([far, turned], [position, angle], rtol=1e-6, atol=1e-9)
    assert far <= arm.system.ik(X[0], arm.frame).position_error * 1.01
    with pytest.raises(NoSolutionError):
        ask(arm, X[0]).expect()


@pytest.mark.parametrize("name", ["youbot", "so101", "cobra600", "randomRRRRR_8", "palletiser4"])
def test_a_pose_that_too_few_joints_cannot_have(name):
    """A reachable pose, tilted: five joints reach a set of measure zero."""
    arm, q, X = posed(name, 19, 10)
    c = math.cos(0.4)
    s = math.sin(0.4)
    tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array(
        [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    )
    X[:, :3, :3] = X[:, :3, :3] @ tilt
    expected = [oracle.isolated(arm.model, x, batch=100, rounds=2) for x in X[:2]]
    answer = ask(arm, X)
    assert [len(r) for r in rows(answer)[:2]] == [len(e) for e in expected]
    assert_sound(arm, answer, X)


# ---------------------------------------------------------------- refusals


def test_refusals():
    arm = ARMS["puma560"]
    X = arm.system.fk(arm.system.neutral, "tool")
    with pytest.raises(InputError, match="task"):
        arm.system.ik_all(X, "tool", task="poes")
    with pytest.raises(InputError, match="axis"):
        arm.system.ik_all(X, "tool", task=("direction", (0, 0, 0)))
    with pytest.raises(UnknownNameError):
        arm.system.ik_all(X, "toool")
    with pytest.raises(UnknownNameError):
        arm.system.ik_all(X, "tool", fixed={"q9": 0.0})
    with pytest.raises(InputError):
        arm.system.ik_all(X[:3], "tool")
    ball = kempe.load("joint_spherical")
    with pytest.raises(UnsupportedError, match="quaternion"):
        ball.ik_all(np.eye(4), ball.body_names[-1])


def test_a_family_of_a_redundant_arm_is_no_isolated_solution():
    """Joints 1 and 3 of a Panda with joint 2 at zero turn against each other."""
    panda = kempe.load("panda")
    X = panda.fk(panda.mid, "panda_hand_tcp")
    found = panda.ik_all(X, "panda_hand_tcp").status
    held = panda.ik_all(X, "panda_hand_tcp", fixed={"panda_joint7": 0.0}).status
    assert found.startswith("6 solutions for what is held") and held.startswith("6 solutions")
    assert "and one of a continuous family" in found and "a family with one freedom" in held
