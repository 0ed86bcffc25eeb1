"""Shorter loops: what singular values and bounds of a mechanism of many loops are read from.

Loops that a spanning tree closes may be long, however small the cells are. Any of them may be
replaced by its sum with another one that is closed by a whole joint: the equations stay equivalent
(Kirchhoff, 1847).
"""

from __future__ import annotations

import numpy as np

from kempe.spatial import Array

MOST = 400
"""Loops of a cluster up to which shorter ones are sought."""


def shortened(signs: Array, whole: np.ndarray, parent: np.ndarray, child: np.ndarray) -> Array:
    """Signs (loops, edges) of loops, each shortened by others that are `whole` (mask) as far as
    that goes at once.

    `parent` and `child` are the bodies of the edges. Each loop stays a simple one, and keeps the
    edge that closes it.
    """
    if not 1 < len(signs) <= MOST:
        return signs
    out = signs.copy()
    length = np.abs(signs).sum(axis=1)
    for k in np.argsort(-length, kind="stable"):  # the longest first: the others are as they were
        while True:
            shared = signs @ out[k]
            gain = np.where(whole, 2.0 * np.abs(shared) - length, 0.0)
            gain[k] = 0.0
            best = int(np.argmax(gain))
            shorter = out[k] - np.sign(shared[best]) * signs[best]
            shrinks = np.abs(shorter).sum() < np.abs(out[k]).sum()
            if (
                gain[best] <= 0.0
                or not shrinks
                or not _simple(shorter, parent, child)
                or length[best] > length[k]
            ):
                break
            if (
                length[best] == length[k] and best > k
            ):  # of two alike only one is replaced by the other
                break
            out[k] = shorter
    return out


def _simple(loop: Array, parent: np.ndarray, child: np.ndarray) -> bool:
    """Whether edges with signs 1, 0, -1 are one closed walk that meets no body twice."""
    edges = np.flatnonzero(loop)
    if np.abs(loop[edges]).max() > 1.0:
        return False
    ahead = loop[edges] > 0.0
    start = np.where(ahead, parent[edges], child[edges])
    end = np.where(ahead, child[edges], parent[edges])
    after = dict(zip(start.tolist(), end.tolist(), strict=True))
    if len(after) < len(edges):
        return False
    body = int(start[0])
    steps = 0
    while steps < len(edges) and body in after:
        body = after[body]
        steps = steps + 1
        if body == int(start[0]):
            break
    return steps == len(edges)
