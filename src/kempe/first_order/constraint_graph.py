"""The constraint graph: joints and constraints as edges, with loops and clusters of loops.

It does not depend on the configuration. Loops and laws that share velocities, directly or through
others, form a cluster. Each cluster has its own rank, redundancy and freedoms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.description.parts import Declared, Joint
from kempe.equations.closure_rows import pack_full_loops
from kempe.joints import P, Primitive, Q
from kempe.model.constraint_program import Tie
from kempe.model.coordinates import Relation
from kempe.model.model import keep_answers
from kempe.model.packed_loops import PackedLoops
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- shorter loops

# Singular values and bounds of a mechanism of many loops are read from short loops.
#
# Loops that a spanning tree closes may be long, however small the cells are. Any of them may be
# replaced by its sum with another one that is closed by a whole joint: the equations stay
# equivalent (Kirchhoff, 1847).

MOST = 400
"""Loops of a cluster up to which shorter ones are sought."""


def shorten_loops(signs: Array, whole: np.ndarray, parent: np.ndarray, child: np.ndarray) -> Array:
    """Shorten loops, given as signs (loops, edges), by adding loops of the mask `whole`.

    One pass is made.

    `parent` and `child` are the bodies of the edges. Each loop stays a simple one, and keeps the
    edge that closes it.
    """
    if not 1 < len(signs) <= MOST:
        return signs
    out = signs.copy()
    length = np.abs(signs).sum(axis=1)
    for k in np.argsort(-length, kind="stable"):  # the longest first: the others are as they were
        while True:
            shared = signs @ out[k]
            gain = np.where(whole, 2.0 * np.abs(shared) - length, 0.0)
            gain[k] = 0.0
            best = int(np.argmax(gain))
            shorter = out[k] - np.sign(shared[best]) * signs[best]
            shrinks = np.abs(shorter).sum() < np.abs(out[k]).sum()
            if (
                gain[best] <= 0.0
                or not shrinks
                or not _is_simple_loop(shorter, parent, child)
                or length[best] > length[k]
            ):
                break
            # of two alike only one is replaced by the other
            if length[best] == length[k] and best > k:
                break
            out[k] = shorter
    return out


def _is_simple_loop(loop: Array, parent: np.ndarray, child: np.ndarray) -> bool:
    """Return whether edges with signs 1, 0, -1 form one closed walk that visits no body twice."""
    edges = np.flatnonzero(loop)
    if np.abs(loop[edges]).max() > 1.0:
        return False
    ahead = loop[edges] > 0.0
    start = np.where(ahead, parent[edges], child[edges])
    end = np.where(ahead, child[edges], parent[edges])
    after = dict(zip(start.tolist(), end.tolist(), strict=True))
    if len(after) < len(edges):
        return False
    body = int(start[0])
    steps = 0
    while steps < len(edges) and body in after:
        body = after[body]
        steps = steps + 1
        if body == int(start[0]):
            break
    return steps == len(edges)


# ---- edges, laws, loops and clusters

Signed = list[tuple[int, float]]
"""Edges with the signs in which they are passed."""
Way = Callable[[int, int], tuple[Signed, Signed]]
"""The function of `_make_path_finder`."""

NO_SERIES = "is a Python function that cannot be recorded, and has no Taylor series"


@dataclass(frozen=True, slots=True)
class Column:
    """One velocity of a joint: name, index among the system's velocities, multiplier and kind.

    `index` is -1 where the velocity is held; `slides` says whether it is a translation.
    """

    name: str
    index: int
    multiplier: float
    slides: bool


@dataclass(frozen=True, eq=False)
class Edge:
    """A joint or declared constraint as an edge of the graph: two bodies and a frame on each.

    Bodies are given by number.

    `columns` are its velocities, all of them, those that follow others or are held too.
    """

    name: str
    of: Joint | Declared
    parent: int
    child: int
    X_PF: Array
    X_CM: Array
    particle: bool
    primitives: tuple[Primitive, ...] = ()
    values: tuple[tuple[int, float, float], ...] = ()
    """For each coordinate of the joint its index in q (-1: none), multiplier and offset."""
    columns: tuple[Column, ...] = ()
    drives: tuple[int, ...] = ()
    """For each primitive the column that moves it (a quaternion: the first of three)."""

    @property
    def is_joint(self) -> bool:
        """Whether the edge is a joint, not a declared constraint."""
        return isinstance(self.of, Joint)

    @property
    def actuated(self) -> bool:
        """Whether a motor drives the joint."""
        return isinstance(self.of, Joint) and self.of.actuated is True


@dataclass(frozen=True, eq=False)
class Law:
    """Equations that belong to no loop: a coupling with several sources, or a written constraint.

    `support` are the velocities that it depends on, `places` those of its rows among all equations
    in full form.
    """

    name: str
    of: Relation | Declared
    support: tuple[int, ...]
    places: list[int]
    names: tuple[str, ...]
    linear: bool
    """Whether its equations are linear in coordinates."""
    edges: tuple[int, ...] = ()
    """The joints on the tree's way between its bodies, where it has two."""

    @property
    def n_rows(self) -> int:
        """Number of equations of the law."""
        return len(self.places)

    @property
    def title(self) -> str:
        """Name of the law in reports."""
        return f"coupling of {self.name}" if isinstance(self.of, Relation) else self.name


@dataclass(frozen=True, eq=False)
class Loop:
    """One closed loop: the edge that closes the loop, and all edges with their signs."""

    edge: int
    path: tuple[tuple[int, float], ...]
    rows: int


class LoopSizes(NamedTuple):
    """Sizes of the loops of a cluster, from which bounds of singular values follow.

    `most` is the largest sum of squares of the multipliers around a loop, times the square root of
    the largest number of loops that share a joint; `joints` counts the joints of the longest loop;
    `rods` are the edges that are rods.
    """

    most: float
    joints: int
    rods: np.ndarray


@dataclass(frozen=True, eq=False)
class Cluster:
    """Loops and laws that share velocities, directly or through others.

    `velocities` are the indices of their velocities.
    """

    loops: tuple[int, ...]
    laws: tuple[int, ...]
    velocities: np.ndarray
    edges: tuple[int, ...]
    signs: Array = field(repr=False)
    """(loops, edges): +1, -1 or 0, how each loop passes each edge."""
    cells: Array = field(repr=False)
    """The same for loops that are shortened by others."""
    moving: np.ndarray = field(repr=False)
    """Of all velocities of the edges, one edge after the other, those that are not held (mask)."""
    owner: np.ndarray = field(repr=False)
    """For each moving velocity, its edge (index into `edges`)."""
    local: np.ndarray = field(repr=False)
    """For each moving velocity, the velocity of the system that it follows (index into
    `velocities`)."""
    factor: Array = field(repr=False)
    """For each moving velocity, the factor by which it follows that."""
    sliding: np.ndarray = field(repr=False)
    """Whether each moving velocity is a slide."""
    bent: tuple[str, ...] = ()
    """Laws that are not linear in coordinates."""

    def list_loop_paths(self, s: ConstraintGraph, short: bool) -> list[np.ndarray]:
        """List the edges of each loop: shortened loops, or loops as the spanning tree closes them."""
        if short:
            edges = np.array(self.edges)
            return [edges[np.flatnonzero(signs)] for signs in self.cells]
        return [np.array([i for i, _ in s.loops[k].path]) for k in self.loops]

    def measure_loops(self, s: ConstraintGraph, short: bool) -> LoopSizes:
        """Return the `LoopSizes` of the cluster, computed once."""
        found = self.__dict__.setdefault("sizes", {})
        if short not in found:
            found[short] = self._compute_loop_sizes(s, self.list_loop_paths(s, short))
        return found[short]

    def _compute_loop_sizes(self, s: ConstraintGraph, paths: list[np.ndarray]) -> LoopSizes:
        """Compute the `LoopSizes` of loops with the given paths."""
        most = 0.0
        joints = 1
        rods: list[int] = []
        for k, path in zip(self.loops, paths, strict=True):
            moving = [c for i in path for c in s.edges[int(i)].columns if c.index >= 0]
            own = len({c.index for c in moving}) == len(moving)
            sizes = [abs(c.multiplier) for c in moving]
            most = max(most, sum(x * x for x in sizes) if own else sum(sizes) ** 2)
            joints = max(joints, len(path))
            edge = s.edges[s.loops[k].edge]
            if isinstance(edge.of, Declared) and edge.of.rod:
                rods.append(s.loops[k].edge)
        passed = float(np.bincount(np.concatenate(paths)).max()) if paths else 1.0
        return LoopSizes(most * float(np.sqrt(passed)), joints, np.array(rods, dtype=np.int64))

    @cached_property
    def has_shared_velocities(self) -> bool:
        """Whether several joint velocities follow one velocity of the system."""
        return len(np.unique(self.local)) < len(self.local)


@dataclass(frozen=True, eq=False)
class ConstraintGraph:
    """Edges, loops, laws and clusters of a system, which do not depend on the configuration."""

    edges: tuple[Edge, ...]
    loops: tuple[Loop, ...]
    laws: tuple[Law, ...]
    clusters: tuple[Cluster, ...]
    parent: np.ndarray
    child: np.ndarray
    X_PF: Array
    X_CM: Array

    slides: np.ndarray
    """Which velocities (nv,) of the system are slides; screws count as turns."""


# ---- the graph of a system


@keep_answers
def build_constraint_graph(system: Model) -> ConstraintGraph:
    """Build the constraint graph of a system: edges, loops, laws and clusters."""
    return _assemble_graph(system)


def list_function_constraints(system: Model) -> tuple[str, ...]:
    """List the names of constraints that are Python functions without a Taylor series."""
    return tuple(
        dict.fromkeys(t.name for t in pack_full_loops(system, True).ties if t.function is not None)
    )


def _assemble_graph(system: Model) -> ConstraintGraph:
    """Assemble the constraint graph of a system."""
    edges = _build_edges(system)
    way = _make_path_finder(system, edges)
    loops = _build_loops(system, edges, way)
    laws = _build_laws(system, way)
    clusters = _build_clusters(system, edges, loops, laws)
    stack = np.array([(e.X_PF, e.X_CM) for e in edges]).reshape(-1, 2, 4, 4)
    ends = np.array([(e.parent, e.child) for e in edges], dtype=np.int64).reshape(-1, 2)
    slides = np.zeros(system.nv, dtype=bool)
    for column in (c for e in edges for c in e.columns):
        if column.index >= 0 and column.name == system.structure.velocity_names[column.index]:
            slides[column.index] = column.slides
    return ConstraintGraph(
        tuple(edges),
        tuple(loops),
        laws,
        clusters,
        ends[:, 0],
        ends[:, 1],
        stack[:, 0],
        stack[:, 1],
        slides,
    )


def _build_edges(system: Model) -> list[Edge]:
    """Build the edges: one for each joint, then one for each constraint between two bodies."""
    m = system._mechanism
    dim = system.dim
    number = {b: i for i, b in enumerate(system.body_names)}
    in_q = {n: i for i, n in enumerate(system.coordinate_names)}
    in_v = {n: i for i, n in enumerate(system.structure.velocity_names)}
    followers = system.structure.couplings
    out: list[Edge] = []
    for joint in m.joints.values():
        particle = m.bodies[joint.child].particle
        names, primitives = joint.type.layout(dim, particle)
        values: list[tuple[int, float, float]] = []
        columns: list[Column] = []
        for name in names:
            f = followers.get(_format_full_name(joint.name, name))
            if f is None:
                values.append((in_q[_format_full_name(joint.name, name)], 1.0, 0.0))
            else:
                values.append((in_q[f.source] if f.source else -1, f.multiplier, f.offset))
        velocities = joint.type.list_velocity_names(dim, particle)
        drives = tuple(
            velocities.index("wx" if p.kind == Q else names[p.coordinate]) for p in primitives
        )
        turning = {
            k + n
            for k, p in zip(drives, primitives, strict=True)
            if p.kind != P
            for n in range(3 if p.kind == Q else 1)
        }
        for k, name in enumerate(velocities):
            full = _format_full_name(joint.name, name)
            slides = k not in turning
            f = followers.get(full)
            if full in in_v:
                columns.append(Column(full, in_v[full], 1.0, slides))
            elif f is not None and f.source is not None:
                columns.append(Column(full, in_v[f.source], f.multiplier, slides))
            else:
                columns.append(Column(full, -1, 0.0, slides))
        X_PF = joint.X_PF.evaluate_pose(m.parameters)
        X_CM = joint.X_CM.evaluate_pose(m.parameters)
        out.append(
            Edge(
                joint.name,
                joint,
                number[joint.parent],
                number[joint.child],
                X_PF,
                X_CM,
                particle,
                primitives,
                tuple(values),
                tuple(columns),
                drives,
            )
        )
    for c in (c for c in m.constraints.values() if c.links):
        X_PF, X_CM = c.frames(m.parameters, dim)
        out.append(Edge(c.name, c, number[c.parent], number[c.child], X_PF, X_CM, False))
    return out


def _format_full_name(joint: str, coordinate: str) -> str:
    """Format the full name of a joint's coordinate."""
    return f"{joint}.{coordinate}" if coordinate else joint


def _make_path_finder(system: Model, edges: list[Edge]) -> Way:
    """Make the function that returns the tree's edges from two bodies to their common ancestor.

    Signs are those with which a loop from the first body to the second and back passes the edges.
    """
    index = {e.name: i for i, e in enumerate(edges)}
    up = [-1, *(index[n] for n in system.structure.parent_joints)]
    parent = (-1, *system.parent)
    depth = [0] * len(parent)
    for body in _sort_tree_bodies(parent):
        depth[body] = depth[parent[body]] + 1 if body else 0

    def find_tree_paths(a: int, b: int) -> tuple[Signed, Signed]:
        """Find the edges from body a, and from body b, to their common ancestor."""
        from_a: Signed = []
        from_b: Signed = []
        while a != b:
            if depth[b] >= depth[a]:
                from_b.append((up[b], 1.0 if edges[up[b]].parent == b else -1.0))
                b = parent[b]
            else:
                from_a.append((up[a], 1.0 if edges[up[a]].child == a else -1.0))
                a = parent[a]
        return from_a, from_b

    return find_tree_paths


def _build_loops(system: Model, edges: list[Edge], way: Way) -> list[Loop]:
    """Build the loops that cut joints and constraints close in the spanning tree."""
    index = {e.name: i for i, e in enumerate(edges)}
    closing = [index[n] for n in system.structure.closures] + [
        i for i, e in enumerate(edges) if not e.is_joint
    ]
    out: list[Loop] = []
    for k in closing:
        back, ahead = way(edges[k].parent, edges[k].child)
        # from the joint nearest to the ground, around and back
        path = (*reversed(back), (k, 1.0), *ahead)
        out.append(Loop(k, path, count_closing_equations(edges[k], system.dim)))
    return out


def _build_laws(system: Model, way: Way) -> tuple[Law, ...]:
    """Build the laws: couplings with several sources, and constraints written as expressions."""
    if not system.structure.relations and not system._mechanism.constraints:
        return ()  # to pack the loops takes longer than all else about the graph
    loops = pack_full_loops(system, True)
    first = 0
    found: dict[tuple[int, int], tuple[Relation | Declared, list[int], list[Tie]]] = {}
    order = {c.name: i for i, c in enumerate(system._mechanism.constraints.values())}
    for tie in loops.ties:
        places = list(range(first, first + len(tie.row_names)))
        first += len(tie.row_names)
        if tie.relation is not None:
            key = (0, system.structure.relations.index(tie.relation))
            of = tie.relation
        elif tie.user_written:
            key = (1, order[tie.name])
            of = system._mechanism.constraints[tie.name]
        else:
            continue
        _, own, ties = found.setdefault(key, (of, [], []))
        own += places
        ties.append(tie)
    number = {b: i for i, b in enumerate(system.body_names)}
    out: list[Law] = []
    for key in sorted(found):
        of, places, ties = found[key]
        between: Signed = []
        if isinstance(of, Declared) and of.parent:
            back, ahead = way(number[of.parent], number[of.child])
            between = back + ahead
        out.append(_build_law(loops, of, places, ties, tuple(i for i, _ in between)))
    return tuple(out)


def _build_law(
    loops: PackedLoops,
    of: Relation | Declared,
    places: list[int],
    ties: list[Tie],
    edges: tuple[int, ...],
) -> Law:
    """Build one law from its ties, the velocities it depends on, and whether it is linear."""
    support = {v for k, tie in enumerate(loops.ties) if tie in ties for v in loops.list_columns(k)}
    tapes = [t.tape for t in ties]
    linear = all(
        t.relation is not None
        or (r is not None and not r.pose_dependent and r.tape.is_linear_in(r.tape.inputs))
        for t, r in zip(ties, tapes, strict=True)
    )
    name = of.of if isinstance(of, Relation) else of.name
    return Law(
        name,
        of,
        tuple(sorted(support)),
        places,
        tuple(loops.names[i][1] for i in places),
        linear,
        edges,
    )


def _sort_tree_bodies(parent: tuple[int, ...]) -> list[int]:
    """Sort the bodies of the tree so that each comes after its parent."""
    children: dict[int, list[int]] = {}
    for body, above in enumerate(parent):
        children.setdefault(above, []).append(body)
    order = [0]
    for body in order:
        order += children.get(body, [])
    return order


def count_closing_equations(edge: Edge, dim: int) -> int:
    """Count the equations with which an edge closes a loop, its own velocities being unknowns."""
    if isinstance(edge.of, Declared):
        return edge.of.count_pose_equations(dim)
    return dim if edge.particle else (6 if dim == 3 else 3)


def _build_clusters(
    system: Model, edges: list[Edge], loops: list[Loop], laws: Sequence[Law]
) -> tuple[Cluster, ...]:
    """Group loops and laws that share velocities into clusters."""
    supports = [
        sorted({c.index for i, _ in loop.path for c in edges[i].columns if c.index >= 0})
        for loop in loops
    ]
    supports += [list(law.support) for law in laws]
    root = list(range(system.nv + len(supports)))

    def find_root(i: int) -> int:
        """Find the root of an element's set (union-find)."""
        while root[i] != i:
            root[i] = i = root[root[i]]
        return i

    for k, support in enumerate(supports):
        for i in support:
            root[find_root(i)] = find_root(system.nv + k)
    groups: dict[int, list[int]] = {}
    for k in range(len(supports)):
        groups.setdefault(find_root(system.nv + k), []).append(k)
    out: list[Cluster] = []
    for members in groups.values():
        own = [k for k in members if k < len(loops)]
        velocities = sorted({i for k in members for i in supports[k]})
        inside = sorted({i for k in own for i, _ in loops[k].path})
        place = {i: n for n, i in enumerate(inside)}
        signs = np.zeros((len(own), len(inside)))
        for n, k in enumerate(own):
            for i, sign in loops[k].path:
                signs[n, place[i]] = sign
        whole = np.array(
            [edges[loops[k].edge].is_joint and not edges[loops[k].edge].particle for k in own],
            dtype=bool,
        )
        ends = np.array(
            [(edges[i].parent, edges[i].child) for i in inside], dtype=np.int64
        ).reshape(-1, 2)
        cells = shorten_loops(signs, whole, ends[:, 0], ends[:, 1])
        laws_ = tuple(k - len(loops) for k in members if k >= len(loops))
        columns = [(n, c) for n, i in enumerate(inside) for c in edges[i].columns]
        moving = np.array([c.index >= 0 for _, c in columns], dtype=bool)
        at = {v: n for n, v in enumerate(velocities)}
        out.append(
            Cluster(
                tuple(own),
                laws_,
                np.array(velocities, dtype=np.int64),
                tuple(inside),
                signs,
                cells,
                moving,
                np.array([n for n, c in columns if c.index >= 0], dtype=np.int64),
                np.array([at[c.index] for _, c in columns if c.index >= 0], dtype=np.int64),
                np.array([c.multiplier for _, c in columns if c.index >= 0]),
                np.array([c.slides for _, c in columns if c.index >= 0], dtype=bool),
                tuple(laws[k].name for k in laws_ if not laws[k].linear),
            )
        )
    return tuple(out)
