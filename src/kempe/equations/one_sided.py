"""One-sided rows of a system, low <= f(q) <= high, as values and rates.

They are declared inequalities and limits of coordinates.

They are read before their bounds: whether a row is active, and how far it is from its bound, is for
others to say.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.equations.closure_rows import pack_full_loops
from kempe.kernels.compiled import closure_batch
from kempe.model.configurations import read_q
from kempe.model.model import keep_answers
from kempe.model.packed_loops import PackedLoops, get_packed_loops
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

CLOSED = 1e-6
"""Slack in radians, or as a part of the characteristic length, up to which a row counts as
closed."""
ROUNDING = 1e-9
"""By how much more than a bound, of 1 or less, a value may be and still respect it."""


class Violation(NamedTuple):
    """A violated inequality: its `name`, and how far the value is outside the bounds.

    `far` is in `unit`, `size` in characteristic lengths.
    """

    name: str
    far: float
    unit: str
    size: float

    @property
    def amount(self) -> str:
        """Size of the violation, with the unit, as text."""
        return f"{self.far:.6g} {self.unit}".removesuffix(" 1")

    @property
    def text(self) -> str:
        """Name of the violated row and size of the violation, as text."""
        return f"{self.name!r} by {self.amount}"


@dataclass(frozen=True, eq=False)
class OneSided:
    """One-sided rows of a system: the `declared` inequalities, then the limited coordinates.

    Row k is called `names[k]`, measured in `units[k]` ("m", "rad" or "1") and holds where its value
    is between `low[k]` and `high[k]`.
    """

    system: Model = field(repr=False)
    names: tuple[str, ...]
    units: tuple[str, ...]
    low: Array
    high: Array
    declared: int
    loops: PackedLoops | None = field(repr=False)
    chosen: np.ndarray = field(repr=False)
    """Which equations of `loops` are rows."""
    at: np.ndarray = field(repr=False)
    """Places in q of the coordinates that are rows."""
    moved: np.ndarray = field(repr=False)
    """Their velocities."""

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def scale(self) -> Array:
        """Factors (k,) that make rows comparable: 1 / characteristic length for metres, else 1."""
        return np.where(
            np.array(self.units) == "m", 1.0 / pack_full_loops(self.system, True).length, 1.0
        )

    @cached_property
    def inner_bounds(self) -> tuple[Array, Array]:
        """Bounds (low, high) of the rows, each moved inwards by `CLOSED`."""
        return self.low + CLOSED / self.scale, self.high - CLOSED / self.scale

    @cached_property
    def slack(self) -> Array:
        """Rounding error (k,) by which the value of each row may be outside its bounds."""
        bounds = np.where(np.isfinite([self.low, self.high]), np.abs([self.low, self.high]), 0.0)
        return ROUNDING * (1.0 + bounds.max(axis=0, initial=0.0))

    def compute_values(self, q: Any, declared: bool = False) -> Array:
        """Compute the values (..., k) of the rows at q (..., nq), in their units.

        With `declared`, only the declared inequalities.
        """
        return self._evaluate_rows(q, False, declared)[0]

    def compute_rates(self, q: Any, declared: bool = False) -> tuple[Array, Array]:
        """Compute scaled rates (..., k, nv) of the rows, and their values (..., k), at q (..., nq).

        The rates are derivatives of the scaled values by the scaled velocities.
        """
        return self._evaluate_rows(q, True, declared)

    def compute_excess(self, q: Any, declared: bool = False) -> Array:
        """Compute how far (..., k) rows are outside their bounds at q (..., nq), in their units.

        It is 0 where they hold.

        Only those that are `declared`, if so requested.
        """
        k = self.declared if declared else len(self)
        x = self._evaluate_rows(q, False, declared)[0]
        out = np.maximum(np.maximum(self.low[:k] - x, x - self.high[:k]), 0.0)
        return np.where(out <= self.slack[:k], 0.0, out)

    def find_violated_rows(self, q: Array, allowed: Array) -> tuple[Array, Array]:
        """Find the declared inequalities violated at q (nq,): excess (m,) and rates (m, nv).

        Only violations by more than `allowed` count.

        Both as `rates` has them, positive above an upper end.
        """
        k = self.declared
        x, J = self.compute_rates(q, declared=True)
        off = np.minimum(x - self.low[:k] + allowed, 0.0) + np.maximum(
            x - self.high[:k] - allowed, 0.0
        )
        out = np.flatnonzero(off)
        return (self.scale[:k] * off)[out], J[out]

    def list_violations(self, q: Array) -> list[Violation]:
        """List the violations of declared inequalities at q (nq,)."""
        far = self.compute_excess(q, declared=True)
        return [
            Violation(self.names[k], float(far[k]), self.units[k], float(far[k] * self.scale[k]))
            for k in np.flatnonzero(far)
        ]

    def list_violated_names(self, q: Array) -> list[str]:
        """List the names of the rows, limits among them, that are violated at q (nq,)."""
        far = self.compute_excess(q)
        return [name for name, x in zip(self.names, far.tolist(), strict=True) if x]

    def describe_omitted_configurations(self, beyond: np.ndarray) -> str:
        """Describe how many configurations were omitted since they violate rows, by how much.

        `beyond` (n, k) is the excess of each row at each configuration.
        """
        count = int(beyond.any(axis=1).sum())
        which = ", ".join(repr(self.names[k]) for k in np.flatnonzero(beyond.any(axis=0)))
        those = (
            "1 is left out that violates" if count == 1 else f"{count} are left out that violate"
        )
        return f"; {those} {which}" if count else ""

    def _evaluate_rows(self, q: Any, rates: bool, declared: bool = False) -> tuple[Array, Array]:
        """Compute the values (..., k) of the rows at q (..., nq), and rates (..., k, nv)."""
        q = read_q(self.system, q)
        nv = self.system.nv
        lead = q.shape[:-1]
        n = self.declared
        k = self.declared if declared else len(self)
        flat = q.reshape(math.prod(lead), self.system.nq)
        values = np.empty((len(flat), k))
        J = np.zeros((len(flat) if rates else 0, k, nv))
        if self.loops is not None:
            loops = self.loops
            m = len(self.loops.names)
            out = np.empty((len(flat), m))
            columns = np.empty((len(J), m, nv))
            none = np.zeros((1, 0))
            packed = loops.ints, loops.floats, loops.plan, loops.weights
            closure_batch.evaluate_equations(*packed, none, flat, rates, out, columns)
            values[:, :n] = out[:, self.chosen] / self.scale[:n]
            J[:, :n] = columns[:, self.chosen]
        if not declared:
            values[:, n:] = flat[:, self.at]
            if rates:
                J[:, np.arange(n, k), self.moved] = 1.0
        return values.reshape(*lead, k), J.reshape(*lead, k, nv) if rates else J

    def format_bound_name(self, k: int, upper: bool) -> str:
        """Format the name of the lower or `upper` bound of row k for messages."""
        end = "upper" if upper else "lower"
        if k >= self.declared:
            return f"{end} limit of {self.names[k]}"
        both = np.isfinite(self.low[k]) and np.isfinite(self.high[k])
        return f"{self.names[k]}, {end} end" if both else self.names[k]


@keep_answers
def pack_one_sided_rows(system: Model) -> OneSided:
    """Pack the one-sided rows of a system; the result is kept."""
    at = system.structure.layout.vector_q
    v = system.structure.layout.vector_v
    limited = np.isfinite(system.lower[v]) | np.isfinite(system.upper[v])
    at = at[limited]
    v = v[limited]
    names, units, bounds, chosen, loops = (
        _list_declared_rows(system) if system._mechanism.constraints else ([], [], [], [], None)
    )
    low, high = np.array(bounds, dtype=float).reshape(-1, 2).T
    names += [system.structure.velocity_names[i] for i in v]
    units += ["rad" if system.structure.coordinates.turning[i] else "m" for i in v]
    return OneSided(
        system,
        tuple(names),
        tuple(units),
        np.append(low, system.lower[v]),
        np.append(high, system.upper[v]),
        len(bounds),
        loops if bounds else None,
        np.array(chosen, dtype=np.int64),
        at,
        v,
    )


def _list_declared_rows(
    system: Model,
) -> tuple[list[str], list[str], list[tuple[float, float]], list[int], PackedLoops]:
    """List names, units, bounds and places of the declared inequalities, and their ties."""
    loops = get_packed_loops(system, frozenset(system.structure.closures), one_sided=True)
    several = Counter(t.name for t in loops.ties if t.bounds for _ in t.row_names)
    at = 0
    every = loops.units
    names: list[str] = []
    units: list[str] = []
    bounds: list[tuple[float, float]] = []
    chosen: list[int] = []
    for tie in loops.ties:
        for i, row in enumerate(tie.row_names if tie.bounds else ()):
            names.append(tie.name if several[tie.name] == 1 else f"{tie.name} {row}")
            units.append(every[at + i])
            bounds.append(tie.bounds[i])
            chosen.append(at + i)
        at += len(tie.row_names)
    return names, units, bounds, chosen, loops
