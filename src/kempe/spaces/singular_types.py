"""Types of singular configurations: the matrix that loses rank, of a chain or of closed loops.

The sets that singular configurations form, and the nearest of them, are described here, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.targets import list_twist_rows
from kempe.arguments import explain_method_errors
from kempe.assemble.assemble import assemble
from kempe.constraints.flat_tasks import DIRECTION, PLANES
from kempe.equations import closure_rows
from kempe.equations.closure import Closure, close_loops
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError
from kempe.forward.fk import fk, jacobian
from kempe.model.configurations import name_values, sample_configurations
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Report, summarize_fields
from kempe.spaces.rank_loss import Matrices, RankLoss, compute_generic_rank
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, format_count, join_words

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- sets of singular configurations

SAME = 1e-5
"""Difference of coordinates, in radians and metres, up to which they are the same."""


@dataclass(frozen=True, eq=False)
class SingularSet(InWords):
    """Configurations that are singular in the same way.

    Attributes
    ----------
    kinds
        "serial" for a chain; for closed loops some of "type 1", "type 2" and "constraint".
    name
        "shoulder", "elbow" or "wrist" for arms with such singularities, else "".
    coordinates, values
        Coordinates that decide membership, and their values (k, n) if these are isolated.
    dimension
        Dimension of the set.
    q
        Configurations (m, nq) that were found.
    """

    __repr__ = summarize_fields

    kinds: tuple[str, ...]
    name: str
    coordinates: tuple[str, ...]
    values: Array
    dimension: int
    q: Array
    local: tuple[LostAndGained, ...] = field(repr=False)
    """What is lost and gained at each of `q`."""
    places: tuple[int, ...] = field(default=(), repr=False)
    """Where the `coordinates` are in q."""

    @property
    def lost(self) -> tuple[Array, ...]:
        """Twists (k, 6), [linear; angular] along the axes of the ground, that the frame has lost."""
        return tuple(x.lost for x in self.local)

    @property
    def gained(self) -> tuple[Array, ...]:
        """Twists (k, 6) of the frame that are possible while all inputs are held."""
        return tuple(x.gained for x in self.local)

    @property
    def self_motion(self) -> tuple[Array, ...]:
        """Velocities (k, nv) that do not move the frame."""
        return tuple(x.self_motion for x in self.local)

    def __str__(self) -> str:
        head = self.name or " and ".join(self.kinds)
        if not len(self.values):
            single = (
                f": {format_count(len(self.q), 'configuration')}" if self.dimension == 0 else ""
            )
            return f"{head} ({join_words(self.coordinates)})" if self.coordinates else head + single
        if len(self.coordinates) == 1:
            return (
                f"{head} ({self.coordinates[0]} = "
                f"{' or '.join(f'{x:.4g}' for x in self.values[:, 0])})"
            )
        points = [f"({', '.join(f'{x:.4g}' for x in row)})" for row in self.values[:4]]
        more = f" and {len(self.values) - 4} more" if len(self.values) > 4 else ""
        return f"{head} ({', '.join(self.coordinates)} = {' or '.join(points)}{more})"

    def to_data(self) -> dict[str, Any]:
        """Convert the set to numbers and names, for JSON."""
        names = (
            "kinds",
            "name",
            "coordinates",
            "values",
            "dimension",
            "q",
            "lost",
            "gained",
            "self_motion",
        )
        values: dict[str, Any] = {n: getattr(self, n) for n in names}
        several = [n for n in names[-3:] if isinstance(values[n], tuple)]
        return values | {n: [np.asarray(x) for x in values[n]] for n in several}


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class NearestSingular(Report):
    """Singular configuration `q` (nq,), nearest of those found, and its `distance`.

    Angles count in radians and lengths in characteristic lengths. `kinds`, `name`, and what is lost
    and gained there, are as in `SingularSet`; `distances` are those of all sets, by their words.
    """

    _entries = ("distance", "kinds", "name", "lost", "gained", "self_motion", "distances")
    _has_angles = True

    system: Model
    q: Array
    distance: float
    kinds: tuple[str, ...]
    name: str
    lost: Array
    gained: Array
    self_motion: Array
    distances: dict[str, float]
    code: Any = Status.SOLVED

    @property
    def status(self) -> str:
        """The nearest singular configuration and its distance, as a sentence."""
        if self.code is not Status.SOLVED:
            return "no singular configuration was found"
        what = self.name or " and ".join(self.kinds)
        if self.distance < SAME:
            return f"singular ({what}): {describe_changes(self.lost, self.gained)}"
        return f"the nearest singular configuration found ({what}) is {self.distance:.4g} away"

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return [
            f"{name}: {x:.4g} away"
            for name, x in sorted(self.distances.items(), key=lambda row: row[1])
        ]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"q": name_values(self.system, self.q)}


def describe_changes(lost: Array, gained: Array) -> str:
    """Describe how many directions of motion are lost and gained."""
    said = [f"{format_count(len(lost), 'direction')} lost"] if len(lost) else []
    said += [f"{format_count(len(gained), 'direction')} gained"] if len(gained) else []
    return " and ".join(said) or "no direction of a frame lost or gained"


def are_inside_limits(system: Model, q: Array) -> np.ndarray:
    """Whether configurations (k, nq) are inside the limits and fulfil the one-sided constraints."""
    return np.asarray((pack_one_sided_rows(system).compute_excess(q) <= SAME).all(axis=1))


# ---- matrices that lose rank

# Of a chain it is the Jacobian of the frame. Of closed loops C(q) = 0 with inputs a: the frame
# loses directions where [dC; J] does (type 1), the inputs no longer hold the mechanism where [dC;
# da] does (type 2), and it has more first-order freedoms than elsewhere where dC alone does
# (constraint singularity). Sources: Gosselin, Angeles, "Singularity analysis of closed-loop
# kinematic chains", IEEE Trans. Robotics and Automation 6 (1990); Zlatanov, Bonev, Gosselin,
# "Constraint singularities of parallel mechanisms", ICRA 2002.

OF_FRAMES = ("pose", "position", "orientation", *PLANES, DIRECTION)
"""Tasks of frames: "xy" is the position along x and y, "direction" that of the frame's z axis."""
RANKED = 1000
"""Starts of which generic ranks are read, and between which sets are looked for, at most."""
GENERIC = 256
"""Random configurations of which some have the rank of almost all."""
PARTS = 8
HALVED = 8
NEARLY = 24
"""Steps of a way between two starts, how often one is halved, and places on all ways from which
sets are looked for."""
SERIAL = "serial"
TYPE_1 = "type 1"
TYPE_2 = "type 2"
CONSTRAINT = "constraint"


@dataclass(frozen=True, eq=False)
class LostAndGained:
    """Lost and gained twists at one configuration, [linear; angular] in metres and radians.

    `kinds` are those of which it is singular; empty where it is regular.
    """

    kinds: tuple[str, ...]
    rank: int
    lost: Array
    gained: Array
    self_motion: Array


class RankAnalysis:
    """Matrices whose rank loss defines the singularities of a frame.

    Without a frame these are the matrices of the inputs only.
    """

    def __init__(
        self,
        system: Model,
        frame: str | None,
        task: str,
        inputs: list[int] | None,
        rng: np.random.Generator,
        starts: int,
        limits: bool = False,
    ):
        self.system = system
        self.frame = frame
        self.inputs = inputs
        self.length = float(closure_rows.compute_characteristic_length(system))
        equations = Closure(system)
        self.unit = equations.unit
        self.loops = bool(len(equations.weight))
        self.starts = sample_configurations(system, rng, starts)
        if self.loops:
            found = [close_loops(equations, q) for q in self.starts]
            self.starts = np.array([q for q in found if q is not None]).reshape(-1, system.nq)
            if limits:
                self.starts = _assemble_inside_limits(system, self.starts)
        if not len(self.starts):
            raise InputError(
                f"{system.name}: no configuration with closed loops was found in "
                f"{format_count(starts, 'start')}"
            )
        self.of_axis = task == DIRECTION
        words = "orientation" if self.of_axis else "position" if task in PLANES else task
        kept = PLANES[task][:2] if task in PLANES else range(6)
        self.rows = [r for r in list_twist_rows(words, system.dim) if r in kept]
        self.twists = np.eye(len(self.rows))
        few = self.starts[:RANKED]
        moving = np.zeros(system.nv, dtype=bool)
        if frame is not None:
            seen = self.compute_task_jacobians(few).swapaxes(1, 2).reshape(-1, len(self.rows))
            self.twists = Spectrum(seen).compute_row_space(Level.GENERIC)
            if not self.twists.size:
                raise InputError(
                    f"frame {frame!r} of {system.name} does not move: nothing of it can be lost"
                )
            moving = np.abs(self.compute_task_jacobians(few)).max(axis=(0, 1)) > 0.0
        self.frame_rank = (
            0 if frame is None else max(self._compute_frame_rank(q) for q in self.starts[:GENERIC])
        )
        self.columns = np.arange(system.nv) if self.loops else np.flatnonzero(moving)

    def find_near_singularities(self, problems: dict[str, RankLoss]) -> dict[str, Array]:
        """Find nearly singular configurations (k, nq) for each problem. They are closed, inside
        the limits, and between the starts.

        On ways from each start to the next determinants change their sign, which halving steps
        locates; of matrices that have none, as they are not square, the least singular values are
        taken. Sets that are met from afar seldom, where limits are narrow, are so from there.
        """
        own = self.starts[are_inside_limits(self.system, self.starts)][:RANKED]
        t = np.arange(PARTS + 1) / PARTS
        if not len(own):
            return dict.fromkeys(problems, own)
        q, ok = self._close_intermediate(
            np.repeat(own, len(t), axis=0),
            np.repeat(np.roll(own, 1, axis=0), len(t), axis=0),
            np.tile(t, len(own)),
        )
        out = dict[str, Array]()
        for kind, problem in problems.items():
            if problem.has_determinant:
                sign = np.where(ok, problem.compute_determinant_sign(q), 0.0).reshape(len(own), -1)
                k = np.flatnonzero(np.pad(sign[:, 1:] * sign[:, :-1] < 0.0, ((0, 0), (0, 1))))
                out[kind] = self._locate_sign_changes(problem, q[k], q[k + 1])[:NEARLY]
            else:
                out[kind] = q[ok][np.argsort(problem.compute_least_values(q[ok]))[:NEARLY]]
        return out

    def _close_intermediate(self, a: Array, b: Array, t: Array) -> tuple[Array, np.ndarray]:
        """Close configurations (k, nq) at fractions t (k,) of straight ways. A mask (k,) tells
        whether they close.
        """
        layout = self.system.structure.layout
        found = assemble(
            self.system,
            None,
            layout.integrate_velocity(a, t[:, None] * layout.compute_difference(a, b)),
        )
        ok = np.asarray(found.success, dtype=bool)
        q = np.where(ok[:, None], found.q, self.system.neutral)
        return q, ok & are_inside_limits(self.system, q)

    def _locate_sign_changes(self, problem: RankLoss, a: Array, b: Array) -> Array:
        """Locate sign changes of the determinant between configurations a and b (k, nq)."""
        for _ in range(HALVED if len(a) else 0):
            middle, ok = self._close_intermediate(a, b, np.full(len(a), 0.5))
            a = a[ok]
            b = b[ok]
            middle = middle[ok]
            first = (
                problem.compute_determinant_sign(a) * problem.compute_determinant_sign(middle) < 0.0
            )[:, None]
            a = np.where(first, a, middle)
            b = np.where(first, middle, b)
        return a

    def compute_task_jacobians(self, q: Array) -> Array:
        """Compute the dimensionless task Jacobians (k, m, nv) of the frame. Their rows are a basis
        of its possible twists.
        """
        assert self.frame is not None
        J = jacobian(self.system, q, self.frame)[:, self.rows] * self.unit
        if self.of_axis:  # a turn about the axis does not count
            z = self._compute_axes(q)
            J = J - z[..., :, None] * (z[..., None, :] @ J)
        J[:, [i for i, r in enumerate(self.rows) if r < 3]] /= self.length
        return self.twists.T @ J

    def _compute_axes(self, q: Array) -> Array:
        """Compute the z axis (..., 3) of the frame at q (..., nq)."""
        assert self.frame is not None
        return fk(self.system, q, self.frame)[..., :3, 2]

    def _compute_frame_rank(self, q: Array) -> int:
        """Count the independent twists of the frame at a closed configuration (nq,)."""
        J = self.compute_task_jacobians(q[None])[0]
        N = (
            Spectrum(self.compute_closure_jacobians(q[None])[0]).compute_null_space(Level.GENERIC)
            if self.loops
            else np.eye(self.system.nv)
        )
        return _compute_rank(J @ N, J)

    def compute_closure_jacobians(self, q: Array) -> Array:
        """Compute the dimensionless derivatives (k, c, nv) of the loop equations."""
        return closure_rows.evaluate_constraints(self.system, q, True, scaled=True)[1]

    def _compute_chain_matrices(self, q: Array) -> Array:
        """Compute the task Jacobians of a chain, of the columns that move the frame."""
        return self.compute_task_jacobians(q)[:, :, self.columns]

    def _compute_loop_matrices(self, q: Array) -> Array:
        """Compute the derivatives of loops and task, one above the other."""
        return np.concatenate(
            [self.compute_closure_jacobians(q), self.compute_task_jacobians(q)], axis=1
        )

    def _compute_input_matrices(self, q: Array) -> Array:
        """Compute the derivatives of loops and held inputs, one above the other."""
        held = np.eye(self.system.nv)[self.inputs]
        return np.concatenate(
            [self.compute_closure_jacobians(q), np.broadcast_to(held, (len(q), *held.shape))],
            axis=1,
        )

    def list_problems(self) -> dict[str, RankLoss]:
        """Return the equations of each kind of singularity, by kind."""
        found: dict[str, Matrices] = {}
        if not self.loops:
            found[SERIAL] = self._compute_chain_matrices
        else:
            if self.frame is not None:
                found[TYPE_1] = self._compute_loop_matrices
            if self.inputs is not None:
                found[TYPE_2] = self._compute_input_matrices
            found[CONSTRAINT] = self.compute_closure_jacobians
        return {
            kind: RankLoss(
                self.system,
                f,
                compute_generic_rank(f(self.starts[:RANKED])),
                self.columns,
                self.unit,
            )
            for kind, f in found.items()
        }

    def convert_twists(self, twists: Array) -> Array:
        """Convert dimensionless twists, columns (m, k), to (k, 6) in metres and radians. They are
        scaled to rotation 1, or translation 1 without rotation.
        """
        full = np.zeros((twists.shape[1], 6))
        full[:, self.rows] = (self.twists @ twists).T
        full[:, :3] *= self.length
        turn: Array
        slide: Array
        turn = np.linalg.norm(full[:, 3:], axis=1)
        slide = np.linalg.norm(full[:, :3], axis=1)
        size = np.where(turn > Level.GENERIC, turn, np.maximum(slide, 1e-300))
        return full / size[:, None] + 0.0

    def describe_local_twists(self, q: Array, problems: dict[str, RankLoss]) -> LostAndGained:
        """Describe the lost and gained twists at a closed configuration (nq,)."""
        kinds = [kind for kind, p in problems.items() if p.is_singular(q[None])[0]]
        N = np.eye(self.system.nv)
        if self.loops:
            N = Spectrum(self.compute_closure_jacobians(q[None])[0]).compute_null_space(
                Level.GENERIC
            )
        none = np.zeros((0, 6))
        lost = none
        gained = none
        still = np.zeros((0, self.system.nv))
        rank = N.shape[1]
        J = N[:0]
        if self.frame is not None:
            J = self.compute_task_jacobians(q[None])[0]
            B = (
                Spectrum((self.twists.T @ self._compute_axes(q))[None]).compute_null_space(
                    Level.GENERIC
                )
                if self.of_axis
                else np.eye(len(J))
            )
            moved = Spectrum(B.T @ J @ N)
            rank = _compute_rank(J @ N, J)
            lost = self.convert_twists(B @ moved.left[:, rank:]) if rank < self.frame_rank else none
            still = (N @ moved.right[rank:].T).T * self.unit
            still = still[np.abs(still[:, self.columns]).max(axis=1, initial=0.0) > Level.GENERIC]
        if self.loops and self.inputs is not None:
            free = Spectrum(self._compute_input_matrices(q[None])[0]).compute_null_space(
                Level.GENERIC
            )
            if self.frame is not None:
                gained = self.convert_twists(
                    Spectrum(J @ free, 1.0).compute_column_space(Level.GENERIC)
                )
        if CONSTRAINT in kinds:
            kinds = [CONSTRAINT, *(k for k in kinds if k != CONSTRAINT)]
        return LostAndGained(tuple(kinds), rank, lost, gained, still)


def _assemble_inside_limits(system: Model, q: Array) -> Array:
    """Replace closed configurations (k, nq) outside the limits by ones inside. This is done where
    `assemble` finds some.

    From far outside Newton's method rarely comes to the part of a singular set that is inside.
    """
    q, out = q.copy(), np.flatnonzero(~are_inside_limits(system, q))[:RANKED]
    if len(out):
        found = assemble(system, None, q[out])
        ok = np.asarray(found.success, dtype=bool)
        q[out[ok]] = found.q[ok]
    return q


def _compute_rank(A: Array, whole: Array) -> int:
    """Compute the rank of a part A of the `whole` matrix."""
    return Spectrum(A, float(Spectrum(whole).largest)).compute_rank(Level.GENERIC)
