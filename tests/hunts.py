"""The cases of a hunt for counter-examples; the fixture `hunt` of conftest.py gives one to a test."""

from __future__ import annotations

import zlib

import numpy as np


class Hunt:
    """Seeded random cases in search of a counter-example to something that Kempe says."""

    def __init__(self, seed: int, times: float, name: str) -> None:
        self.seed = seed
        self._times, self._name = times, name

    def rng(self) -> np.random.Generator:
        """Random numbers of this test under the seed of the command line."""
        return np.random.default_rng([self.seed, zlib.crc32(self._name.encode())])

    def cases(self, count: int) -> int:
        """As many cases as the test asks for, times the factor of the command line; at least one."""
        return max(1, round(count * self._times))
