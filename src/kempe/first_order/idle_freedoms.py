"""Idle freedoms: spins of bodies that move no other body, such as a rod between two balls.

They are found from axes and velocities, not from types of joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.description.parts import Declared
from kempe.first_order.constraint_graph import Edge, build_constraint_graph
from kempe.first_order.rank import Rank
from kempe.first_order.screws import Screws
from kempe.forward.fk import fk
from kempe.joints import P, Q
from kempe.model.model import keep_answers, store_answer
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array, skew
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.model.model import Model


# An *idle freedom* is a motion at which
#
# 1. a group of bodies turns, as one, about a fixed line, and all other bodies rest, except the
#    small links of balls that are made of several joints;
# 2. the line goes through all points, two at least, about which joints let the group turn, its
#    ends: the centre of a ball (a spherical or universal joint, or consecutive hinges whose axes
#    meet in one point), any point of a hinge's axis that is fixed in the group, up to slides in it,
#    or a point of the group that a constraint holds;
# 3. it is there at the configurations around as well;
# 4. no joint that is driven moves;
# 5. the ends are held by different parts, of which a rod that is a constraint is one. A group that
#    one part alone holds is a door, a shaft or a leg: to move is what it is for;
# 6. the group carries nothing: no frame whose origin moves, no body on a joint of its own, no motor
#    but those of slides along it, and its joints, which all rest, are slides. With two ends joints
#    that turn may be among them between balls that are one joint each, or made of hinges that are
#    known not to be driven, since it is known which joints are.
#
# So a group is stated with its ends, and its ends say which twists they allow it while everything
# else rests: these must be the turns about one line.

ALONE = 1e-6
"""Sine of the angle between axes, or distance as a part of the mechanism's size, below which they
are one, or meet."""


@dataclass(frozen=True)
class IdleFreedom(InWords):
    """An idle freedom: bodies spin as one between two joints, while all other bodies rest.

    Only the small `links` of balls made of hinges move as well.

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
    in_body: Array = field(default_factory=lambda: np.zeros((2, 3)), repr=False, compare=False)
    """Point and direction (2, 3) of the axis in the axes of the first of the bodies."""

    @property
    def moving_velocities(self) -> np.ndarray:
        """Mask (nv,) of the velocities of the system that are not zero in this motion."""
        return self.velocity != 0.0

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


# ---- the graph around a group


class Surroundings(NamedTuple):
    """The constraint graph with bodies that rigid joints hold together as one node, a *part*.

    `part` is the number of the part of each body, `ends` the parts of the parent and the child of
    each edge, `edges_at` the edges at each part but rigid joints, `looped` whether an edge is part
    of a loop, `uses` how many columns and laws use each velocity.
    """

    part: np.ndarray
    ends: list[tuple[int, int]]
    edges_at: list[set[int]]
    looped: np.ndarray
    uses: np.ndarray

    @property
    def ground(self) -> int:
        """Number of the part of the ground."""
        return int(self.part[0])

    def collect_edges(self, parts: Iterable[int]) -> set[int]:
        """Collect the edges at several parts."""
        return {i for p in parts for i in self.edges_at[p]}

    def collect_connected_parts(self, part: int, passes: Callable[[int], bool]) -> frozenset[int]:
        """Collect the parts that edges accepted by `passes` connect to a part."""
        order = [part]
        seen = {part}
        for here in order:
            for i in self.edges_at[here]:
                if passes(i):
                    new = {*self.ends[i]} - seen
                    seen |= new
                    order += new
        return frozenset(seen)


@keep_answers
def find_surroundings(system: Model) -> Surroundings:
    """Find parts, the edges at each of them, edges in loops and the use of each velocity."""
    s = build_constraint_graph(system)
    rigid = [e.is_joint and all(c.index < 0 for c in e.columns) for e in s.edges]
    part = np.arange(len(system.body_names))
    for e, holds in zip(s.edges, rigid, strict=True):
        if holds:
            part[part == part[e.child]] = part[e.parent]
    ends = [(int(part[e.parent]), int(part[e.child])) for e in s.edges]
    edges_at: list[set[int]] = [set() for _ in part]
    for i, holds in enumerate(rigid):
        for p in () if holds else ends[i]:
            edges_at[p].add(i)
    looped = np.zeros(len(s.edges), dtype=bool)
    looped[[i for c in s.clusters for i in c.edges]] = True
    used = [c.index for e in s.edges for c in e.columns if c.index >= 0]
    uses = np.bincount(np.array(used, dtype=np.int64), minlength=system.nv)
    for law in s.laws:
        uses[list(law.support)] += 1
    return Surroundings(part, ends, edges_at, looped, uses)


def find_turning_columns(edge: Edge, uses: np.ndarray, driven: frozenset[int]) -> tuple[int, ...]:
    """Find the velocities of an edge that can rotate on their own about an axis with a fixed place.

    Columns that others follow or that a motor drives are left out, screws too, and turns across
    whose axes the joint slides.
    """
    if not edge.is_joint or edge.actuated or edge.particle:
        return ()
    moved: dict[int, list[tuple[int, str]]] = {}
    for p, column in zip(edge.primitives, edge.drives, strict=True):
        for n in range(column, column + (3 if p.kind == Q else 1)):
            moved.setdefault(n, []).append((p.kind, p.axis))
    free = [n for n, c in enumerate(edge.columns) if c.index >= 0]
    own = tuple(
        n
        for n in free
        if not edge.columns[n].slides
        and uses[edge.columns[n].index] == 1
        and edge.columns[n].index not in driven
        and all(kind != P for kind, _ in moved[n])
    )
    slides = {axis for n in free if n not in own for kind, axis in moved[n] if kind == P}
    return () if slides and (len(own) != 1 or slides != {moved[own[0]][0][1]}) else own


# ---- ends of a group


class Step(NamedTuple):
    """One edge of an `End`: the columns that may move, and the rigid part beyond the edge.

    `sign` is +1 where the edge's child is on the side of the group.
    """

    edge: int
    sign: float
    columns: tuple[int, ...]
    beyond: int


class End(NamedTuple):
    """A connection that holds a group at a point: a joint, concurrent hinges, or a constraint.

    `steps` lead outwards. The point is fixed at `place` in frame M of the first edge, or in frame F
    (`of_child` false). `linkage`: an axis beyond goes through the point as well, so that these
    hinges may be links of a spherical linkage. `free`: a joint that can make every motion.
    """

    steps: tuple[Step, ...]
    place: Array
    of_child: bool = True
    linkage: bool = False
    free: bool = False

    @property
    def n_turns(self) -> int:
        """Number of axes about which the group can turn."""
        return sum(len(step.columns) for step in self.steps)

    @property
    def is_hinge(self) -> bool:
        """Whether the group can turn about one axis only."""
        return self.n_turns == 1

    def locate_point(self, at: Screws) -> Array:
        """Return the point (3,) of the end, relative to the centre of the screws and in their unit."""
        X = (at.M if self.of_child else at.F)[self.steps[0].edge]
        return (X[:3, :3] @ self.place + X[:3, 3] - at.center) / at.length

    def compute_twists(self, at: Screws) -> Array:
        """Compute the twists (6, k) of the group relative to the part beyond the end."""
        T = [step.sign * at.twists[step.edge][:, list(step.columns)] for step in self.steps]
        return T[0] if len(T) == 1 else np.concatenate(T, axis=1)


def _find_ends(system: Model, at: Screws, driven: frozenset[int]) -> dict[tuple[int, bool], End]:
    """Find the ends of groups, by first edge and whether the group is on the side of its child."""
    found = {
        (i, of_child): _find_end(system, at, i, of_child, driven)
        for i in range(len(build_constraint_graph(system).edges))
        for of_child in (True, False)
    }
    return {key: end for key, end in found.items() if end is not None}


def _find_end(
    system: Model, at: Screws, i: int, of_child: bool, driven: frozenset[int]
) -> End | None:
    """Find the end that begins with edge i; None where no rotation about a point or axis is left."""
    e = build_constraint_graph(system).edges[i]
    around = find_surroundings(system)
    beyond = around.ends[i][0 if of_child else 1]
    first = Step(i, 1.0 if of_child else -1.0, (), beyond)
    if isinstance(e.of, Declared):
        first = first._replace(beyond=-1 - i) if e.of.rod else first
        return End((first,), np.zeros(3), of_child) if of_child or e.of.rod else None
    alone = [
        c.index >= 0 and around.uses[c.index] == 1 and c.index not in driven for c in e.columns
    ]
    if all(alone) and len(alone) == (6 if system.dim == 3 else 3) and not e.actuated:
        return End((first._replace(columns=tuple(range(len(alone)))),), np.zeros(3), free=True)
    columns = find_turning_columns(e, around.uses, driven)
    if not columns or not around.looped[i]:
        return None
    steps, point = _collect_meeting_joints(system, at, first._replace(columns=columns), driven)
    linkage = len(steps) > 1 and any(
        _do_axes_pass_point(system, at, k, point) for k in _list_edges_beyond(around, steps[-1])
    )
    X = at.M[i]
    return End(
        tuple(steps), X[:3, :3].T @ (at.center + at.length * point - X[:3, 3]), True, linkage
    )


def _collect_meeting_joints(
    system: Model, at: Screws, first: Step, driven: frozenset[int]
) -> tuple[list[Step], Array]:
    """Collect consecutive joints outwards whose axes meet in one point; return joints and point.

    The search stops when the joints allow all rotations, as a ball does.

    The links in between have two joints.
    """
    s = build_constraint_graph(system)
    around = find_surroundings(system)
    steps = [first]
    T = at.twists[first.edge][:, list(first.columns)]
    point = (at.M[first.edge, :3, 3] - at.center) / at.length
    while system.dim == 3 and T.shape[1] < 3:
        last = steps[-1]
        others = _list_edges_beyond(around, last)
        if len(last.columns) < len(s.edges[last.edge].columns) or len(others) != 1:
            break
        (i,) = others
        e = s.edges[i]
        columns = find_turning_columns(e, around.uses, driven)
        T = np.concatenate([T, at.twists[i][:, list(columns)]], axis=1)
        center = find_common_point(T) if len(columns) == len(e.columns) > 0 else None
        if center is None:
            break
        point = center
        outer, inner = around.ends[i]
        inwards = inner == last.beyond
        steps.append(Step(i, 1.0 if inwards else -1.0, columns, outer if inwards else inner))
    return steps, point


def _list_edges_beyond(around: Surroundings, step: Step) -> set[int]:
    """List the other edges of the part beyond a step; none for the part of the ground."""
    return around.edges_at[step.beyond] - {step.edge} if step.beyond != around.ground else set()


def _do_axes_pass_point(system: Model, at: Screws, i: int, point: Array) -> bool:
    """Return whether all axes of rotation of an edge pass through a point."""
    turns = [
        c
        for c, column in enumerate(build_constraint_graph(system).edges[i].columns)
        if not column.slides
    ]
    T = at.twists[i][:, turns]
    return bool(turns) and np.abs(T[:3] - np.cross(point, T[3:], axis=0)).max() < ALONE


def find_common_point(twists: Array) -> Array | None:
    """Find the only point (3,) that the axes of rotations (6, k) share; None if there is none."""
    rows = np.concatenate([skew(w) for w in twists[3:].T])
    spectrum = Spectrum(rows)
    if spectrum.compute_rank(Level.GENERIC) < 3:
        return None
    v = -twists[:3].T.ravel()
    point = spectrum.solve_least_squares(v, Level.GENERIC)
    return point if np.abs(rows @ point - v).max() < ALONE else None


# ---- groups and their ends


class Group(NamedTuple):
    """Parts that may turn as one body, with the ends that hold them."""

    parts: frozenset[int]
    ends: tuple[End, ...]


def find_spin_groups(system: Model, at: Screws, driven: frozenset[int], known: bool) -> list[Group]:
    """Find all groups of bodies that may spin idly, from facts that no configuration changes.

    `driven` are velocities that a motor holds, `known` whether these are all. Where axes meet in a
    part that two joints share, they do so at every closed configuration, such as that of `at`.
    """
    answers = system._kept.setdefault(find_spin_groups, {})
    found = answers.get((driven, known))
    if found is None:
        ends = _find_ends(system, at, driven)
        found = [*_find_sliding_groups(system, at, ends), *_find_ball_groups(system, ends, known)]
        store_answer(answers, (driven, known), found)
    return found


def _find_sliding_groups(
    system: Model, at: Screws, ends: dict[tuple[int, bool], End]
) -> Iterator[Group]:
    """Find groups whose inner joints are at most slides, with all ends that hold each group."""
    edges = build_constraint_graph(system).edges
    around = find_surroundings(system)

    def passes(i: int) -> bool:
        """Return whether an edge is a joint without rotations."""
        return edges[i].is_joint and all(c.index < 0 or c.slides for c in edges[i].columns)

    seen = around.collect_connected_parts(around.ground, passes)
    for part in around.part.tolist():
        if part in seen:
            continue
        parts = around.collect_connected_parts(part, passes)
        seen |= parts
        own = sorted(around.collect_edges(parts))
        inside = [i for i in own if parts.issuperset(around.ends[i])]
        keys = [(i, around.ends[i][1] in parts) for i in own if i not in inside]
        if not around.looped[inside].all() or not ends.keys() >= {*keys}:
            continue
        group = Group(parts, tuple(ends[key] for key in keys))
        holds = [end for end in group.ends if not end.free]
        hinged = any(end.is_hinge for end in holds)
        if (
            len(holds) > 1
            # in a plane lines through points are no axes
            and (hinged or system.dim == 3)
            # hinges that meet on another hinge's axis may be a spherical linkage
            and not (hinged and any(end.linkage for end in holds))
            # without slides, points and hinges keep their places in the group
            and (inside or _find_spin_line(at, group) is not None)
        ):
            yield group


def _find_ball_groups(
    system: Model, ends: dict[tuple[int, bool], End], known: bool
) -> Iterator[Group]:
    """Find groups, with any joints inside, that two balls separate from the ground.

    Two edges part bodies from the ground if each loop passes both of them or none.
    """
    s = build_constraint_graph(system)
    around = find_surroundings(system)
    balls = {
        key: end
        for key, end in ends.items()
        if end.n_turns == 3 and not end.free and (known or len(end.steps) == 1)
    }
    for c in s.clusters:
        alike: dict[bytes, list[int]] = {}
        for n, i in enumerate(c.edges):
            column = c.signs[:, n]
            sign = column[np.flatnonzero(column)[0]]
            alike.setdefault((column * sign).astype(np.int8).tobytes(), []).append(i)
        for series in alike.values():
            usable = [i for i in series if (i, True) in balls or (i, False) in balls]
            for pair in combinations(usable, 2):
                sides = [
                    around.collect_connected_parts(p, lambda i, pair=pair: i not in pair)
                    for p in around.ends[pair[0]][::-1]
                ]
                parts = sides[1] if around.ground in sides[0] else sides[0]
                keys = [(i, around.ends[i][1] in parts) for i in pair]
                carried = around.collect_edges(parts) - {*series}
                rests = all(around.looped[i] and not s.edges[i].actuated for i in carried)
                if balls.keys() >= {*keys} and rests:
                    yield Group(parts, tuple(balls[key] for key in keys))


# ---- spins


class Spin(NamedTuple):
    """A rotation of a group about a line while all other bodies rest.

    The line is given by a point, relative to the screws' centre and in their unit, and a direction.
    `velocity` (nv,) is scaled as the screws are; `moving` are the ends with those of their steps
    that turn, but for free joints.
    """

    group: Group
    point: Array
    direction: Array
    velocity: Array
    moving: list[tuple[End, list[Step]]]


def _find_spins(
    system: Model, at: Sequence[Screws], driven: Iterable[int] | None
) -> Iterator[Spin]:
    """Find the spins that exist at all given configurations, as they are at the first.

    `driven` are the velocities that are known to be driven, besides joints marked so; None where
    nothing is known.
    """
    known = driven is not None or any(e.actuated for e in build_constraint_graph(system).edges)
    for group in find_spin_groups(system, at[0], frozenset(driven or ()), known):
        spin = None
        for screws in reversed(at):
            spin = _find_spin(system, screws, group)
            if spin is None:
                break
        if spin is not None:
            holders = {steps[-1].beyond for _, steps in spin.moving}
            if len(holders) > 1 and not holders & group.parts:
                yield spin


def _find_spin_line(at: Screws, group: Group) -> tuple[Array, Array] | None:
    """Find the line through the points that hold a group: a point and a direction.

    The line is along the axes of all hinges among the ends.
    """
    holds = [end for end in group.ends if not end.free]
    points = np.array([end.locate_point(at) for end in holds])
    away = points - points[0]
    hinges = np.array([end.compute_twists(at)[3:, 0] for end in holds if end.is_hinge]).reshape(
        -1, 3
    )
    direction = hinges[0] if len(hinges) else away[np.argmax((away * away).sum(axis=1))]
    size = float(np.linalg.norm(direction))
    if size < ALONE:
        return None
    direction = direction / size
    across = np.concatenate([away, hinges])
    across = across - (across @ direction)[:, None] * direction
    if (across * across).sum(axis=1).max() > ALONE**2:
        return None
    return points[0], direction * np.sign(direction[np.argmax(np.abs(direction) > ALONE)])


def _find_spin(system: Model, at: Screws, group: Group) -> Spin | None:
    """Find the spin of a group at one configuration; None where there is none."""
    line = _find_spin_line(at, group)
    if line is None:
        return None
    point, direction = line
    screw = np.concatenate([np.cross(point, direction), direction])
    edges = build_constraint_graph(system).edges
    velocity = np.zeros(system.nv)
    moving: list[tuple[End, list[Step]]] = []
    for end in group.ends:
        first = end.steps[0].edge
        of = edges[first].of
        steps = [*end.steps]
        if isinstance(of, Declared):
            left = at.compute_wrench_rows(first, of, system.dim) @ screw
        else:
            T = end.compute_twists(at)
            rates = Spectrum(T).solve_least_squares(screw, Level.GENERIC)
            left = T @ rates - screw
            rates[np.abs(rates) < ALONE * np.abs(rates).max()] = 0.0
            for step in end.steps:
                own, rates = np.split(rates, [len(step.columns)])
                velocity[[edges[step.edge].columns[c].index for c in step.columns]] = own
                if not own.any():
                    steps.remove(step)
        if np.abs(left).max(initial=0.0) > ALONE:
            return None
        if not end.free:
            moving.append((end, steps))
    return Spin(group, point, direction, velocity, moving)


# ---- the idle freedoms of a system


def find_idle_freedoms(
    system: Model, ranks: Sequence[Rank], driven: Iterable[int] | None = None
) -> tuple[IdleFreedom, ...]:
    """Find independent idle freedoms at the first of `ranks` that exist at all of them.

    `driven` are the velocities that are known to be driven, besides joints marked so; None where
    nothing is known.
    """
    spins = _find_spins(system, [r.screws for r in ranks], driven)
    found = [_make_idle_freedom(system, ranks[0], spin) for spin in spins]
    basis = np.zeros((system.nv, 0))
    out: list[IdleFreedom] = []
    # small groups of bodies first: larger ones may move as their sums
    for freedom in sorted((f for f in found if f is not None), key=lambda f: len(f.bodies)):
        scaled = freedom.velocity / ranks[0].units
        rest = scaled - basis @ (basis.T @ scaled)
        if np.linalg.norm(rest) > ALONE * np.linalg.norm(scaled):
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            out.append(freedom)
    return tuple(out)


def can_have_idle_freedom(system: Model, rank: Rank, driven: Iterable[int] | None = None) -> bool:
    """Return whether a spin exists at one configuration that may be an idle freedom."""
    return any(True for _ in _find_spins(system, [rank.screws], driven))


def _make_idle_freedom(system: Model, rank: Rank, spin: Spin) -> IdleFreedom | None:
    """Make the `IdleFreedom` of a spin; None where the spin moves a frame with a name."""
    s = build_constraint_graph(system)
    at = rank.screws
    part = find_surroundings(system).part
    bodies = {*np.flatnonzero(np.isin(part, [*spin.group.parts])).tolist()}
    links: dict[int, Array] = {}
    for end, moving in spin.moving:
        first = end.steps.index(moving[0])
        last = end.steps.index(moving[-1])
        for n, step in enumerate(end.steps[:last]):
            between = np.flatnonzero(part == step.beyond).tolist()
            if n < first:
                bodies.update(between)
            else:
                links |= {b: end.locate_point(at) for b in between}
    names = system.body_names
    poses = fk(system, rank.q)
    for frame in system._mechanism.frames.values():
        body = names.index(frame.body)
        if body in bodies or body in links:
            place = poses[body] @ frame.X_BF.evaluate_pose(system._mechanism.parameters)
            away = (place[:3, 3] - at.center) / at.length - links.get(body, spin.point)
            if body in bodies:
                away = away - (away @ spin.direction) * spin.direction
            if np.linalg.norm(away) > ALONE:
                return None
    places = sorted(
        (steps[0].edge, float(end.locate_point(at) @ spin.direction), end.of_child)
        for end, steps in spin.moving
    )
    # two joints name the axis: the first one, and that which is farthest from it
    farthest = max(places[1:], key=lambda place: abs(place[1] - places[0][1]))
    edges = sorted([places[0], farthest])
    origins = np.array([(at.M if of_child else at.F)[i, :3, 3] for i, _, of_child in edges])
    point = at.center + at.length * spin.point
    point = point + spin.direction * (spin.direction @ (origins[0] - point))
    ends = (origins - point) / at.length
    apart = abs(float((ends[1] - ends[0]) @ spin.direction))
    off = float(np.linalg.norm(np.cross(ends, spin.direction), axis=1).max())
    X = poses[min(bodies)]
    in_body = np.stack([point - X[:3, 3], spin.direction]) @ X[:3, :3]
    return IdleFreedom(
        tuple(names[b] for b in sorted(bodies)),
        (s.edges[edges[0][0]].name, s.edges[edges[1][0]].name),
        tuple((point.round(12) + 0.0).tolist()),
        tuple((spin.direction.round(12) + 0.0).tolist()),
        off < ALONE < apart,
        spin.velocity * rank.units,
        tuple(names[b] for b in sorted(links)),
        in_body,
    )
