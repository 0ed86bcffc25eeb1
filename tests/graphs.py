"""Random connected graphs of bodies and joints, and their poses by the reference."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import reference
from hypothesis import strategies as st

from kempe import Mechanism, System
from kempe.joints import joint_type

KINDS: list[tuple[str, dict]] = [
    ("fixed", {}), ("revolute", {}), ("prismatic", {}), ("helical", {"pitch": 0.3}), ("cylindrical", {}),
    ("universal", {}), ("planar", {}), ("translation", {}), ("spherical", {}), ("spherical", {"angles": True}),
    ("free", {}), ("free", {"angles": True}),
]  # fmt: skip


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

    def mechanism(self) -> Mechanism:
        m = Mechanism("graph")
        for body in self.bodies:
            m.body(body)
        for particle in self.particles:
            m.particle(particle)
        for e in self.edges:
            ends = {} if e.child in self.particles else {"child_at": e.at[6:9], "child_rpy": e.at[9:]}
            m.joint(e.name, e.kind, e.parent, e.child, at=e.at[:3], rpy=e.at[3:6], actuated=e.actuated, cut=e.cut,
                    **e.options, **ends)  # fmt: skip
        for of, source, ratio, offset in self.gears:
            m.gear(of, source, ratio, offset)
        return m.lock(dict(self.locks))

    def shuffled(self, seed: int) -> Graph:
        """The same graph, declared in another order."""
        rng = np.random.default_rng(seed)
        mixed = {name: tuple(getattr(self, name)[i] for i in rng.permutation(len(getattr(self, name))))
                 for name in ("bodies", "edges", "particles", "gears", "locks")}  # fmt: skip
        return replace(self, **mixed)

    def poses(self, system: System, q: np.ndarray) -> dict[str, np.ndarray]:
        """Poses of all bodies by name at one configuration, by the reference, along the tree of the system."""
        free = system.q_dict(q)
        values = reference.coordinate_values(
            free, {of: ({source: ratio}, offset) for of, source, ratio, offset in self.gears}, dict(self.locks)
        )
        edges = {e.name: e for e in self.edges}
        joints = []
        for name, backwards in zip(system.parent_joints, system.topology.reversed_, strict=True):
            e = edges[name]
            particle = e.child in self.particles
            names = joint_type(e.kind, **e.options).coordinates(3, particle)
            local = [values[f"{name}.{c}" if c else name] for c in names]
            X_FM = reference.joint_pose(e.kind, local, particle=particle, **e.options)
            X_CM = np.eye(4) if particle else reference.placement(e.at[6:9], e.at[9:])
            joints.append((reference.placement(e.at[:3], e.at[3:6]), X_FM, X_CM, backwards))
        poses = dict(zip(system.body_names, reference.tree_poses(system.parent, joints), strict=True))
        for name in self.particles:
            poses[name][:3, :3] = np.eye(3)
        return {name: np.asarray(X, dtype=float) for name, X in poses.items()}


@st.composite
def graphs(draw: st.DrawFn, most: int = 9, loops: int = 5, extras: bool = True) -> Graph:
    """Graphs of up to `most` bodies; with `extras` also particles, gears and locks."""
    n = draw(st.integers(1, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    names = [f"b{i}" for i in rng.permutation(n)]
    everyone = ["ground", *names]
    edges: list[Edge] = []

    def edge(name: str, a: str, b: str, kinds: list[tuple[str, dict]]) -> Edge:
        kind, options = kinds[int(rng.integers(len(kinds)))]
        actuated = [None, None, True, False][int(rng.integers(4))]
        return Edge(name, kind, a, b, tuple(rng.uniform(-1, 1, 12).round(3).tolist()), options, actuated,
                    bool(rng.random() < 0.15))  # fmt: skip

    for k in range(n + draw(st.integers(0, loops))):
        a = everyone[int(rng.integers(0, min(k, n) + 1))]
        b = names[k] if k < n else everyone[int(rng.integers(0, n + 1))]
        if a != b:
            a, b = (a, b) if rng.random() < 0.6 else (b, a)
            edges.append(edge(f"j{int(rng.integers(0, 10))}_{k}", a, b, KINDS))
    particles: list[str] = []
    gears: list[tuple[str, str, float, float]] = []
    locks: list[tuple[str, float]] = []
    if extras:
        slides: list[tuple[str, dict]] = [(k, {}) for k in ("fixed", "prismatic", "planar", "translation", "free")]
        for i in range(int(rng.integers(0, 3))):
            particles.append(f"p{i}")
            for k in range(int(rng.integers(1, 3))):
                edges.append(edge(f"s{i}{k}", everyone[int(rng.integers(0, n + 1))], f"p{i}", slides))
        single = [e.name for e in edges if e.kind in ("revolute", "prismatic", "helical")]
        rng.shuffle(single)
        while len(single) > 2 and rng.random() < 0.6:
            gears.append((single.pop(), single[0], round(rng.normal(), 3), round(rng.normal(), 3)))
        if len(single) > 1 and rng.random() < 0.4:
            locks.append((single[0], 0.7))
    order = rng.permutation(len(edges))
    return Graph(tuple(rng.permutation(names).tolist()), tuple(edges[i] for i in order), tuple(particles),
                 tuple(gears), tuple(locks))  # fmt: skip
