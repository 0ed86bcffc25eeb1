"""Residual and Jacobian of all constraint equations of a system.

*Full* form: each joint that the tree left out ties its frame M, led there through its own
coordinates, to its child. The unknowns are all coordinates, those of cut joints included, so that
nothing depends on where a loop was cut, and the nullity of the Jacobian is the number of freedoms
that the rank sees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors, read_flag
from kempe.kernels.compiled import closure_batch
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import read_q
from kempe.model.own_tree import remove_cut_marks
from kempe.model.packed_loops import PackedLoops, find_explicit_joints, get_packed_loops
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


__all__ = [
    "SystemConstraint",
    "compute_characteristic_length",
    "compute_coordinate_units",
    "compute_jacobian",
    "compute_residual",
    "count_remaining_freedoms",
    "evaluate_constraints",
    "list_constraints",
    "list_row_names",
]


def compute_residual(system: Model, q: Any) -> Array:
    """Compute the residual (..., m) of all constraint equations at q (..., nq).

    Its entries are in metres and radians, and zero where all loops close.

    For each joint that the tree left out: position and rotation vector of its frame M on the child,
    in axes of the M that its own coordinates predict (in planar systems two positions and an angle;
    for particles the position); then the declared constraints and the relations between several
    coordinates. `list_row_names` says which row is which.
    """
    return evaluate_constraints(system, q, False)[0]


def compute_jacobian(system: Model, q: Any) -> Array:
    """Compute the Jacobian (..., m, nv) of all constraint equations at q (..., nq).

    It is the exact derivative of `compute_residual`, whether or not the loops are closed at q.
    """
    return evaluate_constraints(system, q, True)[1]


def evaluate_constraints(
    system: Model,
    q: Any,
    with_jacobian: bool = True,
    scaled: bool = False,
    loops: PackedLoops | None = None,
) -> tuple[Array, Array]:
    """Compute residual (..., m) and Jacobian (..., m, nv) of all constraint equations at q.

    The Jacobian is empty without `with_jacobian`.

    `scaled`: lengths, those of sliding coordinates included, are measured in characteristic
    lengths, and loops are cut where solvers cut them (`remove_cut_marks`), so that nothing depends on the
    unit or on joints marked `cut`. `loops` are the equations in another form than the full one.
    """
    q = read_q(system, q)
    loops = loops or pack_full_loops(system, scaled)
    lead = q.shape[:-1]
    m = len(loops.names)
    flat = q.reshape(math.prod(lead), system.nq)
    out = np.empty((len(flat), m))
    columns = np.empty((len(flat) if with_jacobian else 0, m, system.nv))
    pins = np.zeros((1, 0))
    packed = loops.ints, loops.floats, loops.plan, loops.weights
    closure_batch.evaluate_equations(*packed, pins, flat, with_jacobian, out, columns)
    loops.raise_function_error()
    return out.reshape(*lead, m), columns.reshape(*lead, m, system.nv) if with_jacobian else columns


def list_row_names(system: Model) -> list[tuple[str, str]]:
    """List the names of each equation: the joint, constraint or coupling, and the component.

    Components are 'x', 'rz', 'distance', ...
    """
    return list(pack_full_loops(system, False).names)


def pack_full_loops(system: Model, scaled: bool) -> PackedLoops:
    """Pack the loop equations in full form, in metres or `scaled` to characteristic lengths."""
    tree = remove_cut_marks(system) if scaled else system
    return get_packed_loops(
        tree, frozenset(tree.structure.closures), length=None if scaled else 1.0
    )


def compute_coordinate_units(system: Model) -> Array:
    """Compute the unit (nv,) of each velocity coordinate.

    It is 1 radian for an angle and the characteristic length for a prismatic coordinate.
    """
    return pack_full_loops(system, True).scale


@dataclass(frozen=True, eq=False)
class SystemConstraint:
    """A constraint f(q) = 0 of a system, as rows of the packed equations."""

    name: str
    loops: PackedLoops
    rows: tuple[int, ...]

    def __repr__(self) -> str:
        return f"SystemConstraint({self.name!r}: {', '.join(self.names)})"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components of the rows: 'x', 'rz', 'distance', ..."""
        return tuple(self.loops.names[i][1] for i in self.rows)

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def residual(self, system: Model, q: Any) -> Array:
        """Compute the residual (..., size) of the constraint at q (..., nq), in metres and radians."""
        return evaluate_constraints(system, q, False, loops=self.loops)[0][..., list(self.rows)]

    def jacobian(self, system: Model, q: Any) -> Array:
        """Compute the exact derivatives (..., size, nv) of the residual by velocity coordinates."""
        return evaluate_constraints(system, q, loops=self.loops)[1][..., list(self.rows), :]


@explain_errors
def list_constraints(system: Model, own: bool = True) -> list[SystemConstraint]:
    """List the constraints of a system: loop closures, declared constraints and relations.

    With `own=False` the coordinates of the joints that close loops are left out where nothing else
    depends on them.
    """
    loops = (
        pack_full_loops(system, False)
        if read_flag(own, "own")
        else get_packed_loops(system, find_explicit_joints(system), length=1.0)
    )
    rows: dict[tuple[str, bool], list[int]] = {}
    for i, (name, what) in enumerate(loops.names):
        rows.setdefault((name, what == "relation"), []).append(i)
    order = [(n, False) for n in (*system.structure.closures, *system._mechanism.constraints)]
    order += [(r.of, True) for r in system.structure.relations]
    return [SystemConstraint(key[0], loops, tuple(rows[key])) for key in order if key in rows]


def count_remaining_freedoms(system: Model, q: Array, held: frozenset[str] = frozenset()) -> int:
    """Count the freedoms that the constraints leave at q to coordinates that are not held.

    The number is the nullity of the constraint Jacobian.

    The angles of a ball near their own singularity are measured from q, unless some of them are
    held.
    """
    # only here: to assemble needs none of it
    from kempe.model.ball_angles import make_regular_chart

    system, q, _ = make_regular_chart(system, q, held)
    free = [i for i, n in enumerate(system.structure.velocity_names) if n not in held]
    J = evaluate_constraints(system, q, True, True)[1][:, free]
    return len(free) - Spectrum(J, 1.0).compute_rank(Level.CLOSED)
