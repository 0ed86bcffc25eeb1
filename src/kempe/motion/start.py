"""The beginning of a motion: its configuration, its sense, and the periods of its coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.arrays import is_mapping, is_real
from kempe.assemble.idle_freedoms import lock_spins
from kempe.equations.closure import Closure, close_loops
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError, UnknownNameError, UnsupportedError, format_value
from kempe.joints import R
from kempe.model.configurations import (
    find_home,
    make_q,
    read_start,
    refuse_wound_angles,
    sample_configurations,
)
from kempe.model.coordinates import list_coordinate_names
from kempe.motion.crossings import (
    PROBE,
    SingularNode,
    find_branches,
    hold_rank,
    locate_singular_point,
)
from kempe.numerics.curves import Node, make_node
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model

MOST_TURNS = 1000
"""Turns of a coordinate after which those that follow it must be where they were, for that to count
as coming back."""
SAME_VALUE = 1e-9
"""Difference of values that is rounding."""
SAME_RATIO = 1e-12
"""How near a factor must be to a ratio of whole numbers to be that ratio."""
RESTS = 1e-6
"""Share of the driver in a direction below which it rests."""
SEED = 1837
STARTS = 16
"""Random starts from which a configuration within one-sided constraints is looked for."""
LOW_RANK = 0.1
"""Length of a curve on both sides of the start over which the rank is low, if it is low all
along."""
LONGEST = 0.1
"""Longest step unless the caller says otherwise, in radians and characteristic lengths over all
coordinates."""


def read_longest_step(step: float | None) -> float:
    """Return the longest step of arc length, given or by default. Errors: `InputError`."""
    if step is None:
        return LONGEST
    if not is_real(step) or not 1e-6 <= step <= 1.0:
        raise InputError(
            f"step is {step!r}; it must be between 1e-6 and 1, in radians and characteristic "
            "lengths"
        )
    return float(step)


def read_wished_rates(system: Model, toward: Mapping[str, float] | None) -> Array:
    """Read the rates (nv,) that choose a sense or a branch.

    Errors: `InputError`, `UnknownNameError`.
    """
    wish = np.zeros(system.nv)
    for name, rate in (toward or {}).items():
        i = find_angle_or_slide(system, name)
        if not is_real(rate) or not math.isfinite(rate):
            raise InputError(
                f"toward gives the rate {rate!r} to {name!r}; it must be a finite number"
            )
        wish[i] = rate
    return wish


def find_angle_or_slide(system: Model, name: str) -> int:
    """Find the velocity index of an angle or a prismatic coordinate given by name.

    Errors: `InputError` for a coupled coordinate, which is not part of q; `UnknownNameError` for
    components of a quaternion and for unknown names.
    """
    names = list(system.structure.velocity_names)
    layout = system.structure.layout
    if name in names and (i := names.index(name)) in layout.vector_v:
        return i
    refuse_follower(system, name)
    allowed: list[str] = [names[int(i)] for i in layout.vector_v]
    raise UnknownNameError("angle or slide", name, allowed, system.name)


def refuse_follower(system: Model, name: str) -> None:
    """Raise `InputError` for a coordinate that is not part of q: it follows another or is held."""
    follower = system.structure.couplings.get(name)
    if follower is None:
        return
    said = (
        f"it follows {follower.source!r}"
        if follower.source
        else f"it is held at {follower.offset:g}"
    )
    raise InputError(f"coordinate {name!r} is not part of q: {said}")


def read_start_configuration(system: Model, start: Any, hold: Mapping[str, float]) -> Array:
    """Read the configuration (nq,) that `start` names, before any loop is closed."""
    if start is None:
        q = find_home(system)
    elif isinstance(start, str):
        q = make_q(system, start)
    elif is_mapping(start):
        q = make_q(system, start, find_home(system))
    else:
        q = read_start(system, start)
    if q.shape != (system.nq,):
        raise InputError(f"start has shape {q.shape}; it must be one configuration ({system.nq},)")
    refuse_wound_angles(system, q, "start")
    held = make_q(system, hold, q)
    if held.shape != q.shape:
        raise InputError(f"hold is {format_value(hold)}; it must be one number for each coordinate")
    return refuse_wound_angles(system, held, "hold")


def begin_motion(
    system: Model, start: Any, hold: Mapping[str, float]
) -> tuple[Closure, Array | None]:
    """Return the equations with held coordinates, and the closed configuration near `start`.

    The configuration (nq,) is None where there is none.

    What `assemble` calls closed is closed here, too: loops whose numbers contradict each other by a
    little more than rounding are followed within the tolerance of `assemble`.
    """
    held = [find_angle_or_slide(system, n) for n in hold]
    near = read_start_configuration(system, start, hold)
    equations = Closure(system, held, near)
    known: dict[str, Any] = (
        {n: v for n, v in start.items() if n not in hold} if is_mapping(start) else {}
    )
    fixed = Closure(system, held + [find_angle_or_slide(system, n) for n in known], near)
    # what is known may be far: then on the branch that `assemble` finds
    q = None if known else close_loops(fixed, near)
    if q is None:
        from kempe.assemble.assemble import assemble
        from kempe.assemble.bound import TOLERANCE, get_equation_assembler

        answer = assemble(system, known={**hold, **known}, start=near)
        if not answer.success:  # what is one-sided is then reported
            answer = get_equation_assembler(system, {**hold, **known})({**hold, **known}, near)
        q = close_loops(fixed, answer.q) if answer.success else None
        if q is None and answer.success:
            equations.closed = fixed.closed = TOLERANCE
            q = close_loops(fixed, answer.q)
    if (
        start is None
        and q is not None
        and pack_one_sided_rows(system).compute_excess(q, declared=True).any()
    ):
        q = _find_allowed_configuration(system, hold, fixed, near, q)
    return equations, q


def _find_allowed_configuration(
    system: Model, hold: Mapping[str, float], fixed: Closure, near: Array, q: Array
) -> Array:
    """Find a closed configuration (nq,) that one-sided constraints allow, else return q.

    It is looked for where no start is given.
    """
    from kempe.assemble.assemble import assemble

    rows = pack_one_sided_rows(system)
    rng = np.random.default_rng(SEED)
    for start in (near, *sample_configurations(system, rng, (STARTS,))):
        answer = assemble(system, dict(hold), start)
        found = close_loops(fixed, answer.q) if answer.success else None
        if found is not None and not rows.compute_excess(found).any():
            return found
    return q


def explain_open_loop(system: Model, start: Any, hold: Mapping[str, float]) -> str:
    """Explain why a motion cannot begin: which loop is open at the start, by how much, and why."""
    from kempe.assemble.assemble import assemble

    known = {**start, **hold} if is_mapping(start) else hold
    answer = assemble(system, known=known, start=read_start_configuration(system, start, hold))
    return f"the loops do not close near the start{'' if answer.success else f': {answer.status}'}"


class WoundFollower(NamedTuple):
    """A coupled coordinate that does not return after a full turn of its `source` (an index).

    It changes by `factor`, in radians or metres, with each radian of the source.
    """

    name: str
    source: int
    factor: float
    turns: bool


def find_periods(system: Model, limits: bool = True) -> Array:
    """Find the period (nv,) of each velocity coordinate: the turn after which all is as before.

    It is 0 where there is none.

    With `limits` a coordinate that has some does not turn all round.
    """
    return _find_turning_periods(system, limits)[0]


def list_wound_followers(system: Model, limits: bool = True) -> list[WoundFollower]:
    """List the coupled coordinates that keep their sources from returning by full turns."""
    return _find_turning_periods(system, limits)[1]


def _find_turning_periods(system: Model, limits: bool) -> tuple[Array, list[WoundFollower]]:
    """Find the periods (nv,) of the coordinates, and the followers that keep some from having one."""
    c = system.structure.coordinates
    whole = np.where(
        c.turning & ((np.isinf(c.lower) & np.isinf(c.upper)) | (not limits)), 1, 0
    ).astype(object)
    number = {name: i for i, name in enumerate(system.structure.velocity_names)}
    mechanism = system._mechanism
    couplings = system.structure.couplings
    never: list[WoundFollower] = []
    for joint in mechanism.joints.values() if couplings else ():
        names = list_coordinate_names(mechanism, joint)
        for p in joint.type.layout(system.dim, mechanism.bodies[joint.child].particle)[1]:
            follower = couplings.get(names[p.coordinate])
            if follower is None or follower.source is None:
                continue
            i = number[follower.source]
            factor = p.multiplier * follower.multiplier
            ratio = Fraction(factor).limit_denominator(MOST_TURNS)
            if p.kind == R and abs(float(ratio) - factor) < SAME_RATIO:
                whole[i] = math.lcm(int(whole[i]), ratio.denominator) if whole[i] else 0
            elif whole[i] or any(f.source == i for f in never):
                whole[i] = 0
                never.append(WoundFollower(names[p.coordinate], i, factor, p.kind == R))
    found = 2.0 * math.pi * whole.astype(float)
    return np.where(_find_distinct_coordinates(system, found), 0.0, found), never


def _find_distinct_coordinates(system: Model, period: Array) -> np.ndarray:
    """Return a mask (nv,) of coordinates after whose period declared one-sided rows differ."""
    rows = pack_one_sided_rows(system)
    out = np.zeros(system.nv, dtype=bool)
    if rows.declared:
        q = sample_configurations(system, np.random.default_rng(0), 3)
        before = rows.compute_values(q, declared=True)
        for i in np.flatnonzero(period):
            after = rows.compute_values(
                system.structure.layout.integrate_velocity(q, period[i] * np.eye(system.nv)[i]),
                declared=True,
            )
            out[i] = np.any(np.abs(after - before) > SAME_VALUE * (1.0 + np.abs(before)))
    return out


def find_first_node(
    equations: Closure, q: Array, driver: str | None, toward: Mapping[str, float] | None
) -> Node | None:
    """Return the node at the start with its sense chosen, or None where nothing can move.

    Errors: `UnsupportedError`.
    """
    system = equations.system
    wish = read_wished_rates(system, toward)
    wish = wish / equations.unit if equations.n == system.nv else wish
    if not equations.n:
        return None
    here = make_node(equations, q)
    requested = np.flatnonzero(wish).tolist() + (
        [find_angle_or_slide(system, driver)] if driver else []
    )
    # what moves may be but a spin
    rests = driver is not None and here.nullity == 1 and abs(here.t[requested[-1]]) < RESTS
    if (here.nullity > 1 or rests) and lock_spins(equations, q, requested):
        here = make_node(equations, q)

    def hold_start_rank(length: float) -> bool:
        """Hold the rank at the start if that leaves a curve of this length."""
        return hold_rank(equations, q, lambda: (equations, make_node(equations, q)), length)

    if here.nullity > 1 and hold_start_rank(LOW_RANK):
        here = make_node(equations, q)
    if here.nullity == 0:
        return None
    if here.nullity > 1:
        several = _choose_bifurcation_node(equations, here, driver, wish)
        if several is None and not hold_start_rank(PROBE):
            raise UnsupportedError(
                explain_freedom(equations, here.matrix, [driver] if driver else [])
            )
        here = several or make_node(equations, q)
    if isinstance(here, SingularNode) and here.germ.is_cusp(here.half):
        return here  # both halves leave to the same side
    i = (
        find_angle_or_slide(system, driver)
        if driver
        else int(np.argmax(np.abs(here.t) > 0.5 * np.abs(here.t).max()))
    )
    sense = float(here.t @ wish) if abs(here.t @ wish) > 1e-9 else float(here.t[i])
    return here.reverse_direction() if sense < 0.0 else here


def _choose_bifurcation_node(
    equations: Closure, here: Node, driver: str | None, wish: Array
) -> Node | None:
    """Choose the node at a start with several branches, on the one nearest to the wish.

    It is None where there is no branch.
    """
    x = here.x
    polished = locate_singular_point(equations, x, here.nullity, 1e-5)
    x = x if polished is None else polished
    lines, germ, complete = find_branches(equations, x, wish)
    if germ is not None:
        if driver is not None and not wish.any():
            wish = np.eye(equations.n)[find_angle_or_slide(equations.system, driver)]
        return germ.make_node(int(np.argmax(np.round(germ.tangents @ wish, 9))))
    if not len(lines):
        return None
    if np.linalg.norm(wish) > 0.0:
        merit = np.abs(lines @ wish)
    elif driver is not None:
        merit = np.abs(lines[:, find_angle_or_slide(equations.system, driver)])
    else:
        merit = -np.arange(float(len(lines)))
    best = int(np.argmax(merit))
    at = make_node(equations, x)
    return Node(x, lines[best], at.sigma, max(at.nullity, 2), at.matrix, at.image, lines, complete)


def explain_freedom(equations: Closure, matrix: Array, drivers: Sequence[str]) -> str:
    """Explain why the motion is not one curve: which coordinates move with the drivers held."""
    system = equations.system
    null_space = Spectrum(matrix).compute_null_space(Level.CLOSED).T
    count = len(null_space)
    rows = null_space[:, [find_angle_or_slide(system, d) for d in drivers]].T
    if drivers:
        null_space = Spectrum(rows, 1.0).compute_null_space(Level.CLOSED).T @ null_space
    sizes = dict(zip(system.structure.velocity_names, np.abs(null_space).max(axis=0), strict=True))
    moving = [n for n, size in sizes.items() if size > 1e-6]
    named = [n for n in moving if n in system.coordinate_names]
    balls = list(dict.fromkeys(n.rpartition(".")[0] for n in moving if n not in named))
    still = (
        f"with {' and '.join(map(repr, drivers))} held still, these still move"
        if drivers
        else "these move"
    )
    many = len(null_space) - (not drivers)
    own = null_space[:, [n in named for n in system.structure.velocity_names]]
    enough = Spectrum(own, 1.0).compute_rank(Level.GENERIC) >= many if named else False
    driven = f"and {format_count(len(drivers), 'driver')}" if drivers else "and a curve has 1"
    head = f"{system.name} has {format_count(count, 'freedom')} to first order here, {driven}; {still}: "
    if not named:
        return (
            f"{head}{_format_names(balls)}; a ball joint has no coordinate that can be held; with "
            "angles=True it has three angles"
        )
    which, them = ("one", "it") if many == 1 else (str(many), "them")
    also = (
        f" (and balls, which have angles to hold with angles=True: {_format_names(balls)})"
        if balls and not enough
        else ""
    )
    return (
        f"{head}{_format_names(named)}{also}; hold {which} of them (hold={{name: value}}), or lock "
        f"{them}; if there should be fewer freedoms, this start is folded or singular: give another"
    )


def _format_names(names: Sequence[str]) -> str:
    """Return names in quotes as text, the first six of them."""
    return ", ".join(map(repr, names[:6])) + (", ..." if len(names) > 6 else "")
