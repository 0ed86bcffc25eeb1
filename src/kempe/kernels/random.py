"""Random numbers as a pure function of counters: no state, so answers depend on nothing but the arguments.

The mixer is the finaliser of SplitMix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number
generators"), applied once for each counter.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels._jit import device

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MUL_A = np.uint64(0xBF58476D1CE4E5B9)
_MUL_B = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)


@device
def mix(state: int, counter: int) -> int:
    """Next key (uint64) of a chain of counters: well spread in every bit of both arguments."""
    z = np.uint64(state) + _STEP * (np.uint64(counter) + np.uint64(1))
    z = (z ^ (z >> _S30)) * _MUL_A
    z = (z ^ (z >> _S27)) * _MUL_B
    return z ^ (z >> _S31)


@device
def unit(key: int) -> float:
    """Number in [0, 1) from the upper 53 bits of a key."""
    return np.float64(np.uint64(key) >> _S11) * (1.0 / 9007199254740992.0)
