"""The commands for all solutions as their users see them: tables, JSON, files, exit codes, errors."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from command import Result

import kempe

L1 = 0.5
L2 = 0.4
LIMITED = """\
format = 1
name = "limited"
dim = 2
body = [{name = "upper"}, {name = "lower"}]
frame = [{name = "tip", body = "lower", at = [0.4, 0]}]
[[joint]]
name = "shoulder"
type = "revolute"
parent = "ground"
child = "upper"
[[joint]]
name = "elbow"
type = "revolute"
parent = "upper"
child = "lower"
at = [0.5, 0]
limits = [0, 3]
"""


class Table(Result):
    """A run of the command that prints solutions."""

    def table(self) -> list[list[str]]:
        """The words of the lines of solutions, without their notes."""
        lines = [line.strip() for line in self.out.splitlines()]
        rows = [re.split(r"\s+(?:elbow|shoulder|outside|-$|\d roots)", x)[0].split() for x in lines]
        return [row for row in rows if row and re.fullmatch(r"-?\d+\.\d+", row[0])]

    def inside(self) -> list[bool]:
        """Which of these are inside the limits."""
        lines = self.out.splitlines()
        return ["outside" not in x for x in lines if re.match(r" *-?\d+\.\d+  ", x)]


@pytest.fixture
def limited(tmp_path: Path) -> Path:
    path = tmp_path / "limited.toml"
    path.write_text(LIMITED)
    return path


def lecture(x: float, y: float) -> list[list[float]]:
    """Both configurations of the lecture's two-link arm, by its formula, elbow up first."""
    c2 = (x * x + y * y - L1 * L1 - L2 * L2) / (2 * L1 * L2)
    out = []
    for sign in (-1, 1):
        s2 = sign * math.sqrt(1 - c2 * c2)
        out.append([math.atan2(y, x) - math.atan2(L2 * s2, L1 + L2 * c2), math.atan2(s2, c2)])
    return out


# ---- all solutions of one target

TWO = ("ik", "two_link", "--frame", "e", "--all", "--target")


def test_the_arm_of_the_lecture():
    shown = Table(*TWO, "0.5,0.3")
    data = Result(*TWO, "0.5,0.3", "--json").json()
    rows = [list(q.values()) for q in data["q"]]
    assert shown.code == 0 and shown.out.startswith("2 solutions")
    np.testing.assert_allclose(sorted(rows, key=lambda r: r[1]), lecture(0.5, 0.3), atol=1e-12)
    np.testing.assert_allclose(np.array(shown.table(), dtype=float), rows, atol=1e-6)
    assert data["names"] == ["elbow-up" if q[1] < 0 else "elbow-down" for q in rows]
    assert [line.split()[-1] for line in shown.out.splitlines()[3:5]] == data["names"]


def test_degrees_and_nearness():
    """--seed sorts; --deg is for what is read and what is printed."""
    for near in np.degrees(lecture(0.5, 0.3)):
        result = Table(*TWO, "0.5,0.3", "--deg", "--seed", ",".join(map(str, near)))
        np.testing.assert_allclose([float(x) for x in result.table()[0]], near, atol=1e-4)
        q = [float(x) for x in result.out.splitlines()[-1].removeprefix("--q ").split(",")]
        assert "[deg]" in result.out and q == pytest.approx(list(near), abs=1e-8)


def test_a_puma_has_eight(tmp_path):
    """They stand in the table and in the file, those inside the limits first, and reach."""
    out = tmp_path / "q.csv"
    words = ("ik", "puma560", "--frame", "tool", "--target", "0.5,0.2,0.1,0,90,0", "--deg", "--all")
    result = Table(*words, "-o", out)
    assert result.code == 0 and len(result.table()) == 8 and f"written to {out}" in result.out
    inside = result.inside()
    assert inside == sorted(inside, reverse=True)
    robot = kempe.load("puma560")
    q = np.radians(np.array(result.table(), dtype=float))
    limits = robot.structure.limits
    assert inside == ((q >= limits[:, 0]) & (q <= limits[:, 1])).all(axis=1).tolist()
    poses = Result("fk", "puma560", "--frame", "tool", "--q", out, "--deg", "--json").json()
    for pose in poses["configurations"]:
        np.testing.assert_allclose(pose["xyz"], [0.5, 0.2, 0.1], atol=1e-9)
    assert len(poses["configurations"]) == 8


def test_limits(limited):
    """Elbow-up breaks the limit: it is listed, but does not count."""
    words = ("--frame", "tip", "--target", "0.5,0.3", "--all")
    result = Table("ik", limited, *words)
    assert result.code == 0 and result.inside() == [True, False]
    path = limited.with_name("tight.toml")
    path.write_text(LIMITED.replace("limits = [0, 3]", "limits = [0, 1]"))
    result = Table("ik", path, *words)
    assert result.code == 1 and result.inside() == [False, False] and "--q" not in result.out
    assert Result("ik", path, *words, "--json").json()["success"] is False


def test_boundary_and_beyond():
    edge = Table(*TWO, f"{L1 + L2},0")
    assert edge.code == 0 and len(edge.table()) == 1 and "2 roots" in edge.out
    beyond = Table(*TWO, "1.5,0")
    assert beyond.code == 1 and beyond.table() == [] and "0.6 m" in beyond.out
    data = Result(*TWO, "1.5,0", "--json").json()
    assert data["q"] == [] and data["success"] is False and "0.6 m" in data["status"]


def test_families(tmp_path):
    """With equal links and the tip at the base, every shoulder angle will do."""
    path = tmp_path / "equal.toml"
    path.write_text(
        LIMITED.replace("at = [0.4, 0]", "at = [0.5, 0]").replace("limits = [0, 3]", "")
    )
    words = ("ik", path, "--frame", "tip", "--target", "0,0", "--all")
    result = Result(*words)
    assert result.code == 0 and "family: " in result.out and "shoulder" in result.out
    (family,) = Result(*words, "--deg", "--json").json()["families"]
    assert (family["freedoms"], family["joints"], family["closed"]) == (1, ["shoulder"], True)
    q = np.array([list(row.values()) for row in family["q"]])
    np.testing.assert_allclose(np.abs(q[:, 1]), 180.0, atol=1e-6)
    assert np.ptp(q[:, 0]) > 300.0


def test_held_joints():
    target = ("--frame", "panda_hand_tcp", "--target", "0.5,0.2,0.3,180,0,0")
    words = ("ik", "panda", *target, "--deg", "--all", "--hold", "panda_joint7=30", "--json")
    data = Result(*words).json()
    assert len(data["q"]) == 4 and data["complete"] is True
    assert data["held"]["panda_joint7"] == pytest.approx(30.0, abs=1e-12)
    robot = kempe.load("panda")
    for q in data["q"]:
        X = robot.fk(robot.q({n: math.radians(x) for n, x in q.items()}), "panda_hand_tcp")
        np.testing.assert_allclose(X[:3, 3], [0.5, 0.2, 0.3], atol=1e-9)


def test_tasks():
    five = ("ik", "so101", "--frame", "tool", "--target", "0.25,0.05,0.1,0,90,0", "--deg", "--all")
    robot = kempe.load("so101")
    data = Result(*five, "--task", "position_axis", "--axis", "1,0,0", "--json").json()
    assert data["task"] == "position_axis" and data["q"]
    for q in data["q"]:
        X = robot.fk(robot.q({n: math.radians(x) for n, x in q.items()}), "tool")
        np.testing.assert_allclose(X[:3, 3], [0.25, 0.05, 0.1], atol=1e-8)
        np.testing.assert_allclose(X[:3, 0], [0.0, 0.0, -1.0], atol=1e-8)
    held = ("--hold", "wrist_flex=0", "--hold", "wrist_roll=0", "--json")
    for more in (["--position-only"], ["--task", "position"]):
        assert Result(*five, *more, *held).json()["task"] == "position"


# ---- many targets and files


def test_files(tmp_path):
    targets = tmp_path / "targets.csv"
    out = tmp_path / "q.csv"
    np.savetxt(targets, [[0.5, 0.3], [1.5, 0.0], [0.2, -0.4]], delimiter=",")
    result = Result(*TWO, targets, "-o", out)
    assert result.code == 1 and "2 of 3 targets reached, 4 solutions" in result.out
    assert "row 1: " in result.out
    found = np.genfromtxt(out, delimiter=",", names=True)
    assert found["target"].tolist() == [0, 0, 2, 2]
    wanted = sorted(lecture(0.5, 0.3)) + sorted(lecture(0.2, -0.4))
    rows = [[r["q1"], r["q2"]] for r in found]
    np.testing.assert_allclose(sorted(rows[:2]) + sorted(rows[2:]), wanted, atol=1e-9)
    data = Result(*TWO, targets, "--json").json()
    assert data["success"] == [True, False, True] and not any(data["q"][1])
    first = sorted(list(q.values()) for q in data["q"][0] if q)
    np.testing.assert_allclose(first, wanted[:2], atol=1e-9)


# ---- the plan


def test_plan():
    result = Table("plan", "puma560", "--frame", "tool")
    assert result.code == 0 and result.out.startswith(
        "inverse model of tool of puma560, task pose\n"
    )
    assert (
        "the axes of q4, q5 and q6 meet in one point" in result.out
        and "8 isolated configurations" in result.out
    )
    data = Table("plan", "puma560", "--frame", "tool", "--json").json()
    assert data["most"] == 8 and data["method"] == "closed form" and len(data["relations"]) == 4
    plan = kempe.load("puma560").inverse.plan("tool").data()
    assert data == json.loads(json.dumps(plan | {"written": []}))


def test_plan_of_tasks_and_held_joints():
    data = Table(
        "plan", "panda", "--frame", "panda_hand_tcp", "--hold", "panda_joint7", "--json"
    ).json()
    assert data["held"] == ["panda_joint7"] and data["most"] == 8
    assert (
        Table(
            "plan", "panda", "--frame", "panda_hand_tcp", "--hold", "panda_joint7=0.3", "--json"
        ).json()
        == data
    )
    data = Table(
        "plan", "so101", "--frame", "tool", "--task", "position_axis", "--axis", "1,0,0", "--json"
    ).json()
    assert data["task"] == "position_axis" and data["held"] == []


# ---- what is wrong

ALL = ["ik", "two_link", "--frame", "e", "--target", "0.5,0.3"]
FIVE = [
    "ik",
    "so101",
    "--frame",
    "tool",
    "--target",
    "0.2,0,0.1,0,0,0",
    "--all",
    "--task",
    "direction",
]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ([*ALL, "--hold", "q1=0"], "add --all"),
        ([*ALL, "--axis", "0,0,1"], "--axis is for the tasks direction and position_axis"),
        ([*ALL, "--all", "--rng", "1"], "leave --all out"),
        ([*ALL, "--all", "--task", "positions"], "'positions'"),
        ([*ALL, "--all", "--task", "pose"], "needs a target with an orientation"),
        ([*ALL, "--all", "--hold", "q3=0"], "'q3'"),
        ([*ALL, "--all", "--hold", "q1"], "name=value"),
        ([*ALL, "--all", "--hold", "q1=x"], "'x'"),
        ([*ALL, "--all", "--tolerance", "1e-6,1e-3"], "one positive number"),
        ([*ALL, "--all", "--tolerance", "-1"], "one positive number"),
        ([*ALL[:-1], "0.5,0.3,1", "--all", "--axis", "0,0,1"], "--axis is for"),
        ([*FIVE, "--axis", "1,2"], "2 numbers"),
        ([*FIVE, "--axis", "0,0,0"], "not all zero"),
        (["plan", "two_link", "--frame", "f"], "'f'"),
        (["plan", "two_link"], "--frame"),
        (["plan", "two_link", "--frame", "e", "--task", "x"], "'x'"),
        (["plan", "two_link", "--frame", "e", "--hold", "q9"], "'q9'"),
        (["plan", "five_bar", "--frame", "tip"], "loop"),
    ],
)
def test_wrong_use(command, said):
    result = Table(*command)
    assert result.code == 2 and said in result.err and result.err.count("\n") == 1, (
        result.err + result.out
    )
    data = Table(*command, "--json")
    assert data.code == 2 and said in data.json()["error"]
