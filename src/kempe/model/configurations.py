"""Configurations `q` of a system: how they are read, sampled, integrated, subtracted and named."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import broadcast_shapes, check_name, explain_errors, make_generator, numbers
from kempe.arrays import (
    MOST_TURNED,
    PLAIN,
    check_range,
    convert_array,
    is_array,
    is_number_list,
    is_real,
    is_sequence,
    list_named_rows,
    read_joint_state,
    read_mapping,
    read_reals,
    unwrap_scalar,
    warn_of_degrees,
)
from kempe.errors import InputError, UnknownNameError, format_value
from kempe.joints import P, R
from kempe.late import import_late_member
from kempe.model.coordinates import (
    OF_BALL,
    PART_OF_BALL,
    Follower,
    find_periodic_angles,
    find_wound_coordinates,
    format_coordinate_name,
)
from kempe.model.model import keep_answers
from kempe.model.structural_order import make_sort_key
from kempe.report import Table
from kempe.spatial import Array
from kempe.units import METRE, METRES, from_metres, scale_lengths
from kempe.values import find_angle_names
from kempe.words import ByName, Quantity, format_count

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- reading configurations

MOST_WOUND = 1e8
"""Largest angle in a motion, in radians: beyond it, floats are more than a hundred-millionth of a
radian apart."""
FIT = 1e-6
"""How far a given follower may be from what follows from its leader, in radians or metres and
relative to 1 and itself."""
WANTED = "an array of real numbers or a dict by coordinate name"


def read_q(system: Model, q: Any) -> Array:
    """Read configurations as an aligned, C-contiguous float64 array (..., nq).

    An array is taken as it is. What is given by names (a dict, a pandas Series or DataFrame, a list
    of them) is read by name; what is not named is neutral, and in a system with closed loops or
    relations follows from what is: the configuration that `assemble` finds from home.
    Errors: `InputError` for a wrong length or type, and for named values that close no loop;
    `UnknownNameError`.
    """
    return _read_configuration(system, q, close_from_start)


def read_start(system: Model, q: Any) -> Array:
    """Read the start of a search, an array (..., nq), as `read_q` does.

    Coordinates that are not named are as at home; no loop is closed. A text is the name of a
    posture.
    """
    if isinstance(q, str):
        return make_q(system, q, find_home(system))
    return _read_configuration(system, q, set_from_home, "start")


def _read_configuration(
    system: Model,
    q: Any,
    complete: Callable[[Model, Mapping[str, Any]], Array],
    word: str = "q",
) -> Array:
    """Read configurations (..., nq) from an array, a dict by name, a posture's name or a message.

    `complete` makes a configuration of named values; `word` names the argument in messages.
    """
    if is_number_list(q):
        array = convert_array(q, word, WANTED)
        if array.ndim > 1 or max(q) > MOST_TURNED or min(q) < -MOST_TURNED:
            warn_of_degrees_in_q(system, array, word)
    else:
        if isinstance(q, str):
            raise InputError(
                f"{word} is {format_value(q)}; it must be {WANTED}; a posture is system.q({format_value(q)})"
            )
        if q.__class__ is not np.ndarray or q.dtype.names:
            coordinates = _read_named_values(system, q)
            if coordinates is not None:
                if hasattr(q, "columns"):
                    coordinates = drop_other_columns(system, coordinates)
                return complete(system, coordinates)
            rows = list_named_rows(q)
            if rows is not None:
                return np.stack([_read_configuration(system, row, complete, word) for row in rows])
        array = np.require(read_reals(q, word, WANTED), np.float64, ["C", "A"])
    if array.ndim == 0 or array.shape[-1] != system.nq:
        names = ", ".join(system.coordinate_names[:12]) + (", ..." if system.nq > 12 else "")
        got = "a single number" if array.ndim == 0 else format_count(array.shape[-1], "coordinate")
        raise InputError(f"{word} has {got}; {system.name} needs {system.nq}: {names}")
    return array


def _read_named_values(system: Model, given: Any) -> Mapping[str, Any] | None:
    """Read values with names, as `read_mapping` does; those of a message JointState are in metres."""
    values = read_mapping(given)
    if system.unit == METRE or not values or read_joint_state(given) is None:
        return values
    unit, metre = list_units(system), 1 / METRES[system.unit]
    return {
        n: scale_lengths(x, metre) if unit.get(n) == system.unit else x for n, x in values.items()
    }


def warn_of_degrees_in_q(system: Model, q: Array, what: str) -> None:
    """Warn of the first angle of configurations (..., nq) that looks like one in degrees.

    This is for numbers that were typed, not for arrays, which programs compute.
    """
    if q.shape[-1:] == (system.nq,):
        for i in _index_angles(system):
            if warn_of_degrees(q[..., i], f"{what}[{system.coordinate_names[i]!r}]"):
                return


def warn_of_degrees_in_values(system: Model, values: Mapping[str, Any]) -> None:
    """Warn if a value by name, of a coordinate that is an angle, looks like one in degrees."""
    for name, x in values.items():
        if x.__class__ in PLAIN:
            if not -MOST_TURNED <= x <= MOST_TURNED and list_units(system).get(name) == "rad":
                warn_of_degrees((x,), f"{name!r}")
        elif is_sequence(x) or (is_array(x) and x.dtype.kind in "fiu"):
            if list_units(system).get(name) == "rad":
                warn_of_degrees(x, f"{name!r}")


@keep_answers
def _index_angles(system: Model) -> list[int]:
    """Return the indices in q of the coordinates that are angles."""
    unit = list_units(system)
    return [i for i, name in enumerate(system.coordinate_names) if unit[name] == "rad"]


@keep_answers
def has_loops(system: Model) -> bool:
    """Tell whether q has to satisfy equations: of loops, constraints, or relations of coordinates."""
    tied = system.structure.closures or system.structure.relations
    return bool(tied) or any(
        c.count_equations(system.dim) for c in system._mechanism.constraints.values()
    )


def find_home(system: Model) -> Array:
    """Return the home (nq,): the posture 'closed' if there is one, else a point inside the limits."""
    if "closed" in system.structure.posture_names:
        return make_q(system, "closed")
    return compute_mid_configuration(system).copy()


def set_from_home(system: Model, coordinates: Mapping[str, Any]) -> Array:
    """Return the home with the named coordinates set, an array (..., nq) that may not be closed.

    Other coordinates are neutral, or as at home where the system has loops.
    """
    return make_q(system, coordinates, find_home(system) if has_loops(system) else None)


def close_from_start(system: Model, coordinates: Mapping[str, Any], start: Any = None) -> Array:
    """Return a configuration (..., nq) with the named values, closed if the system has loops.

    The search starts at `start`, else at home. Where all coordinates are named nothing is searched
    for. Errors: `InputError` where no closed configuration was found, with the reason.
    """
    q = make_q(system, coordinates, start)  # refuses names and numbers
    if not has_loops(system):
        return q
    given = compute_source_values(system, read_mapping(coordinates) or {})
    if len(given) == system.nq:
        return q
    answer = import_late_member("assemble")(system, given, start)
    if np.all(answer.success):
        return answer.q
    why = answer.status
    where = ""
    if q.ndim > 1:
        first = int(np.flatnonzero(~np.ravel(answer.success))[0])
        why = np.ravel(np.asarray(why, dtype=object))[first]
        where = f"row {first} of "
    raise InputError(
        f"{where}q gives {', '.join(map(repr, given)) or 'nothing'} of a system with loops, and "
        f"the other coordinates must close them: {why} (an array of all {system.nq} is taken as it "
        "is)"
    )


@keep_answers
def _index_coordinates(system: Model) -> dict[str, int]:
    """Return the index in q of each coordinate by its name."""
    return {n: i for i, n in enumerate(system.coordinate_names)}


def _read_posture(system: Model, name: str) -> dict[str, float]:
    """Return the values of a named posture for the coordinates that are in `q`.

    Errors: `UnknownNameError`.
    """
    postures = system._mechanism.postures
    index = _index_coordinates(system)
    return {
        n: x
        for n, x in postures[check_name("posture", name, postures, system.name)].items()
        if n in index
    }


def list_sources(system: Model, names: Iterable[str]) -> tuple[str, ...]:
    """List the coordinates of `q` that determine the named coordinates, each once."""
    couplings = system.structure.couplings
    sources = (couplings[name].source if name in couplings else name for name in names)
    return tuple(dict.fromkeys(source for source in sources if source is not None))


def drop_other_columns(system: Model, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Drop columns that are no coordinates from a table that has all coordinates.

    The tables of answers have further columns. A table without all coordinates is returned as it
    is: a name in it may be mistyped.
    """
    if not given.keys() >= set(system.coordinate_names):
        return given
    own = {*system.coordinate_names, *system.structure.couplings}
    return {name: x for name, x in given.items() if name in own}


def compute_source_values(system: Model, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Compute values of coordinates of `q` from values that may also be those of their followers.

    A follower whose leader is not named gives the leader its value. Errors: `UnknownNameError`;
    `InputError` for followers and locked coordinates that do not fit.
    """
    index = _index_coordinates(system)
    if index.keys() >= given.keys():
        return given
    for name in given:
        if name not in index and name not in system.structure.couplings:
            raise UnknownNameError("coordinate", name, system.coordinate_names, system.name)
    out = {name: x for name, x in given.items() if name in index}
    for name, follower in system.structure.couplings.items():
        if name not in given:
            continue
        x = read_reals(given[name], f"coordinate {name!r}", "a number, or an array of them")
        source = follower.source
        if source is not None and source not in out:
            out[source] = unwrap_scalar((x - follower.offset) / follower.multiplier)
            continue
        leader = 0.0 if source is None else read_reals(out[source], f"coordinate {source!r}")
        broadcast_shapes(
            {f"coordinate {name!r}": x.shape, f"coordinate {source!r}": np.shape(leader)}
        )
        if source is not None and np.ndim(leader) < x.ndim:
            out[source] = leader + np.zeros(x.shape)
        refuse_other_follower(
            f"coordinate {name!r}", follower, x, follower.multiplier * leader + follower.offset
        )
    return out


def refuse_other_follower(
    subject: str,
    follower: Follower,
    x: Array,
    wanted: ArrayLike,
    tolerance: float = FIT,
    turn: float = 0.0,
) -> None:
    """Refuse values (...) of a follower that are not the `wanted` ones, with an `InputError`.

    With `turn` they count as equal where they differ by a multiple of it.
    """
    x, wanted = np.broadcast_arrays(x, wanted)
    off = x - wanted
    if turn:
        off = off - turn * np.round(off / turn)
    bad = ~(np.abs(off) <= tolerance * (1.0 + np.abs(x)))
    if bad.any():
        at = np.unravel_index(int(np.argmax(bad)), bad.shape)
        row = f" (row {', '.join(map(str, at))})" if at else ""
        why = f"follows {follower.source!r} and must be" if follower.source else "is held at"
        raise InputError(f"{subject} is {x[at]:.9g}{row}; it {why} {wanted[at]:.9g}")


@explain_errors
def make_q(
    system: Model, coordinates: Mapping[str, Any] | str, base: ArrayLike | None = None
) -> Array:
    """Return a configuration (..., nq) from values by coordinate name, or from a named posture.

    What is not named is neutral, or as in `base` (..., nq). A coordinate that follows another may be
    named, too, with the value that it has then.
    """
    given = (
        _read_posture(system, coordinates)
        if isinstance(coordinates, str)
        else _read_named_values(system, coordinates)
    )
    if given is None:
        needed = "a dict by coordinate name, or the name of a posture"
        raise InputError(f"coordinates are {format_value(coordinates)}; they must be {needed}")
    warn_of_degrees_in_values(system, given)
    given = compute_source_values(system, given)
    index = _index_coordinates(system)
    single = True
    values: list[float | Array] = []
    for name, number in given.items():
        one_number = is_real(number)
        values.append(
            number
            if one_number
            else read_reals(number, f"coordinate {name!r}", "a number, or an array of them")
        )
        single = single and one_number
    start = system.neutral if base is None else read_q(system, base)
    if single:
        q = start.copy()
        for name, x in zip(given, values, strict=True):
            q[..., index[name]] = x
        return q
    arrays: list[Array] = [np.asarray(x) for x in values]
    try:
        lead = np.broadcast_shapes(start.shape[:-1], *(x.shape for x in arrays))
    except ValueError:
        shapes = ", ".join(f"{n!r} {x.shape}" for n, x in zip(given, arrays, strict=True))
        raise InputError(
            f"the values of the coordinates have shapes that do not fit together: {shapes}"
        ) from None
    q = np.empty((*lead, system.nq))
    q[:] = start
    for name, x in zip(given, arrays, strict=True):
        q[..., index[name]] = x
    return q


@explain_errors
def make_q_dict(system: Model, q: Any) -> dict[str, float]:
    """Return the values of one configuration (nq,) by coordinate name."""
    return dict(zip(system.coordinate_names, read_one_q(system, q).tolist(), strict=True))


def read_one_q(system: Model, q: Any) -> Array:
    """Read the argument as one configuration (nq,). Errors: `InputError`."""
    array = read_q(system, q)
    if array.ndim != 1:
        raise InputError(f"q has shape {array.shape}; it must be one configuration ({system.nq},)")
    return array


def read_finite_q(system: Model, q: Any, what: str = "q") -> Array:
    """Read the argument as one configuration (nq,) of finite numbers, to start a search with.

    Errors: `InputError`.
    """
    array = read_q(system, q)
    if array.shape != (system.nq,):
        raise InputError(
            f"{what} has shape {array.shape}; it must be one configuration ({system.nq},)"
        )
    return refuse_large_numbers(system, array, what)


def refuse_large_numbers(system: Model, q: Array, what: str) -> Array:
    """Refuse configurations (..., nq) with numbers too large for a search; return the others.

    Errors: `InputError` that names the first other one.
    """
    check_range(q, what, system.coordinate_names)
    for i in system.structure.layout.quaternion_q:
        if not np.all(np.any(q[..., i : i + 4], axis=-1)):
            raise InputError(
                f"the quaternion at {what}[{system.coordinate_names[i]!r}] is zero; it has no "
                "rotation"
            )
    return q


def refuse_wound_angles(system: Model, q: Array, what: str) -> Array:
    """Refuse a configuration (nq,) of a motion with large numbers, or angles above `MOST_WOUND`."""
    refuse_large_numbers(system, q, what)
    layout = system.structure.layout
    turning = system.structure.coordinates.turning
    for i, k in zip(layout.vector_q, layout.vector_v, strict=True):
        if turning[k]:
            refuse_wound_angle(float(q[i]), f"{what}[{system.coordinate_names[i]!r}]")
    return q


def refuse_wound_angle(angle: float, what: str) -> None:
    """Refuse an angle so large that steps of the motion would be lost in its rounding.

    Errors: `InputError`.
    """
    if not abs(angle) < MOST_WOUND:
        raise InputError(
            f"{what} is {angle:g} rad; angles of a motion must be below {MOST_WOUND:g} rad in "
            "size, for larger floats are too far apart: subtract whole turns"
        )


# ---- random and special configurations


def compute_mid_configuration(system: Model) -> Array:
    """Return the configuration (nq,) in the middle of the limits.

    Where a limit is missing it has zero, or the allowed value nearest to zero.

    It is read-only: `copy` gives one to change.
    """
    lower = system.lower
    upper = system.upper
    both = np.isfinite(lower) & np.isfinite(upper)
    with np.errstate(invalid="ignore"):
        v = np.where(both, 0.5 * lower + 0.5 * upper, np.clip(0.0, lower, upper))
    q = system.neutral.copy()
    q[system.structure.layout.vector_q] = v[system.structure.layout.vector_v]
    q.setflags(write=False)
    return q


@explain_errors
def sample_configurations(
    system: Model, rng: np.random.Generator | int | None, shape: int | tuple[int, ...] = ()
) -> Array:
    """Sample configurations (*shape, nq) uniformly inside the limits.

    Angles without limits are in [-pi, pi), lengths without limits within 1 m of zero, screws within
    1 rad; a coordinate with one limit is as near to that. Rotations are uniform. Numbers are drawn
    in the order of the names, so the order of declaration does not matter. Loop closures and
    relations of several coordinates are not imposed.
    """
    sizes = shape if isinstance(shape, (tuple, list)) else (shape,)
    if not all(
        isinstance(n, (int, np.integer)) and not isinstance(n, bool) and n >= 0 for n in sizes
    ):
        raise InputError(
            f"shape is {shape!r}; it must be a whole number or a tuple of them, not negative"
        )
    shape = tuple(int(n) for n in sizes)
    rng = make_generator(rng)
    layout = system.structure.layout
    names = system.structure.velocity_names
    try:
        q = np.broadcast_to(system.neutral, (*shape, system.nq)).copy()
    except (MemoryError, ValueError):
        raise InputError(
            f"shape is {shape}; this memory does not hold so many configurations"
        ) from None
    low, high = compute_sampling_box(system)
    order = sorted(
        range(len(layout.vector_v)), key=lambda i: make_sort_key(names[int(layout.vector_v[i])])
    )
    for i in order:
        iv = layout.vector_v[i]
        u = rng.random(size=shape)
        q[..., layout.vector_q[i]] = np.clip((1.0 - u) * low[iv] + u * high[iv], low[iv], high[iv])
    balls = sorted(
        range(len(layout.quaternion_v)),
        key=lambda i: make_sort_key(names[int(layout.quaternion_v[i])]),
    )
    layout.randomize_quaternions(q, rng, np.array(balls, dtype=np.int64))
    return q


def compute_free_reach(system: Model) -> Array:
    """Compute how far from zero coordinates (nv,) without limits are sampled.

    That is half a turn, 1 rad for screws, and 1 m for lengths.
    """
    c = system.structure.coordinates
    straight = np.where(c.angular, 1.0, from_metres(1.0, system.unit))
    return np.where(c.turning, math.pi, straight)


def compute_sampling_box(system: Model) -> tuple[Array, Array]:
    """Return finite lower and upper bounds (nv,) within which coordinates are sampled.

    They are the limits; where one is missing, a turn or a length of 1 m on each side.
    """
    lower = system.lower
    upper = system.upper
    reach = compute_free_reach(system)
    with np.errstate(invalid="ignore"):
        low = np.where(
            np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * reach, -reach)
        )
        high = np.where(
            np.isfinite(upper), upper, np.where(np.isfinite(lower), lower + 2.0 * reach, reach)
        )
    return low, high


# ---- differences and distances


@explain_errors
def integrate_velocity(system: Model, q: Any, v: ArrayLike) -> Array:
    """Return the configuration (..., nq) after 1 s from `q` at the velocity `v` (..., nv)."""
    v = numbers(v, "v")
    if v.ndim == 0 or v.shape[-1] != system.nv:
        got = "a single number" if v.ndim == 0 else format_count(v.shape[-1], "coordinate")
        raise InputError(
            f"v has {got}; {system.name} has {format_count(system.nv, 'velocity coordinate')}"
        )
    q = read_q(system, q)
    if q.shape != v.shape and q.ndim + v.ndim > 2:
        broadcast_shapes({"q": q.shape[:-1], "v": v.shape[:-1]})
    return system.structure.layout.integrate_velocity(q, v)


@explain_errors
def compute_difference(system: Model, q0: Any, q1: Any) -> Array:
    """Compute the shortest tangent vector (..., nv) from `q0` to `q1`.

    Quaternions and unlimited joints go the short way.

    `integrate_velocity` leads from `q0` by it to `q1`, up to whole turns of unlimited joints. Turns that a
    constraint tells apart count.
    """
    a = read_q(system, q0)
    b = read_q(system, q1)
    if a.shape != b.shape:
        broadcast_shapes({"q0": a.shape[:-1], "q1": b.shape[:-1]})
    return shorten_turns(system.structure.layout.compute_difference(a, b), find_free_angles(system))


def shorten_turns(v: Array, circle: np.ndarray) -> Array:
    """Reduce turns in tangent vectors `v` (..., nv) to at most pi, in place.

    This is done where `circle` (nv,) is true.
    """
    v[..., circle] -= 2.0 * math.pi * np.round(v[..., circle] / (2.0 * math.pi))
    return v


def find_free_angles(system: Model) -> np.ndarray:
    """Return a mask (nv,) of the angles without limits, for which a full turn changes nothing."""
    return find_periodic_angles(system._mechanism, system.structure.coordinates)


def find_winding_angles(system: Model) -> np.ndarray:
    """Return a mask (nv,) of the angles without limits whose whole turns a constraint tells apart."""
    coordinates = system.structure.coordinates
    endless = coordinates.turning & np.isinf(system.lower) & np.isinf(system.upper)
    return endless & find_wound_coordinates(system._mechanism, coordinates)


@explain_errors
def interpolate_configurations(system: Model, q0: Any, q1: Any, t: ArrayLike) -> Array:
    """Return the configuration (..., nq) at fraction `t` (...) of the way from `q0` to `q1`.

    Quaternions and unlimited joints go the short way.
    """
    t = numbers(t, "t")
    v = compute_difference(system, q0, q1)
    broadcast_shapes({"t": t.shape, "q0 and q1": v.shape[:-1]})
    return integrate_velocity(system, q0, t[..., None] * v)


@explain_errors
def compute_distance(system: Model, q0: Any, q1: Any) -> Array:
    """Compute the length (...) of the shortest tangent vector from `q0` to `q1`.

    Angles count in radians, lengths in metres.
    """
    return np.linalg.norm(compute_difference(system, q0, q1), axis=-1)


# ---- units and names of coordinates


@keep_answers
def list_units(system: Model) -> dict[str, str]:
    """Return the unit of each coordinate and velocity by name: 'rad', '' in a quaternion, or that
    of lengths.
    """
    out: dict[str, str] = {}
    bodies = system._mechanism.bodies
    for joint in system.structure.joints.values():
        particle = bodies[joint.child].particle
        names, primitives = joint.type.layout(system.dim, particle)
        own = {p.coordinate: system.unit for p in primitives if p.kind == P}
        own |= {p.coordinate: "rad" for p in primitives if p.kind == R}  # of a screw, too
        for i, name in enumerate(names):
            out[format_coordinate_name(joint.name, name)] = own.get(i, "")
        for name in joint.type.list_velocity_names(system.dim, particle):
            out.setdefault(format_coordinate_name(joint.name, name), "rad")
    return out


def list_parameter_units(system: Model) -> dict[str, str]:
    """Return the unit of each parameter by name: 'rad' if placements turn by it, else that of
    lengths.
    """
    mechanism = system._mechanism
    ends = [X for joint in mechanism.joints.values() for X in (joint.X_PF, joint.X_CM)]
    ends += [frame.X_BF for frame in mechanism.frames.values()]
    angles = {
        name
        for X in ends
        for motion, numbers in X.steps
        for x in numbers
        for name in find_angle_names(x, motion in ("rx", "ry", "rz"))
    }
    return {name: "rad" if name in angles else system.unit for name in mechanism.parameters}


def list_limits(system: Model) -> dict[str, Quantity]:
    """Return the limits of each coordinate of q by its name, infinite where it has none."""
    unit = list_units(system)
    structure = system.structure
    known = dict(zip(structure.velocity_names, structure.limits.tolist(), strict=True))
    free = (-math.inf, math.inf)
    return {n: Quantity(known.get(n, free), unit[n]) for n in system.coordinate_names}


def name_values(system: Model, q: Any) -> ByName:
    """Return configurations (..., nq) as values by coordinate name, with their units."""
    unit = list_units(system)
    names = system.coordinate_names
    return ByName(names, [unit[name] for name in names], q)


def make_ranges_table(system: Model, q: Any, steps: bool = False) -> Table:
    """Make a table of the least and the largest value of each coordinate in configurations (n, nq).

    With `steps` it has the largest step of each from one configuration to the next, too.
    Configurations that are not numbers are left out.
    """
    unit = list_units(system)
    rows: list[tuple[Any, ...]] = []
    for name, x in zip(system.coordinate_names, np.asarray(q).T, strict=True):
        values = [np.nanmin(x), np.nanmax(x)]
        if steps:
            step = np.abs(np.diff(x))
            values.append(step[np.isfinite(step)].max(initial=0.0))
        rows.append((name, *(Quantity(float(v), unit[name]) for v in values)))
    heads = ("coordinate", "least", "largest", "largest step")
    return Table(heads[: 4 if steps else 3], rows, grid=True, printed=False)


def refuse_unreadable(system: Model, names: Iterable[str], what: str) -> None:
    """Refuse coordinates that do not exist or are parts of quaternions.

    Errors: `UnknownNameError`, `InputError`.
    """
    known = [*system.coordinate_names, *system.structure.couplings]
    for name in names:
        if name not in known:
            raise UnknownNameError("coordinate", name, known, what)
        if name not in system.structure.couplings and name not in system.structure.velocity_names:
            raise InputError(f"{what}: {PART_OF_BALL.format(name)}: {OF_BALL}")
