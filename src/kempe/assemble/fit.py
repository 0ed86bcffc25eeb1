"""Fits of dimensions with which a mechanism closes exactly along a whole motion."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.assemble.dimensions import Dimensions, Equations, Relations
from kempe.equations.closure_rows import compute_coordinate_units, evaluate_constraints
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.clock import TimeLimit
from kempe.numerics.newton import run_many_gauss_newton
from kempe.numerics.rank import TINY, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


STRIDE = 0.4
FAR = 20
NEAR = 10
"""Length of the steps along a motion, and how many each way: of one freedom, a whole turn; of
several, in each of some directions."""
STRIDES = (STRIDE, 0.25 * STRIDE)
"""The lengths that are tried, one after the other."""
MANY = 6
"""Directions of a motion with several freedoms at most."""
ENOUGH = 6
"""Configurations at which a motion must be followed at least, for it to be one."""
GROWN = 10.0
"""Ratio of what is open from which on configurations are of another motion."""
REGULAR = 1e-2
"""Smallest singular value, relative to the largest, of configurations at which dimensions are
fitted."""
ROUNDS = 24
DAMPING = (3.0, 0.3, 30.0)
"""Steps of a fit at most, and its dampings as multiples of what is open, one after the other until
one ends."""
LEAST = 1e-6
LITTLE = 1e-8
SOON = 12
LATE = 1e-9
"""The least damping where `LITTLE` is open, so that rounding changes nothing, and elsewhere and
after some steps, for mechanisms about which several families meet."""
PATIENCE = 6
HOPEFUL = 1e-5
"""Steps in which a fit must gain, and what may stay open for another damping to be tried."""
AT_FIRST = 14
"""Configurations at most that dimensions are fitted to at first."""
MUCH = 3.0
"""Ratio of changes from which on those that make more configurations close are for another
motion."""
TRIES = 3
"""Fits, each with configurations between those of the one before."""
EXACT = 2e-14
"""Residual at which the fit ends."""
CLOSED = 8e-14
"""Residual up to which what was fitted is closed, at other configurations, too."""
ZERO = 1e-9
"""Singular values below this part of the largest are those of a motion, where dimensions were
fitted."""


# ---- valleys: where loop equations are nearest to zero


class Valley:
    """Configurations where the `rank` strongest combinations of the loop equations are zero.

    The residual of the others is small there: a valley.

    `equations` are those of other dimensions, by default of the system's.
    """

    def __init__(self, system: Model, rank: int, equations: Equations | None = None):
        tree = self.system = remove_cut_marks(system)
        self.rank = rank
        self.scale = compute_coordinate_units(tree)
        self.equations: Equations = equations or partial(evaluate_constraints, tree, scaled=True)

    def compute_spectrum(self, q: Array) -> Spectrum:
        """Compute singular values and vectors of the scaled Jacobian at q (..., nq)."""
        return Spectrum(self.equations(q)[1])

    def converge_to_valley(self, q: Array, rounds: int = 12) -> Array:
        """Converge to the valley from q (N, nq), by Gauss-Newton steps."""
        r = self.rank
        system = self.system

        def compute_step(f: Array, J: Array) -> Array:
            """Compute steps (N, nv) from values (N, m) and Jacobians (N, m, nv)."""
            U, s, Vt = Spectrum(J).thin_decomposition
            part = np.einsum("kmr,km->kr", U[..., :r], f) / np.maximum(s[..., :r], TINY)
            return -np.einsum("krn,kr->kn", Vt[..., :r, :], part)

        return run_many_gauss_newton(
            lambda q, _: self.equations(q),
            q,
            rounds,
            step=compute_step,
            longest=0.3,
            move=lambda q, y: system.structure.layout.integrate_velocity(q, self.scale * y),
        )

    def compute_residual(self, q: Array) -> Array:
        """Compute norms (...) of the residual at configurations (..., nq)."""
        return np.linalg.norm(self.equations(q, False)[0], axis=-1)

    def is_regular(self, spectrum: Spectrum) -> np.ndarray:
        """Return a mask (...) of the configurations at which the combinations are independent."""
        s = spectrum.values
        return s[..., max(self.rank - 1, 0)] > REGULAR * s[..., 0]

    def sample_between(self, q: Array) -> Array:
        """Sample regular configurations (k, nq) a step along the valley from q (N, nq)."""
        if self.rank == self.system.nv:
            return q[:0]
        ways = self.compute_spectrum(q).right[:, -1]
        there = self.system.structure.layout.integrate_velocity(
            q, 0.37 * STRIDE * self.scale * ways
        )
        there = self.converge_to_valley(there)
        there = there[np.isfinite(there).all(axis=1)]
        return there[self.is_regular(self.compute_spectrum(there))]

    def walk_valley(self, q: Array, most: float, rng: np.random.Generator) -> Array:
        """Walk along the valley from q in both directions; return regular configurations (N, nq).

        `most` is the largest residual that is accepted.

        The first are those that the fewest steps lead to. Where long steps lead to few, as the
        valley bends much, they are shorter. Where much more is open than on the way to the `ENOUGH`
        that are closest to closed, the steps went over to another valley: a way ends there.
        """
        freedoms = self.system.nv - self.rank
        null_space = self.compute_spectrum(q).right[self.rank :]
        ways = (
            null_space
            if freedoms == 1
            else rng.normal(size=(min(2 * freedoms, MANY), freedoms)) @ null_space
        )
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        ways = np.stack([ways, -ways], axis=1).reshape(-1, self.system.nv)
        found: list[tuple[float, Array]] = []
        for length in STRIDES:
            found = self._walk_directions(q, ways, length, most, FAR if freedoms == 1 else NEAR)
            if len(found) >= ENOUGH:
                break
        if len(found) > ENOUGH:
            most = max(GROWN * sorted(left for left, _ in found)[ENOUGH - 1], EXACT)
        near = [x for left, x in found if left <= most]
        return np.array(near).reshape(len(near), self.system.nq)

    def _walk_directions(
        self, q: Array, ways: Array, length: float, most: float, steps: int
    ) -> list[tuple[float, Array]]:
        """Walk in directions `ways` (W, n) from q (nq,).

        Returns regular configurations, those after the fewest steps first, each with the largest
        residual on the way to it.
        """
        layout = self.system.structure.layout
        start = float(self.compute_residual(q))
        found = [(start, q)] if self.is_regular(self.compute_spectrum(q)) else []
        q = np.tile(q, (len(ways), 1))
        left = np.full(len(ways), start)
        for _ in range(steps):
            there = self.converge_to_valley(
                layout.integrate_velocity(q, self.scale * ways * length)
            )
            kept = np.isfinite(there).all(axis=1)
            q = q[kept]
            there = there[kept]
            ways = ways[kept]
            left = left[kept]
            if not len(q):
                break
            f, J = self.equations(there)
            spectrum = Spectrum(J)
            null_space = spectrum.right[:, self.rank :]
            onward = np.einsum("wkn,wkm,wm->wn", null_space, null_space, ways)
            onward /= np.maximum(np.linalg.norm(onward, axis=1, keepdims=True), TINY)
            left = np.maximum(left, np.linalg.norm(f, axis=1))
            moved = np.linalg.norm(layout.compute_difference(q, there) / self.scale, axis=1)
            kept = (left <= most) & (0.5 * length < moved) & (moved < 2.0 * length)
            kept &= np.sum(onward * ways, axis=1) >= 0.5
            q = there[kept]
            ways = onward[kept]
            left = left[kept]
            regular = self.is_regular(spectrum)[kept]
            found += zip(left[regular].tolist(), q[regular], strict=True)
        return found


# ---- dimensions fitted to configurations


class Fit(NamedTuple):
    """Changes `p` (size,) of dimensions that close configurations `q` (N, nq).

    `left` is the largest residual that remains.

    Where they do not all close with small changes, `closed` is false, and `p` and `q` are where the
    fit ended.
    """

    closed: bool
    p: Array
    q: Array
    left: float


def fit_whole_motion(
    shape: Dimensions,
    rank: int,
    q: Array,
    most: float,
    time: TimeLimit,
    also: Relations | None = None,
    tries: int = len(DAMPING),
) -> Fit:
    """Fit dimensions to configurations q (N, nq) of a motion, sorted by distance from the first.

    What closes along a part of a motion closes all along, so that a fit to the nearest is enough,
    unless it leaves dimensions undetermined. Far ones may lie on another motion, which crosses the
    first where the mechanism is flat: then the changes with which that one closes, too, are much
    larger, if there are any. Where the nearest are on both sides of a crossing, those of one side
    are enough, too.
    """
    first = q[:AT_FIRST] if rank == shape.system.nv - 1 else q
    near = fit_dimensions(shape, rank, first, most, time, also, tries)
    for part in _split_sides(shape, rank, q) if tries > 1 else ():
        if near.closed:
            break
        near = fit_dimensions(shape, rank, part, most, time, also, tries)
    if (
        not near.closed
        or len(q) <= len(first)
        or is_closed_along_valley(Valley(shape.change_dimensions(near.p), rank), q)
    ):
        return near
    far = fit_dimensions(shape, rank, q, most, time, also, tries)
    return far if far.closed and np.abs(far.p).max() <= MUCH * np.abs(near.p).max() else near


def _split_sides(shape: Dimensions, rank: int, q: Array) -> list[Array]:
    """Split configurations q (N, nq) of a motion with one freedom into both sides of the first.

    Sides with too few configurations are left out.
    """
    valley = Valley(shape.system, rank)
    if rank != shape.system.nv - 1 or len(q) < ENOUGH:
        return []
    along = (
        shape.system.structure.layout.compute_difference(np.tile(q[0], (len(q), 1)), q)
        / valley.scale
        @ valley.compute_spectrum(q[0]).right[-1]
    )
    return [
        side for sign in (1.0, -1.0) if len(side := q[sign * along >= 0.0][:AT_FIRST]) >= ENOUGH
    ]


def fit_dimensions(
    shape: Dimensions,
    rank: int,
    q: Array,
    most: float,
    time: TimeLimit,
    also: Relations | None = None,
    tries: int = len(DAMPING),
) -> Fit:
    """Find the smallest changes with which all configurations q (N, nq) close.

    These configurations move along.

    `most` is the largest change, in metres and radians. What is fitted must close at configurations
    in between, too; where they do not they are fitted as well. `also` are relations that must hold;
    `tries` are the dampings that are tried.
    """
    p = np.zeros(shape.size)
    every = q
    q = q[:: -(-len(q) // AT_FIRST)]
    end: tuple[Array, Array, float] = p, q, np.inf
    left = np.inf
    for _ in range(TRIES):
        for damped in DAMPING[:tries]:
            end = _solve_changes(shape, rank, p, q, most, time, damped, also)
            if not CLOSED < end[2] < HOPEFUL:
                break
        if CLOSED < end[2] < LITTLE:  # the last digits, without damping
            end = _solve_changes(shape, rank, end[0], end[1], most, time, 0.0, also)
        p, q, left = end
        if left > CLOSED or np.abs(p * shape.unit).max(initial=0.0) > most:
            break
        valley = Valley(shape.change_dimensions(p), rank)
        every = valley.converge_to_valley(every)
        if not is_rank_constant(valley, q) or not np.isfinite(every).all():
            break
        between = valley.sample_between(q)
        if valley.compute_residual(
            np.array([*every, *between])
        ).max() <= CLOSED and is_rank_constant(valley, every):
            return Fit(True, p, every, left)
        q = np.array([*every, *between])
    return Fit(False, p, q, left)


def _solve_changes(
    shape: Dimensions,
    rank: int,
    p: Array,
    q: Array,
    most: float,
    time: TimeLimit,
    damped: float,
    also: Relations | None,
) -> tuple[Array, Array, float]:
    """Solve for changes of dimensions from p on, by Levenberg's method.

    Returns the changes, the configurations and the largest residual that remains.

    It acts on those combinations of equations that the configurations cannot answer for.
    """
    H = np.zeros((0, shape.size))
    P = np.zeros((0, 0, 0))
    at = np.full(shape.size, np.inf)
    before = [np.inf] * PATIENCE
    left = np.inf
    for k in range(ROUNDS):
        time.check_time()
        valley = Valley(shape.system, rank, shape.bind_equations(p))
        q = valley.converge_to_valley(q, 4)
        F, J = valley.equations(q)
        h = also.compute_values(p) if also is not None else np.zeros(0)
        left = float(max(np.linalg.norm(F, axis=-1).max(), np.abs(h).max(initial=0.0)))
        # one more for the last digit
        if not left < 0.9 * before[-PATIENCE] or (left <= EXACT and before[-1] <= EXACT):
            return p, q, left
        if not np.isfinite(left) or np.abs(p * shape.unit).max() > 3.0 * most:
            return p, q, np.inf
        before.append(left)
        # the last digits count where roots are nearly double
        if np.abs(p - at).max() > (1e-6 if damped else 0.0):
            P = shape.differentiate_equations(p, q)
            at = p
            H = also.differentiate_values(p) if also is not None else H
        U = Spectrum(J).left[:, :, rank:]
        G = np.concatenate([*(np.swapaxes(U, -1, -2) @ P), H])
        g = np.concatenate([*(np.swapaxes(U, -1, -2) @ F[..., None])[..., 0], h])
        if not U.size:  # no equation too many
            return p, q, np.inf
        L, s, Rt = Spectrum(G).thin_decomposition
        least = LEAST if damped and left < LITTLE and k < SOON else LATE
        damping = max(least, damped * left) * max(float(s[0]), TINY)
        p = p - Rt.T @ (s * (L.T @ g) / (s * s + damping * damping))
    return p, q, left


def is_rank_constant(valley: Valley, q: Array) -> bool:
    """Return whether the rank of the equations stays at all configurations q (N, nq)."""
    return not np.any(valley.compute_spectrum(q).compute_ranks(ZERO) > valley.rank)


def is_closed_along_valley(valley: Valley, q: Array) -> bool:
    """Return whether loops close exactly along the valley near q (N, nq), and between."""
    q = valley.converge_to_valley(q)
    return bool(
        valley.compute_residual(np.array([*q, *valley.sample_between(q)])).max() <= CLOSED
    ) and is_rank_constant(valley, q)
