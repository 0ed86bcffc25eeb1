"""Actuation: freedoms that the driven joints control, leave free, or drive redundantly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.errors import InputError, UnknownNameError
from kempe.first_order.constraint_graph import build_constraint_graph
from kempe.first_order.rank import Rank
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import InWords, format_count

if TYPE_CHECKING:
    from kempe.first_order.idle_freedoms import IdleFreedom
    from kempe.model.model import Model

SHOWN = 1e-6
"""Part of the largest velocity of a motion below which a coordinate is said to rest."""


@dataclass(frozen=True)
class Control(InWords):
    """Result of the actuation analysis: how many freedoms a set of actuated coordinates controls.

    To first order.

    `controlled` of the `useful` freedoms (idle ones left out) follow the actuated coordinates;
    `excess` actuated coordinates depend on the others (redundant actuation). `free` are motions
    with all actuators held, each as velocities by coordinate name, the largest 1. `singular`: at
    this configuration fewer are controlled than at others of the same branch.
    """

    actuated: tuple[str, ...]
    useful: int
    controlled: int
    excess: int
    singular: bool
    free: tuple[dict[str, float], ...]

    @property
    def complete(self) -> bool:
        """Whether the actuated coordinates control all useful freedoms."""
        return self.controlled == self.useful

    def __bool__(self) -> bool:
        return self.complete

    def __str__(self) -> str:
        who = " and ".join(self.actuated) if len(self.actuated) < 3 else ", ".join(self.actuated)
        one = len(self.actuated) == 1
        useful = format_count(self.useful, "freedom")
        if not self.actuated:
            return "no joint is actuated" + (f": {useful} not controlled" if self.useful else "")
        if self.complete:
            text = f"{who} control{'s' if one else ''} the mechanism ({useful})"
        else:
            text = f"{who} control{'s' if one else ''} {self.controlled} of {useful}"
        if self.excess and len(self.actuated) == 1:
            return (
                f"{who} controls nothing here: to first order it stands still" + self._list_free()
            )
        if self.excess:
            text += (
                f"; {self.excess} of the {len(self.actuated)} actuated coordinates "
                f"depend{'s' * (self.excess == 1)}"
            )
            text += " on the others (redundant actuation)"
        if self.singular:
            text += "; singular for these inputs: at other configurations they control more"
        return text + self._list_free()

    def _list_free(self) -> str:
        """List the motions that are left with the actuators held, a line each."""
        return "".join(f"\n  free with them held: {format_motion(m)}" for m in self.free)


def analyse_control(
    system: Model,
    rank: Rank,
    generic: Sequence[Rank],
    idle: Sequence[IdleFreedom],
    actuated: Iterable[str] | None = None,
) -> Control | None:
    """Find which freedoms the `actuated` joints or coordinates control; None without actuators.

    By default the actuators are those that the description marks.
    """
    indices = find_driven_velocities(system, actuated)
    if indices is None:
        return None
    lazy = (
        np.stack([f.velocity / rank.units for f in idle], axis=1)
        if idle
        else np.zeros((system.nv, 0))
    )
    N = rank.null_space
    seen = Spectrum(N[indices], 1.0)
    left = N @ seen.compute_null_space(Level.GENERIC)
    controlled = seen.compute_rank(Level.GENERIC)
    Q = np.linalg.qr(lazy)[0] if lazy.shape[1] else lazy
    left = Spectrum(left - Q @ (Q.T @ left), 1.0).compute_column_space(Level.GENERIC)
    most = max(
        (Spectrum(r.null_space[indices], 1.0).compute_rank(Level.GENERIC) for r in generic),
        default=controlled,
    )
    useful = rank.nullity - len(idle)
    patterns = tuple(_scale_motion(system, x * rank.units) for x in _make_sparse_basis(left).T)
    names = tuple(system.structure.velocity_names[i] for i in indices)
    fewer = (
        useful - controlled
        > min((r.nullity for r in generic), default=rank.nullity) - len(idle) - most
    )
    return Control(names, useful, controlled, len(indices) - max(controlled, most), fewer, patterns)


def find_driven_velocities(system: Model, actuated: Iterable[str] | None) -> list[int] | None:
    """Find the indices of the velocities of named joints, or of joints marked as actuated.

    A name that follows another coordinate stands for that. None where no name is given and no joint
    is marked.
    """
    edges = build_constraint_graph(system).edges
    if actuated is None:
        marked = [c.index for e in edges if e.actuated for c in e.columns if c.index >= 0]
        return list(dict.fromkeys(marked)) if any(e.actuated for e in edges) else None
    if isinstance(actuated, str) or not isinstance(actuated, Iterable):
        raise InputError(
            f"actuated is {actuated!r}; it must be a list of names of joints or coordinates"
        )
    joints = {e.name: e for e in edges if e.is_joint}
    columns = {c.name: c for e in edges for c in e.columns}
    out: list[int] = []
    for name in actuated:
        name = str(name)
        if name not in joints and name not in columns:
            raise UnknownNameError("joint or coordinate", name, [*joints, *columns], system.name)
        chosen = joints[name].columns if name in joints else [columns[name]]
        if chosen and all(c.index < 0 for c in chosen):
            raise InputError(f"{name!r} is held: it cannot be actuated")
        out += [c.index for c in chosen if c.index >= 0]
    return list(dict.fromkeys(out))


def _make_sparse_basis(X: Array) -> Array:
    """Return a basis of the same space in which each vector alone moves one of the coordinates."""
    if not X.shape[1]:
        return X
    Y = X.copy()
    for k in range(Y.shape[1]):
        pivot = int(np.argmax(np.max(np.abs(Y[:, k:]), axis=1)))
        best = k + int(np.argmax(np.abs(Y[pivot, k:])))
        Y[:, [k, best]] = Y[:, [best, k]]
        Y[:, k] /= Y[pivot, k]
        for other in range(Y.shape[1]):
            if other != k:
                Y[:, other] -= Y[pivot, other] * Y[:, k]
    return Y


def _scale_motion(system: Model, v: Array) -> dict[str, float]:
    """Return the velocities of a motion by name, scaled so that the largest is 1."""
    largest = v[np.argmax(np.abs(v))]
    return {
        n: float(x / largest)
        for n, x in zip(system.structure.velocity_names, v, strict=True)
        if abs(x / largest) > SHOWN
    }


def format_motion(motion: dict[str, float]) -> str:
    """Format the velocities of a motion, the largest first, such as 'B 1, C -0.5'."""
    ordered = sorted(motion.items(), key=lambda kv: (-abs(round(kv[1], 9)), kv[0]))
    more = ", ..." if len(ordered) > 8 else ""
    return ", ".join(f"{n} {x:.3g}" for n, x in ordered[:8]) + more
