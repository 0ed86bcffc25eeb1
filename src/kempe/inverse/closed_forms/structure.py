"""Geometry of joint axes, and the closed forms that the geometry of six axes allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kempe.kernels.closed_form.analytic_layout import (
    AT_REST,
    COUPLED,
    PLANE,
    POINT,
    X_FIRST,
    Z_FIRST,
)
from kempe.kernels.compiled import candidates
from kempe.kernels.forward.table_layout import SLIDE, TURN
from kempe.numerics.rank import Spectrum
from kempe.spatial import Array

EXACT = 1e-9
"""Sine of an angle, or distance in lengths of the chain, below which axes count as parallel, or as
meeting.

Chains that are farther from a structure than this, calibrated ones say, are solved as what they
are."""

NO_POINT = 1e-15
"""Least part across all of some axes, squared, below which rounding leaves open in which point
these meet."""

TURNED_OVER = 40
"""Orders of slides among turns along their direction that are looked at."""


@dataclass(frozen=True, eq=False)
class Axes:
    """Joint axes as lines.

    Each joint is a turn about a line or a slide along its direction: `kinds` (n,) TURN or SLIDE,
    `h` (n, 3) unit directions, `o` (n, 3) points.
    """

    kinds: np.ndarray
    h: Array
    o: Array

    def __len__(self) -> int:
        return len(self.kinds)

    def select_lines(self, places: Sequence[int]) -> Axes:
        """Return the lines at these places, in their order."""
        at = list(places)
        return Axes(self.kinds[at], self.h[at], self.o[at])

    def pack_lines(self) -> Array:
        """Pack the lines as kernels read them."""
        out = np.zeros((len(self), 8))
        out[:, :3] = self.h
        out[:, 4:7] = self.o
        return out.ravel()


def join_axes(first: Axes, second: Axes) -> Axes:
    """Join two sets of lines, in new arrays."""
    return Axes(
        np.concatenate([first.kinds, second.kinds]),
        np.concatenate([first.h, second.h]),
        np.concatenate([first.o, second.o]),
    )


@dataclass(frozen=True)
class Strategy:
    """A closed form of six lines: their order, the inner three joints, and the outer equations.

    `inner` is the place of the three joints that leave `what` (POINT or PLANE) in place; `mode`,
    `measure` and `option` say how the outer three are solved.

    See `kempe.kernels.closed_form.arm_part`.
    """

    order: tuple[int, ...]
    inner: int
    what: int
    mode: int
    measure: int
    option: int


def are_parallel(g: Array, h: Array) -> bool:
    """Return whether two unit vectors are parallel, of either sense."""
    return float(np.linalg.norm(np.cross(g, h))) <= EXACT


def compute_line_distance(axes: Axes, i: int, j: int) -> float:
    """Compute the distance between two lines."""
    n = np.cross(axes.h[i], axes.h[j])
    d = axes.o[j] - axes.o[i]
    size = float(np.linalg.norm(n))
    if size <= EXACT:
        return float(np.linalg.norm(np.cross(axes.h[i], d)))
    return abs(float(n @ d)) / size


def do_axes_meet(axes: Axes, i: int, j: int) -> bool:
    """Return whether two axes that are not parallel meet."""
    return not are_parallel(axes.h[i], axes.h[j]) and compute_line_distance(axes, i, j) <= EXACT


def find_meeting_point(axes: Axes, places: tuple[int, ...]) -> Array | None:
    """Find the point (3,) in which axes meet; None where they do not, or are all parallel."""
    across = np.eye(3) - axes.h[list(places), :, None] * axes.h[list(places), None, :]
    total: Array = across.sum(axis=0)
    if Spectrum(total).smallest <= NO_POINT:
        return None
    moments: Array = np.einsum("nij,nj->i", across, axes.o[list(places)])
    centre = np.asarray(np.linalg.solve(total, moments), dtype=float)
    away = np.linalg.norm(np.cross(centre - axes.o[list(places)], axes.h[list(places)]), axis=-1)
    return centre if float(away.max()) <= EXACT else None


def is_spherical_triple(axes: Axes, k: int) -> bool:
    """Return whether turns k, k + 1, k + 2 meet in a point, as a spherical joint does.

    They must allow any rotation near most positions.
    """
    if np.any(axes.kinds[k : k + 3] == SLIDE) or are_parallel(axes.h[k], axes.h[k + 1]):
        return False
    return (
        not are_parallel(axes.h[k + 1], axes.h[k + 2])
        and find_meeting_point(axes, (k, k + 1, k + 2)) is not None
    )


def is_planar_triple(axes: Axes, k: int) -> bool:
    """Return whether joints k, k + 1, k + 2 move a plane in itself with three freedoms."""
    turns = [i for i in range(k, k + 3) if axes.kinds[i] == TURN]
    slides = [i for i in range(k, k + 3) if axes.kinds[i] == SLIDE]
    if not turns or any(not are_parallel(axes.h[i], axes.h[turns[0]]) for i in turns[1:]):
        return False
    if any(abs(float(axes.h[i] @ axes.h[turns[0]])) > EXACT for i in slides):
        return False
    if (
        len(slides) == 2
        and axes.kinds[k + 1] == SLIDE
        and are_parallel(axes.h[slides[0]], axes.h[slides[1]])
    ):
        return False
    return not any(i + 1 in turns and compute_line_distance(axes, i, i + 1) <= EXACT for i in turns)


def can_swap_lines(axes: Axes, i: int) -> bool:
    """Return whether lines i and i + 1 can change places.

    Two slides can, and a slide and a turn along its direction.
    """
    a = axes.kinds[i]
    b = axes.kinds[i + 1]
    if a == SLIDE and b == SLIDE:
        return True
    return a != b and are_parallel(axes.h[i], axes.h[i + 1])


def iterate_orders(variants: list[Axes]) -> Iterator[tuple[int, ...]]:
    """Iterate over orders of the lines that describe the same chain, the given one first."""
    n = len(variants[0])
    seen = [tuple(range(n))]
    for order in seen:
        yield order
        now = [axes.select_lines(order) for axes in variants]
        for i in range(n - 1):
            other = (*order[:i], order[i + 1], order[i], *order[i + 2 :])
            if (
                other not in seen
                and len(seen) < TURNED_OVER
                and all(can_swap_lines(axes, i) for axes in now)
            ):
                seen.append(other)


def find_strategies(variants: list[Axes], goals: list[Any], at_rest: set[int]) -> list[Strategy]:
    """Find all closed forms of six lines, the best first.

    variants: the lines for several positions of locked joints, of which the structure must be
    common; goals: for each some goals (m, 12) that can be reached; at_rest: lines that stand for no
    joint and must stay at zero.
    """
    found: list[tuple[int, Strategy]] = []
    for order in iterate_orders(variants):
        now = [axes.select_lines(order) for axes in variants]
        for k in range(4):
            outer = {order[(k + 3 + i) % 6] for i in range(3)}
            for what, keeps in ((POINT, is_spherical_triple), (PLANE, is_planar_triple)):
                if not all(keeps(axes, k) for axes in now):
                    continue
                if outer <= at_rest:
                    found.append((-1, Strategy(order, k, what, AT_REST, 0, 0)))
                elif (
                    what == POINT
                    or sum(now[0].kinds[(k + 3 + i) % 6] == SLIDE for i in range(3)) < 2
                ):
                    found += [
                        (rank, Strategy(order, k, what, *how))
                        for rank, how in _iterate_outer_solutions(now, goals, k, what)
                    ]
    return [way for _, way in sorted(found, key=lambda pair: pair[0])]


def _iterate_outer_solutions(
    now: list[Axes], goals: list[Array], k: int, what: int
) -> Iterator[tuple[int, tuple[int, int, int]]]:
    """Iterate over ways to solve the outer joints, as (rank, (mode, measure, option)).

    Rank 0 is the best.
    """
    for option in (0, 1):
        size = np.zeros((2, 2, 2))  # joint x or z, measure, largest or smallest over the goals
        size[..., 1] = np.inf
        for axes, some in zip(now, goals, strict=True):
            lines = axes.pack_lines()
            for goal in some:
                terms = np.empty(12)
                candidates.write_outer_terms(axes.kinds, lines, goal, k, what, option, terms)
                amplitude = np.linalg.norm(terms.reshape(2, 2, 3)[..., 1:], axis=-1)
                size[..., 0] = np.maximum(size[..., 0], amplitude)
                size[..., 1] = np.minimum(size[..., 1], amplitude)
        missing = size[..., 0] <= EXACT
        there = size[..., 0] > 1e-6
        for j in (0, 1):
            if missing[1, j] and there[0, j] and there[1, 1 - j]:
                yield 0, (X_FIRST, j, option)
            if missing[0, j] and there[1, j] and there[0, 1 - j]:
                yield 0, (Z_FIRST, j, option)
        if not missing.any():
            yield 2, (COUPLED, 0, option)
