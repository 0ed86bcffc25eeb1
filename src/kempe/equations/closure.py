"""Loop equations of a system as the equations of a curve.

Some coordinates are held, or inputs follow a line.

Turns are in radians, slides and positions divided by the characteristic length of the system.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from kempe.equations import closure_rows
from kempe.kernels.compiled import curve_steps
from kempe.model.characteristic_length import choose_origin
from kempe.model.own_tree import remove_cut_marks
from kempe.model.packed_loops import PackedLoops, pack_loops
from kempe.numerics.clock import TimeLimit
from kempe.numerics.curves import (
    ACROSS,
    BEND,
    BLUNT,
    CLOSED,
    IDEAL_BEND,
    NONE,
    TRIES,
    Curve,
    Node,
)
from kempe.numerics.newton import LAST, NOTHING, run_gauss_newton
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.constraint_program import Tie
    from kempe.model.model import Model
    from kempe.model.primitive_table import Table

LEAST = 0.1
"""What the largest singular value counts as at least: equations are scaled, and where all vanish it
is rounding."""
MOST_UNKNOWNS = 100
"""Unknowns up to which regular steps along a curve are taken by a kernel."""
ANGLES = ("rx", "ry", "rz", "x.y")
"""Names of equations that are angles."""


class Lock(Protocol):
    """Protocol of what holds bodies besides the joints and constraints of a system."""

    def list_ties(self, table: Table) -> list[Tie]:
        """List the ties that hold them, over the rows of the `table`."""
        ...


class Further(Protocol):
    """Protocol of equations that a curve has besides those of loops and coordinates."""

    @property
    def count(self) -> int:
        """Number of further equations."""
        ...

    def write_equations(
        self, equations: Closure, x: Array, F: Array, J: Array, at: int, with_matrix: bool
    ) -> None:
        """Write residuals (rows,) and derivatives (rows, n) of the further equations into F and J.

        `x` is the point of the curve; row `at` is the first to be written, and the rows before `at`
        are filled already. Without `with_matrix` J is left as it is.
        """
        ...


class Closure(Curve):
    """Closure equations of a system, some of whose coordinates are held at given values.

    `unit` (nv,) are the velocity coordinates of one unit of the numbers used here; `closed` is the
    residual below which the equations hold, up to what rounding adds. `held` are indices of
    velocity
    coordinates that belong to angles and slides. Work with them ends by `TimeUp` when the `budget`
    is spent.
    """

    least = LEAST

    def __init__(self, system: Model, held: Sequence[int] = (), at: Array | None = None):
        self.system = system
        self.held = tuple(held)
        self.tree = remove_cut_marks(system)
        self._held = np.array(self.held, dtype=np.int64)
        layout = system.structure.layout
        length = closure_rows.compute_characteristic_length(system)
        self.rounding = (
            4.0 * np.finfo(float).eps * float(np.linalg.norm(choose_origin(system))) / length
        )
        self.unit = np.where(system.structure.coordinates.angular, 1.0, length)
        self.place = np.full(system.nv, -1, dtype=np.int64)
        self.place[layout.vector_v] = layout.vector_q
        self.n = system.nv
        self.targets = np.zeros(0) if at is None else at[self.place[self._held]]
        self.closed = CLOSED
        self.budget = TimeLimit(None)
        self.more: tuple[Further, ...] = ()
        self.set_lock(None)

    def set_lock(self, lock: Lock | None) -> None:
        """Hold bodies by a lock, as it is now, in place of the one before."""
        self.lock = lock
        tree = self.tree
        self.loops: PackedLoops = (
            closure_rows.pack_full_loops(tree, False)
            if lock is None
            else pack_loops(
                tree, frozenset(tree.structure.closures), length=1.0, further=lock.list_ties
            )
        )
        length = closure_rows.compute_characteristic_length(self.system)
        index = {n: i for i, n in enumerate(self.system.structure.velocity_names)}
        self.weight = np.array(
            [
                1.0
                if row in ANGLES or (tie.unscaled and tie.relation is None)
                else 1.0 / (length if tie.relation is None else self.unit[index[tie.relation.of]])
                for tie in self.loops.ties
                for row in tie.row_names
            ]
        )
        self._count_rows()

    def _count_rows(self) -> None:
        """Count the equations, `real`, and the rows of F and J, at least as many as unknowns."""
        self.real = len(self.weight) + len(self.held) + sum(m.count for m in self.more)
        self.rows = max(self.real, self.n)

    def add_equations(self, further: Further) -> None:
        """Add further equations to the closure equations."""
        self.more = (*self.more, further)
        self._count_rows()

    def remove_equations(self, further: Further) -> None:
        """Remove further equations that `add_equations` has added."""
        self.more = tuple(m for m in self.more if m is not further)
        self._count_rows()

    def compute_residuals(self, x: Array) -> Array:
        """Compute the residuals (rows,) of all equations at the point `x`."""
        return self.evaluate_equations(x, False)[0]

    def evaluate_equations(
        self, x: Array, with_matrix: bool = True, further: int | None = None
    ) -> tuple[Array, Array]:
        """Compute residuals F (rows,) and Jacobian J (rows, n) of all equations at the point `x`.

        J is zero without `with_matrix`. `further` is the number of further equations that are
        written, by default all.
        """
        self.budget.check_time()
        F = np.zeros(self.rows)
        J = np.zeros((self.rows, self.n))
        m = len(self.weight)
        if m:
            F[:m], columns = self.evaluate_loops(x, with_matrix)
            if with_matrix:
                J[:m] = columns
        if self.held:
            F[m : m + len(self.held)] = (x[self.place[self._held]] - self.targets) / self.unit[
                self._held
            ]
            J[m + np.arange(len(self.held)), self._held] = 1.0
        if self.more:
            self._write_further_equations(x, F, J, with_matrix, further)
        return F, J

    def _evaluate_ties(self, x: Array, with_matrix: bool = True) -> tuple[Array, Array]:
        """Compute residuals (..., m) and Jacobian (..., m, n) of loops and lock, in metres."""
        return closure_rows.evaluate_constraints(self.tree, x, with_matrix, loops=self.loops)

    def evaluate_loops(self, x: Array, with_matrix: bool = True) -> tuple[Array, Array]:
        """Compute residuals (m,) and Jacobian (m, n) of the loop closures alone at the point `x`.

        The Jacobian is empty without `with_matrix`.
        """
        values, columns = self._evaluate_ties(x, with_matrix)
        if with_matrix:  # in place: the matrix of a long chain is most of the memory
            columns *= self.weight[:, None]
            columns *= self.unit
        return self.weight * values, columns

    def evaluate_sparse_loops(self, x: Array) -> tuple[Array, Array, np.ndarray, np.ndarray]:
        """Compute residuals (m,) and Jacobian (m, n) of the loop closures alone at the point `x`.

        Rows and columns (k,) of its entries that are not zero by structure come with it: of a long
        chain a pass over all entries takes far longer.
        """
        values, columns = self._evaluate_ties(x)
        i, j = self.loops.places
        columns[i, j] *= self.weight[i] * self.unit[j]
        return self.weight * values, columns, i, j

    def evaluate_many_points(self, x: Array, with_matrix: bool = True) -> tuple[Array, Array]:
        """Compute residuals (k, rows) and Jacobians (k, rows, n) at many points `x` (k, nq).

        The Jacobians have no rows without `with_matrix`.
        """
        self.budget.check_time()
        k = len(x)
        m = len(self.weight)
        F = np.zeros((k, self.rows))
        J = np.zeros((k, self.rows if with_matrix else 0, self.n))
        if m:
            values, columns = self._evaluate_ties(x, with_matrix)
            F[:, :m] = self.weight * values
            if with_matrix:
                J[:, :m] = self.weight[:, None] * columns * self.unit
        if self.held:
            F[:, m : m + len(self.held)] = (
                x[:, self.place[self._held]] - self.targets
            ) / self.unit[self._held]
            if with_matrix:
                J[:, m + np.arange(len(self.held)), self._held] = 1.0
        for one, f, j in zip(x, F, J, strict=True) if self.more else ():
            self._write_further_equations(one, f, j, with_matrix, None)
        return F, J

    def _write_further_equations(
        self, x: Array, F: Array, J: Array, with_matrix: bool, most: int | None
    ) -> None:
        """Write residuals and derivatives of the first `most` further equations into F and J."""
        at = len(self.weight) + len(self.held)
        for more in self.more[:most]:
            more.write_equations(self, x, F, J, at, with_matrix)
            at += more.count

    @property
    def follows_by_kernel(self) -> bool:
        """Whether the kernel of regular steps has all equations, and is worth while."""
        return not self.more and 0 < len(self.weight) and self.n <= MOST_UNKNOWNS and self.plain

    @cached_property
    def plain(self) -> bool:
        """Whether a point is a configuration, and no equation a Python function."""
        return not self.loops.functions

    def follow_regular_curve(
        self, x: Array, t: Array, h: float, longest: float, count: int
    ) -> tuple[Array, Array, Array]:
        """Take up to `count` steps along the curve from the point x with the tangent t (n,).

        They are those of `find_next_node` and `choose_step_length`, without a look at singular
        points. Returned are points (k, nq), tangents (k, n), and after each the length (k,) of the
        next step. A step of length 0 leads x to the curve, in the plane across t.
        """
        loops = self.loops
        points = np.empty((count, self.system.nq))
        tangents = np.empty((count, self.n))
        lengths = np.empty(count)
        held = np.zeros(self.n)
        held[self._held] = 1.0
        k = curve_steps.follow_curve(
            loops.ints,
            loops.floats,
            loops.plan,
            loops.weights,
            self.weight,
            self.unit,
            held,
            x,
            np.where(held > 0.0, 0.0, t),
            h,
            longest,
            TRIES,
            np.array([self.closed, self.rounding, LAST, NOTHING, ACROSS, BEND, IDEAL_BEND]),
            points,
            tangents,
            lengths,
        )
        return points[:k], tangents[:k], lengths[:k]

    def find_regular_node(self, x: Array, across: Array) -> Node | None:
        """Find the node in the plane through `x` normal to `across` (n,), without its matrices."""
        if not self.follows_by_kernel:
            return None
        points, tangents, _ = self.follow_regular_curve(x, across, 0.0, 0.0, 1)
        if not len(points):
            return None
        return Node(points[0], tangents[0], np.nan, 1, NONE, NONE)

    def compute_tolerance(self, x: Array) -> float:
        """Compute the largest residual of a closed configuration `x`.

        It grows with angles of many turns, which are known less exactly.
        """
        return self.closed * (1.0 + 0.01 * float(np.abs(x).max(initial=0.0))) + self.rounding

    def move_point(self, x: Array, y: Array) -> Array:
        """Compute the point that the tangent vector `y` (n,) leads to from `x`."""
        return self.system.structure.layout.integrate_velocity(x, y * self.unit)

    def compute_difference(self, x: Array, other: Array) -> Array:
        """Compute the tangent vector (n,) that leads from `x` to `other`, whole turns included."""
        return self.system.structure.layout.compute_difference(x, other) / self.unit


class DrivenClosure(Closure):
    """Closure equations, and inputs that follow a straight line.

    A point is a configuration and the length along that line.

    Point: (nq + 1,) = [q, length]; input i has the value
    `origin[i] + unit * direction[i] * length`.
    """

    def __init__(self, closure: Closure, inputs: Sequence[int], origin: Array, direction: Array):
        vars(self).update(vars(closure))
        self.base = closure
        self.inputs = list(inputs)
        self.origin = origin
        self.direction = direction
        self.n = closure.n + 1
        self.rows = max(self.real + len(self.inputs), self.n)

    @cached_property
    def plain(self) -> bool:
        """False: a point is more than a configuration."""
        return False

    def compute_input_values(self, length: float) -> Array:
        """Compute the values of the inputs, in radians and metres, at a length along their line."""
        return self.origin + self.unit[self.inputs] * self.direction * length

    def evaluate_equations(
        self, x: Array, with_matrix: bool = True, further: int | None = None
    ) -> tuple[Array, Array]:
        """Compute residuals F (rows,) and Jacobian J (rows, n) of all equations at the point `x`.

        J is zero without `with_matrix`.
        """
        F = np.zeros(self.rows)
        J = np.zeros((self.rows, self.n))
        k = self.real
        inner, columns = self.base.evaluate_equations(x[:-1], with_matrix, further)
        F[:k] = inner[:k]
        J[:k, :-1] = columns[:k]
        at = x[self.place[self.inputs]]
        unit = self.unit[self.inputs]
        place = k + np.arange(len(self.inputs))
        F[place] = (at - self.origin) / unit - self.direction * x[-1]
        J[place, self.inputs] = 1.0
        J[place, -1] = -self.direction
        return F, J

    def move_point(self, x: Array, y: Array) -> Array:
        """Compute the point that the tangent vector `y` (n,) leads to from `x`."""
        return np.append(self.base.move_point(x[:-1], y[:-1]), x[-1] + y[-1])

    def compute_difference(self, x: Array, other: Array) -> Array:
        """Compute the tangent vector (n,) that leads from `x` to `other`."""
        return np.append(self.base.compute_difference(x[:-1], other[:-1]), other[-1] - x[-1])


def close_loops(equations: Closure, x: Array, tries: int = 60) -> Array | None:
    """Find a closed configuration near `x`, by steps of least size; None if there is none."""
    found = run_gauss_newton(
        equations.evaluate_equations,
        x,
        tries,
        level=BLUNT,
        met=1e-15,
        longest=0.5,
        move=equations.move_point,
    )
    return found.x if found.size < equations.compute_tolerance(found.x) else None
