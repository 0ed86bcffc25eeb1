"""Least squares under bounds for one step of velocities.

Solutions are damped at singularities, or keep a direction.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from kempe.kernels.servo.step_constants import (
    AWAY,
    BENT,
    INWARD,
    LEAST,
    NEAR,
    NO_PART,
    NOISE,
    NULL_SPEED,
    SLACK,
    WALL,
)
from kempe.numerics.rank import Level, Spectrum, compute_svd
from kempe.spatial import Array

Bend = Callable[[Array], Array]
"""Derivatives (k, m, n) of equations A (m, n) along directions (k, n)."""


def minimize_damped_residual(
    A: Array,
    b: Array,
    low: Array,
    high: Array,
    damping: float,
    G: Array,
    bend: Bend | None = None,
    shift: float = LEAST,
) -> Array:
    """Find the damped x (n,) with low <= G x <= high that minimises |A x - b|.

    Directions whose singular values are below `NEAR` times the largest are damped, by at most
    `damping` times that (Maciejewski and Klein, 1988). Where this x is outside the bounds, the
    nearest one within them is taken, in the metric of the damped equations and of x itself with the
    weight `shift`: with `SHIFT`, x changes slowly where others take over. A singular configuration
    that leads nowhere to first order is left where `bend` gives a way.
    """
    x, hard, s, Vt = _solve_unbounded_wish(A, b, damping)
    n = A.shape[1]
    k = len(s)
    most = float(s[:1].max(initial=0.0)) or 1.0
    if bend is not None and (way := _find_bending_direction(A, b, s, Vt, bend)) is not None:
        force, lead = way
        slow = damping * most
        fastest = compute_feasible_fraction(G @ lead / NOISE, low, high) / NOISE
        x = x + (min(force / (2.0 * slow), fastest) if slow else fastest) * lead
    value = G @ x
    if (value >= low).all() and (value <= high).all():
        return x
    kept = hard > 0.0
    rows = np.concatenate([A, hard[kept, None] * Vt[:k][kept], shift * NEAR * most * np.eye(n)])
    return minimize_bounded_residual(rows, rows @ x, low, high, G)


def _find_bending_direction(
    A: Array, b: Array, s: Array, Vt: Array, bend: Bend
) -> tuple[float, Array] | None:
    """Find the direction (n,) that reaches to second order what A cannot reach of b.

    Its size is the part of b that is missing.

    The direction is that of the largest curvature towards b among those that move nothing to first
    order.
    """
    k = len(s)
    size = math.sqrt(b @ b)
    dead = Vt[int((s > Level.GENERIC * s[:1].max(initial=0.0)).sum()) :]
    if not size or not len(dead) or len(dead) == len(Vt) - k:
        return None
    moved = Vt[: len(Vt) - len(dead)]
    part = b - A @ (moved.T @ ((moved @ (A.T @ b)) / np.square(s[: len(moved)])))
    force = math.sqrt(part @ part)
    if force <= BENT * size:
        return None
    values, W = np.linalg.eigh(np.einsum("a,iaj,kj->ik", part / force, bend(dead), dead))
    return (force, dead.T @ W[:, -1]) if values[-1] > AWAY else None


def _solve_unbounded_wish(A: Array, b: Array, damping: float) -> tuple[Array, Array, Array, Array]:
    """Minimise |A x - b| damped and without bounds.

    Returns x (n,), the damping (k,) of the singular values, these (k,), and the right singular
    vectors (n, n).
    """
    U, s, Vt = compute_svd(A)
    most = float(s[0]) if len(s) else 0.0
    seen = s > Level.ROUNDING * most
    near = NEAR * (most or 1.0)
    hard = np.where(
        seen & (s < near),
        damping * (most or 1.0) * np.sqrt(np.maximum(1.0 - (s / near) ** 2, 0.0)),
        0.0,
    )
    k = len(s)
    part = np.where(seen, s / np.where(seen, s * s + hard * hard, 1.0), 0.0)
    return Vt[:k].T @ (part * (U[:, :k].T @ b)), hard, s, Vt


def scale_solution_to_bounds(
    A: Array,
    b: Array,
    low: Array,
    high: Array,
    dt: float,
    bend: Bend,
    G: Array,
) -> Array:
    """Find a small x (n,) with low <= G x <= high that keeps the direction of b.

    It gives a large part of b.

    The part is the largest one, but for a little that self-motions cost. Towards a singular
    configuration it is so small that no singular value, of those that the direction needs, falls by
    more than `WALL` in one cycle: the motion comes to rest there. From a singular configuration the
    motion leaves along a curvature towards b. There a direction is kept to `BENT`. `bend` gives the
    derivatives (k, m, n) of A along directions (k, n).
    """
    n = A.shape[1]
    size = math.sqrt(b @ b)
    still = np.zeros(n)
    if not size or not n:
        return still
    U, s, Vt = compute_svd(A)
    k = len(s)
    most = float(s[0])
    near = NEAR * (most or 1.0)
    along = U[:, :k].T @ b
    weak = s < near
    left = np.abs(along) - np.where(
        weak, BENT * size * (1.0 - np.square(np.minimum(s / near, 1.0))), 0.0
    )
    along = np.sign(along) * np.maximum(left, 0.0)
    blind = U[:, k:].T @ b
    if math.sqrt(blind @ blind) > BENT * size:
        return still
    dead = s <= Level.GENERIC * most
    y = Vt[:k].T @ np.where(dead, 0.0, along / np.where(dead, 1.0, s))
    if (along[dead] != 0.0).any():
        if (way := _find_bending_direction(A, b, s, Vt, bend)) is None:
            return still
        x = way[1] / NOISE
        return compute_feasible_fraction(G @ x, low, high) * x
    part = compute_feasible_fraction(G @ y, low, high)
    x = part * y
    spare = Vt[int((~dead).sum()) :]
    if part < 1.0 and len(spare):
        x = _add_relieving_motion(y, spare, low, high, G)
    weak = np.flatnonzero(weak & (along != 0.0))
    if len(weak) and x.any():
        falls = np.einsum("ai,aj,ij->i", U[:, weak], bend(x[None])[0], Vt[weak]) * dt
        x = x * float(
            np.min(
                np.where(falls < -WALL * s[weak], WALL * s[weak] / -np.minimum(falls, -1e-300), 1.0)
            )
        )
    return x if float(b @ (A @ x)) > NO_PART * size * size else still


def compute_feasible_fraction(x: Array, low: Array, high: Array) -> float:
    """Compute the largest fraction of x (n,), at most 1, that is within bounds.

    Rounding counts as zero.
    """
    big = np.abs(x) > NOISE * np.abs(x).max(initial=0.0)
    room = np.where(x > 0.0, high, low)[big] / x[big]
    return min(1.0, max(0.0, float(room.min(initial=1.0))))


def _add_relieving_motion(y: Array, spare: Array, low: Array, high: Array, G: Array) -> Array:
    """Add a self-motion, of rows `spare` (k, n), so that more of y (n,) is within bounds."""
    value = np.abs(G @ y)
    width = np.where(np.isfinite(high - low), high - low, 0.0)
    speed = min(float(value.max()), 0.5 * float(width.max(initial=0.0))) or 1.0
    B = np.diag(np.append(1.0, np.full(len(spare), NULL_SPEED / speed)))
    rows = np.column_stack([G @ y, G @ spare.T])
    x = minimize_bounded_residual(
        B, np.eye(len(B))[0], np.minimum(low, 0.0), np.maximum(high, 0.0), rows
    )
    return x[0] * y + spare.T @ x[1:]


def minimize_quadratic_in_box(
    H: Array, push: Array, low: Array, high: Array
) -> tuple[Array, np.ndarray]:
    """Minimise z H z / 2 - push z over z (n,) in a box, for a positive H.

    Also returns which entries are at no bound.
    """
    z: Array = np.asarray(np.linalg.solve(H, push), dtype=float)
    free = (low < z) & (z < high)
    if free.all():
        return z, free
    z = np.minimum(np.maximum(z, low), high)
    for _ in range(10 * len(z)):
        own = free.nonzero()[0]
        step = np.zeros(len(z))
        step[own] = np.linalg.solve(H[own[:, None], own], (push - H @ z)[own])
        ahead = z + step
        over = free & ((ahead < low) | (ahead > high))
        if over.any():
            room = np.where(step < 0.0, low - z, high - z)[over] / step[over]
            which = over.nonzero()[0][int(np.argmin(room))]
            z = np.minimum(np.maximum(z + float(room.min()) * step, low), high)
            z[which] = low[which] if step[which] < 0.0 else high[which]
            free[which] = False
            continue
        z = ahead
        slope = push - H @ z
        pull = np.where(free | (low >= high), 0.0, np.where(z <= low, slope, -slope))
        worst = int(np.argmax(pull))
        if pull[worst] <= INWARD * float(np.abs(push).max()):
            break
        free[worst] = True
    return z, free


def minimize_bounded_residual(A: Array, b: Array, low: Array, high: Array, G: Array) -> Array:
    """Minimise |A x - b| over x (n,) with low <= G x <= high, by an active set.

    Source: Stark and Parker, 1995.

    Zero must be within the bounds, and A must have full column rank; rows of G may depend on each
    other.
    """
    x = np.zeros(A.shape[1])
    held = np.zeros(len(low), dtype=bool)
    for _ in range(10 * len(low) + 10):
        Z = Spectrum(G[held], 1.0).compute_null_space(Level.CLOSED)
        if Z.shape[1]:
            step = Z @ np.linalg.lstsq(A @ Z, b - A @ x, rcond=Level.ROUNDING)[0]
            value = G @ x
            way = G @ step
            slack = SLACK * max(1.0, float(np.abs(way).max(initial=0.0)))
            below = (way < 0.0) & (value + way < low - slack)
            over = ~held & (below | ((way > 0.0) & (value + way > high + slack)))
            if over.any():
                ratio = np.where(way < 0.0, low - value, high - value)[over] / way[over]
                x = x + min(max(float(ratio.min()), 0.0), 1.0) * step
                held[np.flatnonzero(over)[np.argmin(ratio)]] = True
                continue
            x = x + step
        if not held.any():
            break
        at_low = G[held] @ x - low[held] <= high[held] - G[held] @ x
        push = np.linalg.lstsq(G[held].T, A.T @ (A @ x - b), rcond=Level.ROUNDING)[0]
        pull = np.where(low[held] < high[held], np.where(at_low, -push, push), 0.0)
        worst = int(np.argmax(pull))
        if pull[worst] <= INWARD * max(1.0, float(np.abs(b).max(initial=0.0))):
            break
        held[np.flatnonzero(held)[worst]] = False
    return x
