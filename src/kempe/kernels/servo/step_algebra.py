"""Small dense problems of one step of velocities: singular values, eigenvalues, least squares in a
box.

Matrices lie row by row. `work` is scratch that no caller keeps anything in.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import routine
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.servo.step_constants import INWARD, NOISE, SLACK

SWEEPS = 20
"""Rounds of rotations at most; four to six are usual."""
ORTHOGONAL = 1e-15
"""Cosine between two rows that counts as a right angle."""
NOTHING = 1e-14
"""Length of a row, as a part of the longest, that is rounding."""


@routine
def multiply_rows(a, x, m, n, out):
    """Write A x (m,) for a matrix A (m, n)."""
    for i in range(m):
        total = 0.0
        for j in range(n):
            total += a[i * n + j] * x[j]
        out[i] = total


@routine
def multiply_columns(a, y, m, n, out):
    """Write A^T y (n,) for a matrix A (m, n)."""
    for j in range(n):
        out[j] = 0.0
    for i in range(m):
        for j in range(n):
            out[j] += a[i * n + j] * y[i]


@routine
def compute_dot(a, b, n):
    """Return the inner product of two vectors (n,)."""
    total = 0.0
    for i in range(n):
        total += a[i] * b[i]
    return total


@routine
def _turn_rows(a, p, q, n, c, s):
    """Turn rows p and q of a matrix with n columns in their plane."""
    for k in range(n):
        x = a[p * n + k]
        y = a[q * n + k]
        a[p * n + k] = c * x - s * y
        a[q * n + k] = s * x + c * y


@routine
def _swap_rows(a, p, q, n):
    for k in range(n):
        x = a[p * n + k]
        a[p * n + k] = a[q * n + k]
        a[q * n + k] = x


@routine
def compute_singular_values(a, m, n, u, s, v, work):
    """Write A (m, n) = U diag(s) V^T: U^T (m, m), s (m,) in descending order, V^T (n, n).

    Rows of A are turned until they are orthogonal (Hestenes 1958); V^T is completed to a basis.
    work: m n numbers.
    """
    for i in range(m * n):
        work[i] = a[i]
    for i in range(m * m):
        u[i] = 0.0
    for i in range(m):
        u[i * m + i] = 1.0
        row = advance_pointer(work, i * n)
        s[i] = compute_dot(row, row, n)
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(m):
            largest = max(largest, s[i])
        done = True
        for p in range(m - 1):
            for q in range(p + 1, m):
                first = s[p]
                second = s[q]
                if min(first, second) <= NOTHING * NOTHING * largest:
                    continue
                both = compute_dot(advance_pointer(work, p * n), advance_pointer(work, q * n), n)
                if abs(both) <= ORTHOGONAL * math.sqrt(first * second):
                    continue
                done = False
                zeta = 0.5 * (second - first) / both
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + t * t)
                _turn_rows(work, p, q, n, c, c * t)
                _turn_rows(u, p, q, m, c, c * t)
                s[p] = first - t * both
                s[q] = second + t * both
        for i in range(m):
            row = advance_pointer(work, i * n)
            s[i] = compute_dot(row, row, n)
        if done:
            break
    for i in range(m):
        best = i
        for j in range(i + 1, m):
            if s[j] > s[best]:
                best = j
        if best != i:
            x = s[i]
            s[i] = s[best]
            s[best] = x
            _swap_rows(work, i, best, n)
            _swap_rows(u, i, best, m)
        s[i] = math.sqrt(s[i])
    rank = 0
    while rank < min(m, n) and s[rank] > NOTHING * s[0]:
        for k in range(n):
            v[rank * n + k] = work[rank * n + k] / s[rank]
        rank += 1
    complete_basis(v, rank, n)


@routine
def complete_basis(v, rank, n):
    """Complete `rank` orthonormal rows of V (n, n) to a basis."""
    for i in range(rank, n):
        best = 0
        least = 2.0
        for j in range(n):
            used = 0.0
            for k in range(i):
                used += v[k * n + j] * v[k * n + j]
            if used < least:
                least = used
                best = j
        row = advance_pointer(v, i * n)
        for j in range(n):
            row[j] = 0.0
        row[best] = 1.0
        for _ in range(2):
            for k in range(i):
                other = advance_pointer(v, k * n)
                part = compute_dot(row, other, n)
                for j in range(n):
                    row[j] -= part * other[j]
        size = math.sqrt(compute_dot(row, row, n))
        for j in range(n):
            row[j] /= size


@routine
def compute_eigenvectors(h, n, values, v, work):
    """Write the eigenvalues (n,) of a symmetric matrix, ascending, and its eigenvectors, the rows
    of V (n, n), by Jacobi's rotations.

    work: n n numbers.
    """
    size = 0.0
    for i in range(n * n):
        work[i] = h[i]
        v[i] = 0.0
        size = max(size, abs(h[i]))
    for i in range(n):
        v[i * n + i] = 1.0
    for _ in range(SWEEPS):
        done = True
        for p in range(n - 1):
            for q in range(p + 1, n):
                off = work[p * n + q]
                if not abs(off) > 1e-17 * size:
                    continue
                done = False
                zeta = 0.5 * (work[q * n + q] - work[p * n + p]) / off
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = c * t
                for k in range(n):
                    x = work[k * n + p]
                    y = work[k * n + q]
                    work[k * n + p] = c * x - s * y
                    work[k * n + q] = s * x + c * y
                _turn_rows(work, p, q, n, c, s)
                _turn_rows(v, p, q, n, c, s)
                work[p * n + q] = 0.0
                work[q * n + p] = 0.0
        if done:
            break
    for i in range(n):
        values[i] = work[i * n + i]
    for i in range(n):
        best = i
        for j in range(i + 1, n):
            if values[j] < values[best]:
                best = j
        if best != i:
            x = values[i]
            values[i] = values[best]
            values[best] = x
            _swap_rows(v, i, best, n)


@routine
def solve_free_entries(h, n, free, right, out, work):
    """Solve H x = right for the entries of x that are `free`; all others are zero.

    H is positive on them, up to rounding. work: n n + 2 n numbers.
    """
    index = advance_pointer(work, n * n)
    b = advance_pointer(index, n)
    count = 0
    largest = 0.0
    for i in range(n):
        out[i] = 0.0
        if free[i] != 0.0:
            index[count] = float(i)
            count += 1
            largest = max(largest, abs(h[i * n + i]))
    more = 0.0
    for _ in range(SWEEPS):
        for i in range(count):
            row = int(index[i]) * n
            for j in range(i + 1):
                work[i * count + j] = h[row + int(index[j])]
            work[i * count + i] += more
            b[i] = right[int(index[i])]
        if factor_matrix(work, count):
            substitute_back(work, count, b)
            for i in range(count):
                out[int(index[i])] = b[i]
            return
        more = max(10.0 * more, 1e-15 * largest)


@routine
def minimize_quadratic_in_box(h, push, n, low, high, z, free, work):
    """Write the z (n,) in a box that minimises z H z / 2 - push z, for a positive H, and which
    entries are at no bound, by an active set.

    work: n n + 4 n numbers.
    """
    step = advance_pointer(work, n * n + 2 * n)
    slope = advance_pointer(step, n)
    for i in range(n):
        free[i] = 1.0
    solve_free_entries(h, n, free, push, z, work)
    whole = True
    size = 0.0
    for i in range(n):
        size = max(size, abs(push[i]))
        if not (low[i] < z[i] and z[i] < high[i]):
            free[i] = 0.0
            whole = False
    if whole:
        return
    for i in range(n):
        z[i] = min(max(z[i], low[i]), high[i])
    for _ in range(10 * n):
        multiply_rows(h, z, n, n, slope)
        for i in range(n):
            slope[i] = push[i] - slope[i]
        solve_free_entries(h, n, free, slope, step, work)
        part = math.inf
        which = -1
        for i in range(n):
            ahead = z[i] + step[i]
            if free[i] != 0.0 and (ahead < low[i] or ahead > high[i]):
                room = ((low[i] if step[i] < 0.0 else high[i]) - z[i]) / step[i]
                if room < part:
                    part = room
                    which = i
        if which >= 0:
            for i in range(n):
                z[i] = min(max(z[i] + part * step[i], low[i]), high[i])
            z[which] = low[which] if step[which] < 0.0 else high[which]
            free[which] = 0.0
            continue
        for i in range(n):
            z[i] += step[i]
        multiply_rows(h, z, n, n, slope)
        worst = -1
        most = INWARD * size
        for i in range(n):
            if free[i] != 0.0 or low[i] >= high[i]:
                continue
            pull = push[i] - slope[i]
            if z[i] > low[i]:
                pull = -pull
            if pull > most:
                most = pull
                worst = i
        if worst < 0:
            return
        free[worst] = 1.0


@routine
def find_nearest_point(rows, m, p, goal, low, high, y, work):
    """Write the y (p,) nearest to a goal (p,) with low <= R y <= high, R (m, p), by an active set;
    zero must be within the bounds.

    work: p p + 3 m + 3 p numbers.
    """
    gram = work
    pull = advance_pointer(work, p * p)
    step = advance_pointer(pull, p)
    index = advance_pointer(step, p)
    value = advance_pointer(index, p)
    way = advance_pointer(value, m)
    held = advance_pointer(way, m)
    size = 1.0
    for j in range(p):
        y[j] = 0.0
        size = max(size, abs(goal[j]))
    for i in range(m):
        held[i] = 0.0
    for _ in range(10 * m + 10):
        count = 0
        for i in range(m):
            if held[i] != 0.0 and count < p:
                index[count] = float(i)
                count += 1
        for j in range(p):
            step[j] = goal[j] - y[j]
        for a in range(count):
            row = advance_pointer(rows, int(index[a]) * p)
            pull[a] = compute_dot(row, step, p)
            for b in range(a + 1):
                gram[a * count + b] = compute_dot(row, advance_pointer(rows, int(index[b]) * p), p)
            gram[a * count + a] *= 1.0 + NOTHING
        if not factor_matrix(gram, count):
            return
        substitute_back(gram, count, pull)
        for a in range(count):
            row = int(index[a]) * p
            for j in range(p):
                step[j] -= pull[a] * rows[row + j]
        if count == p:
            for j in range(p):
                step[j] = 0.0
        multiply_rows(rows, y, m, p, value)
        multiply_rows(rows, step, m, p, way)
        slack = SLACK * max(1.0, compute_largest_size(way, m))
        part = math.inf
        which = -1
        for i in range(m):
            if held[i] != 0.0:
                continue
            ahead = value[i] + way[i]
            if way[i] < 0.0 and ahead < low[i] - slack:
                room = (low[i] - value[i]) / way[i]
            elif way[i] > 0.0 and ahead > high[i] + slack:
                room = (high[i] - value[i]) / way[i]
            else:
                continue
            if room < part:
                part = room
                which = i
        if which >= 0:
            part = min(max(part, 0.0), 1.0)
            for j in range(p):
                y[j] += part * step[j]
            held[which] = 1.0
            continue
        for j in range(p):
            y[j] += step[j]
        worst = -1
        most = INWARD * size
        for a in range(count):
            i = int(index[a])
            value[i] = compute_dot(advance_pointer(rows, i * p), y, p)
            # the goal pulls along the row: inwards at the lower bound, where it is positive
            inwards = pull[a] if value[i] - low[i] <= high[i] - value[i] else -pull[a]
            if low[i] < high[i] and inwards > most:
                most = inwards
                worst = i
        if worst < 0:
            return
        held[worst] = 0.0


@routine
def compute_largest_size(x, n):
    """Return the largest absolute value of numbers (n,)."""
    size = 0.0
    for i in range(n):
        size = max(size, abs(x[i]))
    return size


@routine
def symmetrize_matrix(h, n):
    """Replace a matrix (n, n) by the mean of itself and its transpose."""
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (h[i * n + j] + h[j * n + i])
            h[i * n + j] = mean
            h[j * n + i] = mean


@routine
def is_inside(x, low, high, n):
    """Return whether numbers (n,) are within their bounds."""
    for i in range(n):
        if not (x[i] >= low[i] and x[i] <= high[i]):
            return False
    return True


@routine
def compute_feasible_fraction(x, low, high, n):
    """Return the largest fraction of x (n,), at most 1, that is within bounds; rounding counts as
    zero.
    """
    size = compute_largest_size(x, n)
    part = 1.0
    for i in range(n):
        if abs(x[i]) > NOISE * size:
            part = min(part, (high[i] if x[i] > 0.0 else low[i]) / x[i])
    return max(0.0, part)
