"""Where a frame sits on a body: a product of elementary motions, whose numbers may be expressions
in parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from kempe import spatial
from kempe.calls import explained
from kempe.calls import numbers as numbers_of
from kempe.errors import InputError
from kempe.reals import FARTHEST, is_array, is_real, is_sequence
from kempe.rigid import arrays, sound
from kempe.values import Expression, Value, evaluate, negate, value, values
from kempe.words import counted

Step = tuple[str, tuple[Value, ...]]

COUNTS = {
    "x": 1,
    "y": 1,
    "z": 1,
    "rx": 1,
    "ry": 1,
    "rz": 1,
    "align": 3,
    "unalign": 3,
    "quat_wxyz": 4,
    "matrix": 9,
}
"""Elementary motions and how many numbers each takes: slides and turns along and about x, y, z;
`align` turns z to an axis by the smallest rotation and `unalign` undoes that; a unit quaternion; a
rotation matrix by rows."""

AXES = {
    sign + name: tuple(float(f"{sign}1") * (name == other) + 0.0 for other in "xyz")
    for sign in ("", "+", "-")
    for name in "xyz"
}
"""Directions by name: 'x', '-z'."""

ROTATION_TOLERANCE = 1e-9
"""How far a matrix may be from a rotation and be taken as it is."""


@dataclass(frozen=True)
class Placement:
    """A constant pose as the product, from left to right, of elementary `steps`
    ``(motion, numbers)``.
    """

    steps: tuple[Step, ...] = ()

    def evaluate(self, parameters: Mapping[str, Any]) -> spatial.Array:
        """Pose (4, 4), or (..., 4, 4) where parameters are arrays."""
        if not any(isinstance(x, Expression) for _, numbers in self.steps for x in numbers):
            return _constant(self.steps)
        out = np.eye(4)
        for motion, numbers in self.steps:
            out = out @ _step_pose(motion, [evaluate(x, parameters) for x in numbers])
        return out

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of the parameters that it uses."""
        return frozenset(
            n for _, xs in self.steps for x in xs if isinstance(x, Expression) for n in x.names
        )

    def inverse(self) -> Placement:
        """The inverse placement, step by step, so that expressions stay expressions."""
        return Placement(tuple(_inverse_step(*step) for step in reversed(self.steps)))

    def __str__(self) -> str:
        """The motions in their order: 'x = l1, rz = 0.5'; 'nothing' where they coincide."""
        said = (
            ", ".join(x.text if isinstance(x, Expression) else f"{x:g}" for x in xs)
            for _, xs in self.steps
        )
        named = zip(self.steps, said, strict=True)
        return (
            ", ".join(f"{m} = {f'({text})' if len(xs) > 1 else text}" for (m, xs), text in named)
            or "nothing"
        )

    def __matmul__(self, other: Placement) -> Placement:
        return Placement(self.steps + other.steps)

    def simplified(self) -> Placement:
        """Without steps that do nothing (slides and turns by exactly zero)."""
        return Placement(tuple(s for s in self.steps if s[0] not in _SCALAR or s[1] != (0.0,)))


_SCALAR = ("x", "y", "z", "rx", "ry", "rz")


@explained
def place(
    at: object = (0.0, 0.0, 0.0),
    rpy: object = None,
    angle: object = None,
    axis: object = None,
    quat_wxyz: object = None,
    matrix: object = None,
) -> Placement:
    """Placement with the origin `at` (2 or 3 lengths) and an orientation given in at most one way.

    `at` can also be a pose in any form that `kempe.rigid.arrays` reads, or a `Placement`, which are
    turned further by the rest. `rpy` are fixed-axis angles x, y, z; `angle` turns about z (planar
    systems); `quat_wxyz` and `matrix` as named. `axis` finally turns z to this direction, read in
    the axes that the rest describes; it need not have unit length, and can be a name: "x", "-z".
    Errors: `InputError` for wrong counts, numbers that are not finite, a zero axis, a matrix that
    does not rotate.
    """
    if isinstance(at, Placement):
        return at @ place(rpy=rpy, angle=angle, axis=axis, quat_wxyz=quat_wxyz, matrix=matrix)
    if (
        angle is None
        and quat_wxyz is None
        and matrix is None
        and _floats(at)
        and _floats(rpy)
        and _floats(axis)
    ):
        return _plain(*(None if x is None else tuple(x) for x in (at, rpy, axis)))  # type: ignore[arg-type]
    at = arrays(at, "at")
    if (at.__class__ is not tuple or len(at) == 4) and _is_pose(at):  # type: ignore[arg-type]
        return place(placement_of_pose(at), rpy, angle, axis, quat_wxyz, matrix)
    steps: list[Step] = [(n, (x,)) for n, x in zip("xyz", values(at, (2, 3), "at"), strict=False)]
    ways = {"rpy": rpy, "angle": angle, "quat_wxyz": quat_wxyz, "matrix": matrix}
    given = [n for n, x in ways.items() if x is not None]
    if len(given) > 1:
        raise InputError(f"orientation given twice, by {' and '.join(given)}; give one")
    if rpy is not None:
        if is_real(rpy):
            raise InputError(
                f"rpy is {rpy!r}; it must have 3 numbers; one turn about z is angle={rpy!r}"
            )
        roll, pitch, yaw = values(rpy, 3, "rpy")
        steps += [("rz", (yaw,)), ("ry", (pitch,)), ("rx", (roll,))]
    if angle is not None:
        steps.append(("rz", (value(angle, "angle"),)))
    if quat_wxyz is not None:
        steps.append(("quat_wxyz", values(quat_wxyz, 4, "quat_wxyz")))
    if matrix is not None:
        R = numbers_of(arrays(matrix, "matrix"), "matrix")
        if R.shape == (4, 4):
            raise InputError(
                "matrix is a pose (4, 4); it must be a rotation (3, 3), and a pose is given as at"
            )
        steps.append(("matrix", values(_rotation(R).reshape(-1), 9, "matrix")))
    for step in steps:
        check_step(*step)
    if axis is not None:
        steps += axis_steps(axis)
    return Placement(tuple(steps)).simplified()


def _rotation(R: spatial.Array) -> spatial.Array:
    """A rotation (3, 3), the nearest one where its numbers are rounded; what is none stays."""
    return sound(R, "matrix", ROTATION_TOLERANCE) if R.shape == (3, 3) else R


def _floats(x: object) -> bool:
    """Whether there are plain numbers, in a tuple or a list, or nothing."""
    entries: Any = x
    return x is None or (
        (type(x) is tuple or type(x) is list) and {float}.issuperset(map(type, entries))
    )


@lru_cache(4096)
def _plain(
    at: tuple[float, ...] | None, rpy: tuple[float, ...] | None, axis: tuple[float, ...] | None
) -> Placement:
    """`place` of plain numbers; many joints have the same ones."""
    steps: list[Step] = [
        (n, (x,)) for n, x in zip("xyz", values(at, (2, 3), "at"), strict=False) if x != 0.0
    ]
    if rpy is not None:
        roll, pitch, yaw = values(rpy, 3, "rpy")
        steps += [(n, (x,)) for n, x in (("rz", yaw), ("ry", pitch), ("rx", roll)) if x != 0.0]
    if axis is not None:
        steps += axis_steps(axis)
    return Placement(tuple(steps))


def _is_pose(at: object) -> bool:
    """Whether `at` has four rows of numbers rather than 2 or 3 numbers."""
    if is_sequence(at):
        return len(at) == 4 and all(isinstance(row, (list, tuple, np.ndarray)) for row in at)
    return is_array(at) and at.shape == (4, 4)


def direction(axis: object) -> object:
    """`axis` as it is, or the three numbers that its name means: "x", "-z". Errors: `InputError`
    for other names.
    """
    if not isinstance(axis, str):
        return axis
    name = axis.strip().lower()
    if name not in AXES:
        raise InputError(f"axis is {axis!r}; it must be numbers, or one of x, y, z, -x, -y, -z")
    return AXES[name]


def axis_steps(axis: object) -> list[Step]:
    """The step that turns z to `axis` (2 or 3 numbers, or a name), or nothing where it is z.
    Errors: `InputError`.
    """
    numbers = values(direction(axis) if isinstance(axis, str) else axis, (2, 3), "axis")
    if any(isinstance(x, Expression) for x in numbers):
        raise InputError(
            f"axis is {list(map(str, numbers))}; it must be plain numbers (turn the frame by rpy "
            "instead)"
        )
    numbers = (*numbers, 0.0)[:3]
    check_step("align", numbers)
    return [] if numbers[:2] == (0.0, 0.0) and float(numbers[2]) > 0 else [("align", numbers)]  # type: ignore[arg-type]


def placement_of_pose(X: object) -> Placement:
    """Placement of a pose given as a (4, 4) matrix. Errors: `InputError` where it is not a rigid
    motion.
    """
    X = numbers_of(X, "pose")
    if X.shape != (4, 4):
        raise InputError(f"the matrix of a pose has shape {X.shape}; it must be (4, 4)")
    spatial._poses(X, "the matrix")
    return (
        place(X[:3, 3])
        if np.array_equal(X[:3, :3], np.eye(3))
        else place(X[:3, 3], matrix=X[:3, :3])
    )


def check_step(motion: str, numbers: tuple[Value, ...]) -> None:
    """Refuse a step that is no motion. Errors: `InputError`."""
    if motion not in COUNTS:
        raise InputError(f"unknown motion {motion!r}; allowed are {', '.join(COUNTS)}")
    if len(numbers) != COUNTS[motion]:
        raise InputError(
            f"{motion} has {counted(len(numbers), 'number')}; it must have {COUNTS[motion]}"
        )
    if motion in _SCALAR:
        if is_real(numbers[0]) and not abs(numbers[0]) < FARTHEST:
            raise InputError(f"{motion} is {numbers[0]!r}; its size must be below {FARTHEST:g}")
        return
    if any(isinstance(x, Expression) for x in numbers):
        if motion in ("align", "unalign", "matrix"):
            raise InputError(
                f"{motion} has an expression among its numbers; it takes plain numbers only"
            )
        return
    if motion != "matrix" and 1e-100 < math.hypot(*numbers) < 1e100:  # type: ignore[arg-type]
        return  # the common case, without the cost of an array
    array = np.array(numbers, dtype=float)
    if motion in ("align", "unalign", "quat_wxyz") and not np.isfinite(spatial.unit(array)).all():
        what = "quaternion" if motion == "quat_wxyz" else "axis"
        raise InputError(
            f"{what} is {' '.join(map(repr, array.tolist()))}; it must be finite and not zero"
        )
    if motion == "matrix":
        R = array.reshape(3, 3)
        if np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
            raise InputError("matrix is not a rotation (orthonormal, determinant +1)")


_AXES = {
    "x": (False, 0),
    "y": (False, 1),
    "z": (False, 2),
    "rx": (True, 0),
    "ry": (True, 1),
    "rz": (True, 2),
}
"""Whether a motion along or about an axis turns, and the axis."""


@lru_cache(1024)
def _constant(steps: tuple[Step, ...]) -> spatial.Array:
    """Pose (4, 4), read-only, of steps without parameters."""
    rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    for motion, numbers in steps:
        place = _AXES.get(motion)
        if place is None:
            R = np.array(rows)
            R[:, :3] = R[:, :3] @ _constant_turn(motion, numbers)
            rows = R.tolist()
            continue
        turns, axis = place
        x = float(numbers[0])  # type: ignore[arg-type]
        if not turns:
            for row in rows:
                row[3] += row[axis] * x
            continue
        c = math.cos(x)
        s = math.sin(x)
        i = (axis + 1) % 3
        j = (axis + 2) % 3
        for row in rows:
            row[i], row[j] = c * row[i] + s * row[j], c * row[j] - s * row[i]
    out = np.array([*rows, [0.0, 0.0, 0.0, 1.0]])
    out.setflags(write=False)
    return out


@lru_cache(1024)
def _constant_turn(motion: str, numbers: tuple[Value, ...]) -> spatial.Array:
    return _step_pose(motion, list(numbers))[:3, :3]


def _step_pose(motion: str, numbers: list[Any]) -> spatial.Array:
    if motion in ("x", "y", "z"):
        zero = np.zeros_like(np.asarray(numbers[0], dtype=float))
        p = [zero, zero, zero]
        p["xyz".index(motion)] = np.asarray(numbers[0], dtype=float)
        return spatial.pose(p=np.stack(p, axis=-1))
    if motion in ("rx", "ry", "rz"):
        return spatial.pose(
            {"rx": spatial.rot_x, "ry": spatial.rot_y, "rz": spatial.rot_z}[motion](numbers[0])
        )
    array = np.stack(np.broadcast_arrays(*numbers), axis=-1).astype(float)
    if motion == "align":
        return spatial.pose(spatial.align_z(array))
    if motion == "unalign":
        return spatial.pose(np.swapaxes(spatial.align_z(array), -1, -2))
    if motion == "quat_wxyz":
        return spatial.pose(spatial.quat_wxyz_to_matrix(array))
    R = array.reshape(*array.shape[:-1], 3, 3)
    # one Newton step to the nearest rotation: what the tolerance let pass is squared (Higham, 1986)
    return spatial.pose(0.5 * R @ (3.0 * np.eye(3) - np.swapaxes(R, -1, -2) @ R))


def _inverse_step(motion: str, numbers: tuple[Value, ...]) -> Step:
    if motion in _SCALAR:
        return motion, (negate(numbers[0]),)
    if motion == "quat_wxyz":
        return motion, (numbers[0], *(negate(x) for x in numbers[1:]))
    if motion == "matrix":
        return motion, tuple(numbers[3 * (i % 3) + i // 3] for i in range(9))
    return {"align": "unalign", "unalign": "align"}[motion], numbers


def steps_from_data(data: Iterable[object]) -> Placement:
    """Placement from ``[["z", "d1"], ["rx", 0.5], ["align", 0, 1, 0], ...]``. Errors: `InputError`."""
    steps: list[tuple[str, tuple[Value, ...]]] = []
    for item in data:
        if not is_sequence(item) or not item or not isinstance(item[0], str):
            raise InputError(
                f"step {item!r} must be a list of a motion and its numbers, such as ['rx', 0.5]"
            )
        numbers = tuple(value(x, item[0]) for x in item[1:])
        if (
            item[0] == "matrix"
            and len(numbers) == 9
            and not any(isinstance(x, Expression) for x in numbers)
        ):
            numbers = tuple(
                _rotation(np.array(numbers, dtype=float).reshape(3, 3)).ravel().tolist()
            )
        step = (item[0], numbers)
        check_step(*step)
        steps.append(step)
    return Placement(tuple(steps))
