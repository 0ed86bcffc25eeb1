"""One-sided constraints at a configuration: which are closed, how far others are open, what is
still allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.mobility.cone import Cone, ConeDirections, tangent_cone
from kempe.calls import explained, explained_methods
from kempe.errors import InputError
from kempe.kinematics.closure_rows import evaluate, full
from kempe.kinematics.common.result import Report
from kempe.kinematics.configuration import as_q
from kempe.kinematics.forward import jacobian
from kempe.kinematics.one_sided import CLOSED, OneSided, one_sided_rows
from kempe.kinematics.velocity.velocity import rates, velocity_rows
from kempe.spatial import Array
from kempe.words import InWords, counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System


BLIND = "its gradient vanishes or is not defined here: nothing is known to first order"
"""What is said of a row that does not tell what it allows."""


@dataclass(frozen=True)
class Side(InWords):
    """One end of a one-sided row: `value` must not be below `bound`, or with `upper` not above it,
    in `unit`.

    `slack` is how far it is inside, negative where it is violated. `state` is "open", "closed" or
    "violated", `ways` what a closed one still lets its value do, to first order.
    """

    name: str
    value: float
    bound: float
    unit: str
    upper: bool
    limit: bool
    """Whether it is a limit of a coordinate."""
    slack: float
    state: str
    ways: ConeDirections
    why: str = ""
    """Why it can do neither though it is one-sided, or why nothing is known."""

    def __str__(self) -> str:
        amount = f"{abs(self.slack):.6g} {self.unit}".removesuffix(" 1")
        if self.state == "open":
            return f"{self.name}: open by {amount}"
        if self.state == "violated":
            return f"{self.name}: violated by {amount}"
        return f"{self.name}: closed, {self.ways}" + (f" ({self.why})" if self.why else "")


@explained_methods
@dataclass(frozen=True, eq=False)
class OneSidedReport(Report):
    """One-sided constraints of a system at `q` (nq,), limits of coordinates among them; ``print``
    it.

    `sides` are all of them, `cone` the velocities that equations, those of rolling among them, and
    closed sides leave, to first order. Sides that are open take nothing away.
    """

    system: System = field(repr=False)
    q: Array
    sides: tuple[Side, ...]
    cone: Cone = field(repr=False)
    scale: Array = field(repr=False)
    """Radians or metres (nv,) in one unit of each velocity of the cone."""

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the sides that are closed."""
        return tuple(s.name for s in self.sides if s.state == "closed")

    @property
    def violated(self) -> tuple[str, ...]:
        """Names of the sides that do not hold."""
        return tuple(s.name for s in self.sides if s.state == "violated")

    @property
    def dimension(self) -> int:
        """Dimension of the cone of allowed velocities."""
        return self.cone.dimension

    @property
    def lineality(self) -> int:
        """How many of these dimensions may be gone both ways."""
        return self.cone.lineality

    @property
    def coordinates(self) -> dict[str, ConeDirections]:
        """What each coordinate may do, to first order: whether it may fall, and rise."""
        each = np.eye(self.system.nv)
        return {
            n: self.cone.ways(row)
            for n, row in zip(self.system.structure.velocity_names, each, strict=True)
        }

    def frame(self, frame: FrameLike) -> dict[str, ConeDirections]:
        """What the origin of a frame may do along the axes of the ground, and its turns about them,
        to first order.
        """
        J = jacobian(self.system, self.q, frame) * self.scale
        large = np.abs(J).max(axis=1, initial=0.0)
        J = np.where((large > 1e-9 * large.max(initial=1e-300))[:, None], J, 0.0)
        names = ("x", "y", "z", "rx", "ry", "rz")
        return {n: self.cone.ways(row) for n, row in zip(names, J, strict=True)}

    @property
    def status(self) -> str:
        """The result in one sentence."""
        bad = (s for s in self.sides if s.state == "violated")
        if which := ", ".join(
            f"{s.name} by {abs(s.slack):.6g} {s.unit}".removesuffix(" 1") for s in bad
        ):
            return f"violated: {which}"
        declared = [s for s in self.sides if not s.limit]
        touching = sum(s.state == "closed" for s in declared)
        reached = len(self.active) - touching
        parts: list[str] = []
        if declared:
            verb = "are" if touching > 1 else "is"
            parts.append(
                f"{touching or 'none'} of {counted(len(declared), 'one-sided constraint')} {verb} "
                "closed"
            )
        if reached:
            parts.append(f"{counted(reached, 'limit')} {'is' if reached == 1 else 'are'} reached")
        text = " and ".join(parts) or "no limit is reached"
        return text + (f": {self._left()}" if self.active else "")

    def _left(self) -> str:
        """What closed sides leave, in words."""
        if self.dimension == 0:
            return "nothing can move"
        one_way = self.dimension - self.lineality
        how = (
            f"{self.lineality} both ways and {one_way} one way only" if one_way else "all both ways"
        )
        return f"what may move has {counted(self.dimension, 'dimension')}, {how}"

    def _data(self) -> dict[str, Any]:
        return {
            "sentence": self.sentence,
            "active": list(self.active),
            "violated": list(self.violated),
            "dimension": self.dimension,
            "lineality": self.lineality,
            "exact": self.cone.exact,
            "sides": [
                {
                    "name": s.name,
                    "state": s.state,
                    "value": s.value,
                    "bound": s.bound,
                    "unit": s.unit,
                    "slack": s.slack,
                    "allowed": str(s.ways),
                    "why": s.why,
                }
                for s in self.sides
            ],
        }

    @property
    def lines(self) -> list[str]:
        """What is said of each side but limits that are open; those that are violated and closed
        come first.
        """
        order = {"violated": 0, "closed": 1, "open": 2}
        shown = [s for s in self.sides if s.state != "open" or not s.limit]
        out = [str(s) for s in sorted(shown, key=lambda s: order[s.state])]
        if self.active and not self.cone.exact:
            out.append("to first order: closed sides that depend on each other may allow less")
        return out

    def _headline(self) -> str:
        return f"{self.system.name}: {self.status}"

    def _notes(self) -> list[str]:
        return self.lines


@explained
def one_sided(system: System, q: Any = None, *, tolerance: float = CLOSED) -> OneSidedReport:
    """What one-sided constraints leave at a configuration: which are closed, by how much others are
    open.

    `q` (nq,) or a dict by coordinate name (default: as for `mobility`) should close all loops.
    Sides within `tolerance` of their bound, in radians and characteristic lengths, count as closed.
    Limits of coordinates are among them. Errors: `InputError`.
    """
    from kempe.analysis.first_order.generic_configurations import find_closed

    at = as_q(system, q) if q is not None else find_closed(system).q
    if at.ndim != 1:
        raise InputError(
            f"q has shape {at.shape}; one-sided constraints are looked at in one configuration"
        )
    rows = one_sided_rows(system)
    values, J = rows.rates(at)
    found, G = _sides(rows, values, J, tolerance)
    E, still = _equations(system, at)
    cone = tangent_cone(E, G)
    cone = cone if still else replace(cone, exact=False)
    states = [s.state for s in found]
    closed = [k for k, state in enumerate(states) if state == "closed"]
    sides = list(found)
    for place, k in enumerate(closed):
        sides[k] = _with_ways(found[k], place, cone, G[place], [found[j].name for j in closed])
    return OneSidedReport(system, at, tuple(sides), cone, full(system, True).scale)


def if_any(system: System, q: Array) -> OneSidedReport | None:
    """The report at a configuration (nq,), None where nothing is declared and no limit is reached."""
    rows = one_sided_rows(system)
    if not rows.declared:
        if not len(rows):
            return None
        x = q[rows.at]
        (low, high) = rows.well_inside
        if ((x > low) & (x < high)).all():
            return None
    return one_sided(system, q)


def _sides(rows: OneSided, values: Array, J: Array, tolerance: float) -> tuple[list[Side], Array]:
    """All sides, and the inward gradients (k, nv) of those that are closed."""
    out: list[Side] = []
    G: list[Any] = []
    for k in range(len(rows)):
        scale = rows.scale[k]
        unit = rows.units[k]
        for upper, bound in ((False, rows.low[k]), (True, rows.high[k])):
            if not np.isfinite(bound):
                continue
            slack = float(bound - values[k] if upper else values[k] - bound)
            state = (
                "open"
                if slack * scale > tolerance
                else "closed"
                if slack * scale >= -tolerance
                else "violated"
            )
            both = ConeDirections(True, True)
            out.append(
                Side(
                    rows.side(k, upper),
                    float(values[k]),
                    float(bound),
                    unit,
                    upper,
                    k >= rows.declared,
                    slack,
                    state,
                    both,
                )
            )
            if state == "closed":
                G.append(-J[k] if upper else J[k])
    return out, np.array(G).reshape(len(G), rows.system.nv)


def _with_ways(side: Side, place: int, cone: Cone, inward: Array, names: list[str]) -> Side:
    """A closed side with what it still allows."""
    if place in cone.vanishing:
        return replace(side, ways=ConeDirections(True, True), why=BLIND)
    if place in cone.implied:
        return replace(side, ways=ConeDirections(False, False), why="the equations keep it closed")
    ways = cone.ways(-inward if side.upper else inward)
    if place in cone.implicit:
        others = ", ".join(names[i] for i in cone.implicit if i != place)
        return replace(side, ways=ConeDirections(False, False), why=f"held by {others}")
    if place in cone.redundant:
        return replace(side, ways=ways, why="it follows from the others that are closed")
    return replace(side, ways=ways)


def _equations(system: System, q: Array) -> tuple[Array, bool]:
    """The rows (m, nv) of loops and declared constraints on scaled velocities, and whether rest is
    one of them.

    Where it is not, what they allow are differences of velocities.
    """
    J = evaluate(system, q, True, True)[1]
    (A, b) = rates(system, q)
    loops = full(system, True)
    names = velocity_rows(system).names
    lengths = np.where([name.unit.startswith("m") for name in names], 1.0 / loops.length, 1.0)
    return np.concatenate([J, lengths[:, None] * A * loops.scale]), not b.any()
