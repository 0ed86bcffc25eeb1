"""The workspace of a planar chain or mechanism, exactly: its boundary, area, voids, and how many
solutions.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.spaces.kinds.questions import (
    DEXTEROUS,
    ORIENTATION,
    REACHABLE,
    WorkspaceKind,
    question_of,
)
from kempe.analysis.spaces.planar.planar_of_systems import planar_region
from kempe.analysis.spaces.planar.planar_region import PlanarRegion
from kempe.analysis.spaces.planar.plane_curves import PlaneCurve
from kempe.calls import brief, explained, explained_methods, numbers
from kempe.errors import InputError, UnsupportedError
from kempe.kinematics.common.result import Report
from kempe.late import late
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted, joined

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.system import FrameLike, System

MEET = 1e-7
"""How far ends of pieces may be apart, in sizes of the chain, to be the same corner."""


@dataclass(frozen=True, eq=False)
class SolutionRegion:
    """Points that are reached in the same number of `solutions` (None: infinitely many), their
    `area` and `boundary`.

    The boundary has the region to its left. `loops` are its closed curves: those with a negative
    area go round voids.
    """

    __repr__ = brief

    solutions: int | None
    area: float
    boundary: tuple[PlaneCurve, ...]
    loops: tuple[tuple[PlaneCurve, ...], ...] = field(repr=False)


@explained_methods
@dataclass(frozen=True, eq=False)
class PlanarWorkspace(Report):
    """The points of the plane that the origin of a frame reaches, within the limits, exactly.

    `boundary` are arcs of circles, segments and pieces of coupler curves that have the workspace to
    their left; `regions` tell how many solutions there are where. The `kind` says in which
    orientations, as in `System.workspace`. Lengths are in metres.
    """

    _pictured = True

    __repr__ = brief

    system: System
    frame: str
    region: PlanarRegion = field(repr=False)
    kind: str = REACHABLE
    code: Any = Status.SOLVED

    @cached_property
    def boundary(self) -> tuple[PlaneCurve, ...]:
        """The pieces of curves that bound it; of a single joint the curve that it is."""
        return tuple(self.region.candidates if self.region.is_curve else self.region.ends)

    @cached_property
    def area(self) -> float:
        """Its area in square metres, exact but for rounding."""
        return sum((r.area for r in self.regions), 0.0)

    @property
    def measure(self) -> float:
        """Its area, as what is measured of it."""
        return self.area

    @property
    def size(self) -> float:
        """A length of what it is made of."""
        return self.region.size

    @property
    def limited(self) -> int:
        """How many joints with limits one chain has at most: the work grows with a power of that."""
        return self.region.limited

    @cached_property
    def extent(self) -> Array:
        """The least and the largest x and y (2, 2) of its boundary in metres."""
        p = np.concatenate(
            [piece.extremes for piece in self.boundary] or [np.zeros(1, dtype=complex)]
        )
        x = np.stack([np.real(p), np.imag(p)])
        return np.stack([x.min(axis=1), x.max(axis=1)])

    @cached_property
    def regions(self) -> tuple[SolutionRegion, ...]:
        """For each number of solutions the points that have it; one region where solutions are not
        counted.
        """
        if self.region.is_curve:
            return ()
        sides = self.region.sides
        counts = sorted({n for _, left, right in sides for n in (left, right) if n > 0})
        out: list[SolutionRegion] = []
        for n in counts:
            edges = [
                p if left == n else p.part(1.0, 0.0)
                for p, left, right in sides
                if (left == n) != (right == n)
            ]
            out.append(
                SolutionRegion(
                    n if self.region.counted else None,
                    float(sum(p.moment for p in edges)),
                    tuple(edges),
                    _loops(edges, MEET * self.region.size),
                )
            )
        return tuple(out)

    @cached_property
    def voids(self) -> tuple[tuple[PlaneCurve, ...], ...]:
        """Closed curves round holes of the workspace."""
        loops = _loops(list(self.boundary), MEET * self.region.size) if self.regions else ()
        return tuple(loop for loop in loops if _area(loop) < 0.0)

    def contains(self, points: ArrayLike) -> Any:
        """Whether points (..., 2) or (..., 3) are reached: the boundary goes round them. On it
        rounding decides.

        Of a curve they are those within 1e-9 of its length.
        """
        p = self._points(points)
        if self.region.is_curve:
            out = np.asarray(self.distance(points) <= 1e-9 * self.region.size)
        else:
            finite = np.isfinite(p)
            out = finite & self.region.holds(np.where(finite, p, 0.0))
        return bool(out) if out.ndim == 0 else out

    def solutions(self, points: ArrayLike) -> Any:
        """In how many ways (...) points (..., 2) are reached, of chains or legs of two joints that
        decide the place.

        Errors: `UnsupportedError` for others.
        """
        if not self.region.counted:
            raise UnsupportedError(
                f"of {self.frame!r} solutions are not counted: they are where two joints decide "
                "the place, in one orientation or whatever it is"
            )
        p = self._points(points)
        out = np.array(
            [self.region.solutions(complex(x)) if np.isfinite(x) else 0 for x in p.ravel()],
            dtype=np.int64,
        )
        return int(out[0]) if p.ndim == 0 else out.reshape(p.shape)

    def distance(self, points: ArrayLike) -> Any:
        """Distances (...) >= 0, in metres, of points (..., 2) or (..., 3) from the boundary, inside
        or outside.

        They are infinite where the boundary is empty or a point is infinite, and NaN where a point
        is.
        """
        given = numbers(points, "points")
        self._points(given)
        xy = given[..., :2]
        finite = np.asarray(np.isfinite(xy).all(axis=-1))
        far = np.hypot(xy[..., 0], xy[..., 1])
        near = self._points(np.where(finite[..., None], xy, 0.0))
        best = np.full(finite.shape, np.inf)
        for piece in self.boundary:
            best = np.minimum(best, piece.distance(near))
        best = np.where(finite, best, far)
        best = np.hypot(best, given[..., 2]) if given.shape[-1] == 3 else best
        return float(best) if best.ndim == 0 else best

    def _points(self, points: ArrayLike) -> np.ndarray:
        p = numbers(points, "points")
        if p.ndim == 0 or p.shape[-1] not in (2, 3):
            raise InputError(f"points has shape {p.shape}; it must be (..., 2)")
        off = p.shape[-1] == 3 and p[..., 2] != 0.0
        out = np.empty(p.shape[:-1], dtype=complex)
        out.real = np.where(off, np.nan, p[..., 0])
        out.imag = p[..., 1]
        return out

    def plot(self, ax: Axes | None = None) -> Axes:
        """Matplotlib axes with the regions, darker where there are more solutions, and the
        boundary.
        """
        return late("plots of workspaces").plot_planar(self, ax)

    @property
    def status(self) -> str:
        """Its area and what bounds it."""
        of = f"{self.system.name}, {self.frame}" + (
            f" ({self.kind})" if self.kind != REACHABLE else ""
        )
        if self.region.is_curve:
            return f"{of}: a curve, without area"
        if not self.regions:
            return f"{of}: no place is reached"
        kinds = Counter(p.kind for p in self.boundary)
        pieces = joined([counted(n, kind) for kind, n in sorted(kinds.items())])
        voids = f", with {counted(len(self.voids), 'void')}" if self.voids else ""
        return f"{of}: area {self.area:.9g} m^2, bounded by {pieces}{voids}"

    def _lines(self) -> list[str]:
        return [
            f"{word_of(r, self.kind)}: {r.area:.9g} m^2, "
            f"{counted(sum(_area(x) > 0.0 for x in r.loops), 'part')}"
            for r in self.regions
        ]

    def _data(self) -> dict[str, Any]:
        regions = [{"solutions": r.solutions, "area": r.area} for r in self.regions]
        pieces = [p.data() for p in self.boundary]
        return {
            "system": self.system.name,
            "frame": self.frame,
            "kind": self.kind,
            "area": self.area,
            "regions": regions,
            "voids": len(self.voids),
            "boundary": pieces,
        }


def word_of(region: SolutionRegion, kind: str) -> str:
    """How often the points of a region are reached."""
    if region.solutions is not None:
        return counted(region.solutions, "solution")
    return "in all orientations" if kind == DEXTEROUS else "infinitely many solutions"


def _area(loop: tuple[PlaneCurve, ...]) -> float:
    return float(sum(p.moment for p in loop))


def _loops(pieces: list[PlaneCurve], same: float) -> tuple[tuple[PlaneCurve, ...], ...]:
    """The pieces as closed curves, each followed by one that begins where it ends: of several the
    leftmost.
    """
    out: list[tuple[PlaneCurve, ...]] = []
    starts = np.array([complex(p.at(0.0)) for p in pieces])
    used = np.zeros(len(pieces), dtype=bool)
    for first in range(len(pieces)):
        if used[first]:
            continue
        loop: list[PlaneCurve] = []
        k = first
        while True:
            used[k] = True
            loop.append(pieces[k])
            far = np.where(used, np.inf, np.abs(starts - complex(pieces[k].at(1.0))))
            far[first] = abs(starts[first] - complex(pieces[k].at(1.0)))
            along = pieces[k].tangent(1.0)
            near = np.flatnonzero(far <= same)
            turns = [float(np.angle(pieces[j].tangent(0.0) / along)) for j in near]
            if not len(near) or (k := int(near[np.argmax(turns)])) == first:
                break
        out.append(tuple(loop))
    return tuple(out)


@explained
def planar_workspace(
    system: System, frame: FrameLike, kind: str | None = None, orientation: Any = None
) -> PlanarWorkspace:
    """The exact workspace of the origin of a frame of a planar system of revolute and prismatic
    joints.

    `kind` and `orientation` are as in `System.workspace`; "dexterous" without orientations means
    all angles. Candidates for the boundary are arcs and segments on which joints are at limits or
    singular; the number of solutions of the inverse model on both sides decides which of them bound
    the workspace (see `kempe.analysis.spaces.planar.planar_chain`). Prismatic joints must have
    limits, revolute ones may.

    Of a mechanism with legs (see `kempe.analysis.spaces.kinds.legs`) places are those that all legs
    leave. The last joint of each chain must turn without limits where orientations count, and so
    must that of each leg, but of one where all others end at the frame's origin (see
    `kempe.analysis.spaces.planar.planar_platform`). Errors: `UnsupportedError` for all else:
    spatial systems, constraints, other loops, two legs that each leave a curve, coupled joints,
    chains with more than 6 joints; `InputError` for prismatic joints without limits and for frames
    that do not move.
    """
    name = system.structure.frame_name(frame)
    return planar_answer(system, name, question_of(system, name, kind, orientation, None))


def planar_answer(system: System, frame: str, question: WorkspaceKind) -> PlanarWorkspace:
    """The answer to a question. Errors: see `planar_workspace`."""
    if question.kind == ORIENTATION:
        raise UnsupportedError(
            "the exact workspace is one of places; one of orientations is a sampled map"
        )
    return PlanarWorkspace(system, frame, planar_region(system, frame, question), question.kind)
