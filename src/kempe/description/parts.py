"""What a `Mechanism` is made of: plain records, without kinematics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NoReturn

from kempe.errors import Where
from kempe.joints import JointType
from kempe.placement import Placement
from kempe.values import Value

Limits = tuple[float, float]
"""Lower and upper bound of one velocity coordinate; an infinity where there is none."""


class Fixed(dict):
    """A dict that can only be read: what it says is part of something that does not change."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("this dict is read-only: nothing would change; change a Mechanism, or make another System "
                        "by with_limits, with_parameters or lock")  # fmt: skip

    __setitem__ = __delitem__ = __ior__ = update = setdefault = pop = popitem = clear = _refuse  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return Fixed, (dict(self),)


@dataclass(frozen=True)
class Body:
    """A rigid body, or a particle: a body without orientation (3 degrees of freedom in space, 2 in the plane)."""

    name: str
    particle: bool = False
    mass: float | None = None
    center: tuple[float, float, float] | None = None
    visuals: tuple[str, ...] = ()
    where: Where | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Joint:
    """A joint of any type between any two bodies: its frame F sits at `X_PF` on the parent, M at `X_CM` on the child.

    `limits`, `velocity_limits` and `effort_limits` are by the joint's velocity coordinate names ('' where there is
    one). `actuated` says that a motor drives it (True), that it is passive (False), or nothing (None); `cut` asks
    that, in a loop, this joint be left out of the spanning tree, over which `fk` goes; no answer of solvers depends on
    it. `unstated` marks limits that a file does not give, and that are zero by the rules of its format.
    """

    name: str
    type: JointType
    parent: str
    child: str
    X_PF: Placement = Placement()
    X_CM: Placement = Placement()
    limits: dict[str, Limits] = field(default_factory=dict)
    velocity_limits: dict[str, float] = field(default_factory=dict)
    effort_limits: dict[str, float] = field(default_factory=dict)
    actuated: bool | None = None
    cut: bool = False
    where: Where | None = field(default=None, compare=False, repr=False)
    unstated: bool = field(default=False, compare=False, repr=False)

    def __str__(self) -> str:
        return self.name

    def __hash__(self) -> int:
        return hash(self.name)


@dataclass(frozen=True)
class Frame:
    """A named frame on a body."""

    name: str
    body: str
    X_BF: Placement = Placement()
    where: Where | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Constraint:
    """A condition on two bodies that is not a joint; the bodies need joints besides.

    Frame A sits at `X_PF` on the parent, point B is the origin of `X_CM` on the child. By `kind`: "distance", B is
    `length` metres from the origin of A (a rod with a ball joint at each end); "point_on_line", B is on the z axis of
    A; "point_on_plane", B is in the xy-plane of A.
    """

    name: str
    kind: str
    parent: str
    child: str
    X_PF: Placement = Placement()
    X_CM: Placement = Placement()
    length: Value | None = None
    where: Where | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return self.name


CONSTRAINT_KINDS = ("distance", "point_on_line", "point_on_plane")
"""What a `Constraint` can ask."""


@dataclass(frozen=True)
class Coupling:
    """A linear relation of joint coordinates: coordinate `of` = sum of multiplier * source + `offset`."""

    of: str
    sources: dict[str, Value]
    offset: Value = 0.0
    where: Where | None = field(default=None, compare=False, repr=False)

    def __hash__(self) -> int:
        return hash(self.of)
