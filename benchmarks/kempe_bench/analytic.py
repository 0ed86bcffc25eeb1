"""All solutions of the inverse model against the peers: time of a pose, completeness, wrong
answers, preparation.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import kempe
from kempe.errors import UnsupportedError
from kempe.spatial import Array
from kempe_bench import analytic_arms, analytic_peers
from kempe_bench.analytic_arms import (
    ANY,
    ARMS,
    FRAME,
    LOCKED,
    OFFSET,
    PARALLEL,
    WRIST,
    Arm,
    Verdict,
    judged,
)
from kempe_bench.analytic_peers import Solver
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Grid, Row, measure

TIMED = 200
SLOW_TIMED = 20
"""Poses that are timed one by one in a turn, and for libraries that need long."""
JUDGED = 2_000
SLOW_JUDGED = 100
"""Poses whose answers of the other libraries are judged."""
BATCH = 10_000
GENERAL_BATCH = 1_000
"""Poses of Kempe's batches, with and without closed form; all are judged."""
PREPARATIONS = 5
LONG = 0.2
"""How often a robot is prepared, and seconds from which twice is enough."""
PATIENT = ("Puma 560",)
"""Arms that roboticstoolbox is given: it derives equations for seconds to minutes."""
ONE = "one call, us"
MANY = "batch, us a pose"
FOUND = "found, %"
WRONG = "wrong answers to 1,000 poses"
PREPARED = "preparation, ms"
ONE_RATIO = "one call, times Kempe's"
MANY_RATIO = "fastest way, times Kempe's batch"
"""Lines of an arm."""


class Kempe(Solver):
    """Kempe: a fresh system and its plan are the preparation."""

    batches = True

    def __init__(self, arm: Arm, scale: float = 1.0):
        self.chain = arm.chain
        self.free = arm.free
        self.system = arm.build(scale)
        self.options: dict[str, Any] = {"fixed": arm.held} if arm.held else {}
        self.system.inverse.plan(FRAME, **self.options)

    def call(self, target: Any, /) -> Any:
        """One public call."""
        return self.system.ik_all(target, FRAME, **self.options)

    def read(self, answer: Any) -> Array:
        """The joints that are not held."""
        return answer.q[:, self.free]

    def call_batch(self, targets: Any, /) -> Any:
        """One public call in one thread."""
        return self.system.ik_all(targets, FRAME, **self.options, budget=kempe.Budget(threads=1))

    def read_batch(self, answer: Any) -> Sequence[Array]:
        """The joints that are not held, of the solutions that exist."""
        return [q[mask][:, self.free] for q, mask in zip(answer.q, answer.mask, strict=True)]


def closed(bench: Bench) -> Grid:
    """All solutions, arms with a closed form: time of a pose, and which solutions are found."""
    table = Grid(
        "All solutions of the inverse model: spherical wrist, and three parallel axes", "arm"
    )
    arms = [arm for arm in ARMS if arm.family in (WRIST, PARALLEL)]
    _fill(table, bench, arms, BATCH)
    _goals(table, arms, "closed form", many=0.4, one=5.0)
    table.remarks += how()
    return table


def general(bench: Bench) -> Grid:
    """All solutions, arms without a spherical wrist or three parallel axes, and arms of seven
    joints with one held.
    """
    table = Grid("All solutions of the inverse model: any six turns, and one of seven held", "arm")
    arms = [arm for arm in ARMS if arm.family in (OFFSET, ANY, LOCKED)]
    _fill(table, bench, arms, GENERAL_BATCH)
    _goals(table, [a for a in arms if a.family != LOCKED], "general 6R", many=120.0, one=150.0)
    _goals(
        table,
        [a for a in arms if a.family == LOCKED],
        "7R with a joint held",
        many=120.0,
        one=150.0,
    )
    table.remarks += [
        *how(),
        "EAIK, ik-geo, OPW: what is missing they refuse, or solve by a search that finds no answer "
        "to 1e-6 (ik-geo)",
        "ssik: offset wrists are modules that come with it, judged by poses of their own "
        "description of the arm; a random, a calibrated arm and the held Panda it would prepare "
        "for a minute or more, as would roboticstoolbox",
    ]
    return table


def how() -> list[str]:
    """How the libraries are used and judged."""
    return [
        "poses of configurations uniform in a full turn of each joint; found: the configuration "
        f"itself is among the answers, to {analytic_arms.TOLERANCE:g} rad; wrong: an answer misses "
        f"the pose by more than {analytic_arms.TOLERANCE:g} m or rad by plain matrix products",
        "limits are ignored by all; answers that a library itself marks as least squares are left "
        "out",
        f"Kempe's batch: {BATCH:,} or {GENERAL_BATCH:,} poses in one call, one thread, all judged; "
        f"others: {JUDGED:,} poses judged, {SLOW_JUDGED} where a pose takes long",
        "batches: EAIK IK_batched, one worker, its answers not yet read; OPW reach, which adds "
        "margins; fastest way: the better of a library's batch and its single call",
        "preparation: Kempe a fresh System and its plan; ssik writing and loading a module; "
        "imports are not counted",
    ]


def _fill(table: Grid, bench: Bench, arms: Sequence[Arm], batch: int) -> None:
    for arm in arms:
        bench.say(f"  {arm.title}")
        solvers = {}
        ready = {}
        for library, make in _makers(bench, arm).items():
            try:
                solvers[library], ready[library] = _prepared(make)
            except UnsupportedError as error:
                bench.say(f"    {library}: {error}")
        times = _timed(solvers, batch)
        verdicts = {name: _verdict(s, batch) for name, s in solvers.items()}
        for library in solvers:
            one = times[library, ONE]
            many = times.get((library, MANY))
            verdict = verdicts[library]
            table.rows.append(Row(library, f"{arm.title}: {ONE}", one.value, one.best))
            if many is not None:
                table.rows.append(Row(library, f"{arm.title}: {MANY}", many.value, many.best))
            table.rows += [
                Row(library, f"{arm.title}: {FOUND}", 100.0 * verdict.found / verdict.poses),
                Row(library, f"{arm.title}: {WRONG}", 1e3 * verdict.wrong / verdict.poses),
            ]
            if library == "Kempe" or not arm.prebuilt:
                table.rows.append(Row(library, f"{arm.title}: {PREPARED}", *ready[library]))
        _ratios(table, arm)
    order = [
        f"{a.title}: {x}"
        for a in arms
        for x in (ONE, MANY, ONE_RATIO, MANY_RATIO, FOUND, WRONG, PREPARED)
    ]
    libraries = list(dict.fromkeys(["Kempe", *(row.library for row in table.rows)]))
    table.rows.sort(key=lambda row: (order.index(row.call), libraries.index(row.library)))


def _makers(bench: Bench, arm: Arm) -> dict[str, Callable[[int], Solver]]:
    """What prepares the arm for each library, for the how manieth time."""
    # another size each time, so that nothing remembered from the last one can be used
    out: dict[str, Callable[[int], Solver]] = {"Kempe": lambda i: Kempe(arm, 1.0 + 1e-3 * i)}
    for package, (library, solver) in analytic_peers.SOLVERS.items():
        late = solver is analytic_peers.Toolbox and arm.title not in PATIENT
        if package in bench.versions and not late:
            out[library] = _maker(solver, arm)
    return out


def _maker(solver: Callable[[Arm], Solver], arm: Arm) -> Callable[[int], Solver]:
    return lambda i: solver(arm)


def _prepared(make: Callable[[int], Solver]) -> tuple[Solver, tuple[float, float]]:
    """The solver, and milliseconds that its preparation takes: the median, and the best."""
    start = time.perf_counter()
    solver = make(0)
    once = time.perf_counter() - start
    spent = []
    for i in range(1 if once > LONG else PREPARATIONS):
        start = time.perf_counter()
        make(i + 1)
        spent.append(1e3 * (time.perf_counter() - start))
    return solver, (statistics.median(spent), min(spent))


def _timed(solvers: dict[str, Solver], batch: int) -> dict[tuple[str, str], Row]:
    """Microseconds of a pose by library and way, all in turns."""
    cases = []
    for library, s in solvers.items():
        q = analytic_arms.random(SLOW_TIMED if s.slow else TIMED)
        targets = s.ready(s.chain.pose(q))
        names = {"call": s.call, "targets": targets}
        cases.append(Case(library, ONE, "for x in targets: call(x)", names, len(q)))
        if s.batches:
            q = analytic_arms.random(batch)
            names = {"call": s.call_batch, "targets": s.ready_batch(s.chain.pose(q))}
            cases.append(Case(library, MANY, "call(targets)", names, len(q)))
    return {(row.library, row.call): row for row in measure(cases, 1e6)}


def _verdict(solver: Solver, batch: int) -> Verdict:
    """Kempe's batch and single calls are judged, of the others single calls."""
    own = isinstance(solver, Kempe)
    q = analytic_arms.random(TIMED if own else SLOW_JUDGED if solver.slow else JUDGED)
    answers = [solver.read(solver.call(x)) for x in solver.ready(solver.chain.pose(q))]
    if own:
        more = analytic_arms.random(batch)
        q = np.concatenate([q, more])
        answers += solver.read_batch(solver.call_batch(solver.ready_batch(solver.chain.pose(more))))
    return judged(solver.chain, q, answers)


def _ratios(table: Grid, arm: Arm) -> None:
    one, many = (table.value("Kempe", f"{arm.title}: {x}") for x in (ONE, MANY))
    for library in dict.fromkeys(row.library for row in table.rows):
        ways = [table.value(library, f"{arm.title}: {x}") for x in (ONE, MANY)]
        known = [x for x in ways if x is not None]
        if library != "Kempe" and known and one and many:
            table.rows.append(Row(library, f"{arm.title}: {ONE_RATIO}", known[0] / one))
            table.rows.append(Row(library, f"{arm.title}: {MANY_RATIO}", min(known) / many))


def _goals(table: Grid, arms: Sequence[Arm], what: str, many: float, one: float) -> None:
    """Goals that the worst of the arms has to meet; times by their best turn."""

    def all_of(line: str) -> list[float]:
        return [x for arm in arms if (x := table.best("Kempe", f"{arm.title}: {line}")) is not None]

    table.at_most(f"{what}, batch, at most {many:g} us a pose", max(all_of(MANY)), many)
    table.at_most(f"{what}, one call, at most {one:g} us", max(all_of(ONE)), one)
    table.at_most(f"{what}, preparation of a robot, at most 50 ms", max(all_of(PREPARED)), 50.0)
    table.at_least(f"{what}, found, 100 %", min(all_of(FOUND)), 100.0)
    table.at_most(f"{what}, wrong answers, none", max(all_of(WRONG)), 0.0)
