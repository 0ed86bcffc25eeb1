"""Counts of assembly modes that share nothing with Kempe: Newton on squared lengths, and closed
forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kempe import Mechanism, System


@dataclass
class Framework:
    """Particles in the plane: `points` as built, `pinned` ones on the ground, `edges` of fixed
    length.
    """

    points: np.ndarray
    edges: list[tuple[int, int]]
    pinned: tuple[int, ...]

    @property
    def free(self) -> list[int]:
        return [i for i in range(len(self.points)) if i not in self.pinned]

    def system(self, place: str = "translation") -> System:
        m = Mechanism("framework", dim=2)
        for i in self.free:
            m.particle(f"p{i}")
            m.joint(f"at p{i}", place, m.ground, f"p{i}")
        for n, (i, k) in enumerate(self.edges):
            i, k = (k, i) if k in self.pinned else (i, k)
            length = float(np.linalg.norm(self.points[i] - self.points[k]))
            if i in self.pinned:
                m.distance(f"d{n}", m.ground, f"p{k}", length, at=tuple(self.points[i]))
            else:
                m.distance(f"d{n}", f"p{i}", f"p{k}", length)
        return m.build()

    def places(self, system: System, q: np.ndarray) -> np.ndarray:
        """Places (n, free, 2) of the free points."""
        return np.stack([system.fk(q, f"p{i}")[:, :2, 3] for i in self.free], axis=1)

    def modes(self, rng: np.random.Generator, starts: int) -> np.ndarray:
        """All places (n, free, 2) at which Newton's method on the squared lengths ends, from so
        many starts.
        """
        free = self.free
        at = {p: n for n, p in enumerate(free)}
        x = np.tile(self.points, (starts, 1, 1))
        x[:, free] = rng.normal(size=(starts, len(free), 2)) * 1.5
        i, k = np.array(self.edges).T
        squares = np.sum((self.points[i] - self.points[k]) ** 2, axis=1)
        for step in range(60):
            d = x[:, i] - x[:, k]
            error = np.sum(d * d, axis=2) - squares
            J = np.zeros((starts, len(i), len(free), 2))
            for e, (a, b) in enumerate(self.edges):
                if a in at:
                    J[:, e, at[a]] += 2 * d[:, e]
                if b in at:
                    J[:, e, at[b]] -= 2 * d[:, e]
            J = J.reshape(starts, len(i), -1)
            JT = np.swapaxes(J, 1, 2)
            damping = 1e-3 * np.sum(error**2, axis=1)[:, None, None] + 1e-300
            damping = np.minimum(damping, 0.5**step) + 1e-11
            move = (JT @ np.linalg.solve(J @ JT + damping * np.eye(len(i)), error[..., None]))[
                ..., 0
            ]
            move /= np.maximum(1.0, np.linalg.norm(move, axis=1, keepdims=True))
            x[:, free] -= move.reshape(starts, len(free), 2)
        good = np.abs(error).max(axis=1) < 1e-9
        found: list[np.ndarray] = []
        for place in x[good][:, free]:
            if all(np.abs(place - f).max() > 1e-5 for f in found):
                found.append(place)
        return np.array(found)


def k33(rng: np.random.Generator) -> Framework:
    """The complete bipartite graph on three and three points, one edge on the ground's x axis."""
    points = rng.uniform(-1, 1, (6, 2))
    points[0] = 0
    points[3] = np.linalg.norm(points[3]), 0
    edges = [(i, k) for i in range(3) for k in range(3, 6) if (i, k) != (0, 3)]
    return Framework(points, edges, (0, 3))


def prism(rng: np.random.Generator) -> Framework:
    """Two triangles and three rods between them; one edge on the ground."""
    points = rng.uniform(-1, 1, (6, 2))
    points[0] = 0
    points[1] = np.linalg.norm(points[1]), 0
    edges = [(0, 2), (1, 2), (3, 4), (4, 5), (3, 5), (0, 3), (1, 4), (2, 5)]
    return Framework(points, edges, (0, 1))


def six_sps(rng: np.random.Generator, flat: bool) -> tuple[System, dict[str, float]]:
    """A platform on six telescopic legs between balls, with the legs' lengths; base and platform
    may be flat.
    """
    m = Mechanism("6-SPS")
    body = m.body("platform")
    base = rng.uniform(-1, 1, (6, 3))
    ends = rng.uniform(-0.6, 0.6, (6, 3))
    if flat:
        base[:, 2] = ends[:, 2] = 0.0
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    p = rng.uniform(-0.5, 0.5, 3) + [0, 0, 0.7]
    known = {}
    for i in range(6):
        m.spherical(f"A{i}", m.ground, m.body(f"low{i}"), at=tuple(base[i]))
        m.prismatic(f"leg{i}", f"low{i}", m.body(f"high{i}"), axis=(1, 0, 0))
        m.spherical(f"B{i}", f"high{i}", body, child_at=tuple(ends[i]))
        known[f"leg{i}"] = float(np.linalg.norm(R @ ends[i] + p - base[i]))
    return m.build(), known


@dataclass
class Rssr:
    """A crank about z at the origin, a rod, and a rocker about its own axis; lengths and places are
    random.
    """

    crank: float
    rocker: float
    place: np.ndarray
    axis: np.ndarray
    angle: float
    rod: float

    @classmethod
    def random(cls, rng: np.random.Generator) -> Rssr:
        axis = rng.normal(size=3)
        r = cls(
            *rng.uniform(0.1, 1.0, 2),
            rng.uniform(-1, 1, 3),
            axis / np.linalg.norm(axis),
            rng.uniform(-3, 3),
            0.0,
        )
        r.rod = float(np.linalg.norm(r.end(rng.uniform(-3, 3)) - r.start(r.angle)))
        return r

    def start(self, angle: float) -> np.ndarray:
        return self.crank * np.array([np.cos(angle), np.sin(angle), 0.0])

    def frame(self) -> np.ndarray:
        x = np.cross(self.axis, np.eye(3)[np.argmin(np.abs(self.axis))])
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(self.axis, x), self.axis], axis=1)

    def end(self, angle: float) -> np.ndarray:
        x, y, _ = self.frame().T
        return self.place + self.rocker * (np.cos(angle) * x + np.sin(angle) * y)

    def angles(self) -> np.ndarray:
        """Both angles of the rocker: |place + rocker (cos x + sin y) - start| = rod is a cos + b
        sin = c.
        """
        x, y, _ = self.frame().T
        d = self.place - self.start(self.angle)
        a = 2 * self.rocker * (d @ x)
        b = 2 * self.rocker * (d @ y)
        c = self.rod**2 - self.rocker**2 - d @ d
        middle = np.arctan2(b, a)
        off = np.arccos(np.clip(c / np.hypot(a, b), -1, 1))
        return np.sort(np.angle(np.exp(1j * np.array([middle - off, middle + off]))))
