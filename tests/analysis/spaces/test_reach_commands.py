"""The commands about what is reached, beside the library."""

from __future__ import annotations

import pytest
from command import Result

import kempe


def test_singularities_as_text_and_json():
    run = Result("singularities", "puma560", "--frame", "tool", "--at", "q5=0.2", "--json")
    data, answer = run.json(), kempe.load("puma560").singularities("tool")
    assert run.code == 0 and [s["name"] for s in data["sets"]] == [s.name for s in answer.sets]
    assert data["nearest"]["distances"]["wrist (q5 = 0)"] == pytest.approx(0.2, abs=1e-6)
    text = Result("singularities", "two_link", "--frame", "e", "--at", "q2=10", "--deg")
    assert text.code == 0 and "q2 = 0 or 3.142" in text.out and "0.1745 away" in text.out


def test_singularities_of_loops():
    data = Result("singularities", "four_bar", "--frame", "rocker", "--inputs", "A", "--json").json()
    assert [(s["kinds"], len(s["q"])) for s in data["sets"]] == [(["type 1"], 4)]
    none = Result("singularities", "four_bar", "--frame", "coupler", "--inputs", "A")
    assert none.code == 1 and "no singular configuration found" in none.out


@pytest.mark.parametrize(("arguments", "said"), [
    (("singularities", "puma560"), "name a frame"),
    (("singularities", "puma560", "--frame", "hand"), "hand"),
    (("singularities", "four_bar", "--inputs", ","), "names no joint"),
    (("singularities", "four_bar", "--inputs", "E"), "E"),
    (("singularities", "puma560", "--frame", "tool", "--at", "q9=1"), "q9"),
    (("singularities", "puma560", "--frame", "tool", "--starts", "0"), "starts"),
])  # fmt: skip
def test_wrong_calls_of_commands(arguments, said):
    for more in ((), ("--json",)):
        run = Result(*arguments, *more)
        assert run.code == 2 and said in run.out + run.err
