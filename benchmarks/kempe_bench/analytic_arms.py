"""Arms for the analytical inverse model, from published tables, and each of them as a plain chain
of six turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import kempe
from kempe import spatial
from kempe.description.mechanism import Mechanism
from kempe.poses import make_placement_from_pose
from kempe.spatial import Array
from kempe_bench import peers

if TYPE_CHECKING:
    from kempe.system import System

FRAME = "tool"
TOLERANCE = 1e-6
"""Of a pose, in metres and radians, and of a configuration that counts as found, in radians."""
ERRORS = 1e-3
"""Standard deviation of a calibrated arm's errors, in metres and radians."""

WRIST = "spherical wrist"
PARALLEL = "three parallel axes"
OFFSET = "offset wrist"
ANY = "any 6R"
LOCKED = "7R"
"""Families; in the last one joint of seven is held."""

Row = tuple[float, float, float, float]
"""a, alpha, d, theta of a Denavit-Hartenberg table."""


@dataclass(frozen=True)
class Chain:
    """Six turns about z: the placements X (6, 4, 4) before them, and the `tool` (4, 4) after the
    last.
    """

    X: Array
    tool: Array

    def pose(self, q: Array) -> Array:
        """Pose (n, 4, 4) of the tool for q (n, 6) by plain products: what answers are judged by."""
        out = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        for i, X in enumerate(self.X):
            out = out @ X @ spatial.pose(spatial.rot_z(q[:, i]))
        return out @ self.tool

    @cached_property
    def frames(self) -> Array:
        """Poses (7, 4, 4) of the joints at q = 0, z along their axes, and of the tool."""
        out = []
        X = np.eye(4)
        for step in (*self.X, self.tool):
            X = X @ step
            out.append(X)
        return np.array(out)

    def wrong(self, q: Array, targets: Array) -> int:
        """How many of the answers q (k, 6) miss their targets (k, 4, 4) by more than `TOLERANCE`,
        or are no numbers.
        """
        X = self.pose(q)
        position = np.linalg.norm(X[:, :3, 3] - targets[:, :3, 3], axis=-1)
        turn = np.linalg.norm(
            spatial.log_so3(np.swapaxes(X[:, :3, :3], -1, -2) @ targets[:, :3, :3]), axis=-1
        )
        return int(np.sum(~((position <= TOLERANCE) & (turn <= TOLERANCE))))


@dataclass(frozen=True)
class Verdict:
    """Of many poses: for how many the configuration that they were made from is found, and how many
    answers miss.
    """

    poses: int
    found: int
    answers: int
    wrong: int


def judged(chain: Chain, q: Array, answers: Sequence[Array]) -> Verdict:
    """Verdict on the answers (k, 6) to the poses of q (n, 6), a list of n, whole turns aside."""
    number = np.repeat(np.arange(len(q)), [len(a) for a in answers])
    given = np.concatenate([np.empty((0, 6)), *answers])
    off = np.abs((given - q[number] + pi) % (2.0 * pi) - pi)
    hit = np.zeros(len(q), dtype=bool)
    hit[number[np.all(off <= TOLERANCE, axis=-1)]] = True
    return Verdict(len(q), int(hit.sum()), len(given), chain.wrong(given, chain.pose(q)[number]))


@dataclass(frozen=True)
class Arm:
    """An arm of the benchmark: what makes its mechanism, all lengths times a factor, and the joint
    that is held.
    """

    title: str
    family: str
    make: Callable[[float], Mechanism]
    held: dict[str, float] = field(default_factory=dict)
    prebuilt: str = ""
    """Name of the arm among those that come with ssik."""

    def build(self, scale: float = 1.0) -> System:
        """A fresh system, all lengths times `scale`."""
        return self.make(scale).build()

    @cached_property
    def system(self) -> System:
        """The arm for Kempe."""
        return self.build()

    @cached_property
    def free(self) -> list[int]:
        """Columns of q of the joints that are not held."""
        return [i for i, name in enumerate(self.system.coordinate_names) if name not in self.held]

    @cached_property
    def chain(self) -> Chain:
        """The arm written out for the others, the held joint as part of a placement."""
        arm = peers.arm_of(self.system, FRAME, Path())
        placements = []
        X = np.eye(4)
        for link in arm.links:
            X = X @ link.X
            if link.name in self.held:
                X = X @ spatial.pose(spatial.rot_z(self.held[link.name]))
            else:
                placements.append(X)
                X = np.eye(4)
        return Chain(np.array(placements), X @ arm.tool)


def random(n: int) -> Array:
    """Configurations (n, 6), uniform in a full turn of each joint, the same ones each time."""
    return np.random.default_rng(1).uniform(-pi, pi, (n, 6))


def table(rows: Sequence[Row], name: str, scale: float, convention: str = "standard") -> Mechanism:
    """Mechanism of a Denavit-Hartenberg table."""
    numbers = [
        {"a": scale * a, "alpha": alpha, "d": scale * d, "theta": theta}
        for a, alpha, d, theta in rows
    ]
    return kempe.from_dh(numbers, convention, name)


def shipped(name: str, scale: float) -> Mechanism:
    """Mechanism of the library, whose parameters are all lengths."""
    out = kempe.read(name)
    for key in out.parameters:
        out.parameters[key] *= scale
    return out


def placed(X: Sequence[Array], name: str, scale: float) -> Mechanism:
    """Mechanism of turns about z, each at its placement X (4, 4) on the body before it."""
    out = Mechanism(name)
    body = out.ground
    for i, here in enumerate(X, 1):
        here = spatial.pose(here[:3, :3], scale * here[:3, 3])
        child = out.body(f"link{i}")
        out.revolute(f"q{i}", body, child, at=make_placement_from_pose(here))
        body = child
    out.frame(FRAME, body)
    return out


def calibrated(rows: Sequence[Row], scale: float) -> Mechanism:
    """A table whose placements all have an error in each of their six freedoms, the same ones each
    time.
    """
    twist = ERRORS * np.random.default_rng(10).standard_normal((len(rows), 6))
    frames = peers.arm_of(table(rows, "nominal", 1.0).build(), FRAME, Path())
    steps = [link.X for link in frames.links]
    return placed(
        [X @ spatial.exp_se3(t) for X, t in zip(steps, twist, strict=True)], "calibrated", scale
    )


def any_6r(seed: int, scale: float) -> Mechanism:
    """A table of random numbers: lengths up to 0.5 m, all twists."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(0.05, 0.5, 6)
    alpha = rng.uniform(-pi, pi, 6)
    d = rng.uniform(-0.5, 0.5, 6)
    return table([(*row, 0.0) for row in zip(a, alpha, d, strict=True)], f"any_6r_{seed}", scale)


# ABB, product specification of the IRB 6640-180/2.55 (3HAC028284): 780, 320, 1075, 200, 1142.5 and
# 200 mm.
IRB_6640 = (
    (0.32, -pi / 2, 0.78, 0.0), (1.075, 0.0, 0.0, -pi / 2), (0.2, -pi / 2, 0.0, 0.0), (0.0, pi / 2, 1.1425, 0.0),
    (0.0, -pi / 2, 0.0, 0.0), (0.0, 0.0, 0.2, pi),
)  # fmt: skip
# Universal Robots, "DH Parameters for calculations of kinematics and dynamics", UR10e.
UR10E = (
    (0.0, pi / 2, 0.1807, 0.0), (-0.6127, 0.0, 0.0, 0.0), (-0.57155, 0.0, 0.0, 0.0), (0.0, pi / 2, 0.17415, 0.0),
    (0.0, -pi / 2, 0.11985, 0.0), (0.0, 0.0, 0.11655, 0.0),
)  # fmt: skip
# Kinova, user guide of the JACO 2 with the curved wrist, "classic DH parameters": D1 = 0.2755, D2 =
# 0.41, D3 = 0.2073, D4 = D5 = 0.0741, D6 = 0.16, e2 = 0.0098 m, and bends of twice 30 degrees,
# sin(30)/sin(60) =
# 1/sqrt(3).
_BEND = 0.0741 / 3**0.5
JACO_2 = (
    (0.0, pi / 2, 0.2755, 0.0), (0.41, pi, 0.0, 0.0), (0.0, pi / 2, -0.0098, 0.0),
    (0.0, pi / 3, -0.2073 - _BEND, 0.0), (0.0, pi / 3, -2 * _BEND, 0.0), (0.0, pi, -_BEND - 0.16, 0.0),
)  # fmt: skip
# FANUC CRX-10iA: M. Abbes and G. Poisson, "Geometric approach for inverse kinematics of the FANUC
# CRX collaborative robot", Robotics 13(6), 2024, modified convention, with the lengths of the
# CRX-10iA (540, 540,
# 150, 160 mm).
CRX_10IA = (
    (0.0, 0.0, 0.0, 0.0), (0.0, -pi / 2, 0.0, -pi / 2), (0.54, pi, 0.0, 0.0), (0.0, -pi / 2, -0.54, 0.0),
    (0.0, pi / 2, 0.15, 0.0), (0.0, -pi / 2, -0.16, 0.0),
)  # fmt: skip
# UFACTORY, support pages, "Kinematic and dynamic parameters of xArm 6", standard convention.
_TILT = float(np.arctan2(0.2845, 0.0535))
XARM_6 = (
    (0.0, -pi / 2, 0.267, 0.0), (float(np.hypot(0.2845, 0.0535)), 0.0, 0.0, -_TILT), (0.0775, -pi / 2, 0.0, _TILT),
    (0.0, pi / 2, 0.3425, 0.0), (0.076, -pi / 2, 0.0, 0.0), (0.0, 0.0, 0.097, 0.0),
)  # fmt: skip
# AgileX, piper_description.urdf: origins of the joints (xyz, rpy), rounded there so that no two
# axes are parallel.
PIPER = (
    ((0.0, 0.0, 0.123), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (1.5708, -0.1359, -3.1416)),
    ((0.28503, 0.0, 0.0), (0.0, 0.0, -1.7939)), ((-0.021984, -0.25075, 0.0), (1.5708, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (-1.5708, 0.0, 0.0)), ((8.8259e-05, -0.091, 0.0), (1.5708, 0.0, 0.0)),
)  # fmt: skip
# KUKA, specification of the LBR iiwa 14 R820: 360, 420, 400 and 126 mm.
IIWA_14 = (
    (0.0, -pi / 2, 0.36, 0.0), (0.0, pi / 2, 0.0, 0.0), (0.0, pi / 2, 0.42, 0.0), (0.0, -pi / 2, 0.0, 0.0),
    (0.0, -pi / 2, 0.4, 0.0), (0.0, pi / 2, 0.0, 0.0), (0.0, 0.0, 0.126, 0.0),
)  # fmt: skip


def _piper(scale: float) -> Mechanism:
    return placed(
        [spatial.pose(spatial.rpy_to_matrix(rpy), xyz) for xyz, rpy in PIPER], "piper", scale
    )


ARMS = (
    Arm("Puma 560", WRIST, partial(shipped, "puma560")),
    Arm("IRB 6640", WRIST, partial(table, IRB_6640, "irb6640")),
    Arm("UR5", PARALLEL, partial(shipped, "ur5")),
    Arm("UR10e", PARALLEL, partial(table, UR10E, "ur10e")),
    Arm("Jaco 2", OFFSET, partial(table, JACO_2, "jaco2"), prebuilt="jaco2"),
    Arm(
        "CRX-10iA",
        OFFSET,
        partial(table, CRX_10IA, "crx10ia", convention="modified"),
        prebuilt="crx10ia",
    ),
    Arm("xArm 6", OFFSET, partial(table, XARM_6, "xarm6"), prebuilt="xarm6"),
    Arm("PiPER", OFFSET, _piper, prebuilt="piper"),
    Arm("random 6R", ANY, partial(any_6r, 6)),
    Arm("UR10e calibrated", ANY, partial(calibrated, UR10E)),
    Arm("Panda, joint 7 held", LOCKED, partial(shipped, "panda"), {"panda_joint7": 0.8}),
    Arm("iiwa 14, joint 3 held", LOCKED, partial(table, IIWA_14, "iiwa14"), {"q3": 0.5}),
)
"""The arms, by family."""
