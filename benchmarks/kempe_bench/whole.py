"""The inverse model of whole bodies: feet and hands of humanoids held, without and with the centre
of mass.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import kempe
from kempe import tasks
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.numeric import SLACK, percent, rows_of, sort
from kempe_bench.numeric_worker import FEWEST, Case, answers
from kempe_bench.timing import Grid, Row
from kempe_bench.whole_peers import BODIES, COARSE, FINE, KEMPE, LIMIT
from kempe_bench.whole_robots import BASE, HUMANOIDS, MOVED, PART, TURNED, Body, poses

GOALS = 300
"""Goals of a robot; a slow library gets as many of them as fit into its share of the time."""
SHARE = 1.0
"""Seconds of a library in each line."""
FOUND = 99.0
FOUND_WITH_MASS = 98.0
"""Percent of the goals that Kempe is to reach at least, without and with the centre of mass."""
FIGURES = SUCCESS, MEDIAN, P99 = "success, %", "median, ms", "99th percentile, ms"
BATCH = "Kempe, batch"
Draw = Callable[[Body, int, np.random.Generator], Array]


@dataclass(frozen=True)
class Line:
    """What is required in one line of the table: of which robot, with which errors, from how many
    starts.
    """

    robot: str
    body: Body
    mass: bool
    tolerance: tuple[float, float]
    once: bool

    @property
    def title(self) -> str:
        """How the line begins."""
        centre = " and mass" if self.mass else ""
        return (
            f"{self.robot}{centre}, {self.tolerance[0]:g}, "
            f"{'one start' if self.once else 'restarts'}"
        )

    def reached(self, q: Array, goals: Array) -> np.ndarray:
        """Which rows of q (n, 7 + joints) hold their goals (n, k, 4, 4) inside the limits, by
        Pinocchio.

        NaN rows do not. The worst distance, that of the centre of mass included, and the worst
        angle count.
        """
        linear, angular = self.tolerance
        X, centre = poses(self.body, np.where(np.isfinite(q), q, self.body.start))
        wanted = goals[:, : X.shape[1]]
        distance = np.linalg.norm(X[..., :3, 3] - wanted[..., :3, 3], axis=-1).max(axis=-1)
        if self.mass:
            distance = np.maximum(distance, np.linalg.norm(centre - goals[:, -1, :3, 3], axis=-1))
        # ||A - B|| = 2 sqrt(2) sin(angle / 2) for rotations: exact where the trace is not
        chord = np.linalg.norm(X[..., :3, :3] - wanted[..., :3, :3], axis=(-2, -1)).max(
            axis=-1
        ) / np.sqrt(8.0)
        angle = 2.0 * np.arcsin(np.minimum(chord, 1.0))
        lower, upper = self.body.limits.T
        joints = q[:, BASE:]
        inside = ((joints >= lower - SLACK) & (joints <= upper + SLACK)).all(axis=-1)
        unit = np.abs(np.linalg.norm(q[:, 3:BASE], axis=-1) - 1.0) <= SLACK
        return (distance <= linear) & (angle <= angular) & inside & unit


def goals_of(body: Body, q: Array, mass: bool) -> Array:
    """Goals (n, k, 4, 4) that q (n, 7 + joints) holds: of the frames, then a pose at the centre of
    mass.
    """
    X, centre = poses(body, q)
    if not mass:
        return X
    last = np.broadcast_to(np.eye(4), (len(q), 1, 4, 4)).copy()
    last[:, 0, :3, 3] = centre
    return np.concatenate([X, last], axis=1)


# ---- the sections


def anywhere(bench: Bench) -> Grid | None:
    """Both feet and both hands of humanoids, any joint angles, without and with the centre of mass."""
    return _section(bench, "joints anywhere inside the limits", Body.anywhere, near=False)


def standing(bench: Bench) -> Grid | None:
    """The same, goals made nearer to the start, which all are given."""
    return _section(
        bench,
        f"joints within {100 * PART:g} % of their range about the start",
        Body.standing,
        near=True,
    )


def _section(bench: Bench, title: str, draw: Draw, near: bool) -> Grid | None:
    if importlib.util.find_spec("pinocchio") is None:
        bench.say("  skipped: Pinocchio makes the goals and judges; pip install pin")
        return None
    table = Grid(f"Whole body, feet and hands held: {title}", "robot, largest error")
    n = max(bench.targets or GOALS, FEWEST)
    with tempfile.TemporaryDirectory() as folder:
        lines = _lines(Path(folder))
        if not lines:
            bench.say("  skipped: no robot is described; pip install example-robot-data")
            return None
        goals = [goals_of(x.body, draw(x.body, n, np.random.default_rng(1)), x.mass) for x in lines]
        tried = _measured(table, bench, Path(folder), lines, goals, near)
    libraries = [BODIES[KEMPE][0], BATCH, *(title for title, _ in BODIES.values())]
    sort(table, [line.title for line in lines], FIGURES, libraries)
    _judged(table, lines)
    table.remarks += _remarks(tried, near)
    return table


def _lines(folder: Path) -> list[Line]:
    """All lines whose robot's description is installed."""
    bodies = {robot.title: robot.body(folder) for robot in HUMANOIDS}
    return [
        Line(title, body, mass, tolerance, once)
        for title, body in bodies.items()
        if body is not None
        for mass in (False, True)
        for tolerance in (COARSE, FINE)
        for once in (False, True)
    ]


def _measured(
    table: Grid, bench: Bench, folder: Path, lines: list[Line], goals: list[Array], near: bool
) -> dict[str, list[int]]:
    """Fill the table; how many goals each library was given, line by line."""
    cases = [
        _case(folder / str(i), line, wanted, near)
        for i, (line, wanted) in enumerate(zip(lines, goals, strict=True))
    ]
    tried: dict[str, list[int]] = {}
    for line, wanted in zip(lines, goals, strict=True):
        if not line.once:
            table.rows += _batch(line, wanted, near)
    for package, (library, made) in BODIES.items():
        if package != KEMPE and package not in bench.versions:
            continue
        bench.say(f"  {library}")
        some = [i for i, line in enumerate(lines) if line.tolerance == COARSE or not made.coarse]
        for i, answer in zip(some, answers(package, [cases[i] for i in some]), strict=True):
            hit = lines[i].reached(answer.q, goals[i][: len(answer.q)])
            if len(hit) >= FEWEST:
                table.rows += rows_of(
                    library, lines[i].title, hit, 1e-6 * answer.nanoseconds, FIGURES
                )
                tried.setdefault(library, []).append(len(hit))
            if answer.trouble:
                table.remarks.append(f"{library} fails on {lines[i].title}: {answer.trouble[:100]}")
    return tried


def _case(folder: Path, line: Line, goals: Array, near: bool) -> Case:
    folder.mkdir()
    np.save(folder / "targets.npy", goals)
    np.save(
        folder / "starts.npy", np.broadcast_to(line.body.start, (len(goals), len(line.body.start)))
    )
    requested = {
        "frames": line.body.frames,
        "mass": line.mass,
        "tolerance": line.tolerance,
        "once": line.once,
    }
    return Case(str(line.body.file), str(folder), near or line.once, SHARE, requested)


def _batch(line: Line, goals: Array, near: bool) -> list[Row]:
    """Kempe's answer to all goals in one call in one thread: success, milliseconds a goal."""
    held: list[tasks.Task] = [
        tasks.Pose(name, goals[:, i]) for i, name in enumerate(line.body.frames)
    ]
    if line.mass:
        held.append(tasks.CentreOfMass(goals[:, -1, :3, 3]))
    turns = []
    q = np.empty(0)
    seed = line.body.start if near else None
    for _ in range(3):
        start = time.perf_counter()
        answer = line.body.system.ik(
            held, start=seed, tolerance=line.tolerance, budget=kempe.Budget(threads=1)
        )
        turns.append(1e3 * (time.perf_counter() - start) / len(goals))
        q = np.where(answer.success[:, None], answer.q, np.nan)
    success = percent(line.reached(q, goals))
    return [
        Row(BATCH, f"{line.title}: {SUCCESS}", success),
        Row(BATCH, f"{line.title}: {MEDIAN}", float(np.median(turns))),
    ]


def _judged(table: Grid, lines: list[Line]) -> None:
    """The goals: of the lines with restarts, the worst."""
    for mass, least, what in (
        (False, FOUND, "feet and hands"),
        (True, FOUND_WITH_MASS, "with the centre of mass"),
    ):
        calls = {
            f"{line.title}: {SUCCESS}" for line in lines if line.mass == mass and not line.once
        }
        worst = min(
            r.value for r in table.rows if r.library in ("Kempe", BATCH) and r.call in calls
        )
        table.at_least(f"{what}, with restarts, Kempe reaches at least {least:g} %", worst, least)


def _remarks(tried: dict[str, list[int]], near: bool) -> list[str]:
    """How it was done, and what is missing."""
    coarse, fine = ("{:g} m and {:g} rad".format(*tolerance) for tolerance in (COARSE, FINE))
    out = [
        "goals: poses of both feet and both hands, and the centre of mass, of random "
        f"configurations, the base up to {MOVED:g} m and {TURNED:g} rad from the origin along and "
        "about each axis; by Pinocchio",
        f"success, rounded down: worst errors at most {coarse}, or {fine}, limits respected, by "
        "Pinocchio",
        "one start: all from the base at the origin and joints at zero, or the limit next to it; "
        "restarts: "
        + ("the same start first" if near else "the same start first, but Kempe chooses its own")
        + f"; the others, which have no restarts, start again at random until {1e3 * LIMIT:g} ms are over",
        "Pinocchio: damped Newton steps written in numpy on its Jacobians; mink, pink: full steps "
        "by daqp; Drake: SNOPT, coarser errors only, as it bounds the square of an angle",
        "times are of one call from Python, success or not; batch: all goals in one call, one "
        "thread, ms a goal",
        "each library runs in a process of its own, one thread, the same URDF file for all; goals, "
        "fewest in a line: " + ", ".join(f"{name} {min(n)}" for name, n in tried.items()),
        "placo, which needs Pinocchio 3, cannot be installed beside the others",
    ]
    absent = [p for p in BODIES if p != KEMPE and importlib.util.find_spec(peers.PEERS[p]) is None]
    return [*out, f"not installed: pip install {' '.join(absent)}"] if absent else out
