"""Self-motions: how a system can move while its tasks hold, traced step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.configuration import as_q
from kempe.kinematics.task import Task, numbers_of
from kempe.kinematics.tasks import Pose
from kempe.solvers.reached import analyse
from kempe.solvers.solution import SOLVED
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System
    from kempe.solvers.tasks import Problem

TOLERANCE = 1e-10
"""Largest error of the tasks along the way, in metres and radians."""
AT_LIMIT = 1e-6
"""How near to a limit a coordinate is at it."""
PARTS = (1.0, 0.1, 1e-2, 1e-3, 1e-4)
"""Parts of a step that are tried, one after the other, before the way ends."""
LEAST_PART = 0.05
"""Part of the wished direction that the freedoms must still have for the way to go on."""


@dataclass(frozen=True, eq=False)
class SelfMotion:
    """A family of configurations `q` (n, nq) in which tasks hold, in the order in which they are passed.

    `freedoms` are those that the tasks leave at the start, `start` is the row of the configuration it began with.
    `closed` says that the way comes back to it; else `ends` says for both ends why the way ends there.
    """

    system: System
    q: Array
    freedoms: int
    start: int
    closed: bool
    ends: tuple[str, str]

    def __len__(self) -> int:
        return len(self.q)

    def __str__(self) -> str:
        how = "it comes back to its start" if self.closed else f"from {self.ends[0]} to {self.ends[1]}"
        freedoms = "1 freedom" if self.freedoms == 1 else f"{self.freedoms} freedoms"
        return f"{len(self.q)} configurations of a self-motion with {freedoms}: {how}"


def self_motion(
    system: System, q: Any, tasks: FrameLike | Task | Sequence[Task], *, direction: Any = None, steps: int = 200,
    step: float = 0.05,
) -> SelfMotion:  # fmt: skip
    """The configurations that a system can reach from q (nq,) without leaving tasks, both ways.

    `tasks` is a frame, which stays at its pose, or hard tasks that hold at q. Where they leave one freedom, its
    whole curve is traced until it closes, meets a limit or has `steps` steps each way; where they leave more,
    `direction` says where to go: a coordinate to be moved, or a velocity (nv,), of which the part is followed that the
    tasks allow. `step` is the length of a step in radians and characteristic lengths. The tasks hold to 1e-9 all along:
    each step is led back by steps of minimum norm. Errors: `InputError` where the tasks do not hold at q, or leave no
    freedom, or more than one without a direction.
    """
    from kempe.solvers.tasks import judge, pose_problem

    q = as_q(system, q)
    if q.ndim != 1:
        raise InputError(f"q has shape {q.shape}; needed is one configuration ({system.nq},)")
    whole = isinstance(steps, (int, np.integer)) and not isinstance(steps, bool)
    if not whole or steps < 1 or not isinstance(step, (int, float, np.floating)) or not 0.0 < step <= 0.5:
        raise InputError(f"steps is {steps!r}, step {step!r}; needed are a whole number from 1 on, and 0 < step <= 0.5")
    wanted: Any = tasks
    if not isinstance(tasks, (Task, list, tuple)):
        name = system.frame_name(tasks)  # type: ignore[arg-type]
        wanted = Pose(name, system.fk(q, name))
    problem, start = pose_problem(system, wanted, q, TOLERANCE, 1)
    if problem.lead:
        raise InputError(f"the goals have the leading shape {problem.lead}; needed are those of one problem")
    problem = replace(problem, tasks=tuple(replace(t, tolerance=None) for t in problem.tasks))
    at = judge(replace(problem, tolerance=(1e-6, 1e-6)), start, np.zeros((1, 3), dtype=np.int64))
    if not at:
        raise InputError(f"the tasks do not hold at q: they are missed by {at.position_error} m, "
                         f"{at.orientation_error} rad")  # fmt: skip
    q0, info = problem.run(start)
    freedoms = analyse(problem, q0[0])[3].shape[1]
    wish = _wish(system, direction, freedoms, problem)
    forth, closed, end = _follow(problem, q0[0], wish, 1.0, steps, step, direction is not None)
    if closed:
        return SelfMotion(system, np.array([q0[0], *forth]), freedoms, 0, True, ("", ""))
    back_, _, other = _follow(problem, q0[0], wish, -1.0, steps, step, direction is not None)
    return SelfMotion(system, np.array([*back_[::-1], q0[0], *forth]), freedoms, len(back_), False, (other, end))


def _wish(system: System, direction: Any, freedoms: int, problem: Problem) -> Array | None:
    """The scaled velocity (nv,) to follow; None for the only one."""
    if freedoms == 0:
        raise InputError("the tasks leave no freedom at q: there is no self-motion")
    if direction is None:
        if freedoms > 1:
            raise InputError(f"the tasks leave {freedoms} freedoms: say by `direction` which way to go")
        return None
    scale = problem.packed.scale
    if isinstance(direction, str):
        if direction not in system.velocity_names:
            raise UnknownNameError("coordinate", direction, system.velocity_names, system.name)
        return np.eye(system.nv)[system.velocity_names.index(direction)]
    wish = numbers_of(direction, "direction")
    if wish.shape != (system.nv,) or not np.isfinite(wish).all() or not wish.any():
        raise InputError(f"direction has shape {wish.shape}; it must be a velocity ({system.nv},), not zero")
    return wish / scale / np.linalg.norm(wish / scale)


def _follow(
    problem: Problem, q: Array, wish: Array | None, sign: float, steps: int, step: float, wished: bool
) -> tuple[list[Array], bool, str]:  # fmt: skip
    """Configurations one way from q, whether they come back to it, and why they end."""
    system, scale, start, out = problem.system, problem.packed.scale, q, []
    before = None if wish is None else sign * wish
    first = None
    for n in range(steps):
        N = analyse(problem, q)[3]
        if before is None:
            before = sign * N[:, 0]
        t = N @ (N.T @ before)
        if np.linalg.norm(t) < LEAST_PART:
            return out, False, "where the tasks leave nothing of this direction"
        t /= np.linalg.norm(t)
        first = t if first is None else first
        for part in PARTS:
            found, info = problem.run(system.integrate(q, part * step * t * scale)[None])
            moved = system.difference(q, found[0]) / scale
            if info[0, 0] == SOLVED and moved @ t >= 0.01 * part * step:
                break
        else:
            return out, False, _stop(problem, q, t, 10.0 * PARTS[-1] * step)
        home = _short(system, found[0], start) / scale
        if n > 2 and np.linalg.norm(home) < step and t @ first > 0.5 and home @ t >= 0.0 and not wished:
            return [*out, found[0]], True, ""
        q, before = found[0], (t if wish is None else before)
        out.append(q)
        if names := _at_limits(system, q, t):
            return out, False, f"the limit of {names[0]!r}"
    return out, False, f"the last of {steps} steps"


def _stop(problem: Problem, q: Array, t: Array, ahead: float) -> str:
    """What stands in the way of going on from q along t: a limit, or the bound of a task, not farther than `ahead`."""
    system, scale = problem.system, problem.packed.scale
    if names := _at_limits(system, q, t, ahead * scale):
        return f"the limit of {names[0]!r}"
    there = system.integrate(q, ahead * t * scale)
    owner, ties = problem.packed.owner, problem.packed.loops.ties
    for i in sorted({int(k) for k, tie in zip(owner, ties, strict=True) if tie.bounds and k >= 0}):
        task, goals = problem.tasks[i], problem.goals[i]
        if max(task.measure(system, there, goals)) > 0.01 * ahead:
            return f"the bound of {task.label!r}"
    return "a point where it cannot be followed"


def _short(system: System, a: Array, b: Array) -> Array:
    """The shortest way (nv,) from a to b; unlimited joints turn the short way."""
    from kempe.kinematics.configuration import circles

    v, round_ = system.difference(a, b), circles(system)
    v[round_] -= 2.0 * np.pi * np.round(v[round_] / (2.0 * np.pi))
    return v


def _at_limits(system: System, q: Array, t: Array, ahead: Array | float = 0.0) -> list[str]:
    """Coordinates at a limit that the direction t (nv,) pushes outwards, or takes there within `ahead` (nv,)."""
    v, x = system.layout.vector_v, q[system.layout.vector_q]
    near = AT_LIMIT + np.abs(ahead * t)[v]
    low = (x <= system.lower[v] + near) & (t[v] < 0.0)
    high = (x >= system.upper[v] - near) & (t[v] > 0.0)
    return [system.velocity_names[v[i]] for i in np.flatnonzero(low | high)]
