"""Freedoms that tasks leave: to first order, and as motions over a distance.

Counted are the freedoms of the joints that move a frame of the tasks, directly or through loops:
fingers and other arms are no redundancy of an arm.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe.numerics.newton import run_gauss_newton, solve_damped_least_squares
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.tasks.demands import Demands

ROUNDING = 1e-14
"""Residual below which equations hold to rounding, in radians and characteristic lengths."""
SAME = 16.0
"""How many times the residual a singular configuration may miss by, to be the same as the one that
was reached."""
SPREAD = 0.1
"""Singular values of unit directions up to this part of the largest are the bend of a motion."""
STEEPEST = 100.0
"""Largest second derivative of the equations that is reckoned with, in radians and characteristic
lengths."""
CURL = 1e-3
"""Step of the differences of the Jacobian."""
CLOSE = 60
STAYS = 1e-13
"""Steps by which a configuration is led to the solutions, at most, and the length below which one
is the last."""
LENGTHS = (0.05, 0.005)
"""Lengths of the steps along the null space, in radians and characteristic lengths."""
KEPT = 0.2
"""Part of a step that must be left when it has been led back."""


# ---- motions that the equations leave

# Where the equations are independent, all freedoms of first order are motions, by the implicit
# function theorem. Where the Jacobian loses rank, steps along its null space are led back to the
# solutions, at two lengths: what stays away from where it began, in proportion to the step, is a
# motion.


class Local:
    """Equations of hard tasks at q (nq,), and the motions that they leave there.

    `q` is led on to where the equations hold to rounding, if that is near; lengths count in
    characteristic lengths.
    """

    def __init__(self, problem: Demands, q: Array) -> None:
        packed = problem.packed
        self.problem = problem
        self.hard = [i for i, t in enumerate(problem.tasks) if t.weight is None and problem.use[i]]
        ties = packed.loops.ties
        equal = np.repeat([not t.bounds for t in ties], [len(t.row_names) for t in ties])[
            packed.rows >= 0
        ]
        self._use = np.isin(packed.rows[packed.rows >= 0], self.hard) & equal
        self.movers, self._moved = find_movers(problem, self.hard)
        self.q = self.correct_configuration(q)

    @property
    def n_equations(self) -> int:
        """Number of equations of the hard tasks."""
        return self.problem.packed.count_equations(self.hard)

    @cached_property
    def n_freedoms(self) -> int:
        """Number of first-order freedoms of the joints that move the tasks' frames."""
        closed = self.problem.packed.closed
        return (
            self.compute_null_space(self.q, tasks=False)[0].shape[1] if closed else len(self.movers)
        )

    def evaluate_equations(self, q: Array, tasks: bool = True) -> tuple[Array, Array]:
        """Compute values (k,) and Jacobian (k, nv) of loops and relations at q (nq,).

        With `tasks`, those of the hard tasks follow.
        """
        packed = self.problem.packed
        pins = self.problem.pins
        if not tasks:
            return packed.evaluate_tasks(q, pins, closures=True)
        own, own_J = packed.evaluate_tasks(q, pins)
        if not self._use.all():
            own = own[self._use]
            own_J = own_J[self._use]
        if not packed.closed:
            return own, own_J
        r, J = packed.evaluate_tasks(q, pins, closures=True)
        return np.concatenate([r, own]), np.concatenate([J, own_J])

    def move_point(self, x: Array, y: Array) -> Array:
        """Compute the configuration (nq,) that the step `y` (nv,) leads to from `x`."""
        return self.problem.system.structure.layout.integrate_velocity(
            x, y * self.problem.packed.scale
        )

    def compute_difference(self, x: Array, other: Array) -> Array:
        """Compute the step (nv,) from `x` to another configuration."""
        return (
            self.problem.system.structure.layout.compute_difference(x, other)
            / self.problem.packed.scale
        )

    def correct_configuration(self, q: Array) -> Array:
        """Find the nearest configuration (nq,) with the smallest residual of the equations.

        The damping is the residual (Fan and Yuan, 2005): quadratic where the equations are
        independent, and by a part of the way each step where solutions merge.
        """

        def compute_step(q: Array, r: Array, J: Array) -> Array:
            return solve_damped_least_squares(J, -r, float(np.linalg.norm(r)))

        return run_gauss_newton(
            self.evaluate_equations,
            q,
            CLOSE,
            step=compute_step,
            met=ROUNDING,
            last=STAYS,
            move=self.move_point,
        ).x

    def compute_null_space(self, q: Array, tasks: bool = True) -> tuple[Array, bool]:
        """Compute an orthonormal basis (nv, k) of velocities that keep the equations.

        Also returns whether the equations are independent.

        A singular value counts as zero where the nearest configuration at which it vanishes, by the
        derivative of the singular value, holds the equations as well as this one.
        """
        r, J = self._select_movers(*self.evaluate_equations(q, tasks))
        if not J.size:
            return self.expand_velocities(np.eye(J.shape[1])), True
        spectrum = Spectrum(J, 1.0)
        U = spectrum.left
        s = spectrum.values
        Vt = spectrum.right
        error = max(float(np.linalg.norm(r)), ROUNDING)
        rank = spectrum.compute_rank(Level.CLOSED)
        while rank and s[rank - 1] ** 2 <= 2.0 * SAME * error * STEEPEST:
            v = self.expand_velocities(Vt[rank - 1])
            u = U[:, rank - 1]
            ahead, behind = (
                self._select_movers(*self.evaluate_equations(self.move_point(q, h * v), tasks))[1]
                for h in (CURL, -CURL)
            )
            curve = float(np.linalg.norm(u @ (ahead - behind))) / (2.0 * CURL)
            if s[rank - 1] ** 2 > 2.0 * SAME * error * curve:
                break
            rank -= 1
        return self.expand_velocities(Vt[rank:].T), rank == len(r)

    def _select_movers(self, r: Array, J: Array) -> tuple[Array, Array]:
        """Select the rows and columns of a Jacobian (k, nv) that the `movers` decide."""
        ties = len(self._moved)
        closures = (
            self._moved
            if len(r) == ties
            else np.append(self._moved, np.ones(len(r) - ties, dtype=bool))
        )
        use = closures if self.problem.packed.closed else np.ones(len(r), dtype=bool)
        return r[use], J[use][:, self.movers]

    def expand_velocities(self, v: Array) -> Array:
        """Expand velocities (k, ...) of the `movers` to velocities (nv, ...) of the system."""
        out = np.zeros((self.problem.system.nv, *v.shape[1:]))
        out[self.movers] = v
        return out

    def compute_tangents(self, q: Array) -> Array:
        """Compute an orthonormal basis (nv, k) of velocities that keep the equations at q.

        The rank is that up to rounding.
        """
        return self.expand_velocities(
            Spectrum(self._select_movers(*self.evaluate_equations(q))[1], 1.0).compute_null_space(
                Level.CLOSED
            )
        )

    @cached_property
    def allowed_velocities(self) -> Array:
        """Orthonormal basis (nv, k) of the velocities that loops and tasks allow."""
        return self._allowed_space[0]

    @cached_property
    def _allowed_space(self) -> tuple[Array, bool]:
        return self.compute_null_space(self.q)

    @cached_property
    def motions(self) -> Array:
        """Unit vectors (n, nv) of the directions of finite motions; a basis at regular points."""
        basis, independent = self._allowed_space
        if independent or not basis.size:
            return basis.T
        return self._find_finite_directions(self.q, basis, LENGTHS)

    @cached_property
    def finite_freedoms(self) -> int:
        """Number of freedoms that are finite motions: the dimension of the set of solutions about
        q.

        Where several branches meet it is the largest of their dimensions.
        """
        basis, independent = self._allowed_space
        if independent:
            return basis.shape[1]
        most = 0
        for direction in self.motions:
            most = max(most, self._compute_dimension(direction))
            if most >= basis.shape[1]:
                break  # no set of solutions has more than the freedoms to first order
        return most

    def _compute_dimension(self, direction: Array) -> int:
        """Compute the dimension of the set of solutions beside q in a direction."""
        there = self.correct_configuration(self.move_point(self.q, LENGTHS[0] * direction))
        basis, independent = self.compute_null_space(there)
        if independent or basis.shape[1] == 1:
            return basis.shape[1]
        landed = self._find_finite_directions(there, basis, tuple(0.1 * h for h in LENGTHS))
        return Spectrum(landed, 1.0).compute_rank(SPREAD) if len(landed) else 0

    def _find_finite_directions(self, q: Array, basis: Array, lengths: tuple[float, ...]) -> Array:
        """Find directions (n, nv) of the null space along which solutions move away from q."""
        k = basis.shape[1]
        mixed = np.random.default_rng(0).normal(size=(2 * k if k > 1 else 0, k))
        wishes = np.concatenate([np.eye(k), mixed / np.linalg.norm(mixed, axis=1, keepdims=True)])
        d = basis[:, 0]
        far = 1.0
        out: list[Array] = []
        for wish in np.concatenate([wishes, -wishes]):
            for h in lengths:
                d = self.compute_difference(
                    q, there := self.correct_configuration(self.move_point(q, h * basis @ wish))
                )
                far = float(np.linalg.norm(d))
                if not KEPT * h <= far <= 5.0 * h or not self._is_satisfied(there):
                    break
            else:
                out.append(d / far)
        return np.array(out).reshape(len(out), self.problem.system.nv)

    def _is_satisfied(self, q: Array) -> bool:
        """Whether the equations hold at q (nq,) as well as at the first configuration."""
        there, here = (float(np.linalg.norm(self.evaluate_equations(x)[0])) for x in (q, self.q))
        return there <= 10.0 * max(here, 100.0 * ROUNDING)


def find_movers(problem: Demands, hard: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Find the velocities (k,) that move a frame of the hard tasks, also through loops.

    Also which equations (m,) of loops and relations these velocities are in.
    """
    packed = problem.packed
    columns = [set(packed.loops.list_columns(k)) for k in range(len(packed.loops.ties))]
    loops = [
        k for k in range(len(columns)) if packed.owner[k] < 0 and not packed.loops.ties[k].bounds
    ]
    found = set[int]().union(*(columns[k] for k in range(len(columns)) if packed.owner[k] in hard))
    while more := {v for k in loops if columns[k] & found for v in columns[k]} - found:
        found |= more
    of_ties = np.array([bool(c & found) for c in columns], dtype=bool)
    rows = np.repeat(of_ties, [len(t.row_names) for t in packed.loops.ties])
    return np.array(sorted(found), dtype=np.int64), rows[packed.rows == -1]


# ---- equations, freedoms and self-motions at a configuration


def analyse_freedoms(problem: Demands, q: Array) -> tuple[int, int, int, Array]:
    """Count equations m and freedoms n, and compute the rank and the self-motions (nv, k).

    The basis of self-motions at q (nq,) is orthonormal and scaled.
    """
    local = Local(problem, q)
    return (
        local.n_equations,
        local.n_freedoms,
        local.n_freedoms - local.allowed_velocities.shape[1],
        local.allowed_velocities,
    )
