"""Several tasks and the loops of their system, packed as one set of equations."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.arguments import explain_errors
from kempe.arrays import check_range
from kempe.constraints.base import Constraint
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.tasks import TILTS, Goal, Task
from kempe.errors import InputError
from kempe.model.configurations import read_q
from kempe.model.constraint_program import GROUND, Tie
from kempe.model.coordinates import find_wound_coordinates
from kempe.model.own_tree import remove_cut_marks
from kempe.model.packed_loops import PackedLoops, pack_loops
from kempe.model.primitive_table import Table
from kempe.poses import check_poses
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

ROUNDING = 1e-9
"""How far a coordinate may be outside its limits."""


def refuse_goal(goal: Goal, what: str) -> None:
    """Raise `InputError` with the reason why a kernel refused a goal."""
    if goal.pose is not None:
        check_poses(goal.pose, f"the goal of {what}")
    for number in goal.numbers.values():
        check_range(number, f"the goal of {what}")


def find_leading_shape(goals: Sequence[Goal]) -> tuple[int, ...]:
    """Find the leading shape of goals.

    Errors: `InputError` where shapes do not fit together.
    """
    shapes = {g.pose.shape[:-2] for g in goals if g.pose is not None}
    shapes |= {x.shape[:-1] for g in goals for x in g.numbers.values()}
    try:
        return shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(
            f"the goals have leading shapes that do not fit together: {sorted(shapes)}"
        ) from None


def _find_wide_angles(system: Model, tasks: Sequence[Task]) -> np.ndarray:
    """Find the angles (nv,) that may change by a whole turn within their limits.

    Nothing else may depend on their number of turns.
    """
    table = remove_cut_marks(system).structure.table
    c = system.structure.coordinates
    with np.errstate(invalid="ignore"):
        wide = c.turning & np.isfinite(c.upper - c.lower) & (c.upper - c.lower >= 2.0 * np.pi)
    for v in np.flatnonzero(wide):
        rows = table.iv == v
        wide[v] = np.sum(rows) == 1 and abs(table.multiplier[rows][0]) == 1.0
    bound = {n for r in system.structure.relations for n in (r.of, *r.sources)}
    for task in tasks:
        bound |= task.list_coordinates()
    wide = wide & ~find_wound_coordinates(system.mechanism, c)
    return wide & np.array(
        [name not in bound for name in system.structure.velocity_names], dtype=bool
    )


class Packed:
    """Tasks of a system as ties, together with its loops and relations, which always hold.

    Lengths are measured in `length` (default: the characteristic length). `owner` (ties,) is the
    number of the task of each tie, -1 for a loop. With `turns`, angles with limits a whole turn
    apart or more count as having none (`wide`): `wrap_wide_angles` brings them back. `levels` are those of
    the tasks: ties stand in their order, loops with the first. Tasks are about the frames of
    `system`, loops are those of `closing`, by default the same (see `find_ideal_system`).
    """

    def __init__(
        self,
        system: Model,
        tasks: Sequence[Task | Constraint],
        length: float | None = None,
        turns: bool = False,
        levels: Sequence[int] = (),
        closing: Model | None = None,
    ):
        made_of = (Task(system, t) if isinstance(t, Constraint) else t for t in tasks)
        self.system = system
        self.tasks = tuple(made_of)
        self.turns = turns
        owner: dict[int, int] = {}
        made: list[Tie] = []

        def make_task_ties(table: Table) -> list[Tie]:
            """Make the ties of all tasks, and note which task each belongs to."""
            for i, task in enumerate(self.tasks):
                for tie in task.make_ties(table):
                    owner[id(tie)] = i
                    made.append(tie)
            return made

        self.wide = (
            _find_wide_angles(system, self.tasks) if turns else np.zeros(system.nv, dtype=bool)
        )
        self.closing = closing or system
        tree = remove_cut_marks(self.closing)
        explicit = frozenset(tree.structure.closures)
        drawn = remove_cut_marks(system) if self.closing is not system else None
        of: Callable[[Tie], int] = lambda tie: levels[owner[id(tie)]] if id(tie) in owner else 0  # noqa: E731
        level = of if any(levels) else None
        self.one_sided = pack_one_sided_rows(self.closing)
        """One-sided rows of the system; those that are declared hold, too."""
        bounded = self.one_sided.declared > 0
        self.loops: PackedLoops = pack_loops(
            tree,
            explicit,
            length=length,
            further=make_task_ties,
            wide=self.wide,
            level=level,
            one_sided=bounded,
            drawn=drawn,
        )
        self.stages: dict[Hashable, Any] = {}
        """What solvers have worked out of weights and priorities."""
        self.scale: Array = self.loops.scale
        self.owner = np.array([owner.get(id(t), -1) for t in self.loops.ties], dtype=np.int64)
        owners: list[int] = self.owner.tolist()
        asked = [(tie, i) for tie, i in zip(self.loops.ties, owners, strict=True) if i >= 0]
        self.pinned = [(tie, i) for tie, i in asked if tie.pin]
        self.numbered = [(name, i) for tie, i in asked for name in tie.numbers]
        """Ties that read the pose of a goal, and names of numbers of goals that ties read, with their
        tasks."""
        self.rows = np.repeat(self.owner, [len(t.row_names) for t in self.loops.ties])
        """Task of each equation; -1 for loops, -2 for what holds of itself, -3 for declared ones
        between bounds."""
        bounds = [
            i < 0 and bool(t.bounds) for i, t in zip(self.owner, self.loops.ties, strict=True)
        ]
        self.rows[np.repeat(bounds, [len(t.row_names) for t in self.loops.ties])] = -3
        ends = np.cumsum([len(t.row_names) for t in self.loops.ties], dtype=np.int64) - 1
        self.rows[ends[[system.dim == 2 and t.turns in TILTS for t in self.loops.ties]]] = -2
        self.closed = bool(np.any(self.rows == -1))
        """Whether loops or relations hold, too."""
        at = system.structure.layout.vector_q
        v = system.structure.layout.vector_v
        which = slice(len(at)) if np.array_equal(at, np.arange(len(at))) else at
        self.limits = which, system.lower[v] - ROUNDING, system.upper[v] + ROUNDING
        """Places in q of what has limits, and these."""
        wide = self.wide[v]
        self._turning = list(
            zip(at[wide], system.lower[v][wide], system.upper[v][wide], strict=True)
        )

    def wrap_wide_angles(self, q: Array) -> Array:
        """Bring wide angles of configurations (N, nq) into their limits by whole turns, in place."""
        for i, a, b in self._turning:
            x = q[:, i]
            x -= 2.0 * np.pi * np.ceil(np.maximum(x - b, 0.0) / (2.0 * np.pi))
            x += 2.0 * np.pi * np.ceil(np.maximum(a - x, 0.0) / (2.0 * np.pi))
        return q

    def count_equations(self, tasks: Sequence[int], bounded: bool = False) -> int:
        """Count the equations of some tasks.

        In the plane, those that hold of themselves do not count.
        """
        trivial = TILTS if self.system.dim == 2 else ()
        ties = [
            t
            for t, i in zip(self.loops.ties, self.owner, strict=True)
            if i in tasks and (bounded or not t.bounds)
        ]
        return sum(len(t.row_names) - (t.turns in trivial) for t in ties)

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Low and high bounds (m,) of the tasks' rows; zero for equations.

        They are in radians and characteristic lengths.
        """
        low, high = self.loops.bounds[:, self.rows >= 0]
        return low, high

    def pack_pins(self, goals: Sequence[Goal], lead: tuple[int, ...] = ()) -> Array:
        """Pack the goals of tasks as the numbers (N or 1, k) that kernels read."""
        poses = [(tie, _compute_pinned_pose(tie, goals[i])) for tie, i in self.pinned]
        numbers = [goals[i].numbers[name] for name, i in self.numbered]
        out = np.empty((*lead, 12 * len(poses) + sum(x.shape[-1] for x in numbers)))
        at = 0
        for tie, pose in poses:
            top = out[..., at : at + 12].reshape(*lead, 3, 4)  # a view
            # a frame that stands; kernels put the pin in its place
            fixed = tie.a is not GROUND and tie.a[0] < 0
            top[...] = (tie.a[1] @ pose if fixed else pose)[..., :3, :]
            if tie.a is GROUND:
                top[..., 3] -= self.loops.origin
            at += 12
        for x in numbers:
            out[..., at : at + x.shape[-1]] = x
            at += x.shape[-1]
        return out.reshape(math.prod(lead), out.shape[-1])

    def evaluate_tasks(
        self, q: Any, pins: Array | None = None, closures: bool = False
    ) -> tuple[Array, Array]:
        """Compute residuals (..., m) and Jacobian (..., m, nv) of the tasks at q (..., nq).

        With `closures`, those of the loops instead.
        """
        import kempe.kernels.compiled as kernels

        q = read_q(self.system, q)
        lead = q.shape[:-1]
        loops = self.loops
        m = len(self.rows)
        flat_q = q.reshape(math.prod(lead), self.system.nq)
        if pins is None:
            goals = [t.goal for t in self.tasks]
            pins = self.pack_pins(goals, lead if find_leading_shape(goals) else ())
        out = np.empty((len(flat_q), m))
        J = np.empty((len(flat_q), m, self.system.nv))
        kernels.closure_batch.evaluate_equations(
            loops.ints, loops.floats, loops.plan, loops.weights, pins, flat_q, True, out, J
        )
        loops.raise_function_error()
        use = self.rows == -1 if closures else self.rows >= 0
        out = out[:, use]
        J = J[:, use]
        return out.reshape(*lead, out.shape[1]), J.reshape(*lead, *J.shape[1:])


def _compute_pinned_pose(tie: Tie, goal: Goal) -> Array:
    """Compute the pose (..., 4, 4) where a tie is pinned: the goal's, moved by its numbers."""
    pose = goal.pose
    assert pose is not None
    if not any(tie.shift):
        return pose
    axes = [k for k in range(3) if tie.mask >> k & 1]
    steps = np.broadcast_arrays(*(goal.numbers[n][..., 0] for n in tie.shift if n))
    p = np.zeros((*steps[0].shape, 3))
    p[..., [k for k, name in zip(axes, tie.shift, strict=True) if name]] = np.stack(steps, axis=-1)
    return pose @ spatial.pose(p=p)


# ---- one constraint: values, derivatives and units


@explain_errors
def error(system: Model, constraint: Constraint, q: Any) -> Array:
    """Compute the residuals (..., m) of a constraint at q (..., nq), in metres and radians.

    They are zero where the constraint holds; bounds of inequalities are not subtracted.
    """
    return _pack_single_constraint(system, constraint).evaluate_tasks(q)[0]


@explain_errors
def jacobian(system: Model, constraint: Constraint, q: Any) -> Array:
    """Compute the exact derivatives (..., m, nv) of `error` by the velocity coordinates."""
    return _pack_single_constraint(system, constraint).evaluate_tasks(q)[1]


@explain_errors
def count(system: Model, constraint: Constraint) -> int:
    """Count the equations of a constraint, inequalities included."""
    return _pack_single_constraint(system, constraint).count_equations([0], True)


@explain_errors
def units(system: Model, constraint: Constraint) -> tuple[str, ...]:
    """Return the unit of each equation of `error`: "m", "rad" or "1"."""
    alone = _pack_single_constraint(system, constraint)
    return tuple(unit for unit, row in zip(alone.loops.units, alone.rows, strict=True) if row >= 0)


@explain_errors
def miss(system: Model, constraint: Constraint, q: Any) -> tuple[Array, Array]:
    """Measure the violation (...) of a constraint at q (..., nq), in metres and radians.

    The forward model measures it, independently of the equations that solvers use.

    Where loops are open, bodies are where solvers place them (`kempe.model.own_tree`).
    """
    return Task(remove_cut_marks(system), constraint).measure_error(read_q(system, q))


def _pack_single_constraint(system: Model, constraint: Constraint) -> Packed:
    """Pack one constraint, with lengths in metres."""
    return Packed(system, [constraint], length=1.0)
