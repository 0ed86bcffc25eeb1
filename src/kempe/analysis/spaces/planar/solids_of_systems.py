"""The solids that chains in space reach whose joints move a frame in a plane, but for a slide or a
first turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from kempe.analysis.spaces.planar.planar_chain import PlanarChain, PlanarJoint
from kempe.analysis.spaces.planar.planar_of_systems import MOST, at_zero
from kempe.analysis.spaces.planar.planar_region import NOTHING
from kempe.analysis.spaces.planar.swept_solids import Folded, Prism, Revolved, SweptSolid, Turned
from kempe.kinematics.forward import fk, jacobian
from kempe.model.tree.primitive_table import local_chain
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

PARALLEL = 1e-9
"""Sine of an angle below which directions are parallel, and cosine below which they are at right
angles."""


@dataclass(frozen=True)
class SpaceJoint:
    """A joint at zero: it turns about a line through `point` by `turn` a unit, or (turn 0) slides
    by `way` a unit.
    """

    turn: Array
    point: Array
    way: Array
    low: float
    high: float

    @property
    def direction(self) -> Array:
        """The unit vector of its axis."""
        v = self.turn if self.turns else self.way
        return v / np.linalg.norm(v)

    @property
    def turns(self) -> bool:
        """Whether it turns."""
        return bool(self.turn.any())

    def in_plane(self, o: Array, axes: Array) -> PlanarJoint | None:
        """The joint in the plane of two unit vectors (2, 3) through o; None if it does not move
        along that.
        """
        normal = np.cross(*axes)
        if self.turns:
            if np.linalg.norm(np.cross(self.direction, normal)) > PARALLEL:
                return None
            return PlanarJoint(
                _complex(axes @ (self.point - o)),
                float(self.turn @ normal),
                0j,
                self.low,
                self.high,
            )
        if abs(self.direction @ normal) > PARALLEL:
            return None
        return PlanarJoint(None, 0.0, _complex(axes @ self.way), self.low, self.high)


def swept_solid(system: System, frame: str) -> SweptSolid | None:
    """The solid that a frame of a chain in space reaches; None where it is of another kind."""
    if (joints := _space_joints(system, frame)) is None:
        return None
    tip = fk(system, at_zero(system), frame)[:3, 3]
    for solid in (*_prisms(joints, tip), *_revolved(joints, tip)):
        if solid.section.ends:
            return solid
    return None


def _space_joints(system: System, frame: str) -> list[SpaceJoint] | None:
    """The joints that move a frame's origin; None where there are others than turns and slides of
    their own.
    """
    table, _, v_index = local_chain(system.structure.table, frame)
    if system.nq != system.nv or len(table.iv) != len(v_index) or system.structure.closures:
        return None
    if system.mechanism.constraints or system.structure.relations or len(v_index) > 2 * MOST:
        return None
    q = at_zero(system)
    tip = fk(system, q, frame)[:3, 3]
    J = jacobian(system, q, frame)[:, v_index]
    out: list[SpaceJoint] = []
    for column, low, high in zip(
        J.T, system.lower[v_index].tolist(), system.upper[v_index].tolist(), strict=True
    ):
        v = column[:3]
        w = column[3:]
        rate = float(w @ w)
        if low == high:
            continue
        if rate == 0.0:
            if not np.isfinite(high - low):
                return None
            out.append(SpaceJoint(np.zeros(3), tip, v, low, high))
        elif abs(float(v @ w)) > PARALLEL * rate:
            return None  # a screw
        else:
            out.append(SpaceJoint(w, tip + np.cross(w, v) / rate, np.zeros(3), low, high))
    while (
        out
        and out[-1].turns
        and np.linalg.norm(np.cross(out[-1].direction, tip - out[-1].point))
        < NOTHING * 1e3 * (1.0 + np.linalg.norm(tip))
    ):
        out.pop()  # the tip is on its axis
    return out if len(out) <= MOST else None


def _prisms(joints: list[SpaceJoint], tip: Array) -> Iterator[SweptSolid]:
    """With one slide across the plane in which all other joints move the tip."""
    for slide in joints:
        if slide.turns:
            continue
        axes = _basis(slide.direction)
        rest = [j.in_plane(tip, axes[:2]) for j in joints if j is not slide]
        if rest and all(j is not None for j in rest):
            chain = PlanarChain.of(cast("list[PlanarJoint]", rest), 0j)
            if len(chain.joints) > 1:
                rate = float(np.linalg.norm(slide.way))
                yield Prism(chain, tip, axes, rate * slide.low, rate * slide.high)


def _revolved(joints: list[SpaceJoint], tip: Array) -> Iterator[SweptSolid]:
    """With a first joint that turns about an axis parallel to the plane in which the others move."""
    first = joints[0] if joints else None
    if first is None or not first.turns:
        return
    a = first.direction
    rate = float(np.linalg.norm(first.turn))
    low = rate * first.low
    high = rate * first.high
    origin = first.point + a * ((tip - first.point) @ a)
    for normal in [j.direction for j in joints[1:] if j.turns][:1] or [_basis(a)[0], _basis(a)[1]]:
        if abs(normal @ a) > PARALLEL:
            continue
        axes = np.stack([np.cross(a, normal), a, normal])
        rest = [j.in_plane(origin, axes[:2]) for j in joints[1:]]
        if rest and all(j is not None for j in rest):
            chain = PlanarChain.of(
                cast("list[PlanarJoint]", rest), _complex(axes[:2] @ (tip - origin))
            )
            if len(chain.joints) > 1:
                beside = float(normal @ (tip - origin))
                if high - low >= 2.0 * np.pi:
                    yield Revolved(Folded(chain), origin, axes, beside)
                else:
                    yield Turned(chain, origin, axes, beside, low, high)


def _complex(xy: Array) -> complex:
    return complex(float(xy[0]), float(xy[1]))


def _basis(normal: Array) -> Array:
    """Unit vectors (3, 3), the last of which is that one."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first), normal], dtype=float)
