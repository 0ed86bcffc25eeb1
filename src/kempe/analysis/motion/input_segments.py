"""One straight segment of the inputs after the other, and the configuration continued along it.

The curve lives in configurations and the length gone on the segment. Where it turns back in that
length the inputs cannot go on (a toggle); where two of its branches cross is a change point.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from kempe.analysis.continuation.beginning import too_free
from kempe.analysis.continuation.continuation import Closure, DrivenClosure
from kempe.analysis.continuation.crossings import branch_lines, locate, singular_node
from kempe.analysis.continuation.deflation import hold_rank
from kempe.analysis.continuation.events import AWKWARD, checked, root
from kempe.analysis.continuation.one_sided_ends import OneSidedEnds
from kempe.analysis.continuation.path import Event
from kempe.analysis.continuation.spins import hold_spins, spins_held
from kempe.errors import UnsupportedError
from kempe.solvers.common.tracing import (
    ACROSS,
    BEND,
    LEAST_STEP,
    Node,
    bend,
    correct,
    next_step,
    node,
    step,
)
from kempe.spatial import Array

SAME_INPUT = 1e-9
"""How far a toggle may be from the inputs requested and still be what was requested."""
NO_CHANGE = 1e-13
"""Changes of the inputs, in radians and characteristic lengths, below which they rest."""
FORWARD = 1e-6
"""Least share of a direction that the inputs must have for it to lead on."""
STEEP = 0.02
"""Share of the inputs below which their values do not fix a point well: near a toggle it is found
otherwise."""
REGULAR = 0.1
"""Share of the inputs in the direction above which a point is far enough from a toggle to return
to."""
AT_ONCE = 1e-6
"""Distance from a change point within which the branch is taken for straight."""


@dataclass(frozen=True, eq=False)
class State:
    """Where the motion is: configuration, values of the inputs; velocity and direction of the
    inputs on arrival.
    """

    q: Array
    u: Array
    velocity: Array | None = None
    direction: Array | None = None


@dataclass(frozen=True, eq=False)
class Stuck:
    """The pose where the inputs cannot go on, their values there, why; `reached` if more was not
    requested.
    """

    q: Array
    u: Array
    reason: str
    reached: bool = False


@dataclass(frozen=True, eq=False)
class SegmentContext:
    """What does not change from one segment to the next; `singular` collects the change points
    passed.

    `index` are the velocity indices of the inputs, `wish` (nv,) a direction that chooses among
    branches at the start.
    """

    closure: Closure
    index: list[int]
    longest: float
    limits: OneSidedEnds
    wish: Array
    singular: list[Event] = field(default_factory=list[Event])

    @property
    def unit(self) -> Array:
        """Radians or metres in one unit of each input."""
        return self.closure.unit[self.index]

    def follow(
        self, state: State, stuck: Stuck | None, last: Array, u: Array, k: int
    ) -> tuple[State, Stuck | None, float]:
        """The state after the inputs moved from `last` to `u` in sample k, what holds it, and the
        size of a jump.

        While held, it waits at the last regular state until the inputs can be reached from there on
        a straight way.
        """
        before = len(self.singular)
        if stuck is not None and len(u) == 1 and (u - stuck.u) @ (stuck.u - state.u) > 0.0:
            return state, replace(stuck, reached=False), 0.0  # further beyond
        there, stop = self.go(state, u, k)
        if stuck is None:
            return there, stop, 0.0
        if stop is not None:
            del self.singular[before:]
            same = stop.reached and not stuck.reached
            return state, stop if same else replace(stuck, reached=stop.reached), 0.0
        passed = len(self.singular)
        back, entry = self.go(
            there, last, k
        )  # on the way that the inputs came: where did they come in again?
        del self.singular[passed:]
        q = back.q if entry is None else entry.q
        return there, None, float(np.linalg.norm(self.closure.between(stuck.q, q)))

    def go(self, state: State, u: Array, k: int) -> tuple[State, Stuck | None]:
        """The state with the inputs moved straight to `u`; or the last regular one, and where it is
        stuck.
        """
        change = (u - state.u) / self.unit
        length = float(np.linalg.norm(change))
        if length < NO_CHANGE:
            return state, None
        way, a = self._begin(state, change / length)
        if a.t[-1] < FORWARD:  # it begins at a toggle
            ways = [
                n
                for n in (a, a.reversed())
                if (b := step(way, n, self.longest)) is not None and b.x[-1] > 0.0
            ]
            if not ways:
                return state, self._stuck(way, a, "no configuration with these inputs", length)
            a = max(ways, key=lambda n: float(n.t[:-1] @ self.wish))
        regular = a
        was = a
        h = 0.25 * self.longest
        while True:
            left = length - float(a.x[-1])
            landing = a.t[-1] > STEEP and h * a.t[-1] >= left
            if a.t[-1] > STEEP and not landing and h * a.t[-1] > 0.5 * left:
                h = 0.5 * left / float(a.t[-1])  # leave more than rounding for the landing
            b = land(way, a, length) if landing else step(way, a, h)
            found = checked(way, a, b)
            if found is None:
                h = 0.5 * (left / float(a.t[-1]) if landing else h)
                if h < LEAST_STEP:
                    return self._state(way, regular), self._stuck(
                        way, a, "the motion is not smooth here", length
                    )
                continue
            for n in found:
                stop, end = self._ends(way, a, n, length)
                if stop is not None:
                    return self._state(way, regular), stop
                if end is not None:
                    return replace(self._state(way, end), u=u), None
                self._passed(n, k)
                regular = n if n.t[-1] > REGULAR and n.lines is None else regular
                a, was = n, a
            if landing:
                return replace(self._state(way, a), u=u), None
            h = next_step(h, self.longest, was, a)

    def _state(self, way: DrivenClosure, a: Node) -> State:
        return State(a.x[:-1], way.at(float(a.x[-1])), a.t[:-1], way.direction)

    def _stuck(self, way: DrivenClosure, a: Node, reason: str, length: float) -> Stuck:
        return Stuck(
            a.x[:-1], way.at(float(a.x[-1])), reason, abs(float(a.x[-1]) - length) < SAME_INPUT
        )

    def _passed(self, n: Node, k: int) -> None:
        if n.lines is not None:
            kind = "bifurcation" if len(n.lines) > 1 else "singular"
            lines = n.lines[:, :-1] * self.closure.unit
            self.singular.append(
                Event(n.x[:-1], float(k), kind, nullity=n.nullity, directions=lines)
            )

    def _ends(
        self, way: DrivenClosure, a: Node, b: Node, length: float
    ) -> tuple[Stuck | None, Node | None]:
        """What ends the segment between two nodes: a limit, or that the curve turns back; or the
        node at its end.
        """
        turn = None
        if b.t[-1] <= 0.0:
            turn = root(way, a, b, lambda n: float(n.t[-1])) or a
        far = b if turn is None else turn
        hit = self.limits.hit(way, a, b)
        if hit is not None and float(hit[0].x[-1]) < min(float(far.x[-1]), length) + NO_CHANGE:
            return self._stuck(way, hit[0], f"beyond {hit[1]}", length), None
        if turn is not None and float(turn.x[-1]) < length + SAME_INPUT:
            return self._stuck(way, turn, "no configuration with these inputs", length), None
        if float(far.x[-1]) <= length + NO_CHANGE:
            return None, None
        high = float(a.t @ way.between(a.x, far.x))
        return None, root(way, a, b, lambda n: float(n.x[-1]) - length, 0.0, high)

    def _begin(self, state: State, direction: Array) -> tuple[DrivenClosure, Node]:
        """The equations of a segment and its first node; what spins idly is held, and so is the
        rank where it is low all along.
        """
        spins = spins_held(self.closure)
        if spins is not None:
            spins.begin(state.q)
        way, here = self._way(state, direction)
        loose = here.nullity > 1 or (
            here.nullity == 1 and abs(here.t[-1]) < FORWARD
        )  # what moves may be but a spin
        if loose and spins is None and hold_spins(self.closure, state.q, self.index):
            way, here = self._way(state, direction)
        if here.nullity > 1 and hold_rank(
            self.closure, state.q, lambda: self._way(state, direction)
        ):
            way, here = self._way(state, direction)
        return way, self._first(way, here, state)

    def _way(self, state: State, direction: Array) -> tuple[DrivenClosure, Node]:
        """The equations of a segment, and the node where it begins."""
        way = DrivenClosure(self.closure, self.index, state.u, direction)
        return way, node(way, np.append(state.q, 0.0))

    def _first(self, way: DrivenClosure, here: Node, state: State) -> Node:
        """The node at the beginning of a segment, on the branch of arrival where several meet."""
        x = here.x
        if here.nullity == 1:
            return here if here.t[-1] >= 0.0 else here.reversed()
        if here.nullity == 0:
            names = ", ".join(
                repr(self.closure.system.structure.velocity_names[i]) for i in self.index
            )
            raise UnsupportedError(
                f"{self.closure.system.name} has fewer freedoms than inputs: {names} cannot be "
                "moved independently; drive fewer of them"
            )
        polished = locate(way, x, here.nullity, 1e-5)
        lines = branch_lines(way, x if polished is None else polished)
        lines = lines[np.abs(lines[:, -1]) > FORWARD]
        if not len(lines):
            J = self.closure.matrix(state.q)
            names = [self.closure.system.structure.velocity_names[i] for i in self.index]
            raise UnsupportedError(too_free(self.closure, J, names))
        lines = lines * np.sign(lines[:, -1:])
        motion = lines[:, :-1] / np.linalg.norm(lines[:, :-1], axis=1)[:, None]
        if state.velocity is not None and state.direction is not None:
            along = float(state.direction @ way.direction)
            merit = motion @ (state.velocity * (1.0 if abs(along) < 1e-9 else along))
        elif np.any(self.wish):
            merit = np.abs(motion @ self.wish)
        else:
            merit = lines[:, -1]
        best = int(np.argmax(merit))
        return Node(
            x, lines[best], here.sigma, max(here.nullity, 2), here.matrix, here.image, lines
        )


def land(way: DrivenClosure, a: Node, length: float) -> Node | None:
    """The node of the curve at this length of the segment, or None where that is too far to be sure
    of it.
    """
    size = (length - float(a.x[-1])) / float(a.t[-1])
    guess = way.move(a.x, size * a.t)
    across = np.zeros(way.n)
    across[-1] = 1.0
    there = correct(way, guess, across)
    if there is None or float(np.linalg.norm(way.between(guess, there.x))) > ACROSS * size:
        return _land_on_crossing(way, a, guess, length, size)
    b = node(way, there.x, way.between(a.x, there.x), there.J)
    if b.sigma < AWKWARD:
        b = _land_on_crossing(way, a, there.x, length, size) or b
    return b if b.t[-1] > STEEP and bend(a, b) <= BEND else None


def _land_on_crossing(
    way: DrivenClosure, a: Node, guess: Array, length: float, size: float
) -> Node | None:
    """The node at this length where it is on a change point, or so near that the branch is
    straight.
    """
    x = locate(way, guess, 2, size)
    if x is None or abs(float(x[-1]) - length) > AT_ONCE:
        return None
    b = singular_node(way, x, way.between(a.x, x))
    if b is None or b.t[-1] < FORWARD or bend(a, b) > BEND:
        return None
    if abs(float(x[-1]) - length) < 1e-12:
        return b
    x = way.move(x, b.t * (length - float(x[-1])) / b.t[-1])
    return replace(b, x=x)
