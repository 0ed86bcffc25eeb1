"""Coordinates after a step of velocities, within limits, and steps after which no joint turns back.

`own` is a `Servo` or `Levels`: velocities (n,) are in the units of its `scale`.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import routine
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.scratch import copy_numbers
from kempe.kernels.servo.step_constants import BESIDE, EDGE, SLOW


@routine
def advance_configuration(own, q, velocity, dt, out):
    """Write the configuration after dt, quaternions normalised."""
    copy_numbers(out, q, 0, own.nq)
    for k in range(own.n):
        i = own.q_of[k]
        if i >= 0:
            out[i] += velocity[k] * own.scale[k] * dt
    for b in range(own.balls):
        k = own.ball_v[b]
        turn_quaternion(
            out,
            own.ball_q[b],
            velocity[k] * own.scale[k] * dt,
            velocity[k + 1] * own.scale[k + 1] * dt,
            velocity[k + 2] * own.scale[k + 2] * dt,
        )


@routine
def take_step(own, q, velocity, out):
    """Write the configuration after the step, with limits kept exactly where q kept them."""
    advance_configuration(own, q, velocity, own.dt, out)
    for k in range(own.n):
        i = own.q_of[k]
        if i >= 0:
            out[i] = min(max(out[i], min(own.lower[k], q[i])), max(own.upper[k], q[i]))


@routine
def compute_velocity_bounds(own, q, bounded, low, high):
    """Write bounds (n,) of velocities that keep limits of position, and of speed if `bounded`.

    What is outside its limits goes no further, and may rest: to stand still is always allowed.
    """
    for k in range(own.n):
        speed = own.fastest[k] if bounded else math.inf
        least = -speed
        most = speed
        i = own.q_of[k]
        if i >= 0:
            below = own.lower[k] - q[i]
            above = own.upper[k] - q[i]
            near = -EDGE * max(1.0, abs(q[i]))
            per = 1.0 / (own.dt * own.scale[k])
            least = max(least, below * per if below < near else 0.0)
            most = min(most, above * per if -above < near else 0.0)
        low[k] = least
        high[k] = most


@routine
def is_any_fast(own, velocity):
    """Return whether a velocity is above `SLOW` of the largest."""
    for j in range(own.n):
        if abs(velocity[j]) > SLOW * own.fastest[j]:
            return True
    return False


@routine
def is_turning_back(own, velocity, then):
    """Return whether a velocity changes its sign, where it is above `SLOW` of the largest before and
    after.
    """
    for j in range(own.n):
        least = SLOW * own.fastest[j]
        if abs(velocity[j]) > least and abs(then[j]) > least and velocity[j] * then[j] < 0.0:
            return True
    return False


@routine
def compute_slow_fraction(own, velocity):
    """Return the fraction of velocities of which none is above `SLOW` of the largest."""
    part = 1.0
    for j in range(own.n):
        least = SLOW * own.fastest[j]
        if abs(velocity[j]) > least:
            part = min(part, least / abs(velocity[j]))
    return part


@routine
def mark_limited(own, velocity, low, high, limited):
    """Mark velocities (n,) at a bound with 1, others with 0; return how many are marked."""
    count = 0
    for j in range(own.n):
        x = velocity[j]
        near = BESIDE * max(1.0, abs(x))
        limited[j] = 0.0
        if x <= low[j] + near or x >= high[j] - near:
            limited[j] = 1.0
            count += 1
    return count
