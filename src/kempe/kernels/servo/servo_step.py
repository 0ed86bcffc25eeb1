"""One step of a frame that its own chain moves, for a twist or towards a pose.

A step is of second order wherever the first order does not halve the error. A step of least
squares takes what is missing for something that the joints can make good. Where they cannot, at
the border of the workspace, at limits or by far, the error stays, and with it the second
derivative of the chain that such a step lacks: it overshoots, and the next one shoots back. So
there the error's own Hessian counts (Newton), in the box of what the limits allow, and a step is
taken where it lowers the error as promised. What cannot be had is then left by speeds that go to
zero, at a local minimum of the error. It is measured as `ik` does, in radians and characteristic
lengths.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLAG, FLOAT, OUT, F, I
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.rotations import compute_rotation_vector
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.forward.bound import advance_integer_pointer
from kempe.kernels.forward.table_layout import WORLD_ALIGNED
from kempe.kernels.forward.table_sweep import evaluate_jacobian, evaluate_pose
from kempe.kernels.servo.joint_step import (
    advance_configuration,
    compute_slow_fraction,
    compute_velocity_bounds,
    is_any_fast,
    is_turning_back,
    mark_limited,
    take_step,
)
from kempe.kernels.servo.servo_layout import (
    ANSWER,
    BAD_CONFIGURATION,
    BAD_MOTION,
    BALLS,
    FLOATS,
    FRACTION,
    HEAD,
    METRIC,
    NEAR,
    PLAIN,
    TWIST,
    WRONG_SHAPE,
)
from kempe.kernels.servo.step_algebra import (
    compute_dot,
    compute_eigenvectors,
    compute_feasible_fraction,
    compute_largest_size,
    compute_singular_values,
    find_nearest_point,
    is_inside,
    minimize_quadratic_in_box,
    multiply_columns,
    multiply_rows,
    solve_free_entries,
    symmetrize_matrix,
)
from kempe.kernels.servo.step_constants import (
    ASIDE,
    AWAY,
    BENT,
    BLIND,
    DIFFERENCE,
    FLAT,
    LARGEST,
    LEADS,
    LITTLE,
    LITTLE_USE,
    MUCH_USE,
    NO_PART,
    NOISE,
    NULL_SPEED,
    REACHED,
    ROUNDING,
    SADDLE,
    SHIFT,
    SHORTER,
    SLOW,
    STILL,
    TAKEN,
    TRIALS,
    WALL,
)

ROWS = 6
SKEW = 1e-5
"""Sum of what a rotation's product with its transpose may miss."""
GENERIC = 1e-6
"""Singular values, as parts of the largest, that count as zero."""
ZERO = 1e-26
"""Square of the error that counts as zero: 1e-13 of a length."""
RESIDUAL = 0.5
"""Damping as a part of the error (Levenberg and Marquardt; Sugihara, 2011)."""
ENOUGH_GAIN = 0.75
LITTLE_GAIN = 0.25
"""Decreases of the error, as parts of what a straight way would give, from which a step of first
order counts alone, and up to which one of second order does; between them they are mixed."""
STRICT = 0.5
"""Part of the promised decrease that must be had where a direction is kept."""
LEAST_PROMISE = 1e-28
"""Promised decrease below which one rests, however small the error is."""
HALVINGS = 6
"""Halvings of a step in a direction that is kept."""


class Servo(NamedTuple):
    """A frame's chain, what is wanted, and scratch; all fields but the numbers are pointers.

    `fastest`, `unit`, `lower` and `upper` have one entry for each velocity, in the chain's order.
    """

    ints: object
    floats: object
    q_of: object
    """Coordinate of each velocity in the chain's q; -1 for those of quaternions."""
    ball_q: object
    ball_v: object
    lower: object
    upper: object
    unit: object
    scale: object
    """Ones: velocities are as they are."""
    fastest: object
    goal: object
    """A twist (6,), or a pose (4, 4)."""
    weights: object
    metric: object
    nq: int
    n: int
    balls: int
    posed: bool
    weighted: bool
    even: bool
    """Whether the logarithm's own derivative leaves the gradient alone."""
    plain: bool
    """Whether each velocity moves one row of the table, a turn or a slide, in their order."""
    kept: bool
    """Whether the direction is kept."""
    dt: float
    damping: float
    near: float
    # scratch
    wished: object
    """U^T (6, 6), singular values and their damping, V^T (n, n)."""
    rows: object
    """The weighted Jacobian A (6, n) and right side b (6,)."""
    vectors: object
    """Vectors (n,)."""
    matrices: object
    """Matrices (n, n): Hessian, model, eigenvectors, two more."""
    ends: object
    """Configurations on both sides, their poses and Jacobians, and the difference (6, n)."""
    work: object


class Move(NamedTuple):
    """Velocities (n,) of a chain at a configuration, their box, the Jacobian (6, n), the pose, the
    twist that is wanted, and the error's rows; all are pointers.
    """

    velocity: object
    low: object
    high: object
    jacobian: object
    twist: object
    pose: object
    error: object
    missing: object
    """The error (6,), and weighted by the metric."""
    slopes: object
    """Derivatives A (6, n) of the weighted error, by coordinates in their units."""


VECTORS = 24
MATRICES = 5


@device
def count_move_numbers(n):
    """Count the numbers of a `Move`."""
    return 3 * n + 12 * n + 16 + 3 * ROWS


@device
def make_move(block, n):
    """Make a `Move` in a block of scratch."""
    low = advance_pointer(block, n)
    high = advance_pointer(low, n)
    jacobian = advance_pointer(high, n)
    slopes = advance_pointer(jacobian, ROWS * n)
    pose = advance_pointer(slopes, ROWS * n)
    twist = advance_pointer(pose, 16)
    error = advance_pointer(twist, ROWS)
    missing = advance_pointer(error, ROWS)
    return Move(block, low, high, jacobian, twist, pose, error, missing, slopes)


# ---- configurations near by


@routine
def compute_pose_error(goal, pose, e):
    """Write the error (6,) of a pose: position, rotation vector, in ground axes."""
    for i in range(3):
        e[i] = goal[4 * i + 3] - pose[4 * i + 3]
    e[3], e[4], e[5] = compute_rotation_vector(
        (
            goal[0] * pose[0] + goal[1] * pose[1] + goal[2] * pose[2],
            goal[0] * pose[4] + goal[1] * pose[5] + goal[2] * pose[6],
            goal[0] * pose[8] + goal[1] * pose[9] + goal[2] * pose[10],
            goal[4] * pose[0] + goal[5] * pose[1] + goal[6] * pose[2],
            goal[4] * pose[4] + goal[5] * pose[5] + goal[6] * pose[6],
            goal[4] * pose[8] + goal[5] * pose[9] + goal[6] * pose[10],
            goal[8] * pose[0] + goal[9] * pose[1] + goal[10] * pose[2],
            goal[8] * pose[4] + goal[9] * pose[5] + goal[10] * pose[6],
            goal[8] * pose[8] + goal[9] * pose[9] + goal[10] * pose[10],
        )
    )


@routine
def convert_angular_rows(e, jacobian, n, out):
    """Copy a Jacobian (6, n), its angular rows as rates of the rotation vector e[3:] (Bullo and
    Murray 1995).
    """
    square = e[3] * e[3] + e[4] * e[4] + e[5] * e[5]
    angle = math.sqrt(square)
    gamma = 0.5 * angle / math.tan(0.5 * angle) if angle > 1e-3 else 1.0 - square / 12.0
    rest = (1.0 - gamma) / square if angle > 1e-3 else 1.0 / 12.0
    x = 0.5 * e[3]
    y = 0.5 * e[4]
    z = 0.5 * e[5]
    f = 4.0 * rest
    for j in range(n):
        for i in range(3):
            out[i * n + j] = jacobian[i * n + j]
        a = jacobian[3 * n + j]
        b = jacobian[4 * n + j]
        c = jacobian[5 * n + j]
        along = f * (x * a + y * b + z * c)
        out[3 * n + j] = along * x + gamma * a - z * b + y * c
        out[4 * n + j] = along * y + z * a + gamma * b - x * c
        out[5 * n + j] = along * z - y * a + x * b + gamma * c


@routine
def compute_remaining_error(servo, q, velocity):
    """Return the squared error after a step with velocities (n,)."""
    after = servo.ends
    pose = advance_pointer(after, servo.nq)
    e = advance_pointer(pose, 16)
    take_step(servo, q, velocity, after)
    evaluate_pose(servo.ints, servo.floats, after, 0, pose, 0)
    compute_pose_error(servo.goal, pose, e)
    total = 0.0
    for i in range(ROWS):
        total += (servo.metric[i] * e[i]) ** 2
    return total


@device
def locate_difference(servo):
    """Return the pointer to the difference (6, n) that `compute_bend` writes."""
    return advance_pointer(servo.ends, servo.nq + 32 + 2 * ROWS * servo.n)


@routine
def compute_ends(servo, q, way, size):
    """Write poses and Jacobians at q + size way and at q - size way.

    They lie in `ends`, after a configuration: the poses, then the Jacobians.
    """
    there = servo.ends
    poses = advance_pointer(there, servo.nq)
    columns = advance_pointer(poses, 32)
    step = size
    for k in range(2):
        advance_configuration(servo, q, way, step, there)
        evaluate_jacobian(
            servo.ints,
            servo.floats,
            there,
            0,
            WORLD_ALIGNED,
            True,
            poses,
            16 * k,
            columns,
            k * ROWS * servo.n,
        )
        step = -step


@routine
def compute_bend(servo, q, way):
    """Write the derivative (6, n) of the weighted Jacobian along a direction (n,), by a central
    difference, to `locate_difference`.
    """
    n = servo.n
    size = 0.0
    for k in range(n):
        size = max(size, abs(way[k]) / servo.unit[k])
    compute_ends(servo, q, way, DIFFERENCE / size if size > 0.0 else DIFFERENCE)
    columns = advance_pointer(servo.ends, servo.nq + 32)
    out = locate_difference(servo)
    for i in range(ROWS):
        scale = servo.weights[i] * size / (2.0 * DIFFERENCE)
        for j in range(n):
            out[i * n + j] = scale * (columns[i * n + j] - columns[(ROWS + i) * n + j])


# ---- least squares without bounds


@device
def get_singular_values(servo):
    """Return pointers to U^T, the singular values, their damping, and V^T."""
    u = servo.wished
    s = advance_pointer(u, ROWS * ROWS)
    hard = advance_pointer(s, ROWS)
    return u, s, hard, advance_pointer(hard, ROWS)


@routine
def fill_rows(servo, move):
    """Write the weighted equations A (6, n), b (6,) of the twist."""
    n = servo.n
    for i in range(ROWS):
        for j in range(n):
            servo.rows[i * n + j] = servo.weights[i] * move.jacobian[i * n + j]
        servo.rows[ROWS * n + i] = servo.weights[i] * move.twist[i]


@routine
def solve_unbounded_wish(servo, more, x):
    """Write the damped x (n,) that minimises |A x - b| without bounds.

    Directions whose singular values are below `near` are damped (Maciejewski and Klein, 1988);
    `more` damps all.
    """
    n = servo.n
    u, s, hard, v = get_singular_values(servo)
    b = advance_pointer(servo.rows, ROWS * n)
    compute_singular_values(servo.rows, ROWS, n, u, s, v, servo.work)
    for j in range(n):
        x[j] = 0.0
    for i in range(min(ROWS, n)):
        seen = s[i] > ROUNDING * s[0]
        weak = 0.0
        if seen and s[i] < servo.near:
            weak = servo.damping * math.sqrt(max(1.0 - (s[i] / servo.near) ** 2, 0.0))
        hard[i] = math.sqrt(weak * weak + more * more)
        if seen:
            part = s[i] / (s[i] * s[i] + hard[i] * hard[i])
            part *= compute_dot(advance_pointer(u, ROWS * i), b, ROWS)
            for j in range(n):
                x[j] += part * v[i * n + j]


@routine
def solve_regular_wish(servo, more, x):
    """Write the x (n,) of `solve_unbounded_wish` by normal equations where no singular value is
    below `near`; return whether that is so.

    What remains after `near` squared is taken off the normal equations proves it by its factors.
    """
    n = servo.n
    a = servo.rows
    b = advance_pointer(a, ROWS * n)
    m = min(ROWS, n)
    normal = servo.work
    right = advance_pointer(normal, m * m)
    for k in range(2):
        shift = more * more if k else -servo.near * servo.near
        for i in range(m):
            for j in range(i + 1):
                total = shift if i == j else 0.0
                if n >= ROWS:
                    for c in range(n):
                        total += a[i * n + c] * a[j * n + c]
                else:
                    for c in range(ROWS):
                        total += a[c * n + i] * a[c * n + j]
                normal[i * m + j] = total
        if not factor_matrix(normal, m):
            return False
    if n >= ROWS:
        for i in range(ROWS):
            right[i] = b[i]
        substitute_back(normal, ROWS, right)
        multiply_columns(a, right, ROWS, n, x)
    else:
        multiply_columns(a, b, ROWS, n, x)
        substitute_back(normal, n, x)
    return True


@routine
def minimize_damped_residual(servo, x, low, high, out):
    """Write the velocities in the box nearest to the x (n,) of `solve_unbounded_wish`, in the
    metric of the damped equations and of a little of the velocities.
    """
    n = servo.n
    _, _, hard, v = get_singular_values(servo)
    h = servo.matrices
    push = advance_pointer(servo.vectors, 22 * n)
    free = advance_pointer(servo.vectors, 23 * n)
    weak = SHIFT * servo.near
    for i in range(n):
        for j in range(i + 1):
            total = weak * weak if i == j else 0.0
            for k in range(ROWS):
                total += servo.rows[k * n + i] * servo.rows[k * n + j]
            for k in range(min(ROWS, n)):
                if hard[k] > 0.0:  # else V^T may be unset, and zero times what is there not zero
                    total += hard[k] * hard[k] * v[k * n + i] * v[k * n + j]
            h[i * n + j] = total
            h[j * n + i] = total
    multiply_rows(h, x, n, n, push)
    minimize_quadratic_in_box(h, push, n, low, high, out, free, servo.work)


# ---- twists


@routine
def find_bending_direction(servo, q, lead):
    """Write the direction (n,) that reaches to second order what A cannot reach of b; return the
    part of b that is missing, or 0 where there is no such direction.

    The direction is that of the largest curvature towards b among those that move nothing to first
    order.
    """
    n = servo.n
    u, s, _, v = get_singular_values(servo)
    b = advance_pointer(servo.rows, ROWS * n)
    k = min(ROWS, n)
    alive = 0
    while alive < k and s[alive] > GENERIC * s[0]:
        alive += 1
    size = math.sqrt(compute_dot(b, b, ROWS))
    if size == 0.0 or alive == k:
        return 0.0
    rest = locate_difference(servo)
    part = advance_pointer(rest, ROWS * n)
    pull = advance_pointer(part, ROWS)
    for i in range(ROWS):
        part[i] = b[i]
    for a in range(alive):
        along = compute_dot(advance_pointer(u, ROWS * a), b, ROWS)
        for i in range(ROWS):
            part[i] -= along * u[ROWS * a + i]
    force = math.sqrt(compute_dot(part, part, ROWS))
    if force <= BENT * size:
        return 0.0
    dead = n - alive
    curved = servo.matrices
    ways = advance_pointer(curved, n * n)
    values = pull
    for i in range(dead):
        compute_bend(servo, q, advance_pointer(v, (alive + i) * n))
        multiply_columns(rest, part, ROWS, n, pull)
        for j in range(dead):
            curved[i * dead + j] = compute_dot(pull, advance_pointer(v, (alive + j) * n), n) / force
    for i in range(dead):
        for j in range(i):
            curved[j * dead + i] = curved[i * dead + j]
    compute_eigenvectors(curved, dead, values, ways, servo.work)
    if values[dead - 1] <= AWAY:
        return 0.0
    best = advance_pointer(ways, (dead - 1) * dead)
    for j in range(n):
        lead[j] = 0.0
        for i in range(dead):
            lead[j] += best[i] * v[(alive + i) * n + j]
    return force


@routine
def slide_along_limits(servo, q, x, low, high, out):
    """Write the velocities in the box for a twist that may be bent, from the x (n,) without bounds.

    A singular configuration that leads nowhere to first order is left where there is a way.
    """
    n = servo.n
    lead = advance_pointer(servo.vectors, 2 * n)
    force = find_bending_direction(servo, q, lead)
    if force > 0.0:
        far = advance_pointer(servo.vectors, 3 * n)
        for j in range(n):
            far[j] = lead[j] / NOISE
        part = compute_feasible_fraction(far, low, high, n) / NOISE
        if servo.damping > 0.0:
            part = min(force / (2.0 * servo.damping), part)
        for j in range(n):
            x[j] += part * lead[j]
    if is_inside(x, low, high, n):
        for j in range(n):
            out[j] = x[j]
    else:
        minimize_damped_residual(servo, x, low, high, out)


@routine
def add_relieving_motion(servo, y, first, low, high, out):
    """Write y (n,), perhaps shortened, with a self-motion of the rows of V^T from `first` on, so
    that more of y is within bounds.
    """
    n = servo.n
    v = get_singular_values(servo)[3]
    count = 1 + n - first
    rows = servo.matrices
    least = advance_pointer(servo.vectors, 16 * n)
    most = advance_pointer(servo.vectors, 17 * n)
    goal = advance_pointer(servo.vectors, 18 * n)
    z = advance_pointer(goal, n + 1)
    speed = 0.0
    width = 0.0
    for i in range(n):
        speed = max(speed, abs(y[i]))
        if high[i] - low[i] < math.inf:
            width = max(width, high[i] - low[i])
        least[i] = min(low[i], 0.0)
        most[i] = max(high[i], 0.0)
    speed = min(speed, 0.5 * width)
    cost = NULL_SPEED / speed if speed > 0.0 else NULL_SPEED
    for i in range(n):
        rows[i * count] = y[i]
        for k in range(1, count):
            rows[i * count + k] = v[(first + k - 1) * n + i] / cost
    for k in range(count):
        goal[k] = 0.0
    goal[0] = 1.0
    find_nearest_point(rows, n, count, goal, least, most, z, servo.work)
    multiply_rows(rows, z, n, count, out)


@routine
def keep_direction(servo, q, low, high, out):
    """Write velocities with a small norm in the box that keep the direction of b, and give a large
    part of it.

    The part is the largest one, but for a little that self-motions cost. Towards a singular
    configuration it is so small that no singular value, of those that the direction needs, falls by
    more than `WALL` in one cycle: the motion comes to rest there. From a singular configuration the
    motion leaves along a curvature towards b. There a direction is kept to `BENT`. The singular
    values are those of the last `solve_unbounded_wish`.
    """
    n = servo.n
    u, s, _, v = get_singular_values(servo)
    b = advance_pointer(servo.rows, ROWS * n)
    k = min(ROWS, n)
    y = advance_pointer(servo.vectors, 4 * n)
    along = advance_pointer(servo.vectors, 15 * n)
    square = compute_dot(b, b, ROWS)
    size = math.sqrt(square)
    outside = False
    for j in range(n):
        out[j] = min(max(0.0, low[j]), high[j])
        outside = outside or out[j] != 0.0
        y[j] = 0.0
    if size == 0.0 or outside:
        return
    blind = 0.0
    for i in range(k, ROWS):
        blind += compute_dot(advance_pointer(u, ROWS * i), b, ROWS) ** 2
    if math.sqrt(blind) > BENT * size:
        return
    alive = 0
    bends = False
    for i in range(k):
        part = compute_dot(advance_pointer(u, ROWS * i), b, ROWS)
        left = abs(part)
        if s[i] < servo.near:
            left -= BENT * size * (1.0 - min(s[i] / servo.near, 1.0) ** 2)
        if not left > 0.0:
            part = 0.0
        else:
            part = math.copysign(left, part)
        along[i] = part
        if s[i] > GENERIC * s[0]:
            alive += 1
            for j in range(n):
                y[j] += part / s[i] * v[i * n + j]
        elif part != 0.0:
            bends = True
    if bends:
        if find_bending_direction(servo, q, y) == 0.0:
            return
        for j in range(n):
            y[j] /= NOISE
        part = compute_feasible_fraction(y, low, high, n)
        for j in range(n):
            out[j] = part * y[j]
        return
    x = advance_pointer(servo.vectors, 5 * n)
    part = compute_feasible_fraction(y, low, high, n)
    if part < 1.0 and alive < n:
        add_relieving_motion(servo, y, alive, low, high, x)
    else:
        for j in range(n):
            x[j] = part * y[j]
    slower = 1.0
    bent = False
    for i in range(k):
        if not (s[i] < servo.near and along[i] != 0.0):
            continue
        if not bent:
            compute_bend(servo, q, x)
            bent = True
        rest = locate_difference(servo)
        fall = 0.0
        for a in range(ROWS):
            fall += u[ROWS * i + a] * compute_dot(
                advance_pointer(rest, a * n), advance_pointer(v, i * n), n
            )
        fall *= servo.dt
        if fall < -WALL * s[i]:
            slower = min(slower, WALL * s[i] / -fall)
    had = 0.0
    for half in range(0, ROWS, 3):
        first = 0.0
        second = 0.0
        for a in range(half, half + 3):
            first += b[a] * compute_dot(advance_pointer(servo.rows, a * n), x, n)
            if bent:
                bend = advance_pointer(locate_difference(servo), a * n)
                second += b[a] * compute_dot(bend, x, n)
        had += first
        if first > 0.0 and -servo.dt * second > first:  # else the step would lead back
            slower = min(slower, first / (-servo.dt * second))
    if slower * had > NO_PART * square:
        for j in range(n):
            out[j] = slower * x[j]


# ---- towards a pose


@routine
def fill_slopes(servo, move):
    """Write the error, its weighted form, the wanted twist, and the derivatives of the weighted
    error; return the square of the latter.
    """
    n = servo.n
    compute_pose_error(servo.goal, move.pose, move.error)
    if servo.even:
        for i in range(ROWS * n):
            move.slopes[i] = move.jacobian[i]
    else:
        convert_angular_rows(move.error, move.jacobian, n, move.slopes)
    square = 0.0
    for i in range(ROWS):
        move.twist[i] = move.error[i] / servo.dt
        move.missing[i] = servo.metric[i] * move.error[i]
        square += move.missing[i] * move.missing[i]
        for j in range(n):
            move.slopes[i * n + j] *= servo.metric[i] * servo.unit[j]
    return square


@routine
def approach_pose(servo, q, move):
    """Write velocities in the box towards a pose: straight where a direction is kept and leads on,
    and towards the nearest pose; return whether no joint turns back after the step.
    """
    n = servo.n
    square = fill_slopes(servo, move)
    for j in range(n):
        move.velocity[j] = min(max(0.0, move.low[j]), move.high[j])
    if square <= ZERO or n == 0:
        return False
    fill_rows(servo, move)
    if not servo.kept:
        return approach_nearest_pose(servo, q, move, square, move.velocity)
    straight = advance_pointer(servo.vectors, 6 * n)
    solve_unbounded_wish(servo, 0.0, move.velocity)
    keep_direction(servo, q, move.low, move.high, straight)
    shorten_velocity(servo, q, move, square, straight)
    share = compute_progress(servo, move, square, straight)
    if share == 1.0:
        for j in range(n):
            move.velocity[j] = straight[j]
        return False
    calm = approach_nearest_pose(servo, q, move, square, move.velocity)
    for j in range(n):
        move.velocity[j] = share * straight[j] + (1.0 - share) * move.velocity[j]
    return calm


@routine
def shorten_velocity(servo, q, move, square, velocity):
    """Halve velocities (n,) until they lower the error by half of the predicted decrease.

    Zero where that is next to nothing for what the joints move: there the direction leads no
    farther.
    """
    n = servo.n
    size = compute_largest_size(velocity, n)
    slope = 0.0
    moved = 0.0
    z = advance_pointer(servo.vectors, 7 * n)
    for j in range(n):
        if not abs(velocity[j]) > NOISE * size:
            velocity[j] = 0.0
        z[j] = velocity[j] * servo.dt / servo.unit[j]
        moved += z[j] * z[j]
    for i in range(ROWS):
        slope += move.missing[i] * compute_dot(advance_pointer(move.slopes, i * n), z, n)
    slope *= 2.0
    if slope > 2.0 * LITTLE * math.sqrt(square * moved) + LEAST_PROMISE:
        for _ in range(HALVINGS):
            if compute_remaining_error(servo, q, velocity) <= square - STRICT * slope:
                return
            for j in range(n):
                velocity[j] *= 0.5
            slope *= 0.5
    for j in range(n):
        velocity[j] = 0.0


@routine
def compute_progress(servo, move, square, velocity):
    """Return how far straight velocities (n,) in the box lead on, from 0 to 1.

    By the decrease of what is missed for what the joints move, and by how much of the room that the
    box and the rest of the way leave is used: close to a singular configuration it is little.
    """
    n = servo.n
    moved = 0.0
    used = 0.0
    z = advance_pointer(servo.vectors, 7 * n)
    for j in range(n):
        z[j] = velocity[j] / servo.unit[j]
        moved += z[j] * z[j]
        room = move.high[j] if velocity[j] > 0.0 else -move.low[j]
        used = max(used, abs(velocity[j]) / max(room, 1e-300))
    had = 0.0
    for i in range(ROWS):
        had += move.missing[i] * compute_dot(advance_pointer(move.slopes, i * n), z, n)
    had /= servo.dt
    if not had > 0.0:
        return 0.0
    wish = math.sqrt(square) / servo.dt
    gain = had / (wish * math.sqrt(moved))
    used = max(used, had / (wish * wish))
    share = min(1.0, max(0.0, (gain - LITTLE) / (LEADS - LITTLE)))
    return min(share, max(0.0, (used - LITTLE_USE) / (MUCH_USE - LITTLE_USE)))


@routine
def approach_nearest_pose(servo, q, move, square, out):
    """Write velocities in the box that lower the error by any way; return whether no joint turns
    back after the step.

    Limits of speed shorten the step that limits of position leave: so all joints arrive together.
    """
    n = servo.n
    x = advance_pointer(servo.vectors, 8 * n)
    least = advance_pointer(servo.vectors, 9 * n)
    most = advance_pointer(servo.vectors, 10 * n)
    y = advance_pointer(servo.vectors, 11 * n)
    more = RESIDUAL * math.sqrt(square)
    regular = solve_regular_wish(servo, more, x)
    compute_velocity_bounds(servo, q, False, least, most)
    whole = regular and is_inside(x, least, most, n)
    decomposed = not whole
    if decomposed:
        solve_unbounded_wish(servo, more, x)
        whole = is_inside(x, least, most, n)
    if not whole:
        minimize_damped_residual(servo, x, least, most, y)
        for j in range(n):
            x[j] = y[j]
    part = compute_feasible_fraction(x, move.low, move.high, n)
    size = 1e-300
    for j in range(n):
        size = max(size, abs(x[j]) * servo.dt / servo.unit[j])
    part = min(part, LARGEST / size)
    gain = 0.0
    left = square
    if part > 0.0:
        for j in range(n):
            y[j] = part * x[j]
        left = compute_remaining_error(servo, q, y)
        gain = (1.0 - math.sqrt(left / square)) / part
    if gain >= ENOUGH_GAIN:
        for j in range(n):
            out[j] = y[j]
        return regular and whole and part == 1.0 and has_arrived(servo, left)
    if not decomposed:
        solve_unbounded_wish(servo, more, x)
    descend_to_second_order(servo, q, move, square, least, most, y)
    own = compute_feasible_fraction(y, move.low, move.high, n)
    share = max(0.0, (gain - LITTLE_GAIN) / (ENOUGH_GAIN - LITTLE_GAIN))
    for j in range(n):
        out[j] = share * part * x[j] + (1.0 - share) * own * y[j]
    return False


@routine
def has_arrived(servo, left):
    """Return whether the squared error is so small that the next velocities of a regular chain are
    small, too.
    """
    slowest = math.inf
    for j in range(servo.n):
        slowest = min(slowest, servo.fastest[j])
    reach = servo.near * servo.dt * SLOW * slowest
    return not servo.weighted and 2.0 * math.sqrt(left) * max(1.0, 1.0 / servo.metric[0]) <= reach


@routine
def fill_chain_curvature(servo, move, h):
    """Subtract from H (n, n) the weighted error times the chain's second derivatives, from the
    columns of its Jacobian; each of them moves one row of the table, and they are in order.

    The column of a joint turns with the joints before it.
    """
    n = servo.n
    j = move.jacobian
    f = servo.metric[0] * move.missing[0]
    g = servo.metric[1] * move.missing[1]
    k = servo.metric[2] * move.missing[2]
    r = servo.metric[3] * move.missing[3]
    s = servo.metric[4] * move.missing[4]
    t = servo.metric[5] * move.missing[5]
    for a in range(n):
        x = j[3 * n + a]
        y = j[4 * n + a]
        z = j[5 * n + a]
        # force . (w_a x v_b) = v_b . (force x w_a), moment . (w_a x w_b) alike
        fx = g * z - k * y
        fy = k * x - f * z
        fz = f * y - g * x
        rx = s * z - t * y
        ry = t * x - r * z
        rz = r * y - s * x
        for b in range(a, n):
            linear = fx * j[b] + fy * j[n + b] + fz * j[2 * n + b]
            # symmetric: only the later of two turns about the earlier
            angular = 0.5 * (rx * j[3 * n + b] + ry * j[4 * n + b] + rz * j[5 * n + b])
            value = (linear + angular) * servo.unit[a] * servo.unit[b]
            h[a * n + b] -= value
            if a != b:
                h[b * n + a] -= value


@routine
def fill_hessian(servo, q, move, h):
    """Write the Hessian (n, n) of half the squared error, in rad and characteristic lengths.

    Of the chain's second derivatives by differences of its Jacobian, of the logarithm by its own
    derivative (Bullo and Murray, 1995). For unequal weights of turns, by differences of the
    gradient.
    """
    n = servo.n
    way = advance_pointer(servo.vectors, 12 * n)
    pull = advance_pointer(servo.vectors, 13 * n)
    poses = advance_pointer(servo.ends, servo.nq)
    columns = advance_pointer(poses, 32)
    rate = locate_difference(servo)
    e = advance_pointer(rate, ROWS * n)
    for i in range(n):
        way[i] = 0.0
    if servo.even:
        convert_angular_rows(move.error, move.jacobian, n, rate)
        for i in range(ROWS):
            for j in range(n):
                rate[i * n + j] *= servo.metric[i] * servo.unit[j]
        for i in range(n):
            for j in range(n):
                total = 0.0
                for k in range(ROWS):
                    total += move.slopes[k * n + i] * rate[k * n + j]
                h[i * n + j] = total
    if servo.even and servo.plain:
        fill_chain_curvature(servo, move, h)
    for i in range(0 if servo.even and servo.plain else n):
        way[i] = servo.unit[i]
        compute_ends(servo, q, way, DIFFERENCE)
        way[i] = 0.0
        if servo.even:
            for j in range(n):
                force = 0.0
                for k in range(ROWS):
                    force += (
                        servo.metric[k]
                        * move.missing[k]
                        * (columns[k * n + j] - columns[(ROWS + k) * n + j])
                    )
                h[i * n + j] -= force * servo.unit[j] / (2.0 * DIFFERENCE)
            continue
        for j in range(n):
            h[i * n + j] = 0.0
        for side in range(2):
            compute_pose_error(servo.goal, advance_pointer(poses, 16 * side), e)
            convert_angular_rows(e, advance_pointer(columns, side * ROWS * n), n, rate)
            for k in range(ROWS):
                e[k] *= servo.metric[k] * servo.metric[k]
            multiply_columns(rate, e, ROWS, n, pull)
            sign = -1.0 if side == 0 else 1.0
            for j in range(n):
                h[i * n + j] += sign * pull[j] * servo.unit[j] / (2.0 * DIFFERENCE)
    symmetrize_matrix(h, n)


@routine
def compute_promise(h, push, z, n):
    """Return the decrease 2 push z - z H z that a step z (n,) promises."""
    total = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += h[i * n + j] * z[j]
        total += z[i] * (2.0 * push[i] - row)
    return total


@routine
def descend_to_second_order(servo, q, move, square, low, high, out):
    """Write velocities in the box that minimise the error to second order.

    Only velocities that lower the error itself are written.
    """
    n = servo.n
    least = advance_pointer(servo.vectors, 14 * n)
    most = advance_pointer(servo.vectors, 15 * n)
    push = advance_pointer(servo.vectors, 16 * n)
    z = advance_pointer(servo.vectors, 17 * n)
    way = advance_pointer(servo.vectors, 18 * n)
    spare = advance_pointer(servo.vectors, 19 * n)
    h = servo.matrices
    model = advance_pointer(h, n * n)
    _, _, hard, v = get_singular_values(servo)
    fill_hessian(servo, q, move, h)
    multiply_columns(move.slopes, move.missing, ROWS, n, push)
    largest = 0.0
    for i in range(n):
        least[i] = max(low[i] * servo.dt / servo.unit[i], -LARGEST)
        most[i] = min(high[i] * servo.dt / servo.unit[i], LARGEST)
        for j in range(n):
            total = 0.0
            for k in range(min(ROWS, n)):
                total += hard[k] * hard[k] * v[k * n + i] * v[k * n + j]
            model[i * n + j] = h[i * n + j] + total * servo.unit[i] * servo.unit[j]
            largest = max(largest, abs(h[i * n + j]))
    more = 0.0
    for _ in range(TRIALS):
        curvature = take_newton_step(servo, model, push, least, most, z, way)
        for i in range(n):
            strength = 0.0
            for j in range(n):
                strength = max(strength, abs(h[i * n + j]))
            if strength <= FLAT * largest:
                z[i] = 0.0
        promise = compute_promise(h, push, z, n)
        # damping hides where the error itself curves down
        if promise <= BLIND * square:
            curvature = take_newton_step(servo, h, push, least, most, spare, way)
            if curvature < 0.0:
                move_along_direction(z, way, compute_dot(push, way, n), least, most, n)
                promise = compute_promise(h, push, z, n)
        if 0.0 <= promise and promise <= STILL * square + LEAST_PROMISE:
            break
        for i in range(n):
            spare[i] = servo.unit[i] * z[i] / servo.dt
        if (0.0 < promise and promise <= BLIND * square) or (
            compute_remaining_error(servo, q, spare) <= square - TAKEN * promise
        ):
            for i in range(n):
                out[i] = spare[i]
            return
        more = max(4.0 * more, 1e-3 * compute_largest_size(model, n * n))
        for i in range(n):
            model[i * n + i] += more
    for i in range(n):
        out[i] = 0.0


@routine
def is_convex(h, n, work):
    """Return whether the factors of a symmetric matrix prove that its least eigenvalue is above
    `FLAT` times the largest.
    """
    size = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            work[i * n + j] = h[i * n + j]
            total += abs(h[i * n + j])
        size = max(size, total)
    for i in range(n):
        work[i * n + i] -= FLAT * size
    return factor_matrix(work, n)


@routine
def take_newton_step(servo, h, push, low, high, z, way):
    """Write the z (n,) in a box that minimises z H z / 2 - push z, H's curvatures made positive;
    return the least curvature of what is free where it is negative, else 0, and write its
    direction.
    """
    n = servo.n
    v = advance_pointer(servo.matrices, 2 * n * n)
    convex = advance_pointer(v, n * n)
    part = advance_pointer(convex, n * n)
    free = advance_pointer(servo.vectors, 20 * n)
    values = advance_pointer(servo.vectors, 21 * n)
    right = advance_pointer(servo.vectors, 22 * n)
    if is_convex(h, n, servo.work):
        minimize_quadratic_in_box(h, push, n, low, high, z, free, servo.work)
        return 0.0
    compute_eigenvectors(h, n, values, v, servo.work)
    most = max(-values[0], max(values[n - 1], 1e-300))
    if values[0] > FLAT * most:
        minimize_quadratic_in_box(h, push, n, low, high, z, free, servo.work)
        return 0.0
    for k in range(n):
        size = abs(values[k])
        right[k] = size if size > FLAT * most else most  # nothing is gained there
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += right[k] * v[k * n + i] * v[k * n + j]
            convex[i * n + j] = total
            convex[j * n + i] = total
    least = values[0]
    minimize_quadratic_in_box(convex, push, n, low, high, z, free, servo.work)
    count = 0
    for i in range(n):
        if free[i] != 0.0:
            count += 1
    if least >= -SADDLE * most or count == 0:
        return 0.0
    row = 0
    for i in range(n):
        if free[i] == 0.0:
            continue
        column = 0
        for j in range(n):
            if free[j] != 0.0:
                part[row * count + column] = h[i * n + j]
                column += 1
        row += 1
    compute_eigenvectors(part, count, values, v, servo.work)
    if values[0] >= FLAT * most:  # convex in what is free: its own curvature, not one made larger
        for i in range(n):
            way[i] = z[i] if free[i] == 0.0 else 0.0
        multiply_rows(h, way, n, n, right)
        for i in range(n):
            right[i] = push[i] - right[i]
        solve_free_entries(h, n, free, right, values, servo.work)
        for i in range(n):
            x = values[i] if free[i] != 0.0 else z[i]
            values[i] = min(max(x, low[i]), high[i])
        if compute_promise(h, push, values, n) > compute_promise(h, push, z, n):
            for i in range(n):
                z[i] = values[i]
        return 0.0
    column = 0
    for i in range(n):
        way[i] = 0.0
        if free[i] != 0.0:
            way[i] = v[column]
            column += 1
    return min(values[0] + SADDLE * most, 0.0)


@routine
def move_along_direction(z, way, slope, low, high, n):
    """Move z (n,) along a direction, downhill, as far as the box and a small step allow."""
    sign = 1.0 if slope >= 0.0 else -1.0
    room = ASIDE
    for i in range(n):
        step = sign * way[i]
        if abs(step) > 1e-12:
            room = min(room, ((high[i] - z[i]) if step > 0.0 else (z[i] - low[i])) / abs(step))
    for i in range(n):
        z[i] = min(max(z[i] + room * sign * way[i], low[i]), high[i])


# ---- the step at a configuration


@routine
def compute_move(servo, q, move):
    """Compute velocities at a configuration; return whether no joint turns back after the step, by
    a bound on second derivatives, or -1 for a bad configuration.
    """
    n = servo.n
    if evaluate_jacobian(
        servo.ints, servo.floats, q, 0, WORLD_ALIGNED, True, move.pose, 0, move.jacobian, 0
    ):
        return -1
    compute_velocity_bounds(servo, q, True, move.low, move.high)
    if servo.posed:
        return int(approach_pose(servo, q, move))
    x = servo.vectors
    for i in range(ROWS):
        move.twist[i] = servo.goal[i]
    fill_rows(servo, move)
    regular = n > 0 and solve_regular_wish(servo, 0.0, x)
    kept = servo.kept and not (regular and n >= ROWS and is_inside(x, move.low, move.high, n))
    if kept or not regular:
        solve_unbounded_wish(servo, 0.0, x)
    if regular and not kept and is_inside(x, move.low, move.high, n):
        slowest = math.inf
        for j in range(n):
            move.velocity[j] = x[j]
            slowest = min(slowest, servo.fastest[j])
        square = 0.0
        for i in range(ROWS * n):
            square += servo.rows[i] * servo.rows[i]
        speed = compute_dot(x, x, n)
        bound = servo.dt * math.sqrt(float(n) * square) * speed / servo.near
        return int(bound <= SLOW * slowest and has_room(servo, q, x))
    if kept:
        keep_direction(servo, q, move.low, move.high, move.velocity)
    elif regular:
        hard = get_singular_values(servo)[2]
        for i in range(ROWS):
            hard[i] = 0.0
        minimize_damped_residual(servo, x, move.low, move.high, move.velocity)
    else:
        slide_along_limits(servo, q, x, move.low, move.high, move.velocity)
    return 0


@routine
def has_room(servo, q, velocity):
    """Return whether two such steps meet no limit of position."""
    for k in range(servo.n):
        i = servo.q_of[k]
        if i >= 0:
            x = q[i] + 2.0 * servo.dt * velocity[k]
            if not (x >= servo.lower[k] and x <= servo.upper[k]):
                return False
    return True


@routine
def find_steady_fraction(servo, q, velocity, move, there):
    """Find the fraction of the step after which no joint turns back at once.

    Speeds below `SLOW` of the largest (n,) do not count. Where a joint turns back, a shorter step
    leads nearer to where its speed passes zero, and one at `SLOW` of the speeds across.
    """
    n = servo.n
    moved = advance_pointer(servo.vectors, n)
    part = 1.0
    for _ in range(SHORTER):
        for j in range(n):
            moved[j] = part * velocity[j]
        if not is_any_fast(servo, moved):
            return part
        take_step(servo, q, moved, there)
        compute_move(servo, there, move)
        if not is_turning_back(servo, moved, move.velocity):
            return part
        part *= 0.5
    return compute_slow_fraction(servo, velocity)


@routine
def is_pose(x):
    """Return whether a matrix (4, 4) is a pose."""
    off = abs(x[15] - 1.0)
    for i in range(3):
        for j in range(3):
            total = -1.0 if i == j else 0.0
            for k in range(3):
                total += x[4 * i + k] * x[4 * j + k]
            off += abs(total)
    turn = (
        x[8] * (x[1] * x[6] - x[2] * x[5])
        + x[9] * (x[2] * x[4] - x[0] * x[6])
        + x[10] * (x[0] * x[5] - x[1] * x[4])
    )
    return off < SKEW and turn > 0.0 and abs(x[3] + x[7] + x[11]) < math.inf


@routine
def write_answer(servo, move, q_index, v_index, after, all_q, all_v, q, out):
    """Write q after the step, velocities, twist, fraction, and which velocities are at a limit;
    return how many are.
    """
    n = servo.n
    for k in range(all_q):
        out[k] = q[k]
    for k in range(servo.nq):
        out[q_index[k]] = after[k]
    velocity = advance_pointer(out, all_q)
    for k in range(all_v):
        velocity[k] = 0.0
    rest = advance_pointer(velocity, all_v)
    for k in range(n):
        velocity[v_index[k]] = move.velocity[k]
    had = 0.0
    square = 0.0
    missed = 0.0
    for i in range(ROWS):
        x = compute_dot(advance_pointer(move.jacobian, i * n), move.velocity, n)
        rest[TWIST + i] = x
        wish = servo.weights[i] * move.twist[i]
        had += wish * servo.weights[i] * x
        square += wish * wish
        way = servo.metric[i] * move.twist[i] * servo.dt
        missed += way * way
    reached = square == 0.0 or missed <= REACHED * REACHED
    rest[FRACTION] = 1.0 if reached else had / square
    return mark_limited(servo, move.velocity, move.low, move.high, advance_pointer(rest, ANSWER))


@kernel(I("_"), F("_"), F("_"), F("_"), F("_"), F("_"), FLOAT, FLOAT, FLAG, OUT("_"))
def compute_frame_step(ints, floats, q, wanted, speed, weights, dt, damping, kept, out):
    """Write the configuration (nq,) after one step, velocities (nv,), and an answer as
    `servo_layout` says; return the number of velocities at a limit, or a negative code of it.

    `wanted` is a twist (6,) or a pose (16,); `speed` has one entry, or nv; `weights` none, or 6.
    """
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    nq = i_[0]
    n = i_[1]
    balls = i_[BALLS]
    all_q = i_[3]
    all_v = i_[4]
    posed = wanted.shape[0] == 16
    one = speed.shape[0] == 1
    if (
        q.shape[0] != all_q
        or (not posed and wanted.shape[0] != ROWS)
        or (not one and speed.shape[0] != all_v)
        or out.shape[0] != all_q + all_v + ANSWER + n
    ):
        return WRONG_SHAPE
    q_index = advance_integer_pointer(i_, HEAD)
    v_index = advance_integer_pointer(q_index, nq)
    q_of = advance_integer_pointer(v_index, n)
    ball_q = advance_integer_pointer(q_of, n)
    ball_v = advance_integer_pointer(ball_q, balls)
    unit = advance_pointer(f_, FLOATS)
    lower = advance_pointer(unit, n)
    upper = advance_pointer(lower, n)
    size = (
        16
        + 3 * nq
        + 3 * n
        + 3 * ROWS
        + 2 * count_move_numbers(n)
        + (ROWS * ROWS + 2 * ROWS + n * n)
        + (ROWS * n + ROWS)
        + VECTORS * n
        + 16
        + MATRICES * n * n
        + (nq + 32 + 3 * ROWS * n + 3 * ROWS + 2 * n)
        + 2 * n * n
        + 12 * n
        + 64
    )
    block = np.empty(size)
    goal = get_pointer(block)
    own = advance_pointer(goal, 16)
    there = advance_pointer(own, nq)
    after = advance_pointer(there, nq)
    fastest = advance_pointer(after, nq)
    scale = advance_pointer(fastest, n)
    w = advance_pointer(scale, n)
    metric = advance_pointer(w, ROWS)
    first = advance_pointer(metric, ROWS)
    second = advance_pointer(first, count_move_numbers(n))
    wished = advance_pointer(second, count_move_numbers(n))
    rows = advance_pointer(wished, ROWS * ROWS + 2 * ROWS + n * n)
    vectors = advance_pointer(rows, ROWS * n + ROWS)
    matrices = advance_pointer(vectors, VECTORS * n + 16)
    ends = advance_pointer(matrices, MATRICES * n * n)
    work = advance_pointer(ends, nq + 32 + 3 * ROWS * n + 3 * ROWS + 2 * n)
    for k in range(wanted.shape[0]):
        goal[k] = wanted[k]
    if posed:
        if not is_pose(goal):
            return BAD_MOTION
    elif not compute_dot(goal, goal, ROWS) < math.inf:
        return BAD_MOTION
    weighted = weights.shape[0] == ROWS
    for k in range(ROWS):
        w[k] = weights[k] if weighted else 1.0
        metric[k] = w[k] * floats[METRIC + k]
    for k in range(nq):
        own[k] = q[q_index[k]]
    for k in range(n):
        fastest[k] = speed[0] if one else speed[v_index[k]]
        scale[k] = 1.0
    servo = Servo(
        advance_integer_pointer(ball_v, balls),
        advance_pointer(upper, n),
        q_of,
        ball_q,
        ball_v,
        lower,
        upper,
        unit,
        scale,
        fastest,
        goal,
        w,
        metric,
        nq,
        n,
        balls,
        posed,
        weighted,
        not weighted or (w[3] == w[4] and w[4] == w[5]),
        i_[PLAIN] != 0,
        kept,
        dt,
        damping,
        floats[NEAR],
        wished,
        rows,
        vectors,
        matrices,
        ends,
        work,
    )
    move = make_move(first, n)
    calm = compute_move(servo, own, move)
    if calm < 0:
        return BAD_CONFIGURATION
    if calm == 0:
        part = find_steady_fraction(servo, own, move.velocity, make_move(second, n), there)
        for j in range(n):
            move.velocity[j] *= part
    take_step(servo, own, move.velocity, after)
    count = write_answer(
        servo, move, q_index, v_index, after, all_q, all_v, get_pointer(q), get_pointer(out)
    )
    keep_alive(block)
    return count
