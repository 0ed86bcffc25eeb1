"""From solutions at many values of a parameter to the arcs of the curves through them."""

from __future__ import annotations

import math

import numpy as np

from kempe.budget import TimeUp, look
from kempe.singular_values import svd
from kempe.solvers.analytic.redundant.sweep_curves import (
    LONGEST,
    ChainMotion,
    CurvePiece,
    follow,
    pieces,
)
from kempe.solvers.common.clock import TimeLimit
from kempe.solvers.common.tracing import BEND
from kempe.spatial import Array

SAME = 1e-4
"""Distance below which the end of a path is a solution that is known."""

STRAIGHT = 0.1
"""How far a step may be from the mean of the tangents at its ends, as a fraction of its length."""

Piece = tuple[Array, Array]


class Net:
    """Solutions at rising values of the parameter, and the pieces of curve that join them.

    x, t (M, nf): solutions and unit tangents along which the parameter rises; level (M,): which
    value. `up[a]` is the next node above a with the piece from a to it, both inclusive; `head[a]`
    and `foot[a]` are pieces that end in a fold above a, or begin in one below; `loose` are arcs
    that no value meets.
    """

    def __init__(self, motion: ChainMotion, values: Array, x: Array, level: np.ndarray):
        self.motion = motion
        self.values = values
        self.x = x
        self.level = level
        t = svd(motion.jacobian(x))[2][:, -1] if len(x) else np.zeros_like(x)
        self.t = np.where(t[:, motion.p, None] < 0.0, -t, t)
        self.up: dict[int, tuple[int, Piece]] = {}
        self.below: set[int] = set()
        self.head: dict[int, Piece] = {}
        self.foot: dict[int, Piece] = {}
        self.loose: list[Piece] = []
        self.at = [np.flatnonzero(level == i) for i in range(len(values))]

    def join(self) -> None:
        """Join what is close and straight, and follow the curves from all ends that are left."""
        for i in range(len(self.values) - 1):
            self._join_levels(self.at[i], self.at[i + 1])
        for a in range(len(self.x)):
            if self.level[a] < len(self.values) - 1 and a not in self.up and a not in self.head:
                self._follow(a, 1.0)
        for a in range(len(self.x)):
            if self.level[a] > 0 and a not in self.below and a not in self.foot:
                self._follow(a, -1.0)

    def _join_levels(self, low: np.ndarray, high: np.ndarray) -> None:
        if not low.size or not high.size:
            return
        d = self.motion.gap(self.x[low][:, None], self.x[high][None])
        t = self.t[low][:, None]
        u = self.t[high][None]
        size = np.linalg.norm(d, axis=-1)
        straight = np.linalg.norm(d - 0.5 * size[..., None] * (t + u), axis=-1) <= STRAIGHT * size
        fits = straight & (np.sum(t * u, axis=-1) >= math.cos(BEND)) & (size < 2.0 * LONGEST)
        for j, k in zip(
            *np.nonzero(fits & (fits.sum(axis=0) == 1) & (fits.sum(axis=1) == 1)[:, None]),
            strict=True,
        ):
            a = int(low[j])
            b = int(high[k])
            x = np.array([self.x[a], self.x[a] + d[j, k]])
            self._link(a, b, (x, self.t[[a, b]]))

    def _link(self, a: int, b: int, piece: Piece) -> None:
        self.up[a] = (b, piece)
        self.below.add(b)

    def _follow(self, a: int, sense: float) -> None:
        """Follow the curve from node a up (sense 1) or down (-1) to the next value of the
        parameter, or back.

        Its pieces are kept in `up`, `head`, `foot` and `loose`.
        """
        look()
        motion = self.motion
        i = int(self.level[a])
        j = i + int(sense)
        between = (
            float(min(self.values[i], self.values[j])),
            float(max(self.values[i], self.values[j])),
        )
        xs, ts = follow(motion, self.x[a], sense * self.t[a], between)
        parts = pieces(motion, xs, ts)
        arrived = (
            i
            if abs(xs[-1][motion.p] - self.values[i]) < abs(xs[-1][motion.p] - self.values[j])
            else j
        )
        b = self._node(xs[-1], arrived)
        if len(parts) == 1:
            x, t = parts[0]
            if b is not None and b not in (self.below if sense > 0.0 else self.up):
                self._link(*((a, b, (x, t)) if sense > 0.0 else (b, a, (x[::-1], -t[::-1]))))
            else:
                (self.head if sense > 0.0 else self.foot)[a] = (
                    (x, t) if sense > 0.0 else (x[::-1], -t[::-1])
                )
            return
        self._hang(a, sense, parts[0])
        if b is not None:
            x, t = parts[-1]
            self._hang(b, sense if arrived == i else -sense, (x[::-1], -t[::-1]))
            parts.pop()
        self.loose += parts[1:]

    def _hang(self, a: int, sense: float, piece: Piece) -> None:
        """Keep a piece that leads away from a node to a fold above or below it."""
        x, t = piece
        if sense > 0.0:
            self.head[a] = x, t
        else:
            self.foot[a] = x[::-1], -t[::-1]

    def _node(self, x: Array, level: int) -> int | None:
        """The node at a level that equals x (nf,), where a path has arrived; None where there is
        none.
        """
        some = self.at[level]
        if not some.size:
            return None
        away = np.abs(self.motion.gap(self.x[some], x)).max(axis=-1)
        k = int(np.argmin(away))
        return int(some[k]) if away[k] < SAME else None

    def arcs(self) -> list[CurvePiece]:
        """All arcs, in the order of where they begin."""
        out = [self._arc([piece]) for piece in self.loose]
        for a in range(len(self.x)):
            if a in self.below:
                continue
            parts = [self.foot[a]] if a in self.foot else []
            k = a
            while k in self.up:
                k, piece = self.up[k]
                parts.append(piece)
            if k in self.head:
                parts.append(self.head[k])
            if parts:
                out.append(self._arc(parts))
        return sorted(out, key=lambda a: (round(float(a.values[0]), 6), *a.x[0].round(6).tolist()))

    def _arc(self, parts: list[Piece]) -> CurvePiece:
        """One arc of pieces that follow each other, angles without jumps, the parameter rising."""
        (x, t) = parts[0]
        p = self.motion.p
        xs = list(x)
        ts = list(t)
        for more, tangents in parts[1:]:
            turn = xs[-1] + self.motion.gap(xs[-1], more[0]) - more[0]
            xs += list(more[1:] + turn)
            ts += list(tangents[1:])
        x = np.array(xs)
        t = np.array(ts)
        if x[-1, p] < x[0, p]:
            x = x[::-1]
            t = -t[::-1]
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(x[:, p])) > 0.0])
        return CurvePiece(self.motion, x[keep], t[keep])


def arcs_through(
    motion: ChainMotion, values: Array, x: Array, level: np.ndarray, time: TimeLimit
) -> list[CurvePiece]:
    """The arcs of the curves through solutions x (M, nf), at rising values (m,); level (M,): at
    which.

    Solutions at the values are joined to curves; from those that find no partner curves are
    followed.
    """
    x = x.copy()
    x[:, motion.p] = values[level]
    better, good = motion.closed(x, np.repeat(np.eye(x.shape[1])[[motion.p]], len(x), axis=0))
    good &= np.abs(better - x).max(axis=-1, initial=0.0) < SAME
    net = Net(motion, values, np.where(good[:, None], better, x), level)
    try:
        net.join()
    except TimeUp:  # the arcs that were joined by now
        if not time.spent:
            raise
    return net.arcs()
