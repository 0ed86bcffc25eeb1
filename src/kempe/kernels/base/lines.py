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
    """Return the scalar product of two 3-vectors."""
    return a[0] * b[0] + (a[1] * b[1] + a[2] * b[2])


@device
def cross(a, b):
    """Return the vector product of two 3-vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@device
def add_scaled(a, k, b):
    """Return a + k b for two 3-vectors a, b and a number k."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@device
def subtract_vectors(a, b):
    """Return the difference a - b of two 3-vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@device
def combine_three(a, x, b, y, c, z):
    """Return x a + y b + z c for three 3-vectors a, b, c and three numbers x, y, z."""
    return (
        x * a[0] + (y * b[0] + z * c[0]),
        x * a[1] + (y * b[1] + z * c[1]),
        x * a[2] + (y * b[2] + z * c[2]),
    )


@device
def rotate_about_axis(h, v, c, s):
    """Rotate the vector v about the unit vector h by the angle with cosine c and sine s (Rodrigues,
    1840).
    """
    return combine_three(v, c, cross(h, v), s, h, (1.0 - c) * dot(h, v))


@device
def read_vector(p, k):
    """Read the 3-vector p[k : k + 3]."""
    return p[k], p[k + 1], p[k + 2]


@device
def rotate_vector(g, v):
    """Return R v, the vector v under the rotation R of the pose g = [R | t]."""
    return (
        g[0] * v[0] + (g[1] * v[1] + g[2] * v[2]),
        g[4] * v[0] + (g[5] * v[1] + g[6] * v[2]),
        g[8] * v[0] + (g[9] * v[1] + g[10] * v[2]),
    )


@device
def unrotate_vector(g, v):
    """Return R^T v, the vector v under the inverse rotation of the pose g = [R | t]."""
    return (
        g[0] * v[0] + (g[4] * v[1] + g[8] * v[2]),
        g[1] * v[0] + (g[5] * v[1] + g[9] * v[2]),
        g[2] * v[0] + (g[6] * v[1] + g[10] * v[2]),
    )


@device
def read_translation(g):
    """Read the translation t of the pose g = [R | t]."""
    return g[3], g[7], g[11]


@device
def transform_point(g, p):
    """Return R p + t, the point p under the pose g = [R | t]."""
    return add_scaled(rotate_vector(g, p), 1.0, read_translation(g))


@device
def transform_point_back(g, p):
    """Return R^T (p - t), the point p under the inverse of the pose g = [R | t]."""
    return unrotate_vector(g, subtract_vectors(p, read_translation(g)))


@device
def write_vector(p, k, v):
    """Write the vector v to p[k : k + 3]."""
    p[k] = v[0]
    p[k + 1] = v[1]
    p[k + 2] = v[2]


@device
def find_foot_point(o, h, a, g):
    """Return the point of the line (o, h) that is nearest to the line (a, g), or o where the lines
    are parallel.
    """
    n = cross(h, g)
    square = dot(n, n)
    if square < 1e-18:
        return o
    return add_scaled(o, dot(cross(subtract_vectors(a, o), g), n) / square, h)


@device
def write_identity(g):
    """Write the identity pose, the rows of [1 | 0], to g."""
    for i in range(12):
        g[i] = 0.0
    g[0] = 1.0
    g[5] = 1.0
    g[10] = 1.0


@device
def append_motion(g, h, o, slides, theta, c, s):
    """Replace the pose g by g E, where E is the turn or slide along the line (o, h) by theta, with
    cosine c and sine s.
    """
    if slides:
        t = add_scaled(read_translation(g), theta, rotate_vector(g, h))
        g[3] = t[0]
        g[7] = t[1]
        g[11] = t[2]
        return
    t = transform_point(g, subtract_vectors(o, rotate_about_axis(h, o, c, s)))
    for i in range(3):  # rows of R E; a row times a rotation is the row turned back
        row = rotate_about_axis(h, read_vector(g, 4 * i), c, -s)
        write_vector(g, 4 * i, row)
    g[3] = t[0]
    g[7] = t[1]
    g[11] = t[2]
