"""Implicit loop joints: what a joint holds of its frame M in its frame F, without coordinates.

It follows from the primitives alone, so nothing is to be declared. A joint whose hold has no fixed
axes in F, or whose coordinates cannot be read off one by one, has none: it is explicit (see
`kempe.model.packed_loops`), which is always right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kempe import spatial
from kempe.joints import JointType, P, Primitive, Q, R

TURNS = {
    "": ("xyz", ()),
    "z": ("xy", ("turn z",)),
    "xy": ("x.y", ("turn rx", "turn ry")),
    "zyx": ("", ("turn yaw", "turn pitch", "turn roll")),
    "ball": ("", ("quaternion",)),
}
"""For the axes of a joint's turns, in their order: the rotations that it holds, and how each turn
is read."""


class ImplicitForm(NamedTuple):
    """Equations of a joint on the pose of M in F, and how its coordinates follow from the pose.

    `position`: the axes along which M stays at the origin of F. `turns`: "xyz" all, "xy" z of M
    stays parallel to z of F, "x.y" y of M stays normal to x of F, "z" the angle in the plane, ""
    none. `readings`: for each independent primitive its coordinate within the joint and "x", "y",
    "z", "turn ..." or "quaternion".
    """

    position: str
    turns: str
    readings: tuple[tuple[int, str], ...]


def find_implicit_form(
    kind: JointType, dim: int = 3, particle: bool = False
) -> ImplicitForm | None:
    """Return the implicit form of a joint type, or None where it has none.

    In the plane, a slide along z is one along x of its frame.

    Such a form needs a coordinate of its own for each primitive, in its unit; slides along
    different axes before all turns (or along z, where it turns about z only); and turns about z,
    about x and y, about z, y and x, or a ball.
    """
    primitives = kind.layout(dim, particle)[1]
    slides = [p for p in primitives if p.kind == P]
    turns = [p for p in primitives if p.kind != P]
    about = (
        "ball"
        if [p.kind for p in turns] == [Q]
        else "".join("?" if p.kind == Q else p.axis for p in turns)
    )
    if (
        about not in TURNS
        or len({p.axis for p in slides}) < len(slides)
        or not has_own_coordinates(primitives)
    ):
        return None
    late = [
        p
        for k, p in enumerate(primitives)
        if p.kind == P and any(t in turns for t in primitives[:k])
    ]
    if any(about != "z" or p.axis != "z" for p in late):
        return None
    along = "".join(p.axis for p in slides)
    if dim == 2 and "z" in along:
        if len(primitives) > 1:
            return None
        along = "x"
    held, said = TURNS[about]
    readings = [(p.coordinate, axis) for p, axis in zip(slides, along, strict=True)]
    readings += [(p.coordinate, how) for p, how in zip(turns, said, strict=True)]
    if dim == 2:
        held = "z" if held == "xyz" else ""
    position = "".join(a for a in "xyz"[:dim] if a not in along)
    return ImplicitForm(position, "" if particle else held, tuple(sorted(readings)))


def has_own_coordinates(primitives: tuple[Primitive, ...]) -> bool:
    """Tell whether each primitive has a coordinate of its own, with multiplier 1."""
    return all(p.multiplier == 1.0 for p in primitives) and len(
        {p.coordinate for p in primitives}
    ) == len(primitives)


def has_slide_along_z(kind: JointType, dim: int, particle: bool) -> bool:
    """Tell whether a planar joint slides along z of its frame F, which then lies in the plane."""
    return dim == 2 and any(p.kind == P and p.axis == "z" for p in kind.layout(2, particle)[1])


def turn_flat_frame(X: np.ndarray) -> np.ndarray:
    """Turn a planar frame so that its z is the plane's normal and its x is what was z.

    The old z is a direction in the plane.
    """
    normal = X[2, :3]
    x = np.array([0.0, 0.0, 1.0])
    return X @ spatial.pose(np.stack([x, np.cross(normal, x), normal], axis=1))


def find_screw_pitch(kind: JointType) -> float | None:
    """Return the pitch of a screw joint about z, in metres a radian; None for other joints."""
    primitives = kind.layout()[1]
    turn, slide = sorted(primitives, key=lambda p: p.kind) if len(primitives) == 2 else (None, None)
    if turn is None or slide is None or (turn.kind, slide.kind) != (R, P) or turn.multiplier != 1.0:
        return None
    alike = turn.coordinate == slide.coordinate and turn.axis == slide.axis == "z"
    return slide.multiplier if alike else None
