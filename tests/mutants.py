"""Whether the tests notice small changes of the source:
`python tests/mutants.py --seed 7 -n 400 --jobs 2`.

Mutations (`mutation.py`) are drawn by the seed, as many from each area, and each is run against
tests that reach the changed lines, cheap ones first, until one fails. Which tests reach what is
recorded once, `--map`, in a copy of the source that says where it is; after a change of some tests,
`--map tests/model/test_gauge.py` records these anew. All of it stands in `build/mutants`, and
`--resume` goes on where a run was interrupted.

Tests are collected once; then each mutant is a fork in which the code of the changed functions is
replaced. What runs at import (constants, defaults, what tests compute while they are collected)
needs a process of its own, in which a mutant stands in a copy of the source: so do mutants that
survived the fork. The checkout is never edited. A kill counts only if the test that failed passes
without the mutant.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections import Counter
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import _lru_cache_wrapper, cache, cached_property  # type: ignore[attr-defined]
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import pytest
from mutation import Site, instrumented, mutated, sites

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "kempe"
TESTS = ROOT / "tests"
BUILD = ROOT / "build" / "mutants"
RECORD = ROOT / "docs" / "mutants.json"
AREAS = {
    "joints": ["joints.py"],
    "constraints": ["constraints/*"],
    "closures": [
        "model/constraint_program.py",
        "model/kernel_functions.py",
        "model/packed_loops.py",
        "equations/closure*",
        "assemble/bound.py",
    ],
    "lowering": ["model/*"],
    "analytic": [
        "inverse/closed_forms/*",
        "inverse/ik_all.py",
        "inverse/solve_all.py",
        "inverse/spare_joints.py",
    ],
    "mobility": ["first_order/*", "mobility/*"],
}
"""Modules of each area, by patterns; the first area that has a module takes it."""
TEXTS = [
    "*text*",
    "*describe*",
    "*explain*",
    "*words*",
    "*/__init__.py",
    "system.py",
    "namespaces.py",
]
"""Modules that make sentences, or only delegate."""
MEMORY = 8 << 30
"""Bytes that a mutant may take."""


@cache
def area(module: str) -> str:
    """The area of a module, by its path below the package; empty if it has none."""
    if any(fnmatch(module, pattern) for pattern in TEXTS):
        return ""
    return next(
        (name for name, patterns in AREAS.items() if any(fnmatch(module, p) for p in patterns)), ""
    )


def modules() -> list[str]:
    """All modules that have an area."""
    return [m for p in sorted(SOURCE.rglob("*.py")) if area(m := p.relative_to(SOURCE).as_posix())]


def draw(seed: int, count: int) -> list[tuple[str, Site]]:
    """Mutations, as many from each area, as modules and sites; a change of other code does not
    change what is drawn.
    """
    pools: dict[str, list[tuple[str, Site]]] = {name: [] for name in AREAS}
    lots: dict[tuple[str, Site], bytes] = {}
    for module in modules():
        seen: Counter[tuple[str, str, str]] = Counter()
        for site in sites((SOURCE / module).read_text()):
            seen[name := (site.function, site.before, site.after)] += 1
            lots[module, site] = hashlib.sha1(
                repr((seed, module, *name, seen[name])).encode()
            ).digest()
            pools[area(module)].append((module, site))
    for pool in pools.values():
        pool.sort(key=lots.__getitem__)
    return [pool.pop() for i in range(count) if (pool := pools[list(AREAS)[i % len(AREAS)]])]


def copy_of_source(folder: str, edit: dict[str, str]) -> str:
    """A copy of the package with other texts of some modules; its path for PYTHONPATH."""
    shutil.copytree(SOURCE, Path(folder) / "kempe", ignore=shutil.ignore_patterns("__pycache__"))
    for module, text in edit.items():
        (Path(folder) / "kempe" / module).write_text(text)
    return folder


def pytest_arguments(files: list[str]) -> list[str]:
    """Pytest in this process, without what slows it down, with all cases of hunts and all rows but
    the slow ones.
    """
    quick = [
        "-q",
        "-s",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:faulthandler",
        "--tb=no",
        "--no-header",
    ]
    quick += ["-m", "not slow", "--hunt-times", "1"]
    return [*quick, "--rootdir", str(ROOT), *files]


def environment(source: str) -> dict[str, str]:
    """The environment of a process that imports the package from there."""
    path = os.pathsep.join([source, str(TESTS), *sys.path[1:]])
    return {
        **os.environ,
        "PYTHONPATH": path,
        "KEMPE_QUIET": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONHASHSEED": "0",
    }


# Which tests reach what


class Recorder:
    """Pytest's plugin that writes for each file of tests what its tests reach, and their seconds.

    Each test begins with empty caches: else only the first one that asks for an answer would be
    known to reach it.
    """

    def __init__(self) -> None:
        self.tests: dict[str, list[Any]] = {}
        self.keys: dict[str, int] = {}
        self.failed = False
        self.systems: WeakValueDictionary[int, Any] = WeakValueDictionary()
        self.caches: list[Any] = []

    def forget(self) -> None:
        """Empty all caches of the library and of the tests, and what systems keep."""
        for cached in self.caches:
            cached.cache_clear()
        for system in list(self.systems.values()):
            for kept in system._kept.values():
                kept.clear()
            for name in self.lazy:
                vars(system).pop(name, None)

    def write(self, name: str) -> None:
        """Write what was gathered, and begin anew; names stand once and are meant by their numbers."""
        (BUILD / "map").mkdir(parents=True, exist_ok=True)
        path = BUILD / "map" / f"{hashlib.sha1(name.encode()).hexdigest()[:12]}.json"
        path.write_text(json.dumps({"of": name, "keys": list(self.keys), "tests": self.tests}))
        self.tests = {}
        self.keys = {}

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        from kempe._hits import HITS  # type: ignore

        from kempe.system import System

        self.keys = dict.fromkeys(HITS, 0)
        self.write("import " + " ".join(session.config.args))
        gathered = self.systems
        begin = System.__init__

        def init(system: Any, *given: Any, **named: Any) -> None:
            begin(system, *given, **named)
            gathered[id(system)] = system

        System.__init__ = init  # type: ignore[method-assign]
        gathered.update({id(x): x for x in gc.get_objects() if isinstance(x, System)})
        names = [name for base in System.__mro__ for name in vars(base)]
        self.lazy = [
            name for name in names if isinstance(getattr(System, name, None), cached_property)
        ]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> Iterator[None]:
        from kempe._hits import HITS  # type: ignore

        file = item.location[0]
        # the first of its file: modules that were imported since have caches, too
        if not self.tests:
            folders = ("kempe.", *(p.stem for p in TESTS.rglob("*.py")))
            found = (x for x in gc.get_objects() if isinstance(x, _lru_cache_wrapper))
            self.caches = [x for x in found if str(x.__module__).startswith(folders)]
        self.forget()
        HITS.clear()
        self.failed = False
        before = sum(os.times()[:4])
        done = yield
        if not self.failed:
            reached = [self.keys.setdefault(key, len(self.keys)) for key in sorted(HITS)]
            self.tests[item.nodeid] = [round(sum(os.times()[:4]) - before, 3), reached]
        if nextitem is None or nextitem.location[0] != file:
            self.write(file)
            print(file, flush=True)
        return done

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.outcome != "passed"


def record(files: list[str], jobs: int) -> None:
    """Record what the tests of some files reach, or of all."""
    if not files:
        shutil.rmtree(BUILD / "map", ignore_errors=True)
        files = [str(p) for p in sorted(TESTS.rglob("test_*.py")) if p.parent.name != "kernels"]
    with tempfile.TemporaryDirectory() as folder:
        edit = {module: instrumented((SOURCE / module).read_text(), module) for module in modules()}
        edit["_hits.py"] = "HITS: set[str] = set()\nhit = HITS.add\n"
        env = environment(copy_of_source(folder, edit))
        parts = [files[i::jobs] for i in range(min(jobs, len(files)))]
        running = [
            subprocess.Popen([sys.executable, __file__, "--record", *p], env=env, cwd=ROOT)
            for p in parts
        ]
        if any([process.wait() > 1 for process in running]):
            raise SystemExit("recording failed")


class Map:
    """Which tests reach a segment, in which seconds; which segments run while tests are collected."""

    def __init__(self, budget: float) -> None:
        self.budget = budget
        self.seconds: dict[str, float] = {}
        self.tests: dict[str, list[str]] = {}
        self.imported: set[str] = set()
        for path in sorted((BUILD / "map").glob("*.json")):
            part = json.loads(path.read_text())
            if part["of"].startswith("import "):
                self.imported.update(part["keys"])
            for test, (seconds, hits) in part["tests"].items():
                self.seconds[test] = seconds
                for hit in hits:
                    self.tests.setdefault(part["keys"][hit], []).append(test)

    def chosen(self, module: str, site: Site) -> list[str]:
        """The tests of a mutant in their order: the first case of each test function, cheap ones
        first, and so on.
        """
        if site.segment:
            reached = self.tests.get(f"{module}:{site.segment}", [])
        else:  # run at import: what reaches the module most
            count = Counter(
                t
                for key, tests in self.tests.items()
                if key.startswith(f"{module}:")
                for t in tests
            )
            reached = [t for t, n in count.items() if 2 * n >= max(count.values())]
        rank: Counter[str] = Counter()
        order = []
        for test in sorted(reached, key=lambda t: self.seconds[t]):
            function = test.partition("[")[0]
            order.append((rank[function], self.seconds[test], test))
            rank[function] += 1
        out = []
        left = self.budget
        for _, seconds, test in sorted(order):
            left -= seconds
            if left > 0 or not out:
                out.append(test)
        return out


# Runs of one mutant


class Judge:
    """Pytest's plugin that runs chosen tests until one fails."""

    def __init__(self) -> None:
        self.failed = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.outcome == "failed"

    def killer(self, items: list[pytest.Item], seconds: dict[str, float]) -> str:
        """The test that fails first, or nothing. A test that takes much too long ends the process
        by a signal.
        """
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        for signals in (signal.SIGPROF, signal.SIGALRM):
            signal.signal(signals, signal.SIG_DFL)
        for item, following in zip(items, [*items[1:], None], strict=True):
            limit = 5 + 10 * seconds.get(item.nodeid, 0.0)
            signal.setitimer(signal.ITIMER_PROF, limit)
            signal.setitimer(signal.ITIMER_REAL, 8 * limit)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self.failed:
                return item.nodeid
        return ""


class Alone(Judge):
    """The same in a process of its own, which writes the answer to a file."""

    def __init__(self, job: Path) -> None:
        super().__init__()
        self.job = job
        self.plan = json.loads(job.read_text())

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        known = {item.nodeid: item for item in session.items}
        missing = [t for t in self.plan["tests"] if t not in known]
        found = (
            missing[0]
            if missing
            else self.killer([known[t] for t in self.plan["tests"]], self.plan["seconds"])
        )
        self.job.with_suffix(".out").write_text(found)
        return True


def codes(code: types.CodeType) -> Iterator[tuple[tuple[str, int], types.CodeType]]:
    """The code of all functions in a code, by name and line."""
    yield (code.co_qualname, code.co_firstlineno), code
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from codes(inner)


class Runner(Judge):
    """Pytest's plugin that, once all tests are collected, runs mutants side by side and writes what
    became of them.
    """

    def __init__(self, work: list[tuple[str, Site]], known: Map, jobs: int, results: Path) -> None:
        super().__init__()
        self.work = work[::-1]
        self.map = known
        self.jobs = jobs
        self.results = results
        self.sound: dict[str, bool] = {}
        self.running: dict[int, dict[str, Any]] = {}
        self.functions: dict[str, list[types.FunctionType]] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items = {item.nodeid: item for item in session.items}
        for found in gc.get_objects():
            if type(found) is types.FunctionType:
                self.functions.setdefault(found.__code__.co_filename, []).append(found)
        gc.freeze()  # forks share what is there now
        with tempfile.TemporaryDirectory() as folder:
            self.folder = Path(folder)
            try:
                while self.work or self.running:
                    while self.work and len(self.running) < self.jobs:
                        module, site = self.work.pop()
                        self.start({"module": module, "site": site}, alone=not site.segment)
                    if self.running:
                        pid, status = os.wait()
                        if pid in self.running:
                            self.ended(self.running.pop(pid), status)
            finally:
                for pid in self.running:
                    os.killpg(pid, signal.SIGKILL)
        return True

    def start(self, run: dict[str, Any], alone: bool) -> None:
        """Begin a mutant, or without one the test that is said to kill it."""
        run.setdefault("since", time.monotonic())
        tests = [run["test"]] if "test" in run else self.map.chosen(run["module"], run["site"])
        tests = [t for t in tests if t in self.items and self.sound.get(t, True)]
        if not tests:
            return self.write(run, "not reached", "")
        run |= {
            "alone": alone,
            "job": self.folder / f"{run['module'].replace('/', '-')}-{run['site'].number}.json",
        }
        run["job"].with_suffix(".out").unlink(missing_ok=True)
        if pid := os.fork():
            self.running[pid] = run
            return None
        code = 3
        try:
            os.setpgid(0, 0)
            null = os.open(os.devnull, os.O_RDWR)
            for descriptor in range(3):
                os.dup2(null, descriptor)
            if alone:
                self.become(run, tests)
            if "test" in run or self.replace_code(run["module"], run["site"].number):
                found = self.killer([self.items[t] for t in tests], self.map.seconds)
                run["job"].with_suffix(".out").write_text(found)
                code = 0
        finally:
            os._exit(code)

    def replace_code(self, module: str, number: int) -> bool:
        """Give the functions of a module the code that they have with a mutation; whether that
        could be done.
        """
        name = str(SOURCE / module)
        done = False
        tree = mutated(Path(name).read_text(), number)
        new = dict(codes(compile(tree, name, "exec", dont_inherit=True)))
        for function in self.functions.get(name, []):
            code = new.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
            if code is not None and code != function.__code__:
                try:
                    function.__code__ = code
                except ValueError:  # other free variables
                    return False
                done = True
        return done

    def become(self, run: dict[str, Any], tests: list[str]) -> None:
        """Go on as another process, with the mutant in a copy of the source."""
        seconds = {t: self.map.seconds[t] for t in tests}
        run["job"].write_text(json.dumps({"tests": tests, "seconds": seconds}))
        source = str(run["job"].with_suffix(""))
        if not Path(source).exists():
            import ast

            text = (SOURCE / run["module"]).read_text()
            copy_of_source(source, {run["module"]: ast.unparse(mutated(text, run["site"].number))})
        os.execve(
            sys.executable,
            [sys.executable, __file__, "--alone", str(run["job"])],
            environment(source),
        )

    def ended(self, run: dict[str, Any], status: int) -> None:
        """What became of a mutant: written, or tried once more in another way."""
        out = run["job"].with_suffix(".out")
        killer = out.read_text() if out.exists() else None
        code = os.waitstatus_to_exitcode(status)
        if "test" in run:
            self.sound[run["test"]] = killer == ""
            return self.start({key: run[key] for key in ("module", "site", "since")}, run["again"])
        if killer:
            if self.sound.get(killer):
                return self.write(run, "killed", killer)
            return self.start({**run, "test": killer, "again": run["alone"]}, alone=False)
        # ended by a signal, or it cannot even be imported
        if killer is None and (run["alone"] or code < 0):
            return self.write(
                run, "killed", "no end" if -code in (signal.SIGPROF, signal.SIGALRM) else "crash"
            )
        if not run["alone"] and (
            killer is None or f"{run['module']}:{run['site'].segment}" in self.map.imported
        ):
            return self.start({key: run[key] for key in ("module", "site", "since")}, alone=True)
        return self.write(run, "survived", "")

    def write(self, run: dict[str, Any], verdict: str, test: str) -> None:
        """Append the result to the file of results."""
        shutil.rmtree(run.get("job", self.folder / "none").with_suffix(""), ignore_errors=True)
        line = {"module": run["module"], **run["site"]._asdict(), "verdict": verdict, "test": test}
        line["seconds"] = round(time.monotonic() - run["since"], 1)
        with self.results.open("a") as file:
            file.write(json.dumps(line) + "\n")
        site = run["site"]
        print(
            f"{verdict:12}{run['module']}:{site.line} {site.before[:50]} -> {site.after[:50]}",
            flush=True,
        )


# What came out


def summary(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """How many mutants of each area were killed, and those that were not, with the reasons that
    were found before.
    """
    former = json.loads(RECORD.read_text())["survivors"] if RECORD.exists() else []
    reasons = {
        (s["module"].rpartition("/")[2], s["before"], s["after"]): s["reason"] for s in former
    }
    areas = {
        name: {"drawn": 0, "killed": 0, "no end": 0, "crash": 0, "not reached": 0} for name in AREAS
    }
    survivors = []
    for line in lines:
        row = areas[area(line["module"])]
        row["drawn"] += 1
        row["killed"] += line["verdict"] == "killed"
        row["not reached"] += line["verdict"] == "not reached"
        if line["test"] in ("no end", "crash"):
            row[line["test"]] += 1
        if line["verdict"] != "killed":
            kept = {key: line[key] for key in ("module", "line", "function", "before", "after")}
            key = (line["module"].rpartition("/")[2], line["before"], line["after"])
            survivors.append(kept | {"reason": reasons.get(key, "")})
    return {"areas": areas, "survivors": sorted(survivors, key=lambda s: (s["module"], s["line"]))}


def report(seed: int, lines: list[dict[str, Any]]) -> None:
    """Print the table and the survivors."""
    found = summary(lines)
    print(f"\n{'area':14}" + "".join(f"{head:>13}" for head in next(iter(found["areas"].values()))))
    for name, row in found["areas"].items():
        print(f"{name:14}" + "".join(f"{n:13}" for n in row.values()))
    killed = sum(row["killed"] for row in found["areas"].values())
    print(
        f"seed {seed}: {killed} of {len(lines)} killed, {100 * killed / max(1, len(lines)):.1f} %\n"
    )
    for s in found["survivors"]:
        where = f"{s['module']}:{s['line']} {s['function']}"
        print(f"{where}: {s['before']} -> {s['after']}  ({s['reason'] or 'no reason yet'})")


def results_of(path: Path) -> list[dict[str, Any]]:
    """The results of a file; a line that was not written to its end is left out."""
    text = path.read_text() if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    return [json.loads(line) for line in whole.splitlines()]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])  # type: ignore[union-attr]
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("-n", dest="count", type=int, default=400, help="number of mutants")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    parser.add_argument("--resume", action="store_true", help="go on with what is not yet done")
    parser.add_argument(
        "--again", action="store_true", help="with --resume: survivors are run once more"
    )
    parser.add_argument(
        "--budget",
        type=float,
        default=40.0,
        help="seconds that the tests of a mutant take without it",
    )
    parser.add_argument("--only", default="", help="a pattern of modules")
    parser.add_argument(
        "--map", nargs="*", metavar="FILE", help="record what tests reach, all or these"
    )
    parser.add_argument("--write", action="store_true", help="write docs/mutants.json")
    parser.add_argument("--record", nargs="+", help=argparse.SUPPRESS)
    parser.add_argument("--alone", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    os.chdir(ROOT)
    if given.record:
        sys.exit(int(pytest.main(pytest_arguments(given.record), [Recorder()])))
    if given.alone:
        judge = Alone(given.alone)
        files = sorted({test.partition("::")[0] for test in judge.plan["tests"]})
        sys.exit(int(pytest.main(pytest_arguments(files), [judge])))
    os.environ.update(environment(str(ROOT / "src")))
    sys.path.insert(0, str(ROOT / "src"))
    if given.map is not None or not (BUILD / "map").is_dir():
        record(given.map or [], given.jobs)
    if given.map is not None:
        return
    results = BUILD / f"results-{given.seed}.jsonl"
    lines = results_of(results) if given.resume else []
    if given.again:
        lines = [line for line in lines if line["verdict"] == "killed"]
    results.write_text("".join(json.dumps(line) + "\n" for line in lines))
    drawn = [d for d in draw(given.seed, given.count) if fnmatch(d[0], given.only or "*")]
    same = {(line["module"], line["number"], line["before"], line["after"]) for line in lines}
    work = [(m, s) for m, s in drawn if (m, s.number, s.before, s.after) not in same]
    if work:
        known = Map(given.budget)
        files = sorted({t.partition("::")[0] for m, s in work for t in known.chosen(m, s)})
        pytest.main(pytest_arguments(files), [Runner(work, known, given.jobs, results)])
    lines = results_of(results)
    report(given.seed, lines)
    if given.write:
        text = json.dumps({"seed": given.seed, **summary(lines)}, indent=1, ensure_ascii=False)
        RECORD.write_text(text + "\n")


if __name__ == "__main__":
    main()
