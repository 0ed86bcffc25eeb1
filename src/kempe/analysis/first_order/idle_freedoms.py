"""Idle freedoms: bodies that can spin about the line through the points that hold them, while
everything else rests.

An *idle freedom* is a motion at which

1. a group of bodies turns, as one, about a fixed line, and all other bodies rest, except the small
   links of balls that are made of several joints;
2. the line goes through all points, two at least, about which joints let the group turn, its ends:
   the centre of a ball (a spherical or universal joint, or consecutive hinges whose axes meet in
   one point), any point of a hinge's axis that is fixed in the group, up to slides in it, or a
   point of the group that a constraint holds. Two hinges of one body must have one axis, as a
   roller's or a bush's;
3. it is there at the configurations around as well;
4. no joint that is driven moves;
5. the ends are held by different parts, of which a rod that is a constraint is one. A group that
   one part alone holds is a door, a shaft or a leg: to move is what it is for;
6. the group carries nothing: no frame whose origin moves, no body on a joint of its own, no motor
   but those of slides along it, and its joints, which all rest, are slides. With two ends joints
   that turn may be among them between balls that are one joint each, or made of hinges that are
   known not to be driven, since it is known which joints are.

Nothing of this looks at the types of joints, but only at their velocities and where the axes of
these are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.analysis.first_order.constraint_graph import ConstraintGraph, structure
from kempe.analysis.first_order.ends import (
    ALONE,
    HeldStar,
    Pair,
    SignedEnd,
    centers_of,
    held,
    line_through,
    off,
    pairs_of,
    turning_inside,
)
from kempe.analysis.first_order.rank import Rank
from kempe.analysis.first_order.screws import Screws
from kempe.analysis.first_order.series_joints import (
    between,
    edges_at,
    ends_of,
    in_loop,
    parts,
    rigid,
)
from kempe.description.parts import Declared, Frame
from kempe.kinematics.forward import fk
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.model.system import System

INDEPENDENT = 1e-3
"""Volume of three unit vectors above which they span space, without a closer look."""


@dataclass(frozen=True)
class IdleFreedom(InWords):
    """A spin of some bodies, as one, between two joints, all else at rest but the `links` of balls
    made of hinges.

    Its axis goes through `point` [m] along `direction`, in the ground's frame at the configuration
    that was looked at. `joints` are those next to the group.
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
        return (
            f"{who} {verb} between {self.joints[0]} and {self.joints[1]}, about ({direction}) "
            f"through ({point})"
        )


class _SpinCandidate(NamedTuple):
    """A motion of what ends hold: its axis at the first configuration, and rates (all columns) by
    edge.

    The point is relative to the screws' centre, in their unit.
    """

    of: Pair | HeldStar
    point: Array
    direction: Array
    rates: dict[int, Array]


class _Group(NamedTuple):
    """The bodies that turn as one, links of balls that move with them, and two joints next to the
    group.
    """

    bodies: frozenset[int]
    links: frozenset[int]
    joints: tuple[int, int]


def idle_freedoms(
    system: System, ranks: Sequence[Rank], driven: Iterable[int] | None = None
) -> tuple[IdleFreedom, ...]:
    """Independent idle freedoms at the first of `ranks`, as far as they are there at all of them.

    `driven` are the velocities that are known to be driven, besides joints marked so; None where
    nothing is known.
    """
    s = structure(system)
    known = driven is not None or any(e.actuated for e in structure(system).edges)
    frames = None
    found: list[tuple[_SpinCandidate, _Group]] = []
    for spin in _spins(system, s, [r.screws for r in ranks], frozenset(driven or ())):
        group = (
            _group(system, s, spin, known)
            if isinstance(spin.of, Pair)
            else _of_star(system, s, ranks[0], spin)
        )
        if group is not None:
            frames = [*system.mechanism.frames.values()] if frames is None else frames
            if not _moves_a_frame(system, frames, ranks[0], spin, group):
                found.append((spin, group))
    found.sort(
        key=lambda f: len(f[1].bodies)
    )  # small groups of bodies first: larger ones may move as their sums
    basis = np.zeros((system.nv, 0))
    out: list[IdleFreedom] = []
    for spin, group in found:
        velocity = np.zeros(system.nv)
        for i, rates in spin.rates.items():
            own = np.flatnonzero(rates)
            velocity[[s.edges[i].columns[c].index for c in own]] = rates[own]
        rest = velocity - basis @ (basis.T @ velocity)
        if np.linalg.norm(rest) > ALONE * np.linalg.norm(velocity):
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            out.append(_freedom(system, s, ranks[0], spin, group, velocity))
    return tuple(out)


def may_idle(system: System, rank: Rank, driven: Iterable[int] | None = None) -> bool:
    """Whether anything looks like an idle freedom at one configuration."""
    return any(
        True for _ in _spins(system, structure(system), [rank.screws], frozenset(driven or ()))
    )


# ---- where something can spin


def _spins(
    system: System, s: ConstraintGraph, at: Sequence[Screws], driven: frozenset[int]
) -> Iterator[_SpinCandidate]:
    """Spins that exist at all configurations; the last to be looked at is whether anything else
    moves with them.
    """
    candidates: list[Pair | HeldStar] = [
        *pairs_of(system, s, at[0], driven),
        *held(system, s, at[0], driven),
    ]
    for of in candidates:
        axis = None
        for screws in reversed(at):
            axis = _axis(screws, of)
            if axis is None:
                break
        if axis is not None:
            rates: dict[int, Array] = {}
            for hold in of.holds:
                rates |= _rates(at[0], hold, *axis)
            star = of.star if isinstance(of, HeldStar) else None
            for i in star.loose if star else ():
                sign = 1.0 if star and s.edges[i].child in star.bodies else -1.0
                screw = sign * np.concatenate([np.cross(axis[0], axis[1]), axis[1]])
                rates[i] = np.asarray(
                    np.linalg.lstsq(at[0].twists[i], screw, rcond=ALONE)[0], dtype=float
                )
            yield _SpinCandidate(of, *axis, rates)


def _axis(at: Screws, of: Pair | HeldStar) -> tuple[Array, Array] | None:
    """Point and direction of the line that the group can turn about at all ends."""
    line = line_through(at, of)
    if line is None:
        return None
    balls = (hold for hold in of.holds if not hold.end.hinge)
    return line if all(_spans(_axes(at, hold), line[1]) for hold in balls) else None


def _axes(at: Screws, hold: SignedEnd) -> Array:
    """Axes (3, n) of an end, in the sense in which its series is passed."""
    series, end, _ = hold
    W = [series.signs[k] * at.twists[series.edges[k]][3:, list(series.own(k))] for k in end.edges]
    return W[0] if len(W) == 1 else np.concatenate(W, axis=1)


def _spans(W: Array, direction: Array) -> bool:
    """Whether turns about axes W (3, n) add up to one about a direction."""
    if W.shape[1] == 3 and abs(_volume(W)) > INDEPENDENT:
        return True
    U, sizes, _ = svd(W, full_matrices=False)
    U = U[:, sizes > ALONE * sizes[0]]
    return bool(np.linalg.norm(direction - U @ (U.T @ direction)) < ALONE)


def _volume(W: Array) -> float:
    """Determinant of a matrix (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = W.tolist()
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _rates(at: Screws, hold: SignedEnd, point: Array, direction: Array) -> dict[int, Array]:
    """Rates of all columns of an end's edges that turn the group about the axis; edges that rest
    are left out.
    """
    (series, end, sign) = hold
    A = _axes(at, hold)
    first = 0
    out: dict[int, Array] = {}
    if A.shape[1] == 3 and abs(_volume(A)) > INDEPENDENT:
        z = np.linalg.solve(A, sign * direction)
    else:
        z = np.asarray(np.linalg.lstsq(A, sign * direction, rcond=ALONE)[0], dtype=float)
    z[np.abs(z) < ALONE * np.abs(z).max()] = 0.0
    for k in end.edges:
        own = series.own(k)
        rates = np.zeros(at.twists[series.edges[k]].shape[1])
        rates[list(own)] = z[first : first + len(own)]
        first += len(own)
        if rates.any():
            out[series.edges[k]] = rates
    return out


# ---- whether it is idle


def _group(system: System, s: ConstraintGraph, spin: _SpinCandidate, known: bool) -> _Group | None:
    """What is between the ends of a pair; None where it is not idle."""
    assert isinstance(spin.of, Pair)
    series, left, right = spin.of
    places = [k for k, i in enumerate(series.edges) if i in spin.rates]
    low = places[0]
    high = places[-1]
    part = parts(system)
    if part[ends_of(s, series, low)[0]] == part[ends_of(s, series, high)[1]]:
        return None
    p = max(k for k in left.edges if k in places)
    q = min(k for k in right.edges if k in places)
    moving = between(system, series.edges[low], series.edges[high])
    bodies = moving if (p, q) == (low, high) else between(system, series.edges[p], series.edges[q])
    turning = turning_inside(s, series, p, q)
    for i in edges_at(system, moving) - {*series.edges[low : high + 1]}:
        if not rigid(s.edges[i]):
            if not in_loop(system)[i] or s.edges[i].actuated:
                return None
            turning = True
    simple = (p, q) == (low, high) and not (left.hinge or right.hinge)
    if turning and not (simple or (known and not (left.hinge or right.hinge))):
        return None
    return _Group(bodies, moving - bodies, (series.edges[p], series.edges[q]))


def _of_star(system: System, s: ConstraintGraph, rank: Rank, spin: _SpinCandidate) -> _Group | None:
    """The bodies of a star, with links of balls that turn with them; None where they are not idle."""
    assert isinstance(spin.of, HeldStar)
    star = spin.of.star
    part = parts(system)
    at = rank.screws
    bodies = set(star.bodies)
    links: set[int] = set()
    outside: list[int] = []
    joints: list[int] = []
    for series, end, _ in spin.of.holds:
        places = [k for k in end.edges if series.edges[k] in spin.rates]
        beyond = [
            np.flatnonzero(part == part[ends_of(s, series, k)[1]]).tolist()
            for k in end.edges[: places[-1]]
        ]
        bodies |= {b for own in beyond[: places[0]] for b in own}
        links |= {b for own in beyond[places[0] :] for b in own}
        outside.append(int(part[ends_of(s, series, places[-1])[1]]))
        joints.append(series.edges[places[0]])
    for i, child in star.points:
        e = s.edges[i]
        rod = isinstance(e.of, Declared) and e.of.rod
        outside.append(-1 - i if rod else int(part[e.parent if child else e.child]))
        joints.append(i)
    if len(set(outside)) == 1:
        return None
    places = np.array(centers_of(at, spin.of)) @ spin.direction
    first = min(range(len(joints)), key=lambda k: joints[k])
    second = int(np.argmax(np.abs(places - places[first])))
    if second == first:  # all hinges have one origin
        second = next(k for k in range(len(joints)) if k != first)
    return _Group(frozenset(bodies), frozenset(links), (joints[first], joints[second]))


def _moves_a_frame(
    system: System, frames: Sequence[Frame], rank: Rank, spin: _SpinCandidate, group: _Group
) -> bool:
    """Whether a frame that somebody named does not stay where it is."""
    names = system.body_names
    at = rank.screws
    poses = None
    bodies = group.bodies
    moving = bodies | group.links
    for frame in frames:
        body = names.index(frame.body)
        if body not in moving:
            continue
        poses = fk(system, rank.q) if poses is None else poses
        place = poses[body] @ frame.X_BF.evaluate(system.mechanism.parameters)
        away = (place[:3, 3] - at.center) / at.length - spin.point
        if body in bodies:
            away = away - (away @ spin.direction) * spin.direction
        else:
            away = min(
                (away + spin.point - center for center in centers_of(at, spin.of)),
                key=np.linalg.norm,
            )
        if np.linalg.norm(away) > ALONE:
            return True
    return False


def _freedom(
    system: System,
    s: ConstraintGraph,
    rank: Rank,
    spin: _SpinCandidate,
    group: _Group,
    velocity: Array,
) -> IdleFreedom:
    at = rank.screws
    edges = sorted(group.joints)
    direction = spin.direction
    places = dict(spin.of.star.points) if isinstance(spin.of, HeldStar) else {}
    origins = np.array([(at.M if places.get(i, True) else at.F)[i, :3, 3] for i in edges])
    point = at.center + at.length * spin.point
    point = point + direction * (direction @ (origins[0] - point))
    direction = direction * np.sign(direction[np.argmax(np.abs(direction) > ALONE)])
    numbers: list[tuple[float, ...]] = [
        tuple((x.round(12) + 0.0).tolist()) for x in (point, direction)
    ]
    ends = (origins - point) / at.length
    joined = bool(
        max(off(e, direction) for e in ends) < ALONE < abs((ends[1] - ends[0]) @ direction)
    )
    names = [
        tuple(system.body_names[b] for b in sorted(own)) for own in (group.bodies, group.links)
    ]
    pair = (s.edges[edges[0]].name, s.edges[edges[1]].name)
    return IdleFreedom(
        names[0], pair, numbers[0], numbers[1], joined, velocity * rank.units, names[1]
    )
