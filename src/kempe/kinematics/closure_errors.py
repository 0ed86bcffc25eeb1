"""How far loops are open: the joints that the spanning tree left out, as residuals of a
configuration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.calls import explained
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.joints import JointType
from kempe.kinematics.configuration import as_q
from kempe.kinematics.forward import fk
from kempe.model.compiled_system import Compiled
from kempe.model.tree.coordinates import Follower, coordinate_names

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled


def coordinate_value(system: Compiled, q: spatial.Array, name: str) -> spatial.Array:
    """Value (...) of a joint coordinate at q (..., nq), also of a coupled or locked one."""
    follower: Follower | None = system.structure.couplings.get(name)
    if follower is None:
        return q[..., system.coordinate_names.index(name)]
    source = (
        0.0 if follower.source is None else q[..., system.coordinate_names.index(follower.source)]
    )
    return np.broadcast_to(follower.multiplier * source + follower.offset, q.shape[:-1])


@explained
def closure_error(system: Compiled, q: Any) -> spatial.Array:
    """How far each loop is open (..., len(closures), 6).

    For each joint that the tree left out: the twist [v; w] in metres and radians, in axes of its
    frame M, that leads from where its own coordinates put M to where the tree puts it. Zero where
    the loop is closed. The angular part of a particle is zero.
    """
    q = as_q(system, q)
    bodies = fk(system, q)
    out = np.zeros((*q.shape[:-1], len(system.structure.closures), 6))
    number = {b: i for i, b in enumerate(system.body_names)}
    mechanism = system.mechanism
    for k, name in enumerate(system.structure.closures):
        joint = mechanism.joints[name]
        names = coordinate_names(mechanism, joint)
        local = (
            np.stack([coordinate_value(system, q, c) for c in names], axis=-1)
            if names
            else q[..., :0]
        )
        X_PF, X_CM = (X.evaluate(mechanism.parameters) for X in (joint.X_PF, joint.X_CM))
        X_FM = joint_pose(joint.type, local, system.dim, mechanism.bodies[joint.child].particle)
        X_WM = bodies[..., number[joint.parent], :, :] @ X_PF @ X_FM
        X_MM = spatial.inverse(X_WM) @ bodies[..., number[joint.child], :, :] @ X_CM
        if mechanism.bodies[joint.child].particle:  # it has a position only
            out[..., k, :3] = X_MM[..., :3, 3]
        else:
            out[..., k, :] = spatial.log_se3(X_MM)
    return out


def joint_pose(
    kind: JointType, q: spatial.Array, dim: int = 3, particle: bool = False
) -> spatial.Array:
    """Pose X_FM (..., 4, 4) of a joint type at its own coordinates (..., number of coordinates)."""
    mechanism = Mechanism("joint", dim)
    child = mechanism.particle("M") if particle else mechanism.body("M")
    # not by `Mechanism.joint`: a slider of the plane slides along z of its frame F, which is not
    # the plane's z
    mechanism.joints["joint"] = Joint("joint", kind, mechanism.ground.name, child.name)
    return fk(Compiled(mechanism), q, "M")
