"""Poses and placements.

Poses are read in the usual forms; placements are constant poses of frames on bodies.

A placement is a product of elementary motions, whose numbers may be expressions in parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np

from kempe import spatial
from kempe.arguments import explain_errors
from kempe.arguments import numbers as numbers_of
from kempe.arrays import (
    DEEPEST,
    FARTHEST,
    PLAIN,
    check_range,
    is_array,
    is_number_list,
    is_real,
    is_sequence,
    read_reals,
)
from kempe.errors import InputError, format_value, warn
from kempe.numerics.rank import Spectrum
from kempe.spatial import Array
from kempe.values import Expression, Value, evaluate_value, negate_value, read_value, read_values
from kempe.words import format_count

# ---- poses in many forms

# Arrays, pairs, words, and the objects of other libraries.

EXACT = 1e-6
"""How far R'R may be from 1 for R to be taken as it is: the kernels allow this, too."""
ROUNDED = 5e-4
"""How far R'R may be from 1 for R to be taken as a rotation whose entries are off by 1e-4: the
nearest one counts."""

PARTS = ("homogeneous", "A", "as_matrix", "GetAsMatrix4", "matrix")
"""Where objects have their matrix: Pinocchio's SE3, the Spatial Math Toolbox, SciPy and jaxlie,
Drake, Sophus."""
ROS = (("position", "orientation"), ("translation", "rotation"))
"""Parts of the messages Pose and Transform of ROS, whose quaternion is x y z w."""
AROUND = ("pose", "transform")
"""Where messages with a header or a covariance have theirs: PoseStamped, TransformStamped,
PoseWithCovarianceStamped, Odometry."""
WORDS = ("at", "rpy", "angle", "quat_wxyz", "quat_xyzw", "matrix")
"""What a pose in words can have: its place, and its orientation in one way."""


def read_pose_array(x: Any, what: str, depth: int = 0) -> Any:
    """Convert poses in any form to an array (..., 4, 4). In the plane it is (..., 3, 3); rotations
    and positions are read, too.

    Objects that have a matrix, messages of ROS (the header is not read: poses are in the ground),
    pairs of a position and a rotation, poses in words,
    ``{"at": (1, 0, 0), "quat_xyzw": (0, 0, 0, 1)}``, and lists of these become arrays; all else is
    given back as it is. Errors: `InputError`.
    """
    if x.__class__ is np.ndarray or x.__class__ in PLAIN or is_number_list(x):
        return x
    if isinstance(x, Mapping):
        return _read_pose_mapping(cast("Mapping[str, Any]", x), what)
    if isinstance(x, (list, tuple)):
        if (pair := _read_pair(x, what)) is not None:
            return pair
        entries = cast("Sequence[Any]", x)
        if not any(
            isinstance(e, (Mapping, list, tuple)) or _find_matrix(e) is not None for e in entries
        ):
            return entries
        if depth == DEEPEST:
            raise InputError(
                f"{what} is {format_value(entries)}: lists are nested more than {DEEPEST} deep"
            )
        parts = [read_pose_array(e, what, depth + 1) for e in entries]
        if all(a is b for a, b in zip(parts, entries, strict=True)):
            return entries
        shapes = {np.shape(p) for p in parts}
        if len(shapes) > 1:
            raise InputError(
                f"{what} is a list of poses of different shapes, {sorted(shapes)}; all must have "
                "one"
            )
        return np.array(parts)
    found = _find_matrix(x)
    return x if found is None else found


def correct_rotations(X: Array, what: str, exact: float = EXACT) -> Array:
    """Replace slightly rounded rotations (..., n, n) by the nearest exact ones, with a warning.

    Those that are off by at most `exact` stay as they are, and what is further off than `ROUNDED`,
    for the caller to refuse. The array is copied where it changes.
    """
    if X.ndim == 2:  # the usual case, without the cost of arrays
        (a, b, c), (d, e, f), (g, h, i) = X[:3, :3].tolist()
        off = max(
            abs(a * a + d * d + g * g - 1.0),
            abs(b * b + e * e + h * h - 1.0),
            abs(c * c + f * f + i * i - 1.0),
            abs(a * b + d * e + g * h),
            abs(a * c + d * f + g * i),
            abs(b * c + e * f + h * i),
        )
        if not exact < off <= ROUNDED:
            return X
    R = X[..., :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        off = _compute_rotation_defect(R)
    rounded = (off > exact) & (off <= ROUNDED)
    if not rounded.any() or not (rounded := rounded & (compute_rotation_error(R) <= ROUNDED)).any():
        return X
    out = X.copy()
    out[rounded, :3, :3] = Spectrum(R[rounded]).orthogonal
    some = (
        ""
        if off.ndim == 0
        else f" in {np.count_nonzero(rounded)} of {format_count(off.size, 'case')}"
    )
    warn(
        f"the rotation of {what} is off by {off[rounded].max():.1g} (R'R - 1){some}; the nearest "
        "rotation was taken"
    )
    return out


def explain_pose_error(X: Array, exact: float = EXACT) -> str:
    """Explain why a matrix (4, 4) is not a valid pose; '' if it is one.

    The last row must be 0 0 0 1, all numbers finite and below `arrays.FARTHEST` in size, and R'R
    within `exact` of 1.
    """
    last = X[3].tolist()
    if np.isfinite(last).all() and last != spatial.LAST_ROW:
        return f"its last row is {last}; it must be 0 0 0 1"
    try:
        check_range(X[:3, :3], "its entry ")
        for axis, x in zip("xyz", X[:3, 3], strict=True):
            check_range(x, f"its {axis}")
        check_range(X, "its entry ")
    except InputError as error:
        return str(error)
    off = float(compute_rotation_error(X[:3, :3]))
    if off <= exact:
        return ""
    wrong = (
        f"R'R - 1 has an entry of {off:.1g}"
        if np.linalg.det(X[:3, :3]) > 0.0
        else "det R is not positive"
    )
    return f"{wrong}, where R is its rotation; R must be orthonormal with determinant +1"


def check_poses(X: Array, what: str, exact: float = EXACT) -> Array:
    """Return poses (..., 4, 4) if all are valid. Errors: `InputError` with the first invalid one
    and the reason.
    """
    good = (X[..., 3, :] == spatial.LAST_ROW).all(axis=-1) & (np.abs(X) < FARTHEST).all(
        axis=(-1, -2)
    )
    good &= compute_rotation_error(X[..., :3, :3]) <= exact
    if not good.all():
        at = [int(i) for i in np.argwhere(~good)[0]]
        raise InputError(
            f"{what}{at or ''} is not a pose: {explain_pose_error(X[tuple(at)], exact)}"
        )
    return X


def _compute_rotation_defect(R: Array) -> Array:
    """Compute the largest entry (...) of R'R - 1 of matrices (..., 3, 3)."""
    return np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2))


def compute_rotation_error(R: Array) -> Array:
    """Compute the errors (...) of rotations (..., 3, 3): the largest entry of R'R - 1. Mirrors have
    at least 2.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        off = _compute_rotation_defect(R)
        return np.where(np.linalg.det(R) < 0.0, np.maximum(off, 2.0), off)


def _find_matrix(x: Any) -> Any:
    """Find the matrix or matrices that an object holds; None if it holds none."""
    if x.__class__ in PLAIN or isinstance(x, (str, np.ndarray)):
        return None
    inner = [part for name in AROUND if (part := getattr(x, name, None)) is not None]
    inner += [part for part in (getattr(e, AROUND[0], None) for e in inner) if part is not None]
    for message in (x, *inner):
        if (found := _read_message(message)) is not None:
            return found
    for name in PARTS:
        part = getattr(x, name, None)
        try:
            found = np.asarray(part() if callable(part) else part, dtype=float)
        except (TypeError, ValueError):
            continue
        if found.ndim >= 2 and found.shape[-2:] in ((3, 3), (4, 4)):
            return found
    return None


def _read_message(x: Any) -> Array | None:
    """Read the pose of a message Pose or Transform of ROS; None for other objects."""
    for position, orientation in ROS:
        p = getattr(x, position, None)
        q = getattr(x, orientation, None)
        if all(hasattr(p, n) for n in "xyz") and all(hasattr(q, n) for n in "wxyz"):
            R = spatial.quat_wxyz_to_matrix([getattr(q, n) for n in "wxyz"])
            return spatial.pose(R, [getattr(p, n) for n in "xyz"])
    return None


def _read_pair(x: Any, what: str) -> Array | None:
    """Read the poses of a pair of positions (..., n) and rotations (..., n, n), in either order.
    None for other values.
    """
    if len(x) != 2:
        return None
    first, second = (_read_array(e) for e in x)
    if first is None or second is None:
        return None
    if first.shape[:-1] == second.shape[:-1] and {first.shape[-1:], second.shape[-1:]} == {
        (3,),
        (4,),
    }:
        raise InputError(
            f"{what} has a quaternion whose order is not named; give {{'at': p, 'quat_wxyz': q}}, "
            "or 'quat_xyzw'"
        )
    p, R = (first, second) if first.ndim < second.ndim else (second, first)
    n = p.shape[-1] if p.ndim else 0
    if n not in (2, 3) or R.ndim != p.ndim + 1 or R.shape[-2:] != (n, n):
        return None
    lead = np.broadcast_shapes(p.shape[:-1], R.shape[:-2])
    out = np.zeros((*lead, n + 1, n + 1))
    out[..., :n, :n] = R
    out[..., :n, n] = p
    out[..., n, n] = 1.0
    return out


def _read_array(x: Any) -> Array | None:
    """Convert numbers to an array; None for ragged lists and other values."""
    found = _find_matrix(x)
    try:
        return read_reals(x if found is None else found, "")
    except InputError:
        return None


def _read_pose_mapping(x: Mapping[str, Any], what: str) -> Array:
    """Read a pose from a mapping such as {"at": (1, 0, 0), "rpy": (0, 0, 1)}. Errors: `InputError`."""
    unknown = [n for n in x if n not in WORDS]
    ways = [n for n in x if n != "at"]
    if unknown or len(ways) > 1 or not x:
        wrong = (
            f"has {unknown[0]!r}"
            if unknown
            else f"has {' and '.join(ways)}"
            if ways
            else "is empty"
        )
        raise InputError(
            f"{what} {wrong}; a pose in words has 'at' and one of {', '.join(WORDS[1:])}"
        )
    at = read_reals(x.get("at", (0.0, 0.0, 0.0)), f"'at' of {what}")
    if not at.ndim or at.shape[-1] not in (2, 3):
        raise InputError(
            f"'at' of {what} has shape {at.shape}; it must be (..., 3), in the plane also (..., 2)"
        )
    p = np.zeros((*at.shape[:-1], 3))
    p[..., : at.shape[-1]] = at
    return spatial.pose(_read_rotation(ways[0], x[ways[0]], what) if ways else np.eye(3), p)


def _read_rotation(way: str, given: Any, what: str) -> Array:
    """Read rotations (..., 3, 3) given as a matrix, an angle, rpy angles or a quaternion. Errors:
    `InputError`.
    """
    if way == "matrix":
        found = _read_array(given)
        if found is None or found.shape[-2:] != (3, 3):
            raise InputError(
                f"'matrix' of {what} is {format_value(given)}; it must be rotations (..., 3, 3)"
            )
        return found
    x = read_reals(given, f"{way!r} of {what}")
    if way == "angle":
        return spatial.rot_z(x)
    n = 3 if way == "rpy" else 4
    if not x.ndim or x.shape[-1] != n:
        raise InputError(f"{way!r} of {what} has shape {x.shape}; it must be (..., {n})")
    if n == 3:
        return spatial.rpy_to_matrix(x)
    q = x if way == "quat_wxyz" else np.roll(x, 1, axis=-1)
    if not np.all(np.linalg.norm(q, axis=-1) > 0.0):
        raise InputError(f"{way!r} of {what} is {format_value(given)}; it must not be zero")
    return spatial.quat_wxyz_to_matrix(q)


# ---- placements

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
    """A constant pose as a product of elementary motions: `steps` ``(motion, numbers)``, left to
    right.
    """

    steps: tuple[Step, ...] = ()

    def evaluate_pose(self, parameters: Mapping[str, Any]) -> spatial.Array:
        """Evaluate the pose (4, 4), or (..., 4, 4) if parameters are arrays."""
        if not any(isinstance(x, Expression) for _, numbers in self.steps for x in numbers):
            return _compute_constant_pose(self.steps)
        out = np.eye(4)
        for motion, numbers in self.steps:
            out = out @ _compute_step_pose(motion, [evaluate_value(x, parameters) for x in numbers])
        return out

    @cached_property
    def names(self) -> frozenset[str]:
        """The names of the parameters in the placement."""
        return frozenset(
            n for _, xs in self.steps for x in xs if isinstance(x, Expression) for n in x.names
        )

    def invert_steps(self) -> Placement:
        """Return the inverse placement, step by step, so that expressions stay expressions."""
        return Placement(tuple(_invert_step(*step) for step in reversed(self.steps)))

    def __str__(self) -> str:
        """Format the motions in order: 'x = l1, rz = 0.5', or 'nothing' for the identity."""
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

    def drop_identity_steps(self) -> Placement:
        """Return the placement without translations and rotations by exactly zero."""
        return Placement(tuple(s for s in self.steps if s[0] not in _SCALAR or s[1] != (0.0,)))


_SCALAR = ("x", "y", "z", "rx", "ry", "rz")


@explain_errors
def place(
    at: object = (0.0, 0.0, 0.0),
    rpy: object = None,
    angle: object = None,
    axis: object = None,
    quat_wxyz: object = None,
    matrix: object = None,
) -> Placement:
    """Make a placement with the origin `at` (2 or 3 lengths) and at most one form of orientation.

    `at` can also be a pose in any form that `kempe.poses.read_pose_array` reads, or a `Placement`,
    which are turned further by the rest. `rpy` are fixed-axis angles x, y, z; `angle` turns about z
    (planar
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
        and _are_floats(at)
        and _are_floats(rpy)
        and _are_floats(axis)
    ):
        return _make_plain_placement(*(None if x is None else tuple(x) for x in (at, rpy, axis)))  # type: ignore[arg-type]
    at = read_pose_array(at, "at")
    if (at.__class__ is not tuple or len(at) == 4) and _is_pose(at):  # type: ignore[arg-type]
        return place(make_placement_from_pose(at), rpy, angle, axis, quat_wxyz, matrix)
    steps: list[Step] = [
        (n, (x,)) for n, x in zip("xyz", read_values(at, (2, 3), "at"), strict=False)
    ]
    ways = {"rpy": rpy, "angle": angle, "quat_wxyz": quat_wxyz, "matrix": matrix}
    given = [n for n, x in ways.items() if x is not None]
    if len(given) > 1:
        raise InputError(f"orientation given twice, by {' and '.join(given)}; give one")
    if rpy is not None:
        if is_real(rpy):
            raise InputError(
                f"rpy is {rpy!r}; it must have 3 numbers; one turn about z is angle={rpy!r}"
            )
        roll, pitch, yaw = read_values(rpy, 3, "rpy")
        steps += [("rz", (yaw,)), ("ry", (pitch,)), ("rx", (roll,))]
    if angle is not None:
        steps.append(("rz", (read_value(angle, "angle"),)))
    if quat_wxyz is not None:
        steps.append(("quat_wxyz", read_values(quat_wxyz, 4, "quat_wxyz")))
    if matrix is not None:
        R = numbers_of(read_pose_array(matrix, "matrix"), "matrix")
        if R.shape == (4, 4):
            raise InputError(
                "matrix is a pose (4, 4); it must be a rotation (3, 3), and a pose is given as at"
            )
        steps.append(("matrix", read_values(_correct_rotation(R).reshape(-1), 9, "matrix")))
    for step in steps:
        check_step(*step)
    if axis is not None:
        steps += list_axis_steps(axis)
    return Placement(tuple(steps)).drop_identity_steps()


def _correct_rotation(R: spatial.Array) -> spatial.Array:
    """Return the nearest rotation to a rounded rotation (3, 3); other matrices stay."""
    return correct_rotations(R, "matrix", ROTATION_TOLERANCE) if R.shape == (3, 3) else R


def _are_floats(x: object) -> bool:
    """Whether `x` is None or a tuple or list of floats."""
    entries: Any = x
    return x is None or (
        (type(x) is tuple or type(x) is list) and {float}.issuperset(map(type, entries))
    )


@lru_cache(4096)
def _make_plain_placement(
    at: tuple[float, ...] | None, rpy: tuple[float, ...] | None, axis: tuple[float, ...] | None
) -> Placement:
    """Make the placement of plain numbers, as `place` does; results are cached."""
    steps: list[Step] = [
        (n, (x,)) for n, x in zip("xyz", read_values(at, (2, 3), "at"), strict=False) if x != 0.0
    ]
    if rpy is not None:
        roll, pitch, yaw = read_values(rpy, 3, "rpy")
        steps += [(n, (x,)) for n, x in (("rz", yaw), ("ry", pitch), ("rx", roll)) if x != 0.0]
    if axis is not None:
        steps += list_axis_steps(axis)
    return Placement(tuple(steps))


def _is_pose(at: object) -> bool:
    """Whether `at` has four rows of numbers rather than 2 or 3 numbers."""
    if is_sequence(at):
        return len(at) == 4 and all(isinstance(row, (list, tuple, np.ndarray)) for row in at)
    return is_array(at) and at.shape == (4, 4)


def read_direction(axis: object) -> object:
    """Return the three numbers of a named axis such as "x" or "-z"; numbers are returned as they
    are. Errors: `InputError`.
    """
    if not isinstance(axis, str):
        return axis
    name = axis.strip().lower()
    if name not in AXES:
        raise InputError(f"axis is {axis!r}; it must be numbers, or one of x, y, z, -x, -y, -z")
    return AXES[name]


def list_axis_steps(axis: object) -> list[Step]:
    """Return the step that turns z to `axis` (2 or 3 numbers, or a name); no step for z itself.
    Errors: `InputError`.
    """
    numbers = read_values(read_direction(axis) if isinstance(axis, str) else axis, (2, 3), "axis")
    if any(isinstance(x, Expression) for x in numbers):
        raise InputError(
            f"axis is {list(map(str, numbers))}; it must be plain numbers (turn the frame by rpy "
            "instead)"
        )
    numbers = (*numbers, 0.0)[:3]
    check_step("align", numbers)
    return [] if numbers[:2] == (0.0, 0.0) and float(numbers[2]) > 0 else [("align", numbers)]  # type: ignore[arg-type]


def make_placement_from_pose(X: object) -> Placement:
    """Make the placement of a pose (4, 4). Errors: `InputError` for a matrix that is no rigid
    motion.
    """
    X = numbers_of(X, "pose")
    if X.shape != (4, 4):
        raise InputError(f"the matrix of a pose has shape {X.shape}; it must be (4, 4)")
    spatial._read_poses(X, "the matrix")
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
            f"{motion} has {format_count(len(numbers), 'number')}; it must have {COUNTS[motion]}"
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
def _compute_constant_pose(steps: tuple[Step, ...]) -> spatial.Array:
    """Compute the pose (4, 4), read-only, of steps without parameters."""
    rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    for motion, numbers in steps:
        place = _AXES.get(motion)
        if place is None:
            R = np.array(rows)
            R[:, :3] = R[:, :3] @ _compute_constant_rotation(motion, numbers)
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
def _compute_constant_rotation(motion: str, numbers: tuple[Value, ...]) -> spatial.Array:
    """Compute the rotation (3, 3) of a step without parameters."""
    return _compute_step_pose(motion, list(numbers))[:3, :3]


def _compute_step_pose(motion: str, numbers: list[Any]) -> spatial.Array:
    """Compute the pose (..., 4, 4) of one elementary motion."""
    if motion in ("x", "y", "z"):
        zero = np.zeros_like(np.asarray(numbers[0], dtype=float))
        p = [zero, zero, zero]
        p["xyz".index(motion)] = np.asarray(numbers[0], dtype=float)
        return spatial.pose(p=np.stack(p, axis=-1))
    if motion in ("rx", "ry", "rz"):
        return spatial.pose(spatial.make_rotation(numbers[0], motion[1]))
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


def _invert_step(motion: str, numbers: tuple[Value, ...]) -> Step:
    """Return the inverse of one elementary motion."""
    if motion in _SCALAR:
        return motion, (negate_value(numbers[0]),)
    if motion == "quat_wxyz":
        return motion, (numbers[0], *(negate_value(x) for x in numbers[1:]))
    if motion == "matrix":
        return motion, tuple(numbers[3 * (i % 3) + i // 3] for i in range(9))
    return {"align": "unalign", "unalign": "align"}[motion], numbers


def read_placement_steps(data: Iterable[object]) -> Placement:
    """Read a placement from ``[["z", "d1"], ["rx", 0.5], ["align", 0, 1, 0], ...]``. Errors:
    `InputError`.
    """
    steps: list[tuple[str, tuple[Value, ...]]] = []
    for item in data:
        if not is_sequence(item) or not item or not isinstance(item[0], str):
            raise InputError(
                f"step {item!r} must be a list of a motion and its numbers, such as ['rx', 0.5]"
            )
        numbers = tuple(read_value(x, item[0]) for x in item[1:])
        if (
            item[0] == "matrix"
            and len(numbers) == 9
            and not any(isinstance(x, Expression) for x in numbers)
        ):
            numbers = tuple(
                _correct_rotation(np.array(numbers, dtype=float).reshape(3, 3)).ravel().tolist()
            )
        step = (item[0], numbers)
        check_step(*step)
        steps.append(step)
    return Placement(tuple(steps))
