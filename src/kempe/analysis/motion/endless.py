"""Motions that have no end: slides that run away to infinity, and gears that never bring all back
to where it was.

That a curve runs away is evidence, found by going on in longer and longer steps; so is a ratio of
whole numbers that is missing: a computer's number is always a fraction. What is said is what was
looked at.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from kempe.analysis.continuation.beginning import MOST_TURNS, SAME_RATIO, followers
from kempe.analysis.continuation.continuation import Closure
from kempe.analysis.continuation.events import sides_change
from kempe.analysis.continuation.one_sided_ends import OneSidedEnds
from kempe.solvers.common.tracing import Node, bend, step
from kempe.spatial import Array
from kempe.words import plural

FAR = 50.0
"""Characteristic lengths that a slide, and radians that a turn without return, is away before one
looks ahead."""
AHEAD = 1e4
"""How many of them one looks ahead."""
STRAIGHT = 1e-9
"""Change of the direction over `SOON` below which a curve counts as straight, and one looks ahead
at once."""
SAME_RATE = 1e-8
"""How near the ratio of two rates of a straight curve must be to one of whole numbers: rates are
computed, far from the origin with less digits."""
SOON = 8.0
"""Arc length after which that is checked."""
NO_RETURN = "a place like any other of a motion that does not come back"
"""How a reason begins that holds both ways."""
ROUNDS = 10
"""Turns after which a curve ends that a gear ratio keeps from closing."""
MOVES = 1e-9
"""Share of a direction below which a coordinate rests."""


class Endless:
    """Whether a walk from a first node on has no end; `limits` are those that may still end it."""

    def __init__(self, equations: Closure, first: Node, periods: Array, limits: OneSidedEnds):
        self.equations = equations
        self.first = first
        self.periods = periods
        self.limits = limits
        system = equations.system
        self.away = np.array(
            [i for i in system.structure.layout.vector_v if not periods[i]], dtype=np.int64
        )
        self.place = equations.place[self.away]
        self.followers = followers(system, limits.limits)
        self.next = FAR
        self.requested = False

    def reason(self, b: Node, length: float) -> str:
        """Why the curve has no end, as the place where it ends; empty as long as nothing speaks for
        that.
        """
        for f in self.followers:
            if f.turns and self._turned(b, f.source) > 2.0 * math.pi * ROUNDS:
                return self._unrelated(f.name, f.factor, f.source)
        if not self.requested and length > SOON:
            self.requested = True
            if float(np.abs(b.t - self.first.t).max()) < STRAIGHT:
                return self._straight(b)
        if not self.away.size:
            return ""
        out = np.abs(b.x[self.place] - self.first.x[self.place]) / self.equations.unit[self.away]
        if float(out.max()) < self.next:
            return ""
        self.next *= 4.0
        return self._runs_away(b)

    def hint(self, b: Node) -> str:
        """What is known about when a curve closes that was not followed so far."""
        whole = np.flatnonzero(self.periods > 7.0)
        i = max(whole.tolist(), key=lambda i: self._turned(b, i), default=-1)
        if i < 0 or self._turned(b, i) < 2.0 * math.pi:
            return ""
        name = self.equations.system.structure.velocity_names[i]
        turns = round(self.periods[i] / (2.0 * math.pi))
        done = f"{self._turned(b, i) / (2.0 * math.pi):.4g}"
        after = f"{done} {plural(float(done), 'turn')} of {name!r}"
        return f", after {after}: by its gear ratios all is as before after {turns}"

    def _turned(self, b: Node, i: int) -> float:
        """How far coordinate i is from where it was at first."""
        at = self.equations.place[i]
        return abs(float(b.x[at] - self.first.x[at]))

    def _straight(self, b: Node) -> str:
        """The same of a curve that has been straight so far: coordinates grow at constant rates."""
        moving = [
            int(i) for i in self.equations.system.structure.layout.vector_v if abs(b.t[i]) > MOVES
        ]
        for f in self.followers:
            if f.turns and f.source in moving:
                return self._unrelated(f.name, f.factor, f.source)
        if any(i in self.away for i in moving):
            return self._runs_away(b)
        lead = max(moving, key=lambda i: abs(b.t[i]) / self.periods[i], default=-1)
        for i in moving:
            factor = float(b.t[i] / b.t[lead])
            ratio = Fraction(factor * self.periods[lead] / self.periods[i]).limit_denominator(
                MOST_TURNS
            )
            if abs(float(ratio) * self.periods[i] / self.periods[lead] - factor) > SAME_RATE:
                return self._unrelated(
                    self.equations.system.structure.velocity_names[i], factor, lead, SAME_RATE
                )
        return ""

    def _unrelated(self, name: str, factor: float, source: int, within: float = SAME_RATIO) -> str:
        digits = round(-math.log10(within))
        of = self.equations.system.structure.velocity_names[source]
        return (
            f"{NO_RETURN} within {MOST_TURNS} turns of {of!r}: {name!r} turns "
            f"{abs(factor):.{digits}g} times as fast, which to {digits} digits is no ratio of "
            f"whole numbers up to {MOST_TURNS}"
        )

    def _runs_away(self, b: Node) -> str:
        """Look ahead in longer and longer steps; what runs away, empty where anything turns back or
        ends.
        """
        equations = self.equations
        h = 1.0
        gone = 0.0
        rest = [i for i in self.away if abs(b.t[i]) > 1e-3]
        if not rest or self.limits.may_end(b, rest):
            return ""
        a = b
        while gone < AHEAD:
            c = step(equations, a, h)
            if (
                c is None
                or bend(a, c) > 0.1
                or sides_change(equations, a, c)
                or np.any(c.t[rest] * b.t[rest] <= 0.0)
            ):
                if h <= 1e-2 * max(gone, 1.0):
                    return ""
                h *= 0.5
                continue
            gone = gone + h
            a = c
            h = min(2.0 * h, max(gone, 1.0))
        names = equations.system.structure.velocity_names
        shown = [
            f"{names[i]!r} = {a.x[equations.place[i]]:.3g}"
            for i in sorted(rest, key=lambda i: -abs(a.t[i]))[:3]
        ]
        return f"infinity: nothing turns back as far as it was followed, to {', '.join(shown)}"
