"""The planar region in which a frame of a system is, from its chain or from its legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.kinds.legs import legs_of
from kempe.analysis.spaces.kinds.questions import CONSTANT, REACHABLE, WorkspaceKind
from kempe.analysis.spaces.planar.planar_chain import PlanarChain, PlanarJoint
from kempe.analysis.spaces.planar.planar_parts import (
    RegionOfLegs,
    in_all_orientations,
    in_one_orientation,
    wrist_of,
)
from kempe.analysis.spaces.planar.planar_platform import PlatformLeg, RegionOfPlatform
from kempe.analysis.spaces.planar.planar_region import NOTHING, PlanarRegion
from kempe.errors import InputError, UnsupportedError
from kempe.kinematics.forward import fk, jacobian
from kempe.model.tree.primitive_table import local_chain
from kempe.solvers.common.serial_chain import obstacle
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

AT_ORIGIN = 1e3 * NOTHING
"""Distance, in sizes of a chain, from which on points are different."""
MOST = 6
"""Joints that a chain may have: the work grows with a power of their number."""


def planar_region(system: System, frame: str, question: WorkspaceKind) -> PlanarRegion:
    """The region of a question about a frame. Errors: `UnsupportedError`, `InputError`; see
    `planar_workspace`.
    """
    if system.dim != 2:
        raise UnsupportedError(
            f"{system.name} is a system in space: the exact workspace is that of planar ones"
        )
    if system.mechanism.constraints:
        declared = next(iter(system.mechanism.constraints))
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


def at_zero(system: System) -> Array:
    """The configuration (nq,) with all coordinates at zero, but for those that their limits hold."""
    q = system.neutral.copy()
    held = system.lower == system.upper
    q[held] = system.lower[held]  # planar coordinates and velocities have the same places
    return q


def _turn_at_zero(system: System, frame: str) -> float:
    """The angle by which a frame is turned there."""
    R = fk(system, at_zero(system), frame)[:2, :2]
    return float(np.arctan2(R[1, 0], R[0, 0]))


def _held(part: PlanarRegion | None, system: System, frame: str) -> PlanarRegion:
    """The part. Errors: `UnsupportedError` where there is none."""
    if part is None:
        raise UnsupportedError(
            f"the last joint before {frame!r} of {system.name}, or of a leg of it, does not turn "
            "without limits, or is all that moves it: where orientations count, its workspace has "
            "other curves"
        )
    return part


def _moving(chain: PlanarChain, system: System, frame: str) -> PlanarChain:
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
    system: System, frame: str, chains: list[PlanarChain], turned: list[float]
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
    system: System,
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


def planar_chain(system: System, frame: str) -> PlanarChain:
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
