"""A system in a scene of viser: nodes for the links with what is drawn of them, ghosts, and one update for a frame."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kempe import spatial
from kempe.spatial import Array
from kempe.views.drawing import style
from kempe.views.drawing.solids import rgb
from kempe.views.viewer.mesh_files import meshes_of
from kempe.views.viewer.rigid_parts import RigidPart, RigidParts

if TYPE_CHECKING:
    from kempe.model.system import System

GHOST = 0.4
"""How much of a ghost is seen."""
PALE = (225, 228, 232)
"""Colour of the lines of the floor."""
ROOM = 1.5
"""Distance of the camera, in extents of the drawing."""


class Shape(NamedTuple):
    """What is drawn on a carrier: a mesh, and how much of it is seen, 1 where it is solid."""

    carrier: int
    mesh: Any
    opacity: float


class Drawn:
    """A system with its shapes, made once for all pages. `lost` says which meshes could not be shown."""

    def __init__(self, system: System, q: Array):
        self.system = system
        self.rigid = RigidParts(system, q)
        found, self.lost = meshes_of(system)
        self.shapes = tuple(self._shapes(found, q))

    def _shapes(self, found: dict[str, list[Any]], q: Array) -> list[Shape]:
        from kempe.views.drawing.scene import look

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
        bare = (p for p in self.rigid.parts if p.carrier not in covered)
        return out + [Shape(p.carrier, _mesh(p), float(p.colours[:, 3].min())) for p in bare]

    @cached_property
    def files(self) -> tuple[bytes, ...]:
        """The solid shapes as GLB, which colours each triangle."""
        return tuple(cast(bytes, s.mesh.export(file_type="glb")) for s in self.shapes)

    @cached_property
    def outlines(self) -> tuple[tuple[int, Any], ...]:
        """One mesh without colours for each carrier that moves, for ghosts."""
        import trimesh

        by: dict[int, list[Any]] = {}
        for shape in self.shapes:
            if shape.carrier and shape.opacity == 1.0:
                by.setdefault(shape.carrier, []).append(trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces,
                                                                        process=False))  # fmt: skip
        return tuple((k, trimesh.util.concatenate(meshes)) for k, meshes in by.items())

    def look_from(self, camera: Any) -> None:
        """Place a camera, or the one that pages begin with."""
        away = np.array([0.0, 0.0, 1.0]) if self.system.dim == 2 else np.array([0.6, -0.85, 0.4])
        camera.position = tuple(self.rigid.middle + ROOM * max(self.rigid.size, 1e-9) * away)
        camera.look_at = tuple(self.rigid.middle)


def _mesh(part: RigidPart) -> Any:
    """The triangles of a part as a mesh of trimesh."""
    import trimesh

    colours = np.round(255 * part.colours).astype(np.uint8)
    return trimesh.Trimesh(part.corners, part.triangles, face_colors=colours, process=False)


def poses_as(X: Array) -> tuple[Array, Array]:
    """Quaternions wxyz (..., 4) and positions (..., 3) of poses."""
    return spatial.matrix_to_quat_wxyz(X[..., :3, :3]), X[..., :3, 3]


class Nodes:
    """The nodes of a drawn system in one scene of viser."""

    def __init__(self, scene: Any, drawn: Drawn, q: Array):
        self.scene, self.drawn = scene, drawn
        self.frames: dict[int, Any] = {}
        self.ghosts: list[tuple[int, Any]] = []
        self.poses = drawn.rigid.poses(q)
        quats, places = poses_as(self.poses)
        for k in sorted({s.carrier for s in drawn.shapes}):
            self.frames[k] = scene.add_frame(f"/system/{k}", show_axes=False, wxyz=quats[k], position=places[k])
        for i, (shape, file) in enumerate(zip(drawn.shapes, drawn.files, strict=True)):
            name = f"/system/{shape.carrier}/{i}"
            if shape.opacity == 1.0:
                scene.add_glb(name, file)
                continue
            colour = tuple(int(x) for x in shape.mesh.visual.face_colors[0][:3])
            scene.add_mesh_simple(name, shape.mesh.vertices, shape.mesh.faces, color=colour, side="double",
                                  opacity=shape.opacity, cast_shadow=False, receive_shadow=False)  # fmt: skip
        if drawn.system.dim == 3:
            wide = 4.0 * drawn.rigid.size
            low = min(0.0, float(drawn.rigid.middle[2] - 0.5 * drawn.rigid.size)) if drawn.rigid.size else 0.0
            cell = 10.0 ** np.floor(np.log10(max(drawn.rigid.size, 1e-9)))
            scene.add_grid("/floor", wide, wide, cell_size=0.5 * cell, section_size=cell, position=(0.0, 0.0, low),
                           shadow_opacity=0.12, cell_color=PALE, section_color=PALE)  # fmt: skip

    def move(self, q: Array) -> None:
        """Put all links where a configuration has them."""
        X = self.drawn.rigid.poses(q)
        moved = np.abs(X - self.poses).max(axis=(-2, -1)) > 1e-12
        self.poses = X
        quats, places = poses_as(X)
        for k, frame in self.frames.items():
            if moved[k]:
                frame.wxyz, frame.position = quats[k], places[k]

    def haunt(self, solutions: Array, clicked: Any = None) -> None:
        """Show the other solutions (k, nq) as ghosts; `clicked` is called with the event of a click on one."""
        if not len(solutions) and not self.ghosts:
            return
        if not self.ghosts or len(self.ghosts[0][1].batched_positions) < len(solutions):
            self._add_ghosts(max(8, len(solutions)), clicked)
        room = len(self.ghosts[0][1].batched_positions)
        X = np.broadcast_to(np.eye(4), (room, len(self.drawn.rigid.heads) + len(self.drawn.rigid.rods), 4, 4)).copy()
        if len(solutions):
            X[: len(solutions)] = self.drawn.rigid.poses(solutions)
        quats, places = poses_as(X)
        scale = (np.arange(room) < len(solutions)).astype(np.float32)
        for k, node in self.ghosts:
            node.batched_wxyzs, node.batched_positions = quats[:, k], places[:, k]
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
                f"/ghosts/{k}", mesh.vertices, mesh.faces, np.tile([1.0, 0, 0, 0], (room, 1)), np.zeros((room, 3)),
                batched_scales=np.zeros(room, dtype=np.float32), batched_colors=colour, opacity=GHOST, lod="off",
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            if clicked is not None:
                node.on_click(clicked)
            self.ghosts.append((k, node))
