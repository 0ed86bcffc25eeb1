"""Kinds on the whole configuration: coordinates, centres of mass and of points, functions of q."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arrays import read_mapping
from kempe.constraints.base import (
    EYE,
    Bounded,
    Constraint,
    Mass,
    Names,
    Number,
    Op,
    Point,
    Row,
    check_constant,
    kind,
    read_numbers,
    read_points,
)
from kempe.errors import InputError
from kempe.spatial import Array

AXES = ("xyz", "xy", "xz", "yz", "x", "y", "z")


@kind("posture", says="coordinates are near {q}")
class Posture(Constraint):
    """Demand that coordinates are near given values.

    Parameters
    ----------
    q
        Configuration (..., nq) in radians and metres, or values by name of the coordinates that
        count.
    weight
        Weight of the squared error (default: 1). With None the values must hold.

    Notes
    -----
    A quaternion counts as a whole, by the angle between the two orientations.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import Position, Posture
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik([Position("tool", (0.4, 0.2, 0.3)), Posture({"q4": 0.0}, weight=0.1)])
    >>> bool(answer.success)
    True
    """

    q: ArrayLike | Mapping[str, ArrayLike]
    weight: float | None = field(default=1.0, kw_only=True)

    unbounded: ClassVar[str] = "Equation has bounds of a coordinate"

    @property
    def subject(self) -> str:
        """The coordinates that are held, by name."""
        given = read_mapping(self.q)
        return "all coordinates" if given is None else ", ".join(map(repr, given))

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for each named coordinate, or for each coordinate if none is named."""
        given = read_mapping(self.q)
        return (Row(Op.COORDINATE, () if given is None else tuple(given), "value"),)


class _OfCentre(Bounded):
    """Base of constraints on a centre of masses, along some of its axes.

    Along a single axis it may have bounds.
    """

    goals: ClassVar[tuple[str, ...]] = ("target",)

    @property
    def ends(self) -> tuple[Any, Any]:
        """The ground as end A, and None as end B, since a centre of mass is not a frame."""
        return None, None

    def describe_field(self, name: str) -> str:
        """Return the value of a field in words; given bounds replace the target."""
        if name != "target" or not self.bounded:
            return super().describe_field(name)
        return f"{self.axes} {self.bounds_text}"  # type: ignore[attr-defined]

    def list_axis_numbers(self, dim: int) -> list[int]:
        """List the numbers (0 for x, 1 for y, 2 for z) of the axes in the field `axes`.

        `dim` is 2 in the plane, else 3.

        Errors: `InputError` for text that names none.
        """
        axes = self.axes  # type: ignore[attr-defined]
        found = ["xyz".index(a) for a in axes] if isinstance(axes, str) and axes in AXES else []
        found = [i for i in found if i < dim]
        if not found:
            allowed = ", ".join(a for a in AXES if dim == 3 or a != "z")
            raise InputError(f"axes of {self.label} are {axes!r}; allowed are {allowed}")
        return found

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for each axis in the field `axes`, with bounds where they are given."""
        n = len(self.list_axis_numbers(dim))
        if self.bounded != (self.target is None) or (self.bounded and n > 1):  # type: ignore[attr-defined]
            raise InputError(
                f"{self.label} needs a target, or at_least or at_most along one of its axes"
            )
        if self.bounded:
            k = self.list_axis_numbers(dim)[0]
            return (Row(Op.POINT, (k,), "xyz"[k], low="at_least", high="at_most"),)
        w = read_numbers(self.within, f"within of {self.label}")  # type: ignore[attr-defined]
        if w.shape[-1:] not in ((), (1,), (n,)) or not np.all(w >= 0.0):
            raise InputError(
                f"within of {self.label} is {self.within!r}; "  # type: ignore[attr-defined]
                f"it must be a distance, or (..., {n})"
            )
        ends = {"low": "lower_margins", "high": "upper_margins"} if np.any(w) else {}
        return tuple(
            Row(Op.POINT, (i,), "xyz"[i], part=k if ends else None, **ends)
            for k, i in enumerate(self.list_axis_numbers(dim))
        )

    @property
    def upper_margins(self) -> Array:
        """Largest allowed offsets (..., n) [m] of the centre from the target along each axis."""
        w = read_numbers(self.within, f"within of {self.label}")  # type: ignore[attr-defined]
        n = len(self.axes)  # type: ignore[attr-defined]
        return np.broadcast_to(w, (*w.shape[:-1], n))

    @property
    def lower_margins(self) -> Array:
        """Least allowed offsets (..., n) [m] of the centre from the target along each axis."""
        return -self.upper_margins

    def make_goal_poses(self, dim: int) -> Array:
        """Return poses (..., 4, 4) at the target.

        The target has three numbers, or one for each axis in the field `axes`.
        """
        if self.bounded:
            return EYE
        what = f"target of {self.label}"
        axes = self.list_axis_numbers(dim)
        p = read_numbers(self.target, what)  # type: ignore[attr-defined]
        if p.shape[-1:] == (len(axes),):
            p, given = np.zeros((*p.shape[:-1], 3)), p
            p[..., axes] = given
        elif p.shape[-1:] not in ((3,), (dim,)):
            short = f", or (..., {len(axes)}) for axes={self.axes!r}" if len(axes) < dim else ""  # type: ignore[attr-defined]
            raise InputError(f"{what} has shape {p.shape}; it must be (..., {dim}){short}")
        return spatial.pose(p=read_points(p, dim, what))


@kind("centre_of_mass", says="the centre of mass is at {target}")
class CentreOfMass(_OfCentre):
    """Demand that the centre of mass is at a position.

    Parameters
    ----------
    target
        Position (..., 3) in metres, or (..., n) for the n axes that count.
    axes
        Axes of the ground that count: "xyz" (default), "xy", "xz", "yz", "x", "y" or "z".
    within
        Largest distance from the target along each axis in metres: a number, or (..., n) for
        the n axes (default: 0).
    at_least, at_most
        Bounds of the coordinate along a single axis in metres, in place of a target (default: none).

    Raises
    ------
    InputError
        If the system has no masses, or neither a target nor bounds are given.

    Notes
    -----
    Masses and centres are those of the bodies; bodies without a mass do not count.

    Examples
    --------
    >>> from kempe import Mechanism
    >>> from kempe.tasks import CentreOfMass
    >>> m = Mechanism("pendulum", dim=2)
    >>> _ = m.revolute("q1", m.ground, m.body("link", mass=2.0, center=(0.5, 0)))
    >>> robot = m.build()
    >>> round(float(robot.ik(CentreOfMass((0.3,), axes="x"), start=[1.0]).q[0]), 4)
    0.9273
    """

    target: Point = None
    axes: str = "xyz"
    within: Number = 0.0

    measured: ClassVar[str] = "height"

    @property
    def subject(self) -> str:
        """Text that names the whole system in messages."""
        return "the system"

    def list_masses(self, bodies: Mapping[str, Any], what: str) -> list[Mass]:
        """Return the centres of the bodies with their shares of the mass."""
        heavy = [
            (n, tuple(b.center or (0.0, 0.0, 0.0)), float(b.mass or 0.0)) for n, b in bodies.items()
        ]
        total = sum(mass for _, _, mass in heavy)
        if not total > 0.0:
            raise InputError(f"{what} has no masses: it has no centre of mass")
        return [Mass(n, p, mass / total) for n, p, mass in heavy if mass > 0.0]


@kind("centre_of_points", says="the mean of {frames} is at {target}")
class CentreOfPoints(_OfCentre):
    """Demand that the mean of the origins of frames is at a position.

    Parameters
    ----------
    frames
        Names of the frames, or a dict of weights by name.
    target
        Position (..., 3) in metres, or (..., n) for the n axes that count.
    axes
        Axes of the ground that count: "xyz" (default), "xy", "xz", "yz", "x", "y" or "z".
    within
        Largest distance from the target along each axis in metres: a number, or (..., n) for
        the n axes (default: 0).
    at_least, at_most
        Bounds of the coordinate along a single axis in metres, in place of a target (default: none).

    Raises
    ------
    InputError
        If there are no frames, or neither a target nor bounds are given.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import CentreOfPoints
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(CentreOfPoints(["link3", "tool"], (0.3,), axes="z"))
    >>> bool(answer.success)
    True
    """

    frames: Sequence[str] | Mapping[str, float]
    target: Point = None
    axes: str = "xyz"
    within: Number = 0.0

    measured: ClassVar[str] = "height"

    def __post_init__(self) -> None:
        if isinstance(self.frames, str) or not isinstance(self.frames, Iterable):
            raise InputError(
                f"frames of {type(self).__name__} is {self.frames!r}; it must be a list of names of "
                "frames, or a dict of their weights"
            )

    @property
    def subject(self) -> str:
        """The names of the frames."""
        return ", ".join(repr(str(f)) for f in self.frames)

    def list_masses(self, bodies: Mapping[str, Any], what: str) -> list[Mass]:
        """Return the origins of the frames with their shares of the weight."""
        given = self.frames if isinstance(self.frames, Mapping) else dict.fromkeys(self.frames, 1.0)
        weights = {
            f: float(check_constant(read_numbers(w, said := f"a weight of {self.label}"), said))
            for f, w in given.items()
        }
        total = sum(weights.values())
        if not weights or any(not w > 0.0 for w in weights.values()):
            raise InputError(
                f"frames of {self.label} are {self.frames!r}; needed are some, with weights above 0"
            )
        return [Mass(f, (0.0, 0.0, 0.0), w / total) for f, w in weights.items()]


@kind("function", says="{function} is zero")
class Function(Constraint):
    """Demand that a function of the configuration is zero, or between bounds.

    Parameters
    ----------
    function
        Function of q (nq,) that returns a number or an array (m,). With `frames` it is called
        with their poses (4, 4) in the ground, one argument each, in place of q.
    derivative
        Function that returns the derivatives (m, nv) by the velocity coordinates (default:
        complex steps or differences). It is compared with differences.
    low, high
        Bounds, a number or (m,) (default: 0).
    frames
        Names of frames (default: none).

    See Also
    --------
    Equation : expressions of named coordinates, which are faster.

    Notes
    -----
    Without `derivative` there are one or two calls for each coordinate; with `frames`, for each
    coordinate that moves one of them. The error is compared with the tolerance of angles.

    Examples
    --------
    >>> import kempe
    >>> from kempe.tasks import Function
    >>> robot = kempe.load("puma560")
    >>> answer = robot.ik(Function(lambda X: X[2, 3] - 0.3, frames=("tool",)))
    >>> round(float(robot.fk(answer.q, "tool")[2, 3]), 5)
    0.3
    """

    function: Callable[..., object]
    derivative: Callable[..., object] | None = None
    low: ArrayLike = 0.0
    high: ArrayLike = 0.0
    frames: Names = ()

    unbounded: ClassVar[str] = "its bounds are 'low' and 'high'"

    @property
    def subject(self) -> str:
        """The name of the function."""
        return getattr(self.function, "__name__", repr(self.function))

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for the function; a call of the function shows the number of equations."""
        return (Row(Op.CALL, (self.function,), "value", "1", low="low", high="high"),)
