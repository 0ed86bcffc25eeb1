"""Reachable targets on every real robot, judged by Pinocchio: all found, none false, none outside
the limits.
"""

from __future__ import annotations

import numpy as np
import pytest
from robots import good_urdf_files

import kempe

pin = pytest.importorskip("pinocchio")

TARGETS = 1000
NOT_FOR_PINOCCHIO = {"romeo.urdf", "talos_full_v2.urdf", "talos_full_v2_box.urdf"}
"""Files with mimic joints that stand before the joints which they follow."""
FILES = {n: p for n, p in good_urdf_files().items() if p.name not in NOT_FOR_PINOCCHIO}


def tips(robot):
    """Ends of the two longest chains, and the last body that carries on from one of them."""
    inner = set(robot.parent)
    ends = [
        name
        for i, name in enumerate(robot.body_names)
        if i and i not in inner and robot.structure.table.find_path(name)
    ]
    return sorted(ends, key=lambda name: (-len(robot.structure.table.find_path(name)), name))[:2]


def pinocchio_poses(model, robot, q, frame):
    """Poses (N, 4, 4) by Pinocchio of configurations of ours."""
    data = model.createData()
    number = model.getFrameId(frame)
    out = np.empty((len(q), 4, 4))
    x = pin.neutral(model)
    index = {n: i for i, n in enumerate(robot.coordinate_names)}
    joints = [
        (model.names[j], model.joints[j].idx_q, model.joints[j].nq) for j in range(1, model.njoints)
    ]
    for row, configuration in enumerate(q):
        for name, at, size in joints:
            if name not in index:
                continue
            value = configuration[index[name]]
            x[at : at + size] = (np.cos(value), np.sin(value)) if size == 2 else value
        pin.framesForwardKinematics(model, data, x)
        out[row] = data.oMf[number].homogeneous
    return out


def angles(A, B):
    """Angles (N,) between rotations, accurate near zero."""
    R = np.swapaxes(A[:, :3, :3], 1, 2) @ B[:, :3, :3]
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], -1)
    return np.arctan2(np.linalg.norm(axis, axis=-1), np.trace(R, axis1=1, axis2=2) - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_every_reachable_target_is_found(name):
    robot = kempe.load(FILES[name])
    model = pin.buildModelFromUrdf(str(FILES[name]), mimic=True)
    for frame in tips(robot):
        q = robot.random(1, TARGETS)
        X = pinocchio_poses(model, robot, q, frame)
        s = robot.ik(X, frame)
        at_q = robot.structure.layout.vector_q
        at_v = robot.structure.layout.vector_v
        assert s.success.all(), f"{frame}: {s}"
        assert (s.q[:, at_q] >= robot.lower[at_v]).all() and (
            s.q[:, at_q] <= robot.upper[at_v]
        ).all()
        Y = pinocchio_poses(model, robot, s.q, frame)
        assert np.linalg.norm(Y[:, :3, 3] - X[:, :3, 3], axis=-1).max() <= 1.001e-6
        assert angles(X, Y).max() <= 1.001e-6
