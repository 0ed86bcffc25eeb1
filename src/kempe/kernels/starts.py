"""Where the inverse kinematics starts, and how its answer is brought back into the limits."""

from __future__ import annotations

import math

from kempe.kernels._jit import device, routine
from kempe.kernels.random import mix, unit
from kempe.kernels.residual import BOX_STRIDE, HIGH, LOW, SCALE
from kempe.kernels.step import is_round, place_of

NUDGE = 0.02
"""Size of the region about the middle of the limits, as a part of their range, in which the first start lies.

The exact middle is often singular (a stretched arm), where no step leads out."""


@device
def draw_ball(q, i, key):
    """Write a uniformly distributed unit quaternion to q[i : i + 4] (Shoemake 1992)."""
    u, a, b = unit(mix(key, 0)), 2.0 * math.pi * unit(mix(key, 1)), 2.0 * math.pi * unit(mix(key, 2))
    q[i], q[i + 1] = math.sqrt(1.0 - u) * math.sin(a), math.sqrt(1.0 - u) * math.cos(a)
    q[i + 2], q[i + 3] = math.sqrt(u) * math.sin(b), math.sqrt(u) * math.cos(b)


@routine
def draw(chain, home, key, spread):
    """Write a random configuration to q: uniform in the part `spread` of the limits about their middle.

    Where a limit is missing, the range is a turn, or twice the chain's length, about `home`.
    """
    q, box = chain.q, chain.box
    v = 0
    while v < chain.nv:
        i, low, high = place_of(chain, v), box[BOX_STRIDE * v + LOW], box[BOX_STRIDE * v + HIGH]
        if is_round(chain, v):
            if spread < 1.0:
                for k in range(4):
                    q[i + k] = home[i + k]
            else:
                draw_ball(q, i, mix(key, v))
            v += 3
            continue
        if low == -math.inf or high == math.inf:
            half = math.pi if box[BOX_STRIDE * v + SCALE] == 1.0 else chain.length
            low = max(low, home[i] - half)
            high = min(high, low + 2.0 * half)
            low = max(box[BOX_STRIDE * v + LOW], high - 2.0 * half)
        part = 0.5 + spread * (unit(mix(key, v)) - 0.5)
        q[i] = min(max(low + part * (high - low), low), high)
        v += 1


@routine
def take(chain, seeds, k):
    """Whether the configuration seeds[k:] is sound; writes it to q, inside the solver's limits."""
    q, box = chain.q, chain.box
    v = 0
    while v < chain.nv:
        i = place_of(chain, v)
        if is_round(chain, v):
            w, x, y, z = seeds[k + i], seeds[k + i + 1], seeds[k + i + 2], seeds[k + i + 3]
            size = math.sqrt(w * w + x * x + y * y + z * z)
            if not 0.0 < size < math.inf:
                return False
            q[i], q[i + 1], q[i + 2], q[i + 3] = w / size, x / size, y / size, z / size
            v += 3
        else:
            if not math.isfinite(seeds[k + i]):
                return False
            q[i] = min(max(seeds[k + i], box[BOX_STRIDE * v + LOW]), box[BOX_STRIDE * v + HIGH])
            v += 1
    return True


@routine
def middle(chain, limits, home):
    """Write the middle of the limits to `home`; the nearest to zero where one is missing, no turn for balls."""
    v = 0
    while v < chain.nv:
        i, low, high = place_of(chain, v), limits[v], limits[chain.nv + v]
        if is_round(chain, v):
            home[i], home[i + 1], home[i + 2], home[i + 3] = 1.0, 0.0, 0.0, 0.0
            v += 3
            continue
        home[i] = 0.5 * (low + high) if low > -math.inf and high < math.inf else min(max(0.0, low), high)
        v += 1


@routine
def wrap(chain, limits, circular, home):
    """Turn the circular coordinates of q by whole turns: inside the limits, and there as near to `home` as can be."""
    for v in range(chain.nv):
        if circular[v] != 0:
            i, low, high = place_of(chain, v), limits[v], limits[chain.nv + v]
            x = chain.q[i]
            x -= 2.0 * math.pi * math.ceil((x - home[i]) / (2.0 * math.pi) - 0.5)
            if x > high:
                x -= 2.0 * math.pi
            elif x < low:
                x += 2.0 * math.pi
            chain.q[i] = min(max(x, low), high)
