"""What is asked of the analytical inverse model: targets, task, joints that are held, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.configuration import as_q
from kempe.solvers.analytic.plan import TASKS
from kempe.solvers.inverse import parse_targets
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

Z_AXIS = (0.0, 0.0, 1.0)

FARTHEST = 1e5
"""Largest coordinate of `near`: beyond, an angle with its turns has lost the digits that solutions have."""


@dataclass(frozen=True, eq=False)
class Question:
    """Targets (N, 4, 4) for a frame, with `lead` their leading shape (None for one target), and the task."""

    system: System
    frame: str
    task: str
    axis: tuple[float, float, float]
    targets: Array = field(repr=False)
    lead: tuple[int, ...] | None
    tolerance: float


def task_of(task: object, is_position: bool, particle: bool) -> str:
    """The task by its name, or as the target says. Errors: `InputError`."""
    if task is None:
        return "position" if is_position or particle else "pose"
    if not isinstance(task, str) or task not in TASKS:
        raise InputError(f"task is {task!r}; it must be one of {', '.join(map(repr, TASKS))}")
    if particle and task != "position":
        raise InputError(f"task {task!r} asks for an orientation, which a particle does not have")
    return task


def within(tolerance: object) -> float:
    """The tolerance of a solution. Errors: `InputError`."""
    if isinstance(tolerance, (int, float, np.number)) and 0.0 < tolerance < math.inf:
        return float(tolerance)
    raise InputError(f"tolerance is {tolerance!r}; it must be a positive number, in metres and radians")


def axis_of(axis: object) -> tuple[float, float, float]:
    """The pointing axis as a unit vector of the tool. Errors: `InputError`."""
    try:
        v = np.asarray(axis, dtype=float)
    except (TypeError, ValueError):
        v = np.zeros(0)
    size = float(np.linalg.norm(v)) if v.shape == (3,) and np.all(np.abs(v) < 1e100) else 0.0
    if size == 0.0:
        raise InputError(f"axis is {axis!r}; it must be three numbers, not all zero: a direction in the tool's frame")
    x, y, z = (v / size).tolist()
    return x, y, z


def frame_of(z: Array) -> Array:
    """Rotations (..., 3, 3) whose third column is the unit vector z (..., 3)."""
    z = np.asarray(z, dtype=float)
    other = np.where(np.abs(z[..., 2:3]) < 0.8, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(other, z)
    x = x / np.sqrt((x * x).sum(axis=-1, keepdims=True))
    return np.asarray(np.stack([x, np.cross(z, x), z], axis=-1), dtype=float)


def targets_of(
    system: System, target: Any, task: str | None, axis: tuple[float, float, float]
) -> tuple[Array, tuple[int, ...], bool]:
    """Targets (N, 4, 4), their leading shape, and whether positions were given. Errors: `InputError`.

    Besides poses and positions: directions (..., 3) for the task "direction", rotations (..., 3, 3) for "orientation",
    and (..., 6), position and direction, for "position_axis"; directions are those of the tool's axis.
    """
    try:
        shape = np.shape(target)
    except ValueError:
        raise InputError("target is ragged; it must be an array of real numbers") from None
    width = {"direction": 3, "position_axis": 6}.get(task or "")
    if task == "orientation" and shape[-2:] == (3, 3) and system.dim == 3:
        out = np.zeros((*shape[:-2], 4, 4))
        out[..., :3, :3], out[..., 3, 3] = target, 1.0
        return parse_targets(system, out)
    if width is None or shape[-1:] != (width,) or shape[-2:] == (4, 4):
        return parse_targets(system, target)
    values = np.asarray(target, dtype=float)
    d = values[..., -3:]
    size = np.linalg.norm(d, axis=-1, keepdims=True)
    if not shape[:-1] and not (np.isfinite(values).all() and size.item() > 0.0):
        raise InputError("the direction of the target must be finite and not zero")
    out = np.zeros((math.prod(shape[:-1]), 4, 4))
    with np.errstate(invalid="ignore", divide="ignore"):
        R = frame_of(d / size)
        out[:, :3, :3] = (R if axis == Z_AXIS else R @ frame_of(np.array(axis)).T).reshape(-1, 3, 3)
    out[:, 3, 3] = 1.0
    if width == 6:
        out[:, :3, 3] = values[..., :3].reshape(-1, 3)
    return out, shape[:-1], False


def in_plane(target: Any, task: str | None, axis: object) -> tuple[Any, str]:
    """Target and task of a planar system where an axis of the tool is pointed: the angle of the frame is then given.

    Directions have two or three numbers, positions too; poses are left as they are.
    """
    full = "orientation" if task == "direction" else "pose"
    shape, widths = np.shape(target), (2, 3) if task == "direction" else (4, 6)
    if shape[-2:] in ((4, 4), (3, 3)) or shape[-1:] not in [(w,) for w in widths]:
        return target, full
    x, y, _ = axis_of(axis)
    values = np.asarray(target, dtype=float)
    k = shape[-1] // (1 if task == "direction" else 2)
    d = values[..., -k:]
    if math.hypot(x, y) < 1e-9 or (k == 3 and np.any(np.abs(d[..., 2]) > 1e-9)):
        raise InputError("in a planar system the axis of the tool and its direction must lie in the plane")
    angle = np.arctan2(d[..., 1], d[..., 0]) - math.atan2(y, x)
    out = np.zeros((*shape[:-1], 4, 4))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0], out[..., 0, 1] = np.sin(angle), -np.sin(angle)
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    if task != "direction":
        out[..., :k, 3] = values[..., :k]
    return out, full


def points_along(task: str | None) -> bool:
    """Whether the task reads one axis of the tool only."""
    return task in ("direction", "position_axis")


def held(frame: str, names: tuple[str, ...], fixed: object, more: Mapping[str, Any]) -> dict[str, Array]:
    """Values of joints of the chain that are held, by name. Errors: `InputError`, `UnknownNameError`."""
    if fixed is not None and not isinstance(fixed, Mapping):
        raise InputError(f"fixed is {type(fixed).__name__}; it must be a dict of values by joint name")
    out = {}
    for name, value in {**(fixed or {}), **more}.items():
        if name not in names:
            raise UnknownNameError("joint", str(name), names, f"the chain of {frame!r}")
        try:
            out[name] = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"{name} is held at {value!r}; it must be a number, or one for each target") from None
    return out


def near_of(system: System, near: Any, lead: tuple[int, ...] | None) -> Array | None:
    """Configurations (1 or N, nq) near which angles are given; None for none. Errors: `InputError`."""
    if near is None:
        return None
    q = as_q(system, near)
    if q.ndim > 1 and q.shape[:-1] != (lead or ()):
        each = f" or {(*lead, system.nq)}" if lead else ""
        raise InputError(f"near has shape {q.shape}; it must be ({system.nq},){each}")
    if not np.all(np.abs(q) < FARTHEST):
        raise InputError(f"near has entries that are not finite, or beyond {FARTHEST:g}: turns cannot be counted there")
    return q.reshape(math.prod(q.shape[:-1]), system.nq)


