"""Answers that are saved as tables: what is in the files, and that the command line writes the
same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import Result

import kempe
from kempe.answers.tables import Tabular, read_pose_columns
from kempe.errors import InputError
from kempe.system import System


def bar() -> System:
    return kempe.load("four_bar")


def redundant() -> System:
    return kempe.from_dh([(0.5, 0, 0, 0), (0.4, 0, 0, 0), (0.3, 0, 0, 0)]).build()


def targets(s: System, n: int, frame: str = "tool") -> np.ndarray:
    return s.fk(s.random(0, n), frame)


MAKERS: dict[str, Callable[[], Any]] = {
    "path": lambda: replace(bar().trace("A"), frames=("P",) if "P" in bar().frame_names else ()),
    "drive": lambda: bar().drive({"A": np.linspace(1.5, 2.5, 7)}),
    "assembly": lambda: bar().assemble({"A": 0.3}),
    "assemblies": lambda: bar().assemble({"A": [0.3, 0.4]}),
    "modes": lambda: bar().assembly_modes({"A": 0.3}),
    "solution": lambda: kempe.load("ur5").ik(targets(kempe.load("ur5"), 1)[0], "tool"),
    "solutions of a batch": lambda: kempe.load("ur5").ik(targets(kempe.load("ur5"), 3), "tool"),
    "all solutions": lambda: kempe.load("ur5").ik_all(targets(kempe.load("ur5"), 1)[0], "tool"),
    "all solutions of a batch": lambda: kempe.load("ur5").ik_all(
        targets(kempe.load("ur5"), 3), "tool"
    ),
    "tasks": lambda: redundant().ik([kempe.tasks.Position("tool", [0.5, 0.5, 0])]),
    "ik_path": lambda: redundant().ik_path(np.linspace([0.9, 0.1, 0], [0.6, 0.3, 0], 9), "tool"),
    "self_motion": lambda: redundant().inverse.self_motion(
        [0.3, 0.4, 0.5], "tool", task="position", budget=kempe.Budget(points=20)
    ),
}


@pytest.mark.parametrize("what", list(MAKERS))
def test_what_is_saved_is_the_table(what: str, tmp_path: Path):
    answer = MAKERS[what]()
    assert isinstance(answer, Tabular)
    binary, text = (answer.save(tmp_path / f"x{ending}") for ending in (".npy", ".csv"))
    names, columns = answer.table()
    assert (binary, text) == (tmp_path / "x.npy", tmp_path / "x.csv") and columns.shape == (
        len(columns),
        len(names),
    )
    plain = np.load(binary)
    np.testing.assert_array_equal(plain, columns[:, : plain.shape[1]])
    assert not {*answer.system.coordinate_names} & {*names[plain.shape[1] :]}
    head, *lines = text.read_text().splitlines()
    assert head.split(",") == names
    np.testing.assert_array_equal(
        np.array([[float(x) for x in line.split(",")] for line in lines]), columns
    )
    assert set(answer.system.coordinate_names) <= set(names)


def test_angles_of_a_drive_are_saved_in_degrees(tmp_path: Path):
    drive = bar().drive({"A": np.linspace(0.3, 0.4, 3)})
    names, columns = drive.table()
    angles = [name in drive.system.coordinate_names for name in names]
    shown = np.load(drive.save(tmp_path / "x.npy", degrees=True))
    np.testing.assert_allclose(shown, np.where(angles, np.degrees(columns), columns), rtol=1e-15)


def test_tables_have_success_errors_and_targets():
    arm = kempe.load("ur5")
    X = targets(arm, 3)
    X[1, :3, 3] = 9.0
    answer = arm.ik(X, "tool")
    table = dict(zip(answer.table()[0], answer.table()[1].T, strict=True))
    assert table["success"].tolist() == [1, 0, 1]
    np.testing.assert_array_equal(table["position_error"], answer.position_error)
    np.testing.assert_array_equal(table["orientation_error"], answer.orientation_error)
    words = ("x", "y", "z", "roll", "pitch", "yaw")
    xyz_rpy = np.column_stack([table[f"target_{word}"] for word in words])
    np.testing.assert_allclose(kempe.spatial.pose_from_xyz_rpy(xyz_rpy), X, atol=1e-12)


def test_each_of_all_solutions_has_its_target_and_error():
    arm = kempe.load("two_link")
    answer = arm.ik_all([[0.6, 0.3], [5, 5], [0.2, 0.4]], "e")
    table = dict(zip(answer.table()[0], answer.table()[1].T, strict=True))
    assert table["target"].tolist() == [0, 0, 2, 2] and table["inside"].all()
    assert table["target_x"].tolist() == [0.6, 0.6, 0.2, 0.2] and set(table["branch"]) == {0, 1}
    assert (table["residual"] < 1e-12).all() and "target_yaw" not in table
    assert arm.ik_all([5, 5], "e").table()[1].shape == (0, 7)


def test_targets_are_saved_in_degrees_and_errors_in_radians(tmp_path: Path):
    answer = kempe.load("ur5").ik(targets(kempe.load("ur5"), 2), "tool")
    names, columns = answer.table()
    file = answer.save(tmp_path / "x.csv", degrees=True)
    shown = np.loadtxt(file, delimiter=",", skiprows=1)
    angles = [n in answer.system.coordinate_names or n[-3:] in ("oll", "tch", "yaw") for n in names]
    np.testing.assert_allclose(shown, np.where(angles, np.degrees(columns), columns), rtol=1e-14)


def test_degrees_in_a_file_are_read_as_degrees(tmp_path: Path):
    """The header says so: with and without --deg, as configurations, targets and known values."""
    arm = kempe.load("ur5")
    answer = arm.ik(targets(arm, 3), "tool")
    degrees = answer.save(tmp_path / "degrees.csv", degrees=True)
    radians = answer.save(tmp_path / "radians.csv")
    heads = degrees.read_text().partition("\n")[0].split(",")
    assert [head.removesuffix(" [deg]") for head in heads] == answer.table()[0]
    assert "target_yaw [deg]" in heads and "orientation_error" in heads
    outputs = [
        [
            pose["matrix"]
            for pose in Result("fk", "ur5", "--frame", "tool", "--json", *words).json()[
                "configurations"
            ]
        ]
        for words in (["--q", radians], ["--q", degrees], ["--q", degrees, "--deg"])
    ]
    np.testing.assert_allclose(outputs[0], arm.fk(answer.q, "tool"), atol=1e-9)
    np.testing.assert_allclose(outputs[1], outputs[0], atol=1e-9)
    np.testing.assert_allclose(outputs[2], outputs[0], atol=1e-9)
    poses = tmp_path / "poses.csv"
    Result("fk", "ur5", "--frame", "tool", "--deg", "--q", degrees, "-o", poses)
    assert poses.read_text().startswith("x,y,z,roll [deg],pitch [deg],yaw [deg]\n")
    for more in ([], ["--deg"]):
        found = Result("ik", "ur5", "--frame", "tool", "--target", poses, "--json", *more).json()
        assert found["success"] == [True] * 3
    zarr = pytest.importorskip("zarr")
    kempe.map_file(arm, "fk", degrees, tmp_path / "out.zarr", "tool", columns=arm.coordinate_names)
    group = zarr.open_group(str(tmp_path / "out.zarr"), mode="r")
    np.testing.assert_allclose(group["pose"][:], arm.fk(answer.q, "tool"), atol=1e-12)


def test_a_coordinate_keeps_its_column():
    m = kempe.Mechanism("arm", dim=2)
    m.revolute("success", m.ground, m.body("a"))
    m.frame("tip", "a", at=(1, 0))
    names, columns = m.build().ik([0, 1], "tip", task="position").table()
    assert names.count("success") == 1
    np.testing.assert_allclose(columns[0, 0], np.pi / 2)


def test_a_data_frame_has_masks_and_is_read_as_configurations():
    pytest.importorskip("pandas")
    arm = kempe.load("two_link")
    answer = arm.ik([[0.6, 0.3], [5, 5]], "e")
    frame = answer.to_dataframe()
    assert len(frame[frame.success]) == 1 and frame.target_x.tolist() == [0.6, 5.0]
    np.testing.assert_array_equal(arm.fk(frame, "e"), arm.fk(answer.q, "e"))
    with pytest.raises(kempe.errors.UnknownNameError, match="'success'"):
        arm.fk(frame.drop(columns="q1"), "e")


def test_frames_of_a_motion_are_chosen_when_it_is_saved(tmp_path: Path):
    path = kempe.load("jansen").trace("O")
    head = path.save(tmp_path / "x.csv", frames=["foot"]).read_text().splitlines()[0]
    assert head.endswith(",foot.x,foot.y")


def test_configurations_that_are_not_closed_are_not_saved_as_if_they_were(tmp_path: Path):
    answer = bar().assemble({"A": [0.3, np.nan]})
    assert np.isnan(np.load(answer.save(tmp_path / "x.npy"))[1]).all()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x.txt", "results are written to .csv or .npy files"),
        ("nowhere/x.csv", "it cannot be written: No such file or directory"),
        ("nowhere/x.npy", "it cannot be written: No such file or directory"),
        (".", "results are written to"),
        ("https://example.org/x.csv", "is a URL"),
    ],
)
def test_files_that_cannot_be_written(name: str, words: str, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        bar().assemble({"A": 0.3}).save(name)


def test_files_of_the_home_folder(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert bar().assemble({"A": 0.3}).save("~/x.csv") == tmp_path / "x.csv"
    assert (
        bar().mechanism.save("~/m.toml") == tmp_path / "m.toml" and kempe.load("~/m.toml") == bar()
    )


def test_columns_of_targets_may_have_names_in_capitals():
    rows = np.array([[0.3, 0.1, 0.2]])
    X, is_position = read_pose_columns(3, rows, ("Z", "X", "Y"))
    assert is_position
    np.testing.assert_array_equal(X[0, :3, 3], [0.1, 0.2, 0.3])
    with pytest.raises(InputError, match="pos_x, y, z; it must be x,y,z .* in any order"):
        read_pose_columns(3, rows, ("pos_x", "y", "z"))
