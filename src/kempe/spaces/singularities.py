"""Singular configurations of a frame and of closed loops: found, named, and traced as curves.

The answer also finds the nearest one to a configuration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.tables import Tabular
from kempe.answers.targets import Z_AXIS
from kempe.arguments import (
    DRAWN,
    call_until_interrupt,
    check_name,
    explain_errors,
    explain_method_errors,
    make_generator,
    raise_interrupted,
    read_flag,
    read_start_count,
)
from kempe.assemble.same_configuration import get_metric
from kempe.budget import Budget, TimeUp, Usual
from kempe.errors import InputError, Interrupted
from kempe.first_order.control import find_driven_velocities
from kempe.forward.fk import jacobian
from kempe.inverse.closed_forms.branch_names import Kind, name_branches, recognise_kind
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.inverse.closed_forms.plan import find_plan_or_reason
from kempe.late import import_late_member
from kempe.model.configurations import (
    find_free_angles,
    has_loops,
    list_units,
    name_values,
    read_finite_q,
    sample_configurations,
    shorten_turns,
)
from kempe.model.model import keep_answers
from kempe.numerics.clock import (
    BROKEN_OFF,
    TIME_LIMIT,
    TimeLimit,
    describe_early_end,
    limit_preparation_time,
)
from kempe.report import Report
from kempe.spaces.rank_loss import RankLoss
from kempe.spaces.singular_curves import USUAL as CURVES_USUAL
from kempe.spaces.singular_curves import SingularCurves, find_singular_curves, make_held_equations
from kempe.spaces.singular_types import (
    CONSTRAINT,
    OF_FRAMES,
    SAME,
    SERIAL,
    LostAndGained,
    NearestSingular,
    RankAnalysis,
    SingularSet,
    are_inside_limits,
    describe_changes,
)
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import ByName, format_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike, Model


# ---- names for six-joint arms

BORDER = " singular"


def name_singularities(system: Model, frame: str | None, q: Array) -> list[str]:
    """Name each configuration (k, nq) "shoulder", "elbow", "wrist", several of them, or ""."""
    named = None if frame is None else _find_named_arm(system, frame)
    if named is None or not len(q):
        return [""] * len(q)
    kind, lines = named
    theta = lines.compute_theta(q[:, lines.q_index])
    found = name_branches(kind, lines, theta, np.ones(len(q), dtype=bool))
    return [
        " and ".join(w.removesuffix(BORDER) for w in name.split(", ") if w.endswith(BORDER))
        for name in found
    ]


@keep_answers
def _find_named_arm(system: Model, frame: str) -> tuple[Kind, Lines] | None:
    """Find the kind of an arm and its joint axes; None if its branches have no names."""
    plan = find_plan_or_reason(system, frame, "pose", Z_AXIS)
    if isinstance(plan, str):
        return None
    kind = recognise_kind(plan, system.dim == 2)
    return None if kind is None else (kind, plan.lines)


# ---- singular configurations

USUAL = Usual("singularities", starts=64, rng=0, time_limit=TIME_LIMIT, progress=None)
AT_ONCE = 16
"""Starts between which the time is looked at."""
MATTERS = 1e-4
"""How far, of 1, a coordinate must be from the directions of the set, to matter."""
BESIDE = 1e-3
"""How far, in radians and characteristic lengths, a configuration may be from one that is more
singular, to be it."""
FARTHER = 20.0 * BESIDE
"""Singular value, as a part of the largest, above which none is looked for so near."""
NEAR = 6
"""Configurations of each set from which the nearest is searched for."""
SEED = 1888
ROUNDS = 6
AROUND = 16
CLOSER = 0.5
"""Rounds in which so many configurations around the nearest one so far, nearer each time, are led
to the set."""
FULL_TURN = 2.0 * np.pi


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Singularities(Report, Tabular):
    """Singular configurations of a frame, in sets of the same type.

    Attributes
    ----------
    sets
        The sets found. A set that is missing may exist.
    starts
        Number of random starts.
    broken
        Reason if the time limit or an interrupt ended the search; the sets are then those of the
        finished starts.
    """

    _entries = ("system", "frame", "task", "starts", "limits")
    _has_angles = True

    system: Model
    frame: str | None
    task: str
    sets: tuple[SingularSet, ...]
    starts: int
    limits: bool
    analysis: RankAnalysis
    problems: dict[str, RankLoss]
    broken: Status | None = None

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `NOT_FOUND` if no set was found, or the reason why the search ended early."""
        return self.broken or (Status.SOLVED if self.sets else Status.NOT_FOUND)

    @property
    def status(self) -> str:
        """The number of sets and their names, as a sentence."""
        of = f"{self.system.name}, {self.frame} ({self.task})" if self.frame else self.system.name
        within = " inside the limits" if self.limits else ""
        tail = describe_early_end(
            self.broken is Status.INTERRUPTED, self.broken is Status.OUT_OF_TIME
        )
        if not self.sets:
            return (
                f"{of}: no singular configuration found{within}, from "
                f"{format_count(self.starts, 'start')}{tail}"
            )
        found = format_count(len(self.sets), "set")
        return (
            f"{of}: {found} of singular configurations{within}, from "
            f"{format_count(self.starts, 'start')}{tail}"
        )

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and columns (n, nq) for a file: the configurations of all sets."""
        rows = [q for s in self.sets for q in s.q]
        return list(self.system.coordinate_names), np.reshape(rows, (-1, self.system.nq))

    def _list_units(self) -> dict[str, str]:
        return list_units(self.system)

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return [
            f"{s}: dimension {s.dimension}, {describe_changes(s.local[0].lost, s.local[0].gained)}"
            for s in self.sets
        ]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"sets": [self._make_set_data(s) for s in self.sets]}

    def _make_set_data(self, s: SingularSet) -> dict[str, Any]:
        unit = list_units(self.system)
        values = ByName(s.coordinates, [unit[name] for name in s.coordinates], s.values)
        return s.to_data() | {"values": values, "q": name_values(self.system, s.q)}

    def nearest(self, q: Any) -> NearestSingular:
        """Find the singular configuration nearest to a closed configuration, over all sets.

        Parameters
        ----------
        q
            Closed configuration (nq,).

        Returns
        -------
        NearestSingular
            A local minimum of the distance, found from several points of each set.

        Raises
        ------
        InputError
            For wrong shapes or values.
        """
        q = read_finite_q(self.system, q)
        found = [self._find_nearest(s, q) for s in self.sets]
        if not found:
            none = np.zeros((0, 6))
            return NearestSingular(
                self.system,
                q,
                np.inf,
                (),
                "",
                none,
                none,
                np.zeros((0, self.system.nv)),
                {},
                Status.NOT_FOUND,
            )
        distances: dict[str, float] = {}
        for s, (_, d) in zip(self.sets, found, strict=True):
            distances[str(s)] = min(d, distances.get(str(s), np.inf))
        i = int(np.argmin([d for _, d in found]))
        there, distance = found[i]
        local = self.analysis.describe_local_twists(there, self.problems)
        s = self.sets[i]
        return NearestSingular(
            self.system,
            there,
            distance,
            local.kinds or s.kinds,
            s.name,
            local.lost,
            local.gained,
            local.self_motion,
            distances,
        )

    def plot(
        self, *, ax: Any = None, budget: Budget | None = None, **options: Any
    ) -> tuple[Axes, ...]:
        """Draw configurations of the sets in Matplotlib axes, with lost and gained twists.

        Arrows show directions of the frame: of turns in the plane there is the centre with an arc,
        in space the axis (dotted). Of a planar system whose sets are curves the last axes have
        these. At most four configurations are drawn. `ax` are as many axes to draw on, the `budget`
        is that of `curves`, of which what was done is drawn (after Ctrl-C in the `answer` of an
        `Interrupted`); `options` are those of `System.plot`.
        Errors: `InputError` where no set was found.
        """
        plots = import_late_member("plots of singularities")
        curves = call_until_interrupt(plots.find_shown_curves, self, budget)
        axes = plots.plot_singularities(self, curves, ax=ax, **options)
        if curves is not None and curves.broken is Status.INTERRUPTED:
            raise Interrupted(axes)
        return axes

    def curves(
        self,
        *,
        hold: Mapping[str, float] | None = None,
        orientation: Any = None,
        budget: Budget | None = None,
    ) -> SingularCurves:
        """Trace the curves of singular configurations, and the curves that the frame draws.

        Only sets that are curves are traced. In the plane these are the curves on which a frame's
        position loses a direction, and all curves of systems with two freedoms.

        Parameters
        ----------
        hold
            Values of coordinates by name, which cut larger sets to curves.
        orientation
            Orientation of the frame that cuts larger sets to curves; in the plane an angle in
            radians.
        budget
            Reads step (0.05, in radians and characteristic lengths), time_limit (120 s) and
            progress(configurations done, all).

        Raises
        ------
        InputError
            If the sets are larger than curves.
        UnknownNameError
            If there is no such coordinate.

        Notes
        -----
        If the answer has `limits`, curves end at them.
        """
        clock = TimeLimit(CURVES_USUAL.complete_budget(budget).time_limit)
        rows, held = make_held_equations(self, hold, orientation)
        problems = {kind: replace(p, further=rows) for kind, p in self.problems.items()}
        starts = [(s.kinds, s.name, q) for s in self.sets for q in s.q]
        if held:
            near = np.concatenate([*(s.q for s in self.sets), self.analysis.starts])
            with limit_preparation_time(CURVES_USUAL, clock):
                led = _find_singular_rows(
                    self.analysis, problems, dict.fromkeys(problems, near), self.task, self.limits
                )
            starts = [(kinds, name, q) for (kinds, name, _), (q, _) in led if kinds]
        return find_singular_curves(self, problems, starts, held, budget, clock)

    def _find_nearest(self, s: SingularSet, q: Array) -> tuple[Array, float]:
        """Find the configuration of a set that is nearest to q, and its distance."""
        problem = self.problems[s.kinds[-1]]
        starts = s.q[np.argsort(self._compute_distances(s.q, q))[:NEAR]]
        best, far = self._choose_best(
            s, q, starts, problem.find_singular(np.concatenate([[q], starts]), home=q)
        )
        rng = np.random.default_rng(SEED)
        nv = self.system.nv
        sizes = [far, 0.5 * far, *(far * CLOSER**k for k in range(1, ROUNDS))]
        # limits cut the set off, and there may be several nearest points
        for k, size in enumerate(sizes):
            centre, many = (q, 5 * AROUND) if k < 2 else (best, AROUND)
            aside = np.zeros((many, nv))
            aside[:, self.analysis.columns] = rng.normal(size=(many, len(self.analysis.columns)))
            aside *= size / np.sqrt(max(1, len(self.analysis.columns)))
            tried = problem.find_singular(
                self._clip_to_limits(
                    problem.move_configurations(np.repeat(centre[None], many, axis=0), aside)
                )
            )
            best, far = self._choose_best(s, q, best[None], tried)
        return best, far

    def _clip_to_limits(self, x: Array) -> Array:
        """Clip configurations (k, nq) to the limits, where these count."""
        if self.limits:
            layout = self.system.structure.layout
            at = layout.vector_q
            v = layout.vector_v
            x[:, at] = np.clip(x[:, at], self.system.lower[v], self.system.upper[v])
        return x

    def _choose_best(
        self, s: SingularSet, q: Array, starts: Array, led: Array
    ) -> tuple[Array, float]:
        """Choose the configuration nearest to q, and its distance. Those of `starts` are in the
        set, those of `led` may be.
        """
        problem = self.problems[s.kinds[-1]]
        led = led[np.isfinite(led).all(axis=1)]
        if s.coordinates:  # a start near another set may have been led there
            names = self.system.structure.velocity_names
            columns = self.analysis.columns
            own = [
                tuple(names[i] for i in _find_deciding_columns(problem, x, columns))
                == s.coordinates
                for x in led
            ]
            led = led[np.array(own, dtype=bool)]
            led = (
                led[[name == s.name for name in name_singularities(self.system, self.frame, led)]]
                if s.name
                else led
            )
        if self.limits:
            led = led[are_inside_limits(self.system, led)]
        led = np.concatenate([led, starts])
        far = self._compute_distances(led, q)
        i = int(np.argmin(far))
        return led[i], float(far[i])

    def _compute_distances(self, x: Array, q: Array) -> Array:
        """Compute the distances (k,) of configurations x (k, nq) from q. Unlimited joints turn the
        short way.
        """
        v = shorten_turns(
            self.system.structure.layout.compute_difference(q, x), find_free_angles(self.system)
        )
        return np.linalg.norm((v / self.analysis.unit)[:, self.analysis.columns], axis=1)


Key = tuple[tuple[str, ...], str, tuple[int, ...]]
Row = tuple[Array, LostAndGained]
Found = dict[Key, list[Row]]
"""Configurations, with what is lost and gained there, by the kinds, name and coordinates of their
set."""


@explain_errors
@raise_interrupted
def singularities(
    system: Model,
    frame: FrameLike | None = None,
    task: str | None = None,
    *,
    inputs: Iterable[str] | None = None,
    limits: bool = True,
    budget: Budget | None = None,
) -> Singularities:
    """Find singular configurations of a frame or of closed loops; see `System.singularities`."""
    spend = USUAL.complete_budget(budget)
    limits = read_flag(limits, "limits")
    name = None if frame is None else system.structure.frame_name(frame)
    loops = has_loops(system)
    if name is None and not loops:
        raise InputError(
            f"{system.name} is a chain: name a frame; there are: {', '.join(system.frame_names)}"
        )
    driving = find_driven_velocities(system, inputs)
    if loops and name is None and not driving:
        raise InputError(f"{system.name} has no actuated joint: name inputs, or a frame")
    clock = TimeLimit(spend.time_limit)
    done = 0
    broken = None
    with limit_preparation_time(USUAL, clock):
        task, analysis = _make_analysis(
            system, name, task, driving if loops else None, spend, limits
        )
        problems = analysis.list_problems()
    found: Found = {}
    try:
        with clock:
            while done < len(analysis.starts):
                clock.check_time()
                starts = dict.fromkeys(problems, analysis.starts[done : done + AT_ONCE])
                for key, row in _find_singular_rows(analysis, problems, starts, task, limits):
                    found.setdefault(key, []).append(row)
                done = min(done + AT_ONCE, len(analysis.starts))
                if spend.progress is not None:
                    spend.progress(done, len(analysis.starts))
            if loops and limits:
                clock.check_time()
                for key, row in _find_singular_rows(
                    analysis, problems, analysis.find_near_singularities(problems), task, limits
                ):
                    found.setdefault(key, []).append(row)
    except BROKEN_OFF as error:
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    sets = [
        _make_set(system, key, rows, [problems[kind] for kind in key[0]])
        for key, rows in found.items()
        if key[0]
    ]
    if any(s.coordinates for s in sets):
        # where several sets cross, their equations do not tell which coordinates decide
        sets = [s for s in sets if s.coordinates]
    sets.sort(key=lambda s: (s.kinds, s.coordinates, s.name))
    starts = int(spend.starts or 0) if broken is None else done
    return Singularities(
        system, name, task, tuple(sets), starts, limits, analysis, problems, broken
    )


def _find_singular_rows(
    analysis: RankAnalysis,
    problems: dict[str, RankLoss],
    starts: dict[str, Array],
    task: str,
    limits: bool,
) -> list[tuple[Key, Row]]:
    """Find singular configurations from starts (k, nq) of each problem, with the keys of their
    sets.
    """
    system = analysis.system
    name = analysis.frame
    rows = list[tuple[Key, Row]]()
    for kind, problem in problems.items():
        q = problem.find_singular(starts[kind])
        if CONSTRAINT in problems and kind != CONSTRAINT:
            q = _sharpen_configurations(problems[CONSTRAINT], q[np.isfinite(q).all(axis=1)])
        q = _wrap_turns(system, q[np.isfinite(q).all(axis=1)])
        q = q[are_inside_limits(system, q)] if limits else q
        names = (
            name_singularities(system, name, q)
            if kind == SERIAL and task == "pose"
            else [""] * len(q)
        )
        for at, word in zip(q, names, strict=True):
            local = analysis.describe_local_twists(at, problems)
            key = (
                local.kinds,
                word,
                () if analysis.loops else _find_deciding_columns(problem, at, analysis.columns),
            )
            rows.append((key, (at, local)))
    return rows


def _make_analysis(
    system: Model,
    frame: str | None,
    task: str | None,
    driving: list[int] | None,
    spend: Budget,
    limits: bool,
) -> tuple[str, RankAnalysis]:
    """Choose the task and prepare the rank analysis. The task of a planar frame with loops and two
    freedoms is its position, if it moves.

    Its pose has three equations, and so lacks a direction everywhere.
    """
    loops = has_loops(system)
    starts = read_start_count(spend.starts, DRAWN)
    word = _choose_task(system, frame, task, loops)
    analysis = RankAnalysis(system, frame, word, driving, make_generator(spend.rng), starts, limits)
    if task is None and loops and system.dim == 2 and analysis.frame_rank == 2:
        try:
            place = RankAnalysis(
                system, frame, "position", driving, make_generator(spend.rng), starts, limits
            )
        except InputError:  # it turns about its origin
            return word, analysis
        if place.frame_rank == 2:
            return "position", place
    return word, analysis


def _choose_task(system: Model, frame: str | None, task: str | None, loops: bool) -> str:
    """Return the task of this name, or by default the one that fits the chain. Errors:
    `InputError`.
    """
    if task is not None:
        return check_name("task", task, OF_FRAMES if system.dim == 3 else OF_FRAMES[:3])
    if frame is None or loops:
        return "pose"
    joints = (
        np.abs(jacobian(system, sample_configurations(system, 0, 8), frame)).max(axis=(0, 1)) > 0.0
    )
    return "pose" if joints.sum() >= (3 if system.dim == 2 else 4) else "position"


def _find_deciding_columns(problem: RankLoss, q: Array, columns: np.ndarray) -> tuple[int, ...]:
    """Find the velocity coordinates that decide whether a configuration is singular."""
    T = problem.compute_tangents(q)
    off = np.linalg.norm(np.eye(len(T)) - T @ T.T, axis=0)
    return tuple(i for i in columns.tolist() if off[i] > MATTERS)


def _sharpen_configurations(problem: RankLoss, q: Array) -> Array:
    """Move configurations (k, nq) that are near a further loss of rank to that point.

    There the equations of a single loss are singular, and Newton's method comes near only.
    """
    if not len(q):
        return q
    some = np.flatnonzero(problem.compute_least_values(q) < FARTHER)
    q, other = q.copy(), problem.find_singular(q[some])
    near = np.abs(problem.compute_steps(q[some], other)).max(axis=1, initial=0.0) < BESIDE
    q[some[near]] = other[near]
    return q


def _make_set(system: Model, key: Key, rows: list[Row], problems: list[RankLoss]) -> SingularSet:
    """Make a set of singular configurations with the same key."""
    kinds, name, deciding = key
    q = np.array([row[0] for row in rows])
    names = system.structure.velocity_names
    columns = problems[0].columns
    dimension = min(p.compute_tangents(q[0]).shape[1] for p in problems) - (
        system.nv - len(columns)
    )
    place = np.full(system.nv, -1, dtype=np.int64)
    place[system.structure.layout.vector_v] = system.structure.layout.vector_q
    at = place[list(deciding)]
    values = np.zeros((0, len(deciding)))
    if deciding and dimension == len(columns) - len(deciding) and (at >= 0).all():
        values = _select_distinct(system, q[:, at], deciding)
    if dimension == 0:
        keep = get_metric(system).find_unique_configurations(q, SAME).tolist()
        rows = [rows[i] for i in keep]
        q = q[keep]
    return SingularSet(
        kinds,
        name,
        tuple(names[int(i)] for i in deciding),
        values,
        dimension,
        q,
        tuple(local for _, local in rows),
        tuple(at.tolist()),
    )


def _select_distinct(system: Model, x: Array, deciding: tuple[int, ...]) -> Array:
    """Select distinct values (k, n), sorted; of unlimited joints full turns do not count."""
    circle = find_free_angles(system)[list(deciding)]
    keep: list[Array] = []
    row: Array
    for row in x[np.lexsort(np.round(x, 6).T[::-1])]:
        if not any(
            np.where(circle, np.abs(np.sin(0.5 * (row - k))), np.abs(row - k)).max() < SAME
            for k in keep
        ):
            keep.append(np.where(np.abs(row) < 1e-9, 0.0, row))
    return np.array(keep)


def _wrap_turns(system: Model, q: Array) -> Array:
    """Wrap rotations of configurations (k, nq) into (-pi, pi], or into the limits if that is
    outside.

    Where relations tie turns to each other they stay as they are.
    """
    if system.structure.relations:
        return q
    layout = system.structure.layout
    turning = system.structure.coordinates.turning[system.structure.layout.vector_v]
    at_q = layout.vector_q[turning]
    at_v = layout.vector_v[turning]
    x = q[:, at_q]
    x = x - FULL_TURN * np.ceil((x - np.pi) / FULL_TURN - 1e-12)
    for shift in (FULL_TURN, -FULL_TURN):
        outside = (x < system.lower[at_v] - SAME) | (x > system.upper[at_v] + SAME)
        moved = x + shift
        fits = (moved >= system.lower[at_v] - SAME) & (moved <= system.upper[at_v] + SAME)
        x = np.where(outside & fits, moved, x)
    q[:, at_q] = x
    return q
