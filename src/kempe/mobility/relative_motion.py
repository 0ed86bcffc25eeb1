"""Motions of one body relative to another at a configuration, to first order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors
from kempe.assemble.generic_configurations import sample_nearby_ranks
from kempe.assemble.nearest_exact import answer_within_tolerance, describe_nearest
from kempe.equations.closure import Closure
from kempe.errors import InputError, UnsupportedError
from kempe.first_order.rank import compute_allowed_velocities, compute_rank
from kempe.forward.fk import fk, jacobian
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import read_q
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Nearest, Report
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


ZERO = 1e-9
"""Velocities below this part of the largest, and singular values likewise, are zero."""


@dataclass(frozen=True, eq=False, repr=False)
class RelativeMotion(Report):
    """The motions of `body` relative to `to` that all constraints allow, to first order."""

    _entries = ("body", "to", "dof", "slides", "twists", "origin", "around")

    body: str
    to: str
    dof: int
    """Their dimension."""
    slides: int
    """Dimension of those among them that do not turn."""
    twists: Array
    """A basis (6, dof), orthonormal in radians and typical lengths, rows [linear; angular] in axes
    of `to`.

    The linear part is the velocity of the origin of `body`.
    """
    origin: Array
    """The origin (3,) of `body` in the frame `to`."""
    around: int
    """The largest dimension found at closed configurations some way from here, at least `dof`."""
    size: float = 1.0
    """The typical length [m]: pitches far below it are rounding."""
    within: Nearest | None = None
    """The nearest mechanism that closes exactly, whose motions these are; None: the given one's."""

    @property
    def status(self) -> str:
        """Sentence about the degrees of freedom; one freedom with its axis in the frame `to`."""
        head = f"{self.dof} DoF of {self.body} relative to {self.to}"
        more = f", {self.slides} of them by sliding alone" if self.dof else ""
        here = f"; to first order here, around here {self.around}" if self.around > self.dof else ""
        return (
            head
            + (f": {self._describe_single_motion()}" if self.dof == 1 else more)
            + here
            + describe_nearest(self.within)
        )

    def _make_headline(self) -> str:
        return self.status

    def _describe_single_motion(self) -> str:
        """Describe a motion of one freedom: a slide, a turn or a screw."""
        v = self.twists[:3, 0]
        w = self.twists[3:, 0]
        if self.slides:
            return f"a slide along {_name_direction(v)}"
        speed = float(np.linalg.norm(w))
        pitch = float(v @ w) / speed**2
        through = self.origin + np.cross(w, v) / speed**2
        at = f"{_name_direction(w)} through ({', '.join(f'{_round_to_zero(x):.4g}' for x in through)})"
        if abs(pitch) <= ZERO * max(float(np.linalg.norm(v)) / speed, self.size):
            return f"a turn about {at}"
        return f"a screw of {pitch:.4g} m a radian about {at}"


@explain_errors
@answer_within_tolerance("q")
def find_relative_motion(
    system: Model,
    q: ArrayLike,
    body: FrameLike,
    to: FrameLike,
    *,
    tolerance: float | str | None = None,
) -> RelativeMotion:
    """Find the motions of a body or frame relative to another at a closed q (nq,).

    It is the image of the velocities that all constraints allow under the difference of both
    Jacobians, in the frame `to`. The answer is one of first order: at a singular posture some of it
    may be the beginning of no motion, of which `mobility` tells, and there may be less of it than
    around, which is said. Errors: `InputError` for shapes and where q is not closed,
    `UnknownNameError`, `UnsupportedError` for frames of particles.

    >>> import kempe
    >>> slider = kempe.load("slider")
    >>> print(find_relative_motion(slider, slider.neutral, "B5", "B0"))
    1 DoF of B5 relative to B0: a slide along x
    """
    found = read_q(system, q)
    if found.shape != (system.nq,):
        raise InputError(f"q has shape {found.shape}; it must be one configuration ({system.nq},)")
    names = [system.structure.frame_name(x) for x in (body, to)]
    for name in names:
        if system.structure.table.at[name][2]:
            raise UnsupportedError(f"{name!r} is on a particle, which has no orientation")
    closure = Closure(system)
    size = compute_characteristic_length(system)
    basis, origin = _compute_twist_basis(closure, found, names, size)
    around = [
        _compute_twist_basis(closure, r.q, names, size)[0].shape[1]
        for r in sample_nearby_ranks(system, compute_rank(system, found), np.random.default_rng(0))
    ]
    dof = basis.shape[1]
    turning = Spectrum(basis[3:], 1.0).compute_rank(Level.CLOSED)
    twists = basis * np.repeat([size, 1.0], 3)[:, None]
    return RelativeMotion(
        names[0], names[1], dof, dof - turning, twists, origin, max([dof, *around]), size
    )


def _compute_twist_basis(
    closure: Closure, q: Array, names: list[str], size: float
) -> tuple[Array, Array]:
    """Compute a basis (6, dof) of the relative twists at q, and the body's origin (3,).

    Rows are in sizes and radians.
    """
    system = closure.system
    rates = closure.unit[:, None] * compute_allowed_velocities(closure, q)
    moved, base = (jacobian(system, q, name) @ rates for name in names)
    X = fk(system, q, names[0])
    Y = fk(system, q, names[1])
    back = Y[:3, :3].T
    arm = X[:3, 3] - Y[:3, 3]
    linear = moved[:3] - base[:3] - np.cross(base[3:], arm, axis=0)
    twists = np.concatenate([back @ linear / size, back @ (moved[3:] - base[3:])])
    return Spectrum(twists, 1.0).compute_column_space(Level.CLOSED), back @ arm


def _round_to_zero(x: float) -> float:
    """Round tiny numbers to zero."""
    return 0.0 if abs(x) < ZERO else x


def _name_direction(v: Array) -> str:
    """Name a direction: an axis, or the unit vector with a positive largest entry."""
    v = v / np.linalg.norm(v)
    k = int(np.argmax(np.abs(v)))
    if np.delete(np.abs(v), k).max() < 1e-6:
        return "xyz"[k]
    v = v * np.sign(v[k])
    return f"({', '.join(f'{_round_to_zero(x):.4g}' for x in v)})"
