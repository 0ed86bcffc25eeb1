"""How far bodies are from one another, by their collision shapes (coal)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import unwrap_scalar
from kempe.constraints.clearances import Apart
from kempe.errors import InputError, UnknownNameError
from kempe.forward.fk import find_query, fk, jacobian
from kempe.geometry.smallest_distance import SmallestDistance
from kempe.geometry.solids import Gap, Placed, Solids, get_solids
from kempe.model.configurations import read_q
from kempe.model.model import keep_answers, store_answer
from kempe.report import Report, Table
from kempe.spatial import Array
from kempe.words import Quantity

if TYPE_CHECKING:
    from kempe.model.model import Model

KEPT = 64
"""Sets of clearances whose pairs a system keeps."""
NEAREST = 10
"""Pairs that a text lists."""

Pairs = Iterable[tuple[str, str]]


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class NearestBodies(Report):
    """Distances between bodies at one configuration, the smallest first.

    Attributes
    ----------
    system
        The system.
    q
        The configuration (nq,).
    pairs
        Names of two bodies, for each of n pairs.
    distance
        Distances (n,) in metres; a negative one is the depth by which two bodies overlap.
    points
        Nearest points (n, 2, 3) on the first and the second body, in the ground frame.
    gradient
        Derivatives (n, nv) of the distances by the velocities. They are exact where the nearest
        points are the only ones.
    """

    _entries = ("system", "q", "pairs", "distance", "points")

    system: Model
    q: Array
    pairs: tuple[tuple[str, str], ...]
    distance: Array
    points: Array
    gradient: Array

    @property
    def status(self) -> str:
        """The smallest distance, and between which bodies it is."""
        if not self.pairs:
            return "no two bodies can touch"
        a, b = self.pairs[0]
        d = float(self.distance[0])
        if d > 0.0:
            return f"nearest bodies: {a!r} and {b!r}, {d:.4g} m apart"
        return f"{a!r} and {b!r} overlap by {abs(d):.4g} m"

    def _make_tables(self) -> list[Table]:
        rows = [
            (a, b, Quantity(float(d), "m"))
            for (a, b), d in zip(self.pairs[:NEAREST], self.distance[:NEAREST], strict=True)
        ]
        return [Table(("body", "body", "distance"), rows)] if rows else []


@explain_errors
def compute_clearance(system: Model, q: Any, pairs: Pairs | None = None) -> Any:
    """Compute the smallest distance (...) between bodies; see `BodyGeometry.clearance`."""
    q = read_q(system, q)
    wanted = pairs if pairs is None else _read_pairs(system, get_solids(system), pairs)
    flat = q.reshape(math.prod(q.shape[:-1]), system.nq)
    out = _prepare_distance(system, wanted).compute_distances(flat)
    return unwrap_scalar(out.reshape(q.shape[:-1]))


@keep_answers
def _prepare_distance(system: Model, pairs: tuple[tuple[str, str], ...] | None) -> SmallestDistance:
    """Prepare the smallest distance of these pairs, or of all that may touch."""
    solids = get_solids(system)
    wanted = solids.pairs if pairs is None else pairs
    couples = [couple for pair in wanted for couple in solids.list_couples(pair)]
    return SmallestDistance(system, solids, np.array(couples, dtype=np.int64).reshape(-1, 2))


@explain_errors
def find_nearest_bodies(system: Model, q: Any, pairs: Pairs | None = None) -> NearestBodies:
    """Find the distance of each pair of bodies at q; see `BodyGeometry.nearest`."""
    q = read_q(system, q)
    if q.ndim != 1:
        raise InputError(f"q has shape {q.shape}; needed is one configuration ({system.nq},)")
    if not np.isfinite(q).all():
        raise InputError("q is not finite")
    solids = get_solids(system)
    wanted = _read_pairs(system, solids, pairs)
    X = fk(system, q, solids.names)
    placed = Placed(solids, X)
    found = [placed.measure_pair(pair) for pair in wanted]
    order = sorted(range(len(found)), key=lambda k: found[k][0])
    points = np.array([found[k][1] for k in order]).reshape(-1, 2, 3)
    distance = np.array([found[k][0] for k in order])
    pairs_ = tuple(wanted[k] for k in order)
    J = {name: jacobian(system, q, name) for name in {n for pair in pairs_ for n in pair}}
    at = dict(zip(solids.names, X, strict=True))
    gradient = np.zeros((len(pairs_), system.nv))
    for row, (a, b), (p, r), d in zip(gradient, pairs_, points, distance, strict=True):
        apart = (r - p) / d if d != 0.0 else np.zeros(3)
        for sign, name, x in ((-1.0, a, p), (1.0, b, r)):
            row += sign * _compute_point_rates(J[name], x - at[name][:3, 3], apart)
    return NearestBodies(system, q, pairs_, distance, points, gradient)


def compute_gap_gradients(system: Model, watch: Watch, q: Array, gaps: Sequence[Gap]) -> Array:
    """Compute the derivatives (n, nv) of distances at q (nq,) by the velocities."""
    pairs = watch.solids.body_of[watch.couples[[gap.couple for gap in gaps]]]
    bodies, of = np.unique(pairs, return_inverse=True)
    names = [watch.solids.names[int(k)] for k in bodies]
    X, J = (
        np.array(x)
        for x in zip(*(find_query(system, n).pose_and_jacobian(q) for n in names), strict=True)
    )
    of = of.reshape(pairs.shape)
    arms = np.array([gap.points for gap in gaps]) - X[of, :3, 3]
    normals = np.array([gap.normal for gap in gaps])
    rates = _compute_point_rates(J[of], arms, normals[:, None])
    return rates[:, 1] - rates[:, 0]


def _compute_point_rates(J: Array, arms: Array, directions: Array) -> Array:
    """Compute how fast (..., nv) points `arms` (..., 3) away from the origins of frames, which have
    Jacobians (..., 6, nv), move in directions (..., 3).
    """
    ax, ay, az = np.moveaxis(arms, -1, 0)
    dx, dy, dz = np.moveaxis(directions, -1, 0)
    turning = np.stack([ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx], axis=-1)
    slid = (directions[..., None, :] @ J[..., :3, :])[..., 0, :]
    return slid + (turning[..., None, :] @ J[..., 3:, :])[..., 0, :]


class Watch(NamedTuple):
    """Pairs of solids that clearances keep apart."""

    solids: Solids
    couples: np.ndarray
    """Pairs (k, 2) of solids."""
    at_least: Array
    """Distance (k,) that each pair keeps."""
    of: np.ndarray
    """For each pair, the number (k,) of its clearance."""

    def name_bodies(self, couple: int) -> tuple[str, str]:
        """Return the names of the bodies of a pair of solids."""
        a, b = self.solids.body_of[self.couples[couple]]
        return self.solids.names[int(a)], self.solids.names[int(b)]

    def list_gaps(self, X: Array, band: float) -> list[Gap]:
        """List the pairs that are less than `band` further apart than they must be.

        X (n, 4, 4) are the poses of the bodies that have solids.
        """
        return Placed(self.solids, X).list_gaps(self.couples, self.at_least + band)

    def find_worst(self, gaps: Sequence[Gap]) -> tuple[str, str, float, float] | None:
        """Find the pair that falls shortest: its names, its distance, and what is asked.

        None without gaps.
        """
        if not gaps:
            return None
        worst = min(gaps, key=lambda g: g.distance - self.at_least[g.couple])
        asked = float(self.at_least[worst.couple])
        return (*self.name_bodies(worst.couple), worst.distance, asked)


def watch_clearances(system: Model, clearances: Sequence[Apart]) -> Watch:
    """Find the pairs of solids that clearances keep apart.

    Errors: `UnknownNameError`, `InputError` where a body has no shape, or no pair is left.
    """
    kept = system._kept.setdefault(watch_clearances, {})
    key = tuple((c.sides, c.at_least) for c in clearances)
    found = kept.get(key)
    return (
        store_answer(kept, key, _make_watch(system, clearances), KEPT) if found is None else found
    )


def _make_watch(system: Model, clearances: Sequence[Apart]) -> Watch:
    """Find the pairs of solids that clearances keep apart."""
    solids = get_solids(system)
    rows: list[tuple[tuple[int, int], float, int]] = []
    for k, clearance in enumerate(clearances):
        pairs = _list_clearance_pairs(system, solids, clearance)
        if not pairs:
            raise InputError(
                f"{clearance.label}: no two of these bodies can touch; system.geometry.pairs lists "
                "those that can"
            )
        couples = [couple for pair in pairs for couple in solids.list_couples(pair)]
        rows += [(couple, clearance.at_least, k) for couple in couples]
    couples, at_least, of = zip(*rows, strict=True)
    return Watch(solids, np.array(couples), np.array(at_least), np.array(of))


def _list_clearance_pairs(
    system: Model, solids: Solids, clearance: Apart
) -> tuple[tuple[str, str], ...]:
    """List the pairs of bodies that a clearance keeps apart."""
    first, second = clearance.sides
    for name in (*first, *second):
        if name not in system._mechanism.bodies:
            raise UnknownNameError("body", name, system._mechanism.bodies, system.name)
        if name not in solids.names:
            raise InputError(f"body {name!r} has no collision shape")
    if len(first) == len(second) == 1:
        return _read_pairs(system, solids, [(first[0], second[0])])
    return tuple(
        (a, b)
        for a, b in solids.pairs
        if (_is_of(a, first) and _is_of(b, second)) or (_is_of(b, first) and _is_of(a, second))
    )


def _is_of(name: str, side: tuple[str, ...]) -> bool:
    """Whether a body belongs to a side; all bodies belong to an open one."""
    return not side or name in side


def _read_pairs(system: Model, solids: Solids, pairs: Pairs | None) -> tuple[tuple[str, str], ...]:
    """Return the pairs that are looked at. Errors: `UnknownNameError`, `InputError`."""
    if pairs is None:
        return solids.pairs
    out: list[tuple[str, str]] = []
    for pair in pairs:
        if isinstance(pair, str) or len(pair) != 2 or pair[0] == pair[1]:
            raise InputError(f"{pair!r} is no pair: two names of different bodies are needed")
        for name in pair:
            if name not in system._mechanism.bodies:
                raise UnknownNameError("body", name, system._mechanism.bodies, system.name)
            if name not in solids.names:
                raise InputError(f"body {name!r} has no collision shape")
        out.append((pair[0], pair[1]))
    return tuple(out)
