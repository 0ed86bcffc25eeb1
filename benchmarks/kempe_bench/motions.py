"""Motions of closed loops, and how the work grows with the number of loops."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from kempe_bench import cranks
from kempe_bench.bench import Bench
from kempe_bench.timing import Case, Grid, Row, measure

SAMPLES = 361
SWING = 0.5
"""Amplitude of the input, in radians: no mechanism meets a dead point within it."""
MECHANISMS = {"four_bar": "A", "slider_crank": "A", "bennett": "q1", "jansen": None, "rssr": None}
"""Shipped mechanisms and their drivers; None: the first coordinate."""
LONG = 30
"""Four-bars in a row that is driven."""
STAGES = 10
"""Stages of the scissor lift, in whose flat states very many branches meet."""
TURNS = 3


def motions(bench: Bench) -> Grid:
    """Time of a sample of `drive`, and of a point of `trace`."""
    import kempe

    table = Grid(
        "Motions of closed loops: time of a sample of drive, and of a point of trace", "ms"
    )
    systems: list[tuple[str, Any, str, np.ndarray]] = []
    for name, driver in MECHANISMS.items():
        system = kempe.load(name)
        systems.append((name, system, driver or system.coordinate_names[0], system.q("closed")))
    row = cranks.four_bars(LONG)
    systems.append((f"row of {LONG} four-bars", row, "A0", row.assemble({"A0": 0.2}).q))
    lift = cranks.scissor_lift(STAGES)
    guess = {"base": 0.9} | {f"middle{k}": math.pi - 1.8 for k in range(STAGES)}
    systems.append((lift.name, lift, "base", lift.assemble({"base": 0.9}, start=guess).q))
    for name, system, driver, start in systems:
        bench.say(f"  {name}")
        first = float(start[system.coordinate_names.index(driver)])
        values = first + SWING * np.sin(np.linspace(0.0, 2.0 * math.pi, SAMPLES))
        names = {"system": system, "start": start, "driver": driver, "values": values}
        call = "system.drive({driver: values}, start=start)"
        timed = [Case("Kempe, drive", name, call, names, SAMPLES)]
        if system is not row:
            points = len(system.trace(driver, start=start))
            call = "system.trace(driver, start=start)"
            timed.append(Case("Kempe, trace", name, call, names, points))
        table.rows += measure(timed, 1e3)
    table.at_most(
        "four_bar, a sample of drive, at most 0.02 ms", table.best("Kempe, drive", "four_bar"), 0.02
    )
    table.at_most(
        f"row of {LONG} four-bars, a sample of drive, at most 0.5 ms",
        table.best("Kempe, drive", "row"),
        0.5,
    )
    table.remarks.append(
        f"drive: {SAMPLES} samples of a swing by {SWING} rad; trace: the whole branch"
    )
    return table


def chains(bench: Bench) -> Grid:
    """Rows of four-bars by their number: Jacobian through the loops, degrees of freedom."""
    table = Grid("Rows of four-bars by their number: time of a call", "ms")
    spent: dict[str, list[float]] = {}
    for n in cranks.ROWS:
        bench.say(f"  {n}")
        system = cranks.four_bars(n)
        q = system.assemble({"A0": 0.2}).q
        calls: dict[str, Callable[[], Any]] = {
            "Kempe, loops.jacobian": lambda s=system, q=q, n=n: s.loops.jacobian(
                q, ["A0"], [f"A{n}"]
            ),
            "Kempe, mobility": lambda s=system, q=q: s.mobility(q),
        }
        for name, call in calls.items():
            call()
            turns = []
            for _ in range(TURNS):
                start = time.perf_counter()
                call()
                turns.append(1e3 * (time.perf_counter() - start))
            spent.setdefault(name, []).append(min(turns))
            table.rows.append(Row(name, f"{n:,}", sorted(turns)[TURNS // 2], min(turns)))
    for name, times in spent.items():
        power = math.log(times[-1] / times[-2]) / math.log(cranks.ROWS[-1] / cranks.ROWS[-2])
        table.rows.append(
            Row(name, f"exponent from {cranks.ROWS[-2]:,} to {cranks.ROWS[-1]:,}", power)
        )
    table.at_most(
        "1,000 four-bars, loops.jacobian, at most 60 ms",
        table.best("Kempe, loops.jacobian", f"{cranks.ROWS[-1]:,}"),
        60,
    )
    table.at_most(
        "1,000 four-bars, mobility, at most 2,000 ms",
        table.best("Kempe, mobility", f"{cranks.ROWS[-1]:,}"),
        2000,
    )
    table.remarks.append(
        "the first crank known; loops.jacobian: of the last crank by the first; mobility: with the "
        "report on redundancy. The second call of each: names and loops are packed"
    )
    return table
