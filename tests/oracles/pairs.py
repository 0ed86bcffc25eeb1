"""Kinematic pairs: what a joint holds and what it leaves free, read off the pose X of its frame M
in its frame F.

Every function gives values with their rates: the matrix (..., m, 6) that takes the relative twist
[v; w] to the time derivatives of the m values, where v is the velocity of the origin of M in F and
w the angular velocity of M against F, both in axes of F: dp/dt = v and dR/dt = [w] R. So the rates
are exact for any X, also where a loop is open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kempe import spatial
from kempe.joints import JointType
from kempe.model.implicit_form import (
    find_implicit_form,
    find_screw_pitch,
    has_slide_along_z,
    turn_flat_frame,
)
from kempe.spatial import Array

Rows = tuple[Array, Array]
"""Values (..., m) and rates (..., m, 6)."""

AXES = {"x": 0, "y": 1, "z": 2}
ANGLES_SINGULAR = 1e-9
"""Cosine of ry below which the turns about z and x of three angles are not distinguished."""


@dataclass(frozen=True)
class Hold:
    """What a pair holds: positions ("xy", ...), and rotations: "xyz" all, "xy" z stays parallel to
    z, "x.y" x of F stays normal to y of M, "z" the angle in the plane, "" none. A `pitch` ties the
    slide along z to the turn about z.
    """

    position: str
    turns: str
    pitch: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each row: x, y, z in metres; rx, ry, rz in radians; x.y; screw in metres."""
        turns = ("x.y",) if self.turns == "x.y" else tuple(f"r{a}" for a in self.turns)
        return (*self.position, *turns, *(("screw",) if self.pitch is not None else ()))

    def rows(self, X: Array) -> Rows:
        """How far M is from where the pair lets it be, with rates; zero where it is held."""
        parts = [slides(X, self.position)]
        if self.turns == "xyz":
            parts.append(rotation(X))
        elif self.turns == "xy":
            parts.append(alignment(X))
        elif self.turns == "x.y":
            parts.append(crossing(X))
        elif self.turns == "z":
            parts.append(_stack([turn(X, "z")]))
        if self.pitch is not None:
            parts.append(_screw(X, self.pitch))
        return np.concatenate([v for v, _ in parts], axis=-1), np.concatenate(
            [r for _, r in parts], axis=-2
        )


def hold_of(kind: JointType, dim: int = 3, particle: bool = False) -> Hold | None:
    """What a joint type holds, None where that has no fixed axes; in the plane a slide is along x
    (`turn_flat_frame`).
    """
    form = find_implicit_form(kind, dim, particle)
    if form is not None:
        return Hold(form.position, form.turns)
    pitch = find_screw_pitch(kind) if dim == 3 and not particle else None
    return None if pitch is None else Hold("xy", "xy", pitch)


def frames_of(
    kind: JointType, X_PF: Array, X_CM: Array, dim: int, particle: bool
) -> tuple[Array, Array]:
    """Frames F on the parent and M on the child in which `hold_of` and `read` speak of the joint."""
    if has_slide_along_z(kind, dim, particle):
        return turn_flat_frame(X_PF), turn_flat_frame(X_CM)
    return X_PF, X_CM


def motion(a: tuple[Array, Array, Array], b: tuple[Array, Array, Array]) -> Array:
    """Matrix (..., 6, n) to the twist of B against A, at the origin of B, in axes of A.

    Each end is a pose X_WB, a pose on it, and the Jacobian (..., 6, n) of the first, world-aligned.
    """
    (p_A, J_A, R_A), (p_B, J_B, _) = (_placed(*end) for end in (a, b))
    v = J_B[..., :3, :] - J_A[..., :3, :] + spatial.skew(p_B - p_A) @ J_A[..., 3:, :]
    back = np.swapaxes(R_A, -1, -2)
    return np.concatenate([back @ v, back @ (J_B[..., 3:, :] - J_A[..., 3:, :])], axis=-2)


def _placed(X_WB: Array, X: Array, J: Array) -> tuple[Array, Array, Array]:
    """Origin, world-aligned Jacobian and rotation of a frame at X on one whose Jacobian is J."""
    X_W = X_WB @ X
    J = np.broadcast_to(J, (*X_W.shape[:-2], *J.shape[-2:]))
    shift = spatial.skew(X_WB[..., :3, 3] - X_W[..., :3, 3])
    J = np.concatenate([J[..., :3, :] + shift @ J[..., 3:, :], J[..., 3:, :]], axis=-2)
    return X_W[..., :3, 3], J, X_W[..., :3, :3]


# ---- one thing at a time


def slides(X: Array, axes: str) -> Rows:
    """Positions of M along some axes of F."""
    index = [AXES[a] for a in axes]
    rates = np.zeros((*X.shape[:-2], len(index), 6))
    rates[..., np.arange(len(index)), index] = 1.0
    return X[..., index, 3], rates


def _turning(X: Array) -> Array:
    """Derivatives (..., 3, 3, 3) of the rotation of X by turns about x, y and z of F."""
    return spatial.skew(np.eye(3)) @ X[..., None, :3, :3]


def _angle(X: Array, s: tuple[int, int], c: tuple[int, int]) -> tuple[Array, Array]:
    """atan2 of two entries of the rotation, with its rates (..., 6)."""
    D = _turning(X)
    a = X[..., s[0], s[1]]
    b = X[..., c[0], c[1]]
    square = (a * a + b * b)[..., None]
    with np.errstate(invalid="ignore", divide="ignore"):
        w = (b[..., None] * D[..., s[0], s[1]] - a[..., None] * D[..., c[0], c[1]]) / square
    return np.arctan2(a, b), np.concatenate(
        [np.zeros_like(w), np.where(square > 0.0, w, 0.0)], axis=-1
    )


def turn(X: Array, which: str) -> tuple[Array, Array]:
    """An angle (...) and its rates (..., 6).

    "z" is that of one turn; "rx", "ry" those of a cross; "yaw", "pitch", "roll" those of turns
    about z, y', x''.
    """
    if which in ("z", "yaw"):
        return _angle(X, (1, 0), (0, 0))
    if which == "rx":
        return _angle(X, (2, 1), (1, 1))
    if which == "ry":
        return _angle(X, (0, 2), (0, 0))
    if which == "roll":
        return _angle(X, (2, 1), (2, 2))
    D = _turning(X)
    up = -X[..., 2, 0]
    across = np.hypot(X[..., 0, 0], X[..., 1, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        d_across = (X[..., 0, 0, None] * D[..., 0, 0] + X[..., 1, 0, None] * D[..., 1, 0]) / across[
            ..., None
        ]
    d_across = np.where(across[..., None] > 0.0, d_across, 0.0)
    w = (-across[..., None] * D[..., 2, 0] - up[..., None] * d_across) / (
        up * up + across * across
    )[..., None]
    return np.arctan2(up, across), np.concatenate([np.zeros_like(w), w], axis=-1)


def rotation(X: Array) -> Rows:
    """Rotation vector of M in F (3 rows). Rates: inverse left Jacobian of SO(3) (Chirikjian, 2012,
    section 10.3).
    """
    phi = spatial.log_so3(X[..., :3, :3])
    return phi, _angular(log_rate(phi))


def log_rate(phi: Array) -> Array:
    """Matrix (..., 3, 3) that takes w to the time derivative of the rotation vector, where dR/dt =
    [w] R.
    """
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    small = angle < 1e-3
    half = np.where(small, 0.5, 0.5 * angle)
    factor = np.where(
        small, 1.0 / 12.0 + angle**2 / 720.0, (1.0 - half / np.tan(half)) / (2.0 * half) ** 2
    )
    K = spatial.skew(phi)
    return np.eye(3) - 0.5 * K + factor * (K @ K)


def alignment(X: Array) -> Rows:
    """Rotation vector, about x and y of F, of the smallest turn that takes z of F to z of M (2
    rows).
    """
    z = X[..., :3, 2]
    D = _turning(X)[..., :, 2]
    sine = np.hypot(z[..., 0], z[..., 1])
    cosine = z[..., 2]
    angle = np.arctan2(sine, cosine)
    near = (sine < 1e-3) & (cosine > 0.0)
    safe = np.where(sine > 0.0, sine, 1.0)
    ratio = np.where(near, 1.0 + sine**2 / 6.0 + 3.0 * sine**4 / 40.0, angle / safe)[..., None]
    slope = np.where(near, -1.0 / 3.0 - 2.0 / 15.0 * sine**2, (angle * cosine - sine) / safe**3)[
        ..., None
    ]
    across = np.stack([-z[..., 1], z[..., 0]], axis=-1)
    d_across = np.stack([-D[..., 1], D[..., 0]], axis=-2)
    w = ratio[..., None] * d_across + across[..., :, None] * (slope * D[..., 2])[..., None, :]
    return ratio * across, _angular(w)


def crossing(X: Array) -> Rows:
    """Cosine of the angle between x of F and y of M, which are the axes of a cross (1 row)."""
    return X[..., 0, 1][..., None], _angular(_turning(X)[..., 0, 1][..., None, :])


def _screw(X: Array, pitch: float) -> Rows:
    """How far the slide along z is from the pitch times the turn, by the nearest number of turns."""
    angle, rate = turn(X, "z")
    value, rates = slides(X, "z")
    return value - pitch * (angle + screw_turns(X, pitch, angle))[..., None], rates - pitch * rate[
        ..., None, :
    ]


def screw_turns(X: Array, pitch: float, angle: Array) -> Array:
    """Full turns, in radians, that a screw has made where its slide fits best."""
    if pitch == 0.0:
        return np.zeros_like(angle)
    return 2.0 * math.pi * np.round((X[..., 2, 3] / pitch - angle) / (2.0 * math.pi))


def _angular(w: Array) -> Array:
    return np.concatenate([np.zeros_like(w), w], axis=-1)


def _stack(parts: list[tuple[Array, Array]]) -> Rows:
    return np.stack([v for v, _ in parts], axis=-1), np.stack([r for _, r in parts], axis=-2)


# ---- the coordinates of a joint


def reading_groups(
    kind: JointType, dim: int = 3, particle: bool = False
) -> list[tuple[tuple[int, ...], str]]:
    """The coordinates of a joint by what is read together: one by one, but three angles or a
    quaternion at once.

    Each is "x", "y", "z" a slide, "turn ..." as in `turn`, "screw", "angles" (yaw, pitch, roll) or
    "quaternion".
    """
    form = find_implicit_form(kind, dim, particle)
    if form is None:
        return [((0,), "screw")]
    angles = {how: k for k, how in form.readings if how in ("turn yaw", "turn pitch", "turn roll")}
    out: list[tuple[tuple[int, ...], str]] = []
    for k, how in form.readings:
        if how == "quaternion":
            out.append((tuple(range(k, k + 4)), how))
        elif how not in angles:
            out.append(((k,), how))
        elif k == min(angles.values()):
            out.append((tuple(angles[f"turn {a}"] for a in ("yaw", "pitch", "roll")), "angles"))
    return out


def read(X: Array, kind: str, pitch: float = 0.0) -> tuple[Array, Array]:
    """One coordinate (...) and its rates (..., 6), as `reading_groups` says; angles within a half
    turn of zero.
    """
    if kind in AXES:
        value, rates = slides(X, kind)
        return value[..., 0], rates[..., 0, :]
    angle, rates = turn(X, "z" if kind == "screw" else kind.removeprefix("turn "))
    return (angle + screw_turns(X, pitch, angle) if kind == "screw" else angle), rates


def angle_rows(X: Array, angles: Array) -> tuple[Array, Array, Array]:
    """As `quaternion_rows`, for turns by `angles` (..., 3) about z, y' and x''; derivatives by
    these angles.
    """
    a = spatial.rot_z(angles[..., 0])
    b = spatial.rot_y(angles[..., 1])
    c = spatial.rot_x(angles[..., 2])
    bc = np.swapaxes(b @ c, -1, -2)
    axes = np.stack(
        [
            bc[..., :, 2],
            np.swapaxes(c, -1, -2)[..., :, 1],
            np.broadcast_to([1.0, 0, 0], a.shape[:-1]),
        ],
        -1,
    )
    phi, rates, by_turn = _rotation_rows(X, a @ b @ c)
    return phi, rates, by_turn @ axes


def quaternion_rows(X: Array, quat_wxyz: Array) -> tuple[Array, Array, Array]:
    """Rotation vector (..., 3) from a quaternion to the rotation of X, its rates, and the matrix
    (..., 3, 3) that takes the angular velocity of the quaternion, in its own axes, to the
    derivative.
    """
    return _rotation_rows(X, spatial.quat_wxyz_to_matrix(quat_wxyz))


def _rotation_rows(X: Array, R_own: Array) -> tuple[Array, Array, Array]:
    back = np.swapaxes(R_own, -1, -2)
    phi = spatial.log_so3(back @ X[..., :3, :3])
    M = log_rate(phi)
    return phi, _angular(M @ back), -M
