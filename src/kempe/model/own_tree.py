"""The tree over which loops are solved: the one that is chosen where no joint is marked `cut`.

Marks say what `fk` and `closure_error` leave out. Where a search from far away ends depends on the equations that it
solves; so these do not follow the marks, and systems that differ by marks only have the same answers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from kempe.model.topology import spanning_tree

if TYPE_CHECKING:
    from kempe.model.system import System


def own_tree(system: System) -> System:
    """The system itself, or, where marks `cut` change its tree, the same without marks; coordinates are the same."""
    found = system._queries.get("own tree")
    if found is None:
        found = system
        if any(joint.cut for joint in system._mechanism.joints.values()):
            mechanism = system.mechanism
            mechanism.joints |= {name: replace(joint, cut=False) for name, joint in mechanism.joints.items()}
            tree = spanning_tree(mechanism)
            found = system if tree == system.topology else type(system)(mechanism, tree)
        system._queries["own tree"] = found
    return found
