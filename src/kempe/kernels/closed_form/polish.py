"""Damped Newton steps on the product of exponentials, which make candidates exact and tell how
exact they are.

Damping: Levenberg (1944). A step counts only if it brings the tip nearer, so a candidate that is
exact stays as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    append_motion,
    cross,
    read_translation,
    read_vector,
    rotate_vector,
    subtract_vectors,
    transform_point,
    unrotate_vector,
    write_identity,
    write_vector,
)
from kempe.kernels.base.rotations import compute_rotation_vector
from kempe.kernels.base.scratch import advance_pointer
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
    """Pointers to a chain that is polished. `moves`: the unknown joints; `rows`: which of the six
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
def count_model_scratch(n):
    """Return the number of floats of scratch for a chain of n joints."""
    return AT_AXES + 6 * n + 6 * n + n * n + 3 * n


@routine
def place_axes(m, theta):
    """Write axes, points and the pose of the tip at the joint values theta to the scratch."""
    g = advance_pointer(m.scratch, AT_POSE)
    axes = advance_pointer(m.scratch, AT_AXES)
    write_identity(g)
    for i in range(m.n):
        h = read_vector(m.lines, LINE_STRIDE * i)
        o = read_vector(m.lines, LINE_STRIDE * i + 4)
        write_vector(axes, 6 * i, rotate_vector(g, h))
        write_vector(axes, 6 * i + 3, transform_point(g, o))
        slides = m.kinds[i] == SLIDE
        append_motion(
            g,
            h,
            o,
            slides,
            theta[i],
            1.0 if slides else math.cos(theta[i]),
            0.0 if slides else math.sin(theta[i]),
        )
    here = advance_pointer(m.scratch, AT_HERE)
    p = transform_point(g, read_translation(m.tip))
    for j in range(3):
        column = rotate_vector(g, (m.tip[j], m.tip[4 + j], m.tip[8 + j]))
        here[j] = column[0]
        here[4 + j] = column[1]
        here[8 + j] = column[2]
    here[3] = p[0]
    here[7] = p[1]
    here[11] = p[2]


@routine
def compute_error(m, theta):
    """Compute the (linear, angular) distance of the tip from the target; the six errors are left in
    the scratch.
    """
    place_axes(m, theta)
    here = advance_pointer(m.scratch, AT_HERE)
    e = advance_pointer(m.scratch, AT_ERROR)
    t = m.target
    rows = m.rows
    linear = unrotate_vector(here, subtract_vectors(read_translation(t), read_translation(here)))
    x = unrotate_vector(here, (t[0], t[4], t[8]))
    y = unrotate_vector(here, (t[1], t[5], t[9]))
    z = unrotate_vector(here, (t[2], t[6], t[10]))
    if rows[5] != 0.0:
        angular = compute_rotation_vector((x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]))
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
def write_columns(m):
    """Write the columns of the Jacobian of the unknowns, six numbers each in the frame of the tip;
    return the number of unknowns.
    """
    axes = advance_pointer(m.scratch, AT_AXES)
    here = advance_pointer(m.scratch, AT_HERE)
    jacobian = advance_pointer(m.scratch, AT_AXES + 6 * m.n)
    p = read_translation(here)
    count = 0
    for i in range(m.n):
        if m.moves[i] == 0:
            continue
        w = read_vector(axes, 6 * i)
        turn = (0.0, 0.0, 0.0)
        if m.kinds[i] == SLIDE:
            move = unrotate_vector(here, w)
        else:
            move = unrotate_vector(
                here, cross(w, subtract_vectors(p, read_vector(axes, 6 * i + 3)))
            )
            turn = unrotate_vector(here, w)
        for k in range(3):
            jacobian[6 * count + k] = m.rows[k] * move[k]
            jacobian[6 * count + 3 + k] = m.rows[3 + k] * turn[k]
        count += 1
    return count


@routine
def solve_normal_equations(m, n, damping):
    """Solve the damped normal equations for the step, left in the scratch; return whether they
    could be solved.
    """
    e = advance_pointer(m.scratch, AT_ERROR)
    jacobian = advance_pointer(m.scratch, AT_AXES + 6 * m.n)
    matrix = advance_pointer(m.scratch, AT_AXES + 12 * m.n)
    right = advance_pointer(matrix, m.n * m.n)
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
    if not factor_matrix(matrix, n):
        return False
    substitute_back(matrix, n, right)
    return True


@routine
def polish_solution(m, theta):
    """Take damped steps, and replace theta by the best values found; return their (linear, angular)
    errors.
    """
    linear, angular = compute_error(m, theta)
    best = math.sqrt(linear * linear + angular * angular)
    step = advance_pointer(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    kept = advance_pointer(m.scratch, AT_AXES + 13 * m.n + m.n * m.n)
    more = 1.0
    for _ in range(STEPS):
        if best <= EXACT:
            break
        n = write_columns(m)
        if not solve_normal_equations(m, n, more * (FLOOR + DAMPING * min(best * best, 1.0))):
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
        new_linear, new_angular = compute_error(m, theta)
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
        compute_error(m, theta)
        if best < 1e-12 or more >= 1e12:
            break
        more = max(1e3 * more, 1e3)
    return linear, angular


@routine
def compute_orthogonal_step(m, n, along):
    """Compute the undamped step by an orthogonal factorization, left in the scratch; return whether
    it exists. The Jacobian is overwritten.

    There is none for want of rank. Gram-Schmidt's method, modified, the longest column first: the
    normal equations would square what is small. With `along` it is not the step to the target, but
    one that moves the tip least.
    """
    e = advance_pointer(m.scratch, AT_ERROR)
    jacobian = advance_pointer(m.scratch, AT_AXES + 6 * m.n)
    r = advance_pointer(m.scratch, AT_AXES + 12 * m.n)
    step = advance_pointer(r, m.n * m.n)
    order = advance_pointer(r, m.n * m.n + m.n)
    first = 0.0
    for i in range(n):
        order[i] = float(i)
    for k in range(n):
        longest = -1.0
        place = k
        for i in range(k, n):
            size = compute_dot_product(jacobian, 6 * int(order[i]), jacobian, 6 * int(order[i]))
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
            f = compute_dot_product(jacobian, pivot, jacobian, column) / longest
            r[n * int(order[k]) + int(order[i])] = f
            for j in range(6):
                jacobian[column + j] -= f * jacobian[pivot + j]
        f = compute_dot_product(jacobian, pivot, e, 0) / longest
        step[int(order[k])] = (1.0 if k == n - 1 else 0.0) if along else f
        for j in range(6):
            e[j] -= f * jacobian[pivot + j]
    for back_ in range(n):
        k = n - 1 - back_
        for i in range(k + 1, n):
            step[int(order[k])] -= r[n * int(order[k]) + int(order[i])] * step[int(order[i])]
    return True


@device
def compute_dot_product(a, i, b, j):
    """Return the scalar product of the six numbers at a[i:] and at b[j:]."""
    return (
        a[i] * b[j]
        + a[i + 1] * b[j + 1]
        + a[i + 2] * b[j + 2]
        + a[i + 3] * b[j + 3]
        + (a[i + 4] * b[j + 4] + a[i + 5] * b[j + 5])
    )


@routine
def sharpen_solution(m, theta):
    """Take undamped steps until IDLE of them do not improve, and replace theta by the nearest
    values; return their (linear, angular) errors.

    For a theta that is polished but close to where roots meet: there it is off by the square root
    of its error. Near a curve of solutions too, along which the root may be far. On the way a step
    may bring the tip farther away: damped steps make that good, which lead back to the curve or
    valley but hardly along it.
    """
    step = advance_pointer(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    kept = advance_pointer(m.scratch, AT_AXES + 14 * m.n + m.n * m.n)
    linear, angular = compute_error(m, theta)
    least = math.hypot(linear, angular)
    idle = 0
    for i in range(m.n):
        kept[i] = theta[i]
    for _ in range(STEPS):
        n = write_columns(m)
        k = 0
        size = 0.0
        if not compute_orthogonal_step(m, n, False):
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
        linear, angular = compute_error(m, theta)
        if math.hypot(linear, angular) > least:
            linear, angular = polish_solution(m, theta)
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
    return compute_error(m, theta)


@routine
def find_tangent(m, out):
    """Write the unit vector of joint velocities (n) that moves the tip least, after `place_axes`;
    return whether it exists.
    """
    n = write_columns(m)
    k = 0
    square = 0.0
    if not compute_orthogonal_step(m, n, True):
        return False
    step = advance_pointer(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    for i in range(n):
        square += step[i] * step[i]
    for i in range(m.n):
        out[i] = 0.0
        if m.moves[i] != 0:
            out[i] = step[k] / math.sqrt(square)
            k += 1
    return True


@routine
def find_smallest_pivot(m):
    """Return the smallest pivot of the normal equations, an upper bound of the smallest singular
    value squared.

    The tip has to have been placed before, which `polish_solution` does.
    """
    n = write_columns(m)
    if n == 0 or not solve_normal_equations(m, n, 1e-30):
        return 0.0
    matrix = advance_pointer(m.scratch, AT_AXES + 12 * m.n)
    least = math.inf
    for i in range(n):
        least = min(least, matrix[i * n + i])
    return least
