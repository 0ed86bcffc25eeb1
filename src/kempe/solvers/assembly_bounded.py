"""Assembly of systems with one-sided constraints: all equations and bounds are held by the solver of tasks.

Its steps are small quadratic programmes with an active set (`kempe.kernels.active`), so that a start which violates a
bound is brought to it, and one that holds all is only closed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.kernels import loop_layout as L
from kempe.kernels import search_layout as S
from kempe.kernels.compiled import equations
from kempe.kernels.compiled import reach as kernel
from kempe.kinematics.parallel import over_chunks
from kempe.model.loops import Loops
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

CHUNK, SERIAL_BELOW = 16, 32


def assemble(
    system: System, loops: Loops, weights: Array, held: np.ndarray, starts: Array, pins: Array, tries: int, steps: int,
    tolerance: float, nearest: int, rng: int, threads: int | None, follow: bool,
) -> tuple[Array, Array, np.ndarray]:  # fmt: skip
    """Configurations (N, nq), residuals (N,) and (status, steps, starts) (N, 3), as of `kempe.kernels.assembly`.

    `loops` hold the one-sided ties, too; `held` (nv,) marks the coordinates that stay as in the starts (N, nq).
    """
    n = len(starts)
    q, info = np.empty((n, system.nq)), np.zeros((n, 3), dtype=np.int64)
    if follow:
        for i in range(n):
            first = starts[i : i + 1].copy()
            if i:
                ahead = system.difference(q[max(i - 2, 0)], q[i - 1])
                first = _with(system, system.integrate(q[i - 1], ahead)[None], first, held)
            pin = pins[i : i + 1] if len(pins) > 1 else pins
            q[i : i + 1], info[i : i + 1] = _search(
                system, loops, weights, held, first, pin, tries, steps, tolerance, nearest, rng, threads, i
            )
    else:
        q[:], info[:] = _search(
            system, loops, weights, held, starts, pins, tries, steps, tolerance, nearest, rng, threads, 0
        )
    return q, residuals(loops, weights, pins, q), info


def _search(
    system: System, loops: Loops, weights: Array, held: np.ndarray, starts: Array, pins: Array, tries: int, steps: int,
    tolerance: float, nearest: int, rng: int, threads: int | None, offset: int,
) -> tuple[Array, np.ndarray]:  # fmt: skip
    """Configurations and (status, steps, starts), from starts that are drawn wider and wider about the given ones."""
    q, info = _solve(loops, weights, starts, starts, pins, steps, tolerance, nearest, rng, threads)
    left = np.flatnonzero(info[:, 0] == S.NOT_FOUND)
    least = residuals(loops, weights, pins, q)
    scale, count = loops.weights[L.SCALES : L.SCALES + system.nv], 1
    while count < tries and len(left):
        spread = min(1.0, L.WIDER * count) * np.pi * scale * ~held
        drawn = np.stack([np.random.default_rng((rng, offset + int(i), count)).uniform(-1.0, 1.0, system.nv) for i in left])
        some = pins[left] if len(pins) > 1 else pins
        first = system.integrate(starts[left], drawn * spread)
        found, more = _solve(loops, weights, first, starts[left], some, steps, tolerance, nearest, rng, threads)
        count += 1
        info[left, 1:] = info[left, 1:] + more[:, 1:]
        size = residuals(loops, weights, some, found)
        better = (more[:, 0] == S.SOLVED) | (size < least[left])
        q[left[better]], least[left[better]] = found[better], size[better]
        info[left, 0] = more[:, 0]
        left = left[more[:, 0] == S.NOT_FOUND]
    return q, info


def _solve(
    loops: Loops, weights: Array, starts: Array, goals: Array, pins: Array, steps: int, tolerance: float, nearest: int,
    rng: int, threads: int | None,
) -> tuple[Array, np.ndarray]:  # fmt: skip
    """One start each."""
    n, ties = len(starts), len(loops.ties)
    q, info = np.empty_like(starts), np.empty((n, 3), dtype=np.int64)
    stages, strengths = np.ones(2 * ties, dtype=np.int64), np.ones((ties, 3))
    strengths[:, 1:] = tolerance
    mode = S.AHEAD if nearest else S.NOTHING

    def work(i: int, j: int) -> int:
        return kernel.solve(
            loops.ints, loops.floats, loops.plan, weights, stages, strengths, starts[i:j], goals[i:j],
            pins[i:j] if len(pins) > 1 else pins, 1, steps, mode, 0, False, rng, q[i:j], info[i:j],
        )  # fmt: skip

    over_chunks(work, n, CHUNK, threads, SERIAL_BELOW)
    return q, info


def _with(system: System, q: Array, known: Array, held: np.ndarray) -> Array:
    """Configurations with the held coordinates of others."""
    layout, out = system.layout, q.copy()
    at = layout.vector_q[held[layout.vector_v]]
    out[:, at] = known[:, at]
    for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
        if held[iv]:
            out[:, iq : iq + 4] = known[:, iq : iq + 4]
    return out


def residuals(loops: Loops, weights: Array, pins: Array, q: Array) -> Array:
    """Norm (N,) of what equations and bounds miss at configurations (N, nq), in radians and characteristic lengths."""
    m = len(loops.names)
    g, none = np.empty((len(q), m)), np.empty((0, m, 0))
    equations.equations(loops.ints, loops.floats, loops.plan, weights, pins, np.ascontiguousarray(q), False, g, none)
    low, high = bounds_of(loops)
    return np.linalg.norm(g - np.clip(g, low, high), axis=1)


def bounds_of(loops: Loops) -> tuple[Array, Array]:
    """The bounds (m,) of all equations of packed ties, as scaled there; zero for equations."""
    low, at = np.zeros((2, len(loops.names))), 0
    for k, tie in enumerate(loops.ties):
        if tie.bounds:
            place = int(loops.plan[L.AT_BOUNDS] + loops.plan[loops.plan[L.AT_TIES] + L.TIE_INTS * k + L.BOUND])
            n = len(tie.rows)
            low[:, at : at + n] = loops.weights[place : place + 2 * n].reshape(n, 2).T
        at += len(tie.rows)
    return low[0], low[1]
