"""Single loops whose components are known by theorem: planar polygons of bars, and two cranks joined by a rod.

Polygons: the configurations of a closed planar chain of n bars, one of them held, are disconnected if and only if there
are three long bars, any two of which are longer together than half of all; then there are two components, mirror images
of one another, and two long bars are never parallel: the side to which the second turns from the first tells them
apart. Source: Kapovich, Millson, "On the moduli space of polygons in the Euclidean plane", J. Differential Geom. 42
(1995), theorem 1. With four bars it is Grashof's rule (1883).

Rods: the ends of two cranks, at angles a and b, are a rod's length apart where A cos b + B sin b = C, with A, B and C
of the first degree in cos a and sin a: b is real where D = A^2 + B^2 - C^2 >= 0, a polynomial of the second degree on
the circle. Each interval of a on which D > 0 is a closed curve, and if D > 0 everywhere there are two. Source:
Freudenstein, Kiss, "Type determination of skew four-bar mechanisms", J. Eng. Ind. 91 (1969).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from kempe.joints import P, Primitive, R
from kempe.kinematics.measure import motion
from kempe.kinematics.one_sided import one_sided_rows
from kempe.model.kept import kept
from kempe.spatial import Array, inverse

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.system import System

EQUAL = 1e-12
"""Part of the sum of all lengths up to which sums of lengths are equal."""
MOST_BARS = 14
"""Bars up to which aligned polygons are listed: there are 2^(n - 1) of them to try."""
ON_CIRCLE, NEARLY = 1e-7, 1e-3
"""How far from the unit circle a root counts as on it, and how near one that is not leaves the number open."""


@dataclass(frozen=True, eq=False)
class Polygon:
    """A planar loop of bars: `bodies` (n) in their order, `joints` (n), each with the next bar, lengths (n,) [m]."""

    system: System
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    vectors: Array
    """From the pin before to the pin after, (n, 2), in axes of the bodies."""

    @property
    def lengths(self) -> Array:
        """Distances (n,) of the two pins of each bar."""
        return np.linalg.norm(self.vectors, axis=1)

    @property
    def count(self) -> int:
        """Number of components, by the theorem: 0 where the loop cannot be closed, 1, or 2."""
        x, total = np.sort(self.lengths)[::-1], float(self.lengths.sum())
        if x[0] > total - x[0] + EQUAL * total:
            return 0
        return 2 if x[1] + x[2] > 0.5 * total * (1.0 + 2.0 * EQUAL) else 1

    @property
    def reason(self) -> str:
        """The theorem, with the lengths that decide."""
        order: list[int] = np.argsort(-self.lengths, kind="stable").tolist()
        total, longest = float(self.lengths.sum()), self.lengths[order]
        if self.count == 0:
            return f"{self.bodies[order[0]]!r}, {longest[0]:.6g} m, is longer than all others together"
        names = ", ".join(repr(self.bodies[k]) for k in order[:3])
        said = "three long bars" if self.count == 2 else "no three long bars"
        sign = ">" if self.count == 2 else "<="
        sums = f"{longest[1]:.6g} + {longest[2]:.6g} {sign} {0.5 * total:.6g} m"
        return (f"{said} (the longest are {names}; {sums}, half of all: Kapovich and Millson, 1995)")  # fmt: skip

    def side(self, q: Array) -> np.ndarray:
        """Which of two components (k,) configurations (k, nq) are on: 1 or -1; 0 where there is only one."""
        if self.count < 2:
            return np.zeros(len(q), dtype=int)
        i, j = map(int, np.sort(np.argsort(-self.lengths, kind="stable")[:2]))
        a, b = (np.einsum("kij,j->ki", self.system.fk(q, self.bodies[k])[:, :2, :2], self.vectors[k]) for k in (i, j))
        return np.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).astype(int)

    def aligned(self) -> Array:
        """Configurations (k, nq) with all bars on one line: the singular points of the configuration space."""
        n, lengths = len(self.bodies), self.lengths
        if n > MOST_BARS:
            return np.empty((0, self.system.nq))
        signs = np.array([s for s in product((1.0, -1.0), repeat=n) if s[0] > 0.0])
        signs = signs[np.abs(signs @ lengths) <= EQUAL * lengths.sum()]
        return np.array([self._at(np.where(s > 0.0, 0.0, np.pi)) for s in signs]).reshape(-1, self.system.nq)

    def _at(self, directions: Array) -> Array:
        """The configuration (nq,) with bars in these directions (n,) from that of the one at rest."""
        m, q = self.system.mechanism, self.system.neutral.copy()
        turn = directions - np.arctan2(self.vectors[:, 1], self.vectors[:, 0])
        turn = dict(zip(self.bodies, turn - turn[0], strict=True))
        for name in self.joints:
            joint = m.joints[name]
            F, M = joint.X_PF.evaluate(m.parameters), joint.X_CM.evaluate(m.parameters)
            angle = turn[joint.child] - turn[joint.parent] + _angle(M) - _angle(F)
            q[self.system.coordinate_names.index(name)] = np.arctan2(np.sin(angle), np.cos(angle))
        return q


def _angle(X: Array) -> float:
    return float(np.arctan2(X[1, 0], X[0, 0]))


@kept
def loop_of(system: System) -> tuple[tuple[str, ...], tuple[str, ...]] | str:
    """Bodies and joints of the only loop in their order, body k before joint k; or why there is no such loop."""
    s = system.structure
    if len(s.closures) != 1:
        return "it has more than one loop" if s.closures else "it has no loop"
    if s.relations or s.couplings or system.mechanism.constraints:
        return "coordinates are tied by more than its loop"
    joints, parent = s.joints, dict(zip(system.body_names[1:], system.parent, strict=True))
    up = dict(zip(system.body_names[1:], s.parent_joints, strict=True))

    def root(body: str) -> list[str]:
        out = [body]
        while out[-1] in parent:
            out.append(system.body_names[parent[out[-1]]])
        return out

    last = joints[s.closures[0]]
    a, b = root(last.parent), root(last.child)
    top = next(body for body in a if body in b)
    left, right = a[: a.index(top)], b[: b.index(top)]
    bodies = [top, *reversed(left), *right]
    names = [*(up[x] for x in reversed(left)), last.name, *(up[x] for x in right)]
    return tuple(bodies), tuple(names)


@kept
def polygon_of(system: System) -> Polygon | str:
    """The planar polygon of bars that a system is, besides what hangs on it; or why it is none."""
    if system.dim != 2:
        return "it is not planar"
    found = loop_of(system)
    if isinstance(found, str):
        return found
    bodies, names = found
    joints = [system.structure.joints[n] for n in names]
    if not all(_turns(system, j) for j in joints):
        return "its loop has a joint that is not a revolute one without limits"
    if len(bodies) < 3:
        return "its loop has two bars only"
    pins = [_pin(system, joints[k - 1], b)[0] for k, b in enumerate(bodies)]
    after = [_pin(system, joints[k], b)[0] for k, b in enumerate(bodies)]
    vectors = (np.array(after) - np.array(pins))[:, :2]
    lengths = np.linalg.norm(vectors, axis=1)
    if lengths.min() <= 1e-9 * lengths.sum():
        return f"the bar {bodies[int(np.argmin(lengths))]!r} has no length"
    return Polygon(system, bodies, names, vectors)


def _turns(system: System, joint: Joint) -> bool:
    """Whether it is one turn without limits."""
    primitives = _primitives(system, joint)
    if len(primitives) != 1 or primitives[0].kind != R or joint.name not in system.structure.velocity_names:
        return False
    i = system.structure.velocity_names.index(joint.name)
    return not (np.isfinite(system.lower[i]) or np.isfinite(system.upper[i]))


def _primitives(system: System, joint: Joint) -> list[Primitive]:
    return list(joint.type.layout(system.dim, system.mechanism.bodies[joint.child].particle)[1])


def _pin(system: System, joint: Joint, body: str) -> tuple[Array, Array]:
    """Where a joint is on one of its bodies (3,), and its frame there (4, 4)."""
    X = (joint.X_PF if joint.parent == body else joint.X_CM).evaluate(system.mechanism.parameters)
    return X[:3, 3], X


# ---- two cranks and a rod


@kept
def rod_count(system: System) -> tuple[int, str] | str:
    """The number of components of two cranks joined by a rod between balls, and the proof; or why there is none."""
    found = loop_of(system)
    if isinstance(found, str) or system.dim != 3:
        return found if isinstance(found, str) else "it is planar"
    if one_sided_rows(system).declared:
        return "it has one-sided constraints"
    bodies, names = found
    joints = [system.structure.joints[n] for n in names]
    free = [j.type.dof(3, False) for j in joints]
    for k in range(4) if len(bodies) == 4 else ():
        first, ball, other, last = (joints[(k + i) % 4] for i in range(4))
        if [free[(k + i) % 4] for i in range(4)] == [1, 3, 3, 1] and _turns(system, first) and _turns(system, last):
            if _is_ball(system, ball) and _is_ball(system, other):
                base, crank, rod, rocker = (bodies[(k + i) % 4] for i in range(4))
                length = float(np.linalg.norm(_pin(system, ball, rod)[0] - _pin(system, other, rod)[0]))
                p = _circle(system, first, base, crank, _pin(system, ball, crank)[0])
                return _intervals(p, _circle(system, last, base, rocker, _pin(system, other, rocker)[0]), length)
    return "it is not two cranks on one body, joined by a rod between balls"


def _is_ball(system: System, joint: Joint) -> bool:
    """Whether only a point is held: it turns three ways, and slides none."""
    return all(p.kind != P for p in _primitives(system, joint))


def _circle(system: System, joint: Joint, base: str, crank: str, point: Array) -> Array:
    """Points (3, 3), seen from the base, at the angles 0, 2 pi / 3 and 4 pi / 3 of a crank."""
    F, M = joint.X_PF.evaluate(system.mechanism.parameters), joint.X_CM.evaluate(system.mechanism.parameters)
    X = F @ motion(_primitives(system, joint), 2.0 * np.pi / 3.0 * np.arange(3.0)[:, None]) @ inverse(M)
    X = X if joint.parent == base else inverse(X)
    return (X @ np.append(point, 1.0))[:, :3]


def _intervals(p: Array, r: Array, length: float) -> tuple[int, str] | str:
    """The number of components for circles through three points each (3, 3), or why it is not certain."""
    turns, scale = 2.0 * np.pi / 3.0 * np.arange(3), max(length, float(np.ptp(np.concatenate([p, r]), axis=0).max()))
    wave = np.stack([np.ones(3), np.cos(turns), np.sin(turns)], axis=1)
    inverse_wave = np.linalg.inv(wave)
    p, r = (inverse_wave @ x / scale for x in (p, r))

    def at(a: Array) -> Array:
        """D at angles (k,) of the first crank."""
        end = np.stack([np.ones_like(a), np.cos(a), np.sin(a)], axis=1) @ p
        f = np.sum((end[:, None] - wave @ r) ** 2, axis=-1) - (length / scale) ** 2
        C, A, B = (f @ inverse_wave.T).T
        return np.asarray(A * A + B * B - C * C)

    nodes: Array = 2.0 * np.pi / 5.0 * np.arange(5.0)
    d = np.fft.fft(at(nodes)) / 5.0
    size = float(np.abs(d).max())
    roots = np.roots([d[2], d[1], d[0], d[4], d[3]]) if size else np.zeros(0)
    off = np.abs(np.abs(roots) - 1.0)
    angles = np.sort(np.asarray(np.angle(roots[off < ON_CIRCLE]), dtype=float))
    if not size or np.any((off >= ON_CIRCLE) & (off < NEARLY)):
        return "a dead point is about to merge with another"
    if not len(angles):
        if at(nodes).min() > 0.0:
            return 2, "the rod fits at every angle of the first crank"
        return 0, "the rod fits at no angle of the first crank"
    gaps = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
    signs = np.sign(at(angles + 0.5 * np.asarray(gaps, dtype=float)))
    if gaps.min() < NEARLY or np.any(signs == np.roll(signs, 1)):
        return "two dead points are about to merge"
    count = int((signs > 0.0).sum())
    return (
        count,
        f"the first crank turns in {count} interval{'s' * (count > 1)} between dead points, roots of a quartic",
    )
