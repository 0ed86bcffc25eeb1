"""Regions of the plane that are bounded by pieces of curves: of candidates those with the region on
one side only.
"""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import Any, cast

import numpy as np

from kempe.analysis.spaces.planar.plane_curves import TURN, PlaneCurve, PlanePiece

NOTHING = 1e-12
SAME = 1e-10
"""Difference, in sizes of a region, up to which circles and lines are the same."""
BESIDE = 1e-6
"""How far beside a curve points are tried, in sizes of a region, at most as a part of the curve's
length, and nearer where another curve is near."""
PART = 0.02


class PlanarRegion:
    """A region by the curves on which it can end, and by what it says of single points."""

    size: Any
    """A length of it in metres."""
    candidates: Any
    """Pieces of all curves on which it can end: a list of `PlaneCurve`."""
    counted: Any
    """Whether `solutions` counts, or else is 0 or 1."""
    is_curve: Any
    """Whether it is a curve, without area."""

    @property
    def limited(self) -> int:
        """How many joints with limits one chain has at most: the work grows with a power of that."""
        raise NotImplementedError

    def solutions(self, p: complex) -> int:
        """In how many ways a point that is on no candidate is reached."""
        raise NotImplementedError

    @cached_property
    def ends(self) -> list[PlaneCurve]:
        """The boundary of the workspace: pieces that have the workspace to their left only."""
        return [p for p, left, right in self.sides if left and not right]

    @cached_property
    def sides(self) -> list[tuple[PlaneCurve, int, int]]:
        """Pieces of the candidates, cut where these meet, with the numbers of solutions to the left
        and to the right.

        Each piece is directed so that the number to its left is no less.
        """
        out: list[tuple[PlaneCurve, int, int]] = []
        for piece in self.candidates:
            cuts = [piece.meets(other) for other in self.candidates]
            t = np.unique(np.concatenate([[0.0, 1.0], *cuts]).clip(0.0, 1.0))
            t = t[np.concatenate([[True], np.diff(t) * piece.length > 10.0 * SAME * self.size])]
            t[-1] = 1.0
            for a, b in itertools.pairwise(t):
                part = piece.part(a, b)
                middle = complex(part.at(0.47))
                others = (
                    float(c.distance(np.asarray(middle))) for c in self.candidates if c is not piece
                )
                thin = min((0.3 * x for x in others if x > 0.1 * SAME * self.size), default=np.inf)
                beside = min(BESIDE * self.size, PART * part.length, thin) * 1j * part.tangent(0.47)
                left, right = (self.solutions(middle + s * beside) for s in (1.0, -1.0))
                if left >= right:
                    out.append((part, left, right))
                else:
                    out.append((part.part(1.0, 0.0), right, left))
        return out

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are not on the boundary, are inside it."""
        raise NotImplementedError


class RegionOfArcs(PlanarRegion):
    """A region that is bounded by arcs and segments only."""

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are not on the boundary, are inside it: by how often this
        goes round them.
        """
        z = np.asarray(p)
        turns = sum(
            (_turn_about(cast(PlanePiece, piece), z) for piece in self.ends), np.zeros(z.shape)
        )
        return np.round(turns / TURN) != 0


def _turn_about(piece: PlanePiece, p: np.ndarray) -> np.ndarray:
    """The angles by which the way from points (...) to a point turns as this goes along a piece."""
    a = complex(piece.at(0.0)) - p
    b = complex(piece.at(1.0)) - p
    if not piece.is_arc:
        return np.angle(b * a.conj())
    # along the arc the angle is that of the chord, and a full turn more where p lies between the
    # two
    parts = max(1, int(np.ceil(abs(piece.sweep) / 1.5)))
    total = np.zeros(p.shape)
    for k in range(parts):
        small = piece.part(k / parts, (k + 1) / parts)
        ends = complex(small.at(0.0)), complex(small.at(1.0))
        inside = np.abs(p - small.centre) < small.radius
        side = np.sign(small.sweep)
        beyond = np.imag((p - ends[0]) * np.conj(ends[1] - ends[0])) * side < 0.0
        total += np.angle((ends[1] - p) * (ends[0] - p).conj()) + TURN * side * (inside & beyond)
    return total
