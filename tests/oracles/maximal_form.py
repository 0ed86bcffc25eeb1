"""The equations of a system in maximal coordinates, compiled once; and its joint coordinates, read
off poses.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.description.parts import Joint
from kempe.equations.judge import compute_coordinate_value
from kempe.joints import Q
from kempe.model.configurations import read_start
from kempe.model.model import keep_answers
from kempe.spatial import Array
from oracles import pairs
from oracles.carried import Carried
from oracles.closures import Closure, closure_of
from oracles.declared import declared
from oracles.frames import Pair

if TYPE_CHECKING:
    from kempe.system import System

TURNS = (0, 32, 6, 2, 1)
"""Full turns to each side that are tried of 0, 1, 2, ... coordinates where what depends on them
tells their turns."""
FULL_TURN = 2.0 * np.pi
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


def maximal_velocity_names(system: System) -> tuple[str, ...]:
    """A name for each number that moves the bodies, such as 'crank.vx' or 'crank.wz'."""
    names = TWIST if system.dim == 3 else ("vx", "vy", "wz")
    bodies = system.mechanism.bodies
    return tuple(
        f"{b}.{n}"
        for b in system.body_names[1:]
        for n in names
        if n[0] == "v" or not bodies[b].particle
    )


class LinearRow(NamedTuple):
    """sum of factor * coordinate = offset, the dependent coordinate first with factor 1.

    `turns` says that the dependent one is an angle, `free` that it is part of q. `periods` are
    those of the other terms that can turn fully, so that poses do not tell how far they have
    turned.
    """

    name: str
    terms: tuple[tuple[str, float], ...]
    offset: float
    turns: bool
    free: bool
    periods: tuple[tuple[str, float], ...]


class Form(NamedTuple):
    """All equations of a system: those of pairs, of coordinates, and of quaternions that are held."""

    joints: list[Closure | Carried]
    pairs: list[Pair]
    relations: list[LinearRow]
    balls: list[tuple[Closure, Array]]
    """Joints whose quaternion is held, and where."""
    selectors: list[Array]
    """For each body the matrix (6, n) that takes all twists to its own."""
    turning: set[str]
    said: dict[str, str]


@keep_answers
def form_of(system: System) -> Form:
    """The equations of a system."""
    mechanism = system.mechanism
    followers = system.structure.couplings
    every = [closure_of(system, name, own=True) for name in mechanism.joints]
    joints = [j for j in every if isinstance(j, Closure)]
    turning = {names[0] for j in joints for names, kind in j.tied if kind.startswith("turn")}
    turning |= {n for j in joints for names, kind in j.tied if kind == "angles" for n in names}
    turning |= {j.own.names[i] for j in every if isinstance(j, Carried) for i in j.own.turning()}
    balls = [
        (j, spatial.unit([followers[n].offset for n in names]))
        for j in joints
        for names, kind in j.tied
        if kind == "quaternion" and names[0] in followers
    ]
    in_balls = {n for j in mechanism.joints.values() for n in _quaternion(system, j)}
    rows = [
        (n, ((f.source, -f.multiplier),) if f.source else (), f.offset)
        for n, f in followers.items()
    ]
    rows += [
        (r.of, tuple((s, -m) for s, m in r.sources.items()), r.offset)
        for r in system.structure.relations
    ]
    wide = {
        n: not high - low < FULL_TURN
        for n, (low, high) in zip(
            system.structure.velocity_names, system.structure.limits, strict=True
        )
    }
    relations = []
    for name, sources, offset in rows:
        if name not in in_balls:
            terms = ((name, 1.0), *sources)
            periods = tuple((n, m) for n, m in sources if n in turning and wide[n])
            relations.append(
                LinearRow(name, terms, offset, name in turning, name not in followers, periods)
            )
    said = {n: f"joint {n!r} ({j.type.type_name})" for n, j in mechanism.joints.items()}
    said |= {n: f"constraint {n!r} ({c.kind})" for n, c in mechanism.constraints.items()}
    columns = maximal_velocity_names(system)
    selectors = {b: np.zeros((6, len(columns))) for b in system.body_names}
    for k, column in enumerate(columns):
        body, _, axis = column.rpartition(".")
        selectors[body][TWIST.index(axis), k] = 1.0
    held = [replace(j, tied=()) if isinstance(j, Closure) else j for j in every]
    held += [declared(system, c) for c in mechanism.constraints.values()]
    return Form(every, held, relations, balls, list(selectors.values()), turning, said)


def _quaternion(system: System, joint: Joint) -> list[str]:
    """Names of the coordinates of a joint that make up its quaternion."""
    names = system.structure.coordinates_of_joint(joint.name)
    primitives = joint.type.layout(system.dim, system.mechanism.bodies[joint.child].particle)[1]
    return [n for p in primitives if p.kind == Q for n in names[p.coordinate : p.coordinate + 4]]


def pose_in(system: System, pair: Pair, poses: Array) -> Array:
    """Pose of B in A."""
    X_WA, X_WB = (_body(system, b, poses) for b in (pair.a, pair.b))
    return spatial.inverse(X_WA @ pair.X_A) @ X_WB @ pair.X_B


def motion_in(system: System, pair: Pair, poses: Array) -> Array:
    """Matrix (..., 6, n) from the twists of the bodies to that of B against A."""
    selectors = form_of(system).selectors
    number = system.body_names.index
    ends = ((pair.a, pair.X_A), (pair.b, pair.X_B))
    return pairs.motion(*((_body(system, b, poses), X, selectors[number(b)]) for b, X in ends))


def _body(system: System, name: str, poses: Array) -> Array:
    i = system.body_names.index(name)
    return poses[..., i - 1, :, :] if i else np.eye(4)


# ---- coordinates


def coordinates_of(
    system: System, poses: Array, near: Any
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Values of all coordinates by name, those nearest to a configuration, and for what is no
    quaternion its derivatives (..., n) by the twists.
    """
    near = system.mid if near is None else read_start(system, near)
    values = {}
    rates = {}
    for joint in form_of(system).joints:
        X = pose_in(system, joint, poses)
        motion = motion_in(system, joint, poses)
        if isinstance(joint, Carried):
            own, slope = joint.read(X, joint.values(system, near))
            values |= {n: own[..., i] for i, n in enumerate(joint.own.names)}
            rates |= {joint.own.names[i]: (slope @ motion)[..., v, :] for i, v in joint.own.plain}
            continue
        for names, kind in joint.tied:
            at = np.stack([compute_coordinate_value(system, near, n) for n in names], axis=-1)
            if kind == "quaternion":
                quat = spatial.matrix_to_quat_wxyz(X[..., :3, :3])
                found = np.where(np.sum(quat * at, axis=-1, keepdims=True) < 0.0, -quat, quat)
                slopes = []
            elif kind == "angles":
                found, slopes = _three_angles(X, at)
            else:
                value, slope = pairs.read(X, kind, joint.pitch)
                turning = kind.startswith("turn") or (kind == "screw" and joint.pitch == 0.0)
                found = (_unwrapped(value, at[..., 0]) if turning else value)[..., None]
                slopes = [slope]
            values |= {n: found[..., i] for i, n in enumerate(names)}
            rates |= {
                n: (s[..., None, :] @ motion)[..., 0, :]
                for n, s in zip(names, slopes, strict=False)
            }
    return values, rates


def _unwrapped(angle: Array, near: Array) -> Array:
    return angle + FULL_TURN * np.round((near - angle) / FULL_TURN)


def _three_angles(X: Array, near: Array) -> tuple[Array, list[Array]]:
    """Turns (..., 3) about z, y', x'': of the two ways to say a rotation the one that is nearest;
    rates (..., 6).
    """
    (a, da), (b, db), (c, dc) = (pairs.turn(X, k) for k in ("yaw", "pitch", "roll"))
    locked = np.hypot(X[..., 0, 0], X[..., 1, 0]) < pairs.ANGLES_SINGULAR
    a = np.where(locked, near[..., 0], a)  # only a combination of a and c is determined
    rest = np.swapaxes(spatial.rot_z(a) @ spatial.rot_y(b), -1, -2) @ X[..., :3, :3]
    c = np.where(locked, np.arctan2(rest[..., 2, 1], rest[..., 1, 1]), c)
    one = _unwrapped(np.stack([a, b, c], axis=-1), near)
    other = _unwrapped(np.stack([a + np.pi, np.pi - b, c + np.pi], axis=-1), near)
    second = np.linalg.norm(other - near, axis=-1) < np.linalg.norm(one - near, axis=-1)
    return np.where(second[..., None], other, one), [da, np.where(second[..., None], -db, db), dc]


def off_by(relation: LinearRow, values: dict[str, Array], fit: bool) -> Array:
    """How far a relation is violated; with `fit` by the full turns that fit best."""
    off = np.asarray(sum(m * values[n] for n, m in relation.terms) - relation.offset)
    if not fit:
        return off
    shifts = _turn_counts(len(relation.periods)) @ np.array([m for _, m in relation.periods])
    tried = _within(off[..., None] + FULL_TURN * shifts, relation.turns)
    return np.take_along_axis(tried, np.argmin(np.abs(tried), axis=-1)[..., None], axis=-1)[..., 0]


def _turn_counts(n: int) -> Array:
    """Numbers of full turns (k, n) of n coordinates that are tried, those of few turns first."""
    most = TURNS[n] if n < len(TURNS) else 0
    found = sorted(product(range(-most, most + 1), repeat=n), key=lambda ks: sum(map(abs, ks)))
    return np.array(found, dtype=float).reshape(len(found), n)


def _within(off: Array, turns: bool) -> Array:
    return off - FULL_TURN * np.round(off / FULL_TURN) if turns else off
