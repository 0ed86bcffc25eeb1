"""A kind that holds a point on a curve through given points."""

from __future__ import annotations

from dataclasses import field
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from kempe.calls import flag
from kempe.constraints.base import Frame, Op, Point, Row, kind
from kempe.constraints.builder import Builder
from kempe.constraints.kinds import ORIGIN, Placed
from kempe.constraints.pieces import dot, frames_of, on_pieces, spline, table_of
from kempe.constraints.reading import points_of
from kempe.constraints.tape import Tape
from kempe.errors import InputError
from kempe.kernels import tape_layout as L
from kempe.reals import reals

Points: TypeAlias = Any
"""A field of a list of points, which are structure: numbers, the same for all targets."""


@kind("on_curve", "line", "{frame} is on a curve of {other}")
class OnCurve(Placed):
    """A point of a frame on the curve through `points` (n, 3), in planar systems also (n, 2).

    The curve is the cubic spline by the length of its chords. A `closed` one ends where it starts, and its first point
    need not be repeated; an open one goes on straight beyond its ends. Its equations are the distances across the curve
    from its nearest point.
    """

    frame: Frame
    points: Points
    closed: bool = False
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        flag(self.closed, f"closed of {self.label}")
        given = reals(self.points, what := f"points of {self.label}")
        if given.ndim != 2 or given.shape[1] not in (2, 3) or not np.isfinite(given).all():
            raise InputError(f"{what} have the shape {given.shape}; they must be (n, 2) or (n, 3), and finite")
        object.__setattr__(self, "points", tuple(map(tuple, given.tolist())))
        across(self.points, self.closed, given.shape[1], what)

    def check(self, dim: int) -> None:
        """The points are in the plane of a planar system, and have three numbers in space."""
        points_of(self.points, dim, f"points of {self.label}")

    def rows(self, dim: int) -> tuple[Row, ...]:
        """Across the curve: two directions, in the plane one."""
        tape = across(self.points, self.closed, dim, f"points of {self.label}")
        names = ("across",) if dim == 2 else ("across 1", "across 2")
        return tuple(Row(Op.TAPE, (tape, k), name, "m") for k, name in enumerate(names))


@lru_cache(maxsize=256)
def across(points: tuple[tuple[float, ...], ...], closed: bool, dim: int, what: str) -> Tape:
    """The distances of (x, y, z) from a curve across it. Errors: `InputError`, see `spline`.

    In space the directions are the two of `frames_of`, turned as the smallest turn takes its third to the tangent t:
    a - (a.t) (z + t) / (1 + z.t), where (p - c).t = 0.
    """
    pieces = spline(tuple((*p, 0.0)[:3] for p in points), closed, what)
    build = Builder("xyz"[:dim])
    b = build.binary
    p = [i if i < dim else build.number(0.0) for i in range(3)]
    s = build.nearest(table_of(pieces, closed), p)
    off, first, _ = on_pieces(build, pieces, s, p)
    speed = build.unary(L.SQRT, dot(build, first, first))
    t = [b(L.DIV, x, speed) for x in first]
    if dim == 2:
        return build.finish([b(L.SUB, b(L.MUL, t[0], off[1]), b(L.MUL, t[1], off[0]))])
    axes = frames_of(pieces)
    x, y, z = ([build.entry(s, axes[:, k, i].tolist()) for i in range(3)] for k in range(3))
    share = b(L.DIV, dot(build, off, z), b(L.ADD, build.number(1.0), dot(build, z, t)))
    return build.finish([b(L.SUB, dot(build, off, a), b(L.MUL, dot(build, a, t), share)) for a in (x, y)])
