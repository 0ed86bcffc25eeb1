"""Components of the configuration space of planar loops of bars, by theorem.

The configurations of a closed planar chain of n bars, one of them held, are disconnected if and
only if there are three long bars, any two of which are longer together than half of all; then
there are two components, mirror images of one another, and two long bars are never parallel: the
side to which the second turns from the first tells them apart. Source: Kapovich, Millson, "On the
moduli space of polygons in the Euclidean plane", J. Differential Geom. 42 (1995), theorem 1. With
four bars it is Grashof's rule (1883).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from kempe.forward.fk import fk
from kempe.joints import R
from kempe.model.model import keep_answers
from kempe.spaces.only_loop import find_only_loop, list_primitives, locate_joint
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.model import Model

EQUAL = 1e-12
"""Part of the sum of all lengths up to which sums of lengths are equal."""
MOST_BARS = 14
"""Bars up to which aligned polygons are listed: there are 2^(n - 1) of them to try."""


@dataclass(frozen=True, eq=False)
class Polygon:
    """A planar loop of bars: `bodies` (n) in order, `joints` (n) to the next bar, lengths (n,) [m]."""

    system: Model
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    vectors: Array
    """From the pin before to the pin after, (n, 2), in axes of the bodies."""

    @property
    def lengths(self) -> Array:
        """Distances (n,) between the two pins of each bar."""
        return np.linalg.norm(self.vectors, axis=1)

    @property
    def count(self) -> int:
        """Number of components, by the theorem: 0 if the loop cannot be closed, 1, or 2."""
        x = np.sort(self.lengths)[::-1]
        total = float(self.lengths.sum())
        if x[0] > total - x[0] + EQUAL * total:
            return 0
        return 2 if x[1] + x[2] > 0.5 * total * (1.0 + 2.0 * EQUAL) else 1

    @property
    def reason(self) -> str:
        """The theorem with the lengths that decide."""
        order: list[int] = np.argsort(-self.lengths, kind="stable").tolist()
        total = float(self.lengths.sum())
        longest = self.lengths[order]
        if self.count == 0:
            return (
                f"{self.bodies[order[0]]!r}, {longest[0]:.6g} m, is longer than all others together"
            )
        names = ", ".join(repr(self.bodies[k]) for k in order[:3])
        said = "three long bars" if self.count == 2 else "no three long bars"
        sign = ">" if self.count == 2 else "<="
        sums = f"{longest[1]:.6g} + {longest[2]:.6g} {sign} {0.5 * total:.6g} m"
        more = max(longest[1] + longest[2], longest[0]) - 0.5 * total
        taken = self.count == 1 and more > 8.0 * np.finfo(float).eps * total
        equal = f"; sums that differ by {more:.1g} m are taken to be equal" if taken else ""
        return (
            f"{said} (the longest are {names}; {sums}, half of the sum of all lengths: Kapovich and "
            f"Millson, 1995{equal})"
        )

    def label_components(self, q: Array) -> np.ndarray:
        """Label configurations (k, nq) with their components (k,): 0, or 1 for the second of two."""
        if self.count < 2:
            return np.zeros(len(q), dtype=int)
        i, j = map(int, np.sort(np.argsort(-self.lengths, kind="stable")[:2]))
        a, b = (
            np.einsum("kij,j->ki", fk(self.system, q, self.bodies[k])[:, :2, :2], self.vectors[k])
            for k in (i, j)
        )
        return (a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]).astype(int)

    @property
    def singular_points(self) -> Array:
        """Singular configurations (k, nq), with all bars on one line."""
        n = len(self.bodies)
        lengths = self.lengths
        if n > MOST_BARS:
            return np.empty((0, self.system.nq))
        signs = np.array([s for s in product((1.0, -1.0), repeat=n) if s[0] > 0.0])
        signs = signs[np.abs(signs @ lengths) <= EQUAL * lengths.sum()]
        return np.array(
            [self._compute_configuration(np.where(s > 0.0, 0.0, np.pi)) for s in signs]
        ).reshape(-1, self.system.nq)

    def _compute_configuration(self, directions: Array) -> Array:
        """Compute the configuration (nq,) with bars in these directions (n,) from the fixed bar."""
        m = self.system._mechanism
        q = self.system.neutral.copy()
        turn = directions - np.arctan2(self.vectors[:, 1], self.vectors[:, 0])
        turn = dict(zip(self.bodies, turn - turn[0], strict=True))
        for name in self.joints:
            joint = m.joints[name]
            F = joint.X_PF.evaluate_pose(m.parameters)
            M = joint.X_CM.evaluate_pose(m.parameters)
            angle = turn[joint.child] - turn[joint.parent] + _compute_angle(M) - _compute_angle(F)
            q[self.system.coordinate_names.index(name)] = np.arctan2(np.sin(angle), np.cos(angle))
        return q


def _compute_angle(X: Array) -> float:
    """Compute the angle of a planar pose X."""
    return float(np.arctan2(X[1, 0], X[0, 0]))


@keep_answers
def find_polygon(system: Model) -> Polygon | str:
    """Find the planar polygon of bars in a system, or the reason why it is none."""
    if system.dim != 2:
        return "it is not planar"
    found = find_only_loop(system)
    if isinstance(found, str):
        return found
    bodies, names = found
    joints = [system.structure.joints[n] for n in names]
    if not all(_is_unlimited_turn(system, j) for j in joints):
        return "its loop has a joint that is not a revolute one without limits"
    if len(bodies) < 3:
        return "its loop has two bars only"
    pins = [locate_joint(system, joints[k - 1], b)[0] for k, b in enumerate(bodies)]
    after = [locate_joint(system, joints[k], b)[0] for k, b in enumerate(bodies)]
    vectors = (np.array(after) - np.array(pins))[:, :2]
    lengths = np.linalg.norm(vectors, axis=1)
    if lengths.min() <= 1e-9 * lengths.sum():
        return f"the bar {bodies[int(np.argmin(lengths))]!r} has no length"
    return Polygon(system, bodies, names, vectors)


def _is_unlimited_turn(system: Model, joint: Joint) -> bool:
    """Whether a joint is one rotation without limits."""
    primitives = list_primitives(system, joint)
    if (
        len(primitives) != 1
        or primitives[0].kind != R
        or joint.name not in system.structure.velocity_names
    ):
        return False
    i = system.structure.velocity_names.index(joint.name)
    return not (np.isfinite(system.lower[i]) or np.isfinite(system.upper[i]))
