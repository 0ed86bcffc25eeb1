"""Reading and writing of shapes in URDF: <visual> and <collision> elements, and materials."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from kempe.arrays import is_sequence
from kempe.description.parts import Shape
from kempe.description.shapes import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Geometry,
    Mesh,
    Sphere,
)
from kempe.description.source import Findings, shorten_text
from kempe.description.urdf_elements import read_numbers, read_origin
from kempe.description.xml import XmlElement
from kempe.errors import InputError
from kempe.poses import place
from kempe.words import format_count

Color = tuple[float, float, float, float]


@dataclass(frozen=True)
class Element:
    """Form of a kind of shape in URDF: for each size its attributes and their numbers of values.

    The number is 0 for text.
    """

    kind: type[Geometry]
    sizes: Mapping[str, Mapping[str, int]]
    optional: tuple[str, ...] = ()
    uniform: tuple[str, ...] = ()
    """Sizes of several numbers that one number may stand for."""
    standard: bool = True
    """Whether it is written, too."""


_TUBE = {"radius": {"radius": 1}, "length": {"length": 1}}
_RADII = {"radii": {"a": 1, "b": 1, "c": 1}}

ELEMENTS = {
    "box": Element(Box, {"size": {"size": 3}}),
    "sphere": Element(Sphere, {"radius": {"radius": 1}}),
    "cylinder": Element(Cylinder, _TUBE),
    "capsule": Element(Capsule, _TUBE),
    "mesh": Element(Mesh, {"path": {"filename": 0}, "scale": {"scale": 3}}, ("scale",), ("scale",)),
    "drake:capsule": Element(Capsule, _TUBE, standard=False),
    "drake:ellipsoid": Element(Ellipsoid, _RADII, standard=False),
}
"""The elements inside <geometry>; capsules are of URDF 1.1, and the last two of Drake."""

USES = {"visual": (True, False), "collision": (False, True)}
"""Elements of a link that hold shapes, with `visual` and `collision` of `Shape`."""

NEWER = (Capsule.kind,)
"""Kinds that are of URDF 1.1."""


_placed = lru_cache(4096)(place)
"""`place` of numbers; many shapes have the same ones."""

# ---- reading


def read_materials(outer: XmlElement, findings: Findings) -> dict[str, Color | None]:
    """Return the colours of a robot or visual by the names of their materials.

    Materials that the visuals of its links define count, too; textures are noted.
    """
    visuals = (
        visual for link in outer.find_children("link") for visual in link.find_children("visual")
    )
    inside = [element for visual in visuals for element in visual.find_children("material")]
    own = outer.find_children("material")
    out: dict[str, Color | None] = {}
    for elements, noted in ((own, findings), (inside, Findings())):  # a visual notes its own
        for element in elements:
            name = element.attributes.get("name", "")
            if name not in out and (element.children or elements is own):
                out[name] = _read_color(element, f"material {shorten_text(name)}", noted)
    textures = [
        texture for element in [*own, *inside] for texture in element.find_children("texture")
    ]
    for first in textures[:1]:
        said = f"{format_count(len(textures), 'texture')} not read: a shape has one colour"
        findings.add_note(said, "", first.location)
    return out


def read_shapes(
    link: XmlElement,
    name: str,
    materials: Mapping[str, Color | None],
    findings: Findings,
    quaternions: bool = True,
) -> tuple[Shape, ...]:
    """Return the shapes of a <link> called `name`; problems are recorded in `findings`."""
    found = (
        read_shape(element, f"link {name!r}", materials, findings, quaternions)
        for element in link.children
        if element.tag in USES
    )
    return tuple(shape for shape in found if shape is not None)


def read_shape(
    element: XmlElement,
    owner: str,
    materials: Mapping[str, Color | None],
    findings: Findings,
    quaternions: bool = True,
) -> Shape | None:
    """Return the shape of a <visual> or <collision>; None after recording why there is none.

    Sizes that are missing, negative or no numbers are problems. What has no size, such as a sphere
    of radius 0, and kinds of shapes that are not known, are left out with a note.
    """
    name = element.attributes.get("name", "")
    subject = format_subject(element, owner)
    before = len(findings.problems)
    given = read_origin(element, findings, subject, quaternions)
    geometry = _read_geometry(element, findings, subject)
    visual, collision = USES[element.tag]
    color = None
    for material in element.find_children("material")[:1] if visual else ():
        color = _find_color(material, subject, materials, findings)
    if geometry is None or len(findings.problems) > before:
        return None
    return Shape(geometry, _placed(**given), visual, collision, color, name, element.location)


def format_subject(element: XmlElement, owner: str) -> str:
    """Return a <visual> or <collision> in messages: "visual 'hand' of link 'arm'"."""
    name = element.attributes.get("name", "")
    return f"{element.tag}{f' {shorten_text(name)}' if name else ''} of {owner}"


def find_only_shape(
    element: XmlElement, known: Container[str], findings: Findings, subject: str
) -> XmlElement | None:
    """Return the element inside <geometry> whose kind is known; several are a problem.

    Readers differ in which of several elements they take.
    """
    found = [
        p for holder in element.find_children("geometry") for p in holder.children if p.tag in known
    ]
    if len(found) > 1:
        findings.add_problem(
            f"it has {len(found)} shapes",
            subject,
            found[1].location,
            f"write one <{element.tag}> for each shape",
        )
    return found[0] if len(found) == 1 else None


def _read_geometry(element: XmlElement, findings: Findings, subject: str) -> Geometry | None:
    """Return the geometry of a visual or collision; None where there is none that is read."""
    inside = [part for holder in element.find_children("geometry") for part in holder.children]
    for part in inside:
        if part.tag not in ELEMENTS:
            said = f"the shape <{part.tag}> is not read; URDF has {', '.join(_STANDARD)}"
            findings.add_note(said, subject, part.location)
    if not inside:
        findings.add_note(
            "it has no <geometry> with a shape, and is left out", subject, element.location
        )
    shape = find_only_shape(element, ELEMENTS, findings, subject)
    return None if shape is None else _make_geometry(shape, findings, subject)


def _make_geometry(element: XmlElement, findings: Findings, subject: str) -> Geometry | None:
    """Return the geometry of an element with its sizes; None after recording a problem."""
    row = ELEMENTS[element.tag]
    given: dict[str, Any] = {}
    for name, attributes in row.sizes.items():
        missing = [a for a in attributes if a not in element.attributes]
        if missing and name in row.optional:
            continue
        if missing:
            findings.add_problem(
                f"its <{element.tag}> has no {' and no '.join(missing)}",
                subject,
                element.location,
                f"it needs {', '.join(a for s in row.sizes.values() for a in s)}",
            )
            return None
        found: list[Any] = []
        for attribute, count in attributes.items():
            text = element.attributes[attribute]
            if name in row.uniform and len(text.split()) == 1:
                count = 1
                said = (
                    f"its {attribute} is one number, {shorten_text(text)}, taken for all directions"
                )
                findings.add_note(said, subject, element.locate_attribute(attribute))
            read = read_numbers(element, attribute, count, findings, subject) if count else (text,)
            if read is None:
                return None
            found += read
        if any(x == 0.0 for x in found):
            said = f"its {element.tag} has no extent ({' '.join(map(str, found))}), and is left out"
            findings.add_note(said, subject, element.location)
            return None
        given[name] = found[0] if len(found) == 1 else tuple(found)
    try:
        return row.kind(**given)
    except InputError as error:
        findings.add_problem(str(error), subject, element.location)
    return None


def _find_color(
    material: XmlElement, subject: str, materials: Mapping[str, Color | None], findings: Findings
) -> Color | None:
    """Return the colour of a <material> in a visual, by its name, else its own.

    The first definition of a name counts, as in ROS.
    """
    name = material.attributes.get("name", "")
    own = _read_color(material, subject, findings) if material.children else None
    if not name:
        return own
    if own is not None and own != materials.get(name, own):
        said = f"its material {shorten_text(name)} has another colour before, which is used, as ROS does it"
        findings.add_note(said, subject, material.location)
    elif name not in materials:
        said = f"its material {shorten_text(name)} is not defined{findings.suggest_name(name, materials)}"
        findings.add_note(said, subject, material.location)
    return materials.get(name)


def _read_color(material: XmlElement, subject: str, findings: Findings) -> Color | None:
    """Return red, green, blue and opacity of a <material>; None with a note for anything else."""
    for element in material.find_children("color")[:1]:
        wrong = Findings()
        text = element.attributes.setdefault("rgba", "")
        found = read_numbers(element, "rgba", 4, wrong, subject)
        if found is not None and all(0.0 <= x <= 1.0 for x in found):
            return found  # type: ignore[return-value]
        said = (
            f"its color is {shorten_text(text)}, which is not 4 numbers from 0 to 1; it is not used"
        )
        findings.add_note(said, subject, element.location)
    return None


# ---- writing

_STANDARD = {row.kind.kind: tag for tag, row in ELEMENTS.items() if row.standard}


def is_writable_shape(shape: Shape) -> bool:
    """Whether URDF has the kind of shape."""
    return shape.kind in _STANDARD


def format_shape(
    shape: Shape, origin: str, parameters: Mapping[str, float], quoted: Any
) -> Iterator[str]:
    """Iterate over the elements <visual> and <collision> of a shape.

    `origin` is the text of the element <origin>, and `quoted` gives the text of an attribute.

    Errors: `InputError` for sizes that are not above zero with these parameters.
    """
    tag = _STANDARD[shape.kind]
    geometry = shape.geometry.evaluate_sizes(parameters)
    said = ""
    for name, x in geometry.sizes.items():
        (attribute,) = ELEMENTS[tag].sizes[name]
        said += f" {attribute}={quoted(_format_attribute(x))}"
    named = f" name={quoted(shape.name)}" if shape.name else ""
    color = (
        f'<material name="rgba {_format_attribute(shape.color)}"><color rgba="{_format_attribute(shape.color)}"/>'
        if shape.color
        else ""
    )
    for use, flag in (("visual", shape.visual), ("collision", shape.collision)):
        material = f"{color}</material>" if color and use == "visual" else ""
        if flag:
            yield f"<{use}{named}>{origin}<geometry><{tag}{said}/></geometry>{material}</{use}>"


def _format_attribute(x: Any) -> str:
    """Return a text, a number or numbers in the form of an attribute."""
    if isinstance(x, str):
        return x
    return " ".join(map(repr, x)) if is_sequence(x) else repr(x)
