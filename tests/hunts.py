"""The cases of hunts and properties, which look for counter-examples.

The fixture `hunt` of conftest.py gives a `Hunt` to a test; properties say
`@settings(max_examples=examples(60))`.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

QUICK = 0.25
"""The part of the cases that the default suite runs; `--hunt-times 1` runs all of them."""
TIMES = QUICK
"""The factor on the number of cases, which conftest.py reads from the command line."""


def examples(count: int) -> int:
    """Examples of a property that asks for so many, times the factor of the command line; at least
    five.
    """
    return max(5, round(count * TIMES))


def some(rows: Iterable[Any], of: int) -> list[Any]:
    """Rows of a battery, of which the default suite runs one of so many; the others have the mark
    `rest`.
    """
    return [row if i % of == 0 else _marked(row) for i, row in enumerate(rows)]


def part(rows: Iterable[Any]) -> list[Any]:
    """An even part of the rows of a long battery: all with `--hunt-times 1` and more, half of them
    with 0.5.
    """
    return list(rows)[:: max(1, round(1.0 / TIMES))]


def _marked(row: Any) -> Any:
    values, marks, name = (
        (row.values, row.marks, row.id) if hasattr(row, "marks") else (None, (), None)
    )
    values = values or (row if isinstance(row, tuple) else (row,))
    return pytest.param(*values, marks=(*marks, pytest.mark.rest), id=name)


class Hunt:
    """Seeded random cases in search of a counter-example to something that Kempe says."""

    def __init__(self, seed: int, times: float, name: str) -> None:
        self.seed = seed
        self._times = times
        self._name = name

    def rng(self) -> np.random.Generator:
        """Random numbers of this test under the seed of the command line."""
        return np.random.default_rng([self.seed, zlib.crc32(self._name.encode())])

    def cases(self, count: int, least: int = 1) -> int:
        """As many cases as the test asks for, times the factor of the command line; at least so
        many.
        """
        return max(least, round(count * self._times))
