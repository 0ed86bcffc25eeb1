"""Motions that are known in closed form, proven at points of the whole motion.

Angles turn in fixed ratios, as those of parallelograms do, or tangents of half of them, as those of
Bennett's linkage. Along such motions the equations are trigonometric polynomials, or rational
functions, of a degree that the joints bound. One that vanishes at random points all around
vanishes, with probability one, everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from kempe.analysis.local.local_equations import Equations
from kempe.kinematics.closure_rows import evaluate
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
    """Largest dimension of a family of closed configurations through q (nq,) with rates in some of
    `spans` (nv, k).
    """
    e = equations
    angles = np.zeros(e.nv, dtype=bool)
    angles[e.system.structure.layout.vector_v] = True
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
        value = evaluate(e.system, e.move(q, s @ K.T), False, True)[0]
        if np.abs(value).max(initial=0.0) < ZERO:
            best = k
    return best


def half_angles(
    equations: Equations, q: Array, axes: Array, places: Sequence[int], null_space: Array
) -> bool:
    """Whether four hinges move so that tangents of half of neighbouring angles have a constant
    product or ratio.

    `axes` (6, 4) are the screws of the hinges around the loop, in its sense, `places` where their
    angles are, `null_space` (nv,) the velocity. Angles are those between common normals of
    neighbouring axes. Bennett, 1903: opposite angles are then equal, up to their signs.
    """
    z = axes[3:].T
    normal = np.cross(z, np.roll(z, -1, axis=0))
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    if size.min() < NEARLY:
        return False
    x = normal / size
    before = np.roll(x, 1, axis=0)
    theta = np.arctan2(np.sum(np.cross(before, x) * z, axis=1), np.sum(before * x, axis=1))
    rate = null_space[list(places)]
    if np.abs(np.sin(theta[:2])).min() < NEARLY or np.abs(rate).min() < NEARLY:
        return False
    opposite = rate[2:] / rate[:2]
    if np.abs(np.abs(opposite) - 1.0).max() > NEARLY:
        return False
    a, b = np.tan(0.5 * theta[:2])
    turn = np.random.default_rng(0).uniform(-np.pi, np.pi, POINTS)
    u = np.tan(0.5 * turn)
    for other in (2.0 * np.arctan(a * b / u), 2.0 * np.arctan(b / a * u)):
        for sense in (1.0, -1.0):
            by = sense * np.stack([turn - theta[0], other - theta[1]], axis=1)
            step = np.zeros((POINTS, equations.nv))
            step[:, places] = np.concatenate([by, by * np.sign(opposite)], axis=1)
            if (
                np.abs(evaluate(equations.system, equations.move(q, step), False, True)[0]).max()
                < ZERO
            ):
                return True
    return False


def _ratios(span: Array) -> Array | None:
    """The same span by columns of ratios, each 1 in one row in which the others are 0; None if some
    are no ratios.
    """
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
