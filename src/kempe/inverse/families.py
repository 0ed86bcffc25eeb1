"""Self-motions: curves and surfaces of configurations that all reach one target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.answers import wording
from kempe.arguments import explained_methods
from kempe.arrays import reals
from kempe.errors import InputError, UnknownNameError
from kempe.inverse.closed_forms.descent import Aim
from kempe.inverse.closed_forms.plan import kernel_of
from kempe.inverse.nearest import aim_of, held_coordinates
from kempe.kernels.closed_form import analytic_layout as A
from kempe.numerics.curves import NONE, Curve, Node, step, walk
from kempe.numerics.newton import GaussNewtonEnd, gauss_newton, gauss_newton_of_many, least_squares
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.words import InWords, counted, in_words, joined, verb

if TYPE_CHECKING:
    from kempe.inverse.all_answer import Solutions


# ---- points of a family

# Whether configurations are on a target, and in how many directions others are next to them.

SINGULAR = 1e-5
"""Singular values of the Jacobian below this (radians, lengths of the chain) are looked at as zero;
whether a motion remains is decided by moving."""

UNDETERMINED = 5e-9
"""Smallest singular value below which a solution is not determined: rounding of its target moves it
by 1e8 times as much. Then the part of the curve that is on target within the tolerance counts as a
family; the curve may be longer."""

CORRECTIONS = 12
FURTHEST = 1.0
POINTS_EXACT = 3e-14
"""Corrections of a step at most; one that is longer leads elsewhere, and is not taken; an error
that is rounding."""

SLACK = 1.01
"""How much more than the tolerance the error may be along a family."""

LONG = 1e3
"""Length of a tool, in lengths of the chain, from which errors are brought to the last axis."""

STRIDE = 0.3
SPANNED = 0.2
"""Where freedoms are counted: the step, in parts of the first one; singular values of the
directions found, in parts of the largest, that count."""

DIRECTIONS = 24
"""Directions tried where several may be free."""


@dataclass(frozen=True, eq=False)
class Points:
    """Configurations of a chain that reach a target to a tolerance [m, rad]."""

    aim: Aim
    tolerance: float

    def gap(self, a: Array, b: Array) -> Array:
        """Difference a - b (..., n), of angles the shortest."""
        d = a - b
        return np.where(self.aim.slides, d, d - 2.0 * math.pi * np.round(d / (2.0 * math.pi)))

    @cached_property
    def shift(self) -> Array:
        """Rows (m, m) that bring errors to the last axis, of tools much longer than the chain; else
        none (0, 0).

        There, a turn that is hardly an error of the tool would move the chain by a lot.
        """
        lines = self.aim.lines
        c = lines.tip[:3, :3].T @ (lines.o[-1] - lines.tip[:3, 3])
        if len(self.aim.rows) < 6 or self.aim.slides[-1] or np.linalg.norm(c) <= LONG:
            return np.zeros((0, 0))
        out = np.eye(6)
        out[:3, 3:] = -spatial.skew(c)
        return out

    def linear(self, theta: Array) -> tuple[Array, Array]:
        """Errors (m,) and Jacobian (m, n) at theta (n,), see `shift`; columns of joints that are
        held are zero.
        """
        e, J = self.linear_each(theta[None])
        return e[0], J[0]

    def linear_each(self, theta: Array) -> tuple[Array, Array]:
        """As `linear`, for each of several (N, n)."""
        e, columns = self.aim.at(theta)
        J = np.zeros((*e.shape, theta.shape[1]))
        J[..., self.aim.moves] = columns
        return (e @ self.shift.T, self.shift @ J) if len(self.shift) else (e, J)

    def missed(self, e: Array) -> float:
        """The larger of both errors, of position [m], also where it is brought to, and of
        orientation [rad].
        """
        place = self.aim.rows < 3
        far = float(np.linalg.norm(e[place]))
        if len(self.shift):
            far = max(far, float(np.linalg.norm(e[:3] - self.shift[:3, 3:] @ e[3:])))
        return max(far * self.aim.lines.length, float(np.linalg.norm(e[~place])))

    def null_space(self, J: Array, least: int = 1) -> Array:
        """Orthonormal directions (d, n), at least so many, in which the tip hardly moves, the
        freest last.
        """
        moves = self.aim.moves
        _, s, Vt = svd(J[:, moves])
        d = max(least, len(moves) - int((s > SINGULAR).sum()))
        out = np.zeros((d, J.shape[1]))
        out[:, moves] = Vt[len(moves) - d :]
        return out

    def led(self, theta: Array, free: Array) -> GaussNewtonEnd:
        """Variables (n,) moved across directions `free` (d, n) until the error is least; error and
        Jacobian there.
        """

        def step(theta: Array, e: Array, J: Array) -> Array:
            y = least_squares(J - (J @ free.T) @ free, e)
            return y if np.abs(y).max(initial=0.0) <= FURTHEST else np.full(len(y), math.inf)

        return gauss_newton(self.linear, theta, CORRECTIONS, step=step, met=POINTS_EXACT)

    def on_target(self, e: Array) -> bool:
        """Whether these errors are within the tolerance."""
        return self.missed(e) <= SLACK * self.tolerance

    @property
    def undetermined(self) -> float:
        """Singular values below this leave a solution undetermined; smaller for long chains, as the
        tolerance is.
        """
        return UNDETERMINED / max(1.0, self.aim.lines.length)

    def spectrum(self, J: Array) -> tuple[float, float]:
        """The smallest and the second smallest singular value of the joints that move."""
        k = len(self.aim.moves)
        s = svd(J[:, self.aim.moves], compute_uv=False)
        least, second = sorted([*s, *[0.0] * (k - len(s)), math.inf])[:2]
        return float(least), float(second)

    # ---- what is next to a configuration

    def spanned(self, theta: Array, far: float) -> Array:
        """Orthonormal directions (d, n) that configurations on target next to one (n,) span.

        They are the null space of the Jacobian, or a part of it where roots have merged: there, the
        tip hardly moves at first order, but it moves.
        """
        free = self.null_space(self.linear(theta)[1])
        if len(free) == 1:
            return free
        near = STRIDE * far
        ways = np.random.default_rng(3).normal(size=(DIRECTIONS, len(free))) @ free
        ways *= near / np.linalg.norm(ways, axis=1, keepdims=True)
        x = self.at_distance(theta, theta + ways, near)
        x = x[np.isfinite(x[:, 0])]
        if not len(x):
            return free[-1:]
        ways = (x - theta) / np.linalg.norm(x - theta, axis=1, keepdims=True)
        _, s, Vt = svd(ways)
        return Vt[: min(len(free), int((s > SPANNED * s[0]).sum()))]

    def at_distance(self, centre: Array, starts: Array, far: float) -> Array:
        """Configurations (N, n) on target so far from `centre` (n,), from starts (N, n); NaN where
        none is found.
        """

        def both(theta: Array, _: np.ndarray) -> tuple[Array, Array]:
            r = theta - centre
            size = np.linalg.norm(r, axis=1)
            e, J = self.linear_each(theta)
            e[~((size > 0.3 * far) & (size < 3.0 * far))] = np.nan
            rows = np.concatenate([J, (r / size[:, None])[:, None]], axis=1)
            return np.concatenate([-e, (size - far)[:, None]], axis=1), rows

        theta = gauss_newton_of_many(both, starts, 2 * CORRECTIONS)
        found = np.flatnonzero(np.isfinite(theta[:, 0]))
        off = [not self.on_target(e) for e in self.linear_each(theta[found])[0]]
        theta[found[off]] = np.nan
        return theta


# ---- curves of solutions, followed step by step

REACH = 0.05
NEAR = 3e-3
"""The first step off a solution; another one, for those that are undetermined (radians, lengths of
the chain)."""

LONGEST = 0.12
"""The longest step along a curve (radians, lengths of the chain)."""

MOST_STEPS = 6000
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
            if len(nodes) == MOST_STEPS:
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


# ---- the families of a target

ON = 1e-5
"""Distance (radians, lengths of the chain) below which a solution counts as one of a family."""

MOST = 64
ROOM = 48
"""Families of one target at most; rows in which their samples are looked for, where an answer has
no room for all."""

STRAIGHT = 1e-6
"""How far samples may be from a straight line in a family that is called linear; joints that move
less rest."""

MERGED = 1e-4
"""Joints that move less rest where roots have merged, which the tolerance leaves open to its
root."""

EXACT = 1e-12
"""Largest error of the samples of a family that is exact [m, rad]; beyond, it holds within the
tolerance only."""

CONDITION = 1e-6
PERTURBED = 0.1
"""A joint that rests is a condition of a family if moving it by PERTURBED makes this singular value
of the joints that move larger."""

AT_ZERO = 1e-7
"""Angle [rad] below which a joint that rests is at zero: merged roots are known to the root of
rounding."""


@explained_methods
@dataclass(frozen=True, eq=False)
class Family(InWords):
    """A connected set of infinitely many configurations that reach a target; limits are ignored.

    `dimension` is the number of its freedoms. `q` (m, nq) are samples: along a curve in their
    order, angles continuous, and if it is `closed` the first one follows the last; of a family with
    more freedoms some, in any order. `basis` (dimension, nq) are unit vectors along it at the first
    sample. `joints` are those that move; `parameter` is a joint whose value (modulo a turn) picks
    one configuration of a curve, None where there is none. `residual` is the largest error of the
    samples [m, rad].
    """

    dimension: int
    q: Array
    closed: bool
    basis: Array
    joints: tuple[str, ...]
    parameter: str | None
    residual: float
    _motion: TolerantMotion = field(repr=False)
    _theta: Array = field(repr=False)
    _base: Array = field(repr=False)

    @property
    def tangent(self) -> Array:
        """The unit vector (nq,) along a curve at its first sample."""
        return self.basis[0]

    def __len__(self) -> int:
        return len(self.q)

    def at(self, **values: ArrayLike) -> Array:
        """Configurations of the family in which joints have given values: (nq,) where there is one,
        (k, nq) of several.

        As many joints are named as the family has freedoms; of more freedoms than one, one such
        configuration is given. An array (m,) of values of the `parameter`, or another joint with
        one configuration for each, gives (m, nq). Errors: `InputError` where there is none, or for
        a wrong number of joints; `UnknownNameError`.
        """
        names = self._motion.aim.lines.names
        if len(values) != self.dimension:
            given = f"{counted(len(values), 'joint')} {verb(len(values), 'is', 'are')} given"
            raise InputError(f"{given}; the family has {in_words(self.dimension, 'freedom')}")
        for name in values:
            if name not in names:
                raise UnknownNameError("joint", name, names, "the chain")
        values = {name: reals(v, f"joint {name!r}") for name, v in values.items()}
        if not all(np.isfinite(v).all() for v in values.values()):
            raise InputError("values of joints must be finite")
        if self.dimension > 1:
            return self._full(self._hold({n: float(np.asarray(v)) for n, v in values.items()}))
        ((name, value),) = values.items()
        wanted = reals(value, f"joint {name!r}")
        if wanted.ndim == 0:
            found = self._crossings(name, float(wanted))
            return found[0] if len(found) == 1 else found
        each = [self._crossings(name, float(x)) for x in wanted]
        if any(len(found) > 1 for found in each):
            raise InputError(
                f"{name!r} does not tell the configurations of the family apart; give one value"
            )
        return np.concatenate([np.zeros((0, self.q.shape[1])), *each])

    def distance(self, q: ArrayLike) -> Any:
        """How far configurations (..., nq) are from the family: the largest difference of a joint
        [rad, m].

        Angles count modulo turns. Of a family with more freedoms than one, the distance to the next
        configuration that reaches the target.
        """
        q = reals(q, "q")
        lines = self._motion.aim.lines
        theta = lines.theta(q[..., lines.q_index])
        flat = np.array([self._apart(x) for x in theta.reshape(-1, len(lines))])
        return float(flat[0]) if q.ndim == 1 else flat.reshape(q.shape[:-1])

    def describe(self) -> str:
        """What moves, and how: "q4 + q6 = 1.234 while q5 = 0: one freedom"."""
        return f"{self._in_words()}: {in_words(self.dimension, 'freedom')}"

    def __str__(self) -> str:
        return self.describe()

    def _in_words(self) -> str:
        """What moves, and how."""
        text = self._moving()
        return text if self.residual <= EXACT else f"{text} (on target within {self.residual:.1g})"

    def _moving(self) -> str:
        names = list(self.joints)
        if self.dimension > 1:
            return f"{joined(names)} can move"
        if self.equations is not None:
            return wording.linear_motion(names, self.equations, self._conditions())
        lines = self._motion.aim.lines
        first = self.parameter or names[0]
        x = self.q[:, lines.q_index[lines.names.index(first)]]
        turns = self.parameter is not None and self.closed
        return wording.curved_motion(names, first, turns, self.closed, (x.min(), x.max()))

    def _conditions(self) -> list[tuple[str, float]]:
        """Joints at rest that must be where they are, with their values."""
        motion = self._motion
        lines = motion.aim.lines
        theta = self._theta[0]
        names = lines.names
        at = [names.index(n) for n in self.joints]
        out: list[tuple[str, float]] = []
        for i in motion.aim.moves.tolist():
            if i in at:
                continue
            other = theta.copy()
            other[i] += PERTURBED
            J = motion.linear(other)[1][:, at]
            if J.shape[0] >= len(at) and svd(J, compute_uv=False)[-1] > CONDITION:
                x = float(self.q[0, lines.q_index[i]])
                zero = abs(x) < AT_ZERO and not motion.aim.slides[i]
                out.append((names[int(i)], 0.0 if zero else x))
        return out

    @cached_property
    def equations(self) -> list[dict[str, float]] | None:
        """Linear equations of a curve that is straight: coefficients by joint, "" for the right
        side; None if it bends.

        Each has two joints, the first of which is the same in all of them.
        """
        lines = self._motion.aim.lines
        if self.dimension > 1 or not self.joints:
            return None
        at = [lines.names.index(n) for n in self.joints]
        x = self._theta[:, at] - self._theta[0, at]
        way = x[np.argmax(np.abs(x).sum(axis=1))]
        way = way / np.linalg.norm(way)
        if np.abs(x - np.outer(x @ way, way)).max() > STRAIGHT:
            return None
        first = at[0]
        out: list[dict[str, float]] = []
        slope = way / lines.multiplier[at]
        for k in range(1, len(at)):
            a = -slope[k]
            b = slope[0]
            size = min(abs(a), abs(b)) * math.copysign(1.0, a)
            a, b = (round(float(c / size), 9) + 0.0 for c in (a, b))
            q = self.q[0, lines.q_index]
            out.append(
                {self.joints[0]: a, self.joints[k]: b, "": float(a * q[first] + b * q[at[k]])}
            )
        return out

    # ---- inside

    def _full(self, theta: Array) -> Array:
        """Configurations (..., nq) of variables (..., n)."""
        out = np.broadcast_to(self._base, (*theta.shape[:-1], len(self._base))).copy()
        out[..., self._motion.aim.lines.q_index] = in_turn(self._motion, theta, self._base)
        return out

    def _crossings(self, name: str, value: float) -> Array:
        """Configurations (k, nq) of a curve in which a joint has a value. Errors: `InputError`."""
        lines = self._motion.aim.lines
        i = lines.names.index(name)
        theta = self._motion.crossings(
            self._theta, self.closed, i, value * lines.multiplier[i] + lines.offset[i]
        )
        if not len(theta):
            x = (self._theta[:, i] - lines.offset[i]) / lines.multiplier[i]
            raise InputError(
                f"the family has no configuration with {name} = {value:.6g}; it goes from "
                f"{x.min():.6g} to {x.max():.6g}"
            )
        q = self._full(theta)
        q[:, lines.q_index[i]] = value
        return q

    def _hold(self, values: dict[str, float]) -> Array:
        """Variables (n,) of a configuration in which joints have values. Errors: `InputError`."""
        lines = self._motion.aim.lines
        at = [lines.names.index(n) for n in values]
        wanted = np.array(list(values.values())) * lines.multiplier[at] + lines.offset[at]
        theta = self._motion.held(self._theta, at, wanted)
        if theta is None:
            raise InputError(f"no configuration of the family was found with {values}")
        return theta

    def _apart(self, theta: Array) -> float:
        """The largest difference of a joint between variables (n,) and the family, in radians and
        metres of q.
        """
        motion = self._motion
        if not np.isfinite(theta).all():
            return math.nan
        if self.dimension == 1:
            nearest = motion.nearest_on(self._theta, theta)
        else:
            nearest = motion.projected(theta, self.dimension)
        apart = np.abs(motion.gap(nearest, theta) / motion.aim.lines.multiplier)
        away = (
            np.abs(motion.gap(self._theta, theta) / motion.aim.lines.multiplier).max(axis=1).min()
        )
        return float(min(apart.max(), away))


def families_of(solutions: Solutions, index: int) -> tuple[list[Family], np.ndarray]:
    """The families of target number `index`, and for each row (K,) of its answer the number of its
    family, or -1.

    A row belongs to a family if the Jacobian of the task is singular there and the chain can move
    away from it without leaving the target: exactly, or within the tolerance, all the way round or,
    where rounding leaves the solution itself undetermined, for a part of it. Joints that were
    locked only because the chain has more than it needs may move. The Jacobian's null space says
    where to start; then each curve is followed (predictor and corrector: Allgower and Georg, 1990).
    """
    plan = solutions.plan
    numbers = solutions._rows[index]
    used = solutions._used[index]
    row_family = np.full(len(numbers), -1, dtype=np.int64)
    if not used.any():
        return [], row_family
    aim = aim_of(solutions, index, spare=True)
    rows = np.flatnonzero(used)
    theta = plan.lines.theta(numbers[rows, : len(plan.lines)])
    motion = TolerantMotion(aim, solutions.question.tolerance)
    J = aim.at(theta)[1]
    if J.shape[2] == 0:
        return [], row_family
    J = motion.shift @ J if len(motion.shift) else J
    if J.shape[1] >= J.shape[2]:
        weak = svd(J, compute_uv=False)[:, -1] < SINGULAR
        rows = rows[weak]
        theta = theta[weak]
    base = solutions._base[index if len(solutions._base) > 1 else 0]
    families: list[Family] = []
    for row, x in zip(rows, theta, strict=True):
        number = _known(families, motion, x)
        if number < 0:
            first = len(families)
            _collect(families, motion, x, base)
            number = _known(families[first:], motion, x)
            number += first if number >= 0 else 0
        row_family[row] = number
    for x in _left_out(solutions, index, aim):
        if _known(families, motion, x) < 0:
            _collect(families, motion, x, base)
    return families, row_family


def _left_out(solutions: Solutions, index: int, aim: Aim) -> Array:
    """Variables (k, n) of samples of families for which the answer had no room, others among them."""
    plan = solutions.plan
    n = len(solutions.plan.lines)
    sampled = solutions._used[index] & (solutions._code[index] < A.MULTIPLICITY_UNIT)
    if plan.method == "search" or not (sampled.any() and solutions._used[index].all()):
        return np.zeros((0, n))
    target = aim.target[None].copy()
    near = solutions._base[index if len(solutions._base) > 1 else 0]
    target[0, :3, 3] = target[0, :3, 3] * plan.lines.length + plan.lines.origin
    out = np.empty((1, ROOM, n + A.INFO))
    counts = np.zeros((1, 2), dtype=np.int64)
    tolerance = solutions.question.tolerance
    locked = held_coordinates(solutions, index)[None]
    kernel_of(plan)(
        plan.ints,
        plan.floats,
        target,
        np.ascontiguousarray(near[plan.lines.q_index])[None],
        locked,
        tolerance,
        tolerance,
        0,
        np.arange(1),
        out,
        counts,
    )
    code = out[0, :, n + A.CODE]
    return plan.lines.theta(out[0, (code >= 0.0) & (code < A.MULTIPLICITY_UNIT), :n])


def _collect(families: list[Family], motion: TolerantMotion, theta: Array, base: Array) -> None:
    """Add the families on which variables (n,) lie, and those that cross them."""

    def known(x: Array) -> bool:
        return any(f.dimension == 1 and _on(f, motion, x) for f in families)

    starts = [theta]
    while starts and len(families) < MOST:
        for curve in motion.through(starts.pop(), known):
            if any(
                f.dimension == curve.dimension and _on(f, motion, curve.theta[0]) for f in families
            ):
                continue
            families.append(_family(motion, curve, base))
            starts += motion.crossings_of(curve) if curve.dimension == 1 else []


def in_turn(motion: TolerantMotion, theta: Array, base: Array) -> Array:
    """Coordinates (..., n) of variables, of each angle the turn that is inside the limits and near
    `base` (nq,).
    """
    lines = motion.aim.lines
    q = (theta - lines.offset) / lines.multiplier
    near = base[lines.q_index]
    (low, high) = lines.limits
    turn = np.where(motion.aim.slides, 0.0, 2.0 * math.pi / np.abs(lines.multiplier))
    unit = np.where(turn > 0.0, turn, 1.0)
    x = q + turn * np.round((near - q) / unit)
    y = x - turn * np.ceil(np.maximum(x - high, 0.0) / unit)
    y = y + turn * np.ceil(np.maximum(low - y, 0.0) / unit)
    return np.where((y >= low) & (y <= high), y, x)


def _known(families: list[Family], motion: TolerantMotion, theta: Array) -> int:
    """The number of the family on which variables (n,) lie, or -1."""
    return next((i for i, f in enumerate(families) if _on(f, motion, theta)), -1)


def _on(family: Family, motion: TolerantMotion, theta: Array) -> bool:
    if family.dimension > 1:
        return motion.joined(theta, family._theta, family.dimension)
    if np.abs(motion.gap(family._theta, theta)).max(axis=1).min() > 1.0:
        return False
    nearest = motion.nearest_on(family._theta, theta)
    return bool(np.abs(motion.gap(nearest, theta)).max() < ON)


def _family(motion: TolerantMotion, curve: Any, base: Array) -> Family:
    """A family with names and units."""
    lines = motion.aim.lines
    theta = curve.theta
    first = lines.theta(in_turn(motion, theta[0], base))
    turns = 2.0 * math.pi * ((first - theta[0]) / (2.0 * math.pi)).round()
    theta = theta + np.where(motion.aim.slides, 0.0, turns)
    q = np.tile(base, (len(theta), 1))
    q[:, lines.q_index] = (theta - lines.offset) / lines.multiplier
    basis = np.zeros((curve.dimension, len(base)))
    basis[:, lines.q_index] = curve.basis / lines.multiplier
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    merged = len(motion.null_space(motion.linear(theta[0])[1], 0)) > curve.dimension
    moved = np.ptp(theta, axis=0) > (MERGED if merged else STRAIGHT)
    joints = tuple(n for n, m in zip(lines.names, moved, strict=True) if m)
    parameter = motion.parameter(curve) if curve.dimension == 1 else None
    residual = float(curve.residual)
    return Family(
        curve.dimension,
        q,
        curve.closed,
        basis,
        joints,
        None if parameter is None else lines.names[parameter],
        residual,
        motion,
        theta,
        base,
    )
