"""Where one-sided rows end a walk along a curve: limits of coordinates, and declared one-sided
constraints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kempe.analysis.continuation.continuation import Closure
from kempe.analysis.continuation.events import RESTING, root
from kempe.kinematics.one_sided import OneSided, one_sided_rows
from kempe.solvers.common.tracing import Node
from kempe.spatial import Array
from kempe.words import InWords

TOUCH = 1e-12
"""Radians or metres beyond a bound that are rounding."""
OUTSIDE = 1e-9
"""How far, as a part of 1 and the bound, a start may be beyond a bound."""


@dataclass(frozen=True, eq=False)
class OneSidedEnd(InWords):
    """A bound of a one-sided constraint or coordinate: `sign` is +1 for an upper bound and -1 for a
    lower one.
    """

    name: str
    limit: float
    sign: float
    of: int | None
    """The velocity coordinate that it limits, None for a declared row."""

    def over(self, x: Array) -> float:
        """How far the bounded quantity is beyond the bound at configuration x; negative inside."""
        return self.sign * (self.value(x) - self.limit)

    def value(self, x: Array) -> float:
        """Value of the bounded quantity at x."""
        raise NotImplementedError

    def rate(self, n: Node) -> float:
        """Rate along the curve, at a node, at which the bounded quantity goes outwards."""
        raise NotImplementedError

    def outside(self, over: float) -> str:
        """Sentence, without its end, that the bound is violated by `over`."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class CoordinateBound(OneSidedEnd):
    """A limit of a coordinate at `place` in q."""

    place: int

    def value(self, x: Array) -> float:
        """The value of the coordinate."""
        return float(x[self.place])

    def rate(self, n: Node) -> float:
        """The rate of the coordinate."""
        return self.sign * float(n.t[self.of])

    def outside(self, over: float) -> str:
        """That it is violated."""
        return f"{self.name!r} is outside its limits"

    def __str__(self) -> str:
        return (
            f"the {'upper' if self.sign > 0 else 'lower'} limit {self.limit:.9g} of {self.name!r}"
        )


@dataclass(frozen=True, eq=False)
class RowBound(OneSidedEnd):
    """A bound of a declared row, the one at `index` of `rows`."""

    rows: OneSided
    index: int

    def value(self, x: Array) -> float:
        """The row's value; of a driven curve, x goes on behind the coordinates."""
        return float(self.rows.values(x[: self.rows.system.nq], declared=True)[self.index])

    def rate(self, n: Node) -> float:
        """Its rate, in scaled units."""
        system = self.rows.system
        J = self.rows.rates(n.x[: system.nq], declared=True)[1]
        return self.sign * float(J[self.index] @ n.t[: system.nv])

    def outside(self, over: float) -> str:
        """That it is violated, and by how much."""
        return f"{self} is violated by {over:.6g} {self.rows.units[self.index]}".removesuffix(" 1")

    def __str__(self) -> str:
        return f"the one-sided constraint {self.rows.side(self.index, self.sign > 0)!r}"


class OneSidedEnds:
    """What is one-sided in a system, as ends of a walk: declared rows, and with `limits` those of
    its coordinates.
    """

    def __init__(self, equations: Closure, limits: bool = True):
        system = equations.system
        rows = one_sided_rows(equations.system)
        self.limits = limits
        """Whether limits of coordinates count."""
        self.all: list[OneSidedEnd] = []
        place = equations.place
        for i in range(system.nv) if limits else ():
            if place[i] >= 0 and i not in equations.held:
                for bound, sign in zip(
                    system.structure.limits[i].tolist(), (-1.0, 1.0), strict=True
                ):
                    if np.isfinite(bound):
                        self.all.append(
                            CoordinateBound(
                                system.structure.velocity_names[i], bound, sign, i, int(place[i])
                            )
                        )
        for k in range(rows.declared):
            for bound, sign in ((rows.low[k], -1.0), (rows.high[k], 1.0)):
                if np.isfinite(bound):
                    self.all.append(RowBound(rows.names[k], float(bound), sign, None, rows, k))

    def outside(self, x: Array) -> str:
        """What is violated at `x`, as a sentence without its end; empty where nothing is."""
        for bound in self.all:
            if (over := bound.over(x)) > OUTSIDE * (1.0 + abs(bound.limit)):
                return bound.outside(over)
        return ""

    def may_end(self, n: Node, moving: list[int]) -> bool:
        """Whether one of the `moving` velocity coordinates, or a declared row, goes towards a bound
        at a node.
        """
        return any(
            bound.rate(n) > 0.0 for bound in self.all if bound.of is None or bound.of in moving
        )

    def hit(self, equations: Closure, a: Node, b: Node) -> tuple[Node, str] | None:
        """The first node between two neighbours at which a bound is reached, and which: None if
        there is none.
        """
        best: tuple[float, Node, str] | None = None
        for bound in self.all:
            reached = _reached(equations, a, b, bound)
            if reached is not None:
                distance = float(a.t @ equations.between(a.x, reached.x))
                if best is None or distance < best[0]:
                    best = (distance, reached, str(bound))
        return None if best is None else best[1:]


def _reached(equations: Closure, a: Node, b: Node, bound: OneSidedEnd) -> Node | None:
    def over(n: Node) -> float:
        return bound.over(n.x)

    before = over(a)
    after = over(b)
    if before > -TOUCH:
        if (rate := bound.rate(a)) > RESTING:
            return a
        if after <= TOUCH:
            return None
        if rate >= -RESTING:
            return a  # at rest on the bound, and then beyond it
    last = b
    low = 0.0
    if (
        before <= -TOUCH
        and after <= TOUCH
        and (bound.rate(a) <= RESTING or bound.rate(b) >= -RESTING)
    ):
        # inside at both ends, and no largest value in between; rates of what rests are rounding
        return None
    if after <= TOUCH or before > -TOUCH:
        turn = root(equations, a, b, bound.rate)
        if turn is None or (after <= TOUCH and over(turn) <= TOUCH):
            return None
        if after <= TOUCH:
            last = turn
        else:
            low = float(a.t @ equations.between(a.x, turn.x))
    high = float(a.t @ equations.between(a.x, last.x))
    return root(equations, a, b, over, low, high)
