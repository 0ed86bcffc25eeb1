"""Random planar mechanisms made of dyads, built around a configuration in which they are closed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kempe import Mechanism, System


def planar(x: float, y: float, angle: float) -> np.ndarray:
    """A pose in the plane (3, 3)."""
    c = np.cos(angle)
    s = np.sin(angle)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def numbers(X: np.ndarray) -> tuple[tuple[float, float], float]:
    """Origin and angle of a pose in the plane."""
    return (float(X[0, 2]), float(X[1, 2])), float(np.arctan2(X[1, 0], X[0, 0]))


@dataclass
class Chain:
    """A mechanism that grows by driven bodies and dyads; `values` closes it, `known` are the
    driving coordinates.
    """

    rng: np.random.Generator
    kinds: list[str] = field(default_factory=list)

    def __post_init__(self):
        self.poses = {"ground": planar(0, 0, 0)}
        self.joints: list[tuple[str, str, str, str, dict]] = []
        self.values: dict[str, float] = {}
        self.known: list[str] = []
        self.two_roots = 0

    def body(self) -> str:
        name = f"b{len(self.poses)}"
        self.poses[name] = planar(*self.rng.uniform(-1, 1, 2), self.rng.uniform(-3, 3))
        return name

    def joint(self, kind: str, a: str, b: str) -> str:
        """A joint of kind R or P between two bodies where they are now, at a random value."""
        rng = self.rng
        name = f"J{len(self.joints) + 1}"
        value = rng.uniform(-2, 2)
        at = rng.uniform(-1, 1, 2)
        angle = rng.uniform(-3, 3)
        axis = rng.normal(size=2)
        axis /= np.linalg.norm(axis)
        motion = planar(0, 0, value) if kind == "R" else planar(*(axis * value), 0)
        M = np.linalg.inv(self.poses[b]) @ self.poses[a] @ planar(*at, angle) @ motion
        child_at, child_angle = numbers(M)
        where = {"at": tuple(at), "angle": angle, "child_at": child_at, "child_angle": child_angle}
        if kind == "P":
            where["axis"] = tuple(axis)
        self.joints.append((name, "revolute" if kind == "R" else "prismatic", a, b, where))
        self.values[name] = value
        return name

    def either(self, kind: str, a: str, b: str) -> str:
        """As `joint`, in a random direction."""
        return self.joint(kind, a, b) if self.rng.random() < 0.5 else self.joint(kind, b, a)

    def drive(self, kind: str) -> None:
        """A body on a known joint."""
        base = str(self.rng.choice(list(self.poses)))
        self.known.append(self.either(kind, base, self.body()))

    def cylinder(self) -> str:
        """Two bodies with a known slider or hinge between them: one link of variable shape."""
        a = self.body()
        b = self.body()
        self.known.append(self.either(str(self.rng.choice(["R", "P"])), a, b))
        return a + " " + b

    def dyad(self, kind: str, variable: bool = False) -> None:
        """Two bodies on what is there, by joints of these kinds on the way round."""
        there = list(self.poses)
        links = [
            (self.cylinder().split() if variable and self.rng.random() < 0.5 else [self.body()])
            for _ in "12"
        ]
        (a, b), (c, d) = ((x[0], x[-1]) for x in links)
        self.either(kind[0], str(self.rng.choice(there)), a)
        self.either(kind[1], b, c)
        self.either(kind[2], d, str(self.rng.choice(there)))
        self.two_roots += kind.count("P") < 2
        self.kinds.append(kind)

    def system(self, ground: str = "ground") -> System:
        """The system, its bodies and joints declared in a random order, with one of its bodies as
        the ground.
        """
        m = Mechanism("chain", dim=2)
        names = {**{b: b for b in self.poses}, "ground": ground, ground: "ground"}
        for name in self.rng.permutation([b for b in self.poses if b != "ground"]):
            m.body(str(name))
        for i in self.rng.permutation(len(self.joints)):
            name, kind, a, b, where = self.joints[i]
            m.joint(name, kind, names[a], names[b], **where)
        return m.build()


DYADS = ("RRR", "RRP", "RPR", "PRR", "RPP", "PRP", "PPR")


def random_chain(
    seed: int, kinds: tuple[str, ...] = DYADS, most: int = 4, variable: bool = True
) -> Chain:
    """A chain of up to `most` dyads of these kinds."""
    rng = np.random.default_rng(seed)
    chain = Chain(rng)
    chain.drive(str(rng.choice(["R", "P"])))
    for _ in range(rng.integers(1, most + 1)):
        if rng.random() < 0.3:
            chain.drive(str(rng.choice(["R", "P"])))
        chain.dyad(str(rng.choice(list(kinds))), variable)
    return chain
