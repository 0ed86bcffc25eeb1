"""Writes docs/joints.md from the table of joint types: `python docs/joints_page.py`. A test fails
where it is stale.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path

from kempe.joints import TYPES, JointType, P, make_joint_type

PITCH = 0.01
"""Value of an option that is a number, so that the table shows what it does."""
SHOWN = ("P(x) R(z) R(y)", "P(x) R(z)", "R(z) R(x) R(z)", "H(x, 0.01) P(y)", "P(z) S")
"""Products in words that the page shows."""

HEAD = """\
# The joint zoo

<!-- Written by docs/joints_page.py from kempe.joints.TYPES; do not edit. -->

A joint connects a frame F on its parent body to a frame M on its child body.

## Degrees of freedom

A body has 6 degrees of freedom (DoF) in space and 3 in the plane. A joint leaves some of them and takes the others
away: these are its constraints.

"""

COORDINATES = """
The last column is `forbids()`: axes of F. What a universal joint and a screw take away besides has no fixed axis.
In the plane a revolute joint turns about z and a prismatic joint slides along its `axis=(x, y)`.

## Coordinates

The joint's pose X_FM(q) is a product of *primitives*, from left to right: R(z) turns about axis z of the frame reached
so far, P(x) slides along its axis x. Most joints are combinations of revolute and prismatic ones: a universal joint is
two revolutes, a cylindrical joint a revolute and a prismatic one, a planar joint two prismatic and a revolute one, a
spherical joint three revolutes.

"""

PRODUCTS = """
## Products in words

A joint that has no name of its own is said as its product: R(x) turns about an axis, P(x) slides along it, H(x, 0.1) is
a screw with its pitch in metres a radian, S is a ball joint (a unit quaternion).
`mechanism.joint("J", "P(x) R(z) R(y)", a, b)` slides along x of F, then turns about z, then about the y that this turn
has moved; TOML has it as `type = "P(x) R(z) R(y)"`. Where a product has several factors about or along one axis, their
coordinates are numbered.

"""

NOTES = """
- A joint with one coordinate gives it its own name, `elbow`; one with several gives `wrist.rx`, `wrist.ry`.
- A rotation as a unit quaternion has four coordinates and three velocities: the angular velocity in the axes of M.
  With `angles=True` it is three turns about z, y and x: as many coordinates as degrees of freedom, at the price of a
  singularity at `ry` = ±90°.
- `pitch` is in metres a radian, along z; it may be negative.
- In the plane `free` has the coordinates `x`, `y`, `rz`, and `translation` has `x`, `y`.
- `limits` are given for each velocity coordinate; a quaternion has no limits.

## Particles

A particle is a body with a position only: 3 degrees of freedom in space, 2 in the plane. It takes the joints that do
not turn it, as their child.

"""


def page() -> str:
    """The page as Markdown."""
    counts = ("DoF", "constraints", "DoF in the plane", "constraints in the plane")
    freedoms = table(("type", "motion", *counts, "forbids"), map(freedom_row, first_examples()))
    head = ("type", "options", "primitives", "coordinates", "velocities")
    coordinates = table(head, map(coordinate_row, examples()))
    particles = table(
        ("type", *counts, "coordinates"),
        (particle_row(t()) for t in TYPES.values() if is_for_particles(t())),
    )
    products = table(("type", "DoF", "constraints", *head[2:]), map(product_row, SHOWN))
    return f"{HEAD}{freedoms}{COORDINATES}{coordinates}{NOTES}{particles}{PRODUCTS}{products}"


def examples() -> Iterator[JointType]:
    """Each type of the zoo, and once more with each option that can be switched on."""
    for kind in TYPES.values():
        yield kind(**{f.name: PITCH for f in fields(kind) if isinstance(f.default, float)})
        for f in fields(kind):
            if f.default is False:
                yield kind(**{f.name: True})


def first_examples() -> Iterator[JointType]:
    """Each type of the zoo once."""
    for kind in TYPES.values():
        yield next(k for k in examples() if isinstance(k, kind))


def is_for_particles(kind: JointType) -> bool:
    """Whether the child can be a particle."""
    return all(p.kind == P for p in kind.layout(3, True)[1])


def freedom_row(kind: JointType) -> list[str]:
    """What a joint type leaves to a body and takes away, in space and in the plane."""
    counts = [str(kind.dof()), str(kind.constraints()), *in_the_plane(kind, False)]
    return [
        f"`{kind.type_name}`",
        kind.summary,
        *counts,
        ", ".join(kind.forbids()) or "–",
    ]


def coordinate_row(kind: JointType) -> list[str]:
    """What a joint type is made of in space, and its coordinates."""
    options = ", ".join(f"`{name}={getattr(kind, name)}`" for name in kind.list_defaults())
    coordinates = names(kind.list_coordinate_names())
    velocities = names(kind.list_velocity_names())
    same = velocities == coordinates
    return [
        f"`{kind.type_name}`",
        options,
        kind.decomposition,
        coordinates,
        "the same" if same else velocities,
    ]


def product_row(words: str) -> list[str]:
    """What a product in words leaves and takes away in space, and its coordinates."""
    kind = make_joint_type(words)
    return [
        f"`{words}`",
        str(kind.dof()),
        str(kind.constraints()),
        *coordinate_row(kind)[2:],
    ]


def particle_row(kind: JointType) -> list[str]:
    """What a joint type does to a particle, in space and in the plane."""
    counts = [
        str(kind.dof(3, True)),
        str(kind.constraints(3, True)),
        *in_the_plane(kind, True),
    ]
    return [f"`{kind.type_name}`", *counts, names(kind.list_coordinate_names(3, True))]


def in_the_plane(kind: JointType, particle: bool) -> list[str]:
    """Degrees of freedom and constraints in the plane, or dashes where the joint does not exist
    there.
    """
    return (
        [str(kind.dof(2, particle)), str(kind.constraints(2, particle))]
        if kind.planar
        else ["–", "–"]
    )


def names(coordinates: tuple[str, ...]) -> str:
    """Names of coordinates as code."""
    return ", ".join(f"`{c}`" if c else "as the joint" for c in coordinates) or "none"


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    lines = [list(head), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    Path(__file__).with_name("joints.md").write_text(page(), encoding="utf-8")
