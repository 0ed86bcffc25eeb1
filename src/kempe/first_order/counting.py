"""Degrees of freedom by the Grübler count, for the whole system and for each loop.

The count of Gruebler (1917) and Kutzbach (1929) assumes that all constraints are independent, which
only the rank can tell. A loop whose joints move its links in a group of motions of d dimensions is
closed by d equations (Herve, 1978).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from kempe.description.parts import Declared
from kempe.first_order.constraint_graph import (
    ConstraintGraph,
    Edge,
    build_constraint_graph,
    count_closing_equations,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import InWords, choose_verb, format_count

if TYPE_CHECKING:
    from kempe.first_order.screws import Screws
    from kempe.model.model import Model

GROUPS = {
    (0, 0): "no motion",
    (1, 0): "one slide",
    (1, 1): "one screw",
    (2, 0): "slides in a plane",
    (2, 1): "turns and slides along one axis",
    (3, 0): "slides in space",
    (3, 1): "motions of a plane",
    (3, 3): "turns about one point",
    (4, 1): "slides in space and turns about one direction",
}
"""Groups of motions by dimension and dimension of their turns; what is missing is all motions of
space."""


@dataclass(frozen=True)
class LoopCount(InWords):
    """Grübler count of one loop: freedoms of its joints less the equations that close the loop.

    `equations` is 3 in the plane and 6 in space, or the dimension of the smaller group that the
    joints move in, whose name is `motion` ('' where it is not known: the mechanism is open).
    """

    name: str
    joints: tuple[str, ...]
    freedoms: int
    equations: int
    motion: str

    @property
    def count(self) -> int:
        """Freedoms of the joints less the equations that close the loop."""
        return self.freedoms - self.equations

    def __str__(self) -> str:
        why = f" ({self.motion})" if self.motion else ""
        return f"{' - '.join(self.joints)}: {self.freedoms} - {self.equations} = {self.count}{why}"


@dataclass(frozen=True)
class Counting(InWords):
    """The Grübler count of a system with its steps as sentences.

    `gruebler` is the result; `gruebler_spatial` is the count of the same planar system in space.
    """

    dim: int
    free: int
    taken: int
    gruebler: int
    gruebler_spatial: int
    steps: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(self.steps)


def count_freedoms(system: Model) -> Counting:
    """Compute the Grübler count with its steps, such as 4 x (3 - 2) - 2 = 2."""
    s = build_constraint_graph(system)
    m = system._mechanism
    dim = system.dim
    whole, point = (6, 3) if dim == 3 else (3, 2)
    particles = [m.bodies[b].particle for b in system.body_names[1:]]
    bodies = particles.count(False)
    points = particles.count(True)
    free = bodies * whole + points * point
    takes = [(*_count_removed_freedoms(e, dim), e) for e in s.edges]
    held = _count_other_constraints(s, system)
    taken = sum(n for n, _, _ in takes) + sum(n for n, _ in held)
    gruebler = free - taken
    spatial = gruebler - (_count_extra_equations(s) if dim == 2 else 0)
    steps = (
        _describe_free_bodies(bodies, points, whole, point, free, dim),
        _describe_removed_freedoms(takes, held, taken, free, gruebler),
        _describe_lecture_count(system, s, takes, held, particles, gruebler),
    )
    return Counting(dim, free, taken, gruebler, spatial, tuple(t for t in steps if t))


def _count_extra_equations(s: ConstraintGraph) -> int:
    """Count the equations that the loops of a planar system have in space but not in the plane."""
    edges = (s.edges[loop.edge] for loop in s.loops)
    return sum(count_closing_equations(e, 3) - count_closing_equations(e, 2) for e in edges)


def _count_removed_freedoms(edge: Edge, dim: int) -> tuple[int, str]:
    """Return how many freedoms a joint or constraint removes, and the name of its kind."""
    if isinstance(edge.of, Declared):
        return count_closing_equations(edge, dim), f"{edge.of.kind.replace('_', '-')} constraint"
    return edge.of.type.constraints(dim, edge.particle), f"{edge.of.type.type_name} joint"


def _count_other_constraints(s: ConstraintGraph, system: Model) -> list[tuple[int, str]]:
    """Count the freedoms that couplings, locks and written constraints remove, with their names."""
    locked = sum(c.index < 0 for e in s.edges for c in e.columns)
    follow = sum(
        c.index >= 0 and c.name != system.structure.velocity_names[c.index]
        for e in s.edges
        for c in e.columns
    )
    written = sum(law.n_rows for law in s.laws if isinstance(law.of, Declared))
    found = [
        (locked, "locked coordinate"),
        (follow + len(system.structure.relations), "coupling"),
        (written, "equation"),
    ]
    return [(n, what) for n, what in found if n]


def _describe_free_bodies(
    bodies: int, points: int, whole: int, point: int, free: int, dim: int
) -> str:
    """Describe the freedoms of bodies and particles without joints."""
    who = [format_count(n, what) for n, what in ((bodies, "body"), (points, "particle")) if n]
    if not who:
        return "There is no body that moves: 0 DoF."
    sums = " + ".join(f"{n} x {k}" for n, k in ((bodies, whole), (points, point)) if n)
    place = "the plane" if dim == 2 else "space"
    return f"Without joints, {' and '.join(who)} could move freely in {place}: {sums} = {free} DoF."


def _describe_removed_freedoms(
    takes: Sequence[tuple[int, str, Edge]],
    held: Sequence[tuple[int, str]],
    taken: int,
    free: int,
    gruebler: int,
) -> str:
    """Describe the freedoms that joints and constraints remove, and the count that is left."""
    groups = Counter((what, n) for n, what, _ in takes)
    parts = [f"{format_count(k, what)} x {n}" for (what, n), k in groups.items()]
    parts += [f"{format_count(n, what)} x 1" for n, what in held]
    first = next(iter(groups.values())) if groups else held[0][0] if held else 0
    if not parts:
        return ""
    sums = f"{' + '.join(parts)} = {taken}, which leaves {free} - {taken} = {gruebler}"
    return f"Taken away {choose_verb(first, 'is', 'are')} {sums}."


def _describe_lecture_count(
    system: Model,
    s: ConstraintGraph,
    takes: Sequence[tuple[int, str, Edge]],
    held: Sequence[tuple[int, str]],
    particles: Sequence[bool],
    gruebler: int,
) -> str:
    """Write the sum body by body: one joint holds each body, joints that close loops remove more."""
    whole, point = (6, 3) if system.dim == 3 else (3, 2)
    by_name = {e.name: n for n, _, e in takes}
    tree = Counter(
        (point if p else whole, by_name[j])
        for p, j in zip(particles, system.structure.parent_joints, strict=True)
    )
    if not tree:
        return ""
    extra = Counter(takes[loop.edge][0] for loop in s.loops)
    more = sum(n for n, _ in held)
    text = " + ".join(f"{k} x ({free} - {n})" for (free, n), k in tree.items())
    text += "".join(f" - {k} x {n}" if k > 1 else f" - {n}" for n, k in extra.items() if n)
    text += f" - {more}" if more else ""
    loops = sum(extra.values())
    if loops == 1 and len(tree) == 1:
        who = "Each body is held by one joint (the last by two)"
    elif loops:
        who = (
            f"Each body is held by one joint, and {loops} more "
            f"{choose_verb(loops, 'closes a loop', 'close loops')}"
        )
    else:
        who = "Each body is held by one joint"
    if held:
        how = "take away one each" if more > 1 else "takes away one"
        who += f", and {' and '.join(format_count(n, what) for n, what in held)} {how}"
    return f"{who}: {text} = {gruebler}."


# ---- the count of each loop, by its group of motions

# Such groups are the motions in one plane, about one point, along one line, and so on.


def count_loop_freedoms(system: Model, at: Screws | None) -> tuple[LoopCount, ...]:
    """Count the freedoms of each fundamental loop.

    With the screws `at` a closed configuration, the equations of a loop are as many as the
    dimension of its group of motions.
    """
    s = build_constraint_graph(system)
    out: list[LoopCount] = []
    for loop in s.loops:
        inside = [i for i, _ in loop.path]
        freedoms = len({c.index for i in inside for c in s.edges[i].columns if c.index >= 0})
        equations = loop.rows
        motion = ""
        edge = s.edges[loop.edge]
        if at is not None and edge.is_joint and not edge.particle:
            equations, turns = find_group_dimensions(
                np.concatenate([at.twists[i] for i in inside], axis=1)
            )
            whole = 3 if system.dim == 2 else 6
            motion = GROUPS.get((equations, turns), "") if equations < whole else ""
        out.append(
            LoopCount(
                edge.name, tuple(s.edges[i].name for i in inside), freedoms, equations, motion
            )
        )
    return tuple(out)


def find_group_dimensions(twists: Array) -> tuple[int, int]:
    """Find the dimension of the smallest group of motions with the screws (6, n), and of its turns."""
    basis = compute_group_basis(twists, Level.GENERIC)
    return basis.shape[1], Spectrum(basis[3:], 1.0).compute_rank(Level.GENERIC)


def compute_group_basis(twists: Array, level: float) -> Array:
    """Compute an orthonormal basis (6, d) of the smallest Lie algebra that contains screws (6, n).

    The span, of a rank at `level`, is completed by Lie brackets until it no longer grows.
    """
    basis = Spectrum(twists, 1.0).compute_column_space(level)
    while True:
        if basis.shape[1] in (0, 1, 6):
            return basis
        grown = Spectrum(np.hstack([basis, _compute_brackets(basis)]), 1.0).compute_column_space(
            level
        )
        if grown.shape[1] == basis.shape[1]:
            return basis
        basis = grown


def spans_lie_algebra(twists: Array, level: float, clear: float) -> bool:
    """Return whether screws (6, n) span a Lie algebra, with a clear rank."""
    spectrum = Spectrum(twists)
    basis = spectrum.compute_column_space(level)
    d = basis.shape[1]
    if d > spectrum.compute_rank(clear):
        return False
    return d in (1, 6) or d == Spectrum(np.hstack([basis, _compute_brackets(basis)])).compute_rank(
        level
    )


def _compute_brackets(basis: Array) -> Array:
    """Compute all Lie brackets (6, n (n - 1) / 2) of pairs of screws (6, n).

    The bracket of [v; w] and [v'; w'] is [w x v' + v x w'; w x w'].
    """
    i, k = zip(*combinations(range(basis.shape[1]), 2), strict=True)
    a = basis[:, i]
    b = basis[:, k]
    out = np.empty_like(a)
    for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[x] = a[y + 3] * b[z] - a[z + 3] * b[y] + a[y] * b[z + 3] - a[z] * b[y + 3]
        out[x + 3] = a[y + 3] * b[z + 3] - a[z + 3] * b[y + 3]
    return out
