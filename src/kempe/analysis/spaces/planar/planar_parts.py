"""Planar regions made of others: where several hold, and where a circle about the point lies in
one.

So are places in one orientation, in several and in all of them, and those of parallel mechanisms:
each leg leaves a region of its own. Sources: Gosselin, Angeles, "The optimum kinematic design of a
planar three-degree-of-freedom parallel manipulator", J. Mechanisms 110 (1988); Merlet, Gosselin,
Mouly, "Workspaces of planar parallel manipulators", Mechanism and Machine Theory 33 (1998).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from kempe.analysis.spaces.planar.planar_chain import PlanarChain
from kempe.analysis.spaces.planar.planar_region import NOTHING, SAME, PlanarRegion, RegionOfArcs
from kempe.analysis.spaces.planar.plane_curves import TURN, PlaneCurve, PlanePiece, merged


@dataclass(frozen=True)
class RegionOfLegs(PlanarRegion):
    """The points that all parts hold; each combination of their ways is one where these are
    `counted`.
    """

    parts: tuple[PlanarRegion, ...]
    counted: bool = False
    is_curve: bool = False

    @property
    def size(self) -> float:
        """A length of the region."""
        return max(part.size for part in self.parts)

    @property
    def limited(self) -> int:
        """How many joints with limits one chain has at most."""
        return max(part.limited for part in self.parts)

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which it can end; of many parts those that bound what either half
        of them holds.
        """
        if self.counted or len(self.parts) < 3:
            return merged([c for part in self.parts for c in part.candidates], SAME * self.size)
        half = len(self.parts) // 2
        halves = (RegionOfLegs(self.parts[:half]), RegionOfLegs(self.parts[half:]))
        return merged([c for part in halves for c in part.ends], SAME * self.size)

    def solutions(self, p: complex) -> int:
        """In how many ways a point is reached."""
        ways = 1
        for part in self.parts:
            ways *= part.solutions(p)
            if not ways:
                break
        return ways

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are on no boundary, are inside all parts."""
        return np.all([part.holds(p) for part in self.parts], axis=0)


@dataclass(frozen=True)
class Surrounded(RegionOfArcs):
    """The points about which a whole circle of a radius lies in the `inner` region."""

    inner: RegionOfArcs
    radius: float
    counted: bool = False
    is_curve: bool = False

    @property
    def size(self) -> float:
        """A length of the region."""
        return self.inner.size + self.radius

    @property
    def limited(self) -> int:
        """How many joints of its chain have limits."""
        return self.inner.limited

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which it can end: beside those that bound the inner one, and
        about their ends.
        """
        found: list[PlanePiece] = []
        for piece in cast("list[PlanePiece]", self.inner.ends):
            if piece.is_arc:
                radii = (piece.radius + self.radius, abs(piece.radius - self.radius))
                found += [
                    PlanePiece(piece.centre, r, 0.0, TURN) for r in radii if r > SAME * self.size
                ]
            else:
                beside = 1j * piece.way / abs(piece.way) * self.radius
                found += [
                    PlanePiece(piece.centre + s * beside, 0.0, way=piece.way) for s in (1.0, -1.0)
                ]
            found += [PlanePiece(complex(piece.at(t)), self.radius, 0.0, TURN) for t in (0.0, 1.0)]
        return merged(found, SAME * self.size)

    def solutions(self, p: complex) -> int:
        """1 for a point that it holds, else 0."""
        circle = PlanePiece(p, self.radius, 0.0, TURN)
        t = np.unique(
            np.concatenate([[0.0, 1.0], *[circle.meets(end) for end in self.inner.ends]]).clip(
                0.0, 1.0
            )
        )
        return int(self.inner.holds(circle.at(0.5 * (t[1:] + t[:-1]))).all())


def wrist_of(chain: PlanarChain) -> tuple[PlanarChain, complex] | None:
    """The chain without its last joint, up to the axis of that, and the way from there to the tip;
    None without one.

    The last joint must turn without limits: then the orientation is free, wherever the axis is.
    """
    last = chain.joints[-1]
    if last.axis is None or last.limits:
        return None
    inner = PlanarChain.of(chain.joints[:-1], last.axis)
    return (inner, chain.tip - last.axis) if inner.joints else None


def in_all_orientations(chain: PlanarChain) -> PlanarRegion | None:
    """Where the tip is reached in all orientations; None where the last joint does not turn without
    limits.
    """
    if (found := wrist_of(chain)) is None:
        return None
    inner, way = found
    return inner if abs(way) < NOTHING * chain.size else Surrounded(inner, abs(way))


def in_one_orientation(chain: PlanarChain, turn: float) -> PlanarChain | None:
    """Where the tip is reached with the last body turned by an angle from where it is while all
    joints are at zero.
    """
    if (found := wrist_of(chain)) is None:
        return None
    inner, way = found
    return inner.moved(way * complex(np.exp(1j * turn)))
