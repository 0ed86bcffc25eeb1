"""Where the inverse kinematics starts, and how its answer is brought back into the limits."""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.random import mix, unit
from kempe.kernels.base.rotations import draw_ball
from kempe.kernels.base.scratch import copy
from kempe.kernels.base.search_layout import LARGEST
from kempe.kernels.one_frame.residual import BOX_STRIDE, HIGH, LOW, SCALE
from kempe.kernels.one_frame.step import is_round, place_of

NUDGE = 0.02
"""Size of the region about the middle of the limits, as a part of their range, in which the first
start lies.

The exact middle is often singular (a stretched arm), where no step leads out."""


LATE = 64
WIDER = 2.0
"""Every other start from this one on is drawn from so much of the range that half of the
coordinates are at a limit."""


@device
def spread_of(count):
    """Part of the limits from which start `count` after the seeds is drawn: late ones crowd at the
    limits.
    """
    if count >= LATE and count % 2 == 1:
        return WIDER
    return NUDGE if count == 0 else min(0.75 + 0.05 * count, 1.35)


@routine
def draw(chain, home, key, spread):
    """Write a random configuration to q: uniform in `spread` times the limits' range, cut off at
    them.

    Where a limit is missing, the range is a turn, or twice the chain's length, about `home`.
    """
    q = chain.q
    box = chain.box
    copy(q, home, 0, chain.nq)
    v = 0
    while v < chain.nv:
        i = place_of(chain, v)
        low = box[BOX_STRIDE * v + LOW]
        high = box[BOX_STRIDE * v + HIGH]
        fresh = mix(key, np.uint64(v))
        if is_round(chain, v):
            if spread > NUDGE:
                draw_ball(q, i, fresh)
            v += 3
            continue
        if i >= 0:
            part = spread
            if low < -LARGEST or high > LARGEST:
                half = math.pi if box[BOX_STRIDE * v + SCALE] == 1.0 else chain.length
                low = max(low, home[i] - half)
                high = min(high, low + 2.0 * half)
                low = max(box[BOX_STRIDE * v + LOW], high - 2.0 * half)
                part = min(spread, 1.0)
            x = 0.5 * (low + high) + part * (unit(fresh) - 0.5) * (high - low)
            q[i] = min(max(x, low), high)
        v += 1


@routine
def take(chain, seeds, k):
    """Whether the configuration seeds[k:] is sound; writes it to q, inside the solver's limits."""
    q = chain.q
    box = chain.box
    sound = True
    copy(q, seeds, k, chain.nq)
    v = 0
    while v < chain.nv:
        i = place_of(chain, v)
        if is_round(chain, v):
            w = q[i]
            x = q[i + 1]
            y = q[i + 2]
            z = q[i + 3]
            size = math.sqrt(w * w + x * x + y * y + z * z)
            sound = sound and 0.0 < size < LARGEST
            q[i], q[i + 1], q[i + 2], q[i + 3] = w / size, x / size, y / size, z / size
            v += 3
            continue
        if i >= 0:
            sound = sound and abs(q[i]) < LARGEST
            q[i] = min(max(q[i], box[BOX_STRIDE * v + LOW]), box[BOX_STRIDE * v + HIGH])
        v += 1
    return sound


@routine
def middle(chain, limits, home):
    """Write to `home` (nq,) the middle of the limits of each coordinate; the identity for
    quaternions.

    Where a limit is missing it is the allowed value nearest to 0.
    """
    for k in range(chain.nq):
        home[k] = 0.0
    v = 0
    while v < chain.nv:
        i = place_of(chain, v)
        low = limits[v]
        high = limits[chain.nv + v]
        if is_round(chain, v):
            home[i] = 1.0
            v += 3
            continue
        if i >= 0:
            home[i] = (
                0.5 * (low + high)
                if low > -LARGEST and high < LARGEST
                else min(max(0.0, low), high)
            )
        v += 1


@routine
def wrap(chain, limits, circular, home):
    """Turn circular coordinates of q by whole turns: into the limits, there as near to `home` as
    can be.
    """
    for v in range(chain.nv):
        i = place_of(chain, v)
        low = limits[v]
        high = limits[chain.nv + v]
        if circular[v] != 0 and i >= 0:
            x = chain.q[i]
            near = min(max(home[i], low), high)
            x -= 2.0 * math.pi * math.ceil((x - near) / (2.0 * math.pi) - 0.5)
            if x > high:
                x -= 2.0 * math.pi
            elif x < low:
                x += 2.0 * math.pi
            chain.q[i] = min(max(x, low), high)
