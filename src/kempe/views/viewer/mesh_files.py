"""Meshes that a model names for its bodies, read where they lie in the model's folders.

Files of meshes are not trusted: they are read in a process with limits, which hands back GLB.
"""

from __future__ import annotations

import importlib.util
import io
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.description.limited import last_words, run_limited
from kempe.description.packages import Folders
from kempe.description.parts import Shape
from kempe.description.shapes import Mesh
from kempe.errors import InputError, KempeError, requirement, shown
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import Model


# ---- meshes of bodies

# Archives and XML unpack to a thousand times their size, and readers raise and run out of memory in
# their own ways: hence the limits.

LARGEST = 200_000_000
"""Bytes of a mesh: of its file, of what an archive unpacks to, and of its triangles, at most."""
MOST = 500_000_000
"""Bytes of triangles of all meshes of a model, at most."""
MEMORY = 2 * 2**30
"""Bytes of memory that may be used to read one mesh."""
EACH = 20
ALL = 120.0
"""Seconds of processor time for one mesh, and seconds for all of a model, at most."""
FARTHEST = 1e9
"""Bound of the sizes, places and scales of shapes [m]: pages hold them with 32 bits."""
ROUND = 24
"""Sides of the polygon that is drawn for a circle."""
TEXTURE = 2048
"""Pixels of a texture along an edge; larger ones are made smaller."""
READERS = {
    ".dae": {"collada": "pycollada"},
    ".zae": {"collada": "pycollada"},
    ".3mf": {"lxml": "lxml", "networkx": "networkx"},
}
"""Modules that trimesh needs for some kinds of files, with the packages that have them."""
_WORKER = """
import io, os, zipfile
import numpy as np
import trimesh


class Refused(Exception):
    pass


def read(path):
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            size = sum(x.file_size for x in archive.infolist())
        if size > s["largest"]:
            raise Refused(f"it unpacks to {size} bytes; {s['largest']} are allowed")
    mesh = trimesh.load_mesh(path, process=False)
    if not len(mesh.faces):
        raise Refused("it has no triangles")
    if not np.isfinite(mesh.vertices).all():
        raise Refused("some of its points are not finite")
    material = getattr(mesh.visual, "material", None)
    for name in ("image", "baseColorTexture"):
        if getattr(material, name, None) is not None:
            getattr(material, name).thumbnail((s["texture"], s["texture"]))
    return mesh.export(file_type="glb")


for k in range(s["first"], len(s["paths"])):
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft, hard = int(used.ru_utime + used.ru_stime) + 1 + s["each"], resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))
    try:
        data, kind = read(s["paths"][k]), "glb"
        if len(data) > s["largest"]:
            raise Refused(f"its triangles take {len(data)} bytes; {s['largest']} are allowed")
    except MemoryError:
        data, kind = f"reading it takes more than {s['memory']} bytes of memory".encode(), "txt"
    except Refused as error:
        data, kind = str(error).encode(), "txt"
    except BaseException as error:
        text = " ".join(str(error).split())
        data, kind = f"it cannot be read ({type(error).__name__}: {text})"[:300].encode("utf-8", "replace"), "txt"
    part = os.path.join(s["folder"], "part")
    with open(part, "wb") as file:
        file.write(data)
    os.replace(part, os.path.join(s["folder"], f"{k}.{kind}"))
"""


class _File(NamedTuple):
    """A mesh of a file, scaled by (3,) and then placed by (4, 4), in a colour if it has none."""

    path: Path
    scale: Array
    X: Array
    color: tuple[float, ...] | None


def meshes_of(system: Model) -> tuple[dict[str, list[Any]], list[str]]:
    """Meshes (trimesh) by body, in the body's frame, and a sentence for each that could not be
    shown.
    """
    mechanism = system.mechanism
    folders = Folders(mechanism.roots)
    wanted: list[tuple[str, Any]] = []
    lost: list[str] = []
    for name, body in mechanism.bodies.items():
        for shape in drawn(body.shapes):
            try:
                wanted.append((name, _wanted(shape, mechanism, folders)))
            except KempeError as error:
                lost.append(f"{name}: {error}")
    read = read_meshes(one.path for _, one in wanted if isinstance(one, _File))
    found: dict[str, list[Any]] = {}
    total = 0
    for name, one in wanted:
        if not isinstance(one, _File):
            found.setdefault(name, []).append(one)
            continue
        mesh = read[one.path]
        if not isinstance(mesh, str):
            total += mesh.vertices.nbytes + mesh.faces.nbytes
            if total > MOST:
                mesh = f"the meshes of this model together have more than {MOST} bytes of triangles"
        if isinstance(mesh, str):
            lost.append(f"{name}: mesh {one.path.name}: {mesh}")
            continue
        made = mesh.copy()
        made.apply_scale(one.scale)
        found.setdefault(name, []).append(_placed(made, one.X, one.color))
    return found, lost


def drawn(shapes: Iterable[Shape]) -> list[Shape]:
    """The shapes of a body that are drawn: what is seen of it, else what it collides with."""
    given = list(shapes)
    return [s for s in given if s.visual] or given


def _wanted(shape: Shape, mechanism: Mechanism, folders: Folders) -> Any:
    """The mesh of a shape, or the file that holds it. Errors: `KempeError`."""
    geometry = shape.geometry.evaluate(mechanism.parameters)
    X = shape.X_BS.evaluate(mechanism.parameters)
    _refuse_far(geometry, X)
    if isinstance(geometry, Mesh):
        path = folders.find(geometry.path)
        return _File(path, np.array(geometry.scale), X, shape.color)
    if shape.kind not in PRIMITIVES:
        raise InputError(f"shapes of kind {shape.kind!r} are not drawn")
    return _placed(PRIMITIVES[shape.kind](geometry), X, shape.color)


def _creation(name: str, *sizes: Any) -> Any:
    """A mesh of `trimesh.creation`."""
    import trimesh

    return getattr(trimesh.creation, name)(*sizes)


PRIMITIVES: dict[str, Callable[[Any], Any]] = {
    "sphere": lambda s: _creation("icosphere", 2, s.radius),
    "box": lambda s: _creation("box", s.size),
    "cylinder": lambda s: _creation("cylinder", s.radius, s.length, ROUND),
    "capsule": lambda s: _creation("capsule", s.length, s.radius, (ROUND, ROUND)),
    "ellipsoid": lambda s: _creation("icosphere", 2, 1.0).apply_scale(s.radii),
}
"""The mesh of a shape with numbers for sizes, by its kind; files are read apart."""


def _refuse_far(geometry: Any, X: Array) -> None:
    """Refuse sizes, scales and places that a page cannot hold. Errors: `InputError`."""
    given: dict[str, Any] = {"place": X[:3, 3], **geometry.sizes}
    for name, x in given.items():
        if not isinstance(x, str) and not (np.abs(x) < FARTHEST).all():
            raise InputError(
                f"the {name} of its {geometry.kind} is {shown(x)}; it must be below {FARTHEST:g} in "
                "size"
            )


def _placed(mesh: Any, X: Array, color: tuple[float, ...] | None) -> Any:
    """The mesh, placed; in the colour where it has none of its own."""
    mesh.apply_transform(X)
    if color is not None and not mesh.visual.defined:
        mesh.visual.vertex_colors = np.round(255.0 * np.array(color)).astype(np.uint8)
    return mesh


# ---- reading in a process of its own


def read_meshes(paths: Iterable[Path]) -> dict[Path, Any]:
    """The mesh (trimesh) of each file, or the reason why it could not be read, as text.

    Where a file ends the process, the next one reads those that are left.
    """
    found: dict[Path, Any] = {}
    for path in paths:
        if path not in found:
            found[path] = _refused(path)
    left = [path for path, said in found.items() if not said]
    first = 0
    end = time.monotonic() + ALL
    with tempfile.TemporaryDirectory() as folder:
        while first < len(left):
            seconds = end - time.monotonic()
            if seconds <= 0.0:
                found.update(
                    (path, f"the meshes of this model take more than {ALL:g} s")
                    for path in left[first:]
                )
                break
            settings = {
                "paths": list(map(str, left)),
                "first": first,
                "folder": folder,
                "largest": LARGEST,
                "each": EACH,
                "memory": MEMORY,
                "texture": TEXTURE,
            }
            ended = run_limited(
                _WORKER, settings, seconds=seconds, cpu=ALL, memory=MEMORY, output=LARGEST
            )
            while first < len(left) and (said := _handed_back(Path(folder), first)) is not None:
                found[left[first]] = said
                first += 1
            if first < len(left):
                found[left[first]] = {
                    "time": f"reading it takes more than {EACH} s",
                    "memory": f"reading it takes more than {MEMORY} bytes of memory",
                    "output": f"its triangles take more than {LARGEST} bytes",
                }.get(ended.reason, f"reading it ended the process: {last_words(ended.said)}")
                first += 1
    return found


def _refused(path: Path) -> str:
    """Why a file is not even opened; '' where it is."""
    if path.stat().st_size > LARGEST:
        return f"the file has more than {LARGEST} bytes"
    missing = [
        package
        for module, package in READERS.get(path.suffix.lower(), {}).items()
        if importlib.util.find_spec(module) is None
    ]
    if missing:
        return (
            f"{path.suffix} files need: pip install "
            f"{' '.join(repr(requirement(p, 'view')) for p in missing)}"
        )
    return ""


def _handed_back(folder: Path, k: int) -> Any:
    """The mesh of file `k`, or the text about it; None where the process wrote neither."""
    import trimesh

    if (said := folder / f"{k}.txt").exists():
        return said.read_text(encoding="utf-8", errors="replace")
    if not (made := folder / f"{k}.glb").exists():
        return None
    mesh = trimesh.load_mesh(io.BytesIO(made.read_bytes()), file_type="glb", process=False)
    made.unlink()
    return mesh
