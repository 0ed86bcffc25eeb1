"""Chains of real robots, made from Pinocchio's models alone."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from chain_problems import Chain
from primitive_tables import Row, Table, pose
from scipy.spatial.transform import Rotation

from kempe.kernels.forward.table_layout import SLIDE, TURN

pin = pytest.importorskip("pinocchio")


def urdf(name):
    """Path of a file of the package example-robot-data."""
    found = sorted(
        Path(sys.prefix).glob(
            f"lib/python*/site-packages/cmeel.prefix/share/example-robot-data/**/{name}"
        )
    )
    if not found:
        pytest.skip("example-robot-data is not installed")
    return str(found[0])


def axis_to_z(axis):
    """A rotation that takes z to the axis."""
    return Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0].as_matrix()


class Arm(Chain):
    """A chain of joints with one coordinate, from the root to a frame, with Pinocchio's own forward
    model.
    """

    def __init__(self, file, frame):
        self.model = pin.buildModelFromUrdf(urdf(file))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(frame)
        assert self.frame < self.model.nframes
        f = self.model.frames[self.frame]
        joints = []
        j = f.parentJoint
        while j > 0:
            joints.insert(0, j)
            j = self.model.parents[j]
        rows = []
        lower = []
        upper = []
        back = np.eye(4)
        for i, j in enumerate(joints):
            joint = self.model.joints[j]
            data = joint.createData()
            joint.calc(data, pin.neutral(self.model), np.zeros(self.model.nv))
            motion = np.asarray(
                data.S if isinstance(data.S, np.ndarray) else data.S.matrix()
            ).reshape(6)
            kind = TURN if np.any(motion[3:]) else SLIDE
            A = pose(axis_to_z(motion[3:] if kind == TURN else motion[:3]))
            rows.append(
                Row(kind, i - 1, i, i, back @ self.model.jointPlacements[j].homogeneous @ A)
            )
            back = A.T
            unlimited = joint.nq == 2
            lower.append(-np.inf if unlimited else self.model.lowerPositionLimit[joint.idx_q])
            upper.append(np.inf if unlimited else self.model.upperPositionLimit[joint.idx_q])
        n = len(joints)
        self.joints = [self.model.joints[j] for j in joints]
        table = Table(rows, [(n - 1, False, back @ f.placement.homogeneous)], n, n, True)
        circular = [
            int(r.kind == TURN and b - a >= 2 * np.pi)
            for r, a, b in zip(rows, lower, upper, strict=True)
        ]
        super().__init__(
            table, np.array(lower), np.array(upper), np.array(circular, dtype=np.int64)
        )

    def forward(self, q):
        full = pin.neutral(self.model)
        for joint, x in zip(self.joints, q, strict=True):
            full[joint.idx_q : joint.idx_q + joint.nq] = (
                [np.cos(x), np.sin(x)] if joint.nq == 2 else x
            )
        pin.framesForwardKinematics(self.model, self.data, full)
        return self.data.oMf[self.frame].homogeneous.copy()

    def at_limits(self, rng, n):
        """Configurations with half of the joints exactly at a limit."""
        q = self.random_q(rng, n)
        for x in q:
            chosen = rng.permutation(len(x))[: len(x) // 2]
            x[chosen] = np.where(
                rng.random(len(chosen)) < 0.5, self.lower[chosen], self.upper[chosen]
            )
        return q
