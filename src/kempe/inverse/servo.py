"""`ik_step`: velocities of one step that give a frame a twist or lead it to a pose, within limits.

Loops and relations stay closed. Several tasks are met in order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.answers.answer import Answer
from kempe.arguments import brief, explained, explained_methods
from kempe.arrays import reals
from kempe.assemble.nearest_exact import ideal_of
from kempe.equations.closure_rows import evaluate, full
from kempe.equations.one_sided import one_sided_rows
from kempe.equations.slip import at_rest, hard_rows, rolls
from kempe.equations.velocity import row_names
from kempe.errors import InputError
from kempe.forward.fk import query, refuse_bad
from kempe.inverse.chain.serial_chain import chain_of, obstacle
from kempe.kernels.forward.table_layout import BALL, TURN
from kempe.model.characteristic_length import characteristic_length
from kempe.model.configurations import as_q
from kempe.model.model import kept
from kempe.model.own_tree import own_tree
from kempe.numerics.least_squares import (
    LEAST,
    NEAR,
    NOISE,
    SHIFT,
    Bend,
    bounded,
    damped,
    least_in_box,
    part_within,
    scaled,
    wish,
)
from kempe.numerics.rank import null_space
from kempe.poses import arrays, sound
from kempe.report import by_code
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.equations.packed_tasks import Packed
    from kempe.inverse.tasks.demands import Demands
    from kempe.model.model import FrameLike, Model


# ---- steps of one frame towards a pose

# A step is of second order wherever the first order does not halve the error. A step of least
# squares takes what is missing for something that the joints can make good. Where they cannot, at
# the border of the workspace, at limits or by far, the error stays, and with it the second
# derivative of the chain that such a step lacks: it overshoots, and the next one shoots back. So
# there the error's own Hessian counts (Newton), in the box of what the limits allow, and a step is
# taken where it lowers the error as promised. What cannot be had is then left by speeds that go to
# zero, at a local minimum of the error. It is measured as `ik` does, in radians and characteristic
# lengths.

POSE_ENOUGH = 1e-26
"""Square of the error that counts as zero: 1e-13 of a length."""
RESIDUAL = 0.5
"""Damping as a part of the error (Levenberg and Marquardt; Sugihara, 2011)."""
ENOUGH_GAIN = 0.75
LITTLE_GAIN = 0.25
"""Decreases of the error, as parts of what a straight way would give, from which a step of first
order counts alone, and up to which one of second order does; between them they are mixed."""
POSE_DIFFERENCE = 1e-5
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
POSE_ROUNDING = 1e-28
"""Promised decrease below which one rests, however small the error is."""
LITTLE = 0.01
LEADS = 0.05
"""Decreases of the error, as parts of what the joints move: up to the first no direction is kept,
from the second on it alone counts; between them the straight step and the one towards the nearest
pose are mixed."""
POSE_SLOW = 0.1
FAST = 0.5
"""The same for the part of the speed, or of the rest of the way, that a straight step makes use
of."""
TRIALS = 16
POSE_HALVINGS = 6
"""Steps tried in one cycle, each shorter than the one before; halvings of a step in a direction
that is kept."""


def error(goal: Array, pose: Array) -> Array:
    """What is missing (6,) of a pose: [position; rotation vector] in ground axes."""
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


class Approach:
    """One step towards a pose, from a configuration q (nq,): `velocity` (n,) of the chain, and `q`
    after it.
    """

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
        self.e = error(goal, pose)
        self.J = J
        self.metric = servo.metric if weights is None else servo.metric * weights
        self.missing = self.metric * self.e
        self.even = weights is None or weights[3] == weights[4] == weights[5]
        """Whether the logarithm's own derivative leaves the gradient alone."""
        self.A = self.metric[:, None] * (J if self.even else turned(self.e[3:], J)) * servo.unit
        self.square = float(self.missing @ self.missing)

    def go(
        self, low: Array, high: Array, damping: float, weights: Array | None, direction: bool
    ) -> Array:
        """Velocities (n,) in the box from `low` to `high`: straight ahead as long as that leads on,
        where a `direction` is kept, and then towards the nearest pose.
        """
        rest = np.minimum(np.maximum(0.0, low), high)
        if self.square <= POSE_ENOUGH or not len(low):
            return rest
        twist = self.e / self.dt
        A, b = (self.J, twist) if weights is None else (weights[:, None] * self.J, weights * twist)
        if not direction:
            return self.nearer(A, b, low, high, rest, damping, weights)
        bend = self.servo.bend(self.before, weights)
        straight = self.shortened(scaled(A, b, low, high, self.dt, bend, near=self.servo.near))
        unit = self.servo.unit
        share = led_on(self.A, self.missing / self.dt, straight / unit, low / unit, high / unit)
        if share == 1.0:
            return straight
        return share * straight + (1.0 - share) * self.nearer(
            A, b, low, high, rest, damping, weights
        )

    def nearer(
        self,
        A: Array,
        b: Array,
        low: Array,
        high: Array,
        rest: Array,
        damping: float,
        weights: Array | None,
    ) -> Array:
        """Velocities (n,) in the box towards the nearest pose, by any way that the error goes down.

        Limits of speed shorten the step that limits of position leave: so all joints arrive
        together.
        """
        near = self.servo.near
        wished = wish(A, b, damping, near, RESIDUAL * math.sqrt(self.square))
        x = wished.x
        least, most = self.servo.box(self.before, self.dt, self.servo.unbounded)
        if whole := bool((x >= least).all() and (x <= most).all()):
            part = part_within(x, low, high)
        else:
            x = damped(A, b, least, most, damping, near=near, shift=SHIFT, wished=wished)
            part = 0.0 if rest.any() else part_within(x, low, high)
        part = min(part, LARGEST / max(float(np.abs(x * self.dt / self.servo.unit).max()), 1e-300))
        left = self.left(part * x) if part else self.square
        gain = (1.0 - math.sqrt(left / self.square)) / part if part else 0.0
        if gain >= ENOUGH_GAIN:
            self.calm = whole and part == 1.0 and self.arrived(left, wished.s[-1], weights)
            return part * x
        y = self.second_order(least, most, wished.rows)
        if rest.any():
            return np.minimum(np.maximum(y, low), high)
        y = part_within(y, low, high) * y
        share = max(0.0, (gain - LITTLE_GAIN) / (ENOUGH_GAIN - LITTLE_GAIN))
        return share * part * x + (1.0 - share) * y

    def arrived(self, left: float, smallest: float, weights: Array | None) -> bool:
        """Whether the square of the error that is left is so small that the next velocities are,
        too.
        """
        servo = self.servo
        if weights is not None or smallest < servo.near:
            return False
        return (
            2.0 * math.sqrt(left) * max(1.0, 1.0 / servo.metric[0])
            <= smallest * self.dt * self.slow
        )

    def left(self, velocity: Array) -> float:
        """Square of the error after velocities (n,)."""
        servo = self.servo
        pose = servo.query(servo.after(self.before, servo.spread(velocity), self.dt))
        missing = self.metric * error(self.goal, pose)
        return float(missing @ missing)

    def shortened(self, velocity: Array) -> Array:
        """The velocities (n,), halved until they lower the error by at least half of what they
        promise.

        Zero where that is next to nothing for what the joints move: there the direction leads no
        farther.
        """
        velocity = np.where(np.abs(velocity) > NOISE * np.abs(velocity).max(), velocity, 0.0)
        z = velocity * self.dt / self.servo.unit
        slope = 2.0 * float(self.missing @ (self.A @ z))
        if slope <= 2.0 * LITTLE * math.sqrt(self.square * float(z @ z)) + POSE_ROUNDING:
            return 0.0 * velocity
        for _ in range(POSE_HALVINGS):
            if self.left(velocity) <= self.square - STRICT * slope:
                return velocity
            velocity = 0.5 * velocity
            slope = 0.5 * slope
        return 0.0 * velocity

    def second_order(self, low: Array, high: Array, damping: Array) -> Array:
        """The velocities (n,) in the box that make the error's second order least, if they lower
        the error itself.
        """
        unit = self.servo.unit
        dt = self.dt
        least = np.maximum(low * dt / unit, -LARGEST)
        most = np.minimum(high * dt / unit, LARGEST)
        rest = np.minimum(np.maximum(0.0, least), most)
        push = self.A.T @ self.missing
        H = self.hessian()
        strength = np.abs(H).max(axis=1)
        idle = strength <= FLAT * strength.max()
        weak = damping * unit
        model = H + weak.T @ weak if len(weak) else H
        more = 0.0
        for _ in range(TRIALS):
            z, curvature, way = newton(model, push, least, most)
            z[idle] = rest[idle]
            promise = 2.0 * float(push @ z) - float(z @ H @ z)
            # damping hides where the error itself curves down
            if promise <= BLIND * self.square and len(weak):
                curvature, way = newton(H, push, least, most)[1:]
            if promise <= BLIND * self.square and curvature < 0.0:
                z = aside(z, way if push @ way >= 0.0 else -way, least, most)
                promise = 2.0 * float(push @ z) - float(z @ H @ z)
            if rest.any():  # what is outside its limits comes back
                return unit * z / dt
            if 0.0 <= promise <= STILL * self.square + POSE_ROUNDING:
                break
            if (
                0.0 < promise <= BLIND * self.square
                or self.left(unit * z / dt) <= self.square - TAKEN * promise
            ):
                return unit * z / dt
            more = max(4.0 * more, 1e-3 * float(np.abs(model).max()))
            model = model + more * np.eye(len(z))
        return rest

    def hessian(self) -> Array:
        """The Hessian (n, n) of half the square of the error, in radians and characteristic
        lengths.

        Of the chain's second derivatives by differences of its Jacobian, of the logarithm by its
        own derivative (Bullo and Murray, 1995).
        """
        servo = self.servo
        w = self.metric
        if not self.even:
            return self.by_differences()
        J = servo.query.pose_and_jacobian(servo.beside(self.before, POSE_DIFFERENCE * servo.unit))[
            1
        ]
        ahead = J[: len(servo.v)]
        behind = J[len(servo.v) :]
        rate = w[:, None] * turned(self.e[3:], self.J) * servo.unit
        forces = ((w * self.missing) @ (ahead - behind))[:, servo.v] * servo.unit
        H = self.A.T @ rate - forces / (2.0 * POSE_DIFFERENCE)
        return 0.5 * (H + H.T)

    def by_differences(self) -> Array:
        """The Hessian (n, n) where turns about the axes of the ground count unequally: differences
        of the gradient.
        """
        servo = self.servo
        w = self.metric
        pushes: list[Array] = []
        for q in servo.beside(self.before, POSE_DIFFERENCE * servo.unit):
            pose, J = servo.query.pose_and_jacobian(q)
            e = error(self.goal, pose)
            pushes.append((w * e) @ (w[:, None] * turned(e[3:], J[:, servo.v]) * servo.unit))
        ahead, behind = np.reshape(pushes, (2, len(servo.v), len(servo.v)))
        H = (behind - ahead) / (2.0 * POSE_DIFFERENCE)
        return 0.5 * (H + H.T)


def led_on(A: Array, b: Array, x: Array, low: Array, high: Array) -> float:
    """How far straight velocities x (n,) in a box lead on, from 0 to 1.

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
        max(0.0, (used - POSE_SLOW) / (FAST - POSE_SLOW)),
    )


def turned(r: Array, J: Array) -> Array:
    """A Jacobian (6, n) whose angular rows are the rates of what is missing, the rotation vector r,
    not of turns.
    """
    angle = math.sqrt(float(r @ r))
    gamma = 0.5 * angle / math.tan(0.5 * angle) if angle > 1e-3 else 1.0 - angle * angle / 12.0
    rest = (1.0 - gamma) / (angle * angle) if angle > 1e-3 else 1.0 / 12.0
    x, y, z = (0.5 * r).tolist()
    M = 4.0 * rest * np.array([[x * x, x * y, x * z], [x * y, y * y, y * z], [x * z, y * z, z * z]])
    M += np.array([[gamma, -z, y], [z, gamma, -x], [-y, x, gamma]])
    out = J.copy()
    out[3:] = M @ J[3:]
    return out


def newton(H: Array, push: Array, low: Array, high: Array) -> tuple[Array, float, Array]:
    """The z (n,) in a box that makes z H z / 2 - push z least, H's curvatures made positive; also
    the least curvature of what is free, where it is negative, and its direction (n,).
    """
    values, V = np.linalg.eigh(H)
    most = max(float(-values[0]), float(values[-1]), 1e-300)
    if values[0] > FLAT * most:
        return least_in_box(H, push, low, high)[0], 0.0, push
    size = np.abs(values)
    size[size <= FLAT * most] = most  # nothing is gained there
    z, free = least_in_box((V * size) @ V.T, push, low, high)
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


def aside(z: Array, way: Array, low: Array, high: Array) -> Array:
    """z (n,) moved along a way, as far as the box and a small step let it."""
    moves = np.abs(way) > 1e-12
    room = np.where(way > 0.0, high - z, z - low)[moves] / np.abs(way[moves])
    return np.minimum(np.maximum(z + min(ASIDE, float(room.min(initial=ASIDE))) * way, low), high)


# ---- steps under constraints, and for several tasks

# Velocities are looked for in what the constraints leave, velocity constraints among them: v = N z,
# with an orthonormal basis N of their null space, in radians and characteristic lengths. What each
# stage reaches, the next ones keep: they act in the null space of its equations, its inequalities
# become bounds (Siciliano and Slotine, 1991; Escande, Mansard and Wieber, 2014). The step is of
# first order, so it opens the loops by the square of its size: they are closed again, within the
# same limits.

OPEN = 1e-3
"""By how much, in radians and characteristic lengths, loops may be open at first: more is no
drift."""
CLOSED = 1e-12
"""By how much they may be open after the step."""
CORRECTIONS = 8
HALVINGS = 12
"""Steps that close the loops again, and how often a step is halved after which that fails."""
HALF = 0.5
ENOUGH = 1e-13
BUSY = 2.0
"""Part of what is required that a step of first order may leave; what may be left in any case; and
what earlier stages miss, as a multiple of the square of the step, to count as not arrived."""
DIFFERENCE = 1e-5
"""Step of the differences of Jacobians, in radians and characteristic lengths."""
ROUNDING = 1e-14
"""Length of what is missed that rounding makes."""
PREVENTS = 1e-6
"""Part of what is missed that a velocity constraint takes, where it is named as the reason."""
EPSILON = 1e-15
"""Part of a coordinate by which it is at a limit."""
BEYOND = 1e-12
"""By how much a bound may seem to be exceeded: rounding."""


class Stage(NamedTuple):
    """What is required at one level: A u = b as nearly as can be, and low <= I u <= high; u are
    scaled velocities.
    """

    A: Array
    b: Array
    inequalities: Array
    low: Array
    high: Array
    hard: bool = True

    def beside(self, rest: Array) -> Stage:
        """What is required of the velocities beside some that are there at rest (nv,)."""
        if not rest.any():
            return self
        have = self.inequalities @ rest
        return self._replace(b=self.b - self.A @ rest, low=self.low - have, high=self.high - have)

    def missed(self, u: Array | None = None) -> float:
        """The length of what velocities u (nv,) leave of what is required, or of all of it."""
        left = self.b if u is None else self.b - self.A @ u
        square = float(left @ left)
        if len(self.low):
            value = np.zeros(len(self.low)) if u is None else self.inequalities @ u
            out = np.maximum(self.low - value, 0.0) + np.maximum(value - self.high, 0.0)
            square += float(out @ out)
        return math.sqrt(square)


class Left(NamedTuple):
    """What constraints leave of the velocities at a configuration: a `basis` (nv, k) of what
    equations do, velocities (nv,) that these ask for at `rest`, and between what declared one-sided
    `rows` (m, nv) of them stay for dt.
    """

    basis: Array
    rest: Array
    rows: Array
    low: Array
    high: Array


class ConstrainedSteps:
    """All of a system's steps under its constraints that does not depend on the configuration.

    `closing` is the system whose loops stay closed: the ideal one of `system`, or itself.
    """

    def __init__(self, system: Model):
        self.system = system
        layout = system.structure.layout
        self.closing = ideal_of(system)
        loops = full(self.closing, True)
        self.length = loops.length
        self.names = loops.names
        self.rolls = rolls(system)
        self.scale: Array = loops.scale
        self.at_v = layout.vector_v
        self.at_q = layout.vector_q
        self.lower = system.lower[self.at_v]
        self.upper = system.upper[self.at_v]
        self.bounds = one_sided_rows(self.closing)
        self.upcoming: tuple[Any, Any] = None, None
        """A step that was computed ahead, after what asks for it."""

    def box(self, q: Array, dt: float, speed: Array) -> tuple[Array, Array]:
        """Least and largest scaled velocities (nv,) for which limits of position and speed hold
        after dt.

        What is outside its limits comes back as fast as it may.
        """
        x = q[self.at_q]
        low = -speed
        high = speed.copy()
        at = self.at_v
        below = self.lower - x
        above = self.upper - x
        near = EPSILON * np.maximum(1.0, np.abs(x))
        below[np.abs(below) <= near] = 0.0
        above[np.abs(above) <= near] = 0.0
        low[at] = np.minimum(np.maximum(low[at], below / dt), speed[at])
        high[at] = np.maximum(np.minimum(high[at], above / dt), -speed[at])
        return low / self.scale, high / self.scale

    def twist(self, J: Array, twist: Array, weights: Array) -> Stage:
        """The stage of a frame's twist, of its Jacobian (6, nv)."""
        w = weights.copy()
        w[:3] /= self.length
        nothing = np.zeros(0)
        return Stage(
            w[:, None] * J * self.scale, w * twist, np.zeros((0, self.system.nv)), nothing, nothing
        )

    def free(self, q: Array, dt: float) -> Left:
        """What constraints leave of the velocities at q (nq,), for dt. Errors: `InputError` for
        open loops.
        """
        error, C = evaluate(self.closing, q, True, True)
        worst = int(np.argmax(np.abs(error))) if len(error) else -1
        if len(error) and not abs(error[worst]) < OPEN:
            raise InputError(
                f"the loops are open at q: {self.names[worst][0]!r} by {abs(error[worst]):.2g} "
                "(radians, characteristic lengths); robot.assemble(start=q) closes them"
            )
        between = self._between(q, dt)
        if not self.rolls:
            return Left(null_space(C), np.zeros(self.system.nv), *between)
        A, b = hard_rows(self.system, q, self.scale)
        return Left(null_space(np.concatenate([C, A])), at_rest(C, A, b), *between)

    def _between(self, q: Array, dt: float) -> tuple[Array, Array, Array]:
        """Declared one-sided rows (m, nv) of the scaled velocities, and between what they stay
        within dt.
        """
        rows = self.bounds
        k = self.bounds.declared
        if not k:
            return np.zeros((0, self.system.nv)), np.zeros(0), np.zeros(0)
        value, G = rows.rates(q, declared=True)
        scale = rows.scale[:k] / dt
        return G, scale * (rows.low[:k] - value), scale * (rows.high[:k] - value)

    def _missed(self, x: Array, before: Array) -> tuple[Array, Array]:
        """What equations miss at x, and declared one-sided rows by more than `before`, with the
        rates of both.
        """
        error, C = evaluate(self.closing, x, True, True)
        if not self.bounds.declared:
            return error, C
        more, G = self.bounds.violated(x, before)
        return np.concatenate([error, more]), np.concatenate([C, G])

    def velocity(
        self,
        free: Left,
        stages: list[Stage],
        low: Array,
        high: Array,
        damping: float,
        *,
        speeds: tuple[Array, Array] | None = None,
        twist: Twist | None = None,
        model: Array | None = None,
    ) -> Array:
        """Scaled velocities (nv,) of the stages, in order, within the box; what is left `free` as
        from there.

        `speeds`, least and largest velocities within the box, shorten what a stage asks for, before
        others take over. `twist` says that the stage is a twist, or has a direction that is kept.
        `model` (k, k), where given, is the Hessian that counts for the last stage.
        """
        N, rest, rows, least, most = free
        some = _Descent(N, speeds)
        own = np.isfinite(low) | np.isfinite(high)
        rows = np.concatenate([np.eye(len(low))[own], rows])
        box = Stage(N.T[:0], low[:0], rows, np.append(low[own], least), np.append(high[own], most))
        some.take(box.beside(rest), 0.0)
        for k, stage in enumerate(stages):
            some.take(stage.beside(rest), damping, twist, model if k + 1 == len(stages) else None)
        least, most = speeds or (low, high)
        return np.minimum(np.maximum(rest + N @ some.z, least), most)

    def blocking(
        self, q: Array, stages: list[Stage], u: Array, low: Array, high: Array
    ) -> tuple[str, ...]:
        """Names of the velocity constraints that prevent what velocities u (nv,) miss: by their
        multipliers.
        """
        pull = sum((s.A.T @ (s.b - s.A @ u) for s in stages if s.hard), np.zeros(len(u)))
        C = evaluate(self.closing, q, True, True)[1]
        A = hard_rows(self.system, q, self.scale)[0]
        bounds = np.eye(len(u))[(u <= low) | (u >= high)]
        forces = np.linalg.lstsq(np.concatenate([A, C, bounds]).T, pull, rcond=1e-9)[0][: len(A)]
        some = np.abs(forces) > PREVENTS * math.sqrt(float(pull @ pull))
        return tuple(
            dict.fromkeys(
                name for (name, _), is_so in zip(row_names(self.system), some, strict=True) if is_so
            )
        )

    def twisted(
        self,
        q: Array,
        stages: list[Stage],
        low: Array,
        high: Array,
        damping: float,
        direction: bool,
        dt: float,
        at: Callable[[Array], list[Stage]],
        slow: float,
    ) -> tuple[Array, Array, bool]:
        """The configuration (nq,) after dt, the scaled velocities (nv,) of a twist, and whether the
        motion is calm.
        """
        free = self.free(q, dt)
        twist = Twist(dt, self.bend(q, free.basis, stages[0], at), direction)
        return *self.after(
            q, self.velocity(free, stages, low, high, damping, twist=twist), dt, low, high
        ), False

    def towards(
        self,
        q: Array,
        stages: list[Stage],
        low: Array,
        high: Array,
        damping: float,
        direction: bool,
        dt: float,
        at: Callable[[Array], list[Stage]],
        slow: float,
    ) -> tuple[Array, Array, bool]:
        """The configuration (nq,) after dt, the scaled velocities (nv,) towards goals, and whether
        the motion is calm.

        Where a `direction` is kept the step is straight as long as that leads on. Otherwise the
        first stage that a step of first order does not lower as promised takes one of second order,
        which must do so, else a shorter one; stages after it do not count. Limits of speed shorten
        these steps. `at` gives the stages at a configuration. The motion is calm where the step
        arrives, and the next one makes good only what second derivatives have left: then no joint
        turns back.
        """
        free = self.free(q, dt)
        if direction:
            after, u = self.straight(q, free, stages, low, high, dt, at)
            if (share := led_on(stages[0].A, stages[0].b, u, low, high)) == 1.0:
                return after, u, False
            other = self.towards(q, stages, low, high, damping, False, dt, at, slow)[1]
            return *self.after(q, share * u + (1.0 - share) * other, dt, low, high), False
        wide = (low, high)
        speeds = None
        if not free.rest.any() and (low <= 0.0).all() and (high >= 0.0).all():
            least, most = self.box(q, dt, np.full(len(low), math.inf))
            wide = (np.maximum(least, -LARGEST / dt), np.minimum(most, LARGEST / dt))
            speeds = (low, high)
        u = self.velocity(free, stages, *wide, damping)
        size = dt * float(u @ u)
        requested = [s.missed() for s in stages]
        still = size * dt <= ENOUGH**2
        whole = speeds is None or part_within(u, low, high) == 1.0
        left = [s.missed(u) for s in stages]
        if not (whole or still):  # far away
            left = [s.missed() for s in at(self.after(q, u, dt, *wide)[0])]
        k = next(
            (k for k, had in enumerate(requested) if left[k] > max(HALF * had, ENOUGH / dt)), None
        )
        if (
            k is None
            or (k and max(requested[:k]) > BUSY * size)
            or (k and requested[k] ** 2 - left[k] ** 2 > 2.0 * BUSY * size * left[k])
            # earlier ones move it, by more than it disturbs them; or curvature is little beside
            # what is gained
        ):
            if still:
                u = np.minimum(np.maximum(0.0, low), high)
            elif not whole:
                u = self.velocity(free, stages, *wide, damping, speeds=speeds)
            next_speed = size * math.sqrt(len(u)) / max(NEAR, damping)
            calm = (
                whole
                and max(left, default=0.0) <= ENOUGH / dt
                and damping >= NEAR
                and next_speed <= slow
            )
            return *self.after(q, u, dt, low, high), calm
        own = stages[: k + 1]
        before = requested[k]
        model = self.curvature(q, free.basis, own, u, *wide, dt, at)
        more = 0.0
        for _ in range(TRIALS):
            convex = model + more * np.eye(len(model))
            u = self.velocity(free, own, *wide, damping, model=convex)
            promise = before**2 - own[k].missed(u) ** 2
            if (
                promise <= BLIND * before**2
                and (way := self.aside(free, own, u, *wide, dt, model)) is not None
            ):
                u, promise = way
                speeds = (low, high) if speeds is None else speeds
                convex = None
            if 0.0 <= promise <= STILL * before**2 + (ROUNDING / dt) ** 2:
                break
            if promise > 0.0 and (
                promise <= BLIND * before**2
                or at(self.after(q, u, dt, *wide)[0])[k].missed() ** 2
                <= before**2 - TAKEN * promise
            ):
                if convex is None:
                    u = part_within(u, low, high) * u
                elif speeds is not None:
                    u = self.velocity(free, own, *wide, damping, speeds=speeds, model=convex)
                return *self.after(q, u, dt, low, high), False
            more = 4.0 * more if more else 1e-2 * float(np.abs(model).max())
        u = self.velocity(free, stages[:k], *wide, damping, speeds=speeds)
        return *self.after(q, u, dt, low, high), False

    def straight(
        self,
        q: Array,
        free: Left,
        stages: list[Stage],
        low: Array,
        high: Array,
        dt: float,
        at: Callable[[Array], list[Stage]],
    ) -> tuple[Array, Array]:
        """The configuration (nq,) after dt, and the scaled velocities (nv,), towards a pose, its
        direction kept.

        The step is halved until it lowers what is missed by half of what it promises; if it never
        does, there is none.
        """
        twist = Twist(dt, self.bend(q, free.basis, stages[0], at), True)
        before = stages[0].missed()
        u = self.velocity(free, stages, low, high, 0.0, twist=twist)
        for _ in range(HALVINGS if before > ENOUGH / dt else 0):
            promise = before**2 - stages[0].missed(u) ** 2
            if promise <= STILL * before**2:
                break
            found = self.after(q, u, dt, low, high)
            if at(found[0])[0].missed() ** 2 <= before**2 - HALF * promise:
                return found
            u = 0.5 * u
        return self.after(q, np.minimum(np.maximum(0.0, low), high), dt, low, high)

    def aside(
        self,
        free: Left,
        stages: list[Stage],
        u: Array,
        low: Array,
        high: Array,
        dt: float,
        model: Array,
    ) -> tuple[Array, float] | None:
        """Velocities (nv,) that leave a saddle point of what the last stage misses, and the
        decrease that they promise.

        Their direction is that of the least curvature, where it is negative, among those that
        earlier stages and bounds leave; None where there is no such direction.
        """
        N = free.basis
        held = np.eye(len(u))[(u <= low) | (u >= high)] @ N
        own = null_space(np.concatenate([held, *(s.A @ N for s in stages[:-1])]))
        if not own.shape[1]:
            return None
        values, W = np.linalg.eigh(own.T @ model @ own)
        if values[0] >= -SADDLE * float(np.abs(model).max()):
            return None
        way = N @ (own @ W[:, 0])
        way = way if float(way @ (stages[-1].A.T @ stages[-1].b)) >= 0.0 else -way
        rows = [np.eye(len(u)), free.rows]
        ends = [(low, high), (free.low, free.high)]
        for s in stages:
            kept = (s.low <= 0.0) & (s.high >= 0.0)
            rows.append(s.inequalities[kept])
            ends.append((s.low[kept], s.high[kept]))
        least, most = (np.concatenate(x) for x in zip(*ends, strict=True))
        step = ASIDE / dt * way
        step = part_within(np.concatenate(rows) @ step, least, most) * step
        return step, -float(values[0]) * float(step @ step)

    def bend(self, q: Array, N: Array, stage: Stage, at: Callable[[Array], list[Stage]]) -> Bend:
        """Derivatives (k, m, n) of a stage's equations over the free velocities N along directions
        (k, n) of these.

        Loops stay closed to second order.
        """

        def along(ways: Array) -> Array:
            size = np.abs(ways).max(axis=1)
            moves = (DIFFERENCE / np.where(size > 0.0, size, 1.0))[:, None] * (ways @ N.T)
            ends = self.system.structure.layout.integrate(
                q, np.concatenate([moves, -moves]) * self.scale
            )
            per = (size / (2.0 * DIFFERENCE))[:, None, None]
            k = len(ways)
            A = at(ends)[0].A
            C = evaluate(self.closing, ends, True, True)[1]
            A = (A[:k] - A[k:]) * per
            C = (C[:k] - C[k:]) * per
            if C.shape[-2]:
                A = (
                    A
                    - stage.A
                    @ np.linalg.pinv(evaluate(self.closing, q, True, True)[1], rcond=1e-8)
                    @ C
                )
            return A @ N

        return along

    def curvature(
        self,
        q: Array,
        N: Array,
        stages: list[Stage],
        u: Array,
        low: Array,
        high: Array,
        dt: float,
        at: Callable[[Array], list[Stage]],
    ) -> Array:
        """The Hessian (k, k), in the free velocities, of half the square of what the last stage
        misses, where loops and earlier stages stay as they are: that of the Lagrangian, by
        differences.
        """

        def push(x: Array, requested: list[Stage]) -> tuple[Array, Array]:
            """What the last stage pulls at (..., nv), and the rows (..., m, nv) that stay, at
            configurations.
            """
            C = evaluate(self.closing, x, True, True)[1]
            s = requested[-1]
            out = np.maximum(s.low, 0.0) + np.minimum(s.high, 0.0)
            pull = np.einsum("...i,...ij->...j", s.b, s.A) + np.einsum(
                "...i,...ij->...j", out, s.inequalities
            )
            return dt * pull, np.concatenate([C, *(t.A for t in requested[:-1])], axis=-2)

        pull, rows = push(q, stages)
        at_bound = np.eye(len(u))[(u <= low) | (u >= high)]
        rolling = hard_rows(self.system, q, self.scale)[0] if self.rolls else at_bound[:0]
        held = np.concatenate([rows, rolling, at_bound])
        forces = (
            np.linalg.lstsq(held.T, pull, rcond=1e-9)[0][: len(rows)] if len(held) else np.zeros(0)
        )
        moves = DIFFERENCE * N.T * self.scale
        ends = self.system.structure.layout.integrate(q, np.concatenate([moves, -moves]))
        pulled, kept = push(ends, at(ends)[: len(stages)])
        pulled = pulled - np.einsum("i,...ij->...j", forces, kept)
        H = (pulled[len(moves) :] - pulled[: len(moves)]) @ N / (2.0 * DIFFERENCE)
        return 0.5 * (H + H.T)

    def after(self, q: Array, u: Array, dt: float, low: Array, high: Array) -> tuple[Array, Array]:
        """The configuration (nq,) after dt, loops closed and limits held, and u, shortened where
        that has to be.
        """
        for k in range(HALVINGS):
            part = 0.5**k
            found = self.closed(q, part * u, dt, low, high)
            if found is not None:
                return found, part * u
        return q.copy(), 0.0 * u

    def closed(self, q: Array, u: Array, dt: float, low: Array, high: Array) -> Array | None:
        """The closed configuration (nq,) next to q + u dt, None where limits or a singularity are
        in the way.

        By the smallest corrections (Newton), bounded where these would leave the box.
        """
        system = self.system
        x = self.system.structure.layout.integrate(
            q, (self.bent(q, u, dt) if self.rolls else u) * self.scale * dt
        )
        before = self.bounds.beyond(q, declared=True) if self.bounds.declared else x
        for _ in range(CORRECTIONS):
            error, C = self._missed(x, before)
            if np.abs(error).max(initial=0.0) <= CLOSED:
                return self._inside(q, x)
            moved = system.structure.layout.difference(q, x) / self.scale
            least = np.minimum(low * dt - moved, 0.0)
            most = np.maximum(high * dt - moved, 0.0)
            more = -np.linalg.pinv(C, rcond=1e-8) @ error
            if (more < least).any() or (more > most).any():
                A = np.concatenate([C, LEAST * np.eye(len(more))])
                more = bounded(A, np.concatenate([-error, np.zeros(len(more))]), least, most, more)
            x = system.structure.layout.integrate(x, more * self.scale)
        return None

    def bent(self, q: Array, u: Array, dt: float) -> Array:
        """Scaled velocities (nv,) over dt for those at q: without slip in the middle of the way, to
        second order.
        """
        A, b = hard_rows(
            self.system,
            self.system.structure.layout.integrate(q, 0.5 * dt * u * self.scale),
            self.scale,
        )
        return u - np.linalg.pinv(A, rcond=1e-8) @ (A @ u - b)

    def _inside(self, q: Array, x: Array) -> Array:
        """x, its limits kept to the last bit where q kept them."""
        now = q[self.at_q]
        x[self.at_q] = np.clip(
            x[self.at_q], np.minimum(self.lower, now), np.maximum(self.upper, now)
        )
        return x


class Twist(NamedTuple):
    """What a twist needs beside its equations: the time of the step, their derivatives, and whether
    it is kept.
    """

    dt: float
    bend: Bend
    kept: bool


class _Descent:
    """Velocities N z, lowered stage by stage: what earlier stages reached stays."""

    def __init__(self, N: Array, speeds: tuple[Array, Array] | None = None):
        self.N = N
        self.z = np.zeros(N.shape[1])
        self.free = np.eye(N.shape[1])
        self.G = np.zeros((0, N.shape[1]))
        self.low = np.zeros(0)
        self.high = np.zeros(0)
        self.speeds = speeds

    def take(
        self, stage: Stage, damping: float, twist: Twist | None = None, model: Array | None = None
    ) -> None:
        """Do for a stage what can be done; `model` (k, k), where given, is the Hessian that counts
        for it.
        """
        A = stage.A @ self.N
        b = stage.b
        G = stage.inequalities @ self.N
        value = G @ self.z
        slack = BEYOND * np.maximum(1.0, np.abs(value))
        out = (value < stage.low - slack) | (value > stage.high + slack)
        if stage.hard:
            self._bound(G[~out], stage.low[~out], stage.high[~out])
        free = self.free
        equations = np.concatenate([A, G[out]]) @ free
        wish = np.concatenate(
            [b - A @ self.z, (np.clip(value, stage.low, stage.high) - value)[out]]
        )
        low = self.low - self.G @ self.z
        high = self.high - self.G @ self.z
        # rounding
        low = np.minimum(low, 0.0)
        high = np.maximum(high, 0.0)
        if len(wish) and free.shape[1]:
            if twist is not None and twist.kept:
                y = scaled(equations, wish, low, high, twist.dt, twist.bend, self.G @ free, None)
            elif twist is not None:
                y = damped(
                    equations, wish, low, high, damping, self.G @ free, None, twist.bend, SHIFT
                )
            else:
                if model is not None:
                    pull = free.T @ (
                        A.T @ b
                        + G[out].T @ np.clip(value, stage.low, stage.high)[out]
                        - model @ self.z
                    )
                    equations, wish = convex(free.T @ model @ free, pull, equations, damping)
                    damping = 0.0
                y = damped(equations, wish, low, high, damping, self.G @ free, None)
            self.z = self.z + free @ (
                y if self.speeds is None else self._slowed(y, equations, low, high)
            )
        if stage.hard and out.any():
            value = G[out] @ self.z
            self._bound(
                G[out], np.minimum(stage.low[out], value), np.maximum(stage.high[out], value)
            )
        self.free = free @ null_space(A @ free)

    def _slowed(self, y: Array, equations: Array, low: Array, high: Array) -> Array:
        """y (k,) of the free velocities, shortened until limits of speed alone hold, then the
        nearest that is left.
        """
        assert self.speeds is not None
        rows = self.N @ self.free
        (least, most) = self.speeds
        now = self.N @ self.z
        y = part_within(rows @ y, least, most) * y
        value = rows @ y
        least = np.minimum(least - now, 0.0)
        most = np.maximum(most - now, 0.0)
        if (value >= least).all() and (value <= most).all():
            return y
        G = np.concatenate([rows, self.G @ self.free])
        low = np.append(least, low)
        high = np.append(most, high)
        weak = SHIFT * NEAR * (float(np.linalg.norm(equations, 2)) or 1.0)
        metric = np.concatenate([equations, weak * np.eye(len(y))])
        return bounded(metric, metric @ y, low, high, np.zeros(len(y)), G)

    def _bound(self, G: Array, low: Array, high: Array) -> None:
        self.G = np.concatenate([self.G, G])
        self.low = np.concatenate([self.low, low])
        self.high = np.concatenate([self.high, high])


def convex(H: Array, pull: Array, J: Array, damping: float) -> tuple[Array, Array]:
    """Rows and wish (n,) of the least squares that a Hessian, its curvatures made positive, and a
    pull stand for.

    What damping the equations J would have is added.
    """
    _, s, Vt = svd(J, full_matrices=True)
    s = np.concatenate([s, np.zeros(len(Vt) - len(s))]) / max(float(s.max(initial=0.0)), 1e-300)
    weak = damping * np.sqrt(np.maximum(1.0 - (s / NEAR) ** 2, 0.0)) * float(np.linalg.norm(J, 2))
    values, V = np.linalg.eigh(H + (Vt.T * weak**2) @ Vt)
    size = np.abs(values)
    size[size <= FLAT * size.max()] = max(float(size.max()), 1e-300)
    return np.sqrt(size)[:, None] * V.T, (pull @ V) / np.sqrt(size)


def stages_of(problem: Demands, q: Array, dt: float) -> list[Stage]:
    """What tasks ask of the velocities at q (..., nq), level by level: that what they miss is gone
    after dt.
    """
    packed = problem.packed
    loops = problem.packed.loops
    error, J = packed.evaluate(q, problem.pins)
    levels, strengths, *_ = problem.levels
    counts = np.array([len(t.rows) for t in loops.ties])
    own = packed.rows >= 0
    level, hard = (np.repeat(x, counts)[own] for x in levels.reshape(2, -1))
    weight = np.repeat(np.sqrt(strengths[:, 0]), counts)[own]
    low, high = ends_of_rows(packed)
    equal = low == high
    J = weight[:, None] * J
    low = weight * (low - error) / dt
    high = weight * (high - error) / dt
    out: list[Stage] = []
    for s in range(1, int(level.max(initial=0)) + 1):
        same = (level == s) & equal
        between = (level == s) & ~equal
        ends = low[..., between], high[..., between]
        out.append(
            Stage(
                J[..., same, :],
                low[..., same],
                J[..., between, :],
                *ends,
                bool(hard[level == s][0]),
            )
        )
    return out


def ends_of_rows(packed: Packed) -> tuple[Array, Array]:
    """Low and high ends (m,) of the tasks' rows, in radians and characteristic lengths; zero for
    equations.
    """
    low, high = packed.loops.bounds[:, packed.rows >= 0]
    return low, high


def posed(system: Model, wanted: Any, q: Array) -> Demands:
    """The tasks of one step, checked and packed. Errors: `InputError` for a batch, and for goals
    that are none.
    """
    from kempe.equations.packed_tasks import refuse
    from kempe.inverse.tasks.search import pose_problem

    problem, _ = pose_problem(system, wanted, q)
    if problem.lead:
        raise InputError(
            f"the goals have the leading shape {problem.lead}; one step has one goal for each task"
        )
    for task, goals in zip(problem.tasks, problem.goals, strict=True):
        refuse(goals, task.label)
    return problem


# ---- `ik_step`, and the steps of one frame

WHOLE = 1.0 - 1e-3
"""Fraction of what is wanted that counts as all of it: damping takes less than the rest far from
singularities."""
NONE = np.zeros(0)
EYE = np.eye(3)
TURNING = math.pi
SLIDING = 1.0
"""Largest speeds of joints that the description gives none, in rad/s and m/s."""
SLOW = 0.0499
SHORTER = 5
"""Part of its speed above which no joint turns back from one cycle to the next; halvings of a step
for that."""
SKEW = 1e-5
"""Sum of what a rotation's product with its transpose may miss."""
BESIDE = 1e-12
"""How near to a bound a velocity is at it, where it is a sum of others."""


@explained_methods
@dataclass(frozen=True, eq=False)
class IkStep(Answer):
    """Velocities of one step: `q` (nq,) after it, `velocity` (nv,), and the `twist` (6,) that they
    give the frame.

    For tasks, `twist` are the rates (m,) of the equations of the hard ones, in radians and
    characteristic lengths. `fraction` is the part of the wanted twist in that, 1 where it is had in
    full; `saturated` names the coordinates that are at a limit of position or velocity,
    `default_speed` those of them whose limit of velocity is the default one, since neither the
    system nor the call has one. `blocked_by` names the velocity constraints, such as wheels that do
    not slip sideways, that prevent the rest of the wanted motion.
    """

    __repr__ = brief

    also = ("velocity", "twist", "fraction", "saturated", "blocked_by")

    q: Array
    velocity: Array
    twist: Array
    fraction: float
    saturated: tuple[str, ...]
    system: Model = field(repr=False)
    default_speed: tuple[str, ...] = ()
    blocked_by: tuple[str, ...] = ()

    success = by_code

    @property
    def code(self) -> Status:
        """The outcome: `PARTLY` where limits or a singularity leave only a fraction of what was
        wanted.
        """
        return Status.SOLVED if self.fraction >= WHOLE else Status.PARTLY

    def _sentence(self, index: tuple[int, ...]) -> str:
        if self.success:
            text = "The wanted motion in full"
            default = ()
        else:
            none = "Nothing of the wanted motion" if self.velocity.any() else "No motion"
            text = f"{self.fraction:.3g} of the wanted motion" if self.fraction > 0.0 else none
            default = self.default_speed
        declared = self.system._mechanism.constraints
        why = [declared[name].of.prevents.format(name=name) for name in self.blocked_by]
        if limited := [name for name in self.saturated if name not in self.default_speed]:
            why.append(f"at a limit: {', '.join(map(repr, limited))}")
        if default:
            why.append(
                f"at the default speed (pi rad/s, {SLIDING:.3g} m/s): "
                f"{', '.join(map(repr, default))}"
            )
        return f"{text}: {'; '.join(why)}" if why else text

    def _claimed(self) -> np.ndarray:
        return np.array(False)  # a step is of first order: how far it leads away is its residual


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
    """All of a frame's steps that does not depend on the configuration, looked up once."""

    def __init__(self, system: Model, frame: str):
        self.system = system
        self.frame = frame
        self.query = query(system, frame)
        chain = chain_of(system, frame)
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
        length = characteristic_length(system)
        slides = ~system.structure.coordinates.turning[self.v]
        slides[~np.isin(self.v, system.structure.layout.vector_v)] = False
        self.metric = np.array([1.0 / length] * 3 + [1.0] * 3)
        """What weighs the error of a pose as `ik` does."""
        self.unit = np.where(slides, length, 1.0)

    def move(
        self,
        q: Array,
        x: Array,
        dt: float,
        fastest: Array,
        damping: float,
        direction: bool,
        weights: Array | None,
    ) -> Move:
        """The velocities for a twist (6,) or towards a pose (4, 4), at a configuration (nq,)."""
        pose, J = self.query.pose_and_jacobian(q)
        J = J[:, self.v]
        w = weights
        low, high = self.box(q, dt, fastest)
        if x.ndim == 2:
            approach = Approach(
                self, q, x, pose, J, dt, w, SLOW * float(fastest.min(initial=math.inf))
            )
            own = approach.go(low, high, damping, w, direction)
            return Move(own, low, high, J, approach.e / dt, approach.calm)
        A, b = (J, x) if w is None else (w[:, None] * J, w * x)
        wished = wish(A, b, damping, self.near)
        if (
            len(wished.s)
            and wished.s[-1] >= self.near
            and (not direction or len(A) <= len(wished.s))
        ):
            own = wished.x  # regular
            if (own >= low).all() and (own <= high).all():
                bound = dt * math.sqrt(len(own)) * float(wished.s[0] * (own @ own) / wished.s[-1])
                calm = bound <= SLOW * float(fastest.min()) and self.roomy(q, own, dt)
                return Move(own, low, high, J, x, calm)
        bend = self.bend(q, w)
        if direction:
            own = scaled(A, b, low, high, dt, bend, near=self.near)
        else:
            own = damped(
                A, b, low, high, damping, near=self.near, bend=bend, shift=SHIFT, wished=wished
            )
        return Move(own, low, high, J, x, False)

    def roomy(self, q: Array, velocity: Array, dt: float) -> bool:
        """Whether no limit of position is met in two such steps."""
        x = q[self.at_q] + 2.0 * dt * velocity[self.at_v]
        return bool((x >= self.lower).all() and (x <= self.upper).all())

    def box(self, q: Array, dt: float, speed: Array) -> tuple[Array, Array]:
        """Least and largest velocities (n,) for which limits of position and speed hold after dt.

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

    def bend(self, q: Array, weights: Array | None) -> Bend:
        """Derivatives (k, 6, n) of the Jacobian, its rows weighted, along directions (k, n), as
        central differences.
        """

        def along(ways: Array) -> Array:
            size = np.abs(ways / self.unit).max(axis=1)
            steps = np.zeros((len(ways), self.system.nv))
            steps[:, self.v] = (POSE_DIFFERENCE / np.where(size > 0.0, size, 1.0))[:, None] * ways
            ends = self.system.structure.layout.integrate(q, np.concatenate([steps, -steps]))
            J = self.query.pose_and_jacobian(ends)[1][:, :, self.v]
            out = (J[: len(ways)] - J[len(ways) :]) * (size / (2.0 * POSE_DIFFERENCE))[
                :, None, None
            ]
            return out if weights is None else weights[:, None] * out

        return along

    def spread(self, velocity: Array) -> Array:
        """Velocities (nv,) of the system, those of the chain (n,) given, the others zero."""
        out = np.zeros(self.system.nv)
        out[self.v] = velocity
        return out

    def beside(self, q: Array, step: Array) -> Array:
        """Configurations (2 n, nq), each coordinate of the chain moved by its step (n,), then by
        minus that.
        """
        n = len(self.v)
        if self.plain:
            out = np.broadcast_to(q, (2 * n, len(q))).copy()
            out[self.ahead, self.at_q] += step
            out[self.behind, self.at_q] -= step
            return out
        moves = np.zeros((2 * n, self.system.nv))
        moves[range(n), self.v] = step
        moves[range(n, 2 * n), self.v] = -step
        return self.system.structure.layout.integrate(q, moves)

    def after(self, q: Array, velocity: Array, dt: float) -> Array:
        """The configuration (nq,) after dt, limits kept to the last bit where q kept them."""
        if not self.plain:
            out = self.system.structure.layout.integrate(q, velocity * dt)
        else:
            out = q.copy()
            out[self.at_q] += velocity[self.v] * dt
        x = q[self.at_q]
        out[self.at_q] = np.minimum(
            np.maximum(out[self.at_q], np.minimum(self.lower, x)), np.maximum(self.upper, x)
        )
        return out


@explained
def ik_step(
    system: Model,
    q: Any,
    wanted: Any,
    frame: FrameLike | None = None,
    dt: float = 0.0,
    *,
    velocity_limits: Any = None,
    damping: float = 0.05,
    keep_direction: bool = False,
    weights: Any = None,
) -> IkStep:
    """The step that gives a frame the wanted twist for the time dt [s], as nearly as limits allow.

    `wanted` is a twist (6,), [linear; angular] of the frame's origin in ground axes, or a pose (4,
    4) to be reached in dt; without a frame, tasks of `kempe.tasks` to be reached in dt, hard or
    soft and in strict priorities. The velocities make the squared error of the twist least
    (`weights` (6,) of its rows, zero where a row does not count) and, among those that do, their
    own size; near singularities the directions that are hard to move in are damped, by at most
    `damping` (Maciejewski and Klein, 1988). They stay in `velocity_limits` (a number or (nv,);
    default: those of the system, and where it has none pi rad/s and 1 m/s of all that a coordinate
    turns or slides; `math.inf` lifts them), and no coordinate leaves its limits within dt. Where a
    twist asks for more, other joints take over, and the velocities change gradually where they do:
    so a little of the twist that a bounded least-squares problem would give is left. A singular
    configuration from which a twist leads to second order only is left.

    With `keep_direction` the twist is scaled instead of bent: what is had is the largest part of it
    that the limits allow, from 0 to 1, but for a few percent that self-motions cost. Towards a
    singular configuration the part falls to zero, and the motion comes to rest there: it never goes
    back. Close to one, the direction is kept to 1 %. Towards a pose the frame goes straight, in
    position and orientation together, as long as that leads on; where a limit or the border of the
    workspace ends the straight way, the motion turns gradually towards the nearest pose.

    A pose or tasks that cannot be had within dt, since they are far, out of reach or beyond limits,
    are approached: limits of speed shorten the step, so all joints arrive together. Where a step of
    first order does not lower the error, its second order counts (Newton); saddle points of the
    error are left. So cycles that ask for the same come to rest, at a local minimum of the error,
    in radians and characteristic lengths as in `ik`, with `keep_direction`, too. Of a twist only
    the caller knows where it leads.

    In cycles that ask for the same, no joint turns back from one cycle to the next at more than a
    twentieth of its limit of speed: the velocities of the next cycle are computed, too, and the
    step is shortened where one changes its sign. What is asked for decides alone: no velocity of an
    earlier call counts.

    Loops and relations of several coordinates stay closed, those of the whole system for tasks and
    for a frame that they move: to first order by the velocities, and then in `q`, which is closed
    again (q may be open a little, as by drift). Velocity constraints hold: what rolls does not
    slip, and the way to `q` obeys them to second order. Declared one-sided constraints hold as
    limits do. There
    sizes are measured in radians and characteristic lengths, and damping relative to the largest
    singular value. Errors: `InputError`, also where the loops are open.
    """
    q = as_q(system, q)
    if q.ndim != 1 or not (0.0 < dt < math.inf and 0.0 <= damping < math.inf):
        raise InputError(
            f"q has shape {q.shape}, dt is {dt!r}, damping {damping!r}; needed are one "
            f"configuration ({system.nq},), a positive time and a number not negative"
        )
    speed = (
        speeds(system)
        if velocity_limits is None
        else _numbers(velocity_limits, system.nv, "velocity_limits")
    )
    default = ~np.isfinite(system.structure.velocity_limits) if velocity_limits is None else None
    w = _numbers(weights, 6, "weights", True) if weights is not None else None
    if frame is None:
        if keep_direction or w is not None:
            raise InputError(
                "keep_direction and weights are for the twist of a frame; tasks have weights of "
                "their own"
            )
        return _held_step(system, q, wanted, None, dt, speed, default, damping, False, None)
    name = system.structure.frame_name(frame)
    if rolls(system) or obstacle(system, name) or one_sided_rows(system).declared:
        return _held_step(system, q, wanted, name, dt, speed, default, damping, keep_direction, w)
    servo = _servo(system, name)
    x = _motion(wanted)
    fastest = speed[servo.v]
    case = (
        x.tobytes(),
        dt,
        fastest.tobytes(),
        damping,
        keep_direction,
        None if w is None else w.tobytes(),
    )

    def law(q: Array) -> Move:
        if servo.upcoming[0] == (case, q.tobytes()):
            return servo.upcoming[1]
        return servo.move(q, x, dt, fastest, damping, keep_direction, w)

    def after(part: float) -> Array:
        there = servo.after(q, servo.spread(part * own), dt)
        move = law(there)
        servo.upcoming = (case, there.tobytes()), move
        return move.velocity

    own, low, high, J, twist, calm = law(q)
    if not calm:
        own = own * steady(after, own, fastest)
    velocity = servo.spread(own)
    had = J @ own
    part = _part(had, twist) if w is None else _part(w * had, w * twist)
    at = ((own <= low) | (own >= high)).nonzero()[0]
    names = tuple(servo.names[int(i)] for i in at)
    return IkStep(
        servo.after(q, velocity, dt),
        velocity,
        had,
        part,
        names,
        system,
        _at_default(system, names, velocity, speed, default),
    )


def _at_default(
    system: Model,
    saturated: tuple[str, ...],
    velocity: Array,
    speed: Array,
    default: np.ndarray | None,
) -> tuple[str, ...]:
    """Those of the saturated coordinates that move at a default speed (nv,)."""
    if not saturated or default is None:
        return ()
    fast: list[bool] = np.logical_and(default, np.abs(velocity) >= speed * (1.0 - BESIDE)).tolist()
    return tuple(
        name
        for name, is_so in zip(system.structure.velocity_names, fast, strict=True)
        if is_so and name in saturated
    )


def steady(after: Callable[[float], Array], velocity: Array, fastest: Array) -> float:
    """The part of the step by which no joint turns back at once, at more than `SLOW` of its speed
    (n,).

    `after` gives the velocities (n,) that follow a part of the step. Where a joint turns back, a
    shorter step leads nearer to where its speed passes zero, and one at `SLOW` of the speeds
    across.
    """
    least = SLOW * fastest
    part = 1.0
    for _ in range(SHORTER):
        moved = part * velocity
        big = np.abs(moved) > least
        if not big.any():
            break
        then = after(part)
        if not (big & (np.abs(then) > least) & (moved * then < 0.0)).any():
            break
        part *= 0.5
    else:
        big = np.abs(velocity) > least
        part = float((least[big] / np.abs(velocity[big])).min(initial=1.0))
    return part


@kept
def _servo(system: Model, frame: str) -> Servo:
    return Servo(system, frame)


def _held_step(
    system: Model,
    q: Array,
    wanted: Any,
    frame: str | None,
    dt: float,
    speed: Array,
    default: np.ndarray | None,
    damping: float,
    direction: bool,
    weights: Array | None,
) -> IkStep:
    """A step for a frame, or for tasks, while the system's loops and relations stay closed."""
    if not np.isfinite(q).all():
        refuse_bad(system, q)
    closed = _closed(system)
    at, J, asked = _wanted(
        system, closed, q, wanted, frame, dt, np.ones(6) if weights is None else weights
    )
    low, high = closed.box(q, dt, speed)
    slow = SLOW * float((speed / closed.scale).min(initial=math.inf))
    law = closed.twisted if frame is not None and np.ndim(wanted) == 1 else closed.towards

    case = (
        asked,
        dt,
        speed.tobytes(),
        damping,
        direction,
        None if weights is None else weights.tobytes(),
    )

    def step(x: Array) -> tuple[Array, Array, bool]:
        if closed.upcoming[0] == (case, x.tobytes()):
            return closed.upcoming[1]
        return law(x, at(x), *closed.box(x, dt, speed), damping, direction, dt, at, slow)

    def then(part: float) -> Array:
        there = after if part == 1.0 else closed.after(q, part * u, dt, low, high)[0]
        found = step(there)
        closed.upcoming = (case, there.tobytes()), found
        return found[1]

    stages = at(q)
    (after, u, calm) = step(q)
    if not calm and (part := steady(then, u, speed / closed.scale)) < 1.0:
        after, u = closed.after(q, part * u, dt, low, high)
    velocity = u * closed.scale
    near = BESIDE * np.maximum(1.0, np.abs(u))
    at = ((u <= low + near) | (u >= high - near)).nonzero()[0]
    requested = np.concatenate([NONE, *(s.b for s in stages if s.hard)])
    had = np.concatenate([NONE, *(s.A @ u for s in stages if s.hard)])
    twist = had if frame is None else J @ velocity
    names = tuple(system.structure.velocity_names[int(i)] for i in at)
    part = _part(had, requested)
    blocked = closed.blocking(q, stages, u, low, high) if part < WHOLE and closed.rolls else ()
    return IkStep(
        after,
        velocity,
        twist,
        part,
        names,
        system,
        _at_default(system, names, velocity, speed, default),
        blocked,
    )


def _wanted(
    system: Model,
    closed: ConstrainedSteps,
    q: Array,
    wanted: Any,
    frame: str | None,
    dt: float,
    weights: Array,
) -> tuple[Callable[[Array], list[Stage]], Array, tuple[Any, ...]]:
    """What is required at configurations (..., nq), as a function of them; the Jacobian (6, nv) of
    the frame, if any; and all that the function depends on, for comparisons.
    """

    if frame is None:
        problem = posed(system, wanted, q)
        levels, strengths, *_ = problem.levels
        asked = (
            problem.packed,
            problem.pins.tobytes(),
            np.asarray(levels).tobytes(),
            np.asarray(strengths).tobytes(),
        )
        return lambda x: stages_of(problem, x, dt), NONE, asked
    goal = _motion(wanted)
    pose_of = query(system, frame)

    def at(x: Array) -> list[Stage]:
        pose, J = pose_of.pose_and_jacobian(x)
        if goal.ndim == 1:
            return [closed.twist(J, np.broadcast_to(goal, (*x.shape[:-1], 6)), weights)]
        missing = np.array([error(goal, X) for X in pose.reshape(-1, 4, 4)]).reshape(
            *x.shape[:-1], 6
        )
        return [closed.twist(J, missing / dt, weights)]

    return at, pose_of.jacobian(q), (frame, goal.tobytes())


@kept
def _closed(system: Model) -> Any:

    return ConstrainedSteps(system)


def _part(had: Array, requested: Array) -> float:
    """Which part of what is required is had."""
    square = float(requested @ requested)
    return float(requested @ had) / square if square else 1.0


def _motion(wanted: Any) -> Array:
    """The twist (6,) or pose (4, 4) that is wanted, checked."""
    x = reals(
        arrays(wanted, "the wanted motion"), "the wanted motion", "a twist (6,) or a pose (4, 4)"
    )
    good = x.shape == (6,) and math.isfinite(x.dot(x))
    if x.shape == (4, 4) and not (good := _is_pose(x)):
        x = sound(x, "the wanted motion")
        good = _is_pose(x)
    if not good:
        raise InputError(
            f"the wanted motion has shape {x.shape}; it must be a twist (6,) or a pose (4, 4), "
            "finite, the rotation of a pose orthonormal with determinant +1"
        )
    return x


def _is_pose(x: Array) -> bool:
    R = x[:3, :3]
    off = math.fsum(np.abs((R @ R.T - EYE).ravel())) + abs(float(x[3, 3]) - 1.0)
    return off < SKEW and math.isfinite(x[:3, 3].sum()) and float(R[2] @ np.cross(R[0], R[1])) > 0.0


@kept
def speeds(system: Model) -> Array:
    """Largest speeds (nv,) of the steps, in rad/s and m/s: the system's velocity limits, else
    `TURNING` and `SLIDING`.

    The defaults hold for coupled joints too: a coordinate is so slow that none of its followers
    exceeds them.
    """
    table = own_tree(system).structure.table
    given = system.structure.velocity_limits
    usual = np.where(system.structure.coordinates.turning, TURNING, SLIDING)
    usual[system.structure.layout.quaternion_v[:, None] + np.arange(3)] = TURNING
    for kind, v, m in zip(
        table.kind.tolist(), table.iv.tolist(), table.multiplier.tolist(), strict=True
    ):
        if kind != BALL:
            usual[v] = min(usual[v], (TURNING if kind == TURN else SLIDING) / abs(m))
    return np.where(np.isfinite(given), given, usual)


def _numbers(x: Any, n: int, what: str, finite: bool = False) -> Array:
    try:
        out = np.broadcast_to(reals(x, what, f"a number or ({n},) numbers"), (n,))
    except InputError:
        raise
    except ValueError:
        out = np.full(1, np.nan)
    if not (out >= 0.0).all() or (finite and not np.isfinite(out).all()):
        raise InputError(
            f"{what} is {x!r}; it must be a number or ({n},) numbers, none "
            f"negative{' or infinite' if finite else ''}"
        )
    return out
