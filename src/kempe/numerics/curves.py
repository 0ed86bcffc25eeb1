"""Continuation of curves: a predictor along the tangent and a corrector across it.

A curve is where n - 1 independent equations of n unknowns hold; there may be more, dependent ones.
Everything is done in numbers without unit: turns in radians, slides and positions divided by a
characteristic length.
Source: Allgower, Georg, *Numerical Continuation Methods*, 1990, chapters 2, 6 and 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kempe.numerics.newton import LARGE, GaussNewtonEnd, run_gauss_newton, solve_least_squares
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

CLOSED = 1e-13
"""Residual below which the equations hold; rounding leaves about 1e-15. A shaky structure cannot
move by 1e-6 then."""
BEND = 0.25
"""Largest angle between the tangents at both ends of a step."""
IDEAL_BEND = 0.1
"""Angle between tangents that the step length aims at."""
ACROSS = 0.25
"""Largest correction, relative to the step, that is still taken for the same curve."""
LEAST_STEP = 1e-6
"""Steps below this are given up: the curve has a cusp or an end there."""
BLUNT = 1e-7
"""Relative singular values below which a correction is only rounding noise, blown up."""
SAME_RANGE = 0.2
"""Least determinant between the ranges of the equations at two nodes that are compared."""
ARRIVED = 0.999
"""Cosine between the directions in which a curve leaves its start and returns to it."""
TRIES = 12
"""Steps of a correction at most."""
NONE = np.zeros((0, 0))


class Curve:
    """Equations of a curve over points x (n,). `n` is the number of unknowns.

    What is written here is what others than plain vectors, or with other correctors, do in their
    own way.
    """

    least = 0.0
    """What the largest singular value counts as at least, where the size of equations is known."""
    n: Any
    """How many variables there are: set once by some curves, a property of others."""

    def evaluate_equations(self, x: Array) -> tuple[Array, Array]:
        """Compute residuals (rows,) and derivatives (rows, n) of the equations at `x`.

        There are at least n rows, some of them zero.
        """
        raise NotImplementedError

    def compute_jacobian(self, x: Array) -> Array:
        """Compute the derivatives (rows, n) of the equations at `x`."""
        return self.evaluate_equations(x)[1]

    def move_point(self, x: Array, y: Array) -> Array:
        """Compute the point that the tangent vector `y` (n,) leads to from `x`."""
        return x + y

    def compute_difference(self, x: Array, other: Array) -> Array:
        """Compute the tangent vector (n,) that leads from `x` to `other`."""
        return other - x

    def compute_tolerance(self, x: Array) -> float:
        """Compute the largest residual of a point `x` of the curve."""
        return CLOSED

    def correct_point(self, x: Array, across: Array) -> GaussNewtonEnd | None:
        """Find the point of the curve near `x` in the plane normal to `across` (n,), or None."""
        return correct_point(self, x, across)

    def make_node(self, x: Array, toward: Array, J: Array) -> Node:
        """Make the node at point `x` of the curve, its tangent in the sense of `toward` (n,)."""
        return make_node(self, x, toward, J)


@dataclass(frozen=True, eq=False)
class Node:
    """Point of a curve with its unit tangent and a measure of its regularity.

    `sigma` is the last singular value that is not zero on the regular curve, relative to the
    largest; `nullity` counts those that are zero here: 1 at regular points. `lines` (k, n) are the
    directions of the branches at a singular point, None where the point is regular; `complete` says
    whether they are all that were looked for.
    """

    x: Array
    t: Array
    sigma: float
    nullity: int
    matrix: Array = field(repr=False)
    image: Array = field(repr=False)
    lines: Array | None = None
    complete: bool = True

    def reverse_direction(self) -> Node:
        """Return the same point with the opposite tangent."""
        return replace(self, t=-self.t)


def make_node(
    equations: Curve, x: Array, toward: Array | None = None, J: Array | None = None
) -> Node:
    """Make the `Node` at point `x` of a curve.

    Its tangent is the null vector nearest to `toward` (n,).
    """
    J = equations.compute_jacobian(x) if J is None else J
    spectrum = Spectrum(J, equations.least)
    U, s, Vt = spectrum.thin_decomposition
    n = equations.n
    nullity = n - spectrum.compute_rank(Level.CLOSED)
    t = Vt[-1]
    if toward is not None:
        null_space = Vt[min(spectrum.compute_rank(BLUNT), n - 1) :]
        along = null_space.T @ (null_space @ toward)
        size = np.linalg.norm(along)
        t = along / size if size > 0.0 else t
    image = U[:, : n - 1]
    sigma = float(s[n - 2] / spectrum.largest) if n > 1 else 1.0
    return Node(x, t, sigma, nullity, J, image)


def correct_point(equations: Curve, x: Array, across: Array) -> GaussNewtonEnd | None:
    """Find the point of a curve in the plane through `x` normal to `across` (n,), or None.

    Newton's method with least squares, so that dependent equations do no harm.
    """

    def evaluate_augmented_equations(x: Array) -> tuple[Array, Array]:
        F, J = equations.evaluate_equations(x)
        return np.append(F, 0.0), np.vstack([J, across])

    found = run_gauss_newton(
        evaluate_augmented_equations, x, TRIES, level=BLUNT, halving=True, move=equations.move_point
    )
    return (
        GaussNewtonEnd(found.x, found.r[:-1], found.J[:-1])
        if found.size < equations.compute_tolerance(found.x)
        else None
    )


def find_next_node(curve: Curve, a: Node, h: float) -> Node | None:
    """Find the node at a distance of about `h` from `a`; None where `h` is too long."""
    guess = curve.move_point(a.x, h * a.t)
    there = curve.correct_point(guess, a.t)
    if (
        there is None
        or float(np.linalg.norm(curve.compute_difference(guess, there.x))) > ACROSS * h
    ):
        return None
    b = curve.make_node(there.x, curve.compute_difference(a.x, there.x), there.J)
    return b if compute_bend_angle(a, b) <= BEND else None


def find_next_nodes(curve: Curve, a: Node, h: float) -> list[Node] | None:
    """Find the nodes that a step of `walk_curve` leads to: one, or None where `h` is too long."""
    b = find_next_node(curve, a, h)
    return None if b is None else [b]


def join_ways(back: list[Node], way: list[Node]) -> list[Node]:
    """Join the nodes of both ways from one node: `back` reversed, then `way`."""
    return [*(a.reverse_direction() for a in back[:0:-1]), *way]


def choose_step_length(
    h: float, longest: float, a: Node, b: Node, ideal: float = IDEAL_BEND
) -> float:
    """Choose the next step length by how much the tangent turned in the last step."""
    factor = (
        1.5
        if ideal == math.inf
        else min(1.5, max(0.5, ideal / max(compute_bend_angle(a, b), 1e-9)))
    )
    return min(longest, h * factor)


def walk_curve(
    a: Node,
    taken: Callable[[Node, float], list[Node] | None],
    longest: float,
    h: float,
    *,
    least: float = LEAST_STEP,
    ideal: float = IDEAL_BEND,
    many: Callable[[Node, float], tuple[list[Node], float]] | None = None,
) -> Iterator[Node]:
    """Yield nodes of a curve after `a`, until steps would be shorter than `least`.

    The first step has the length `h`.

    `taken` gives the nodes that a step of some length from a node leads to, None where that is too
    long. `ideal` is the angle between tangents that the length aims at. `many` gives the nodes of
    many steps, perhaps none, and the length of the next step; it is called before each single one.
    """
    while True:
        if many is not None:
            found, h = many(a, h)
            yield from found
            a = found[-1] if found else a
        found = taken(a, h)
        if found is None:
            h *= 0.5
            if h < least:
                return
            continue
        yield from found
        h = choose_step_length(h, longest, a, found[-1], ideal)
        a = found[-1]


def compute_bend_angle(a: Node, b: Node) -> float:
    """Compute the angle [rad] between the tangents of two nodes."""
    return 2.0 * float(np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(b.t - a.t)))))


def is_determinant_flipped(a: Node, b: Node) -> bool | None:
    """Whether the determinant of equations and tangent changes its sign between two nodes.

    It does at a simple crossing of branches, and where a step went over to another branch
    (Allgower, Georg, 1990, section 8.1). None where the nodes are too different to tell. The image
    of the equations at `a` stands for both: of dependent equations only independent combinations
    count.
    """
    if a.nullity > 1 or b.nullity > 1:
        return False
    size = np.linalg.slogdet(a.image.T @ b.image)[1]
    if size < math.log(SAME_RANGE):
        return None
    sign = np.linalg.slogdet(np.vstack([a.image.T @ b.matrix, b.t]))[0]
    own = np.linalg.slogdet(np.vstack([a.image.T @ a.matrix, a.t]))[0]
    return bool(sign * own < 0.0)


def are_sides_same(M: Array) -> np.ndarray:
    """Tell for neighbouring nodes whether the determinants of equations and tangent agree in sign.

    `M` (k, rows, n) are their Jacobians and tangents, of full rank. It is False, too, where the
    nodes are too different to tell. With M = Q R the determinant of Q_a^T Q_b decides, in the
    notation of `is_determinant_flipped`: it is that of M_a^T M_b over the volumes of both.
    """
    volume = 0.5 * np.linalg.slogdet(np.swapaxes(M, -1, -2) @ M)[1]
    sign, size = np.linalg.slogdet(np.swapaxes(M[:-1], -1, -2) @ M[1:])
    return (sign > 0.0) & (size > volume[:-1] + volume[1:] + math.log(SAME_RANGE))


def guess_point_between(equations: Curve, a: Node, b: Node, distance: float) -> Array:
    """Guess the point of the curve between two neighbours at `distance` along the first tangent."""
    y = equations.compute_difference(a.x, b.x)
    h = float(a.t @ y)
    f = distance / h
    return equations.move_point(a.x, distance * a.t + f * f * (y - h * a.t))


def find_node_between(
    equations: Curve, a: Node, b: Node, distance: float, whole: bool = True
) -> Node | None:
    """Find the node between two neighbours at `distance` along the first one's tangent.

    One that is not `whole` may lack singular values and matrices, where these cost much.
    """
    guess = guess_point_between(equations, a, b, distance)
    there = equations.correct_point(guess, a.t)
    if there is None:
        return None
    f = distance / float(a.t @ equations.compute_difference(a.x, b.x))
    along = (1.0 - f) * a.t + f * b.t
    if whole or len(there.r) <= LARGE:
        return equations.make_node(there.x, along, there.J)
    t = solve_least_squares(
        np.vstack([there.J, along]), np.append(np.zeros(len(there.r)), 1.0), BLUNT
    )
    return Node(there.x, t / np.linalg.norm(t), np.nan, 1, NONE, NONE)


def has_returned(curve: Curve, a: Node, b: Node, start: Node, near: float) -> bool:
    """Tell whether a curve returns to its start between two neighbours.

    It does where it passes at a distance below `near`, in the direction in which it left. `start`
    has the whole turns of `b`, where these lead back to the same place.
    """
    chord = curve.compute_difference(a.x, b.x)
    length = float(np.linalg.norm(chord))
    away = float(np.linalg.norm(curve.compute_difference(b.x, start.x)))
    if away > near + 3.0 * length:  # the common case, told without the rest
        return False
    if away < near:
        return bool(start.t @ b.t > ARRIVED)
    home = curve.compute_difference(a.x, start.x)
    along = float(a.t @ home)
    if not 1e-9 < along <= float(a.t @ chord) or np.linalg.norm(home) > 2.0 * length:
        return False
    here = find_node_between(curve, a, b, along)
    if here is None or start.t @ here.t < ARRIVED:
        return False
    return float(np.linalg.norm(curve.compute_difference(here.x, start.x))) < near


def estimate_arc_length(equations: Curve, a: Node, b: Node) -> float:
    """Estimate the arc length between two neighbours: the chord times 1 + angle^2 / 24.

    The error is O(h^5).
    """
    return float(np.linalg.norm(equations.compute_difference(a.x, b.x))) * (
        1.0 + compute_bend_angle(a, b) ** 2 / 24.0
    )


def estimate_arc_lengths(equations: Curve, x: Array, t: Array) -> Array:
    """Estimate the arc lengths (k,) up to each of the points x (k, ...), as `estimate_arc_length` does.

    `t` (k, n) are their tangents.
    """
    chords = np.linalg.norm(equations.compute_difference(x[:-1], x[1:]), axis=-1)
    bends = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(np.diff(t, axis=0), axis=-1)))
    return np.append(0.0, np.cumsum(chords * (1.0 + bends**2 / 24.0)))
