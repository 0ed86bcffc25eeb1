"""Targets and tasks of inverse kinematics: reading, checking, and conversion to constraints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import numbers
from kempe.arrays import explain_ragged_list, is_array, is_sequence, read_reals
from kempe.constraints.base import Constraint, refuse_rotations
from kempe.errors import InputError
from kempe.poses import (
    check_poses,
    correct_rotations,
    explain_pose_error,
    read_direction,
    read_pose_array,
)
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.constraints.base import Constraint
    from kempe.model.model import Model

Z_AXIS = (0.0, 0.0, 1.0)

UNTURNED = 1e-6
"""Largest entry of R - 1 of a pose that is given for a particle, which has no orientation."""

TASKS = {
    "pose": (1, 1, 1, 1, 1, 1), "position": (1, 1, 1, 0, 0, 0), "orientation": (0, 0, 0, 1, 1, 1),
    "direction": (0, 0, 0, 1, 1, 0), "position_axis": (1, 1, 1, 1, 1, 0),
}  # fmt: skip
"""Tasks, and which errors [linear; angular] in the frame of the tip count; the direction is that of
its z axis."""

AXIS_TASKS = ("direction", "position_axis")
"""Tasks on an axis of the tool."""


def make_target_constraints(
    frame: str, task: str, axis: tuple[float, float, float], X: Array
) -> list[Constraint]:
    """Make the constraints that bring a frame to a target (..., 4, 4), for a named task."""
    # only here: most targets are reached by numbers alone
    from kempe.constraints.kinds import Orientation, Pointing, Pose, Position

    out: list[Constraint] = []
    if task == "pose":
        out.append(Pose(frame, X))
    if task in AXIS_TASKS:
        out.append(Pointing(frame, X[..., :3, :3] @ np.array(axis), axis=axis))
    if task == "orientation":
        out.append(Orientation(frame, X[..., :3, :3]))
    if task in ("position", "position_axis"):
        out.append(Position(frame, X[..., :3, 3]))
    return out


def list_twist_rows(task: str, dim: int) -> list[int]:
    """List the rows of a twist [linear; angular] that count in a task."""
    return [r for r in range(6) if TASKS[task][r] and (dim == 3 or r in (0, 1, 5))]


def choose_task(task: object, is_position: bool, particle: bool) -> str:
    """Return the name of the task, by default the one for the kind of target. Errors: `InputError`."""
    if task is None:
        return "position" if is_position or particle else "pose"
    if not isinstance(task, str) or task not in TASKS:
        raise InputError(
            f"task is {task!r}; it must be one of {', '.join(map(repr, TASKS))}, or a pair of the "
            "last two and an axis: ('direction', (1, 0, 0))"
        )
    if particle and task != "position":
        raise InputError(f"task {task!r} asks for an orientation, which a particle does not have")
    return task


def read_target(system: Model, target: Any) -> Any:
    """Convert a target to an array; the name of a frame on the ground stands for its pose (4, 4).

    Errors: those of `kempe.poses.read_pose_array`; `UnknownNameError`, `InputError` for frames that
    move.
    """
    if isinstance(target, Constraint) or (
        is_sequence(target) and any(isinstance(part, Constraint) for part in target)
    ):
        raise InputError("target holds tasks, which name their own frames: leave out the frame")
    if not isinstance(target, str):
        return read_pose_array(target, "target")
    name = system.structure.frame_name(target)
    if system.structure.table.find_path(name):
        raise InputError(
            f"target is the frame {name!r}, which moves; it must be on the ground, or give its pose"
        )
    from kempe.forward.fk import fk

    return fk(system, system.neutral, name)


def split_task(task: Any) -> tuple[Any, Any]:
    """Split a `task` into its name and the axis of the tool to be pointed, by default z."""
    if is_sequence(task) and len(task) == 2:
        return task[0], task[1]
    return task, Z_AXIS


def read_axis(axis: object) -> tuple[float, float, float]:
    """Return the axis of the tool to be pointed as a unit vector. Errors: `InputError`."""
    v = read_reals(read_direction(axis), "axis", "three numbers: a direction in the tool's frame")
    size = float(np.linalg.norm(v)) if v.shape == (3,) and np.all(np.abs(v) < 1e100) else 0.0
    if size == 0.0:
        raise InputError(
            f"axis is {axis!r}; it must be three numbers, not all zero: a direction in the tool's "
            "frame"
        )
    x, y, z = (v / size).tolist()
    return x, y, z


def choose_axis(axis: object, task: str | None) -> tuple[float, float, float]:
    """Return the axis to be pointed in a task, z if the task has none. Errors: `InputError`."""
    given = Z_AXIS if axis is Z_AXIS else read_axis(axis)
    return given if is_axis_task(task) else Z_AXIS


def make_rotations_along(z: Array) -> Array:
    """Make rotations (..., 3, 3) whose third column is the unit vector z (..., 3)."""
    z = np.asarray(z, dtype=float)
    other = np.where(np.abs(z[..., 2:3]) < 0.8, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(other, z)
    x = x / np.sqrt((x * x).sum(axis=-1, keepdims=True))
    return np.asarray(np.stack([x, np.cross(z, x), z], axis=-1), dtype=float)


def turn_targets_to_axis(targets: Array, axis: tuple[float, float, float]) -> Array:
    """Rotate targets (..., 4, 4) so that their z axis is the pointed `axis` of the tool."""
    if axis == Z_AXIS:
        return targets
    out = targets.copy()
    out[..., :3, :3] = out[..., :3, :3] @ make_rotations_along(np.array(axis))
    return out


def parse_task_targets(
    system: Model, target: Any, task: str | None, axis: tuple[float, float, float]
) -> tuple[Array, tuple[int, ...], bool]:
    """Parse targets of a task into poses (N, 4, 4).

    Also returned are their leading shape, and whether positions were given. Errors: `InputError`.

    Besides poses and positions: directions (..., 3) for the task "direction", rotations (..., 3, 3)
    for "orientation", and (..., 6), position and direction, for "position_axis"; directions are
    those of the tool's axis. In the plane (..., 3), x, y and angle, for "pose".
    """
    try:
        shape = np.shape(target)
    except ValueError:
        raise InputError(_explain_ragged_target(target)) from None
    width = 3 if task == "direction" else 6 if task == "position_axis" else None
    if task == "orientation" and shape[-2:] == (3, 3) and system.dim == 3:
        out = np.zeros((*shape[:-2], 4, 4))
        out[..., :3, :3] = read_target_numbers(target)
        out[..., 3, 3] = 1.0
        return parse_targets(system, out)
    if task == "pose" and system.dim == 2 and shape[-1:] == (3,):
        target = _make_planar_poses(read_target_numbers(target))
    if width is None or shape[-1:] != (width,) or shape[-2:] == (4, 4):
        return parse_targets(system, target, task == "position")
    values = read_target_numbers(target)
    d = values[..., -3:]
    size = np.linalg.norm(d, axis=-1, keepdims=True)
    if not shape[:-1] and not (np.isfinite(values).all() and size.item() > 0.0):
        raise InputError("the direction of the target must be finite and not zero")
    out = np.zeros((math.prod(shape[:-1]), 4, 4))
    with np.errstate(invalid="ignore", divide="ignore"):
        R = make_rotations_along(d / size)
        out[:, :3, :3] = (
            R if axis == Z_AXIS else R @ make_rotations_along(np.array(axis)).T
        ).reshape(-1, 3, 3)
    out[:, 3, 3] = 1.0
    if width == 6:
        out[:, :3, 3] = values[..., :3].reshape(-1, 3)
    return out, shape[:-1], False


def _explain_ragged_target(target: Any) -> str:
    """Explain why a list is no target; a position beside a quaternion has names."""
    said = f"target is {explain_ragged_list(target)}" if is_sequence(target) else "target is ragged"
    parts = target if is_sequence(target) else ()
    sizes = [len(part) for part in parts if is_sequence(part) or (is_array(part) and part.ndim)]
    if sizes == [3, 4] and len(parts) == 2:
        allowed = (
            "with a quaternion, write {'at': [x, y, z], 'quat_wxyz': [w, x, y, z]}, or 'quat_xyzw'"
        )
    else:
        allowed = "it must be an array of real numbers"
    return f"{said}; {allowed}"


def _make_planar_poses(target: Array) -> Array:
    """Make poses (..., 4, 4) from x, y and angle (..., 3); planar poses (..., 3, 3) stay."""
    if target.shape[-2:] == (3, 3) and np.all(target[..., 2, :] == [0.0, 0.0, 1.0]):
        return target
    x, y, angle = np.moveaxis(target, -1, 0)
    out = np.zeros((*target.shape[:-1], 4, 4))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0], out[..., 0, 1] = np.sin(angle), -np.sin(angle)
    out[..., 0, 3], out[..., 1, 3], out[..., 2, 2], out[..., 3, 3] = x, y, 1.0, 1.0
    return out


def refuse_position(task: str, is_position: bool, dim: int) -> None:
    """Refuse positions as targets of a task that needs an orientation. Errors: `InputError`."""
    if is_position and task != "position":
        also = ", or x, y and angle (..., 3)" if dim == 2 and task == "pose" else ""
        raise InputError(
            f"target is a position, but task {task!r} asks for an orientation; give a pose (..., "
            f"4, 4){also}"
        )


def make_planar_target(target: Any, task: str | None, axis: object) -> tuple[Any, str]:
    """Convert a target that points an axis of the tool to a pose or orientation in the plane.

    Returned are poses (..., 4, 4), and the task "pose" or "orientation".

    Directions and positions have two or three numbers; poses and other shapes stay as they are.
    Errors: `InputError`.
    """
    full = "orientation" if task == "direction" else "pose"
    shape = np.shape(target)
    widths = (2, 3) if task == "direction" else (4, 6)
    if shape[-2:] in ((4, 4), (3, 3)) or shape[-1:] not in [(w,) for w in widths]:
        return target, full
    x, y, _ = read_axis(axis)
    values = read_target_numbers(target)
    k = shape[-1] // (1 if task == "direction" else 2)
    d = values[..., -k:]
    if not shape[:-1] and not np.any(d):
        raise InputError("the direction of the target must be finite and not zero")
    if math.hypot(x, y) < 1e-9 or (k == 3 and np.any(np.abs(d[..., 2]) > 1e-9)):
        raise InputError(
            "in a planar system the axis of the tool and its direction must lie in the plane"
        )
    angle = np.arctan2(d[..., 1], d[..., 0]) - math.atan2(y, x)
    out = _make_planar_poses(np.stack([np.zeros_like(angle), np.zeros_like(angle), angle], axis=-1))
    if task != "direction":
        out[..., :k, 3] = values[..., :k]
    return out, full


def is_axis_task(task: str | None) -> bool:
    """Whether the task points one axis of the tool, instead of a full orientation."""
    return task in AXIS_TASKS


def read_target_numbers(target: Any) -> Array:
    """Convert a target to an array of real numbers. Errors: `InputError`."""
    return numbers(target, "target")


def parse_targets(
    system: Model, target: Any, positions: bool = False
) -> tuple[Array, tuple[int, ...], bool]:
    """Parse poses or positions into poses (N, 4, 4).

    Also returned are their leading shape, and whether they are positions; with `positions` they
    must be.

    Errors: `InputError`, also for rotations (3, 3) that would pass for three positions.
    """
    array = read_target_numbers(target)
    planar = system.dim == 2
    is_pose = array.ndim >= 2 and array.shape[-2:] == (4, 4)
    if (
        planar
        and array.ndim >= 2
        and array.shape[-2:] == (3, 3)
        and np.all(array[..., 2, :] == [0.0, 0.0, 1.0])
    ):
        flat = array
        array = np.zeros((*flat.shape[:-2], 4, 4))
        array[..., :2, :2], array[..., :2, 3], array[..., 2, 2], array[..., 3, 3] = (
            flat[..., :2, :2],
            flat[..., :2, 2],
            1.0,
            1.0,
        )
        is_pose = True
    if is_pose:
        lead = array.shape[:-2]
        if not lead:  # of many, the kernels tell those that need a closer look
            array = correct_rotations(array, "target")
        out = array.reshape(math.prod(lead), 4, 4)
        if (
            not lead
            and out.flags.c_contiguous
            and out.flags.aligned
            and array[3].tolist() == [0.0, 0.0, 0.0, 1.0]
        ):
            return out, lead, False  # the usual case, without the cost of arrays
        # a transposed pose would pass for another one
        bad = np.any(out[:, 3] != [0.0, 0.0, 0.0, 1.0], axis=-1)
        if bad.any():
            out = out.copy()
            out[bad, :3] = math.nan
            if not lead:
                check_poses(array, "target")
        return np.require(out, requirements=["C", "A"]), lead, False
    if array.ndim and (array.shape[-1] == 3 or (planar and array.shape[-1] == 2)):
        lead = array.shape[:-1]
        if not positions:
            refuse_rotations(array, "target")
        out = np.zeros((math.prod(lead), 4, 4))
        out[:] = np.eye(4)
        out[:, : array.shape[-1], 3] = array.reshape(len(out), array.shape[-1])
        return out, lead, True
    in_plane = ", or (..., 3, 3) or (..., 2) in the plane" if planar else ""
    allowed = f"a pose (..., 4, 4) or a position (..., 3){in_plane}"
    if array.shape == (7,):
        allowed += (
            "; with a quaternion, write {'at': [x, y, z], 'quat_xyzw': [x, y, z, w]}, or "
            "'quat_wxyz'"
        )
    elif array.shape == (6,):
        allowed += "; with angles, write {'at': [x, y, z], 'rpy': [roll, pitch, yaw]}"
    raise InputError(f"target has shape {array.shape}; it must be {allowed}")


def check_particle(targets: Array, name: str) -> None:
    """Refuse poses that rotate a particle, which has no orientation. Errors: `InputError`."""
    # a NaN stays one
    turned = np.abs(targets[:, :3, :3] - np.eye(3)).max(axis=(1, 2), initial=0.0) > UNTURNED
    if turned.any():
        raise InputError(
            f"{name!r} is a particle, which has no orientation; give a position (..., 3) as target"
        )


def explain_refused_target(target: Array, other: str = "target") -> str:
    """Explain why a target (4, 4) was refused.

    If the target itself is a pose, the message names `other`, the argument that was wrong instead.
    """
    if why := explain_pose_error(target):
        return f"target is not a pose: {why}"
    return f"{other} has entries that are not finite or too large, or a quaternion that is zero"
