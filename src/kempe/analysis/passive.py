"""Idle freedoms: bodies that can spin about the line through two points, while everything else rests.

An *idle freedom* is a motion at which

1. a group of bodies turns, as one, about a fixed line, and all other bodies rest, except the small links of balls that
   are made of several joints;
2. the line goes through two points about which joints let the group turn, one at either end: the centre of a ball (a
   spherical or universal joint, or consecutive hinges whose axes meet in one point), or any point of a hinge's axis
   that is fixed in the group, up to slides in it. Two hinges of one body must have one axis, as a roller's or a bush's;
3. it is there at the configurations around as well;
4. no joint that is driven moves;
5. the two ends are held by different parts. A group that one part alone holds is a door, a shaft or a leg: to move
   is what it is for;
6. the group carries nothing: no frame whose origin moves, no body on a joint of its own, no motor but those of slides
   along it, and its joints, which all rest, are slides. Joints that turn may be among them between two balls that are
   one joint each, or made of hinges that are known not to be driven, since it is known which joints are.

Nothing of this looks at the types of joints, but only at their velocities and where the axes of these are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.analysis.ends import ALONE, End, Pair, center_of, line_of, off, pairs_of, turning_inside
from kempe.analysis.graph import Structure, structure
from kempe.analysis.rank import Rank
from kempe.analysis.screws import Screws
from kempe.analysis.series import Ring, between, edges_at, ends_of, in_loop, parts, rigid
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

INDEPENDENT = 1e-3
"""Volume of three unit vectors above which they span space, without a closer look."""


@dataclass(frozen=True)
class IdleFreedom:
    """A spin of some bodies, as one, between two joints, all else at rest but the `links` of balls made of hinges.

    Its axis goes through `point` [m] along `direction`, in the ground's frame at the configuration that was looked at.
    `joints` are those next to the group.
    """

    bodies: tuple[str, ...]
    joints: tuple[str, str]
    point: tuple[float, ...]
    direction: tuple[float, ...]
    joined: bool
    """Whether the axis is the line through the origins of the two joints."""
    velocity: Array = field(repr=False, compare=False)
    """The motion as velocities (nv,) of the system, in SI units."""
    links: tuple[str, ...] = ()

    def __str__(self) -> str:
        who = " and ".join(self.bodies)
        verb = "spin together" if len(self.bodies) > 1 else "spins"
        direction = ", ".join(f"{x:.4g}" for x in self.direction)
        if self.joined:
            return f"{who} {verb} about the line through {self.joints[0]} and {self.joints[1]}"
        point = ", ".join(f"{x:.4g}" for x in self.point)
        return f"{who} {verb} between {self.joints[0]} and {self.joints[1]}, about ({direction}) through ({point})"


class _Spin(NamedTuple):
    """A motion of what is between two ends of a ring: its axis at the first configuration, and rates by edge.

    The point is relative to the screws' centre, in their unit.
    """

    pair: Pair
    point: Array
    direction: Array
    rates: dict[int, Array]


def idle_freedoms(
    system: System, ranks: Sequence[Rank], driven: Iterable[int] | None = None
) -> tuple[IdleFreedom, ...]:  # fmt: skip
    """Independent idle freedoms at the first of `ranks`, as far as they are there at all of them.

    `driven` are the velocities that are known to be driven, besides joints marked so; None where nothing is known.
    """
    s, known = structure(system), driven is not None or any(e.actuated for e in structure(system).edges)
    found = []
    for spin in _spins(system, s, [r.screws for r in ranks], frozenset(driven or ())):
        bodies = _group(system, s, ranks[0], spin, known)
        if bodies is not None:
            found.append((spin, *bodies))
    found.sort(key=lambda f: len(f[1]))  # small groups of bodies first: larger ones may move as their sums
    basis, out = np.zeros((system.nv, 0)), []
    for spin, bodies, links in found:
        velocity = np.zeros(system.nv)
        for k, rates in spin.rates.items():
            columns = s.edges[spin.pair.ring.edges[k]].columns
            velocity[[columns[c].index for c in spin.pair.ring.own(k)]] = rates
        rest = velocity - basis @ (basis.T @ velocity)
        if np.linalg.norm(rest) > ALONE * np.linalg.norm(velocity):
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            out.append(_freedom(system, s, ranks[0], spin, bodies, links, velocity))
    return tuple(out)


def may_idle(system: System, rank: Rank, driven: Iterable[int] | None = None) -> bool:
    """Whether anything looks like an idle freedom at one configuration."""
    return any(True for _ in _spins(system, structure(system), [rank.screws], frozenset(driven or ())))


# ---- where something can spin


def _spins(system: System, s: Structure, at: Sequence[Screws], driven: frozenset[int]) -> Iterator[_Spin]:
    """Spins that exist at all configurations; the last to be looked at is whether anything else moves with them."""
    for pair in pairs_of(system, s, at[0], driven):
        axis = None
        for screws in reversed(at):
            axis = _axis(s, screws, pair)
            if axis is None:
                break
        if axis is not None:
            rates = [_rates(s, at[0], pair.ring, end, *axis, sign) for end, sign in ((pair.left, 1), (pair.right, -1))]
            yield _Spin(pair, *axis, rates[0] | rates[1])


def _axis(s: Structure, at: Screws, pair: Pair) -> tuple[Array, Array] | None:
    """Point and direction of the line that both ends can turn about."""
    a, b = center_of(at, pair.ring, pair.left), center_of(at, pair.ring, pair.right)
    if pair.left.hinge or pair.right.hinge:
        hinge = pair.left if pair.left.hinge else pair.right
        direction = line_of(at, pair.ring, hinge.edges[0])[1]
        assert direction is not None
        if off(b - a, direction) > ALONE:
            return None
    else:
        size = math.sqrt((b - a) @ (b - a))
        if size < ALONE:
            return None
        direction = (b - a) / size
    point = b if pair.left.hinge else a
    for end in (pair.left, pair.right):
        W = np.concatenate([at.twists[pair.ring.edges[k]][3:, list(pair.ring.own(k))] for k in end.edges], axis=1)
        if not end.hinge and not _spans(W, direction):
            return None
    return point, direction


def _spans(W: Array, direction: Array) -> bool:
    """Whether turns about axes W (3, n) add up to one about a direction."""
    if W.shape[1] == 3 and abs(_volume(W)) > INDEPENDENT:
        return True
    U, sizes, _ = np.linalg.svd(W, full_matrices=False)
    U = U[:, sizes > ALONE * sizes[0]]
    return bool(np.linalg.norm(direction - U @ (U.T @ direction)) < ALONE)


def _volume(W: Array) -> float:
    """Determinant of a matrix (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = W.tolist()
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _rates(
    s: Structure, at: Screws, ring: Ring, end: End, point: Array, direction: Array, sign: float
) -> dict[int, Array]:  # fmt: skip
    """Rates of the own columns of an end's edges, by place in the ring, that turn the group about the axis."""
    W = [ring.signs[k] * at.twists[ring.edges[k]][3:, list(ring.own(k))] for k in end.edges]
    A = np.concatenate(W, axis=1)
    if A.shape[1] == 3 and abs(_volume(A)) > INDEPENDENT:
        z = np.linalg.solve(A, sign * direction)
    else:
        z = np.asarray(np.linalg.lstsq(A, sign * direction, rcond=ALONE)[0], dtype=float)
    z[np.abs(z) < ALONE * np.abs(z).max()] = 0.0
    cuts = np.cumsum([w.shape[1] for w in W])[:-1]
    parted = [np.asarray(part, dtype=float) for part in np.split(z, cuts)]
    return {k: part for k, part in zip(end.edges, parted, strict=True) if part.any()}


# ---- whether it is idle


def _group(
    system: System, s: Structure, rank: Rank, spin: _Spin, known: bool
) -> tuple[frozenset[int], frozenset[int]] | None:  # fmt: skip
    """The bodies that turn as one and the links of balls that move with them; None where they are not idle."""
    ring, left, right = spin.pair
    places = sorted(spin.rates)
    low, high, part = places[0], places[-1], parts(system)
    if part[ends_of(s, ring, low)[0]] == part[ends_of(s, ring, high)[1]]:
        return None
    p, q = _inner(spin)
    moving = between(system, ring.edges[low], ring.edges[high])
    bodies = moving if (p, q) == (low, high) else between(system, ring.edges[p], ring.edges[q])
    turning = turning_inside(s, ring, p, q)
    for i in edges_at(system, moving) - {*ring.edges[low : high + 1]}:
        if not rigid(s.edges[i]):
            if not in_loop(system)[i] or s.edges[i].actuated:
                return None
            turning = True
    simple = (p, q) == (low, high) and not (left.hinge or right.hinge)
    if turning and not (simple or (known and not (left.hinge or right.hinge))):
        return None
    if _moves_a_frame(system, rank, spin, bodies, moving):
        return None
    return bodies, moving - bodies


def _inner(spin: _Spin) -> tuple[int, int]:
    """Places in the ring of the joints next to the group."""
    _, left, right = spin.pair
    return max(k for k in left.edges if k in spin.rates), min(k for k in right.edges if k in spin.rates)


def _moves_a_frame(
    system: System, rank: Rank, spin: _Spin, bodies: frozenset[int], moving: frozenset[int]
) -> bool:  # fmt: skip
    """Whether a frame that somebody named does not stay where it is."""
    names, at, poses = system.body_names, rank.screws, None
    for frame in system.mechanism.frames.values():
        body = names.index(frame.body)
        if body not in moving:
            continue
        poses = system.fk(rank.q) if poses is None else poses
        place = poses[body] @ frame.X_BF.evaluate(system.mechanism.parameters)
        away = (place[:3, 3] - at.center) / at.length - spin.point
        if body in bodies:
            away = away - (away @ spin.direction) * spin.direction
        else:
            centers = (center_of(at, spin.pair.ring, end) for end in (spin.pair.left, spin.pair.right))
            away = min((away + spin.point - center for center in centers), key=np.linalg.norm)
        if np.linalg.norm(away) > ALONE:
            return True
    return False


def _freedom(
    system: System, s: Structure, rank: Rank, spin: _Spin, bodies: frozenset[int], links: frozenset[int],
    velocity: Array,
) -> IdleFreedom:  # fmt: skip
    at, ring = rank.screws, spin.pair.ring
    p, q = _inner(spin)
    edges = sorted((ring.edges[p], ring.edges[q]))
    direction = spin.direction
    point = at.center + at.length * spin.point
    point = point + direction * (direction @ (at.M[edges[0], :3, 3] - point))
    direction = direction * np.sign(direction[np.argmax(np.abs(direction) > ALONE)])
    numbers = [tuple((np.round(x, 12) + 0.0).tolist()) for x in (point, direction)]
    ends = (at.M[edges, :3, 3] - point) / at.length
    joined = max(off(e, direction) for e in ends) < ALONE < abs((ends[1] - ends[0]) @ direction)
    names = [tuple(system.body_names[b] for b in sorted(group)) for group in (bodies, links)]
    pair = (s.edges[edges[0]].name, s.edges[edges[1]].name)
    return IdleFreedom(names[0], pair, numbers[0], numbers[1], joined, velocity * rank.units, names[1])
