"""Tasks and paths on the command line: files of tasks, batches, interrupts, sentences for what is
wrong.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command import Result

import kempe
from kempe import tasks
from kempe.arguments import call_until_interrupt
from kempe.cli import task_file

HAND = "panda_link7"

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


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(name: str, text: str) -> str:
    Path(name).write_text(text)
    return name


def fk(q: dict[str, float]) -> np.ndarray:
    panda = kempe.load("panda")
    return panda.fk(panda.q(q), HAND)


def test_several_tasks(folder):
    data = Result("ik", "panda", "--tasks", write("t.toml", TASKS), "--deg", "--json").json()
    assert data["success"] and data["q"]["panda_joint1"] == pytest.approx(20.0, abs=1e-4)
    X = fk({k: np.deg2rad(x) for k, x in data["q"].items()})
    np.testing.assert_allclose(X[:3, 3], [0.4, 0.1, 0.5], atol=1e-6)
    np.testing.assert_allclose(X[:3, 2], [0, 0, -1], atol=1e-6)
    shown = Result("ik", "panda", "--tasks", "t.toml", "--prefer", "mid")
    assert shown.code == 0 and "all hard tasks hold" in shown.out
    assert Result("ik", "panda", "--tasks", "t.toml", "--prefer", "most").code == 2


def test_what_tasks_contradict_is_said(folder):
    two = (
        TASKS
        + '[[task]]\ntype = "position"\nname = "elsewhere"\nframe = "panda_link7"\ntarget = [0, 0.4, 0.5]\n'
    )
    result = Result("ik", "panda", "--tasks", write("t.toml", two))
    assert result.code == 1 and "contradictory" in result.out and "elsewhere" in result.out


def test_every_type_is_read(folder):
    """Each class of the task zoo, with its goal, as the class itself would take it."""
    panda = kempe.load("panda")
    link = '"panda_link4"'
    pose = "[0.3, 0.1, 0.5, 0.1, 0.2, 0.3]"
    body = {
        "pose": f"target = {pose}",
        "position": "target = [0.3, 0, 0.5]\npoint = [0, 0, 0.1]",
        "orientation": "target = [0.1, 0.2, 0.3]",
        "pointing": "direction = [0, 0, -1]\naxis = [1, 0, 0]",
        "look_at": "target = [1, 0, 0]",
        "on_line": "origin = [0.3, 0, 0]\ndirection = [0, 0, 1]",
        "on_plane": "origin = [0.3, 0, 0]\nnormal = [0, 0, 1]",
        "half_space": "origin = [0.3, 0, 0]\nnormal = [0, 0, 1]\nmargin = 0.1",
        "on_sphere": "center = [0.3, 0, 0]\nradius = 0.2",
        "in_box": f"low = [0, 0, 0]\nhigh = [0.1, 0.2, 0.3]\npose = {pose}",
        "relative_pose": f"other = {link}\ntarget = {pose}",
        "relative_position": f"other = {link}\ntarget = [0, 0, 1]",
        "distance": f"other = {link}\nat_least = 0.1",
        "centre_of_points": (
            'frames = ["panda_link3", "panda_link7"]\ntarget = [0.3, 0, 0.5]\naxes = "xy"'
        ),
        "centre_of_mass": "target = [0.3, 0, 0.5]\nwithin = 0.1",
        "posture": "q = {panda_joint1 = 0.3}",
    }
    assert set(body) <= set(task_file.list_constraint_types())
    for name, lines in body.items():
        if name == "centre_of_mass" and not any(b.mass for b in panda.mechanism.bodies.values()):
            continue
        frame = (
            ""
            if name in ("centre_of_points", "centre_of_mass", "posture")
            else f'frame = "{HAND}"\n'
        )
        file = write(f"{name}.toml", f'[[task]]\ntype = "{name}"\nweight = 2.0\n{frame}{lines}\n')
        (made,) = task_file.read_tasks(panda, Path(file)).tasks
        assert task_file.list_constraint_types()[name] is type(made) and made.weight == 2.0
        assert np.isfinite(tasks.error(panda, made, panda.mid)).all()
    (made,) = task_file.read_tasks(panda, Path("pose.toml"), degrees=True).tasks
    np.testing.assert_allclose(made.target[:3, 3], [0.3, 0.1, 0.5])
    np.testing.assert_allclose(made.target[1, 0] / made.target[0, 0], np.tan(np.deg2rad(0.3)))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# none", "t.toml:1: there are no tasks; write [[task]]"),
        ("[task]\ntype = 'pose'", "t.toml:1: 'task' is not a list of tables"),
        (
            "[[task]]\ntarget = [1, 2, 3]",
            "t.toml:1: task '1': the key 'type' is missing; it must be one of",
        ),
        (
            "[[task]]\ntype = 'poyntin'",
            "t.toml:2: task 'poyntin': unknown type of task 'poyntin'; did you mean",
        ),
        ("[[task]]\ntype = 'function'", "unknown type of task 'function'"),
        (
            "[[task]]\ntype = 'pose'\nframe = 'panda_link7'\ntargt = [1]",
            "t.toml:4: task 'pose': unknown key 'targt'",
        ),
        (
            "[[task]]\ntype = 'pose'\nframe = 'panda_link7'",
            "task 'pose': the key 'target' is missing; it needs frame",
        ),
        (
            "[[task]]\ntype = 'position'\nname = 'a'\nframe = 'x'\ntarget = [1, 2, 3]",
            "t.toml:4: task 'a': panda has",
        ),
        (
            "[[task]]\ntype = 'position'\nframe = 'panda_link7'\ntarget = [1, 2]",
            "t.toml:4: task 'position': target of",
        ),
        (
            "[[task]]\ntype = 'position'\nframe = 7\ntarget = [1, 2, 3]",
            "t.toml:3: task 'position': frame is '7'",
        ),
        (
            "[[task]]\ntype = 'position'\nframe = 'panda_link7'\ntarget = 'x'",
            "t.toml:4: task 'position': target is",
        ),
        ("[[task]]\ntype = 'posture'\nq = {panda_joint9 = 1}", "t.toml:3: task 'posture'"),
        (
            "[[task]]\ntype = 'posture'\nq = {panda_joint1 = 1}\nweight = 'much'",
            "t.toml:4: task 'posture': weight is",
        ),
        (
            "[[task]]\ntype = 'posture'\nq = {panda_joint1 = 1}\npriority = 0.5",
            "priority is '0.5'; it must be a whole",
        ),
        (
            "[[task]]\ntype = 'position'\nframe = 'panda_link7'\ntarget = 'no.csv'",
            "no.csv: there is no such file",
        ),
        ("tasks = 3\n[[task]]", "t.toml:1: unknown key 'tasks'"),
        ("[[task", "this is not TOML"),
    ],
)
def test_wrong_files(folder, text, said):
    result = Result("ik", "panda", "--tasks", write("t.toml", text))
    assert result.code == 2 and said in result.err, result.err
    assert Result("ik", "panda", "--tasks", "t.toml", "--json").json()["error"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--tasks", "t.toml", "--frame", HAND], "leave --frame out"),
        (["--tasks", "t.toml", "--all"], "--all"),
        (["--frame", HAND], "'--target'"),
        ([], "'--frame'"),
        (["--tasks", "no.toml"], "no such file"),
        (["--frame", HAND, "--target", "1,0,0", "--prefer", "mid"], "--prefer is for --tasks"),
    ],
)
def test_what_does_not_go_together(folder, options, said):
    write("t.toml", TASKS)
    result = Result("ik", "panda", *options)
    assert result.code == 2 and said in result.err and result.err.count("\n") == 1


BATCH = TASKS.replace("[0.4, 0.1, 0.5]", '"targets.csv"').replace("[0, 0, -1]", '"ways.csv"')


def batch(n: int) -> np.ndarray:
    targets = np.column_stack([np.full(n, 0.4), np.linspace(0.0, 0.2, n), np.full(n, 0.5)])
    np.savetxt("targets.csv", targets, delimiter=",", header="x,y,z", comments="")
    np.savetxt("ways.csv", np.tile([0.0, 0.0, -1.0], (n, 1)), delimiter=",")
    write("batch.toml", BATCH)
    return targets


def test_a_batch_of_tasks(folder):
    targets = batch(7)
    data = Result("ik", "panda", "--tasks", "batch.toml", "--json").json()
    assert data["success"] == [True] * 7
    np.testing.assert_allclose([fk(q)[:3, 3] for q in data["q"]], targets, atol=1e-6)
    np.savetxt("ways.csv", np.tile([0.0, 0.0, -1.0], (4, 1)), delimiter=",")
    result = Result("ik", "panda", "--tasks", "batch.toml")
    assert result.code == 2 and "4, 7 rows" in result.err


# ---- paths


def test_a_path(folder):
    targets = batch(12)
    result = Result(
        "path", "panda", "--frame", HAND, "--targets", "targets.csv", "-o", "q.csv", "--deg"
    )
    assert (
        result.code == 0
        and "12 of 12 targets followed" in result.out
        and "largest step" in result.out
    )
    found = np.deg2rad(np.loadtxt("q.csv", delimiter=",", skiprows=1))
    np.testing.assert_allclose(kempe.load("panda").fk(found, HAND)[:, :3, 3], targets, atol=1e-9)
    data = Result("path", "panda", "--frame", HAND, "--targets", "targets.csv", "--json").json()
    assert (
        data["success"] and len(data["q"]) == 12 and data["jumps"] == [] and not data["interrupted"]
    )
    of_tasks = Result("path", "panda", "--tasks", "batch.toml", "--json").json()
    X = np.array([fk(q) for q in of_tasks["q"]])
    np.testing.assert_allclose(X[:, :3, 3], targets, atol=1e-9)
    np.testing.assert_allclose(X[:, :3, 2], [[0, 0, -1]] * 12, atol=1e-9)


def test_a_path_that_stops(folder):
    out = np.column_stack([np.linspace(0.6, 1.6, 12), np.zeros(12), np.full(12, 0.4)])
    np.savetxt("t.csv", out, delimiter=",")
    stopped = Result("path", "panda", "--frame", HAND, "--targets", "t.csv")
    assert stopped.code == 1 and "of 12 targets followed; stops" in stopped.out
    np.savetxt("far.csv", out + [2.0, 0.0, 0.0], delimiter=",")
    assert "does not begin" in Result("path", "panda", "--frame", HAND, "--targets", "far.csv").out
    for options, said in (
        (["--targets", "0.4,0,0.5"], ".csv or .npy"),
        (["--targets", "t.csv", "--max-step", "-1"], "max_step"),
        (["--targets", "t.csv", "--tasks", "x"], "leave --frame out"),
        ([], "'--target'"),
    ):
        result = Result("path", "panda", "--frame", HAND, *options)
        assert result.code == 2 and said in result.err


def test_an_interrupted_path():
    panda = kempe.load("panda")
    done = []
    targets = np.column_stack([np.full(9, 0.4), np.linspace(0.0, 0.2, 9), np.full(9, 0.5)])

    def progress(count: int) -> None:
        done.append(count)
        if count == 5:
            raise KeyboardInterrupt

    path = call_until_interrupt(
        panda.ik_path, targets, HAND, budget=kempe.Budget(progress=progress)
    )
    assert done == [2, 3, 4, 5] and path.interrupted and "interrupted" in path.status
    assert list(path.success) == [True] * 5 + [False] * 4 and np.isnan(path.q[5:]).all()
