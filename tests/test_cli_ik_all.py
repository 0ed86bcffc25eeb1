"""The commands for all solutions as their users see them: tables, JSON, files, exit codes, errors."""

from __future__ import annotations

import io
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from command import Result
from rich.console import Console

import kempe
from kempe.cli import ik_report

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
        """The words of the lines that begin with a number, without the names of branches at their
        ends.
        """
        rows = [
            re.split(r"\s+(?:elbow|shoulder)", line.strip())[0].split()
            for line in self.out.splitlines()
        ]
        return [row for row in rows if row and row[0].isdigit() and row[1] in ("yes", "no")]


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


def test_the_arm_of_the_lecture():
    result = Table("ik", "two_link", "--frame", "e", "--target", "0.5,0.3", "--all")
    rows = [[float(x) for x in row[3:]] for row in result.table()]
    assert result.code == 0 and result.out.startswith("2 solutions")
    np.testing.assert_allclose(sorted(rows, key=lambda r: r[1]), lecture(0.5, 0.3), atol=1e-6)
    found = Table(
        "ik", "two_link", "--frame", "e", "--target", "0.5,0.3", "--all", "--json"
    ).json()["solutions"]
    assert [x["name"] for x in found] == [
        "elbow-up" if x["q"]["q2"] < 0 else "elbow-down" for x in found
    ]
    assert [line.split()[-1] for line in result.out.splitlines()[3:5]] == [x["name"] for x in found]


def test_degrees_and_nearness():
    """--seed sorts; --deg is for what is read and what is printed."""
    up, down = np.degrees(lecture(0.5, 0.3))
    for near in (up, down):
        seed = ",".join(map(str, near))
        result = Table(
            "ik",
            "two_link",
            "--frame",
            "e",
            "--target",
            "0.5,0.3",
            "--all",
            "--deg",
            "--seed",
            seed,
        )
        np.testing.assert_allclose([float(x) for x in result.table()[0][3:]], near, atol=1e-4)
        assert "[deg]" in result.out
        q = [float(x) for x in result.out.splitlines()[-1].removeprefix("--q ").split(",")]
        np.testing.assert_allclose(q, near, atol=1e-8)


def test_a_puma_has_eight():
    result = Table(
        "ik", "puma560", "--frame", "tool", "--target", "0.5,0.2,0.1,0,90,0", "--deg", "--all"
    )
    table = result.table()
    assert result.code == 0 and len(table) == 8
    # "yes" before "no"
    assert [row[1] for row in table] == sorted((row[1] for row in table), reverse=True)
    robot = kempe.load("puma560")
    q = np.radians([[float(x) for x in row[3:]] for row in table])
    X = robot.fk(q, "tool")
    np.testing.assert_allclose(X, np.broadcast_to(X[0], X.shape), atol=2e-5)
    np.testing.assert_allclose(X[0][:3, 3], [0.5, 0.2, 0.1], atol=1e-5)
    inside = ((q >= robot.structure.limits[:, 0]) & (q <= robot.structure.limits[:, 1])).all(axis=1)
    assert [row[1] == "yes" for row in table] == inside.tolist()


def test_limits(limited):
    """Elbow-up breaks the limit: it is listed, but does not count."""
    result = Table("ik", limited, "--frame", "tip", "--target", "0.5,0.3", "--all")
    assert result.code == 0 and [row[1] for row in result.table()] == ["yes", "no"]
    path = limited.with_name("tight.toml")
    path.write_text(LIMITED.replace("limits = [0, 3]", "limits = [0, 1]"))
    result = Table("ik", path, "--frame", "tip", "--target", "0.5,0.3", "--all")
    assert (
        result.code == 1
        and [row[1] for row in result.table()] == ["no", "no"]
        and "--q" not in result.out
    )
    assert (
        Table("ik", path, "--frame", "tip", "--target", "0.5,0.3", "--all", "--json").json()[
            "success"
        ]
        is False
    )


def test_boundary_and_beyond():
    edge = Table("ik", "two_link", "--frame", "e", "--target", f"{L1 + L2},0", "--all")
    assert (
        edge.code == 0
        and len(edge.table()) == 1
        and "times" in edge.out
        and edge.table()[0][2] == "2"
    )
    beyond = Table("ik", "two_link", "--frame", "e", "--target", "1.5,0", "--all")
    assert beyond.code == 1 and beyond.table() == [] and "0.6 m" in beyond.out
    data = Table("ik", "two_link", "--frame", "e", "--target", "1.5,0", "--all", "--json").json()
    assert data["solutions"] == [] and data["success"] is False and "0.6 m" in data["status"]


def test_families(tmp_path):
    """With equal links and the tip at the base, every shoulder angle will do."""
    path = tmp_path / "equal.toml"
    path.write_text(
        LIMITED.replace("at = [0.4, 0]", "at = [0.5, 0]").replace("limits = [0, 3]", "")
    )
    result = Table("ik", path, "--frame", "tip", "--target", "0,0", "--all")
    assert result.code == 0 and "family: " in result.out and "shoulder" in result.out
    data = Table("ik", path, "--frame", "tip", "--target", "0,0", "--all", "--deg", "--json").json()
    (family,) = data["families"]
    assert family["freedoms"] == 1 and family["joints"] == ["shoulder"] and family["closed"] is True
    q = np.array(family["q"])
    np.testing.assert_allclose(np.abs(q[:, 1]), 180.0, atol=1e-6)
    assert np.ptp(q[:, 0]) > 300.0


def test_held_joints():
    command = (
        "ik",
        "panda",
        "--frame",
        "panda_hand_tcp",
        "--target",
        "0.5,0.2,0.3,180,0,0",
        "--deg",
        "--all",
    )
    data = Table(*command, "--hold", "panda_joint7=30", "--json").json()
    assert len(data["solutions"]) == 4 and data["complete"] is True
    robot = kempe.load("panda")
    for s in data["solutions"]:
        assert s["q"]["panda_joint7"] == pytest.approx(30.0, abs=1e-12)
        q = robot.q({n: math.radians(x) for n, x in s["q"].items() if "finger" not in n})
        np.testing.assert_allclose(robot.fk(q, "panda_hand_tcp")[:3, 3], [0.5, 0.2, 0.3], atol=1e-9)


def test_tasks():
    five = ("ik", "so101", "--frame", "tool", "--target", "0.25,0.05,0.1,0,90,0", "--deg", "--all")
    robot = kempe.load("so101")
    data = Table(*five, "--task", "position_axis", "--axis", "1,0,0", "--json").json()
    assert data["task"] == "position_axis" and data["solutions"]
    for s in data["solutions"]:
        X = robot.fk(robot.q({n: math.radians(x) for n, x in s["q"].items()}), "tool")
        np.testing.assert_allclose(X[:3, 3], [0.25, 0.05, 0.1], atol=1e-8)
        np.testing.assert_allclose(X[:3, 0], [0.0, 0.0, -1.0], atol=1e-8)
    for more in (["--position-only"], ["--task", "position"]):
        assert (
            Table(
                *five, *more, "--hold", "wrist_flex=0", "--hold", "wrist_roll=0", "--json"
            ).json()["task"]
            == "position"
        )


def test_many_coordinates_are_columns(tmp_path):
    """Eight coordinates beside two that move the tip: a column for each solution."""
    joints = [
        f'[[joint]]\nname = "w{k}"\ntype = "revolute"\nparent = "ground"\nchild = "wheel{k}"\n'
        for k in range(8)
    ]
    bodies = ", ".join(f'{{name = "wheel{k}"}}' for k in range(8))
    path = tmp_path / "wheels.toml"
    path.write_text(
        LIMITED.replace('{name = "lower"}', f'{{name = "lower"}}, {bodies}') + "".join(joints)
    )
    result = Table("ik", path, "--frame", "tip", "--target", "0.5,0.3", "--all")
    rows = {words[0]: words[1:] for words in map(str.split, result.out.splitlines()) if words}
    assert rows["inside"] == ["limits", "yes", "no"]
    found = np.array([rows["shoulder"][1:], rows["elbow"][1:]], dtype=float).T
    np.testing.assert_allclose(
        sorted(found.tolist(), key=lambda r: r[1]), lecture(0.5, 0.3), atol=1e-6
    )
    assert rows["w7"] == ["[rad]", "0.000000", "0.000000"]


# ---- many targets and files


def test_files(tmp_path):
    targets = tmp_path / "targets.csv"
    out = tmp_path / "q.csv"
    np.savetxt(targets, [[0.5, 0.3], [1.5, 0.0], [0.2, -0.4]], delimiter=",")
    result = Table("ik", "two_link", "--frame", "e", "--target", targets, "--all", "-o", out)
    assert (
        result.code == 1
        and "2 of 3 targets reached, 4 solutions" in result.out
        and "row 1: " in result.out
    )
    found = np.genfromtxt(out, delimiter=",", names=True)
    assert found["target"].tolist() == [0, 0, 2, 2]
    wanted = sorted(lecture(0.5, 0.3)) + sorted(lecture(0.2, -0.4))
    rows = [[r["q1"], r["q2"]] for r in found]
    np.testing.assert_allclose(sorted(rows[:2]) + sorted(rows[2:]), wanted, atol=1e-9)
    data = Table("ik", "two_link", "--frame", "e", "--target", targets, "--all", "--json").json()
    assert [len(t["solutions"]) for t in data["targets"]] == [2, 0, 2]
    assert [t["success"] for t in data["targets"]] == [True, False, True]
    np.testing.assert_allclose(
        sorted(list(s["q"].values()) for s in data["targets"][0]["solutions"]),
        wanted[:2],
        atol=1e-9,
    )
    array = tmp_path / "q.npy"
    Table("ik", "two_link", "--frame", "e", "--target", targets, "--all", "-o", array)
    q = np.load(array)
    assert (
        q.shape[0] == 3
        and q.shape[2] == 2
        and np.isnan(q[1]).all()
        and np.isfinite(q[0]).all(axis=-1).sum() == 2
    )


def test_what_is_written_is_read_by_fk(tmp_path):
    out = tmp_path / "q.csv"
    result = Table(
        "ik",
        "puma560",
        "--frame",
        "tool",
        "--target",
        "0.5,0.2,0.1,0,90,0",
        "--deg",
        "--all",
        "-o",
        out,
    )
    assert result.code == 0 and f"written to {out}" in result.out
    poses = Table("fk", "puma560", "--frame", "tool", "--q", out, "--deg", "--json").json()[
        "configurations"
    ]
    assert len(poses) == 8
    for pose in poses:
        np.testing.assert_allclose(pose["xyz"], [0.5, 0.2, 0.1], atol=1e-9)


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
    assert data == json.loads(json.dumps(kempe.load("puma560").inverse.plan("tool").data()))


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


def test_names_stand_in_columns_where_solutions_do():
    """A chain with more coordinates than fit into lines: one row a word, with the word that the
    solution's name has.
    """
    rows = [
        {"alpha": 1.5707963267948966},
        {"a": 0.4},
        {"a": 0.02, "alpha": -1.5707963267948966, "d": 0.15},
        {"alpha": 1.5707963267948966, "d": 0.43},
        {"alpha": -1.5707963267948966},
        {},
    ]
    m = kempe.from_dh(rows)
    for k in range(3):
        m.revolute(f"f{k}", "link6", m.body(f"f{k}"))
    system = m.build()
    answer = system.ik_all(system.fk(system.random(1), "tool"), "tool")
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(ik_report.solutions(answer))
    lines = {line.split()[0]: line for line in console.export_text().splitlines() if line.split()}
    for head, j in (("shoulder", 0), ("elbow", 1), ("wrist", 2)):
        words = [name.split(", ")[j].removeprefix(f"{head} ") for name in answer.names]
        assert lines[head].replace("no flip", "no_flip").split()[1:] == [
            w.replace(" ", "_") for w in words
        ]
