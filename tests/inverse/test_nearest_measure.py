"""What is nearest to a pose out of reach: one measure, whether the pose is a target of a frame or a
task.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import kempe
from kempe.model.characteristic_length import compute_characteristic_length

FRAMES = {"two_link": "e", "ur5": "tool", "puma560": "tool", "panda": "panda_hand_tcp"}


def off(system, q, frame, X) -> float:
    """Square of the miss: of the position in characteristic lengths, of the rotation in radians."""
    Y = system.fk(q, frame)
    turn = Rotation.from_matrix(Y[:3, :3].T @ X[:3, :3]).magnitude()
    return float(
        np.sum((Y[:3, 3] - X[:3, 3]) ** 2) / compute_characteristic_length(system) ** 2 + turn**2
    )


def descent(system, q, frame, X) -> float:
    """The least miss that SciPy finds from here, within the limits."""
    low = np.maximum(system.lower, -7.0)
    high = np.minimum(system.upper, 7.0)
    found = minimize(
        lambda x: off(system, x, frame, X),
        np.clip(q, low, high),
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
        options={"ftol": 1e-15, "gtol": 1e-9},
    )
    return float(found.fun)


def beyond(system, frame, seed):
    """A pose of a random configuration, moved on by some characteristic lengths in a random
    direction.
    """
    way = np.random.default_rng(seed).normal(size=3) * (1.0, 1.0, system.dim == 3)
    X = np.array(system.fk(system.random(seed), frame))
    X[:3, 3] += (
        1.5 * (1 + seed % 4) * compute_characteristic_length(system) * way / np.linalg.norm(way)
    )
    return X


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("two_link", 1),
        ("puma560", 1),
        *(
            pytest.param(name, seed, marks=pytest.mark.slow)
            for name, seed in (
                ("two_link", 2),
                ("puma560", 2),
                ("ur5", 1),
                ("ur5", 2),
                ("panda", 1),
                ("panda", 2),
            )
        ),
    ],
)
def test_a_frame_and_a_task_miss_a_pose_by_the_same_measure(name, seed):
    """Neither can be brought nearer by SciPy, and random starts of SciPy end no nearer than the
    frame does.
    """
    system = kempe.load(name)
    frame = FRAMES[name]
    X = beyond(system, frame, seed)
    one = system.ik(X, frame, system.mid, task="pose")
    other = system.ik(kempe.tasks.Pose(frame, X), start=system.mid)
    assert not one.success and not other.success
    least = off(system, one.q, frame, X)
    assert least <= descent(system, one.q, frame, X) + 1e-9 * least
    assert off(system, other.q, frame, X) <= descent(system, other.q, frame, X) * (1 + 1e-6)
    assert least <= off(system, other.q, frame, X) * (1 + 1e-6)
    rng = np.random.default_rng(0)
    assert least <= min(descent(system, system.random(rng), frame, X) for _ in range(2)) * (
        1 + 1e-6
    )


def test_rows_of_a_batch_are_nearest_by_this_measure():
    """What is searched for when `q` is read is what a single call finds."""
    system = kempe.load("ur5")
    frame = FRAMES["ur5"]
    X = np.array([beyond(system, frame, seed) for seed in range(1, 4)])
    batch = system.ik(X, frame, system.mid)
    for i in range(3):
        single = system.ik(X[i], frame, system.mid)
        assert off(system, batch.q[i], frame, X[i]) == pytest.approx(
            off(system, single.q, frame, X[i]), rel=1e-9
        )
