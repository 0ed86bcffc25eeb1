"""One step of `ik_step` that brings no two bodies nearer to one another than they must be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.base import KINDS, Constraint
from kempe.constraints.clearances import Apart
from kempe.forward.fk import fk
from kempe.geometry.clearance import Watch, watch_clearances
from kempe.geometry.solids import Gap
from kempe.inverse.tasks.keep_clear import BAND, MARGIN, lay_planes
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.ik_step import IkStep
    from kempe.model.model import Model

PARTS = (1.0, 0.5, 0.25, 0.125)
"""Parts of a step that are tried before there is none."""
SAME = 1e-9
"""By how much a distance may shrink that is too small already: rounding, in metres."""

TakeStep = Callable[[Sequence[Constraint]], "IkStep"]


def make_clear_step(
    system: Model, q: Array, wanted: Sequence[Any], dt: float, take_step: TakeStep
) -> IkStep:
    """Make a step for tasks, among them clearances, by what takes a step for other tasks.

    Planes between near shapes stand beside the first tasks. The distances after the step are measured: a
    step that leads too near is shortened.
    """
    watch = watch_clearances(system, [t for t in wanted if isinstance(t, Apart)])
    tasks = [t for t in wanted if not isinstance(t, Apart)]
    if not tasks:
        posture: Any = KINDS["posture"]
        tasks = [posture(q)]
    length = compute_characteristic_length(system)
    before = watch.list_gaps(fk(system, q, watch.solids.names), BAND * length)
    priority = min(int(t.priority) for t in tasks)
    planes = lay_planes(system, watch, q[None], [before], priority)
    step = take_step([*(_flatten_plane(p) for p in planes), *tasks])
    least = dict.fromkeys(range(len(watch.couples)), np.inf) | {
        g.couple: g.distance for g in before
    }
    for part in PARTS:
        there = (
            step.q
            if part == 1.0
            else system.structure.layout.integrate_velocity(q, part * dt * step.velocity)
        )
        if part < 1.0 and system.structure.closures:
            break
        after = watch.list_gaps(fk(system, there, watch.solids.names), 2.0 * MARGIN * length)
        if all(_is_allowed(watch, gap, least[gap.couple]) for gap in after):
            held = tuple(dict.fromkeys(watch.name_bodies(gap.couple) for gap in after))
            if part == 1.0:
                return replace(step, held_apart=held)
            return _shorten(step, there, part, held)
    held = tuple(dict.fromkeys(watch.name_bodies(gap.couple) for gap in before))
    return _shorten(step, q.copy(), 0.0, held)


def _is_allowed(watch: Watch, gap: Gap, before: float) -> bool:
    """Whether two shapes keep their distance after the step, or are no nearer than before it."""
    return gap.distance >= min(float(watch.at_least[gap.couple]), before - SAME)


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


def _flatten_plane(plane: Any) -> Constraint:
    """Return the plane of the only configuration of a batch, without the leading axis."""
    names = ("origin", "normal", "px", "py", "pz")
    return replace(plane, **{name: np.asarray(getattr(plane, name))[0] for name in names})
