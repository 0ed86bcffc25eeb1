"""The commands about what is reached, beside the library."""

from __future__ import annotations

import numpy as np
import pytest
import typer
from command import Result

import kempe
from kempe import Budget
from kempe.arguments import call_until_interrupt
from kempe.cli.terminal import end_incomplete_command
from kempe.workspace import base_placement


@pytest.mark.slow
def test_singularities_as_text_and_json():
    run = Result("singularities", "puma560", "--frame", "tool", "--at", "q5=0.2", "--json")
    data = run.json()
    answer = kempe.load("puma560").singularities("tool")
    assert run.code == 0 and [s["name"] for s in data["sets"]] == [s.name for s in answer.sets]
    assert data["nearest"]["distances"]["wrist (q5 = 0)"] == pytest.approx(0.2, abs=1e-6)
    text = Result("singularities", "two_link", "--frame", "e", "--at", "q2=10", "--deg")
    assert text.code == 0 and "q2 = 0 or 3.142" in text.out and "0.1745 away" in text.out


@pytest.mark.slow
def test_singularities_are_drawn(tmp_path):
    file = tmp_path / "singular.png"
    run = Result("singularities", "two_link", "--frame", "e", "--starts", "8", "--plot", str(file))
    assert run.code == 0 and file.read_bytes()[:4] == b"\x89PNG" and "serial" in run.out
    refused = Result(
        "singularities", "two_link", "--frame", "e", "--plot", str(tmp_path / "singular.xyz")
    )
    assert refused.code and ".xyz" in refused.err


@pytest.mark.slow
def test_singularities_of_loops():
    data = Result(
        "singularities", "four_bar", "--frame", "rocker", "--inputs", "A", "--json"
    ).json()
    assert [(s["kinds"], len(s["q"])) for s in data["sets"]] == [(["type 1"], 4)]
    none = Result("singularities", "four_bar", "--frame", "coupler", "--inputs", "A")
    assert none.code == 1 and "no singular configuration found" in none.out


def interrupted(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    "ask",
    [
        lambda arm, X, budget: arm.reach.poses(X, "tool", budget=budget),
        lambda arm, X, budget: arm.reach.place(X, "tool", {"x": (0.0, 0.1)}, 4000, budget=budget),
        lambda arm, X, budget: arm.singularities("tool", budget=budget),
    ],
    ids=["reach", "place", "singularities"],
)
def test_what_was_interrupted_ends_with_the_code_of_ctrl_c(ask):
    arm = kempe.load("ur5")
    answer = call_until_interrupt(
        ask, arm, arm.fk(arm.mid, "tool")[None], Budget(starts=20, progress=interrupted)
    )
    assert "interrupted" in str(answer) or len(answer.codes) == 1
    with pytest.raises(typer.Exit) as end:
        end_incomplete_command(answer)
    assert end.value.exit_code == 130


def test_many_starts_and_places_are_not_prepared_at_once(monkeypatch):
    """What is made of all of them takes long, and cannot be interrupted."""
    made = list[int]()
    pose = base_placement.compute_base_poses
    monkeypatch.setattr(
        base_placement,
        "compute_base_poses",
        lambda places: made.append(len(places)) or pose(places),
    )
    arm = kempe.load("ur5")
    X = arm.fk(arm.mid, "tool")[None]
    with pytest.raises(kempe.Interrupted):
        arm.reach.place(
            X, "tool", {"x": (0.0, 0.1)}, 100_000, budget=Budget(starts=1, progress=interrupted)
        )
    assert made == [2048]


def test_poses_of_a_file(tmp_path):
    arm = kempe.load("ur5")
    path = tmp_path / "weld.csv"
    path.write_text("x,y,z,roll,pitch,yaw\n0.4,0.1,0.5,180,0,0\n0.5,0.1,0.4,180,0,0\n3,0,0,0,0,0\n")
    run = Result("reach", "ur5", path, "--frame", "tool", "--deg", "--json")
    data = run.json()
    assert (
        run.code == 1 and data["reached"] == [True, True, False] and data["solutions"] == [8, 8, 0]
    )
    assert "outside the workspace" in data["reasons"]["2"] and data["codes"][2] == "OUT_OF_REACH"
    written = Result("reach", "ur5", path, "--frame", "tool", "--deg", "-o", tmp_path / "q.csv")
    rows = np.loadtxt(tmp_path / "q.csv", delimiter=",", skiprows=1)
    assert written.code == 1 and np.isfinite(rows).all(axis=1).tolist() == [True, True, False]
    text = Result("reach", "ur5", path, "--frame", "tool", "--deg")
    assert "2 of 3 poses reached" in text.out and "pose 2: outside" in text.out
    box = ("--box", "x=-0.5,0.5", "--box", "yaw=90", "--cells", "3")
    placed = Result("place", "ur5", path, "--frame", "tool", "--deg", *box, "--json").json()
    assert placed["fixed"]["yaw"] == pytest.approx(90.0) and len(placed["fraction"]) == 3
    assert max(placed["fraction"]) == pytest.approx(2 / 3) and set(placed["best"]) == {
        "x",
        "y",
        "z",
        "yaw",
    }
    assert arm.name == data["system"]


@pytest.mark.slow
def test_what_is_reached_is_drawn(tmp_path):
    """Every place is inside the axes, marked by whether it is reached; so are the map of the base,
    and an arm.
    """
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra view)")
    path = tmp_path / "points.csv"
    files = [tmp_path / f"{k}.svg" for k in range(4)]
    path.write_text("x,y\n0.5,0.3\n3,0.3\n-0.2,0.4\n")
    run = Result("reach", "two_link", path, "--frame", "e", "--plot", files[0])
    assert run.code == 1 and f"written to {files[0]}" in run.out
    assert all(f'id="poses:{name}"' in files[0].read_text() for name in ("reached", "not reached"))
    ax = kempe.load("two_link").reach.poses([[0.5, 0.3], [3.0, 0.3], [-0.2, 0.4]], "e").plot()
    marked = {
        line.get_gid(): line.get_xydata().tolist()
        for line in ax.lines
        if str(line.get_gid()).startswith("poses")
    }
    assert marked == {"poses:reached": [[0.5, 0.3], [-0.2, 0.4]], "poses:not reached": [[3.0, 0.3]]}
    assert ax.get_xlim()[0] < -0.2 and ax.get_xlim()[1] > 3.0
    arm = kempe.load("ur5")
    far = arm.fk(arm.random(0, 2), "tool")
    far[1, :3, 3] = 2.0
    axes = arm.reach.poses(far, "tool").plot()
    assert all(limits()[1] > 2.0 for limits in (axes.get_xlim, axes.get_ylim, axes.get_zlim))
    none = arm.reach.poses(far[:0], "tool")
    assert (
        none.plot().get_legend() is None
        and none.q.shape == (0, 6)
        and "0 of 0 poses" in none.status
    )
    box = ("--box", "x=-1,1", "--box", "y=-1,1", "--cells", "3")
    assert Result("place", "two_link", path, "--frame", "e", *box, "--plot", files[1]).code == 1
    assert "<svg" in files[1].read_text()
    assert (
        Result("fk", "two_link", "--frame", "e", "--q", "30,50", "--deg", "--plot", files[2]).code
        == 0
    )
    assert 'id="mark:e:x"' in files[2].read_text()
    refused = Result("fk", "two_link", "--q", "0,0", "--plot", tmp_path / "arm.txt")
    assert refused.code == 2 and "pictures are .png, .svg or .pdf files" in refused.err


@pytest.mark.slow
def test_the_time_limit_of_the_commands(tmp_path):
    path = tmp_path / "weld.npy"
    np.save(path, kempe.load("ur5").fk(kempe.load("ur5").random(0, 30_000), "tool"))
    run = Result("reach", "ur5", path, "--frame", "tool", "--time-limit", "1e-9", "--json")
    assert run.code == 1 and set(run.json()["codes"][20_000:]) == {"OUT_OF_TIME"}
    run = Result("singularities", "puma560", "--frame", "tool", "--time-limit", "1e-9")
    assert (
        run.code == 1
        and "singularities: the time limit of 1e-09 s was over before anything was known" in run.err
    )


def test_wrong_files_and_boxes(tmp_path):
    path = tmp_path / "weld.csv"
    path.write_text("0.4,0.1,0.5,0,0,0\n")
    for arguments, said in [
        (("reach", "ur5", "0.4,0.1,0.5", "--frame", "tool"), "POSES"),
        (("reach", "ur5", tmp_path / "none.csv", "--frame", "tool"), "no such file"),
        (("reach", "ur5", path, "--frame", "hand"), "hand"),
        (("place", "ur5", path, "--frame", "tool", "--box", "x"), "it must be NAME=VALUE"),
        (("place", "ur5", path, "--frame", "tool", "--box", "x=a,b"), "is not a number"),
        (("place", "ur5", path, "--frame", "tool", "--box", "w=0,1"), "w"),
        (("place", "ur5", path, "--frame", "tool", "--box", "x=0,1", "--cells", "0"), "cells"),
    ]:
        run = Result(*arguments)
        assert run.code == 2 and said in run.out + run.err, arguments


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("singularities", "puma560"), "name a frame"),
        (("singularities", "puma560", "--frame", "hand"), "hand"),
        (("singularities", "four_bar", "--inputs", ","), "names no joint"),
        (("singularities", "four_bar", "--inputs", "E"), "E"),
        (("singularities", "puma560", "--frame", "tool", "--at", "q9=1"), "q9"),
        (("singularities", "puma560", "--frame", "tool", "--starts", "0"), "starts"),
    ],
)
def test_wrong_calls_of_commands(arguments, said):
    for more in ((), ("--json",)):
        run = Result(*arguments, *more)
        assert run.code == 2 and said in run.out + run.err


def test_poses_with_several_leading_axes_are_refused():
    robot = kempe.load("ur5")
    X = robot.fk(robot.random(0, 6), "tool").reshape(2, 3, 4, 4)
    with pytest.raises(
        kempe.errors.InputError, match=r"targets have shape \(2, 3, 4, 4\); they must be a list"
    ):
        robot.reach.poses(X, "tool")
