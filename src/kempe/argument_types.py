"""Types of what users give, for the annotations of public functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias

from numpy.typing import ArrayLike

from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.constraints.base import Constraint
    from kempe.description.parts import Body, Frame
    from kempe.model.model import FrameLike


class JointStateLike(Protocol):
    """A message with the names of coordinates and their values, such as JointState of ROS."""

    name: Sequence[str]
    position: Sequence[float]


class HasConfigurations(Protocol):
    """An answer with configurations."""

    @property
    def q(self) -> Array:
        """Configurations (n, nq)."""
        ...


class PoseMessage(Protocol):
    """A message with a place and a quaternion x y z w, such as Pose of ROS."""

    position: object
    orientation: object


class TransformMessage(Protocol):
    """A message with a translation and a quaternion x y z w, such as Transform of ROS."""

    translation: object
    rotation: object


class StampedPose(Protocol):
    """A message around a pose, such as PoseStamped of ROS."""

    pose: object


class StampedTransform(Protocol):
    """A message around a transform, such as TransformStamped of ROS."""

    transform: object


class PinocchioPose(Protocol):
    """A pose of Pinocchio, an `SE3`."""

    homogeneous: Array


class ToolboxPose(Protocol):
    """A pose of the Spatial Math Toolbox, an `SE3`."""

    A: object


class MatrixPose(Protocol):
    """A rotation or pose of SciPy or jaxlie."""

    def as_matrix(self) -> object:
        """Return the matrix."""
        ...


class DrakePose(Protocol):
    """A pose of Drake, a `RigidTransform`."""

    def GetAsMatrix4(self) -> object:
        """Return the matrix."""
        ...


PoseObject: TypeAlias = (
    PoseMessage
    | TransformMessage
    | StampedPose
    | StampedTransform
    | PinocchioPose
    | ToolboxPose
    | MatrixPose
    | DrakePose
)
ConfigurationLike: TypeAlias = (
    ArrayLike | Mapping[str, ArrayLike] | Sequence[Mapping[str, ArrayLike]] | JointStateLike
)
"""Configurations: an array (..., nq) in radians and metres, values by coordinate name, a table
whose columns have the names, or a message with names."""
StartLike: TypeAlias = ConfigurationLike | str
"""A configuration, or the name of a posture."""
PoseLike: TypeAlias = ArrayLike | Mapping[str, ArrayLike] | PoseObject | Sequence[PoseObject]
"""Poses (..., 4, 4), in the plane also (..., 3, 3), and positions (..., d); pairs of a position and
a rotation; a pose in words such as ``{"at": (1, 0, 0), "rpy": (0, 0, 0.5)}``; poses and messages of
other libraries."""
TaskLike: TypeAlias = "Constraint | Sequence[Constraint]"
"""One task of `kempe.tasks`, or several."""
TargetLike: TypeAlias = "PoseLike | TaskLike"
"""What a frame reaches, or tasks."""
HeldLike: TypeAlias = (
    "TaskLike | Callable[[Array], ArrayLike] | Sequence[Constraint | Callable[[Array], ArrayLike]]"
)
"""Constraints, or functions of q (nq,) that must be zero."""
KnownValues: TypeAlias = Mapping[str, PoseLike]
"""Values by coordinate name, and places or poses by frame name."""
Preference: TypeAlias = Literal["nearest", "mid", "manipulability"] | Callable[[Array], float]
"""What is minimised in the freedoms that tasks leave: by name, or a function of q (nq,)."""
Inputs: TypeAlias = Mapping[str, float | Array | Sequence[float] | Callable[[float], float]]
"""Values by name: numbers, arrays over the time, or functions of the time in seconds."""
Limits: TypeAlias = Mapping[str, tuple[float | None, float | None] | None] | ArrayLike
"""Pairs (lower, upper) by coordinate name, with None for no limit, or an array (n, 2)."""
MotionLike: TypeAlias = ArrayLike | HasConfigurations
"""A motion: configurations (n, nq), or an answer that has them."""
Frames: TypeAlias = "list[str] | list[Body] | list[Frame] | list[FrameLike] | tuple[FrameLike, ...]"
"""Several bodies or frames, by their names or as declared."""
