"""Collision shapes of bodies as objects of coal, and which pairs of bodies are looked at.

Needs the extra [collision]. A mesh counts as its convex hull, so that distances are too
large by rounding at most.
"""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.assemble.assemble import assemble
from kempe.description.meshes import read_meshes
from kempe.description.packages import Folders
from kempe.description.shapes import Mesh
from kempe.errors import InputError, KempeError, MissingExtraError
from kempe.forward.fk import fk
from kempe.kernels.solids.solid_layout import BOX, OTHER, POINT, SEGMENT
from kempe.model.configurations import sample_configurations
from kempe.model.model import keep_answers
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import Model

SAMPLES = 64
"""Configurations in which pairs that always touch are looked for."""
THIN = 1e-6
"""Thickness of flat meshes, as a part of their size."""

MADE: dict[str, Callable[[Any, Any], Any]] = {
    "sphere": lambda coal, s: coal.Sphere(s.radius),
    "box": lambda coal, s: coal.Box(*s.size),
    "cylinder": lambda coal, s: coal.Cylinder(s.radius, s.length),
    "capsule": lambda coal, s: coal.Capsule(s.radius, s.length),
    "ellipsoid": lambda coal, s: coal.Ellipsoid(*s.radii),
}
"""By the kind of a shape: what coal makes of it. Meshes are read apart."""

CORES: dict[str, Callable[[Any], Core]] = {
    "sphere": lambda s: Core(POINT, (0.0, 0.0, 0.0), s.radius),
    "capsule": lambda s: Core(SEGMENT, (0.5 * s.length, 0.0, 0.0), s.radius),
    "box": lambda s: Core(BOX, tuple(0.5 * x for x in s.size), 0.0),
}
"""By the kind of a shape: its core, where distances have a closed form."""


class Core(NamedTuple):
    """What a ball makes a solid of: form and sizes as kernels read them, and the ball's radius."""

    form: int
    sizes: tuple[float, ...]
    radius: float


class Solid(NamedTuple):
    """A shape as coal has it, its body, its place X (4, 4) in the body, the centre in the body,
    the radius and the half sizes (3,) of a sphere and a box about it, and its core.
    """

    shape: Any
    body: str
    X: Array
    center: Array
    radius: float
    half: Array
    core: Core


class Gap(NamedTuple):
    """Two solids of different bodies that are near: the number of their couple, their distance,
    their nearest points, and the direction from the first to the second.
    """

    couple: int
    distance: float
    points: tuple[Array, Array]
    normal: Array


class Solids(NamedTuple):
    """All solids of a system, and the pairs of bodies that are looked at."""

    shapes: tuple[Any, ...]
    names: tuple[str, ...]
    """Bodies that have solids."""
    body_of: np.ndarray
    """For each solid, the number of its body in `names`."""
    places: Array
    """Places (n, 4, 4) in their bodies."""
    centers: Array
    radii: Array
    halves: Array
    """Centres (n, 3) in their bodies of spheres and boxes about the solids, radii (n,) of the spheres,
    and half sizes (n, 3) of the boxes, along the axes of the solids."""
    cores: tuple[Core, ...]
    numbers: dict[str, list[int]]
    """For each body, the numbers of its solids."""
    pairs: tuple[tuple[str, str], ...]

    def list_couples(self, pair: tuple[str, str]) -> list[tuple[int, int]]:
        """List all pairs of solids of two bodies."""
        a, b = pair
        return list(itertools.product(self.numbers[a], self.numbers[b]))


def import_coal() -> Any:
    """Import coal. Errors: `MissingExtraError`."""
    try:
        import coal
    except ImportError:
        raise MissingExtraError("coal", "collision") from None
    return coal


@keep_answers
def get_solids(system: Model) -> Solids:
    """Return the solids of all bodies, and the pairs of bodies that may touch.

    Errors: `InputError` if no body has a collision shape, or a mesh cannot be read.
    """
    mechanism = system.mechanism
    found = _make_solids(mechanism)
    if not found:
        raise InputError(
            f"no body of {system.name!r} has a collision shape: `Mechanism.shape` adds one, and "
            "files may have them"
        )
    names = tuple(dict.fromkeys(solid.body for solid in found))
    solids = Solids(
        tuple(solid.shape for solid in found),
        names,
        np.array([names.index(solid.body) for solid in found]),
        np.array([solid.X for solid in found]),
        np.array([solid.center for solid in found]),
        np.array([solid.radius for solid in found]),
        np.array([solid.half for solid in found]),
        tuple(solid.core for solid in found),
        {name: [k for k, solid in enumerate(found) if solid.body == name] for name in names},
        tuple(_list_pairs(mechanism, names)),
    )
    return solids._replace(pairs=_drop_touching_pairs(system, solids))


# ---- shapes


def _make_solids(mechanism: Mechanism) -> list[Solid]:
    """Make the solids of all collision shapes."""
    coal = import_coal()
    given = [
        (name, shape.geometry.evaluate_sizes(mechanism.parameters), shape)
        for name, body in mechanism.bodies.items()
        for shape in body.shapes
        if shape.collision
    ]
    corners = _read_corners([(n, g) for n, g, _ in given if isinstance(g, Mesh)], mechanism)
    out: list[Solid] = []
    for name, geometry, shape in given:
        if isinstance(geometry, Mesh):
            made = _make_hull(coal, corners[geometry.path] * np.array(geometry.scale, dtype=float))
        else:
            made = MADE[geometry.kind](coal, geometry)
        made.computeLocalAABB()
        X = shape.X_BS.evaluate_pose(mechanism.parameters)
        center = X[:3, :3] @ np.ravel(made.aabb_center) + X[:3, 3]
        half = 0.5 * (np.ravel(made.aabb_local.max_) - np.ravel(made.aabb_local.min_))
        core = CORES.get(geometry.kind, lambda _: Core(OTHER, (0.0, 0.0, 0.0), 0.0))(geometry)
        out.append(Solid(made, name, X, center, float(made.aabb_radius), half, core))
    return out


def _read_corners(meshes: list[tuple[str, Mesh]], mechanism: Mechanism) -> dict[str, Array]:
    """Return the corners (n, 3) of meshes by their paths. Errors: `InputError`."""
    if meshes and importlib.util.find_spec("trimesh") is None:
        raise MissingExtraError("trimesh", "collision")
    folders = Folders(mechanism.roots)
    sources: dict[str, tuple[Any, None]] = {}
    for name, mesh in meshes:
        try:
            sources[mesh.path] = (folders.find_file(mesh.path), None)
        except KempeError as error:
            raise InputError(f"collision shape of {name!r}: {error}") from None
    read = read_meshes(sources.values())
    out: dict[str, Array] = {}
    for name, mesh in meshes:
        found = read[sources[mesh.path]]
        if isinstance(found, str):
            raise InputError(f"collision shape of {name!r}: mesh {mesh.path}: {found}")
        out[mesh.path] = found.corners.astype(float)
    return out


def _make_hull(coal: Any, corners: Array) -> Any:
    """Make the convex hull of points (n, 3); flat ones get a thickness."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(corners)
    except QhullError:
        size = THIN * max(float(np.ptp(corners, axis=0).max()), 1e-300)
        steps = size * np.concatenate([np.eye(3), -np.eye(3)])
        corners = (corners[:, None] + steps).reshape(-1, 3)
        hull = ConvexHull(corners)
    a, b, c = (corners[hull.simplices[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    simplices = np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
    number = np.zeros(len(corners), dtype=int)
    number[hull.vertices] = np.arange(len(hull.vertices))
    points = coal.StdVec_Vec3s()
    points.extend(list(corners[hull.vertices]))
    triangles = coal.StdVec_Triangle()
    triangles.extend([coal.Triangle(*row) for row in number[simplices].tolist()])
    return coal.Convex(points, triangles)


# ---- one configuration


class Placed:
    """Solids at poses X (n, 4, 4) of the bodies that have them."""

    def __init__(self, solids: Solids, X: Array):
        self._solids = solids
        at = X[solids.body_of]
        self._places = at @ solids.places
        self._centers = (at[:, :3, :3] @ solids.centers[:, :, None])[:, :, 0] + at[:, :3, 3]
        coal = import_coal()
        self._make = coal.Transform3s
        self._measure = coal.distance
        self._request = coal.DistanceRequest()
        self._result = coal.DistanceResult()
        self._made: dict[int, Any] = {}

    def measure_pair(self, pair: tuple[str, str]) -> tuple[float, tuple[Array, Array]]:
        """Measure the distance of two bodies, and their nearest points."""
        best = np.inf
        points = (np.zeros(3), np.zeros(3))
        for i, j in self._solids.list_couples(pair):
            d = self.measure_solids(i, j)
            if d < best:
                best = d
                found = self._result
                points = (np.ravel(found.getNearestPoint1()), np.ravel(found.getNearestPoint2()))
        return best, points

    def find_smallest(self, couples: np.ndarray, at_least: Array, best: float) -> float:
        """Find the smallest distance of pairs (k, 2) of solids, less what they have to keep (k,), or
        `best` where none is smaller: bounds by spheres and boxes say which are measured.
        """
        i, j = couples.T
        bound = self._bound_distances(i, j) - at_least
        for k in np.argsort(bound).tolist():
            if bound[k] >= best:
                break
            best = min(best, self.measure_solids(int(i[k]), int(j[k])) - float(at_least[k]))
        return best

    def list_gaps(self, couples: np.ndarray, within: Array) -> list[Gap]:
        """List the gaps of pairs (k, 2) of solids that are nearer than `within` (k,), by the pairs."""
        i, j = couples.T
        bound = self._bound_distances(i, j)
        out: list[Gap] = []
        for k in np.flatnonzero(bound < within).tolist():
            d = self.measure_solids(int(i[k]), int(j[k]))
            if d < within[k]:
                found = self._result
                points = (np.ravel(found.getNearestPoint1()), np.ravel(found.getNearestPoint2()))
                out.append(Gap(k, d, points, np.ravel(found.normal).copy()))
        return out

    def _bound_distances(self, i: np.ndarray, j: np.ndarray) -> Array:
        """Compute lower bounds of the distances of solids i and j (k,): from the sphere about each one
        to the box about the other one, and between spheres where these may overlap.
        """
        apart = (self._centers[j] - self._centers[i])[:, None]
        bound = np.maximum(self._bound_from_boxes(apart, i, j), self._bound_from_boxes(apart, j, i))
        reach = self._solids.radii[i] + self._solids.radii[j]
        # how deep a sphere is in a box, its distance from the box does not bound
        return np.where(bound > 0.0, bound, np.linalg.norm(apart[:, 0], axis=1) - reach)

    def _bound_from_boxes(self, apart: Array, box: np.ndarray, sphere: np.ndarray) -> Array:
        """Compute the distances (k,) of spheres from boxes whose centres are `apart` (k, 1, 3)."""
        off = np.abs((apart @ self._places[box, :3, :3])[:, 0]) - self._solids.halves[box]
        off = np.maximum(off, 0.0)
        return np.sqrt(np.einsum("ki,ki->k", off, off)) - self._solids.radii[sphere]

    def measure_solids(self, i: int, j: int) -> float:
        """Measure the distance of two solids."""
        self._result.clear()
        a, b = (self._solids.shapes[k] for k in (i, j))
        places = (self._place_solid(i), self._place_solid(j))
        return float(self._measure(a, places[0], b, places[1], self._request, self._result))

    def _place_solid(self, k: int) -> Any:
        """Return the place of a solid for coal."""
        if k not in self._made:
            X = self._places[k]
            self._made[k] = self._make(X[:3, :3], X[:3, 3])
        return self._made[k]


# ---- pairs


def _list_pairs(mechanism: Mechanism, names: tuple[str, ...]) -> Iterable[tuple[str, str]]:
    """List pairs of bodies with shapes that move against one another and are no neighbours.

    Neighbours are joined by a joint, or by a joint and a body without shapes that is fixed to them;
    the ground is no such body. Pairs that the mechanism ignores are left out.
    """
    rigid = {name: {name} for name in mechanism.bodies}
    for joint in mechanism.joints.values():
        if joint.type.dof(mechanism.dim) == 0:
            group = rigid[joint.parent] | rigid[joint.child]
            rigid.update(dict.fromkeys(group, group))
    left = {frozenset(pair) for pair in mechanism.ignored_pairs}
    ground = mechanism.ground.name
    for joint in mechanism.joints.values():
        ends = [
            {name} if name in names or name == ground else rigid[name]
            for name in (joint.parent, joint.child)
        ]
        left |= {frozenset(pair) for pair in itertools.product(*ends)}
    for a, b in itertools.combinations(names, 2):
        if b not in rigid[a] and frozenset((a, b)) not in left:
            yield a, b


def _drop_touching_pairs(system: Model, solids: Solids) -> tuple[tuple[str, str], ...]:
    """Drop the pairs that touch in every one of some configurations: they are built so."""
    q = sample_configurations(system, 0, SAMPLES)
    closed = assemble(system, start=q)
    q = closed.q[closed.success]
    if not len(q):
        return solids.pairs
    poses = fk(system, q, solids.names)
    left = solids.pairs
    for X in poses:
        placed = Placed(solids, X)
        touching = [pair for pair in left if placed.measure_pair(pair)[0] <= 0.0]
        if not touching:
            return solids.pairs
        left = tuple(touching)
    return tuple(pair for pair in solids.pairs if pair not in left)
