"""Mechanisms rebuilt from their joint axes at one closed configuration: renamed, reordered, cut
elsewhere, moved.

At neutral coordinates the rebuilt mechanism stands where the original stands at q, so everything
that mobility says to first order must be the same, whatever is done to names, orders, cuts, the
ground, the unit and the handedness.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kempe import Mechanism, System
from kempe.poses import make_placement_from_pose

SWAPPABLE = {"revolute", "prismatic", "spherical", "cylindrical"}


@dataclass(frozen=True)
class Change:
    """What is done to a mechanism when it is rebuilt."""

    order: tuple[int, ...] = ()
    swap: frozenset[str] = frozenset()
    cut: str | None = None
    ground: str | None = None
    scale: float = 1.0
    mirror: bool = False
    move: np.ndarray = field(default_factory=lambda: np.eye(4))
    prefix: str = ""


def joint_frames(system: System, q: np.ndarray) -> dict[str, np.ndarray]:
    """Frame of each joint in the ground whose axes are those of its motion; for universal joints
    its cross.
    """
    pose = dict(zip(system.body_names, system.fk(q), strict=True))
    out = {}
    for joint in system.structure.joints.values():
        F = pose[joint.parent] @ joint.X_PF.evaluate_pose(system.structure.parameters)
        M = pose[joint.child] @ joint.X_CM.evaluate_pose(system.structure.parameters)
        K = np.eye(4)
        if joint.type.type_name == "universal":
            x = F[:3, 0]
            y = M[:3, 1]
            K[:3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
        else:
            K[:3, :3] = F[:3, :3]
        K[:3, 3] = M[:3, 3]
        out[joint.name] = K
    return out


def rebuilt(system: System, q: np.ndarray, change: Change) -> System:
    """The mechanism at q, changed."""
    ground = change.ground or system.body_names[0]
    name = (lambda n: f"{change.prefix}{n}") if change.prefix else (lambda n: n)
    m = Mechanism("rebuilt", system.dim, ground=name(ground))
    joints = list(system.structure.joints.values())
    order = change.order or tuple(range(len(joints)))
    rank = {j.child: order[k] for k, j in enumerate(joints)}
    for body in sorted(system.body_names, key=lambda b: rank.get(b, -1)):
        if body != ground:
            m.body(name(body))
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0]) if change.mirror else np.eye(4)
    frames = joint_frames(system, q)
    for k in np.argsort(order):
        joint = joints[k]
        K = change.move @ mirror @ frames[joint.name] @ mirror
        K[:3, 3] *= change.scale
        kind = joint.type.type_name
        ends = (name(joint.parent), name(joint.child))
        if joint.name in change.swap and kind in SWAPPABLE:
            ends = ends[::-1]
        where = {"at": make_placement_from_pose(K), "child_at": make_placement_from_pose(K)}
        if system.dim == 2:
            where = {"at": K[:2, 3], "child_at": K[:2, 3]}
            if kind == "prismatic":
                where["axis"] = K[:2, 2]
        m.joint(name(joint.name), kind, *ends, cut=joint.name == change.cut, **where)
    return m.build()
