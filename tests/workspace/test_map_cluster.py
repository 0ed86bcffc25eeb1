"""Maps made by worker processes of a Dask cluster: killed, late, failing once; the same counts as
of one process.
"""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

import kempe
from kempe import Budget
from kempe.errors import InputError, KempeError, KernelsError
from kempe.numerics import clock
from kempe.workspace import sampling_job
from kempe.workspace import workers as maps_cluster

dask = pytest.importorskip("dask", reason="dask is not installed (extra scale)")
distributed = pytest.importorskip(
    "distributed", reason="distributed is not installed (extra scale)"
)
pytest.importorskip("zarr", reason="zarr is not installed (extra scale)")
ARM = kempe.load("puma560")


@contextmanager
def running(workers):
    """A scheduler in this process, worker processes, and a client."""
    settings = {
        "distributed.scheduler.allowed-failures": 3,
        "distributed.comm.timeouts.connect": "5s",
    }
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            memory_limit=None,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield cluster, client


@pytest.fixture(scope="module")
def cluster():
    with running(2) as pair:
        yield pair


@pytest.fixture(autouse=True)
def small_tasks(monkeypatch):
    monkeypatch.setattr(sampling_job, "PART", 500_000)


def made(n, **more):
    return ARM.workspace("tool", n=n, cells=24, **more)


def digest(workspace):
    """A checksum of counts, by their values."""
    return hashlib.sha256(workspace.map.counts.astype("<u8").tobytes()).hexdigest()


def checksum(n):
    return digest(made(n))


def kill(cluster, rng):
    """End one worker process, as the system would: its nanny starts another. Whether there was one.

    Only workers that have joined are ended: where one ends as it starts, its nanny ends, too.
    """
    nannies = [nanny for nanny in cluster.workers.values() if nanny.status.name == "running"]
    joined = [n.pid for n in nannies if n.worker_address in cluster.scheduler.workers and n.pid]
    for pid in rng.permutation(joined).tolist():
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
        return True
    return False


@pytest.mark.slow
def test_a_cluster_makes_the_same_map(cluster):
    n = 40 * 500_000 + 17
    workspace = made(n, client=cluster[1])
    assert workspace.samples == n and digest(workspace) == checksum(n)


@pytest.mark.slow
def test_with_loops_too(cluster, monkeypatch):
    monkeypatch.setattr(sampling_job, "SLOW_PART", 1500)
    bar = kempe.load("five_bar")
    one, many = (bar.workspace("tip", n=5000, cells=24, client=c) for c in (None, cluster[1]))
    assert np.array_equal(one.map.counts, many.map.counts) and one.left_out == many.left_out


@pytest.mark.slow
def test_a_killed_worker_and_a_late_one(cluster, tmp_path):
    n = 80 * 500_000
    rng = np.random.default_rng(1)
    path = tmp_path / "map.zarr"
    local, client = cluster
    killed = []

    def disturb(samples, _):
        if not killed and kill(local, rng):
            killed.append(samples)
            local.scale(3)

    workspace = made(n, client=client, path=path, budget=Budget(progress=disturb))
    local.scale(2)
    assert killed and killed[0] < n == workspace.samples
    assert digest(kempe.open_workspace(path)) == checksum(n)


@pytest.mark.slow
def test_a_task_that_fails_once(cluster):
    local, client = cluster

    def fail_once():
        from kempe.workspace import sampling_job

        class Once(sampling_job.Recipe):
            failed = False

        count = sampling_job.Recipe.count_samples

        def failing(self, first, last, counts):
            if not Once.failed:
                Once.failed = True
                raise OSError("a worker that fails once")
            count(self, first, last, counts)

        sampling_job.Recipe.count_samples = failing

    client.run(fail_once)
    n = 8 * 500_000
    assert digest(made(n, client=client, budget=Budget(rng=4))) == digest(
        made(n, budget=Budget(rng=4))
    )


@pytest.mark.slow
def test_a_task_that_always_fails_says_why_and_loses_nothing(cluster, tmp_path, monkeypatch):
    said = sampling_job.Recipe.__reduce__
    path = tmp_path / "map.zarr"
    monkeypatch.setattr(
        sampling_job.Recipe,
        "__reduce__",
        lambda self: (said(self)[0], (*said(self)[1][:4], "v9", "0")),
    )
    with pytest.raises(KempeError, match="'v9'"):
        made(10**6, client=cluster[1], path=path, budget=Budget(rng=5))
    monkeypatch.undo()
    assert made(10**6, path=path, budget=Budget(rng=5)).samples == 10**6


@pytest.mark.slow
def test_the_time_limit_gives_tasks_up(cluster, monkeypatch):
    """The time is up when the first parts are there."""

    def up(*_):
        monkeypatch.setattr(clock, "time", SimpleNamespace(monotonic=lambda: np.inf))

    n = 32 * 500_000
    workspace = made(n, client=cluster[1], budget=Budget(time_limit=1000.0, rng=6, progress=up))
    assert workspace.late and 0 < workspace.map.counts.sum() == workspace.samples < n


def test_what_is_no_address_is_refused_before_a_client_is_made(monkeypatch):
    """A client that has no scheduler lets the process wait for half a minute at its end."""
    monkeypatch.setattr(distributed, "Client", lambda *a, **k: pytest.fail("a client was made"))
    for address, why in (
        ("rubbish", "port"),
        ("tcp://nowhere", "port"),
        ("", "port"),
        ("http://127.0.0.1:1", "scheme"),
    ):
        with pytest.raises(
            InputError, match=f"no scheduler answers at {address!r}: .*{why}.*; give an address"
        ):
            made(10**6, client=address)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("tls://127.0.0.1:1", "TLS configuration"),
        ("wss://127.0.0.1:1", "Timed out"),
        ("ucx://127.0.0.1:1", "UCX"),
    ],
)
def test_ways_to_a_scheduler_that_are_not_set_up_are_refused_before_a_client_is_made(
    monkeypatch, address, why
):
    """They ended in a TypeError of distributed."""
    monkeypatch.setattr(distributed, "Client", lambda *a, **k: pytest.fail("a client was made"))
    monkeypatch.setattr(maps_cluster, "PATIENCE", 0.5)
    with pytest.raises(InputError, match=f"no scheduler answers at '{address}'.*{why}"):
        made(10**6, client=address)


@pytest.mark.slow
def test_schedulers_that_are_not_there(monkeypatch):
    monkeypatch.setattr(maps_cluster, "PATIENCE", 0.5)
    with pytest.raises(InputError, match="no scheduler answers at 'tcp://127.0.0.1:1'"):
        made(10**6, client="tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="must be a distributed.Client"):
        made(10**6, client=3)


@pytest.mark.slow
def test_a_client_that_was_closed(cluster):
    client = distributed.Client(cluster[0], set_as_default=False)
    client.close()
    with pytest.raises(InputError, match="closed: it has no scheduler"):
        made(10**6, client=client)


def test_a_scheduler_without_workers_is_mentioned():
    scheduler = SimpleNamespace(address="tcp://10.0.0.1:8786")
    client = SimpleNamespace(run=lambda *_, **__: {}, scheduler=scheduler)
    with pytest.warns(UserWarning, match="tcp://10.0.0.1:8786 has no workers; the work begins"):
        maps_cluster.refuse_workers(client)


@contextmanager
def filled(local, size):
    """The cluster has so many workers again each second: Dask's nannies give up where a worker is
    killed while it starts.
    """
    over = threading.Event()

    def fill():
        while not over.wait(1.0):
            local.scale(size())

    thread = threading.Thread(target=fill)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.slow
def test_workers_killed_twenty_times(tmp_path):
    n = 400 * 500_000
    rng = np.random.default_rng(0)
    kills = []
    whole = []
    with running(2) as (local, client):

        def disturb(samples, _):
            # something is done between two kills: a task that dies each time is given up
            if len(kills) < 20 and samples not in kills[-1:] and kill(local, rng):
                kills.append(samples)

        with filled(local, lambda: 2 if len(kills) < 5 else 3):
            while len(kills) < 20:  # as many maps as that takes
                whole.append(tmp_path / f"map{len(whole)}.zarr")
                made(n, client=client, path=whole[-1], budget=Budget(progress=disturb))
    assert {digest(kempe.open_workspace(p)) for p in whole} == {checksum(n)}


# ---- as users start it: a scheduler, workers and Kempe in processes of their own, an address as
# text


@contextmanager
def processes(folder, *environments):
    """The address of a scheduler whose workers run with these environment variables."""
    begun = []

    def begin(module, *arguments, **environment):
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        with open(folder / "log", "ab") as log:
            begun.append(
                subprocess.Popen(
                    command, stderr=log, stdout=log, env=os.environ | environment, cwd=folder
                )
            )

    file = folder / "scheduler.json"
    try:
        begin("dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        while not file.exists():
            assert begun[0].poll() is None, (folder / "log").read_text()
            time.sleep(0.05)
        for environment in environments:
            begin(
                "dask_worker",
                "--scheduler-file",
                str(file),
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
                **environment,
            )
        with distributed.Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(len(environments))
            address = client.scheduler.address
        yield address
    finally:
        for process in reversed(begun):
            # asked to end, a worker waits for ever for a scheduler that has ended meanwhile
            process.kill()
        for process in begun:
            process.wait()


def ran(*arguments, **environment):
    """What a process of its own printed."""
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=os.environ | environment
    )
    return done.returncode, done.stdout + done.stderr


MAP = """
import sys, kempe
if __name__ == "__main__":
    space = kempe.load("puma560").workspace("tool", n=1e6, cells=24, client=sys.argv[1])
    rows = kempe.map_file(kempe.load("puma560"), "fk", sys.argv[2], sys.argv[3], "tool", client=sys.argv[1])
    counts = space.map.counts.ravel()
    print(space.samples, int((counts * range(1, counts.size + 1)).sum() % 1000003), rows.rows)
"""


@pytest.mark.slow
def test_a_cluster_by_its_address_in_a_process_of_its_own(tmp_path):
    counts = made(10**6).map.counts.ravel()
    np.save(tmp_path / "q.npy", ARM.random(0, 50))
    (tmp_path / "map.py").write_text(MAP)
    with processes(tmp_path, {}) as address:
        code, printed = ran(
            str(tmp_path / "map.py"), address, str(tmp_path / "q.npy"), str(tmp_path / "x.zarr")
        )
        assert code == 0, printed
        checksum = int((counts * range(1, counts.size + 1)).sum() % 1000003)
        assert printed.split() == ["1000000", str(checksum), "50"]
        command = [
            "-m",
            "kempe",
            "workspace",
            "puma560",
            "--frame",
            "tool",
            "-n",
            "1e6",
            "--scheduler",
            address,
        ]
        code, printed = ran(*command)
        assert code == 0 and printed.startswith("1e+06 samples"), printed


@pytest.mark.slow
@pytest.mark.parametrize("good", [0, 1])
@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ("import nothing_of_this_name", "No module named 'nothing_of_this_name'"),
        ("__version__ = '9'", "cannot import"),
    ],
    ids=["missing", "other"],
)
def test_workers_without_kempe_are_refused_by_name(tmp_path, broken, words, good):
    """And at once, where others could do the work, too."""
    shadow = tmp_path / "shadow" / "kempe"
    shadow.mkdir(parents=True)
    (shadow / "__init__.py").write_text(broken + "\n")
    with processes(tmp_path, {"PYTHONPATH": str(shadow.parent)}, *[{}] * good) as address:
        with pytest.raises(
            KernelsError, match=rf"worker tcp://\S+ cannot import Kempe: .*{words}|{words}.*"
        ):
            made(10**6, client=address)


@pytest.mark.slow
def test_workers_with_other_kernels_are_refused(tmp_path):
    with (
        processes(tmp_path, {"KEMPE_KERNELS": "none"}) as address,
        pytest.raises(KernelsError, match="'none'"),
    ):
        made(10**6, client=address)


@pytest.mark.slow
def test_the_description_travels_once(cluster, monkeypatch):
    """Not in each task: the tasks of 10^12 samples would be gigabytes."""
    pickled = []
    reduced = sampling_job.Recipe.__reduce__
    monkeypatch.setattr(
        sampling_job.Recipe, "__reduce__", lambda self: (pickled.append(1), reduced(self))[1]
    )
    made(20 * 500_000, client=cluster[1], budget=Budget(rng=8))
    assert 0 < len(pickled) <= 4
