"""What a process pays: import, first results, memory; each measured in processes of its own."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence

from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Row, Table

REPEATS = 3
MEMORY_POSES = 1_000_000

_MODULES = {
    "ikpy": "ikpy.chain",
    "drake": "pydrake.multibody.inverse_kinematics",
    "EAIK": "eaik.IK_Homogeneous",
    "roboplan": "roboplan.simple_ik",
}
"""What to import of packages that are empty at the top."""

_FIRST = """
import json, sys, time
start = time.perf_counter()
import kempe
imported = time.perf_counter() - start
robot = kempe.load(sys.argv[1])
loaded = time.perf_counter() - start
X = robot.fk(robot.mid, sys.argv[2])
forward = time.perf_counter() - start
robot.ik(X, sys.argv[2])
print(json.dumps([imported, loaded, forward, time.perf_counter() - start]))
"""

_IMPORT = """
import importlib, sys, time
start = time.perf_counter()
importlib.import_module(sys.argv[1])
print(time.perf_counter() - start)
"""

_MEMORY = """
import json, sys
import kempe, numpy as np
def status(key):
    return next(int(x.split()[1]) for x in open("/proc/self/status") if x.startswith(key)) / 1024.0
def extra(call, output):
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")
    before = status("VmRSS")
    result = call()
    return status("VmHWM") - before - output
robot = kempe.load(sys.argv[1])
query, n = robot.query(sys.argv[2]), int(sys.argv[3])
q = robot.random(0, n)
query(q[:30000], threads=2)
out = np.ones((n, 4, 4))
print(json.dumps([extra(lambda: query(q, out=out), 0.0), extra(lambda: query(q), out.nbytes / 2**20)]))
"""
"""The peak of the resident memory is reset before each call, which Linux alone can do."""


def startup(bench: Bench) -> Table:
    """Seconds until something is there, in a fresh process."""
    table = Table("Start-up", "s", _own_startup(bench), ratios=False)
    for package in bench.versions:
        module = _MODULES.get(package, peers.PEERS[package])
        table.rows.append(
            _row(package, "import", [float(_run(_IMPORT, module)) for _ in range(REPEATS)])
        )
    for text, call, bound in (
        ("import, under 0.15 s", "import", 0.15),
        ("first forward result, under 0.5 s", "import, load and first forward result", 0.5),
        ("first inverse result, under 0.5 s", "the same and first inverse result", 0.5),
    ):
        table.at_most(text, table.best("Kempe", call), bound)
    return table


def _own_startup(bench: Bench) -> list[Row]:
    job = (str(bench.arm.file), bench.arm.frame)
    labels = (
        "import",
        "import and load",
        "import, load and first forward result",
        "the same and first inverse result",
        "the whole process of that",
    )
    runs = [_timed(_FIRST, *job) for _ in range(REPEATS)]
    columns = zip(*([*json.loads(reported), wall] for wall, reported in runs), strict=True)
    return [_row("Kempe", label, seconds) for label, seconds in zip(labels, columns, strict=True)]


def _row(library: str, call: str, seconds: Sequence[float]) -> Row:
    return Row(library, call, statistics.median(seconds), min(seconds))


def memory(bench: Bench) -> Table | None:
    """Peak memory of a batch call beyond its input and output."""
    if not os.access("/proc/self/clear_refs", os.W_OK):
        bench.say("  skipped: this system does not tell the peak of memory of one call")
        return None
    file = str(bench.arm.file)
    frame = bench.arm.frame
    runs = [json.loads(_run(_MEMORY, file, frame, str(MEMORY_POSES))) for _ in range(REPEATS)]
    into, new = (statistics.median(column) for column in zip(*runs, strict=True))
    table = Table(
        f"Memory: {MEMORY_POSES:,} poses, peak beyond input and output", "MiB", ratios=False
    )
    table.rows = [Row("Kempe", "into out=", into), Row("Kempe", "a new array", new)]
    table.at_most("beyond the output, at most 8 MiB", max(into, new), 8.0)
    return table


def _run(code: str, *arguments: str) -> str:
    """Last line that a fresh Python process prints."""
    command = [sys.executable, "-c", code, *arguments]
    environment = {**os.environ, "KEMPE_QUIET": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip().splitlines()[-1] if done.stdout.strip() else ""


def _timed(code: str, *arguments: str) -> tuple[float, str]:
    """Seconds of a whole process, and its last line."""
    start = time.perf_counter()
    reported = _run(code, *arguments)
    return time.perf_counter() - start, reported
