"""Former names of what a `System` has: they work with a warning that says the place, and are listed nowhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from kempe.errors import warn

STRUCTURE = (
    "closures", "content_hash", "coordinates", "coordinates_of_joint", "couplings", "frame_name", "frames", "joints",
    "layout", "limits", "notes", "parameters", "parent_joints", "posture_names", "relations", "table", "tolerance",
    "topology", "velocity_limits", "velocity_names",
)  # fmt: skip

FORMER = {
    **{name: f"structure.{name}" for name in STRUCTURE},
    "structure_hash": "structure.hash",
    **{name: f"configuration_space.{name}" for name in ("difference", "distance", "integrate", "interpolate")},
    **{name: f"loops.{name}" for name in ("assembler", "closed_form", "closure_error", "constraints")},
    **{name: f"loops.{name}" for name in ("mechanical_advantage", "transmission_angle")},
    "loop_jacobian": "loops.jacobian",
    **{name: f"inverse.{name}" for name in ("arm_angle", "self_motion")},
    "ik_plan": "inverse.plan",
    "ik_sweep": "inverse.sweep",
    "symbolic_fk": "symbolic.fk",
    "posture": "q",
    "save": "mechanism.save",
    "lock": "mechanism.lock(...).build()",
    "subchain": "mechanism.subchain(...).build()",
    "maximal": "kempe.convert.maximal(system)",
    "to_maximal": "kempe.convert.to_maximal(system, q)",
    "from_maximal": "kempe.convert.from_maximal(system, poses)",
}
"""The place of each, as an attribute of the system or as a function of it."""


class Former:
    """An attribute by its former name."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, system: Any, owner: type) -> Any:
        """What the name stands for; it warns, and says the place."""
        if system is None:
            return self
        place = FORMER[self.name]
        said = place if place.startswith("kempe.") else f"system.{place}"
        warn(f"system.{self.name} is the former name of {said}", DeprecationWarning)
        return found(system, self.name)


def found(system: Any, name: str) -> Any:
    """The attribute that a former name stands for, with a warning."""
    from functools import partial  # only here: few ask for former names
    from operator import attrgetter

    from kempe import convert

    place = FORMER[name]
    if place.startswith("kempe."):
        function = getattr(convert, name)
        return function(system) if name == "maximal" else partial(function, system)
    if place.endswith(".build()"):
        return _built(getattr(system.mechanism, name))
    if name == "posture":
        return system.q
    return attrgetter(place)(system)


def _built(change: Callable[..., Any]) -> Callable[..., Any]:
    """The change of a mechanism, followed by its building."""
    return lambda *args, **options: change(*args, **options).build()


class Unlisted(type):
    """A class whose former names are not listed by `dir`."""

    def __dir__(cls) -> Iterable[str]:
        return [name for name in super().__dir__() if name not in FORMER]


class FormerNames(metaclass=Unlisted):
    """The former names, as attributes: looking up other attributes takes no longer, as it would by `__getattr__`."""

    def __dir__(self) -> Iterable[str]:
        return [name for name in super().__dir__() if name not in FORMER]


for _name in FORMER:
    _attribute = Former()
    _attribute.__set_name__(FormerNames, _name)
    setattr(FormerNames, _name, _attribute)
