"""Kinds of constraints on a multibody system: one class for each kind, used by all verbs.

``from kempe import constraints``: `Mechanism.constrain` holds one always, `System.ik` asks for it
in one call. `KINDS` is the table.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kempe.constraints import base
from kempe.constraints.base import Constraint, End, Op, Row
from kempe.errors import raise_missing_name

if TYPE_CHECKING:
    from kempe.constraints.base import KINDS, kind
    from kempe.constraints.clearances import Clearance
    from kempe.constraints.contacts import Contact, NoSideslip, Rolls
    from kempe.constraints.coordinates_and_centres import (
        CentreOfMass,
        CentreOfPoints,
        Function,
        Posture,
    )
    from kempe.constraints.curves import OnCurve
    from kempe.constraints.equations import Equation, Inequality, VelocityEquation
    from kempe.constraints.kinds import (
        Distance,
        HalfSpace,
        InBox,
        LookAt,
        OnLine,
        OnPlane,
        OnSphere,
        OnSurface,
        Orientation,
        Pointing,
        Pose,
        Position,
        RelativePose,
        RelativePosition,
    )

__all__ = [
    "KINDS",
    "CentreOfMass",
    "CentreOfPoints",
    "Clearance",
    "Constraint",
    "Contact",
    "Distance",
    "End",
    "Equation",
    "Function",
    "HalfSpace",
    "InBox",
    "Inequality",
    "LookAt",
    "NoSideslip",
    "OnCurve",
    "OnLine",
    "OnPlane",
    "OnSphere",
    "OnSurface",
    "Op",
    "Orientation",
    "Pointing",
    "Pose",
    "Position",
    "Posture",
    "RelativePose",
    "RelativePosition",
    "Rolls",
    "Row",
    "VelocityEquation",
    "kind",
]
MODULES = ("clearances", "contacts", "curves", "equations", "kinds", "coordinates_and_centres")
"""Where kinds are declared; imported when the first one is used, for most systems have none."""


def __getattr__(name: str) -> Any:
    """Return a kind by its name, the decorator `kind`, or the table of all kinds."""
    if name not in __all__:
        raise_missing_name(__name__, name, __all__)
    for module in MODULES:
        import_module(f"{__name__}.{module}")
    own = {
        cls.__name__: cls
        for cls in base.KINDS.values()
        if cls.__module__.startswith(f"{__name__}.")
    }
    globals().update(own, KINDS=base.KINDS, kind=base.kind)
    return globals()[name]
