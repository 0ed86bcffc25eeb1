"""Kinds on the whole configuration: coordinates, centres of mass and of points, functions of q."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from typing import Any, ClassVar

import numpy as np

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
    """Coordinates near given values.

    The values are a configuration `q` (..., nq), or a dict by coordinate name of those that count.

    It is soft unless `weight` is None. A quaternion counts as a whole, by the angle between the two
    orientations.
    """

    q: Any
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
    """Centre of mass at a position `target` (..., 3), or `within` a distance [m] of the target.

    `axes` says along which axes: "xyz", "xy", ...

    Where fewer axes count, `target` may have a number for each of these only.
    `within` is one number, or (..., n) for the n axes, from target to target where it has leading
    axes. Along one axis, `at_least` and `at_most` are bounds in place of a target.
    Masses and centres are those of the bodies, as files give them.
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
    """The mean of the origins of frames at a position `target` (..., 3).

    `frames` is a list, or a dict of weights.

    Along one axis, `at_least` and `at_most` are bounds in place of a target.
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
    """A function of q (nq,) that is zero, or between `low` and `high` (m,).

    It gives a number or an array (m,).

    With `frames` it is called with their poses (4, 4) in the ground, one after the other, in place
    of q. `derivative` gives its derivatives (m, nv) by the velocity coordinates, and is checked;
    else they are by complex steps or differences, with one or two calls for each coordinate, and
    with `frames` for each that moves one of them. Its error is compared with the tolerance of
    angles.
    """

    function: Callable[..., Any]
    derivative: Callable[..., Any] | None = None
    low: Any = 0.0
    high: Any = 0.0
    frames: Names = ()

    unbounded: ClassVar[str] = "its bounds are 'low' and 'high'"

    @property
    def subject(self) -> str:
        """The name of the function."""
        return getattr(self.function, "__name__", repr(self.function))

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row for the function; a call of the function shows the number of equations."""
        return (Row(Op.CALL, (self.function,), "value", "1", low="low", high="high"),)
