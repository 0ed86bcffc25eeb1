"""Functions on arrays of rotations SO(3) and poses SE(3); leading axes broadcast.

Poses are (..., 4, 4), rotations (..., 3, 3), twists (..., 6) with the linear part first,
quaternions (..., 4) in the order that the function's name says. Angles are radians.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kempe.arguments import broadcast_shapes, numbers, quiet
from kempe.arrays import warn_of_degrees
from kempe.errors import InputError, format_value, raise_missing_name
from kempe.numerics.rank import Spectrum

Array = NDArray[np.float64]

LAST_ROW = [0.0, 0.0, 0.0, 1.0]
"""The last row of a pose."""
SMALL_ANGLE = 1e-4
"""Below this angle, series replace quotients by the angle: their first dropped term is under
1e-17."""


@quiet
def unit(v: ArrayLike) -> Array:
    """Scale vectors (..., n) to length one; a vector that is zero or not finite gives NaN."""
    v = numbers(v, "v")
    if v.ndim == 0:
        raise InputError("v is a single number; it must be a vector (..., n)")
    # or squares would overflow or vanish
    scaled = v / np.max(np.abs(v), axis=-1, keepdims=True, initial=0.0)
    return scaled / np.sqrt(np.sum(scaled * scaled, axis=-1, keepdims=True))


@quiet
def skew(v: ArrayLike) -> Array:
    """Return the matrix (..., 3, 3) of the cross product with `v` (..., 3)."""
    v = numbers(v, "v", 3)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1] = -v[..., 2]
    out[..., 0, 2] = v[..., 1]
    out[..., 1, 0] = v[..., 2]
    out[..., 1, 2] = -v[..., 0]
    out[..., 2, 0] = -v[..., 1]
    out[..., 2, 1] = v[..., 0]
    return out


@quiet
def pose(R: ArrayLike | None = None, p: ArrayLike | None = None) -> Array:
    """Make poses (..., 4, 4) of rotations (..., 3, 3) and positions (..., 3), by default identity."""
    turn = np.eye(3) if R is None else numbers(R, "R", 3, 3)
    p = np.zeros(3) if p is None else numbers(p, "p", 3)
    shape = turn.shape[:-2]
    if p.shape[:-1] != shape:
        shape = broadcast_shapes({"R": shape, "p": p.shape[:-1]})
    out = np.zeros((*shape, 4, 4))
    out[..., :3, :3] = turn
    out[..., :3, 3] = p
    out[..., 3, 3] = 1.0
    return out


def _read_poses(X: ArrayLike, what: str = "X") -> Array:
    """Read poses (..., 4, 4), all NaN where the last row holds a NaN. `what` names them in
    messages.

    Errors: `InputError` for other shapes, and for a last row that is not 0 0 0 1. Rotations are not
    checked.
    """
    given = numbers(X, what, 4, 4)
    last = given[..., 3, :]
    if given.ndim == 2 and last.tolist() == LAST_ROW:  # the usual case, without the cost of arrays
        return given
    right = (last == LAST_ROW).all(axis=-1)
    if right.all():
        return given
    bad = np.isnan(last).any(axis=-1)
    if not (right | bad).all():
        wrong = last[~(right | bad)][0].tolist()
        raise InputError(f"{what} is not a pose: its last row is {wrong}; it must be 0 0 0 1")
    out = given.copy()
    out[bad] = np.nan
    return out


@quiet
def inverse(X: ArrayLike) -> Array:
    """Compute the inverse (..., 4, 4) of poses, by transposing the rotation."""
    given = _read_poses(X)
    R = np.swapaxes(given[..., :3, :3], -1, -2)
    return pose(R, -np.einsum("...ij,...j->...i", R, given[..., :3, 3]))


@quiet
def rot_x(angle: ArrayLike) -> Array:
    """Return the rotation (..., 3, 3) about x by `angle` (...) in radians."""
    return make_rotation(_read_typed_angle(angle), "x")


@quiet
def rot_y(angle: ArrayLike) -> Array:
    """Return the rotation (..., 3, 3) about y by `angle` (...) in radians."""
    return make_rotation(_read_typed_angle(angle), "y")


@quiet
def rot_z(angle: ArrayLike) -> Array:
    """Return the rotation (..., 3, 3) about z by `angle` (...) in radians."""
    return make_rotation(_read_typed_angle(angle), "z")


def _read_typed_angle(angle: ArrayLike) -> Array:
    """Read the angle of a call by a user, who is warned if it looks like degrees."""
    angle = numbers(angle, "angle")
    warn_of_degrees(angle, "angle")
    return angle


@quiet
def make_rotation(angle: ArrayLike, axis: str) -> Array:
    """Make the rotation (..., 3, 3) by `angle` (...) [rad] about the axis "x", "y" or "z".

    Errors: `InputError` for another axis.
    """
    angle = numbers(angle, "angle")
    if not isinstance(axis, str) or axis not in ("x", "y", "z"):  # pyright: ignore
        raise InputError(f"axis is {format_value(axis)}; it must be 'x', 'y' or 'z'")
    k = "xyz".index(axis)
    c = np.cos(angle)
    s = np.sin(angle)
    i = (k + 1) % 3
    j = (k + 2) % 3
    out = np.zeros((*angle.shape, 3, 3))
    out[..., k, k] = 1.0
    out[..., i, i], out[..., j, j] = c, c
    out[..., i, j], out[..., j, i] = -s, s
    return out


@quiet
def align_z(axis: ArrayLike) -> Array:
    """Return the smallest rotation (..., 3, 3) that takes z to `axis` (..., 3).

    For -z it is the half turn about x.

    Axes along x, y or z give exact permutations. A zero axis gives NaN.
    """
    a = unit(numbers(axis, "axis", 3))
    x = a[..., 0]
    y = a[..., 1]
    z = a[..., 2]
    across = np.hypot(x, y)
    upright = across < 1e-200  # the quotients would be inexact, and any do
    across = np.where(upright, 1.0, across)
    u = np.where(upright, 0.0, x / across)
    w = np.where(upright, 1.0, y / across)
    k = 1.0 - z  # a turn about (-w, u, 0) with cosine z
    out = np.empty((*a.shape, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1.0 - k * u * u, -k * u * w, x
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = -k * u * w, 1.0 - k * w * w, y
    out[..., 2, 0] = -x
    out[..., 2, 1] = -y
    out[..., 2, 2] = z
    return out


@quiet
def rpy_to_matrix(rpy: ArrayLike) -> Array:
    """Convert angles `rpy` (..., 3) [rad] to rotations (..., 3, 3), Rz(yaw) Ry(pitch) Rx(roll).

    The axes are fixed, as in URDF.
    """
    angles = numbers(rpy, "rpy", 3)
    warn_of_degrees(angles, "rpy")
    r, p, y = np.moveaxis(angles, -1, 0)
    return make_rotation(y, "z") @ make_rotation(p, "y") @ make_rotation(r, "x")


@quiet
def matrix_to_rpy(R: ArrayLike) -> Array:
    """Convert rotations (..., 3, 3) to fixed-axis angles (..., 3) roll, pitch, yaw in radians.

    At pitch = +-90 degrees roll is zero.
    """
    m = numbers(R, "R", 3, 3)
    cos_pitch = np.hypot(m[..., 0, 0], m[..., 1, 0])
    pitch = np.arctan2(-m[..., 2, 0], cos_pitch)
    regular = cos_pitch > 1e-12
    roll = np.where(regular, np.arctan2(m[..., 2, 1], m[..., 2, 2]), 0.0 * pitch)  # or NaN
    yaw = np.where(
        regular, np.arctan2(m[..., 1, 0], m[..., 0, 0]), np.arctan2(-m[..., 0, 1], m[..., 1, 1])
    )
    return np.stack([roll, pitch, yaw], axis=-1)


@quiet
def quat_wxyz_to_matrix(quat_wxyz: ArrayLike) -> Array:
    """Convert quaternions (..., 4) to rotations (..., 3, 3), normalised first.

    A zero quaternion gives NaN.
    """
    q = unit(numbers(quat_wxyz, "quat_wxyz", 4))
    w = q[..., 0, None, None]
    v = q[..., 1:]
    K = skew(v)
    return np.eye(3) + 2.0 * (w * K + K @ K)


@quiet
def matrix_to_quat_wxyz(R: ArrayLike) -> Array:
    """Convert rotations (..., 3, 3) to unit quaternions (..., 4) with w >= 0.

    The largest component is used (Shepperd, 1978).
    """
    m = numbers(R, "R", 3, 3)
    xx = m[..., 0, 0]
    yy = m[..., 1, 1]
    zz = m[..., 2, 2]
    trace = xx + yy + zz
    rest = 1.0 - trace
    wx = m[..., 2, 1] - m[..., 1, 2]
    wy = m[..., 0, 2] - m[..., 2, 0]
    wz = m[..., 1, 0] - m[..., 0, 1]
    xy = m[..., 0, 1] + m[..., 1, 0]
    xz = m[..., 0, 2] + m[..., 2, 0]
    yz = m[..., 1, 2] + m[..., 2, 1]
    # products of two of (w, x, y, z), times 4
    products = np.empty((*m.shape[:-2], 4, 4))
    products[..., 0, 0] = 1.0 + trace
    products[..., 1, 1] = rest + 2.0 * xx
    products[..., 2, 2] = rest + 2.0 * yy
    products[..., 3, 3] = rest + 2.0 * zz
    for i, j, x in ((0, 1, wx), (0, 2, wy), (0, 3, wz), (1, 2, xy), (1, 3, xz), (2, 3, yz)):
        products[..., i, j] = x
        products[..., j, i] = x
    best = np.diagonal(products, axis1=-2, axis2=-1).argmax(axis=-1)
    q = (
        products[best]
        if products.ndim == 2
        else np.take_along_axis(products, best[..., None, None], axis=-2)[..., 0, :]
    )
    q = q / np.sqrt((q * q).sum(axis=-1, keepdims=True))
    return cast(Array, np.where(q[..., :1] < 0.0, -q, q))


@quiet
def quat_wxyz_multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Compute the product (..., 4) of quaternions (w, x, y, z)."""
    a = numbers(a, "a", 4)
    b = numbers(b, "b", 4)
    if a.shape != b.shape:
        broadcast_shapes({"a": a.shape, "b": b.shape})
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    w = aw * bw - (ax * bx + ay * by + az * bz)
    out = np.empty((*w.shape, 4))
    out[..., 0] = w
    out[..., 1] = aw * bx + bw * ax + (ay * bz - az * by)
    out[..., 2] = aw * by + bw * ay + (az * bx - ax * bz)
    out[..., 3] = aw * bz + bw * az + (ax * by - ay * bx)
    return out


@quiet
def quat_wxyz_conjugate(q: ArrayLike) -> Array:
    """Compute conjugates (..., 4) of quaternions: for unit quaternions, the inverse rotations."""
    return numbers(q, "q", 4) * np.array([1.0, -1.0, -1.0, -1.0])


@quiet
def quat_wxyz_exp(w: ArrayLike) -> Array:
    """Convert rotation vectors `w` (..., 3) to unit quaternions (..., 4)."""
    w = numbers(w, "w", 3)
    half = 0.5 * np.linalg.norm(w, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * w], axis=-1)


@quiet
def quat_wxyz_log(q: ArrayLike) -> Array:
    """Convert unit quaternions (..., 4) to rotation vectors (..., 3), at most pi long.

    Q and -q give the same.
    """
    q = numbers(q, "q", 4)
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    # asin(s)/s = 1 + s^2/6 + ...
    factor = cast(Array, np.where(sine < SMALL_ANGLE, 2.0 + sine**2 / 3.0, angle / sine))
    return factor * q[..., 1:]


@quiet
def exp_so3(w: ArrayLike) -> Array:
    """Convert rotation vectors (..., 3) to rotations (..., 3, 3) (Rodrigues, 1840)."""
    return quat_wxyz_to_matrix(quat_wxyz_exp(w))


@quiet
def log_so3(R: ArrayLike) -> Array:
    """Convert rotations (..., 3, 3) to rotation vectors (..., 3), at most pi long.

    The result is accurate near 0 and near pi.
    """
    return quat_wxyz_log(matrix_to_quat_wxyz(R))


@quiet
def exp_se3(twist: ArrayLike) -> Array:
    """Compute the pose (..., 4, 4) of the screw motion `twist` = [v; w] (..., 6).

    See Murray, Li, Sastry, 1994, eq. 2.36.
    """
    twist = numbers(twist, "twist", 6)
    v = twist[..., :3]
    w = twist[..., 3:]
    K = skew(w)
    _, b, c = _evaluate_series(np.linalg.norm(w, axis=-1))
    V = np.eye(3) + b[..., None, None] * K + c[..., None, None] * (K @ K)
    return pose(exp_so3(w), np.einsum("...ij,...j->...i", V, v))


@quiet
def log_se3(X: ArrayLike) -> Array:
    """Compute the twist [v; w] (..., 6) whose exponential is the pose (..., 4, 4).

    The rotation is at most a half turn.
    """
    given = _read_poses(X)
    w = log_so3(given[..., :3, :3])
    K = skew(w)
    a, b, _ = _evaluate_series(np.linalg.norm(w, axis=-1))
    angle2 = np.sum(w * w, axis=-1)
    k = cast(
        Array,
        np.where(
            angle2 < SMALL_ANGLE**2, 1.0 / 12.0 + angle2 / 720.0, (1.0 - 0.5 * a / b) / angle2
        ),
    )
    V_inverse = np.eye(3) - 0.5 * K + k[..., None, None] * (K @ K)
    return np.concatenate([np.einsum("...ij,...j->...i", V_inverse, given[..., :3, 3]), w], axis=-1)


def _evaluate_series(angle: Array) -> tuple[Array, Array, Array]:
    """Evaluate sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3, by series for small t."""
    t2 = angle * angle
    small = angle < 1e-2
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    c = np.where(small, 1.0 / 6.0 - t2 / 120.0 + t2 * t2 / 5040.0, (1.0 - a) / t2)
    return a, b, c


@quiet
def adjoint(X: ArrayLike) -> Array:
    """Return the matrix (..., 6, 6) that transforms twists [v; w] from frame B to frame A.

    X is X_AB.
    """
    given = _read_poses(X)
    R = given[..., :3, :3]
    p = given[..., :3, 3]
    out = np.zeros((*given.shape[:-2], 6, 6))
    out[..., :3, :3] = R
    out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(p) @ R
    return out


@quiet
def pose_from_xyz_rpy(values: ArrayLike) -> Array:
    """Convert x, y, z, roll, pitch, yaw (..., 6) to poses (..., 4, 4), with fixed axes as in URDF."""
    values = numbers(values, "values", 6)
    return pose(rpy_to_matrix(values[..., 3:]), values[..., :3])


@quiet
def xyz_rpy_from_pose(X: ArrayLike) -> Array:
    """Convert poses (..., 4, 4) to x, y, z, roll, pitch, yaw (..., 6)."""
    given = _read_poses(X)
    return np.concatenate([given[..., :3, 3], matrix_to_rpy(given[..., :3, :3])], axis=-1)


class PoseFit(NamedTuple):
    """Pose of a body that best fits measured positions of its particles, with remaining errors."""

    X: Array
    """Pose (..., 4, 4)."""
    residual: Array
    """Root mean square (...) of the distances, in metres."""
    distances: Array
    """Distance (..., n) of each particle from where the pose puts it, in metres."""


@quiet
def fit_pose(particles: ArrayLike, places: ArrayLike) -> PoseFit:
    """Fit the pose of a body to measured positions of its particles, by least squares.

    See Arun, Huang, Blostein, 1987.

    `particles` (..., n, 3) are points of the body in its frame, `places` (..., n, 3) where they
    were measured; n is at least 3, and they do not lie on a line. In the plane both are (..., n,
    2), and n is at least 2. Batch axes broadcast. Errors: `InputError` for shapes, NaN, and
    particles that leave the orientation open; among many these give NaN.

    >>> round(float(fit_pose([[0, 0], [1, 0]], [[2, 1], [2, 2.2]]).residual), 12)
    0.1
    """
    given = numbers(particles, "particles")
    there = numbers(places, "places")
    for name, x in (("particles", given), ("places", there)):
        if (
            x.ndim < 2
            or x.shape[-1] not in (2, 3)
            or x.shape[-2:] != given.shape[-2:]
            or x.shape[-2] < x.shape[-1]
        ):
            need = (
                "(..., n, 3) with at least 3 points, or, in the plane, (..., n, 2) with at least 2"
            )
            raise InputError(f"{name} have shape {x.shape}; both must be {need}")
    dim = given.shape[-1]
    given, there = np.broadcast_arrays(given, there)
    centre = given.mean(axis=-2)
    target = there.mean(axis=-2)
    a = given - centre[..., None, :]
    b = there - target[..., None, :]
    bad = ~(np.isfinite(a) & np.isfinite(b)).all(axis=(-1, -2))
    spectrum = Spectrum(np.where(bad[..., None, None], 0.0, np.swapaxes(b, -1, -2) @ a))
    R = spectrum.rotation
    sense = np.sign(np.linalg.det(spectrum.orthogonal))
    S = spectrum.values
    size = np.linalg.norm(a, axis=(-1, -2)) * np.linalg.norm(b, axis=(-1, -2))
    loose = ~bad & ~(S[..., -2] + sense * S[..., -1] > 1e-12 * size)
    if bad.ndim == 0 and (bad or loose):
        open_ = "the particles lie on one line or in one point, which leaves the orientation open"
        raise InputError(
            "particles or places have entries that are not finite; all must be finite numbers"
            if bad
            else open_
        )
    X = np.zeros((*bad.shape, 4, 4))
    X[...] = np.eye(4)
    X[..., :dim, :dim] = R
    X[..., :dim, 3] = target - np.einsum("...ij,...j->...i", X[..., :dim, :dim], centre)
    X[bad | loose, :3] = np.nan
    moved = given @ np.swapaxes(X[..., :dim, :dim], -1, -2) + X[..., None, :dim, 3]
    distances = np.linalg.norm(moved - there, axis=-1)
    return PoseFit(X, np.sqrt((distances**2).mean(axis=-1)), distances)


def __getattr__(name: str) -> Any:
    """Raise the error of a function that does not exist, with the nearest names."""
    own = (n for n, x in globals().items() if getattr(x, "__module__", "") == __name__)
    raise_missing_name(__name__, name, (n for n in own if n[0] != "_"))
