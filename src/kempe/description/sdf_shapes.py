"""Reading of shapes in SDF: the elements <visual> and <collision>."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from kempe.description.parts import Shape
from kempe.description.sdf_elements import find_first_child, read_numbers, read_pose
from kempe.description.shapes import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Geometry,
    Mesh,
    Sphere,
)
from kempe.description.source import Findings, parse_numbers
from kempe.description.urdf_shapes import USES, find_only_shape, format_subject
from kempe.description.xml import XmlElement
from kempe.poses import Placement
from kempe.words import format_count

KINDS: dict[str, tuple[type[Geometry], Mapping[str, int]]] = {
    "box": (Box, {"size": 3}),
    "sphere": (Sphere, {"radius": 1}),
    "cylinder": (Cylinder, {"radius": 1, "length": 1}),
    "capsule": (Capsule, {"radius": 1, "length": 1}),
    "ellipsoid": (Ellipsoid, {"radii": 3}),
    "mesh": (Mesh, {"scale": 3}),
}
"""Elements inside <geometry> that are read, with their sizes and how many numbers each has."""


def read_shapes(
    link: XmlElement,
    owner: str,
    placed: Callable[[str, XmlElement], Placement | None],
    folder: str,
    findings: Findings,
) -> Iterator[Shape]:
    """Iterate over the shapes of a link; problems are recorded in `findings`.

    `placed` gives the placement on the link of a frame that a <pose> names, at an element; `folder`
    is the folder of the file, seen from the outermost file, before relative paths of meshes. What
    has no size is left out with a note, and so are shapes of other kinds.
    """
    for element in link.children:
        if element.tag not in USES:
            continue
        subject = format_subject(element, owner)
        before = len(findings.problems)
        X, relative, pose = read_pose(element, findings, subject)
        if relative and pose is not None:
            X = (placed(relative, pose) or Placement()) @ X
        geometry = _read_geometry(element, folder, findings, subject)
        if geometry is None or len(findings.problems) > before:
            continue
        visual, collision = USES[element.tag]
        color = _read_color(element) if visual else None
        name = element.attributes.get("name", "")
        yield Shape(geometry, X, visual, collision, color, name, element.location)


def _read_geometry(
    element: XmlElement, folder: str, findings: Findings, subject: str
) -> Geometry | None:
    """Return the geometry of a visual or collision; None where there is none that is read."""
    shape = find_only_shape(element, KINDS, findings, subject)
    if shape is None:
        return None
    kind, sizes = KINDS[shape.tag]
    given: dict[str, Any] = {}
    for tag, count in sizes.items():
        part = find_first_child(shape, tag)
        if part is not None:
            found = read_numbers(part, count, findings, subject)
            if found is None:
                return None
            given[tag] = found if count > 1 else found[0]
        elif kind is not Mesh:
            given[tag] = (
                1.0 if count == 1 else (1.0, 1.0, 1.0)
            )  # what SDF takes where it is left out
    if kind is Mesh:
        path = _make_mesh_path(shape, folder)
        if not path:
            findings.add_note("its mesh names no file, and is left out", subject, shape.location)
            return None
        given["path"] = path
    if any(0.0 in (x if isinstance(x, tuple) else (x,)) for x in given.values()):
        findings.add_note(
            f"its {shape.tag} has no extent, and is left out", subject, shape.location
        )
        return None
    with findings.record_errors(subject, shape.location):
        return kind(**given)
    return None


def _make_mesh_path(mesh: XmlElement, folder: str) -> str:
    """Return the path of a mesh: in a package, or relative to the outermost file."""
    uri = find_first_child(mesh, "uri")
    text = uri.content if uri is not None else ""
    scheme, colon, rest = text.partition("://")
    if colon and scheme in ("model", "package"):
        return f"package://{rest}"
    path = rest if colon and scheme == "file" else text
    relative = path and not colon and folder not in ("", ".") and not Path(path).is_absolute()
    return f"{folder}/{path}" if relative else path


def _read_color(visual: XmlElement) -> tuple[float, float, float, float] | None:
    """Return the colour of a visual: the ambient or the diffuse colour of its material."""
    for material in visual.find_children("material"):
        for tag in ("diffuse", "ambient"):
            part = find_first_child(material, tag)
            text = part.content if part is not None else ""
            for count in (4, 3):
                found = parse_numbers(text, count)
                if not isinstance(found, str) and all(0.0 <= x <= 1.0 for x in found):
                    return (*found, 1.0)[:4]  # type: ignore[return-value]
    return None


def collect_unread_shapes(link: XmlElement, seen: dict[str, list[XmlElement]]) -> None:
    """Collect the shapes of a link whose kinds are not read, by kind."""
    for element in link.children:
        for holder in element.find_children("geometry") if element.tag in USES else ():
            for part in holder.children:
                if part.tag not in KINDS and part.tag != "empty":
                    seen.setdefault(part.tag, []).append(part)


def note_unread_shapes(seen: Mapping[str, list[XmlElement]], findings: Findings) -> None:
    """Note the collected shapes, once for each kind."""
    for tag, elements in seen.items():
        said = f"{format_count(len(elements), f'shape <{tag}>')} not read: shapes are "
        findings.add_note(said + ", ".join(KINDS), "", elements[0].location)
