"""Curves of singular configurations, and the curves that a frame draws along them.

The equations are those of `kempe.spaces.rank_loss`, of configuration and null vectors; where they
leave one dimension, a curve is followed from each singular configuration that was found. In the
plane, places at which the frame loses a direction are such curves for any number of freedoms, and
they bound what it reaches where no limit does (Haug and others, "Numerical algorithms for mapping
boundaries of manipulator workspaces", J. Mechanical Design 118, 1996).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_method_errors, numbers, raise_interrupted
from kempe.assemble.dyads import find_source_values
from kempe.budget import Budget, TimeUp, Usual
from kempe.errors import InputError, format_value
from kempe.forward.fk import fk, jacobian
from kempe.late import import_late_member
from kempe.model.configurations import find_free_angles, shorten_turns
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit, describe_early_end
from kempe.numerics.curves import (
    Curve,
    Node,
    find_next_nodes,
    find_node_between,
    join_ways,
    make_node,
    walk_curve,
)
from kempe.report import Report, summarize_fields
from kempe.spaces.rank_loss import Equations, RankLoss
from kempe.spaces.singular_types import are_inside_limits
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, format_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import Model
    from kempe.spaces.singularities import Singularities

USUAL = Usual("curves", step=0.05, time_limit=TIME_LIMIT, progress=None)
MOST = 1500
"""Nodes of one curve, at most, to each side."""
COARSE = 0.2
BEND = 0.2
"""How far apart nodes are at most, and by which angle the tangent turns between them, if they are
not too few."""
FEW = 3
"""Points that a curve has at least: less is an isolated configuration that was found several
times."""
BESIDE = 0.1
"""How far a configuration may be from a piece of a curve, as a part of its length, to be on it."""
HALVINGS = 24
"""Bisections by which the end of a curve at a limit is found."""


@dataclass(frozen=True, eq=False)
class SingularCurve(InWords):
    """Singular configurations `q` (n, nq) along a curve, and frame positions `p` (n, 3) in metres.

    `kinds` and `name` are those of the set; `p` has no rows without a frame. A curve that is
    `closed` ends where it begins, unlimited turns modulo full ones; others end at a limit, at a
    configuration that is more singular, or where they are followed no further.
    """

    __repr__ = summarize_fields

    kinds: tuple[str, ...]
    name: str
    q: Array
    p: Array
    closed: bool

    def __len__(self) -> int:
        return len(self.q)

    def __str__(self) -> str:
        closed = ", closed" if self.closed else ""
        return (
            f"{self.name or ' and '.join(self.kinds)}: {format_count(len(self), 'point')}{closed}"
        )

    def to_data(self) -> dict[str, Any]:
        """Convert the curve to numbers and names, for JSON."""
        return {n: getattr(self, n) for n in ("kinds", "name", "q", "p", "closed")}


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class SingularCurves(Report):
    """The `curves` of singular configurations that were found. Others may exist.

    `held` are the coordinates, and "orientation", that were held. What was `broken` off, by the
    time limit or an interrupt, has the curves that were done.
    """

    _entries = ("system", "frame", "held")

    system: Model
    frame: str | None
    curves: tuple[SingularCurve, ...]
    held: tuple[str, ...] = ()
    broken: Status | None = field(default=None)

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `NOT_FOUND` if no curve was found, or the reason why the search ended early."""
        return self.broken or (Status.SOLVED if self.curves else Status.NOT_FOUND)

    @property
    def status(self) -> str:
        """The number of curves, as a sentence."""
        held = f" with {', '.join(self.held)} held" if self.held else ""
        tail = describe_early_end(
            self.broken is Status.INTERRUPTED, self.broken is Status.OUT_OF_TIME
        )
        found = format_count(len(self.curves), "curve") if self.curves else "no curve"
        return f"{self.system.name}: {found} of singular configurations found{held}{tail}"

    def __len__(self) -> int:
        return len(self.curves)

    def __iter__(self) -> Iterator[SingularCurve]:
        return iter(self.curves)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the positions of the frame along the curves in Matplotlib axes.

        Each kind has a line style.

        Errors: `InputError` where there are no curves, or no frame.
        """
        return import_late_member("plots of singularities").plot_curves(self, ax)

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return [str(c) for c in self.curves]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"curves": [c.to_data() for c in self.curves]}


Start = tuple[tuple[str, ...], str, Array]
"""The kinds, the name, and the singular configuration (nq,) from which a curve is followed."""


@raise_interrupted
def find_singular_curves(
    found: Singularities,
    problems: dict[str, RankLoss],
    starts: list[Start],
    held: tuple[str, ...],
    budget: Budget | None,
    clock: TimeLimit,
) -> SingularCurves:
    """Trace the curves of `problems` through `starts`, in the time of the `clock`. See
    `Singularities.curves`.
    """
    spend = USUAL.complete_budget(budget)
    system = found.system
    curves = list[SingularCurve]()
    sizes = set[int]()
    broken = None
    try:
        with clock:
            for k, (kinds, name, q) in enumerate(starts):
                clock.check_time()
                tracer = _CurveTracer(problems[kinds[0]], clock, spend.step or 0.0, found.limits)
                if not any(tracer.is_on_curve(q, c.q) for c in curves if c.kinds == kinds):
                    sizes.add(size := tracer.compute_dimension(q))
                    way, closed = tracer.trace_curve(q) if size == 1 else (q[None], False)
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
        more = format_count(min(sizes) - 1, "further coordinate")
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


def make_held_equations(
    found: Singularities, hold: Mapping[str, float] | None, orientation: Any
) -> tuple[Equations | None, tuple[str, ...]]:
    """Make the equations of held coordinates and a held orientation, with their names. Errors:
    `InputError`.
    """
    system = found.system
    unit = found.analysis.unit
    given: Mapping[str, float] = {} if hold is None else hold
    if not isinstance(given, Mapping):
        raise InputError(
            f"hold is {format_value(given)}; it must be a dict of values by coordinate name"
        )
    values = find_source_values(system, {str(k): x for k, x in given.items()})
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
    angle = None if orientation is None else _read_angle(found, orientation)
    if not at and angle is None:
        return None, ()

    def evaluate_rows(q: Array) -> tuple[Array, Array]:
        """Evaluate residuals of the held equations at q (k, nq), and their derivatives."""
        F = [(q[:, place] - x) / unit[v] for v, place, x in at]
        J = [np.broadcast_to(np.eye(system.nv)[v], (len(q), system.nv)) for v, _, _ in at]
        if angle is not None and found.frame is not None:
            X = fk(system, q, found.frame)
            turned = np.arctan2(X[:, 1, 0], X[:, 0, 0]) - angle
            F.append(np.mod(turned + np.pi, 2.0 * np.pi) - np.pi)
            J.append(jacobian(system, q, found.frame)[:, 5] * unit)
        return np.stack(F, axis=1), np.stack(J, axis=1)

    return evaluate_rows, (*values, *(() if angle is None else ("orientation",)))


def _read_angle(found: Singularities, orientation: Any) -> float:
    """Read the angle at which the frame is held. Errors: `InputError`."""
    if found.system.dim != 2 or found.frame is None:
        raise InputError("orientation is held of a frame of a planar system")
    angle = numbers(orientation, "orientation")
    if angle.ndim or not np.isfinite(angle):
        raise InputError(
            f"orientation is {format_value(orientation)}; it must be one finite angle in radians"
        )
    return float(angle)


class _SingularCurveEquations(Curve):
    """The equations of `RankLoss` for a curve of configurations with null vectors of length 1."""

    def __init__(self, problem: RankLoss, shape: tuple[int, int], clock: TimeLimit):
        self.problem = problem
        self.shape = shape
        self.clock = clock
        self.nq = problem.system.nq
        self.nv = problem.system.nv
        self.idle = np.setdiff1d(np.arange(self.nv), problem.columns)
        self.n = self.nv + shape[0] * shape[1]

    def evaluate_equations(self, x: Array) -> tuple[Array, Array]:
        self.clock.check_time()
        V = x[None, self.nq :].reshape(1, *self.shape)
        F, J = self.problem.evaluate_equations(x[None, : self.nq], V, V)
        F[:, -(self.shape[1] ** 2) :] *= 0.5  # V^T V - 1 changes twice as fast as V^T dV
        rows = max(F.shape[1] + len(self.idle), self.n)
        r = np.zeros(rows)
        A = np.zeros((rows, self.n))
        r[: F.shape[1]] = F[0]
        A[: F.shape[1]] = J[0]
        A[F.shape[1] + np.arange(len(self.idle)), self.idle] = 1.0
        return r, A

    def move_point(self, x: Array, y: Array) -> Array:
        q = self.problem.move_configurations(x[None, : self.nq], y[None, : self.nv])[0]
        return np.concatenate([q, x[self.nq :] + y[self.nv :]])

    def compute_difference(self, x: Array, other: Array) -> Array:
        q = self.problem.compute_steps(x[None, : self.nq], other[None, : self.nq])[0]
        return np.concatenate([q, other[self.nq :] - x[self.nq :]])


class _CurveTracer:
    """Tracer of the curves of one problem."""

    def __init__(self, problem: RankLoss, clock: TimeLimit, longest: float, limits: bool):
        self.problem = problem
        self.clock = clock
        self.longest = longest
        self.limits = limits
        system = problem.system
        self.circle = find_free_angles(system) if limits else system.structure.coordinates.turning
        self.idle = system.nv - len(problem.columns)
        self.broken: BaseException | None = None
        """What ended the last curve before its end."""

    def compute_dimension(self, q: Array) -> int:
        """Compute the dimension of the singular set at a configuration (nq,)."""
        return self.problem.compute_tangents(q).shape[1] - self.idle

    def compute_short_steps(self, q: Array, to: Array) -> Array:
        """Compute the shortest steps (k, n) between configurations (k, nq), in the relevant
        coordinates.
        """
        v = self.problem.system.structure.layout.compute_difference(q, to)
        columns = self.problem.columns[self.problem.counted_columns[self.problem.columns]]
        return (shorten_turns(v, self.circle) / self.problem.unit)[:, columns]

    def is_on_curve(self, q: Array, way: Array) -> bool:
        """Whether a configuration (nq,) is on a curve (n, nq)."""
        here = self.compute_short_steps(way, np.broadcast_to(q, way.shape))
        return bool(_is_beside(here[:-1], here[1:]).any())

    def trace_curve(self, q: Array) -> tuple[Array, bool]:
        """Trace the curve (n, nq) through a configuration, and whether it is closed."""
        V = self.problem.compute_null_vectors(q[None])[0]
        equations = _SingularCurveEquations(self.problem, (V.shape[0], V.shape[1]), self.clock)
        start = make_node(equations, np.concatenate([q, V.ravel()]))
        way, closed = self._walk_nodes(equations, start)
        if not closed and self.broken is None:
            back, _ = self._walk_nodes(equations, start.reverse_direction())
            way = join_ways(back, way)
        rows = self._refine_way(equations, way)
        # what spins idly came back otherwise, and was in the way of the last point
        if closed and self.problem.has_idle_spins:
            layout = self.problem.system.structure.layout
            at = layout.vector_q[self.circle[layout.vector_v]]
            rows[-1] = q
            rows[-1, at] += 2.0 * np.pi * np.round((way[-1].x[at] - q[at]) / (2.0 * np.pi))
        return rows, closed

    def _walk_nodes(
        self, equations: _SingularCurveEquations, start: Node
    ) -> tuple[list[Node], bool]:
        """Follow the curve from a node, and return the nodes and whether they lead back to it."""
        nq = equations.nq
        way = [start]
        take_step = partial(find_next_nodes, equations)
        try:
            for b in walk_curve(start, take_step, COARSE, 0.2 * COARSE, ideal=BEND):
                ends = np.array([way[-1].x[:nq], b.x[:nq]])
                here = self.compute_short_steps(ends, np.broadcast_to(start.x[:nq], ends.shape))
                if len(way) > FEW and _is_beside(here[:1], here[1:]).any():
                    x = b.x.copy()
                    x[:nq] -= self._compute_difference(start.x[:nq], x[:nq])
                    return [*way, replace(start, x=x)], True
                if (
                    self.limits
                    and not are_inside_limits(equations.problem.system, b.x[None, :nq])[0]
                ):
                    return way + self._find_limit_point(equations, way[-1], b), False
                way.append(b)
                if len(way) >= MOST:
                    break
        except BROKEN_OFF as error:
            self.broken = error
        return way, False

    def _refine_way(self, equations: _SingularCurveEquations, way: list[Node]) -> Array:
        """Interpolate nodes to configurations (n, nq) at most `longest` apart, corrected to the
        curve.
        """
        nq = equations.nq
        nv = equations.nv
        rows = [way[0].x[None, : equations.nq]]
        for a, b in zip(way[:-1], way[1:], strict=True):
            y = equations.compute_difference(a.x, b.x)
            h = float(np.linalg.norm(y))
            y = y[:nv]
            t = np.linspace(0.0, 1.0, max(int(np.ceil(np.linalg.norm(y) / self.longest)), 1) + 1)[
                1:-1, None
            ]
            bent = (3.0 - 2.0 * t) * t**2 * y + h * t * (1.0 - t) * (
                (1.0 - t) * a.t[:nv] - t * b.t[:nv]
            )
            rows += [
                self.problem.move_configurations(np.repeat(a.x[None, :nq], len(t), axis=0), bent),
                b.x[None, :nq],
            ]
        q = self.problem.find_singular(np.concatenate(rows))
        return q[np.isfinite(q).all(axis=1)]

    def _compute_difference(self, q: Array, to: Array) -> Array:
        """Compute the difference (nq,) of two configurations, with full turns removed."""
        off = to - q
        layout = self.problem.system.structure.layout
        at = layout.vector_q[self.circle[layout.vector_v]]
        off = shorten_turns(off, at)
        counts = self.problem.counted_columns  # what spins idly need not be where it was
        off[layout.vector_q[~counts[layout.vector_v]]] = 0.0
        for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
            off[iq : iq + 4] *= counts[iv]
        return off

    def _find_limit_point(self, equations: _SingularCurveEquations, a: Node, b: Node) -> list[Node]:
        """Find the last point inside the limits between two nodes, of which the second is outside."""
        low = 0.0
        high = float(a.t @ equations.compute_difference(a.x, b.x))
        best = list[Node]()
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            there = find_node_between(equations, a, b, middle)
            if there is None:
                break
            if are_inside_limits(equations.problem.system, there.x[None, : equations.nq])[0]:
                low = middle
                best = [there]
            else:
                high = middle
        return best


def _is_beside(to: Array, on: Array) -> np.ndarray:
    """Whether (k,) the origin is beside the segments from -to (k, n) to -on."""
    along = to - on
    size = np.einsum("ij,ij->i", along, along)
    t = np.einsum("ij,ij->i", to, along) / np.maximum(size, 1e-300)
    across = np.linalg.norm(to - np.clip(t, 0.0, 1.0)[:, None] * along, axis=1)
    # on the far side of a turn the short way changes its sense, and what is no segment seems to be
    # a long one
    return (across <= BESIDE * np.sqrt(size)) & (size < np.pi**2)
