"""The tasks of a request, checked and packed, and one run of the search for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import read_tolerances
from kempe.assemble.bound import TOLERANCE as CLOSED
from kempe.assemble.bound import remove_limits
from kempe.budget import list_checks, watched_by
from kempe.equations.judge import Numbers
from kempe.equations.packed_tasks import Packed
from kempe.equations.tasks import Goal, Task
from kempe.inverse.chain.serial_chain import move_inside_limits
from kempe.kernels.base import search_layout as S
from kempe.kernels.compiled import task_search
from kempe.model.configurations import sample_configurations
from kempe.model.kernel_functions import Callback
from kempe.model.model import store_answer
from kempe.numerics.clock import EndReached, get_clock, make_end_check
from kempe.numerics.pool import sum_over_chunks
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- coordinates that no task depends on

# No search needs to move them.

NONE = np.zeros(0, dtype=np.int64)
SAMPLES = 3
NOTHING = 1e-12
"""Configurations at which it is looked what moves what, and derivatives there that are none, but
rounding."""


def find_untouched_places(packed: Packed, pins: Array) -> np.ndarray:
    """Find the places in q that no task depends on; `pins` (N, k) are goals.

    Neither do loops or relations that a task moves.

    Looked for once, by derivatives at random configurations.
    """
    found = packed.stages.get(find_untouched_places)
    if found is None:
        if not len(pins):
            return NONE
        q = sample_configurations(packed.system, 0, SAMPLES)
        (_, tasks), (_, loops) = (packed.evaluate_tasks(q, pins[:1], c) for c in (False, True))
        if not (np.isfinite(tasks).all() and np.isfinite(loops).all()):
            return NONE
        sided = packed.one_sided.compute_rates(q, declared=True)[1]
        tasks = np.concatenate([tasks, sided], axis=1)  # as if they were requested
        opaque = any(tie.function is not None for tie in packed.loops.ties)  # and may be flat there
        found = packed.stages[find_untouched_places] = (
            NONE if opaque else _find_independent_places(packed, tasks, loops)
        )
    return found


def _find_independent_places(packed: Packed, tasks: Array, loops: Array) -> np.ndarray:
    """Find the places in q whose columns of the Jacobians (N, m, nv) are zero."""
    layout = packed.system.structure.layout
    requested: np.ndarray = np.any(np.abs(tasks) > NOTHING, axis=(0, 1))
    bound: np.ndarray = np.any(np.abs(loops) > NOTHING, axis=0)
    for _ in range(len(bound)):  # what moves a loop moves all of it
        requested = requested | bound[(bound & requested).any(axis=1)].any(axis=0)
    balls = ~(requested[layout.quaternion_v[:, None] + np.arange(3)].any(axis=1))
    angles = layout.vector_q[~requested[layout.vector_v]]
    return np.concatenate(
        [angles, (layout.quaternion_q[balls][:, None] + np.arange(4)).ravel()]
    ).astype(np.int64)


# ---- the packed problem, and one run of the search

FIRST = 60
"""Starts after which one looks whether more are worth their time."""
STARTS = FIRST
"""Starts before tasks are given up that are requested beside something else, as along a path."""
STEPS = 60
"""Steps of one start; those that succeed need 5 to 20."""
CHUNK = 16
"""Problems in one piece of work of a thread."""
SERIAL_BELOW = 32
"""Problems below which a batch stays on one thread."""
KEPT = 64
"""Structures of tasks whose packed ties a system keeps, and sets of weights and tolerances kept
with each."""

TaskLevel = tuple[int, bool]
"""The priority of a task, and whether the task is soft."""


def get_task_level(task: Task) -> TaskLevel:
    """Return the level of a task: its priority, and whether the task is soft."""
    return int(task.priority), task.weight is not None


@dataclass(frozen=True, eq=False)
class Demands:
    """Packed tasks of a `Problem`, kept with the answer to explain failures.

    `pins` (N or 1, k) are the goals, `use` (tasks,) says which count, `limits` whether limits do.
    """

    system: Model
    tasks: tuple[Task, ...]
    packed: Packed = field(repr=False)
    goals: tuple[Goal, ...] = field(repr=False)
    pins: Array = field(repr=False)
    lead: tuple[int, ...]
    tolerance: tuple[float, float]
    starts: int
    rng: int
    use: tuple[bool, ...]
    mode: int = field(default=S.NOTHING, repr=False)
    """What the last stage leads towards: nothing, `aim`, or the address of a function."""
    aim: Array | None = field(default=None, repr=False)
    """Configurations (N or 1, nq) that the last stage leads towards."""
    callback: Callback | None = field(default=None, repr=False)
    limits: bool = True
    one_sided: bool = True
    """Whether declared one-sided constraints hold."""
    loose: bool = False
    """Whether nobody named a start, so that a free base may be moved before the first start."""
    iterations: int = STEPS
    time_limit: float | None = None
    end: float = math.inf
    """When the time is up, by `time.monotonic`."""
    effort: Callable[[], None] | None = field(default=None, repr=False)
    """How many calls of functions the search may make; None: as many as it takes."""
    given_up: int = 0
    """After how many calls of functions the search was given up; 0 where it was not."""
    kept: dict[Any, Any] = field(default_factory=dict[Any, Any], init=False, repr=False)
    """What functions worked out of this problem; a changed copy begins anew."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled problem; its callback has another address in this process."""
        vars(self).update(state)
        if self.callback is not None and self.mode not in (S.NOTHING, S.AHEAD):
            vars(self)["mode"] = self.callback.address

    def get_tolerance(self, task: Task) -> tuple[float, float]:
        """Return the largest error of a hard task in metres and radians."""
        return self.tolerance if task.tolerance is None else read_tolerances(task.tolerance)

    @property
    def hard_tasks(self) -> list[tuple[Task, Goal, tuple[float, float]]]:
        """Hard tasks that count, with their goals and tolerances."""
        every = zip(self.tasks, self.goals, self.use, strict=True)
        return [
            (task, goal, self.get_tolerance(task))
            for task, goal, used in every
            if used and task.weight is None
        ]

    def select_row(self, index: int) -> Demands:
        """Return the problem of row `index` of a batch."""
        pins = self.pins[index : index + 1] if len(self.pins) > 1 else self.pins
        aim = (
            self.aim[index : index + 1] if self.aim is not None and len(self.aim) > 1 else self.aim
        )
        goals = tuple(select_goal_rows(g, index, self.lead) for g in self.goals)
        return replace(self, goals=goals, pins=pins, aim=aim, lead=())

    def select_tasks(
        self, tasks: Sequence[int], limits: bool = True, one_sided: bool = True
    ) -> Demands:
        """Return the problem with only these tasks, without preference or time limit.

        It has at most `STARTS` starts.

        `limits` says whether joint limits count, `one_sided` whether one-sided constraints of the
        system do.
        """
        use = tuple(i in tasks for i in range(len(self.tasks)))
        few = min(self.starts, STARTS)
        return replace(
            self,
            use=use,
            limits=limits,
            one_sided=one_sided,
            mode=S.NOTHING,
            end=math.inf,
            effort=None,
            starts=few,
        )

    def run_search(
        self,
        starts: Array,
        threads: int | None = 1,
        *,
        tries: int | None = None,
        rows: np.ndarray | None = None,
    ) -> tuple[Array, np.ndarray]:
        """Search configurations (N, nq) from starts (N or 1, nq), for some `rows` or all.

        Also returns (status, steps, starts) (N, 3).

        `tries` are the starts at most, by default those of the problem.
        """
        loops = self.packed.loops
        n = math.prod(self.lead) if rows is None else len(rows)
        stages, strengths, *_ = self.levels
        weights = loops.weights if self.limits else remove_limits(self.system, loops)
        q = np.empty((n, self.system.nq))
        info = np.empty((n, 3), dtype=np.int64)
        aim = starts if self.aim is None else self.aim
        pins = self.pins
        timed = self.end < math.inf or self.effort is not None or list_checks()
        stop = get_clock().address if timed else 0
        if rows is not None:
            starts, aim, pins = (x[rows] if len(x) > 1 else x for x in (starts, aim, pins))
        most = self.starts if tries is None else min(tries, self.starts)

        def select_part(x: Array, i: int, j: int) -> Array:
            return x[i:j] if len(x) > 1 else x

        def search_rows(i: int, j: int) -> int:
            with watched_by(
                make_end_check(self.end), *(() if self.effort is None else (self.effort,))
            ):
                left = task_search.solve_tasks(
                    loops.ints,
                    loops.floats,
                    loops.plan,
                    weights,
                    stages,
                    strengths,
                    select_part(starts, i, j),
                    select_part(aim, i, j),
                    select_part(pins, i, j),
                    most,
                    self.iterations,
                    self.mode,
                    stop,
                    self.loose,
                    self.rng,
                    q[i:j],
                    info[i:j],
                )
            error = get_clock().take_error()
            # the time of a verb that asked
            if error is not None and not isinstance(error, EndReached):
                raise error
            return left

        sum_over_chunks(search_rows, n, CHUNK, threads, SERIAL_BELOW)
        callbacks = [t.function for t in loops.ties if t.function is not None] + [self.callback]
        for callback in callbacks:
            if isinstance(callback, Callback) and callback.error is not None:
                error = callback.error
                callback.error = None
                if not isinstance(error, EndReached):
                    raise error
        return self._restore_free_coordinates(
            self.packed.wrap_wide_angles(q) if self.limits else q, starts
        ), info

    def _restore_free_coordinates(self, q: Array, starts: Array) -> Array:
        """Set coordinates that no task depends on to their values in the starts, in place."""
        if self.mode != S.NOTHING:
            return q
        untouched = find_untouched_places(self.packed, self.pins)
        if untouched.size and not (q[:, untouched] == starts[:, untouched]).all():
            own = move_inside_limits(self.system, starts.copy()) if self.limits else starts
            sound = ~np.isnan(q).any(axis=1)
            q[np.ix_(sound, untouched)] = (own if len(own) == 1 else own[sound])[:, untouched]
        return q

    @property
    def levels(self) -> tuple[np.ndarray, Array, list[int], Array]:
        """Levels of the tasks as kernels read them, hard tasks, and their tolerances (hard, 2).

        Kernels read stage and hardness of each tie (2 ties,), and weights and tolerances (ties, 3).
        """
        key = (
            self.use,
            self.one_sided,
            self.tolerance,
            *((t.priority, t.weight, t.tolerance) for t in self.tasks),
        )
        found = self.packed.stages.get(key)
        if found is None:
            hard = [i for i, used in enumerate(self.use) if used and self.tasks[i].weight is None]
            allowed = np.array([self.get_tolerance(self.tasks[i]) for i in hard]).reshape(-1, 2)
            found = store_answer(
                self.packed.stages, key, (*self._compute_stages(), hard, allowed), KEPT
            )
        return found

    def _compute_stages(self) -> tuple[np.ndarray, Array]:
        """Compute stage and hardness (2 ties,), and weights and tolerances (ties, 3), of the ties."""
        keys = [get_task_level(t) for t in self.tasks]
        order = sorted({k for k, used in zip(keys, self.use, strict=True) if used})
        top = {
            k: max(t.weight or 0.0 for t, key in zip(self.tasks, keys, strict=True) if key == k)
            for k in keys
        }
        ties = self.packed.loops.ties
        length = self.packed.loops.length
        stages = np.zeros((2, len(ties)), dtype=np.int64)
        strengths = np.ones((len(ties), 3))
        stages[1] = 1
        strengths[:, 1:] = CLOSED
        for k, i in enumerate(self.packed.owner):
            if i < 0:
                stages[0, k] = -1 if ties[k].bounds and not self.one_sided else 0
                continue
            task = self.tasks[int(i)]
            key = keys[int(i)]
            stages[0, k] = order.index(key) + 1 if self.use[i] else -1
            stages[1, k] = task.weight is None
            linear, angular = self.get_tolerance(task)
            share = 1.0 if task.weight is None else task.weight / top[key]
            strengths[k] = (share, linear / length, angular)
        return stages.ravel(), strengths


def select_goal_rows(goal: Goal, index: int | np.ndarray, lead: tuple[int, ...]) -> Goal:
    """Return the goal of row `index` of a batch, or the goals of several rows."""
    pose = None if goal.pose is None else _select_row(goal.pose, index, lead, 2)
    numbers: Numbers = {n: _select_row(x, index, lead, 1) for n, x in goal.numbers.items()}
    return Goal(pose, numbers)


def _select_row(x: Array, index: int | np.ndarray, lead: tuple[int, ...], axes: int) -> Array:
    """Return rows `index` of numbers with a leading shape and `axes` axes of one goal."""
    core = x.shape[-axes:]
    return np.broadcast_to(x, (*lead, *core)).reshape(-1, *core)[index]
