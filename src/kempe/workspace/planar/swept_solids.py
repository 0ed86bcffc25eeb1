"""Solids that planar regions sweep in space: prisms along their normal, or solids of revolution.

They are the places that chains reach whose other joints move a frame in a plane: prisms, shells and
tori.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from kempe.errors import UnsupportedError
from kempe.forward.joint_lines import JointLine, compute_joint_lines
from kempe.spatial import Array
from kempe.workspace.planar.planar_chain import (
    PARALLEL,
    PlanarChain,
    list_stopping_limits,
    project_joint,
)
from kempe.workspace.planar.planar_workspace import MOST
from kempe.workspace.planar.plane_curves import (
    NOTHING,
    ROUNDING,
    PlanarRegion,
    PlanePiece,
    mirror_region,
)

if TYPE_CHECKING:
    from kempe.model.model import Model


@dataclass(frozen=True, eq=False)
class SweptSolid:
    """Planar section moved across its plane from `low` to `high` [m], or turned about its y axis.

    It is turned if both are equal.

    `axes` (3, 3) are unit vectors along the plane and across it, from `origin` (3,), in the ground
    frame. A section that is turned holds with x also -x.
    """

    section: PlanarRegion
    origin: Array
    axes: Array = field(repr=False)
    low: float = 0.0
    high: float = 0.0

    @property
    def turned(self) -> bool:
        """Whether the section is turned about an axis, not moved across its plane."""
        return self.low == self.high

    @property
    def measure(self) -> tuple[float, float]:
        """Volume in cubic metres, exact up to rounding, and its error."""
        ends = self.section.boundary_pieces
        if self.turned:  # Pappus: pi times the integral of |x| over a section that is folded
            axis = PlanePiece(-4j * self.section.size, 0.0, way=8j * self.section.size)
            volume = 0.0
            for piece in ends:
                t = np.unique(
                    np.concatenate([[0.0, 1.0], piece.find_meetings(axis)]).clip(0.0, 1.0)
                )
                for part in (piece.cut_piece(a, b) for a, b in itertools.pairwise(t)):
                    volume += (
                        0.5
                        * np.pi
                        * np.sign(np.real(part.evaluate_points(0.5)))
                        * _integrate_square_moment(part)
                    )
        else:
            volume = self.section.measure_area()[0] * (self.high - self.low)
        return float(volume), ROUNDING * self.section.size**3

    @property
    def extent(self) -> Array:
        """The least and the largest x, y and z (2, 3) in metres, of a box around the solid."""
        p = np.concatenate([piece.extremes for piece in self.section.boundary_pieces])
        x, y = ((float(side.min()), float(side.max())) for side in (np.real(p), np.imag(p)))
        if not self.turned:
            corners = np.array(list(itertools.product(x, y, (self.low, self.high))))
            corners = corners @ self.axes + self.origin
            return np.stack([corners.min(axis=0), corners.max(axis=0)])
        axis = self.axes[1]
        ends = np.outer(y, axis) + self.origin
        wide = x[1] * np.sqrt(np.maximum(1.0 - axis**2, 0.0))
        return np.stack([ends.min(axis=0) - wide, ends.max(axis=0) + wide])

    def contains(self, points: Array) -> np.ndarray:
        """Return a mask (n,) of the points (n, 3) [m] inside the solid, false for NaN.

        On the boundary rounding decides.
        """
        z, h = self._map_to_section(points)
        finite = np.isfinite(z)
        inside = finite & self.section.contains_points(np.where(finite, z, 0.0))
        return inside if self.turned else inside & (h >= self.low) & (h <= self.high)

    def distance(self, points: Array) -> Array:
        """Compute distances (n,) >= 0 [m] of points (n, 3) from the boundary.

        Infinite points have infinite distances, NaN gives NaN.
        """
        z, h = self._map_to_section(points)
        finite = np.asarray(np.isfinite(z))
        near = np.where(finite, z, 0.0)
        far = np.stack([piece.compute_distances(near) for piece in self.section.boundary_pieces])
        beside: Array = far.min(axis=0)
        if not self.turned:
            inside = self.section.contains_points(near)
            above = np.maximum(self.low - h, h - self.high)  # negative between the ends
            outside = np.hypot(np.where(inside, 0.0, beside), np.maximum(above, 0.0))
            beside = np.where(inside & (above < 0.0), np.minimum(beside, -above), outside)
        away = np.where(np.isnan(points).any(axis=1), np.nan, np.inf)
        return np.where(finite, beside, away)

    def _map_to_section(self, points: Array) -> tuple[np.ndarray, Array]:
        """Map points (n, 3) to points (n,) of the section, and heights (n,) above its plane. Points
        that are not finite give NaN.
        """
        finite = np.asarray(np.isfinite(points).all(axis=1))
        x, y, h = (np.where(finite[:, None], points, 0.0) - self.origin).dot(self.axes.T).T
        z = (np.hypot(x, h) if self.turned else x) + 1j * y
        return np.where(finite, z, np.nan), h


def _integrate_square_moment(piece: PlanePiece) -> float:
    """Integrate x^2 dy along a piece."""
    a, b = (complex(piece.evaluate_points(t)) for t in (0.0, 1.0))
    if not piece.is_arc:
        return (b.imag - a.imag) * (a.real**2 + a.real * b.real + b.real**2) / 3.0
    c = piece.centre.real
    r = piece.radius

    def evaluate_antiderivative(angle: float) -> float:
        """Evaluate the antiderivative of x^2 dy of an arc at an angle."""
        sine = np.sin(angle)
        turned = 0.5 * angle + 0.25 * np.sin(2.0 * angle)
        return c * c * r * sine + 2.0 * c * r * r * turned + r**3 * (sine - sine**3 / 3.0)

    return float(
        evaluate_antiderivative(piece.start + piece.sweep) - evaluate_antiderivative(piece.start)
    )


# ---- the solid of a chain


def find_swept_solid(system: Model, frame: str) -> SweptSolid | None:
    """Find the solid that a frame of a spatial chain reaches, or None for other chains."""
    if system.structure.closures or system._mechanism.constraints or system.structure.relations:
        return None
    try:
        lines, pose = compute_joint_lines(system, frame)
    except UnsupportedError:
        return None
    tip = pose[:3, 3]
    if any(not line.turns and not np.isfinite(line.limits).all() for line in lines):
        return None
    while lines and lines[-1].turns and _is_on(tip, lines[-1]):
        lines.pop()
    if len(lines) > MOST:
        return None
    return next(
        (
            s
            for s in (*_find_prism(lines, tip), *_find_turned_solid(lines, tip))
            if s.section.boundary_pieces
        ),
        None,
    )


def _is_on(point: Array, line: JointLine) -> bool:
    """Whether a point is on a line."""
    off = float(np.linalg.norm(np.cross(line.direction, point - line.point)))
    return off < 1e3 * NOTHING * (1.0 + float(np.linalg.norm(point)))


def _make_plane_chain(
    axes: Array, origin: Array, lines: Sequence[JointLine], tip: Array
) -> PlanarChain | None:
    """Make the chain of lines in a plane. None if one moves the tip across it, or fewer than two
    move it along.
    """
    joints = [j for line in lines if (j := project_joint(line, axes, origin)) is not None]
    if len(joints) < len(lines):
        return None
    chain = PlanarChain.from_joints(joints, complex(*(axes[:2] @ (tip - origin))))
    return chain if len(chain.joints) > 1 else None


def _find_prism(lines: list[JointLine], tip: Array) -> Iterator[SweptSolid]:
    """Find the solid of a slide across the plane in which all other joints move the tip."""
    for slide in lines:
        if not slide.turns:
            axes = _complete_basis(slide.direction)
            if chain := _make_plane_chain(axes, tip, [x for x in lines if x is not slide], tip):
                low, high = (slide.rate * x for x in slide.limits)
                yield SweptSolid(chain.region, tip, axes, low, high)


def _find_turned_solid(lines: list[JointLine], tip: Array) -> Iterator[SweptSolid]:
    """Find the solid of a first joint that turns without limits, about an axis in the others'
    plane.
    """
    first = lines[0] if lines else None
    if first is None or not first.turns or list_stopping_limits(first):
        return
    a = first.direction
    origin = first.point + a * ((tip - first.point) @ a)
    aside = tip - origin
    normals = [x.direction for x in lines[1:] if x.turns][:1] or [np.cross(a, aside)]
    size = float(np.linalg.norm(normals[0]))
    if size == 0.0 or abs(normals[0] @ a) > PARALLEL * size:
        return
    normal = normals[0] / size
    axes = np.stack([np.cross(a, normal), a, normal])
    chain = _make_plane_chain(axes, origin, lines[1:], tip)
    if chain is not None and abs(normal @ aside) <= NOTHING * chain.size:
        yield SweptSolid(mirror_region(chain.region), origin, axes)


def _complete_basis(normal: Array) -> Array:
    """Complete a normal to unit vectors (3, 3), of which it is the last."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first), normal], dtype=float)
