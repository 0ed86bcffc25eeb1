"""What is said of singular configurations: sets that are singular in the same way, and the nearest
of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.calls import brief, explained_methods
from kempe.kinematics.common.result import Report
from kempe.kinematics.one_sided import one_sided_rows
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, counted, joined

if TYPE_CHECKING:
    from kempe.analysis.spaces.singular.rank_questions import LostAndGained
    from kempe.model.system import System

SAME = 1e-5
"""Difference of coordinates, in radians and metres, up to which they are the same."""


@dataclass(frozen=True, eq=False)
class SingularSet(InWords):
    """Configurations that are singular in the same way.

    `kinds` are "serial" of a chain, and of closed loops some of "type 1", "type 2" and
    "constraint". `name` is "shoulder", "elbow" or "wrist" where the arm has such, else "".
    `coordinates` are those that decide whether a configuration is in the set, and `values` (k, n)
    theirs, where they are isolated; elsewhere it has no rows. `dimension` is that of the set; `q`
    (m, nq) are the configurations that were found.
    """

    __repr__ = brief

    kinds: tuple[str, ...]
    name: str
    coordinates: tuple[str, ...]
    values: Array
    dimension: int
    q: Array
    local: tuple[LostAndGained, ...] = field(repr=False)
    """What is lost and gained at each of `q`."""
    places: tuple[int, ...] = field(default=(), repr=False)
    """Where the `coordinates` are in q."""

    @property
    def lost(self) -> tuple[Array, ...]:
        """Twists (k, 6), [linear; angular] at the frame along the axes of the ground, that the
        frame has lost.
        """
        return tuple(x.lost for x in self.local)

    @property
    def gained(self) -> tuple[Array, ...]:
        """Twists (k, 6) that the frame has while all inputs are held."""
        return tuple(x.gained for x in self.local)

    @property
    def self_motion(self) -> tuple[Array, ...]:
        """Velocities (k, nv) that leave the frame where it is."""
        return tuple(x.self_motion for x in self.local)

    def __str__(self) -> str:
        head = self.name or " and ".join(self.kinds)
        if not len(self.values):
            single = f": {counted(len(self.q), 'configuration')}" if self.dimension == 0 else ""
            return f"{head} ({joined(self.coordinates)})" if self.coordinates else head + single
        if len(self.coordinates) == 1:
            return (
                f"{head} ({self.coordinates[0]} = "
                f"{' or '.join(f'{x:.4g}' for x in self.values[:, 0])})"
            )
        points = [f"({', '.join(f'{x:.4g}' for x in row)})" for row in self.values[:4]]
        more = f" and {len(self.values) - 4} more" if len(self.values) > 4 else ""
        return f"{head} ({', '.join(self.coordinates)} = {' or '.join(points)}{more})"

    def data(self) -> dict[str, Any]:
        """Its numbers and names."""
        names = (
            "kinds",
            "name",
            "coordinates",
            "values",
            "dimension",
            "q",
            "lost",
            "gained",
            "self_motion",
        )
        values: dict[str, Any] = {n: getattr(self, n) for n in names}
        several = [n for n in names[-3:] if isinstance(values[n], tuple)]
        return values | {n: [np.asarray(x) for x in values[n]] for n in several}


@explained_methods
@dataclass(frozen=True, eq=False)
class NearestSingular(Report):
    """The singular configuration `q` (nq,) that is nearest to one, of those found, at a `distance`.

    Angles count in radians and lengths in characteristic lengths. `kinds`, `name`, and what is lost
    and gained there, are as in `SingularSet`; `distances` are those of all sets, by their words.
    """

    __repr__ = brief

    q: Array
    distance: float
    kinds: tuple[str, ...]
    name: str
    lost: Array
    gained: Array
    self_motion: Array
    distances: dict[str, float]
    code: Any = Status.SOLVED

    @property
    def status(self) -> str:
        """Which is the nearest, and how far it is."""
        if self.code is not Status.SOLVED:
            return "no singular configuration was found"
        what = self.name or " and ".join(self.kinds)
        if self.distance < SAME:
            return f"singular ({what}): {changes(self.lost, self.gained)}"
        return f"the nearest singular configuration found ({what}) is {self.distance:.4g} away"

    def _lines(self) -> list[str]:
        return [
            f"{name}: {x:.4g} away"
            for name, x in sorted(self.distances.items(), key=lambda row: row[1])
        ]

    def _data(self) -> dict[str, Any]:
        names = ("q", "distance", "kinds", "name", "lost", "gained", "self_motion", "distances")
        return {n: getattr(self, n) for n in names}


def changes(lost: Array, gained: Array) -> str:
    """How many directions are lost and gained, in words."""
    said = [f"{counted(len(lost), 'direction')} lost"] if len(lost) else []
    said += [f"{counted(len(gained), 'direction')} gained"] if len(gained) else []
    return " and ".join(said) or "no direction of a frame lost or gained"


def inside_limits(system: System, q: Array) -> np.ndarray:
    """Whether configurations (k, nq) are inside the limits and hold the one-sided constraints."""
    return np.asarray((one_sided_rows(system).beyond(q) <= SAME).all(axis=1))
