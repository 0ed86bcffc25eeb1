"""The chain that moves one frame, packed for the kernels of the numerical inverse model."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.errors import UnsupportedError
from kempe.kernels.layout import HEADER, KIND, MULTIPLIER, N_ROWS, ROW_FLOATS, ROW_INTS, SLIDE, TURN, V_INDEX
from kempe.model.gauge import regauge
from kempe.model.table import local_chain
from kempe.solvers.targets import Z_AXIS, frame_of
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


@dataclass(frozen=True, eq=False)
class Chain:
    """The chain that moves one frame, packed for the kernel with coordinates of its own.

    `q_index` and `v_index` say which entries of the system's `q` and velocities they are.
    """

    ints: np.ndarray
    floats: np.ndarray
    q_index: np.ndarray
    v_index: np.ndarray
    limits: np.ndarray
    circular: np.ndarray
    base: Array
    """Where (1, nq) coordinates rest that no seed names: neutral, inside the limits."""
    no_seed: Array
    bounds: tuple[tuple[Array, float, float], ...]
    """Reach bounds: the frame is never farther than the second number, nor nearer than the third, from the point."""


def chain_of(system: System, name: str, axis: tuple[float, float, float] = Z_AXIS) -> Chain:
    """The packed chain of a frame, its z axis turned to `axis`, made once.

    Errors: `UnsupportedError` where loops or relations move it.
    """
    key = ("ik", name, axis)
    chain = system._queries.get(key)
    if chain is None:
        chain = system._queries[key] = _chain(system, name) if axis == Z_AXIS else _turned(chain_of(system, name), axis)
    return chain


def _turned(chain: Chain, axis: tuple[float, float, float]) -> Chain:
    floats = chain.floats.copy()
    tip = floats[ROW_FLOATS * int(chain.ints[N_ROWS]) :][:12].reshape(3, 4)
    tip[:, :3] = tip[:, :3] @ frame_of(np.array(axis))
    return replace(chain, floats=floats)


def _chain(system: System, name: str) -> Chain:
    refusal = obstacle(system, name)
    if refusal is not None:
        raise UnsupportedError(refusal)
    table, q_index, v_index = local_chain(system.table, name)
    packed = table.pack([name], table.path(name))
    limits = np.ascontiguousarray(system.limits[v_index].T)
    ints, floats = regauge(*packed)
    circular = np.zeros(len(v_index), dtype=np.int64)
    wide = np.subtract(limits[1], limits[0]) >= 2.0 * math.pi
    for iv in range(len(v_index)):
        rows = table.multiplier[table.iv == iv]
        circular[iv] = wide[iv] and len(rows) == 1 and abs(rows[0]) == 1.0 and table.kind[table.iv == iv][0] == TURN
    bounds = tuple(_reach(*arrays, limits) for arrays in (packed, (ints, floats)))
    base, no_seed = inside(system, system.neutral[None]), np.empty((1, 0, len(q_index)))
    return Chain(ints, floats, q_index, v_index, limits, circular, base, no_seed, bounds)


def obstacle(system: System, name: str) -> str | None:
    """Why no chain of its own leads to a frame: a loop or a relation that moves it; None if one does. Found once."""
    key = ("obstacle", name)
    if key not in system._queries:
        _, _, v_index = local_chain(system.table, name)
        system._queries[key] = _obstacle(system, name, {system.velocity_names[i] for i in v_index})
    return system._queries[key]


def _obstacle(system: System, name: str, used: set[str]) -> str | None:
    for closure in system.closures:
        if used & loop_coordinates(system, closure):
            return f"frame {name!r} moves with the loop that joint {closure!r} closes: no chain of its own leads there"
    for relation in system.relations:
        if used & {relation.of, *relation.sources}:
            return (
                f"frame {name!r} moves with coordinate {relation.of!r}, which follows several others: no chain of its "
                f"own leads there"
            )
    return None


def loop_coordinates(system: System, closure: str) -> set[str]:
    """Velocity coordinates of the joints of the loop that a left-out joint closes, its own included."""
    number = {b: i for i, b in enumerate(system.body_names)}
    joint = system.joints[closure]
    ways: list[set[int]] = []
    for body in (joint.parent, joint.child):
        i, way = number[body], set()
        while i:
            way.add(i)
            i = system.parent[i - 1]
        ways.append(way)
    joints = {closure} | {system.parent_joints[i - 1] for i in ways[0] ^ ways[1]}
    names: set[str] = set()
    for j in joints:
        for c in system.coordinates_of_joint(j):
            follower = system.couplings.get(c)
            names.add(c if follower is None else follower.source or c)
        names |= {v for v in system.velocity_names if v.startswith(f"{j}.")}
    return names


def _reach(ints: np.ndarray, floats: np.ndarray, limits: Array) -> tuple[Array, float, float]:
    """A point and the largest and smallest distance that the tip can have from it, by lengths alone."""
    n = int(ints[0])
    lengths = []
    for k in range(1, n + 1):  # the last one is the output's placement
        at = ROW_FLOATS * k
        lengths.append(float(np.linalg.norm(floats[[at + 3, at + 7, at + 11]])))
    for row in range(n):
        at = HEADER + ROW_INTS * row
        kind, iv, m = ints[at + KIND], ints[at + V_INDEX], floats[ROW_FLOATS * row + MULTIPLIER]
        if kind == SLIDE:
            far = float(np.max(np.abs(m * limits[:, iv])))
            lengths.append(far)
            if not math.isfinite(far):
                return np.zeros(3), math.inf, 0.0
    start = floats[[3, 7, 11]]
    slides = np.any(ints[HEADER + KIND : HEADER + ROW_INTS * n : ROW_INTS] == SLIDE)
    total = sum(lengths)
    longest = 0.0 if slides or not lengths else max(lengths)
    return start, total, max(0.0, 2.0 * longest - total)


def inside(system: System, q: Array) -> Array:
    """The configurations (N, nq) with every limited coordinate brought inside its limits, in place."""
    at_q, at_v = system.layout.vector_q, system.layout.vector_v
    q[:, at_q] = np.clip(q[:, at_q], system.lower[at_v], system.upper[at_v])
    return q
