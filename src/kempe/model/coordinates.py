"""Coordinates of a system: joint coordinates in `q`, and coordinates that follow from `q`.

Couplings and locks decide this; limits are brought back to the coordinates in `q`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.arrays import read_reals
from kempe.constraints.base import Op
from kempe.constraints.tape import TIME
from kempe.description.checks import raise_problem
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Coupling, Joint
from kempe.errors import UnknownNameError
from kempe.joints import P, Primitive, Q, R
from kempe.values import Expression, evaluate_value

# ---- the layout of q


@dataclass(frozen=True)
class Layout:
    """Layout of an array `q`: plain coordinates, and unit quaternions (w, x, y, z).

    Velocities of a quaternion are angular velocities (3,).

    `vector_q[i]` is the coordinate whose velocity is `vector_v[i]`; a quaternion starts at
    `quaternion_q[k]`, its three angular velocities, in the axes of the turned frame, at
    `quaternion_v[k]`.
    """

    nq: int
    nv: int
    vector_q: np.ndarray
    vector_v: np.ndarray
    quaternion_q: np.ndarray
    quaternion_v: np.ndarray

    @cached_property
    def neutral(self) -> spatial.Array:
        """Zero coordinates and identity quaternions (nq,); read-only."""
        q = np.zeros(self.nq)
        q[self.quaternion_q] = 1.0
        q.setflags(write=False)
        return q

    def integrate_velocity(self, q: ArrayLike, v: ArrayLike) -> spatial.Array:
        """Return the configuration (..., nq) after 1 s from `q` at the velocity `v` (..., nv)."""
        return self._call_kernel("integrate_velocities", q, "q", v, "v", self.nq)

    def compute_difference(self, q0: ArrayLike, q1: ArrayLike) -> spatial.Array:
        """Compute the tangent vector (..., nv) that `integrate_velocity` needs from `q0` to `q1`.

        Rotations go the short way.
        """
        return self._call_kernel("compute_differences", q0, "q0", q1, "q1", self.nv)

    def _call_kernel(
        self, name: str, a: Any, a_name: str, b: Any, b_name: str, size: int
    ) -> spatial.Array:
        """Call a kernel with all pairs of rows of two arrays; its rows (..., size)."""
        # describing needs no kernels; `from` would look for a path, which costs more than the kernel
        import kempe.kernels.compiled as kernels

        kernel = getattr(kernels.configuration_steps, name)
        a = read_reals(a, a_name)
        b = read_reals(b, b_name)
        if a.ndim == b.ndim == 1:  # without what broadcasting takes
            out = np.empty((1, size))
            kernel(*self._places, np.ascontiguousarray(a)[None], np.ascontiguousarray(b)[None], out)
            return out[0]
        lead = np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
        n = math.prod(lead)
        rows = [
            np.ascontiguousarray(np.broadcast_to(x, (*lead, x.shape[-1]))).reshape(n, x.shape[-1])
            for x in (a, b)
        ]
        out = np.empty((n, size))
        kernel(*self._places, *rows, out)
        return out.reshape(*lead, size)

    @cached_property
    def _places(self) -> tuple[np.ndarray, ...]:
        return self.vector_q, self.vector_v, self.quaternion_q, self.quaternion_v

    def randomize_quaternions(
        self, q: spatial.Array, rng: np.random.Generator, order: np.ndarray | None = None
    ) -> None:
        """Fill the quaternions of `q` (..., nq), in place, with uniformly distributed rotations."""
        for k in range(self.quaternion_q.size) if order is None else order:
            i = self.quaternion_q[k]
            q[..., i : i + 4] = spatial.unit(rng.normal(size=(*q.shape[:-1], 4)))


def make_layout(primitives: list[tuple[int, int, int]], nq: int, nv: int) -> Layout:
    """Make the `Layout` of primitives, each (kind, first coordinate, first velocity)."""
    vectors = [(iq, iv) for kind, iq, iv in primitives if kind != Q]
    balls = [(iq, iv) for kind, iq, iv in primitives if kind == Q]
    vector = np.array(vectors, dtype=np.int64).reshape(-1, 2)
    ball = np.array(balls, dtype=np.int64).reshape(-1, 2)
    places = [np.ascontiguousarray(column) for array in (vector, ball) for column in array.T]
    for array in places:
        array.setflags(write=False)
    return Layout(nq, nv, *places)


# ---- coordinates, couplings and limits

HELD_TOLERANCE = 1e-9
"""How far a coordinate that follows a locked one may be outside its limits: rounding of the
multiplier."""


@dataclass(frozen=True)
class Follower:
    """A coordinate that is not in `q` and follows from a `source`: multiplier * source + offset.

    Where `source` is None, its value is the constant `offset`.
    """

    source: str | None
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Relation:
    """A linear relation with several sources, q[of] - sum multiplier * q[source] - offset = 0."""

    of: str
    sources: dict[str, float]
    offset: float


@dataclass(frozen=True)
class Coordinates:
    """Coordinates of a system in the order of `q` and of velocities, with limits and dependencies."""

    names: tuple[str, ...]
    velocity_names: tuple[str, ...]
    first: dict[str, tuple[int, int]]
    followers: dict[str, Follower]
    relations: tuple[Relation, ...]
    layout: Layout
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    turning: np.ndarray
    """Which velocity coordinates (nv,) are angles that a turn brings back."""
    angular: np.ndarray
    """Which of them are in radians: those, the turns of balls, and screws."""

    @cached_property
    def limits(self) -> np.ndarray:
        """Lower and upper limits side by side (nv, 2)."""
        out = np.stack([self.lower, self.upper], axis=-1)
        out.setflags(write=False)
        return out


def list_coordinate_names(mechanism: Mechanism, joint: Joint) -> list[str]:
    """List the names of a joint's coordinates: the joint's name, or 'joint.x' if it has several."""
    particle = mechanism.bodies[joint.child].particle
    return [
        format_coordinate_name(joint.name, c)
        for c in joint.type.list_coordinate_names(mechanism.dim, particle)
    ]


def format_coordinate_name(joint: str, coordinate: str) -> str:
    """Return the full name of a coordinate: the joint's name, or 'joint.x' if it has several."""
    return f"{joint}.{coordinate}" if coordinate else joint


def make_coordinates(mechanism: Mechanism) -> Coordinates:
    """Make the coordinates of a mechanism.

    Errors: `DescriptionError` for couplings, locks and limits that do not fit.
    """
    balls: set[str] = set()
    every: dict[str, Joint] = {}
    taken: dict[str, str] = {}
    for joint in mechanism.joints.values():
        particle = mechanism.bodies[joint.child].particle
        names, primitives = joint.type.layout(mechanism.dim, particle)
        for name in dict.fromkeys(names + joint.type.list_velocity_names(mechanism.dim, particle)):
            full = format_coordinate_name(joint.name, name)
            if full in taken:
                raise_problem(
                    f"joint {joint.name!r}",
                    f"its coordinate {full!r} has the same name as one of joint {taken[full]!r}",
                    joint.where,
                    "rename one of the joints",
                )
            taken[full] = joint.name
        for name in names:
            every[format_coordinate_name(joint.name, name)] = joint
        for p in primitives:
            if p.kind == Q:
                balls |= {
                    format_coordinate_name(joint.name, n)
                    for n in names[p.coordinate : p.coordinate + 4]
                }
    followers, relations = _resolve_followers(mechanism, every, balls)
    _check_equations(mechanism, every, balls)
    every_name: list[str] = []
    velocity_names: list[str] = []
    first: dict[str, tuple[int, int]] = {}
    triples: list[tuple[int, int, int]] = []
    angles: list[int] = []
    for joint in mechanism.joints.values():
        particle = mechanism.bodies[joint.child].particle
        local, primitives = joint.type.layout(mechanism.dim, particle)
        kinds = {p.coordinate: p.kind for p in primitives}
        turned = {p.coordinate for p in primitives if p.kind != P}
        # a screw, or a turn that is geared down, counts as a slide: it returns only by going back
        kinds |= {
            p.coordinate: P for p in primitives if p.kind != Q and not _is_unchanged_by_turn(p, 1.0)
        }
        for i, name in enumerate(local):
            full = format_coordinate_name(joint.name, name)
            if full in followers or i not in kinds:
                continue
            size = 4 if kinds[i] == Q else 1
            first[full] = (len(every_name), len(velocity_names))
            triples.append((kinds[i], len(every_name), len(velocity_names)))
            if i in turned:
                angles += range(len(velocity_names), len(velocity_names) + (3 if size == 4 else 1))
            every_name += [format_coordinate_name(joint.name, n) for n in local[i : i + size]]
            velocity_names += (
                [full]
                if size == 1
                else [format_coordinate_name(joint.name, w) for w in ("wx", "wy", "wz")]
            )
    layout = make_layout(triples, len(every_name), len(velocity_names))
    lower, upper, speed = _collect_limits(mechanism, velocity_names, followers)
    turning = np.zeros(len(velocity_names), dtype=bool)
    turning[[iv for kind, _, iv in triples if kind == R]] = True
    angular = np.zeros(len(velocity_names), dtype=bool)
    angular[angles] = True
    for array in (lower, upper, speed, turning, angular):
        array.setflags(write=False)
    return Coordinates(
        tuple(every_name),
        tuple(velocity_names),
        first,
        followers,
        relations,
        layout,
        lower,
        upper,
        speed,
        turning,
        angular,
    )


def _resolve_followers(
    mechanism: Mechanism, every: dict[str, Joint], balls: set[str]
) -> tuple[dict[str, Follower], tuple[Relation, ...]]:
    """Express followers by coordinates of q; relations of several sources stay equations."""
    followers: dict[str, Follower] = {}
    for name, number in _read_locks(mechanism, every, balls).items():
        followers[name] = Follower(None, 0.0, number)
    pending: dict[str, tuple[dict[str, float], float]] = {}
    for coupling in mechanism.couplings.values():
        _check_coupling(mechanism, coupling, every, balls)
        if coupling.of in followers:
            said = f"it is locked, but follows {', '.join(coupling.sources)}"
            raise_problem(
                f"coordinate {coupling.of!r}", said, coupling.where, "lock what it follows"
            )
        sources = {
            k: float(evaluate_value(v, mechanism.parameters)) for k, v in coupling.sources.items()
        }
        pending[coupling.of] = (
            sources,
            float(evaluate_value(coupling.offset, mechanism.parameters)),
        )
    relations: list[Relation] = []
    for of in _sort_couplings(mechanism, pending):
        sources, offset = pending[of]
        flat: dict[str, float] = {}
        for name, factor in sources.items():
            follower = followers.get(name)
            if follower is None:
                flat[name] = flat.get(name, 0.0) + factor
            else:
                offset += factor * follower.offset
                if follower.source is not None:
                    flat[follower.source] = (
                        flat.get(follower.source, 0.0) + factor * follower.multiplier
                    )
        flat = {k: v for k, v in flat.items() if v != 0.0}
        if not (math.isfinite(offset) and all(map(math.isfinite, flat.values()))):
            raise_problem(
                f"coupling of {of!r}",
                "its multiplier or offset is not a number",
                mechanism.couplings[of].where,
            )
        if len(flat) > 1:
            relations.append(Relation(of, flat, offset))
        else:
            source = next(iter(flat), None)
            followers[of] = Follower(source, flat[source] if source is not None else 0.0, offset)
    return followers, tuple(relations)


def _check_equations(mechanism: Mechanism, every: dict[str, Joint], balls: set[str]) -> None:
    """Refuse coordinates in equations that do not exist, or that equations cannot read."""
    for c in (c for c in mechanism.constraints.values() if c.of.coordinate_names):
        reads = [n for n in c.of.coordinate_names if n not in mechanism.parameters]
        operations = {r.op for r in c.of.list_rows(mechanism.dim)}
        for name in reads:
            subject = f"constraint {c.name!r}"
            if name not in every:
                allowed = "for the time say time=True" if name == TIME else ""
                raise_problem(
                    subject,
                    str(UnknownNameError("coordinate", name, every, mechanism.name)),
                    c.where,
                    allowed,
                )
            if name in balls and Op.VELOCITY not in operations:
                raise_problem(subject, PART_OF_BALL.format(name), c.where, OF_BALL)
        both = [n for n in mechanism.parameters if n in every and n in getattr(c.of, "words", ())]
        if both:
            raise_problem(
                f"constraint {c.name!r}",
                f"{both[0]!r} is a coordinate and a parameter",
                c.where,
                "rename one",
            )


PART_OF_BALL = "{!r} is part of a quaternion, which equations of positions do not read"
OF_BALL = "use a joint with angles=True, or a constraint on a frame"


def _sort_couplings(
    mechanism: Mechanism, pending: dict[str, tuple[dict[str, float], float]]
) -> list[str]:
    """Sort couplings so that each comes after those it depends on (depth first).

    Errors: `DescriptionError` for couplings in a cycle, with the cycle.
    """
    done: dict[str, bool] = {}
    order: list[str] = []
    for start in pending:
        stack = [(start, iter(pending[start][0]))] if start not in done else []
        done.setdefault(start, False)
        while stack:
            name, sources = stack[-1]
            for source in sources:
                if source not in pending or done.get(source):
                    continue
                if source in done:
                    path = [n for n, _ in stack]
                    cycle = " -> ".join([*path[path.index(source) :], source])
                    where = mechanism.couplings[source].where
                    raise_problem(
                        f"coordinate {source!r}",
                        f"it follows itself: {cycle}",
                        where,
                        "one of them must be free",
                    )
                done[source] = False
                stack.append((source, iter(pending[source][0])))
                break
            else:
                done[name] = True
                order.append(name)
                stack.pop()
    return order


def _check_coupling(
    mechanism: Mechanism, coupling: Coupling, every: dict[str, Joint], balls: set[str]
) -> None:
    """Refuse a coupling of coordinates that do not exist, or cannot be coupled."""
    subject = f"coupling of {coupling.of!r}"
    for name in (coupling.of, *coupling.sources):
        if name not in every:
            raise_problem(
                subject,
                str(UnknownNameError("coordinate", name, every, mechanism.name)),
                coupling.where,
            )
        if name in balls:
            said = f"{name!r} is part of a quaternion"
            raise_problem(subject, said, coupling.where, "only angles and lengths can be coupled")
    for v in (*coupling.sources.values(), coupling.offset):
        if isinstance(v, Expression):
            for name in v.names:
                if name not in mechanism.parameters:
                    raise_problem(
                        subject,
                        str(UnknownNameError("parameter", name, mechanism.parameters)),
                        coupling.where,
                    )


def _read_locks(mechanism: Mechanism, every: dict[str, Joint], balls: set[str]) -> dict[str, float]:
    """Return the value of each locked coordinate. Errors: `DescriptionError`."""
    for name, number in mechanism.locks.items():
        subject = f"lock of {name!r}"
        if name not in every:
            raise_problem(
                subject, str(UnknownNameError("coordinate", name, every, mechanism.name)), None
            )
        joint = every[name]
        if name in balls:
            missing = [
                c
                for c in list_coordinate_names(mechanism, joint)
                if c in balls and c not in mechanism.locks
            ]
            if missing:
                raise_problem(
                    subject,
                    f"a quaternion is locked as a whole; missing are {', '.join(missing)}",
                    None,
                )
            if not any(
                mechanism.locks[c] for c in list_coordinate_names(mechanism, joint) if c in balls
            ):
                raise_problem(subject, "the quaternion is zero; (1, 0, 0, 0) is no rotation", None)
        local = name[len(joint.name) + 1 :]
        lower, upper = joint.limits.get(local, (-math.inf, math.inf))
        if not lower <= number <= upper:
            raise_problem(subject, f"{number:g} is outside the limits [{lower:g}, {upper:g}]", None)
    return mechanism.locks


def _collect_limits(
    mechanism: Mechanism, velocity_names: list[str], followers: dict[str, Follower]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Collect the limits of the coordinates; limits of followers become limits of their sources."""
    index = {n: i for i, n in enumerate(velocity_names)}
    lower = np.full(len(index), -math.inf)
    upper = np.full(len(index), math.inf)
    speed = np.full(len(index), math.inf)
    setter: list[str] = [""] * len(index)
    for joint in mechanism.joints.values():
        for local in joint.type.list_velocity_names(
            mechanism.dim, mechanism.bodies[joint.child].particle
        ):
            name = format_coordinate_name(joint.name, local)
            low, high = joint.limits.get(local, (-math.inf, math.inf))
            fast = joint.velocity_limits.get(local, math.inf)
            follower = followers.get(name)
            if follower is None and name not in index:
                continue  # a locked quaternion
            if follower is not None:
                if follower.source is None:
                    slack = HELD_TOLERANCE * (1.0 + abs(follower.offset))
                    if not low - slack <= follower.offset <= high + slack:
                        raise_problem(
                            f"coordinate {name!r}",
                            f"it is held at {follower.offset:g}, outside its limits "
                            f"[{low:g}, {high:g}]",
                            joint.where,
                        )
                    continue
                m = follower.multiplier
                # + 0.0: a bound of zero has no sign
                low, high = sorted((x - follower.offset) / m + 0.0 for x in (low, high))
                name = follower.source
                fast = fast / abs(m)
            i = index[name]
            before = (lower[i], upper[i])
            lower[i], upper[i], speed[i] = (
                max(lower[i], low),
                min(upper[i], high),
                min(speed[i], fast),
            )
            if lower[i] > upper[i]:
                if lower[i] - upper[i] > HELD_TOLERANCE * (1.0 + abs(lower[i])):
                    _refuse_limits(
                        mechanism.joints[setter[i]],
                        before,
                        joint,
                        (low, high),
                        name,
                        follower is None,
                    )
                # they touch, up to rounding
                lower[i] = upper[i] = before[1] if low > before[1] else before[0]
            if (lower[i], upper[i]) != before:
                setter[i] = joint.name
    return lower, upper, speed


def _refuse_limits(
    first: Joint,
    before: tuple[float, float],
    second: Joint,
    now: tuple[float, float],
    name: str,
    swap: bool,
):
    """Refuse limits of two joints that leave no value to the coordinate that moves both."""
    a, b = ((first, before), (second, now)) if swap else ((second, now), (first, before))
    raise_problem(
        f"joint {a[0].name!r}",
        f"its limits leave nothing to {name!r}, which drives it: they ask for {name!r} in "
        f"[{a[1][0]:g}, {a[1][1]:g}], those of joint {b[0].name!r} for [{b[1][0]:g}, {b[1][1]:g}]",
        a[0].where,
        "these must overlap",
    )


def format_relation(relation: Relation) -> str:
    """Return the relation as text of an equation."""
    terms = " + ".join(f"{m:g} {s}" for s, m in relation.sources.items())
    return f"{relation.of} = {terms}" + (f" + {relation.offset:g}" if relation.offset else "")


def _is_unchanged_by_turn(p: Primitive, multiplier: float) -> bool:
    """Tell whether a primitive is as before after a full turn of the coordinate that drives it.

    `multiplier` is the number of turns of the primitive for one turn of the coordinate.
    """
    return p.kind == R and (p.multiplier * multiplier).is_integer()


def find_periodic_angles(mechanism: Mechanism, c: Coordinates) -> np.ndarray:
    """Which velocity coordinates (nv,) are angles without limits, so that a full turn changes
    nothing.
    """
    return find_returning_angles(mechanism, c) & np.isinf(c.lower) & np.isinf(c.upper)


def find_returning_angles(mechanism: Mechanism, c: Coordinates) -> np.ndarray:
    """Which velocity coordinates (nv,) are angles of which a full turn changes no pose, whatever
    their limits.
    """
    back = c.turning.copy()
    number = {name: i for i, name in enumerate(c.velocity_names)}
    for joint in mechanism.joints.values() if c.followers else ():
        names = list_coordinate_names(mechanism, joint)
        for p in joint.type.layout(mechanism.dim, mechanism.bodies[joint.child].particle)[1]:
            follower = c.followers.get(names[p.coordinate])
            # it must return after a full turn, too
            if follower is not None and follower.source is not None:
                back[number[follower.source]] &= _is_unchanged_by_turn(p, follower.multiplier)
    for relation in c.relations:
        for name in (relation.of, *relation.sources):
            back[number[name]] = False
    return back & ~find_wound_coordinates(mechanism, c)


def find_wound_coordinates(mechanism: Mechanism, c: Coordinates) -> np.ndarray:
    """Return a mask (nv,) of coordinates that declared position equations read directly.

    Such an equation may tell whole turns apart.
    """
    out = np.zeros(len(c.velocity_names), dtype=bool)
    number = {name: i for i, name in enumerate(c.velocity_names)}
    for declared in mechanism.constraints.values():
        for name in declared.of.coordinate_names if declared.count_positions(mechanism.dim) else ():
            source = c.followers[name].source if name in c.followers else name
            if source in number:
                out[number[source]] = True
    return out
