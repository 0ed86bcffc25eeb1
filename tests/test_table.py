"""The table of solvers: which one answers, why those before it do not, and that all who can say the
same.
"""

from __future__ import annotations

import inspect
import json
import pickle

import numpy as np
import pytest

import kempe
from kempe.answers.problem import Problem
from kempe.answers.targets import Z_AXIS
from kempe.assemble import modes
from kempe.errors import UnsupportedError
from kempe.inverse import numeric
from kempe.namespaces import Inverse
from kempe.solvers import TABLE

PUMA, SEVEN, SMALL, ANYHOW = (kempe.load(n) for n in ("puma560", "iiwa14", "so101", "gen3_lite"))
LINKAGE, PLATFORM, SPATIAL = (kempe.load(n) for n in ("four_bar", "three_rrr", "rssr"))
TOOL = PUMA.frame_names[-1]
Q = PUMA.mid + 0.2
X = PUMA.fk(Q, TOOL)
PATH = PUMA.fk(np.linspace(Q, Q + 0.05, 4), TOOL)


def ball() -> kempe.System:
    m = kempe.Mechanism("stop", dim=2)
    m.revolute("A", m.ground, m.body("crank"))
    m.revolute("B", "crank", m.body("rod"), at=(1, 0))
    m.revolute("C", "rod", m.body("rocker"), at=(1.2, 0))
    m.revolute("D", m.ground, "rocker", at=(1.5, 0), child_at=(-0.9, 0))
    m.frame("tip", "crank", at=(1, 0))
    m.frame("low", m.ground, at=(0, -2))
    m.contact("stop", "tip", on="low")
    return m.build()


def turned() -> kempe.System:
    """Six turning joints of which no three axes meet or are parallel."""
    rng = np.random.default_rng(4)
    m = kempe.Mechanism("general")
    before = m.ground
    for i in range(6):
        link = m.body(f"b{i}")
        m.revolute(f"q{i}", before, link, at=rng.uniform(-0.4, 0.4, 3), rpy=rng.uniform(-2, 2, 3))
        before = link
    m.frame("tool", before, at=(0.1, 0.2, 0.1))
    return m.build()


STOPPED = ball()
GENERAL = turned()
G = GENERAL.fk(GENERAL.mid + 0.3, "tool")
CASES = {
    ("ik", "chain"): lambda: PUMA.ik(X, TOOL),
    ("ik", "chain", "in a batch"): lambda: PUMA.ik(PATH, TOOL),
    ("ik", "closed form"): lambda: PUMA.ik(X, TOOL, method="auto"),
    ("ik", "levels"): lambda: PUMA.ik([kempe.tasks.Pose(TOOL, X)]),
    ("ik", "levels", "through loops"): lambda: PLATFORM.ik(
        PLATFORM.fk(PLATFORM.q("closed"), "tool"), "tool"
    ),
    ("ik", "levels", "preferring"): lambda: SEVEN.ik(
        SEVEN.fk(SEVEN.mid, "tool"), "tool", prefer="mid"
    ),
    ("ik_all", "closed form, side by side"): lambda: PUMA.ik_all(X, TOOL),
    ("ik_all", "closed form"): lambda: PUMA.ik_all(
        X[:3, 3], TOOL, fixed=dict.fromkeys(PUMA.coordinate_names[3:], 0.1)
    ),
    ("ik_all", "elimination"): lambda: GENERAL.ik_all(G, "tool"),
    ("ik_all", "assembly modes"): lambda: PLATFORM.ik_all(
        PLATFORM.fk(PLATFORM.q("closed"), "tool"), "tool"
    ),
    ("ik_path", "steps"): lambda: PUMA.ik_path(PATH, TOOL, start=Q),
    ("assemble", "least squares"): lambda: LINKAGE.assemble({"A": 0.3}),
    ("assemble", "dyads"): lambda: LINKAGE.assemble({"A": 0.3}, branch="+"),
    ("assemble", "active set"): lambda: STOPPED.assemble({"A": 0.3}),
    ("assembly_modes", "dyads"): lambda: LINKAGE.assembly_modes({"A": 0.3}),
    ("assembly_modes", "many starts"): lambda: SPATIAL.assembly_modes(
        {SPATIAL.coordinate_names[0]: 0.2}, budget=kempe.Budget(starts=64)
    ),
    ("self_motion", "tangents"): lambda: SEVEN.inverse.self_motion(
        SEVEN.mid + 0.2, "tool", budget=kempe.Budget(points=5)
    ),
    ("sweep", "arm angle"): lambda: SEVEN.inverse.sweep(SEVEN.fk(SEVEN.mid + 0.2, "tool"), "tool"),
    ("sweep", "joint"): lambda: SEVEN.inverse.sweep(
        SEVEN.fk(SEVEN.mid + 0.2, "tool"),
        "tool",
        SEVEN.coordinate_names[2],
        budget=kempe.Budget(points=16),
    ),
}
"""Questions by verb and by who must answer."""


@pytest.mark.parametrize("case", CASES, ids=" - ".join)
def test_answers_say_who_answered_and_why(case):
    answer = CASES[case]()
    (verb, name) = case[:2]
    rows = [row.name for row in TABLE[verb]]
    assert answer and answer.solver.name == name
    before = rows[: rows.index(name)]
    assert [n for n, _ in answer.solver.refused] == before
    assert all(why and not why.endswith(".") for _, why in answer.solver.refused)
    assert str(answer.solver).startswith(f"{name}: ") and str(answer.solver).count("\n") == len(
        answer.solver.refused
    )
    assert pickle.loads(pickle.dumps(answer)).solver == answer.solver
    assert json.loads(answer.to_json())["solver"] == name


def test_every_row_answers_something():
    """All but the search of ik_all, which is for chains that no shipped arm has."""
    requested = {case[:2] for case in CASES}
    every = {(verb, row.name) for verb, rows in TABLE.items() for row in rows}
    assert every - requested == {("ik_all", "search")}


@pytest.mark.parametrize("verb", TABLE)
def test_rows_have_names_sentences_and_a_last_one_that_takes_what_is_left(verb):
    names = [row.name for row in TABLE[verb]]
    assert len(set(names)) == len(names)
    assert all(row.how and not row.how.endswith(".") for row in TABLE[verb])
    owner = Inverse if verb in vars(Inverse) else kempe.System
    assert inspect.signature(vars(owner)[verb])


@pytest.mark.parametrize("name", ["puma560", "ur5", "stanford", "two_link_pose"])
def test_all_who_can_reach_the_same(name, hunt):
    """Closed form, chain and levels, on targets that are reached: each by the judge."""
    robot = kempe.load(name)
    rng = hunt.rng()
    frame = robot.frame_names[-1]
    refused = set[str]()
    for _ in range(hunt.cases(5)):
        target = robot.fk(robot.random(rng), frame)
        for row in numeric.SOLVERS:
            method = "analytic" if row.name == "closed form" else "numeric"
            task = ("pose", Z_AXIS)
            problem = Problem(
                robot, "one", frame=frame, task=task, targets=target[None], method=method
            )
            if row.refuses(problem) is not None:
                refused.add(row.name)
                continue
            answer = row.run(problem)
            assert answer.success and answer.judged.holds, row.name
    assert len(refused) < len(numeric.SOLVERS) - 1, refused


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "five_bar"])
def test_closed_forms_and_many_starts_find_the_same_modes(name):
    system = kempe.load(name)
    known = {
        n: float(system.q_dict(system.assemble().q)[n])
        for n in system.coordinate_names[: system.mobility().dof]
    }
    problem = Problem(system, "all", known=known, budget=kempe.Budget(starts=256))
    assert modes.explain_missing_dyads(problem) is None
    exact = modes.find_modes_by_dyads(problem)
    found = modes.find_modes_by_starts(problem)
    assert len(exact) == len(found)
    for q in exact.q:
        assert np.abs(np.exp(1j * found.q) - np.exp(1j * q)).max(axis=-1).min() < 1e-7


def test_what_nobody_answers_is_refused_with_the_reason():
    with pytest.raises(UnsupportedError, match="more joints than the task needs"):
        SEVEN.ik(SEVEN.fk(SEVEN.mid, "tool"), "tool", method="analytic")
    with pytest.raises(
        UnsupportedError, match="does not hold one-sided constraints, such as 'stop'"
    ):
        STOPPED.ik([1.0, 0.2], "tip", method="analytic")
