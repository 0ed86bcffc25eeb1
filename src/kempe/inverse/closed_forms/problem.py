"""The problem that `ik_all` solves for a chain: targets, task, tolerance, time limit, held joints."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arrays import check_range, read_reals
from kempe.errors import InputError, UnknownNameError, format_value
from kempe.model.configurations import read_start
from kempe.numerics.clock import TimeLimit
from kempe.spatial import Array
from kempe.units import METRES

if TYPE_CHECKING:
    from kempe.model.model import Model

FARTHEST = 1e5
"""Largest coordinate of `start`: beyond, an angle with its turns has lost the digits that solutions
have."""

ANGULAR = 1e-6
"""Largest tolerance of angles that rounding of positions makes."""


class Watch:
    """The time limit of a call, and the mask `late` (N,) of the targets that it stopped."""

    def __init__(self, limit: TimeLimit, count: int):
        self.limit = limit
        self.late = np.zeros(count, dtype=bool)

    @property
    def is_over(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() >= self.limit.end


@dataclass(frozen=True, eq=False)
class ChainProblem:
    """The problem of all configurations of a chain that reach targets (N, 4, 4) of a frame.

    `lead` is the leading shape of the targets, None for a single one.
    """

    system: Model
    frame: str
    task: str
    axis: tuple[float, float, float]
    targets: Array = field(repr=False)
    lead: tuple[int, ...] | None
    tolerance: float
    """Largest position error, in the unit of the system."""
    requested: float = 0.0
    """The tolerance of angles that was requested [rad]; that of positions may be rounding."""
    watch: Watch | None = field(default=None, repr=False, compare=False)
    """What ends the work early; None where nothing does."""
    numbers: np.ndarray | None = field(default=None, repr=False, compare=False)
    """Numbers of the targets in the problem that these were taken from; None where it is this
    one."""

    def check_time(self, which: Any) -> bool:
        """Return whether the time is up, and record this for the targets `which`.

        They are given by a number, a slice, or an array of numbers.
        """
        if self.watch is None or not self.watch.is_over:
            return False
        self.watch.late[which if self.numbers is None else self.numbers[which]] = True
        return True

    def of(self, which: np.ndarray, lead: tuple[int, ...] | None) -> ChainProblem:
        """Return the same problem for the targets `which` (m,) alone."""
        numbers = which if self.numbers is None else self.numbers[which]
        return replace(self, targets=self.targets[which], lead=lead, numbers=numbers)

    @property
    def angular(self) -> float:
        """Tolerance of angles [rad], which does not grow with the rounding of positions."""
        rounding = self.tolerance * float(METRES[self.system.unit])
        return max(self.requested, min(rounding, ANGULAR))


def read_solution_tolerance(tolerance: Any) -> float:
    """Read the tolerance of a solution.

    Errors: `InputError`.
    """
    number: Any = tolerance
    if isinstance(tolerance, (int, float, np.number)) and 0.0 < number < math.inf:
        return float(number)
    raise InputError(
        f"tolerance is {tolerance!r}; it must be a positive number, in metres and radians"
    )


def read_fixed_values(fixed: Any) -> Mapping[str, Any]:
    """Read values of held joints by name, unchecked; empty for None.

    Errors: `InputError` for what is no mapping.
    """
    names: Any = fixed
    if fixed is not None and not isinstance(fixed, Mapping):
        raise InputError(
            f"fixed is {format_value(fixed)}; it must be a dict of values by joint name"
        )
    return names or {}


def read_held_joints(frame: str, names: tuple[str, ...], fixed: object) -> dict[str, Array]:
    """Read the values of held joints of the chain, by name.

    Errors: `InputError`, `UnknownNameError`.
    """
    out: dict[str, Array] = {}
    for name, value in read_fixed_values(fixed).items():
        if name not in names:
            raise UnknownNameError("joint", str(name), names, f"the chain of {frame!r}")
        out[name] = read_reals(
            value, f"the value of {name!r}, which is held,", "a number, or one for each target"
        )
    return out


def read_near_configurations(
    system: Model, near: Any, lead: tuple[int, ...] | None
) -> Array | None:
    """Read configurations (1 or N, nq) near which angles are returned; None for none.

    Errors: `InputError`.
    """
    if near is None:
        return None
    q = read_start(system, near)
    if q.ndim > 1 and q.shape[:-1] != (lead or ()):
        each = f" or {(*lead, system.nq)}" if lead else ""
        raise InputError(f"start has shape {q.shape}; it must be ({system.nq},){each}")
    check_range(q, "start", system.coordinate_names, FARTHEST)
    return q.reshape(math.prod(q.shape[:-1]), system.nq)
