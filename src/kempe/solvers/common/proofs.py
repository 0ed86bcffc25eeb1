"""Why there is no answer, as data: what proves it, and what was found out; `wording` says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.model.tree.characteristic_length import characteristic_length
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.common.serial_chain import ReachBound

ROUNDING = 1e-14
"""What rounding makes of lengths, in parts of them."""


@dataclass(frozen=True, slots=True)
class Evidence(InWords):
    """What was found out about why there is no answer: of which `kind`, with `figures`, names and
    numbers of that kind.

    Figures are attributes, too; `text` is the sentence. Kinds that prove that there is no answer
    are

    - "lengths": the target is out of reach of the links by at least so many metres, at its `place`
      whatever its orientation, `turned` together with it, or off the `plane` of the system;
    - "tilted": by an `angle` out of the plane of the system;
    - "outside": all `count` configurations that reach it are outside limits, or slides end `short`
      metres before it;
    - "contradiction": tasks `first` and `second` exclude each other by `off` metres or radians;
    - "no root": no angle of a `joint` brings what `axes` keep to where it must be, by `off` metres
      or radians.
    """

    kind: str
    figures: Mapping[str, Any]

    @property
    def proof(self) -> bool:
        """Whether it proves that there is no answer; else it is what was found out by asking again."""
        from kempe.solvers.common.wording import PROOFS  # only here: a success needs no sentences

        return self.kind in PROOFS

    @property
    def text(self) -> str:
        """The sentence that says it."""
        from kempe.solvers.common.wording import FOUND_OUT, PROOFS

        return (PROOFS.get(self.kind) or FOUND_OUT[self.kind])(**self.figures)

    def __str__(self) -> str:
        return self.text

    def __getattr__(self, name: str) -> Any:
        if name in Evidence.__slots__ or name not in self.figures:
            return object.__getattribute__(self, name)  # the error as it is of any object
        return self.figures[name]


def evidence(kind: str, **figures: Any) -> Evidence:
    """Evidence of a kind, with its figures."""
    return Evidence(kind, figures)


def lengths(
    system: System,
    place: float = 0.0,
    turned: float = 0.0,
    plane: float = 0.0,
    task: str = "",
    point: bool = False,
    slides: Sequence[str] = (),
) -> Evidence | None:
    """Evidence that a target is out of reach of a system by so many metres; None where all are
    zero.

    Its figure `times` is the largest of them in typical lengths of a link, `point` says that the
    target is x, y, z, and `slides` names the coordinates of slides, whose limits are a reason as
    the lengths are.
    """
    far = max(place, turned, plane)
    if not far > 0.0:
        return None
    times = far / characteristic_length(system)
    return evidence(
        "lengths",
        place=place,
        turned=turned,
        plane=plane,
        task=task,
        times=times,
        point=point,
        slides=list(slides),
    )


def outside_limits(system: System, q: Array, slack: float = 1e-9, turns: bool = True) -> list[str]:
    """Coordinates that are outside their limits at q (nq,), whatever whole `turns` are added; else
    as they are.
    """
    structure = system.structure
    names: list[str] = []
    for i, v in zip(structure.layout.vector_q, structure.layout.vector_v, strict=True):
        low = system.lower[v]
        high = system.upper[v]
        x = q[i]
        if turns and structure.coordinates.turning[v]:
            x -= 2.0 * np.pi * np.ceil((x - high) / (2.0 * np.pi)) if x > high else 0.0
            x += 2.0 * np.pi * np.ceil((low - x) / (2.0 * np.pi)) if x < low else 0.0
        if not low - slack <= x <= high + slack:
            names.append(structure.velocity_names[int(v)])
    return names


def by_lengths(
    bounds: Sequence[ReachBound],
    X: Array,
    tolerance: tuple[float, float],
    turned: bool = True,
    axes: Sequence[int] = (0, 1, 2),
    dim: int = 3,
    along: Array | None = None,
) -> Array:
    """How far (..., 2) in metres poses X (..., 4, 4) of a frame are past the bounds of its chain.

    First as to the place, then together with the orientation, where that is `turned`, or points
    `along` an axis (3,) of the frame. `axes` of the pose are those along which its place counts:
    with fewer than `dim`, no place is too near. These are lower bounds of the error in its place;
    zero within the tolerances and what rounding makes of them.
    """
    linear, angular = tolerance
    out = np.zeros((*X.shape[:-2], 2))
    p = X[..., :3, 3]
    R = X[..., :3, :3]
    size = np.abs(p).max(axis=-1)
    for centre, largest, smallest, point in bounds:
        arm = float(np.linalg.norm(point))
        on_axis = along is not None and float(np.linalg.norm(np.cross(point, along))) < 1e-12 * arm
        if arm > 0.0 and not (turned or on_axis):
            continue
        away = p + R @ point - centre
        if len(axes) < 3:
            away = np.einsum("...ji,...j->...i", R, away)[..., list(axes)]
        far = np.linalg.norm(away, axis=-1)
        off = far - largest if len(axes) < dim else np.maximum(far - largest, smallest - far)
        k = int(arm > 0.0)
        slack = linear + arm * angular + ROUNDING * (largest + arm + size)
        out[..., k] = np.where(off > slack, np.maximum(out[..., k], off), out[..., k])
    return out
