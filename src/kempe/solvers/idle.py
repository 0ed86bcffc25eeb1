"""The idle spins of a system, found once, and what answers need to know of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.model.own_tree import own_tree
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


class Spin(NamedTuple):
    """An idle spin: a body that spins, the direction (3,) of its line in the body's axes, velocities (nv,) it moves,
    and the sentence that says it."""

    body: str
    line: Array
    moves: np.ndarray
    text: str


def spins_of(system: System, q: Array) -> tuple[Spin, ...]:
    """The idle spins of a system, found at the first closed configuration (nq,) that they are asked for at."""
    tree = own_tree(system)
    found = tree._queries.get("spins")
    if found is None:
        idle = tree.mobility(q, local=False).idle_freedoms
        found = tree._queries["spins"] = tuple(
            Spin(f.bodies[0], tree.fk(q, f.bodies[0])[:3, :3].T @ np.array(f.direction), f.velocity != 0.0, str(f))
            for f in idle
        )
    return found


def idle_part(N: Array, spins: tuple[Spin, ...]) -> Array:
    """Of a basis (nv, p) of velocities, the combinations (p, k), orthonormal, that are idle spins."""
    found = []
    for spin in spins:
        _, sizes, V = np.linalg.svd(N[~spin.moves], full_matrices=True)
        found.append(V[int(np.sum(sizes > 1e-8)) :])
    together = np.concatenate([np.zeros((0, N.shape[1])), *found])
    _, sizes, V = np.linalg.svd(together, full_matrices=False)
    return V[sizes > 1e-8].T
