"""Arguments that several solvers take, checked."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.reading import poses_of, refuse_rotations
from kempe.errors import InputError, shown
from kempe.reals import is_whole, reals
from kempe.rigid import EXACT, arrays, refuse_no_poses, rotation_error
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


DRAWN = 10**6
"""Starts of a search that draws them all before it begins, at most."""


def start_count(starts: object, most: int = 2**62 - 1) -> int:
    """The number of starts. Errors: `InputError`."""
    if not is_whole(starts) or not 1 <= starts <= most:
        above = f" and at most {most}" if most == DRAWN else ""
        raise InputError(f"starts is {shown(starts)}; it must be a whole number, at least 1{above}")
    return int(starts)


def step_count(iterations: object) -> int:
    """The number of steps of a start. Errors: `InputError`."""
    if not is_whole(iterations) or not 1 <= iterations < 2**31:
        raise InputError(
            f"iterations is {shown(iterations)}; it must be a whole number, at least 1"
        )
    return int(iterations)


LONGEST = 1e15
"""Seconds above which a time limit is none."""


def deadline(time_limit: Any) -> float:
    """When a search that begins now must end, by the clock `time.monotonic`; never without a limit
    [s].

    Errors: `InputError`.
    """
    if time_limit is None:
        return math.inf
    if (
        isinstance(time_limit, bool)
        or not isinstance(time_limit, (int, float))
        or not time_limit > 0.0
    ):
        raise InputError(
            f"time_limit is {shown(time_limit)}; it must be a positive number of seconds, or None"
        )
    return time.monotonic() + (math.inf if time_limit > LONGEST else float(time_limit))


def seed_number(rng: object) -> int:
    """A whole number to draw from, of a generator or a number. Errors: `InputError`."""
    if is_whole(rng) and 0 <= rng < 2**62:
        return int(rng)
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**62))
    raise InputError(
        f"rng is {shown(rng)}; it must be a generator or a whole number, from 0 and below 2**62"
    )


def tolerances(tolerance: Any) -> tuple[float, float]:
    """Largest errors in metres and radians, of one number or two. Errors: `InputError`."""
    try:
        linear, angular = (tolerance, tolerance) if np.ndim(tolerance) == 0 else tolerance
        if 0.0 < linear < math.inf and 0.0 < angular < math.inf:
            return float(linear), float(angular)
    except (TypeError, ValueError):
        pass
    raise InputError(
        f"tolerance is {shown(tolerance)}; it must be one or two positive numbers, in metres and "
        "radians"
    )


def with_places(given: Mapping[str, Any], frames: Sequence[str]) -> Mapping[str, Any]:
    """Known values by name, the places of frames as arrays. Errors: `InputError`."""
    if not frames:
        return given
    return {
        k: arrays(x, f"the place of frame {k!r}") if k in frames else x for k, x in given.items()
    }


def place_of(system: System, frame: str, place: Any, whole: bool) -> Array:
    """Positions (..., 2 or 3) of a frame, or its poses (..., 4, 4); what is not finite is let
    through.

    Errors: `InputError` for what are no numbers, no poses, or leaves the plane of a planar system.
    """
    what = f"the place of frame {frame!r}"
    if whole:
        X = poses_of(place, 3, what)
        for bad in X[
            ~(rotation_error(X[..., :3, :3]) <= EXACT) & np.isfinite(X).all(axis=(-1, -2))
        ][:1]:
            refuse_no_poses(bad, what)
        return poses_of(X, system.dim, what)
    x = reals(place, what, "numbers")
    refuse_rotations(x, what)
    if system.dim == 2 and x.shape[-1] == 3 and np.any(np.abs(x[..., 2]) > EXACT):
        raise InputError(f"{what} leaves the plane")
    return x
