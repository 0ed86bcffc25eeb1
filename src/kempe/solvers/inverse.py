"""The inverse geometric model, numerically: a configuration in which a frame of a tree reaches a target."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained
from kempe.constraints.targets import of_target
from kempe.errors import InputError, NoSolutionError, UnsupportedError
from kempe.kernels.compiled import maker, search
from kempe.kernels.layout import HAS_QUATERNION
from kempe.kernels.search_layout import ANSWER, LARGEST, LINEAR, SOLVED, STATUS
from kempe.kinematics.configuration import as_start
from kempe.kinematics.one_sided import one_sided_rows
from kempe.kinematics.parallel import over_chunks
from kempe.rigid import arrays, sound
from kempe.solvers import rounds
from kempe.solvers.arguments import deadline, seed_number, start_count, step_count, tolerances
from kempe.solvers.chain import Chain, chain_of, inside, obstacle
from kempe.solvers.rounds import FEW, ITERATIONS, MOST, TOLERANCE, Task, outside
from kempe.solvers.solution import Solution
from kempe.solvers.targets import (
    Z_AXIS,
    axis_for,
    check_particle,
    in_plane,
    not_a_pose,
    points_along,
    targets_of,
    task_of,
)
from kempe.spatial import Array
from kempe.status import Status, member

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

CHUNK, SERIAL_BELOW = 256, 1024


@explained
def ik(
    system: System, target: ArrayLike, frame: FrameLike, start: Any = None, *, task: str | None = None,
    axis: ArrayLike = Z_AXIS, position_only: bool = False, tolerance: float | tuple[float, float] = TOLERANCE,
    starts: int = MOST, iterations: int = ITERATIONS, time_limit: float | None = None,
    rng: int | np.random.Generator = 0, threads: int | None = None, throw: bool = False, method: str = "numeric",
) -> Solution:  # fmt: skip
    """A configuration in which `frame` reaches `target` (the inverse geometric model), always inside the limits.

    `target` is a pose (..., 4, 4) in the ground frame (in planar systems also (..., 3, 3)), or a position (..., 3)
    (in planar systems also (..., 2)), or an object or words that say one (`kempe.rigid.arrays`).
    `task` says what of it counts: "pose", "position" (also by `position_only`), "orientation", "direction" (of the
    tool's `axis`), "position_axis" (both). `tolerance` is the largest position error [m] and rotation angle [rad].
    `start` (nq,) or (..., nq), or a dict by name, is the first start; what the chain does not move keeps its value
    there, else the neutral one, inside the limits.

    Starts are tried in order, `start` or the middle of the limits first, up to `starts` of them, the others drawn from
    `rng`; the first that reaches the target is the answer: the same for the same arguments, whatever the `threads`.
    `iterations` are the steps of one start, at most; where all fail, as many descents to the nearest, at most 16, have
    five times as many. `time_limit` [s] is for the whole call, looked at after each 32 starts: an answer that it ended
    says so, and is the only one that depends on the machine.

    The answer says by `success` and `status` whether it was reached and if not, why; `throw=True` raises
    `NoSolutionError` instead. A NaN in a single target is an `InputError`, in a batch it gives a NaN row. A frame that
    moves with closed loops, or with relations of several coordinates, is a case for `kempe.solvers.tasks.reach`, which
    holds these: the answer then is `Reached`.

    `method`: "numeric", damped least squares with an active set of limits and restarts (Sugihara, 2011; Chan and
    Lawrence, 1988); "analytic", of all solutions that `ik_all` finds the one nearest to `start`; "auto", that where the
    chain allows it, else numeric. Targets that have no analytic solution inside the limits get the numeric answer.
    """
    name, target = system.frame_name(frame), arrays(target, "target")
    asked, targets, lead = _asked(system, name, target, _task_name(task, position_only), axis)
    if _bounded(system, method) or (method != "analytic" and obstacle(system, name)):
        from kempe.solvers.tasks import reach

        wanted = of_target(name, *asked, targets.reshape(*lead, 4, 4))
        given = {"starts": (starts, MOST), "iterations": (iterations, ITERATIONS), "time_limit": (time_limit, None)}
        more: dict[str, Any] = {name: value for name, (value, usual) in given.items() if value != usual}
        return reach(system, wanted, start, tolerance=tolerance, rng=rng, threads=threads, throw=throw, **more)
    chain = chain_of(system, name, asked[1])
    base, seeds = _seeds(system, chain, start, lead)
    targets = targets.copy() if np.may_share_memory(targets, target) else targets  # the answer keeps them
    question = Task(
        system, name, targets, *asked, tolerances(tolerance), start_count(starts), seed_number(rng), chain,
        step_count(iterations), time_limit, deadline(time_limit),
    )  # fmt: skip
    plan = None
    if method != "numeric":
        from kempe.solvers.analytic import hand_over

        plan = hand_over.plan_of(question, method)
    question, (q, residual, info) = _run(question, plan, base, seeds, threads, lead)
    solution = _judged(question, base, q, residual, info, lead, seeds, threads)
    if not lead:
        _bind(question, _task_name(task, position_only), np.shape(target))
    if throw and not solution:
        raise NoSolutionError(solution)
    return solution


def _run(
    question: Task, plan: Any, base: Array, seeds: Array, threads: int | None, lead: tuple[int, ...]
) -> tuple[Task, tuple[Array, Array, np.ndarray]]:  # fmt: skip
    """The question and what `run`, or the closed form of a plan, finds; rotations that were rounded are mended."""
    if plan is None:
        found = run(question, seeds, threads, postpone=bool(lead) and question.time_limit is None)
    else:
        from kempe.solvers.analytic import hand_over

        found = hand_over.answer(question, plan, base, seeds, threads)
    targets = question.targets
    if lead and (found[2][:, 0] == Status.BAD_INPUT).any() and (mended := sound(targets, "target")) is not targets:
        return _run(replace(question, targets=mended), plan, base, seeds, threads, lead)
    return question, found


def _nearest(
    question: Task, base: Array, seeds: Array, threads: int | None, q: Array, residual: Array, info: np.ndarray,
    lead: tuple[int, ...],
) -> Solution:  # fmt: skip
    """The answer of a batch as of `run`, with what is nearest to the targets that are out of reach."""
    far = np.flatnonzero(info[:, 0] == Status.OUT_OF_REACH)
    some = seeds[far] if len(seeds) > 1 else seeds
    q[far], residual[far], info[far] = run(question, some, threads, targets=question.targets[far])
    return _judged(question, base, q, residual, info, lead, seeds, threads)


def _judged(
    question: Task, base: Array, q: Array, residual: Array, info: np.ndarray, lead: tuple[int, ...], seeds: Array,
    threads: int | None,
) -> Solution:  # fmt: skip
    """The answer, from the chain's configurations (N, n), residuals (N, 2) and status, steps and starts (N, 3).

    Where `run` has postponed targets, their part of it is found when it is asked for.
    """
    system, targets, code = question.system, question.targets, info[:, 0]
    if (code == Status.OUT_OF_REACH).any():
        given = (question, base, seeds, threads, q, residual, info, lead)
        return Solution.postponed(code.reshape(lead).copy(), question, (_nearest, given))
    full = np.empty((len(targets), system.nq))
    full[:] = base
    full[:, question.chain.q_index] = q
    if code.any():
        _look_closer(question, code)
        full[code == Status.BAD_INPUT] = math.nan
    if not lead and code[0] == Status.BAD_INPUT:
        raise InputError(not_a_pose(targets[0], "start"))
    return _answer(question, full, code, residual, info, lead)


def _bounded(system: System, method: str) -> bool:
    """Whether declared one-sided constraints have to be held. Errors: `UnsupportedError` where the method cannot."""
    bounds = one_sided_rows(system)
    if bounds.declared and method == "analytic":
        raise UnsupportedError(f"method 'analytic' does not hold one-sided constraints, such as {bounds.names[0]!r}; "
                               "leave it out, or take one of the solutions of ik_all, which do")  # fmt: skip
    return bounds.declared > 0


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
    direction = axis_for(axis, task)
    targets, lead, is_position = targets_of(system, target, task, direction)
    particle = bool(system.table.at[frame][2])
    name = task_of(task, is_position, particle)
    if is_position and name != "position":
        raise InputError(f"target is a position, but task {name!r} asks for an orientation; give a pose (..., 4, 4)")
    if particle and task is None and not is_position:
        check_particle(targets, frame)
    return (name, direction), targets, lead


def run(
    task: Task, seeds: Array, threads: int | None = 1, limits: Array | None = None, targets: Array | None = None,
    postpone: bool = False,
) -> tuple[Array, Array, np.ndarray]:  # fmt: skip
    """Chain configurations, residuals (N, 2) and (status, steps, starts) of all targets, in fixed chunks.

    `postpone` is as in `rounds.answered`.
    """
    chain = task.chain
    goals = task.targets if targets is None else targets
    n, nq = len(goals), len(chain.q_index)
    out = np.empty((n, nq + ANSWER))
    bounds = chain.limits if limits is None else limits

    def work(i: int, j: int) -> int:
        first = seeds[i:j] if len(seeds) > 1 else seeds
        return rounds.answered(task, goals[i:j], first, bounds, out[i:j], postpone)

    if task.time_limit is None:
        over_chunks(work, n, CHUNK, threads, SERIAL_BELOW)
    else:  # all targets get their first starts before one gets its last: each thread has all of its own at once
        over_chunks(work, n, None, threads, CHUNK)
    return out[:, :nq], out[:, nq + LINEAR : nq + STATUS], out[:, nq + STATUS :].astype(np.int64)


def _bind(question: Task, task: str | None, shape: tuple[int, ...]) -> None:
    """Nothing; calls like this one go by a `Bound` from now on, if they are plain enough."""
    system, chain, key = question.system, question.chain, ("one", question.frame, str(task), len(shape))
    point = question.name == "position" and (task is not None or shape != (4, 4))  # a turned particle is an error
    plain = shape in ((4, 4), (3,), (2,)) if point else (shape == (4, 4) and question.name != "position")
    if plain and question.axis == Z_AXIS and not chain.ints[HAS_QUATERNION] and key not in system._queries:
        usual = replace(question, tolerance=TOLERANCE, starts=MOST, rng=0)
        system._queries[key] = Bound(usual, shape)


class Bound:
    """`ik` of single targets for one frame and task, with all looked up that can be: the way of plain calls."""

    def __init__(self, question: Task, shape: tuple[int, ...]):
        self.asked, self.chain, self.rows = question, question.chain, rounds.rows_of(question)
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
        self.shape, self.posed, self.new = shape, len(shape) == 2, maker(1, self.size + ANSWER)
        self.reach, self.base, self.no_seed = search.reach, self.chain.base[0], self.chain.no_seed

    def __reduce__(self) -> tuple[Any, ...]:
        return Bound, (self.asked, self.shape)

    def task(self, X: Array) -> Task:
        """What was asked, for poses (1, 4, 4)."""
        return replace(self.asked, targets=X)

    def _pose(self, target: Array) -> Array:
        """A position as (1, 4, 4)."""
        X = self.unmoved.copy()
        X[0, : self.shape[0], 3] = target
        return X

    def __call__(self, target: Array, start: Any) -> Solution | None:
        """The answer for a target, None where target or seed need the general solver."""
        if target.shape != self.shape or not (self.posed or target.dtype == np.float64):
            return None
        chain, n = self.chain, self.size
        if start is None:
            base, seeds = self.base, self.no_seed
        else:
            if start.__class__ is not np.ndarray or start.dtype != np.float64 or start.shape != (self.nq,):
                return None
            if not (self.plain and start.flags.c_contiguous):
                return None
            base, seeds = start, (start if self.whole else start[self.part]).reshape(1, 1, n)
        out = self.new()
        X = target.copy()[None] if self.posed else self._pose(target)  # the answer keeps it
        try:
            missed = self.reach(
                chain.ints, chain.floats, chain.limits, self.rows, X, seeds, 0, 0, FEW, ITERATIONS, *TOLERANCE, 0.0, out
            )
        except TypeError:  # not float64
            return None
        row = out[0]
        if missed:
            head = (chain.ints, chain.floats, chain.limits, self.rows, X, seeds, 0)
            rounds.go_on(self.task(X), X, head, FEW, out)
            if row[n + STATUS] == Status.BAD_INPUT:
                return None
        if self.whole:
            q = row[:n]
        else:
            q = np.minimum(np.maximum(base, self.lower), self.upper) if self.plain else base.copy()
            q[self.part] = row[:n]
            if not math.isfinite(base.dot(base)):
                return None
        if not missed or row[n + STATUS] == Status.SOLVED:
            return Solution.reached((self, X), q, row)
        task, codes = self.task(X), np.array([Status.NOT_FOUND])
        _look_closer(task, codes)
        linear, angular, _, steps, starts = row[n:].tolist()
        return Solution(q, False, member(codes[0]), linear, angular, int(steps), int(starts), task)


def _look_closer(task: Task, code: np.ndarray) -> None:
    """Tell, in place, targets that lengths alone put out of reach from those that were not found."""
    failed = np.flatnonzero((code == Status.NOT_FOUND) | (code == Status.OUT_OF_TIME))
    code[failed[outside(task, task.targets[failed]) > 0.0]] = Status.OUT_OF_REACH


def _seeds(system: System, chain: Chain, start: Any, lead: tuple[int, ...]) -> tuple[Array, Array]:
    """Configurations (1 or N, nq) to start from, and the chain's part of them as (1 or N, K, nq) for the kernel."""
    if start is None:
        return chain.base, chain.no_seed
    base = as_start(system, start)
    if base.ndim > 1 and base.shape[:-1] != lead:
        each = f" or {(*lead, system.nq)}" if lead else ""
        raise InputError(f"start has shape {base.shape}; it must be ({system.nq},){each}")
    base = np.array(base.reshape(math.prod(base.shape[:-1]), system.nq))
    if not lead and not np.all(np.abs(base) < LARGEST):
        raise InputError(not_a_pose(np.eye(4), "start"))
    seeds = np.ascontiguousarray(base[:, None, chain.q_index])  # the kernel brings them inside, circles by turns
    return inside(system, base), seeds


def _answer(
    task: Task, q: Array, code: np.ndarray, residual: Array, info: np.ndarray, lead: tuple[int, ...]
) -> Solution:  # fmt: skip
    columns = (code == SOLVED, code, residual[:, 0], residual[:, 1], info[:, 1], info[:, 2])
    fields = [x.reshape(lead) if lead else x[0].item() for x in columns]
    success, code_, position, angle, steps, starts = fields
    q = q.reshape(*lead, task.system.nq)
    return Solution(q, success, member(code_), position, angle, steps, starts, task)
