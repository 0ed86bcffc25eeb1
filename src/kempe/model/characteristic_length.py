"""Size and place of a mechanism: its characteristic length, and the origin of its loops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arrays import compute_median
from kempe.joints import Fixed
from kempe.model.model import keep_answers
from kempe.model.own_tree import remove_cut_marks
from kempe.model.primitive_table import Table
from kempe.units import from_metres

if TYPE_CHECKING:
    from kempe.model.model import Model, SystemType

NOTHING = 1e-12
"""Lengths, in metres, that no link has."""
SHORT = 1e-2
"""Links shorter than this part of the longest but one are offsets by which axes miss each other,
and not typical.

It is the widest tolerance of dimensions, as a part of the size: rounded numbers do not decide what
the size is.
"""
FAR = 10.0
"""Characteristic lengths from the ground's origin to its joints beyond which loops are measured
from there."""


@keep_answers
def compute_characteristic_length(system: Model) -> float:
    """Compute the characteristic length of a system: a typical length of a link.

    It is in the unit of the system; 1 m if all lengths are 0.

    The median over the links of how far apart their joints are (for two, their distance): it
    depends neither on where loops are cut nor on where bodies have their origins. Where no link has
    two, the mean distance of frames from the joint before them.
    """
    found: list[float] = []
    for links in _group_joint_points(system).values():
        points = np.array(links)
        unit = _choose_unit(points)
        off = (points - points.mean(axis=0)) / unit
        spread = unit * float(2.0 * np.sqrt((off**2).sum(axis=-1).mean()))
        if spread > NOTHING * (1.0 + float(np.abs(points).max())):
            found.append(spread)
    if found:
        least = SHORT * sorted(found)[-2:][0]
        return compute_median([x for x in found if x > least])
    table = remove_cut_marks(system).structure.table
    found = _compute_lengths(table.placement[..., :3, 3]).ravel().tolist()
    found += [
        float(_compute_lengths(np.asarray(X)[..., :3, 3]).max()) for _, X, _ in table.at.values()
    ]
    real = [x for x in found if x > NOTHING * (1.0 + max(found))]
    return float(np.mean(real)) if real else from_metres(1.0, system.unit)


def _choose_unit(v: np.ndarray) -> float:
    """Choose a power of two, by which vectors are divided before they are squared.

    It is 1 unless squares would be infinite.
    """
    return 2.0**600 if np.abs(v).max(initial=0.0) > 1e150 else 1.0


def _compute_lengths(v: np.ndarray) -> np.ndarray:
    """Compute the lengths (...) of vectors (..., 3)."""
    unit = _choose_unit(v)
    return unit * np.linalg.norm(v / unit, axis=-1)


def adopt_characteristic_length(system: SystemType, other: Model) -> SystemType:
    """Give a system the characteristic length of another one, of which it is a small change."""
    system._kept.setdefault(LENGTH, {})[()] = compute_characteristic_length(other)
    return system


LENGTH: Any = compute_characteristic_length.__wrapped__  # type: ignore[attr-defined]
"""What the characteristic length is kept by."""


def choose_origin(system: Model) -> np.ndarray:
    """Choose the point (3,) from which positions in loop equations are measured.

    For a mechanism far from the ground's origin it is the mean of its joints on the ground, so that
    no digits are lost.
    """
    points = _group_joint_points(system).get(-1, [])
    center = np.mean(points, axis=0) if len(points) else np.zeros(3)
    return (
        center
        if np.linalg.norm(center) > FAR * compute_characteristic_length(system)
        else np.zeros(3)
    )


def move_table(table: Table, by: np.ndarray) -> Table:
    """Return the table with all that is attached to the ground moved by a vector (3,) in metres."""
    X = np.eye(4)
    X[:3, 3] = by
    placement = table.placement.copy()
    root = table.parent == -1
    placement[..., root, :, :] = X @ placement[..., root, :, :]
    at = {
        name: (row, X @ pose if row < 0 else pose, particle)
        for name, (row, pose, particle) in table.at.items()
    }
    return replace(table, placement=placement, at=at)


@keep_answers
def _group_joint_points(system: Model) -> dict[int, list[np.ndarray]]:
    """List, for each row of the table, the places (3,) of joints and constraints on it.

    Row -1 is the ground; fixed joints do not count.
    """
    system = remove_cut_marks(system)
    out: dict[int, list[np.ndarray]] = {}
    for body, point in _iterate_joint_points(system):
        row, X, _ = system.structure.table.at[body]
        out.setdefault(row, []).append(np.asarray(X)[:3, :3] @ point + np.asarray(X)[:3, 3])
    return out


def _iterate_joint_points(system: Model) -> Iterator[tuple[str, np.ndarray]]:
    """Iterate over the bodies that joints and constraints connect, with the place (3,) on each."""
    mechanism = system._mechanism
    for j in mechanism.joints.values():
        if not isinstance(j.type, Fixed):
            yield j.parent, j.X_PF.evaluate_pose(mechanism.parameters)[:3, 3]
            yield j.child, j.X_CM.evaluate_pose(mechanism.parameters)[:3, 3]
    for c in (c for c in mechanism.constraints.values() if c.parent):
        A, B = c.frames(mechanism.parameters, system.dim)
        yield c.parent, A[:3, 3]
        yield c.child, B[:3, 3]
