"""Idle freedoms: bodies between two joints that can spin while everything else rests, such as a rod between two balls.

Two joints of a loop are *in series* if cutting both parts the bodies. If both can turn about one and the same axis,
what is between them can spin alone. That is idle, since it transmits nothing, unless it is what the joints are for:
two hinges that only happen to be in line, or both between the same two bodies (a shaft in its bearings), or driven.
Two hinges on one axis of one body, such as a roller or a bush, are in line by construction, and that body is idle.
Slides are not looked at: a block that slides alone is as a rule a slider that is meant to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.graph import Cluster, Edge, Structure, structure
from kempe.analysis.rank import Rank
from kempe.analysis.screws import Screws
from kempe.description.parts import Joint
from kempe.model.lengths import characteristic_length
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

ALONE = 1e-6
"""Sine of the angle between the motions of two joints below which they have an axis in common."""
TURNING = {"revolute", "universal", "spherical", "cylindrical"}
"""Joint types in which something can spin and stay where it is."""


@dataclass(frozen=True)
class IdleFreedom:
    """A spin of some bodies, as one, between two joints, all else at rest.

    Its axis goes through `point` [m] along `direction`, in the ground's frame at the configuration that was looked at.
    """

    bodies: tuple[str, ...]
    joints: tuple[str, str]
    point: tuple[float, ...]
    direction: tuple[float, ...]
    joined: bool
    """Whether the axis is the line through the origins of the two joints."""
    velocity: Array = field(repr=False, compare=False)
    """The motion as velocities (nv,) of the system, in SI units."""

    def __str__(self) -> str:
        who = " and ".join(self.bodies)
        verb = "spin together" if len(self.bodies) > 1 else "spins"
        direction = ", ".join(f"{x:.4g}" for x in self.direction)
        if self.joined:
            return f"{who} {verb} about the line through {self.joints[0]} and {self.joints[1]}"
        point = ", ".join(f"{x:.4g}" for x in self.point)
        return f"{who} {verb} between {self.joints[0]} and {self.joints[1]}, about ({direction}) through ({point})"


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two joints in series, and the positions (in the cluster's velocities) of what each can do."""

    edges: tuple[int, int]
    signs: tuple[float, float]
    columns: tuple[tuple[int, ...], tuple[int, ...]]
    """Own columns of each edge that nothing else follows."""


def idle_freedoms(system: System, ranks: Sequence[Rank]) -> tuple[IdleFreedom, ...]:
    """Independent idle freedoms at the first of `ranks`, as far as they are there at all of them."""
    s = structure(system)
    out: list[IdleFreedom] = []
    for c in s.clusters:
        found = []
        for pair, motions in _at_all(_pairs(system, s, c), ranks):
            found.append((bodies_between(system, s, *pair.edges), pair, motions))
        found.sort(key=lambda f: len(f[0]))  # small groups of bodies first: larger ones may move as their sums
        basis = np.zeros((system.nv, 0))
        for bodies, pair, motions in found:
            for z in motions.T:
                velocity, twist = _velocity(system, s, ranks[0], pair, z)
                rest = velocity - basis @ (basis.T @ velocity)
                if np.linalg.norm(rest) > ALONE * np.linalg.norm(velocity):
                    basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                    out.append(_freedom(s, ranks[0], bodies, pair, velocity, twist))
    return tuple(out)


def may_idle(system: System) -> bool:
    """Whether any two joints in series could have a motion in common."""
    s = structure(system)
    return any(_pairs(system, s, c) for c in s.clusters)


def _pairs(system: System, s: Structure, c: Cluster) -> list[_Pair]:
    key = ("analysis pairs", c.edges)
    found = system._queries.get(key)
    if found is None:
        found = system._queries[key] = _find_pairs(system, s, c)
    return found


def _find_pairs(system: System, s: Structure, c: Cluster) -> list[_Pair]:
    uses, length = np.bincount(c.velocities[c.local], minlength=system.nv), characteristic_length(system)
    for r in (system.relations[k] for k in c.relations):
        uses[[system.velocity_names.index(n) for n in (r.of, *r.sources)]] += 1
    series: dict[bytes, list[tuple[int, float]]] = {}
    for n, i in enumerate(c.edges):
        column = c.signs[:, n]
        sign = float(column[np.flatnonzero(column)[0]])
        series.setdefault((column * sign).astype(np.int8).tobytes(), []).append((i, sign))
    out = []
    for members in series.values():
        for (i, si), (k, sk) in combinations(members, 2):
            a, b = s.edges[i], s.edges[k]
            if not (_passive(a) and _passive(b)):
                continue
            if _same_bodies(s, i, k):
                continue
            own = [tuple(n for n, col in enumerate(e.columns)
                         if col.index >= 0 and uses[col.index] == 1 and not col.slides) for e in (a, b)]  # fmt: skip
            if all(own) and (max(len(a.columns), len(b.columns)) > 1 or _on_one_axis(system, s, i, k, length)):
                out.append(_Pair((i, k), (si, sk), (own[0], own[1])))
    return out


def _passive(edge: Edge) -> bool:
    """Whether it is a joint that something can spin in, and not driven."""
    return isinstance(edge.of, Joint) and edge.of.type.type_name in TURNING and not edge.actuated


def _on_one_axis(system: System, s: Structure, i: int, k: int, length: float) -> bool:
    """Whether two hinges have one axis of one body, which is all that is between them; `length` is that of links."""
    a, b = s.edges[i], s.edges[k]
    body = {a.parent, a.child} & {b.parent, b.child}
    if len(body) != 1:
        return False
    U, V = (e.X_PF if e.parent in body else e.X_CM for e in (a, b))
    apart = V[:3, 3] - U[:3, 3]
    apart -= U[:3, 2] * (apart @ U[:3, 2])
    if abs(U[:3, 2] @ V[:3, 2]) < 1.0 - 0.5 * ALONE**2 or apart @ apart > (ALONE * length) ** 2:
        return False
    return bodies_between(system, s, i, k) == (system.body_names[next(iter(body))],)


def _same_bodies(s: Structure, i: int, k: int) -> bool:
    """Whether two joints connect the same two bodies: what spins is then a shaft in its bearings."""
    a, b = s.edges[i], s.edges[k]
    return {a.parent, a.child} == {b.parent, b.child}


def _at_all(pairs: Sequence[_Pair], ranks: Sequence[Rank]) -> list[tuple[_Pair, Array]]:
    """Pairs that have motions in common at all configurations, with those (columns of both joints, k) at the first."""
    alike: dict[tuple[int, int], list[_Pair]] = {}
    for pair in pairs:
        alike.setdefault((len(pair.columns[0]), len(pair.columns[1])), []).append(pair)
    out = []
    for (n, _), group in alike.items():
        both = np.array([[_twists(r.screws, pair) for pair in group] for r in ranks])  # (ranks, pairs, 6, columns)
        _, values, Vt = np.linalg.svd(both)
        zero = Vt.shape[-1] - (values > ALONE * values[..., :1]).sum(axis=-1)
        for k in np.flatnonzero(zero.min(axis=0)).tolist():
            kernel = Vt[0, k, Vt.shape[-1] - zero[0, k] :].T
            moved = both[0, k, :, :n] @ kernel[:n]  # turns of a ball joint by angles can fail to move anything
            _, size, V = np.linalg.svd(moved)
            kernel = kernel @ V[: int((size > ALONE).sum())].T
            if kernel.shape[1]:
                out.append((group[k], kernel))
    return out


def _twists(at: Screws, pair: _Pair) -> Array:
    """Screws (6, n) of both joints, signed so that equal and opposite ones move what is between them alone."""
    a, b = (at.twists[i][:, list(c)] * s for i, c, s in zip(pair.edges, pair.columns, pair.signs, strict=True))
    return np.concatenate([a, b], axis=1)


def _velocity(system: System, s: Structure, rank: Rank, pair: _Pair, z: Array) -> tuple[Array, Array]:
    """Scaled velocities (nv,) of one motion of what is between two joints, and its twist (6,)."""
    out, n = np.zeros(system.nv), 0
    twist = rank.screws.twists[pair.edges[0]][:, list(pair.columns[0])] @ z[: len(pair.columns[0])]
    for i, columns in zip(pair.edges, pair.columns, strict=True):
        for c in columns:
            out[s.edges[i].columns[c].index] = z[n]
            n += 1
    return out, twist


def bodies_between(system: System, s: Structure, i: int, k: int) -> tuple[str, ...]:
    """Names of the bodies that two joints in series part from the ground."""
    key = ("analysis between", i, k)
    found = system._queries.get(key)
    if found is None:
        found = system._queries[key] = _between(system, s, i, k)
    return found


def _between(system: System, s: Structure, i: int, k: int) -> tuple[str, ...]:
    links: dict[int, list[int]] = {}
    for n, e in enumerate(s.edges):
        if n not in (i, k):
            links.setdefault(e.parent, []).append(e.child)
            links.setdefault(e.child, []).append(e.parent)
    reached, order = {0}, [0]
    for body in order:
        for other in links.get(body, ()):
            if other not in reached:
                reached.add(other)
                order.append(other)
    return tuple(b for n, b in enumerate(system.body_names) if n not in reached)


def _freedom(
    s: Structure, rank: Rank, bodies: tuple[str, ...], pair: _Pair, velocity: Array, twist: Array
) -> IdleFreedom:  # fmt: skip
    at = rank.screws
    v, w = twist[:3], twist[3:]
    size = np.linalg.norm(w)
    direction = w / size
    point = at.center + at.length * np.cross(w, v) / size**2
    point = point + direction * (direction @ (at.M[pair.edges[0], :3, 3] - point))
    direction = direction * np.sign(direction[np.argmax(np.abs(direction) > ALONE)])
    names = (s.edges[pair.edges[0]].name, s.edges[pair.edges[1]].name)
    numbers = [tuple((np.round(x, 12) + 0.0).tolist()) for x in (point, direction)]
    ends = (at.M[list(pair.edges), :3, 3] - point) / at.length
    joined = bool(np.abs(np.cross(ends, direction)).max() < ALONE < np.ptp(ends @ direction))
    return IdleFreedom(bodies, names, numbers[0], numbers[1], joined, velocity * rank.units)
