"""A serial chain as lines: its joint axes and tip at the reference configuration."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.answers.targets import Z_AXIS, make_rotations_along
from kempe.errors import UnsupportedError
from kempe.inverse.chain.serial_chain import find_chain
from kempe.inverse.chain.span import Span, even_out_offsets
from kempe.inverse.closed_forms.structure import Axes, compute_line_distance
from kempe.kernels.forward.table_layout import (
    BALL,
    COS_OFFSET,
    KIND,
    MULTIPLIER,
    Q_INDEX,
    SIN_OFFSET,
    SLIDE,
    copy_placements,
    get_row_integers,
    get_row_numbers,
)
from kempe.model.model import keep_answers
from kempe.numerics.rank import Spectrum
from kempe.spatial import Array
from kempe.units import from_metres

if TYPE_CHECKING:
    from kempe.model.model import Model


NOISE = 1e-12
"""Distances of axes, relative to those of their points and of the base, that are rounding: such
axes meet."""

PARALLEL = 1e-9
"""Square of the sine of the angle between axes below which the place of the nearest point along them
is not asked: it would be thousands of lengths away."""
LITTLE = 0.1
"""The least unit of length of a chain with slides, relative to how far these may go."""


@dataclass(frozen=True, eq=False)
class Lines(Axes):
    """The joint axes of a serial chain T(theta) = E_1 ... E_n M, with its tip and coordinates.

    `tip` (4, 4) is the pose M at theta = 0. All are seen from `origin` (3,) in the ground's axes and
    measured in `length` [m]. theta = multiplier q + offset, slides divided by the length. `limits`
    (2, n), `q_index` and `v_index` (n,) into the system's q and velocities, `names`.
    """

    tip: Array
    offset: Array
    multiplier: Array
    limits: Array
    q_index: np.ndarray
    v_index: np.ndarray
    names: tuple[str, ...]
    origin: Array
    length: float
    span: Span
    even: Lines | None = None
    """The same axes with lengths of one size, by which freedoms are counted where lengths are far
    apart."""

    def compute_theta(self, q: Array) -> Array:
        """Compute the variables (..., n) of the lines at coordinates q (..., n) of the chain."""
        return q * self.multiplier + self.offset


def build_lines(system: Model, frame: str) -> Lines:
    """Build the lines of the chain that moves a frame.

    Errors: `UnsupportedError` for loops, balls and shared coordinates.
    """
    chain = find_chain(system, frame)
    ints = chain.ints
    floats = chain.floats
    rows = get_row_integers(ints)
    numbers = get_row_numbers(ints, floats)
    n = len(rows)
    names = tuple(system.structure.velocity_names[int(i)] for i in chain.v_index)
    if n == 0:
        raise UnsupportedError(f"no joint moves frame {frame!r}")
    if np.any(rows[:, KIND] == BALL):
        raise UnsupportedError(
            f"frame {frame!r} moves with a joint whose coordinates are a quaternion; `ik_all` "
            "needs angles and slides (a spherical joint can be loaded with angles=True)"
        )
    if len(set(rows[:, Q_INDEX].tolist())) < n:
        raise UnsupportedError(
            f"two motions of the chain of {frame!r} share one coordinate (a helical joint, or a "
            "joint that follows another): there is no plan for that; `ik` solves it, and `ik_all` "
            "by `assembly_modes`"
        )
    placements = copy_placements(ints, floats)
    if chain.span.rounding > chain.span.largest > 0.0:
        raise UnsupportedError(
            f"all of the chain of {frame!r} is smaller than rounding: {chain.span.format_ratio()}"
        )
    h, o, tip = _compute_lines(placements)
    order = np.argsort(rows[:, Q_INDEX])
    if not np.array_equal(rows[order, Q_INDEX], np.arange(n)):
        raise UnsupportedError(f"the coordinates of {frame!r} are not one for each joint")
    at = rows[:, Q_INDEX]  # the joint in row i has the chain's coordinate at[i]
    kinds = rows[:, KIND].copy()
    multiplier = numbers[:, MULTIPLIER].copy()
    offset = np.where(
        kinds == SLIDE, 0.0, np.arctan2(numbers[:, SIN_OFFSET], numbers[:, COS_OFFSET])
    )

    def scale_lines(h: Array, o: Array, tip: Array, even: Lines | None) -> Lines:
        origin, length = _choose_unit(
            kinds, h, o, tip[:3, 3], chain.limits[:, at], from_metres(1.0, system.unit)
        )
        tip[:3, 3] = (tip[:3, 3] - origin) / length
        return Lines(
            kinds,
            h,
            (o - origin) / length,
            tip,
            offset,
            np.where(kinds == SLIDE, multiplier / length, multiplier),
            np.ascontiguousarray(chain.limits[:, at]),
            chain.q_index[at],
            chain.v_index[at],
            tuple(names[int(i)] for i in at),
            origin,
            length,
            chain.span,
            even,
        )

    p = even_out_offsets(ints, floats)
    even = (
        None
        if p is None
        else scale_lines(
            *_compute_lines([_shift_placement(x, y) for x, y in zip(placements, p, strict=True)]),
            None,
        )
    )
    return scale_lines(h, o, tip, even)


def _compute_lines(placements: Iterable[np.ndarray]) -> tuple[Array, Array, Array]:
    """Compute directions and points (n, 3) of the axes and the pose (4, 4) of the tip."""
    poses = list(itertools.accumulate(map(_build_pose, placements), np.matmul))
    X = np.array(poses[:-1])
    return X[:, :3, 2].copy(), X[:, :3, 3].copy(), poses[-1]


def _shift_placement(placement: np.ndarray, p: Array) -> np.ndarray:
    """Return the placement (12,) at another point (3,)."""
    rows = placement.reshape(3, 4).copy()
    rows[:, 3] = p
    return rows.ravel()


def _build_pose(rows: np.ndarray) -> Array:
    """Build a pose (4, 4) from its upper rows (12,)."""
    return np.vstack([rows.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])


def _choose_unit(
    kinds: np.ndarray, h: Array, o: Array, tip: Array, limits: Array, metre: float
) -> tuple[Array, float]:
    """Choose a point near the turning axes as origin, and a length as unit.

    Where that is zero it is how far slides may go, and a metre without slides. Neither changes if the
    points slide along their axes or the base moves. What slides go is no part of the way: where
    that is much longer, offsets by which axes miss each other would be a unit in which slides are
    immense.
    """
    turning = np.flatnonzero(kinds != SLIDE)
    if turning.size == 0:
        return np.zeros(3), metre
    slides = np.flatnonzero(kinds == SLIDE)
    all_points = o
    o = o[turning]
    h = h[turning]
    # the point nearest to all axes
    across = np.eye(3) - h[:, :, None] * h[:, None, :]
    total: Array = np.einsum("nij,nj->i", across, o)
    origin = Spectrum(across.sum(axis=0)).solve_least_squares(total, PARALLEL)
    free = o - origin
    away = np.linalg.norm(free - h * np.sum(h * free, axis=-1)[:, None], axis=-1)
    axes = Axes(kinds[turning], h, o)
    steps = [compute_line_distance(axes, i, i + 1) for i in range(len(axes) - 1)]
    size = max(sum(steps), float(away.max()))
    noise = NOISE * max(float(np.linalg.norm(x)) for x in (free, origin))
    alone = not (size > noise and math.isfinite(size))
    if slides.size:
        travel = _estimate_travel(
            limits[1, slides] - limits[0, slides], all_points[slides] - origin, tip - origin
        )
        size = travel if alone else max(size, LITTLE * travel)
    elif alone:
        return origin, metre
    return origin, size if size > noise and math.isfinite(size) else metre


def _estimate_travel(ranges: Array, offsets: Array, tip: Array) -> float:
    """Estimate how far slides may move: by their limits, or else by distances of the chain."""
    by_limits = float(np.where(np.isfinite(ranges), ranges, 0.0).max())
    return by_limits if by_limits > 0.0 else max(float(np.linalg.norm(x)) for x in (*offsets, tip))


@keep_answers
def find_chain_lines(system: Model, frame: str, axis: tuple[float, float, float]) -> Lines:
    """Find the lines of a frame's chain, its tip turned so that z is the tool's `axis`."""
    lines = build_lines(system, frame)
    if axis == Z_AXIS:
        return lines
    tip = lines.tip.copy()
    tip[:3, :3] = tip[:3, :3] @ make_rotations_along(np.array(axis))
    return replace(lines, tip=tip)


# ---- motions of lines


def compute_line_placements(lines: Lines, theta: Array) -> tuple[Array, Array, Array]:
    """Compute tip poses (m, 4, 4), and directions and points (m, n, 3) of lines at theta (m, n)."""
    m, n = theta.shape
    h = np.empty((m, n, 3))
    o = np.empty((m, n, 3))
    R = np.broadcast_to(np.eye(3), (m, 3, 3))
    p = np.zeros((m, 3))
    K = spatial.skew(lines.h)
    turns = (lines.kinds != SLIDE)[:, None, None]
    s = np.sin(theta)[..., None, None]
    c = np.cos(theta)[..., None, None]
    E = np.where(turns, np.eye(3) + s * K + (1.0 - c) * (K @ K), np.eye(3))
    shift = np.where(
        turns[..., 0], lines.o - np.einsum("mnij,nj->mni", E, lines.o), theta[..., None] * lines.h
    )
    for i in range(n):
        h[:, i], o[:, i] = R @ lines.h[i], R @ lines.o[i] + p
        p = p + np.einsum("mij,mj->mi", R, shift[:, i])
        R = R @ E[:, i]
    T = np.zeros((m, 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R @ lines.tip[:3, :3], R @ lines.tip[:3, 3] + p, 1.0
    return T, h, o


def compute_jacobians(lines: Lines, theta: Array) -> Array:
    """Compute Jacobians (m, 6, n) [linear; angular] in the tip's frame at theta (m, n)."""
    T, h, o = compute_line_placements(lines, theta)
    slides = (lines.kinds == SLIDE)[:, None]
    v = np.where(slides, h, np.cross(h, T[:, None, :3, 3] - o))
    w = np.where(slides, 0.0, h)
    back = np.swapaxes(T[:, :3, :3], 1, 2)
    return np.concatenate([back @ np.swapaxes(v, 1, 2), back @ np.swapaxes(w, 1, 2)], axis=1)


def compute_motion(kind: int, h: Array, o: Array, theta: float) -> Array:
    """Compute the pose (4, 4) of a turn about a line, or of a slide along its direction."""
    X = np.eye(4)
    if kind == SLIDE:
        X[:3, 3] = theta * h
        return X
    X[:3, :3] = spatial.exp_so3(theta * h)
    X[:3, 3] = o - X[:3, :3] @ o
    return X
