"""The workspace of a planar chain, exactly: boundary of arcs and segments, area, voids, and how many solutions."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.spaces.planar.planar_chain import PlanarChain, PlanarJoint
from kempe.analysis.spaces.planar.plane_curves import PlanePiece
from kempe.calls import brief, explained, explained_methods, numbers
from kempe.errors import InputError, UnsupportedError
from kempe.kinematics.common.result import Report
from kempe.model.tree.primitive_table import local_chain
from kempe.solvers.common.serial_chain import obstacle
from kempe.status import Status
from kempe.words import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.model.system import FrameLike, System

MOST = 6
"""Joints that a chain may have: the work grows with a power of their number."""
MEET = 1e-7
"""How far ends of pieces may be apart, in sizes of the chain, to be the same corner."""


@dataclass(frozen=True, eq=False)
class SolutionRegion:
    """Points that are reached in the same number of `solutions` (None: infinitely many), their `area` and `boundary`.

    The boundary has the region to its left. `loops` are its closed curves: those with a negative area go round voids.
    """

    __repr__ = brief

    solutions: int | None
    area: float
    boundary: tuple[PlanePiece, ...]
    loops: tuple[tuple[PlanePiece, ...], ...] = field(repr=False)


@explained_methods
@dataclass(frozen=True, eq=False)
class PlanarWorkspace(Report):
    """The points of the plane that the origin of a frame of a planar chain reaches, within the limits, exactly.

    `boundary` are arcs of circles and segments that have the workspace to their left; `regions` tell how many solutions
    there are where. Lengths are in metres.
    """

    __repr__ = brief

    system: System
    frame: str
    chain: PlanarChain = field(repr=False)
    code: Any = Status.SOLVED

    @cached_property
    def boundary(self) -> tuple[PlanePiece, ...]:
        """Arcs and segments that bound it; of a single joint the curve that it is."""
        if len(self.chain.joints) == 1:
            return tuple(self.chain.candidates)
        return tuple(self.chain.ends)

    @cached_property
    def area(self) -> float:
        """Its area in square metres, exact but for rounding."""
        return sum((r.area for r in self.regions), 0.0)

    @cached_property
    def regions(self) -> tuple[SolutionRegion, ...]:
        """For each number of solutions the points that have it; for more than two joints one region."""
        if len(self.chain.joints) == 1:
            return ()
        sides, several = self.chain.sides, len(self.chain.joints) > 2
        counts = sorted({n for _, left, right in sides for n in (left, right) if n > 0})
        out: list[SolutionRegion] = []
        for n in counts:
            edges = [p if left == n else p.part(1.0, 0.0) for p, left, right in sides if (left == n) != (right == n)]
            out.append(SolutionRegion(None if several else n, float(sum(p.moment for p in edges)), tuple(edges),
                              _loops(edges, MEET * self.chain.size)))  # fmt: skip
        return tuple(out)

    @cached_property
    def voids(self) -> tuple[tuple[PlanePiece, ...], ...]:
        """Closed curves round holes of the workspace."""
        loops = _loops(list(self.boundary), MEET * self.chain.size) if self.regions else ()
        return tuple(loop for loop in loops if sum(p.moment for p in loop) < 0.0)

    def contains(self, points: ArrayLike) -> Any:
        """Whether points (..., 2) or (..., 3) are reached, by the inverse model; on the boundary rounding decides."""
        p = self._points(points)
        out = np.zeros(p.shape, dtype=bool)
        for i in np.ndindex(p.shape):
            out[i] = bool(np.isfinite(p[i])) and self.chain.solutions(complex(p[i])) > 0
        return bool(out) if out.ndim == 0 else out

    def solutions(self, points: ArrayLike) -> Any:
        """In how many ways (...) points (..., 2) are reached by two joints. Errors: `UnsupportedError` for others."""
        if len(self.chain.joints) != 2:
            raise UnsupportedError(f"{self.frame!r} is moved by {counted(len(self.chain.joints), 'joint')}: solutions "
                                   "are counted for two")  # fmt: skip
        p = self._points(points)
        out = np.array([self.chain.solutions(complex(x)) if np.isfinite(x) else 0 for x in p.ravel()], dtype=np.int64)
        return int(out[0]) if p.ndim == 0 else out.reshape(p.shape)

    def distance(self, points: ArrayLike) -> Any:
        """Distances (...) >= 0, in metres, of points (..., 2) from the boundary, inside or outside."""
        p = self._points(points)
        best = np.full(p.shape, np.inf)
        for piece in self.boundary:
            d = p - piece.centre
            with np.errstate(invalid="ignore", divide="ignore"):
                foot = piece.centre + piece.radius * d / np.abs(d) if piece.is_arc else p
            inner = piece.parameters(foot)
            near = np.abs(d) if piece.is_arc else np.zeros(p.shape)
            near = np.abs(near - piece.radius) if piece.is_arc else np.abs(p - piece.at(inner[0]))
            ends = np.minimum(np.abs(p - piece.at(0.0)), np.abs(p - piece.at(1.0)))
            best = np.minimum(best, np.where(inner[1], near, ends))
        return float(best) if best.ndim == 0 else best

    def _points(self, points: ArrayLike) -> np.ndarray:
        p = numbers(points, "points")
        if p.ndim == 0 or p.shape[-1] not in (2, 3):
            raise InputError(f"points has shape {p.shape}; it must be (..., 2)")
        off = p.shape[-1] == 3 and p[..., 2] != 0.0
        return np.where(off, np.nan, p[..., 0] + 1j * p[..., 1])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Matplotlib axes with the regions, darker where there are more solutions, and the boundary."""
        from kempe.views.workspace_plot import plot_planar

        return plot_planar(self, ax)

    @property
    def status(self) -> str:
        """Its area and what bounds it."""
        if not self.regions:
            return f"{self.system.name}, {self.frame}: a curve, without area"
        arcs = sum(p.is_arc for p in self.boundary)
        pieces = f"{counted(arcs, 'arc')} and {counted(len(self.boundary) - arcs, 'segment')}"
        voids = f", with {counted(len(self.voids), 'void')}" if self.voids else ""
        return f"{self.system.name}, {self.frame}: area {self.area:.9g} m^2, bounded by {pieces}{voids}"

    def _lines(self) -> list[str]:
        return [f"{'infinitely many solutions' if r.solutions is None else counted(r.solutions, 'solution')}: "
                f"{r.area:.9g} m^2" for r in self.regions]  # fmt: skip

    def _data(self) -> dict[str, Any]:
        regions = [{"solutions": r.solutions, "area": r.area} for r in self.regions]
        pieces = [_piece_data(p) for p in self.boundary]
        return {"system": self.system.name, "frame": self.frame, "area": self.area, "regions": regions,
                "voids": len(self.voids), "boundary": pieces}  # fmt: skip


def _pair(z: Any) -> list[float]:
    point = complex(z)
    return [point.real, point.imag]


def _piece_data(p: PlanePiece) -> dict[str, Any]:
    ends = {"from": _pair(p.at(0.0)), "to": _pair(p.at(1.0))}
    if not p.is_arc:
        return {"kind": "segment"} | ends
    return {"kind": "arc", "centre": _pair(p.centre), "radius": p.radius, "start": p.start, "sweep": p.sweep} | ends


def _loops(pieces: list[PlanePiece], same: float) -> tuple[tuple[PlanePiece, ...], ...]:
    """The pieces as closed curves, each followed by one that begins where it ends."""
    left = list(pieces)
    out: list[tuple[PlanePiece, ...]] = []
    starts = np.array([complex(p.at(0.0)) for p in pieces])
    used = np.zeros(len(left), dtype=bool)
    for first in range(len(left)):
        if used[first]:
            continue
        loop: list[PlanePiece] = []
        k = first
        while not used[k]:
            used[k] = True
            loop.append(left[k])
            end = complex(left[k].at(1.0))
            far = np.where(used, np.inf, np.abs(starts - end))
            if abs(starts[first] - end) <= same or not far.min(initial=np.inf) <= same:
                break
            k = int(np.argmin(far))
        out.append(tuple(loop))
    return tuple(out)


@explained
def planar_workspace(system: System, frame: FrameLike) -> PlanarWorkspace:
    """The exact workspace of the origin of a frame of a planar open chain of revolute and prismatic joints.

    Candidates for the boundary are arcs and segments on which joints are at limits or singular; the number of solutions
    of the inverse model on both sides decides which of them bound the workspace (see
    `kempe.analysis.spaces.planar.planar_chain`). Prismatic joints must have limits, revolute ones may. Errors:
    `UnsupportedError` for spatial systems, for constraints, and for chains with loops, with coupled joints or with more
    than 6 joints; `InputError` for prismatic joints without limits and for frames that do not move.
    """
    name = system.structure.frame_name(frame)
    if system.dim != 2:
        raise UnsupportedError(f"{system.name} is a system in space: the exact workspace is that of planar chains")
    if (why := obstacle(system, name)) is not None:
        raise UnsupportedError(why)
    if system.mechanism.constraints:
        declared = next(iter(system.mechanism.constraints))
        raise UnsupportedError(f"constraint {declared!r} of {system.name} may bound the workspace by other curves")
    table, q_index, v_index = local_chain(system.structure.table, name)
    names = [system.coordinate_names[int(i)] for i in q_index]
    if not names:
        raise InputError(f"frame {name!r} of {system.name} does not move")
    if len(table.iv) != len(v_index):
        raise UnsupportedError(
            f"the chain of {name!r} has joints that follow each other: its workspace has other curves"
        )
    if len(names) > MOST:
        raise UnsupportedError(f"the chain of {name!r} has {len(names)} joints; it may have {MOST}")
    q = system.neutral
    tip, J = complex(*system.fk(q, name)[:2, 3]), system.jacobian(q, name)[:, v_index]
    joints: list[PlanarJoint] = []
    for label, iv, (vx, vy, w) in zip(names, v_index, J[[0, 1, 5]].T, strict=True):
        low, high = float(system.lower[iv]), float(system.upper[iv])
        if w == 0.0 and not np.isfinite(high - low):
            raise InputError(f"slide {label!r} has no limits, so the workspace has no end: give it some")
        axis = None if w == 0.0 else tip + 1j * complex(vx, vy) / w
        joints.append(PlanarJoint(axis, float(w), complex(vx, vy) if w == 0.0 else 0j, low, high))
    return PlanarWorkspace(system, name, PlanarChain(tuple(joints), tip))
