"""Inverse kinematics on the command line beside independent formulas: solutions, tasks, paths."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from command import LIMITED, Result

import kempe
from kempe import tasks
from kempe.arguments import call_until_interrupt
from kempe.cli import task_file

HAND = "panda_link7"
L1 = 0.5
L2 = 0.4


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(name: str, text: str) -> str:
    Path(name).write_text(text)
    return name


# ---- all solutions of one target


def lecture(x: float, y: float) -> list[list[float]]:
    """Both configurations of the lecture's two-link arm, by its formula, elbow up first."""
    c2 = (x * x + y * y - L1 * L1 - L2 * L2) / (2 * L1 * L2)
    out = []
    for sign in (-1, 1):
        s2 = sign * math.sqrt(1 - c2 * c2)
        out.append([math.atan2(y, x) - math.atan2(L2 * s2, L1 + L2 * c2), math.atan2(s2, c2)])
    return out


def test_the_arm_of_the_lecture():
    words = ("ik", "two_link", "--frame", "e", "--all", "--target", "0.5,0.3")
    data = Result(*words, "--json").json()
    rows = [list(q.values()) for q in data["q"]]
    np.testing.assert_allclose(sorted(rows, key=lambda r: r[1]), lecture(0.5, 0.3), atol=1e-12)
    assert data["names"] == ["elbow-up" if q[1] < 0 else "elbow-down" for q in rows]
    lines = Result(*words).out.splitlines()
    shown = [line.split() for line in lines[3:5]]
    np.testing.assert_allclose([[float(x) for x in row[:2]] for row in shown], rows, atol=1e-6)
    assert lines[0].startswith("2 solutions") and [row[-1] for row in shown] == data["names"]


def test_a_puma_has_eight(folder):
    """They stand in the file, those inside the limits first, and reach."""
    words = ("ik", "puma560", "--frame", "tool", "--target", "0.5,0.2,0.1,0,90,0", "--deg", "--all")
    assert Result(*words, "-o", "q.csv").code == 0
    robot = kempe.load("puma560")
    q = np.radians(np.loadtxt("q.csv", delimiter=",", skiprows=1)[:, : robot.nq])
    limits = robot.structure.limits
    inside = ((q >= limits[:, 0]) & (q <= limits[:, 1])).all(axis=1).tolist()
    assert len(q) == 8 and inside == sorted(inside, reverse=True)
    poses = Result("fk", "puma560", "--frame", "tool", "--q", "q.csv", "--deg", "--json").json()
    for pose in poses["configurations"]:
        np.testing.assert_allclose(pose["xyz"], [0.5, 0.2, 0.1], atol=1e-9)


def test_a_table_of_answers_is_read_as_configurations(folder):
    """Columns for success, errors and targets stand in it, and `kempe fk` reads the coordinates."""
    Path("t.csv").write_text("x,y,z\n0.5,0.2,0.1\n0.4,0.3,0.2\n")
    words = ("ik", "puma560", "--frame", "tool", "--task", "position", "--target", "t.csv")
    assert Result(*words, "-o", "q.csv").code == 0
    head = Path("q.csv").read_text().splitlines()[0]
    assert head == (
        "q1,q2,q3,q4,q5,q6,success,position_error,orientation_error,target_x,target_y,target_z"
    )
    poses = Result("fk", "puma560", "--frame", "tool", "--q", "q.csv", "--json").json()
    xyz = [pose["xyz"] for pose in poses["configurations"]]
    np.testing.assert_allclose(xyz, [[0.5, 0.2, 0.1], [0.4, 0.3, 0.2]], atol=1e-6)


def test_limits():
    """Elbow-up breaks the limit: it is listed, but does not count."""
    for limits, inside in (("[0, 3]", [True, False]), ("[0, 1]", [False, False])):
        file = write("limited.toml", LIMITED.replace("limits = [0, 3]", f"limits = {limits}"))
        words = ("ik", file, "--frame", "tip", "--target", "0.5,0.3", "--all")
        shown = Result(*words)
        assert ["outside" not in x for x in shown.out.splitlines()[3:5]] == inside
        assert shown.code == (not any(inside)) and ("--q" in shown.out) == any(inside)
        assert Result(*words, "--json").json()["success"] == any(inside)


def test_families():
    """With equal links and the tip at the base, every shoulder angle will do."""
    equal = LIMITED.replace("at = [0.4, 0]", "at = [0.5, 0]").replace(", limits = [0, 3]", "")
    words = ("ik", write("equal.toml", equal), "--frame", "tip", "--target", "0,0", "--all")
    result = Result(*words)
    assert result.code == 0 and "family: " in result.out and "shoulder" in result.out
    (family,) = Result(*words, "--deg", "--json").json()["families"]
    assert (family["freedoms"], family["joints"], family["closed"]) == (1, ["shoulder"], True)
    q = np.array([list(row.values()) for row in family["q"]])
    np.testing.assert_allclose(np.abs(q[:, 1]), 180.0, atol=1e-6)
    assert np.ptp(q[:, 0]) > 300.0


# ---- files of tasks

TASKS = """\
[[task]]
type = "position"
frame = "panda_link7"
target = [0.4, 0.1, 0.5]

[[task]]
type = "pointing"
frame = "panda_link7"
direction = [0, 0, -1]

[[task]]
type = "posture"
q = {panda_joint1 = 20}
priority = 1
"""


def fk(q: dict[str, float]) -> np.ndarray:
    panda = kempe.load("panda")
    return panda.fk(panda.q(q), HAND)


def test_several_tasks():
    data = Result("ik", "panda", "--tasks", write("t.toml", TASKS), "--deg", "--json").json()
    assert data["success"] and data["q"]["panda_joint1"] == pytest.approx(20.0, abs=1e-4)
    X = fk({k: np.deg2rad(x) for k, x in data["q"].items()})
    np.testing.assert_allclose(X[:3, 3], [0.4, 0.1, 0.5], atol=1e-6)
    np.testing.assert_allclose(X[:3, 2], [0, 0, -1], atol=1e-6)
    shown = Result("ik", "panda", "--tasks", "t.toml", "--prefer", "mid")
    assert shown.code == 0 and "all hard tasks hold" in shown.out
    two = (
        TASKS
        + '[[task]]\ntype="position"\nname="elsewhere"\nframe="panda_link7"\ntarget=[0,0.4,0.5]'
    )
    result = Result("ik", "panda", "--tasks", write("t.toml", two))
    assert result.code == 1 and "contradictory" in result.out and "elsewhere" in result.out


LINK = 'other = "panda_link4"'
POSE = "[0.3, 0.1, 0.5, 0.1, 0.2, 0.3]"
BODIES = {
    "pose": f"target = {POSE}",
    "position": "target = [0.3, 0, 0.5]\npoint = [0, 0, 0.1]",
    "orientation": "target = [0.1, 0.2, 0.3]",
    "pointing": "direction = [0, 0, -1]\naxis = [1, 0, 0]",
    "look_at": "target = [1, 0, 0]",
    "on_line": "origin = [0.3, 0, 0]\ndirection = [0, 0, 1]",
    "on_plane": "origin = [0.3, 0, 0]\nnormal = [0, 0, 1]",
    "half_space": "origin = [0.3, 0, 0]\nnormal = [0, 0, 1]\nmargin = 0.1",
    "on_sphere": "center = [0.3, 0, 0]\nradius = 0.2",
    "in_box": f"low = [0, 0, 0]\nhigh = [0.1, 0.2, 0.3]\npose = {POSE}",
    "relative_pose": f"{LINK}\ntarget = {POSE}",
    "relative_position": f"{LINK}\ntarget = [0, 0, 1]",
    "distance": f"{LINK}\nat_least = 0.1",
    "centre_of_points": f'frames = ["panda_link3", "{HAND}"]\ntarget = [0.3, 0, 0.5]\naxes = "xy"',
    "posture": "q = {panda_joint1 = 0.3}",
}
"""A task of each type with its goal; the last two have no frame. The model has no masses."""


@pytest.mark.parametrize("name", BODIES)
def test_every_type_is_read(name):
    """Each class of the task zoo, with its goal, as the class itself would take it."""
    panda = kempe.load("panda")
    frame = "" if name in [*BODIES][-2:] else f'frame = "{HAND}"\n'
    file = write("t.toml", f'[[task]]\ntype = "{name}"\nweight = 2.0\n{frame}{BODIES[name]}\n')
    (made,) = task_file.read_tasks(panda, Path(file)).tasks
    assert task_file.list_constraint_types()[name] is type(made) and made.weight == 2.0
    assert np.isfinite(tasks.error(panda, made, panda.mid)).all()
    if name == "pose":
        (made,) = task_file.read_tasks(panda, Path(file), degrees=True).tasks
        np.testing.assert_allclose(made.target[:3, 3], [0.3, 0.1, 0.5])
        slope = made.target[1, 0] / made.target[0, 0]
        np.testing.assert_allclose(slope, np.tan(np.deg2rad(0.3)))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# none", "t.toml:1: there are no tasks; write [[task]]"),
        ("[task]\ntype = 'pose'", "t.toml:1: 'task' is not a list of tables"),
        ("tasks = 3\n[[task]]", "t.toml:1: unknown key 'tasks'"),
        ("[[task", "this is not TOML"),
        ("target=[1]", "t.toml:1: task '1': the key 'type' is missing; it must be one of"),
        (
            "type='poyntin'",
            "t.toml:2: task 'poyntin': unknown type of task 'poyntin'; did you mean",
        ),
        ("type='function'", "unknown type of task 'function'"),
        ("type='pose';frame='tool';targt=[1]", "t.toml:4: task 'pose': unknown key 'targt'"),
        ("type='pose';frame='tool'", "task 'pose': the key 'target' is missing; it needs frame"),
        ("type='pose';frame='tool';target=[1,2,3]", "t.toml:4: task 'pose': a pose has"),
        ("type='position';name='a';frame='x';target=[1,2,3]", "t.toml:4: task 'a': panda has"),
        ("type='position';frame='tool';target=[1,2]", "t.toml:4: task 'position': target of"),
        ("type='position';frame=7;target=[1,2,3]", "t.toml:3: task 'position': frame is '7'"),
        ("type='position';frame='tool';target='x'", "t.toml:4: task 'position': target is"),
        ("type='position';frame='tool';target='no.csv'", "no.csv: there is no such file"),
        ("type='posture';q={panda_joint9=1}", "t.toml:3: task 'posture'"),
        ("type='posture';q={panda_joint1=1};weight='much'", "t.toml:4: task 'posture': weight is"),
        ("type='posture';q={panda_joint1=1};priority=0.5", "is '0.5'; it must be a whole"),
    ],
)
def test_wrong_files(text, said):
    lines = text if text[0] in "#[" or "[[" in text else f"[[task]]\n{text}"
    file = write("t.toml", lines.replace(";", "\n"))
    result = Result("ik", "panda", "--tasks", file)
    assert result.code == 2 and said in result.err, result.err
    assert Result("ik", "panda", "--tasks", "t.toml", "--json").json()["error"]


def batch(n: int) -> np.ndarray:
    """Write a file of the first two tasks whose values are `n` rows of two files."""
    targets = np.column_stack([np.full(n, 0.4), np.linspace(0.0, 0.2, n), np.full(n, 0.5)])
    np.savetxt("targets.csv", targets, delimiter=",", header="x,y,z", comments="")
    np.savetxt("ways.csv", np.tile([0.0, 0.0, -1.0], (n, 1)), delimiter=",")
    text = TASKS.replace("[0.4, 0.1, 0.5]", '"targets.csv"').replace("[0, 0, -1]", '"ways.csv"')
    write("batch.toml", text)
    return targets


def test_a_batch_of_tasks():
    targets = batch(7)
    data = Result("ik", "panda", "--tasks", "batch.toml", "--json").json()
    assert data["success"] == [True] * 7
    np.testing.assert_allclose([fk(q)[:3, 3] for q in data["q"]], targets, atol=1e-6)
    np.savetxt("ways.csv", np.tile([0.0, 0.0, -1.0], (4, 1)), delimiter=",")
    result = Result("ik", "panda", "--tasks", "batch.toml")
    assert result.code == 2 and "4, 7 rows" in result.err


# ---- paths


def test_a_path():
    targets = batch(12)
    words = ("path", "panda", "--frame", HAND, "--targets", "targets.csv")
    result = Result(*words, "-o", "q.csv", "--deg")
    assert result.code == 0 and "12 of 12 targets followed" in result.out
    assert "largest step" in result.out
    found = np.deg2rad(np.loadtxt("q.csv", delimiter=",", skiprows=1)[:, :7])
    np.testing.assert_allclose(kempe.load("panda").fk(found, HAND)[:, :3, 3], targets, atol=1e-9)
    data = Result(*words, "--json").json()
    assert data["success"] and len(data["q"]) == 12
    assert data["jumps"] == [] and not data["interrupted"]
    of_tasks = Result("path", "panda", "--tasks", "batch.toml", "--json").json()
    X = np.array([fk(q) for q in of_tasks["q"]])
    np.testing.assert_allclose(X[:, :3, 3], targets, atol=1e-9)
    np.testing.assert_allclose(X[:, :3, 2], [[0, 0, -1]] * 12, atol=1e-9)


def test_a_path_that_stops():
    out = np.column_stack([np.linspace(0.6, 1.6, 12), np.zeros(12), np.full(12, 0.4)])
    np.savetxt("t.csv", out, delimiter=",")
    stopped = Result("path", "panda", "--frame", HAND, "--targets", "t.csv")
    assert stopped.code == 1 and "of 12 targets followed; stops" in stopped.out
    np.savetxt("far.csv", out + [2.0, 0.0, 0.0], delimiter=",")
    assert "does not begin" in Result("path", "panda", "--frame", HAND, "--targets", "far.csv").out


def test_an_interrupted_path():
    panda = kempe.load("panda")
    done = []
    targets = np.column_stack([np.full(900, 0.4), np.linspace(0.0, 0.2, 900), np.full(900, 0.5)])

    def progress(count: int) -> None:
        done.append(count)
        if count == 5:
            raise KeyboardInterrupt

    budget = kempe.Budget(progress=progress)
    path = call_until_interrupt(panda.ik_path, targets, HAND, budget=budget)
    assert done == [2, 3, 4, 5] and path.interrupted and "interrupted" in path.status
    followed = int(path.success.sum())
    assert 5 <= followed < 900 and path.success[:followed].all()
    assert np.isfinite(path.q[:followed]).all() and np.isnan(path.q[followed:]).all()
