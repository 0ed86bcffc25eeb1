"""The serial chain that moves one frame, packed for numerical kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.answers.targets import Z_AXIS, make_rotations_along
from kempe.equations.closure_rows import pack_full_loops
from kempe.errors import UnsupportedError
from kempe.inverse.chain.span import Span, measure_span
from kempe.kernels.base.search_layout import LARGEST
from kempe.kernels.forward.table_layout import (
    BALL,
    KIND,
    Q_INDEX,
    SLIDE,
    TURN,
    V_INDEX,
    get_row_integers,
    get_tip_placement,
)
from kempe.model.gauge import regauge_table
from kempe.model.model import keep_answers
from kempe.model.primitive_table import extract_chain
from kempe.numerics.length_bounds import ReachBound, compute_packed_reach_bounds
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


@dataclass(frozen=True, eq=False)
class Chain:
    """The serial chain that moves one frame, packed with coordinates of its own.

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
    bounds: tuple[ReachBound, ...]
    span: Span


def find_chain(system: Model, name: str, axis: tuple[float, float, float] = Z_AXIS) -> Chain:
    """Find the packed chain of a frame, with its z axis turned to `axis`.

    Errors: `UnsupportedError` where loops, declared constraints or relations move it.
    """
    return _pack_chain(system, name, axis)


@keep_answers
def _pack_chain(system: Model, name: str, axis: tuple[float, float, float]) -> Chain:
    """Pack the chain of a frame for a pointing axis, once."""
    return (
        _build_chain(system, name) if axis == Z_AXIS else _turn_tip(find_chain(system, name), axis)
    )


def _turn_tip(chain: Chain, axis: tuple[float, float, float]) -> Chain:
    """Return the chain with its tip turned so that z points along `axis`."""
    floats = chain.floats.copy()
    turn = make_rotations_along(np.array(axis))
    tip = get_tip_placement(chain.ints, floats)
    tip[:, :3] = tip[:, :3] @ turn
    return replace(chain, floats=floats)


def _build_chain(system: Model, name: str) -> Chain:
    """Build the packed chain of a frame.

    Errors: `UnsupportedError` where no open chain leads to the frame.
    """
    refusal = find_obstacle(system, name)
    if refusal is not None:
        raise UnsupportedError(refusal)
    table, q_index, v_index = extract_chain(system.structure.table, name)
    packed = table.pack_arrays([name], table.find_path(name))
    limits = np.ascontiguousarray(system.structure.limits[v_index].T)
    largest = float(np.abs(packed[1]).max(initial=0.0))
    if not largest < LARGEST:
        raise UnsupportedError(
            f"the chain of {name!r} has a length of {largest:.3g} m; it must be below {LARGEST:g} m"
        )
    ints, floats = regauge_table(*packed)
    circular = np.zeros(len(v_index), dtype=np.int64)
    wide = np.subtract(limits[1], limits[0]) >= 2.0 * math.pi
    for iv in range(len(v_index)):
        rows = table.multiplier[table.iv == iv]
        circular[iv] = (
            wide[iv]
            and len(rows) == 1
            and abs(rows[0]) == 1.0
            and table.kind[table.iv == iv][0] == TURN
        )
    bounds = compute_packed_reach_bounds((packed, (ints, floats)), limits.T)
    base = move_inside_limits(system, system.neutral[None].copy())
    no_seed = np.empty((1, 0, len(q_index)))
    return Chain(
        ints,
        floats,
        q_index,
        v_index,
        limits,
        circular,
        base,
        no_seed,
        bounds,
        measure_span(ints, floats),
    )


def find_motion_masks(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Find masks (n,) of the chain's coordinates that rotate a body, and that translate one.

    Screws do both.
    """
    rows = get_row_integers(chain.ints)
    each = np.arange(len(chain.v_index))
    turns, slides = (np.isin(each, rows[rows[:, KIND] == kind, V_INDEX]) for kind in (TURN, SLIDE))
    return turns, slides


def is_moved_by_loop(system: Model, name: str) -> bool:
    """Return whether the motion of a frame depends on a closed loop or a declared constraint."""
    why = find_obstacle(system, name) or ""
    return any(words in why for words in (" moves with the loop ", " moves with the constraint "))


@keep_answers
def has_shared_coordinates(system: Model, frame: str) -> bool:
    """Return whether two motions of a frame's chain, without balls, share a coordinate."""
    if find_obstacle(system, frame) is not None:
        return False
    rows = get_row_integers(find_chain(system, frame).ints)
    return not np.any(rows[:, KIND] == BALL) and len(set(rows[:, Q_INDEX].tolist())) < len(rows)


@keep_answers
def find_obstacle(system: Model, name: str) -> str | None:
    """Find the reason why no open chain leads to a frame; None if one does."""
    moving = {int(i) for i in extract_chain(system.structure.table, name)[2]}
    used = {system.structure.velocity_names[i] for i in moving}
    for closure in system.structure.closures:
        if used & list_loop_coordinates(system, closure):
            return (
                f"frame {name!r} moves with the loop that joint {closure!r} closes: no chain of "
                "its own leads there"
            )
    for relation in system.structure.relations:
        if used & {relation.of, *relation.sources}:
            return (
                f"frame {name!r} moves with coordinate {relation.of!r}, which follows several "
                "others: no chain of its own leads there"
            )
    if any(c.count_equations(system.dim) for c in system._mechanism.constraints.values()):
        loops = pack_full_loops(system, False)
        for k, tie in enumerate(loops.ties):
            if tie.name in system._mechanism.constraints and moving & set(loops.list_columns(k)):
                return (
                    f"frame {name!r} moves with the constraint {tie.name!r}: no chain of its own "
                    "leads there"
                )
    return None


def list_loop_coordinates(system: Model, closure: str) -> set[str]:
    """List the velocity coordinates of the joints of a loop, by the cut joint that closes it."""
    number = {b: i for i, b in enumerate(system.body_names)}
    joint = system.structure.joints[closure]
    ways: list[set[int]] = []
    for body in (joint.parent, joint.child):
        i = number[body]
        way: set[int] = set()
        while i:
            way.add(i)
            i = system.parent[i - 1]
        ways.append(way)
    joints = {closure} | {system.structure.parent_joints[i - 1] for i in ways[0] ^ ways[1]}
    names: set[str] = set()
    for j in joints:
        for c in system.structure.coordinates_of_joint(j):
            follower = system.structure.couplings.get(c)
            names.add(c if follower is None else follower.source or c)
        names |= {v for v in system.structure.velocity_names if v.startswith(f"{j}.")}
    return names


def move_inside_limits(system: Model, q: Array) -> Array:
    """Move every limited coordinate of configurations (N, nq) inside its limits, in place."""
    at_q = system.structure.layout.vector_q
    at_v = system.structure.layout.vector_v
    q[:, at_q] = np.clip(q[:, at_q], system.lower[at_v], system.upper[at_v])
    return q
