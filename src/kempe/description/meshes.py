"""Meshes that a model names for its bodies, read where they lie in the model's folders.

Files of meshes are not trusted: they are read in a process with limits, which hands back triangles
and GLB. That process makes the simple shapes, too, so that only it needs trimesh, which takes long
to import.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.description.limited import extract_last_lines, run_limited_code
from kempe.description.packages import Folders
from kempe.description.parts import Shape
from kempe.description.shapes import Mesh
from kempe.errors import InputError, KempeError, format_value, requirement
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism


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

sys.modules["scipy"] = None  # few files need it, and trimesh is imported in a third of the time
import trimesh


class Refused(Exception):
    pass


def from_file(path):
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
    return mesh


def import_scipy():
    global trimesh
    for name in [x for x in sys.modules if x.partition(".")[0] in ("scipy", "trimesh")]:
        del sys.modules[name]
    import trimesh


def read(source, color):
    if isinstance(source, str):
        mesh = from_file(source)
    else:
        name, *sizes = source
        mesh = getattr(trimesh.creation, name)(*sizes)
    if color is not None and not mesh.visual.defined:
        mesh.visual.vertex_colors = np.round(255.0 * np.array(color)).astype(np.uint8)
    each = mesh.visual.vertex_colors if mesh.visual.defined and mesh.visual.kind != "texture" else []
    out = io.BytesIO()
    np.savez(
        out,
        glb=np.frombuffer(mesh.export(file_type="glb"), np.uint8),
        corners=np.asarray(mesh.vertices, np.float32),
        triangles=np.asarray(mesh.faces, np.uint32),
        color=each[0] if len(each) and (each == each[0]).all() else np.zeros(0, np.uint8),
    )
    return out.getvalue()


for k in range(s["first"], len(s["wanted"])):
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft, hard = int(used.ru_utime + used.ru_stime) + 1 + s["each"], resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (soft if hard == resource.RLIM_INFINITY else min(soft, hard), hard))
    try:
        try:
            data = read(*s["wanted"][k])
        except ImportError:
            import_scipy()
            data = read(*s["wanted"][k])
        kind = "npz"
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


Source = tuple[Any, tuple[float, ...] | None]
"""What the other process makes a mesh of: the path of a file, or the name of a function in
trimesh's module `creation` with its arguments; and the colour of what has none."""


class Triangles(NamedTuple):
    """Triangles (m, 3) over corners (n, 3), the same as GLB, and their colour (4,) of bytes if they
    have one only.
    """

    glb: bytes
    corners: Array
    triangles: np.ndarray
    color: tuple[int, ...] | None


class PlacedMesh(NamedTuple):
    """Triangles that are scaled by (3,) and then placed by (4, 4) in the frame of a body or link."""

    drawn: Triangles
    scale: Array
    X: Array

    @property
    def opacity(self) -> float:
        """Opacity from 0 to 1 of a mesh of one colour; 1 of a mesh of several colours."""
        return 1.0 if self.drawn.color is None else self.drawn.color[3] / 255.0

    @property
    def corners(self) -> Array:
        """The corners (n, 3) in the frame of the body or link [m]."""
        return self.scale * self.drawn.corners @ self.X[:3, :3].T + self.X[:3, 3]

    @property
    def triangles(self) -> np.ndarray:
        """Numbers (m, 3) of the corners of each triangle, counterclockwise as seen from outside."""
        return self.drawn.triangles[:, :: -1 if np.prod(self.scale) < 0.0 else 1]


def read_body_meshes(
    mechanism: Mechanism,
    meanwhile: Callable[[], object] | None = None,
    known: dict[Source, Triangles | str] | None = None,
) -> tuple[dict[str, list[PlacedMesh]], list[str]]:
    """Read the meshes of each body by its name, and a sentence for each mesh that cannot be shown.

    `meanwhile` is called while they are read, if there are any. What is `known` is not read again;
    what is read becomes known.
    """
    folders = Folders(mechanism.roots)
    wanted: list[tuple[str, Source, Array, Array]] = []
    lost: list[str] = []
    for name, body in mechanism.bodies.items():
        for shape in list_drawn_shapes(body.shapes):
            try:
                wanted.append((name, *_find_source(shape, mechanism, folders)))
            except KempeError as error:
                lost.append(f"{name}: {error}")
    read = {} if known is None else known
    read |= read_meshes((source for _, source, *_ in wanted if source not in read), meanwhile)
    meshes: dict[str, list[PlacedMesh]] = {}
    total = 0
    for name, source, scale, X in wanted:
        mesh = read[source]
        if not isinstance(mesh, str):
            total += mesh.corners.nbytes + mesh.triangles.nbytes
            if total > MOST:
                mesh = f"the meshes of this model together have more than {MOST} bytes of triangles"
        if isinstance(mesh, str):
            what = f"mesh {source[0].name}" if isinstance(source[0], Path) else source[0][0]
            lost.append(f"{name}: {what}: {mesh}")
        else:
            meshes.setdefault(name, []).append(PlacedMesh(mesh, scale, X))
    return meshes, lost


def list_drawn_shapes(shapes: Iterable[Shape]) -> list[Shape]:
    """List the shapes of a body that are drawn: its visual shapes, else its collision shapes."""
    given = list(shapes)
    return [s for s in given if s.visual] or given


def _find_source(
    shape: Shape, mechanism: Mechanism, folders: Folders
) -> tuple[Source, Array, Array]:
    """Find the source of a shape, its scale (3,) and its place (4, 4). Errors: `KempeError`."""
    geometry = shape.geometry.evaluate_sizes(mechanism.parameters)
    X = shape.X_BS.evaluate_pose(mechanism.parameters)
    _refuse_large_sizes(geometry, X)
    if isinstance(geometry, Mesh):
        return (folders.find_file(geometry.path), shape.color), np.array(geometry.scale), X
    if shape.kind not in PRIMITIVES:
        raise InputError(f"shapes of kind {shape.kind!r} are not drawn")
    call, scale = PRIMITIVES[shape.kind](geometry)
    return (call, shape.color), np.array(scale), X


UNSCALED = (1.0, 1.0, 1.0)
PRIMITIVES: dict[str, Callable[[Any], tuple[tuple[Any, ...], tuple[float, ...]]]] = {
    "sphere": lambda s: (("icosphere", 2, s.radius), UNSCALED),
    "box": lambda s: (("box", tuple(s.size)), UNSCALED),
    "cylinder": lambda s: (("cylinder", s.radius, s.length, ROUND), UNSCALED),
    "capsule": lambda s: (("capsule", s.length, s.radius, (ROUND, ROUND)), UNSCALED),
    "ellipsoid": lambda s: (("icosphere", 2, 1.0), s.radii),
}
"""By the kind of a shape: the function of trimesh that makes its mesh, with arguments, and the scale
of the mesh. Files are read apart."""


def _refuse_large_sizes(geometry: Any, X: Array) -> None:
    """Refuse sizes, scales and places that a page cannot represent. Errors: `InputError`."""
    given: dict[str, Any] = {"place": X[:3, 3], **geometry.sizes}
    for name, x in given.items():
        if not isinstance(x, str) and not (np.abs(x) < FARTHEST).all():
            raise InputError(
                f"the {name} of its {geometry.kind} is {format_value(x)}; it must be below "
                f"{FARTHEST:g} in size"
            )


# ---- reading in a process of its own


def read_meshes(
    sources: Iterable[Source], meanwhile: Callable[[], object] | None = None
) -> dict[Source, Triangles | str]:
    """Read mesh files (trimesh); a file that cannot be read gives the reason as text instead.

    Where a file ends the process, the next one reads those that are left.
    """
    meshes: dict[Source, Triangles | str] = {}
    for source in sources:
        if source not in meshes:
            meshes[source] = _explain_unread_file(source[0]) if isinstance(source[0], Path) else ""
    left = [source for source, reason in meshes.items() if not reason]
    first = 0
    end = time.monotonic() + ALL
    with tempfile.TemporaryDirectory() as folder:
        while first < len(left):
            seconds = end - time.monotonic()
            if seconds <= 0.0:
                meshes.update(
                    (source, f"the meshes of this model take more than {ALL:g} s")
                    for source in left[first:]
                )
                break
            settings = {
                "wanted": [(str(x) if isinstance(x, Path) else x, color) for x, color in left],
                "first": first,
                "folder": folder,
                "largest": LARGEST,
                "each": EACH,
                "memory": MEMORY,
                "texture": TEXTURE,
            }
            ended = run_limited_code(
                _WORKER,
                settings,
                seconds=seconds,
                cpu=ALL,
                memory=MEMORY,
                output=LARGEST,
                meanwhile=meanwhile if first == 0 else None,
            )
            while first < len(left) and (made := _load_result(Path(folder), first)) is not None:
                meshes[left[first]] = made
                first += 1
            if first < len(left):
                meshes[left[first]] = {
                    "time": f"reading it takes more than {EACH} s",
                    "memory": f"reading it takes more than {MEMORY} bytes of memory",
                    "output": f"its triangles take more than {LARGEST} bytes",
                }.get(
                    ended.reason, f"reading it ended the process: {extract_last_lines(ended.said)}"
                )
                first += 1
    return meshes


def _explain_unread_file(path: Path) -> str:
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


def _load_result(folder: Path, k: int) -> Triangles | str | None:
    """Load the triangles of source `k`, or the text about it; None where the process wrote neither."""
    if (reason := folder / f"{k}.txt").exists():
        return reason.read_text(encoding="utf-8", errors="replace")
    if not (made := folder / f"{k}.npz").exists():
        return None
    with np.load(made) as data:
        color = tuple(data["color"].tolist()) or None
        mesh = Triangles(data["glb"].tobytes(), data["corners"], data["triangles"], color)
    made.unlink()
    return mesh
