"""The forward geometric model: poses of bodies and frames (`fk`), and Jacobians (`jacobian`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from types import MethodType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from kempe import spatial
from kempe.arguments import check_name, explain_errors, quiet
from kempe.errors import InputError, UnknownNameError, format_value
from kempe.kernels.compiled import bound, chain, make_allocator, table_sweep
from kempe.kernels.forward.table_layout import BODY, WORLD, WORLD_ALIGNED, fuse_table
from kempe.model.configurations import read_q
from kempe.model.gauge import regauge_table
from kempe.model.model import bind_call, keep_answers
from kempe.numerics.pool import sum_over_chunks
from kempe.spatial import Array, matrix_to_quat_wxyz

if TYPE_CHECKING:
    from kempe.argument_types import Frames
    from kempe.model.model import FrameLike, Model


# ---- forms of a pose

# Whole poses, their upper three rows, positions, and positions with quaternions.

FEW = 2048
"""Configurations whose poses, or numbers of another type, are held at once: a block that stays in
the cache."""
FORM_CHUNK = 16384
FORM_SERIAL_BELOW = 20_000


class Form(NamedTuple):
    """A form of poses in results: a function `of` poses (..., 4, 4), and its values' `shape`."""

    shape: tuple[int, ...]
    of: Callable[[Array], Array]


def _select_matrix(X: Array) -> Array:
    """Return poses (..., 4, 4) unchanged."""
    return X


def _select_upper_rows(X: Array) -> Array:
    """Select the upper three rows (..., 3, 4) of poses."""
    return X[..., :3, :]


def _select_position(X: Array) -> Array:
    """Select the positions (..., 3) of poses."""
    return X[..., :3, 3]


def _compute_position_quat_wxyz(X: Array) -> Array:
    """Compute positions and quaternions (..., 7) of poses."""
    return np.concatenate([X[..., :3, 3], matrix_to_quat_wxyz(X[..., :3, :3])], axis=-1)


FORMS = {
    "matrix": Form((4, 4), _select_matrix),
    "3x4": Form((3, 4), _select_upper_rows),
    "position": Form((3,), _select_position),
    "position_quat_wxyz": Form((7,), _compute_position_quat_wxyz),
}
"""The forms by their names."""
TYPES = ("float64", "float32")


@keep_answers
def pack_chain(system: Model, frame: str) -> tuple[np.ndarray, Array]:
    """Pack the chain from the ground to a frame for the kernels of open chains."""
    return regauge_table(
        *system.structure.table.pack_arrays([frame], system.structure.table.find_path(frame))
    )


@quiet
def compute_poses_in_form(
    system: Model,
    q: Any,
    frame: Any,
    out: Array | None,
    threads: int | None,
    form: str | None,
    dtype: Any,
    relative_to: Any = None,
) -> Array:
    """Compute poses of a frame in a given form and number type; see `fk` for arguments and errors."""

    wanted = FORMS[check_name("form", "matrix" if form is None else form, FORMS)]
    try:
        kind = np.dtype(dtype)  # of None float64
    except (TypeError, ValueError, SyntaxError):
        kind = np.dtype(object)
    if kind.name not in TYPES:
        raise InputError(f"dtype is {format_value(dtype)}; allowed: {', '.join(TYPES)}")
    q = read_q(system, q)
    one: Any = frame
    several = frame is None or isinstance(frame, (list, tuple))
    base = None if relative_to is None else system.structure.frame_name(relative_to)

    def compute_poses(at: Array) -> Array:
        """Compute poses (..., 4, 4) at configurations, relative to the base frame."""
        X = fk(system, at, one, threads=1)
        if base is None:
            return X
        back = spatial.inverse(fk(system, at, base, threads=1))
        return (back[..., None, :, :] if several else back) @ X

    lead = q.shape[:-1] + ((len(system.body_names if frame is None else one),) if several else ())
    out = _prepare_output(out, (*lead, *wanted.shape), kind)
    if q.ndim == 1:
        out[...] = wanted.of(compute_poses(q))
        return out
    flat = q.reshape(math.prod(q.shape[:-1]), system.nq)
    rows = out.reshape(len(flat), *out.shape[q.ndim - 1 :])
    if np.may_share_memory(q, out):
        flat = flat.copy()
    table = (
        None
        if several or base is not None
        else pack_chain(system, system.structure.frame_name(one))
    )
    width = math.prod(wanted.shape)

    def fill_rows(start: int, stop: int) -> int:
        """Fill rows of the result, and return the number of bad configurations."""
        if table is None:
            rows[start:stop] = wanted.of(compute_poses(flat[start:stop]))
            return 0
        made = rows[start:stop] if kind == np.float64 else np.empty((stop - start, *wanted.shape))
        bad = chain.compute_chain_poses(*table, flat[start:stop], made.reshape(stop - start, width))
        if kind != np.float64:
            rows[start:stop] = made
        return bad

    def compute_chunk(start: int, stop: int) -> int:
        if table is not None and kind == np.float64:
            return fill_rows(start, stop)
        return sum(fill_rows(i, min(i + FEW, stop)) for i in range(start, stop, FEW))

    sum_over_chunks(compute_chunk, len(flat), FORM_CHUNK, threads, FORM_SERIAL_BELOW)
    return out


# ---- queries: one frame, looked up once

SERIAL_BELOW = 20_000
"""Configurations below which a batch stays on one thread: starting others would cost more than it
saves."""
CHUNK = 16384
"""Configurations in one piece of work of a thread."""
IN_FRAMES = {"world_aligned": WORLD_ALIGNED, "world": WORLD, "body": BODY}
"""Frames in which a Jacobian can be expressed, with the number that the kernels use."""


class Query(Protocol):
    """Forward kinematics of one frame of one system, prepared for many calls.

    Names are looked up and arrays are packed once.
    """

    frame: str
    system: Model

    def __call__(self, q: ArrayLike, out: Array | None = None, threads: int | None = None) -> Array:
        """Compute poses (..., 4, 4) of the frame in the ground frame at q (..., nq).

        With a `form`, the result has the shape of that form.

        `out`, where given, is a C-contiguous array of this shape and type; it is filled and
        returned.
        """
        ...

    def jacobian(
        self,
        q: ArrayLike,
        in_frame: str = "world_aligned",
        out: Array | None = None,
        threads: int | None = None,
    ) -> Array:
        """Compute Jacobians (..., 6, nv) of the frame, rows [linear; angular]; see `jacobian`."""
        ...

    def pose_and_jacobian(
        self, q: ArrayLike, in_frame: str = "world_aligned", threads: int | None = None
    ) -> tuple[Array, Array]:
        """Compute poses (..., 4, 4) and Jacobians (..., 6, nv) in one pass."""
        ...


@explain_errors
def query(system: Model, frame: FrameLike, form: str | None = None, dtype: Any = None) -> Query:
    """Return a function that computes the forward kinematics of one frame; see `System.query`."""
    if form is not None or dtype is not None:
        compute_poses_in_form(system, system.neutral, frame, None, 1, form, dtype)
    chain_of = _ChainQuery(system, system.structure.frame_name(frame), form, dtype)
    # a method, for it is pickled as an attribute of its object
    bound_to: Any = MethodType(_bind_query(chain_of), chain_of)
    return bound_to


def _bind_query(chain_of: _ChainQuery) -> Any:
    """Bind the forward kinematics of a chain to a function of q, out and threads.

    The function's first argument is not read.

    A closure over the packed arrays, not an object: for one configuration the way into a method and
    back would cost as much as the forward model itself. The kernels check shapes; whatever they
    refuse goes the general way.
    """
    new_pose = make_allocator(4, 4)
    new_columns = make_allocator(6, chain_of.system.nv)
    tables = chain_of.tables
    usual = "world_aligned"
    table = tables[usual]
    table_in = tables.get
    pose_kernel = bound.compute_pose
    jacobian_kernel = bound.compute_jacobian
    both_kernel = bound.compute_pose_jacobian

    def compute_pose(_: object, q: Any, out: Any = None, threads: int | None = None) -> Array:
        try:
            if q.ndim == 1:
                X = new_pose() if out is None else out
                if not pose_kernel(table, q, X):
                    return X
        except (TypeError, AttributeError):
            pass  # not float64, not contiguous, not a plain array
        return chain_of.compute_poses(q, out, threads)

    def compute_jacobian(
        q: Any, in_frame: str = "world_aligned", out: Any = None, threads: int | None = None
    ) -> Array:
        try:
            if q.ndim == 1:
                J = new_columns() if out is None else out
                if not jacobian_kernel(table if in_frame is usual else table_in(in_frame), q, J):
                    return J
        except (TypeError, AttributeError):
            pass
        return chain_of.compute_jacobians(q, in_frame, out, threads)[1]

    def compute_pose_and_jacobian(
        q: Any, in_frame: str = "world_aligned", threads: int | None = None
    ) -> tuple[Array, Array]:
        try:
            if q.ndim == 1:
                X = new_pose()
                J = new_columns()
                if not both_kernel(table if in_frame is usual else table_in(in_frame), q, X, J):
                    return X, J
        except (TypeError, AttributeError):
            pass
        return chain_of.compute_jacobians(q, in_frame, None, threads)

    def compute_poses(_: object, q: Any, out: Any = None, threads: int | None = None) -> Array:
        return compute_poses_in_form(
            chain_of.system, q, chain_of.name, out, threads, *chain_of.form
        )

    function: Any = compute_pose if all(part is None for part in chain_of.form) else compute_poses
    function.jacobian = compute_jacobian
    function.pose_and_jacobian = compute_pose_and_jacobian
    function.system = chain_of.system
    function.frame = chain_of.name
    function.__name__ = "query"
    function.__qualname__ = f"query({chain_of.system.name!r}, {chain_of.name!r})"
    function.__doc__ = Query.__call__.__doc__
    return function


class _ChainQuery:
    """The packed chain of one frame, with the general computations: batches, threads, errors."""

    def __init__(self, system: Model, name: str, form: str | None = None, dtype: Any = None):
        self.system = system
        self.name = name
        self.form = (form, dtype)
        self.ints, self.floats = system.structure.table.pack_arrays(
            [name], system.structure.table.find_path(name)
        )
        self.tables = {
            key: fuse_table(self.ints, self.floats, kind) for key, kind in IN_FRAMES.items()
        }
        self.regauged = pack_chain(system, name)

    def __reduce__(self) -> tuple[Any, ...]:
        return _ChainQuery, (self.system, self.name, *self.form)

    def __repr__(self) -> str:
        return repr(self.system)

    @property
    def query(self) -> Query:
        """The prepared forward kinematics of the frame."""
        return query(self.system, self.name, *self.form)

    def compute_poses(self, q: Any, out: Array | None, threads: int | None) -> Array:
        """Compute poses (..., 4, 4) of the frame at q (..., nq)."""
        q = read_q(self.system, q)
        out, q = _prepare_output(out, (*q.shape[:-1], 4, 4)), _copy_shared_array(q, out)
        if q.ndim == 1:
            if bound.compute_pose(self.tables["world_aligned"], q, out):
                refuse_bad_configuration(self.system, q)
            return out
        flat_q = _flatten_batch(q, 1)
        flat_out = _flatten_batch(out, 2).reshape(-1, 16)
        ints, floats = self.regauged

        def compute_chunk(start: int, stop: int) -> int:
            return chain.compute_chain_poses(ints, floats, flat_q[start:stop], flat_out[start:stop])

        sum_over_chunks(compute_chunk, len(flat_q), CHUNK, threads, SERIAL_BELOW)
        return out

    def compute_jacobians(
        self, q: Any, in_frame: str, out: Array | None, threads: int | None
    ) -> tuple[Array, Array]:
        """Compute poses (..., 4, 4) and Jacobians (..., 6, nv) of the frame at q (..., nq)."""
        kind = IN_FRAMES.get(in_frame) if isinstance(in_frame, str) else None
        if kind is None:
            raise UnknownNameError("frame of expression", in_frame, IN_FRAMES)
        q = read_q(self.system, q)
        nv = self.system.nv
        pose = np.empty((*q.shape[:-1], 4, 4))
        columns = _prepare_output(out, (*q.shape[:-1], 6, nv))
        q = _copy_shared_array(q, out)
        if q.ndim == 1:
            if bound.compute_pose_jacobian(self.tables[in_frame], q, pose, columns):
                refuse_bad_configuration(self.system, q)
            return pose, columns
        flat = _flatten_batch(q, 1), _flatten_batch(pose, 2), _flatten_batch(columns, 2)

        def compute_chunk(start: int, stop: int) -> int:
            a, b, c = (x[start:stop] for x in flat)
            return table_sweep.compute_jacobians(self.ints, self.floats, a, kind, b, c)

        sum_over_chunks(compute_chunk, len(flat[0]), CHUNK, threads, SERIAL_BELOW)
        return pose, columns


def find_query(system: Model, frame: FrameLike) -> Any:
    """Return the prepared forward kinematics of a frame, made once."""
    name = frame if frame.__class__ is str else system.structure.frame_name(frame)

    def make_query() -> Any:
        return _bind_query(_ChainQuery(system, system.structure.frame_name(name)))

    return bind_call(system, "fk", name, make_query)


@keep_answers
def _pack_frames(system: Model, frames: tuple[str, ...] | None) -> tuple[np.ndarray, Array]:
    """Pack the tree that leads to the given frames, or to all bodies."""
    return system.structure.table.pack_arrays(system.body_names if frames is None else frames)


# ---- `fk` and `jacobian`


@partial(explain_errors, fast=True)
def fk(
    system: Model,
    q: Any,
    frame: FrameLike | Frames | None = None,
    out: Array | None = None,
    threads: int | None = None,
    form: str | None = None,
    dtype: Any = None,
    relative_to: FrameLike | None = None,
) -> Array:
    """Compute poses of frames at configurations; see `System.fk`."""
    if form is not None or dtype is not None or relative_to is not None:
        return compute_poses_in_form(system, q, frame, out, threads, form, dtype, relative_to)
    if frame is not None and not isinstance(frame, (list, tuple)):
        return find_query(system, frame)(None, q, out, threads)
    key = None if frame is None else tuple(system.structure.frame_name(f) for f in frame)
    ints, floats = _pack_frames(system, key)
    q = read_q(system, q)
    k = len(system.body_names) if key is None else len(key)
    out, q = _prepare_output(out, (*q.shape[:-1], k, 4, 4)), _copy_shared_array(q, out)
    if q.ndim == 1:
        if table_sweep.compute_single_poses(ints, floats, q, out):
            refuse_bad_configuration(system, q)
        return out
    flat_q = _flatten_batch(q, 1)
    flat_out = _flatten_batch(out, 3)

    def compute_chunk(start: int, stop: int) -> int:
        return table_sweep.compute_poses(ints, floats, flat_q[start:stop], flat_out[start:stop])

    sum_over_chunks(
        compute_chunk,
        len(flat_q),
        max(1, min(CHUNK, 4 * CHUNK // max(k, 1))),
        threads,
        max(1, SERIAL_BELOW // max(k, 1)),
    )
    return out


@partial(explain_errors, fast=True)
def jacobian(
    system: Model,
    q: Any,
    frame: FrameLike | Frames,
    in_frame: str = "world_aligned",
    threads: int | None = None,
) -> Array:
    """Compute Jacobians (..., 6, nv) of frames; see `System.jacobian`.

    Source: Featherstone, *Rigid Body Dynamics Algorithms*, 2008, section 2.8.
    """
    if not isinstance(frame, (list, tuple)):
        of_frame = find_query(system, frame)
        return of_frame.jacobian(q, in_frame, threads=threads)
    of_frames = [find_query(system, system.structure.frame_name(f)) for f in frame]
    q = read_q(system, q)
    out = np.empty((*q.shape[:-1], len(of_frames), 6, system.nv))
    for k, of_frame in enumerate(of_frames):
        out[..., k, :, :] = of_frame.jacobian(q, in_frame, threads=threads)
    return out


# ---- checks of arguments


def refuse_bad_configuration(system: Model, q: Array) -> None:
    """Raise an `InputError` that names the bad coordinate of one configuration."""
    for name, x in zip(system.coordinate_names, q.tolist(), strict=True):
        if not np.isfinite(x):
            raise InputError(f"q[{name!r}] is {x}; it must be a finite number")
    for i in system.structure.layout.quaternion_q:
        if not np.any(q[i : i + 4]):
            raise InputError(
                f"the quaternion at q[{system.coordinate_names[i]!r}] is zero; (1, 0, 0, 0) is no "
                "rotation"
            )
    raise InputError("q leads to poses that are not finite: a coordinate is too large")


def _flatten_batch(x: Array, core: int) -> Array:
    """Reshape `x` so that all axes before the last `core` become one, also for empty arrays."""
    return x.reshape(math.prod(x.shape[:-core]), *x.shape[-core:])


def _copy_shared_array(q: Array, out: Array | None) -> Array:
    """Return `q`, copied where it shares memory with `out`."""
    return q.copy() if out is not None and np.may_share_memory(q, out) else q


def _prepare_output(
    out: Array | None, shape: tuple[int, ...], dtype: DTypeLike = np.float64
) -> Array:
    """Return the array `out`, checked for shape and type, or a new array where `out` is None."""
    if out is None:
        return np.empty(shape, dtype)
    if not (
        isinstance(out, np.ndarray)
        and out.shape == shape
        and out.dtype == dtype
        and out.flags.carray
    ):
        given = (
            f"{out.dtype} array of shape {out.shape}"
            if isinstance(out, np.ndarray)
            else type(out).__name__
        )
        needed = (
            f"writable, C-contiguous {np.dtype(dtype)} array of shape {shape}, aligned in memory"
        )
        raise InputError(f"out is a {given}; it must be a {needed}")
    return out
