"""Minimal coordinates of systems with loops: which of the joint coordinates are independent, and the others from them.

Near a regular configuration the closed configurations form a surface of dimension p, and p of the n velocity
coordinates can be its parameters: a *chart* (Haug, 1989, chapter 3; the lecture's generalised positions). It is as good
as the smallest singular value of the tangent space's rows of these p coordinates: 1 where they are the tangent space, 0
where they no longer move the others (a turning point of a driver).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.calls import explained, explained_methods, listed, numbers
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.configuration import as_q
from kempe.kinematics.loops import RANK_TOLERANCE, evaluate, scales
from kempe.solvers.assembly import TOLERANCE, Assembly, assemble
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

WORST = 0.02
"""Conditioning below which a chart is given up, for up to four coordinates a freedom; with more, less is usual."""


@explained_methods
@dataclass(frozen=True, eq=False)
class Chart:
    """Independent coordinates of a system about a closed configuration.

    `independent` are the names of the p coordinates chosen, `dependent` those of all others, `origin` (nq,) where it
    was chosen, `quality` its conditioning there, from 0 (useless) to 1.
    """

    system: System
    independent: tuple[str, ...]
    dependent: tuple[str, ...]
    origin: Array
    quality: float

    @property
    def dim(self) -> int:
        """Number p of independent coordinates."""
        return len(self.independent)

    def u(self, q: Any) -> Array:
        """The independent coordinates (..., p) of configurations (..., nq)."""
        q = as_q(self.system, q)
        return q[..., [self.system.coordinate_names.index(n) for n in self.independent]]

    def q(self, u: Any, near: Any = None) -> Assembly:
        """The configuration with these independent coordinates (..., p), reached by one search from `near`.

        Default for `near`: the origin. From far away it may be on another branch: lead it in steps.
        """
        u = numbers(u, "u")
        if u.ndim == 0 and self.dim == 1:
            u = u[None]
        if u.ndim == 0 or u.shape[-1] != self.dim:
            raise InputError(f"u has shape {u.shape}; needed is (..., {self.dim}): {', '.join(self.independent)}")
        known = {n: u[..., i] for i, n in enumerate(self.independent)}
        return assemble(self.system, known, self.origin if near is None else near, starts=1)

    def tangent(self, q: Any) -> Array:
        """Rates (nv, p) of all velocity coordinates by the independent ones, at a closed configuration (nq,)."""
        N, scale = tangent_space(self.system, q)
        rows = [self.system.velocity_names.index(n) for n in self.independent]
        return (scale[:, None] * N) @ np.linalg.inv(scale[rows, None] * N[rows])

    def condition(self, q: Any) -> float:
        """How well the independent coordinates move all others at a closed q (nq,): 1 best, 0 not at all."""
        N, _ = tangent_space(self.system, q)
        return _quality(N, [self.system.velocity_names.index(n) for n in self.independent])

    def valid(self, q: Any) -> bool:
        """Whether the chart can still be used at the closed configuration q (nq,)."""
        return self.condition(q) >= _worst(self.dim, self.system.nv)

    def next(self, q: Any) -> Chart:
        """The best chart at the closed configuration q (nq,)."""
        return independent(self.system, q)

    def __str__(self) -> str:
        return (
            f"{self.dim} independent coordinates: {', '.join(self.independent) or 'none'} "
            f"(conditioning {self.quality:.2g}); dependent: {', '.join(self.dependent) or 'none'}"
        )


@explained
def independent(system: System, q: Any = None, prefer: Iterable[str] = ()) -> Chart:
    """A chart at a closed configuration q (nq,): which p coordinates can be set, so that the others follow.

    Without a wish the best conditioned ones are taken, greedily (QR with column pivoting of the tangent space: Golub,
    1965). `prefer` are names of coordinates that must be among them. Default for q: the closed configuration that
    `assemble` finds. Errors: `InputError` if q is not closed, or if the preferred ones cannot be set independently,
    with the reason; `UnknownNameError`.
    """
    if q is None:
        answer = assemble(system)
        if not answer:
            raise InputError(f"{system.name} could not be assembled: {answer.status}")
        q = answer.q
    q = as_q(system, q)
    N, _ = tangent_space(system, q)
    names, p = system.velocity_names, N.shape[1]
    wish = listed(prefer, "prefer")
    usable = {names[v] for v in system.layout.vector_v}
    for name in wish:
        if name not in usable:
            raise UnknownNameError("coordinate", name, sorted(usable), system.name)
    rows = [names.index(n) for n in wish]
    if len(set(rows)) < len(rows) or len(rows) > p:
        raise InputError(f"{len(rows)} coordinates are preferred; here {p} different ones are independent")
    least = _worst(p, system.nv)
    if rows and _quality(N, rows) < least:
        raise InputError(
            f"{', '.join(wish)} cannot be set independently here: conditioning {_quality(N, rows):.2g}, at least "
            f"{least:.2g} is needed; the best choice is {', '.join(independent(system, q).independent)}"
        )
    rows = _extend(N, rows, [v for v in range(system.nv) if names[v] in usable])
    quality = _quality(N, rows)
    if len(rows) < p or (p and quality < least):
        raise InputError(
            "no choice of angles and lengths is independent here: quaternions would be needed; "
            "joints with angles=True have angles in their place"
        )
    chosen = tuple(names[v] for v in sorted(rows))
    rest = tuple(n for n in names if n not in chosen)
    return Chart(system, chosen, rest, q.copy(), quality)


def tangent_space(system: System, q: Any) -> tuple[Array, Array]:
    """Orthonormal basis (nv, p) of the velocities that keep all loops closed at q (nq,), and the scales (nv,).

    Slides are measured in characteristic lengths: velocities in units are ``scale * N``. Errors: `InputError` if q
    is not closed.
    """
    q = as_q(system, q)
    if q.ndim != 1:
        raise InputError(f"q has shape {q.shape}; needed is one configuration ({system.nq},)")
    error, J = evaluate(system, q, True, True)
    if not np.linalg.norm(error) <= 10.0 * TOLERANCE:
        raise InputError(f"q is not closed: the loops' equations are off by {np.linalg.norm(error):.3g}; use assemble")
    _, values, Vt = np.linalg.svd(J, full_matrices=True)
    rank = int((values > RANK_TOLERANCE * max(1.0, values.max(initial=0.0))).sum())
    return Vt[rank:].T, scales(system)


def _quality(N: Array, rows: list[int]) -> float:
    """The smallest singular value of these rows of an orthonormal basis."""
    return float(np.linalg.svd(N[rows], compute_uv=False).min(initial=1.0)) if rows else 1.0


def _worst(p: int, n: int) -> float:
    """The least conditioning of p of n coordinates; even the best choice has no more than sqrt(p / n)."""
    return WORST * min(1.0, 2.0 * np.sqrt(p / max(n, 1)))


def _extend(N: Array, rows: list[int], usable: list[int]) -> list[int]:
    """The rows, extended to p of them, each time by that which is farthest from the span of those chosen."""
    rows, p = list(rows), N.shape[1]
    rest = N.copy()
    for row in rows:
        rest = _without(rest, rest[row])
    while len(rows) < p and usable:
        size = np.linalg.norm(rest[usable], axis=1)
        row = usable[int(np.argmax(np.round(size, 9)))]  # rounding does not decide between equals: the first is taken
        rows.append(row)
        rest = _without(rest, rest[row])
    return rows


def _without(N: Array, direction: Array) -> Array:
    size = np.linalg.norm(direction)
    if size < 1e-300:
        return N
    u = direction / size
    return N - np.outer(N @ u, u)
