"""What may be required of a multibody system: every kind of constraint is one class, declared for all verbs alike.

``from kempe import constraints``: `Mechanism.constrain` holds one always, `System.ik` asks for it in one call.
`KINDS` is the table.
"""

from kempe.constraints.base import KINDS, Constraint, End, Op, Row, kind
from kempe.constraints.contacts import Contact, NoSideslip, Rolls
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
from kempe.constraints.whole import CentreOfMass, CentreOfPoints, Function, Posture

__all__ = [
    "KINDS", "CentreOfMass", "CentreOfPoints", "Constraint", "Contact", "Distance", "End", "Equation", "Function",
    "HalfSpace", "InBox", "Inequality", "LookAt", "NoSideslip", "OnCurve", "OnLine", "OnPlane", "OnSphere",
    "OnSurface", "Op", "Orientation", "Pointing", "Pose", "Position", "Posture", "RelativePose", "RelativePosition",
    "Rolls", "Row", "VelocityEquation", "kind",
]  # fmt: skip
