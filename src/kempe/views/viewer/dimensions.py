"""Dimensions of a mechanism on a page: their sliders, what is said of them, and the file to save."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.assemble.assemble import assemble
from kempe.description.toml_writer import write_toml
from kempe.equations.judge import judge_configurations
from kempe.model.configurations import make_q
from kempe.spaces.polygons import EQUAL, Polygon, find_polygon
from kempe.spatial import Array
from kempe.views.viewer.sliders import Slider

if TYPE_CHECKING:
    from kempe.model.model import Model

SHORTER = 10.0
LONGER = 2.0
"""Ends of the slider of a length: its first value divided by the one, and multiplied by the other."""


def make_dimension_slider(name: str, unit: str, first: float, value: float, size: float) -> Slider:
    """Make the slider of a parameter whose value was `first`; `size` [m] is that of the drawing."""
    if unit == "rad":
        low, high = (-np.pi, np.pi) if abs(first) <= np.pi else (first - np.pi, first + np.pi)
    elif first:
        low, high = sorted((first / SHORTER, first * LONGER))
    else:
        low, high = -0.5 * size, 0.5 * size
    return Slider(name, unit, min(low, value), max(high, value), value)


# ---- four-bars


def describe_four_bar(system: Model, q: Array, driver: str) -> str:
    """Describe a planar four-bar: its class by Grashof, and its transmission angle.

    The text is empty for other systems. `driver` is the joint that is moved.

    The class is that of Grashof (1883); the input is the bar between the ground and `driver`. The
    angle between coupler and output follows from the length of the diagonal between the pins of the
    input and the output, whose ends bound it (Alt, 1932).
    """
    polygon = find_polygon(system)
    if isinstance(polygon, str) or len(polygon.bodies) != 4:
        return ""
    ground = polygon.bodies.index(system.body_names[0])
    pins = [polygon.joints[ground - 1], polygon.joints[ground]]
    if driver not in pins:
        return f"{_name_class(polygon.lengths, None)}."
    step = 1 if driver == pins[1] else -1
    order = [(ground + step * k) % 4 for k in range(4)]
    d, a, b, c = polygon.lengths[order].tolist()
    at = [polygon.bodies[order[k]] for k in (2, 3)]
    now, least, most = compute_transmission_angles(system, q, (a, b, c, d), (at[0], at[1]), polygon)
    return (
        f"{_name_class(np.array([d, a, b, c]), 1)}. Transmission angle "
        f"{now:.1f}° here, {least:.1f}° to {most:.1f}° over the motion."
    )


def _name_class(lengths: Array, driver: int | None) -> str:
    """Name the class of a four-bar with bars (4,): ground, input, coupler, output.

    `driver` is None if the input is not known.
    """
    order = np.argsort(lengths, kind="stable")
    s, p, q, l = lengths[order].tolist()  # noqa: E741
    total = s + p + q + l
    if abs(s + l - p - q) <= EQUAL * total:
        return "Change-point four-bar (Grashof: shortest + longest = the other two)"
    if s + l > p + q:
        return "Triple-rocker (Grashof: shortest + longest > the other two)"
    why = "(Grashof: shortest + longest < the other two)"
    if driver is None:
        return f"Grashof four-bar {why}"
    kind = ("double-crank", "crank-rocker", "double-rocker", "rocker-crank")[int(order[0])]
    return f"{kind.capitalize()} {why}"


def compute_transmission_angles(
    system: Model,
    q: Array,
    lengths: tuple[float, float, float, float],
    bodies: tuple[str, str],
    polygon: Polygon,
) -> tuple[float, float, float]:
    """Compute the transmission angle at q (nq,), and its least and largest value [deg].

    `lengths` are those of input, coupler, output and ground; `bodies` are coupler and output.
    """
    from kempe.motion.transmission import compute_transmission_angle

    a, b, c, d = lengths
    joint = next(
        n
        for n in polygon.joints
        if set(bodies) == {system.structure.joints[n].parent, system.structure.joints[n].child}
    )
    now = float(compute_transmission_angle(system, q, joint))
    ends = np.array([max(abs(d - a), abs(b - c)), min(d + a, b + c)])
    angles = np.arccos(np.clip((b * b + c * c - ends**2) / (2.0 * b * c), -1.0, 1.0))
    least = float(np.minimum(angles, np.pi - angles).min())
    most = (
        0.5 * np.pi
        if angles[0] <= 0.5 * np.pi <= angles[1]
        else float(np.minimum(angles, np.pi - angles).max())
    )
    now, least, most = np.rad2deg([now, least, most]).tolist()
    return now, least, most


# ---- the file


def write_mechanism(system: Model) -> str:
    """Write a system as TOML, with postures that close its loops with its present dimensions.

    Postures that cannot be closed are left out.
    """
    mechanism = system.mechanism
    for name in tuple(mechanism.postures):
        q = make_q(system, name)
        if judge_configurations(system, q):
            continue
        answer = assemble(system, start=q)
        if answer:
            values = dict(zip(system.coordinate_names, answer.q.tolist(), strict=True))
            mechanism.postures[name] = values
        else:
            del mechanism.postures[name]
    return write_toml(mechanism)
