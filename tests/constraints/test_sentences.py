"""What constraints ask, said in a plain sentence where a user sees it."""

from __future__ import annotations

import numpy as np
import pytest
from kinds_battery import EXAMPLES, TASKS_ONLY, two_bodies

import kempe
from kempe import constraints as c
from kempe.views.facts import SystemFacts


def info(system: kempe.System) -> str:
    return SystemFacts(system).text()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", [n for n in EXAMPLES if n not in TASKS_ONLY])
def test_each_kind_is_said(name, dim):
    m = two_bodies(dim)
    m.constrain(made := EXAMPLES[name](dim), "it")
    said = SystemFacts(system := m.build()).data()["constraints"][0]["says"]
    assert said == made.sentence and f" {said}\n" in f"{info(system)}\n"
    assert not {*"{}[]"} & {*said} and "None" not in said and "array" not in said
    frames = [
        x for x in (getattr(made, "frame", None), getattr(made, "other", None)) if x is not None
    ]
    assert all(frame in said for frame in frames)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (c.Distance("tip", "eye", 0.9), "tip and eye are 0.9 m apart"),
        (c.Distance("tip", "eye", at_most="2*l"), "tip and eye are at most 1 m apart"),
        (
            c.Distance("tip", "eye", at_least=0.1, at_most=0.5),
            "tip and eye are at least 0.1 and at most 0.5 m apart",
        ),
        (c.OnSphere("tip", (0, 0, 0), 0.5), "tip is 0.5 m away from a point of the ground"),
        (c.Pose("tip", np.eye(4), other="eye"), "tip is at a given pose, seen from eye"),
        (
            c.Equation(lambda x: [x["Ja.x"] - 1, 2 * x["Ja.y"]], of=("Ja.x", "Ja.y")),
            "Ja.x - 1 = 0, 2*Ja.y = 0",
        ),
        (c.Equation(lambda x: 1.0 if x["Ja.x"] > 0 else 2.0, of=("Ja.x",)), "f(Ja.x) = 0"),
        (c.Inequality("1 - `Ja.x`"), "1 - `Ja.x` >= 0"),
        (
            c.VelocityEquation([["1", "2"]], of=("Ja.x", "Ja.y")),
            "the velocities v of (Ja.x, Ja.y) obey ((1, 2)) v = 0",
        ),
    ],
)
def test_sentences(made, said):
    m = two_bodies(3)
    m.parameter("l", 0.5)
    m.constrain(made, "it")
    assert SystemFacts(m.build()).data()["constraints"][0]["says"] == said
