"""Joint axes as lines in space: short vectors as tuples, motions about lines, 3x4 matrices behind
pointers.

A chain is T = E_1(theta_1) ... E_n(theta_n) M, the product of exponentials of Brockett (1984): E_i
turns by theta_i about the line through o_i along the unit vector h_i, or slides by theta_i along
h_i. Everything here holds for floats and for vectors of lanes alike.
"""

from __future__ import annotations

from kempe.kernels.base._jit import device

LINE_STRIDE = 8
"""Numbers of a line: direction (3), 0, point (3), 0."""


@device
def dot(a, b):
    """The scalar product of two vectors of three."""
    return a[0] * b[0] + (a[1] * b[1] + a[2] * b[2])


@device
def cross(a, b):
    """The vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@device
def plus(a, k, b):
    """a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@device
def minus(a, b):
    """The difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@device
def mix3(a, x, b, y, c, z):
    """x a + y b + z c."""
    return (
        x * a[0] + (y * b[0] + z * c[0]),
        x * a[1] + (y * b[1] + z * c[1]),
        x * a[2] + (y * b[2] + z * c[2]),
    )


@device
def turned(h, v, c, s):
    """v turned about the unit vector h by the angle with cosine c and sine s (Rodrigues, 1840)."""
    return mix3(v, c, cross(h, v), s, h, (1.0 - c) * dot(h, v))


@device
def three(p, k):
    """The vector p[k : k + 3]."""
    return p[k], p[k + 1], p[k + 2]


@device
def rotated(g, v):
    """R v, where g holds the rows of [R | t]."""
    return (
        g[0] * v[0] + (g[1] * v[1] + g[2] * v[2]),
        g[4] * v[0] + (g[5] * v[1] + g[6] * v[2]),
        g[8] * v[0] + (g[9] * v[1] + g[10] * v[2]),
    )


@device
def unrotated(g, v):
    """R^T v."""
    return (
        g[0] * v[0] + (g[4] * v[1] + g[8] * v[2]),
        g[1] * v[0] + (g[5] * v[1] + g[9] * v[2]),
        g[2] * v[0] + (g[6] * v[1] + g[10] * v[2]),
    )


@device
def translation(g):
    """t, where g holds the rows of [R | t]."""
    return g[3], g[7], g[11]


@device
def mapped(g, p):
    """R p + t."""
    return plus(rotated(g, p), 1.0, translation(g))


@device
def unmapped(g, p):
    """R^T (p - t)."""
    return unrotated(g, minus(p, translation(g)))


@device
def write3(p, k, v):
    """Write the vector v to p[k : k + 3]."""
    p[k] = v[0]
    p[k + 1] = v[1]
    p[k + 2] = v[2]


@device
def foot(o, h, a, g):
    """The point of the line (o, h) that is nearest to the line (a, g); o itself where they are
    parallel.
    """
    n = cross(h, g)
    square = dot(n, n)
    if square < 1e-18:
        return o
    return plus(o, dot(cross(minus(a, o), g), n) / square, h)


@device
def identity(g):
    """Make g the rows of [1 | 0]."""
    for i in range(12):
        g[i] = 0.0
    g[0] = 1.0
    g[5] = 1.0
    g[10] = 1.0


@device
def follow(g, h, o, slides, theta, c, s):
    """Replace g by g E, E the motion along the line (o, h) by theta, whose cosine is c and sine s."""
    if slides:
        t = plus(translation(g), theta, rotated(g, h))
        g[3] = t[0]
        g[7] = t[1]
        g[11] = t[2]
        return
    t = mapped(g, minus(o, turned(h, o, c, s)))
    for i in range(3):  # rows of R E; a row times a rotation is the row turned back
        row = turned(h, three(g, 4 * i), c, -s)
        write3(g, 4 * i, row)
    g[3] = t[0]
    g[7] = t[1]
    g[11] = t[2]
