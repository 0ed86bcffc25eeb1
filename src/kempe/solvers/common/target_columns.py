"""Targets as tables have them: in columns, by their order or by their names."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kempe import spatial
from kempe.errors import InputError
from kempe.spatial import Array
from kempe.words import counted, listed

PLACE = ("x", "y", "z")
TURNED = ("roll", "pitch", "yaw")
QUATERNION = ("qw", "qx", "qy", "qz")
COLUMNS = {
    2: [("x", "y"), ("x", "y", "angle"), (*PLACE, *TURNED), (*PLACE, *QUATERNION)],
    3: [PLACE, (*PLACE, *TURNED), (*PLACE, *QUATERNION)],
}
"""What columns of targets can be, in the plane and in space; the first are positions only."""


def said_columns(dim: int) -> str:
    """What columns of targets can be, in words."""
    return ", ".join(
        ",".join(names) + " (position only)" * (k == 0) for k, names in enumerate(COLUMNS[dim][:-1])
    ) + (f" or {','.join(COLUMNS[dim][-1])}")


def poses_of_columns(
    dim: int, values: Array, names: Sequence[str] | None = None, degrees: bool = False
) -> tuple[Array, bool]:
    """Poses (..., 4, 4) of targets in columns (..., k), and whether only their position counts.

    Columns are in the order of `COLUMNS`, or have the `names` there. Angles turn about fixed axes,
    as in URDF; where `degrees` says so they are degrees. A quaternion of length zero gives NaN.
    Errors: `InputError`.
    """
    width = values.shape[-1]
    order = next(
        (
            c
            for c in COLUMNS[dim]
            if (len(c) == width if names is None else sorted(c) == sorted(names))
        ),
        None,
    )
    if order is None:
        has = counted(width, "number") if names is None else f"the columns {listed(names, 12)}"
        raise InputError(f"the target has {has}; it must be {said_columns(dim)}")
    if names is not None:
        values = values[..., [list(names).index(name) for name in order]]
    full = np.zeros((*values.shape[:-1], 6))
    whole = ("x", "y", "yaw") if order[-1] == "angle" else order[:3] if order[-1] == "qz" else order
    full[..., [(*PLACE, *TURNED).index(name) for name in whole]] = values[..., : len(whole)]
    if degrees:
        full[..., 3:] *= math.pi / 180.0
    with np.errstate(invalid="ignore", over="ignore"):
        X = spatial.pose_from_xyz_rpy(full)
        if order[-1] == "qz":
            X[..., :3, :3] = spatial.quat_wxyz_to_matrix(values[..., 3:])
    return X, order == COLUMNS[dim][0]
