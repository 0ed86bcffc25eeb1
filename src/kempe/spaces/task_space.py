"""The task space of a system: the image of its configuration space under a task.

It is described by counts of freedoms, by ranks, and by bounds of the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import (
    DRAWN,
    explain_errors,
    explain_method_errors,
    make_generator,
    read_start_count,
)
from kempe.budget import Budget, TimeUp, Usual, check_for_stop
from kempe.constraints import KINDS
from kempe.constraints.base import Constraint
from kempe.equations import closure_rows
from kempe.equations.packed_tasks import count, jacobian, units
from kempe.errors import InputError, format_value
from kempe.forward.fk import fk
from kempe.mobility.independent import compute_tangent_space
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import (
    compute_mid_configuration,
    has_loops,
    name_values,
    read_finite_q,
    sample_configurations,
)
from kempe.numerics.clock import SHORT, find_time_limit, limit_time
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Report, Table
from kempe.spaces.manifold import Manifold
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import choose_verb, format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- ranks of rates

# The rank of what a system moves: of rates of tasks or frames over the velocities that loops leave.

ROUNDED = 1e-13
CLOSED = 1e-9
"""Rate, of rows in radians or characteristic lengths, up to which it is rounding: of trees, and
where loops are closed within a tolerance. Rounding of places grows with their distance from the
origin."""


def compute_image_ranks(
    system: Model, q: Array, rates: Array, metres: np.ndarray
) -> tuple[np.ndarray, int]:
    """Compute ranks (k,) of rates (k, m, nv) for the velocities that loops allow at q (k, nq). Also
    return the least freedoms.

    `metres` (m,) says which rows are lengths: these are measured in characteristic lengths, so that
    ranks do not depend on the unit of length. A singular value counts where it is above
    `Level.GENERIC` of the largest, and above rounding.
    """
    out = list[int]()
    n = system.nv
    loops = has_loops(system)
    N = np.eye(system.nv)
    scale = closure_rows.compute_coordinate_units(system)
    length = compute_characteristic_length(system)
    row_unit = np.where(metres, length, 1.0)[:, None]
    far = np.abs(fk(system, q)[..., :3, 3]).max(axis=(-2, -1), initial=0.0) / length
    for x, J, away in zip(q, rates, far.tolist(), strict=True):
        N = compute_tangent_space(system, x)[0] if loops else N
        n = min(n, N.shape[1])
        rounding = (CLOSED if loops else ROUNDED) * (1.0 + away)
        moved = J @ (scale[:, None] * N) / row_unit
        out.append(Spectrum(moved, rounding / Level.GENERIC).compute_rank(Level.GENERIC))
    return np.array(out, dtype=int), n


# ---- the task space

SEEN = 10_000
"""Further configurations of a tree, which cost next to nothing, that bound the image."""
OF_FRAMES = ("pose", "position")
"""Kinds of constraints that a frame alone stands for."""
USUAL = Usual("task_space", starts=64, rng=0, time_limit=SHORT)
SOME = 8
"""Configurations whose ranks are found between two looks at the clock."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class TaskSpace(Report):
    """Task space of `m` constraints over a configuration space of dimension `n`.

    Attributes
    ----------
    rank
        Number of directions in which the task can move at `q` (nq,).
    generic_rank
        Largest rank at random configurations: the dimension of the image.
    redundancy
        Number of freedoms that the task leaves.
    image
        Least and largest coordinates [m] of a frame's origin at random configurations, by axis. The
        reached set is at least as wide.
    samples
        Number of configurations that were examined.
    late
        Whether the time limit ended the work.
    """

    _entries = (
        "system",
        "task",
        "m",
        "n",
        "rank",
        "generic_rank",
        "redundancy",
        "dependent",
        "singular",
        "image",
        "samples",
    )
    _has_angles = True

    system: Model
    task: str
    m: int
    n: int
    rank: int
    generic_rank: int
    q: Array
    image: dict[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    samples: int = 0
    late: bool = False
    """Whether the time limit ended the work: ranks are those of the samples that were looked at."""

    @property
    def redundancy(self) -> int:
        """Degrees of freedom that remain while the task is fulfilled, at generic configurations."""
        return self.n - self.generic_rank

    @property
    def dependent(self) -> int:
        """Number of constraints of the task that depend on the others, at generic configurations."""
        return self.m - self.generic_rank

    @property
    def singular(self) -> bool:
        """Whether the task loses rank at `q` compared to generic configurations."""
        return self.rank < self.generic_rank

    @property
    def status(self) -> str:
        """Comparison of m, n and the rank, and the consequence for solutions, as a sentence."""
        k = self.generic_rank
        m = self.m
        n = self.n
        counts = f"m = n = {n}" if m == n else f"m = {m} {'<' if m < n else '>'} n = {n}"
        if m > n:
            lucky = (
                f"unless the {format_count(m, 'constraint')} {choose_verb(m, 'is', 'are')} "
                "dependent"
            )
            said = f"no solution {lucky}: what can be reached has dimension {k}"
        elif k < m:
            said = f"{format_count(m - k, 'constraint')} of the task cannot be set independently"
        elif n > k:
            said = (
                f"redundant by {format_count(n - k, 'degree')} of freedom: infinitely many configurations "
                "reach each point"
            )
        else:
            said = "finitely many configurations reach each point, except at singular ones"
        here = (
            f"; at this q the rank is {self.rank}, a singular configuration"
            if self.singular
            else ""
        )
        seen = format_count(self.samples, "random configuration")
        late = f"; the time limit ended the work after {seen}" if self.late else ""
        return f"{self.task}: {counts}, rank {k}; {said}{here}{late}"

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `OUT_OF_TIME` if the time limit ended the computation early."""
        return Status.OUT_OF_TIME if self.late else Status.SOLVED

    def _make_headline(self) -> str:
        return f"{self.system.name}: {self.status}"

    def _make_tables(self) -> Sequence[Table]:
        rows = [
            (f"{axis} [m]", f"from {a:.6g} to {b:.6g}, at least")
            for axis, (a, b) in self.image.items()
        ]
        return [Table((), rows, record=True)] if rows else []

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"q": name_values(self.system, self.q)}


@explain_errors
@limit_time(USUAL)
def task_space(
    system: Model,
    tasks: Any,
    q: Any = None,
    *,
    task: str | None = None,
    budget: Budget | None = None,
) -> TaskSpace:
    """Compute the dimension, the ranks and bounds of the image of tasks; see `System.task_space`."""
    spend = USUAL.complete_budget(budget)
    wanted, name, frame = _read_tasks(system, tasks, task)
    rng = make_generator(spend.rng)
    drawn = _draw_configurations(system, read_start_count(spend.starts, DRAWN), rng)
    at = drawn[0] if q is None else read_finite_q(system, q)
    every = np.concatenate([at[None], drawn])
    m = sum(count(system, t) for t in wanted)
    metres = np.array([unit == "m" for t in wanted for unit in units(system, t)])
    time = find_time_limit(USUAL)
    ranks = list[int]()
    n = system.nv
    time.release_reserved_time()
    try:
        for k in range(0, len(every), SOME):
            check_for_stop()
            some = every[k : k + SOME]
            rates = np.concatenate([jacobian(system, t, some) for t in wanted], axis=-2)
            found, freedoms = compute_image_ranks(system, some, rates, metres)
            ranks += found.tolist()
            n = min(n, freedoms)
    except TimeUp:
        if not ranks or not time.spent:
            raise
        drawn = drawn[: len(ranks) - 1]
    rank = int(ranks[0])
    generic = int(max(ranks))
    image = dict[str, tuple[float, float]]()
    p = np.empty((0, 3))
    if frame is not None:
        seen = (
            drawn
            if has_loops(system)
            else np.concatenate([drawn, sample_configurations(system, rng, SEEN)])
        )
        seen = seen[Manifold(system, 1).are_allowed(seen)]
        p = fk(system, seen, frame, form="position")
    if frame is not None and len(p):
        image = {
            axis: (float(p[:, i].min()), float(p[:, i].max()))
            for i, axis in enumerate("xyz"[: system.dim])
        }
    return TaskSpace(system, name, m, n, rank, generic, at.copy(), image, len(drawn), time.spent)


def _read_tasks(
    system: Model, tasks: Any, task: str | None
) -> tuple[list[Constraint], str, FrameLike | None]:
    """Read the tasks, their names, and the frame if the task is one of a frame."""
    name: Any = tasks
    if isinstance(tasks, Constraint) or (isinstance(tasks, (list, tuple)) and tasks):
        if task is not None:
            raise InputError(
                "task says what counts of a frame; with tasks of kempe.tasks leave it out"
            )
        given: list[Any] = [tasks] if isinstance(tasks, Constraint) else list(name)
        wrong = [t for t in given if not isinstance(t, Constraint)]
        if wrong:
            raise InputError(f"{format_value(wrong[0])} is no task; see kempe.tasks")
        return given, ", ".join(t.label for t in given), None
    frame = system.structure.frame_name(name)
    kind = "pose" if task is None else task
    if kind not in OF_FRAMES:
        raise InputError(f"task is {task!r}; it must be one of {', '.join(map(repr, OF_FRAMES))}")
    X = fk(system, compute_mid_configuration(system), frame)
    made: Any = KINDS[kind]
    return [made(frame, X if kind == "pose" else X[:3, 3])], f"{kind} of {frame!r}", frame


def _draw_configurations(system: Model, count: int, rng: np.random.Generator) -> Array:
    """Draw random configurations (k, nq), closed if there are loops."""
    if not has_loops(system):
        return sample_configurations(system, rng, count)
    q = Manifold(system, 1).draw_configurations(rng, count)
    if not len(q):
        raise InputError(
            f"{system.name} was not closed from {count} random starts: it has no configuration to "
            "look at"
        )
    return q
