"""The inverse geometric model, numerically: a configuration in which a frame of a tree reaches a target."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.errors import InputError, NoSolutionError
from kempe.kernels import search
from kempe.kernels.job import ANSWER, LINEAR, STATUS
from kempe.kernels.layout import HAS_QUATERNION
from kempe.kinematics.configuration import as_q
from kempe.kinematics.parallel import over_chunks
from kempe.solvers.arguments import deadline, seed_number, start_count, step_count, tolerances
from kempe.solvers.chain import Chain, chain_of, inside, obstacle
from kempe.solvers.solution import BAD_INPUT, NOT_FOUND, OUT_OF_REACH, OUT_OF_TIME, SOLVED, Solution
from kempe.solvers.targets import (
    TASKS,
    Z_AXIS,
    axis_of,
    check_particle,
    frame_of,
    in_plane,
    points_along,
    targets_of,
    task_of,
)
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

STARTS = 250
"""Starts before a target is given up. Most succeed with the first; one in a hundred thousand needs more than 100."""
ITERATIONS = 40
"""Steps of one start; those that converge need 5 to 9, few as many as 40, and hopeless ones are given up before."""
TOLERANCE = (1e-6, 1e-6)
"""Largest position error [m] and rotation angle [rad] of a success."""
CHUNK, SERIAL_BELOW = 256, 1024


@dataclass(frozen=True, eq=False)
class Task:
    """What was asked of the solver: kept with the answer, so that it can say why it failed."""

    system: System
    frame: str
    targets: Array = field(repr=False)
    name: str
    """One of `TASKS`."""
    axis: tuple[float, float, float]
    """The direction of the tool that is pointed, for tasks that point one."""
    tolerance: tuple[float, float]
    starts: int
    rng: int
    chain: Chain = field(repr=False)
    """The chain of the frame, its z axis turned to `axis`."""
    iterations: int = ITERATIONS
    time_limit: float | None = None
    end: float = math.inf
    """When the time is up, by `time.monotonic`."""

    @property
    def mask(self) -> tuple[int, ...]:
        """Which errors [linear; angular] in the frame of the tip count, its z axis being `axis`."""
        return TASKS[self.name]


def ik(
    system: System, target: ArrayLike, frame: FrameLike, seed: Any = None, *, task: str | None = None,
    axis: ArrayLike = Z_AXIS, position_only: bool = False, tolerance: float | tuple[float, float] = TOLERANCE,
    starts: int = STARTS, iterations: int = ITERATIONS, time_limit: float | None = None,
    rng: int | np.random.Generator = 0, threads: int | None = None, throw: bool = False, method: str = "numeric",
) -> Solution:  # fmt: skip
    """A configuration in which `frame` reaches `target` (the inverse geometric model), always inside the limits.

    `target` is a pose (..., 4, 4) in the ground frame (in planar systems also (..., 3, 3)), or a position (..., 3)
    (in planar systems also (..., 2)). `task` says what of it counts: "pose", "position" (also by `position_only`),
    "orientation", "direction" (of the tool's `axis`), "position_axis" (both). `tolerance` is the largest position error
    [m] and rotation angle [rad]. `seed` (nq,) or (..., nq), or a dict by name, is the first start; what the chain does
    not move keeps its value there, else the neutral one, inside the limits.

    Starts are tried in order, the seed or the middle of the limits first, up to `starts` of them, the others drawn from
    `rng`; the answer is that of the first start that reaches the target. So the same arguments give the same answer,
    whatever the `threads`, and a seed that leads to the target is preferred to all else. `iterations` are the steps of
    one start, at most. `time_limit` [s] is for the whole call, looked at after each 32 starts (so their sequence is
    another one): an answer that it ended says so, and is the only one that depends on the machine.

    The answer says by `success` and `status` whether it was reached and if not, why; `throw=True` raises
    `NoSolutionError` instead. A NaN in a single target is an `InputError`, in a batch it gives a NaN row. A frame that
    moves with closed loops, or with relations of several coordinates, is a case for `kempe.solvers.tasks.reach`, which
    holds these: the answer then is `Reached`.

    `method`: "numeric", damped least squares with an active set of limits and restarts (Sugihara, 2011; Chan and
    Lawrence, 1988); "analytic", of all solutions that `ik_all` finds the one nearest to `seed`; "auto", that where the
    chain allows it, else numeric. Targets that have no analytic solution inside the limits get the numeric answer.
    """
    name = system.frame_name(frame)
    asked, targets, lead = _asked(system, name, target, _task_name(task, position_only), axis)
    if method != "analytic" and obstacle(system, name):
        from kempe.solvers.tasks import reach

        wanted = _tasks(name, asked, targets.reshape(*lead, 4, 4))
        more: dict[str, Any] = {} if starts == STARTS else {"starts": starts}
        more |= {} if iterations == ITERATIONS else {"iterations": iterations}
        more |= {} if time_limit is None else {"time_limit": time_limit}
        return reach(system, wanted, seed, tolerance=tolerance, rng=rng, threads=threads, throw=throw, **more)
    chain = chain_of(system, name, asked[1])
    base, seeds = _seeds(system, chain, seed, lead)
    question = Task(
        system, name, targets, *asked, tolerances(tolerance), start_count(starts), seed_number(rng), chain,
        step_count(iterations), time_limit, deadline(time_limit),
    )  # fmt: skip
    plan = None
    if method != "numeric":
        from kempe.solvers.analytic import hand_over

        plan = hand_over.plan_of(question, method)
    if plan is None:
        q, residual, info = run(question, seeds, threads)
    else:
        q, residual, info = hand_over.answer(question, plan, base, seeds, threads)
    solution = _judged(question, base, q, residual, info, lead)
    if not lead and asked[0] == "pose" and not chain.ints[HAS_QUATERNION] and ("one", name) not in system._queries:
        system._queries[("one", name)] = Bound(system, name, chain)
    if throw and not solution:
        raise NoSolutionError(solution)
    return solution


def _judged(
    question: Task, base: Array, q: Array, residual: Array, info: np.ndarray, lead: tuple[int, ...]
) -> Solution:  # fmt: skip
    """The answer, from the chain's configurations (N, n), residuals (N, 2) and status, steps and starts (N, 3)."""
    system, targets, code = question.system, question.targets, info[:, 0]
    full = np.empty((len(targets), system.nq))
    full[:] = base
    full[:, question.chain.q_index] = q
    if code.any():
        _look_closer(question, code)
        full[code == BAD_INPUT] = math.nan
    if not lead and code[0] == BAD_INPUT:
        _refuse_target(targets[0], base[0])
    return _answer(question, full, code, residual, info, lead)


def _tasks(frame: str, asked: tuple[str, tuple[float, float, float]], X: Array) -> list[Any]:
    """The tasks that a target (..., 4, 4) stands for."""
    from kempe.kinematics import tasks

    name, axis = asked
    out: list[Any] = []
    if name == "pose":
        out.append(tasks.Pose(frame, X))
    if points_along(name):
        out.append(tasks.Pointing(frame, X[..., :3, :3] @ np.array(axis), axis=axis))
    if name == "orientation":
        out.append(tasks.Orientation(frame, X[..., :3, :3]))
    if name in ("position", "position_axis"):
        out.append(tasks.Position(frame, X[..., :3, 3]))
    return out


def _task_name(task: str | None, position_only: bool) -> str | None:
    if position_only and task not in (None, "position"):
        raise InputError(f"task is {task!r}, but position_only asks for 'position'")
    return "position" if position_only else task


def _asked(
    system: System, frame: str, target: Any, task: str | None, axis: ArrayLike
) -> tuple[tuple[str, tuple[float, float, float]], Array, tuple[int, ...]]:
    """(task, axis), targets (N, 4, 4) and their leading shape."""
    if system.dim == 2 and points_along(task):
        target, task = in_plane(target, task, axis)
    direction = axis_of(axis) if points_along(task) else Z_AXIS
    targets, lead, is_position = targets_of(system, target, task, direction)
    particle = bool(system.table.at[frame][2])
    name = task_of(task, is_position, particle)
    if is_position and name != "position":
        raise InputError(f"target is a position, but task {name!r} asks for an orientation; give a pose (..., 4, 4)")
    if particle and task is None and not is_position:
        check_particle(targets, frame)
    return (name, direction), targets, lead


def _kernel_task(task: Task) -> np.ndarray:
    """What the kernel is told of a task: six rows, whether an axis is pointed, circular coordinates."""
    pointed = points_along(task.name)
    rows = (*task.mask[:5], 1, 1) if pointed else (*task.mask, 0)
    return np.concatenate([np.array(rows, dtype=np.int64), task.chain.circular])


def run(
    task: Task, seeds: Array, threads: int | None = 1, limits: Array | None = None, targets: Array | None = None
) -> tuple[Array, Array, np.ndarray]:
    """Chain configurations, residuals (N, 2) and (status, steps, starts) of all targets, in fixed chunks."""
    chain = task.chain
    goals = task.targets if targets is None else targets
    if task.axis != Z_AXIS:
        goals = goals.copy()
        goals[:, :3, :3] = goals[:, :3, :3] @ frame_of(np.array(task.axis))
    n, nq = len(goals), len(chain.q_index)
    out = np.empty((n, nq + ANSWER))
    bounds = chain.limits if limits is None else limits
    rows = _kernel_task(task)

    def work(i: int, j: int) -> int:
        first = seeds[i:j] if len(seeds) > 1 else seeds
        arguments = (
            chain.ints, chain.floats, bounds, rows, goals[i:j], first, task.rng, i, task.starts, task.iterations,
            *task.tolerance, 0.0, out[i:j],
        )  # fmt: skip
        search_ = _search(chain)
        if task.time_limit is not None:
            from kempe.solvers.rounds import in_time

            return in_time(task, search_, _approach, arguments)
        return _approach(*arguments) if search_(*arguments) else 0

    over_chunks(work, n, CHUNK, threads, SERIAL_BELOW if task.time_limit is None else CHUNK)
    return out[:, :nq], out[:, nq + LINEAR : nq + STATUS], out[:, nq + STATUS :].astype(np.int64)


def _search(chain: Chain) -> Callable[..., int]:
    """The kernel that searches for a chain."""
    if chain.ints[HAS_QUATERNION]:
        from kempe.kernels.solve import reach_one_by_one  # what few chains need is compiled for them alone

        return reach_one_by_one
    return search.reach


def _approach(*arguments: Any) -> int:
    """What `search.reach` did not reach, answered by the nearest configurations."""
    from kempe.kernels.closest import approach  # a success needs none of this

    return approach(*arguments)


class Bound:
    """`ik` of single poses for one frame, with all that can be looked up looked up: the way of plain calls."""

    def __init__(self, system: System, frame: str, chain: Chain):
        self.system, self.frame, self.chain = system, frame, chain
        self.rows = _kernel_task(self.task(np.zeros((4, 4))))
        self.size = len(chain.q_index)
        first = int(chain.q_index[0]) if self.size else 0
        in_a_row = np.array_equal(chain.q_index, np.arange(first, first + self.size))
        self.part = slice(first, first + self.size) if in_a_row else chain.q_index
        self.plain = system.nq == system.nv == len(system.layout.vector_q)
        """Whether entry i of q and of the limits belong together."""
        self.lower, self.upper = system.lower, system.upper

    def task(self, target: Array) -> Task:
        """What was asked."""
        return Task(self.system, self.frame, target[None], "pose", Z_AXIS, TOLERANCE, STARTS, 0, self.chain)

    def __call__(self, target: Array, seed: Any) -> Solution | None:
        """The answer for a pose (4, 4), None where target or seed want the careful path."""
        system, chain, n = self.system, self.chain, self.size
        if target.shape != (4, 4) or target.dtype != np.float64 or not target.flags.c_contiguous:
            return None
        if seed is None:
            q, seeds = chain.base[0].copy(), chain.no_seed
        else:
            if seed.__class__ is not np.ndarray or seed.dtype != np.float64 or seed.shape != (system.nq,):
                return None
            if not self.plain:
                return None
            q = np.maximum(seed, self.lower)
            np.minimum(q, self.upper, out=q)
            if not math.isfinite(q.dot(q)):
                return None
            seeds = q[self.part].reshape(1, 1, n)
        out = np.empty((1, n + ANSWER))
        arguments = (
            chain.ints, chain.floats, chain.limits, self.rows, target.reshape(1, 4, 4), seeds, 0, 0, STARTS, ITERATIONS,
            *TOLERANCE, 0.0, out,
        )  # fmt: skip
        if search.reach(*arguments):
            _approach(*arguments)
        row = out[0]
        linear, angular, code, steps, starts = row[n:].tolist()
        if code == BAD_INPUT:
            return None
        q[self.part] = row[:n]
        if code == SOLVED:
            return Solution.reached((self, target), q, linear, angular, int(steps), int(starts))
        task, codes = self.task(target), np.array([NOT_FOUND])
        _look_closer(task, codes)
        return Solution(q, False, codes.item(), linear, angular, int(steps), int(starts), task)


def _look_closer(task: Task, code: np.ndarray) -> None:
    """Tell, in place, targets that lengths alone put out of reach from those that were not found."""
    failed = np.flatnonzero((code == NOT_FOUND) | (code == OUT_OF_TIME))
    code[failed[outside(task, task.targets[failed]) > task.tolerance[0]]] = OUT_OF_REACH


def outside(task: Task, targets: Array) -> Array:
    """How far (N,) targets are outside the reach bounds, in metres: a proven lower bound of the position error."""
    if not task.mask[0]:
        return np.zeros(len(targets))
    out = np.abs(targets[:, 2, 3]) if task.system.dim == 2 else np.zeros(len(targets))
    for point, largest, smallest in task.chain.bounds:
        distance = np.linalg.norm(targets[:, :3, 3] - point, axis=-1)
        out = np.maximum(out, np.maximum(distance - largest, smallest - distance))
    return out


def _seeds(system: System, chain: Chain, seed: Any, lead: tuple[int, ...]) -> tuple[Array, Array]:
    """Configurations (1 or N, nq) to start from, and the chain's part of them as (1 or N, K, nq) for the kernel."""
    if seed is None:
        return chain.base, chain.no_seed
    base = as_q(system, seed)
    if base.ndim > 1 and base.shape[:-1] != lead:
        each = f" or {(*lead, system.nq)}" if lead else ""
        raise InputError(f"seed has shape {base.shape}; it must be ({system.nq},){each}")
    base = np.array(base.reshape(math.prod(base.shape[:-1]), system.nq))
    if not lead and not np.isfinite(base).all():
        raise InputError("seed has entries that are not finite")
    base = inside(system, base)
    return base, np.ascontiguousarray(base[:, None, chain.q_index])


def _refuse_target(target: Array, seed: Array) -> None:
    if not np.isfinite(target).all():
        raise InputError("target has entries that are not finite")
    if not np.isfinite(seed).all():
        raise InputError("seed has entries that are not finite")
    raise InputError("target is not a pose: its rotation part must be orthonormal with determinant +1")


def _answer(
    task: Task, q: Array, code: np.ndarray, residual: Array, info: np.ndarray, lead: tuple[int, ...]
) -> Solution:  # fmt: skip
    columns = (code == SOLVED, code, residual[:, 0], residual[:, 1], info[:, 1], info[:, 2])
    fields = [x.reshape(lead) if lead else x[0].item() for x in columns]
    success, code_, position, angle, steps, starts = fields
    return Solution(q.reshape(*lead, task.system.nq), success, code_, position, angle, steps, starts, task)
