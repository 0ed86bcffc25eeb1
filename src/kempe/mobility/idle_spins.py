"""The idle spins of a system, found once, and what answers need to know of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.forward.fk import fk, jacobian
from kempe.model.configurations import has_loops, mid
from kempe.model.model import kept
from kempe.model.own_tree import own_tree
from kempe.singular_values import svd
from kempe.spatial import Array, skew

if TYPE_CHECKING:
    from kempe.first_order.idle_freedoms import IdleFreedom
    from kempe.mobility.answer import Mobility
    from kempe.model.model import Model

ZERO = 1e-8
"""Singular values below this count as zero."""


class Spin(NamedTuple):
    """An idle spin: a body that spins, point and direction (3,) of its line in the body's axes,
    velocities (nv,) that it moves, and the sentence that says it.
    """

    body: str
    point: Array
    line: Array
    moves: np.ndarray
    text: str


def spins_of(system: Model, q: Array) -> tuple[Spin, ...]:
    """The idle spins of a system: as at its posture `closed`, or at a closed configuration that is
    found; if there is none, at q (nq,).
    """
    tree = own_tree(system)
    found = _at_home(tree)
    if found is not None:
        return found
    from kempe.mobility.mobility import mobility

    return _spins(tree, mobility(tree, q, local=False))


def moved_by_spins(system: Model, q: Array) -> np.ndarray:
    """Which velocity coordinates (nv,) idle spins change; of a rotation, all three."""
    out = np.any(
        [s.moves for s in spins_of(system, q)] or [np.zeros(system.nv, dtype=bool)], axis=0
    )
    for iv in system.structure.layout.quaternion_v:
        out[iv : iv + 3] = out[iv : iv + 3].any()
    return np.asarray(out)


def not_spun(system: Model) -> np.ndarray:
    """Which velocity coordinates (nv,) idle spins leave alone."""
    return (
        ~moved_by_spins(system, mid(system))
        if has_loops(system)
        else np.ones(system.nv, dtype=bool)
    )


def spin_rates(system: Model, q: Array) -> Array:
    """Rows (k, s, nv) by which velocities at q (k, nq) give the rates of the s idle spins [rad/s]."""
    tree = own_tree(system)
    spins = spins_of(system, mid(system)) if system.dim == 3 else ()
    rows = [s.line @ jacobian(tree, q, s.body, "body")[:, 3:] for s in spins]
    return np.stack(rows, axis=1) if rows else np.zeros((len(q), 0, system.nv))


@kept
def _at_home(system: Model) -> tuple[Spin, ...] | None:
    from kempe.mobility.mobility import mobility

    report = mobility(system, local=False)
    return _spins(system, report) if report.closed else None


def _spins(system: Model, report: Mobility) -> tuple[Spin, ...]:
    return tuple(_spin(system, report.q, f) for f in report.idle_freedoms)


def _spin(system: Model, q: Array, found: IdleFreedom) -> Spin:
    X = fk(system, q, found.bodies[0])
    point, line = (
        X[:3, :3].T @ v for v in (np.array(found.point) - X[:3, 3], np.array(found.direction))
    )
    return Spin(found.bodies[0], point, line, found.velocity != 0.0, str(found))


def idle_part(system: Model, q: Array, N: Array, scale: Array, spins: tuple[Spin, ...]) -> Array:
    """Of a basis (nv, p) of scaled velocities at q (nq,), the combinations (p, k), orthonormal,
    that are idle spins.
    """
    tree = own_tree(system)
    found = [np.zeros((0, N.shape[1]))]
    for spin in spins:
        rows = _nothing(N[~spin.moves])
        if len(rows) > 1:  # they move what is useful as well: the spin is what keeps the line
            X = fk(tree, q, spin.body)
            J = jacobian(tree, q, spin.body)
            line = X[:3, :3] @ spin.line
            arm = X[:3, :3] @ spin.point
            keeps = np.concatenate([J[:3] - skew(arm) @ J[3:], skew(line) @ J[3:]])
            rows = _nothing(np.concatenate([N[~spin.moves], keeps @ (scale[:, None] * N)]))
        found.append(rows)
    _, sizes, V = svd(np.concatenate(found), full_matrices=False)
    return V[sizes > ZERO].T


def _nothing(A: Array) -> Array:
    """A basis (k, p) of what a matrix (n, p) makes nothing of."""
    _, sizes, V = svd(A, full_matrices=True)
    return V[int(np.sum(sizes > ZERO)) :]
