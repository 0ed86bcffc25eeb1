"""All constraint equations of a system as one smooth, scale-free map.

Unknowns are all velocity coordinates, those of cut joints included, lengths divided by the
characteristic length.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.errors import UnsupportedError
from kempe.first_order.constraint_graph import NO_SERIES, list_function_constraints
from kempe.kernels import compiled
from kempe.kernels.constraints.loop_layout import LINEAR
from kempe.kernels.forward.table_layout import (
    KIND,
    N_OUT,
    N_ROWS,
    SLIDE,
    TURN,
    V_INDEX,
    get_row_integers,
)
from kempe.model.configurations import read_q
from kempe.model.packed_loops import get_packed_loops, pack_tapes
from kempe.numerics.clock import TimeLimit
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

BALL_REST = -(10**9)
"""Mark of the second and third velocity coordinate of a ball."""

ITERATIONS = 60
LONGEST = 0.2
"""Longest step of a projection, in scaled coordinates: it is to find what is near."""
SHARP = 1e-15
BLUNT = 1e-4
"""Residuals between these (the first for each equation), where a projection ends, may be halved
many times."""
LEAP = 0.6
"""Plain steps longer than this part of the distance from the center are not taken: where the
residual is what the digits of a description allow, they would run along the motion to where it is
less."""
PLAIN = 40
HOPELESS = 4
"""Most plain steps, and steps without gain that end it."""
STEEP = 1e-3
"""Singular values below this part of the largest are left out by steps back into the valley: along
them the equations are flat, and steps would leave its neighbourhood."""


class Landing(NamedTuple):
    """Results of projections: points (N, nq), residuals (N,) and distances (N,) from the centers.

    With the values (N, m) of the equations there and their Jacobian (N, m, nv) to scaled
    coordinates.
    """

    q: Array
    residual: Array
    distance: Array
    value: Array
    jacobian: Array


class Equations:
    """The packed equations of a system: m of them in nv scaled unknowns."""

    time = TimeLimit(None)
    """What is looked at where they are evaluated: it raises `TimeUp`. Copies for one call have a
    limit of their own."""

    def __init__(self, system: Model):
        self.system = system
        self._loops = get_packed_loops(system, frozenset(system.structure.closures))
        self.names = self._loops.names
        found = list_function_constraints(system)
        if found:
            raise UnsupportedError(f"constraint {found[0]!r} {NO_SERIES}, which is needed here")
        self.m = len(self.names)
        self.nv = system.nv
        self.nq = system.nq
        self.length = self._loops.length
        self.ints = self._loops.ints
        self.floats = self._loops.floats
        turning = np.array(system.structure.coordinates.turning)
        for iv in system.structure.layout.quaternion_v:
            turning[iv : iv + 3] = True
        self.turning = turning | np.isin(np.arange(self.nv), self._find_driving_velocities(TURN))
        self.sliding = np.isin(np.arange(self.nv), self._find_driving_velocities(SLIDE))
        """Which velocities (nv,) slide something, screws among them."""
        self.scale = np.where(self.turning, 1.0, self.length)
        self.ties, self.numbers = self._pack_arrays()
        self.places = np.full(self.nv, BALL_REST, dtype=np.int64)
        self.places[system.structure.layout.vector_v] = system.structure.layout.vector_q
        for iq, iv in zip(
            system.structure.layout.quaternion_q, system.structure.layout.quaternion_v, strict=True
        ):
            self.places[iv] = -1 - iq

    def _find_driving_velocities(self, kind: int) -> list[int]:
        """Find the velocity coordinates that move primitives of a kind."""
        rows = get_row_integers(self.ints)
        return rows[rows[:, KIND] == kind, V_INDEX].tolist()

    def _pack_arrays(self) -> tuple[np.ndarray, Array]:
        """Pack the arrays `ties` and `numbers` of `kempe.kernels.series.jet`."""
        numbers = [1.0 / self.length]
        row = 0
        heads: list[list[int]] = []
        entries: list[tuple[int, int]] = []
        factors: list[Any] = []
        recorded: list[tuple[np.ndarray, Array, list[int]]] = []
        first = self.system.structure.coordinates.first
        for tie in self._loops.ties:
            count = 0
            size = len(tie.row_names)
            number = tie.number
            start = len(entries)
            if tie.relation is not None:
                unit = 1.0 / self.scale[first[tie.relation.of][1]]
                number *= unit
                terms = {tie.relation.of: unit}
                for name, m in tie.relation.sources.items():
                    terms[name] = terms.get(name, 0.0) - m * unit
                for name, factor in terms.items():
                    entries.append(first[name])
                    factors.append(factor)
                count = len(terms)
            data = -1
            if tie.tape is not None:
                data = len(recorded)
                number = 1.0 / self.length if tie.tape.unit == "m" else 1.0
                inputs = (
                    [tie.tape.encode_input(n), *first.get(n, (-1, -1))]
                    for n in tie.tape.tape.inputs
                )
                recorded.append(
                    (*tie.tape.tape.make_arrays(), [x for item in inputs for x in item])
                )
            heads.append(
                [
                    tie.mask,
                    LINEAR if tie.relation is not None else tie.turns,
                    size,
                    row,
                    count,
                    start,
                    data,
                ]
            )
            numbers.append(number)
            row += size
        at = 1 + sum(len(item) for group in (heads, entries) for item in group)
        read, starts = pack_tapes(recorded, at, len(numbers) + len(factors))
        for head in heads:
            head[-1] = starts[head[-1]] if head[-1] >= 0 else -1
        flat = [x for group in (heads, entries) for item in group for x in item]
        self.tape_size = 3 * sum(int(ints[1]) for ints, _, _ in recorded)
        tapes = np.concatenate([np.zeros(0), *(x for _, x, _ in recorded)])
        return np.array([len(heads), *flat, *read], dtype=np.int64), np.array(
            [*numbers, *factors, *tapes], dtype=float
        )

    def linearise_equations(self, q: Any) -> tuple[Array, Array]:
        """Evaluate values (N, m) and scaled Jacobians (N, m, nv) at q (N, nq)."""
        q = np.array(read_q(self.system, q))
        q = q.reshape(math.prod(q.shape[:-1]), self.nq)
        landing = self._project_points(q, q, 0.0, 0)
        return landing.value, landing.jacobian

    def project_points(self, q: Array, centers: Array, radius: Array | float = 0.0) -> Landing:
        """Project configurations q (N, nq) onto the solution set.

        Where `radius` > 0 the points are sought at that distance from `centers` (N, nq) or (nq,).

        What is left where equations touch the set goes down in a narrow bent valley, in which steps
        that must not climb are short: plain steps, which climb out and come back, finish it.
        """
        q = np.array(q, dtype=float, order="C")
        q = q.reshape(math.prod(q.shape[:-1]), self.nq)
        found = self._project_points(q, centers, radius, ITERATIONS)
        radii = np.array(np.broadcast_to(np.asarray(radius, dtype=float), len(found.q)))
        left = self._compute_residuals(found, radii)
        slow = np.flatnonzero((left > self.m * SHARP) & (left < BLUNT))
        if len(slow):
            self._refine_points(
                found, slow, left[slow], np.broadcast_to(centers, found.q.shape)[slow], radii[slow]
            )
        return found

    @staticmethod
    def _compute_residuals(at: Landing, radii: Array) -> Array:
        """Compute residuals (N,), the equation of the sphere included."""
        return np.hypot(at.residual, np.where(radii > 0.0, at.distance - radii, 0.0))

    def _refine_points(
        self, found: Landing, slow: np.ndarray, best: Array, centers: Array, radii: Array
    ) -> None:
        """Refine the points `slow` by plain Gauss-Newton steps; better ones are stored in `found`."""
        q = found.q[slow]
        since = np.zeros(len(slow), dtype=int)
        for _ in range(PLAIN):
            at = self._project_points(q.copy(), centers, radii, 0)
            left = self._compute_residuals(at, radii)
            since = np.where(left < 0.5 * best, 0, since + 1)
            better = left < best
            best = np.where(better, left, best)
            for kept, new in zip(found, at, strict=True):
                kept[slow[better]] = new[better]
            there = self._take_step(at, centers, radii, Level.ROUNDING)
            step = np.linalg.norm(self.compute_offsets(at.q, there), axis=1)
            on = (left > self.m * SHARP) & (since < HOPELESS) & (step < LEAP * at.distance)
            if not on.any():
                return
            slow, best, since, centers, radii, q = (
                x[on] for x in (slow, best, since, centers, radii, there)
            )
            for _ in range(2):
                q = self._take_step(
                    self._project_points(q, centers, radii, 0), centers, radii, STEEP
                )

    def _take_step(self, at: Landing, centers: Array, radii: Array, level: float) -> Array:
        """Take an undamped step towards the equations and, where radii > 0, the spheres."""
        q = at.q
        value = at.value
        J = at.jacobian
        x = np.where((radii > 0.0)[:, None], self.compute_offsets(centers, q), 0.0)
        over = np.where(radii > 0.0, 1.0 / np.where(radii > 0.0, radii, 1.0), 0.0)
        error = 0.5 * (np.sum(x * x, axis=1) - radii**2) * over
        rows = np.concatenate([J, (x * over[:, None])[:, None]], axis=1)
        step = -(
            Spectrum(rows).compute_pseudo_inverse(level)
            @ np.append(value, error[:, None], axis=1)[..., None]
        )[..., 0]
        shorter = np.minimum(1.0, LONGEST / np.maximum(np.linalg.norm(step, axis=1), 1e-300))
        return self.move_configurations(q, step * shorter[:, None])

    def _project_points(
        self, q: Array, centers: Array, radius: Array | float, iterations: int
    ) -> Landing:
        """Project configurations in place by the kernel, with at most so many iterations."""
        self.time.check_time()
        centers = np.ascontiguousarray(np.broadcast_to(centers, q.shape), dtype=float)
        radii = np.array(np.broadcast_to(np.asarray(radius, dtype=float), len(q)))
        info = np.zeros((len(q), 3))
        value = np.zeros((len(q), self.m))
        J = np.zeros((len(q), self.m, self.nv))
        compiled.projection.project_configurations(
            self.ints,
            self.floats,
            self.ties,
            self.numbers,
            self.places,
            self.scale,
            centers,
            q,
            radii,
            iterations,
            LONGEST,
            info,
            value,
            J,
        )
        return Landing(q, info[:, 0], info[:, 1], value, J * self.scale)

    def move_configurations(self, q: Array, x: Array) -> Array:
        """Move configurations q (..., nq) by scaled tangent vectors x (..., nv)."""
        return self.system.structure.layout.integrate_velocity(q, np.asarray(x) * self.scale)

    def compute_offsets(self, q0: Array, q: Array) -> Array:
        """Compute scaled tangent vectors (..., nv) from configurations q0 to q (..., nq)."""
        return self.system.structure.layout.compute_difference(q0, q) / self.scale

    def make_series(self, q: Array, n: int, order: int) -> Series:
        """Make the Taylor series, up to `order`, of the equations along n curves.

        The curves begin at q (nq,), or each at its own (n, nq); `Series.set` gives their
        coefficients, order by order.
        """
        return Series(self, np.array(np.broadcast_to(q, (n, self.nq)), dtype=float), order)

    @cached_property
    def rows_by_name(self) -> dict[str, np.ndarray]:
        """Row indices of the equations of joints and constraints, without expressions, by name."""
        out: dict[str, np.ndarray] = {}
        row = 0
        for tie in self._loops.ties:
            if tie.relation is None and not tie.user_written:
                out[tie.name] = np.arange(row, row + len(tie.row_names))
            row += len(tie.row_names)
        return out

    @cached_property
    def sizes(self) -> tuple[int, int]:
        """Numbers of primitive rows and of outputs, at least one for the arrays of kernels."""
        return max(int(self.ints[N_ROWS]), 1), max(int(self.ints[N_OUT]), 1)


class Series:
    """Taylor series of equations and frames along curves q0 (+) v(t), computed order by order."""

    def __init__(self, equations: Equations, q: Array, order: int):
        from kempe.kernels.series.jet_layout import POSE_SIZE, compute_scratch_width

        self.equations = equations
        self.order = order
        n = len(q)
        (rows, outputs) = equations.sizes
        depth = order + 1
        self._q = np.ascontiguousarray(q)
        self._poses = np.zeros((n, rows, depth, POSE_SIZE))
        self._extra = np.zeros((n, rows, depth, compute_scratch_width(order)))
        self._frames = np.zeros((n, outputs, depth, 12))
        self._v = np.zeros((n, depth, equations.nv))
        self._tapes = np.zeros((n, equations.tape_size, depth))
        self.values = np.zeros((n, depth, equations.m))
        """Series (n, order + 1, m) of the equations."""

    def set_coefficients(self, k: int, x: Array) -> None:
        """Set the coefficients of order k of the curves: scaled tangent vectors x (n, nv)."""
        self._v[:, k] = x * self.equations.scale

    def compute_values(self, first: int, last: int) -> Array:
        """Compute coefficients (n, m) of order `last` of the equations.

        Orders first ... last are computed anew.
        """
        e = self.equations
        compiled.jet.compute_jets(
            e.ints,
            e.floats,
            e.ties,
            e.numbers,
            self._q,
            self._v,
            first,
            last,
            self._poses,
            self._extra,
            self._frames,
            self._tapes,
            self.values,
        )
        return self.values[:, last]
