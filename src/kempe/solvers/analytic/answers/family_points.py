"""Whether configurations are on a target, and in how many directions others are next to them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kempe import spatial
from kempe.kinematics.common.gauss_newton import (
    GaussNewtonEnd,
    gauss_newton,
    gauss_newton_of_many,
    least_squares,
)
from kempe.singular_values import svd
from kempe.solvers.analytic.answers.nearest import Aim
from kempe.spatial import Array

SINGULAR = 1e-5
"""Singular values of the Jacobian below this (radians, lengths of the chain) are looked at as zero;
whether a motion remains is decided by moving."""

UNDETERMINED = 5e-9
"""Smallest singular value below which a solution is not determined: rounding of its target moves it
by 1e8 times as much. Then the part of the curve that is on target within the tolerance counts as a
family; the curve may be longer."""

CORRECTIONS = 12
FURTHEST = 1.0
EXACT = 3e-14
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

        return gauss_newton(self.linear, theta, CORRECTIONS, step=step, met=EXACT)

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
