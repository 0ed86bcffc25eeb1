"""Forms in which the forward model is written: whole poses, their upper three rows, positions, with
quaternions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.calls import known, quiet
from kempe.errors import InputError, shown
from kempe.kernels.compiled import chain
from kempe.kinematics.common.parallel import over_chunks
from kempe.kinematics.configuration import as_q
from kempe.model.kept import kept
from kempe.model.tree.gauge import regauge
from kempe.spatial import Array, matrix_to_quat_wxyz

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled

FEW = 2048
"""Configurations whose poses, or numbers of another type, are held at once: a block that stays in
the cache."""
CHUNK = 16384
SERIAL_BELOW = 20_000


class Form(NamedTuple):
    """What of a pose is written: an array of this `shape`, as `of` makes it from poses (..., 4, 4)."""

    shape: tuple[int, ...]
    of: Callable[[Array], Array]


def _pose(X: Array) -> Array:
    return X


def _rows(X: Array) -> Array:
    return X[..., :3, :]


def _position(X: Array) -> Array:
    return X[..., :3, 3]


def _position_quat_wxyz(X: Array) -> Array:
    return np.concatenate([X[..., :3, 3], matrix_to_quat_wxyz(X[..., :3, :3])], axis=-1)


FORMS = {
    "matrix": Form((4, 4), _pose),
    "3x4": Form((3, 4), _rows),
    "position": Form((3,), _position),
    "position_quat_wxyz": Form((7,), _position_quat_wxyz),
}
"""The forms by their names."""
TYPES = ("float64", "float32")


@kept
def chain_table(system: Compiled, frame: str) -> tuple[np.ndarray, Array]:
    """The chain that leads to a frame, packed for the kernels that compute chains in the cheapest
    form.
    """
    return regauge(*system.structure.table.pack([frame], system.structure.table.path(frame)))


@quiet
def in_form(
    system: Compiled,
    q: Any,
    frame: Any,
    out: Array | None,
    threads: int | None,
    form: str | None,
    dtype: Any,
    relative_to: Any = None,
) -> Array:
    """Poses of a frame in a chosen form and number type; arguments and errors as in `forward.fk`."""
    from kempe.kinematics.forward import fk

    wanted = FORMS[known("form", "matrix" if form is None else form, FORMS)]
    try:
        kind = np.dtype(dtype)  # of None float64
    except (TypeError, ValueError, SyntaxError):
        kind = np.dtype(object)
    if kind.name not in TYPES:
        raise InputError(f"dtype is {shown(dtype)}; allowed: {', '.join(TYPES)}")
    q = as_q(system, q)
    one: Any = frame
    several = frame is None or isinstance(frame, (list, tuple))
    base = None if relative_to is None else system.structure.frame_name(relative_to)

    def poses(at: Array) -> Array:
        X = fk(system, at, one, threads=1)
        if base is None:
            return X
        back = spatial.inverse(fk(system, at, base, threads=1))
        return (back[..., None, :, :] if several else back) @ X

    lead = q.shape[:-1] + ((len(system.body_names if frame is None else one),) if several else ())
    out = _taken(out, (*lead, *wanted.shape), kind)
    if q.ndim == 1:
        out[...] = wanted.of(poses(q))
        return out
    flat = q.reshape(math.prod(q.shape[:-1]), system.nq)
    rows = out.reshape(len(flat), *out.shape[q.ndim - 1 :])
    if np.may_share_memory(q, out):
        flat = flat.copy()
    table = (
        None
        if several or base is not None
        else chain_table(system, system.structure.frame_name(one))
    )
    width = math.prod(wanted.shape)

    def some(start: int, stop: int) -> int:
        if table is None:
            rows[start:stop] = wanted.of(poses(flat[start:stop]))
            return 0
        made = rows[start:stop] if kind == np.float64 else np.empty((stop - start, *wanted.shape))
        bad = chain.chain_poses(*table, flat[start:stop], made.reshape(stop - start, width))
        if kind != np.float64:
            rows[start:stop] = made
        return bad

    def work(start: int, stop: int) -> int:
        if table is not None and kind == np.float64:
            return some(start, stop)
        return sum(some(i, min(i + FEW, stop)) for i in range(start, stop, FEW))

    over_chunks(work, len(flat), CHUNK, threads, SERIAL_BELOW)
    return out


def _taken(out: Array | None, shape: tuple[int, ...], kind: np.dtype) -> Array:
    """The array `out`, checked, or a new array where `out` is None."""
    if out is None:
        return np.empty(shape, dtype=kind)
    if (
        isinstance(out, np.ndarray)
        and out.shape == shape
        and out.dtype == kind
        and out.flags.carray
    ):
        return out
    given = (
        f"{out.dtype} array of shape {out.shape}"
        if isinstance(out, np.ndarray)
        else type(out).__name__
    )
    raise InputError(
        f"out is a {given}; it must be a writable, C-contiguous {kind} array of shape {shape}"
    )
