"""Independent answers for tests: joint poses and forward models in numpy's long double and scipy,
tables nowhere.

Nothing here uses Kempe's arithmetic. Poses are (4, 4) arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

Long = np.longdouble


def turn(axis: str, angle: float) -> np.ndarray:
    """Turn about an axis of the frame."""
    c = np.cos(Long(angle))
    s = np.sin(Long(angle))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    X = np.eye(4, dtype=Long)
    X[i, i], X[i, j], X[j, i], X[j, j] = c, -s, s, c
    return X


def slide(axis: str, length: float) -> np.ndarray:
    """Slide along an axis of the frame."""
    X = np.eye(4, dtype=Long)
    X["xyz".index(axis), 3] = length
    return X


def ball(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Rotation of a quaternion of any length (Euler and Rodrigues)."""
    w, x, y, z = np.array([w, x, y, z], dtype=Long) / np.sqrt(
        sum(Long(a) * Long(a) for a in (w, x, y, z))
    )
    X = np.eye(4, dtype=Long)
    X[:3, :3] = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return X


def joint_pose(
    kind: str,
    q: Sequence[float],
    pitch: float = 0.0,
    angles: bool = False,
    dim: int = 3,
    particle: bool = False,
) -> np.ndarray:
    """X_FM of each joint of the zoo, written out, and of products in words."""
    if kind == "fixed":
        return np.eye(4, dtype=Long)
    if kind == "revolute":
        return turn("z", q[0])
    if kind == "prismatic":
        return slide("z", q[0])
    if kind == "helical":
        return turn("z", q[0]) @ slide("z", Long(pitch) * Long(q[0]))
    if kind == "cylindrical":
        return turn("z", q[0]) @ slide("z", q[1])
    if kind == "universal":
        return turn("x", q[0]) @ turn("y", q[1])
    if kind == "spherical":
        return turn("z", q[0]) @ turn("y", q[1]) @ turn("x", q[2]) if angles else ball(*q)
    if kind == "translation" or (kind == "free" and particle):
        return slide("x", q[0]) @ slide("y", q[1]) @ (slide("z", q[2]) if dim == 3 else np.eye(4))
    if kind == "planar" or (kind == "free" and dim == 2):
        return slide("x", q[0]) @ slide("y", q[1]) @ (np.eye(4) if particle else turn("z", q[2]))
    if kind == "free":
        return joint_pose("translation", q[:3]) @ joint_pose("spherical", q[3:], angles=angles)
    # a product in words
    X = np.eye(4, dtype=Long)
    left = list(q)
    for word in kind.replace(", ", ",").split():
        if word == "S":
            X = X @ ball(*left[:4])
            del left[:4]
            continue
        number = left.pop(0)
        axis = word[2]
        X = X @ (slide(axis, number) if word[0] == "P" else turn(axis, number))
        if word[0] == "H":
            X = X @ slide(axis, Long(float(word[4:-1])) * Long(number))
    assert not left, kind
    return X


def placement(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Pose of a position and fixed-axis angles."""
    X = np.eye(4, dtype=Long)
    X[: len(xyz), 3] = xyz
    X[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    return X


def inverse(X: np.ndarray) -> np.ndarray:
    """Inverse of a pose."""
    out = np.eye(4, dtype=X.dtype)
    out[:3, :3] = X[:3, :3].T
    out[:3, 3] = -X[:3, :3].T @ X[:3, 3]
    return out


def twist_between(X0: np.ndarray, X1: np.ndarray, step: float) -> np.ndarray:
    """Body twist [v; w] that leads from X0 to the nearby pose X1 in the time `step`, to first
    order.
    """
    D = np.asarray(inverse(X0) @ X1, dtype=float)
    w = np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]) / 2
    return np.concatenate([D[:3, 3], w]) / step


def tree_poses(
    parent: Sequence[int], joints: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, bool]]
) -> list[np.ndarray]:
    """Poses of all bodies, the ground first, from (X_PF, X_FM, X_CM, walked backwards) of each
    parent joint.
    """
    poses = [np.eye(4, dtype=Long)]
    for number, (X_PF, X_FM, X_CM, backwards) in zip(parent, joints, strict=True):
        X = X_PF @ X_FM @ inverse(X_CM)
        poses.append(poses[number] @ (inverse(X) if backwards else X))
    return poses


def coordinate_values(
    q: Mapping[str, float],
    couplings: Mapping[str, tuple[Mapping[str, float], float]],
    locks: Mapping[str, float],
) -> dict[str, float]:
    """Values of all coordinates: free ones, locked ones, and those that follow others, in any
    order.
    """
    values = {**q, **locks}
    waiting = dict(couplings)
    while waiting:
        ready = [n for n, (sources, _) in waiting.items() if all(s in values for s in sources)]
        assert ready, "a cycle"
        for name in ready:
            sources, offset = waiting.pop(name)
            values[name] = offset + sum(m * values[s] for s, m in sources.items())
    return values
