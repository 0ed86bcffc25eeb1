"""The subproblems to which closed-form inverse models reduce: equations in one or two joint
variables.

They go back to Paden (1986) and Kahan (1983), as numbered by Murray, Li and Sastry (1994) and,
extended, by Elias and Wen ("IK-Geo", 2022). Angles are pairs (cosine, sine): no function of the C
library is called, so that the same code serves floats and vectors of lanes. Rounding may push a
problem with a double root over the edge: discriminants are taken as zero where they are negative,
and whoever calls decides by the residual whether that is a solution.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device
from kempe.kernels.base.lines import add_scaled, cross, dot, subtract_vectors
from kempe.kernels.base.vectors import compute_square_root, select_where

TINY = 1e-300


@device
def compute_root(x):
    """Return the square root of a float or vector; 0 for negative numbers."""
    return compute_square_root(select_where(x > 0.0, x, 0.0 * x))


# ---- subproblem 4: a cos + b sin = k


@device
def find_trig_roots(a, b, k):
    """Return both solutions (c0, s0, c1, s1, d2) of a c + b s = k, c^2 + s^2 = 1; there are two if
    d2 = a^2 + b^2 - k^2 > 0.

    A circle meets a line: (c, s) = (a k -+ b d, b k +- a d) / (a^2 + b^2), d = sqrt(d2). The first
    has the smaller angle against (a, b), counted anticlockwise from it. With d2 < 0 both are the
    point of the circle nearest to the line; with a = b = 0 they mean nothing.
    """
    r2 = a * a + b * b
    r = compute_square_root(r2)
    d2 = (r - k) * (r + k)
    return find_precise_trig_roots(a, b, k, d2)


@device
def find_precise_trig_roots(a, b, k, d2):
    """Return what `find_trig_roots` does, for a discriminant d2 that is known more precisely than
    by subtraction.
    """
    d = compute_root(d2)
    n = 1.0 / compute_square_root((a * a + b * b) * (k * k + d * d) + TINY)
    return (a * k - b * d) * n, (b * k + a * d) * n, (a * k + b * d) * n, (b * k - a * d) * n, d2


@device
def compute_triangle_discriminant(r1, r2, rho2):
    """Return (2 r1 r2)^2 - (rho2 - r1^2 - r2^2)^2, the discriminant of a two-link arm, by Heron's
    formula.

    rho2 is the square of the third side: with r1 = r2 and a target at the base no digits are lost.
    """
    return ((r1 + r2) * (r1 + r2) - rho2) * (rho2 - (r1 - r2) * (r1 - r2))


# ---- subproblem 1: turn u about h onto v


@device
def find_aligning_turn(h, u, v):
    """Return (c, s, size) of the turn about the unit vector h that brings u into the half plane of
    v.

    tan = h.(u' x v') / u'.v' with u' = h x u, v' = h x v: one solution, and all angles where u or v
    lies along h: then `size`, the product of their distances from h, vanishes. The lengths of u and
    v do not matter. The textbooks' u.v - (h.u)(h.v) in place of u'.v' would lose all digits near
    that singularity.
    """
    u = cross(h, u)
    v = cross(h, v)
    sine = dot(h, cross(u, v))
    cosine = dot(u, v)
    size = compute_square_root(sine * sine + cosine * cosine)
    n = 1.0 / (size + TINY)
    return cosine * n, sine * n, size


# ---- orientation: the angle between two directions made what it has to be


@device
def find_cone_turns(k, h, n, w):
    """Return the turns (c0, s0, c1, s1, d2) about h after which n makes the same angle with k as w
    does.

    k.Rot(h, theta) n = k.w; unit vectors. Two solutions, one where the three axes lie in a plane,
    none where the angle is out of range. The discriminant is Heron's formula on the sphere, 4 d2 =
    (|k - w|^2 - (2 sin((a - b)/2))^2) (|k + w|^2 - (2 cos((a + b)/2))^2) with a = angle(k, h), b =
    angle(h, n): differences of vectors do not lose the digits that 1 - cos^2 would lose where w
    comes close to k, which is where wrists are singular.
    """
    cos_a = dot(k, h)
    cos_b = dot(h, n)
    across_a = cross(k, h)
    across_b = cross(h, n)
    sin_a = compute_square_root(dot(across_a, across_a))
    sin_b = compute_square_root(dot(across_b, across_b))
    apart = subtract_vectors(k, w)
    together = add_scaled(k, 1.0, w)
    less = (cos_a - cos_b) * (cos_a - cos_b) + (sin_a - sin_b) * (sin_a - sin_b)
    more = (cos_a + cos_b) * (cos_a + cos_b) + (sin_a - sin_b) * (sin_a - sin_b)
    d2 = 0.25 * (dot(apart, apart) - less) * (dot(together, together) - more)
    a = dot(k, n) - cos_a * cos_b
    b = dot(k, across_b)
    return find_precise_trig_roots(a, b, dot(k, w) - cos_a * cos_b, d2)


# ---- the path of a point or a direction under one joint


@device
def compute_orbit(h, v):
    """Return (m, u, w): v turned about h by theta is m + u cos(theta) + w sin(theta)."""
    w = cross(h, v)
    u = cross(w, h)
    return subtract_vectors(v, u), u, w


# ---- polynomials of degree two


@device
def find_parabola_roots(a, b, k):
    """Return both solutions (x0, x1, d2) of a x^2 + b x + k = 0; both are the vertex where there is
    none.

    Where a is negligible the other root is infinite: x1 is then the only one, and x0 repeats it.
    """
    d2 = b * b - 4.0 * a * k
    d = math.sqrt(max(d2, 0.0))
    size = abs(a) + abs(b) + abs(k)
    if abs(a) <= 1e-14 * size:
        x = -k / b if b != 0.0 else 0.0
        return x, x, b * b
    q = -0.5 * (b + math.copysign(d, b))
    x0 = q / a
    x1 = k / q if q != 0.0 and d2 > 0.0 else -0.5 * b / a
    if d2 <= 0.0:
        x0 = x1 = -0.5 * b / a
    return min(x0, x1), max(x0, x1), d2
