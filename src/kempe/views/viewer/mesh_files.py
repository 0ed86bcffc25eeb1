"""Meshes that a model names for its bodies, read where they exist inside the model's folders; others are left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.description.meshes import resolve_mesh
from kempe.description.urdf.xml import parse_xml
from kempe.errors import KempeError
from kempe.spatial import Array

if TYPE_CHECKING:
    from collections.abc import Iterator

    from kempe.description.urdf.xml import XmlElement
    from kempe.model.system import System

LARGEST = 200_000_000
"""Bytes of a mesh file, at most."""
LOST = (ImportError, ValueError, KeyError, IndexError, TypeError, AttributeError, NotImplementedError, OSError)
"""What readers of meshes raise for a file that they cannot read, or for a format that is not installed."""


def meshes_of(system: System) -> tuple[dict[str, list[Any]], list[str]]:
    """Meshes (trimesh) by body, in the body's frame, and a sentence for each that could not be shown."""
    mechanism = system.mechanism
    found: dict[str, list[Any]] = {}
    lost: list[str] = []
    for name, body in mechanism.bodies.items():
        for text in body.visuals:
            try:
                found.setdefault(name, []).extend(_of_visual(text, mechanism.roots))
            except (KempeError, *LOST) as error:
                lost.append(f"{name}: {error}")
    return {name: meshes for name, meshes in found.items() if meshes}, lost


def _of_visual(text: str, roots: tuple[str, ...]) -> Iterator[Any]:
    """The meshes of one <visual> element. Errors: `InputError`, and what readers raise."""
    import trimesh

    visual = parse_xml(text, "visual")
    X = _origin(next(iter(visual.of("origin")), None))
    for geometry in visual.of("geometry"):
        for mesh in geometry.of("mesh"):
            path = resolve_mesh(mesh.attributes.get("filename", ""), roots)
            if path.stat().st_size > LARGEST:
                raise ValueError(f"mesh {path.name}: it is larger than {LARGEST} bytes")
            made = trimesh.load_mesh(path, process=False)
            made.apply_scale(_numbers(mesh.attributes.get("scale"), 3, 1.0))
            yield _placed(made, X)
        for box in geometry.of("box"):
            yield _placed(trimesh.creation.box(_numbers(box.attributes.get("size"), 3)), X)
        for ball in geometry.of("sphere"):
            yield _placed(trimesh.creation.icosphere(2, _numbers(ball.attributes.get("radius"), 1)[0]), X)
        for tube in geometry.of("cylinder"):
            radius, length = (_numbers(tube.attributes.get(key), 1)[0] for key in ("radius", "length"))
            yield _placed(trimesh.creation.cylinder(radius, length, 24), X)


def _placed(mesh: Any, X: Array) -> Any:
    mesh.apply_transform(X)
    return mesh


def _origin(element: XmlElement | None) -> Array:
    X = np.eye(4)
    if element is not None:
        X[:3, 3] = _numbers(element.attributes.get("xyz"), 3, 0.0)
        X[:3, :3] = spatial.rpy_to_matrix(_numbers(element.attributes.get("rpy"), 3, 0.0))
    return X


def _numbers(text: str | None, n: int, default: float | None = None) -> Array:
    """The numbers (n,) in a text. Errors: ValueError."""
    if text is None and default is not None:
        return np.full(n, default)
    values = np.array([float(x) for x in (text or "").split()])
    if len(values) != n or not np.isfinite(values).all():
        raise ValueError(f"{text!r} are not {n} numbers")
    return values
