"""Answers of public cases by plain numpy: products of Denavit-Hartenberg rows, errors of poses,
differences of angles.

Sources are named as owner's project and number of the report or question.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import reference
from scipy.spatial.transform import Rotation

from kempe import System

PI = math.pi


def turn(axis: str, angle: float) -> np.ndarray:
    """Pose of a rotation about an axis of the frame."""
    return np.asarray(reference.turn(axis, angle), dtype=float)


def at(*xyz: float) -> np.ndarray:
    """Pose of a translation."""
    return np.asarray(reference.placement(xyz), dtype=float)


def rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Pose of three rotations about fixed axes x, y, z."""
    return turn("z", yaw) @ turn("y", pitch) @ turn("x", roll)


def product(poses: Iterable[np.ndarray]) -> np.ndarray:
    """Product of poses, from the base to the tip."""
    X = np.eye(4)
    for pose in poses:
        X = X @ pose
    return X


def dh(theta: float, d: float, a: float, alpha: float) -> np.ndarray:
    """Pose of one row in the standard convention."""
    return turn("z", theta) @ at(a, 0, d) @ turn("x", alpha)


def modified_dh(alpha: float, a: float, theta: float, d: float) -> np.ndarray:
    """Pose of one row in the modified convention (Craig)."""
    return turn("x", alpha) @ at(a, 0, 0) @ turn("z", theta) @ at(0, 0, d)


def pose_errors(A: np.ndarray, B: np.ndarray) -> tuple[float, float]:
    """Distance of the origins, and angle between the orientations."""
    turned = np.linalg.norm(A[:3, :3] - B[:3, :3]) / (2 * math.sqrt(2))
    return float(np.linalg.norm(A[:3, 3] - B[:3, 3])), 2 * math.asin(min(1.0, turned))


def pose_error(A: np.ndarray, B: np.ndarray) -> float:
    """Larger one of distance and angle."""
    return max(pose_errors(A, B))


def six_errors(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Three differences of position and three of orientation, for solvers of equations."""
    return np.concatenate(
        [A[:3, 3] - B[:3, 3], Rotation.from_matrix(B[:3, :3].T @ A[:3, :3]).as_rotvec()]
    )


def jacobian_by_differences(
    pose: Callable[[np.ndarray], np.ndarray], q: np.ndarray, h: float = 1e-6
) -> np.ndarray:
    """Velocity of the frame's origin and angular velocity, both in axes of the ground, per
    coordinate.
    """
    R = pose(q)[:3, :3]
    columns = []
    for e in np.eye(len(q)) * h:
        rate = (pose(q + e) - pose(q - e)) / (2 * h)
        W = rate[:3, :3] @ R.T
        columns.append(
            [
                *rate[:3, 3],
                (W[2, 1] - W[1, 2]) / 2,
                (W[0, 2] - W[2, 0]) / 2,
                (W[1, 0] - W[0, 1]) / 2,
            ]
        )
    return np.array(columns).T


def apart(a: np.ndarray | Sequence[float], b: np.ndarray | Sequence[float]) -> float:
    """Largest difference of angles, whole turns left out."""
    return float(np.abs(np.angle(np.exp(1j * (np.asarray(a) - np.asarray(b))))).max())


def nearest(solutions: Iterable[np.ndarray], q: np.ndarray | Sequence[float]) -> float:
    """How far the nearest of the solutions is from `q`, whole turns left out."""
    return min((apart(v, q) for v in solutions), default=math.inf)


def inside(system: System, q: np.ndarray) -> bool:
    """Whether all coordinates are inside their limits."""
    return bool((q >= system.lower - 1e-9).all() and (q <= system.upper + 1e-9).all())


def without_limits(system: System) -> System:
    """The same robot with no limits at all."""
    return system.with_limits(dict.fromkeys(system.coordinate_names))


def point(system: System, q: np.ndarray, body: str, *xyz: float) -> np.ndarray:
    """Where a point of a body is."""
    return (system.fk(q, body) @ [*xyz, *[0.0] * (3 - len(xyz)), 1.0])[:3]
