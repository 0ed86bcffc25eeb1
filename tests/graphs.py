"""Random connected graphs of bodies and joints, and their poses by the reference."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import reference
from hypothesis import strategies as st
from own_joints import PRODUCTS, variants

from kempe import Mechanism, System
from kempe.joints import TYPES, P, make_joint_type
from kempe.model.implicit_form import has_slide_along_z

KINDS: list[tuple[str, dict]] = [(name, o) for name, t in TYPES.items() for o in variants(t, 0.3)]
PLANAR_KINDS: list[tuple[str, dict]] = [(name, {}) for name, t in TYPES.items() if t.planar]
SLIDES: list[tuple[str, dict]] = [
    (name, {})
    for name, t in TYPES.items()
    if t.planar and all(p.kind == P for p in t().layout(3, True)[1])
]
KINDS += [(words, {}) for words in PRODUCTS]
PLANAR_KINDS += [("P(x) R(z)", {}), ("R(z) P(y) R(z)", {}), ("P(y) P(x)", {})]
SLIDES += [("P(y) P(x)", {}), ("P(y)", {})]
"""Joint types in space, in the plane, and for particles."""


@dataclass(frozen=True)
class Edge:
    """One joint of a random graph; `at` are x, y, z, roll, pitch, yaw of F and then of M."""

    name: str
    kind: str
    parent: str
    child: str
    at: tuple[float, ...]
    options: dict = field(default_factory=dict)
    actuated: bool | None = None
    cut: bool = False


@dataclass(frozen=True)
class Graph:
    """A connected graph of bodies, particles and joints, in an order of declaration."""

    bodies: tuple[str, ...]
    edges: tuple[Edge, ...]
    particles: tuple[str, ...] = ()
    gears: tuple[tuple[str, str, float, float], ...] = ()
    locks: tuple[tuple[str, float], ...] = ()
    dim: int = 3

    def mechanism(self) -> Mechanism:
        m = Mechanism("graph", self.dim)
        for body in self.bodies:
            m.body(body)
        for particle in self.particles:
            m.particle(particle)
        for e in self.edges:
            where = {"at": e.at[:3], "rpy": e.at[3:6], "child_at": e.at[6:9], "child_rpy": e.at[9:]}
            if self.dim == 2:
                where = {
                    "at": e.at[:2],
                    "angle": e.at[5],
                    "child_at": e.at[6:8],
                    "child_angle": e.at[11],
                }
            if e.child in self.particles:
                where = {k: v for k, v in where.items() if not k.startswith("child")}
            if self.dim == 2 and has_slide_along_z(make_joint_type(e.kind, **e.options), 2, False):
                where["axis"] = (0.6, -0.8)
            m.joint(
                e.name,
                e.kind,
                e.parent,
                e.child,
                actuated=e.actuated,
                cut=e.cut,
                **e.options,
                **where,
            )
        for of, source, ratio, offset in self.gears:
            m.gear(of, source, ratio, offset)
        return m.lock(dict(self.locks))

    def shuffled(self, seed: int) -> Graph:
        """The same graph, declared in another order."""
        rng = np.random.default_rng(seed)
        mixed = {
            name: tuple(getattr(self, name)[i] for i in rng.permutation(len(getattr(self, name))))
            for name in ("bodies", "edges", "particles", "gears", "locks")
        }
        return replace(self, **mixed)

    def ends(self, e: Edge) -> tuple[np.ndarray, np.ndarray]:
        """X_PF and X_CM of a joint."""
        if self.dim == 2:
            X_PF = reference.placement(e.at[:2], (0, 0, e.at[5]))
            X_CM = reference.placement(e.at[6:8], (0, 0, e.at[11]))
        else:
            X_PF = reference.placement(e.at[:3], e.at[3:6])
            X_CM = reference.placement(e.at[6:9], e.at[9:])
        return X_PF, np.eye(4, dtype=X_PF.dtype) if e.child in self.particles else X_CM

    def joint_pose(self, e: Edge, values: dict[str, float]) -> np.ndarray:
        """Motion of a joint between its two placements, from the values of all coordinates by name."""
        particle = e.child in self.particles
        names = make_joint_type(e.kind, **e.options).list_coordinate_names(self.dim, particle)
        q = [values[f"{e.name}.{c}" if c else e.name] for c in names]
        if self.dim == 2 and has_slide_along_z(make_joint_type(e.kind, **e.options), 2, False):
            return reference.slide("x", 0.6 * q[0]) @ reference.slide("y", -0.8 * q[0])
        return reference.joint_pose(e.kind, q, dim=self.dim, particle=particle, **e.options)

    def values(self, system: System, q: np.ndarray) -> dict[str, float]:
        """Values of all coordinates by name, those that follow or are locked included."""
        couplings = {of: ({source: ratio}, offset) for of, source, ratio, offset in self.gears}
        return reference.coordinate_values(system.q_dict(q), couplings, dict(self.locks))

    def poses(self, system: System, q: np.ndarray) -> dict[str, np.ndarray]:
        """Poses of all bodies by name at one configuration, by the reference, along the tree of the
        system.
        """
        values = self.values(system, q)
        edges = {e.name: e for e in self.edges}
        joints = []
        for name, backwards in zip(
            system.structure.parent_joints, system.structure.topology.reversed_, strict=True
        ):
            X_PF, X_CM = self.ends(edges[name])
            joints.append((X_PF, self.joint_pose(edges[name], values), X_CM, backwards))
        poses = dict(
            zip(system.body_names, reference.tree_poses(system.parent, joints), strict=True)
        )
        for name in self.particles:
            poses[name][:3, :3] = np.eye(3)
        return {name: np.asarray(X, dtype=float) for name, X in poses.items()}


@st.composite
def graphs(draw: st.DrawFn, most: int = 9, loops: int = 5, dims: tuple[int, ...] = (2, 3)) -> Graph:
    """Graphs of up to `most` bodies, with some particles, gears and locks."""
    dim = draw(st.sampled_from(dims))
    n = draw(st.integers(1, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    names = [f"b{i}" for i in rng.permutation(n)]
    everyone = ["ground", *names]
    edges: list[Edge] = []

    def edge(name: str, a: str, b: str, kinds: list[tuple[str, dict]]) -> Edge:
        kind, options = kinds[int(rng.integers(len(kinds)))]
        actuated = [None, None, True, False][int(rng.integers(4))]
        return Edge(
            name,
            kind,
            a,
            b,
            tuple(rng.uniform(-1, 1, 12).round(3).tolist()),
            options,
            actuated,
            bool(rng.random() < 0.15),
        )

    for k in range(n + draw(st.integers(0, loops))):
        a = everyone[int(rng.integers(0, min(k, n) + 1))]
        b = names[k] if k < n else everyone[int(rng.integers(0, n + 1))]
        if a != b:
            a, b = (a, b) if rng.random() < 0.6 else (b, a)
            edges.append(
                edge(f"j{int(rng.integers(0, 10))}_{k}", a, b, KINDS if dim == 3 else PLANAR_KINDS)
            )
    particles: list[str] = []
    gears: list[tuple[str, str, float, float]] = []
    locks: list[tuple[str, float]] = []
    for i in range(int(rng.integers(0, 3))):
        particles.append(f"p{i}")
        for k in range(int(rng.integers(1, 3))):
            edges.append(edge(f"s{i}{k}", everyone[int(rng.integers(0, n + 1))], f"p{i}", SLIDES))
    single = [e.name for e in edges if make_joint_type(e.kind).list_coordinate_names() == ("",)]
    rng.shuffle(single)
    while len(single) > 2 and rng.random() < 0.6:
        gears.append((single.pop(), single[0], round(rng.normal(), 3), round(rng.normal(), 3)))
    if len(single) > 1 and rng.random() < 0.4:
        locks.append((single[0], 0.7))
    order = rng.permutation(len(edges))
    return Graph(
        tuple(rng.permutation(names).tolist()),
        tuple(edges[i] for i in order),
        tuple(particles),
        tuple(gears),
        tuple(locks),
        dim,
    )
