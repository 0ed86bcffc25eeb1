"""`ik` for tasks together with clearances: planes between near shapes, and restarts.

The tasks are solved first. Where shapes are then too near, a plane between each two of them,
fixed to one body, becomes a task: the nearest point of the other body stays beyond it. All is
solved again from there, with new planes, until the shapes keep their distance as coal measures it.
Other starts follow.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.answers.problem import Problem
from kempe.constraints.base import KINDS, Frame, Number, Op, Point, Row, make_rotations_along
from kempe.constraints.clearances import Apart
from kempe.constraints.kinds import Direction, Placed
from kempe.constraints.tape import POSE
from kempe.constraints.text import parse_tape
from kempe.equations.tasks import Goal, Task
from kempe.forward.fk import fk
from kempe.geometry.clearance import Watch, watch_clearances
from kempe.geometry.solids import Gap
from kempe.inverse.answer import Closest, Reached
from kempe.inverse.tasks.demands import Demands, find_untouched_places, select_goal_rows
from kempe.inverse.tasks.search import (
    make_checked_answer,
    pack_tasks,
    reach_tasks,
    solve_levels,
)
from kempe.kernels.base import search_layout as S
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import find_home, read_start, sample_configurations
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.model import Model

NEAR_START = "Posture of the start"
"""Label of the soft task of clearances that nothing else is asked with."""
ROUNDS = 8
"""Times that planes are laid from one start."""
WAVES = (4, 12, 44)
"""Starts that are tried at a time, for what the first start did not solve."""
TRIES = 3
"""Starts of the tasks alone for each start here."""
BAND = 0.05
"""How much further than asked shapes may be apart to get a plane, in characteristic lengths."""
MARGIN = 1e-5
"""By how much planes keep shapes further apart than asked, in characteristic lengths."""
HEIGHT = parse_tape("z + zx*px + zy*py + zz*pz", (*POSE, "px", "py", "pz"))
"""Height of a point of frame B over the plane z = 0 of A."""
DEEP = 1e3
"""How far below a body a plane lies that says nothing, in metres."""
FLAT = 1e-3
"""Part of a direction that lies in the plane of a planar system, below which it says nothing."""
SLANTED = np.array([[0.6, 0.48, 0.64], [0.8, 0.6, 0.0]])
"""Directions in space, and in the plane, that are parallel to no axis."""


@dataclass(frozen=True, eq=False)
class Beyond(Placed):
    """Task that a point of one body stays beyond a plane of another; all its numbers may vary."""

    frame: Frame
    other: Frame
    origin: Point
    normal: Direction
    px: Number
    py: Number
    pz: Number

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the height of the point over the plane."""
        return (Row(Op.TAPE, (HEIGHT, 0), "height", "m", low="zero"),)

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at `origin` whose z is the normal of the plane."""
        return self._make_poses_along(dim, "normal")


class State(NamedTuple):
    """Configurations (k, nq), whether they hold the hard tasks (k,), gaps of each, and by how much
    its distances fall short (k,).
    """

    q: Array
    held: np.ndarray
    gaps: list[list[Gap]]
    short: Array

    @property
    def solved(self) -> np.ndarray:
        """Whether the hard tasks hold, and all distances are kept."""
        return self.held & (self.short <= 0.0)


def reach_clear(problem: Problem) -> Reached:
    """Find a configuration that satisfies tasks and keeps clearances; see `System.ik`.

    Clearances alone are kept as near to the start as possible.
    """
    system = problem.system
    clearances = [t for t in problem.wanted if isinstance(t, Apart)]
    others = [t for t in problem.wanted if not isinstance(t, Apart)]
    watch = watch_clearances(system, clearances)
    if not others:
        start = find_home(system) if problem.start is None else read_start(system, problem.start)
        posture: Any = KINDS["posture"]
        others = [posture(start, name=NEAR_START)]
    answer = reach_tasks(problem._replace(wanted=others))
    threads = None if problem.budget is None else problem.budget.threads
    search = ClearSearch(answer.problem, watch, threads)
    return search.finish(answer, _make_labels(clearances, answer))


def _make_labels(clearances: Sequence[Apart], answer: Reached) -> list[str]:
    """Make different labels of clearances."""
    labels: list[str] = []
    for clearance in clearances:
        label = clearance.label
        count = 1
        while label in labels or label in answer.errors:
            count += 1
            label = f"{clearance.label} ({count})"
        labels.append(label)
    return labels


class ClearSearch:
    """Search for configurations that keep shapes apart, from those that hold the tasks alone."""

    def __init__(self, alone: Demands, watch: Watch, threads: int | None):
        self.alone = alone
        self.watch = watch
        self.threads = threads
        self.system: Model = alone.system
        self.length = compute_characteristic_length(self.system)
        self.priority = min((t.priority for t in alone.tasks), default=0)

    def finish(self, answer: Reached, labels: list[str]) -> Reached:
        """Lead an answer for the tasks alone away from what is too near."""
        lead = self.alone.lead
        n = math.prod(lead)
        q = np.reshape(answer.q, (n, self.system.nq)).copy()
        held = np.ravel(answer.success).astype(bool)
        steps, starts = (np.ravel(x).copy() for x in (answer.iterations, answer.starts))
        best = self._measure(q, held)
        late = False
        pending = np.flatnonzero(held & ~best.solved)
        if pending.size:
            first = _select_state(best, pending)
            late = self._lead_away(best, pending, first, steps)
        for wave, count in enumerate(WAVES):
            pending = np.flatnonzero(held & ~best.solved)
            count = min(count, self.alone.starts - 1 - sum(WAVES[:wave]))
            if not pending.size or count <= 0 or late:
                break
            starts[pending] += count
            rng = np.random.default_rng([self.alone.rng, wave])
            others = sample_configurations(self.system, rng, count)
            rows = np.repeat(pending, count)
            starts_at = np.tile(others, (len(pending), 1))
            hard = any(t.weight is None for t in self.alone.tasks)
            found = (
                self._solve(rows, starts_at, (), steps)
                if hard or self.alone.packed.closed
                else self._measure(starts_at, np.ones(len(rows), dtype=bool))
            )
            self._keep_best(best, rows, found)
            late = self._lead_away(best, rows, found, steps)
        return self._make_answer(answer, best, labels, steps, starts, late)

    def _lead_away(self, best: State, rows: np.ndarray, at: State, steps: np.ndarray) -> bool:
        """Lay planes and solve again for some rows, in place of `best`; whether time was up."""
        for _ in range(ROUNDS):
            open_ = np.flatnonzero(~best.solved[rows] & np.isfinite(at.short))
            if not open_.size:
                return False
            if time.monotonic() >= self.alone.end:
                return True
            rows = rows[open_]
            at = _select_state(at, open_)
            planes = lay_planes(self.system, self.watch, at.q, at.gaps, self.priority)
            at = self._solve(rows, at.q, planes, steps)
            self._keep_best(best, rows, at)
        return False

    def _keep_best(self, best: State, rows: np.ndarray, found: State) -> None:
        """Put configurations that hold the tasks in place of those that fall shorter."""
        for k in np.flatnonzero(found.held).tolist():
            row = rows[k]
            if max(found.short[k], 0.0) < max(best.short[row], 0.0):
                best.q[row] = found.q[k]
                best.short[row] = found.short[k]
                best.gaps[row] = found.gaps[k]

    def _measure(self, q: Array, held: np.ndarray) -> State:
        """Measure the gaps of configurations (k, nq)."""
        names = self.watch.solids.names
        gaps: list[list[Gap]] = []
        short = np.full(len(q), np.nan)
        X = fk(self.system, q, names).reshape(len(q), len(names), 4, 4)
        for k, poses in enumerate(X):
            found = (
                self.watch.list_gaps(poses, BAND * self.length) if np.isfinite(poses).all() else []
            )
            gaps.append(found)
            if np.isfinite(poses).all():
                short[k] = max(
                    (self.watch.at_least[g.couple] - g.distance for g in found), default=-math.inf
                )
        return State(q, held, gaps, np.maximum(short, -BAND * self.length))

    def _solve(
        self, rows: np.ndarray, q: Array, planes: tuple[Beyond, ...], steps: np.ndarray
    ) -> State:
        """Solve the tasks of some rows with planes, from configurations (k, nq), and measure."""
        part = _select_rows(self.alone, rows)
        if planes:
            part = _add_tasks(part, tuple(Task(self.system, p) for p in planes))
        tries = 1 if planes else TRIES
        found, info = solve_levels(
            part, np.ascontiguousarray(q), lambda p, b, t: p.run_search(b, t, tries=tries),
            self.threads,
        )  # fmt: skip
        np.add.at(steps, rows, info[:, 1])
        return self._measure(found, info[:, 0] == S.SOLVED)

    def _make_answer(
        self,
        answer: Reached,
        best: State,
        labels: list[str],
        steps: np.ndarray,
        starts: np.ndarray,
        late: bool,
    ) -> Reached:
        """Make the answer from the best configuration of each row."""
        lead = self.alone.lead
        n = len(best.q)
        info = np.zeros((n, 3), dtype=np.int64)
        code = np.ravel(answer.code).astype(np.int64)
        info[:, 0] = code
        info[:, 1] = steps
        info[:, 2] = starts
        checked = make_checked_answer(self.alone, best.q, info)
        codes = np.ravel(checked.code).astype(np.int64)
        codes[code != Status.SOLVED] = code[code != Status.SOLVED]
        short = np.isfinite(best.short) & (best.short > 0.0) & (codes == Status.SOLVED)
        codes[short] = Status.OUT_OF_TIME if late else Status.NOT_FOUND
        errors = dict(checked.errors)
        for k, label in enumerate(labels):
            each = np.zeros((n, 2))
            for row, gaps in enumerate(best.gaps):
                own = [
                    self.watch.at_least[g.couple] - g.distance
                    for g in gaps
                    if self.watch.of[g.couple] == k
                ]
                each[row, 0] = max([0.0, *own])
            errors[label] = each.reshape(*lead, 2)
        return replace(
            checked,
            success=(codes == Status.SOLVED).reshape(lead) if lead else codes[0] == 0,
            code=codes.reshape(lead) if lead else Status(int(codes[0])),
            errors=errors,
            closest=Closest.from_rows([self.watch.find_worst(gaps) for gaps in best.gaps]),
        )


def lay_planes(
    system: Model, watch: Watch, q: Array, gaps: list[list[Gap]], priority: int
) -> tuple[Beyond, ...]:
    """Lay a plane between each two near shapes at q (k, nq), fixed to the body of the first.

    Where only some of the configurations have a gap between two bodies, the plane of the others
    lies far below.
    """
    length = compute_characteristic_length(system)
    body = watch.solids.body_of[watch.couples]
    X = fk(system, q, watch.solids.names).reshape(len(q), len(watch.solids.names), 4, 4)
    slots: dict[tuple[str, str, int], list[tuple[int, Gap]]] = {}
    for k, near in enumerate(gaps):
        counts: dict[tuple[str, str], int] = {}
        for gap in sorted(near, key=lambda g: g.distance):
            pair = watch.name_bodies(gap.couple)
            slot = counts[pair] = counts.get(pair, -1) + 1
            slots.setdefault((*pair, slot), []).append((k, gap))
    slanted = SLANTED[3 - system.dim]
    nothing = np.array([-DEEP * length * slanted, slanted, 0.1 * length * slanted])
    out: list[Beyond] = []
    for number, (key, used) in enumerate(sorted(slots.items(), key=lambda item: item[0])):
        rows = np.array([k for k, _ in used])
        own = [gap for _, gap in used]
        couples = [gap.couple for gap in own]
        a, b = body[couples[0]]
        height = watch.at_least[couples] + MARGIN * length
        made = _make_planes(own, height, X[rows, a], X[rows, b], system.dim)
        sound = np.isfinite(made).all(axis=(0, 2))
        plane = np.repeat(nothing[:, None], len(q), axis=1)
        plane[:, rows[sound]] = made[:, sound]
        out.append(
            Beyond(
                key[1],
                key[0],
                plane[0],
                plane[1],
                *plane[2].T,
                name=f"plane {number + 1}",
                priority=priority,
                tolerance=1e-6 * length,
            )
        )
    return tuple(out)


def _make_planes(gaps: Sequence[Gap], height: Array, A: Array, B: Array, dim: int) -> Array:
    """Make planes between shapes on bodies at A and B (n, 4, 4): origins, normals, points (3, n, 3).

    They are `height` (n,) before the nearest points of the first shapes. Not finite without a
    direction, and in a planar system where the direction leaves the plane.
    """
    points = np.array([gap.points for gap in gaps])
    n = np.array([gap.normal for gap in gaps])
    p = points[:, 0] + height[:, None] * n
    r = points[:, 1]
    if dim == 2:
        across = np.hypot(n[:, 0], n[:, 1])[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            over = n[:, 2:] * (r[:, 2:] - p[:, 2:]) / across
            n = np.where(across > FLAT, n / across, np.nan)
        n[:, 2] = 0.0
        p = p - over * n
        p[:, 2] = r[:, 2] = 0.0
    else:
        with np.errstate(invalid="ignore"):
            n = n / np.linalg.norm(n, axis=1, keepdims=True)
    turned = np.stack([p - A[:, :3, 3], n, r - B[:, :3, 3]])
    R = np.stack([A, A, B])[..., :3, :3]
    return np.einsum("cnji,cnj->cni", R, turned)


def _select_state(state: State, at: np.ndarray) -> State:
    """Return some rows of a state."""
    return State(state.q[at], state.held[at], [state.gaps[k] for k in at], state.short[at])


def _select_rows(problem: Demands, rows: np.ndarray) -> Demands:
    """Return the problem of some rows, as a batch; rows may repeat."""
    goals = tuple(select_goal_rows(g, rows, problem.lead) for g in problem.goals)
    pins = problem.pins[rows] if len(problem.pins) > 1 else problem.pins
    aim = problem.aim
    aim = aim[rows] if aim is not None and len(aim) > 1 else aim
    return replace(problem, goals=goals, pins=pins, aim=aim, lead=(len(rows),))


def _add_tasks(problem: Demands, added: tuple[Task, ...]) -> Demands:
    """Return a batch of problems with further tasks."""
    tasks = (*problem.tasks, *added)
    packed = pack_tasks(problem.system, tasks, problem.packed.turns)
    goals = (*problem.goals, *(t.goal for t in added))
    if find_untouched_places not in packed.stages:
        # by planes that are parallel to nothing: those at hand may be blind to a coordinate
        dim = problem.system.dim
        slanted = spatial.pose(make_rotations_along(SLANTED[3 - dim], dim))
        planes = [
            Goal(slanted, {n: np.full(1, 0.1) for n in g.numbers}) for g in goals[-len(added) :]
        ]
        pins = packed.pack_pins((*problem.goals, *planes), problem.lead)
        find_untouched_places(packed, pins)
    return replace(
        problem,
        tasks=tasks,
        packed=packed,
        goals=goals,
        pins=packed.pack_pins(goals, problem.lead),
        use=(True,) * len(tasks),
    )
