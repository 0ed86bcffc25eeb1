"""Rotations as numbers: the rotation vector of a matrix, unit quaternions (w, x, y, z) turned and
drawn.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device
from kempe.kernels.base.random import mix_bits, to_unit_interval
from kempe.kernels.base.trig import atan2


@device
def compute_rotation_vector(m):
    """Compute the rotation vector of a rotation matrix (9 numbers, row by row), accurate at all
    angles from 0 to pi.
    """
    x = 0.5 * (m[7] - m[5])
    y = 0.5 * (m[2] - m[6])
    z = 0.5 * (m[3] - m[1])
    cosine = 0.5 * (m[0] + m[4] + m[8] - 1.0)
    square = x * x + y * y + z * z
    if cosine > -0.8:
        if square < 1e-5 and cosine > 0.0:  # the arcsine's series; the next term is below 1e-21
            factor = 1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * (15.0 / 336.0)))
        else:
            sine = math.sqrt(square)
            factor = atan2(sine, cosine) / sine
        return x * factor, y * factor, z * factor
    # Near pi the antisymmetric part fades: four times a quaternion, from its largest entry
    # (Shepperd 1978).
    if m[0] >= m[4] and m[0] >= m[8]:
        x = 1.0 + m[0] - m[4] - m[8]
        y = m[1] + m[3]
        z = m[2] + m[6]
        w = m[7] - m[5]
    elif m[4] >= m[8]:
        x = m[1] + m[3]
        y = 1.0 - m[0] + m[4] - m[8]
        z = m[5] + m[7]
        w = m[2] - m[6]
    else:
        x = m[2] + m[6]
        y = m[5] + m[7]
        z = 1.0 - m[0] - m[4] + m[8]
        w = m[3] - m[1]
    size = math.sqrt(x * x + y * y + z * z)
    factor = math.copysign(2.0 * atan2(size, abs(w)) / size, w)
    return x * factor, y * factor, z * factor


@device
def turn_quaternion(q, i, x, y, z):
    """Write the quaternion q multiplied by exp((x, y, z)) to q[i : i + 4], with norm 1."""
    x = 0.5 * x
    y = 0.5 * y
    z = 0.5 * z
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(angle) / angle if angle > 1e-4 else 1.0 - angle * angle / 6.0
    c = math.cos(angle)
    x = x * s
    y = y * s
    z = z * s
    w0 = q[i]
    x0 = q[i + 1]
    y0 = q[i + 2]
    z0 = q[i + 3]
    w1 = w0 * c - x0 * x - y0 * y - z0 * z
    x1 = w0 * x + x0 * c + y0 * z - z0 * y
    y1 = w0 * y - x0 * z + y0 * c + z0 * x
    z1 = w0 * z + x0 * y - y0 * x + z0 * c
    f = 1.0 / math.sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    q[i] = w1 * f
    q[i + 1] = x1 * f
    q[i + 2] = y1 * f
    q[i + 3] = z1 * f


@device
def draw_quaternion(q, i, key):
    """Write a uniformly distributed unit quaternion to q[i : i + 4] (Shoemake 1992)."""
    zero = np.uint64(0)
    one = np.uint64(1)
    two = np.uint64(2)
    u = to_unit_interval(mix_bits(key, zero))
    a = 2.0 * math.pi * to_unit_interval(mix_bits(key, one))
    b = 2.0 * math.pi * to_unit_interval(mix_bits(key, two))
    q[i] = math.sqrt(1.0 - u) * math.sin(a)
    q[i + 1] = math.sqrt(1.0 - u) * math.cos(a)
    q[i + 2] = math.sqrt(u) * math.sin(b)
    q[i + 3] = math.sqrt(u) * math.cos(b)
