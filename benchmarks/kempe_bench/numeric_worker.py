"""One library's answers to many targets, in a process of its own:
`python -m kempe_bench.numeric_worker JOB`.

The job is a JSON file: the package, and cases. A case is a URDF file, a folder with `targets.npy`
(n, 4, 4) and `starts.npy` (n, number of joints), whether the starts are near the answers, and the
seconds that it may take. A whole body has goals of several frames (n, k, 4, 4), and may ask for
more. Answers are written as they come, so that what is done survives when the library ends the
process.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import kempe
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.numeric_peers import LIMIT, SOLVERS, Solver
from kempe_bench.numeric_robots import TIP
from kempe_bench.whole_peers import WholeBody, prepared

FEWEST = 20
"""Targets that a library gets however long they take."""
PATIENCE = 60.0
"""Seconds beyond its share after which a process that does not end is ended."""
ALONE = {
    name: "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")
}
"""Environment in which numerical libraries start no threads."""


@dataclass(frozen=True)
class Case:
    """The targets of one robot: its URDF file, their folder, whether starts are near, seconds that
    it may take.

    `requested` is what `whole_peers.prepared` gets of a whole body; a chain has none.
    """

    file: str
    folder: str
    near: bool
    seconds: float
    requested: dict[str, Any] | None = None


@dataclass(frozen=True)
class Answers:
    """Configurations (k, number of joints) for the first k targets, NaN where there is none;
    nanoseconds of each.

    `trouble` says why the process ended early; the target that it ended on counts as tried.
    """

    q: Array
    nanoseconds: np.ndarray
    trouble: str = ""


def answers(package: str, cases: Sequence[Case]) -> list[Answers]:
    """Answers of one library to all cases; a process that ends early is followed by one for the
    other cases.
    """
    troubles: dict[int, str] = {}
    first = 0
    while first < len(cases):
        trouble = _process(package, cases[first:])
        done = next(
            (i for i in range(first, len(cases)) if not _path(cases[i], package, "done").exists()),
            len(cases),
        )
        if done == len(cases):
            break
        troubles[done] = trouble or "ended early"
        first = done + 1
    return [_read(package, case, troubles.get(i, "")) for i, case in enumerate(cases)]


def _process(package: str, cases: Sequence[Case]) -> str:
    """Run a process to its end, and say why it ended early, if it did."""
    patience = PATIENCE + sum(3.0 * case.seconds + 2.0 * FEWEST * LIMIT for case in cases)
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "job.json"
        job.write_text(
            json.dumps({"package": package, "cases": [asdict(case) for case in cases]}),
            encoding="utf-8",
        )
        command = [sys.executable, "-m", __name__, str(job)]
        environment = {
            **os.environ,
            **ALONE,
            "KEMPE_QUIET": "1",
            "PYTHONPATH": os.pathsep.join(sys.path),
        }
        try:
            run = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=patience
            )
        except subprocess.TimeoutExpired:
            return f"no answer for {patience:.0f} s"
    if run.returncode < 0:
        return f"signal {-run.returncode}"
    reported = run.stderr.strip().splitlines()
    return (reported[-1] if reported else f"exit {run.returncode}") if run.returncode else ""


def _read(package: str, case: Case, trouble: str) -> Answers:
    path = _path(case, package, "q.npy")
    if not path.exists():  # the library could not even be given the robot
        return Answers(
            np.full((1, np.load(_path(case, "starts.npy")).shape[1]), np.nan), np.empty(0), trouble
        )
    q = np.load(path)
    ns = np.load(_path(case, package, "ns.npy"))
    tried = int(np.sum(ns >= 0))
    return Answers(q[: tried + bool(trouble)], ns[:tried], trouble)


def _path(case: Case, *names: str) -> Path:
    return Path(case.folder) / "_".join(names)


# ---- in the process


def _solver(package: str, case: Case) -> Solver | WholeBody:
    file = Path(case.file)
    if case.requested is not None:
        return prepared(package, file, **case.requested)
    return SOLVERS[package][1](peers.arm_of(kempe.load(file), TIP, file))


def work(package: str, case: Case) -> None:
    """Solve a case, write what comes out."""
    solver = _solver(package, case)
    starts = np.load(_path(case, "starts.npy"))
    targets = solver.ready(np.load(_path(case, "targets.npy")))
    given = list(starts) if case.near or not solver.seedless else [None] * len(starts)
    write = np.lib.format.open_memmap
    q = write(_path(case, package, "q.npy"), "w+", float, starts.shape)
    ns = write(_path(case, package, "ns.npy"), "w+", np.int64, (len(starts),))
    q[:] = np.nan
    ns[:] = -1
    for i in (0, -1):  # what is made at first use is not counted
        solver.solve(targets[i], given[i])
    end = time.perf_counter() + case.seconds
    gc.disable()
    for i, (target, start) in enumerate(zip(targets, given, strict=True)):
        before = time.perf_counter_ns()
        answer = solver.solve(target, start)
        after = time.perf_counter_ns()
        if answer is not None:
            q[i] = solver.read(answer)
        ns[i] = after - before
        if i + 1 >= FEWEST and time.perf_counter() > end:
            break
    gc.enable()
    q.flush()
    ns.flush()
    _path(case, package, "done").touch()


def main() -> None:
    """Work through the job that the command line names."""
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    for case in job["cases"]:
        work(job["package"], Case(**case))


if __name__ == "__main__":
    main()
