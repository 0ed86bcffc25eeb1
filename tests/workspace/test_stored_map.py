"""Maps on disk: stopped and gone on with, damaged, full disks, opened by xarray, made anew bit for
bit.
"""

from __future__ import annotations

import errno
import itertools
import json
import math
import shutil
import signal
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from interrupts import Interrupt, ended
from reached_sets import shell, two_bars

import kempe
from kempe import Budget, Status
from kempe.arguments import call_until_interrupt
from kempe.errors import DamagedError, InputError, KempeError, KernelsError
from kempe.workspace import sampling_job, store, stored_map, workers
from kempe.workspace import workspace as mapping
from kempe.workspace.cell_map import Grid

pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
ARM = two_bars(0.5, 0.3)
N = 400_000


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    """Parts and pieces of a size for tests, and a clock by which progress is reported after each of
    them.
    """
    monkeypatch.setattr(workers, "time", SimpleNamespace(monotonic=itertools.count().__next__))
    monkeypatch.setattr(sampling_job, "PART", 50_000)
    monkeypatch.setattr(sampling_job, "PIECE", 10_000)


def made(path=None, n=N, **more):
    return call_until_interrupt(ARM.workspace, "tip", n=n, cells=64, path=path, **more)


def interrupted_after(samples, kind=KeyboardInterrupt):
    """A budget whose progress raises when so many samples are done."""

    def said(done, *_):
        if done >= samples:
            raise kind

    return Budget(progress=said)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_one_thread_and_many_make_the_same_map(threads):
    assert np.array_equal(made(budget=Budget(threads=threads)).map.counts, made().map.counts)


def test_threads_that_share_memory_make_the_same_map(monkeypatch):
    monkeypatch.setattr(sampling_job, "SHARED_BYTES", 1)
    assert np.array_equal(made(budget=Budget(threads=4)).map.counts, made().map.counts)


MODULES = (sampling_job, mapping, workers, store, stored_map)


@pytest.mark.slow
@pytest.mark.parametrize("on_disk", [False, True])
def test_an_interrupt_at_any_line(tmp_path, hunt, on_disk):
    """What is said to be counted is, and goes on to the whole map: also where a piece is about to
    be handed out.
    """
    n = 120_000
    with Interrupt(0, *MODULES) as none:
        whole = made(tmp_path / "whole.zarr" if on_disk else None, n, budget=Budget(threads=2))
    assert none.lines > 300
    for at in hunt.rng().permutation(none.lines)[: hunt.cases(100 if on_disk else 300)]:
        path = tmp_path / f"{at}.zarr" if on_disk else None
        workspace = None
        with Interrupt(1 + at, *MODULES):
            workspace = made(path, n, budget=Budget(threads=2))
        if workspace is not None and workspace.samples:
            assert np.array_equal(workspace.map.counts, made(n=workspace.samples).map.counts), at
        if on_disk:
            assert np.array_equal(made(path, n).map.counts, whole.map.counts), at
            shutil.rmtree(path)


def test_an_interrupt_where_a_thread_is_begun(monkeypatch):
    """The future of a thread is lost while it counts a piece, and nobody else waits for it: the
    piece is in the map.
    """
    begun = threading.Event()
    counted = sampling_job.Recipe.count_samples
    handed_out = []

    def count(*arguments):
        begun.set()
        time.sleep(0.05)
        counted(*arguments)

    def submit(pool, task, number):
        handed_out.append(task)
        begun.clear()
        threading.Thread(target=task, args=(number,)).start()
        assert begun.wait(120)
        if len(handed_out) == 3:
            raise KeyboardInterrupt
        future = Future()
        future.set_result(None)
        return future

    with monkeypatch.context() as patch:
        patch.setattr(sampling_job.Recipe, "count_samples", count)
        patch.setattr(ThreadPoolExecutor, "submit", submit)
        workspace = made(budget=Budget(threads=3))
    assert workspace.interrupted and 30_000 <= workspace.samples < N
    assert np.array_equal(workspace.map.counts, made(n=workspace.samples).map.counts)


def test_a_seed_is_a_map_and_another_is_another():
    assert not np.array_equal(made(budget=Budget(rng=1)).map.counts, made().map.counts)


def test_a_map_depends_on_its_seed_only(hunt):
    """Not on threads, not on how often and where the work was interrupted."""
    rng = hunt.rng()
    for _ in range(hunt.cases(12)):
        system = (
            shell(*rng.uniform(0.1, 1.0, 2))
            if rng.random() < 0.5
            else two_bars(*rng.uniform(0.1, 1.0, 2))
        )
        n = int(rng.integers(1, 300_000))
        seed = int(rng.integers(10**6))
        cells = int(rng.integers(2, 60))
        recipe_ = sampling_job.make_recipe(system, "tip", seed, cells, None)
        cuts = [0, *sorted(rng.integers(0, n, 5).tolist()), n]
        parts = sum(
            sampling_job.count_part(recipe_, a, b).astype(np.uint64)
            for a, b in itertools.pairwise(cuts)
        )
        budget = Budget(rng=seed, threads=int(rng.integers(1, 6)))
        whole = system.workspace("tip", n=n, cells=cells, budget=budget)
        assert np.array_equal(whole.map.counts.ravel(), parts[: whole.map.counts.size])
        assert whole.outside == parts[whole.map.counts.size]


def test_an_interrupted_map_is_gone_on_with(tmp_path):
    path = tmp_path / "map.zarr"
    first = made(path, budget=interrupted_after(120_000))
    assert first.code is Status.INTERRUPTED and 120_000 <= first.samples < N
    assert first.map.counts.sum() == first.samples
    assert np.array_equal(kempe.open_workspace(path).map.counts, first.map.counts)
    drawn = []
    whole = made(path, budget=Budget(progress=lambda done, *_: drawn.append(done)))
    assert whole.code is Status.SOLVED and drawn[0] >= first.samples and whole.samples == N
    assert np.array_equal(whole.map.counts, made().map.counts)
    assert [p.name for p in tmp_path.iterdir()] == ["map.zarr"]


def test_a_finished_map_is_opened_and_grows(tmp_path):
    path = tmp_path / "map.zarr"
    made(path, 100_000)
    assert made(path, 50_000).samples == 100_000
    assert [p.name for p in tmp_path.iterdir()] == ["map.zarr"]
    grown = made(path, N)
    assert grown.samples == N and np.array_equal(grown.map.counts, made().map.counts)


def test_ranges_of_samples_are_joined_and_what_is_between_them_is_missing(hunt):
    """Against sets of numbers."""
    rng = hunt.rng()
    for _ in range(hunt.cases(50)):
        cuts = np.unique(rng.integers(0, 60, 12)).tolist()
        parts = [cut for cut in itertools.pairwise(cuts) if rng.random() < 0.6]
        samples = stored_map.make_empty_counts({}, Grid((0,) * 3, (1,) * 3, (1, 1, 1), ("x",)))
        for first, last in rng.permutation(parts).tolist():
            samples = samples.add_counts(
                first, last, np.array([last - first, 0, 0, 9], dtype=np.uint32)
            )
        drawn = {k for first, last in parts for k in range(first, last)}
        n, most = (int(x) for x in rng.integers(1, 70, 2))
        missing = samples.list_missing_ranges(n, most)
        assert samples.samples == samples.map.counts.sum() == len(drawn)
        assert [k for part in missing for k in range(*part)] == sorted(set(range(n)) - drawn)
        assert all(0 < last - first <= most for first, last in missing)
        assert all(a[1] < b[0] for a, b in itertools.pairwise(samples.ranges))


def test_a_process_that_ended_while_a_map_was_replaced(tmp_path):
    path = tmp_path / "map.zarr"
    made(path, budget=interrupted_after(100_000))
    path.rename(tmp_path / "map.zarr.kempe-former")
    (tmp_path / "map.zarr.kempe-new").mkdir()
    drawn = []
    whole = made(path, budget=Budget(progress=lambda done, *_: drawn.append(done)))
    assert min(drawn) >= 100_000 and np.array_equal(whole.map.counts, made().map.counts)
    assert [p.name for p in tmp_path.iterdir()] == ["map.zarr"]


def test_a_process_that_ended_after_a_map_was_replaced(tmp_path):
    """The map that was there before is removed; a folder of somebody else with its name is not."""
    path = tmp_path / "map.zarr"
    former = tmp_path / "map.zarr.kempe-former"
    whole = made(path)
    former.mkdir()
    (former / "x").write_text("precious")
    made(path)
    assert (former / "x").read_text() == "precious"
    shutil.rmtree(former)
    shutil.copytree(path, former)
    assert np.array_equal(made(path).map.counts, whole.map.counts)
    assert [p.name for p in tmp_path.iterdir()] == ["map.zarr"]


@pytest.mark.parametrize("how", ["changed", "cut", "gone"])
@pytest.mark.parametrize("whole", [True, False])
def test_a_damaged_map_is_found_and_made_again(tmp_path, how, whole):
    path = tmp_path / "map.zarr"
    made(path, budget=None if whole else interrupted_after(160_000))
    chunk = max(
        (p for p in path.rglob("*") if p.is_file() and "counts" in p.parts),
        key=lambda p: p.stat().st_size,
    )
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 16
    if how == "changed":
        chunk.write_bytes(data)
    elif how == "cut":
        chunk.write_bytes(data[:-900])
    else:
        chunk.unlink()
    with pytest.raises(DamagedError, match=rf"chunk '{chunk.relative_to(path)}': .*make it again"):
        kempe.open_workspace(path)
    again = made(path)
    assert again.redone == 1 and np.array_equal(again.map.counts, made().map.counts)
    assert np.array_equal(kempe.open_workspace(path).map.counts, again.map.counts)


@pytest.mark.parametrize("what", ["box", "samples", "system", "axis", "axis cut", "axis gone"])
def test_what_is_said_of_a_map_is_guarded_like_its_counts(tmp_path, what):
    """A digit of the box or of the number of samples, or an axis that xarray would read, makes
    another map.
    """
    path = tmp_path / "map.zarr"
    made(path)
    if what.startswith("axis"):
        file = path / "x" / "c" / "0"
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 16
        file.unlink() if what == "axis gone" else file.write_bytes(
            data[:-9] if what == "axis cut" else data
        )
    else:
        words = json.loads((path / "zarr.json").read_text())
        said = json.loads(words["attributes"]["kempe"])
        if what == "box":
            said["low"][0] *= 0.5
        elif what == "samples":
            said["samples"] += 100_000
        else:
            said["toml"] = said["toml"].replace("0.5", "0.6", 1)
        words["attributes"]["kempe"] = json.dumps(said)
        (path / "zarr.json").write_text(json.dumps(words))
    with pytest.raises(DamagedError, match="make it again"):
        kempe.open_workspace(path)
    again = made(path)
    assert again.redone == 1 and np.array_equal(again.map.counts, made().map.counts)
    assert kempe.open_workspace(path).samples == N


@pytest.mark.parametrize("number", [errno.ENOSPC, None])
def test_a_full_disk_midway_loses_nothing(tmp_path, monkeypatch, number):
    """Numpy raises an error without a number where not all bytes are taken."""
    path = tmp_path / "map.zarr"
    write = store.import_zarr().Array.__setitem__
    writes = []

    def full(array, where, value):
        writes.append(1)
        if len(writes) == 8:
            raise OSError(*[number] * (number is not None), "No space left on device")
        write(array, where, value)

    monkeypatch.setattr(store.import_zarr().Array, "__setitem__", full)
    monkeypatch.setattr(mapping, "SPARE", 0.0)
    why = "the disk is full" if number else "not all of it was taken: the disk may be full"
    with pytest.raises(KempeError, match=f"{why}; what was written before stands"):
        made(path)
    assert [p.name for p in tmp_path.iterdir()] == ["map.zarr"]
    assert kempe.open_workspace(path).samples == 100_000
    assert np.array_equal(made(path).map.counts, made().map.counts)


def test_a_small_disk_is_refused_early(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    with pytest.raises(KempeError, match="are free on this disk"):
        made(tmp_path / "map.zarr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "other"),
    [
        ("system", lambda path: two_bars(0.5, 0.31).workspace("tip", n=N, cells=64, path=path)),
        ("frame", lambda path: ARM.workspace("second", n=N, cells=64, path=path)),
        ("seed", lambda path: made(path, budget=Budget(rng=3))),
        ("cells", lambda path: ARM.workspace("tip", n=N, cells=32, path=path)),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
@pytest.mark.parametrize("whole", [True, False])
def test_maps_of_something_else_are_refused(tmp_path, words, other, whole):
    path = tmp_path / "map.zarr"
    made(path, budget=None if whole else interrupted_after(100_000))
    with pytest.raises(InputError, match=f"belongs to another map: (its|it is of another) {words}"):
        other(path)
    assert np.array_equal(made(path).map.counts, made().map.counts)


def test_kernels_that_round_otherwise_are_refused_by_name():
    one = sampling_job.make_recipe(ARM, "tip", 0, 16, None)
    foreign = sampling_job.Recipe(one.system, one.frame, 0, one.grid, "v9")
    with pytest.raises(KernelsError, match="'v9'.*KEMPE_KERNELS=v9"):
        sampling_job.count_part(foreign, 0, 100)


def test_a_map_of_other_kernels_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "map.zarr"
    made(path, budget=interrupted_after(100_000))
    monkeypatch.setattr(
        sampling_job.Recipe, "describe_recipe", lambda self: {**SAID(self), "variant": "v9"}
    )
    with pytest.raises(InputError, match="its variant is .* and here it is 'v9'"):
        made(path)


SAID = sampling_job.Recipe.describe_recipe


def test_opened_without_kempe(tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed (extra scale)")
    system = shell(0.5, 0.3)
    workspace = system.workspace("tip", n=20_000, cells=(10, 12, 14))
    data = xarray.open_zarr(workspace.save(tmp_path / "map.zarr"))
    assert data.counts.dims == ("x", "y", "z") and data.counts.shape == (10, 12, 14)
    assert data.x.attrs["units"] == "m" and np.array_equal(data.y, workspace.map.axes["y"])
    assert np.array_equal(data.counts, workspace.map.counts)
    made_of = json.loads(data.attrs["kempe"])
    assert (
        made_of["system"] == system.structure.content_hash
        and made_of["seed"] == 0
        and made_of["variant"] == sampling_job.VARIANT
    )


def test_written_and_opened(tmp_path):
    workspace = made(n=20_000)
    opened = kempe.open_workspace(workspace.save(tmp_path / "map.zarr"))
    assert opened.system == ARM and opened.data() == workspace.data()
    assert opened.contains([0.6, 0.0]) and np.array_equal(
        opened.map.axes["x"], workspace.map.axes["x"]
    )
    with pytest.raises(InputError, match="belongs to another map: it is of another system"):
        kempe.open_workspace(tmp_path / "map.zarr", two_bars(1, 1))


@pytest.mark.parametrize("what", ["nothing", "folder", "file"])
def test_what_is_no_map(tmp_path, what):
    path = tmp_path / "map.zarr"
    if what == "folder":
        path.mkdir()
    elif what == "file":
        path.write_text("x")
    with pytest.raises(InputError, match="map"):
        kempe.open_workspace(path)


def test_what_stands_at_the_path_is_kept(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "x").write_text("precious")
    with pytest.raises(InputError, match="something else than a map"):
        made(tmp_path / "data")
    with pytest.raises(InputError, match="something else than a map"):
        made(n=100).save(tmp_path / "data")
    with pytest.raises(InputError, match="no folder"):
        made(tmp_path / "none" / "map.zarr")
    assert (tmp_path / "data" / "x").read_text() == "precious"


WORK = """
    import kempe
    from kempe.workspace import sampling_job as recipe
    recipe.PART, recipe.PIECE = 200_000, 20_000
    kempe.load("puma560").workspace("tool", n=4_000_000, cells=32, path={path!r}, budget=kempe.Budget(threads=2))
"""


@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGINT])
def test_a_process_that_is_ended_at_any_moment(tmp_path, hunt, ending):
    """Six times, each in the next twelfth of the work at most."""
    path = tmp_path / "map.zarr"
    rng = hunt.rng()
    lines = ended(ending, 0, MODULES, WORK.format(path=str(tmp_path / "whole.zarr")))
    for _ in range(6):
        at = int(rng.integers(1, lines // 12))
        ended(ending, at, MODULES, WORK.format(path=str(path)))
        assert not path.exists() or kempe.open_workspace(path).samples < 4_000_000
    assert ended(ending, 0, MODULES, WORK.format(path=str(path))) is not None
    whole = kempe.load("puma560").workspace("tool", n=4_000_000, cells=32)
    assert np.array_equal(kempe.open_workspace(path).map.counts, whole.map.counts)
    assert math.isclose(float(whole.map.counts.sum()), 4e6) and Path(path).is_dir()
