"""Intervals of a parameter, on a line or round the circle."""

from __future__ import annotations

import math

Intervals = tuple[tuple[float, float], ...]

SAME_ANGLE = 1e-11
"""Angles [rad] that are closer than this are one."""

TWO_PI = 2.0 * math.pi


def split_circle(angles: list[float]) -> list[tuple[float, float]]:
    """Split a circle at angles into arcs (low, high); without any, return the whole circle.

    `low` is in [-pi, pi).
    """
    at: list[float] = []
    for x in sorted(math.remainder(a, TWO_PI) for a in angles):
        if not at or x - at[-1] > SAME_ANGLE:
            at.append(x)
    if len(at) > 1 and at[0] + TWO_PI - at[-1] <= SAME_ANGLE:
        at.pop()
    if not at:
        return [(-math.pi, math.pi)]
    return list(zip(at, [*at[1:], at[0] + TWO_PI], strict=True))


def join_arcs(parts: list[tuple[float, float]], good: list[bool]) -> list[tuple[float, float]]:
    """Join neighbouring `good` arcs of consecutive arcs round a circle."""
    if all(good):
        return [(-math.pi, math.pi)]
    first = good.index(False)
    out: list[list[float]] = []
    for k in range(first, first + len(parts)):
        (low, high) = parts[k % len(parts)]
        turn = TWO_PI * (k // len(parts))
        if not good[k % len(parts)]:
            continue
        if out and abs(out[-1][1] - (low + turn)) <= SAME_ANGLE:
            out[-1][1] = high + turn
        else:
            out.append([low + turn, high + turn])
    shifts = [TWO_PI if low >= math.pi else 0.0 for low, _ in out]
    return sorted((low - s, high - s) for (low, high), s in zip(out, shifts, strict=True))


def unite_intervals(
    intervals: list[tuple[float, float]], circular: bool = False, slack: float = 0.0
) -> Intervals:
    """Compute the union of intervals, sorted, with gaps up to `slack` closed.

    On a circle low is in [-pi, pi), and (-pi, pi) stands for all of it.
    """
    parts: list[tuple[float, float]] = []
    for low, high in intervals:
        if circular and high > math.pi:
            parts += [(low, math.pi), (-math.pi, high - TWO_PI)]
        else:
            parts.append((low, high))
    out: list[tuple[float, float]] = []
    for low, high in sorted(parts):
        if out and low <= out[-1][1] + slack:
            out[-1] = (out[-1][0], max(out[-1][1], high))
        else:
            out.append((low, high))
    if circular and len(out) > 1 and out[0][0] == -math.pi and out[-1][1] == math.pi:
        first = out.pop(0)
        out[-1] = (out[-1][0], first[1] + TWO_PI)
    return tuple(out)


def format_intervals(intervals: Intervals | list[tuple[float, float]]) -> str:
    """Format intervals as text."""
    return ", ".join(f"[{a:.6g}, {b:.6g}]" for a, b in intervals)
