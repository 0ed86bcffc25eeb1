"""How a chain can move without leaving its target: curves of solutions followed step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from kempe.kinematics.common.gauss_newton import GaussNewtonEnd, gauss_newton, least_squares
from kempe.singular_values import svd
from kempe.solvers.analytic.answers.family_points import CORRECTIONS, DIRECTIONS, SINGULAR, Points
from kempe.solvers.common.tracing import NONE, Curve, Node, step, walk
from kempe.spatial import Array

REACH = 0.05
NEAR = 3e-3
"""The first step off a solution; another one, for those that are undetermined (radians, lengths of
the chain)."""

LONGEST = 0.12
"""The longest step along a curve (radians, lengths of the chain)."""

MOST = 6000
FAR = 50.0
"""Samples of a curve at most; how many lengths a slide is followed."""

CLOSE = 0.3
"""Second singular value at a sample below which a crossing is looked for."""

SLOW = 1e-4
"""Speed along a curve below which a joint does not tell its configurations apart."""

SAMPLES = 64
"""Samples of families with several freedoms."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples theta (m, n) of a family with `dimension` freedoms; tangents (m, n) along a curve, a
    `basis` at the first sample, the largest error [m, rad]. Where the `second` (m,) smallest
    singular value vanishes, curves may cross.
    """

    dimension: int
    theta: Array
    tangents: Array
    basis: Array
    closed: bool
    residual: float
    second: Array


@dataclass(frozen=True, eq=False)
class TolerantMotion(Points, Curve):
    """What a chain can do with its target reached to a tolerance [m, rad]."""

    # ---- from a solution

    def through(self, theta: Array, known: Callable[[Array], bool]) -> list[Samples]:
        """The families on which a solution (n,) lies, none where it is isolated; those through
        `known` are left out.
        """
        free = self.null_space(self.linear(theta)[1], least=0)
        found = list[Samples]()
        if not len(free):
            return []
        far = REACH
        near = self._neighbours(theta, free, REACH)
        if not near and self.spectrum(self.linear(theta)[1])[0] < self.undetermined:
            far = NEAR
            near = self._neighbours(theta, free, NEAR)
        for start in near:
            if known(start) or any(self._passes(curve, start) for curve in found):
                continue
            way = (start - theta) / np.linalg.norm(start - theta)
            wide = self.spanned(start, far)
            if len(wide) > 1:
                return [self._surface(theta, start, wide)]
            curve = self.follow(theta, way) if len(free) == 1 else self.follow(start, way)
            if curve is not None:
                found.append(curve)
        return found

    def _neighbours(self, theta: Array, free: Array, far: float) -> list[Array]:
        """Configurations (n,) on target at a small distance, far from each other."""
        if len(free) == 1:
            ways = np.array([free[0], -free[0]])
        else:
            c = np.random.default_rng(1).normal(size=(DIRECTIONS, len(free)))
            if len(free) == 2:
                angle = 2.0 * math.pi * (np.arange(DIRECTIONS) + 0.25) / DIRECTIONS
                c = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            ways = c @ free / np.linalg.norm(c, axis=1, keepdims=True)
        seen: list[Array] = []
        for x in self.at_distance(theta, theta + far * ways, far):
            if np.isfinite(x[0]) and not any(np.abs(x - y).max() < 0.05 * far for y in seen):
                seen.append(x)
        return seen

    def _passes(self, curve: Samples, theta: Array) -> bool:
        near = self.nearest_on(curve.theta, theta)
        return bool(np.abs(self.gap(near, theta)).max() < 1e-3 * REACH)

    # ---- curves

    def follow(self, theta: Array, way: Array) -> Samples | None:
        """The curve through a configuration (n,), which starts in a direction; None if it leaves
        the target.
        """
        theta, _, J = self.led(theta, way[None])
        first = self.node(theta, way, J)
        nodes, end = self._trace(first)
        other = end
        if end != "closed":
            back, other = self._trace(first.reversed())
            nodes = [*(a.reversed() for a in back[:0:-1]), *nodes]
        x = np.array([a.x for a in nodes])
        t = np.array([a.t for a in nodes])
        worst = max(map(self.missed, self.linear_each(x)[0]))
        if (
            "off" in (end, other)
            and worst > 1e-3 * self.tolerance
            and self.spectrum(J)[0] > self.undetermined
        ):
            return None
        return Samples(1, x, t, t[:1], end == "closed", worst, np.array([a.sigma for a in nodes]))

    def corrected(self, x: Array, across: Array) -> GaussNewtonEnd | None:
        """What is found on target near x (n,), in the plane across a direction, or None."""
        found = self.led(x, across[None])
        return found if self.on_target(found.r) else None

    def node(self, x: Array, toward: Array, J: Array) -> Node:
        """The node at a configuration (n,); its `sigma` is the second smallest singular value."""
        moves = self.aim.moves
        t = np.zeros(len(x))
        _, s, Vt = svd(J[:, moves])
        s = np.append(s, np.zeros(len(moves) - len(s)))
        free = Vt[len(moves) - max(1, int((s <= SINGULAR).sum())) :]
        t[moves] = (free @ toward[moves]) @ free
        size = math.sqrt(t @ t)
        whole = math.sqrt(toward @ toward)
        t = t / size if size > 0.1 * whole else toward / whole
        return Node(x, t, float(s[-2]) if len(s) > 1 else math.inf, 1, NONE, NONE)

    def crossings_of(self, curve: Samples) -> Iterator[Array]:
        """Points (n,) of a curve in which others may cross it: its Jacobian loses one more rank."""
        from scipy import optimize  # only here: most targets have no families

        before = np.roll(curve.second, 1)
        size = curve.second
        after = np.roll(curve.second, -1)
        steep = size <= np.maximum(before, after) - size  # a zero nearby leaves such a kink
        for k in np.flatnonzero((size <= before) & (size <= after) & (size < CLOSE) & steep):
            t = curve.tangents[k : k + 1]

            def at(s: float, x: Array = curve.theta[k], t: Array = t) -> tuple[Array, Array]:
                point, _, J = self.led(x + s * t[0], t)
                return point, J

            def least(s: float, at: Callable[[float], tuple[Array, Array]] = at) -> float:
                return self.spectrum(at(s)[1])[1]

            found = cast(Any, optimize).minimize_scalar(
                least, bounds=(-LONGEST, LONGEST), method="bounded", options={"xatol": 1e-8}
            )
            if found.fun < SINGULAR:
                yield at(found.x)[0]

    def _trace(self, first: Node) -> tuple[list[Node], str]:
        """Nodes one way, and its end: "closed", "far", or "off"."""
        nodes = [first]
        for b in walk(
            first, lambda a, h: None if (c := step(self, a, h)) is None else [c], LONGEST, REACH
        ):
            if len(nodes) > 3 and self._returns(nodes[-1], b, first):
                return nodes, "closed"
            nodes.append(b)
            if np.abs(b.x - first.x)[self.aim.slides].max(initial=0.0) > FAR:
                return nodes, "far"
            if len(nodes) == MOST:
                break
        return nodes, "off"

    def _returns(self, a: Node, b: Node, first: Node) -> bool:
        """Whether the step from a to b passes the first node."""
        rest = self.gap(first.x, a.x)
        h = float((b.x - a.x) @ a.t)
        along = float(rest @ a.t)
        if (
            not -0.01 * h < along <= 1.01 * h
            or a.t @ first.t < 0.8
            or np.linalg.norm(rest - along * a.t) > 0.3 * h
        ):
            return False
        there, _, _ = self.led(a.x + along * a.t, a.t[None])
        return bool(np.linalg.norm(self.gap(first.x, there)) < 0.02 * h)

    def parameter(self, curve: Samples) -> int | None:
        """The joint whose value picks one configuration of a curve; None where none does.

        Of several that do, the first that is not much slower than the others.
        """
        found: list[tuple[int, float]] = []
        for i in self.aim.moves.tolist():
            speed = curve.tangents[:, i]
            x = curve.theta[:, i]
            if np.any(speed > 0.0) and np.any(speed < 0.0):
                continue
            once = abs(x[-1] - x[0]) < 2.0 * math.pi + (0.0 if curve.closed else 1e-9)
            if self.aim.slides[i] or once:
                found.append((i, float(np.abs(speed).min())))
        fastest = max((speed for _, speed in found), default=0.0)
        return next((i for i, speed in found if speed > max(SLOW, 0.2 * fastest)), None)

    # ---- questions about a curve

    def nearest_on(self, samples: Array, theta: Array) -> Array:
        """The point (n,) of a curve, of which samples are known, nearest to theta (n,); in the turn
        of the samples.
        """
        k = int(np.argmin((self.gap(samples, theta) ** 2).sum(axis=1)))
        if len(samples) == 1:
            return samples[0]
        x = samples[k]
        way = self.gap(samples[k - 1], samples[k]) if k else self.gap(samples[0], samples[1])
        for _ in range(20):
            way = self.node(x, way, self.linear(x)[1]).t
            step = float(self.gap(theta, x) @ way)
            if abs(step) < 1e-12:
                break
            x, _, _ = self.led(x + max(-LONGEST, min(LONGEST, step)) * way, way[None])
        return x

    def crossings(self, samples: Array, closed: bool, i: int, value: float) -> Array:
        """Points (k, n) of a curve in which joint i has a value, angles modulo a turn."""
        x = samples
        if closed:
            x = np.vstack([x, x[-1] + self.gap(x[0], x[-1])])
        x = self._with_extremes(x, i)
        period = math.inf if self.aim.slides[i] else 2.0 * math.pi
        out: list[Array] = []
        for a, b in zip(x[:-1], x[1:], strict=True):
            if math.isinf(period):
                aimed = [value] if (a[i] - value) * (b[i] - value) <= 0.0 else []
            else:
                low, high = sorted((a[i], b[i]))
                k = range(
                    math.ceil((low - value) / period - 1e-12),
                    math.floor((high - value) / period + 1e-12) + 1,
                )
                aimed = [value + period * j for j in k]
            for v in aimed:
                share = (v - a[i]) / (b[i] - a[i]) if b[i] != a[i] else 0.0
                point = self._with_value(
                    a + min(1.0, max(0.0, share)) * (b - a), [i], np.array([v])
                )
                if point is not None and not any(
                    np.abs(self.gap(point, y)).max() < 1e-7 for y in out
                ):
                    out.append(point)
        return np.array(out).reshape(-1, samples.shape[1])

    def _with_extremes(self, x: Array, i: int) -> Array:
        """The samples with those added at which joint i turns round."""
        out = [x[0]]
        before = None
        for a, b in zip(x[:-1], x[1:], strict=True):
            way = (b - a) / max(float(np.linalg.norm(b - a)), 1e-300)
            ta = self.node(a, way, self.linear(a)[1]).t[i] if before is None else before
            tb = self.node(b, way, self.linear(b)[1]).t[i]
            before = tb
            if ta * tb < 0.0:
                low = 0.0
                high = 1.0
                point = a
                for _ in range(40):
                    middle = 0.5 * (low + high)
                    point, _, J = self.led(a + middle * (b - a), way[None])
                    low, high = (
                        (middle, high)
                        if self.node(point, way, J).t[i] * ta > 0.0
                        else (low, middle)
                    )
                out.append(point)
            out.append(b)
        return np.array(out)

    def _with_value(self, theta: Array, at: list[int], values: Array) -> Array | None:
        """A configuration on target near theta (n,) in which joints have values; None if none is
        found.
        """
        units = np.eye(len(theta))[at]

        def both(theta: Array) -> tuple[Array, Array]:
            e, J = self.linear(theta)
            return np.concatenate([-e, theta[at] - values]), np.vstack([J, units])

        theta, left, _ = gauss_newton(both, theta, 2 * CORRECTIONS, longest=0.5)
        e, off = np.split(left, [len(left) - len(at)])
        return theta if np.abs(off).max() < 1e-9 and self.on_target(e) else None

    # ---- more than one freedom

    def _surface(self, theta: Array, start: Array, wide: Array) -> Samples:
        """A family with several freedoms, those `wide` (d, n) next to a solution: samples of a
        random walk on it.
        """
        rng = np.random.default_rng(2)
        x = start
        out = [theta, start]
        worst = 0.0
        d = len(wide)
        for _ in range(SAMPLES):
            free = self.null_space(self.linear(x)[1], d)
            way = rng.normal(size=d) @ (free if len(free) == d else wide @ free.T @ free)
            far = 0.6 * rng.random()
            ahead = x + far * way / np.linalg.norm(way)
            new = (
                self.led(ahead, free)[0]
                if len(free) == d
                else self.at_distance(x, ahead[None], far)[0]
            )
            if np.isfinite(new[0]) and self.on_target(e := self.linear(new)[0]):
                x = new
                worst = max(worst, self.missed(e))
                out.append(x)
        free = self.null_space(self.linear(theta)[1], d)
        basis = free if len(free) == d else wide
        return Samples(
            d, np.array(out), np.zeros((0, len(theta))), basis, False, worst, np.zeros(0)
        )

    def projected(self, theta: Array, dimension: int) -> Array:
        """The configuration on target next to theta (n,), by shortest steps."""

        def step(_: Array, e: Array, J: Array) -> Array:
            free = self.null_space(J, dimension)
            return least_squares(J - (J @ free.T) @ free, e)

        x, e, _ = gauss_newton(self.linear, theta, 2 * CORRECTIONS, step=step, longest=0.5)
        return x if self.on_target(e) else np.full_like(x, math.inf)

    def joined(self, theta: Array, samples: Array, dimension: int) -> bool:
        """Whether a walk straight towards one of the samples reaches it without leaving the target."""
        goal = samples[int(np.argmin((self.gap(samples, theta) ** 2).sum(axis=1)))]
        x = theta
        for _ in range(200):
            rest = self.gap(goal, x)
            if (far := float(np.linalg.norm(rest))) < 1e-6:
                return True
            free = self.null_space(self.linear(x)[1], dimension)
            step = (free @ rest) @ free
            size = float(np.linalg.norm(step))
            if size < 1e-2 * far:
                return False
            x, e, _ = self.led(x + step * min(1.0, 0.2 / size), free)
            if not self.on_target(e):
                return False
        return False

    def held(self, samples: Array, at: list[int], values: Array) -> Array | None:
        """A configuration on target in which joints have values; None if none is found from the
        nearest samples.
        """
        turns = np.where(self.aim.slides[at], 0.0, 2.0 * math.pi)
        off = values - samples[:, at]
        off -= turns * np.round(off / (2.0 * math.pi))
        for k in np.argsort(np.abs(off).max(axis=1))[:8]:
            found = self._with_value(samples[k], at, samples[k, at] + off[k])
            if found is not None:
                return found
        return None
