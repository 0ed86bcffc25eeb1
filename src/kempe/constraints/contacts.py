"""Kinds of contacts: points and balls above a plane, and wheels, discs and balls that roll.

A plane is the xy-plane of a frame `other`; in planar systems it is the line of its x axis, which y
points away from.
"""

from __future__ import annotations

from typing import Any, ClassVar

from kempe.arguments import read_flag
from kempe.constraints.base import (
    Constraint,
    Frame,
    Number,
    Op,
    Row,
    kind,
    read_nonnegative_numbers,
)
from kempe.constraints.tape import POSE, TWIST
from kempe.constraints.text import parse_tape
from kempe.errors import InputError, UnknownNameError

SPACE = {
    "ball": ("z - radius", ("vx - radius*wy", "vy + radius*wx"), "wz"),
    "disc": (
        "z - radius*sqrt(1 - zy^2)",
        (
            "vx - radius*(wy*(1 - zy^2) + wz*yy*zy)/sqrt(1 - zy^2)",
            "vy + radius*(wx*(1 - zy^2) + wz*xy*zy)/sqrt(1 - zy^2)",
        ),
        "wz",
    ),
}
"""Of each shape of the radius that touches the plane: the gap, the velocities of the point that
touches, its spin.

The point of a disc whose axle is a, y of its frame, lies at c = -radius (n - (n.a) a) / |n - (n.a)
a| from its centre, n being the normal; its velocity is v + w x c.
"""
PLANE = {
    "ball": ("y - radius", ("vx + radius*wz",), ""),
    "disc": ("y - radius", ("vx + radius*wz",), ""),
}


def choose_contact_expressions(shape: Any, dim: int, what: str) -> tuple[str, tuple[str, ...], str]:
    """Return the expressions of the gap, the slips and the spin of a shape.

    Errors: `UnknownNameError`.
    """
    if not isinstance(shape, str) or shape not in SPACE:
        raise UnknownNameError("shape", shape, SPACE, what)
    return (PLANE if dim == 2 else SPACE)[shape]


@kind("contact", "contact", "{frame} stays above the plane of {other}")
class Contact(Constraint):
    """Demand that a point, ball or disc stays on or above a plane.

    Parameters
    ----------
    frame
        Name of the frame or body, whose origin is the centre.
    other
        Frame whose xy-plane is the plane (default: the ground). In the plane it is the line of
        its x axis, and y points to the allowed side.
    radius
        Radius in metres (default: 0, a point).
    shape
        "ball" or "disc"; the axle of a disc is y of its frame.

    See Also
    --------
    Mechanism.contact : hold it always.
    """

    frame: Frame
    other: Frame | None = None
    radius: Number = 0.0
    shape: str = "ball"

    unbounded: ClassVar[str] = "its gap is never negative; OnPlane has bounds of a height"

    def check_fields(self, dim: int) -> None:
        """Refuse a negative radius."""
        read_nonnegative_numbers(self.radius, f"radius of {self.label}")

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the gap, which is not negative."""
        gap, _, _ = choose_contact_expressions(self.shape, dim, self.label)
        return (
            Row(Op.TAPE, (parse_tape([gap], (*POSE, "radius"), {}), 0), "gap", "m", low="zero"),
        )


@kind("no_sideslip", "wheel", "{frame} does not slip along its y")
class NoSideslip(Constraint):
    """Prescribe the velocity of a frame's origin along its y axis: 0 for a wheel or a blade.

    Parameters
    ----------
    frame
        Name of the frame or body.
    other
        Frame against which the velocity is measured (default: the ground).
    speed
        Velocity along y in m/s (default: 0).

    See Also
    --------
    Mechanism.no_sideslip : hold it always.

    Notes
    -----
    The constraint is one of velocities: a mechanism can have it, `ik` cannot.
    """

    frame: Frame
    other: Frame | None = None
    speed: Number = 0.0

    prevents: ClassVar[str] = "the wheels of {name!r} do not slip sideways"

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return one row: the velocity along y of the frame."""
        text = "xy*vx + yy*vy - speed" if dim == 2 else "xy*vx + yy*vy + zy*vz - speed"
        return (
            Row(
                Op.VELOCITY,
                (parse_tape([text], (*POSE, *TWIST, "speed"), {}), 0),
                "sideslip",
                "m/s",
            ),
        )


@kind("rolls", "wheel", "{frame} rolls on the plane of {other}")
class Rolls(Constraint):
    """Demand that a ball or disc rolls on a plane without slipping.

    Parameters
    ----------
    frame
        Name of the frame or body, whose origin is the centre.
    other
        Frame whose xy-plane is the plane (default: the ground); in the plane, the line of its x
        axis.
    radius
        Radius in metres; it must be given.
    shape
        "ball" or "disc"; the axle of a disc is y of its frame.
    spin
        Whether it may turn about the normal of the plane (default: True).
    one_sided
        Whether it may leave the plane (default: False).

    See Also
    --------
    Mechanism.rolls : hold it always.

    Notes
    -----
    One equation holds the gap at 0; one or more hold the velocity of the touching point at 0. A
    mechanism can have the constraint, `ik` cannot.
    """

    frame: Frame
    other: Frame | None = None
    radius: Number = None
    shape: str = "ball"
    spin: bool = True
    one_sided: bool = False

    prevents: ClassVar[str] = "{name!r} does not slip"

    def __post_init__(self) -> None:
        read_flag(self.spin, f"spin of {self.label}")
        read_flag(self.one_sided, f"one_sided of {self.label}")

    def check_fields(self, dim: int) -> None:
        """Refuse a negative radius."""
        read_nonnegative_numbers(self.radius, f"radius of {self.label}")

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """Return rows of the gap (an equation on positions) and of the slip velocities."""
        if self.radius is None:
            raise InputError(f"{self.label} needs a radius")
        gap, slips, spin = choose_contact_expressions(self.shape, dim, self.label)
        more = (spin,) if spin and not self.spin else ()
        inputs = (*POSE, *TWIST, "radius")
        tape = parse_tape([*slips, *more], inputs, {})
        own = parse_tape([gap], (*POSE, "radius"), {})
        names = [
            *(f"slip {a}" for a, _ in zip("xy", slips, strict=False)),
            *(["spin"] if more else []),
        ]
        low = "zero" if self.one_sided else ""
        return (
            Row(Op.TAPE, (own, 0), "gap", "m", low=low),
            *(
                Row(Op.VELOCITY, (tape, k), name, "rad/s" if name == "spin" else "m/s")
                for k, name in enumerate(names)
            ),
        )
