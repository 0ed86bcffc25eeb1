"""Steps along the way of targets: from target to target without a jump, also through singularities.

Where nothing is singular a step is explained by its first order. Near a singularity that says
little: there a path goes on as before where it can, and a turn of joints that leaves the targets'
way alone is no jump.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.kernels.base.search_layout import SOLVED
from kempe.singular_values import svd
from kempe.solvers.common.clock import TimeLimit
from kempe.solvers.common.serial_chain import inside
from kempe.solvers.tasks.demands import Demands
from kempe.solvers.tasks.ik_tasks import judge
from kempe.solvers.tasks.uninvolved import apart
from kempe.spatial import Array

TOLERANCE = 1e-10
"""Largest error of the targets along a path, in metres and radians."""
DEPTH = 12
"""How often the way between two targets is halved before it counts as a jump."""
SMALL = 0.02
"""Steps so small, in radians and characteristic lengths, need no explanation: with square roots, 1
/ 2^(DEPTH/2)."""
STRETCH = 2.0
"""How many times longer than its first order a step may be."""
ALIKE = 0.5
"""How much a step may differ from the one before, as a part of it, to count as going on."""
DAMPING = 1e-3
"""Singular values below it do not make the first order longer (Wampler, 1986)."""
SINGULAR = 0.05
"""Ratio of singular values at the end of a path below which it ends at a singularity; it falls with
a square root."""
WEAK = 0.1
"""Ratio of singular values below which a path goes on as before where it can."""
BESIDE = 0.1
"""How far from their way, as a part of it, straight lines of the joints may lead that are no
jump."""
ASIDE = (0.0, 1.0, -1.0, 2.0, -2.0)
"""Steps aside, as parts of the first order, from which the other side of a singularity is looked
for."""
CALM = 0.7
"""Part of the steps before the last one in what goes on, where tolerances let targets be
rounded."""
UNEVEN = 0.5
"""Part by which the ways to two targets may differ that count as equal steps of one motion."""
STAYS = 1e-9
"""Length of a way below which a target stays where it was."""
AVOID = 0.1
"""Self-motion at most at one target, in radians and characteristic lengths, that leads away from
limits."""
TRUNCATED = 6
"""Steps that leave out what is singular."""


class Order(NamedTuple):
    """First-order step towards a problem's solution, and how singular its Jacobian is."""

    ahead: Array
    """The scaled step (nv,) to it, damped."""
    ratio: float
    """The smallest singular value, as a part of the largest."""
    weak: Array
    """The velocity (nv,) that belongs to it."""
    way: float
    """The length of what is missing."""


class _Targets:
    """The problems of the single targets of a path, which are made where they are needed: there may
    be a million.
    """

    def __init__(self, problem: Demands):
        self.count = problem.lead[0]
        self._of = functools.lru_cache(8)(problem.of)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, i: int) -> Demands:
        return self._of(i)


class PathSteps:
    """The targets of a path, those interpolated between them, and steps from one to the next."""

    def __init__(
        self,
        problem: Demands,
        max_step: float,
        budget: TimeLimit,
        progress: Callable[[int], None] | None = None,
    ):
        tasks = tuple(t.exactly() for t in problem.tasks)
        self.problem = replace(problem, tasks=tasks)
        self.max_step = max_step
        self.budget = budget
        self.given = min(problem.tolerance)
        self.calm = CALM if self.given > TOLERANCE else 0.0
        self.system = problem.system
        self.scale = problem.packed.scale
        self.progress = progress
        self.rows = _Targets(self.problem)
        packed = problem.packed
        equal = np.repeat(
            [not t.bounds for t in packed.loops.ties], [len(t.rows) for t in packed.loops.ties]
        )
        hard = [i for i, t in enumerate(tasks) if t.weight is None]
        own = packed.rows >= 0
        self.counts = np.isin(packed.rows[own], hard) & equal[own]

    def at(self, i: int, part: float) -> Demands:
        """The problem at the fraction `part` of the way from target i - 1 to target i."""
        if part >= 1.0:
            return self.rows[i]
        a = self.rows[i - 1].goals
        b = self.rows[i].goals
        goals: Any = tuple(
            [
                (_between(x, y, part), None if m is None or n is None else m + part * (n - m))
                for (x, m), (y, n) in zip(g, h, strict=True)
            ]
            for g, h in zip(a, b, strict=True)
        )
        return replace(self.rows[i], goals=goals, pins=self.problem.packed.pins(goals))

    def first_order(self, problem: Demands, q: Array, weak: float = 0.0) -> Order:
        """Damped first-order step from q that solves a problem.

        Singular values below `weak` times the largest are left out.
        """
        e, J = self.missing(problem, q)
        if not J.size:
            return Order(np.zeros(self.system.nv), 1.0, np.zeros(self.system.nv), 0.0)
        U, s, Vt = svd(J, full_matrices=False)
        part = s / (s * s + DAMPING**2)
        if weak:
            part[s < weak * s[0]] = 0.0
        return Order(
            -Vt.T @ (part * (U.T @ e)),
            float(s[-1] / max(s[0], 1e-300)),
            Vt[-1],
            float(np.linalg.norm(e)),
        )

    def missing(self, problem: Demands, q: Array) -> tuple[Array, Array]:
        """Residuals (m,) of hard tasks and loops at q (nq,), and their Jacobian (m, nv)."""
        packed = problem.packed
        e, J = packed.evaluate(q, problem.pins)
        if not self.counts.all():
            e = e[self.counts]
            J = J[self.counts]
        if packed.closed:
            more, rows = packed.evaluate(q, problem.pins, closures=True)
            e = np.concatenate([e, more])
            J = np.concatenate([J, rows])
        return e, J

    def step(self, problem: Demands, q: Array, order: Order | None = None) -> Array | None:
        """The configuration (nq,) near q that solves a problem, found by first-order steps; None
        where there is none.

        Singular configurations are left by a small step to either side: there, the residual gives
        no direction.
        """
        ahead, ratio, weak, _ = self.first_order(problem, q) if order is None else order
        if np.abs(ahead).max(initial=0.0) > self.max_step:
            return None
        for aside in (0.0, 0.5, -0.5) if ratio < SINGULAR else (0.0,):
            found, moved = self.land(problem, q, ahead + aside * SMALL * weak)
            most = np.abs(moved).max(initial=0.0)
            explained = (
                most <= self.max_step
                and np.linalg.norm(moved) <= STRETCH * np.linalg.norm(ahead) + SMALL
            )
            if found is not None and (explained or most <= SMALL):
                return found
        return None

    def coast(self, problem: Demands, q: Array, before: Array) -> Array | None:
        """The configuration (nq,) near q that solves a problem, found by repeating the last scaled
        step (nv,); or None.

        So targets beyond a singularity are met.
        """
        if not before.any():
            return None
        found = self.loose(problem, q, before)
        if found is not None:
            return found
        found, moved = self.land(problem, q, before)
        return found if found is not None and self.smooth(moved, before) else None

    def loose(self, problem: Demands, q: Array, before: Array) -> Array | None:
        """As `coast`, but within the tolerance only: residuals in singular directions stay. None
        where this fails.
        """
        x = self.truncated(problem, q, before) if self.given > TOLERANCE else None
        good = x is not None and judge(problem, x[None], np.full((1, 3), SOLVED)).success
        return x if good else None

    def truncated(self, problem: Demands, q: Array, before: Array) -> Array | None:
        """As `coast`, then corrected in the regular directions only; None where the configuration
        is off the target.
        """
        x = self.system.structure.layout.integrate(q, before * self.scale)
        for _ in range(TRUNCATED):
            x = self.system.structure.layout.integrate(
                x, self.first_order(problem, x, SINGULAR).ahead * self.scale
            )
            x = inside(self.system, x[None])[0] if problem.limits else x
        return (
            x
            if self.smooth(self.system.structure.layout.difference(q, x) / self.scale, before)
            else None
        )

    def smooth(self, moved: Array, before: Array) -> bool:
        """Whether a scaled step (nv,) continues the step before, without a jump or a sharp turn."""
        close = np.linalg.norm(moved - before) <= ALIKE * np.linalg.norm(before)
        return bool(close) and np.abs(moved).max(initial=0.0) <= self.max_step

    def opening(self, i: int, q: Array, order: Order) -> Array | None:
        """The configuration (nq,) at target i, near q, from which the next step is most like the
        step that led there.

        Near a singularity a candidate is tried on either side. `order` is the first-order step at
        q. None where no candidate leads smoothly to the next target.
        """
        size = max(float(np.linalg.norm(order.ahead)), SMALL)
        tried: list[tuple[float, Array]] = []
        for aside in ASIDE if i + 1 < len(self.rows) and order.way > STAYS else ():
            start = order.ahead + aside * size * order.weak
            found, moved = self.land(self.rows[i], q, start)
            if (
                found is not None
                and np.linalg.norm(moved) <= (1.0 + STRETCH) * size
                and self.smooth(moved, moved)
            ):
                there, further = self.land(self.rows[i + 1], found, moved)
                if there is not None and self.smooth(further, moved):
                    tried.append((float(np.linalg.norm(further - moved)), found))
        return min(tried, key=lambda x: x[0])[1] if tried else None

    def bridge(self, i: int, q: Array, before: Array, order: Order) -> Array | None:
        """The nearest configuration (nq,) at target i from which straight lines of the joints lead
        along the way.

        At a singularity joints may turn by much while the targets move by little: that is no jump,
        as long as the way between is held as well as short steps hold it elsewhere.
        """
        starts = (np.zeros(self.system.nv), order.ahead, before)
        tried = [
            self.land(self.rows[i], q, x)
            for x in starts
            if np.abs(x).max(initial=0.0) <= self.max_step
        ]
        found = [(np.abs(moved).max(initial=0.0), x, moved) for x, moved in tried if x is not None]
        integrate = self.system.structure.layout.integrate
        for most, x, moved in sorted(found, key=lambda f: float(f[0])):
            if most <= self.max_step and all(
                np.linalg.norm(
                    self.missing(self.at(i, part), integrate(q, part * moved * self.scale))[0]
                )
                <= BESIDE * order.way
                for part in (0.25, 0.5, 0.75)
            ):
                return x
        return None

    def away(self, i: int, q: Array, strength: float) -> Array:
        """The configuration (nq,) at target i, near q, to which a small self-motion away from
        limits leads.

        It is the motion that lowers the sum of 1 / distance over all limits the fastest, distances
        as parts of ranges; its size is the rate of that times `strength`, and `AVOID` at most.
        """
        system = self.system
        limits = self.system.lower
        at = system.structure.layout.vector_q
        v = system.structure.layout.vector_v
        wide = system.upper[v] - limits[v]
        bounded = np.isfinite(wide) & (wide > 0.0)
        at = at[bounded]
        v = v[bounded]
        wide = wide[bounded]
        low, high = (
            (np.maximum(x, 1e-3 * wide)) / wide
            for x in (q[at] - limits[v], system.upper[v] - q[at])
        )
        pull = np.zeros(system.nv)
        pull[v] = (1.0 / low**2 - 1.0 / high**2) / wide * self.scale[v]
        pull[v[np.isin(at, np.flatnonzero(apart(self.problem.packed, self.problem.pins)))]] = 0.0
        J = self.missing(self.rows[i], q)[1]
        _, s, Vt = svd(J, full_matrices=True)
        N = Vt[int(np.sum(s > 1e-6 * s.max(initial=0.0))) :]
        way = N.T @ (N @ pull)
        size = float(np.linalg.norm(way))
        if size < 1e-9:
            return q
        for step in (AVOID, 0.25 * AVOID):
            moved = way * (min(step, strength * size) / size)
            found, whole = self.land(self.rows[i], q, moved)
            if found is not None and np.linalg.norm(whole - moved) <= 0.5 * np.linalg.norm(moved):
                return found
        return q

    def land(self, problem: Demands, q: Array, ahead: Array) -> tuple[Array | None, Array]:
        """The configuration (nq,) found from q plus the scaled step `ahead` (nv,), or None; the
        scaled step there.
        """
        self.budget.check()
        start = self.system.structure.layout.integrate(q, ahead * self.scale)[None]
        found, info = replace(problem, starts=1).run(
            inside(self.system, start) if problem.limits else start
        )
        moved = self.system.structure.layout.difference(q, found[0]) / self.scale
        return found[0] if info[0, 0] == SOLVED else None, moved

    def follow(self, i: int, q: Array, before: Array, last: float) -> tuple[Array, float, float]:
        """Where one gets from q at target i - 1 towards target i, which part of the way that is,
        and its length.

        `before` (nv,) is the scaled step that led to q, and `last` the length of its way.
        """
        begin = q
        order = self.first_order(self.rows[i], q)
        part = 0.0
        size = 1.0
        if abs(order.way - last) > UNEVEN * last:
            before = before * (order.way / last if last else 0.0)
        near = order.ratio < WEAK
        found = None
        if near:
            found = (
                self.coast(self.rows[i], q, before) if before.any() else self.opening(i, q, order)
            )
        if found is None:
            found = self.step(self.rows[i], q, order)
        if found is None and not near:
            found = self.coast(self.rows[i], q, before)
        if found is not None:
            return found, 1.0, order.way
        while part < 1.0:
            found = self.step(self.at(i, part + size), q) if size < 1.0 else None
            if found is None:
                size *= 0.5
                if size < 0.5**DEPTH:
                    break
            else:
                q = found
                part = part + size
                size = min(2.0 * size, 1.0 - part)
        if part < 1.0 and (found := self.bridge(i, begin, before, order)) is not None:
            return found, 1.0, order.way
        return q, part, order.way


def _between(a: Array | None, b: Array | None, part: float) -> Array | None:
    """The pose at a part of the way between two: positions linear, rotations by the exponential
    map.
    """
    if a is None or b is None:
        return None
    R = a[:3, :3]
    S = b[:3, :3]
    turned = R @ spatial.exp_so3(part * spatial.log_so3(R.T @ S))
    return spatial.pose(turned, a[:3, 3] + part * (b[:3, 3] - a[:3, 3]))
