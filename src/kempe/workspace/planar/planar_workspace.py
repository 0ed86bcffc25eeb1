"""Exact workspaces of planar chains and mechanisms: boundary, area, voids, numbers of solutions.

The region of a frame of a system is found here, too, from its chain or from its legs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors, explain_method_errors, numbers
from kempe.errors import InputError, UnsupportedError
from kempe.forward.joint_lines import compute_joint_lines
from kempe.inverse.chain.serial_chain import find_obstacle
from kempe.late import import_late_member
from kempe.report import Report, summarize_fields
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import format_count, join_words
from kempe.workspace.kinds import (
    CONSTANT,
    DEXTEROUS,
    ORIENTATION,
    REACHABLE,
    WorkspaceKind,
    read_workspace_kind,
)
from kempe.workspace.legs import find_legs
from kempe.workspace.planar.planar_chain import PlanarChain, project_joint, split_wrist
from kempe.workspace.planar.planar_platform import (
    MEET,
    PlaneCurve,
    PlatformLeg,
    PlatformRegion,
    compute_extent,
    find_open_ends,
)
from kempe.workspace.planar.plane_curves import (
    NOTHING,
    PlanarRegion,
    PlanePiece,
    intersect_regions,
    shrink_region,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.model import FrameLike, Model


# ---- the region of a frame

AT_ORIGIN = 1e3 * NOTHING
"""Distance, in sizes of a chain, from which on points are different."""
MOST = 6
"""Joints that a chain may have: the work grows with their number."""


def find_planar_region(
    system: Model, frame: str, workspace_kind: WorkspaceKind
) -> PlanarRegion | PlatformRegion:
    """Find the region of a planar frame for a kind of workspace. Errors: `UnsupportedError`,
    `InputError`; see `planar_workspace`.
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
    legs = find_legs(system, frame)
    if not legs and (why := find_obstacle(system, frame)) is not None:
        raise UnsupportedError(why)
    chains = [find_planar_chain(leg, frame) for leg in legs or (system,)]
    if workspace_kind.kind == REACHABLE:
        if len(chains) > 1:
            return _find_platform_region(system, frame, chains)
        chain = PlanarChain.from_joints(chains[0][0].joints, chains[0][0].tip)
        if not chain.joints:
            raise InputError(
                f"frame {frame!r} of {system.name} turns in its place: it does not move"
            )
        return chain.region
    parts: list[PlanarRegion] = []
    for chain, turned in chains:
        wrist = split_wrist(chain)
        if wrist is None:
            raise UnsupportedError(
                f"the last joint before {frame!r} of {system.name}, or of a leg of it, does not "
                "turn without limits, or is all that moves it: where orientations count, its "
                "workspace has other curves"
            )
        inner, way = wrist
        if not workspace_kind.all_turns(2):
            for R in workspace_kind.rotations:
                turn = float(np.arctan2(R[1, 0], R[0, 0])) - turned
                parts.append(inner.region.move_region(way * complex(np.exp(1j * turn))))
        elif abs(way) < NOTHING * inner.size:
            parts.append(inner.region)
        else:
            parts.append(shrink_region(inner.region, abs(way)))
    region = _merge_regions(parts)
    counted = workspace_kind.kind == CONSTANT
    return region if counted or not region.counted else replace(region, counted=False)


def _merge_regions(parts: Sequence[PlanarRegion]) -> PlanarRegion:
    """Merge the parts to one region. Errors: `UnsupportedError` if one of several is a curve."""
    if len(parts) > 1 and any(p.is_curve for p in parts):
        raise UnsupportedError(
            "a leg of the loop leaves a curve only: what several leave is a piece of it, or points"
        )
    return reduce(intersect_regions, parts)


def _find_platform_region(
    system: Model, frame: str, chains: Sequence[tuple[PlanarChain, float]]
) -> PlanarRegion | PlatformRegion:
    """Find the region of a frame on legs. They are given as chains and the angles of the frame with
    each chain at zero.

    Legs whose last joint turns without limits at the frame's origin hold that in a region whatever
    the orientation, so that one other decides alone. Errors: `UnsupportedError`.
    """
    regions: list[PlanarRegion] = []
    aside: list[tuple[PlanarChain, float]] = []
    for chain, turned in chains:
        wrist = split_wrist(chain)
        if wrist is None or abs(wrist[1]) > AT_ORIGIN * chain.size:
            aside.append((chain, turned))
        else:
            regions.append(wrist[0].region)
    if len(aside) < 2:
        return _merge_regions([*regions, *(chain.region for chain, _ in aside)])
    legs = [PlatformLeg(_merge_regions(regions), 0j)] if regions else []
    for chain, turned in aside:
        wrist = split_wrist(chain)
        if wrist is None:
            raise UnsupportedError(
                f"frame {frame!r} moves with the loops of {system.name}, and a leg of it does not "
                "end with a joint that turns without limits: its workspace has other curves"
            )
        region = wrist[0].region
        b = complex(-wrist[1] * np.exp(-1j * turned))
        same = [k for k, leg in enumerate(legs) if abs(leg.b - b) <= AT_ORIGIN * region.size]
        if same:
            legs[same[0]] = replace(
                legs[same[0]], region=_merge_regions([legs[same[0]].region, region])
            )
        else:
            legs.append(PlatformLeg(region, b))
    if sum(leg.region.is_curve for leg in legs) > 1 or (regions and legs[0].region.is_curve):
        raise UnsupportedError(
            f"two of the legs of {system.name} leave frame {frame!r} a curve, which has no area"
        )
    return PlatformRegion(tuple(legs))


def find_planar_chain(system: Model, frame: str) -> tuple[PlanarChain, float]:
    """Find the chain that moves a frame, and the angle of the frame with the chain at zero. Errors:
    `UnsupportedError`, `InputError`; see `planar_workspace`.
    """
    lines, pose = compute_joint_lines(system, frame)
    if not len(system.structure.table.find_path(frame)):
        raise InputError(f"frame {frame!r} of {system.name} does not move")
    if not lines:
        raise InputError(
            f"frame {frame!r} of {system.name} does not move: all its joints are held by their "
            "limits"
        )
    if len(lines) > MOST:
        raise UnsupportedError(
            f"the chain of {frame!r} has {len(lines)} joints; it may have {MOST}"
        )
    for line in lines:
        if not line.turns and not np.isfinite(line.limits).all():
            raise InputError(
                f"slide {line.coordinate!r} has no limits, so the workspace has no end: give it "
                "some"
            )
    joints = [j for line in lines if (j := project_joint(line, np.eye(3), np.zeros(3)))]
    return (
        PlanarChain(tuple(joints), complex(*pose[:2, 3])),
        float(np.arctan2(pose[1, 0], pose[0, 0])),
    )


# ---- the answer and the verb


@dataclass(frozen=True, eq=False)
class SolutionRegion:
    """Points with the same number of `solutions` (None: infinite), with `area` and `boundary`.

    The boundary has the region to its left. `loops` are its closed curves: those with a negative
    area go round voids.
    """

    __repr__ = summarize_fields

    solutions: int | None
    area: float
    boundary: tuple[PlaneCurve, ...]
    loops: tuple[tuple[PlaneCurve, ...], ...] = field(repr=False)


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class PlanarWorkspace(Report):
    """Exact set of points that the origin of a frame reaches in the plane, within the limits.

    Attributes
    ----------
    boundary
        Arcs and segments with the workspace to their left; for platforms on legs also pieces of
        coupler curves.
    regions
        Regions with their numbers of solutions.
    area, error
        Area in square metres, exact up to rounding, and its error. For a platform it is sampled.
    kind
        Kind of workspace, as in `System.workspace`.
    """

    _pictured = True

    _entries = ("system", "frame", "kind", "area")

    system: Model
    frame: str
    region: PlanarRegion | PlatformRegion
    kind: str = REACHABLE
    code: Any = Status.SOLVED

    @cached_property
    def boundary(self) -> tuple[PlaneCurve, ...]:
        """The curves that bound the workspace; for a single joint the curve itself."""
        return tuple(self.region.boundary_pieces)

    @cached_property
    def measure(self) -> tuple[float, float]:
        """Area in square metres, and its error: rounding, or two standard errors of samples."""
        return self.region.measure_area()

    @property
    def area(self) -> float:
        """Area in square metres."""
        return self.measure[0]

    @property
    def error(self) -> float:
        """Error of the area in square metres: 0 if exact up to rounding, else two standard errors."""
        return 0.0 if self.region.is_exact else self.measure[1]

    @cached_property
    def extent(self) -> Array:
        """The least and the largest x and y (2, 2) of the boundary in metres."""
        return compute_extent(self.boundary)

    @cached_property
    def regions(self) -> tuple[SolutionRegion, ...]:
        """The regions of points by number of solutions; one region if solutions are not counted."""
        if self.region.is_curve or not self.boundary:
            return ()
        sides = self.region.sides
        counts = sorted({n for _, left, right in sides for n in (left, right) if n > 0})
        out: list[SolutionRegion] = []
        for n in counts:
            edges = [
                p if left == n else p.cut_piece(1.0, 0.0)
                for p, left, right in sides
                if (left == n) != (right == n)
            ]
            loops = _join_loops(edges, MEET * self.region.size)
            if self.region.counted:
                out.append(SolutionRegion(n, sum(p.moment for p in edges), tuple(edges), loops))
            else:
                out.append(SolutionRegion(None, self.area, tuple(edges), loops))
        return tuple(out)

    @cached_property
    def voids(self) -> tuple[tuple[PlaneCurve, ...], ...]:
        """Closed curves around holes of the workspace."""
        loops = _join_loops(self.boundary, MEET * self.region.size) if self.regions else ()
        return tuple(loop for loop in loops if compute_loop_area(loop) < 0.0)

    def contains(self, points: ArrayLike) -> Any:
        """Return a mask (...) of the points (..., 2) or (..., 3) [m] that are reached.

        On the boundary rounding decides.

        Of a curve they are those within 1e-9 of its length.
        """
        p = self._read_points(points)
        if self.region.is_curve:
            out = np.asarray(self.distance(points) <= 1e-9 * self.region.size)
        else:
            finite = np.isfinite(p)
            out = finite & self.region.contains_points(np.where(finite, p, 0.0))
        return bool(out) if out.ndim == 0 else out

    def solutions(self, points: ArrayLike) -> Any:
        """Count the solutions (...) at points (..., 2).

        They are known for chains of two joints, and for legs of two joints that meet in a point or
        hold one orientation.

        Errors: `UnsupportedError` for others.
        """
        if not (self.region.counted and isinstance(self.region, PlanarRegion)):
            raise UnsupportedError(
                f"of {self.frame!r} solutions are not counted: they are where two joints decide "
                "the place, in one orientation or whatever it is; see `ik_all`"
            )
        p = self._read_points(points)
        finite = np.isfinite(p)
        out = np.where(finite, self.region.count_solutions(np.where(finite, p, 0.0)), 0)
        return int(out) if p.ndim == 0 else out

    def distance(self, points: ArrayLike) -> Any:
        """Compute the distances (...) >= 0 [m] of points (..., 2) or (..., 3) from the boundary.

        They are infinite where the boundary is empty or a point is infinite, and NaN where a point
        is.
        """
        given = numbers(points, "points")
        self._read_points(given)
        xy = given[..., :2]
        finite = np.asarray(np.isfinite(xy).all(axis=-1))
        far = np.hypot(xy[..., 0], xy[..., 1])
        near = self._read_points(np.where(finite[..., None], xy, 0.0))
        best = np.full(finite.shape, np.inf)
        for piece in self.boundary:
            best = np.minimum(best, piece.compute_distances(near))
        best = np.where(finite, best, far)
        best = np.hypot(best, given[..., 2]) if given.shape[-1] == 3 else best
        return float(best) if best.ndim == 0 else best

    def _read_points(self, points: ArrayLike) -> np.ndarray:
        """Read points (..., 2) or (..., 3) as complex numbers (...). Errors: `InputError`."""
        p = numbers(points, "points")
        if p.ndim == 0 or p.shape[-1] not in (2, 3):
            raise InputError(f"points has shape {p.shape}; it must be (..., 2)")
        off = p.shape[-1] == 3 and p[..., 2] != 0.0
        out = np.empty(p.shape[:-1], dtype=complex)
        out.real = np.where(off, np.nan, p[..., 0])
        out.imag = p[..., 1]
        return out

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the regions, darker with more solutions, and the boundary in Matplotlib axes."""
        return import_late_member("plots of workspaces").plot_planar(self, ax)

    @property
    def ring(self) -> str:
        """Description of a disc or an annulus: 'annulus about (0, 0), 0.1 to 0.9 m'; '' for others."""
        return describe_ring(self.boundary, AT_ORIGIN * self.region.size)

    @property
    def status(self) -> str:
        """The area of the workspace and the curves that bound it, as a sentence."""
        of = f"{self.system.name}, {self.frame}" + (
            f" ({self.kind})" if self.kind != REACHABLE else ""
        )
        if self.region.is_curve:
            return f"{of}: a curve, without area"
        if not self.regions:
            return f"{of}: no place is reached"
        if ring := self.ring:
            return f"{of}: {ring}, area {self.area:.9g} m^2"
        kinds = Counter(p.kind for p in self.boundary)
        pieces = join_words([format_count(n, kind) for kind, n in sorted(kinds.items())])
        voids = f", with {format_count(len(self.voids), 'void')}" if self.voids else ""
        if not self.region.is_exact:
            area = f"area {self.area:.5g} +- {self.error:.2g} m^2 (sampled)"
            ends = len(find_open_ends(self.boundary, MEET * self.region.size))
            gaps = f"; pieces are missing at {format_count(ends, 'open end')}" if ends else ""
            return f"{of}: {area}, bounded by {pieces}{voids}{gaps}"
        return f"{of}: area {self.area:.9g} m^2, bounded by {pieces}{voids}"

    def _list_notes(self, degrees: bool = False) -> list[str]:
        return [
            f"{describe_solution_count(r, self.kind)}: {r.area:.{5 if self.error else 9}g} m^2, "
            f"{format_count(sum(compute_loop_area(x) > 0.0 for x in r.loops), 'part')}"
            for r in self.regions
        ]

    def _collect_data(self) -> dict[str, Any]:
        regions = [{"solutions": r.solutions, "area": r.area} for r in self.regions]
        pieces = [p.data() for p in self.boundary]
        return super()._collect_data() | {
            "area_error": self.error,
            "regions": regions,
            "voids": len(self.voids),
            "boundary": pieces,
        }


def describe_solution_count(region: SolutionRegion, kind: str) -> str:
    """Describe in how many ways the points of a region are reached."""
    if region.solutions is not None:
        return format_count(region.solutions, "solution")
    return "in all orientations" if kind == DEXTEROUS else "infinitely many solutions"


def compute_loop_area(loop: tuple[PlaneCurve, ...]) -> float:
    """Compute the area to the left of a closed curve; coupler curves count by short chords."""
    return sum(piece.moment for piece in loop)


def describe_ring(pieces: Sequence[PlaneCurve], same: float) -> str:
    """Describe a boundary that is one whole circle, or two about one point; '' for others.

    Lengths that differ by less than `same` are equal.
    """
    arcs = [p for p in pieces if isinstance(p, PlanePiece) and p.is_arc]
    if not arcs or len(arcs) < len(pieces):
        return ""
    centre = arcs[0].centre
    radii = sorted({p.radius for p in arcs})
    radii = [r for k, r in enumerate(radii) if k == 0 or r - radii[k - 1] > same]
    turns = [sum(p.sweep for p in arcs if abs(p.radius - r) <= same) / math.tau for r in radii]
    concentric = all(abs(p.centre - centre) <= same for p in arcs)
    x, y = (0.0 if abs(c) <= same else c for c in (centre.real, centre.imag))
    about = f"about ({x:.6g}, {y:.6g})"
    if not concentric or not np.allclose(turns, [-1.0, 1.0][-len(radii) :], atol=1e-9):
        return ""
    if len(radii) == 1:
        return f"disc {about}, radius {radii[0]:.6g} m"
    return f"annulus {about}, {radii[0]:.6g} to {radii[1]:.6g} m"


def _join_loops(pieces: Sequence[PlaneCurve], same: float) -> tuple[tuple[PlaneCurve, ...], ...]:
    """Join pieces to closed curves, each followed by the leftmost of those that begin at its end."""
    out: list[tuple[PlaneCurve, ...]] = []
    starts = np.array([complex(p.evaluate_points(0.0)) for p in pieces])
    used = np.zeros(len(pieces), dtype=bool)
    for first in range(len(pieces)):
        if used[first]:
            continue
        loop: list[PlaneCurve] = []
        k = first
        while True:
            used[k] = True
            loop.append(pieces[k])
            far = np.where(used, np.inf, np.abs(starts - complex(pieces[k].evaluate_points(1.0))))
            far[first] = abs(starts[first] - complex(pieces[k].evaluate_points(1.0)))
            along = pieces[k].evaluate_tangent(1.0)
            near = np.flatnonzero(far <= same)
            turns = [
                float(np.angle(pieces[j].evaluate_tangent(0.0) / along)) for j in near.tolist()
            ]
            if not len(near) or (k := int(near[np.argmax(turns)])) == first:
                break
        out.append(tuple(loop))
    return tuple(out)


@explain_errors
def planar_workspace(
    system: Model, frame: FrameLike, kind: str | None = None, orientation: Any = None
) -> PlanarWorkspace:
    """Compute the exact workspace of a frame's origin, for planar revolute and prismatic joints.

    `kind` and `orientation` are as in `System.workspace`; "dexterous" without orientations means
    all angles. Candidates for the boundary are arcs and segments on which joints are at limits or
    singular; the number of solutions of the inverse model on both sides decides which of them bound
    the workspace (see `kempe.workspace.planar.planar_chain`). Prismatic joints must have
    limits, revolute ones may.

    Of a mechanism with legs (see `kempe.workspace.legs`) places are those that all legs
    leave. The last joint of each chain must turn without limits where orientations count, and so
    must that of each leg, but of one where all others end at the frame's origin. Of legs that hold
    different points of a platform the boundary has coupler curves and the area is sampled (see
    `kempe.workspace.planar.planar_platform`). Errors: `UnsupportedError` for all else:
    spatial systems, constraints, other loops, two legs that each leave a curve, coupled joints,
    chains with more than 6 joints; `InputError` for prismatic joints without limits and for frames
    that do not move.
    """
    name = system.structure.frame_name(frame)
    return compute_planar_workspace(
        system, name, read_workspace_kind(system, name, kind, orientation, None)
    )


def compute_planar_workspace(
    system: Model, frame: str, workspace_kind: WorkspaceKind
) -> PlanarWorkspace:
    """Compute the exact workspace for a kind of workspace. Errors: see `planar_workspace`."""
    if workspace_kind.kind == ORIENTATION:
        raise UnsupportedError(
            "the exact workspace is one of places; one of orientations is a sampled map"
        )
    return PlanarWorkspace(
        system, frame, find_planar_region(system, frame, workspace_kind), workspace_kind.kind
    )
