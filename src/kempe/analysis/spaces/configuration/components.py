"""Connected components of the configuration space: by theorem, or by tracing every curve that is found."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.continuation.path import Event, Path
from kempe.analysis.motion.motion import trace
from kempe.analysis.spaces.configuration.manifold import Manifold
from kempe.analysis.spaces.configuration.single_loop import polygon_of, rod_count
from kempe.budget import Budget, Usual
from kempe.calls import brief, explained, explained_methods
from kempe.kinematics.common.result import Report
from kempe.kinematics.configuration import has_loops
from kempe.kinematics.one_sided import one_sided_rows
from kempe.solvers.assembly.idle import spins_of
from kempe.solvers.common.arguments import start_count
from kempe.solvers.common.clock import TIME_LIMIT, TimeLimit
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import System

STARTS, VALUES = 256, 24
"""Random assemblies from which curves are traced, and values of each coordinate at which assembly modes are."""
NEAR, SAME = 0.3, 1e-5
"""Distance from a node of a curve from which it is looked closer at, and that below which a point is on it."""
USUAL = Usual("components", starts=STARTS, rng=0, time_limit=TIME_LIMIT)


@dataclass(frozen=True, eq=False)
class Component:
    """A component with one freedom (idle spins left out): the curves that it consists of, joined at bifurcations."""

    paths: tuple[Path, ...]
    still: np.ndarray = field(repr=False)
    """Velocity coordinates (nv,) that idle spins change: they do not count."""

    @property
    def length(self) -> float:
        """Length of all its curves, in radians and characteristic lengths."""
        return float(sum(p.length for p in self.paths))

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The least and largest value of each coordinate on it."""
        q = np.concatenate([p.track.q for p in self.paths])
        return dict(zip(self.paths[0].system.coordinate_names, zip(q.min(0).tolist(), q.max(0).tolist(), strict=True),
                        strict=True))  # fmt: skip

    @property
    def singular_points(self) -> tuple[Event, ...]:
        """Where curves meet, or the rank drops otherwise, each once."""
        system = self.paths[0].system
        found: list[Event] = []
        for event in (e for p in self.paths for e in p.singular_points):
            if not any(Manifold(system, 1).metric.distances(event.q[None], e.q[None])[0] < SAME for e in found):
                found.append(event)
        return tuple(found)

    def place(self, q: Array) -> tuple[np.ndarray, Array, Array]:
        """For configurations (k, nq) the curve (k,) that is nearest, the arc length (k,) there, and the distance (k,).

        The distance is infinite where no curve is near.
        """
        which, s, far = np.zeros(len(q), dtype=int), np.zeros(len(q)), np.full(len(q), np.inf)
        for i, path in enumerate(self.paths):
            at, off = _nearest(path, q, ~self.still)
            better = off < far
            which[better], s[better], far[better] = i, at[better], off[better]
        return which, s, far

    def contains(self, q: Array) -> np.ndarray:
        """Whether (k,) configurations (k, nq) are on it."""
        return self.place(q)[2] < SAME

    def __str__(self) -> str:
        first = self.paths[0]
        kind = "closed curve" if first.closed else "curve"
        turns = [f"{counted(abs(k), 'turn')} of {n!r}" for n, k in first.turns.items()]
        text = f"{kind} of length {first.length:.6g}" if len(self.paths) == 1 else \
            f"{counted(len(self.paths), 'curve')} of total length {self.length:.6g}"  # fmt: skip
        text += f", {', '.join(turns)}" if turns and len(self.paths) == 1 else ""
        points = len(self.singular_points)
        return text + (f", {counted(points, 'singular point')}" if points else "")


def _nearest(path: Path, q: Array, useful: np.ndarray) -> tuple[Array, Array]:
    """Arc lengths (k,) of the points of a path nearest to configurations (k, nq), and their distances (k,)."""
    manifold, track = Manifold(path.system, 1), path.track
    nodes, t = track.q, np.where(useful, track.t, 0.0)
    best, far = np.zeros(len(q), dtype=int), np.full(len(q), np.inf)
    for k, node in enumerate(nodes):
        off = np.linalg.norm(manifold.between(np.broadcast_to(node, q.shape), q)[:, useful], axis=1)
        best, far = np.where(off < far, k, best), np.minimum(off, far)
    s, near = track.s[best], np.flatnonzero(far < NEAR)
    for _ in range(12) if len(near) and len(nodes) > 1 else ():
        way = np.where(useful, manifold.between(path.at(s[near]), q[near]), 0.0)
        far[near] = np.linalg.norm(way, axis=1)
        k = np.clip(np.searchsorted(track.s, np.mod(s[near], path.length or 1.0), side="right") - 1, 0, len(nodes) - 2)
        u = ((np.mod(s[near], path.length) - track.s[k]) / (track.s[k + 1] - track.s[k]))[:, None]
        along = (1.0 - u) * t[k] + u * t[k + 1]
        size = np.maximum(np.sum(along**2, axis=1), 1e-12)
        s[near] = np.clip(s[near] + np.sum(along * way, axis=1) / size, *((-np.inf, np.inf) if path.closed
                                                                          else (0.0, path.length)))  # fmt: skip
    return np.mod(s, path.length) if path.closed and path.length else s, np.where(far < NEAR, far, np.inf)


@explained_methods
@dataclass(frozen=True, eq=False)
class Components(Report):
    """The connected components of a configuration space.

    `count` is their number, a lower bound unless `complete`, and `reason` says why it is the one or the other. `parts`
    are those with one freedom, as curves; `singular` (k, nq) are the singular points that are known. `dimension` is the
    number of freedoms, of which `idle` spins do not count.
    """

    __repr__ = brief

    system: System = field(repr=False)
    count: int
    complete: bool
    reason: str
    dimension: int | None
    idle: int = 0
    parts: tuple[Component, ...] = ()
    singular: Array = field(default_factory=lambda: np.empty((0, 0)), repr=False)
    late: bool = False

    @cached_property
    def code(self) -> Status:  # type: ignore[override]
        """The outcome: `PARTLY` where the count is a lower bound, `NONE_EXISTS` where it is proven to be 0."""
        if self.complete:
            return Status.SOLVED if self.count else Status.NONE_EXISTS
        return Status.OUT_OF_TIME if self.late else Status.PARTLY if self.count else Status.NOT_FOUND

    @property
    def status(self) -> str:
        """How many there are, and why these are all or are not."""
        few = "" if self.complete or not self.count else "at least "
        proven = "proven" if self.complete else "a lower bound"
        idle = f", {counted(self.idle, 'idle spin')} left out" if self.idle else ""
        return f"{few}{counted(self.count, 'connected component')}{idle}; {proven}: {self.reason}"

    def _notes(self) -> list[str]:
        lines = [f"{k + 1}: {part}" for k, part in enumerate(self.parts)]
        return lines + ([f"{counted(len(self.singular), 'singular point')} of the space"] if len(self.singular) else [])

    def _headline(self) -> str:
        return f"{self.system.name}: {self.status}"

    def _data(self) -> dict[str, Any]:
        names = self.system.coordinate_names
        parts = [{"length": p.length, "curves": len(p.paths), "closed": all(x.closed for x in p.paths),
                  "ranges": p.ranges} for p in self.parts]  # fmt: skip
        singular = [dict(zip(names, q.tolist(), strict=True)) for q in self.singular]
        own = {n: getattr(self, n) for n in ("count", "complete", "reason", "dimension", "idle", "late")}
        return {"system": self.system.name} | own | {"parts": parts, "singular": singular}


@explained
def components(system: System, *, budget: Budget | None = None) -> Components:
    """The connected components of the configuration space, with the proof, or as a lower bound with the reason.

    A tree has one. Planar single loops of revolute joints have as many as the theorem on long bars says, two cranks and
    a rod between balls as many as the roots of a quartic say (see `single_loop`). Systems with one freedom are
    traced, idle spins held, from random assemblies and, where these have a closed form, from the assembly modes at
    24 values of each coordinate; curves that meet at bifurcations are one component, and limits cut curves. Without a
    theorem a curve may be missed that none of them is on: the count is then a lower bound, as it is of other systems
    with several freedoms. Of the `budget` are read: starts (256), rng (0), time_limit (120 s).
    """
    spend = USUAL.of(budget)
    time = TimeLimit(spend.time_limit)
    if not has_loops(system):
        divided = bool(one_sided_rows(system).declared)
        why = "one-sided constraints may divide it" if divided else "a product of circles, intervals and rotations"
        return Components(system, 1, not divided, why, system.nv)
    polygon, rod = polygon_of(system), rod_count(system)
    known = rod if not isinstance(rod, str) else None
    if not isinstance(polygon, str):
        known = polygon.count, polygon.reason
    if known and not known[0]:
        return Components(system, 0, True, known[1], None)
    mobility = system.mobility()
    if not mobility.closed or mobility.dof is None:
        return Components(system, 0, False, mobility.sentence, None)
    if mobility.dof == 0:
        modes = system.assembly_modes()
        return Components(system, len(modes), modes.complete, f"a structure, {modes.status}", 0)
    singular = np.empty((0, system.nq)) if isinstance(polygon, str) else polygon.aligned()
    if mobility.useful != 1:
        count, why = known or (
            1,
            f"no theorem is known here for {counted(mobility.dof or 0, 'freedom')}; one configuration is known",
        )
        return Components(system, count, known is not None, why, mobility.dof, mobility.idle, (), singular)
    parts, late = _traced(system, mobility.q, spend, time)
    points = [e.q for part in parts for e in part.singular_points]
    singular = np.array(points).reshape(-1, system.nq)
    if known is None:
        limited = "limits cut its curves, and " if one_sided_rows(system).names else ""
        why = f"{limited}a curve that no start led to may be missed"
        return Components(system, len(parts), False, why, 1, mobility.idle, parts, singular, late)
    found = "" if len(parts) == known[0] else f"; {counted(len(parts), 'curve')} traced"
    return Components(system, known[0], True, known[1] + found, 1, mobility.idle, parts, singular, late)


def _traced(system: System, home: Array, spend: Budget, time: TimeLimit) -> tuple[tuple[Component, ...], bool]:
    """All components to which starts lead, and whether the time was up before all starts were used."""
    still = moved_by_spins(system, home)
    q, late = _starts(system, home, spend), False
    parts: list[Component] = []
    while len(q):
        left = None if time.limit is None else time.end - monotonic()
        if left is not None and left <= 0.0:
            return tuple(parts), True
        path = trace(system, start=q[0], ways="branches", budget=Budget(time_limit=left))
        late |= path.late
        part = Component((path, *path.others), still)
        if path.success:
            parts.append(part)
        q = q[1:]
        q = q[~part.contains(q)] if len(q) else q
    return tuple(parts), late


def moved_by_spins(system: System, q: Array) -> np.ndarray:
    """Which velocity coordinates (nv,) idle spins change; of a rotation, all three."""
    out = np.any([s.moves for s in spins_of(system, q)] or [np.zeros(system.nv, dtype=bool)], axis=0)
    for iv in system.structure.layout.quaternion_v:
        out[iv : iv + 3] = out[iv : iv + 3].any()
    return np.asarray(out)


def _starts(system: System, home: Array, spend: Budget) -> Array:
    """Closed configurations (k, nq) within all limits: near home, random ones, and assembly modes of a closed form."""
    rng = np.random.default_rng(spend.rng)
    manifold, found = Manifold(system, 1), [home[None]]
    q = manifold.drawn(rng, start_count(spend.starts))
    found.append(q)
    for name in system.coordinate_names if system.dim == 2 else ():
        k = system.coordinate_names.index(name)
        if system.loops.closed_form([name]):
            low, high = q[:, k].min(initial=0.0), q[:, k].max(initial=0.0)
            low, high = (
                (-np.pi, np.pi) if manifold.circle[list(system.structure.layout.vector_q).index(k)] else (low, high)
            )
            for x in low + (np.arange(VALUES) + rng.random()) / VALUES * (high - low):
                found.append(system.assembly_modes({name: x}).q)
    q = manifold.metric.representatives(np.concatenate(found), None)
    return q[manifold.inside(q)]
