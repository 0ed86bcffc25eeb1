"""Bounds by lengths and limits: how far a point of a mechanism can get from another one.

A chain cannot be longer than its links and slides together, nor fold back further than its longest
link leaves. And the box of a place is led from the tip to the base through the joints, each anywhere
within its limits (interval arithmetic: Moore, Kearfott, Cloud, *Introduction to Interval Analysis*,
2009). Loops, constraints and tasks only take away from what a chain of the tree can reach, so the
bounds hold with them, too: what lies outside is proven to be impossible.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    KIND,
    MULTIPLIER,
    SIN_OFFSET,
    SLIDE,
    TURN,
    V_INDEX,
    copy_placements,
    get_row_integers,
    get_row_numbers,
)
from kempe.model.gauge import regauge_table
from kempe.model.packed_loops import make_explicit_table
from kempe.model.primitive_table import End, Table, extract_chain
from kempe.spatial import Array, make_rotation

if TYPE_CHECKING:
    from kempe.model.model import Model

Packed = tuple[np.ndarray, np.ndarray]
"""The integers and numbers of a packed chain, as kernels take them."""
GROUND: End = (-1, np.eye(4), False)
"""The ground as the base of a chain."""

SLACK = 1e-9
"""Slack for rounding, as a part of lengths and boxes."""

# ---- the chain between two frames


class Links(NamedTuple):
    """Links of a chain: what leads from each joint to the next, and how joints move.

    `kinds` (n,) of the joints; `placements` (n + 1, 3, 4) of each joint in the axes of the one
    before, the first in those of the base, and of the tip; `ends` (n, 2) between which a joint
    moves, in radians or metres, low before high.
    """

    kinds: np.ndarray
    placements: Array
    ends: Array

    @property
    def slides(self) -> float:
        """How far the sliding joints lead together at most [m]."""
        return float(np.abs(self.ends[self.kinds == SLIDE]).max(axis=1, initial=0.0).sum())


def _extract_chain(table: Table, tip: End, base: End) -> tuple[Table, np.ndarray]:
    """Extract the table of the chain between two frames, and the indices of its coordinates in v."""
    chain, _, v_index = extract_chain(replace(table, at={"tip": tip, "base": base}), "tip", "base")
    return chain, v_index


def list_sliding_coordinates(system: Model, tip: End, base: End = GROUND) -> list[str]:
    """List the names of the sliding coordinates of a chain, whose limits bound its reach."""
    chain, v_index = _extract_chain(system.structure.table, tip, base)
    slides = np.unique(v_index[chain.iv[chain.kind == SLIDE]])
    return [system.structure.velocity_names[v] for v in slides]


def _list_equivalent_links(
    table: Table, limits: Array, tip: End, base: End
) -> tuple[Iterator[Links], int]:
    """List equivalent links of the chain between two frames, and count its coordinates.

    Coordinates move within `limits` (nv, 2).

    The first are as described. Sums of lengths depend on where along the axis of a joint its frame
    stands, so the second have frames at common normals.
    """
    chain, v_index = _extract_chain(table, tip, base)
    packed = chain.pack_arrays(["tip"])
    within = limits[v_index]
    return (_read_links(*a, within) for a in (packed, regauge_table(*packed))), len(v_index)


def _read_links(ints: np.ndarray, floats: np.ndarray, limits: Array) -> Links:
    """Read the links of a packed chain whose coordinates have limits (n, 2)."""
    rows = get_row_integers(ints)
    numbers = get_row_numbers(ints, floats)
    ends = np.sort(numbers[:, MULTIPLIER, None] * limits[rows[:, V_INDEX]], axis=1)
    turns = rows[:, KIND] == TURN
    offsets = np.arctan2(numbers[:, SIN_OFFSET], numbers[:, COS_OFFSET])
    ends[turns] += offsets[turns, None]
    return Links(rows[:, KIND], copy_placements(ints, floats), ends)


def _join_fixed_links(links: Links) -> Links:
    """Join the links at each joint whose limits leave it one position: they are one link."""
    fixed = (links.ends[:, 0] == links.ends[:, 1]) & np.isin(links.kinds, (TURN, SLIDE))
    if not fixed.any():
        return links
    placements: list[Array] = []
    X = np.eye(4)
    for k, placement in enumerate(links.placements):
        X = X @ np.vstack([placement, [0.0, 0.0, 0.0, 1.0]])
        if k < len(fixed) and fixed[k]:
            X = X @ _make_joint_pose(links.kinds[k], float(links.ends[k, 0]))
        else:
            placements.append(X[:3])
            X = np.eye(4)
    return Links(links.kinds[~fixed], np.array(placements), links.ends[~fixed])


def _make_joint_pose(kind: int, x: float) -> Array:
    """Return the pose (4, 4) of a joint that turns about z, or slides along it, at a position."""
    X = np.eye(4)
    if kind == TURN:
        X[:3, :3] = make_rotation(np.float64(x), "z")
    else:
        X[2, 3] = x
    return X


# ---- bounds of distances


class ReachBound(NamedTuple):
    """Bounds of the distance between a point of a frame and a point of the base."""

    centre: Array
    """The point of the base (3,), in its axes."""
    largest: float
    smallest: float
    point: Array
    """The point of the frame (3,), in its axes: its origin, or one of the last axis."""


def compute_distance_bounds(system: Model, tip: End, base: End) -> tuple[float, float]:
    """Compute the smallest and largest distance [m] between the origins of two frames."""
    links, _ = _list_equivalent_links(system.structure.table, system.structure.limits, tip, base)
    bounds = np.array([_bound_length(x.placements[..., 3], x.slides) for x in links])
    return float(bounds[:, 0].max()), float(bounds[:, 1].min())


def compute_reach_bounds(
    system: Model, tip: End, base: End = GROUND
) -> tuple[tuple[ReachBound, ...], int]:
    """Compute bounds of the reach of a frame from a base, and count coordinates that move it.

    They bound the frame's origin and, if the last joint turns, its axis: a pose of the frame
    determines where the last axis is, and fewer lengths lead there. Of an axis that turns the best
    point counts: of the first the one nearest to the second joint, of the last the one nearest to
    the joint before.
    """
    links, freedoms = _list_equivalent_links(
        system.structure.table, system.structure.limits, tip, base
    )
    return _bound_reaches(links), freedoms


def compute_packed_reach_bounds(packed: Iterable[Packed], limits: Array) -> tuple[ReachBound, ...]:
    """Compute bounds of the reach of a chain with limits (n, 2) from equivalent packed forms of it.

    They are those of `compute_reach_bounds`, for a caller who has packed the chain.
    """
    return _bound_reaches(_read_links(*arrays, limits) for arrays in packed)


def _bound_reaches(links: Iterable[Links]) -> tuple[ReachBound, ...]:
    """Bound the reach by equivalent links of a chain, without bounds that are infinite."""
    return tuple(b for x in links for b in _bound_reach(x) if math.isfinite(b.largest))


def _bound_reach(links: Links) -> Iterator[ReachBound]:
    """Bound the reach of the tip of a chain, and of a point of its last axis."""
    R = links.placements[..., :3]
    p = links.placements[..., 3].copy()
    n = len(links.kinds)
    start = p[0]
    if n and links.kinds[0] == TURN:
        start = start + p[1, 2] * R[0, :, 2]
        p[1, 2] = 0.0
    smallest, largest = _bound_length(p[1:], links.slides)
    yield ReachBound(start, largest, smallest, np.zeros(3))
    if n > 1 and links.kinds[-1] == TURN:
        along = 0.0
        if n > 2:
            axis = R[n - 1, :, 2]
            along = -float(p[n - 1] @ axis)
            p[n - 1] = p[n - 1] + along * axis
        point = R[n].T @ (np.array([0.0, 0.0, along]) - links.placements[n, :, 3])
        smallest, largest = _bound_length(p[1:n], links.slides)
        yield ReachBound(start, largest, smallest, point)


def _bound_length(steps: Array, slides: float) -> tuple[float, float]:
    """Bound the distance from the first to the last of points that steps (n, 3) and slides join."""
    lengths = np.sqrt((steps * steps).sum(axis=-1))
    return (
        max(0.0, 2.0 * float(lengths.max(initial=0.0)) - float(lengths.sum()) - slides),
        float(lengths.sum()) + slides,
    )


# ---- loops that their lengths leave open


class LoopGap(NamedTuple):
    """Loop that lengths leave open: its joint, its longest link, and all others with slides [m]."""

    joint: str
    longest: float
    others: float


def find_unclosable_loop(
    system: Model, known: Mapping[str, float], limits: bool = True
) -> LoopGap | None:
    """Find the loop with a link that is longer than all others together, by most; None for none.

    No configuration closes it. Coordinates of `known` stay at their values, so that links between
    them are one; slides stay within their `limits`.
    """
    within = np.array(system.structure.limits)
    if not limits:
        within[:] = -np.inf, np.inf
    for k, name in enumerate(system.structure.velocity_names):
        if name in known:
            within[k] = known[name]
    table = make_explicit_table(system)
    size = float(np.linalg.norm(table.placement[:, :3, 3], axis=1).sum())
    size += sum(map(abs, known.values()))
    worst: LoopGap | None = None
    for joint in system.structure.closures:
        ends = table.at[joint, "M"], table.at[joint, "F"]
        for moving in _list_equivalent_links(table, within, *ends)[0]:
            links = _join_fixed_links(moving)
            lengths = np.linalg.norm(links.placements[..., 3], axis=-1)
            longest = float(lengths.max())
            others = float(lengths.sum()) - longest + links.slides
            least = SLACK * size if worst is None else worst.longest - worst.others
            if longest - others > least:
                worst = LoopGap(joint, longest, others)
    return worst


# ---- bounds of places

ZERO = 1e-14
"""Components of an axis that are rounding: a slide without limits does not move the tip in them."""


class PlaceBounds(NamedTuple):
    """Bounds of a frame's origin: a box (2, 3), perhaps infinite, and shells.

    All are to be widened by a `slack` for rounding.
    """

    box: Array
    shells: tuple[ReachBound, ...]
    slack: float


def compute_place_bounds(system: Model, tip: End, base: End = GROUND) -> PlaceBounds:
    """Compute the bounds of the places of a frame's origin, in the axes of a base."""
    links, _ = _list_equivalent_links(system.structure.table, system.structure.limits, tip, base)
    kinds, placements, ends = next(links)
    box = np.tile(placements[-1][:, 3], (2, 1))
    far = float(np.linalg.norm(placements[-1][:, 3]))
    for kind, (low, high), X in zip(kinds[::-1], ends[::-1], placements[-2::-1], strict=True):
        if kind == TURN:
            box = _bound_turned_box(box, low, high)
        elif kind == SLIDE:
            box[:, 2] += (low, high)
            far += max(abs(low), abs(high))
        else:
            box = np.array([[-far] * 3, [far] * 3])
        # no place is farther from a joint than the links behind it are long
        box = np.clip(_bound_placed_box(box, X), X[:, 3] - far, X[:, 3] + far)
        far += float(np.linalg.norm(X[:, 3]))
    shells, _ = compute_reach_bounds(system, tip, base)
    finite = np.abs(box[np.isfinite(box)])
    slack = SLACK * (1.0 + float(finite.max(initial=0.0)))
    return PlaceBounds(box, tuple(b for b in shells if not b.point.any()), slack)


def _bound_placed_box(box: Array, X: Array) -> Array:
    """Compute the smallest box that contains a box moved by the pose X (3, 4)."""
    axes = np.where(np.abs(X[:, :3]) < ZERO, 0.0, X[:, :3])
    with np.errstate(invalid="ignore"):
        ends = np.where(axes == 0.0, 0.0, axes * box[:, None, :])
    return X[:, 3] + np.stack([ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)])


def _bound_turned_box(box: Array, low: float, high: float) -> Array:
    """Compute the smallest box that contains a box turned about z by angles from `low` to `high`."""
    out = box.copy()
    if not np.isfinite(box[:, :2]).all():
        out[:, :2] = [[-np.inf], [np.inf]]
        return out
    x = np.repeat(box[:, 0], 2)
    y = np.tile(box[:, 1], 2)
    r = np.hypot(x, y)
    angle = np.arctan2(y, x)
    if not high - low < 2.0 * math.pi:
        low = 0.0
        high = 2.0 * math.pi
    # the largest value is at `quarter`, the least opposite
    for axis, quarter in ((0, 0.0), (1, 0.5 * math.pi)):
        at = np.stack([r * np.cos(angle + low - quarter), r * np.cos(angle + high - quarter)])
        for k, side in ((1, 0.0), (0, math.pi)):
            passes = np.floor((angle + high - quarter - side) / (2.0 * math.pi)) >= np.ceil(
                (angle + low - quarter - side) / (2.0 * math.pi)
            )
            ends = np.where(passes, r if k else -r, at.max(axis=0) if k else at.min(axis=0))
            out[k, axis] = ends.max() if k else ends.min()
    return out


# ---- poses out of reach

ROUNDING = 1e-14
"""What rounding makes of lengths, in parts of them."""


def measure_bound_excess(
    bounds: Sequence[ReachBound],
    X: Array,
    tolerance: tuple[float, float],
    turned: bool = True,
    axes: Sequence[int] = (0, 1, 2),
    dim: int = 3,
    along: Array | None = None,
) -> Array:
    """Measure how far (..., 2) in metres poses X (..., 4, 4) of a frame exceed reach bounds.

    First as to the place, then together with the orientation, where that is `turned`, or points
    `along` an axis (3,) of the frame. `axes` of the pose are those along which its place counts:
    with fewer than `dim`, no place is too near. These are lower bounds of the error in its place;
    zero within the tolerances and what rounding makes of them.
    """
    linear, angular = tolerance
    out = np.zeros((*X.shape[:-2], 2))
    p = X[..., :3, 3]
    R = X[..., :3, :3]
    size = np.abs(p).max(axis=-1)
    for centre, largest, smallest, point in bounds:
        arm = float(np.linalg.norm(point))
        on_axis = along is not None and float(np.linalg.norm(np.cross(point, along))) < 1e-12 * arm
        if arm > 0.0 and not (turned or on_axis):
            continue
        away = p + R @ point - centre
        if len(axes) < 3:
            away = np.einsum("...ji,...j->...i", R, away)[..., list(axes)]
        far = np.linalg.norm(away, axis=-1)
        off = far - largest if len(axes) < dim else np.maximum(far - largest, smallest - far)
        k = int(arm > 0.0)
        slack = linear + arm * angular + ROUNDING * (largest + arm + size)
        out[..., k] = np.where(off > slack, np.maximum(out[..., k], off), out[..., k])
    return out
