"""Spanning trees of mechanisms: tree joints, cut joints, and numbers of bodies.

The loops that the cut joints close are short.
"""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.errors import DescriptionError, Fault
from kempe.model.structural_order import order_joints

# ---- spanning trees with short loops

# A spanning tree of least total loop length is NP-hard to find (Deo, Prabhu and Krishnamoorthy,
# 1982). The heuristic here reduces the graph to branches between bodies where loops meet, keeps the
# branches that lie on many short loops (a shortest loop through every branch, as in Horton, 1987),
# and then exchanges branches of the tree for branches that it left out while this shortens the
# loops (Amaldi, Liberti, Maculan and Maffioli, 2009). It is exact for chains of loops, ladders and
# trusses.
#
# The result depends on the graph and on the order of preference only, not on how bodies and joints
# are numbered.

REACH = 400
"""Bodies at most that the search for a shortest loop through a branch looks at: others count as on
no short loop."""
EXCHANGES = 400
"""Work for exchanges, in loops that are looked at for each branch: it makes the whole search linear
in the size."""

FEW = 200
"""Branches up to which the search begins at the preferred tree, too."""


class Branch(NamedTuple):
    """A chain of joints between two bodies where loops meet.

    A tree leaves out one joint of a branch, or none.
    """

    ends: tuple[int, int]
    members: tuple[int, ...]
    worst: int
    """The member that is left out before the others."""

    def get_other_end(self, body: int) -> int:
        """Return the end of the branch that is not `body`."""
        return self.ends[1] if self.ends[0] == body else self.ends[0]


def find_left_out_edges(
    ends: Sequence[tuple[int, int]], grade: Sequence[Any], order: Sequence[int]
) -> set[int]:
    """Find the edges that a spanning tree with short loops leaves out.

    Parameters
    ----------
    ends
        For each edge the two bodies that it joins; several edges may join the same two.
    grade
        For each edge its grade: of each loop an edge of the highest grade is left out, however long
        loops become.
    order
        For each edge its place in the order of preference, each another number: among choices with
        loops of the same total length, edges that come late are left out.
    """
    branches, out = _find_branches(ends, grade, order)
    if branches:
        # from here on a branch's number is its preference
        branches.sort(key=lambda b: order[b.worst])
        out |= _Search(branches, [grade[b.worst] for b in branches]).find_left_out_edges()
    return out


def _find_branches(
    ends: Sequence[tuple[int, int]], grade: Sequence[Any], order: Sequence[int]
) -> tuple[list[Branch], set[int]]:
    """Find the branches of the graph, and the edges to leave out of rings.

    These rings are attached to the rest by one body at most.
    """
    at: dict[int, list[int]] = defaultdict(list)
    for edge, (a, b) in enumerate(ends):
        at[a].append(edge)
        at[b].append(edge)
    degree = {body: len(edges) for body, edges in at.items()}
    gone = [False] * len(ends)
    leaves = [body for body, count in degree.items() if count == 1]
    while leaves:
        for edge in at[leaves.pop()]:
            if not gone[edge]:
                gone[edge] = True
                for body in ends[edge]:
                    degree[body] -= 1
                    if degree[body] == 1:
                        leaves.append(body)
    used = list(gone)
    branches = list[Branch]()
    out = set[int]()
    meeting = [body for body, count in degree.items() if count > 2]
    for body in (*meeting, *degree):  # then rings without a body where loops meet
        for first in at[body]:
            if used[first]:
                continue
            members = list[int]()
            here = body
            edge = first
            while True:
                used[edge] = True
                members.append(edge)
                a, b = ends[edge]
                here = b if here == a else a
                if here == body or degree[here] > 2:
                    break
                edge = next(e for e in at[here] if not used[e])
            worst = max(members, key=lambda e: (grade[e], order[e]))
            if here == body:
                out.add(worst)
            else:
                branches.append(Branch((body, here), tuple(members), worst))
    return branches, out


class _Search:
    """A tree of branches that is improved by exchanges.

    Branches come in the order of preference: those to keep come first.
    """

    def __init__(self, branches: list[Branch], grade: list[Any]):
        self.branches = branches
        self.grade = grade
        self.length = [len(b.members) for b in branches]
        self.at: dict[int, list[int]] = defaultdict(list)
        for k, branch in enumerate(branches):
            for body in branch.ends:
                self.at[body].append(k)

    def find_left_out_edges(self) -> set[int]:
        """Return the edges that the best tree found leaves out."""
        use = self._count_short_loops()
        every = range(len(self.branches))
        found = [
            self._improve_tree(
                self._find_cheapest_tree(
                    [(self.grade[k], -use[k], self.length[k], k) for k in every]
                )
            )
        ]
        if len(self.branches) <= FEW:
            found.append(
                self._improve_tree(self._find_cheapest_tree([(self.grade[k], k) for k in every]))
            )
        _, cut = min(found)
        return {self.branches[k].worst for k in cut}

    def _count_short_loops(self) -> list[int]:
        """Count, for each branch, the shortest loops through some branch that it lies on."""
        loops = {loop for k in range(len(self.branches)) if (loop := self._find_shortest_loop(k))}
        use = [0] * len(self.branches)
        for loop in loops:
            for k in loop:
                use[k] += 1
        return use

    def _find_shortest_loop(self, k: int) -> frozenset[int]:
        """Find the branches of a shortest loop through branch k (Dijkstra, 1959).

        The set is empty where there is no loop within `REACH`.
        """
        # an end that numbers do not choose
        start, goal = sorted(self.branches[k].ends, key=lambda body: self.at[body])
        came: dict[int, int] = {}
        front = [(0, k, start)]
        while front and len(came) < REACH:
            far, by, here = heapq.heappop(front)
            if here in came:
                continue
            came[here] = by
            if here == goal:
                loop = {k}
                while here != start:
                    loop.add(came[here])
                    here = self.branches[came[here]].get_other_end(here)
                return frozenset(loop)
            for j in self.at[here]:
                there = self.branches[j].get_other_end(here)
                if j != k and there not in came:
                    heapq.heappush(front, (far + self.length[j], j, there))
        return frozenset()

    def _find_cheapest_tree(self, cost: list[Any]) -> list[int]:
        """Find the branches of the spanning tree of least cost (Kruskal, 1956)."""
        root: dict[int, int] = {}

        def find_root(body: int) -> int:
            """Return the body that stands for the connected part of a body."""
            while (up := root.get(body, body)) != body:
                root[body] = body = root.get(up, up)
            return body

        kept: list[int] = []
        for k in sorted(range(len(self.branches)), key=cost.__getitem__):
            a, b = (find_root(body) for body in self.branches[k].ends)
            if a != b:
                root[a] = b
                kept.append(k)
        return kept

    def _find_loops(self, kept: list[int]) -> dict[int, set[int]]:
        """Find, for each branch that is left out, the branches of the tree that close its loop."""
        ways: dict[int, list[int]] = defaultdict(list)
        for k in kept:
            for body in self.branches[k].ends:
                ways[body].append(k)
        up: dict[int, tuple[int, int, int]] = {}
        for base in self.at:
            if base in up:
                continue
            up[base] = (0, -1, base)
            stack = [base]
            while stack:
                here = stack.pop()
                for k in ways[here]:
                    there = self.branches[k].get_other_end(here)
                    if there not in up:
                        up[there] = (up[here][0] + 1, k, here)
                        stack.append(there)
        loops: dict[int, set[int]] = {}
        for k in sorted(set(range(len(self.branches))) - set(kept)):
            a, b = self.branches[k].ends
            loops[k] = set()
            while a != b:
                if up[a][0] < up[b][0]:
                    a, b = b, a
                loops[k].add(up[a][1])
                a = up[a][2]
        return loops

    def _improve_tree(self, kept: list[int]) -> tuple[int, list[int]]:
        """Exchange branches while this shortens the loops.

        Returned are the total length of the loops, and the branches left out.

        Branch e comes in for f of its loop. Each other loop through f then goes round the rest of
        e's loop: it becomes longer by the length of e's loop less twice what the two share.
        Exchanges of the same length are made where the branch that comes in is preferred.
        """
        loops = self._find_loops(kept)
        through: dict[int, set[int]] = defaultdict(set)
        for e, loop in loops.items():
            for f in loop:
                through[f].add(e)
        size = {e: self.length[e] + sum(self.length[f] for f in loop) for e, loop in loops.items()}
        work = EXCHANGES * len(self.branches)
        better = True
        while better and work > 0:
            better = False
            for e in sorted(loops):
                if work <= 0:
                    break
                shared: dict[int, int] = defaultdict(int)
                for f in loops[e]:
                    work -= len(through[f])
                    for g in through[f]:
                        shared[g] += self.length[f]
                gains = [
                    (sum(size[e] - 2 * shared[g] for g in through[f] if g != e), -f)
                    for f in loops[e]
                    if self.grade[f] == self.grade[e]
                ]
                if gains and min(gains) < (0, -e):
                    self._exchange_branches(e, -min(gains)[1], loops, through, size)
                    better = True
        return sum(size.values()), sorted(loops)

    def _exchange_branches(
        self,
        e: int,
        f: int,
        loops: dict[int, set[int]],
        through: dict[int, set[int]],
        size: dict[int, int],
    ) -> None:
        """Take branch e into the tree and leave out f, which is on its loop."""
        own = loops.pop(e)
        for k in own:
            through[k].discard(e)
        own ^= {e, f}
        for g in through.pop(f, set[int]()):
            loop = loops[g]
            loop.discard(f)
            for k in own:
                if k in loop:
                    loop.discard(k)
                    through[k].discard(g)
                else:
                    loop.add(k)
                    through[k].add(g)
            size[g] = self.length[g] + sum(self.length[k] for k in loop)
        loops[f] = own
        size[f] = size.pop(e)
        for k in own:
            through[k].add(f)


# ---- the tree of a mechanism

# Required of the result, and tested: the user's joint directions are kept (a tree joint may be
# walked from its child to its parent); a joint marked `cut` is left out if any other choice exists;
# fixed, actuated and coupled joints stay in the tree where they can; among the choices that remain
# the loops that the cut joints close are short. Between choices with loops of the same total
# length, joints of the least wanted kind are cut: passive ones, those with many freedoms, those far
# from the ground, those that are a second way into their child. What is alike in all this is
# ordered by structure, then by placements, then by limits, and by names last; the order of
# declaration decides nothing.


@dataclass(frozen=True)
class Topology:
    """The spanning tree of a mechanism.

    `bodies` are names in their numbering, the ground first. For body i > 0, `parent[i - 1]` is the
    number of its parent (the lecture's vector C), `parent_joints[i - 1]` the joint between them,
    and `reversed_[i - 1]` says that the tree walks this joint from its child to its parent.
    `closures` are the joints left out.
    """

    bodies: tuple[str, ...]
    parent: tuple[int, ...]
    parent_joints: tuple[str, ...]
    reversed_: tuple[bool, ...]
    closures: tuple[str, ...]


def find_spanning_tree(mechanism: Mechanism) -> Topology:
    """Find the spanning tree and the loop closures of a mechanism.

    Errors: `DescriptionError`, with bodies that no joint connects.
    """
    ground = mechanism.ground.name
    neighbours: dict[str, list[tuple[str, Joint]]] = {b: [] for b in mechanism.bodies}
    for joint in mechanism.joints.values():
        neighbours[joint.parent].append((joint.child, joint))
        neighbours[joint.child].append((joint.parent, joint))
    level = _compute_levels(mechanism, ground, neighbours)
    _refuse_detached(mechanism, level)
    kept = _choose_tree_joints(mechanism, level)
    came: dict[str, tuple[str, Joint]] = {}
    queue = deque([ground])
    while queue:
        here = queue.popleft()
        for there, joint in neighbours[here]:
            if joint.name in kept and there != ground and there not in came:
                came[there] = (here, joint)
                queue.append(there)
    order = _number_bodies(mechanism, came)
    index = {b: i for i, b in enumerate(order)}
    moving = order[1:]
    return Topology(
        tuple(order),
        tuple(index[came[b][0]] for b in moving),
        tuple(came[b][1].name for b in moving),
        tuple(came[b][1].child != b for b in moving),
        tuple(n for n in mechanism.joints if n not in kept),
    )


def _compute_levels(
    mechanism: Mechanism, ground: str, neighbours: dict[str, list[tuple[str, Joint]]]
) -> dict[str, int]:
    """Compute the number of joints on a shortest way from the ground to each body."""
    level = {ground: 0}
    queue = deque([ground])
    while queue:
        here = queue.popleft()
        for there, _ in neighbours[here]:
            if there not in level:
                level[there] = level[here] + 1
                if not mechanism.bodies[there].particle:  # nothing can hang on a particle
                    queue.append(there)
    return level


def _refuse_detached(mechanism: Mechanism, level: dict[str, int]) -> None:
    """Refuse bodies that no joints connect to the ground. Errors: `DescriptionError`."""
    detached = [b for b in mechanism.bodies.values() if b.name not in level]
    if detached:
        names = ", ".join(repr(b.name) for b in detached[:8]) + (
            ", ..." if len(detached) > 8 else ""
        )
        raise DescriptionError(
            Fault(
                f"no joints lead from {mechanism.ground.name!r} to {names}",
                f"mechanism {mechanism.name!r}",
                detached[0].where,
                "a free body needs a 'free' joint; a particle can hold no body",
            )
        )


def _choose_tree_joints(mechanism: Mechanism, level: dict[str, int]) -> set[str]:
    """Choose the names of the joints of the tree."""
    joints = mechanism.joints
    if len(joints) < len(mechanism.bodies):  # a tree needs no choice
        return set(joints)
    coupled = {
        c if c in joints else c.rpartition(".")[0]
        for k in mechanism.couplings.values()
        for c in (k.of, *k.sources)
    }
    ways_in = Counter(j.child for j in joints.values())
    grade: dict[str, tuple[Any, ...]] = {}
    first: dict[str, tuple[Any, ...]] = {}
    for name, joint in joints.items():
        dof = joint.type.dof(mechanism.dim, mechanism.bodies[joint.child].particle)
        wish = 0 if joint.actuated or name in coupled else 1 if joint.actuated is None else 2
        grade[name] = joint.cut, dof > 0, wish > 0
        second_way_in = joint.child == mechanism.ground.name or ways_in[joint.child] > 1
        first[name] = (
            *grade[name],
            wish,
            dof,
            level[joint.parent] + level[joint.child],
            second_way_in,
        )
    order = order_joints(mechanism, level, first)
    number = {b: k for k, b in enumerate(mechanism.bodies)}
    names = [n for n, j in joints.items() if not mechanism.bodies[j.child].particle]
    out = find_left_out_edges(
        [(number[joints[n].parent], number[joints[n].child]) for n in names],
        [grade[n] for n in names],
        [order[n] for n in names],
    )
    kept = set(names) - {names[k] for k in out}
    held: dict[
        str, str
    ] = {}  # particles have no orientation: one joint holds each, and no branch goes on from it
    for name in sorted(set(joints) - set(names), key=lambda n: (grade[n], order[n])):
        held.setdefault(joints[name].child, name)
    return kept | set(held.values())


def _number_bodies(mechanism: Mechanism, came: dict[str, tuple[str, Joint]]) -> list[str]:
    """List the bodies in the order of declaration, each one after its parent."""
    names = list(mechanism.bodies)
    declared = {b: i for i, b in enumerate(names)}
    children: dict[str, list[str]] = {b: [] for b in names}
    for child, (parent, _) in came.items():
        children[parent].append(child)
    ready = [declared[mechanism.ground.name]]
    order = list[str]()
    while ready:
        body = names[heapq.heappop(ready)]
        order.append(body)
        for child in children[body]:
            heapq.heappush(ready, declared[child])
    return order
