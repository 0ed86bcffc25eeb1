"""Least squares under bounds, as one step of velocities needs it: damped at singularities, or with a direction kept."""

from __future__ import annotations

import math

import numpy as np

from kempe.solvers.common.freedoms import null
from kempe.spatial import Array

NEAR = 0.05
"""Singular values below it are damped, those at zero fully."""
FLAT = 1e-13
"""Singular values below this fraction of the largest are zero: freedoms that are not seen."""
LEAST = 1e-5
"""Weight of small velocities against what is wished, so that the best ones are unique."""
SHRINK, LEAST_SCALED = 1e-4, 1e-8
"""Weights, against the direction of what is wished, of having it in full and of small velocities."""
HAD = 1e-9
"""Part of what is wished that may be missing where it counts as had in full."""
NO_PART = 1e-6
"""Part of what is wished up to which none of it is had: what the weights bend it by."""
INWARD = 1e-14
"""Gradients below this fraction of what is required release no bound: rounding."""
SLACK = 1e-13
"""By how much a row that no step moves may seem to be beyond its bound: rounding."""


def damped(
    A: Array, b: Array, low: Array, high: Array, damping: float, G: Array | None = None, near: float | None = NEAR
) -> Array:
    """The x (n,) with low <= G x <= high that makes |A x - b| least, damped and small.

    Directions whose singular values are below `near` are damped, by at most `damping` (Maciejewski and Klein, 1988).
    Without G the bounds are those of x; with it zero must be within them. Without `near` both are relative to the
    largest singular value.
    """
    x, hard, s, Vt = _unbounded(A, b, damping, near)
    n, k, seen = A.shape[1], len(s), s > FLAT * s[:1].max(initial=0.0)
    value = x if G is None else G @ x
    if (value >= low).all() and (value <= high).all():
        return x
    rows = np.full(n, LEAST)
    rows[:k][seen] = np.maximum(hard[seen], LEAST * (s[seen] < (near or NEAR * s[0])))
    kept = rows > 0.0
    first = x if G is None else np.zeros(n)
    return bounded(np.concatenate([A, rows[kept, None] * Vt[kept]]), np.concatenate([b, np.zeros(kept.sum())]), low,
                   high, first, G)  # fmt: skip


def wish(A: Array, b: Array, damping: float, near: float = NEAR) -> tuple[Array, Array]:
    """The x (n,) of `damped` without bounds, and rows (k, n) whose squares are its damping."""
    x, hard, _, Vt = _unbounded(A, b, damping, near)
    some = hard > 0.0
    return x, hard[some, None] * Vt[: len(hard)][some]


def _unbounded(A: Array, b: Array, damping: float, near: float | None) -> tuple[Array, Array, Array, Array]:
    """x (n,), the damping of each singular value, these, and the right singular vectors."""
    U, s, Vt = np.linalg.svd(A, full_matrices=True)
    most = float(s[0]) if len(s) else 0.0
    seen = s > FLAT * most
    if near is None:
        near, damping = NEAR * (most or 1.0), damping * (most or 1.0)
    hard = np.where(seen & (s < near), damping * np.sqrt(np.maximum(1.0 - (s / near) ** 2, 0.0)), 0.0)
    k = len(s)
    part = np.where(seen, s / np.where(seen, s * s + hard * hard, 1.0), 0.0)
    return Vt[:k].T @ (part * (U[:, :k].T @ b)), hard, s, Vt


def scaled(A: Array, b: Array, low: Array, high: Array, G: Array | None = None) -> Array:
    """The x (n,) with low <= G x <= high that gives the largest part of b, its direction kept, and is small."""
    size, (m, n) = math.sqrt(b @ b), A.shape
    inside = np.minimum(np.maximum(0.0, low), high) if G is None else np.zeros(n)
    if not size:
        return inside
    if G is None:
        y: Array = np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], dtype=float)
        if (y >= low).all() and (y <= high).all() and np.abs(A @ y - b).max() <= HAD * size:
            return y
    # the part of b is one more unknown, in [0, 1], wished to be 1 with little weight
    B = np.zeros((m + 1 + n, n + 1))
    B[:m, :n], B[:m, n], B[m, n] = A / size, -b / size, SHRINK
    B[range(m + 1, m + 1 + n), range(n)] = LEAST_SCALED / size
    wish = np.zeros(m + 1 + n)
    wish[m] = SHRINK
    x: Array = np.asarray(np.linalg.lstsq(B, wish, rcond=None)[0], dtype=float)
    value = x[:n] if G is None else G @ x[:n]
    if (value < low).any() or (value > high).any():
        if G is not None:
            G = np.pad(G, ((0, 1), (0, 1)))
            x = np.zeros((n + 1,))
            G[-1, -1] = 1.0
        x = bounded(B, wish, np.append(low, 0.0), np.append(high, 1.0), x, G)
    return x[:n] if x[n] > NO_PART or inside.any() else inside


def bounded(A: Array, b: Array, low: Array, high: Array, first: Array, G: Array | None = None) -> Array:
    """The x (n,) with low <= G x <= high that makes |A x - b| least: active set (Stark and Parker, 1995).

    Without G the bounds are those of x: `first` (n,) says which are tried first, those that it violates. With G, whose
    rows then need not be independent, `first` must be within them. A must have full column rank.
    """
    plain, eye = G is None, np.eye(A.shape[1])
    rows: Array = eye if G is None else G
    x = np.minimum(np.maximum(first, low), high) if plain else first.copy()
    held = (first <= low) | (first >= high) if plain else np.zeros(len(low), dtype=bool)
    for _ in range(10 * len(low) + 10):
        Z = eye[:, ~held] if plain else null(rows[held])
        if Z.shape[1]:
            step = Z @ np.linalg.lstsq(A @ Z, b - A @ x, rcond=None)[0]
            value, way = rows @ x, rows @ step
            slack = 0.0 if plain else SLACK * max(1.0, float(np.abs(way).max(initial=0.0)))
            over = ~held & (((way < 0.0) & (value + way < low - slack)) | ((way > 0.0) & (value + way > high + slack)))
            if over.any():
                ratio = np.where(way < 0.0, low - value, high - value)[over] / way[over]
                part = min(max(float(ratio.min()), 0.0), 1.0)
                block = np.flatnonzero(over)[ratio <= part] if plain else np.flatnonzero(over)[[np.argmin(ratio)]]
                x = x + part * step
                if plain:  # to the last bit
                    x = np.minimum(np.maximum(x, low), high)
                    x[block] = np.where(way[block] < 0.0, low[block], high[block])
                held[block] = True
                continue
            x = x + step
        slope = A.T @ (A @ x - b)
        if not held.any():
            break
        at_low = rows[held] @ x - low[held] <= high[held] - rows[held] @ x
        push = slope[held] if plain else np.linalg.lstsq(rows[held].T, slope, rcond=None)[0]
        pull = np.where(low[held] < high[held], np.where(at_low, -push, push), 0.0)
        worst = int(np.argmax(pull))
        if pull[worst] <= INWARD * max(1.0, float(np.abs(b).max(initial=0.0))):
            break
        held[np.flatnonzero(held)[worst]] = False
    return x
