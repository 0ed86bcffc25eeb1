"""Manoeuvres: how what cannot move sideways gets there all the same, by turns, arcs and straight
lines.

The path is put together of pieces in which the axle keeps its speed and its turning, so that it is
known in closed form and obeys the velocity rows at every time. A car without steering limits turns
on the spot between two straight lines; one with a turning radius takes the shortest way of Reeds
and Shepp (1990), by alternation where there is no room. Each sample is held against the velocity
rows of the system itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.continuation.rolling import slip
from kempe.analysis.manoeuvre.manoeuvre_path import ExactManoeuvre, Manoeuvre, Piece
from kempe.analysis.manoeuvre.steering import Plan, Refused, plans
from kempe.analysis.manoeuvre.wheeled import Wheeled, wheeled
from kempe.analysis.mobility.classify import classify
from kempe.budget import Budget, Usual
from kempe.calls import explained, listed
from kempe.errors import InputError, KempeError, UnknownNameError, UnsupportedError
from kempe.kinematics.configuration import as_q, has_loops, q_from_dict, refuse_far
from kempe.kinematics.one_sided import one_sided_rows
from kempe.kinematics.velocity.velocity import row_names
from kempe.model.kept import kept
from kempe.reals import is_real, is_whole, named
from kempe.solvers.common.clock import SHORT, TimeLimit, TimeUp, begun_within
from kempe.spatial import Array

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kempe.model.system import System

SLIP = 1e-9
"""Slip, of rows and speeds of size 1, above which a sample is not on the constraint."""
PARALLEL = 1e-3
"""Sine of the angle between the two slides, of the sign that it has at the start, from which on
they go on."""
MOST = 10**6
"""Samples at most."""
USUAL = Usual("manoeuvre", points=200, time_limit=SHORT)


@explained
def manoeuvre(
    system: System,
    start: ArrayLike | Mapping[str, float] | None,
    goal: ArrayLike | Mapping[str, float],
    *,
    radius: float | None = None,
    free: Iterable[str] = (),
    budget: Budget | None = None,
) -> Manoeuvre:
    """The `Manoeuvre` from one configuration to another of a system that rolls: every velocity
    constraint is obeyed.

    `start` and `goal` are configurations (nq,) or dicts by coordinate name (what is not named is
    neutral). `radius` [m] is the smallest turning circle of the axle's middle: 0 allows turns on
    the spot. By default it is 0, or what the limits of the steering allow. `free` names coordinates
    that may end anywhere, such as the angles of wheels that roll along; a dict as the goal leaves
    those free that it does not name. With a radius the axle takes the shortest way of Reeds and
    Shepp (1990), and the heading may end whole turns from the goal's number; without one it ends at
    that number. The axle goes at 1 m/s and turns at 1 rad/s at most, or slower by the velocity
    limits of the system. `q` has about as many configurations as the `budget` has points (200), the
    ends of all pieces among them; its time_limit (30 s) ends the search, see `late`.

    It is known for a body that moves in a plane by two slides and a turn, with an axle that does
    not slip sideways (knife edge, unicycle, coin that stands upright, differential drive, car with
    one steering angle), wherever that is on the body; other coordinates may be idle, steer, or
    follow. All else is refused with the reason. Errors: `UnsupportedError`; `InputError`;
    `UnknownNameError`.
    """
    q = _one(system, start, "start")
    goals = _one(system, goal, "goal")
    if radius is not None and (not is_real(radius) or not 0.0 <= radius < math.inf):
        raise InputError(
            f"radius is {radius!r}; it must be a length in metres, or 0 for turns on the spot"
        )
    spend = USUAL.of(budget)
    samples = spend.points
    time = TimeLimit(spend.time_limit)
    if not is_whole(samples) or not 2 <= samples <= MOST:
        raise InputError(
            f"points is {samples!r}; it must be a whole number, at least 2 and at most {MOST}"
        )
    time.put_in_order()  # there is nothing to do afterwards
    with begun_within(USUAL, time):
        car = wheeled(system, q)
        loose = _loose(system, goal, free, car)
    motion = None
    said = ""
    late = False
    try:
        with time:
            for plan in plans(car, q, goals, None if radius is None else float(radius), loose):
                time.check()
                found = _exact(car, q, goals, plan)
                said = "" if found is None else _outside(system, found, int(samples))
                if not said:
                    motion = found
                    break
    except Refused as refusal:
        said = str(refusal)
    except TimeUp as error:
        late = True
        said = f"not found: {time.reason(error)} came" + (f"; {said}" if said else "")
    zero = np.zeros(1)
    if motion is None:
        return Manoeuvre(
            system, q[None], zero, zero, (), 0.0, 0, not said, said, (car.pose.body,), late=late
        )
    t = _times(motion, int(samples))
    x, v = motion.at(t)
    slipped = slip(system, t, x, v)
    if slipped > SLIP:
        raise UnsupportedError(
            f"{system.name}: the manoeuvre slips by {slipped:.2g}: its velocity constraints are "
            "not those of an axle everywhere"
        )
    turns = _arrive(car, motion, x, q, goals, loose)
    return Manoeuvre(
        system,
        x,
        t,
        motion.lengths(t),
        tuple(motion.pieces),
        slipped,
        turns,
        True,
        "",
        (car.pose.body,),
        motion,
    )


def _one(system: System, q: Any, what: str) -> Array:
    """One configuration (nq,), closed or not. Errors: `InputError`."""
    if q is None:
        q = system.neutral
    given = named(q)
    array = (
        as_q(system, q) if given is None or not has_loops(system) else q_from_dict(system, given)
    )
    if array.shape != (system.nq,):
        raise InputError(
            f"{what} has shape {array.shape}; it must be one configuration ({system.nq},)"
        )
    refuse_far(system, array, what)
    rows = one_sided_rows(system)
    if (over := rows.beyond(array)).any():
        k = int(np.argmax(over))
        raise InputError(
            f"{what} has {rows.names[k]!r} = {rows.values(array)[k]:.9g}; it must be between "
            f"{rows.low[k]:.9g} and {rows.high[k]:.9g}"
        )
    return array.astype(float)


def _loose(system: System, goal: Any, free: Iterable[str], car: Wheeled) -> tuple[int, ...]:
    """Velocity indices of what may end anywhere. Errors: `InputError`, `UnknownNameError`."""
    names = list(system.structure.velocity_names)
    out: list[int] = []
    for name in listed(free, "free"):
        if name not in names:
            raise UnknownNameError("coordinate", name, names, system.name)
        if names.index(name) not in car.driven:
            those = ", ".join(repr(names[v]) for v in car.driven) or "none"
            raise InputError(
                f"{name!r} does not roll along, so its goal counts; those that do: {those}"
            )
        out.append(names.index(name))
    given = named(goal)
    return (*out, *(v for v in car.driven if given is not None and names[v] not in given))


def _exact(car: Wheeled, q: Array, goal: Array, plan: Plan) -> ExactManoeuvre | None:
    """A plan in closed form, with the steering between its moves, as fast as limits allow; None for
    nothing to do.
    """
    pieces: list[Piece] = []
    now = float(q[car.steering_q])

    def steer(values: Sequence[float]) -> None:
        nonlocal now
        s = min(values, key=lambda s: abs(s - now)) if values else now
        if s != now:
            at = pieces[-1].start + pieces[-1].duration if pieces else 0.0
            pieces.append(Piece("steer", at, abs(s - now), 0.0, 0.0, math.copysign(1.0, s - now)))
        now = s

    for move in plan:
        steer(move.steering)
        time = max(abs(move.length), abs(move.angle))
        kind = "turn" if not move.length else "forwards" if move.length > 0.0 else "in reverse"
        at = pieces[-1].start + pieces[-1].duration if pieces else 0.0
        pieces.append(Piece(kind, at, time, move.length / time, move.angle / time, 0.0))
    if car.steering is not None:
        steer((float(goal[car.steering_q]),))
    idle = np.zeros(car.system.nv)
    idle[list(car.idle)] = car.system.structure.layout.difference(q, goal)[list(car.idle)]
    if not pieces and idle.any():
        pieces.append(Piece("rest", 0.0, float(np.abs(idle).max()), 0.0, 0.0, 0.0))
    if not pieces:
        return None
    motion = ExactManoeuvre(car, q, idle, pieces)
    limits = car.system.structure.velocity_limits
    if not np.isfinite(limits).any():
        return motion
    return ExactManoeuvre(car, q, idle, _slower(motion, limits))


def _slower(motion: ExactManoeuvre, limits: Array) -> list[Piece]:
    """The pieces, each slower where a coordinate would exceed its velocity limit (nv,)."""
    idle = np.zeros(len(limits), dtype=bool)
    idle[list(motion.car.idle)] = True
    still = np.where(idle, np.inf, limits)
    out: list[Piece] = []
    for p in motion.pieces:
        n = 65
        inside = p.start + p.duration * (np.arange(n) + 0.5) / n
        v = np.abs(motion.at(inside)[1]).max(axis=0) / math.cos(min(0.5 * abs(p.angle) / n, 1.0))
        out.append(_stretched(p, out, max(1.0, float((v / still).max(initial=0.0)))))
    total = out[-1].start + out[-1].duration
    most = float((np.abs(motion.idle) * motion.total / limits)[idle].max(initial=0.0)) / total
    if most > 1.0:
        pieces = out
        out = []
        for p in pieces:
            out.append(_stretched(p, out, most))
    return out


def _stretched(p: Piece, before: Sequence[Piece], by: float) -> Piece:
    """A piece that takes `by` times as long, after the pieces before it."""
    at = before[-1].start + before[-1].duration if before else 0.0
    return Piece(p.kind, at, p.duration * by, p.forward / by, p.turning / by, p.steering / by)


def _times(motion: ExactManoeuvre, samples: int) -> Array:
    """Times (n,): the ends of all pieces, and evenly spread ones between them."""
    out = [np.zeros(1)]
    for p in motion.pieces:
        n = max(1, math.ceil(p.duration / motion.total * (samples - 1)))
        out.append(p.start + p.duration * np.arange(1, n + 1) / n)
    out[-1][-1] = motion.total
    return np.concatenate(out)


def _outside(system: System, motion: ExactManoeuvre, samples: int) -> str:
    """What a motion does that it must not, in words: it leaves limits, or violates one-sided
    constraints.
    """
    q = motion.at(_times(motion, max(samples, 200)))[0]
    if (motion.car.pose.spread(q) <= PARALLEL).any():
        slides = " and ".join(
            repr(system.structure.velocity_names[int(v)]) for v in motion.car.pose.slides_v
        )
        return f"on the way {slides} would be parallel, and cannot go on"
    rows = one_sided_rows(system)
    over = rows.beyond(q)
    if not over.any():
        return ""
    n, k = np.unravel_index(int(np.argmax(over)), over.shape)
    return (
        f"not found within the limits: {rows.names[k]!r} would get to {rows.values(q[n])[k]:.6g}, "
        f"and must be between {rows.low[k]:.6g} and {rows.high[k]:.6g}"
    )


def _arrive(
    car: Wheeled, motion: ExactManoeuvre, x: Array, q: Array, goal: Array, free: Sequence[int]
) -> int:
    """Put the ends of samples (n, nq) right to the last bit; returns by how many whole turns the
    heading is off.

    Errors: `UnsupportedError` where the motion does not lead to the goal.
    """
    system = car.system
    end = goal.copy()
    place = dict(
        zip(
            system.structure.layout.vector_v.tolist(),
            system.structure.layout.vector_q.tolist(),
            strict=True,
        )
    )
    for v in free:
        end[place[v]] = x[-1, place[v]]
    i = car.pose.turn_q
    turns = round(float(car.pose.gear * (x[-1, i] - goal[i])) / (2.0 * math.pi))
    end[i] += 2.0 * math.pi * turns / car.pose.gear
    off = np.abs(system.structure.layout.difference(x[-1], end))
    scale = (
        1.0 + float(np.abs(x[:, system.structure.layout.vector_q]).max(initial=0.0)) + motion.total
    )
    if off.max() > 1e-12 * scale:
        name = system.structure.velocity_names[int(np.argmax(off))]
        if int(np.argmax(off)) not in car.driven:
            raise UnsupportedError(
                f"{system.name}: {name!r} would miss the goal by {off.max():.3g}: this radius is "
                "too large beside the distance for the digits of numbers"
            )
        raise UnsupportedError(
            f"{system.name}: with this radius {name!r} ends {off.max():.6g} away from the goal: "
            f"let it end anywhere (free={[name]!r}), or turn on the spot (radius=0)"
        )
    x[0] = q
    x[-1] = end
    return turns


def way_there(system: System) -> str:
    """End of a sentence about a configuration: whether motions get there, of a system that rolls.

    A manoeuvre is named only where brackets show that motions reach every configuration around.
    """
    names = list(dict.fromkeys(name for name, *_ in row_names(system)))
    said = ", ".join(map(repr, names[:3])) + ", ..." * (len(names) > 3)
    hold = "holds" if len(names) == 1 else "hold"
    return f"; {_motions_there(system).format(hold=f'{said} {hold} on the way')}"


@kept
def _motions_there(system: System) -> str:
    """What is known of motions to other configurations, with a field {hold} for the constraints."""
    unknown = "{hold}: whether a motion gets there is not known"
    try:
        found = classify(system)
    except KempeError:
        return unknown
    if found.doubtful or found.reachable_around is None:
        return unknown
    lost = found.position_dof - found.reachable_around
    if lost > 0:
        keep = (
            "1 function of position keeps its value"
            if lost == 1
            else f"{lost} functions of position keep their values"
        )
        return (
            f"{{hold}}, where {keep} (system.classify): a motion gets there only if the start has "
            "the same"
        )
    try:
        manoeuvre(system, found.q, found.q)
    except UnsupportedError:
        return (
            "going there takes a motion: {hold}; there are such motions (system.classify), none is "
            "known here"
        )
    except KempeError:
        pass
    return "going there is a manoeuvre ({hold}): system.manoeuvre(start, q)"
