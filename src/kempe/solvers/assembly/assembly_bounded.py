"""Assembly of systems with one-sided constraints: all equations and bounds are held by the solver
of tasks.

Its steps are small quadratic programmes with an active set (`kempe.kernels.tasks.active_set`). What
is found is then led back towards its start, so that a start which violates a bound is brought to
the nearest place that holds all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.kernels.base import search_layout as S
from kempe.kernels.compiled import closure_batch
from kempe.kernels.compiled import task_search as kernel
from kempe.kernels.constraints import loop_layout as L
from kempe.kinematics.common.parallel import over_chunks
from kempe.model.closures.packed_loops import PackedLoops
from kempe.solvers.common.clock import clock
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

CHUNK = 16
SERIAL_BELOW = 32
MANY = 60
"""Rows from which on the clock is looked at within a start."""


@dataclass(frozen=True, eq=False)
class OneSidedAssembly:
    """One assembly: packed ties with one-sided ones, `weights` with or without limits, steps of a
    start, tolerance.
    """

    system: System
    loops: PackedLoops
    weights: Array
    steps: int
    tolerance: float
    rng: int
    threads: int | None

    @property
    def held(self) -> np.ndarray:
        """Which velocity coordinates (nv,) stay as they are given."""
        return np.isin(np.arange(self.system.nv), self.loops.unknown, invert=True)

    def assemble(
        self, starts: Array, pins: Array, tries: int, q: Array, residual: Array, info: np.ndarray
    ) -> None:
        """Write configurations (N, nq), residuals (N,) and (status, steps, starts) (N, 3), as
        kernels write them.

        Where `TimeUp` ends it, what was found by then is written.
        """
        try:
            self._search(starts, pins, tries, 0, q, info)
        finally:
            residual[:] = self.residuals(q, pins)

    def follow(
        self, starts: Array, pins: Array, tries: int, q: Array, residual: Array, info: np.ndarray
    ) -> None:
        """The same, each row started where the two before it lead, with its own held coordinates."""
        try:
            self._follow(starts, pins, tries, q, info)
        finally:
            residual[:] = self.residuals(q, pins)

    def _follow(self, starts: Array, pins: Array, tries: int, q: Array, info: np.ndarray) -> None:
        for i in range(len(starts)):
            first = starts[i : i + 1]
            if i:
                ahead = self.system.structure.layout.difference(q[max(i - 2, 0)], q[i - 1])
                first = self._with_known(
                    self.system.structure.layout.integrate(q[i - 1], ahead)[None], first
                )
            own = pins[i : i + 1] if len(pins) > 1 else pins
            self._search(first, own, tries, i, q[i : i + 1], info[i : i + 1])

    def residuals(self, q: Array, pins: Array) -> Array:
        """Norm (N,) of what equations and bounds miss at configurations, in radians and
        characteristic lengths.
        """
        loops = self.loops
        m = len(self.loops.names)
        g = np.empty((len(q), m))
        none = np.empty((0, m, 0))
        closure_batch.equations(
            loops.ints,
            loops.floats,
            loops.plan,
            self.weights,
            pins,
            np.ascontiguousarray(q),
            False,
            g,
            none,
        )
        return np.linalg.norm(g - np.clip(g, *loops.bounds), axis=1)

    def _search(
        self, starts: Array, pins: Array, tries: int, offset: int, q: Array, info: np.ndarray
    ) -> None:
        """Write configurations and (status, steps, starts), from starts drawn wider and wider about
        those given.
        """
        self._solve(starts, starts, pins, q, info)
        left = np.flatnonzero(info[:, 0] == S.NOT_FOUND)
        nv = self.system.nv
        least = self.residuals(q, pins)
        scale = self.loops.scale * ~self.held
        count = 1
        while count < tries and len(left):
            each = [
                np.random.default_rng((self.rng, offset + int(i), count)).uniform(-1.0, 1.0, nv)
                for i in left
            ]
            spread = min(1.0, L.WIDER * count) * np.pi * scale
            some = pins[left] if len(pins) > 1 else pins
            begin = self.system.structure.layout.integrate(starts[left], np.stack(each) * spread)
            found = begin.copy()
            more = np.zeros((len(left), 3), dtype=np.int64)
            # until these starts are made
            before = info[left, 0]
            info[left, 0] = S.NOT_FOUND + S.LATE
            self._solve(begin, starts[left], some, found, more)
            info[left, 0] = before
            size = self.residuals(found, some)
            better = (more[:, 0] == S.SOLVED) | (size < least[left])
            q[left[better]] = found[better]
            least[left[better]] = size[better]
            info[left, 0] = more[:, 0]
            info[left, 1:] += more[:, 1:]
            left = left[more[:, 0] == S.NOT_FOUND]
            count = count + 1

    def _solve(self, starts: Array, goals: Array, pins: Array, q: Array, info: np.ndarray) -> None:
        """Write the ends of one start each; what is found is led towards the goals. It may end by
        `TimeUp`.
        """
        loops = self.loops
        ties = len(self.loops.ties)
        stages = np.ones(2 * ties, dtype=np.int64)
        strengths = np.ones((ties, 3))
        strengths[:, 1:] = self.tolerance

        stop = (
            clock().address if len(loops.names) >= MANY or loops.functions else 0
        )  # each start is short, else

        def work(i: int, j: int) -> int:
            left = kernel.solve(
                loops.ints,
                loops.floats,
                loops.plan,
                self.weights,
                stages,
                strengths,
                starts[i:j],
                goals[i:j],
                pins[i:j] if len(pins) > 1 else pins,
                1,
                self.steps,
                S.AHEAD,
                stop,
                False,
                self.rng,
                q[i:j],
                info[i:j],
            )
            if error := clock().taken():
                raise error
            return left

        over_chunks(work, len(starts), CHUNK, self.threads, SERIAL_BELOW)

    def _with_known(self, q: Array, known: Array) -> Array:
        """Configurations with the held coordinates of others."""
        layout = self.system.structure.layout
        held = self.held
        out = q.copy()
        at = layout.vector_q[held[layout.vector_v]]
        out[:, at] = known[:, at]
        for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
            if held[iv]:
                out[:, iq : iq + 4] = known[:, iq : iq + 4]
        return out
