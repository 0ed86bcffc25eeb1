"""The exact workspace of a planar chain or mechanism: boundary, area, voids, numbers of solutions.

The region of a frame of a system is found here, too, from its chain or from its legs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explained, explained_methods, numbers
from kempe.errors import InputError, UnsupportedError
from kempe.forward.fk import fk, jacobian
from kempe.inverse.chain.serial_chain import obstacle
from kempe.late import late
from kempe.model.primitive_table import local_chain
from kempe.report import Report, brief
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted, joined
from kempe.workspace.kinds import (
    CONSTANT,
    DEXTEROUS,
    ORIENTATION,
    REACHABLE,
    WorkspaceKind,
    question_of,
)
from kempe.workspace.place_bounds import legs_of
from kempe.workspace.planar.planar_chain import (
    PlanarChain,
    PlanarJoint,
    RegionOfLegs,
    in_all_orientations,
    in_one_orientation,
    wrist_of,
)
from kempe.workspace.planar.planar_platform import PlatformLeg, RegionOfPlatform
from kempe.workspace.planar.plane_curves import NOTHING, PlanarRegion, PlaneCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike, Model


# ---- the region of a frame

AT_ORIGIN = 1e3 * NOTHING
"""Distance, in sizes of a chain, from which on points are different."""
MOST = 6
"""Joints that a chain may have: the work grows with a power of their number."""


def planar_region(system: Model, frame: str, question: WorkspaceKind) -> PlanarRegion:
    """The region of a question about a frame. Errors: `UnsupportedError`, `InputError`; see
    `planar_workspace`.
    """
    if system.dim != 2:
        raise UnsupportedError(
            f"{system.name} is a system in space: the exact workspace is that of planar ones"
        )
    if system._mechanism.constraints:
        declared = next(iter(system._mechanism.constraints))
        raise UnsupportedError(
            f"constraint {declared!r} of {system.name} may bound the workspace by other curves"
        )
    legs = legs_of(system, frame)
    if not legs:
        if (why := obstacle(system, frame)) is not None:
            raise UnsupportedError(why)
        legs = (system,)
    chains = [planar_chain(leg, frame) for leg in legs]
    if question.kind == REACHABLE:
        if len(chains) == 1:
            return _moving(chains[0], system, frame)
        turned = [_turn_at_zero(leg, frame) for leg in legs]
        return _of_platform(system, frame, chains, turned)
    if question.all_turns(2):
        return _together([_held(x, system, frame) for x in map(in_all_orientations, chains)], False)
    parts: list[PlanarRegion] = []
    for R in question.rotations:
        turn = float(np.arctan2(R[1, 0], R[0, 0]))
        for leg, chain in zip(legs, chains, strict=True):
            parts.append(
                _held(in_one_orientation(chain, turn - _turn_at_zero(leg, frame)), system, frame)
            )
    return _together(parts, question.kind == CONSTANT and all(p.counted for p in parts))


def at_zero(system: Model) -> Array:
    """The configuration (nq,) with all coordinates at zero, but for those that their limits hold."""
    q = system.neutral.copy()
    held = system.lower == system.upper
    q[held] = system.lower[held]  # planar coordinates and velocities have the same places
    return q


def _turn_at_zero(system: Model, frame: str) -> float:
    """The angle by which a frame is turned there."""
    R = fk(system, at_zero(system), frame)[:2, :2]
    return float(np.arctan2(R[1, 0], R[0, 0]))


def _held(part: PlanarRegion | None, system: Model, frame: str) -> PlanarRegion:
    """The part. Errors: `UnsupportedError` where there is none."""
    if part is None:
        raise UnsupportedError(
            f"the last joint before {frame!r} of {system.name}, or of a leg of it, does not turn "
            "without limits, or is all that moves it: where orientations count, its workspace has "
            "other curves"
        )
    return part


def _moving(chain: PlanarChain, system: Model, frame: str) -> PlanarChain:
    """The chain without joints that do not move the frame's origin. Errors: `InputError` where none
    does.
    """
    found = PlanarChain.of(chain.joints, chain.tip)
    if not found.joints:
        raise InputError(f"frame {frame!r} of {system.name} turns in its place: it does not move")
    return found


def _together(parts: Sequence[PlanarRegion], counted: bool) -> PlanarRegion:
    """One region of all parts. Errors: `UnsupportedError` where one of several is a curve."""
    if len(parts) == 1:
        return parts[0]
    if any(p.is_curve for p in parts):
        raise UnsupportedError(
            "a leg of the loop leaves a curve only: what several leave is a piece of it, or points"
        )
    return RegionOfLegs(tuple(parts), counted)


def _of_platform(
    system: Model, frame: str, chains: list[PlanarChain], turned: list[float]
) -> PlanarRegion:
    """The region of a frame at the end of legs, which are turned by angles where they are at zero.

    Legs whose last joint turns without limits at the frame's origin hold that in a region whatever
    the orientation, so that one other decides alone.
    """
    wrists = [wrist_of(c) for c in chains]
    held = [
        k
        for k, found in enumerate(wrists)
        if found is None or abs(found[1]) > AT_ORIGIN * chains[k].size
    ]
    own: list[PlanarRegion] = [
        found[0] for k, found in enumerate(wrists) if found is not None and k not in held
    ]
    if len(held) == 1:
        own.append(chains[held[0]])
    elif held:
        own.append(RegionOfPlatform(tuple(_platform_legs(system, frame, wrists, turned, held))))
    return _together(own, all(p.counted for p in own))


def _platform_legs(
    system: Model,
    frame: str,
    wrists: list[tuple[PlanarChain, complex] | None],
    turned: list[float],
    held: list[int],
) -> list[PlatformLeg]:
    """Legs that hold different points of the platform. Errors: `UnsupportedError`."""
    legs: list[PlatformLeg] = []
    for k in held:
        if (found := wrists[k]) is None:
            raise UnsupportedError(
                f"frame {frame!r} moves with the loops of {system.name}, and a leg of it does not "
                "end with a joint that turns without limits: its workspace has other curves"
            )
        inner, way = found
        b = complex(-way * np.exp(-1j * turned[k]))
        same = [i for i, leg in enumerate(legs) if abs(leg.b - b) <= AT_ORIGIN * inner.size]
        if same:
            legs[same[0]] = replace(
                legs[same[0]], region=_together([legs[same[0]].region, inner], False)
            )
        else:
            legs.append(PlatformLeg(inner, b))
    if sum(leg.region.is_curve for leg in legs) > 1:
        raise UnsupportedError(
            f"two of the legs of {system.name} leave frame {frame!r} a curve, which has no area"
        )
    return legs


def planar_chain(system: Model, frame: str) -> PlanarChain:
    """The chain that moves a frame. Errors: `UnsupportedError`, `InputError`; see
    `planar_workspace`.
    """
    table, q_index, v_index = local_chain(system.structure.table, frame)
    names = [system.coordinate_names[int(i)] for i in q_index]
    if not names:
        raise InputError(f"frame {frame!r} of {system.name} does not move")
    if len(table.iv) != len(v_index):
        raise UnsupportedError(
            f"the chain of {frame!r} has joints that follow each other: its workspace has other "
            "curves"
        )
    if len(names) > MOST:
        raise UnsupportedError(
            f"the chain of {frame!r} has {len(names)} joints; it may have {MOST}"
        )
    q = at_zero(system)
    low = system.lower[v_index]
    high = system.upper[v_index]
    tip = complex(*fk(system, q, frame)[:2, 3])
    J = jacobian(system, q, frame)[:, v_index]
    joints: list[PlanarJoint] = []
    for label, a, b, (vx, vy, w) in zip(
        names, low.tolist(), high.tolist(), J[[0, 1, 5]].T, strict=True
    ):
        if a == b:
            continue
        if w == 0.0 and not np.isfinite(b - a):
            raise InputError(
                f"slide {label!r} has no limits, so the workspace has no end: give it some"
            )
        axis = None if w == 0.0 else tip + 1j * complex(vx, vy) / w
        joints.append(PlanarJoint(axis, float(w), complex(vx, vy) if w == 0.0 else 0j, a, b))
    if not joints:
        raise InputError(
            f"frame {frame!r} of {system.name} does not move: all its joints are held by their "
            "limits"
        )
    return PlanarChain(tuple(joints), tip)


# ---- the answer and the verb

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

    system: Model
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

    def _notes(self, degrees: bool = False) -> list[str]:
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
    system: Model, frame: FrameLike, kind: str | None = None, orientation: Any = None
) -> PlanarWorkspace:
    """The exact workspace of the origin of a frame of a planar system of revolute and prismatic
    joints.

    `kind` and `orientation` are as in `System.workspace`; "dexterous" without orientations means
    all angles. Candidates for the boundary are arcs and segments on which joints are at limits or
    singular; the number of solutions of the inverse model on both sides decides which of them bound
    the workspace (see `kempe.workspace.planar.planar_chain`). Prismatic joints must have
    limits, revolute ones may.

    Of a mechanism with legs (see `kempe.workspace.place_bounds`) places are those that all legs
    leave. The last joint of each chain must turn without limits where orientations count, and so
    must that of each leg, but of one where all others end at the frame's origin (see
    `kempe.workspace.planar.planar_platform`). Errors: `UnsupportedError` for all else:
    spatial systems, constraints, other loops, two legs that each leave a curve, coupled joints,
    chains with more than 6 joints; `InputError` for prismatic joints without limits and for frames
    that do not move.
    """
    name = system.structure.frame_name(frame)
    return planar_answer(system, name, question_of(system, name, kind, orientation, None))


def planar_answer(system: Model, frame: str, question: WorkspaceKind) -> PlanarWorkspace:
    """The answer to a question. Errors: see `planar_workspace`."""
    if question.kind == ORIENTATION:
        raise UnsupportedError(
            "the exact workspace is one of places; one of orientations is a sampled map"
        )
    return PlanarWorkspace(system, frame, planar_region(system, frame, question), question.kind)
