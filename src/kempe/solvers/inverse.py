"""The inverse geometric model, numerically: a configuration in which a frame of a tree reaches a target."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.errors import InputError, NoSolutionError
from kempe.kernels import search
from kempe.kernels.job import ANSWER, LINEAR, STATUS
from kempe.kernels.layout import HAS_QUATERNION
from kempe.kinematics.configuration import as_q
from kempe.kinematics.parallel import over_chunks
from kempe.solvers.arguments import seed_number, start_count, tolerances
from kempe.solvers.chain import Chain, chain_of, inside, obstacle
from kempe.solvers.solution import BAD_INPUT, NOT_FOUND, OUT_OF_REACH, SOLVED, Solution
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

    @property
    def mask(self) -> tuple[int, ...]:
        """Which errors [linear; angular] in the frame of the tip count, its z axis being `axis`."""
        return TASKS[self.name]


def ik(
    system: System, target: ArrayLike, frame: FrameLike, seed: Any = None, *, task: str | None = None,
    axis: ArrayLike = Z_AXIS, position_only: bool = False, tolerance: float | tuple[float, float] = TOLERANCE,
    starts: int = STARTS, rng: int | np.random.Generator = 0, threads: int | None = None, throw: bool = False,
    method: str = "numeric",
) -> Solution:  # fmt: skip
    """A configuration in which `frame` reaches `target` (the inverse geometric model), always inside the limits.

    `target` is a pose (..., 4, 4) in the ground frame (in planar systems also (..., 3, 3)), or a position (..., 3)
    (in planar systems also (..., 2)). `task` says what of it counts: "pose", "position" (also by `position_only`),
    "orientation", "direction" (of the tool's `axis`), "position_axis" (both). `tolerance` is the largest position error
    [m] and rotation angle [rad]. `seed` (nq,) or (..., nq), or a dict by name, is the first start; what the chain does
    not move keeps its value there, else the neutral one, inside the limits.

    Starts are tried in order, the seed or the middle of the limits first, up to `starts` of them, the others drawn from
    `rng`; the answer is that of the first start that reaches the target. So the same arguments give the same answer,
    whatever the `threads`, and a seed that leads to the target is preferred to all else.

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
        return reach(system, wanted, seed, tolerance=tolerance, rng=rng, threads=threads, throw=throw, **more)
    chain = chain_of(system, name, asked[1])
    base, seeds = _seeds(system, chain, seed, lead)
    question = Task(system, name, targets, *asked, tolerances(tolerance), start_count(starts), seed_number(rng), chain)
    plan = None
    if method != "numeric":
        from kempe.solvers.analytic import hand_over

        plan = hand_over.plan_of(question, method)
    if plan is None:
        q, residual, info = run(question, seeds, threads)
    else:
        q, residual, info = hand_over.answer(question, plan, base, seeds, threads)
    solution = _judged(question, base, q, residual, info, lead)
    if not lead:
        _bind(question, _task_name(task, position_only), np.shape(target))
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
            chain.ints, chain.floats, bounds, rows, goals[i:j], first, task.rng, i, task.starts, ITERATIONS,
            *task.tolerance, 0.0, out[i:j],
        )  # fmt: skip
        if chain.ints[HAS_QUATERNION]:
            from kempe.kernels.solve import reach_one_by_one  # what few chains need is compiled for them alone

            missed = reach_one_by_one(*arguments)
        else:
            missed = search.reach(*arguments)
        return _approach(*arguments) if missed else 0

    over_chunks(work, n, CHUNK, threads, SERIAL_BELOW)
    return out[:, :nq], out[:, nq + LINEAR : nq + STATUS], out[:, nq + STATUS :].astype(np.int64)


def _approach(*arguments: Any) -> int:
    """What `search.reach` did not reach, answered by the nearest configurations."""
    from kempe.kernels.closest import approach  # a success needs none of this

    return approach(*arguments)


def _bind(question: Task, task: str | None, shape: tuple[int, ...]) -> None:
    """Nothing; calls like this one go by a `Bound` from now on, if they are plain enough."""
    system, chain, key = question.system, question.chain, ("one", question.frame, str(task), len(shape))
    point = question.name == "position" and (task is not None or shape != (4, 4))  # a turned particle is an error
    plain = shape in ((4, 4), (3,), (2,)) if point else (shape == (4, 4) and question.name != "position")
    if plain and question.axis == Z_AXIS and not chain.ints[HAS_QUATERNION] and key not in system._queries:
        usual = replace(question, tolerance=TOLERANCE, starts=STARTS, rng=0)
        system._queries[key] = Bound(usual, shape)


class Bound:
    """`ik` of single targets for one frame and task, with all looked up that can be: the way of plain calls."""

    def __init__(self, question: Task, shape: tuple[int, ...]):
        self.asked, self.chain, self.rows = question, question.chain, _kernel_task(question)
        system, self.size = question.system, len(question.chain.q_index)
        self.nq = system.nq
        first = int(self.chain.q_index[0]) if self.size else 0
        in_a_row = np.array_equal(self.chain.q_index, np.arange(first, first + self.size))
        self.part = slice(first, first + self.size) if in_a_row else self.chain.q_index
        self.whole = in_a_row and self.size == system.nq
        """Whether the chain has all coordinates of the system."""
        self.plain = system.nq == system.nv == len(system.layout.vector_q)
        """Whether entry i of q and of the limits belong together."""
        self.lower, self.upper, self.unmoved = system.lower, system.upper, np.eye(4)[None]
        self.shape = shape

    def task(self, target: Array) -> Task:
        """What was asked."""
        return replace(self.asked, targets=self._poses(target))

    def _poses(self, target: Array) -> Array:
        """Target as (1, 4, 4)."""
        if len(self.shape) == 2:
            return target.reshape(1, 4, 4)
        X = self.unmoved.copy()
        X[0, : self.shape[0], 3] = target
        return X

    def __call__(self, target: Array, seed: Any) -> Solution | None:
        """The answer for a target, None where target or seed want the careful path."""
        if target.shape != self.shape or target.dtype != np.float64 or not target.flags.c_contiguous:
            return None
        chain, n = self.chain, self.size
        if seed is None:
            base, seeds = chain.base[0], chain.no_seed
        else:
            if seed.__class__ is not np.ndarray or seed.dtype != np.float64 or seed.shape != (self.nq,):
                return None
            if not (self.plain and seed.flags.c_contiguous):
                return None
            base, seeds = seed, seed[self.part].reshape(1, 1, n)
        out = np.empty((1, n + ANSWER))
        arguments = (
            chain.ints, chain.floats, chain.limits, self.rows, self._poses(target), seeds, 0, 0, STARTS, ITERATIONS,
            *TOLERANCE, 0.0, out,
        )  # fmt: skip
        if search.reach(*arguments):
            _approach(*arguments)
        row = out[0]
        linear, angular, code, steps, starts = row[n:].tolist()
        if code == BAD_INPUT:
            return None
        if self.whole:
            q = row[:n]
        else:
            q = np.minimum(np.maximum(base, self.lower), self.upper) if self.plain else base.copy()
            q[self.part] = row[:n]
            if not math.isfinite(q.dot(q)):
                return None
        if code == SOLVED:
            return Solution.reached((self, target), q, linear, angular, int(steps), int(starts))
        task, codes = self.task(target), np.array([NOT_FOUND])
        _look_closer(task, codes)
        return Solution(q, False, codes.item(), linear, angular, int(steps), int(starts), task)


def _look_closer(task: Task, code: np.ndarray) -> None:
    """Tell, in place, targets that lengths alone put out of reach from those that were not found."""
    failed = np.flatnonzero(code == NOT_FOUND)
    code[failed[outside(task, task.targets[failed]) > 0.0]] = OUT_OF_REACH


def outside(task: Task, targets: Array) -> Array:
    """How far (N,) targets are outside the reach bounds, in metres, for a point of the frame that each one fixes.

    Zero within what the tolerances allow. With the target's orientation, it is a lower bound of the position error.
    """
    linear, angular = task.tolerance
    if not task.mask[0]:
        return np.zeros(len(targets))
    out = np.abs(targets[:, 2, 3]) if task.system.dim == 2 else np.zeros(len(targets))
    out[out <= linear] = 0.0
    can_turn = len(task.chain.v_index) >= (3 if task.system.dim == 2 else sum(task.mask))  # else that is the reason
    for centre, largest, smallest, point in task.chain.bounds:
        arm = float(np.linalg.norm(point))
        along = points_along(task.name) and float(np.linalg.norm(np.cross(point, task.axis))) < 1e-12 * arm
        if arm > 0.0 and not (can_turn and (all(task.mask) or along)):
            continue
        distance = np.linalg.norm(targets[:, :3, 3] + targets[:, :3, :3] @ point - centre, axis=-1)
        beyond = np.maximum(distance - largest, smallest - distance)
        out = np.where(beyond > linear + arm * angular, np.maximum(out, beyond), out)
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
    seeds = np.ascontiguousarray(base[:, None, chain.q_index])  # the kernel brings them inside, circles by turns
    return inside(system, base), seeds


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
