"""Who is joined to whom, for readers and writers of tree-shaped formats; without recursion, for any
size.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

from kempe.description.source import Findings
from kempe.description.urdf.xml import XmlElement


def choose_root(
    links: Mapping[str, XmlElement],
    ends: Mapping[str, tuple[str, str]],
    findings: Findings,
    root: str | None,
) -> str | None:
    """Name of the link that is the ground, or None after recording why there is none.

    `ends` are (parent, child) of each joint. The root is the only link that is nobody's child, or
    `root`. Links that no joint connects to it are a problem.
    """
    if not links:
        return None
    children = {child for _, child in ends.values()}
    roots = [root] if root is not None else [n for n in links if n not in children]
    parts = components(links, ends.values())
    if not roots:
        cycle = find_cycle(links, ends)
        shown = " -> ".join(map(repr, cycle))
        allowed = f"name the link that does not move, with root={cycle[0]!r}"
        message = f"no link is the root, since each is the child of a joint: {shown}"
        findings.add(message, "robot", links[cycle[0]].where, allowed)
        return None
    if len(roots) > 1:
        listed = _listed(roots, links)
        separate = len({parts[n] for n in roots}) > 1
        cure = (
            "join them by joints (type fixed where they do not move)"
            if separate
            else f"choose with root={roots[0]!r}"
        )
        findings.add(
            f"{len(roots)} links are nobody's child: {listed}",
            "robot",
            links[roots[1]].where,
            f"one link must be the root; {cure}",
        )
        return None
    detached = [n for n in links if parts[n] != parts[roots[0]]]
    if detached:
        message = f"no joints lead from the root {roots[0]!r} to {_listed(detached, links)}"
        findings.add(
            message, "robot", links[detached[0]].where, "join them by joints, or remove them"
        )
        return None
    return roots[0]


def _listed(names: list[str], links: Mapping[str, XmlElement]) -> str:
    shown = ", ".join(f"{n!r} (line {links[n].where.line})" for n in names[:8])
    return shown + (f", ... ({len(names)} in all)" if len(names) > 8 else "")


def components(bodies: Iterable[str], ends: Iterable[tuple[str, str]]) -> dict[str, int]:
    """For each body the number of the connected part that it belongs to."""
    neighbours: dict[str, list[str]] = {b: [] for b in bodies}
    for a, b in ends:
        neighbours[a].append(b)
        neighbours[b].append(a)
    part: dict[str, int] = {}
    for number, start in enumerate(neighbours):
        if start in part:
            continue
        part[start] = number
        queue = deque([start])
        while queue:
            for there in neighbours[queue.popleft()]:
                if there not in part:
                    part[there] = number
                    queue.append(there)
    return part


def find_cycle(bodies: Iterable[str], ends: Mapping[str, tuple[str, str]]) -> list[str]:
    """A cycle of bodies, its first repeated at the end, where every body is some joint's child."""
    parent: dict[str, str] = {}
    for a, b in ends.values():
        parent.setdefault(b, a)
    here = next(iter(bodies))
    seen: dict[str, None] = {}
    while here not in seen:
        seen[here] = None
        here = parent[here]
    path = list(seen)
    cycle = path[path.index(here) :][::-1]
    first = min(range(len(cycle)), key=lambda i: cycle[i])
    cycle = cycle[first:] + cycle[:first]
    return [*cycle, cycle[0]] if len(cycle) <= 10 else [*cycle[:9], "...", cycle[0]]


def reachable(start: str, ends: Iterable[tuple[str, str]]) -> set[str]:
    """The bodies that can be reached from `start`, walking joints from parent to child only."""
    children: dict[str, list[str]] = {}
    for a, b in ends:
        children.setdefault(a, []).append(b)
    reached = {start}
    queue = deque([start])
    while queue:
        for there in children.get(queue.popleft(), ()):
            if there not in reached:
                reached.add(there)
                queue.append(there)
    return reached
