"""Assembly of closed loops against the peers: how long it takes from a guess nearby, and how often
it succeeds.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

import kempe
from kempe.spatial import Array
from kempe_bench.bench import Bench
from kempe_bench.loop_peers import Drake, Exudyn
from kempe_bench.loop_solvers import Assembler, Mujoco, Pinocchio
from kempe_bench.loop_trees import Tree
from kempe_bench.timing import Grid, Row

MECHANISMS = (
    "four_bar",
    "slider_crank",
    "double_parallelogram",
    "bennett",
    "sarrus",
    "stewart",
    "peaucellier",
    "jansen",
    "three_rrr",
    "delta_ss",
    "bricard_trihedral",
)
"""The mechanisms, each from its posture 'closed'."""
KNOWN = {"four_bar": ("A",), "stewart": tuple(f"leg{i}" for i in range(1, 7))}
"""What is given in the lines with known inputs: the crank, the lengths of the legs."""
UNFIT = {"bennett", "sarrus", "bricard_trihedral"}
"""Mechanisms that are not given to Exudyn's static solver."""
TIMED = (0.1, 1.0)
RATES = (0.1, 0.3, 1.0)
"""Standard deviations of the guesses whose assembly is timed, and counted."""
GUESSES = 100
SLOW_GUESSES = 10
BATCH = 1000
TURNS = 5
CALL = "Kempe, one call"
NEAREST = "Kempe, nearest"
BOUND = "Kempe, bound"
MANY = "Kempe, batch"
ONE_START = "Kempe, starts=1"
USUAL = "Kempe"
"""Names of Kempe's columns."""


def how() -> list[str]:
    """How the libraries are used, and what they are not given."""
    return [
        "guesses: the closed posture with normal noise on all coordinates of the spanning tree, in "
        "radians and metres",
        "closed: 1e-8 m and rad by plain matrix products (Drake 1e-5, as SNOPT scales its "
        "equations)",
        "MuJoCo, Pinocchio: Gauss-Newton written in numpy on their equality constraints and frame "
        "placements; Drake: inverse kinematics by SNOPT, without building the program; Exudyn: "
        "static solver, full-pivot factorisation",
        "Exudyn is not given the overconstrained spatial mechanisms, where this factorisation "
        "seldom gets over the redundant equations, nor known inputs",
        f"Drake and Exudyn: {SLOW_GUESSES} guesses, the others {GUESSES}",
    ]


class Kempe(Assembler):
    """Kempe in one of its ways to be called."""

    def __init__(self, tree: Tree, call: Callable[[Array], Any]):
        self.tree = tree
        self.call = call

    def ready(self, q: Array) -> Sequence[Array]:
        """The configurations."""
        return list(q)

    def opening(self, answers: Sequence[Any]) -> Array:
        """Of the cut joints; infinite where Kempe says that it did not succeed."""
        q = np.array([a.q for a in answers])
        return np.where(
            [a.success for a in answers], self.tree.opening(self.tree.coordinates(q)), np.inf
        )


def assembly(bench: Bench) -> Grid:
    """Closed configurations from guesses nearby: one call, bound, and as a batch."""
    import kempe

    table = Grid("Assembly of closed loops from a guess: time of a call, by noise in radians", "us")
    for name in MECHANISMS:
        tree = Tree(kempe.load(name))
        bench.say(f"  {name}")
        for sigma in TIMED:
            _line(table, bench, tree, f"{name}, {sigma:g}", sigma, ())
        if name in KNOWN:
            _line(table, bench, tree, known_line(name), TIMED[0], KNOWN[name])
    _goals(table)
    table.remarks += [
        "nearest: with prefer='nearest', the closed configuration nearest to the guess; all others "
        "find any near it",
        f"bound: a prepared assembler; batch: {BATCH:,} guesses in one call, one thread",
        *how(),
    ]
    return table


def known_line(name: str) -> str:
    """How the line of a mechanism with known inputs is called."""
    return f"{name}, {TIMED[0]:g}, {'legs' if len(KNOWN[name]) > 1 else 'crank'} known"


def _line(
    table: Grid, bench: Bench, tree: Tree, line: str, sigma: float, known: tuple[str, ...]
) -> None:
    system = tree.system
    home = tree.system.q("closed")
    given = {n: float(home[tree.columns[n]]) for n in known}
    bound = system.loops.assembler(known)
    solvers: dict[str, Assembler] = {
        CALL: Kempe(tree, lambda q: system.assemble(given, start=q)),
        NEAREST: Kempe(tree, lambda q: system.assemble(given, start=q, prefer="nearest")),
        BOUND: Kempe(tree, lambda q: bound(given, q)),
        **peers_of(bench, tree, known),
    }
    guesses = tree.guesses(sigma, BATCH, known)
    rows = timed(solvers, guesses[:GUESSES])
    spent = []
    for _ in range(TURNS + 1):
        start = time.perf_counter_ns()
        bound(given, guesses, budget=kempe.Budget(threads=1))
        spent.append((time.perf_counter_ns() - start) * 1e-3 / len(guesses))
    rows[MANY] = (statistics.median(spent[1:]), min(spent[1:]))
    for library in (CALL, NEAREST, BOUND, MANY, *solvers):
        if library in rows:
            table.rows.append(Row(library, line, *rows.pop(library)))


def peers_of(bench: Bench, tree: Tree, known: Iterable[str] = ()) -> dict[str, Assembler]:
    """The other libraries that take part, each given the mechanism."""
    out: dict[str, Assembler] = {}
    if "mujoco" in bench.versions:
        out["MuJoCo"] = Mujoco(tree, known)
    if "pin" in bench.versions:
        out["Pinocchio"] = Pinocchio(tree, known)
    if "drake" in bench.versions:
        out["Drake"] = Drake(tree, known)
    if "exudyn" in bench.versions and not known and tree.system.name not in UNFIT:
        out["Exudyn"] = Exudyn(tree)
    return out


def timed(solvers: dict[str, Assembler], q: Array) -> dict[str, tuple[float, float]]:
    """Microseconds of one call to each solver, those that close: the median, and that of the best
    turn.

    The solvers take turns; a turn goes through all guesses q (n, nq), with garbage collection off.
    """
    ready = {name: s.ready(q[:SLOW_GUESSES] if s.slow else q) for name, s in solvers.items()}
    closed = {}
    for name, s in solvers.items():
        closed[name] = s.opening([s.call(guess) for guess in ready[name]]) <= s.tolerance
    turns: dict[str, list[float]] = {name: [] for name in solvers}
    for _ in range(TURNS):
        for name, s in solvers.items():
            if closed[name].any():
                turns[name].append(
                    float(np.median(_turn(s.call, ready[name])[closed[name]])) * 1e-3
                )
    return {name: (statistics.median(t), min(t)) for name, t in turns.items() if t}


def _turn(call: Callable[[Any], Any], guesses: Sequence[Any]) -> np.ndarray:
    """Nanoseconds (n,) of the calls."""
    clock = time.perf_counter_ns
    spent = []
    collecting = gc.isenabled()
    gc.disable()
    try:
        for guess in guesses:
            start = clock()
            call(guess)
            spent.append(clock() - start)
    finally:
        if collecting:
            gc.enable()
    return np.array(spent)


def _goals(table: Grid) -> None:
    for name, title, one, many, times in (
        ("four_bar", "four-bar", 10, 2, 4),
        ("stewart", "Stewart", 30, 12, 2),
    ):
        line = f"{name}, {TIMED[0]:g}"
        known = known_line(name)
        fast = table.best(CALL, line)
        table.at_most(
            f"{title} with known inputs, one call, at most {one} us", table.best(CALL, known), one
        )
        table.at_most(f"{title}, one call, at most {one} us", fast, one)
        table.at_most(
            f"{title} with known inputs, batch, at most {many} us", table.best(MANY, known), many
        )
        table.at_most(f"{title}, batch, at most {many} us", table.best(MANY, line), many)
        other = table.value("MuJoCo", line)
        mine = table.value(CALL, line)
        if other is not None and mine is not None:
            text = (
                f"{title}, at least {times} times as fast as Gauss-Newton on MuJoCo's constraints"
            )
            table.at_least(text, other / mine, times)


def success(bench: Bench) -> Grid:
    """How many of the guesses close, near and far."""
    import kempe

    table = Grid("Assembly of closed loops from a guess: how many close, by noise in radians", "%")
    for name in MECHANISMS:
        tree = Tree(kempe.load(name))
        system = tree.system
        solvers = peers_of(bench, tree)
        bench.say(f"  {name}")
        for sigma in RATES:
            q = tree.guesses(sigma, BATCH)
            line = f"{name}, {sigma:g}"
            for library, starts in ((USUAL, _starts()), (ONE_START, 1)):
                answer = system.assemble(start=q, budget=kempe.Budget(starts=starts))
                opening = np.where(answer.success, tree.opening(tree.coordinates(answer.q)), np.inf)
                table.rows.append(Row(library, line, share(opening, Assembler.tolerance)))
            for library, s in solvers.items():
                guesses = s.ready(q[: SLOW_GUESSES if s.slow else GUESSES])
                table.rows.append(
                    Row(library, line, share(s.opening([s.call(g) for g in guesses]), s.tolerance))
                )
    least = min(row.value for row in table.rows if row.library == USUAL)
    table.at_least("each mechanism, all noises, at least 95 %", least, 95)
    table.remarks += [
        f"Kempe: {BATCH:,} guesses each, with the usual {_starts()} starts, and with one start",
        *how(),
    ]
    return table


def _starts() -> int:
    from kempe.assemble.bound import STARTS

    return STARTS


def share(opening: Array, tolerance: float) -> float:
    """Percent of openings (n,) that count as closed."""
    return 100.0 * float(np.mean(opening <= tolerance))
