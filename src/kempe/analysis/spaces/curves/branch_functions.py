"""A curve of configurations as branches over one coordinate, each of which exists where functions
are positive.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.common.enclosures import UNIT, Enclosure, constant
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

LIMIT = -1
SOUND = -2
"""Kinds of functions beside the numbers of the signs that flip where they are zero: a limit, and
what is never zero."""
Function = tuple[Enclosure, int]
"""A function that is positive where a branch exists, and its kind."""


@dataclass(frozen=True, eq=False)
class BranchFunctions:
    """The branches of a mechanism over one coordinate `name` from `low` to `high`, which meet if it
    `closes`.

    `signs` is the number of their signs, `functions(x, signs)` are those that are positive where
    branches exist, for the coordinate as an enclosure of n intervals, and signs (n, signs).
    """

    system: System
    name: str
    low: float
    high: float
    closes: bool
    signs: int
    functions: Callable[[Enclosure, Array], list[Function]] = field(repr=False)
    at: Callable[[Array, Array], Array] = field(repr=False)
    """Configurations (n, nq) for values (n,) of the coordinate and signs (n, signs)."""
    signs_of: Callable[[Array], Array] = field(repr=False)
    """Signs (n, signs) of configurations (n, nq); 0 where two branches meet, nearly."""

    @property
    def place(self) -> int:
        """The place of the coordinate in q."""
        return self.system.coordinate_names.index(self.name)


def within_turn(angle: tuple[Enclosure, Enclosure], low: float, high: float) -> list[Function]:
    """What is positive where an angle is between two limits less than a turn apart."""
    if not (math.isfinite(low) or math.isfinite(high)):
        return []
    mid = 0.5 * (low + high)
    half = 0.5 * (high - low)
    edge = constant(np.array([math.cos(half)]), len(angle[0].mid) - 1, UNIT)
    return [(angle[0] * math.cos(mid) + angle[1] * math.sin(mid) - edge, LIMIT)]


def within(value: Enclosure, low: float, high: float) -> list[Function]:
    """What is positive where a length is between two limits."""
    return [
        (x, LIMIT)
        for x, bound in ((value - low, low), (high - value, high))
        if math.isfinite(bound)
    ]
