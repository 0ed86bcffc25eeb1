"""Composition of mechanisms: mount one on another, cut a chain out of one."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from kempe.description.constrain import renamed
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Coupling, Frame, Joint
from kempe.errors import DescriptionError, Fault, InputError, UnknownNameError, shown
from kempe.joints import Fixed
from kempe.values import evaluate


def attach(
    host: Mechanism,
    guest: Mechanism,
    to: Body | Frame | str | None,
    prefix: str,
    placement: Mapping[str, Any],
) -> None:
    """Copy `guest` into `host`, its ground fixed to the body or frame `to` (the ground where None)."""
    if guest.dim != host.dim:
        raise InputError(
            f"{guest.name!r} has dim {guest.dim}, {host.name!r} has dim {host.dim}; they must be "
            "equal"
        )
    if not isinstance(prefix, str):
        raise InputError(f"prefix is {shown(prefix)}; it must be text")
    _refuse_clashes(host, guest, prefix)
    trial = host.copy()
    name = str(to) if to is not None else host.ground.name
    if name in host.frames:
        if "at" in placement:
            raise InputError(
                "`at` cannot be given when mounting on a frame; mount on the body instead"
            )
        on = host.frames[name].body
        placement = {"at": host.frames[name].X_BF, **placement}
    elif name in host.bodies:
        on = name
    else:
        raise UnknownNameError("body or frame", name, [*host.bodies, *host.frames], host.name)
    for key, number in guest.parameters.items():
        if trial.parameters.setdefault(key, number) != number:
            raise InputError(
                f"parameter {key!r} is {trial.parameters[key]:g} here and {number:g} in "
                f"{guest.name!r}"
            )
    for body in guest.bodies.values():
        trial._add_body(replace(body, name=prefix + body.name))
    trial.joint(
        f"{prefix}{guest.ground.name}_mount", Fixed(), on, prefix + guest.ground.name, **placement
    )
    for joint in guest.joints.values():
        trial.joints[prefix + joint.name] = replace(
            joint,
            name=prefix + joint.name,
            parent=prefix + joint.parent,
            child=prefix + joint.child,
        )
    for frame in guest.frames.values():
        trial.frames[prefix + frame.name] = replace(
            frame, name=prefix + frame.name, body=prefix + frame.body
        )
    for coupling in guest.couplings.values():
        sources = {prefix + k: v for k, v in coupling.sources.items()}
        trial.couplings[prefix + coupling.of] = replace(
            coupling, of=prefix + coupling.of, sources=sources
        )
    for constraint in guest.constraints.values():
        bodies, frames = ({n: prefix + n for n in names} for names in (guest.bodies, guest.frames))
        trial.constraints[prefix + constraint.name] = renamed(constraint, bodies, frames, prefix)
    for key, posture in guest.postures.items():
        trial.postures[prefix + key] = {prefix + k: v for k, v in posture.items()}
    trial.locks |= {prefix + k: v for k, v in guest.locks.items()}
    trial.notes += guest.notes
    trial.roots = tuple(dict.fromkeys(host.roots + guest.roots))
    host.__dict__.update(trial.__dict__)


def _refuse_clashes(host: Mechanism, guest: Mechanism, prefix: str) -> None:
    """Refuse names of the guest that the host has, too; bodies and frames share names, joints and
    constraints do.
    """
    taken: list[str] = []
    for one, other in (("bodies", "frames"), ("joints", "constraints"), ("postures", "postures")):
        here = {**getattr(host, one), **getattr(host, other)}
        mount = [f"{guest.ground.name}_mount"] if one == "joints" else []
        there = dict.fromkeys([*getattr(guest, one), *getattr(guest, other), *mount])
        names = [prefix + name for name in there if prefix + name in here]
        if names:
            what = one if one == other else f"{one} and {other}"
            more = f", ... ({len(names)} in all)" if len(names) > 4 else ""
            taken.append(f"{what} {', '.join(map(repr, names[:4]))}{more}")
    if taken:
        better = f"{prefix}2_" if prefix else re.sub(r"\W", "_", guest.name) + "_"
        allowed = f"give its names a prefix: attach(..., prefix={better!r})"
        raise DescriptionError(
            Fault(
                f"both have {'; '.join(taken)}",
                f"attach {guest.name!r} to {host.name!r}",
                None,
                allowed,
            )
        )


def subchain(mechanism: Mechanism, base: str, tip: str) -> Mechanism:
    """The bodies and joints on the shortest path from body `base` to body or frame `tip`, as a
    mechanism.

    Frames on these bodies, constraints between them, couplings and locks among these joints come
    along; one that follows a free coordinate outside is refused, as the chain alone would move
    differently.
    Errors: `UnknownNameError`, `DescriptionError`.
    """
    if base not in mechanism.bodies:
        raise UnknownNameError("body", base, mechanism.bodies, mechanism.name)
    if tip not in mechanism.bodies and tip not in mechanism.frames:
        raise UnknownNameError(
            "body or frame", tip, [*mechanism.bodies, *mechanism.frames], mechanism.name
        )
    end = mechanism.frames[tip].body if tip in mechanism.frames else tip
    path = _path(mechanism, base, end)
    kept = {base, end} | {b for j in path for b in (j.parent, j.child)}
    out = Mechanism(f"{mechanism.name}: {base} to {tip}", mechanism.dim, ground=base)
    out.parameters = dict(mechanism.parameters)
    out.roots = mechanism.roots
    out.bodies = {
        n: mechanism.bodies[n]
        for n in [base, *(b for b in mechanism.bodies if b in kept and b != base)]
    }
    names = {j.name for j in path}
    out.joints = {n: j for n, j in mechanism.joints.items() if n in names}
    out.frames = {f.name: f for f in mechanism.frames.values() if f.body in kept}
    out.constraints = {
        n: c for n, c in mechanism.constraints.items() if {c.parent, c.child} <= kept
    }
    coordinates = {
        f"{j.name}.{c}" if c else j.name
        for j in path
        for c in j.type.coordinates(out.dim, mechanism.bodies[j.child].particle)
    }
    for coupling in mechanism.couplings.values():
        inside = [c in coordinates for c in (coupling.of, *coupling.sources)]
        if all(inside):
            out.couplings[coupling.of] = coupling
        elif inside[0]:
            _follow_inside(mechanism, out, coupling, coordinates)
    out.locks |= {k: v for k, v in mechanism.locks.items() if k in coordinates}
    for name, posture in mechanism.postures.items():
        out.postures[name] = {k: v for k, v in posture.items() if k in coordinates}
    return out


def _follow_inside(
    mechanism: Mechanism, out: Mechanism, coupling: Coupling, coordinates: set[str]
) -> None:
    """Keep a coupling that reaches outside the chain, where it does so only through locks and other
    couplings.
    """
    sources = dict(coupling.sources)
    offset = coupling.offset
    for _ in range(len(mechanism.couplings) + 1):
        outside = [c for c in sources if c not in coordinates]
        for name in outside:
            factor = sources[name]
            if name in mechanism.locks:
                offset = offset + factor * mechanism.locks[name]
            elif name in mechanism.couplings:
                via = mechanism.couplings[name]
                offset = offset + factor * via.offset
                for source, number in via.sources.items():
                    sources[source] = sources.get(source, 0.0) + factor * number
            else:
                problem = f"it follows {name}, outside the chain; lock that first"
                raise DescriptionError(
                    Fault(problem, f"coordinate {coupling.of!r}", coupling.where)
                )
            del sources[name]
    if sources:
        out.couplings[coupling.of] = replace(coupling, sources=sources, offset=offset)
    else:
        out.locks[coupling.of] = float(evaluate(offset, mechanism.parameters))


def _path(mechanism: Mechanism, base: str, end: str) -> list[Joint]:
    neighbours: dict[str, list[tuple[str, Joint]]] = {b: [] for b in mechanism.bodies}
    for joint in sorted(mechanism.joints.values(), key=lambda j: (j.cut, j.name)):
        neighbours[joint.parent].append((joint.child, joint))
        neighbours[joint.child].append((joint.parent, joint))
    came: dict[str, Joint | None] = {base: None}
    queue = deque([base])
    while queue and end not in came:
        here = queue.popleft()
        if mechanism.bodies[here].particle:
            continue  # nothing can hang on a particle
        for there, joint in neighbours[here]:
            if there not in came:
                came[there] = joint
                queue.append(there)
    if end not in came:
        raise DescriptionError(
            Fault(f"no joints lead from {base!r} to {end!r}", f"mechanism {mechanism.name!r}")
        )
    path: list[Joint] = []
    while (joint := came[end]) is not None:
        path.append(joint)
        end = joint.parent if joint.child == end else joint.child
    return path
