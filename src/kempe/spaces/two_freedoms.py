"""Systems with two freedoms: all configurations for two coordinates or for a place of a frame.

Open chains and planar mechanisms of dyads are solved in closed form, others on a lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.assemble.dyads import Incomplete, Plan, find_closed_form
from kempe.assemble.idle_freedoms import compute_idle_rates, find_idle_coordinates
from kempe.budget import TimeUp
from kempe.constraints.flat_tasks import FlatTask
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.packed_tasks import Packed
from kempe.errors import InputError, UnsupportedError
from kempe.first_order.control import find_driven_velocities
from kempe.forward.fk import fk
from kempe.inverse.ik_all import ik_all
from kempe.mobility.independent import compute_tangent_space
from kempe.mobility.mobility import mobility
from kempe.model.configurations import (
    compute_sampling_box,
    find_free_angles,
    has_loops,
    shorten_turns,
)
from kempe.numerics.clock import BROKEN_OFF, TimeLimit
from kempe.numerics.newton import run_many_gauss_newton
from kempe.numerics.rank import Spectrum
from kempe.spaces.manifold import CLOSED, Manifold
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- lattices

# Closed configurations at which two functions have the values of a lattice. Each configuration that
# is found at a node leads by Newton's method to those of its neighbours, from many random ones on.
# What is found is closed and has the values of its node; that nothing else exists is evidence, not
# proof.

MOST = 64
"""Configurations of one node, at most."""
SAME = 1e-4
"""Difference, in radians and characteristic lengths, up to which configurations of one node are
one."""
NEAR = 3.0
"""How far configurations of neighbours may be apart, in parts of a turn along the lattice, to be of
one sheet."""
DAMPING = 1e-13
"""What is added to normal equations, as a part of their trace."""
TRIES = 10
FIRST = 40
LONGEST = 0.4
"""Steps of Newton's method, those from where nothing is known yet, and the longest."""
FOLLOWED = 0.5
"""How far apart neighbours on a line are at most, in radians and characteristic lengths."""
AT_ONCE = 1 << 14
"""Configurations that are solved for at once."""

Missing = Callable[[Array, np.ndarray], tuple[Array, Array]]
"""What two functions miss (k, m) at configurations (k, nq), at nodes of numbers (k,), and
derivatives (k, m, nv)."""


class Lattice(NamedTuple):
    """Configurations `q` (n, k, nq) at the nodes of a lattice and their `mask` (n, k). It keeps
    what broke the search off.
    """

    q: Array
    mask: np.ndarray
    broken: Status | None = None


class NodeSolver:
    """Solver for closed configurations at which two functions have given values. They are isolated
    but for idle freedoms.

    What spins idly is left as it is, and configurations that differ by that only are one.
    """

    def __init__(self, manifold: Manifold):
        self.manifold = manifold
        self.counts = ~find_idle_coordinates(manifold.system)
        self.spins = not self.counts.all()

    def solve_nodes(
        self, missing: Missing, q: Array, node: np.ndarray, tries: int = TRIES
    ) -> tuple[Array, np.ndarray]:
        """Solve by Newton's method from q (k, nq). A mask (k,) tells whether the equations
        `missing` hold at the node (k,).
        """
        M = self.manifold

        def evaluate_equations(x: Array, at: np.ndarray) -> tuple[Array, Array]:
            (F, J) = M.evaluate_equations(x)
            (f, j) = missing(x, node[at])
            still = compute_idle_rates(M.system, x) if self.spins else J[:, :0]
            zero = np.zeros(still.shape[:2])
            return np.concatenate([F, f, zero], axis=1), np.concatenate(
                [J, j, still * M.scale], axis=1
            )

        x = run_many_gauss_newton(
            evaluate_equations,
            q,
            tries,
            step=_compute_step,
            met=1e-3 * CLOSED,
            longest=LONGEST,
            move=M.move_configurations,
        )
        sound = np.isfinite(x).all(axis=1)
        x[~sound] = q[~sound]
        size = np.abs(evaluate_equations(x, np.arange(len(x)))[0]).max(axis=1, initial=0.0)
        return x, sound & (size < CLOSED)

    def compute_distances(self, q: Array, to: Array) -> Array:
        """Compute the distances (...) of configurations (..., nq) from others."""
        return self.manifold.metric.compute_distances(q, to, self.counts)

    def are_configurations_equal(self, q: Array, to: Array) -> np.ndarray:
        """Whether (...) configurations (..., nq) are the same as others."""
        return self.compute_distances(q, to) < SAME


def _compute_step(r: Array, J: Array) -> Array:
    """Compute Gauss-Newton steps (k, n), damped so little that only singular equations notice."""
    Jt = np.swapaxes(J, -1, -2)
    G = Jt @ J
    n = G.shape[-1]
    G[:, np.arange(n), np.arange(n)] += (DAMPING * np.einsum("kii->k", G) + 1e-300)[:, None]
    return np.asarray(-np.linalg.solve(G, Jt @ r[..., None])[..., 0], dtype=float)


def flood_lattice(
    solver: NodeSolver,
    missing: Missing,
    shape: tuple[int, int],
    q: Array,
    node: np.ndarray,
    clock: TimeLimit,
    progress: Callable[[int, int], Any] | None = None,
) -> Lattice:
    """Find the configurations on a lattice of `shape`, node after node. It begins with q (k, nq)
    near these nodes (k,).

    `progress` is called with the number of nodes that have some, and that of all.
    """
    found = np.full((shape[0] * shape[1], 4, q.shape[1]), np.nan)
    count = np.zeros(shape[0] * shape[1], dtype=int)
    broken = None
    tries = FIRST
    swept = False
    near = NEAR * 2.0 * np.pi / max(shape)
    try:
        while len(q):
            new = list[tuple[np.ndarray, np.ndarray]]()
            for i in range(0, len(q), AT_ONCE):
                clock.check_time()
                x, ok = solver.solve_nodes(
                    missing, q[i : i + AT_ONCE], node[i : i + AT_ONCE], tries
                )
                found = _add_found_configurations(
                    solver, found, count, x[ok], node[i : i + AT_ONCE][ok], new
                )
            at, slot = (
                np.concatenate([x[k] for x in new]).astype(int) if new else np.zeros(0, dtype=int)
                for k in (0, 1)
            )
            if progress is not None:
                progress(int((count > 0).sum()), len(count))
            tries = TRIES
            swept = swept and not len(at)
            q, node = _make_neighbour_starts(solver, shape, found, count, at, slot, near)
            if not len(q) and not swept:  # all that have more than a neighbour, once more
                at, slot = np.nonzero(np.arange(found.shape[1]) < count[:, None])
                q, node = _make_neighbour_starts(solver, shape, found, count, at, slot, 0.0)
                swept = True
    except BROKEN_OFF as error:
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    most = max(int(count.max(initial=0)), 1)
    return Lattice(found[:, :most], np.arange(most) < count[:, None], broken)


def _add_found_configurations(
    solver: NodeSolver,
    found: Array,
    count: np.ndarray,
    q: Array,
    node: np.ndarray,
    new: list[tuple[np.ndarray, np.ndarray]],
) -> Array:
    """Add configurations (k, nq) that their nodes (k,) lack to `found`, and their numbers to `new`."""
    order = np.argsort(node, kind="stable")
    q = q[order]
    node = node[order]
    first = np.searchsorted(node, node)
    rank = np.arange(len(node)) - first  # the several candidates of a node come one after another
    for k in range(int(rank.max(initial=-1)) + 1):
        x = q[rank == k]
        at = node[rank == k]
        known = np.zeros(len(at), dtype=bool)
        for slot in range(int(count[at].max(initial=0))):
            there = slot < count[at]
            known[there] |= solver.are_configurations_equal(x[there], found[at[there], slot])
        x = x[~known & (count[at] < MOST)]
        at = at[~known & (count[at] < MOST)]
        if count[at].max(initial=0) >= found.shape[1]:
            found = np.concatenate([found, np.full_like(found, np.nan)], axis=1)
        found[at, count[at]] = x
        new.append((at, count[at].copy()))
        count[at] += 1
    return found


def _make_neighbour_starts(
    solver: NodeSolver,
    shape: tuple[int, int],
    found: Array,
    count: np.ndarray,
    node: np.ndarray,
    slot: np.ndarray,
    near: float,
) -> tuple[Array, np.ndarray]:
    """Make starts for neighbours of nodes that have fewer configurations, or none within `near`."""
    i, j = np.divmod(node, shape[1])
    starts = [found[:0, 0]]
    nodes = [node[:0]]
    for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        ok = (0 <= i + di) & (i + di < shape[0]) & (0 <= j + dj) & (j + dj < shape[1])
        q = found[node[ok], slot[ok]]
        to = (i[ok] + di) * shape[1] + j[ok] + dj
        fewer = count[node[ok]]
        lacks = count[to] < fewer
        if near:
            lacks |= ~np.any(
                [
                    (k < count[to]) & (solver.compute_distances(q, found[to, k]) < near)
                    for k in range(int(count[to].max(initial=1)))
                ],
                axis=0,
            )
        starts.append(q[lacks])
        nodes.append(to[lacks])
    return np.concatenate(starts), np.concatenate(nodes)


def order_along_line(solver: NodeSolver, q: Array, mask: np.ndarray) -> tuple[Array, np.ndarray]:
    """Order configurations (n, k, nq) along a line so that each continues the one before. The mask
    is (n, k).
    """
    q = q.copy()
    mask = mask.copy()
    like: Array = q[0].copy()
    for i in range(len(q)):
        far = solver.compute_distances(like[:, None], q[i][None])
        far = np.where(mask[i] & np.isfinite(far), far, np.pi)
        order = _match_nearest(far)
        q[i] = q[i, order]
        mask[i] = mask[i, order]
        # what is too far to follow begins a line of its own
        mask[i] &= (far[np.arange(len(order)), order] < FOLLOWED) | (i == 0) | ~mask[i - 1]
        like = np.where((mask[i] | ~np.isfinite(like).all(axis=1))[:, None], q[i], like)
    return q, mask


def _match_nearest(far: Array) -> np.ndarray:
    """Match each of k rows of distances (k, k) with a column of its own, nearest pairs first."""
    out = np.full(len(far), -1)
    used = set[int]()
    for at in np.argsort(far, axis=None).tolist():
        row, column = divmod(at, len(far))
        if out[row] < 0 and column not in used:
            out[row] = column
            used.add(column)
    return out


def find_cell_nodes(x: Array, y: Array, p: Array) -> np.ndarray:
    """Find the numbers (k, 4) of the corners of the cells that contain places p (k, 2). The lattice
    is x (m,), y (n,).
    """
    i, j = (
        np.clip(((p[:, k] - side[0]) // (side[1] - side[0])).astype(int), 0, len(side) - 2)
        for k, side in enumerate((x, y))
    )
    return np.stack([(i + a) * len(y) + j + b for a in (0, 1) for b in (0, 1)], axis=1)


def find_nearest_nodes(x: Array, y: Array, p: Array) -> np.ndarray:
    """Find the numbers (k,) of the nodes of a lattice x (m,), y (n,) nearest to places p (k, 2)."""
    i, j = (
        np.clip(np.rint((p[:, k] - side[0]) / (side[1] - side[0])), 0, len(side) - 1).astype(int)
        for k, side in enumerate((x, y))
    )
    return i * len(y) + j


# ---- systems with two freedoms

# Of an open chain there is one configuration over each pair of values; of a planar mechanism made
# of dyads there are its assembly modes. Of others configurations are found from node to node of a
# lattice.

MOST_SIGNS = 6
"""Branch signs of a closed form, at most: 64 configurations at each place."""
INSIDE = 1e-9
"""How far, in radians and metres, a configuration may be beyond a limit to be inside."""
STARTS = 1024
LOOKED = 64
"""Random configurations from which others are found, and those at which pairs of coordinates are
looked at."""
SEEDS = 4000
"""Configurations, at most, from which those that reach a place are found."""
BLOCK = 4096
"""Places of which those reached in several ways are counted at once."""
SETS = 0.2
FLAT = 1e-6
"""Area that rates of two coordinates span at half of all configurations, as a part of the largest,
for these to be taken, and that of two that do not place the others."""
NEEDED = "pictures of both spaces need two degrees of freedom"


Solve = Callable[[Array], tuple[Array, np.ndarray]]
"""A closed form: configurations (..., k, nq) at values (..., 2), and a mask (..., k)."""


class TwoFreedoms:
    """A system with two freedoms over two coordinates, and the frame whose task is drawn.

    `names` are the two coordinates, `columns` theirs in q, `low`, `high` and `turns` (2,) their
    ranges and which of them are full turns. `over` is the closed form for values of the two
    coordinates, branch by branch, and `reaching` that for places of the frame. Without one
    configurations are found from node to node of a lattice; `broken` says what ended that early.
    Errors: `InputError`.
    """

    progress: Callable[[int, int], Any] | None = None
    """Called with how many nodes of a lattice have configurations, and how many it has."""

    def __init__(
        self,
        system: Model,
        frame: str,
        task: FlatTask,
        names: tuple[str, ...],
        clock: TimeLimit,
        over: Solve | None = None,
        reaching: Solve | None = None,
    ):
        self.system = system
        self.frame = frame
        self.task = task
        self.names = names
        self.clock = clock
        self.over = over
        self.reaching = reaching
        self.modes = has_loops(system)
        """Whether several configurations can lie over the same values."""
        velocity = system.structure.velocity_names
        self.at = [velocity.index(n) for n in names]
        self.columns = [system.coordinate_names.index(n) for n in names]
        self.turns = find_free_angles(system)[self.at]
        for i, name in zip(self.at, names, strict=True):
            if (
                not find_free_angles(system)[i]
                and not np.isfinite([system.lower[i], system.upper[i]]).all()
            ):
                raise InputError(
                    f"{name!r} has no limits on both sides, and a picture has an end: "
                    f"with_limits({{{name!r}: (low, high)}}) gives it one"
                )
        self.low, self.high = (x[self.at] for x in compute_sampling_box(system))
        self.manifold = Manifold(system, 2)
        self.rows = pack_one_sided_rows(system)
        self.solver = NodeSolver(self.manifold)
        self.broken: Status | None = None
        self._over: tuple[int, Array, np.ndarray] | None = None
        self._reaching: tuple[Array, Array, Array, np.ndarray] | None = None

    @property
    def complete(self) -> bool:
        """Whether the configurations over values and at places are all, by closed forms."""
        return self.over is not None and self.reaching is not None

    def make_grid(self, n: int) -> Array:
        """Make a grid of values (n, n, 2) over the ranges of both coordinates."""
        sides = [np.linspace(float(self.low[i]), float(self.high[i]), n) for i in range(2)]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)

    # ---- over values of the coordinates

    def solve_grid(self, n: int) -> tuple[Array, np.ndarray]:
        """Solve for configurations (n, n, k, nq) at the values of the grid, with mask (n, n, k) of
        those inside the limits.
        """
        values = self.make_grid(n).reshape(-1, 2)
        if self.over is not None:
            q, mask = self.over(values)
        else:
            seeds = self.manifold.draw_configurations(np.random.default_rng(0), STARTS)
            nodes = self._find_nodes(seeds[:, self.columns], n)
            q, mask = self._flood_lattice(self._make_value_equations(values), (n, n), seeds, nodes)
        self._over = n, q, mask
        q, mask = self._bring_inside(q, mask)
        return q.reshape(n, n, -1, self.system.nq), mask.reshape(n, n, -1)

    def solve_values(self, values: Array) -> tuple[Array, np.ndarray]:
        """Solve for configurations (..., k, nq) at values (..., 2) of the coordinates. The mask is
        (..., k) of those inside the limits.
        """
        if self.over is not None:
            return self._bring_inside(*self.over(values))
        assert self._over is not None
        n, q, mask = self._over
        flat = values.reshape(-1, 2)
        node = self._find_nodes(flat, n)
        x, ok = self._solve_again(self._make_value_equations(flat), q[node], mask[node])
        return x.reshape(*values.shape[:-1], -1, self.system.nq), ok.reshape(*values.shape[:-1], -1)

    def solve_line(self, values: Array) -> tuple[Array, np.ndarray]:
        """Solve for configurations (n, k, nq) over a line of values (n, 2). The mask is (n, k),
        mode by mode.
        """
        q, mask = self.solve_values(values)
        return (q, mask) if self.over is not None else order_along_line(self.solver, q, mask)

    def count_modes(self, q: Array, mask: np.ndarray) -> np.ndarray:
        """Count the assembly modes (n, n) of q (n, n, k, nq) on the grid; of a chain the ways to the
        place of the frame.
        """
        out = mask.sum(axis=-1)
        if not self.modes:
            out[mask[..., 0]] = self._count_ways(q[mask])
        return out

    def _find_nodes(self, values: Array, n: int) -> np.ndarray:
        """Find the numbers (k,) of the nodes nearest to values (k, 2)."""
        off = values - self.low
        off = np.where(self.turns, np.mod(off, 2.0 * np.pi), off)
        i, j = np.clip(np.rint(off / (self.high - self.low) * (n - 1)), 0, n - 1).astype(int).T
        return i * n + j

    def _make_value_equations(self, values: Array) -> Missing:
        """Make the function that evaluates how far coordinates are from values (k, 2)."""
        scale = self.manifold.scale[self.at]
        turning = self.system.structure.coordinates.turning[self.at]
        rates = np.eye(self.system.nv)[self.at]

        def evaluate_missing(q: Array, node: np.ndarray) -> tuple[Array, Array]:
            off = shorten_turns(q[:, self.columns] - values[node], turning)
            return off / scale, np.broadcast_to(rates, (len(q), *rates.shape))

        return evaluate_missing

    # ---- that reach a place

    def solve_places(self, p: Array) -> tuple[Array, np.ndarray]:
        """Solve for configurations (..., k, nq) that bring the frame to places p (..., 2), by the
        closed form. The mask is (..., k) of those inside the limits.
        """
        assert self.reaching is not None
        return self._bring_inside(*self.reaching(p))

    def count_reaching_grid(self, x: Array, y: Array) -> np.ndarray:
        """Count the configurations that bring the frame to each place of a lattice x (m,), y (n,)."""
        p = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        if self.reaching is not None:
            return self.solve_places(p)[1].sum(axis=-1)
        seeds = self._find_seeds()
        node = find_nearest_nodes(x, y, self.task.project_poses(fk(self.system, seeds, self.frame)))
        equations = self._make_place_equations(p.reshape(-1, 2))
        q, mask = self._bring_inside(*self._flood_lattice(equations, (len(x), len(y)), seeds, node))
        self._reaching = x, y, q, mask
        return mask.sum(axis=1).reshape(len(x), len(y))

    def _count_ways(self, q: Array) -> np.ndarray:
        """Count the configurations (k,) inside the limits with the frame where it is at q (k, nq).

        On a lattice, where the nodes around have different numbers, those of them that lead to the
        place are counted, with q.
        """
        p = self.task.project_poses(fk(self.system, q, self.frame))
        if self.reaching is not None:
            return np.maximum(self.solve_places(p)[1].sum(axis=-1), 1)
        assert self._reaching is not None
        x, y, found, mask = self._reaching
        count = mask.sum(axis=1)
        around = find_cell_nodes(x, y, p)
        out = count[around[:, 0]]
        mixed = np.flatnonzero((count[around] != out[:, None]).any(axis=1))
        for at in np.array_split(mixed, 1 + len(mixed) // BLOCK):
            near = around[at]
            k = len(at)
            starts = np.concatenate([q[at, None], found[near].reshape(k, -1, q.shape[-1])], axis=1)
            there = np.insert(mask[near].reshape(k, -1), 0, True, axis=1)
            out[at] = self._solve_again(self._make_place_equations(p[at]), starts, there)[1].sum(
                axis=1
            )
        return out

    def find_solutions(self, p: Array) -> Array:
        """Find the distinct configurations (k, nq) that bring the frame to a place (2,)."""
        if self.reaching is not None:
            q, mask = self.solve_places(p)
            q = q[mask]
            return q[self.manifold.metric.find_unique_configurations(q, SAME, self.solver.counts)]
        assert self._reaching is not None
        x, y, q, mask = self._reaching
        i, j = np.divmod(find_nearest_nodes(x, y, p[None])[0], len(y))
        rows, columns = (
            range(max(int(k) - 1, 0), min(int(k) + 2, len(side))) for k, side in ((i, x), (j, y))
        )
        near = np.array([r * len(y) + c for r in rows for c in columns])
        found, ok = self._solve_again(
            self._make_place_equations(p[None]),
            q[near].reshape(1, -1, q.shape[2]),
            mask[near].reshape(1, -1),
        )
        return found[ok]

    def _find_seeds(self) -> Array:
        """Find configurations (k, nq) over a grid from which searches for places start."""
        assert self._over is not None
        _, q, mask = self._over
        q = q[mask]
        return q[:: max(len(q) // SEEDS, 1)]

    def _make_place_equations(self, p: Array) -> Missing:
        """Make the function that evaluates how far the frame is from places (k, 2)."""
        packed = Packed(self.system, [self.task.make_constraint(self.frame, p)])
        pins = packed.pack_pins([packed.tasks[0].goal], (len(p),))

        def evaluate_missing(q: Array, node: np.ndarray) -> tuple[Array, Array]:
            return packed.evaluate_tasks(q, np.ascontiguousarray(pins[node]))

        return evaluate_missing

    # ---- both

    def _flood_lattice(
        self, missing: Missing, shape: tuple[int, int], q: Array, node: np.ndarray
    ) -> tuple[Array, np.ndarray]:
        """Find configurations (n, k, nq) at the nodes of a lattice, and their mask (n, k)."""
        found = flood_lattice(self.solver, missing, shape, q, node, self.clock, self.progress)
        self.broken = self.broken or found.broken
        return found.q, found.mask

    def _solve_again(
        self, missing: Missing, q: Array, mask: np.ndarray
    ) -> tuple[Array, np.ndarray]:
        """Solve n problems from the configurations of others, (n, k, nq), with mask (n, k), each
        once.
        """
        n, k = mask.shape
        x = q.reshape(n * k, -1).copy()
        ok = mask.ravel().copy()
        at = np.flatnonzero(ok)
        x[at], ok[at] = self.solver.solve_nodes(missing, x[at], at // k)
        x = x.reshape(n, k, -1)
        ok = ok.reshape(n, k)
        for j in range(1, k):
            for i in range(j):
                ok[:, j] &= ~(ok[:, i] & self.solver.are_configurations_equal(x[:, j], x[:, i]))
        return self._bring_inside(x, ok)

    def _bring_inside(self, q: Array, mask: np.ndarray) -> tuple[Array, np.ndarray]:
        """Turn angles of configurations (..., nq) into the limits where possible, with mask (...)."""
        flat = np.array(q.reshape(-1, self.system.nq))
        ok = np.array(mask.ravel())
        flat[ok] = self.manifold.metric.choose_representatives(flat[ok], None)
        ok[ok] = (self.rows.compute_excess(flat[ok]) <= INSIDE).all(axis=-1)
        return flat.reshape(q.shape), ok.reshape(mask.shape)

    def compute_places(self, q: Array, mask: np.ndarray) -> Array:
        """Compute the task values (..., k, 2) of the frame at configurations. They are NaN where
        the mask is false.
        """
        X = fk(self.system, np.where(mask[..., None], q, self.system.neutral), self.frame)
        return np.where(mask[..., None], self.task.project_poses(X), np.nan)


def make_two_freedoms(
    system: Model, frame: str, task: FlatTask, clock: TimeLimit | None = None
) -> TwoFreedoms:
    """Make the solver of a system over two of its coordinates. Errors: `UnsupportedError`,
    `InputError`.
    """
    loops = has_loops(system)
    clock = clock or TimeLimit(None)
    found = mobility(system, local=False) if loops else None
    freedoms = system.nv if found is None else found.rank_dof
    if freedoms is None:
        raise UnsupportedError(
            f"{NEEDED}; of {system.name} they are not known: {found and found.sentence}"
        )
    idle = found.idle if found else 0
    if freedoms - idle != 2 or (not loops and len(system.structure.layout.vector_q) != 2):
        what = format_count(freedoms - idle, "freedom" if loops else "coordinate")
        left_out = f", {format_count(idle, 'idle spin')} left out" if idle else ""
        raise UnsupportedError(
            f"{NEEDED}; {system.name} has {what}{' and loops' if loops else ''}{left_out}"
        )
    flat = system.dim == 2
    if not loops:
        reaching = partial(_solve_chain, system, frame) if flat else None
        names = tuple(system.coordinate_names)
        return TwoFreedoms(system, frame, task, names, clock, _take_values, reaching)
    plan = _make_plan(system) if flat else None
    if plan is None:
        return TwoFreedoms(system, frame, task, _choose_pair(system), clock)
    reaching = _plan_for_place(system, frame)
    return TwoFreedoms(system, frame, task, plan.known, clock, plan.all, reaching)


def _take_values(values: Array) -> tuple[Array, np.ndarray]:
    """Return the one configuration (..., 1, 2) of an open chain over values (..., 2)."""
    return values[..., None, :], np.ones((*values.shape[:-1], 1), dtype=bool)


def _solve_chain(system: Model, frame: str, p: Array) -> tuple[Array, np.ndarray]:
    """Solve for configurations (..., k, nq) of an open planar chain that reach places p (..., 2)."""
    found: Any = ik_all(system, p.reshape(-1, 2), frame, task="position", limits=True)
    return found.q.reshape(*p.shape[:-1], -1, system.nq), found.mask.reshape(*p.shape[:-1], -1)


def _list_pairs(system: Model) -> Iterator[tuple[str, ...]]:
    """List the pair of actuated coordinates, if these are two, and then all pairs."""
    names = system.structure.velocity_names
    inputs = tuple(names[i] for i in find_driven_velocities(system, None) or ())
    if len(inputs) == 2 and set(inputs) <= set(system.coordinate_names):
        yield inputs
    yield from combinations([n for n in names if n in system.coordinate_names], 2)


def _make_plan(system: Model) -> Plan | None:
    """Make the closed form from the actuated coordinates, else from the first that have one."""
    for pair in _list_pairs(system):
        found = find_closed_form(system, pair)
        if not isinstance(found, Incomplete) and found.signs <= MOST_SIGNS and _has_area(found):
            return found
    return None


def _has_area(plan: Plan) -> bool:
    """Whether configurations exist over an area of the known coordinates."""
    at = [plan.system.structure.velocity_names.index(n) for n in plan.known]
    low, high = (x[at] for x in compute_sampling_box(plan.system))
    return bool(plan.all(np.random.default_rng(0).uniform(low, high, (512, 2)))[1].any())


def _choose_pair(system: Model) -> tuple[str, ...]:
    """Choose the actuated coordinates if they determine the others, else the first pair that does.
    Errors: `UnsupportedError`.
    """
    q = Manifold(system, 2).draw_configurations(np.random.default_rng(0), LOOKED)
    if not len(q):
        raise UnsupportedError(
            f"{system.name}: no closed configuration was found: there is nothing to draw"
        )
    N = [compute_tangent_space(system, x)[0] for x in q]
    names = system.structure.velocity_names
    pairs = list(_list_pairs(system))
    at = [[names.index(n) for n in pair] for pair in pairs]
    # the area that rates of two coordinates span: what spins idly adds nothing
    areas = [float(np.median([np.prod(Spectrum(x[i]).values[:2]) for x in N])) for i in at]
    ended = find_free_angles(system) | (np.isfinite(system.lower) & np.isfinite(system.upper))
    driving = set(pairs[0]) == {names[i] for i in find_driven_velocities(system, None) or ()}
    good = [
        k
        for k, x in enumerate(areas)
        if x > (FLAT if driving and k == 0 else max(SETS * max(areas), FLAT))
    ]
    good.sort(key=lambda k: (not (driving and k == 0), not ended[at[k]].all()))
    if not good:
        raise UnsupportedError(
            f"{NEEDED}, over two coordinates that place the others; of {system.name} no two do"
        )
    return pairs[good[0]]


def _plan_for_place(system: Model, frame: str) -> Solve | None:
    """Make the closed form for a known place of a frame, by slides in x and y pinned to it."""
    m = system.mechanism
    free = "place"
    while any(
        name.startswith(free)
        for name in (*m.bodies, *m.joints, *m.frames, *m.couplings, *m.constraints)
    ):
        free += "'"
    m.prismatic(f"{free} x", m.ground, m.body(f"{free} 1"), axis=(1, 0))
    m.prismatic(f"{free} y", f"{free} 1", m.body(f"{free} 2"), axis=(0, 1))
    on = m.frames.get(frame)
    m.revolute(
        f"{free} pin",
        f"{free} 2",
        frame if on is None else on.body,
        child_at=(0, 0) if on is None else frame,
    )
    found = find_closed_form(type(system)(m), (f"{free} x", f"{free} y"))
    if isinstance(found, Incomplete) or found.signs > MOST_SIGNS:
        return None
    at = [found.system.coordinate_names.index(n) for n in system.coordinate_names]

    def solve_places(p: Array) -> tuple[Array, np.ndarray]:
        """Solve for configurations (..., k, nq) on all branches, and a mask (..., k)."""
        q, mask = found.all(p)
        return q[..., at], mask

    return solve_places
