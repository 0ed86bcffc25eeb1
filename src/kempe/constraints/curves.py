"""Constraint of a point to a curve through given points, and piecewise cubic splines."""

from __future__ import annotations

from dataclasses import field
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arguments import read_flag
from kempe.arrays import read_reals
from kempe.constraints.base import Frame, Op, Point, Row, kind, read_points
from kempe.constraints.builder import Builder, add_curve_terms, add_dot_product
from kempe.constraints.kinds import ORIGIN, Measured
from kempe.constraints.tape import Tape
from kempe.constraints.text import LEAST
from kempe.errors import InputError
from kempe.kernels.constraints import tape_layout as L
from kempe.spatial import Array

SAME_POINT = 1e-9
"""Distance, in parts of the extent of a curve, of points that are one."""
TURN = 0.5
"""Cosine of the most that a piece turns from its middle; sharper ones are halved."""
HALVINGS = 24
"""Most halvings: a curve that still turns is taken to have a cusp."""


Points: TypeAlias = ArrayLike
"""A field of a list of points, which are structure: numbers, the same for all targets."""


@kind("on_curve", says="{frame} is on a curve of {other}")
class OnCurve(Measured):
    """Demand that a point of a frame is on a curve through given points, or near it.

    Parameters
    ----------
    frame
        Name of the frame or body.
    points
        Points (n, 3) in metres, in the plane also (n, 2): at least 4, of a closed curve 3.
    closed
        Whether the curve ends where it starts (default: False). The first point need not be
        repeated.
    point
        Point (3,) of the frame in its axes in metres (default: its origin).
    other
        Frame in whose axes the points are read (default: the ground).
    at_least, at_most
        Bounds of the distance from the curve in metres, in place of 0 (default: none).

    Raises
    ------
    InputError
        If there are too few points, or neighbours are equal.

    Notes
    -----
    The curve is the cubic spline over the lengths of its chords. An open curve goes on straight
    beyond its ends.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import OnCurve
    >>> robot = kempe.load("puma560")
    >>> points = [(0.3, 0, 0.3), (0.4, 0.1, 0.3), (0.5, 0, 0.3), (0.4, -0.1, 0.3)]
    >>> bool(robot.ik(OnCurve("tool", points, closed=True)).success)
    True
    """

    frame: Frame
    points: Points
    closed: bool = False
    point: Point = ORIGIN
    other: Frame | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        read_flag(self.closed, f"closed of {self.label}")
        given = read_reals(self.points, what := f"points of {self.label}")
        if given.ndim != 2 or given.shape[1] not in (2, 3) or not np.isfinite(given).all():
            raise InputError(
                f"{what} have the shape {given.shape}; they must be (n, 2) or (n, 3), and finite"
            )
        object.__setattr__(self, "points", tuple(tuple(p) for p in given.tolist()))
        make_curve_tape(self.points, self.closed, given.shape[1], what)

    def check_fields(self, dim: int) -> None:
        """Refuse points off the plane of a planar system, and bounds that do not fit.

        In space, points of two numbers are refused, too.
        """
        super().check_fields(dim)
        read_points(self.points, dim, f"points of {self.label}")

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the offsets across the curve, or of the bounded distance from the curve.

        Across the curve there are two directions, in the plane one.
        """
        tape = make_curve_tape(
            self.points, self.closed, dim, f"points of {self.label}", self.bounded
        )
        if self.bounded:
            return self.list_bounded_rows(Op.TAPE, tape, 0)
        names = ("across",) if dim == 2 else ("across 1", "across 2")
        return tuple(Row(Op.TAPE, (tape, k), name, "m") for k, name in enumerate(names))


@lru_cache(maxsize=256)
def make_curve_tape(
    points: tuple[tuple[float, ...], ...], closed: bool, dim: int, what: str, whole: bool = False
) -> Tape:
    """Make the tape of the distances of (x, y, z) across a curve, or of the `whole` distance.

    Errors: `InputError`, see `fit_spline`.

    In space the directions are the two of `compute_piece_axes`, turned as the smallest turn takes its third
    to the tangent t: a - (a.t) (z + t) / (1 + z.t), where (p - c).t = 0.
    """
    pieces = fit_spline(tuple((*p, 0.0)[:3] for p in points), closed, what)
    build = Builder("xyz"[:dim])
    b = build.add_binary
    p = [i if i < dim else build.add_number(0.0) for i in range(3)]
    s = build.add_nearest_parameter(flatten_pieces(pieces, closed), p)
    off, first, _ = add_curve_terms(build, pieces, s, p)
    speed = build.add_unary(L.SQRT, add_dot_product(build, first, first))
    t = [b(L.DIV, x, speed) for x in first]
    if whole:
        return build.finish_tape(
            [
                build.add_unary(
                    L.SQRT,
                    b(L.ADD, add_dot_product(build, off, off), build.add_number(float(LEAST))),
                )
            ]
        )
    if dim == 2:
        return build.finish_tape([b(L.SUB, b(L.MUL, t[0], off[1]), b(L.MUL, t[1], off[0]))])
    axes = compute_piece_axes(pieces)
    x, y, z = ([build.add_entry(s, axes[:, k, i].tolist()) for i in range(3)] for k in range(3))
    share = b(
        L.DIV,
        add_dot_product(build, off, z),
        b(L.ADD, build.add_number(1.0), add_dot_product(build, z, t)),
    )
    return build.finish_tape(
        [
            b(L.SUB, add_dot_product(build, off, a), b(L.MUL, add_dot_product(build, a, t), share))
            for a in (x, y)
        ]
    )


@lru_cache(maxsize=256)
def fit_spline(points: tuple[tuple[float, ...], ...], closed: bool, what: str) -> Array:
    """Fit a cubic spline through points by the length of its chords.

    Returned are its pieces (n, 3, 4): coefficients in u from 0 to 1 each.

    An open one goes on straight at both ends, in a first and a last piece. Errors: `InputError` for
    fewer than 4 points (3 of a closed curve), neighbours that are equal, and cusps.
    """
    from scipy.interpolate import CubicSpline

    given = np.array(points)
    same = SAME_POINT * np.max(np.ptp(given, axis=0), initial=0.0)
    if closed and len(given) > 1 and np.linalg.norm(given[0] - given[-1]) <= same:
        given = given[:-1]
    least, which = (3, "a closed") if closed else (4, "an open")
    if len(given) < least:
        raise InputError(f"{what} are {len(given)}; {which} curve needs {least} at least")
    if closed:
        given = np.concatenate([given, given[:1]])
    chords = np.linalg.norm(np.diff(given, axis=0), axis=1)
    if chords.min() <= same:
        i = int(np.argmin(chords))
        raise InputError(
            f"{what}: the points {i} and {(i + 1) % len(points)} are equal; neighbours must differ"
        )
    size = float(chords.max())
    found = CubicSpline(
        np.r_[0.0, np.cumsum(chords / size)], given, bc_type="periodic" if closed else "not-a-knot"
    )
    powers = (chords / size)[:, None, None] ** np.arange(4)
    pieces = np.moveaxis(found.c[::-1], 0, -1) * powers  # (n, 3, 4)
    made = [
        half
        for i, piece in enumerate(pieces)
        for half in _split_piece(piece, HALVINGS, f"{what}: near point {i}")
    ]
    if not closed:
        first = made[0]
        last = made[-1]
        slope = last @ [0.0, 1.0, 2.0, 3.0]
        zero = np.zeros(3)
        made.insert(0, np.stack([first[:, 0] - first[:, 1], first[:, 1], zero, zero], axis=1))
        made.append(np.stack([last.sum(axis=1), slope, zero, zero], axis=1))
    return np.array(made)


def _split_piece(piece: Array, left: int, what: str) -> list[Array]:
    """Split a piece in halves until none turns far.

    The directions of its derivative's control points are then near each other.
    """
    a = piece[:, 1]
    b = 2.0 * piece[:, 2]
    c = 3.0 * piece[:, 3]
    ends = np.stack([a, a + 0.5 * b, a + b + c])
    middle = a + 0.5 * b + 0.25 * c
    sizes = np.linalg.norm(ends, axis=1) * np.linalg.norm(middle)
    if np.all(ends @ middle > TURN * sizes):
        return [piece]
    if not left:
        raise InputError(f"{what} the curve has a cusp; it must have a direction everywhere")
    half = 0.5 ** np.arange(4)
    # p((1 + u) / 2)
    moved = np.array([[1, 1, 1, 1], [0, 1, 2, 3], [0, 0, 1, 3], [0, 0, 0, 1]]) * half
    return _split_piece(piece * half, left - 1, what) + _split_piece(
        piece @ moved.T, left - 1, what
    )


def flatten_pieces(pieces: Array, closed: bool) -> tuple[float, ...]:
    """Return pieces as a tuple of numbers that kernels read (`tape_layout`)."""
    b = pieces[..., 1]
    c = pieces[..., 2]
    # Bezier's points less the first
    control = np.stack([b / 3.0, (2.0 * b + c) / 3.0, pieces[..., 1:].sum(axis=-1)])
    radius = np.linalg.norm(control, axis=-1).max(axis=0)
    rows = np.concatenate([pieces.reshape(len(pieces), 12), radius[:, None]], axis=1)
    return (float(not closed), *rows.ravel().tolist())


def compute_piece_axes(pieces: Array) -> Array:
    """Compute axes (n, 3, 3) of each piece: two across its middle, and its direction there.

    No turn about the curve is added.

    Where pieces meet, the smallest turns from both middles lead the axes across into the same.
    """
    middle = spatial.unit(pieces @ [0.0, 1.0, 1.0, 0.75])
    start = spatial.unit(pieces[..., 1])
    k = int(np.argmin(np.abs(middle[0])))
    x = spatial.unit(np.eye(3)[k] - middle[0, k] * middle[0])
    out = np.empty((len(pieces), 3, 3))
    for i, z in enumerate(middle):
        if i:
            x = _transport_vector(_transport_vector(x, middle[i - 1], start[i]), start[i], z)
            x = spatial.unit(x - (x @ z) * z)
        out[i] = x, np.cross(z, x), z
    return out


def _transport_vector(x: Array, a: Array, b: Array) -> Array:
    """Turn a vector across a by the smallest turn that takes a to b."""
    return x - (x @ b) / (1.0 + a @ b) * (a + b)
