"""One step of `ik_step` that brings no two bodies nearer to one another than they must be.

Distances of near bodies change by their derivatives, to first order: these are the first rows of a
step, before all tasks. What a step leaves of the distances is measured. Where curvature takes too
much, the step is made again with that much more asked of it (a correction of second order; Fletcher,
1982), else shortened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.base import KINDS, Constraint
from kempe.constraints.clearances import Apart
from kempe.forward.fk import fk
from kempe.geometry.clearance import compute_gap_gradients, watch_clearances
from kempe.geometry.solids import Gap
from kempe.inverse.constrained_step import NearRows
from kempe.inverse.tasks.keep_clear import BAND, FLAT, MARGIN
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.model import store_answer
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.ik_step import IkStep
    from kempe.model.model import Model

CORRECTIONS = 3
"""How often a step is made again with more asked of its distances."""
PARTS = (0.5, 0.25, 0.125)
"""Parts of a step that are tried before there is none."""
KEPT = 64
"""Sets of clearances whose last gaps a system keeps."""
SAME = 1e-9
"""By how much a distance may shrink that is too small already: rounding, in metres."""

TakeStep = Callable[[Sequence[Constraint], NearRows | None], "IkStep"]


def make_clear_step(
    system: Model, q: Array, wanted: Sequence[Any], dt: float, take_step: TakeStep
) -> IkStep:
    """Make a step for tasks, among them clearances, by what takes a step for other tasks."""
    tasks = [t for t in wanted if not isinstance(t, Apart)]
    if not tasks:
        posture: Any = KINDS["posture"]
        tasks = [posture(q)]
    near = NearBodies(system, q, [t for t in wanted if isinstance(t, Apart)])
    for _ in range(CORRECTIONS + 1):
        step = take_step(tasks, near.make_rows())
        after = near.measure_gaps(step.q)
        excess = near.list_violations(after)
        if not excess:
            return replace(step, held_apart=near.list_held(after))
        near.ask_for_more(excess)
    for part in PARTS if not system.structure.closures else ():
        there = system.structure.layout.integrate_velocity(q, part * dt * step.velocity)
        after = near.measure_gaps(there)
        if not near.list_violations(after):
            return _shorten(step, there, part, near.list_held(after))
    return _shorten(step, q.copy(), 0.0, near.list_held(near.gaps.values(), BAND * near.length))


class NearBodies:
    """Pairs of shapes that are near one another at q (nq,), where a step begins."""

    def __init__(self, system: Model, q: Array, clearances: Sequence[Apart]):
        self.system = system
        self.q = q
        self.watch = watch_clearances(system, clearances)
        self.length = compute_characteristic_length(system)
        self.margin = MARGIN * self.length
        self._measured = system._kept.setdefault(NearBodies, {})
        self._key = tuple([(c.sides, c.at_least) for c in clearances])
        kept = self._measured.get(self._key)
        known = kept is not None and kept[0] == q.tobytes()
        self.gaps = {g.couple: g for g in (kept[1] if known else self.measure_gaps(q))}
        self._more = dict.fromkeys(self.gaps, 0.0)

    def measure_gaps(self, q: Array) -> list[Gap]:
        """Measure the gaps at q (nq,), and keep them for a step that begins there."""
        found = self.watch.list_gaps(
            fk(self.system, q, self.watch.solids.names), BAND * self.length
        )
        store_answer(self._measured, self._key, (q.tobytes(), found), KEPT)
        return found

    def make_rows(self) -> NearRows | None:
        """Make the rows that keep shapes apart; None where none are near."""
        gaps = [g for g in self.gaps.values() if np.isfinite(g.normal).all()]
        if not gaps:
            return None
        rates = compute_gap_gradients(self.system, self.watch, self.q, gaps)
        room = np.array([g.distance - self.watch.at_least[g.couple] for g in gaps])
        least = np.where(room < 0.0, self.margin - room, np.minimum(self.margin - room, 0.0))
        least += [self._more[g.couple] for g in gaps]
        turning = self.system.structure.coordinates.angular
        size = np.abs(rates * np.where(turning, 1.0 / self.length, 1.0)).max(axis=1)
        least = np.where(size > FLAT, least, np.minimum(least, 0.0))
        return NearRows(self.q, rates / self.length, least / self.length)

    def list_violations(self, after: Sequence[Gap]) -> dict[int, float]:
        """List by how much gaps after a step are too small: nearer than asked, and than before."""
        out: dict[int, float] = {}
        for gap in after:
            begun = self.gaps.get(gap.couple)
            least = float(self.watch.at_least[gap.couple])
            if begun is not None:
                least = min(least, begun.distance - SAME)
            if gap.distance < least:
                out[gap.couple] = least - gap.distance
        return out

    def ask_for_more(self, excess: dict[int, float]) -> None:
        """Ask gaps to grow by what a step left too small."""
        if not excess.keys() <= self.gaps.keys():
            X = fk(self.system, self.q, self.watch.solids.names)
            every = self.watch.list_gaps(X, np.inf)
            self.gaps |= {g.couple: g for g in every if g.couple in excess}
        for couple, size in excess.items():
            self._more[couple] = self._more.get(couple, 0.0) + size + self.margin

    def list_held(
        self, gaps: Iterable[Gap], band: float | None = None
    ) -> tuple[tuple[str, str], ...]:
        """List the bodies, by name, whose gaps are less than `band` larger than asked."""
        band = 2.0 * self.margin if band is None else band
        return tuple(
            dict.fromkeys(
                self.watch.name_bodies(g.couple)
                for g in gaps
                if g.distance < self.watch.at_least[g.couple] + band
            )
        )


def _shorten(step: IkStep, q: Array, part: float, held: tuple[tuple[str, str], ...]) -> IkStep:
    """Return a part of a step, which leads to q."""
    return replace(
        step,
        q=q,
        velocity=part * step.velocity,
        twist=part * step.twist,
        fraction=part * step.fraction,
        saturated=(),
        default_speed=(),
        held_apart=held,
    )
