"""Regions that planar chains of revolute and prismatic joints reach within their limits.

The region of a chain is what its first joint sweeps with the region of the others.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kempe.forward.joint_lines import JointLine
from kempe.spatial import Array
from kempe.workspace.planar.plane_curves import (
    NOTHING,
    SAME,
    TURN,
    PlanarRegion,
    PlanePiece,
    arrange_region,
    list_middles,
)

PARALLEL = 1e-9
"""Sine of an angle below which directions are parallel, and cosine below which they are at right
angles."""

# A swept region ends on pieces of its boundary where the joint is at a limit, or on ways of points
# of its boundary: of corners, and of points at which the joint moves along the boundary. Sources:
# Litvin, "Application of theorem of implicit function system existence for analysis and synthesis
# of linkages", Mechanism and Machine Theory 15 (1980); Haug, Luh, Adkins, Wang, "Numerical
# algorithms for mapping boundaries of manipulator workspaces", J. Mechanical Design 118 (1996).


def project_joint(line: JointLine, axes: Array, origin: Array) -> JointLine | None:
    """Project a joint to a plane through an origin; None if it moves across the plane. The third of
    `axes` is the normal.
    """
    across = float(line.direction @ axes[2])
    if line.turns:
        if np.linalg.norm(np.cross(line.direction, axes[2])) > PARALLEL:
            return None
        point = complex(*(axes[:2] @ (line.point - origin)))
        return line._replace(point=point, direction=0j, rate=line.rate * np.sign(across))
    if abs(across) > PARALLEL:
        return None
    return line._replace(point=0j, direction=complex(*(axes[:2] @ line.direction)))


def list_stopping_limits(joint: JointLine) -> tuple[float, ...]:
    """List the limits of a joint that stop it. A joint that turns round has none."""
    low, high = joint.limits
    if joint.turns and abs(joint.rate) * (high - low) >= TURN:
        return ()
    return tuple(x for x in (low, high) if np.isfinite(x))


def compute_motion(joint: JointLine, x: float) -> tuple[complex, complex]:
    """Compute (a, b): with the joint at x, a point z of its body is at a z + b."""
    if not joint.turns:
        return 1.0 + 0j, joint.direction * joint.rate * x
    a = complex(np.exp(1j * joint.rate * x))
    return a, joint.point - a * joint.point


def make_joint_path(joint: JointLine, p: complex, back: bool = False) -> PlanePiece:
    """Return the arc or segment along which a joint moves p; with `back`, that of points which
    reach p.
    """
    rate = -joint.rate if back else joint.rate
    low, high = joint.limits
    if not joint.turns:
        way = joint.direction * rate
        return PlanePiece(p + way * low, 0.0, way=way * (high - low))
    if not list_stopping_limits(joint):
        low = 0.0
        high = TURN / abs(rate)
    d = p - joint.point
    start = float(np.angle(d)) + rate * low
    return PlanePiece(joint.point, abs(d), start, rate * (high - low))


def compute_swept_region(joint: JointLine, region: PlanarRegion, size: float) -> PlanarRegion:
    """Compute the region that a joint sweeps with a region or a curve. Solutions are counted for a
    curve.
    """
    pieces: list[PlanePiece] = []
    for piece in region.edges:
        pieces += [piece.move_piece(*compute_motion(joint, x)) for x in list_stopping_limits(joint)]
        pieces += [make_joint_path(joint, p) for p in _find_leading_points(joint, piece, size)]

    def count_solutions(p: complex) -> int:
        """Count the joint positions at which a point is reached."""
        back = make_joint_path(joint, p, back=True)
        if back.length < NOTHING * size:
            return int(region.contains_points(np.array(p)))
        if region.is_curve:
            return sum(len(back.find_meetings(piece, 0.0)) for piece in region.curve)
        return int(region.contains_points(list_middles(back, region.edges)).any())

    return arrange_region(
        pieces,
        lambda p: np.array([count_solutions(z) for z in p.tolist()]),
        size,
        counted=region.is_curve and region.counted,
    )


def _find_leading_points(joint: JointLine, piece: PlanePiece, size: float) -> list[complex]:
    """Find the leading points of a boundary that a joint moves. These are its ends, and points
    where it moves along itself.
    """
    concentric = joint.turns and piece.is_arc and abs(piece.centre - joint.point) < SAME * size
    t = [] if piece.is_whole and not concentric else [0.0, 1.0]
    ends = [complex(piece.evaluate_points(x)) for x in t]
    if concentric or not (joint.turns or piece.is_arc):
        return ends
    if not piece.is_arc:
        way = piece.way / abs(piece.way)
        foot = piece.centre + way * np.real((joint.point - piece.centre) * np.conj(way))
        along = np.array([foot])
    else:
        across = piece.centre - joint.point if joint.turns else 1j * joint.direction
        along = piece.centre + np.array([1.0, -1.0]) * piece.radius * across / abs(across)
    return ends + along[piece.find_parameters(along)[1]].tolist()


# ---- chains


@dataclass(frozen=True)
class PlanarChain:
    """The joints of a chain from the ground on, and the point that they move, at zero.

    `spare` joints more move it no further than these do.
    """

    joints: tuple[JointLine, ...]
    tip: complex
    spare: int = 0

    @classmethod
    def from_joints(cls, joints: Iterable[JointLine], tip: complex) -> PlanarChain:
        """Make a chain of joints. Joints with the same axis or direction are merged.

        A joint with the tip on its axis is left out.
        """
        every = tuple(joints)
        kept: list[JointLine] = []
        for joint in every:
            one = _merge_joints(kept[-1], joint) if kept else None
            kept[len(kept) - (one is not None) :] = [one or joint]
        chain = cls(tuple(kept), tip, len(every) - len(kept))
        last = kept[-1] if kept else None
        if last and last.turns and abs(tip - last.point) <= NOTHING * max(chain.size, abs(tip)):
            return cls(chain.joints[:-1], tip, chain.spare + 1)
        return chain

    @cached_property
    def size(self) -> float:
        """A characteristic length [m]: distances of successive axes and the tip, plus the largest
        slide.
        """
        places = [j.point for j in self.joints if j.turns] + [self.tip]
        slides = [j.rate * max(map(abs, j.limits)) for j in self.joints if not j.turns]
        return sum(abs(b - a) for a, b in itertools.pairwise(places)) + sum(slides)

    @cached_property
    def region(self) -> PlanarRegion:
        """The region that the chain reaches. Solutions are counted for two joints."""
        curve = (make_joint_path(self.joints[-1], self.tip),)
        region = PlanarRegion(self.size, curve=curve, counted=not self.spare)
        for joint in self.joints[-2::-1]:
            region = compute_swept_region(joint, region, self.size)
        return region


def _merge_joints(a: JointLine, b: JointLine) -> JointLine | None:
    """Merge two joints with the same axis or direction to one; None for others."""
    if a.turns != b.turns:
        return None
    if a.turns:
        if abs(a.point - b.point) > NOTHING * (abs(a.point) + abs(b.point)):
            return None
        rates = (a.rate, b.rate)
    else:
        across = b.direction / a.direction
        if abs(across.imag) > NOTHING:
            return None
        rates = (a.rate, b.rate * across.real)
    ends = [sorted((r * j.limits[0], r * j.limits[1])) for r, j in zip(rates, (a, b), strict=True)]
    low, high = (sum(x) for x in zip(*ends, strict=True))
    return a._replace(rate=1.0, limits=(low, high))


def split_wrist(chain: PlanarChain) -> tuple[PlanarChain, complex] | None:
    """Split a chain into the part up to the last joint's axis, and the way from there to the tip.
    None without a last revolute joint.

    The last joint must turn without limits: then the orientation is free, wherever the axis is.
    """
    last = chain.joints[-1]
    if not last.turns or list_stopping_limits(last):
        return None
    inner = PlanarChain.from_joints(chain.joints[:-1], last.point)
    return (inner, chain.tip - last.point) if inner.joints else None
