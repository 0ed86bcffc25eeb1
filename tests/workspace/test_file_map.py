"""Verbs over files: the same answers as the plain verbs, stopped, killed, damaged, changed, and
gone on with.
"""

from __future__ import annotations

import errno
import itertools
import json
import os
import shutil
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from hunts import some
from interrupts import Interrupt, ended

import kempe
from kempe import Budget, Status, spatial
from kempe.arguments import call_until_interrupt
from kempe.budget import check_for_stop
from kempe.errors import DamagedError, InputError, KempeError, UnknownNameError
from kempe.numerics import clock
from kempe.workspace import map_file, row_sources, store, workers

zarr = pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed (extra scale)")
pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra scale)")
PUMA = kempe.load("puma560")
BAR = kempe.load("four_bar")
TWO = kempe.load("two_link")
N = 1000
MODULES = (map_file, workers, store)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """Chunks and blocks of a size for tests, and a clock by which progress is reported after each
    of them.
    """
    monkeypatch.setattr(map_file, "CHUNK_BYTES", 2**13)
    monkeypatch.setattr(row_sources, "BLOCK_ROWS", 70)
    monkeypatch.setattr(workers, "WAKE", 0.001)
    monkeypatch.setattr(workers, "time", SimpleNamespace(monotonic=itertools.count().__next__))


@pytest.fixture
def q():
    rows = PUMA.random(1, N)
    rows[[3, 700], 2] = np.nan
    return rows


def interrupted_after(rows, kind=KeyboardInterrupt):
    """A budget whose progress raises when so many rows are done."""

    def said(done, *_):
        if done >= rows:
            raise kind

    return Budget(progress=said, threads=1)


def written(path, name, rows, columns=None):
    """A file of rows in one of the formats, and what is given as its path."""
    file = path / name
    if name.endswith(".npy"):
        np.save(file, rows)
    elif name.endswith(".csv"):
        np.savetxt(
            file, rows, delimiter=",", fmt="%.17g", header=",".join(columns or []), comments=""
        )
    elif name.endswith(".parquet"):
        table = pyarrow.table({c: x for c, x in zip(columns, rows.T, strict=True)})
        parquet.write_table(table, file, row_group_size=90)
    elif columns is None:
        zarr.create_array(
            str(file), shape=rows.shape, dtype=rows.dtype, chunks=(33, *rows.shape[1:])
        )[...] = rows
    else:
        group = zarr.open_group(str(file), mode="w")
        for c, x in zip(columns, rows.T, strict=True):
            group.create_array(c, shape=x.shape, dtype=x.dtype, chunks=(50,))[...] = x
    return file


def arrays(path):
    group = zarr.open_group(str(path), mode="r")
    return {name: array[...] for name, array in group.arrays()}


def same(a, b):
    return all(np.array_equal(x, b[name], equal_nan=x.dtype.kind == "f") for name, x in a.items())


# ---- the answers


FILES = ["rows.npy", "rows.csv", "rows.zarr", "named.csv", "named.parquet", "named.zarr"]


@pytest.mark.parametrize("name", some(FILES, 3))
def test_configurations_in_all_formats(tmp_path, q, name):
    columns = list(PUMA.coordinate_names) if name.startswith("named") else None
    answer = kempe.map_file(
        PUMA, "fk", written(tmp_path, name, q, columns), tmp_path / "out.zarr", "tool"
    )
    assert answer.rows == answer.requested == N and answer.chunk < N / 10
    assert np.array_equal(arrays(answer.path)["pose"], PUMA.fk(q, "tool"), equal_nan=True)
    assert answer.outcomes == {"SOLVED": N - 2, "BAD_INPUT": 2} and answer.code is Status.PARTLY


@pytest.mark.parametrize(
    ("form", "name"),
    some(
        [
            ("matrix", "pose"),
            ("3x4", "pose"),
            ("position", "position"),
            ("position_quat_wxyz", "position_quat_wxyz"),
        ],
        3,
    ),
)
@pytest.mark.parametrize("frame", ["tool", None])
def test_forms(tmp_path, q, form, name, frame):
    options = {"form": form, "dtype": "float32"}
    kempe.map_file(
        PUMA, "fk", written(tmp_path, "q.npy", q), tmp_path / "out.zarr", frame, options=options
    )
    found = arrays(tmp_path / "out.zarr")[name]
    assert found.dtype == np.float32 and np.array_equal(
        found, PUMA.fk(q, frame, **options), equal_nan=True
    )


def test_answers_are_no_workspace(tmp_path, q):
    kempe.map_file(PUMA, "fk", written(tmp_path, "q.npy", q), tmp_path / "out.zarr", "tool")
    with pytest.raises(InputError, match="out.zarr: it holds answers of `kempe map`, no workspace"):
        kempe.open_workspace(tmp_path / "out.zarr")


def test_some_coordinates_by_name_in_any_order(tmp_path, q):
    file = written(tmp_path, "q.parquet", q[:, [4, 1]], ["q5", "q2"])
    kempe.map_file(PUMA, "fk", file, tmp_path / "out.zarr", "tool")
    assert np.array_equal(
        arrays(tmp_path / "out.zarr")["pose"],
        PUMA.fk(PUMA.q({"q5": q[:, 4], "q2": q[:, 1]}), "tool"),
        equal_nan=True,
    )


def test_columns_choose_and_name(tmp_path, q):
    wide = written(
        tmp_path, "wide.parquet", np.c_[q, np.arange(N)], [*PUMA.coordinate_names, "time"]
    )
    kempe.map_file(PUMA, "fk", wide, tmp_path / "a.zarr", "tool", columns=PUMA.coordinate_names)
    bare = written(tmp_path, "bare.npy", q[:, ::-1])
    kempe.map_file(
        PUMA, "fk", bare, tmp_path / "b.zarr", "tool", columns=PUMA.coordinate_names[::-1]
    )
    assert same(
        arrays(tmp_path / "a.zarr"),
        {
            **arrays(tmp_path / "b.zarr"),
            "done": arrays(tmp_path / "a.zarr")["done"],
        },
    )


def targets(shape):
    """Poses of which one is no number, and the same as rows of this shape."""
    X = PUMA.fk(PUMA.random(2, N), "tool")
    X[11] = np.nan
    if shape == "rpy":
        return X, spatial.xyz_rpy_from_pose(X), ["x", "y", "z", "roll", "pitch", "yaw"]
    if shape == "quaternion":
        quat = np.full((N, 4), np.nan)
        good = np.arange(N) != 11
        quat[good] = spatial.matrix_to_quat_wxyz(X[good, :3, :3])
        return X, np.c_[X[:, :3, 3], -quat], ["x", "y", "z", "qw", "qx", "qy", "qz"]
    return X, X[:, :3] if shape == "3x4" else X, None


@pytest.mark.parametrize("shape", ["4x4", "3x4", "rpy", "quaternion"])
def test_targets_as_rows(tmp_path, shape):
    X, rows, columns = targets(shape)
    order = None if columns is None else np.random.default_rng(0).permutation(len(columns))
    file = (
        written(tmp_path, "x.npy", rows)
        if columns is None
        else (written(tmp_path, "x.parquet", rows[:, order], [columns[k] for k in order]))
    )
    answer = kempe.map_file(PUMA, "ik", file, tmp_path / "out.zarr", "tool")
    found = arrays(answer.path)
    assert answer.outcomes == {"SOLVED": N - 1, "BAD_INPUT": 1} and np.isnan(found["q"][11]).all()
    good = np.arange(N) != 11
    assert np.abs(PUMA.fk(found["q"][good], "tool") - X[good]).max() < 1e-5


def test_ik_is_the_plain_verb(tmp_path):
    X, rows, _ = targets("4x4")
    options = {"start": PUMA.mid + 0.1, "tolerance": 1e-4}
    budget = Budget(rng=5)
    path = tmp_path / "out.zarr"
    kempe.map_file(
        PUMA, "ik", written(tmp_path, "x.npy", rows), path, "tool", options=options, budget=budget
    )
    plain = PUMA.ik(X, "tool", budget=budget, **options)
    found = arrays(tmp_path / "out.zarr")
    assert np.array_equal(found["q"], plain.q, equal_nan=True) and np.array_equal(
        found["code"], plain.code
    )
    assert np.array_equal(found["position_error"], plain.position_error, equal_nan=True)


@pytest.mark.parametrize("options", some([{}, {"limits": True}], 2))
@pytest.mark.parametrize("name", ["puma560", "panda"])
def test_ik_all_is_the_plain_verb(tmp_path, name, options):
    system = kempe.load(name)
    X = system.fk(system.random(3, 300), "tool")
    X[5] = np.nan
    kempe.map_file(
        system,
        "ik_all",
        written(tmp_path, "x.npy", X),
        tmp_path / "out.zarr",
        "tool",
        options=options,
    )
    plain = system.ik_all(X, "tool", **options)
    found = arrays(tmp_path / "out.zarr")
    assert np.array_equal(found["q"], plain.q, equal_nan=True) and np.array_equal(
        found["inside"], plain.inside
    )
    assert np.array_equal(found["count"], plain.mask.sum(-1)) and np.array_equal(
        found["complete"], plain.complete
    )


def test_assemble_is_the_plain_verb(tmp_path):
    known = np.linspace(0.0, 6.0, N)[:, None].copy()
    known[8] = np.nan
    answer = kempe.map_file(
        BAR, "assemble", written(tmp_path, "a.csv", known, ["A"]), tmp_path / "out.zarr"
    )
    plain = BAR.assemble({"A": known[:, 0]})
    found = arrays(answer.path)
    assert answer.outcomes == {"SOLVED": N - 1, "BAD_INPUT": 1}
    assert np.array_equal(found["q"], plain.q, equal_nan=True) and np.array_equal(
        found["residual"], plain.residual, equal_nan=True
    )


def test_degrees_and_the_plane(tmp_path):
    rows = np.degrees(TWO.random(0, 50))
    kempe.map_file(
        TWO,
        "fk",
        written(tmp_path, "q.csv", rows, TWO.coordinate_names),
        tmp_path / "x.zarr",
        "e",
        degrees=True,
    )
    X = arrays(tmp_path / "x.zarr")["pose"]
    assert np.abs(X - TWO.fk(np.radians(rows), "e")).max() < 1e-12
    kempe.map_file(
        TWO, "ik", written(tmp_path, "p.csv", X[:, :2, 3], ["x", "y"]), tmp_path / "q.zarr", "e"
    )
    assert (
        np.abs(TWO.fk(arrays(tmp_path / "q.zarr")["q"], "e")[:, :2, 3] - X[:, :2, 3]).max() < 1e-6
    )


def test_one_map_is_the_rows_of_the_next(tmp_path, q):
    kempe.map_file(PUMA, "fk", written(tmp_path, "q.npy", q), tmp_path / "x.zarr", "tool")
    answer = kempe.map_file(PUMA, "ik", tmp_path / "x.zarr" / "pose", tmp_path / "q.zarr", "tool")
    kempe.map_file(PUMA, "fk", tmp_path / "q.zarr" / "q", tmp_path / "y.zarr", "tool")
    X, Y = (arrays(tmp_path / name)["pose"] for name in ("x.zarr", "y.zarr"))
    assert answer.outcomes["BAD_INPUT"] == 2 and np.nanmax(np.abs(X - Y)) < 1e-5


@pytest.mark.parametrize("name", FILES)
def test_a_file_without_rows(tmp_path, name):
    columns = list(PUMA.coordinate_names)
    rows = np.zeros((0, 6))
    if name == "rows.csv":
        (tmp_path / name).write_text(",".join(columns) + "\n")
        answer = kempe.map_file(PUMA, "fk", tmp_path / name, tmp_path / "out.zarr", "tool")
    else:
        file = written(tmp_path, name, rows, columns if name.startswith("named") else None)
        answer = kempe.map_file(PUMA, "fk", file, tmp_path / "out.zarr", "tool")
    assert answer.rows == 0 and answer and arrays(answer.path)["pose"].shape == (0, 4, 4)


def test_parts_of_a_parquet_folder(tmp_path, q):
    (tmp_path / "q").mkdir()
    for k, part in enumerate(np.array_split(q, 3)):
        written(tmp_path / "q", f"{k}.parquet", part, PUMA.coordinate_names)
    os.rename(tmp_path / "q", tmp_path / "q.parquet")
    kempe.map_file(PUMA, "fk", tmp_path / "q.parquet", tmp_path / "out.zarr", "tool")
    assert np.array_equal(arrays(tmp_path / "out.zarr")["pose"], PUMA.fk(q, "tool"), equal_nan=True)


def test_a_folder_of_parquet_files_has_any_name(tmp_path, q):
    written(tmp_path, "one.parquet", q, PUMA.coordinate_names)
    folder = tmp_path / "rows"
    (folder / "2026").mkdir(parents=True)
    (tmp_path / "one.parquet").rename(folder / "2026" / "one.parquet")
    assert kempe.map_file(PUMA, "fk", folder, tmp_path / "o.zarr", "tool").rows == len(q)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="cannot be read as Zarr, and holds no .parquet files$"):
        kempe.map_file(PUMA, "fk", tmp_path / "empty", tmp_path / "o2.zarr", "tool")


def test_cells_of_a_table_may_stand_in_quotation_marks(tmp_path, q):
    """Programs write them so that quote all cells."""
    rows = [PUMA.coordinate_names, *q.tolist()]
    (tmp_path / "q.csv").write_text("".join(",".join(f'"{x}"' for x in row) + "\n" for row in rows))
    found = kempe.map_file(PUMA, "fk", tmp_path / "q.csv", tmp_path / "o.zarr", "tool")
    assert found.rows == len(q)
    assert np.array_equal(arrays(tmp_path / "o.zarr")["pose"], PUMA.fk(q, "tool"), equal_nan=True)


@pytest.mark.parametrize("empty", ["", " ", '""'])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_an_empty_cell_of_a_table_concerns_its_row_alone(tmp_path, empty, ending):
    """Pandas writes NaN so."""
    q = PUMA.random(0, 5)
    cells = [[str(x) for x in row] for row in q]
    cells[1][0] = cells[2][-1] = empty
    lines = [",".join(row) for row in (PUMA.coordinate_names, *cells)]
    (tmp_path / "q.csv").write_bytes((ending.join(lines) + ending).encode())
    found = kempe.map_file(PUMA, "fk", tmp_path / "q.csv", tmp_path / "o.zarr", "tool")
    pose = arrays(tmp_path / "o.zarr")["pose"]
    assert found.outcomes == {"SOLVED": 3, "BAD_INPUT": 2}
    assert np.isnan(pose[1:3, :3]).any(axis=(1, 2)).all()
    assert np.array_equal(pose[[0, 3, 4]], PUMA.fk(q, "tool")[[0, 3, 4]])


@pytest.mark.parametrize("name", ["out.csv", "out.parquet", "out.NPY", "out.csv.gz"])
def test_answers_are_not_written_to_a_folder_with_the_name_of_a_table(tmp_path, q, name):
    file = written(tmp_path, "q.npy", q)
    with pytest.raises(
        InputError, match=r"written as a folder of Zarr; give it a name such as 'out.zarr'"
    ):
        kempe.map_file(PUMA, "fk", file, tmp_path / name, "tool")
    assert not (tmp_path / name).exists()


def test_whole_numbers_and_missing_ones(tmp_path):
    table = pyarrow.table(
        {"q1": pyarrow.array([1, None, 2]), "q2": pyarrow.array([0.5, 0.5, 0.5], pyarrow.float32())}
    )
    parquet.write_table(table, tmp_path / "q.parquet")
    answer = kempe.map_file(PUMA, "fk", tmp_path / "q.parquet", tmp_path / "out.zarr", "tool")
    assert answer.outcomes == {"SOLVED": 2, "BAD_INPUT": 1}
    assert np.array_equal(
        arrays(answer.path)["pose"][2], PUMA.fk(PUMA.q({"q1": 2.0, "q2": 0.5})[None], "tool")[0]
    )


def test_opened_without_kempe(tmp_path, q):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed (extra scale)")
    X = PUMA.fk(q, "tool")
    kempe.map_file(
        PUMA,
        "ik",
        written(tmp_path, "x.npy", X),
        tmp_path / "out.zarr",
        "tool",
        options={"task": "pose"},
    )
    data = xarray.open_zarr(tmp_path / "out.zarr")
    assert data.q.dims == ("row", "coordinate") and list(data.coordinate.values) == list(
        PUMA.coordinate_names
    )
    assert set(data.unit.values) == {"rad"} and data.position_error.attrs["units"] == "m"
    assert data.code.attrs["flag_meanings"].split()[int(data.code[3])] == "BAD_INPUT"
    made = json.loads(data.attrs["kempe"])
    assert (
        made["system"] == PUMA.structure.content_hash
        and made["verb"] == "ik"
        and made["frame"] == "tool"
    )
    assert (
        made["options"] == {"task": "pose"}
        and made["source"]["file"] == "x.npy"
        and made["version"]
        and (made["variant"])
    )


# ---- any number of threads, any end


@pytest.fixture
def whole(tmp_path, q):
    """A file of targets, and the map of it."""
    X = PUMA.fk(q, "tool")
    file = written(tmp_path, "x.npy", X)
    kempe.map_file(PUMA, "ik", file, tmp_path / "whole.zarr", "tool")
    return file, arrays(tmp_path / "whole.zarr")


def mapped(file, path, **more):
    return call_until_interrupt(kempe.map_file, PUMA, "ik", file, path, "tool", **more)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_one_thread_and_many_write_the_same(tmp_path, whole, threads):
    answer = mapped(whole[0], tmp_path / "out.zarr", budget=Budget(threads=threads))
    assert same(arrays(answer.path), whole[1])


@pytest.mark.slow
def test_a_map_is_what_the_verb_answers(tmp_path, hunt, monkeypatch):
    """Whatever the chunks, the threads and the interruptions."""
    rng = hunt.rng()
    for k in range(hunt.cases(12)):
        system = [PUMA, TWO, BAR, kempe.load("panda")][int(rng.integers(4))]
        n = int(rng.integers(1, 400))
        frame = system.body_names[-1]
        monkeypatch.setattr(map_file, "CHUNK_BYTES", int(2 ** rng.integers(8, 15)))
        rows = system.random(int(rng.integers(100)), n)
        rows[rng.random(n) < 0.02, 0] = np.nan
        file = written(tmp_path, f"{k}.npy", rows)
        path = tmp_path / f"{k}.zarr"
        threads = int(rng.integers(1, 4))
        call_until_interrupt(
            kempe.map_file,
            system,
            "fk",
            file,
            path,
            frame,
            budget=interrupted_after(rng.integers(1, n + 1)),
        )
        kempe.map_file(system, "fk", file, path, frame, budget=Budget(threads=threads))
        assert np.array_equal(arrays(path)["pose"], system.fk(rows, frame), equal_nan=True)


def test_an_interrupted_map_is_gone_on_with(tmp_path, whole):
    path = tmp_path / "out.zarr"
    first = mapped(whole[0], path, budget=interrupted_after(300))
    assert first.code is Status.INTERRUPTED and 200 <= first.rows < N and not first
    begun = arrays(path)
    left = begun["code"] == map_file.LEFT
    assert left.sum() == N - first.rows and np.isnan(begun["q"][left]).all()
    assert same({"q": begun["q"][~left]}, {"q": whole[1]["q"][~left]})
    done = []
    second = mapped(whole[0], path, budget=Budget(progress=lambda *said: done.append(said)))
    assert second.rows == N and same(arrays(path), whole[1]) and second.redone == 0
    assert done[-1] == (N, N)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.zarr", "whole.zarr", "x.npy"]


@pytest.mark.slow
def test_an_interrupt_at_any_line(tmp_path, hunt):
    """Where the work is broken off, the same call goes on to what was to be written, and nothing is
    made twice.
    """
    rows = PUMA.random(0, 300)
    file = written(tmp_path, "x.npy", rows)

    def done(name):
        return call_until_interrupt(
            kempe.map_file, PUMA, "fk", file, tmp_path / name, "tool", budget=Budget(threads=2)
        )

    with Interrupt(0, *MODULES) as none:
        done("whole.zarr")
    assert none.lines > 300
    for at in hunt.rng().permutation(none.lines)[: hunt.cases(40)].tolist():
        first = None
        with Interrupt(1 + at, *MODULES) as interrupt:
            first = done(f"{at}.zarr")
        assert first is None or (first.code is Status.INTERRUPTED) == interrupt.came
        second = done(f"{at}.zarr")
        assert second.rows == len(rows) and second.redone == 0, at
        assert np.array_equal(arrays(second.path)["pose"], PUMA.fk(rows, "tool")), at


def test_the_time_limit(tmp_path, whole):
    answer = mapped(whole[0], tmp_path / "out.zarr", budget=Budget(time_limit=1e-9))
    assert answer.code is Status.OUT_OF_TIME and answer.late and answer.rows < N
    assert mapped(whole[0], tmp_path / "out.zarr").rows == N and same(
        arrays(tmp_path / "out.zarr"), whole[1]
    )


def test_a_map_with_all_rows_is_not_late(tmp_path, whole, monkeypatch):
    """Although the time is up when the last rows are reported."""
    said = [0]
    fake = SimpleNamespace(monotonic=lambda: np.inf if said[-1] == N else -np.inf)
    monkeypatch.setattr(clock, "time", fake)
    budget = Budget(time_limit=5.0, progress=lambda done, *_: said.append(done))
    answer = mapped(whole[0], tmp_path / "out.zarr", budget=budget)
    assert said[-1] == answer.rows == N and not answer.late
    assert answer.code is Status.PARTLY and "time limit" not in str(answer)


@pytest.fixture
def begun(tmp_path, monkeypatch):
    """A file of 64 targets and its map, of whose only chunk three of eight pieces are answered; and
    a list of the rows that are answered from then on.
    """
    X = PUMA.fk(PUMA.random(1, 64), "tool")
    X[20:, :3, 3] *= 2.0
    file = written(tmp_path, "x.npy", X)
    path = tmp_path / "out.zarr"
    monkeypatch.setattr(map_file, "CHUNK_BYTES", 2**30)
    monkeypatch.setitem(map_file.VERBS, "ik", map_file.VERBS["ik"]._replace(rows=64))
    answered = []
    most = [3]
    before = map_file.RowJob.answer_rows

    def answers(job, rows):
        if len(rows):
            if len(answered) == most[0]:
                raise workers.Stopped
            answered.append(len(rows))
        return before(job, rows)

    monkeypatch.setattr(map_file.RowJob, "answer_rows", answers)
    first = kempe.map_file(PUMA, "ik", file, path, "tool", budget=Budget(threads=1))
    assert answered == [8, 8, 8] and first.rows == 24 and sum(first.outcomes.values()) == 24
    answered.clear()
    most[0] = -1
    return X, file, path, answered


@pytest.mark.parametrize("spoil", ["", "cut", "flipped"])
def test_a_chunk_whose_work_is_stopped_is_gone_on_with(begun, spoil):
    """Pieces of a chunk that are done when the work is told to stop are not answered again; damaged
    ones are.
    """
    X, file, path, answered = begun
    if spoil == "cut":
        (path / "q" / "c" / "0" / "0").write_bytes(b"cut")
    elif spoil == "flipped":
        flip(path / "code" / "c" / "0")
    done = kempe.map_file(PUMA, "ik", file, path, "tool", budget=Budget(threads=1))
    assert sum(answered) == (64 if spoil else 40) and done.redone == bool(spoil)
    plain = PUMA.ik(X, "tool")
    assert done.rows == 64 and np.array_equal(arrays(path)["q"], plain.q)
    assert np.array_equal(arrays(path)["code"], plain.code)


def test_rows_of_a_chunk_that_is_begun_are_refused_where_they_have_changed(tmp_path, begun):
    X, _, path, _ = begun
    X[5, :3, 3] *= 0.9
    with pytest.raises(InputError, match=r"rows 0 to 24 of .* have changed since"):
        kempe.map_file(PUMA, "ik", written(tmp_path, "x.npy", X), path, "tool")


def test_an_interrupt_stops_the_work_of_threads(tmp_path, monkeypatch):
    """At their next look, although an answer takes as long as one lets it."""
    file = written(tmp_path, "x.npy", PUMA.fk(PUMA.random(1, 64), "tool"))
    before = map_file.RowJob.answer_rows

    def answers(job, rows):
        while len(rows):
            check_for_stop()
        return before(job, rows)

    with monkeypatch.context() as patch:
        patch.setattr(map_file.RowJob, "answer_rows", answers)
        first = mapped(file, tmp_path / "out.zarr", budget=interrupted_after(0))
    assert first.interrupted and first.rows == 0
    assert mapped(file, tmp_path / "out.zarr").rows == 64


def test_a_finished_map_is_left_as_it_is(tmp_path, whole):
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "whole.zarr").rglob("*")}
    assert mapped(whole[0], tmp_path / "whole.zarr").rows == N
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "whole.zarr").rglob("*")}


def flip(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 16
    file.write_bytes(data)


@pytest.mark.slow
@pytest.mark.parametrize("how", some(["changed", "gone", "cut"], 3))
@pytest.mark.parametrize("finished", [True, False])
def test_damaged_chunks_are_found_and_made_again(tmp_path, whole, how, finished):
    path = tmp_path / "out.zarr"
    mapped(whole[0], path, budget=None if finished else interrupted_after(500))
    chunk = path / "q" / "c" / "1" / "0"
    if how == "changed":
        flip(chunk)
    elif how == "gone":
        chunk.unlink()
    else:
        chunk.write_bytes(chunk.read_bytes()[:-100])
    again = mapped(whole[0], path)
    assert again.redone == 1 and same(arrays(path), whole[1]) and "redone" in str(again)
    assert mapped(whole[0], path).redone == 0


@pytest.mark.parametrize("name", ["q/zarr.json", "done/zarr.json", "zarr.json"])
def test_a_damaged_description_is_refused_by_name(tmp_path, whole, name):
    path = tmp_path / "out.zarr"
    mapped(whole[0], path)
    said = json.loads((path / "zarr.json").read_text())
    (path / "zarr.json").write_text(json.dumps({**said, "consolidated_metadata": None}))
    (path / name).write_text("{")
    with pytest.raises((DamagedError, InputError), match="out.zarr"):
        mapped(whole[0], path)


def test_names_along_an_axis_that_were_changed_are_made_again(tmp_path, whole):
    """They say which column is which joint."""
    path = tmp_path / "out.zarr"
    mapped(whole[0], path)
    names = zarr.open_group(str(path), mode="r+")["coordinate"]
    names[...] = names[...][::-1].copy()
    assert mapped(whole[0], path).redone == 1 and same(arrays(path), whole[1])


@pytest.mark.parametrize("how", ["gone", "cut", "changed"])
def test_a_damaged_entry_of_what_is_done_costs_its_chunk(tmp_path, whole, how):
    path = tmp_path / "out.zarr"
    mapped(whole[0], path)
    entry = path / "done" / "c" / "2" / "0"
    if how == "gone":
        entry.unlink()
    elif how == "cut":
        entry.write_bytes(b"")
    else:
        flip(entry)
    again = mapped(whole[0], path)
    assert again.redone == (how != "gone") and same(arrays(path), whole[1])


def test_a_map_of_an_earlier_version_is_refused_by_name(tmp_path, whole):
    path = tmp_path / "out.zarr"
    mapped(whole[0], path)
    said = json.loads((path / "zarr.json").read_text())
    said["attributes"]["format"] = "kempe rows 1"
    (path / "zarr.json").write_text(json.dumps(said))
    with pytest.raises(
        InputError, match=r"out.zarr: .* of this kind and version \('kempe rows 1'\)"
    ):
        mapped(whole[0], path)


def test_a_full_disk_midway_loses_nothing(tmp_path, whole, monkeypatch):
    path = tmp_path / "out.zarr"
    write = zarr.Array.__setitem__
    writes = []

    def full(self, where, value):
        writes.append(1)
        if len(writes) == 25:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, where, value)

    monkeypatch.setattr(zarr.Array, "__setitem__", full)
    with pytest.raises(KempeError, match="the disk is full; what was written before stands"):
        mapped(whole[0], path, budget=Budget(threads=1))
    monkeypatch.undo()
    done = int((arrays(path)["done"][:, 0] > 0).sum())
    monkeypatch.setattr(map_file, "CHUNK_BYTES", 2**13)
    answered = []
    answer_chunk = map_file.RowStore.answer_chunk

    def answer(store, *part):
        answered.append(part)
        return answer_chunk(store, *part)

    monkeypatch.setattr(map_file.RowStore, "answer_chunk", answer)
    mapped(whole[0], path)
    assert done >= 2 and len(answered) == len(arrays(path)["done"]) - done
    assert same(arrays(path), whole[1])


def test_a_small_disk_is_refused_early(tmp_path, whole, monkeypatch):
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    with pytest.raises(KempeError, match="are free on this disk"):
        mapped(whole[0], tmp_path / "out.zarr")
    assert not (tmp_path / "out.zarr").exists()


def test_a_place_that_may_not_be_written(tmp_path, whole, monkeypatch):
    def refused(self, *_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(type(tmp_path), "mkdir", refused)
    with pytest.raises(KempeError, match=r"out\.zarr cannot be written: Permission denied"):
        mapped(whole[0], tmp_path / "out.zarr")


WORK = """
    import kempe
    from kempe.workspace import map_file as file_map
    file_map.CHUNK_BYTES = 2**14
    kempe.map_file(kempe.load("puma560"), "ik", {file!r}, {path!r}, "tool", budget=kempe.Budget(threads=2))
"""


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGINT])
def test_a_process_that_is_ended_at_any_moment(tmp_path, hunt, ending):
    """Three times, each in the next sixth of the work at most."""
    X = PUMA.fk(PUMA.random(0, 5000), "tool")
    file = written(tmp_path, "x.npy", X)
    path = tmp_path / "out.zarr"
    lines = ended(
        ending, 0, MODULES, WORK.format(file=str(file), path=str(tmp_path / "whole.zarr"))
    )
    for _ in range(3):
        at = int(hunt.rng().integers(1, lines // 6))
        ended(ending, at, MODULES, WORK.format(file=str(file), path=str(path)))
        assert not path.exists() or (arrays(path)["code"] == map_file.LEFT).any()
    assert ended(ending, 0, MODULES, WORK.format(file=str(file), path=str(path))) is not None
    plain = PUMA.ik(X, "tool")
    found = arrays(path)
    assert np.array_equal(found["q"], plain.q) and np.array_equal(found["code"], plain.code)


# ---- something else, and what is wrong


@pytest.mark.parametrize(
    ("words", "more"),
    some(
        [
            ("system", {"system": kempe.load("panda")}),
            ("verb", {"verb": "ik_all"}),
            ("frame", {"frame": "wrist_3"}),
            ("options", {"options": {"task": "position"}}),
            ("degrees", {"degrees": True}),
            ("rng", {"budget": Budget(rng=3)}),
        ],
        3,
    ),
    ids=lambda x: x if isinstance(x, str) else "",
)
@pytest.mark.parametrize("finished", [True, False])
def test_maps_of_something_else_are_refused(tmp_path, whole, words, more, finished):
    path = tmp_path / "out.zarr"
    mapped(whole[0], path, budget=None if finished else interrupted_after(300))
    given = {"system": PUMA, "verb": "ik", "frame": "tool", **more}
    given["frame"] = PUMA.body_names[2] if given["frame"] == "wrist_3" else given["frame"]
    with pytest.raises(InputError, match=f"belongs to another map: (its|it is of another) {words}"):
        kempe.map_file(given.pop("system"), given.pop("verb"), whole[0], path, **given)
    assert mapped(whole[0], path).redone == 0 and same(arrays(path), whole[1])


@pytest.mark.slow
@pytest.mark.parametrize("finished", [True, False])
def test_rows_that_have_changed_are_refused_and_copies_are_not(tmp_path, whole, finished):
    path = tmp_path / "out.zarr"
    X = np.load(whole[0])
    mapped(whole[0], path, budget=None if finished else interrupted_after(300))
    (tmp_path / "other").mkdir()
    changed = X.copy()
    changed[10, 0, 3] += 1e-12
    with pytest.raises(InputError, match=r"rows 0 to \d+ of .* have changed since"):
        mapped(written(tmp_path / "other", "x.npy", changed), path)
    copy = written(tmp_path / "other", "y.npy", X)
    os.utime(copy, (1, 1))
    assert mapped(copy, path).redone == 0 and same(arrays(path), whole[1])


@pytest.mark.slow
def test_more_rows_are_another_map(tmp_path, whole):
    X = np.load(whole[0])
    mapped(whole[0], tmp_path / "out.zarr")
    with pytest.raises(InputError, match=f"its rows is {N}, and here it is {2 * N}"):
        mapped(written(tmp_path, "y.npy", np.concatenate([X, X])), tmp_path / "out.zarr")


def test_what_stands_at_the_path_is_kept(tmp_path, whole):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "x").write_text("precious")
    TWO.workspace("e", n=1000).save(tmp_path / "space.zarr")
    for place in ("data", "space.zarr"):
        with pytest.raises(InputError, match="something else than a map"):
            mapped(whole[0], tmp_path / place)
    with pytest.raises(InputError, match="no folder"):
        mapped(whole[0], tmp_path / "none" / "out.zarr")
    assert (tmp_path / "data" / "x").read_text() == "precious" and kempe.open_workspace(
        tmp_path / "space.zarr"
    )


def test_a_source_that_is_damaged_midway(tmp_path, q):
    file = written(tmp_path, "q.zarr", q)
    chunk = file / "c" / "9" / "0"
    data = chunk.read_bytes()
    chunk.write_bytes(data[:100])
    with pytest.raises(DamagedError, match=r"q\.zarr: rows \d+ to \d+ cannot be read"):
        kempe.map_file(PUMA, "fk", file, tmp_path / "out.zarr", "tool")
    chunk.write_bytes(data)
    kempe.map_file(PUMA, "fk", file, tmp_path / "out.zarr", "tool")
    assert np.array_equal(arrays(tmp_path / "out.zarr")["pose"], PUMA.fk(q, "tool"), equal_nan=True)


def test_text_that_is_no_number_names_its_line(tmp_path, q):
    lines = [",".join(map(str, row)) for row in q[:500]]
    lines[321] = lines[321].replace(",", ",x", 1)
    (tmp_path / "q.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"q\.csv:322: 'x.*' is not a number"):
        kempe.map_file(PUMA, "fk", tmp_path / "q.csv", tmp_path / "out.zarr", "tool")


def rows_of(*shape, columns=None, name=None):
    """A file of zeros, made when it is needed."""
    return lambda path: written(
        path, name or ("x.npy" if columns is None else "x.csv"), np.zeros(shape), columns
    )


def text(name, words):
    def write(path):
        (path / name).write_text(words)
        return path / name

    return write


def two_lengths(path):
    file = written(path, "x.zarr", np.zeros((5, 1)), ["q1"])
    zarr.open_group(str(file))["q1"]
    zarr.open_group(str(file), mode="r+").create_array("q2", shape=(6,), dtype=float, chunks=(6,))
    return file


def words_in_parquet(path):
    parquet.write_table(pyarrow.table({"q1": ["a", "b"]}), path / "x.parquet")
    return path / "x.parquet"


def objects_in_npy(path):
    np.save(path / "x.npy", np.array([{"q1": 1.0}], dtype=object))
    return path / "x.npy"


WRONG = [
    (lambda path: path / "none.npy", {}, "no such file"),
    (text("x.npy", "hello"), {}, r"cannot be read as \.npy: it does not begin as such a file does"),
    (text("x.npy", ""), {}, r"cannot be read as \.npy"),
    (objects_in_npy, {}, "x.npy: it holds Python objects; it must hold an array of real numbers"),
    (text("x.parquet", "hello"), {}, r"cannot be read as \.parquet"),
    (text("x.txt", "1,2,3"), {}, "rows are read from Zarr, and from"),
    (lambda path: path, {}, "cannot be read as Zarr"),
    (rows_of(5, 7), {}, "q has 7 coordinates; .* needs 6: q1, q2"),
    (rows_of(5, 2, columns=["q1", "elbow"]), {}, "no coordinate 'elbow'; .*q1"),
    (rows_of(5, 2, columns=["q1", "q1"]), {}, "'q1' appears twice"),
    (rows_of(5, 2, columns=["q1", "q2"]), {"columns": ["q9"]}, "no column 'q9'"),
    (rows_of(5, 6), {"columns": ["q1"]}, "1 column is named"),
    (
        rows_of(5, 5),
        {"verb": "ik"},
        "the target has 5 numbers; it must be x,y,z .position only., x,y,z,roll",
    ),
    (
        rows_of(5, 3, columns=["a", "b", "c"]),
        {"verb": "ik"},
        "the columns a, b, c; it must be x,y,z",
    ),
    (rows_of(5, 3, 3), {"verb": "ik"}, r"a row is of shape \(3, 3\); a target is \(4, 4\)"),
    (
        rows_of(5, 3),
        {"verb": "ik", "options": {"task": "pose"}},
        "needs targets with an orientation",
    ),
    (rows_of(5, 6), {"verb": "ik", "frame": None}, "ik needs a frame"),
    (rows_of(5, 6), {"verb": "ik", "frame": "hand"}, "hand"),
    (rows_of(5, 6), {"verb": "turn"}, "no verb 'turn'; there are: 'fk', 'ik'"),
    (rows_of(5, 6), {"options": {"task": "pose"}}, "no option of map fk 'task'"),
    (rows_of(5, 6), {"options": {"form": "quaternion"}}, "no form 'quaternion'"),
    (rows_of(5, 6), {"verb": "ik_all", "options": {"limits": "turns"}}, "'turns' gives as many"),
    (
        rows_of(5, 6),
        {"verb": "ik", "options": {"start": np.zeros((5, 6))}},
        "start must be one configuration",
    ),
    (rows_of(5, 6), {"verb": "ik", "options": {"start": len}}, "built-in function len"),
    (
        rows_of(5, 6),
        {"system": BAR, "verb": "assemble", "frame": None},
        "the columns have no names",
    ),
    (
        rows_of(5, 1, columns=["A"]),
        {"system": BAR, "frame": None},
        "'B' is missing: give all of",
    ),
    (rows_of(5, 1, columns=["Z"]), {"system": BAR, "verb": "assemble", "frame": None}, "'Z'"),
    (rows_of(5, 1, columns=["A"]), {"system": BAR, "verb": "assemble"}, "assemble needs no frame"),
    (rows_of(5, 6), {"budget": Budget(threads=0)}, "threads is 0"),
    (rows_of(5, 6), {"budget": Budget(starts=3)}, "budget has starts"),
    (rows_of(5, 6), {"client": "tcp://127.0.0.1:1"}, "no scheduler answers"),
    (
        two_lengths,
        {},
        r"it holds .*q1 \(5,\).*; name columns of one length, or give the path of an array",
    ),
    (words_in_parquet, {}, "column 'q1' holds"),
]


@pytest.mark.parametrize(("file", "more", "words"), WRONG, ids=[words for _, _, words in WRONG])
def test_wrong_questions(tmp_path, monkeypatch, file, more, words):
    monkeypatch.setattr(workers, "PATIENCE", 0.5)
    given = {"system": PUMA, "verb": "fk", "frame": "tool", **more}
    with pytest.raises((InputError, UnknownNameError), match=words):
        kempe.map_file(
            given.pop("system"), given.pop("verb"), file(tmp_path), tmp_path / "out.zarr", **given
        )
    assert not (tmp_path / "out.zarr").exists()


def test_blocks_that_are_too_large_are_refused(tmp_path, q, monkeypatch):
    monkeypatch.setattr(row_sources, "BLOCK_BYTES", 1000)
    with pytest.raises(InputError, match="a row group of it has 90 rows"):
        kempe.map_file(
            PUMA,
            "fk",
            written(tmp_path, "q.parquet", q, PUMA.coordinate_names),
            tmp_path / "o.zarr",
            "tool",
        )


@pytest.mark.filterwarnings("ignore:invalid escape sequence:DeprecationWarning")
@pytest.mark.parametrize("read", ["map", "rows"])
def test_damaged_npy_files_are_refused_in_words(tmp_path, hunt, read):
    """Numpy reads the header of such a file as Python: any error of that may come."""
    from kempe.cli import arguments

    rng = hunt.rng()
    file = tmp_path / "x.npy"
    np.save(file, np.zeros((20, 6)))
    data = file.read_bytes()
    refused: list[str] = []
    for case in range(hunt.cases(400)):
        bad = bytearray(data)
        if case == 0:
            bad = bytearray(data.replace(b"), }", b"   }"))
        for _ in range(int(rng.integers(1, 4)) if case else 0):
            bad[int(rng.integers(128))] = int(
                rng.choice([*b"(){}[],:'\\\n 0", int(rng.integers(256))])
            )
        file.write_bytes(bytes(bad))
        try:
            if read == "map":
                row_sources.open_rows(file).read_rows(0, 1)
            else:
                arguments.read_table(file)
        except KempeError as error:
            refused.append(str(error))
    assert refused and all(str(file) in words for words in refused)


def test_a_chunk_of_many_digits_is_refused_in_words(tmp_path):
    path = written(tmp_path, "x.zarr", np.zeros((20, 6)))
    said = json.loads((path / "zarr.json").read_text())
    for digits in (30, 400):
        said["chunk_grid"]["configuration"]["chunk_shape"][0] = 10**digits
        (path / "zarr.json").write_text(json.dumps(said))
        with pytest.raises(KempeError):
            row_sources.open_rows(path).read_rows(0, 20_000)


# ---- on a cluster


@pytest.mark.slow
def test_workers_of_a_cluster_answer_the_same(tmp_path, whole):
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed (extra scale)"
    )
    path = tmp_path / "out.zarr"
    with (
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=2,
            processes=True,
            dashboard_address=None,
            memory_limit=None,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        first = mapped(whole[0], path, client=client, budget=interrupted_after(300))
        second = mapped(whole[0], path, client=client)
        third = kempe.map_file(
            PUMA, "ik", whole[0], tmp_path / "three.zarr", "tool", client=cluster.scheduler_address
        )
    assert 300 <= first.rows < N and second.rows == third.rows == N
    assert same(arrays(path), whole[1]) and same(arrays(tmp_path / "three.zarr"), whole[1])


def test_a_file_of_very_many_columns_is_refused_at_once(tmp_path, monkeypatch):
    """The names were looked up in all others, one by one: with 100 000 it took minutes."""
    k = 100_000
    (tmp_path / "wide.csv").write_text(
        ",".join(f"c{i}" for i in range(k)) + "\n" + "1," * (k - 1) + "1\n"
    )
    monkeypatch.setattr(
        row_sources, "check_name", lambda *given: pytest.fail(f"{given[1]} is looked up in a list")
    )
    with pytest.raises(
        InputError, match=r"the target has the columns c0, c1, .*, \.\.\.; it must be"
    ):
        kempe.map_file(TWO, "ik", tmp_path / "wide.csv", tmp_path / "out.zarr", "e")


def test_folders_named_as_parquet_files_are_no_files(tmp_path):
    (tmp_path / "rows" / "q.parquet").mkdir(parents=True)
    parquet.write_table(
        pyarrow.table({"q1": [0.1], "q2": [0.2]}), tmp_path / "rows" / "q.parquet" / "part.parquet"
    )
    answer = kempe.map_file(TWO, "fk", tmp_path / "rows", tmp_path / "out.zarr", "e")
    assert answer and zarr.open(str(tmp_path / "out.zarr"), mode="r")["pose"].shape == (1, 4, 4)
