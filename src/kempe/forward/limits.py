"""Systems with other limits of coordinates and speeds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from kempe.arguments import explain_errors
from kempe.arrays import read_mapping, read_reals
from kempe.description import checks
from kempe.description.parts import Joint
from kempe.errors import InputError, UnknownNameError
from kempe.model.coordinates import HELD_TOLERANCE
from kempe.model.model import Model, SystemType

UNLIMITED = (-math.inf, math.inf)


@explain_errors
def with_limits(system: SystemType, limits: Any = None, velocity: Any = None) -> SystemType:
    """Return the system with other limits of coordinates and speeds; see `System.with_limits`."""
    pairs = _read_limits(system, limits, "limits", 2)
    speeds = _read_limits(system, velocity, "velocity", 1)
    mechanism = system.mechanism
    for name in (*pairs, *speeds):
        joint, local = _find_joint(system, name)
        now = mechanism.joints[joint.name]
        particle = mechanism.bodies[joint.child].particle
        if name in pairs:
            pair = UNLIMITED if pairs[name] is None else pairs[name]
            subject = f"limits of {name!r}"
            names = {local: pair}
            found = checks.check_limits(subject, names, joint.type, system.dim, particle, None)
            now = replace(now, limits={**now.limits, **found})
        if name in speeds:
            speed = math.inf if speeds[name] is None else speeds[name]
            found = checks.check_bounds(
                f"velocity of {name!r}",
                "velocity",
                {local: speed},
                joint.type.list_velocity_names(system.dim, particle),
                None,
            )
            now = replace(now, velocity_limits={**now.velocity_limits, **found})
        mechanism.joints[joint.name] = now
    made = type(system)(mechanism, system.structure.topology, system.structure.table)
    for name in pairs:
        _check_limits(made, name, mechanism.joints[_find_joint(system, name)[0].name])
    for name in speeds:
        _check_speed(made, name, mechanism.joints[_find_joint(system, name)[0].name])
    return made


def _read_limits(system: Model, given: Any, what: str, width: int) -> dict[str, Any]:
    """Read limits by coordinate name, from a dict or an array for all coordinates.

    Errors: `InputError`.
    """
    if given is None:
        return {}
    found = read_mapping(given)
    if found is not None:
        return dict(found)
    array = read_reals(given, what, "a dict by coordinate name, or an array")
    shape = (system.nv, 2)[:width]
    if width == 1 and not array.ndim:
        array = np.broadcast_to(array, shape)
    if array.shape != shape:
        raise InputError(
            f"{what} have shape {array.shape}; they must be a dict by coordinate name, or {shape}"
        )
    before = system.structure.limits if width == 2 else system.structure.velocity_limits
    changed = (array != before).reshape(system.nv, width).any(axis=1)  # NaN, too
    return {
        system.structure.velocity_names[i]: tuple(array[i].tolist())
        if width == 2
        else array[i].item()
        for i in np.flatnonzero(changed)
    }


def _find_joint(system: Model, name: str) -> tuple[Joint, str]:
    """Find the joint of a velocity coordinate, and the coordinate's name within the joint.

    Errors: `UnknownNameError`.
    """
    bodies = system.mechanism.bodies
    for joint in system.structure.joints.values():
        for local in joint.type.list_velocity_names(system.dim, bodies[joint.child].particle):
            if name == (f"{joint.name}.{local}" if local else joint.name):
                follower = system.structure.couplings.get(name)
                if follower is not None and follower.source is None:
                    raise InputError(
                        f"coordinate {name!r} is held at {follower.offset:g}: it has no limits"
                    )
                return joint, local
    raise UnknownNameError("coordinate", name, system.structure.velocity_names, system.name)


def _find_leader(system: Model, name: str) -> tuple[int, float, float]:
    """Find index, multiplier and offset of the velocity coordinate that moves a coordinate."""
    follower = system.structure.couplings.get(name)
    if follower is None:
        return system.structure.velocity_names.index(name), 1.0, 0.0
    return (
        system.structure.velocity_names.index(follower.source),
        follower.multiplier,
        follower.offset,
    )


def _check_limits(made: Model, name: str, joint: Joint) -> None:
    """Refuse limits that a coordinate cannot have because a coupled coordinate moves with it."""
    i, m, offset = _find_leader(made, name)
    has = sorted((m * made.structure.limits[i] + offset).tolist())
    requested = joint.limits[_strip_joint_name(joint, name)]
    if not all(
        a == b or abs(a - b) <= HELD_TOLERANCE * (1.0 + abs(b))
        for a, b in zip(has, requested, strict=True)
    ):
        raise InputError(
            f"{name!r} cannot have the limits [{requested[0]:g}, {requested[1]:g}]: what moves "
            f"with it leaves [{has[0]:g}, {has[1]:g}]; give limits of {_format_coupled_names(made, name)}, too"
        )


def _check_speed(made: Model, name: str, joint: Joint) -> None:
    """Refuse a speed that a coordinate cannot have because a coupled coordinate moves with it."""
    i, m, _ = _find_leader(made, name)
    has = abs(m) * float(made.structure.velocity_limits[i])
    requested = joint.velocity_limits[_strip_joint_name(joint, name)]
    if not (has == requested or abs(has - requested) <= HELD_TOLERANCE * (1.0 + requested)):
        raise InputError(
            f"{name!r} cannot have the speed {requested:g}: what moves with it leaves {has:g}; "
            f"give that of {_format_coupled_names(made, name)}, too"
        )


def _strip_joint_name(joint: Joint, name: str) -> str:
    """Return the name of a coordinate without the name of its joint."""
    return name[len(joint.name) + 1 :]


def _format_coupled_names(system: Model, name: str) -> str:
    """Format the names of the coordinates that are coupled with a coordinate."""
    i = _find_leader(system, name)[0]
    moved = [
        system.structure.velocity_names[i],
        *(
            n
            for n, f in system.structure.couplings.items()
            if f.source == system.structure.velocity_names[i]
        ),
    ]
    return ", ".join(repr(n) for n in moved if n != name)
