"""Ways on constraint manifolds: planar loops of bars from one configuration to another, beside
OMPL.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Grid, Row

if TYPE_CHECKING:
    from kempe.spatial import Array

LOOPS = {"five bars": (0.9, 1.0, 0.9, 0.8), "six bars": (0.9, 0.5, 1.0, 0.6, 0.8),
         "eight bars": (0.9, 0.5, 0.7, 0.4, 0.6, 0.5, 0.8)}  # fmt: skip
"""Lengths of the moving bars; the pins of the ground are 1.1 apart. No three bars are long: all
configurations join."""
GROUND = 1.1
PAIRS = 20
LIMIT = 5.0
STEP = 0.25
"""Longest step in radians, by the largest difference of a coordinate, of a way that counts."""
CLOSED = 1e-3
"""Opening in units of length up to which a configuration of a way counts as closed: OMPL's
tolerance is 1e-4."""

Way = Callable[["Array", "Array"], "Array | None"]


def planar(bench: Bench) -> Grid:
    """Share of pairs that are joined within the time limit, and the median time of those."""
    table = Grid("Ways between random closed configurations of planar loops", "% or ms")
    for name, lengths in LOOPS.items():
        bench.say(f"  {name}")
        system = loop_of(lengths)
        q = system.configuration_space.sample(2 * PAIRS, 1).q[:, : len(lengths)]
        pairs = list(zip(q[:PAIRS], q[PAIRS:], strict=True))
        ways: dict[str, Way] = {"Kempe": lambda a, b, s=system: of_kempe(s, a, b)}
        if "ompl" in bench.versions:
            ways |= {
                f"OMPL, {kind}": lambda a, b, k=kind, x=lengths: of_ompl(k, x, a, b)
                for kind in ("projection", "atlas", "tangent bundle")
            }
        for library, way in ways.items():
            times = [
                t
                for t in (timed(way, np.asarray(lengths), *pair) for pair in pairs)
                if t is not None
            ]
            table.rows.append(Row(library, f"{name}: success, %", 100.0 * len(times) / PAIRS))
            if times:
                table.rows.append(
                    Row(library, f"{name}: median, ms", 1e3 * statistics.median(times))
                )
    least = min(r.value for r in table.rows if r.library == "Kempe" and "%" in r.call)
    table.at_least("all loops, success in %", least, 100.0)
    table.remarks += [
        f"{PAIRS} pairs each, at most {LIMIT:g} s a pair; a way counts if its steps are at most "
        f"{STEP:g} rad and all its configurations close to {CLOSED:g}",
        "OMPL: RRT-Connect with the defaults of its constrained state spaces; the constraint and "
        "its Jacobian are some lines of numpy, called from C++ for each configuration, which is "
        "most of its time; its coordinates are numbers within a turn, those of Kempe angles",
    ]
    return table


def timed(way: Way, lengths: Array, a: Array, b: Array) -> float | None:
    """Seconds that a way took, or None where there is none that counts."""
    begin = time.perf_counter()
    q = way(a, b)
    took = time.perf_counter() - begin
    if q is None or took > 1.2 * LIMIT:
        return None
    steps = (np.diff(np.vstack([a, q, b]), axis=0) + np.pi) % (2 * np.pi) - np.pi
    return (
        took
        if np.abs(steps).max() <= STEP and np.abs(opening(lengths, q)).max() <= CLOSED
        else None
    )


def opening(lengths: Array, q: Array) -> Array:
    """Where the chain of bars ends, less where it should (..., 2)."""
    turned = np.cumsum(q, axis=-1)
    return np.stack([np.cos(turned) @ lengths - GROUND, np.sin(turned) @ lengths], axis=-1)


# ---- Kempe


def loop_of(lengths: tuple[float, ...]) -> Any:
    """Bars in a loop; coordinates are the angles from each bar to the next."""
    import kempe

    m = kempe.Mechanism("loop", dim=2)
    before = m.ground
    at = (0.0, 0.0)
    for k, length in enumerate(lengths):
        bar = m.body(f"bar {k}")
        m.revolute(f"q{k}", before, bar, at=at)
        before = bar
        at = (length, 0.0)
    m.revolute("last", before, m.ground, at=at, child_at=(GROUND, 0.0), cut=True)
    return m.build()


def of_kempe(system: Any, a: Array, b: Array) -> Array | None:
    """A way by `configuration_space.path`; the last coordinate of the system is the angle at the
    pin that closes it.
    """
    import kempe

    ends = [np.append(q, -q.sum()) for q in (a, b)]
    found = system.configuration_space.path(*ends, budget=kempe.Budget(time_limit=LIMIT))
    return found.q[:, : len(a)] if found else None


# ---- OMPL


def of_ompl(kind: str, lengths: tuple[float, ...], a: Array, b: Array) -> Array | None:
    """A way by one of OMPL's constrained state spaces."""
    base = peers.module("ompl.base")
    geometric = peers.module("ompl.geometric")
    bars = np.asarray(lengths)
    n = len(lengths)

    class Closure(base.Constraint):
        def function(self, x: Array, out: Array) -> None:
            out[:] = opening(bars, x)

        def jacobian(self, x: Array, out: Array) -> None:
            turned = np.cumsum(x)
            out[0] = np.cumsum((-bars * np.sin(turned))[::-1])[::-1]
            out[1] = np.cumsum((bars * np.cos(turned))[::-1])[::-1]

    spaces = {
        "projection": ("ProjectedStateSpace", "ConstrainedSpaceInformation"),
        "atlas": ("AtlasStateSpace", "ConstrainedSpaceInformation"),
        "tangent bundle": ("TangentBundleStateSpace", "TangentBundleSpaceInformation"),
    }
    space_name, information_name = spaces[kind]
    around = base.RealVectorStateSpace(n)
    bounds = base.RealVectorBounds(n)
    bounds.setLow(-np.pi)
    bounds.setHigh(np.pi)
    around.setBounds(bounds)
    closure = Closure(n, 2)
    space = getattr(base, space_name)(around, closure)
    information = getattr(base, information_name)(space)
    setup = geometric.SimpleSetup(information)
    setup.setStateValidityChecker(lambda state: True)
    ends = []
    for q in (a, b):
        state = information.allocState()
        state.copy((q + np.pi) % (2 * np.pi) - np.pi)
        if kind != "projection":
            space.anchorChart(state)
        ends.append(state)
    setup.setStartAndGoalStates(*ends, 0.01)
    setup.setPlanner(geometric.RRTConnect(information))
    setup.setup()
    setup.solve(LIMIT)
    if not setup.haveExactSolutionPath():
        return None
    path = setup.getSolutionPath()
    path.interpolate()
    return np.array([[path.getState(k)[i] for i in range(n)] for k in range(path.getStateCount())])
