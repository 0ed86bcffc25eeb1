"""`assembly_modes`: all configurations that close a mechanism for given inputs.

Mechanisms made of dyads are solved in closed form, others from many starts. The answer says how
surely it is complete.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.answers.answer import Configurations
from kempe.answers.evidence import Evidence, make_loop_length_evidence
from kempe.answers.known_values import find_source_values, list_known_tasks
from kempe.answers.problem import Problem, Solver, accept_all_problems, solve_problem
from kempe.arguments import (
    explain_errors,
    explain_method_errors,
    make_generator,
    raise_interrupted,
    read_flag,
    read_start_count,
)
from kempe.arrays import check_range
from kempe.assemble.assemble import assemble
from kempe.assemble.bound import Assembler, get_equation_assembler
from kempe.assemble.dyad_proofs import enclose_branches
from kempe.assemble.dyads import CLOSED, MOST_SIGNS, DyadAnswer, Incomplete, Plan, find_closed_form
from kempe.assemble.from_poses import read_configurations
from kempe.assemble.idle_freedoms import find_idle_freedoms_at
from kempe.assemble.nearest_exact import answer_within_tolerance, find_ideal_system
from kempe.assemble.same_configuration import INSIDE, SAME, Clusters, get_metric
from kempe.budget import Budget, TimeUp, Usual
from kempe.constraints.tape import TIME
from kempe.description.parts import Declared
from kempe.equations.closure_rows import evaluate_constraints
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError, format_value
from kempe.forward.fk import fk, jacobian
from kempe.joints import P
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import (
    compute_free_reach,
    find_home,
    list_sources,
    read_start,
    refuse_large_numbers,
    sample_configurations,
)
from kempe.model.coordinates import find_wound_coordinates
from kempe.model.model import keep_answers
from kempe.model.own_tree import remove_cut_marks
from kempe.model.time_coordinate import fix_known_time
from kempe.numerics.clock import (
    BROKEN_OFF,
    ENDLESS,
    TIME_LIMIT,
    TimeLimit,
    describe_early_end,
    find_time_limit,
    limit_time,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.report import ROWS, Table
from kempe.spatial import Array, xyz_rpy_from_pose
from kempe.status import Status
from kempe.words import Quantity, choose_verb, format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- mirror images and mixtures: where further modes are looked for

# Where the points by which bodies are connected lie in a plane (in a planar system: on a line), on
# the ground and on each body, the mirror image of a closed configuration in the ground's plane is
# closed, too: distances do not tell left from right. Where they do not, the bodies are put as near
# to the image as may be; whoever reads these configurations closes them, so nothing rests on them.


def mirror_configurations(system: Model, q: Array) -> Array:
    """Mirror configurations (n, nq) in the plane of the ground's points.

    There are none if these points lie in no plane.
    """
    plane = _find_ground_plane(system)
    if plane is None or not len(q):
        return np.empty((0, system.nq))
    center, normal = plane
    poses = fk(system, q)[:, 1:]
    out = poses.copy()
    for i, points in enumerate(_list_body_points(system)[1:]):
        image = poses[:, i, :3, :3] @ points.T + poses[:, i, :3, 3:]  # (n, 3, points)
        image = image - 2.0 * normal[:, None] * (normal @ (image - center[:, None]))[:, None, :]
        out[:, i] = _fit_poses(system, i + 1, points, np.swapaxes(image, 1, 2), poses[:, i])
    found = read_configurations(system, out, q)
    return found[np.isfinite(found).all(axis=1)]


def mix_configurations(system: Model, q: Array, n: int, rng: np.random.Generator) -> Array:
    """Mix configurations (k, nq): the joints of each of n results are taken from two of them."""
    owner = np.array([name.rpartition(".")[0] or name for name in system.coordinate_names])
    joints, place = np.unique(owner, return_inverse=True)
    first, second = rng.integers(len(q), size=(2, n))
    return np.where((rng.random((n, len(joints))) < 0.5)[:, place], q[first], q[second])


@keep_answers
def _list_body_points(system: Model) -> list[Array]:
    """List the points (k, 3) of joints and constraints on each body, in its axes.

    Hinges and slides have a second point on their axis, which a mirror image must keep as well.
    """
    m = system.mechanism
    number = {b: i for i, b in enumerate(system.body_names)}
    length = compute_characteristic_length(system)
    points: list[list[Array]] = [[] for _ in system.body_names]
    for owner in (*m.joints.values(), *(c for c in m.constraints.values() if c.parent)):
        joint = m.joints.get(owner.name)
        particle = joint is not None and m.bodies[joint.child].particle
        primitives = () if joint is None else joint.type.layout(system.dim, particle)[1]
        axes = {p.axis for p in primitives}
        letter = axes.pop() if len(axes) == 1 and not particle else ""
        if isinstance(owner, Declared) and not owner.rod:
            letter = "z"
        if joint is not None and particle:
            continue  # a place where it is at neutral, and no end of a link
        if isinstance(owner, Declared):
            places = owner.frames(m.parameters, system.dim)
        else:
            places = owner.X_PF.evaluate_pose(m.parameters), owner.X_CM.evaluate_pose(m.parameters)
        for body, X in zip((owner.parent, owner.child), places, strict=True):
            points[number[body]].append(X[:3, 3])
            along = X[:3, "xyz".index(letter)] if letter else np.zeros(3)
            if system.dim == 3 or np.abs(along[2]) < 0.5:
                points[number[body]].append(X[:3, 3] + length * along)
    return [np.array(p).reshape(-1, 3) for p in points]


@keep_answers
def _find_ground_plane(system: Model) -> tuple[Array, Array] | None:
    """Find the plane (in a planar system: the line) of the ground's points; None if there is none.

    It is returned as point and normal.
    """
    points = _list_body_points(system)[0]
    dim = system.dim
    if not len(points):
        return None
    center = points.mean(axis=0)
    spectrum = Spectrum((points - center)[:, :dim], compute_characteristic_length(system))
    normal = spectrum.right[-1]
    if spectrum.compute_rank(Level.GENERIC) == dim:
        return None
    return center, np.append(normal, np.zeros(3 - dim))


def _fit_poses(system: Model, body: int, points: Array, image: Array, poses: Array) -> Array:
    """Fit poses (n, 4, 4) that bring points (k, 3) of a body nearest to images (n, k, 3).

    After Kabsch, 1976.
    """
    out = poses.copy()
    if not len(points):
        return out
    if system.mechanism.bodies[system.body_names[body]].particle:
        out[:, :3, 3] = image.mean(axis=1)
        return out
    middle = points.mean(axis=0)
    place = image.mean(axis=1)
    H = np.swapaxes(points - middle, 0, 1) @ (image - place[:, None])
    dim = system.dim
    scale = np.linalg.norm(H, axis=(1, 2), keepdims=True)
    # where the points leave a turn open it stays small
    old = np.swapaxes(poses[:, :dim, :dim], 1, 2)
    turn = Spectrum(H[:, :dim, :dim] + 1e-9 * np.maximum(scale, 1e-300) * old).rotation
    out[:, :dim, :dim] = np.swapaxes(turn, 1, 2)
    out[:, :3, 3] = place - out[:, :3, :3] @ middle
    return out


# ---- search from many random starts

# Random starts are closed and sorted. When each mode has been found often enough, places are tried
# where others may hide: mirror images and mixtures of those found. This does not prove that all are
# found.

ONCE = Budget(starts=1)

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
MIXED = 64
"""Mixtures of modes that are tried, at most four for each."""
CONFIDENCE = 0.95
"""Confidence of what is said about modes that were not found."""


@dataclass
class ModesSearch:
    """A search for assembly modes: `clusters` of configurations and their freedoms `free` (k,).

    `twin` (k,) is the index of the first cluster that is a mirror image.

    With a `frame`, modes are one that put it at the same pose. `spins` are the idle freedoms that
    do not count (`requested` whether they were looked for), `odd` says that the number found must
    be even, and is not, `broken` what ended the search early.
    """

    system: Model
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
        """Whether limits exclude a part of the configurations from the starts."""
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
        """Number of times that each isolated mode, or a mirror image of it, was found."""
        isolated = self.free == 0
        return np.bincount(self.twin[isolated], weights=self.clusters.hits[isolated]).astype(
            np.int64
        )[np.unique(self.twin[isolated])]

    def copy_search(self) -> ModesSearch:
        """Copy the search, so that later rounds do not change the copy."""
        clusters = copy.copy(self.clusters)
        clusters.members = [list(m) for m in clusters.members]
        return replace(self, clusters=clusters, twin=self.twin.copy())

    def close_configurations(self, q: Array, counted: bool) -> tuple[np.ndarray, np.ndarray]:
        """Close configurations (n, nq) and sort them into clusters.

        Returns a mask (n,) of those that closed, and their clusters.
        """
        answer = self.bound(self.known, q, limits=False, budget=ONCE)
        if np.shape(answer.success) != (len(q),):
            raise InputError("known coordinates must be single numbers, known frames single places")
        good = np.asarray(answer.success)
        found = self.clusters.metric.choose_representatives(np.asarray(answer.q)[good], self.near)
        tolerance = np.maximum(SAME, 10.0 * np.sqrt(np.asarray(answer.residual)[good]))
        where = self.clusters.add_configurations(found, tolerance, counted)
        self._count_cluster_freedoms(len(self.free))
        if counted and self.frame is None and not self.requested and self.free.any():
            self.requested = True
            self._ignore_idle_spins(found, tolerance)
        return good, where

    def _count_cluster_freedoms(self, first: int) -> None:
        """Count the freedoms of the clusters from `first` on, each of which is its own twin."""
        new = count_freedoms(
            self.system, self.bound, self.known, self.clusters, self.clusters.q[first:]
        )
        self.free = np.concatenate([self.free[:first], new])
        self.twin = np.concatenate([self.twin[:first], np.arange(first, len(self.free))])

    def _ignore_idle_spins(self, q: Array, tolerance: Array) -> None:
        """From here on, treat configurations that differ only by idle spins as one."""
        held = [self.system.structure.velocity_names.index(n) for n in self.bound.held]
        idle = find_idle_freedoms_at(
            remove_cut_marks(find_ideal_system(self.system)),
            self.clusters.q[int(np.argmax(self.free > 0))],
        )
        self.spins = tuple(f for f in idle if not f.velocity[held].any())
        moved = {b for f in self.spins for b in (*f.bodies, *f.links)}
        rest = tuple(b for b in self.system.body_names[1:] if b not in moved)
        if self.spins and rest:
            before = self.clusters
            self.clusters = Clusters(self.system, rest)
            self.clusters.add_configurations(q, tolerance)
            self.clusters.add_configurations(before.q, before.tolerance, False)
            self._count_cluster_freedoms(0)

    def try_suggested_modes(self) -> bool:
        """Try mixtures and mirror images of the modes found; return whether there are new ones."""
        before = len(self.free)
        modes = self.clusters.q[self.free == 0]
        if not len(modes):
            return False
        if len(modes) > 1:
            self.close_configurations(
                mix_configurations(
                    self.system,
                    modes,
                    min(MIXED, 4 * len(modes)),
                    np.random.default_rng(len(modes)),
                ),
                False,
            )
        isolated = np.flatnonzero(self.free == 0)
        modes = self.clusters.q[isolated]
        images = mirror_configurations(self.system, modes)
        if len(images) == len(modes):
            error = np.linalg.norm(
                evaluate_constraints(self.system, images, False, True)[0], axis=1
            )
            good, where = self.close_configurations(images, False)
            exact = error[good] < SAME
            for i, k in zip(isolated[good][exact], where[exact], strict=True):
                self.twin[self.twin == self.twin[max(i, k)]] = self.twin[min(i, k)]
        return len(self.free) > before

    def is_decided(self) -> bool:
        """Return whether the search may end: each mode was found often, and no other is suggested."""
        if (
            self.tried < LEAST
            or not len(self.free)
            or not np.all(self.hits >= SEEN_OFTEN)
            or self.try_suggested_modes()
        ):
            return False
        return not self.has_odd_count() and (
            len(self.free) % 2 == 0 or bool(self.free.any()) or self.tried >= LONGER
        )

    def has_odd_count(self) -> bool:
        """Return whether the number of modes is odd although it must be even.

        That says nothing where limits leave some out.
        """
        return (
            not self.bounded
            and not self.free.any()
            and len(self.free) % 2 == 1
            and has_even_count(self)
        )


def search_modes(
    system: Model,
    known: dict[str, Any],
    near: Array | None,
    frame: str | None,
    rng: np.random.Generator,
    starts: int,
    budget: TimeLimit = ENDLESS,
    progress: Callable[[int, int], Any] | None = None,
    limits: bool = False,
) -> ModesSearch:
    """Search assembly modes from at most `starts` random starts, the first at `near` or home.

    With `limits` starts are drawn inside the limits, else all over the configurations. An
    interrupt, or the end of the time, which is looked for after each round, leaves what the rounds
    before found.
    """
    system = remove_cut_marks(system)
    bound = get_equation_assembler(system, known)
    s = ModesSearch(
        system,
        known,
        near,
        rng,
        bound,
        Clusters(system, _choose_frames(system, frame)),
        frame,
        limits=limits,
    )
    while s.tried < starts:
        before = s.copy_search()
        try:
            with budget:
                budget.check_time()
                done = _search_one_round(s, starts)
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
        s.try_suggested_modes()  # what those found suggest costs next to nothing
    s.odd = s.has_odd_count()
    return s


def _search_one_round(s: ModesSearch, starts: int) -> bool:
    """Search one more round of starts; return whether the search may end."""
    system = s.system
    near = s.near
    n = min(ROUND, starts - s.tried)
    start = sample_starts(s, n)
    if s.tried == 0:
        start[0] = find_home(system) if near is None else near
    s.tried += n
    s.close_configurations(start, True)
    if s.is_decided():
        return True
    hits = s.hits
    return bool(s.tried >= MANY and len(hits) and estimate_share_found(hits) < HOPELESS)


def _choose_frames(system: Model, frame: str | None) -> tuple[str, ...]:
    """Choose the frames whose poses distinguish modes; none where coordinates do.

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


def sample_starts(s: ModesSearch, n: int) -> Array:
    """Sample starts (n, nq), all inside the limits if these count, else every other one.

    Angles run over their period, free screws over a turn, free lengths up to two characteristic
    ones; in the other half of the starts angles run over their period, too, and screws and lengths
    beyond their limits.
    """
    system = s.system
    metric = s.clusters.metric
    limits: Array = system.structure.limits
    turning = system.structure.coordinates.turning
    layout = system.structure.layout
    far = np.where(system.structure.coordinates.angular, np.pi, 2.0 * metric.length)
    q = sample_configurations(system, s.rng, n)
    endless = ~np.isfinite(limits).all(axis=-1) & ~turning
    slides = endless[layout.vector_v]
    q[:, layout.vector_q[slides]] *= (far / compute_free_reach(system))[layout.vector_v[slides]]
    geared = (metric.period > 6.3) & np.isinf(limits).all(axis=-1)
    q[:, layout.vector_q[geared[layout.vector_v]]] *= metric.period[geared] / (2.0 * np.pi)
    if s.limits:
        return q
    bounded = np.flatnonzero(np.any(np.isfinite(limits), axis=-1)[layout.vector_v])
    v = layout.vector_v[bounded]
    at = layout.vector_q[bounded]
    reach = np.where(turning, np.maximum(metric.period, 2.0 * np.pi) / 2.0, far)
    beyond = np.where(np.isfinite(limits) & ~turning[:, None], limits, 0.0)
    low = np.minimum(beyond[:, 0], 0.0) - reach
    high = np.maximum(beyond[:, 1], 0.0) + reach
    wide = np.arange(n) % 2 == 1
    q[np.ix_(wide, at)] = low[v] + s.rng.random((int(wide.sum()), len(v))) * (high - low)[v]
    return q


# ---- freedoms left at a mode


def count_freedoms(
    system: Model, bound: Assembler, known: dict[str, Any], clusters: Clusters, q: Array
) -> np.ndarray:
    """Count the freedoms (k,) left at configurations: null space directions that can be followed.

    Where only some frames count, those that move them. Where frames are known, which the Jacobian
    does not hold, steps go in random directions, and 1 stands for any.
    """
    free = [i for i, n in enumerate(system.structure.velocity_names) if n not in bound.held]
    out = np.zeros(len(q), dtype=np.int64)
    if not len(q):
        return out
    J = evaluate_constraints(system, q, True, True)[1][..., free]
    ranks = Spectrum(J, 1.0).compute_ranks(Level.CLOSED)
    owner: list[int] = []
    kicks: list[Array] = []
    sizes: list[float] = []
    loose = np.arange(len(q)) if bound.frames else np.flatnonzero(ranks < len(free))
    spaces = Spectrum(J[loose]).right if len(loose) and not bound.frames else J[loose]
    for k, space in zip(loose.tolist(), spaces, strict=True):
        if bound.frames:
            null_space = np.random.default_rng(0).normal(size=(2, len(free)))
            size = np.ones(2)
        else:
            null_space, size = _find_moving_directions(
                system, clusters, q[k], free, space[ranks[k] :]
            )
        owner += [k] * (2 * len(null_space))
        kicks += [*null_space, *-null_space]
        sizes += [*size, *size]
    if not kicks:
        return out
    v = np.zeros((len(kicks), system.nv))
    v[:, free] = KICK * np.array(kicks)
    answer = bound(
        known,
        system.structure.layout.integrate_velocity(q[owner], v * clusters.metric.scale),
        limits=False,
        budget=ONCE,
    )
    moved = clusters.compute_distances(np.asarray(answer.q), q[owner]) > STAYED * KICK * np.array(
        sizes
    )
    moved &= np.asarray(answer.success)
    found = np.unique(np.array(owner, dtype=np.int64)[moved])
    out[found] = 1 if bound.frames else np.bincount(owner, minlength=len(q))[found] // 2
    return out


def _find_moving_directions(
    system: Model, clusters: Clusters, q: Array, free: list[int], null_space: Array
) -> tuple[Array, Array]:
    """Find directions (k, n) of a null space that move the frames, and how far they do."""
    if not clusters.frames:
        return null_space, np.ones(len(null_space))
    scale = clusters.metric.scale[free]
    J = np.concatenate([jacobian(system, q, f)[:, free] * scale for f in clusters.frames])
    J.reshape(-1, 6, len(free))[:, :3] /= clusters.metric.length
    spectrum = Spectrum(J @ null_space.T, 1.0)
    moving = spectrum.compute_row_space(Level.GENERIC).T
    return moving @ null_space, spectrum.values[: len(moving)]


# ---- completeness: parity, and estimates from how often modes are found

# Parity can prove that some modes are missing: the map from what is unknown to how far the loops
# are open has as many regular zeros as its degree modulo 2 says, which is 0 if not all values are
# taken. So their number is even where angles alone are unknown, which run around closed circles,
# and where particles are tied by distances, which are not negative (Milnor, Topology from the
# differentiable viewpoint, 1965).


def has_even_count(s: ModesSearch) -> bool:
    """Return whether the number of modes is proven to be even.

    All found must be regular solutions of as many equations as unknowns.

    See the comment above. Limits do not count, and modes that are one only as to some frames are not
    looked at. Rods that spin between balls act on all configurations, open ones too, and change no
    equation: what is counted are their orbits.
    """
    system = s.system
    bound = s.bound
    metric = s.clusters.metric
    if bound.frames or (s.clusters.frames and not s.spins) or not len(s.clusters.q):
        return False
    free = [i for i, n in enumerate(system.structure.velocity_names) if n not in bound.held]
    if find_wound_coordinates(system.mechanism, system.structure.coordinates)[
        free
    ].any():  # laws may read angles of no circle
        return False
    J = evaluate_constraints(system, s.clusters.q, True, True)[1][..., free]
    if (
        J.shape[1] + len(s.spins) != J.shape[2]
        or not J.size
        or not all(_is_rigid_spin(s, f) for f in s.spins)
    ):
        return False
    if np.any(Spectrum(J).compute_ranks(Level.ROUGH) < J.shape[1]):
        return False
    return all(
        metric.period[i] > 0.0 or _is_quaternion_velocity(system, i) or _is_tied_particle(system, i)
        for i in free
    )


def _is_rigid_spin(s: ModesSearch, spin: Any) -> bool:
    """Return whether an idle spin turns one rigid part, with the known coordinates held.

    Its balls must have no further links.
    """
    mechanism = s.system.mechanism
    inside = [j for j in mechanism.joints.values() if {j.parent, j.child} <= {*spin.bodies}]
    names = {
        f"{j.name}.{v}" if v else j.name
        for j in inside
        for v in j.type.list_velocity_names(s.system.dim, False)
    }
    return not spin.links and not (names & {*s.system.structure.velocity_names}) - s.bound.held


def _is_quaternion_velocity(system: Model, i: int) -> bool:
    """Return whether a velocity coordinate is one of a quaternion, which runs around a sphere."""
    return bool(
        np.any(
            (i >= system.structure.layout.quaternion_v)
            & (i < system.structure.layout.quaternion_v + 3)
        )
    )


def _list_equations(system: Model) -> list[Declared]:
    """List the declared constraints that are equations."""
    return [c for c in system._mechanism.constraints.values() if c.count_equations(system.dim)]


def _is_tied_particle(system: Model, i: int) -> bool:
    """Return whether a velocity is one of a particle that only distances hold.

    As some solution is regular, these keep the particle near.
    """
    mechanism = system.mechanism
    kinds = {c.rod for c in _list_equations(system)}
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


def estimate_share_found(hits: np.ndarray) -> float:
    """Estimate the share of starts that lead to modes already found: 1 - f1 / n.

    f1 modes were found once in n hits (Good, 1953).
    """
    return 1.0 - float(np.sum(hits == 1)) / max(float(np.sum(hits)), 1.0)


def estimate_coverage(hits: np.ndarray) -> tuple[float, float]:
    """Estimate coverage, from below, and number of modes from how often (k,) each was found.

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
    return 1.0 - _bound_share(once, n), len(hits) + once * (once - 1) / (2.0 * (twice + 1))


def _bound_share(seen: int, n: int) -> float:
    """Bound the share of starts that `seen` hits in `n` starts allow, with confidence `CONFIDENCE`."""
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


# ---- the answer

STARTS = 4096
"""Starts of a search, at most."""
BESIDE = 128
"""Random starts beside a closed form that leaves branches undetermined, at most."""
USUAL = Usual("assembly_modes", starts=STARTS, rng=0, time_limit=TIME_LIMIT, progress=None)


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Modes(Configurations):
    """Answer of `assembly_modes`: all configurations that close the mechanism, each once.

    Attributes
    ----------
    q
        Configurations (k, nq).
    complete, reason
        Whether no other modes exist, proven by structure, and why.
    branches
        Branch of dyads of each mode as signs such as '+-' (see `Plan.describe`), 0 where two
        branches meet; '' for other mechanisms.
    multiplicity
        Number (k,) of merged roots. In a search, the number of starts that found the mode; 0 for
        modes found from mirror images, combinations, or least squares in an undetermined branch of
        dyads.
    freedoms
        Number (k,) of freedoms that remain with the known values held, without idle freedoms. Where
        it is not 0, the mode is one of infinitely many.
    inside
        Mask (k,) of the modes inside the limits; `outside` counts the dropped ones.
    coverage
        Lower bound, with 95 % confidence, of the share of random starts that lead to the modes
        found; None with a proof.
    expected
        Estimated number of modes; None with a proof.
    late, interrupted
        Whether the time limit or Ctrl-C ended the search.

    Notes
    -----
    A mode is proven where each branch of dyads has a joint that stays open whatever rounding does,
    or closes in one place: its circles and lines cross, or meet within 1e-6 (radians, sizes of the
    mechanism). Sources: Good, Biometrika 40, 1953 (coverage); Chao, Scand. J. Statist. 11, 1984
    (expected).
    """

    _entries = (
        "complete",
        "branches",
        "multiplicity",
        "freedoms",
        "inside",
        "outside",
        "coverage",
        "expected",
        "interrupted",
        "late",
    )

    q: Array
    complete: bool
    reason: str
    branches: tuple[str, ...]
    multiplicity: np.ndarray
    freedoms: np.ndarray
    inside: np.ndarray
    outside: int
    system: Model
    known: dict[str, Any]
    coverage: float | None = None
    expected: float | None = None
    interrupted: bool = False
    late: bool = False
    left_out: int = 0
    """How many close the mechanism, but violate declared one-sided constraints."""
    frame: str | None = None
    """Frame whose poses distinguish the modes; None: the coordinates do."""

    @property
    def success(self) -> bool:
        """Whether at least one assembly mode was found."""
        return len(self.q) > 0

    @property
    def code(self) -> Status:
        """Outcome: `NONE_EXISTS` or `OUTSIDE_LIMITS` only if a `complete` search found no mode."""
        if self.success:
            return Status.SOLVED
        if self.complete:
            return Status.OUTSIDE_LIMITS if self.outside else Status.NONE_EXISTS
        return self._find_early_end() or Status.NOT_FOUND

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the configurations in pictures: names of branches, or else numbers."""
        return tuple(name or str(k) for k, name in enumerate(self.branches, 1))

    def _list_outcomes(self) -> dict[str, np.ndarray]:
        return {"inside": self.inside, "freedoms": self.freedoms, "residual": self.residual}

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return list_known_tasks(self.system, self.known)

    def _make_tables(self) -> Sequence[Table]:
        """Return a table of the coordinates that are not known, a row for each configuration.

        With a `frame`, of its poses.
        """
        if self.frame is not None and len(self.q):
            return [self._make_pose_table(self.frame)]
        names = self.system.coordinate_names
        places = [i for i, name in enumerate(names) if name not in self.known]
        rows = [
            (self._label_configuration(k), *self._list_quantities(q, places))
            for k, q in enumerate(self.q[:ROWS])
        ]
        heads = ("", *(names[i] for i in places))
        return [Table(heads, rows, more=len(self.q) - len(rows))] if rows else []

    def _make_pose_table(self, frame: str) -> Table:
        """Make a table of the poses of a frame, a row for each configuration."""
        unit = self.system.unit
        heads = ["x", "y", "z", "roll", "pitch", "yaw"]
        columns = [0, 1, 5] if self.system.dim == 2 else range(6)
        poses = xyz_rpy_from_pose(fk(self.system, self.q[:ROWS], frame))
        rows = [
            (
                self._label_configuration(k),
                *(Quantity(float(pose[i]), unit if i < 3 else "rad") for i in columns),
            )
            for k, pose in enumerate(poses)
        ]
        names = ("", *(f"{heads[i]} of {frame!r}" if i == 0 else heads[i] for i in columns))
        return Table(names, rows, more=len(self.q) - len(rows))

    def _label_configuration(self, k: int) -> str:
        """Return the name of a configuration in a text."""
        return (self.branches[k] or str(k + 1)) + " (outside limits)" * (not self.inside[k])

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        signs = []
        if any(self.branches):
            signs = find_closed_form(self.system, tuple(self.known))._list_notes()
        return [*signs, *super()._list_notes()]

    def _make_headline(self) -> str:
        return f"{format_count(len(self), 'configuration')} of {self.system.name}; {self.status}"


def _make_late_answer(
    time: TimeLimit,
    system: Model,
    known: Mapping[str, Any] | None = None,
    start: Any = None,
    *,
    limits: bool = True,
    **_: Any,
) -> Modes:
    """Return the answer of a call whose time ended before the search began."""
    none = np.zeros(0, dtype=np.int64)
    said = f"none is known: {time.describe_end_reason(TimeUp())} came first"
    problem = Problem(system, "all", dict(known or {}), None, limits=bool(limits))
    return replace(
        _make_answer(problem, np.empty((0, system.nq)), said, [], none, none, False), late=True
    )


@explain_errors
@raise_interrupted
@limit_time(USUAL, _make_late_answer)
@answer_within_tolerance()
def assembly_modes(
    system: Model,
    known: Mapping[str, Any] | None = None,
    start: Any = None,
    *,
    limits: bool = True,
    frame: FrameLike | None = None,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Modes:
    """Find all configurations that close the mechanism; see `System.assembly_modes`."""
    given: Mapping[str, Any] = {} if known is None else known
    if not isinstance(given, Mapping):
        raise InputError(
            f"known is {format_value(given)}; it must be a dict of values by coordinate or frame "
            "name"
        )
    if TIME in given:
        system, given = fix_known_time(system, given)
    base = None if start is None else read_start(system, start)
    if base is not None and refuse_large_numbers(system, base, "start").ndim != 1:
        raise InputError(
            f"start has shape {base.shape}; it must be one configuration ({system.nq},)"
        )
    spend = USUAL.complete_budget(budget)
    make_generator(spend.rng)
    read_start_count(spend.starts)
    read_flag(limits, "limits")
    name = None if frame is None else system.structure.frame_name(frame)
    problem = Problem(
        system, "all", dict(given), base, limits=bool(limits), budget=budget, frame=name
    )
    return solve_problem(SOLVERS, problem)


# ---- solver: dyads in closed form


def explain_missing_dyads(problem: Problem) -> str | None:
    """Explain why there is no closed form with these names known; None where there is one."""
    system = problem.system
    known = tuple(problem.known)
    if system.dim != 2:
        return "it is for planar mechanisms"
    frames = [k for k in known if k in system.frame_names and k not in system.coordinate_names]
    if frames:
        return f"the place of frame {frames[0]!r} is known, not only coordinates"
    plan = find_closed_form(system, list_sources(system, known))
    if isinstance(plan, Incomplete):
        return plan.reason
    return f"it has 2^{plan.signs} branches, too many to list" if plan.signs > MOST_SIGNS else None


def find_modes_by_dyads(problem: Problem) -> Modes:
    """Find all modes of a mechanism made of dyads, in closed form."""
    system = problem.system
    values = find_source_values(system, problem.known)
    for name, x in values.items():
        if x.ndim:
            raise InputError(
                f"the known value of {name!r} has shape {x.shape}; it must be one number"
            )
        check_range(x, f"the known value of {name!r}")
    plan: Any = find_closed_form(system, tuple(values))
    signs = plan.branches()
    numbers = np.array([[float(x) for x in values.values()]] * len(signs)).reshape(
        len(signs), len(values)
    )
    closed = plan.close(numbers, signs, problem.start)
    names = ["".join("+" if s > 0 else "-" for s in row) for row in signs]
    ok = np.flatnonzero(closed.ok)
    clusters = Clusters(system, () if problem.frame is None else (problem.frame,))
    clusters.add_configurations(closed.q[ok], np.full(len(ok), SAME))
    groups = [ok[members] for members in clusters.members]
    q = closed.q[[g[0] for g in groups]]
    free = np.zeros(len(groups), dtype=np.int64)
    branches = [_merge_branch_names([names[i] for i in g]) for g in groups]
    sizes = np.array([len(g) for g in groups], dtype=np.int64)
    doubt = _examine_doubtful_branches(problem, plan, numbers[0], closed, clusters)
    if doubt.found:
        shown = [*range(len(groups)), *doubt.found]
        q = np.concatenate([q, clusters.q[list(doubt.found)]])
        free = doubt.free[shown]
        branches += [
            "".join("+" if s > 0 else "-" for s in row) for row in plan.branch_of(q[len(groups) :])
        ]
        sizes = np.concatenate([sizes, np.zeros(len(doubt.found), dtype=np.int64)])
    elif len(doubt.free):
        free = doubt.free[: len(groups)]
    all_ = format_count(len(signs), "branch")
    do = choose_verb(len(ok), "closes", "close")
    new = len(doubt.found)
    status = f"complete: every dyad in closed form, {len(ok)} of {all_} {do}"
    if not len(q):
        status = (
            f"complete: none of the {all_} closes; the best is open by {closed.gap.min():.3g} m"
        )
    if len(doubt.rows):
        them = (
            f"{format_count(len(doubt.rows), 'branch')} "
            f"{choose_verb(len(doubt.rows), 'is', 'are')} undetermined: {doubt.why}"
        )
        status = f"not proven complete: {len(ok)} of {all_} {do}, and {them}"
        if free.any():
            moving = f"{int((free > 0).sum())} of {format_count(len(q), 'configuration')}"
            status = f"infinitely many: {moving} can move with these known values; {them}"
        elif not len(q):
            status = f"none found, without proof: {them}"
    if new:
        status += f"; {format_count(new, 'configuration')} found by least squares"
    if any(len(g) > 1 for g in groups):
        status += f", {format_count(sum(len(g) > 1 for g in groups), 'multiple root')}"
    return _make_answer(problem, q, status, branches, sizes, free, not len(doubt.rows))


class _Doubt(NamedTuple):
    """Branches `rows` that disc arithmetic leaves undetermined, and `why`.

    `found` are the clusters that least squares found there, and `free` the freedoms of all clusters
    (empty where nothing was searched).
    """

    rows: np.ndarray
    why: str = ""
    found: tuple[int, ...] = ()
    free: np.ndarray = np.zeros(0, dtype=np.int64)


def _examine_doubtful_branches(
    problem: Problem, plan: Plan, values: Array, closed: DyadAnswer, clusters: Clusters
) -> _Doubt:
    """Examine the branches that are not proven to close once or never.

    Further configurations go into the clusters.

    A branch that did not close as it was computed may do so elsewhere in its discs: least squares
    start where it nearly closed and, where a branch is undetermined, at random.
    """
    system = problem.system
    size = plan.tolerance / CLOSED
    proof = enclose_branches(plan, values, bool(problem.limits), size)
    layout = system.structure.layout
    turning = np.zeros(system.nq, dtype=bool)
    turning[layout.vector_q] = system.structure.coordinates.turning[layout.vector_v]
    within = SAME * np.where(turning, 1.0, size)
    ok = np.asarray(closed.ok)[proof.branch]
    wide = proof.find_undetermined(within, ok)
    if not len(ok) or (ok & ~wide).all():
        return _Doubt(np.zeros(0, dtype=np.int64))

    tree = remove_cut_marks(system)
    before = len(clusters.members)
    spend = USUAL.complete_budget(problem.budget)
    bound = get_equation_assembler(tree, problem.known)
    s = ModesSearch(
        tree,
        dict(problem.known),
        problem.start,
        make_generator(spend.rng),
        bound,
        clusters,
        problem.frame,
        limits=bool(problem.limits),
    )
    s.close_configurations(closed.q[proof.branch[~ok]], False)
    left = [
        k
        for k in np.flatnonzero(wide | ~ok).tolist()
        if wide[k] or not proof.find_contained(k, clusters.q, turning, within).any()
    ]
    continuum = bool(left) and proof.has_free_part(left)
    if continuum:
        s.close_configurations(sample_starts(s, min(BESIDE, read_start_count(spend.starts))), False)
    else:  # near roots that merge, least squares stop at what only seems to move
        s.free = np.zeros(len(clusters.q), dtype=np.int64)
    new = np.arange(before, len(s.free))
    found = new[s.free[new] == 0].tolist()
    moving = new[s.free[new] > 0]
    if len(moving) and not s.free[:before].any():
        found.append(int(moving[_choose_example(problem, clusters, moving)]))
    return _Doubt(proof.branch[left], proof.explain_undetermined(left), tuple(found), s.free)


def _merge_branch_names(names: list[str]) -> str:
    """Merge the names of branches that meet: their common signs, 0 for the others."""
    return "".join(c[0] if len(set(c)) == 1 else "0" for c in zip(*names, strict=True))


# ---- solver: many starts


def find_modes_by_starts(problem: Problem) -> Modes:
    """Find modes from many random starts.

    The answer is proven complete only where lengths leave a loop open: then there are none.
    """
    system = problem.system
    if (proof := _find_proof_by_lengths(problem)) is not None:
        none = np.zeros(0, dtype=np.int64)
        return _make_answer(
            problem, np.zeros((0, system.nq)), f"complete: {proof}", [], none, none, True
        )
    spend = USUAL.complete_budget(problem.budget)
    found = search_modes(
        system,
        dict(problem.known),
        problem.start,
        problem.frame,
        make_generator(spend.rng),
        read_start_count(spend.starts),
        find_time_limit(USUAL, problem.budget),
        spend.progress,
        bool(problem.limits),
    )
    q = found.clusters.q
    hits = found.clusters.hits
    free = found.free
    isolated = np.flatnonzero(free == 0)
    families = np.flatnonzero(free > 0)
    coverage, expected = estimate_coverage(found.hits)
    expected *= len(isolated) / max(len(found.hits), 1)  # mirror images are counted together
    expected += found.odd
    closed = int(hits.sum())
    status = (
        f"not proven complete: {len(isolated)} found from {format_count(found.tried, 'start')}, of "
        f"which {closed} closed; with 95 % confidence at most {_format_rounded_up(100.0 * (1.0 - coverage))} % of "
        "the starts that close lead to others"
    )
    if expected > len(isolated) + 0.5:
        status += f", about {expected:.3g} in all by estimate"
    if found.bounded:
        status += "; starts were drawn inside the limits only"
    if found.odd:
        status += "; one is missing at least, since their number is even"
    if not closed:
        why = assemble(system, problem.known, start=problem.start).status
        why = re.sub(r"^not closed after \d+ starts?: ", "", why)
        status = f"none found from {format_count(found.tried, 'start')}, without proof: {why}"
    if len(families):
        besides = (
            f"besides {format_count(len(isolated), 'isolated configuration')}, "
            if len(isolated)
            else ""
        )
        left = (
            "1 degree of freedom" if free.max() == 1 else f"up to {free.max()} degrees of freedom"
        )
        status = (
            f"infinitely many: {besides}there are sets of them with {left}, of which one "
            "configuration is shown; give more known coordinates"
        )
        families = families[[_choose_example(problem, found.clusters, families)]]
    if found.spins:
        status += f"; {format_count(len(found.spins), 'idle spin')} left out: " + ", ".join(
            map(str, found.spins[:3])
        )
        status += ", ..." if len(found.spins) > 3 else ""
    keep = np.concatenate([isolated, families])
    guess = (coverage, float(expected))
    interrupted, late = (isinstance(found.broken, kind) for kind in BROKEN_OFF)
    status += describe_early_end(interrupted, late)
    answer = _make_answer(
        problem, q[keep], status, [""] * len(keep), hits[keep], free[keep], False, guess
    )
    return replace(answer, interrupted=interrupted, late=late)


def _find_proof_by_lengths(problem: Problem) -> Evidence | None:
    """Find the proof by lengths that a loop is open with the known values; None where there is none."""
    system = problem.system
    known = {name: x for name, x in problem.known.items() if name in system.coordinate_names}
    values = find_source_values(system, known)
    fixed = {name: float(x) for name, x in values.items() if not x.ndim}
    return make_loop_length_evidence(system, fixed, bool(problem.limits))


def _choose_example(problem: Problem, clusters: Clusters, which: np.ndarray) -> int:
    """Choose the cluster shown as an example, inside the limits if possible, and near home.

    Returns its index in `which`.
    """
    q = clusters.q[which]
    near = find_home(problem.system) if problem.start is None else problem.start
    away = clusters.metric.compute_distances(q, near)
    return int(np.argmin(np.where(_find_inside_limits(problem.system, q), away, away + 1e9)))


def _format_rounded_up(percent: float) -> str:
    """Format a percentage with two digits, rounded up."""
    if percent <= 0.0:
        return "0"
    unit = 10.0 ** (np.floor(np.log10(percent)) - 1)
    return f"{np.ceil(percent / unit - 1e-9) * unit:.3g}"


# ---- steps of both solvers


def _find_inside_limits(system: Model, q: Array) -> np.ndarray:
    """Return a mask (n,) of the configurations (n, nq) inside the limits."""
    v = q[:, system.structure.layout.vector_q]
    low, high = (x[system.structure.layout.vector_v] for x in (system.lower, system.upper))
    return np.all((v >= low - INSIDE) & (v <= high + INSIDE), axis=-1)


def _make_answer(
    problem: Problem,
    q: Array,
    status: str,
    branches: list[str],
    multiplicity: np.ndarray,
    freedoms: np.ndarray,
    complete: bool,
    guess: tuple[float | None, float | None] = (None, None),
) -> Modes:
    """Make the answer: modes sorted, those outside the limits dropped or marked."""
    system = problem.system
    inside = _find_inside_limits(system, q)
    bounds = pack_one_sided_rows(system)
    left_out = 0
    keep = np.flatnonzero(inside) if problem.limits else np.arange(len(q))
    if bounds.declared:
        beyond = bounds.compute_excess(q, declared=True) > 0.0
        holds = np.logical_not(beyond.any(axis=1))
        inside = inside & holds
        left_out = int(np.sum(~holds))
        keep = keep[holds[keep]]
        status += bounds.describe_omitted_configurations(beyond)
    if problem.start is not None:
        keep = keep[
            np.argsort(get_metric(system).compute_distances(q[keep], problem.start), kind="stable")
        ]
    outside = len(q) - int(inside.sum()) - left_out
    if outside:
        status += f"; {outside} {'are' if outside > 1 else 'is'} outside the limits"
    return Modes(
        q[keep],
        complete,
        status,
        tuple(branches[i] for i in keep),
        multiplicity[keep],
        freedoms[keep],
        inside[keep],
        outside if problem.limits else 0,
        system,
        dict(problem.known),
        *guess,
        left_out=left_out,
        frame=problem.frame,
    )


SOLVERS = (
    Solver(
        "dyads", "closed form, one dyad after the other", explain_missing_dyads, find_modes_by_dyads
    ),
    Solver(
        "many starts",
        "assembly from random starts, from mirror images and mixtures of what is found",
        accept_all_problems,
        find_modes_by_starts,
    ),
)
"""Who answers for all assembly modes."""
