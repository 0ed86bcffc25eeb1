"""Constraints that one call requests: their goals, ties for the kernels, and errors.

The forward model measures the errors.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Hashable
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.constraints.base import (
    HERE,
    Constraint,
    Op,
    Row,
    evaluate_number_fields,
    find_value_field,
    is_one_sided,
    read_numbers,
)
from kempe.description.mechanism import is_orientation_dependent
from kempe.equations.judge import FRAME_ROWS, Numbers, RowShape, make_row_shape, measure_rows
from kempe.equations.task_functions import bind_constraint
from kempe.errors import InputError
from kempe.forward.fk import fk
from kempe.kernels.constraints import loop_layout as L
from kempe.model.configurations import refuse_unreadable
from kempe.model.constraint_program import (
    GROUND,
    Centre,
    End,
    Tie,
    format_input_name,
    get_input_number,
    get_row_bounds,
    has_varied_bounds,
    list_recorded_numbers,
    list_varied_ends,
    make_ties,
)
from kempe.model.model import keep_answers
from kempe.model.primitive_table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

TILTS = (L.ALIGN, L.LOOK)
"""Ties on an axis, whose second equation holds of itself in the plane."""
WRITTEN = (Op.TAPE, Op.CALL, Op.COORDINATE)
"""Operations that read coordinates, or expressions and functions of them."""
FAR = 1e6
"""Where a bound is put that only some targets have, in metres."""
PoseFunction = Callable[[Any], Array]
"""Function that gives the pose (..., 4, 4) of a frame by its name. A list of names, or None for all
bodies, gives (..., n, 4, 4)."""


class Goal(NamedTuple):
    """The goal of a task in one call: the pose (..., 4, 4) of frame A, and numbers by name.

    The numbers are (..., k).
    """

    pose: Array | None
    numbers: Numbers


class RowFacts(NamedTuple):
    """Facts about the rows of a constraint: units, and what the rows read."""

    lengths: bool
    """Whether their error has a part in metres."""
    angles: bool
    """Whether their error has a part in radians or plain numbers."""
    lasting: bool
    """Whether their ties can be kept for the next task of the same structure."""
    placed: bool
    """Whether they hold a point."""
    written: bool
    """Whether they hold coordinates, or values of expressions or functions."""
    compares: bool
    """Whether they are compared with numbers of the constraint."""
    velocity: bool
    """Whether some of them are about velocities."""


@lru_cache(maxsize=512)
def collect_row_facts(rows: tuple[Row, ...]) -> RowFacts:
    """Collect facts about the rows of a constraint: units, and what the rows read."""
    ops = {r.op for r in rows}
    units = {r.unit for r in rows}
    compares = any(r.equal or r.low or r.high for r in rows)
    written = not ops.isdisjoint(WRITTEN)
    return RowFacts(
        "m" in units,
        units != {"m"},
        Op.CALL not in ops,
        Op.POINT in ops,
        written,
        compares or written,
        any(r.velocity for r in rows),
    )


class Task:
    """A constraint that is requested of a system in one call.

    Its structure decides which ties kernels get; its goal comes with each call. Errors:
    `InputError` where no configuration has what the constraint is about, or its fields do not fit;
    `UnknownNameError` for coordinates that do not exist.
    """

    def __init__(self, system: Model, constraint: Constraint):
        rows = constraint.list_rows(system.dim)
        constraint.check_fields(system.dim)
        facts = collect_row_facts(rows)
        if facts.velocity:
            raise InputError(
                f"{constraint.label} is about velocities, which no configuration has: declare it "
                "by Mechanism.constrain"
            )
        self.system = system
        self.label = constraint.label
        self.weight = constraint.weight
        self.priority = constraint.priority
        self.tolerance = constraint.tolerance
        self.name = constraint.name
        made = constraint
        if facts.written:
            known = system.structure.parameters
            made = bind_constraint(
                system, evaluate_number_fields(constraint.resolve_names(known), known)
            )
            refuse_unreadable(system, made.coordinate_names, self.label)
            rows = made.list_rows(system.dim)
            facts = collect_row_facts(rows)
        self.of: Any = made
        self.rows = rows
        self.lengths = facts.lengths
        self.angles = facts.angles
        self.lasting = facts.lasting
        self.compares = facts.compares
        """Whether rows are compared with numbers."""
        self.bounded = self.compares and any(is_one_sided(made, r) for r in rows)
        """Whether some of its rows are held between bounds."""
        self.varied = self.bounded and any(has_varied_bounds(made, r) for r in rows)
        """Whether bounds differ from target to target."""
        self.central = facts.placed and made.ends[1] is None
        """Whether a centre of masses takes the place of frame B."""
        self.tool = made.make_tool_pose(system.dim)
        a, b = made.ends
        self.frames = (
            None if a is None else system.structure.frame_name(a),
            None if b is None else system.structure.frame_name(b),
        )
        """Names of the frames A and B; None for the ground, and where there is no frame B."""
        self.structure = object()
        """Stands for all but the goal: tasks that differ in nothing else have the same one."""
        self._written = facts.written
        self._goal: Goal | None = None

    def copy_without_tolerance(self) -> Task:
        """Copy the task without a tolerance of its own."""
        out = copy.copy(self)
        out.structure = object()
        out.tolerance = None
        return out

    def copy_with_goal(self, constraint: Constraint) -> Task | None:
        """Copy the task with the goal of a constraint that differs in nothing else.

        None where the constraint has to be looked at.
        """
        if self._written or any([getattr(constraint, name) is None for name in constraint.goals]):
            return None
        out = object.__new__(Task)  # `copy` takes three times as long
        out.__dict__.update(self.__dict__, of=constraint, _goal=None)
        return out

    @property
    def frame_shape(self) -> RowShape | None:
        """Parts of the pose of a frame that the task holds; None where it holds anything else."""
        others = [r for r in self.rows if r.op is not Op.POINT]
        plain = all(r.op in FRAME_ROWS for r in self.rows) and len(others) <= 1
        valued = any(find_value_field(self.of, r) for r in self.rows if r.op is not Op.DISTANCE)
        if self.frames[1] is None or not plain or valued:
            return None
        return make_row_shape(self.rows, self.system.dim)

    @cached_property
    def structure_key(self) -> Hashable:
        """The key of the task's ties: tasks with the same key have the same ties.

        Goals may differ.

        Errors: `InputError` for bounds that leave nothing between them.
        """
        made: Constraint = self.of
        numbers: tuple[Any, ...] = ()
        if self.compares:
            varied = tuple([self._list_varied_ends(r) for r in self.rows])
            values = tuple([bool(find_value_field(made, r)) for r in self.rows])
            bounds = [
                get_row_bounds(made, r) if is_one_sided(made, r) and not ends else None
                for r, ends in zip(self.rows, varied, strict=True)
            ]
            numbers = varied, values, tuple(bounds)
        shares = self._shares if self.central else None
        return type(made), self.frames, self.tool, self.rows, numbers, shares

    def _list_varied_ends(self, row: Row) -> tuple[str, ...]:
        """List the bounds of a row that come with each call."""
        return list_varied_ends(self.of, row) if self.varied else ()

    # ---- ties

    def make_ties(self, table: Table) -> list[Tie]:
        """Make the ties of the task; `table` has the bodies' frames.

        Errors: `InputError` where axes of a particle are read.
        """
        a, b = self.frames
        A = GROUND if a is None else table.at[a]
        B = GROUND
        if b is not None:
            row, X, particle = table.at[b]
            B = (row, X @ np.reshape(self.tool, (4, 4)), particle)
            self._refuse_axes_of_particles(A, B)
        centre = self._compute_centre(table) if self.central else None
        return make_ties(self.system, self.label, self.of, A, B, True, centre)

    def _refuse_axes_of_particles(self, A: End, B: End) -> None:
        """Raise `InputError` where the task reads axes of a particle."""
        turned = B[2] and (
            any(map(is_orientation_dependent, self.rows)) or any(self.tool[k] for k in (3, 7, 11))
        )
        beside = any(r.op is not Op.DISTANCE for r in self.rows)
        leaned = A[2] and (beside or np.any(self.of.make_goal_poses(self.system.dim)[..., :3, 3]))
        if turned or leaned:
            raise InputError(
                f"{self.frames[1 if turned else 0]!r} is a particle, which has no axes: "
                f"{self.label} cannot be required of it"
            )

    @cached_property
    def _shares(self) -> tuple[tuple[str, tuple[float, ...], float], ...]:
        """Frames, points on them, and their parts of the whole mass."""
        shares = self.of.list_masses(self.system._mechanism.bodies, self.system.name)
        return tuple((self.system.structure.frame_name(m.frame), m.point, m.part) for m in shares)

    def _compute_centre(self, table: Table) -> Centre:
        """Compute the masses, and first moments of mass, on the rows of the table."""
        rows = np.zeros((len(table.kind), 4))
        rest = np.zeros(3)
        for frame, point, mass in self._shares:
            row, X, _ = table.at[frame]
            p = X[:3, :3] @ point + X[:3, 3]
            if row < 0:
                rest += mass * p
            else:
                rows[row] += mass, *(mass * p)
        return Centre(rows, rest)

    def list_coordinates(self) -> set[str]:
        """List the velocity coordinates whose whole turns change the task's error."""
        first = self.system.structure.coordinates.first
        found: set[int] = set()
        if not collect_row_facts(self.rows).written:
            return set()
        for tie in make_ties(self.system, self.label, self.of, GROUND, GROUND, True):
            if tie.tape is not None:
                found |= {first[n][1] for n in tie.tape.coordinates}
            if tie.function is not None:
                found |= set(tie.function.support)
            if tie.own >= 0:
                found.add(tie.own)
        return {self.system.structure.velocity_names[v] for v in found}

    # ---- the goal, and how far it is missed

    @property
    def goal(self) -> Goal:
        """The goal of this call, read once: the pose of frame A, and the numbers.

        Bounds that only some targets have are far away for the others. Errors: `InputError`.
        """
        if self._goal is None:
            self._goal = self._read_goal()
        return self._goal

    def _read_goal(self) -> Goal:
        """Read the goal from the constraint."""
        made = self.of
        posed = self.frames[1] is not None or self.central
        numbers: Numbers = {}
        for row in self.rows if self.compares else ():
            varied = self._list_varied_ends(row)
            for field in [getattr(row, end) for end in varied] or [find_value_field(made, row)]:
                if field:
                    name = format_input_name(field, row.part)
                    x = self._read_number(name)
                    numbers[name] = np.clip(x, -FAR, FAR) if varied else x
            if row.op is Op.TAPE:
                numbers |= {
                    n: self._read_number(n)
                    for n in list_recorded_numbers(made, self.system.dim, row.args[0])
                    if n not in numbers
                }
            if row.op is Op.COORDINATE:
                numbers[row.args[2]] = made.read_row_values(row)
        return Goal(made.make_goal_poses(self.system.dim) if posed else None, numbers)

    def _read_number(self, name: str) -> Array:
        """Read a number (..., 1) of the constraint by name."""
        return read_numbers(get_input_number(self.of, name), f"{name} of {self.label}")[..., None]

    def measure_error(
        self, q: Array, goal: Goal | None = None, poses: PoseFunction | None = None
    ) -> tuple[Array, Array]:
        """Measure the task's errors (...) at q (..., nq), in metres and radians.

        The forward model gives the poses.

        `goal` is its own, where it is at hand; `poses` gives the poses of frames in place of the
        forward model.
        """
        pose, numbers = self.goal if goal is None else goal
        poses = poses or partial(fk, self.system, q)
        A = None
        B = None
        if pose is not None:
            a, b = self.frames
            A = pose if a is None else poses(a) @ pose
            B = self._compute_centre_pose(poses) if b is None else poses(b)
            if self.tool is not HERE:
                B = B @ np.reshape(self.tool, (4, 4))
        with np.errstate(invalid="ignore", over="ignore"):  # of goals that are not finite
            return measure_rows(self.system, self.of, self.rows, q, A, B, numbers)

    def _compute_centre_pose(self, poses: PoseFunction) -> Array:
        """Compute the pose (..., 4, 4) at the centre of masses, in axes of the ground."""
        names, moments = _compute_moments(self.system, self._shares)
        return spatial.pose(p=np.einsum("...kij,kj->...i", poses(names)[..., :3, :], moments))


@keep_answers
def _compute_moments(
    system: Model, points: tuple[tuple[str, tuple[float, ...], float], ...]
) -> tuple[list[str] | None, Array]:
    """Compute frames and moments (n, 4), whose products with the poses sum to a centre.

    The frames are None for all bodies.
    """
    # all bodies are quicker than some
    names = list(dict.fromkeys([*system.body_names, *(f for f, _, _ in points)]))
    moments = np.zeros((len(names), 4))
    for f, p, mass in points:
        moments[names.index(f)] += *(mass * x for x in p), mass
    return None if len(names) == len(system.body_names) else names, moments
