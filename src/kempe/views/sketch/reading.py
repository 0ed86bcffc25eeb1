"""A planar mechanism as a sketch: revolute joints are pins, bodies bars, blocks that slide pins on a line."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.assemble.assemble import assemble
from kempe.description.parts import Joint
from kempe.errors import InputError
from kempe.forward.fk import fk
from kempe.spatial import Array
from kempe.views.sketch.sketch import (
    GROUND,
    NAME,
    Point,
    Sketch,
    iterate_pin_names,
)
from kempe.words import join_words

if TYPE_CHECKING:
    from kempe.model.model import Model

CLOSED = "closed"
"""Posture in which a mechanism is drawn that has one of this name."""
SAME = 1e-7
"""Distance up to which joints stand at one place, in parts of the size of the mechanism."""


@dataclass
class _Pin:
    """Pin while a mechanism is read: its place, the parts that meet there, names that it may get."""

    at: Point
    parts: set[str]
    names: list[str] = field(default_factory=list[str])


@dataclass
class _Reading:
    """Mechanism that is drawn as it stands closed: poses of its bodies, and which are one `part`."""

    system: Model
    poses: dict[str, Array]
    part: dict[str, str]
    joints: list[Joint]

    def place_frame(self, body: str, X: Array) -> Array:
        """Return the pose in the ground of a frame of a body."""
        return self.poses.get(body, np.eye(4)) @ X

    def place_joint(self, joint: Joint) -> Point:
        """Return where the frame M of a joint stands."""
        X = joint.X_CM.evaluate_pose(self.system.mechanism.parameters)
        x, y = self.place_frame(joint.child, X)[:2, 3].tolist()
        return x, y

    def find_direction(self, joint: Joint) -> float:
        """Find the direction along which a joint slides [rad]."""
        X = joint.X_PF.evaluate_pose(self.system.mechanism.parameters)
        x, y = self.place_frame(joint.parent, X)[:2, 2].tolist()
        return math.atan2(y, x)

    def list_parts(self, joint: Joint) -> tuple[str, str]:
        """List the parts that a joint connects."""
        return self.part[joint.parent], self.part[joint.child]


def read_sketch(system: Model) -> tuple[Sketch, list[str]]:
    """Read the sketch of a planar mechanism as it stands closed, and list what a sketch does not keep.

    Errors: `InputError` where a part cannot be drawn with pins, bars and sliders, or the mechanism
    cannot be closed.
    """
    m = system.mechanism
    reading = _read_mechanism(system)
    pins = _list_pins(reading)
    blocks: dict[str, Joint] = {}
    lost = _list_lost_parts(reading)
    for joint in reading.joints:
        if joint.type.type_name == "prismatic":
            block, pin = _find_block(reading, joint, pins)
            blocks[block] = joint
            beside = [p for p in pins if block in p.parts and p is not pin]
            lost += [f"frame {name} beside its pin" for p in beside for name in p.names]
            pins = [p for p in pins if p not in beside]
    named = _name_pins(pins)
    sketch = Sketch(
        m.name,
        {name: pin.at for name, pin in named.items()},
        grounded=frozenset(name for name, pin in named.items() if GROUND in pin.parts),
        unit=m.unit,
    )
    bars = {GROUND: GROUND}
    for part in dict.fromkeys(reading.part.values()):
        if part == GROUND or part in blocks:
            continue
        ends = tuple(name for name, pin in named.items() if part in pin.parts)
        if len(ends) < 2:
            raise InputError(
                f"{part} of {system.name} cannot be drawn: a bar joins two pins, and this body has "
                f"{len(ends)}; a frame counts as a pin"
            )
        bars[part] = sketch.choose_bar_name(ends, part)
        sketch = replace(sketch, bars={**sketch.bars, bars[part]: ends})
    sketch.check_bars()
    for block, joint in blocks.items():
        pin = next(name for name, pin in named.items() if block in pin.parts)
        (carrier,) = {*reading.list_parts(joint)} - {block}
        sketch = sketch.slide_pin(pin, reading.find_direction(joint), bars[carrier])
    return _set_crank(sketch, reading, named, bars), lost


def _read_mechanism(system: Model) -> _Reading:
    """Read joints, poses and parts of a mechanism. Errors: `InputError` for what cannot be drawn."""
    m = system.mechanism
    if system.dim != 2:
        raise InputError(f"{system.name} moves in space; the drawing board is for the plane")
    related = {r.of for r in system.structure.relations} | {*system.structure.couplings}
    if others := [*m.constraints, *sorted(related)]:
        raise InputError(
            f"{join_words(others)} of {system.name} cannot be drawn: the drawing board has pins, bars and "
            "sliders, and no other constraints"
        )
    part = {body: body for body in (GROUND, *system.body_names)}
    for joint in m.joints.values():
        kind = joint.type.type_name
        if kind == "fixed":
            ends = part[joint.parent], part[joint.child]
            one = GROUND if GROUND in ends else ends[0]
            part = {body: one if p in ends else p for body, p in part.items()}
        elif kind not in ("revolute", "prismatic"):
            raise InputError(
                f"joint {joint.name!r} of {system.name} cannot be drawn: it is {kind}, and the drawing board "
                "has revolute joints (pins) and prismatic joints of pins (sliders)"
            )
    answer = assemble(system, start=CLOSED if CLOSED in m.postures else None)
    if not answer.success:
        raise InputError(f"{system.name} cannot be drawn: {answer.status}")
    poses = dict(zip(system.body_names, fk(system, answer.q), strict=True))
    joints = [j for j in m.joints.values() if j.type.type_name != "fixed"]
    return _Reading(system, poses, part, joints)


# ---- pins


def _list_pins(reading: _Reading) -> list[_Pin]:
    """List the pins: revolute joints and frames at one place that have bodies in common are one."""
    m = reading.system.mechanism
    found: list[_Pin] = []
    for joint in reading.joints:
        if joint.type.type_name == "revolute":
            parts = {*reading.list_parts(joint)}
            found.append(_Pin(reading.place_joint(joint), parts, [joint.name]))
    for frame in m.frames.values():
        X = reading.place_frame(frame.body, frame.X_BF.evaluate_pose(m.parameters))
        x, y = X[:2, 3].tolist()
        found.append(_Pin((x, y), {reading.part[frame.body]}, [frame.name]))
    places = np.array([pin.at for pin in found]).reshape(-1, 2)
    near = SAME * float(np.ptp(places, axis=0).max(initial=0.0))
    pins: list[_Pin] = []
    for pin in found:
        _add_pin(pins, pin, near)
    for pin in pins:
        pin.names.sort(key=lambda name: name not in m.frames)
    return pins


def _add_pin(pins: list[_Pin], pin: _Pin, near: float) -> None:
    """Add a pin, or join it with those at its place that have parts in common with it."""
    same = [p for p in pins if math.dist(p.at, pin.at) <= near and p.parts & pin.parts]
    for other in same:
        pins.remove(other)
        pin = _Pin(other.at, other.parts | pin.parts, other.names + pin.names)
    pins.append(pin)


def _find_block(reading: _Reading, joint: Joint, pins: list[_Pin]) -> tuple[str, _Pin]:
    """Find the part that a joint slides, as the block of a pin, and this pin.

    Errors: `InputError` where there is none.
    """
    carrier, part = reading.list_parts(joint)
    for block, other in ((part, carrier), (carrier, part)):
        joints = [j for j in reading.joints if block in reading.list_parts(j)]
        own = [p for p in pins if block in p.parts]
        met = [p for p in own if len(p.parts) > 1] or own
        line = other == GROUND or sum(other in p.parts for p in pins) > 1
        if (
            block != GROUND
            and line
            and len(met) == 1
            and not met[0].parts & {GROUND, other}
            and [j for j in joints if j.type.type_name == "prismatic"] == [joint]
        ):
            return block, met[0]
    raise InputError(
        f"joint {joint.name!r} of {reading.system.name} cannot be drawn: a slider is a pin on a line of "
        "the ground or of a bar with two pins, and no body of this joint is such a pin"
    )


def _name_pins(pins: list[_Pin]) -> dict[str, _Pin]:
    """Choose the names of pins: that of a frame or joint there, else a free letter."""
    named: dict[str, _Pin] = {}
    wanted = {name for pin in pins for name in pin.names}
    free = (name for name in iterate_pin_names() if name not in wanted)
    for pin in pins:
        own = (n for n in pin.names if NAME.fullmatch(n) and n not in named and n != GROUND)
        named[next(own, None) or next(free)] = pin
    return named


# ---- the crank, and what is not kept


def _set_crank(
    sketch: Sketch, reading: _Reading, named: dict[str, _Pin], bars: dict[str, str]
) -> Sketch:
    """Choose the crank: a joint of the ground, one with a motor if there is one, else the first."""
    for joint in sorted(reading.joints, key=lambda j: not j.actuated):
        parts = {*reading.list_parts(joint)}
        if GROUND not in parts:
            continue
        (moved,) = parts - {GROUND}
        pin = next(
            name
            for name, pin in named.items()
            if moved in pin.parts and (joint.name in pin.names or moved not in bars)
        )
        if moved in bars:
            return sketch.set_crank(pin, bars[moved])
        if joint.type.type_name == "prismatic":
            return sketch.set_crank(pin)
    return sketch


def _list_lost_parts(reading: _Reading) -> list[str]:
    """List what a sketch does not keep of a mechanism."""
    m = reading.system.mechanism
    limits = [j.name for j in reading.joints if np.isfinite([*j.limits.values()]).any()]
    lost = {
        "limits of": limits,
        "parameters": [*m.parameters],
        "postures": [name for name in m.postures if name != CLOSED],
        "shapes of": [name for name, body in m.bodies.items() if body.shapes],
    }
    return [f"{what} {join_words(names)}" for what, names in lost.items() if names]
