"""Systems with joints taken out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from kempe.calls import explained
from kempe.description.parts import Frame
from kempe.errors import InputError, UnknownNameError
from kempe.model.compiled_system import SystemType

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism


@explained
def opened(system: SystemType, joints: str | Iterable[str] | None = None) -> SystemType:
    """The system without these joints, by default without those that its tree leaves out: a loop
    becomes a tree.

    Where a joint was, each moving body keeps a frame, called "C on rocker" for joint C and the body
    rocker. What postures and locks say of the coordinates of the joints goes with them. Errors:
    `UnknownNameError`; `InputError` where there is no joint to take out; `DescriptionError` where a
    body would hang on nothing, or where a coupling or a constraint needs a coordinate that is gone.
    """
    given = [joints] if isinstance(joints, str) else joints
    names = system.structure.closures if given is None else tuple(map(str, given))
    if not names:
        raise InputError(f"{system.name} has no loop to open: it is a {system.kind}")
    mechanism = system.mechanism
    for name in names:
        if name not in mechanism.joints:
            raise UnknownNameError("joint", name, tuple(mechanism.joints), system.name)
        _keep_ends(mechanism, name)
        gone = set(system.structure.coordinates_of_joint(name))
        del mechanism.joints[name]
        mechanism.postures = {
            k: {c: x for c, x in p.items() if c not in gone} for k, p in mechanism.postures.items()
        }
        mechanism.locks = {c: x for c, x in mechanism.locks.items() if c not in gone}
    return type(system)(mechanism)


def _keep_ends(mechanism: Mechanism, name: str) -> None:
    """Give the moving bodies of a joint frames where it holds them, before those that are there."""
    joint = mechanism.joints[name]
    frames = dict[str, Frame]()
    for body, X in ((joint.parent, joint.X_PF), (joint.child, joint.X_CM)):
        label = f"{name} on {body}"
        taken = label in mechanism.frames or label in mechanism.bodies
        if (
            body != mechanism.ground.name
            and not taken
            and not (mechanism.bodies[body].particle and X.steps)
        ):
            frames[label] = Frame(label, body, X)
    mechanism.frames = {**frames, **mechanism.frames}
