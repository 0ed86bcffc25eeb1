"""Regions of planar chains of turns and slides: their boundary curves, and the points reached.

Regions of several legs, and of one or all orientations, are made of those of chains.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from kempe.workspace.planar.plane_curves import (
    NOTHING,
    SAME,
    TURN,
    PlanarRegion,
    PlaneCurve,
    PlanePiece,
    RegionOfArcs,
    merged,
)

# ---- chains

# The workspace ends where joints are at limits, or the others cannot move the point across a
# direction: their axes and the point are on a line, to which slides are at right angles. There the
# first of them leads the point along an arc or a segment. Sources: Litvin, "Application of theorem
# of implicit function system existence for analysis and synthesis of linkages", Mechanism and
# Machine Theory 15 (1980); Haug, Luh, Adkins, Wang, "Numerical algorithms for mapping boundaries of
# manipulator workspaces", J. Mechanical Design 118 (1996).


@dataclass(frozen=True)
class PlanarJoint:
    """A joint where its coordinate is zero: a turn about `axis` by `rate` times it, or (axis None)
    a slide along `way`.

    `low` and `high` are its limits; those of turns may be infinite.
    """

    axis: complex | None
    rate: float
    way: complex
    low: float
    high: float

    @property
    def limits(self) -> tuple[float, ...]:
        """The limits that there are."""
        if self.axis is not None and abs(self.rate) * (self.high - self.low) >= TURN:
            return ()
        return tuple(x for x in (self.low, self.high) if np.isfinite(x))

    def motion(self, x: float) -> tuple[complex, complex]:
        """(a, b): where its value is x, a point z of its body is at a z + b."""
        if self.axis is None:
            return 1.0 + 0j, self.way * x
        a = complex(np.exp(1j * self.rate * x))
        return a, self.axis - a * self.axis

    def curve(self, p: complex, back: bool = False) -> PlanePiece:
        """The piece along which it leads a point; `back`: that of the points which it leads to p."""
        sense = -1.0 if back else 1.0
        low = self.low
        high = self.high
        if self.axis is None:
            return PlanePiece(p + sense * self.way * low, 0.0, way=sense * self.way * (high - low))
        if not self.limits:
            low = 0.0
            high = TURN / abs(self.rate)
        d = p - self.axis
        return PlanePiece(
            self.axis,
            abs(d),
            float(np.angle(d)) + sense * self.rate * low,
            sense * self.rate * (high - low),
        )

    def turned_to(self, turns: Iterator[complex] | list[complex]) -> list[float]:
        """Values inside the limits at which it turns by unit numbers, one each."""
        out: list[float] = []
        for u in turns:
            angle = float(np.angle(u))
            if not self.limits:
                out.append(angle / self.rate)
                continue
            k = np.arange(-4, 5) if np.isfinite(self.high - self.low) else np.zeros(1)
            x = (angle + TURN * k) / self.rate
            x = x[(x >= self.low - 1e-12) & (x <= self.high + 1e-12)]
            out += x[:1].tolist()
        return out

    def with_next(self, other: PlanarJoint) -> PlanarJoint | None:
        """One joint for this and the next, where they turn about one axis or slide along one way;
        else None.
        """
        if self.axis is None or other.axis is None:
            if self.axis is not other.axis or abs(
                np.imag(self.way * np.conj(other.way))
            ) > NOTHING * abs(self.way * other.way):
                return None
            rates = 1.0, float(np.real(other.way / self.way))
        elif abs(self.axis - other.axis) > NOTHING * (abs(self.axis) + abs(other.axis)):
            return None
        else:
            rates = self.rate, other.rate
        ends = [sorted((r * j.low, r * j.high)) for r, j in zip(rates, (self, other), strict=True)]
        low, high = (sum(x) for x in zip(*ends, strict=True))
        return replace(self, rate=1.0 if self.axis is not None else self.rate, low=low, high=high)


@dataclass(frozen=True)
class PlanarChain(RegionOfArcs):
    """The joints of a chain from the ground on, and the point that they lead, all of them at zero.

    `spare` joints more move it no further than these do.
    """

    joints: tuple[PlanarJoint, ...]
    tip: complex
    spare: int = 0

    @classmethod
    def of(cls, joints: Iterable[PlanarJoint], tip: complex) -> PlanarChain:
        """The chain of joints, of which those that turn about one axis or slide along one way are
        one.

        A joint with the tip on its axis is left out.
        """
        kept: list[PlanarJoint] = []
        given = tuple(joints)
        for joint in given:
            one = kept[-1].with_next(joint) if kept else None
            kept[len(kept) - (one is not None) :] = [one or joint]
        chain = cls(tuple(kept), tip, len(given) - len(kept))
        last = kept[-1].axis if kept else None
        if last is not None and abs(tip - last) <= NOTHING * max(chain.size, abs(tip)):
            return cls(chain.joints[:-1], tip, chain.spare + 1)
        return chain

    @cached_property
    def size(self) -> float:
        """A length scale [m]: distances between successive axes and the tip, plus the largest
        values of slides.
        """
        places = [j.axis for j in self.joints if j.axis is not None] + [self.tip]
        slides = [abs(j.way) * max(abs(j.low), abs(j.high)) for j in self.joints if j.axis is None]
        return sum(abs(b - a) for a, b in itertools.pairwise(places)) + sum(slides)

    @cached_property
    def tail(self) -> PlanarChain:
        """The chain without its first joint."""
        return PlanarChain(self.joints[1:], self.tip)

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which the workspace can end."""
        found: list[PlanePiece] = []
        options = [(None, *j.limits) for j in self.joints]
        for choice in itertools.product(*options):
            if any(x is None for x in choice):
                found += self._of(choice)
        return merged(found, SAME * self.size)

    def _of(self, choice: tuple[float | None, ...]) -> list[PlanePiece]:
        """The pieces with joints at these limits, the others (None) singular."""
        free = [i for i, x in enumerate(choice) if x is None]
        if not free:
            return []
        last = free[-1]
        tip = _carried(self._fixed(choice, last + 1, len(choice)), self.tip)
        states = self._first_state(last, tip)
        if not states:  # the tip is on the axis, and stays there
            return self._of((*choice[:last], 0.0, *choice[last + 1 :]))
        for i, k in zip(free[-2::-1], free[:0:-1], strict=True):
            a, b = self._fixed(choice, i + 1, k)
            states = [s for t, u in states for s in self._before(i, k, a, b, t, u)]
        start = self._fixed(choice, 0, free[0])
        return [_moved(self.joints[free[0]].curve(t), start) for t, _ in states]

    def _fixed(self, choice: tuple[float | None, ...], i: int, k: int) -> tuple[complex, complex]:
        """The motion of joints i to k, which are at limits."""
        a = 1.0 + 0j
        b = 0j
        for joint, x in zip(self.joints[i:k], choice[i:k], strict=True):
            assert x is not None
            c, d = joint.motion(x)
            a, b = a * c, a * d + b
        return a, b

    def _first_state(self, last: int, tip: complex) -> list[tuple[complex, complex]]:
        """Where the point is on the body of the last joint that is free, and the direction of the
        line.
        """
        joint = self.joints[last]
        if joint.axis is None:
            return [(tip, 1j * joint.way / abs(joint.way))]
        d = tip - joint.axis
        return [] if abs(d) < NOTHING * self.size else [(tip, d / abs(d))]

    def _before(
        self, i: int, k: int, a: complex, b: complex, t: complex, u: complex
    ) -> list[tuple[complex, complex]]:
        """What of a state (t, u) of joint k becomes one of joint i, with k where all are on a line
        again.
        """
        first = self.joints[i]
        joint = self.joints[k]
        if joint.axis is None and first.axis is None:
            # parallel slides: what they reach together they reach with one of them at a limit
            return []
        if joint.axis is None:
            assert first.axis is not None
            way = a * joint.way
            x = -np.real((a * t + b - first.axis) * np.conj(way)) / abs(way) ** 2
            values = [float(x)] if joint.low - NOTHING <= x <= joint.high + NOTHING else []
        else:
            line = 1j * first.way if first.axis is None else a * joint.axis + b - first.axis
            if abs(line) < NOTHING * self.size:
                # axes that coincide: one joint
                return [] if joint.limits or first.limits else [(a * t + b, a * u)]
            turn = line / abs(line) / (a * u)
            values = joint.turned_to([turn, -turn])
        out: list[tuple[complex, complex]] = []
        for x in values:
            c, d = joint.motion(x)
            out.append((a * (c * t + d) + b, a * c * u))
        return out

    @property
    def counted(self) -> bool:
        """Whether it says in how many ways a point is reached: two joints do."""
        return len(self.joints) == 2 and not self.spare

    @property
    def limited(self) -> int:
        """How many joints have limits."""
        return sum(bool(j.limits) for j in self.joints)

    @property
    def is_curve(self) -> bool:
        """Whether it is a curve, without area."""
        return len(self.joints) == 1

    def moved(self, by: complex) -> PlanarChain:
        """The chain, moved as a whole."""
        joints = [j if j.axis is None else replace(j, axis=j.axis + by) for j in self.joints]
        return replace(self, joints=tuple(joints), tip=self.tip + by)

    def solutions(self, p: complex) -> int:
        """In how many ways two joints reach a point; of more whether they do, 0 or 1."""
        curve = self.joints[0].curve(p, back=True)
        if curve.length < NOTHING * self.size:
            return int(self.tail.holds(p))
        if len(self.joints) == 2:
            return len(curve.meets(self.joints[1].curve(self.tip), 0.0))
        t = np.concatenate([[0.0, 1.0], *[curve.meets(end) for end in self.tail.ends]])
        t = np.unique(t.clip(0.0, 1.0))
        return int(self.tail.holds(curve.at(0.5 * (t[1:] + t[:-1]))).any())


def _carried(motion: tuple[complex, complex], z: complex) -> complex:
    return motion[0] * z + motion[1]


def _moved(piece: PlanePiece, motion: tuple[complex, complex]) -> PlanePiece:
    a = motion[0]
    centre = _carried(motion, piece.centre)
    return PlanePiece(
        centre, piece.radius, piece.start + float(np.angle(a)), piece.sweep, a * piece.way
    )


# ---- regions of legs and of orientations

# Several regions hold, or a circle about the point lies in one. So are places in one orientation,
# in several and in all of them, and those of parallel mechanisms: each leg leaves a region of its
# own. Sources: Gosselin, Angeles, "The optimum kinematic design of a planar three-degree-of-freedom
# parallel manipulator", J. Mechanisms 110 (1988); Merlet, Gosselin, Mouly, "Workspaces of planar
# parallel manipulators", Mechanism and Machine Theory 33 (1998).


@dataclass(frozen=True)
class RegionOfLegs(PlanarRegion):
    """The points that all parts hold; each combination of their ways is one where these are
    `counted`.
    """

    parts: tuple[PlanarRegion, ...]
    counted: bool = False
    is_curve: bool = False

    @property
    def size(self) -> float:
        """A length of the region."""
        return max(part.size for part in self.parts)

    @property
    def limited(self) -> int:
        """How many joints with limits one chain has at most."""
        return max(part.limited for part in self.parts)

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which it can end; of many parts those that bound what either half
        of them holds.
        """
        if self.counted or len(self.parts) < 3:
            return merged([c for part in self.parts for c in part.candidates], SAME * self.size)
        half = len(self.parts) // 2
        halves = (RegionOfLegs(self.parts[:half]), RegionOfLegs(self.parts[half:]))
        return merged([c for part in halves for c in part.ends], SAME * self.size)

    def solutions(self, p: complex) -> int:
        """In how many ways a point is reached."""
        ways = 1
        for part in self.parts:
            ways *= part.solutions(p)
            if not ways:
                break
        return ways

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are on no boundary, are inside all parts."""
        return np.all([part.holds(p) for part in self.parts], axis=0)


@dataclass(frozen=True)
class Surrounded(RegionOfArcs):
    """The points about which a whole circle of a radius lies in the `inner` region."""

    inner: RegionOfArcs
    radius: float
    counted: bool = False
    is_curve: bool = False

    @property
    def size(self) -> float:
        """A length of the region."""
        return self.inner.size + self.radius

    @property
    def limited(self) -> int:
        """How many joints of its chain have limits."""
        return self.inner.limited

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which it can end: beside those that bound the inner one, and
        about their ends.
        """
        found: list[PlanePiece] = []
        for piece in cast("list[PlanePiece]", self.inner.ends):
            if piece.is_arc:
                radii = (piece.radius + self.radius, abs(piece.radius - self.radius))
                found += [
                    PlanePiece(piece.centre, r, 0.0, TURN) for r in radii if r > SAME * self.size
                ]
            else:
                beside = 1j * piece.way / abs(piece.way) * self.radius
                found += [
                    PlanePiece(piece.centre + s * beside, 0.0, way=piece.way) for s in (1.0, -1.0)
                ]
            found += [PlanePiece(complex(piece.at(t)), self.radius, 0.0, TURN) for t in (0.0, 1.0)]
        return merged(found, SAME * self.size)

    def solutions(self, p: complex) -> int:
        """1 for a point that it holds, else 0."""
        circle = PlanePiece(p, self.radius, 0.0, TURN)
        t = np.unique(
            np.concatenate([[0.0, 1.0], *[circle.meets(end) for end in self.inner.ends]]).clip(
                0.0, 1.0
            )
        )
        return int(self.inner.holds(circle.at(0.5 * (t[1:] + t[:-1]))).all())


def wrist_of(chain: PlanarChain) -> tuple[PlanarChain, complex] | None:
    """The chain without its last joint, up to the axis of that, and the way from there to the tip;
    None without one.

    The last joint must turn without limits: then the orientation is free, wherever the axis is.
    """
    last = chain.joints[-1]
    if last.axis is None or last.limits:
        return None
    inner = PlanarChain.of(chain.joints[:-1], last.axis)
    return (inner, chain.tip - last.axis) if inner.joints else None


def in_all_orientations(chain: PlanarChain) -> PlanarRegion | None:
    """Where the tip is reached in all orientations; None where the last joint does not turn without
    limits.
    """
    if (found := wrist_of(chain)) is None:
        return None
    inner, way = found
    return inner if abs(way) < NOTHING * chain.size else Surrounded(inner, abs(way))


def in_one_orientation(chain: PlanarChain, turn: float) -> PlanarChain | None:
    """Where the tip is reached with the last body turned by an angle from where it is while all
    joints are at zero.
    """
    if (found := wrist_of(chain)) is None:
        return None
    inner, way = found
    return inner.moved(way * complex(np.exp(1j * turn)))
