"""Mirror images of configurations, and mixtures of them: places where more assembly modes are
looked for.

Where the points by which bodies are connected lie in a plane (in a planar system: on a line), on
the ground and on each body, the mirror image of a closed configuration in the ground's plane is
closed, too: distances do not tell left from right. Where they do not, the bodies are put as near to
the image as may be; whoever reads these configurations closes them, so nothing rests on them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.description.parts import Declared
from kempe.kinematics.forward import fk
from kempe.model.closures.packed_loops import characteristic_length
from kempe.model.kept import kept
from kempe.singular_values import svd
from kempe.solvers.assembly.poses import coordinates_at
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

FLAT = 1e-6
"""Distance of points from a plane, as a part of the mechanism's size, up to which they lie in
it."""


def mirrored(system: System, q: Array) -> Array:
    """Configurations (n, nq) near the mirror images of others in the plane of the ground's points;
    none if these points lie in no plane.
    """
    plane = _plane(system)
    if plane is None or not len(q):
        return np.empty((0, system.nq))
    center, normal = plane
    poses = fk(system, q)[:, 1:]
    out = poses.copy()
    for i, points in enumerate(_points(system)[1:]):
        image = poses[:, i, :3, :3] @ points.T + poses[:, i, :3, 3:]  # (n, 3, points)
        image = image - 2.0 * normal[:, None] * (normal @ (image - center[:, None]))[:, None, :]
        out[:, i] = _fitted(system, i + 1, points, np.swapaxes(image, 1, 2), poses[:, i])
    found = coordinates_at(system, out, q)
    return found[np.isfinite(found).all(axis=1)]


def mixed(system: System, q: Array, n: int, rng: np.random.Generator) -> Array:
    """Configurations (n, nq) whose joints stand as in one or another of some configurations (k,
    nq).
    """
    owner = np.array([name.rpartition(".")[0] or name for name in system.coordinate_names])
    joints, place = np.unique(owner, return_inverse=True)
    first, second = rng.integers(len(q), size=(2, n))
    return np.where((rng.random((n, len(joints))) < 0.5)[:, place], q[first], q[second])


@kept
def _points(system: System) -> list[Array]:
    """For each body the points (k, 3) of joints and constraints on it, in its axes; of hinges and
    slides a second one on their axis, which a mirror image must keep as well.
    """
    m = system.mechanism
    number = {b: i for i, b in enumerate(system.body_names)}
    length = characteristic_length(system)
    points: list[list[Array]] = [[] for _ in system.body_names]
    for owner in (*m.joints.values(), *(c for c in m.constraints.values() if c.parent)):
        joint = m.joints.get(owner.name)
        particle = joint is not None and m.bodies[joint.child].particle
        primitives = () if joint is None else joint.type.layout(system.dim, particle)[1]
        axes = {p.axis for p in primitives}
        letter = axes.pop() if len(axes) == 1 and not particle else ""
        if isinstance(owner, Declared) and not owner.rod:
            letter = "z"
        if joint is not None and particle:
            continue  # a place where it is at neutral, and no end of a link
        if isinstance(owner, Declared):
            places = owner.frames(m.parameters, system.dim)
        else:
            places = owner.X_PF.evaluate(m.parameters), owner.X_CM.evaluate(m.parameters)
        for body, X in zip((owner.parent, owner.child), places, strict=True):
            points[number[body]].append(X[:3, 3])
            along = X[:3, "xyz".index(letter)] if letter else np.zeros(3)
            if system.dim == 3 or np.abs(along[2]) < 0.5:
                points[number[body]].append(X[:3, 3] + length * along)
    return [np.array(p).reshape(-1, 3) for p in points]


@kept
def _plane(system: System) -> tuple[Array, Array] | None:
    """A point and the normal of the plane, in a planar system of the line, that the ground's points
    lie in.
    """
    points = _points(system)[0]
    dim = system.dim
    if not len(points):
        return None
    center = points.mean(axis=0)
    _, sizes, V = svd((points - center)[:, :dim])
    if len(sizes) == dim and sizes[-1] > FLAT * characteristic_length(system):
        return None
    return center, np.append(V[-1], np.zeros(3 - dim))


def _fitted(system: System, body: int, points: Array, image: Array, poses: Array) -> Array:
    """Poses (n, 4, 4) that bring points (k, 3) of a body as near to their images (n, k, 3) as may
    be (Kabsch, 1976).
    """
    out = poses.copy()
    if not len(points):
        return out
    if system.mechanism.bodies[system.body_names[body]].particle:
        out[:, :3, 3] = image.mean(axis=1)
        return out
    middle = points.mean(axis=0)
    place = image.mean(axis=1)
    H = np.swapaxes(points - middle, 0, 1) @ (image - place[:, None])
    dim = system.dim
    scale = np.linalg.norm(H, axis=(1, 2), keepdims=True)
    old = np.swapaxes(
        poses[:, :dim, :dim], 1, 2
    )  # where the points leave a turn open it stays small
    U, _, V = svd(H[:, :dim, :dim] + 1e-9 * np.maximum(scale, 1e-300) * old)
    flip = np.linalg.det(U @ V)
    U[:, :, -1] *= flip[:, None]
    R = np.swapaxes(U @ V, 1, 2)
    out[:, :dim, :dim] = R
    out[:, :3, 3] = place - out[:, :3, :3] @ middle
    return out
