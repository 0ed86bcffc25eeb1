"""Systems with joints taken out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kempe.calls import explained
from kempe.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from kempe.model.system import System


@explained
def opened(system: System, *joints: str) -> System:
    """The system without these joints, by default without those that its tree leaves out: a loop becomes a tree.

    What postures and locks say of their coordinates goes with them. Errors: `UnknownNameError`; `InputError` where
    there is no joint to take out; `DescriptionError` where a body would hang on nothing, or where a coupling or a
    constraint needs a coordinate that is gone.
    """
    names = joints or system.structure.closures
    if not names:
        raise InputError(f"{system.name} has no loop to open: it is a {system.kind}")
    mechanism = system.mechanism
    for name in map(str, names):
        if name not in mechanism.joints:
            raise UnknownNameError("joint", name, tuple(mechanism.joints), system.name)
        gone = {c for c in system.structure.coordinates_of_joint(name)}
        del mechanism.joints[name]
        mechanism.postures = {k: {c: x for c, x in p.items() if c not in gone} for k, p in mechanism.postures.items()}
        mechanism.locks = {c: x for c, x in mechanism.locks.items() if c not in gone}
    return mechanism.build()
