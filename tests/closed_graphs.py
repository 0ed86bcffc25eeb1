"""Random mechanisms with loops that are closed by construction, at known values of all coordinates.

Poses are those of `reference`: the frame on the child of each joint that closes a loop is put where
the values of its coordinates want it. The same mechanism can be built with other joints cut, and
with each joint taken apart into elementary ones with bodies between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import reference
from own_joints import random_product, random_type, variants

from kempe import Mechanism, System
from kempe.joints import TYPES, JointType, P, Primitive, Q, R, make_joint_type
from kempe.poses import make_placement_from_pose

ELEMENTARY = ("revolute", "prismatic", "spherical")
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Link:
    """A joint of a closed mechanism: its frames F and M on the two bodies, and values of its
    coordinates.

    A slide along z in the plane goes along `axis`, a direction (2,) in the axes of F.
    """

    name: str
    kind: JointType
    parent: str
    child: str
    F: np.ndarray
    M: np.ndarray
    values: np.ndarray
    axis: tuple[float, float] | None = None


@dataclass(frozen=True)
class Closed:
    """A mechanism with loops as data, closed at the values of its links."""

    dim: int
    bodies: tuple[str, ...]
    links: tuple[Link, ...]

    def system(self, cut: frozenset[str] = frozenset(), apart: bool = False) -> System:
        """The system with the joints `cut` marked; `apart`: each joint as a chain of elementary
        ones.
        """
        m = Mechanism("closed", self.dim)
        for body in self.bodies:
            m.body(body)
        for link in self.links:
            if apart:
                _chain(m, link, link.name in cut)
            else:
                m.joint(
                    link.name,
                    link.kind,
                    link.parent,
                    link.child,
                    cut=link.name in cut,
                    **_places(m, link),
                )
        return m.build()

    def values(self, system: System, apart: bool = False) -> np.ndarray:
        """The closed configuration (nq,)."""
        known = {}
        for link in self.links:
            names, primitives = link.kind.layout(self.dim)
            if apart:
                for place, p in _firsts(primitives).items():
                    name = f"{link.name}:{place}"
                    size = 4 if p.kind == Q else 1
                    own = link.values[p.coordinate : p.coordinate + size]
                    if p.kind == Q:
                        known |= {
                            f"{name}.{c}": x
                            for c, x in zip(("qw", "qx", "qy", "qz"), own, strict=True)
                        }
                    else:
                        known[name] = p.multiplier * own[0]
            else:
                known |= {
                    f"{link.name}.{n}" if n else link.name: x
                    for n, x in zip(names, link.values, strict=True)
                }
        return system.q(known)

    def open_by(self, system: System, q: np.ndarray) -> float:
        """How far (entries of poses) any joint is open at q, by poses that `reference` computes
        along the tree.
        """
        joints = {link.name: link for link in self.links}
        at = system.q_dict(q)
        motions = {}
        for name, link in joints.items():
            names = [f"{name}.{n}" if n else name for n in link.kind.layout(self.dim)[0]]
            motions[name] = pose_of(
                link.kind.layout(self.dim)[1],
                [at[n] for n in names],
                self.dim,
                link.axis,
            )
        tree = system.structure
        steps = [
            (joints[n].F, motions[n], joints[n].M, back)
            for n, back in zip(tree.parent_joints, tree.topology.reversed_, strict=True)
        ]
        poses = dict(
            zip(system.body_names, reference.tree_poses(system.parent, steps), strict=True)
        )
        gaps = [
            np.abs(poses[k.parent] @ k.F @ motions[k.name] - poses[k.child] @ k.M).max()
            for k in self.links
        ]
        return float(max(gaps))


def pose_of(
    primitives: Sequence[Primitive],
    values: Sequence[float],
    dim: int = 3,
    axis: tuple[float, float] | None = None,
) -> np.ndarray:
    """X_FM of primitives, multiplied out by the reference."""
    X = np.eye(4, dtype=np.longdouble)
    for p in primitives:
        if p.kind == Q:
            X = X @ reference.ball(*values[p.coordinate : p.coordinate + 4])
        elif p.kind == R:
            X = X @ reference.turn(p.axis, p.multiplier * values[p.coordinate])
        elif dim == 2 and p.axis == "z":
            assert axis is not None
            s = p.multiplier * values[p.coordinate]
            X = X @ reference.slide("x", axis[0] * s) @ reference.slide("y", axis[1] * s)
        else:
            X = X @ reference.slide(p.axis, p.multiplier * values[p.coordinate])
    return X


def from_table(rng: np.random.Generator, dim: int) -> JointType:
    """A random type of the table of joints with random options."""
    kinds = [t for t in TYPES.values() if dim == 3 or t.planar]
    options = variants(
        kind := kinds[int(rng.integers(len(kinds)))], round(float(rng.uniform(-1, 1)), 2)
    )
    return kind(**options[int(rng.integers(len(options)))])


def closed(
    rng: np.random.Generator,
    dim: int,
    bodies: int,
    kinds: list[JointType],
    backwards: bool | None = None,
    ring: bool = False,
) -> Closed:
    """A closed mechanism whose joints have these kinds in turn: those of a tree first, then those
    that close loops.

    `backwards`: joints go from the outer body to the inner one; by chance where None. `ring`: the
    tree is one chain.
    """
    names = tuple(f"b{i}" for i in range(bodies))
    poses = {"ground": np.eye(4, dtype=np.longdouble)}
    links = []
    for k, kind in enumerate(kinds):
        if k < bodies:
            a = ["ground", *names][k if ring else int(rng.integers(max(k - 1, 0), k + 1))]
            b = names[k]
        elif k == bodies:
            a = names[-1]
            b = "ground"
        else:
            a, b = (str(x) for x in rng.choice(["ground", *names], 2, replace=False))
        if rng.random() < 0.5 if backwards is None else backwards:
            a, b = b, a
        values = rng.uniform(-1.2, 1.2, len(kind.layout(dim)[0]))
        for p in kind.layout(dim)[1]:
            if p.kind == Q:
                ball = rng.normal(size=4)
                values[p.coordinate : p.coordinate + 4] = ball / np.linalg.norm(ball)
        angle = float(rng.uniform(-3, 3))
        along = (np.cos(angle), np.sin(angle)) if dim == 2 and _slider(kind) else None
        motion = pose_of(kind.layout(dim)[1], values.tolist(), dim, along)
        F = _random(rng, dim)
        M = _random(rng, dim)
        if a in poses and b in poses:
            M = reference.inverse(poses[b]) @ poses[a] @ F @ motion
        elif a in poses:
            poses[b] = poses[a] @ F @ motion @ reference.inverse(M)
        else:
            poses[a] = poses[b] @ M @ reference.inverse(F @ motion)
        links.append(Link(f"j{k}", kind, a, b, F, M, values, along))
    return Closed(dim, names, tuple(links))


def random_closed(rng: np.random.Generator, own: float = 0.4) -> Closed:
    """A random closed mechanism: joints of the table and, a part `own` of them, of random types
    and products in words, in one to three loops.

    It has freedoms to spare, so that it does not close at one place only.
    """
    dim = int(rng.choice([2, 3, 3]))
    bodies = int(rng.integers(2, 6))
    loops = int(rng.integers(1, 4))
    kinds: list[JointType] = []
    for k in range(bodies + loops):
        where = rng.random()
        product = where < 0.5 * own
        kinds.append(
            make_joint_type(random_product(rng, dim))
            if product
            else random_type(rng, f"own{k}", dim)
            if where < own
            else from_table(rng, dim)
        )
    return closed(rng, dim, bodies, kinds)


def _random(rng: np.random.Generator, dim: int) -> np.ndarray:
    xyz = rng.uniform(-1, 1, 3).tolist()
    rpy = rng.uniform(-1.5, 1.5, 3).tolist()
    return reference.placement(xyz[:dim], rpy if dim == 3 else (0.0, 0.0, rpy[2]))


def stays_in_plane(kind: JointType) -> bool:
    """Whether a joint of this kind can be used in the plane."""
    steps = kind.layout(2)[1]
    flat = all((p.kind == R and p.axis == "z") or (p.kind == P and p.axis != "z") for p in steps)
    return flat or all(p.kind == P and p.axis == "z" for p in steps)


def _slider(kind: JointType) -> bool:
    return any(p.kind == P and p.axis == "z" for p in kind.layout(2)[1])


def _flat(X: np.ndarray) -> tuple[list[float], float]:
    return [float(X[0, 3]), float(X[1, 3])], float(np.arctan2(X[1, 0], X[0, 0]))


def _places(m: Mechanism, link: Link) -> dict[str, Any]:
    if m.dim == 3:
        return {"at": _placement(link.F), "child_at": _placement(link.M)}
    (at, angle) = _flat(link.F)
    (child_at, child_angle) = _flat(link.M)
    axis = {} if link.axis is None else {"axis": link.axis}
    return {"at": at, "angle": angle, "child_at": child_at, "child_angle": child_angle, **axis}


def _placement(X: np.ndarray):
    return make_placement_from_pose(np.asarray(X, dtype=float))


def _firsts(primitives: Sequence[Primitive]) -> dict[int, Primitive]:
    """The first primitive of each coordinate, by its place among all."""
    out: dict[int, Primitive] = {}
    for place, p in enumerate(primitives):
        if all(p.coordinate != o.coordinate for o in out.values()) and p.multiplier:
            out[place] = p
    return out


def _chain(m: Mechanism, link: Link, cut: bool) -> None:
    """A joint as a chain of elementary ones through bodies of their own; those that share a
    coordinate are geared.
    """
    primitives = link.kind.layout(m.dim)[1]
    if not primitives:
        m.joint(link.name, "fixed", link.parent, link.child, cut=cut, **_places(m, link))
        return
    firsts = _firsts(primitives)
    here = link.parent
    for k, p in enumerate(primitives):
        last = k == len(primitives) - 1
        there = link.child if last else m.body(f"{link.name}/{k}").name
        F = link.F if k == 0 else np.eye(4)
        M = link.M if last else np.eye(4)
        one = Link(
            f"{link.name}:{k}", link.kind, here, there, F, M, link.values, _along(m.dim, link, p)
        )
        places: dict[str, Any] = _places(m, one)
        if m.dim == 3:
            places = {"at": _placement(F @ _turned(p)), "child_at": _placement(M @ _turned(p))}
        m.joint(one.name, ELEMENTARY[p.kind], here, there, cut=cut and last, **places)
        if k not in firsts and p.kind != Q:
            source, first = next((i, f) for i, f in firsts.items() if f.coordinate == p.coordinate)
            m.gear(one.name, f"{link.name}:{source}", p.multiplier / first.multiplier)
        here = there


def _along(dim: int, link: Link, p: Primitive) -> tuple[float, float] | None:
    if dim == 3 or p.kind != P:
        return None
    return link.axis if p.axis == "z" else AXES[p.axis][:2]


def _turned(p: Primitive) -> np.ndarray:
    """The pose whose z is the axis of a primitive."""
    if p.kind == Q or p.axis == "z":
        return np.eye(4)
    return np.asarray(
        reference.turn("y", np.pi / 2) if p.axis == "x" else reference.turn("x", -np.pi / 2),
        dtype=float,
    )
