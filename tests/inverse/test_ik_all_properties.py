"""Properties of all inverse solutions on arms that nobody has seen: random geometry, random
structure.
"""

from __future__ import annotations

import math

import analytic_oracle as oracle
import arms
import numpy as np
import pytest
from hunts import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from ik_all_checks import SAME, ask, assert_sound, nearest, rows, same_sets

import kempe

RIGHT = st.sampled_from([0.0, math.pi / 2, -math.pi / 2, math.pi])
ANGLE = st.one_of(RIGHT, RIGHT, st.floats(-3.1, 3.1).map(lambda x: round(x, 3)))
LENGTH = st.one_of(
    st.just(0.0),
    st.sampled_from([0.1, 0.3, -0.25]),
    st.floats(-0.5, 0.5).map(lambda x: round(x, 3)),
)
SEEDS = st.integers(0, 2**16)


@st.composite
def tables(draw, n: int = 6, slides: int = 0):
    """Denavit-Hartenberg tables of n rows as engineers make them: right angles and zeros besides
    other numbers.
    """
    kinds = draw(st.permutations(["revolute"] * (n - slides) + ["prismatic"] * slides))
    return [(draw(LENGTH), draw(ANGLE), draw(LENGTH), draw(ANGLE), kind) for kind in kinds]


def regular(arm, task: str = "pose") -> bool:
    """Whether most configurations of the arm are regular."""
    theta = arm.model.theta(arm.random(0, 9))
    return bool(np.median(arm.model.condition(theta, task)) > 1e-3)


def check(arm, seed: int, number: int = 6) -> None:
    """Answers are sound, and what gave a target is found where it is isolated."""
    q = arm.random(seed, number)
    X = arm.model.fk(q)
    answer = ask(arm, X)
    assert_sound(arm, answer, X)
    theta = arm.model.theta(q)
    isolated = arm.model.condition(theta, arm.task, arm.axis) > 1e-5
    for found, wanted, good in zip(rows(answer), theta, isolated, strict=True):
        assert not good or nearest(arm, found, wanted) < SAME


@pytest.mark.slow
@given(rows_=tables(), seed=SEEDS)
@settings(max_examples=examples(60))
def test_six_turns_of_any_structure(rows_, seed):
    arm = arms.table("any", rows_, "", 16)
    assume(regular(arm))
    check(arm, seed)


@pytest.mark.slow
@given(rows_=st.integers(1, 3).flatmap(lambda k: tables(6, k)), seed=SEEDS)
@settings(max_examples=examples(40))
def test_six_joints_some_of_which_slide(rows_, seed):
    arm = arms.table("any", rows_, "", 16)
    assume(regular(arm))
    check(arm, seed)


@given(rows_=tables(3), seed=SEEDS)
def test_three_turns_for_a_position(rows_, seed):
    arm = arms.table("any", rows_, "", 4, task="position")
    assume(regular(arm, "position"))
    check(arm, seed)


@pytest.mark.slow
@given(rows_=tables(5), seed=SEEDS)
def test_five_turns_for_a_pose(rows_, seed):
    arm = arms.table("any", rows_, "", 16)
    assume(regular(arm))
    check(arm, seed, 3)


@given(n=st.integers(1, 5), seed=SEEDS, slides=st.integers(0, 1))
@settings(max_examples=examples(20))
def test_random_short_chains(n, seed, slides):
    arm = arms.random_arm(seed, "P" * min(slides, n) + "R" * (n - min(slides, n)), name="short")
    check(arm, seed, 3)


@pytest.mark.slow
@given(rows_=tables(), seed=SEEDS)
@settings(max_examples=examples(25))
def test_degenerate_arms_are_answered_truly(rows_, seed):
    """Arms with more joints than freedoms: whatever comes back reaches its target."""
    rows_ = [*rows_[:3], (0.0, 0.0, *rows_[3][2:]), *rows_[4:]]  # joints 4 and 5 share an axis
    arm = arms.table("any", rows_, "", 10**6)
    X = arm.model.fk(arm.random(seed, 1)[0])
    answer = arm.system.ik_all(X, "tool")
    theta = arm.model.theta(answer.q)
    position, angle = oracle.error(arm.model.pose(theta), X)
    assert (position <= 1e-9).all() and (angle <= 1e-9).all()
    assert len(answer.families) or not len(answer)


@given(rows_=tables(), seed=SEEDS)
@settings(max_examples=examples(25))
def test_gauges(rows_, seed):
    arm = arms.table("any", rows_, "", 16)
    assume(regular(arm))
    q = arm.random(seed, 1)[0]
    new, base, tool, signs = arms.regauged(arm, seed)
    theta = arm.model.theta(ask(arm, arm.model.fk(q)).q)
    assume(len(theta) and arm.model.condition(theta).min() > 1e-4)
    answer = new.system.ik_all(base @ arm.model.fk(q) @ tool, "tool")
    assert same_sets(new, new.model.theta(answer.q), signs * theta)


@pytest.mark.slow
@given(rows_=tables(), seed=SEEDS)
@settings(max_examples=examples(25))
def test_the_chain_walked_backwards(rows_, seed):
    """The inverse pose has the same solutions on the mirrored arm, angles in reverse order."""
    arm = arms.table("any", rows_, "", 16)
    assume(regular(arm))
    back = arms.mirrored(arm, "back")
    X = arm.model.fk(arm.random(seed, 1)[0])
    theta = arm.model.theta(ask(arm, X).q)
    assume(len(theta) and arm.model.condition(theta).min() > 1e-4)
    answer = back.system.ik_all(np.linalg.inv(X), "tool")
    assert same_sets(back, back.model.theta(answer.q), theta[:, ::-1])


@given(
    seed=SEEDS, name=st.sampled_from(["puma560", "ur10e", "jaco2", "crx10ia", "puma_wide_limits"])
)
@settings(max_examples=examples(25))
def test_near_and_limits_only_sort(seed, name):
    arm = arms.arms()[name]
    rng = np.random.default_rng(seed)
    X = arm.model.fk(arm.random(rng, 1)[0])
    plain = ask(arm, X)
    near = ask(arm, X, start=rng.uniform(-6, 6, arm.system.nq))
    assert same_sets(arm, arm.model.theta(plain.q), arm.model.theta(near.q), 1e-9)
    assert sorted(plain.inside) == sorted(near.inside)
    assert near.inside.tolist() == sorted(near.inside.tolist(), reverse=True)


@given(
    seed=SEEDS, name=st.sampled_from(["puma560", "ur10e", "jaco2", "stanford", "randomRRRRRR_2"])
)
@settings(max_examples=examples(25))
def test_targets_written_with_seven_digits(seed, name):
    """Rotations that are off by rounding to float32: the solutions are those of a pose nearby."""
    arm = arms.arms()[name]
    q = arm.random(seed, 1)[0]
    assume(arm.model.condition(arm.model.theta(q)) > 0.02)
    X = arm.model.fk(q).astype(np.float32).astype(float)
    assert nearest(arm, arm.system.ik_all(X, arm.frame).q, arm.model.theta(q)) < 2e-4


def test_turns_at_both_ends_of_a_range_of_one_turn_are_solutions():
    arm = kempe.load("two_link").with_limits({"q1": (0.3, 0.3 + 2 * np.pi), "q2": (0.0, 3.0)})
    found = arm.ik_all(arm.fk([0.3, 0.4], "e")[:2, 3], "e", limits="turns")
    assert np.allclose(sorted(found.q[:, 0]), [0.3, 0.3 + 2 * np.pi]) and np.allclose(
        found.q[:, 1], 0.4
    )


@pytest.mark.parametrize("name", ["puma560", "ur5", "crx10ia", "gen3_lite", "jaco2"])
def test_targets_that_are_no_numbers_are_said_by_each_method(name):
    arm = kempe.load(name)
    frame = arm.frame_names[-1]
    X = np.stack([arm.fk(arm.mid, frame), np.full((4, 4), np.nan)])
    assert arm.ik_all(X, frame).code[1] == kempe.Status.BAD_INPUT


@pytest.mark.parametrize("word", ["UTTPR", "UTTTR", "UTPTR", "TUTPR"])
def test_chains_of_which_the_first_choices_hold_a_freedom(word):
    """Many spare slides: joints are held one by one, and solutions reach the pose."""
    types = {"P": "prismatic", "R": "revolute", "T": "translation", "U": "universal"}
    rng = np.random.default_rng(0)
    m = kempe.Mechanism(word, dim=3)
    last = "ground"
    for k, letter in enumerate(word):
        body = m.body(f"b{k}").name
        at = rng.normal(size=3)
        m.joint(f"j{k}", types[letter], last, body, at=at, rpy=rng.uniform(-3, 3, 3))
        last = body
    s = m.build()
    X = s.fk(s.neutral, last)
    answer = s.ik_all(X, last)
    assert len(answer) and np.abs(s.fk(answer.q, last) - X).max() < 1e-9
