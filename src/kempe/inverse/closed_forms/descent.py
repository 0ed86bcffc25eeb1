"""Descents of a serial chain towards a target: errors, Jacobians, closest configurations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe import spatial
from kempe.answers.targets import TASKS, turn_targets_to_axis
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.kernels.forward.table_layout import SLIDE
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.closed_forms.plan import ChainPlan
    from kempe.inverse.closed_forms.problem import ChainProblem

STARTS = 32
STEPS = 40
BEST = 4
"""Starts of a descent, steps of each, and how many of the best are followed to their minimum."""

SMALL_SINE = 0.1
"""Sine of a rotation angle below which the rotation vector comes from the skew part alone."""


@dataclass(frozen=True, eq=False)
class Aim:
    """The equations of one target for a chain, as errors [linear; angular] in the tip's frame.

    `rows` are those that the task asks for, `target` (4, 4) is scaled as `lines`, and `moves` are
    the joints that may move.
    """

    lines: Lines
    rows: np.ndarray
    target: Array
    moves: np.ndarray

    @classmethod
    def from_target(
        cls, problem: ChainProblem, plan: ChainPlan, target: Array, held: tuple[int, ...]
    ) -> Aim:
        """Make the equations of a target (4, 4) of a problem, with joints `held`."""
        lines = plan.lines
        X = turn_targets_to_axis(target, problem.axis).copy()
        X[:3, 3] = (X[:3, 3] - lines.origin) / lines.length
        moves = np.array([i for i in range(len(lines)) if i not in held], dtype=np.int64)
        return cls(lines, np.flatnonzero(TASKS[plan.task]), X, moves)

    @cached_property
    def slide_mask(self) -> np.ndarray:
        """Mask (n,) of the joints that slide."""
        return self.lines.kinds == SLIDE

    @cached_property
    def _motion_matrices(self) -> tuple[Array, Array]:
        """Matrices (n, 4, 16) that map 1, sine, cosine and value to motions; lines (n, 4, 2).

        A turn is 1 + sin K + (1 - cos) K^2 (Rodrigues, 1840).
        """
        lines = self.lines
        turns = ~self.slide_mask
        C = np.zeros((len(lines), 4, 4, 4))
        K = spatial.skew(lines.h) * turns[:, None, None]
        C[:, 1, :3, :3] = K
        C[:, 2, :3, :3] = -K @ K
        C[:, 0, :3, :3] = K @ K
        C[:, :3, :3, 3] = -np.einsum("nkij,nj->nki", C[:, :3, :3, :3], lines.o)
        C[:, 0] += np.eye(4)
        C[~turns, 3, :3, 3] = lines.h[~turns]
        axes = np.zeros((len(lines), 4, 2))
        axes[:, :3, 0] = lines.h
        axes[:, :3, 1] = lines.o
        axes[:, 3, 1] = 1.0
        return C.reshape(len(lines), 4, 16), axes

    def compute_line_placements(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Compute rotation (N, 3, 3) and position (N, 3) of the tip, and lines (N, n, 3) there."""
        (N, n) = theta.shape
        (parts, axes) = self._motion_matrices
        terms = np.ones((N, n, 1, 4))
        terms[..., 0, 1], terms[..., 0, 2], terms[..., 0, 3] = np.sin(theta), np.cos(theta), theta
        E = (terms @ parts).reshape(N, n, 4, 4)
        X = np.empty((N, n + 1, 4, 4))
        X[:, 0] = np.eye(4)
        if N == 1:  # plain products of matrices cost a third of stacked ones
            before = X[0, 0]
            steps = E[0]
            after = X[0]
            for i in range(n):
                before = before @ steps[i]
                after[i + 1] = before
        else:
            for i in range(n):
                X[:, i + 1] = X[:, i] @ E[:, i]
        T = X[:, n] @ self.lines.tip
        there = X[:, :n] @ axes
        return T[:, :3, :3], T[:, :3, 3], there[..., :3, 0], there[..., :3, 1]

    def compute_errors(self, R: Array, p: Array) -> Array:
        """Compute the errors (N, 6) at poses of the tip; rows that do not count are zero."""
        back = np.swapaxes(R, 1, 2)
        full = np.zeros((len(R), 6))
        full[:, :3] = (back @ (self.target[:3, 3] - p)[..., None])[..., 0]
        if self.rows[-1] >= 3:
            D = back @ self.target[:3, :3]
            full[:, 3:] = (
                _compute_pointing_vectors(D[:, :, 2])
                if len(self.rows) in (2, 5)
                else _compute_rotation_vectors(D)
            )
        out = np.zeros((len(R), 6))
        out[:, self.rows] = full[:, self.rows]
        return out

    def linearise_errors(self, theta: Array) -> tuple[Array, Array]:
        """Compute the errors (N, m) and their Jacobian (N, m, k) by moving joints, at theta (N, n)."""
        R, p, h, o = self.compute_line_placements(theta)
        h = h[:, self.moves]
        o = o[:, self.moves]
        slides = self.slide_mask[self.moves, None]
        v = np.where(slides, h, _compute_cross_product(h, p[:, None] - o))
        w = np.where(slides, 0.0, h)
        J = np.concatenate([np.swapaxes(v @ R, 1, 2), np.swapaxes(w @ R, 1, 2)], axis=1)
        return self.compute_errors(R, p)[:, self.rows], J[:, self.rows]

    def compute_energy(self, theta: Array) -> tuple[float, Array]:
        """Compute half the square of the error, and its gradient, at theta (n,)."""
        e, J = (x[0] for x in self.linearise_errors(theta[None]))
        return 0.5 * float(e @ e), -(e @ J)


def _compute_cross_product(a: Array, b: Array) -> Array:
    """Compute cross products of vectors (..., 3)."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def _compute_pointing_vectors(z: Array) -> Array:
    """Compute rotation vectors (N, 3) that turn the z axis to unit vectors z (N, 3)."""
    sine = np.hypot(z[:, 0], z[:, 1])
    angle = np.arctan2(sine, z[:, 2])
    none = sine < 1e-300
    f = angle / np.where(none, 1.0, sine)
    return np.stack([np.where(none, angle, -z[:, 1] * f), z[:, 0] * f, np.zeros(len(z))], axis=1)


def _compute_rotation_vectors(D: Array) -> Array:
    """Compute the rotation vectors (N, 3) of rotation matrices (N, 3, 3)."""
    v = 0.5 * np.stack(
        [D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1
    )
    sine = np.sqrt((v * v).sum(axis=1))
    # no half turns
    if sine.max(initial=0.0) < SMALL_SINE and np.trace(D, axis1=1, axis2=2).min(initial=3.0) > 1.0:
        return v * np.where(sine < 1e-8, 1.0, np.arcsin(sine) / np.maximum(sine, 1e-300))[:, None]
    return spatial.log_so3(D)


def compute_limits(lines: Lines) -> tuple[Array, Array]:
    """Compute lower and upper limits (n,) of the variables of the lines."""
    ends = np.sort(lines.limits * lines.multiplier + lines.offset, axis=0)
    return ends[0], ends[1]


def run_descent(aim: Aim, theta: Array, low: Array, high: Array, first: float = 1e-2) -> Array:
    """Run damped Gauss-Newton steps inside the limits from theta (N, n), and return the ends.

    Joints that press on a limit stay there.

    first: damping of the first step.
    """
    moves = aim.moves
    damping = np.full(len(theta), first)
    e, J = aim.linearise_errors(theta)
    for _ in range(STEPS):
        slope = np.einsum("Nmk,Nm->Nk", J, e)
        x = theta[:, moves]
        pressed = ((x <= low) & (slope < 0.0)) | ((x >= high) & (slope > 0.0))
        J = np.where(pressed[:, None], 0.0, J)
        A_ = np.swapaxes(J, 1, 2) @ J
        A_[:, range(len(moves)), range(len(moves))] += damping[:, None] + 1e-12
        step = np.linalg.solve(A_, np.where(pressed, 0.0, slope)[..., None])[..., 0]
        trial = theta.copy()
        trial[:, moves] = np.clip(x + np.clip(step, -1.0, 1.0), low, high)
        new, J_new = aim.linearise_errors(trial)
        better = (new * new).sum(axis=1) < (e * e).sum(axis=1)
        theta = np.where(better[:, None], trial, theta)
        e = np.where(better[:, None], new, e)
        J = np.where(better[:, None, None], J_new, J)
        damping = np.clip(np.where(better, 0.3 * damping, 5.0 * damping), 1e-12, 1e6)
    return theta


def find_closest(aim: Aim, first: Array) -> Array:
    """Find the variables (n,) inside the limits where the error is smallest."""
    from scipy import optimize  # only here: most targets are reached

    low, high = (x[aim.moves] for x in compute_limits(aim.lines))
    rng = np.random.default_rng(0)
    k = len(aim.moves)
    wide = np.where(aim.slide_mask[aim.moves], 2.0, math.pi)
    left = np.where(np.isfinite(low), low, -wide)
    right = np.where(np.isfinite(high), high, wide)
    theta = np.tile(first, (STARTS, 1))
    theta[1:, aim.moves] = rng.uniform(
        np.minimum(left, right), np.maximum(left, right), (STARTS - 1, k)
    )
    theta[:, aim.moves] = np.clip(theta[:, aim.moves], low, high)
    theta = run_descent(aim, theta, low, high)
    e, _ = aim.linearise_errors(theta)
    order = np.argsort((e * e).sum(axis=1))
    best = theta[order[0]]
    least = math.inf
    for start in theta[order[:BEST]]:

        def evaluate_energy(x: Array, start: Array = start) -> tuple[float, Array]:
            full = start.copy()
            full[aim.moves] = x
            return aim.compute_energy(full)

        options = {"maxiter": 500, "ftol": 1e-18, "gtol": 1e-13}
        bounds = list(zip(low, high, strict=True))
        found = cast(Any, optimize).minimize(
            evaluate_energy,
            start[aim.moves],
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options=options,
        )
        if found.fun < least:
            best = start.copy()
            least = float(found.fun)
            best[aim.moves] = found.x
    return best
