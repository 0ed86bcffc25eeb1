"""Systems with joints taken out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from kempe.calls import explained
from kempe.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from kempe.model.system import System


@explained
def opened(system: System, joints: str | Iterable[str] | None = None) -> System:
    """The system without these joints, by default without those that its tree leaves out: a loop becomes a tree.

    What postures and locks say of their coordinates goes with them. Errors: `UnknownNameError`; `InputError` where
    there is no joint to take out; `DescriptionError` where a body would hang on nothing, or where a coupling or a
    constraint needs a coordinate that is gone.
    """
    given = [joints] if isinstance(joints, str) else joints
    names = system.structure.closures if given is None else tuple(map(str, given))
    if not names:
        raise InputError(f"{system.name} has no loop to open: it is a {system.kind}")
    mechanism = system.mechanism
    for name in names:
        if name not in mechanism.joints:
            raise UnknownNameError("joint", name, tuple(mechanism.joints), system.name)
        gone = set(system.structure.coordinates_of_joint(name))
        del mechanism.joints[name]
        mechanism.postures = {k: {c: x for c, x in p.items() if c not in gone} for k, p in mechanism.postures.items()}
        mechanism.locks = {c: x for c, x in mechanism.locks.items() if c not in gone}
    return mechanism.build()
