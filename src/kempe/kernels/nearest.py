"""The nearest configuration: descent to a local minimum of the error, where it need not vanish.

Gauss-Newton steps converge slowly, or not at all, where the error stays large: they lack the curvature of the chain.
Here the Hessian is exact, and second derivatives of a chain are cross products of what the Jacobian has already.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels._jit import device, routine
from kempe.kernels.linear import back, factor
from kempe.kernels.residual import (
    AXES_STRIDE,
    BOX_STRIDE,
    COLUMN_INTS,
    FREE,
    JACOBIAN_STRIDE,
    OWNER,
    SCALE,
    STEP,
    TURNS,
    WEIGHTS,
    along,
    energy,
    error,
    fill_jacobian,
    trace,
)
from kempe.kernels.step import advance, blocked, within
from kempe.kernels.vectors import keep, raw

ENOUGH = 1e-26
"""Energy that counts as zero: errors of 1e-13 of the chain's length."""

LAST = 1e-12
"""Promised relative decrease of the energy below which one more step ends the descent."""


@device
def cross(a, b):
    """The cross product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@device
def dot(a, b):
    """The scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def column_at(chain, column, p):
    """Axis of a column, the velocity that it gives the tip at p, and whether it turns."""
    k, a = AXES_STRIDE * column, chain.axes
    axis = (a[k], a[k + 1], a[k + 2])
    if chain.notes[COLUMN_INTS * column + TURNS] == 0:
        return axis, axis, False
    return axis, cross(axis, (p[0] - a[k + 3], p[1] - a[k + 4], p[2] - a[k + 5])), True


@routine
def fill_hessian(chain, e, p, h):
    """Write the Hessian of the energy, (nv, nv), at the configuration traced last, its tip at p and its error e.

    For columns j before i of a chain, with axes a and tip velocities t: the second derivative of the tip is a_j x t_i
    (0 if j slides). With phi the rotation error, n its direction and gamma = |phi|/2 cot(|phi|/2), the rotation's part
    is a_i (gamma I + (1 - gamma) n n^T) a_j - phi (a_j x a_i) / 2, from the inverse Jacobian of the
    exponential (Bullo and Murray 1995).
    """
    w = (chain.goal[WEIGHTS], chain.goal[WEIGHTS + 1], chain.goal[WEIGHTS + 2])
    u = (chain.goal[WEIGHTS + 3], chain.goal[WEIGHTS + 4], chain.goal[WEIGHTS + 5])
    force, phi = (w[0] * e[0], w[1] * e[1], w[2] * e[2]), (e[3], e[4], e[5])
    angle = math.sqrt(dot(phi, phi))
    small = angle < 1e-3
    gamma = 1.0 - angle * angle / 12.0 if small else 0.5 * angle / math.tan(0.5 * angle)
    rest = 1.0 / 12.0 if small else (1.0 - gamma) / (angle * angle)
    for k in range(chain.nv * chain.nv):
        h[k] = 0.0
    for j in range(chain.columns):
        a, t, turns = column_at(chain, j, p)
        f = cross(force, a) if turns else (0.0, 0.0, 0.0)
        m = (0.5 * (phi[1] * a[2] - phi[2] * a[1]), 0.5 * (phi[2] * a[0] - phi[0] * a[2]),
             0.5 * (phi[0] * a[1] - phi[1] * a[0]))  # fmt: skip
        t = (w[0] * w[0] * t[0] - f[0], w[1] * w[1] * t[1] - f[1], w[2] * w[2] * t[2] - f[2])
        s = rest * dot(phi, a)
        m = (
            gamma * u[0] * a[0] + s * phi[0] - m[0],
            gamma * u[1] * a[1] + s * phi[1] - m[1],
            gamma * u[2] * a[2] + s * phi[2] - m[2],
        )
        row = chain.notes[COLUMN_INTS * j + OWNER]
        for i in range(j, chain.columns):
            b, v, also = column_at(chain, i, p)
            value = dot(t, v)
            if turns and also:
                value += dot(m, b)
            other = chain.notes[COLUMN_INTS * i + OWNER]
            h[row * chain.nv + other] += value
            if i != j:
                h[other * chain.nv + row] += value


@routine
def factor_damped(chain, h, damping, a):
    """Write L and D of the Hessian of the FREE coordinates plus damping * I; the damping, raised until that is positive."""
    n = chain.nv
    while True:
        for i in range(n):
            mobile = chain.jacobian[JACOBIAN_STRIDE * i + FREE] != 0.0
            for j in range(i):
                both = mobile and chain.jacobian[JACOBIAN_STRIDE * j + FREE] != 0.0
                a[i * n + j] = h[i * n + j] if both else 0.0
            a[i * n + i] = h[i * n + i] + damping if mobile else 1.0
        if factor(a, n) or damping > 1e12:
            return damping
        damping = max(1e-6, 4.0 * damping)


@routine
def newton_step(chain, e, h, damping, a, b):
    """Write the damped Newton step with an active set of limits; the decrease that it promises, and the damping used."""
    n, jacobian = chain.nv, chain.jacobian
    for v in range(n):
        k = JACOBIAN_STRIDE * v
        jacobian[k + FREE] = 0.0 if blocked(chain, v, along(jacobian, v, e)) else 1.0
        jacobian[k + STEP] = 0.0
    for _ in range(2):
        damping = factor_damped(chain, h, damping, a)
        for i in range(n):
            b[i] = 0.0
            if jacobian[JACOBIAN_STRIDE * i + FREE] != 0.0:
                b[i] = along(jacobian, i, e)
                for j in range(n):
                    if jacobian[JACOBIAN_STRIDE * j + FREE] == 0.0:
                        d = jacobian[JACOBIAN_STRIDE * j + STEP] / chain.box[BOX_STRIDE * j + SCALE]
                        b[i] -= h[i * n + j] * d
        back(a, n, b)
        stopped = False
        for v in range(n):
            k = JACOBIAN_STRIDE * v
            if jacobian[k + FREE] != 0.0:
                wish = b[v] * chain.box[BOX_STRIDE * v + SCALE]
                jacobian[k + STEP] = within(chain, v, wish)
                if jacobian[k + STEP] != wish:
                    stopped = True
                    jacobian[k + FREE] = 0.0
        if not stopped:
            break
    promise = 0.0
    for i in range(n):
        d = jacobian[JACOBIAN_STRIDE * i + STEP] / chain.box[BOX_STRIDE * i + SCALE]
        slope = along(jacobian, i, e)
        for j in range(n):
            slope -= 0.5 * h[i * n + j] * jacobian[JACOBIAN_STRIDE * j + STEP] / chain.box[BOX_STRIDE * j + SCALE]
        promise += d * slope
    return promise, damping


@routine
def descend(chain, limit):
    """Steps taken to move q to a local minimum of the energy within the limits: damped Newton, decrease checked.

    The damping follows the ratio of found to promised decrease (Levenberg 1944; Marquardt 1963; Fletcher 1971).
    """
    n = chain.nv
    h_, a_, b_, kept_ = np.empty(n * n), np.empty(n * n), np.empty(n), np.empty(chain.nq)
    h, a, b, kept = raw(h_), raw(a_), raw(b_), raw(kept_)
    best, promise, damping = np.inf, np.inf, 1e-3
    e_best = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    steps = 0
    while True:
        r, p = trace(chain)
        e = error(chain.goal, r, p)
        new = energy(e)
        if new < best:
            if new < ENOUGH:
                break
            if best < np.inf:
                ratio = (best - new) / promise
                damping *= 0.1 if ratio > 0.75 else (1.0 if ratio > 0.25 else 4.0)
                damping = max(damping, 1e-12)
            best, e_best = new, e
            for k in range(chain.nq):
                kept[k] = chain.q[k]
            fill_jacobian(chain, p)
            fill_hessian(chain, e, p, h)
        else:
            damping *= 8.0
            for k in range(chain.nq):
                chain.q[k] = kept[k]
        if steps >= limit or damping > 1e12:
            break
        promise, damping = newton_step(chain, e_best, h, damping, a, b)
        steps += 1
        last = promise < LAST * best
        if promise > 0.0:
            advance(chain)
        if last:
            break
    keep(h_)
    keep(a_)
    keep(b_)
    keep(kept_)
    return steps
