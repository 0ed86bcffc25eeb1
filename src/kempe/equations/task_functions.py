"""Constraints that are Python functions of configurations or poses, with their derivatives."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.arguments import read_names
from kempe.arrays import is_sequence, read_mapping, read_reals
from kempe.constraints.base import Constraint, Op, Row, read_numbers, read_row_bounds
from kempe.constraints.coordinates_and_centres import Function
from kempe.description.parts import Declared
from kempe.errors import InputError, format_value
from kempe.forward.fk import fk
from kempe.forward.fk import jacobian as frame_jacobian
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import make_q, read_q, sample_configurations
from kempe.model.coordinates import Layout
from kempe.model.kernel_functions import Callback, ConfigurationRows
from kempe.model.model import keep_answers
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model, SystemType


# ---- derivatives of users' functions

# Supplied and checked, by complex steps, or by central differences.

SUPPLIED = "supplied"
COMPLEX = "complex step"
DIFFERENCES = "central differences"
"""Where a derivative comes from."""
IMAGINARY_STEP = 1e-30
"""A complex step has no cancellation, so it can be this small (Squire, Trapp, 1998)."""
REAL_STEP = float(np.finfo(float).eps) ** (1.0 / 3.0)
"""Step of central differences: their error is of second order, that of rounding of order -1."""
AGREE = 1e-5
"""How far, relative to 1 and the largest entry, a derivative may be from central differences and be
taken as right."""


def build_rate_matrix(layout: Layout, q: Array) -> Array:
    """Build the matrix (nq, nv) that maps velocity coordinates to the rates of q's entries."""
    out = np.zeros((layout.nq, layout.nv))
    out[layout.vector_q, layout.vector_v] = 1.0
    for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
        w, x, y, z = q[iq : iq + 4]
        # q' = q (0, w) / 2
        out[iq : iq + 4, iv : iv + 3] = 0.5 * np.array(
            [[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]]
        )
    return out


def compute_difference_jacobian(
    function: Callable[[Array], Any], layout: Layout, q: Array
) -> Array:
    """Compute the Jacobian (m, nv) of a function of q by central differences."""
    steps = REAL_STEP * np.eye(layout.nv)
    ends = [
        [
            np.asarray(function(layout.integrate_velocity(q, s * e)), dtype=float).ravel()
            for s in (1, -1)
        ]
        for e in steps
    ]
    if not ends:
        return np.zeros((np.size(function(q)), 0))
    return np.stack([(a - b) / (2.0 * REAL_STEP) for a, b in ends], axis=-1)


def compute_complex_step_jacobian(
    function: Callable[[Array], Any], layout: Layout, q: Array
) -> Array:
    """Compute the Jacobian (m, nv) of an analytic function of q by imaginary steps."""
    steps = 1j * IMAGINARY_STEP * build_rate_matrix(layout, q).T
    out = [np.imag(function(q + step)).ravel() / IMAGINARY_STEP for step in steps]
    return np.stack(out, axis=-1) if out else np.zeros((np.size(function(q)), 0))


def compute_function_jacobian(
    function: Callable[[Array], Any],
    derivative: Callable[[Array], Any] | None,
    how: str,
    layout: Layout,
    q: Array,
) -> Array:
    """Compute the Jacobian (m, nv) of a function of q by the method `how`."""
    if derivative is not None:
        return read_reals(derivative(q), "the Jacobian of a constraint")
    return (
        compute_complex_step_jacobian(function, layout, q)
        if how == COMPLEX
        else compute_difference_jacobian(function, layout, q)
    )


def choose_derivative_method(function: Callable[[Array], Any], layout: Layout, q: Array) -> str:
    """Choose `COMPLEX` if complex steps give the right Jacobian at q, else `DIFFERENCES`."""
    real = compute_difference_jacobian(function, layout, q)
    try:
        with warnings.catch_warnings():
            # numpy only warns where an imaginary part is thrown away
            warnings.simplefilter("error")
            found = compute_complex_step_jacobian(function, layout, q)
    except (TypeError, ValueError, AttributeError, ArithmeticError, Warning):
        return DIFFERENCES
    return (
        COMPLEX if found.shape == real.shape and _is_derivative_right(found, real) else DIFFERENCES
    )


def compute_checked_value(name: str, function: Callable[[Array], Any], q: Array) -> Array:
    """Compute the value of a constraint's function at q, () or (m,).

    Errors: `InputError` for anything else.
    """
    found = function(q)
    try:
        value = read_reals(found, "the value")
    except InputError:
        value = np.full((), np.nan)
    if value.ndim > 1 or not np.isfinite(value).all():
        raise InputError(
            f"constraint {name!r} gives {found!r}; it must give a number or an array (m,), finite"
        )
    return value


def check_supplied_jacobian(
    name: str,
    function: Callable[[Array], Any],
    derivative: Callable[[Array], Any],
    layout: Layout,
    q: Array,
    columns: tuple[str, ...],
) -> None:
    """Refuse a supplied Jacobian that differs from central differences at q.

    The message names its worst entry.
    """
    real = np.atleast_2d(compute_difference_jacobian(function, layout, q))
    given = read_reals(derivative(q), f"constraint {name!r}: its Jacobian")
    if given.shape != real.shape:
        raise InputError(
            f"constraint {name!r}: its Jacobian has shape {given.shape}; it must have {real.shape}"
        )
    if not _is_derivative_right(given, real):
        off = np.where(np.isfinite(given), np.abs(given - real), math.inf)
        i, k = np.unravel_index(np.argmax(off), off.shape)
        raise InputError(
            f"constraint {name!r}: its Jacobian is wrong: the derivative of row {i} by "
            f"{columns[k]!r} is given as {given[i, k]:.6g}, central differences give "
            f"{real[i, k]:.6g}"
        )


def _is_derivative_right(a: Array, b: Array) -> bool:
    """Whether a derivative agrees with central differences."""
    scale = 1.0 + float(np.max(np.abs(b), initial=0.0))
    return bool(np.all(np.abs(a - b) <= AGREE * scale))  # not a number fails


# ---- functions as constraints of a system


class Whole:
    """A user's function of q (nq,), or of poses (4, 4) of frames, bound to one system.

    Its derivatives are (m, nv).

    It is called first at a random configuration, which finds how many numbers it gives and checks a
    given Jacobian. Errors: `InputError` for what is no function, a wrong Jacobian, with its worst
    entry, values that are not finite.
    """

    def __init__(self, system: Model, of: Any):
        self.system = system
        self.label = of.label
        self.given = of.function
        self.supplied = of.derivative
        self.frames = tuple(
            system.structure.frame_name(f) for f in read_names(of.frames, f"frames of {of.label}")
        )
        takes = (
            f"of {format_count(len(self.frames), 'pose')} (4, 4)"
            if self.frames
            else f"of q ({system.nq},)"
        )
        if not callable(of.function):
            raise InputError(f"{of.label} is given {of.function!r}; it must be a function {takes}")
        if not _can_take_arguments(of.function, len(self.frames) or 1):
            given = (
                f"{format_count(len(self.frames), 'pose')}, of {', '.join(self.frames)}"
                if self.frames
                else f"q ({system.nq},)"
            )
            raise InputError(f"{of.label} is called with {given}, which it does not take")
        found = compute_checked_value(
            self.label, self.call_function, q := sample_configurations(system, 0)
        )
        self.count = found.size
        if not self.count:
            raise InputError(f"{of.label} returns no numbers; it must return at least one")
        self.how = ""
        if self.supplied is not None:
            rows: Callable[[Array], Any] = self.call_derivative
            if not found.ndim:
                rows = lambda x: np.atleast_2d(self.call_derivative(x))  # noqa: E731
            check_supplied_jacobian(
                self.label,
                self.call_function,
                rows,
                system.structure.layout,
                q,
                system.structure.velocity_names,
            )
            self.how = SUPPLIED
        elif not self.frames:
            self.how = choose_derivative_method(of.function, system.structure.layout, q)
        self.low, self.high = read_row_bounds(of.low, of.high, f"bounds of {of.label}", self.count)

    def call_function(self, q: Array) -> Any:
        """Call the user's function at q."""
        return self.given(*self._compute_inputs(q))

    def _compute_inputs(self, q: Array) -> list[Array]:
        """Compute the arguments of the user's function at q: q itself, or poses of frames."""
        return [fk(self.system, q, f) for f in self.frames] or [q]

    def call_derivative(self, q: Array) -> Any:
        """Call the supplied derivative at q."""
        assert self.supplied is not None
        return self.supplied(*self._compute_inputs(q))

    def compute_values(self, q: Array) -> Array:
        """Compute the values (m,) of the user's function at the configuration q (nq,).

        Errors: `InputError` where their number is not m.
        """
        return self._check_values(self.call_function(q.copy()))

    def _check_values(self, found: Any) -> Array:
        """Convert the values that the function gave to an array (m,).

        Errors: `InputError` where their number is not m.
        """
        if np.size(found) != self.count:
            raise InputError(
                f"{self.label} gives {np.size(found)} numbers, but gave {self.count} before"
            )
        return read_reals(found, f"the value of {self.label}").reshape(self.count)

    def compute_jacobian(self, q: Array) -> Array:
        """Compute the derivatives (m, nv) of the user's function at q (nq,).

        Those of a function of poses by differences along the motions of all frames together: two
        calls for each coordinate that moves one of them, or for each twist where these are fewer.
        """
        shape = (self.count, self.system.nv)
        if self.how:
            layout = self.system.structure.layout
            return read_reals(
                compute_function_jacobian(
                    self.call_function, self.supplied and self.call_derivative, self.how, layout, q
                ),
                f"the Jacobian of {self.label}",
            ).reshape(shape)
        poses = np.stack(self._compute_inputs(q))
        columns = frame_jacobian(self.system, q, self.frames)
        moving = np.flatnonzero(columns.any(axis=(0, 1)))
        if len(moving) > 6 * len(self.frames):
            scale = np.tile(
                np.repeat([compute_characteristic_length(self.system), 1.0], 3), len(poses)
            )
            twists = np.diag(scale).reshape(-1, len(poses), 6)
            return (
                self._differentiate_along_twists(poses, twists)
                / scale
                @ columns.reshape(-1, self.system.nv)
            )
        J = np.zeros(shape)
        J[:, moving] = self._differentiate_along_twists(
            poses, np.moveaxis(columns[..., moving], -1, 0)
        )
        return J

    def _differentiate_along_twists(self, poses: Array, twists: Array) -> Array:
        """Compute derivatives (m, n) of a function of poses (k, 4, 4) along twists (n, k, 6).

        The twists have the axes of the ground.
        """
        out = np.empty((self.count, len(twists)))
        for i, twist in enumerate(REAL_STEP * twists):
            ahead, back = (
                self._check_values(self.given(*_move_poses(poses, x))) for x in (twist, -twist)
            )
            out[:, i] = (ahead - back) / (2.0 * REAL_STEP)
        return out

    def make_callback(self, rows: Sequence[int], offset: Array | float = 0.0) -> Callback:
        """Make a callback for kernels that gives some of the function's numbers."""
        own = list(rows)
        made = Callback(
            self.system,
            len(own),
            lambda q: (self.compute_values(q)[own] - offset, self.compute_jacobian(q)[own]),
            alone=lambda q: self.compute_values(q)[own] - offset,
        )
        return made.remember_maker(self.make_callback, rows, offset)

    def compute_error(self, q: Array) -> Array:
        """Compute how far (..., m) the numbers are outside their bounds at q (..., nq)."""
        out = np.empty((*q.shape[:-1], self.count))
        for index in np.ndindex(q.shape[:-1]):
            value = self.compute_values(q[index])
            out[index] = value - np.clip(value, self.low, self.high)
        return out


def _can_take_arguments(function: Callable[..., Any], n: int) -> bool:
    """Whether a function can be called with `n` arguments."""
    try:
        signature(function).bind(*range(n))
    except TypeError:
        return False
    except ValueError:  # it has no signature
        return not isinstance(function, type)
    return True


def _move_poses(poses: Array, twists: Array) -> Array:
    """Move poses (k, 4, 4) by twists (k, 6): along and about axes of the ground.

    They turn about their own origins.
    """
    out = poses.copy()
    out[:, :3, :3] = spatial.exp_so3(twists[:, 3:]) @ poses[:, :3, :3]
    out[:, :3, 3] += twists[:, :3]
    return out


@dataclass(frozen=True, eq=False)
class HeldFunction(Constraint, ConfigurationRows):
    """A function of configurations as a constraint that a system holds for one call."""

    whole: Whole
    low: Array
    high: Array

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """One for each number; where both ends are the same it is held there."""
        return tuple(
            Row(Op.CALL, (self, k), str(k), "1")
            if same
            else Row(Op.CALL, (self, k), str(k), "1", "", "low", "high", k)
            for k, same in enumerate(self.low == self.high)
        )

    def make_callback(self, rows: Sequence[int]) -> Callback:
        """Make a callback for kernels that gives some of the rows."""
        return self.whole.make_callback(rows, self._held_values[list(rows)])

    @property
    def _held_values(self) -> Array:
        """Values (m,) at which rows are held; 0 for rows between bounds."""
        return np.where(self.low == self.high, self.low, 0.0)

    def compute_row_values(self, q: Array) -> Array:
        """Compute the values (m,) of the rows at q (nq,), less those at which they are held."""
        return self.whole.compute_values(q) - self._held_values


CoordinateItem = tuple[str, int, int, bool]
"""A coordinate or quaternion: its name, its place in q, its velocity coordinate, and whether it is a
quaternion."""


@dataclass(frozen=True, eq=False)
class CoordinateValues(Constraint):
    """Coordinates and quaternions of one system, held at their values in a configuration.

    These `items` are held at their values in `q` (..., nq).
    """

    system: Model
    q: Array
    items: tuple[CoordinateItem, ...]

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """One for each coordinate or quaternion."""
        return _list_value_rows(self.system, self.items)

    def read_row_values(self, row: Row) -> Array:
        """Read the values that a row holds: (..., 1) of a coordinate, (..., 4) of a quaternion.

        Errors: `InputError` for a quaternion that is zero.
        """
        _, i, _, ball = row.args
        x = self.q[..., i : i + (4 if ball else 1)]
        if not ball:
            return x
        size = np.linalg.norm(x, axis=-1, keepdims=True)
        if np.any(size == 0.0):
            raise InputError(f"the quaternion at {row.name!r} of {self.label} is zero")
        return x / size


@keep_answers
def _list_value_rows(system: Model, items: tuple[CoordinateItem, ...]) -> tuple[Row, ...]:
    """List the rows that hold coordinates and quaternions at values."""
    turning = system.structure.coordinates.turning
    return tuple(
        Row(Op.COORDINATE, (v, i, f"q[{i}]", ball), name, "rad" if turning[v] or ball else "m")
        for name, i, v, ball in items
    )


@keep_answers
def _list_coordinate_items(system: Model) -> tuple[CoordinateItem, ...]:
    """List all coordinates and quaternions, in the order of their places in q."""
    layout = system.structure.layout
    names = system.coordinate_names
    vectors = zip(layout.vector_q.tolist(), layout.vector_v.tolist(), strict=True)
    balls = zip(layout.quaternion_q.tolist(), layout.quaternion_v.tolist(), strict=True)
    items: list[CoordinateItem] = [(names[i], i, v, False) for i, v in vectors]
    items += [(names[i], i, v, True) for i, v in balls]
    return tuple(sorted(items, key=lambda item: item[1]))


def make_coordinate_values(system: Model, made: Constraint) -> CoordinateValues:
    """Make the coordinates and quaternions that a constraint holds at values of its field `q`.

    Errors: `UnknownNameError` for names that are none; `InputError` for quaternions without all
    four.
    """
    given: Any = made.q  # type: ignore[attr-defined]
    items = _list_coordinate_items(system)
    values = read_mapping(given)
    if values is None:
        return CoordinateValues(system, read_q(system, given), items, name=made.label)
    names = system.coordinate_names
    # refuses names that are none, or follow others
    make_q(system, dict.fromkeys(values, 0.0))
    columns = {n: read_numbers(x, f"{n!r} of {made.label}") for n, x in values.items()}
    q = np.empty((*np.broadcast_shapes(*(x.shape for x in columns.values())), system.nq))
    q[:] = system.neutral
    for n, x in columns.items():
        q[..., names.index(n)] = x
    chosen: list[CoordinateItem] = []
    for item in items:
        width = 4 if item[3] else 1
        parts = names[item[1] : item[1] + width]
        missing = [n for n in parts if n not in values]
        if 0 < len(missing) < width:
            raise InputError(f"a quaternion is given as a whole; missing are {', '.join(missing)}")
        if not missing:
            chosen.append(item)
    return CoordinateValues(system, q, tuple(chosen), name=made.label)


def bind_constraint(system: Model, made: Constraint) -> Constraint:
    """Bind a constraint to a system: functions to its q, coordinates to their places."""
    rows = made.list_rows(system.dim)
    if any(r.op is Op.COORDINATE for r in rows):
        return make_coordinate_values(system, made)
    if not any(r.op is Op.CALL and len(r.args) == 1 for r in rows):
        return made
    whole = Whole(system, made)
    return HeldFunction(whole, whole.low, whole.high)


def add_held_constraints(system: SystemType, further: Any) -> SystemType:
    """Return the system with further constraints, or functions of q, that always hold.

    Its coordinates stay the same.

    Errors: `InputError` for what is none, `DescriptionError` for what does not fit the system.
    """
    given: tuple[Any, ...] = tuple(further) if is_sequence(further) else (further,)
    if not given:
        return system
    m = system.mechanism
    taken = {*system._mechanism.constraints, *system._mechanism.joints}
    for c in given:
        made = Function(c) if callable(c) and not isinstance(c, Constraint) else c
        if not isinstance(made, Constraint):
            raise InputError(
                f"also holds {format_value(c)}, which is no constraint of kempe.constraints and no "
                "function"
            )
        name = made.name or (made.subject if made is not c else made.label)
        while name in taken:
            name += " again"
        taken.add(name)
        own = bind_constraint(system, made)
        if own is made:
            m.constrain(made, name)
        elif made.weight is not None:
            raise InputError(
                f"{made.label} has a weight, which ik reads of a wish: what also holds, holds"
            )
        else:
            m.constraints[name] = Declared(name, own, "", "")
    return type(system)(m, system.structure.topology)
