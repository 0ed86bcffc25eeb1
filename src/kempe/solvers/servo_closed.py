"""One step of the differential inverse model under constraints: loops and relations stay closed, tasks come in order.

Velocities are looked for in what the constraints leave: v = N z, with an orthonormal basis N of their null space, in
radians and characteristic lengths. What each stage reaches, the next ones keep: they act in the null space of its
equations, its inequalities become bounds (Siciliano and Slotine, 1991; Escande, Mansard and Wieber, 2014). The step is
of first order, so it opens the loops by the square of its size: they are closed again, within the same limits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.errors import InputError
from kempe.kernels import loop_layout as L
from kempe.kinematics.loops import evaluate, full
from kempe.solvers.freedoms import null
from kempe.solvers.least_squares import LEAST, NEAR, bounded, damped, scaled
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.kinematics.task import Packed
    from kempe.model.system import System
    from kempe.solvers.tasks import Problem

OPEN = 1e-3
"""By how much, in radians and characteristic lengths, loops may be open at first: more is no drift."""
CLOSED = 1e-12
"""By how much they may be open after the step."""
CORRECTIONS, HALVINGS = 8, 12
"""Steps that close the loops again, and how often a step is halved after which that fails."""
BEYOND = 1e-12
"""By how much a bound may seem to be exceeded: rounding."""


class Stage(NamedTuple):
    """What is asked at one level: A u = b as nearly as can be, and low <= I u <= high; u are scaled velocities."""

    A: Array
    b: Array
    inequalities: Array
    low: Array
    high: Array
    hard: bool = True


class Closed:
    """All of a system's steps under its constraints that does not depend on the configuration."""

    def __init__(self, system: System):
        self.system, layout = system, system.layout
        loops = full(system, True)
        self.length, self.names = loops.length, loops.names
        self.scale: Array = loops.weights[L.SCALES : L.SCALES + system.nv]
        self.at_v, self.at_q = layout.vector_v, layout.vector_q
        self.lower, self.upper = system.lower[self.at_v], system.upper[self.at_v]

    def box(self, q: Array, dt: float, speed: Array) -> tuple[Array, Array]:
        """Least and largest scaled velocities (nv,) for which limits of position and speed hold after dt.

        What is outside its limits comes back as fast as it may.
        """
        x, low, high, at = q[self.at_q], -speed, speed.copy(), self.at_v
        low[at] = np.minimum(np.maximum(low[at], (self.lower - x) / dt), speed[at])
        high[at] = np.maximum(np.minimum(high[at], (self.upper - x) / dt), -speed[at])
        return low / self.scale, high / self.scale

    def twist(self, J: Array, twist: Array, weights: Array) -> Stage:
        """The stage of a frame's twist, of its Jacobian (6, nv)."""
        w = weights.copy()
        w[:3] /= self.length
        nothing = np.zeros(0)
        return Stage(w[:, None] * J * self.scale, w * twist, np.zeros((0, self.system.nv)), nothing, nothing)

    def velocity(
        self, q: Array, stages: list[Stage], low: Array, high: Array, damping: float, direction: bool
    ) -> Array:  # fmt: skip
        """Scaled velocities (nv,) of the stages, in order, within the box. Errors: `InputError` for open loops."""
        error, C = evaluate(self.system, q, True, True)
        worst = int(np.argmax(np.abs(error))) if len(error) else -1
        if len(error) and not abs(error[worst]) < OPEN:
            raise InputError(f"the loops are open at q: {self.names[worst][0]!r} by {abs(error[worst]):.2g} (radians, "
                             f"characteristic lengths); robot.assemble(near=q) closes them")  # fmt: skip
        N = null(C)
        own = np.isfinite(low) | np.isfinite(high)
        some = _Descent(N)
        some.take(Stage(C[:0], error[:0], np.eye(len(low))[own], low[own], high[own]), 0.0, False)
        for stage in stages:
            some.take(stage, damping, direction)
        return np.minimum(np.maximum(N @ some.z, low), high)

    def after(self, q: Array, u: Array, dt: float, low: Array, high: Array) -> tuple[Array, Array]:
        """The configuration (nq,) after dt, loops closed and limits held, and u, shortened where that has to be."""
        for k in range(HALVINGS):
            part = 0.5**k
            found = self.closed(q, part * u, dt, low, high)
            if found is not None:
                return found, part * u
        return q.copy(), 0.0 * u

    def closed(self, q: Array, u: Array, dt: float, low: Array, high: Array) -> Array | None:
        """The closed configuration (nq,) next to q + u dt, None where limits or a singularity are in the way.

        By the smallest corrections (Newton), bounded where these would leave the box.
        """
        system, x = self.system, self.system.integrate(q, u * self.scale * dt)
        for _ in range(CORRECTIONS):
            error, C = evaluate(system, x, True, True)
            if np.abs(error).max(initial=0.0) <= CLOSED:
                return self._inside(q, x)
            moved = system.difference(q, x) / self.scale
            least, most = np.minimum(low * dt - moved, 0.0), np.maximum(high * dt - moved, 0.0)
            more = -np.linalg.pinv(C, rcond=1e-8) @ error
            if (more < least).any() or (more > most).any():
                A = np.concatenate([C, LEAST * np.eye(len(more))])
                more = bounded(A, np.concatenate([-error, np.zeros(len(more))]), least, most, more)
            x = system.integrate(x, more * self.scale)
        return None

    def _inside(self, q: Array, x: Array) -> Array:
        """x, its limits kept to the last bit where q kept them."""
        now = q[self.at_q]
        x[self.at_q] = np.clip(x[self.at_q], np.minimum(self.lower, now), np.maximum(self.upper, now))
        return x


class _Descent:
    """Velocities N z, lowered stage by stage: what earlier stages reached stays."""

    def __init__(self, N: Array):
        self.N, self.z, self.free = N, np.zeros(N.shape[1]), np.eye(N.shape[1])
        self.G, self.low, self.high = np.zeros((0, N.shape[1])), np.zeros(0), np.zeros(0)

    def take(self, stage: Stage, damping: float, direction: bool) -> None:
        """Do for a stage what can be done."""
        A, b, G = stage.A @ self.N, stage.b, stage.inequalities @ self.N
        value = G @ self.z
        slack = BEYOND * np.maximum(1.0, np.abs(value))
        out = (value < stage.low - slack) | (value > stage.high + slack)
        if stage.hard:
            self._bound(G[~out], stage.low[~out], stage.high[~out])
        free = self.free
        equations = np.concatenate([A, G[out]]) @ free
        wish = np.concatenate([b - A @ self.z, (np.clip(value, stage.low, stage.high) - value)[out]])
        low, high = self.low - self.G @ self.z, self.high - self.G @ self.z
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)  # rounding
        if len(wish) and free.shape[1]:
            if direction:
                y = scaled(equations, wish, low, high, self.G @ free)
            else:
                near = NEAR * (float(np.linalg.norm(equations, 2)) or 1.0)
                y = damped(equations, wish, low, high, damping * near / NEAR, self.G @ free, near)
            self.z = self.z + free @ y
        if stage.hard and out.any():
            value = G[out] @ self.z
            self._bound(G[out], np.minimum(stage.low[out], value), np.maximum(stage.high[out], value))
        self.free = free @ null(A @ free)

    def _bound(self, G: Array, low: Array, high: Array) -> None:
        self.G = np.concatenate([self.G, G])
        self.low, self.high = np.concatenate([self.low, low]), np.concatenate([self.high, high])


def stages_of(problem: Problem, q: Array, dt: float) -> list[Stage]:
    """What tasks ask of the velocities at q (nq,), level by level: that what they miss is gone after dt."""
    packed, loops = problem.packed, problem.packed.loops
    error, J = packed.evaluate(q, problem.pins)
    levels, strengths, *_ = problem.levels
    counts = np.array([len(t.rows) for t in loops.ties])
    own = packed.rows >= 0
    level, hard = (np.repeat(x, counts)[own] for x in levels.reshape(2, -1))
    weight = np.repeat(np.sqrt(strengths[:, 0]), counts)[own]
    low, high = ends_of_rows(packed)
    J, low, high = weight[:, None] * J, weight * (low - error) / dt, weight * (high - error) / dt
    out = []
    for s in range(1, int(level.max(initial=0)) + 1):
        equal, between = (level == s) & (low == high), (level == s) & (low < high)
        out.append(Stage(J[equal], low[equal], J[between], low[between], high[between], bool(hard[level == s][0])))
    return out


def ends_of_rows(packed: Packed) -> tuple[Array, Array]:
    """Low and high ends (m,) of the tasks' rows, in radians and characteristic lengths; zero for equations."""
    loops, plan, ends = packed.loops, packed.loops.plan, [np.zeros((0, 2))]
    for k, tie in enumerate(loops.ties):
        first = plan[L.AT_BOUNDS] + plan[plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND]
        own = loops.weights[first : first + 2 * len(tie.rows)] if tie.bounds else np.zeros(2 * len(tie.rows))
        ends.append(own.reshape(-1, 2))
    low, high = np.concatenate(ends)[packed.rows >= 0].T
    return low, high


def posed(system: System, wanted: Any, q: Array) -> Problem:
    """The tasks of one step, checked and packed. Errors: `InputError` for a batch, and for goals that are none."""
    from kempe.kinematics.task import refuse
    from kempe.solvers.tasks import pose_problem

    problem, _ = pose_problem(system, wanted, q)
    if problem.lead:
        raise InputError(f"the goals have the leading shape {problem.lead}; one step has one goal for each task")
    for task, goals in zip(problem.tasks, problem.goals, strict=True):
        refuse(goals, task.label)
    return problem
