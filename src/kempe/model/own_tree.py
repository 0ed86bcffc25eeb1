"""The tree over which loops are solved: the one that is chosen where no joint is marked `cut`.

Marks say what `fk` and `closure_error` leave out. Where a search from far away ends depends on the
equations that it solves; so these do not follow the marks, and systems that differ by marks only
have the same answers. One mark is more than that: where it keeps a joint in the tree that holds
nothing, a free one, it says that bodies are given by their own coordinates and those of the joints
between them follow.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from kempe.model.model import keep_answers
from kempe.model.topology import Topology, find_spanning_tree

if TYPE_CHECKING:
    from kempe.model.model import Model, SystemType


@keep_answers
def remove_cut_marks(system: SystemType) -> SystemType:
    """Return the system without marks `cut` where they change its tree, else the system itself.

    Its coordinates are the same.
    """
    if not any(joint.cut for joint in system._mechanism.joints.values()):
        return system
    mechanism = system.mechanism
    mechanism.joints |= {
        name: replace(joint, cut=False) for name, joint in mechanism.joints.items()
    }
    tree = find_spanning_tree(mechanism)
    return (
        system
        if tree == system.structure.topology or _has_kept_free_joint(system, tree)
        else type(system)(mechanism, tree)
    )


def _has_kept_free_joint(system: Model, tree: Topology) -> bool:
    """Tell whether the system's tree has a free joint that the other tree leaves out."""
    m = system._mechanism
    joints = (m.joints[name] for name in {*tree.closures} - {*system.structure.closures})
    return any(j.type.constraints(m.dim, m.bodies[j.child].particle) <= 0 for j in joints)
