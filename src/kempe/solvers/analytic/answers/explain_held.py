"""What is said of joints that a redundant chain has to spare: which are held, where, and why there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.solvers.analytic.answers.nearest import fixed_joints, held_coordinates
from kempe.solvers.analytic.plans.plan import ChainPlan, free_lines
from kempe.solvers.one_frame.multi_start import MOST
from kempe.words import in_words

if TYPE_CHECKING:
    from kempe.solvers.analytic.answers.solutions import Solutions


def held_sentence(solutions: Solutions) -> str:
    """Which joints a redundant chain has to spare, and where they are held for the targets; '' for other chains."""
    if not solutions.spare:
        return ""
    parts = []
    for name in solutions.spare:
        values = np.ravel(solutions.held[name])[solutions._used.any(axis=1)]
        if not len(values):
            continue
        place, count = np.unique(values, return_counts=True)
        usual = float(place[np.argmax(count)])
        text = f"{name!r} at {number(usual)}"
        if len(place) > 1 and count.max() > 1:
            text += f" for {count.max()} of {len(values)} targets, else"
        if len(place) > 1:
            text = text if count.max() > 1 else f"{name!r}"
            text += f" at values from {number(place[0])} to {number(place[-1])}"
        parts.append(text)
    text = f"the chain has {in_words(len(solutions.spare), 'joint')} to spare"
    return f"{text}, held: {', '.join(parts)}" if parts else text


def tried_sentence(solutions: Solutions, index: int, spare: list[int]) -> str:
    """At which values of the spare joints there is none: evidence, no proof."""
    tried, names = int(np.ravel(solutions.tried)[index]), solutions.plan.lines.names
    if tried == 1:
        return f" with {held_at(solutions, index, spare)}, and none from {MOST} starts of a search"
    joints = ", ".join(repr(names[i]) for i in spare)
    return f" with {joints} at any of {tried} values tried, and none from {MOST} starts of a search"


def spare_joints(plan: ChainPlan) -> list[int]:
    """Joints that are locked only because the chain has more than the task needs."""
    return [i for i in plan.locked if i not in fixed_joints(plan)]


def more_than_enough(plan: ChainPlan) -> bool:
    """Whether the chain has more joints than the task has equations: else freedoms to spare come from its lengths."""
    free = free_lines(plan.lines, plan.task, plan.planar)
    return len(plan.lines) - len(fixed_joints(plan)) + len(free.kinds) > (3 if plan.planar else 6)


def held_at(solutions: Solutions, index: int, joints: list[int]) -> str:
    """The joints with the values at which they are held for target number `index`."""
    q, names = held_coordinates(solutions, index), solutions.plan.lines.names
    return ", ".join(f"{names[i]!r} at {number(q[i])}" for i in joints)


def moved_sentence(solutions: Solutions, index: int, inside: int) -> str:
    """Why the spare joints are not where they were held first, or that other values were tried."""
    first, tried = solutions._first, int(np.ravel(solutions.tried)[index])
    if tried == 1 or first is None:
        return ""
    spare, now = spare_joints(solutions.plan), held_coordinates(solutions, index)
    before = first[index if len(first) > 1 else 0]
    if np.array_equal(now[spare], before[spare]):
        return f" ({tried} values were tried)"
    there = ", ".join(number(x) for x in before[spare])
    return f" (at {there} there is none{' inside the limits' if inside else ''})"


def number(x: float) -> str:
    """Six digits of a number, rounding at zero taken away."""
    return f"{0.0 if abs(x) < 1e-9 else x:.6g}"
