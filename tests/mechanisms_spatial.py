"""The shipped closed mechanisms in space: what counting says of each, what the rank says, and what
is true.

`SPATIAL` is a table for all tests that need mechanisms with known degrees of freedom.
`joint_constraints` is an independent oracle for the rank: velocities of bodies in place of joint
coordinates, nothing of Kempe's loops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kempe import System


@dataclass(frozen=True)
class Spatial:
    """A mechanism and its degrees of freedom at the posture `closed`.

    `count` is 6 for each moving body minus the constraints of all joints; `rank` is the dimension
    of the velocities that the joints allow; `dof` is the dimension of the set of configurations
    through the posture; `redundant` is the number of constraints that others imply, always
    `rank - count`; `idle` is how many freedoms are left when the motors hold, spins of rods that
    move nothing else.
    """

    name: str
    count: int
    rank: int
    dof: int
    redundant: int
    idle: int
    source: str


SPATIAL = [
    Spatial(
        "four_bar_spatial",
        -2,
        1,
        1,
        3,
        0,
        "three redundant constraints for each planar loop of revolute joints",
    ),
    Spatial("bennett", -2, 1, 1, 3, 0, "Bennett, 1903"),
    Spatial("goldberg_5r", -1, 1, 1, 2, 0, "Goldberg, 1943"),
    Spatial("sarrus", 0, 1, 1, 1, 0, "Sarrus, 1853"),
    Spatial("bricard_trihedral", 0, 1, 1, 1, 0, "Bricard, 1927; Baker, 1980"),
    Spatial("bricard_rectangular", 0, 1, 1, 1, 0, "Bricard, 1897; benchmark of IFToMM"),
    Spatial("bricard_line_symmetric", 0, 1, 1, 1, 0, "Bricard, 1897; Baker, 1980"),
    Spatial("schatz", 0, 1, 1, 1, 0, "Lee and Dai, 2003"),
    Spatial("rssr", 2, 2, 2, 0, 1, "Hartenberg and Denavit, 1964: the coupler spins"),
    Spatial("delta_ss", 9, 9, 9, 0, 6, "Clavel, 1988: each rod spins"),
    Spatial("delta_uu", -3, 3, 3, 6, 0, "Clavel, 1988"),
    Spatial("stewart", 6, 6, 6, 0, 0, "Stewart, 1965"),
    Spatial("stewart_sps", 12, 12, 12, 0, 6, "Stewart, 1965: each leg spins"),
    Spatial("stewart_dietmaier", 6, 6, 6, 0, 0, "Dietmaier, 1998"),
    Spatial("three_upu", 3, 3, 3, 0, 0, "Tsai, 1996"),
    Spatial(
        "three_upu_snu",
        3,
        5,
        3,
        2,
        0,
        "Zlatanov, Bonev and Gosselin, 2002: a constraint singularity",
    ),
    Spatial("three_rps", 3, 3, 3, 0, 0, "Hunt, 1983"),
    Spatial(
        "seven_bodies_loop",
        2,
        5,
        5,
        3,
        0,
        "a slider-crank in a plane and four joints outside the loop",
    ),
]
"""One row a mechanism. At `three_upu_snu` two motions of dimension 3 meet, which is why the rank
says 5."""


def singular_values(J: np.ndarray) -> tuple[np.ndarray, int]:
    """Singular values of a matrix and its rank; a rank without a clear gap is an error."""
    S = np.linalg.svd(J, compute_uv=False)
    rank = int((S > 1e-9 * S[0]).sum())
    dropped = S[rank] if rank < len(S) else 0.0
    assert S[rank - 1] > 1e-4 * S[0] and dropped < 1e-13 * S[0], S
    return S, rank


def joint_constraints(system: System, q: np.ndarray, held: tuple[str, ...] = ()) -> np.ndarray:
    """Rows that the twists of all moving bodies must meet (m, 6 bodies): each joint allows its own
    screws only.

    Twists [v; w] are taken at the origin. Joints named in `held` allow nothing. Rows are
    orthonormal for each joint.
    """
    pose = dict(zip(system.body_names, system.fk(q), strict=True))
    column = {b: 6 * i for i, b in enumerate(system.body_names[1:])}
    rows = []
    for joint in system.structure.joints.values():
        F, M = (
            pose[body] @ X.evaluate_pose(system.structure.parameters)
            for body, X in ((joint.parent, joint.X_PF), (joint.child, joint.X_CM))
        )
        x = F[:3, 0]
        z = F[:3, 2]
        p = F[:3, 3]
        turns = {
            "revolute": [z],
            "prismatic": [],
            "universal": [x, M[:3, 1]],
            "spherical": list(np.eye(3)),
        }
        screws = [np.r_[np.cross(p, w), w] for w in turns[joint.type.type_name]]
        screws += [np.r_[z, 0, 0, 0]] if joint.type.type_name == "prismatic" else []
        if joint.name in held:
            screws = []
        allowed = np.array(screws).reshape(-1, 6)
        wrenches = (
            np.linalg.svd(allowed, full_matrices=True)[2][len(allowed) :]
            if len(allowed)
            else np.eye(6)
        )
        block = np.zeros((len(wrenches), 6 * len(column)))
        for body, sign in ((joint.parent, -1.0), (joint.child, 1.0)):
            if body in column:
                block[:, column[body] : column[body] + 6] += sign * wrenches
        rows.append(block)
    return np.concatenate(rows)
