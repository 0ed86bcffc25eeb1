"""The configuration space of a system: reading `q`, random and special configurations, distances, its shape."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained, generator, numbers, together
from kempe.errors import InputError, UnknownNameError
from kempe.model.coordinates import returning
from kempe.model.topology import natural
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


def as_q(system: System, q: object) -> Array:
    """`q` as an aligned, C-contiguous float64 array (..., nq); a dict by name is completed with neutral values.

    Errors: `InputError` for a wrong length or type, `UnknownNameError` for names.
    """
    if isinstance(q, Mapping):
        return q_from_dict(system, q)
    what = type(q).__name__
    try:
        given = np.asarray(q)
        if given.dtype.kind not in "fiub":
            what = "complex" if given.dtype.kind == "c" else what
            raise TypeError
        array = np.require(given, np.float64, "CA")
    except (TypeError, ValueError):
        raise InputError(f"q is {what}; it must be an array of real numbers or a dict by coordinate name") from None
    if array.ndim == 0 or array.shape[-1] != system.nq:
        names = ", ".join(system.coordinate_names[:12]) + (", ..." if system.nq > 12 else "")
        got = "a single number" if array.ndim == 0 else f"{array.shape[-1]} coordinates"
        raise InputError(f"q has {got}; {system.name} needs {system.nq}: {names}")
    return array


@explained
def q_from_dict(system: System, coordinates: Mapping[str, float], base: ArrayLike | None = None) -> Array:
    """Configuration (nq,) from values by coordinate name; the others are neutral, or as in `base` (..., nq)."""
    if not isinstance(coordinates, Mapping):
        raise InputError(f"coordinates are {type(coordinates).__name__}; they must be a dict by coordinate name")
    q = system.neutral if base is None else np.array(as_q(system, base))
    index = {n: i for i, n in enumerate(system.coordinate_names)}
    for name, number in coordinates.items():
        if name not in index:
            follower = system.couplings.get(name)
            if follower is not None:
                follows = f"it follows {follower.source!r}" if follower.source else f"it is held at {follower.offset:g}"
                raise InputError(f"coordinate {name!r} is not part of q: {follows}")
            raise UnknownNameError("coordinate", name, system.coordinate_names, system.name)
        try:
            q[..., index[name]] = float(number)
        except (TypeError, ValueError):
            raise InputError(f"coordinate {name!r} is {number!r}; it must be a number") from None
    return q


@explained
def q_dict(system: System, q: Any) -> dict[str, float]:
    """Values by coordinate name of one configuration (nq,)."""
    return dict(zip(system.coordinate_names, one(system, q).tolist(), strict=True))


def one(system: System, q: Any) -> Array:
    """One configuration (nq,). Errors: `InputError`."""
    array = as_q(system, q)
    if array.ndim != 1:
        raise InputError(f"q has shape {array.shape}; it must be one configuration ({system.nq},)")
    return array


def mid(system: System) -> Array:
    """A configuration (nq,) inside the limits: mid-range; zero, or the nearest allowed, where a limit is missing."""
    lower, upper = system.lower, system.upper
    both = np.isfinite(lower) & np.isfinite(upper)
    with np.errstate(invalid="ignore"):
        v = np.where(both, 0.5 * lower + 0.5 * upper, np.clip(0.0, lower, upper))
    q = system.neutral
    q[system.layout.vector_q] = v[system.layout.vector_v]
    return q


@explained
def random(system: System, rng: np.random.Generator | int | None, shape: int | tuple[int, ...] = ()) -> Array:
    """Configurations (*shape, nq), uniform inside the limits.

    Angles without limits are in [-pi, pi), lengths without limits within 1 m of zero, screws within 1 rad; a
    coordinate with one limit is as near to that. Rotations are uniform. Numbers are drawn in the order of the names,
    so the order of declaration does not matter. Loop closures and relations of several coordinates are not imposed.
    """
    sizes = shape if isinstance(shape, (tuple, list)) else (shape,)
    if not all(isinstance(n, (int, np.integer)) and not isinstance(n, bool) and n >= 0 for n in sizes):
        raise InputError(f"shape is {shape!r}; it must be a whole number or a tuple of them, not negative")
    shape = tuple(int(n) for n in sizes)
    rng = generator(rng)
    layout, names = system.layout, system.velocity_names
    try:
        q = np.broadcast_to(system.neutral, (*shape, system.nq)).copy()
    except (MemoryError, ValueError):
        raise InputError(f"shape is {shape}; this memory does not hold so many configurations") from None
    low, high = sampling_box(system)
    order = sorted(range(len(layout.vector_v)), key=lambda i: natural(names[layout.vector_v[i]]))
    for i in order:
        iv = layout.vector_v[i]
        u = rng.random(size=shape)
        q[..., layout.vector_q[i]] = np.clip((1.0 - u) * low[iv] + u * high[iv], low[iv], high[iv])
    balls = sorted(range(len(layout.quaternion_v)), key=lambda i: natural(names[layout.quaternion_v[i]]))
    layout.random_quaternions(q, rng, np.array(balls, dtype=np.int64))
    return q


def sampling_box(system: System) -> tuple[Array, Array]:
    """Finite bounds (nv,) to draw from: the limits, and where one is missing a turn or a length of 1 m on each side."""
    lower, upper = system.lower, system.upper
    reach = np.where(system.coordinates.turning, math.pi, 1.0)
    with np.errstate(invalid="ignore"):
        low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * reach, -reach))
        high = np.where(np.isfinite(upper), upper, np.where(np.isfinite(lower), lower + 2.0 * reach, reach))
    return low, high


@explained
def integrate(system: System, q: Any, v: ArrayLike) -> Array:
    """Configuration (..., nq) reached from `q` by the tangent vector `v` (..., nv) in one unit of time."""
    v = numbers(v, "v")
    if v.ndim == 0 or v.shape[-1] != system.nv:
        got = "a single number" if v.ndim == 0 else f"{v.shape[-1]} coordinates"
        raise InputError(f"v has {got}; {system.name} has {system.nv} velocity coordinates")
    return system.layout.integrate(as_q(system, q), v)


@explained
def difference(system: System, q0: Any, q1: Any) -> Array:
    """Tangent vector (..., nv) that `integrate` needs to go from `q0` to `q1`; rotations go the short way."""
    return system.layout.difference(as_q(system, q0), as_q(system, q1))


def _tangent(system: System, q0: Any, q1: Any) -> Array:
    """Shortest tangent vector from q0 to q1: unlimited joints turn by at most pi."""
    v = difference(system, q0, q1)
    circle = circles(system)
    with np.errstate(invalid="ignore"):
        v[..., circle] -= 2.0 * math.pi * np.round(v[..., circle] / (2.0 * math.pi))
    return v


def circles(system: System) -> np.ndarray:
    """Which velocity coordinates (nv,) are angles without limits, so that a full turn changes nothing."""
    return returning(system.mechanism, system.coordinates)


@explained
def interpolate(system: System, q0: Any, q1: Any, t: ArrayLike) -> Array:
    """Configuration (..., nq) at fraction `t` (...) of the way; quaternions and unlimited joints go the short way."""
    t, v = numbers(t, "t"), _tangent(system, q0, q1)
    together({"t": t.shape, "q0 and q1": v.shape[:-1]})
    with np.errstate(invalid="ignore", over="ignore"):
        return integrate(system, q0, t[..., None] * v)


@explained
def distance(system: System, q0: Any, q1: Any) -> Array:
    """Euclidean length (...) of the shortest tangent vector, angles in radians and lengths in metres."""
    with np.errstate(over="ignore"):
        return np.linalg.norm(_tangent(system, q0, q1), axis=-1)


@dataclass(frozen=True)
class ConfigurationSpace:
    """The set that configurations of the tree range over.

    `dim` is its dimension, `shape` its product form: a circle T for each turn, a line R for each slide, SO(3) for
    each quaternion. `limited` coordinates are confined to an interval of their factor. With loop closures or
    relations (`constraints` rows of them) the configurations of the system are a subset.
    """

    dim: int
    shape: str
    limited: int
    constraints: int

    def __str__(self) -> str:
        text = f"{self.shape}, dimension {self.dim}"
        if self.limited:
            text += f", {self.limited} of them within limits"
        if self.constraints:
            text += f"; the system is the subset that satisfies {self.constraints} constraint equations"
        return text


@explained
def configuration_space(system: System) -> ConfigurationSpace:
    """Dimension and shape of the configuration space of a system's joints."""
    turning = system.coordinates.turning[system.layout.vector_v]
    turns, slides = int(turning.sum()), int((~turning).sum())
    balls = len(system.layout.quaternion_q)
    factors = [("SO(3)", balls), ("T", turns), ("R", slides)]
    if turns == 0 and slides and balls:
        factors = [("R", slides), ("SO(3)", balls)]
    parts = [name if n == 1 else f"{name}^{n}" for name, n in factors if n]
    limited = int((np.isfinite(system.lower) | np.isfinite(system.upper)).sum())
    rows = len(system.relations)
    for constraint in system.mechanism.constraints.values():
        rows += 2 if constraint.kind == "point_on_line" and system.dim == 3 else 1
    for name in system.closures:
        joint = system.joints[name]
        particle = system.mechanism.bodies[joint.child].particle
        # q holds the joint's own coordinates too: all freedoms of the child are tied to it
        rows += joint.type.constraints(system.dim, particle) + joint.type.dof(system.dim, particle)
    return ConfigurationSpace(system.nv, " x ".join(parts) or "a point", limited, rows)
