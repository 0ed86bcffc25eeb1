"""A system with loops, written out plainly for libraries that know trees and points: its spanning
tree and its cuts.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.errors import UnsupportedError
from kempe.kernels.forward.table_layout import BALL, SLIDE, TURN
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.implicit_form import find_implicit_form

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.system import System


@dataclass(frozen=True)
class Move:
    """One elementary motion of the tree: kind and axis (0, 1, 2), its column in q, and +1 or,
    walked backwards, -1.
    """

    name: str
    kind: int
    axis: int
    column: int
    sign: int

    @property
    def size(self) -> int:
        """How many coordinates it has: four for a quaternion."""
        return 4 if self.kind == BALL else 1


@dataclass(frozen=True)
class Limb:
    """A body of the tree: its parent's number, the placement before its moves, the moves, the
    placement after them.
    """

    name: str
    parent: int
    before: spatial.Array
    moves: tuple[Move, ...]
    after: spatial.Array


@dataclass(frozen=True)
class Link:
    """A joint between two bodies by their numbers, with its frames on them."""

    joint: Joint
    a: int
    X_a: spatial.Array
    b: int
    X_b: spatial.Array

    def opening(self, X: list[spatial.Array]) -> spatial.Array:
        """How far (...) the joint is from assembled, in metres and sines of angles, for poses X of
        all bodies.
        """
        between = spatial.inverse(X[self.a] @ self.X_a) @ (X[self.b] @ self.X_b)
        form = find_implicit_form(self.joint.type)
        if form is None:
            raise UnsupportedError(f"joint {self.joint.name!r} has no implicit form")
        slides = form.position
        turns = form.turns
        held = ["xyz".index(axis) for axis in slides]
        R = between[..., :3, :3]
        errors = [np.linalg.norm(between[..., held, 3], axis=-1)]
        if turns == "x.y":
            errors.append(np.abs(R[..., 0, 1]))
        elif turns == "xy":
            errors.append(np.where(R[..., 2, 2] > 0.0, np.linalg.norm(R[..., :2, 2], axis=-1), 2.0))
        elif turns == "xyz":
            errors.append(np.linalg.norm(R - np.eye(3), axis=(-1, -2)))
        return np.max(errors, axis=0)


class Tree:
    """The spanning tree of a system, and its cuts. Coordinates x (..., nx) are those of its moves,
    quaternions wxyz.

    Errors: `UnsupportedError` for what the other libraries have no counterpart of.
    """

    def __init__(self, system: System):
        beside = [
            *system.structure.couplings,
            *system.mechanism.constraints,
            *(r.of for r in system.structure.relations),
        ]
        if beside:
            raise UnsupportedError(f"{system.name}: {beside[0]} is tied by more than joints")
        self.system = system
        self.columns = {name: i for i, name in enumerate(system.coordinate_names)}
        self.numbers = {name: i for i, name in enumerate(system.body_names)}
        self.links = {joint.name: self._link(joint) for joint in system.structure.joints.values()}
        self.limbs = tuple(self._limb(i) for i in range(len(system.parent)))
        self.moves = tuple(m for limb in self.limbs for m in limb.moves)
        self.firsts = np.cumsum([0, *(m.size for m in self.moves)])
        self.nx = int(self.firsts[-1])
        self.cuts = tuple(self.links[name] for name in system.structure.closures)

    def _link(self, joint: Joint) -> Link:
        X_a, X_b = (
            place.evaluate_pose(self.system.structure.parameters)
            for place in (joint.X_PF, joint.X_CM)
        )
        return Link(joint, self.numbers[joint.parent], X_a, self.numbers[joint.child], X_b)

    def _limb(self, i: int) -> Limb:
        system = self.system
        back = self.system.structure.topology.reversed_[i]
        link = self.links[system.structure.parent_joints[i]]
        names = system.structure.coordinates_of_joint(link.joint.name)
        moves = []
        for k, p in enumerate(link.joint.type.layout(system.dim)[1]):
            if p.multiplier != 1.0:
                raise UnsupportedError(
                    f"{system.name}: joint {link.joint.name!r} couples a turn and a slide"
                )
            column = self.columns[names[p.coordinate]]
            axis = "xyz".index(p.axis)
            moves.append(Move(f"{link.joint.name}_{k}", p.kind, axis, column, -1 if back else 1))
        ends = (link.X_b, link.X_a) if back else (link.X_a, link.X_b)
        order = tuple(reversed(moves)) if back else tuple(moves)
        return Limb(
            system.body_names[i + 1], system.parent[i], ends[0], order, spatial.inverse(ends[1])
        )

    def points(self, cut: Link) -> spatial.Array:
        """Points (k, 3) of both frames of a cut joint that coincide where it is assembled, and only
        there.

        One for a ball joint, and for a hinge in the plane; two, a typical length apart, for a hinge
        in space.
        """
        kind = cut.joint.type.type_name
        if kind not in ("revolute", "spherical"):
            reported = "only hinges and ball joints can be given by points"
            raise UnsupportedError(
                f"{self.system.name}: joint {cut.joint.name!r} is cut, and {kind}; {reported}"
            )
        if kind == "spherical" or self.system.dim == 2:
            return np.zeros((1, 3))
        return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, compute_characteristic_length(self.system)]])

    @cached_property
    def in_tree(self) -> np.ndarray:
        """Which velocity coordinates (nv,) of the system belong to the tree."""
        cut = set()
        for link in self.cuts:
            names = link.joint.type.list_velocity_names(self.system.dim)
            cut |= {f"{link.joint.name}.{v}" if v else link.joint.name for v in names}
        return np.array([name not in cut for name in self.system.structure.velocity_names])

    def guesses(self, sigma: float, n: int, known: Iterable[str] = ()) -> spatial.Array:
        """Configurations q (n, nq): the posture 'closed' with normal noise on all coordinates of
        the tree not known.
        """
        system = self.system
        held = set(known)
        moved = self.in_tree & np.array(
            [name not in held for name in system.structure.velocity_names]
        )
        noise = sigma * np.random.default_rng(7).normal(size=(n, system.nv)) * moved
        return system.configuration_space.integrate(system.q("closed"), noise)

    def coordinates(self, q: spatial.Array) -> spatial.Array:
        """Coordinates x (..., nx) of the moves at configurations q (..., nq)."""
        x = np.empty((*q.shape[:-1], self.nx))
        for move, first in zip(self.moves, self.firsts, strict=False):
            part = q[..., move.column : move.column + move.size]
            if move.kind == BALL:
                part = spatial.unit(part) * [1, move.sign, move.sign, move.sign]
            else:
                part = part * move.sign
            x[..., first : first + move.size] = part
        return x

    def poses(self, x: spatial.Array) -> list[spatial.Array]:
        """Poses (..., 4, 4) of all bodies, the ground first, by plain products."""
        out: list[spatial.Array] = [np.broadcast_to(np.eye(4), (*x.shape[:-1], 4, 4))]
        firsts = iter(self.firsts.tolist())
        for limb in self.limbs:
            X = out[limb.parent] @ limb.before
            for move in limb.moves:
                first = next(firsts)
                X = X @ motion(move, x[..., first : first + move.size])
            out.append(X @ limb.after)
        return out

    def opening(self, x: spatial.Array) -> spatial.Array:
        """How far (...) the worst cut joint is from assembled: an independent check."""
        return worst(self.cuts, self.poses(x))


def worst(links: Iterable[Link], X: list[spatial.Array]) -> spatial.Array:
    """The largest opening (...) of some joints, for poses X of all bodies."""
    return np.max([np.zeros(X[0].shape[:-2]), *(link.opening(X) for link in links)], axis=0)


def motion(move: Move, x: spatial.Array) -> spatial.Array:
    """Pose (..., 4, 4) of one elementary motion at its coordinates x (..., 1 or 4)."""
    if move.kind == BALL:
        return spatial.pose(spatial.quat_wxyz_to_matrix(x))
    if move.kind == TURN:
        return spatial.pose((spatial.rot_x, spatial.rot_y, spatial.rot_z)[move.axis](x[..., 0]))
    return spatial.pose(None, x * np.eye(3)[move.axis])


# ---- MJCF


def mjcf(tree: Tree, sparse: bool = False) -> str:
    """The tree as an MJCF document: nested bodies, and for each point of a cut two sites that a
    `connect` joins.

    Sites, since a `connect` of bodies takes the reference position, which is not assembled, for
    assembled. With `sparse` MuJoCo keeps the Jacobian of the constraints as a sparse matrix.
    """
    root = ElementTree.Element("mujoco", model=tree.system.name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false")
    option = ElementTree.SubElement(
        root, "option", gravity="0 0 0", jacobian="sparse" if sparse else "dense"
    )
    ElementTree.SubElement(option, "flag", contact="disable")
    bodies = [ElementTree.SubElement(root, "worldbody")]
    offsets = [np.eye(4)]
    for limb in tree.limbs:
        X = offsets[limb.parent] @ limb.before
        at = {
            "name": limb.name,
            "pos": _text(X[:3, 3]),
            "quat": _text(spatial.matrix_to_quat_wxyz(X[:3, :3])),
        }
        body = ElementTree.SubElement(bodies[limb.parent], "body", at)
        ElementTree.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        for move in limb.moves:
            kind = {TURN: "hinge", SLIDE: "slide", BALL: "ball"}[move.kind]
            axis = {} if move.kind == BALL else {"axis": _text(np.eye(3)[move.axis])}
            ElementTree.SubElement(body, "joint", axis, name=move.name, type=kind)
        bodies.append(body)
        offsets.append(limb.after)
    equality = ElementTree.SubElement(root, "equality")
    for cut in tree.cuts:
        for k, point in enumerate(tree.points(cut)):
            sites = {}
            for side, number, X in (("site1", cut.a, cut.X_a), ("site2", cut.b, cut.X_b)):
                place = offsets[number] @ X @ np.append(point, 1.0)
                sites[side] = f"{cut.joint.name}_{k}_{side}"
                ElementTree.SubElement(
                    bodies[number], "site", name=sites[side], pos=_text(place[:3])
                )
            ElementTree.SubElement(equality, "connect", sites)
    return ElementTree.tostring(root, encoding="unicode")


def _text(numbers: spatial.Array) -> str:
    return " ".join(repr(float(x)) for x in numbers)
