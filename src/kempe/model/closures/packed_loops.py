"""Loops as data: what ties which frames together over which coordinates, packed for the kernels.

A *tie* is one constraint between two frames A and B: a joint that the tree left out, a declared
constraint, a frame held in place (a pin), or a linear relation of coordinates. A joint that the
tree left out is tied in one of two forms. *Implicit*, A is its frame F and B its frame M, held as
the joint holds them; its own coordinates are read off afterwards. *Explicit*, A is led on through
the joint's own motion, and coincides with B; its coordinates are unknowns like all others. So a
coordinate that is known, limited or coupled needs nothing special, and neither does a joint type
that has no implicit form (`kempe.model.closures.implicit_form`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.description.parts import Joint
from kempe.kernels.constraints import loop_layout as L
from kempe.model.closures.constraint_program import declared_ties
from kempe.model.closures.frame_constraints import Centre, CompiledFunction, PackedLoops, Tie
from kempe.model.closures.implicit_form import ImplicitForm, implicit_form, slides_along_z
from kempe.model.closures.loop_plan import LoopPlan, moving
from kempe.model.kept import kept
from kempe.model.tree.characteristic_length import characteristic_length, moved, origin_of
from kempe.model.tree.primitive_table import End, Table, lower

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled

__all__ = [
    "Centre",
    "CompiledFunction",
    "PackedLoops",
    "Tie",
    "characteristic_length",
    "loops_of",
    "must_be_explicit",
    "pack",
    "plane_normal",
]
Places = dict[str, tuple[int, int]]
"""For each coordinate by name its place in q, and in the velocities."""
TURNS = {"": L.NO_TURN, "z": L.ANGLE, "xy": L.ALIGN, "x.y": L.CROSS, "xyz": L.FULL}


def must_be_explicit(system: Compiled, known: Iterable[str] = ()) -> frozenset[str]:
    """The explicit loop joints: those cut without an implicit form, or with known, limited or
    coupled coordinates.
    """
    related = {n for r in system.structure.relations for n in (r.of, *r.sources)} | set(known)
    related |= {n for c in system._mechanism.constraints.values() for n in c.of.reads}
    related |= {
        f.source for f in system.structure.couplings.values() if f.source is not None
    }  # others move with them
    v_index = {n: i for i, n in enumerate(system.structure.velocity_names)}
    limited = np.isfinite(system.lower) | np.isfinite(system.upper)
    out: set[str] = set()
    for name in system.structure.closures:
        names = system.structure.coordinates_of_joint(name)
        none = _implicit(system, system.structure.joints[name]) is None
        if none or any(
            c in system.structure.couplings
            or c in related
            or (c in v_index and limited[v_index[c]])
            for c in names
        ):
            out.add(name)
    return frozenset(out)


def loops_of(
    system: Compiled,
    explicit: frozenset[str],
    held: frozenset[str] = frozenset(),
    pins: tuple[tuple[str, bool], ...] = (),
    length: float | None = None,
    one_sided: bool = False,
) -> PackedLoops:
    """The packed loops of a system; with `one_sided` those declared constraints, too, that hold
    between bounds.

    `explicit` names the left-out joints in explicit form, `held` the velocity coordinates that are
    no unknowns, `pins` the frames that are held in place (with their orientation where the flag
    says so). Equations and unknowns are scaled by `length` (default: the characteristic length);
    with length 1 they are in metres.
    """
    return _packed(system, explicit, held, pins, length, one_sided)


@kept
def _packed(
    system: Compiled,
    explicit: frozenset[str],
    held: frozenset[str],
    pins: tuple[tuple[str, bool], ...],
    length: float | None,
    one_sided: bool,
) -> PackedLoops:
    return pack(system, explicit, held, pins, length, one_sided=one_sided)


def pack(
    system: Compiled,
    explicit: frozenset[str],
    held: frozenset[str] = frozenset(),
    pins: tuple[tuple[str, bool], ...] = (),
    length: float | None = None,
    further: Callable[[Table], list[Tie]] | None = None,
    wide: np.ndarray | None = None,
    level: Callable[[Tie], int] | None = None,
    one_sided: bool = False,
    drawn: Compiled | None = None,
) -> PackedLoops:
    """The packed loops as `loops_of` gives them, but packed anew, with `further` ties over the rows
    of the table.

    `wide` (nv,) marks angles whose limits do not count, for whole turns lead back into them. Ties
    of a lower `level` stand before others, so that of rows that depend on each other the later ones
    yield. The frames of `further` ties are those of the `drawn` system, where given: it has the
    same coordinates, and other dimensions.
    """
    size = characteristic_length(system) if length is None else length
    origin = origin_of(system)
    table = _lowered(system, {n: n in explicit for n in system.structure.closures}, origin)
    frames = table
    if drawn is not None:
        table, frames = _side_by_side(_lowered(drawn, {}, origin), table)
    ties = _ties(system, table, explicit, pins, one_sided) + (further(frames) if further else [])
    ties = [t for t in ties if t.rows or t.joint]
    first = system.structure.coordinates.first
    ties = _by_level(ties, table, level, first) if level else _in_order(ties, table, first)
    at = dict(table.at)
    for k, tie in enumerate(ties):
        at["tie", k, 0] = tie.a
        at["tie", k, 1] = tie.b
    table = replace(table, at=at)
    every = (
        range(len(table.kind)) if any(t.centre for t in ties) else None
    )  # a centre is moved by all that has mass
    ints, floats = table.pack([("tie", k, end) for k in range(len(ties)) for end in (0, 1)], every)
    plan, weights = LoopPlan(system, ties, ints, held, size, length is None, wide).arrays()
    for tie in ties:
        if tie.function is not None:
            tie.function.scale = L.velocity_lists(weights, system.nv)[0]
    names = tuple((t.name, row) for t in ties for row in t.rows)
    unknown = np.array(
        [i for i, n in enumerate(system.structure.velocity_names) if n not in held], dtype=np.int64
    )
    return PackedLoops(tuple(ties), names, ints, floats, plan, weights, unknown, size, origin)


def _lowered(system: Compiled, ends: dict[str, bool], origin: np.ndarray) -> Table:
    """The table of a system with the ends of joints that the tree left out, measured from `origin`
    (3,).
    """
    mechanism = system._mechanism
    given = system.structure
    table = lower(mechanism, given.topology, given.coordinates, mechanism.parameters, ends)
    return moved(table, -origin) if origin.any() else table


def _side_by_side(first: Table, second: Table) -> tuple[Table, Table]:
    """The rows of two tables over the same coordinates as one table: with the ends of the second,
    and of the first.
    """
    n = len(first.kind)
    behind = np.where(second.parent < 0, -1, second.parent + n)
    ends = {
        name: (row if row < 0 else row + n, X, particle)
        for name, (row, X, particle) in second.at.items()
    }
    both = Table(
        np.concatenate([first.kind, second.kind]),
        np.concatenate([first.parent, behind]),
        np.concatenate([first.iq, second.iq]),
        np.concatenate([first.iv, second.iv]),
        np.concatenate([first.multiplier, second.multiplier]),
        np.concatenate([first.offset, second.offset]),
        np.concatenate([first.placement, second.placement]),
        ends,
        second.nq,
        second.nv,
    )
    return both, replace(both, at=first.at)


# ---- what is tied


def held_ties(system: Compiled, table: Table) -> list[Tie]:
    """All ties that hold positions: of joints that the tree left out, in explicit form, and of
    declared constraints.

    One-sided constraints are among them. `table` has the frames of these joints, led on through
    their motion.
    """
    return _ties(system, table, frozenset(system.structure.closures), (), True)


def _ties(
    system: Compiled,
    table: Table,
    explicit: frozenset[str],
    pins: tuple[tuple[str, bool], ...],
    one_sided: bool,
) -> list[Tie]:
    mechanism = system._mechanism
    ties = [
        _of_joint(system, table, mechanism.joints[n], n in explicit)
        for n in system.structure.closures
    ]
    ties += declared_ties(system, table, one_sided)
    ground = (-1, np.eye(4), False)
    for relation in system.structure.relations:
        ties.append(
            Tie(
                relation.of,
                ground,
                ground,
                turns=L.LINEAR,
                number=relation.offset,
                relation=relation,
            )
        )
    for frame, turned in pins:
        mask = _mask("xyz"[: system.dim])
        turns = L.NO_TURN if not turned else L.ANGLE if system.dim == 2 else L.FULL
        ties.append(Tie(frame, ground, table.at[frame], mask, turns, pin=True))
    return ties


def _flat(end: End, of: End, table: Table) -> End:
    """The end turned so that x is what was z of `of`, and z the plane's normal: a slide of the
    plane is along z.
    """
    z = plane_normal(of, table)
    x = np.array([0.0, 0.0, 1.0])
    C = np.eye(4)
    C[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return end[0], end[1] @ C, end[2]


def plane_normal(end: End, table: Table) -> np.ndarray:
    """The normal of the plane of a planar system, in axes of a frame: the same in all
    configurations.
    """
    z = np.array([0.0, 0.0, 1.0])
    row = end[0]
    way: list[np.ndarray] = [end[1]]
    while row >= 0:
        way.append(table.placement[row])
        row = int(table.parent[row])
    for X in reversed(way):
        z = X[:3, :3].T @ z
    return z


def _of_joint(system: Compiled, table: Table, joint: Joint, explicit: bool) -> Tie:
    """The tie of a joint that the tree left out."""
    a = table.at[joint.name, "F"]
    b = table.at[joint.name, "M"]
    if slides_along_z(joint.type, system.dim, b[2]):
        a = _flat(a, b, table)
        b = _flat(b, b, table)
    if explicit:
        turns = "" if b[2] else "z" if system.dim == 2 else "xyz"
        return Tie(joint.name, a, b, _mask("xyz"[: system.dim]), TURNS[turns])
    form = _implicit(system, joint)
    assert form is not None, f"joint {joint.name!r} must be explicit"
    return Tie(joint.name, a, b, _mask(form.position), TURNS[form.turns], joint=joint)


def _implicit(system: Compiled, joint: Joint) -> ImplicitForm | None:
    return implicit_form(joint.type, system.dim, system._mechanism.bodies[joint.child].particle)


def _mask(axes: str) -> int:
    """The bits of some axes, as one integer."""
    return sum(1 << "xyz".index(a) for a in axes)


def _in_order(ties: list[Tie], table: Table, first: Places) -> list[Tie]:
    """The ties so that those that share coordinates are near each other: it keeps the envelope of J
    J^T small.
    """
    if len(ties) < 8:
        return ties
    from scipy.sparse import csgraph, csr_matrix

    users: dict[int, list[int]] = {}
    for k, tie in enumerate(ties):
        for v in _coordinates_of(tie, table, first):
            users.setdefault(v, []).append(k)
    pairs = [(i, j) for use in users.values() for i in use for j in use]
    if not pairs:
        return ties
    i, j = np.array(pairs).T
    graph = csr_matrix((np.ones(len(pairs)), (i, j)), shape=(len(ties), len(ties)))
    order: np.ndarray = cast(Any, csgraph).reverse_cuthill_mckee(graph, symmetric_mode=True)
    return [ties[int(k)] for k in order]


def _by_level(
    ties: list[Tie], table: Table, level: Callable[[Tie], int], first: Places
) -> list[Tie]:
    """The ties in the order of levels, each in an order of its own, so that it is the same without
    the last level.

    Those of the last level that hold one coordinate each stand before the first other one that it
    moves: this keeps the envelope small.
    """
    last = max(level(t) for t in ties)
    loose = [t for t in ties if t.own >= 0 and level(t) == last]
    groups = [
        [t for t in ties if level(t) == n and t not in loose]
        for n in sorted({level(t) for t in ties})
    ]
    out: list[Tie] = []
    for tie in (t for group in groups for t in _in_order(group, table, first)):
        moved_by = _coordinates_of(tie, table, first)
        out += [*(t for t in loose if t.own in moved_by), tie]
        loose = [t for t in loose if t.own not in moved_by]
    return out + loose


def _coordinates_of(tie: Tie, table: Table, first: Places) -> set[int]:
    """Velocity coordinates that the equations of a tie depend on, by which its neighbours in the
    order are found.

    `table` holds the rows of the tree, `first` the places of coordinates by name.
    """
    if tie.own >= 0:
        return {tie.own}
    if tie.function is not None:
        return set(tie.function.support)
    if tie.centre is not None:
        return set(table.iv.tolist())
    if tie.tape is not None:
        own = {first[name][1] for name in tie.tape.coordinates}
        return own | (_between(tie, table) if tie.tape.moved else set())
    return _between(tie, table)


def _between(tie: Tie, table: Table) -> set[int]:
    """Velocity coordinates that move frame B of a tie against its frame A."""
    return {int(table.iv[row]) for _, row in moving(tie.a[0], tie.b[0], table.parent)}
