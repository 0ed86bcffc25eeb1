"""Cubic splines through points as polynomial pieces, and the point of a curve nearest to a place, in plain numpy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from kempe.errors import InputError
from kempe.kernels import tape_layout as L
from kempe.kernels.tape_layout import PIECE
from kempe.spatial import Array

SAME_POINT = 1e-9
"""Distance, in parts of the extent of a curve, of points that are one."""
TURN = 0.5
"""Cosine of the most that a piece turns from its middle; sharper ones are halved."""
HALVINGS = 24
"""Most halvings: a curve that still turns is taken to have a cusp."""


@lru_cache(maxsize=256)
def spline(points: tuple[tuple[float, ...], ...], closed: bool, what: str) -> Array:
    """The pieces (n, 3, 4) of the cubic spline through points, by the length of its chords, for u from 0 to 1 each.

    An open one goes on straight at both ends, in a first and a last piece. Errors: `InputError` for fewer than 4 points
    (3 of a closed curve), neighbours that are equal, and cusps.
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
        raise InputError(f"{what}: the points {i} and {(i + 1) % len(points)} are equal; neighbours must differ")
    size = float(chords.max())
    found = CubicSpline(np.r_[0.0, np.cumsum(chords / size)], given, bc_type="periodic" if closed else "not-a-knot")
    powers = (chords / size)[:, None, None] ** np.arange(4)
    pieces = np.moveaxis(found.c[::-1], 0, -1) * powers  # (n, 3, 4)
    made = [half for i, piece in enumerate(pieces) for half in _gentle(piece, HALVINGS, f"{what}: near point {i}")]
    if not closed:
        first, last = made[0], made[-1]
        slope = last @ [0.0, 1.0, 2.0, 3.0]
        zero = np.zeros(3)
        made.insert(0, np.stack([first[:, 0] - first[:, 1], first[:, 1], zero, zero], axis=1))
        made.append(np.stack([last.sum(axis=1), slope, zero, zero], axis=1))
    return np.array(made)


def _gentle(piece: Array, left: int, what: str) -> list[Array]:
    """A piece in parts of which none turns far: the directions of its derivative's control points are near."""
    a, b, c = piece[:, 1], 2.0 * piece[:, 2], 3.0 * piece[:, 3]
    ends, middle = np.stack([a, a + 0.5 * b, a + b + c]), a + 0.5 * b + 0.25 * c
    sizes = np.linalg.norm(ends, axis=1) * np.linalg.norm(middle)
    if np.all(ends @ middle > TURN * sizes):
        return [piece]
    if not left:
        raise InputError(f"{what} the curve has a cusp; it must have a direction everywhere")
    half = 0.5 ** np.arange(4)
    moved = np.array([[1, 1, 1, 1], [0, 1, 2, 3], [0, 0, 1, 3], [0, 0, 0, 1]]) * half  # p((1 + u) / 2)
    return _gentle(piece * half, left - 1, what) + _gentle(piece @ moved.T, left - 1, what)


def table_of(pieces: Array, closed: bool) -> tuple[float, ...]:
    """Pieces as kernels read them (`tape_layout`)."""
    b, c = pieces[..., 1], pieces[..., 2]
    control = np.stack([b / 3.0, (2.0 * b + c) / 3.0, pieces[..., 1:].sum(axis=-1)])  # Bezier's points less the first
    radius = np.linalg.norm(control, axis=-1).max(axis=0)
    rows = np.concatenate([pieces.reshape(len(pieces), 12), radius[:, None]], axis=1)
    return (float(not closed), *rows.ravel().tolist())


def frames_of(pieces: Array) -> Array:
    """Axes (n, 3, 3) of each piece: two across its middle, and its direction there; no turn about the curve is added.

    Where pieces meet, the smallest turns from both middles lead the axes across into the same.
    """
    middle = _unit(pieces @ [0.0, 1.0, 1.0, 0.75])
    start = _unit(pieces[..., 1])
    k = int(np.argmin(np.abs(middle[0])))
    x = _unit(np.eye(3)[k] - middle[0, k] * middle[0])
    out = np.empty((len(pieces), 3, 3))
    for i, z in enumerate(middle):
        if i:
            x = _led(_led(x, middle[i - 1], start[i]), start[i], z)
            x = _unit(x - (x @ z) * z)
        out[i] = x, np.cross(z, x), z
    return out


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _led(x: Array, a: Array, b: Array) -> Array:
    """A vector across a, turned as the smallest turn takes a to b."""
    return x - (x @ b) / (1.0 + a @ b) * (a + b)


def on_pieces(build: Any, pieces: Array, s: int, p: Sequence[int]) -> tuple[list[int], list[int], int]:
    """Places of a builder of tapes: of what leads from the point c(s) to p, of c'(s), and of c'.c' - (p - c).c''."""
    b = build.binary
    entry = lambda column: build.entry(s, column.tolist())  # noqa: E731
    u = b(L.SUB, s, entry(np.arange(len(pieces), dtype=float)))
    two, three = build.number(2.0), build.number(3.0)
    off, first, second = [], [], []
    for i in range(3):
        k = [entry(pieces[:, i, j]) for j in range(4)]
        slope = b(L.ADD, k[2], b(L.MUL, u, k[3]))
        off.append(b(L.SUB, p[i], b(L.ADD, k[0], b(L.MUL, u, b(L.ADD, k[1], b(L.MUL, u, slope))))))
        cubed = b(L.MUL, three, b(L.MUL, u, k[3]))
        first.append(b(L.ADD, k[1], b(L.MUL, u, b(L.ADD, b(L.MUL, two, k[2]), cubed))))
        second.append(b(L.MUL, two, b(L.ADD, k[2], cubed)))
    return off, first, b(L.SUB, dot(build, first, first), dot(build, off, second))


def dot(build: Any, a: Sequence[int], b: Sequence[int]) -> int:
    """The place of a sum of products."""
    x, y, z = (build.binary(L.MUL, i, k) for i, k in zip(a, b, strict=True))
    return build.binary(L.ADD, build.binary(L.ADD, x, y), z)


def nearest_rates(build: Any, table: tuple[float, ...], s: int, p: Sequence[int]) -> list[int]:
    """Places of the derivatives of the parameter of the nearest point by p: (p - c) . c' = 0, differentiated."""
    pieces = np.reshape(table[1:], (-1, PIECE))[:, :12].reshape(-1, 3, 4)
    _, first, bend = on_pieces(build, pieces, s, p)
    return [build.binary(L.DIV, x, bend) for x in first]


def entries(s: Any, table: Array) -> Array:
    """The entries of a table at parameters."""
    return table[np.clip(np.floor(s), 0, len(table) - 1).astype(np.int64)]


def nearest(way: Any, z: Any) -> Array:
    """The parameters of the points of a curve nearest to places: all critical points of all pieces that may be it.

    `way` has the table of the curve, and x and y.
    """
    table, *xy = way
    endless, rows = table[0] != 0.0, np.reshape(table[1:], (-1, PIECE))
    p = np.stack(np.broadcast_arrays(*xy, z), axis=-1)
    out = np.empty(p.shape[:-1])
    for index in np.ndindex(out.shape):
        out[index] = _nearest(rows, endless, p[index])
    return out


def _nearest(rows: Array, endless: bool, p: Array) -> float:
    """The nearest of one place: roots of the derivative of the squared distance, polynomials of degree 5."""
    if not np.isfinite(p).all():
        return 0.0
    c, n = rows[:, :12].reshape(-1, 3, 4).copy(), len(rows)
    c[..., 0] -= p
    away = np.linalg.norm(c[..., 0], axis=-1)
    may = away - rows[:, 12] <= away.min()
    if endless:
        may[[0, -1]] = True
    best, found = np.inf, 0.0
    for i in np.flatnonzero(may):
        slope = np.sum([np.convolve(x, x[1:] * [1.0, 2.0, 3.0]) for x in c[i]], axis=0)
        low, high = -np.inf if endless and i == 0 else 0.0, np.inf if endless and i == n - 1 else 1.0
        us = np.polynomial.polynomial.polyroots(np.trim_zeros(slope, "b"))
        us = np.clip(us[np.abs(us.imag) < 1e-6].real, low, high).tolist()
        for u in [*us, *(x for x in (low, high) if np.isfinite(x))]:
            far = float(np.sum((c[i] @ [1.0, u, u * u, u**3]) ** 2))
            if far < best:
                best, found = far, float(i + u)
    return found
