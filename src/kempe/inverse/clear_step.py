"""One step of `ik_step` that brings no two bodies nearer to one another than they must be.

Distances of near bodies change by their derivatives, to first order: these are the first rows of a
step, before all tasks. What a step leaves of the distances is measured. Where curvature takes too
much, the smallest velocities that give it back are added (a correction of second order; Fletcher,
1982). Where that does not do, the step is shortened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.base import KINDS, Constraint, freeze_fields
from kempe.constraints.clearances import Apart
from kempe.forward.fk import fk
from kempe.geometry.clearance import compute_gap_gradients, watch_clearances
from kempe.geometry.solids import Gap
from kempe.inverse.constrained_step import NearRows, find_steady_fraction, make_constrained_steps
from kempe.inverse.tasks.keep_clear import BAND, FLAT, MARGIN
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.model import store_answer
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.ik_step import IkStep
    from kempe.model.model import Model

CORRECTIONS = 3
"""How often velocities are added that give distances back, less one."""
PARTS = (0.5, 0.25, 0.125)
"""Parts of a step that are tried before there is none."""
KEPT = 64
"""Sets of clearances whose last gaps, and next steps, a system keeps."""
SAME = 1e-9
"""By how much a distance may shrink that is too small already: rounding, in metres."""

TakeStep = Callable[[Array, Sequence[Constraint], NearRows | None], "IkStep"]
"""Makes a step from a configuration (nq,) for tasks and rows of near bodies."""


def make_clear_step(
    system: Model,
    q: Array,
    wanted: Sequence[Any],
    dt: float,
    case: tuple[Any, ...],
    fastest: Array,
    take_step: TakeStep,
) -> IkStep:
    """Make a step for tasks, among them clearances, by what takes a step for other tasks.

    `case` holds what the step depends on beside q and the tasks, and `fastest` the largest speeds
    (nv,). Beside a held body the curvature of its distance can turn steps back and forth: a joint
    that would turn back at once makes a shorter step, as without clearances. The step that follows
    is kept, for it is most often asked for next.
    """
    clearances = [t for t in wanted if isinstance(t, Apart)]
    tasks = [t for t in wanted if not isinstance(t, Apart)]
    if not tasks:
        posture: Any = KINDS["posture"]
        tasks = [posture(q)]
    content = [freeze_fields(t) for t in tasks]
    upcoming: dict[Any, tuple[Any, tuple[IkStep, bool]]]
    upcoming = system._kept.setdefault(make_clear_step, {})
    key = tuple([(c.sides, c.at_least) for c in clearances])
    asked = (case, content) if all([c.comparable for c in content]) else None

    def take_whole_step(x: Array) -> tuple[IkStep, bool]:
        kept = upcoming.get(key)
        if kept is not None and asked is not None and kept[0] == (asked, x.tobytes()):
            return kept[1]
        near = NearBodies(system, x, clearances)
        step = near.keep_apart(take_step(x, tasks, near.make_rows()), dt, fastest)
        return step, near.is_holding or bool(step.held_apart)

    def compute_velocity_after(part: float) -> Array:
        there = step.q
        if part < 1.0:
            there = follow_velocity(system, q, part * step.velocity, dt, fastest)[0]
        found = take_whole_step(there)
        store_answer(upcoming, key, ((asked, there.tobytes()), found), KEPT)
        return found[0].velocity

    step, held = take_whole_step(q)
    if held:
        part = find_steady_fraction(compute_velocity_after, step.velocity, fastest)
        if part < 1.0:
            near = NearBodies(system, q, clearances)
            return near.find_clear_part(step, dt, fastest, (part,))
    return step


class NearBodies:
    """Pairs of shapes that are near one another at q (nq,), where a step begins."""

    def __init__(self, system: Model, q: Array, clearances: Sequence[Apart]):
        self.system = system
        self.q = q
        self.watch = watch_clearances(system, clearances)
        self.length = compute_characteristic_length(system)
        self.margin = MARGIN * self.length
        self._measured: dict[Any, tuple[bytes, list[Gap]]]
        self._measured = system._kept.setdefault(NearBodies, {})
        self._key = tuple([(c.sides, c.at_least) for c in clearances])
        kept = self._measured.get(self._key)
        known = kept[1] if kept is not None and kept[0] == q.tobytes() else self.measure_gaps(q)
        self.gaps: dict[int, Gap] = {g.couple: g for g in known}

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
        turning = self.system.structure.coordinates.angular
        size = np.abs(rates * np.where(turning, 1.0 / self.length, 1.0)).max(axis=1)
        least = np.where(size > FLAT, least, np.minimum(least, 0.0))
        return NearRows(self.q, rates / self.length, least / self.length)

    @property
    def is_holding(self) -> bool:
        """Whether a gap is as small as it may be."""
        return bool(self.list_held(self.gaps.values()))

    def keep_apart(self, step: IkStep, dt: float, fastest: Array) -> IkStep:
        """Correct a step that leaves gaps too small, else shorten it; name the bodies it holds."""
        corrected = step
        for _ in range(CORRECTIONS):
            after = self.measure_gaps(corrected.q)
            excess = self.list_violations(after)
            if not excess:
                return replace(corrected, held_apart=self.list_held(after))
            close = [g.couple for g in after if self._is_held(g)]
            want = dict.fromkeys(close, 0.0) | {c: x + self.margin for c, x in excess.items()}
            velocity = corrected.velocity + self._find_correction(want, dt)
            x, velocity = follow_velocity(self.system, self.q, velocity, dt, fastest)
            corrected = replace(corrected, q=x, velocity=velocity)
        return self.find_clear_part(step, dt, fastest, PARTS)

    def find_clear_part(
        self, step: IkStep, dt: float, fastest: Array, parts: Sequence[float]
    ) -> IkStep:
        """Find the first of some parts of a step that keeps bodies apart, else rest."""
        for part in parts:
            x, velocity = follow_velocity(self.system, self.q, part * step.velocity, dt, fastest)
            after = self.measure_gaps(x)
            if not self.list_violations(after):
                return _shorten(step, x, velocity, part, self.list_held(after))
        held = self.list_held(self.gaps.values(), BAND * self.length)
        return _shorten(step, self.q.copy(), 0.0 * step.velocity, 0.0, held)

    def _find_correction(self, want: dict[int, float], dt: float) -> Array:
        """Find the smallest velocities (nv,) by which gaps grow, by their couples, within dt."""
        if not want.keys() <= self.gaps.keys():
            X = fk(self.system, self.q, self.watch.solids.names)
            every = self.watch.list_gaps(X, np.inf)
            self.gaps |= {g.couple: g for g in every if g.couple in want}
        steps = make_constrained_steps(self.system)
        rates = compute_gap_gradients(
            self.system, self.watch, self.q, [self.gaps[couple] for couple in want]
        )
        free = steps.scale[:, None] * steps.find_free_velocities(self.q, dt).basis
        grow = np.array(list(want.values())) / dt
        return free @ Spectrum(rates @ free).solve_least_squares(grow, Level.CLOSED)

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

    def _is_held(self, gap: Gap, band: float = 0.0) -> bool:
        """Whether a gap is as small as it may be, or less than `band` larger."""
        least = float(self.watch.at_least[gap.couple])
        return gap.distance < least + max(band, 2.0 * self.margin)

    def list_held(self, gaps: Iterable[Gap], band: float = 0.0) -> tuple[tuple[str, str], ...]:
        """List the bodies, by name, that are as near as they may be, or less than `band` further."""
        return tuple(
            dict.fromkeys(self.watch.name_bodies(g.couple) for g in gaps if self._is_held(g, band))
        )


def follow_velocity(
    system: Model, q: Array, velocity: Array, dt: float, fastest: Array
) -> tuple[Array, Array]:
    """Follow velocities (nv,) within limits, loops closed: the configuration (nq,), and velocities,
    perhaps shortened.
    """
    steps = make_constrained_steps(system)
    low, high = steps.compute_velocity_bounds(q, dt, fastest)
    u = np.clip(velocity / steps.scale, low, high)
    after, u = steps.take_step(q, u, dt, low, high)
    return after, u * steps.scale


def _shorten(
    step: IkStep, q: Array, velocity: Array, part: float, held: tuple[tuple[str, str], ...]
) -> IkStep:
    """Return a part of a step, which leads to q."""
    return replace(
        step,
        q=q,
        velocity=velocity,
        twist=part * step.twist,
        fraction=part * step.fraction,
        saturated=(),
        default_speed=(),
        held_apart=held,
    )
