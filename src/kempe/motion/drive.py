"""Motions with given inputs: the verb `drive` follows the time courses on one branch.

Positions follow by continuation, so that no step jumps to another branch; what rolls follows by
integration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Motion
from kempe.answers.known_values import list_known_tasks
from kempe.answers.tables import convert_columns, write_table
from kempe.arguments import (
    explain_errors,
    explain_method_errors,
    raise_interrupted,
    read_flag,
)
from kempe.arrays import check_range, is_mapping, read_mapping, read_reals
from kempe.assemble.bound import get_equation_assembler
from kempe.assemble.idle_freedoms import find_spin_lock, lock_spins
from kempe.assemble.nearest_exact import answer_within_tolerance
from kempe.budget import Budget, TimeUp, Usual
from kempe.constraints.tape import TIME
from kempe.equations.closure import Closure, DrivenClosure, close_loops
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.slip import find_first_slip, has_velocity_constraints
from kempe.equations.velocity import evaluate_velocity_rows
from kempe.errors import InputError, UnsupportedError, format_value
from kempe.geometry.clearance import watch_clearances
from kempe.geometry.path_clearance import Encounter, PathGuard, read_clearances
from kempe.model.configurations import (
    find_home,
    read_q,
    refuse_wound_angle,
    warn_of_degrees_in_values,
)
from kempe.model.packed_loops import PackedLoops, pack_loops
from kempe.model.time_coordinate import add_time_coordinate, list_timed_constraints
from kempe.motion.crossings import (
    find_branches,
    hold_rank,
    locate_singular_point,
    make_singular_node,
)
from kempe.motion.events import (
    AWKWARD,
    NEARLY,
    RESTING,
    TOUCH,
    CoordinateBound,
    OneSidedEnds,
    Patience,
    accept_step,
    find_root,
)
from kempe.motion.path import Event
from kempe.motion.rolling import compute_coordinate_rates
from kempe.motion.start import (
    begin_motion,
    explain_freedom,
    explain_open_loop,
    find_angle_or_slide,
    find_periods,
    read_longest_step,
    read_start_configuration,
    read_wished_rates,
)
from kempe.motion.trace import Progress
from kempe.numerics.clock import BROKEN_OFF, LONG, TimeLimit, find_time_limit, limit_time
from kempe.numerics.curves import (
    ACROSS,
    BEND,
    LEAST_STEP,
    Node,
    are_sides_same,
    choose_step_length,
    compute_bend_angle,
    correct_point,
    find_next_node,
    make_node,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, format_count

if TYPE_CHECKING:
    from kempe.argument_types import StartLike
    from kempe.assemble.bound import Assembler
    from kempe.constraints.base import Constraint
    from kempe.model.model import FrameLike, Model


# ---- segments of the inputs

# Between two samples the inputs move on a straight segment, and the configuration is continued
# along it as a curve in configurations and length gone on the segment. Where it turns back in that
# length the inputs cannot go on (a toggle); where two of its branches cross is a change point,
# which is passed straight on at any number of samples.

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
    """A state of the motion: configuration, input values, velocity and direction on arrival."""

    q: Array
    u: Array
    velocity: Array | None = None
    direction: Array | None = None


@dataclass(frozen=True, eq=False)
class Stuck:
    """A configuration where the inputs cannot go on, with their values and the reason.

    `reached` says that no more was requested.
    """

    q: Array
    u: Array
    reason: str
    reached: bool = False


UNREACHED = "this branch does not reach the requested inputs"
"""Reason of being stuck where the motion turns back."""


@dataclass(frozen=True, eq=False)
class SegmentContext:
    """Data that all segments of the inputs share; `singular` collects the change points passed.

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

    def follow_inputs(
        self, state: State, stuck: Stuck | None, last: Array, u: Array, k: int
    ) -> tuple[State, Stuck | None, float]:
        """Return the state after the inputs moved from `last` to `u` in sample k.

        Returned are the state, where it is stuck, if it is, and the size of a jump.

        While held, it waits at the last regular state until the inputs can be reached from there on
        a straight way.
        """
        before = len(self.singular)
        if stuck is not None and len(u) == 1 and (u - stuck.u) @ (stuck.u - state.u) > 0.0:
            return state, replace(stuck, reached=False), 0.0  # further beyond
        there, stop = self.move_to_inputs(state, u, k)
        if stuck is None:
            return there, stop, 0.0
        if stop is not None:
            del self.singular[before:]
            same = stop.reached and not stuck.reached
            return state, stop if same else replace(stuck, reached=stop.reached), 0.0
        passed = len(self.singular)
        # on the way that the inputs came: where did they come in again?
        back, entry = self.move_to_inputs(there, last, k)
        del self.singular[passed:]
        q = back.q if entry is None else entry.q
        return there, None, float(np.linalg.norm(self.closure.compute_difference(stuck.q, q)))

    def move_to_inputs(self, state: State, u: Array, k: int) -> tuple[State, Stuck | None]:
        """Return the state after the inputs moved straight to `u`.

        Where it is stuck, the last regular state and the reason are returned.
        """
        change = (u - state.u) / self.unit
        length = float(np.linalg.norm(change))
        if length < NO_CHANGE:
            return state, None
        way, a = self._begin_segment(state, change / length)
        if a.t[-1] < FORWARD:  # it begins at a toggle
            ways = [
                n
                for n in (a, a.reverse_direction())
                if (b := find_next_node(way, n, self.longest)) is not None and b.x[-1] > 0.0
            ]
            if not ways:
                return state, self._make_stuck(way, a, UNREACHED, length)
            a = max(ways, key=lambda n: float(n.t[:-1] @ self.wish))
        regular = a
        was = a
        h = 0.25 * self.longest
        while True:
            left = length - float(a.x[-1])
            landing = a.t[-1] > STEEP and h * a.t[-1] >= left
            if a.t[-1] > STEEP and not landing and h * a.t[-1] > 0.5 * left:
                h = 0.5 * left / float(a.t[-1])  # leave more than rounding for the landing
            b = find_landing_node(way, a, length) if landing else find_next_node(way, a, h)
            found = accept_step(way, a, b)
            if found is None:
                h = 0.5 * (left / float(a.t[-1]) if landing else h)
                if h < LEAST_STEP:
                    return self._make_state(way, regular), self._make_stuck(
                        way, a, "the motion is not smooth here", length
                    )
                continue
            for n in found:
                stop, end = self._find_segment_end(way, a, n, length)
                if stop is not None:
                    return self._make_state(way, regular), stop
                if end is not None:
                    return replace(self._make_state(way, end), u=u), None
                self._record_singular_point(n, k)
                regular = n if n.t[-1] > REGULAR and n.lines is None else regular
                a, was = n, a
            if landing:
                return replace(self._make_state(way, a), u=u), None
            h = choose_step_length(h, self.longest, was, a)

    def _make_state(self, way: DrivenClosure, a: Node) -> State:
        """Return the state at a node of a segment."""
        return State(a.x[:-1], way.compute_input_values(float(a.x[-1])), a.t[:-1], way.direction)

    def _make_stuck(self, way: DrivenClosure, a: Node, reason: str, length: float) -> Stuck:
        """Return the `Stuck` at a node of a segment, with the reason."""
        return Stuck(
            a.x[:-1],
            way.compute_input_values(float(a.x[-1])),
            reason,
            abs(float(a.x[-1]) - length) < SAME_INPUT,
        )

    def _record_singular_point(self, n: Node, k: int) -> None:
        """Record the change point, if a node of sample k is one."""
        if n.lines is not None:
            kind = "bifurcation" if len(n.lines) > 1 else "singular"
            lines = n.lines[:, :-1] * self.closure.unit
            self.singular.append(
                Event(
                    n.x[:-1],
                    float(k),
                    kind,
                    nullity=n.nullity,
                    directions=lines,
                    complete=n.complete,
                )
            )

    def _find_segment_end(
        self, way: DrivenClosure, a: Node, b: Node, length: float
    ) -> tuple[Stuck | None, Node | None]:
        """Find what ends the segment between two nodes: a limit, a toggle, or its own end."""
        turn = None
        if b.t[-1] <= 0.0:
            turn = find_root(way, a, b, lambda n: float(n.t[-1])) or a
        far = b if turn is None else turn
        hit = self.limits.find_first_bound(way, a, b)
        if hit is not None and float(hit[0].x[-1]) < min(float(far.x[-1]), length) + NO_CHANGE:
            return self._make_stuck(way, hit[0], f"beyond {hit[1]}", length), None
        if turn is not None and float(turn.x[-1]) < length + SAME_INPUT:
            return self._make_stuck(way, turn, UNREACHED, length), None
        if float(far.x[-1]) <= length + NO_CHANGE:
            return None, None
        high = float(a.t @ way.compute_difference(a.x, far.x))
        return None, find_root(way, a, b, lambda n: float(n.x[-1]) - length, 0.0, high)

    def _begin_segment(self, state: State, direction: Array) -> tuple[DrivenClosure, Node]:
        """Return the equations of a segment and its first node.

        Idle spins are held, and so is the rank where it is low all along.
        """
        self.update_lock(state)
        lock = find_spin_lock(self.closure)
        way, here = self._make_equations(state, direction)
        # what moves may be but a spin
        loose = here.nullity > 1 or (here.nullity == 1 and abs(here.t[-1]) < FORWARD)
        if loose and lock is None and lock_spins(self.closure, state.q, self.index):
            way, here = self._make_equations(state, direction)
        if here.nullity > 1 and hold_rank(
            self.closure, state.q, lambda: self._make_equations(state, direction)
        ):
            way, here = self._make_equations(state, direction)
        return way, self._choose_first_node(way, here, state)

    def update_lock(self, state: State) -> None:
        """Hold idle spins by other directions where the lines come near to those in use."""
        lock = find_spin_lock(self.closure)
        if lock is not None and lock.update_directions(state.q):
            self.closure.set_lock(lock)

    def _make_equations(self, state: State, direction: Array) -> tuple[DrivenClosure, Node]:
        """Return the equations of a segment, and the node where it begins."""
        way = DrivenClosure(self.closure, self.index, state.u, direction)
        return way, make_node(way, np.append(state.q, 0.0))

    def _choose_first_node(self, way: DrivenClosure, here: Node, state: State) -> Node:
        """Choose the node where a segment begins, on the branch of arrival where several meet."""
        x = here.x
        if here.nullity == 1:
            return here if here.t[-1] >= 0.0 else here.reverse_direction()
        if here.nullity == 0:
            names = ", ".join(
                repr(self.closure.system.structure.velocity_names[i]) for i in self.index
            )
            raise UnsupportedError(
                f"{self.closure.system.name} has fewer freedoms than inputs: {names} cannot be "
                "moved independently; drive fewer of them"
            )
        polished = locate_singular_point(way, x, here.nullity, 1e-5)
        toward = None if state.velocity is None else np.append(state.velocity, 0.0)
        at = x if polished is None else polished
        lines, _, complete = find_branches(way, at, toward)
        lines = lines[np.abs(lines[:, -1]) > FORWARD]
        if not len(lines):
            J = self.closure.compute_jacobian(state.q)
            names = [self.closure.system.structure.velocity_names[i] for i in self.index]
            raise UnsupportedError(explain_freedom(self.closure, J, names))
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
            x,
            lines[best],
            here.sigma,
            max(here.nullity, 2),
            here.matrix,
            here.image,
            lines,
            complete,
        )


def find_landing_node(way: DrivenClosure, a: Node, length: float) -> Node | None:
    """Find the node of the curve at this length of the segment.

    It is None where that is too far to be sure of the branch.
    """
    size = (length - float(a.x[-1])) / float(a.t[-1])
    guess = way.move_point(a.x, size * a.t)
    across = np.zeros(way.n)
    across[-1] = 1.0
    there = correct_point(way, guess, across)
    if (
        there is None
        or float(np.linalg.norm(way.compute_difference(guess, there.x))) > ACROSS * size
    ):
        return _land_on_crossing(way, a, guess, length, size)
    b = make_node(way, there.x, way.compute_difference(a.x, there.x), there.J)
    if b.sigma < AWKWARD:
        b = _land_on_crossing(way, a, there.x, length, size) or b
    return b if b.t[-1] > STEEP and compute_bend_angle(a, b) <= BEND else None


def _land_on_crossing(
    way: DrivenClosure, a: Node, guess: Array, length: float, size: float
) -> Node | None:
    """Return the node at this length where it is on a change point, or close to one."""
    x = locate_singular_point(way, guess, 2, size)
    if x is None or abs(float(x[-1]) - length) > AT_ONCE:
        return None
    b = make_singular_node(way, x, way.compute_difference(a.x, x))
    if b is None or b.t[-1] < FORWARD or compute_bend_angle(a, b) > BEND:
        return None
    if abs(float(x[-1]) - length) < 1e-12:
        return b
    x = way.move_point(x, b.t * (length - float(x[-1])) / b.t[-1])
    return replace(b, x=x)


# ---- regular samples, many at once

# Away from singular points a configuration follows from those before it by Newton's method, in the
# kernel of `assemble`. What a step of a segment demands of its ends is then verified for all steps
# at once: length, correction, angle between tangents, sign of the determinant, distance from
# singular points, limits. The first step that fails leaves its sample to the steps above.

MOST_STEPS = 256
"""Steps that are verified at once."""
MOST_ENTRIES = 500_000
"""Entries of their Jacobians."""
FIRST_SAMPLES = 32
"""Samples that are tried at once at first; after a success twice as many."""
PART = 0.5
"""Share of the longest step that steps aim at."""
CONSISTENT = 1e-8
"""How far the velocities of the inputs may miss the equations."""


class RegularSteps:
    """Steps through many samples of a motion that meets no singular point and no limit.

    Motions whose equations hold more than loops and coordinates, and systems with declared
    one-sided constraints, are left to single steps.
    """

    def __init__(self, context: SegmentContext):
        closure = context.closure
        system = closure.system
        self.context = context
        self.closure = closure
        given = [*context.index, *closure.held]
        self.free = np.setdiff1d(np.arange(system.nv), given)
        bounds = context.limits.all
        self.bounds = [b for b in bounds if isinstance(b, CoordinateBound)]
        self.places = closure.place[context.index]
        self.count = FIRST_SAMPLES
        self.patience = Patience()
        self._locked: tuple[PackedLoops, PackedLoops] | None = None

    @cached_property
    def _assembler(self) -> Assembler:
        """The assembler whose known coordinates are those that are driven or held."""
        system = self.closure.system
        places = self.closure.place[[*self.context.index, *self.closure.held]]
        names = tuple(system.coordinate_names[i] for i in map(int, places))
        return get_equation_assembler(system, names)

    @property
    def equations(self) -> int:
        """Number of equations of loops and of the lock of idle spins."""
        return len(self.closure.weight)

    @property
    def _loops(self) -> PackedLoops:
        """The loops of the assembler, with idle spins held as the closure holds them now."""
        assembler = self._assembler
        lock = find_spin_lock(self.closure)
        if lock is None:
            return assembler.loops
        if self._locked is None or self._locked[0] is not self.closure.loops:
            loops = pack_loops(
                assembler.tree, assembler.explicit, assembler.held, further=lock.list_ties
            )
            self._locked = self.closure.loops, loops
        return self._locked[1]

    @cached_property
    def _bound_arrays(self) -> tuple[np.ndarray, np.ndarray, Array, Array]:
        """Places in q, velocity indices, signs and values of the limits."""
        rows = [(b.place, b.of or 0, b.sign, b.limit) for b in self.bounds]
        place, of, sign, limit = np.array(rows).reshape(-1, 4).T
        return place.astype(np.int64), of.astype(np.int64), sign, limit

    def choose_sample_count(self) -> int:
        """Choose how many samples are tried at once; 0 where the next one is left to single steps."""
        closure = self.closure
        plain = len(self.bounds) == len(self.context.limits.all) and not closure.more
        if not self.patience.count_step() or not plain:
            return 0
        if not 0 < len(self.free) <= self.equations:
            return 0
        size = self.equations * self.closure.n
        return max(1, min(self.count, MOST_STEPS, MOST_ENTRIES // size))

    def follow_samples(self, state: State, ends: Sequence[Array]) -> tuple[State, Array]:
        """Follow the inputs to the first samples of `ends`, (inputs,) each, that steps reach.

        Returned are the state at the last of them, and the configurations (k, nq) at each.
        """
        points = np.array([state.u, *ends])
        change = np.diff(points, axis=0) / self.context.unit
        length = np.linalg.norm(change, axis=1)
        moving = int(np.argmin(np.append(length >= NO_CHANGE, False)))
        self.context.update_lock(state)
        found = self._take_steps(state, points[: moving + 1], length[:moving]) if moving else None
        self.patience.record_trial(found is not None)
        if found is None:
            self.count = FIRST_SAMPLES
            return state, np.empty((0, self.closure.system.nq))
        self.count = 2 * len(found[1])
        return found

    def _take_steps(self, state: State, points: Array, length: Array) -> tuple[State, Array] | None:
        """Take regular steps from the state through inputs `points` (n + 1, inputs).

        `length` (n,) is the distance between neighbours. None is returned where no sample is
        reached.
        """
        direction = np.diff(points, axis=0) / self.context.unit / length[:, None]
        rates = self._compute_rates(state.q[None])
        if rates is None:
            return None
        tangents = self._make_tangents(rates.gain, direction)
        size = float((length * np.linalg.norm(tangents, axis=1)).max())
        parts = math.ceil(size / (PART * self.context.longest)) if math.isfinite(size) else 0
        most = max(1, min(MOST_STEPS, MOST_ENTRIES // (self.equations * self.closure.n)))
        samples = min(len(length), most // parts) if parts else 0
        if not samples:
            return None
        share = np.arange(1, parts + 1) / parts
        u = (
            points[:samples, None]
            + share[:, None] * np.diff(points[: samples + 1], axis=0)[:, None]
        )
        u[:, -1] = points[1 : samples + 1]
        starts = np.tile(state.q, (samples * parts + 1, 1))
        starts[1:, self.places] = u.reshape(-1, len(self.places))
        assembler = self._assembler
        q, _, info = assembler.run(
            starts, assembler.no_pins, 1, limits=False, follow=True, loops=self._loops
        )
        good = info[1:, 0] == Status.SOLVED
        count = int(np.argmin(np.append(good, False))) // parts * parts
        q = q[: count + 1]
        direction = np.repeat(direction[:samples], parts, axis=0)[:count]
        length = np.repeat(length[:samples] / parts, parts)[:count]
        rates = self._compute_rates(q)
        if not count or rates is None:
            return None
        before = self._make_tangents(rates.gain[:-1], direction)
        after = self._make_tangents(rates.gain[1:], direction)
        good = self._verify_steps(q, length, rates, before, after)
        reached = int(np.argmin(np.append(good, False))) // parts
        lock = find_spin_lock(self.closure)
        if lock is not None:  # what spins is held anew where a segment begins
            near = lock.find_near_lines(q[parts : reached * parts + 1 : parts])
            reached = min(reached, 1 + int(np.argmax(np.append(near, True))))
        if not reached:
            return None
        last = reached * parts - 1
        velocity = after[last, :-1] / np.linalg.norm(after[last])
        there = State(q[last + 1], points[reached], velocity, direction[last])
        return there, q[parts : last + 2 : parts]

    def _make_tangents(self, gain: Array, direction: Array) -> Array:
        """Make the tangents (n, nv + 1) of segments with these directions (n, inputs).

        Their last entry, the rate of the length, is 1.
        """
        out = np.zeros((len(direction), self.closure.n + 1))
        out[:, self.free] = (gain @ direction[..., None])[..., 0]
        out[:, self.context.index] = direction
        out[:, -1] = 1.0
        return out

    def _compute_rates(self, q: Array) -> _Rates | None:
        """Compute how the velocities follow those of the inputs at configurations (n, nq).

        None is returned where they do not at one of them.
        """
        closure = self.closure
        F, J = closure.evaluate_many_points(q)
        columns = J[:, : self.equations]
        A = np.ascontiguousarray(columns[..., self.free])
        B = np.ascontiguousarray(columns[..., self.context.index])
        At = np.swapaxes(A, -1, -2)
        try:
            inverse = np.linalg.inv(At @ A) @ At
        except np.linalg.LinAlgError:
            return None
        gain = -(inverse @ B)
        closed = np.abs(F[:, : self.equations]).max(axis=1)
        closed = closed < closure.closed * (1.0 + 0.01 * np.abs(q).max(axis=1)) + closure.rounding
        closed &= np.abs(A @ gain + B).max(axis=(1, 2)) < CONSISTENT
        # of the equations of a segment: a left inverse, and the equations
        inputs = B.shape[-1]
        small = 1.0 / np.sqrt(
            _bound_square_norm(inverse) + 2.0 * _bound_square_norm(gain) + inputs + 2
        )
        large = np.sqrt(_bound_square_norm(A) + _bound_square_norm(B) + inputs + 1)
        return _Rates(A, gain, closed, small / large)

    def _verify_steps(
        self, q: Array, length: Array, rates: _Rates, before: Array, after: Array
    ) -> np.ndarray:
        """Verify the steps between configurations (n + 1, nq); return a mask (n,).

        `before` and `after` are the tangents (n, nv + 1) at both ends of each.
        """
        closure = self.closure
        here = np.linalg.norm(before, axis=1)
        there = np.linalg.norm(after, axis=1)
        size = length * here
        guess = closure.move_point(q[:-1], length[:, None] * before[:, :-1])
        miss = np.linalg.norm(closure.compute_difference(guess, q[1:]), axis=1)
        chord = np.linalg.norm(before / here[:, None] - after / there[:, None], axis=1)
        good = rates.closed[:-1] & rates.closed[1:]
        good &= np.minimum(rates.sigma[:-1], rates.sigma[1:]) > NEARLY
        good &= size <= self.context.longest
        good &= np.maximum(here, there) * STEEP < 1.0
        good &= miss <= ACROSS * size
        good &= chord <= 2.0 * math.sin(0.5 * BEND)
        good &= are_sides_same(rates.matrix)
        if self.bounds:
            place, of, side, limit = self._bound_arrays
            over = side * (q[:, place] - limit)
            leave = side * before[:, of] / here[:, None] <= RESTING
            arrive = side * after[:, of] / there[:, None] >= -RESTING
            inside = (over[:-1] <= -TOUCH) & (over[1:] <= TOUCH) & (leave | arrive)
            good &= inside.all(axis=1)
        return good


class _Rates(NamedTuple):
    """Velocities that follow from those of the inputs, at n configurations.

    `matrix` (n, m, free) is the Jacobian of the loops by the free velocities, `gain` (n, free,
    inputs) the free velocities for each input, `closed` (n,) whether the equations hold and are
    consistent, `sigma` (n,) a lower bound of the relative singular value that a `Node` has.
    """

    matrix: Array
    gain: Array
    closed: np.ndarray
    sigma: Array


def _bound_square_norm(A: Array) -> Array:
    """Bound the squares (n,) of the spectral norms of matrices (n, m, k).

    Two bounds are known: the sum of squares, and the largest sum of a row times that of a column.
    """
    size = np.abs(A)
    sums = size.sum(axis=2).max(axis=1) * size.sum(axis=1).max(axis=1)
    return np.minimum(np.square(size).sum(axis=(1, 2)), sums)


# ---- inputs of what rolls

# All else follows by integration, and the motion must not slip. The velocities satisfy the inputs
# and the loops; among those that do, the ones that slip least are taken. After each sample the
# inputs
# have their values and the loops are closed. Whether the motion slips is decided by its samples.

STEP = 0.02
"""Longest step of integration, in radians and characteristic lengths."""
MOST = 10_000
"""Steps at most between two samples."""
MIDDLE = 12
"""Repetitions after which the middle of a step is known."""
ERROR = 1e-9
"""Local error of the integration."""
MISS = 1e-9
"""By how much loops may miss the velocities of inputs, of rows of size 1."""


class RollingSamples(NamedTuple):
    """Configurations (n, nq) at the samples that were computed, and why the motion ends early.

    `broken` is the exception that broke it off.
    """

    q: Array
    reason: str
    broken: BaseException | None


def drive_rolling(
    system: Model,
    names: Sequence[str],
    hold: Mapping[str, float],
    start: Any,
    clock: Array,
    samples: Callable[[int, int], list[Array]],
    limits: bool,
    budget: TimeLimit,
) -> RollingSamples | None:
    """Compute the motion of a rolling system under inputs; None where it cannot begin.

    `samples` gives the inputs, as `_read_samples` returns it.

    Errors: `UnsupportedError` where the inputs leave freedoms.
    """
    index = [find_angle_or_slide(system, n) for n in (*names, *hold)]
    follow = _Follow(system, index, names, hold, budget)
    q = _find_first_configuration(system, start, hold, names, samples(0, 1)[-1])
    if q is None:
        return None
    out = [q]
    reason = ""
    broken = None
    rows = pack_one_sided_rows(system)
    before = samples(0, 1)[-1]
    try:
        for k in range(1, len(clock)):
            budget.check_time()
            q = follow.advance_to_sample(
                out[-1], float(clock[k - 1]), float(clock[k]), before, lambda n, k=k: samples(k, n)
            )
            before = samples(k, 1)[-1]
            if q is None:
                reason = f"at time {clock[k]:.6g} the inputs cannot be had: the loops do not close"
                break
            over = rows.compute_excess(q, not limits)
            if over.any():
                name = rows.names[int(np.argmax(over))]
                reason = (
                    f"it stops before time {clock[k]:.6g}, where {name!r} would be beyond its limit"
                )
                break
            out.append(q)
    except BROKEN_OFF as error:
        broken = error
    done = np.array(out)
    slip = find_first_slip(system, done, clock[: len(done)])
    if slip is not None:
        speed = abs(slip.amount) / slip.time
        reason = (
            f"the inputs make it slip: before time {clock[slip.index]:.6g} by {speed:.3g} "
            f"{slip.unit}/s across {slip.name!r}; getting there is a manoeuvre"
        )
        done = done[: slip.index]
    return RollingSamples(done, reason, broken)


def _find_first_configuration(
    system: Model, start: Any, hold: Mapping[str, float], names: Sequence[str], u: Array
) -> Array | None:
    """Find the closed configuration (nq,) near the start with inputs `names` at u and `hold` held.

    It is None on failure.
    """
    near = read_start_configuration(system, start, hold)
    index = [find_angle_or_slide(system, n) for n in (*names, *hold)]
    closure = Closure(system)
    near[closure.place[index]] = [*u, *hold.values()]
    return close_loops(Closure(system, index, near), near)


class _Follow:
    """Velocities of a rolling system that follow from those of inputs, and steps along them."""

    def __init__(
        self,
        system: Model,
        index: list[int],
        names: Sequence[str],
        hold: Mapping[str, float],
        time: TimeLimit,
    ) -> None:
        self.system = system
        self.index = index
        self.closure = Closure(system)
        self.time = time
        self.names = names
        self.held = [0.0] * len(hold)
        self.slips = False
        self.loops = len(self.closure.weight)

    def compute_velocities(self, q: Array, t: float, speeds: Array) -> Array:
        """Compute the scaled velocities (nv,).

        Errors: `UnsupportedError` where they are not determined.
        """
        unit = self.closure.unit
        A, b = evaluate_velocity_rows(self.system, q, t)
        A = A * unit
        size = np.linalg.norm(A, axis=1)
        size = np.where(size > 0.0, size, 1.0)
        A = A / size[:, None]
        b = b / size
        J = self.closure.compute_jacobian(q)[: self.loops]
        M = np.concatenate([J, np.eye(len(unit))[self.index]])
        wanted = np.concatenate([np.zeros(len(J)), np.append(speeds, self.held) / unit[self.index]])
        held = Spectrum(M, 1.0)
        N = held.compute_null_space(Level.CLOSED)
        z = held.solve_least_squares(wanted, Level.CLOSED)
        if np.abs(M @ z - wanted).max(initial=0.0) > MISS * max(
            1.0, float(np.abs(wanted).max(initial=0.0))
        ):
            raise UnsupportedError(
                f"the inputs {', '.join(map(repr, self.names))} fight each other: the loops do not "
                "allow their velocities together"
            )
        if not N.shape[1]:
            return z
        rolling = Spectrum(A @ N, 1.0)
        loose = (N @ rolling.compute_null_space(Level.CLOSED)).T
        if len(loose):
            moving = [
                n
                for n, x in zip(
                    self.system.structure.velocity_names, np.abs(loose).max(axis=0), strict=True
                )
                if x > 1e-6
            ]
            many = len(loose)
            raise UnsupportedError(
                f"the inputs {', '.join(map(repr, self.names))} leave {many} "
                f"freedom{'s' * (many != 1)} of motion, among {', '.join(map(repr, moving[:6]))}; "
                "drive or hold more, or give velocities (system.simulate)"
            )
        z = z + N @ rolling.solve_least_squares(b - A @ z, Level.CLOSED)
        self.slips |= bool(
            np.abs(A @ z - b).max(initial=0.0) > MISS * max(1.0, float(np.linalg.norm(z)))
        )
        return z

    def advance_to_sample(
        self, q: Array, t0: float, t1: float, u: Array, samples: Callable[[int], list[Array]]
    ) -> Array | None:
        """Return the configuration (nq,) at the next sample.

        Times are from t0 to t1, inputs from u to those of the `samples`.
        """
        end = samples(1)[-1]
        h = t1 - t0
        speed = float(np.linalg.norm(self.compute_velocities(q, t0, (end - u) / h)))
        parts = min(max(1, math.ceil(speed * h / STEP)), MOST)
        values = [u, *samples(2 * parts)]
        self.slips = False
        x = q
        for k in range(parts):
            self.time.check_time()
            there = self._integrate_step(
                x, t0 + k * h / parts, h / parts, values[2 * k : 2 * k + 3]
            )
            if there is None:
                return None
            x = there
        # between samples of inputs that are too many, straight lines do, if those at samples do not
        if self.slips:
            x = self._make_middle_step(q, t0, h, u, end)
        near = x.copy()
        near[self.closure.place[self.index[: len(end)]]] = end
        return close_loops(Closure(self.system, self.index, near), near)

    def _integrate_step(self, q: Array, t: float, h: float, values: list[Array]) -> Array | None:
        """Return the configuration (nq,) after a step, with inputs on a parabola of three values.

        It is None where the integration does not come to the end of the step.
        """
        from scipy import integrate  # only here: it takes long

        a, m, b = values

        def compute_slope(s: float, x: Array) -> Array:
            """Compute the rates of the coordinates at the time s of the step."""
            part = s / h
            speeds = (4.0 * m - 3.0 * a - b + 4.0 * part * (a + b - 2.0 * m)) / h
            return compute_coordinate_rates(
                self.system, x, self.compute_velocities(x, t + s, speeds) * self.closure.unit
            )

        solve = cast(Any, integrate).solve_ivp
        motion = solve(compute_slope, (0.0, h), q, first_step=h, rtol=ERROR, atol=ERROR)
        return motion.y[:, -1] if motion.success else None

    def _make_middle_step(self, q: Array, t: float, h: float, u: Array, end: Array) -> Array:
        """Make one step by the velocities that slip least in the middle of the step."""
        z = self.compute_velocities(q, t, (end - u) / h)
        for _ in range(MIDDLE):
            z = self.compute_velocities(
                self.closure.move_point(q, 0.5 * h * z), t + 0.5 * h, (end - u) / h
            )
        return self.closure.move_point(q, h * z)


# ---- the answer and the verb

USUAL = Usual("drive", step=None, time_limit=LONG, progress=None)
CONTINUOUS = 1e-5
"""Distance between the pose that was held and the one from which it goes on, above which that is a
jump."""
BETWEEN = 0.2
"""Change of an input between two samples above which a function is evaluated in between, too."""
MOST_PARTS = 200
"""Values in between two samples for which a function is evaluated at most."""


def _format_samples(first: int, last: int) -> str:
    """Return the samples as text: 'sample 3', 'samples 3 to 5'."""
    return f"sample {first}" if first == last else f"samples {first} to {last}"


@dataclass(frozen=True, eq=False)
class Toggle(InWords):
    """Samples `first` to `last` with inputs out of reach, where the motion stays at `q` (nq,).

    `reason` says why.
    """

    first: int
    last: int
    q: Array
    inputs: dict[str, float]
    reason: str

    def __str__(self) -> str:
        at = ", ".join(f"{k!r} = {v:.9g}" for k, v in self.inputs.items())
        return f"{_format_samples(self.first, self.last)}: held at {at}: {self.reason}"


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Drive(Motion):
    """Motion of a mechanism with prescribed inputs.

    Attributes
    ----------
    q
        Closed configurations (n, nq), one for each of the `times` (n,).
    inputs
        The prescribed values by coordinate name.
    held
        Mask (n,) of samples at which the inputs cannot be reached and the last configuration stays;
        see `toggles`.
    jumps
        Pairs (index, distance) of samples at which the motion is not continuous: it continues at
        another configuration than the one that was held.
    singular_points
        Change points that the motion passed, straight on.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work; the finished samples remain.
    """

    _entries = ("times", "inputs", "held", "jumps", "interrupted", "late")

    system: Model
    q: Array
    times: Array
    inputs: dict[str, Array]
    held: Array
    toggles: tuple[Toggle, ...]
    jumps: tuple[tuple[int, float], ...]
    singular_points: tuple[Event, ...]
    success: bool
    interrupted: bool
    reason: str = ""
    late: bool = False
    _clock: Array | None = None
    """Time (n,) at which each configuration holds, where equations depend on time: of those `held`
    an earlier one."""

    def table(self, frames: Iterable[FrameLike] = ()) -> tuple[list[str], Array]:
        """Return names and columns (n, k) for a file.

        These are time, all coordinates, whether held, x, y (and z) of frames.
        """
        names, columns = self._make_columns("time", self.times, frames)
        return [*names, "held"], np.column_stack([columns, self.held])

    def save(
        self,
        path: str | FilePath,
        frames: Iterable[FrameLike] = (),
        *,
        degrees: bool = False,
    ) -> FilePath:
        """Write the `table` with these frames to a .csv or .npy file; return the path.

        Errors: `InputError`.
        """
        return write_table(path, *convert_columns(*self.table(frames), self._list_units(), degrees))

    @property
    def code(self) -> Status:
        """Outcome: `PARTLY` where inputs cannot be reached, or the motion jumps."""
        return (
            Status.SOLVED
            if self.success
            else self._find_early_end()
            or (Status.NOT_FOUND if self.reason and len(self) < 2 else Status.PARTLY)
        )

    def _list_times(self) -> Any:
        return 0.0 if self._clock is None else self._clock

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        """The inputs, of samples that are not held, where they belong to coordinates."""
        own = [] if self.reason else [n for n in self.inputs if n in self.system.coordinate_names]
        return list_known_tasks(
            self.system, {n: np.where(self.held, self.values(n), self.inputs[n]) for n in own}
        )

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        if self.reason:
            return self.reason
        text = (
            f"{format_count(len(self), 'sample')}, "
            f"{format_count(len(self.singular_points), 'change point')} passed"
        )
        if self.toggles:
            count = int(self.held.sum())
            text += (
                f"; at {format_count(count, 'sample')} the inputs cannot be reached and the last "
                "pose is held"
            )
        if self.jumps:
            text += f"; it jumps at samples {', '.join(str(k) for k, _ in self.jumps)}"
        return text + self._describe_early_end()

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        lines = [str(toggle) for toggle in self.toggles]
        lines += [
            f"sample {k}: it goes on {size:.6g} away from where it was held"
            for k, size in self.jumps
        ]
        return [*lines, *super()._list_notes()]


def _make_unstarted_drive(
    time: TimeLimit,
    system: Model,
    inputs: Mapping[str, Any],
    times: Any = None,
    start: Any = None,
    **_: Any,
) -> Drive:
    """Return the answer where the time was up before a closed configuration was known.

    The motion stays where `start` is, or at home.
    """
    near = (
        find_home(system)
        if start is None or isinstance(start, str) or is_mapping(start)
        else read_q(system, start)
    )
    clock, samples = _read_samples(inputs, times)
    requested = {n: np.array([v]) for n, v in zip(inputs, samples(0, 1)[-1].tolist(), strict=True)}
    said = f"nothing was driven: {time.describe_end_reason(TimeUp())} came before a closed configuration was known"
    return Drive(
        system,
        near[None],
        clock[:1],
        requested,
        np.ones(1, dtype=bool),
        (),
        (),
        (),
        False,
        False,
        said,
        True,
    )


@explain_errors
@raise_interrupted
@limit_time(USUAL, _make_unstarted_drive)
@answer_within_tolerance()
def drive(
    system: Model,
    inputs: Mapping[str, ArrayLike | Callable[[float], float]],
    times: ArrayLike | None = None,
    start: StartLike | None = None,
    *,
    hold: Mapping[str, float] | None = None,
    toward: Mapping[str, float] | None = None,
    limits: bool = True,
    clearance: Constraint | Sequence[Constraint] | None = None,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Drive:
    """Compute the motion that follows prescribed inputs; see `System.drive`."""
    time = find_time_limit(USUAL, budget)
    guard = None
    if clearance is None:
        time.release_reserved_time()  # there is nothing to do afterwards
    else:
        guard = PathGuard(system, watch_clearances(system, read_clearances(clearance)))
    motion = _follow_inputs(system, inputs, times, start, hold, toward, limits, budget, time)
    if guard is None:
        return motion
    time.release_reserved_time()
    return _stop_before_encounter(motion, *guard.check_in_time(motion.q, time))


def _follow_inputs(
    system: Model,
    inputs: Any,
    times: Any,
    start: Any,
    hold: Any,
    toward: Any,
    limits: bool,
    budget: Budget | None,
    time: TimeLimit,
) -> Drive:
    """Compute the motion that follows prescribed inputs, whatever bodies it brings together."""
    given = read_mapping(inputs)
    if given is None:
        raise InputError(
            f"inputs is {format_value(inputs)}; it must be a dict of values by coordinate name"
        )
    inputs = given
    read_flag(limits, "limits")
    spend = USUAL.complete_budget(budget)
    if list_timed_constraints(system):
        if TIME in inputs and TIME not in system.coordinate_names:
            raise InputError(f"{TIME!r} is the time and no input; give it by `times`")
        clock, _ = _read_samples({**inputs, TIME: 0.0}, times)
        found = _follow_inputs(
            add_time_coordinate(system),
            {**inputs, TIME: clock},
            clock,
            _append_time(start, clock),
            hold,
            toward,
            limits,
            budget,
            time,
        )
        return _remove_time(found, system)
    warn_of_degrees_in_values(system, inputs)
    names = list(inputs)
    index = [find_angle_or_slide(system, n) for n in names]
    if hold and set(hold) & set(names):
        raise InputError(
            f"{sorted(set(hold) & set(names))} are both driven and held; a coordinate is one of "
            "them"
        )
    turning = system.structure.coordinates.turning
    angles = {n for n, i in zip(names, index, strict=True) if turning[i]}
    clock, samples = _read_samples(inputs, times, angles)
    longest = read_longest_step(spend.step)
    if has_velocity_constraints(system):
        rolled = drive_rolling(system, names, dict(hold or {}), start, clock, samples, limits, time)
        return _make_rolling_drive(rolled, system, names, clock, samples)
    first = dict(zip(names, samples(0, 1)[-1].tolist(), strict=True))
    closure, q = _begin_drive(system, start, dict(hold or {}), first, index)
    if q is None:
        near = read_start_configuration(system, start, dict(hold or {}))
        requested = {n: np.array([v]) for n, v in first.items()}
        said = explain_open_loop(system, start, {**(hold or {}), **first})
        return Drive(
            system,
            near[None],
            clock[:1],
            requested,
            np.ones(1, dtype=bool),
            (),
            (),
            (),
            False,
            False,
            said,
        )
    closure.budget = time
    wish = read_wished_rates(system, toward)
    context = SegmentContext(
        closure, index, longest, OneSidedEnds(closure, limits), wish / closure.unit
    )
    return _drive_samples(context, q, names, clock, samples, spend.progress)


def _stop_before_encounter(motion: Drive, checked: int, met: Encounter | None) -> Drive:
    """Return the samples before bodies come too near, which they do on the way that `met` says.

    Without `met`, the motion ends after the samples that were `checked` before the time was up.
    """
    n = checked if met is None else met.clear
    if met is None and n == len(motion):
        return motion
    last = max(n, 1)
    reason = ""
    if met is not None:
        where = f"it stops after sample {n - 1} (time {motion.times[n - 1]:.6g}), before"
        reason = f"{where if n else 'it begins where'} {met.describe_bodies()}"
    return replace(
        motion,
        q=motion.q[:last],
        times=motion.times[:last],
        inputs={name: values[:last] for name, values in motion.inputs.items()},
        held=motion.held[:last],
        toggles=tuple(replace(t, last=min(t.last, n - 1)) for t in motion.toggles if t.first < n),
        jumps=tuple(jump for jump in motion.jumps if jump[0] < n),
        singular_points=tuple(event for event in motion.singular_points if event.s < n),
        success=False,
        reason=reason,
        late=motion.late or met is None,
        _clock=None if motion._clock is None else motion._clock[:last],
    )


def _append_time(start: Any, clock: Array) -> Any:
    """Return the start with the first time appended, where it is a configuration."""
    if start is None or isinstance(start, str) or not clock.size:
        return start
    return (
        {**start, TIME: clock[0]}
        if is_mapping(start)
        else np.append(np.asarray(start, float), clock[0])
    )


def _remove_time(found: Drive, system: Model) -> Drive:
    """Return the motion in the coordinates of the system itself."""
    inputs = {n: x for n, x in found.inputs.items() if n != TIME}
    toggles = tuple(replace(toggle, q=toggle.q[:-1]) for toggle in found.toggles)
    events = tuple(replace(event, q=event.q[:-1]) for event in found.singular_points)
    return replace(
        found,
        system=system,
        q=found.q[:, :-1],
        inputs=inputs,
        toggles=toggles,
        singular_points=events,
        _clock=found.q[:, -1],
    )


def _make_rolling_drive(
    found: RollingSamples | None,
    system: Model,
    names: list[str],
    clock: Array,
    samples: Callable[[int, int], list[Array]],
) -> Drive:
    """Return the motion of a rolling system as an answer."""
    if found is None:
        found = RollingSamples(
            read_start_configuration(system, None, {})[None],
            "the loops do not close near the start",
            None,
        )
    n = len(found.q)
    requested = np.array([samples(k, 1)[-1] for k in range(n)]).reshape(n, len(names))
    return Drive(
        system,
        found.q,
        clock[:n],
        {name: requested[:, j] for j, name in enumerate(names)},
        np.zeros(n, dtype=bool),
        (),
        (),
        (),
        not found.reason and found.broken is None,
        isinstance(found.broken, KeyboardInterrupt),
        found.reason,
        isinstance(found.broken, TimeUp),
    )


def _read_samples(
    inputs: Mapping[str, Any], times: ArrayLike | None, angles: Set[str] = frozenset()
) -> tuple[Array, Callable[[int, int], list[Array]]]:
    """Read the inputs as times (n,) and a function (k, parts) of their values.

    The function gives the inputs on the way from sample k - 1 to sample k.
    """
    if not inputs:
        raise InputError("there are no inputs; give values by coordinate name")
    functions = [n for n, f in inputs.items() if callable(f)]
    arrays = {n: _read_numbers(v, f"input {n!r}") for n, v in inputs.items() if not callable(v)}
    sizes = {a.shape[0] for a in arrays.values() if a.ndim == 1}
    if times is not None:
        clock = _read_numbers(times, "times")
    elif functions and not sizes:
        raise InputError(
            f"inputs {', '.join(map(repr, functions))} are functions of time; give the times"
        )
    else:
        clock = np.arange(float(max(sizes, default=1)))
    bad = [n for n, a in arrays.items() if a.ndim > 1 or (a.ndim == 1 and a.shape != clock.shape)]
    if not clock.size:
        raise InputError("there are no samples: times or inputs are empty")
    if clock.ndim != 1 or bad:
        raise InputError(
            f"times and inputs must be one number or {clock.shape} numbers; {', '.join(bad)} differ"
        )
    back = np.flatnonzero(~(np.diff(clock) > 0.0))
    if np.isfinite(clock).all() and len(back):
        k = int(back[0])
        raise InputError(
            f"times must grow from sample to sample: {clock[k + 1]:g} at sample {k + 1} comes "
            f"after {clock[k]:g}"
        )
    full = {n: np.broadcast_to(a, clock.shape) for n, a in arrays.items()}
    for name, a in {"times": clock, **{f"input {n!r}": a for n, a in full.items()}}.items():
        check_range(a, name)
    for n in angles & full.keys():
        refuse_wound_angle(float(np.abs(full[n]).max()), f"input {n!r}")

    def evaluate_input(name: str, before: int, k: int, f: float) -> float:
        """Return an input at the fraction f of the way from one sample to the next."""
        if name in functions:
            t = (1.0 - f) * clock[before] + f * clock[k]
            found = _read_numbers(inputs[name](t), f"input {name!r} at time {t:g}")
            if found.size != 1:
                raise InputError(
                    f"input {name!r} at time {t:g} has shape {found.shape}; it must be one number"
                )
            number = float(check_range(found, f"input {name!r} at time {t:g}").item())
            if name in angles:
                refuse_wound_angle(number, f"input {name!r} at time {t:g}")
            return number
        return float((1.0 - f) * full[name][before] + f * full[name][k])

    def sample_inputs(k: int, parts: int) -> list[Array]:
        """Return the inputs at equal parts of the way to sample k."""
        before = max(k - 1, 0)
        return [
            np.array([evaluate_input(n, before, k, float(f)) for n in inputs])
            for f in (np.linspace(0.0, 1.0, parts + 1)[1:] if parts > 1 else (1.0,))
        ]

    return clock, sample_inputs


def _read_numbers(values: Any, subject: str) -> Array:
    """Read real numbers as an array. Errors: `InputError`."""
    return read_reals(values, subject, "numbers")


def _begin_drive(
    system: Model,
    start: Any,
    hold: dict[str, float],
    first: dict[str, float],
    index: Sequence[int],
) -> tuple[Closure, Array | None]:
    """Return the equations, and a closed configuration (nq,) to begin with, or None."""
    if start is None and "closed" not in system.structure.posture_names:
        start = first
    closure, q = begin_motion(system, start, hold)
    if q is None:
        return closure, None
    u = q[closure.place[list(index)]]
    period = find_periods(system)[list(index)]
    gap = np.array(list(first.values())) - u
    turns = np.divide(gap, period, out=np.zeros_like(gap), where=period > 0.0)
    q[closure.place[list(index)]] += np.round(turns) * period
    return closure, q


def _count_near_samples(u: Array, ends: Sequence[Array], unit: Array) -> int:
    """Count the first samples that change no input by more than `BETWEEN`, from `u` on."""
    change = np.abs(np.diff(np.array([u, *ends]), axis=0) / unit).max(axis=1)
    return int(np.argmax(np.append(change > BETWEEN, True)))


def _drive_samples(
    context: SegmentContext,
    q: Array,
    names: list[str],
    clock: Array,
    samples: Callable[[int, int], list[Array]],
    progress: Progress | None,
) -> Drive:
    """Compute the motion through all samples."""
    state = State(q, q[context.closure.place[context.index]])
    requested: list[Array] = []
    poses: list[Array] = []
    held: list[bool] = []
    toggles: list[Toggle] = []
    jumps: list[tuple[int, float]] = []
    stuck: Stuck | None = None
    last = state.u
    broken = None
    regular = RegularSteps(context)

    def note_sample(q: Array, waits: bool) -> None:
        """Append the configuration of a sample, and whether the motion is held at it."""
        poses.append(q)
        held.append(waits)
        if progress is not None and (len(held) - 1) % 16 == 0:
            progress(len(held), len(clock))

    try:
        with context.closure.budget:
            while (k := len(held)) < len(clock):
                ahead = regular.choose_sample_count() if k and stuck is None else 0
                for i in range(len(requested), min(k + max(ahead, 1), len(clock))):
                    requested.append(samples(i, 1)[-1])
                if ahead:
                    near = _count_near_samples(state.u, requested[k:], context.unit)
                    state, reached = regular.follow_samples(state, requested[k : k + near])
                    for q in reached:
                        note_sample(q, False)
                    if len(reached):
                        last = state.u
                        continue
                end = requested[k]
                parts = (
                    int(np.ceil(np.abs((end - last) / context.unit).max() / BETWEEN)) if k else 1
                )
                # a way back in several inputs is looked for once a sample
                single = len(names) == 1 or stuck is None
                for u in samples(k, min(max(parts, 1), MOST_PARTS) if single else 1):
                    state, stuck, gap = context.follow_inputs(state, stuck, last, u, k)
                    last = u
                    if gap > CONTINUOUS:
                        jumps.append((k, gap))
                if stuck is not None and not stuck.reached:
                    if toggles and toggles[-1].last == k - 1 and toggles[-1].q is stuck.q:
                        toggles[-1] = replace(toggles[-1], last=k)
                    else:
                        at = dict(zip(names, stuck.u.tolist(), strict=True))
                        toggles.append(Toggle(k, k, stuck.q, at, stuck.reason))
                note_sample(
                    state.q if stuck is None else stuck.q, stuck is not None and not stuck.reached
                )
    except BROKEN_OFF as error:
        broken = error
    n = len(held)
    values = np.array(requested[:n]).reshape(n, len(names))
    return Drive(
        context.closure.system,
        np.array(poses[:n]).reshape(n, context.closure.system.nq),
        clock[:n],
        {name: values[:, j] for j, name in enumerate(names)},
        np.array(held[:n], dtype=bool),
        tuple(toggles),
        tuple(j for j in jumps if j[0] < n),
        tuple(context.singular),
        not (broken or any(held) or jumps),
        isinstance(broken, KeyboardInterrupt),
        late=isinstance(broken, TimeUp),
    )
