"""Inputs that follow time courses, of what rolls: all else follows by integration, and the motion
must not slip.

The velocities satisfy the inputs and the loops; among those that do, the ones that slip least are
taken. They are integrated by the classical method of Runge and Kutta, and after each sample the
inputs have their values and the loops are closed. Whether the motion slips is decided by its
samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.analysis.continuation.beginning import angle_or_slide, start_of
from kempe.analysis.continuation.continuation import Closure, close
from kempe.errors import UnsupportedError
from kempe.kinematics.one_sided import one_sided_rows
from kempe.kinematics.velocity.velocity import rates
from kempe.singular_values import svd
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit
from kempe.solvers.common.slip import slip_of
from kempe.solvers.common.tracing import RANK
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

STEP = 0.02
"""Longest step of integration, in radians and characteristic lengths."""
MOST = 10_000
"""Steps at most between two samples."""
MIDDLE = 12
"""Repetitions after which the middle of a step is known."""
MISS = 1e-9
"""By how much loops may miss the velocities of inputs, of rows of size 1."""


class RollingSamples(NamedTuple):
    """Configurations (n, nq) at the samples that were done, why the motion ends, if early, and what
    broke it off.
    """

    q: Array
    reason: str
    broken: BaseException | None


def driven(
    system: System,
    names: Sequence[str],
    hold: Mapping[str, float],
    start: Any,
    clock: Array,
    samples: Callable[[int, int], list[Array]],
    limits: bool,
    budget: TimeLimit,
) -> RollingSamples | None:
    """The motion of what rolls under inputs, by their `samples` as `drive` gives them; None where
    it cannot begin.

    Errors: `UnsupportedError` where the inputs leave freedoms.
    """
    index = [angle_or_slide(system, n) for n in (*names, *hold)]
    follow = _Follow(system, index, names, hold, budget)
    q = _first(system, start, hold, names, samples(0, 1)[-1])
    if q is None:
        return None
    out = [q]
    reason = ""
    broken = None
    rows = one_sided_rows(system)
    before = samples(0, 1)[-1]
    try:
        for k in range(1, len(clock)):
            budget.check()
            q = follow.to(
                out[-1], float(clock[k - 1]), float(clock[k]), before, lambda n, k=k: samples(k, n)
            )
            before = samples(k, 1)[-1]
            if q is None:
                reason = f"at time {clock[k]:.6g} the inputs cannot be had: the loops do not close"
                break
            over = rows.beyond(q, not limits)
            if over.any():
                name = rows.names[int(np.argmax(over))]
                reason = (
                    f"it stops before time {clock[k]:.6g}, where {name!r} would be beyond its limit"
                )
                break
            out.append(q)
    except BROKEN_OFF as error:
        broken = error
    done = np.array(out)
    slip = slip_of(system, done, clock[: len(done)])
    if slip is not None:
        speed = abs(slip.amount) / slip.time
        reason = (
            f"the inputs make it slip: before time {clock[slip.index]:.6g} by {speed:.3g} "
            f"{slip.unit}/s across {slip.name!r}; getting there is a manoeuvre"
        )
        done = done[: slip.index]
    return RollingSamples(done, reason, broken)


def _first(
    system: System, start: Any, hold: Mapping[str, float], names: Sequence[str], u: Array
) -> Array | None:
    """The closed configuration (nq,) near the start with inputs `names` at u and `hold` held; None
    on failure.
    """
    near = start_of(system, start, hold)
    index = [angle_or_slide(system, n) for n in (*names, *hold)]
    closure = Closure(system)
    near[closure.place[index]] = [*u, *hold.values()]
    return close(Closure(system, index, near), near)


class _Follow:
    """Velocities that follow from those of inputs, and steps along them."""

    def __init__(
        self,
        system: System,
        index: list[int],
        names: Sequence[str],
        hold: Mapping[str, float],
        time: TimeLimit,
    ) -> None:
        self.system = system
        self.index = index
        self.closure = Closure(system)
        self.time = time
        self.names = names
        self.held = [0.0] * len(hold)
        self.slips = False
        self.loops = len(self.closure.weight)

    def at(self, q: Array, t: float, speeds: Array) -> Array:
        """Velocities (nv,) without unit. Errors: `UnsupportedError` where they are not determined."""
        unit = self.closure.unit
        A, b = rates(self.system, q, t)
        A = A * unit
        size = np.linalg.norm(A, axis=1)
        size = np.where(size > 0.0, size, 1.0)
        A = A / size[:, None]
        b = b / size
        J = self.closure.matrix(q)[: self.loops]
        M = np.concatenate([J, np.eye(len(unit))[self.index]])
        wanted = np.concatenate([np.zeros(len(J)), np.append(speeds, self.held) / unit[self.index]])
        U, s, Vt = svd(M)
        rank = int(np.sum(s > RANK))
        z = Vt[:rank].T @ ((U.T @ wanted)[:rank] / s[:rank])
        if np.abs(M @ z - wanted).max(initial=0.0) > MISS * max(
            1.0, float(np.abs(wanted).max(initial=0.0))
        ):
            raise UnsupportedError(
                f"the inputs {', '.join(map(repr, self.names))} fight each other: the loops do not "
                "allow their velocities together"
            )
        N = Vt[rank:].T
        if not N.shape[1]:
            return z
        _, s, Vt = svd(A @ N)
        free = int(np.sum(s > RANK))
        if free < N.shape[1]:
            loose = Vt[free:] @ N.T
            moving = [
                n
                for n, x in zip(
                    self.system.structure.velocity_names, np.abs(loose).max(axis=0), strict=True
                )
                if x > 1e-6
            ]
            many = len(loose)
            raise UnsupportedError(
                f"the inputs {', '.join(map(repr, self.names))} leave {many} "
                f"freedom{'s' * (many != 1)} of motion, among {', '.join(map(repr, moving[:6]))}; "
                "drive or hold more, or give velocities (system.simulate)"
            )
        z = z + N @ np.linalg.lstsq(A @ N, b - A @ z, rcond=RANK)[0]
        self.slips |= bool(
            np.abs(A @ z - b).max(initial=0.0) > MISS * max(1.0, float(np.linalg.norm(z)))
        )
        return z

    def to(
        self, q: Array, t0: float, t1: float, u: Array, samples: Callable[[int], list[Array]]
    ) -> Array | None:
        """The configuration (nq,) at the next sample, of times t0 to t1 and inputs u to those of
        the `samples`.
        """
        end = samples(1)[-1]
        h = t1 - t0
        speed = float(np.linalg.norm(self.at(q, t0, (end - u) / h)))
        parts = min(max(1, math.ceil(speed * h / STEP)), MOST)
        values = [u, *samples(2 * parts)]
        self.slips = False
        x = q
        for k in range(parts):
            self.time.check()
            x = self._runge_kutta(x, t0 + k * h / parts, h / parts, values[2 * k : 2 * k + 3])
        # between samples of inputs that are too many, straight lines do, if those at samples do not
        if self.slips:
            x = self._middle(q, t0, h, u, end)
        near = x.copy()
        near[self.closure.place[self.index[: len(end)]]] = end
        return close(Closure(self.system, self.index, near), near)

    def _runge_kutta(self, q: Array, t: float, h: float, values: list[Array]) -> Array:
        """One step of the classical method, along the parabola through three values of the inputs."""
        a, m, b = values
        first = (4 * m - 3 * a - b) / h
        middle = (b - a) / h
        last = (a - 4 * m + 3 * b) / h
        k1 = self.at(q, t, first)
        k2 = self.at(self.closure.move(q, 0.5 * h * k1), t + 0.5 * h, middle)
        k3 = self.at(self.closure.move(q, 0.5 * h * k2), t + 0.5 * h, middle)
        k4 = self.at(self.closure.move(q, h * k3), t + h, last)
        return self.closure.move(q, h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))

    def _middle(self, q: Array, t: float, h: float, u: Array, end: Array) -> Array:
        """One step by the velocities that slip least in its own middle."""
        z = self.at(q, t, (end - u) / h)
        for _ in range(MIDDLE):
            z = self.at(self.closure.move(q, 0.5 * h * z), t + 0.5 * h, (end - u) / h)
        return self.closure.move(q, h * z)
