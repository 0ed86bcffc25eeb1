"""Smallest distances between spheres, capsules and boxes, `LANES` configurations side by side.

Distances are exact: no iteration, no tolerance. An overlap counts as its depth, the length of the
shortest translation that separates the two, with a minus sign.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.lines import (
    add_scaled,
    combine_three,
    cross,
    dot,
    subtract_vectors,
)
from kempe.kernels.base.masks import pack_mask
from kempe.kernels.base.vectors import (
    LANES,
    compute_square_root,
    gather_lanes,
    get_pointer,
    keep_alive,
    load_lanes,
    select_where,
    spread_lanes,
    store_value,
)
from kempe.kernels.forward.table_layout import N_OUT, N_ROWS
from kempe.kernels.forward.table_rows import count_sweep_scratch
from kempe.kernels.forward.table_sweep import descend_tree
from kempe.kernels.solids.solid_layout import (
    BOX,
    FORM,
    OFF_CENTERS,
    OFF_CORES,
    OUTPUT,
    PAIR_FLOATS,
    PAIR_INTS,
    SEGMENT,
    SIZES,
    SOLID_FLOATS,
    SOLID_INTS,
)

PLACED = 12 * LANES
"""Numbers of a placed solid: its centre, and three vectors. Of a segment the first one is half of
it, of a point it is zero; of a box they are its axes."""
SMALLEST = 1e-290
"""Squares and divisors below which nothing is divided by them."""


# ---- solids at configurations


@device
def load_vector(placed, k):
    """Load a vector of lanes from placed[k:]."""
    return (
        load_lanes(placed, k),
        load_lanes(placed, k + LANES),
        load_lanes(placed, k + 2 * LANES),
    )


@device
def store_vector(placed, k, v):
    """Store a vector of lanes at placed[k:]."""
    store_value(placed, k, v[0])
    store_value(placed, k + LANES, v[1])
    store_value(placed, k + 2 * LANES, v[2])


@device
def place_solids(solids, shapes, count, poses, n_out, placed):
    """Write the solids at the poses of LANES configurations to `placed`; return 0 for each lane, or
    NaN where a pose is not finite.
    """
    size = 16 * n_out
    spoil = spread_lanes(0.0)
    for i in range(count):
        pose = 16 * solids[SOLID_INTS * i + OUTPUT]
        form = solids[SOLID_INTS * i + FORM]
        shape = SOLID_FLOATS * i
        to = PLACED * i
        x = (
            gather_lanes(poses, pose, size),
            gather_lanes(poses, pose + 4, size),
            gather_lanes(poses, pose + 8, size),
        )
        y = (
            gather_lanes(poses, pose + 1, size),
            gather_lanes(poses, pose + 5, size),
            gather_lanes(poses, pose + 9, size),
        )
        z = (
            gather_lanes(poses, pose + 2, size),
            gather_lanes(poses, pose + 6, size),
            gather_lanes(poses, pose + 10, size),
        )
        p = (
            gather_lanes(poses, pose + 3, size),
            gather_lanes(poses, pose + 7, size),
            gather_lanes(poses, pose + 11, size),
        )
        turned = combine_three(x, shapes[shape + 3], y, shapes[shape + 7], z, shapes[shape + 11])
        center = add_scaled(p, 1.0, turned)
        spoil = spoil + 0.0 * (center[0] + (center[1] + center[2]))
        store_vector(placed, to, center)
        if form == BOX:
            for k in range(3):
                axis = combine_three(
                    x, shapes[shape + k], y, shapes[shape + 4 + k], z, shapes[shape + 8 + k]
                )
                store_vector(placed, to + 3 * LANES * (k + 1), axis)
        else:
            half = shapes[shape + SIZES] if form == SEGMENT else 0.0
            axis = combine_three(
                x,
                half * shapes[shape + 2],
                y,
                half * shapes[shape + 6],
                z,
                half * shapes[shape + 10],
            )
            store_vector(placed, to + 3 * LANES, axis)
    return spoil


# ---- distances of cores


@device
def take_smaller(a, b):
    """Return the smaller one of two numbers."""
    return select_where(b > a, a, b)


@device
def take_larger(a, b):
    """Return the larger one of two numbers."""
    return select_where(a > b, a, b)


@device
def clamp(x, bound):
    """Bring x between -bound and bound."""
    return take_smaller(take_larger(x, -bound), bound)


@device
def invert(x):
    """Return 1 / x, or 0 where x is too small for that."""
    return select_where(abs(x) > SMALLEST, 1.0 / select_where(abs(x) > SMALLEST, x, 1.0), 0.0)


@device
def measure_point_to_segment(w, v, inverse):
    """Measure the squared distance of a point from a segment.

    w leads from the point to the middle of the segment, v is half of it; `inverse` is 1 / |v|^2.
    """
    r = add_scaled(w, clamp(-dot(w, v) * inverse, 1.0), v)
    return dot(r, r)


@routine
def measure_segments(w, u, v):
    """Measure the squared distance of two segments, halves u and v, from whose first to whose second
    middle w leads.

    It is the smallest of those of each end from the other segment, and of the lines, where these
    are nearest within the segments. The distance of two points of the segments is no less than
    theirs, so that the points may be inaccurate where the lines are nearly parallel.
    """
    by_u = invert(dot(u, u))
    by_v = invert(dot(v, v))
    n = cross(u, v)
    by_n = invert(dot(n, n))
    s = clamp(dot(cross(w, v), n) * by_n, 1.0)
    t = clamp(dot(cross(w, u), n) * by_n, 1.0)
    r = add_scaled(add_scaled(w, t, v), -s, u)
    best = dot(r, r)
    best = take_smaller(best, measure_point_to_segment(add_scaled(w, 1.0, u), v, by_v))
    best = take_smaller(best, measure_point_to_segment(add_scaled(w, -1.0, u), v, by_v))
    best = take_smaller(best, measure_point_to_segment(add_scaled(w, 1.0, v), u, by_u))
    return take_smaller(best, measure_point_to_segment(add_scaled(w, -1.0, v), u, by_u))


@device
def measure_excess(x, half):
    """Return how far x is beyond -half or half, with its sign; 0 between them."""
    return x - clamp(x, half)


@device
def compute_slope(c, d, half, t):
    """Return half the derivative by t of the squared distance of c + t d from a box."""
    return (
        measure_excess(c[0] + t * d[0], half[0]) * d[0]
        + measure_excess(c[1] + t * d[1], half[1]) * d[1]
        + measure_excess(c[2] + t * d[2], half[2]) * d[2]
    )


@device
def narrow_bracket(c, d, half, place, rate, bracket):
    """Replace an end of the bracket (low, its slope, high, its slope) by place / rate, where this
    lies within.
    """
    low, at_low, high, at_high = bracket
    t = clamp(place * invert(rate), 1.0)
    slope = compute_slope(c, d, half, t)
    rises = slope > 0.0
    falls = 0.0 > slope
    # where it is flat, t is both ends
    up = select_where(rises, low, select_where(t > low, t, low))
    down = select_where(falls, high, select_where(high > t, t, high))
    return (
        up,
        select_where(up > low, slope, at_low),
        down,
        select_where(high > down, slope, at_high),
    )


@device
def separate_by_edges(ca, cb, da, db, ha, hb):
    """Return how far the normal to a segment and to an edge of a box separates them.

    The numbers are along the two axes of the box that are perpendicular to the edge.
    """
    square = da * da + db * db
    apart = abs(da * cb - db * ca) - (abs(da) * hb + abs(db) * ha)
    wide = square > SMALLEST
    return select_where(wide, apart / compute_square_root(select_where(wide, square, 1.0)), -1e300)


@routine
def measure_segment_to_box(c, d, half):
    """Measure the signed distance of a segment from a box.

    c and d are its middle and half of it along the axes of the box, from the centre.

    The squared distance of a point c + t d from the box is convex in t, and its derivative is
    linear between the planes of the faces: between the last of these places where it falls and the
    first one where it rises, it is zero on a straight line. The depth of a segment in a box is that
    of the origin in their Minkowski sum, whose faces are perpendicular to an axis of the box, or to
    an axis and the segment.
    """
    one = spread_lanes(1.0)
    bracket = -one, compute_slope(c, d, half, -one), one, compute_slope(c, d, half, one)
    bracket = narrow_bracket(c, d, half, half[0] - c[0], d[0], bracket)
    bracket = narrow_bracket(c, d, half, half[0] + c[0], -d[0], bracket)
    bracket = narrow_bracket(c, d, half, half[1] - c[1], d[1], bracket)
    bracket = narrow_bracket(c, d, half, half[1] + c[1], -d[1], bracket)
    bracket = narrow_bracket(c, d, half, half[2] - c[2], d[2], bracket)
    bracket = narrow_bracket(c, d, half, half[2] + c[2], -d[2], bracket)
    low, at_low, high, at_high = bracket
    part = -at_low * invert(at_high - at_low)
    t = low + take_smaller(take_larger(part, 0.0), 1.0) * (high - low)
    x = measure_excess(c[0] + t * d[0], half[0])
    y = measure_excess(c[1] + t * d[1], half[1])
    z = measure_excess(c[2] + t * d[2], half[2])
    apart = compute_square_root(x * x + (y * y + z * z))
    inside = abs(c[0]) - (half[0] + abs(d[0]))
    inside = take_larger(inside, abs(c[1]) - (half[1] + abs(d[1])))
    inside = take_larger(inside, abs(c[2]) - (half[2] + abs(d[2])))
    inside = take_larger(inside, separate_by_edges(c[1], c[2], d[1], d[2], half[1], half[2]))
    inside = take_larger(inside, separate_by_edges(c[2], c[0], d[2], d[0], half[2], half[0]))
    inside = take_larger(inside, separate_by_edges(c[0], c[1], d[0], d[1], half[0], half[1]))
    return select_where(0.0 > inside, inside, apart)


@device
def measure_cores(solids, shapes, placed, i, j, w, square):
    """Measure the signed distance of the cores of the solids i and j, between whose centres w leads,
    with the square of its length.
    """
    a = solids[SOLID_INTS * i + FORM]
    b = solids[SOLID_INTS * j + FORM]
    if b == BOX:
        u = load_vector(placed, PLACED * i + 3 * LANES)
        x = load_vector(placed, PLACED * j + 3 * LANES)
        y = load_vector(placed, PLACED * j + 6 * LANES)
        z = load_vector(placed, PLACED * j + 9 * LANES)
        k = SOLID_FLOATS * j + SIZES
        half = (
            spread_lanes(shapes[k]),
            spread_lanes(shapes[k + 1]),
            spread_lanes(shapes[k + 2]),
        )
        c = (-dot(w, x), -dot(w, y), -dot(w, z))
        return measure_segment_to_box(c, (dot(u, x), dot(u, y), dot(u, z)), half)
    if a == SEGMENT or b == SEGMENT:
        u = load_vector(placed, PLACED * i + 3 * LANES)
        v = load_vector(placed, PLACED * j + 3 * LANES)
        square = measure_segments(w, u, v)
    return compute_square_root(square)


# ---- the smallest distance


@kernel(
    I("_"), F("_"), F("N", "_"), I("S", 2), F("S", 16), I("P", 2), F("P", 2), OUT("N"),
    returns=False,
)  # fmt: skip
def find_smallest_distances(ints, floats, q, solids, shapes, pairs, offsets, out):
    """Write the smallest distance (N,) of pairs of solids at each q (N, nq), less what each pair has
    to keep; NaN where a pose is not finite, infinite without pairs.

    Lanes beyond the last configuration repeat it.
    """
    n, nq = q.shape
    count = solids.shape[0]
    n_out = ints[N_OUT]
    scratch = np.empty(count_sweep_scratch(ints[N_ROWS]))
    held = np.empty(LANES * 16 * n_out)
    room = np.empty(PLACED * count + LANES)
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    q_ = get_pointer(q)
    solids_ = get_pointer(solids)
    shapes_ = get_pointer(shapes)
    pairs_ = get_pointer(pairs)
    offsets_ = get_pointer(offsets)
    scratch_ = get_pointer(scratch)
    poses = get_pointer(held)
    placed = get_pointer(room)
    smallest = get_pointer(room[PLACED * count :])
    for start in range(0, n, LANES):
        for lane in range(LANES):
            at = min(start + lane, n - 1)
            descend_tree(i_, f_, q_, at * nq, poses, 16 * n_out * lane, scratch_)
        spoil = place_solids(solids_, shapes_, count, poses, n_out, placed)
        best = spread_lanes(np.inf)
        for k in range(pairs.shape[0]):
            i = pairs_[PAIR_INTS * k]
            j = pairs_[PAIR_INTS * k + 1]
            w = subtract_vectors(load_vector(placed, PLACED * j), load_vector(placed, PLACED * i))
            square = dot(w, w)
            limit = best + offsets_[PAIR_FLOATS * k + OFF_CENTERS]
            near = limit * limit > square
            if pack_mask(near) != 0:
                d = measure_cores(solids_, shapes_, placed, i, j, w, square)
                d = d - offsets_[PAIR_FLOATS * k + OFF_CORES]
                # a lane does not depend on what the others are near to
                best = select_where(near, select_where(best > d, d, best), best)
        store_value(smallest, 0, best + spoil)
        for lane in range(min(LANES, n - start)):
            out[start + lane] = smallest[lane]
    keep_alive(scratch)
    keep_alive(held)
    keep_alive(room)
