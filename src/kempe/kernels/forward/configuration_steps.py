"""Steps between configurations: plain coordinates add, unit quaternions turn in their own axes."""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.trig import atan2
from kempe.kernels.base.vectors import get_pointer
from kempe.kernels.forward.table_rows import read_unit_quaternion

SMALL_SINE = 1e-4
"""Below this sine of half an angle, a series replaces the quotient of both."""


@device
def compute_turn(a, b):
    """Return the rotation vector, at most pi long, from a unit quaternion to another one, in the
    axes of the first.
    """
    d = b[0] - a[0], b[1] - a[1], b[2] - a[2], b[3] - a[3]  # exactly nothing where both are equal
    w = a[0] * b[0] + (a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    x = a[0] * d[1] - a[1] * d[0] - (a[2] * d[3] - a[3] * d[2])
    y = a[0] * d[2] - a[2] * d[0] - (a[3] * d[1] - a[1] * d[3])
    z = a[0] * d[3] - a[3] * d[0] - (a[1] * d[2] - a[2] * d[1])
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 + sine * sine / 3.0 if sine < SMALL_SINE else 2.0 * atan2(sine, abs(w)) / sine
    factor = math.copysign(factor, w)
    return x * factor, y * factor, z * factor


@kernel(I("k"), I("k"), I("b"), I("b"), F("N", "nq"), F("N", "nv"), OUT("N", "nq"), returns=False)
def integrate_velocities(vector_q, vector_v, ball_q, ball_v, q, v, out):
    """Write the configurations after 1 s from q at the velocities v.

    vector_q, vector_v: places of plain coordinates and of their velocities. ball_q, ball_v: where
    quaternions (4) and their angular velocities (3) begin.
    """
    nq = q.shape[1]
    out_ = get_pointer(out)
    q_ = get_pointer(q)
    for i in range(q.shape[0]):
        for k in range(vector_q.shape[0]):
            out[i, vector_q[k]] = q[i, vector_q[k]] + v[i, vector_v[k]]
        for k in range(ball_q.shape[0]):
            at = nq * i + ball_q[k]
            out_[at], out_[at + 1], out_[at + 2], out_[at + 3] = read_unit_quaternion(q_, at, 1.0)
            first = ball_v[k]
            turn_quaternion(out_, at, v[i, first], v[i, first + 1], v[i, first + 2])


@kernel(I("k"), I("k"), I("b"), I("b"), F("N", "nq"), F("N", "nq"), OUT("N", "nv"), returns=False)
def compute_differences(vector_q, vector_v, ball_q, ball_v, start, end, out):
    """Write the velocities that lead from start to end in 1 s; quaternions turn the short way.

    The places are those of `integrate_velocities`.
    """
    nq = start.shape[1]
    start_ = get_pointer(start)
    end_ = get_pointer(end)
    for i in range(start.shape[0]):
        for k in range(vector_q.shape[0]):
            out[i, vector_v[k]] = end[i, vector_q[k]] - start[i, vector_q[k]]
        for k in range(ball_q.shape[0]):
            at = nq * i + ball_q[k]
            first = ball_v[k]
            a = read_unit_quaternion(start_, at, 1.0)
            b = read_unit_quaternion(end_, at, 1.0)
            out[i, first], out[i, first + 1], out[i, first + 2] = compute_turn(a, b)
