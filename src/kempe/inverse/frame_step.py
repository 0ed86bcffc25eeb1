"""One step of a frame that its own chain moves, for a twist or towards a pose.

A step is of second order wherever the first order does not halve the error. A step of least
squares takes what is missing for something that the joints can make good. Where they cannot, at
the border of the workspace, at limits or by far, the error stays, and with it the second
derivative of the chain that such a step lacks: it overshoots, and the next one shoots back. So
there the error's own Hessian counts (Newton), in the box of what the limits allow, and a step is
taken where it lowers the error as promised. What cannot be had is then left by speeds that go to
zero, at a local minimum of the error. It is measured as `ik` does, in radians and characteristic
lengths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.forward.fk import query
from kempe.inverse.chain.serial_chain import find_chain
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.numerics.least_squares import (
    NEAR,
    NOISE,
    SHIFT,
    Bend,
    compute_feasible_fraction,
    minimize_damped_residual,
    minimize_quadratic_in_box,
    scale_solution_to_bounds,
    solve_unbounded_wish,
)
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


SLOW = 0.0499
"""Part of its speed above which no joint turns back from one cycle to the next."""


ENOUGH = 1e-26
"""Square of the error that counts as zero: 1e-13 of a length."""
RESIDUAL = 0.5
"""Damping as a part of the error (Levenberg and Marquardt; Sugihara, 2011)."""
ENOUGH_GAIN = 0.75
LITTLE_GAIN = 0.25
"""Decreases of the error, as parts of what a straight way would give, from which a step of first
order counts alone, and up to which one of second order does; between them they are mixed."""
DIFFERENCE = 1e-5
"""Step of the differences of the Jacobian, in radians and characteristic lengths."""
LARGEST = 0.5
ASIDE = 0.05
"""Longest step of a coordinate where no speed bounds it, and where a singular configuration is
left."""
FLAT = 1e-10
SADDLE = 1e-6
"""Parts of the largest curvature: up to the first it counts as none, below minus the second as
negative."""
TAKEN = 0.1
STRICT = 0.5
"""Part of the promised decrease that must be had; more than half of it where a direction is
kept."""
STILL = 1e-20
BLIND = 1e-13
"""Promised decreases, as parts of the square of the error, below which one rests, or rounding hides
the true one."""
ROUNDING = 1e-28
"""Promised decrease below which one rests, however small the error is."""
LITTLE = 0.01
LEADS = 0.05
"""Decreases of the error, as parts of what the joints move: up to the first no direction is kept,
from the second on it alone counts; between them the straight step and the one towards the nearest
pose are mixed."""
LITTLE_USE = 0.1
MUCH_USE = 0.5
"""The same for the part of the speed, or of the rest of the way, that a straight step makes use
of."""
TRIALS = 16
HALVINGS = 6
"""Steps tried in one cycle, each shorter than the one before; halvings of a step in a direction
that is kept."""


def compute_pose_error(goal: Array, pose: Array) -> Array:
    """Compute the error (6,) of a pose: [position; rotation vector] in ground axes."""
    out = np.empty(6)
    out[:3] = goal[:3, 3] - pose[:3, 3]
    R = goal[:3, :3] @ pose[:3, :3].T
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    x = 0.5 * (h - f)
    y = 0.5 * (c - g)
    z = 0.5 * (d - b)
    cosine = 0.5 * (a + e + i - 1.0)
    if not cosine > -0.9:  # the antisymmetric part fades
        out[3:] = spatial.log_so3(R)
        return out
    sine = math.sqrt(x * x + y * y + z * z)
    factor = math.atan2(sine, cosine) / sine if sine > 1e-8 else 1.0
    out[3] = factor * x
    out[4] = factor * y
    out[5] = factor * z
    return out


# ---- towards a pose


class Approach:
    """One step from q (nq,) towards a pose: `velocity` (n,) of the chain, and `q` after it."""

    def __init__(
        self,
        servo: Servo,
        q: Array,
        goal: Array,
        pose: Array,
        J: Array,
        dt: float,
        weights: Array | None,
        slow: float,
    ):
        self.servo = servo
        self.before = q
        self.goal = goal
        self.dt = dt
        self.slow = slow
        self.calm = False
        """A speed that no joint exceeds in the next cycle, where it is `calm`."""
        self.e = compute_pose_error(goal, pose)
        self.J = J
        self.metric = servo.metric if weights is None else servo.metric * weights
        self.missing = self.metric * self.e
        self.even = weights is None or weights[3] == weights[4] == weights[5]
        """Whether the logarithm's own derivative leaves the gradient alone."""
        self.A = (
            self.metric[:, None]
            * (J if self.even else convert_angular_rows(self.e[3:], J))
            * servo.unit
        )
        self.square = float(self.missing @ self.missing)

    def compute_velocity(
        self, low: Array, high: Array, damping: float, weights: Array | None, direction: bool
    ) -> Array:
        """Compute velocities (n,) in the box: straight towards the pose, then to the nearest one.

        The direction is kept only where `direction` asks for it.
        """
        rest = np.minimum(np.maximum(0.0, low), high)
        if self.square <= ENOUGH or not len(low):
            return rest
        twist = self.e / self.dt
        A, b = (self.J, twist) if weights is None else (weights[:, None] * self.J, weights * twist)
        if not direction:
            return self.approach_nearest_pose(A, b, low, high, rest, damping, weights)
        bend = self.servo.make_bend(self.before, weights)
        straight = self.shorten_velocity(
            scale_solution_to_bounds(A, b, low, high, self.dt, bend, near=self.servo.near)
        )
        unit = self.servo.unit
        share = compute_progress(
            self.A, self.missing / self.dt, straight / unit, low / unit, high / unit
        )
        if share == 1.0:
            return straight
        return share * straight + (1.0 - share) * self.approach_nearest_pose(
            A, b, low, high, rest, damping, weights
        )

    def approach_nearest_pose(
        self,
        A: Array,
        b: Array,
        low: Array,
        high: Array,
        rest: Array,
        damping: float,
        weights: Array | None,
    ) -> Array:
        """Compute velocities (n,) in the box that lower the error by any way.

        Limits of speed shorten the step that limits of position leave: so all joints arrive
        together.
        """
        near = self.servo.near
        wished = solve_unbounded_wish(A, b, damping, near, RESIDUAL * math.sqrt(self.square))
        x = wished.x
        least, most = self.servo.compute_velocity_bounds(self.before, self.dt, self.servo.unbounded)
        if whole := bool((x >= least).all() and (x <= most).all()):
            part = compute_feasible_fraction(x, low, high)
        else:
            x = minimize_damped_residual(
                A, b, least, most, damping, near=near, shift=SHIFT, wished=wished
            )
            part = 0.0 if rest.any() else compute_feasible_fraction(x, low, high)
        part = min(part, LARGEST / max(float(np.abs(x * self.dt / self.servo.unit).max()), 1e-300))
        left = self.compute_remaining_error(part * x) if part else self.square
        gain = (1.0 - math.sqrt(left / self.square)) / part if part else 0.0
        if gain >= ENOUGH_GAIN:
            self.calm = whole and part == 1.0 and self.has_arrived(left, wished.s[-1], weights)
            return part * x
        y = self.compute_second_order_velocity(least, most, wished.rows)
        if rest.any():
            return np.minimum(np.maximum(y, low), high)
        y = compute_feasible_fraction(y, low, high) * y
        share = max(0.0, (gain - LITTLE_GAIN) / (ENOUGH_GAIN - LITTLE_GAIN))
        return share * part * x + (1.0 - share) * y

    def has_arrived(self, left: float, smallest: float, weights: Array | None) -> bool:
        """Whether the squared error is so small that the next velocities are small, too."""
        servo = self.servo
        if weights is not None or smallest < servo.near:
            return False
        return (
            2.0 * math.sqrt(left) * max(1.0, 1.0 / servo.metric[0])
            <= smallest * self.dt * self.slow
        )

    def compute_remaining_error(self, velocity: Array) -> float:
        """Compute the squared error after velocities (n,)."""
        servo = self.servo
        pose = servo.query(servo.take_step(self.before, servo.expand_velocities(velocity), self.dt))
        missing = self.metric * compute_pose_error(self.goal, pose)
        return float(missing @ missing)

    def shorten_velocity(self, velocity: Array) -> Array:
        """Halve velocities (n,) until they lower the error by half of the predicted decrease.

        Zero where that is next to nothing for what the joints move: there the direction leads no
        farther.
        """
        velocity = np.where(np.abs(velocity) > NOISE * np.abs(velocity).max(), velocity, 0.0)
        z = velocity * self.dt / self.servo.unit
        slope = 2.0 * float(self.missing @ (self.A @ z))
        if slope <= 2.0 * LITTLE * math.sqrt(self.square * float(z @ z)) + ROUNDING:
            return 0.0 * velocity
        for _ in range(HALVINGS):
            if self.compute_remaining_error(velocity) <= self.square - STRICT * slope:
                return velocity
            velocity = 0.5 * velocity
            slope = 0.5 * slope
        return 0.0 * velocity

    def compute_second_order_velocity(self, low: Array, high: Array, damping: Array) -> Array:
        """Compute velocities (n,) in the box that minimise the error to second order.

        Only velocities that lower the error itself are returned.
        """
        unit = self.servo.unit
        dt = self.dt
        least = np.maximum(low * dt / unit, -LARGEST)
        most = np.minimum(high * dt / unit, LARGEST)
        rest = np.minimum(np.maximum(0.0, least), most)
        push = self.A.T @ self.missing
        H = self.compute_hessian()
        strength = np.abs(H).max(axis=1)
        idle = strength <= FLAT * strength.max()
        weak = damping * unit
        model = H + weak.T @ weak if len(weak) else H
        more = 0.0
        for _ in range(TRIALS):
            z, curvature, way = compute_newton_step(model, push, least, most)
            z[idle] = rest[idle]
            promise = 2.0 * float(push @ z) - float(z @ H @ z)
            # damping hides where the error itself curves down
            if promise <= BLIND * self.square and len(weak):
                curvature, way = compute_newton_step(H, push, least, most)[1:]
            if promise <= BLIND * self.square and curvature < 0.0:
                z = move_along_direction(z, way if push @ way >= 0.0 else -way, least, most)
                promise = 2.0 * float(push @ z) - float(z @ H @ z)
            if rest.any():  # what is outside its limits comes back
                return unit * z / dt
            if 0.0 <= promise <= STILL * self.square + ROUNDING:
                break
            if (
                0.0 < promise <= BLIND * self.square
                or self.compute_remaining_error(unit * z / dt) <= self.square - TAKEN * promise
            ):
                return unit * z / dt
            more = max(4.0 * more, 1e-3 * float(np.abs(model).max()))
            model = model + more * np.eye(len(z))
        return rest

    def compute_hessian(self) -> Array:
        """Compute the Hessian (n, n) of half the squared error, in rad and characteristic lengths.

        Of the chain's second derivatives by differences of its Jacobian, of the logarithm by its
        own derivative (Bullo and Murray, 1995).
        """
        servo = self.servo
        w = self.metric
        if not self.even:
            return self.compute_difference_hessian()
        J = servo.query.pose_and_jacobian(
            servo.make_neighbour_configurations(self.before, DIFFERENCE * servo.unit)
        )[1]
        ahead = J[: len(servo.v)]
        behind = J[len(servo.v) :]
        rate = w[:, None] * convert_angular_rows(self.e[3:], self.J) * servo.unit
        forces = ((w * self.missing) @ (ahead - behind))[:, servo.v] * servo.unit
        H = self.A.T @ rate - forces / (2.0 * DIFFERENCE)
        return 0.5 * (H + H.T)

    def compute_difference_hessian(self) -> Array:
        """Compute the Hessian (n, n) by differences of the gradient, for unequal weights of turns."""
        servo = self.servo
        w = self.metric
        pushes: list[Array] = []
        for q in servo.make_neighbour_configurations(self.before, DIFFERENCE * servo.unit):
            pose, J = servo.query.pose_and_jacobian(q)
            e = compute_pose_error(self.goal, pose)
            pushes.append(
                (w * e) @ (w[:, None] * convert_angular_rows(e[3:], J[:, servo.v]) * servo.unit)
            )
        ahead, behind = np.reshape(pushes, (2, len(servo.v), len(servo.v)))
        H = (behind - ahead) / (2.0 * DIFFERENCE)
        return 0.5 * (H + H.T)


def compute_progress(A: Array, b: Array, x: Array, low: Array, high: Array) -> float:
    """Compute how far straight velocities x (n,) in a box lead on, from 0 to 1.

    By the decrease of what is missed for what the joints move, and by how much of the room that the
    box and the rest of the way leave is used: close to a singular configuration it is little.
    """
    wish = math.sqrt(float(b @ b))
    size = math.sqrt(float(x @ x))
    had = float(b @ (A @ x))
    if not had > 0.0:
        return 0.0
    gain = had / (wish * size)
    room = np.where(x > 0.0, high, -low)
    used = max(had / wish**2, float(np.max(np.abs(x) / np.maximum(room, 1e-300))))
    return min(
        1.0,
        max(0.0, (gain - LITTLE) / (LEADS - LITTLE)),
        max(0.0, (used - LITTLE_USE) / (MUCH_USE - LITTLE_USE)),
    )


def convert_angular_rows(r: Array, J: Array) -> Array:
    """Convert the angular rows of a Jacobian (6, n) to rates of the rotation vector r."""
    angle = math.sqrt(float(r @ r))
    gamma = 0.5 * angle / math.tan(0.5 * angle) if angle > 1e-3 else 1.0 - angle * angle / 12.0
    rest = (1.0 - gamma) / (angle * angle) if angle > 1e-3 else 1.0 / 12.0
    x, y, z = (0.5 * r).tolist()
    M = 4.0 * rest * np.array([[x * x, x * y, x * z], [x * y, y * y, y * z], [x * z, y * z, z * z]])
    M += np.array([[gamma, -z, y], [z, gamma, -x], [-y, x, gamma]])
    out = J.copy()
    out[3:] = M @ J[3:]
    return out


def compute_newton_step(
    H: Array, push: Array, low: Array, high: Array
) -> tuple[Array, float, Array]:
    """The z (n,) in a box that makes z H z / 2 - push z least, H's curvatures made positive; also
    the least curvature of what is free, where it is negative, and its direction (n,).
    """
    values, V = np.linalg.eigh(H)
    most = max(float(-values[0]), float(values[-1]), 1e-300)
    if values[0] > FLAT * most:
        return minimize_quadratic_in_box(H, push, low, high)[0], 0.0, push
    size = np.abs(values)
    size[size <= FLAT * most] = most  # nothing is gained there
    z, free = minimize_quadratic_in_box((V * size) @ V.T, push, low, high)
    own = free.nonzero()[0]
    if values[0] >= -SADDLE * most or not len(own):
        return z, 0.0, z
    some, W = np.linalg.eigh(H[own[:, None], own])
    if some[0] >= FLAT * most:  # convex in what is free: its own curvature, not one made larger
        x = z.copy()
        x[own] = np.linalg.solve(H[own[:, None], own], push[own] - H[own] @ np.where(free, 0.0, z))
        x = np.minimum(np.maximum(x, low), high)
        return x if 2.0 * push @ x - x @ H @ x > 2.0 * push @ z - z @ H @ z else z, 0.0, z
    way = np.zeros(len(z))
    way[own] = W[:, 0]
    return z, min(float(some[0]) + SADDLE * most, 0.0), way


def move_along_direction(z: Array, way: Array, low: Array, high: Array) -> Array:
    """Move z (n,) along a direction as far as the box and a small step allow."""
    moves = np.abs(way) > 1e-12
    room = np.where(way > 0.0, high - z, z - low)[moves] / np.abs(way[moves])
    return np.minimum(np.maximum(z + min(ASIDE, float(room.min(initial=ASIDE))) * way, low), high)


# ---- the step at a configuration


class Move(NamedTuple):
    """Velocities (n,) of a chain at a configuration, their box, the Jacobian (6, n), and the twist
    that is wanted.

    `calm` says that no joint turns back after the step, by a bound on second derivatives.
    """

    velocity: Array
    low: Array
    high: Array
    J: Array
    twist: Array
    calm: bool


class Servo:
    """Quantities of a frame's steps that do not depend on the configuration."""

    def __init__(self, system: Model, frame: str):
        self.system = system
        self.frame = frame
        self.query = query(system, frame)
        chain = find_chain(system, frame)
        self.v = chain.v_index
        reach = min((b.largest for b in chain.bounds), default=math.inf)
        self.near = NEAR * min(1.0, reach) if reach > 0.0 else NEAR
        """Singular values to be damped: metres, so less where the whole chain is shorter than
        one."""
        layout = system.structure.layout
        place = dict(zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True))
        limited = [(k, place[v]) for k, v in enumerate(self.v.tolist()) if v in place]
        self.at_v = np.array([k for k, _ in limited], dtype=np.int64)
        self.at_q = np.array([i for _, i in limited], dtype=np.int64)
        own = self.v[self.at_v]
        self.lower = system.lower[own]
        self.upper = system.upper[own]
        self.speed = system.structure.velocity_limits[self.v]
        self.upcoming: tuple[Any, Any] = None, None
        """A move that was computed ahead, after what asks for it: the next cycle mostly does."""
        self.unbounded = np.full(len(self.v), math.inf)
        self.plain = len(limited) == len(self.v)
        self.ahead, self.behind = np.arange(2 * len(self.v)).reshape(2, -1)
        self.names = [system.structure.velocity_names[int(i)] for i in self.v]
        length = compute_characteristic_length(system)
        slides = ~system.structure.coordinates.turning[self.v]
        slides[~np.isin(self.v, system.structure.layout.vector_v)] = False
        self.metric = np.array([1.0 / length] * 3 + [1.0] * 3)
        """What weighs the error of a pose as `ik` does."""
        self.unit = np.where(slides, length, 1.0)

    def compute_move(
        self,
        q: Array,
        x: Array,
        dt: float,
        fastest: Array,
        damping: float,
        direction: bool,
        weights: Array | None,
    ) -> Move:
        """Compute the velocities for a twist (6,) or towards a pose (4, 4), at q (nq,)."""
        pose, J = self.query.pose_and_jacobian(q)
        J = J[:, self.v]
        w = weights
        low, high = self.compute_velocity_bounds(q, dt, fastest)
        if x.ndim == 2:
            approach = Approach(
                self, q, x, pose, J, dt, w, SLOW * float(fastest.min(initial=math.inf))
            )
            own = approach.compute_velocity(low, high, damping, w, direction)
            return Move(own, low, high, J, approach.e / dt, approach.calm)
        A, b = (J, x) if w is None else (w[:, None] * J, w * x)
        wished = solve_unbounded_wish(A, b, damping, self.near)
        if (
            len(wished.s)
            and wished.s[-1] >= self.near
            and (not direction or len(A) <= len(wished.s))
        ):
            own = wished.x  # regular
            if (own >= low).all() and (own <= high).all():
                bound = dt * math.sqrt(len(own)) * float(wished.s[0] * (own @ own) / wished.s[-1])
                calm = bound <= SLOW * float(fastest.min()) and self.has_room(q, own, dt)
                return Move(own, low, high, J, x, calm)
        bend = self.make_bend(q, w)
        if direction:
            own = scale_solution_to_bounds(A, b, low, high, dt, bend, near=self.near)
        else:
            own = minimize_damped_residual(
                A, b, low, high, damping, near=self.near, bend=bend, shift=SHIFT, wished=wished
            )
        return Move(own, low, high, J, x, False)

    def has_room(self, q: Array, velocity: Array, dt: float) -> bool:
        """Whether two such steps meet no limit of position."""
        x = q[self.at_q] + 2.0 * dt * velocity[self.at_v]
        return bool((x >= self.lower).all() and (x <= self.upper).all())

    def compute_velocity_bounds(self, q: Array, dt: float, speed: Array) -> tuple[Array, Array]:
        """Compute bounds (n,) of velocities that keep limits of position and speed after dt.

        What is outside its limits comes back as fast as it may.
        """
        x = q[self.at_q]
        low = -speed
        high = speed.copy()
        low[self.at_v] = np.minimum(
            np.maximum(low[self.at_v], (self.lower - x) / dt), speed[self.at_v]
        )
        high[self.at_v] = np.maximum(
            np.minimum(high[self.at_v], (self.upper - x) / dt), -speed[self.at_v]
        )
        return low, high

    def make_bend(self, q: Array, weights: Array | None) -> Bend:
        """Make the function that gives second derivatives (k, 6, n) along directions (k, n).

        They are central differences of the Jacobian, whose rows are weighted.
        """

        def compute_bends(ways: Array) -> Array:
            size = np.abs(ways / self.unit).max(axis=1)
            steps = np.zeros((len(ways), self.system.nv))
            steps[:, self.v] = (DIFFERENCE / np.where(size > 0.0, size, 1.0))[:, None] * ways
            ends = self.system.structure.layout.integrate_velocity(
                q, np.concatenate([steps, -steps])
            )
            J = self.query.pose_and_jacobian(ends)[1][:, :, self.v]
            out = (J[: len(ways)] - J[len(ways) :]) * (size / (2.0 * DIFFERENCE))[:, None, None]
            return out if weights is None else weights[:, None] * out

        return compute_bends

    def expand_velocities(self, velocity: Array) -> Array:
        """Expand velocities (n,) of the chain to those (nv,) of the system; others are zero."""
        out = np.zeros(self.system.nv)
        out[self.v] = velocity
        return out

    def make_neighbour_configurations(self, q: Array, step: Array) -> Array:
        """Make configurations (2 n, nq) with each coordinate moved by plus and minus its step."""
        n = len(self.v)
        if self.plain:
            out = np.broadcast_to(q, (2 * n, len(q))).copy()
            out[self.ahead, self.at_q] += step
            out[self.behind, self.at_q] -= step
            return out
        moves = np.zeros((2 * n, self.system.nv))
        moves[range(n), self.v] = step
        moves[range(n, 2 * n), self.v] = -step
        return self.system.structure.layout.integrate_velocity(q, moves)

    def take_step(self, q: Array, velocity: Array, dt: float) -> Array:
        """Compute the configuration (nq,) after dt, with limits kept exactly where q kept them."""
        if not self.plain:
            out = self.system.structure.layout.integrate_velocity(q, velocity * dt)
        else:
            out = q.copy()
            out[self.at_q] += velocity[self.v] * dt
        x = q[self.at_q]
        out[self.at_q] = np.minimum(
            np.maximum(out[self.at_q], np.minimum(self.lower, x)), np.maximum(self.upper, x)
        )
        return out
