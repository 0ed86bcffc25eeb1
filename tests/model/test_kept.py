"""What follows from a system is worked out once, and no list of kept answers grows without end."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe.model.model import MOST, bind_call, keep_answers, store_answer


def test_once_for_each_system_and_keys():
    calls = []

    @keep_answers
    def answer(system, *keys):
        calls.append((system, *keys))
        return [*keys]

    a = kempe.load("four_bar")
    b = kempe.load("four_bar")
    assert answer(a, 1) is answer(a, 1) and answer(a, 1) is not answer(b, 1) and answer(a) == []
    assert calls == [(a, 1), (b, 1), (a,)]


def test_none_and_errors():
    calls = []

    @keep_answers
    def nothing(system):
        calls.append(system)

    @keep_answers
    def failing(system):
        raise ValueError("no")

    s = kempe.load("four_bar")
    assert nothing(s) is None and nothing(s) is None and len(calls) == 1
    for _ in range(2):
        with pytest.raises(ValueError, match="no") as caught:
            failing(s)
        assert caught.value.__context__ is None


def test_a_prepared_call_is_made_once_for_each_verb_and_key():
    made = []

    def make():
        made.append(len(made))
        return made[-1]

    s = kempe.load("four_bar")
    asked = [("ik", 1), ("ik", 2), ("ik_all", 1), ("ik", 1), ("ik_all", 1)]
    assert [bind_call(s, verb, key, make) for verb, key in asked] == [0, 1, 2, 0, 2]
    assert made == [0, 1, 2]


def test_the_oldest_go_first():
    answers: dict = {}
    for k in range(10):
        assert store_answer(answers, k, -k, 4) == -k
    assert answers == {6: -6, 7: -7, 8: -8, 9: -9}


def test_a_system_does_not_grow_with_its_calls(hunt):
    arm = kempe.load("puma560")
    rng = hunt.rng()
    X = arm.fk(arm.mid, "tool")
    for _ in range(MOST + 50):
        axis = rng.normal(size=3)
        arm.ik(X, "tool", task=("direction", axis))
    assert max(map(len, arm._kept.values())) <= MOST


def test_copies_keep_nothing_of_the_original():
    s = kempe.load("four_bar")
    s.assemble({"A": 0.3})
    other = s.with_parameters(a=0.2) if "a" in s.structure.parameters else s.mechanism.build()
    assert any(s._kept.values()) and not any(other._kept.values())
    assert np.all(np.isfinite(other.assemble({"A": 0.3}).q))
