"""The search for assembly modes from many starts, and what it is worth.

Random starts are closed and sorted. When each mode has been found often enough, places are tried
where others may hide: mirror images and mixtures of those found. Nothing of this proves that all
are found, but parity can prove that some are not: the map from what is unknown to how far the loops
are open has as many regular zeros as its degree modulo 2 says, which is 0 if not all values are
taken. So their number is even where angles alone are unknown, which run around closed circles, and
where particles are tied by distances, which are not negative (Milnor, Topology from the
differentiable viewpoint, 1965).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.first_order.generic_configurations import idle_at
from kempe.budget import Budget
from kempe.description.parts import Declared
from kempe.errors import InputError
from kempe.joints import P
from kempe.kinematics.closure_rows import RANK_TOLERANCE, evaluate
from kempe.kinematics.configuration import home_of, random
from kempe.kinematics.forward import jacobian
from kempe.model.tree.coordinates import distinct
from kempe.model.tree.own_tree import own_tree
from kempe.singular_values import svd
from kempe.solvers.assembly.assembler import Assembler, of_equations
from kempe.solvers.assembly.ideal import ideal_of
from kempe.solvers.common.clock import BROKEN_OFF, ENDLESS, TimeLimit
from kempe.solvers.modes.mirror_images import mirrored, mixed
from kempe.solvers.modes.same_configuration import SAME, Clusters
from kempe.spatial import Array

ONCE = Budget(starts=1)

if TYPE_CHECKING:
    from kempe.model.system import System

ROUND = 128
"""Starts in one batch; after each it is checked whether the search may end."""
SEEN_OFTEN = 6
LEAST = 512
"""The search ends when each mode has been found this many times, and after so many starts: of a
mode to which 1 % of them leads, fewer would miss more than one in a hundred."""
MANY = 1024
HOPELESS = 0.1
"""After so many starts a search ends that, by estimate, has found less than this part: there are
thousands."""
KICK = 1e-2
STAYED = 0.1
"""A step along a freedom that seems left, and how much of it must remain when the loops are closed
again."""
LONGER = 1024
"""Starts after which a search may end though the number found is odd, where that proves nothing."""
REGULAR = 1e-5
"""Smallest singular value, as a part of the largest, of the equations at a mode that counts as one
for parity."""
MIXED = 64
"""Mixtures of modes that are tried, at most four for each."""
CONFIDENCE = 0.95
"""Confidence of what is said about modes that were not found."""


@dataclass
class ModesSearch:
    """Modes found: `clusters`, `free` (k,) freedoms left at each, `twin` (k,) the first of those
    that are its images.

    With a `frame`, modes are one that put it at the same pose. `spins` are the idle freedoms that
    do not count (`requested` whether they were looked for), `odd` says that the number found must
    be even, and is not, `broken` what ended the search early.
    """

    system: System
    known: dict[str, Any]
    near: Array | None
    rng: np.random.Generator
    bound: Assembler
    clusters: Clusters
    frame: str | None = None
    free: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    twin: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    spins: tuple[Any, ...] = ()
    requested: bool = False
    tried: int = 0
    odd: bool = False
    broken: BaseException | None = None
    limits: bool = False
    """Whether starts are drawn inside the limits, and only what is inside them is asked for."""

    @property
    def bounded(self) -> bool:
        """Whether limits keep starts from a part of the configurations."""
        if not self.limits:
            return False
        low = self.system.lower
        high = self.system.upper
        coordinates = self.system.structure.coordinates
        period = self.clusters.metric.period
        whole = coordinates.turning & (period > 0.0) & (high - low >= period * (1.0 - 1e-9))
        whole |= np.isinf(low) & np.isinf(high)
        held = np.array(
            [n in self.bound.held for n in self.system.structure.velocity_names], dtype=bool
        )
        return not bool(np.all(whole | held))

    @property
    def hits(self) -> np.ndarray:
        """How often each isolated mode or one of its mirror images was found."""
        isolated = self.free == 0
        return np.bincount(self.twin[isolated], weights=self.clusters.hits[isolated]).astype(
            np.int64
        )[np.unique(self.twin[isolated])]

    def copy(self) -> ModesSearch:
        """What was found so far, which later rounds leave as it is."""
        clusters = copy.copy(self.clusters)
        clusters.members = [list(m) for m in clusters.members]
        return replace(self, clusters=clusters, twin=self.twin.copy())

    def take(self, q: Array, counted: bool) -> tuple[np.ndarray, np.ndarray]:
        """Close configurations (n, nq) and sort them in; which of them closed (n,), and their
        clusters.
        """
        answer = self.bound(self.known, q, limits=False, budget=ONCE)
        if np.shape(answer.success) != (len(q),):
            raise InputError("known coordinates must be single numbers, known frames single places")
        good = np.asarray(answer.success)
        found = self.clusters.metric.representatives(np.asarray(answer.q)[good], self.near)
        tolerance = np.maximum(SAME, 10.0 * np.sqrt(np.asarray(answer.residual)[good]))
        where = self.clusters.add(found, tolerance, counted)
        self._look(len(self.free))
        if counted and self.frame is None and not self.requested and self.free.any():
            self.requested = True
            self._leave_out_spins(found, tolerance)
        return good, where

    def _look(self, first: int) -> None:
        """Find the freedoms of the clusters from the first new one on, each its own twin."""
        new = freedoms(self.system, self.bound, self.known, self.clusters, self.clusters.q[first:])
        self.free = np.concatenate([self.free[:first], new])
        self.twin = np.concatenate([self.twin[:first], np.arange(first, len(self.free))])

    def _leave_out_spins(self, q: Array, tolerance: Array) -> None:
        """Count configurations that differ only by idle spins as one, from here on."""
        held = [self.system.structure.velocity_names.index(n) for n in self.bound.held]
        idle = idle_at(
            own_tree(ideal_of(self.system)), self.clusters.q[int(np.argmax(self.free > 0))]
        )
        self.spins = tuple(f for f in idle if not f.velocity[held].any())
        moved = {b for f in self.spins for b in (*f.bodies, *f.links)}
        rest = tuple(b for b in self.system.body_names[1:] if b not in moved)
        if self.spins and rest:
            before = self.clusters
            self.clusters = Clusters(self.system, rest)
            self.clusters.add(q, tolerance)
            self.clusters.add(before.q, before.tolerance, False)
            self._look(0)

    def complete(self) -> bool:
        """Look for modes where those found suggest some, mirror images last; whether there are new
        ones.
        """
        before = len(self.free)
        modes = self.clusters.q[self.free == 0]
        if not len(modes):
            return False
        if len(modes) > 1:
            self.take(
                mixed(
                    self.system,
                    modes,
                    min(MIXED, 4 * len(modes)),
                    np.random.default_rng(len(modes)),
                ),
                False,
            )
        isolated = np.flatnonzero(self.free == 0)
        modes = self.clusters.q[isolated]
        images = mirrored(self.system, modes)
        if len(images) == len(modes):
            error = np.linalg.norm(evaluate(self.system, images, False, True)[0], axis=1)
            good, where = self.take(images, False)
            exact = error[good] < SAME
            for i, k in zip(isolated[good][exact], where[exact], strict=True):
                self.twin[self.twin == self.twin[max(i, k)]] = self.twin[min(i, k)]
        return len(self.free) > before

    def decided(self) -> bool:
        """Whether each mode was found often, others were looked for in vain, and their number is
        not against it.
        """
        if (
            self.tried < LEAST
            or not len(self.free)
            or not np.all(self.hits >= SEEN_OFTEN)
            or self.complete()
        ):
            return False
        return not self.is_odd() and (
            len(self.free) % 2 == 0 or bool(self.free.any()) or self.tried >= LONGER
        )

    def is_odd(self) -> bool:
        """Whether the number of modes is odd, and must be even: of all modes, so not where limits
        leave some out.
        """
        return (
            not self.bounded
            and not self.free.any()
            and len(self.free) % 2 == 1
            and must_be_even(self)
        )


def search(
    system: System,
    known: dict[str, Any],
    near: Array | None,
    frame: str | None,
    rng: np.random.Generator,
    starts: int,
    budget: TimeLimit = ENDLESS,
    progress: Callable[[int, int], Any] | None = None,
    limits: bool = False,
) -> ModesSearch:
    """Assembly modes from at most so many random starts, the first of them `near` or home.

    With `limits` starts are drawn inside the limits, else all over the configurations. An
    interrupt, or the end of the time, which is looked for after each round, leaves what the rounds
    before found.
    """
    system = own_tree(system)
    bound = of_equations(system, known)
    s = ModesSearch(
        system,
        known,
        near,
        rng,
        bound,
        Clusters(system, _places(system, frame)),
        frame,
        limits=limits,
    )
    while s.tried < starts:
        before = s.copy()
        try:
            with budget:
                budget.check()
                done = _one_round(s, starts)
            before = s  # the round is done
            if progress is not None:
                progress(s.tried, len(s.free))
        except BROKEN_OFF as error:
            s = before
            s.broken = error
            break
        if done:
            break
    else:
        s.complete()  # what those found suggest costs next to nothing
    s.odd = s.is_odd()
    return s


def _one_round(s: ModesSearch, starts: int) -> bool:
    """Whether the search may end after one more round of starts."""
    system = s.system
    near = s.near
    n = min(ROUND, starts - s.tried)
    start = random_starts(s, n)
    if s.tried == 0:
        start[0] = home_of(system) if near is None else near
    s.tried += n
    s.take(start, True)
    if s.decided():
        return True
    hits = s.hits
    return bool(s.tried >= MANY and len(hits) and share_found(hits) < HOPELESS)


def _places(system: System, frame: str | None) -> tuple[str, ...]:
    """The frames whose poses tell modes apart; none where coordinates do.

    Angles in a relation of several wind up: after full turns of some of them all bodies are where
    they were.
    """
    if frame is not None:
        return (frame,)
    turning = dict(
        zip(
            system.structure.velocity_names,
            system.structure.coordinates.turning.tolist(),
            strict=True,
        )
    )
    winds = any(sum(turning[n] for n in (r.of, *r.sources)) > 1 for r in system.structure.relations)
    return tuple(system.body_names[1:]) if winds else ()


def random_starts(s: ModesSearch, n: int) -> Array:
    """Starts (n, nq): angles over their period, free lengths up to two characteristic ones; all
    inside the limits, if these count, else every other one: in the rest angles run over their
    period, and lengths beyond their limits.
    """
    system = s.system
    metric = s.clusters.metric
    limits: Array = system.structure.limits
    turning = system.structure.coordinates.turning
    layout = system.structure.layout
    q = random(system, s.rng, n)
    endless = ~np.isfinite(limits).all(axis=-1) & ~turning
    slides = endless[layout.vector_v]
    q[:, layout.vector_q[slides]] *= 2.0 * metric.length
    geared = (metric.period > 6.3) & np.isinf(limits).all(axis=-1)
    q[:, layout.vector_q[geared[layout.vector_v]]] *= metric.period[geared] / (2.0 * np.pi)
    if s.limits:
        return q
    bounded = np.flatnonzero(np.any(np.isfinite(limits), axis=-1)[layout.vector_v])
    v = layout.vector_v[bounded]
    at = layout.vector_q[bounded]
    reach = np.where(turning, np.maximum(metric.period, 2.0 * np.pi) / 2.0, 2.0 * metric.length)
    beyond = np.where(np.isfinite(limits) & ~turning[:, None], limits, 0.0)
    low = np.minimum(beyond[:, 0], 0.0) - reach
    high = np.maximum(beyond[:, 1], 0.0) + reach
    wide = np.arange(n) % 2 == 1
    q[np.ix_(wide, at)] = low[v] + s.rng.random((int(wide.sum()), len(v))) * (high - low)[v]
    return q


# ---- what is left to move


def freedoms(
    system: System, bound: Assembler, known: dict[str, Any], clusters: Clusters, q: Array
) -> np.ndarray:
    """Freedoms (k,) that are left at configurations: nullities of the Jacobian, where a step along
    one can be closed.

    Where only some frames count, those that move them. Where frames are known, which the Jacobian
    does not hold, steps go in random directions, and 1 stands for any.
    """
    free = [i for i, n in enumerate(system.structure.velocity_names) if n not in bound.held]
    out = np.zeros(len(q), dtype=np.int64)
    if not len(q):
        return out
    J = evaluate(system, q, True, True)[1][..., free]
    values = svd(J, compute_uv=False)
    ranks = (
        values > RANK_TOLERANCE * np.maximum(1.0, values.max(axis=-1, initial=0.0))[:, None]
    ).sum(axis=-1)
    owner: list[int] = []
    kicks: list[Array] = []
    sizes: list[float] = []
    loose = np.arange(len(q)) if bound.frames else np.flatnonzero(ranks < len(free))
    spaces = svd(J[loose])[2] if len(loose) and not bound.frames else J[loose]
    for k, space in zip(loose.tolist(), spaces, strict=True):
        if bound.frames:
            null_space = np.random.default_rng(0).normal(size=(2, len(free)))
            size = np.ones(2)
        else:
            null_space, size = _moving(system, clusters, q[k], free, space[ranks[k] :])
        owner += [k] * (2 * len(null_space))
        kicks += [*null_space, *-null_space]
        sizes += [*size, *size]
    if not kicks:
        return out
    v = np.zeros((len(kicks), system.nv))
    v[:, free] = KICK * np.array(kicks)
    answer = bound(
        known,
        system.structure.layout.integrate(q[owner], v * clusters.metric.scale),
        limits=False,
        budget=ONCE,
    )
    moved = clusters.distances(np.asarray(answer.q), q[owner]) > STAYED * KICK * np.array(sizes)
    moved &= np.asarray(answer.success)
    found = np.unique(np.array(owner, dtype=np.int64)[moved])
    out[found] = 1 if bound.frames else np.bincount(owner, minlength=len(q))[found] // 2
    return out


def _moving(
    system: System, clusters: Clusters, q: Array, free: list[int], null_space: Array
) -> tuple[Array, Array]:
    """Directions (k, n) in a null space (rows) that move what counts, and how far they move it."""
    if not clusters.frames:
        return null_space, np.ones(len(null_space))
    scale = clusters.metric.scale[free]
    J = np.concatenate([jacobian(system, q, f)[:, free] * scale for f in clusters.frames])
    J.reshape(-1, 6, len(free))[:, :3] /= clusters.metric.length
    _, sizes, V = svd(J @ null_space.T)
    moving = sizes > RANK_TOLERANCE * 1e2
    return V[: len(sizes)][moving] @ null_space, sizes[moving]


# ---- what the search is worth


def must_be_even(s: ModesSearch) -> bool:
    """Whether the number of modes is even for sure, all found being regular solutions of as many
    equations as unknowns.

    See the module. Limits do not count, and modes that are one only as to some frames are not
    looked at. Rods that spin between balls act on all configurations, open ones too, and change no
    equation: what is counted are their orbits.
    """
    system = s.system
    bound = s.bound
    metric = s.clusters.metric
    if bound.frames or (s.clusters.frames and not s.spins) or not len(s.clusters.q):
        return False
    free = [i for i, n in enumerate(system.structure.velocity_names) if n not in bound.held]
    if distinct(system.mechanism, system.structure.coordinates)[
        free
    ].any():  # laws may read angles of no circle
        return False
    J = evaluate(system, s.clusters.q, True, True)[1][..., free]
    if (
        J.shape[1] + len(s.spins) != J.shape[2]
        or not J.size
        or not all(_rigid(s, f) for f in s.spins)
    ):
        return False
    values = svd(J, compute_uv=False)
    if np.any(values[:, -1] < REGULAR * values[:, 0]):
        return False
    return all(metric.period[i] > 0.0 or _round(system, i) or _tied(system, i) for i in free)


def _rigid(s: ModesSearch, spin: Any) -> bool:
    """Whether what spins is one part with the known coordinates held, and has no further links in
    its balls.
    """
    mechanism = s.system.mechanism
    inside = [j for j in mechanism.joints.values() if {j.parent, j.child} <= {*spin.bodies}]
    names = {
        f"{j.name}.{v}" if v else j.name
        for j in inside
        for v in j.type.velocities(s.system.dim, False)
    }
    return not spin.links and not (names & {*s.system.structure.velocity_names}) - s.bound.held


def _round(system: System, i: int) -> bool:
    """Whether a velocity is one of a quaternion, which runs around a sphere."""
    return bool(
        np.any(
            (i >= system.structure.layout.quaternion_v)
            & (i < system.structure.layout.quaternion_v + 3)
        )
    )


def _equations(system: System) -> list[Declared]:
    """The declared constraints that are equations."""
    return [c for c in system.mechanism.constraints.values() if c.equations(system.dim)]


def _tied(system: System, i: int) -> bool:
    """Whether a velocity is one of a particle's place, and distances are the only constraints: as
    some solution is regular, these tie it to what stays near.
    """
    mechanism = system.mechanism
    kinds = {c.rod for c in _equations(system)}
    joint = mechanism.joints.get(system.structure.velocity_names[i].rpartition(".")[0])
    if (
        joint is None
        or kinds != {True}
        or system.structure.relations
        or not mechanism.bodies[joint.child].particle
    ):
        return False
    names, primitives = joint.type.layout(system.dim, True)
    slides = sorted((p.kind, p.axis) for p in primitives)
    return len(names) == len(primitives) and slides == [(P, axis) for axis in "xyz"[: system.dim]]


def share_found(hits: np.ndarray) -> float:
    """Share of starts, by estimate, that lead to what was found: 1 - f1 / n, with f1 found once
    (Good, 1953).
    """
    return 1.0 - float(np.sum(hits == 1)) / max(float(np.sum(hits)), 1.0)


def estimates(hits: np.ndarray) -> tuple[float, float]:
    """Coverage and number of modes, from how often (k,) each was found; of coverage a lower bound.

    The share of starts that lead to others is estimated as f1 / n, with f1 modes found once, and n
    hits (Good, 1953, after Turing). The coverage is 1 less the upper bound of that share (Clopper,
    Pearson, 1934): with no mode found once, 3 / n. The number is at least k + f1 (f1 - 1) / (2 (f2
    + 1)), f2 found twice (Chao, 1984, bias-corrected).
    """
    n = int(np.sum(hits))
    once = int(np.sum(hits == 1))
    twice = int(np.sum(hits == 2))
    if not n:
        return 0.0, 0.0
    return 1.0 - _upper(once, n), len(hits) + once * (once - 1) / (2.0 * (twice + 1))


def _upper(seen: int, n: int) -> float:
    """The largest share at which no more than `seen` of `n` would still be seen with probability 1
    - CONFIDENCE.
    """
    if seen >= n:
        return 1.0
    low = seen / n
    high = 1.0
    ways = [
        math.lgamma(n + 1) - math.lgamma(i + 1) - math.lgamma(n - i + 1) for i in range(seen + 1)
    ]
    for _ in range(60):
        x = 0.5 * (low + high)
        terms = (
            [w + i * math.log(x) + (n - i) * math.log1p(-x) for i, w in enumerate(ways)]
            if x < 1.0
            else [-np.inf]
        )
        low, high = (x, high) if sum(map(math.exp, terms)) > 1.0 - CONFIDENCE else (low, x)
    return high
