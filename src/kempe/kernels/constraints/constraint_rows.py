"""Constraint equations of loops and their Jacobian at one configuration, tie by tie
(`loop_layout`).

A tie holds frame B in frame A: rows of p = R_A^T (p_B - p_A) and of the rotation R = R_A^T R_B.
Between them lie the joints of the loop. The twist that a joint gives B against A, at the origin of
B and in axes of A, is
v = f z x (p_B - o), w = f z for a turn about z through o, and v = f z for a slide; f is negative on
the way to A (Featherstone, 2008, chapter 8). Then dp/dt = v and dR/dt = w x R exactly, so the rows
below have exact derivatives everywhere.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.rotations import compute_rotation_vector
from kempe.kernels.base.trig import atan2
from kempe.kernels.base.vectors import extract_entry, last_of, pack_four
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.forward.table_layout import (
    BALL,
    HEADER,
    KIND,
    MULTIPLIER,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    PARENT,
    PARTICLE,
    ROW,
    ROW_FLOATS,
    ROW_INTS,
    SLIDE,
    TURN,
)
from kempe.kernels.forward.table_rows import prepend_placement, read_placement

ANTIPODE = 1e-12
"""Square of the sine below which two axes count as opposite: the way back is arbitrary there, its
length is not."""
MEETS = 1e-12
"""Distance in metres below which there is no direction from one point to another."""


class LoopScratch(NamedTuple):
    """Packed loops with the scratch of their solver; all fields but the numbers are pointers."""

    ints: object
    floats: object
    plan: object
    weights: object
    pins: object
    q: object
    scratch: object
    poses: object
    """Poses (3x4) of the rows of the table."""
    error: object
    """The equations' residual."""
    blocks: object
    """The Jacobian, tie by tie: a tie's rows by its local columns, column by column."""
    n_rows: int
    nq: int
    nv: int


@device
def read_output_pose(loops, output):
    """Read the rows of the pose of an output."""
    k = HEADER + ROW_INTS * loops.n_rows + OUTPUT_INTS * output
    row = loops.ints[k + ROW]
    a, b, c = read_placement(loops.floats, ROW_FLOATS * loops.n_rows + OUTPUT_FLOATS * output)
    if row >= 0:
        a, b, c = prepend_placement(loops.poses, OUTPUT_FLOATS * row, a, b, c)
    if loops.ints[k + PARTICLE] != 0:  # a particle: only its place counts
        a = drop_rotation(a, 0)
        b = drop_rotation(b, 1)
        c = drop_rotation(c, 2)
    return a, b, c


@device
def drop_rotation(row, i):
    """Return row i of a pose with the identity in place of its rotation."""
    zero = extract_entry(row, 3) * 0.0
    x = zero + (1.0 if i == 0 else 0.0)
    y = zero + (1.0 if i == 1 else 0.0)
    z = zero + (1.0 if i == 2 else 0.0)
    return pack_four(x, y, z, extract_entry(row, 3))


@device
def pack_rotation(a, b, c):
    """Return the nine entries of the rotation in the rows a, b, c."""
    return (
        extract_entry(a, 0),
        extract_entry(a, 1),
        extract_entry(a, 2),
        extract_entry(b, 0),
        extract_entry(b, 1),
        extract_entry(b, 2),
        extract_entry(c, 0),
        extract_entry(c, 1),
        extract_entry(c, 2),
    )


@device
def rotate_vector_back(r, x, y, z):
    """Return R^T (x, y, z), the vector under the inverse rotation."""
    return (
        r[0] * x + r[3] * y + r[6] * z,
        r[1] * x + r[4] * y + r[7] * z,
        r[2] * x + r[5] * y + r[8] * z,
    )


@device
def compute_relative_rotation(r, s):
    """Return R^T S, the rotation S seen from R."""
    return (
        r[0] * s[0] + r[3] * s[3] + r[6] * s[6], r[0] * s[1] + r[3] * s[4] + r[6] * s[7],
        r[0] * s[2] + r[3] * s[5] + r[6] * s[8],
        r[1] * s[0] + r[4] * s[3] + r[7] * s[6], r[1] * s[1] + r[4] * s[4] + r[7] * s[7],
        r[1] * s[2] + r[4] * s[5] + r[7] * s[8],
        r[2] * s[0] + r[5] * s[3] + r[8] * s[6], r[2] * s[1] + r[5] * s[4] + r[8] * s[7],
        r[2] * s[2] + r[5] * s[5] + r[8] * s[8],
    )  # fmt: skip


@device
def multiply_row(row, a, b, c):
    """Return the row `row` times the matrix [a; b; c; 0 0 0 1]."""
    return extract_entry(row, 0) * a + (
        extract_entry(row, 1) * b + (extract_entry(row, 2) * c + last_of(row))
    )


@routine
def read_tie_ends(loops, k):
    """Return rotation and position of frame A, and rotation and position of frame B, of tie k."""
    pin = loops.plan[loops.plan[L.AT_TIES] + L.TIE_INTS * k + L.PIN]
    if pin < 0:
        a, b, c = read_output_pose(loops, 2 * k)
    else:
        a, b, c = read_placement(loops.pins, 12 * pin)
        if (
            loops.ints[HEADER + ROW_INTS * loops.n_rows + OUTPUT_INTS * 2 * k] >= 0
        ):  # pinned to a body that moves
            d, e, f = read_output_pose(loops, 2 * k)
            a, b, c = multiply_row(d, a, b, c), multiply_row(e, a, b, c), multiply_row(f, a, b, c)
    d, e, f = read_output_pose(loops, 2 * k + 1)
    return (
        pack_rotation(a, b, c),
        (extract_entry(a, 3), extract_entry(b, 3), extract_entry(c, 3)),
        pack_rotation(d, e, f),
        (extract_entry(d, 3), extract_entry(e, 3), extract_entry(f, 3)),
    )


@device
def compute_lengthening(x, y, c):
    """Return the factor that makes (x, y), as long as the sine of an angle with cosine c, as long
    as twice the sine of half the angle.

    Zero where the axes are opposite: there (2, 0) takes its place.
    """
    if c >= 0.0:
        return math.sqrt(2.0 / (1.0 + c))
    square = x * x + y * y
    if square < ANTIPODE:
        return 0.0
    return math.sqrt(2.0 * (1.0 - c) / square)


@device
def lengthen_tilt(x, y, c):
    """Return the vector of a tilt, as long as twice the sine of half the angle."""
    k = compute_lengthening(x, y, c)
    if k == 0.0:
        return 2.0, 0.0
    return x * k, y * k


@device
def compute_lengthened_rates(x, y, c, dx, dy, dc):
    """Return the rates of `lengthen_tilt`; where the axes are opposite, the rates of one way back."""
    k = compute_lengthening(x, y, c)
    if k == 0.0:
        return 0.8 * dx + 0.6 * dy, 0.8 * dy - 0.6 * dx
    change = -0.25 * k * k * k * dc
    return dx * k + x * change, dy * k + y * change


@device
def compute_sight_line(p, r):
    """Return the distance from B to A, and the unit vector from B to A in axes of B."""
    x, y, z = rotate_vector_back(r, -p[0], -p[1], -p[2])
    far = math.sqrt(x * x + y * y + z * z)
    if far < MEETS:
        return 1.0, 0.0, 0.0, -1.0
    return far, x / far, y / far, z / far


@routine
def write_error(loops, tie, at, p, r):
    """Write the equations of one tie, p and R the pose of B in A; return the numbers that
    `add_rates` needs.

    That is the rotation vector where all is held, and p where B looks at A.
    """
    e = loops.error
    short = loops.weights[L.INVERSE_LENGTH]
    mask = loops.plan[tie + L.MASK]
    turns = loops.plan[tie + L.TURNS]
    phi = (0.0, 0.0, 0.0)
    for i in range(3):
        if (mask >> i) & 1:
            e[at] = p[i] * short
            at += 1
    if turns == L.FULL:
        phi = compute_rotation_vector(r)
        e[at] = phi[0]
        e[at + 1] = phi[1]
        e[at + 2] = phi[2]
    elif turns == L.ALIGN:
        e[at], e[at + 1] = lengthen_tilt(-r[5], r[2], r[8])
    elif turns == L.ANGLE:
        e[at] = atan2(r[3] - r[1], r[0] + r[4])
    elif turns == L.CROSS:
        e[at] = r[1]
    elif turns == L.LOOK:
        phi = p
        _, x, y, z = compute_sight_line(p, r)
        e[at], e[at + 1] = lengthen_tilt(-y, x, z)
    return phi


@device
def compute_vector_rate(phi, w):
    """Return the rate of the rotation vector phi under the angular velocity w (Bullo and Murray,
    1995).
    """
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if square < 1e-8:
        rest = 1.0 / 12.0
    else:
        half = 0.5 * math.sqrt(square)
        rest = (1.0 - half / math.tan(half)) / square
    c = (
        phi[1] * w[2] - phi[2] * w[1],
        phi[2] * w[0] - phi[0] * w[2],
        phi[0] * w[1] - phi[1] * w[0],
    )
    return (
        w[0] - 0.5 * c[0] + rest * (phi[1] * c[2] - phi[2] * c[1]),
        w[1] - 0.5 * c[1] + rest * (phi[2] * c[0] - phi[0] * c[2]),
        w[2] - 0.5 * c[2] + rest * (phi[0] * c[1] - phi[1] * c[0]),
    )


@device
def add_rates(loops, tie, at, r, phi, v, w):
    """Add the rates of the equations of a tie under the twist (v, w), already scaled, to the column
    at blocks[at:].
    """
    j = loops.blocks
    short = loops.weights[L.INVERSE_LENGTH]
    mask = loops.plan[tie + L.MASK]
    turns = loops.plan[tie + L.TURNS]
    for i in range(3):
        if (mask >> i) & 1:
            j[at] += v[i] * short
            at += 1
    if turns == L.FULL:
        rate = compute_vector_rate(phi, w)
        j[at] += rate[0]
        j[at + 1] += rate[1]
        j[at + 2] += rate[2]
    elif turns == L.ALIGN:
        x = w[1] * r[8] - w[2] * r[5]
        y = w[2] * r[2] - w[0] * r[8]
        z = w[0] * r[5] - w[1] * r[2]
        rates = compute_lengthened_rates(-r[5], r[2], r[8], -y, x, z)
        j[at] += rates[0]
        j[at + 1] += rates[1]
    elif turns == L.ANGLE:
        j[at] += w[2]
    elif turns == L.CROSS:
        j[at] += w[1] * r[7] - w[2] * r[4]
    elif turns == L.LOOK:
        far, x, y, z = compute_sight_line(phi, r)
        c = (
            w[1] * phi[2] - w[2] * phi[1],
            w[2] * phi[0] - w[0] * phi[2],
            w[0] * phi[1] - w[1] * phi[0],
        )
        dx, dy, dz = rotate_vector_back(
            r, (c[0] - v[0]) / far, (c[1] - v[1]) / far, (c[2] - v[2]) / far
        )
        along = x * dx + y * dy + z * dz
        rates = compute_lengthened_rates(-y, x, z, along * y - dy, dx - along * x, dz - along * z)
        j[at] += rates[0]
        j[at + 1] += rates[1]


@device
def read_row_axes(loops, row):
    """Return the three axes of a row and the point on them: of its frame, or for a reversed ball of
    the frame before its motion.
    """
    k = HEADER + ROW_INTS * row
    f = ROW_FLOATS * row
    if loops.ints[k + KIND] == BALL and loops.floats[f + MULTIPLIER] < 0.0:
        a, b, c = read_placement(loops.floats, f)
        if loops.ints[k + PARENT] >= 0:
            a, b, c = prepend_placement(
                loops.poses, OUTPUT_FLOATS * loops.ints[k + PARENT], a, b, c
            )
        return a, b, c
    return read_placement(loops.poses, OUTPUT_FLOATS * row)


@device
def compute_lever(loops, tie, row, sign, a, b, c, p_b):
    """Return the share of B's mass that the row moves (1 for a frame), and this share times the arm
    from the row's point.
    """
    centre = loops.plan[tie + L.CENTRE]
    if centre < 0 or sign < 0.0:
        return 1.0, (
            p_b[0] - extract_entry(a, 3),
            p_b[1] - extract_entry(b, 3),
            p_b[2] - extract_entry(c, 3),
        )
    at = loops.plan[L.AT_CENTRES] + (L.CENTRE_FLOATS * loops.n_rows + 3) * centre
    share = loops.weights[at + L.CENTRE_FLOATS * row + 4]
    s = loops.scratch
    return share, (
        s[3 * row] - share * extract_entry(a, 3),
        s[3 * row + 1] - share * extract_entry(b, 3),
        s[3 * row + 2] - share * extract_entry(c, 3),
    )


@routine
def fill_block(loops, k, r_a, p_b, r, phi):
    """Write the Jacobian block of tie k."""
    plan = loops.plan
    weights = loops.weights
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    rows = plan[tie + L.ROWS]
    block = plan[tie + L.BLOCK]
    for i in range(rows * plan[tie + L.LOCALS]):
        loops.blocks[block + i] = 0.0
    local = plan[L.AT_LOCALS] + plan[tie + L.LOCAL]
    first = plan[tie + L.ENTRY]
    for i in range(first, first + plan[tie + L.ENTRIES]):
        at = plan[L.AT_ENTRIES] + L.ENTRY_INTS * i
        row = plan[at]
        column = plan[at + 1]
        f = ROW_FLOATS * row + MULTIPLIER
        kind = loops.ints[HEADER + ROW_INTS * row + KIND]
        multiplier = loops.floats[f]
        factor = weights[plan[L.AT_FACTORS] + i] * multiplier
        a, b, c = read_row_axes(loops, row)
        share, arm = compute_lever(loops, tie, row, weights[plan[L.AT_FACTORS] + i], a, b, c, p_b)
        there = block + rows * column
        if kind != BALL:
            factor *= weights[L.SCALES + plan[local + column]]
        for n in range(
            0 if kind == BALL else 2, 3
        ):  # a ball turns about three axes, all others are about z
            x = factor * extract_entry(a, n)
            y = factor * extract_entry(b, n)
            z = factor * extract_entry(c, n)
            if kind == SLIDE:
                v = (share * x, share * y, share * z)
                w = (0.0, 0.0, 0.0)
            else:
                v = (y * arm[2] - z * arm[1], z * arm[0] - x * arm[2], x * arm[1] - y * arm[0])
                w = (x, y, z)
            add_rates(
                loops,
                tie,
                there,
                r,
                phi,
                rotate_vector_back(r_a, v[0], v[1], v[2]),
                rotate_vector_back(r_a, w[0], w[1], w[2]),
            )
            there += rows


@routine
def fill_rod_block(loops, k, x, p_b):
    """Write the block of a rod of direction x."""
    plan = loops.plan
    weights = loops.weights
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    block = plan[tie + L.BLOCK]
    first = plan[tie + L.ENTRY]
    local = plan[L.AT_LOCALS] + plan[tie + L.LOCAL]
    for i in range(plan[tie + L.LOCALS]):
        loops.blocks[block + i] = 0.0
    for i in range(first, first + plan[tie + L.ENTRIES]):
        at = plan[L.AT_ENTRIES] + L.ENTRY_INTS * i
        row = plan[at]
        column = plan[at + 1]
        kind = loops.ints[HEADER + ROW_INTS * row + KIND]
        multiplier = loops.floats[ROW_FLOATS * row + MULTIPLIER]
        factor = weights[plan[L.AT_FACTORS] + i] * multiplier * weights[L.INVERSE_LENGTH]
        a, b, c = read_row_axes(loops, row)
        share, arm = compute_lever(loops, tie, row, weights[plan[L.AT_FACTORS] + i], a, b, c, p_b)
        # x . (z x arm) = z . (arm x x)
        m = (
            arm[1] * x[2] - arm[2] * x[1],
            arm[2] * x[0] - arm[0] * x[2],
            arm[0] * x[1] - arm[1] * x[0],
        )
        if kind == BALL:
            for n in range(3):
                rate = (
                    extract_entry(a, n) * m[0]
                    + extract_entry(b, n) * m[1]
                    + extract_entry(c, n) * m[2]
                )
                loops.blocks[block + column + n] += factor * rate
            continue
        if kind != TURN:
            m = (share * x[0], share * x[1], share * x[2])
        factor *= weights[L.SCALES + plan[local + column]]
        loops.blocks[block + column] += factor * (
            extract_entry(a, 2) * m[0] + extract_entry(b, 2) * m[1] + extract_entry(c, 2) * m[2]
        )


@routine
def add_twist_rates(loops, k, r_a, p_b, along, about, row):
    """Add to one row of the block of tie k the rates that (along, about) give for the twist of B
    against A, in axes of A.
    """
    plan = loops.plan
    weights = loops.weights
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    rows = plan[tie + L.ROWS]
    block = plan[tie + L.BLOCK]
    first = plan[tie + L.ENTRY]
    local = plan[L.AT_LOCALS] + plan[tie + L.LOCAL]
    for i in range(first, first + plan[tie + L.ENTRIES]):
        at = plan[L.AT_ENTRIES] + L.ENTRY_INTS * i
        table_row = plan[at]
        column = plan[at + 1]
        f = ROW_FLOATS * table_row + MULTIPLIER
        kind = loops.ints[HEADER + ROW_INTS * table_row + KIND]
        factor = weights[plan[L.AT_FACTORS] + i] * loops.floats[f]
        a, b, c = read_row_axes(loops, table_row)
        arm = (
            p_b[0] - extract_entry(a, 3),
            p_b[1] - extract_entry(b, 3),
            p_b[2] - extract_entry(c, 3),
        )
        there = block + rows * column + row
        if kind != BALL:
            factor *= weights[L.SCALES + plan[local + column]]
        for n in range(0 if kind == BALL else 2, 3):
            x = factor * extract_entry(a, n)
            y = factor * extract_entry(b, n)
            z = factor * extract_entry(c, n)
            if kind == SLIDE:
                v = rotate_vector_back(r_a, x, y, z)
                loops.blocks[there] += along[0] * v[0] + along[1] * v[1] + along[2] * v[2]
            else:
                v = rotate_vector_back(
                    r_a, y * arm[2] - z * arm[1], z * arm[0] - x * arm[2], x * arm[1] - y * arm[0]
                )
                w = rotate_vector_back(r_a, x, y, z)
                loops.blocks[there] += along[0] * v[0] + along[1] * v[1] + along[2] * v[2]
                loops.blocks[there] += about[0] * w[0] + about[1] * w[1] + about[2] * w[2]
            there += rows
