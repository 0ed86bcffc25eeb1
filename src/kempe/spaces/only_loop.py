"""The only loop of a system: its bodies and joints in order, and the places of the joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kempe.joints import Primitive
from kempe.model.model import keep_answers
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.model import Model


@keep_answers
def find_only_loop(system: Model) -> tuple[tuple[str, ...], tuple[str, ...]] | str:
    """Find bodies and joints of the only loop in order, body k before joint k. Otherwise return the
    reason why there is none.
    """
    s = system.structure
    if len(s.closures) != 1:
        return "it has more than one loop" if s.closures else "it has no loop"
    if s.relations or s.couplings or system._mechanism.constraints:
        return "coordinates are tied by more than its loop"
    joints = s.joints
    parent = dict(zip(system.body_names[1:], system.parent, strict=True))
    up = dict(zip(system.body_names[1:], s.parent_joints, strict=True))

    def list_ancestors(body: str) -> list[str]:
        """List a body and its ancestors in the spanning tree."""
        out = [body]
        while out[-1] in parent:
            out.append(system.body_names[parent[out[-1]]])
        return out

    last = joints[s.closures[0]]
    a = list_ancestors(last.parent)
    b = list_ancestors(last.child)
    top = next(body for body in a if body in b)
    left = a[: a.index(top)]
    right = b[: b.index(top)]
    bodies = [top, *reversed(left), *right]
    names = [*(up[x] for x in reversed(left)), last.name, *(up[x] for x in right)]
    return tuple(bodies), tuple(names)


def list_primitives(system: Model, joint: Joint) -> list[Primitive]:
    """List the rotations and translations of a joint."""
    return list(joint.type.layout(system.dim, system._mechanism.bodies[joint.child].particle)[1])


def locate_joint(system: Model, joint: Joint, body: str) -> tuple[Array, Array]:
    """Locate a joint on one of its bodies: its point (3,) and its frame (4, 4)."""
    X = (joint.X_PF if joint.parent == body else joint.X_CM).evaluate_pose(
        system._mechanism.parameters
    )
    return X[:3, 3], X
