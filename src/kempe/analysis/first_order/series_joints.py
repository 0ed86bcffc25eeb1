"""Joints in series: sets of joints any two of which part the mechanism, and what is between two of
them; and stars, groups of bodies that are held at more than two places.

Two joints of a loop are in series if cutting both parts the bodies. All that are in series with
each other stand in one order around every loop through them: a series, of which the part with the
ground is one piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.first_order.constraint_graph import ConstraintGraph, Edge, structure
from kempe.description.parts import Declared
from kempe.joints import P, Primitive, Q
from kempe.model.kept import kept

if TYPE_CHECKING:
    from kempe.model.system import System


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
def all_series(system: System, driven: frozenset[int]) -> tuple[SeriesLoop, ...]:
    """All series of at least two edges in which something can turn; `driven` are velocities that a
    motor holds.
    """
    return _all_series(system, structure(system), driven)


def _uses(system: System, s: ConstraintGraph) -> np.ndarray:
    """For each velocity by how many columns and laws it is used."""
    uses = np.bincount(
        [c.index for e in s.edges for c in e.columns if c.index >= 0], minlength=system.nv
    )
    for law in s.laws:
        uses[list(law.support)] += 1
    return uses


def _all_series(
    system: System, s: ConstraintGraph, driven: frozenset[int]
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


def stars(system: System, driven: frozenset[int]) -> tuple[Star, ...]:
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
    system: System,
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
    system: System,
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
def parts(system: System) -> np.ndarray:
    """For each body the number of its part: bodies that joints without a velocity hold together are
    one part.
    """
    found = np.arange(len(system.body_names))
    for edge in structure(system).edges:
        if rigid(edge):
            found[found == found[edge.child]] = found[edge.parent]
    return found


@kept
def in_loop(system: System) -> np.ndarray:
    """For each edge whether it is part of a loop (mask)."""
    s = structure(system)
    found = np.zeros(len(s.edges), dtype=bool)
    found[[i for c in s.clusters for i in c.edges]] = True
    return found


def edges_at(system: System, bodies: frozenset[int]) -> set[int]:
    """Numbers of the edges that some of these bodies are connected by."""
    found = _edges_of_bodies(system)
    return {i for body in bodies for i in found[body]}


@kept
def _edges_of_bodies(system: System) -> list[list[int]]:
    found: list[list[int]] = [[] for _ in system.body_names]
    for i, edge in enumerate(structure(system).edges):
        found[edge.parent].append(i)
        found[edge.child].append(i)
    return found


@kept
def between(system: System, i: int, k: int) -> frozenset[int]:
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
