"""Which joints of a redundant chain are held: those without which the rest is solved best, and most
often.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kempe.budget import look
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.forward.table_layout import SLIDE
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.solvers.analytic.plans.plan import (
    ChainPlan,
    Extra,
    carried_lines,
    free_lines,
    freedoms,
    in_closed_form,
    kernel_of,
    make,
    spread,
    targets_at,
)
from kempe.spatial import Array

MOST_CHOICES = 60
ELIMINATED = 12
"""Choices of joints that are looked at for a closed form, and for an elimination where none has a
closed form."""

SAMPLES = 32
STEP = 0.1
"""Random poses that measure how often a choice has a solution, and the difference in that which
counts."""

TOLERANCE = 1e-9

ASIDE = 0.4
"""Angle, or length of the chain, from zero at which joints are held first where at zero axes of the
rest line up."""

NEARLY = 1e-3
"""Sine of an angle, or distance in lengths of the chain, below which an elimination has trouble
with two axes."""


def plan_holding(lines: Lines, task: str, fixed: tuple[int, ...], planar: bool) -> ChainPlan:
    """The plan with as many joints locked, beside those `fixed`, as the chain has too many.

    Best is to hold slides that carry an arm of turns: a rail, a torso. Then what counts is how the
    rest is solved (side by side, in closed form, by elimination), and how many random poses have a
    solution inside the limits with the joints held where they are held first.
    """
    free = free_lines(lines, task, planar)
    unknown = [i for i in range(len(lines)) if i not in fixed]
    rank = freedoms(lines, free, unknown)
    extra = len(unknown) + len(free.kinds) - rank
    if extra <= 0:
        return make(lines, task, fixed, planar)
    best: tuple[tuple[float, ...], ChainPlan] | None = None
    choices = list(_able(lines, task, free, unknown, extra, rank))
    for carried, some in itertools.groupby(
        choices, lambda choice: _carries(lines, unknown, choice)
    ):
        group = [tuple(sorted((*fixed, *choice))) for choice in some]
        plans = [
            p
            for p in (in_closed_form(lines, task, locked, planar) for locked in group)
            if p is not None
        ]
        plans = plans or [
            p
            for p in (make(lines, task, x, planar) for x in group[:ELIMINATED])
            if p.method != "search"
        ]
        for k, bare in enumerate(plans):
            look()
            plan = replace(bare, first=_first(bare, fixed))
            key = (_rank(plan), -round(_share(plan) / STEP), k)
            if best is None or key < best[0]:
                best = key, plan
        if carried and best is not None:
            break
    if best is not None:
        return best[1]
    return make(lines, task, tuple(sorted((*fixed, *choices[0]))) if choices else fixed, planar)


def _able(
    lines: Lines, task: str, free: Extra, unknown: list[int], extra: int, rank: int
) -> Iterator[tuple[int, ...]]:
    """Choices that leave the chain all of its freedoms, those that carry an arm of turns first, the
    last joints first.

    Where the task asks for an orientation alone the first joints come first, since the last are
    those that turn the tip. Of many spare joints, the choices come first that leave joints in a
    row.
    """
    order = unknown if task in ("orientation", "direction") else unknown[::-1]
    count = len(unknown) - extra
    slides = [i for i in order if lines.kinds[i] == SLIDE]
    turns = [i for i in order if lines.kinds[i] != SLIDE]
    rows = (tuple(i for i in order if i not in order[k : k + count]) for k in range(extra + 1))
    more = extra - len(slides)
    carrying = (
        ((*c, *slides) for c in itertools.combinations(turns, more)) if slides and more >= 0 else ()
    )
    seen: set[frozenset[int]] = set()
    every = itertools.chain(
        itertools.islice(carrying, MOST_CHOICES),
        rows if extra > 2 else (),
        itertools.islice(itertools.combinations(order, extra), MOST_CHOICES),
    )
    for choice in every:
        look()
        key = frozenset(choice)
        if key not in seen and freedoms(lines, free, [i for i in unknown if i not in key]) == rank:
            seen.add(key)
            yield choice
        if len(seen) >= MOST_CHOICES:
            return


def _carries(lines: Lines, unknown: list[int], choice: tuple[int, ...]) -> bool:
    """Whether the choice holds all slides of the chain, and leaves an arm of turns."""
    slides = [i for i in unknown if lines.kinds[i] == SLIDE]
    return bool(slides) and set(slides) <= set(choice)


def _rank(plan: ChainPlan) -> float:
    """How a plan is solved, 0 the fastest."""
    if plan.method == "closed":
        return 0.0 if plan.side_by_side else 1.0
    return 2.0


def _first(plan: ChainPlan, fixed: tuple[int, ...]) -> tuple[float, ...]:
    """Coordinates (n,) at which joints are held by choice where nobody says where: zero, inside the
    limits.

    An elimination takes long where axes line up that do not otherwise; there they are held aside of
    zero.
    """
    lines = plan.lines
    n = len(plan.lines)
    zero = np.clip(np.zeros(n), *lines.limits)
    if plan.method != "elimination":
        return tuple(zero.tolist())
    rng = np.random.default_rng(23)
    theta = spread(lines, rng, 2)
    theta[1, list(plan.locked)] = lines.theta(zero)[list(plan.locked)]
    if _aligned(plan, theta[1]) <= _aligned(plan, theta[0]):
        return tuple(zero.tolist())
    aside = np.clip(ASIDE / np.abs(lines.multiplier), *lines.limits)
    there = np.where(aside > zero, aside, np.clip(-ASIDE / np.abs(lines.multiplier), *lines.limits))
    return tuple(there.tolist())


def _aligned(plan: ChainPlan, theta: Array) -> int:
    """How many joints that move have an axis nearly parallel to the next one's, or nearly meeting
    it, at theta (n,).
    """
    axes, _ = carried_lines(plan.lines, plan.locked, plan.extra, theta)
    moving = [i for i in range(len(plan.lines)) if i not in plan.locked]
    count = 0
    for i, j in itertools.pairwise(moving):
        across = np.cross(axes.h[i], axes.h[j])
        size = float(np.linalg.norm(across))
        count += size < NEARLY or abs(float(across @ (axes.o[j] - axes.o[i]))) < NEARLY * size
    return count


def _share(plan: ChainPlan) -> float:
    """The share of random poses that have a solution inside the limits with the locked joints where
    they are first.
    """
    lines = plan.lines
    n = len(plan.lines)
    q = within_domains(lines, np.random.default_rng(17).random((SAMPLES, n)))
    held = np.array([plan.first])
    out = np.empty((SAMPLES, A.SLOTS, n + A.INFO))
    counts = np.empty((SAMPLES, 2), dtype=np.int64)
    tolerance = 1e-9 * max(lines.length, 1.0)
    kernel_of(plan)(
        plan.ints,
        plan.floats,
        targets_at(lines, plan.extra, q),
        held,
        held,
        tolerance,
        TOLERANCE,
        0,
        np.arange(SAMPLES),
        out,
        counts,
    )
    code = out[..., n + A.CODE]
    return float(((code >= 0.0) & (code.astype(np.int64) % 2 == 1)).any(axis=1).mean())


def domains(lines: Lines) -> Array:
    """Values (2, n) between which joints are looked at: limits; else a turn, or two lengths of the
    chain each way.
    """
    half = np.where(lines.kinds == SLIDE, 2.0, np.pi) / np.abs(lines.multiplier)
    low, high = lines.limits
    with np.errstate(invalid="ignore"):
        first = np.where(
            np.isfinite(low), low, np.where(np.isfinite(high), high - 2.0 * half, -half)
        )
        last = np.where(np.isfinite(high), high, first + 2.0 * half)
    return np.stack([first, last])


def within_domains(lines: Lines, shares: Array) -> Array:
    """Coordinates (m, n) at these shares (m, n) of the ways from the first to the last values of
    `domains`.
    """
    first, last = domains(lines)
    return first + shares * (last - first)
