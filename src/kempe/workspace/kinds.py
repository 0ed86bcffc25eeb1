"""Kinds of workspaces: places reached in any, one or several orientations, or orientations.

Whether one is reached is decided by the inverse model, in closed form where there is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.answers.targets import Z_AXIS
from kempe.arguments import check_name, numbers
from kempe.budget import Budget
from kempe.errors import InputError, format_value
from kempe.inverse.closed_forms.plan import find_plan_or_reason
from kempe.inverse.ik import ik
from kempe.inverse.ik_all import ik_all
from kempe.poses import EXACT, compute_rotation_error
from kempe.spatial import Array
from kempe.workspace.legs import find_legs, find_possible_places

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- kinds

# The inverse model is in closed form where the chain has one, leg by leg where the mechanism is
# made of legs, else a search. Sources of the kinds: Kumar, Waldron, "The workspaces of a mechanical
# manipulator", J. Mechanical Design 103 (1981); Merlet, *Parallel Robots*, 2006, chapter 7.

REACHABLE = "reachable"
CONSTANT = "constant-orientation"
DEXTEROUS = "dexterous"
ORIENTATION = "orientation"
KINDS = (REACHABLE, CONSTANT, DEXTEROUS, ORIENTATION)
TURNS = {2: 180, 3: 256}
"""Orientations that stand for all of them, in the plane and in space."""
STARTS = 64
"""Starts of a search for one pose."""
TURNED = {2: ("angle",), 3: ("azimuth", "height", "roll")}
"""Coordinates of orientations, of which equal cells hold equally many: an angle, or the azimuth and
the height of the z axis on the unit sphere and the turn about it (Euler's angles z-y-z, with the
cosine of the second)."""
RANGES = {2: ((-np.pi, np.pi),), 3: ((-np.pi, np.pi), (-1.0, 1.0), (-np.pi, np.pi))}


@dataclass(frozen=True)
class WorkspaceKind:
    """Kind of workspace: places in the orientations `turns` (k, 9), or orientations at a place.

    These are reached `at` a place. `tried`: samples are places or orientations that the inverse
    model decides, not configurations.
    """

    kind: str = REACHABLE
    turns: tuple[tuple[float, ...], ...] = ()
    at: tuple[float, ...] = ()
    tried: bool = False

    @classmethod
    def from_data(cls, made: dict[str, Any]) -> WorkspaceKind:
        """Make the kind of workspace of a stored map from its data."""
        at = tuple(made["at"])
        turns = tuple(tuple(r) for r in made["turns"])
        return cls(made["kind"], turns, at, made["tried"])

    @cached_property
    def rotations(self) -> Array:
        """The orientations (k, 3, 3) in which places must be reached."""
        return np.reshape(self.turns, (-1, 3, 3))

    def all_turns(self, dim: int) -> bool:
        """Return whether the orientations sample all rotations."""
        return len(self.turns) == TURNS[dim] and np.array_equal(
            self.rotations, spread_rotations(TURNS[dim], dim)
        )

    @property
    def noun(self) -> str:
        """The noun for elements of the workspace, such as places."""
        return "orientation" if self.kind == ORIENTATION else "place"

    def find_reached_points(
        self, system: Model, frame: str, points: Array, seed: int
    ) -> np.ndarray:
        """Return a mask (n,) of the points (n, 3) that are reached within limits and constraints.

        Points that inverse kinematics does not find count as not reached.
        """
        if self.kind == ORIENTATION:
            return self._find_reached(system, frame, points, seed)
        out = find_possible_places(system, frame, points)
        out[out] = self._find_reached(system, frame, points[out], seed)
        return out

    def _find_reached(self, system: Model, frame: str, points: Array, seed: int) -> np.ndarray:
        """Find which points (n, 3) are reached, all within the lengths of the links."""
        X = np.tile(np.eye(4), (len(points), 1, 1))
        X[:, :3, 3] = self.at or points
        if self.kind == REACHABLE:
            return find_reached(system, X, frame, "position", seed)
        if self.kind == ORIENTATION:
            X[:, :3, :3] = compute_rotations(points, system.dim)
            return find_reached(system, X, frame, "pose", seed)
        left = np.arange(len(points))
        for R in self.rotations:
            X[:, :3, :3] = R
            left = left[find_reached(system, X[left], frame, "pose", seed)] if len(left) else left
        return np.isin(np.arange(len(points)), left)


def find_reached(system: Model, X: Array, frame: str, task: str, seed: int) -> np.ndarray:
    """Find which poses (n, 4, 4), or for the task "position" which places, a frame reaches."""
    if not len(X):
        return np.zeros(0, dtype=bool)
    legs = find_legs(system, frame) if task == "pose" else ()
    if legs:
        out = np.ones(len(X), dtype=bool)
        for leg in legs:
            out[out] = find_reached(leg, X[out], frame, task, seed)
        return out
    if not isinstance(find_plan_or_reason(system, frame, task, Z_AXIS), str):
        goals = X[:, : system.dim, 3] if task == "position" else X
        every: Any = ik_all(system, goals, frame, task=task, limits=True)
        out = np.asarray(every.mask.any(axis=-1))
        left = ~out & ~np.asarray(every.complete)
        if left.any():
            out[left] = search_reached(system, X[left], frame, task, seed)
        return out
    return search_reached(system, X, frame, task, seed)


def search_reached(system: Model, X: Array, frame: str, task: str, seed: int) -> np.ndarray:
    """Search which poses a frame reaches. Places have as many starts as in `ik`."""
    budget = Budget(rng=seed) if task == "position" else Budget(rng=seed, starts=STARTS)
    goals = X[:, : system.dim, 3] if task == "position" else X
    return np.asarray(ik(system, goals, frame, task=task, budget=budget).success, dtype=bool)


# ---- orientations


def compute_rotations(points: Array, dim: int) -> Array:
    """Compute rotations (n, 3, 3) from coordinates `TURNED` (n, 3), in the plane from the angle."""
    a, c, b = points.T
    if dim == 2:
        return spatial.exp_so3(np.column_stack([0.0 * a, 0.0 * a, a]))
    s = np.sqrt(np.maximum(1.0 - c * c, 0.0))
    ca = np.cos(a)
    sa = np.sin(a)
    cb = np.cos(b)
    sb = np.sin(b)
    rows = [
        [ca * c * cb - sa * sb, -ca * c * sb - sa * cb, ca * s],
        [sa * c * cb + ca * sb, -sa * c * sb + ca * cb, sa * s],
        [-s * cb, s * sb, c],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def compute_rotation_coordinates(R: Array, dim: int) -> Array:
    """Compute coordinates (..., 3) of rotations (..., 3, 3), the inverse of `compute_rotations`.
    Unused coordinates are 0.
    """
    out = np.zeros(R.shape[:-1])
    if dim == 2:
        out[..., 0] = np.arctan2(R[..., 1, 0], R[..., 0, 0])
        return out
    s = np.hypot(R[..., 0, 2], R[..., 1, 2])
    level = s > 1e-12  # else only the sum of azimuth and roll counts
    out[..., 0] = np.where(level, np.arctan2(R[..., 1, 2], R[..., 0, 2]), 0.0)
    out[..., 1] = np.clip(R[..., 2, 2], -1.0, 1.0)
    out[..., 2] = np.where(
        level, np.arctan2(R[..., 2, 1], -R[..., 2, 0]), np.arctan2(R[..., 1, 0], R[..., 1, 1])
    )
    return out


def spread_rotations(n: int, dim: int) -> Array:
    """Spread rotations (n, 3, 3) evenly, in space along a super-Fibonacci spiral.

    Source: Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3)", CVPR 2022.
    """
    if dim == 2:
        return compute_rotations(
            np.pad(2.0 * np.pi * np.arange(n)[:, None] / n, ((0, 0), (0, 2))), 2
        )
    s = np.arange(n) + 0.5
    a = 2.0 * np.pi * s / np.sqrt(2.0)
    b = 2.0 * np.pi * s / 1.533751168755204288118041
    near = np.sqrt(s / n)
    far = np.sqrt(1.0 - s / n)
    quat_wxyz = np.column_stack(
        [near * np.sin(a), near * np.cos(a), far * np.sin(b), far * np.cos(b)]
    )
    return spatial.quat_wxyz_to_matrix(quat_wxyz)


def read_rotations(x: Any, dim: int, what: str = "orientation") -> Array:
    """Read rotations (..., 3, 3), given as such or as angles. In the plane these are angles (...),
    in space roll, pitch, yaw (3,).

    Errors: `InputError`.
    """
    needed = "angles in radians (...), or rotations (..., 3, 3)"
    if dim == 3:
        needed = "rotations (..., 3, 3), or roll, pitch and yaw (3,) in radians"
    R = numbers(x, what)
    if R.shape[-2:] != (3, 3):
        if dim == 2:
            R = compute_rotations(np.pad(R.reshape(-1, 1), ((0, 0), (0, 2))), 2).reshape(
                *R.shape, 3, 3
            )
        elif R.shape == (3,):
            R = spatial.pose_from_xyz_rpy(np.concatenate([np.zeros(3), R]))[:3, :3]
        else:
            raise InputError(f"{what} has shape {R.shape}; it must be {needed}")
    if not np.isfinite(R).all() or R.size == 0:
        raise InputError(f"{what} is {format_value(x)}; it must be finite {needed}, at least one")
    about_z = dim == 3 or bool((np.abs(R[..., 2, 2] - 1.0) < EXACT).all())
    if (compute_rotation_error(R) > EXACT).any() or not about_z:
        raise InputError(
            f"{what} is no rotation{'' if about_z else ' of the plane'}; it must be {needed}"
        )
    return R


# ---- the kind that arguments state


def read_workspace_kind(
    system: Model, frame: str, kind: object, orientation: Any, at: Any
) -> WorkspaceKind:
    """Read the kind of workspace from the arguments of `workspace`. Errors: `InputError`."""
    if kind is None:
        several = orientation is not None and np.ndim(orientation) not in (
            (0,) if system.dim == 2 else (1, 2)
        )
        kind = ORIENTATION if at is not None else REACHABLE if orientation is None else CONSTANT
        kind = DEXTEROUS if several else kind
    word = check_name("kind", kind, KINDS)
    if (at is not None) != (word == ORIENTATION):
        raise InputError(
            f"kind {word!r} {'needs' if at is None else 'reads no'} at, the place of the frame's "
            "origin, which kind 'orientation' reads"
        )
    if word == REACHABLE and orientation is None:
        return WorkspaceKind()
    if bool(system.structure.table.at[frame][2]):
        raise InputError(
            f"{frame!r} is a particle, which has no orientation: its only workspace is the "
            "reachable one"
        )
    if word == ORIENTATION:
        p = numbers(at, "at")
        if p.shape != (system.dim,) or not np.isfinite(p).all():
            raise InputError(
                f"at is {format_value(at)}; it must be one place ({system.dim},) of finite numbers "
                "in metres"
            )
        if orientation is not None:
            raise InputError("kind 'orientation' looks for orientations: it reads none")
        return WorkspaceKind(word, at=(*p.tolist(), 0.0)[:3], tried=True)
    if word == REACHABLE:
        raise InputError(
            f"kind 'reachable' reads no orientation: kinds {CONSTANT!r} and {DEXTEROUS!r} do"
        )
    if orientation is None and word == CONSTANT:
        given = (
            "an angle in radians"
            if system.dim == 2
            else "a rotation (3, 3), or roll, pitch and yaw in radians"
        )
        raise InputError(f"kind {CONSTANT!r} needs an orientation: {given}")
    R = (
        spread_rotations(TURNS[system.dim], system.dim)
        if orientation is None
        else read_rotations(orientation, system.dim)
    )
    if word == CONSTANT and R.shape != (3, 3):
        raise InputError(
            f"kind {CONSTANT!r} reads one orientation, not {len(R)}: kind {DEXTEROUS!r} reads "
            "several"
        )
    return WorkspaceKind(word, tuple(tuple(r) for r in R.reshape(-1, 9).tolist()), tried=True)
