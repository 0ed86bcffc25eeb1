"""The numerical inverse model against all libraries that have one: how often a target is reached,
how long it takes.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import kempe
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.numeric_peers import KEMPE, LIMIT, SOLVERS, TOLERANCE
from kempe_bench.numeric_robots import ROBOTS, TIP
from kempe_bench.numeric_worker import FEWEST, Case, answers
from kempe_bench.timing import Grid, Row

TARGETS = 2_000
"""Targets of a robot; a slow library gets as many of them as fit into its share of the time."""
SHARE = 0.25
SMALL_SHARE = 0.1
"""Seconds of a library on a robot: for targets anywhere, and for the other sets, without the slow
libraries."""
OFF = 0.05
"""How far each joint of a near start is from the configuration that the target was made from [rad,
m]."""
SLACK = 1e-9
"""How far beyond a limit an answer may be [rad, m]."""
FIGURES = SUCCESS, MEDIAN, P99 = "success, %", "median, us", "99th percentile, us"
BATCH = "Kempe, batch"
Draw = Callable[[peers.Arm, int], tuple[Array, Array]]


def anywhere(arm: peers.Arm, n: int) -> tuple[Array, Array]:
    """Configurations (n, number of joints) uniform inside the limits, and starts that have nothing
    to do with them.
    """
    random = np.random.default_rng(1)
    return _uniform(arm, n, random), _uniform(arm, n, random)


def at_limits(arm: peers.Arm, n: int) -> tuple[Array, Array]:
    """As `anywhere`, but half of the joints, chosen anew for each, are exactly at a limit."""
    q, starts = anywhere(arm, n)
    random = np.random.default_rng(2)
    order = np.argsort(random.random(q.shape), axis=-1)
    side = random.integers(0, 2, q.shape)
    ends = np.where(side, arm.limits[:, 1], arm.limits[:, 0])
    return np.where(order < len(arm.links) // 2, ends, q), starts


def nearby(arm: peers.Arm, n: int) -> tuple[Array, Array]:
    """Configurations as in `anywhere`, and starts in which each joint is `OFF` away, inside the
    limits.
    """
    q, _ = anywhere(arm, n)
    side = np.random.default_rng(3).choice([-OFF, OFF], q.shape)
    return q, np.clip(q + side, *arm.limits.T)


def _uniform(arm: peers.Arm, n: int, random: np.random.Generator) -> Array:
    return random.uniform(arm.limits[:, 0], arm.limits[:, 1], (n, len(arm.links)))


# ---- the judge


def poses(arm: peers.Arm, q: Array) -> Array:
    """Poses (n, 4, 4) of the chain's end for q (n, number of joints): Pinocchio's, or plain
    products without it.
    """
    if importlib.util.find_spec("pinocchio") is None:
        return arm.pose(q)
    pin = peers.module("pinocchio")
    model, data, frame = peers.pinocchio_arm(arm)
    out = np.empty((len(q), 4, 4))
    for row, X in zip(np.ascontiguousarray(q), out, strict=True):
        pin.forwardKinematics(model, data, row)
        X[:] = pin.updateFramePlacement(model, data, frame).homogeneous
    return out


def reached(arm: peers.Arm, q: Array, targets: Array) -> np.ndarray:
    """Which rows of q (n, number of joints) reach their targets (n, 4, 4) inside the limits; NaN
    rows do not.

    The distance of the positions and the angle between the orientations are at most `TOLERANCE`.
    """
    X = poses(arm, np.nan_to_num(q))
    distance = np.linalg.norm(X[:, :3, 3] - targets[:, :3, 3], axis=-1)
    # ||A - B|| = 2 sqrt(2) sin(angle / 2) for rotations: exact where the trace is not
    chord = np.linalg.norm(X[:, :3, :3] - targets[:, :3, :3], axis=(-2, -1)) / np.sqrt(8.0)
    angle = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    inside = ((q >= arm.limits[:, 0] - SLACK) & (q <= arm.limits[:, 1] + SLACK)).all(axis=-1)
    return (distance <= TOLERANCE) & (angle <= TOLERANCE) & inside


# ---- the sections


def random(bench: Bench) -> Grid:
    """Reachable targets anywhere, 13 chains, all libraries with a numerical inverse model."""
    return _section(bench, "reachable targets anywhere", anywhere, SHARE, near=False)


def limits(bench: Bench) -> Grid:
    """The same with half of the joints exactly at their limits, the hardest targets."""
    return _section(bench, "half of the joints at their limits", at_limits, SMALL_SHARE, near=False)


def warm(bench: Bench) -> Grid:
    """The same from starts near the answer."""
    return _section(bench, f"starts {OFF:g} rad off each joint", nearby, SMALL_SHARE, near=True)


def _section(bench: Bench, title: str, draw: Draw, share: float, near: bool) -> Grid:
    table = Grid(f"Numerical inverse model: {title}, errors below {TOLERANCE:g}", "robot")
    n = max(bench.targets or TARGETS, FEWEST)
    seconds = share * n / TARGETS
    packages = [p for p in SOLVERS if p == KEMPE or p in bench.versions]
    packages = [p for p in packages if share == SHARE or not SOLVERS[p][1].slow]
    tried: dict[str, list[int]] = {SOLVERS[p][0]: [] for p in packages}
    with tempfile.TemporaryDirectory() as folder:
        arms, missing = _arms(Path(folder))
        cases = {}
        targets = {}
        for name, arm in arms.items():
            q, starts = draw(arm, n)
            targets[name] = poses(arm, q)
            cases[name] = _case(Path(folder) / name, arm, targets[name], starts, near, seconds)
            table.rows += _batch(name, arm, targets[name], starts if near else None)
        for package in packages:
            library = SOLVERS[package][0]
            bench.say(f"  {library}")
            found = answers(package, list(cases.values()))
            for (name, arm), answer in zip(arms.items(), found, strict=True):
                hit = reached(arm, answer.q, targets[name][: len(answer.q)])
                if len(hit) >= FEWEST:
                    table.rows += rows_of(library, name, hit, 1e-3 * answer.nanoseconds, FIGURES)
                    tried[library].append(len(hit))
                if answer.trouble:
                    table.remarks.append(f"{library} fails on {name}: {answer.trouble[:100]}")
    sort(
        table,
        list(arms),
        FIGURES,
        [SOLVERS[KEMPE][0], BATCH, *(title for title, _ in SOLVERS.values())],
    )
    worst = min(
        r.value for r in table.rows if r.library in ("Kempe", BATCH) and r.call.endswith(SUCCESS)
    )
    goal = 99.9 if draw is at_limits else 100.0
    table.at_least(f"Kempe reaches at least {goal:g} % of the targets of each robot", worst, goal)
    table.remarks += _remarks(bench, tried, missing, near)
    return table


def _arms(folder: Path) -> tuple[dict[str, peers.Arm], list[str]]:
    """The chains by title, and the titles of those whose descriptions are not installed."""
    arms = {}
    missing = []
    for robot in ROBOTS:
        arm = robot.arm(folder)
        if arm is None:
            missing.append(robot.title)
        else:
            arms[robot.title] = arm
    return arms, missing


def _case(
    folder: Path, arm: peers.Arm, targets: Array, starts: Array, near: bool, seconds: float
) -> Case:
    folder.mkdir()
    np.save(folder / "targets.npy", targets)
    np.save(folder / "starts.npy", starts)
    return Case(str(arm.file), str(folder), near, seconds)


def _batch(name: str, arm: peers.Arm, targets: Array, starts: Array | None) -> list[Row]:
    """Kempe's answer to all targets in one call in one thread: success, microseconds a target."""
    turns = []
    q = targets
    for _ in range(3):
        start = time.perf_counter()
        q = arm.system.ik(targets, TIP, start=starts, budget=kempe.Budget(threads=1)).q
        turns.append(1e6 * (time.perf_counter() - start) / len(targets))
    success = percent(reached(arm, q, targets))
    return [
        Row(BATCH, f"{name}: {SUCCESS}", success),
        Row(BATCH, f"{name}: {MEDIAN}", float(np.median(turns))),
    ]


def percent(hit: np.ndarray) -> float:
    """Successes, rounded down: a single failure is seen."""
    return 0.1 * (1_000 * int(np.sum(hit)) // len(hit))


def rows_of(
    library: str, name: str, hit: np.ndarray, times: Array, figures: tuple[str, str, str]
) -> list[Row]:
    """How often a library succeeds, and median and 99th percentile of its times, under their
    figures' names.
    """
    values = (percent(hit), np.median(times), np.percentile(times, 99))
    return [
        Row(library, f"{name}: {figure}", float(value))
        for figure, value in zip(figures, values, strict=True)
    ]


def sort(
    table: Grid, names: list[str], figures: tuple[str, str, str], libraries: list[str]
) -> None:
    """Figure by figure, the names below each other; the libraries in their order."""
    calls = [f"{name}: {figure}" for figure in figures for name in names]
    table.rows.sort(key=lambda row: (calls.index(row.call), libraries.index(row.library)))


def _remarks(
    bench: Bench, tried: dict[str, list[int]], missing: list[str], near: bool
) -> list[str]:
    """How it was done, and what is missing."""
    judge = (
        "Pinocchio"
        if importlib.util.find_spec("pinocchio") is not None
        else "plain matrix products"
    )
    start = "" if near else "; starts are random, but Kempe and roboticstoolbox choose their own"
    out = [
        f"success, rounded down: distance and angle at most {TOLERANCE:g} m and rad, limits "
        f"respected, by {judge}",
        f"times are of one call from Python, success or not, at most {1e3 * LIMIT:g} ms and what "
        f"is in work then; batch: all targets in one call, one thread, us a target{start}",
        "Klampt, mink, pink, placo, Drake and ikpy have no restarts: they start again at random "
        "until time is over; Drake and ikpy are given targets anywhere only",
        "each library runs in a process of its own; TRAC-IK in two threads; the same URDF file of "
        "the chain alone for all; targets, fewest on a robot: "
        + ", ".join(f"{name} {min(n):,}" for name, n in tried.items() if n),
    ]
    absent = [p for p in SOLVERS if p != KEMPE and importlib.util.find_spec(peers.PEERS[p]) is None]
    if absent:
        alone = "; placo only in an environment without the others, as it needs Pinocchio 3" * (
            "placo" in absent
        )
        out.append(f"not installed: pip install {' '.join(absent)}{alone}")
    if missing:
        out.append(f"no description of {', '.join(missing)}: pip install example-robot-data")
    return out
