"""Motions in which angles turn in fixed ratios, such as those of parallelograms: proven at points of the whole motion.

Along them the equations are trigonometric polynomials of a degree that the joints bound. One that vanishes at random
points all around vanishes, with probability one, everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kempe.analysis.equations import Equations
from kempe.spatial import Array

PARTS = 12
"""Ratios are multiples of one over this."""
NEARLY = 1e-6
"""How far a ratio that was found may be from it."""
POINTS = 48
"""Random points at which the equations must vanish."""
ZERO = 1e-12
"""Values of equations, in radians and typical lengths, that are rounding."""


def dimension(equations: Equations, q: Array, spans: Iterable[Array]) -> int:
    """Largest dimension of a family of closed configurations through q (nq,) with rates in some of `spans` (nv, k)."""
    e = equations
    angles = np.zeros(e.nv, dtype=bool)
    angles[e.system.layout.vector_v] = True
    angles &= e.turning & ~e.sliding
    best = 0
    for span in spans:
        k = span.shape[1]
        if k <= best or np.abs(span[~angles]).max(initial=0.0) > NEARLY:
            continue
        K = _ratios(span)
        if K is None:
            continue
        s = np.random.default_rng(0).uniform(-np.pi, np.pi, size=(POINTS, k)) * PARTS
        value = e.linearise(e.move(q, s @ K.T))[0]
        if np.abs(value).max(initial=0.0) < ZERO * (1.0 + np.abs(K).sum() * PARTS):
            best = k
    return best


def _ratios(span: Array) -> Array | None:
    """The same span by columns of ratios, each 1 in one row in which the others are 0; None if some are no ratios."""
    K = np.array(span)
    for j in range(K.shape[1]):
        left = np.abs(K[:, j:]).max(axis=1)
        i = int(np.argmax(left > 0.5 * left.max()))
        k = j + int(np.argmax(np.abs(K[i, j:])))
        if abs(K[i, k]) < NEARLY:
            return None
        K[:, [j, k]] = K[:, [k, j]]
        K[:, j] /= K[i, j]
        for other in range(K.shape[1]):
            if other != j:
                K[:, other] -= K[i, other] * K[:, j]
    near = np.round(K * PARTS) / PARTS
    return near if np.abs(K - near).max() < NEARLY else None
