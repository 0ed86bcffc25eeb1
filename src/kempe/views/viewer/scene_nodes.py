"""A system in a scene of viser: nodes for links and ghosts, and one update for a frame.

The pictures are cut into parts that move as one, so that an update is a few poses.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.description.meshes import PlacedMesh, Triangles, read_body_meshes
from kempe.errors import MissingExtraError
from kempe.forward.fk import fk
from kempe.model.configurations import integrate_velocity
from kempe.spatial import Array
from kempe.views.drawing import style, symbols
from kempe.views.drawing.scene import Scene, SeenJoint, build_scene, separate_bearings
from kempe.views.drawing.solids import DrawnPiece, SolidRecord, make_fan, parse_colour
from kempe.views.viewer.first_sight import fit_camera
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model
    from kempe.views.viewer.overlays import Overlay


# ---- parts that move as one

# Triangles with colours, each on the link that carries it. The pictures of `kempe.views.drawing`
# are recorded at two configurations. What moved with a link between the two is carried by that
# link, and rods by their two ends. What reaches from one half of a sliding joint to the other is
# carried by both, and is as long as the joint. So a new configuration is a few poses and lengths,
# and no drawing.

NEAR_PART = 1e-6
"""How far a corner may be from where a link brings it, as a part of the drawing."""
APART = 0.03
"""Radians and characteristic lengths between the two configurations."""
SOLID = 1.4
"""Radius of a hinge in space, in those of a picture: a page is looked at from nearer."""
LEAST = 1e-9
"""Least length [m] of a part that is stretched; it is negative where the joint slides backwards."""
SLIDING = ("prismatic", "cylindrical", "helical")
"""Joints that slide along z of their frame."""
OWN = ("cylinder", "neck", "rail", "rod", "line", "slot", "ground", "hatch")
"""Beginnings of names of what moves with no link, and stays with the first of its two."""


@dataclass(frozen=True)
class RigidPart:
    """Triangles (m, 3) over corners (n, 3) in the frame of carrier `carrier`, a colour (m, 4) each."""

    carrier: int
    corners: Array
    triangles: np.ndarray
    colours: Array


class Slide(NamedTuple):
    """A carrier between the frame A on a link and the origin of the frame B on another, which
    slides along z of A.

    `a` and `b` are numbers of bodies with poses (4, 4) on them, `links` the two links. With `part`
    None it reaches from A to B and `beyond` [m] both, and its parts are 1 long; else it sits at
    this part of the way from A to B. It turns with A.
    """

    name: str
    links: tuple[int, int]
    a: tuple[int, Array]
    b: tuple[int, Array]
    part: float | None = None
    beyond: float = 0.0

    def compute_pose(self, every: Array) -> tuple[Array, Array]:
        """Compute the pose (..., 4, 4) and length (...) [m] of the carrier from all bodies' poses."""
        A: Array = every[..., self.a[0], :, :] @ self.a[1]
        to: Array = (every[..., self.b[0], :, :] @ self.b[1])[..., :3, 3] - A[..., :3, 3]
        along: Array = np.sum(A[..., :3, 2] * to, axis=-1)
        if self.part is not None:
            A[..., :3, 3] += (self.part * along)[..., None] * A[..., :3, 2]
            return A, np.ones(along.shape)
        way: Array = np.where(along < 0.0, -1.0, 1.0)
        A[..., :3, 3] -= (self.beyond * way)[..., None] * A[..., :3, 2]
        return A, way * np.maximum(np.abs(along) + 2.0 * self.beyond, LEAST)


class RigidParts:
    """The parts of a system, and the poses that bring them to where a configuration puts them.

    `parts` are at most two of each carrier: what is solid, and what can be looked through. Carriers
    are the links, the ground first, then the rods, then the `slides`. They were drawn at `q` (nq,).
    `r` is the radius of a hinge [m]; what is solid lies in a box of diagonal `size` [m]. `like` are
    the parts of the system with other dimensions: what is named alike moves with the same carrier.
    """

    def __init__(self, system: Model, q: Array, like: RigidParts | None = None):
        self.system = system
        self.q = q
        scene = build_scene(system, q)
        self.heads = [system.body_names.index(link.name) for link in scene.links]
        self.names = tuple(link.name for link in scene.links)
        self.rods = [
            (_find_rod_end(system, n, 0), _find_rod_end(system, n, 1)) for n, *_ in scene.rods
        ]
        self.size = scene.size
        if system.dim == 2:
            from kempe.views.drawing.planar import choose_pin_radius

            self.r = choose_pin_radius(scene)
        else:
            self.r = SOLID * symbols.choose_radius(scene)
        self.scene = scene = self._build_scene(q)
        self.slides = _list_slides(scene, self.r)
        self.parts = self._make_parts(scene, like)
        self.size = self._measure_diagonal() or scene.size

    def _build_scene(self, q: Array) -> Scene:
        """Build the scene at q (nq,), in space with bearings that lie side by side."""
        scene = build_scene(self.system, q)
        return scene if self.system.dim == 2 else separate_bearings(scene, self.r)

    def _measure_diagonal(self) -> float:
        """Measure the diagonal [m] of the box about all solids; 0 if there is none."""
        X = self.compute_stretched_maps(self.q)
        solid = [
            p.corners @ X[p.carrier, :3, :3].T + X[p.carrier, :3, 3]
            for p in self.parts
            if p.colours[:, 3].min() == 1.0
        ]
        return float(np.linalg.norm(np.ptp(np.concatenate(solid), axis=0))) if solid else 0.0

    def compute_places(self, q: Array) -> tuple[Array, Array]:
        """Compute poses (..., carriers, 4, 4) and lengths (..., carriers) of the carriers at q
        (..., nq).

        The parts of a carrier are stretched along its z by its length, which is 1 of all but
        slides.
        """
        every = fk(self.system, q)
        poses = [every[..., self.heads, :, :]]
        if self.rods:
            ends = np.stack(
                [
                    np.stack([(every[..., b, :, :] @ X)[..., :3, 3] for b, X in rod], axis=-2)
                    for rod in self.rods
                ],
                axis=-3,
            )
            poses.append(_make_rod_poses(ends))
        lengths = [np.ones(x.shape[:-2]) for x in poses]
        for slide in self.slides:
            pose, length = slide.compute_pose(every)
            poses.append(pose[..., None, :, :])
            lengths.append(length[..., None])
        return np.concatenate(poses, axis=-3), np.concatenate(lengths, axis=-1)

    def compute_poses(self, q: Array) -> Array:
        """Compute poses (..., carriers, 4, 4) of the carriers at configurations (..., nq)."""
        return self.compute_places(q)[0]

    @property
    def carriers(self) -> int:
        """Number of carriers."""
        return len(self.heads) + len(self.rods) + len(self.slides)

    def list_links(self, carrier: int) -> tuple[int, ...]:
        """List the numbers of the links that a carrier moves with; none for a rod."""
        if carrier < len(self.heads):
            return (carrier,)
        k = carrier - len(self.heads) - len(self.rods)
        return self.slides[k].links if k >= 0 else ()

    def compute_stretched_maps(self, q: Array) -> Array:
        """Compute the affine maps (..., carriers, 4, 4) of the carriers' parts at q (..., nq)."""
        X, lengths = self.compute_places(q)
        X = X.copy()
        X[..., :3, 2] *= lengths[..., None]
        return X

    def _make_parts(self, scene: Scene, like: RigidParts | None) -> list[RigidPart]:
        """Make the rigid parts: pieces that move with the same carrier, joined."""
        first = [p for p in self._record_pieces(scene) if not p.name.startswith("open:")]
        X = self.compute_stretched_maps(scene.q)
        X_inv = np.linalg.inv(X)
        self.made = [p.name for p in first] + [(s.name, s.part) for s in self.slides]
        self.carrying = (
            like.carrying
            if like is not None and like.made == self.made
            else self._find_all_carriers(scene, first, X)
        )
        held: dict[tuple[int, bool], list[DrawnPiece]] = {}
        for piece, carrier in zip(first, self.carrying.tolist(), strict=True):
            local = piece.corners @ X_inv[carrier, :3, :3].T + X_inv[carrier, :3, 3]
            held.setdefault((carrier, piece.colour[3] < 1.0), []).append(
                piece._replace(corners=local)
            )
        for k, slide in enumerate(self.slides, len(self.heads) + len(self.rods)):
            held.setdefault((k, False), []).extend(_make_bars(scene, slide, self.r, X[k, :3, :3]))
        held = {key: pieces for key, pieces in held.items() if pieces}
        return [
            _join_pieces(carrier, pieces)
            for (carrier, _), pieces in sorted(held.items(), key=lambda x: x[0])
        ]

    def _find_all_carriers(self, scene: Scene, first: list[DrawnPiece], X: Array) -> np.ndarray:
        """Find the carrier of each piece, by the drawing at another configuration.

        `X` are the maps (carriers, 4, 4) of the carriers' parts.
        """
        system = self.system
        rng = np.random.default_rng(0)
        other = integrate_velocity(
            system,
            scene.q,
            APART * rng.choice([-1.0, 1.0], system.nv) * rng.uniform(0.5, 1.0, system.nv),
        )
        second: dict[str, list[DrawnPiece]] = {}
        for piece in self._record_pieces(self._build_scene(other)):
            second.setdefault(piece.name, []).append(piece)
        moved = self.compute_stretched_maps(other) @ np.linalg.inv(X)
        by_name: dict[str, list[int]] = {}
        for i, piece in enumerate(first):
            by_name.setdefault(piece.name, []).append(i)
        carriers = np.empty(len(first), dtype=np.int64)
        for name, places in by_name.items():
            pieces = [first[i] for i in places]
            carriers[places] = self._find_carriers(scene, pieces, second.get(name, []), moved)
        return carriers

    def _record_pieces(self, scene: Scene) -> list[DrawnPiece]:
        """Record the pieces of the drawing of a scene."""
        lengths = [i for i, unit in enumerate(_mark_lengths(self.system)) if unit]
        wide = np.repeat(scene.q[None], 2, axis=0)
        wide[:, lengths] += np.array([[-0.5], [0.5]]) * self.size
        if self.system.dim == 2:
            from kempe.views.drawing.planar import SheetRecord, draw_scene

            sheet = SheetRecord(scene, self.r, wide)
            draw_scene(sheet, {}, False)
            return sheet.pieces
        solids = SolidRecord()
        symbols.add_scene(solids, scene, self.r, wide)
        return solids.pieces

    def _find_carriers(
        self, scene: Scene, pieces: list[DrawnPiece], twins: list[DrawnPiece], moved: Array
    ) -> list[int]:
        """Find the carrier of each piece of one name by the motion of its corners.

        It brings the corners to those of the piece's twin at another configuration.
        """
        slides = self._find_slide_carrier(scene, pieces[0])  # of one name all slide, or none
        if slides is not None:
            return [self._find_slide_carrier(scene, piece) or 0 for piece in pieces]
        name = pieces[0].name
        likely = _list_likely_carriers(scene, name, len(self.heads))
        out = [likely[0] if name.partition(":")[0] in OWN else likely[-1]] * len(pieces)
        alike: dict[int, list[int]] = {}
        for i, (piece, twin) in enumerate(zip(pieces, twins, strict=False)):
            if len(piece.corners) == len(twin.corners):
                alike.setdefault(len(twin.corners), []).append(i)
        for left in alike.values():
            for some in (likely, range(len(moved))):
                here = np.array([pieces[i].corners for i in left])[:, None]
                there = here @ moved[some, :3, :3].swapaxes(-1, -2) + moved[some, None, :3, 3]
                off = np.abs(there - np.array([twins[i].corners for i in left])[:, None])
                good = off.max(axis=(2, 3)) < NEAR_PART * self.size
                for i, fits in zip(left, good, strict=True):
                    if fits.any():
                        out[i] = some[int(np.argmax(fits))]
                left = [i for i, fits in zip(left, good, strict=True) if not fits.any()]
                if not left:
                    break
        return out

    def _find_slide_carrier(self, scene: Scene, piece: DrawnPiece) -> int | None:
        """Find the carrier of a piece of a sliding joint or line; None if it is a link."""
        what, _, of = piece.name.partition(":")
        name = of.partition(":")[0]
        first = len(self.heads) + len(self.rods)
        spans = {s.name: k for k, s in enumerate(self.slides, first) if s.part is None}
        seats = {s.name: k for k, s in enumerate(self.slides, first) if s.part is not None}
        if any(line[0] == name for line in scene.lines):
            return (
                seats[name]
                if what == "slot" or of.endswith(":point") or scene.system.dim == 3
                else None
            )
        joint = next((j for j in scene.joints if j.name == name and j.kind in SLIDING), None)
        if joint is None:
            return None
        if name in spans and name in seats:  # cylinder and rod
            return (seats if what == "driver" else spans)[name]
        if scene.system.dim == 2:
            rail = _choose_rail_link(scene, joint)
            block = joint.child if rail == joint.parent else joint.parent
            return {"rail": seats.get(name, rail), "block": block}.get(what)
        if what != "rail":
            return None
        if name not in spans:
            return seats.get(name, joint.parent)
        now = float((joint.centre - joint.F[:3, 3]) @ joint.axis)
        t = (1.0 if now >= 0.0 else -1.0) * ((piece.corners - joint.F[:3, 3]) @ joint.axis)
        ends = 0.9 * self.slides[spans[name] - first].beyond
        if t.max() < -ends:  # a collar at its end
            return joint.parent
        return joint.child if t.min() > abs(now) + ends else spans[name]


def _list_slides(scene: Scene, r: float) -> list[Slide]:
    """List what is drawn between the halves of each sliding joint, and points on lines."""
    system = scene.system
    out = list[Slide]()
    mechanism = system.mechanism
    number = system.body_names.index
    for seen in scene.joints:
        if seen.kind not in SLIDING:
            continue
        joint = mechanism.joints[seen.name]
        links = (seen.parent, seen.child)
        X_PF, X_CM = (X.evaluate_pose(mechanism.parameters) for X in (joint.X_PF, joint.X_CM))
        a = (number(joint.parent), X_PF)
        b = (number(joint.child), X_CM)
        if scene.is_telescopic(seen, r):
            out += [Slide(seen.name, links, a, b), Slide(seen.name, links, a, b, part=0.36)]
        elif scene.system.dim == 3 and (0 not in links or seen.kind != "prismatic"):
            out.append(Slide(seen.name, links, a, b, None, symbols.BEYOND * r))
        elif not np.isfinite(seen.limits).all():
            ground = 0 in links
            out.append(
                Slide(
                    seen.name,
                    links,
                    a,
                    b,
                    float(system.dim == 3 or seen.parent == 0) if ground else None,
                )
            )
    for name, links, _, _ in scene.lines:
        c = mechanism.constraints[name]
        X_A, X_B = c.frames(mechanism.parameters, system.dim)
        ends = (number(c.parent), X_A), (number(c.child), X_B)
        out += [Slide(name, links, *ends), Slide(name, links, *ends, part=1.0)]
    return out


def _choose_rail_link(scene: Scene, joint: SeenJoint) -> int:
    """Choose the link that has the rail of a planar prismatic joint, as `planar` draws it."""
    ends = joint.parent, joint.child
    return (
        0
        if 0 in ends
        else max(ends, key=lambda k: (scene.compute_reach(joint, k), k == joint.parent))
    )


def _make_bars(scene: Scene, slide: Slide, r: float, R: Array) -> list[DrawnPiece]:
    """Make the bars of a planar drawing along a slide without limits, or along a line.

    In the frame of the slide, whose axes (3, 3) are those of R.
    """
    if scene.system.dim == 3 or next(
        (scene.is_telescopic(j, r) for j in scene.joints if j.name == slide.name), False
    ):
        return []
    line = next((x for x in scene.lines if x[0] == slide.name), None)
    seen = next((j for j in scene.joints if j.name == slide.name), None)
    if seen is not None and slide.part is not None:
        return []
    rail = slide.links[0] if seen is None else _choose_rail_link(scene, seen)
    half = 1.25 * r if line else 0.5 * style.BAR * r
    z = np.array([0.0, 1.0] if slide.part is None else [-5.0 * r, 5.0 * r])
    colour = style.choose_link_colour(rail)
    fill = style.mix_colours(colour, style.PAPER, 0.45 if line else 0.25)
    dark = style.mix_colours(colour, style.INK, 0.45)
    layer = style.POLYGONS if line else style.BARS
    edge = 0.5 * style.POINT * 0.9 * r
    up = R[2] / np.linalg.norm(R[2])
    side = np.cross([0.0, 0.0, 1.0], up)

    def make_strip(low: float, high: float, layer: float, colour: str) -> DrawnPiece:
        """Make a flat bar between two positions along the slide."""
        x = np.array([low, high, high, low])[:, None] * side + style.THICK * r * layer * up
        corners = x + np.repeat(z, 2)[:, None] * np.array([0.0, 0.0, 1.0])
        fan = make_fan(4)
        return DrawnPiece(
            f"rail:{slide.name}",
            corners,
            np.concatenate([fan, fan[:, ::-1]]),
            (*parse_colour(colour), 1.0),
        )

    sides = [make_strip(s * half - edge, s * half + edge, layer + 0.5, dark) for s in (-1.0, 1.0)]
    return [make_strip(-half, half, layer, fill), *sides]


def _list_likely_carriers(scene: Scene, name: str, links: int) -> list[int]:
    """List the carriers that may belong to a name, those nearer to the ground first."""
    what, _, of = name.partition(":")
    of = of.partition(":")[0]
    for k, rod in enumerate(scene.rods):
        if what == "rod" and rod[0] == of:
            return [links + k]
    for joint in scene.joints:
        if joint.name == of and what not in (
            "link",
            "frame",
            "mark",
            "line",
            "slot",
            "ground",
            "hatch",
        ):
            return [joint.parent, joint.child]
    for line in scene.lines:
        if line[0] == of and what in ("line", "slot"):
            return list(line[1])
    found = [
        link.number
        for link in scene.links
        if (what == "link" and link.name == of) or of in link.frames
    ]
    found += [
        mark.link
        for mark in scene.marks
        if mark.name == of and what == "mark" and not name.endswith(":plane")
    ]
    return found or [0]


def _find_rod_end(system: Model, rod: str, k: int) -> tuple[int, Array]:
    """Find the body of a rod's end, and the pose (4, 4) of the end on it."""
    c = system.mechanism.constraints[rod]
    frames = c.frames(system.mechanism.parameters, system.dim)
    return system.body_names.index((c.parent, c.child)[k]), frames[k]


def _make_rod_poses(ends: Array) -> Array:
    """Make poses (..., 4, 4) at the first of two ends (..., 2, 3), with z towards the second."""
    way = ends[..., 1, :] - ends[..., 0, :]
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    X = np.broadcast_to(np.eye(4), (*way.shape[:-1], 4, 4)).copy()
    unit = np.where(length > 1e-12, way / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    X[..., :3, :3] = spatial.align_z(unit)
    X[..., :3, 3] = ends[..., 0, :]
    return X


def _mark_lengths(system: Model) -> list[bool]:
    """Whether each coordinate is a length, in metres."""
    from kempe.model.configurations import list_units

    unit = list_units(system)
    return [unit.get(name) == system.unit for name in system.coordinate_names]


def _join_pieces(carrier: int, pieces: Sequence[DrawnPiece]) -> RigidPart:
    """Join the pieces of one carrier into a rigid part."""
    first = np.cumsum([0, *(len(p.corners) for p in pieces)])
    triangles = np.concatenate([p.triangles + k for p, k in zip(pieces, first, strict=False)])
    colours = np.concatenate([np.tile(p.colour, (len(p.triangles), 1)) for p in pieces])
    return RigidPart(carrier, np.concatenate([p.corners for p in pieces]), triangles, colours)


if importlib.util.find_spec("trimesh") is None:
    raise MissingExtraError("trimesh", "view")


# ---- nodes of a scene

SAID = 3
"""Meshes that could not be shown that are named in one sentence."""
GHOST = 0.4
SEEN = 0.25
"""How much is seen of a ghost, and of a surface that is laid over a system."""
ABOVE = 3.0
"""Height of lines above a planar drawing, in radii of a pin."""
PALE = (150, 155, 162)
FINE = 0.6
"""Colour and thickness of the lines of the floor, which are faint on light and on dark pages."""
HANDLE = 0.22
TIP = 1.35
"""Size of the handles of a target in diagonals of the drawing, and how far their arrows go in
their size.
"""
OPENING = {2: np.deg2rad(12.0), 3: np.deg2rad(45.0)}
"""Angle of the camera: what is planar is seen nearly without perspective, so that its layers lie on
one another."""
SOME = 48
"""Configurations of a motion by which a camera is placed."""
DIRECTIONS = np.array([x for x in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(x)])
"""Directions (26, 3) in which the outermost points of links are found, to frame them."""
FLAT = 2.6
GAMMA = 2.2
"""Strength of the light on what is flat, and the exponent of light in numbers of colours."""
UPWARDS = np.array([0.0, 0.0, 1.0])
ASIDE = np.array([0.6, -0.85, 0.4])
"""From where planar and spatial systems are looked at."""
NEAR = 0.01
FAR = 1000.0
"""How near to the camera and how far from it things are seen, in diagonals of the drawing."""
SOFT = np.cos(np.deg2rad(35.0))
"""Cosine of the angle up to which neighbouring triangles are shaded as one round surface."""
HASH = np.array([0x9E3779B97F4A7C1, 0x2545F4914F6CDD1D, 0x5851F42D4C957F2D])
"""Odd factors by which the whole coordinates of a place become one number."""
NORMALS = 1e3
"""Steps from 0 to 1 in which components of normals count as the same."""
GLTF_TYPES = {"B": 5121, "I": 5125, "f": 5126}
"""Numbers of glTF for types of numpy."""


class Shape(NamedTuple):
    """A mesh in the frame of the carrier that it is drawn on."""

    carrier: int
    mesh: PlacedMesh


class Drawn:
    """A system with its shapes, made once for all pages. `lost` says which meshes could not be
    shown.

    Cameras have all configurations of a motion `way` (n, nq) in sight, if there is one, and the
    ends of the `handles` (k, 3) of a target. `like` is the drawing of the system with other
    dimensions, of which is kept what does not change. What is `flat` has no surfaces of files.
    """

    def __init__(
        self, system: Model, q: Array, way: Array | None = None, like: Drawn | None = None
    ):
        self.system = system
        self.q = q
        self._like = like
        self.read: dict[Any, Any] = {} if like is None else like.read
        meshes, self.lost = read_body_meshes(system.mechanism, lambda: self.rigid, self.read)
        self.flat = system.dim == 2 and not meshes
        self.shapes = tuple(self._place_shapes(meshes))
        self.extremes = self._find_extremes()
        shown = q[None]
        if way is not None:
            some = way[np.unique(np.linspace(0, len(way) - 1, SOME).round().astype(int))]
            shown = np.concatenate([shown, some])
        self.points = self.compute_extremes(shown)
        self.handles = np.zeros((0, 3))
        self._like = None

    @cached_property
    def rigid(self) -> RigidParts:
        """The links, drawn at `q`."""
        return RigidParts(self.system, self.q, None if self._like is None else self._like.rigid)

    def _place_shapes(self, meshes: dict[str, list[PlacedMesh]]) -> list[Shape]:
        out: list[Shape] = []
        covered: set[int] = set()
        for link in self.rigid.scene.links:
            head = np.linalg.inv(next(iter(link.bodies.values())))
            for body, X in link.bodies.items():
                for mesh in meshes.get(body, ()):
                    out.append(Shape(link.number, mesh._replace(X=head @ X @ mesh.X)))
                    covered.add(link.number)
            # what is left of a link without some of its meshes may hang in the air
            if any(said.startswith(f"{body}: ") for body in link.bodies for said in self.lost):
                covered.discard(link.number)
        bare = (
            p
            for p in self.rigid.parts
            if not covered.intersection(self.rigid.list_links(p.carrier))
        )
        return out + [_make_shape(p, float(not self.flat)) for p in bare]

    def _find_extremes(self) -> list[tuple[int, Array]]:
        """Find the corners (k, 3) of each carrier that are the farthest ones in some direction."""
        by: dict[int, list[Array]] = {}
        for carrier, mesh in self.shapes:
            corners = mesh.corners
            by.setdefault(carrier, []).append(
                corners[np.unique(np.argmax(corners @ DIRECTIONS.T, axis=0))]
            )
        return [(k, np.concatenate(corners)) for k, corners in by.items()]

    def compute_extremes(self, q: Array) -> Array:
        """Compute the outermost points (k, 3) of all that is drawn at configurations (n, nq)."""
        X = self.rigid.compute_stretched_maps(q)
        points = [
            (p @ X[:, k, :3, :3].swapaxes(-1, -2) + X[:, k, None, :3, 3]).reshape(-1, 3)
            for k, p in self.extremes
        ]
        return np.concatenate([np.zeros((1, 3))] if not points else points)

    @property
    def lost_sentence(self) -> str:
        """Sentence about meshes that are not drawn, with the reasons; '' if all are drawn."""
        if not self.lost:
            return ""
        more = f"; and {len(self.lost) - SAID} more" if len(self.lost) > SAID else ""
        return (
            f"{format_count(len(self.lost), 'mesh')} not drawn: {'; '.join(self.lost[:SAID])}{more}"
        )

    @cached_property
    def seen(self) -> tuple[Scene, Array]:
        """Scene that was drawn, and poses (carriers, 4, 4) of the ground in the carriers' frames."""
        return self.rigid.scene, spatial.inverse(self.rigid.compute_poses(self.rigid.q))

    @cached_property
    def outlines(self) -> tuple[tuple[int, Array, np.ndarray], ...]:
        """One mesh without colours for each moving carrier, for ghosts."""
        by: dict[int, list[PlacedMesh]] = {}
        for carrier, mesh in self.shapes:
            if carrier and mesh.opacity == 1.0:
                by.setdefault(carrier, []).append(mesh)
        out: list[tuple[int, Array, np.ndarray]] = []
        for k, meshes in by.items():
            corners = [mesh.corners for mesh in meshes]
            first = np.cumsum([0, *map(len, corners)])
            triangles = [mesh.triangles + n for mesh, n in zip(meshes, first, strict=False)]
            out.append((k, np.concatenate(corners), np.concatenate(triangles)))
        return tuple(out)

    @property
    def near(self) -> float:
        """Least distance [m] of the camera from visible objects."""
        return NEAR * max(self.rigid.size, 1e-9)

    def place_camera(self, camera: Any, aspect: float = 1.0) -> None:
        """Place a camera so that the system is in a picture of width by height `aspect`."""
        camera.fov = OPENING[self.system.dim]
        camera.near = self.near
        camera.far = FAR * max(float(np.ptp(self.points, axis=0).max()), 1e-9)
        camera.position, camera.look_at = self.find_place(aspect)

    def find_place(self, aspect: float) -> Array:
        """Find where a camera is that has the system in the picture, and where it looks (2, 3)."""
        away = UPWARDS if self.system.dim == 2 else ASIDE
        opening = OPENING[self.system.dim]
        points = np.concatenate([self.points, self.handles])
        return fit_camera(points, away, self.upright, opening, aspect)

    def add_handles(self, X: Array) -> None:
        """Have the handles of a target at the pose X (4, 4) in sight of cameras."""
        axes = [0, 1] if self.system.dim == 2 else [0, 1, 2]
        tips = X[:3, 3] + TIP * self.handle_size * X[:3, axes].T
        self.handles = np.concatenate([self.handles, tips])

    @property
    def handle_size(self) -> float:
        """Size [m] of the handles of a target."""
        return HANDLE * max(self.rigid.size, 1e-9)

    @property
    def upright(self) -> Array:
        """Direction (3,) that points upwards in the picture."""
        return np.array([0.0, 1.0, 0.0]) if self.system.dim == 2 else UPWARDS


def _make_shape(part: RigidPart, metal: float) -> Shape:
    """Make a shape of a part; see `write_glb` for `metal`."""
    corners = part.corners[part.triangles].reshape(-1, 3)
    colours = _to_bytes(part.colours)
    if not metal:  # as glTF has colours: in proportion to light
        colours = _to_bytes(np.column_stack([part.colours[:, :3] ** GAMMA, part.colours[:, 3]]))
    glb = write_glb(corners, compute_soft_normals(corners), np.repeat(colours, 3, axis=0), metal)
    color = tuple(_to_bytes(part.colours[0]).tolist()) if colours[:, 3].min() < 255 else None
    triangles = np.arange(len(corners)).reshape(-1, 3)
    drawn = Triangles(glb, corners, triangles, color)
    return Shape(part.carrier, PlacedMesh(drawn, np.ones(3), np.eye(4)))


def write_glb(corners: Array, normals: Array, colours: np.ndarray, metal: float = 1.0) -> bytes:
    """Triangles as binary glTF 2.0: every three of the corners (3 m, 3) [m] are one, with normals
    (3 m, 3) and colours (3 m, 4) of bytes.

    A surface of `metal` 1 reflects its surroundings, one of 0 is seen in any light.

    Corners that are alike in all three are one vertex, for viser computes normals anew, as means
    over the triangles at a vertex.
    """
    first, index = _find_alike(corners, normals, colours)
    arrays = {
        "POSITION": corners[first].astype("<f4"),
        "NORMAL": normals[first].astype("<f4"),
        "COLOR_0": colours[first].astype(np.uint8),
        "": index.astype("<u4"),
    }
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    start = 0
    for k, (name, array) in enumerate(arrays.items()):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": array.nbytes})
        accessors.append(
            {
                "bufferView": k,
                "componentType": GLTF_TYPES[array.dtype.char],
                "normalized": array.dtype == np.uint8,
                "count": len(array),
                "type": f"VEC{array.shape[1]}" if name else "SCALAR",
            }
        )
        start += array.nbytes
    accessors[0]["min"], accessors[0]["max"] = (
        extreme.tolist() for extreme in (corners.min(axis=0), corners.max(axis=0))
    )
    attributes = {name: k for k, name in enumerate(arrays) if name}
    scene: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(attributes)}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
    if metal < 1.0:
        surface = {"metallicFactor": metal, "roughnessFactor": 1.0}
        scene["materials"] = [{"pbrMetallicRoughness": surface}]
        scene["meshes"][0]["primitives"][0]["material"] = 0
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(array.tobytes() for array in arrays.values())
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
    chunks = [
        struct.pack("<I4s", len(x), kind) + x for x, kind in ((text, b"JSON"), (data, b"BIN\0"))
    ]
    return b"".join([head, *chunks])


def _find_alike(
    corners: Array, normals: Array, colours: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find corners with the same place, normal and colour: the first of each kind (n,), in order,
    and for each corner (3 m,) its number among these.
    """
    place = _number_places(corners)
    turn = np.round(normals * NORMALS).astype(np.int64) @ HASH[[1, 2, 0]]
    colour = np.ascontiguousarray(colours.astype(np.uint8)).view(np.uint32).ravel().astype(np.int64)
    key = place + turn * HASH[0] + colour * HASH[1]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[index]


def _number_places(corners: Array) -> np.ndarray:
    """Number the places of corners (n, 3): equal numbers (n,) for the same place but for rounding."""
    near = 1e-7 * max(float(np.ptp(corners, axis=0).max()), 1e-300)
    return np.round(corners / near).astype(np.int64) @ HASH


def compute_soft_normals(corners: Array) -> Array:
    """Compute unit normals (3 m, 3) at the corners (3 m, 3) of m triangles, for smooth shading.

    They are means over the triangles that meet at a corner nearly flat.
    """
    a, b, c = corners.reshape(-1, 3, 3).transpose(1, 0, 2)
    own = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    unit = own / np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-300)
    flat = unit[np.argmax(np.linalg.norm(own, axis=1))] if len(own) else UPWARDS
    along = np.abs(unit @ flat)
    if np.all((along > 1.0 - 1e-12) | (along == 0.0)):  # a sheet, as all that is planar
        return np.where(along[:, None] == 0.0, flat, unit)
    place = _number_places(corners)
    order = np.argsort(place, kind="stable")
    place = place[order]
    out = own.copy()
    first = np.arange(len(order))
    step = 1
    while len(first):  # each corner with the one `step` after it at the same place
        first = first[: np.searchsorted(first, len(order) - step)]
        first = first[place[first] == place[first + step]]
        i = order[first]
        k = order[first + step]
        both = np.sum(unit[i] * unit[k], axis=1) > SOFT
        np.add.at(out, i[both], own[k[both]])
        np.add.at(out, k[both], own[i[both]])
        step += 1
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)


def _to_bytes(colours: Any) -> np.ndarray:
    """Convert colours from 0 to 1 to bytes."""
    return np.round(255 * np.asarray(colours)).astype(np.uint8)


def split_poses(X: Array) -> tuple[Array, Array]:
    """Convert poses (..., 4, 4) to quaternions wxyz (..., 4) and positions (..., 3)."""
    return spatial.matrix_to_quat_wxyz(X[..., :3, :3]), X[..., :3, 3]


def _scale_along_z(length: float) -> tuple[float, float, float]:
    """Return the scale factors (x, y, z) of a part stretched along z."""
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
        self.legends: dict[str, tuple[tuple[str, str], ...]] = {}
        self.made = list[Any]()
        self._add_shapes(q)
        if drawn.flat:
            # what is flat needs no surroundings to reflect and no shadows, which cost the processor
            # most where there is no graphics card
            scene.configure_environment_map(None)
            scene.configure_default_lights(enabled=False, cast_shadow=False)
            scene.add_light_ambient("/light", intensity=FLAT)
        if drawn.system.dim == 3:
            wide = 4.0 * drawn.rigid.size
            low = min(0.0, float(drawn.points[:, 2].min()))
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
                cell_thickness=0.6 * FINE,
                section_thickness=FINE,
            )

    def _add_shapes(self, q: Array) -> None:
        """Add the nodes of all shapes, at a configuration (nq,)."""
        drawn = self.drawn
        scene = self.scene
        # on what is flat light falls from aside, and shadows are stripes
        solid = drawn.system.dim == 3
        self.poses, self.lengths = drawn.rigid.compute_places(q)
        self.stretched: dict[int, list[Any]] = {}
        quats, places = split_poses(self.poses)
        for k in sorted({s.carrier for s in drawn.shapes}):
            self.frames[k] = scene.add_frame(
                f"/system/{k}", show_axes=False, wxyz=quats[k], position=places[k]
            )
        for i, (carrier, mesh) in enumerate(drawn.shapes):
            name = f"/system/{carrier}/{i}"
            along = np.array(_scale_along_z(self.lengths[carrier]))
            color = mesh.drawn.color
            if color is None or mesh.opacity == 1.0:
                quat, place = split_poses(mesh.X)
                scale = tuple((along * mesh.scale).tolist())
                node = scene.add_glb(
                    name,
                    mesh.drawn.glb,
                    scale=scale,
                    wxyz=quat,
                    position=place,
                    cast_shadow=solid,
                    receive_shadow=solid,
                )
            else:
                node = scene.add_mesh_simple(
                    name,
                    mesh.corners,
                    mesh.triangles,
                    color=color[:3],
                    side="double",
                    scale=tuple(along.tolist()),
                    opacity=mesh.opacity,
                    cast_shadow=False,
                    receive_shadow=False,
                )
            self.stretched.setdefault(carrier, []).append(node)
            self.made.append(node)

    def change_drawing(self, drawn: Drawn, q: Array) -> None:
        """Draw the system with other dimensions in place of the present one, at q (nq,)."""
        old = self.drawn.shapes
        self.drawn = drawn
        for _, ghost in self.ghosts:
            ghost.remove()
        self.ghosts = []
        fits = [s.carrier for s in old] == [s.carrier for s in drawn.shapes] and all(
            s.mesh.opacity == 1.0 for s in (*old, *drawn.shapes)
        )
        if fits:  # what is changed in place does not flicker
            for a, b, node in zip(old, drawn.shapes, self.made, strict=True):
                if a.mesh.drawn.glb != b.mesh.drawn.glb:
                    node.glb_data = b.mesh.drawn.glb
                if not np.array_equal(a.mesh.X, b.mesh.X):
                    node.wxyz, node.position = split_poses(b.mesh.X)
                if not np.array_equal(a.mesh.scale, b.mesh.scale):
                    node.scale = tuple(b.mesh.scale.tolist())
            self.move_links(q)
        else:
            for frame in self.frames.values():
                frame.remove()
            self.frames = {}
            self.made = []
            self._add_shapes(q)

    # ---- what is shown on request

    def show_names(self, shown: bool) -> None:
        """Show the names of joints, bodies and frames, or remove them."""
        for label in self.labels:
            label.remove()
        self.labels = []
        if not shown:
            return
        scene, X = self.drawn.seen
        at = [(joint.child, joint.centre, joint.name) for joint in scene.joints]
        at += [
            (link.number, scene.list_points(link).mean(axis=0), link.name)
            for link in scene.links[1:]
            if len(scene.list_points(link)) > 1
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

    def show_axes(self, shown: bool) -> None:
        """Show the axes of all frames, or remove them."""
        for axes in self.axes:
            axes.remove()
        self.axes = []
        if not shown:
            return
        (scene, X) = self.drawn.seen
        r = self.drawn.rigid.r
        for link in scene.links:
            for k, Y in enumerate((link.bodies | link.frames).values()):
                quat, place = split_poses(X[link.number] @ Y)
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

    def show_overlay(self, name: str, overlay: Overlay | None) -> None:
        """Show an overlay in place of the one with the same name; None removes it."""
        for node in self.laid.pop(name, ()):
            node.remove()
        self.legends.pop(name, None)
        if overlay is None:
            return
        new = self.laid[name] = []
        self.legends[name] = overlay.legend
        flat = self.drawn.system.dim == 2
        above = np.array([0.0, 0.0, ABOVE * self.drawn.rigid.r if flat else 0.0], dtype=np.float32)
        scene = self.scene
        at = f"/over/{name}"
        still = {"cast_shadow": False, "receive_shadow": False}
        if len(overlay.lines):
            lines = overlay.lines.astype(np.float32) + above
            colour = _to_bytes(parse_colour(overlay.line_colour))
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
                    color=_to_bytes(parse_colour(colour)),
                    opacity=SEEN,
                    side="double",
                    **still,
                )
            )
        if len(overlay.points):
            record = SolidRecord()
            record.add_ball("", np.zeros(3), 0.5, style.INK)
            (ball,) = record.pieces
            none = np.tile([1.0, 0.0, 0.0, 0.0], (len(overlay.points), 1))
            new.append(
                scene.add_batched_meshes_simple(
                    f"{at}/points",
                    ball.corners,
                    ball.triangles,
                    none,
                    overlay.points + above,
                    lod="off",
                    batched_scales=overlay.sizes.astype(np.float32),
                    batched_colors=_to_bytes(overlay.colours),
                    **still,
                )
            )

    # ---- configurations

    def move_links(self, q: Array) -> None:
        """Move all links to a configuration (nq,)."""
        X, lengths = self.drawn.rigid.compute_places(q)
        moved = np.abs(X - self.poses).max(axis=(-2, -1)) > 1e-12
        for k in np.flatnonzero(np.abs(lengths - self.lengths) > 1e-12):
            for node in self.stretched.get(int(k), ()):
                node.scale = _scale_along_z(lengths[k])
        self.poses = X
        self.lengths = lengths
        quats, places = split_poses(X)
        for k, frame in self.frames.items():
            if moved[k]:
                frame.wxyz = quats[k]
                frame.position = places[k]

    def show_ghosts(self, solutions: Array, clicked: Any = None) -> None:
        """Show other solutions (k, nq) as ghosts; `clicked` is called with the event of a click."""
        if not len(solutions) and not self.ghosts:
            return
        if not self.ghosts or len(self.ghosts[0][1].batched_positions) < len(solutions):
            self._add_ghosts(max(8, len(solutions)), clicked)
        room = len(self.ghosts[0][1].batched_positions)
        X = np.broadcast_to(np.eye(4), (room, self.drawn.rigid.carriers, 4, 4)).copy()
        scales = np.zeros((room, self.drawn.rigid.carriers, 3), dtype=np.float32)
        if len(solutions):
            X[: len(solutions)], lengths = self.drawn.rigid.compute_places(solutions)
            scales[: len(solutions)] = 1.0
            scales[: len(solutions), :, 2] = lengths
        quats, places = split_poses(X)
        for k, node in self.ghosts:
            scale = scales[:, k]
            node.batched_wxyzs = quats[:, k]
            node.batched_positions = places[:, k]
            if not np.array_equal(scale, node.batched_scales):
                node.batched_scales = scale
            node.visible = bool(len(solutions))

    def _add_ghosts(self, room: int, clicked: Any) -> None:
        """Add ghosts for up to `room` solutions in place of the old ones."""
        for _, node in self.ghosts:
            node.remove()
        self.ghosts = []
        for k, corners, triangles in self.drawn.outlines:
            colour = tuple(int(255 * x) for x in parse_colour(style.choose_link_colour(k)))
            node = self.scene.add_batched_meshes_simple(
                f"/ghosts/{k}",
                corners,
                triangles,
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
