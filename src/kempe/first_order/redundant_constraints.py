"""Redundant constraints: self-stresses in the axes of each joint, and a small set of releases.

A self-stress is a set of joint reactions in balance without any load; each is one redundant
constraint. A released direction may move. Releases leave no self-stress, and give the mechanism no
new freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.constraints.base import COUNTS, Op, list_position_rows
from kempe.description.parts import Declared, Joint
from kempe.first_order.constraint_graph import Edge, build_constraint_graph
from kempe.first_order.rank import ClusterRank, Rank, compute_loop_rows
from kempe.first_order.screws import Screws
from kempe.model.implicit_form import (
    ImplicitForm,
    find_implicit_form,
    find_screw_pitch,
    has_slide_along_z,
)
from kempe.model.structural_order import make_sort_key
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import InWords, format_count, spell_count

if TYPE_CHECKING:
    from kempe.model.model import Model

CARRIES = 1e-6
"""Part of a unit self-stress below which a joint direction carries nothing."""
WELL = 0.05
"""Part of a release, measured across those taken before it, from which on it is taken at once: so
no two are nearly the same."""

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
REACTIONS = {"x": "Fx", "y": "Fy", "z": "Fz", "rx": "Mx", "ry": "My", "rz": "Mz"}
"""What a joint that does not move in a direction can carry: a force along it, or a moment about
it."""

_ORDER = ("rx", "ry", "rz", "z", "x", "y")
"""Directions in the order in which they are released: turns cost least, then the slide along the
joint's axis."""

_TURNS = {"xyz": "", "z": "", "xy": "z", "x.y": "xy", "": "xyz"}
"""About which axes a joint turns, by the turns that it holds."""

PAIRS = {
    "rz": "a revolute joint",
    "z": "a prismatic joint",
    "z rz": "a cylindrical joint",
    "rx rz": "a universal joint",
    "rx ry rz": "a spherical joint",
    "z rx ry rz": "a point-on-axis pair (a ball in a tube)",
    "x z": "a cross slide",
    "x y rz": "a planar joint",
    "x y z": "three slides",
    "x y rx rz": "a line-on-plane pair (a roller on a plate)",
    "x y rx ry rz": "a point-on-plane pair (a ball on a plate)",
    "z rx rz": "a universal joint that slides",
    "x rz": "a pin in a slot",
    "x z rz": "a cylinder in a slot",
    "x y z rz": "a planar joint that also lifts",
}
"""Names of pairs by the directions in which they move, up to the names of the axes."""


@dataclass(frozen=True)
class Release(InWords):
    """Directions that a joint or constraint can release, and a joint that could replace it.

    `reactions` names the directions by their reactions, such as 'Mx'.

    `pair` names the joint that is left, such as 'a point-on-axis pair'; '' where nothing is. `kind`
    says what kind of joint or constraint it is, and `dim` that of the system.
    """

    joint: str
    reactions: tuple[str, ...]
    pair: str
    kind: str = ""
    dim: int = 3

    def __str__(self) -> str:
        if not self.pair:
            return f"leave out the {self.kind} {self.joint}".replace("  ", " ")
        # in the plane a moment has one axis only, whatever the axes of the joint are
        shown = ["about the normal" if self.dim == 2 and r[0] == "M" else r for r in self.reactions]
        return f"{self.joint}: {describe_reactions(self.reactions)} ({', '.join(shown)}): use {self.pair}"


@dataclass(frozen=True)
class Redundancy(InWords):
    """Redundant constraints: their number, the joints under self-stress, and releases.

    `stressed` gives for each joint the reactions that carry self-stress, in the joint's own axes
    (forces F and moments M in axes of frame F, at the origin of M; of a universal joint in those of
    its cross).
    """

    number: int
    stressed: tuple[tuple[str, tuple[str, ...]], ...]
    releases: tuple[Release, ...]

    def __str__(self) -> str:
        if not self.number:
            return "no constraint is redundant"
        lines = [f"{format_count(self.number, 'redundant constraint')}; released by"]
        return "\n".join(lines + [f"  {r}" for r in self.releases])


@dataclass(frozen=True, eq=False)
class _JointReaction:
    """One constraint direction of a joint, with its reaction in each self-stress of a cluster."""

    owner: str
    label: str
    passive: bool
    edge: Edge | None
    stress: Array
    free: frozenset[str] = frozenset()
    """Directions in which the owner moves, where it is a joint."""

    @property
    def sort_key(self) -> tuple[int, Any]:
        """Order of release: rods, passive joints, driven joints, couplings; then names."""
        kind = (
            3
            if self.edge is None
            else 0
            if isinstance(self.edge.of, Declared)
            else 1
            if self.passive
            else 2
        )
        return kind, make_sort_key(self.owner)


def find_redundancy(system: Model, rank: Rank) -> Redundancy:
    """Find the redundant constraints of a system at the closed configuration of `rank`."""
    stressed: dict[str, list[str]] = {}
    releases: list[Release] = []
    for c in rank.clusters:
        if not c.n_dependent:
            continue
        rows = [
            r for r in _list_joint_reactions(system, rank, c) if np.abs(r.stress).max() > CARRIES
        ]
        for r in rows:
            stressed.setdefault(r.owner, []).append(r.label)
        releases += [
            _make_release(chosen, system.dim) for chosen in _choose_releases(rows, c.n_dependent)
        ]
    order = {e.name: i for i, e in enumerate(build_constraint_graph(system).edges)}
    named = sorted(stressed.items(), key=lambda kv: (order.get(kv[0], len(order)), kv[0]))
    releases.sort(key=lambda r: (order.get(r.joint, len(order)), r.joint))
    return Redundancy(rank.n_dependent, tuple((k, tuple(v)) for k, v in named), tuple(releases))


# ---- self-stresses in the axes of each joint

# A joint direction that carries no self-stress is needed.


def _list_joint_reactions(system: Model, rank: Rank, c: ClusterRank) -> list[_JointReaction]:
    """List the constraint directions of a cluster of loops with their reactions.

    `c` holds the self-stresses of the cluster, `rank` the screws of all joints at the same
    configuration.
    """
    s = build_constraint_graph(system)
    at = rank.screws
    wrenches = np.zeros((len(c.cluster.loops), 6, c.n_dependent))
    n = 0
    rows: list[_JointReaction] = []
    for k, loop in enumerate(c.cluster.loops):
        R = compute_loop_rows(system, s, at, loop)
        own = c.stresses[n : n + len(R)]
        n += len(R)
        wrenches[k] = R.T @ own
        edge = s.edges[s.loops[loop].edge]
        if isinstance(edge.of, Declared):
            labels = _name_reactions(edge.of, system.dim)
            rows += [
                _JointReaction(edge.name, label, True, edge, x)
                for label, x in zip(labels, own, strict=True)
            ]
    inside = np.tensordot(c.cluster.cells, wrenches, (0, 0))  # (edges, 6, stresses)
    for i, wrench in zip(c.cluster.edges, inside, strict=True):
        edge = s.edges[i]
        if isinstance(edge.of, Declared):
            continue
        names, twists = compute_joint_directions(at, i, edge, system.dim)
        free = _find_free_directions(edge, system.dim)
        free = _find_unheld_directions(names, twists, at.twists[i]) if free is None else free
        for name, twist in zip(names, twists, strict=True):
            if name not in free:
                rows.append(
                    _JointReaction(
                        edge.name, REACTIONS[name], not edge.actuated, edge, twist @ wrench, free
                    )
                )
        for column, twist in zip(edge.columns, at.twists[i].T, strict=True):
            if column.index < 0 or column.name != system.structure.velocity_names[column.index]:
                what = f"{'lock' if column.index < 0 else 'coupling'} of {column.name}"
                rows.append(_JointReaction(what, "", False, None, twist @ wrench))
    for law in (s.laws[k] for k in c.cluster.laws):
        labels = law.names if law.n_rows > 1 else ("",)
        own = c.stresses[n : n + law.n_rows]
        rows += [
            _JointReaction(law.title, label, False, None, x)
            for label, x in zip(labels, own, strict=True)
        ]
        n += law.n_rows
    return rows


def _name_reactions(of: Declared, dim: int) -> tuple[str, ...]:
    """Name the reactions of the equations of a declared constraint, in their order."""
    out: list[str] = []
    for row in list_position_rows(of.of, dim):
        if row.op in COUNTS:
            count = COUNTS[row.op][dim]
            out += ["Mx", "My", "Mz"][-count:] if row.op is Op.ROTATION else ["Mx", "My"][:count]
        elif row.op not in (Op.TAPE, Op.CALL):
            out.append(REACTIONS["xyz"[row.args[0]]] if row.op is Op.POINT else "F")
    return tuple(out) if len(out) > 1 else (out[0][0],)


def compute_joint_directions(
    at: Screws, i: int, edge: Edge, dim: int
) -> tuple[tuple[str, ...], Array]:
    """Compute names and scaled twists (k, 6) of elementary motions in the axes of joint `i`.

    The twists are taken at the origin of the joint's frame M.
    """
    form = _find_implicit_form(edge, dim)
    R = at.cross[i] if form is not None and form.turns == "x.y" else at.F[i, :3, :3]
    names = DIRECTIONS if dim == 3 else ("x", "y", "rz")
    if _is_slider(edge, dim):  # its z lies in the plane: y is across it, x is the plane's normal
        names = ("z", "y", "rx")
        R = np.stack([[0.0, 0.0, 1.0], np.cross([0.0, 0.0, 1.0], R[:, 2]), R[:, 2]], axis=1)
    if edge.particle:
        names = tuple(n for n in names if not n.startswith("r"))
    r = (at.M[i, :3, 3] - at.center) / at.length
    both = np.zeros((6, 6))
    both[:3, :3] = R.T
    both[3:, :3], both[3:, 3:] = (spatial.skew(r) @ R).T, R.T
    return names, both[[DIRECTIONS.index(n) for n in names]]


def _find_implicit_form(edge: Edge, dim: int) -> ImplicitForm | None:
    """Find the implicit form of the equations of a joint; None where there is none."""
    assert isinstance(edge.of, Joint)
    return find_implicit_form(edge.of.type, dim, edge.particle)


def _is_slider(edge: Edge, dim: int) -> bool:
    """Return whether a planar joint slides along z of its frame F."""
    assert isinstance(edge.of, Joint)
    return has_slide_along_z(edge.of.type, dim, edge.particle)


def _find_free_directions(edge: Edge, dim: int) -> frozenset[str] | None:
    """Find the directions in which a joint moves, in axes of F or of its cross.

    None where they are not always the same.
    """
    assert isinstance(edge.of, Joint)
    form = _find_implicit_form(edge, dim)
    if form is None:
        return (
            frozenset({"rz"}) if dim == 3 and find_screw_pitch(edge.of.type) is not None else None
        )
    slides = {how for _, how in form.readings if how in DIRECTIONS}
    if _is_slider(edge, dim):
        return frozenset({"z"})
    turns = "" if edge.particle else "z" if dim == 2 and not form.turns else _TURNS[form.turns]
    return frozenset(slides | {f"r{a}" for a in turns})


def _find_unheld_directions(names: Sequence[str], twists: Array, moves: Array) -> frozenset[str]:
    """Find the directions that a joint with the motions `moves` (6, n) need not hold."""
    basis = Spectrum(moves).compute_column_space(Level.GENERIC)
    held: set[str] = set()
    for part in (WELL, CARRIES):
        for name, twist in zip(names, twists, strict=True):
            rest = twist - basis @ (basis.T @ twist)
            far = float(np.linalg.norm(rest))
            if name not in held and far > part * float(np.linalg.norm(twist)):
                basis = np.column_stack([basis, rest / far])
                held.add(name)
    return frozenset(names) - held


# ---- choice of releases


def _choose_releases(rows: Sequence[_JointReaction], count: int) -> list[list[_JointReaction]]:
    """Choose constraint directions, grouped by joint, whose removal leaves no self-stress.

    Joints that remove most come first, so that they are few.
    """
    owners: dict[str, list[_JointReaction]] = {}
    for r in rows:
        owners.setdefault(r.owner, []).append(r)
    for own in owners.values():
        own.sort(
            key=lambda r: _ORDER.index(_find_direction(r)) if _find_direction(r) in _ORDER else -1
        )
    left = np.eye(count)
    chosen: list[list[_JointReaction]] = []
    while left.shape[1]:
        found = None
        for part in (WELL, CARRIES):
            options = [(own, _select_independent_rows(own, left, part)) for own in owners.values()]
            options = [(own, picked) for own, picked in options if picked]
            if options:
                found = min(
                    options, key=lambda o: (-len(o[1]) * bool(o[0][0].edge), o[0][0].sort_key)
                )[1]
                break
        if found is None:
            break
        chosen.append(found)
        held = np.stack([r.stress for r in found]) @ left
        left = left @ Spectrum(held).right[len(found) :].T
    return chosen


def _select_independent_rows(
    rows: Sequence[_JointReaction], left: Array, part: float
) -> list[_JointReaction]:
    """Select, in order, reactions that are independent in the self-stresses `left`.

    Each must exceed `part` across the ones before.
    """
    basis: list[Array] = []
    out: list[_JointReaction] = []
    for r in rows:
        if len(basis) == left.shape[1]:
            break
        x = r.stress @ left
        for b in basis:
            x = x - (x @ b) * b
        size = np.linalg.norm(x)
        if size > part:
            basis.append(x / size)
            out.append(r)
    return out


_DIRECTION_OF = {reaction: direction for direction, reaction in REACTIONS.items()}


def _find_direction(row: _JointReaction) -> str:
    """Find the direction of a reaction; '' where there is none."""
    return _DIRECTION_OF.get(row.label, "")


def _make_release(rows: Sequence[_JointReaction], dim: int) -> Release:
    """Make the release of constraint directions of one joint or constraint."""
    edge = rows[0].edge
    labels = tuple(r.label for r in rows if r.label)
    if edge is None:
        return Release(rows[0].owner, (), "", dim=dim)
    if isinstance(edge.of, Declared):
        held = _name_reactions(edge.of, dim)
        every: set[str] = set(DIRECTIONS if dim == 3 else ("x", "y", "rz"))
        free = every - {_DIRECTION_OF.get(name, "") for name in held if name not in labels}
        pair = "" if len(rows) == len(held) else name_pair(free)
        return Release(rows[0].owner, labels, pair, "constraint", dim)
    kind = edge.of.type.type_name
    pin = dim == 2 and kind == "revolute"
    kind = "pin" if pin else f"{kind} joint"
    more = {_find_direction(r) for r in rows}
    free = (rows[0].free & _list_possible_directions(edge, dim)) | more
    if free == _list_possible_directions(edge, dim):
        return Release(rows[0].owner, labels, "", kind, dim)
    if _find_free_directions(edge, dim) is None:
        return Release(
            rows[0].owner,
            labels,
            f"a {edge.of.type.type_name} joint that also {describe_motions(more)}",
            kind,
            dim,
        )
    return Release(rows[0].owner, labels, name_pair(set(free)), kind, dim)


def _list_possible_directions(edge: Edge, dim: int) -> AbstractSet[str]:
    """List the directions in which the child of a joint could move at all."""
    if dim == 3:
        return set(DIRECTIONS[:3] if edge.particle else DIRECTIONS)
    if _is_slider(edge, dim):
        return {"z", "y"} if edge.particle else {"z", "y", "rx"}
    return {"x", "y"} if edge.particle else {"x", "y", "rz"}


def name_pair(free: set[str]) -> str:
    """Name the kinematic pair that moves in the directions `free` ('x', ..., 'rz').

    The names of the axes do not matter.
    """
    for axes in permutations("xyz"):
        renamed = dict(zip("xyz", axes, strict=True))
        turned = {d[:-1] + renamed[d[-1]] for d in free}
        found = PAIRS.get(" ".join(d for d in DIRECTIONS if d in turned))
        if found:
            return found
    return f"a joint that {describe_motions(free)}"


def describe_motions(free: set[str]) -> str:
    """Describe motions, such as 'slides along x and turns about y, z' for {'x', 'ry', 'rz'}."""
    slides, turns = (
        ", ".join(d[-1] for d in DIRECTIONS if d in free and len(d) == n) for n in (1, 2)
    )
    parts = [f"slides along {slides}" * bool(slides), f"turns about {turns}" * bool(turns)]
    return " and ".join(p for p in parts if p)


def describe_reactions(reactions: Sequence[str]) -> str:
    """Describe reactions, such as 'two moments and one force' for ('Mx', 'My', 'Fz')."""
    moments = sum(r.startswith("M") for r in reactions)
    parts = [(moments, "moment"), (len(reactions) - moments, "force")]
    return " and ".join(spell_count(n, what) for n, what in parts if n)
