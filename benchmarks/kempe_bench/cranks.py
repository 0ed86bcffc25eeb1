"""Mechanisms of many positions or many loops: a crank's turn in closed form, and long rows of
four-bars.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from kempe.description.mechanism import Mechanism
from kempe.system import System
from kempe_bench.bench import Bench
from kempe_bench.crank_peers import DRIVES, Drive, angles, linkage
from kempe_bench.loop_solvers import SparseMujoco
from kempe_bench.loop_trees import Tree
from kempe_bench.timing import Case, Grid, cases, measure

STEPS = 10_000
SINGLE_STEPS = 200
"""Steps of the crank in one call, and of a loop in Python."""
ROWS = (10, 100, 1000)
NOISE = 0.1
SWEEP = "Kempe, assemble, array, branch"
ONE = "Kempe, assembler, one angle"
"""Names of Kempe's columns: calls that users make, none from inside."""

_PYLINKAGE_LOOP = """
reset()
for _ in step(iterations=steps):
    pass
"""


def dyads(bench: Bench) -> Grid:
    """Steps of a crank, by the calls that users of each library make."""
    import kempe

    table = Grid("Dyads in closed form: time of a step of the crank", "us")
    compiled = importlib.util.find_spec("numba") is not None
    for name, drive in DRIVES.items():
        system = kempe.load(name)
        names = turn(system, drive)
        timed = [
            Case(
                SWEEP,
                name,
                "system.assemble({crank: values}, branch=branch, budget=budget)",
                names,
                STEPS,
            ),
            Case(ONE, name, "bound({crank: one}, start)", names),
        ]
        if "pylinkage" in bench.versions:
            reported = linkage(system, STEPS)
            names = {
                "reset": reported.reset,
                "fast": reported.model.step_fast,
                "step": reported.model.step,
            }
            if compiled:
                code = "reset(); fast(iterations=steps)"
                timed.append(
                    Case("pylinkage, step_fast", name, code, names | {"steps": STEPS}, STEPS)
                )
            timed.append(
                Case(
                    "pylinkage, step",
                    name,
                    _PYLINKAGE_LOOP,
                    names | {"steps": SINGLE_STEPS},
                    SINGLE_STEPS,
                )
            )
        table.rows += measure(timed, 1e6)
        table.at_most(
            f"{name}, array of angles, at most 0.3 us a step", table.best(SWEEP, name), 0.3
        )
    if "pylinkage" in bench.versions:
        table.remarks.append(
            "pylinkage has its numba, without which step_fast is Python"
            if compiled
            else "numba is missing, without which pylinkage's step_fast is Python: it is not measured"
        )
    table.remarks += [
        f"{STEPS:,} steps a call, one thread; step: a loop in Python; one angle: from a start one "
        "radian away at most. Kempe answers joint angles, pylinkage points",
        "peaucellier: the crank swings from -1.2 to 1.2, since it cannot turn fully",
    ]
    return table


def turn(system: System, drive: Drive) -> dict[str, Any]:
    """What the calls for a turn of the crank need, by the names in their code: angles, a start and
    its branch.
    """
    import kempe

    start = system.assemble({drive.crank: drive.start}, start=system.q("closed"))
    plan = system.loops.closed_form((drive.crank,))
    assert plan, f"{system.name} is made of dyads"
    values = angles(drive, STEPS)
    return {
        "system": system,
        "crank": drive.crank,
        "values": values,
        "start": start.q,
        "one": drive.start + 0.1 * (drive.end - drive.start),
        "bound": system.loops.assembler((drive.crank,)),
        "branch": "".join("-" if sign < 0 else "+" for sign in plan.branch_of(start.q)),
        "budget": kempe.Budget(threads=1),
    }


def row(bench: Bench) -> Grid:
    """Rows of four-bars whose first crank is known, each solved as one system."""
    table = Grid("Row of four-bars in one solve, by their number", "ms")
    for n in ROWS:
        system = four_bars(n)
        q = system.configuration_space.integrate(system.neutral, _noise(system))
        call = "row.assemble({'A0': 0.2}, start=q)"
        line = f"{n:,}"
        timed = cases("Kempe", {"row": system, "q": q}, (f"{n:,}", call))
        answer = system.assemble({"A0": 0.2}, start=q)
        if not answer:
            table.remarks.append(f"{line} four-bars: Kempe did not close: {answer.status}")
        if "mujoco" in bench.versions:
            peer = SparseMujoco(Tree(system), ("A0",))
            q = q.copy()
            q[system.coordinate_names.index("A0")] = 0.2
            guess = peer.ready(q[None])[0]
            if peer.opening([peer.call(guess)])[0] <= peer.tolerance:
                timed += cases(
                    "MuJoCo, SciPy", {"solve": peer.call, "guess": guess}, (line, "solve(guess)")
                )
            else:
                table.remarks.append(
                    f"{line} four-bars: Gauss-Newton on MuJoCo's constraints did not close"
                )
        table.rows += measure(timed, 1e3)
    table.at_most(f"{ROWS[-1]:,} four-bars under 20 ms", table.best("Kempe", f"{ROWS[-1]:,}"), 20)
    table.remarks.append(
        f"from {NOISE} rad of noise, the first crank known; MuJoCo: Gauss-Newton on its sparse "
        "constraints, with the sparse factorisation of SciPy"
    )
    return table


def _noise(system: System) -> np.ndarray:
    return NOISE * np.random.default_rng(0).normal(size=system.nv)


def scissor_lift(n: int) -> System:
    """A scissor lift of n stages: crossed bars of 1 m, the foot of one on a rail; one freedom."""
    out = Mechanism(f"scissor lift of {n} stages", dim=2)
    for k in range(n):
        out.body(f"a{k}")
        out.body(f"b{k}")
    out.body("foot")
    out.revolute("base", out.ground, "a0")
    out.prismatic("rail", out.ground, "foot", axis=(1, 0))
    out.revolute("hinge", "foot", "b0")
    for k in range(n):
        out.revolute(f"middle{k}", f"a{k}", f"b{k}", at=(0.5, 0), child_at=(0.5, 0))
        if k + 1 < n:
            out.revolute(f"right{k}", f"a{k}", f"b{k + 1}", at=(1, 0))
            out.revolute(f"left{k}", f"b{k}", f"a{k + 1}", at=(1, 0))
    return out.build()


def four_bars(n: int) -> System:
    """A row of n four-bars: n + 1 cranks on the ground, neighbours joined by couplers; one freedom."""
    out = Mechanism(f"row of {n} four-bars", dim=2)
    for i in range(n + 1):
        out.body(f"crank{i}")
        out.revolute(f"A{i}", out.ground, f"crank{i}", at=(i, 0))
    for i in range(n):
        out.body(f"coupler{i}")
        out.revolute(f"B{i}", f"crank{i}", f"coupler{i}", at=(0, 0.5))
        out.revolute(f"C{i}", f"coupler{i}", f"crank{i + 1}", at=(1, 0), child_at=(0, 0.5))
    return out.build()
