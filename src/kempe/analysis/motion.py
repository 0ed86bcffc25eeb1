"""How a mechanism with one degree of freedom moves: its whole branch, by continuation; other branches by switching.

Pseudo-arclength continuation in all velocity coordinates (Keller, 1977; Allgower, Georg, 1990): the driver is not
special, so dead points are ordinary points. At a crossing the walk goes straight on; what other branches there are is
recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.continuation import RANK, Closure, Node, arc, close, node
from kempe.analysis.crossings import branch_lines, locate
from kempe.analysis.events import Limits, Stop, extremes, hidden_crossings, home, walk
from kempe.analysis.path import Event, Path, Track
from kempe.calls import explained, flag
from kempe.errors import InputError, UnknownNameError, UnsupportedError, shown
from kempe.joints import R
from kempe.kinematics.configuration import as_q
from kempe.model.coordinates import coordinate_names
from kempe.reals import is_real
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

LONGEST = 0.1
"""Longest step unless the caller says otherwise, in radians and characteristic lengths over all coordinates."""
SAME_POINT = 1e-6
"""Distance below which two singular points are the same."""

Progress = Callable[[int, float], Any]


@dataclass(frozen=True)
class _Options:
    """What all walks of one call share."""

    driver: str | None
    both: bool
    longest: float
    limits: bool
    max_points: int
    frames: tuple[str, ...]
    progress: Progress | None
    periods: Array


@explained
def trace(
    system: System, driver: str | None = None, start: ArrayLike | Mapping[str, float] | str | None = None, *,
    both: bool = True, step: float | None = None, limits: bool = True, max_points: int = 20_000,
    frames: Iterable[FrameLike] = (), hold: Mapping[str, float] | None = None,
    toward: Mapping[str, float] | None = None, switch: bool = False, progress: Progress | None = None,
) -> Path:  # fmt: skip
    """The `Path` of a mechanism with one degree of freedom: its whole branch through `start`.

    `start` is a configuration (nq,), the name of a posture, or known coordinates by name (default: the posture
    "closed", else mid-range); it is closed first. `driver` is the coordinate that counts as the input: the path begins
    with it growing, and points where it turns back are its dead points. `hold` fixes other coordinates at values.
    `toward` gives rates by coordinate name that choose the sense, and the branch where the start is a bifurcation.
    `both=False` walks in one direction only. `step` is the longest step of arc length (default 0.1). The path
    ends where it closes on itself, at a limit (unless `limits=False`) or after `max_points` points. `switch=True` also
    traces the branches met at bifurcations: see `Path.others`. `progress(points, length)` is called now and then;
    an interrupt from the keyboard returns what was done. `frames` are those that tables of the path show.

    Errors: `UnsupportedError` where more than one freedom remains, naming it; `UnknownNameError`; `InputError`.

    >>> from kempe import Mechanism
    >>> m = Mechanism("slider-crank", dim=2)
    >>> crank, rod, slider = m.body("crank"), m.body("rod"), m.body("slider")
    >>> _ = m.revolute("A", m.ground, crank)
    >>> _ = m.revolute("B", crank, rod, at=(1, 0))
    >>> _ = m.revolute("C", rod, slider, at=(2, 0))
    >>> _ = m.prismatic("S", m.ground, slider, axis=(1, 0))
    >>> path = trace(m.build(), "S", {"A": 0.5})
    >>> path.closed, [round(e.value, 9) for e in path.turning_points]
    (True, [3.0, 1.0])
    """
    options = _options(system, driver, both, step, limits, max_points, frames, progress)
    held = dict(hold or {})
    equations, q = begin(system, start, held)
    if q is None:
        return _failed(equations, options, "the loops do not close near the start", start_of(system, start, held))
    if limits and (name := Limits(equations).outside(q)):
        return _failed(equations, options, f"{name!r} is outside its limits at the start", q)
    first = first_node(equations, q, driver, toward)
    if first is None:
        return _failed(equations, options, "it cannot move: no degree of freedom is left", q, True)
    path = _trace(equations, first, options)
    if len(path) == 1 and path.success and path.ends[1].startswith("a point"):
        said = "it cannot move along a smooth curve: its first-order motion leads nowhere (shaky), or this is a cusp"
        return _failed(equations, options, said, q, True)
    return replace(path, others=_others(equations, path, options)) if switch else path


def branches(system: System, driver: str | None = None, start: Any = None, **options: Any) -> tuple[Path, ...]:
    """All paths that meet at bifurcations, that through `start` first; arguments as in `trace`."""
    path = trace(system, driver, start, **{**options, "switch": True})
    return (replace(path, others=()), *path.others)


# ---- where it begins


def _options(
    system: System, driver: str | None, both: bool, step: float | None, limits: bool, max_points: int,
    frames: Iterable[FrameLike], progress: Progress | None,
) -> _Options:  # fmt: skip
    flag(limits, "limits")
    if driver is not None:
        angle_or_slide(system, driver)
    longest = longest_step(step)
    if isinstance(max_points, bool) or not isinstance(max_points, (int, np.integer)) or max_points < 2:
        raise InputError(f"max_points is {max_points!r}; it must be a whole number, at least 2")
    names = tuple(system.frame_name(f) for f in ([frames] if isinstance(frames, str) else frames))
    return _Options(driver, both, longest, limits, int(max_points), names, progress, periods(system, limits))


def longest_step(step: float | None) -> float:
    """The longest step of arc length. Errors: `InputError`."""
    if step is None:
        return LONGEST
    if not is_real(step) or not 1e-6 <= step <= 1.0:
        raise InputError(f"step is {step!r}; it must be between 1e-6 and 1, in radians and characteristic lengths")
    return float(step)


def wish_of(system: System, toward: Mapping[str, float] | None) -> Array:
    """The rates (nv,) that choose a sense or a branch. Errors: `InputError`, `UnknownNameError`."""
    wish = np.zeros(system.nv)
    for name, rate in (toward or {}).items():
        i = angle_or_slide(system, name)
        if not is_real(rate) or not math.isfinite(rate):
            raise InputError(f"toward gives the rate {rate!r} to {name!r}; it must be a finite number")
        wish[i] = rate
    return wish


def angle_or_slide(system: System, name: str) -> int:
    """Velocity index of a coordinate that is not part of a quaternion."""
    names = list(system.velocity_names)
    layout = system.layout
    if name in names and (i := names.index(name)) in layout.vector_v:
        return i
    follower = system.couplings.get(name)
    if follower is not None:
        said = f"it follows {follower.source!r}" if follower.source else f"it is held at {follower.offset:g}"
        raise InputError(f"coordinate {name!r} is not part of q: {said}")
    allowed = [names[i] for i in layout.vector_v]
    raise UnknownNameError("angle or slide", name, allowed, system.name)


def start_of(system: System, start: Any, hold: Mapping[str, float]) -> Array:
    """The configuration (nq,) that `start` names, before any loop is closed."""
    if start is None:
        start = "closed" if "closed" in system.posture_names else system.mid
    if isinstance(start, str):
        q = system.posture(start)
    elif isinstance(start, Mapping):
        base = system.posture("closed") if "closed" in system.posture_names else system.mid
        q = system.q(start, base)
    else:
        q = as_q(system, start)
    if q.shape != (system.nq,):
        raise InputError(f"start has shape {q.shape}; it must be one configuration ({system.nq},)")
    if not np.isfinite(q).all():
        raise InputError("start holds a NaN or an infinity")
    held = system.q(hold, q)
    if held.shape != q.shape:
        raise InputError(f"hold is {shown(hold)}; it must be one number for each coordinate")
    return held


def begin(system: System, start: Any, hold: Mapping[str, float]) -> tuple[Closure, Array | None]:
    """The equations with the held coordinates, and the closed configuration (nq,) near `start`, or None."""
    held = [angle_or_slide(system, n) for n in hold]
    near = start_of(system, start, hold)
    equations = Closure(system, held, near)
    known = {n: v for n, v in start.items() if n not in hold} if isinstance(start, Mapping) else {}
    fixed = Closure(system, held + [angle_or_slide(system, n) for n in known], near)
    q = None if known else close(fixed, near)  # what is known may be far: then on the branch that `assemble` finds
    if q is None:
        from kempe.solvers.assembly import assemble

        answer = assemble(system, known={**hold, **known}, near=near)
        q = close(fixed, answer.q) if answer.success else None
    return equations, q


def periods(system: System, limits: bool = True) -> Array:
    """For each velocity coordinate (nv,) by how much it turns until all is as before; 0 where that never happens.

    With `limits` a coordinate that has some does not turn all round.
    """
    c = system.coordinates
    whole = np.where(c.turning & ((np.isinf(c.lower) & np.isinf(c.upper)) | (not limits)), 1, 0)
    number = {name: i for i, name in enumerate(system.velocity_names)}
    mechanism, followers = system.mechanism, system.couplings
    for joint in mechanism.joints.values() if followers else ():
        names = coordinate_names(mechanism, joint)
        for p in joint.type.layout(system.dim, mechanism.bodies[joint.child].particle)[1]:
            follower = followers.get(names[p.coordinate])
            if follower is None or follower.source is None or not whole[number[follower.source]]:
                continue
            i = number[follower.source]
            factor = p.multiplier * follower.multiplier
            ratio = Fraction(factor).limit_denominator(1000)
            again = p.kind == R and abs(float(ratio) - factor) < 1e-12
            whole[i] = math.lcm(int(whole[i]), ratio.denominator) if again else 0
    return 2.0 * math.pi * whole


def first_node(
    equations: Closure, q: Array, driver: str | None, toward: Mapping[str, float] | None
) -> Node | None:  # fmt: skip
    """The node at the start with its sense chosen; None where nothing can move. Errors: `UnsupportedError`."""
    system = equations.system
    wish = wish_of(system, toward)
    wish = wish / equations.unit if equations.n == system.nv else wish
    if not equations.n:
        return None
    here = node(equations, q)
    if here.nullity == 0:
        return None
    if here.nullity > 1:
        here = _at_bifurcation(equations, here, driver, wish)
    i = angle_or_slide(system, driver) if driver else int(np.argmax(np.abs(here.t) > 0.5 * np.abs(here.t).max()))
    sense = float(here.t @ wish) if abs(here.t @ wish) > 1e-9 else float(here.t[i])
    return here.reversed() if sense < 0.0 else here


def _at_bifurcation(equations: Closure, here: Node, driver: str | None, wish: Array) -> Node:
    """The node at a start where first order leaves several motions, on the branch nearest to the wish."""
    x = here.x
    polished = locate(equations, x, here.nullity, 1e-5)
    x = x if polished is None else polished
    lines = branch_lines(equations, x)
    if not len(lines):
        raise UnsupportedError(too_free(equations, here.matrix, [driver] if driver else []))
    if np.linalg.norm(wish) > 0.0:
        merit = np.abs(lines @ wish)
    elif driver is not None:
        merit = np.abs(lines[:, angle_or_slide(equations.system, driver)])
    else:
        merit = -np.arange(float(len(lines)))
    best = int(np.argmax(merit))
    at = node(equations, x)
    return Node(x, lines[best], at.sigma, max(at.nullity, 2), at.matrix, at.image, lines)


def too_free(equations: Closure, matrix: Array, drivers: Sequence[str]) -> str:
    """Why the motion is not one curve: which coordinates still move with the drivers held."""
    system = equations.system
    _, s, Vt = np.linalg.svd(matrix)
    kernel = Vt[int(np.sum(s > RANK * s[0])) :]
    count = len(kernel)
    rows = kernel[:, [angle_or_slide(system, d) for d in drivers]].T
    if drivers:
        _, s, Vt = np.linalg.svd(rows)
        kernel = Vt[int(np.sum(s > RANK)) :] @ kernel
    moving = [n for n, size in zip(system.velocity_names, np.abs(kernel).max(axis=0), strict=True) if size > 1e-6]
    shown = ", ".join(repr(n) for n in moving[:6]) + (", ..." if len(moving) > 6 else "")
    still = " and ".join(repr(d) for d in drivers)
    what = f"with {still} held still, these still move: {shown}" if drivers else f"these move: {shown}"
    many = len(kernel) - (not drivers)
    return (
        f"to first order {system.name} has {count} freedoms here, more than are driven; {what}; "
        f"hold {'one' if many == 1 else str(many)} of them (hold={{name: value}}), or lock "
        f"{'it' if many == 1 else 'them'}; "
        "a singular point where branches of several freedoms meet is no place to start"
    )


# ---- the walk


def _trace(equations: Closure, first: Node, options: _Options) -> Path:
    """The whole branch from its first node."""
    nodes, reason, closed, interrupted = _one_way(equations, first, options, options.max_points)
    ends = ("the start", reason)
    left = options.max_points - len(nodes)
    if options.both and not closed and not interrupted and left > 1:
        back, other, _, interrupted = _one_way(equations, first.reversed(), options, left)
        nodes = [n.reversed() for n in reversed(back[1:])] + nodes
        ends = (other, reason)
    return _path(equations, nodes, options, closed, ends, interrupted)


def _one_way(equations: Closure, first: Node, options: _Options, most: int) -> tuple[list[Node], str, bool, bool]:
    """Nodes from the first on, why they end, whether they came home, whether the user broke off."""
    nodes, limits, length = [first], Limits(equations), 0.0
    try:
        for b in walk(equations, first, options.longest):
            a = nodes[-1]
            if isinstance(b, Stop):
                return nodes, b.reason, False, False
            hit = limits.hit(equations, a, b) if options.limits else None
            back = home(equations, a, b, first, options.periods) if length > 0.0 else None
            if back is not None and (hit is None or _before(equations, a, back, hit[0])):
                return [*nodes, back], "the start", True, False
            if hit is not None:
                return nodes if hit[0] is a else [*nodes, hit[0]], hit[1], False, False
            nodes.append(b)
            length += arc(equations, a, b)
            if options.progress is not None and len(nodes) % 16 == 0:
                options.progress(len(nodes), length)
            if len(nodes) >= most:
                return nodes, f"the {options.max_points} points allowed", False, False
    except KeyboardInterrupt:
        return nodes, "the interrupt", False, True
    raise AssertionError("a walk ends only with a reason")


def _before(equations: Closure, a: Node, first: Node, second: Node) -> bool:
    return float(np.linalg.norm(equations.between(a.x, first.x) - equations.between(a.x, second.x))) < 1e-12 or (
        float(a.t @ equations.between(a.x, first.x)) <= float(a.t @ equations.between(a.x, second.x))
    )


def _path(
    equations: Closure, nodes: list[Node], options: _Options, closed: bool, ends: tuple[str, str], interrupted: bool
) -> Path:  # fmt: skip
    """The answer from the nodes of a branch."""
    system = equations.system
    nodes = hidden_crossings(equations, nodes)
    s = np.concatenate([[0.0], np.cumsum([arc(equations, a, b) for a, b in zip(nodes, nodes[1:], strict=False)])])
    track = Track(equations, np.array([n.x for n in nodes]), s, np.array([n.t for n in nodes]))
    found = []
    indices = [int(i) for i in system.layout.vector_v if i not in equations.held]
    for k, n, i in extremes(equations, nodes, closed, indices):
        name = system.velocity_names[i]
        kind = "fold of the driver" if name == options.driver else "extreme"
        at = float(s[k]) + arc(equations, nodes[k], n) if n is not nodes[0] else 0.0
        found.append(Event(n.x, at, kind, name, float(n.x[equations.place[i]])))
    found.sort(key=lambda e: e.s)
    singular = []
    for k, n in enumerate(nodes[:-1] if closed else nodes):
        if n.lines is not None:
            own = np.argmax(np.abs(n.lines @ n.t))
            order = [int(own), *(j for j in range(len(n.lines)) if j != own)]
            lines = n.lines[order] * equations.unit
            kind = "bifurcation" if len(lines) > 1 else "singular"
            singular.append(Event(n.x, float(s[k]), kind, nullity=n.nullity, directions=lines))
    turning = tuple(e for e in found if options.driver is None or e.coordinate == options.driver)
    held = tuple(system.velocity_names[i] for i in equations.held)
    return Path(
        track.q, s, closed, ends, turning, tuple(singular), tuple(found), options.driver, held, options.frames,
        not interrupted, interrupted, track,
    )  # fmt: skip


def _failed(equations: Closure, options: _Options, reason: str, q: Array, success: bool = False) -> Path:
    """The path of one point that could not be left."""
    track = Track(equations, q[None], np.zeros(1), np.zeros((1, equations.n)))
    held = tuple(equations.system.velocity_names[i] for i in equations.held)
    return Path(
        track.q, track.s, False, (reason, reason), (), (), (), options.driver, held, options.frames, success, False,
        track,
    )  # fmt: skip


# ---- other branches


def _others(equations: Closure, path: Path, options: _Options) -> tuple[Path, ...]:
    """The branches that leave a path at its bifurcations, and those that leave these."""
    found, waiting = [path], list(path.singular_points)
    while waiting and not any(p.interrupted for p in found):
        event = waiting.pop(0)
        assert event.directions is not None
        for line in event.directions / equations.unit:
            if any(_covers(equations, p, event.q, line, options.periods) for p in found):
                continue
            at = node(equations, event.q)
            first = Node(event.q, line, at.sigma, max(at.nullity, 2), at.matrix, at.image,
                         event.directions / equations.unit)  # fmt: skip
            other = _trace(equations, first, options)
            found.append(other)
            waiting += other.singular_points
    return tuple(found[1:])


def _covers(equations: Closure, path: Path, q: Array, line: Array, period: Array) -> bool:
    """Whether a path goes through the singular point `q` in the direction `line`."""
    for event in path.singular_points:
        y = equations.between(event.q, q) * equations.unit
        turns = np.divide(y, period, out=np.zeros_like(y), where=period > 0.0)
        same = np.linalg.norm((y - np.round(turns) * period) / equations.unit) < SAME_POINT
        if same and event.directions is not None:
            own = event.directions[0] / equations.unit
            if abs(own @ line) > 0.999 * np.linalg.norm(own) * np.linalg.norm(line):
                return True
    return False
