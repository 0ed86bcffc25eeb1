"""Two installations of Kempe side by side, in one run:
`python benchmarks/compare.py BEFORE AFTER [-o FILE]`.

BEFORE and AFTER are Python interpreters of environments with Kempe installed. Everything is
measured in processes of their own, of the two in turn, and the least of each is compared: what else
runs only adds. Prints a table in Markdown, and writes it to FILE.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROUNDS = 7
COLD_ROUNDS = 3

VERBS = {
    "fk": "r = kempe.load('puma560'); r.fk(r.mid, 'tool')",
    "ik": "r = kempe.load('puma560'); r.ik(r.fk(r.mid, 'tool'), 'tool')",
    "ik_all": "r = kempe.load('puma560'); r.ik_all(r.fk(r.mid, 'tool'), 'tool')",
    "ik_all, six general axes": (
        "r = kempe.load('jaco2'); f = r.frame_names[-1]; r.ik_all(r.fk(r.mid, f), f)"
    ),
    "ik of tasks": (
        "r = kempe.load('puma560'); r.ik([kempe.tasks.Position('tool', r.fk(r.mid, 'tool')[:3, "
        "3])])"
    ),
    "ik_sweep": (
        "r = kempe.load('panda'); f = r.frame_names[-1]; r.inverse.sweep(r.fk(r.mid, f), f)"
    ),
    "assemble": "r = kempe.load('jansen'); r.assemble({'O': 1.0})",
    "assembly_modes": "r = kempe.load('jansen'); r.assembly_modes({'O': 1.0})",
    "mobility": "r = kempe.load('bennett'); r.mobility()",
    "trace": "r = kempe.load('jansen'); r.trace('O')",
}
"""What the first answer of a verb takes."""

SINGLE = """
import json, statistics, time, timeit
import numpy as np, kempe
panda, puma, bar = kempe.load("panda"), kempe.load("puma560"), kempe.load("four_bar")
hand = panda.frame_names[-1]
query, q, X, out, J = panda.query(hand), panda.random(3), np.empty((4, 4)), np.empty((4, 4)), np.empty((6, panda.nv))
targets = list(panda.fk(panda.random(5, 400), hand))
Y = puma.fk(puma.random(1), "tool")
panda.ik(targets[0], hand), puma.ik_all(Y, "tool")
def each(call, items):
    times = []
    for item in items * 3:
        start = time.perf_counter_ns(); call(item); times.append(time.perf_counter_ns() - start)
    return statistics.median(times) / 1e3
def one(call, number=20000):
    call()
    return statistics.median(timeit.repeat(call, number=number, repeat=5)) / number * 1e6
closed = bar.assemble({"A": 1.0}).q
assembler = bar.loops.assembler(["A"])
print(json.dumps({
    "query(q), pose of Panda's hand": one(lambda: query(q)),
    "query(q, out)": one(lambda: query(q, out)),
    "query.jacobian(q)": one(lambda: query.jacobian(q)),
    "system.fk(q, frame)": one(lambda: panda.fk(q, hand)),
    "ik, 400 targets": each(lambda X: panda.ik(X, hand), targets),
    "ik_all of a Puma 560": one(lambda: puma.ik_all(Y, "tool"), 2000),
    "four-bar, bound: assembler(A)": one(lambda: assembler([0.9], closed), 2000),
    "four-bar: assemble(A)": one(lambda: bar.assemble({"A": 0.9}, closed), 1000),
}))
"""

BATCH = """
import json, statistics, time
import numpy as np, kempe
panda, puma, jaco, bar, stewart = (kempe.load(n) for n in ("panda", "puma560", "jaco2", "jansen", "stewart"))
hand, tip = panda.frame_names[-1], jaco.frame_names[-1]
q = panda.random(1, 100_000); out = panda.fk(q, hand, threads=1)
X, Y = panda.fk(panda.random(2, 2000), hand), puma.fk(puma.random(2, 5000), "tool")
Z = jaco.fk(jaco.random(2, 200), tip)
angles = np.linspace(0.0, 6.0, 2000)
start = stewart.q("closed") if "closed" in stewart.structure.posture_names else stewart.neutral
near = np.tile(start, (500, 1)) + 1e-2 * np.random.default_rng(0).normal(size=(500, stewart.nq))
def per(count, call, repeat=7):
    call()
    times = []
    for _ in range(repeat):
        begun = time.perf_counter(); call(); times.append(time.perf_counter() - begun)
    return statistics.median(times) / count * 1e6
print(json.dumps({
    "forward model, pose of Panda's hand": per(100_000, lambda: panda.fk(q, hand, out, 1)),
    "forward model, all bodies": per(20_000, lambda: panda.fk(q[:20_000], threads=1)),
    "Jacobian": per(20_000, lambda: panda.jacobian(q[:20_000], hand, threads=1)),
    "ik of Panda": per(2000, lambda: panda.ik(X, hand, budget=kempe.Budget(threads=1))),
    "ik_all of a Puma 560": per(5000, lambda: puma.ik_all(Y, "tool", budget=kempe.Budget(threads=1))),
    "ik_all, six general axes": per(200, lambda: jaco.ik_all(Z, tip, budget=kempe.Budget(threads=1)), 3),
    "Jansen's leg from its crank": per(2000, lambda: bar.assemble({"O": angles}, budget=kempe.Budget(threads=1))),
    "Stewart platform, from 0.01 off": per(500, lambda: stewart.assemble({}, near, budget=kempe.Budget(threads=1))),
}))
"""

WARM = """
import json, statistics, time
import numpy as np, kempe
panda, bar, jansen, bennett, arm = (kempe.load(n) for n in ("panda", "four_bar", "jansen", "bennett", "two_link"))
hand = panda.frame_names[-1]
q = panda.mid
X = np.repeat(panda.fk(q, hand)[None], 50, axis=0)
X[:, 0, 3] += np.linspace(0.0, 0.1, 50)
tasks = [kempe.tasks.Position(hand, X[-1, :3, 3]), kempe.tasks.Pointing(hand, (0, 0, -1)).soft(weight=0.1)]
angles = np.linspace(0.3, 1.3, 200)
closed = bar.assemble({"A": 0.3}).q
def warm(call, number, repeat=5, count=1):
    call()
    times = []
    for _ in range(repeat):
        begun = time.perf_counter()
        for _ in range(number):
            call()
        times.append((time.perf_counter() - begun) / number)
    return statistics.median(times) / count * 1e6
print(json.dumps({
    "trace of a four-bar": warm(lambda: bar.trace("A"), 3),
    "trace of Jansen's leg": warm(lambda: jansen.trace("O"), 3),
    "drive of a four-bar, a sample": warm(lambda: bar.drive({"A": angles}, start=closed), 3, count=200),
    "ik_path of Panda, a target": warm(lambda: panda.ik_path(X, hand, q), 10, count=50),
    "ik_step of Panda, a twist": warm(lambda: panda.ik_step(q, [0.1, 0, 0, 0, 0, 0], hand, 0.01), 300),
    "ik_step of Panda, a pose": warm(lambda: panda.ik_step(q, X[-1], hand, 0.01), 300),
    "ik_step of Panda, tasks": warm(lambda: panda.ik_step(q, tasks, dt=0.01), 100),
    "ik of tasks of Panda": warm(lambda: panda.ik(tasks, start=q), 30),
    "mobility of Bennett's linkage": warm(lambda: bennett.mobility(), 5),
    "mobility of Jansen's leg": warm(lambda: jansen.mobility(), 5),
    "workspace of Panda, a sample": warm(lambda: panda.workspace(hand, n=1e6), 1, 3, 1e6),
    "workspace of a planar arm, exact": warm(lambda: arm.workspace("e", n=1e4), 3),
}))
"""

IMPORT = """
import time
{first}
start = time.perf_counter()
import {module}
print(time.perf_counter() - start)
"""

FIRST = (
    "import kempe\nr = kempe.load('puma560'); X = r.fk(r.mid, 'tool'); r.ik(X, 'tool'); "
    "r.ik_all(X, 'tool')"
)
COMMAND = ["ik", "puma560", "--frame", "tool", "--target", "0.5,0.2,0.1,0,90,0", "--deg"]


@dataclass(frozen=True)
class Cost:
    """What a process took: processor seconds, peak memory in MB, what it printed."""

    seconds: float
    memory: float
    printed: str


def process(python: str, *arguments: str, cache: str | None = None) -> Cost:
    """A process and what it took. Errors: what it wrote to standard error, as `RuntimeError`."""
    env = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("KEMPE_", "PYTHON"))
    }
    env |= {"KEMPE_QUIET": "1"} | ({"KEMPE_CACHE_DIR": cache} if cache else {})
    with tempfile.TemporaryFile() as reported, tempfile.TemporaryFile() as said:
        child = subprocess.Popen(
            [python, *arguments], stdout=reported, stderr=said, env=env, cwd=tempfile.gettempdir()
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        reported.seek(0), said.seek(0)
        if child.returncode:
            raise RuntimeError(said.read().decode())
        return Cost(
            used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, reported.read().decode()
        )


Row = tuple[str, str, float, float]


def in_turn(
    pythons: list[str], code: str, rounds: int = ROUNDS, cold: bool = False
) -> tuple[Cost, Cost]:
    """The process of least cost, of each of the two in turn."""
    found: tuple[list[Cost], list[Cost]] = [], []
    for _ in range(rounds):
        for costs, python in zip(found, pythons, strict=True):
            with tempfile.TemporaryDirectory() as folder:
                costs.append(process(python, "-c", code, cache=folder if cold else None))
    before, after = (min(costs, key=lambda c: c.seconds) for costs in found)
    return before, after


def printed(pythons: list[str], code: str) -> tuple[float, float]:
    """The least number that a process prints, of the two in turn."""
    found: tuple[list[float], list[float]] = [], []
    for _ in range(ROUNDS):
        for numbers, python in zip(found, pythons, strict=True):
            numbers.append(float(process(python, "-c", code).printed))
    return min(found[0]), min(found[1])


def rows(pythons: list[str]) -> Iterator[Row]:
    """All rows: what, unit, before, after."""
    sizes = [environment(python) for python in pythons]
    yield "environment with Kempe and what it needs", "MB", *sizes
    for name, first in (("numpy", "pass"), ("kempe, beyond numpy", "import numpy, numpy.typing")):
        module = name.partition(",")[0]
        yield (
            f"import {name}, seconds by the clock",
            "s",
            *printed(pythons, IMPORT.format(first=first, module=module)),
        )
    for name, code in VERBS.items():
        before, after = in_turn(pythons, f"import kempe\n{code}", COLD_ROUNDS, cold=True)
        yield f"first answer on a fresh machine: {name}", "s", before.seconds, after.seconds
    for name in ("ik", "trace", "mobility"):
        before, after = in_turn(pythons, f"import kempe\n{VERBS[name]}")
        yield f"first answer of a later process: {name}", "s", before.seconds, after.seconds
    before, after = in_turn(
        pythons, f"from kempe.cli import main\nimport sys\nsys.argv[1:] = {COMMAND!r}\nmain()"
    )
    yield f"`kempe {' '.join(COMMAND[:2])} ...`, whole process", "s", before.seconds, after.seconds
    before, after = in_turn(pythons, FIRST)
    yield "memory of a process that did fk, ik, ik_all", "MB", before.memory, after.memory
    for code, what in (
        (SINGLE, "one call"),
        (WARM, "later calls"),
        (BATCH, "batch, one thread, per item"),
    ):
        answers: tuple[list[dict[str, float]], ...] = [], []
        for _ in range(ROUNDS):
            for found, python in zip(answers, pythons, strict=True):
                found.append(json.loads(process(python, "-c", code).printed))
        for name in answers[0][0]:
            yield f"{what}: {name}", "µs", *(min(x[name] for x in found) for found in answers)


def environment(python: str) -> float:
    """Megabytes of an environment."""
    folder = Path(process(python, "-c", "import sys; print(sys.prefix)").printed.strip())
    return (
        sum(p.stat(follow_symlinks=False).st_size for p in folder.rglob("*") if p.is_file()) / 1e6
    )


VERSIONS = """
import platform
from importlib.metadata import distributions
found = {d.metadata["Name"].lower(): d.version for d in distributions()}
try:
    from kempe.kernels.compiled import VARIANT as kernels
except ImportError:
    kernels = "compiled at first use"
names = [f"{name} {found[name]}" for name in ("kempe", "numpy", "scipy", "numba") if name in found]
print(f"Python {platform.python_version()},", ", ".join(names) + f"; kernels: {kernels}")
"""


def versions(python: str) -> str:
    """What runs: versions, and the variant of the kernels."""
    return process(python, "-c", VERSIONS).printed.strip()


def processor() -> str:
    """The name of the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        "unknown",
    )


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("before", help="interpreter of one environment")
    parser.add_argument("after", help="interpreter of the other")
    parser.add_argument("--title", default="two installations", help="what changed between them")
    parser.add_argument("-o", "--out", type=Path, help="Markdown file to write")
    given = parser.parse_args()
    pythons = [given.before, given.after]
    lines = [
        f"# Before and after: {given.title}",
        "",
        "Written by `python benchmarks/compare.py BEFORE AFTER`: two installations in one run, "
        "numbers in processes of their own, of the two in turn, the least of each. Seconds are "
        "processor time of whole processes.",
        "",
        f"Machine: {processor()}, {len(os.sched_getaffinity(0))} processors.",
        "",
        f"- before: {versions(given.before)}",
        f"- after: {versions(given.after)}",
        "",
        "| | unit | before | after | after / before |",
        "|---|---|--:|--:|--:|",
    ]
    print("\n".join(lines), flush=True)
    for what, unit, before, after in rows(pythons):
        digits = 0 if unit == "MB" else 3
        lines.append(
            f"| {what} | {unit} | {before:.{digits}f} | {after:.{digits}f} | {after / before:.2f} |"
        )
        print(lines[-1], flush=True)
        if given.out is not None:  # what is there so far survives an interrupt
            given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.exit(main())
