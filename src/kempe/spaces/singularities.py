"""Singular configurations of a frame and of closed loops: found, named, and traced as curves.

The answer also finds the nearest one to a configuration.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.targets import Z_AXIS
from kempe.arguments import (
    DRAWN,
    explained,
    explained_methods,
    flag,
    generator,
    interruptible,
    known,
    numbers,
    start_count,
    until_interrupt,
)
from kempe.assemble.dyads import source_values
from kempe.budget import Budget, TimeUp, Usual
from kempe.errors import InputError, Interrupted, shown
from kempe.first_order.control import driven
from kempe.forward.fk import fk, jacobian
from kempe.inverse.closed_forms.branch_names import Kind, branch_names, kind_of
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.inverse.closed_forms.plan import plan_or_reason
from kempe.late import late
from kempe.model.configurations import by_short_turns, circles, has_loops, one_finite, random
from kempe.model.model import kept
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit, begun_within, partial
from kempe.numerics.curves import Curve, Node, node, step, walk
from kempe.numerics.curves import inside as node_between
from kempe.report import Report, brief
from kempe.spaces.rank_loss import Equations, RankLoss
from kempe.spaces.singular_types import (
    CONSTRAINT,
    OF_FRAMES,
    SAME,
    SERIAL,
    LostAndGained,
    NearestSingular,
    RankQuestions,
    SingularSet,
    changes,
    inside_limits,
)
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike, Model


# ---- names for six-joint arms

BORDER = " singular"


def names_of(system: Model, frame: str | None, q: Array) -> list[str]:
    """For each configuration (k, nq) "shoulder", "elbow", "wrist", or several of them, or "" where
    there is no name.
    """
    named = None if frame is None else _named(system, frame)
    if named is None or not len(q):
        return [""] * len(q)
    kind, lines = named
    theta = lines.theta(q[:, lines.q_index])
    found = branch_names(kind, lines, theta, np.ones(len(q), dtype=bool))
    return [
        " and ".join(w.removesuffix(BORDER) for w in name.split(", ") if w.endswith(BORDER))
        for name in found
    ]


@kept
def _named(system: Model, frame: str) -> tuple[Kind, Lines] | None:
    """The kind of arm and its lines, None where its branches have no names."""
    plan = plan_or_reason(system, frame, "pose", Z_AXIS)
    if isinstance(plan, str):
        return None
    kind = kind_of(plan, system.dim == 2)
    return None if kind is None else (kind, plan.lines)


# ---- singular curves

# The equations are those of `kempe.spaces.rank_loss`, of configuration and null vectors; where they
# leave one dimension, a curve is followed from each singular configuration that was found. In the
# plane, places at which the frame loses a direction are such curves for any number of freedoms, and
# they bound what it reaches where no limit does (Haug and others, "Numerical algorithms for mapping
# boundaries of manipulator workspaces", J. Mechanical Design 118, 1996).

CURVES_USUAL = Usual("curves", step=0.05, time_limit=TIME_LIMIT, progress=None)
MOST = 1500
"""Nodes of one curve, at most, to each side."""
COARSE = 0.2
BEND = 0.2
"""How far apart nodes are at most, and by which angle the tangent turns between them, if they are
not too few."""
FEW = 3
"""Points that a curve has at least: less is an isolated configuration that was found several
times."""
CURVE_BESIDE = 0.1
"""How far a configuration may be from a piece of a curve, as a part of its length, to be on it."""
HALVINGS = 24
"""Bisections by which the end of a curve at a limit is found."""


@dataclass(frozen=True, eq=False)
class SingularCurve(InWords):
    """Singular configurations `q` (n, nq) along a curve, and where the frame is there: places `p`
    (n, 3) in metres.

    `kinds` and `name` are those of the set; `p` has no rows without a frame. A curve that is
    `closed` ends where it begins, unlimited turns modulo full ones; others end at a limit, at a
    configuration that is more singular, or where they are followed no further.
    """

    __repr__ = brief

    kinds: tuple[str, ...]
    name: str
    q: Array
    p: Array
    closed: bool

    def __len__(self) -> int:
        return len(self.q)

    def __str__(self) -> str:
        closed = ", closed" if self.closed else ""
        return f"{self.name or ' and '.join(self.kinds)}: {counted(len(self), 'point')}{closed}"

    def data(self) -> dict[str, Any]:
        """Its numbers and names."""
        return {n: getattr(self, n) for n in ("kinds", "name", "q", "p", "closed")}


@explained_methods
@dataclass(frozen=True, eq=False)
class SingularCurves(Report):
    """The `curves` of singular configurations that were found; that there are no others is not
    proven.

    `held` are the coordinates, and "orientation", that were held. What was `broken` off, by the
    time limit or an interrupt, has the curves that were done.
    """

    __repr__ = brief

    system: Model
    frame: str | None
    curves: tuple[SingularCurve, ...]
    held: tuple[str, ...] = ()
    broken: Status | None = field(default=None)

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `NOT_FOUND` where there is none, or what broke the search off."""
        return self.broken or (Status.SOLVED if self.curves else Status.NOT_FOUND)

    @property
    def status(self) -> str:
        """How many curves were found."""
        held = f" with {', '.join(self.held)} held" if self.held else ""
        tail = partial(self.broken is Status.INTERRUPTED, self.broken is Status.OUT_OF_TIME)
        found = counted(len(self.curves), "curve") if self.curves else "no curve"
        return f"{self.system.name}: {found} of singular configurations found{held}{tail}"

    def __len__(self) -> int:
        return len(self.curves)

    def __iter__(self) -> Iterator[SingularCurve]:
        return iter(self.curves)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Matplotlib axes with the places of the frame along the curves, a style of line for each
        kind.

        Errors: `InputError` where there are no curves, or no frame.
        """
        return late("plots of singularities").plot_curves(self, ax)

    def _lines(self) -> list[str]:
        return [str(c) for c in self.curves]

    def _data(self) -> dict[str, Any]:
        own = {"system": self.system.name, "frame": self.frame, "held": self.held}
        return own | {"curves": [c.data() for c in self.curves]}


Start = tuple[tuple[str, ...], str, Array]
"""The kinds, the name, and the singular configuration (nq,) from which a curve is followed."""


@interruptible
def singular_curves(
    found: Singularities,
    problems: dict[str, RankLoss],
    starts: list[Start],
    held: tuple[str, ...],
    budget: Budget | None,
    clock: TimeLimit,
) -> SingularCurves:
    """The curves of `problems` through `starts`, in the time of the `clock`; see
    `Singularities.curves`.
    """
    spend = CURVES_USUAL.of(budget)
    system = found.system
    curves = list[SingularCurve]()
    sizes = set[int]()
    broken = None
    try:
        with clock:
            for k, (kinds, name, q) in enumerate(starts):
                clock.check()
                tracer = _CurveTracer(problems[kinds[0]], clock, spend.step or 0.0, found.limits)
                if not any(tracer.on(q, c.q) for c in curves if c.kinds == kinds):
                    sizes.add(size := tracer.dimension(q))
                    way, closed = tracer.traced(q) if size == 1 else (q[None], False)
                    p = (
                        fk(system, way, found.frame)[:, :3, 3]
                        if found.frame is not None
                        else np.zeros((0, 3))
                    )
                    if len(way) >= FEW:
                        curves.append(SingularCurve(kinds, name, way, p, closed))
                    if tracer.broken is not None:
                        raise tracer.broken
                if spend.progress is not None:
                    spend.progress(k + 1, len(starts))
    except BROKEN_OFF as error:
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    if sizes and min(sizes) > 1 and broken is None:
        more = counted(min(sizes) - 1, "further coordinate")
        hint = (
            ", or the orientation"
            if system.dim == 2 and found.frame is not None and not held
            else ""
        )
        raise InputError(
            f"the singular configurations of {system.name} have dimension {min(sizes)}: curves are "
            f"what is left when {more} {'is' if min(sizes) == 2 else 'are'} held, by hold={{name: "
            f"value}}{hint}"
        )
    return SingularCurves(system, found.frame, tuple(curves), held, broken)


def held_equations(
    found: Singularities, hold: Mapping[str, float] | None, orientation: Any
) -> tuple[Equations | None, tuple[str, ...]]:
    """The equations of coordinates and of an orientation that are held, and their names. Errors:
    `InputError`.
    """
    system = found.system
    unit = found.questions.unit
    given: Mapping[str, float] = {} if hold is None else hold
    if not isinstance(given, Mapping):
        raise InputError(
            f"hold is {type(given).__name__}; it must be a dict of values by coordinate name"
        )
    values = source_values(system, {str(k): x for k, x in given.items()})
    names = system.structure.velocity_names
    layout = system.structure.layout
    places = dict(zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True))
    at: list[tuple[int, int, float]] = []
    for name, x in values.items():
        if name not in names or names.index(name) not in places:
            raise InputError(f"{name!r} is part of a rotation, which is not held")
        if np.ndim(x) or not np.isfinite(x):
            raise InputError(f"held coordinate {name!r} must be one finite number")
        at.append((names.index(name), places[names.index(name)], float(x)))
    angle = None if orientation is None else _angle(found, orientation)
    if not at and angle is None:
        return None, ()

    def rows(q: Array) -> tuple[Array, Array]:
        F = [(q[:, place] - x) / unit[v] for v, place, x in at]
        J = [np.broadcast_to(np.eye(system.nv)[v], (len(q), system.nv)) for v, _, _ in at]
        if angle is not None and found.frame is not None:
            X = fk(system, q, found.frame)
            turned = np.arctan2(X[:, 1, 0], X[:, 0, 0]) - angle
            F.append(np.mod(turned + np.pi, 2.0 * np.pi) - np.pi)
            J.append(jacobian(system, q, found.frame)[:, 5] * unit)
        return np.stack(F, axis=1), np.stack(J, axis=1)

    return rows, (*values, *(() if angle is None else ("orientation",)))


def _angle(found: Singularities, orientation: Any) -> float:
    """The angle at which the frame is held. Errors: `InputError`."""
    if found.system.dim != 2 or found.frame is None:
        raise InputError("orientation is held of a frame of a planar system")
    angle = numbers(orientation, "orientation")
    if angle.ndim or not np.isfinite(angle):
        raise InputError(
            f"orientation is {shown(orientation)}; it must be one finite angle in radians"
        )
    return float(angle)


class _SingularCurveEquations(Curve):
    """The equations of `RankLoss` as those of a curve: its points are configurations with null
    vectors of length 1.
    """

    def __init__(self, problem: RankLoss, shape: tuple[int, int], clock: TimeLimit):
        self.problem = problem
        self.shape = shape
        self.clock = clock
        self.nq = problem.system.nq
        self.nv = problem.system.nv
        self.idle = np.setdiff1d(np.arange(self.nv), problem.columns)
        self.n = self.nv + shape[0] * shape[1]

    def both(self, x: Array) -> tuple[Array, Array]:
        self.clock.check()
        V = x[None, self.nq :].reshape(1, *self.shape)
        F, J = self.problem.equations(x[None, : self.nq], V, V)
        F[:, -(self.shape[1] ** 2) :] *= 0.5  # V^T V - 1 changes twice as fast as V^T dV
        rows = max(F.shape[1] + len(self.idle), self.n)
        r = np.zeros(rows)
        A = np.zeros((rows, self.n))
        r[: F.shape[1]] = F[0]
        A[: F.shape[1]] = J[0]
        A[F.shape[1] + np.arange(len(self.idle)), self.idle] = 1.0
        return r, A

    def move(self, x: Array, y: Array) -> Array:
        q = self.problem.move(x[None, : self.nq], y[None, : self.nv])[0]
        return np.concatenate([q, x[self.nq :] + y[self.nv :]])

    def between(self, x: Array, other: Array) -> Array:
        q = self.problem.between(x[None, : self.nq], other[None, : self.nq])[0]
        return np.concatenate([q, other[self.nq :] - x[self.nq :]])


class _CurveTracer:
    """Follows the curves of one problem."""

    def __init__(self, problem: RankLoss, clock: TimeLimit, longest: float, limits: bool):
        self.problem = problem
        self.clock = clock
        self.longest = longest
        self.limits = limits
        system = problem.system
        self.circle = circles(system) if limits else system.structure.coordinates.turning
        self.idle = system.nv - len(problem.columns)
        self.broken: BaseException | None = None
        """What ended the last curve before its end."""

    def dimension(self, q: Array) -> int:
        """The dimension of the set at one of its configurations (nq,)."""
        return self.problem.tangents(q).shape[1] - self.idle

    def short(self, q: Array, to: Array) -> Array:
        """The shortest ways (k, n) from configurations (k, nq) to others, of the coordinates that
        count.
        """
        v = self.problem.system.structure.layout.difference(q, to)
        columns = self.problem.columns[self.problem.counts[self.problem.columns]]
        return (by_short_turns(v, self.circle) / self.problem.unit)[:, columns]

    def on(self, q: Array, way: Array) -> bool:
        """Whether a configuration (nq,) is on a curve (n, nq)."""
        here = self.short(way, np.broadcast_to(q, way.shape))
        return bool(_beside(here[:-1], here[1:]).any())

    def traced(self, q: Array) -> tuple[Array, bool]:
        """The curve (n, nq) through a configuration, and whether it is closed."""
        V = self.problem.null_vectors(q[None])[0]
        equations = _SingularCurveEquations(self.problem, (V.shape[0], V.shape[1]), self.clock)
        start = node(equations, np.concatenate([q, V.ravel()]))
        way, closed = self._walked(equations, start)
        if not closed and self.broken is None:
            back, _ = self._walked(equations, start.reversed())
            way = [*(b.reversed() for b in back[:0:-1]), *way]
        rows = self._finer(equations, way)
        # what spins idly came back otherwise, and was in the way of the last point
        if closed and self.problem.spins:
            layout = self.problem.system.structure.layout
            at = layout.vector_q[self.circle[layout.vector_v]]
            rows[-1] = q
            rows[-1, at] += 2.0 * np.pi * np.round((way[-1].x[at] - q[at]) / (2.0 * np.pi))
        return rows, closed

    def _walked(self, equations: _SingularCurveEquations, start: Node) -> tuple[list[Node], bool]:
        """The nodes from one on, and whether they lead back to it."""
        nq = equations.nq
        way = [start]

        def taken(a: Node, h: float) -> list[Node] | None:
            b = step(equations, a, h)
            return None if b is None else [b]

        try:
            for b in walk(start, taken, COARSE, 0.2 * COARSE, ideal=BEND):
                ends = np.array([way[-1].x[:nq], b.x[:nq]])
                here = self.short(ends, np.broadcast_to(start.x[:nq], ends.shape))
                if len(way) > FEW and _beside(here[:1], here[1:]).any():
                    x = b.x.copy()
                    x[:nq] -= self._turned(start.x[:nq], x[:nq])
                    return [*way, replace(start, x=x)], True
                if self.limits and not inside_limits(equations.problem.system, b.x[None, :nq])[0]:
                    return way + self._end(equations, way[-1], b), False
                way.append(b)
                if len(way) >= MOST:
                    break
        except BROKEN_OFF as error:
            self.broken = error
        return way, False

    def _finer(self, equations: _SingularCurveEquations, way: list[Node]) -> Array:
        """Configurations (n, nq) along nodes, at most `longest` apart: cubic pieces, led onto the
        curve.
        """
        nq = equations.nq
        nv = equations.nv
        rows = [way[0].x[None, : equations.nq]]
        for a, b in zip(way[:-1], way[1:], strict=True):
            y = equations.between(a.x, b.x)
            h = float(np.linalg.norm(y))
            y = y[:nv]
            t = np.linspace(0.0, 1.0, max(int(np.ceil(np.linalg.norm(y) / self.longest)), 1) + 1)[
                1:-1, None
            ]
            bent = (3.0 - 2.0 * t) * t**2 * y + h * t * (1.0 - t) * (
                (1.0 - t) * a.t[:nv] - t * b.t[:nv]
            )
            rows += [
                self.problem.move(np.repeat(a.x[None, :nq], len(t), axis=0), bent),
                b.x[None, :nq],
            ]
        q = self.problem.led(np.concatenate(rows))
        return q[np.isfinite(q).all(axis=1)]

    def _turned(self, q: Array, to: Array) -> Array:
        """How far (nq,) a configuration is from another, full turns left out, as a difference of
        entries of q.
        """
        off = to - q
        layout = self.problem.system.structure.layout
        at = layout.vector_q[self.circle[layout.vector_v]]
        off[at] -= 2.0 * np.pi * np.round(off[at] / (2.0 * np.pi))
        counts = self.problem.counts  # what spins idly need not be where it was
        off[layout.vector_q[~counts[layout.vector_v]]] = 0.0
        for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
            off[iq : iq + 4] *= counts[iv]
        return off

    def _end(self, equations: _SingularCurveEquations, a: Node, b: Node) -> list[Node]:
        """The last point inside the limits between two nodes, the second outside."""
        low = 0.0
        high = float(a.t @ equations.between(a.x, b.x))
        best = list[Node]()
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            there = node_between(equations, a, b, middle)
            if there is None:
                break
            if inside_limits(equations.problem.system, there.x[None, : equations.nq])[0]:
                low = middle
                best = [there]
            else:
                high = middle
        return best


def _beside(to: Array, on: Array) -> np.ndarray:
    """Whether (k,) the origin is beside the segments from -to (k, n) to -on."""
    along = to - on
    size = np.einsum("ij,ij->i", along, along)
    t = np.einsum("ij,ij->i", to, along) / np.maximum(size, 1e-300)
    across = np.linalg.norm(to - np.clip(t, 0.0, 1.0)[:, None] * along, axis=1)
    # on the far side of a turn the short way changes its sense, and what is no segment seems to be
    # a long one
    return (across <= CURVE_BESIDE * np.sqrt(size)) & (size < np.pi**2)


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


@explained_methods
@dataclass(frozen=True, eq=False)
class Singularities(Report):
    """The singular configurations of a frame of `system`, as `sets` that are singular in the same
    way.

    They were found from so many `starts`; that a set is not among them is no proof that it does not
    exist. Where the search was `broken` off, by the time limit or an interrupt, these are the
    starts that were done.
    """

    __repr__ = brief

    system: Model
    frame: str | None
    task: str
    sets: tuple[SingularSet, ...]
    starts: int
    limits: bool
    questions: RankQuestions = field(repr=False)
    problems: dict[str, RankLoss] = field(repr=False)
    broken: Status | None = None

    @property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `NOT_FOUND` where none was found, or what broke the search off."""
        return self.broken or (Status.SOLVED if self.sets else Status.NOT_FOUND)

    @property
    def status(self) -> str:
        """How many sets were found, and which."""
        of = f"{self.system.name}, {self.frame} ({self.task})" if self.frame else self.system.name
        within = " inside the limits" if self.limits else ""
        tail = partial(self.broken is Status.INTERRUPTED, self.broken is Status.OUT_OF_TIME)
        if not self.sets:
            return (
                f"{of}: no singular configuration found{within}, from "
                f"{counted(self.starts, 'start')}{tail}"
            )
        found = counted(len(self.sets), "set")
        return (
            f"{of}: {found} of singular configurations{within}, from "
            f"{counted(self.starts, 'start')}{tail}"
        )

    def _lines(self) -> list[str]:
        return [
            f"{s}: dimension {s.dimension}, {changes(s.local[0].lost, s.local[0].gained)}"
            for s in self.sets
        ]

    def _data(self) -> dict[str, Any]:
        own = {n: getattr(self, n) for n in ("frame", "task", "starts", "limits")}
        return {"system": self.system.name} | own | {"sets": [s.data() for s in self.sets]}

    def nearest(self, q: Any) -> NearestSingular:
        """The nearest singular configuration to a closed one (nq,), of each set that was found; see
        `NearestSingular`.

        It is a local minimum of the distance, found from several points of each set. Errors:
        `InputError`.
        """
        q = one_finite(self.system, q)
        found = [self._nearest(s, q) for s in self.sets]
        if not found:
            none = np.zeros((0, 6))
            return NearestSingular(
                q, np.inf, (), "", none, none, np.zeros((0, self.system.nv)), {}, Status.NOT_FOUND
            )
        distances: dict[str, float] = {}
        for s, (_, d) in zip(self.sets, found, strict=True):
            distances[str(s)] = min(d, distances.get(str(s), np.inf))
        i = int(np.argmin([d for _, d in found]))
        there, distance = found[i]
        local = self.questions.local(there, self.problems)
        s = self.sets[i]
        return NearestSingular(
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
        """Matplotlib axes with configurations of the sets beside one another, and what is lost and
        gained there.

        Arrows show directions of the frame: of turns in the plane there is the centre with an arc,
        in space the axis (dotted). Of a planar system whose sets are curves the last axes have
        these. At most four configurations are drawn. `ax` are as many axes to draw on, the `budget`
        is that of `curves`, of which what was done is drawn (after Ctrl-C in the `answer` of an
        `Interrupted`); `options` are those of `System.plot`.
        Errors: `InputError` where no set was found.
        """
        plots = late("plots of singularities")
        curves = until_interrupt(plots.curves_shown, self, budget)
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
        """The curves of singular configurations, and those that the frame draws there, where the
        sets are curves.

        In the plane those are curves at which a frame's position loses a direction, and of two
        freedoms all of them. Larger sets are cut down to curves by coordinates that are held,
        `hold` {name: value}, and by the frame's `orientation` (planar systems: an angle in
        radians). With the answer's `limits` curves end there. Of the `budget` are read: step (0.05,
        the longest step, in radians and characteristic lengths), time_limit (120 s), and progress,
        which is called with the number of configurations done and that of all. Errors: `InputError`
        where the sets are larger than curves; `UnknownNameError`.
        """
        clock = TimeLimit(CURVES_USUAL.of(budget).time_limit)
        rows, held = held_equations(self, hold, orientation)
        problems = {kind: replace(p, further=rows) for kind, p in self.problems.items()}
        starts = [(s.kinds, s.name, q) for s in self.sets for q in s.q]
        if held:
            near = np.concatenate([*(s.q for s in self.sets), self.questions.starts])
            with begun_within(CURVES_USUAL, clock):
                led = _led(
                    self.questions, problems, dict.fromkeys(problems, near), self.task, self.limits
                )
            starts = [(kinds, name, q) for (kinds, name, _), (q, _) in led if kinds]
        return singular_curves(self, problems, starts, held, budget, clock)

    def _nearest(self, s: SingularSet, q: Array) -> tuple[Array, float]:
        problem = self.problems[s.kinds[-1]]
        starts = s.q[np.argsort(self._apart(s.q, q))[:NEAR]]
        best, far = self._best(s, q, starts, problem.led(np.concatenate([[q], starts]), home=q))
        rng = np.random.default_rng(SEED)
        nv = self.system.nv
        sizes = [far, 0.5 * far, *(far * CLOSER**k for k in range(1, ROUNDS))]
        # limits cut the set off, and there may be several nearest points
        for k, size in enumerate(sizes):
            centre, many = (q, 5 * AROUND) if k < 2 else (best, AROUND)
            aside = np.zeros((many, nv))
            aside[:, self.questions.columns] = rng.normal(size=(many, len(self.questions.columns)))
            aside *= size / np.sqrt(max(1, len(self.questions.columns)))
            tried = problem.led(
                self._inside(problem.move(np.repeat(centre[None], many, axis=0), aside))
            )
            best, far = self._best(s, q, best[None], tried)
        return best, far

    def _inside(self, x: Array) -> Array:
        """Configurations (k, nq) brought to their limits, where these count."""
        if self.limits:
            layout = self.system.structure.layout
            at = layout.vector_q
            v = layout.vector_v
            x[:, at] = np.clip(x[:, at], self.system.lower[v], self.system.upper[v])
        return x

    def _best(self, s: SingularSet, q: Array, starts: Array, led: Array) -> tuple[Array, float]:
        """The nearest to q of configurations that are in the set, `starts`, and may be, `led`, and
        its distance.
        """
        problem = self.problems[s.kinds[-1]]
        led = led[np.isfinite(led).all(axis=1)]
        if s.coordinates:  # a start near another set may have been led there
            names = self.system.structure.velocity_names
            columns = self.questions.columns
            own = [
                tuple(names[i] for i in _deciding(problem, x, columns)) == s.coordinates
                for x in led
            ]
            led = led[np.array(own, dtype=bool)]
            led = (
                led[[name == s.name for name in names_of(self.system, self.frame, led)]]
                if s.name
                else led
            )
        if self.limits:
            led = led[inside_limits(self.system, led)]
        led = np.concatenate([led, starts])
        far = self._apart(led, q)
        i = int(np.argmin(far))
        return led[i], float(far[i])

    def _apart(self, x: Array, q: Array) -> Array:
        """How far (k,) configurations x (k, nq) are from q, unlimited turns the short way."""
        v = by_short_turns(self.system.structure.layout.difference(q, x), circles(self.system))
        return np.linalg.norm((v / self.questions.unit)[:, self.questions.columns], axis=1)


Key = tuple[tuple[str, ...], str, tuple[int, ...]]
Row = tuple[Array, LostAndGained]
Found = dict[Key, list[Row]]
"""Configurations, with what is lost and gained there, by the kinds, name and coordinates of their
set."""


@explained
@interruptible
def singularities(
    system: Model,
    frame: FrameLike | None = None,
    task: str | None = None,
    *,
    inputs: Iterable[str] | None = None,
    limits: bool = True,
    budget: Budget | None = None,
) -> Singularities:
    """The singular configurations of a frame, and of closed loops, that are found from random
    starts.

    Of a chain they are those at which the Jacobian of the frame's `task` has a smaller rank than
    almost everywhere: "pose", "position", "orientation", in space also "xy", "xz", "yz" (the
    position along two axes) and "direction" (of its z axis); by default the pose where three joints
    or, in space, four move the frame, else the position; with closed loops the pose, but of planar
    frames with two freedoms the position. Of closed loops see
    `kempe.spaces.singular_types`: type 1, where the frame has lost directions;
    type 2, where it moves although all `inputs` (names of coordinates; by default what is marked as
    actuated) are held; and constraint singularities, where the loops allow more than elsewhere.
    What spins idly does not count.

    Sets are distinguished by the coordinates that decide, and of six-joint arms by the names of
    their branches. With `limits` only configurations inside them count, which hold the one-sided
    constraints, too; with closed loops they are then looked for from nearly singular ones between
    the starts, besides. Of the `budget` are read: starts (64, at most a million), rng (0),
    time_limit (120 s), and progress(starts done, all).
    Errors: `InputError`, `UnknownNameError`.
    """
    spend = USUAL.of(budget)
    limits = flag(limits, "limits")
    name = None if frame is None else system.structure.frame_name(frame)
    loops = has_loops(system)
    if name is None and not loops:
        raise InputError(
            f"{system.name} is a chain: name a frame; there are: {', '.join(system.frame_names)}"
        )
    driving = driven(system, inputs)
    if loops and name is None and not driving:
        raise InputError(f"{system.name} has no actuated joint: name inputs, or a frame")
    clock = TimeLimit(spend.time_limit)
    done = 0
    broken = None
    with begun_within(USUAL, clock):
        task, questions = _questions_of(
            system, name, task, driving if loops else None, spend, limits
        )
        problems = questions.problems()
    found: Found = {}
    try:
        with clock:
            while done < len(questions.starts):
                clock.check()
                starts = dict.fromkeys(problems, questions.starts[done : done + AT_ONCE])
                for key, row in _led(questions, problems, starts, task, limits):
                    found.setdefault(key, []).append(row)
                done = min(done + AT_ONCE, len(questions.starts))
                if spend.progress is not None:
                    spend.progress(done, len(questions.starts))
            if loops and limits:
                clock.check()
                for key, row in _led(questions, problems, questions.nearly(problems), task, limits):
                    found.setdefault(key, []).append(row)
    except BROKEN_OFF as error:
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    sets = [
        _set(system, key, rows, [problems[kind] for kind in key[0]])
        for key, rows in found.items()
        if key[0]
    ]
    if any(s.coordinates for s in sets):
        # where several sets cross, their equations do not tell which coordinates decide
        sets = [s for s in sets if s.coordinates]
    sets.sort(key=lambda s: (s.kinds, s.coordinates, s.name))
    starts = int(spend.starts or 0) if broken is None else done
    return Singularities(
        system, name, task, tuple(sets), starts, limits, questions, problems, broken
    )


def _led(
    questions: RankQuestions,
    problems: dict[str, RankLoss],
    starts: dict[str, Array],
    task: str,
    limits: bool,
) -> list[tuple[Key, Row]]:
    """Singular configurations to which starts (k, nq) of each question are led, with the keys of
    their sets.
    """
    system = questions.system
    name = questions.frame
    rows = list[tuple[Key, Row]]()
    for kind, problem in problems.items():
        q = problem.led(starts[kind])
        if CONSTRAINT in problems and kind != CONSTRAINT:
            q = _sharpened(problems[CONSTRAINT], q[np.isfinite(q).all(axis=1)])
        q = _turned(system, q[np.isfinite(q).all(axis=1)])
        q = q[inside_limits(system, q)] if limits else q
        names = names_of(system, name, q) if kind == SERIAL and task == "pose" else [""] * len(q)
        for at, word in zip(q, names, strict=True):
            local = questions.local(at, problems)
            key = (
                local.kinds,
                word,
                () if questions.loops else _deciding(problem, at, questions.columns),
            )
            rows.append((key, (at, local)))
    return rows


def _questions_of(
    system: Model,
    frame: str | None,
    task: str | None,
    driving: list[int] | None,
    spend: Budget,
    limits: bool,
) -> tuple[str, RankQuestions]:
    """The task by its name and what is wanted: of a planar frame with loops and two freedoms its
    place, if that moves.

    Its pose has three equations, and so lacks a direction everywhere.
    """
    loops = has_loops(system)
    starts = start_count(spend.starts, DRAWN)
    word = _task(system, frame, task, loops)
    questions = RankQuestions(system, frame, word, driving, generator(spend.rng), starts, limits)
    if task is None and loops and system.dim == 2 and questions.frame_rank == 2:
        try:
            place = RankQuestions(
                system, frame, "position", driving, generator(spend.rng), starts, limits
            )
        except InputError:  # it turns about its origin
            return word, questions
        if place.frame_rank == 2:
            return "position", place
    return word, questions


def _task(system: Model, frame: str | None, task: str | None, loops: bool) -> str:
    """The task by its name, or that which the chain is for. Errors: `InputError`."""
    if task is not None:
        return known("task", task, OF_FRAMES if system.dim == 3 else OF_FRAMES[:3])
    if frame is None or loops:
        return "pose"
    joints = np.abs(jacobian(system, random(system, 0, 8), frame)).max(axis=(0, 1)) > 0.0
    return "pose" if joints.sum() >= (3 if system.dim == 2 else 4) else "position"


def _deciding(problem: RankLoss, q: Array, columns: np.ndarray) -> tuple[int, ...]:
    """Velocity coordinates that change what a singular configuration is a singular one by."""
    T = problem.tangents(q)
    off = np.linalg.norm(np.eye(len(T)) - T @ T.T, axis=0)
    return tuple(i for i in columns.tolist() if off[i] > MATTERS)


def _sharpened(problem: RankLoss, q: Array) -> Array:
    """Configurations (k, nq), those next to one where another rank is lost, too, as that one.

    There the equations of a single loss are singular, and Newton's method comes near only.
    """
    if not len(q):
        return q
    some = np.flatnonzero(problem.least(q) < FARTHER)
    q, other = q.copy(), problem.led(q[some])
    near = np.abs(problem.between(q[some], other)).max(axis=1, initial=0.0) < BESIDE
    q[some[near]] = other[near]
    return q


def _set(system: Model, key: Key, rows: list[Row], problems: list[RankLoss]) -> SingularSet:
    kinds, name, deciding = key
    q = np.array([row[0] for row in rows])
    names = system.structure.velocity_names
    columns = problems[0].columns
    dimension = min(p.tangents(q[0]).shape[1] for p in problems) - (system.nv - len(columns))
    place = np.full(system.nv, -1, dtype=np.int64)
    place[system.structure.layout.vector_v] = system.structure.layout.vector_q
    at = place[list(deciding)]
    values = np.zeros((0, len(deciding)))
    if deciding and dimension == len(columns) - len(deciding) and (at >= 0).all():
        values = _distinct(system, q[:, at], deciding)
    if dimension == 0:
        keep = _distinct_rows(q)
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


def _distinct_rows(x: Array) -> list[int]:
    keep: list[int] = []
    for i, row in enumerate(x):
        if not any(np.abs(np.sin(0.5 * (row - x[j]))).max(initial=0.0) < SAME for j in keep):
            keep.append(i)
    return keep


def _distinct(system: Model, x: Array, deciding: tuple[int, ...]) -> Array:
    """Values (k, n) that differ, sorted; turns that differ by full turns are the same where they
    have no limits.
    """
    circle = circles(system)[list(deciding)]
    keep: list[Array] = []
    row: Array
    for row in x[np.lexsort(np.round(x, 6).T[::-1])]:
        if not any(
            np.where(circle, np.abs(np.sin(0.5 * (row - k))), np.abs(row - k)).max() < SAME
            for k in keep
        ):
            keep.append(np.where(np.abs(row) < 1e-9, 0.0, row))
    return np.array(keep)


def _turned(system: Model, q: Array) -> Array:
    """Configurations (k, nq) of which turns are led by full turns into (-pi, pi], or where that is
    outside, the limits.

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
