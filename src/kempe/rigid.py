"""Poses and rotations as people have them: arrays, pairs, words, and the objects of other
libraries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from kempe import spatial
from kempe.errors import InputError, shown, warn
from kempe.reals import DEEPEST, FARTHEST, PLAIN, is_plain, reals, within_range
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.words import counted

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
WORDS = ("at", "rpy", "angle", "quat_wxyz", "quat_xyzw", "matrix")
"""What a pose in words can have: its place, and its orientation in one way."""


def arrays(x: Any, what: str, depth: int = 0) -> Any:
    """What can be read as an array of poses (..., 4, 4), in the plane (..., 3, 3), rotations, or
    positions.

    Objects that have a matrix, pairs of a position and a rotation, poses in words,
    ``{"at": (1, 0, 0), "quat_xyzw": (0, 0, 0, 1)}``, and lists of these become arrays; all else is
    given back as it is. Errors: `InputError`.
    """
    if x.__class__ is np.ndarray or x.__class__ in PLAIN or is_plain(x):
        return x
    if isinstance(x, Mapping):
        return _in_words(cast("Mapping[str, Any]", x), what)
    if isinstance(x, (list, tuple)):
        if (pair := _of_pair(x, what)) is not None:
            return pair
        entries = cast("Sequence[Any]", x)
        if not any(
            isinstance(e, (Mapping, list, tuple)) or _matrix(e) is not None for e in entries
        ):
            return entries
        if depth == DEEPEST:
            raise InputError(
                f"{what} is {shown(entries)}: lists are nested more than {DEEPEST} deep"
            )
        parts = [arrays(e, what, depth + 1) for e in entries]
        if all(a is b for a, b in zip(parts, entries, strict=True)):
            return entries
        shapes = {np.shape(p) for p in parts}
        if len(shapes) > 1:
            raise InputError(
                f"{what} is a list of poses of different shapes, {sorted(shapes)}; all must have "
                "one"
            )
        return np.array(parts)
    found = _matrix(x)
    return x if found is None else found


def sound(X: Array, what: str, exact: float = EXACT) -> Array:
    """Poses or rotations (..., n, n) of which those that are off by rounding are the nearest
    rotations, with a warning.

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
        off = _stretched(R)
    rounded = (off > exact) & (off <= ROUNDED)
    if not rounded.any() or not (rounded := rounded & (rotation_error(R) <= ROUNDED)).any():
        return X
    U, _, Vt = svd(R[rounded])
    out = X.copy()
    out[rounded, :3, :3] = U @ Vt
    some = (
        "" if off.ndim == 0 else f" in {np.count_nonzero(rounded)} of {counted(off.size, 'case')}"
    )
    warn(
        f"the rotation of {what} is off by {off[rounded].max():.1g} (R'R - 1){some}; the nearest "
        "rotation was taken"
    )
    return out


def why_not_a_pose(X: Array, exact: float = EXACT) -> str:
    """What is wrong with a matrix (4, 4) as a pose that a search can begin with; '' where nothing
    is.

    The last row must be 0 0 0 1, all numbers finite and below `reals.FARTHEST` in size, and R'R
    within `exact` of 1.
    """
    last = X[3].tolist()
    if np.isfinite(last).all() and last != spatial.LAST_ROW:
        return f"its last row is {last}; it must be 0 0 0 1"
    try:
        within_range(X, "its entry ")
    except InputError as error:
        return str(error)
    off = float(rotation_error(X[:3, :3]))
    if off <= exact:
        return ""
    wrong = (
        f"R'R - 1 has an entry of {off:.1g}"
        if np.linalg.det(X[:3, :3]) > 0.0
        else "det R is not positive"
    )
    return f"{wrong}, where R is its rotation; R must be orthonormal with determinant +1"


def refuse_no_poses(X: Array, what: str, exact: float = EXACT) -> Array:
    """Poses (..., 4, 4) that a search can begin with. Errors: `InputError` that says which one is
    none, and why.
    """
    good = (X[..., 3, :] == spatial.LAST_ROW).all(axis=-1) & (np.abs(X) < FARTHEST).all(
        axis=(-1, -2)
    )
    good &= rotation_error(X[..., :3, :3]) <= exact
    if not good.all():
        at = [int(i) for i in np.argwhere(~good)[0]]
        raise InputError(f"{what}{at or ''} is not a pose: {why_not_a_pose(X[tuple(at)], exact)}")
    return X


def _stretched(R: Array) -> Array:
    return np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2))


def rotation_error(R: Array) -> Array:
    """How far (...) matrices (..., 3, 3) are from rotations: the largest entry of R'R - 1, at least
    2 for mirrors.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        off = _stretched(R)
        return np.where(np.linalg.det(R) < 0.0, np.maximum(off, 2.0), off)


def _matrix(x: Any) -> Any:
    """The matrix that an object has, or the matrices; None where it has none."""
    if x.__class__ in PLAIN or isinstance(x, (str, np.ndarray)):
        return None
    for position, orientation in ROS:
        p = getattr(x, position, None)
        q = getattr(x, orientation, None)
        if all(hasattr(p, n) for n in "xyz") and all(hasattr(q, n) for n in "wxyz"):
            R = spatial.quat_wxyz_to_matrix([getattr(q, n) for n in "wxyz"])
            return spatial.pose(R, [getattr(p, n) for n in "xyz"])
    for name in PARTS:
        part = getattr(x, name, None)
        try:
            found = np.asarray(part() if callable(part) else part, dtype=float)
        except (TypeError, ValueError):
            continue
        if found.ndim >= 2 and found.shape[-2:] in ((3, 3), (4, 4)):
            return found
    return None


def _of_pair(x: Any, what: str) -> Array | None:
    """The poses of a pair of positions (..., n) and rotations (..., n, n), in either order; None
    for all else.
    """
    if len(x) != 2:
        return None
    first, second = (_shaped(e) for e in x)
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


def _shaped(x: Any) -> Array | None:
    """Numbers as an array; None for what is ragged or no numbers."""
    found = _matrix(x)
    try:
        return reals(x if found is None else found, "")
    except InputError:
        return None


def _in_words(x: Mapping[str, Any], what: str) -> Array:
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
    at = reals(x.get("at", (0.0, 0.0, 0.0)), f"'at' of {what}")
    if not at.ndim or at.shape[-1] not in (2, 3):
        raise InputError(
            f"'at' of {what} has shape {at.shape}; it must be (..., 3), in the plane also (..., 2)"
        )
    p = np.zeros((*at.shape[:-1], 3))
    p[..., : at.shape[-1]] = at
    return spatial.pose(_rotation(ways[0], x[ways[0]], what) if ways else np.eye(3), p)


def _rotation(way: str, given: Any, what: str) -> Array:
    if way == "matrix":
        found = _shaped(given)
        if found is None or found.shape[-2:] != (3, 3):
            raise InputError(
                f"'matrix' of {what} is {shown(given)}; it must be rotations (..., 3, 3)"
            )
        return found
    x = reals(given, f"{way!r} of {what}")
    if way == "angle":
        return spatial.rot_z(x)
    n = 3 if way == "rpy" else 4
    if not x.ndim or x.shape[-1] != n:
        raise InputError(f"{way!r} of {what} has shape {x.shape}; it must be (..., {n})")
    if n == 3:
        return spatial.rpy_to_matrix(x)
    q = x if way == "quat_wxyz" else np.roll(x, 1, axis=-1)
    if not np.all(np.linalg.norm(q, axis=-1) > 0.0):
        raise InputError(f"{way!r} of {what} is {shown(given)}; it must not be zero")
    return spatial.quat_wxyz_to_matrix(q)
