"""Graph -> forest: which joints carry the spanning tree, which close loops, and how bodies are
numbered.

Required of the result, and tested: the user's joint directions are kept (a tree joint may be walked
from its child to its parent); a joint marked `cut` is left out if any other choice exists; fixed,
actuated and coupled joints stay in the tree where they can; among the choices that remain the loops
that the cut joints close are short. Between choices with loops of the same total length, joints of
the least wanted kind are cut: passive ones, those with many freedoms, those far from the ground,
those that are a second way into their child. What is alike in all this is ordered by structure,
then by placements, then by limits, and by names last; the order of declaration decides nothing.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from dataclasses import dataclass
from typing import Any

from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.errors import DescriptionError, Fault
from kempe.model.tree.short_loops import edges_left_out
from kempe.model.tree.structural_order import structural_order


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


def spanning_tree(mechanism: Mechanism) -> Topology:
    """Spanning tree and loop closures of a mechanism. Errors: `DescriptionError` naming bodies
    without a way to it.
    """
    ground = mechanism.ground.name
    neighbours: dict[str, list[tuple[str, Joint]]] = {b: [] for b in mechanism.bodies}
    for joint in mechanism.joints.values():
        neighbours[joint.parent].append((joint.child, joint))
        neighbours[joint.child].append((joint.parent, joint))
    level = _levels(mechanism, ground, neighbours)
    _refuse_detached(mechanism, level)
    kept = _kept(mechanism, level)
    came: dict[str, tuple[str, Joint]] = {}
    queue = deque([ground])
    while queue:
        here = queue.popleft()
        for there, joint in neighbours[here]:
            if joint.name in kept and there != ground and there not in came:
                came[there] = (here, joint)
                queue.append(there)
    order = _number(mechanism, came)
    index = {b: i for i, b in enumerate(order)}
    moving = order[1:]
    return Topology(
        tuple(order),
        tuple(index[came[b][0]] for b in moving),
        tuple(came[b][1].name for b in moving),
        tuple(came[b][1].child != b for b in moving),
        tuple(n for n in mechanism.joints if n not in kept),
    )


def _levels(
    mechanism: Mechanism, ground: str, neighbours: dict[str, list[tuple[str, Joint]]]
) -> dict[str, int]:
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


def _kept(mechanism: Mechanism, level: dict[str, int]) -> set[str]:
    """Names of the tree's joints."""
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
    order = structural_order(mechanism, level, first)
    number = {b: k for k, b in enumerate(mechanism.bodies)}
    names = [n for n, j in joints.items() if not mechanism.bodies[j.child].particle]
    out = edges_left_out(
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


def _number(mechanism: Mechanism, came: dict[str, tuple[str, Joint]]) -> list[str]:
    """Bodies in the order of declaration, except that a child waits for its parent."""
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
