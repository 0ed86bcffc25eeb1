"""A free base moved as a whole so that the frames which tasks hold come as near to their goals as
they can together.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.rotations import turn_ball
from kempe.kernels.base.vectors import entry
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import back, ends_of, matrix
from kempe.kernels.constraints.loop_coordinates import number
from kempe.kernels.forward.table_layout import (
    HEADER,
    MULTIPLIER,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    PARENT,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    V_INDEX,
)
from kempe.kernels.forward.table_rows import placement, row_poses

SQUARINGS = 26
"""Squarings that leave of a matrix the projection on the eigenvectors of its largest eigenvalue."""
FAINT = 1e-6
"""Square of a projection of length one at most from which on it counts."""


@device
def fits(loops, ask, k, ball):
    """Whether tie k holds the position of a frame that the base moves against the ground, in a
    stage of its own.
    """
    plan = loops.plan
    ints = loops.ints
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    outputs = HEADER + ROW_INTS * loops.n_rows + OUTPUT_INTS * 2 * k
    turns = plan[tie + L.TURNS]
    if ask.stage[k] < 1 or plan[tie + L.PIN] < 0 or plan[tie + L.MASK] != 7 or ints[outputs] >= 0:
        return False
    if (
        (turns != L.FULL and turns != L.NO_TURN)
        or plan[tie + L.BOUND] >= 0
        or plan[tie + L.CENTRE] >= 0
    ):
        return False
    row = ints[outputs + OUTPUT_INTS]
    while row > ball:
        row = ints[HEADER + ROW_INTS * row + PARENT]
    return row == ball


@device
def squared(m):
    """The square of a symmetric 4x4 matrix, ten numbers row by row from the diagonal on, divided by
    its trace.
    """
    a, b, c, d, e, f, g, h, i, j = m
    p = a * a + b * b + c * c + d * d
    q = b * b + e * e + f * f + g * g
    r = c * c + f * f + h * h + i * i
    s = d * d + g * g + i * i + j * j
    n = 1.0 / max(p + q + r + s, 1e-300)
    return (
        p * n,
        (a * b + b * e + c * f + d * g) * n,
        (a * c + b * f + c * h + d * i) * n,
        (a * d + b * g + c * i + d * j) * n,
        q * n,
        (b * c + e * f + f * h + g * i) * n,
        (b * d + e * g + f * i + g * j) * n,
        r * n,
        (c * d + f * g + h * i + i * j) * n,
        s * n,
    )


@routine
def rotation_for(h):
    """The unit quaternion of the rotation D for which tr(D H) is largest, H row by row (Horn,
    1987).

    Where many are as good, the one nearest to no rotation.
    """
    a, b, c, d, e, f, g, i, j = h  # of D x ~ y, H is the sum of all x y^T
    size = 1e-30
    for x in h:
        size += 2.0 * abs(x)
    m = (
        size + a + e + j,
        f - i,
        g - c,
        b - d,
        size + a - e - j,
        b + d,
        c + g,
        size + e - a - j,
        f + i,
        size + j - a - e,
    )
    for _ in range(SQUARINGS):
        m = squared(m)
    if m[0] > FAINT:
        w = m[0]
        x = m[1]
        y = m[2]
        z = m[3]
    elif m[4] >= m[7] and m[4] >= m[9]:
        w = m[1]
        x = m[4]
        y = m[5]
        z = m[6]
    elif m[7] >= m[9]:
        w = m[2]
        x = m[5]
        y = m[7]
        z = m[8]
    else:
        w = m[3]
        x = m[6]
        y = m[8]
        z = m[9]
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * n, x * n, y * n, z * n


@routine
def spread_of(loops, ask, ball, hard):
    """Sums over the frames that count: how many; where they are, where they shall be, and the
    matrix of `rotation_for`.

    Places are measured from the first frame and its goal, which are returned, too.
    """
    count = 0
    first = (0.0, 0.0, 0.0)
    aim = (0.0, 0.0, 0.0)
    p = (0.0, 0.0, 0.0)
    g = (0.0, 0.0, 0.0)
    h = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    square = loops.weights[L.LENGTH] * loops.weights[L.LENGTH]
    for k in range(loops.plan[L.N_TIES]):
        if (ask.hard[k] != 0) != hard or not fits(loops, ask, k, ball):
            continue
        r_a, p_a, r_b, p_b = ends_of(loops, k)
        if count == 0:
            first = p_b
            aim = p_a
        x = (p_b[0] - first[0], p_b[1] - first[1], p_b[2] - first[2])
        y = (p_a[0] - aim[0], p_a[1] - aim[1], p_a[2] - aim[2])
        count += 1
        p = (p[0] + x[0], p[1] + x[1], p[2] + x[2])
        g = (g[0] + y[0], g[1] + y[1], g[2] + y[2])
        t = (
            square
            if loops.plan[loops.plan[L.AT_TIES] + L.TIE_INTS * k + L.TURNS] == L.FULL
            else 0.0
        )
        h = (
            h[0] + x[0] * y[0] + t * (r_b[0] * r_a[0] + r_b[1] * r_a[1] + r_b[2] * r_a[2]),
            h[1] + x[0] * y[1] + t * (r_b[0] * r_a[3] + r_b[1] * r_a[4] + r_b[2] * r_a[5]),
            h[2] + x[0] * y[2] + t * (r_b[0] * r_a[6] + r_b[1] * r_a[7] + r_b[2] * r_a[8]),
            h[3] + x[1] * y[0] + t * (r_b[3] * r_a[0] + r_b[4] * r_a[1] + r_b[5] * r_a[2]),
            h[4] + x[1] * y[1] + t * (r_b[3] * r_a[3] + r_b[4] * r_a[4] + r_b[5] * r_a[5]),
            h[5] + x[1] * y[2] + t * (r_b[3] * r_a[6] + r_b[4] * r_a[7] + r_b[5] * r_a[8]),
            h[6] + x[2] * y[0] + t * (r_b[6] * r_a[0] + r_b[7] * r_a[1] + r_b[8] * r_a[2]),
            h[7] + x[2] * y[1] + t * (r_b[6] * r_a[3] + r_b[7] * r_a[4] + r_b[8] * r_a[5]),
            h[8] + x[2] * y[2] + t * (r_b[6] * r_a[6] + r_b[7] * r_a[7] + r_b[8] * r_a[8]),
        )
    n = 1.0 / max(count, 1)
    p = (p[0] * n, p[1] * n, p[2] * n)
    g = (g[0] * n, g[1] * n, g[2] * n)
    c = float(count)
    h = (h[0] - c * p[0] * g[0], h[1] - c * p[0] * g[1], h[2] - c * p[0] * g[2], h[3] - c * p[1] * g[0],
         h[4] - c * p[1] * g[1], h[5] - c * p[1] * g[2], h[6] - c * p[2] * g[0], h[7] - c * p[2] * g[1],
         h[8] - c * p[2] * g[2])  # fmt: skip
    p = (p[0] + first[0], p[1] + first[1], p[2] + first[2])
    return count, p, (g[0] + aim[0], g[1] + aim[1], g[2] + aim[2]), h


@routine
def fit_base(loops, ask):
    """Move a free base so that the frames that tasks hold are nearest to where they shall be, as
    the other joints are.

    Least is the sum of squares of distances and, by the characteristic length, of rotation matrices
    (Kabsch, 1976). Soft tasks count where no hard one holds a frame.
    """
    plan = loops.plan
    q = loops.q
    row = loops.plan[L.BASE_ROW]
    if plan[L.BASE_TIE] < 0:
        return
    row_poses(loops.ints, loops.floats, q, 0, loops.scratch)
    count, p, g, h = spread_of(loops, ask, row + 3, True)
    if count == 0:
        count, p, g, h = spread_of(loops, ask, row + 3, False)
    if count == 0:
        return
    w, x, y, z = rotation_for(h)
    a, b, c = placement(loops.poses, OUTPUT_FLOATS * (row + 3))
    sine = math.sqrt(x * x + y * y + z * z)
    f = 2.0 * math.atan2(sine, w) / max(sine, 1e-300)
    turn = back(matrix(a, b, c), f * x, f * y, f * z)  # in axes of the base
    turn_ball(q, loops.ints[HEADER + ROW_INTS * (row + 3) + Q_INDEX], turn[0], turn[1], turn[2])
    o = (entry(a, 3) - p[0], entry(b, 3) - p[1], entry(c, 3) - p[2])
    u = (2.0 * (y * o[2] - z * o[1]), 2.0 * (z * o[0] - x * o[2]), 2.0 * (x * o[1] - y * o[0]))
    d = (
        g[0] - p[0] + w * u[0] + y * u[2] - z * u[1],
        g[1] - p[1] + w * u[1] + z * u[0] - x * u[2],
        g[2] - p[2] + w * u[2] + x * u[1] - y * u[0],
    )
    for i in range(row, row + 3):
        a, b, c = placement(loops.poses, OUTPUT_FLOATS * i)
        at = loops.ints[HEADER + ROW_INTS * i + Q_INDEX]
        v = loops.ints[HEADER + ROW_INTS * i + V_INDEX]
        x = (
            q[at]
            + (entry(a, 2) * d[0] + entry(b, 2) * d[1] + entry(c, 2) * d[2])
            / loops.floats[ROW_FLOATS * i + MULTIPLIER]
        )
        q[at] = min(max(x, number(loops, 1, v)), number(loops, 2, v))
