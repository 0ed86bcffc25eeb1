"""The commands for all solutions as their users see them: tables, JSON, files, exit codes, errors."""

from __future__ import annotations

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


# ---- many targets and files


# ---- the plan


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
        ([*ALL, "--all", "--task", "pose"], "task 'pose' asks for an orientation"),
        ([*ALL, "--all", "--hold", "q3=0"], "'q3'"),
        ([*ALL, "--all", "--hold", "q1"], "name=value"),
        ([*ALL, "--all", "--hold", "q1=x"], "'x'"),
        ([*ALL, "--all", "--tolerance", "1e-6,1e-3"], "must be a positive number"),
        ([*ALL, "--all", "--tolerance", "-1"], "must be a positive number"),
        ([*ALL[:-1], "0.5,0.3,1", "--all", "--axis", "0,0,1"], "--axis is for"),
        ([*FIVE, "--axis", "1,2"], "it must be three numbers"),
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
