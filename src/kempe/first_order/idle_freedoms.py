"""Idle freedoms: spins of bodies about the line through the points that hold them.

Everything else rests at such a motion. It is found from velocities and axes, not from joint types.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.description.parts import Declared, Frame
from kempe.first_order.constraint_graph import ConstraintGraph, Edge, structure
from kempe.first_order.rank import Rank
from kempe.first_order.screws import Screws
from kempe.forward.fk import fk
from kempe.joints import P, Primitive, Q
from kempe.model.model import keep, kept
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- definition of an idle freedom

# An *idle freedom* is a motion at which
#
# 1. a group of bodies turns, as one, about a fixed line, and all other bodies rest, except the
#    small links of balls that are made of several joints;
# 2. the line goes through all points, two at least, about which joints let the group turn, its
#    ends: the centre of a ball (a spherical or universal joint, or consecutive hinges whose axes
#    meet in one point), any point of a hinge's axis that is fixed in the group, up to slides in it,
#    or a point of the group that a constraint holds. Two hinges of one body must have one axis, as
#    a roller's or a bush's;
# 3. it is there at the configurations around as well;
# 4. no joint that is driven moves;
# 5. the ends are held by different parts, of which a rod that is a constraint is one. A group that
#    one part alone holds is a door, a shaft or a leg: to move is what it is for;
# 6. the group carries nothing: no frame whose origin moves, no body on a joint of its own, no motor
#    but those of slides along it, and its joints, which all rest, are slides. With two ends joints
#    that turn may be among them between balls that are one joint each, or made of hinges that are
#    known not to be driven, since it is known which joints are.


# ---- joints in series, and stars

# Two joints of a loop are in series if cutting both parts the bodies. All that are in series with
# each other stand in one order around every loop through them: a series, of which the part with the
# ground is one piece. A star is a group of bodies that is held at more than two places.


@dataclass(frozen=True, eq=False)
class Turns:
    """How an edge can turn on its own: which of its `columns`, and whether these are all that it
    can do (`whole`).

    Columns that others follow or that a motor drives are left out, screws too, and turns whose axes
    have no place in the bodies, since the joint slides across them. `axis` is the name of the axis
    of a hinge, '' where there are more.
    """

    columns: tuple[int, ...]
    whole: bool
    axis: str


@dataclass(frozen=True, eq=False)
class SeriesLoop:
    """Edges in series in the order around their loops, from the ground's piece and back to it.

    Joints that cannot move are left out: what they connect is one part. `signs` tells which are
    passed from parent to child (+1), `turns` how each can turn on its own (None where it cannot),
    `joined` whether an edge and the next one meet in one part.
    """

    edges: tuple[int, ...]
    signs: tuple[float, ...]
    turns: tuple[Turns | None, ...]
    joined: tuple[bool, ...]

    def own(self, k: int) -> tuple[int, ...]:
        """Columns of the k-th edge that can turn alone."""
        turns = self.turns[k]
        return () if turns is None else turns.columns


def ends_of(s: ConstraintGraph, series: SeriesLoop, k: int) -> tuple[int, int]:
    """The bodies before and after the k-th edge of a series."""
    return _ends(s.edges[series.edges[k]], series.signs[k])


def _ends(edge: Edge, sign: float) -> tuple[int, int]:
    return (edge.parent, edge.child) if sign > 0 else (edge.child, edge.parent)


@kept
def all_series(system: Model, driven: frozenset[int]) -> tuple[SeriesLoop, ...]:
    """All series of at least two edges in which something can turn; `driven` are velocities that a
    motor holds.
    """
    return _all_series(system, structure(system), driven)


def _uses(system: Model, s: ConstraintGraph) -> np.ndarray:
    """For each velocity by how many columns and laws it is used."""
    uses = np.bincount(
        [c.index for e in s.edges for c in e.columns if c.index >= 0], minlength=system.nv
    )
    for law in s.laws:
        uses[list(law.support)] += 1
    return uses


def _all_series(
    system: Model, s: ConstraintGraph, driven: frozenset[int]
) -> tuple[SeriesLoop, ...]:
    part = parts(system)
    uses = _uses(system, s)
    out: list[SeriesLoop] = []
    for c in s.clusters:
        alike: dict[bytes, list[int]] = {}
        for n, i in enumerate(c.edges):
            column = c.signs[:, n]
            sign = column[np.flatnonzero(column)[0]]
            alike.setdefault((column * sign).astype(np.int8).tobytes(), []).append(i)
        number = {i: n for n, i in enumerate(c.edges)}
        for members in alike.values():
            loop = c.loops[int(np.flatnonzero(c.signs[:, number[members[0]]])[0])]
            inside = set(members)
            path = [
                (i, sign) for i, sign in s.loops[loop].path if i in inside and not rigid(s.edges[i])
            ]
            turns = tuple(_turns(s.edges[i], uses, driven) for i, _ in path)
            if sum(t is not None for t in turns) > 1:
                ends = [_ends(s.edges[i], sign) for i, sign in path]
                joined = tuple(bool(part[a[1]] == part[b[0]]) for a, b in pairwise(ends))
                out.append(
                    SeriesLoop(
                        tuple(i for i, _ in path), tuple(sign for _, sign in path), turns, joined
                    )
                )
    return tuple(out)


def _turns(edge: Edge, uses: np.ndarray, driven: frozenset[int]) -> Turns | None:
    """How an edge can turn alone; None where it cannot, or about axes that have no place."""
    if not edge.joint or edge.actuated or edge.particle:
        return None
    moved: dict[int, list[Primitive]] = {}
    for p, column in zip(edge.primitives, edge.drives, strict=True):
        for n in range(column, column + (3 if p.kind == Q else 1)):
            moved.setdefault(n, []).append(p)
    free = [n for n, c in enumerate(edge.columns) if c.index >= 0]
    own = tuple(
        n
        for n in free
        if not edge.columns[n].slides
        and uses[edge.columns[n].index] == 1
        and edge.columns[n].index not in driven
        and all(p.kind != P for p in moved[n])
    )
    slides = [p.axis for n in free if n not in own for p in moved[n] if p.kind == P]
    axis = moved[own[0]][0].axis if own else ""
    if not own or (slides and (len(own) > 1 or {*slides} != {axis})):
        return None
    whole = len(own) == len(edge.columns)
    return Turns(own, whole, axis if whole and len(own) == 1 else "")


@dataclass(frozen=True, eq=False)
class Star:
    """Bodies that only slides connect, and all that they are held by: at three places at least, or
    by a constraint.

    `chains` are edges in series, outwards; `points` constraints that hold a point of these bodies,
    and whether it is the origin of frame M; `loose` joints that hold nothing, since they can make
    every motion.
    """

    bodies: frozenset[int]
    slides: bool
    chains: tuple[SeriesLoop, ...]
    points: tuple[tuple[int, bool], ...]
    loose: tuple[int, ...]


def stars(system: Model, driven: frozenset[int]) -> tuple[Star, ...]:
    """All stars in which every joint can turn, or hold a point; `driven` are velocities that a
    motor holds.
    """
    s = structure(system)
    part = parts(system)
    uses = _uses(system, structure(system))
    group = part.copy()
    for e in s.edges:
        if e.joint and all(c.index < 0 or c.slides for c in e.columns):
            group[group == group[e.child]] = group[e.parent]
    outside: dict[int, list[int]] = {}
    for i, e in enumerate(s.edges):
        for g in (
            {int(group[e.parent]), int(group[e.child])} if group[e.parent] != group[e.child] else ()
        ):
            outside.setdefault(g, []).append(i)
    found: list[Star | None] = []
    for g, edges in outside.items():
        joints = sum(s.edges[i].joint for i in edges)
        if g != group[0] and len(edges) > 1 and (joints > 2 or joints < len(edges)):
            found.append(_star(system, s, group == g, edges, uses, driven))
    return tuple(x for x in found if x is not None)


def _star(
    system: Model,
    s: ConstraintGraph,
    inside: np.ndarray,
    edges: list[int],
    uses: np.ndarray,
    driven: frozenset[int],
) -> Star | None:
    looped = in_loop(system)
    chains: list[SeriesLoop] = []
    points: list[tuple[int, bool]] = []
    loose: list[int] = []
    bodies = frozenset(np.flatnonzero(inside).tolist())
    sliding = [i for i in edges_at(system, bodies) - {*edges} if not rigid(s.edges[i])]
    if not all(looped[i] for i in sliding):
        return None
    for i in edges:
        e = s.edges[i]
        child = bool(inside[e.child])
        if isinstance(e.of, Declared):
            if not e.of.rod and not child:
                return None
            points.append((i, child))
            continue
        own = len(e.columns) == (6 if system.dim == 3 else 3) and not (e.actuated or e.particle)
        if own and all(
            c.index >= 0 and uses[c.index] == 1 and c.index not in driven for c in e.columns
        ):
            loose.append(i)
            continue
        chain = _outwards(system, s, inside, i, uses, driven)
        if chain is None or not looped[i]:
            return None
        chains.append(chain)
    return Star(bodies, bool(sliding), tuple(chains), tuple(points), tuple(loose))


def _outwards(
    system: Model,
    s: ConstraintGraph,
    inside: np.ndarray,
    i: int,
    uses: np.ndarray,
    driven: frozenset[int],
) -> SeriesLoop | None:
    """The edges from a group outwards, through links that have two joints; None where the first
    cannot turn.
    """
    part = parts(system)
    path: list[tuple[int, float]] = []
    turns: list[Turns] = []
    here = s.edges[i].child if inside[s.edges[i].parent] else s.edges[i].parent
    sign = 1.0 if inside[s.edges[i].parent] else -1.0
    own = _turns(s.edges[i], uses, driven)
    while own is not None and len(path) < 3:
        path.append((i, sign))
        turns.append(own)
        link = frozenset(np.flatnonzero(part == part[here]).tolist())
        others = [k for k in edges_at(system, link) if k != i and not rigid(s.edges[k])]
        if 0 in link or inside[here] or len(others) != 1:
            break
        i = others[0]
        e = s.edges[i]
        sign, here = (1.0, e.child) if e.parent in link else (-1.0, e.parent)
        own = _turns(e, uses, driven)
    if not path or inside[here]:
        return None
    return SeriesLoop(
        tuple(k for k, _ in path),
        tuple(x for _, x in path),
        tuple(turns),
        (True,) * (len(path) - 1),
    )


def rigid(edge: Edge) -> bool:
    """Whether it holds its bodies together as one: a joint without a velocity."""
    return edge.joint and all(c.index < 0 for c in edge.columns)


@kept
def parts(system: Model) -> np.ndarray:
    """For each body the number of its part: bodies that joints without a velocity hold together are
    one part.
    """
    found = np.arange(len(system.body_names))
    for edge in structure(system).edges:
        if rigid(edge):
            found[found == found[edge.child]] = found[edge.parent]
    return found


@kept
def in_loop(system: Model) -> np.ndarray:
    """For each edge whether it is part of a loop (mask)."""
    s = structure(system)
    found = np.zeros(len(s.edges), dtype=bool)
    found[[i for c in s.clusters for i in c.edges]] = True
    return found


def edges_at(system: Model, bodies: frozenset[int]) -> set[int]:
    """Numbers of the edges that some of these bodies are connected by."""
    found = _edges_of_bodies(system)
    return {i for body in bodies for i in found[body]}


@kept
def _edges_of_bodies(system: Model) -> list[list[int]]:
    found: list[list[int]] = [[] for _ in system.body_names]
    for i, edge in enumerate(structure(system).edges):
        found[edge.parent].append(i)
        found[edge.child].append(i)
    return found


@kept
def between(system: Model, i: int, k: int) -> frozenset[int]:
    """Numbers of the bodies that two joints in series part from the ground."""
    s = structure(system)
    links: dict[int, list[int]] = {}
    for n, e in enumerate(s.edges):
        if n not in (i, k):
            links.setdefault(e.parent, []).append(e.child)
            links.setdefault(e.child, []).append(e.parent)
    reached = {0}
    order = [0]
    for body in order:
        for other in links.get(body, ()):
            if other not in reached:
                reached.add(other)
                order.append(other)
    return frozenset(range(len(system.body_names))) - reached


# ---- ends, between which something may spin

# An end is one joint, or consecutive joints in series whose axes meet in one point. Where axes meet
# in a part that two joints share does not depend on the configuration, as long as it is closed.

ALONE = 1e-6
"""Sine of the angle between axes, or distance as a part of the mechanism's size, below which they
are one, or meet."""


class BallEnd(NamedTuple):
    """Consecutive edges of a series (by place, the one next to the group first) whose axes meet in
    one point.

    The point is on the first edge's axis, `along` from its origin. It is a `hinge` if that is its
    only axis.
    """

    edges: tuple[int, ...]
    along: float
    hinge: bool


class SignedEnd(NamedTuple):
    """An end, and the sense in which its series is passed: +1 towards what it holds, -1 from there."""

    series: SeriesLoop
    end: BallEnd
    sign: float


class Pair(NamedTuple):
    """Two ends of a series between which something may spin."""

    series: SeriesLoop
    left: BallEnd
    right: BallEnd

    @property
    def holds(self) -> tuple[SignedEnd, ...]:
        """Both ends as holds."""
        return SignedEnd(self.series, self.left, 1.0), SignedEnd(self.series, self.right, -1.0)


class HeldStar(NamedTuple):
    """A star with its ends."""

    star: Star
    holds: tuple[SignedEnd, ...]


def pairs_of(system: Model, s: ConstraintGraph, at: Screws, driven: frozenset[int]) -> list[Pair]:
    """Pairs of ends between which something may spin, by what does not depend on the configuration.

    Where axes meet in a part that two joints share, they do so at every closed configuration, such
    as that of `at`.
    """
    answers = system._kept.setdefault(pairs_of, {})
    found = answers.get(driven)
    if found is None:
        found = keep(
            answers,
            driven,
            [p for series in all_series(system, driven) for p in _of_series(s, at, series)],
        )
    return found


def _of_series(s: ConstraintGraph, at: Screws, series: SeriesLoop) -> Iterator[Pair]:
    n = len(series.edges)
    meets = [_meet(at, series, k, k + 1) if series.joined[k] else None for k in range(n - 1)]
    turning = [k for k in range(n) if series.turns[k] is not None]
    ends = {(k, step): _grow(series, meets, k, step) for k in turning for step in (-1, 1)}
    balls = {
        step: {k for (k, d), end in ends.items() if d == step and not end.hinge} for step in (-1, 1)
    }
    chosen = {(p, q) for q in balls[1] for p in turning if p < q}
    chosen |= {(p, q) for p in balls[-1] for q in turning if p < q}
    chosen |= {(k, k + 1) for k, meet in enumerate(meets) if meet is not None and meet.one_axis}
    for p, q in sorted(chosen):
        pair = Pair(series, ends[p, -1], ends[q, 1])
        if not (pair.left.hinge or pair.right.hinge) or not (
            turning_inside(s, series, p, q) or _one_of_many(s, at, series, pair)
        ):
            yield pair


def held(system: Model, s: ConstraintGraph, at: Screws, driven: frozenset[int]) -> list[HeldStar]:
    """Stars with their ends, which do not depend on the configuration either; nor does, without
    slides, their line.
    """
    answers = system._kept.setdefault(held, {})
    found = answers.get(driven)
    if found is None:
        found = keep(answers, driven, [])
        for star in stars(system, driven):
            holds: list[SignedEnd] = []
            if not (star.chains or star.points):  # nothing holds it
                continue
            for series in star.chains:
                meets = [_meet(at, series, k, k + 1) for k in range(len(series.edges) - 1)]
                holds.append(SignedEnd(series, _grow(series, meets, 0, 1), -1.0))
            simple = all(len(h.end.edges) == 1 for h in holds)
            if not simple and any(h.end.hinge for h in holds):  # it may be a spherical linkage
                continue
            if star.slides or line_through(at, HeldStar(star, tuple(holds))) is not None:
                found.append(HeldStar(star, tuple(holds)))
    return found


class _Meeting(NamedTuple):
    """Where the axes of two joints of one part meet: from their origins, along their axes; or they
    are one axis.
    """

    along: tuple[float, float]
    one_axis: bool


def _meet(at: Screws, series: SeriesLoop, k: int, m: int) -> _Meeting | None:
    """Where the axes of the k-th and the m-th edge, which share a part, meet; None where they do
    not.
    """
    a = series.turns[k]
    b = series.turns[m]
    if a is None or b is None or not (a.columns and b.columns):
        return None
    (p, u), (r, v) = (line_of(at, series, i) for i in (k, m))
    away = (r - p) / at.length
    if u is None and v is None:
        return (
            _Meeting((0.0, 0.0), False)
            if np.linalg.norm(away) < ALONE and a.whole and b.whole
            else None
        )
    if u is not None and v is not None:
        normal = np.cross(u, v)
        size = np.linalg.norm(normal)
        if size < ALONE:
            return _Meeting((0.0, 0.0), True) if off(away, u) < ALONE else None
        if abs(away @ normal) > ALONE * size or not (a.whole and b.whole):
            return None
        x = np.cross(away, v) @ normal / size**2
        y = np.cross(away, u) @ normal / size**2
        return _Meeting((float(x), float(y)), False)
    if not (a.whole and b.whole):
        return None
    x = _along(u, away) if u is not None else _along(v, -away)
    if x is None:
        return None
    return _Meeting((x, 0.0) if u is not None else (0.0, x), False)


def _along(axis: Array | None, to: Array) -> float | None:
    """How far along an axis a point is, if it is on it."""
    assert axis is not None
    return float(to @ axis) if off(to, axis) < ALONE else None


def off(to: Array, axis: Array) -> float:
    """Distance of a point from the axis through the origin along a unit vector."""
    rest = to - (to @ axis) * axis
    return math.sqrt(rest @ rest)


def line_of(at: Screws, series: SeriesLoop, k: int) -> tuple[Array, Array | None]:
    """Origin of an edge, in the ground, and the direction of its axis if it can turn about one
    only.
    """
    i = series.edges[k]
    own = series.own(k)
    w = at.twists[i][3:, list(own)]
    return at.M[i, :3, 3], w[:, 0] / np.linalg.norm(w) if len(own) == 1 else None


def _grow(series: SeriesLoop, meets: Sequence[_Meeting | None], k: int, step: int) -> BallEnd:
    """The edges from the k-th on, in one direction, whose axes meet in one point, until they are as
    good as a ball.
    """
    edges = [k]
    columns = len(series.own(k))
    first = 0.0
    here = None
    while columns < 3:
        last = edges[-1]
        meet = meets[min(last, last + step)] if 0 <= last + step < len(series.edges) else None
        if meet is None or meet.one_axis:
            break
        near, far = meet.along if step > 0 else meet.along[::-1]
        if here is None:
            first = near
        elif abs(near - here) > ALONE:
            break
        here = far
        edges.append(last + step)
        columns += len(series.own(last + step))
    return BallEnd(tuple(edges), first, columns == 1)


def turning_inside(s: ConstraintGraph, series: SeriesLoop, p: int, q: int) -> bool:
    """Whether between two edges of a series there is more than slides."""
    inside = (s.edges[i] for i in series.edges[p + 1 : q])
    return any(not e.joint or any(c.index >= 0 and not c.slides for c in e.columns) for e in inside)


def _one_of_many(s: ConstraintGraph, at: Screws, series: SeriesLoop, pair: Pair) -> bool:
    """Whether a hinge and a ball made of several joints are but some of the joints about one point:
    of a spherical linkage, whose links are no parts of a ball.
    """
    hinge, ball = (pair.left, pair.right) if pair.left.hinge else (pair.right, pair.left)
    if ball.hinge or len(ball.edges) == 1:
        return False
    point = center_of(at, series, ball)
    n = len(series.edges)
    low = min(*hinge.edges, *ball.edges)
    high = max(*hinge.edges, *ball.edges)
    for k in {(low - 1) % n, (high + 1) % n} - set(range(low, high + 1)):
        edge = series.edges[k]
        T = at.twists[edge][:, [c for c, col in enumerate(s.edges[edge].columns) if not col.slides]]
        if T.size and np.abs(T[:3] - np.cross(point, T[3:], axis=0)).max() < ALONE:
            return True
    return False


def center_of(at: Screws, series: SeriesLoop, end: BallEnd) -> Array:
    """The point that all axes of an end go through, relative to the screws' centre, in their unit."""
    k = end.edges[0]
    point = (at.M[series.edges[k], :3, 3] - at.center) / at.length
    axis = line_of(at, series, k)[1] if len(series.own(k)) == 1 else None
    return point if axis is None else point + end.along * axis


def centers_of(at: Screws, of: Pair | HeldStar) -> list[Array]:
    """The points that hold a group, relative to the screws' centre, in their unit."""
    points = of.star.points if isinstance(of, HeldStar) else ()
    places = [(at.M if child else at.F)[i, :3, 3] for i, child in points]
    return [center_of(at, h.series, h.end) for h in of.holds] + [
        (p - at.center) / at.length for p in places
    ]


def line_through(at: Screws, of: Pair | HeldStar) -> tuple[Array, Array] | None:
    """A point and the direction of the line through all points that hold a group, and along all
    hinges that do.
    """
    centers = centers_of(at, of)
    a = next(
        (c for c, hold in zip(centers, of.holds, strict=False) if not hold.end.hinge), centers[0]
    )
    direction = None
    for series, end, _ in of.holds:
        along = line_of(at, series, end.edges[0])[1] if end.hinge else None
        direction = along if direction is None else direction
        if along is not None and direction is not None and off(along, direction) > ALONE:
            return None
    if direction is None:
        away = (
            centers[1] - a
            if len(centers) == 2
            else max((c - a for c in centers), key=lambda d: float(d @ d))
        )
        size = math.sqrt(away @ away)
        if size < ALONE:
            return None
        direction = away / size
        if len(centers) == 2:
            return a, direction
    return None if any(off(c - a, direction) > ALONE for c in centers) else (a, direction)


# ---- the idle freedoms of a system

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
    system: Model, ranks: Sequence[Rank], driven: Iterable[int] | None = None
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
            frames = [*system._mechanism.frames.values()] if frames is None else frames
            if not _moves_a_frame(system, frames, ranks[0], spin, group):
                found.append((spin, group))
    # small groups of bodies first: larger ones may move as their sums
    found.sort(key=lambda f: len(f[1].bodies))
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


def may_idle(system: Model, rank: Rank, driven: Iterable[int] | None = None) -> bool:
    """Whether anything looks like an idle freedom at one configuration."""
    return any(
        True for _ in _spins(system, structure(system), [rank.screws], frozenset(driven or ()))
    )


# ---- spins that exist at all configurations


def _spins(
    system: Model, s: ConstraintGraph, at: Sequence[Screws], driven: frozenset[int]
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
                rates |= _rates(at[0], hold, axis[1])
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


def _rates(at: Screws, hold: SignedEnd, direction: Array) -> dict[int, Array]:
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


# ---- tests whether a spin is idle


def _group(system: Model, s: ConstraintGraph, spin: _SpinCandidate, known: bool) -> _Group | None:
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


def _of_star(system: Model, s: ConstraintGraph, rank: Rank, spin: _SpinCandidate) -> _Group | None:
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
    system: Model, frames: Sequence[Frame], rank: Rank, spin: _SpinCandidate, group: _Group
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
        place = poses[body] @ frame.X_BF.evaluate(system._mechanism.parameters)
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
    system: Model,
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
