"""Commands print, write and end as the answers of the library say: by one table of commands with the
calls that they stand for.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from command import Result

import kempe
from kempe import Budget
from kempe.cli.terminal import clean_text
from kempe.views.facts import Poses, SystemFacts
from kempe.words import DEGREE

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
ROWS = {
    "way.csv": "x,y\n0.6,0.3\n0.55,0.28\n0.5,0.25\n",
    "far.csv": "0.6,0.3\n9,0\n",
    "poses.csv": "0.4,0.1,180\n0.5,0.1,90\n",
    "q.csv": "q2,q1\n0.1,0.2\n0.3,0.4\n",
    "A.csv": "A\n10\n20\n30\n",
    "S.csv": "D\n1.6\n0\n",
}
"""Files that commands read: places, configurations and known values."""


@cache
def load(name: str) -> kempe.System:
    return kempe.load(name)


def plane(x: float, y: float, angle: float) -> np.ndarray:
    X = np.eye(4)
    c = np.cos(angle)
    s = np.sin(angle)
    X[:2, :2] = [[c, -s], [s, c]]
    X[:2, 3] = x, y
    return X


def arm() -> kempe.System:
    return load("two_link")


def bar() -> kempe.System:
    return load("four_bar")


def puma(x: float, y: float, z: float, *rpy: float) -> np.ndarray:
    return kempe.spatial.pose_from_xyz_rpy(np.array([x, y, z, *(a * DEGREE for a in rpy)]))


WAY = np.array([[0.6, 0.3], [0.55, 0.28], [0.5, 0.25]])
FAR = np.array([[0.6, 0.3], [9.0, 0.0]])


class Case(NamedTuple):
    """The words of a command, and the call that gives its answer."""

    words: str
    call: Callable[[], Any]


CASES = [
    Case("info puma560", lambda: SystemFacts(load("puma560"))),
    Case("info stewart --deg", lambda: SystemFacts(load("stewart"))),
    Case(
        "fk two_link --q 30,40 --deg",
        lambda: Poses(arm(), None, arm().fk([DEGREE * 30, DEGREE * 40])),
    ),
    Case(
        "fk two_link --frame e --q q.csv",
        lambda: Poses(arm(), "e", arm().fk([[0.2, 0.1], [0.4, 0.3]], "e")),
    ),
    Case("ik two_link --frame e --target 0.6,0.3", lambda: arm().ik([0.6, 0.3], "e")),
    Case(
        "ik two_link --frame e --target 0.6,0.3 --start q2=-1",
        lambda: arm().ik([0.6, 0.3], "e", start=[0, -1]),
    ),
    Case("ik two_link --frame e --target 9,0", lambda: arm().ik([9.0, 0.0], "e")),
    Case("ik two_link --frame e --target far.csv --deg", lambda: arm().ik(FAR, "e")),
    Case(
        "ik two_link_pose --frame p --target 0.5,0.1,90 --deg",
        lambda: load("two_link_pose").ik(plane(0.5, 0.1, np.pi / 2), "p"),
    ),
    Case(
        "ik two_link --frame e --target 0.6,0.3,1 --position-only --rng 7 --tolerance 1e-3,1e-2",
        lambda: arm().ik([0.6, 0.3], "e", tolerance=(1e-3, 1e-2), budget=Budget(rng=7)),
    ),
    Case(
        "ik four_bar --frame coupler_point --target 0.1,0.3",
        lambda: bar().ik([0.1, 0.3], "coupler_point"),
    ),
    Case("ik two_link --frame e --target 0.9,0 --all", lambda: arm().ik_all([0.9, 0.0], "e")),
    Case("ik two_link --frame e --target 1.5,0 --all", lambda: arm().ik_all([1.5, 0.0], "e")),
    Case("ik two_link --frame e --target far.csv --all", lambda: arm().ik_all(FAR, "e")),
    Case(
        "ik two_link --frame e --target 0.6,0.3 --all --start 0,-90 --deg",
        lambda: arm().ik_all([0.6, 0.3], "e", [0.0, -90 * DEGREE]),
    ),
    Case(
        "ik puma560 --frame tool --target 0.5,0.2,0.1,0,90,0 --deg --all",
        lambda: load("puma560").ik_all(puma(0.5, 0.2, 0.1, 0, 90, 0), "tool"),
    ),
    Case(
        "ik panda --frame tool --target 0.5,0.2,0.3,180,0,0 --deg --all --hold panda_joint7=30",
        lambda: load("panda").ik_all(
            puma(0.5, 0.2, 0.3, 180, 0, 0), "tool", fixed={"panda_joint7": 30 * DEGREE}
        ),
    ),
    Case(
        "ik so101 --frame tool --target 0.25,0.05,0.1,0,90,0 --deg --all --task position_axis --axis 1,0,0",
        lambda: load("so101").ik_all(
            puma(0.25, 0.05, 0.1, 0, 90, 0), "tool", task=("position_axis", [1, 0, 0])
        ),
    ),
    Case("plan puma560 --frame tool", lambda: load("puma560").inverse.plan("tool")),
    Case(
        "plan panda --frame tool --hold panda_joint7",
        lambda: load("panda").inverse.plan("tool", fixed=["panda_joint7"]),
    ),
    Case("path two_link --frame e --targets way.csv --deg", lambda: arm().ik_path(WAY, "e")),
    Case(
        "path two_link --frame e --targets far.csv --restart",
        lambda: arm().ik_path(FAR, "e", restart=True),
    ),
    Case("dof bennett", lambda: load("bennett").mobility()),
    Case(
        "dof four_bar --q A=30 --deg", lambda: bar().mobility(bar().assemble({"A": 30 * DEGREE}).q)
    ),
    Case(
        "dof five_bar --actuated A,D --fast",
        lambda: load("five_bar").mobility(None, ["A", "D"], local=False),
    ),
    Case("classify car --q 0,0,30 --deg", lambda: load("car").classify([0, 0, 30 * DEGREE])),
    Case(
        "classify four_bar --q 0.5,0.1,0.2,0.3 --project",
        lambda: bar().classify([0.5, 0.1, 0.2, 0.3], project=True),
    ),
    Case("assemble four_bar A=30 --deg", lambda: bar().assemble({"A": 30 * DEGREE})),
    Case("assemble four_bar D=0", lambda: bar().assemble({"D": 0.0})),
    Case("assemble four_bar A=0.3 --branch -", lambda: bar().assemble({"A": 0.3}, branch="-")),
    Case("assemble five_bar tip=0.1,0.25", lambda: load("five_bar").assemble({"tip": [0.1, 0.25]})),
    Case(
        "assemble four_bar A.csv --deg --continuous",
        lambda: bar().assemble({"A": np.array([10.0, 20, 30]) * DEGREE}, prefer="continuous"),
    ),
    Case(
        "assemble four_bar S.csv --no-limits",
        lambda: bar().assemble({"D": [1.6, 0.0]}, limits=False),
    ),
    Case("assemble four_bar A=90 --modes --deg", lambda: bar().assembly_modes({"A": 90 * DEGREE})),
    Case("assemble jansen O=0.3 --modes", lambda: load("jansen").assembly_modes({"O": 0.3})),
    Case("trace four_bar --driver D --deg", lambda: bar().trace("D")),
    Case("trace four_bar --points 9 --no-limits", lambda: bar().trace(limits=False).resample(9)),
    Case("trace four_bar --start closed", lambda: bar().trace(start=bar().q("closed"))),
    Case(
        "trace five_bar --driver A --hold C=60 --deg",
        lambda: load("five_bar").trace(
            "A", load("five_bar").assemble({"C": 60 * DEGREE}).q, hold={"C": 60 * DEGREE}
        ),
    ),
    Case(
        "singularities two_link --frame e --task position --deg",
        lambda: arm().singularities("e", "position"),
    ),
    Case("reach two_link way.csv --frame e", lambda: arm().reach.poses(WAY, "e", task="position")),
    Case(
        "place two_link way.csv --frame e --box yaw=0,90 --cells 2 --deg",
        lambda: arm().reach.place(
            [plane(*p, 0.0) for p in WAY], "e", {"yaw": [0, 90 * DEGREE]}, 2, task="position"
        ),
    ),
    Case(
        "workspace two_link --frame e -n 2e4 --cells 16",
        lambda: arm().workspace("e", n=2e4, cells=16),
    ),
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in ROWS.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.words)
def test_a_command_prints_the_answer(case: Case, folder):
    """As text and as JSON; and its exit code says whether the answer is complete."""
    words = case.words.split()
    degrees = "--deg" in words
    answer = case.call()
    shown = Result(*words)
    text = clean_text(answer.text(degrees))
    assert NUMBER.sub("#", shown.out).startswith(NUMBER.sub("#", text)), shown.out + shown.err
    data = Result(*words, "--json")
    same(data.json(), json.loads(json.dumps(answer.data(degrees))) | {"written": []})
    assert shown.code == data.code == (not answer)


def same(got: Any, expected: Any, place: str = "") -> None:
    """Data that are equal but for the rounding of numbers."""
    if isinstance(expected, dict):
        assert list(got) == list(expected), place
        for key, value in expected.items():
            same(got[key], value, f"{place}.{key}")
    elif isinstance(expected, list):
        assert len(got) == len(expected), place
        for k, (a, b) in enumerate(zip(got, expected, strict=True)):
            same(a, b, f"{place}[{k}]")
    elif isinstance(expected, float):
        assert got == pytest.approx(expected, rel=1e-9, abs=1e-7), place
    elif isinstance(expected, str):
        assert NUMBER.sub("#", got) == NUMBER.sub("#", expected), place
    else:
        assert got == expected, place


NOTHING = "assemble four_bar D=0"
"""A command that writes nothing, as nothing closes."""
WRITTEN = ("fk ", "ik ", "path ", "assemble ", "trace ", "singularities ", "reach ")


@pytest.mark.parametrize(
    "case",
    [c for c in CASES if c.words.startswith(WRITTEN) and c.words != NOTHING],
    ids=lambda case: case.words,
)
def test_a_command_writes_the_answer(case: Case, folder):
    words = case.words.split()
    answer = case.call()
    done = Result(*words, "-o", "out.csv")
    answer.save(folder / "own.csv", degrees="--deg" in words)
    head, *_ = (folder / "out.csv").read_text().splitlines()
    assert head == (folder / "own.csv").read_text().splitlines()[0]
    read = (np.genfromtxt(folder / n, delimiter=",", skip_header=1) for n in ("out.csv", "own.csv"))
    np.testing.assert_allclose(*read, rtol=1e-9, atol=1e-7)
    assert done.out.rstrip().endswith("written to out.csv")
