"""Conversion of a mechanism to another unit of length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Coupling, Declared, Frame, Joint, Shape
from kempe.description.shapes import Geometry
from kempe.errors import InputError
from kempe.joints import P, R, scale_pitch
from kempe.poses import Placement
from kempe.units import METRE, METRES, check_unit, scale_lengths
from kempe.values import Value


def convert_unit(mechanism: Mechanism, unit: str) -> Mechanism:
    """Return the mechanism in a unit of length; itself if it is in this unit already.

    Parameters keep their numbers: they may be angles or factors, and expressions of lengths are
    multiplied instead. So does the tolerance, which is also one of angles. Efforts stay in newtons
    and newton metres.
    Errors: `InputError` for a unit that does not exist, and for own joint types and Python
    functions that cannot be converted.
    """
    if mechanism.unit == check_unit(unit):
        return mechanism
    factor = METRES[mechanism.unit] / METRES[unit]
    slides = set(_iterate_slides(mechanism))
    out = mechanism.copy()
    out.unit = unit
    out.bodies = {n: _scale_body(b, factor) for n, b in out.bodies.items()}
    out.joints = {n: _scale_joint(j, factor) for n, j in out.joints.items()}
    out.frames = {n: _scale_frame(f, factor) for n, f in out.frames.items()}
    out.constraints = {n: _scale_constraint(c, factor, slides) for n, c in out.constraints.items()}
    out.couplings = {n: _scale_coupling(c, factor, slides) for n, c in out.couplings.items()}
    out.postures = {n: _scale_slides(x, factor, slides) for n, x in out.postures.items()}
    out.locks = _scale_slides(out.locks, factor, slides)
    return out


def convert_to_metres(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism in metres, as file formats and libraries of others are."""
    return convert_unit(mechanism, METRE)


def _iterate_slides(mechanism: Mechanism) -> Iterator[str]:
    """Iterate over the names of the coordinates that are lengths."""
    for joint in mechanism.joints.values():
        for name in _list_slides(joint):
            yield f"{joint.name}.{name}" if name else joint.name


def _list_slides(joint: Joint) -> set[str]:
    """Return the names of a joint's own coordinates that are lengths."""
    names, primitives = joint.type.layout(joint.dim, joint.of_particle)
    turning = {p.coordinate for p in primitives if p.kind == R}
    return {names[p.coordinate] for p in primitives if p.kind == P} - {names[i] for i in turning}


def _scale_placement(X: Placement, factor: Fraction) -> Placement:
    """Return a placement with its translations in another unit."""
    return Placement(
        tuple(
            (motion, scale_lengths(xs, factor) if motion in ("x", "y", "z") else xs)
            for motion, xs in X.steps
        )
    )


def _scale_body(body: Body, factor: Fraction) -> Body:
    """Return a body with its centre of mass and its shapes in another unit."""
    shapes = tuple(_scale_shape(shape, factor) for shape in body.shapes)
    return replace(body, center=scale_lengths(body.center, factor), shapes=shapes)


def _scale_shape(shape: Shape, factor: Fraction) -> Shape:
    """Return a shape in another unit; the numbers in the file of a mesh are scaled, too."""
    of: Geometry = shape.geometry
    sizes = {n: x if isinstance(x, str) else scale_lengths(x, factor) for n, x in of.sizes.items()}
    return replace(shape, geometry=replace(of, **sizes), X_BS=_scale_placement(shape.X_BS, factor))


def _scale_joint(joint: Joint, factor: Fraction) -> Joint:
    """Return a joint with its places, limits and speeds of slides in another unit."""
    slides = _list_slides(joint)
    try:
        made = scale_pitch(joint.type, factor)
    except InputError as error:
        raise InputError(f"joint {joint.name!r}: {error}") from None
    return replace(
        joint,
        type=made,
        X_PF=_scale_placement(joint.X_PF, factor),
        X_CM=_scale_placement(joint.X_CM, factor),
        limits=_scale_slides(joint.limits, factor, slides),
        velocity_limits=_scale_slides(joint.velocity_limits, factor, slides),
    )


def _scale_frame(frame: Frame, factor: Fraction) -> Frame:
    """Return a frame in another unit."""
    return replace(frame, X_BF=_scale_placement(frame.X_BF, factor))


def _scale_constraint(made: Declared, factor: Fraction, slides: set[str]) -> Declared:
    """Return a constraint in another unit. Errors: `InputError` with its name."""
    try:
        of = made.of.scale_lengths(factor, slides)
    except InputError as error:
        raise InputError(f"constraint {made.name!r}: {error}") from None
    return replace(
        made,
        of=of,
        X_PF=_scale_placement(made.X_PF, factor),
        X_CM=_scale_placement(made.X_CM, factor),
    )


def _scale_coupling(coupling: Coupling, factor: Fraction, slides: set[str]) -> Coupling:
    """Return a coupling whose slides, the follower and its sources, are in another unit."""
    of = factor if coupling.of in slides else Fraction(1)

    def scale_multiplier(source: str, x: Value) -> Value:
        """Return the multiplier of a source."""
        return scale_lengths(x, of / factor if source in slides else of)

    sources = {name: scale_multiplier(name, x) for name, x in coupling.sources.items()}
    return replace(coupling, sources=sources, offset=scale_lengths(coupling.offset, of))


def _scale_slides(values: Mapping[str, Any], factor: Fraction, slides: set[str]) -> dict[str, Any]:
    """Return numbers by coordinate, those of slides in another unit."""
    return {n: scale_lengths(x, factor) if n in slides else x for n, x in values.items()}
