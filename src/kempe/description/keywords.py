"""What the methods of `Mechanism` take: types of places and turns, and the keywords of all joints."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, TypedDict, TypeVar

from numpy.typing import ArrayLike

from kempe.arguments import add_parameter_text, find_parameter_text
from kempe.description.parts import Body, Frame
from kempe.errors import Where
from kempe.poses import Placement
from kempe.spatial import Array
from kempe.values import Value

BodyLike: TypeAlias = Body | str
"""A body, or its name."""
ValueLike: TypeAlias = Value | str
"""A number, an expression in parameters, or its text, such as ``"l1/2"``."""
ValuesLike: TypeAlias = Sequence[ValueLike] | Array
"""Several numbers or expressions."""
PlaceLike: TypeAlias = ArrayLike | ValuesLike | Mapping[str, ArrayLike] | Placement | Frame
"""A position (2 or 3 lengths), a pose (4, 4), a pose in words such as ``{"at": (1, 0, 0)}``, a
`Placement`, or a frame or its name."""
AxisLike: TypeAlias = Sequence[float] | Array | str
"""A direction, or its name: "x", "-z"."""
MatrixLike: TypeAlias = ArrayLike
"""A rotation matrix (3, 3)."""
LimitsLike: TypeAlias = (
    Sequence[float | None] | Array | Mapping[str, Sequence[float | None] | Array]
)
"""A pair (lower, upper), with None for no limit, or a dict of such pairs by coordinate."""
BoundsLike: TypeAlias = float | Mapping[str, float]
"""A largest value, or a dict of them by velocity coordinate."""

Method = TypeVar("Method", bound=Callable[..., Any])


class JointKeywords(TypedDict, total=False):
    """Keywords that all joints take; `Mechanism.joint` describes them."""

    at: PlaceLike
    child_at: PlaceLike
    rpy: ValuesLike | None
    angle: ValueLike | None
    axis: AxisLike | None
    child_rpy: ValuesLike | None
    child_angle: ValueLike | None
    child_axis: AxisLike | None
    quat_wxyz: ValuesLike | None
    matrix: MatrixLike | None
    child_quat_wxyz: ValuesLike | None
    child_matrix: MatrixLike | None
    limits: LimitsLike | None
    velocity: BoundsLike | None
    effort: BoundsLike | None
    actuated: bool | None
    cut: bool
    where: Where | None


def make_turn(
    rpy: object, angle: object, axis: object, quat_wxyz: object, matrix: object
) -> dict[str, Any]:
    """Return the keywords of an orientation by name, as `kempe.poses.place` takes them."""
    return {"rpy": rpy, "angle": angle, "axis": axis, "quat_wxyz": quat_wxyz, "matrix": matrix}


def show_joint_keywords(joint: Callable[..., Any]) -> Callable[[Method], Method]:
    """Make a decorator that shows the keywords of `joint` in place of ``**keywords``.

    The keywords stand in the signature of the method, and what the docstring of `joint` says of
    them stands in its docstring, after its own parameters.
    """
    keywords = [
        p.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, p in inspect.signature(joint).parameters.items()
        if name in JointKeywords.__annotations__
    ]
    text = find_parameter_text(joint.__doc__, first="at")

    def write_method(method: Method) -> Method:
        signature = inspect.signature(method)
        own = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        method.__signature__ = signature.replace(parameters=[*own, *keywords])  # type: ignore[attr-defined]
        method.__doc__ = add_parameter_text(method.__doc__, text)
        return method

    return write_method
