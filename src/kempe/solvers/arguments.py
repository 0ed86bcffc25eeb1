"""Arguments that several solvers take, checked."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.reading import refuse_rotations
from kempe.errors import InputError
from kempe.reals import is_whole, reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

RIGID = 1e-6
"""How far the place of a frame may be from a rigid motion, or from the plane."""


def start_count(starts: object) -> int:
    """The number of starts. Errors: `InputError`."""
    if not is_whole(starts) or not 1 <= starts < 2**62:
        raise InputError(f"starts is {starts!r}; it must be a whole number, at least 1")
    return int(starts)


def step_count(iterations: object) -> int:
    """The number of steps of a start. Errors: `InputError`."""
    if not is_whole(iterations) or not 1 <= iterations < 2**31:
        raise InputError(f"iterations is {iterations!r}; it must be a whole number, at least 1")
    return int(iterations)


def deadline(time_limit: Any) -> float:
    """When a search that begins now must end, by the clock `time.monotonic`; never without a limit [s].

    Errors: `InputError`.
    """
    if time_limit is None:
        return math.inf
    if isinstance(time_limit, bool) or not isinstance(time_limit, (int, float)) or not time_limit > 0.0:
        raise InputError(f"time_limit is {time_limit!r}; it must be a positive number of seconds, or None")
    return time.monotonic() + time_limit


def seed_number(rng: object) -> int:
    """A whole number to draw from, of a generator or a number. Errors: `InputError`."""
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**62))
    if not is_whole(rng) or not 0 <= rng < 2**62:
        raise InputError(f"rng is {rng!r}; it must be a generator or a whole number, from 0 and below 2**62")
    return int(rng)


def tolerances(tolerance: Any) -> tuple[float, float]:
    """Largest errors in metres and radians, of one number or two. Errors: `InputError`."""
    try:
        linear, angular = (tolerance, tolerance) if np.ndim(tolerance) == 0 else tolerance
        if 0.0 < linear < math.inf and 0.0 < angular < math.inf:
            return float(linear), float(angular)
    except (TypeError, ValueError):
        pass
    raise InputError(f"tolerance is {tolerance!r}; it must be one or two positive numbers, in metres and radians")


def place_of(system: System, frame: str, place: Any, whole: bool) -> Array:
    """Positions (..., 2 or 3) of a frame, or its poses (..., 4, 4); what is not finite is let through.

    Errors: `InputError` for what are no numbers, no poses, or leaves the plane of a planar system.
    """
    x = reals(place, f"the place of frame {frame!r}", "numbers")
    if not whole:
        refuse_rotations(x, f"the place of frame {frame!r}")
    fine = np.isfinite(x).all(axis=(-1, -2) if whole else -1)
    tilt, height = np.zeros(1), np.zeros(1)
    if whole:
        R = x[fine][..., :3, :3]
        off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0)
        last = np.abs(x[fine][..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max(initial=0.0)
        if max(off, last) > RIGID or np.any(np.linalg.det(R) < 0.0):
            raise InputError(f"the place of frame {frame!r} is no pose: rotation with determinant +1, last row 0 0 0 1")
        tilt, height = 1.0 - R[..., 2, 2], x[fine][..., 2, 3]
    elif x.shape[-1] == 3:
        height = x[fine][..., 2]
    if system.dim == 2 and max(np.abs(tilt).max(initial=0.0), np.abs(height).max(initial=0.0)) > RIGID:
        raise InputError(f"the place of frame {frame!r} leaves the plane")
    return x


def check_constraints(constraints: object) -> None:
    """Refuse what is no list of constraints of `kempe.kinematics.zoo`."""
    from kempe.kinematics.zoo import SystemConstraint

    if not isinstance(constraints, (list, tuple)) or not all(isinstance(c, SystemConstraint) for c in constraints):
        raise InputError(f"constraints is {constraints!r}; it must be a list of constraints of kempe.kinematics.zoo")
