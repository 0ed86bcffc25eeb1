"""Mechanisms written down as they stand: all joints by points and axes of the ground, closed at
neutral coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kempe import Mechanism, System
from kempe.poses import make_placement_from_pose

X, Y, Z = np.eye(3)


def unit(a) -> np.ndarray:
    a = np.asarray(a, dtype=float)
    return a / np.linalg.norm(a)


def axes_with(z, x=None) -> np.ndarray:
    """Rotation whose z is along `z`, and whose x is as near to `x` as may be."""
    z = unit(z)
    x = np.eye(3)[np.argmin(np.abs(z))] if x is None else np.asarray(x, dtype=float)
    x = unit(x - z * (x @ z))
    return np.stack([x, np.cross(z, x), z], axis=1)


@dataclass
class World:
    """Joints and constraints in the ground's axes; bodies are made when they are named first.

    `scale` and `move` (4, 4) are applied when it is built.
    """

    name: str
    dim: int = 3
    joints: list[tuple] = field(default_factory=list)
    constraints: list[tuple] = field(default_factory=list)
    points: dict[str, np.ndarray] = field(default_factory=dict)
    couplings: list[tuple[str, dict[str, float]]] = field(default_factory=list)

    def joint(
        self, kind: str, a: str, b: str, at=(0, 0, 0), z=Z, x=None, name: str = "", **options
    ) -> str:
        name = name or f"J{len(self.joints) + 1}"
        self.joints.append(
            (name, kind, a, b, self._point(at), axes_with(self._point(z), x), options)
        )
        return name

    def turn(self, a: str, b: str, at, z=Z, **options) -> str:
        return self.joint("revolute", a, b, at, z, **options)

    def ball(self, a: str, b: str, at, **options) -> str:
        return self.joint("spherical", a, b, at, **options)

    def slide(self, a: str, b: str, along, at=(0, 0, 0), **options) -> str:
        return self.joint("prismatic", a, b, at, along, **options)

    def cross(self, a: str, b: str, at, x, y, **options) -> str:
        """A universal joint that turns about x, then about y."""
        return self.joint("universal", a, b, at, np.cross(x, y), x, **options)

    def particle(self, name: str, at) -> str:
        self.points[name] = self._point(at)
        self.joints.append(
            (f"at {name}", "translation", "ground", name, self.points[name], np.eye(3), {})
        )
        return name

    def rod(self, a: str, b: str, at=None, end=None) -> str:
        at = self.points[a] if at is None else self._point(at)
        end = self.points[b] if end is None else self._point(end)
        return self._constraint("distance", a, b, at, end, Z)

    def line(self, a: str, b: str, at, along) -> str:
        return self._constraint(
            "point_on_line", a, b, self._point(at), self._point(at), self._point(along)
        )

    def plane(self, a: str, b: str, at, normal) -> str:
        return self._constraint(
            "point_on_plane", a, b, self._point(at), self._point(at), self._point(normal)
        )

    def _constraint(self, kind, a, b, at, end, axis) -> str:
        name = f"C{len(self.constraints) + 1}"
        self.constraints.append((name, kind, a, b, at, end, axis))
        return name

    @staticmethod
    def _point(p) -> np.ndarray:
        p = np.asarray(p, dtype=float)
        return np.append(p, 0.0) if len(p) == 2 else p

    def build(self, scale: float = 1.0, move: np.ndarray | None = None) -> System:
        T = np.eye(4) if move is None else move
        d = self.dim
        m = Mechanism(self.name, self.dim)
        for name in dict.fromkeys(b for j in self.joints for b in j[2:4] if b != "ground"):
            (m.particle if name in self.points else m.body)(name)

        def place(p):
            return scale * (T[:3, :3] @ p + T[:3, 3])

        for name, kind, a, b, p, R, options in self.joints:
            K = np.eye(4)
            K[:3, :3] = np.eye(3) if b in self.points else T[:3, :3] @ R
            K[:3, 3] = place(p)
            where = {"at": make_placement_from_pose(K), "child_at": make_placement_from_pose(K)}
            if d == 2:
                where = {"at": K[:2, 3], "child_at": K[:2, 3]}
                if kind == "prismatic":
                    where["axis"] = K[:2, 2]
            if b in self.points:
                del where["child_at"]
            if "pitch" in options:
                options = options | {"pitch": scale * options["pitch"]}
            m.joint(name, kind, a, b, **where, **options)
        for name, kind, a, b, p, end, axis in self.constraints:
            ends = [
                np.zeros(d) if body in self.points else place(x)[:d]
                for body, x in ((a, p), (b, end))
            ]
            if kind == "distance":
                m.distance(
                    name, a, b, scale * float(np.linalg.norm(end - p)), at=ends[0], child_at=ends[1]
                )
            else:
                declare = {"point_on_line": m.point_on_line, "point_on_plane": m.point_on_plane}[
                    kind
                ]
                declare(name, a, b, at=ends[0], child_at=ends[1], axis=(T[:3, :3] @ axis)[:d])
        for of, sources in self.couplings:
            m.couple(of, sources)
        return m.build()


def framework(name: str, points, edges, pinned=(), dim: int = 3) -> World:
    """Particles with rods between them; those that are `pinned` belong to the ground."""
    w = World(name, dim)
    for i, p in enumerate(points):
        if i not in pinned:
            w.particle(f"p{i}", p)
    for i, k in edges:
        if i in pinned and k in pinned:
            continue
        i, k = (k, i) if k in pinned else (i, k)
        if i in pinned:
            w.rod("ground", f"p{k}", at=points[i])
        else:
            w.rod(f"p{i}", f"p{k}")
    return w


def loop(name: str, joints) -> World:
    """A single closed loop of joints (kind, point, axis, options) in this order, the first on the
    ground.
    """
    w = World(name)
    bodies = ["ground", *(f"l{i}" for i in range(1, len(joints)))]
    for i, (kind, p, z, *options) in enumerate(joints):
        w.joint(kind, bodies[i - 1], bodies[i], p, z, **(options[0] if options else {}))
    return w


def on_rods(name: str, base, platform, dim: int = 3) -> World:
    """A platform on rods from points of the base to points of the platform."""
    w = World(name, dim)
    w.joint("free", "ground", "platform")
    for a, b in zip(base, platform, strict=True):
        w.rod("ground", "platform", a, b)
    return w
