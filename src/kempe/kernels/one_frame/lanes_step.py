"""A damped step of the starts in `lanes`, inside the limits, and the choice of the configurations
that are kept.
"""

from __future__ import annotations

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.linear import solve_definite_six
from kempe.kernels.base.lines import add_scaled, dot
from kempe.kernels.base.masks import pack_mask
from kempe.kernels.base.vectors import LANES, load_lanes, select_where, spread_lanes, store_value
from kempe.kernels.one_frame.descent import ENOUGH
from kempe.kernels.one_frame.lanes import (
    BEST,
    COUNT,
    FOUND,
    FREE,
    KEPT,
    POINTING,
    STALL,
    STEP,
    WHOLE,
    U,
    combine_vectors,
    compute_dot_product,
    compute_lane_errors,
    compute_normal_lanes,
    load_column,
    locate_lane_coordinate,
    recompute_normal_lanes,
    select_greater,
    select_smaller,
    trace_lanes,
)

DAMPING = 0.05
DAMPING_FLOOR = 1e-10
DAMPING_CAP = 0.3
"""Damping: DAMPING * E, at most DAMPING_CAP, plus DAMPING_FLOOR. Factors of 0.02 to 0.3 do equally
well."""

NEAR = 1e-14
"""Energy from which one step leads to rounding error, seldom two."""

PATIENCE = 3
SLOW = 0.7
"""A start is given up after PATIENCE steps that do not lower the energy below SLOW of the least
before.

Towards a goal it falls to a quarter or less, as a rule even where the chain is singular. To wait
for steps without any decrease costs a fifth more work, a third at the limits."""


@device
def project_across(c, x):
    """Return the component of x perpendicular to the unit vector c."""
    return add_scaled(x, -dot(c, x), c)


@device
def select_task_part(s, e, c):
    """Return the part of six numbers that the task reads; c: the tips' z axes."""
    w = s.weights
    if s.task == WHOLE:
        return e
    v = project_across(c, (e[3], e[4], e[5])) if s.task == POINTING else (e[3], e[4], e[5])
    return w[0] * e[0], w[1] * e[1], w[2] * e[2], w[3] * v[0], w[4] * v[1], w[5] * v[2]


@device
def weigh_triangle(w, m):
    """Return W M W for a lower triangle M and W = diag(w)."""
    return (
        w[0] * m[0],
        w[1] * (w[0] * m[1]), w[1] * m[2],
        w[2] * (w[0] * m[3]), w[2] * (w[1] * m[4]), w[2] * m[5],
        w[3] * (w[0] * m[6]), w[3] * (w[1] * m[7]), w[3] * (w[2] * m[8]), w[3] * m[9],
        w[4] * (w[0] * m[10]), w[4] * (w[1] * m[11]), w[4] * (w[2] * m[12]), w[4] * (w[3] * m[13]), w[4] * m[14],
        w[5] * (w[0] * m[15]), w[5] * (w[1] * m[16]), w[5] * (w[2] * m[17]), w[5] * (w[3] * m[18]),
        w[5] * (w[4] * m[19]), w[5] * m[20],
    )  # fmt: skip


@device
def project_triangle(c, m):
    """Return the lower triangle with P = 1 - c c^T applied to its angular rows and columns, and c
    c^T added.

    What is added keeps the matrix regular, and takes no part: errors have no component along c.
    """
    x = project_across(c, (m[6], m[10], m[15]))
    y = project_across(c, (m[7], m[11], m[16]))
    z = project_across(c, (m[8], m[12], m[17]))
    h = (
        m[9] * c[0] + m[13] * c[1] + m[18] * c[2],
        m[13] * c[0] + m[14] * c[1] + m[19] * c[2],
        m[18] * c[0] + m[19] * c[1] + m[20] * c[2],
    )
    h = combine_vectors(0.5 * (dot(c, h) + 1.0), c, -1.0, h)
    return (
        m[0], m[1], m[2], m[3], m[4], m[5],
        x[0], y[0], z[0],
        m[9] + 2.0 * (h[0] * c[0]),
        x[1], y[1], z[1], m[13] + (h[1] * c[0] + c[1] * h[0]), m[14] + 2.0 * (h[1] * c[1]),
        x[2], y[2], z[2], m[18] + (h[2] * c[0] + c[2] * h[0]), m[19] + (h[2] * c[1] + c[2] * h[1]),
        m[20] + 2.0 * (h[2] * c[2]),
    )  # fmt: skip


@device
def solve_damped_lanes(s, m, c, damping, e):
    """Return (A + damping)^-1 e, where A is the part of the lower triangle m that the task reads."""
    if s.task == POINTING:
        m = project_triangle(c, m)
    if s.task != WHOLE:
        m = weigh_triangle(s.weights, m)
    d = damping
    damped = (
        m[0] + d, m[1], m[2] + d, m[3], m[4], m[5] + d, m[6], m[7], m[8], m[9] + d,
        m[10], m[11], m[12], m[13], m[14] + d, m[15], m[16], m[17], m[18], m[19], m[20] + d,
    )  # fmt: skip
    return solve_definite_six(damped, e)


@routine
def write_first_steps(s, y):
    """Write the steps; return 1 in lanes where a limit stopped a coordinate, and how far the
    stopped coordinates move the tip.

    D J^T y, cut off at the limits; those that were stopped there leave D.
    """
    lanes = s.lanes
    limits = s.limits
    o = spread_lanes(0.0)
    a = o
    d0 = o
    d1 = o
    d2 = o
    d3 = o
    d4 = o
    d5 = o
    for v in range(s.nv):
        at = locate_lane_coordinate(s, v)
        x = load_column(lanes, at)
        u = load_lanes(lanes, (at + U) * LANES)
        free = load_lanes(lanes, (at + FREE) * LANES)
        wish = free * compute_dot_product(x, y)
        step = select_smaller(select_greater(wish, limits[2 * v] - u), limits[2 * v + 1] - u)
        step = select_where(free > 0.5, step, o)
        stopped = select_where(step == wish, o, 1.0)
        store_value(lanes, (at + STEP) * LANES, step)
        store_value(lanes, (at + FREE) * LANES, free - stopped)
        a = a + stopped
        step = stopped * step
        d0 = d0 + step * x[0]
        d1 = d1 + step * x[1]
        d2 = d2 + step * x[2]
        d3 = d3 + step * x[3]
        d4 = d4 + step * x[4]
        d5 = d5 + step * x[5]
    return a, (d0, d1, d2, d3, d4, d5)


@routine
def write_second_steps(s, y, again):
    """Write the steps of the coordinates that D marks, in lanes where `again` is not zero."""
    lanes = s.lanes
    for v in range(s.nv):
        at = locate_lane_coordinate(s, v)
        wish = compute_dot_product(load_column(lanes, at), y)
        old = load_lanes(lanes, (at + STEP) * LANES)
        new = select_where(load_lanes(lanes, (at + FREE) * LANES) > 0.5, wish, old)
        store_value(lanes, (at + STEP) * LANES, select_where(again > 0.5, new, old))


@device
def advance_lanes(s):
    """Move the coordinates by their steps, never out of the limits."""
    lanes = s.lanes
    limits = s.limits
    for v in range(s.nv):
        at = locate_lane_coordinate(s, v)
        u = load_lanes(lanes, (at + U) * LANES) + load_lanes(lanes, (at + STEP) * LANES)
        store_value(
            lanes,
            (at + U) * LANES,
            select_smaller(select_greater(u, limits[2 * v]), limits[2 * v + 1]),
        )


@device
def keep_better_configurations(s, e, limit, linear, angular):
    """Keep the configurations that lowered the energy; return the lanes that are done or nearly so,
    as bits, and the energy.

    limit: steps at most; linear, angular: squares of the tolerances, in the lanes' units.
    """
    lanes = s.lanes
    far = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    off = e[3] * e[3] + e[4] * e[4] + e[5] * e[5]
    energy = 0.5 * (far + off)
    best = load_lanes(lanes, BEST * LANES)
    stall = load_lanes(lanes, STALL * LANES)
    count = load_lanes(lanes, COUNT * LANES)
    found = load_lanes(lanes, FOUND * LANES)
    better = best > energy
    best, stall = (
        select_where(better, energy, best),
        select_where(SLOW * best > energy, 0.0, stall + 1.0),
    )
    within = select_where(far > linear, 0.0, select_where(off > angular, 0.0, spread_lanes(1.0)))
    found = select_where(better, select_greater(found, within), found)
    over = select_where(
        stall > select_where(found > 0.5, 0.5, PATIENCE - 0.5), 1.0, spread_lanes(0.0)
    )
    over = select_where(ENOUGH > best, 1.0, select_where(count > limit - 0.5, 1.0, over))
    over = select_where(
        NEAR > best, select_where(found > 0.5, select_where(found > 1.5, over, 1.0), over), over
    )
    store_value(lanes, BEST * LANES, best)
    store_value(lanes, STALL * LANES, stall)
    store_value(lanes, COUNT * LANES, select_where(over > 0.5, count, count + 1.0))
    store_value(lanes, FOUND * LANES, found)
    for v in range(s.nv):
        at = locate_lane_coordinate(s, v)
        u = load_lanes(lanes, (at + U) * LANES)
        kept = load_lanes(lanes, (at + KEPT) * LANES)
        store_value(lanes, (at + KEPT) * LANES, select_where(better, u, kept))
    return pack_mask(over > 0.5), energy


@routine
def step_lanes(s, limit, linear, angular):
    """Move all lanes by a step; return as bits the lanes that are done: at the goal, out of steps,
    without hope, or, once, NEAR.

    The step is that of `step.compute_damped_step`.
    """
    a, b, c, p = trace_lanes(s)
    e = compute_lane_errors(s, a, b, c, p)
    done, energy = keep_better_configurations(s, e, limit, linear, angular)
    damping = select_smaller(DAMPING * energy, spread_lanes(DAMPING_CAP)) + DAMPING_FLOOR
    again, moved = write_first_steps(
        s, solve_damped_lanes(s, compute_normal_lanes(s, e, p), c, damping, e)
    )
    if pack_mask(again > 0.5) != 0:
        d = select_task_part(s, moved, c)
        e = (e[0] - d[0], e[1] - d[1], e[2] - d[2], e[3] - d[3], e[4] - d[4], e[5] - d[5])
        write_second_steps(
            s, solve_damped_lanes(s, recompute_normal_lanes(s), c, damping, e), again
        )
    advance_lanes(s)
    return done
