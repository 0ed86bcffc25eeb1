"""Tasks that hold values between two ends, or a length at a number: one tie, or one for each end.

Kernels keep the ends of a tie with its structure. So where ends differ from target to target, each has a tie of its
own, whose goal is moved there: the value, seen from there, is then above zero, or below.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import InputError
from kempe.kinematics.forward import fk
from kempe.kinematics.task import Goals, Hold, Placed, numbers_of
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

ABOVE, BELOW = (0.0, math.inf), (-math.inf, 0.0)
"""Bounds of what is measured from an end."""
FAR = 1e6
"""Where an end is put that only some targets have, in metres."""


class Between(Placed):
    """A task on values of a frame in the goal that lie between ends. Subclasses say which values, and which ends."""

    @abstractmethod
    def values(self, X: Array) -> Array:
        """What is held (..., n), before its number, of the pose X (..., 4, 4) of the frame in the goal."""

    def ends(self, system: System) -> tuple[Array, Array] | None:
        """Low and high ends (n,), or (..., n) from target to target; None for an equality."""
        return None

    def from_end(self, system: System, goal: Array, end: Array) -> tuple[Array, Array | None]:
        """The goal's pose and its number for values that are measured from an end (..., n)."""
        raise NotImplementedError

    def holds(self, system: System) -> list[Hold]:
        """One tie, or one for each end that is finite anywhere."""
        h, ends = self.hold(system), self.ends(system)
        if ends is None:
            return [h]
        if ends[0].ndim == 1:
            if not np.all((ends[0] <= ends[1]) & (ends[0] < math.inf) & (ends[1] > -math.inf)):
                low, high = (x.tolist() for x in ends)
                raise InputError(f"{self.label} holds between {low} and {high}, which is nothing")
            return [h._replace(bounds=tuple(zip(ends[0].tolist(), ends[1].tolist(), strict=True)))]
        n = ends[0].shape[-1]
        return [h._replace(bounds=(bound,) * n) for bound, _ in _sides(*ends)]

    def goals(self, system: System) -> Goals:
        """The goal, moved to each end that has a tie."""
        ends = self.ends(system)
        if ends is None or ends[0].ndim == 1:
            return super().goals(system)
        goal, out = self.goal(system), []
        for _, end in _sides(*ends):
            X, number = self.from_end(system, goal, end)
            out.append((X, None if number is None else number[..., None]))
        return out

    def measure(self, system: System, q: Array, goals: Goals | None = None) -> tuple[Array, Array]:
        """How far (...) its values are from where they must be, in metres, by the forward model."""
        X, square = None, np.zeros(())
        for h, (goal, number) in zip(self.holds(system), self.goals(system) if goals is None else goals, strict=True):
            X = self.place(system, q, h) if X is None else X
            assert goal is not None
            seen = self.values(spatial.inverse(goal if h.a is None else fk(system, q, h.a) @ goal) @ X)
            seen = seen if number is None else seen - number
            low, high = np.array(h.bounds).T if h.bounds else (0.0, 0.0)
            seen = seen[..., : len(h.bounds)] if h.bounds else seen  # a box in the plane may be given in space
            square = square + np.sum((seen - np.clip(seen, low, high)) ** 2, axis=-1)
        return np.sqrt(square), np.zeros(np.shape(square))

    def miss(self, X: Array) -> tuple[Array, Array]:
        """The size of its values."""
        x = self.values(X)
        return np.sqrt(np.sum(x * x, axis=-1)), np.zeros(X.shape[:-2])


def _sides(low: Array, high: Array) -> list[tuple[tuple[float, float], Array]]:
    """Bounds and ends of the sides on which there is an end anywhere."""
    sides = ((ABOVE, low), (BELOW, high))
    return [(bound, np.clip(end, -FAR, FAR)) for bound, end in sides if not np.isinf(end).all()]


def pair(low: Any, high: Any, what: str) -> tuple[Array, Array]:
    """Two ends as arrays of one shape. Errors: `InputError` where they do not fit together, or leave nothing."""
    try:
        a, b = np.broadcast_arrays(*(numbers_of(x, f"an end of {what}") for x in (low, high)))
    except ValueError:
        raise InputError(f"{what}: {low!r} and {high!r} have shapes that do not fit together") from None
    if np.any(a > b):
        raise InputError(f"{what}: {low!r} and {high!r} leave nothing; needed is low <= high")
    return a.copy(), b.copy()
