"""Proofs that hard tasks do not hold: one is out of reach, or two contradict each other.

A frame is out of reach of another, or of the ground, where the lengths of the chain between them
say so. Two tasks on one rigid body fix the distance of their points, the angle of their axes, or
the whole of both. Points of two bodies are at most as far apart as the links between them are long.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe import spatial
from kempe.constraints.base import Op
from kempe.equations.tasks import Goal, Task
from kempe.kernels.constraints import loop_layout as L
from kempe.model.constraint_program import get_row_bounds
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.length_bounds import (
    GROUND,
    compute_distance_bounds,
    compute_reach_bounds,
    measure_bound_excess,
)
from kempe.poses import EXACT as RIGID
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.tasks.demands import Demands

SLACK = 1e-9
"""What is left to rounding, in radians and parts of the lengths."""

# ---- tasks out of reach


def find_unreachable_problems(problem: Demands) -> np.ndarray:
    """Find the problems (...) with a hard task that is out of reach."""
    out = np.zeros(problem.lead, dtype=bool)
    for i, (task, goal) in enumerate(zip(problem.tasks, problem.goals, strict=True)):
        if problem.use[i] and task.weight is None:
            out = out | compute_excess_distances(problem, task, goal).any(axis=-1)
    return out


def compute_excess_distances(problem: Demands, task: Task, goal: Goal) -> Array:
    """Compute how far (..., 2) [m] a task's position, and its pose, are out of reach.

    It is a lower bound of the error in its place; zero where lengths say nothing, or within the
    tolerances.
    """
    system = remove_cut_marks(problem.system)
    shape = task.frame_shape
    a, b = task.frames
    base = GROUND if a is None else system.structure.table.at[a]
    if shape is None or task.bounded or goal.pose is None or b is None or base[2]:
        return np.zeros((1, 2))
    if not shape.mask or shape.turns not in (L.NO_TURN, L.FULL, L.ANGLE):
        return np.zeros((1, 2))
    row, X, particle = system.structure.table.at[b]
    tip = (row, X @ np.reshape(task.tool, (4, 4)), particle)
    bounds, freedoms = compute_reach_bounds(system, tip, base)
    # else that is the reason
    turned = shape.turned and freedoms >= (3 if system.dim == 2 else 6)
    return measure_bound_excess(
        bounds, goal.pose, problem.get_tolerance(task), turned, sorted(shape.axes), system.dim
    )


# ---- tasks that contradict each other


class Exclusion(NamedTuple):
    """How two tasks exclude each other, and by how much (...); 0 where they do not.

    `how` is a key of `wording.CONTRADICTIONS`; `longest` is the greatest distance [m] that links
    allow.
    """

    how: str
    off: Array
    longest: float = 0.0


class Region(NamedTuple):
    """Region of a point: bounds (n,) along axes of the goal."""

    axes: tuple[int, ...]
    low: Array
    high: Array


class BodyDemand(NamedTuple):
    """Demand of a task on one body: the pose of its frame in the ground and on the body."""

    row: int
    goal: Array
    local: Array
    point: bool
    turn: bool
    axis: bool
    region: Region | None
    linear: float
    angular: float


def list_contradictions(problem: Demands) -> list[tuple[int, int, Exclusion]]:
    """List the pairs of hard tasks that exclude each other somewhere in the batch."""
    hard = [i for i, t in enumerate(problem.tasks) if problem.use[i] and t.weight is None]
    held = {i: h for i in hard if (h := _read_body_demand(problem, i)) is not None}
    out: list[tuple[int, int, Exclusion]] = []
    for i, j in combinations(held, 2):
        out += [
            (i, j, x) for x in _list_exclusions(problem, held[i], held[j]) if np.any(x.off > 0.0)
        ]
    return out


def find_contradictory_problems(problem: Demands) -> np.ndarray:
    """Find the problems (...) with two hard tasks that exclude each other."""
    out = np.zeros(problem.lead, dtype=bool)
    for _, _, found in list_contradictions(problem):
        out = out | (found.off > 0.0)
    return out


def _read_body_demand(problem: Demands, i: int) -> BodyDemand | None:
    """Read what a task demands of one body; None for tasks of other kinds."""
    task = problem.tasks[i]
    system = remove_cut_marks(problem.system)
    goal = problem.goals[i].pose
    shape = task.frame_shape
    a, b = task.frames
    if shape is None or goal is None or b is None or task.varied or a is not None:
        return None
    if shape.turns not in (L.NO_TURN, L.FULL, L.ANGLE, L.ALIGN):
        return None
    row, X, particle = system.structure.table.at[b]
    if particle or row < 0:
        return None
    linear, angular = problem.get_tolerance(task)
    angular += 2.0 * RIGID  # a goal's rotation may be off by rounding
    region = None
    point = shape.point and not task.bounded
    if shape.mask and not point:
        rows = [r for r in task.rows if r.op is Op.POINT]
        low, high = np.array(
            [get_row_bounds(task.of, r) if task.bounded else (0.0, 0.0) for r in rows]
        ).T
        region = Region(shape.axes, low, high)
    local = X @ np.reshape(task.tool, (4, 4))
    axis = shape.turns == L.ALIGN
    return BodyDemand(int(row), goal, local, point, shape.turned, axis, region, linear, angular)


def _list_exclusions(problem: Demands, a: BodyDemand, b: BodyDemand) -> list[Exclusion]:
    """List how much the demands of two tasks differ, by each argument that applies."""
    if a.row != b.row:
        if not (a.point and b.point):
            return []
        system = remove_cut_marks(problem.system)
        _, longest = compute_distance_bounds(
            system, (a.row, a.local, False), (b.row, b.local, False)
        )
        apart = np.linalg.norm(a.goal[..., :3, 3] - b.goal[..., :3, 3], axis=-1)
        slack = longest + a.linear + b.linear + SLACK * (1.0 + apart)
        return [Exclusion("links", np.where(apart > slack, apart, 0.0), longest)]
    return [*_compare_orientations(a, b), *_compare_places(a, b)]


def _compare_orientations(a: BodyDemand, b: BodyDemand) -> list[Exclusion]:
    """Compute the angle [rad] between the orientations that two tasks ask of one body."""
    slack = a.angular + b.angular
    if a.turn and b.turn:
        off = np.linalg.norm(
            spatial.log_so3(
                np.swapaxes(_compute_body_rotation(a), -1, -2) @ _compute_body_rotation(b)
            ),
            axis=-1,
        )
        return [Exclusion("turns", _remove_slack(off, slack))]
    if not (a.turn or a.axis) or not (b.turn or b.axis):
        return []
    if a.axis and b.axis:
        off = np.abs(
            _compute_angle(a.goal[..., :3, 2], b.goal[..., :3, 2])
            - _compute_angle(a.local[:3, 2], b.local[:3, 2])
        )
    else:
        whole, axis = (a, b) if a.turn else (b, a)
        off = _compute_angle(
            _compute_body_rotation(whole) @ axis.local[:3, 2], axis.goal[..., :3, 2]
        )
    return [Exclusion("axes", _remove_slack(off, slack))]


def _compare_places(a: BodyDemand, b: BodyDemand) -> list[Exclusion]:
    """Compute the distance [m] between the places that two tasks ask of one body's points."""
    arm = b.local[:3, 3] - a.local[:3, 3]
    length = float(np.linalg.norm(arm))
    out: list[Exclusion] = []
    slack = a.linear + b.linear
    if a.point and b.point:
        p = a.goal[..., :3, 3]
        g = b.goal[..., :3, 3]
        off = np.abs(np.linalg.norm(g - p, axis=-1) - length)
        how = "point" if length <= SLACK else "points"
        out.append(Exclusion(how, _remove_slack(off, slack, p, g)))
        for whole, sign in ((a, 1.0), (b, -1.0)):
            if whole.turn:
                off = np.linalg.norm(
                    g - p - sign * (sign * _compute_body_rotation(whole) @ arm), axis=-1
                )
                out.append(
                    Exclusion(how, _remove_slack(off, slack + 2.0 * whole.angular * length, p, g))
                )
    for point, there in ((a, b), (b, a)):
        if point.point and there.region is not None:
            axes, low, high = there.region
            way = there.local[:3, 3] - point.local[:3, 3]
            p = point.goal[..., :3, 3]
            more = slack + length
            if point.turn:
                p = p + _compute_body_rotation(point) @ way
                more = slack + 2.0 * point.angular * length
            x = np.einsum("...ji,...j->...i", there.goal[..., :3, :3], p - there.goal[..., :3, 3])[
                ..., axes
            ]
            off = np.linalg.norm(x - np.clip(x, low, high), axis=-1)
            out.append(Exclusion("region", _remove_slack(off, more, p, there.goal[..., :3, 3])))
    return out


def _compute_body_rotation(h: BodyDemand) -> Array:
    """Compute the rotation (..., 3, 3) of the body that a task asks for."""
    return h.goal[..., :3, :3] @ h.local[:3, :3].T


def _compute_angle(a: Array, b: Array) -> Array:
    """Compute the angle (...) between directions."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))


def _remove_slack(off: Array, slack: float, *sizes: Array) -> Array:
    """Return `off` where it exceeds the slack and rounding, else 0; NaN becomes 0."""
    size = 1.0 + sum(np.linalg.norm(x, axis=-1) for x in sizes)
    return np.where(off > slack + SLACK * size, off, 0.0)
