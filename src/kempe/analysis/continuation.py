"""Walking along a curve of configurations: predictor along the tangent, corrector across it, steps that stay on it.

Everything is done in numbers without unit: turns in radians, slides and positions divided by the characteristic length
of the system. A curve is where n - 1 independent equations of n unknowns hold; there may be more, dependent ones.
Source: Allgower, Georg, *Numerical Continuation Methods*, 1990, chapters 2, 6 and 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from kempe.kinematics import loops
from kempe.kinematics.gauss_newton import LARGE, gauss_newton, least_squares
from kempe.model.lengths import origin_of
from kempe.model.own_tree import own_tree
from kempe.solvers.clock import Budget
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

RANK = 1e-8
"""Singular values below this, relative to the largest, count as zero."""
CLOSED = 1e-13
"""Residual below which the equations hold; rounding leaves about 1e-15. A shaky structure cannot move by 1e-6 then."""
BEND = 0.25
"""Largest angle between the tangents at both ends of a step."""
IDEAL_BEND = 0.1
"""Angle between tangents that the step length aims at."""
ACROSS = 0.25
"""Largest correction, relative to the step, that is still taken for the same curve."""
BLUNT = 1e-7
"""Relative singular values below which a correction is only rounding noise, blown up."""
ANGLES = ("rx", "ry", "rz", "x.y")
"""Names of equations that are angles."""


class Further(Protocol):
    """Equations of a curve besides those of the loops."""

    @property
    def count(self) -> int:
        """How many there are."""
        ...

    def write(self, equations: Closure, x: Array, F: Array, J: Array, at: int, with_matrix: bool) -> None:
        """Write what is missing in each, and the derivatives, into F (., ) and J (., n) from row `at` on; rows before
        it are written."""  # fmt: skip
        ...


class Closure:
    """The closure equations of a system, some of its coordinates held at the values of a configuration.

    `unit` (nv,) are the velocity coordinates of one unit of the numbers used here. `held` are indices of velocity
    coordinates that belong to angles and slides. Work with them ends by `TimeUp` when the `budget` is spent.
    """

    def __init__(self, system: System, held: Sequence[int] = (), at: Array | None = None):
        self.system, self.held, self.tree = system, tuple(held), own_tree(system)
        self._held = np.array(self.held, dtype=np.int64)
        layout, turning = system.layout, system.coordinates.turning
        length = loops.characteristic_length(system)
        self.rounding = 4.0 * np.finfo(float).eps * float(np.linalg.norm(origin_of(system))) / length
        self.unit = np.where(turning, 1.0, length)
        for iv in layout.quaternion_v:
            self.unit[iv : iv + 3] = 1.0
        self.place = np.full(system.nv, -1, dtype=np.int64)
        self.place[layout.vector_v] = layout.vector_q
        self.n = system.nv
        index = {n: i for i, n in enumerate(system.velocity_names)}
        self.weight = np.array([
            1.0 if row in ANGLES or (tie.plain and tie.relation is None)
            else 1.0 / (length if tie.relation is None else self.unit[index[tie.relation.of]])
            for tie in loops.full(self.tree, False).ties for row in tie.rows
        ])  # fmt: skip
        self.targets = np.zeros(0) if at is None else at[self.place[self._held]]
        self.budget = Budget(None)
        self.more: tuple[Further, ...] = ()
        self._count()

    def _count(self) -> None:
        self.real = len(self.weight) + len(self.held) + sum(m.count for m in self.more)
        self.rows = max(self.real, self.n)

    def add(self, further: Further) -> None:
        """Let further equations hold from here on."""
        self.more = (*self.more, further)
        self._count()

    def leave_out(self, further: Further) -> None:
        """Let these equations hold no longer."""
        self.more = tuple(m for m in self.more if m is not further)
        self._count()

    def values(self, x: Array) -> Array:
        """What is missing in each equation (rows,) at `x`."""
        return self.both(x, False)[0]

    def matrix(self, x: Array) -> Array:
        """Derivative (rows, n) of the equations at `x`, at least as many rows as columns (zeros where none is)."""
        return self.both(x)[1]

    def both(self, x: Array, with_matrix: bool = True, further: int | None = None) -> tuple[Array, Array]:
        """`values` and `matrix` in one pass; the latter is all zero unless asked for. Of further equations only the
        first so many are written, where their number is given."""  # fmt: skip
        self.budget.check()
        F, J, m = np.zeros(self.rows), np.zeros((self.rows, self.n)), len(self.weight)
        if m:
            values, columns = loops.evaluate(self.tree, x, with_matrix)
            F[:m] = self.weight * values
            if with_matrix:
                J[:m] = self.weight[:, None] * columns * self.unit
        if self.held:
            F[m : m + len(self.held)] = (x[self.place[self._held]] - self.targets) / self.unit[self._held]
            J[m + np.arange(len(self.held)), self._held] = 1.0
        if self.more:
            self._further(x, F, J, with_matrix, further)
        return F, J

    def many(self, x: Array) -> tuple[Array, Array]:
        """`both` of many points (k, nq): (k, rows) and (k, rows, n)."""
        self.budget.check()
        k, m = len(x), len(self.weight)
        F, J = np.zeros((k, self.rows)), np.zeros((k, self.rows, self.n))
        if m:
            values, columns = loops.evaluate(self.tree, x)
            F[:, :m], J[:, :m] = self.weight * values, self.weight[:, None] * columns * self.unit
        if self.held:
            F[:, m : m + len(self.held)] = (x[:, self.place[self._held]] - self.targets) / self.unit[self._held]
            J[:, m + np.arange(len(self.held)), self._held] = 1.0
        for one, f, j in zip(x, F, J, strict=True) if self.more else ():
            self._further(one, f, j, True, None)
        return F, J

    def _further(self, x: Array, F: Array, J: Array, with_matrix: bool, most: int | None) -> None:
        """Write the first so many of the further equations."""
        at = len(self.weight) + len(self.held)
        for more in self.more[:most]:
            more.write(self, x, F, J, at, with_matrix)
            at += more.count

    def tolerance(self, x: Array) -> float:
        """Residual below which the equations hold at `x`: angles of many turns are known less well."""
        return CLOSED * (1.0 + 0.01 * float(np.abs(x).max(initial=0.0))) + self.rounding

    def move(self, x: Array, y: Array) -> Array:
        """The point reached from `x` by the tangent vector `y` (n,)."""
        return self.system.layout.integrate(x, y * self.unit)

    def between(self, x: Array, other: Array) -> Array:
        """The tangent vector (n,) from `x` to `other`, turns as many as they are."""
        return self.system.layout.difference(x, other) / self.unit

    def index(self, names: Sequence[str]) -> list[int]:
        """Velocity indices of angles and slides by name."""
        number = {n: i for i, n in enumerate(self.system.velocity_names)}
        return [number[n] for n in names]


class Driven(Closure):
    """Closure, and inputs that follow a straight line: a point is a configuration and the length along that line.

    Point: (nq + 1,) = [q, length]; input i has the value `origin[i] + unit * direction[i] * length`.
    """

    def __init__(self, closure: Closure, inputs: Sequence[int], origin: Array, direction: Array):
        vars(self).update(vars(closure))
        self.base, self.inputs = closure, list(inputs)
        self.origin, self.direction = origin, direction
        self.n = closure.n + 1
        self.rows = max(self.real + len(self.inputs), self.n)

    def at(self, length: float) -> Array:
        """Values of the inputs, in radians and metres, at a length of their line."""
        return self.origin + self.unit[self.inputs] * self.direction * length

    def both(self, x: Array, with_matrix: bool = True, further: int | None = None) -> tuple[Array, Array]:
        """`values` and `matrix` in one pass; the latter is all zero unless asked for."""
        F, J, k = np.zeros(self.rows), np.zeros((self.rows, self.n)), self.real
        inner, columns = self.base.both(x[:-1], with_matrix, further)
        F[:k], J[:k, :-1] = inner[:k], columns[:k]
        at, unit, place = x[self.place[self.inputs]], self.unit[self.inputs], k + np.arange(len(self.inputs))
        F[place] = (at - self.origin) / unit - self.direction * x[-1]
        J[place, self.inputs], J[place, -1] = 1.0, -self.direction
        return F, J

    def move(self, x: Array, y: Array) -> Array:
        """The point reached from `x` by the tangent vector `y` (n,)."""
        return np.append(self.base.move(x[:-1], y[:-1]), x[-1] + y[-1])

    def between(self, x: Array, other: Array) -> Array:
        """The tangent vector (n,) from `x` to `other`."""
        return np.append(self.base.between(x[:-1], other[:-1]), other[-1] - x[-1])


@dataclass(frozen=True, eq=False)
class Node:
    """A point of a curve: where, the unit tangent, how regular it is.

    `sigma` is the last singular value that is not zero on the regular curve, relative to the largest; `nullity` counts
    those that are zero here: 1 at regular points. `lines` (k, n) are the directions of all branches at a singular
    point, None where the point is regular.
    """

    x: Array
    t: Array
    sigma: float
    nullity: int
    matrix: Array = field(repr=False)
    image: Array = field(repr=False)
    lines: Array | None = None

    def reversed(self) -> Node:
        """The same point, walked the other way."""
        return Node(self.x, -self.t, self.sigma, self.nullity, self.matrix, self.image, self.lines)


def node(equations: Closure, x: Array, toward: Array | None = None) -> Node:
    """The `Node` at a point of the curve; its tangent is the kernel vector nearest to `toward` (n,)."""
    J = equations.matrix(x)
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    n = equations.n
    scale = s[0] if s[0] > 0.0 else 1.0
    nullity = int(np.sum(s <= RANK * scale))
    t = Vt[-1]
    if toward is not None:
        kernel = Vt[n - max(int(np.sum(s <= BLUNT * scale)), 1) :]
        along = kernel.T @ (kernel @ toward)
        size = np.linalg.norm(along)
        t = along / size if size > 0.0 else t
    image = U[:, : n - 1]
    sigma = float(s[n - 2] / scale) if n > 1 else 1.0
    return Node(x, t, sigma, nullity, J, image)


def correct(equations: Closure, x: Array, across: Array, tries: int = 12) -> Array | None:
    """The point of the curve in the plane through `x` across the direction `across` (n,), or None.

    Newton's method with least squares, so that dependent equations do no harm.
    """

    def both(x: Array) -> tuple[Array, Array]:
        F, J = equations.both(x)
        return np.append(F, 0.0), np.vstack([J, across])

    found = gauss_newton(both, x, tries, cut=BLUNT, halving=True, move=equations.move)
    return found.x if found.size < equations.tolerance(found.x) else None


def close(equations: Closure, x: Array, tries: int = 60) -> Array | None:
    """The configuration with closed loops near `x`, by steps of least size, or None."""
    found = gauss_newton(equations.both, x, tries, cut=BLUNT, met=1e-15, longest=0.5, move=equations.move)
    return found.x if found.size < equations.tolerance(found.x) else None


def step(equations: Closure, a: Node, h: float) -> Node | None:
    """The next node at a distance of about `h`, or None where that is too far to be sure of the curve."""
    guess = equations.move(a.x, h * a.t)
    x = correct(equations, guess, a.t)
    if x is None or float(np.linalg.norm(equations.between(guess, x))) > ACROSS * h:
        return None
    b = node(equations, x, equations.between(a.x, x))
    return b if bend(a, b) <= BEND else None


def bend(a: Node, b: Node) -> float:
    """Angle between the tangents of two nodes."""
    return 2.0 * float(np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(b.t - a.t)))))


def flipped(a: Node, b: Node) -> bool | None:
    """Whether the determinant of the equations and the tangent changes its sign between two nodes.

    It does at a simple crossing of branches, and where a step went over to another branch (Allgower, Georg, 1990,
    section 8.1). None where the nodes are too different to tell. The image of the equations at `a` stands for both:
    of dependent equations only independent combinations count.
    """
    if a.nullity > 1 or b.nullity > 1:
        return False
    overlap, size = np.linalg.slogdet(a.image.T @ b.image)
    if size < np.log(0.2):
        return None
    sign = np.linalg.slogdet(np.vstack([a.image.T @ b.matrix, b.t]))[0]
    own = np.linalg.slogdet(np.vstack([a.image.T @ a.matrix, a.t]))[0]
    return bool(sign * own < 0.0)


def inside(equations: Closure, a: Node, b: Node, distance: float, whole: bool = True) -> Node | None:
    """The node between two neighbours at `distance` along the tangent of the first.

    One that is not `whole` may lack singular values and matrices, where these cost much.
    """
    y = equations.between(a.x, b.x)
    h = float(a.t @ y)
    f = distance / h
    guess = equations.move(a.x, distance * a.t + f * f * (y - h * a.t))
    x = correct(equations, guess, a.t)
    if x is None:
        return None
    along = (1.0 - f) * a.t + f * b.t
    if whole or equations.rows <= LARGE:
        return node(equations, x, along)
    A = np.vstack([equations.matrix(x), along])
    t = least_squares(A, np.append(np.zeros(equations.rows), 1.0), BLUNT)
    return Node(x, t / np.linalg.norm(t), np.nan, 1, NONE, NONE)


NONE = np.zeros((0, 0))


def arc(equations: Closure, a: Node, b: Node) -> float:
    """Length of the curve between two neighbours: the chord times 1 + angle^2/24, which leaves an error O(h^5)."""
    return float(np.linalg.norm(equations.between(a.x, b.x))) * (1.0 + bend(a, b) ** 2 / 24.0)
