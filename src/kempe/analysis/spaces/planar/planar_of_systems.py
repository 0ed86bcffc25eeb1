"""The planar region in which a frame of a system is, from its chain or from its legs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.kinds.legs import legs_of
from kempe.analysis.spaces.kinds.questions import CONSTANT, REACHABLE, WorkspaceKind
from kempe.analysis.spaces.planar.planar_chain import PlanarChain, PlanarJoint
from kempe.analysis.spaces.planar.planar_parts import RegionOfLegs, in_all_orientations, in_one_orientation, wrist_of
from kempe.analysis.spaces.planar.planar_region import NOTHING, PlanarRegion
from kempe.errors import InputError, UnsupportedError
from kempe.model.tree.primitive_table import local_chain
from kempe.solvers.common.serial_chain import obstacle
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

MOST = 6
"""Joints that a chain may have: the work grows with a power of their number."""


def planar_region(system: System, frame: str, question: WorkspaceKind) -> PlanarRegion:
    """The region of a question about a frame. Errors: `UnsupportedError`, `InputError`; see `planar_workspace`."""
    if system.dim != 2:
        raise UnsupportedError(f"{system.name} is a system in space: the exact workspace is that of planar ones")
    if system.mechanism.constraints:
        declared = next(iter(system.mechanism.constraints))
        raise UnsupportedError(f"constraint {declared!r} of {system.name} may bound the workspace by other curves")
    legs = legs_of(system, frame)
    if not legs:
        if (why := obstacle(system, frame)) is not None:
            raise UnsupportedError(why)
        legs = (system,)
    chains = [planar_chain(leg, frame) for leg in legs]
    if question.kind == REACHABLE:
        own = _moving(chains[0], system, frame) if len(chains) == 1 else _meeting_at_a_point(system, frame, chains)
        return _together(own, all(p.counted for p in own))
    if question.all_turns(2):
        return _together([_held(x, system, frame) for x in map(in_all_orientations, chains)], False)
    parts: list[PlanarRegion] = []
    for R in question.rotations:
        for leg, chain in zip(legs, chains, strict=True):
            parts.append(_held(in_one_orientation(chain, _turn(leg.fk(leg.neutral, frame), R)), system, frame))
    return _together(parts, question.kind == CONSTANT and all(p.counted for p in parts))


def _turn(X: Array, R: Array) -> float:
    """The angle by which a rotation (3, 3) is turned against that of a pose."""
    return float(np.arctan2(R[1, 0], R[0, 0]) - np.arctan2(X[1, 0], X[0, 0]))


def _held(part: PlanarRegion | None, system: System, frame: str) -> PlanarRegion:
    """The part. Errors: `UnsupportedError` where there is none."""
    if part is None:
        raise UnsupportedError(f"the last joint before {frame!r} of {system.name}, or of a leg of it, does not turn "
                               "without limits, or is all that moves it: where orientations count, its workspace has "
                               "other curves")  # fmt: skip
    return part


def _moving(chain: PlanarChain, system: System, frame: str) -> list[PlanarChain]:
    """The chain without joints that do not move the frame's origin. Errors: `InputError` where none does."""
    found = PlanarChain.of(chain.joints, chain.tip)
    if not found.joints:
        raise InputError(f"frame {frame!r} of {system.name} turns in its place: it does not move")
    return [found]


def _together(parts: Sequence[PlanarRegion], counted: bool) -> PlanarRegion:
    """One region of all parts. Errors: `UnsupportedError` where one of several is a curve."""
    if len(parts) == 1:
        return parts[0]
    if any(p.is_curve for p in parts):
        raise UnsupportedError("a leg of the loop leaves a curve only: what several leave is a piece of it, or points")
    return RegionOfLegs(tuple(parts), counted)


def _meeting_at_a_point(system: System, frame: str, chains: list[PlanarChain]) -> list[PlanarChain]:
    """What is left of legs that lead to one point, whatever the orientation: one of them decides that, or none."""
    free = [wrist_of(c) for c in chains]
    held = [k for k, found in enumerate(free) if found is None or abs(found[1]) > NOTHING * 1e3 * chains[k].size]
    if len(held) > 1:
        raise UnsupportedError(f"frame {frame!r} moves with the loops of {system.name}, whose legs do not end with "
                               "joints without limits at its origin: its workspace has other curves")  # fmt: skip
    return [
        c if k in held or found is None else found[0] for k, (c, found) in enumerate(zip(chains, free, strict=True))
    ]


def planar_chain(system: System, frame: str) -> PlanarChain:
    """The chain that moves a frame. Errors: `UnsupportedError`, `InputError`; see `planar_workspace`."""
    table, q_index, v_index = local_chain(system.structure.table, frame)
    names = [system.coordinate_names[int(i)] for i in q_index]
    if not names:
        raise InputError(f"frame {frame!r} of {system.name} does not move")
    if len(table.iv) != len(v_index):
        raise UnsupportedError(
            f"the chain of {frame!r} has joints that follow each other: its workspace has other curves"
        )
    if len(names) > MOST:
        raise UnsupportedError(f"the chain of {frame!r} has {len(names)} joints; it may have {MOST}")
    q, (low, high) = system.neutral.copy(), (system.lower[v_index], system.upper[v_index])
    held = low == high
    q[q_index[held]] = low[held]
    tip, J = complex(*system.fk(q, frame)[:2, 3]), system.jacobian(q, frame)[:, v_index]
    joints: list[PlanarJoint] = []
    for label, a, b, (vx, vy, w) in zip(names, low.tolist(), high.tolist(), J[[0, 1, 5]].T, strict=True):
        if a == b:
            continue
        if w == 0.0 and not np.isfinite(b - a):
            raise InputError(f"slide {label!r} has no limits, so the workspace has no end: give it some")
        axis = None if w == 0.0 else tip + 1j * complex(vx, vy) / w
        joints.append(PlanarJoint(axis, float(w), complex(vx, vy) if w == 0.0 else 0j, a, b))
    if not joints:
        raise InputError(f"frame {frame!r} of {system.name} does not move: all its joints are held by their limits")
    return PlanarChain(tuple(joints), tip)
