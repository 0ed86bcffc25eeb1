"""Parallel robots: joint coordinates, all of them, for a pose of the platform, with the loops
closed.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import kempe
from kempe import spatial, tasks
from kempe.budget import Budget
from kempe.spatial import Array
from kempe_bench import peers
from kempe_bench.bench import Bench
from kempe_bench.loop_solvers import Assembler, GaussNewton, Mujoco, Pinocchio
from kempe_bench.loop_trees import Tree
from kempe_bench.loops import share, timed
from kempe_bench.timing import Grid, Row

ROBOTS = {"stewart": "pose", "delta_ss": "position", "three_rrr": "pose"}
"""The robots, and what of their platform is held."""
SIGMA = 0.3
"""Standard deviation of the noise on the coordinates of the tree from which goals are assembled, in
radians, metres."""
GOALS = 100
BATCH = 1000
TURNS = 5
PLATFORM = "platform"
ONE = "Kempe, one call"
MANY = "Kempe, batch"
FORMULA = "formula, legs only"
SUCCESS = "success, %"
MEDIAN = "median, us"


class Goals:
    """The poses of the platform at closed configurations, as plain products have them, and what of
    them is held.
    """

    def __init__(self, tree: Tree, what: str):
        self.tree = tree
        self.number = tree.numbers[PLATFORM]
        planar = tree.system.dim == 2
        self.rows = np.array([0, 1, 2] if what == "position" else [0, 1, 5] if planar else range(6))
        self.X = np.empty((0, 4, 4))

    def of(self, q: Array) -> Array:
        """Poses (n, 4, 4) of the platform at q (n, nq), which are kept."""
        self.X = self.at(self.tree.coordinates(q))
        return self.X

    def at(self, x: Array) -> Array:
        """Poses (n, 4, 4) of the platform at the tree's coordinates x (n, nx)."""
        return self.tree.poses(x)[self.number]

    def error(self, X: Array, goal: Array) -> Array:
        """What is missed (..., rows) at X (..., 4, 4) in axes of the world."""
        w = spatial.log_so3(X[..., :3, :3] @ np.swapaxes(goal[..., :3, :3], -1, -2))
        return np.concatenate([X[..., :3, 3] - goal[..., :3, 3], w], axis=-1)[..., self.rows]

    def opening(self, x: Array) -> Array:
        """How far (n,) x (n, nx) are from closed loops and from the goals that are kept."""
        return np.maximum(
            self.tree.opening(x), np.linalg.norm(self.error(self.at(x), self.X), axis=-1)
        )


class Kempe(Assembler):
    """Kempe, by its one public call, from the posture 'closed'."""

    tolerance = 1e-6

    def __init__(self, goals: Goals):
        self.goals = goals
        self.system = goals.tree.system
        self.home = self.system.q("closed")

    def ready(self, q: Array) -> Sequence[Array]:
        """The goals."""
        return list(self.goals.of(q))

    def held(self, X: Array) -> tasks.Task:
        """The task for goals X (..., 4, 4)."""
        if len(self.goals.rows) == 3 and self.system.dim == 3:
            return tasks.Position(PLATFORM, X[..., :3, 3])
        return tasks.Pose(PLATFORM, X)

    def call(self, guess: Array, /) -> Any:
        """One public call, task and all."""
        return self.system.ik(self.held(guess), start=self.home)

    def opening(self, answers: Sequence[Any]) -> Array:
        """Infinite where Kempe says that it did not succeed."""
        q = np.array([a.q for a in answers])
        opening = self.goals.opening(self.goals.tree.coordinates(q))
        return np.where([a.success for a in answers], opening, np.inf)


class Holding(GaussNewton):
    """Gauss-Newton on the loops and on the pose of the platform together, from the posture
    'closed'.
    """

    tolerance = 1e-6

    def __init__(self, goals: Goals):
        super().__init__(goals.tree)  # pyright: ignore[reportCallIssue]
        self.goals = goals
        self.goal = np.eye(4)
        self.home = super().ready(goals.tree.system.q("closed")[None])[0]

    def platform(self) -> tuple[Array, Array]:
        """Pose (4, 4) of the platform, and its Jacobian (6, nv) in axes of the world."""
        raise NotImplementedError

    def equations(self, x: Array) -> tuple[Array, Array]:
        """Those of the loops, then those of the platform."""
        r, J = super().equations(x)
        X, move = self.platform()
        e = self.goals.error(X, self.goal)
        return np.concatenate([r, e]), np.concatenate([J, move[self.goals.rows]])

    def ready(self, q: Array) -> Sequence[Array]:
        """The goals."""
        return list(self.goals.of(q))

    def call(self, guess: Array, /) -> Array:
        """Coordinates found."""
        self.goal = guess
        return super().call(self.home)

    def opening(self, answers: Sequence[Array]) -> Array:
        """Of the cut joints and of the platform."""
        return self.goals.opening(np.array(answers)[:, self.place])


class MujocoHolding(Holding, Mujoco):
    """MuJoCo's equality constraints and its Jacobian of the platform."""

    def __init__(self, goals: Goals):
        super().__init__(goals)
        self.number = self.model.body(PLATFORM).id
        self.after = goals.tree.limbs[goals.number - 1].after
        self.jacobian = peers.module("mujoco").mj_jac
        self.move = np.empty((6, self.nv))

    def platform(self) -> tuple[Array, Array]:
        """Read off MuJoCo's data, whose bodies end before the last placement."""
        X = (
            spatial.pose(self.data.xmat[self.number].reshape(3, 3), self.data.xpos[self.number])
            @ self.after
        )
        self.jacobian(self.model, self.data, self.move[:3], self.move[3:], X[:3, 3], self.number)
        return X, self.move


class PinocchioHolding(Holding, Pinocchio):
    """Pinocchio's frames, that of the platform too."""

    def __init__(self, goals: Goals):
        super().__init__(goals)
        self.number = self.model.getFrameId(PLATFORM)

    def platform(self) -> tuple[Array, Array]:
        """Read off Pinocchio's data."""
        X = self.update(self.model, self.data, self.number).homogeneous
        return X, self.read(self.model, self.data, self.number, self.axes)


def legs(tree: Tree, X: Array) -> Array:
    """Lengths (n, 6) of the legs of a Stewart platform at poses X (n, 4, 4), by the distance of
    their ends' centres.
    """
    low = np.array([tree.links[f"U{i}"].X_a[:3, 3] for i in range(1, 7)])
    high = np.array([tree.links[f"S{i}"].X_a[:3, 3] for i in range(1, 7)])
    return np.linalg.norm(
        high @ np.swapaxes(X[:, :3, :3], -1, -2) + X[:, None, :3, 3] - low, axis=-1
    )


def platforms(bench: Bench) -> Grid:
    """Parallel robots: all joint coordinates for poses of the platform, from the posture 'closed'."""

    table = Grid("Parallel robots: pose of the platform to all joint coordinates", "robot")
    for name, what in ROBOTS.items():
        bench.say(f"  {name}")
        _robot(table, bench, Tree(kempe.load(name)), what)
    table.rows.sort(key=lambda row: row.call.endswith(MEDIAN))
    worst = min(
        row.value for row in table.rows if row.library in (ONE, MANY) and row.call.endswith(SUCCESS)
    )
    table.at_least("Kempe reaches all goals of each robot", worst, 100.0)
    table.remarks += [
        "goals: the platform at configurations closed near the posture 'closed' with normal noise "
        f"of {SIGMA:g} on all coordinates of the spanning tree; all start from that posture; "
        "delta_ss: position only",
        "success: loops closed and goal held to 1e-6 m and rad by plain matrix products",
        "MuJoCo, Pinocchio: Gauss-Newton written in numpy on their equations of loops and "
        "platform, without limits",
        f"{FORMULA}: distances of the ends of a Stewart platform's legs, in numpy, without the "
        "passive joints",
        f"batch and formula: {BATCH:,} goals in one call, one thread; the others {GOALS}",
    ]
    return table


def _robot(table: Grid, bench: Bench, tree: Tree, what: str) -> None:
    system = tree.system
    goals = Goals(tree, what)
    closed = system.assemble(start=tree.guesses(SIGMA, BATCH))
    q = closed.q[closed.success]
    solver = Kempe(goals)
    solvers: dict[str, Assembler] = {ONE: solver}
    if "mujoco" in bench.versions:
        solvers["MuJoCo"] = MujocoHolding(goals)
    if "pin" in bench.versions:
        solvers["Pinocchio"] = PinocchioHolding(goals)
    success = {library: _success(s, q[:GOALS]) for library, s in solvers.items()}
    times = timed(solvers, q[:GOALS])
    wanted = solver.held(goals.of(q))
    answer, times[MANY] = _batch(
        lambda: system.ik(wanted, start=solver.home, budget=Budget(threads=1)), len(q)
    )
    opening = np.where(answer.success, goals.opening(tree.coordinates(answer.q)), np.inf)
    success[MANY] = share(opening, solver.tolerance)
    if system.name == "stewart":
        lengths, times[FORMULA] = _batch(lambda: legs(tree, goals.X), len(q))
        # a leg turned round has a negative one
        own = np.abs(q[:, [tree.columns[f"leg{i}"] for i in range(1, 7)]])
        success[FORMULA] = share(np.abs(lengths - own).max(axis=-1), solver.tolerance)
    for library in (ONE, MANY, *(x for x in solvers if x != ONE), FORMULA):
        if library in success:
            table.rows.append(Row(library, f"{system.name}: {SUCCESS}", success[library]))
        if library in times:
            table.rows.append(Row(library, f"{system.name}: {MEDIAN}", *times[library]))


def _success(solver: Assembler, q: Array) -> float:
    """Percent of the goals that a solver reaches."""
    return share(solver.opening([solver.call(goal) for goal in solver.ready(q)]), solver.tolerance)


def _batch(call: Callable[[], Any], n: int) -> tuple[Any, tuple[float, float]]:
    """What a call answers, and microseconds of one of its n results: the median turn, the best."""
    turns = []
    answer = None
    for _ in range(TURNS):
        start = time.perf_counter_ns()
        answer = call()
        turns.append(1e-3 * (time.perf_counter_ns() - start) / n)
    return answer, (statistics.median(turns), min(turns))
