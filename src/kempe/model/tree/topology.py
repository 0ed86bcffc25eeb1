"""Graph -> forest: which joints carry the spanning tree, which close loops, and how bodies are numbered.

Required of the result, and tested: it depends on names and structure only, never on the order of declaration; the
user's joint directions are kept (a tree joint may be walked from its child to its parent); fixed, actuated and
coupled joints stay in the tree where they can; among the others, joints with many freedoms are cut first, then those
far from the ground, which keeps the tree shallow; a joint marked `cut` is left out if any other choice exists.
"""

from __future__ import annotations

import heapq
import re
from collections import deque
from dataclasses import dataclass
from typing import Any

from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.errors import DescriptionError, Fault


@dataclass(frozen=True)
class Topology:
    """The spanning tree of a mechanism.

    `bodies` are names in their numbering, the ground first. For body i > 0, `parent[i - 1]` is the number of its
    parent (the lecture's vector C), `parent_joints[i - 1]` the joint between them, and `reversed_[i - 1]` says
    that the tree walks this joint from its child to its parent. `closures` are the joints left out.
    """

    bodies: tuple[str, ...]
    parent: tuple[int, ...]
    parent_joints: tuple[str, ...]
    reversed_: tuple[bool, ...]
    closures: tuple[str, ...]


def natural(name: str) -> tuple[Any, ...]:
    """Sort key by which 'J2' comes before 'J10'."""
    parts = ((p, p.lstrip("0")) for p in re.split(r"(\d+)", name) if p)
    return tuple((0, len(d), d) if p.isdecimal() else (1, 0, p) for p, d in parts) + ((-1, 0, name),)


def spanning_tree(mechanism: Mechanism) -> Topology:
    """Spanning tree and loop closures of a mechanism. Errors: `DescriptionError` naming bodies without a way to it."""
    ground = mechanism.ground.name
    neighbours: dict[str, list[tuple[str, Joint]]] = {b: [] for b in mechanism.bodies}
    for joint in mechanism.joints.values():
        neighbours[joint.parent].append((joint.child, joint))
        neighbours[joint.child].append((joint.parent, joint))
    level = _levels(mechanism, ground, neighbours)
    _refuse_detached(mechanism, level)
    kept = _kruskal(mechanism, level)
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


def _levels(mechanism: Mechanism, ground: str, neighbours: dict[str, list[tuple[str, Joint]]]) -> dict[str, int]:
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
        names = ", ".join(repr(b.name) for b in detached[:8]) + (", ..." if len(detached) > 8 else "")
        raise DescriptionError(
            Fault(
                f"no joints lead from {mechanism.ground.name!r} to {names}", f"mechanism {mechanism.name!r}",
                detached[0].where, "a free body needs a 'free' joint; a particle can hold no body",
            )
        )  # fmt: skip


def _kruskal(mechanism: Mechanism, level: dict[str, int]) -> set[str]:
    """Names of the tree's joints: the spanning tree of least cost, ties broken by name (Kruskal, 1956)."""
    coupled = {c if c in mechanism.joints else c.rpartition(".")[0]
               for k in mechanism.couplings.values() for c in (k.of, *k.sources)}  # fmt: skip

    def cost(joint: Joint) -> tuple[Any, ...]:
        dof = joint.type.dof(mechanism.dim, mechanism.bodies[joint.child].particle)
        wish = 0 if joint.actuated or joint.name in coupled else 1 if joint.actuated is None else 2
        return joint.cut, dof > 0, wish, dof, level[joint.parent] + level[joint.child], natural(joint.name)

    root = {b: b for b in mechanism.bodies}

    def find(body: str) -> str:
        while root[body] != body:
            root[body] = body = root[root[body]]
        return body

    kept: set[str] = set()
    ends: set[str] = set()  # particles have no orientation: no branch goes on from them
    joints = list(mechanism.joints.values())
    if len(joints) >= len(root):  # a tree needs no choice
        joints.sort(key=cost)
    for joint in joints:
        a, b = find(joint.parent), find(joint.child)
        if a != b and joint.child not in ends:
            root[a] = b
            kept.add(joint.name)
            if mechanism.bodies[joint.child].particle:
                ends.add(joint.child)
    return kept


def _number(mechanism: Mechanism, came: dict[str, tuple[str, Joint]]) -> list[str]:
    """Bodies in the order of declaration, except that a child waits for its parent."""
    names = list(mechanism.bodies)
    declared = {b: i for i, b in enumerate(names)}
    children: dict[str, list[str]] = {b: [] for b in names}
    for child, (parent, _) in came.items():
        children[parent].append(child)
    ready, order = [declared[mechanism.ground.name]], list[str]()
    while ready:
        body = names[heapq.heappop(ready)]
        order.append(body)
        for child in children[body]:
            heapq.heappush(ready, declared[child])
    return order
