"""Random numbers as a pure function of counters: no state, so answers depend on nothing but the
arguments.

The generator is SplitMix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number
generators"), whose numbers can be had in any order; one sequence for each seed, goal and start.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MUL_A = np.uint64(0xBF58476D1CE4E5B9)
_MUL_B = np.uint64(0x94D049BB133111EB)
_ONE = np.uint64(1)
_S27 = np.uint64(27)
_S30 = np.uint64(30)
_S31 = np.uint64(31)
_S11 = np.uint64(11)


@device
def mix_bits(state, counter):
    """Return number `counter` of the random sequence that belongs to `state`, both uint64; the
    result can be the state of another sequence.
    """
    z = state + _STEP * (counter + _ONE)
    z = (z ^ (z >> _S30)) * _MUL_A
    z = (z ^ (z >> _S27)) * _MUL_B
    return z ^ (z >> _S31)


@device
def to_unit_interval(bits):
    """Convert the upper 53 bits of a uint64 to a number in [0, 1)."""
    return np.float64(bits >> _S11) * (1.0 / 9007199254740992.0)
