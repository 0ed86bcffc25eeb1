"""The motion of a joint of any type: its pose and twists at given coordinates, and coordinates that
fit a pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe import spatial
from kempe.description.parts import Joint
from kempe.joints import P, Q, R
from kempe.spatial import Array
from oracles import pairs

if TYPE_CHECKING:
    from kempe.system import System

STARTS = 16
STEPS = 60
POLISH = 4
"""Starts of a fit, its damped steps, and Newton steps after them."""
AT_LEAST = 12
SETTLED = 1e-6
"""Steps that every start of a fit has, and the length of the best start's step from which Newton
steps go on."""
FITS = 1e-13
"""Residual, in metres and radians, at which a fit is done."""
AS_GOOD = 1e-9
"""Residuals that differ by less are equally good: the coordinates nearest to the given ones
count."""
FLAT = 1e-10
"""Singular values below this part of the largest count as zero: coordinates that the pose does not
tell stay."""

_TURNS = (spatial.rot_x, spatial.rot_y, spatial.rot_z)


class Step(NamedTuple):
    """A primitive: kind, axis (0, 1, 2), multiplier, its first value and velocity; or a quaternion
    that is held.
    """

    kind: int
    axis: int
    multiplier: float
    value: int
    velocity: int
    held: Array | None = None


@dataclass(frozen=True, eq=False)
class Motion:
    """The primitives of a joint, by `values` (..., n) of the coordinates `names`; a held quaternion
    has none.

    `keep` are the rows of a twist [v; w] that count: all in space, three in the plane, the position
    of a particle.
    """

    steps: tuple[Step, ...]
    names: tuple[str, ...]
    keep: tuple[int, ...]
    size: int
    """Number of velocities."""
    ball: int
    """First value and velocity of the quaternion, (-1) where there is none."""

    @property
    def plain(self) -> list[tuple[int, int]]:
        """Value and velocity of each coordinate that is part of no quaternion."""
        return sorted({(s.value, s.velocity) for s in self.steps if s.kind != Q})

    def turning(self) -> list[int]:
        """Values that a full turn leaves as they are."""
        slow = {s.value for s in self.steps if s.kind == P or not float(s.multiplier).is_integer()}
        return [i for i, _ in self.plain if i not in slow]

    def at(self, values: Array) -> tuple[Array, Array]:
        """Pose X_FM (..., 4, 4), and twists (..., 6, primitives) of M in its own axes; a quaternion
        has three.
        """
        X = np.array(np.broadcast_to(np.eye(4), (*values.shape[:-1], 4, 4)))
        parts: list[tuple[Array, Array | None]] = []  # axis and, for turns, a point of it
        for s in self.steps:
            if s.held is not None:
                X[..., :3, :3] = X[..., :3, :3] @ s.held
            elif s.kind == Q:
                quat = values[..., s.value : s.value + 4]
                X[..., :3, :3] = X[..., :3, :3] @ spatial.quat_wxyz_to_matrix(quat)
                parts += [(X[..., :3, i].copy(), X[..., :3, 3].copy()) for i in range(3)]
            else:
                axis = X[..., :3, s.axis].copy()
                amount = s.multiplier * values[..., s.value]
                parts.append((s.multiplier * axis, X[..., :3, 3].copy() if s.kind == R else None))
                if s.kind == P:
                    X[..., :3, 3] += amount[..., None] * axis
                else:
                    X[..., :3, :3] = X[..., :3, :3] @ _TURNS[s.axis](amount)
        out = np.zeros((*values.shape[:-1], 6, len(parts)))
        back = np.swapaxes(X[..., :3, :3], -1, -2)
        for k, (axis, point) in enumerate(parts):
            if point is None:
                out[..., :3, k] = (back @ axis[..., None])[..., 0]
            else:
                out[..., :3, k] = (back @ np.cross(axis, X[..., :3, 3] - point)[..., None])[..., 0]
                out[..., 3:, k] = (back @ axis[..., None])[..., 0]
        return X, out

    def owners(self) -> Array:
        """Matrix (twists of `at`, velocities): which velocity moves which twist."""
        places = [s.velocity + i for s in self.steps if s.held is None for i in range(_count(s))]
        return np.eye(self.size)[places] if places else np.zeros((0, self.size))

    def error(self, X: Array, values: Array) -> Error:
        """How far a pose X (..., 4, 4) of M in F is from where the values put it."""
        predicted, twists = self.at(values)
        back = np.swapaxes(predicted[..., :3, :3], -1, -2)
        off = (back @ (X[..., :3, 3] - predicted[..., :3, 3])[..., None])[..., 0]
        phi = spatial.log_so3(back @ X[..., :3, :3])
        rate = pairs.log_rate(phi)
        own = twists @ self.owners()
        by_pose = np.zeros((*off.shape[:-1], 6, 6))
        by_pose[..., :3, :3], by_pose[..., 3:, 3:] = back, rate @ back
        slides = spatial.skew(off) @ own[..., 3:, :] - own[..., :3, :]
        by_own = np.concatenate([slides, -rate @ own[..., 3:, :]], axis=-2)
        counts = np.isin(np.arange(6), self.keep).astype(float)
        return Error(
            np.concatenate([off, phi], axis=-1) * counts,
            by_pose * counts[:, None],
            by_own * counts[:, None],
            own,
            twists,
        )

    def moved(self, values: Array, by: Array) -> Array:
        """Values after a step (..., velocities)."""
        out = np.array(np.broadcast_to(values, (*by.shape[:-1], values.shape[-1])))
        for value, velocity in self.plain:
            out[..., value] += by[..., velocity]
        for s in self.steps:
            if s.kind == Q and s.held is None:
                i = s.value
                turn = spatial.quat_wxyz_exp(by[..., s.velocity : s.velocity + 3])
                out[..., i : i + 4] = spatial.unit(
                    spatial.quat_wxyz_multiply(spatial.unit(out[..., i : i + 4]), turn)
                )
        return out

    def slope(self, e: Error) -> tuple[Array, Array]:
        """Derivatives of own^T value, zero at the best fit: by the velocities, and by the twist of
        the pose.
        """
        a = e.twists[..., :, None]
        b = e.twists[..., None, :]
        v = _cross(a[..., 3:, :, :], b[..., :3, :, :]) - _cross(b[..., 3:, :, :], a[..., :3, :, :])
        bracket = np.concatenate([v, _cross(a[..., 3:, :, :], b[..., 3:, :, :])], axis=-3)
        step = np.array(
            [k for k, s in enumerate(self.steps) if s.held is None for _ in range(_count(s))],
            dtype=int,
        )
        curved = np.sum(e.value[..., :, None, None] * bracket, axis=-3) * (step[:, None] < step)
        turned = np.swapaxes(e.own, -1, -2)
        owners = self.owners()
        return owners.T @ curved @ owners + turned @ e.by_own, turned @ e.by_pose

    def fit(self, X: Array, near: Array | None = None) -> Array:
        """Values (..., n) that put M nearest to X (..., 4, 4); of several those nearest to `near`
        (default: zero).
        """
        lead = X.shape[:-2]
        home = (
            np.zeros((*lead, len(self.names)))
            if near is None
            else np.broadcast_to(near, (*lead, len(self.names)))
        )
        if near is None and self.ball >= 0:
            home[..., self.ball] = 1.0
        X, starts = X[..., None, :, :], self._starts(X, home)
        values = starts
        e = self.error(X, starts)
        damping = np.full((*starts.shape[:-1], 1, 1), 1e-3)
        for k in range(STEPS):
            size = _size(e)
            best = np.argmin(size, axis=-1)[..., None]
            if np.all(size.min(axis=-1) < FITS):
                break
            T = np.swapaxes(e.by_own, -1, -2)
            step = np.linalg.solve(
                T @ e.by_own + damping * np.eye(self.size), T @ -e.value[..., None]
            )[..., 0]
            if k >= AT_LEAST and np.all(
                np.take_along_axis(np.linalg.norm(step, axis=-1), best, axis=-1) < SETTLED
            ):
                break
            tried = self.moved(values, np.asarray(step, dtype=float))
            new = self.error(X, tried)
            better = _size(new) < size
            values = np.where(better[..., None], tried, values)
            e = _pick(better, new, e)
            damping = np.clip(np.where(better[..., None, None], 0.2, 5.0) * damping, 1e-12, 1e6)
        return self._polished(X[..., 0, :, :], self._nearest(values, _size(e), home))

    def _starts(self, X: Array, home: Array) -> Array:
        """Values (..., STARTS, n) from which to fit: `home` first, then others all over."""
        rng = np.random.default_rng(0)
        out = np.repeat(home[..., None, :], STARTS, axis=-2)
        far = np.linalg.norm(X[..., :3, 3], axis=-1)[..., None]
        turning = self.turning()
        for value, _ in self.plain:
            turns = [
                abs(s.multiplier)
                for s in self.steps
                if s.value == value and s.kind == R and s.multiplier
            ]
            reach = np.pi / min(turns) if turns or value in turning else 2.0 * far
            out[..., 1:, value] += reach * rng.uniform(-1.0, 1.0, STARTS - 1)
        if self.ball >= 0:
            out[..., 1:, self.ball : self.ball + 4] = spatial.unit(rng.normal(size=(STARTS - 1, 4)))
        return out

    def _nearest(self, values: Array, size: Array, home: Array) -> Array:
        """Of values (..., k, n) with residuals (..., k) the best, and of equally good ones the
        nearest to `home`.
        """
        home = home[..., None, :]
        turning = self.turning()
        values[..., turning] += (
            2.0 * np.pi * np.round((home - values)[..., turning] / (2.0 * np.pi))
        )
        if self.ball >= 0:
            ball = slice(self.ball, self.ball + 4)
            opposite = np.sum(values[..., ball] * home[..., ball], axis=-1) < 0.0
            values[..., ball] = np.where(opposite[..., None], -values[..., ball], values[..., ball])
        good = size <= size.min(axis=-1, keepdims=True) + AS_GOOD
        apart = np.where(good, np.linalg.norm(values - home, axis=-1), np.inf)
        best = np.argmin(apart, axis=-1)[..., None, None]
        return np.take_along_axis(values, best, axis=-2)[..., 0, :]

    def _polished(self, X: Array, values: Array) -> Array:
        """The values after a few Newton steps, where they help."""
        e = self.error(X, values)
        for _ in range(POLISH):
            by_own, _ = self.slope(e)
            step = -np.linalg.pinv(by_own, rcond=FLAT) @ _gradient(e)[..., None]
            tried = self.moved(values, step[..., 0])
            new = self.error(X, tried)
            better = np.linalg.norm(_gradient(new), axis=-1) < np.linalg.norm(_gradient(e), axis=-1)
            better &= _size(new) <= _size(e) + AS_GOOD
            values = np.where(better[..., None], tried, values)
            e = _pick(better, new, e)
        return values


class Error(NamedTuple):
    """How far M is from where values put it: position and rotation vector (..., 6) in axes of the M
    that they predict.

    What does not count is zero. `by_pose` (..., 6, 6) and `by_own` (..., 6, velocities) are its
    derivatives by the twist of M against F in axes of F and by the velocities, `own` and `twists`
    the twists of the predicted M.
    """

    value: Array
    by_pose: Array
    by_own: Array
    own: Array
    twists: Array


def motion_of(system: System, joint: Joint, flat: bool) -> Motion:
    """The motion of a joint of a system; `flat`: its slides along z of F are along x of the turned
    frame.
    """
    particle = system.mechanism.bodies[joint.child].particle
    names = system.structure.coordinates_of_joint(joint.name)
    primitives = joint.type.layout(system.dim, particle)[1]
    held = {
        k
        for p in primitives
        if p.kind == Q and names[p.coordinate] in system.structure.couplings
        for k in range(p.coordinate, p.coordinate + 4)
    }
    value = {k: i for i, k in enumerate(k for k in range(len(names)) if k not in held)}
    velocity: dict[int, int] = {}
    steps = []
    size = 0
    ball = -1
    for p in primitives:
        if p.coordinate in held:
            quat = [
                system.structure.couplings[n].offset for n in names[p.coordinate : p.coordinate + 4]
            ]
            steps.append(Step(Q, 2, 1.0, -1, -1, spatial.quat_wxyz_to_matrix(spatial.unit(quat))))
            continue
        if p.coordinate not in velocity:
            velocity[p.coordinate] = size
            size = size + (3 if p.kind == Q else 1)
        ball = value[p.coordinate] if p.kind == Q else ball
        axis = 0 if flat else "xyz".index(p.axis)
        steps.append(Step(p.kind, axis, p.multiplier, value[p.coordinate], velocity[p.coordinate]))
    keep = range(system.dim) if particle else (0, 1, 5) if system.dim == 2 else range(6)
    free = tuple(n for k, n in enumerate(names) if k not in held)
    return Motion(tuple(steps), free, tuple(keep), size, ball)


def _count(step: Step) -> int:
    """How many velocities a step has."""
    return 3 if step.kind == Q else 1


def _gradient(e: Error) -> Array:
    """What is zero at the best fit (..., velocities)."""
    return (np.swapaxes(e.own, -1, -2) @ e.value[..., None])[..., 0]


def _size(e: Error) -> Array:
    return np.linalg.norm(e.value, axis=-1)


def _pick(which: np.ndarray, a: Error, b: Error) -> Error:
    """The first of two where `which` says so."""
    return Error(
        *(
            np.where(which[(..., *[None] * (x.ndim - which.ndim))], x, y)
            for x, y in zip(a, b, strict=True)
        )
    )


def _cross(a: Array, b: Array) -> Array:
    """Cross products of vectors along the third axis from the end."""
    return np.cross(a, b, axis=-3)
