"""What consecutive axes of a chain have in common, in words: the facts by which its inverse model
is solved.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.forward.table_layout import SLIDE
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.solvers.analytic.plans.structure import (
    EXACT,
    Axes,
    apart,
    keeps_point,
    meeting,
    parallel,
)
from kempe.spatial import Array
from kempe.words import joined

NEAR = 1e-2
"""Sine of an angle, or distance in lengths of the chain, below which a structure that is not there
counts as missed."""

AS_IT_IS = "solved as what they are"


def relations(lines: Lines) -> tuple[str, ...]:
    """Facts about consecutive axes of a chain, in its order; they hold in every configuration.

    Structures are those that `structure.EXACT` accepts; what misses one by less than `NEAR` is
    reported with its size.
    """
    axes = Axes(lines.kinds, lines.h, lines.o)
    n = len(lines)
    i = 0
    out: list[str] = []
    if n == 1:
        return (f"{lines.names[0]} is the only joint",)
    while i < n - 1:
        end = _last_parallel(axes, i)
        if end > i:
            out += _run(lines, axes, i, end)
            i = end
            continue
        end = _last_meeting(axes, i)
        if end > i + 1:
            out.append(_ball(lines, axes, i, end))
            i = end
            continue
        out.append(_pair(lines, axes, i))
        missed = _missed_ball(lines, axes, i)
        if missed:
            out.append(missed)
        i += 1
    return tuple(out)


def _last_parallel(axes: Axes, i: int) -> int:
    j = i
    while j + 1 < len(axes.kinds) and parallel(axes.h[j], axes.h[j + 1]):
        j += 1
    return j


def _last_meeting(axes: Axes, i: int) -> int:
    """The last of the consecutive turns from i that meet in one point, neighbours not parallel."""
    j = i + 1
    while j + 1 < len(axes.kinds) and keeps_point(axes, j - 1):
        if meeting(axes, tuple(range(i, j + 2))) is None:
            break
        j += 1
    return j


def _run(lines: Lines, axes: Axes, first: int, last: int) -> list[str]:
    """Facts about joints of one direction."""
    turns = [i for i in range(first, last + 1) if axes.kinds[i] != SLIDE]
    slides = [i for i in range(first, last + 1) if axes.kinds[i] == SLIDE]
    sliding = joined([lines.names[i] for i in slides]) if slides else ""
    verb = "slides" if len(slides) == 1 else "slide"
    if not turns:
        return [f"{sliding} slide in one direction"]
    names = joined([lines.names[i] for i in turns])
    if len(turns) == 1:
        return [f"{sliding} {verb} along the axis of {names}"]
    gaps = [apart(axes, i, j) for i, j in zip(turns, turns[1:], strict=False)]
    if max(gaps) <= EXACT:
        fact = f"the axes of {names} are one line"
        them = "it"
    else:
        size = f", {_metres(lines, gaps[0])} apart" if len(turns) == 2 else ""
        fact = f"the axes of {names} are parallel{size}"
        them = "them"
    out = [fact + (f", and {sliding} {verb} along {them}" if slides else "")]
    if max(gaps) > EXACT:
        for gap, i, j in zip(gaps, turns, turns[1:], strict=False):
            if gap <= EXACT:
                out.append(f"the axes of {lines.names[i]} and {lines.names[j]} are one line")
    return out


def _ball(lines: Lines, axes: Axes, first: int, last: int) -> str:
    names = joined([lines.names[i] for i in range(first, last + 1)])
    right = all(abs(float(axes.h[i] @ axes.h[i + 1])) <= EXACT for i in range(first, last))
    return f"the axes of {names} meet in one point" + (
        ", neighbours at right angles" if right else ""
    )


def _pair(lines: Lines, axes: Axes, i: int) -> str:
    """The fact about two neighbours that are not parallel."""
    a = lines.names[i]
    b = lines.names[i + 1]
    angle, sine = _angle(axes.h[i], axes.h[i + 1])
    at = (
        "right angles"
        if abs(float(axes.h[i] @ axes.h[i + 1])) <= EXACT
        else f"{math.degrees(angle):.4g} degrees"
    )
    sliding = axes.kinds[i] == SLIDE, axes.kinds[i + 1] == SLIDE
    if sine <= NEAR:
        what = "the directions" if any(sliding) else "the axes"
        return f"{what} of {a} and {b} are {sine:.2g} rad from parallel: {AS_IT_IS}"
    if all(sliding):
        return f"{a} and {b} slide at {at} to each other"
    if any(sliding):
        slide, turn = (a, b) if sliding[0] else (b, a)
        return f"{slide} slides at {at} to the axis of {turn}"
    gap = apart(axes, i, i + 1)
    if gap <= EXACT:
        return f"the axes of {a} and {b} meet at {at}"
    if gap <= NEAR:
        return (
            f"the axes of {a} and {b} miss each other by {_metres(lines, gap)}, at {at}: {AS_IT_IS}"
        )
    return f"the axes of {a} and {b} pass each other at {at}, {_metres(lines, gap)} apart"


def _missed_ball(lines: Lines, axes: Axes, i: int) -> str:
    """The fact that three axes nearly meet in one point; '' where they do not."""
    if i + 2 >= len(axes.kinds) or np.any(axes.kinds[i : i + 3] == SLIDE):
        return ""
    points: list[Array] = []
    for j in (i, i + 1):
        if _angle(axes.h[j], axes.h[j + 1])[1] <= NEAR or apart(axes, j, j + 1) > NEAR:
            return ""
        points.append(_foot(axes, j + 1 if j == i else j, j if j == i else j + 1))
    gap = max(
        float(np.linalg.norm(points[1] - points[0])),
        apart(axes, i, i + 1),
        apart(axes, i + 1, i + 2),
    )
    if not EXACT < gap <= NEAR:
        return ""
    names = joined(lines.names[i : i + 3])
    return f"the axes of {names} miss a common point by {_metres(lines, gap)}: {AS_IT_IS}"


def _foot(axes: Axes, i: int, j: int) -> Array:
    """The point (3,) of axis i nearest to axis j."""
    n = np.cross(axes.h[i], axes.h[j])
    d = axes.o[j] - axes.o[i]
    return axes.o[i] + axes.h[i] * (np.cross(d, axes.h[j]) @ n) / (n @ n)


def _angle(g: Array, h: Array) -> tuple[float, float]:
    """The angle between two axes, at most a right angle, and its sine."""
    sine = float(np.linalg.norm(np.cross(g, h)))
    cosine = abs(float(g @ h))
    return math.atan2(sine, cosine), sine


def _metres(lines: Lines, distance: float) -> str:
    return f"{distance * lines.length:.4g} m"
