"""The nearest configuration: descent to a local minimum of the error, where it need not vanish.

Gauss-Newton steps converge slowly, or not at all, where the error stays large: they lack the
curvature of the chain. Here the Hessian is exact: a chain's second derivatives are cross products
of what the Jacobian has.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.lines import add_scaled, combine_three, cross, dot, subtract_vectors
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.one_frame.residual import (
    BOX_STRIDE,
    COLUMN_INTS,
    FREE,
    JACOBIAN_STRIDE,
    OWNER,
    POINTS,
    SCALE,
    STEP,
    WEIGHTS,
    compute_column,
    compute_energy,
    compute_error,
    fill_jacobian,
    multiply_column,
    take_first_three,
    trace_chain,
)
from kempe.kernels.one_frame.step import advance_configuration, clip_step, is_blocked

ENOUGH = 1e-26
"""Energy that counts as zero: errors of 1e-13 of the chain's length."""

DAMPING_LIMIT = 1e12
"""Damping at which a descent gives up: its steps are nothing."""

LAST = 1e-16
"""Square of the step (radians, and parts of the chain's length) after which rounding hides the
next."""


@device
def compute_turning_part(chain, e, tip, a):
    """Return m, such that m.b is the rotation's part of the Hessian for a turn about a and a later
    one about b.

    With phi the rotation error, r its size and gamma = r/2 cot(r/2), m = gamma a + (1 - gamma)/r^2
    (phi.a) phi - phi x a / 2, from the inverse Jacobian of the exponential (Bullo and Murray 1995).
    Where only the direction c of the z axis counts, g being the goal's and n = c x g, the error is
    e = r/sin r n and by its derivative
    m = r/sin r ((c.g) a - (a.g) c) + (sin r - r cos r)/sin^3 r (n.a) n - e x a.
    """
    g = chain.goal
    phi = (e[3], e[4], e[5])
    square = dot(phi, phi)
    angle = math.sqrt(square)
    small = angle < 1e-3
    if g[POINTS] != 0.0:
        c = take_first_three(tip[2])
        goal = (g[2], g[6], g[10])
        sine = max(math.sin(min(angle, math.pi)), 1e-3 * angle)
        f = 1.0 + square / 6.0 if small else angle / sine
        s = (1.0 + 0.4 * square) / 3.0 if small else (sine - angle * math.cos(angle)) / sine**3
        n = cross(c, goal)
        m = combine_three(a, f * dot(c, goal), c, -f * dot(a, goal), n, s * dot(n, a))
        return subtract_vectors(m, cross(phi, a))
    u = (g[WEIGHTS + 3], g[WEIGHTS + 4], g[WEIGHTS + 5])
    gamma = 1.0 - square / 12.0 if small else 0.5 * angle / math.tan(0.5 * angle)
    rest = 1.0 / 12.0 if small else (1.0 - gamma) / square
    m = (gamma * u[0] * a[0], gamma * u[1] * a[1], gamma * u[2] * a[2])
    return add_scaled(add_scaled(m, rest * dot(phi, a), phi), -0.5, cross(phi, a))


@routine
def fill_hessian(chain, e, tip, h):
    """Write the Hessian (nv, nv) of the energy at the configuration traced last, its error e.

    For columns j before i of a chain, with axes a and tip velocities t: the tip's second derivative
    is a_j x t_i (0 if j slides). The part of the rotation is `compute_turning_part`.
    """
    w = (chain.goal[WEIGHTS], chain.goal[WEIGHTS + 1], chain.goal[WEIGHTS + 2])
    force = (w[0] * e[0], w[1] * e[1], w[2] * e[2])
    for k in range(chain.nv * chain.nv):
        h[k] = 0.0
    for j in range(chain.columns):
        a, t, turns = compute_column(chain, j, tip)
        f = (0.0, 0.0, 0.0)
        m = (0.0, 0.0, 0.0)
        if turns:
            f = cross(force, a)
            m = compute_turning_part(chain, e, tip, a)
        t = (w[0] * w[0] * t[0] - f[0], w[1] * w[1] * t[1] - f[1], w[2] * w[2] * t[2] - f[2])
        row = chain.notes[COLUMN_INTS * j + OWNER]
        for i in range(j, chain.columns):
            b, v, also = compute_column(chain, i, tip)
            value = dot(t, v)
            if turns and also:
                value += dot(m, b)
            other = chain.notes[COLUMN_INTS * i + OWNER]
            h[row * chain.nv + other] += value
            if i != j:
                h[other * chain.nv + row] += value


@routine
def factor_damped(chain, h, damping, a):
    """Factor the Hessian of FREE coordinates plus damping * I, the damping raised until it is
    positive definite; return the damping.
    """
    n = chain.nv
    while True:
        for i in range(n):
            mobile = chain.jacobian[JACOBIAN_STRIDE * i + FREE] != 0.0
            for j in range(i):
                both = mobile and chain.jacobian[JACOBIAN_STRIDE * j + FREE] != 0.0
                a[i * n + j] = h[i * n + j] if both else 0.0
            a[i * n + i] = h[i * n + i] + damping if mobile else 1.0
        if factor_matrix(a, n) or damping > DAMPING_LIMIT:
            return damping
        damping = max(1e-6, 4.0 * damping)


@device
def start_step(chain, e):
    """Mark as FREE the coordinates that the gradient does not push out of a limit, and set all
    steps to zero.
    """
    for v in range(chain.nv):
        k = JACOBIAN_STRIDE * v
        chain.jacobian[k + FREE] = (
            0.0 if is_blocked(chain, v, multiply_column(chain.jacobian, v, e)) else 1.0
        )
        chain.jacobian[k + STEP] = 0.0


@device
def scale_step(chain, v):
    """Return the step of coordinate v in its unit."""
    return chain.jacobian[JACOBIAN_STRIDE * v + STEP] / chain.box[BOX_STRIDE * v + SCALE]


@device
def take_newton_pass(chain, e, h, damping, a, b):
    """Solve for the Newton step of FREE coordinates, the others' given; return whether no
    coordinate met a limit. One that did is fixed.
    """
    n = chain.nv
    jacobian = chain.jacobian
    for i in range(n):
        b[i] = 0.0
        if jacobian[JACOBIAN_STRIDE * i + FREE] != 0.0:
            b[i] = multiply_column(jacobian, i, e)
            for j in range(n):
                if jacobian[JACOBIAN_STRIDE * j + FREE] == 0.0:
                    b[i] -= h[i * n + j] * scale_step(chain, j)
    substitute_back(a, n, b)
    clear = True
    for v in range(n):
        k = JACOBIAN_STRIDE * v
        if jacobian[k + FREE] != 0.0:
            wish = b[v] * chain.box[BOX_STRIDE * v + SCALE]
            jacobian[k + STEP] = clip_step(chain, v, wish)
            if jacobian[k + STEP] != wish:
                clear = False
                jacobian[k + FREE] = 0.0
    return clear


@routine
def compute_newton_step(chain, e, h, damping, a, b):
    """Write the damped Newton step within the limits; return the decrease that it promises, its
    square, and the damping.
    """
    while True:
        start_step(chain, e)
        for _ in range(2):
            damping = factor_damped(chain, h, damping, a)
            if take_newton_pass(chain, e, h, damping, a, b):
                break
        promise = 0.0
        square = 0.0
        for i in range(chain.nv):
            d = scale_step(chain, i)
            slope = multiply_column(chain.jacobian, i, e)
            for j in range(chain.nv):
                slope -= 0.5 * h[i * chain.nv + j] * scale_step(chain, j)
            promise += d * slope
            square += d * d
        if promise > 0.0 or square <= LAST or damping > DAMPING_LIMIT:
            return promise, square, damping
        damping *= 8.0  # the limits have bent the step uphill


@routine
def minimize_energy(chain, limit, kept):
    """Minimise the energy from q within the limits; return the local minimum and the number of
    steps. `kept` is the configuration.

    Damped Newton steps, taken where they decrease the energy; the damping follows the ratio of the
    decrease to the promised one (Levenberg 1944; Marquardt 1963; Fletcher 1971).
    """
    n = chain.nv
    block = np.empty(2 * n * n + n)
    h = get_pointer(block)
    a = advance_pointer(h, n * n)
    b = advance_pointer(h, 2 * n * n)
    best = np.inf
    promise = 1.0
    square = 1.0
    damping = 1e-3
    steps = 0
    e_best = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    while True:
        tip = trace_chain(chain)
        e = compute_error(chain.goal, tip)
        new = compute_energy(e)
        if new < best:
            if best < np.inf:
                ratio = (best - new) / promise
                damping = max(
                    damping * (0.1 if ratio > 0.75 else (1.0 if ratio > 0.25 else 4.0)), 1e-12
                )
            best = new
            e_best = e
            for k in range(chain.nq):
                kept[k] = chain.q[k]
            fill_jacobian(chain, tip)
            fill_hessian(chain, e, tip, h)
        else:
            damping *= 8.0
        if best < ENOUGH or square <= LAST or steps >= limit or damping > DAMPING_LIMIT:
            break
        for k in range(chain.nq):
            chain.q[k] = kept[k]
        promise, square, damping = compute_newton_step(chain, e_best, h, damping, a, b)
        advance_configuration(chain)
        steps += 1
    keep_alive(block)
    return best, steps
