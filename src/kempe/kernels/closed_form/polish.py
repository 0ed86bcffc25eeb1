"""Candidates made exact on the chain itself, and judged: damped Newton steps on the product of
exponentials.

Damping: Levenberg (1944). A step counts only if it brings the tip nearer, so a candidate that is
exact stays as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.linear import back, factor
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    cross,
    follow,
    identity,
    mapped,
    minus,
    rotated,
    three,
    translation,
    unrotated,
    write3,
)
from kempe.kernels.base.rotations import logarithm
from kempe.kernels.base.scratch import beyond
from kempe.kernels.forward.table_layout import SLIDE

STEPS = 40
IDLE = 10
EXACT = 3e-15
LONGEST = 0.5
"""Steps at most; those in a row that bring nothing; the error at which nothing is left to do; the
longest step."""

LEAST = 1e-26
NOISE = 1e-14
SHORTEST = 1e-4
"""Square of the smallest singular value, over that of the largest, below which there is no undamped
step; the error from which one may be long, and how long it may be below that: there rounding is no
reason to go far."""

FLOOR = 1e-15
DAMPING = 1e-3
"""Damping of the normal equations: FLOOR + DAMPING times the square of the error."""


class Model(NamedTuple):
    """A chain to be polished; pointers. `moves`: joints that are unknown; `rows`: which of the six
    errors count.

    Rows are [linear; angular] in the frame of the tip; with rows 3 and 4 but not 5, the direction
    of its z axis counts.
    """

    kinds: object
    lines: object
    moves: object
    tip: object
    rows: object
    target: object
    scratch: object
    n: int


AT_POSE = 0
AT_HERE = 12
AT_ERROR = 24
AT_AXES = 30
"""Places in a model's scratch: the pose on the way, that of the tip, the error, axes and points of
the joints."""


@device
def model_scratch(n):
    """Numbers of scratch for a chain of n joints: axes, Jacobian, equations, right side, order,
    kept variables.
    """
    return AT_AXES + 6 * n + 6 * n + n * n + 3 * n


@routine
def place(m, theta):
    """Write axes, points and the pose of the tip at theta to the scratch."""
    g = beyond(m.scratch, AT_POSE)
    axes = beyond(m.scratch, AT_AXES)
    identity(g)
    for i in range(m.n):
        h = three(m.lines, LINE_STRIDE * i)
        o = three(m.lines, LINE_STRIDE * i + 4)
        write3(axes, 6 * i, rotated(g, h))
        write3(axes, 6 * i + 3, mapped(g, o))
        slides = m.kinds[i] == SLIDE
        follow(
            g,
            h,
            o,
            slides,
            theta[i],
            1.0 if slides else math.cos(theta[i]),
            0.0 if slides else math.sin(theta[i]),
        )
    here = beyond(m.scratch, AT_HERE)
    p = mapped(g, translation(m.tip))
    for j in range(3):
        column = rotated(g, (m.tip[j], m.tip[4 + j], m.tip[8 + j]))
        here[j] = column[0]
        here[4 + j] = column[1]
        here[8 + j] = column[2]
    here[3] = p[0]
    here[7] = p[1]
    here[11] = p[2]


@routine
def error_at(m, theta):
    """(linear, angular): how far the tip is from the target; the six errors are left in the
    scratch.
    """
    place(m, theta)
    here = beyond(m.scratch, AT_HERE)
    e = beyond(m.scratch, AT_ERROR)
    t = m.target
    rows = m.rows
    linear = unrotated(here, minus(translation(t), translation(here)))
    x = unrotated(here, (t[0], t[4], t[8]))
    y = unrotated(here, (t[1], t[5], t[9]))
    z = unrotated(here, (t[2], t[6], t[10]))
    if rows[5] != 0.0:
        angular = logarithm((x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]))
    else:
        sine = math.hypot(z[0], z[1])
        f = math.atan2(sine, z[2]) / sine if sine > 1e-300 else (0.0 if z[2] > 0.0 else math.pi)
        angular = (-z[1] * f, z[0] * f, 0.0)
        if sine <= 1e-300 and z[2] < 0.0:
            angular = (math.pi, 0.0, 0.0)
    for i in range(3):
        e[i] = rows[i] * linear[i]
        e[3 + i] = rows[3 + i] * angular[i]
    return math.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2), math.sqrt(
        e[3] ** 2 + e[4] ** 2 + e[5] ** 2
    )


@routine
def columns_at(m):
    """Number of unknowns; writes their columns of the Jacobian, rows in the frame of the tip, six
    numbers each.
    """
    axes = beyond(m.scratch, AT_AXES)
    here = beyond(m.scratch, AT_HERE)
    jacobian = beyond(m.scratch, AT_AXES + 6 * m.n)
    p = translation(here)
    count = 0
    for i in range(m.n):
        if m.moves[i] == 0:
            continue
        w = three(axes, 6 * i)
        turn = (0.0, 0.0, 0.0)
        if m.kinds[i] == SLIDE:
            move = unrotated(here, w)
        else:
            move = unrotated(here, cross(w, minus(p, three(axes, 6 * i + 3))))
            turn = unrotated(here, w)
        for k in range(3):
            jacobian[6 * count + k] = m.rows[k] * move[k]
            jacobian[6 * count + 3 + k] = m.rows[3 + k] * turn[k]
        count += 1
    return count


@routine
def normal_equations(m, n, damping):
    """Whether they could be solved; the step of the unknowns is left in the scratch."""
    e = beyond(m.scratch, AT_ERROR)
    jacobian = beyond(m.scratch, AT_AXES + 6 * m.n)
    matrix = beyond(m.scratch, AT_AXES + 12 * m.n)
    right = beyond(matrix, m.n * m.n)
    for i in range(n):
        right[i] = 0.0
        for k in range(6):
            right[i] += jacobian[6 * i + k] * e[k]
        for j in range(i + 1):
            s = 0.0
            for k in range(6):
                s += jacobian[6 * i + k] * jacobian[6 * j + k]
            matrix[i * n + j] = s
        matrix[i * n + i] += damping
    if not factor(matrix, n):
        return False
    back(matrix, n, right)
    return True


@routine
def polish(m, theta):
    """(linear, angular) errors after the steps; theta is replaced by the best found."""
    linear, angular = error_at(m, theta)
    best = math.sqrt(linear * linear + angular * angular)
    step = beyond(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    kept = beyond(m.scratch, AT_AXES + 13 * m.n + m.n * m.n)
    more = 1.0
    for _ in range(STEPS):
        if best <= EXACT:
            break
        n = columns_at(m)
        if not normal_equations(m, n, more * (FLOOR + DAMPING * min(best * best, 1.0))):
            break
        size = 0.0
        for i in range(n):
            size = max(size, abs(step[i]))
        scale = LONGEST / size if size > LONGEST else 1.0
        k = 0
        for i in range(m.n):
            kept[i] = theta[i]
            if m.moves[i] != 0:
                theta[i] += scale * step[k]
                k += 1
        new_linear, new_angular = error_at(m, theta)
        new = math.sqrt(new_linear * new_linear + new_angular * new_angular)
        if new < best:
            slow = new > 0.5 * best
            best = new
            linear = new_linear
            angular = new_angular
            if slow and (best < 1e-12 or more > 1.0):
                break
            more = max(1.0, 0.1 * more)
            continue
        for i in range(m.n):
            theta[i] = kept[i]
        error_at(m, theta)
        if best < 1e-12 or more >= 1e12:
            break
        more = max(1e3 * more, 1e3)
    return linear, angular


@routine
def orthogonal_step(m, n, along):
    """Whether there is one; the undamped step of the unknowns is left in the scratch, the Jacobian
    is lost.

    There is none for want of rank. Gram-Schmidt's method, modified, the longest column first: the
    normal equations would square what is small. With `along` it is not the step to the target, but
    one that moves the tip least.
    """
    e = beyond(m.scratch, AT_ERROR)
    jacobian = beyond(m.scratch, AT_AXES + 6 * m.n)
    r = beyond(m.scratch, AT_AXES + 12 * m.n)
    step = beyond(r, m.n * m.n)
    order = beyond(r, m.n * m.n + m.n)
    first = 0.0
    for i in range(n):
        order[i] = float(i)
    for k in range(n):
        longest = -1.0
        place = k
        for i in range(k, n):
            size = product(jacobian, 6 * int(order[i]), jacobian, 6 * int(order[i]))
            if size > longest:
                longest = size
                place = i
        first = max(first, longest)
        if not longest > (0.0 if along else LEAST * first):
            return False
        order[k], order[place] = order[place], order[k]
        pivot = 6 * int(order[k])
        for i in range(k + 1, n):
            column = 6 * int(order[i])
            f = product(jacobian, pivot, jacobian, column) / longest
            r[n * int(order[k]) + int(order[i])] = f
            for j in range(6):
                jacobian[column + j] -= f * jacobian[pivot + j]
        f = product(jacobian, pivot, e, 0) / longest
        step[int(order[k])] = (1.0 if k == n - 1 else 0.0) if along else f
        for j in range(6):
            e[j] -= f * jacobian[pivot + j]
    for back_ in range(n):
        k = n - 1 - back_
        for i in range(k + 1, n):
            step[int(order[k])] -= r[n * int(order[k]) + int(order[i])] * step[int(order[i])]
    return True


@device
def product(a, i, b, j):
    """The scalar product of six numbers at a[i:] and at b[j:]."""
    return (
        a[i] * b[j]
        + a[i + 1] * b[j + 1]
        + a[i + 2] * b[j + 2]
        + a[i + 3] * b[j + 3]
        + (a[i + 4] * b[j + 4] + a[i + 5] * b[j + 5])
    )


@routine
def sharpen(m, theta):
    """(linear, angular) errors after undamped steps; theta is replaced by the nearest met, given up
    after IDLE steps.

    For a theta that is polished but close to where roots meet: there it is off by the square root
    of its error. Near a curve of solutions too, along which the root may be far. On the way a step
    may bring the tip farther away: damped steps make that good, which lead back to the curve or
    valley but hardly along it.
    """
    step = beyond(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    kept = beyond(m.scratch, AT_AXES + 14 * m.n + m.n * m.n)
    linear, angular = error_at(m, theta)
    least = math.hypot(linear, angular)
    idle = 0
    for i in range(m.n):
        kept[i] = theta[i]
    for _ in range(STEPS):
        n = columns_at(m)
        k = 0
        size = 0.0
        if not orthogonal_step(m, n, False):
            break
        for i in range(n):
            size = max(size, abs(step[i]))
        if not size < math.inf:
            break
        longest = LONGEST if least > NOISE else SHORTEST
        for i in range(m.n):
            if m.moves[i] != 0:
                theta[i] += step[k] * (longest / max(size, longest))
                k += 1
        linear, angular = error_at(m, theta)
        if math.hypot(linear, angular) > least:
            linear, angular = polish(m, theta)
        idle += 1
        if math.hypot(linear, angular) < least:
            least = math.hypot(linear, angular)
            idle = 0
            for i in range(m.n):
                kept[i] = theta[i]
        elif idle == IDLE:
            break
    for i in range(m.n):
        theta[i] = kept[i]
    return error_at(m, theta)


@routine
def tangent(m, out):
    """Whether there is one; writes the unit vector of motion (n) that moves the tip least. It has
    to be placed.
    """
    n = columns_at(m)
    k = 0
    square = 0.0
    if not orthogonal_step(m, n, True):
        return False
    step = beyond(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    for i in range(n):
        square += step[i] * step[i]
    for i in range(m.n):
        out[i] = 0.0
        if m.moves[i] != 0:
            out[i] = step[k] / math.sqrt(square)
            k += 1
    return True


@routine
def weakest(m):
    """The smallest pivot of the normal equations: an upper bound of the square of the smallest
    singular value.

    The tip has to have been placed before, which `polish` does.
    """
    n = columns_at(m)
    if n == 0 or not normal_equations(m, n, 1e-30):
        return 0.0
    matrix = beyond(m.scratch, AT_AXES + 12 * m.n)
    least = math.inf
    for i in range(n):
        least = min(least, matrix[i * n + i])
    return least
