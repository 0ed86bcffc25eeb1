"""Inverse model against the peers: how often a reachable pose is reached, and how long that takes."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import kempe
from kempe import spatial
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.timing import Row, Table

TARGETS = 2_000
BATCH = 10_000
SLOW_TARGETS = 20
"""Targets given to a library that needs milliseconds for one."""
TOLERANCE = 1e-6


def single(bench: Bench) -> Table:
    """Reachable targets, no seed, one a call and as one batch."""
    arm = bench.arm
    targets = arm.pose(arm.random(BATCH))
    robot = arm.system
    frame = arm.frame
    solvers: dict[str, tuple[Callable[[np.ndarray], np.ndarray], int]] = {
        "Kempe": (lambda X: robot.ik(X, frame).q, TARGETS)
    }
    if "roboticstoolbox-python" in bench.versions:
        ets = peers.toolbox_arm(arm)
        # its residual is half the squared norm of the error
        solvers["roboticstoolbox (C++ ik_LM)"] = (
            lambda X: ets.ik_LM(X, tol=0.5 * TOLERANCE**2).q,
            TARGETS,
        )
    if "ikpy" in bench.versions:
        solvers["ikpy"] = (_ikpy(arm), SLOW_TARGETS)
    found, times = _turns(solvers, targets)
    table = Table(
        f"Inverse: {frame} of {robot.name}, reachable targets, no seed, errors below 1e-6",
        "us or %",
        ratios=False,
    )
    for name, (_, n) in solvers.items():
        _rows(
            table,
            name,
            f"{n:,} calls",
            100.0 * float(np.mean(reached(arm, found[name], targets[:n]))),
            np.array(times[name]),
        )
    _batch(table, arm, targets)
    table.remarks.append(
        "success: errors within 1e-6 m and 1e-6 rad and limits respected, judged by plain matrix "
        "products"
    )
    return table


def _ikpy(arm: peers.Arm) -> Callable[[np.ndarray], np.ndarray]:
    chain = peers.ikpy_arm(arm)
    middle = np.array([0.0, *(np.mean(link.limits) for link in arm.links), 0.0])
    return lambda X: chain.inverse_kinematics_frame(
        X, initial_position=middle, orientation_mode="all"
    )[1:-1]


def _turns(
    solvers: dict[str, tuple[Callable[[np.ndarray], np.ndarray], int]], targets: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, list[int]]]:
    """Configurations and nanoseconds of all solvers, target by target in turns."""
    found = {name: [] for name in solvers}
    times: dict[str, list[int]] = {name: [] for name in solvers}
    for solve, _ in solvers.values():
        solve(targets[0])
    for i in range(max(n for _, n in solvers.values())):
        for name, (solve, n) in solvers.items():
            if i < n:
                start = time.perf_counter_ns()
                q = solve(targets[i])
                times[name].append(time.perf_counter_ns() - start)
                found[name].append(q)
    return {name: np.array(rows, dtype=float) for name, rows in found.items()}, times


def _rows(table: Table, library: str, call: str, success: float, nanoseconds: np.ndarray) -> None:
    us = nanoseconds * 1e-3
    table.rows += [
        Row(library, f"{call}: success, %", float(success)),
        Row(library, f"{call}: median, us", float(np.median(us))),
        Row(library, f"{call}: 99th percentile, us", float(np.percentile(us, 99))),
    ]


def _batch(table: Table, arm: peers.Arm, targets: np.ndarray) -> None:
    for threads in (1, 2):
        turns = []
        for _ in range(3):
            start = time.perf_counter_ns()
            q = arm.system.ik(targets, arm.frame, budget=kempe.Budget(threads=threads)).q
            turns.append((time.perf_counter_ns() - start) / len(targets) * 1e-3)
        call = f"one batch of {len(targets):,}, {threads} thread{'s' * (threads > 1)}"
        table.rows += [
            Row("Kempe", f"{call}: success, %", 100.0 * float(np.mean(reached(arm, q, targets)))),
            Row("Kempe", f"{call}: us a target", float(np.median(turns))),
        ]


def reached(arm: peers.Arm, q: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Which rows of q (n, number of joints) reach their targets (n, 4, 4), inside the limits."""
    X = arm.pose(q)
    position = np.linalg.norm(X[:, :3, 3] - targets[:, :3, 3], axis=-1)
    turn = np.linalg.norm(
        spatial.log_so3(np.swapaxes(X[:, :3, :3], -1, -2) @ targets[:, :3, :3]), axis=-1
    )
    inside = ((q >= arm.limits[:, 0] - 1e-12) & (q <= arm.limits[:, 1] + 1e-12)).all(axis=-1)
    return (position <= 1.0001 * TOLERANCE) & (turn <= 1.0001 * TOLERANCE) & inside
