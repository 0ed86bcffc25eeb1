"""Connected components of configuration space: by theorem, by dead points, or by tracing curves."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import (
    DRAWN,
    call_until_interrupt,
    explain_errors,
    explain_method_errors,
    raise_interrupted,
    read_start_count,
)
from kempe.assemble.assemble import assemble
from kempe.assemble.dyads import find_closed_form
from kempe.assemble.idle_freedoms import find_idle_coordinates
from kempe.assemble.modes import assembly_modes
from kempe.assemble.same_configuration import get_metric
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.mobility.mobility import mobility
from kempe.model.configurations import (
    compute_mid_configuration,
    find_winding_angles,
    has_loops,
    list_units,
    name_values,
    sample_configurations,
)
from kempe.motion.path import Event, Path
from kempe.motion.trace import trace
from kempe.numerics.clock import (
    TIME_LIMIT,
    TimeLimit,
    describe_early_end,
    find_time_limit,
    limit_time,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Report
from kempe.spaces.four_joints import FourJoints, find_four_joints
from kempe.spaces.manifold import Manifold
from kempe.spaces.polygons import find_polygon
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, Quantity, format_count

if TYPE_CHECKING:
    from kempe.mobility.answer import Mobility
    from kempe.model.model import Model

STARTS = 256
VALUES = 24
"""Random assemblies from which curves are traced, and values of each coordinate at which assembly
modes are."""
NEAR = 0.3
SAME = 1e-5
"""Distance from a node of a curve from which it is looked closer at, and that below which a point
is on it."""
NONE_INSIDE = "no configuration within limits and one-sided constraints was found"
NOTHING = 1e-9
"""Part of a period that is rounding."""
USUAL = Usual("components", starts=STARTS, rng=0, time_limit=TIME_LIMIT)


@dataclass(frozen=True, eq=False)
class Component(InWords):
    """Component with one freedom, without idle freedoms: curves that bifurcations join.

    One without a freedom is a path of one configuration.
    """

    paths: tuple[Path, ...]
    still: np.ndarray = field(repr=False)
    """Velocity coordinates (nv,) that idle spins change: they do not count."""

    @property
    def length(self) -> float:
        """Length of all curves of the component, in radians and characteristic lengths."""
        return float(sum(p.length for p in self.paths))

    @property
    def alone(self) -> bool:
        """Whether the component is one closed or complete curve without singular points.

        Then nothing else joins it.
        """
        first = self.paths[0]
        smooth = not any("not smooth" in end for end in first.ends)
        return first.success and len(self.paths) == 1 and smooth and not first.singular_points

    @property
    def dimension(self) -> int:
        """Dimension of the component without idle freedoms: 1, or 0 for an immobile configuration."""
        return int(self.length > 0.0)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest value [rad, m] of each coordinate on the component, by name."""
        q = np.concatenate([p.track.q for p in self.paths])
        return dict(
            zip(
                self.paths[0].system.coordinate_names,
                zip(q.min(0).tolist(), q.max(0).tolist(), strict=True),
                strict=True,
            )
        )

    @property
    def singular_points(self) -> tuple[Event, ...]:
        """Points where curves meet or the rank drops, each once."""
        system = self.paths[0].system
        events = [e for p in self.paths for e in p.singular_points]
        q = np.array([e.q for e in events]).reshape(-1, system.nq)
        numbers: list[int] = get_metric(system).find_unique_configurations(q, SAME).tolist()
        return tuple(events[k] for k in numbers)

    def place(self, q: Array) -> tuple[np.ndarray, Array, Array]:
        """Find the index (k,) of the curve nearest to each configuration (k, nq).

        Also return the arc lengths (k,) on the curves, and the distances (k,).

        The distance is infinite where no curve is near.
        """
        which = np.zeros(len(q), dtype=int)
        s = np.zeros(len(q))
        far = np.full(len(q), np.inf)
        for i, path in enumerate(self.paths):
            at, off = _find_nearest(path, q, ~self.still)
            better = off < far
            which[better] = i
            s[better] = at[better]
            far[better] = off[better]
        return which, s, far

    def contains(self, q: Array) -> np.ndarray:
        """Return a mask (k,) of the configurations (k, nq) that lie on the component."""
        return self.place(q)[2] < SAME

    def __str__(self) -> str:
        first = self.paths[0]
        if not self.dimension:
            return "a configuration that cannot move"
        kind = "closed curve" if first.closed else "curve"
        if first.closed and _count_turns(first):
            kind = "endless curve that repeats with a period"
        turns = [f"{format_count(abs(k), 'turn')} of {n!r}" for n, k in first.turns.items()]
        text = (
            f"{kind} of length {first.length:.6g}"
            if len(self.paths) == 1
            else f"{format_count(len(self.paths), 'curve')} of total length {self.length:.6g}"
        )
        text += f", {', '.join(turns)}" if turns and len(self.paths) == 1 else ""
        points = len(self.singular_points)
        return text + (f", {format_count(points, 'singular point')}" if points else "")


def _count_turns(path: Path) -> dict[int, int]:
    """Count the whole turns of each angle by which a curve advances until it repeats."""
    layout = path.system.structure.layout
    names = path.system.structure.velocity_names
    place = dict(zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True))
    return {
        place[int(v)]: path.turns[names[v]]
        for v in np.flatnonzero(find_winding_angles(path.system))
        if path.turns.get(names[v])
    }


def _unwind_turns(path: Path, q: Array) -> Array:
    """Move configurations (k, nq) by periods of a repeating curve to the part that was traced."""
    wound = _count_turns(path)
    if not wound:
        return q
    at = list(wound)
    turns = 2.0 * np.pi * np.array(list(wound.values()))
    out = q.copy()
    periods = np.floor((q[:, at[0]] - path.track.q[0, at[0]]) / turns[0] + NOTHING)
    out[:, at] -= periods[:, None] * turns
    return out


def _find_nearest(path: Path, q: Array, useful: np.ndarray) -> tuple[Array, Array]:
    """Find the points of a path nearest to configurations (k, nq). Return their arc lengths (k,)
    and distances (k,).
    """
    manifold = Manifold(path.system, 1)
    track = path.track
    q = _unwind_turns(path, q)
    nodes = track.q
    t = np.where(useful, track.t, 0.0)
    best = np.zeros(len(q), dtype=int)
    far = np.full(len(q), np.inf)
    for k, node in enumerate(nodes):
        off = np.linalg.norm(
            manifold.compute_steps(np.broadcast_to(node, q.shape), q)[:, useful], axis=1
        )
        best = np.where(off < far, k, best)
        far = np.minimum(off, far)
    s = track.s[best]
    near = np.flatnonzero(far < NEAR)
    for _ in range(12) if len(near) and len(nodes) > 1 else ():
        way = np.where(useful, manifold.compute_steps(path.at(s[near]), q[near]), 0.0)
        far[near] = np.linalg.norm(way, axis=1)
        k = np.clip(
            np.searchsorted(track.s, np.mod(s[near], path.length or 1.0), side="right") - 1,
            0,
            len(nodes) - 2,
        )
        u = ((np.mod(s[near], path.length) - track.s[k]) / (track.s[k + 1] - track.s[k]))[:, None]
        along = (1.0 - u) * t[k] + u * t[k + 1]
        size = np.maximum(np.sum(along**2, axis=1), 1e-12)
        s[near] = np.clip(
            s[near] + np.sum(along * way, axis=1) / size,
            *((-np.inf, np.inf) if path.closed else (0.0, path.length)),
        )
    return np.mod(s, path.length) if path.closed and path.length else s, np.where(
        far < NEAR, far, np.inf
    )


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Components(Report):
    """Connected components of a configuration space.

    Attributes
    ----------
    count
        Number of components; a lower bound unless `complete`.
    complete, reason
        Whether the count is proven, and why.
    parts
        Components with one freedom, as curves.
    singular
        Known singular points (k, nq).
    dimension
        Number of freedoms, without idle freedoms.
    """

    _entries = ("system", "count", "complete", "reason", "dimension", "idle", "late", "interrupted")
    _has_angles = True

    system: Model
    count: int
    complete: bool
    reason: str
    dimension: int | None
    idle: int = 0
    parts: tuple[Component, ...] = ()
    singular: Array = field(default_factory=lambda: np.empty((0, 0)))
    late: bool = False
    interrupted: bool = False

    @cached_property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `PARTLY` if the count is a lower bound, `NONE_EXISTS` if 0 is proven."""
        if self.complete:
            return Status.SOLVED if self.count else Status.NONE_EXISTS
        if self.interrupted:
            return Status.INTERRUPTED
        return (
            Status.OUT_OF_TIME if self.late else Status.PARTLY if self.count else Status.NOT_FOUND
        )

    @property
    def status(self) -> str:
        """The number of components, with the proof or the evidence."""
        few = "" if self.complete or not self.count else "at least "
        proven = "proven" if self.complete else "a lower bound"
        idle = f", {format_count(self.idle, 'idle spin')} left out" if self.idle else ""
        said = (
            f"{few}{format_count(self.count, 'connected component')}{idle}; {proven}: {self.reason}"
        )
        return said + describe_early_end(self.interrupted, self.late)

    def _list_notes(self, degrees: bool = False) -> list[str]:
        lines = [f"{k + 1}: {part}" for k, part in enumerate(self.parts)]
        return lines + (
            [f"{format_count(len(self.singular), 'singular point')} of the space"]
            if len(self.singular)
            else []
        )

    def _make_headline(self) -> str:
        return f"{self.system.name}: {self.status}"

    def _collect_data(self) -> dict[str, Any]:
        unit = list_units(self.system)
        parts = [
            {
                "dimension": p.dimension,
                "length": p.length,
                "curves": len(p.paths),
                "closed": all(x.closed for x in p.paths),
                "ranges": {n: Quantity(ends, unit[n]) for n, ends in p.ranges.items()},
            }
            for p in self.parts
        ]
        singular = [name_values(self.system, q) for q in self.singular]
        return super()._collect_data() | {"parts": parts, "singular": singular}


@explain_errors
@raise_interrupted
@limit_time(USUAL)
def find_components(system: Model, *, budget: Budget | None = None) -> Components:
    """Find the connected components of the configuration space.

    They come with the proof, or as a lower bound with the evidence.

    A tree has one. Planar single loops of revolute joints have as many as the theorem on long bars
    says. Loops of four joints, in which a rod joins two cranks, a crank and a slide, or two slides,
    in the plane or between balls, and loops of four turns about parallel axes or axes through one
    point, are counted by their dead points and by the places where limits cut them. All other
    systems with one freedom, idle spins left out, are traced: from random assemblies and, where
    these have a closed form, from the assembly modes at 24 values of each coordinate. Curves that
    meet at bifurcations are one component. Traced curves are evidence: one may be missed, or a
    place where two meet, so curves without singular points count, and all others as one.
    Systems with several freedoms have at least one. Of the `budget` are read: starts (256), rng
    (0), time_limit (120 s).
    """
    spend = USUAL.complete_budget(budget)
    time = find_time_limit(USUAL, budget)
    try:
        return _count_components(system, spend, time)
    except TimeUp as error:
        return Components(
            system,
            0,
            False,
            f"none is known: {time.describe_end_reason(error)} came first",
            None,
            late=True,
        )


def _count_components(system: Model, spend: Budget, time: TimeLimit) -> Components:
    """Count the components, as `find_components` does, in the time of a clock."""
    if not has_loops(system):
        divided = bool(pack_one_sided_rows(system).declared)
        why = (
            "one-sided constraints may divide it"
            if divided
            else "a product of circles, intervals and rotations"
        )
        if divided and not _has_allowed_configuration(
            system, compute_mid_configuration(system), spend
        ):
            return Components(system, 0, False, NONE_INSIDE, None)
        return Components(system, 1, not divided, why, system.nv)
    polygon = find_polygon(system)
    loop = find_four_joints(system)
    proof = next((x for x in (polygon, loop) if not isinstance(x, str)), None)
    if proof is not None and not proof.count:
        return Components(system, 0, True, proof.reason, None)
    freedoms = mobility(system)
    if not freedoms.closed or freedoms.dof is None:
        return Components(system, 0, False, freedoms.sentence, None)
    if freedoms.dof == 0 and proof is None:
        modes = assembly_modes(system)
        return Components(system, len(modes), modes.complete, f"a structure, {modes.status}", 0)
    traced = Traced()
    if freedoms.useful == 1:
        traced = _trace_components(system, freedoms, loop, spend, time)
    points = [e.q for part in traced.parts for e in part.singular_points]
    singular = np.array(points).reshape(-1, system.nq)
    if proof is not None:
        count = proof.count
        why = proof.reason + traced.describe_components(count)
        singular = np.concatenate([singular, proof.singular_points])
    elif freedoms.useful == 1:
        count, why = _compute_lower_bound(system, traced)
    elif _has_allowed_configuration(system, freedoms.q, spend):
        several = format_count(freedoms.dof, "freedom")
        count, why = 1, f"no theorem is known here for {several}; one configuration is known"
    else:
        return Components(system, 0, False, NONE_INSIDE, None, freedoms.idle)
    return Components(
        system,
        count,
        proof is not None,
        why,
        freedoms.dof,
        freedoms.idle,
        traced.parts,
        singular[get_metric(system).find_unique_configurations(singular, SAME)],
        traced.late,
        traced.interrupted,
    )


def _has_allowed_configuration(system: Model, home: Array, spend: Budget) -> bool:
    """Whether `home` or a start leads to a configuration within limits and one-sided constraints."""
    manifold = Manifold(system, 1)
    if manifold.are_allowed(home[None]).any():
        return True
    found = assemble(
        system,
        None,
        sample_configurations(
            system, np.random.default_rng(spend.rng), read_start_count(spend.starts, DRAWN)
        ),
    )
    ok = np.asarray(found.success, dtype=bool)
    return bool(ok.any() and manifold.are_allowed(found.q[ok]).any())


@dataclass(frozen=True)
class Traced:
    """Traced curves, whether `several` freedoms were found, and whether the search was broken off."""

    parts: tuple[Component, ...] = ()
    several: frozenset[int] = frozenset()
    late: bool = False
    interrupted: bool = False

    def describe_components(self, known: int | None) -> str:
        """Describe what is known of the traced components beside their number."""
        text = ""
        if self.parts and known not in (None, len(self.parts)):
            text = f"; {format_count(len(self.parts), 'curve')} traced"
        dims = " or ".join(map(str, sorted(self.several)))
        return text + (f"; configurations with {dims} freedoms were found, too" if dims else "")


def _compute_lower_bound(system: Model, traced: Traced) -> tuple[int, str]:
    """Compute a lower bound of the number of components, with the evidence."""
    alone = sum(part.alone for part in traced.parts)
    met = len(traced.parts) - alone
    curves = format_count(len(traced.parts), "curve")
    why = f"{curves} traced, which is evidence and no proof"
    why += ": limits cut curves, and" if pack_one_sided_rows(system).names else ":"
    why += " a curve that no start led to may be missed"
    if met > 1:
        why += f"; {met} curves with singular points, where they may meet, count as one"
    return alone + (met > 0), why + traced.describe_components(None)


def _trace_components(
    system: Model, freedoms: Mobility, loop: FourJoints | str, spend: Budget, time: TimeLimit
) -> Traced:
    """Trace the components that starts lead to. A loop of four joints has one start on each; others
    have random starts.
    """
    home = freedoms.q
    still = find_idle_coordinates(system, home)
    starts = np.empty((0, system.nq)) if isinstance(loop, str) else loop.starts
    whole = not isinstance(loop, str) and len(starts) == loop.count
    q = starts if whole else _find_starts(system, home, spend)
    q, several = _select_one_freedom(system, q, freedoms.dof or 1)
    parts = list[Component]()
    late = False
    while len(q):
        left = time.remaining_seconds
        if left is not None and left <= 0.0:
            return Traced(tuple(parts), several, True)
        path = call_until_interrupt(
            trace, system, start=q[0], ways="branches", budget=Budget(time_limit=left)
        )
        late |= path.late
        part = Component((path, *path.others), still)
        if part.dimension or (path.success and not mobility(system, q[0]).dof):
            parts.append(part)
        if path.interrupted:
            return Traced(tuple(parts), several, late, True)
        q = q[1:]
        q = q[~part.contains(q)] if len(q) else q
    return Traced(tuple(parts), several, late)


def _select_one_freedom(system: Model, q: Array, dof: int) -> tuple[Array, frozenset[int]]:
    """Select configurations (k, nq) with `dof` freedoms by rank, or as few as found. Also return
    the true freedoms of others.
    """
    left = system.nv - Spectrum(Manifold(system, 1).evaluate_equations(q)[1], 1.0).compute_ranks(
        Level.CLOSED
    )
    most = max(dof, int(left.min(initial=system.nv)))
    others = {mobility(system, q[left == k][0]).dof or 0 for k in np.unique(left) if k > most}
    return q[left <= most], frozenset(others - {0, 1})


def _find_starts(system: Model, home: Array, spend: Budget) -> Array:
    """Find closed configurations (k, nq) within all limits: near home, random ones, and assembly
    modes.
    """
    rng = np.random.default_rng(spend.rng)
    manifold = Manifold(system, 1)
    found = [home[None]]
    q = manifold.draw_configurations(rng, read_start_count(spend.starts, DRAWN))
    found.append(q)
    for name in system.coordinate_names if system.dim == 2 else ():
        k = system.coordinate_names.index(name)
        if find_closed_form(system, [name]):
            low = q[:, k].min(initial=0.0)
            high = q[:, k].max(initial=0.0)
            low, high = (
                (-np.pi, np.pi)
                if manifold.circle[list(system.structure.layout.vector_q).index(k)]
                else (low, high)
            )
            for x in low + (np.arange(VALUES) + rng.random()) / VALUES * (high - low):
                found.append(assembly_modes(system, {name: x}).q)
    q = manifold.metric.choose_representatives(np.concatenate(found), None)
    return q[manifold.are_allowed(q)]
