"""Isolated solutions of special targets, from targets nearby that are not special, by Newton's
method in numpy.

A solution of a generic target a little aside is followed to the special one; where it is nearly
singular there, its twin across the fold is looked for as well. So solutions are known that an
answer has to have.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import numpy as np
from arms import Arm

ISOLATED = 1e-5
"""Smallest singular value of a solution that is judged: nearer to singular ones it may lie on a
curve, or merge."""

EXACT = 1e-12
"""Error of a solution, lengths in units of the chain's size."""

NUDGE = 1e-11 * np.random.default_rng(0).standard_normal((6, 6))
"""Added to Jacobians, of which some are singular: large enough that no pivot is zero to
rounding."""

PI = np.pi


def newton(model: oracle.Model, X, theta, steps: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """(theta (N, n), smallest singular value (N,) or 0 where not converged) by undamped steps to
    targets (N, 4, 4).
    """
    theta = np.array(theta, dtype=float)
    X = np.asarray(X, dtype=float)
    scale = np.where(model.kinds == oracle.SLIDE, model.size, 1.0)
    live = np.arange(len(theta))
    done = np.zeros(len(theta), dtype=bool)
    for k in range(steps):
        R, p, h, o = model._sweep(theta[live])
        J = model._columns(p, h, o)
        J[:, :3] /= model.size
        J = J * scale
        w = oracle.rotation_log(X[live, :3, :3] @ np.swapaxes(R, 1, 2))
        r = np.concatenate([(X[live, :3, 3] - p) / model.size, w], axis=1)
        size = np.abs(r).max(axis=1, initial=0.0)
        done[live] = size < EXACT
        go = (size >= 1e-15) & np.isfinite(size)
        if k == steps - 1 or not go.any():
            break
        live = live[go]
        J = J[go]
        r = r[go]
        J = J + NUDGE
        step = np.linalg.solve(J, r[..., None])[..., 0]
        longest = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, 0.5 / np.maximum(longest, 1e-300))[:, None]
        theta[live] += step * scale
        slow = done[live] & (longest < 1e-9)
        live = live[~slow]
        if not len(live):
            break
    weak = np.zeros(len(theta))
    if done.any():
        weak[done] = model.condition(theta[done])
    return theta, weak


def aside(model: oracle.Model, X, size: float, rng: np.random.Generator) -> np.ndarray:
    """Targets (N, 4, 4) that are `size` off in random directions."""
    d = rng.standard_normal((len(X), 6))
    d *= size / np.linalg.norm(d, axis=1, keepdims=True)
    out = np.array(X)
    out[:, :3, :3] = rotations(d[:, 3:]) @ out[:, :3, :3]
    out[:, :3, 3] += d[:, :3] * model.size
    return out


def rotations(w) -> np.ndarray:
    """Rotations (N, 3, 3) by vectors (N, 3), which are small."""
    angle = np.linalg.norm(w, axis=1)[:, None, None]
    x, y, z = (w / np.maximum(angle[:, 0], 1e-300)).T
    zero = np.zeros_like(x)
    K = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def solutions(arm: Arm, X, q, rng: np.random.Generator, sizes=(1e-3, 1e-5)):
    """(target (m,), theta (m, n), smallest singular value (m,)) of solutions of targets (N, 4, 4)
    that q (N, nq) gave.

    Not all of them, and some several times.
    """
    at = [np.arange(len(X))]
    theta = [arm.model.theta(q)]
    for size in sizes:
        near = arm.system.ik_all(aside(arm.model, X, size, rng), arm.frame)
        rows, k = np.nonzero(near.mask)
        at.append(rows)
        theta.append(arm.model.theta(near.q[rows, k]))
    where = np.concatenate(at)
    start = np.concatenate(theta)
    found, weak = newton(arm.model, X[where], start)
    folds = np.flatnonzero((weak > ISOLATED) & (weak < 0.03))
    if len(folds):
        scale = np.where(arm.model.kinds == oracle.SLIDE, arm.model.size, 1.0)
        J = arm.model.jacobian(found[folds])
        J[:, :3] /= arm.model.size
        null = np.linalg.svd(J * scale)[2][:, -1] * scale
        for t in (0.02, -0.02, 0.1, -0.1, 0.3, -0.3):
            more, its = newton(arm.model, X[where[folds]], found[folds] + t * null)
            where = np.append(where, where[folds])
            found = np.vstack([found, more])
            weak = np.append(weak, its)
    good = weak > ISOLATED
    return where[good], found[good], weak[good]


def missed(arm: Arm, answer, where, theta, weak) -> np.ndarray:
    """Which (m,) of the solutions are not among the answer's rows."""
    mine = arm.model.theta(np.where(answer.mask[..., None], answer.q, 0.0))
    scale = np.where(arm.model.kinds == oracle.SLIDE, arm.model.size, 1.0)
    off = np.abs(arm.model.wrapped(mine[where] - theta[:, None]) / scale).max(axis=-1)
    off[~answer.mask[where]] = np.inf
    return off.min(axis=1) > 1e-6 + 1e-12 / weak**2


# ---------------------------------------------------------------- structured arms and poses

LENGTHS = (0.0, 0.0, 0.3, 0.3, -0.2, 0.5)
TWISTS = (0.0, PI / 2, -PI / 2, PI / 2, -PI / 2, PI, PI / 3)
KINDS = ("RRRRRR", "RRRRRR", "RRRRRR", "PRRRRR", "RPRPRR", "RRPRRR", "RRRRPR", "PRRPRR")


def structured_arm(rng: np.random.Generator, number: int = 0) -> Arm:
    """An arm with right angles, equal lengths and zeros; one in three with errors of 1e-6 to 1e-3."""
    kinds = KINDS[rng.integers(len(KINDS))]
    error = 10.0 ** rng.uniform(-6, -3) if rng.random() < 1 / 3 else 0.0
    rows = []
    for kind in kinds:
        a = rng.choice(LENGTHS)
        d = rng.choice(LENGTHS)
        alpha = rng.choice(TWISTS)
        e = error * rng.standard_normal(4)
        rows.append(
            (a + e[0], alpha + e[1], d + e[2], e[3], "prismatic" if kind == "P" else "revolute")
        )
    return arms.table(f"structured{number}", rows, "structured", 16)


def structured_poses(arm: Arm, rng: np.random.Generator, count: int) -> np.ndarray:
    """Configurations (count, nq), most joints at multiples of 30 or 45 degrees, two or three
    anywhere.

    A quarter lies on a line: one joint anywhere, the others structured, but for the first and the
    last.
    """
    n = arm.system.nq
    step = rng.choice([PI / 6, PI / 4, PI / 2], size=(count, 1))
    q = np.where(rng.random((count, n)) < 0.9, step * rng.integers(-6, 7, (count, n)), 0.0)
    free = rng.random((count, n)).argsort(axis=1) < rng.integers(2, 4, (count, 1))
    line = rng.random(count) < 0.25
    free[line] = (
        np.eye(n, dtype=bool)[[0, n - 1]].any(axis=0)
        | np.eye(n, dtype=bool)[rng.integers(n, size=line.sum())]
    )
    q = np.where(
        free, rng.uniform(-PI, PI, (count, n)), arm.model.wrapped(q) if n == arm.model.n else q
    )
    slides = np.zeros(n, dtype=bool)
    slides[arm.model.index[arm.model.kinds == oracle.SLIDE]] = True
    return np.where(slides, 0.1 * q, q)
