"""The coordinates of packed loops: their places in q, distances, random starts, and values of cut
joints.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.random import mix_bits, to_unit_interval
from kempe.kernels.base.rotations import draw_quaternion, turn_quaternion
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.search_layout import LARGEST
from kempe.kernels.base.trig import atan2
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import (
    compute_relative_rotation,
    read_tie_ends,
    rotate_vector_back,
)

"""Size from which a number is no coordinate."""


@device
def read_sort(loops, v):
    """Return the sort of velocity coordinate v: turn, slide, or part of a ball."""
    return loops.plan[loops.plan[L.AT_PLACES] + L.PLACE_INTS * v + 1]


@device
def find_place(loops, v):
    """Return the index in q of velocity coordinate v; for a ball, of its quaternion."""
    return loops.plan[loops.plan[L.AT_PLACES] + L.PLACE_INTS * v]


@device
def is_held(loops, v):
    """Return whether velocity coordinate v is held, and so no unknown."""
    return loops.plan[loops.plan[L.AT_PLACES] + L.PLACE_INTS * v + 2] != 0


@device
def read_velocity_number(loops, list_, v):
    """Return entry v of a list in `weights`: 0 scales, 1 lower and 2 upper limits, 3 and 4 ends of
    the range of random starts.
    """
    return loops.weights[L.SCALES + list_ * loops.nv + v]


@device
def write_ball_difference(q, home, i, to, at):
    """Write the rotation vector from the quaternion at q[i:] to that at home[i:] to to[at:]."""
    w = q[i]
    x = -q[i + 1]
    y = -q[i + 2]
    z = -q[i + 3]
    a = home[i]
    b = home[i + 1]
    c = home[i + 2]
    d = home[i + 3]
    rw = w * a - x * b - y * c - z * d
    rx = w * b + x * a + y * d - z * c
    ry = w * c - x * d + y * a + z * b
    rz = w * d + x * c - y * b + z * a
    sine = math.sqrt(rx * rx + ry * ry + rz * rz)
    f = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, abs(rw)) / sine
    f = math.copysign(f, rw)
    to[at] = f * rx
    to[at + 1] = f * ry
    to[at + 2] = f * rz


@routine
def compute_home_distance(loops, home, target):
    """Return the square of the scaled distance from q to `home`; write the difference to `target`.
    Held coordinates do not count.
    """
    far = 0.0
    for v in range(loops.nv):
        if is_held(loops, v):
            target[v] = 0.0
        elif read_sort(loops, v) == L.BALL_FIRST:
            write_ball_difference(loops.q, home, find_place(loops, v), target, v)
        elif read_sort(loops, v) != L.BALL_MORE:
            i = find_place(loops, v)
            target[v] = (home[i] - loops.q[i]) / read_velocity_number(loops, 0, v)
    for v in range(loops.nv):
        far += target[v] * target[v]
    return far


@device
def choose_nearest_angle(x, to):
    """Return the angle x plus whole turns, as near as possible to the angle `to`."""
    return x - 2.0 * math.pi * math.ceil((x - to) / (2.0 * math.pi) - 0.5)


@device
def write_quaternion(r, q, i, home):
    """Write the unit quaternion of the rotation r to q[i:], of the sign that is nearer to home[i:]."""
    if r[0] + r[4] + r[8] > 0.0:
        w = 1.0 + r[0] + r[4] + r[8]
        x = r[7] - r[5]
        y = r[2] - r[6]
        z = r[3] - r[1]
    elif r[0] >= r[4] and r[0] >= r[8]:
        w = r[7] - r[5]
        x = 1.0 + r[0] - r[4] - r[8]
        y = r[1] + r[3]
        z = r[2] + r[6]
    elif r[4] >= r[8]:
        w = r[2] - r[6]
        x = r[1] + r[3]
        y = 1.0 - r[0] + r[4] - r[8]
        z = r[5] + r[7]
    else:
        w = r[3] - r[1]
        x = r[2] + r[6]
        y = r[5] + r[7]
        z = 1.0 - r[0] - r[4] + r[8]
    size = math.sqrt(w * w + x * x + y * y + z * z)
    if w * home[i] + x * home[i + 1] + y * home[i + 2] + z * home[i + 3] < 0.0:
        size = -size
    q[i] = w / size
    q[i + 1] = x / size
    q[i + 2] = y / size
    q[i + 3] = z / size


@routine
def write_cut_coordinates(loops, home):
    """Write the coordinates of cut joints to q, with angles shifted by whole turns near to `home`.

    The poses must be those of q. Angles of crosses and of three turns are as in `joints`.
    """
    plan = loops.plan
    q = loops.q
    for n in range(plan[L.N_READINGS]):
        k = plan[L.AT_READINGS] + L.READING_INTS * n
        code = plan[k]
        i = plan[k + 1]
        r_a, p_a, r_b, p_b = read_tie_ends(loops, plan[k + 2])
        p = rotate_vector_back(r_a, p_b[0] - p_a[0], p_b[1] - p_a[1], p_b[2] - p_a[2])
        r = compute_relative_rotation(r_a, r_b)
        if code <= L.READ_Z:
            q[i] = p[code]
        elif code == L.READ_QUATERNION:
            write_quaternion(r, q, i, home)
        else:
            # READ_ANGLE
            sine = r[3] - r[1]
            cosine = r[0] + r[4]
            if code == L.READ_RX:
                sine = r[7]
                cosine = r[4]
            elif code == L.READ_RY:
                sine = r[2]
                cosine = r[0]
            elif code == L.READ_YAW:
                sine = r[3]
                cosine = r[0]
            elif code == L.READ_PITCH:
                sine = -r[6]
                cosine = math.sqrt(r[0] * r[0] + r[3] * r[3])
            elif code == L.READ_ROLL:
                sine = r[7]
                cosine = r[8]
            q[i] = choose_nearest_angle(atan2(sine, cosine), home[i])
    for v in range(loops.nv):
        if read_sort(loops, v) == L.CIRCLE and not is_held(loops, v):
            i = find_place(loops, v)
            q[i] = choose_nearest_angle(q[i], home[i])


@routine
def draw_configuration(loops, home, spread, key):
    """Write a random configuration to q: unknowns within `spread` of their range about `home`, or
    anywhere for 1.
    """
    q = loops.q
    copy_numbers(q, home, 0, loops.nq)
    for v in range(loops.nv):
        if is_held(loops, v):
            continue
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        fresh = mix_bits(key, np.uint64(v))
        if sort == L.BALL_FIRST:
            if spread >= 1.0:
                draw_quaternion(q, i, fresh)
            else:
                t = 2.0 * math.pi * spread
                a = mix_bits(fresh, np.uint64(0))
                b = mix_bits(fresh, np.uint64(1))
                c = mix_bits(fresh, np.uint64(2))
                turn_quaternion(
                    q,
                    i,
                    t * (to_unit_interval(a) - 0.5),
                    t * (to_unit_interval(b) - 0.5),
                    t * (to_unit_interval(c) - 0.5),
                )
        elif sort != L.BALL_MORE:
            low = read_velocity_number(loops, 3, v)
            high = read_velocity_number(loops, 4, v)
            if spread >= 1.0:
                q[i] = low + (high - low) * to_unit_interval(fresh)
            else:
                x = home[i] + spread * (high - low) * (to_unit_interval(fresh) - 0.5)
                q[i] = min(
                    max(x, read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v)
                )


@routine
def prepare_start(loops, home):
    """Bring quaternions at q to norm 1, copy it to `home`, and bring the unknowns at q inside their
    limits; return whether the start is finite.
    """
    q = loops.q
    copy_numbers(home, q, 0, loops.nq)
    good = True
    for v in range(loops.nv):
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        if sort == L.BALL_FIRST:
            w = q[i]
            x = q[i + 1]
            y = q[i + 2]
            z = q[i + 3]
            size = math.sqrt(w * w + x * x + y * y + z * z)
            good = good and 0.0 < size < LARGEST
            q[i], q[i + 1], q[i + 2], q[i + 3] = w / size, x / size, y / size, z / size
            copy_numbers(advance_pointer(home, i), advance_pointer(q, i), 0, 4)
        elif sort != L.BALL_MORE:
            good = good and abs(q[i]) < LARGEST
            if not is_held(loops, v):
                q[i] = min(
                    max(q[i], read_velocity_number(loops, 1, v)), read_velocity_number(loops, 2, v)
                )
    return good


@device
def extrapolate_unknowns(loops, done, i):
    """Extrapolate the unknowns of q from rows i - 2 and i - 1 of `done`."""
    last = (i - 1) * loops.nq
    nq = loops.nq
    for v in range(loops.nv):
        if is_held(loops, v):
            continue
        sort = read_sort(loops, v)
        k = find_place(loops, v)
        if sort == L.BALL_FIRST:
            copy_numbers(advance_pointer(loops.q, k), done, last + k, 4)
        elif sort != L.BALL_MORE:
            before = done[last - nq + k] if i > 1 else done[last + k]
            loops.q[k] = 2.0 * done[last + k] - before
