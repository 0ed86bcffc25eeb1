"""Parts of a constraint: its ends, its rows and its numbers. Nothing is computed here.

The checks of what a constraint is given, and the table of kinds, are also here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import IntEnum, auto
from fractions import Fraction
from functools import cached_property, lru_cache
from types import NoneType
from typing import (
    Any,
    ClassVar,
    NamedTuple,
    TypeAlias,
    TypedDict,
    TypeVar,
    Unpack,
    dataclass_transform,
)

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arguments import add_parameter_text, explain_init_errors, find_parameter_text, numbers
from kempe.arrays import is_array, is_mapping, is_sequence
from kempe.errors import INSTEAD, InputError
from kempe.poses import EXACT as RIGID
from kempe.poses import Placement, correct_rotations, read_direction, read_pose_array
from kempe.spatial import Array
from kempe.units import scale_lengths
from kempe.values import Expression
from kempe.words import format_html_paragraphs

# ---- checks of what is given

# Poses, points, directions, and what cannot change from target to target.

LARGEST = 1e100
"""Numbers above this are too large for the kernels."""

ROTATES = 1e-4
"""How far R'R of a (3, 3) array may be from 1 for it to be a rotation, and not three positions."""
MEETS = 1e-12
"""Distance in metres below which there is no direction from one point to another."""


def read_poses(x: Any, dim: int, what: str) -> Array:
    """Read poses (..., 4, 4), in the plane also (..., 3, 3), and check their rotations.

    Errors: `InputError`.
    """
    given = read_numbers(read_pose_array(x, what), what)
    is_planar = dim == 2 and given.ndim >= 2 and given.shape[-2:] == (3, 3)
    X = np.zeros((*given.shape[:-2], 4, 4)) if is_planar else given
    if is_planar:
        X[..., :2, :2] = given[..., :2, :2]
        X[..., :2, 3] = given[..., :2, 2]
        X[..., 2, 2] = 1.0
        X[..., 3, 3] = 1.0
    if X.ndim < 2 or X.shape[-2:] != (4, 4):
        raise InputError(f"{what} has shape {X.shape}; it must be a pose (..., 4, 4)")
    X = spatial._read_poses(X, what)
    if dim == 2 and (np.any(np.abs(X[..., 2, 3]) > RIGID) or np.any(1.0 - X[..., 2, 2] > RIGID)):
        raise InputError(f"{what} leaves the plane of the system")
    return correct_rotations(X, what)


def read_numbers(x: Any, what: str) -> Array:
    """Read real numbers as an array. Errors: `InputError`."""
    return numbers(x, what)


def make_rotations_along(z: Array, dim: int) -> Array:
    """Return rotations (..., 3, 3) whose z is along unit vectors (..., 3).

    In the plane their x is the plane's normal.
    """
    if dim == 3:
        return spatial.align_z(z)
    x = np.broadcast_to([0.0, 0.0, 1.0], z.shape)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def flatten_pose(X: Array) -> tuple[float, ...]:
    """Return a pose (4, 4) as a tuple of 16 numbers, which can be hashed."""
    return tuple(X.ravel().tolist())


def read_points(x: Any, dim: int, what: str) -> Array:
    """Read points (..., 3), in the plane also (..., 2), with z = 0.

    Errors: `InputError`, also for rotations.
    """
    p = _read_vectors(x, dim, what)
    refuse_rotations(p, what)
    return _check_plane(p, dim, what)


def refuse_rotations(x: Array, what: str) -> None:
    """Refuse rotations, or planar poses, (..., 3, 3) where positions (..., 3) are meant.

    Errors: `InputError`.
    """
    if x.ndim < 2 or x.shape[-2:] != (3, 3):
        return
    R = x[np.isfinite(x).all(axis=(-1, -2))]
    if not len(R) or np.abs(R).max() > 1e6:
        return
    turned = (np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < ROTATES) and np.all(
        np.linalg.det(R) > 0.0
    )
    flat_ = np.all(R[:, 2] == [0.0, 0.0, 1.0]) and (
        np.abs(R[:, :2, :2] @ np.swapaxes(R[:, :2, :2], -1, -2) - np.eye(2)).max() < ROTATES
    )
    if turned or flat_:
        is_ = "a rotation" if turned else "a pose of the plane"
        raise InputError(
            f"{what} is {is_} (3, 3), not three positions: an orientation is "
            "tasks.Orientation(frame, R), or task='orientation' of ik, a pose is (4, 4); "
            "task='position' says that positions are meant"
        )


def read_directions(x: Any, dim: int, what: str) -> Array:
    """Read unit vectors (..., 3), in the plane also (..., 2).

    Errors: `InputError`, also for zero vectors.
    """
    p = _read_vectors(read_direction(x), dim, what)
    if np.any(np.all(p == 0.0, axis=-1)):
        raise InputError(f"{what} is zero; it must have a direction")
    return _check_plane(spatial.unit(p), dim, what)


def check_constant(x: Array, what: str, shape: tuple[int, ...] = ()) -> Array:
    """Refuse numbers that are infinite, or differ from target to target; return the others.

    `shape` is the one they must have. Errors: `InputError`.
    """
    if x.shape != shape:
        raise InputError(
            f"{what} has shape {x.shape}; it must have {shape or 'none: a number'}, one for all "
            "targets"
        )
    if not np.all(np.abs(x) < LARGEST):
        raise InputError(f"{what} is {x.tolist()}; it must be finite")
    return x


def make_point_pose(point: Any, dim: int, what: str) -> tuple[float, ...]:
    """Return the pose, without a rotation, at a point of a frame as a tuple of 16 numbers.

    `dim` is 2 in the plane, else 3; `what` names the point in messages. Errors: `InputError` for
    points that are not finite, of another shape, or different for several targets.
    """
    return flatten_pose(spatial.pose(p=check_constant(read_points(point, dim, what), what, (3,))))


def make_axis_pose(axis: Any, dim: int, what: str) -> tuple[float, ...]:
    """Return a rotation whose z is along the axis, as a pose of 16 numbers.

    The axis is z by default, in the plane x. Errors: `InputError`.
    """
    usual = (1.0, 0.0, 0.0) if dim == 2 else (0.0, 0.0, 1.0)
    z = check_constant(read_directions(usual if axis is None else axis, dim, what), what, (3,))
    return flatten_pose(spatial.pose(make_rotations_along(z, dim)))


def compute_tilt(d: Array) -> Array:
    """Compute the angle (...) between z and vectors (..., 3); it is pi for a vector of length 0."""
    across = np.hypot(d[..., 0], d[..., 1])
    return np.where(np.hypot(across, d[..., 2]) < MEETS, np.pi, np.arctan2(across, d[..., 2]))


def read_row_bounds(low: Any, high: Any, what: str, n: int) -> tuple[Array, Array]:
    """Read lower and upper bounds of n rows, arrays (n,) that may be infinite.

    Errors: `InputError` where they leave nothing between them.
    """
    a, b = (read_numbers(x, f"an end of {what}") for x in (low, high))
    if any(x.shape not in ((), (n,)) for x in (a, b)):
        raise InputError(f"{what}: {low!r} and {high!r} must be numbers, or have {n} entries each")
    if not np.all((a <= b) & (a < np.inf) & (b > -np.inf)):
        raise InputError(f"{what}: {low!r} and {high!r} leave nothing; needed is low <= high")
    return np.broadcast_to(a, n), np.broadcast_to(b, n)


def read_corners(low: Any, high: Any, dim: int, what: str) -> tuple[Array, Array]:
    """Read two corners (..., dim) of a box; in the plane, of a box that cuts the plane.

    Errors: `InputError`.
    """
    a, b = (_read_vectors(x, dim, what) for x in (low, high))
    if dim == 2 and (np.any(a[..., 2] > 0.0) or np.any(b[..., 2] < 0.0)):
        raise InputError(f"{what} are {low!r} and {high!r}: the box leaves the plane of the system")
    return a[..., :dim], b[..., :dim]


def _read_vectors(x: Any, dim: int, what: str) -> Array:
    """Read vectors (..., 3), in the plane also (..., 2), with z = 0. Errors: `InputError`."""
    p = read_numbers(x, what)
    if dim == 2 and p.ndim and p.shape[-1] == 2:
        p = np.concatenate([p, np.zeros((*p.shape[:-1], 1))], axis=-1)
    if p.ndim == 0 or p.shape[-1] != 3:
        raise InputError(f"{what} has shape {p.shape}; it must be (..., {dim})")
    return p


def _check_plane(p: Array, dim: int, what: str) -> Array:
    """Refuse points off the plane of a planar system; return the others. Errors: `InputError`."""
    if dim == 2 and np.any(np.abs(p[..., 2]) > RIGID):
        raise InputError(
            f"{what} leaves the plane of the system: its z must be 0, and is up to "
            f"{np.nanmax(np.abs(p[..., 2])):.6g} m"
        )
    return p


def read_nonnegative_numbers(x: Any, what: str) -> Array:
    """Read numbers that are not negative. Errors: `InputError`."""
    value = read_numbers(x, what)
    if np.any(value < 0.0):
        raise InputError(f"{what} is {x!r}; it must not be negative")
    return value


def read_bounds(low: Any, high: Any, what: str) -> tuple[Array, Array]:
    """Read lower and upper bounds as arrays of one shape.

    Errors: `InputError` where shapes differ or bounds leave nothing.
    """
    a, b = (read_numbers(x, f"an end of {what}") for x in (low, high))
    try:
        a, b = (a, b) if a.shape == b.shape else np.broadcast_arrays(a, b)
    except ValueError:
        raise InputError(
            f"{what}: {low!r} and {high!r} have shapes that do not fit together"
        ) from None
    if np.any(a > b):
        raise InputError(f"{what}: {low!r} and {high!r} leave nothing; needed is low <= high")
    return a.copy(), b.copy()


# ---- the parts of a constraint

# A *kind* of constraint is a small class. Its `list_rows` are structure: which operation reads what, and
# between which of its fields the value is held. Its fields hold the numbers. How rows become
# equations is in `kempe.model.constraint_program`, how they are judged from poses alone in
# `kempe.equations.judge`.

Frame: TypeAlias = "str | End"
"""A field that names a frame or a body, or is an `End`."""
Number: TypeAlias = ArrayLike | Expression | None
"""A field of one number (...): in a description also an expression in parameters."""
Point: TypeAlias = ArrayLike | Sequence[ArrayLike | Expression] | None
"""A field of a place, or of a number for each direction (..., 3), in planar systems also (...,
2)."""
Direction: TypeAlias = ArrayLike | Sequence[ArrayLike | Expression] | None
"""A field of a direction (..., 3), or its name: "x", "-z"."""
Matrix: TypeAlias = ArrayLike | Mapping[str, ArrayLike]
"""A field of a pose (..., 4, 4)."""
Names: TypeAlias = Sequence[str] | str
"""A field of names of coordinates, or of frames."""
Rotation: TypeAlias = ArrayLike | Mapping[str, ArrayLike]
"""A field of a rotation (..., 3, 3)."""


class Op(IntEnum):
    """Operations of rows: on coordinates, or on the pose or twist of frame B in frame A."""

    POINT = auto()
    """The origin of B along the axis `args[0]` of A."""
    ROTATION = auto()
    """The rotation of B in A: three equations that belong together, in the plane one."""
    TILT = auto()
    """The direction of z of B in A: two equations, in the plane one."""
    LOOK = auto()
    """The direction of z of B against that from B to the origin of A: two equations, in the plane
    one."""
    DISTANCE = auto()
    """The distance of the origins."""
    COORDINATE = auto()
    """A coordinate, or a quaternion."""
    TAPE = auto()
    """Output `args[1]` of the recorded expression `args[0]`."""
    CALL = auto()
    """Values of a Python function of the configuration."""
    VELOCITY = auto()
    """Output `args[1]` of the recorded expression `args[0]`, linear in velocities: the row A(q) v -
    b(q, t)."""


COUNTS = {Op.ROTATION: {2: 1, 3: 3}, Op.TILT: {2: 1, 3: 2}, Op.LOOK: {2: 1, 3: 2}}
"""How many equations an operation is, by the dimension, where that is not one."""


class Row(NamedTuple):
    """Row of a constraint: one equation or a group of related equations, without numbers.

    `equal`, `low` and `high` name fields of the constraint; without them the value is held at zero.
    Where the field of `equal` is None, the value is held between the others, an infinity where
    these are None. `part` is its place in fields that hold several numbers.
    """

    op: Op
    args: tuple[Any, ...] = ()
    name: str = ""
    unit: str = "m"
    equal: str = ""
    low: str = ""
    high: str = ""
    part: int | None = None

    def count_equations(self, dim: int) -> int:
        """Return the number of equations, in the plane (`dim` 2) or in space (3)."""
        return COUNTS.get(self.op, {}).get(dim, 1)

    @property
    def velocity(self) -> bool:
        """Whether the row is a velocity constraint A(q) v = b(q, t)."""
        return self.op is Op.VELOCITY


class Mass(NamedTuple):
    """Point of a frame, with the fraction of the total mass that counts at the point."""

    frame: str
    point: tuple[float, ...]
    part: float


@dataclass(frozen=True)
class End:
    """An end of a constraint: a frame at `X` on a body."""

    body: str
    X: Placement = Placement()

    def __str__(self) -> str:
        return self.body


class TaskKeywords(TypedDict, total=False):
    """What only `ik` reads of a soft task, besides its weight."""

    priority: int
    tolerance: float | tuple[float, float] | None
    name: str


class WeightedTaskKeywords(TaskKeywords, total=False):
    """What only `ik` reads."""

    weight: float | None


@dataclass(frozen=True, eq=False)
class Constraint(ABC):
    """Constraint on a system, or task of `ik`; each kind is a subclass that declares its rows.

    `Mechanism.constrain` holds a constraint always, `System.ik` in one call. What only `ik` reads:

    Parameters
    ----------
    weight
        Weight of a soft task of `ik`, which minimises the sum of weight times squared error, in
        radians and characteristic lengths. A task without a weight must hold (default).
    priority
        Tasks of a lower number come first; others act only in the freedoms that these leave
        (default: 0).
    tolerance
        Largest error of a task that must hold: a number, or (metres, radians) (default: that of the
        call).
    name
        Name in answers and messages.
    """

    weight: float | None = field(default=None, kw_only=True)
    priority: int = field(default=0, kw_only=True)
    tolerance: float | tuple[float, float] | None = field(default=None, kw_only=True)
    name: str = field(default="", kw_only=True)

    kind: ClassVar[str] = ""
    """Its name in files and tables."""
    symbol: ClassVar[str] = "mark"
    """How it is drawn where its rows do not say it, as those of rods and slots do: "wheel",
    "contact", "mark"."""
    says: ClassVar[str] = ""
    """What it asks, as a sentence over its fields; `sentence` has it filled in."""
    prevents: ClassVar[str] = "the velocity constraint {name!r} prevents the rest"
    """What of a wanted motion it does not let happen, as a sentence over its name."""
    scaled: ClassVar[bool] = True
    """Whether its rows have a size of their own, and not one that a caller has written."""
    unbounded: ClassVar[str] = "it measures no single number, which alone has bounds"
    """What is said where it is given `at_least` or `at_most` and has none; see `Bounded`."""
    zero: ClassVar[float] = 0.0
    """What `low` or `high` of a row may name."""
    goals: ClassVar[tuple[str, ...]] = ()
    """Fields of numbers that only `make_goal_poses` reads."""

    @abstractmethod
    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return the equations of the constraint; `dim` is 2 in the plane, 3 in space.

        Errors: `InputError` where fields do not fit.
        """

    def check_fields(self, dim: int) -> None:
        """Refuse values of fields that `make_goal_poses` does not check. Errors: `InputError`."""
        return

    # ---- its ends

    @property
    def ends(self) -> tuple[Any, Any]:
        """Ends A and B: frames by name, `End`s, or None.

        A is None for the ground, B where the constraint holds no frame.
        """
        return getattr(self, "other", None), getattr(self, "frame", None)

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the coordinates that the rows read."""
        return getattr(self, "of", ())

    def list_masses(self, bodies: Mapping[str, Any], what: str) -> list[Mass]:
        """Return the mass points of a centre (their masses sum to 1), if end B is None."""
        raise NotImplementedError

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) of frame A on its body, which may differ in each call.

        `dim` is 2 in the plane, 3 in space.
        """
        return EYE

    def make_tool_pose(self, dim: int) -> tuple[float, ...]:
        """Return the pose of frame B on its body as 16 numbers, the same in all calls.

        `dim` is 2 in the plane, 3 in space.
        """
        return HERE

    def add_prefix(self, prefix: str) -> Constraint:
        """Return the constraint with a prefix before the names of its coordinates."""
        return self

    def scale_lengths(self, factor: Fraction, slides: Collection[str]) -> Constraint:
        """Return the constraint with its lengths in another unit.

        `factor` is the old unit in new ones; `slides` are the coordinates that are lengths.
        """
        given = {f.name: (f.type, getattr(self, f.name)) for f in fields(self)}
        new = {n: scale_lengths(x, factor) for n, (sort, x) in given.items() if sort in LENGTHS}
        new |= {n: _scale_pose(x, factor) for n, (sort, x) in given.items() if sort == "Matrix"}
        return replace(self, **new)

    def resolve_names(self, parameters: Collection[str]) -> Constraint:
        """Return the constraint with each name resolved to a coordinate or to a given parameter."""
        return self

    # ---- how it is called

    @property
    def subject(self) -> str:
        """The frames that the constraint holds, as text."""
        a, b = self.ends
        if b is None:
            return "the system"
        return repr(str(b)) if a is None else f"{str(b)!r} and {str(a)!r}"

    @cached_property
    def label(self) -> str:
        """Name of the constraint in answers and messages."""
        return self.name or f"{type(self).__name__} of {self.subject}"

    @property
    def sentence(self) -> str:
        """The constraint as one plain sentence with its frames and numbers."""
        said = self.says.format_map({f.name: self.describe_field(f.name) for f in fields(self)})
        other = getattr(self, "other", None)
        return said if other is None or "{other}" in self.says else f"{said}, seen from {other}"

    def _repr_html_(self) -> str:
        return format_html_paragraphs(
            [f"{self.name}: {self.sentence}" if self.name else self.sentence]
        )

    def describe_field(self, name: str) -> str:
        """Return the value of the field `name` as words of `sentence`."""
        x = getattr(self, name)
        sort = next(f.type for f in fields(self) if f.name == name)
        if x is None:
            return "the ground" if sort in FRAMES else "what is given"
        return SQUARE[sort] if sort in SQUARE and np.ndim(x) >= 2 else format_value(x)

    # ---- what only `ik` reads

    def soft(self, weight: float = 1.0, **more: Unpack[TaskKeywords]) -> Constraint:
        """Return the constraint as a soft task of `ik` with a weight.

        Parameters
        ----------
        weight
            Weight of the squared error (default: 1).
        **more
            `priority`, `tolerance` and `name`, as of the constraint.

        Returns
        -------
        Constraint
            A new constraint of the same kind.
        """
        return replace(self, weight=weight, **more)

    def demand(self, **more: Unpack[WeightedTaskKeywords]) -> Constraint:
        """Return the constraint with other settings that only `ik` reads.

        Parameters
        ----------
        **more
            `weight`, `priority`, `tolerance` and `name`, as of the constraint.

        Returns
        -------
        Constraint
            A new constraint of the same kind.
        """
        return replace(self, **more)


@dataclass(frozen=True, eq=False)
class Bounded(Constraint):
    """Base of constraints on one measured number, or on several alike, with optional bounds.

    With `at_least` (...) or `at_most` (...), or both, the number stays within these bounds, in
    place of being zero or a value that the kind has.
    """

    at_least: Number = field(default=None, kw_only=True)
    at_most: Number = field(default=None, kw_only=True)

    measured: ClassVar[str] = "value"
    """What the number is, one of `UNITS`."""

    def scale_lengths(self, factor: Fraction, slides: Collection[str]) -> Constraint:
        """Return the constraint with its lengths in another unit; bounds of other numbers stay."""
        scaled = super().scale_lengths(factor, slides)
        if UNITS[self.measured] == "m":
            return scaled
        return replace(scaled, at_least=self.at_least, at_most=self.at_most)  # type: ignore[call-arg]

    @property
    def bounded(self) -> bool:
        """Whether `at_least` or `at_most` is given."""
        return self.at_least is not None or self.at_most is not None

    def check_fields(self, dim: int) -> None:
        """Refuse bounds that leave no value, and negative bounds of distances and angles."""
        if not self.bounded:
            return
        signed = self.measured in SIGNED
        for bound in (self.at_least, self.at_most):
            if bound is not None and not signed:
                read_nonnegative_numbers(bound, f"a bound of {self.label}")
        low = (-np.inf if signed else 0.0) if self.at_least is None else self.at_least
        high = self.at_most
        read_bounds(low, np.inf if high is None else high, f"at_least and at_most of {self.label}")

    @property
    def bounds_text(self) -> str:
        """The bounds `at_least` and `at_most` as words of `sentence`."""
        given = (("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{word} {format_value(x)}" for word, x in given if x is not None)


SIGNED = ("height", "value")
UNITS = {"distance": "m", "height": "m", "angle": "rad", "value": "1"}
"""Numbers that may be negative, and the units of all."""

EYE = np.eye(4)
EYE.setflags(write=False)
HERE = tuple(EYE.ravel().tolist())
"""The frame itself."""


# ---- the table of kinds

KINDS: dict[str, type[Constraint]] = {}
"""The kinds by name: the one table, which files, builders and reports read."""

_Kind = TypeVar("_Kind", bound=type[Constraint])


@dataclass_transform(frozen_default=True)
def kind(name: str, symbol: str = "mark", says: str = "") -> Callable[[_Kind], _Kind]:
    """Decorate a class to enter it into the table of kinds of constraints, under `name`.

    `says` is its sentence, with fields in braces: "{frame} and {other} are {value} apart". Errors:
    `InputError` for a name that another kind has.
    """

    def register_kind(cls: _Kind) -> _Kind:
        """Make the class a frozen dataclass and enter it into `KINDS`."""
        made = dataclass(frozen=True, eq=False)(cls)
        if not all(isinstance(f.type, str) for f in fields(made)):
            raise InputError(
                f"{made.__qualname__}: its module must begin with: from __future__ import "
                "annotations"
            )
        taken = KINDS.get(name)
        if taken is not None and taken.__qualname__ != made.__qualname__:
            raise InputError(
                f"the kind {name!r} of constraint exists already: {taken.__qualname__}"
            )
        made.__doc__ = add_parameter_text(made.__doc__, find_parameter_text(Constraint.__doc__))
        made.kind = name
        made.symbol = symbol
        made.says = says
        explain_init_errors(made)
        if not issubclass(made, Bounded):
            INSTEAD.update(
                {(made.__name__, word): made.unbounded for word in ("at_least", "at_most")}
            )
        KINDS[name] = made
        return made

    return register_kind


def find_value_field(constraint: Constraint, row: Row) -> str:
    """Return the name of the field whose value a row is held at.

    It is '' for zero, and for rows held between two bounds.
    """
    return row.equal if row.equal and getattr(constraint, row.equal) is not None else ""


def is_one_sided(constraint: Constraint, row: Row) -> bool:
    """Tell whether a row is an inequality, held between two bounds and not at a value."""
    return bool(row.low or row.high) and not find_value_field(constraint, row)


def list_position_rows(constraint: Constraint, dim: int) -> Sequence[Row]:
    """Return the equations f(q) = 0 of a constraint, which take freedoms of position.

    `dim` is 2 in the plane, 3 in space.
    """
    return [
        r for r in constraint.list_rows(dim) if not r.velocity and not is_one_sided(constraint, r)
    ]


def make_content_key(constraint: Constraint) -> tuple[Any, ...]:
    """Return kind and fields of a constraint as nested tuples, which can be compared and hashed."""

    def convert_value(x: Any) -> Any:
        """Return arrays, sequences and mappings as tuples."""
        if is_array(x):
            return x.shape, tuple(x.ravel().tolist())
        if is_sequence(x):
            return tuple(map(convert_value, x))
        return tuple((k, convert_value(v)) for k, v in x.items()) if is_mapping(x) else x

    own = (f.name for f in fields(constraint) if f.init and f.type != PARAMETERS)
    return constraint.kind, *((name, convert_value(getattr(constraint, name))) for name in own)


FIXED = {NoneType, bool, int, float, str, np.bool_, np.int64, np.float64, End, Expression}
"""Classes of values that cannot change."""
CHANGING = object()
"""Stands for a value that may change unseen, or is too long to be compared."""
LONGEST = 64
"""Most numbers of a value that is compared."""


class Content(NamedTuple):
    """Values of the fields of a constraint, copied: they are equal later only if none has changed.

    Arrays and lists can change in place. Where a change would not be seen there is `CHANGING`.
    """

    kind: type[Constraint]
    rest: Any
    goals: Any

    @property
    def comparable(self) -> bool:
        """Whether each change would be seen."""
        return self.rest is not CHANGING and self.goals is not CHANGING


def freeze_fields(constraint: Constraint) -> Content:
    """Copy the values of all fields, those that only the goal is read from apart."""
    kind = constraint.__class__
    rest, goals = _list_field_names(kind)
    return Content(
        kind,
        _freeze_value([getattr(constraint, n) for n in rest]),
        _freeze_value([getattr(constraint, n) for n in goals]),
    )


@lru_cache(maxsize=512)
def _list_field_names(kind: type[Constraint]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """List the names of the fields of a kind: of those that are no goals, and of goals."""
    return tuple(f.name for f in fields(kind) if f.name not in kind.goals), kind.goals


def _freeze_value(x: Any) -> Any:
    """Return a value in a form that does not change with it, or `CHANGING`."""
    sort = x.__class__
    if sort in FIXED:
        return x
    if sort is np.ndarray and x.size <= LONGEST and x.dtype.kind in "fiub":
        return x.shape, x.dtype, x.tobytes()
    if sort is dict:
        return _freeze_value([*x, *x.values()])
    if sort not in (list, tuple) or len(x) > LONGEST:
        return CHANGING
    parts = [part if part.__class__ in FIXED else _freeze_value(part) for part in x]
    return CHANGING if CHANGING in parts else parts


# ---- fields and numbers of a kind

FRAMES = ("Frame", "Frame | None")
"""Annotations of fields that name a frame."""
SQUARE = {"Matrix": "a given pose", "Rotation": "a given rotation"}
"""Annotations of fields of numbers that are too many for a sentence, and what it says of them."""
NUMBERS = ("Number", "Point", "Direction", "Matrix", "Rotation")
"""Annotations of fields of numbers, which in a description may be expressions in parameters."""
LENGTHS = ("Number", "Point", "Points")
"""Annotations of fields of lengths, and of speeds."""
PARAMETERS = "Parameters"
"""Annotation of a field that receives the parameters of the mechanism."""


def list_frame_fields(constraint: Constraint) -> dict[str, Any]:
    """Return the fields that name frames, with their values."""
    return {f.name: getattr(constraint, f.name) for f in fields(constraint) if f.type in FRAMES}


def list_number_fields(constraint: Constraint) -> dict[str, Any]:
    """Return the fields that hold numbers, with their values."""
    return {
        name: getattr(constraint, name) for name in _list_fields_of_types(type(constraint), NUMBERS)
    }


@lru_cache(maxsize=512)
def _list_fields_of_types(kind: type[Constraint], types: tuple[str, ...]) -> tuple[str, ...]:
    """List the fields of a kind of constraints that have one of these types."""
    return tuple(f.name for f in fields(kind) if f.type in types)


def evaluate_number_fields(constraint: Constraint, parameters: Mapping[str, float]) -> Constraint:
    """Return the constraint with the expressions in its numbers evaluated.

    Errors: `UnknownNameError`.
    """
    given = {
        k: _evaluate_expressions(x, parameters)
        for k, x in list_number_fields(constraint).items()
        if list_expressions(x)
    }
    given |= dict.fromkeys(_list_fields_of_types(type(constraint), (PARAMETERS,)), parameters)
    return replace(constraint, **given) if given else constraint


def _scale_pose(x: Any, factor: Fraction) -> Any:
    """Return a pose in any form that `read_pose_array` reads with its place in another unit."""
    if list_expressions(x):  # rows of numbers and expressions
        return [[*row[:-1], scale_lengths(row[-1], factor)] for row in x[:-1]] + [x[-1]]
    X = np.array(read_pose_array(x, "pose"), dtype=float)
    X[..., :-1, -1] = scale_lengths(X[..., :-1, -1], factor)
    return X


def list_expressions(x: Any) -> list[Expression]:
    """List the expressions in a number, or in lists of numbers."""
    if isinstance(x, Expression):
        return [x]
    return [e for item in x for e in list_expressions(item)] if is_sequence(x) else []


def _evaluate_expressions(x: Any, parameters: Mapping[str, float]) -> Any:
    """Evaluate the expressions in a number, or in lists of numbers."""
    if is_sequence(x):
        return [_evaluate_expressions(item, parameters) for item in x]
    return x.evaluate(parameters) if isinstance(x, Expression) else x


def format_value(x: Any) -> str:
    """Return a name, a number or a list of them as text for a sentence."""
    if isinstance(x, (np.ndarray, list, tuple, np.generic)):
        x = np.asarray(x, dtype=object).tolist()
    if is_sequence(x):
        return f"({', '.join(map(format_value, x))})"
    return f"{x:g}" if isinstance(x, (int, float)) else getattr(x, "__name__", None) or str(x)


def list_fields(kind: type[Constraint]) -> dict[str, str]:
    """Return the fields of a kind that a description may give, with their annotations."""
    left_out = {f.name for f in fields(Constraint)}
    return {
        f.name: str(f.type)
        for f in fields(kind)
        if f.init and f.name not in left_out and f.type != PARAMETERS
    }


def list_required_fields(kind: type[Constraint]) -> list[str]:
    """List the fields of a kind that must be given."""
    own = (
        f for f in fields(kind) if f.init and f.default is MISSING and f.default_factory is MISSING
    )
    return [f.name for f in own]
