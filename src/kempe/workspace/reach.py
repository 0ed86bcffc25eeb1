"""Studies of the reach of a frame: which poses of a list it reaches, and what blocks the others.

The other studies of reach ask the same of poses in slices: maps of capability and places of a base.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.tables import Tabular
from kempe.answers.targets import (
    choose_axis,
    choose_task,
    list_twist_rows,
    make_target_constraints,
    parse_task_targets,
    split_task,
)
from kempe.arguments import explain_errors, explain_method_errors, numbers, raise_interrupted
from kempe.arrays import check_range
from kempe.budget import Budget, TimeUp, Usual
from kempe.constraints.clearances import Apart
from kempe.errors import InputError
from kempe.forward.fk import jacobian
from kempe.geometry.path_clearance import read_clearances
from kempe.inverse.closed_forms.plan import find_plan_or_reason
from kempe.inverse.ik import ik
from kempe.inverse.ik_all import ik_all
from kempe.late import import_late_member
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import has_loops, list_units, name_values
from kempe.numerics.clock import BROKEN_OFF, TimeLimit, describe_early_end
from kempe.numerics.clock import LONG as CLOCK_LONG
from kempe.poses import check_poses, correct_rotations
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import Status, name_outcomes
from kempe.words import format_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.constraints.base import Constraint
    from kempe.model.model import FrameLike, Model


# ---- what is reached

USUAL = Usual("reach.poses", starts=1000, rng=0, threads=None, time_limit=CLOCK_LONG, progress=None)
UNKNOWN = -1
"""In place of a number of solutions, where it is not known, or infinite."""
SHOWN = 6
"""Poses that the text lists."""
PROVEN = [int(s) for s in Status if s.proof]


@dataclass(frozen=True, eq=False)
class ReachedPoses:
    """Results for poses (n,): whether they are `reached`, the number of `solutions`, and the best
    one.

    `solutions` are those inside the limits, `UNKNOWN` where it is not certain that all are known.
    `manipulability` and `margin` are the largest of those found, each by itself; `q` (n, nq) has
    the largest margin.
    """

    reached: np.ndarray
    solutions: np.ndarray
    manipulability: Array
    margin: Array
    q: Array
    code: np.ndarray


MOST = 10_000_000
"""Poses that one map may try."""
SLICE = 2048
LOOP_SLICE = 128
"""Poses that are tried at once, of a system with closed loops, where each takes longer: less than a
second's work."""
LONG = 16
"""Velocity coordinates, twice which make these poses fewer, for the work grows with their
square."""


def check_targets(X: Array) -> Array:
    """Check targets (n, ...), and replace slightly rounded poses (n, 4, 4) by exact ones.

    Errors: `InputError` that says which one has entries that are not finite, or is no pose.
    """
    if X.ndim == 3 and X.shape[1:] == (4, 4):
        return check_poses(correct_rotations(X, "targets"), "targets")
    return check_range(X, "targets")


def compute_manipulability(system: Model, frame: str, q: Array, task: str) -> Array:
    """Compute the manipulability sqrt(det(J J^T)) (...) at q (..., nq). J has the rows of the task,
    with lengths in characteristic lengths.

    Of a chain with fewer joints than rows it is sqrt(det(J^T J)). Source: Yoshikawa, Int. J.
    Robotics Res. 4 (1985).
    """
    axes = list_twist_rows(task, system.dim)
    J = jacobian(system, q, frame, "body")[..., axes, :]
    J[..., np.asarray(axes) < 3, :] /= float(compute_characteristic_length(system))
    J = J[..., np.abs(J).reshape(-1, J.shape[-1]).max(axis=0, initial=0.0) > 0.0]
    wide = J.shape[-1] >= J.shape[-2]
    G = J @ np.swapaxes(J, -1, -2) if wide else np.swapaxes(J, -1, -2) @ J
    return np.sqrt(np.maximum(np.linalg.det(G), 0.0))


def compute_margin(system: Model, q: Array) -> Array:
    """Compute the distances (...) of q (..., nq) from the nearest limit, in parts of half the
    range. They are 0 at the limit, 1 in the middle, inf without limits.
    """
    at_q = system.structure.layout.vector_q
    at_v = system.structure.layout.vector_v
    low = system.lower[at_v]
    high = system.upper[at_v]
    limited = np.isfinite(low) & np.isfinite(high) & (high > low)
    if not limited.any():
        return np.full(q.shape[:-1], np.inf)
    x = q[..., at_q[limited]]
    low = low[limited]
    high = high[limited]
    return (np.minimum(x - low, high - x) / (0.5 * (high - low))).min(axis=-1)


def reach_targets(
    system: Model,
    targets: Array,
    frame: str,
    task: Any,
    clearances: Sequence[Apart],
    budget: Budget,
) -> Any:
    """Return the answer of `ik` for targets (...), which keeps clearances."""
    if not clearances:
        return ik(system, targets, frame, task=task, budget=budget)
    said, axis = split_task(task)
    direction = choose_axis(axis, said)
    X, lead, is_position = parse_task_targets(system, targets, said, direction)
    name = choose_task(said, is_position, bool(system.structure.table.at[frame][2]))
    wanted = make_target_constraints(frame, name, direction, X.reshape(*lead, 4, 4))
    return ik(system, [*wanted, *clearances], budget=budget)


def study_targets(
    system: Model,
    targets: Array,
    frame: str,
    task: Any,
    clearances: Sequence[Apart],
    budget: Budget,
) -> ReachedPoses:
    """Study which `targets` (n, ...) are reached, and how well."""
    said, axis = split_task(task)
    particle = bool(system.structure.table.at[frame][2])
    name = choose_task(said, targets.shape[-2:] not in ((4, 4), (3, 3)), particle)
    every: Any = None
    if not isinstance(find_plan_or_reason(system, frame, name, choose_axis(axis, said)), str):
        every = ik_all(system, targets, frame, task=task, limits=True, clearance=clearances or None)
    # searches among bodies are long: they are for what the closed form does not decide
    decided = every.complete | every.success if clearances and every is not None else False
    left = np.flatnonzero(~np.broadcast_to(decided, len(targets)))
    first = np.full((len(targets), system.nq), np.nan)
    reached = np.zeros(len(targets), dtype=bool)
    code = np.full(len(targets), int(Status.NOT_FOUND)) if every is None else np.array(every.code)
    if len(left) or not len(targets):
        single = reach_targets(system, targets[left], frame, task, clearances, budget)
        first[left], reached[left], code[left] = single.q, single.success, single.code
    q = first[:, None]
    mask = reached[:, None]
    solutions = np.where(reached, UNKNOWN, np.where(np.isin(code, PROVEN), 0, UNKNOWN))
    if every is not None:
        solutions = np.where(every.complete, every.mask.sum(axis=-1), UNKNOWN)
        q = np.concatenate([q, every.q], axis=1)
        mask = np.concatenate([mask, every.mask], axis=1)
    w = np.full(mask.shape, np.nan)
    far = np.full(mask.shape, np.nan)
    if mask.any():
        w[mask], far[mask] = (
            compute_manipulability(system, frame, q[mask], name),
            compute_margin(system, q[mask]),
        )
    any_ = np.asarray(mask.any(axis=1))
    best = np.argmax(np.where(mask, far, -np.inf), axis=1)
    at = np.arange(len(q))
    return ReachedPoses(
        any_,
        np.where(any_ & (solutions == 0), UNKNOWN, solutions),
        np.where(any_, np.max(np.where(mask, w, -1.0), axis=1), np.nan),
        far[at, best],
        q[at, best],
        np.where(any_, int(Status.SOLVED), code),
    )


def refuse_many_poses(poses: int, fewer: str) -> None:
    """Refuse a map that would try more than `MOST` poses. Errors: `InputError`."""
    if poses > MOST:
        raise InputError(f"{poses} poses would be tried; {MOST} at most: take fewer {fewer}")


def study_places(
    system: Model,
    frame: str,
    task: Any,
    targets: Callable[[int, int], Array],
    shape: tuple[int, int],
    names: Sequence[str],
    spend: Budget,
    clearances: Sequence[Apart] = (),
) -> tuple[list[Array], Status | None]:
    """Study targets at many places: return fields of `ReachedPoses` as arrays (places, targets,
    ...). Also return what broke the work off, or None.

    `targets(first, last)` are those (last - first, targets, ...) of the places `first` to `last`.
    Slices of places are tried one after the other; those that were not before the time limit or an
    interrupt are NaN.
    """
    count, several = shape
    own = {"q": (system.nq,)}
    out = [np.full((*shape, *own.get(name, ())), np.nan) for name in names]
    clock = TimeLimit(spend.time_limit)
    each = Budget(starts=spend.starts, rng=spend.rng, threads=spend.threads)
    share = max(1, system.nv // LONG) ** 2
    at_once = max(1, (LOOP_SLICE if has_loops(system) else SLICE) // (max(several, 1) * share))
    try:
        with clock:
            for first in range(0, count, at_once):
                clock.check_time()
                X = targets(first, min(first + at_once, count))
                last = first + len(X)
                answer = study_targets(
                    system, X.reshape(-1, *X.shape[2:]), frame, task, clearances, each
                )
                for array, name in zip(out, names, strict=True):
                    array[first:last] = getattr(answer, name).reshape(array[first:last].shape)
                if spend.progress is not None:
                    spend.progress(last * several, count * several)
    except BROKEN_OFF as error:
        return out, Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    return out, None


# ---- the answer and the verb


class Study(Report):
    """A report on the poses that a frame of a system reaches. It may be `broken` off."""

    system: Model
    frame: str
    broken: Status | None

    @property
    def _subject(self) -> str:
        """The system and the frame, as the subject of sentences."""
        return f"{self.system.name}, {self.frame}"

    @property
    def _tail(self) -> str:
        """The end of a sentence about a study that was broken off, or ''."""
        return describe_early_end(
            self.broken is Status.INTERRUPTED, self.broken is Status.OUT_OF_TIME
        )


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class ReachStudy(Study, Tabular):
    """Study of the poses of a list: which a frame reaches, how well, and what blocks the others.

    Attributes
    ----------
    reached
        Mask (n,) of the reached poses.
    solutions
        Numbers (n,) of configurations inside the limits; -1 if infinite or not certain.
    manipulability, margin
        Best values (n,) of the solutions found; NaN without one. The margin is the distance of a
        joint from its nearest limit, as a share of half its range.
    q
        Configurations (n, nq) with the largest margin, or nearest to the pose.
    codes
        Numbers (n,) of `Status`.
    broken
        Reason if the time limit or an interrupt ended the study; the remaining poses have this
        code.
    """

    _has_angles = True
    _entries = ("system", "frame", "reached", "solutions", "manipulability", "margin")

    system: Model
    frame: str
    reached: np.ndarray
    solutions: np.ndarray
    manipulability: Array
    margin: Array
    q: Array
    codes: np.ndarray
    targets: Array
    task: Any
    budget: Budget
    broken: Status | None = None
    clearances: tuple[Apart, ...] = ()

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `SOLVED` (all poses reached), `PARTLY` (some), or `broken` if it is set."""
        if self.broken is not None:
            return self.broken
        if self.reached.all():
            return Status.SOLVED
        return Status.PARTLY if self.reached.any() else Status.NOT_FOUND

    @property
    def status(self) -> str:
        """The number of reached poses, as a sentence."""
        n = int(self.reached.sum())
        tried = int(self.tried.sum())
        return f"{self._subject}: {n} of {format_count(tried, 'pose')} reached{self._tail}"

    @property
    def tried(self) -> np.ndarray:
        """Mask (n,) of the poses that were tried: all, unless the study was broken off."""
        return self.codes != (-1 if self.broken is None else int(self.broken))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw all poses, and the system at the reached pose with the largest margin.

        Reached ones are dots, others crosses, those that were not tried rings.
        """
        return import_late_member("plots of workspaces").plot_reach(self, ax)

    def reason(self, index: int) -> str:
        """Return the sentence of `System.ik` for a pose: how it is reached, or what blocks it.
        Errors: `InputError`.
        """
        if not 0 <= index < len(self.reached):
            raise InputError(
                f"index is {index}; there are {format_count(len(self.reached), 'pose')}, from 0"
            )
        answer = reach_targets(
            self.system,
            self.targets[index],
            self.frame,
            self.task,
            self.clearances,
            self.budget,
        )
        return str(answer.status)

    @property
    def reasons(self) -> dict[int, str]:
        """Reasons why poses are not reached, by the number of the pose from 0."""
        return {i: self.reason(i) for i in np.flatnonzero(self.tried & ~self.reached).tolist()}

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and columns (n, nq) for a file: the configuration of each pose, or NaN."""
        q = np.where(self.reached[:, None], self.q, np.nan)
        return list(self.system.coordinate_names), q

    def _list_units(self) -> dict[str, str]:
        return list_units(self.system)

    def _list_notes(self, degrees: bool = False) -> list[str]:
        if not self.reached.any():
            lines = []
        else:
            worst = int(np.nanargmin(self.margin))
            lines = [f"least margin to limits: {self.margin[worst]:.3g} (pose {worst})"] * bool(
                np.isfinite(self.margin[worst])
            )
            least = int(np.nanargmin(self.manipulability))
            lines.append(f"least manipulability: {self.manipulability[least]:.3g} (pose {least})")
        blocked = np.flatnonzero(self.tried & ~self.reached).tolist()
        lines += [f"pose {i}: {self.reason(i)}" for i in blocked[:SHOWN]]
        return lines + [f"... and {len(blocked) - SHOWN} more"] * (len(blocked) > SHOWN)

    def _collect_data(self) -> dict[str, Any]:
        more = {"codes": name_outcomes(self.codes), "q": name_values(self.system, self.q)}
        reasons = {str(i): text for i, text in self.reasons.items()}
        return super()._collect_data() | more | {"reasons": reasons}


@explain_errors
@raise_interrupted
def reach_poses(
    system: Model,
    targets: ArrayLike,
    frame: FrameLike,
    *,
    task: str | tuple[str, ArrayLike] | None = None,
    clearance: Constraint | Sequence[Constraint] | None = None,
    budget: Budget | None = None,
) -> ReachStudy:
    """Study which poses of a list a frame reaches, how well, and what blocks the others.

    `targets` (n, 4, 4) are poses, or (n, 3) positions, in the ground frame, with `task` as
    `System.ik` takes them. A pose counts as reached where `ik` or, of chains with finitely many
    solutions, `ik_all` finds one inside the limits that keeps a `clearance`. Of the `budget` are
    read: starts (1000), rng (0), threads, time_limit (600 s), and progress(poses tried, all). After
    the time limit the study has what was done, after Ctrl-C the `answer` of the `Interrupted`.

    Errors: `InputError`, `UnknownNameError`.
    """
    spend = USUAL.complete_budget(budget)
    name = system.structure.frame_name(frame)
    X = numbers(targets, "targets")
    if X.ndim < 2 or (X.ndim == 2 and X.shape == (4, 4)):
        X = X[None]
    if X.ndim > 3 or (X.ndim == 3 and X.shape[1:] not in ((4, 4), (3, 3))):
        raise InputError(
            f"targets have shape {X.shape}; they must be a list: poses (n, 4, 4), rotations (n, 3, "
            f"3) or places (n, {system.dim})"
        )
    X = check_targets(X)

    clearances = () if clearance is None else tuple(read_clearances(clearance))
    names = ("reached", "solutions", "manipulability", "margin", "q", "code")
    fields, broken = study_places(
        system,
        name,
        task,
        lambda first, last: X[first:last, None],
        (len(X), 1),
        names,
        spend,
        clearances,
    )
    hit, solutions, w, far, q, codes = (array[:, 0] for array in fields)
    left = np.isnan(codes)
    each = replace(spend, time_limit=None, progress=None)
    if broken is not None:
        codes[left] = int(broken)
        solutions[left] = UNKNOWN
    return ReachStudy(
        system,
        name,
        hit == 1.0,
        solutions.astype(np.int64),
        w,
        far,
        q,
        codes.astype(np.int64),
        X,
        task,
        each,
        broken,
        clearances,
    )
