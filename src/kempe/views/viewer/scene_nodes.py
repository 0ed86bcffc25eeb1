"""A system in a scene of viser: nodes for the links with what is drawn of them, ghosts, and one
update for a frame.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kempe import spatial
from kempe.errors import MissingExtraError
from kempe.spatial import Array
from kempe.views.drawing import style
from kempe.views.drawing.scene import Scene, look
from kempe.views.drawing.solids import rgb
from kempe.views.viewer.mesh_files import meshes_of
from kempe.views.viewer.rigid_parts import RigidPart, RigidParts
from kempe.words import counted

try:
    import trimesh
except ImportError:
    raise MissingExtraError("trimesh", "view") from None

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.views.viewer.overlays import Overlay

SAID = 3
"""Meshes that could not be shown that are named in one sentence."""
GHOST = 0.4
SEEN = 0.25
"""How much is seen of a ghost, and of a surface that is laid over a system."""
ABOVE = 3.0
"""Height of lines above a planar drawing, in radii of a pin."""
PALE = (225, 228, 232)
"""Colour of the lines of the floor."""
OPENING = {2: np.deg2rad(12.0), 3: np.deg2rad(75.0)}
"""Angle of the camera: what is planar is seen nearly without perspective, so that its layers lie on
one another."""
SOME = 48
"""Configurations of a motion by which a camera is placed."""
ROOM = {2: 1.15, 3: 1.53}
"""Height of the picture where the camera looks at, in diagonals of the drawing, in the plane and in
space."""
UPWARDS = np.array([0.0, 0.0, 1.0])
ASIDE = np.array([0.6, -0.85, 0.4])
"""From where planar and spatial systems are looked at."""
NEAR = 0.01
FAR = 1000.0
"""How near to the camera and how far from it things are seen, in diagonals of the drawing."""
SOFT = np.cos(np.deg2rad(35.0))
"""Cosine of the angle up to which neighbouring triangles are shaded as one round surface."""


class Shape(NamedTuple):
    """What is drawn on a carrier: a mesh, and how much of it is seen, 1 where it is solid."""

    carrier: int
    mesh: Any
    opacity: float


class Drawn:
    """A system with its shapes, made once for all pages. `lost` says which meshes could not be
    shown.

    Cameras have all configurations of a motion `way` (n, nq) in sight, if there is one.
    """

    def __init__(self, system: System, q: Array, way: Array | None = None):
        self.system = system
        self.rigid = RigidParts(system, q)
        self.middle = self.rigid.middle
        self.size = self.rigid.size
        if way is not None:
            some = way[np.unique(np.linspace(0, len(way) - 1, SOME).round().astype(int))]
            self.middle, self.size = self.rigid.box(
                np.concatenate([q[None], some]), self.middle[None]
            )
        found, self.lost = meshes_of(system)
        self.shapes = tuple(self._shapes(found, q))

    def _shapes(self, found: dict[str, list[Any]], q: Array) -> list[Shape]:
        links = look(self.system, q).links
        out: list[Shape] = []
        covered: set[int] = set()
        for link in links:
            own = [(X, mesh) for body, X in link.bodies.items() for mesh in found.get(body, ())]
            head = np.linalg.inv(next(iter(link.bodies.values())))
            for X, mesh in own:
                placed = mesh.copy()
                placed.apply_transform(head @ X)
                out.append(Shape(link.number, placed, 1.0))
                covered.add(link.number)
        bare = (
            p for p in self.rigid.parts if not covered.intersection(self.rigid.links(p.carrier))
        )
        return out + [Shape(p.carrier, _mesh(p), float(p.colours[:, 3].min())) for p in bare]

    @property
    def lost_sentence(self) -> str:
        """Which meshes are not drawn, and why, in one sentence; '' where all are."""
        if not self.lost:
            return ""
        more = f"; and {len(self.lost) - SAID} more" if len(self.lost) > SAID else ""
        return f"{counted(len(self.lost), 'mesh')} not drawn: {'; '.join(self.lost[:SAID])}{more}"

    @cached_property
    def files(self) -> tuple[bytes, ...]:
        """The solid shapes as GLB, which colours each triangle."""
        return tuple(cast(bytes, s.mesh.export(file_type="glb")) for s in self.shapes)

    @cached_property
    def seen(self) -> tuple[Scene, Array]:
        """The scene that was drawn, and poses (carriers, 4, 4) of the ground seen from the carriers
        in it.
        """
        q = self.rigid.q
        return look(self.system, q), spatial.inverse(self.rigid.poses(q))

    @cached_property
    def outlines(self) -> tuple[tuple[int, Any], ...]:
        """One mesh without colours for each carrier that moves, for ghosts."""
        by: dict[int, list[Any]] = {}
        for shape in self.shapes:
            if shape.carrier and shape.opacity == 1.0:
                by.setdefault(shape.carrier, []).append(
                    trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
                )
        return tuple((k, trimesh.util.concatenate(meshes)) for k, meshes in by.items())

    @property
    def near(self) -> float:
        """The least distance [m] of the camera from what it sees."""
        return NEAR * max(self.rigid.size, 1e-9)

    def look_from(self, camera: Any, aspect: float = 1.0, below: float = 0.0) -> None:
        """Place a camera, or the one that pages begin with.

        `aspect` is the width of the picture by its height; of the latter the part `below` is
        covered.
        """
        flat = self.system.dim == 2
        away, upright = (UPWARDS, np.array([0.0, 1.0, 0.0])) if flat else (ASIDE, UPWARDS)
        opening = OPENING[self.system.dim]
        size = max(self.size, 1e-9)
        high = ROOM[self.system.dim] * size / min(max(aspect, 0.1), 1.0 - below)
        far = 0.5 * high / np.tan(0.5 * opening)
        up = upright - away * float(upright @ away) / float(away @ away)
        at = (
            self.middle - 0.5 * below * high * float(np.linalg.norm(away) / np.linalg.norm(up)) * up
        )
        camera.fov = opening
        camera.near = self.near
        camera.far = FAR * size
        camera.position = tuple(at + far * away)
        camera.look_at = tuple(at)


def _mesh(part: RigidPart) -> Any:
    """The triangles of a part as a mesh of trimesh."""
    corners = part.corners[part.triangles].reshape(-1, 3)
    triangles = np.arange(len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(
        corners,
        triangles,
        face_colors=_bytes(part.colours),
        vertex_normals=soft_normals(corners),
        process=False,
    )


def soft_normals(corners: Array) -> Array:
    """Unit normals (3 m, 3) at the corners (3 m, 3) of m triangles: means over those that meet
    there nearly flat.
    """
    a, b, c = corners.reshape(-1, 3, 3).transpose(1, 0, 2)
    own = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    unit = own / np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-300)
    near = 1e-7 * max(float(np.ptp(corners, axis=0).max()), 1e-300)
    place = np.unique(np.round(corners / near), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(place, kind="stable")
    out = own.copy()
    for step in range(1, int(np.bincount(place).max())):  # each corner with the one `step` after it
        i = order[:-step]
        k = order[step:]
        both = (place[i] == place[k]) & (np.sum(unit[i] * unit[k], axis=1) > SOFT)
        np.add.at(out, i[both], own[k[both]])
        np.add.at(out, k[both], own[i[both]])
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)


def _bytes(colours: Any) -> np.ndarray:
    """Colours from 0 to 1 as bytes."""
    return np.round(255 * np.asarray(colours)).astype(np.uint8)


def poses_as(X: Array) -> tuple[Array, Array]:
    """Quaternions wxyz (..., 4) and positions (..., 3) of poses."""
    return spatial.matrix_to_quat_wxyz(X[..., :3, :3]), X[..., :3, 3]


def _along(length: float) -> tuple[float, float, float]:
    """The scale of what is stretched along z."""
    return 1.0, 1.0, float(length)


class Nodes:
    """The nodes of a drawn system in one scene of viser."""

    def __init__(self, scene: Any, drawn: Drawn, q: Array):
        self.scene = scene
        self.drawn = drawn
        self.frames: dict[int, Any] = {}
        self.ghosts: list[tuple[int, Any]] = []
        self.labels = list[Any]()
        self.axes = list[Any]()
        self.laid = dict[str, list[Any]]()
        self.poses, self.lengths = drawn.rigid.places(q)
        self.stretched: dict[int, list[Any]] = {}
        quats, places = poses_as(self.poses)
        for k in sorted({s.carrier for s in drawn.shapes}):
            self.frames[k] = scene.add_frame(
                f"/system/{k}", show_axes=False, wxyz=quats[k], position=places[k]
            )
        for i, (shape, file) in enumerate(zip(drawn.shapes, drawn.files, strict=True)):
            name = f"/system/{shape.carrier}/{i}"
            scale = _along(self.lengths[shape.carrier])
            if shape.opacity == 1.0:
                node = scene.add_glb(name, file, scale=scale)
            else:
                colour = tuple(int(x) for x in shape.mesh.visual.face_colors[0][:3])
                node = scene.add_mesh_simple(
                    name,
                    shape.mesh.vertices,
                    shape.mesh.faces,
                    color=colour,
                    side="double",
                    scale=scale,
                    opacity=shape.opacity,
                    cast_shadow=False,
                    receive_shadow=False,
                )
            self.stretched.setdefault(shape.carrier, []).append(node)
        if drawn.system.dim == 3:
            wide = 4.0 * drawn.rigid.size
            low = (
                min(0.0, float(drawn.rigid.middle[2] - 0.5 * drawn.rigid.size))
                if drawn.rigid.size
                else 0.0
            )
            cell = 10.0 ** np.floor(np.log10(max(drawn.rigid.size, 1e-9)))
            scene.add_grid(
                "/floor",
                wide,
                wide,
                cell_size=0.5 * cell,
                section_size=cell,
                position=(0.0, 0.0, low),
                shadow_opacity=0.12,
                cell_color=PALE,
                section_color=PALE,
            )

    # ---- what is shown on request

    def name(self, shown: bool) -> None:
        """Write the names of joints, bodies and frames, or take them away."""
        for label in self.labels:
            label.remove()
        self.labels = []
        if not shown:
            return
        scene, X = self.drawn.seen
        at = [(joint.child, joint.centre, joint.name) for joint in scene.joints]
        at += [
            (link.number, scene.points(link).mean(axis=0), link.name)
            for link in scene.links[1:]
            if len(scene.points(link)) > 1
        ]
        at += [
            (link.number, Y[:3, 3], name) for link in scene.links for name, Y in link.frames.items()
        ]
        for k, (carrier, p, text) in enumerate(at):
            place = X[carrier, :3, :3] @ p + X[carrier, :3, 3]
            self.labels.append(
                self.scene.add_label(
                    f"/system/{carrier}/name/{k}",
                    text,
                    position=place,
                    font_screen_scale=0.8,
                    anchor="bottom-left",
                )
            )

    def mark(self, shown: bool) -> None:
        """Show the axes of all frames, or take them away."""
        for axes in self.axes:
            axes.remove()
        self.axes = []
        if not shown:
            return
        (scene, X) = self.drawn.seen
        r = self.drawn.rigid.r
        for link in scene.links:
            for k, Y in enumerate((link.bodies | link.frames).values()):
                quat, place = poses_as(X[link.number] @ Y)
                self.axes.append(
                    self.scene.add_frame(
                        f"/system/{link.number}/axes/{k}",
                        axes_length=style.MARK * r,
                        axes_radius=0.2 * r,
                        origin_radius=0.3 * r,
                        wxyz=quat,
                        position=place,
                    )
                )

    def lay(self, name: str, overlay: Overlay | None) -> None:
        """Show something laid over the system, in place of what had the same name."""
        for node in self.laid.pop(name, ()):
            node.remove()
        if overlay is None:
            return
        new = self.laid[name] = []
        flat = self.drawn.system.dim == 2
        above = np.array([0.0, 0.0, ABOVE * self.drawn.rigid.r if flat else 0.0], dtype=np.float32)
        scene = self.scene
        at = f"/over/{name}"
        still = {"cast_shadow": False, "receive_shadow": False}
        if len(overlay.lines):
            lines = overlay.lines.astype(np.float32) + above
            colour = _bytes(rgb(style.curve_colour(0)))
            new.append(
                scene.add_line_segments(
                    f"{at}/lines", lines, colour, thickness=2.5, thickness_units="screen"
                )
            )
        for k, (corners, triangles, colour) in enumerate(overlay.surfaces):
            new.append(
                scene.add_mesh_simple(
                    f"{at}/{k}",
                    corners - above,
                    triangles,
                    color=_bytes(rgb(colour)),
                    opacity=SEEN,
                    side="double",
                    **still,
                )
            )
        if len(overlay.points):
            ball = trimesh.creation.icosphere(1, 0.5)
            none = np.tile([1.0, 0.0, 0.0, 0.0], (len(overlay.points), 1))
            new.append(
                scene.add_batched_meshes_simple(
                    f"{at}/points",
                    ball.vertices,
                    ball.faces,
                    none,
                    overlay.points + above,
                    lod="off",
                    batched_scales=overlay.sizes.astype(np.float32),
                    batched_colors=_bytes(overlay.colours),
                    **still,
                )
            )

    # ---- configurations

    def move(self, q: Array) -> None:
        """Put all links where a configuration has them."""
        X, lengths = self.drawn.rigid.places(q)
        moved = np.abs(X - self.poses).max(axis=(-2, -1)) > 1e-12
        for k in np.flatnonzero(np.abs(lengths - self.lengths) > 1e-12):
            for node in self.stretched.get(int(k), ()):
                node.scale = _along(lengths[k])
        self.poses = X
        self.lengths = lengths
        quats, places = poses_as(X)
        for k, frame in self.frames.items():
            if moved[k]:
                frame.wxyz = quats[k]
                frame.position = places[k]

    def haunt(self, solutions: Array, clicked: Any = None) -> None:
        """Show the other solutions (k, nq) as ghosts; `clicked` is called with the event of a click
        on one.
        """
        if not len(solutions) and not self.ghosts:
            return
        if not self.ghosts or len(self.ghosts[0][1].batched_positions) < len(solutions):
            self._add_ghosts(max(8, len(solutions)), clicked)
        room = len(self.ghosts[0][1].batched_positions)
        X = np.broadcast_to(np.eye(4), (room, self.drawn.rigid.carriers, 4, 4)).copy()
        scales = np.zeros((room, self.drawn.rigid.carriers, 3), dtype=np.float32)
        if len(solutions):
            X[: len(solutions)], lengths = self.drawn.rigid.places(solutions)
            scales[: len(solutions)] = 1.0
            scales[: len(solutions), :, 2] = lengths
        quats, places = poses_as(X)
        for k, node in self.ghosts:
            scale = scales[:, k]
            node.batched_wxyzs = quats[:, k]
            node.batched_positions = places[:, k]
            if not np.array_equal(scale, node.batched_scales):
                node.batched_scales = scale
            node.visible = bool(len(solutions))

    def _add_ghosts(self, room: int, clicked: Any) -> None:
        for _, node in self.ghosts:
            node.remove()
        self.ghosts = []
        for k, mesh in self.drawn.outlines:
            colour = tuple(int(255 * x) for x in rgb(style.link_colour(k)))
            node = self.scene.add_batched_meshes_simple(
                f"/ghosts/{k}",
                mesh.vertices,
                mesh.faces,
                np.tile([1.0, 0, 0, 0], (room, 1)),
                np.zeros((room, 3)),
                batched_scales=np.zeros((room, 3), dtype=np.float32),
                batched_colors=colour,
                opacity=GHOST,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )
            if clicked is not None:
                node.on_click(clicked)
            self.ghosts.append((k, node))
