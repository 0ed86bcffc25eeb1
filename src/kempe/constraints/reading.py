"""What constraints are given, checked: poses, points, directions, and what cannot change from
target to target.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kempe import spatial
from kempe.calls import numbers
from kempe.errors import InputError
from kempe.placement import direction
from kempe.rigid import EXACT as RIGID
from kempe.rigid import arrays, sound
from kempe.spatial import Array

LARGEST = 1e100
"""Numbers above this are too large for the kernels."""

ROTATES = 1e-4
"""How far R'R of a (3, 3) array may be from 1 for it to be a rotation, and not three positions."""
MEETS = 1e-12
"""Distance in metres below which there is no direction from one point to another."""


def poses_of(x: Any, dim: int, what: str) -> Array:
    """Poses (..., 4, 4), in the plane also from (..., 3, 3); kernels check rotations. Errors:
    `InputError`.
    """
    given = numbers_of(arrays(x, what), what)
    is_planar = dim == 2 and given.ndim >= 2 and given.shape[-2:] == (3, 3)
    X = np.zeros((*given.shape[:-2], 4, 4)) if is_planar else given
    if is_planar:
        X[..., :2, :2] = given[..., :2, :2]
        X[..., :2, 3] = given[..., :2, 2]
        X[..., 2, 2] = 1.0
        X[..., 3, 3] = 1.0
    if X.ndim < 2 or X.shape[-2:] != (4, 4):
        raise InputError(f"{what} has shape {X.shape}; it must be a pose (..., 4, 4)")
    X = spatial._poses(X, what)
    if dim == 2 and (np.any(np.abs(X[..., 2, 3]) > RIGID) or np.any(1.0 - X[..., 2, 2] > RIGID)):
        raise InputError(f"{what} leaves the plane of the system")
    return sound(X, what)


def numbers_of(x: Any, what: str) -> Array:
    """Real numbers as an array. Errors: `InputError`."""
    return numbers(x, what)


def along(z: Array, dim: int) -> Array:
    """Rotations (..., 3, 3) whose z is along unit vectors (..., 3); in the plane their x is the
    plane's normal.
    """
    if dim == 3:
        return spatial.align_z(z)
    x = np.broadcast_to([0.0, 0.0, 1.0], z.shape)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def flat(X: Array) -> tuple[float, ...]:
    """A pose (4, 4) as a tuple of 16 numbers, which can be hashed."""
    return tuple(X.ravel().tolist())


def points_of(x: Any, dim: int, what: str) -> Array:
    """Points (..., 3), in the plane also from (..., 2), with z = 0. Errors: `InputError`, also for
    rotations.
    """
    p = _vectors(x, dim, what)
    refuse_rotations(p, what)
    return _in_plane(p, dim, what)


def refuse_rotations(x: Array, what: str) -> None:
    """Refuse, with an `InputError`, rotations or poses of the plane (..., 3, 3) where positions
    (..., 3) are meant.
    """
    if x.ndim < 2 or x.shape[-2:] != (3, 3):
        return
    R = x[np.isfinite(x).all(axis=(-1, -2))]
    if not len(R) or np.abs(R).max() > 1e6:
        return
    turned = (np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < ROTATES) and np.all(
        np.linalg.det(R) > 0.0
    )
    flat_ = np.all(R[:, 2] == [0.0, 0.0, 1.0]) and (
        np.abs(R[:, :2, :2] @ np.swapaxes(R[:, :2, :2], -1, -2) - np.eye(2)).max() < ROTATES
    )
    if turned or flat_:
        is_ = "a rotation" if turned else "a pose of the plane"
        raise InputError(
            f"{what} is {is_} (3, 3), not three positions: an orientation is "
            "tasks.Orientation(frame, R), or task='orientation' of ik, a pose is (4, 4); "
            "task='position' says that positions are meant"
        )


def directions_of(x: Any, dim: int, what: str) -> Array:
    """Unit vectors (..., 3), in the plane also from (..., 2). Errors: `InputError`, also for zero
    vectors.
    """
    p = _vectors(direction(x), dim, what)
    if np.any(np.all(p == 0.0, axis=-1)):
        raise InputError(f"{what} is zero; it must have a direction")
    return _in_plane(spatial.unit(p), dim, what)


def fixed(x: Array, what: str, shape: tuple[int, ...] = ()) -> Array:
    """A number or array of shape `shape` that must be finite and the same for all targets. Errors:
    `InputError`.
    """
    if x.shape != shape:
        raise InputError(
            f"{what} has shape {x.shape}; it must have {shape or 'none: a number'}, one for all "
            "targets"
        )
    if not np.all(np.abs(x) < LARGEST):
        raise InputError(f"{what} is {x.tolist()}; it must be finite")
    return x


def at_point(point: Any, dim: int, what: str) -> tuple[float, ...]:
    """Pose without a rotation at a point of a frame, as a tuple of 16 numbers, which can be hashed.

    `dim` is 2 in the plane, else 3; `what` names the point in messages. Errors: `InputError` for
    points that are not finite, of another shape, or different for several targets.
    """
    return flat(spatial.pose(p=fixed(points_of(point, dim, what), what, (3,))))


def with_axis(axis: Any, dim: int, what: str) -> tuple[float, ...]:
    """Rotation whose z is along the axis (default z, in the plane x), as a pose of 16 numbers.
    Errors: `InputError`.
    """
    usual = (1.0, 0.0, 0.0) if dim == 2 else (0.0, 0.0, 1.0)
    z = fixed(directions_of(usual if axis is None else axis, dim, what), what, (3,))
    return flat(spatial.pose(along(z, dim)))


def tilt_of(d: Array) -> Array:
    """Angle (...) between z and vectors (..., 3); pi for a vector that has no direction."""
    across = np.hypot(d[..., 0], d[..., 1])
    return np.where(np.hypot(across, d[..., 2]) < MEETS, np.pi, np.arctan2(across, d[..., 2]))


def ends_of(low: Any, high: Any, what: str, n: int) -> tuple[Array, Array]:
    """Lower and upper bounds (n,), which may be infinite.

    Errors: `InputError` where they leave nothing between them.
    """
    a, b = (numbers_of(x, f"an end of {what}") for x in (low, high))
    if any(x.shape not in ((), (n,)) for x in (a, b)):
        raise InputError(f"{what}: {low!r} and {high!r} must be numbers, or have {n} entries each")
    if not np.all((a <= b) & (a < np.inf) & (b > -np.inf)):
        raise InputError(f"{what}: {low!r} and {high!r} leave nothing; needed is low <= high")
    return np.broadcast_to(a, n), np.broadcast_to(b, n)


def corners_of(low: Any, high: Any, dim: int, what: str) -> tuple[Array, Array]:
    """Two corners (..., dim) of a box; in the plane, of a box that it goes through. Errors:
    `InputError`.
    """
    a, b = (_vectors(x, dim, what) for x in (low, high))
    if dim == 2 and (np.any(a[..., 2] > 0.0) or np.any(b[..., 2] < 0.0)):
        raise InputError(f"{what} are {low!r} and {high!r}: the box leaves the plane of the system")
    return a[..., :dim], b[..., :dim]


def _vectors(x: Any, dim: int, what: str) -> Array:
    p = numbers_of(x, what)
    if dim == 2 and p.ndim and p.shape[-1] == 2:
        p = np.concatenate([p, np.zeros((*p.shape[:-1], 1))], axis=-1)
    if p.ndim == 0 or p.shape[-1] != 3:
        raise InputError(f"{what} has shape {p.shape}; it must be (..., {dim})")
    return p


def _in_plane(p: Array, dim: int, what: str) -> Array:
    if dim == 2 and np.any(np.abs(p[..., 2]) > RIGID):
        raise InputError(
            f"{what} leaves the plane of the system: its z is up to "
            f"{np.nanmax(np.abs(p[..., 2])):.6g}"
        )
    return p


def positive(x: Any, what: str) -> Array:
    """Numbers that are not negative. Errors: `InputError`."""
    value = numbers_of(x, what)
    if np.any(value < 0.0):
        raise InputError(f"{what} is {x!r}; it must not be negative")
    return value


def pair(low: Any, high: Any, what: str) -> tuple[Array, Array]:
    """Lower and upper bounds as arrays of one shape.

    Errors: `InputError` where shapes differ or bounds leave nothing.
    """
    a, b = (numbers_of(x, f"an end of {what}") for x in (low, high))
    try:
        a, b = (a, b) if a.shape == b.shape else np.broadcast_arrays(a, b)
    except ValueError:
        raise InputError(
            f"{what}: {low!r} and {high!r} have shapes that do not fit together"
        ) from None
    if np.any(a > b):
        raise InputError(f"{what}: {low!r} and {high!r} leave nothing; needed is low <= high")
    return a.copy(), b.copy()
