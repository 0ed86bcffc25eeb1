"""The legs of a parallel mechanism: chains from the ground to a frame that share only the bodies at
their ends.

Where the frame's pose is given, the legs do not know of each other: it is reached if and only if
each leg reaches it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from kempe.model.kept import kept

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.system import System


@kept
def legs_of(system: System, frame: str) -> tuple[System, ...]:
    """The legs to a frame, each a system with that frame; none where the mechanism is not made of
    two legs or more.

    Bodies that hang on others only are left out. Constraints and couplings may tie legs: with these
    there are none.
    """
    m = system.mechanism
    ground = system.body_names[0]
    body = m.frames[frame].body if frame in m.frames else frame
    if m.constraints or m.couplings or system.structure.relations or body == ground:
        return ()
    out: list[System] = []
    for names in _between(m, ground, body):
        part = m.copy()
        part.joints = {n: m.joints[n] for n in names}
        part.postures = {}
        leg = type(system)(part.subchain(ground, frame))
        if leg.structure.closures or len(leg.joint_names) != len(names):
            return ()
        out.append(leg)
    return tuple(out) if len(out) > 1 else ()


def _between(m: Mechanism, ground: str, body: str) -> list[list[str]]:
    """Names of the joints of each part that lies between two bodies, without what hangs on it."""
    ends = {ground, body}
    free = dict(m.joints)
    parts: list[list[str]] = []
    while free:
        first = next(iter(free.values()))
        inside = {first.parent, first.child} - ends
        names = [first.name]
        del free[first.name]
        while more := [j for j in free.values() if {j.parent, j.child} & inside]:
            for j in more:
                inside |= {j.parent, j.child} - ends
                names.append(j.name)
                del free[j.name]
        parts.append(_trimmed(m, names, ends))
    return [
        names
        for names in parts
        if ends <= {b for n in names for b in (m.joints[n].parent, m.joints[n].child)}
    ]


def _trimmed(m: Mechanism, names: list[str], ends: set[str]) -> list[str]:
    """The joints without those that lead to a body on which no other joint is."""
    while True:
        bodies = [b for n in names for b in (m.joints[n].parent, m.joints[n].child)]
        loose = {b for b in bodies if bodies.count(b) == 1} - ends
        if not loose:
            return names
        names = [n for n in names if not {m.joints[n].parent, m.joints[n].child} & loose]
