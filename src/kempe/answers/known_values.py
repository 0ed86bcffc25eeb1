"""Known values by name: values of coordinates and places of frames, and the tasks that verify them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.answers.targets import Z_AXIS, make_target_constraints
from kempe.arrays import read_reals
from kempe.constraints.base import read_poses, refuse_rotations
from kempe.errors import InputError
from kempe.model.configurations import compute_source_values
from kempe.poses import EXACT, check_poses, compute_rotation_error, read_pose_array
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

WITHIN = (1e-6, 1e-6)
"""Metres and radians that a known value may be off by."""


def convert_places(given: Mapping[str, Any], frames: Sequence[str]) -> Mapping[str, Any]:
    """Convert the places of frames among known values to arrays. Errors: `InputError`."""
    if not frames:
        return given
    return {
        k: read_pose_array(x, f"the place of frame {k!r}") if k in frames else x
        for k, x in given.items()
    }


def read_place(system: Model, frame: str, place: Any, whole: bool) -> Array:
    """Read the position (..., 2 or 3) [m] of a frame, or its pose (..., 4, 4) if `whole`.

    Numbers that are not finite are let through.

    Errors: `InputError` for what are no numbers, no poses, or leaves the plane of a planar system.
    """
    what = f"the place of frame {frame!r}"
    if whole:
        X = read_poses(place, 3, what)
        for bad in X[
            ~(compute_rotation_error(X[..., :3, :3]) <= EXACT) & np.isfinite(X).all(axis=(-1, -2))
        ][:1]:
            check_poses(bad, what)
        return read_poses(X, system.dim, what)
    x = read_reals(place, what, "numbers")
    refuse_rotations(x, what)
    if system.dim == 2 and x.shape[-1] == 3 and np.any(np.abs(x[..., 2]) > EXACT):
        raise InputError(f"{what} leaves the plane")
    return x


def find_source_values(system: Model, known: Mapping[str, Any]) -> dict[str, Array]:
    """Map known values to independent coordinates: a coupled coordinate gives its source the value.

    Errors: `UnknownNameError`; `InputError` for a coordinate that follows another one whose known
    value does not fit, or that is held at another value.
    """
    return {
        name: read_reals(x, f"coordinate {name!r}", "a number")
        for name, x in compute_source_values(system, known).items()
    }


# ---- for the judge


class HeldCoordinate(NamedTuple):
    """Task that the coordinate `label` of q has the `value` (...)."""

    label: str
    place: int
    turns: bool
    value: Any

    def measure_error(self, q: Array, goal: Any, poses: Any) -> tuple[Array, Array]:
        """How far (...) configurations q (..., nq) miss it, in metres and in radians."""
        off = np.abs(q[..., self.place] - self.value)
        return (np.zeros_like(off), off) if self.turns else (off, np.zeros_like(off))


def list_known_tasks(system: Model, known: Mapping[str, Any]) -> list[tuple[Any, Any, Any]]:
    """List the tasks, goals and tolerances that verify known values of coordinates and frames."""
    from kempe.equations.tasks import Task  # only here: most answers are not judged

    own = {*system.coordinate_names, *system.structure.couplings}
    turns = system.structure.coordinates.turning[system.structure.layout.vector_v].tolist()
    turning = dict(zip(system.structure.layout.vector_q.tolist(), turns, strict=True))
    out: list[tuple[Any, Any, Any]] = []
    for name, value in find_source_values(
        system, {k: x for k, x in known.items() if k in own}
    ).items():
        i = system.coordinate_names.index(name)
        out.append((HeldCoordinate(name, i, turning.get(i, True), value), None, WITHIN))
    for name in known.keys() - own:
        whole = np.ndim(known[name]) == 2
        X = np.eye(4)
        place = read_place(system, name, known[name], whole)
        X[: len(place), 3 if not whole else slice(None)] = place
        made = make_target_constraints(name, "pose" if whole else "position", Z_AXIS, X)
        out += [(Task(system, c), None, WITHIN) for c in made]
    return out
