"""Curves along which a chain with one freedom to spare keeps its task.

A point x has the coordinates of the joints that move, slides in lengths of the chain. Equations are
solved, and null vectors found, by Gram-Schmidt of the rows of the Jacobian, the largest row first,
so that rows which depend on others do no harm (Golub, Van Loan, *Matrix Computations*, 2013,
section 5.4).
Source of the steps: Allgower, Georg, *Numerical Continuation Methods*, 1990, chapters 2, 6 and 8.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints.envelope import dot
from kempe.kernels.forward.table_layout import BODY, NV
from kempe.kernels.forward.table_sweep import evaluate_jacobian

ROWS = 7
"""Equations at most: six of the task, and a plane."""

POINTED = 18
"""Place in a goal of the flag that only the direction of the tip's z axis counts."""

CHECKS = 6
"""Places in a step where the sense of the parameter is looked at."""

MOST_STEPS = 4000
"""Steps that a curve may have."""

LANDINGS = 20
BISECTIONS = 45
"""Bisections of a cubic: where a corrector follows, and where the cubic is all there is."""

ROUNDING = 1e-15
"""Distance of two places in a step between which it is not looked again."""

AT_END = 1e-14
"""Difference of a parameter, relative to its size, that is rounding at the end of a curve."""

FLAT = 1e-5
"""Length of a projected unit vector below which another vector is projected: rounding counts."""


class ChainScratch(NamedTuple):
    """Pointers to the chain, its goal and the scratch: configuration, pose, Jacobian, right sides
    and rows of the equations, a point, its tangent, and a plane's normal.
    """

    ints: object
    floats: object
    places: object
    goal: object
    unit: object
    rules: object
    q: object
    pose: object
    columns: object
    right: object
    rows: object
    x: object
    t: object
    across: object
    n: int
    nv: int


@device
def count_scratch(n, nq, nv):
    """Count the numbers of scratch of a chain."""
    return nq + 16 + 6 * nv + ROWS + ROWS * n + 3 * n


@device
def make_scratch(block, ints, floats, places, goal, unit, rules, base, n, nq, nv):
    """Lay the scratch out from the pointer `block` on, with q at `base`."""
    pose = advance_pointer(block, nq)
    columns = advance_pointer(pose, 16)
    right = advance_pointer(columns, 6 * nv)
    rows = advance_pointer(right, ROWS)
    x = advance_pointer(rows, ROWS * n)
    copy_numbers(block, base, 0, nq)
    return ChainScratch(
        ints,
        floats,
        places,
        goal,
        unit,
        rules,
        block,
        pose,
        columns,
        right,
        rows,
        x,
        advance_pointer(x, n),
        advance_pointer(x, 2 * n),
        n,
        nv,
    )


@routine
def evaluate_task(c):
    """Write the missing twist of the tip and its derivatives at x to `right` and `rows`; return the
    largest error, infinite for what is no number.
    """
    n = c.n
    nv = c.nv
    goal = c.goal
    for i in range(n):
        c.q[c.places[i]] = c.x[i] * c.unit[i]
    if evaluate_jacobian(c.ints, c.floats, c.q, 0, BODY, True, c.pose, 0, c.columns, 0):
        return np.inf
    left = c.rows  # rotation from the tip to the target, before the rows are written
    for i in range(3):
        away = 0.0
        for k in range(3):
            away += c.pose[4 * k + i] * (goal[4 * k + 3] - c.pose[4 * k + 3])
        c.right[i] = away
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += c.pose[4 * k + i] * goal[4 * k + j]
            left[3 * i + j] = s
    if goal[POINTED] > 0.0:
        c.right[3] = -left[5]
        c.right[4] = left[2]
        c.right[5] = 0.0
    else:
        scale = 2.0 / max(1.0 + left[0] + left[4] + left[8], 1e-9)
        c.right[3] = scale * (left[7] - left[5])
        c.right[4] = scale * (left[2] - left[6])
        c.right[5] = scale * (left[3] - left[1])
    worst = 0.0
    for r in range(6):
        weight = goal[12 + r]
        c.right[r] *= weight
        worst = max(worst, abs(c.right[r]))
        for i in range(n):
            c.rows[r * n + i] = weight * c.unit[i] * c.columns[r * nv + c.places[n + i]]
    return worst


@routine
def reduce_rows(c, m, most, level):
    """Make the first rows of m equations orthonormal, at most `most` of them; return how many.

    Rows that are smaller than `level` of the largest, without what those before them say, are left
    out.
    """
    n = c.n
    rows = c.rows
    right = c.right
    first = 0.0
    count = 0
    while count < most:
        size = 0.0
        best = count
        for r in range(count, m):
            row = advance_pointer(rows, n * r)
            s = dot(row, row, n)
            if s > size:
                size = s
                best = r
        if count == 0:
            first = size
        if not size > level * level * first:
            break
        own = advance_pointer(rows, n * count)
        other = advance_pointer(rows, n * best)
        if best != count:
            for i in range(n):
                own[i], other[i] = other[i], own[i]
            right[count], right[best] = right[best], right[count]
        for j in range(count):  # once more: what rounding left
            before = advance_pointer(rows, n * j)
            s = dot(own, before, n)
            for i in range(n):
                own[i] -= s * before[i]
            right[count] -= s * right[j]
        s = dot(own, own, n)
        if not s > level * level * first:
            break
        s = 1.0 / math.sqrt(s)
        for i in range(n):
            own[i] *= s
        right[count] *= s
        for r in range(count + 1, m):
            row = advance_pointer(rows, n * r)
            s = dot(row, own, n)
            for i in range(n):
                row[i] -= s * own[i]
            right[r] -= s * right[count]
        count += 1
    return count


@routine
def correct_point(c, tries):
    """Lead x to the curve in the plane through it that is normal to `across`; return the largest
    error, infinite for what is no number. The rows are the Jacobian there.
    """
    n = c.n
    rules = c.rules
    at = dot(c.across, c.x, n)
    for _ in range(tries):
        worst = evaluate_task(c)
        away = at - dot(c.across, c.x, n)
        if max(worst, abs(away)) <= rules[0] or not worst < np.inf:
            return worst
        plane = advance_pointer(c.rows, 6 * n)
        for i in range(n):
            plane[i] = c.across[i]
        c.right[6] = away
        count = reduce_rows(c, ROWS, min(ROWS, n), rules[3])
        size = 0.0
        for i in range(n):
            y = 0.0
            for k in range(count):
                y += c.right[k] * c.rows[n * k + i]
            c.x[i] += y
            size = max(size, abs(y))
        if size <= rules[2]:
            break
    return evaluate_task(c)


@device
def project_vector(c, count, v):
    """Take from v what lies in the first rows, twice for what rounding leaves; return its length."""
    n = c.n
    for _ in range(2):
        for k in range(count):
            row = advance_pointer(c.rows, n * k)
            s = dot(row, v, n)
            for i in range(n):
                v[i] -= s * row[i]
    return math.sqrt(dot(v, v, n))


@routine
def find_tangent(c, toward):
    """Write the unit null vector of the rows that is nearest to the vector `toward` to `t`."""
    n = c.n
    count = reduce_rows(c, 6, min(6, n - 1), c.rules[4])
    copy_numbers(c.t, toward, 0, n)
    length = math.sqrt(dot(toward, toward, n))
    size = project_vector(c, count, c.t)
    sense = 1.0
    if not size > FLAT * length:  # almost normal to the curve: the unit vector that is nearest
        least = np.inf
        best = 0
        for i in range(n):
            s = 0.0
            for k in range(count):
                s += c.rows[n * k + i] * c.rows[n * k + i]
            if s < least:
                least = s
                best = i
        for i in range(n):
            c.t[i] = 0.0
        c.t[best] = 1.0
        size = project_vector(c, count, c.t)
        if dot(c.t, toward, n) < 0.0:
            sense = -1.0
    for i in range(n):
        c.t[i] *= sense / size


@kernel(
    I("_"),
    F("_"),
    I(2, "n"),
    F(19),
    F("n"),
    F("nq"),
    F(10),
    F("N", "n"),
    INT,
    OUT("N", "n"),
    OUT("N", "n"),
    OUT("N"),
    returns=False,
)
def correct_points(
    ints, floats, places, goal, unit, base, rules, across, tries, out_x, out_t, error
):
    """Lead points out_x to their curves, in planes normal to `across`; write tangents and errors.

    ints, floats: the table of the chain. places: places in q and in v of the joints that move.
    goal: rows of the target (3, 4), weights of the six errors, whether only the z axis points. unit:
    units of the coordinates. base: the configuration of joints that rest. rules: the largest error
    of a point that is corrected no further, and of one that is held; the size of the last step of a
    correction; the level of equations that depend on others, and the same for tangents; the longest
    step; the largest correction as a part of the step; the largest angle between tangents, and the
    one that steps aim at; the shortest step. Tangents are those nearest to `across`.
    """
    n = out_x.shape[1]
    nq = base.shape[0]
    nv = ints[NV]
    block = np.empty(count_scratch(n, nq, nv))
    c = make_scratch(
        get_pointer(block),
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(places),
        get_pointer(goal),
        get_pointer(unit),
        get_pointer(rules),
        get_pointer(base),
        n,
        nq,
        nv,
    )
    normals = get_pointer(across)
    points = get_pointer(out_x)
    tangents = get_pointer(out_t)
    for k in range(out_x.shape[0]):
        copy_numbers(c.x, points, n * k, n)
        copy_numbers(c.across, normals, n * k, n)
        error[k] = correct_point(c, tries)
        if error[k] < np.inf:
            find_tangent(c, c.across)
        else:
            for i in range(n):
                c.x[i] = np.nan
                c.t[i] = np.nan
        copy_numbers(advance_pointer(points, n * k), c.x, 0, n)
        copy_numbers(advance_pointer(tangents, n * k), c.t, 0, n)
    keep_alive(block)


# ---- steps


class StepEnds(NamedTuple):
    """Pointers to points and tangents at both ends of a step, and to its length."""

    a: Any
    u: Any
    b: Any
    v: Any
    size: Any


@device
def evaluate_cubic(x0, d0, x1, d1, s):
    """Return the cubic at s between 0, where it is x0 with the derivative d0, and 1."""
    r = 1.0 - s
    return x0 + s * s * (3.0 - 2.0 * s) * (x1 - x0) + (s * r * r * d0 - s * s * r * d1)


@device
def estimate_coordinate(e, i, s):
    """Return coordinate i at the fraction s of a step, by a cubic."""
    size = e.size[0]
    return evaluate_cubic(e.a[i], size * e.u[i], e.b[i], size * e.v[i], s)


@device
def measure_distance(a, b, n):
    """Return the distance of two points."""
    s = 0.0
    for i in range(n):
        s += (a[i] - b[i]) * (a[i] - b[i])
    return math.sqrt(s)


@device
def measure_gap(a, b, period, n):
    """Return the largest difference of the coordinates of two points, the short way."""
    gap = 0.0
    for i in range(n):
        d = b[i] - a[i]
        if abs(d) > 0.5 * period[i]:
            d -= period[i] * round(d / period[i])
        gap = max(gap, abs(d))
    return gap


@device
def measure_bend(u, v, n):
    """Return the angle between two unit tangents."""
    return 2.0 * math.asin(min(1.0, 0.5 * measure_distance(u, v, n)))


@routine
def visit_step(c, e, s, p):
    """Write point and tangent of the curve at the fraction s of a step; return the tangent's part
    along coordinate p.
    """
    n = c.n
    for i in range(n):
        c.across[i] = (e.b[i] - e.a[i]) / e.size[0]
        c.x[i] = estimate_coordinate(e, i, s)
    if not correct_point(c, 8) < np.inf:
        return np.nan
    find_tangent(c, e.u)
    return c.t[p]


@routine
def find_turn(c, e, p, b, fb, a, fa):
    """Find where coordinate p turns back between fractions b and a of a step, with rates of
    different signs; see `kempe.numerics.roots.find_sign_change`.
    """
    if fa == 0.0 or fb == 0.0:
        return b if fb == 0.0 else a
    part = 0.5
    while True:
        x = a + part * (b - a)
        fx = visit_step(c, e, x, p)
        if (fx > 0.0) == (fa > 0.0):
            far = a
            f_far = fa
        else:
            far = b
            f_far = fb
            b = a
            fb = fa
        a = x
        fa = fx
        best = a
        least = fa
        if not abs(fa) < abs(fb):
            best = b
            least = fb
        if a == b or fx != fx:
            return best
        margin = ROUNDING * (1.0 + 2.0 * abs(best)) / abs(b - a)
        if least == 0.0 or margin > 0.5:
            return best
        xi = (a - b) / (far - b)
        phi = (fa - fb) / (f_far - fb)
        part = 0.5
        if phi * phi < xi and (1.0 - phi) * (1.0 - phi) < 1.0 - xi:
            part = fa / (fb - fa) * f_far / (fb - f_far)
            part += (far - a) / (b - a) * fa / (f_far - fa) * fb / (f_far - fb)
        part = min(max(part, margin), 1.0 - margin)


@routine
def land_on_value(c, e, p, value):
    """Find the point of a step where coordinate p has a value; return whether it was found.

    The point and its tangent are left in x and t.
    """
    n = c.n
    low = 1e-9
    high = 1.0
    first = estimate_coordinate(e, p, low) < value
    if first == (e.b[p] < value):
        return False
    for _ in range(LANDINGS):
        s = 0.5 * (low + high)
        if (estimate_coordinate(e, p, s) < value) == first:
            low = s
        else:
            high = s
    s = 0.5 * (low + high)
    for i in range(n):
        c.x[i] = estimate_coordinate(e, i, s)
        c.across[i] = 0.0
    c.x[p] = value
    c.across[p] = 1.0
    worst = correct_point(c, 8)
    if not worst < c.rules[1]:
        return False
    d = 0.0
    for i in range(n):
        guess = value if i == p else estimate_coordinate(e, i, s)
        d += (c.x[i] - guess) * (c.x[i] - guess)
    if not math.sqrt(d) <= c.rules[6] * e.size[0]:
        return False
    find_tangent(c, e.u)
    return True


@device
def estimate_rate(e, p, s):
    """Return a multiple of the rate of coordinate p at the fraction s of a step."""
    r = 1.0 - s
    return 6.0 * s * r * (e.b[p] - e.a[p]) + e.size[0] * (
        r * (1.0 - 3.0 * s) * e.u[p] - s * (2.0 - 3.0 * s) * e.v[p]
    )


@routine
def write_folds(c, e, p, out_x, out_t, fold, count):
    """Append the points of a step where coordinate p turns back; return the number of points."""
    n = c.n
    last = CHECKS - 1
    turns = False
    before = e.u[p] > 0.0
    for k in range(1, CHECKS):
        rate = e.v[p] if k == last else estimate_rate(e, p, k / last)
        after = rate > 0.0
        turns |= after != before
        before = after
    if not turns:
        return count
    # the cubic says that there is one; the curve itself says where
    rate = e.u[p]
    for k in range(1, CHECKS):
        s = k / last
        following = e.v[p] if k == last else visit_step(c, e, s, p)
        if (following > 0.0) != (rate > 0.0):
            at = find_turn(c, e, p, (k - 1) / last, rate, s, following)
            if 0.0 < at < 1.0 and count < out_x.shape[0]:
                visit_step(c, e, at, p)
                for i in range(n):
                    out_x[count, i] = c.x[i]
                    out_t[count, i] = c.t[i]
                fold[count] = 1
                count += 1
        rate = following
    return count


@kernel(
    I("_"),
    F("_"),
    I(2, "n"),
    F(19),
    F("n"),
    F("nq"),
    F(10),
    F("N", "n"),
    F("N", "n"),
    F("N", 2),
    INT,
    F("n"),
    FLOAT,
    OUT("K", "n"),
    OUT("K", "n"),
    OUTI("K"),
    OUTI("N"),
)
def follow_curves(
    ints,
    floats,
    places,
    goal,
    unit,
    base,
    rules,
    x,
    t,
    bounds,
    p,
    period,
    same,
    out_x,
    out_t,
    fold,
    last,
):
    """Follow curves from points x along tangents t until coordinate p leaves its bounds; return
    the number of curves that there was room for.

    The first arguments are those of `correct_points`. period: of each coordinate, or infinite; a
    curve that leads back to another start, nearer than `same`, is followed from one of the two only,
    the other one has no points. Written are the points and tangents of one curve after the other,
    whether p turns back there, and the place after the last point of each curve. The last point is
    on one of the bounds; where the curve has no tangent, or is too long, between them.
    """
    n = x.shape[1]
    nq = base.shape[0]
    nv = ints[NV]
    size = count_scratch(n, nq, nv)
    block = np.empty(size + 4 * n + 1)
    c = make_scratch(
        get_pointer(block),
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(places),
        get_pointer(goal),
        get_pointer(unit),
        get_pointer(rules),
        get_pointer(base),
        n,
        nq,
        nv,
    )
    a = advance_pointer(get_pointer(block), size)
    u = advance_pointer(a, n)
    b = advance_pointer(a, 2 * n)
    v = advance_pointer(a, 3 * n)
    e = StepEnds(a, u, b, v, advance_pointer(a, 4 * n))
    points = get_pointer(x)
    tangents = get_pointer(t)
    room = out_x.shape[0]
    count = 0
    for k in range(x.shape[0]):
        last[k] = 0
    for k in range(x.shape[0]):
        if last[k] < 0:  # followed from its other end
            last[k] = count
            continue
        if count >= room:
            keep_alive(block)
            return k
        copy_numbers(a, points, n * k, n)
        copy_numbers(u, tangents, n * k, n)
        for i in range(n):
            out_x[count, i] = a[i]
            out_t[count, i] = u[i]
        fold[count] = 0
        count += 1
        h = rules[5]
        for _ in range(MOST_STEPS):
            for i in range(n):
                c.x[i] = a[i] + h * u[i]
                c.across[i] = u[i]
            good = correct_point(c, 8) < rules[1]
            bend = 0.0
            done = False
            if good:
                d = 0.0
                for i in range(n):
                    b[i] = c.x[i]
                    d += (b[i] - a[i] - h * u[i]) * (b[i] - a[i] - h * u[i])
                    c.across[i] = b[i] - a[i]
                good = math.sqrt(d) <= rules[6] * h
            if good:
                find_tangent(c, c.across)
                copy_numbers(v, c.t, 0, n)
                bend = measure_bend(u, v, n)
                good = bend <= rules[7]
            if good and not bounds[k, 0] <= b[p] <= bounds[k, 1]:
                e.size[0] = measure_distance(a, b, n)
                good = land_on_value(c, e, p, bounds[k, 0] if b[p] < bounds[k, 0] else bounds[k, 1])
                done = good
                if good:
                    copy_numbers(b, c.x, 0, n)
                    copy_numbers(v, c.t, 0, n)
            if good:
                e.size[0] = measure_distance(a, b, n)
                if e.size[0] > 0.0:
                    count = write_folds(c, e, p, out_x, out_t, fold, count)
                if count >= room:
                    keep_alive(block)
                    return k
                for i in range(n):
                    out_x[count, i] = b[i]
                    out_t[count, i] = v[i]
                fold[count] = 0
                count += 1
                copy_numbers(a, b, 0, n)
                copy_numbers(u, v, 0, n)
                h = min(rules[5], h * min(1.5, max(0.5, rules[8] / max(bend, 1e-9))))
            else:
                h *= 0.5
            if done or h < rules[9]:
                break
        last[k] = count
        if abs(a[p] - x[k, p]) < 0.5 * (bounds[k, 1] - bounds[k, 0]):
            for other in range(k + 1, x.shape[0]):
                if measure_gap(a, advance_pointer(points, n * other), period, n) < same:
                    last[other] = -1
    keep_alive(block)
    return x.shape[0]


# ---- solutions at many values of the parameter


@kernel(F("N", "n"), F("N", "n"), I("_"), F("n"), F(3), OUTI("N"), returns=False)
def join_levels(x, t, first, period, rules, up):
    """Join points of neighbouring levels that only fit to each other.

    The points first[i] to first[i + 1] are those of level i. period: of each coordinate, or
    infinite. rules: how far a step may be from the mean of the tangents at its ends as a part of its
    length, the cosine of the largest angle between tangents, and the longest step. up: the point
    of the next level that is joined to each, else -1; those of the first to the last level but one
    are written.
    """
    n = x.shape[1]
    way = np.empty(n)
    met = np.zeros(x.shape[0], dtype=np.int64)
    longest = rules[2] * rules[2]
    for level in range(first.shape[0] - 2):
        for i in range(first[level], first[level + 1]):
            found = 0
            up[i] = -1
            for j in range(first[level + 1], first[level + 2]):
                size = 0.0
                for k in range(n):
                    d = x[j, k] - x[i, k]
                    if abs(d) > 0.5 * period[k]:
                        d -= period[k] * round(d / period[k])
                    way[k] = d
                    size += d * d
                    if size >= longest:
                        break
                if not size < longest:
                    continue
                size = math.sqrt(size)
                off = 0.0
                cosine = 0.0
                for k in range(n):
                    d = way[k] - 0.5 * size * (t[i, k] + t[j, k])
                    off += d * d
                    cosine += t[i, k] * t[j, k]
                if math.sqrt(off) <= rules[0] * size and cosine >= rules[1]:
                    found += 1
                    met[j] += 1
                    up[i] = j
            if found != 1:
                up[i] = -1
        for i in range(first[level], first[level + 1]):
            if up[i] >= 0 and met[up[i]] != 1:
                up[i] = -1


@kernel(F("M", "n"), I("_"), F("n"), I("N"), F("N", "n"), FLOAT, OUTI("N"), returns=False)
def find_nodes(x, first, period, level, ends, same, found):
    """Find the point of a level that is nearest to each end, if it is nearer than `same`, else -1.

    The points first[i] to first[i + 1] are those of level i.
    """
    n = x.shape[1]
    points = get_pointer(x)
    others = get_pointer(ends)
    for k in range(ends.shape[0]):
        least = same
        found[k] = -1
        for i in range(first[level[k]], first[level[k] + 1]):
            gap = measure_gap(
                advance_pointer(others, n * k), advance_pointer(points, n * i), period, n
            )
            if gap < least:
                least = gap
                found[k] = i


@kernel(I("N"), OUTI("N"), OUTI("N"))
def list_chains(up, order, last):
    """List the points of chains, each led on by `up` until that is -1; return their number.

    Written are the points of one chain after the other, and the place after the last of each.
    """
    below = np.zeros(up.shape[0], dtype=np.int64)
    for i in range(up.shape[0]):
        if up[i] >= 0:
            below[up[i]] = 1
    place = 0
    count = 0
    for i in range(up.shape[0]):
        if below[i]:
            continue
        k = i
        while k >= 0:
            order[place] = k
            place += 1
            k = up[k]
        last[count] = place
        count += 1
    return count


@kernel(
    I("_"),
    F("_"),
    I(2, "n"),
    F(19),
    F("n"),
    F("nq"),
    F(10),
    F("K", "n"),
    F("K", "n"),
    I("A"),
    I("A"),
    INT,
    F("N"),
    I("N"),
    OUT("N", "n"),
    OUTI("N"),
    returns=False,
)
def find_points(
    ints,
    floats,
    places,
    goal,
    unit,
    base,
    rules,
    x,
    t,
    first,
    last,
    p,
    values,
    curve,
    out,
    there,
):
    """Find the points of curves at values of coordinate p, which rises along them, and which exist.

    The first arguments are those of `correct_points`. x, t: nodes and tangents; those of curve i are
    first[i] to last[i]. curve: the number of the curve for each value. Where a curve has none, the
    point is NaN.
    """
    n = x.shape[1]
    nq = base.shape[0]
    nv = ints[NV]
    size = count_scratch(n, nq, nv)
    block = np.empty(size + 1)
    c = make_scratch(
        get_pointer(block),
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(places),
        get_pointer(goal),
        get_pointer(unit),
        get_pointer(rules),
        get_pointer(base),
        n,
        nq,
        nv,
    )
    length = advance_pointer(get_pointer(block), size)
    points = get_pointer(x)
    tangents = get_pointer(t)
    for k in range(values.shape[0]):
        i = first[curve[k]]
        j = last[curve[k]]
        value = min(max(values[k], x[i, p]), x[j, p])
        slack = AT_END * (1.0 + abs(values[k]))
        there[k] = int(abs(value - values[k]) <= slack)
        # folds, where the corrector has nothing to hold on to
        end = j if abs(value - x[j, p]) <= slack else i
        if not there[k] or abs(value - x[end, p]) <= slack:
            for m in range(n):
                out[k, m] = x[end, m] if there[k] else np.nan
            continue
        while j - i > 1:
            middle = (i + j) // 2
            if x[middle, p] <= value:
                i = middle
            else:
                j = middle
        a = advance_pointer(points, n * i)
        b = advance_pointer(points, n * j)
        length[0] = measure_distance(a, b, n)
        e = StepEnds(
            a, advance_pointer(tangents, n * i), b, advance_pointer(tangents, n * j), length
        )
        low = 0.0
        high = 1.0
        for _ in range(BISECTIONS):
            s = 0.5 * (low + high)
            if estimate_coordinate(e, p, s) < value:
                low = s
            else:
                high = s
        s = 0.5 * (low + high)
        for m in range(n):
            c.x[m] = value if m == p else estimate_coordinate(e, m, s)
            c.across[m] = 0.0
            c.t[m] = c.x[m]
        c.across[p] = 1.0
        good = correct_point(c, 8) < rules[1]
        good = good and measure_distance(c.x, c.t, n) < 0.5 * length[0] + 1e-6
        there[k] = int(good)
        for m in range(n):
            out[k, m] = c.x[m] if good else np.nan
    keep_alive(block)


@kernel(F("N", "n"), F("N", "n"), I("_"), F(2, "n"), F("n"), INT, OUTI("M", 2), OUT("M", 4))
def find_crossings(x, t, steps, limits, period, p, out, places):
    """Find where cubics through nodes pass limits of coordinates other than p; return the number of
    places, which are written as far as there is room.

    steps: the numbers of the nodes that another one of the same curve follows. Written are the step
    and the coordinate, and the level, in some turn, with the fraction of the step at which it is
    passed and two fractions around it between which the cubic passes it once.
    """
    n = x.shape[1]
    ends = np.empty(1)
    size_ = get_pointer(ends)
    points = get_pointer(x)
    tangents = get_pointer(t)
    count = 0
    for row in range(steps.shape[0]):
        k = steps[row]
        a = advance_pointer(points, n * k)
        b = advance_pointer(points, n * (k + 1))
        size_[0] = measure_distance(a, b, n)
        e = StepEnds(
            a,
            advance_pointer(tangents, n * k),
            b,
            advance_pointer(tangents, n * (k + 1)),
            size_,
        )
        for j in range(n):
            if j == p:
                continue
            for side in range(2):
                limit = limits[side, j]
                if not abs(limit) < np.inf or (side == 1 and limit == limits[0, j]):
                    continue
                turn = period[j] if period[j] < np.inf else 1e30
                lap = math.floor((a[j] - limit) / turn)
                for i in range(1, CHECKS):
                    s = i / (CHECKS - 1)
                    here = b[j] if i == CHECKS - 1 else estimate_coordinate(e, j, s)
                    following = math.floor((here - limit) / turn)
                    if following != lap:
                        if count < out.shape[0]:
                            level = limit + turn * max(lap, following)
                            low = (i - 1) / (CHECKS - 1)
                            high = s
                            rising = following > lap
                            for _ in range(BISECTIONS):
                                middle = 0.5 * (low + high)
                                if (estimate_coordinate(e, j, middle) < level) == rising:
                                    low = middle
                                else:
                                    high = middle
                            out[count, 0] = k
                            out[count, 1] = j
                            places[count, 0] = level
                            places[count, 1] = 0.5 * (low + high)
                            places[count, 2] = (i - 1) / (CHECKS - 1)
                            places[count, 3] = s
                        count += 1
                    lap = following
    keep_alive(ends)
    return count
