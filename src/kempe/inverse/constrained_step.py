"""One step of a system with constraints, for a frame or for several tasks in order.

Velocities are looked for in what the constraints leave, velocity constraints among them: v = N z,
with an orthonormal basis N of their null space, in radians and characteristic lengths. What each
stage reaches, the next ones keep: they act in the null space of its equations, its inequalities
become bounds (Siciliano and Slotine, 1991; Escande, Mansard and Wieber, 2014). The step is of
first order, so it opens the loops by the square of its size: they are closed again, within the
same limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.assemble.nearest_exact import find_ideal_system
from kempe.equations.closure_rows import evaluate_constraints, pack_full_loops
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.slip import compute_unit_rows, find_shortest_velocity, has_velocity_constraints
from kempe.equations.velocity import list_velocity_row_names
from kempe.errors import InputError
from kempe.kernels.servo.step_constants import (
    ASIDE,
    BEYOND,
    BLIND,
    BUSY,
    DIFFERENCE,
    EDGE,
    ENOUGH,
    FLAT,
    HALF,
    LARGEST,
    LEADS,
    LEAST,
    LITTLE,
    LITTLE_USE,
    MUCH_USE,
    NEAR,
    NOTHING,
    SADDLE,
    SHIFT,
    SHORTER,
    SLOW,
    STILL,
    TAKEN,
    TRIALS,
)
from kempe.model.model import keep_answers
from kempe.numerics.least_squares import (
    Bend,
    compute_feasible_fraction,
    minimize_bounded_residual,
    minimize_damped_residual,
    minimize_quadratic_in_box,
    scale_solution_to_bounds,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.tasks.demands import Demands
    from kempe.model.model import Model


OPEN = 1e-3
"""By how much, in radians and characteristic lengths, loops may be open at first: more is no
drift."""
CLOSED = 1e-12
"""By how much they may be open after the step."""
CORRECTIONS = 8
HALVINGS = 12
"""Steps that close the loops again, and how often a step is halved after which that fails."""
PREVENTS = 1e-6
"""Part of what is missed that a velocity constraint takes, where it is named as the reason."""


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

    def make_remaining_stage(self, rest: Array) -> Stage:
        """Make the stage that remains when velocities at `rest` (nv,) are already there."""
        if not rest.any():
            return self
        have = self.inequalities @ rest
        return self._replace(b=self.b - self.A @ rest, low=self.low - have, high=self.high - have)

    def compute_residual_norm(self, u: Array | None = None) -> float:
        """Compute the norm of the residual that velocities u (nv,) leave; without u, of all."""
        left = self.b if u is None else self.b - self.A @ u
        square = float(left @ left)
        if len(self.low):
            value = np.zeros(len(self.low)) if u is None else self.inequalities @ u
            out = np.maximum(self.low - value, 0.0) + np.maximum(value - self.high, 0.0)
            square += float(out @ out)
        return math.sqrt(square)


class NearRows(NamedTuple):
    """How the distances of near bodies change from a configuration on, to first order.

    `rates` (k, nv) are their derivatives at `q` by the velocities, and `least` (k,) is by how much
    each must grow within the step, both in characteristic lengths. A distance may shrink where
    that is negative.
    """

    q: Array
    rates: Array
    least: Array

    def pack(self, scale: Array, dt: float) -> Array:
        """Pack derivatives by scaled velocities and least speeds, row by row, for the kernel."""
        return np.column_stack([self.rates * scale, self.least / dt]).ravel()

    def make_stage(self, system: Model, scale: Array, q: Array, dt: float) -> Stage:
        """Make the stage that keeps bodies apart, at configurations (..., nq)."""
        moved = system.structure.layout.compute_difference(np.broadcast_to(self.q, q.shape), q)
        low = (self.least - moved @ self.rates.T) / dt
        rows = np.broadcast_to(self.rates * scale, (*q.shape[:-1], *self.rates.shape))
        return Stage(rows[..., :0, :], low[..., :0], rows, low, np.full(low.shape, math.inf))


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
    """Quantities of a constrained system's steps that do not depend on q.

    `closing` is the system whose loops stay closed: the ideal one of `system`, or itself.
    """

    def __init__(self, system: Model):
        self.system = system
        layout = system.structure.layout
        self.closing = find_ideal_system(system)
        loops = pack_full_loops(self.closing, True)
        self.length = loops.length
        self.names = loops.names
        self.rolls = has_velocity_constraints(system)
        self.scale: Array = loops.scale
        self.at_v = layout.vector_v
        self.at_q = layout.vector_q
        self.lower = system.lower[self.at_v]
        self.upper = system.upper[self.at_v]
        self.bounds = pack_one_sided_rows(self.closing)
        self.upcoming: tuple[Any, Any] = None, None
        """A step that was computed ahead, after what asks for it."""

    def compute_velocity_bounds(self, q: Array, dt: float, speed: Array) -> tuple[Array, Array]:
        """Compute bounds (nv,) of scaled velocities that keep limits of position and speed.

        They hold after dt.

        What is outside its limits goes no further, and may rest.
        """
        x = q[self.at_q]
        low = -speed
        high = speed.copy()
        at = self.at_v
        below = self.lower - x
        above = self.upper - x
        near = EDGE * np.maximum(1.0, np.abs(x))
        low[at] = np.maximum(low[at], np.where(below < -near, below / dt, 0.0))
        high[at] = np.minimum(high[at], np.where(above > near, above / dt, 0.0))
        return low / self.scale, high / self.scale

    def make_twist_stage(self, J: Array, twist: Array, weights: Array) -> Stage:
        """Make the stage of a frame's twist from its Jacobian (6, nv)."""
        w = weights.copy()
        w[:3] /= self.length
        nothing = np.zeros(0)
        return Stage(
            w[:, None] * J * self.scale, w * twist, np.zeros((0, self.system.nv)), nothing, nothing
        )

    def find_free_velocities(self, q: Array, dt: float) -> Left:
        """Find the velocities that constraints leave at q (nq,), for dt.

        Errors: `InputError` for open loops.
        """
        error, C = evaluate_constraints(self.closing, q, True, True)
        worst = int(np.argmax(np.abs(error))) if len(error) else -1
        if len(error) and not abs(error[worst]) < OPEN:
            raise InputError(
                f"the loops are open at q: {self.names[worst][0]!r} by {abs(error[worst]):.2g} "
                "(radians, characteristic lengths); robot.assemble(start=q) closes them"
            )
        between = self._compute_row_bounds(q, dt)
        if not self.rolls:
            return Left(
                Spectrum(C, 1.0).compute_null_space(Level.CLOSED),
                np.zeros(self.system.nv),
                *between,
            )
        A, b = compute_unit_rows(self.system, q, self.scale)
        basis = Spectrum(np.concatenate([C, A]), 1.0).compute_null_space(Level.CLOSED)
        return Left(basis, find_shortest_velocity(C, A, b), *between)

    def _compute_row_bounds(self, q: Array, dt: float) -> tuple[Array, Array, Array]:
        """Compute rows (m, nv) of declared inequalities, and bounds of their change within dt."""
        rows = self.bounds
        k = self.bounds.declared
        if not k:
            return np.zeros((0, self.system.nv)), np.zeros(0), np.zeros(0)
        value, G = rows.compute_rates(q, declared=True)
        scale = rows.scale[:k] / dt
        return G, scale * (rows.low[:k] - value), scale * (rows.high[:k] - value)

    def _evaluate_errors(self, x: Array, before: Array) -> tuple[Array, Array]:
        """Compute errors and rates of equations, and of inequalities violated beyond `before`."""
        error, C = evaluate_constraints(self.closing, x, True, True)
        if not self.bounds.declared:
            return error, C
        more, G = self.bounds.find_violated_rows(x, before)
        return np.concatenate([error, more]), np.concatenate([C, G])

    def compute_velocity(
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
        """Compute scaled velocities (nv,) for the stages, in order, within the box.

        `speeds`, least and largest velocities within the box, shorten what a stage asks for, before
        others take over. `twist` says that the stage is a twist, or has a direction that is kept.
        `model` (k, k), where given, is the Hessian that counts for the last stage.
        """
        N, rest, rows, least, most = free
        some = _Descent(N, speeds)
        own = np.isfinite(low) | np.isfinite(high)
        rows = np.concatenate([np.eye(len(low))[own], rows])
        box = Stage(N.T[:0], low[:0], rows, np.append(low[own], least), np.append(high[own], most))
        some.take_stage(box.make_remaining_stage(rest), 0.0)
        for k, stage in enumerate(stages):
            last = k + 1 == len(stages)
            some.take_stage(
                stage.make_remaining_stage(rest), damping, twist, model if last else None
            )
            if not last:
                some.keep_equations(stage)
        least, most = speeds or (low, high)
        return np.minimum(np.maximum(rest + N @ some.z, least), most)

    def find_blocking_constraints(
        self, q: Array, stages: list[Stage], u: Array, low: Array, high: Array
    ) -> tuple[str, ...]:
        """Find the velocity constraints that prevent a motion, by their multipliers.

        They prevent what velocities u (nv,) leave of the stages.
        """
        pull = sum((s.A.T @ (s.b - s.A @ u) for s in stages if s.hard), np.zeros(len(u)))
        C = evaluate_constraints(self.closing, q, True, True)[1]
        A = compute_unit_rows(self.system, q, self.scale)[0]
        bounds = np.eye(len(u))[(u <= low) | (u >= high)]
        forces = Spectrum(np.concatenate([A, C, bounds]).T).solve_least_squares(pull, Level.CLOSED)[
            : len(A)
        ]
        some = np.abs(forces) > PREVENTS * math.sqrt(float(pull @ pull))
        return tuple(
            dict.fromkeys(
                name
                for (name, _), is_so in zip(list_velocity_row_names(self.system), some, strict=True)
                if is_so
            )
        )

    def make_twist_step(
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
        """Compute the step of a twist: q (nq,) after dt, velocities (nv,), whether it is calm."""
        free = self.find_free_velocities(q, dt)
        twist = Twist(dt, self.make_bend(q, free.basis, stages[0], at), direction)
        return *self.take_step(
            q, self.compute_velocity(free, stages, low, high, damping, twist=twist), dt, low, high
        ), False

    def make_goal_step(
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
        """Compute the step to goals: q (nq,) after dt, velocities (nv,), whether it is calm.

        Where a `direction` is kept the step is straight as long as that leads on. Otherwise the
        first stage that a step of first order does not lower as promised takes one of second order,
        which must do so, else a shorter one; stages after it do not count. Limits of speed shorten
        these steps. `at` gives the stages at a configuration. The motion is calm where the step
        arrives, and the next one makes good only what second derivatives have left: then no joint
        turns back.
        """
        free = self.find_free_velocities(q, dt)
        if direction:
            after, u = self.make_straight_step(q, free, stages, low, high, dt, at)
            if (share := compute_progress(stages[0].A, stages[0].b, u, low, high)) == 1.0:
                return after, u, False
            other = self.make_goal_step(q, stages, low, high, damping, False, dt, at, slow)[1]
            return *self.take_step(q, share * u + (1.0 - share) * other, dt, low, high), False
        wide = (low, high)
        speeds = None
        if not free.rest.any():
            least, most = self.compute_velocity_bounds(q, dt, np.full(len(low), math.inf))
            wide = (np.maximum(least, -LARGEST / dt), np.minimum(most, LARGEST / dt))
            speeds = (low, high)
        u = self.compute_velocity(free, stages, *wide, damping)
        size = dt * float(u @ u)
        requested = [s.compute_residual_norm() for s in stages]
        still = size * dt <= ENOUGH**2
        whole = speeds is None or compute_feasible_fraction(u, low, high) == 1.0
        left = [s.compute_residual_norm(u) for s in stages]
        if not (whole or still):  # far away
            left = [s.compute_residual_norm() for s in at(self.take_step(q, u, dt, *wide)[0])]
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
                u = np.zeros_like(u)
            elif not whole:
                u = self.compute_velocity(free, stages, *wide, damping, speeds=speeds)
            next_speed = size * math.sqrt(len(u)) / max(NEAR, damping)
            calm = (
                whole
                and max(left, default=0.0) <= ENOUGH / dt
                and damping >= NEAR
                and next_speed <= slow
            )
            return *self.take_step(q, u, dt, low, high), calm
        own = stages[: k + 1]
        before = requested[k]
        model = self.compute_hessian(q, free.basis, own, u, *wide, dt, at)
        more = 0.0
        for _ in range(TRIALS):
            convex = model + more * np.eye(len(model))
            u = self.compute_velocity(free, own, *wide, damping, model=convex)
            promise = before**2 - own[k].compute_residual_norm(u) ** 2
            if (
                promise <= BLIND * before**2
                and (way := self.leave_saddle_point(free, own, u, *wide, dt, model)) is not None
            ):
                u, promise = way
                speeds = (low, high) if speeds is None else speeds
                convex = None
            if 0.0 <= promise <= STILL * before**2 + (NOTHING / dt) ** 2:
                break
            if promise > 0.0 and (
                promise <= BLIND * before**2
                or at(self.take_step(q, u, dt, *wide)[0])[k].compute_residual_norm() ** 2
                <= before**2 - TAKEN * promise
            ):
                if convex is None:
                    u = compute_feasible_fraction(u, low, high) * u
                elif speeds is not None:
                    u = self.compute_velocity(
                        free, own, *wide, damping, speeds=speeds, model=convex
                    )
                return *self.take_step(q, u, dt, low, high), False
            more = 4.0 * more if more else 1e-2 * float(np.abs(model).max())
        u = self.compute_velocity(free, stages[:k], *wide, damping, speeds=speeds)
        return *self.take_step(q, u, dt, low, high), False

    def make_straight_step(
        self,
        q: Array,
        free: Left,
        stages: list[Stage],
        low: Array,
        high: Array,
        dt: float,
        at: Callable[[Array], list[Stage]],
    ) -> tuple[Array, Array]:
        """Compute the step to a pose in a fixed direction: q (nq,) after dt, velocities (nv,).

        The step is halved until it lowers what is missed by half of what it promises; if it never
        does, there is none.
        """
        twist = Twist(dt, self.make_bend(q, free.basis, stages[0], at), True)
        before = stages[0].compute_residual_norm()
        u = self.compute_velocity(free, stages, low, high, 0.0, twist=twist)
        for _ in range(HALVINGS if before > ENOUGH / dt else 0):
            promise = before**2 - stages[0].compute_residual_norm(u) ** 2
            if promise <= STILL * before**2:
                break
            found = self.take_step(q, u, dt, low, high)
            if at(found[0])[0].compute_residual_norm() ** 2 <= before**2 - HALF * promise:
                return found
            u = 0.5 * u
        return self.take_step(q, np.minimum(np.maximum(0.0, low), high), dt, low, high)

    def leave_saddle_point(
        self,
        free: Left,
        stages: list[Stage],
        u: Array,
        low: Array,
        high: Array,
        dt: float,
        model: Array,
    ) -> tuple[Array, float] | None:
        """Find velocities (nv,) that leave a saddle point of the last stage's error.

        Also returns the decrease that they promise; None without such velocities.

        Their direction is that of the least curvature, where it is negative, among those that
        earlier stages and bounds leave; None where there is no such direction.
        """
        N = free.basis
        held = np.eye(len(u))[(u <= low) | (u >= high)] @ N
        earlier = np.concatenate([held, *(s.A @ N for s in stages[:-1])])
        own = Spectrum(earlier, 1.0).compute_null_space(Level.CLOSED)
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
        step = compute_feasible_fraction(np.concatenate(rows) @ step, least, most) * step
        return step, -float(values[0]) * float(step @ step)

    def make_bend(
        self, q: Array, N: Array, stage: Stage, at: Callable[[Array], list[Stage]]
    ) -> Bend:
        """Make the function that gives second derivatives (k, m, n) of a stage's equations.

        They are along directions (k, n) of the free velocities N.

        Loops stay closed to second order.
        """

        def compute_bends(ways: Array) -> Array:
            size = np.abs(ways).max(axis=1)
            moves = (DIFFERENCE / np.where(size > 0.0, size, 1.0))[:, None] * (ways @ N.T)
            ends = self.system.structure.layout.integrate_velocity(
                q, np.concatenate([moves, -moves]) * self.scale
            )
            per = (size / (2.0 * DIFFERENCE))[:, None, None]
            k = len(ways)
            A = at(ends)[0].A
            C = evaluate_constraints(self.closing, ends, True, True)[1]
            A = (A[:k] - A[k:]) * per
            C = (C[:k] - C[k:]) * per
            if C.shape[-2]:
                closing = evaluate_constraints(self.closing, q, True, True)[1]
                A = A - stage.A @ Spectrum(closing).compute_pseudo_inverse(Level.CLOSED) @ C
            return A @ N

        return compute_bends

    def compute_hessian(
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
        """Compute the Hessian (k, k), in the free velocities, of half the square of what the last stage
        misses, where loops and earlier stages stay as they are: that of the Lagrangian, by
        differences.
        """

        def evaluate_pull(x: Array, requested: list[Stage]) -> tuple[Array, Array]:
            """Evaluate the gradient (..., nv) of the last stage, and the rows (..., m, nv) that stay, at
            configurations.
            """
            C = evaluate_constraints(self.closing, x, True, True)[1]
            s = requested[-1]
            out = np.maximum(s.low, 0.0) + np.minimum(s.high, 0.0)
            pull = np.einsum("...i,...ij->...j", s.b, s.A) + np.einsum(
                "...i,...ij->...j", out, s.inequalities
            )
            return dt * pull, np.concatenate([C, *(t.A for t in requested[:-1])], axis=-2)

        pull, rows = evaluate_pull(q, stages)
        at_bound = np.eye(len(u))[(u <= low) | (u >= high)]
        rolling = compute_unit_rows(self.system, q, self.scale)[0] if self.rolls else at_bound[:0]
        held = np.concatenate([rows, rolling, at_bound])
        forces = (
            Spectrum(held.T).solve_least_squares(pull, Level.CLOSED)[: len(rows)]
            if len(held)
            else np.zeros(0)
        )
        moves = DIFFERENCE * N.T * self.scale
        ends = self.system.structure.layout.integrate_velocity(q, np.concatenate([moves, -moves]))
        pulled, kept = evaluate_pull(ends, at(ends)[: len(stages)])
        pulled = pulled - np.einsum("i,...ij->...j", forces, kept)
        H = (pulled[len(moves) :] - pulled[: len(moves)]) @ N / (2.0 * DIFFERENCE)
        return 0.5 * (H + H.T)

    def take_step(
        self, q: Array, u: Array, dt: float, low: Array, high: Array
    ) -> tuple[Array, Array]:
        """Compute the closed configuration (nq,) after dt within limits, and u, perhaps shortened."""
        for k in range(HALVINGS):
            part = 0.5**k
            found = self.find_closed_configuration(q, part * u, dt, low, high)
            if found is not None:
                return found, part * u
        return q.copy(), 0.0 * u

    def find_closed_configuration(
        self, q: Array, u: Array, dt: float, low: Array, high: Array
    ) -> Array | None:
        """Find the closed configuration (nq,) next to q + u dt.

        None where limits or a singularity prevent it.

        By the smallest corrections (Newton), bounded where these would leave the box.
        """
        system = self.system
        x = self.system.structure.layout.integrate_velocity(
            q, (self.correct_slip(q, u, dt) if self.rolls else u) * self.scale * dt
        )
        before = self.bounds.compute_excess(q, declared=True) if self.bounds.declared else x
        for _ in range(CORRECTIONS):
            error, C = self._evaluate_errors(x, before)
            if np.abs(error).max(initial=0.0) <= CLOSED:
                return self._clamp_to_limits(q, x)
            moved = system.structure.layout.compute_difference(q, x) / self.scale
            least = np.minimum(low * dt - moved, 0.0)
            most = np.maximum(high * dt - moved, 0.0)
            more = -Spectrum(C).compute_pseudo_inverse(Level.CLOSED) @ error
            if (more < least).any() or (more > most).any():
                H = C.T @ C + LEAST**2 * np.eye(len(more))
                more = minimize_quadratic_in_box(H, -C.T @ error, least, most)[0]
            x = system.structure.layout.integrate_velocity(x, more * self.scale)
        return None

    def correct_slip(self, q: Array, u: Array, dt: float) -> Array:
        """Correct velocities (nv,) so that the middle of the step does not slip, to second order."""
        A, b = compute_unit_rows(
            self.system,
            self.system.structure.layout.integrate_velocity(q, 0.5 * dt * u * self.scale),
            self.scale,
        )
        return u - Spectrum(A).compute_pseudo_inverse(Level.CLOSED) @ (A @ u - b)

    def _clamp_to_limits(self, q: Array, x: Array) -> Array:
        """Clamp x to the limits, to the last bit, where q kept them."""
        now = q[self.at_q]
        x[self.at_q] = np.clip(
            x[self.at_q], np.minimum(self.lower, now), np.maximum(self.upper, now)
        )
        return x


@keep_answers
def make_constrained_steps(system: Model) -> ConstrainedSteps:
    """Make what the steps of a system need, once."""
    return ConstrainedSteps(system)


class Twist(NamedTuple):
    """What a twist needs beside its equations: the time of the step, their derivatives, and whether
    it is kept.
    """

    dt: float
    bend: Bend
    kept: bool


class _Descent:
    """Velocities N z that satisfy stages one after the other."""

    def __init__(self, N: Array, speeds: tuple[Array, Array] | None = None):
        self.N = N
        self.z = np.zeros(N.shape[1])
        self.free = np.eye(N.shape[1])
        self.G = np.zeros((0, N.shape[1]))
        self.low = np.zeros(0)
        self.high = np.zeros(0)
        self.speeds = speeds

    def take_stage(
        self, stage: Stage, damping: float, twist: Twist | None = None, model: Array | None = None
    ) -> None:
        """Minimise the error of a stage while earlier stages keep theirs.

        `model` (k, k), where given, is the Hessian of the stage.
        """
        A = stage.A @ self.N
        b = stage.b
        G = stage.inequalities @ self.N
        value = G @ self.z
        slack = BEYOND * np.maximum(1.0, np.abs(value))
        out = (value < stage.low - slack) | (value > stage.high + slack)
        if stage.hard:
            self._add_bounds(G[~out], stage.low[~out], stage.high[~out])
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
                y = scale_solution_to_bounds(
                    equations, wish, low, high, twist.dt, twist.bend, self.G @ free
                )
            elif twist is not None:
                y = minimize_damped_residual(
                    equations, wish, low, high, damping, self.G @ free, twist.bend, SHIFT
                )
            else:
                if model is not None:
                    pull = free.T @ (
                        A.T @ b
                        + G[out].T @ np.clip(value, stage.low, stage.high)[out]
                        - model @ self.z
                    )
                    equations, wish = make_convex_problem(
                        free.T @ model @ free, pull, equations, damping
                    )
                    damping = 0.0
                y = minimize_damped_residual(equations, wish, low, high, damping, self.G @ free)
            self.z = self.z + free @ (
                y if self.speeds is None else self._slow_velocities(y, equations, low, high)
            )
        if stage.hard and out.any():
            value = G[out] @ self.z
            self._add_bounds(
                G[out], np.minimum(stage.low[out], value), np.maximum(stage.high[out], value)
            )

    def keep_equations(self, stage: Stage) -> None:
        """Leave to later stages what moves none of the equations of a stage."""
        A = stage.A @ (self.N @ self.free)
        self.free = self.free @ Spectrum(A, 1.0).compute_null_space(Level.CLOSED)

    def _slow_velocities(self, y: Array, equations: Array, low: Array, high: Array) -> Array:
        """Shorten y (k,) to the limits of speed, then find the nearest allowed velocities."""
        assert self.speeds is not None
        rows = self.N @ self.free
        (least, most) = self.speeds
        now = self.N @ self.z
        y = compute_feasible_fraction(rows @ y, least, most) * y
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
        return minimize_bounded_residual(metric, metric @ y, low, high, G)

    def _add_bounds(self, G: Array, low: Array, high: Array) -> None:
        """Add bounds low <= G z <= high."""
        self.G = np.concatenate([self.G, G])
        self.low = np.concatenate([self.low, low])
        self.high = np.concatenate([self.high, high])


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


def make_convex_problem(H: Array, pull: Array, J: Array, damping: float) -> tuple[Array, Array]:
    """Make the least-squares rows and right side (n,) of a Hessian and a pull.

    Curvatures of the Hessian are made positive.

    What damping the equations J would have is added.
    """
    spectrum = Spectrum(J)
    Vt = spectrum.right
    s = np.append(spectrum.values, np.zeros(len(Vt) - len(spectrum.values))) / spectrum.largest
    weak = damping * np.sqrt(np.maximum(1.0 - (s / NEAR) ** 2, 0.0)) * float(np.linalg.norm(J, 2))
    values, V = np.linalg.eigh(H + (Vt.T * weak**2) @ Vt)
    size = np.abs(values)
    size[size <= FLAT * size.max()] = max(float(size.max()), 1e-300)
    return np.sqrt(size)[:, None] * V.T, (pull @ V) / np.sqrt(size)


def find_steady_fraction(after: Callable[[float], Array], velocity: Array, fastest: Array) -> float:
    """Find the fraction of the step after which no joint turns back at once.

    Speeds below `SLOW` of the largest (n,) do not count.

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


class StageMaker:
    """The stages of tasks, with all that does not depend on the configuration looked up once."""

    def __init__(self, problem: Demands, dt: float, near: NearRows | None = None):
        self.evaluate = problem.packed.evaluate_tasks
        self.pins = problem.pins
        packed = problem.packed
        self.system = packed.system
        self.scale = packed.scale
        self.dt = dt
        self.near = near
        levels, strengths, *_ = problem.levels
        counts = np.array([len(t.row_names) for t in packed.loops.ties])
        own = packed.rows >= 0
        level, hard = (np.repeat(x, counts)[own] for x in levels.reshape(2, -1))
        weight = np.repeat(np.sqrt(strengths[:, 0]), counts)[own]
        low, high = packed.row_bounds
        equal = low == high
        self.weight = weight[:, None]
        self.rate = weight / dt
        self.low = low * self.rate
        self.high = high * self.rate
        self.parts = [
            (
                np.flatnonzero((level == k) & equal),
                np.flatnonzero((level == k) & ~equal),
                bool(hard[level == k][0]),
            )
            for k in range(1, int(level.max(initial=0)) + 1)
        ]
        """Rows of equations and of inequalities of each stage, and whether it is hard."""

    def __call__(self, q: Array) -> list[Stage]:
        """Make the stages at q (..., nq): near bodies stay apart, and errors of the tasks vanish
        after dt.
        """
        near = self.near
        first = [] if near is None else [near.make_stage(self.system, self.scale, q, self.dt)]
        error, J = self.evaluate(q, self.pins)
        J = self.weight * J
        error = self.rate * error
        low = self.low - error
        high = self.high - error
        return first + [
            Stage(
                J[..., equal, :],
                low[..., equal],
                J[..., between, :],
                low[..., between],
                high[..., between],
                hard,
            )
            for equal, between, hard in self.parts
        ]
