"""Targets of a batch that lengths prove out of reach cost a glance; what is nearest to them is
found on demand.
"""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import kempe
from kempe.errors import CallError, InputError
from kempe.kernels.compiled import fallback
from kempe.status import Status

FIELDS = ("q", "position_error", "orientation_error", "iterations", "starts")


@pytest.fixture
def descents(monkeypatch):
    """The number of targets that the search for what is nearest was called with, so far: a list."""
    requested: list[int] = []

    class Counted:
        @staticmethod
        def approach_goals(*given):
            # those that are not found
            requested.append(int(np.sum(given[-1][:, -3] == Status.NOT_FOUND)))
            return fallback.approach_goals(*given)

    monkeypatch.setattr("kempe.kernels.compiled.fallback", Counted)
    return requested


def mixed(s: kempe.System, frame: str, rng: np.random.Generator, n: int) -> np.ndarray:
    """Targets, some of which are far away."""
    X = np.array(s.fk(s.random(rng, n), frame))
    X[:, :3, 3] *= rng.choice([1.0, 1.2, 3.0], size=(n, 1))
    return X


def test_what_is_nearest_is_searched_for_on_demand(descents):
    s = kempe.load("puma560")
    X = np.array(s.fk(s.random(0, 500), "tool"))
    X[:, :3, 3] *= 30.0
    answer = s.ik(X, "tool")
    assert (
        not answer.success.any()
        and (answer.code == Status.OUT_OF_REACH).all()
        and answer.proven.all()
    )
    assert len(answer) == 500 and not answer and not sum(descents)
    assert np.isfinite(answer.q).all() and sum(descents) == 500


@pytest.mark.parametrize("name", ["panda", "so101", "puma560", "ur5", "cobra600"])
def test_rows_of_a_batch_are_what_single_calls_answer(name, hunt):
    s = kempe.load(name)
    rng = hunt.rng()
    frame = s.frame_names[-1]
    X = mixed(s, frame, rng, hunt.cases(60))
    answer = s.ik(X, frame)
    for i, Y in enumerate(X):
        one = s.ik(Y, frame)
        assert (one.success, one.code) == (answer.success[i], answer.code[i])
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(one, field), getattr(answer, field)[i])
    assert {Status.SOLVED, Status.OUT_OF_REACH} <= set(answer.code.tolist())


@pytest.mark.parametrize(
    "use", [pickle.dumps, repr, lambda a: a.status, lambda a: replace(a, problem=None)]
)
def test_an_answer_can_be_used_before_its_numbers_were_read(use):
    s = kempe.load("puma560")
    X = mixed(s, "tool", np.random.default_rng(4), 30)
    seeds = s.random(5, 30)
    answer = s.ik(X, "tool", seeds)
    same = s.ik(X, "tool", seeds)
    assert use(answer) is not None
    again = pickle.loads(pickle.dumps(answer))
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(again, field), getattr(same, field))


# ---- answers as lists


def test_a_batch_of_answers_is_a_list_of_configurations(descents):
    """Length, rows and iteration agree with `q`, also where q is found on demand; one answer says
    where it is.
    """
    s = kempe.load("puma560")
    X = mixed(s, "tool", np.random.default_rng(1), 7)
    for answer in (
        s.ik(X, "tool"),
        s.ik(kempe.tasks.Pose("tool", X)),
        s.ik(X.reshape(7, 1, 4, 4), "tool"),
    ):
        assert len(answer) == 7
        np.testing.assert_array_equal(answer[2], answer.q[2])
        np.testing.assert_array_equal(answer[-1], answer.q[6])
        np.testing.assert_array_equal(answer[1:3], answer.q[1:3])
        np.testing.assert_array_equal([q for q in answer], answer.q)
        with pytest.raises(IndexError):
            _ = answer[7]
        with pytest.raises(InputError, match="index is 'q'"):
            _ = answer["q"]
    bar = kempe.load("four_bar")
    closed = bar.assemble({"A": np.linspace(0.1, 0.5, 4)})
    np.testing.assert_array_equal(list(closed), closed.q)
    plan = bar.loops.closed_form(["A"])
    assert len(list(plan.close(np.array([[0.1], [0.2]])))) == 2
    singles = (
        s.ik(X[0], "tool"),
        s.ik(X[0, :3, 3], "tool"),
        bar.assemble({"A": 0.3}),
        plan.close([0.1]),
    )
    for one in singles:
        for use in (len, list, lambda a: a[0], iter):
            with pytest.raises(
                CallError, match="one problem and no list: its configuration is `q`"
            ):
                use(one)
        assert bool(one) in (True, False) and np.array([one], dtype=object).shape == (1,)
